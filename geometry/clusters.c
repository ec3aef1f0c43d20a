/* Clusters of points in the plane: recursive cuts across the longer side give equal numbers, a few of Lloyd's rounds
 * make the pieces round (Lloyd 1982, "Least squares quantization in PCM"). */
#include "geometry/geometry.h"

#include <math.h>
#include <stdlib.h>

enum { ROUNDS = 3 };

typedef struct {
    float key;
    int32_t point;
} sorted_point;

static int compare_points(const void *a, const void *b)
{
    const sorted_point *x = a, *y = b;
    if (x->key != y->key) return x->key < y->key ? -1 : 1;
    return x->point < y->point ? -1 : x->point > y->point;
}

/* Parts points[0..n) into `count` clusters numbered from `first`. */
static void cut(sorted_point *points, int64_t n, const float *uv, int32_t first, int32_t count, int32_t *cluster)
{
    if (count <= 1) {
        for (int64_t i = 0; i < n; i++) cluster[points[i].point] = first;
        return;
    }
    float lo[2] = { 0 }, hi[2] = { 0 };
    for (int64_t i = 0; i < n; i++)
        for (int k = 0; k < 2; k++) {
            float x = uv[2 * (int64_t)points[i].point + k];
            if (i == 0 || x < lo[k]) lo[k] = x;
            if (i == 0 || x > hi[k]) hi[k] = x;
        }
    int axis = hi[1] - lo[1] > hi[0] - lo[0];
    for (int64_t i = 0; i < n; i++) points[i].key = uv[2 * (int64_t)points[i].point + axis];
    qsort(points, (size_t)n, sizeof *points, compare_points);
    int32_t left = count / 2;
    int64_t middle = n * left / count;
    cut(points, middle, uv, first, left, cluster);
    cut(points + middle, n - middle, uv, first + left, count - left, cluster);
}

hg_status hg_clusters(int64_t n, const float *uv, int size, int32_t *cluster, int32_t *count)
{
    *count = 0;
    if (n < 0 || n > INT32_MAX || size < 1)
        return hg_fail(HG_INVALID, "clusters: %lld points in clusters of %d; the size has to be at least 1",
                       (long long)n, size);
    for (int64_t i = 0; i < 2 * n; i++)
        if (!isfinite(uv[i]))
            return hg_fail(HG_NUMERIC, "clusters: the UV of root %lld is not finite", (long long)(i / 2));
    if (n == 0) return HG_OK;
    int32_t k = (int32_t)((n + size / 2) / size);
    if (k < 1) k = 1;
    sorted_point *points = hg_alloc((size_t)n, sizeof *points);
    double *sums = hg_alloc((size_t)k, 3 * sizeof *sums);
    float *centres = hg_alloc((size_t)k, 2 * sizeof *centres);
    int32_t *number = hg_alloc((size_t)k, sizeof *number);
    if (!points || !sums || !centres || !number) {
        hg_free(points);
        hg_free(sums);
        hg_free(centres);
        hg_free(number);
        return HG_MEMORY;
    }
    for (int64_t i = 0; i < n; i++) points[i].point = (int32_t)i;
    cut(points, n, uv, 0, k, cluster);
    for (int round = 0; round < ROUNDS; round++) {
        for (int64_t c = 0; c < 3 * (int64_t)k; c++) sums[c] = 0.0;
        for (int64_t i = 0; i < n; i++) {
            double *sum = sums + 3 * (int64_t)cluster[i];
            sum[0] += (double)uv[2 * i];
            sum[1] += (double)uv[2 * i + 1];
            sum[2] += 1.0;
        }
        for (int32_t c = 0; c < k; c++) { /* one that lost all its points keeps its centre */
            if (sums[3 * c + 2] <= 0.0) continue;
            centres[2 * c] = (float)(sums[3 * c] / sums[3 * c + 2]);
            centres[2 * c + 1] = (float)(sums[3 * c + 1] / sums[3 * c + 2]);
        }
        for (int64_t i = 0; i < n; i++) {
            float best = INFINITY;
            int32_t nearest = cluster[i];
            for (int32_t c = 0; c < k; c++) {
                float u = uv[2 * i] - centres[2 * c], v = uv[2 * i + 1] - centres[2 * c + 1], d2 = u * u + v * v;
                if (d2 < best) {
                    best = d2;
                    nearest = c;
                }
            }
            cluster[i] = nearest;
        }
    }
    /* Numbers without gaps, in the order of the cuts. */
    for (int64_t i = 0; i < n; i++) number[cluster[i]] = 1;
    for (int32_t c = 0; c < k; c++) number[c] = number[c] ? (*count)++ : -1;
    for (int64_t i = 0; i < n; i++) cluster[i] = number[cluster[i]];
    hg_free(points);
    hg_free(sums);
    hg_free(centres);
    hg_free(number);
    return HG_OK;
}
