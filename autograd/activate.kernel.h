/* Kernels of activate. Which function it is, is the same for all threads. */
#include "autograd/activation_kernel.h"

typedef struct {
    int activation, fresh;
    const void *x, *g, *saved;
    void *out, *derivative;
} activate_args;

#define REAL   float
#define SUFFIX _f32
#include "autograd/activate.inc"
#undef REAL
#undef SUFFIX
#define REAL   double
#define SUFFIX _f64
#include "autograd/activate.inc"
#undef REAL
#undef SUFFIX

HG_KERNELS(activate_forward, activate_args, 0)
HG_KERNELS(activate_backward_of, activate_args, 0)
