/* Roots spread evenly over the scalp, without rows: darts thrown by area and kept at a distance from each other that
 * shrinks until there are enough (McCool and Fiume 1992, hierarchical Poisson disks). */
#include "scene/roots.h"

enum { DARTS = 12 /* thrown per root kept */ };

typedef struct {
    int64_t darts;
    int32_t *face;
    float *bary;   /* [darts,3] */
    hg_vec3d *at;  /* [darts] */
    int32_t *kept; /* dart numbers in the order kept */
    int64_t n;
    bool *used;
    /* cells of the roots kept: a grid of lists */
    int32_t *head, *next;
    hg_vec3d low;
    double cell;
    int64_t size[3];
} scatter;

static hg_vec3d face_point(const hg_body *body, int64_t face, const float *bary)
{
    hg_vec3d p = { 0 };
    for (int c = 0; c < 3; c++)
        p = hg_vec3d_add_scaled(p, (double)bary[c],
                                scene_point(body->points + 3 * (int64_t)body->triangles[3 * face + c]));
    return p;
}

static double face_area(const hg_body *body, int64_t face)
{
    const int32_t *t = body->triangles + 3 * face;
    hg_vec3d a = scene_point(body->points + 3 * (int64_t)t[0]);
    hg_vec3d b = hg_vec3d_sub(scene_point(body->points + 3 * (int64_t)t[1]), a);
    hg_vec3d c = hg_vec3d_sub(scene_point(body->points + 3 * (int64_t)t[2]), a);
    return 0.5 * hg_vec3d_norm(hg_vec3d_cross(b, c));
}

/* Darts at random, as many per area everywhere. Returns the area of the scalp. */
static double throw_darts(scatter *s, const hg_body *body, uint64_t seed, double *sum)
{
    double area = 0;
    for (int64_t i = 0; i < body->scalp_faces; i++) sum[i] = area += face_area(body, body->scalp[i]);
    for (int64_t d = 0; d < s->darts; d++) {
        double at = area * hg_random_uniform(seed, 1, (uint64_t)d);
        int64_t first = 0, last = body->scalp_faces - 1;
        while (first < last) {
            int64_t middle = (first + last) / 2;
            if (sum[middle] > at)
                last = middle;
            else
                first = middle + 1;
        }
        double u = sqrt(hg_random_uniform(seed, 2, (uint64_t)d)), v = hg_random_uniform(seed, 3, (uint64_t)d);
        float *bary = s->bary + 3 * d;
        bary[0] = (float)(1 - u), bary[1] = (float)(u * (1 - v)), bary[2] = 1 - bary[0] - bary[1];
        s->face[d] = body->scalp[first];
        s->at[d] = face_point(body, s->face[d], bary);
    }
    return area;
}

static int64_t cell_of(const scatter *s, hg_vec3d p, int axis)
{
    double x = axis == 0 ? p.x - s->low.x : axis == 1 ? p.y - s->low.y : p.z - s->low.z;
    int64_t c = (int64_t)floor(x / s->cell);
    return c < 0 ? 0 : c >= s->size[axis] ? s->size[axis] - 1 : c;
}

static bool is_free(const scatter *s, hg_vec3d p, double distance)
{
    int64_t c[3];
    for (int i = 0; i < 3; i++) c[i] = cell_of(s, p, i);
    for (int64_t z = c[2] - 1; z <= c[2] + 1; z++)
        for (int64_t y = c[1] - 1; y <= c[1] + 1; y++)
            for (int64_t x = c[0] - 1; x <= c[0] + 1; x++) {
                if (x < 0 || y < 0 || z < 0 || x >= s->size[0] || y >= s->size[1] || z >= s->size[2]) continue;
                for (int32_t k = s->head[(z * s->size[1] + y) * s->size[0] + x]; k >= 0; k = s->next[k])
                    if (hg_vec3d_distance(p, s->at[k]) < distance) return false;
            }
    return true;
}

static void keep_dart(scatter *s, int64_t dart)
{
    int64_t cell = (cell_of(s, s->at[dart], 2) * s->size[1] + cell_of(s, s->at[dart], 1)) * s->size[0] +
                   cell_of(s, s->at[dart], 0);
    s->next[dart] = s->head[cell], s->head[cell] = (int32_t)dart;
    s->kept[s->n++] = (int32_t)dart, s->used[dart] = true;
}

/* Cells are as wide as the distance, so that a dart looks at its 27 cells; both shrink together. */
static hg_status set_distance(scatter *s, double distance)
{
    hg_vec3d high = s->low = s->at[0];
    for (int64_t d = 1; d < s->darts; d++) {
        hg_vec3d p = s->at[d];
        s->low = hg_vec3d_make(fmin(s->low.x, p.x), fmin(s->low.y, p.y), fmin(s->low.z, p.z));
        high = hg_vec3d_make(fmax(high.x, p.x), fmax(high.y, p.y), fmax(high.z, p.z));
    }
    hg_vec3d extent = hg_vec3d_sub(high, s->low);
    s->cell = fmax(distance, fmax(extent.x, fmax(extent.y, extent.z)) / 128); /* memory has a bound */
    s->size[0] = (int64_t)(extent.x / fmax(s->cell, 1e-9)) + 1;
    s->size[1] = (int64_t)(extent.y / fmax(s->cell, 1e-9)) + 1;
    s->size[2] = (int64_t)(extent.z / fmax(s->cell, 1e-9)) + 1;
    hg_free(s->head);
    int64_t cells = s->size[0] * s->size[1] * s->size[2], kept = s->n;
    s->head = hg_alloc((size_t)cells, sizeof *s->head);
    if (!s->head) return HG_MEMORY;
    for (int64_t c = 0; c < cells; c++) s->head[c] = -1;
    s->n = 0;
    for (int64_t k = 0; k < kept; k++) keep_dart(s, s->kept[k]);
    return HG_OK;
}

static hg_status scatter_fill(scatter *s, int64_t n, double area)
{
    /* far above what fits (a hexagonal packing has the distance sqrt(2 A / (sqrt(3) n))), so that few come first */
    double distance = fmin(8 * sqrt(area / (double)n), sqrt(area));
    if (!(distance > 0)) return hg_fail(HG_INVALID, "the scalp has no area: no hair can grow on it");
    for (int round = 0; s->n < n; round++, distance *= 0.9) {
        if (round == 60) distance = 0;
        HG_TRY(set_distance(s, distance));
        for (int64_t d = 0; d < s->darts && s->n < n; d++)
            if (!s->used[d] && is_free(s, s->at[d], distance)) keep_dart(s, d);
    }
    return HG_OK;
}

hg_status scene_scatter_roots(const hg_body *body, int64_t n, uint64_t seed, int32_t *face, float *bary,
                              float *position)
{
    scatter s = { .darts = n * DARTS };
    double *sum = hg_alloc((size_t)body->scalp_faces, sizeof *sum);
    s.face = hg_alloc((size_t)s.darts, sizeof *s.face);
    s.bary = hg_alloc((size_t)s.darts, 3 * sizeof *s.bary);
    s.at = hg_alloc((size_t)s.darts, sizeof *s.at);
    s.kept = hg_alloc((size_t)n, sizeof *s.kept);
    s.used = hg_alloc((size_t)s.darts, sizeof *s.used);
    s.next = hg_alloc((size_t)s.darts, sizeof *s.next);
    hg_status status = HG_MEMORY;
    if (sum && s.face && s.bary && s.at && s.kept && s.used && s.next)
        status = scatter_fill(&s, n, throw_darts(&s, body, seed, sum));
    for (int64_t i = 0; status == HG_OK && i < n; i++) {
        int64_t d = s.kept[i];
        face[i] = s.face[d];
        for (int c = 0; c < 3; c++) bary[3 * i + c] = s.bary[3 * d + c];
        scene_put(position + 3 * i, s.at[d]);
    }
    hg_free(sum);
    hg_free(s.face);
    hg_free(s.bary);
    hg_free(s.at);
    hg_free(s.kept);
    hg_free(s.used);
    hg_free(s.next);
    hg_free(s.head);
    return status;
}
