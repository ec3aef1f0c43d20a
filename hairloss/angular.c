/* Angular springs: every edge is drawn to where the ghost of its end is seen from its beginning.
 *
 *     E = k/2 theta^2 per edge,  theta = atan2(|a x b|, a.b),  a = y_{i+1} - x_i,  b = x_{i+1} - x_i
 *
 * Ours, in place of Herrera et al. 2025 (AMS), eq. 2, whose torque is not the gradient of an energy; k is in N m. y is the
 * array "ghost" of the frame. Both vectors are divided by the rest length of the edge, which does not change the angle and
 * keeps their squares within f32. The angle has no derivative at 0 and at pi: there the gradient is zero, as it is where a
 * or b is zero; its force grows as 1/|b| when an edge collapses. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar angular(void)
{
    scalar l0 = rest_length(rest(0), rest(1));
    vec3 a = divide(sub(frame_vec3("ghost", 1), x(0)), l0), b = divide(sub(x(1), x(0)), l0);
    scalar theta = atan2(norm(cross(a, b)), dot(a, b));
    return mul(0.5, param("stiffness"), square(theta));
}

HG_ENERGY(angular, .equation = "k/2 theta^2 per edge, theta between y_{i+1} - x_i and x_{i+1} - x_i",
          .source = "hairgrad, after AMS eq. 2", .site = window(2),
          .params = { { "stiffness", 1e-7, "N*m", "spring of an angle, per hair" } }, .zero_at_rest = true,
          .rigid_invariant = true);
