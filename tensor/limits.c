/* What the machine can do at best, measured: fused multiply-adds in registers, and copying between arrays that no cache
 * holds, on all threads of a context. */
#include "tensor/context.h"
#include "tensor/limits.kernel.h"

#include <math.h>
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

/* A device: more is asked for until it takes long enough to be measured. */
static hg_status device_limits(hg_ctx *ctx, double *operations, double *bytes)
{
    enum { BLOCKS = 512 };
    const double enough = 1e-3;
    const int64_t most = (int64_t)64 << 20;
    const hg_step_mark mark = hg_step_set_mark(ctx);
    limit_args add = { .out = hg_step_device(ctx, BLOCKS * LIMIT_THREADS * sizeof(float)), .rounds = 16 };
    hg_status status = add.out ? HG_OK : HG_MEMORY;
    for (int i = 0; i < TRIES && status == HG_OK;) {
        const double start = now();
        status = hg_launch(ctx, &limit_multiply_add_kernel, BLOCKS, &add);
        if (status == HG_OK) status = hg_ctx_wait(ctx);
        const double passed = now() - start;
        if (passed < enough && add.rounds < most) {
            add.rounds *= 2;
            continue;
        }
        if (i++ == 0) continue; /* what was compiled or woken is not counted */
        *operations = fmax(*operations, 2.0 * BLOCKS * LIMIT_THREADS * LIMIT_CHAINS * (double)add.rounds / passed);
    }
    int64_t floats = 1 << 20;
    for (int i = 0; i < TRIES && status == HG_OK;) {
        const hg_step_mark before = hg_step_set_mark(ctx);
        const limit_copy_args move = { hg_step_device(ctx, (size_t)floats * 4),
                                       hg_step_device(ctx, (size_t)floats * 4) };
        if (!move.from || !move.to) return HG_MEMORY;
        status = hg_ctx_wait(ctx);
        const double start = now();
        if (status == HG_OK) status = hg_launch(ctx, &limit_copy_kernel, floats, &move);
        if (status == HG_OK) status = hg_ctx_wait(ctx);
        const double passed = now() - start;
        hg_step_rewind(ctx, before);
        if (passed < enough && floats < most) {
            floats *= 2;
            continue;
        }
        if (i++ > 0) *bytes = fmax(*bytes, 8.0 * (double)floats / passed);
    }
    hg_step_rewind(ctx, mark);
    return status;
}

hg_status hg_machine_limits(hg_ctx *ctx, double *operations, double *bytes)
{
    enum { FLOATS = 16 << 20 };
    static const hg_kernel add = {
        .name = "limit_multiply_add", .args_size = sizeof(void *), .cpu = multiply_add, .block = 1
    };
    *operations = *bytes = 0;
    if (!hg_ctx_host(ctx)) return device_limits(ctx, operations, bytes);
    const int threads = hg_ctx_threads(ctx);
    float *from = hg_alloc(FLOATS, sizeof *from), *to = hg_alloc(FLOATS, sizeof *to);
    hg_status status = from && to ? HG_OK : HG_MEMORY;
    for (int i = 0; i < TRIES && status == HG_OK; i++) {
        double start = now();
        status = hg_launch(ctx, &add, threads, &to);
        double rate = 2.0 * CHAINS * LANES * ROUNDS * threads / (now() - start);
        if (rate > *operations) *operations = rate;
        const limit_copy_args args = { from, to };
        start = now();
        if (status == HG_OK) status = hg_launch(ctx, &limit_copy_kernel, FLOATS, &args);
        rate = 2.0 * FLOATS * sizeof(float) / (now() - start);
        if (rate > *bytes) *bytes = rate;
    }
    hg_free(from);
    hg_free(to);
    return status;
}
