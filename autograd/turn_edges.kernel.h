/* Kernels of turn_edges. */
#include "autograd/floats.h"

#define LEAST_LENGTH 1e-9 /* m, where divided by */
#define LEAST_SQUARE 1e-4

typedef struct {
    int64_t strands, edges, turned;
    int fresh;
    const void *a, *rest, *g;
    void *d, *da;
} turn_args;

#define REAL   float
#define SUFFIX _f32
#include "autograd/turn_edges.inc"
#undef REAL
#undef SUFFIX
#define REAL   double
#define SUFFIX _f64
#include "autograd/turn_edges.inc"
#undef REAL
#undef SUFFIX

HG_KERNELS(turn_forward, turn_args, 64)
HG_KERNELS(turn_backward, turn_args, 64)
