/* strand_cuda (private): what a strand kernel printed as CUDA C++ is made of: the scalar type (HG_BYTES, 4 or 8, is defined by its
 * text), and what strand_vector.h has for tiles, where a thread has a strand. */
#ifndef HG_STRAND_CUDA_H
#define HG_STRAND_CUDA_H

#include "autograd/trace/scalar_cuda.h"
#include "autograd/trace/strand_kernel.h"

#define HG_LANES 1
#if HG_BYTES == 8
typedef double hg_real;
#else
typedef float hg_real;
#endif
typedef hg_real hg_v;

/* Rows of the tiles of a warp lie side by side: each lane's own begins where the lane's number says. */
struct hg_tile {
    hg_v *at;
    __device__ inline hg_v &operator[](int64_t row) const { return at[32 * row]; }
    __device__ inline hg_tile operator+(int64_t rows) const { return hg_tile{ at + 32 * rows }; }
};
typedef hg_tile hg_tile_read;
static __device__ inline hg_tile hg_v_tile(void *scratch, int64_t at) { return hg_tile{ (hg_v *)scratch + 32 * at }; }

/* The values of a groom, of 32 strands side by side too. */
static __device__ inline hg_tile hg_v_stored(const void *from, int64_t strand, int64_t size)
{
    return hg_tile{ (hg_v *)from + strand / 32 * 32 * size + strand % 32 };
}

/* Other warps work while this one waits: nothing is asked for ahead. */
template <class tile> static __device__ inline void hg_v_soon(tile, int64_t, int) {}
template <class tile> static __device__ inline void hg_v_soon_written(tile, int64_t, int) {}

template <class tile>
static __device__ inline void hg_v_load_tile(tile to, const hg_real *row, int64_t width, int64_t count)
{
    for (int64_t j = 0; j < width && count > 0; j++) to[j] = row[j];
}

template <class tile>
static __device__ inline void hg_v_store_tile(hg_real *row, tile from, int64_t width, int64_t count)
{
    for (int64_t j = 0; j < width && count > 0; j++) row[j] = from[j];
}

static __device__ inline void hg_v_store_energy(const hg_strand_args *args, int64_t tile, int64_t strand, int64_t count,
                                                const hg_v *energy, int terms)
{
    for (int t = 0; t < terms && count > 0; t++) {
        args->energy[tile * terms + t] = (double)energy[t];
        if (args->per_strand) args->per_strand[strand * args->stride + args->column[t]] = (double)energy[t];
    }
}

#endif
