/* bf16 compute: rounding, products, and a layer's values and gradients against f32, with the same bits for any number of
 * threads. What needs bf16 instructions is skipped where the processor has none. */
#include "test.h"

#include "autograd/autograd.h"
#include "tensor/math.h"

static float normal(uint64_t stream, int64_t i) { return (float)hg_random_normal(1, stream, (uint64_t)i); }

static void test_rounding(void **state)
{
    (void)state;
    const float special[] = {
        0.0f,    -0.0f,    1.0f,      1.00390625f, 1.01171875f, -1.00390625f, 3.4e38f, 1e-40f,
        -1e-42f, INFINITY, -INFINITY, NAN,         -NAN,        1.00390637f,  65504.f, 3.3895e38f
    };
    enum { N = sizeof special / sizeof *special };
    uint16_t out[1000 + N];
    float in[1000 + N];
    for (int i = 0; i < 1000; i++) in[i] = normal(1, i);
    memcpy(in + 1000, special, sizeof special);
    hg_bf16_of_f32(1000 + N, in, out);
    for (int i = 0; i < 1000 + N; i++) {
        assert_int_equal(out[i], hg_bf16_from_f32(in[i]));
        if (isnan(in[i])) assert_true(isnan(hg_f32_from_bf16(out[i])));
    }
}

/* Against sums in f64 of the same rounded factors. */
static void check_product(bool ta, bool tb, int64_t m, int64_t n, int64_t k, bool add)
{
    const int64_t lda = (ta ? m : k) + 3, ldb = (tb ? k : n) + 1, ldc = n + 2;
    const int64_t na = (ta ? k : m) * lda, nb = (tb ? n : k) * ldb;
    uint16_t *a = hg_alloc((size_t)na + 1, sizeof *a), *b = hg_alloc((size_t)nb + 1, sizeof *b);
    float *c = hg_alloc((size_t)(m * ldc) + 1, sizeof *c);
    for (int64_t i = 0; i < na; i++) a[i] = hg_bf16_from_f32(normal(2, i));
    for (int64_t i = 0; i < nb; i++) b[i] = hg_bf16_from_f32(normal(3, i));
    for (int64_t i = 0; i < m * ldc; i++) c[i] = normal(4, i);
    hg_product_here(HG_BF16, ta, tb, m, n, k, 1, a, lda, b, ldb, add, c, ldc);
    for (int64_t i = 0; i < m; i++)
        for (int64_t j = 0; j < ldc; j++) {
            const double before = (double)normal(4, i * ldc + j);
            double sum = j >= n || add ? before : 0, size = fabs(sum);
            for (int64_t p = 0; p < k && j < n; p++) {
                const double term = (double)hg_f32_from_bf16(ta ? a[p * lda + i] : a[i * lda + p]) *
                                    (double)hg_f32_from_bf16(tb ? b[j * ldb + p] : b[p * ldb + j]);
                sum += term;
                size += fabs(term);
            }
            assert_true(fabs((double)c[i * ldc + j] - sum) <= 1e-5 * size);
        }
    hg_free(a);
    hg_free(b);
    hg_free(c);
}

static void test_products(void **state)
{
    (void)state;
    static const int64_t sizes[][3] = { { 1, 1, 1 }, { 5, 3, 7 }, { 64, 33, 17 }, { 40, 72, 256 }, { 7, 9, 0 } };
    for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++)
        for (int how = 0; how < 8; how++)
            check_product(how & 1, how & 2, sizes[s][0], sizes[s][1], sizes[s][2], how & 4);
}

/* ---- a network of two layers -------------------------------------------------------------------------------- */

enum { ROWS = 1300, IN = 37, WIDTH = 64, OUT = 20, PARTS = 6 };

typedef struct {
    float *value[PARTS]; /* output, gradients of x, W0, b0, W1, b1 */
    int64_t count[PARTS];
} result;

static hg_tensor *leaf(hg_ctx *ctx, int64_t rows, int64_t columns, uint64_t stream, double scale)
{
    hg_tensor *t =
        columns ? hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ rows, columns }) : hg_tensor_make(ctx, HG_F32, 1, &rows);
    assert_non_null(t);
    for (int64_t i = 0; i < hg_tensor_count(t); i++) ((float *)t->data)[i] = (float)scale * normal(stream, i);
    hg_require_grad(t);
    return t;
}

static result run(int threads, hg_dtype compute, int64_t rows)
{
    hg_ctx *ctx;
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = threads, .seed = 1 }), HG_OK);
    assert_int_equal(hg_ctx_compute(ctx, compute), HG_OK);
    assert_int_equal(hg_ctx_compute_dtype(ctx), compute);
    hg_step_guard(ctx, true);
    hg_step_reset(ctx);
    hg_tensor *in[5] = { leaf(ctx, rows, IN, 10, 1), leaf(ctx, IN, WIDTH, 11, 0.2), leaf(ctx, WIDTH, 0, 12, 0.1),
                         leaf(ctx, WIDTH, OUT, 13, 0.15), leaf(ctx, OUT, 0, 14, 0.1) };
    hg_tensor *y = hg_linear(ctx, hg_linear(ctx, in[0], in[1], in[2], HG_SILU), in[3], in[4], HG_IDENTITY);
    hg_tensor *loss = hg_sum(ctx, hg_square(ctx, y));
    assert_int_equal(hg_backward(ctx, loss), HG_OK);
    assert_int_equal(hg_step_check(ctx), HG_OK);
    result r;
    for (int i = 0; i < PARTS; i++) {
        const hg_tensor *t = i == 0 ? y : hg_grad(in[i - 1]);
        r.count[i] = hg_tensor_count(t);
        r.value[i] = hg_alloc((size_t)r.count[i] + 1, sizeof(float));
        memcpy(r.value[i], t->data, hg_tensor_bytes(t));
    }
    hg_ctx_destroy(ctx);
    return r;
}

static void free_result(result *r)
{
    for (int i = 0; i < PARTS; i++) hg_free(r->value[i]);
}

static bool has_bf16(void)
{
    hg_ctx *ctx;
    assert_int_equal(hg_ctx_create(&ctx, NULL), HG_OK);
    const bool has = hg_ctx_compute(ctx, HG_BF16) == HG_OK;
    if (!has) {
        assert_non_null(strstr(hg_message(), "no bf16 instructions"));
        assert_int_equal(hg_ctx_compute_dtype(ctx), HG_F32);
    }
    hg_ctx_destroy(ctx);
    return has;
}

/* Factors have 8 bits: every part agrees with f32 to better than 1 % of its length, and is not the same. */
static void test_layers(void **state)
{
    (void)state;
    if (!has_bf16()) skip();
    result full = run(2, HG_F32, ROWS), half = run(2, HG_BF16, ROWS);
    for (int i = 0; i < PARTS; i++) {
        double difference = 0, length = 0;
        for (int64_t k = 0; k < full.count[i]; k++) {
            const double d = (double)(half.value[i][k] - full.value[i][k]);
            difference += d * d;
            length += (double)full.value[i][k] * (double)full.value[i][k];
        }
        assert_true(length > 0 && difference > 0);
        assert_true(sqrt(difference / length) < 1e-2);
    }
    free_result(&full);
    free_result(&half);
}

static void test_same_bits(void **state)
{
    (void)state;
    if (!has_bf16()) skip();
    result one = run(1, HG_BF16, ROWS);
    for (int threads = 2; threads <= 3; threads++) {
        result other = run(threads, HG_BF16, ROWS);
        for (int i = 0; i < PARTS; i++)
            assert_memory_equal(one.value[i], other.value[i], (size_t)one.count[i] * sizeof(float));
        free_result(&other);
    }
    free_result(&one);
}

/* Up to 256 rows nothing is rounded. */
static void test_few_rows(void **state)
{
    (void)state;
    if (!has_bf16()) skip();
    result full = run(1, HG_F32, 256), half = run(1, HG_BF16, 256);
    for (int i = 0; i < PARTS; i++)
        assert_memory_equal(full.value[i], half.value[i], (size_t)full.count[i] * sizeof(float));
    free_result(&full);
    free_result(&half);
}

static void test_refused(void **state)
{
    (void)state;
    hg_ctx *ctx;
    assert_int_equal(hg_ctx_create(&ctx, NULL), HG_OK);
    assert_int_equal(hg_ctx_compute(ctx, HG_I32), HG_INVALID);
    assert_int_equal(hg_ctx_compute_dtype(ctx), HG_F32);
    hg_ctx_destroy(ctx);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_rounding),  cmocka_unit_test(test_products), cmocka_unit_test(test_layers),
        cmocka_unit_test(test_same_bits), cmocka_unit_test(test_few_rows), cmocka_unit_test(test_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
