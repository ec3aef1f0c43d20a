/* Kernels are written once in a .inc file over REAL and F(name), and included for f32 and for f64. */
#ifndef HG_AUTOGRAD_FLOATS_H
#define HG_AUTOGRAD_FLOATS_H

#include "tensor/math.h"

#define HG_JOIN_(a_, b_) a_##b_
#define HG_JOIN(a_, b_)  HG_JOIN_(a_, b_)
#define F(name_)         HG_JOIN(name_, SUFFIX)

/* Before a loop that has to become vectors. In f64 the C library's functions are called one by one, so there it is only
 * the compiler's choice: HG_SIMD is empty while the f64 kernels are included. */
#ifdef HG_CUDA
#define HG_SIMD_f32
#else
#define HG_SIMD_f32 _Pragma("omp simd")
#endif
#define HG_SIMD_f64
#define HG_SIMD HG_JOIN(HG_SIMD, SUFFIX)

#endif
