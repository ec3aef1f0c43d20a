/* Grid: points into cells by kernels alone; seven launches for all frames together. */
#include "geometry/grid.h"

#include "geometry/grid.kernel.h"

#include <string.h>

/* About two cells a point; at least four along an axis, so that the three around a cell are three. */
static void choose_bits(hg_grid *grid)
{
    int bits = 6;
    while (bits < 24 && ((int64_t)1 << bits) < 2 * grid->n) bits++;
    for (int k = 0; k < 3; k++) grid->bits[k] = (bits + 2 - k) / 3;
    grid->bits[3] = bits;
}

/* mark: what is behind it is not needed once the grid is made. */
static hg_status reserve(hg_ctx *ctx, hg_grid *grid, hg_dtype dtype, grid_args *args, grid_scan_args *scan,
                         hg_step_mark *mark)
{
    const size_t points = (size_t)(grid->frames * grid->n) + 1, real = hg_dtype_size(dtype);
    scan->n = grid->frames * hg_grid_cells(grid) + 2;
    scan->values = hg_step_device(ctx, (size_t)scan->n * sizeof(int32_t));
    grid->vertex = hg_step_device(ctx, points * sizeof(int32_t));
    grid->place = hg_step_device(ctx, points * sizeof(int32_t));
    grid->cell = hg_step_device(ctx, points * sizeof(int32_t));
    grid->x = hg_step_device(ctx, points * real);
    grid->y = hg_step_device(ctx, points * real);
    grid->z = hg_step_device(ctx, points * real);
    *mark = hg_step_set_mark(ctx);
    args->slot = hg_step_device(ctx, points * sizeof(int32_t));
    args->unordered = hg_step_device(ctx, points * sizeof(int32_t));
    scan->sums = hg_step_device(ctx, (size_t)(scan->n / GRID_CHUNK + 1) * sizeof(int32_t));
    const bool made = scan->values && grid->vertex && grid->place && grid->cell && grid->x && grid->y && grid->z &&
                      args->slot && args->unordered && scan->sums;
    grid->start = scan->values;
    args->grid = *grid;
    return made ? HG_OK : HG_MEMORY;
}

static hg_status build(hg_ctx *ctx, hg_grid *grid, hg_dtype dtype, grid_args *args)
{
    grid_scan_args scan;
    hg_step_mark mark;
    const int64_t all = grid->frames * grid->n;
    HG_TRY(reserve(ctx, grid, dtype, args, &scan, &mark));
    const int64_t chunks = (scan.n + GRID_CHUNK - 1) / GRID_CHUNK;
    hg_tensor *start = hg_tensor_wrap(ctx, HG_I32, 1, &scan.n, scan.values);
    if (!start) return HG_MEMORY;
    HG_TRY(hg_tensor_fill(start, 0));
    HG_TRY(hg_launch(ctx, grid_find_kernels[dtype == HG_F64], all, args));
    HG_TRY(hg_launch(ctx, &grid_chunks_kernel, chunks, &scan));
    HG_TRY(hg_launch(ctx, &grid_scan_sums_kernel, 1, &scan));
    HG_TRY(hg_launch(ctx, &grid_scan_kernel, chunks, &scan));
    HG_TRY(hg_launch(ctx, &grid_put_kernel, all, args));
    HG_TRY(hg_launch(ctx, grid_order_kernels[dtype == HG_F64], all, args));
    hg_step_rewind(ctx, mark);
    return HG_OK;
}

hg_status hg_grid_build(hg_ctx *ctx, hg_grid *grid, hg_dtype dtype, int64_t frames, int64_t n, const void *points,
                        const void *reach, double factor)
{
    *grid = (hg_grid){ .frames = frames, .n = n };
    choose_bits(grid);
    if (dtype != HG_F32 && dtype != HG_F64)
        return hg_fail(HG_INVALID, "grid: points are f32 or f64, not %s", hg_dtype_name(dtype));
    if (frames < 0 || n < 0 || (n > 0 && frames > (INT32_MAX - 2) / n) ||
        frames > (INT32_MAX - 2) / hg_grid_cells(grid))
        return hg_fail(HG_UNSUPPORTED, "grid: %lld frames of %lld points; %d points and cells can be numbered",
                       (long long)frames, (long long)n, INT32_MAX - 2);
    grid_args args = { .points = points, .reach = reach, .factor = factor };
    hg_profile_begin(ctx, "neighbours", "cells");
    const hg_status status = build(ctx, grid, dtype, &args);
    hg_profile_end(ctx, frames * n * (6 * (int64_t)hg_dtype_size(dtype) + 28));
    return status;
}
