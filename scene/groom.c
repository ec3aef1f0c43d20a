/* Grooms: memory, files, and strands of equal arc length from the ragged curves that readers find. */
#include "scene/internal.h"

#include <stdlib.h>
#include <string.h>

#define GROOM_FORMAT "hairgrad groom"
#define SHORTEST     1e-6 /* m; a strand below this has no direction, and rest lengths are never divided by less */
#define REPEATS      1e-9 /* m; two points nearer than this are one */

hg_status hg_groom_create(hg_groom **groom, int64_t strands, int64_t vertices)
{
    *groom = NULL;
    if (strands < 0 || strands > INT32_MAX || vertices < 2 || vertices > 65536)
        return hg_fail(HG_INVALID, "groom of %lld strands x %lld vertices: a strand has 2 to 65536 vertices",
                       (long long)strands, (long long)vertices);
    hg_groom *g = hg_alloc(1, sizeof *g);
    if (!g) return HG_MEMORY;
    size_t n = strands ? (size_t)strands : 1;
    g->strands = strands, g->vertices = vertices;
    g->points = hg_alloc(n, (size_t)vertices * 3 * sizeof *g->points);
    g->root_face = hg_alloc(n, sizeof *g->root_face);
    g->root_bary = hg_alloc(n, 3 * sizeof *g->root_bary);
    g->root_uv = hg_alloc(n, 2 * sizeof *g->root_uv);
    if (!g->points || !g->root_face || !g->root_bary || !g->root_uv) {
        hg_groom_destroy(g);
        return HG_MEMORY;
    }
    for (int64_t i = 0; i < strands; i++) g->root_face[i] = -1;
    *groom = g;
    return HG_OK;
}

void hg_groom_destroy(hg_groom *groom)
{
    if (!groom) return;
    hg_free(groom->points);
    hg_free(groom->root_face);
    hg_free(groom->root_bary);
    hg_free(groom->root_uv);
    hg_free(groom->name);
    hg_free(groom);
}

uint64_t hg_groom_hash(const hg_groom *groom)
{
    int64_t counts[2] = { groom->strands, groom->vertices };
    size_t n = (size_t)groom->strands;
    uint64_t hash = hg_hash(counts, sizeof counts, groom->body_hash);
    hash = hg_hash(groom->points, n * (size_t)groom->vertices * 3 * sizeof *groom->points, hash);
    hash = hg_hash(groom->root_face, n * sizeof *groom->root_face, hash);
    hash = hg_hash(groom->root_bary, n * 3 * sizeof *groom->root_bary, hash);
    return hg_hash(groom->root_uv, n * 2 * sizeof *groom->root_uv, hash);
}

/* ---- files -------------------------------------------------------------------------------------------------- */

/* A native groom was checked when it was made: anything wrong in it is damage, and is refused rather than repaired. */
static hg_status groom_check(const hg_groom *g, const char *path)
{
    int64_t v = g->vertices;
    for (int64_t s = 0; s < g->strands; s++) {
        const float *p = g->points + 3 * v * s;
        for (int64_t i = 0; i < 3 * v; i++)
            if (!isfinite(p[i]))
                return hg_fail(HG_NUMERIC,
                               "%s: strand %lld, vertex %lld is not finite; import the groom again, which drops and "
                               "counts such strands",
                               path, (long long)s, (long long)(i / 3));
        if (scene_length(p, v) < SHORTEST)
            return hg_fail(HG_NUMERIC,
                           "%s: strand %lld has no length; import the groom again, which drops and counts such strands",
                           path, (long long)s);
        const float *w = g->root_bary + 3 * s, *uv = g->root_uv + 2 * s;
        if (g->root_face[s] < -1)
            return hg_fail(HG_FORMAT, "%s: strand %lld has root face %d, expected a face or -1", path, (long long)s,
                           g->root_face[s]);
        if (g->root_face[s] >= 0 &&
            !(fabsf(w[0] + w[1] + w[2] - 1) < 1e-3f && w[0] > -1e-3f && w[1] > -1e-3f && w[2] > -1e-3f))
            return hg_fail(HG_FORMAT,
                           "%s: strand %lld has root barycentrics (%g, %g, %g), expected three weights with sum 1",
                           path, (long long)s, (double)w[0], (double)w[1], (double)w[2]);
        if (!(uv[0] >= 0 && uv[0] <= 1 && uv[1] >= 0 && uv[1] <= 1))
            return hg_fail(HG_FORMAT, "%s: strand %lld has root UV (%g, %g), expected numbers from 0 to 1", path,
                           (long long)s, (double)uv[0], (double)uv[1]);
    }
    return HG_OK;
}

static hg_status groom_read(hg_h5 *file, const char *path, hg_groom *g)
{
    int64_t shape[6];
    scene_axes axes;
    char *hash;
    HG_TRY(scene_format_check(file, path, GROOM_FORMAT));
    HG_TRY(scene_axes_read(file, path, &axes));
    HG_TRY(hg_h5_read(file, "/strands", HG_F32, 3, (int64_t[]){ -1, -1, 3 }, shape, (void **)&g->points));
    g->strands = shape[0], g->vertices = shape[1];
    if (g->strands < 1 || g->strands > INT32_MAX || g->vertices < 2 || g->vertices > 65536)
        return hg_fail(HG_FORMAT, "%s: strands is [%lld,%lld,3], expected at least one strand of 2 to 65536 vertices",
                       path, (long long)g->strands, (long long)g->vertices);
    HG_TRY(hg_h5_read(file, "/root_face", HG_I32, 1, (int64_t[]){ g->strands }, NULL, (void **)&g->root_face));
    HG_TRY(
        hg_h5_read(file, "/root_barycentric", HG_F32, 2, (int64_t[]){ g->strands, 3 }, NULL, (void **)&g->root_bary));
    HG_TRY(hg_h5_read(file, "/root_uv", HG_F32, 2, (int64_t[]){ g->strands, 2 }, NULL, (void **)&g->root_uv));
    HG_TRY(scene_text_or(file, "name", "", &g->name));
    HG_TRY(scene_text_or(file, "body_hash", "0", &hash));
    char *end;
    g->body_hash = strtoull(hash, &end, 16);
    bool whole = *hash && !*end;
    hg_free(hash);
    if (!whole) return hg_fail(HG_FORMAT, "%s: attribute body_hash is not a hexadecimal number", path);
    scene_axes_points(&axes, g->points, g->strands * g->vertices);
    return groom_check(g, path);
}

hg_status hg_groom_load(hg_groom **groom, const char *path)
{
    hg_h5 *file;
    *groom = NULL;
    HG_TRY(hg_h5_open(&file, path));
    hg_groom *g = hg_alloc(1, sizeof *g);
    hg_status status = g ? groom_read(file, path, g) : HG_MEMORY;
    hg_h5_close(file);
    if (status == HG_OK)
        *groom = g;
    else
        hg_groom_destroy(g);
    return status;
}

static hg_status groom_write(hg_h5 *file, const hg_groom *g)
{
    HG_TRY(scene_format_write(file, GROOM_FORMAT));
    HG_TRY(scene_axes_write(file));
    HG_TRY(hg_h5_set_text(file, "/", "name", g->name ? g->name : ""));
    HG_TRY(scene_hash_write(file, "body_hash", g->body_hash));
    HG_TRY(hg_h5_write(file, "/strands", HG_F32, 3, (int64_t[]){ g->strands, g->vertices, 3 }, g->points));
    HG_TRY(hg_h5_write(file, "/root_face", HG_I32, 1, (int64_t[]){ g->strands }, g->root_face));
    HG_TRY(hg_h5_write(file, "/root_barycentric", HG_F32, 2, (int64_t[]){ g->strands, 3 }, g->root_bary));
    return hg_h5_write(file, "/root_uv", HG_F32, 2, (int64_t[]){ g->strands, 2 }, g->root_uv);
}

hg_status hg_groom_save(const hg_groom *groom, const char *path)
{
    hg_h5 *file;
    if (groom->strands < 1) return hg_fail(HG_INVALID, "%s: a groom without strands cannot be saved", path);
    HG_TRY(groom_check(groom, path));
    HG_TRY(hg_h5_create(&file, path));
    hg_status status = groom_write(file, groom);
    if (status == HG_OK) return hg_h5_commit(file);
    hg_h5_close(file);
    return status;
}

/* ---- from curves -------------------------------------------------------------------------------------------- */

void hg_curves_destroy(hg_curves *curves)
{
    if (!curves) return;
    hg_free(curves->start);
    hg_free(curves->points);
    hg_free(curves);
}

typedef enum { STRAND_KEPT, STRAND_BALD, STRAND_BROKEN, STRAND_ZERO_LENGTH, STRAND_NON_FINITE } strand_kind;

static strand_kind strand_classify(const float *points, int64_t n)
{
    double extent = 0;
    if (n == 0) return STRAND_BALD;
    for (int64_t i = 0; i < 3 * n; i++)
        if (!isfinite(points[i])) return STRAND_NON_FINITE;
    if (n == 1) return STRAND_BROKEN;
    for (int64_t i = 1; i < n; i++)
        extent = fmax(extent, hg_vec3d_distance(scene_point(points), scene_point(points + 3 * i)));
    return scene_length(points, n) < SHORTEST || extent < 2 * REPEATS ? STRAND_ZERO_LENGTH : STRAND_KEPT;
}

/* Leaves out points that repeat the one before. */
static int64_t strand_points(const float *points, int64_t n, double *out)
{
    int64_t kept = 0;
    for (int64_t i = 0; i < n; i++) {
        hg_vec3d p = scene_point(points + 3 * i);
        if (kept == 0 || hg_vec3d_distance(p, hg_vec3d_load(out + 3 * (kept - 1))) >= REPEATS)
            hg_vec3d_store(out + 3 * kept++, p);
    }
    return kept;
}

hg_status hg_groom_from_curves(hg_groom **groom, const hg_curves *curves, int64_t vertices, hg_groom_report *report)
{
    hg_groom_report counted = { .strands = curves->strands };
    int64_t longest = 0;
    *groom = NULL;
    for (int64_t s = 0; s < curves->strands; s++) {
        int64_t first = curves->start[s], n = curves->start[s + 1] - first;
        if (n > longest) longest = n;
        switch (strand_classify(curves->points + 3 * first, n)) {
        case STRAND_KEPT:
            counted.kept++;
            break;
        case STRAND_BALD:
            counted.bald++;
            break;
        case STRAND_BROKEN:
            counted.broken++;
            break;
        case STRAND_ZERO_LENGTH:
            counted.zero_length++;
            break;
        case STRAND_NON_FINITE:
            counted.non_finite++;
            break;
        }
    }
    if (report) *report = counted;
    if (counted.kept == 0)
        return hg_fail(HG_INVALID,
                       "no strand is left of %lld: %lld without vertices, %lld with one vertex, %lld of zero length, "
                       "%lld not finite",
                       (long long)counted.strands, (long long)counted.bald, (long long)counted.broken,
                       (long long)counted.zero_length, (long long)counted.non_finite);
    double *points = hg_alloc((size_t)longest, 3 * sizeof *points);
    if (!points) return HG_MEMORY;
    hg_status status = hg_groom_create(groom, counted.kept, vertices);
    for (int64_t s = 0, kept = 0; status == HG_OK && s < curves->strands; s++) {
        const float *from = curves->points + 3 * curves->start[s];
        int64_t n = curves->start[s + 1] - curves->start[s];
        if (strand_classify(from, n) != STRAND_KEPT) continue;
        n = strand_points(from, n, points);
        scene_resample(points, n, vertices, (*groom)->points + 3 * vertices * kept++);
    }
    hg_free(points);
    return status;
}
