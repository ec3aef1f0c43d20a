/* Bend and twist: the change of a strand's discrete curvature and torsion against rest, without extra unknowns.
 *
 *     E = k/2 l' |Omega|^2 per consecutive edge pair,  Omega = 2/l' (Im r - Im r0)                  strain: published
 *     E = 4k/l' (1 - |r.r0|)                                                                       strain: smooth
 *
 * Lin et al. 2025 (Neuralocks), eq. 3. l' is the mean rest length of the pair. p_i = transport(t_0 -> t_i) goes directly
 * from the root edge to edge i (no chain: holonomy is ignored), conj(p_i) p_{i+1} is the rotation from one edge to the
 * next, and r is that rotation seen in the root's frame F = transport(R t0_rest -> t_0) R, so that it can be compared
 * with r0, the same of the strand at rest. r and -r are one rotation: the sign with r.r0 >= 0 is taken.
 *
 * `published` compares imaginary parts, which jumps where r.r0 = 0. `smooth` is ours: continuous, bounded, zero only at
 * rest, and equal for small strains of nearly straight rest pairs.
 *
 * root: clamped adds the pair (rest root frame R, root edge): r = conj(R) F seen in R, r0 = 1, l' = l0 of edge 0. Nothing
 * else resists a rigid swing of the whole strand about its root. */
#include "hairloss/hairloss.h"

#include "hairloss/bend_twist.h"

/* Rotation from edge (a, b) to edge (b, c), both carried to from the root tangent t0. */
static quat edge_to_edge(vec3 t0, vec3 a, vec3 b, vec3 c, scalar l0, scalar l1)
{
    quat p0 = transport(t0, tangent(a, b, l0));
    quat p1 = transport(t0, tangent(b, c, l1));
    return qmul(conj(p0), p1);
}

static scalar bend_twist(void)
{
    root_edge e = root();
    scalar l0 = rest_length(rest(0), rest(1)), l1 = rest_length(rest(1), rest(2));
    quat r0 = edge_to_edge(e.rest, rest(0), rest(1), rest(2), l0, l1);
    quat r = edge_to_edge(e.now, x(0), x(1), x(2), l0, l1);
    return strain_energy(seen_in(e.frame, r), r0, mul(0.5, add(l0, l1)));
}

HG_ENERGY(bend_twist, .equation = "k/2 l' |2/l' (Im r - Im r0)|^2 per edge pair, or 4k/l' (1 - |r.r0|)",
          .source = "Neuralocks eq. 3", .site = window(3),
          .params = { { "stiffness", 1e-8, "N*m^2", "bending and twisting stiffness of a hair" } },
          .options = { { "strain", "published|smooth", "published", "how a rotation is compared with the one at rest" },
                       { "root", "free|clamped", "free", "does the root edge resist leaving its rest direction" } },
          .root = root_clamp, .zero_at_rest = true, .rigid_invariant = true);
