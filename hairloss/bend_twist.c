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

#include "autograd/trace/names.h"

/* Strain energy of a pair, with r0 = (1, 0, 0, 0) for the root. */
static scalar strain_energy(quat r, quat r0, scalar length)
{
    scalar k = param("stiffness"), alignment = dot(r, r0);
    if (option("strain", "smooth")) return mul(4, k, divide(sub(1, abs(alignment)), length));
    vec3 im = sub(mul(select(less(alignment, 0), -1, 1), r.v), r0.v);
    return mul(2, k, divide(square(im), length)); /* k/2 l' (2/l')^2 |dIm|^2 */
}

/* Rotation from edge (a, b) to edge (b, c), both carried to from the root tangent t0. */
static quat edge_to_edge(vec3 t0, vec3 a, vec3 b, vec3 c, scalar l0, scalar l1)
{
    quat p0 = transport(t0, tangent(a, b, l0));
    quat p1 = transport(t0, tangent(b, c, l1));
    return qmul(conj(p0), p1);
}

/* Tangents of the root edge, and the frame that the root edge has now. */
typedef struct {
    vec3 rest, now;
    quat frame;
    scalar length;
} root_edge;

static root_edge root(void)
{
    root_edge e;
    quat R = root_rotation();
    e.length = rest_length(root_rest(0), root_rest(1));
    e.rest = tangent(root_rest(0), root_rest(1), e.length);
    e.now = tangent(root_x(0), root_x(1), e.length);
    e.frame = qmul(transport(rotate(R, e.rest), e.now), R);
    return e;
}

static scalar bend_twist(void)
{
    root_edge e = root();
    scalar l0 = rest_length(rest(0), rest(1)), l1 = rest_length(rest(1), rest(2));
    quat r0 = edge_to_edge(e.rest, rest(0), rest(1), rest(2), l0, l1);
    quat r = edge_to_edge(e.now, x(0), x(1), x(2), l0, l1);
    quat in_root = quaternion(mul(r.w, square(e.frame)), rotate(conj(e.frame), r.v)); /* conj(F) r F */
    return strain_energy(in_root, r0, mul(0.5, add(l0, l1)));
}

static scalar root_clamp(void)
{
    root_edge e = root();
    if (option("root", "free")) return hg_trace_number(0);
    quat R = root_rotation();
    quat r = qmul(conj(R), e.frame); /* seen in R: conj(R) (F conj(R)) R */
    return strain_energy(r, quaternion(1, vector(0, 0, 0)), e.length);
}

HG_ENERGY(bend_twist, .equation = "k/2 l' |2/l' (Im r - Im r0)|^2 per edge pair, or 4k/l' (1 - |r.r0|)",
          .source = "Neuralocks eq. 3", .site = window(3),
          .params = { { "stiffness", 1e-8, "N*m^2", "bending and twisting stiffness of a hair" } },
          .options = { { "strain", "published|smooth", "published", "how a rotation is compared with the one at rest" },
                       { "root", "free|clamped", "free", "does the root edge resist leaving its rest direction" } },
          .root = root_clamp, .zero_at_rest = true, .rigid_invariant = true);
