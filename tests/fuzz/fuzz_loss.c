/* The input of `hairgrad loss`: every energy that is known, in turn, on a file that was damaged; and what a trap wrote. */
#include "autograd/autograd.h"
#include "hairloss/hairloss.h"
#include "tests/fuzz/fuzz.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { B = 2, S = 3, V = 5, N = 4, most = 64 };

int fuzz_one(const uint8_t *data, size_t size)
{
    static int turns;
    const int turn = turns++;
    const char *names[most];
    const int n = hg_list("energy", names, most);
    char *path = hg_strdup(fuzz_file(data, size, "h5")), *out = hg_format("%s.out", path ? path : "");
    hg_ctx *ctx = NULL;
    if (path && out && hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1 }) == HG_OK) {
        hg_loss_result result;
        hg_text report = { 0 };
        const hg_loss_options options = { .energies = names[turn % (n < most ? n : most)],
                                          .dtype = turn % 3 ? HG_F64 : HG_F32,
                                          .wrt = turn % 2 ? "x" : "stiffness" };
        hg_loss_run(ctx, path, out, &options, &result);
        hg_ctx_clear(ctx);
        hg_trap_replay(ctx, path, &report);
        hg_text_free(&report);
    }
    hg_ctx_destroy(ctx);
    if (out) remove(out);
    hg_free(path);
    hg_free(out);
    return 0;
}

static void check(hg_status status)
{
    if (status == HG_OK) return;
    fprintf(stderr, "no sound file to begin with: %s\n", hg_message());
    abort();
}

static void write_loss(const char *path)
{
    static const char *const names[] = { "x", "posed", "predicted", "previous", "ghost", "deformation" };
    const double body[N * 3] = { 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 0 };
    double x[B * S * V * 3], q[B * S * (V - 1) * 4], bodies[B * N * 3];
    hg_h5 *file;
    check(hg_h5_create(&file, path));
    for (int i = 0; i < B * S * V * 3; i++) x[i] = 0.004 * (i / 3 % V) + 0.002 * hg_random_normal(1, 1, (uint64_t)i);
    for (int i = 0; i < B * S * (V - 1) * 4; i++) q[i] = hg_random_normal(1, 2, (uint64_t)i);
    for (int i = 0; i < B * N * 3; i++) bodies[i] = body[i % (N * 3)];
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        check(hg_h5_write(file, names[i], HG_F64, 4, (int64_t[]){ B, S, V, 3 }, x));
    check(hg_h5_write(file, "rest", HG_F64, 3, (int64_t[]){ S, V, 3 }, x));
    check(hg_h5_write(file, "q", HG_F64, 4, (int64_t[]){ B, S, V - 1, 4 }, q));
    check(hg_h5_write(file, "mass", HG_F64, 0, NULL, (double[]){ 2.6e-8 }));
    check(hg_h5_write(file, "stiffness", HG_F64, 1, (int64_t[]){ S }, (double[S]){ 1, 2, 3 }));
    check(hg_h5_write(file, "scalp_distance", HG_F64, 0, NULL, (double[]){ 0.01 }));
    check(hg_h5_write(file, "body_vertices", HG_F64, 3, (int64_t[]){ B, N, 3 }, bodies));
    check(hg_h5_write(file, "rest_body_vertices", HG_F64, 2, (int64_t[]){ N, 3 }, body));
    check(hg_h5_write(file, "body_faces", HG_I32, 2, (int64_t[]){ 4, 3 },
                      (int32_t[]){ 0, 1, 2, 0, 2, 3, 0, 3, 1, 1, 3, 2 }));
    check(hg_h5_write_i64(file, "neighbours", 2, (int64_t[]){ 2, 2 }, (int64_t[]){ 1, V + 2, V, 2 * V }));
    check(hg_h5_commit(file));
}

static void write_trap(const char *path)
{
    hg_ctx *ctx;
    check(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1 }));
    hg_trap_nan(ctx, true, path);
    hg_tensor *x = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 2, 3 });
    check(hg_tensor_write(x, (float[]){ 1e38f, 1e38f, 3e38f, 3e38f, 1, 2 }));
    check(hg_require_grad(x));
    if (hg_sum_axis(ctx, x, 0, false)) check(HG_INVALID);
    hg_ctx_destroy(ctx);
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    void *bytes = NULL;
    size_t size = 0;
    if (number > 1) return 0;
    char *path = hg_strdup(fuzz_file(to, 0, "seed.h5"));
    if (!path) abort();
    if (number == 0)
        write_loss(path);
    else
        write_trap(path);
    check(hg_file_read(path, &bytes, &size));
    if (size > room) abort();
    memcpy(to, bytes, size);
    remove(path);
    hg_free(bytes);
    hg_free(path);
    return size;
}
