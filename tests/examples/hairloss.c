/* The example of hairloss/hairloss.h, run on two strands that hang and are pulled. */
#include "hairloss/hairloss.h"

#include <stdio.h>

int main(void)
{
    enum { B = 1, S = 2, V = 3 };
    hg_ctx *ctx;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1 }) != HG_OK) return 1;
    double rest[S * V * 3] = { 0 }, unweighted[2];
    for (int s = 0; s < S; s++)
        for (int v = 0; v < V; v++) rest[(s * V + v) * 3] = 0.1 * s, rest[(s * V + v) * 3 + 1] = -0.01 * v;
    hg_groom_data groom_data = { .grooms = 1, .strands = S, .vertices = V, .rest = rest };
    hg_frame frame = { .dt = 1.0 / 30.0 };
    hg_tensor *x = hg_tensor_make(ctx, HG_F32, 4, (int64_t[]){ B, S, V, 3 });
    for (int i = 0; i < S * V * 3; i++) ((float *)x->data)[i] = 1.1f * (float)rest[i];
    hg_require_grad(x);
    hg_physics *physics;
#include "example.inc"
    int wrong = hg_ctx_status(ctx) != HG_OK || hg_grad(x) == NULL || !(unweighted[0] > 0.0);
    if (wrong) fprintf(stderr, "%s\n", hg_message());
    hg_physics_destroy(physics);
    hg_ctx_destroy(ctx);
    return wrong;
}
