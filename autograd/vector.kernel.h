/* Kernels of the ops on vectors and quaternions. */
#include "autograd/broadcast.h"

typedef struct {
    int64_t width;
    const void *x, *g;
    void *y, *d;
    int fresh;
} row_args;

#define REAL   float
#define SUFFIX _f32
#include "autograd/vector.inc"
#undef REAL
#undef SUFFIX
#define REAL   double
#define SUFFIX _f64
#include "autograd/vector.inc"
#undef REAL
#undef SUFFIX

HG_PAIR_KERNELS(dot)
HG_PAIR_KERNELS(cross)
HG_PAIR_KERNELS(quat_mul)
HG_PAIR_KERNELS(quat_rotate)
HG_PAIR_KERNELS(transport)

#define ROW_KERNELS(NAME_)                                                                                             \
    HG_KERNELS(NAME_##_forward, row_args, 512)                                                                         \
    HG_KERNELS(NAME_##_backward, row_args, 512)
ROW_KERNELS(norm)
ROW_KERNELS(normalize)
ROW_KERNELS(quat_conjugate)
