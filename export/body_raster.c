/* The body: triangles with depth, smooth normals and a soft matte material, lit by key, fill and rim light; the key
 * light is shadowed by the body itself and by the hair. */
#include "export/raster.h"

#include <string.h>

/* ---- vertices ------------------------------------------------------------------------------------------------ */

/* Vertex normals: the sum of the faces' area vectors. */
static void body_normals(raster_body *body, const raster_view *view)
{
    const hg_view *scene = body->scene;
    for (int64_t f = 0; f < scene->body_faces; f++) {
        const int32_t *corner = scene->triangles + 3 * f;
        vec a = vec_of(scene->body + 3 * (int64_t)corner[0]);
        vec n = vec_cross(vec_sub(vec_of(scene->body + 3 * (int64_t)corner[1]), a),
                          vec_sub(vec_of(scene->body + 3 * (int64_t)corner[2]), a));
        if (!vec_finite(n)) continue;
        for (int k = 0; k < 3; k++) body->normal[corner[k]] = vec_add(body->normal[corner[k]], n);
    }
    for (int64_t i = 0; i < scene->body_vertices; i++) {
        vec n = vec_unit(body->normal[i]);
        body->normal[i] = (vec){ vec_dot(n, view->right), vec_dot(n, view->up), -vec_dot(n, view->forward) };
    }
}

hg_status raster_body_build(raster_body *body, const raster_view *view, const hg_view *scene,
                            const raster_volume *volume)
{
    *body = (raster_body){ .scene = scene };
    size_t n = (size_t)scene->body_vertices, faces = (size_t)scene->body_faces;
    body->screen = hg_alloc(n, sizeof(vec));
    body->normal = hg_alloc(n, sizeof(vec));
    body->lit = hg_alloc(n, 2 * sizeof(float));
    raster_box *box = hg_alloc(faces, sizeof *box);
    if (!body->screen || !body->normal || !body->lit || !box) {
        hg_free(box);
        return HG_MEMORY;
    }
    body_normals(body, view);

    int threads = view->threads;
    (void)threads;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t i = 0; i < scene->body_vertices; i++) {
        vec p = vec_of(scene->body + 3 * i), n_view = body->normal[i];
        body->screen[i] = raster_project(view, p);
        body->lit[2 * i] = body->lit[2 * i + 1] = 1.0f;
        if (!volume->density || !vec_finite(p)) continue;
        vec n_world = vec_add(vec_add(vec_scale(view->right, n_view.x), vec_scale(view->up, n_view.y)),
                              vec_scale(view->forward, -n_view.z));
        vec above = vec_along(p, n_world, 0.4f * volume->cell);
        body->lit[2 * i] = raster_volume_through(volume, above, view->light_world[0], 0.0f, 0.3f);
        body->lit[2 * i + 1] = raster_volume_open(volume, view, above, 0.0f);
    }

    for (size_t f = 0; f < faces; f++) {
        vec a = body->screen[scene->triangles[3 * f]], b = body->screen[scene->triangles[3 * f + 1]];
        vec c = body->screen[scene->triangles[3 * f + 2]];
        box[f] = (raster_box){ 1, 1, 0, 0 };
        if (vec_finite(a) && vec_finite(b) && vec_finite(c) && (a.z > 0.0f || b.z > 0.0f || c.z > 0.0f))
            box[f] = raster_box_of(view, fminf(a.x, fminf(b.x, c.x)), fminf(a.y, fminf(b.y, c.y)),
                                   fmaxf(a.x, fmaxf(b.x, c.x)), fmaxf(a.y, fmaxf(b.y, c.y)));
    }
    hg_status status = raster_bins_build(&body->bins, view, scene->body_faces, box, NULL);
    hg_free(box);
    return status;
}

void raster_body_free(raster_body *body)
{
    hg_free(body->screen);
    hg_free(body->normal);
    hg_free(body->lit);
    raster_bins_free(&body->bins);
}

/* ---- faces --------------------------------------------------------------------------------------------------- */

/* Barycentric coordinates of a point of the screen in a face; false for a face seen edge on. */
static bool face_weights(const vec p[3], float x, float y, float weight[3])
{
    float area = (p[1].x - p[0].x) * (p[2].y - p[0].y) - (p[1].y - p[0].y) * (p[2].x - p[0].x);
    if (!(fabsf(area) > 1e-12f)) return false;
    weight[1] = ((x - p[0].x) * (p[2].y - p[0].y) - (y - p[0].y) * (p[2].x - p[0].x)) / area;
    weight[2] = ((p[1].x - p[0].x) * (y - p[0].y) - (p[1].y - p[0].y) * (x - p[0].x)) / area;
    weight[0] = 1.0f - weight[1] - weight[2];
    return true;
}

static void draw_face(const vec p[3], int32_t number, int left, int top, int tile, float *depth, int32_t *face)
{
    int x0 = (int)clampf(floorf(fminf(p[0].x, fminf(p[1].x, p[2].x))) - (float)left, 0.0f, (float)tile);
    int x1 = (int)clampf(ceilf(fmaxf(p[0].x, fmaxf(p[1].x, p[2].x))) - (float)left, 0.0f, (float)tile);
    int y0 = (int)clampf(floorf(fminf(p[0].y, fminf(p[1].y, p[2].y))) - (float)top, 0.0f, (float)tile);
    int y1 = (int)clampf(ceilf(fmaxf(p[0].y, fmaxf(p[1].y, p[2].y))) - (float)top, 0.0f, (float)tile);
    for (int y = y0; y < y1; y++)
        for (int x = x0; x < x1; x++) {
            float weight[3];
            if (!face_weights(p, (float)(left + x) + 0.5f, (float)(top + y) + 0.5f, weight)) return;
            if (weight[0] < 0.0f || weight[1] < 0.0f || weight[2] < 0.0f) continue;
            float z = weight[0] * p[0].z + weight[1] * p[1].z + weight[2] * p[2].z;
            int at = y * tile + x;
            if (z > 0.0f && z < depth[at]) {
                depth[at] = z;
                face[at] = number;
            }
        }
}

/* A matte, slightly translucent surface: red light wraps further around an edge than blue. */
static vec shade_body(const raster_view *view, vec n, float key_lit, float open)
{
    const vec albedo = { 0.545f, 0.390f, 0.318f }, wrap = { 0.34f, 0.20f, 0.14f };
    const vec sky = { 0.36f, 0.38f, 0.42f }, ground = { 0.15f, 0.125f, 0.11f };
    float inside = n.z < 0.0f ? 0.35f : 1.0f; /* the back of an open mesh: mouth, eye sockets, neck */
    if (n.z < 0.0f) n = vec_scale(n, -1.0f);
    vec sum = vec_scale(vec_mix(ground, sky, 0.5f + 0.5f * n.y), open);
    float gloss = 0.0f;
    for (int k = 0; k < RASTER_LIGHTS; k++) {
        float facing = vec_dot(n, view->light[k]);
        float lit = k == 0 ? key_lit : open;
        vec soft = { fmaxf(0.0f, (facing + wrap.x) / (1.0f + wrap.x)), fmaxf(0.0f, (facing + wrap.y) / (1.0f + wrap.y)),
                     fmaxf(0.0f, (facing + wrap.z) / (1.0f + wrap.z)) };
        sum = vec_add(sum, vec_scale(vec_mul(soft, view->light_colour[k]), lit));
        vec half = vec_unit(vec_add(view->light[k], (vec){ 0.0f, 0.0f, 1.0f }));
        float shine = fmaxf(0.0f, vec_dot(n, half));
        shine *= shine, shine *= shine, shine *= shine, shine *= shine;
        if (facing > 0.0f) gloss += 0.035f * lit * shine * view->light_colour[k].y;
    }
    vec colour = vec_scale(vec_mul(albedo, sum), inside);
    return vec_add(colour, (vec){ gloss, gloss, gloss });
}

void raster_body_draw(const raster_body *body, const raster_view *view, const raster_shadow *shadow, int tile_x,
                      int tile_y, float *depth, int32_t *face, float *colour)
{
    int tile = view->tile, left = tile_x * tile, top = tile_y * tile;
    int samples = tile * tile;
    for (int i = 0; i < samples; i++) depth[i] = INFINITY, face[i] = -1;
    memset(colour, 0, (size_t)samples * 4 * sizeof(float));
    const int32_t *triangles = body->scene->triangles;
    const int64_t *start = body->bins.start + tile_y * view->tiles_x + tile_x;
    for (int64_t i = start[0]; i < start[1]; i++) {
        int32_t f = body->bins.item[i];
        vec p[3] = { body->screen[triangles[3 * f]], body->screen[triangles[3 * f + 1]],
                     body->screen[triangles[3 * f + 2]] };
        draw_face(p, f, left, top, tile, depth, face);
    }
    for (int y = 0; y < tile; y++)
        for (int x = 0; x < tile; x++) {
            int at = y * tile + x;
            if (face[at] < 0) continue;
            const int32_t *corner = triangles + 3 * (int64_t)face[at];
            vec p[3] = { body->screen[corner[0]], body->screen[corner[1]], body->screen[corner[2]] };
            float weight[3], px = (float)(left + x) + 0.5f, py = (float)(top + y) + 0.5f, key = 0.0f, open = 0.0f;
            if (!face_weights(p, px, py, weight)) continue;
            vec n = { 0 };
            for (int k = 0; k < 3; k++) {
                n = vec_along(n, body->normal[corner[k]], weight[k]);
                key += weight[k] * body->lit[2 * corner[k]];
                open += weight[k] * body->lit[2 * corner[k] + 1];
            }
            n = vec_unit(n);
            if (vec_dot(n, view->light[0]) > -0.3f) {
                vec point = raster_unproject(view, px, py, depth[at]);
                key *= raster_shadow_lit(shadow, point, 0.006f);
            }
            vec shade = shade_body(view, n, key, open);
            float *out = colour + 4 * (size_t)at;
            out[0] = shade.x, out[1] = shade.y, out[2] = shade.z, out[3] = 1.0f;
        }
}
