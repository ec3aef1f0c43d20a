/* Rows of contact: self collision with its neighbour list, and the closest triangle of a body that moves. */
#include "bench/bench.h"

#include "tasks/hair.h"

#include <math.h>
#include <string.h>

/* ---- self collision ----------------------------------------------------------------------------------------- */

typedef struct {
    hg_ctx *ctx;
    hg_physics *physics;
    hg_tensor *x, *gradient;
} collision;

static void collide(void *self, double *ms, int n)
{
    collision *s = self;
    double energy;
    const hg_frame frame = { .dt = 1.0 / 30 };
    for (int i = -1; i < n; i++) {
        const double start = bench_now();
        bench_need(hg_physics_evaluate(s->physics, s->ctx, &frame, s->x, &energy, NULL, s->gradient));
        bench_need(hg_ctx_wait(s->ctx));
        if (i >= 0) ms[i] = bench_now() - start;
        hg_step_reset(s->ctx);
    }
}

/* Half of the radius within which a vertex has `wanted` neighbours in the mean. */
static double find_h(bench *b, int64_t n, const float *x, double wanted, double *found)
{
    hg_neighbours *list;
    double low = 1e-4, high = 2e-2;
    bench_need(hg_neighbours_create(&list, 0));
    for (int i = 0; i < 12; i++) {
        const double h = sqrt(low * high);
        bench_need(hg_neighbours_build(b->host, list, HG_F32, n, x, 2 * h, NULL));
        *found = (double)hg_neighbours_start(list)[n] / (double)n;
        if (*found > wanted)
            high = h;
        else
            low = h;
        if (fabs(*found - wanted) < 0.5) break;
    }
    hg_neighbours_destroy(list);
    return sqrt(low * high);
}

void bench_self_collision(bench *b)
{
    const hg_hair_task *task = bench_task(b, 2);
    const int64_t S = task->subset.n, V = task->groom->vertices, n = S * V, shape[4] = { 1, S, V, 3 };
    double *rest = hg_alloc((size_t)(3 * n), sizeof *rest), found;
    collision side[2];
    if (!rest) bench_need(HG_MEMORY);
    float *from = bench_get(task->subset.rest), *x = hg_alloc((size_t)(3 * n), sizeof *x);
    if (!x) bench_need(HG_MEMORY);
    for (int64_t i = 0; i < 3 * n; i++) {
        rest[i] = (double)from[i];
        x[i] = (float)(rest[i] + 1e-3 * hg_random_normal(3, 0, (uint64_t)i));
    }
    hg_free(from);
    for (int c = 0; c < 2; c++) {
        side[c] = (collision){ .ctx = b->ctx[c],
                               .x = hg_tensor_create(b->ctx[c], HG_F32, 4, shape),
                               .gradient = hg_tensor_create(b->ctx[c], HG_F32, 4, shape) };
        if (!side[c].x || !side[c].gradient) bench_need(HG_MEMORY);
        bench_put(side[c].x, x);
    }
    const double h = find_h(b, n, x, 50, &found), params[HG_ENERGY_PARAMS] = { 1e-10, h };
    const hg_groom_data data = { .grooms = 1, .strands = S, .vertices = V, .rest = rest };
    const hg_term term = { hg_energy_find("self_collision"), 1, params, NULL };
    for (int c = 0; c < 2; c++) bench_need(hg_physics_create(&side[c].physics, b->ctx[c], HG_F32, &term, 1, &data));
    bench_write(b, "rest", HG_F64, 3, shape + 1, rest);
    bench_write_tensor(b, "x", side[1].x);
    bench_write(b, "h", HG_F64, 1, (int64_t[]){ 1 }, &h);
    bench_peer *peer = bench_peer_start(b, "self_collision", 100);

    double ms;
    for (int c = 0; c < 2; c++) collide(&side[c], &ms, 1);
    int64_t state[3];
    bench_result r = { .row = "self_collision", .ours = "cells and gradient", .aim = 20 };
    r.same_bits = bench_same(side[0].gradient, side[1].gradient);
    bench_steady_begin(b, state);
    bench_side race[2] = { { "ours", collide, &side[1] } };
    int sides = 1;
    if (bench_peer_has(peer, "eager")) race[sides++] = bench_peer_side(peer, "eager", "PyTorch with cKDTree");
    bench_race(b, sides, race, 5);
    r.steady = bench_steady(b, state);
    r.ours_ms = race[0].median;
    if (sides > 1) {
        r.other_ms = race[1].median;
        snprintf(r.other, sizeof r.other, "PyTorch eager, cKDTree");
    }
    /* per neighbour: distance, W, W' and three components, about 40 operations; its position, twice */
    r.operations = 40 * found * (double)n;
    r.bytes = 2 * 12 * found * (double)n;
    snprintf(r.note, sizeof r.note, "%lld vertices, %.0f neighbours each, h %.2f mm, %s; %s", (long long)n, found,
             1e3 * h, b->scene, bench_peer_text(peer));
    bench_add(b, &r);
    bench_peer_end(peer);
    for (int c = 0; c < 2; c++) {
        hg_physics_destroy(side[c].physics);
        hg_tensor_destroy(side[c].x);
        hg_tensor_destroy(side[c].gradient);
    }
    hg_free(rest);
    hg_free(x);
}

/* ---- body collision ----------------------------------------------------------------------------------------- */

enum { FRAMES = 4 };
typedef struct {
    hg_ctx *ctx;
    hg_body_refit *refit;
    const float *vertices[FRAMES], *points[FRAMES]; /* of consecutive frames */
    int64_t n;
    int32_t *triangle;
    float *contact, *normal;
    /* where the context computes: the same */
    hg_tensor *bodies[FRAMES], *places[FRAMES], *triangles, *contacts, *normals;
    double reach;
    int at;
#ifdef BENCH_EMBREE
    bench_embree *embree;
    float *distance;
#endif
} closest;

static void ours(void *self, double *ms, int n)
{
    closest *s = self;
    for (int i = -1; i < n; i++) {
        const int f = s->at++ % FRAMES;
        const double start = bench_now();
        bench_need(hg_body_refit_update(s->ctx, s->refit, s->bodies[f]->data));
        bench_need(hg_body_closest(s->ctx, s->refit, HG_CONTACT_EXACT, s->reach, s->n, s->places[f]->data,
                                   s->triangles->data, s->contacts->data, s->normals->data));
        bench_need(hg_ctx_wait(s->ctx));
        if (i >= 0) ms[i] = bench_now() - start;
        hg_step_reset(s->ctx);
    }
}

static hg_tensor *sent(hg_ctx *ctx, hg_dtype dtype, int64_t n, const void *from)
{
    hg_tensor *to = hg_tensor_create(ctx, dtype, 1, &n);
    if (!to) bench_need(hg_ctx_status(ctx));
    bench_need(hg_tensor_write(to, from));
    return to;
}

static void send(closest *s, int64_t n_vertices)
{
    for (int f = 0; f < FRAMES; f++) {
        s->bodies[f] = sent(s->ctx, HG_F32, 3 * n_vertices, s->vertices[f]);
        s->places[f] = sent(s->ctx, HG_F32, 3 * s->n, s->points[f]);
    }
    s->triangles = sent(s->ctx, HG_I32, s->n, s->triangle);
    s->contacts = sent(s->ctx, HG_F32, 3 * s->n, s->contact);
    s->normals = sent(s->ctx, HG_F32, 3 * s->n, s->normal);
}

static void fetch(closest *s)
{
    bench_need(hg_tensor_read(s->triangles, s->triangle));
    bench_need(hg_tensor_read(s->contacts, s->contact));
    bench_need(hg_tensor_read(s->normals, s->normal));
}

#ifdef BENCH_EMBREE
static void embree(void *self, double *ms, int n)
{
    closest *s = self;
    for (int i = -1; i < n; i++) {
        const int f = s->at++ % FRAMES;
        const double start = bench_now();
        bench_embree_query(s->embree, s->vertices[f], (float)s->reach, s->n, s->points[f], s->triangle, s->distance);
        if (i >= 0) ms[i] = bench_now() - start;
    }
}

/* Both find the same distance, where both find one. */
static double disagreement(const closest *a, const closest *e, int frame)
{
    double worst = 0;
    for (int64_t i = 0; i < a->n; i++) {
        double d = 0;
        for (int k = 0; k < 3; k++) d += pow((double)(a->contact[3 * i + k] - a->points[frame][3 * i + k]), 2);
        if (a->triangle[i] >= 0 && e->triangle[i] >= 0) worst = fmax(worst, fabs(sqrt(d) - (double)e->distance[i]));
    }
    return worst;
}
#endif

void bench_body_collision(bench *b)
{
    hg_hair_task *task = bench_task(b, 0);
    const int64_t S = task->subset.n, V = task->groom->vertices, n = S * V, N = task->body->vertices,
                  F = task->body->faces;
    const int32_t *faces = task->body->triangles;
    hg_poser *poser; /* of the whole body, not only of what a training lets collide */
    bench_need(hg_poser_create(&poser, task->body, false));
    double *rest = hg_alloc((size_t)(3 * N), sizeof *rest);
    float *vertices = hg_alloc((size_t)(FRAMES * 3 * N), sizeof *vertices),
          *points = hg_alloc((size_t)(FRAMES * 3 * n), sizeof *points),
          *rotation = hg_alloc((size_t)(4 * S), sizeof *rotation),
          *position = hg_alloc((size_t)(3 * S), sizeof *position);
    float *strands = hg_alloc((size_t)(3 * n), sizeof *strands);
    if (!rest || !vertices || !points || !rotation || !position || !strands) bench_need(HG_MEMORY);
    bench_need(hg_tensor_read(task->subset.rest, strands));
    for (int f = 0; f < FRAMES; f++) { /* a groom that follows the head, a little behind */
        bench_need(hg_pose(b->host, poser, NULL, task->clips[0][0].motion, 10 + f, vertices + f * 3 * N, NULL, NULL));
        bench_need(hg_pose_roots(b->host, poser, task->groom, task->subset.strand, S, vertices + f * 3 * N, rotation,
                                 position));
        hg_pose_strands(b->host, S, V, strands, rotation, position, points + f * 3 * n);
        for (int64_t i = 0; i < 3 * n; i++)
            points[f * 3 * n + i] += (float)(5e-4 * hg_random_normal(5, (uint64_t)f, (uint64_t)i));
    }
    for (int64_t i = 0; i < 3 * N; i++) rest[i] = (double)vertices[i];
    hg_body_tree *tree;
    bench_need(hg_body_tree_create(&tree, N, rest, F, faces));
    for (int bounded = 1; bounded >= 0; bounded--) {
        closest side[3] = { 0 };
        for (int c = 0; c < 3; c++) {
            side[c] = (closest){ .ctx = b->ctx[c > 0], .n = n, .reach = bounded ? 0.01 : (double)INFINITY };
            for (int f = 0; f < FRAMES; f++)
                side[c].vertices[f] = vertices + f * 3 * N, side[c].points[f] = points + f * 3 * n;
            side[c].triangle = hg_alloc((size_t)n, sizeof *side[c].triangle);
            side[c].contact = hg_alloc((size_t)(3 * n), sizeof(float));
            side[c].normal = hg_alloc((size_t)(3 * n), sizeof(float));
            if (!side[c].triangle || !side[c].contact || !side[c].normal) bench_need(HG_MEMORY);
            for (int64_t i = 0; i < n; i++) side[c].triangle[i] = -1;
            if (c == 2) continue;
            bench_need(hg_body_refit_create(&side[c].refit, tree, HG_F32));
            send(&side[c], N);
        }
        bench_result r = { .aim = 1, .ours = "refit and closest triangles" };
        snprintf(r.row, sizeof r.row, "body_collision, %s", bounded ? "within 1 cm" : "any distance");
        double ms;
        for (int c = 0; c < 2; c++) {
            ours(&side[c], &ms, 1);
            fetch(&side[c]);
        }
        r.same_bits = !memcmp(side[0].contact, side[1].contact, (size_t)n * 12) &&
                      !memcmp(side[0].normal, side[1].normal, (size_t)n * 12) &&
                      !memcmp(side[0].triangle, side[1].triangle, (size_t)n * 4);
        bench_side race[2] = { { "ours", ours, &side[1] } };
        int sides = 1;
        double worst = 0;
#ifdef BENCH_EMBREE
        side[2].embree = bench_embree_create(N, F, faces);
        side[2].distance = hg_alloc((size_t)n, sizeof(float));
        if (!side[2].distance) bench_need(HG_MEMORY);
        embree(&side[2], &ms, 1);
        worst = disagreement(&side[1], &side[2], 1);
        race[sides++] = (bench_side){ "Embree", embree, &side[2] };
#endif
        int64_t state[3];
        bench_steady_begin(b, state);
        bench_race(b, sides, race, 5);
        r.steady = bench_steady(b, state);
        r.ours_ms = race[0].median;
        r.bytes = (double)n * 48 + (double)F * 100;
        snprintf(r.note, sizeof r.note, "%lld vertices, %lld triangles, %s", (long long)n, (long long)F, b->scene);
        if (sides > 1) {
            r.other_ms = race[1].median;
            snprintf(r.other, sizeof r.other, "Embree 3 point query");
            const size_t at = strlen(r.note);
            snprintf(r.note + at, sizeof r.note - at, ", distances differ by %.0g m at most", worst);
        } else {
            const size_t at = strlen(r.note);
            snprintf(r.note + at, sizeof r.note - at, "; Embree 3 (libembree-dev) is not installed");
        }
        bench_add(b, &r);
        for (int c = 0; c < 3; c++) {
            hg_body_refit_destroy(side[c].refit);
            for (int f = 0; f < FRAMES; f++) {
                hg_tensor_destroy(side[c].bodies[f]);
                hg_tensor_destroy(side[c].places[f]);
            }
            hg_tensor_destroy(side[c].triangles);
            hg_tensor_destroy(side[c].contacts);
            hg_tensor_destroy(side[c].normals);
            hg_free(side[c].triangle);
            hg_free(side[c].contact);
            hg_free(side[c].normal);
        }
#ifdef BENCH_EMBREE
        bench_embree_destroy(side[2].embree);
        hg_free(side[2].distance);
#endif
    }
    hg_body_tree_destroy(tree);
    hg_poser_destroy(poser);
    hg_free(rest);
    hg_free(vertices);
    hg_free(points);
    hg_free(strands);
    hg_free(rotation);
    hg_free(position);
}
