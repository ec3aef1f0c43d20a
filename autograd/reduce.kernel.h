/* Kernels of sums over the middle axis of [outer, n, inner], and of their gradient. */
#include "tensor/block.h"

#include "autograd/floats.h"

typedef struct {
    int64_t outer, n, inner;
    int64_t chunk;       /* outputs of one index of axis_forward */
    int64_t slab, slabs; /* of the partial sums: slab numbers each, slabs of them */
    double scale;
    const void *x, *g;
    double *partial; /* [outer, slabs, inner] */
    void *out;
    bool fresh;
} axis_args;

#define REAL   double
#define SUFFIX _f64
#include "autograd/reduce.inc"
#undef REAL
#undef SUFFIX
#define REAL   float
#define SUFFIX _f32
#include "autograd/reduce.inc"
#undef REAL
#undef SUFFIX

HG_KERNELS(axis_forward, axis_args, 1)
HG_KERNELS(axis_partial, axis_args, 4096)
HG_KERNELS(axis_finish, axis_args, 4096)
HG_KERNELS(axis_backward, axis_args, 4096)
HG_KERNELS_BLOCK(row_forward, axis_args, 64, 256)
HG_KERNELS_BLOCK(row_partial, axis_args, 1, 256)
HG_KERNELS_BLOCK(row_finish, axis_args, 1, 256)
