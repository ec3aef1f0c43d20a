/* Ragged strands: memory, what is wrong with them, choosing and resampling some, and grooms of equal strands from them. */
#include "scene/internal.h"

#include <string.h>

#define REPEATS 1e-9 /* m; two points nearer than this are one */

hg_status hg_curves_create(hg_curves **curves, int64_t strands, int64_t points)
{
    hg_curves *c = hg_alloc(1, sizeof *c);
    *curves = NULL;
    if (!c) return HG_MEMORY;
    c->strands = strands;
    c->start = hg_alloc((size_t)strands + 1, sizeof *c->start);
    c->points = hg_alloc((size_t)(points > 0 ? points : 1), 3 * sizeof *c->points);
    if (!c->start || !c->points) {
        hg_curves_destroy(c);
        return HG_MEMORY;
    }
    *curves = c;
    return HG_OK;
}

void hg_curves_destroy(hg_curves *curves)
{
    if (!curves) return;
    hg_free(curves->start);
    hg_free(curves->points);
    hg_free(curves->root_uv);
    hg_free(curves->root_face);
    hg_free(curves->root_bary);
    hg_free(curves);
}

/* ---- what is wrong with a strand ---------------------------------------------------------------------------- */

scene_strand_kind scene_strand_classify(const float *points, int64_t n)
{
    double extent = 0;
    for (int64_t i = 0; i < 3 * n; i++)
        if (!isfinite(points[i])) return STRAND_NON_FINITE;
    if (n < 2) return STRAND_BALD;
    for (int64_t i = 1; i < n; i++)
        extent = fmax(extent, hg_vec3d_distance(scene_point(points), scene_point(points + 3 * i)));
    return scene_length(points, n) < SCENE_SHORTEST || extent < 2 * REPEATS ? STRAND_ZERO_LENGTH : STRAND_KEPT;
}

int64_t scene_strand_points(const float *points, int64_t n, double *out)
{
    int64_t kept = 0;
    for (int64_t i = 0; i < n; i++) {
        hg_vec3d p = scene_point(points + 3 * i);
        if (kept == 0 || hg_vec3d_distance(p, hg_vec3d_load(out + 3 * (kept - 1))) >= REPEATS)
            hg_vec3d_store(out + 3 * kept++, p);
    }
    return kept;
}

static void report_add(hg_groom_report *report, scene_strand_kind kind)
{
    report->kept += kind == STRAND_KEPT;
    report->bald += kind == STRAND_BALD;
    report->zero_length += kind == STRAND_ZERO_LENGTH;
    report->non_finite += kind == STRAND_NON_FINITE;
}

static hg_status nothing_left(const hg_groom_report *report)
{
    return hg_fail(HG_INVALID,
                   "no strand is left of %lld: %lld bald (one vertex or none), %lld of zero length, %lld not finite",
                   (long long)report->strands, (long long)report->bald, (long long)report->zero_length,
                   (long long)report->non_finite);
}

/* ---- choosing ----------------------------------------------------------------------------------------------- */

hg_status hg_curves_select(hg_curves *curves, int64_t n, const int64_t *strand)
{
    int64_t to = 0;
    for (int64_t i = 0; i < n; i++) {
        int64_t s = strand[i];
        if (s < 0 || s >= curves->strands || (i > 0 && s <= strand[i - 1]))
            return hg_fail(HG_INVALID, "strand %lld cannot be chosen: there are %lld, in ascending order", (long long)s,
                           (long long)curves->strands);
        int64_t first = curves->start[s], count = curves->start[s + 1] - first;
        memmove(curves->points + 3 * to, curves->points + 3 * first, (size_t)count * 3 * sizeof *curves->points);
        if (curves->root_uv) memmove(curves->root_uv + 2 * i, curves->root_uv + 2 * s, 2 * sizeof *curves->root_uv);
        if (curves->root_face) curves->root_face[i] = curves->root_face[s];
        if (curves->root_bary)
            memmove(curves->root_bary + 3 * i, curves->root_bary + 3 * s, 3 * sizeof *curves->root_bary);
        curves->start[i] = to; /* s >= i: what is still to be read is not overwritten */
        to += count;
    }
    curves->start[n] = to;
    curves->strands = n;
    return HG_OK;
}

hg_status hg_curves_clean(hg_curves *curves, hg_groom_report *report)
{
    hg_groom_report counted = { .strands = curves->strands };
    int64_t *kept = hg_alloc((size_t)curves->strands + 1, sizeof *kept);
    if (!kept) return HG_MEMORY;
    for (int64_t s = 0; s < curves->strands; s++) {
        int64_t first = curves->start[s], before = counted.kept;
        report_add(&counted, scene_strand_classify(curves->points + 3 * first, curves->start[s + 1] - first));
        if (counted.kept > before) kept[before] = s;
    }
    if (report) *report = counted;
    hg_status status = counted.kept ? hg_curves_select(curves, counted.kept, kept) : nothing_left(&counted);
    hg_free(kept);
    return status;
}

/* ---- resampling --------------------------------------------------------------------------------------------- */

static int64_t longest(const hg_curves *curves)
{
    int64_t most = 1;
    for (int64_t s = 0; s < curves->strands; s++)
        if (curves->start[s + 1] - curves->start[s] > most) most = curves->start[s + 1] - curves->start[s];
    return most;
}

hg_status hg_curves_resample(hg_curves *curves, int64_t vertices)
{
    if (vertices < 2 || vertices > 65536 || curves->strands > INT64_MAX / 12 / vertices)
        return hg_fail(HG_INVALID, "%lld vertices per strand: 2 to 65536 are possible", (long long)vertices);
    double *scratch = hg_alloc((size_t)longest(curves), 3 * sizeof *scratch);
    float *points = hg_alloc((size_t)(curves->strands * vertices), 3 * sizeof *points);
    hg_status status = scratch && points ? HG_OK : HG_MEMORY;
    for (int64_t s = 0; status == HG_OK && s < curves->strands; s++) {
        const float *from = curves->points + 3 * curves->start[s];
        int64_t n = curves->start[s + 1] - curves->start[s];
        if (scene_strand_classify(from, n) == STRAND_KEPT)
            scene_resample(scratch, scene_strand_points(from, n, scratch), vertices, points + 3 * vertices * s);
        else
            status = hg_fail(HG_INVALID, "strand %lld is bald, without length or not finite: it cannot be resampled",
                             (long long)s);
    }
    hg_free(scratch);
    if (status != HG_OK) {
        hg_free(points);
        return status;
    }
    hg_free(curves->points);
    curves->points = points;
    for (int64_t s = 0; s <= curves->strands; s++) curves->start[s] = s * vertices;
    return HG_OK;
}

hg_status scene_equal_vertices(const hg_curves *curves, const char *path, int64_t *vertices)
{
    *vertices = curves->start[1];
    for (int64_t s = 1; s < curves->strands; s++)
        if (curves->start[s + 1] - curves->start[s] != *vertices)
            return hg_fail(HG_INVALID,
                           "%s: strand 0 has %lld vertices and strand %lld has %lld; .%s holds strands of one number "
                           "only: resample them (--vertices N)",
                           path, (long long)*vertices, (long long)s,
                           (long long)(curves->start[s + 1] - curves->start[s]), hg_path_extension(path));
    return HG_OK;
}

hg_status scene_finite_strands(const hg_curves *curves, const char *path)
{
    for (int64_t s = 0; s < curves->strands; s++)
        for (int64_t i = 3 * curves->start[s]; i < 3 * curves->start[s + 1]; i++)
            if (!isfinite(curves->points[i]))
                return hg_fail(HG_INVALID, "%s: strand %lld is not finite, which text cannot hold", path, (long long)s);
    return HG_OK;
}

/* ---- units and axes ----------------------------------------------------------------------------------------- */

void hg_curves_to_world(hg_curves *curves, double unit, bool z_up)
{
    for (int64_t i = 0; i < curves->start[curves->strands]; i++) {
        float *p = curves->points + 3 * i, y = p[1];
        if (z_up) p[1] = p[2], p[2] = -y;
        for (int k = 0; unit != 1 && k < 3; k++) p[k] = (float)(unit * (double)p[k]);
    }
}

void hg_curves_from_world(hg_curves *curves, double unit, bool z_up)
{
    for (int64_t i = 0; i < curves->start[curves->strands]; i++) {
        float *p = curves->points + 3 * i, y = p[1];
        if (z_up) p[1] = -p[2], p[2] = y;
        for (int k = 0; unit != 1 && k < 3; k++) p[k] = (float)((double)p[k] / unit);
    }
}

/* ---- grooms ------------------------------------------------------------------------------------------------- */

hg_status hg_groom_from_curves(hg_groom **groom, const hg_curves *curves, int64_t vertices, hg_groom_report *report)
{
    hg_groom_report counted = { .strands = curves->strands };
    *groom = NULL;
    for (int64_t s = 0; s < curves->strands; s++)
        report_add(&counted, scene_strand_classify(curves->points + 3 * curves->start[s],
                                                   curves->start[s + 1] - curves->start[s]));
    if (report) *report = counted;
    if (counted.kept == 0) return nothing_left(&counted);
    double *points = hg_alloc((size_t)longest(curves), 3 * sizeof *points);
    if (!points) return HG_MEMORY;
    hg_status status = hg_groom_create(groom, counted.kept, vertices);
    for (int64_t s = 0, kept = 0; status == HG_OK && s < curves->strands; s++) {
        const float *from = curves->points + 3 * curves->start[s];
        int64_t n = curves->start[s + 1] - curves->start[s];
        if (scene_strand_classify(from, n) != STRAND_KEPT) continue;
        n = scene_strand_points(from, n, points);
        scene_resample(points, n, vertices, (*groom)->points + 3 * vertices * kept++);
    }
    hg_free(points);
    return status;
}

hg_status hg_groom_to_curves(hg_curves **curves, const hg_groom *groom)
{
    size_t n = (size_t)groom->strands;
    HG_TRY(hg_curves_create(curves, groom->strands, groom->strands * groom->vertices));
    hg_curves *c = *curves;
    c->root_uv = hg_alloc(n ? n : 1, 2 * sizeof *c->root_uv);
    c->root_face = hg_alloc(n ? n : 1, sizeof *c->root_face);
    c->root_bary = hg_alloc(n ? n : 1, 3 * sizeof *c->root_bary);
    if (!c->root_uv || !c->root_face || !c->root_bary) {
        hg_curves_destroy(c);
        *curves = NULL;
        return HG_MEMORY;
    }
    for (int64_t s = 0; s <= groom->strands; s++) c->start[s] = s * groom->vertices;
    memcpy(c->points, groom->points, n * (size_t)groom->vertices * 3 * sizeof *c->points);
    memcpy(c->root_uv, groom->root_uv, n * 2 * sizeof *c->root_uv);
    memcpy(c->root_face, groom->root_face, n * sizeof *c->root_face);
    memcpy(c->root_bary, groom->root_bary, n * 3 * sizeof *c->root_bary);
    c->body_hash = groom->body_hash;
    return HG_OK;
}
