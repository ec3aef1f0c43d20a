/* Vectors, body tree, neighbours, pairs and clusters, each against plain loops or an identity that must hold. */
#include "geometry/geometry.h"
#include "geometry/vector.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

enum { SEED = 7 };

static double uniform(uint64_t stream, uint64_t i) { return hg_random_uniform(SEED, stream, i); }
static double between(uint64_t stream, uint64_t i, double lo, double hi) { return lo + (hi - lo) * uniform(stream, i); }

static hg_ctx *make_ctx(int threads)
{
    hg_ctx *ctx = NULL;
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = threads, .seed = 1 }), HG_OK);
    return ctx;
}

/* ---- vectors ---- */

static void assert_vec(hg_vec3d a, hg_vec3d b, double tolerance)
{
    if (hg_vec3d_distance(a, b) > tolerance) fail_msg("(%g %g %g) is not (%g %g %g)", a.x, a.y, a.z, b.x, b.y, b.z);
}

static hg_quatd random_rotation(uint64_t i)
{
    return hg_quatd_normalize(hg_quatd_make(between(90, 4 * i, -1, 1), between(90, 4 * i + 1, -1, 1),
                                            between(90, 4 * i + 2, -1, 1), between(90, 4 * i + 3, -1, 1)));
}

static hg_vec3d random_vec(uint64_t i)
{
    return hg_vec3d_make(between(91, 3 * i, -1, 1), between(91, 3 * i + 1, -1, 1), between(91, 3 * i + 2, -1, 1));
}

static void test_rotations(void **state)
{
    (void)state;
    for (uint64_t i = 0; i < 200; i++) {
        hg_quatd p = random_rotation(2 * i), q = random_rotation(2 * i + 1);
        hg_vec3d v = random_vec(i);
        assert_vec(hg_quatd_rotate(hg_quatd_mul(p, q), v), hg_quatd_rotate(p, hg_quatd_rotate(q, v)), 1e-14);
        assert_vec(hg_quatd_rotate(hg_quatd_conj(p), hg_quatd_rotate(p, v)), v, 1e-14);

        double m[9];
        hg_quatd_to_matrix(p, m);
        assert_vec(hg_vec3d_make(m[0] * v.x + m[1] * v.y + m[2] * v.z, m[3] * v.x + m[4] * v.y + m[5] * v.z,
                                 m[6] * v.x + m[7] * v.y + m[8] * v.z),
                   hg_quatd_rotate(p, v), 1e-14);
        assert_true(fabs(hg_quatd_dot(hg_quatd_from_matrix(m), p)) > 1.0 - 1e-14);

        hg_vec3d turn = hg_quatd_to_rotation_vector(p);
        assert_true(hg_vec3d_norm(turn) <= 3.14159265358979323846 + 1e-12);
        assert_true(fabs(hg_quatd_dot(hg_quatd_from_rotation_vector(turn), p)) > 1.0 - 1e-14);
        double angle;
        hg_vec3d axis = hg_quatd_to_axis_angle(p, &angle);
        assert_true(fabs(hg_quatd_dot(hg_quatd_from_axis_angle(axis, angle), p)) > 1.0 - 1e-14);
        assert_vec(hg_quatd_rotate(p, axis), axis, 1e-14);

        /* slerp: ends, the short way, constant speed */
        assert_true(fabs(hg_quatd_dot(hg_quatd_slerp(p, q, 0.0), p)) > 1.0 - 1e-14);
        assert_true(fabs(hg_quatd_dot(hg_quatd_slerp(p, q, 1.0), q)) > 1.0 - 1e-14);
        hg_quatd half = hg_quatd_slerp(p, q, 0.5);
        assert_true(fabs(hg_quatd_dot(half, p)) > 0.7071 - 1e-4);
        assert_true(fabs(fabs(hg_quatd_dot(half, p)) - fabs(hg_quatd_dot(half, q))) < 1e-14);
        assert_true(fabs(hg_quatd_dot(hg_quatd_slerp(p, hg_quatd_neg(q), 0.3), hg_quatd_slerp(p, q, 0.3))) >
                    1.0 - 1e-14);

        hg_vec3d a = hg_vec3d_normalize(random_vec(1000 + i)), b = hg_vec3d_normalize(random_vec(2000 + i));
        assert_vec(hg_quatd_rotate(hg_quatd_transport(a, b), a), b, 1e-13);
        assert_vec(hg_quatd_rotate(hg_quatd_between(a, b), a), b, 1e-13);
        assert_vec(hg_quatd_rotate(hg_quatd_between(a, hg_vec3d_neg(a)), a), hg_vec3d_neg(a), 1e-13);
        assert_true(fabs(hg_vec3d_dot(hg_vec3d_perpendicular(a), a)) < 1e-15);
    }
    /* float is the same text */
    hg_quatf f = hg_quatf_from_rotation_vector(hg_vec3f_make(0.3f, -0.2f, 0.9f));
    hg_quatd d = hg_quatd_from_rotation_vector(hg_vec3d_make(0.3, -0.2, 0.9));
    assert_vec(hg_vec3d_from_f(hg_quatf_rotate(f, hg_vec3f_make(1, 2, 3))), hg_quatd_rotate(d, hg_vec3d_make(1, 2, 3)),
               1e-6);
}

static void test_degenerate_vectors(void **state)
{
    (void)state;
    hg_vec3d zero = { 0, 0, 0 }, x = { 1, 0, 0 }, minus = { -1, 0, 0 };
    assert_vec(hg_vec3d_normalize(zero), zero, 0.0);
    assert_true(hg_quatd_normalize(hg_quatd_make(0, 0, 0, 0)).w == 1.0);
    assert_vec(hg_quatd_to_rotation_vector(hg_quatd_identity()), zero, 0.0);
    /* The guarded transport is finite and zero at antiparallel, exact 0.0101 rad before. */
    hg_quatd q = hg_quatd_transport(x, minus);
    assert_true(hg_quatd_norm(q) == 0.0);
    double angle = 3.14159265358979323846 - 0.0101;
    hg_vec3d near = { cos(angle), sin(angle), 0 };
    assert_vec(hg_quatd_rotate(hg_quatd_transport(x, near), x), near, 1e-12);
    assert_vec(hg_quatd_rotate(hg_quatd_from_rotation_vector(hg_vec3d_make(1e-9, 0, 0)), hg_vec3d_make(0, 1, 0)),
               hg_vec3d_make(0, 1, 1e-9), 1e-15);
}

/* ---- bodies ---- */

typedef struct {
    int64_t n_vertices, n_faces;
    double *vertices;
    int32_t *faces;
} mesh;

static void mesh_free(mesh *m)
{
    free(m->vertices);
    free(m->faces);
}

/* A closed sphere with bumps: rings of `around` vertices between two poles. */
static mesh bumpy_sphere(int rings, int around, double bump)
{
    mesh m = { 2 + (int64_t)rings * around, 2 * (int64_t)rings * around, NULL, NULL };
    m.vertices = calloc((size_t)m.n_vertices * 3, sizeof(double));
    m.faces = calloc((size_t)m.n_faces * 3, sizeof(int32_t));
    assert_non_null(m.vertices);
    assert_non_null(m.faces);
    const double pi = 3.14159265358979323846;
    for (int64_t v = 0; v < m.n_vertices; v++) {
        double theta = v == 0 ? 0.0 : v == m.n_vertices - 1 ? pi : pi * (double)((v - 1) / around + 1) / (rings + 1);
        double phi = v == 0 || v == m.n_vertices - 1 ? 0.0 : 2.0 * pi * (double)((v - 1) % around) / around;
        double r = 0.1 * (1.0 + bump * sin(5.0 * theta) * cos(4.0 * phi) + 0.3 * bump * uniform(1, (uint64_t)v));
        m.vertices[3 * v] = r * sin(theta) * cos(phi);
        m.vertices[3 * v + 1] = r * cos(theta);
        m.vertices[3 * v + 2] = -r * sin(theta) * sin(phi);
    }
    int64_t f = 0;
    int32_t last = (int32_t)m.n_vertices - 1;
    for (int k = 0; k < around; k++) {
        int32_t next = (k + 1) % around;
        memcpy(m.faces + 3 * f++, (int32_t[]){ 0, 1 + k, 1 + next }, 12);
        for (int r = 0; r + 1 < rings; r++) {
            int32_t a = 1 + r * around + k, b = 1 + r * around + next, c = a + around, d = b + around;
            memcpy(m.faces + 3 * f++, (int32_t[]){ a, c, b }, 12);
            memcpy(m.faces + 3 * f++, (int32_t[]){ b, c, d }, 12);
        }
        memcpy(m.faces + 3 * f++, (int32_t[]){ last, 1 + (rings - 1) * around + next, 1 + (rings - 1) * around + k },
               12);
    }
    m.n_faces = f;
    return m;
}

/* Triangles anywhere, sharing nothing, some of them degenerate: zero length, zero area, slivers. */
static mesh triangle_soup(int n)
{
    mesh m = { 3 * (int64_t)n, n, calloc((size_t)n * 9, sizeof(double)), calloc((size_t)n * 3, sizeof(int32_t)) };
    assert_non_null(m.vertices);
    assert_non_null(m.faces);
    for (int f = 0; f < n; f++)
        for (int k = 0; k < 3; k++) {
            m.faces[3 * f + k] = 3 * f + k;
            for (int axis = 0; axis < 3; axis++) {
                double *x = m.vertices + 9 * f + 3 * k + axis;
                *x = between(2, (uint64_t)(3 * f + axis), -0.1, 0.1) +
                     between(3, (uint64_t)(9 * f + 3 * k + axis), -0.02, 0.02);
                if (f % 7 == 3 && k > 0) *x = m.vertices[9 * f + axis]; /* a point */
                if (f % 7 == 4 && k == 2)
                    *x = 0.3 * m.vertices[9 * f + axis] + 0.7 * m.vertices[9 * f + 3 + axis];     /* a line */
                if (f % 7 == 5 && k == 2) *x = m.vertices[9 * f + 3 + axis] + 1e-7 * (axis == 0); /* a sliver */
            }
        }
    return m;
}

/* Solid angle over 4 pi, summed: 1 inside a closed body, 0 outside (van Oosterom and Strackee 1983). */
static double winding(const mesh *m, const double *p)
{
    double sum = 0.0;
    for (int64_t f = 0; f < m->n_faces; f++) {
        hg_vec3d v[3];
        double l[3];
        for (int k = 0; k < 3; k++) {
            v[k] = hg_vec3d_sub(hg_vec3d_load(m->vertices + 3 * m->faces[3 * f + k]), hg_vec3d_load(p));
            l[k] = hg_vec3d_norm(v[k]);
        }
        sum += 2.0 * atan2(hg_vec3d_dot(v[0], hg_vec3d_cross(v[1], v[2])),
                           l[0] * l[1] * l[2] + hg_vec3d_dot(v[0], v[1]) * l[2] + hg_vec3d_dot(v[1], v[2]) * l[0] +
                               hg_vec3d_dot(v[2], v[0]) * l[1]);
    }
    return sum / (4.0 * 3.14159265358979323846);
}

/* Points all over, near the surface, and exactly on corners and edges. */
static double *query_points(const mesh *m, int64_t n, double extent)
{
    double *p = calloc((size_t)n * 3, sizeof *p);
    assert_non_null(p);
    for (int64_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) {
            uint64_t c = (uint64_t)(3 * i + k);
            const int32_t *face = m->faces + 3 * (int64_t)hg_random_below(SEED, 5, (uint64_t)i, (uint64_t)m->n_faces);
            double a = m->vertices[3 * face[0] + k], b = m->vertices[3 * face[1] + k];
            switch (i % 4) {
            case 0:
                p[c] = between(4, c, -extent, extent);
                break;
            case 1:
                p[c] = a + between(6, c, -0.004, 0.004);
                break;
            case 2:
                p[c] = a;
                break;
            default:
                p[c] = 0.5 * (a + b) + (i % 8 == 7 ? between(6, c, -0.001, 0.001) : 0.0);
                break;
            }
        }
    return p;
}

typedef struct {
    int32_t *triangle;
    double *point, *normal;
} contacts;

static contacts contacts_make(int64_t n)
{
    contacts c = { calloc((size_t)n, 4), calloc((size_t)n * 3, 8), calloc((size_t)n * 3, 8) };
    assert_non_null(c.triangle);
    assert_non_null(c.point);
    assert_non_null(c.normal);
    for (int64_t i = 0; i < n; i++) c.triangle[i] = -1;
    return c;
}

static void contacts_free(contacts *c)
{
    free(c->triangle);
    free(c->point);
    free(c->normal);
}

static double signed_distance(const contacts *c, int64_t i, const double *points)
{
    hg_vec3d from = hg_vec3d_sub(hg_vec3d_load(points + 3 * i), hg_vec3d_load(c->point + 3 * i));
    return hg_vec3d_dot(hg_vec3d_load(c->normal + 3 * i), from);
}

/* The queries in either precision; results as double. */
static void query(hg_ctx *ctx, const hg_body_tree *tree, hg_dtype dtype, const mesh *m, hg_contact_mode mode,
                  double reach, int64_t n, const double *points, contacts *out)
{
    hg_body_refit *refit = NULL;
    assert_int_equal(hg_body_refit_create(&refit, tree, dtype), HG_OK);
    if (dtype == HG_F64) {
        assert_int_equal(hg_body_refit_update(ctx, refit, m->vertices), HG_OK);
        assert_int_equal(hg_body_closest(ctx, refit, mode, reach, n, points, out->triangle, out->point, out->normal),
                         HG_OK);
    } else {
        float *v = calloc((size_t)m->n_vertices * 3, 4), *p = calloc((size_t)n * 9, 4);
        assert_non_null(v);
        assert_non_null(p);
        for (int64_t i = 0; i < 3 * m->n_vertices; i++) v[i] = (float)m->vertices[i];
        for (int64_t i = 0; i < 3 * n; i++) p[i] = (float)points[i];
        assert_int_equal(hg_body_refit_update(ctx, refit, v), HG_OK);
        assert_int_equal(hg_body_closest(ctx, refit, mode, reach, n, p, out->triangle, p + 3 * n, p + 6 * n), HG_OK);
        for (int64_t i = 0; i < 3 * n; i++) {
            out->point[i] = (double)p[3 * n + i];
            out->normal[i] = (double)p[6 * n + i];
        }
        free(v);
        free(p);
    }
    hg_body_refit_destroy(refit);
}

static void round_to_float(mesh *m)
{
    for (int64_t i = 0; i < 3 * m->n_vertices; i++) m->vertices[i] = (double)(float)m->vertices[i];
}

/* In f32 a triangle at just about the tie's limit may be in or out: the least and the largest height that may win. */
static void tied_heights(const mesh *m, const double *point, double distance, double *least, double *most)
{
    *least = *most = 0.0;
    for (int64_t f = 0; f < m->n_faces; f++) {
        int32_t triangle;
        double a[3], n[3];
        hg_body_closest_brute(m->n_vertices, m->vertices, 1, m->faces + 3 * f, HG_CONTACT_PLANE, point, &triangle, a,
                              n);
        hg_vec3d from = hg_vec3d_sub(hg_vec3d_load(point), hg_vec3d_load(a));
        double height = fabs(hg_vec3d_dot(hg_vec3d_load(n), from)), beyond = hg_vec3d_norm(from) - distance;
        if (beyond <= 0.5e-6 && height > *least) *least = height;
        if (beyond <= 2e-6 && height > *most) *most = height;
    }
}

/* The tree against the plain loop: with no guesses, with wrong ones and with right ones, all the same. */
static void check_body(hg_ctx *ctx, const hg_body_tree *tree, const mesh *m, double extent)
{
    enum { N = 600 };
    double *points = query_points(m, N, extent);
    for (int64_t i = 0; i < 3 * N; i++) points[i] = (double)(float)points[i];
    contacts got = contacts_make(N), want = contacts_make(N);
    for (int mode = HG_CONTACT_PLANE; mode <= HG_CONTACT_EXACT; mode++) {
        for (int64_t i = 0; i < N; i++)
            hg_body_closest_brute(m->n_vertices, m->vertices, m->n_faces, m->faces, (hg_contact_mode)mode,
                                  points + 3 * i, want.triangle + i, want.point + 3 * i, want.normal + 3 * i);
        for (int dtype = HG_F32; dtype <= HG_F64; dtype++)
            for (int guess = 0; guess < 3; guess++) {
                for (int64_t i = 0; i < N; i++)
                    got.triangle[i] = guess == 0   ? -1
                                      : guess == 1 ? (int32_t)hg_random_below(SEED, 8, (uint64_t)i, 1u << 20) - 99
                                                   : want.triangle[i];
                query(ctx, tree, (hg_dtype)dtype, m, (hg_contact_mode)mode, INFINITY, N, points, &got);
                for (int64_t i = 0; i < N; i++) {
                    double tolerance = dtype == HG_F64 ? 1e-12 : 2e-6;
                    hg_vec3d p = hg_vec3d_load(points + 3 * i);
                    double d_got = hg_vec3d_distance(p, hg_vec3d_load(got.point + 3 * i));
                    double d_want = hg_vec3d_distance(p, hg_vec3d_load(want.point + 3 * i));
                    if (dtype == HG_F64 && got.triangle[i] != want.triangle[i])
                        fail_msg("point %lld: triangle %d, not %d", (long long)i, got.triangle[i], want.triangle[i]);
                    if (!(fabs(d_got - d_want) <= tolerance))
                        fail_msg("point %lld: %.9g m to the closest point, not %.9g", (long long)i, d_got, d_want);
                    double height = signed_distance(&got, i, points), want_height = signed_distance(&want, i, points);
                    double least = fabs(want_height), most = least;
                    if (dtype == HG_F32 && mode == HG_CONTACT_PLANE)
                        tied_heights(m, points + 3 * i, d_want, &least, &most);
                    if (!(fabs(height) >= least - tolerance && fabs(height) <= most + tolerance))
                        fail_msg("point %lld, mode %d, dtype %d: signed distance %.9g, not %.9g (%.9g .. %.9g)",
                                 (long long)i, mode, dtype, height, want_height, least, most);
                    if (fabs(want_height) > 1e-5) assert_true((height < 0.0) == (want_height < 0.0));
                    assert_true(fabs(hg_vec3d_norm(hg_vec3d_load(got.normal + 3 * i)) - 1.0) < 1e-6);
                }
            }
    }
    contacts_free(&got);
    contacts_free(&want);
    free(points);
}

static void test_closest_and_refit(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(2);
    mesh m = bumpy_sphere(24, 30, 0.2);
    round_to_float(&m);
    hg_body_tree *tree = NULL;
    assert_int_equal(hg_body_tree_create(&tree, m.n_vertices, m.vertices, m.n_faces, m.faces), HG_OK);
    assert_int_equal(hg_body_tree_faces(tree), m.n_faces);
    check_body(ctx, tree, &m, 0.2);
    /* bent and twisted far from the rest body; the topology of the tree stays */
    for (int64_t v = 0; v < m.n_vertices; v++) {
        double *x = m.vertices + 3 * v, angle = 9.0 * x[1], c = cos(angle), s = sin(angle), x0 = x[0], z0 = x[2];
        x[0] = c * x0 + s * z0 + 0.5;
        x[2] = c * z0 - s * x0 + 4.0 * x[1] * x[1];
        x[1] *= 1.7;
    }
    round_to_float(&m);
    check_body(ctx, tree, &m, 0.7);
    hg_body_tree_destroy(tree);
    mesh_free(&m);
    hg_ctx_destroy(ctx);
}

static void test_soup(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(2);
    for (int n = 1; n <= 900; n = n < 20 ? n + 8 : n * 3) {
        mesh m = triangle_soup(n);
        hg_body_tree *tree = NULL;
        round_to_float(&m);
        assert_int_equal(hg_body_tree_create(&tree, m.n_vertices, m.vertices, m.n_faces, m.faces), HG_OK);
        enum { N = 400 };
        double *points = query_points(&m, N, 0.2);
        for (int64_t i = 0; i < 3 * N; i++) points[i] = (double)(float)points[i];
        contacts got = contacts_make(N), want = contacts_make(N);
        for (int dtype = HG_F32; dtype <= HG_F64; dtype++) {
            query(ctx, tree, (hg_dtype)dtype, &m, HG_CONTACT_EXACT, INFINITY, N, points, &got);
            for (int64_t i = 0; i < N; i++) {
                hg_body_closest_brute(m.n_vertices, m.vertices, m.n_faces, m.faces, HG_CONTACT_EXACT, points + 3 * i,
                                      want.triangle + i, want.point + 3 * i, want.normal + 3 * i);
                hg_vec3d p = hg_vec3d_load(points + 3 * i);
                double d = hg_vec3d_distance(p, hg_vec3d_load(got.point + 3 * i));
                double d_want = hg_vec3d_distance(p, hg_vec3d_load(want.point + 3 * i));
                if (!(fabs(d - d_want) <= (dtype == HG_F64 ? 1e-6 + 1e-12 : 3e-6)))
                    fail_msg("%d triangles, point %lld: %.9g m, not %.9g", n, (long long)i, d, d_want);
                assert_true(fabs(hg_vec3d_norm(hg_vec3d_load(got.normal + 3 * i)) - 1.0) < 1e-5);
            }
        }
        contacts_free(&got);
        contacts_free(&want);
        free(points);
        hg_body_tree_destroy(tree);
        mesh_free(&m);
    }
    hg_ctx_destroy(ctx);
}

static void test_sign(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(2);
    mesh m = bumpy_sphere(16, 20, 0.5); /* deep dents: concave edges and corners on both sides */
    hg_body_tree *tree = NULL;
    assert_int_equal(hg_body_tree_create(&tree, m.n_vertices, m.vertices, m.n_faces, m.faces), HG_OK);
    enum { N = 4000 };
    double *points = query_points(&m, N, 0.16);
    contacts got = contacts_make(N);
    query(ctx, tree, HG_F64, &m, HG_CONTACT_EXACT, INFINITY, N, points, &got);
    int inside = 0, outside = 0;
    for (int64_t i = 0; i < N; i++) {
        double d = signed_distance(&got, i, points);
        if (fabs(d) < 1e-7) continue;
        bool truly = winding(&m, points + 3 * i) > 0.5;
        inside += truly;
        outside += !truly;
        if ((d < 0.0) != truly)
            fail_msg("point %lld: signed distance %g, but it is %s", (long long)i, d, truly ? "inside" : "outside");
    }
    assert_true(inside > 500 && outside > 500);

    /* With a reach: deep inside is still found, far outside may be waved through. */
    /* Every other strand of 20 is a walk of small steps away from the surface and back. */
    for (int64_t i = 0; i < N; i++)
        if (i / 20 % 2 && i % 20)
            for (int k = 0; k < 3; k++)
                points[3 * i + k] = points[3 * i - 3 + k] + between(9, (uint64_t)(i / 20 * 3 + k), -0.005, 0.005);
    query(ctx, tree, HG_F64, &m, HG_CONTACT_EXACT, INFINITY, N, points, &got);
    contacts near = contacts_make(N);
    query(ctx, tree, HG_F64, &m, HG_CONTACT_EXACT, 0.01, N, points, &near);
    int skipped = 0;
    for (int64_t i = 0; i < N; i++) {
        double d = signed_distance(&got, i, points), d_near = signed_distance(&near, i, points);
        if (near.triangle[i] < 0) {
            skipped++;
            assert_true(d > 0.01);
            assert_true(fabs(d_near - 0.01) < 1e-12);
        } else {
            assert_int_equal(near.triangle[i], got.triangle[i]);
            assert_true(d_near == d);
        }
    }
    assert_true(skipped > 50);
    contacts_free(&near);
    contacts_free(&got);
    free(points);
    hg_body_tree_destroy(tree);
    mesh_free(&m);
    hg_ctx_destroy(ctx);
}

static void test_ties(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    /* A roof: two triangles that share the ridge (0,0,+-1), the left one steep. Above the ridge both are as near. */
    double vertices[] = { 0, 0, -1, 0, 0, 1, -0.2, -1, 0, 1, -0.3, 0 };
    int32_t faces[] = { 0, 2, 1, 1, 3, 0 };
    hg_body_tree *tree = NULL;
    hg_body_refit *refit = NULL;
    assert_int_equal(hg_body_tree_create(&tree, 4, vertices, 2, faces), HG_OK);
    assert_int_equal(hg_body_refit_create(&refit, tree, HG_F64), HG_OK);
    assert_int_equal(hg_body_refit_update(ctx, refit, vertices), HG_OK);
    double point[] = { 0.0, 0.5, 0.1 }, a[3], n[3];
    int32_t triangle = 0;
    assert_int_equal(hg_body_closest(ctx, refit, HG_CONTACT_PLANE, INFINITY, 1, point, &triangle, a, n), HG_OK);
    assert_int_equal(triangle,
                     1); /* height 0.5 cos(16.7 deg) above the right plane, 0.5 cos(78.7 deg) above the left */
    assert_true(fabs(n[0] * (point[0] - a[0]) + n[1] * (point[1] - a[1]) + n[2] * (point[2] - a[2]) -
                     0.5 / sqrt(1.09)) < 1e-12);
    hg_body_refit_destroy(refit);
    hg_body_tree_destroy(tree);

    /* A cone of 64 triangles around its tip: more ties than a search keeps; all heights equal to rounding. */
    enum { AROUND = 64 };
    double cone[(AROUND + 1) * 3] = { 0, 0, 0 };
    int32_t cone_faces[AROUND * 3];
    for (int k = 0; k < AROUND; k++) {
        double phi = 2.0 * 3.14159265358979323846 * k / AROUND;
        double *v = cone + 3 * (k + 1);
        v[0] = 0.1 * cos(phi);
        v[1] = -0.05 - 0.01 * (k % 5);
        v[2] = 0.1 * sin(phi);
        memcpy(cone_faces + 3 * k, (int32_t[]){ 0, 1 + (k + 1) % AROUND, 1 + k }, 12);
    }
    mesh m = { AROUND + 1, AROUND, cone, cone_faces };
    assert_int_equal(hg_body_tree_create(&tree, AROUND + 1, cone, AROUND, cone_faces), HG_OK);
    double above[] = { 0.001, 0.2, 0.0, 0.0, 0.3, 0.0 };
    contacts got = contacts_make(2);
    for (int dtype = HG_F32; dtype <= HG_F64; dtype++) {
        query(ctx, tree, (hg_dtype)dtype, &m, HG_CONTACT_PLANE, INFINITY, 2, above, &got);
        for (int i = 0; i < 2; i++) {
            int32_t want;
            double want_point[3], want_normal[3];
            hg_body_closest_brute(m.n_vertices, cone, AROUND, cone_faces, HG_CONTACT_PLANE, above + 3 * i, &want,
                                  want_point, want_normal);
            if (dtype == HG_F64) assert_int_equal(got.triangle[i], want);
            hg_vec3d from = hg_vec3d_sub(hg_vec3d_load(above + 3 * i), hg_vec3d_load(want_point));
            assert_true(fabs(signed_distance(&got, i, above) - hg_vec3d_dot(hg_vec3d_load(want_normal), from)) < 1e-6);
        }
    }
    contacts_free(&got);
    hg_body_tree_destroy(tree);
    hg_ctx_destroy(ctx);
}

static void test_degenerate_bodies(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    hg_body_tree *tree = NULL;
    double vertices[] = { 0, 0, 0, 1, 0, 0, 0, 0, 1 };
    assert_int_equal(hg_body_tree_create(&tree, 3, vertices, 0, NULL), HG_INVALID);
    assert_int_equal(hg_body_tree_create(&tree, 3, vertices, 1, (int32_t[]){ 0, 1, 3 }), HG_INVALID);
    assert_non_null(strstr(hg_message(), "triangle 0 names vertex 3"));
    double broken[] = { 0, 0, 0, NAN, 0, 0, 0, 0, 1 };
    assert_int_equal(hg_body_tree_create(&tree, 3, broken, 1, (int32_t[]){ 0, 1, 2 }), HG_NUMERIC);

    /* All corners the same: the body is a point. The triangle twice: not a manifold. Both finite. */
    int32_t faces[] = { 0, 0, 0, 0, 2, 1, 0, 2, 1 };
    mesh m = { 3, 1, vertices, faces };
    double points[] = { 0, 0, 0, 0.5, 0, 0, 0, NAN, 0, 0, INFINITY, 0, 0.2, 3.0, 0.2, 1e30, 0, 0 };
    contacts got = contacts_make(6);
    for (m.n_faces = 1; m.n_faces <= 3; m.n_faces += 2)
        for (int mode = HG_CONTACT_PLANE; mode <= HG_CONTACT_EXACT; mode++)
            for (int dtype = HG_F32; dtype <= HG_F64; dtype++) {
                assert_int_equal(hg_body_tree_create(&tree, 3, vertices, m.n_faces, faces), HG_OK);
                query(ctx, tree, (hg_dtype)dtype, &m, (hg_contact_mode)mode, INFINITY, 6, points, &got);
                for (int i = 0; i < 18; i++) assert_true(isfinite(got.point[i]) && isfinite(got.normal[i]));
                for (int i = 2; i < 4; i++) {
                    assert_int_equal(got.triangle[i], -1);
                    assert_vec(hg_vec3d_load(got.normal + 3 * i), hg_vec3d_make(0, 0, 0), 0.0);
                }
                assert_true(got.triangle[0] >= 0 && got.triangle[1] >= 0 && got.triangle[4] >= 0);
                hg_body_tree_destroy(tree);
            }

    assert_int_equal(hg_body_tree_create(&tree, 3, vertices, 1, faces), HG_OK);
    hg_body_refit *refit = NULL;
    assert_int_equal(hg_body_refit_create(&refit, tree, HG_I32), HG_INVALID);
    assert_int_equal(hg_body_refit_create(&refit, tree, HG_F64), HG_OK);
    assert_int_equal(hg_body_closest(ctx, refit, HG_CONTACT_EXACT, 1.0, 1, points, got.triangle, got.point, got.normal),
                     HG_INVALID);
    double nan_body[] = { NAN, 0, 0, 0, 0, 0, 0, 0, 0 };
    assert_int_equal(hg_body_refit_update(ctx, refit, nan_body), HG_NUMERIC);
    assert_int_equal(hg_body_refit_update(ctx, refit, vertices), HG_OK);
    assert_int_equal(hg_body_closest(ctx, refit, HG_CONTACT_EXACT, 1.0, 0, points, got.triangle, got.point, got.normal),
                     HG_OK);
    hg_body_refit_destroy(refit);
    hg_body_tree_destroy(tree);
    contacts_free(&got);
    hg_ctx_destroy(ctx);
}

static void test_threads(void **state)
{
    (void)state;
    enum { N = 3000 };
    mesh m = bumpy_sphere(24, 30, 0.2);
    hg_body_tree *tree = NULL;
    assert_int_equal(hg_body_tree_create(&tree, m.n_vertices, m.vertices, m.n_faces, m.faces), HG_OK);
    double *points = query_points(&m, N, 0.2);
    contacts c[2] = { contacts_make(N), contacts_make(N) };
    hg_neighbours *neighbours[2];
    for (int t = 0; t < 2; t++) {
        hg_ctx *ctx = make_ctx(t + 1);
        query(ctx, tree, HG_F32, &m, HG_CONTACT_EXACT, 0.02, N, points, &c[t]);
        assert_int_equal(hg_neighbours_create(&neighbours[t], 0), HG_OK);
        assert_int_equal(hg_neighbours_build(ctx, neighbours[t], HG_F64, N, points, 0.01, NULL), HG_OK);
        hg_ctx_destroy(ctx);
    }
    assert_memory_equal(c[0].triangle, c[1].triangle, N * sizeof(int32_t));
    assert_memory_equal(c[0].point, c[1].point, 3 * N * sizeof(double));
    assert_memory_equal(c[0].normal, c[1].normal, 3 * N * sizeof(double));
    const int64_t *start = hg_neighbours_start(neighbours[0]);
    assert_memory_equal(start, hg_neighbours_start(neighbours[1]), (N + 1) * sizeof *start);
    assert_memory_equal(hg_neighbours_list(neighbours[0]), hg_neighbours_list(neighbours[1]),
                        (size_t)start[N] * sizeof(int32_t));
    for (int t = 0; t < 2; t++) {
        contacts_free(&c[t]);
        hg_neighbours_destroy(neighbours[t]);
    }
    free(points);
    hg_body_tree_destroy(tree);
    mesh_free(&m);
}

/* ---- neighbours ---- */

static bool near_d(const double *p, int64_t i, int64_t j, double radius)
{
    double x = p[3 * j] - p[3 * i], y = p[3 * j + 1] - p[3 * i + 1], z = p[3 * j + 2] - p[3 * i + 2];
    return x * x + y * y + z * z <= radius * radius;
}

static bool near_f(const float *p, int64_t i, int64_t j, double radius)
{
    float x = p[3 * j] - p[3 * i], y = p[3 * j + 1] - p[3 * i + 1], z = p[3 * j + 2] - p[3 * i + 2];
    return x * x + y * y + z * z <= (float)(radius * radius);
}

static void check_neighbours(hg_ctx *ctx, hg_neighbours *neighbours, int64_t n, const double *points, double radius)
{
    float *f = calloc((size_t)n * 3 + 1, 4);
    assert_non_null(f);
    for (int64_t i = 0; i < 3 * n; i++) f[i] = (float)points[i];
    for (int dtype = HG_F32; dtype <= HG_F64; dtype++) {
        int64_t needed = -1, at = 0;
        assert_int_equal(hg_neighbours_build(ctx, neighbours, (hg_dtype)dtype, n,
                                             dtype == HG_F32 ? (const void *)f : (const void *)points, radius, &needed),
                         HG_OK);
        const int64_t *start = hg_neighbours_start(neighbours);
        const int32_t *list = hg_neighbours_list(neighbours);
        for (int64_t i = 0; i < n; i++) {
            assert_int_equal(start[i], at);
            for (int64_t j = 0; j < n; j++)
                if (j != i && (dtype == HG_F32 ? near_f(f, i, j, radius) : near_d(points, i, j, radius))) {
                    assert_true(at < needed);
                    assert_int_equal(list[at++], j);
                }
        }
        assert_int_equal(start[n], at);
        assert_int_equal(needed, at);
    }
    free(f);
}

static void test_neighbours(void **state)
{
    (void)state;
    enum { N = 1500 };
    hg_ctx *ctx = make_ctx(2);
    hg_neighbours *neighbours = NULL;
    assert_int_equal(hg_neighbours_create(&neighbours, 0), HG_OK);
    double *points = calloc(3 * N, sizeof *points);
    assert_non_null(points);
    for (int64_t i = 0; i < 3 * N; i++) points[i] = between(20, (uint64_t)i, -0.05, 0.05);
    check_neighbours(ctx, neighbours, N, points, 0.01);
    check_neighbours(ctx, neighbours, N, points, 1.0);  /* everyone is a neighbour: one cell */
    check_neighbours(ctx, neighbours, N, points, 1e-7); /* nobody is: far fewer cells than radius-wide ones */
    check_neighbours(ctx, neighbours, 1, points, 0.01);
    check_neighbours(ctx, neighbours, 0, points, 0.01);
    for (int64_t i = 0; i < 300; i++) points[i] = 0.01 * (double)(i % 4); /* coincident, and exactly one radius apart */
    check_neighbours(ctx, neighbours, N, points, 0.01);
    points[6] = 1e9; /* ran away */
    points[10] = -1e12;
    check_neighbours(ctx, neighbours, N, points, 0.01);
    points[31] = NAN; /* has no neighbours */
    points[35] = INFINITY;
    check_neighbours(ctx, neighbours, N, points, 0.01);
    assert_int_equal(hg_neighbours_build(ctx, neighbours, HG_F64, N, points, 0.0, NULL), HG_INVALID);
    hg_neighbours_destroy(neighbours);
    free(points);
    hg_ctx_destroy(ctx);
}

static void test_neighbour_overflow(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    hg_neighbours *neighbours = NULL;
    double points[30] = { 0 };
    for (int i = 0; i < 10; i++) points[3 * i] = 0.001 * i;
    assert_int_equal(hg_neighbours_create(&neighbours, -1), HG_INVALID);
    assert_int_equal(hg_neighbours_create(&neighbours, 89), HG_OK);
    int64_t needed = 0;
    assert_int_equal(hg_neighbours_build(ctx, neighbours, HG_F64, 10, points, 1.0, &needed), HG_INVALID);
    assert_int_equal(needed, 90);
    assert_non_null(strstr(hg_message(), "90 pairs"));
    assert_non_null(strstr(hg_message(), "room for 89"));
    assert_int_equal(hg_neighbours_start(neighbours)[10], 0); /* nothing half-built to read */
    hg_neighbours_destroy(neighbours);
    assert_int_equal(hg_neighbours_create(&neighbours, 90), HG_OK);
    assert_int_equal(hg_neighbours_build(ctx, neighbours, HG_F64, 10, points, 1.0, &needed), HG_OK);
    hg_neighbours_destroy(neighbours);
    hg_ctx_destroy(ctx);
}

/* ---- pairs ---- */

static void test_pairs(void **state)
{
    (void)state;
    enum { S = 40, V = 7, N = S * V, COUNT = 5 };
    hg_ctx *ctx = make_ctx(2);
    double points[3 * N];
    for (int i = 0; i < 3 * N; i++) points[i] = between(30, (uint64_t)i, 0.0, 0.05);
    for (int i = 0; i < 3 * V; i++) points[3 * V + i] = points[i]; /* strand 1 lies on strand 0 */
    const double radius = 0.008;
    hg_pairs *pairs = NULL;
    assert_int_equal(hg_pairs_nearest(ctx, &pairs, S, V, points, radius, COUNT), HG_OK);
    assert_int_equal(pairs->n_vertices, N);
    int64_t at = 0;
    for (int i = 0; i < N; i++) {
        bool taken[N] = { false };
        for (int k = 0; k < COUNT; k++) {
            int best = -1;
            double best_d = 0.0;
            for (int j = 0; j < N; j++) {
                double d = hg_vec3d_norm2(hg_vec3d_sub(hg_vec3d_load(points + 3 * j), hg_vec3d_load(points + 3 * i)));
                if (j / V == i / V || taken[j] || d > radius * radius || (best >= 0 && d >= best_d)) continue;
                best = j;
                best_d = d;
            }
            if (best < 0) break;
            taken[best] = true;
            assert_true(at < pairs->n_pairs);
            assert_int_equal(pairs->pairs[2 * at], i);
            assert_int_equal(pairs->pairs[2 * at + 1], best);
            at++;
        }
    }
    assert_int_equal(at, pairs->n_pairs);
    assert_true(at > N);
    /* every end of every pair once, under its vertex, ascending */
    assert_int_equal(pairs->start[0], 0);
    assert_int_equal(pairs->start[N], 2 * pairs->n_pairs);
    for (int v = 0; v < N; v++)
        for (int64_t k = pairs->start[v]; k < pairs->start[v + 1]; k++) {
            assert_int_equal(pairs->pairs[pairs->incident[k]], v);
            if (k > pairs->start[v]) assert_true(pairs->incident[k] > pairs->incident[k - 1]);
        }
    hg_pairs_destroy(pairs);

    assert_int_equal(hg_pairs_nearest(ctx, &pairs, 0, V, points, radius, COUNT), HG_OK);
    assert_int_equal(pairs->n_pairs, 0);
    hg_pairs_destroy(pairs);
    assert_int_equal(hg_pairs_nearest(ctx, &pairs, S, V, points, radius, 0), HG_OK);
    assert_int_equal(pairs->n_pairs, 0);
    hg_pairs_destroy(pairs);
    assert_int_equal(hg_pairs_nearest(ctx, &pairs, S, V, points, radius, 33), HG_INVALID);
    assert_int_equal(hg_pairs_from_list(&pairs, 3, 1, (int32_t[]){ 0, 3 }), HG_INVALID);
    assert_non_null(strstr(hg_message(), "names vertex 3"));
    hg_ctx_destroy(ctx);
}

/* ---- clusters ---- */

static void test_clusters(void **state)
{
    (void)state;
    enum { N = 5000, SIZE = 64 };
    float uv[2 * N];
    static int32_t cluster[N], again[N];
    for (int i = 0; i < N; i++) {
        uv[2 * i] = (float)uniform(40, (uint64_t)(2 * i));
        uv[2 * i + 1] = (float)(uniform(40, (uint64_t)(2 * i + 1)) * 0.6);
    }
    int32_t count = 0, count_again = 0;
    assert_int_equal(hg_clusters(N, uv, SIZE, cluster, &count), HG_OK);
    assert_int_equal(hg_clusters(N, uv, SIZE, again, &count_again), HG_OK);
    assert_int_equal(count, count_again);
    assert_memory_equal(cluster, again, sizeof cluster);
    assert_int_equal(count, 78);
    int members[128] = { 0 };
    double centre[128][2] = { { 0 } }, spread = 0.0;
    for (int i = 0; i < N; i++) {
        assert_in_range(cluster[i], 0, count - 1);
        members[cluster[i]]++;
        centre[cluster[i]][0] += (double)uv[2 * i];
        centre[cluster[i]][1] += (double)uv[2 * i + 1];
    }
    for (int c = 0; c < count; c++) {
        assert_in_range(members[c], SIZE / 3, SIZE * 3);
        centre[c][0] /= members[c];
        centre[c][1] /= members[c];
    }
    for (int i = 0; i < N; i++)
        spread +=
            pow((double)uv[2 * i] - centre[cluster[i]][0], 2) + pow((double)uv[2 * i + 1] - centre[cluster[i]][1], 2);
    /* squares of this area have area / 6 of mean squared distance to their centre; round pieces little more or less */
    assert_true(spread / N < 1.1 * (0.6 / count) / 6.0);

    for (int i = 0; i < N; i++) uv[2 * i] = uv[2 * i + 1] = 0.5f; /* all roots in one place */
    assert_int_equal(hg_clusters(N, uv, SIZE, cluster, &count), HG_OK);
    for (int i = 0; i < N; i++) assert_in_range(cluster[i], 0, count - 1);
    assert_int_equal(hg_clusters(1, uv, SIZE, cluster, &count), HG_OK);
    assert_int_equal(count, 1);
    assert_int_equal(cluster[0], 0);
    assert_int_equal(hg_clusters(0, uv, SIZE, cluster, &count), HG_OK);
    assert_int_equal(count, 0);
    assert_int_equal(hg_clusters(N, uv, 0, cluster, &count), HG_INVALID);
    uv[7] = NAN;
    assert_int_equal(hg_clusters(N, uv, SIZE, cluster, &count), HG_NUMERIC);
    assert_non_null(strstr(hg_message(), "root 3"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_rotations),
        cmocka_unit_test(test_degenerate_vectors),
        cmocka_unit_test(test_closest_and_refit),
        cmocka_unit_test(test_soup),
        cmocka_unit_test(test_sign),
        cmocka_unit_test(test_ties),
        cmocka_unit_test(test_degenerate_bodies),
        cmocka_unit_test(test_threads),
        cmocka_unit_test(test_neighbours),
        cmocka_unit_test(test_neighbour_overflow),
        cmocka_unit_test(test_pairs),
        cmocka_unit_test(test_clusters),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
