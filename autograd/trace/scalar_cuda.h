/* scalar_cuda (private): the functions that a printed formula calls, as CUDA C++ for one value, in float and in double: those of
 * strand_vector.h for one lane. A printed text says `hg_v` for its type. */
#ifndef HG_SCALAR_CUDA_H
#define HG_SCALAR_CUDA_H

#define HG_R(literal) ((hg_v)literal)
#define HG_SCALAR_FUNCTIONS(real, f)                                                                                   \
    static __device__ inline real hg_v_all(real a) { return a; }                                                       \
    static __device__ inline real hg_v_sqrt(real a) { return sqrt##f(a); }                                             \
    static __device__ inline real hg_v_rsqrt(real a) { return (real)1 / sqrt##f(a); }                                  \
    static __device__ inline real hg_v_abs(real a) { return fabs##f(a); }                                              \
    static __device__ inline real hg_v_exp(real a) { return exp##f(a); }                                               \
    static __device__ inline real hg_v_log(real a) { return log##f(a); }                                               \
    static __device__ inline real hg_v_sin(real a) { return sin##f(a); }                                               \
    static __device__ inline real hg_v_cos(real a) { return cos##f(a); }                                               \
    static __device__ inline real hg_v_atan2(real a, real b) { return atan2##f(a, b); }                                \
    static __device__ inline real hg_v_min(real a, real b) { return b < a ? b : a; }                                   \
    static __device__ inline real hg_v_max(real a, real b) { return a < b ? b : a; }                                   \
    static __device__ inline real hg_v_less(real a, real b) { return a < b ? (real)1 : (real)0; }                      \
    static __device__ inline real hg_v_select(real c, real a, real b) { return c != 0 ? a : b; }                       \
    static __device__ inline real hg_v_if_less(real a, real b, real c, real d) { return a < b ? c : d; }
HG_SCALAR_FUNCTIONS(float, f)
HG_SCALAR_FUNCTIONS(double, )
#undef HG_SCALAR_FUNCTIONS

#endif
