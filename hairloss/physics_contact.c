/* physics_contact: where strands are near the body, before their energies are summed.
 *
 * Solvers look at the same body hundreds of times, and most strands are where they were: while the body is held it is fitted
 * once, and only vertices that moved since the last call are searched for. What is found is the same. */
#include "hairloss/physics_contact.h"

#include <string.h>

static void drop_last(hg_physics_contact *c)
{
    char *const memory[] = { c->x,  c->point,     c->normal,    (char *)c->moved, (char *)c->triangle,
                             c->at, c->its_point, c->its_normal };
    for (size_t i = 0; i < sizeof memory / sizeof *memory; i++) hg_free(memory[i]);
    c->x = c->point = c->normal = c->at = c->its_point = c->its_normal = NULL;
    c->moved = c->triangle = NULL;
    c->room = 0;
}

void hg_physics_contact_free(hg_physics_contact *c)
{
    hg_body_refit_destroy(c->refit);
    hg_tensor_destroy(c->triangles);
    drop_last(c);
}

static hg_status make_room(hg_physics_contact *c, hg_ctx *ctx, hg_dtype dtype, const hg_body_tree *body, int64_t frames,
                           int64_t points)
{
    hg_tensor *triangles = hg_tensor_create(ctx, HG_I32, 1, (int64_t[]){ frames * points });
    if (!triangles) return HG_MEMORY;
    hg_tensor_destroy(c->triangles);
    c->triangles = triangles;
    HG_TRY(hg_tensor_fill(triangles, -1));
    hg_body_refit_destroy(c->refit);
    c->refit = NULL;
    c->frames = 0;
    c->known = false;
    HG_TRY(hg_body_refit_create_frames(&c->refit, body, dtype, frames));
    c->frames = frames;
    return HG_OK;
}

static hg_status room_for_last(hg_physics_contact *c, size_t vertex, int64_t points)
{
    if (points <= c->room) return HG_OK;
    drop_last(c);
    const size_t n = (size_t)points;
    c->x = hg_alloc(n, vertex);
    c->point = hg_alloc(n, vertex);
    c->normal = hg_alloc(n, vertex);
    c->at = hg_alloc(n, vertex);
    c->its_point = hg_alloc(n, vertex);
    c->its_normal = hg_alloc(n, vertex);
    c->moved = hg_alloc(n, sizeof *c->moved);
    c->triangle = hg_alloc(n, sizeof *c->triangle);
    if (!c->x || !c->point || !c->normal || !c->at || !c->its_point || !c->its_normal || !c->moved || !c->triangle)
        return HG_MEMORY;
    c->room = points;
    c->known = false;
    return HG_OK;
}

/* Those that moved since the last call, and what is found for them put in the place of what was. */
static hg_status find_moved(hg_physics_contact *c, hg_ctx *ctx, size_t vertex, const char *x, int64_t points,
                            double reach)
{
    int32_t *guess = c->triangles->data;
    int64_t n = 0;
    for (int64_t i = 0; i < points; i++) {
        const size_t at = (size_t)i * vertex;
        if (memcmp(x + at, c->x + at, vertex) == 0) continue;
        memcpy(c->x + at, x + at, vertex);
        memcpy(c->at + (size_t)n * vertex, x + at, vertex);
        c->triangle[n] = guess[i];
        c->moved[n++] = (int32_t)i;
    }
    if (!n) return HG_OK;
    const hg_status status =
        hg_body_closest(ctx, c->refit, c->mode, reach, n, c->at, c->triangle, c->its_point, c->its_normal);
    if (status != HG_OK) {
        c->known = false;
        return status;
    }
    for (int64_t k = 0; k < n; k++) {
        const size_t to = (size_t)c->moved[k] * vertex, from = (size_t)k * vertex;
        guess[c->moved[k]] = c->triangle[k];
        memcpy(c->point + to, c->its_point + from, vertex);
        memcpy(c->normal + to, c->its_normal + from, vertex);
    }
    return HG_OK;
}

static hg_status find_held(hg_physics_contact *c, hg_ctx *ctx, size_t vertex, const hg_tensor *body_vertices,
                           const hg_tensor *x, int64_t points, double reach)
{
    HG_TRY(room_for_last(c, vertex, points));
    if (c->known) return find_moved(c, ctx, vertex, x->data, points, reach);
    HG_TRY(hg_body_refit_update_frames(ctx, c->refit, 1, body_vertices->data));
    HG_TRY(hg_body_closest(ctx, c->refit, c->mode, reach, points, x->data, c->triangles->data, c->point, c->normal));
    memcpy(c->x, x->data, (size_t)points * vertex);
    c->known = true;
    return HG_OK;
}

hg_status hg_physics_contact_find(hg_physics_contact *c, hg_ctx *ctx, hg_dtype dtype, const hg_body_tree *body,
                                  const hg_tensor *body_vertices, const hg_tensor *x, double reach, void **point,
                                  void **normal)
{
    const int64_t B = x->shape[0], points = x->shape[1] * x->shape[2];
    const size_t vertex = 3 * hg_dtype_size(dtype), bytes = (size_t)(B * points) * vertex;
    if (B > c->frames) HG_TRY(make_room(c, ctx, dtype, body, B, points));
    if (c->held && B == 1 && hg_ctx_host(ctx)) {
        HG_TRY(find_held(c, ctx, vertex, body_vertices, x, points, reach));
        *point = c->point;
        *normal = c->normal;
        return HG_OK;
    }
    *point = hg_step_device(ctx, bytes + 1);
    *normal = hg_step_device(ctx, bytes + 1);
    if (!*point || !*normal)
        return hg_fail(HG_MEMORY, "out of memory for the contacts of %lld vertices", (long long)(B * points));
    if (B == 0) return HG_OK;
    HG_TRY(hg_body_refit_update_frames(ctx, c->refit, B, body_vertices->data));
    return hg_body_closest(ctx, c->refit, c->mode, reach, points, x->data, c->triangles->data, *point, *normal);
}
