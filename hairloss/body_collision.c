/* Body collision: a cubic barrier within a distance D of the body.
 *
 *     E = k max(D - d, 0)^3 per vertex
 *
 * Lin et al. 2025 (Neuralocks), eq. 4. d is the signed distance n.(x - a) to the contact that the body query found: the
 * plane of the closest triangle (mode: plane, as published) or the closest point itself, with the sign of the
 * angle-weighted normals (mode: exact). Contact is detached: only x is differentiated.
 *
 * rest_clearance: with the published D hair that rests on the scalp is pushed off it. D_v = min(D, max(d_rest, 0.5 mm))
 * is no larger than the distance that the vertex has at rest. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar body_collision(void)
{
    scalar clearance = param("distance");
    if (option("rest_clearance", "true")) clearance = min(clearance, max(attribute("body_distance", 0), 0.5e-3));
    scalar depth = max(sub(clearance, contact_distance(0)), 0);
    return mul(param("stiffness"), mul(square(depth), depth));
}

HG_ENERGY(body_collision, .equation = "k max(D - d, 0)^3 per vertex", .source = "Neuralocks eq. 4", .site = window(1),
          .params = { { "stiffness", 30, "J/m^3", "barrier" },
                      { "distance", 5e-3, "m", "D: where the barrier begins" } },
          .options = { { "mode", "plane|exact", "plane", "distance to the closest triangle's plane, or to the body" },
                       { "rest_clearance", "true|false", "false", "begin no farther out than the vertex rests" } },
          .contact = true, .zero_at_rest = true);
