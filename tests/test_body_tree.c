/* The closest triangle of a moving body: against plain loops over all triangles and against winding numbers. */
#include "tests/device.h"
#include "tests/geometry_random.h"

static hg_ctx *on_device(int threads)
{
    hg_ctx *ctx = NULL;
    const hg_ctx_options options = { .threads = threads, .seed = 1, .device = test_device() };
    assert_int_equal(hg_ctx_create(&ctx, &options), HG_OK);
    return ctx;
}

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

/* Numbers of the host as a tensor of the context's device in `dtype`; and back. */
static hg_tensor *sent(hg_ctx *ctx, hg_dtype dtype, int64_t n, const double *from)
{
    hg_tensor *wide = hg_tensor_create(ctx, HG_F64, 1, &n), *to = hg_tensor_create(ctx, dtype, 1, &n);
    assert_non_null(to);
    assert_int_equal(hg_tensor_write(wide, from), HG_OK);
    assert_int_equal(hg_tensor_copy(to, wide), HG_OK);
    hg_tensor_destroy(wide);
    return to;
}

static void fetched(hg_ctx *ctx, hg_tensor *from, double *to)
{
    const int64_t n = hg_tensor_count(from);
    hg_tensor *wide = hg_tensor_create(ctx, HG_F64, 1, &n);
    assert_int_equal(hg_tensor_copy(wide, from), HG_OK);
    assert_int_equal(hg_tensor_read(wide, to), HG_OK);
    hg_tensor_destroy(wide);
    hg_tensor_destroy(from);
}

/* The queries of n points of each frame in either precision on the context's device; results as double. */
static void query_frames(hg_ctx *ctx, const hg_body_tree *tree, hg_dtype dtype, int64_t frames, const double *vertices,
                         hg_contact_mode mode, double reach, int64_t n, const double *points, contacts *out)
{
    const int64_t all = frames * n;
    hg_body_refit *refit = NULL;
    hg_tensor *v = sent(ctx, dtype, frames * 3 * hg_body_tree_vertices(tree), vertices);
    hg_tensor *p = sent(ctx, dtype, 3 * all, points), *triangle = hg_tensor_create(ctx, HG_I32, 1, &all);
    hg_tensor *point = hg_tensor_create(ctx, dtype, 1, (int64_t[]){ 3 * all });
    hg_tensor *normal = hg_tensor_create(ctx, dtype, 1, (int64_t[]){ 3 * all });
    assert_int_equal(hg_tensor_write(triangle, out->triangle), HG_OK);
    assert_int_equal(hg_body_refit_create_frames(&refit, tree, dtype, frames + 1), HG_OK);
    assert_int_equal(hg_body_refit_update_frames(ctx, refit, frames, v->data), HG_OK);
    assert_int_equal(hg_body_closest(ctx, refit, mode, reach, n, p->data, triangle->data, point->data, normal->data),
                     HG_OK);
    assert_int_equal(hg_tensor_read(triangle, out->triangle), HG_OK);
    fetched(ctx, point, out->point);
    fetched(ctx, normal, out->normal);
    hg_tensor_destroy(v);
    hg_tensor_destroy(p);
    hg_tensor_destroy(triangle);
    hg_body_refit_destroy(refit);
}

static void query(hg_ctx *ctx, const hg_body_tree *tree, hg_dtype dtype, const mesh *m, hg_contact_mode mode,
                  double reach, int64_t n, const double *points, contacts *out)
{
    query_frames(ctx, tree, dtype, 1, m->vertices, mode, reach, n, points, out);
}

static void round_to_float(mesh *m)
{
    for (int64_t i = 0; i < 3 * m->n_vertices; i++) m->vertices[i] = (double)(float)m->vertices[i];
}

static double height_over(const double *vertices, const int32_t *face, const double *point)
{
    int32_t triangle;
    double a[3], n[3];
    hg_body_closest_brute(0, vertices, 1, face, HG_CONTACT_PLANE, point, &triangle, a, n);
    return fabs(hg_vec3d_dot(hg_vec3d_load(n), hg_vec3d_sub(hg_vec3d_load(point), hg_vec3d_load(a))));
}

/* In f64 the processor finds the very triangle. A GPU rounds a multiplication and a sum once, so that of two which tie, with the
 * same height but for rounding, it may take the other. */
static bool same_triangle(const hg_ctx *ctx, const mesh *m, const double *vertices, const double *point, int32_t got,
                          int32_t want)
{
    if (got == want) return true;
    if (hg_ctx_host(ctx) || got < 0 || want < 0) return false;
    return fabs(height_over(vertices, m->faces + 3 * (int64_t)got, point) -
                height_over(vertices, m->faces + 3 * (int64_t)want, point)) < 1e-14;
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
                    if (dtype == HG_F64 &&
                        !same_triangle(ctx, m, m->vertices, points + 3 * i, got.triangle[i], want.triangle[i]))
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

/* Points along strands that go in and out of a closed body, with a reach: what is near, or inside, is what the plain loop
 * finds; what is left out is outside and beyond the reach. */
static void test_strands_with_reach(void **state)
{
    (void)state;
    enum { STRANDS = 60, VERTICES = 25, N = STRANDS * VERTICES };
    hg_ctx *ctx = on_device(2);
    mesh m = bumpy_sphere(24, 30, 0.2);
    hg_body_tree *tree = NULL;
    assert_int_equal(hg_body_tree_create(&tree, m.n_vertices, m.vertices, m.n_faces, m.faces), HG_OK);
    double *points = calloc(3 * N, sizeof *points);
    assert_non_null(points);
    for (int64_t s = 0; s < STRANDS; s++) {
        const double *root = m.vertices + 3 * hg_random_below(SEED, 21, (uint64_t)s, (uint64_t)m.n_vertices);
        const double step = s % 3 ? 0.004 : 0.02, out = s % 4 ? 0.6 : -0.6; /* some go inwards */
        for (int v = 0; v < VERTICES; v++)
            for (int k = 0; k < 3; k++) {
                double *x = points + 3 * (s * VERTICES + v) + k;
                *x = v == 0 ? root[k]
                            : x[-3] + step * (out * root[k] / 0.2 +
                                              hg_random_normal(SEED, 22 + (uint64_t)k, (uint64_t)(s * VERTICES + v)));
            }
    }
    points[3 * 777] = (double)NAN;
    contacts got = contacts_make(N), want = contacts_make(N);
    for (int64_t i = 0; i < N; i++)
        if (i != 777)
            hg_body_closest_brute(m.n_vertices, m.vertices, m.n_faces, m.faces, HG_CONTACT_EXACT, points + 3 * i,
                                  want.triangle + i, want.point + 3 * i, want.normal + 3 * i);
    const double reaches[] = { 0.0, 0.002, 0.01, 0.05, 0.5 };
    for (size_t r = 0; r < sizeof reaches / sizeof *reaches; r++)
        for (int again = 0; again < 2; again++) { /* the second time with guesses */
            int64_t left_out = 0;
            query(ctx, tree, HG_F64, &m, HG_CONTACT_EXACT, reaches[r], N, points, &got);
            for (int64_t i = 0; i < N; i++) {
                if (i == 777) continue;
                const double distance = signed_distance(&want, i, points);
                left_out += got.triangle[i] < 0;
                if (got.triangle[i] < 0 && !(distance > reaches[r] - 1e-12))
                    fail_msg("reach %g: point %lld is at %g and was left out", reaches[r], (long long)i, distance);
                if (got.triangle[i] >= 0 &&
                    !same_triangle(ctx, &m, m.vertices, points + 3 * i, got.triangle[i], want.triangle[i]))
                    fail_msg("reach %g: point %lld: triangle %d, not %d", reaches[r], (long long)i, got.triangle[i],
                             want.triangle[i]);
                if (got.triangle[i] >= 0) assert_true(fabs(signed_distance(&got, i, points) - distance) < 1e-12);
            }
            assert_int_equal(got.triangle[777], -1);
            assert_true(reaches[r] > 0.1 ? left_out < N : left_out > N / 20);
        }
    contacts_free(&got);
    contacts_free(&want);
    free(points);
    hg_body_tree_destroy(tree);
    mesh_free(&m);
    hg_ctx_destroy(ctx);
}

static void test_closest_and_refit(void **state)
{
    (void)state;
    hg_ctx *ctx = on_device(2);
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
    hg_ctx *ctx = on_device(2);
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
    hg_ctx *ctx = on_device(2);
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
    hg_ctx *ctx = on_device(1);
    /* A roof: two triangles that share the ridge (0,0,+-1), the left one steep. Above the ridge both are as near. */
    double vertices[] = { 0, 0, -1, 0, 0, 1, -0.2, -1, 0, 1, -0.3, 0 };
    int32_t faces[] = { 0, 2, 1, 1, 3, 0 };
    hg_body_tree *tree = NULL;
    assert_int_equal(hg_body_tree_create(&tree, 4, vertices, 2, faces), HG_OK);
    const mesh roof = { 4, 2, vertices, faces };
    double point[] = { 0.0, 0.5, 0.1 };
    contacts one = contacts_make(1);
    query(ctx, tree, HG_F64, &roof, HG_CONTACT_PLANE, INFINITY, 1, point, &one);
    assert_int_equal(one.triangle[0],
                     1); /* height 0.5 cos(16.7 deg) above the right plane, 0.5 cos(78.7 deg) above the left */
    assert_true(fabs(signed_distance(&one, 0, point) - 0.5 / sqrt(1.09)) < 1e-12);
    contacts_free(&one);
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
    hg_ctx *ctx = on_device(1);
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
    const double nan_body[] = { NAN, 0, 0, 0, 0, 0, 0, 0, 0 };
    hg_tensor *body = sent(ctx, HG_F64, 9, nan_body);
    if (hg_ctx_host(
            ctx)) { /* elsewhere nothing waits for the device: contacts are not numbers, and the loss then is not */
        assert_int_equal(hg_body_refit_update(ctx, refit, body->data), HG_NUMERIC);
    } else {
        m.n_faces = 1;
        m.vertices = (double *)(uintptr_t)nan_body;
        query(ctx, tree, HG_F64, &m, HG_CONTACT_EXACT, 1.0, 2, points, &got);
        for (int i = 0; i < 6; i++) assert_true(isnan(got.point[i]) && isnan(got.normal[i]));
        assert_int_equal(got.triangle[0], -1);
    }
    assert_int_equal(hg_tensor_write(body, vertices), HG_OK);
    assert_int_equal(hg_body_refit_update(ctx, refit, body->data), HG_OK);
    assert_int_equal(hg_body_closest(ctx, refit, HG_CONTACT_EXACT, 1.0, 0, points, got.triangle, got.point, got.normal),
                     HG_OK);
    hg_tensor_destroy(body);
    hg_body_refit_destroy(refit);
    hg_body_tree_destroy(tree);
    contacts_free(&got);
    hg_ctx_destroy(ctx);
}

/* Several frames at once are what each is alone, and so are those of the processor: to the last bit where both are in f64 but for
 * what is rounded. */
static void test_frames(void **state)
{
    (void)state;
    enum { N = 500, FRAMES = 3 };
    hg_ctx *ctx = on_device(2), *host = NULL;
    assert_int_equal(hg_ctx_create(&host, &(hg_ctx_options){ .threads = 2 }), HG_OK);
    mesh m = bumpy_sphere(24, 30, 0.2);
    hg_body_tree *tree = NULL;
    assert_int_equal(hg_body_tree_create(&tree, m.n_vertices, m.vertices, m.n_faces, m.faces), HG_OK);
    double *points = query_points(&m, FRAMES * N, 0.2);
    double *vertices = calloc((size_t)(FRAMES * m.n_vertices) * 3, sizeof *vertices);
    assert_non_null(vertices);
    for (int64_t i = 0; i < FRAMES * 3 * m.n_vertices; i++)
        vertices[i] = m.vertices[i % (3 * m.n_vertices)] * (1.0 + 0.1 * (double)(i / (3 * m.n_vertices)));
    for (int dtype = HG_F32; dtype <= HG_F64; dtype++) {
        contacts together = contacts_make(FRAMES * N), alone = contacts_make(N), there = contacts_make(N);
        query_frames(ctx, tree, (hg_dtype)dtype, FRAMES, vertices, HG_CONTACT_EXACT, INFINITY, N, points, &together);
        for (int64_t b = 0; b < FRAMES; b++) {
            const double *frame = vertices + b * 3 * m.n_vertices;
            query_frames(ctx, tree, (hg_dtype)dtype, 1, frame, HG_CONTACT_EXACT, INFINITY, N, points + 3 * b * N,
                         &alone);
            query_frames(host, tree, (hg_dtype)dtype, 1, frame, HG_CONTACT_EXACT, INFINITY, N, points + 3 * b * N,
                         &there);
            assert_memory_equal(alone.triangle, together.triangle + b * N, N * sizeof(int32_t));
            assert_memory_equal(alone.point, together.point + 3 * b * N, 3 * N * sizeof(double));
            assert_memory_equal(alone.normal, together.normal + 3 * b * N, 3 * N * sizeof(double));
            for (int64_t i = 0; i < N; i++) {
                const double tolerance = dtype == HG_F64 ? 1e-12 : 2e-6;
                const double here = signed_distance(&alone, i, points + 3 * b * N);
                assert_true(fabs(here - signed_distance(&there, i, points + 3 * b * N)) < tolerance);
                if (dtype == HG_F64)
                    assert_true(
                        same_triangle(ctx, &m, frame, points + 3 * (b * N + i), alone.triangle[i], there.triangle[i]));
            }
            for (int64_t i = 0; i < N; i++) alone.triangle[i] = there.triangle[i] = -1;
        }
        contacts_free(&together);
        contacts_free(&alone);
        contacts_free(&there);
    }
    free(vertices);
    free(points);
    hg_body_tree_destroy(tree);
    mesh_free(&m);
    hg_ctx_destroy(ctx);
    hg_ctx_destroy(host);
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
    for (int t = 0; t < 2; t++) {
        hg_ctx *ctx = on_device(t + 1);
        query(ctx, tree, HG_F32, &m, HG_CONTACT_EXACT, 0.02, N, points, &c[t]);
        hg_ctx_destroy(ctx);
    }
    assert_memory_equal(c[0].triangle, c[1].triangle, N * sizeof(int32_t));
    assert_memory_equal(c[0].point, c[1].point, 3 * N * sizeof(double));
    assert_memory_equal(c[0].normal, c[1].normal, 3 * N * sizeof(double));
    for (int t = 0; t < 2; t++) contacts_free(&c[t]);
    free(points);
    hg_body_tree_destroy(tree);
    mesh_free(&m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_closest_and_refit),
        cmocka_unit_test(test_strands_with_reach),
        cmocka_unit_test(test_soup),
        cmocka_unit_test(test_sign),
        cmocka_unit_test(test_ties),
        cmocka_unit_test(test_degenerate_bodies),
        cmocka_unit_test(test_frames),
        cmocka_unit_test(test_threads),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
