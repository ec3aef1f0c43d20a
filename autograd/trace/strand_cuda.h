/* strand_cuda (private): what a kernel printed as CUDA C needs: the scalar type, the functions of strand_vector.h for one
 * strand a thread, and where a warp keeps things. HG_BYTES (4 or 8) is defined by whoever compiles the kernel: NVRTC, or a C++
 * compiler that a test gives __global__, threadIdx and __syncwarp. */
#ifndef HG_STRAND_CUDA_H
#define HG_STRAND_CUDA_H

#include "autograd/trace/scalar_cuda.h"
#include "autograd/trace/strand_kernel.h"

#ifndef HG_DYNAMIC_SHARED
#define HG_DYNAMIC_SHARED(type, name) extern __shared__ type name[]
#endif

#define restrict __restrict__
#define HG_LANES 1
#if HG_BYTES == 8
typedef double hg_real;
#else
typedef float hg_real;
#endif
typedef hg_real hg_v;

/* Other warps work while this one waits: nothing is asked for ahead. */
static __device__ inline void hg_v_soon(const void *, int64_t, int) {}
static __device__ inline void hg_v_soon_written(const void *, int64_t, int) {}
static __device__ inline void hg_v_load_tile(hg_v *tile, const hg_real *rows, int64_t width, int64_t count)
{
    for (int64_t j = 0; j < width && count > 0; j++) tile[j] = rows[j];
}

static __device__ inline void hg_v_store_tile(hg_real *rows, const hg_v *tile, int64_t width, int64_t count)
{
    for (int64_t j = 0; j < width && count > 0; j++) rows[j] = tile[j];
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
