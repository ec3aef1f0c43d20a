/* Reductions: sum and mean of everything, sum and mean over an axis. Added in f64, in an order that the shape fixes.
 * The mean of nothing is 0. */
#include "autograd/reduce.kernel.h"
#include "autograd/tape.h"

#include <string.h>

/* ---- on both devices ---- */

enum { SLAB = 4096, FEW = 64 };

/* A GPU: what is short is a thread's, a row a block's; where that makes too few of them, slabs are summed first. Like this it
 * depends on the shape alone. */
static hg_status sum_on_device(hg_ctx *ctx, int f64, axis_args *args)
{
    const int64_t count = args->outer * args->inner;
    const bool rows = args->inner == 1 && args->n >= FEW;
    int64_t slabs = (rows ? 256 : 65536) / (count ? count : 1);
    const int64_t most = rows ? args->n / SLAB : args->n / FEW;
    if (slabs > 256) slabs = 256;
    if (slabs > most) slabs = most;
    if (slabs > 1) {
        args->slab = (args->n + slabs - 1) / slabs;
        args->slabs = (args->n + args->slab - 1) / args->slab;
        const hg_step_mark mark = hg_step_set_mark(ctx);
        args->partial = hg_step_device(ctx, (size_t)(count * args->slabs) * sizeof(double));
        if (!args->partial) return HG_MEMORY;
        hg_status status =
            hg_launch(ctx, (rows ? row_partial_kernels : axis_partial_kernels)[f64], count * args->slabs, args);
        if (status == HG_OK)
            status = hg_launch(ctx, (rows ? row_finish_kernels : axis_finish_kernels)[f64], count, args);
        hg_step_rewind(ctx, mark);
        return status;
    }
    args->slab = args->n;
    args->slabs = 1;
    return hg_launch(ctx, (rows ? row_forward_kernels : axis_forward_kernels)[f64], count, args);
}

hg_status hg_sum_middle(hg_ctx *ctx, hg_dtype dtype, int64_t outer, int64_t n, int64_t inner, double scale,
                        const void *from, void *out, bool fresh)
{
    axis_args args = { .outer = outer, .n = n, .inner = inner, .scale = scale, .x = from, .out = out, .fresh = fresh };
    if (!hg_ctx_host(ctx)) return sum_on_device(ctx, dtype == HG_F64, &args);
    args.chunk = 65536 / (n + 1) + 1; /* a chunk of outputs reads about 64 K inputs */
    return hg_launch(ctx, axis_forward_kernels[dtype == HG_F64], (outer * inner + args.chunk - 1) / args.chunk, &args);
}

/* ---- everything ---- */

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
    const hg_tensor *x = call->in[0];
    const int f64 = x->dtype == HG_F64;
    const int64_t n = hg_tensor_count(x);
    axis_args args = { .outer = 1,
                       .n = n,
                       .inner = 1,
                       .slab = SLAB,
                       .slabs = (n + SLAB - 1) / SLAB,
                       .scale = scale_of(call, mean),
                       .x = x->data,
                       .out = call->out->data,
                       .fresh = true };
    const hg_step_mark mark = hg_step_set_mark(call->ctx);
    args.partial = hg_step_device(call->ctx, (size_t)args.slabs * sizeof(double));
    if (!args.partial) return HG_MEMORY;
    HG_TRY(hg_launch(call->ctx, row_partial_kernels[f64], args.slabs, &args));
    HG_TRY(hg_launch(call->ctx, row_finish_kernels[f64], 1, &args));
    hg_step_rewind(call->ctx, mark);
    return HG_OK;
}

/* One sum over a row that is the whole tensor. */
static hg_status total_backward(hg_call *call, bool mean)
{
    const int64_t n = hg_tensor_count(call->in[0]);
    axis_args args = { .outer = 1, .n = n, .inner = 1, .scale = scale_of(call, mean) };
    args.g = hg_grad(call->out)->data;
    args.out = hg_grad_data(call->in[0], &args.fresh);
    return hg_launch(call->ctx, axis_backward_kernels[call->out->dtype == HG_F64], n, &args);
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
    axis_args args = { .outer = 1, .n = x->shape[axis], .inner = 1, .scale = 1, .x = x->data };
    for (int i = 0; i < axis; i++) args.outer *= x->shape[i];
    for (int i = axis + 1; i < x->rank; i++) args.inner *= x->shape[i];
    if (mean) args.scale = args.n ? 1.0 / (double)args.n : 0;
    return args;
}

static hg_status axis_forward(hg_call *call, bool mean)
{
    const axis_args args = axis_arguments(call, mean);
    return hg_sum_middle(call->ctx, call->out->dtype, args.outer, args.n, args.inner, args.scale, args.x,
                         call->out->data, true);
}

static hg_status axis_backward(hg_call *call, bool mean)
{
    axis_args args = axis_arguments(call, mean);
    args.g = hg_grad(call->out)->data;
    args.out = hg_grad_data(call->in[0], &args.fresh);
    return hg_launch(call->ctx, axis_backward_kernels[call->out->dtype == HG_F64], hg_tensor_count(call->in[0]), &args);
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
    AXIS("rows", 1, false, 2, 3, 100),
    AXIS("long rows", 1, false, 2, 2, 9001),
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
