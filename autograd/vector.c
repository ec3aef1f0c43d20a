/* Vectors and quaternions along the last axis: dot, norm, normalize, cross; quat_mul, quat_conjugate, quat_rotate and
 * transport (the rotation that carries one unit vector to another). Quaternions are (w,x,y,z), Hamilton's product.
 * Pairs broadcast over the leading axes. A zero vector has norm 0, direction 0, and no gradient. */
#include "autograd/vector.kernel.h"

#include <string.h>

/* ---- shapes ---- */

/* Leading axes broadcast; the last axes have to be `a` and `b` long (0: any, but the same), the output's is `out`
 * (0: none). */
static hg_tensor *pair_shape(hg_call *call, int64_t a, int64_t b, int64_t out, const char *what)
{
    const hg_tensor *x = call->in[0], *y = call->in[1];
    hg_broadcast plan;
    int rank;
    int64_t shape[HG_MAX_RANK + 1];
    if (!hg_floats_agree(call)) return NULL;
    if (x->rank < 1 || y->rank < 1) return hg_refuse(call, "%s", what);
    int64_t nx = x->shape[x->rank - 1], ny = y->shape[y->rank - 1];
    if (a ? nx != a || ny != b : nx != ny) return hg_refuse(call, "%s", what);
    if (!hg_broadcast_plan(call, 1, &plan, &rank, shape)) return NULL;
    if (out) shape[rank++] = out;
    return hg_out(call, x->dtype, rank, shape);
}

static hg_tensor *dot_shape(hg_call *call) { return pair_shape(call, 0, 0, 0, "the last axes differ"); }
static hg_tensor *cross_shape(hg_call *call) { return pair_shape(call, 3, 3, 3, "both inputs have to be [...,3]"); }
static hg_tensor *quat_mul_shape(hg_call *call) { return pair_shape(call, 4, 4, 4, "both inputs have to be [...,4]"); }
static hg_tensor *quat_rotate_shape(hg_call *call)
{
    return pair_shape(call, 4, 3, 3, "q has to be [...,4] and v [...,3]");
}
static hg_tensor *transport_shape(hg_call *call) { return pair_shape(call, 3, 3, 4, "both inputs have to be [...,3]"); }

/* ---- references ---- */

static void items_of(const hg_call *call, int64_t item, double *a, double *b)
{
    int64_t at[2];
    hg_pair_items(call, 1, item, at);
    double *to[2] = { a, b };
    for (int j = 0; j < 2; j++) {
        int64_t width = call->in[j]->shape[call->in[j]->rank - 1];
        for (int64_t k = 0; k < width; k++) to[j][k] = hg_tensor_item(call->in[j], at[j] * width + k);
    }
}

static int64_t items_in(const hg_tensor *out, int64_t width) { return hg_tensor_count(out) / width; }

static void dot_reference(const hg_call *call, double *out)
{
    int64_t width = call->in[0]->shape[call->in[0]->rank - 1];
    for (int64_t i = 0; i < hg_tensor_count(call->out); i++) {
        int64_t at[2];
        hg_pair_items(call, 1, i, at);
        out[i] = 0;
        for (int64_t k = 0; k < width; k++)
            out[i] += hg_tensor_item(call->in[0], at[0] * width + k) * hg_tensor_item(call->in[1], at[1] * width + k);
    }
}

static void cross_reference(const hg_call *call, double *out)
{
    for (int64_t i = 0; i < items_in(call->out, 3); i++) {
        double a[3], b[3];
        items_of(call, i, a, b);
        for (int k = 0; k < 3; k++) out[3 * i + k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
    }
}

/* The multiplication table of 1, i, j, k written out. */
static void multiply(const double a[4], const double b[4], double out[4])
{
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
    out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
    out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
}

static void quat_mul_reference(const hg_call *call, double *out)
{
    for (int64_t i = 0; i < items_in(call->out, 4); i++) {
        double a[4], b[4];
        items_of(call, i, a, b);
        multiply(a, b, out + 4 * i);
    }
}

static void quat_rotate_reference(const hg_call *call, double *out)
{
    for (int64_t i = 0; i < items_in(call->out, 3); i++) {
        double q[4], v[4] = { 0 }, half[4], whole[4];
        items_of(call, i, q, v + 1);
        multiply(q, v, half);
        multiply(half, (double[]){ q[0], -q[1], -q[2], -q[3] }, whole);
        memcpy(out + 3 * i, whole + 1, 3 * sizeof *out);
    }
}

/* -a h as quaternions: (a.h, -(a x h)) conjugated. */
static void transport_reference(const hg_call *call, double *out)
{
    for (int64_t i = 0; i < items_in(call->out, 4); i++) {
        double a[4] = { 0 }, h[4] = { 0 }, square = 0, *y = out + 4 * i;
        items_of(call, i, a + 1, h + 1);
        for (int k = 1; k < 4; k++) {
            h[k] += a[k];
            square += h[k] * h[k];
        }
        for (int k = 1; k < 4; k++) h[k] /= sqrt(fmax(square, 1e-4));
        multiply(a, h, y);
        y[0] = -y[0];
    }
}

/* ---- pairs ---- */

static hg_status dot_emit(const hg_call *call, hg_emitter *e)
{
    int64_t one = 1, last = -1;
    int in[2] = { e->input(e->self, call->in[0]), e->input(e->self, call->in[1]) };
    int sum[2] = { e->node(e->self, "Mul", 2, in, ""), e->constant_i64(e->self, 1, &one, &last) };
    return e->output(e->self, call->out, e->node(e->self, "ReduceSum", 2, sum, "keepdims=i", (int64_t)0));
}

#define EMIT_PAIR(NAME_)                                                                                               \
    static hg_status NAME_##_emit(const hg_call *call, hg_emitter *e)                                                  \
    {                                                                                                                  \
        int a = e->input(e->self, call->in[0]), b = e->input(e->self, call->in[1]);                                    \
        return e->output(e->self, call->out, hg_emit_##NAME_(e, a, b));                                                \
    }
EMIT_PAIR(cross)
EMIT_PAIR(quat_mul)
EMIT_PAIR(quat_rotate)
EMIT_PAIR(transport)

#define SHAPE(...)                                                                                                     \
    {                                                                                                                  \
        __VA_ARGS__                                                                                                    \
    }
#define PAIR(label_, ra_, sa_, rb_, sb_)                                                                               \
    {                                                                                                                  \
        .label = label_, .n_in = 2, .in = { { ra_, SHAPE sa_ }, { rb_, SHAPE sb_ } }                                   \
    }
#define PAIRS(wa_, wb_)                                                                                                \
    PAIR("plain", 2, (3, wa_), 2, (3, wb_)), PAIR("one", 1, (wa_), 1, (wb_)),                                          \
        PAIR("b shared", 3, (2, 3, wa_), 1, (wb_)), PAIR("a shared", 3, (2, 1, wa_), 3, (2, 3, wb_)),                  \
        PAIR("empty", 2, (0, wa_), 2, (1, wb_)), PAIR("two blocks", 2, (4200, wa_), 2, (4200, wb_)),                   \
        PAIR("two blocks, shared", 2, (1, wa_), 2, (4200, wb_))
static const hg_sample dot_samples[] = { PAIRS(5, 5), PAIR("width 0", 2, (2, 0), 2, (2, 0)),
                                         PAIR("width 1", 2, (2, 1), 2, (2, 1)) };
static const hg_sample cross_samples[] = { PAIRS(3, 3) };
static const hg_sample quat_mul_samples[] = { PAIRS(4, 4) };
static const hg_sample quat_rotate_samples[] = { PAIRS(4, 3) };
/* The last pair of `clamped` is antiparallel to 0.003 rad. */
static const hg_sample transport_samples[] = {
    PAIRS(3, 3),
    { .label = "clamped",
      .n_in = 2,
      .in = { { 2, { 2, 3 }, .values = (const double[]){ 0, 0, 1, 1, 0, 0 } },
              { 2, { 2, 3 }, .values = (const double[]){ 0.6, 0, 0.8, -1, 0.003, 0 } } } },
};

#define PAIR_OP(NAME_, FORMULA_, EMIT_)                                                                                \
    static hg_status NAME_##_forward(hg_call *call) { return hg_pair_forward(call, 1, &NAME_##_kernels); }             \
    static hg_status NAME_##_backward(hg_call *call) { return hg_pair_backward(call, 1, &NAME_##_kernels); }           \
    HG_OP(NAME_, .formula = FORMULA_, .min_in = 2, .max_in = 2, .shape = NAME_##_shape, .forward = NAME_##_forward,    \
          .backward = NAME_##_backward, .samples = NAME_##_samples,                                                    \
          .n_samples = sizeof NAME_##_samples / sizeof *NAME_##_samples, .reference = NAME_##_reference,               \
          .emit = EMIT_);                                                                                              \
    hg_tensor *hg_##NAME_(hg_ctx *ctx, hg_tensor *a, hg_tensor *b)                                                     \
    {                                                                                                                  \
        return hg_apply(ctx, &op_##NAME_, 2, (hg_tensor *[]){ a, b }, NULL);                                           \
    }

PAIR_OP(dot, "a . b along the last axis", dot_emit)
PAIR_OP(cross, "a x b", cross_emit)
PAIR_OP(quat_mul, "a b", quat_mul_emit)
PAIR_OP(quat_rotate, "q v conj(q)", quat_rotate_emit)
PAIR_OP(transport, "(a.h, a x h), h = (a + b) / sqrt(max(|a + b|^2, 1e-4))", transport_emit)

/* ---- rows ---- */

static int64_t rows_of(const hg_tensor *x)
{
    int64_t rows = 1;
    for (int i = 0; i + 1 < x->rank; i++) rows *= x->shape[i];
    return rows;
}

static hg_status rows_forward(hg_call *call, const hg_kernel *const *kernels)
{
    const hg_tensor *x = call->in[0];
    const row_args args = { .width = x->shape[x->rank - 1], .x = x->data, .y = call->out->data };
    return hg_launch(call->ctx, kernels[x->dtype == HG_F64], rows_of(x), &args);
}

static hg_status rows_backward(hg_call *call, const hg_kernel *const *kernels)
{
    hg_tensor *x = call->in[0];
    bool fresh;
    row_args args = { .width = x->shape[x->rank - 1], .x = x->data, .y = call->out->data };
    args.g = hg_grad(call->out)->data;
    args.d = hg_grad_data(x, &fresh);
    args.fresh = fresh;
    return hg_launch(call->ctx, kernels[x->dtype == HG_F64], rows_of(x), &args);
}

static hg_tensor *norm_shape(hg_call *call)
{
    const hg_tensor *x = call->in[0];
    if (!hg_floats_agree(call)) return NULL;
    return x->rank < 1 ? hg_refuse(call, "a scalar has no last axis") : hg_out(call, x->dtype, x->rank - 1, x->shape);
}

static hg_tensor *normalize_shape(hg_call *call)
{
    const hg_tensor *x = call->in[0];
    if (!hg_floats_agree(call)) return NULL;
    return x->rank < 1 ? hg_refuse(call, "a scalar has no last axis") : hg_out_like(call, x);
}

static hg_tensor *quat_conjugate_shape(hg_call *call)
{
    const hg_tensor *x = call->in[0];
    if (!hg_floats_agree(call)) return NULL;
    return x->rank < 1 || x->shape[x->rank - 1] != 4 ? hg_refuse(call, "q has to be [...,4]") : hg_out_like(call, x);
}

static double row_length(const hg_tensor *x, int64_t row)
{
    int64_t width = x->shape[x->rank - 1];
    double length = 0;
    for (int64_t k = 0; k < width; k++) length = hypot(length, hg_tensor_item(x, row * width + k));
    return length;
}

static void norm_reference(const hg_call *call, double *out)
{
    for (int64_t i = 0; i < hg_tensor_count(call->out); i++) out[i] = row_length(call->in[0], i);
}

static void normalize_reference(const hg_call *call, double *out)
{
    const hg_tensor *x = call->in[0];
    for (int64_t i = 0; i < hg_tensor_count(x); i++) {
        double length = row_length(x, i / x->shape[x->rank - 1]);
        out[i] = length > 0 ? hg_tensor_item(x, i) / length : 0;
    }
}

static void quat_conjugate_reference(const hg_call *call, double *out)
{
    for (int64_t i = 0; i < hg_tensor_count(call->in[0]); i++)
        out[i] = i % 4 == 0 ? hg_tensor_item(call->in[0], i) : -hg_tensor_item(call->in[0], i);
}

static bool short_row_kink(const hg_call *call, int in, int64_t element, double step)
{
    const hg_tensor *x = call->in[in];
    return row_length(x, element / x->shape[x->rank - 1]) < 4 * step;
}

static hg_status norm_emit(const hg_call *call, hg_emitter *e)
{
    int64_t last = -1;
    int x = e->input(e->self, call->in[0]);
    return e->output(e->self, call->out,
                     e->node(e->self, "ReduceL2", 1, &x, "axes=I keepdims=i", 1, &last, (int64_t)0));
}

/* x / max(|x|, 1e-30): zero stays zero. */
static hg_status normalize_emit(const hg_call *call, hg_emitter *e)
{
    int64_t last = -1;
    int x = e->input(e->self, call->in[0]);
    int length = e->node(e->self, "ReduceL2", 1, &x, "axes=I keepdims=i", 1, &last, (int64_t)1);
    int guarded = e->node(e->self, "Max", 2, (int[]){ length, hg_emit_scalar(e, 1e-30) }, "");
    return e->output(e->self, call->out, e->node(e->self, "Div", 2, (int[]){ x, guarded }, ""));
}

static hg_status quat_conjugate_emit(const hg_call *call, hg_emitter *e)
{
    int signs = e->constant_f32(e->self, 1, (int64_t[]){ 4 }, (float[]){ 1, -1, -1, -1 });
    int in[2] = { e->input(e->self, call->in[0]), signs };
    return e->output(e->self, call->out, e->node(e->self, "Mul", 2, in, ""));
}

static const hg_sample row_samples[] = {
    { .label = "vectors", .n_in = 1, .in = { { 3, { 2, 3, 3 } } } },
    { .label = "one", .n_in = 1, .in = { { 1, { 1 } } }, .zero_gradient = true }, /* of normalize */
    { .label = "zero among others",
      .n_in = 1,
      .in = { { 2, { 3, 2 }, .values = (const double[]){ 1, 2, 0, 0, -3, 4 } } } },
    { .label = "empty", .n_in = 1, .in = { { 2, { 0, 3 } } } },
    { .label = "width 0", .n_in = 1, .in = { { 2, { 3, 0 } } } },
    { .label = "two blocks", .n_in = 1, .in = { { 2, { 600, 4 } } } },
};
static const hg_sample quat_conjugate_samples[] = {
    { .label = "some", .n_in = 1, .in = { { 3, { 2, 3, 4 } } } },
    { .label = "one", .n_in = 1, .in = { { 1, { 4 } } } },
    { .label = "empty", .n_in = 1, .in = { { 2, { 0, 4 } } } },
    { .label = "two blocks", .n_in = 1, .in = { { 2, { 600, 4 } } } },
};

#define ROW_OP(NAME_, FORMULA_, SAMPLES_, KINK_)                                                                       \
    static hg_status NAME_##_forward(hg_call *call) { return rows_forward(call, NAME_##_forward_kernels); }            \
    static hg_status NAME_##_backward(hg_call *call) { return rows_backward(call, NAME_##_backward_kernels); }         \
    HG_OP(NAME_, .formula = FORMULA_, .min_in = 1, .max_in = 1, .shape = NAME_##_shape, .forward = NAME_##_forward,    \
          .backward = NAME_##_backward, .samples = SAMPLES_, .n_samples = sizeof SAMPLES_ / sizeof *SAMPLES_,          \
          .reference = NAME_##_reference, .kink = KINK_, .emit = NAME_##_emit);                                        \
    hg_tensor *hg_##NAME_(hg_ctx *ctx, hg_tensor *a) { return hg_apply(ctx, &op_##NAME_, 1, &a, NULL); }

ROW_OP(norm, "|x| along the last axis, gradient 0 at 0", row_samples, short_row_kink)
ROW_OP(normalize, "x / |x| along the last axis, 0 at 0", row_samples, short_row_kink)
ROW_OP(quat_conjugate, "(w, -x, -y, -z)", quat_conjugate_samples, NULL)
