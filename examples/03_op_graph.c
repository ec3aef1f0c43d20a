/* 03 * The same loss twice: as a graph of tensor ops, and as a traced energy. They agree.
 *
 *     cc -std=gnu11 03_op_graph.c $(pkg-config --cflags --libs hairgrad) -lm && ./a.out
 *
 * Ops are what other frameworks offer: every line reads and writes whole arrays, and is free to combine anything. A traced
 * energy is the formula of one site: it is fused with the others, its gradient included, into one pass over the strands.
 * Prototype with ops if that comes easier; then write the energy and hold it against the ops, as here. */
#include "hairgrad.h"

#include <math.h>
#include <stdio.h>

enum { B = 2, S = 5, V = 8 };
static const double stiffness = 2.0; /* N/m */

/* sum k/2 (|x_{i+1} - x_i| - l0)^2 */
static hg_tensor *stretch_of_ops(hg_ctx *ctx, hg_tensor *x, hg_tensor *rest)
{
    hg_tensor *edge = hg_sub(ctx, hg_slice(ctx, x, 2, 1, V - 1), hg_slice(ctx, x, 2, 0, V - 1)); /* [B,S,V-1,3] */
    hg_tensor *edge0 = hg_sub(ctx, hg_slice(ctx, rest, 1, 1, V - 1), hg_slice(ctx, rest, 1, 0, V - 1)); /* [S,V-1,3] */
    hg_tensor *strain = hg_sub(ctx, hg_norm(ctx, edge), hg_norm(ctx, edge0)); /* broadcast over B */
    return hg_scale(ctx, hg_sum(ctx, hg_square(ctx, strain)), 0.5 * stiffness, 0);
}

/* The same by name: hairloss/stretch.c is the formula. */
static hg_tensor *stretch_traced(hg_ctx *ctx, hg_physics *physics, hg_tensor *x)
{
    const hg_frame frame = { .dt = 1.0 / 30.0 };
    return hg_physics_energy(physics, ctx, &frame, x, NULL);
}

static int failed(void)
{
    fprintf(stderr, "%s\n", hg_message());
    return 1;
}

int main(void)
{
    hg_ctx *ctx;
    hg_physics *physics;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1, .seed = 1 }) != HG_OK) return failed();

    double rest[S * V * 3], moved[B * S * V * 3], by_ops[B * S * V * 3];
    for (int i = 0; i < S * V * 3; i++)
        rest[i] = (i % 3 == 1 ? -0.004 * (i / 3 % V) : 0) + 5e-4 * hg_random_normal(1, 0, (uint64_t)i);
    for (int i = 0; i < B * S * V * 3; i++)
        moved[i] = rest[i % (S * V * 3)] + 5e-4 * hg_random_normal(1, 1, (uint64_t)i);

    const hg_groom_data groom = { .grooms = 1, .strands = S, .vertices = V, .rest = rest };
    const hg_term term = { hg_energy_find("stretch"), 1, &stiffness, NULL };
    if (hg_physics_create(&physics, ctx, HG_F64, &term, 1, &groom) != HG_OK) return failed();

    hg_tensor *x = hg_tensor_make(ctx, HG_F64, 4, (int64_t[]){ B, S, V, 3 });
    hg_tensor *at_rest = hg_tensor_make(ctx, HG_F64, 3, (int64_t[]){ S, V, 3 });
    hg_tensor_write(x, moved);
    hg_tensor_write(at_rest, rest);
    hg_require_grad(x);

    hg_tensor *ops = stretch_of_ops(ctx, x, at_rest);
    if (hg_backward(ctx, ops) != HG_OK) return failed();
    hg_tensor_read(hg_grad(x), by_ops); /* the next backward starts from zero */

    hg_tensor *traced = stretch_traced(ctx, physics, x);
    if (hg_backward(ctx, traced) != HG_OK) return failed();

    double difference = 0, largest = 0;
    for (int i = 0; i < B * S * V * 3; i++) {
        difference = fmax(difference, fabs(by_ops[i] - hg_tensor_item(hg_grad(x), i)));
        largest = fmax(largest, fabs(by_ops[i]));
    }
    const double value = fabs(hg_tensor_item(ops, 0) - hg_tensor_item(traced, 0)) / hg_tensor_item(ops, 0);
    printf("ops     %.9e J in %d calls on the tape\n", hg_tensor_item(ops, 0), hg_tape_count(ctx) - 1);
    printf("traced  %.9e J in 1 call\n", hg_tensor_item(traced, 0));
    printf("values %s, gradients %s (to 1e-12)\n", value < 1e-12 ? "agree" : "DIFFER",
           difference < 1e-12 * largest ? "agree" : "DIFFER");

    hg_physics_destroy(physics);
    hg_ctx_destroy(ctx);
    return !(value < 1e-12 && difference < 1e-12 * largest);
}
