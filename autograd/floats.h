/* Kernels are written once in a .inc file over REAL and F(name), and included for f32 and for f64. */
#ifndef HG_AUTOGRAD_FLOATS_H
#define HG_AUTOGRAD_FLOATS_H

#include "tensor/math.h"

#define HG_JOIN_(a_, b_) a_##b_
#define HG_JOIN(a_, b_)  HG_JOIN_(a_, b_)
#define F(name_)         HG_JOIN(name_, SUFFIX)

#endif
