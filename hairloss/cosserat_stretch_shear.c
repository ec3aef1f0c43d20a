/* Stretch and shear of a Cosserat rod: an edge has the rest length and the direction of its own free frame.
 *
 *     E = k/2 |(x_{i+1} - x_i) / l0 - rotate(q_i, e3)|^2 per edge
 *
 * Stuyck et al. 2025 (Quaffure), eq. 3. The orientations q [B,S,V-1,4] are unknowns like x, brought as the frame's input
 * "q"; rotate(q, e3) = q e3 conj(q) is the direction of the edge (times |q|^2: unit_quaternion keeps it at 1). q and -q are
 * one orientation and one energy. Nothing is divided but by l0, at least 1e-6 m, so an edge of length zero is smooth. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar cosserat_stretch_shear(void)
{
    scalar l0 = rest_length(rest(0), rest(1));
    vec3 strain = sub(divide(sub(x(1), x(0)), l0), rotate(q(0), vector(0, 0, 1)));
    return mul(0.5, param("stiffness"), square(strain));
}

HG_ENERGY(cosserat_stretch_shear, .equation = "k/2 |(x_{i+1} - x_i)/l0 - rotate(q_i, e3)|^2 per edge",
          .source = "Quaffure eq. 3", .site = window(2),
          .params = { { "stiffness", 3e-5, "J", "of an edge, per hair; 2 N/m over an edge of 4 mm" } });
