/* grid: points of several frames sorted into cubes at least `radius` wide, made by kernels alone: on a GPU nothing of it
 * passes through the host. What lies within the radius of a point is in the 27 cells around its own.
 *
 * The cells are a box of powers of two that repeats without end in all directions, so that no box of the points is needed
 * and none can run out of it: points that are a whole box apart share a cell, and their distance tells them apart. A
 * frame has its own cells. Cells along +x follow each other; the points of a cell are in ascending order, whatever the
 * order of threads; those that are not finite are behind all others, in no order.
 *
 *     hg_grid grid;
 *     hg_grid_build(ctx, &grid, HG_F32, frames, n, points, NULL, radius);          until hg_step_reset or a rewind
 *     in a kernel, for a place i < hg_grid_placed(&grid), with k = grid.vertex[i] its point (frame * n + number):
 *         for (int part = 0; part < HG_GRID_RUNS; part++) {
 *             hg_grid_run(&grid, grid.cell[k], part, &first, &last);
 *             ... places first .. last - 1; positions ((const float *)grid.x)[place] and so on
 *         }
 *
 * bits: of the number of cells along x, y, z, and of a whole frame. start [frames * cells + 2]: first place of each cell,
 * then of what is not finite, then the end. vertex, x, y, z by place; place, cell by point. */
#ifndef HG_GEOMETRY_GRID_H
#define HG_GEOMETRY_GRID_H

#include "tensor/kernel.h"

#include "geometry/grid_walk.inc"

/* The radius is factor * *reach, with reach one number of the device in the dtype (so that a step may change it), or
 * factor where reach is NULL. With a radius that is not positive and finite no point gets a place. */
hg_status hg_grid_build(hg_ctx *ctx, hg_grid *grid, hg_dtype dtype, int64_t frames, int64_t n,
                        const void *points /* [frames,n,3] */, const void *reach, double factor);

#endif
