/* Bend spring of the mass-spring model: holds the distance of every second vertex, and so the bend between two edges.
 *
 *     E = k/2 (|x_{i+2} - x_i| - l0)^2,  l0 = |rest_{i+2} - rest_i|
 *
 * The mass-spring ablation of Stuyck et al. 2025 (Quaffure); Herrera et al. 2025 (AMS). Where the rest hair is straight it
 * resists only to second order. The gradient of two vertices in one place is zero. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar spring_bend(void)
{
    scalar l = norm(sub(x(2), x(0)));
    scalar l0 = norm(sub(rest(2), rest(0)));
    return mul(0.5, param("stiffness"), square(sub(l, l0)));
}

HG_ENERGY(spring_bend, .equation = "k/2 (|x_{i+2} - x_i| - l0)^2 per edge pair",
          .source = "Quaffure, mass-spring ablation; AMS", .site = window(3),
          .params = { { "stiffness", 0.5, "N/m", "spring across an edge pair, per hair" } }, .zero_at_rest = true,
          .rigid_invariant = true);
