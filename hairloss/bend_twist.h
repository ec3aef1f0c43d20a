/* bend_twist (private): what direct and chained transport share. Included last, in the place of names.h. */
#ifndef HG_HAIRLOSS_BEND_TWIST_H
#define HG_HAIRLOSS_BEND_TWIST_H

#include "autograd/trace/names.h"

/* Strain energy of a pair, with r0 = (1, 0, 0, 0) for the root. */
static inline scalar strain_energy(quat r, quat r0, scalar length)
{
    scalar k = param("stiffness"), alignment = dot(r, r0);
    if (option("strain", "smooth")) return mul(4, k, divide(sub(1, abs(alignment)), length));
    vec3 im = sub(mul(select(less(alignment, 0), -1, 1), r.v), r0.v);
    return mul(2, k, divide(square(im), length)); /* k/2 l' (2/l')^2 |dIm|^2 */
}

/* Tangents of the root edge, and the frame that the root edge has now. */
typedef struct {
    vec3 rest, now;
    quat frame;
    scalar length;
} root_edge;

static inline root_edge root(void)
{
    root_edge e;
    quat R = root_rotation();
    e.length = rest_length(root_rest(0), root_rest(1));
    e.rest = tangent(root_rest(0), root_rest(1), e.length);
    e.now = tangent(root_x(0), root_x(1), e.length);
    e.frame = qmul(transport(rotate(R, e.rest), e.now), R);
    return e;
}

/* conj(F) r F: the rotation r seen in the frame F. */
static inline quat seen_in(quat frame, quat r) { return quaternion(mul(r.w, square(frame)), rotate(conj(frame), r.v)); }

/* The pair (rest root frame R, root edge), where the root is clamped. */
static inline scalar root_clamp(void)
{
    root_edge e = root();
    if (option("root", "free")) return hg_trace_number(0);
    quat R = root_rotation();
    quat r = qmul(conj(R), e.frame); /* seen in R: conj(R) (F conj(R)) R */
    return strain_energy(r, quaternion(1, vector(0, 0, 0)), e.length);
}

#endif
