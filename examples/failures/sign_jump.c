/* A loss that jumps: q and -q are the same rotation.
 *
 *     cc -std=gnu11 sign_jump.c $(pkg-config --cflags --libs hairgrad) -lm && ./a.out
 *
 * bend_twist compares the quaternion r between two edges with r0, that at rest. As published it takes the difference of
 * their imaginary parts, with the sign of r for which r.r0 >= 0. Where r.r0 goes through zero, half a turn from rest, the
 * sign flips: for a rest pair that is bent, the difference changes at once, and the energy with it. A finite difference
 * across such a point is nonsense, and an optimiser that steps over it sees its loss jump.
 *
 * strain: smooth is 4k/l' (1 - |r.r0|): the same for small strains, and continuous everywhere. */
#include "hairgrad.h"

#include <math.h>
#include <stdio.h>

enum { V = 3 };
static const double edge = 0.004, stiffness = 1e-8, degree = 0.017453292519943295;

/* Two edges: down, then turned by `angle` in the plane. */
static void bent(double angle, double p[V * 3])
{
    for (int i = 0; i < V * 3; i++) p[i] = 0;
    p[4] = -edge;
    p[6] = edge * sin(angle);
    p[7] = -edge - edge * cos(angle);
}

/* Energy and derivative by the angle of a strand whose rest angle is 90 degrees. */
static int evaluate(hg_ctx *ctx, const char *strain, double angle, double *value, double *slope)
{
    hg_physics *physics;
    double rest[V * 3];
    bent(90 * degree, rest);
    const hg_groom_data groom = { .grooms = 1, .strands = 1, .vertices = V, .rest = rest };
    const hg_term term = { hg_energy_find("bend_twist"), 1, &stiffness, (const char *[]){ strain, "free" } };
    if (hg_physics_create(&physics, ctx, HG_F64, &term, 1, &groom) != HG_OK) return 1;
    hg_tensor *x = hg_tensor_make(ctx, HG_F64, 4, (int64_t[]){ 1, 1, V, 3 });
    bent(angle, x->data);
    hg_require_grad(x);
    const hg_frame frame = { .dt = 1.0 / 30.0 };
    const hg_status status = hg_backward(ctx, hg_physics_energy(physics, ctx, &frame, x, value));
    if (status == HG_OK) /* chain rule: the last vertex moves along (cos, sin) * edge */
        *slope = edge * (cos(angle) * hg_tensor_item(hg_grad(x), 6) + sin(angle) * hg_tensor_item(hg_grad(x), 7));
    hg_physics_destroy(physics);
    hg_step_reset(ctx);
    return status != HG_OK;
}

int main(void)
{
    hg_ctx *ctx;
    const double angles[] = { 90, 60, 0, -60, -85, -89.9, -90.1, -95, -120 };
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1 }) != HG_OK) return 1;
    printf("  angle     published                  smooth\n");
    for (size_t i = 0; i < sizeof angles / sizeof *angles; i++) {
        double value[2], slope[2];
        if (evaluate(ctx, "published", angles[i] * degree, &value[0], &slope[0]) ||
            evaluate(ctx, "smooth", angles[i] * degree, &value[1], &slope[1])) {
            fprintf(stderr, "%s\n", hg_message());
            return 1;
        }
        printf("  %5.1f   %7.3f uJ %7.3f uJ/rad   %7.3f uJ %7.3f uJ/rad\n", angles[i], 1e6 * value[0], 1e6 * slope[0],
               1e6 * value[1], 1e6 * slope[1]);
    }
    hg_ctx_destroy(ctx);
    return 0;
}
