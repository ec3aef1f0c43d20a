/* The example of autograd/trace/trace.h as an energy of a user's own: registered, found by name, its gradient checked. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

#include <stdio.h>

#define stretch stretch_of_the_example
#include "example.inc"
HG_ENERGY(stretch_of_the_example, .equation = "k/2 (l - l_rest)^2", .source = "Neuralocks eq. 2", .site = window(2),
          .params = { { "stiffness", 2.0, "N/m", "" } });

int main(void)
{
    hg_ctx *ctx;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1 }) != HG_OK) return 1;
    const hg_energy *energy = hg_energy_find("stretch_of_the_example");
    hg_status status = energy == NULL ? HG_INVALID : hg_energy_gradcheck(ctx, energy, NULL, NULL, NULL, NULL, NULL);
    if (status != HG_OK) fprintf(stderr, "%s\n", hg_message());
    hg_ctx_destroy(ctx);
    return status != HG_OK;
}
