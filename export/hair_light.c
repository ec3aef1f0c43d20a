/* Light that reaches hair and body: a shadow map of the body for the key light, and the hair as a volume of shadowing
 * area through which rays are followed (a deep opacity volume). Both are soft on purpose: hair has its look of depth
 * from light that gets lost between strands, not from hard shadows. */
#include "export/raster.h"

#include <string.h>

/* ---- shadow map ---------------------------------------------------------------------------------------------- */

#define SHADOW_SIZE 768

static vec shadow_project(const raster_shadow *shadow, vec p)
{
    vec d = vec_sub(p, shadow->centre);
    return (vec){ vec_dot(d, shadow->right) * shadow->scale + 0.5f * (float)shadow->size,
                  vec_dot(d, shadow->up) * shadow->scale + 0.5f * (float)shadow->size, -vec_dot(d, shadow->towards) };
}

static void shadow_triangle(raster_shadow *shadow, vec a, vec b, vec c)
{
    float area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    if (!(fabsf(area) > 1e-12f)) return;
    float size = (float)shadow->size;
    int left = (int)clampf(floorf(fminf(a.x, fminf(b.x, c.x))), 0.0f, size);
    int right = (int)clampf(ceilf(fmaxf(a.x, fmaxf(b.x, c.x))), 0.0f, size);
    int top = (int)clampf(floorf(fminf(a.y, fminf(b.y, c.y))), 0.0f, size);
    int bottom = (int)clampf(ceilf(fmaxf(a.y, fmaxf(b.y, c.y))), 0.0f, size);
    for (int y = top; y < bottom; y++)
        for (int x = left; x < right; x++) {
            float px = (float)x + 0.5f, py = (float)y + 0.5f;
            float v = ((px - a.x) * (c.y - a.y) - (py - a.y) * (c.x - a.x)) / area;
            float w = ((b.x - a.x) * (py - a.y) - (b.y - a.y) * (px - a.x)) / area;
            if (v < 0.0f || w < 0.0f || v + w > 1.0f) continue;
            float depth = a.z + v * (b.z - a.z) + w * (c.z - a.z);
            float *kept = &shadow->depth[(size_t)y * (size_t)shadow->size + (size_t)x];
            if (depth < *kept) *kept = depth;
        }
}

hg_status raster_shadow_build(raster_shadow *shadow, const raster_view *view, const hg_view *scene, float extent)
{
    vec towards = view->light_world[0];
    *shadow = (raster_shadow){ .size = SHADOW_SIZE, .towards = towards, .centre = view->target };
    shadow->right = vec_unit(vec_cross(view->up, towards));
    shadow->up = vec_cross(towards, shadow->right);
    shadow->scale = SHADOW_SIZE / extent;
    size_t pixels = (size_t)SHADOW_SIZE * SHADOW_SIZE;
    shadow->depth = hg_alloc(pixels, sizeof(float));
    if (!shadow->depth) return HG_MEMORY;
    for (size_t i = 0; i < pixels; i++) shadow->depth[i] = INFINITY;
    for (int64_t f = 0; f < scene->body_faces; f++) {
        vec p[3];
        for (int k = 0; k < 3; k++)
            p[k] = shadow_project(shadow, vec_of(scene->body + 3 * (int64_t)scene->triangles[3 * f + k]));
        if (vec_finite(p[0]) && vec_finite(p[1]) && vec_finite(p[2])) shadow_triangle(shadow, p[0], p[1], p[2]);
    }
    return HG_OK;
}

void raster_shadow_free(raster_shadow *shadow)
{
    hg_free(shadow->depth);
    shadow->depth = NULL;
}

/* 5 x 5 comparisons around the point; outside the map everything is lit. */
float raster_shadow_lit(const raster_shadow *shadow, vec point, float bias)
{
    vec p = shadow_project(shadow, point);
    if (!(p.x > 2.0f && p.y > 2.0f && p.x < (float)shadow->size - 3.0f && p.y < (float)shadow->size - 3.0f))
        return 1.0f;
    int x = (int)p.x, y = (int)p.y, lit = 0;
    for (int dy = -2; dy <= 2; dy++)
        for (int dx = -2; dx <= 2; dx++)
            lit += shadow->depth[(size_t)(y + dy) * (size_t)shadow->size + (size_t)(x + dx)] > p.z - bias;
    return (float)lit / 25.0f;
}

/* ---- hair volume --------------------------------------------------------------------------------------------- */

#define LARGEST_SIDE 112   /* cells along the longest side */
#define EXTINCTION   0.55f /* a strand lets some light through and scatters some on */

static void volume_bounds(const hg_view *scene, vec *low, vec *high)
{
    *low = (vec){ INFINITY, INFINITY, INFINITY };
    *high = (vec){ -INFINITY, -INFINITY, -INFINITY };
    for (int64_t i = 0; i < scene->strands * scene->vertices; i++) {
        vec p = vec_of(scene->x + 3 * i);
        if (!vec_finite(p)) continue;
        *low = (vec){ fminf(low->x, p.x), fminf(low->y, p.y), fminf(low->z, p.z) };
        *high = (vec){ fmaxf(high->x, p.x), fmaxf(high->y, p.y), fmaxf(high->z, p.z) };
    }
}

/* Spreads an amount over the eight cells whose centres surround the point. */
static void volume_add(raster_volume *volume, vec p, float amount)
{
    float q[3] = { (p.x - volume->low.x) / volume->cell - 0.5f, (p.y - volume->low.y) / volume->cell - 0.5f,
                   (p.z - volume->low.z) / volume->cell - 0.5f };
    int cell[3];
    for (int k = 0; k < 3; k++) {
        q[k] = clampf(q[k], 0.0f, (float)(volume->n[k] - 2) + 0.999f);
        cell[k] = (int)q[k];
        q[k] -= (float)cell[k];
    }
    for (int corner = 0; corner < 8; corner++) {
        int i = corner & 1, j = corner >> 1 & 1, k = corner >> 2;
        float weight = (i ? q[0] : 1 - q[0]) * (j ? q[1] : 1 - q[1]) * (k ? q[2] : 1 - q[2]);
        size_t at = ((size_t)(cell[2] + k) * (size_t)volume->n[1] + (size_t)(cell[1] + j)) * (size_t)volume->n[0] +
                    (size_t)(cell[0] + i);
        volume->density[at] += weight * amount;
    }
}

hg_status raster_volume_build(raster_volume *volume, const hg_view *scene, float width)
{
    *volume = (raster_volume){ 0 };
    vec low, high;
    volume_bounds(scene, &low, &high);
    if (!(low.x <= high.x)) return HG_OK; /* no hair: light passes */
    vec size = vec_sub(high, low);
    float longest = fmaxf(size.x, fmaxf(size.y, size.z));
    volume->cell = fmaxf(longest / (LARGEST_SIDE - 4), 1e-3f);
    volume->low = vec_sub(low, (vec){ 2 * volume->cell, 2 * volume->cell, 2 * volume->cell });
    float side[3] = { size.x, size.y, size.z };
    for (int k = 0; k < 3; k++) volume->n[k] = (int)clampf(side[k] / volume->cell, 0.0f, LARGEST_SIDE) + 5;
    volume->density = hg_alloc((size_t)volume->n[0] * (size_t)volume->n[1] * (size_t)volume->n[2], sizeof(float));
    if (!volume->density) return HG_MEMORY;

    float scale = EXTINCTION * width / (volume->cell * volume->cell * volume->cell);
    for (int64_t s = 0; s < scene->strands; s++)
        for (int64_t v = 0; v + 1 < scene->vertices; v++) {
            vec a = vec_of(scene->x + 3 * (s * scene->vertices + v));
            vec edge = vec_sub(vec_of(scene->x + 3 * (s * scene->vertices + v + 1)), a);
            float length = sqrtf(vec_dot(edge, edge));
            if (!vec_finite(a) || !isfinite(length) || length == 0.0f) continue;
            int pieces = (int)clampf(ceilf(length / volume->cell), 1.0f, 64.0f);
            for (int k = 0; k < pieces; k++)
                volume_add(volume, vec_along(a, edge, ((float)k + 0.5f) / (float)pieces),
                           scale * length / (float)pieces);
        }
    return HG_OK;
}

void raster_volume_free(raster_volume *volume)
{
    hg_free(volume->density);
    volume->density = NULL;
}

static float volume_at(const raster_volume *volume, vec p)
{
    float q[3] = { (p.x - volume->low.x) / volume->cell - 0.5f, (p.y - volume->low.y) / volume->cell - 0.5f,
                   (p.z - volume->low.z) / volume->cell - 0.5f };
    int cell[3];
    for (int k = 0; k < 3; k++) {
        if (!(q[k] >= 0.0f && q[k] < (float)(volume->n[k] - 1))) return 0.0f;
        cell[k] = (int)q[k];
        q[k] -= (float)cell[k];
    }
    size_t row = (size_t)volume->n[0], plane = row * (size_t)volume->n[1];
    const float *d = volume->density + (size_t)cell[2] * plane + (size_t)cell[1] * row + (size_t)cell[0];
    float a = d[0] + q[0] * (d[1] - d[0]), b = d[row] + q[0] * (d[row + 1] - d[row]);
    float c = d[plane] + q[0] * (d[plane + 1] - d[plane]);
    float e = d[plane + row] + q[0] * (d[plane + row + 1] - d[plane + row]);
    float near = a + q[1] * (b - a), far = c + q[1] * (e - c);
    return near + q[2] * (far - near);
}

/* Steps grow on the way: what is far is seen coarsely, as it should be for a soft light. */
float raster_volume_through(const raster_volume *volume, vec from, vec towards, float skip, float reach)
{
    if (!volume->density) return 1.0f;
    float depth = 0.0f, at = skip, step = volume->cell;
    while (at < reach && depth < 6.0f) {
        depth += step * volume_at(volume, vec_along(from, towards, at + 0.5f * step));
        at += step;
        step *= 1.25f;
    }
    return expf(-depth);
}

float raster_volume_open(const raster_volume *volume, const raster_view *view, vec from, float skip)
{
    if (!volume->density) return 1.0f;
    static const float direction[5][4] = { /* right, up, towards the eye, weight */
                                           { 0.0f, 0.30f, 0.95f, 0.30f },
                                           { 0.0f, 1.00f, 0.10f, 0.22f },
                                           { 0.94f, 0.20f, 0.25f, 0.18f },
                                           { -0.94f, 0.20f, 0.25f, 0.18f },
                                           { 0.0f, -0.90f, 0.40f, 0.12f }
    };
    float open = 0.0f;
    for (int k = 0; k < 5; k++) {
        vec towards = vec_add(vec_add(vec_scale(view->right, direction[k][0]), vec_scale(view->up, direction[k][1])),
                              vec_scale(view->forward, -direction[k][2]));
        open += direction[k][3] * raster_volume_through(volume, from, towards, skip, 0.08f);
    }
    return open;
}
