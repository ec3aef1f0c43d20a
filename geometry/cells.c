/* Cells: points sorted into a grid by counting. Everything that looks for neighbours stands on it. */
#include "geometry/geometry.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { SAMPLES = 1024 };

typedef struct {
    hg_cells *cells;
    const void *points;
    int64_t n;
} cell_args;

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

static double coordinate(hg_dtype dtype, const void *points, int64_t i)
{
    return dtype == HG_F32 ? (double)((const float *)points)[i] : ((const double *)points)[i];
}

/* Cell of a position, -1 when not finite. Clamping keeps neighbours in neighbouring cells. */
static int32_t cell_of(const hg_cells *cells, double x, double y, double z)
{
    double inverse = 1.0 / cells->width;
    double place[3] = { (x - cells->lo[0]) * inverse, (y - cells->lo[1]) * inverse, (z - cells->lo[2]) * inverse };
    int32_t c[3];
    for (int k = 0; k < 3; k++) {
        double last = (double)(cells->size[k] - 1);
        if (!isfinite(place[k])) return -1;
        c[k] = (int32_t)(place[k] < 0.0 ? 0.0 : place[k] < last ? place[k] : last);
    }
    return (c[2] * cells->size[1] + c[1]) * cells->size[0] + c[0];
}

static void find_cells(const void *args, int64_t first, int64_t last)
{
    const cell_args *a = args;
    hg_dtype dtype = a->cells->dtype;
    for (int64_t i = first; i < last; i++)
        a->cells->scratch[i] =
            cell_of(a->cells, coordinate(dtype, a->points, 3 * i), coordinate(dtype, a->points, 3 * i + 1),
                    coordinate(dtype, a->points, 3 * i + 2));
}

static void gather_places(const void *args, int64_t first, int64_t last)
{
    const cell_args *a = args;
    const hg_cells *cells = a->cells;
    for (int64_t i = first; i < last; i++) {
        int64_t from = 3 * (int64_t)cells->index[i];
        cells->cell[i] = cells->scratch[cells->index[i]];
        if (cells->dtype == HG_F32) {
            const float *points = a->points;
            ((float *)cells->x)[i] = points[from];
            ((float *)cells->y)[i] = points[from + 1];
            ((float *)cells->z)[i] = points[from + 2];
        } else {
            const double *points = a->points;
            ((double *)cells->x)[i] = points[from];
            ((double *)cells->y)[i] = points[from + 1];
            ((double *)cells->z)[i] = points[from + 2];
        }
    }
}

/* Box of what is finite. x - x is zero for finite numbers alone; sixteen points at a time, so that it vectorises. */
#define BOX(real_, points_)                                                                                            \
    do {                                                                                                               \
        enum { AT_ONCE = 48 };                                                                                         \
        real_ least[AT_ONCE], most[AT_ONCE];                                                                           \
        for (int l = 0; l < AT_ONCE; l++) least[l] = (real_)INFINITY, most[l] = -(real_)INFINITY;                      \
        for (int64_t i = 0; i < 3 * n; i += AT_ONCE) {                                                                 \
            const int count = 3 * n - i < AT_ONCE ? (int)(3 * n - i) : AT_ONCE;                                        \
            if (count == AT_ONCE) {                                                                                    \
                _Pragma("omp simd") for (int l = 0; l < AT_ONCE; l++)                                                  \
                {                                                                                                      \
                    const real_ x = (points_)[i + l];                                                                  \
                    const real_ low = x - x == 0 ? x : (real_)INFINITY, high = x - x == 0 ? x : -(real_)INFINITY;      \
                    least[l] = low < least[l] ? low : least[l];                                                        \
                    most[l] = high > most[l] ? high : most[l];                                                         \
                }                                                                                                      \
                continue;                                                                                              \
            }                                                                                                          \
            for (int l = 0; l < count; l++) {                                                                          \
                const real_ x = (points_)[i + l];                                                                      \
                if (!(x - x == 0)) continue;                                                                           \
                least[l] = x < least[l] ? x : least[l];                                                                \
                most[l] = x > most[l] ? x : most[l];                                                                   \
            }                                                                                                          \
        }                                                                                                              \
        for (int l = 0; l < AT_ONCE; l++) {                                                                            \
            lo[l % 3] = (double)least[l] < lo[l % 3] ? (double)least[l] : lo[l % 3];                                   \
            hi[l % 3] = (double)most[l] > hi[l % 3] ? (double)most[l] : hi[l % 3];                                     \
        }                                                                                                              \
    } while (0)

static void find_box(hg_dtype dtype, int64_t n, const void *points, double lo[3], double hi[3])
{
    for (int k = 0; k < 3; k++) lo[k] = HUGE_VAL, hi[k] = -HUGE_VAL;
    if (dtype == HG_F32)
        BOX(float, (const float *)points);
    else
        BOX(double, (const double *)points);
    for (int k = 0; k < 3; k++)
        if (!(lo[k] <= hi[k])) lo[k] = hi[k] = 0.0;
}

/* Number of cells of a box at this width, as double: it may be astronomical. */
static double cell_count(const double lo[3], const double hi[3], double width)
{
    double count = 1.0;
    for (int k = 0; k < 3; k++) count *= floor((hi[k] - lo[k]) / width) + 1.0;
    return count;
}

/* Box and width of the grid: all points if that takes at most `most` cells, else most points, else wider cells. */
static void choose_grid(hg_cells *cells, int64_t n, const void *points, double radius, double most)
{
    double lo[3], hi[3];
    find_box(cells->dtype, n, points, lo, hi);
    /* A little more than the radius, so that rounding never puts two points within it two cells apart. */
    double width = radius * (1.0 + 1e-5);
    for (int k = 0; k < 3; k++) {
        double reach = fmax(fabs(lo[k]), fabs(hi[k])) * 1e-12;
        if (width < reach) width = reach;
    }
    if (!(cell_count(lo, hi, width) <= most)) {
        /* A few points have run away: the grid covers the middle 96 % of each axis, the others share its border. */
        for (int k = 0; k < 3; k++) {
            double sample[SAMPLES];
            int taken = 0;
            int64_t stride = n / SAMPLES + 1;
            for (int64_t i = 0; i < n && taken < SAMPLES; i += stride) {
                double x = coordinate(cells->dtype, points, 3 * i + k);
                if (isfinite(x)) sample[taken++] = x;
            }
            if (taken == 0) continue;
            qsort(sample, (size_t)taken, sizeof *sample, compare_doubles);
            lo[k] = sample[taken / 50];
            hi[k] = sample[taken - 1 - taken / 50];
        }
        while (!(cell_count(lo, hi, width) <= most)) width *= 1.25;
    }
    cells->width = width;
    for (int k = 0; k < 3; k++) {
        cells->lo[k] = lo[k];
        cells->size[k] = (int32_t)floor((hi[k] - lo[k]) / width) + 1;
    }
}

static hg_status reserve(hg_cells *cells, hg_dtype dtype, int64_t n)
{
    if (n <= cells->capacity && dtype == cells->dtype && cells->x) return HG_OK;
    hg_cells_free(cells);
    size_t places = (size_t)(n + n / 8) + HG_CELL_PAD, real = hg_dtype_size(dtype);
    cells->dtype = dtype;
    cells->index = hg_alloc(places, sizeof *cells->index);
    cells->cell = hg_alloc(places, sizeof *cells->cell);
    cells->scratch = hg_alloc(places, sizeof *cells->scratch);
    cells->x = hg_alloc(places, real);
    cells->y = hg_alloc(places, real);
    cells->z = hg_alloc(places, real);
    if (!cells->index || !cells->cell || !cells->scratch || !cells->x || !cells->y || !cells->z) {
        hg_cells_free(cells);
        return HG_MEMORY;
    }
    cells->capacity = (int64_t)places - HG_CELL_PAD;
    return HG_OK;
}

static hg_status build(hg_ctx *ctx, hg_cells *cells, hg_dtype dtype, int64_t n, const void *points, double radius)
{
    static const hg_kernel find = {
        .name = "cells_find", .args_size = sizeof(cell_args), .cpu = find_cells, .block = 4096
    };
    static const hg_kernel gather = {
        .name = "cells_gather", .args_size = sizeof(cell_args), .cpu = gather_places, .block = 4096
    };
    if (dtype != HG_F32 && dtype != HG_F64)
        return hg_fail(HG_INVALID, "cells: points are f32 or f64, not %s", hg_dtype_name(dtype));
    if (!(radius > 0.0) || !isfinite(radius))
        return hg_fail(HG_INVALID, "cells: a radius of %g m; it has to be positive", radius);
    if (n < 0 || n > INT32_MAX - HG_CELL_PAD)
        return hg_fail(HG_INVALID, "cells: %lld points; at most %d can be numbered", (long long)n,
                       INT32_MAX - HG_CELL_PAD);
    HG_TRY(reserve(cells, dtype, n));
    choose_grid(cells, n, points, radius, 4096.0 + 8.0 * (double)n);
    int64_t n_cells = (int64_t)cells->size[0] * cells->size[1] * cells->size[2];
    if (n_cells > cells->cell_capacity) {
        hg_free(cells->start);
        int64_t wanted = n_cells + n_cells / 4;
        cells->cell_capacity = 0;
        cells->start = hg_alloc((size_t)wanted + 2, sizeof *cells->start);
        if (!cells->start) return HG_MEMORY;
        cells->cell_capacity = wanted;
    }
    cell_args args = { cells, points, n };
    HG_TRY(hg_launch(ctx, &find, n, &args));

    /* start is shifted by one while counting and by one more while placing, so that it ends as it should */
    int32_t *start = cells->start;
    memset(start, 0, ((size_t)n_cells + 2) * sizeof *start);
    for (int64_t i = 0; i < n; i++)
        if (cells->scratch[i] >= 0) start[cells->scratch[i] + 2]++;
    for (int64_t c = 0; c < n_cells; c++) start[c + 2] += start[c + 1];
    cells->n = start[n_cells + 1];
    for (int64_t i = 0; i < n; i++)
        if (cells->scratch[i] >= 0) cells->index[start[cells->scratch[i] + 1]++] = (int32_t)i;
    HG_TRY(hg_launch(ctx, &gather, cells->n, &args));
    for (int64_t i = cells->n; i < cells->n + HG_CELL_PAD; i++) {
        if (dtype == HG_F32)
            ((float *)cells->x)[i] = ((float *)cells->y)[i] = ((float *)cells->z)[i] = 1e18f;
        else
            ((double *)cells->x)[i] = ((double *)cells->y)[i] = ((double *)cells->z)[i] = 1e18;
    }
    return HG_OK;
}

hg_status hg_cells_build(hg_ctx *ctx, hg_cells *cells, hg_dtype dtype, int64_t n, const void *points, double radius)
{
    hg_profile_begin(ctx, "neighbours", "cells");
    HG_TRY(build(ctx, cells, dtype, n, points, radius));
    hg_profile_end(ctx, n * (6 * (int64_t)hg_dtype_size(dtype) + 16));
    return HG_OK;
}

void hg_cells_free(hg_cells *cells)
{
    hg_free(cells->start);
    hg_free(cells->index);
    hg_free(cells->cell);
    hg_free(cells->scratch);
    hg_free(cells->x);
    hg_free(cells->y);
    hg_free(cells->z);
    *cells = (hg_cells){ 0 };
}
