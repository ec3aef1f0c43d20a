/* Torsion spring of the mass-spring model: holds the distance of every third vertex, and so the turn of the bend.
 *
 *     E = k/2 (|x_{i+3} - x_i| - l0)^2,  l0 = |rest_{i+3} - rest_i|
 *
 * The mass-spring ablation of Stuyck et al. 2025 (Quaffure); Herrera et al. 2025 (AMS). It cannot tell a strand from its
 * mirror image. The gradient of two vertices in one place is zero. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar spring_torsion(void)
{
    scalar l = norm(sub(x(3), x(0)));
    scalar l0 = norm(sub(rest(3), rest(0)));
    return mul(0.5, param("stiffness"), square(sub(l, l0)));
}

HG_ENERGY(spring_torsion, .equation = "k/2 (|x_{i+3} - x_i| - l0)^2 per three edges",
          .source = "Quaffure, mass-spring ablation; AMS", .site = window(4),
          .params = { { "stiffness", 0.5, "N/m", "spring across three edges, per hair" } }, .zero_at_rest = true,
          .rigid_invariant = true);
