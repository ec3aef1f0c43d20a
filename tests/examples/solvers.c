/* The example of solvers/solvers.h, compiled; tests/test_solve.c and tests/test_fit_material.c run what it calls. */
#include "solvers/solvers.h"

hg_status run(hg_ctx *ctx, hg_physics *physics, const hg_term *terms, int n_terms, hg_groom_data groom_data,
              hg_frame frame, hg_tensor *x);

hg_status run(hg_ctx *ctx, hg_physics *physics, const hg_term *terms, int n_terms, hg_groom_data groom_data,
              hg_frame frame, hg_tensor *x)
{
    const int64_t frames = x->shape[0], strands = x->shape[1], vertices = x->shape[2];
    hg_minimiser *minimiser;
    hg_solution solution;
    hg_material_fit fit;
#include "example.inc"
    return there && stiffness > 0 ? hg_ctx_status(ctx) : HG_NUMERIC;
}

int main(void) { return 0; }
