/* physics_kernels (private): what the parts of a physics have computed on the device beside their energies; the bodies are in
 * physics.kernel.h. Every pointer is memory of the device, and what is returned is in the step arena, NULL without memory. */
#ifndef HG_HAIRLOSS_PHYSICS_KERNELS_H
#define HG_HAIRLOSS_PHYSICS_KERNELS_H

#include "tensor/tensor.h"

/* Sums of the columns of [rows,columns], in f64 and in fixed order; that of column i goes to to[column[i]], or to[i]. */
hg_status hg_physics_sums(hg_ctx *ctx, hg_dtype dtype, const void *from, int64_t rows, int64_t columns,
                          hg_dtype to_dtype, void *to, const int32_t *column);
/* to [] = sum of weights * energies */
hg_status hg_physics_weigh(hg_ctx *ctx, int64_t n, const double *energies, const double *weights, hg_tensor *to);
/* to += scale [] * from; fresh: to = */
hg_status hg_physics_add_scaled(hg_ctx *ctx, hg_dtype dtype, int64_t n, const void *from, const void *scale, void *to,
                                bool fresh);
/* [B,S,width] of the groom of each frame, from [G,S,width] */
void *hg_physics_of_groom(hg_ctx *ctx, hg_dtype dtype, const int32_t *groom, int64_t frames, int64_t strands,
                          int64_t width, const void *from);
/* [B,row] to the groom of each frame [G,row] */
hg_status hg_physics_groom_sum(hg_ctx *ctx, hg_dtype dtype, const int32_t *groom, int64_t frames, int64_t grooms,
                               int64_t row, const void *from, void *to);
/* `count` numbers: n of them again and again */
void *hg_physics_repeat(hg_ctx *ctx, hg_dtype dtype, int64_t n, int64_t count, const void *from);
void *hg_physics_zeros(hg_ctx *ctx, hg_dtype dtype, int64_t n);
hg_status hg_physics_zero(hg_ctx *ctx, hg_dtype dtype, int64_t n, void *to);
/* [frames,row] of the mean of each `group` frames */
void *hg_physics_mean(hg_ctx *ctx, hg_dtype dtype, int64_t frames, int64_t group, int64_t row, const void *from);
/* [strands,V] from rest [strands,V,3], and the gradient that came to it back to that of rest */
void *hg_physics_lengths(hg_ctx *ctx, hg_dtype dtype, int64_t strands, int64_t vertices, const void *rest);
hg_status hg_physics_lengths_gradient(hg_ctx *ctx, hg_dtype dtype, int64_t strands, int64_t vertices, const void *rest,
                                      const void *length_gradient, void *rest_gradient);
/* n sums: of every part each n-th number */
enum { HG_PHYSICS_PARTS = 32 };
void *hg_physics_add_parts(hg_ctx *ctx, hg_dtype dtype, int64_t n, int parts, const void *const *part,
                           const int64_t *count);

#endif
