/* Shear: an edge keeps the direction and the length that the head has turned it to.
 *
 *     E = k/2 |(x_{i+1} - x_i) / l0 - d3|^2 per edge,  d3 = (y_{i+1} - y_i) / |y_{i+1} - y_i|
 *
 * Stuyck et al. 2025 (Quaffure), eq. 6. y is the rigidly posed groom: frame.posed where it is given, else the rest groom
 * moved by root_rotation and root_position. l0 is the rest length, at least 1e-6 m. An edge of length zero at rest has
 * d3 = 0 and is pulled together; one of length zero now has a finite gradient, since nothing is divided by its length. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar shear(void)
{
    scalar l0 = rest_length(rest(0), rest(1));
    vec3 strain = sub(divide(sub(x(1), x(0)), l0), tangent(posed(0), posed(1), l0));
    return mul(0.5, param("stiffness"), square(strain));
}

HG_ENERGY(shear, .equation = "k/2 |(x_{i+1} - x_i)/l0 - d3|^2 per edge", .source = "Quaffure eq. 6", .site = window(2),
          .params = { { "stiffness", 1e-7, "J",
                        "of an edge, per hair; holds 10 cm about as hard as gravity bends it" } },
          .zero_at_rest = true, .rigid_invariant = true);
