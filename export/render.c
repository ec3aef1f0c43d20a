/* The picture of a body and its hair: orthographic, supersampled, drawn tile by tile. */
#include "export/draw.h"
#include "export/raster.h"

#include <string.h>

/* ---- tiles --------------------------------------------------------------------------------------------------- */

raster_box raster_box_of(const raster_view *view, float x0, float y0, float x1, float y1)
{
    float tile = (float)view->tile;
    if (!(x1 >= 0.0f && y1 >= 0.0f && x0 < tile * (float)view->tiles_x && y0 < tile * (float)view->tiles_y))
        return (raster_box){ 1, 1, 0, 0 };
    return (raster_box){ (int16_t)clampf(x0 / tile, 0.0f, (float)(view->tiles_x - 1)),
                         (int16_t)clampf(y0 / tile, 0.0f, (float)(view->tiles_y - 1)),
                         (int16_t)clampf(x1 / tile, 0.0f, (float)(view->tiles_x - 1)),
                         (int16_t)clampf(y1 / tile, 0.0f, (float)(view->tiles_y - 1)) };
}

hg_status raster_bins_build(raster_bins *bins, const raster_view *view, int64_t n, const raster_box *box,
                            const int32_t *order)
{
    int tiles = view->tiles_x * view->tiles_y;
    *bins = (raster_bins){ .start = hg_alloc((size_t)tiles + 2, sizeof *bins->start) };
    if (!bins->start) return HG_MEMORY;
    int64_t *next = bins->start + 1; /* next[t] runs from the start of t to its end, which is the start of t + 1 */
    for (int64_t i = 0; i < n; i++)
        for (int y = box[i].y0; y <= box[i].y1; y++)
            for (int x = box[i].x0; x <= box[i].x1; x++) next[y * view->tiles_x + x + 1]++;
    for (int t = 0; t < tiles; t++) next[t + 1] += next[t];
    bins->item = hg_alloc((size_t)next[tiles] + 1, sizeof *bins->item);
    if (!bins->item) return HG_MEMORY;
    for (int64_t k = 0; k < n; k++) {
        int32_t i = order ? order[k] : (int32_t)k;
        for (int y = box[i].y0; y <= box[i].y1; y++)
            for (int x = box[i].x0; x <= box[i].x1; x++) bins->item[next[y * view->tiles_x + x]++] = i;
    }
    return HG_OK;
}

void raster_bins_free(raster_bins *bins)
{
    hg_free(bins->start);
    hg_free(bins->item);
    *bins = (raster_bins){ 0 };
}

/* ---- view ---------------------------------------------------------------------------------------------------- */

static vec vec_of_double(const double *p) { return (vec){ (float)p[0], (float)p[1], (float)p[2] }; }

static hg_status check_scene(const hg_view *scene)
{
    if (scene->strands < 0 || scene->vertices < 0 || scene->body_vertices < 0 || scene->body_faces < 0)
        return hg_fail(HG_INVALID, "render: negative number of strands, vertices or faces");
    if (scene->strands > 0 && scene->vertices > 0 && !scene->x)
        return hg_fail(HG_INVALID, "render: strands without positions");
    if (scene->body_faces > 0 && (!scene->body || !scene->triangles))
        return hg_fail(HG_INVALID, "render: a body without vertices or triangles");
    for (int64_t i = 0; i < 3 * scene->body_faces; i++)
        if (scene->triangles[i] < 0 || scene->triangles[i] >= scene->body_vertices)
            return hg_fail(HG_INVALID, "render: triangle %lld names vertex %d of %lld", (long long)(i / 3),
                           (int)scene->triangles[i], (long long)scene->body_vertices);
    return HG_OK;
}

static hg_status make_view(raster_view *view, const hg_camera *camera, int width, int height, int threads)
{
    vec eye = vec_of_double(camera->eye), target = vec_of_double(camera->target);
    vec forward = vec_unit(vec_sub(target, eye)), right = vec_unit(vec_cross(forward, vec_of_double(camera->up)));
    if (!(camera->height > 0.0) || !isfinite(camera->height) || !vec_finite(forward) || !vec_finite(right) ||
        vec_dot(right, right) < 0.5f)
        return hg_fail(HG_INVALID, "render: the camera needs a height above 0, a target away from its eye and an up "
                                   "direction that is not the direction it looks in");
    int samples = 3;
    *view = (raster_view){ .width = width, .height = height, .samples = samples, .threads = threads };
    view->tile = RASTER_TILE * samples;
    view->tiles_x = (width + RASTER_TILE - 1) / RASTER_TILE;
    view->tiles_y = (height + RASTER_TILE - 1) / RASTER_TILE;
    view->scale = (float)(height * samples) / (float)camera->height;
    view->eye = eye;
    view->target = target;
    view->forward = forward;
    view->right = right;
    view->up = vec_cross(right, forward);
    /* A portrait's light: a warm key from above left, a cool fill from the right, a rim from behind. */
    const vec direction[RASTER_LIGHTS] = { { -0.55f, 0.72f, 0.72f },
                                           { 0.85f, 0.10f, 0.55f },
                                           { 0.45f, 0.60f, -0.85f } };
    const vec colour[RASTER_LIGHTS] = { { 1.18f, 1.10f, 1.00f }, { 0.26f, 0.29f, 0.34f }, { 0.75f, 0.75f, 0.78f } };
    for (int k = 0; k < RASTER_LIGHTS; k++) {
        vec l = view->light[k] = vec_unit(direction[k]);
        view->light_world[k] =
            vec_add(vec_add(vec_scale(view->right, l.x), vec_scale(view->up, l.y)), vec_scale(view->forward, -l.z));
        view->light_colour[k] = colour[k];
    }
    return HG_OK;
}

/* ---- picture ------------------------------------------------------------------------------------------------- */

typedef struct {
    raster_view view;
    raster_volume volume;
    raster_shadow shadow;
    raster_body body;
    raster_strands strands;
} studio;

/* Bright values bend towards white instead of being cut off. */
static float tone(float value) { return value < 0.6f ? value : 0.6f + 0.4f * (1.0f - expf(-(value - 0.6f) / 0.4f)); }

/* Averages the samples of each pixel and lays them over what the picture shows already. */
static void resolve(const raster_view *view, hg_image *image, int x, int y, int tile_x, int tile_y, const float *colour)
{
    int samples = view->samples, tile = view->tile;
    float share = 1.0f / (float)(samples * samples);
    for (int row = 0; row < RASTER_TILE; row++)
        for (int column = 0; column < RASTER_TILE; column++) {
            int px = tile_x * RASTER_TILE + column, py = tile_y * RASTER_TILE + row;
            if (px >= view->width || py >= view->height) continue;
            px += x, py += y;
            if (px < 0 || py < 0 || px >= image->width || py >= image->height) continue;
            float sum[4] = { 0 };
            for (int j = 0; j < samples; j++)
                for (int i = 0; i < samples; i++) {
                    const float *c = colour + 4 * (size_t)((row * samples + j) * tile + column * samples + i);
                    /* stored colours are weighted by their alpha */
                    for (int k = 0; k < 3; k++)
                        if (c[3] > 0.0f) sum[k] += c[3] * tone(c[k] / c[3]);
                    sum[3] += c[3];
                }
            if (sum[3] <= 0.0f) continue;
            uint8_t *out = image->rgb + 3 * ((size_t)py * (size_t)image->width + (size_t)px);
            for (int k = 0; k < 3; k++)
                out[k] = hg_srgb_from_linear(share * sum[k] + (1.0f - share * sum[3]) * hg_linear_from_srgb(out[k]));
        }
}

static hg_status draw_tiles(const studio *stage, hg_image *image, int x, int y)
{
    const raster_view *view = &stage->view;
    size_t samples = (size_t)view->tile * (size_t)view->tile;
    int tiles = view->tiles_x * view->tiles_y, threads = view->threads;
    (void)threads;
    bool failed = false;
#pragma omp parallel num_threads(threads)
    {
        float *depth = hg_alloc(samples, sizeof *depth), *colour = hg_alloc(samples, 4 * sizeof *colour);
        int32_t *face = hg_alloc(samples, sizeof *face);
        bool ready = depth && colour && face;
#pragma omp for schedule(dynamic, 1)
        for (int t = 0; t < tiles; t++) {
            if (!ready) {
#pragma omp atomic write
                failed = true;
                continue;
            }
            int tile_x = t % view->tiles_x, tile_y = t / view->tiles_x;
            raster_body_draw(&stage->body, view, &stage->shadow, tile_x, tile_y, depth, face, colour);
            raster_strands_draw(&stage->strands, view, tile_x, tile_y, depth, colour);
            resolve(view, image, x, y, tile_x, tile_y, colour);
        }
        hg_free(depth);
        hg_free(colour);
        hg_free(face);
    }
    return failed ? hg_fail(HG_MEMORY, "render: no memory for the tiles of the picture") : HG_OK;
}

static void caption(hg_image *image, int x, int y, int width, int height, const char *text)
{
    static const uint8_t ink[3] = { 40, 42, 48 };
    int scale = 2;
    while (scale > 1 && hg_text_width(text, scale) > width - 16) scale--;
    hg_image_text(image, x + (width - hg_text_width(text, scale)) / 2, y + height - 7 * scale - 8, scale, ink, text);
}

hg_status hg_render(hg_ctx *ctx, hg_image *image, int x, int y, int width, int height, const hg_view *scene)
{
    if (width < 1 || height < 1 || width > 32768 || height > 32768)
        return hg_fail(HG_INVALID, "render: a view of %d x %d pixels", width, height);
    HG_TRY(check_scene(scene));
    studio stage = { 0 };
    int threads = ctx ? hg_ctx_threads(ctx) : 1;
    HG_TRY(make_view(&stage.view, &scene->camera, width, height, threads < 1 ? 1 : threads));
    const raster_view *view = &stage.view;
    float hair_width = scene->hair_width > 0.0 ? (float)scene->hair_width : 3e-4f;
    float wide = (float)scene->camera.height * fmaxf(1.0f, (float)width / (float)height);
    float per_strand = scene->hairs > 1 ? (float)scene->hairs : 1.0f;
    hg_status status = raster_volume_build(&stage.volume, scene, hair_width * per_strand);
    if (status == HG_OK) status = raster_shadow_build(&stage.shadow, view, scene, 1.4f * wide);
    if (status == HG_OK) status = raster_body_build(&stage.body, view, scene, &stage.volume);
    if (status == HG_OK)
        status = raster_strands_build(&stage.strands, view, scene, hair_width, &stage.volume, &stage.shadow);
    if (status == HG_OK) status = draw_tiles(&stage, image, x, y);
    raster_volume_free(&stage.volume);
    raster_shadow_free(&stage.shadow);
    raster_body_free(&stage.body);
    raster_strands_free(&stage.strands);
    if (status == HG_OK && scene->caption && scene->caption[0]) caption(image, x, y, width, height, scene->caption);
    return status;
}
