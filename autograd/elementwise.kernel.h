/* Kernels of the elementwise ops. */
#include "autograd/broadcast.h"

typedef struct {
    double numbers[2];
    const void *x, *y, *g;
    void *to;
    int fresh;
} unary_args;

#define REAL   float
#define SUFFIX _f32
#include "autograd/elementwise.inc"
#undef REAL
#undef SUFFIX
#define REAL   double
#define SUFFIX _f64
#include "autograd/elementwise.inc"
#undef REAL
#undef SUFFIX

HG_PAIR_KERNELS(add)
HG_PAIR_KERNELS(sub)
HG_PAIR_KERNELS(mul)
HG_PAIR_KERNELS(div)
HG_PAIR_KERNELS(minimum)
HG_PAIR_KERNELS(maximum)

#define UNARY_KERNELS(NAME_) HG_KERNELS(NAME_##_forward, unary_args, 0) HG_KERNELS(NAME_##_backward, unary_args, 0)
UNARY_KERNELS(scale)
UNARY_KERNELS(square)
UNARY_KERNELS(sqrt)
UNARY_KERNELS(exp)
UNARY_KERNELS(log)
UNARY_KERNELS(abs)
UNARY_KERNELS(clamp)
