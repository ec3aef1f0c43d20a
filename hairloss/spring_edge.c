/* Edge spring of the mass-spring model: holds the length of an edge.
 *
 *     E = k/2 (|x_{i+1} - x_i| - l0)^2,  l0 = |rest_{i+1} - rest_i|
 *
 * The mass-spring ablation of Stuyck et al. 2025 (Quaffure); Herrera et al. 2025 (AMS). The same as stretch; it has a name of
 * its own so that a mass-spring model reads as its three springs. The gradient of two vertices in one place is zero. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar spring_edge(void)
{
    scalar l = norm(sub(x(1), x(0)));
    scalar l0 = norm(sub(rest(1), rest(0)));
    return mul(0.5, param("stiffness"), square(sub(l, l0)));
}

HG_ENERGY(spring_edge, .equation = "k/2 (|x_{i+1} - x_i| - l0)^2 per edge",
          .source = "Quaffure, mass-spring ablation; AMS", .site = window(2),
          .params = { { "stiffness", 2, "N/m", "spring of an edge, per hair" } }, .zero_at_rest = true,
          .rigid_invariant = true);
