/* Pairs of vertices that belong together, such as neighbouring hairs for adhesion, with the way back from a vertex to
 * its pairs, so that forces can be gathered without conflicts. */
#include "geometry/geometry.h"

#include <string.h>

typedef struct {
    const hg_cells *cells;
    int64_t vertices;
    double radius;
    int count;
    int32_t *nearest; /* [n, count], -1 where there are fewer */
} nearest_args;

static void nearest_block(const void *args, int64_t first, int64_t last)
{
    const nearest_args *a = args;
    const hg_cells *cells = a->cells;
    const double *x = cells->x, *y = cells->y, *z = cells->z;
    double best[32];
    for (int64_t i = first; i < last; i++) {
        int32_t self = cells->index[i], *nearest = a->nearest + (int64_t)self * a->count;
        int64_t strand = self / a->vertices;
        int32_t runs[HG_CELL_RUNS][2];
        int n_runs = hg_cells_runs(cells, cells->cell[i], runs), found = 0;
        for (int r = 0; r < n_runs; r++)
            for (int32_t q = runs[r][0]; q < runs[r][1]; q++) {
                double dx = x[q] - x[i], dy = y[q] - y[i], dz = z[q] - z[i], d2 = dx * dx + dy * dy + dz * dz;
                int32_t other = cells->index[q];
                if (d2 > a->radius * a->radius || other / a->vertices == strand) continue;
                int at = found;
                while (at > 0 && (d2 < best[at - 1] || (d2 == best[at - 1] && other < nearest[at - 1]))) at--;
                if (at == a->count) continue;
                if (found < a->count) found++;
                for (int k = found - 1; k > at; k--) {
                    best[k] = best[k - 1];
                    nearest[k] = nearest[k - 1];
                }
                best[at] = d2;
                nearest[at] = other;
            }
    }
}

hg_status hg_pairs_nearest(hg_ctx *ctx, hg_pairs **out, int64_t strands, int64_t vertices, const double *points,
                           double radius, int count)
{
    static const hg_kernel kernel = {
        .name = "pairs_nearest", .args_size = sizeof(nearest_args), .cpu = nearest_block, .block = 512
    };
    *out = NULL;
    if (strands < 0 || vertices < 0 || count < 0 || count > 32)
        return hg_fail(HG_INVALID, "pairs: %lld strands of %lld vertices, %d neighbours each; the last is from 0 to 32",
                       (long long)strands, (long long)vertices, count);
    int64_t n = strands * vertices;
    hg_cells cells = { 0 };
    int32_t *nearest = NULL;
    hg_status status = hg_cells_build(ctx, &cells, HG_F64, n, points, radius);
    if (status == HG_OK) {
        nearest = hg_alloc((size_t)n * (size_t)count + 1, sizeof *nearest);
        if (!nearest) status = HG_MEMORY;
    }
    if (status == HG_OK) {
        for (int64_t i = 0; i < n * count; i++) nearest[i] = -1;
        nearest_args args = { &cells, vertices > 0 ? vertices : 1, radius, count, nearest };
        status = hg_launch(ctx, &kernel, count > 0 ? cells.n : 0, &args);
    }
    if (status == HG_OK) {
        int64_t n_pairs = 0;
        for (int64_t i = 0; i < n * count; i++) n_pairs += nearest[i] >= 0;
        int32_t *list = hg_alloc(2 * (size_t)n_pairs + 1, sizeof *list);
        if (!list) {
            status = HG_MEMORY;
        } else {
            int64_t at = 0;
            for (int64_t i = 0; i < n * count; i++) {
                if (nearest[i] < 0) continue;
                list[at++] = (int32_t)(i / count);
                list[at++] = nearest[i];
            }
            status = hg_pairs_from_list(out, n, n_pairs, list);
            hg_free(list);
        }
    }
    hg_free(nearest);
    hg_cells_free(&cells);
    return status;
}

hg_status hg_pairs_from_list(hg_pairs **out, int64_t n_vertices, int64_t n_pairs, const int32_t *list)
{
    *out = NULL;
    if (n_vertices < 0 || n_pairs < 0 || n_pairs > INT32_MAX / 2 || n_vertices > INT32_MAX)
        return hg_fail(HG_INVALID, "pairs: %lld pairs of %lld vertices; at most %d pairs can be numbered",
                       (long long)n_pairs, (long long)n_vertices, INT32_MAX / 2);
    for (int64_t i = 0; i < 2 * n_pairs; i++)
        if (list[i] < 0 || list[i] >= n_vertices)
            return hg_fail(HG_INVALID, "pairs: pair %lld names vertex %d, but there are %lld", (long long)(i / 2),
                           list[i], (long long)n_vertices);
    hg_pairs *pairs = hg_alloc(1, sizeof *pairs);
    if (!pairs) return HG_MEMORY;
    pairs->n_vertices = n_vertices;
    pairs->n_pairs = n_pairs;
    pairs->pairs = hg_alloc(2 * (size_t)n_pairs + 1, sizeof *pairs->pairs);
    pairs->start = hg_alloc((size_t)n_vertices + 2, sizeof *pairs->start);
    pairs->incident = hg_alloc(2 * (size_t)n_pairs + 1, sizeof *pairs->incident);
    if (!pairs->pairs || !pairs->start || !pairs->incident) {
        hg_pairs_destroy(pairs);
        return HG_MEMORY;
    }
    if (n_pairs > 0) memcpy(pairs->pairs, list, 2 * (size_t)n_pairs * sizeof *list);
    /* start is shifted by one while counting and by one more while placing, so that it ends as it should */
    for (int64_t i = 0; i < 2 * n_pairs; i++) pairs->start[list[i] + 2]++;
    for (int64_t v = 0; v < n_vertices; v++) pairs->start[v + 2] += pairs->start[v + 1];
    for (int64_t i = 0; i < 2 * n_pairs; i++) pairs->incident[pairs->start[list[i] + 1]++] = (int32_t)i;
    *out = pairs;
    return HG_OK;
}

void hg_pairs_destroy(hg_pairs *pairs)
{
    if (!pairs) return;
    hg_free(pairs->pairs);
    hg_free(pairs->start);
    hg_free(pairs->incident);
    hg_free(pairs);
}
