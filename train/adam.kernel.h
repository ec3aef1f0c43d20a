/* Kernels of Adam; an index is a piece of a parameter. */
#include "tensor/block.h"

#include "train/chunk_kernel.h"

/* What changes with the step, on the device. */
typedef struct {
    double clip;  /* 0: none */
    int64_t step; /* from 1 */
    float beta1, beta2, rate, correction2, epsilon, decay;
} adam_numbers;

/* What a step finds. Once a gradient (or the loss) was not finite, later steps leave everything as it is too, until the host has seen it. */
enum { ADAM_NORM = -1, ADAM_LOSS = -2 }; /* in place of a parameter */
typedef struct {
    double norm, loss;
    int64_t failed_step, failed_param; /* 0: none; the first one */
    float scale;                       /* of the gradient: clipping */
} adam_state;

typedef struct {
    const hg_chunk *chunks;
    const adam_numbers *numbers;
    adam_state *state;
    double *partial; /* [chunks] squares of the gradient */
    float *m, *v;
    int64_t n_chunks;
    const float *loss; /* f32 or f64; both NULL: not looked at */
    const double *loss_f64;
} adam_args;

#ifdef HG_CUDA

HG_BODY void adam_norm_block(const adam_args *p, int64_t c)
{
    const float *g = p->chunks[c].gradient;
    double sum = 0;
    for (int64_t i = threadIdx.x; i < p->chunks[c].count; i += blockDim.x) sum += (double)g[i] * (double)g[i];
    sum = hg_block_sum(sum);
    if (threadIdx.x == 0) p->partial[c] = sum;
}

HG_BODY bool adam_finite(double x) { return x - x == 0; }

/* One block: the norm of the whole gradient, the factor that clips it, and whether it is finite at all. */
HG_BODY void adam_clip_block(const adam_args *p, int64_t index)
{
    (void)index;
    double sum = 0;
    for (int64_t c = threadIdx.x; c < p->n_chunks; c += blockDim.x) sum += p->partial[c];
    const double norm = sqrt(hg_block_sum(sum)), clip = p->numbers->clip;
    if (threadIdx.x != 0 || p->state->failed_step) return;
    p->state->norm = norm;
    p->state->loss = p->loss ? (double)*p->loss : p->loss_f64 ? *p->loss_f64 : 0;
    p->state->scale = (float)(clip > 0 && norm > clip ? clip / norm : 1);
    if (adam_finite(norm) && adam_finite(p->state->loss)) return;
    int64_t c = 0;
    while (c < p->n_chunks && adam_finite(p->partial[c])) c++;
    p->state->failed_param = !adam_finite(p->state->loss) ? ADAM_LOSS
                             : c < p->n_chunks            ? p->chunks[c].param
                                                          : ADAM_NORM;
    p->state->failed_step = p->numbers->step;
}

#else

HG_BODY void adam_norm(const adam_args *p, int64_t first, int64_t last)
{
    for (int64_t c = first; c < last; c++) {
        const float *g = p->chunks[c].gradient;
        const int64_t count = p->chunks[c].count;
        double sum[8] = { 0 };
        int64_t i = 0;
        for (; i + 8 <= count; i += 8)
            for (int k = 0; k < 8; k++) sum[k] += (double)g[i + k] * (double)g[i + k];
        for (; i < count; i++) sum[i & 7] += (double)g[i] * (double)g[i];
        p->partial[c] = ((sum[0] + sum[1]) + (sum[2] + sum[3])) + ((sum[4] + sum[5]) + (sum[6] + sum[7]));
    }
}

#endif

/* Every `stride`-th element of a piece, from `begin` on. */
HG_BODY void adam_piece(const adam_args *p, const hg_chunk *chunk, int64_t begin, int64_t stride)
{
    const adam_numbers *numbers = p->numbers;
    const float scale = p->state->scale, beta1 = numbers->beta1, beta2 = numbers->beta2, rate = numbers->rate;
    const float correction2 = numbers->correction2, epsilon = numbers->epsilon, decay = numbers->decay;
    float *restrict value = chunk->value, *restrict m = p->m + chunk->offset, *restrict v = p->v + chunk->offset;
    const float *restrict gradient = chunk->gradient;
    const int64_t count = chunk->count;
    for (int64_t i = begin; i < count; i += stride) {
        const float g = gradient[i] * scale;
        m[i] = beta1 * m[i] + (1 - beta1) * g;
        v[i] = beta2 * v[i] + (1 - beta2) * g * g;
        value[i] -= rate * m[i] / (sqrtf(v[i] * correction2) + epsilon) + decay * value[i];
    }
}

#ifdef HG_CUDA
HG_BODY void adam_step_block(const adam_args *p, int64_t c)
{
    if (!p->state->failed_step) adam_piece(p, &p->chunks[c], threadIdx.x, blockDim.x);
}
#else
HG_BODY void adam_step(const adam_args *p, int64_t first, int64_t last)
{
    for (int64_t c = first; c < last; c++) adam_piece(p, &p->chunks[c], 0, 1);
}
#endif

HG_KERNEL_BLOCK(adam_norm, adam_args, 1, 256)
HG_KERNEL_GPU(adam_clip, adam_args, 256)
HG_KERNEL_BLOCK(adam_step, adam_args, 1, 256)
