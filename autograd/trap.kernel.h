/* The search for numbers that are not finite: the first one of each block of numbers. */
#include "tensor/kernel.h"

enum { SEARCHED = 16384, SEARCH_THREADS = 256 }; /* numbers of a block */

typedef struct {
    const void *data;
    int64_t *first; /* of each block, -1: none */
    int64_t n;
} search_args;

#ifdef HG_CUDA
#define SEARCH(REAL_, SUFFIX_)                                                                                         \
    HG_BODY void search_##SUFFIX_##_block(const search_args *p, int64_t block)                                         \
    {                                                                                                                  \
        __shared__ int64_t found[SEARCH_THREADS];                                                                      \
        const int thread = (int)threadIdx.x;                                                                           \
        const int64_t begin = block * SEARCHED, end = begin + SEARCHED < p->n ? begin + SEARCHED : p->n;               \
        int64_t first = end;                                                                                           \
        for (int64_t i = begin + thread; i < end && first == end; i += SEARCH_THREADS)                                 \
            if (!isfinite(((const REAL_ *)p->data)[i])) first = i;                                                     \
        found[thread] = first;                                                                                         \
        __syncthreads();                                                                                               \
        for (int half = SEARCH_THREADS / 2; half > 0; half /= 2) {                                                     \
            if (thread < half && found[thread + half] < found[thread]) found[thread] = found[thread + half];           \
            __syncthreads();                                                                                           \
        }                                                                                                              \
        if (thread == 0) p->first[block] = found[0] < end ? found[0] : -1;                                             \
        __syncthreads(); /* before the next block of numbers */                                                        \
    }
#else
#define SEARCH(REAL_, SUFFIX_)                                                                                         \
    HG_BODY void search_##SUFFIX_(const search_args *p, int64_t first, int64_t last)                                   \
    {                                                                                                                  \
        for (int64_t block = first; block < last; block++) {                                                           \
            int64_t end = (block + 1) * SEARCHED < p->n ? (block + 1) * SEARCHED : p->n;                               \
            p->first[block] = -1;                                                                                      \
            for (int64_t i = block * SEARCHED; i < end && p->first[block] < 0; i++)                                    \
                if (!isfinite(((const REAL_ *)p->data)[i])) p->first[block] = i;                                       \
        }                                                                                                              \
    }
#endif
SEARCH(float, f32)
SEARCH(double, f64)
#undef SEARCH

HG_KERNELS_BLOCK(search, search_args, 1, SEARCH_THREADS)
