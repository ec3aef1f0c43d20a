/* Vectors and quaternions: small values passed by value, the same text for C and CUDA, for float and double.
 *
 *     hg_vec3d a = hg_vec3d_load(x + 3 * i), b = hg_vec3d_load(x + 3 * i + 3);
 *     hg_quatd turn = hg_quatd_transport(hg_vec3d_normalize(a), hg_vec3d_normalize(b));
 *     hg_vec3d_store(out, hg_quatd_rotate(turn, a));
 *
 * hg_vec3d, hg_quatd and their functions are double; hg_vec3f, hg_quatf are float: the same names with f for d.
 * Quaternions are (w,x,y,z), Hamilton's product: rotate(mul(p, q), v) = rotate(p, rotate(q, v)). Matrices are [9],
 * row-major, and act on columns: rotate(from_matrix(m), v) = m v. Angles are radians. Functions that expect a unit
 * vector or quaternion say so; every function is finite for finite input, zero vectors included.
 *
 * The functions themselves are in geometry/vector_functions.h, which is read once per precision.
 */
#ifndef HG_VECTOR_H
#define HG_VECTOR_H

#ifdef __CUDACC__
#define HG_INLINE static inline __host__ __device__
#else
#define HG_INLINE static inline __attribute__((unused))
#endif
#ifndef __CUDACC_RTC__
#include <math.h>
#endif

#define HG_JOIN_(a, b, c) a##b##c
#define HG_JOIN(a, b, c)  HG_JOIN_(a, b, c)
#define HG_V(name)        HG_JOIN(hg_vec3, HG_SUFFIX, _##name)
#define HG_Q(name)        HG_JOIN(hg_quat, HG_SUFFIX, _##name)

/* h of transport(a -> b) is (a + b) / sqrt(max(|a + b|^2, this)): exact up to 0.01 rad before antiparallel. */
#define HG_TRANSPORT_GUARD 1e-4

#define hg_real       double
#define HG_SUFFIX     d
#define HG_VEC3       hg_vec3d
#define HG_QUAT       hg_quatd
#define HG_MATH(name) name
#include "geometry/vector_functions.h"
#undef hg_real
#undef HG_SUFFIX
#undef HG_VEC3
#undef HG_QUAT
#undef HG_MATH

#define hg_real       float
#define HG_SUFFIX     f
#define HG_VEC3       hg_vec3f
#define HG_QUAT       hg_quatf
#define HG_MATH(name) name##f
#include "geometry/vector_functions.h"
#undef hg_real
#undef HG_SUFFIX
#undef HG_VEC3
#undef HG_QUAT
#undef HG_MATH

HG_INLINE hg_vec3f hg_vec3f_from_d(hg_vec3d a) { return hg_vec3f_make((float)a.x, (float)a.y, (float)a.z); }
HG_INLINE hg_vec3d hg_vec3d_from_f(hg_vec3f a) { return hg_vec3d_make((double)a.x, (double)a.y, (double)a.z); }
HG_INLINE hg_quatf hg_quatf_from_d(hg_quatd q) { return hg_quatf_make((float)q.w, (float)q.x, (float)q.y, (float)q.z); }
HG_INLINE hg_quatd hg_quatd_from_f(hg_quatf q)
{
    return hg_quatd_make((double)q.w, (double)q.x, (double)q.y, (double)q.z);
}

#endif
