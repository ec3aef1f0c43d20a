/* The parts of the renderer: view, lights, shadow map, hair volume, tiles. Private to export/.
 *
 * A picture is cut into square tiles; a tile is drawn by one thread from first to last, and what it holds is listed in
 * an order that depends on the scene alone, so that the same scene gives the same bytes whatever the number of threads.
 * Three spaces: world [m]; screen (columns right, rows down in samples, depth along the view [m]); view (right, up,
 * towards the eye), in which everything is shaded, since directions there are the screen's own.
 */
#ifndef HG_EXPORT_RASTER_H
#define HG_EXPORT_RASTER_H

#include "export/export.h"

#include <math.h>

typedef struct {
    float x, y, z;
} vec;

static inline vec vec_of(const float *p) { return (vec){ p[0], p[1], p[2] }; }
static inline vec vec_add(vec a, vec b) { return (vec){ a.x + b.x, a.y + b.y, a.z + b.z }; }
static inline vec vec_sub(vec a, vec b) { return (vec){ a.x - b.x, a.y - b.y, a.z - b.z }; }
static inline vec vec_scale(vec a, float s) { return (vec){ s * a.x, s * a.y, s * a.z }; }
static inline vec vec_along(vec a, vec b, float s) { return vec_add(a, vec_scale(b, s)); }
static inline vec vec_mul(vec a, vec b) { return (vec){ a.x * b.x, a.y * b.y, a.z * b.z }; }
static inline vec vec_mix(vec a, vec b, float t) { return vec_along(vec_scale(a, 1.0f - t), b, t); }
static inline float vec_dot(vec a, vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline vec vec_cross(vec a, vec b)
{
    return (vec){ a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x };
}
static inline vec vec_unit(vec a) /* of zero: zero */
{
    float length = sqrtf(vec_dot(a, a));
    return length > 0.0f ? vec_scale(a, 1.0f / length) : (vec){ 0 };
}
static inline bool vec_finite(vec a) { return isfinite(a.x) && isfinite(a.y) && isfinite(a.z); }
static inline float clampf(float value, float low, float high)
{
    return value < low ? low : value > high ? high : value;
}

#define RASTER_TILE   32 /* side of a tile in pixels of the picture */
#define RASTER_LIGHTS 3  /* key, fill, rim */

typedef struct {
    int width, height, samples; /* pixels, samples along a pixel's side */
    int tiles_x, tiles_y, tile; /* tile: side in samples */
    float scale;                /* samples per metre */
    vec right, up, forward, eye, target;
    vec light[RASTER_LIGHTS], light_world[RASTER_LIGHTS]; /* unit, towards the light; light[] in view space */
    vec light_colour[RASTER_LIGHTS];
    int threads;
} raster_view;

static inline vec raster_project(const raster_view *view, vec p)
{
    vec d = vec_sub(p, view->target);
    return (vec){ vec_dot(d, view->right) * view->scale + 0.5f * (float)(view->width * view->samples),
                  0.5f * (float)(view->height * view->samples) - vec_dot(d, view->up) * view->scale,
                  vec_dot(vec_sub(p, view->eye), view->forward) };
}
static inline vec raster_unproject(const raster_view *view, float x, float y, float depth)
{
    float r = (x - 0.5f * (float)(view->width * view->samples)) / view->scale;
    float u = (0.5f * (float)(view->height * view->samples) - y) / view->scale;
    float f = depth - vec_dot(vec_sub(view->target, view->eye), view->forward);
    return vec_along(vec_along(vec_along(view->target, view->right, r), view->up, u), view->forward, f);
}

/* ---- tiles: which items touch which tile, in the items' order ------------------------------------------------ */

typedef struct {
    int16_t x0, y0, x1, y1;
} raster_box; /* tiles, inclusive; x1 < x0: nowhere */
typedef struct {
    int64_t *start;
    int32_t *item;
} raster_bins;

raster_box raster_box_of(const raster_view *view, float x0, float y0, float x1, float y1);
/* order NULL: 0, 1, 2, ... */
hg_status raster_bins_build(raster_bins *bins, const raster_view *view, int64_t n, const raster_box *box,
                            const int32_t *order);
void raster_bins_free(raster_bins *bins);

/* ---- light --------------------------------------------------------------------------------------------------- */

/* Depth of the body as the key light sees it. */
typedef struct {
    int size;
    float *depth;
    vec right, up, towards, centre;
    float scale;
} raster_shadow;
hg_status raster_shadow_build(raster_shadow *shadow, const raster_view *view, const hg_view *scene, float extent);
void raster_shadow_free(raster_shadow *shadow);
float raster_shadow_lit(const raster_shadow *shadow, vec point, float bias); /* 0 in shadow .. 1 lit, soft */

/* Hair as a volume: shadowing area per cube metre, in a grid of cubes. */
typedef struct {
    float *density;
    int n[3];
    float cell;
    vec low;
} raster_volume;
hg_status raster_volume_build(raster_volume *volume, const hg_view *scene, float width);
void raster_volume_free(raster_volume *volume);
/* How much light comes through the hair to a point, from afar in a direction: exp(-optical depth), skipping `skip` m. */
float raster_volume_through(const raster_volume *volume, vec from, vec towards, float skip, float reach);
float raster_volume_open(const raster_volume *volume, const raster_view *view, vec from,
                         float skip); /* the same for the light of all around */

/* ---- body ---------------------------------------------------------------------------------------------------- */

typedef struct {
    const hg_view *scene;
    vec *screen, *normal; /* [N]; normals in view space */
    float *lit;           /* [N,2] through the hair: of the key light, of all around */
    raster_bins bins;
} raster_body;
hg_status raster_body_build(raster_body *body, const raster_view *view, const hg_view *scene,
                            const raster_volume *volume);
void raster_body_free(raster_body *body);
/* Fills depth (INFINITY where there is none) and colour (r, g, b, alpha) of one tile. */
void raster_body_draw(const raster_body *body, const raster_view *view, const raster_shadow *shadow, int tile_x,
                      int tile_y, float *depth, int32_t *face, float *colour);

/* ---- strands ------------------------------------------------------------------------------------------------- */

typedef struct {
    float x0, y0, z0, x1, y1, z1, r0, g0, b0, r1, g1, b1, half, alpha;
} raster_segment;
typedef struct {
    int64_t n;
    raster_segment *segment;
    raster_bins bins;
} raster_strands;
hg_status raster_strands_build(raster_strands *strands, const raster_view *view, const hg_view *scene, float width,
                               const raster_volume *volume, const raster_shadow *shadow);
void raster_strands_free(raster_strands *strands);
void raster_strands_draw(const raster_strands *strands, const raster_view *view, int tile_x, int tile_y,
                         const float *depth, float *colour);

#endif
