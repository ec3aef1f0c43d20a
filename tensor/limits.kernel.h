/* What a machine can do at best: fused multiply-adds in registers, and copying. */
#include "tensor/kernel.h"

enum { LIMIT_THREADS = 256, LIMIT_CHAINS = 8 };

typedef struct {
    float *out; /* a number for each thread */
    int64_t rounds;
} limit_args;

#ifdef HG_CUDA
HG_BODY void limit_multiply_add_block(const limit_args *p, int64_t index)
{
    float sum[LIMIT_CHAINS], total = 0;
    for (int k = 0; k < LIMIT_CHAINS; k++) sum[k] = (float)(k + threadIdx.x);
    for (int64_t i = 0; i < p->rounds; i++)
        for (int k = 0; k < LIMIT_CHAINS; k++) sum[k] = fmaf(sum[k], 0.999f, 1e-3f);
    for (int k = 0; k < LIMIT_CHAINS; k++) total += sum[k];
    p->out[index * LIMIT_THREADS + threadIdx.x] = total;
}
#endif
HG_KERNEL_GPU(limit_multiply_add, limit_args, LIMIT_THREADS)

typedef struct {
    const float *from;
    float *to;
} limit_copy_args;

HG_BODY void limit_copy(const limit_copy_args *p, int64_t first, int64_t last)
{
    for (int64_t i = first; i < last; i++) p->to[i] = p->from[i];
}
HG_KERNEL(limit_copy, limit_copy_args, 1 << 20)
