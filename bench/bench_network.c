/* The Neuralocks network as training sees it: 748 -> 256 -> 256 -> 72 with silu, 3,000 strands, forward and backward,
 * concatenated (every strand carries all 748 features) and factored (66 strand features, 682 of the frame). Prints
 * medians in milliseconds and GFLOP/s; threads as OMP_NUM_THREADS says. Usage: bench_network [rows] [frames] */
#include "autograd/autograd.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { RUNS = 41, STRAND = 66, FRAME = 682, WIDTH = 256, OUT = 72 };

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e3 * (double)t.tv_sec + 1e-6 * (double)t.tv_nsec;
}

static int ascending(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(double *x, int n)
{
    qsort(x, (size_t)n, sizeof *x, ascending);
    return x[n / 2];
}

static hg_tensor *make(hg_ctx *ctx, int64_t rows, int64_t columns, double scale, bool gradient)
{
    hg_tensor *t = columns ? hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ rows, columns })
                           : hg_tensor_create(ctx, HG_F32, 1, &rows);
    for (int64_t i = 0; t && i < hg_tensor_count(t); i++)
        ((float *)t->data)[i] = (float)(scale * hg_random_normal(1, (uint64_t)(rows * 1000 + columns), (uint64_t)i));
    if (t && gradient) hg_require_grad(t);
    return t;
}

int main(int n, char **arguments)
{
    const bool half = n > 3;
    int64_t rows = n > 1 ? atoll(arguments[1]) : 3000, frames = n > 2 ? atoll(arguments[2]) : 1;
    hg_ctx *ctx;
    if (hg_ctx_create(&ctx, NULL) != HG_OK) return fprintf(stderr, "%s\n", hg_message()), 1;
    if (half && hg_ctx_compute(ctx, HG_BF16) != HG_OK) return fprintf(stderr, "%s\n", hg_message()), 1;
    hg_tensor *all = make(ctx, rows * frames, STRAND + FRAME, 1, false), *strand = make(ctx, rows, STRAND, 1, false);
    hg_tensor *frame = make(ctx, frames, FRAME, 1, false);
    hg_tensor *w0 = make(ctx, STRAND + FRAME, WIDTH, 0.05, true), *b0 = make(ctx, WIDTH, 0, 0.05, true);
    hg_tensor *ws = make(ctx, STRAND, WIDTH, 0.05, true), *wf = make(ctx, FRAME, WIDTH, 0.05, true);
    hg_tensor *w1 = make(ctx, WIDTH, WIDTH, 0.09, true), *b1 = make(ctx, WIDTH, 0, 0.05, true);
    hg_tensor *w2 = make(ctx, WIDTH, OUT, 0.09, true), *b2 = make(ctx, OUT, 0, 0.05, true);
    double forward[2][RUNS], backward[2][RUNS];
    for (int run = -3; run < RUNS; run++)
        for (int factored = 0; factored < 2; factored++) {
            hg_step_reset(ctx);
            double t0 = now();
            hg_tensor *h = factored ? hg_linear_pair(ctx, hg_linear(ctx, strand, ws, b0, HG_IDENTITY),
                                                     hg_linear(ctx, frame, wf, NULL, HG_IDENTITY), HG_SILU)
                                    : hg_linear(ctx, all, w0, b0, HG_SILU);
            hg_tensor *y = hg_linear(ctx, hg_linear(ctx, h, w1, b1, HG_SILU), w2, b2, HG_IDENTITY);
            double t1 = now();
            hg_backward_seeded(ctx, y, y);
            double t2 = now();
            if (run < 0) continue;
            forward[factored][run] = t1 - t0;
            backward[factored][run] = t2 - t1;
        }
    if (hg_ctx_status(ctx) != HG_OK) return fprintf(stderr, "%s\n", hg_ctx_message(ctx)), 1;
    for (int factored = 0; factored < 2; factored++) {
        double f = median(forward[factored], RUNS), b = median(backward[factored], RUNS);
        double deep = (double)(rows * frames) * (WIDTH * WIDTH + WIDTH * OUT);
        double first = factored ? (double)rows * STRAND * WIDTH + (double)frames * FRAME * WIDTH
                                : (double)(rows * frames) * (STRAND + FRAME) * WIDTH;
        double flops = 2 * (first + deep), gradient = 2 * (first + 2 * deep);
        printf("%-12s %lld strands x %lld frames, %d threads: forward %.2f ms (%.0f GFLOP/s), backward %.2f ms (%.0f "
               "GFLOP/s), "
               "together %.2f ms\n",
               factored ? "factored" : "concatenated", (long long)rows, (long long)frames, hg_ctx_threads(ctx), f,
               1e-6 * flops / f, b, 1e-6 * gradient / b, f + b);
    }
    printf("step memory: %.1f MB\n", 1e-6 * (double)hg_step_reserved(ctx));
    hg_tensor *owned[] = { all, strand, frame, w0, b0, ws, wf, w1, b1, w2, b2 };
    for (size_t i = 0; i < sizeof owned / sizeof *owned; i++) hg_tensor_destroy(owned[i]);
    hg_ctx_destroy(ctx);
    return 0;
}
