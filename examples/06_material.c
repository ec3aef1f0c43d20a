/* 06 * A material from a drape: which bending stiffness makes hair hang like that?
 *
 *     cc -std=gnu11 06_material.c $(pkg-config --cflags --libs hairgrad) -lm && ./a.out
 *
 * Given are hairs x* that hang still, their rest shape and their weight; sought is k. A drape is a minimum of the energy, so
 * for the right k no strand has less energy than the observed one:
 *
 *     L(k) = E(x*, k) - min over x of E(x, k)  >=  0, and 0 for the k that x* hangs by
 *
 * dL/dk needs no derivative of the minimum: E does not change to first order when x does there, so dL/dk = dE/dk(x*, k) -
 * dE/dk(x(k), k), and both stand on the tape when k is a tensor of the frame. E is linear in k: L is convex, and has one
 * minimum. Strands are edges that turn (hg_turn_edges), so that nothing stretches. */
#include "hairgrad.h"

#include <math.h>
#include <stdio.h>

enum { S = 4, V = 16, outer = 60, inner = 100 };
static const double edge = 0.005, mass = 1e-6, true_stiffness = 3e-8; /* m; kg a vertex; N m^2 */

typedef struct {
    hg_ctx *ctx;
    hg_physics *physics;
    hg_tensor *rest;  /* [S,V,3] */
    hg_tensor *turns; /* [1,S,V-2,3] how edges are turned; the root edge is clamped */
    hg_adam *adam;    /* of the turns */
} scene;

/* E(x, k), k a tensor. */
static hg_tensor *energy(const scene *of, hg_tensor *x, hg_tensor *k)
{
    const hg_frame_input inputs[] = { { "bend_twist.stiffness", k } };
    const hg_frame frame = { .dt = 1.0 / 30.0, .inputs = inputs, .n_inputs = 1 };
    return hg_physics_energy(of->physics, of->ctx, &frame, x, NULL);
}

/* Turned edges, placed at the roots: [1,S,V,3]. */
static hg_tensor *strands(const scene *of)
{
    hg_tensor *rotation = hg_tensor_make(of->ctx, HG_F32, 3, (int64_t[]){ 1, S, 4 }),
              *position = hg_tensor_make(of->ctx, HG_F32, 3, (int64_t[]){ 1, S, 3 });
    for (int s = 0; s < S; s++)
        for (int c = 0; c < 4; c++) ((float *)rotation->data)[4 * s + c] = c == 0;
    for (int s = 0; s < S; s++)
        for (int c = 0; c < 3; c++) ((float *)position->data)[3 * s + c] = ((float *)of->rest->data)[s * V * 3 + c];
    return hg_place(of->ctx, hg_turn_edges(of->ctx, of->turns, of->rest), of->rest, rotation, position);
}

/* Goes on minimising E(x, k) by x; `rate` is an angle. */
static hg_status settle(const scene *of, double k, int steps, double rate)
{
    const double unit = S * V * mass * 9.81 * edge * V; /* gradients of order one suit f32 */
    for (int i = 0; i < steps; i++) {
        hg_step_reset(of->ctx);
        hg_tensor *stiffness = hg_tensor_make(of->ctx, HG_F32, 0, NULL);
        hg_tensor_fill(stiffness, k);
        HG_TRY(hg_backward(of->ctx, hg_scale(of->ctx, energy(of, strands(of), stiffness), 1 / unit, 0)));
        double norm;
        HG_TRY(hg_adam_step(of->adam, rate * pow(0.01, (double)i / steps), 0.9, 0.99, 1e-10, 0, 0, &norm));
    }
    return HG_OK;
}

/* The observed drape: strands with the true stiffness, come to rest. That is all that the fit gets to see of it. */
static hg_status observe(const scene *of, float *drape)
{
    HG_TRY(settle(of, true_stiffness, 1500, 0.05));
    hg_step_reset(of->ctx);
    HG_TRY(hg_tensor_read(strands(of), drape));
    return hg_tensor_fill(of->turns, 0);
}

/* log k on the tape, so that k stays positive. */
static hg_status fit(const scene *of, const float *drape, hg_tensor *log_k)
{
    hg_adam *adam;
    HG_TRY(hg_adam_create(&adam, of->ctx, 1, &log_k));
    hg_status status = settle(of, exp(hg_tensor_item(log_k, 0)), 800, 0.05);
    for (int i = 0; i <= outer && status == HG_OK; i++) {
        const double k = exp(hg_tensor_item(log_k, 0));
        if (i % 15 == 0) printf("step %2d   stiffness %.2e N m^2, %+.1f %%\n", i, k, 100 * (k / true_stiffness - 1));
        status = settle(of, k, inner, 0.02);
        hg_step_reset(of->ctx);
        hg_tensor *observed = hg_tensor_make(of->ctx, HG_F32, 4, (int64_t[]){ 1, S, V, 3 });
        hg_tensor_write(observed, drape);
        hg_tensor *stiffness = hg_exp(of->ctx, log_k);
        hg_tensor *gap =
            hg_sub(of->ctx, energy(of, observed, stiffness), energy(of, hg_detach(of->ctx, strands(of)), stiffness));
        double norm;
        if (status == HG_OK) status = hg_backward(of->ctx, hg_scale(of->ctx, gap, 1e9, 0)); /* nJ */
        if (status == HG_OK)
            status = hg_adam_step(adam, 0.3 * pow(0.03, (double)i * i / outer / outer), 0.5, 0.8, 1e-8, 0, 0, &norm);
    }
    hg_adam_destroy(adam);
    return status;
}

int main(void)
{
    scene of = { 0 };
    hg_status status = hg_ctx_create(&of.ctx, &(hg_ctx_options){ .threads = 1, .seed = 1 });
    if (status != HG_OK) return 1;

    double rest[S * V * 3] = { 0 }, masses[S * V];
    float drape[S * V * 3];
    for (int i = 0; i < S * V; i++) { /* strands that leave their roots at different angles */
        const double angle = 0.3 * (i / V) - 0.2;
        rest[3 * i] = edge * cos(angle) * (i % V);
        rest[3 * i + 1] = edge * sin(angle) * (i % V);
        rest[3 * i + 2] = 0.01 * (i / V);
        masses[i] = mass;
    }
    const hg_groom_data groom = { .grooms = 1, .strands = S, .vertices = V, .rest = rest, .mass = masses };
    const hg_term terms[] = {
        { hg_energy_find("bend_twist"), 1, NULL, (const char *[]){ "smooth", "clamped" } },
        { hg_energy_find("gravity"), 1, NULL, NULL },
    };
    status = hg_physics_create(&of.physics, of.ctx, HG_F32, terms, 2, &groom);
    of.rest = hg_tensor_create(of.ctx, HG_F32, 3, (int64_t[]){ S, V, 3 });
    of.turns = hg_tensor_create(of.ctx, HG_F32, 4, (int64_t[]){ 1, S, V - 2, 3 });
    hg_tensor *log_k = hg_tensor_create(of.ctx, HG_F32, 0, NULL);
    for (int i = 0; i < S * V * 3; i++) ((float *)of.rest->data)[i] = (float)rest[i];
    hg_tensor_fill(log_k, log(3e-7)); /* ten times too stiff */
    hg_require_grad(of.turns);
    hg_require_grad(log_k);
    if (status == HG_OK) status = hg_adam_create(&of.adam, of.ctx, 1, &of.turns);
    if (status == HG_OK) status = observe(&of, drape);
    if (status == HG_OK) status = fit(&of, drape, log_k);
    const double error = exp(hg_tensor_item(log_k, 0)) / true_stiffness - 1;
    if (status == HG_OK) printf("recovered to %s 2 %%\n", fabs(error) < 0.02 ? "within" : "WORSE THAN");
    if (status != HG_OK) fprintf(stderr, "%s\n", hg_message());

    hg_adam_destroy(of.adam);
    hg_tensor_destroy(log_k);
    hg_tensor_destroy(of.turns);
    hg_tensor_destroy(of.rest);
    hg_physics_destroy(of.physics);
    hg_ctx_destroy(of.ctx);
    return status != HG_OK || fabs(error) >= 0.02;
}
