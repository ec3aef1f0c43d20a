/* A small groom with everything that an energy may ask for, for tests of energies: wavy strands on a bust of two boxes,
 * turned and moved roots, a last and a predicted frame. Made from counters: the same on every machine. */
#ifndef ENERGIES_SCENE_H
#define ENERGIES_SCENE_H

#include "hairloss/hairloss.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    int64_t G, B, S, V;
    double *rest, *mass, *body_distance, *scalp_distance;           /* [G,S,V,..] */
    double *x, *predicted, *previous, *posed, *rotation, *position; /* [B,S,V,3], [B,S,4], [B,S,3] */
    double *ghost, *deformation, *q;                                /* [B,S,V,3], [B,S,V-1,4] */
    int32_t *groom;                                                 /* [B] */
    double body_rest[8 * 3], *body;                                 /* [8,3], [B,8,3] */
    hg_body_tree *tree;
    hg_groom_attribute attributes[2];
    hg_groom_data data;
} scene;

static inline double noise(uint64_t stream, int64_t i) { return 2 * hg_random_uniform(7, stream, (uint64_t)i) - 1; }

static inline double *numbers(int64_t n)
{
    double *values = hg_alloc((size_t)n + 1, sizeof *values);
    if (!values) abort();
    return values;
}

static inline void rotate_by(const double q[4], const double v[3], double out[3])
{
    const double t[3] = { 2 * (q[2] * v[2] - q[3] * v[1]), 2 * (q[3] * v[0] - q[1] * v[2]),
                          2 * (q[1] * v[1] - q[2] * v[0]) };
    out[0] = v[0] + q[0] * t[0] + q[2] * t[2] - q[3] * t[1];
    out[1] = v[1] + q[0] * t[1] + q[3] * t[0] - q[1] * t[2];
    out[2] = v[2] + q[0] * t[2] + q[1] * t[1] - q[2] * t[0];
}

static inline void make_posed(scene *s)
{
    for (int64_t i = 0; i < s->B * s->S; i++) {
        const int64_t strand = i % s->S, groom = s->groom[i / s->S];
        const double *root = s->rest + (groom * s->S + strand) * s->V * 3;
        for (int64_t v = 0; v < s->V; v++) {
            const double arm[3] = { root[3 * v] - root[0], root[3 * v + 1] - root[1], root[3 * v + 2] - root[2] };
            double turned[3];
            rotate_by(s->rotation + 4 * i, arm, turned);
            for (int c = 0; c < 3; c++) s->posed[(i * s->V + v) * 3 + c] = s->position[3 * i + c] + turned[c];
        }
    }
}

static inline void multiply(const double a[4], const double b[4], double to[4])
{
    const double product[4] = { a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
                                a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
                                a[0] * b[2] + a[2] * b[0] + a[3] * b[1] - a[1] * b[3],
                                a[0] * b[3] + a[3] * b[0] + a[1] * b[2] - a[2] * b[1] };
    memcpy(to, product, sizeof product);
}

/* The rotation that takes unit vector a to b by the shortest way. */
static inline void shortest(const double a[3], const double b[3], double to[4])
{
    const double w = 1 + a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const double v[3] = { a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0] };
    const double length = sqrt(w * w + v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    to[0] = length > 0 ? w / length : 0;
    for (int c = 0; c < 3; c++) to[1 + c] = length > 0 ? v[c] / length : 0;
}

/* The orientations of the rest edges, parallel from edge to edge and turned with the root; every second one with the other
 * sign, which is the same rotation. */
static inline void make_q(scene *s)
{
    for (int64_t i = 0; i < s->B * s->S; i++) {
        const int64_t strand = i % s->S, groom = s->groom[i / s->S];
        const double *rest = s->rest + (groom * s->S + strand) * s->V * 3;
        double frame[4] = { 1, 0, 0, 0 }, last[3] = { 0, 0, 1 };
        for (int64_t v = 0; v + 1 < s->V; v++) {
            double edge[3], turn[4], length = 0;
            for (int c = 0; c < 3; c++) {
                edge[c] = rest[3 * v + 3 + c] - rest[3 * v + c];
                length += edge[c] * edge[c];
            }
            for (int c = 0; c < 3; c++) edge[c] /= sqrt(length);
            shortest(last, edge, turn);
            multiply(turn, frame, frame);
            memcpy(last, edge, sizeof last);
            double *q = s->q + 4 * (i * (s->V - 1) + v);
            multiply(s->rotation + 4 * i, frame, q);
            for (int c = 0; v % 2 && c < 4; c++) q[c] = -q[c];
        }
    }
}

/* bend: how far x is from the posed groom, in edge lengths */
static inline void scene_make(scene *s, int64_t G, int64_t B, int64_t S, int64_t V, double bend)
{
    static const int32_t faces[36] = { 0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4,
                                       2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5 };
    const double edge = 4e-3;
    *s = (scene){ .G = G, .B = B, .S = S, .V = V };
    s->rest = numbers(G * S * V * 3);
    s->mass = numbers(G * S * V);
    s->body_distance = numbers(G * S * V);
    s->scalp_distance = numbers(G * S * V);
    s->x = numbers(B * S * V * 3);
    s->predicted = numbers(B * S * V * 3);
    s->previous = numbers(B * S * V * 3);
    s->posed = numbers(B * S * V * 3);
    s->ghost = numbers(B * S * V * 3);
    s->deformation = numbers(B * S * V * 3);
    s->q = numbers(B * S * V * 4);
    s->rotation = numbers(B * S * 4);
    s->position = numbers(B * S * 3);
    s->body = numbers(B * 24);
    s->groom = hg_alloc((size_t)B + 1, sizeof *s->groom);
    for (int64_t i = 0; i < G * S; i++) {
        double at[3] = { 0.03 * noise(1, 3 * i), 0.002 + 0.002 * (1 + noise(1, 3 * i + 1)),
                         0.03 * noise(1, 3 * i + 2) };
        const double phase = 3 * noise(2, i), lean = 0.5 * noise(3, i);
        for (int64_t v = 0; v < V; v++) {
            const int64_t k = i * V + v;
            const double angle = 0.6 * (double)v + phase;
            for (int c = 0; c < 3; c++) s->rest[3 * k + c] = at[c];
            at[0] += edge * (0.5 * cos(angle) + lean) * (1 + 0.2 * noise(4, k));
            at[1] += edge * (0.7 + 0.1 * noise(5, k));
            at[2] += edge * 0.5 * sin(angle);
            s->mass[k] = 2.6e-8 * (1 + 0.3 * noise(6, k));
            s->body_distance[k] = s->rest[3 * k + 1];
            s->scalp_distance[k] = 1.1 * s->rest[3 * k + 1];
        }
    }
    for (int64_t b = 0; b < B; b++) s->groom[b] = (int32_t)(b % G);
    for (int64_t i = 0; i < B * S; i++) {
        double q[4] = { 1, 0.2 * noise(8, 3 * i), 0.2 * noise(8, 3 * i + 1), 0.2 * noise(8, 3 * i + 2) };
        const double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
        for (int c = 0; c < 4; c++) s->rotation[4 * i + c] = q[c] / length;
        const double *root = s->rest + ((s->groom[i / S] * S) + i % S) * V * 3;
        for (int c = 0; c < 3; c++) s->position[3 * i + c] = root[c] + (c == 1 ? 0 : 0.01) * noise(9, 3 * i + c);
    }
    make_posed(s);
    for (int64_t i = 0; i < B * S * V * 3; i++) {
        s->x[i] = s->posed[i] + bend * edge * noise(10, i);
        s->previous[i] = s->posed[i] + 0.3 * edge * noise(11, i);
        s->predicted[i] = s->posed[i] + 0.3 * edge * noise(12, i);
        s->ghost[i] = s->posed[i] + (bend > 0 ? 3 * edge * noise(13, i) : 0);
        s->deformation[i] = edge * noise(14, i);
    }
    make_q(s);
    for (int64_t i = 0; bend > 0 && i < B * S * (V - 1) * 4; i++) s->q[i] += 0.3 * noise(15, i);
    for (int i = 0; i < 8; i++) { /* a box whose upper face is y = 0 */
        const double corner[3] = { i & 1 ? 0.1 : -0.1, i & 2 ? 0 : -0.1, i & 4 ? 0.1 : -0.1 };
        for (int c = 0; c < 3; c++) {
            s->body_rest[3 * i + c] = corner[c];
            for (int64_t b = 0; b < B; b++) s->body[24 * b + 3 * i + c] = corner[c];
        }
    }
    if (hg_body_tree_create(&s->tree, 8, s->body_rest, 12, faces) != HG_OK) abort();
    s->attributes[0] = (hg_groom_attribute){ "body_distance", s->body_distance };
    s->attributes[1] = (hg_groom_attribute){ "scalp_distance", s->scalp_distance };
    s->data = (hg_groom_data){ .grooms = G,
                               .strands = S,
                               .vertices = V,
                               .rest = s->rest,
                               .mass = s->mass,
                               .attributes = s->attributes,
                               .n_attributes = 2,
                               .body = s->tree };
}

static inline void scene_free(scene *s)
{
    double *arrays[] = { s->rest,        s->mass,  s->body_distance, s->scalp_distance, s->x,    s->predicted,
                         s->previous,    s->posed, s->rotation,      s->position,       s->body, s->ghost,
                         s->deformation, s->q };
    for (size_t i = 0; i < sizeof arrays / sizeof *arrays; i++) hg_free(arrays[i]);
    hg_free(s->groom);
    hg_body_tree_destroy(s->tree);
}

static inline hg_tensor *upload(hg_ctx *ctx, hg_dtype dtype, int rank, const int64_t *shape, const double *values)
{
    hg_tensor *tensor = hg_tensor_make(ctx, dtype, rank, shape);
    const int64_t n = tensor ? hg_tensor_count(tensor) : 0;
    float *narrow = dtype == HG_F32 ? hg_alloc((size_t)n + 1, sizeof *narrow) : NULL;
    for (int64_t i = 0; narrow && i < n; i++) narrow[i] = (float)values[i];
    if (n && hg_tensor_write(tensor, narrow ? (const void *)narrow : values) != HG_OK) tensor = NULL;
    hg_free(narrow);
    return tensor;
}

static inline hg_frame scene_frame(const scene *s, hg_ctx *ctx, hg_dtype dtype)
{
    const int64_t vertices[4] = { s->B, s->S, s->V, 3 }, rotation[3] = { s->B, s->S, 4 },
                  position[3] = { s->B, s->S, 3 }, body[3] = { s->B, 8, 3 };
    return (hg_frame){ .groom = s->groom,
                       .dt = 1.0 / 30,
                       .root_rotation = upload(ctx, dtype, 3, rotation, s->rotation),
                       .root_position = upload(ctx, dtype, 3, position, s->position),
                       .predicted = upload(ctx, dtype, 4, vertices, s->predicted),
                       .previous = upload(ctx, dtype, 4, vertices, s->previous),
                       .body_vertices = upload(ctx, dtype, 3, body, s->body) };
}

static inline hg_tensor *scene_x(const scene *s, hg_ctx *ctx, hg_dtype dtype)
{
    return upload(ctx, dtype, 4, (int64_t[]){ s->B, s->S, s->V, 3 }, s->x);
}

#endif
