/* geometry: spatial structures on plain arrays: closest triangle of a moving body, neighbour grid, clusters.
 *
 * Vector and quaternion maths (static inline, float and double, C and CUDA) is in "geometry/vector.h".
 * Points and vertices are f32 or f64 as `dtype` says; indices are i32. Everything is deterministic, whatever the threads.
 */
#ifndef HG_GEOMETRY_H
#define HG_GEOMETRY_H

#include "tensor/tensor.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- body tree ---------------------------------------------------------------------------------------------- */

/* A bounding-volume tree over triangles. Topology is built once from the rest body; hg_body_refit_update moves it to the
 * vertices of a frame, or of several. Vertices, points and what comes out are memory of the context's device. A vertex that is
 * not finite is an error on the host; elsewhere, where nothing waits for the device, contacts are not a number then. A refit
 * belongs to the device of its first update and, where that is not the host, is destroyed before the context. */
typedef struct hg_body_tree hg_body_tree;
typedef struct hg_body_refit hg_body_refit;                      /* boxes, vertices and normals of a frame */

hg_status hg_body_tree_create(hg_body_tree **tree, int64_t n_vertices, const double *rest_vertices /* [N,3] */, int64_t n_faces, const int32_t *faces /* [F,3] */);
void      hg_body_tree_destroy(hg_body_tree *tree);
int64_t   hg_body_tree_faces(const hg_body_tree *tree);
int64_t   hg_body_tree_vertices(const hg_body_tree *tree);
hg_status hg_body_refit_create(hg_body_refit **refit, const hg_body_tree *tree, hg_dtype dtype);
void      hg_body_refit_destroy(hg_body_refit *refit);
hg_status hg_body_refit_update(hg_ctx *ctx, hg_body_refit *refit, const void *vertices /* [N,3], dtype of the refit */);
/* Several frames in as many launches as one: room for `most` of them, and below n are the points of each. */
hg_status hg_body_refit_create_frames(hg_body_refit **refit, const hg_body_tree *tree, hg_dtype dtype, int64_t most);
hg_status hg_body_refit_update_frames(hg_ctx *ctx, hg_body_refit *refit, int64_t frames, const void *vertices /* [frames,N,3] */);

typedef enum { HG_CONTACT_PLANE, HG_CONTACT_EXACT } hg_contact_mode;
/* For every point: the closest triangle by true point-triangle distance (ties within 1e-6 m: the one with the largest
 * |n.(x - a)|, then the lowest index), and the contact as a plane (a, n) whose signed distance is n.(x - a):
 *   PLANE: the triangle's plane, as published;  EXACT: a the closest point, n the unit vector from it to x, turned
 *   outwards (sign by angle-weighted normals, Baerentzen and Aanaes 2005), so that n.(x - a) is the signed distance.
 * triangle [n] i32 is in and out: on entry a guess (or -1) that bounds the search, on exit the closest. A point that is
 * outside by more than `reach` may be reported with triangle -1, a = x - n reach, n = +Y (reach INFINITY: never).
 * Non-finite points get triangle -1 and n = 0, a = 0. */
hg_status hg_body_closest(hg_ctx *ctx, const hg_body_refit *refit, hg_contact_mode mode, double reach, int64_t n,
                          const void *points /* [n,3] */, int32_t *triangle, void *contact_point /* [n,3] */, void *contact_normal /* [n,3] */);
/* One point, plain loops over all triangles, f64: what the tree is checked against. */
void hg_body_closest_brute(int64_t n_vertices, const double *vertices, int64_t n_faces, const int32_t *faces, hg_contact_mode mode,
                           const double point[3], int32_t *triangle, double contact_point[3], double contact_normal[3]);

/* ---- cells -------------------------------------------------------------------------------------------------- */

/* Points sorted into cubes at least `radius` wide: what lies within the radius of a point is in the 27 cells around its
 * own. Cells along +x follow each other, so these are 9 runs of places (hg_cells_runs). Sorting is stable, points that
 * are not finite are left out, memory is kept from build to build; {0} is empty. Far outliers share the outermost cells.
 * Cells, neighbours and pairs are the host's and take a context of the processor; geometry/grid.h is what kernels of any
 * device make of points.
 *
 *     hg_cells cells = { 0 };
 *     hg_cells_build(ctx, &cells, HG_F32, n, points, radius);
 *     for (int64_t i = 0; i < cells.n; i++) {
 *         int32_t runs[HG_CELL_RUNS][2];
 *         int k = hg_cells_runs(&cells, cells.cell[i], runs);
 *         ... places runs[0][0] .. runs[0][1] - 1 and so on; x, y, z are cells.x[place] ..., the point cells.index[place]
 *     }
 *     hg_cells_free(&cells); */
#define HG_CELL_RUNS 9
#define HG_CELL_PAD  16     /* x, y, z have this many more elements, far away, so that a vector may be read past the end */
typedef struct {
    hg_dtype dtype;
    int64_t n;                                                   /* points that are finite */
    int32_t size[3];                                             /* cells along x, y, z */
    double lo[3], width;                                         /* corner of cell 0 and width of a cell [m] */
    int32_t *start;                                              /* [cells+1] first place of each cell */
    int32_t *index;                                              /* [n] number of the point at each place, ascending in a cell */
    int32_t *cell;                                               /* [n] cell of each place */
    void *x, *y, *z;                                             /* [n+pad] positions by place */
    int64_t capacity, cell_capacity;
    int32_t *scratch;
} hg_cells;
hg_status hg_cells_build(hg_ctx *ctx, hg_cells *cells, hg_dtype dtype, int64_t n, const void *points /* [n,3] */, double radius);
void      hg_cells_free(hg_cells *cells);
static inline int hg_cells_runs(const hg_cells *cells, int32_t cell, int32_t runs[HG_CELL_RUNS][2]) /* returns how many are not empty */
{
    int32_t nx = cells->size[0], ny = cells->size[1], nz = cells->size[2];
    int32_t cx = cell % nx, cy = cell / nx % ny, cz = cell / nx / ny;
    int n = 0;
    for (int32_t z = cz > 0 ? cz - 1 : 0; z <= (cz + 1 < nz ? cz + 1 : cz); z++)
        for (int32_t y = cy > 0 ? cy - 1 : 0; y <= (cy + 1 < ny ? cy + 1 : cy); y++) {
            int32_t row = (z * ny + y) * nx;
            int32_t first = cells->start[row + (cx > 0 ? cx - 1 : 0)], last = cells->start[row + (cx + 1 < nx ? cx + 1 : cx) + 1];
            if (first == last) continue;
            runs[n][0] = first;
            runs[n++][1] = last;
        }
    return n;
}

/* ---- neighbour grid ----------------------------------------------------------------------------------------- */

/* All pairs within a radius, as rows: neighbours of point i are list[start[i] .. start[i+1]), in ascending order,
 * i itself left out. Built by counting sort into cells of one radius. Memory is kept from build to build. */
typedef struct hg_neighbours hg_neighbours;
hg_status hg_neighbours_create(hg_neighbours **neighbours, int64_t capacity_pairs /* 0: grows as needed */);
void      hg_neighbours_destroy(hg_neighbours *neighbours);
/* HG_INVALID when a fixed capacity is too small: the message and `needed` (may be NULL) say the size that would do. */
hg_status hg_neighbours_build(hg_ctx *ctx, hg_neighbours *neighbours, hg_dtype dtype, int64_t n, const void *points /* [n,3] */, double radius, int64_t *needed);
const int64_t *hg_neighbours_start(const hg_neighbours *neighbours); /* [n+1] */
const int32_t *hg_neighbours_list(const hg_neighbours *neighbours);

/* ---- pairs and clusters ------------------------------------------------------------------------------------- */

/* A list of directed pairs (i, j) with, per vertex, the pairs it takes part in from either side. */
typedef struct { int64_t n_vertices, n_pairs; int32_t *pairs /* [M,2] */; int64_t *start /* [n_vertices+1] */; int32_t *incident /* [2M]: pair * 2 + side */; } hg_pairs;
/* For every vertex its up to `count` nearest vertices of OTHER strands within radius at rest. points [S*V,3] f64. */
hg_status hg_pairs_nearest(hg_ctx *ctx, hg_pairs **pairs, int64_t strands, int64_t vertices, const double *points, double radius, int count);
hg_status hg_pairs_from_list(hg_pairs **pairs, int64_t n_vertices, int64_t n_pairs, const int32_t *list);
void      hg_pairs_destroy(hg_pairs *pairs);

/* Deterministic clusters of about `size` points in the plane (root UV): balanced recursive cuts, refined by a fixed
 * number of Lloyd rounds. cluster [n] gets 0 .. *count-1. */
hg_status hg_clusters(int64_t n, const float *uv /* [n,2] */, int size, int32_t *cluster, int32_t *count);

#ifdef __cplusplus
}
#endif
#endif
