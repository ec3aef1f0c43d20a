/* The neighbour sums of self collision against plain loops over all pairs: scattered, flat, in one place, with points far
 * off and points that are not finite, with masses; the same bits for any number of threads. On the device of the test. */
#include "device.h"
#include "test.h"

#include "hairloss/hairloss.h"

enum { STRANDS = 60, VERTICES = 25, N = STRANDS * VERTICES };

static const double h = 4e-3, stiffness = 1e-6;

static double weight(double r, double *slope)
{
    const double s = r / h;
    *slope = (s < 1 ? -12 * s + 9 * s * s : s < 2 ? -3 * (2 - s) * (2 - s) : 0) / h;
    return s < 1 ? 4 - 6 * s * s + 3 * s * s * s : s < 2 ? (2 - s) * (2 - s) * (2 - s) : 0;
}

static bool finite3(const double *x) { return isfinite(x[0]) && isfinite(x[1]) && isfinite(x[2]); }

/* rho of finite points; with slopes dE/drho also the gradient */
static void plain(const double *x, const double *mass, double *rho, const double *slopes, double *gradient)
{
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) {
            if (!finite3(x + 3 * i) || !finite3(x + 3 * j)) continue;
            double d[3], r = 0, slope;
            for (int k = 0; k < 3; k++) d[k] = x[3 * i + k] - x[3 * j + k], r += d[k] * d[k];
            r = sqrt(r);
            const double w = weight(r, &slope);
            if (rho) rho[i] += mass[j] * w;
            for (int k = 0; k < 3 && gradient && r > 0; k++)
                gradient[3 * i + k] += (slopes[i] * mass[j] + slopes[j] * mass[i]) * slope * d[k] / r;
        }
}

typedef struct {
    double energy, gradient[3 * N];
} result;

static void evaluate(int threads, hg_dtype dtype, bool masses, const double *rest, const double *mass, const double *x,
                     result *r)
{
    hg_ctx *ctx;
    hg_physics *physics;
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .device = test_device(), .threads = threads }), HG_OK);
    const double params[HG_ENERGY_PARAMS] = { stiffness, h };
    const char *const options[HG_ENERGY_OPTIONS] = { masses ? "kg" : "unit" };
    const hg_term term = { hg_energy_find("self_collision"), 1, params, options };
    const hg_groom_data data = {
        .grooms = 1, .strands = STRANDS, .vertices = VERTICES, .rest = rest, .mass = masses ? mass : NULL
    };
    assert_int_equal(hg_physics_create(&physics, ctx, dtype, &term, 1, &data), HG_OK);
    const int64_t shape[4] = { 1, STRANDS, VERTICES, 3 };
    hg_tensor *at = hg_tensor_create(ctx, dtype, 4, shape), *gradient = hg_tensor_create(ctx, dtype, 4, shape);
    static float single[3 * N];
    for (int i = 0; i < 3 * N; i++) single[i] = (float)x[i];
    assert_int_equal(hg_tensor_write(at, dtype == HG_F64 ? (const void *)x : single), HG_OK);
    for (int twice = 0; twice < 2; twice++) { /* the second time with what the first one left */
        hg_step_guard(ctx, true);
        hg_step_reset(ctx);
        assert_int_equal(hg_physics_evaluate(physics, ctx, &(hg_frame){ .dt = 1 }, at, &r->energy, NULL, gradient),
                         HG_OK);
        assert_int_equal(hg_step_check(ctx), HG_OK);
    }
    for (int i = 0; i < 3 * N; i++) r->gradient[i] = hg_tensor_item(gradient, i);
    hg_tensor_destroy(at);
    hg_tensor_destroy(gradient);
    hg_physics_destroy(physics);
    hg_ctx_destroy(ctx);
}

static void check(bool masses, const double *rest, const double *x)
{
    static double mass[N], rho_rest[N], rho[N], slopes[N], want[3 * N];
    static result one, two, single;
    double energy = 0, size = 0;
    memset(rho_rest, 0, sizeof rho_rest);
    memset(rho, 0, sizeof rho);
    memset(want, 0, sizeof want);
    for (int i = 0; i < N; i++) mass[i] = masses ? 0.5 + hg_random_uniform(4, 0, (uint64_t)i) : 1;
    plain(rest, mass, rho_rest, NULL, NULL);
    plain(x, mass, rho, NULL, NULL);
    for (int i = 0; i < N; i++) {
        const double excess = fmax(rho[i] - rho_rest[i], 0);
        energy += stiffness * excess * excess * excess;
        slopes[i] = 3 * stiffness * excess * excess;
    }
    plain(x, mass, NULL, slopes, want);
    for (int i = 0; i < 3 * N; i++) size = fmax(size, fabs(want[i]));
    evaluate(1, HG_F64, masses, rest, mass, x, &one);
    evaluate(2, HG_F64, masses, rest, mass, x, &two);
    assert_memory_equal(&one, &two, sizeof one);
    assert_true(energy > 0 && fabs(one.energy - energy) <= 1e-10 * energy);
    evaluate(2, HG_F32, masses, rest, mass, x, &single);
    assert_true(fabs(single.energy - energy) <= 1e-3 * energy);
    for (int i = 0; i < 3 * N; i++) {
        if (!(fabs(one.gradient[i] - want[i]) <= 1e-10 * size))
            fail_msg("gradient %d: %.17g, not %.17g", i, one.gradient[i], want[i]);
        assert_true(fabs(single.gradient[i] - want[i]) <= 2e-3 * size);
    }
}

/* Points in a box, and the same ones pushed together. */
static void scatter(double wide, double high, double deep, double *rest, double *x)
{
    const double box[3] = { wide, high, deep };
    for (int i = 0; i < 3 * N; i++) {
        rest[i] = (double)(float)(box[i % 3] * (hg_random_uniform(2, 0, (uint64_t)i) - 0.5));
        x[i] = (double)(float)(0.8 * rest[i] + 1e-4 * (double)(box[i % 3] > 0) * hg_random_normal(2, 1, (uint64_t)i));
    }
}

static double rest[3 * N], x[3 * N];

static void test_scattered(void **state)
{
    (void)state;
    scatter(0.05, 0.05, 0.06, rest, x);
    check(false, rest, x);
    check(true, rest, x);
}

static void test_flat(void **state) /* one layer of cells, a row, a point of the grid */
{
    (void)state;
    scatter(0.2, 0.2, 0, rest, x);
    check(false, rest, x);
    scatter(0, 0, 1.5, rest, x);
    check(false, rest, x);
}

static void test_in_one_place(void **state) /* everybody is everybody's neighbour */
{
    (void)state;
    scatter(0.004, 0.004, 0.004, rest, x);
    check(false, rest, x);
    check(true, rest, x);
}

static void test_strays(void **state)
{
    (void)state;
    scatter(0.05, 0.05, 0.05, rest, x);
    x[3 * 100] = 1e6;
    x[3 * 200 + 1] = -1e4;
    x[3 * 300 + 2] = (double)NAN;
    x[3 * 1400] = (double)INFINITY;
    check(false, rest, x);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_scattered),
        cmocka_unit_test(test_flat),
        cmocka_unit_test(test_in_one_place),
        cmocka_unit_test(test_strays),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
