/* Tests of the procedural scene: a closed bust, hair that grows on its scalp and stays out of it, motions that start and end
 * at rest and move as fast as people do. */
#include "geometry/vector.h"
#include "scene/scene.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define OK(call)                                                                                                       \
    do {                                                                                                               \
        hg_status ok_ = (call);                                                                                        \
        if (ok_ != HG_OK) fail_msg("%s: %s", #call, hg_message());                                                     \
    } while (0)

#define FAILS(call, text)                                                                                              \
    do {                                                                                                               \
        assert_int_not_equal((call), HG_OK);                                                                           \
        if (!strstr(hg_message(), text)) fail_msg("%s: \"%s\" is not in \"%s\"", #call, text, hg_message());           \
    } while (0)

static hg_ctx *ctx;
static hg_body *bust;

static int set_up(void **state)
{
    (void)state;
    return hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .seed = 1 }) != HG_OK || hg_bust_create(&bust) != HG_OK;
}

static int tear_down(void **state)
{
    (void)state;
    hg_body_destroy(bust);
    hg_ctx_destroy(ctx);
    return 0;
}

static hg_vec3d point(const float *p) { return hg_vec3d_make((double)p[0], (double)p[1], (double)p[2]); }

/* ---- the bust ----------------------------------------------------------------------------------------------- */

static int compare_edges(const void *a, const void *b)
{
    const int32_t *x = a, *y = b;
    return x[0] != y[0] ? (x[0] > y[0]) - (x[0] < y[0]) : (x[1] > y[1]) - (x[1] < y[1]);
}

static double volume(const hg_body *b, const float *points)
{
    double sum = 0;
    for (int64_t f = 0; f < b->faces; f++) {
        hg_vec3d p[3];
        for (int c = 0; c < 3; c++) p[c] = point(points + 3 * (int64_t)b->triangles[3 * f + c]);
        sum += hg_vec3d_dot(p[0], hg_vec3d_cross(p[1], p[2])) / 6;
    }
    return sum;
}

/* Every edge is used once in each direction: closed, manifold, turned the same way; and outwards. */
static void test_the_bust_is_closed(void **state)
{
    (void)state;
    assert_in_range(bust->faces, 3000, 12000);
    int64_t edges = 3 * bust->faces;
    int32_t(*edge)[2] = hg_alloc((size_t)edges, sizeof *edge);
    assert_non_null(edge);
    for (int64_t i = 0; i < edges; i++) {
        edge[i][0] = bust->triangles[i], edge[i][1] = bust->triangles[i % 3 == 2 ? i - 2 : i + 1];
        assert_int_not_equal(edge[i][0], edge[i][1]);
    }
    qsort(edge, (size_t)edges, sizeof *edge, compare_edges);
    for (int64_t i = 0; i < edges; i++) {
        if (i > 0) assert_int_not_equal(compare_edges(edge[i - 1], edge[i]), 0);
        assert_non_null(
            bsearch((int32_t[]){ edge[i][1], edge[i][0] }, edge, (size_t)edges, sizeof *edge, compare_edges));
    }
    hg_free(edge);
    assert_int_equal(bust->vertices - edges / 2 + bust->faces, 2); /* one piece without a hole */
    assert_true(volume(bust, bust->points) > 0.01 && volume(bust, bust->points) < 0.03);

    float low = 9, high = -9, left = 0, right = 0;
    for (int64_t v = 0; v < bust->vertices; v++) {
        const float *p = bust->points + 3 * v;
        low = fminf(low, p[1]), high = fmaxf(high, p[1]), right = fminf(right, p[0]), left = fmaxf(left, p[0]);
    }
    assert_true(fabsf(high - 0.842f) < 0.003f && low > 0.3f); /* the crown is where people have it */
    assert_true(fabsf(left + right) < 1e-4f);                 /* and both sides are the same */
}

static void test_the_rig_of_the_bust(void **state)
{
    (void)state;
    const char *const names[] = { "Hips",  "LowerBack", "Spine1",       "Neck",
                                  "Neck1", "Head",      "LeftShoulder", "RightShoulder" };
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) assert_true(hg_body_joint(bust, names[i]) >= 0);
    assert_int_equal(hg_body_joint(bust, "Tail"), -1);
    int32_t head = hg_body_joint(bust, "Head");
    /* where the head's weight is: all of it at the crown, chin and nose, none at the shoulders */
    for (int64_t v = 0; v < bust->vertices; v++) {
        const float *p = bust->points + 3 * v;
        float w = 0;
        for (int k = 0; k < HG_INFLUENCES; k++)
            if (bust->influence[HG_INFLUENCES * v + k] == head) w += bust->weight[HG_INFLUENCES * v + k];
        if (p[1] > 0.76f || p[2] > 0.11f) assert_true(w > 0.97f || p[1] < 0.62f);
        if (fabsf(p[0]) > 0.1f) assert_true(w < 0.03f);
    }
    /* weights change little from neighbour to neighbour */
    for (int64_t i = 0; i < 3 * bust->faces; i++) {
        int64_t a = bust->triangles[i], b = bust->triangles[i % 3 == 2 ? i - 2 : i + 1];
        double w[16] = { 0 }, most = 0;
        for (int k = 0; k < HG_INFLUENCES; k++) {
            w[bust->influence[HG_INFLUENCES * a + k]] += (double)bust->weight[HG_INFLUENCES * a + k];
            w[bust->influence[HG_INFLUENCES * b + k]] -= (double)bust->weight[HG_INFLUENCES * b + k];
        }
        for (int j = 0; j < 16; j++) most = fmax(most, fabs(w[j]));
        assert_true(most < 0.45);
    }
    /* every shape moves something, not too far, and keeps the surface the right way out */
    for (int k = 0; k < HG_SHAPES; k++) {
        double shape[HG_SHAPES] = { 0 }, most = 0;
        shape[k] = 1;
        hg_poser *poser;
        float *x = hg_alloc((size_t)bust->vertices, 3 * sizeof *x);
        OK(hg_poser_create(&poser, bust, false));
        OK(hg_pose(ctx, poser, shape, NULL, 0, x, NULL, NULL));
        for (int64_t v = 0; v < bust->vertices; v++)
            most = fmax(most, hg_vec3d_distance(point(x + 3 * v), point(bust->points + 3 * v)));
        assert_true(most > 0.004 && most < 0.04);
        assert_true(volume(bust, x) > 0.01);
        hg_poser_destroy(poser);
        hg_free(x);
    }
}

/* The projection has no fold and no seam: every scalp face keeps its orientation, inside [0,1]^2. */
static void test_the_scalp_projects_without_seam(void **state)
{
    (void)state;
    assert_in_range(bust->scalp_faces, 300, 4000);
    for (int64_t i = 0; i < bust->scalp_faces; i++) {
        float uv[3][2];
        for (int c = 0; c < 3; c++) {
            hg_scalp_project(bust, bust->points + 3 * (int64_t)bust->triangles[3 * (int64_t)bust->scalp[i] + c], uv[c]);
            for (int k = 0; k < 2; k++) assert_true(uv[c][k] > 0 && uv[c][k] < 1);
        }
        float area = (uv[1][0] - uv[0][0]) * (uv[2][1] - uv[0][1]) - (uv[2][0] - uv[0][0]) * (uv[1][1] - uv[0][1]);
        assert_true(area > 0 && area < 0.01f);
    }
    hg_body round = { .scalp_axis = { 0, 0.6, -0.8 } };
    float uv[2];
    hg_scalp_project(&round, (float[3]){ 0, 0, 0 }, uv); /* the centre has no direction */
    assert_true(uv[0] == 0.5f && uv[1] == 0.5f);
    hg_scalp_project(&round, (float[3]){ 0, 0.3f, -0.4f }, uv); /* on the axis */
    assert_true(fabsf(uv[0] - 0.5f) < 1e-4f && fabsf(uv[1] - 0.5f) < 1e-4f);
    hg_scalp_project(&round, (float[3]){ 0.1f, 0, 0 }, uv); /* 90 degrees off: 0.5 sin 45 / sin 60 to the left */
    assert_true(fabsf(uv[0] - 0.908248f) < 1e-4f && fabsf(uv[1] - 0.5f) < 1e-4f);
    hg_scalp_project(&round, (float[3]){ 0, -0.8f, -0.6f }, uv); /* and to the back */
    assert_true(fabsf(uv[0] - 0.5f) < 1e-4f && fabsf(uv[1] - 0.908248f) < 1e-4f);
    hg_scalp_project(&round, (float[3]){ 0.01f, -0.6f, 0.8f }, uv); /* beyond the edge */
    assert_true(uv[0] == 1 && uv[1] > 0.49f && uv[1] < 0.51f);
}

/* ---- grooms ------------------------------------------------------------------------------------------------- */

static void check_roots(const hg_groom *groom)
{
    bool *scalp = hg_alloc((size_t)bust->faces, sizeof *scalp);
    for (int64_t i = 0; i < bust->scalp_faces; i++) scalp[bust->scalp[i]] = true;
    for (int64_t s = 0; s < groom->strands; s++) {
        assert_in_range(groom->root_face[s], 0, bust->faces - 1);
        assert_true(scalp[groom->root_face[s]]);
        hg_vec3d on = { 0 }, root = point(groom->points + 3 * groom->vertices * s);
        const float *w = groom->root_bary + 3 * s;
        for (int c = 0; c < 3; c++) {
            int64_t v = bust->triangles[3 * (int64_t)groom->root_face[s] + c];
            assert_true(w[c] >= -1e-6f);
            on = hg_vec3d_add_scaled(on, (double)w[c], point(bust->points + 3 * v));
        }
        assert_true(fabsf(w[0] + w[1] + w[2] - 1) < 1e-5f);
        assert_true(hg_vec3d_distance(on, root) < 1e-5);
        float uv[2];
        hg_scalp_project(bust, groom->points + 3 * groom->vertices * s, uv);
        assert_true(fabsf(uv[0] - groom->root_uv[2 * s]) < 1e-5f && fabsf(uv[1] - groom->root_uv[2 * s + 1]) < 1e-5f);
    }
    hg_free(scalp);
}

static void check_outside(const hg_groom *groom)
{
    int64_t n = groom->strands * groom->vertices;
    double *rest = hg_alloc((size_t)bust->vertices, 3 * sizeof *rest);
    int32_t *triangle = hg_alloc((size_t)n, sizeof *triangle);
    float *at = hg_alloc((size_t)n, 3 * sizeof *at), *normal = hg_alloc((size_t)n, 3 * sizeof *normal);
    hg_body_tree *tree;
    hg_body_refit *refit;
    for (int64_t i = 0; i < 3 * bust->vertices; i++) rest[i] = (double)bust->points[i];
    OK(hg_body_tree_create(&tree, bust->vertices, rest, bust->faces, bust->triangles));
    OK(hg_body_refit_create(&refit, tree, HG_F32));
    OK(hg_body_refit_update(ctx, refit, bust->points));
    for (int64_t i = 0; i < n; i++) triangle[i] = -1;
    OK(hg_body_closest(ctx, refit, HG_CONTACT_EXACT, INFINITY, n, groom->points, triangle, at, normal));
    for (int64_t i = 0; i < n; i++) {
        hg_vec3d d = hg_vec3d_sub(point(groom->points + 3 * i), point(at + 3 * i));
        double distance = hg_vec3d_dot(d, point(normal + 3 * i));
        if (distance < -0.0005)
            fail_msg("%s: strand %d is %g m inside", groom->name, (int)(i / groom->vertices), -distance);
    }
    hg_body_refit_destroy(refit);
    hg_body_tree_destroy(tree);
    hg_free(rest), hg_free(triangle), hg_free(at), hg_free(normal);
}

static void test_grooms(void **state)
{
    (void)state;
    static const struct {
        const char *style;
        double shortest, longest;
    } styles[] = { { "straight", 0.15, 0.32 },
                   { "wavy", 0.17, 0.42 },
                   { "curly", 0.14, 0.46 },
                   { "short", 0.03, 0.09 },
                   { "long", 0.24, 0.50 } };
    for (int i = 0; i < 5; i++) {
        enum { S = 400, V = 25 };
        hg_groom *groom;
        OK(hg_groom_grow(ctx, &groom, bust, styles[i].style, S, V, 11));
        assert_int_equal(groom->strands, S);
        assert_int_equal(groom->vertices, V);
        assert_true(groom->body_hash == hg_body_hash(bust));
        check_roots(groom);
        check_outside(groom);
        int uneven = 0;
        for (int s = 0; s < S; s++) {
            double length = 0, edge[V];
            for (int v = 1; v < V; v++) {
                const float *p = groom->points + 3 * (V * s + v);
                length += edge[v] = hg_vec3d_distance(point(p), point(p - 3));
            }
            assert_true(length > styles[i].shortest && length < styles[i].longest);
            for (int v = 1; v < V; v++) uneven += fabs(edge[v] * (V - 1) / length - 1) > 0.25;
        }
        assert_true(uneven < S * (V - 1) / 50); /* only where hair was pushed out of the body at the very end */
        hg_groom_destroy(groom);
    }
}

/* Roots keep a distance from each other: no two closer than a third of what an even grid would have. */
static void test_roots_are_even(void **state)
{
    (void)state;
    enum { S = 1500 };
    hg_groom *groom;
    OK(hg_groom_grow(ctx, &groom, bust, "short", S, 4, 2));
    double area = 0;
    for (int64_t i = 0; i < bust->scalp_faces; i++) {
        const int32_t *t = bust->triangles + 3 * (int64_t)bust->scalp[i];
        hg_vec3d a = point(bust->points + 3 * (int64_t)t[0]), b = point(bust->points + 3 * (int64_t)t[1]);
        hg_vec3d c = point(bust->points + 3 * (int64_t)t[2]);
        area += 0.5 * hg_vec3d_norm(hg_vec3d_cross(hg_vec3d_sub(b, a), hg_vec3d_sub(c, a)));
    }
    double even = sqrt(area / S), nearest_mean = 0;
    for (int s = 0; s < S; s++) {
        double nearest = 1;
        for (int k = 0; k < S; k++)
            if (k != s)
                nearest =
                    fmin(nearest, hg_vec3d_distance(point(groom->points + 12 * s), point(groom->points + 12 * k)));
        assert_true(nearest > 0.33 * even);
        nearest_mean += nearest / S;
    }
    assert_true(nearest_mean > 0.7 * even); /* 0.5 for points at random */
    hg_groom_destroy(groom);
}

static void test_grooms_repeat(void **state)
{
    (void)state;
    hg_ctx *one;
    hg_groom *a, *b, *c;
    OK(hg_ctx_create(&one, &(hg_ctx_options){ .threads = 1 }));
    OK(hg_groom_grow(ctx, &a, bust, "curly", 150, 12, 5));
    OK(hg_groom_grow(one, &b, bust, "curly", 150, 12, 5));
    OK(hg_groom_grow(one, &c, bust, "curly", 150, 12, 6));
    assert_true(hg_groom_hash(a) == hg_groom_hash(b));
    assert_true(hg_groom_hash(a) != hg_groom_hash(c));
    hg_groom_destroy(a);
    hg_groom_destroy(b);
    hg_groom_destroy(c);
    OK(hg_groom_grow(ctx, &a, bust, "straight", 1, 2, 5)); /* one strand of one edge */
    hg_groom_destroy(a);
    FAILS(hg_groom_grow(ctx, &a, bust, "straigth", 10, 8, 1), "did you mean straight?");
    FAILS(hg_groom_grow(ctx, &a, bust, "straight", 0, 8, 1), "0 strands");
    FAILS(hg_groom_grow(ctx, &a, bust, "straight", 10, 1, 1), "2 to 65536 vertices");
    hg_body bald = *bust;
    bald.scalp_faces = 0;
    FAILS(hg_groom_grow(ctx, &a, &bald, "straight", 10, 8, 1), "no scalp");
    assert_null(a);
    hg_ctx_destroy(one);
}

/* ---- motions ------------------------------------------------------------------------------------------------ */

static int compare(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* The head's turn against the world. */
static hg_quatd head_turn(const hg_motion *m, int64_t t)
{
    hg_quatd turn = hg_quatd_identity();
    int path[16], n = 0;
    for (int j = hg_body_joint(bust, "Head"); j >= 0; j = bust->parent[j]) path[n++] = j;
    while (n-- > 0)
        turn = hg_quatd_mul(turn, hg_quatd_from_f(hg_quatf_load(m->rotation + 4 * (t * m->joints + path[n]))));
    return turn;
}

static void test_motions(void **state)
{
    (void)state;
    static const struct {
        const char *kind;
        double median, low, high; /* degrees per second: the least median, the fastest between these */
    } kinds[] = { { "nod", 15, 90, 250 },  { "turn", 15, 250, 480 }, { "shake", 20, 250, 480 },
                  { "walk", 15, 60, 250 }, { "jump", 12, 60, 250 },  { "mixed", 12, 90, 480 } };
    for (int i = 0; i < 6; i++)
        for (uint64_t seed = 1; seed < 4; seed++) {
            hg_motion *m, *again, *other;
            OK(hg_motion_make(&m, bust, kinds[i].kind, 20, 30, seed));
            OK(hg_motion_make(&again, bust, kinds[i].kind, 20, 30, seed));
            OK(hg_motion_make(&other, bust, kinds[i].kind, 20, 30, seed + 9));
            int64_t n = m->frames * m->joints * 4;
            assert_int_equal(m->frames, 601);
            assert_memory_equal(m->rotation, again->rotation, (size_t)n * sizeof(float));
            assert_true(memcmp(m->rotation, other->rotation, (size_t)n * sizeof(float)) != 0);
            for (int64_t k = 0; k < n; k++) assert_true(isfinite(m->rotation[k]));
            /* at rest in the first frame and the last, and slow beside them */
            for (int64_t j = 0; j < m->joints; j++) {
                const float *first = m->rotation + 4 * j, *last = m->rotation + 4 * ((m->frames - 1) * m->joints + j);
                assert_true(first[0] == 1 && last[0] == 1);
            }
            for (int c = 0; c < 3; c++)
                assert_true(m->translation[c] == 0 && fabsf(m->translation[3 * (m->frames - 1) + c]) < 1e-9f);
            double speed[600];
            for (int64_t t = 0; t < 600; t++) {
                hg_quatd step = hg_quatd_mul(head_turn(m, t + 1), hg_quatd_conj(head_turn(m, t)));
                speed[t] = hg_vec3d_norm(hg_quatd_to_rotation_vector(hg_quatd_normalize(step))) * 30 * 180 / 3.14159265;
            }
            assert_true(speed[0] < 5 && speed[599] < 5);
            qsort(speed, 600, sizeof *speed, compare);
            if (speed[300] < kinds[i].median || speed[300] > 90 || speed[599] < kinds[i].low ||
                speed[599] > kinds[i].high)
                fail_msg("%s %d: median %g, fastest %g degrees/s", kinds[i].kind, (int)seed, speed[300], speed[599]);
            hg_motion_destroy(m);
            hg_motion_destroy(again);
            hg_motion_destroy(other);
        }
}

/* In the air only gravity acts: the second difference of the height is -g dt^2 in every frame off the ground. */
static void test_a_jump_falls_as_it_should(void **state)
{
    (void)state;
    hg_motion *m;
    OK(hg_motion_make(&m, bust, "jump", 12, 240, 1));
    int flying = 0;
    double highest = 0;
    for (int64_t t = 480; t + 480 < m->frames; t++) {
        double a = (double)m->translation[3 * t - 2], b = (double)m->translation[3 * t + 1],
               c = (double)m->translation[3 * t + 4];
        if (!(a > 0.01 && b > 0.01 && c > 0.01)) continue;
        assert_true(fabs((a - 2 * b + c) * 240 * 240 + 9.81) < 0.05);
        flying++, highest = fmax(highest, b);
    }
    assert_true(flying > 60 && highest > 0.1 && highest < 0.3);
    hg_motion_destroy(m);
}

static void test_short_motions_and_other_bodies(void **state)
{
    (void)state;
    hg_motion *m;
    OK(hg_motion_make(&m, bust, "mixed", 0, 30, 1));
    assert_int_equal(m->frames, 1);
    hg_motion_destroy(m);
    OK(hg_motion_make(&m, bust, "shake", 0.1, 30, 1));
    for (int64_t i = 0; i < m->frames * m->joints * 4; i++) assert_true(isfinite(m->rotation[i]));
    hg_motion_destroy(m);
    hg_body stiff = *bust;
    char *names[11];
    for (int j = 0; j < 11; j++) names[j] = j == 0 ? "Hips" : "Bone";
    stiff.joint_name = names;
    FAILS(hg_motion_make(&m, &stiff, "nod", 1, 30, 1), "none of the joints");
}

/* Mirrored twice is the motion itself; mirrored once, the left arm does what the right one did, seen in a mirror. With a
 * motion that rests on top nothing changes, with a turn of the head on top the head's local rotation is the product. */
static void test_mirrored_and_combined(void **state)
{
    (void)state;
    hg_motion *m, *once, *twice, *rest, *sum;
    OK(hg_motion_make(&m, bust, "mixed", 2, 30, 5));
    const int64_t J = m->joints, T = m->frames, n = T * J * 4;
    const int left = hg_body_joint(bust, "LeftArm"), right = hg_body_joint(bust, "RightArm"),
              head = hg_body_joint(bust, "Head");
    assert_true(left >= 0 && right >= 0 && head >= 0);
    float *arm = m->rotation + 4 * (10 * J + right);
    arm[0] = 0.5f, arm[1] = 0.5f, arm[2] = -0.5f, arm[3] = 0.5f;
    m->translation[3 * 10] = 0.25f;
    OK(hg_motion_mirror(&once, m));
    OK(hg_motion_mirror(&twice, once));
    const float *seen = once->rotation + 4 * (10 * J + left);
    assert_true(seen[0] == 0.5f && seen[1] == 0.5f && seen[2] == 0.5f && seen[3] == -0.5f);
    assert_true(once->translation[3 * 10] == -0.25f);
    assert_memory_equal(twice->rotation, m->rotation, (size_t)n * sizeof *m->rotation);

    OK(hg_motion_create(&rest, 1, bust, 30)); /* shorter: its last frame stays */
    OK(hg_motion_combine(&sum, m, rest));
    for (int64_t i = 0; i < n; i++) assert_true(fabsf(sum->rotation[i] - m->rotation[i]) < 1e-6f);
    hg_motion_destroy(sum);
    OK(hg_motion_combine(&sum, m, once));
    const hg_quatf expected = hg_quatf_mul(hg_quatf_load(m->rotation + 4 * (20 * J + head)),
                                           hg_quatf_load(once->rotation + 4 * (20 * J + head)));
    const float *got = sum->rotation + 4 * (20 * J + head);
    assert_true(fabsf(got[0] - expected.w) < 1e-5f && fabsf(got[1] - expected.x) < 1e-5f);
    assert_true(fabsf(got[2] - expected.y) < 1e-5f && fabsf(got[3] - expected.z) < 1e-5f);
    rest->joints--;
    hg_motion *none = NULL;
    FAILS(hg_motion_combine(&none, m, rest), "cannot be combined");
    rest->joints++;
    hg_motion_destroy(m), hg_motion_destroy(once), hg_motion_destroy(twice), hg_motion_destroy(rest),
        hg_motion_destroy(sum);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_the_bust_is_closed),
        cmocka_unit_test(test_the_rig_of_the_bust),
        cmocka_unit_test(test_the_scalp_projects_without_seam),
        cmocka_unit_test(test_grooms),
        cmocka_unit_test(test_roots_are_even),
        cmocka_unit_test(test_grooms_repeat),
        cmocka_unit_test(test_motions),
        cmocka_unit_test(test_a_jump_falls_as_it_should),
        cmocka_unit_test(test_short_motions_and_other_bodies),
        cmocka_unit_test(test_mirrored_and_combined),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
