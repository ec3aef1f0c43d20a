/* names: the short names in which formulas are written. Include it LAST, and only in files that hold formulas.
 *
 *     scalar vec3 quat                     the handles
 *     add(a, b, ...) mul(a, b, ...)        up to 6; scalars, vectors, quaternions; numbers mixed in; mul scales a vector
 *     sub(a, b) divide(a, b) neg(a)
 *     dot(a, b) cross(a, b) norm(a) normalize(a) square(a)     square of a vector is a.a
 *     sqrt rsqrt abs exp log sin cos atan2 min max clamp(a, low, high)
 *     less(a, b) select(condition, a, b) detach(a)
 *     vector(x, y, z) quaternion(w, v)
 *     conj(q) qmul(p, q) rotate(q, v) transport(a, b) tangent(a, b, l0) rest_length(a, b)
 *     x(k) rest(k) posed(k) predicted(k) previous(k) contact_point(k) contact_normal(k) contact_distance(k)
 *     root_x(k) root_rest(k) root_rotation() root_position() mass(k) attribute(name, k)
 *     strand_length() q(k) frame_scalar(name, k) frame_vec3(name, k) carry(name, first) keep(name, value)
 *     distance() rest_distance() field() field_rest() param(name) param3(name) dt() option(name, choice)
 *
 * A vector plus a scalar does not compile, nor does `if (a < b)`. Names of the C library (sqrt, abs, div, select, ...)
 * keep their meaning in everything included before. */
#ifndef HG_TRACE_NAMES_H
#define HG_TRACE_NAMES_H

#include "autograd/trace/trace.h"

#include <complex.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef hg_scalar scalar;
typedef hg_vec3 vec3;
typedef hg_quat quat;

/* ---- a number where a scalar may stand ---------------------------------------------------------------------- */

static inline hg_scalar hg_name_scalar(hg_scalar a) { return a; }

#define HG_SCALAR(a) _Generic((a), hg_scalar : hg_name_scalar, default : hg_trace_number)(a)

#define HG_NAME_MIXED(name_, function_)                                                                                \
    static inline hg_scalar hg_name_##name_##_sn(hg_scalar a, double b) { return function_(a, hg_trace_number(b)); }   \
    static inline hg_scalar hg_name_##name_##_ns(double a, hg_scalar b) { return function_(hg_trace_number(a), b); }   \
    static inline hg_scalar hg_name_##name_##_nn(double a, double b)                                                   \
    {                                                                                                                  \
        return function_(hg_trace_number(a), hg_trace_number(b));                                                      \
    }                                                                                                                  \
    struct hg_needs_semicolon

HG_NAME_MIXED(add, hg_trace_add2);
HG_NAME_MIXED(sub, hg_trace_sub);
HG_NAME_MIXED(mul, hg_trace_mul2);
HG_NAME_MIXED(div, hg_trace_div);
HG_NAME_MIXED(min, hg_trace_min);
HG_NAME_MIXED(max, hg_trace_max);
HG_NAME_MIXED(less, hg_trace_less);
HG_NAME_MIXED(atan2, hg_trace_atan2);
static inline hg_vec3 hg_name_vec3_sv(hg_scalar s, hg_vec3 v) { return hg_trace_vec3_scale(v, s); }
static inline hg_vec3 hg_name_vec3_nv(double s, hg_vec3 v) { return hg_trace_vec3_scale(v, hg_trace_number(s)); }
static inline hg_vec3 hg_name_vec3_vn(hg_vec3 v, double s) { return hg_trace_vec3_scale(v, hg_trace_number(s)); }
static inline hg_vec3 hg_name_vec3_div_vn(hg_vec3 v, double s) { return hg_trace_vec3_div(v, hg_trace_number(s)); }
static inline hg_quat hg_name_quat_sq(hg_scalar s, hg_quat q) { return hg_trace_quat_scale(q, s); }
static inline hg_quat hg_name_quat_nq(double s, hg_quat q) { return hg_trace_quat_scale(q, hg_trace_number(s)); }
static inline hg_quat hg_name_quat_qn(hg_quat q, double s) { return hg_trace_quat_scale(q, hg_trace_number(s)); }

#define HG_NAME_SCALARS(name_, function_, a, b)                                                                        \
    hg_scalar:                                                                                                         \
    _Generic((b), hg_scalar                                                                                            \
             : function_, default                                                                                      \
             : hg_name_##name_##_sn),                                                                                  \
        default : _Generic((b), hg_scalar                                                                              \
                           : hg_name_##name_##_ns, default                                                             \
                           : hg_name_##name_##_nn)

/* ---- arithmetic --------------------------------------------------------------------------------------------- */

#define HG_ADD2(a, b)                                                                                                  \
    _Generic((a), hg_vec3                                                                                              \
             : hg_trace_vec3_add, hg_quat                                                                              \
             : hg_trace_quat_add, HG_NAME_SCALARS(add, hg_trace_add2, a, b))(a, b)
#define HG_MUL2(a, b)                                                                                                  \
    _Generic((a), hg_vec3                                                                                              \
             : _Generic((b), hg_scalar                                                                                 \
                        : hg_trace_vec3_scale, default                                                                 \
                        : hg_name_vec3_vn),                                                                            \
               hg_quat                                                                                                 \
             : _Generic((b), hg_scalar                                                                                 \
                        : hg_trace_quat_scale, default                                                                 \
                        : hg_name_quat_qn),                                                                            \
               hg_scalar                                                                                               \
             : _Generic((b), hg_vec3                                                                                   \
                        : hg_name_vec3_sv, hg_quat                                                                     \
                        : hg_name_quat_sq, hg_scalar                                                                   \
                        : hg_trace_mul2, default                                                                       \
                        : hg_name_mul_sn),                                                                             \
               default                                                                                                 \
             : _Generic((b), hg_vec3                                                                                   \
                        : hg_name_vec3_nv, hg_quat                                                                     \
                        : hg_name_quat_nq, hg_scalar                                                                   \
                        : hg_name_mul_ns, default                                                                      \
                        : hg_name_mul_nn))(a, b)
#define HG_PICK(_1, _2, _3, _4, _5, _6, name_, ...) name_
#define HG_ADD3(a, b, c)                            HG_ADD2(HG_ADD2(a, b), c)
#define HG_ADD4(a, b, c, d)                         HG_ADD2(HG_ADD3(a, b, c), d)
#define HG_ADD5(a, b, c, d, e)                      HG_ADD2(HG_ADD4(a, b, c, d), e)
#define HG_ADD6(a, b, c, d, e, f)                   HG_ADD2(HG_ADD5(a, b, c, d, e), f)
#define HG_MUL3(a, b, c)                            HG_MUL2(HG_MUL2(a, b), c)
#define HG_MUL4(a, b, c, d)                         HG_MUL2(HG_MUL3(a, b, c), d)
#define HG_MUL5(a, b, c, d, e)                      HG_MUL2(HG_MUL4(a, b, c, d), e)
#define HG_MUL6(a, b, c, d, e, f)                   HG_MUL2(HG_MUL5(a, b, c, d, e), f)
#define add(...)                                    HG_PICK(__VA_ARGS__, HG_ADD6, HG_ADD5, HG_ADD4, HG_ADD3, HG_ADD2, HG_ADD1, HG_ADD0)(__VA_ARGS__)
#define mul(...)                                    HG_PICK(__VA_ARGS__, HG_MUL6, HG_MUL5, HG_MUL4, HG_MUL3, HG_MUL2, HG_MUL1, HG_MUL0)(__VA_ARGS__)
#define sub(a, b)                                                                                                      \
    _Generic((a), hg_vec3                                                                                              \
             : hg_trace_vec3_sub, hg_quat                                                                              \
             : hg_trace_quat_sub, HG_NAME_SCALARS(sub, hg_trace_sub, a, b))(a, b)
#define divide(a, b)                                                                                                   \
    _Generic((a), hg_vec3                                                                                              \
             : _Generic((b), hg_scalar                                                                                 \
                        : hg_trace_vec3_div, default                                                                   \
                        : hg_name_vec3_div_vn),                                                                        \
               HG_NAME_SCALARS(div, hg_trace_div, a, b))(a, b)
#define neg(a)       _Generic((a), hg_vec3 : hg_trace_vec3_neg, hg_quat : hg_trace_quat_neg, hg_scalar : hg_trace_neg)(a)
#define dot(a, b)    _Generic((a), hg_vec3 : hg_trace_vec3_dot, hg_quat : hg_trace_quat_dot)(a, b)
#define cross(a, b)  hg_trace_vec3_cross(a, b)
#define norm(a)      _Generic((a), hg_vec3 : hg_trace_vec3_norm, hg_quat : hg_trace_quat_norm)(a)
#define normalize(a) _Generic((a), hg_vec3 : hg_trace_vec3_normalize, hg_quat : hg_trace_quat_normalize)(a)
#define square(a)                                                                                                      \
    _Generic((a), hg_vec3 : hg_trace_vec3_square, hg_quat : hg_trace_quat_square, hg_scalar : hg_trace_square)(a)

/* ---- functions ---------------------------------------------------------------------------------------------- */

#undef sqrt
#undef abs
#undef exp
#undef log
#undef sin
#undef cos
#undef atan2
#undef min
#undef max
#undef select
#undef conj
#define sqrt(a)             hg_trace_sqrt(a)
#define rsqrt(a)            hg_trace_rsqrt(a)
#define abs(a)              hg_trace_abs(a)
#define exp(a)              hg_trace_exp(a)
#define log(a)              hg_trace_log(a)
#define sin(a)              hg_trace_sin(a)
#define cos(a)              hg_trace_cos(a)
#define atan2(y_, x_)       _Generic((y_), HG_NAME_SCALARS(atan2, hg_trace_atan2, y_, x_))(y_, x_)
#define min(a, b)           _Generic((a), hg_vec3 : hg_trace_vec3_min, HG_NAME_SCALARS(min, hg_trace_min, a, b))(a, b)
#define max(a, b)           _Generic((a), hg_vec3 : hg_trace_vec3_max, HG_NAME_SCALARS(max, hg_trace_max, a, b))(a, b)
#define less(a, b)          _Generic((a), HG_NAME_SCALARS(less, hg_trace_less, a, b))(a, b)
#define clamp(a, low, high) hg_trace_clamp(HG_SCALAR(a), HG_SCALAR(low), HG_SCALAR(high))

static inline hg_scalar hg_name_select_nn(hg_scalar c, double a, double b)
{
    return hg_trace_select(c, hg_trace_number(a), hg_trace_number(b));
}
static inline hg_scalar hg_name_select_sn(hg_scalar c, hg_scalar a, double b)
{
    return hg_trace_select(c, a, hg_trace_number(b));
}
static inline hg_scalar hg_name_select_ns(hg_scalar c, double a, hg_scalar b)
{
    return hg_trace_select(c, hg_trace_number(a), b);
}
#define select(condition, a, b)                                                                                        \
    _Generic((a), hg_vec3                                                                                              \
             : hg_trace_vec3_select, hg_quat                                                                           \
             : hg_trace_quat_select, HG_NAME_SCALARS(select, hg_trace_select, a, b))(condition, a, b)
#define detach(a)                                                                                                      \
    _Generic((a), hg_vec3 : hg_trace_vec3_detach, hg_quat : hg_trace_quat_detach, hg_scalar : hg_trace_detach)(a)

/* ---- vectors and quaternions -------------------------------------------------------------------------------- */

static inline hg_vec3 hg_name_vector(hg_scalar a, hg_scalar b, hg_scalar c) { return (hg_vec3){ a, b, c }; }
static inline hg_quat hg_name_quaternion(hg_scalar w, hg_vec3 v) { return (hg_quat){ w, v }; }
#define vector(a, b, c)   hg_name_vector(HG_SCALAR(a), HG_SCALAR(b), HG_SCALAR(c))
#define quaternion(w, v)  hg_name_quaternion(HG_SCALAR(w), v)
#define conj(q)           hg_trace_quat_conj(q)
#define qmul(p, q)        hg_trace_quat_mul(p, q)
#define rotate(q, v)      hg_trace_quat_rotate(q, v)
#define transport(a, b)   hg_trace_transport(a, b)
#define tangent(a, b, l0) hg_trace_tangent(a, b, l0)
#define rest_length(a, b) hg_trace_rest_length(a, b)

/* ---- inputs ------------------------------------------------------------------------------------------------- */

#define x(k)                  hg_trace_x(k)
#define rest(k)               hg_trace_rest(k)
#define posed(k)              hg_trace_posed(k)
#define predicted(k)          hg_trace_predicted(k)
#define previous(k)           hg_trace_previous(k)
#define contact_point(k)      hg_trace_contact_point(k)
#define contact_normal(k)     hg_trace_contact_normal(k)
#define contact_distance(k)   hg_trace_contact_distance(k)
#define root_x(k)             hg_trace_root_x(k)
#define root_rest(k)          hg_trace_root_rest(k)
#define root_rotation()       hg_trace_root_rotation()
#define root_position()       hg_trace_root_position()
#define mass(k)               hg_trace_mass(k)
#define attribute(name, k)    hg_trace_attribute(name, k)
#define strand_length()       hg_trace_strand_length()
#define q(k)                  hg_trace_q(k)
#define frame_scalar(name, k) hg_trace_frame_scalar(name, k)
#define frame_vec3(name, k)   hg_trace_frame_vec3(name, k)
#define carry(name, first)                                                                                             \
    _Generic((first), hg_vec3                                                                                          \
             : hg_trace_carry_vec3, hg_quat                                                                            \
             : hg_trace_carry_quat, hg_scalar                                                                          \
             : hg_trace_carry_scalar)(name, first)
#define keep(name, value)                                                                                              \
    _Generic((value), hg_vec3                                                                                          \
             : hg_trace_keep_vec3, hg_quat                                                                             \
             : hg_trace_keep_quat, hg_scalar                                                                           \
             : hg_trace_keep_scalar)(name, value)
#define distance()           hg_trace_distance()
#define rest_distance()      hg_trace_rest_distance()
#define field()              hg_trace_field()
#define field_rest()         hg_trace_field_rest()
#define param(name)          hg_trace_param(name)
#define param3(name)         hg_trace_param3(name)
#define dt()                 hg_trace_dt()
#define option(name, choice) hg_trace_option(name, choice)
#define window(n)                                                                                                      \
    {                                                                                                                  \
        HG_SITE_WINDOW, n                                                                                              \
    }

#endif
