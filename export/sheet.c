/* Contact sheets: frames of a drape, a posed scene or a groom in a grid, the camera going with the head. */
#include "export/draw.h"
#include "export/source.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define MOST_FRAMES 64
#define GAP         6 /* pixels between pictures */

static const uint8_t backdrop[3] = { 233, 233, 231 }, gap_colour[3] = { 255, 255, 255 };

/* ---- camera -------------------------------------------------------------------------------------------------- */

/* Where the head is and where it looks: the mean of the roots, and their rotations' mean of the rest head's +Z, level. */
typedef struct {
    double centre[3], forward[3], right[3];
} head_frame;

static head_frame head_of(const hg_source *s)
{
    head_frame head = { 0 };
    double n = 0.0, x = 0.0, z = 0.0;
    for (int64_t i = 0; i < s->strands; i++) {
        const float *p = s->position + 3 * i, *q = s->rotation + 4 * i;
        if (!isfinite(p[0]) || !isfinite(p[1]) || !isfinite(p[2])) continue;
        for (int k = 0; k < 3; k++) head.centre[k] += (double)p[k];
        n += 1.0;
        double turned_x = 2.0 * ((double)q[1] * (double)q[3] + (double)q[0] * (double)q[2]);
        double turned_z = 1.0 - 2.0 * ((double)q[1] * (double)q[1] + (double)q[2] * (double)q[2]);
        if (!isfinite(turned_x) || !isfinite(turned_z)) continue;
        x += turned_x, z += turned_z;
    }
    for (int k = 0; k < 3; k++) head.centre[k] = n > 0.0 ? head.centre[k] / n : 0.0;
    double length = hypot(x, z);
    head.forward[0] = length > 1e-9 ? x / length : 0.0;
    head.forward[2] = length > 1e-9 ? z / length : 1.0;
    head.right[0] = -head.forward[2]; /* the picture's right when the face is seen from the front is the left ear */
    head.right[2] = head.forward[0];
    return head;
}

/* How far hair reaches from the head's centre: up, down and to any side. */
typedef struct {
    double up, down, side;
} extent;

static void widen(extent *e, const hg_source *s)
{
    head_frame head = head_of(s);
    for (int64_t i = 0; i < s->strands * s->vertices; i++) {
        const float *p = s->x + 3 * i;
        if (!isfinite(p[0]) || !isfinite(p[1]) || !isfinite(p[2])) continue;
        double up = (double)p[1] - head.centre[1];
        e->up = fmax(e->up, up);
        e->down = fmax(e->down, -up);
        e->side = fmax(e->side, hypot((double)p[0] - head.centre[0], (double)p[2] - head.centre[2]));
    }
}

static hg_status angle_of(const char *view, double *angle)
{
    static const struct {
        const char *name;
        double degrees;
    } known[] = { { "front", 0.0 }, { "three_quarter", 38.0 }, { "side", 90.0 }, { "back", 180.0 } };
    if (!view) view = "three_quarter";
    for (size_t i = 0; i < sizeof known / sizeof *known; i++)
        if (strcmp(known[i].name, view) == 0) {
            *angle = known[i].degrees * 3.14159265358979 / 180.0;
            return HG_OK;
        }
    return hg_fail(HG_INVALID, "view '%s' is none of front, three_quarter, side, back", view);
}

static hg_camera camera_for(const hg_source *s, const extent *e, double angle, double aspect)
{
    head_frame head = head_of(s);
    /* Room for the face and the shoulders below a short groom, and for hair that swings out. */
    double up = 1.10 * e->up + 0.03, down = fmax(1.06 * e->down + 0.03, 0.27);
    double height = fmax(up + down, 2.1 * e->side / aspect);
    hg_camera camera = { .up = { 0, 1, 0 }, .height = height };
    for (int k = 0; k < 3; k++) {
        double towards = cos(angle) * head.forward[k] - sin(angle) * head.right[k];
        camera.target[k] = head.centre[k] + (k == 1 ? 0.5 * (up - down) : 0.0);
        camera.eye[k] = camera.target[k] + 5.0 * towards;
    }
    return camera;
}

/* ---- one picture --------------------------------------------------------------------------------------------- */

typedef struct {
    hg_ctx *ctx;
    hg_source *source;
    hg_image *sheet;
    extent room;
    double angle, hair_width, lock_radius;
    int hairs, width, height;
} studio;

static hg_status draw_one(const studio *u, int column, int row, int64_t frame, source_version version, const char *name)
{
    hg_source *s = u->source;
    HG_TRY(hg_source_read(s, frame, version));
    char caption[96];
    if (s->frames == 1 || version == SOURCE_REST)
        snprintf(caption, sizeof caption, "%s", name);
    else
        snprintf(caption, sizeof caption, "%s%s%.2f s", name, name[0] ? ", " : "", (double)frame / s->rate);
    int x = column * (u->width + GAP), y = row * (u->height + GAP);
    hg_draw_rectangle(u->sheet, x, y, u->width, u->height, backdrop, 1.0f);
    const hg_view view = {
        .camera = camera_for(s, &u->room, u->angle, (double)u->width / u->height),
        .body_vertices = s->body_shown ? s->body_vertices : 0,
        .body_faces = s->body_shown ? s->body_faces : 0,
        .body = s->body,
        .triangles = s->triangles,
        .strands = s->strands,
        .vertices = s->vertices,
        .x = s->x,
        .hair_width = u->hair_width,
        .hairs = u->hairs,
        .lock_radius = u->lock_radius,
        .caption = caption,
    };
    return hg_render(u->ctx, u->sheet, x, y, u->width, u->height, &view);
}

/* A head needs about this many hairs at this width to be covered; few strands stand for locks of some. */
static void fill(studio *u, const hg_sheet_options *options)
{
    double strands = (double)u->source->strands;
    u->hairs = options->hairs > 0 ? options->hairs : (int)fmin(fmax(round(12000.0 / strands), 1.0), 10.0);
    u->lock_radius = 0.13 / sqrt(strands); /* half of the way to the next root on 0.06 m^2 of scalp, about */
    u->hair_width = options->hair_width;
    if (!(u->hair_width > 0.0)) u->hair_width = fmin(fmax(2.6e-4 * sqrt(11400.0 / (strands * u->hairs)), 1e-4), 9e-4);
}

/* ---- sheet --------------------------------------------------------------------------------------------------- */

/* Spread over the clip without its very first frames, where nothing has moved yet. */
static int spread(int64_t frames, int count, int64_t *frame)
{
    if (count > frames) count = (int)frames;
    for (int i = 0; i < count; i++) frame[i] = (2 * i + 1) * frames / (2 * count);
    return count;
}

static hg_status draw_sheet(studio *u, const hg_sheet_options *options, int n, const int64_t *frame,
                            const hg_progress *progress)
{
    hg_source *s = u->source;
    for (int i = 0; i < n; i++) {
        HG_TRY(hg_source_read(s, frame[i], SOURCE_FILE));
        widen(&u->room, s);
        if (!options->compare) continue;
        HG_TRY(hg_source_read(s, frame[i], SOURCE_POSED));
        widen(&u->room, s);
    }
    if (options->compare) {
        HG_TRY(hg_source_read(s, 0, SOURCE_REST));
        widen(&u->room, s);
    }
    int columns = options->compare ? 3 : n < 4 ? n : n == 4 ? 2 : 3;
    int rows = options->compare ? n : (n + columns - 1) / columns;
    HG_TRY(hg_image_create(&u->sheet, columns * (u->width + GAP) - GAP, rows * (u->height + GAP) - GAP, gap_colour));
    for (int i = 0; i < n; i++) {
        hg_progress_report(progress, (double)i / n, "picture %d of %d", i + 1, n);
        if (options->compare) {
            HG_TRY(draw_one(u, 0, i, frame[i], SOURCE_REST, "rest"));
            HG_TRY(draw_one(u, 1, i, frame[i], SOURCE_POSED, "rigidly posed"));
            HG_TRY(draw_one(u, 2, i, frame[i], SOURCE_FILE, "trained"));
        } else {
            HG_TRY(draw_one(u, i % columns, i / columns, frame[i], SOURCE_FILE, ""));
        }
    }
    return HG_OK;
}

hg_status hg_sheet_draw(hg_ctx *ctx, hg_image **sheet, const char *path, const hg_sheet_options *options,
                        const hg_progress *progress)
{
    *sheet = NULL;
    if (options->n_frames > MOST_FRAMES)
        return hg_fail(HG_INVALID, "a sheet has room for %d frames, not %d", MOST_FRAMES, options->n_frames);
    studio u = { .ctx = ctx, .width = options->width, .height = options->height };
    if (u.width <= 0) u.width = 480;
    if (u.height <= 0) u.height = 560;
    HG_TRY(angle_of(options->view, &u.angle));
    HG_TRY(hg_source_open(&u.source, ctx, path, options->body));
    fill(&u, options);
    int64_t chosen[6];
    const int64_t *frame = options->frames;
    int n = options->n_frames;
    if (n <= 0) {
        n = spread(u.source->frames, options->compare ? 3 : 6, chosen);
        frame = chosen;
    }
    hg_status status = draw_sheet(&u, options, n, frame, progress);
    hg_source_close(u.source);
    if (status == HG_OK)
        *sheet = u.sheet;
    else
        hg_image_destroy(u.sheet);
    return status;
}
