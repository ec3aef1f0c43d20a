/* A picture of what `hairgrad check` found: the strands, each in the colour of its worst problem, from the front, the side
 * and the back. */
#include "export/export.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { VERTICES = 24, VIEWS = 3, LEGEND = 22 };

static const struct {
    const char *name;
    float linear[3];
    uint8_t rgb[3];
} kinds[] = {
    { "fine", { 0.16f, 0.13f, 0.11f }, { 110, 100, 95 } },
    { "left out", { 0, 0, 0 }, { 0, 0, 0 } },
    { "duplicate", { 0.05f, 0.2f, 0.9f }, { 60, 120, 240 } },
    { "zero-length edges", { 0.9f, 0.7f, 0.05f }, { 240, 210, 60 } },
    { "root off the scalp", { 0.9f, 0.25f, 0.02f }, { 240, 130, 30 } },
    { "inside the body", { 0.85f, 0.03f, 0.03f }, { 230, 40, 40 } },
};

/* The strands that can be drawn, with equal numbers of vertices, and their colours. */
static hg_status drawable(hg_groom **groom, float **colour, const hg_curves *curves, const uint8_t *problem)
{
    hg_groom_report report;
    HG_TRY(hg_groom_from_curves(groom, curves, VERTICES, &report));
    *colour = hg_alloc((size_t)report.kept, 3 * sizeof **colour);
    if (!*colour) return HG_MEMORY;
    int64_t kept = 0;
    for (int64_t s = 0; s < curves->strands; s++) {
        if (problem[s] == HG_STRAND_DROPPED) continue;
        int kind = problem[s] <= HG_STRAND_INSIDE ? problem[s] : HG_STRAND_FINE;
        if (kept < report.kept) memcpy(*colour + 3 * kept++, kinds[kind].linear, 3 * sizeof **colour);
    }
    return HG_OK;
}

static void frame(const hg_groom *groom, double centre[3], double *size)
{
    double low[3] = { INFINITY, INFINITY, INFINITY }, high[3] = { -INFINITY, -INFINITY, -INFINITY };
    for (int64_t i = 0; i < 3 * groom->strands * groom->vertices; i++) {
        low[i % 3] = fmin(low[i % 3], (double)groom->points[i]);
        high[i % 3] = fmax(high[i % 3], (double)groom->points[i]);
    }
    *size = 0;
    for (int k = 0; k < 3; k++) {
        centre[k] = 0.5 * (low[k] + high[k]);
        *size = fmax(*size, 1.15 * (high[k] - low[k]));
    }
    if (!(*size > 0)) *size = 1;
}

static hg_status draw(hg_ctx *ctx, hg_image *image, const hg_groom *groom, const float *colour, const hg_body *body,
                      int width, int height)
{
    static const double towards[VIEWS][3] = { { 0, 0, 1 }, { 1, 0, 0 }, { 0, 0, -1 } };
    double centre[3], size;
    frame(groom, centre, &size);
    for (int v = 0; v < VIEWS; v++) {
        hg_view view = { .strands = groom->strands,
                         .vertices = groom->vertices,
                         .x = groom->points,
                         .colour = colour,
                         .hair_width = size / 400,
                         .hairs = 1 };
        view.camera.height = size * (height > width ? (double)height / width : 1);
        view.camera.up[1] = 1;
        for (int k = 0; k < 3; k++) {
            view.camera.target[k] = centre[k];
            view.camera.eye[k] = centre[k] + 4 * size * towards[v][k];
        }
        if (body) {
            view.body = body->points;
            view.triangles = body->triangles;
            view.body_vertices = body->vertices;
            view.body_faces = body->faces;
        }
        HG_TRY(hg_render(ctx, image, v * width, 0, width, height, &view));
    }
    return HG_OK;
}

static void legend(hg_image *image, const hg_curves *curves, const uint8_t *problem, int y)
{
    int x = 8;
    for (int kind = 0; kind <= HG_STRAND_INSIDE; kind++) {
        char text[64];
        int64_t count = 0;
        for (int64_t s = 0; s < curves->strands; s++) count += problem[s] == kind;
        if (!count) continue;
        snprintf(text, sizeof text, "%s %lld", kinds[kind].name, (long long)count);
        hg_image_text(image, x, y, 1, kinds[kind].rgb, text);
        x += 8 * (int)strlen(text) + 16;
    }
}

hg_status hg_problems_draw(hg_ctx *ctx, hg_image **image, const hg_curves *curves, const uint8_t *problem,
                           const hg_body *body, int width, int height)
{
    static const uint8_t white[3] = { 255, 255, 255 };
    hg_groom *groom = NULL;
    float *colour = NULL;
    *image = NULL;
    hg_status status = drawable(&groom, &colour, curves, problem);
    if (status == HG_OK) status = hg_image_create(image, VIEWS * width, height + LEGEND, white);
    if (status == HG_OK) status = draw(ctx, *image, groom, colour, body, width, height);
    if (status == HG_OK) legend(*image, curves, problem, height + 6);
    hg_groom_destroy(groom);
    hg_free(colour);
    if (status != HG_OK && *image) {
        hg_image_destroy(*image);
        *image = NULL;
    }
    return status;
}
