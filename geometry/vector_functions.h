/* The functions of geometry/vector.h, for one precision: hg_real, HG_VEC3, HG_QUAT, HG_V(name), HG_Q(name) and
 * HG_MATH(function) are set by it. Not to be included elsewhere (and so without an include guard).
 */

typedef struct {
    hg_real x, y, z;
} HG_VEC3;
typedef struct {
    hg_real w, x, y, z;
} HG_QUAT;

/* ---- vec3 ---- */

HG_INLINE HG_VEC3 HG_V(make)(hg_real x, hg_real y, hg_real z)
{
    HG_VEC3 v = { x, y, z };
    return v;
}
HG_INLINE HG_VEC3 HG_V(load)(const hg_real *from) { return HG_V(make)(from[0], from[1], from[2]); }
HG_INLINE void HG_V(store)(hg_real *to, HG_VEC3 a)
{
    to[0] = a.x;
    to[1] = a.y;
    to[2] = a.z;
}
HG_INLINE HG_VEC3 HG_V(add)(HG_VEC3 a, HG_VEC3 b) { return HG_V(make)(a.x + b.x, a.y + b.y, a.z + b.z); }
HG_INLINE HG_VEC3 HG_V(sub)(HG_VEC3 a, HG_VEC3 b) { return HG_V(make)(a.x - b.x, a.y - b.y, a.z - b.z); }
HG_INLINE HG_VEC3 HG_V(neg)(HG_VEC3 a) { return HG_V(make)(-a.x, -a.y, -a.z); }
HG_INLINE HG_VEC3 HG_V(scale)(HG_VEC3 a, hg_real s) { return HG_V(make)(a.x * s, a.y * s, a.z * s); }
/* a + s b */
HG_INLINE HG_VEC3 HG_V(add_scaled)(HG_VEC3 a, hg_real s, HG_VEC3 b)
{
    return HG_V(make)(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}
/* a at t = 0, b at t = 1 */
HG_INLINE HG_VEC3 HG_V(mix)(HG_VEC3 a, HG_VEC3 b, hg_real t) { return HG_V(add_scaled)(a, t, HG_V(sub)(b, a)); }
HG_INLINE hg_real HG_V(dot)(HG_VEC3 a, HG_VEC3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
HG_INLINE HG_VEC3 HG_V(cross)(HG_VEC3 a, HG_VEC3 b)
{
    return HG_V(make)(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
HG_INLINE hg_real HG_V(norm2)(HG_VEC3 a) { return HG_V(dot)(a, a); }
HG_INLINE hg_real HG_V(norm)(HG_VEC3 a) { return HG_MATH(sqrt)(HG_V(dot)(a, a)); }
HG_INLINE hg_real HG_V(distance)(HG_VEC3 a, HG_VEC3 b) { return HG_V(norm)(HG_V(sub)(a, b)); }
/* the unit vector along a; zero for the zero vector */
HG_INLINE HG_VEC3 HG_V(normalize)(HG_VEC3 a)
{
    hg_real length = HG_V(norm)(a);
    return length > (hg_real)0 ? HG_V(scale)(a, (hg_real)1 / length) : HG_V(make)(0, 0, 0);
}
/* some unit vector at right angles to the unit vector a */
HG_INLINE HG_VEC3 HG_V(perpendicular)(HG_VEC3 a)
{
    hg_real x = HG_MATH(fabs)(a.x), y = HG_MATH(fabs)(a.y), z = HG_MATH(fabs)(a.z);
    HG_VEC3 axis = x <= y && x <= z ? HG_V(make)(1, 0, 0) : y <= z ? HG_V(make)(0, 1, 0) : HG_V(make)(0, 0, 1);
    HG_VEC3 c = HG_V(cross)(a, axis);
    return HG_V(norm2)(c) > (hg_real)0 ? HG_V(normalize)(c) : HG_V(make)(1, 0, 0);
}
HG_INLINE int HG_V(finite)(HG_VEC3 a) { return isfinite(a.x) && isfinite(a.y) && isfinite(a.z); }

/* ---- quaternion ---- */

HG_INLINE HG_QUAT HG_Q(make)(hg_real w, hg_real x, hg_real y, hg_real z)
{
    HG_QUAT q = { w, x, y, z };
    return q;
}
HG_INLINE HG_QUAT HG_Q(load)(const hg_real *from) { return HG_Q(make)(from[0], from[1], from[2], from[3]); }
HG_INLINE void HG_Q(store)(hg_real *to, HG_QUAT q)
{
    to[0] = q.w;
    to[1] = q.x;
    to[2] = q.y;
    to[3] = q.z;
}
HG_INLINE HG_QUAT HG_Q(identity)(void) { return HG_Q(make)(1, 0, 0, 0); }
HG_INLINE HG_VEC3 HG_Q(vector)(HG_QUAT q) { return HG_V(make)(q.x, q.y, q.z); }
HG_INLINE HG_QUAT HG_Q(conj)(HG_QUAT q) { return HG_Q(make)(q.w, -q.x, -q.y, -q.z); }
HG_INLINE HG_QUAT HG_Q(neg)(HG_QUAT q) { return HG_Q(make)(-q.w, -q.x, -q.y, -q.z); }
HG_INLINE hg_real HG_Q(dot)(HG_QUAT a, HG_QUAT b) { return a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z; }
HG_INLINE hg_real HG_Q(norm)(HG_QUAT q) { return HG_MATH(sqrt)(HG_Q(dot)(q, q)); }
/* the identity for zero */
HG_INLINE HG_QUAT HG_Q(normalize)(HG_QUAT q)
{
    hg_real length = HG_Q(norm)(q);
    if (!(length > (hg_real)0)) return HG_Q(identity)();
    hg_real s = (hg_real)1 / length;
    return HG_Q(make)(q.w * s, q.x * s, q.y * s, q.z * s);
}
HG_INLINE HG_QUAT HG_Q(mul)(HG_QUAT a, HG_QUAT b)
{
    return HG_Q(make)(a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z, a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
                      a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w);
}
/* the vector turned by the unit quaternion */
HG_INLINE HG_VEC3 HG_Q(rotate)(HG_QUAT q, HG_VEC3 v)
{
    HG_VEC3 u = HG_Q(vector)(q);
    HG_VEC3 t = HG_V(scale)(HG_V(cross)(u, v), 2);
    return HG_V(add)(HG_V(add_scaled)(v, q.w, t), HG_V(cross)(u, t));
}
/* The smallest rotation that takes the unit vector a to the unit vector b, as the energies use it: (a.h, a x h) with
 * h = (a + b) / sqrt(max(|a + b|^2, HG_TRANSPORT_GUARD)). Within 0.01 rad of antiparallel it is finite but shorter
 * than one. */
HG_INLINE HG_QUAT HG_Q(transport)(HG_VEC3 a, HG_VEC3 b)
{
    HG_VEC3 h = HG_V(add)(a, b);
    h = HG_V(scale)(h, (hg_real)1 / HG_MATH(sqrt)(HG_MATH(fmax)(HG_V(norm2)(h), (hg_real)HG_TRANSPORT_GUARD)));
    HG_VEC3 v = HG_V(cross)(a, h);
    return HG_Q(make)(HG_V(dot)(a, h), v.x, v.y, v.z);
}
/* The same, always of unit length: half a turn about some perpendicular axis when a = -b. For scenes, not energies. */
HG_INLINE HG_QUAT HG_Q(between)(HG_VEC3 a, HG_VEC3 b)
{
    HG_VEC3 h = HG_V(add)(a, b);
    hg_real length = HG_V(norm)(h);
    if (length < (hg_real)1e-6) {
        HG_VEC3 p = HG_V(perpendicular)(a);
        return HG_Q(make)(0, p.x, p.y, p.z);
    }
    h = HG_V(scale)(h, (hg_real)1 / length);
    HG_VEC3 v = HG_V(cross)(a, h);
    return HG_Q(normalize)(HG_Q(make)(HG_V(dot)(a, h), v.x, v.y, v.z));
}
/* a turn by `angle` about the unit vector `axis` */
HG_INLINE HG_QUAT HG_Q(from_axis_angle)(HG_VEC3 axis, hg_real angle)
{
    hg_real half = angle * (hg_real)0.5, s = HG_MATH(sin)(half);
    return HG_Q(make)(HG_MATH(cos)(half), axis.x * s, axis.y * s, axis.z * s);
}
/* a rotation vector is axis times angle: the form that networks are fed with */
HG_INLINE HG_QUAT HG_Q(from_rotation_vector)(HG_VEC3 v)
{
    hg_real angle = HG_V(norm)(v);
    /* sin(angle/2)/angle, by its series where the quotient loses digits */
    hg_real s = angle > (hg_real)1e-3 ? HG_MATH(sin)(angle * (hg_real)0.5) / angle
                                      : (hg_real)0.5 - angle * angle * (hg_real)(1.0 / 48.0);
    return HG_Q(make)(HG_MATH(cos)(angle * (hg_real)0.5), v.x * s, v.y * s, v.z * s);
}
/* the shorter of the two rotation vectors of the unit quaternion: at most pi long */
HG_INLINE HG_VEC3 HG_Q(to_rotation_vector)(HG_QUAT q)
{
    if (q.w < (hg_real)0) q = HG_Q(neg)(q);
    HG_VEC3 u = HG_Q(vector)(q);
    hg_real s = HG_V(norm)(u);
    hg_real angle_over_sine = s > (hg_real)1e-6 ? (hg_real)2 * HG_MATH(atan2)(s, q.w) / s : (hg_real)2;
    return HG_V(scale)(u, angle_over_sine);
}
/* axis (unit; +X for no rotation) and angle in [0, pi] of the unit quaternion */
HG_INLINE HG_VEC3 HG_Q(to_axis_angle)(HG_QUAT q, hg_real *angle)
{
    HG_VEC3 v = HG_Q(to_rotation_vector)(q);
    *angle = HG_V(norm)(v);
    return *angle > (hg_real)0 ? HG_V(scale)(v, (hg_real)1 / *angle) : HG_V(make)(1, 0, 0);
}
/* of a rotation matrix [9], row-major; w >= 0 */
HG_INLINE HG_QUAT HG_Q(from_matrix)(const hg_real m[9])
{
    /* The largest of the four squares is taken out of the root, so that nothing small is divided by. */
    hg_real trace = m[0] + m[4] + m[8];
    HG_QUAT q;
    if (trace >= m[0] && trace >= m[4] && trace >= m[8])
        q = HG_Q(make)((hg_real)1 + trace, m[7] - m[5], m[2] - m[6], m[3] - m[1]);
    else if (m[0] >= m[4] && m[0] >= m[8])
        q = HG_Q(make)(m[7] - m[5], (hg_real)1 + m[0] - m[4] - m[8], m[1] + m[3], m[2] + m[6]);
    else if (m[4] >= m[8])
        q = HG_Q(make)(m[2] - m[6], m[1] + m[3], (hg_real)1 + m[4] - m[0] - m[8], m[5] + m[7]);
    else
        q = HG_Q(make)(m[3] - m[1], m[2] + m[6], m[5] + m[7], (hg_real)1 + m[8] - m[0] - m[4]);
    q = HG_Q(normalize)(q);
    return q.w < (hg_real)0 ? HG_Q(neg)(q) : q;
}
/* of three perpendicular unit columns */
HG_INLINE HG_QUAT HG_Q(from_columns)(HG_VEC3 x, HG_VEC3 y, HG_VEC3 z)
{
    hg_real m[9] = { x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z };
    return HG_Q(from_matrix)(m);
}
HG_INLINE void HG_Q(to_matrix)(HG_QUAT q, hg_real m[9])
{
    hg_real two = 2, one = 1;
    m[0] = one - two * (q.y * q.y + q.z * q.z);
    m[1] = two * (q.x * q.y - q.w * q.z);
    m[2] = two * (q.x * q.z + q.w * q.y);
    m[3] = two * (q.x * q.y + q.w * q.z);
    m[4] = one - two * (q.x * q.x + q.z * q.z);
    m[5] = two * (q.y * q.z - q.w * q.x);
    m[6] = two * (q.x * q.z - q.w * q.y);
    m[7] = two * (q.y * q.z + q.w * q.x);
    m[8] = one - two * (q.x * q.x + q.y * q.y);
}
/* from a (t = 0) to b (t = 1) the short way, at constant speed; unit quaternions */
HG_INLINE HG_QUAT HG_Q(slerp)(HG_QUAT a, HG_QUAT b, hg_real t)
{
    hg_real c = HG_Q(dot)(a, b);
    if (c < (hg_real)0) {
        b = HG_Q(neg)(b);
        c = -c;
    }
    /* The part of b at right angles to a: its length is the sine of the angle, without the loss of digits of acos. */
    HG_QUAT across = HG_Q(make)(b.w - c * a.w, b.x - c * a.x, b.y - c * a.y, b.z - c * a.z);
    hg_real s = HG_Q(norm)(across), angle = HG_MATH(atan2)(s, c);
    hg_real wa = HG_MATH(cos)(t * angle), wb = s > (hg_real)1e-12 ? HG_MATH(sin)(t * angle) / s : (hg_real)0;
    return HG_Q(normalize)(HG_Q(make)(wa * a.w + wb * across.w, wa * a.x + wb * across.x, wa * a.y + wb * across.y,
                                      wa * a.z + wb * across.z));
}
