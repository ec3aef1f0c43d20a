/* conv2d at sizes of networks, on the device under test, in every precision, against plain loops; upsample beside it. The small
 * and odd shapes are the ops' samples (test_ops). */
#define HG_NO_CALLER
#include "tests/device.h"
#include "tests/test.h"

#include "autograd/autograd.h"

enum { PARTS = 4 }; /* y, and the gradients to x, weight and bias */
static const char *const part_names[PARTS] = { "y", "dx", "dweight", "dbias" };

typedef struct {
    int64_t batch, in, height, width, out, kernel;
    int stride, padding;
} shape;

typedef struct {
    double *part[PARTS];
    int64_t count[PARTS];
} result;

static void free_result(result *r)
{
    for (int i = 0; i < PARTS; i++) hg_free(r->part[i]);
}

static hg_ctx *make_ctx(int threads, hg_dtype compute)
{
    hg_ctx *ctx;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = threads, .device = test_device() }) != HG_OK)
        fail_msg("%s", hg_message());
    assert_int_equal(hg_ctx_compute(ctx, compute), HG_OK);
    return ctx;
}

static bool has(hg_dtype compute)
{
    hg_ctx *ctx;
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .device = test_device() }), HG_OK);
    const bool good = hg_ctx_compute(ctx, compute) == HG_OK;
    hg_ctx_destroy(ctx);
    return good;
}

static double number(uint64_t stream, int64_t i)
{
    return (double)(float)(2 * hg_random_uniform(5, stream, (uint64_t)i) - 1);
}

static hg_tensor *numbers(hg_ctx *ctx, hg_dtype dtype, int rank, const int64_t *sizes, uint64_t stream)
{
    hg_tensor *t = hg_tensor_make(ctx, dtype, rank, sizes);
    assert_non_null(t);
    const int64_t n = hg_tensor_count(t);
    void *values = hg_alloc((size_t)n + 1, hg_dtype_size(dtype));
    for (int64_t i = 0; i < n; i++) {
        if (dtype == HG_F32)
            ((float *)values)[i] = (float)number(stream, i);
        else
            ((double *)values)[i] = number(stream, i);
    }
    assert_int_equal(hg_tensor_write(t, values), HG_OK);
    hg_free(values);
    return t;
}

static void keep(result *r, int part, const hg_tensor *t)
{
    const int64_t n = r->count[part] = hg_tensor_count(t);
    void *values = hg_alloc((size_t)n + 1, hg_dtype_size(t->dtype));
    r->part[part] = hg_alloc((size_t)n + 1, sizeof(double));
    assert_int_equal(hg_tensor_read(t, values), HG_OK);
    for (int64_t i = 0; i < n; i++)
        r->part[part][i] = t->dtype == HG_F32 ? (double)((float *)values)[i] : ((double *)values)[i];
    hg_free(values);
}

typedef struct {
    hg_tensor *in[3], *y, *seed;
} network;

static network build(hg_ctx *ctx, const shape *s, hg_dtype dtype)
{
    network n = { { numbers(ctx, dtype, 4, (int64_t[]){ s->batch, s->in, s->height, s->width }, 1),
                    numbers(ctx, dtype, 4, (int64_t[]){ s->out, s->in, s->kernel, s->kernel }, 2),
                    numbers(ctx, dtype, 1, (int64_t[]){ s->out }, 3) } };
    for (int i = 0; i < 3; i++) assert_int_equal(hg_require_grad(n.in[i]), HG_OK);
    n.y = hg_conv2d(ctx, n.in[0], n.in[1], n.in[2], s->stride, s->padding);
    if (!n.y) fail_msg("%s", hg_ctx_message(ctx));
    n.seed = numbers(ctx, dtype, 4, n.y->shape, 4);
    return n;
}

static result run(const shape *s, hg_dtype dtype, hg_dtype compute, int threads)
{
    hg_ctx *ctx = make_ctx(threads, compute);
    result r = { 0 };
    const network n = build(ctx, s, dtype);
    if (hg_backward_seeded(ctx, n.y, n.seed) != HG_OK) fail_msg("%s", hg_message());
    keep(&r, 0, n.y);
    for (int i = 0; i < 3; i++) keep(&r, 1 + i, hg_grad(n.in[i]));
    hg_ctx_destroy(ctx);
    return r;
}

/* Plain loops, factors in bf16 where they are to be. */
static result expected(const shape *s, bool bf16)
{
    const int64_t oh = (s->height + 2 * s->padding - s->kernel) / s->stride + 1,
                  ow = (s->width + 2 * s->padding - s->kernel) / s->stride + 1, taps = s->kernel * s->kernel;
    result r = { .count = { s->batch * s->out * oh * ow, s->batch * s->in * s->height * s->width, s->out * s->in * taps,
                            s->out } };
    double *factor[3];
    const int64_t counts[3] = { r.count[1], r.count[2], r.count[0] };
    for (int i = 0; i < 3; i++) {
        factor[i] = hg_alloc((size_t)counts[i] + 1, sizeof(double));
        for (int64_t k = 0; k < counts[i]; k++) {
            const double x = number((uint64_t)(i == 2 ? 4 : i + 1), k);
            factor[i][k] = bf16 ? (double)hg_f32_from_bf16(hg_bf16_from_f32((float)x)) : x;
        }
    }
    for (int i = 0; i < PARTS; i++) r.part[i] = hg_alloc((size_t)r.count[i] + 1, sizeof(double));
    for (int64_t b = 0; b < s->batch; b++)
        for (int64_t o = 0; o < s->out; o++)
            for (int64_t i = 0; i < oh; i++)
                for (int64_t j = 0; j < ow; j++) {
                    const int64_t at = ((b * s->out + o) * oh + i) * ow + j;
                    double sum = number(3, o);
                    for (int64_t c = 0; c < s->in; c++)
                        for (int64_t t = 0; t < taps; t++) {
                            const int64_t y = i * s->stride + t / s->kernel - s->padding,
                                          x = j * s->stride + t % s->kernel - s->padding;
                            if (y < 0 || y >= s->height || x < 0 || x >= s->width) continue;
                            const int64_t pixel = ((b * s->in + c) * s->height + y) * s->width + x,
                                          weight = (o * s->in + c) * taps + t;
                            sum += factor[0][pixel] * factor[1][weight];
                            r.part[1][pixel] += factor[1][weight] * factor[2][at];
                            r.part[2][weight] += factor[0][pixel] * factor[2][at];
                        }
                    r.part[0][at] = sum;
                    r.part[3][o] += number(4, at); /* never rounded */
                }
    for (int i = 0; i < 3; i++) hg_free(factor[i]);
    return r;
}

/* Relative to the largest; returns the largest difference. */
static double compare(const shape *s, const result *a, const result *b, double tolerance)
{
    double worst = 0;
    for (int i = 0; i < PARTS; i++) {
        double largest = 0;
        assert_int_equal(a->count[i], b->count[i]);
        for (int64_t k = 0; k < b->count[i]; k++) largest = fmax(largest, fabs(b->part[i][k]));
        for (int64_t k = 0; k < b->count[i]; k++) {
            const double difference = fabs(a->part[i][k] - b->part[i][k]) / largest;
            if (!(difference <= tolerance))
                fail_msg("[%lld,%lld,%lld,%lld] stride %d: element %lld of %s is %.9g, expected %.9g",
                         (long long)s->batch, (long long)s->in, (long long)s->height, (long long)s->width, s->stride,
                         (long long)k, part_names[i], a->part[i][k], b->part[i][k]);
            worst = fmax(worst, difference);
        }
    }
    return worst;
}

/* Layers of an encoder and a decoder made thin, and what makes one block, and many, of every kind. */
static const shape shapes[] = {
    { 2, 8, 32, 32, 12, 3, 2, 1 },  { 1, 96, 8, 8, 64, 3, 1, 1 }, { 3, 40, 16, 16, 24, 3, 1, 1 },
    { 2, 20, 15, 17, 9, 5, 2, 2 },  { 2, 33, 9, 7, 70, 1, 1, 0 }, { 1, 3, 64, 64, 8, 3, 1, 1 },
    { 2, 17, 12, 12, 10, 4, 2, 1 },
};
enum { SHAPES = sizeof shapes / sizeof *shapes };

static double check_all(hg_dtype dtype, hg_dtype compute, double tolerance)
{
    double worst = 0;
    for (int i = 0; i < SHAPES; i++) {
        result want = expected(&shapes[i], compute == HG_BF16), one = run(&shapes[i], dtype, compute, 1);
        worst = fmax(worst, compare(&shapes[i], &one, &want, tolerance));
        for (int threads = 2; threads <= 3; threads++) {
            result other = run(&shapes[i], dtype, compute, threads);
            for (int part = 0; part < PARTS; part++)
                assert_memory_equal(one.part[part], other.part[part], (size_t)one.count[part] * sizeof(double));
            free_result(&other);
        }
        free_result(&want);
        free_result(&one);
    }
    return worst;
}

static void test_f32(void **state)
{
    (void)state;
    check_all(HG_F32, HG_F32, 2e-6);
}

static void test_f64(void **state)
{
    (void)state;
    check_all(HG_F64, HG_F32, 1e-14);
}

/* cuDNN's results are in bf16 too. Every shape has more than 256 pixels in a batch but one, of 126, which on the cpu is in f32. */
static void test_bf16(void **state)
{
    (void)state;
    if (!has(HG_BF16)) skip();
    const bool cuda = test_device() && strncmp(test_device(), "cuda", 4) == 0;
    for (int i = 0; i < SHAPES; i++) {
        const int64_t rows = (shapes[i].height + 2 * shapes[i].padding - shapes[i].kernel) / shapes[i].stride + 1;
        const bool few = shapes[i].batch * rows * rows <= 256;
        if (few && !cuda) continue;
        result want = expected(&shapes[i], true), got = run(&shapes[i], HG_F32, HG_BF16, 2),
               full = run(&shapes[i], HG_F32, HG_F32, 1);
        compare(&shapes[i], &got, &want, cuda ? 4e-3 : 2e-6);
        assert_true(compare(&shapes[i], &got, &full, 3e-2) > 1e-4);
        free_result(&want);
        free_result(&got);
        free_result(&full);
    }
}

static void test_tf32(void **state)
{
    (void)state;
    if (!has(HG_TF32)) skip();
    assert_true(check_all(HG_F32, HG_TF32, 1e-3) > 1e-5);
}

/* From the second step on nothing is taken, and a recorded step is replayed to the same numbers. */
static void test_recorded(void **state)
{
    (void)state;
    const hg_dtype computes[] = { HG_F32, HG_BF16 };
    for (int c = 0; c < 2; c++) {
        if (!has(computes[c])) continue;
        hg_ctx *ctx = make_ctx(2, computes[c]);
        const shape *s = &shapes[0];
        result first = { 0 };
        size_t reserved = 0;
        int64_t taken = 0;
        for (int step = 0; step < 6; step++) {
            hg_step_reset(ctx);
            const int64_t before = hg_alloc_count();
            assert_int_equal(hg_step_record(ctx), HG_OK);
            network n = build(ctx, s, HG_F32);
            hg_tensor *up = hg_upsample(ctx, hg_activate(ctx, n.y, HG_SILU), HG_BILINEAR);
            assert_int_equal(hg_backward(ctx, hg_sum(ctx, hg_square(ctx, up))), HG_OK);
            if (hg_step_run(ctx) != HG_OK) fail_msg("%s", hg_message());
            const int64_t used = hg_alloc_count() - before;
            result r = { 0 };
            keep(&r, 0, n.y);
            for (int i = 0; i < 3; i++) keep(&r, 1 + i, hg_grad(n.in[i]));
            if (step == 0) first = r;
            for (int i = 0; i < PARTS && step > 0; i++)
                assert_memory_equal(first.part[i], r.part[i], (size_t)r.count[i] * sizeof(double));
            if (step > 0) free_result(&r);
            if (step == 4) reserved = hg_step_reserved(ctx), taken = used;
            if (step == 5) assert_int_equal(hg_step_reserved(ctx), reserved), assert_int_equal(used, taken);
        }
        if (!hg_ctx_host(ctx)) assert_true(hg_ctx_counts(ctx).replays > 0);
        free_result(&first);
        hg_ctx_destroy(ctx);
    }
}

static void test_refused(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1, HG_F32);
    hg_tensor *x = numbers(ctx, HG_F32, 4, (int64_t[]){ 1, 2, 3, 3 }, 1),
              *w = numbers(ctx, HG_F32, 4, (int64_t[]){ 2, 2, 5, 3 }, 2),
              *b = numbers(ctx, HG_F32, 1, (int64_t[]){ 3 }, 3);
    const struct {
        hg_tensor *bias;
        int stride, padding;
        const char *says;
    } wrong[] = { { NULL, 1, 0, "5 x 3 do not fit into images of 3 x 3" },
                  { NULL, 0, 1, "stride 0" },
                  { NULL, 1, -1, "padding -1" },
                  { b, 1, 1, "bias has to be [out]" } };
    for (int i = 0; i < 4; i++) {
        assert_null(hg_conv2d(ctx, x, w, wrong[i].bias, wrong[i].stride, wrong[i].padding));
        if (!strstr(hg_ctx_message(ctx), wrong[i].says)) fail_msg("%s", hg_ctx_message(ctx));
        hg_ctx_clear(ctx);
    }
    assert_null(hg_upsample(ctx, b, HG_NEAREST));
    assert_non_null(strstr(hg_ctx_message(ctx), "[batch,channels,height,width]"));
    hg_ctx_clear(ctx);
    /* Below the op: sizes that do not fit are not followed. */
    hg_convolution sizes = { 1, 2, 3, 3, 2, 3, 3, 1, 0, 2, 1 };
    assert_int_equal(hg_convolve(ctx, HG_F32, &sizes, x->data, w->data, NULL, x->data), HG_INVALID);
    hg_ctx_clear(ctx);
    sizes.out_height = 1;
    assert_int_equal(hg_convolve(ctx, HG_I32, &sizes, x->data, w->data, NULL, x->data), HG_UNSUPPORTED);
    hg_ctx_destroy(ctx);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_f32),  cmocka_unit_test(test_f64),      cmocka_unit_test(test_bf16),
        cmocka_unit_test(test_tf32), cmocka_unit_test(test_recorded), cmocka_unit_test(test_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
