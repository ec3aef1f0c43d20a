/* Images [..,height,width] to twice their size. Forward an index is a pixel of the large image, backward one of the small. */
#include "tensor/kernel.h"

typedef struct {
    const void *from;
    void *to;
    int64_t height, width; /* of the small image */
    int fresh;             /* backward: nothing was added yet */
} upsample_args;

#define REAL   float
#define SUFFIX _f32
#include "autograd/upsample.inc"
#undef REAL
#undef SUFFIX
#define REAL   double
#define SUFFIX _f64
#include "autograd/upsample.inc"
#undef REAL
#undef SUFFIX

HG_KERNELS(upsample_nearest, upsample_args, 16384)
HG_KERNELS(upsample_nearest_backward, upsample_args, 16384)
HG_KERNELS(upsample_bilinear, upsample_args, 16384)
HG_KERNELS(upsample_bilinear_backward, upsample_args, 16384)
