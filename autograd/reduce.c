/* Reductions: sum and mean of everything, sum and mean over an axis. Added in f64, in an order that the shape fixes.
 * The mean of nothing is 0. */
#include "autograd/floats.h"
#include "autograd/tape.h"

#include <string.h>

typedef struct {
    hg_dtype dtype;
    int64_t outer, n, inner;
    double scale;
    const void *x, *g;
    void *out;
    bool fresh;
} axis_args;

#define REAL   float
#define SUFFIX _f32
#include "autograd/reduce.inc"
#undef REAL
#undef SUFFIX
#define REAL   double
#define SUFFIX _f64
#include "autograd/reduce.inc"
#undef REAL
#undef SUFFIX

static void axis_forward_cpu(const void *memory, int64_t first, int64_t last)
{
    const axis_args *p = memory;
    (p->dtype == HG_F32 ? axis_forward_f32 : axis_forward_f64)(p, first, last);
}

static void axis_backward_cpu(const void *memory, int64_t first, int64_t last)
{
    const axis_args *p = memory;
    (p->dtype == HG_F32 ? axis_backward_f32 : axis_backward_f64)(p, first, last);
}

/* ---- everything ---- */

enum { BLOCK = 4096 };

typedef struct {
    hg_dtype dtype;
    int64_t n;
    const void *x;
    double *partial;
} total_args;

static void total_cpu(const void *memory, int64_t first, int64_t last)
{
    const total_args *p = memory;
    for (int64_t block = first; block < last; block++) {
        int64_t at = block * BLOCK, n = p->n - at < BLOCK ? p->n - at : BLOCK;
        p->partial[block] =
            p->dtype == HG_F32 ? sum_of_f32((const float *)p->x + at, n) : sum_of_f64((const double *)p->x + at, n);
    }
}

static hg_tensor *total_shape(hg_call *call)
{
    return hg_floats_agree(call) ? hg_out(call, call->in[0]->dtype, 0, NULL) : NULL;
}

static double scale_of(const hg_call *call, bool mean)
{
    int64_t n = hg_tensor_count(call->in[0]);
    return mean ? n ? 1.0 / (double)n : 0 : 1;
}

static hg_status total_forward(hg_call *call, bool mean)
{
    static const hg_kernel kernel = { .name = "sum", .args_size = sizeof(total_args), .cpu = total_cpu, .block = 1 };
    const hg_tensor *x = call->in[0];
    int64_t n = hg_tensor_count(x), blocks = (n + BLOCK - 1) / BLOCK;
    hg_step_mark mark = hg_step_set_mark(call->ctx);
    hg_tensor *partial = hg_tensor_make(call->ctx, HG_F64, 1, &blocks);
    if (!partial) return HG_MEMORY;
    HG_TRY(hg_launch(call->ctx, &kernel, blocks, &(total_args){ x->dtype, n, x->data, partial->data }));
    axis_args last = {
        .dtype = HG_F64, .outer = 1, .n = blocks, .inner = 1, .scale = scale_of(call, mean), .x = partial->data
    };
    static const hg_kernel axis = { .name = "sum", .args_size = sizeof(axis_args), .cpu = axis_forward_cpu };
    hg_tensor *sum = hg_tensor_make(call->ctx, HG_F64, 0, NULL);
    if (!sum) return HG_MEMORY;
    last.out = sum->data;
    HG_TRY(hg_launch(call->ctx, &axis, 1, &last));
    HG_TRY(hg_tensor_copy(call->out, sum));
    hg_step_rewind(call->ctx, mark);
    return HG_OK;
}

/* One sum over a row that is the whole tensor. */
static hg_status total_backward(hg_call *call, bool mean)
{
    static const hg_kernel kernel = { .name = "sum", .args_size = sizeof(axis_args), .cpu = axis_backward_cpu };
    int64_t n = hg_tensor_count(call->in[0]);
    axis_args args = { .dtype = call->out->dtype, .outer = 1, .n = n, .inner = 1, .scale = scale_of(call, mean) };
    args.g = hg_grad(call->out)->data;
    args.out = hg_grad_data(call->in[0], &args.fresh);
    return hg_launch(call->ctx, &kernel, n, &args);
}

static hg_status sum_forward(hg_call *call) { return total_forward(call, false); }
static hg_status sum_backward(hg_call *call) { return total_backward(call, false); }
static hg_status mean_forward(hg_call *call) { return total_forward(call, true); }
static hg_status mean_backward(hg_call *call) { return total_backward(call, true); }

static void sum_reference(const hg_call *call, double *out)
{
    *out = 0;
    for (int64_t i = 0; i < hg_tensor_count(call->in[0]); i++) *out += hg_tensor_item(call->in[0], i);
}

static void mean_reference(const hg_call *call, double *out)
{
    sum_reference(call, out);
    if (hg_tensor_count(call->in[0])) *out /= (double)hg_tensor_count(call->in[0]);
}

static hg_status total_emit(const hg_call *call, hg_emitter *e, const char *op_type)
{
    int x = e->input(e->self, call->in[0]);
    return e->output(e->self, call->out, e->node(e->self, op_type, 1, &x, "keepdims=i", (int64_t)0));
}
static hg_status sum_emit(const hg_call *call, hg_emitter *e) { return total_emit(call, e, "ReduceSum"); }
static hg_status mean_emit(const hg_call *call, hg_emitter *e) { return total_emit(call, e, "ReduceMean"); }

static const hg_sample total_samples[] = {
    { .label = "matrix", .n_in = 1, .in = { { 2, { 3, 5 } } } },
    { .label = "scalar", .n_in = 1, .in = { { 0, { 0 } } } },
    { .label = "empty", .n_in = 1, .in = { { 2, { 0, 5 } } } },
    { .label = "several blocks", .n_in = 1, .in = { { 1, { 9001 } } } },
};
HG_OP(sum, .formula = "sum of all elements", .min_in = 1, .max_in = 1, .shape = total_shape, .forward = sum_forward,
      .backward = sum_backward, .samples = total_samples, .n_samples = sizeof total_samples / sizeof *total_samples,
      .reference = sum_reference, .emit = sum_emit);
HG_OP(mean, .formula = "mean of all elements", .min_in = 1, .max_in = 1, .shape = total_shape, .forward = mean_forward,
      .backward = mean_backward, .samples = total_samples, .n_samples = sizeof total_samples / sizeof *total_samples,
      .reference = mean_reference, .emit = mean_emit);

hg_tensor *hg_sum(hg_ctx *ctx, hg_tensor *a) { return hg_apply(ctx, &op_sum, 1, &a, NULL); }
hg_tensor *hg_mean(hg_ctx *ctx, hg_tensor *a) { return hg_apply(ctx, &op_mean, 1, &a, NULL); }

/* ---- one axis ---- */

typedef struct {
    int axis;
    bool keep;
} axis_attributes;

static hg_tensor *axis_shape(hg_call *call)
{
    axis_attributes *attributes = call->attributes;
    const hg_tensor *x = call->in[0];
    if (!hg_floats_agree(call)) return NULL;
    attributes->axis = hg_axis_of(call, x, attributes->axis);
    if (attributes->axis < 0) return NULL;
    int64_t shape[HG_MAX_RANK];
    int rank = 0;
    for (int i = 0; i < x->rank; i++)
        if (i != attributes->axis)
            shape[rank++] = x->shape[i];
        else if (attributes->keep)
            shape[rank++] = 1;
    return hg_out(call, x->dtype, rank, shape);
}

static axis_args axis_arguments(const hg_call *call, bool mean)
{
    const hg_tensor *x = call->in[0];
    int axis = ((const axis_attributes *)call->attributes)->axis;
    axis_args args = { .dtype = x->dtype, .outer = 1, .n = x->shape[axis], .inner = 1, .scale = 1, .x = x->data };
    for (int i = 0; i < axis; i++) args.outer *= x->shape[i];
    for (int i = axis + 1; i < x->rank; i++) args.inner *= x->shape[i];
    if (mean) args.scale = args.n ? 1.0 / (double)args.n : 0;
    return args;
}

static hg_status axis_forward(hg_call *call, bool mean)
{
    axis_args args = axis_arguments(call, mean);
    /* A block of outputs reads about 64 K inputs: fixed by the shape. */
    int64_t block = 65536 / (args.n + 1) + 1;
    const hg_kernel kernel = { .name = "sum_axis", .args_size = sizeof args, .cpu = axis_forward_cpu, .block = block };
    args.out = call->out->data;
    return hg_launch(call->ctx, &kernel, args.outer * args.inner, &args);
}

static hg_status axis_backward(hg_call *call, bool mean)
{
    static const hg_kernel kernel = { .name = "sum_axis", .args_size = sizeof(axis_args), .cpu = axis_backward_cpu };
    axis_args args = axis_arguments(call, mean);
    args.g = hg_grad(call->out)->data;
    args.out = hg_grad_data(call->in[0], &args.fresh);
    return hg_launch(call->ctx, &kernel, hg_tensor_count(call->in[0]), &args);
}

static hg_status sum_axis_forward(hg_call *call) { return axis_forward(call, false); }
static hg_status sum_axis_backward(hg_call *call) { return axis_backward(call, false); }
static hg_status mean_axis_forward(hg_call *call) { return axis_forward(call, true); }
static hg_status mean_axis_backward(hg_call *call) { return axis_backward(call, true); }

static void sum_axis_reference(const hg_call *call, double *out)
{
    axis_args p = axis_arguments(call, false);
    for (int64_t o = 0; o < p.outer; o++)
        for (int64_t i = 0; i < p.inner; i++) {
            double sum = 0;
            for (int64_t k = 0; k < p.n; k++) sum += hg_tensor_item(call->in[0], (o * p.n + k) * p.inner + i);
            *out++ = sum;
        }
}

static void mean_axis_reference(const hg_call *call, double *out)
{
    int64_t n = call->in[0]->shape[((const axis_attributes *)call->attributes)->axis];
    sum_axis_reference(call, out);
    for (int64_t i = 0; i < hg_tensor_count(call->out); i++) out[i] = n ? out[i] / (double)n : 0;
}

/* Up to opset 17 the axes of ReduceSum are an input, those of ReduceMean an attribute. */
static hg_status sum_axis_emit(const hg_call *call, hg_emitter *e)
{
    const axis_attributes *attributes = call->attributes;
    int64_t axis = attributes->axis;
    int in[2] = { e->input(e->self, call->in[0]), e->constant_i64(e->self, 1, (int64_t[]){ 1 }, &axis) };
    return e->output(e->self, call->out, e->node(e->self, "ReduceSum", 2, in, "keepdims=i", (int64_t)attributes->keep));
}

static hg_status mean_axis_emit(const hg_call *call, hg_emitter *e)
{
    const axis_attributes *attributes = call->attributes;
    int64_t axis = attributes->axis;
    int x = e->input(e->self, call->in[0]);
    return e->output(e->self, call->out,
                     e->node(e->self, "ReduceMean", 1, &x, "axes=I keepdims=i", 1, &axis, (int64_t)attributes->keep));
}

#define AXIS(label_, axis_, keep_, rank_, ...)                                                                         \
    {                                                                                                                  \
        .label = label_, .n_in = 1, .in = { { rank_, { __VA_ARGS__ } } }, .attributes = &(const axis_attributes)       \
        {                                                                                                              \
            axis_, keep_                                                                                               \
        }                                                                                                              \
    }
static const hg_sample axis_samples[] = {
    AXIS("first", 0, false, 2, 3, 5),
    AXIS("last", -1, false, 3, 2, 3, 5),
    AXIS("middle, kept", 1, true, 3, 2, 3, 5),
    AXIS("one", 0, true, 1, 1),
    AXIS("empty axis", 1, false, 2, 3, 0),
    AXIS("nothing", 1, false, 2, 0, 3),
    AXIS("several blocks", 0, false, 2, 300, 40),
    AXIS("wide", 0, false, 2, 3, 300),
};
HG_OP(sum_axis, .formula = "sum over one axis", .min_in = 1, .max_in = 1, .attributes_size = sizeof(axis_attributes),
      .shape = axis_shape, .forward = sum_axis_forward, .backward = sum_axis_backward, .samples = axis_samples,
      .n_samples = sizeof axis_samples / sizeof *axis_samples, .reference = sum_axis_reference, .emit = sum_axis_emit);
HG_OP(mean_axis, .formula = "mean over one axis", .min_in = 1, .max_in = 1, .attributes_size = sizeof(axis_attributes),
      .shape = axis_shape, .forward = mean_axis_forward, .backward = mean_axis_backward, .samples = axis_samples,
      .n_samples = sizeof axis_samples / sizeof *axis_samples, .reference = mean_axis_reference,
      .emit = mean_axis_emit);

hg_tensor *hg_sum_axis(hg_ctx *ctx, hg_tensor *a, int axis, bool keep)
{
    return hg_apply(ctx, &op_sum_axis, 1, &a, &(axis_attributes){ axis, keep });
}

hg_tensor *hg_mean_axis(hg_ctx *ctx, hg_tensor *a, int axis, bool keep)
{
    return hg_apply(ctx, &op_mean_axis, 1, &a, &(axis_attributes){ axis, keep });
}
