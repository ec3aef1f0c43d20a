/* The kernels of a physics behind functions: who calls them knows no arguments of kernels. */
#include "hairloss/physics_kernels.h"

#include "hairloss/physics.kernel.h"

#include <assert.h>

static_assert((int)HG_PHYSICS_PARTS == (int)PHYSICS_PARTS, "both say how many parts there are");

static hg_status run(hg_ctx *ctx, const hg_kernel *const kernels[2], hg_dtype dtype, int64_t n, const void *args)
{
    return n > 0 ? hg_launch(ctx, kernels[dtype == HG_F64], n, args) : HG_OK;
}

static void *room(hg_ctx *ctx, hg_dtype dtype, int64_t n)
{
    return hg_step_device(ctx, (size_t)n * hg_dtype_size(dtype) + 1);
}

/* Rows that one block of a GPU sums; the processor takes them all in a row. */
enum { CHUNK = 4096 };

hg_status hg_physics_sums(hg_ctx *ctx, hg_dtype dtype, const void *from, int64_t rows, int64_t columns,
                          hg_dtype to_dtype, void *to, const int32_t *column)
{
    column_args args = { from, rows, columns, hg_ctx_host(ctx) && rows > 0 ? rows : CHUNK, to, column };
    if (dtype != HG_F64 || (rows > CHUNK && !hg_ctx_host(ctx))) {
        const int64_t chunks = (rows + args.chunk - 1) / args.chunk;
        if (!(args.to = room(ctx, HG_F64, chunks * columns))) return HG_MEMORY;
        HG_TRY(run(ctx, column_partial_kernels, dtype, chunks * columns, &args));
        args = (column_args){ args.to, chunks, columns, 0, to, column };
    }
    return run(ctx, column_total_kernels, to_dtype, columns, &args);
}

hg_status hg_physics_weigh(hg_ctx *ctx, int64_t n, const double *energies, const double *weights, hg_tensor *to)
{
    const weigh_args args = { energies, weights, n, to->data };
    return run(ctx, weigh_kernels, to->dtype, 1, &args);
}

hg_status hg_physics_add_scaled(hg_ctx *ctx, hg_dtype dtype, int64_t n, const void *from, const void *scale, void *to,
                                bool fresh)
{
    const scale_args args = { from, scale, to, fresh };
    return run(ctx, add_scaled_kernels, dtype, n, &args);
}

void *hg_physics_of_groom(hg_ctx *ctx, hg_dtype dtype, const int32_t *groom, int64_t frames, int64_t strands,
                          int64_t width, const void *from)
{
    const int64_t n = frames * strands * width;
    const of_groom_args args = { from, groom, strands, width, room(ctx, dtype, n) };
    return args.to && run(ctx, of_groom_kernels, dtype, n, &args) == HG_OK ? args.to : NULL;
}

hg_status hg_physics_groom_sum(hg_ctx *ctx, hg_dtype dtype, const int32_t *groom, int64_t frames, int64_t grooms,
                               int64_t row, const void *from, void *to)
{
    const groom_sum_args args = { from, groom, frames, grooms, row, to };
    return run(ctx, groom_sum_kernels, dtype, row, &args);
}

void *hg_physics_repeat(hg_ctx *ctx, hg_dtype dtype, int64_t n, int64_t count, const void *from)
{
    const repeat_args args = { from, n, room(ctx, dtype, count) };
    return args.to && run(ctx, repeat_values_kernels, dtype, count, &args) == HG_OK ? args.to : NULL;
}

hg_status hg_physics_zero(hg_ctx *ctx, hg_dtype dtype, int64_t n, void *to)
{
    hg_tensor *all = n > 0 ? hg_tensor_wrap(ctx, dtype, 1, &n, to) : NULL;
    return n <= 0 ? HG_OK : all ? hg_tensor_fill(all, 0) : HG_MEMORY;
}

void *hg_physics_zeros(hg_ctx *ctx, hg_dtype dtype, int64_t n)
{
    void *to = room(ctx, dtype, n);
    return to && hg_physics_zero(ctx, dtype, n, to) == HG_OK ? to : NULL;
}

void *hg_physics_mean(hg_ctx *ctx, hg_dtype dtype, int64_t frames, int64_t group, int64_t row, const void *from)
{
    const mean_args args = { from, group, row, room(ctx, dtype, frames * row) };
    const int64_t n = group > 0 ? frames / group * row : 0;
    return args.to && run(ctx, frame_mean_kernels, dtype, n, &args) == HG_OK ? args.to : NULL;
}

void *hg_physics_lengths(hg_ctx *ctx, hg_dtype dtype, int64_t strands, int64_t vertices, const void *rest)
{
    const length_args args = { .rest = rest, .vertices = vertices, .length = room(ctx, dtype, strands * vertices) };
    return args.length && run(ctx, strand_length_kernels, dtype, strands, &args) == HG_OK ? args.length : NULL;
}

hg_status hg_physics_lengths_gradient(hg_ctx *ctx, hg_dtype dtype, int64_t strands, int64_t vertices, const void *rest,
                                      const void *length_gradient, void *rest_gradient)
{
    const length_args args = { rest, vertices, NULL, length_gradient, rest_gradient };
    return run(ctx, strand_length_gradient_kernels, dtype, strands, &args);
}

void *hg_physics_add_parts(hg_ctx *ctx, hg_dtype dtype, int64_t n, int parts, const void *const *part,
                           const int64_t *count)
{
    parts_args args = { .n = n, .parts = parts, .to = room(ctx, dtype, n) };
    for (int i = 0; i < parts; i++) {
        args.part[i] = part[i];
        args.count[i] = count[i];
    }
    return args.to && run(ctx, add_parts_kernels, dtype, n, &args) == HG_OK ? args.to : NULL;
}
