/* fit_drape: a drape's file read back, and what its hair is made of. */
#include "export/source.h"

#include <math.h>
#include <string.h>

enum { MOST_FRAMES = 64, TIMES = 3 };

/* Frames of a file, each with the two before it. */
typedef struct {
    int32_t *strand;
    float *x[MOST_FRAMES][TIMES], *body[MOST_FRAMES], *rotation[MOST_FRAMES], *position[MOST_FRAMES];
    hg_observed_frame frame[MOST_FRAMES];
    int n;
} frames;

static void frames_free(frames *f)
{
    for (int i = 0; i < MOST_FRAMES; i++) {
        for (int t = 0; t < TIMES; t++) hg_free(f->x[i][t]);
        hg_free(f->body[i]);
        hg_free(f->rotation[i]);
        hg_free(f->position[i]);
    }
    hg_free(f->strand);
}

static float *copy(const float *from, int64_t count)
{
    float *to = hg_alloc((size_t)(count > 0 ? count : 1), sizeof *to);
    if (to && count > 0) memcpy(to, from, (size_t)count * sizeof *to);
    return to;
}

/* The strands have to be those of the groom, at rest. */
static hg_status check_strands(hg_source *s, const hg_groom *groom, frames *f)
{
    if (!hg_h5_has(s->h5, "hairgrad/strand") || !s->rest || !s->rotations)
        return hg_fail(HG_FORMAT,
                       "%s: a drape as `hairgrad drape` writes it is needed: with its rest strands, their numbers and "
                       "root frames",
                       s->path);
    if (s->vertices != groom->vertices)
        return hg_fail(HG_INVALID, "%s: strands of %lld vertices, the groom's have %lld", s->path,
                       (long long)s->vertices, (long long)groom->vertices);
    HG_TRY(hg_h5_read(s->h5, "hairgrad/strand", HG_I32, 1, &s->strands, NULL, (void **)&f->strand));
    for (int64_t i = 0; i < s->strands; i++) {
        const int32_t number = f->strand[i];
        if (number < 0 || number >= groom->strands)
            return hg_fail(HG_INVALID, "%s: strand %d of a groom of %lld", s->path, (int)number,
                           (long long)groom->strands);
        for (int64_t k = 0; k < 3 * s->vertices; k++)
            if (!(fabs((double)(s->rest[i * 3 * s->vertices + k] - groom->points[number * 3 * groom->vertices + k])) <
                  1e-6))
                return hg_fail(HG_INVALID,
                               "%s: strand %d is another at rest than in the groom of the recipe; is it a drape of "
                               "another groom?",
                               s->path, (int)number);
    }
    return HG_OK;
}

static hg_status read_frames(hg_source *s, const hg_body *body, int wanted, frames *f)
{
    const int64_t count = s->strands * s->vertices * 3;
    f->n = (int)(wanted < s->frames ? wanted : s->frames);
    for (int i = 0; i < f->n; i++) {
        const int64_t at = f->n > 1 ? (s->frames - 1) * i / (f->n - 1) : s->frames - 1;
        for (int t = TIMES - 1; t >= 0; t--) { /* the frame itself last: its body and roots stay */
            const int64_t from = at - t < 0 ? 0 : at - t;
            HG_TRY(hg_source_read(s, from, SOURCE_FILE));
            f->x[i][t] = copy(s->x, count);
            if (!f->x[i][t]) return HG_MEMORY;
        }
        f->rotation[i] = copy(s->rotation, s->strands * 4);
        f->position[i] = copy(s->position, s->strands * 3);
        if (!f->rotation[i] || !f->position[i]) return HG_MEMORY;
        if (s->body_shown) {
            if (s->body_vertices != body->vertices)
                return hg_fail(HG_INVALID, "%s: its body has %lld vertices, that of the recipe %lld", s->path,
                               (long long)s->body_vertices, (long long)body->vertices);
            f->body[i] = copy(s->body, s->body_vertices * 3);
            if (!f->body[i]) return HG_MEMORY;
        }
        f->frame[i] = (hg_observed_frame){ .x = f->x[i][0],
                                           .before = f->x[i][1],
                                           .older = f->x[i][2],
                                           .body_vertices = f->body[i],
                                           .root_rotation = f->rotation[i],
                                           .root_position = f->position[i] };
    }
    return HG_OK;
}

hg_status hg_drape_fit_material(hg_hair_task *task, hg_ctx *ctx, const char *path, const hg_drape_fit_options *options,
                                hg_material_fit *fit)
{
    *fit = (hg_material_fit){ 0 };
    const int wanted = options->n_frames > 0 ? options->n_frames : 8;
    if (wanted > MOST_FRAMES) return hg_fail(HG_INVALID, "fit: %d frames; at most %d at once", wanted, MOST_FRAMES);
    hg_source *source;
    HG_TRY(hg_source_open(&source, ctx, path, options->body));
    frames *f = hg_alloc(1, sizeof *f);
    hg_status status = f ? check_strands(source, hg_hair_groom(task), f) : HG_MEMORY;
    if (status == HG_OK) status = read_frames(source, hg_hair_body(task), wanted, f);
    if (status == HG_OK)
        status = hg_hair_fit_material(task, ctx, f->strand, source->strands, f->n, f->frame, &options->material, fit);
    if (f) frames_free(f);
    hg_free(f);
    hg_source_close(source);
    return status;
}
