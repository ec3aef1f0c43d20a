/* Adhesion: hairs that lie together at rest stay together.
 *
 *     E = k |x_i - x_j|^2                          rest_length: false, as published
 *     E = k (|x_i - x_j| - |x_i - x_j|_rest)^2     rest_length: true, which does not pull the groom together
 *
 * over the pairs (i, j) where j is one of the up to `count` vertices of other strands that are nearest to i within
 * `radius` in the rest groom.
 *
 * Source: Neuralocks eq. 8. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar adhesion(void)
{
    if (option("rest_length", "true")) return mul(param("stiffness"), square(sub(distance(), rest_distance())));
    return mul(param("stiffness"), square(distance()));
}

HG_ENERGY(adhesion, .equation = "k |x_i - x_j|^2, or k (|x_i - x_j| - d_rest)^2", .source = "Neuralocks eq. 8",
          .site = { HG_SITE_PAIRS, 2 },
          .params = { { "stiffness", 1e-6, "N/m", "of one pair" },
                      { "radius", 0.003, "m", "within which pairs are made at rest" },
                      { "count", 5, "1", "at most so many pairs from each vertex" } },
          .options = { { "rest_length", "false|true", "false", "measure from the distance at rest" } },
          .rigid_invariant = true);
