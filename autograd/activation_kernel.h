/* The activation functions, for the kernels that fuse them. */
#ifndef HG_AUTOGRAD_ACTIVATION_KERNEL_H
#define HG_AUTOGRAD_ACTIVATION_KERNEL_H

#include "autograd/floats.h"
#include "tensor/kernel.h"

#ifdef HG_CUDA /* as autograd.h has them */
enum { HG_IDENTITY, HG_RELU, HG_LEAKY_RELU, HG_ELU, HG_TANH, HG_SIGMOID, HG_SILU, HG_GELU, HG_SOFTPLUS };
#else
#include "autograd/tape.h"
#endif

#define HG_LEAK 0.01 /* of leaky_relu */

#define REAL   float
#define SUFFIX _f32
#include "autograd/activation.inc"
#undef REAL
#undef SUFFIX
#define REAL   double
#define SUFFIX _f64
#include "autograd/activation.inc"
#undef REAL
#undef SUFFIX

#endif
