/* The example of solvers/solvers.h, compiled; tests/test_fit_material.c runs it. */
#include "solvers/solvers.h"

hg_status run(hg_ctx *ctx, const hg_term *terms, int n_terms, hg_groom_data groom_data, hg_frame frame, hg_tensor *x);

hg_status run(hg_ctx *ctx, const hg_term *terms, int n_terms, hg_groom_data groom_data, hg_frame frame, hg_tensor *x)
{
    hg_material_fit fit;
#include "example.inc"
    return hg_ctx_status(ctx);
}

int main(void) { return 0; }
