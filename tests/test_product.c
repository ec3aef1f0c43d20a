/* Matrix products: all transposes, leading dimensions and factors, on the device under test, against plain loops. */
#include "tests/device.h"
#include "tests/test.h"

#include "tensor/tensor.h"

static hg_ctx *make_ctx(int threads)
{
    hg_ctx *ctx;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = threads, .device = test_device() }) != HG_OK)
        fail_msg("%s", hg_message());
    return ctx;
}

static double element(const void *data, hg_dtype dtype, int64_t i)
{
    return dtype == HG_F32 ? (double)((const float *)data)[i] : ((const double *)data)[i];
}

static void set_random(void *data, hg_dtype dtype, int64_t n, uint64_t stream)
{
    for (int64_t i = 0; i < n; i++) {
        double x = 2 * hg_random_uniform(1, stream, (uint64_t)i) - 1;
        if (dtype == HG_F32)
            ((float *)data)[i] = (float)x;
        else
            ((double *)data)[i] = x;
    }
}

/* The host's numbers in the device's memory. */
static hg_tensor *on_device(hg_ctx *ctx, hg_dtype dtype, int64_t n, const void *from)
{
    hg_tensor *t = hg_tensor_make(ctx, dtype, 1, &n);
    assert_non_null(t);
    assert_int_equal(hg_tensor_write(t, from), HG_OK);
    return t;
}

typedef struct {
    hg_dtype dtype, compute;
    bool ta, tb;
    int64_t m, n, k;
    double alpha, beta;
} product;

/* Factors as they are rounded, f64 never; TF32 is compared with a tolerance. */
static double factor(const product *p, const void *data, int64_t i)
{
    const double x = element(data, p->dtype, i);
    return p->dtype == HG_F32 && p->compute == HG_BF16 ? (double)hg_f32_from_bf16(hg_bf16_from_f32((float)x)) : x;
}

/* Rows are longer than they have to be, and what lies behind them must not change. Returns the largest error. */
static double check_product(product p, int threads)
{
    const size_t size = hg_dtype_size(p.dtype);
    const int64_t m = p.m, n = p.n, k = p.k;
    const int64_t lda = (p.ta ? m : k) + 3, ldb = (p.tb ? k : n) + 1, ldc = n + 2;
    const int64_t count_a = (p.ta ? k : m) * lda + 1, count_b = (p.tb ? n : k) * ldb + 1, count_c = m * ldc + 1;
    void *a = hg_alloc((size_t)count_a, size), *b = hg_alloc((size_t)count_b, size),
         *start = hg_alloc((size_t)count_c, size);
    void *c[2] = { hg_alloc((size_t)count_c, size), hg_alloc((size_t)count_c, size) };
    set_random(a, p.dtype, count_a, 1);
    set_random(b, p.dtype, count_b, 2);
    set_random(start, p.dtype, count_c, 3);
    if (p.beta == 0) /* C is not read then */
        for (int64_t i = 0; i < count_c; i++)
            if (i % ldc < n && i < m * ldc) {
                if (p.dtype == HG_F32)
                    ((float *)start)[i] = NAN;
                else
                    ((double *)start)[i] = (double)NAN;
            }
    for (int run = 0; run < 2; run++) { /* the same bits from another run, with another number of threads */
        hg_ctx *ctx = make_ctx(run ? threads : 1);
        assert_int_equal(hg_ctx_compute(ctx, p.compute), HG_OK);
        const hg_tensor *ta = on_device(ctx, p.dtype, count_a, a), *tb = on_device(ctx, p.dtype, count_b, b);
        hg_tensor *tc = on_device(ctx, p.dtype, count_c, start);
        if (hg_product(ctx, p.dtype, p.ta, p.tb, m, n, k, p.alpha, ta->data, lda, tb->data, ldb, p.beta, tc->data,
                       ldc) != HG_OK)
            fail_msg("%s", hg_message());
        assert_int_equal(hg_tensor_read(tc, c[run]), HG_OK);
        hg_ctx_destroy(ctx);
    }
    assert_memory_equal(c[0], c[1], (size_t)count_c * size);
    double worst = 0;
    const double epsilon = p.compute == HG_TF32 ? 1e-3 : p.dtype == HG_F32 ? 1e-6 : 1e-14;
    for (int64_t i = 0; i < count_c; i++) {
        const int64_t row = i / ldc, column = i % ldc;
        const double x = element(c[0], p.dtype, i);
        if (row >= m || column >= n) {
            if (x != element(start, p.dtype, i))
                fail_msg("%s in %s, %lld x %lld x %lld: what lies behind row %lld changed: %g", hg_dtype_name(p.dtype),
                         hg_dtype_name(p.compute), (long long)m, (long long)n, (long long)k, (long long)row, x);
            continue;
        }
        double sum = 0;
        for (int64_t l = 0; l < k; l++)
            sum += factor(&p, a, p.ta ? l * lda + row : row * lda + l) *
                   factor(&p, b, p.tb ? column * ldb + l : l * ldb + column);
        sum = p.alpha * sum + (p.beta == 0 ? 0 : p.beta * element(start, p.dtype, i));
        worst = fmax(worst, fabs(x - sum));
        if (!(fabs(x - sum) <= epsilon * (double)(k + 4)))
            fail_msg("%s product in %s%s%s %lld x %lld x %lld: element %lld,%lld is %g, expected %g",
                     hg_dtype_name(p.dtype), hg_dtype_name(p.compute), p.ta ? " A^T" : "", p.tb ? " B^T" : "",
                     (long long)m, (long long)n, (long long)k, (long long)row, (long long)column, x, sum);
    }
    void *all[] = { a, b, start, c[0], c[1] };
    for (int i = 0; i < 5; i++) hg_free(all[i]);
    return worst;
}

static const int64_t sizes[][3] = { { 1, 1, 1 },     { 3, 5, 7 },     { 5, 3, 0 },     { 257, 33, 17 },
                                    { 30, 1030, 9 }, { 13, 17, 600 }, { 600, 66, 72 }, { 2, 3, 8300 } };
static const double scales[][2] = { { 1, 0 }, { -0.5, 1 }, { 2, 0.25 } };
enum { SIZES = sizeof sizes / sizeof *sizes };

static double check_all(hg_dtype dtype, hg_dtype compute)
{
    double worst = 0;
    for (int t = 0; t < 4; t++)
        for (int s = 0; s < SIZES; s++)
            for (int i = 0; i < 3; i++)
                worst = fmax(worst, check_product((product){ dtype, compute, t & 1, t & 2, sizes[s][0], sizes[s][1],
                                                             sizes[s][2], scales[i][0], scales[i][1] },
                                                  2));
    return worst;
}

static void test_f32(void **state)
{
    (void)state;
    check_all(HG_F32, HG_F32);
}

static void test_f64(void **state)
{
    (void)state;
    check_all(HG_F64, HG_F32);
}

/* On cuda, factors are rounded to bf16 by us, or to TF32 by the library: close to f32, and not f32. Elsewhere hg_product is f32,
 * and TF32 is refused. */
static void test_rounded_factors(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    const bool cuda = !hg_ctx_host(ctx);
    const hg_status tf32 = hg_ctx_compute(ctx, HG_TF32);
    assert_int_equal(tf32, cuda ? HG_OK : HG_UNSUPPORTED);
    if (!cuda) assert_non_null(strstr(hg_message(), "only GPUs"));
    assert_int_equal(hg_ctx_compute_dtype(ctx), cuda ? HG_TF32 : HG_F32);
    hg_ctx_destroy(ctx);
    if (!cuda) return;
    check_all(HG_F32, HG_BF16);
    assert_true(check_all(HG_F32, HG_TF32) > 1e-4);
    check_product((product){ HG_F64, HG_BF16, true, false, 33, 20, 40, 1, 0 }, 2);
}

static void test_refused(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    const float zeros[4] = { 0 };
    float *x = on_device(ctx, HG_F32, 4, zeros)->data;
    assert_int_equal(hg_product(ctx, HG_F32, false, false, 2, 2, 2, 1, x, 1, x, 2, 0, x, 2), HG_INVALID);
    assert_non_null(strstr(hg_ctx_message(ctx), "lda 1"));
    hg_ctx_clear(ctx);
    assert_int_equal(hg_product(ctx, HG_I32, false, false, 2, 2, 2, 1, x, 2, x, 2, 0, x, 2), HG_UNSUPPORTED);
    hg_ctx_clear(ctx);
    assert_int_equal(hg_product(ctx, HG_F32, false, false, 0, 2, 2, 1, NULL, 2, x, 2, 0, NULL, 2), HG_OK);
    hg_ctx_destroy(ctx);
}

/* Workspaces are of the step, at the same place in the next one: it needs no memory, and a device replays it, to the same bits. */
static void steady(hg_dtype compute)
{
    enum { M = 64, N = 40, K = 700, STEPS = 6 };
    hg_ctx *ctx = make_ctx(2);
    if (hg_ctx_compute(ctx, compute) != HG_OK) {
        hg_ctx_destroy(ctx);
        return;
    }
    size_t reserved[STEPS];
    int64_t taken[STEPS];
    float *a = hg_alloc(K * M, sizeof *a), *b = hg_alloc(K * N, sizeof *b),
          *c[2] = { hg_alloc(M * N, sizeof **c), hg_alloc(M * N, sizeof **c) };
    set_random(a, HG_F32, K * M, 1);
    set_random(b, HG_F32, K * N, 2);
    for (int step = 0; step < STEPS; step++) {
        hg_step_reset(ctx);
        assert_int_equal(hg_step_record(ctx), HG_OK);
        const float *ta = on_device(ctx, HG_F32, K * M, a)->data, *tb = on_device(ctx, HG_F32, K * N, b)->data;
        hg_tensor *tc = hg_tensor_make(ctx, HG_F32, 1, (int64_t[]){ M * N });
        for (int i = 0; i < 3; i++)
            if (hg_product(ctx, HG_F32, true, false, M, N, K, 1, ta, M, tb, N, i ? 0.5 : 0, tc->data, N) != HG_OK)
                fail_msg("%s", hg_message());
        if (hg_step_run(ctx) != HG_OK) fail_msg("%s", hg_message());
        assert_int_equal(hg_tensor_read(tc, c[step > 0]), HG_OK);
        if (step > 0) assert_memory_equal(c[0], c[1], M * N * sizeof **c);
        reserved[step] = hg_step_reserved(ctx);
        taken[step] = hg_alloc_count();
    }
    for (int i = 0; i < 5; i++) assert_true(c[0][i] != 0);
    assert_int_equal(reserved[STEPS - 2], reserved[STEPS - 1]);
    assert_int_equal(taken[STEPS - 2], taken[STEPS - 1]);
    assert_true(hg_ctx_host(ctx) || hg_ctx_counts(ctx).replays > 0);
    float *all[] = { a, b, c[0], c[1] };
    for (int i = 0; i < 4; i++) hg_free(all[i]);
    hg_ctx_destroy(ctx);
}

static void test_steady(void **state)
{
    (void)state;
    steady(HG_F32);
    steady(HG_BF16);
    steady(HG_TF32);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_f32),     cmocka_unit_test(test_f64),    cmocka_unit_test(test_rounded_factors),
        cmocka_unit_test(test_refused), cmocka_unit_test(test_steady),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
