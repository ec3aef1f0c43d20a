/* Puts a groom made for one head on another.
 *
 * The similarity between the heads is found by trimmed iterative closest points without rotation: skulls are nearly
 * spheres, so a free rotation drifts. Roots are then projected to the scalp and strands follow; vertices that end
 * inside the body are pushed out along the exact distance, once, at rest: displacements are smoothed along the strand,
 * and the strand is resampled by arc length, several times over, so that kinks and uneven edges stay small. */
#include "scene/internal.h"
#include "scene/scene.h"

#include "geometry/vector.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- closest points on a part of the body at rest ------------------------------------------------------------ */

typedef struct {
    hg_ctx *ctx;
    hg_body_tree *tree;
    hg_body_refit *refit;
    int64_t capacity;
    int32_t *triangle;      /* [capacity] of the last query: where the next one starts */
    double *point, *normal; /* [capacity,3] */
} surface;

static void surface_free(surface *s)
{
    hg_body_refit_destroy(s->refit);
    hg_body_tree_destroy(s->tree);
    hg_free(s->triangle);
    hg_free(s->point);
    hg_free(s->normal);
    *s = (surface){ 0 };
}

/* faces NULL: all of the body's */
static hg_status surface_make(surface *s, hg_ctx *ctx, const hg_body *body, int64_t n_faces, const int32_t *faces,
                              int64_t capacity)
{
    *s = (surface){ .ctx = hg_ctx_on_host(ctx), .capacity = capacity };
    if (!s->ctx) return HG_MEMORY;
    int64_t count = faces ? n_faces : body->faces;
    double *vertices = hg_alloc((size_t)body->vertices, 3 * sizeof *vertices);
    int32_t *corners = hg_alloc((size_t)count, 3 * sizeof *corners);
    s->triangle = hg_alloc((size_t)capacity, sizeof *s->triangle);
    s->point = hg_alloc((size_t)capacity, 3 * sizeof *s->point);
    s->normal = hg_alloc((size_t)capacity, 3 * sizeof *s->normal);
    hg_status status = vertices && corners && s->triangle && s->point && s->normal ? HG_OK : HG_MEMORY;
    if (status == HG_OK) {
        for (int64_t i = 0; i < 3 * body->vertices; i++) vertices[i] = (double)body->points[i];
        for (int64_t f = 0; f < count; f++)
            memcpy(corners + 3 * f, body->triangles + 3 * (faces ? (int64_t)faces[f] : f), 3 * sizeof *corners);
        for (int64_t i = 0; i < capacity; i++) s->triangle[i] = -1;
        status = hg_body_tree_create(&s->tree, body->vertices, vertices, count, corners);
    }
    if (status == HG_OK) status = hg_body_refit_create(&s->refit, s->tree, HG_F64);
    if (status == HG_OK) status = hg_body_refit_update(s->ctx, s->refit, vertices);
    hg_free(vertices);
    hg_free(corners);
    return status;
}

static hg_status surface_query(surface *s, int64_t n, const double *points)
{
    return hg_body_closest(s->ctx, s->refit, HG_CONTACT_EXACT, (double)INFINITY, n, points, s->triangle, s->point,
                           s->normal);
}

/* Signed distance of the i-th point of the last query, negative inside. */
static double surface_distance(const surface *s, int64_t i, const double *points)
{
    hg_vec3d away = hg_vec3d_sub(hg_vec3d_load(points + 3 * i), hg_vec3d_load(s->point + 3 * i));
    return hg_vec3d_dot(away, hg_vec3d_load(s->normal + 3 * i));
}

static int compare(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* ---- the similarity ------------------------------------------------------------------------------------------ */

#define KEPT       0.9 /* of the vertices with the smallest residual */
#define ROUNDS     200
#define MOST_ROOTS 4096 /* looked at to tell which vertices are near roots */

/* The source vertices within 2.5 % of the roots' extent of some root, as [*count,3]. */
static hg_status near_roots(int64_t n, const float *source, const hg_groom *groom, double **out, int64_t *count)
{
    int64_t step = groom->strands / MOST_ROOTS + 1, roots = 0;
    const double far = (double)INFINITY;
    hg_vec3d low = hg_vec3d_make(far, far, far), high = hg_vec3d_neg(low);
    double *root = hg_alloc((size_t)(groom->strands / step + 1), 3 * sizeof *root),
           *kept = hg_alloc((size_t)n, 3 * sizeof *kept);
    if (!root || !kept) {
        hg_free(root);
        hg_free(kept);
        return HG_MEMORY;
    }
    for (int64_t s = 0; s < groom->strands; s += step, roots++) {
        const float *p = groom->points + 3 * s * groom->vertices;
        for (int k = 0; k < 3; k++) root[3 * roots + k] = (double)p[k];
        hg_vec3d at = hg_vec3d_load(root + 3 * roots);
        low = hg_vec3d_make(fmin(low.x, at.x), fmin(low.y, at.y), fmin(low.z, at.z));
        high = hg_vec3d_make(fmax(high.x, at.x), fmax(high.y, at.y), fmax(high.z, at.z));
    }
    double reach = 0.025 * hg_vec3d_distance(low, high);
    *count = 0;
    for (int64_t v = 0; v < n; v++) {
        hg_vec3d at = hg_vec3d_make((double)source[3 * v], (double)source[3 * v + 1], (double)source[3 * v + 2]);
        bool near = false;
        for (int64_t i = 0; i < roots && !near; i++)
            near = hg_vec3d_norm2(hg_vec3d_sub(at, hg_vec3d_load(root + 3 * i))) < reach * reach;
        if (near) hg_vec3d_store(kept + 3 * (*count)++, at);
    }
    hg_free(root);
    *out = kept;
    return HG_OK;
}

static void centre_and_radius(int64_t n, const double *points, hg_vec3d *centre, double *radius)
{
    hg_vec3d sum = { 0, 0, 0 };
    double square = 0;
    for (int64_t i = 0; i < n; i++) sum = hg_vec3d_add(sum, hg_vec3d_load(points + 3 * i));
    *centre = hg_vec3d_scale(sum, 1 / (double)n);
    for (int64_t i = 0; i < n; i++) square += hg_vec3d_norm2(hg_vec3d_sub(hg_vec3d_load(points + 3 * i), *centre));
    *radius = sqrt(square / (double)n);
}

/* Scale and translation that bring the kept points closest to what they were matched with, in least squares. */
static void solve(int64_t n, const double *source, const surface *matched, const double *residual, double limit,
                  double *scale, hg_vec3d *move)
{
    hg_vec3d from = { 0, 0, 0 }, to = { 0, 0, 0 };
    double count = 0, up = 0, down = 0;
    for (int64_t i = 0; i < n; i++) {
        if (residual[i] > limit) continue;
        count++;
        from = hg_vec3d_add(from, hg_vec3d_load(source + 3 * i));
        to = hg_vec3d_add(to, hg_vec3d_load(matched->point + 3 * i));
    }
    from = hg_vec3d_scale(from, 1 / count);
    to = hg_vec3d_scale(to, 1 / count);
    for (int64_t i = 0; i < n; i++) {
        if (residual[i] > limit) continue;
        hg_vec3d a = hg_vec3d_sub(hg_vec3d_load(source + 3 * i), from),
                 b = hg_vec3d_sub(hg_vec3d_load(matched->point + 3 * i), to);
        up += hg_vec3d_dot(a, b);
        down += hg_vec3d_dot(a, a);
    }
    *scale = down > 0 ? up / down : 1;
    *move = hg_vec3d_add_scaled(to, -*scale, from);
}

static hg_status iterate(surface *s, int64_t n, const double *source, double *moved, double *residual, double *sorted,
                         double *scale, hg_vec3d *move)
{
    for (int round = 0; round < ROUNDS; round++) {
        for (int64_t i = 0; i < n; i++)
            hg_vec3d_store(moved + 3 * i, hg_vec3d_add_scaled(*move, *scale, hg_vec3d_load(source + 3 * i)));
        HG_TRY(surface_query(s, n, moved));
        for (int64_t i = 0; i < n; i++) sorted[i] = residual[i] = fabs(surface_distance(s, i, moved));
        qsort(sorted, (size_t)n, sizeof *sorted, compare);
        double before = *scale;
        hg_vec3d place = *move;
        solve(n, source, s, residual, sorted[(int64_t)(KEPT * (double)(n - 1))], scale, move);
        if (!(*scale > 1e-6) || !isfinite(*scale))
            return hg_fail(HG_NUMERIC, "no similarity takes this head to the body: give one");
        if (fabs(*scale - before) < 1e-7 * *scale && hg_vec3d_distance(place, *move) < 1e-7) break;
    }
    return HG_OK;
}

hg_status hg_fit_similarity(hg_ctx *ctx, const hg_body *body, int64_t n_vertices, const float *source,
                            const hg_groom *groom, hg_similarity *found)
{
    *found = (hg_similarity){ .scale = 1, .rotation = { 1, 0, 0, 0 } };
    if (body->scalp_faces < 1)
        return hg_fail(HG_INVALID, "the body has no scalp faces, so a head cannot be fitted to it");
    if (n_vertices < 1 || groom->strands < 1)
        return hg_fail(HG_INVALID, "a head of %lld vertices and a groom of %lld strands", (long long)n_vertices,
                       (long long)groom->strands);
    double *near = NULL;
    int64_t count = 0;
    HG_TRY(near_roots(n_vertices, source, groom, &near, &count));
    surface head = { 0 };
    double *work = hg_alloc((size_t)(count + 1), 5 * sizeof *work),
           *scalp = hg_alloc((size_t)body->scalp_faces, 3 * sizeof *scalp);
    hg_status status = work && scalp ? HG_OK : HG_MEMORY;
    if (status == HG_OK && count < 16)
        status = hg_fail(HG_INVALID,
                         "%lld vertices of the head lie near roots of the groom, 16 are needed: are they in the same "
                         "unit and place?",
                         (long long)count);
    if (status == HG_OK) status = surface_make(&head, ctx, body, 0, NULL, count);
    if (status == HG_OK) {
        /* start: centres and mean radii of the hairy part and of the scalp agree */
        hg_vec3d from, to, move;
        double from_radius, to_radius, scale;
        for (int64_t i = 0; i < body->scalp_faces; i++) {
            const int32_t *t = body->triangles + 3 * (int64_t)body->scalp[i];
            for (int k = 0; k < 3; k++)
                scalp[3 * i + k] =
                    ((double)body->points[3 * (int64_t)t[0] + k] + (double)body->points[3 * (int64_t)t[1] + k] +
                     (double)body->points[3 * (int64_t)t[2] + k]) /
                    3;
        }
        centre_and_radius(count, near, &from, &from_radius);
        centre_and_radius(body->scalp_faces, scalp, &to, &to_radius);
        scale = from_radius > 0 ? to_radius / from_radius : 1;
        move = hg_vec3d_add_scaled(to, -scale, from);
        status = iterate(&head, count, near, work, work + 3 * count, work + 4 * count, &scale, &move);
        found->scale = scale;
        hg_vec3d_store(found->translation, move);
    }
    surface_free(&head);
    hg_free(near);
    hg_free(work);
    hg_free(scalp);
    return status;
}

/* ---- pushing out --------------------------------------------------------------------------------------------- */

#define MARGIN      1e-3 /* [m] how far outside vertices are put, before resampling */
#define LAST_MARGIN 5e-4 /* after it */
#define NEAR_ROOT   0.25 /* of the arc length from the root: the margin grows from 0 at the root */
#define PUSH_CYCLES 6    /* of pushing and resampling */
#define PUSH_ROUNDS 2    /* of pushing in a cycle */
#define LAST_ROUNDS 16

typedef struct {
    surface body;
    int64_t strands, vertices;
    double *x;                            /* [S,V,3] */
    double *arc;                          /* [V] of one strand */
    double *need, *displacement, *smooth; /* [V,3] of one strand */
    bool *moved;                          /* [S] */
} push;

/* The displacement of every vertex of one strand; need is what takes an inside vertex to the margin. */
static bool push_strand(push *p, int64_t strand, double margin)
{
    int64_t n = p->vertices, first = strand * n;
    double *x = p->x + 3 * first;
    bool any = false;
    for (int64_t v = 0; v < n; v++) {
        p->arc[v] =
            v == 0 ? 0 : p->arc[v - 1] + hg_vec3d_distance(hg_vec3d_load(x + 3 * v), hg_vec3d_load(x + 3 * v - 3));
        double depth = v == 0 ? 0 : -surface_distance(&p->body, first + v, p->x);
        double length = depth > 0 ? depth + fmin(margin, NEAR_ROOT * p->arc[v]) : 0;
        hg_vec3d_store(p->need + 3 * v, hg_vec3d_scale(hg_vec3d_load(p->body.normal + 3 * (first + v)), length));
        any |= length > 0;
    }
    if (!any) return false;
    memcpy(p->displacement, p->need, (size_t)(3 * n) * sizeof *p->need);
    for (int pass = 0; pass < 2; pass++) {
        memcpy(p->smooth, p->displacement, (size_t)(3 * n) * sizeof *p->smooth);
        for (int64_t i = 3; i < 3 * n; i++)
            p->displacement[i] =
                0.25 * p->smooth[i - 3] + 0.5 * p->smooth[i] + 0.25 * p->smooth[i + 3 < 3 * n ? i + 3 : i];
    }
    for (int64_t v = 1; v < n; v++) {
        hg_vec3d need = hg_vec3d_load(p->need + 3 * v), d = hg_vec3d_load(p->displacement + 3 * v),
                 out = hg_vec3d_normalize(need);
        double missing = hg_vec3d_norm(need) - hg_vec3d_dot(d, out);
        if (missing > 0) d = hg_vec3d_add_scaled(d, missing, out);
        hg_vec3d_store(x + 3 * v, hg_vec3d_add(hg_vec3d_load(x + 3 * v), d));
    }
    p->moved[strand] = true;
    return true;
}

static hg_status push_rounds(push *p, int rounds, double margin)
{
    bool any = true;
    for (int round = 0; round < rounds && any; round++) {
        HG_TRY(surface_query(&p->body, p->strands * p->vertices, p->x));
        any = false;
        for (int64_t s = 0; s < p->strands; s++) any |= push_strand(p, s, margin);
    }
    return HG_OK;
}

static hg_status count_inside(push *p, int64_t *count)
{
    HG_TRY(surface_query(&p->body, p->strands * p->vertices, p->x));
    *count = 0;
    for (int64_t i = 0; i < p->strands * p->vertices; i++)
        *count += i % p->vertices != 0 && surface_distance(&p->body, i, p->x) < 0;
    return HG_OK;
}

static void resample_moved(push *p, float *out)
{
    for (int64_t s = 0; s < p->strands; s++) {
        double *x = p->x + 3 * s * p->vertices;
        bool even = p->moved[s];
        for (int64_t v = 1; v < p->vertices; v++)
            even &= hg_vec3d_distance(hg_vec3d_load(x + 3 * v), hg_vec3d_load(x + 3 * v - 3)) > 1e-9;
        if (!even) continue;
        scene_resample(x, p->vertices, p->vertices, out);
        for (int64_t i = 3; i < 3 * p->vertices; i++) x[i] = (double)out[i];
    }
}

/* points [S,V,3] in and out */
static hg_status push_out(hg_ctx *ctx, const hg_body *body, hg_groom *groom, hg_fit_report *report)
{
    int64_t n = groom->vertices, count = groom->strands * n;
    push p = { .strands = groom->strands, .vertices = n };
    p.x = hg_alloc((size_t)count, 3 * sizeof *p.x);
    p.arc = hg_alloc((size_t)n, sizeof *p.arc);
    p.need = hg_alloc((size_t)n, 3 * sizeof *p.need);
    p.displacement = hg_alloc((size_t)n, 3 * sizeof *p.displacement);
    p.smooth = hg_alloc((size_t)n, 3 * sizeof *p.smooth);
    p.moved = hg_alloc((size_t)groom->strands, sizeof *p.moved);
    float *strand = hg_alloc((size_t)n, 3 * sizeof *strand);
    hg_status status = p.x && p.arc && p.need && p.displacement && p.smooth && p.moved && strand ? HG_OK : HG_MEMORY;
    if (status == HG_OK) {
        for (int64_t i = 0; i < 3 * count; i++) p.x[i] = (double)groom->points[i];
        status = surface_make(&p.body, ctx, body, 0, NULL, count);
    }
    if (status == HG_OK) status = count_inside(&p, &report->inside_before);
    for (int cycle = 0; status == HG_OK && cycle < PUSH_CYCLES; cycle++) {
        status = push_rounds(&p, PUSH_ROUNDS, MARGIN);
        resample_moved(&p, strand);
    }
    if (status == HG_OK) status = push_rounds(&p, LAST_ROUNDS, LAST_MARGIN);
    if (status == HG_OK) status = count_inside(&p, &report->inside_after);
    for (int64_t s = 0; status == HG_OK && s < groom->strands; s++)
        for (int64_t i = 3 * s * n; p.moved[s] && i < 3 * (s + 1) * n; i++) groom->points[i] = (float)p.x[i];
    surface_free(&p.body);
    hg_free(p.x);
    hg_free(p.arc);
    hg_free(p.need);
    hg_free(p.displacement);
    hg_free(p.smooth);
    hg_free(p.moved);
    hg_free(strand);
    return status;
}

/* ---- binding ------------------------------------------------------------------------------------------------- */

/* Weights of the corners of a triangle at a point on it; a degenerate triangle gives its first corner. */
static void barycentric(const hg_body *body, int64_t face, hg_vec3d at, float out[3])
{
    hg_vec3d p[3];
    for (int k = 0; k < 3; k++) {
        const float *v = body->points + 3 * (int64_t)body->triangles[3 * face + k];
        p[k] = hg_vec3d_make((double)v[0], (double)v[1], (double)v[2]);
    }
    hg_vec3d a = hg_vec3d_sub(p[1], p[0]), b = hg_vec3d_sub(p[2], p[0]), c = hg_vec3d_sub(at, p[0]);
    double aa = hg_vec3d_dot(a, a), ab = hg_vec3d_dot(a, b), bb = hg_vec3d_dot(b, b), ac = hg_vec3d_dot(a, c),
           bc = hg_vec3d_dot(b, c);
    double area = aa * bb - ab * ab, u = 0, v = 0;
    if (area > 0) {
        u = fmin(fmax((bb * ac - ab * bc) / area, 0), 1);
        v = fmin(fmax((aa * bc - ab * ac) / area, 0), 1 - u);
    }
    out[0] = (float)(1 - u - v);
    out[1] = (float)u;
    out[2] = (float)v;
}

/* Roots to the closest points of the scalp; strands are moved along. */
static hg_status bind(hg_ctx *ctx, const hg_body *body, hg_groom *groom, hg_fit_report *report)
{
    int64_t n = groom->strands;
    surface scalp = { 0 };
    double *root = hg_alloc((size_t)n, 3 * sizeof *root), *moved = hg_alloc((size_t)n, sizeof *moved);
    hg_status status = root && moved ? surface_make(&scalp, ctx, body, body->scalp_faces, body->scalp, n) : HG_MEMORY;
    for (int64_t i = 0; status == HG_OK && i < 3 * n; i++)
        root[i] = (double)groom->points[3 * (i / 3) * groom->vertices + i % 3];
    if (status == HG_OK) status = surface_query(&scalp, n, root);
    for (int64_t s = 0; status == HG_OK && s < n; s++) {
        if (scalp.triangle[s] < 0) {
            status = hg_fail(HG_NUMERIC, "strand %lld: its root is not finite", (long long)s);
            break;
        }
        hg_vec3d to = hg_vec3d_load(scalp.point + 3 * s), step = hg_vec3d_sub(to, hg_vec3d_load(root + 3 * s));
        float *points = groom->points + 3 * s * groom->vertices;
        for (int64_t v = 0; v < groom->vertices; v++) {
            points[3 * v] = (float)((double)points[3 * v] + step.x);
            points[3 * v + 1] = (float)((double)points[3 * v + 1] + step.y);
            points[3 * v + 2] = (float)((double)points[3 * v + 2] + step.z);
        }
        groom->root_face[s] = body->scalp[scalp.triangle[s]];
        barycentric(body, groom->root_face[s], to, groom->root_bary + 3 * s);
        hg_scalp_project(body, points, groom->root_uv + 2 * s);
        moved[s] = hg_vec3d_norm(step);
        report->moved_far += moved[s] > 0.01;
    }
    if (status == HG_OK) {
        qsort(moved, (size_t)n, sizeof *moved, compare);
        report->moved_median = moved[n / 2];
        report->moved_p95 = moved[(int64_t)(0.95 * (double)(n - 1))];
        report->moved_max = moved[n - 1];
    }
    surface_free(&scalp);
    hg_free(root);
    hg_free(moved);
    return status;
}

hg_status hg_fit_groom(hg_ctx *ctx, hg_groom *groom, const hg_body *body, const hg_similarity *similarity,
                       hg_fit_report *report)
{
    hg_fit_report unused;
    if (!report) report = &unused;
    *report = (hg_fit_report){ 0 };
    if (body->scalp_faces < 1) return hg_fail(HG_INVALID, "the body has no scalp faces, so no hair can grow on it");
    if (groom->strands < 1 || groom->vertices < 2)
        return hg_fail(HG_INVALID, "a groom of %lld strands of %lld vertices", (long long)groom->strands,
                       (long long)groom->vertices);
    if (similarity) {
        hg_quatd turn = hg_quatd_normalize(hg_quatd_load(similarity->rotation));
        hg_vec3d move = hg_vec3d_load(similarity->translation);
        if (!(similarity->scale > 0) || !isfinite(similarity->scale) || !hg_vec3d_finite(move))
            return hg_fail(HG_INVALID, "a similarity of scale %g and translation (%g, %g, %g)", similarity->scale,
                           move.x, move.y, move.z);
        for (int64_t i = 0; i < groom->strands * groom->vertices; i++) {
            float *at = groom->points + 3 * i;
            hg_vec3d x = hg_quatd_rotate(turn, hg_vec3d_make((double)at[0], (double)at[1], (double)at[2]));
            x = hg_vec3d_add_scaled(move, similarity->scale, x);
            at[0] = (float)x.x;
            at[1] = (float)x.y;
            at[2] = (float)x.z;
        }
    }
    HG_TRY(bind(ctx, body, groom, report));
    HG_TRY(push_out(ctx, body, groom, report));
    groom->body_hash = hg_body_hash(body);
    return HG_OK;
}
