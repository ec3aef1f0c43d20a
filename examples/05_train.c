/* 05 * A small network, trained with no data: only the energy of what it says.
 *
 *     cc -std=gnu11 05_train.c $(pkg-config --cflags --libs hairgrad) -lm && ./a.out
 *
 * The network sees how far the head is tilted, as cosine and sine, and turns the edges of a strand. No step is ever
 * shown a simulated strand; the loss is the energy of the strand that comes out. That is how `hairgrad train` works, with
 * a body, motion and thousands of strands. */
#include "hairgrad.h"

#include <math.h>
#include <stdio.h>

enum { B = 16, V = 12, width = 24, steps = 600 };
static const double edge = 0.005, mass = 1e-6, half_pi = 1.5707963267948966;

typedef struct {
    hg_linear_layer layers[3];
    hg_tensor *params[6];
} network;

static int failed(void)
{
    fprintf(stderr, "%s\n", hg_message());
    return 1;
}

/* The strand points along +X at rest; the head turns it up by an angle about +Z. */
static void draw_frames(hg_tensor *input, hg_tensor *rotation, int step)
{
    float *in = input->data, *q = rotation->data;
    for (int b = 0; b < B; b++) {
        const double angle =
            step < 0 ? (b + 0.5) / B * half_pi : hg_random_uniform(3, (uint64_t)step, (uint64_t)b) * half_pi;
        in[2 * b] = (float)cos(angle);
        in[2 * b + 1] = (float)sin(angle);
        q[4 * b] = (float)cos(angle / 2);
        q[4 * b + 1] = q[4 * b + 2] = 0;
        q[4 * b + 3] = (float)sin(angle / 2);
    }
}

/* Strands [B,1,V,3]: turned edges, then placed in the world. */
static hg_tensor *strands(const network *net, hg_ctx *ctx, hg_tensor *input, hg_tensor *rest, hg_tensor *rotation,
                          hg_tensor *position)
{
    hg_tensor *h = hg_linear_layer_forward(&net->layers[0], ctx, input, HG_TANH);
    h = hg_linear_layer_forward(&net->layers[1], ctx, h, HG_TANH);
    h = hg_linear_layer_forward(&net->layers[2], ctx, h, HG_IDENTITY);
    hg_tensor *turns = hg_reshape(ctx, h, 4, (int64_t[]){ B, 1, V - 2, 3 }); /* the root edge stays */
    return hg_place(ctx, hg_turn_edges(ctx, turns, rest), rest, rotation, position);
}

int main(void)
{
    hg_ctx *ctx;
    hg_physics *physics;
    hg_adam *adam;
    network net;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1, .seed = 1 }) != HG_OK) return failed();

    const int sizes[4] = { 2, width, width, (V - 2) * 3 };
    for (int i = 0; i < 3; i++) { /* the last layer starts at zero: training begins at the rigid strand */
        if (hg_linear_layer_create(&net.layers[i], ctx, sizes[i], sizes[i + 1], i < 2 ? HG_INIT_XAVIER : HG_INIT_ZERO,
                                   (uint64_t)i, "layer") != HG_OK)
            return failed();
        net.params[2 * i] = net.layers[i].weight;
        net.params[2 * i + 1] = net.layers[i].bias;
    }
    if (hg_adam_create(&adam, ctx, 6, net.params) != HG_OK) return failed();

    double at_rest[V * 3] = { 0 }, masses[V];
    for (int v = 0; v < V; v++) at_rest[3 * v] = edge * v, masses[v] = mass;
    const hg_groom_data groom = { .grooms = 1, .strands = 1, .vertices = V, .rest = at_rest, .mass = masses };
    const hg_term terms[] = {
        { hg_energy_find("bend_twist"), 1, (double[]){ 4e-8 }, (const char *[]){ "smooth", "clamped" } },
        { hg_energy_find("gravity"), 1, NULL, NULL },
    };
    if (hg_physics_create(&physics, ctx, HG_F32, terms, 2, &groom) != HG_OK) return failed();

    const double unit = B * V * mass * 9.81 * edge * V; /* gradients of order one suit f32 and Adam */
    for (int step = 0; step <= steps; step++) {
        hg_step_reset(ctx);
        hg_tensor *input = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ B, 2 }),
                  *rest = hg_tensor_make(ctx, HG_F32, 3, (int64_t[]){ 1, V, 3 }),
                  *rotation = hg_tensor_make(ctx, HG_F32, 3, (int64_t[]){ B, 1, 4 }),
                  *position = hg_tensor_make(ctx, HG_F32, 3, (int64_t[]){ B, 1, 3 });
        for (int i = 0; i < V * 3; i++) ((float *)rest->data)[i] = (float)at_rest[i];
        hg_tensor_fill(position, 0);
        draw_frames(input, rotation,
                    step % 100 == 0 ? -1 : step); /* every hundredth: angles spread evenly, to be shown */
        const hg_frame frame = { .root_rotation = rotation, .root_position = position, .dt = 1.0 / 30.0 };
        hg_tensor *x = strands(&net, ctx, input, rest, rotation, position);
        hg_tensor *loss = hg_scale(ctx, hg_physics_energy(physics, ctx, &frame, x, NULL), 1 / unit, 0);
        if (hg_backward(ctx, loss) != HG_OK) return failed();
        const int64_t tip = 3 * V - 2; /* y of the last vertex of frame 0, where the head is nearly upright */
        if (step % 200 == 0)
            printf("step %3d   loss %7.4f   tip of frame 0 %7.4f m, of frame %d %7.4f m\n", step,
                   hg_tensor_item(loss, 0), hg_tensor_item(x, tip), B - 1, hg_tensor_item(x, (B - 1) * 3 * V + tip));
        double norm;
        if (hg_adam_step(adam, 1e-2 * (1 - 0.95 * step / steps), 0.9, 0.999, 1e-8, 0, 1, &norm) != HG_OK)
            return failed();
    }
    for (int i = 0; i < 3; i++) hg_linear_layer_destroy(&net.layers[i]);
    hg_adam_destroy(adam);
    hg_physics_destroy(physics);
    hg_ctx_destroy(ctx);
    return 0;
}
