/* A gradient that explodes: bending energies near antiparallel tangents.
 *
 *     cc -std=gnu11 exploding_bend.c $(pkg-config --cflags --libs hairgrad) -lm && ./a.out
 *
 * The curvature binormal of discrete elastic rods, 2 t0 x t1 / (1 + t0.t1), grows as tan of half the angle: where a network
 * folds an edge back onto the one before (and an untrained one does), value and gradient have no bound; exactly folded
 * back, they are 0/0. One such vertex in a batch of a million is a NaN loss.
 *
 * bend_twist measures the same angle by quaternions, whose imaginary part is bounded: the force even vanishes as the edge
 * folds back. Only the direction in which it is folded has no limit; within 0.01 rad of antiparallel the transport is
 * therefore guarded: its quaternion shrinks to zero there, value and force stay finite, and are wrong by intent. */
#include "hairgrad.h"

#include <math.h>
#include <stdio.h>

enum { V = 3 };
static const double edge = 0.004, stiffness = 1e-8; /* m, N m^2 */
static const double straight[V * 3] = { 0, 0, 0, 0, -0.004, 0, 0, -0.008, 0 };

/* Two edges, the second one folded back up to `angle` rad. */
static void fold(double angle, double *p)
{
    for (int i = 0; i < V * 3; i++) p[i] = straight[i];
    p[6] = edge * sin(angle);
    p[7] = -edge + edge * cos(angle);
}

/* "1.56e-05", or what is none. */
static const char *number(double value, char text[16])
{
    snprintf(text, 16, isfinite(value) ? "%9.2e" : " infinite", value);
    return text;
}

#include "autograd/trace/names.h"

/* k/2 l' |kappa|^2 with kappa = 2/l' t0 x t1 / (1 + t0.t1): nothing guarded. */
static scalar curvature_binormal(void)
{
    vec3 e0 = sub(x(1), x(0)), e1 = sub(x(2), x(1));
    vec3 t0 = divide(e0, norm(e0)), t1 = divide(e1, norm(e1));
    vec3 bend = divide(cross(t0, t1), add(1, dot(t0, t1)));
    scalar length = mul(0.5, add(norm(sub(rest(1), rest(0))), norm(sub(rest(2), rest(1)))));
    return mul(2, param("stiffness"), divide(square(bend), length));
}

HG_ENERGY(curvature_binormal, .equation = "2k/l' |t0 x t1|^2 / (1 + t0.t1)^2 per edge pair", .source = "a demo",
          .site = window(3), .params = { { "stiffness", 1e-8, "N m^2", "bending" } });

/* Value, and largest force on a vertex. */
static int evaluate(hg_ctx *ctx, const char *energy, double angle, double *value, double *force)
{
    hg_physics *physics;
    const hg_groom_data groom = { .grooms = 1, .strands = 1, .vertices = V, .rest = straight };
    const hg_term term = { hg_energy_find(energy), 1, &stiffness, NULL };
    if (hg_physics_create(&physics, ctx, HG_F64, &term, 1, &groom) != HG_OK) return 1;
    hg_tensor *at = hg_tensor_make(ctx, HG_F64, 4, (int64_t[]){ 1, 1, V, 3 });
    fold(angle, at->data);
    hg_require_grad(at);
    const hg_frame frame = { .dt = 1.0 / 30.0 };
    const hg_status status = hg_backward(ctx, hg_physics_energy(physics, ctx, &frame, at, value));
    *force = 0;
    for (int i = 0; status == HG_OK && i < V * 3; i++) {
        const double f = hg_tensor_item(hg_grad(at), i);
        if (!(fabs(f) <= *force)) *force = fabs(f);
    }
    hg_physics_destroy(physics);
    hg_step_reset(ctx);
    return status != HG_OK;
}

int main(void)
{
    hg_ctx *ctx;
    const double angles[] = { 1, 0.1, 0.03, 0.02, 1e-3, 1e-4, 0 };
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1 }) != HG_OK) return 1;
    printf("from folded back   curvature binormal        bend_twist\n");
    for (size_t i = 0; i < sizeof angles / sizeof *angles; i++) {
        double value[2], force[2];
        if (evaluate(ctx, "curvature_binormal", angles[i], &value[0], &force[0]) ||
            evaluate(ctx, "bend_twist", angles[i], &value[1], &force[1])) {
            fprintf(stderr, "%s\n", hg_message());
            return 1;
        }
        char text[4][16];
        printf("  %7g rad      %s J %s N   %s J %s N\n", angles[i], number(value[0], text[0]),
               number(force[0], text[1]), number(value[1], text[2]), number(force[1], text[3]));
    }
    hg_ctx_destroy(ctx);
    return 0;
}
