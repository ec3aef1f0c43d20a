/* Stretch: Hookean springs along the edges.
 *
 *     E = k/2 (l - l0)^2 per edge, l = |x_{i+1} - x_i|, l0 at rest
 *
 * Lin et al. 2025 (Neuralocks), eq. 2; Stuyck et al. 2025 (Quaffure), eq. 7. The gradient of an edge of length zero is
 * zero. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar stretch(void)
{
    scalar l = norm(sub(x(1), x(0)));
    scalar l0 = norm(sub(rest(1), rest(0)));
    return mul(0.5, param("stiffness"), square(sub(l, l0)));
}

HG_ENERGY(stretch, .equation = "k/2 (l - l0)^2 per edge", .source = "Neuralocks eq. 2, Quaffure eq. 7",
          .site = window(2), .params = { { "stiffness", 2, "N/m", "spring of an edge, per hair" } },
          .zero_at_rest = true, .rigid_invariant = true);
