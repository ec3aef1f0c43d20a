/* 02 * An energy of one's own: written once, differentiated and checked by the library.
 *
 *     cc -std=gnu11 02_energy.c $(pkg-config --cflags --libs hairgrad) -lm && ./a.out
 *
 * The function is called once and records the formula of ONE site, here of a vertex: tips that rise above their roots cost
 * energy. Nobody writes a gradient. HG_ENERGY makes it known by name: in this program, or, compiled as a shared object, in
 * `hairgrad --plugin ./it.so gradcheck tip_height` and in every config. */
#include "hairgrad.h"

#include <stdio.h>

#include "autograd/trace/names.h" /* the short names of formulas: last */

/* k/2 max(y - y_root - clearance, 0)^2 per vertex */
static scalar tip_height(void)
{
    scalar rise = sub(x(0).y, add(root_x(0).y, param("clearance")));
    return mul(0.5, param("stiffness"), square(max(rise, 0)));
}

HG_ENERGY(tip_height, .equation = "k/2 max(y - y_root - c, 0)^2 per vertex", .source = "example 02", .site = window(1),
          .params = { { "stiffness", 2, "N/m", "of the spring that pulls down" },
                      { "clearance", 0.001, "m", "height above the root that costs nothing" } });

enum { B = 1, S = 2, V = 4 }; /* frames, strands, vertices of a strand: root first */

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

    /* One strand hangs, the other one stands: 1 cm edges, metres, +Y up. */
    double rest[S * V * 3] = { 0 };
    for (int s = 0; s < S; s++)
        for (int v = 0; v < V; v++) {
            rest[(s * V + v) * 3] = 0.05 * s;
            rest[(s * V + v) * 3 + 1] = (s == 0 ? -0.01 : 0.01) * v;
        }
    const hg_groom_data groom = { .grooms = 1, .strands = S, .vertices = V, .rest = rest };
    const hg_term term = { .energy = hg_energy_find("tip_height"), .weight = 1 };
    if (hg_physics_create(&physics, ctx, HG_F64, &term, 1, &groom) != HG_OK) return failed();

    hg_tensor *at = hg_tensor_make(ctx, HG_F64, 4, (int64_t[]){ B, S, V, 3 });
    hg_tensor_write(at, rest);
    hg_require_grad(at);
    const hg_frame frame = { .dt = 1.0 / 30.0 };
    hg_tensor *energy = hg_physics_energy(physics, ctx, &frame, at, NULL);
    if (hg_backward(ctx, energy) != HG_OK) return failed();

    printf("energy %.6g J\n", hg_tensor_item(energy, 0));
    for (int s = 0; s < S; s++)
        for (int v = 0; v < V; v++)
            printf("  strand %d vertex %d   y %6.3f m   dE/dy %6.3f N\n", s, v, rest[(s * V + v) * 3 + 1],
                   hg_tensor_item(hg_grad(at), (s * V + v) * 3 + 1));
    hg_physics_destroy(physics);

    /* Against finite differences, on strands that the library makes up. */
    if (hg_energy_gradcheck(ctx, hg_energy_find("tip_height"), NULL, NULL, NULL, NULL, NULL) != HG_OK) return failed();
    printf("gradcheck: right to 1e-6\n");
    hg_ctx_destroy(ctx);
    return 0;
}
