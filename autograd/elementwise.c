/* Elementwise ops: add, sub, mul, div, minimum, maximum (broadcasting), scale, square, sqrt, exp, log, abs, clamp,
 * activate, cast. Conventions at the kinks: ties of minimum and maximum go to a; sqrt and abs have gradient 0 at 0. */
#include "autograd/elementwise.kernel.h"

#include <string.h>

/* ---- binary ---- */

static hg_tensor *binary_shape(hg_call *call)
{
    hg_broadcast plan;
    int rank;
    int64_t shape[HG_MAX_RANK];
    if (!hg_floats_agree(call) || !hg_broadcast_plan(call, 0, &plan, &rank, shape)) return NULL;
    return hg_out(call, call->in[0]->dtype, rank, shape);
}

static void binary_reference(const hg_call *call, double *out, double (*f)(double, double))
{
    for (int64_t i = 0; i < hg_tensor_count(call->out); i++) {
        int64_t at[2];
        hg_pair_items(call, 0, i, at);
        out[i] = f(hg_tensor_item(call->in[0], at[0]), hg_tensor_item(call->in[1], at[1]));
    }
}

static double add_of(double a, double b) { return a + b; }
static double sub_of(double a, double b) { return a - b; }
static double mul_of(double a, double b) { return a * b; }
static double div_of(double a, double b) { return a / b; }
static double minimum_of(double a, double b) { return fmin(a, b); }
static double maximum_of(double a, double b) { return fmax(a, b); }

static bool tie_kink(const hg_call *call, int in, int64_t element, double step)
{
    const hg_tensor *x = call->in[in], *other = call->in[1 - in];
    for (int64_t i = 0; i < hg_tensor_count(other); i++) /* near any element of the other: safe, if a little wide */
        if (fabs(hg_tensor_item(x, element) - hg_tensor_item(other, i)) < 2 * step) return true;
    return false;
}

#define PAIR(label_, ra_, sa_, rb_, sb_, low_)                                                                         \
    {                                                                                                                  \
        .label = label_, .n_in = 2, .in = {                                                                            \
            { ra_, SHAPE sa_ },                                                                                        \
            { rb_, SHAPE sb_, .low = low_, .high = low_ == 0 ? 0 : low_ + 1 }                                          \
        }                                                                                                              \
    }
#define SHAPE(...)                                                                                                     \
    {                                                                                                                  \
        __VA_ARGS__                                                                                                    \
    }
#define PAIRS(low_)                                                                                                    \
    PAIR("same shape", 2, (3, 4), 2, (3, 4), low_), PAIR("row", 2, (3, 4), 1, (4), low_),                              \
        PAIR("column", 2, (3, 4), 2, (3, 1), low_), PAIR("outer", 2, (3, 1), 2, (1, 4), low_),                         \
        PAIR("middle", 3, (2, 3, 4), 3, (2, 1, 4), low_), PAIR("middle of a", 4, (2, 1, 2, 1), 3, (3, 2, 2), low_),    \
        PAIR("scalar b", 2, (3, 4), 0, (0), low_), PAIR("scalar a", 0, (0), 2, (3, 4), low_),                          \
        PAIR("empty", 2, (0, 4), 1, (4), low_), PAIR("two blocks, row", 2, (1500, 3), 1, (3), low_),                   \
        PAIR("two blocks, column", 2, (3, 1500), 2, (3, 1), low_),                                                     \
        PAIR("rows of several tiles", 2, (7, 70), 1, (70), low_),                                                      \
        PAIR("three chunks, scalar", 1, (9001), 0, (0), low_)

static const hg_sample plain_pairs[] = { PAIRS(0), PAIR("one", 1, (1), 1, (1), 0) };
static const hg_sample positive_pairs[] = { PAIRS(0.5), PAIR("one", 1, (1), 1, (1), 0.5) };
static const hg_sample tie_pairs[] = {
    PAIRS(0), { .label = "one", .n_in = 2, .in = { { 1, { 1 } }, { 1, { 1 } } }, .zero_gradient = true }
};

#define BINARY_OP(NAME_, FORMULA_, ONNX_, SAMPLES_, ...)                                                               \
    static hg_status NAME_##_forward(hg_call *call) { return hg_pair_forward(call, 0, &NAME_##_kernels); }             \
    static hg_status NAME_##_backward(hg_call *call) { return hg_pair_backward(call, 0, &NAME_##_kernels); }           \
    static void NAME_##_reference(const hg_call *call, double *out) { binary_reference(call, out, NAME_##_of); }       \
    static hg_status NAME_##_emit(const hg_call *call, hg_emitter *e) { return hg_emit_one(call, e, ONNX_); }          \
    HG_OP(NAME_, .formula = FORMULA_, .min_in = 2, .max_in = 2, .shape = binary_shape, .forward = NAME_##_forward,     \
          .backward = NAME_##_backward, .samples = SAMPLES_, .n_samples = sizeof SAMPLES_ / sizeof *SAMPLES_,          \
          .reference = NAME_##_reference, .emit = NAME_##_emit, __VA_ARGS__);                                          \
    hg_tensor *hg_##NAME_(hg_ctx *ctx, hg_tensor *a, hg_tensor *b)                                                     \
    {                                                                                                                  \
        return hg_apply(ctx, &op_##NAME_, 2, (hg_tensor *[]){ a, b }, NULL);                                           \
    }

BINARY_OP(add, "a + b", "Add", plain_pairs, .kink = NULL)
BINARY_OP(sub, "a - b", "Sub", plain_pairs, .kink = NULL)
BINARY_OP(mul, "a b", "Mul", plain_pairs, .kink = NULL)
BINARY_OP(div, "a / b", "Div", positive_pairs, .kink = NULL)
BINARY_OP(minimum, "min(a, b), ties to a", "Min", tie_pairs, .kink = tie_kink)
BINARY_OP(maximum, "max(a, b), ties to a", "Max", tie_pairs, .kink = tie_kink)

/* ---- unary ---- */

typedef struct {
    double numbers[2];
} unary_attributes;

static hg_tensor *unary_shape(hg_call *call) { return hg_floats_agree(call) ? hg_out_like(call, call->in[0]) : NULL; }

static unary_args unary_arguments(const hg_call *call)
{
    unary_args args = { .x = call->in[0]->data, .y = call->out->data };
    if (call->attributes) memcpy(args.numbers, call->attributes, sizeof args.numbers);
    return args;
}

static hg_status unary_forward(hg_call *call, const hg_kernel *const *kernels)
{
    unary_args args = unary_arguments(call);
    args.to = call->out->data;
    return hg_launch(call->ctx, kernels[call->out->dtype == HG_F64], hg_tensor_count(call->out), &args);
}

static hg_status unary_backward(hg_call *call, const hg_kernel *const *kernels)
{
    bool fresh;
    unary_args args = unary_arguments(call);
    args.g = hg_grad(call->out)->data;
    args.to = hg_grad_data(call->in[0], &fresh);
    args.fresh = fresh;
    return hg_launch(call->ctx, kernels[call->out->dtype == HG_F64], hg_tensor_count(call->out), &args);
}

#define UNARY_SAMPLES(low_, high_, ...)                                                                                \
    { .label = "matrix", .n_in = 1, .in = { { 2, { 3, 5 }, .low = low_, .high = high_ } }, __VA_ARGS__ },              \
        { .label = "scalar", .n_in = 1, .in = { { 0, { 0 }, .low = low_, .high = high_ } }, __VA_ARGS__ },             \
        { .label = "empty", .n_in = 1, .in = { { 2, { 0, 5 }, .low = low_, .high = high_ } }, __VA_ARGS__ },           \
    {                                                                                                                  \
        .label = "two blocks", .n_in = 1, .in = { { 1, { 5001 }, .low = low_, .high = high_ } }, __VA_ARGS__           \
    }

#define UNARY_OP(NAME_, FORMULA_, SIZE_, SAMPLES_, KINK_)                                                              \
    static hg_status NAME_##_forward(hg_call *call) { return unary_forward(call, NAME_##_forward_kernels); }           \
    static hg_status NAME_##_backward(hg_call *call) { return unary_backward(call, NAME_##_backward_kernels); }        \
    static void NAME_##_reference(const hg_call *call, double *out)                                                    \
    {                                                                                                                  \
        for (int64_t i = 0; i < hg_tensor_count(call->in[0]); i++)                                                     \
            out[i] = NAME_##_of(hg_tensor_item(call->in[0], i), call->attributes);                                     \
    }                                                                                                                  \
    HG_OP(NAME_, .formula = FORMULA_, .min_in = 1, .max_in = 1, .attributes_size = SIZE_, .shape = unary_shape,        \
          .forward = NAME_##_forward, .backward = NAME_##_backward, .samples = SAMPLES_,                               \
          .n_samples = sizeof SAMPLES_ / sizeof *SAMPLES_, .reference = NAME_##_reference, .kink = KINK_,              \
          .emit = NAME_##_emit)

static double scale_of(double x, const double *numbers) { return numbers[0] * x + numbers[1]; }
static double square_of(double x, const double *numbers) { return (void)numbers, x * x; }
static double sqrt_of(double x, const double *numbers) { return (void)numbers, sqrt(x); }
static double exp_of(double x, const double *numbers) { return (void)numbers, exp(x); }
static double log_of(double x, const double *numbers) { return (void)numbers, log(x); }
static double abs_of(double x, const double *numbers) { return (void)numbers, fabs(x); }
static double clamp_of(double x, const double *numbers) { return fmin(fmax(x, numbers[0]), numbers[1]); }

static hg_status scale_emit(const hg_call *call, hg_emitter *e)
{
    const unary_attributes *attributes = call->attributes;
    int y = e->input(e->self, call->in[0]);
    y = e->node(e->self, "Mul", 2, (int[]){ y, hg_emit_scalar(e, attributes->numbers[0]) }, "");
    if (attributes->numbers[1] != 0)
        y = e->node(e->self, "Add", 2, (int[]){ y, hg_emit_scalar(e, attributes->numbers[1]) }, "");
    return e->output(e->self, call->out, y);
}

static hg_status square_emit(const hg_call *call, hg_emitter *e)
{
    int x = e->input(e->self, call->in[0]);
    return e->output(e->self, call->out, e->node(e->self, "Mul", 2, (int[]){ x, x }, ""));
}

static hg_status sqrt_emit(const hg_call *call, hg_emitter *e) { return hg_emit_one(call, e, "Sqrt"); }
static hg_status exp_emit(const hg_call *call, hg_emitter *e) { return hg_emit_one(call, e, "Exp"); }
static hg_status log_emit(const hg_call *call, hg_emitter *e) { return hg_emit_one(call, e, "Log"); }
static hg_status abs_emit(const hg_call *call, hg_emitter *e) { return hg_emit_one(call, e, "Abs"); }

static hg_status clamp_emit(const hg_call *call, hg_emitter *e)
{
    const unary_attributes *attributes = call->attributes;
    int in[3] = { e->input(e->self, call->in[0]), hg_emit_scalar(e, attributes->numbers[0]),
                  hg_emit_scalar(e, attributes->numbers[1]) };
    return e->output(e->self, call->out, e->node(e->self, "Clip", 3, in, ""));
}

static bool abs_kink(const hg_call *call, int in, int64_t element, double step)
{
    return fabs(hg_tensor_item(call->in[in], element)) < 2 * step;
}

static bool clamp_kink(const hg_call *call, int in, int64_t element, double step)
{
    const double *numbers = call->attributes, x = hg_tensor_item(call->in[in], element);
    return fabs(x - numbers[0]) < 2 * step || fabs(x - numbers[1]) < 2 * step;
}

static const hg_sample plain_samples[] = { UNARY_SAMPLES(-2, 2, ) };
static const hg_sample positive_samples[] = { UNARY_SAMPLES(0.25, 4, ) };
static const hg_sample scale_samples[] = { UNARY_SAMPLES(-2, 2,
                                                         .attributes = &(const unary_attributes){ { -1.5, 0.25 } }) };
static const hg_sample clamp_samples[] = { UNARY_SAMPLES(-0.6, 0.9,
                                                         .attributes = &(const unary_attributes){ { -0.5, 0.75 } }) };

UNARY_OP(scale, "p x + q", sizeof(unary_attributes), scale_samples, NULL);
UNARY_OP(square, "x^2", 0, plain_samples, NULL);
UNARY_OP(sqrt, "sqrt(x), gradient 0 at 0", 0, positive_samples, NULL);
UNARY_OP(exp, "exp(x)", 0, plain_samples, NULL);
UNARY_OP(log, "log(x)", 0, positive_samples, NULL);
UNARY_OP(abs, "|x|, gradient 0 at 0", 0, plain_samples, abs_kink);
UNARY_OP(clamp, "min(max(x, p), q)", sizeof(unary_attributes), clamp_samples, clamp_kink);

static hg_tensor *apply_unary(hg_ctx *ctx, const hg_op *op, hg_tensor *a, double p, double q)
{
    return hg_apply(ctx, op, 1, &a, &(unary_attributes){ { p, q } });
}
hg_tensor *hg_scale(hg_ctx *ctx, hg_tensor *a, double scale, double shift)
{
    return apply_unary(ctx, &op_scale, a, scale, shift);
}
hg_tensor *hg_square(hg_ctx *ctx, hg_tensor *a) { return apply_unary(ctx, &op_square, a, 0, 0); }
hg_tensor *hg_sqrt(hg_ctx *ctx, hg_tensor *a) { return apply_unary(ctx, &op_sqrt, a, 0, 0); }
hg_tensor *hg_exp(hg_ctx *ctx, hg_tensor *a) { return apply_unary(ctx, &op_exp, a, 0, 0); }
hg_tensor *hg_log(hg_ctx *ctx, hg_tensor *a) { return apply_unary(ctx, &op_log, a, 0, 0); }
hg_tensor *hg_abs(hg_ctx *ctx, hg_tensor *a) { return apply_unary(ctx, &op_abs, a, 0, 0); }
hg_tensor *hg_clamp(hg_ctx *ctx, hg_tensor *a, double low, double high)
{
    return apply_unary(ctx, &op_clamp, a, low, high);
}
