/* The kernel of the moving average; an index is a piece of a parameter. */
#include "train/chunk_kernel.h"

typedef struct {
    const hg_chunk *chunks;
    float *other;
    const float *rate; /* on the device; negative: exchange */
} average_args;

HG_BODY void average_piece(const average_args *p, const hg_chunk *chunk, int64_t begin, int64_t stride)
{
    float *restrict a = p->other + chunk->offset, *restrict b = chunk->value;
    const float rate = *p->rate;
    const int64_t count = chunk->count;
    if (rate >= 0)
        for (int64_t i = begin; i < count; i += stride) a[i] += rate * (b[i] - a[i]);
    else
        for (int64_t i = begin; i < count; i += stride) {
            const float kept = a[i];
            a[i] = b[i];
            b[i] = kept;
        }
}

#ifdef HG_CUDA
HG_BODY void average_block(const average_args *p, int64_t c)
{
    average_piece(p, &p->chunks[c], threadIdx.x, blockDim.x);
}
#else
HG_BODY void average(const average_args *p, int64_t first, int64_t last)
{
    for (int64_t c = first; c < last; c++) average_piece(p, &p->chunks[c], 0, 1);
}
#endif

HG_KERNEL_BLOCK(average, average_args, 1, 256)
