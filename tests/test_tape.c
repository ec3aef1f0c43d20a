/* autograd/: the tape. Recording, backward, detached and gradient-free parts, overwritten tensors, errors, drawing, and
 * a steady state that takes no memory. */
#include "device.h"
#include "test.h"

#include "autograd/autograd.h"

static hg_ctx *make_ctx(void)
{
    hg_ctx *ctx;
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .device = test_device() }), HG_OK);
    return ctx;
}

static hg_tensor *leaf(hg_ctx *ctx, const char *name, int64_t n, const float *values)
{
    hg_tensor *x = hg_tensor_create(ctx, HG_F32, 1, &n);
    assert_int_equal(hg_tensor_write(x, values), HG_OK);
    assert_int_equal(hg_require_grad(x), HG_OK);
    x->name = name;
    return x;
}

static void gradient_is(const hg_tensor *x, int64_t n, const double *expected)
{
    assert_non_null(hg_grad(x));
    for (int64_t i = 0; i < n; i++)
        if (!(fabs(hg_tensor_item(hg_grad(x), i) - expected[i]) <= 1e-6))
            fail_msg("gradient %lld is %g, expected %g", (long long)i, hg_tensor_item(hg_grad(x), i), expected[i]);
}

static void test_manual_example(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx();
    hg_tensor *x = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 3, 4 });
    assert_int_equal(hg_tensor_fill(x, 1), HG_OK);
    hg_tensor *w = hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ 4, 2 });
    assert_int_equal(hg_tensor_fill(w, 0.5), HG_OK);
    assert_int_equal(hg_require_grad(w), HG_OK);
    hg_tensor *loss = hg_sum(ctx, hg_square(ctx, hg_matmul(ctx, x, w)));
    assert_int_equal(hg_backward(ctx, loss), HG_OK);
    assert_true(hg_tensor_item(loss, 0) == 24);
    for (int i = 0; i < 8; i++) assert_true(hg_tensor_item(hg_grad(w), i) == 12);
    hg_step_reset(ctx);
    assert_true(hg_tensor_item(hg_grad(w), 0) == 12); /* a leaf's gradient outlives the step */
    hg_tensor_destroy(w);
    hg_ctx_destroy(ctx);
}

/* d/da and d/db of sum(a b + a), a used twice; then again, and from another loss. */
static void test_backward_accumulates_within_and_zeroes_between(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx();
    hg_tensor *a = leaf(ctx, "a", 2, (float[]){ 2, 3 }), *b = leaf(ctx, "b", 2, (float[]){ 5, 7 });
    hg_tensor *c = leaf(ctx, "c", 1, (float[]){ 1 });
    hg_tensor *loss = hg_sum(ctx, hg_add(ctx, hg_mul(ctx, a, b), a));
    for (int i = 0; i < 2; i++) {
        assert_int_equal(hg_backward(ctx, loss), HG_OK);
        gradient_is(a, 2, (double[]){ 6, 8 });
        gradient_is(b, 2, (double[]){ 2, 3 });
        gradient_is(c, 1, (double[]){ 0 });
    }
    assert_int_equal(hg_backward(ctx, hg_sum(ctx, hg_square(ctx, b))), HG_OK);
    gradient_is(a, 2, (double[]){ 0, 0 }); /* takes no part in this loss */
    gradient_is(b, 2, (double[]){ 10, 14 });
    hg_tensor *owned[] = { a, b, c };
    for (int i = 0; i < 3; i++) hg_tensor_destroy(owned[i]);
    hg_ctx_destroy(ctx);
}

static void test_detach_and_no_grad(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx();
    hg_tensor *a = leaf(ctx, "a", 2, (float[]){ 2, 3 });
    assert_int_equal(hg_backward(ctx, hg_sum(ctx, hg_mul(ctx, a, hg_detach(ctx, a)))), HG_OK);
    gradient_is(a, 2, (double[]){ 2, 3 });
    hg_no_grad_begin(ctx);
    hg_no_grad_begin(ctx);
    hg_no_grad_end(ctx);
    int before = hg_tape_count(ctx);
    hg_tensor *square = hg_square(ctx, a);
    assert_int_equal(hg_tape_count(ctx), before);
    hg_no_grad_end(ctx);
    assert_false(hg_needs_grad(square));
    assert_true(hg_tensor_item(square, 1) == 9);
    assert_int_equal(hg_backward(ctx, square), HG_INVALID);
    assert_non_null(strstr(hg_ctx_message(ctx), "does not depend"));
    hg_ctx_clear(ctx);
    assert_int_equal(hg_backward(ctx, hg_sum(ctx, hg_mul(ctx, square, a))), HG_OK);
    gradient_is(a, 2, (double[]){ 4, 9 });
    hg_tensor_destroy(a);
    hg_ctx_destroy(ctx);
}

static void test_gradients_of_the_middle(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx();
    hg_tensor *a = leaf(ctx, "a", 2, (float[]){ 2, 3 });
    hg_tensor *middle = hg_square(ctx, a), *unused = hg_exp(ctx, a);
    hg_tensor *step_leaf = hg_tensor_make(ctx, HG_F32, 1, (int64_t[]){ 2 });
    assert_int_equal(hg_tensor_fill(step_leaf, 1), HG_OK);
    assert_int_equal(hg_require_grad(step_leaf), HG_OK);
    assert_null(hg_grad(middle));
    assert_int_equal(
        hg_backward(ctx, hg_sum(ctx, hg_mul(ctx, step_leaf, hg_reshape(ctx, middle, 1, (int64_t[]){ -1 })))), HG_OK);
    gradient_is(middle, 2, (double[]){ 1, 1 });
    gradient_is(step_leaf, 2, (double[]){ 4, 9 });
    assert_null(hg_grad(unused));
    hg_tensor_destroy(a);
    hg_ctx_destroy(ctx);
}

static void test_seeded(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx();
    hg_tensor *a = leaf(ctx, "a", 2, (float[]){ 2, 3 });
    hg_tensor *y = hg_square(ctx, a), *seed = hg_tensor_make(ctx, HG_F32, 1, (int64_t[]){ 2 });
    assert_int_equal(hg_tensor_write(seed, (float[]){ 10, 100 }), HG_OK);
    assert_int_equal(hg_backward_seeded(ctx, y, seed), HG_OK);
    gradient_is(a, 2, (double[]){ 40, 600 });
    assert_int_equal(hg_backward(ctx, y), HG_INVALID);
    assert_non_null(strstr(hg_ctx_message(ctx), "one element, not f32 [2]"));
    hg_ctx_clear(ctx);
    assert_int_equal(hg_backward_seeded(ctx, y, hg_tensor_make(ctx, HG_F32, 1, (int64_t[]){ 3 })), HG_INVALID);
    hg_tensor_destroy(a);
    hg_ctx_destroy(ctx);
}

static void test_overwritten(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx();
    hg_tensor *a = leaf(ctx, "stiffness", 2, (float[]){ 2, 3 });
    hg_tensor *middle = hg_exp(ctx, a);
    hg_tensor *loss = hg_sum(ctx, hg_square(ctx, middle));
    hg_tensor_touch(middle);
    assert_int_equal(hg_backward(ctx, loss), HG_INVALID);
    assert_non_null(strstr(hg_ctx_message(ctx), "backward of square"));
    assert_non_null(strstr(hg_ctx_message(ctx), "made by exp"));
    assert_non_null(strstr(hg_ctx_message(ctx), "test_tape.c:"));
    hg_ctx_clear(ctx);
    /* A leaf, through a view of it, and through rows of it. */
    loss = hg_sum(ctx, hg_square(ctx, hg_reshape(ctx, a, 2, (int64_t[]){ 2, 1 })));
    assert_int_equal(hg_backward(ctx, loss), HG_OK);
    assert_int_equal(hg_tensor_fill(hg_tensor_rows(ctx, a, 0, 1), 7), HG_OK);
    assert_int_equal(hg_backward(ctx, loss), HG_INVALID);
    assert_non_null(strstr(hg_ctx_message(ctx), "made by reshape"));
    hg_ctx_clear(ctx);
    loss = hg_sum(ctx, hg_mul(ctx, a, a));
    assert_int_equal(hg_tensor_fill(a, 1), HG_OK);
    assert_int_equal(hg_backward(ctx, loss), HG_INVALID);
    assert_non_null(strstr(hg_ctx_message(ctx), "stiffness"));
    hg_tensor_destroy(a);
    hg_ctx_destroy(ctx);
}

/* ---- errors ---- */

static void test_errors_run_through_a_formula(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx();
    hg_tensor *a = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 3, 4 }),
              *b = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 5, 2 });
    int line = __LINE__ + 1;
    hg_tensor *bad = hg_matmul(ctx, a, b);
    assert_null(bad);
    assert_null(hg_sum(ctx, hg_square(ctx, hg_add(ctx, bad, a)))); /* NULL goes through */
    char place[64];
    snprintf(place, sizeof place, "test_tape.c:%d)", line);
    assert_int_equal(hg_ctx_status(ctx), HG_INVALID);
    assert_non_null(strstr(hg_ctx_message(ctx), "matmul: "));
    assert_non_null(strstr(hg_ctx_message(ctx), "f32 [3,4], f32 [5,2]"));
    assert_non_null(strstr(hg_ctx_message(ctx), place));
    assert_int_equal(hg_backward(ctx, bad), HG_INVALID);
    hg_ctx_clear(ctx);
    assert_null(hg_add(ctx, NULL, a)); /* without an error before, NULL is one */
    assert_non_null(strstr(hg_ctx_message(ctx), "input 0 is NULL"));
    hg_ctx_clear(ctx);
    assert_null(hg_add(ctx, a, hg_tensor_make(ctx, HG_F64, 0, NULL)));
    assert_non_null(strstr(hg_ctx_message(ctx), "all f32 or all f64"));
    hg_ctx_clear(ctx);
    hg_tensor *index = hg_tensor_make(ctx, HG_I32, 1, (int64_t[]){ 2 });
    assert_int_equal(hg_tensor_write(index, (int32_t[]){ 1, 3 }), HG_OK);
    assert_null(hg_gather(ctx, a, index));
    assert_non_null(strstr(hg_ctx_message(ctx), "index 1 is 3, there are 3 rows"));
    hg_ctx_clear(ctx);
    assert_int_equal(hg_require_grad(index), HG_INVALID);
    hg_ctx_clear(ctx);
    hg_ctx *other = make_ctx();
    assert_null(hg_add(ctx, a, hg_tensor_make(other, HG_F32, 0, NULL)));
    assert_non_null(strstr(hg_ctx_message(ctx), "another context"));
    hg_ctx_destroy(other);
    hg_ctx_destroy(ctx);
}

/* Every refusal of a shape rule says which op it was. */
static void test_refusals_name_their_op(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx();
    hg_tensor *m = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 3, 4 }),
              *v = hg_tensor_make(ctx, HG_F32, 1, (int64_t[]){ 3 });
    hg_tensor *scalar = hg_tensor_make(ctx, HG_F32, 0, NULL), *index = hg_tensor_make(ctx, HG_I32, 1, (int64_t[]){ 4 });
#define REFUSED(name_, call_)                                                                                          \
    do {                                                                                                               \
        assert_null(call_);                                                                                            \
        assert_int_equal(hg_ctx_status(ctx), HG_INVALID);                                                              \
        if (strncmp(hg_ctx_message(ctx), name_ ": ", strlen(name_) + 2) != 0) fail_msg("%s", hg_ctx_message(ctx));     \
        hg_ctx_clear(ctx);                                                                                             \
    } while (0)
    REFUSED("add", hg_add(ctx, m, v));
    REFUSED("linear", hg_linear(ctx, m, m, NULL, HG_TANH));
    REFUSED("linear", hg_linear(ctx, v, m, v, HG_TANH));
    REFUSED("linear", hg_linear(ctx, v, m, NULL, (hg_activation)99));
    REFUSED("linear_pair", hg_linear_pair(ctx, m, v, HG_TANH));
    REFUSED("activate", hg_activate(ctx, m, (hg_activation)-1));
    REFUSED("square", hg_square(ctx, index));
    REFUSED("sum_axis", hg_sum_axis(ctx, m, 2, false));
    REFUSED("mean_axis", hg_mean_axis(ctx, m, -3, false));
    REFUSED("reshape", hg_reshape(ctx, m, 2, (int64_t[]){ 5, -1 }));
    REFUSED("reshape", hg_reshape(ctx, m, 2, (int64_t[]){ -1, -1 }));
    REFUSED("reshape", hg_reshape(ctx, m, 1, (int64_t[]){ 11 }));
    REFUSED("permute", hg_permute(ctx, m, (int[]){ 0, 0 }));
    REFUSED("concat", hg_concat(ctx, 0, 2, (hg_tensor *[]){ m, v }));
    REFUSED("concat", hg_concat(ctx, 5, 1, (hg_tensor *[]){ m }));
    hg_tensor *many[HG_OP_INPUTS + 1];
    for (int i = 0; i <= HG_OP_INPUTS; i++) many[i] = m;
    REFUSED("concat", hg_concat(ctx, 0, HG_OP_INPUTS + 1, many));
    REFUSED("slice", hg_slice(ctx, m, 1, 3, 2));
    REFUSED("pad", hg_pad(ctx, m, 1, -1, 0));
    REFUSED("gather", hg_gather(ctx, m, v));
    REFUSED("scatter_add", hg_scatter_add(ctx, m, index, 3));
    REFUSED("softmax", hg_softmax(ctx, scalar));
    REFUSED("layer_norm", hg_layer_norm(ctx, m, v, NULL, 1e-5));
    REFUSED("layer_norm", hg_layer_norm(ctx, m, NULL, NULL, 0));
    REFUSED("group_norm", hg_group_norm(ctx, m, NULL, NULL, 3, 1e-5));
    REFUSED("group_norm", hg_group_norm(ctx, m, NULL, NULL, 0, 1e-5));
    REFUSED("dot", hg_dot(ctx, m, v));
    REFUSED("cross", hg_cross(ctx, m, m));
    REFUSED("quat_rotate", hg_quat_rotate(ctx, m, m));
    REFUSED("norm", hg_norm(ctx, scalar));
    REFUSED("place", hg_place(ctx, m, m, m, m));
    hg_ctx_destroy(ctx);
}

static hg_tensor *same_shape(hg_call *call)
{
    return hg_tensor_make(call->ctx, call->in[0]->dtype, call->in[0]->rank, call->in[0]->shape);
}
static hg_status copy_forward(hg_call *call) { return hg_tensor_copy(call->out, call->in[0]); }
static hg_status failing_backward(hg_call *call) { return (void)call, hg_fail(HG_NUMERIC, "no way back"); }
static hg_status add_backward(hg_call *call)
{
    float g[2], d[2];
    HG_TRY(hg_tensor_read(hg_grad(call->out), g));
    HG_TRY(hg_tensor_read(hg_grad(call->in[0]), d));
    for (int i = 0; i < 2; i++) d[i] += 3 * g[i];
    return hg_tensor_write(hg_grad(call->in[0]), d);
}

static void test_ops_of_ones_own(void **state)
{
    (void)state;
    const hg_op mute = { .name = "mute", .min_in = 1, .max_in = 1, .shape = same_shape, .forward = copy_forward };
    hg_op cut = mute, failing = mute, tripled = mute;
    cut.name = "cut", cut.not_differentiable = true;
    failing.name = "failing", failing.backward = failing_backward;
    tripled.name = "tripled", tripled.backward = add_backward;
    hg_ctx *ctx = make_ctx();
    hg_tensor *a = leaf(ctx, "a", 2, (float[]){ 2, 3 });
    /* No backward: refused when it is recorded, fine without a gradient. */
    assert_null(hg_apply(ctx, &mute, 1, &a, NULL));
    assert_non_null(strstr(hg_ctx_message(ctx), "mute: it has no backward"));
    hg_ctx_clear(ctx);
    hg_tensor *detached = hg_detach(ctx, a);
    assert_non_null(hg_apply(ctx, &mute, 1, &detached, NULL));
    assert_false(hg_needs_grad(hg_apply(ctx, &cut, 1, &a, NULL)));
    assert_int_equal(hg_backward(ctx, hg_sum(ctx, hg_apply(ctx, &failing, 1, &a, NULL))), HG_NUMERIC);
    assert_non_null(strstr(hg_ctx_message(ctx), "backward of failing"));
    assert_non_null(strstr(hg_ctx_message(ctx), "no way back"));
    hg_ctx_clear(ctx);
    /* Adding into zeroed gradients is all that a backward has to know. */
    hg_tensor *y = hg_add(ctx, hg_apply(ctx, &tripled, 1, &a, NULL), hg_apply(ctx, &tripled, 1, &a, NULL));
    for (int i = 0; i < 2; i++) {
        assert_int_equal(hg_backward(ctx, hg_sum(ctx, y)), HG_OK);
        gradient_is(a, 2, (double[]){ 6, 6 });
    }
    hg_tensor_destroy(a);
    hg_ctx_destroy(ctx);
}

/* Of a device's index the numbers are read back once, and again after it was overwritten; also through a view of it. */
static void test_index_is_analysed_once(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx();
    hg_tensor *a = leaf(ctx, "a", 3, (float[]){ 2, 3, 5 }), *index = hg_tensor_create(ctx, HG_I32, 1, (int64_t[]){ 4 });
    assert_int_equal(hg_tensor_write(index, (int32_t[]){ 2, 0, 2, 1 }), HG_OK);
    for (int round = 0; round < 3; round++) {
        const int64_t before = hg_ctx_counts(ctx).downloaded;
        hg_tensor *view = round == 2 ? hg_tensor_rows(ctx, index, 1, 2) : index; /* 1, 0 of the second one */
        assert_int_equal(hg_backward(ctx, hg_sum(ctx, hg_square(ctx, hg_gather(ctx, a, view)))), HG_OK);
        if (round == 1) assert_int_equal(hg_ctx_counts(ctx).downloaded, before);
        gradient_is(a, 3, round == 2 ? (double[]){ 4, 6, 0 } : (double[]){ 4, 6, 20 });
        if (round == 1) assert_int_equal(hg_tensor_write(index, (int32_t[]){ 2, 1, 0, 9 }), HG_OK);
        hg_step_reset(ctx);
    }
    assert_null(hg_gather(ctx, a, index));
    assert_non_null(strstr(hg_ctx_message(ctx), "index 3 is 9, there are 3 rows"));
    hg_ctx_clear(ctx);
    /* Rows of what has no gradient are taken too. */
    assert_int_equal(hg_tensor_write(index, (int32_t[]){ 2, 1, 0, 1 }), HG_OK);
    hg_tensor *half = hg_tensor_make(ctx, HG_BF16, 1, (int64_t[]){ 3 });
    assert_int_equal(hg_tensor_copy(half, a), HG_OK);
    assert_true(hg_tensor_item(hg_gather(ctx, half, index), 0) == 5);
    hg_tensor_destroy(index);
    hg_tensor_destroy(a);
    hg_ctx_destroy(ctx);
}

/* ---- export, drawing, steady state ---- */

static void test_record_all_and_dot(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx();
    hg_tensor *a = leaf(ctx, "a", 2, (float[]){ 2, 3 }), *constant = hg_tensor_make(ctx, HG_F32, 0, NULL);
    assert_int_equal(hg_tensor_fill(constant, 2), HG_OK);
    hg_scale(ctx, constant, 2, 0);
    assert_int_equal(hg_tape_count(ctx), 0);
    hg_tape_record_all(ctx, true);
    hg_tensor *two = hg_scale(ctx, constant, 1, 0);
    hg_tensor *loss = hg_sum(ctx, hg_mul(ctx, a, two));
    assert_int_equal(hg_tape_count(ctx), 3);
    assert_string_equal(hg_tape_call(ctx, 0)->op->name, "scale");
    assert_ptr_equal(hg_tape_call(ctx, 2)->out, loss);
    assert_null(hg_tape_call(ctx, 3));
    assert_int_equal(hg_backward(ctx, loss), HG_OK);
    gradient_is(a, 2, (double[]){ 2, 2 });
    hg_text dot = { 0 };
    assert_int_equal(hg_graph_dot(ctx, &dot), HG_OK);
    const char *parts[] = { "digraph", "mul", "f32 [2]", "gradient", "a\\n", "->", "}" };
    for (size_t i = 0; i < sizeof parts / sizeof *parts; i++)
        if (!strstr(dot.data, parts[i])) fail_msg("\"%s\" is not in %s", parts[i], dot.data);
    hg_text_free(&dot);
    hg_step_reset(ctx);
    assert_int_equal(hg_tape_count(ctx), 0);
    hg_tensor_destroy(a);
    hg_ctx_destroy(ctx);
}

static void test_trap(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx();
    char *path = test_path("trap.h5");
    hg_tensor *a = leaf(ctx, "a", 3, (float[]){ 1, -1, 4 }), *zero = leaf(ctx, "zero", 3, (float[]){ 0, 0, 0 });
    assert_non_null(hg_log(ctx, a)); /* nothing is said without the trap */
    hg_trap_nan(ctx, true, path);
    assert_null(hg_log(ctx, a));
    assert_int_equal(hg_ctx_status(ctx), HG_NUMERIC);
    assert_non_null(strstr(hg_ctx_message(ctx), "log (recorded at "));
    assert_non_null(strstr(hg_ctx_message(ctx), "the output, f32 [3], is "));
    assert_non_null(strstr(hg_ctx_message(ctx), "nan at [1]"));
    assert_null(strstr(hg_ctx_message(ctx), "already"));
    hg_h5 *file;
    float *input;
    assert_int_equal(hg_h5_open(&file, path), HG_OK);
    assert_int_equal(hg_h5_read(file, "input_0", HG_F32, 1, (int64_t[]){ 3 }, NULL, (void **)&input), HG_OK);
    assert_true(input[1] == -1);
    hg_free(input);
    hg_h5_close(file);
    hg_ctx_clear(ctx);
    /* A call with attributes, in its backward: run again from its file, and in f64, where nothing overflows. */
    float large[3] = { 1e19f, 2e19f, 3 };
    hg_tensor *big = leaf(ctx, "big", 3, large), *line = hg_reshape(ctx, big, 2, (int64_t[]){ 3, 1 });
    hg_tensor *squares = hg_sum_axis(ctx, line, 0, false), *far = hg_tensor_make(ctx, HG_F32, 1, (int64_t[]){ 1 });
    assert_non_null(squares);
    assert_int_equal(hg_tensor_fill(far, 3e38), HG_OK);
    assert_int_equal(hg_ctx_status(ctx), HG_OK);
    assert_null(hg_mul(ctx, squares, far));
    assert_non_null(strstr(hg_ctx_message(ctx), "hairgrad replay "));
    hg_ctx_clear(ctx);
    hg_text report = { 0 };
    assert_int_equal(hg_trap_replay(ctx, path, &report), HG_OK);
    assert_non_null(strstr(report.data, "mul: "));
    assert_non_null(strstr(report.data, ", inf at [0]"));
    assert_null(strstr(strstr(report.data, "in f64"), "inf"));
    hg_text_free(&report);
    /* One that is no trap's. */
    assert_int_equal(hg_h5_create(&file, path), HG_OK);
    assert_int_equal(hg_h5_set_text(file, "/", "op", "mull"), HG_OK);
    assert_int_equal(hg_h5_commit(file), HG_OK);
    assert_int_equal(hg_trap_replay(ctx, path, &report), HG_INVALID);
    assert_non_null(strstr(hg_message(), "\"mull\", which is not known"));
    hg_tensor_destroy(big);
    hg_ctx_clear(ctx);
    /* Finite forward, not backward; and a file that cannot be written. */
    hg_trap_nan(ctx, true, "/no/such/folder/trap.h5");
    hg_tensor *y = hg_sum(ctx, hg_scale(ctx, hg_add(ctx, a, zero), 1e30, 0)),
              *seed = hg_tensor_make(ctx, HG_F32, 0, NULL);
    assert_int_equal(hg_tensor_fill(seed, 1e30), HG_OK);
    assert_int_equal(hg_ctx_status(ctx), HG_OK);
    assert_int_equal(hg_backward_seeded(ctx, y, seed), HG_NUMERIC);
    assert_non_null(strstr(hg_ctx_message(ctx), "scale (recorded"));
    assert_non_null(strstr(hg_ctx_message(ctx), "the gradient of input 0, f32 [3], is inf at [0]"));
    assert_non_null(strstr(hg_ctx_message(ctx), "could not be written"));
    hg_ctx_clear(ctx);
    hg_trap_nan(ctx, false, NULL);
    assert_non_null(hg_log(ctx, a));
    hg_free(path);
    hg_tensor_destroy(a);
    hg_tensor_destroy(zero);
    hg_ctx_destroy(ctx);
}

static void test_steady_state(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx();
    hg_tensor *w = hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ 30, 40 }),
              *b = hg_tensor_create(ctx, HG_F32, 1, (int64_t[]){ 40 });
    assert_int_equal(hg_require_grad(w), HG_OK);
    assert_int_equal(hg_require_grad(b), HG_OK);
    size_t reserved = 0;
    for (int step = 0; step < 8; step++) {
        hg_step_reset(ctx);
        hg_tensor *x = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 2000, 30 });
        assert_int_equal(hg_tensor_fill(x, 0.1 * step), HG_OK);
        hg_tensor *h = hg_linear(ctx, x, w, b, HG_SILU);
        hg_tensor *y = hg_linear(ctx, h, w, NULL, HG_GELU);
        assert_null(y); /* 40 inputs into 30: a step that fails must not leak or poison the next */
        hg_ctx_clear(ctx);
        assert_int_equal(hg_backward(ctx, hg_sum(ctx, hg_square(ctx, h))), HG_OK);
        if (step == 1) reserved = hg_step_reserved(ctx);
        if (step > 1) assert_int_equal(hg_step_reserved(ctx), reserved);
    }
    hg_tensor_destroy(w);
    hg_tensor_destroy(b);
    hg_ctx_destroy(ctx);
}

/* A layer as wide as a real one, on so many rows that a chunk is longer than a tile: gradients of x, W and b. */
static void run_layer(int threads, hg_dtype dtype, int64_t rows, int64_t in, int64_t out, void *gradient[3])
{
    hg_ctx *ctx;
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = threads, .device = test_device() }), HG_OK);
    hg_tensor *t[3] = { hg_tensor_make(ctx, dtype, 2, (int64_t[]){ rows, in }),
                        hg_tensor_make(ctx, dtype, 2, (int64_t[]){ in, out }), hg_tensor_make(ctx, dtype, 1, &out) };
    for (int i = 0; i < 3; i++) {
        const int64_t count = hg_tensor_count(t[i]);
        float *numbers = hg_alloc((size_t)count, sizeof *numbers);
        for (int64_t e = 0; e < count; e++) numbers[e] = (float)(hg_random_uniform(3, (uint64_t)i, (uint64_t)e) - 0.5);
        assert_int_equal(hg_tensor_copy(t[i], hg_tensor_from(ctx, HG_F32, t[i]->rank, t[i]->shape, numbers)), HG_OK);
        hg_free(numbers);
        assert_int_equal(hg_require_grad(t[i]), HG_OK);
    }
    hg_tensor *y = hg_linear(ctx, t[0], t[1], t[2], HG_SILU);
    assert_int_equal(hg_backward_seeded(ctx, y, y), HG_OK);
    for (int i = 0; i < 3; i++) {
        gradient[i] = hg_alloc(hg_tensor_bytes(t[i]), 1);
        assert_int_equal(hg_tensor_read(hg_grad(t[i]), gradient[i]), HG_OK);
    }
    hg_ctx_destroy(ctx);
}

static void test_same_bits_at_size(void **state)
{
    (void)state;
    const int64_t sizes[][3] = { { 8500, 20, 24 }, { 3000, 66, 256 }, { 1000, 256, 72 } };
    for (int s = 0; s < 3; s++) {
        const int64_t rows = sizes[s][0], in = sizes[s][1], out = sizes[s][2], count[3] = { rows * in, in * out, out };
        void *of[4][3];
        for (int threads = 1; threads <= 3; threads++) run_layer(threads, HG_F32, rows, in, out, of[threads - 1]);
        run_layer(2, HG_F64, rows, in, out, of[3]);
        for (int i = 0; i < 3; i++) {
            for (int threads = 2; threads <= 3; threads++)
                assert_memory_equal(of[0][i], of[threads - 1][i], (size_t)count[i] * sizeof(float));
            double largest = 0, worst = 0;
            for (int64_t e = 0; e < count[i]; e++) {
                largest = fmax(largest, fabs(((double *)of[3][i])[e]));
                worst = fmax(worst, fabs((double)((float *)of[0][i])[e] - ((double *)of[3][i])[e]));
            }
            assert_true(largest > 0 && worst <= 2e-6 * largest);
            for (int r = 0; r < 4; r++) hg_free(of[r][i]);
        }
    }
}

static void test_activation_names(void **state)
{
    (void)state;
    hg_activation activation;
    assert_int_equal(hg_activation_parse("silu", &activation), HG_OK);
    assert_int_equal(activation, HG_SILU);
    assert_int_equal(hg_activation_parse("tahn", &activation), HG_INVALID);
    assert_non_null(strstr(hg_message(), "tanh"));
    assert_non_null(strstr(hg_activation_names(), "gelu|softplus"));
}

/* The vectorised functions over their whole range, ends included. */
static void test_f32_functions(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx();
    enum { N = 40001 };
    hg_tensor *x = hg_tensor_make(ctx, HG_F32, 1, (int64_t[]){ N }),
              *wide = hg_tensor_make(ctx, HG_F64, 1, (int64_t[]){ N });
    float *arguments = hg_alloc(N, sizeof *arguments), *values = hg_alloc(N, sizeof *values);
    double *exact = hg_alloc(N, sizeof *exact);
    for (int i = 0; i < N; i++) arguments[i] = (float)(i - N / 2) * 0.006f; /* -120 .. 120 */
    assert_int_equal(hg_tensor_write(x, arguments), HG_OK);
    assert_int_equal(hg_tensor_copy(wide, x), HG_OK);
    /* What an argument's rounding or a difference leaves, beside a relative error of a few units in the last place. */
    const struct {
        hg_activation activation;
        double absolute;
    } functions[] = { { HG_IDENTITY, 1e-36 }, { HG_TANH, 1e-36 },     { HG_SIGMOID, 1e-36 }, { HG_SILU, 1e-36 },
                      { HG_GELU, 1e-7 },      { HG_SOFTPLUS, 1e-36 }, { HG_ELU, 1e-7 } };
    for (int f = 0; f < 7; f++) { /* 0 stands for exp */
        hg_tensor *y = f ? hg_activate(ctx, x, functions[f].activation) : hg_exp(ctx, x);
        hg_tensor *z = f ? hg_activate(ctx, wide, functions[f].activation) : hg_exp(ctx, wide);
        assert_int_equal(hg_tensor_read(y, values), HG_OK);
        assert_int_equal(hg_tensor_read(z, exact), HG_OK);
        for (int i = 0; i < N; i++) {
            const double found = (double)values[i], expected = exact[i];
            if (expected > 3.4028235677e38)
                assert_true(isinf(found));
            else if (!(fabs(found - expected) <= 6e-7 * fabs(expected) + functions[f].absolute))
                fail_msg("function %d at %g: %.9g, expected %.9g", f, (double)arguments[i], found, expected);
        }
    }
    hg_free(arguments);
    hg_free(values);
    hg_free(exact);
    const float odd[] = { NAN, INFINITY, -INFINITY, 0.0f };
    const double limits[][4] = { { (double)NAN, (double)INFINITY, 0, 1 }, { (double)NAN, 1, -1, 0 } };
    hg_tensor *o = hg_tensor_make(ctx, HG_F32, 1, (int64_t[]){ 4 });
    assert_int_equal(hg_tensor_write(o, odd), HG_OK);
    hg_tensor *results[] = { hg_exp(ctx, o), hg_activate(ctx, o, HG_TANH) };
    for (int f = 0; f < 2; f++)
        for (int i = 0; i < 4; i++) {
            double found = hg_tensor_item(results[f], i);
            assert_true(isnan(limits[f][i]) ? isnan(found) : found == limits[f][i]);
        }
    hg_ctx_destroy(ctx);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_manual_example),
        cmocka_unit_test(test_backward_accumulates_within_and_zeroes_between),
        cmocka_unit_test(test_detach_and_no_grad),
        cmocka_unit_test(test_gradients_of_the_middle),
        cmocka_unit_test(test_seeded),
        cmocka_unit_test(test_overwritten),
        cmocka_unit_test(test_errors_run_through_a_formula),
        cmocka_unit_test(test_refusals_name_their_op),
        cmocka_unit_test(test_ops_of_ones_own),
        cmocka_unit_test(test_index_is_analysed_once),
        cmocka_unit_test(test_record_all_and_dot),
        cmocka_unit_test(test_trap),
        cmocka_unit_test(test_steady_state),
        cmocka_unit_test(test_same_bits_at_size),
        cmocka_unit_test(test_activation_names),
        cmocka_unit_test(test_f32_functions),
    };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
