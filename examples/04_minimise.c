/* 04 * A strand comes to rest under gravity: the same energies, minimised directly.
 *
 *     cc -std=gnu11 04_minimise.c $(pkg-config --cflags --libs hairgrad) -lm && ./a.out
 *
 * Nothing but a loss that is minimised: the positions are the weights, Adam is the solver. The strand leaves its root
 * horizontally and is clamped there; stretching, bending and weight find their balance. */
#include "hairgrad.h"

#include <math.h>
#include <stdio.h>

enum { V = 16, steps = 3000 };
static const double edge = 0.005, mass = 1e-6; /* m; kg a vertex: thick hair, so that it shows */

static int failed(void)
{
    fprintf(stderr, "%s\n", hg_message());
    return 1;
}

int main(void)
{
    hg_ctx *ctx;
    hg_physics *physics;
    hg_adam *adam;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1, .seed = 1 }) != HG_OK) return failed();

    double rest[V * 3] = { 0 }, masses[V];
    for (int v = 0; v < V; v++) rest[3 * v] = edge * v, masses[v] = mass;
    const hg_groom_data groom = { .grooms = 1, .strands = 1, .vertices = V, .rest = rest, .mass = masses };
    const hg_term terms[] = {
        { hg_energy_find("stretch"), 1, (double[]){ 2 }, NULL },
        { hg_energy_find("bend_twist"), 1, (double[]){ 4e-8 }, (const char *[]){ "smooth", "clamped" } },
        { hg_energy_find("gravity"), 1, NULL, NULL },
    };
    if (hg_physics_create(&physics, ctx, HG_F32, terms, 3, &groom) != HG_OK) return failed();

    /* Owned by us, so that it outlives the steps. */
    hg_tensor *x = hg_tensor_create(ctx, HG_F32, 4, (int64_t[]){ 1, 1, V, 3 }); /* Adam steps f32 */
    for (int i = 0; i < 3 * V; i++) ((float *)x->data)[i] = (float)rest[i];
    hg_require_grad(x);
    if (hg_adam_create(&adam, ctx, 1, &x) != HG_OK) return failed();

    const hg_frame frame = { .dt = 1.0 / 30.0 };
    double unweighted[3];
    for (int step = 0; step <= steps; step++) {
        hg_step_reset(ctx);
        hg_tensor *energy = hg_physics_energy(physics, ctx, &frame, x, unweighted);
        if (hg_backward(ctx, energy) != HG_OK) return failed();
        float *force = hg_grad(x)->data;
        for (int c = 0; c < 3; c++) force[c] = 0; /* the root is held */
        if (step % 1000 == 0)
            printf("step %4d   energy %8.4f uJ   tip (%.4f, %.4f) m\n", step, 1e6 * hg_tensor_item(energy, 0),
                   hg_tensor_item(x, 3 * V - 3), hg_tensor_item(x, 3 * V - 2));
        /* The learning rate is a length here: it comes down from half a millimetre to a micrometre. */
        const double rate = 5e-4 * pow(2e-3, (double)step / steps);
        double norm;
        if (hg_adam_step(adam, rate, 0.9, 0.999, 1e-16, 0, 0, &norm) != HG_OK) return failed();
    }
    double length = 0;
    for (int v = 3; v < 3 * V; v += 3) {
        double square = 0;
        for (int c = 0; c < 3; c++) square += pow(hg_tensor_item(x, v + c) - hg_tensor_item(x, v - 3 + c), 2);
        length += sqrt(square);
    }
    printf("stretch %.4f  bend_twist %.4f  gravity %.4f uJ; it is %.2f %% longer than at rest\n", 1e6 * unweighted[0],
           1e6 * unweighted[1], 1e6 * unweighted[2], 100 * (length / (edge * (V - 1)) - 1));

    hg_adam_destroy(adam);
    hg_tensor_destroy(x);
    hg_physics_destroy(physics);
    hg_ctx_destroy(ctx);
    return 0;
}
