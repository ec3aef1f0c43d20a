/* Hair style: hair near the skin keeps its style.
 *
 *     E = k (1 - min(1, s/s_max)) |x - x_posed|^2 per vertex
 *
 * Lin et al. 2025 (Neuralocks), eq. 7; there s is the distance of the current vertex to the body, here that of the rest
 * vertex, at least 0. surface: scalp measures to the scalp only, since hair that rests on the shoulders must not be glued
 * to them. x_posed is the rigidly posed groom. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar hair_style(void)
{
    scalar s = max(attribute(option("surface", "scalp") ? "scalp_distance" : "body_distance", 0), 0);
    scalar nearness = sub(1, min(1, divide(s, param("s_max"))));
    return mul(param("stiffness"), nearness, square(sub(x(0), posed(0))));
}

HG_ENERGY(hair_style, .equation = "k (1 - min(1, s/s_max)) |x - x_posed|^2 per vertex", .source = "Neuralocks eq. 7",
          .site = window(1),
          .params = { { "stiffness", 0.005, "N/m", "spring to the posed vertex, per hair" },
                      { "s_max", 8e-3, "m", "distance from the skin where it ends" } },
          .options = { { "surface", "body|scalp", "body", "distance to the whole body, or to the scalp only" } },
          .zero_at_rest = true, .rigid_invariant = true);
