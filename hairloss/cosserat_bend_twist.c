/* Bend and twist of a Cosserat rod: the change of the rotation from one edge's free frame to the next against rest.
 *
 *     E = k/2 |Omega|^2 per edge pair,  Omega = 2/l' Im(conj(q_i) q_{i+1} - conj(q0_i) q0_{i+1})
 *
 * Stuyck et al. 2025 (Quaffure), eq. 4 (without a factor l'). The orientations q [B,S,V-1,4] are unknowns, brought as the
 * frame's input "q". l' is the mean rest length of the pair. The rest frames q0 are carried along the rest strand:
 * q0_0 = transport(e3 -> t_0), q0_{i+1} = transport(t_i -> t_{i+1}) q0_i, once per groom.
 *
 * q_i and -q_i are one orientation, so the sign of the rotation is the one with r.r0 >= 0: there the energy jumps, as that of
 * bend_twist does. Quaternions of length zero have r = 0: a finite energy and a finite gradient. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar cosserat_bend_twist(void)
{
    scalar l0 = rest_length(rest(0), rest(1)), l1 = rest_length(rest(1), rest(2));
    vec3 t0 = tangent(rest(0), rest(1), l0), t1 = tangent(rest(1), rest(2), l1);
    quat rest_q = carry("rest_q", transport(vector(0, 0, 1), t0));
    quat next = qmul(transport(t0, t1), rest_q);
    keep("rest_q", next);
    quat r = qmul(conj(q(0)), q(1)), r0 = qmul(conj(rest_q), next);
    vec3 omega = divide(mul(4, sub(mul(select(less(dot(r, r0), 0), -1, 1), r.v), r0.v)), add(l0, l1));
    return mul(0.5, param("stiffness"), square(omega));
}

HG_ENERGY(cosserat_bend_twist, .equation = "k/2 |2/l' Im(conj(q_i) q_{i+1} - conj(q0_i) q0_{i+1})|^2 per edge pair",
          .source = "Quaffure eq. 4", .site = window(3),
          .params = { { "stiffness", 4e-11, "N*m^3", "of a pair of edges, per hair; 1e-8 N m^2 over edges of 4 mm" } });
