/* Kernels of place. */
#include "autograd/floats.h"

typedef struct {
    int64_t strands, vertices;
    int shared_rest, fresh;
    const void *d, *rest, *rotation, *position, *g;
    void *x, *dd;
} place_args;

#define REAL   float
#define SUFFIX _f32
#include "autograd/place.inc"
#undef REAL
#undef SUFFIX
#define REAL   double
#define SUFFIX _f64
#include "autograd/place.inc"
#undef REAL
#undef SUFFIX

HG_KERNELS(place_forward, place_args, 2048)
HG_KERNELS(place_backward, place_args, 2048)
