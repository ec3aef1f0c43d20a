/* Every op of the registry, on every one of its samples, through one call: forward against the reference, gradcheck in
 * f64, f32 against f64, an input used twice, backward twice, guards around every buffer, and the same bits for 1 and 2
 * threads, or on a device for two runs, whose numbers are the processor's. An op that cannot be tested fails. */
#include "device.h"
#include "test.h"

#include "autograd/tape.h"

enum { MAX_OPS = 512 };

typedef struct {
    void *data; /* NULL: there is none */
    int64_t count;
    size_t size; /* of an element */
} array;

typedef struct {
    int n_in;
    array out, gradient[HG_OP_INPUTS];
} result;

static double item(const array *a, int64_t i)
{
    return a->size == 4 ? (double)((const float *)a->data)[i] : ((const double *)a->data)[i];
}

static array copy_of(const hg_tensor *tensor)
{
    array copy = { hg_alloc(hg_tensor_bytes(tensor) + 1, 1), hg_tensor_count(tensor), hg_dtype_size(tensor->dtype) };
    assert_non_null(copy.data);
    assert_int_equal(hg_tensor_read(tensor, copy.data), HG_OK);
    return copy;
}

static void free_result(result *r)
{
    hg_free(r->out.data);
    for (int i = 0; i < r->n_in; i++) hg_free(r->gradient[i].data);
}

static void check(hg_ctx *ctx, const hg_op *op, const hg_sample *sample, const char *what)
{
    if (hg_ctx_status(ctx) != HG_OK) fail_msg("%s (%s), %s: %s", op->name, sample->label, what, hg_ctx_message(ctx));
}

static hg_ctx *context(const char *device, int threads)
{
    hg_ctx *ctx;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = threads, .device = device }) != HG_OK)
        fail_msg("%s", hg_message());
    return ctx;
}

/* Random, but the same for every run. */
static hg_tensor *seed_for(hg_ctx *ctx, const hg_tensor *y)
{
    const int64_t n = hg_tensor_count(y);
    hg_tensor *wide = hg_tensor_make(ctx, HG_F64, y->rank, y->shape),
              *seed = hg_tensor_make(ctx, y->dtype, y->rank, y->shape);
    double *values = hg_step_alloc(ctx, (size_t)n * sizeof *values);
    assert_true(wide && seed && values);
    for (int64_t i = 0; i < n; i++) values[i] = (double)(float)(0.5 + hg_random_uniform(3, 1, (uint64_t)i));
    assert_int_equal(hg_tensor_write(wide, values), HG_OK);
    assert_int_equal(hg_tensor_copy(seed, wide), HG_OK);
    return seed;
}

static void against_reference(const hg_op *op, const hg_sample *sample, const hg_call *call)
{
    const int64_t n = hg_tensor_count(call->out);
    double *expected = hg_alloc((size_t)n + 1, sizeof *expected), largest = 0;
    op->reference(call, expected);
    for (int64_t i = 0; i < n; i++) largest = fmax(largest, fabs(expected[i]));
    for (int64_t i = 0; i < n; i++)
        if (!(fabs(hg_tensor_item(call->out, i) - expected[i]) <= 1e-13 * (1 + largest)))
            fail_msg("%s (%s): element %lld is %.17g, the reference says %.17g", op->name, sample->label, (long long)i,
                     hg_tensor_item(call->out, i), expected[i]);
    hg_free(expected);
}

/* One run in a context of its own. With `twice` the op is applied two times to the same inputs, and its outputs are
 * added. The reference is asked on the processor. */
static result run(const char *device, const hg_op *op, const hg_sample *sample, hg_dtype dtype, int threads, bool twice)
{
    hg_tensor *in[HG_OP_INPUTS] = { NULL };
    hg_ctx *ctx = context(device, threads);
    hg_step_guard(ctx, true);
    hg_step_reset(ctx);
    hg_tape_record_all(ctx, true);
    for (int i = 0; i < sample->n_in; i++) {
        in[i] = hg_sample_input(ctx, sample, i, dtype);
        check(ctx, op, sample, "its inputs");
        if (hg_is_float(in[i]) && !sample->in[i].no_grad) assert_int_equal(hg_require_grad(in[i]), HG_OK);
    }
    hg_tensor *y = hg_apply(ctx, op, sample->n_in, in, sample->attributes);
    check(ctx, op, sample, "forward");
    assert_non_null(y);
    if (dtype == HG_F64 && !twice && hg_ctx_host(ctx)) against_reference(op, sample, hg_tape_call(ctx, 0));
    hg_tensor *out = twice ? hg_add(ctx, y, hg_apply(ctx, op, sample->n_in, in, sample->attributes)) : y;
    hg_tensor *seed = seed_for(ctx, y);
    hg_backward_seeded(ctx, out, seed);
    check(ctx, op, sample, "backward");
    result r = { .n_in = sample->n_in, .out = copy_of(y) };
    for (int i = 0; i < sample->n_in; i++)
        if (hg_grad(in[i])) r.gradient[i] = copy_of(hg_grad(in[i]));
    /* Backward again: gradients are made anew, not added to. */
    assert_int_equal(hg_backward_seeded(ctx, out, seed), HG_OK);
    for (int i = 0; i < sample->n_in; i++) {
        if (!r.gradient[i].data) continue;
        array again = copy_of(hg_grad(in[i]));
        if (memcmp(r.gradient[i].data, again.data, hg_tensor_bytes(in[i])) != 0)
            fail_msg("%s (%s): a second backward gives another gradient of input %d", op->name, sample->label, i);
        hg_free(again.data);
    }
    if (hg_step_check(ctx) != HG_OK) fail_msg("%s (%s) wrote outside of its buffers", op->name, sample->label);
    hg_ctx_destroy(ctx);
    return r;
}

static bool same_bits(const array *a, const array *b)
{
    return !a->data || memcmp(a->data, b->data, (size_t)a->count * a->size) == 0;
}

static void compare_bits(const hg_op *op, const hg_sample *sample, const result *a, const result *b)
{
    const char *runs = test_device() ? "two runs" : "1 and 2 threads";
    if (!same_bits(&a->out, &b->out)) fail_msg("%s (%s): %s give other bits", op->name, sample->label, runs);
    for (int i = 0; i < a->n_in; i++)
        if (!same_bits(&a->gradient[i], &b->gradient[i]))
            fail_msg("%s (%s): %s give other bits in the gradient of input %d", op->name, sample->label, runs, i);
}

/* a = factor b, relative to the largest element; a gradient that cancels to zero keeps the rounding of its terms. */
static void compare_arrays(const hg_op *op, const hg_sample *sample, const char *what, const array *a, double factor,
                           const array *b, double tolerance)
{
    double largest = 0;
    for (int64_t i = 0; a->data && i < a->count; i++) largest = fmax(largest, fabs(item(b, i)));
    for (int64_t i = 0; a->data && i < a->count; i++)
        if (!(fabs(item(a, i) - factor * item(b, i)) <= tolerance * (2e-2 + largest)))
            fail_msg("%s (%s), %s: element %lld is %.9g, expected %.9g", op->name, sample->label, what, (long long)i,
                     item(a, i), factor * item(b, i));
}

/* f(x, x): both gradients end in the one tensor. */
static void check_shared_input(const hg_op *op, const hg_sample *sample)
{
    if (sample->n_in < 2 || sample->in[0].no_grad || sample->in[1].no_grad || sample->in[1].dtype == HG_I32 ||
        sample->in[0].rank != sample->in[1].rank ||
        memcmp(sample->in[0].shape, sample->in[1].shape, sizeof sample->in[0].shape) != 0)
        return;
    hg_ctx *ctx = context(test_device(), 1);
    hg_tensor *in[2][HG_OP_INPUTS];
    for (int i = 0; i < sample->n_in; i++) in[0][i] = hg_sample_input(ctx, sample, i, HG_F64);
    assert_int_equal(hg_tensor_copy(in[0][1], in[0][0]), HG_OK);
    memcpy(in[1], in[0], sizeof in[0]);
    in[1][1] = in[1][0] = hg_sample_input(ctx, sample, 0, HG_F64);
    hg_tensor *leaves[] = { in[0][0], in[0][1], in[1][0] };
    array gradients[3] = { { NULL } };
    for (int i = 0; i < 3; i++) assert_int_equal(hg_require_grad(leaves[i]), HG_OK);
    for (int j = 0; j < 2; j++) {
        hg_tensor *y = hg_apply(ctx, op, sample->n_in, in[j], sample->attributes);
        check(ctx, op, sample, "one tensor as both inputs");
        assert_int_equal(hg_backward_seeded(ctx, y, seed_for(ctx, y)), HG_OK);
        for (int i = 0; i < 3; i++) /* the second backward zeroes the first two */
            if ((i == 2) == (j == 1)) gradients[i] = copy_of(hg_grad(leaves[i]));
    }
    for (int64_t e = 0; e < hg_tensor_count(leaves[0]); e++) {
        double sum = item(&gradients[0], e) + item(&gradients[1], e), shared = item(&gradients[2], e);
        if (!(fabs(sum - shared) <= 1e-12 * (1 + fabs(sum))))
            fail_msg("%s (%s): one tensor as both inputs: gradient %.12g, expected %.12g", op->name, sample->label,
                     shared, sum);
    }
    for (int i = 0; i < 3; i++) hg_free(gradients[i].data);
    hg_ctx_destroy(ctx);
}

/* A device's numbers are the processor's, but for the order of sums. */
static void check_against_cpu(const hg_op *op, const hg_sample *sample, hg_dtype dtype, const result *device)
{
    const double tolerance = dtype == HG_F32 ? 1e-5 : 1e-12;
    result cpu = run("cpu", op, sample, dtype, 2, false);
    compare_arrays(op, sample, "against the processor", &device->out, 1, &cpu.out, tolerance);
    for (int i = 0; i < cpu.n_in; i++)
        compare_arrays(op, sample, "gradient, against the processor", &device->gradient[i], 1, &cpu.gradient[i],
                       tolerance);
    free_result(&cpu);
}

/* Everything about one op on one sample. */
static void check_sample(const hg_op *op, const hg_sample *sample)
{
    const char *device = test_device();
    result one = run(device, op, sample, HG_F32, 1, false), two = run(device, op, sample, HG_F32, 2, false);
    result wide = run(device, op, sample, HG_F64, 2, false), twice = run(device, op, sample, HG_F32, 2, true);
    result twice_wide = run(device, op, sample, HG_F64, 1, true);
    compare_bits(op, sample, &one, &two);
    compare_arrays(op, sample, "f32 against f64", &one.out, 1, &wide.out, 1e-5);
    for (int i = 0; i < one.n_in; i++) {
        compare_arrays(op, sample, "gradient, f32 against f64", &one.gradient[i], 1, &wide.gradient[i], 1e-5);
        compare_arrays(op, sample, "used twice", &twice.gradient[i], 2, &one.gradient[i], 1e-5);
        compare_arrays(op, sample, "used twice, f64", &twice_wide.gradient[i], 2, &wide.gradient[i], 1e-13);
    }
    if (device) {
        check_against_cpu(op, sample, HG_F32, &one);
        check_against_cpu(op, sample, HG_F64, &wide);
    }
    check_shared_input(op, sample);
    result *all[] = { &one, &two, &wide, &twice, &twice_wide };
    for (int i = 0; i < 5; i++) free_result(all[i]);
    hg_ctx *ctx = context(device, 1);
    hg_gradcheck_result checked;
    if (hg_gradcheck_op(ctx, op, sample, NULL, &checked) != HG_OK) fail_msg("%s", hg_message());
    hg_ctx_destroy(ctx);
}

/* What keeps an op from being tested, NULL when nothing does. */
static const char *what_is_missing(const hg_op *op)
{
    bool empty = false, small = false;
    if (!op->name || !op->formula) return "its name or formula";
    if (!op->shape || !op->forward) return "its shape rule or forward";
    if (op->not_differentiable)
        return op->backward ? "a reason: it has a backward and says that it has no gradient" : NULL;
    if (!op->backward) return "its backward";
    if (!op->samples || op->n_samples < 1) return "sample inputs";
    if (!op->reference) return "its reference";
    for (int s = 0; s < op->n_samples; s++)
        for (int i = 0; i < op->samples[s].n_in; i++) {
            int64_t count = 1;
            for (int axis = 0; axis < op->samples[s].in[i].rank; axis++) count *= op->samples[s].in[i].shape[axis];
            if (count == 0) empty = true;
            if (i == 0 && count > 0 && count <= 4) small = true;
        }
    return !empty ? "a sample with an empty input" : !small ? "a sample with one item" : NULL;
}

static void test_every_op(void **state)
{
    (void)state;
    const char *names[MAX_OPS];
    int n = hg_list("op", names, MAX_OPS), samples = 0;
    assert_in_range(n, 40, MAX_OPS);
    for (int i = 0; i < n; i++) {
        const hg_op *op = hg_find("op", names[i]);
        assert_string_equal(op->name, names[i]);
        if (what_is_missing(op)) fail_msg("%s lacks %s", op->name, what_is_missing(op));
        for (int s = 0; s < op->n_samples; s++, samples++) check_sample(op, &op->samples[s]);
    }
    print_message("%d ops, %d samples\n", n, samples);
}

static hg_status nothing(hg_call *call) { return (void)call, HG_OK; }
static hg_tensor *no_shape(hg_call *call) { return (void)call, NULL; }
static void no_reference(const hg_call *call, double *out) { (void)call, (void)out; }

static void test_incomplete_ops_fail(void **state)
{
    (void)state;
    const hg_sample samples[] = { { .n_in = 1, .in = { { 1, { 0 } } } }, { .n_in = 1, .in = { { 1, { 1 } } } } };
    const hg_op complete = { .name = "x",
                             .formula = "x",
                             .shape = no_shape,
                             .forward = nothing,
                             .backward = nothing,
                             .samples = samples,
                             .n_samples = 2,
                             .reference = no_reference };
    assert_null(what_is_missing(&complete));
    hg_op op = complete;
    op.backward = NULL;
    assert_string_equal(what_is_missing(&op), "its backward");
    op = complete, op.samples = NULL;
    assert_string_equal(what_is_missing(&op), "sample inputs");
    op = complete, op.reference = NULL;
    assert_string_equal(what_is_missing(&op), "its reference");
    op = complete, op.samples = samples + 1, op.n_samples = 1;
    assert_string_equal(what_is_missing(&op), "a sample with an empty input");
    op = complete, op.n_samples = 1;
    assert_string_equal(what_is_missing(&op), "a sample with one item");
}

/* Moving elements asks for their size alone: what is true of f32 is true of i32 and bf16. */
static void test_layout_of_every_type(void **state)
{
    (void)state;
    hg_ctx *ctx = context(test_device(), 2);
    double values[6 * 11 * 10];
    for (int i = 0; i < 6 * 11 * 10; i++) values[i] = i % 251 - 125; /* exact in bf16 */
    hg_tensor *x = hg_cast(ctx, hg_tensor_from(ctx, HG_F64, 3, (int64_t[]){ 6, 11, 10 }, values), HG_F32);
    hg_tensor *moved[3];
    const hg_dtype types[] = { HG_F32, HG_I32, HG_BF16 };
    for (int t = 0; t < 3; t++) {
        hg_tensor *y = t ? hg_cast(ctx, x, types[t]) : x;
        hg_tensor *turned = hg_permute(ctx, y, (int[]){ 2, 0, 1 }), *tail = hg_slice(ctx, turned, 2, 3, 8);
        moved[t] = hg_concat(ctx, 2, 2, (hg_tensor *[]){ tail, turned });
        assert_int_equal(hg_ctx_status(ctx), HG_OK);
        assert_int_equal(moved[t]->dtype, types[t]);
    }
    for (int64_t i = 0; i < hg_tensor_count(moved[0]); i++) {
        const int64_t row = i / 19, column = i % 19 < 8 ? i % 19 + 3 : i % 19 - 8;
        const double expected = values[(row % 6 * 11 + column) * 10 + row / 6];
        for (int t = 0; t < 3; t++)
            if (hg_tensor_item(moved[t], i) != expected)
                fail_msg("%s: element %lld is %g, expected %g", hg_dtype_name(types[t]), (long long)i,
                         hg_tensor_item(moved[t], i), expected);
    }
    hg_ctx_destroy(ctx);
}

/* ---- gradcheck itself ---- */

static hg_tensor *half_missing(void *self, hg_ctx *ctx, hg_tensor **in)
{
    (void)self;
    return hg_sum(ctx, hg_mul(ctx, hg_detach(ctx, in[0]), in[0]));
}

static hg_tensor *forgotten(void *self, hg_ctx *ctx, hg_tensor **in)
{
    (void)self;
    return hg_sum(ctx, hg_add(ctx, hg_scale(ctx, in[0], 0, 0), hg_square(ctx, hg_detach(ctx, in[0]))));
}

static hg_tensor *cubic(void *self, hg_ctx *ctx, hg_tensor **in)
{
    (void)self;
    return hg_sum(ctx, hg_mul(ctx, hg_square(ctx, in[0]), in[0]));
}

static hg_tensor *bent(void *self, hg_ctx *ctx, hg_tensor **in)
{
    (void)self;
    return hg_sum(ctx, hg_activate(ctx, in[0], HG_LEAKY_RELU));
}

/* The derivative to the right is half of what it should be: a wrong gradient, not a kink. */
static hg_tensor *bent_and_wrong(void *self, hg_ctx *ctx, hg_tensor **in)
{
    return hg_add(ctx, bent(self, ctx, in), half_missing(self, ctx, in));
}

static void test_gradcheck_kinks(void **state)
{
    (void)state;
    static const char *const names[] = { "slope" };
    const double units[] = { 1e-3 };
    const hg_gradcheck_options options = { .names = names, .units = units };
    hg_gradcheck_result r;
    hg_ctx *ctx = context(test_device(), 0);
    hg_tensor *x = hg_tensor_make(ctx, HG_F64, 2, (int64_t[]){ 2, 2 });
    hg_tensor_write(x, (double[]){ 0.5, 0, -2, 0 });
    assert_int_equal(hg_gradcheck(ctx, bent, NULL, 1, &x, &options, &r), HG_OK);
    assert_int_equal(r.kinks, 2);
    assert_int_equal(r.checked, 2);
    assert_true(r.steps > 0 && r.sweep[0].step == 1e-3 * 2 && r.sweep[0].error == r.worst);
    /* A kink excuses nothing that is wrong on both sides, and the worst element has its place in the message. */
    hg_tensor_write(x, (double[]){ 0.5, 0, -2, 0.25 });
    assert_int_equal(hg_gradcheck(ctx, bent_and_wrong, NULL, 1, &x, &options, &r), HG_NUMERIC);
    assert_int_equal(r.element, 2);
    if (!strstr(hg_message(), "slope[1,0]")) fail_msg("%s", hg_message());
    /* Nothing but kinks is nothing checked. */
    hg_tensor_fill(x, 0);
    assert_int_equal(hg_gradcheck(ctx, bent, NULL, 1, &x, &options, &r), HG_NUMERIC);
    assert_non_null(strstr(hg_message(), "kink"));
    hg_ctx_destroy(ctx);
}

static void test_gradcheck_sees(void **state)
{
    (void)state;
    hg_gradcheck_result r;
    hg_ctx *ctx = context(test_device(), 0);
    hg_tensor *x = hg_tensor_make(ctx, HG_F64, 1, (int64_t[]){ 3 });
    hg_tensor_write(x, (double[]){ 0.5, -1, 2 });
    assert_int_equal(hg_gradcheck(ctx, cubic, NULL, 1, &x, NULL, &r), HG_OK);
    assert_true(r.worst < 1e-8);
    assert_int_equal(hg_gradcheck(ctx, cubic, NULL, 1, &x, &(hg_gradcheck_options){ .directions = 4 }, &r), HG_OK);
    /* Half the gradient is missing. */
    assert_int_equal(hg_gradcheck(ctx, half_missing, NULL, 1, &x, NULL, &r), HG_NUMERIC);
    assert_true(fabs(r.worst - 0.5) < 1e-6);
    assert_non_null(strstr(hg_message(), "input 0"));
    /* All of it is. */
    assert_int_equal(hg_gradcheck(ctx, forgotten, NULL, 1, &x, NULL, &r), HG_NUMERIC);
    assert_non_null(strstr(hg_message(), "zero everywhere"));
    assert_int_equal(hg_ctx_status(ctx), HG_OK);
    /* The inputs are as they were. */
    assert_true(hg_tensor_item(x, 1) == -1);
    hg_ctx_destroy(ctx);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_every_op),
        cmocka_unit_test(test_incomplete_ops_fail),
        cmocka_unit_test(test_layout_of_every_type),
        cmocka_unit_test(test_gradcheck_sees),
        cmocka_unit_test(test_gradcheck_kinks),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
