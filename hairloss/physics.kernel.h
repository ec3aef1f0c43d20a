/* What a physics computes beside its energies: sums, what a call leaves out, and what its gradients are made of. */
#include "autograd/floats.h"
#include "tensor/block.h"

/* Sums of columns in f64. partial: chunk c of the rows [rows,columns] goes to row c of `to`; total: all rows, f64 already, go to
 * to[column[i]], or to[i]. */
typedef struct {
    const void *from;
    int64_t rows, columns, chunk;
    void *to;
    const int32_t *column;
} column_args;

/* The weighted sum of n energies. */
typedef struct {
    const double *energies, *weights;
    int64_t n;
    void *to;
} weigh_args;

/* to += scale from, where scale is one number; fresh: to = scale from. */
typedef struct {
    const void *from, *scale;
    void *to;
    int64_t fresh;
} scale_args;

/* Rows of `width` numbers: row i of the frames [B,S] is row i % strands of the frame's groom in `from` [G,S,width]. */
typedef struct {
    const void *from;
    const int32_t *groom; /* [B], NULL: all 0 */
    int64_t strands, width;
    void *to;
} of_groom_args;

/* to[i] = from[i % n] */
typedef struct {
    const void *from;
    int64_t n;
    void *to;
} repeat_args;

/* to[groom] = sum of the frames of that groom, row by row: [B,row] to [G,row]. */
typedef struct {
    const void *from;
    const int32_t *groom;
    int64_t frames, grooms, row;
    void *to;
} groom_sum_args;

/* Means over sequences of `group` frames of `row` numbers, for each of their frames. */
typedef struct {
    const void *from;
    int64_t group, row;
    void *to;
} mean_args;

/* Rest lengths of strands of a groom that is given, at each of their vertices; and what came to them goes on to the groom. */
typedef struct {
    const void *rest;
    int64_t vertices;
    void *length;
    const void *length_gradient;
    void *rest_gradient;
} length_args;

/* Gradients of values that are made of one tensor, of n numbers: each is n numbers again and again. */
enum { PHYSICS_PARTS = 32 };
typedef struct {
    int64_t n;
    int parts;
    const void *part[PHYSICS_PARTS];
    int64_t count[PHYSICS_PARTS];
    void *to;
} parts_args;

#define REAL   double
#define SUFFIX _f64
#include "hairloss/physics.inc"
#undef REAL
#undef SUFFIX
#define REAL   float
#define SUFFIX _f32
#include "hairloss/physics.inc"
#undef REAL
#undef SUFFIX

HG_KERNELS_BLOCK(column_partial, column_args, 1, 256)
HG_KERNELS_BLOCK(column_total, column_args, 1, 256)
HG_KERNELS(weigh, weigh_args, 1)
HG_KERNELS(add_scaled, scale_args, 65536)
HG_KERNELS(of_groom, of_groom_args, 4096)
HG_KERNELS(repeat_values, repeat_args, 65536)
HG_KERNELS(groom_sum, groom_sum_args, 4096)
HG_KERNELS(frame_mean, mean_args, 4096)
HG_KERNELS(strand_length, length_args, 256)
HG_KERNELS(strand_length_gradient, length_args, 256)
HG_KERNELS(add_parts, parts_args, 4096)
