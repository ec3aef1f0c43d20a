/* What pictures are drawn from: drapes (VTKHDF), posed scenes and grooms, and the bodies that go with them. */
#include "export/source.h"

#include <math.h>
#include <string.h>

/* ---- strands ------------------------------------------------------------------------------------------------- */

static hg_status open_drape(hg_source *s)
{
    double frames, strands, vertices;
    if (hg_h5_get_number(s->h5, "", "T", &frames) != HG_OK || hg_h5_get_number(s->h5, "", "S", &strands) != HG_OK ||
        hg_h5_get_number(s->h5, "", "V", &vertices) != HG_OK || hg_h5_get_number(s->h5, "", "rate", &s->rate) != HG_OK)
        return hg_fail(HG_FORMAT, "%s: is VTKHDF, but has not the attributes T, S, V and rate of a drape of strands",
                       s->path);
    int rank;
    int64_t shape[6];
    HG_TRY(hg_h5_shape(s->h5, "VTKHDF/Points", &rank, shape));
    if (!(frames >= 1 && strands >= 1 && vertices >= 1 && frames * strands * vertices == (double)shape[0]) ||
        rank != 2 || shape[1] != 3 || !(s->rate > 0.0))
        return hg_fail(HG_FORMAT,
                       "%s: attributes say %g frames of %g strands of %g vertices, but there are %lld points", s->path,
                       frames, strands, vertices, (long long)shape[0]);
    s->frames = (int64_t)frames;
    s->strands = (int64_t)strands;
    s->vertices = (int64_t)vertices;
    s->points = "VTKHDF/Points";
    s->flat = true;
    if (hg_h5_has(s->h5, "hairgrad/root_rotation") && hg_h5_has(s->h5, "hairgrad/root_position")) {
        s->rotations = "hairgrad/root_rotation";
        s->positions = "hairgrad/root_position";
    }
    if (!hg_h5_has(s->h5, "hairgrad/rest")) return HG_OK;
    return hg_h5_read(s->h5, "hairgrad/rest", HG_F32, 3, (int64_t[]){ s->strands, s->vertices, 3 }, NULL,
                      (void **)&s->rest);
}

/* A groom is its own rest groom, and all that there is. */
static hg_status open_groom(hg_source *s)
{
    hg_groom *groom;
    HG_TRY(hg_groom_load(&groom, s->path));
    s->frames = 1;
    s->rate = 30.0;
    s->strands = groom->strands;
    s->vertices = groom->vertices;
    s->rest = groom->points;
    groom->points = NULL;
    hg_groom_destroy(groom);
    return HG_OK;
}

/* A posed scene has strands [T,S,V,3], a groom [S,V,3]. */
static hg_status open_plain(hg_source *s)
{
    if (!hg_h5_has(s->h5, "strands"))
        return hg_fail(HG_FORMAT, "%s: holds neither a drape (/VTKHDF) nor /strands of a groom or a posed scene",
                       s->path);
    int rank;
    int64_t shape[6];
    HG_TRY(hg_h5_shape(s->h5, "strands", &rank, shape));
    if (rank == 3) return open_groom(s);
    if (rank != 4 || shape[3] != 3 || shape[0] < 1)
        return hg_fail(HG_FORMAT, "%s: /strands has %d axes; a groom's are [S,V,3], a posed scene's [T,S,V,3]", s->path,
                       rank);
    s->points = "strands";
    s->frames = shape[0];
    s->strands = shape[1];
    s->vertices = shape[2];
    if (hg_h5_get_number(s->h5, "", "rate", &s->rate) != HG_OK || !(s->rate > 0.0)) s->rate = 30.0;
    if (hg_h5_has(s->h5, "root_rotation")) s->rotations = "root_rotation";
    if (hg_h5_has(s->h5, "root_position")) s->positions = "root_position";
    return HG_OK;
}

static hg_status make_room(hg_source *s)
{
    if (s->strands < 1 || s->vertices < 1 || s->strands > INT32_MAX / s->vertices)
        return hg_fail(HG_FORMAT, "%s: %lld strands of %lld vertices", s->path, (long long)s->strands,
                       (long long)s->vertices);
    s->x = hg_alloc((size_t)(s->strands * s->vertices), 3 * sizeof *s->x);
    s->rotation = hg_alloc((size_t)s->strands, 4 * sizeof *s->rotation);
    s->position = hg_alloc((size_t)s->strands, 3 * sizeof *s->position);
    return s->x && s->rotation && s->position ? HG_OK : HG_MEMORY;
}

/* ---- body ---------------------------------------------------------------------------------------------------- */

/* A body.vtkhdf: triangles and vertices by frame. */
static hg_status open_moving_body(hg_source *s, const char *path)
{
    double frames;
    int rank;
    int64_t shape[6], any[1] = { -1 };
    HG_TRY(hg_h5_shape(s->body_h5, "VTKHDF/Points", &rank, shape));
    HG_TRY(hg_h5_read(s->body_h5, "VTKHDF/Polygons/Connectivity", HG_I32, 1, any, any, (void **)&s->triangles));
    if (hg_h5_get_number(s->body_h5, "", "T", &frames) != HG_OK || !(frames >= 1) || rank != 2 || shape[1] != 3 ||
        shape[0] % (int64_t)frames != 0 || any[0] % 3 != 0)
        return hg_fail(HG_FORMAT, "%s: is not a moving triangle mesh as hairgrad writes it", path);
    s->body_frames = (int64_t)frames;
    s->body_vertices = shape[0] / s->body_frames;
    s->body_faces = any[0] / 3;
    s->body_points = "VTKHDF/Points";
    s->body_flat = true;
    if (!hg_h5_has(s->body_h5, "hairgrad/rest")) return HG_OK;
    return hg_h5_read(s->body_h5, "hairgrad/rest", HG_F32, 2, (int64_t[]){ s->body_vertices, 3 }, NULL,
                      (void **)&s->body_rest);
}

/* A posed scene has the body's vertices by frame, for whatever triangles were found. */
static hg_status use_posed_vertices(hg_source *s)
{
    int rank;
    int64_t shape[6];
    HG_TRY(hg_h5_shape(s->h5, "body_vertices", &rank, shape));
    if (rank != 3 || shape[2] != 3 || (s->body_vertices > 0 && shape[1] != s->body_vertices))
        return hg_fail(HG_FORMAT, "%s: /body_vertices has %lld vertices a frame, the body %lld", s->path,
                       (long long)shape[1], (long long)s->body_vertices);
    s->body_points = "body_vertices";
    s->body_frames = shape[0];
    s->body_vertices = shape[1];
    s->body_h5 = s->h5;
    return HG_OK;
}

/* A body.h5 has the triangles and the rest vertices. */
static hg_status open_body(hg_source *s, const char *path)
{
    hg_body *body;
    HG_TRY(hg_body_load(&body, path));
    s->body_vertices = body->vertices;
    s->body_faces = body->faces;
    s->body_rest = body->points;
    s->triangles = body->triangles;
    body->points = NULL;
    body->triangles = NULL;
    hg_body_destroy(body);
    return hg_h5_has(s->h5, "body_vertices") ? use_posed_vertices(s) : HG_OK;
}

static hg_status open_posed_body(hg_source *s)
{
    int64_t shape[2] = { -1, 3 };
    HG_TRY(hg_h5_read(s->h5, "triangles", HG_I32, 2, shape, shape, (void **)&s->triangles));
    s->body_faces = shape[0];
    return use_posed_vertices(s);
}

/* The body that a drape names lies beside it; without it the hair is drawn alone. */
static char *body_beside(hg_source *s)
{
    char *name;
    if (hg_h5_get_text(s->h5, "hairgrad", "body", &name) != HG_OK) return NULL;
    const char *slash = strrchr(s->path, '/');
    char *path = slash ? hg_format("%.*s/%s", (int)(slash - s->path), s->path, name) : hg_strdup(name);
    hg_free(name);
    if (path && hg_file_exists(path)) return path;
    hg_free(path);
    return NULL;
}

static hg_status find_body(hg_source *s, const char *given)
{
    char *found = NULL;
    if (!given && hg_h5_has(s->h5, "VTKHDF")) found = body_beside(s);
    const char *path = given ? given : found;
    hg_status status = HG_OK;
    hg_h5 *h5 = NULL;
    if (!path) {
        if (hg_h5_has(s->h5, "triangles") && hg_h5_has(s->h5, "body_vertices")) status = open_posed_body(s);
    } else if ((status = hg_h5_open(&h5, path)) == HG_OK && hg_h5_has(h5, "VTKHDF")) {
        s->body_h5 = h5;
        status = open_moving_body(s, path);
    } else if (status == HG_OK) {
        hg_h5_close(h5);
        status = open_body(s, path);
    }
    hg_free(found);
    if (status != HG_OK || s->body_vertices < 1) return status;
    s->body = hg_alloc((size_t)s->body_vertices, 3 * sizeof *s->body);
    return s->body ? HG_OK : HG_MEMORY;
}

/* ---- frames -------------------------------------------------------------------------------------------------- */

hg_status hg_source_open(hg_source **source, hg_ctx *ctx, const char *path, const char *body)
{
    *source = NULL;
    hg_source *s = hg_alloc(1, sizeof *s);
    if (!s) return HG_MEMORY;
    s->ctx = ctx;
    s->path = hg_strdup(path);
    hg_status status = s->path ? hg_h5_open(&s->h5, path) : HG_MEMORY;
    if (status == HG_OK) status = hg_h5_has(s->h5, "VTKHDF") ? open_drape(s) : open_plain(s);
    if (status == HG_OK) status = make_room(s);
    if (status == HG_OK) status = find_body(s, body);
    if (status != HG_OK) {
        hg_source_close(s);
        return status;
    }
    *source = s;
    return HG_OK;
}

static hg_status read_frame(hg_h5 *h5, const char *name, bool flat, int64_t frame, int64_t rows, float *to)
{
    return flat ? hg_h5_read_rows(h5, name, HG_F32, frame * rows, rows, to)
                : hg_h5_read_rows(h5, name, HG_F32, frame, 1, to);
}

static hg_status read_roots(hg_source *s, int64_t frame)
{
    for (int64_t i = 0; i < s->strands; i++) {
        memcpy(s->rotation + 4 * i, (float[]){ 1, 0, 0, 0 }, 4 * sizeof(float));
        memcpy(s->position + 3 * i, s->x + 3 * i * s->vertices, 3 * sizeof(float));
    }
    if (s->rotations) HG_TRY(hg_h5_read_rows(s->h5, s->rotations, HG_F32, frame, 1, s->rotation));
    return s->positions ? hg_h5_read_rows(s->h5, s->positions, HG_F32, frame, 1, s->position) : HG_OK;
}

hg_status hg_source_read(hg_source *s, int64_t frame, source_version version)
{
    if (frame < 0 || frame >= s->frames)
        return hg_fail(HG_INVALID, "%s: frame %lld of %lld; the first is 0", s->path, (long long)frame,
                       (long long)s->frames);
    if (version != SOURCE_FILE && (!s->rest || (version == SOURCE_POSED && !s->rotations)))
        return hg_fail(HG_INVALID,
                       "%s: holds no rest groom and root frames beside its strands, so there is nothing to "
                       "compare with",
                       s->path);
    size_t bytes = (size_t)(3 * s->strands * s->vertices) * sizeof *s->x;
    if (s->points)
        HG_TRY(read_frame(s->h5, s->points, s->flat, frame, s->strands * s->vertices, s->x));
    else
        memcpy(s->x, s->rest, bytes);
    HG_TRY(read_roots(s, frame));
    if (version == SOURCE_POSED)
        hg_pose_strands(s->ctx, s->strands, s->vertices, s->rest, s->rotation, s->position, s->x);
    if (version == SOURCE_REST) {
        memcpy(s->x, s->rest, bytes);
        for (int64_t i = 0; i < s->strands; i++) {
            memcpy(s->rotation + 4 * i, (float[]){ 1, 0, 0, 0 }, 4 * sizeof(float));
            memcpy(s->position + 3 * i, s->x + 3 * i * s->vertices, 3 * sizeof(float));
        }
    }
    bool at_rest = version == SOURCE_REST || !s->body_points;
    s->body_shown = s->body && (!at_rest || s->body_rest);
    if (!s->body_shown) return HG_OK;
    if (at_rest) {
        memcpy(s->body, s->body_rest, (size_t)(3 * s->body_vertices) * sizeof *s->body);
        return HG_OK;
    }
    if (frame >= s->body_frames)
        return hg_fail(HG_INVALID, "%s: frame %lld, but the body has only %lld", s->path, (long long)frame,
                       (long long)s->body_frames);
    return read_frame(s->body_h5, s->body_points, s->body_flat, frame, s->body_vertices, s->body);
}

void hg_source_close(hg_source *s)
{
    if (!s) return;
    if (s->body_h5 != s->h5) hg_h5_close(s->body_h5);
    hg_h5_close(s->h5);
    hg_free(s->path);
    hg_free(s->x);
    hg_free(s->rest);
    hg_free(s->rotation);
    hg_free(s->position);
    hg_free(s->body);
    hg_free(s->body_rest);
    hg_free(s->triangles);
    hg_free(s);
}
