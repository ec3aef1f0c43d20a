/* Neighbours: for every point the ascending list of the others within a radius. */
#include "geometry/scan.h"

#include <string.h>

struct hg_neighbours {
    hg_cells cells;
    int64_t *start; /* [n+1] */
    int32_t *list;
    int64_t n_capacity, capacity; /* points, pairs */
    bool fixed;
};

typedef struct {
    const hg_neighbours *neighbours;
    double radius;
} search_args;

/* Counts the neighbours of the point at `place`, and lists them when list is given. */
static int32_t find_neighbours(const hg_cells *cells, int64_t place, double radius, int32_t *list)
{
    int32_t runs[HG_CELL_RUNS][2], hits[HG_SCAN_PIECE + HG_CELL_PAD], count = 0;
    union {
        float f[HG_SCAN_PIECE + HG_CELL_PAD];
        double d[HG_SCAN_PIECE + HG_CELL_PAD];
    } distance2;
    int n_runs = hg_cells_runs(cells, cells->cell[place], runs);
    for (int r = 0; r < n_runs; r++)
        for (int32_t first = runs[r][0]; first < runs[r][1]; first += HG_SCAN_PIECE) {
            int32_t last = runs[r][1] - first < HG_SCAN_PIECE ? runs[r][1] : first + HG_SCAN_PIECE;
            int n;
            if (cells->dtype == HG_F32) {
                const float *x = cells->x, *y = cells->y, *z = cells->z;
                n = hg_scan_f(x, y, z, first, last, x[place], y[place], z[place], (float)(radius * radius), hits,
                              distance2.f);
            } else {
                const double *x = cells->x, *y = cells->y, *z = cells->z;
                n = hg_scan_d(x, y, z, first, last, x[place], y[place], z[place], radius * radius, hits, distance2.d);
            }
            if (!list) {
                count += n;
                continue;
            }
            for (int h = 0; h < n; h++)
                if (hits[h] != place) list[count++] = cells->index[hits[h]];
        }
    return list ? count : count - 1; /* the point itself is always found */
}

static void count_block(const void *args, int64_t first, int64_t last)
{
    const search_args *a = args;
    const hg_cells *cells = &a->neighbours->cells;
    for (int64_t i = first; i < last; i++)
        a->neighbours->start[cells->index[i] + 1] = find_neighbours(cells, i, a->radius, NULL);
}

enum { RANKED = 128 };

/* Ascending order of different numbers. Few of them are put where the count of smaller ones says: n^2 comparisons, but
 * sixteen at a time and without a branch. */
static void sort_list(int32_t *list, int32_t n)
{
    if (n <= RANKED) {
        int32_t sorted[RANKED];
        for (int32_t i = 0; i < n; i++) {
            int32_t value = list[i], rank = 0;
            for (int32_t j = 0; j < n; j++) rank += list[j] < value;
            sorted[rank] = value;
        }
        memcpy(list, sorted, (size_t)n * sizeof *list);
        return;
    }
    static const int32_t gaps[] = { 1750, 701, 301, 132, 57, 23, 10, 4, 1 }; /* Shell's method, Ciura's gaps */
    for (size_t g = 0; g < sizeof gaps / sizeof *gaps; g++)
        for (int32_t j = gaps[g]; j < n; j++) {
            int32_t value = list[j], k = j;
            for (; k >= gaps[g] && list[k - gaps[g]] > value; k -= gaps[g]) list[k] = list[k - gaps[g]];
            list[k] = value;
        }
}

static void list_block(const void *args, int64_t first, int64_t last)
{
    const search_args *a = args;
    const hg_cells *cells = &a->neighbours->cells;
    for (int64_t i = first; i < last; i++) {
        int32_t *list = a->neighbours->list + a->neighbours->start[cells->index[i]];
        sort_list(list, find_neighbours(cells, i, a->radius, list));
    }
}

hg_status hg_neighbours_create(hg_neighbours **out, int64_t capacity_pairs)
{
    *out = NULL;
    if (capacity_pairs < 0)
        return hg_fail(HG_INVALID, "neighbours: a capacity of %lld pairs; 0 grows as needed",
                       (long long)capacity_pairs);
    hg_neighbours *neighbours = hg_alloc(1, sizeof *neighbours);
    if (!neighbours) return HG_MEMORY;
    neighbours->start = hg_alloc(1, sizeof *neighbours->start);
    neighbours->fixed = capacity_pairs > 0;
    neighbours->capacity = capacity_pairs > 0 ? capacity_pairs : 1024;
    neighbours->list = hg_alloc((size_t)neighbours->capacity, sizeof *neighbours->list);
    if (!neighbours->start || !neighbours->list) {
        hg_neighbours_destroy(neighbours);
        return HG_MEMORY;
    }
    *out = neighbours;
    return HG_OK;
}

void hg_neighbours_destroy(hg_neighbours *neighbours)
{
    if (!neighbours) return;
    hg_cells_free(&neighbours->cells);
    hg_free(neighbours->start);
    hg_free(neighbours->list);
    hg_free(neighbours);
}

hg_status hg_neighbours_build(hg_ctx *ctx, hg_neighbours *neighbours, hg_dtype dtype, int64_t n, const void *points,
                              double radius, int64_t *needed)
{
    static const hg_kernel count = {
        .name = "neighbours_count", .args_size = sizeof(search_args), .cpu = count_block, .block = 512
    };
    static const hg_kernel list = {
        .name = "neighbours_list", .args_size = sizeof(search_args), .cpu = list_block, .block = 512
    };
    if (needed) *needed = 0;
    HG_TRY(hg_cells_build(ctx, &neighbours->cells, dtype, n, points, radius));
    if (n > neighbours->n_capacity) {
        int64_t *start = hg_alloc((size_t)(n + n / 8) + 1, sizeof *start);
        if (!start) return HG_MEMORY;
        hg_free(neighbours->start);
        neighbours->start = start;
        neighbours->n_capacity = n + n / 8;
    }
    int64_t *start = neighbours->start;
    memset(start, 0, ((size_t)n + 1) * sizeof *start);
    search_args args = { neighbours, radius };
    HG_TRY(hg_launch(ctx, &count, neighbours->cells.n, &args));
    for (int64_t i = 0; i < n; i++) start[i + 1] += start[i];
    int64_t pairs = start[n];
    if (needed) *needed = pairs;
    if (pairs > neighbours->capacity) {
        if (neighbours->fixed) {
            memset(start, 0, ((size_t)n + 1) * sizeof *start);
            return hg_fail(HG_INVALID,
                           "neighbours: %lld pairs within %g m, but room for %lld; a capacity of %lld would do",
                           (long long)pairs, radius, (long long)neighbours->capacity, (long long)pairs);
        }
        int32_t *grown = hg_alloc((size_t)(pairs + pairs / 4), sizeof *grown);
        if (!grown) {
            memset(start, 0, ((size_t)n + 1) * sizeof *start);
            return HG_MEMORY;
        }
        hg_free(neighbours->list);
        neighbours->list = grown;
        neighbours->capacity = pairs + pairs / 4;
    }
    return hg_launch(ctx, &list, neighbours->cells.n, &args);
}

const int64_t *hg_neighbours_start(const hg_neighbours *neighbours) { return neighbours->start; }

const int32_t *hg_neighbours_list(const hg_neighbours *neighbours) { return neighbours->list; }
