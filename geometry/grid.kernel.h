/* Kernels of the grid: the cell of every point and how many a cell has, where the cells begin, and the order in a cell. */
#include "tensor/kernel.h"

#include "geometry/grid_walk.inc"

typedef struct {
    hg_grid grid;
    const void *points; /* [frames,n,3] */
    const void *reach;  /* one number, NULL: 1 */
    double factor;      /* the radius is factor * reach */
    int32_t *slot;      /* [frames*n] which of its cell a point was, in the order in which they came */
    int32_t *unordered; /* [frames*n] points by cell, in that order */
} grid_args;

#ifdef HG_CUDA
#define GRID_TAKE(at_) atomicAdd(at_, 1)
#else
#define GRID_TAKE(at_) __atomic_fetch_add(at_, 1, __ATOMIC_RELAXED)
#endif

#define REAL    float
#define F(name) name##_f32
#include "geometry/grid.inc"
#undef REAL
#undef F
#define REAL    double
#define F(name) name##_f64
#include "geometry/grid.inc"
#undef REAL
#undef F
HG_KERNELS(grid_find, grid_args, 4096)
HG_KERNELS(grid_order, grid_args, 1024)

HG_BODY void grid_put(const grid_args *p, int64_t first, int64_t last)
{
    for (int64_t i = first; i < last; i++) p->unordered[p->grid.start[p->grid.cell[i]] + p->slot[i]] = (int32_t)i;
}
HG_KERNEL(grid_put, grid_args, 4096)

/* ---- sums of all numbers before each: of chunks, of the sums of chunks, and in the chunks --------------------- */

#define GRID_THREADS 256
#define GRID_EACH    8
#define GRID_CHUNK   (GRID_THREADS * GRID_EACH)

typedef struct {
    int32_t *values; /* [n] become the sums of those before */
    int32_t *sums;   /* [chunks] */
    int64_t n;
} grid_scan_args;

#ifdef HG_CUDA

/* The sum of the values of the threads before this one; *all is that of the whole block. */
HG_BODY int32_t grid_before(int32_t value, int32_t *all)
{
    __shared__ int32_t sums[GRID_THREADS];
    const int t = (int)threadIdx.x;
    sums[t] = value;
    __syncthreads();
    for (int step = 1; step < GRID_THREADS; step *= 2) {
        const int32_t other = t >= step ? sums[t - step] : 0;
        __syncthreads();
        sums[t] += other;
        __syncthreads();
    }
    const int32_t before = sums[t] - value;
    *all = sums[GRID_THREADS - 1];
    __syncthreads(); /* before they are used again */
    return before;
}

HG_BODY void grid_chunks_block(const grid_scan_args *p, int64_t chunk)
{
    int32_t sum = 0, all;
    for (int k = 0; k < GRID_EACH; k++) {
        const int64_t i = chunk * GRID_CHUNK + k * GRID_THREADS + threadIdx.x;
        if (i < p->n) sum += p->values[i];
    }
    grid_before(sum, &all);
    if (threadIdx.x == 0) p->sums[chunk] = all;
}

/* Every thread has GRID_EACH neighbours; `before` is the sum of all that is before them. */
HG_BODY int32_t grid_scan_piece(int32_t *values, int64_t first, int64_t n, int32_t before)
{
    int32_t own[GRID_EACH], sum = 0, all;
    const int64_t from = first + (int64_t)threadIdx.x * GRID_EACH;
    for (int k = 0; k < GRID_EACH; k++) {
        own[k] = from + k < n ? values[from + k] : 0;
        sum += own[k];
    }
    int32_t at = before + grid_before(sum, &all);
    for (int k = 0; k < GRID_EACH; k++) {
        if (from + k < n) values[from + k] = at;
        at += own[k];
    }
    return before + all;
}

HG_BODY void grid_scan_sums_block(const grid_scan_args *p, int64_t index)
{
    const int64_t chunks = (p->n + GRID_CHUNK - 1) / GRID_CHUNK;
    int32_t before = 0;
    (void)index; /* there is one */
    for (int64_t first = 0; first < chunks; first += GRID_CHUNK)
        before = grid_scan_piece(p->sums, first, chunks, before);
}

HG_BODY void grid_scan_block(const grid_scan_args *p, int64_t chunk)
{
    grid_scan_piece(p->values, chunk * GRID_CHUNK, p->n, p->sums[chunk]);
}

#else

HG_BODY void grid_chunks(const grid_scan_args *p, int64_t first, int64_t last)
{
    for (int64_t c = first; c < last; c++) {
        int32_t sum = 0;
        for (int64_t i = c * GRID_CHUNK; i < p->n && i < (c + 1) * GRID_CHUNK; i++) sum += p->values[i];
        p->sums[c] = sum;
    }
}

HG_BODY int32_t grid_scan_piece(int32_t *values, int64_t first, int64_t last, int32_t before)
{
    for (int64_t i = first; i < last; i++) {
        const int32_t value = values[i];
        values[i] = before;
        before += value;
    }
    return before;
}

HG_BODY void grid_scan_sums(const grid_scan_args *p, int64_t first, int64_t last)
{
    if (first < last) grid_scan_piece(p->sums, 0, (p->n + GRID_CHUNK - 1) / GRID_CHUNK, 0);
}

HG_BODY void grid_scan(const grid_scan_args *p, int64_t first, int64_t last)
{
    for (int64_t c = first; c < last; c++) {
        const int64_t end = (c + 1) * GRID_CHUNK;
        grid_scan_piece(p->values, c * GRID_CHUNK, end < p->n ? end : p->n, p->sums[c]);
    }
}

#endif

HG_KERNEL_BLOCK(grid_chunks, grid_scan_args, 16, GRID_THREADS)
HG_KERNEL_BLOCK(grid_scan_sums, grid_scan_args, 1, GRID_THREADS)
HG_KERNEL_BLOCK(grid_scan, grid_scan_args, 16, GRID_THREADS)
