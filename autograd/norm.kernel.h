/* Kernels of softmax and of layer and group normalisation. */
#include "tensor/block.h"

#include "autograd/floats.h"

typedef struct {
    int64_t rows, n, groups, inner, chunk;
    double epsilon;
    const void *x, *gain, *bias, *g;
    void *y, *statistics, *dx, *dgain, *dbias, *products;
    bool fresh;
} norm_args;

#define REAL   float
#define SUFFIX _f32
#include "autograd/norm.inc"
#undef REAL
#undef SUFFIX
#define REAL   double
#define SUFFIX _f64
#include "autograd/norm.inc"
#undef REAL
#undef SUFFIX

HG_KERNELS_BLOCK(softmax_forward, norm_args, 32, 128)
HG_KERNELS_BLOCK(softmax_backward, norm_args, 32, 128)
HG_KERNELS_BLOCK(normalise_forward, norm_args, 32, 128)
HG_KERNELS_GPU(normalise_gradient, norm_args, 128)
HG_KERNELS_CPU(normalise_backward, norm_args, 1)
