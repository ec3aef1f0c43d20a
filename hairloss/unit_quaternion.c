/* Unit quaternions: the free orientations of a Cosserat rod stay of length one.
 *
 *     E = k/2 (|q_i| - 1)^2 per edge
 *
 * Stuyck et al. 2025 (Quaffure), eq. 5. q [B,S,V-1,4] is brought as the frame's input "q". The gradient of a quaternion of
 * length zero is zero: which way it should grow is not known. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar unit_quaternion(void) { return mul(0.5, param("stiffness"), square(sub(norm(q(0)), 1))); }

HG_ENERGY(unit_quaternion, .equation = "k/2 (|q_i| - 1)^2 per edge", .source = "Quaffure eq. 5", .site = window(2),
          .params = { { "stiffness", 1e-5, "J", "of an edge, per hair" } });
