/* What the machine can do at best, measured: fused multiply-adds in registers, and copying between arrays that no cache
 * holds, on all threads of a context. */
#include "tensor/context.h"

#include <string.h>
#include <time.h>

enum { TRIES = 7, LANES = 16, CHAINS = 16, ROUNDS = 40000 };

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

#ifdef __FMA__
#define MULTIPLY_ADD(a_, b_, c_) __builtin_fmaf(a_, b_, c_)
#else /* a build for any processor: two instructions */
#define MULTIPLY_ADD(a_, b_, c_) ((a_) * (b_) + (c_))
#endif

typedef float vector __attribute__((vector_size(LANES * sizeof(float))));

static void multiply_add(const void *args, int64_t first, int64_t last)
{
    float *out = *(float *const *)args;
    for (int64_t t = first; t < last; t++) {
        vector sum[CHAINS];
        for (int k = 0; k < CHAINS; k++) sum[k] = (vector){ 0 } + (float)(k + t);
        const vector a = (vector){ 0 } + 0.999f, b = (vector){ 0 } + 1e-3f;
        for (int i = 0; i < ROUNDS; i++) {
            for (int k = 0; k < CHAINS; k++)
                for (int l = 0; l < LANES; l++) sum[k][l] = MULTIPLY_ADD(sum[k][l], a[l], b[l]);
        }
        float total = 0;
        for (int k = 0; k < CHAINS; k++)
            for (int l = 0; l < LANES; l++) total += sum[k][l];
        out[t] = total;
    }
}

typedef struct {
    const float *from;
    float *to;
} copy_args;

static void copy(const void *args, int64_t first, int64_t last)
{
    const copy_args *c = args;
    memcpy(c->to + first, c->from + first, (size_t)(last - first) * sizeof(float));
}

hg_status hg_machine_limits(hg_ctx *ctx, double *operations, double *bytes)
{
    enum { FLOATS = 16 << 20 };
    static const hg_kernel add = {
        .name = "limit_multiply_add", .args_size = sizeof(void *), .cpu = multiply_add, .block = 1
    };
    static const hg_kernel move = {
        .name = "limit_copy", .args_size = sizeof(copy_args), .cpu = copy, .block = 1 << 20
    };
    const int threads = hg_ctx_threads(ctx);
    float *from = hg_alloc(FLOATS, sizeof *from), *to = hg_alloc(FLOATS, sizeof *to);
    hg_status status = from && to ? HG_OK : HG_MEMORY;
    *operations = *bytes = 0;
    for (int i = 0; i < TRIES && status == HG_OK; i++) {
        double start = now();
        status = hg_launch(ctx, &add, threads, &to);
        double rate = 2.0 * CHAINS * LANES * ROUNDS * threads / (now() - start);
        if (rate > *operations) *operations = rate;
        const copy_args args = { from, to };
        start = now();
        if (status == HG_OK) status = hg_launch(ctx, &move, FLOATS, &args);
        rate = 2.0 * FLOATS * sizeof(float) / (now() - start);
        if (rate > *bytes) *bytes = rate;
    }
    hg_free(from);
    hg_free(to);
    return status;
}
