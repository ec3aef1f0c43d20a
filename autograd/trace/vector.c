/* Vectors and quaternions of a formula: compositions of scalars, with the guards that every energy shares
 * (rest lengths, tangents and transports of degenerate edges stay finite, and so do their gradients). */
#include "autograd/trace/graph.h"

static hg_scalar add(hg_scalar a, hg_scalar b) { return hg_trace_add2(a, b); }

static hg_scalar sub(hg_scalar a, hg_scalar b) { return hg_trace_sub(a, b); }

static hg_scalar mul(hg_scalar a, hg_scalar b) { return hg_trace_mul2(a, b); }

static hg_scalar number(double value) { return hg_trace_number(value); }

/* ---- scalars ------------------------------------------------------------------------------------------------ */

hg_scalar hg_trace_square(hg_scalar a) { return mul(a, a); }

hg_scalar hg_trace_clamp(hg_scalar a, hg_scalar low, hg_scalar high)
{
    return hg_trace_min(hg_trace_max(a, low), high);
}

/* ---- vectors ------------------------------------------------------------------------------------------------ */

hg_vec3 hg_trace_vec3_add(hg_vec3 a, hg_vec3 b) { return (hg_vec3){ add(a.x, b.x), add(a.y, b.y), add(a.z, b.z) }; }

hg_vec3 hg_trace_vec3_sub(hg_vec3 a, hg_vec3 b) { return (hg_vec3){ sub(a.x, b.x), sub(a.y, b.y), sub(a.z, b.z) }; }

hg_vec3 hg_trace_vec3_neg(hg_vec3 a) { return (hg_vec3){ hg_trace_neg(a.x), hg_trace_neg(a.y), hg_trace_neg(a.z) }; }

hg_vec3 hg_trace_vec3_scale(hg_vec3 a, hg_scalar s) { return (hg_vec3){ mul(a.x, s), mul(a.y, s), mul(a.z, s) }; }

hg_vec3 hg_trace_vec3_div(hg_vec3 a, hg_scalar s)
{
    return (hg_vec3){ hg_trace_div(a.x, s), hg_trace_div(a.y, s), hg_trace_div(a.z, s) };
}

hg_scalar hg_trace_vec3_dot(hg_vec3 a, hg_vec3 b) { return add(add(mul(a.x, b.x), mul(a.y, b.y)), mul(a.z, b.z)); }

hg_vec3 hg_trace_vec3_cross(hg_vec3 a, hg_vec3 b)
{
    return (hg_vec3){ sub(mul(a.y, b.z), mul(a.z, b.y)), sub(mul(a.z, b.x), mul(a.x, b.z)),
                      sub(mul(a.x, b.y), mul(a.y, b.x)) };
}

hg_scalar hg_trace_vec3_square(hg_vec3 a) { return hg_trace_vec3_dot(a, a); }

hg_scalar hg_trace_vec3_norm(hg_vec3 a) { return hg_trace_sqrt(hg_trace_vec3_dot(a, a)); }

hg_vec3 hg_trace_vec3_normalize(hg_vec3 a)
{
    const hg_scalar square = hg_trace_vec3_dot(a, a), some = hg_trace_less(number(0), square);
    const hg_scalar scale = hg_trace_rsqrt(hg_trace_select(some, square, number(1)));
    return hg_trace_vec3_scale(a, hg_trace_select(some, scale, number(0)));
}

hg_vec3 hg_trace_vec3_min(hg_vec3 a, hg_vec3 b)
{
    return (hg_vec3){ hg_trace_min(a.x, b.x), hg_trace_min(a.y, b.y), hg_trace_min(a.z, b.z) };
}

hg_vec3 hg_trace_vec3_max(hg_vec3 a, hg_vec3 b)
{
    return (hg_vec3){ hg_trace_max(a.x, b.x), hg_trace_max(a.y, b.y), hg_trace_max(a.z, b.z) };
}

hg_vec3 hg_trace_vec3_select(hg_scalar condition, hg_vec3 a, hg_vec3 b)
{
    return (hg_vec3){ hg_trace_select(condition, a.x, b.x), hg_trace_select(condition, a.y, b.y),
                      hg_trace_select(condition, a.z, b.z) };
}

hg_vec3 hg_trace_vec3_detach(hg_vec3 a)
{
    return (hg_vec3){ hg_trace_detach(a.x), hg_trace_detach(a.y), hg_trace_detach(a.z) };
}

hg_scalar hg_trace_rest_length(hg_vec3 a, hg_vec3 b)
{
    return hg_trace_max(hg_trace_vec3_norm(hg_trace_vec3_sub(b, a)), number(1e-6));
}

hg_vec3 hg_trace_tangent(hg_vec3 a, hg_vec3 b, hg_scalar l0)
{
    const hg_vec3 e = hg_trace_vec3_sub(b, a);
    const hg_scalar least = hg_trace_square(mul(number(1e-3), l0));
    return hg_trace_vec3_scale(e, hg_trace_rsqrt(hg_trace_max(hg_trace_vec3_dot(e, e), least)));
}

/* ---- quaternions -------------------------------------------------------------------------------------------- */

hg_quat hg_trace_quat_add(hg_quat a, hg_quat b) { return (hg_quat){ add(a.w, b.w), hg_trace_vec3_add(a.v, b.v) }; }

hg_quat hg_trace_quat_sub(hg_quat a, hg_quat b) { return (hg_quat){ sub(a.w, b.w), hg_trace_vec3_sub(a.v, b.v) }; }

hg_quat hg_trace_quat_neg(hg_quat a) { return (hg_quat){ hg_trace_neg(a.w), hg_trace_vec3_neg(a.v) }; }

hg_quat hg_trace_quat_scale(hg_quat a, hg_scalar s) { return (hg_quat){ mul(a.w, s), hg_trace_vec3_scale(a.v, s) }; }

hg_scalar hg_trace_quat_dot(hg_quat a, hg_quat b) { return add(mul(a.w, b.w), hg_trace_vec3_dot(a.v, b.v)); }

hg_scalar hg_trace_quat_square(hg_quat a) { return hg_trace_quat_dot(a, a); }

hg_scalar hg_trace_quat_norm(hg_quat a) { return hg_trace_sqrt(hg_trace_quat_dot(a, a)); }

hg_quat hg_trace_quat_normalize(hg_quat a)
{
    const hg_scalar square = hg_trace_quat_dot(a, a), some = hg_trace_less(number(0), square);
    const hg_scalar scale = hg_trace_rsqrt(hg_trace_select(some, square, number(1)));
    return hg_trace_quat_scale(a, hg_trace_select(some, scale, number(0)));
}

hg_quat hg_trace_quat_conj(hg_quat a) { return (hg_quat){ a.w, hg_trace_vec3_neg(a.v) }; }

hg_quat hg_trace_quat_mul(hg_quat a, hg_quat b)
{
    const hg_vec3 v = hg_trace_vec3_add(hg_trace_vec3_add(hg_trace_vec3_scale(b.v, a.w), hg_trace_vec3_scale(a.v, b.w)),
                                        hg_trace_vec3_cross(a.v, b.v));
    return (hg_quat){ sub(mul(a.w, b.w), hg_trace_vec3_dot(a.v, b.v)), v };
}

/* q v conj(q), also for a q that is not quite unit (a transport inside its guard). Slower q than v: by the matrix, which
 * is then computed once for all v. Otherwise (w^2 - u.u) v + 2 (u.v) u + 2 w u x v. */
hg_vec3 hg_trace_quat_rotate(hg_quat q, hg_vec3 v)
{
    const hg_scalar w = q.w, x = q.v.x, y = q.v.y, z = q.v.z, two = number(2);
    if (hg_trace_rate(w) < hg_trace_rate(v.x)) {
        const hg_scalar ww = mul(w, w), xx = mul(x, x), yy = mul(y, y), zz = mul(z, z), xy = mul(x, y), xz = mul(x, z),
                        yz = mul(y, z), wx = mul(w, x), wy = mul(w, y), wz = mul(w, z);
        const hg_scalar sum = add(ww, xx), difference = sub(ww, xx);
        const hg_vec3 rows[3] = {
            { sub(sum, add(yy, zz)), mul(two, sub(xy, wz)), mul(two, add(xz, wy)) },
            { mul(two, add(xy, wz)), add(difference, sub(yy, zz)), mul(two, sub(yz, wx)) },
            { mul(two, sub(xz, wy)), mul(two, add(yz, wx)), add(difference, sub(zz, yy)) },
        };
        return (hg_vec3){ hg_trace_vec3_dot(rows[0], v), hg_trace_vec3_dot(rows[1], v), hg_trace_vec3_dot(rows[2], v) };
    }
    const hg_vec3 straight = hg_trace_vec3_scale(v, sub(mul(w, w), hg_trace_vec3_dot(q.v, q.v)));
    const hg_vec3 along = hg_trace_vec3_scale(q.v, mul(two, hg_trace_vec3_dot(q.v, v)));
    const hg_vec3 across = hg_trace_vec3_scale(hg_trace_vec3_cross(q.v, v), mul(two, w));
    return hg_trace_vec3_add(hg_trace_vec3_add(straight, along), across);
}

hg_quat hg_trace_quat_select(hg_scalar condition, hg_quat a, hg_quat b)
{
    return (hg_quat){ hg_trace_select(condition, a.w, b.w), hg_trace_vec3_select(condition, a.v, b.v) };
}

hg_quat hg_trace_quat_detach(hg_quat a) { return (hg_quat){ hg_trace_detach(a.w), hg_trace_vec3_detach(a.v) }; }

hg_quat hg_trace_transport(hg_vec3 a, hg_vec3 b)
{
    hg_vec3 h = hg_trace_vec3_add(a, b);
    h = hg_trace_vec3_scale(h, hg_trace_rsqrt(hg_trace_max(hg_trace_vec3_dot(h, h), number(1e-4))));
    return (hg_quat){ hg_trace_vec3_dot(a, h), hg_trace_vec3_cross(a, h) };
}
