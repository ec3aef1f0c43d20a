/* Vectors, neighbours, pairs and clusters, each against plain loops or an identity that must hold. */
#include "tests/geometry_random.h"

/* ---- vectors ---- */

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

static void test_threads(void **state)
{
    (void)state;
    enum { N = 3000 };
    double *points = malloc(sizeof(double) * 3 * N);
    hg_neighbours *neighbours[2];
    for (uint64_t i = 0; i < 3 * N; i++) points[i] = between(40, i, -0.1, 0.1);
    for (int t = 0; t < 2; t++) {
        hg_ctx *ctx = make_ctx(t + 1);
        assert_int_equal(hg_neighbours_create(&neighbours[t], 0), HG_OK);
        assert_int_equal(hg_neighbours_build(ctx, neighbours[t], HG_F64, N, points, 0.02, NULL), HG_OK);
        hg_ctx_destroy(ctx);
    }
    const int64_t *start = hg_neighbours_start(neighbours[0]);
    assert_true(start[N] > N);
    assert_memory_equal(start, hg_neighbours_start(neighbours[1]), (N + 1) * sizeof *start);
    assert_memory_equal(hg_neighbours_list(neighbours[0]), hg_neighbours_list(neighbours[1]),
                        (size_t)start[N] * sizeof(int32_t));
    for (int t = 0; t < 2; t++) hg_neighbours_destroy(neighbours[t]);
    free(points);
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
        cmocka_unit_test(test_rotations),  cmocka_unit_test(test_degenerate_vectors),
        cmocka_unit_test(test_neighbours), cmocka_unit_test(test_neighbour_overflow),
        cmocka_unit_test(test_threads),    cmocka_unit_test(test_pairs),
        cmocka_unit_test(test_clusters),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
