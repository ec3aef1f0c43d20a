/* Strands: smooth curves cut into short segments, shaded, sorted from far to near and blended as anti-aliased lines.
 *
 * Shading: the diffuse term of Kajiya and Kay 1989 (the sine of the angle between strand and light), two highlights
 * along the strand, one white and moved towards the root, one in the hair's colour and moved towards the tip, and light
 * that passes through from behind; longitudinal and azimuthal shapes after Marschner et al. 2003 as simplified for
 * real time by Karis 2016. What reaches a vertex comes from the hair volume and the body's shadow map.
 */
#include "export/raster.h"

#include <string.h>

#define PIECE       5.0f /* samples a piece of a curve is long, about */
#define MOST_PIECES 24
#define IN_FRONT    0.0008f /* hair that lies on the skin is drawn over it [m] */

typedef struct {
    float key, fill, rim, open;
} reached;

typedef struct {
    vec colour;           /* linear, of the strand's middle */
    float tilt, strength; /* small differences between strands: direction and brightness of the highlights */
} fibre;

static float noise(int64_t strand, uint32_t what)
{
    uint32_t h = (uint32_t)strand * 2654435761u ^ what * 2246822519u;
    h ^= h >> 15;
    h *= 2246822519u;
    h ^= h >> 13;
    h *= 3266489917u;
    h ^= h >> 16;
    return (float)(h >> 8) * (1.0f / 16777216.0f);
}

/* `hair` numbers all hairs: those of a strand's lock share its colour but for a little. */
static fibre fibre_of(const hg_view *scene, int64_t strand, int64_t hair)
{
    const vec dark = { 0.055f, 0.022f, 0.010f }, light = { 0.235f, 0.105f, 0.043f };
    fibre f;
    float a = 0.7f * noise(strand, 1) + 0.3f * noise(hair, 5), b = noise(strand, 2);
    if (scene->colour) {
        f.colour = vec_scale(vec_of(scene->colour + 3 * strand), 0.82f + 0.36f * a);
    } else {
        f.colour = vec_mix(dark, light, 0.25f + 0.65f * a * a);
        f.colour.x *= 0.92f + 0.16f * b;
    }
    f.tilt = 0.10f * (noise(hair, 3) - 0.5f);
    f.strength = 0.55f + 0.9f * noise(hair, 4);
    return f;
}

static float bell(float x, float width)
{
    float t = x / width;
    return expf(-0.5f * t * t);
}

/* `tangent` in view space, from root to tip; the eye is at +z. */
static vec shade(const raster_view *view, const fibre *f, vec tangent, const reached *light, float along)
{
    const vec sky = { 0.42f, 0.45f, 0.50f }, ground = { 0.20f, 0.17f, 0.15f };
    float root_to_tip = 0.78f + 0.38f * along;
    vec base = vec_scale(f->colour, root_to_tip);
    float sine_out = clampf(tangent.z, -1.0f, 1.0f), cosine_out = sqrtf(fmaxf(1e-4f, 1.0f - sine_out * sine_out));
    float theta_out = asinf(sine_out);
    vec sum =
        vec_scale(vec_mul(base, vec_mix(ground, sky, 0.5f + 0.5f * sqrtf(fmaxf(0.0f, 1.0f - tangent.y * tangent.y)))),
                  0.85f * light->open);
    const float lit[RASTER_LIGHTS] = { light->key, light->fill, light->rim };
    vec tinted = { powf(base.x, 0.6f), powf(base.y, 0.6f), powf(base.z, 0.6f) };
    for (int k = 0; k < RASTER_LIGHTS; k++) {
        if (lit[k] < 0.003f) continue;
        vec towards = view->light[k];
        float sine_in = clampf(vec_dot(tangent, towards), -1.0f, 1.0f);
        float cosine_in = sqrtf(fmaxf(1e-4f, 1.0f - sine_in * sine_in));
        float theta = 0.5f * (asinf(sine_in) + theta_out) + f->tilt;
        float cosine_phi = clampf((towards.z - sine_in * sine_out) / (cosine_in * cosine_out), -1.0f, 1.0f);
        float half_phi = sqrtf(0.5f + 0.5f * cosine_phi);
        float gloss = k == 1 ? 0.35f : 1.0f; /* the fill light is large and soft: hardly a highlight */
        float white = 0.15f * gloss * f->strength * half_phi * bell(theta + 0.14f, 0.10f);
        float coloured = 0.75f * gloss * f->strength * half_phi * half_phi * bell(theta - 0.10f, 0.17f);
        float through = 0.55f * expf(-3.65f * cosine_phi - 3.98f) * bell(theta, 0.28f);
        float diffuse = 0.62f * (0.60f + 0.40f * cosine_phi);
        vec answer = vec_scale(base, diffuse);
        answer = vec_along(answer, tinted, 0.5f * coloured + through);
        answer = vec_add(answer, (vec){ white, white, white });
        sum = vec_add(sum, vec_scale(vec_mul(answer, view->light_colour[k]), cosine_in * lit[k]));
    }
    return sum;
}

/* ---- curves into segments ------------------------------------------------------------------------------------ */

typedef struct {
    const raster_view *view;
    const hg_view *scene;
    const raster_volume *volume;
    const raster_shadow *shadow;
    float half, alpha; /* of a line, in samples */
    int64_t hairs;     /* drawn for a strand: itself and others around it */
    float radius;      /* of the lock that they make [m] */
    reached *light;    /* [S,V] what reaches the strands' vertices, and so the hairs around them */
} painter;

/* A strand's first hair is the strand; the others wind slowly around it, closer at the tip. */
typedef struct {
    const float *x;
    bool beside;
    vec side, front;
    float turn, step;
} lock_hair;

static lock_hair hair_of(const painter *p, int64_t hair)
{
    int64_t strand = hair / p->hairs, n = p->scene->vertices;
    lock_hair h = { .x = p->scene->x + 3 * strand * n, .beside = hair % p->hairs != 0 };
    if (!h.beside) return h;
    vec axis = vec_unit((vec){ noise(hair, 6) - 0.5f, 0.7f * (noise(hair, 7) - 0.5f), noise(hair, 8) - 0.5f });
    vec side = vec_unit(vec_cross(axis, (vec){ 0.31f, 0.91f, 0.27f }));
    float away = p->radius * sqrtf(noise(hair, 9));
    h.side = vec_scale(side, away);
    h.front = vec_scale(vec_cross(axis, side), away);
    h.turn = 6.2832f * noise(hair, 10);
    h.step = n > 1 ? 4.0f * (noise(hair, 11) - 0.5f) / (float)(n - 1) : 0.0f;
    return h;
}

static vec hair_point(const painter *p, const lock_hair *h, int64_t vertex)
{
    vec point = vec_of(h->x + 3 * vertex);
    if (!h->beside) return point;
    float closer = 1.0f - 0.55f * (float)vertex / (float)(p->scene->vertices - 1);
    float angle = h->turn + h->step * (float)vertex;
    return vec_along(vec_along(point, h->side, closer * cosf(angle)), h->front, closer * sinf(angle));
}

static reached reached_at(const painter *p, vec point)
{
    const raster_view *view = p->view;
    float skip = p->volume->cell * 1.2f;
    reached r;
    r.key = raster_volume_through(p->volume, point, view->light_world[0], skip, 0.30f);
    if (r.key > 0.01f) r.key *= raster_shadow_lit(p->shadow, point, 0.008f);
    r.fill = raster_volume_through(p->volume, point, view->light_world[1], skip, 0.16f);
    r.rim = raster_volume_through(p->volume, point, view->light_world[2], skip, 0.30f);
    r.open = raster_volume_open(p->volume, view, point, skip);
    return r;
}

static int pieces_of(const raster_view *view, vec a, vec b)
{
    if (!vec_finite(a) || !vec_finite(b) || a.z <= 0.0f || b.z <= 0.0f) return 0;
    float width = (float)(view->width * view->samples), height = (float)(view->height * view->samples);
    float margin = 4.0f * (float)view->samples;
    if (fmaxf(a.x, b.x) < -margin || fminf(a.x, b.x) > width + margin || fmaxf(a.y, b.y) < -margin ||
        fminf(a.y, b.y) > height + margin)
        return 0;
    float dx = b.x - a.x, dy = b.y - a.y, dz = (b.z - a.z) * view->scale;
    float length = sqrtf(dx * dx + dy * dy + dz * dz);
    if (!(length > 0.0f)) return 0;
    return (int)clampf(ceilf(sqrtf(dx * dx + dy * dy) / PIECE), 1.0f, MOST_PIECES);
}

static vec curve(vec a, vec b, vec c, vec d, float t)
{
    float t2 = t * t, t3 = t2 * t;
    vec sum = vec_scale(a, -0.5f * t3 + t2 - 0.5f * t);
    sum = vec_along(sum, b, 1.5f * t3 - 2.5f * t2 + 1.0f);
    sum = vec_along(sum, c, -1.5f * t3 + 2.0f * t2 + 0.5f * t);
    return vec_along(sum, d, 0.5f * t3 - 0.5f * t2);
}

static int64_t count_hair(const painter *p, int64_t hair)
{
    int64_t n = p->scene->vertices, count = 0;
    lock_hair h = hair_of(p, hair);
    vec last = raster_project(p->view, hair_point(p, &h, 0));
    for (int64_t v = 1; v < n; v++) {
        vec next = raster_project(p->view, hair_point(p, &h, v));
        count += pieces_of(p->view, last, next);
        last = next;
    }
    return count;
}

static void paint_hair(const painter *p, int64_t hair, raster_segment *out)
{
    const raster_view *view = p->view;
    int64_t n = p->scene->vertices;
    lock_hair h = hair_of(p, hair);
    fibre f = fibre_of(p->scene, hair / p->hairs, hair);
    const reached *light = p->light + hair / p->hairs * n;
    for (int64_t v = 0; v + 1 < n; v++) {
        vec b = raster_project(view, hair_point(p, &h, v)), c = raster_project(view, hair_point(p, &h, v + 1));
        int pieces = pieces_of(view, b, c);
        if (!pieces) continue;
        vec a = v > 0 ? raster_project(view, hair_point(p, &h, v - 1)) : vec_sub(vec_scale(b, 2.0f), c);
        vec d = v + 2 < n ? raster_project(view, hair_point(p, &h, v + 2)) : vec_sub(vec_scale(c, 2.0f), b);
        if (!vec_finite(a)) a = b;
        if (!vec_finite(d)) d = c;
        vec from = b, colour_from = { 0 };
        for (int k = 0; k <= pieces; k++) {
            float t = (float)k / (float)pieces, along = ((float)v + t) / (float)(n - 1);
            float t_before = clampf(t - 0.25f, 0.0f, 1.0f), t_after = clampf(t + 0.25f, 0.0f, 1.0f);
            vec slope = vec_sub(curve(a, b, c, d, t_after), curve(a, b, c, d, t_before));
            vec tangent = vec_unit((vec){ slope.x, -slope.y, -slope.z * view->scale });
            reached r = { light[v].key + t * (light[v + 1].key - light[v].key),
                          light[v].fill + t * (light[v + 1].fill - light[v].fill),
                          light[v].rim + t * (light[v + 1].rim - light[v].rim),
                          light[v].open + t * (light[v + 1].open - light[v].open) };
            vec colour = shade(view, &f, tangent, &r, along);
            vec to = k == pieces ? c : curve(a, b, c, d, t);
            if (k > 0) {
                float thin = along > 0.75f ? 1.0f - 0.6f * (along - 0.75f) / 0.25f : 1.0f; /* tips taper */
                *out++ = (raster_segment){ from.x,   from.y,        from.z,        to.x,           to.y,
                                           to.z,     colour_from.x, colour_from.y, colour_from.z,  colour.x,
                                           colour.y, colour.z,      p->half,       p->alpha * thin };
            }
            from = to;
            colour_from = colour;
        }
    }
}

/* ---- order --------------------------------------------------------------------------------------------------- */

/* Numbers of the segments from far to near, equal depths in the order of strands: a stable radix sort. */
static hg_status far_to_near(const raster_segment *segment, int64_t n, int32_t **order)
{
    uint32_t *key = hg_alloc((size_t)n, sizeof *key);
    int32_t *from = hg_alloc((size_t)n, sizeof *from), *to = hg_alloc((size_t)n, sizeof *to);
    if (!key || !from || !to) {
        hg_free(key);
        hg_free(from);
        hg_free(to);
        return HG_MEMORY;
    }
    for (int64_t i = 0; i < n; i++) {
        float depth = 0.5f * (segment[i].z0 + segment[i].z1); /* positive: its bits grow with it */
        memcpy(&key[i], &depth, sizeof depth);
        key[i] = ~key[i];
        from[i] = (int32_t)i;
    }
    for (int shift = 0; shift < 32; shift += 11) {
        int64_t start[2049] = { 0 };
        for (int64_t i = 0; i < n; i++) start[(key[from[i]] >> shift & 2047) + 1]++;
        for (int k = 0; k < 2048; k++) start[k + 1] += start[k];
        for (int64_t i = 0; i < n; i++) to[start[key[from[i]] >> shift & 2047]++] = from[i];
        int32_t *swap = from;
        from = to;
        to = swap;
    }
    hg_free(key);
    hg_free(to);
    *order = from;
    return HG_OK;
}

static hg_status bin_segments(raster_strands *strands, const raster_view *view)
{
    int64_t n = strands->n;
    int32_t *order = NULL;
    raster_box *box = hg_alloc((size_t)n, sizeof *box);
    if (!box) return HG_MEMORY;
    int threads = view->threads;
    (void)threads;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t i = 0; i < n; i++) {
        const raster_segment *s = &strands->segment[i];
        float reach = s->half + 1.0f;
        box[i] = raster_box_of(view, fminf(s->x0, s->x1) - reach, fminf(s->y0, s->y1) - reach,
                               fmaxf(s->x0, s->x1) + reach, fmaxf(s->y0, s->y1) + reach);
    }
    hg_status status = far_to_near(strands->segment, n, &order);
    if (status == HG_OK) status = raster_bins_build(&strands->bins, view, n, box, order);
    hg_free(order);
    hg_free(box);
    return status;
}

hg_status raster_strands_build(raster_strands *strands, const raster_view *view, const hg_view *scene, float width,
                               const raster_volume *volume, const raster_shadow *shadow)
{
    *strands = (raster_strands){ 0 };
    float thickness = width * view->scale; /* in samples; thinner than a sample: fainter instead */
    painter p = { .view = view, .scene = scene, .volume = volume, .shadow = shadow, .hairs = 1 };
    p.half = 0.5f * fmaxf(thickness, 1.0f);
    p.alpha = fminf(thickness, 1.0f);
    if (scene->hairs > 1) p.hairs = scene->hairs, p.radius = (float)scene->lock_radius;
    int64_t hairs = scene->strands * p.hairs;
    int64_t *start = hg_alloc((size_t)hairs + 1, sizeof *start);
    if (!start) return HG_MEMORY;
    int threads = view->threads;
    (void)threads;
    int64_t vertices = scene->strands * scene->vertices;
    p.light = hg_alloc((size_t)vertices, sizeof *p.light);
    if (!p.light) {
        hg_free(start);
        return HG_MEMORY;
    }
    if (scene->vertices > 1) {
#pragma omp parallel for schedule(dynamic, 512) num_threads(threads)
        for (int64_t i = 0; i < vertices; i++) {
            vec point = vec_of(scene->x + 3 * i);
            if (vec_finite(point)) p.light[i] = reached_at(&p, point);
        }
#pragma omp parallel for schedule(static) num_threads(threads)
        for (int64_t i = 0; i < hairs; i++) start[i + 1] = count_hair(&p, i);
    }
    for (int64_t i = 0; i < hairs; i++) start[i + 1] += start[i];
    strands->n = start[hairs];
    hg_status status = HG_OK;
    if (strands->n > INT32_MAX) status = hg_fail(HG_INVALID, "render: more than %d line segments", INT32_MAX);
    if (status == HG_OK) strands->segment = hg_alloc((size_t)strands->n, sizeof *strands->segment);
    if (status == HG_OK && !strands->segment) status = HG_MEMORY;
    if (status == HG_OK) {
#pragma omp parallel for schedule(dynamic, 64) num_threads(threads)
        for (int64_t i = 0; i < hairs; i++)
            if (start[i + 1] > start[i]) paint_hair(&p, i, strands->segment + start[i]);
        status = bin_segments(strands, view);
    }
    hg_free(start);
    hg_free(p.light);
    return status;
}

void raster_strands_free(raster_strands *strands)
{
    hg_free(strands->segment);
    raster_bins_free(&strands->bins);
}

/* ---- lines --------------------------------------------------------------------------------------------------- */

/* One segment over a tile: the samples whose projection falls on the segment, row by row, so that consecutive segments
 * of a curve meet without overlap. */
static void draw_segment(const raster_segment *s, int left, int top, int tile, const float *depth, float *colour)
{
    float x0 = s->x0 - (float)left - 0.5f, y0 = s->y0 - (float)top - 0.5f;
    float dx = s->x1 - s->x0, dy = s->y1 - s->y0, square = dx * dx + dy * dy;
    if (!(square > 1e-8f)) return;
    float inverse = 1.0f / square, length = sqrtf(square), reach = s->half + 0.5f;
    float low = fminf(0.0f, dy) + y0 - reach, high = fmaxf(0.0f, dy) + y0 + reach;
    int row0 = (int)clampf(ceilf(low), 0.0f, (float)tile), row1 = (int)clampf(floorf(high) + 1.0f, 0.0f, (float)tile);
    float left_end = fminf(0.0f, dx) + x0 - reach, right_end = fmaxf(0.0f, dx) + x0 + reach;
    for (int row = row0; row < row1; row++) {
        float from = left_end, to = right_end, py = (float)row - y0;
        if (fabsf(dy) > 1e-3f * length) { /* the slanted band of half width `reach` around the line */
            float middle = x0 + py * dx / dy, wide = reach * length / fabsf(dy);
            from = fmaxf(from, middle - wide);
            to = fminf(to, middle + wide);
        }
        int column0 = (int)clampf(ceilf(from), 0.0f, (float)tile);
        int column1 = (int)clampf(floorf(to) + 1.0f, 0.0f, (float)tile);
        for (int column = column0; column < column1; column++) {
            float px = (float)column - x0, t = (px * dx + py * dy) * inverse;
            if (t < 0.0f || t >= 1.0f) continue;
            float away = fabsf(px * dy - py * dx) / length;
            float alpha = s->alpha * clampf(reach - away, 0.0f, 1.0f);
            int at = row * tile + column;
            float z = s->z0 + t * (s->z1 - s->z0);
            if (alpha <= 0.0f || z > depth[at] + IN_FRONT) continue;
            float *c = colour + 4 * (size_t)at, rest = 1.0f - alpha;
            c[0] = rest * c[0] + alpha * (s->r0 + t * (s->r1 - s->r0));
            c[1] = rest * c[1] + alpha * (s->g0 + t * (s->g1 - s->g0));
            c[2] = rest * c[2] + alpha * (s->b0 + t * (s->b1 - s->b0));
            c[3] = rest * c[3] + alpha;
        }
    }
}

void raster_strands_draw(const raster_strands *strands, const raster_view *view, int tile_x, int tile_y,
                         const float *depth, float *colour)
{
    const int64_t *start = strands->bins.start + tile_y * view->tiles_x + tile_x;
    for (int64_t i = start[0]; i < start[1]; i++)
        draw_segment(&strands->segment[strands->bins.item[i]], tile_x * view->tile, tile_y * view->tile, view->tile,
                     depth, colour);
}
