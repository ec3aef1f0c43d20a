/* Grooms: memory, files, and strands of equal arc length from the ragged curves that readers find. */
#include "scene/internal.h"

#include <stdlib.h>
#include <string.h>

#define GROOM_FORMAT "hairgrad groom"

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
        if (scene_length(p, v) < SCENE_SHORTEST)
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

static hg_status groom_read(hg_h5 *file, const char *path, const scene_axes *axes, void *to)
{
    hg_groom *g = to;
    int64_t shape[6];
    char *hash;
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
    scene_axes_points(axes, g->points, g->strands * g->vertices);
    return groom_check(g, path);
}

hg_status hg_groom_load(hg_groom **groom, const char *path)
{
    *groom = NULL;
    hg_groom *g = hg_alloc(1, sizeof *g);
    hg_status status = g ? scene_file_load(path, GROOM_FORMAT, groom_read, g) : HG_MEMORY;
    if (status == HG_OK)
        *groom = g;
    else
        hg_groom_destroy(g);
    return status;
}

static hg_status groom_write(hg_h5 *file, const void *from)
{
    const hg_groom *g = from;
    HG_TRY(hg_h5_set_text(file, "/", "name", g->name ? g->name : ""));
    HG_TRY(scene_hash_write(file, "body_hash", g->body_hash));
    HG_TRY(hg_h5_write(file, "/strands", HG_F32, 3, (int64_t[]){ g->strands, g->vertices, 3 }, g->points));
    HG_TRY(hg_h5_write(file, "/root_face", HG_I32, 1, (int64_t[]){ g->strands }, g->root_face));
    HG_TRY(hg_h5_write(file, "/root_barycentric", HG_F32, 2, (int64_t[]){ g->strands, 3 }, g->root_bary));
    return hg_h5_write(file, "/root_uv", HG_F32, 2, (int64_t[]){ g->strands, 2 }, g->root_uv);
}

hg_status hg_groom_save(const hg_groom *groom, const char *path)
{
    if (groom->strands < 1) return hg_fail(HG_INVALID, "%s: a groom without strands cannot be saved", path);
    HG_TRY(groom_check(groom, path));
    return scene_file_save(path, GROOM_FORMAT, groom_write, groom);
}
