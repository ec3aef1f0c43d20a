/* Speed of the fused strand pass: median milliseconds of energy and gradient of stretch + bend_twist + gravity +
 * inertia, V = 25, f32, by the interpreter and by the printed kernel, in interleaved runs.
 *
 *     bench_energies [threads] [rounds] */
#include "hairloss/hairloss.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { MAX_ROUNDS = 1000 };

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e3 * (double)t.tv_sec + 1e-6 * (double)t.tv_nsec;
}

static int order(const void *a, const void *b)
{
    const double p = *(const double *)a, q = *(const double *)b;
    return (p > q) - (p < q);
}

static void check(hg_status status)
{
    if (status == HG_OK) return;
    fprintf(stderr, "%s\n", hg_message());
    exit(1);
}

static void bench(hg_ctx *ctx, int64_t strands, hg_dtype dtype, int rounds)
{
    const int64_t vertices = 25, n = strands * vertices * 3;
    double *rest = hg_alloc((size_t)n, sizeof *rest);
    if (!rest) exit(1);
    for (int64_t s = 0; s < strands; s++)
        for (int64_t v = 0; v < vertices; v++)
            for (int c = 0; c < 3; c++)
                rest[(s * vertices + v) * 3 + c] =
                    (c == 1 ? -4e-3 * (double)v : 0) +
                    1e-3 * hg_random_normal(1, (uint64_t)c, (uint64_t)(s * vertices + v));
    const hg_term terms[] = { { hg_energy_find("stretch"), 1, NULL, NULL },
                              { hg_energy_find("bend_twist"), 1, NULL, NULL },
                              { hg_energy_find("gravity"), 1, NULL, NULL },
                              { hg_energy_find("inertia"), 1, NULL, NULL } };
    const hg_groom_data data = { .grooms = 1, .strands = strands, .vertices = vertices, .rest = rest };
    hg_physics *physics[2];
    double ms[2][MAX_ROUNDS], created[2];
    for (int k = 0; k < 2; k++) {
        created[k] = now();
        check(hg_physics_create(&physics[k], ctx, dtype, terms, 4, &data));
        check(hg_physics_backend(physics[k], k ? HG_BACKEND_AUTO : HG_BACKEND_INTERPRETER));
        created[k] = now() - created[k];
    }
    const int64_t shape[4] = { 1, strands, vertices, 3 };
    hg_tensor *x = hg_tensor_create(ctx, dtype, 4, shape), *predicted = hg_tensor_create(ctx, dtype, 4, shape),
              *gradient = hg_tensor_create(ctx, dtype, 4, shape);
    if (!x || !predicted || !gradient) exit(1);
    for (int64_t i = 0; i < n; i++) {
        const double value = rest[i] + 5e-4 * hg_random_normal(2, 0, (uint64_t)i);
        if (dtype == HG_F64)
            ((double *)x->data)[i] = ((double *)predicted->data)[i] = value;
        else
            ((float *)x->data)[i] = ((float *)predicted->data)[i] = (float)value;
    }
    hg_tensor *rotation = hg_tensor_create(ctx, dtype, 3, (int64_t[]){ 1, strands, 4 });
    hg_tensor *position = hg_tensor_create(ctx, dtype, 3, (int64_t[]){ 1, strands, 3 });
    if (!rotation || !position) exit(1);
    for (int64_t i = 0; i < strands; i++) {
        if (dtype == HG_F64)
            ((double *)rotation->data)[4 * i] = 1;
        else
            ((float *)rotation->data)[4 * i] = 1;
    }
    const hg_frame frame = {
        .root_rotation = rotation, .root_position = position, .predicted = predicted, .dt = 1.0 / 30
    };
    double energies[4];
    for (int round = 0; round < rounds; round++)
        for (int k = 0; k < 2; k++) {
            const double start = now();
            check(hg_physics_evaluate(physics[k], ctx, &frame, x, energies, NULL, gradient));
            ms[k][round] = now() - start;
            hg_step_reset(ctx);
        }
    for (int k = 0; k < 2; k++) {
        qsort(ms[k], (size_t)rounds, sizeof(double), order);
        printf("%s %7lld strands  %-16s median %8.3f ms  min %8.3f ms   (made in %.0f ms)\n", hg_dtype_name(dtype),
               (long long)strands, hg_physics_backend_name(physics[k]), ms[k][rounds / 2], ms[k][0], created[k]);
        hg_physics_destroy(physics[k]);
    }
    hg_tensor_destroy(x);
    hg_tensor_destroy(predicted);
    hg_tensor_destroy(gradient);
    hg_tensor_destroy(rotation);
    hg_tensor_destroy(position);
    hg_free(rest);
}

int main(int argc, char **argv)
{
    const int threads = argc > 1 ? atoi(argv[1]) : 2;
    int rounds = argc > 2 ? atoi(argv[2]) : 51;
    if (rounds < 1 || rounds > MAX_ROUNDS) rounds = 51;
    hg_ctx *ctx;
    check(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = threads, .seed = 1 }));
    bench(ctx, 3000, HG_F32, rounds);
    bench(ctx, 30000, HG_F32, rounds > 15 ? 15 : rounds);
    bench(ctx, 3000, HG_F64, rounds);
    hg_ctx_destroy(ctx);
    return 0;
}
