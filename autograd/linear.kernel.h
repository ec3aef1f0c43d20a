/* Kernels of the linear family, element by element: what stands beside the products where they are not fused. */
#include "autograd/activation_kernel.h"

typedef struct {
    int activation;
    int64_t width; /* n_out */
    const void *bias;
    void *out, *saved; /* out is the product when it comes in */
} finish_args;

typedef struct {
    int activation;
    const void *gradient, *saved;
    void *dz;
} dz_args;

typedef struct {
    int dtype, activation;
    int64_t rows, groups, width;
    const void *row_values, *group_values, *gradient;
    void *out, *saved, *drows, *dgroups, *scratch;
    bool drows_fresh;
} pair_args;

#define REAL   float
#define SUFFIX _f32
#include "autograd/linear.inc"
#undef REAL
#undef SUFFIX
#define REAL   double
#define SUFFIX _f64
#include "autograd/linear.inc"
#undef REAL
#undef SUFFIX

HG_KERNELS(linear_finish, finish_args, 4096)
HG_KERNELS(linear_dz, dz_args, 4096)
HG_KERNELS(pair_elements, pair_args, 4096)
