/* softmax over the last axis; layer normalisation (Ba, Kiros and Hinton 2016) over the last axis; group normalisation
 * (Wu and He 2018) of [B,C,...]. Both normalisations are one kernel: rows of n elements, each of n / inner channels. */
#include "autograd/norm.kernel.h"
#include "autograd/tape.h"

#include <string.h>

enum { ROWS = 32, CHUNKS = 64 };

static int is_f64(const hg_call *call) { return call->out->dtype == HG_F64; }

/* ---- softmax ---- */

static hg_tensor *softmax_shape(hg_call *call)
{
    if (!hg_floats_agree(call)) return NULL;
    return call->in[0]->rank < 1 ? hg_refuse(call, "a scalar has no last axis") : hg_out_like(call, call->in[0]);
}

static norm_args softmax_arguments(const hg_call *call)
{
    const hg_tensor *x = call->in[0];
    norm_args args = { .rows = 1, .n = x->shape[x->rank - 1], .x = x->data, .y = call->out->data };
    for (int i = 0; i + 1 < x->rank; i++) args.rows *= x->shape[i];
    return args;
}

static hg_status softmax_forward(hg_call *call)
{
    norm_args args = softmax_arguments(call);
    return hg_launch(call->ctx, softmax_forward_kernels[is_f64(call)], args.rows, &args);
}

static hg_status softmax_backward(hg_call *call)
{
    norm_args args = softmax_arguments(call);
    args.g = hg_grad(call->out)->data;
    args.dx = hg_grad_data(call->in[0], &args.fresh);
    return hg_launch(call->ctx, softmax_backward_kernels[is_f64(call)], args.rows, &args);
}

static void softmax_reference(const hg_call *call, double *out)
{
    const hg_tensor *x = call->in[0];
    int64_t n = x->shape[x->rank - 1];
    for (int64_t i = 0; i < hg_tensor_count(x); i++) {
        double sum = 0;
        for (int64_t j = i / n * n; j < i / n * n + n; j++) sum += exp(hg_tensor_item(x, j) - hg_tensor_item(x, i));
        out[i] = 1 / sum;
    }
}

static hg_status softmax_emit(const hg_call *call, hg_emitter *e)
{
    int x = e->input(e->self, call->in[0]);
    return e->output(e->self, call->out, e->node(e->self, "Softmax", 1, &x, "axis=i", (int64_t)-1));
}

static const hg_sample softmax_samples[] = {
    { .label = "rows", .n_in = 1, .in = { { 2, { 3, 5 }, .low = -3, .high = 3 } } },
    { .label = "large", .n_in = 1, .in = { { 1, { 4 }, .low = 1000, .high = 1003 } } },
    { .label = "one", .n_in = 1, .in = { { 1, { 1 } } }, .zero_gradient = true },
    { .label = "empty", .n_in = 1, .in = { { 2, { 0, 3 } } } },
    { .label = "width 0", .n_in = 1, .in = { { 2, { 2, 0 } } } },
    { .label = "two blocks", .n_in = 1, .in = { { 2, { 40, 3 } } } },
};
HG_OP(softmax, .formula = "exp(x) / sum of exp(x) along the last axis", .min_in = 1, .max_in = 1,
      .shape = softmax_shape, .forward = softmax_forward, .backward = softmax_backward, .samples = softmax_samples,
      .n_samples = sizeof softmax_samples / sizeof *softmax_samples, .reference = softmax_reference,
      .emit = softmax_emit);

hg_tensor *hg_softmax(hg_ctx *ctx, hg_tensor *a) { return hg_apply(ctx, &op_softmax, 1, &a, NULL); }

/* ---- layer and group normalisation ---- */

typedef struct {
    double epsilon;
    int groups; /* 0: layer */
} norm_attributes;

static hg_tensor *input_of(const hg_call *call, int i) { return call->n_in > i ? call->in[i] : NULL; }

static hg_tensor *norm_shape(hg_call *call)
{
    const norm_attributes *attributes = call->attributes;
    const hg_tensor *x = call->in[0];
    if (!hg_floats_agree(call)) return NULL;
    if (!(attributes->epsilon > 0)) return hg_refuse(call, "epsilon is %g, it has to be above 0", attributes->epsilon);
    if (attributes->groups == 0 && x->rank < 1) return hg_refuse(call, "a scalar has no last axis");
    if (attributes->groups && (x->rank < 2 || attributes->groups < 0 || x->shape[1] % attributes->groups))
        return hg_refuse(call, "x has to be [B,C,...] with C a multiple of the %d groups", attributes->groups);
    int64_t channels = attributes->groups ? x->shape[1] : x->shape[x->rank - 1];
    for (int i = 1; i < 3; i++)
        if (input_of(call, i) && (input_of(call, i)->rank != 1 || input_of(call, i)->shape[0] != channels))
            return hg_refuse(call, "gain and bias have to be [%lld]", (long long)channels);
    return hg_out_like(call, x);
}

static norm_args norm_arguments(const hg_call *call)
{
    const norm_attributes *attributes = call->attributes;
    const hg_tensor *x = call->in[0], *gain = input_of(call, 1), *bias = input_of(call, 2);
    norm_args args = { .groups = 1,
                       .inner = 1,
                       .epsilon = attributes->epsilon,
                       .x = x->data,
                       .gain = gain ? gain->data : NULL,
                       .bias = bias ? bias->data : NULL,
                       .y = call->out->data };
    if (attributes->groups) {
        for (int i = 2; i < x->rank; i++) args.inner *= x->shape[i];
        args.groups = attributes->groups;
        args.n = x->shape[1] / args.groups * args.inner;
        args.rows = x->shape[0] * args.groups;
    } else {
        args.n = x->shape[x->rank - 1];
        args.rows = 1;
        for (int i = 0; i + 1 < x->rank; i++) args.rows *= x->shape[i];
    }
    return args;
}

static hg_status norm_forward(hg_call *call)
{
    norm_args args = norm_arguments(call);
    if (hg_tensor_count(call->out) == 0) return HG_OK;
    call->saved[0] = hg_tensor_make(call->ctx, call->out->dtype, 2, (int64_t[]){ args.rows, 2 });
    if (!call->saved[0]) return HG_MEMORY;
    args.statistics = call->saved[0]->data;
    return hg_launch(call->ctx, normalise_forward_kernels[is_f64(call)], args.rows, &args);
}

/* gradient = or += the sum of `of` [B,C,inner] over all but the channels. */
static hg_status sum_channels(hg_call *call, const norm_args *args, const void *of, hg_tensor *parameter)
{
    const hg_dtype dtype = call->out->dtype;
    const int64_t channels = args->n / args->inner * args->groups, samples = args->rows / args->groups;
    if (args->inner > 1) {
        hg_tensor *sums = hg_tensor_make(call->ctx, dtype, 2, (int64_t[]){ samples, channels });
        if (!sums) return HG_MEMORY;
        HG_TRY(hg_sum_middle(call->ctx, dtype, samples * channels, args->inner, 1, 1, of, sums->data, true));
        of = sums->data;
    }
    bool fresh;
    void *gradient = hg_grad_data(parameter, &fresh);
    return hg_sum_middle(call->ctx, dtype, 1, samples, channels, 1, of, gradient, fresh);
}

/* A GPU: a block of threads for a row, then sums over rows. */
static hg_status norm_backward_by_rows(hg_call *call, norm_args *args)
{
    hg_tensor *gain = input_of(call, 1), *bias = input_of(call, 2);
    if (hg_needs_grad(gain)) {
        args->products = hg_step_device(call->ctx, hg_tensor_bytes(call->out));
        if (!args->products) return HG_MEMORY;
    }
    if (hg_needs_grad(call->in[0])) args->dx = hg_grad_data(call->in[0], &args->fresh);
    HG_TRY(hg_launch(call->ctx, normalise_gradient_kernels[is_f64(call)], args->rows, args));
    if (hg_needs_grad(gain)) HG_TRY(sum_channels(call, args, args->products, gain));
    return hg_needs_grad(bias) ? sum_channels(call, args, args->g, bias) : HG_OK;
}

/* The processor: chunks of rows, each with its own sums for gain and bias. */
static hg_status norm_backward_by_chunks(hg_call *call, norm_args *args)
{
    hg_ctx *ctx = call->ctx;
    const hg_dtype dtype = call->out->dtype;
    args->chunk = (args->rows + CHUNKS - 1) / CHUNKS;
    if (args->chunk < ROWS) args->chunk = ROWS;
    const int64_t chunks = (args->rows + args->chunk - 1) / args->chunk,
                  channels = args->n / args->inner * args->groups;
    void **partials[3] = { NULL, &args->dgain, &args->dbias };
    for (int i = 1; i < 3; i++) {
        if (!hg_needs_grad(input_of(call, i))) continue;
        hg_tensor *copies = hg_tensor_make(ctx, dtype, 2, (int64_t[]){ chunks, channels });
        if (!copies) return HG_MEMORY;
        *partials[i] = copies->data;
    }
    if (hg_needs_grad(call->in[0])) args->dx = hg_grad_data(call->in[0], &args->fresh);
    HG_TRY(hg_launch(ctx, normalise_backward_kernels[is_f64(call)], chunks, args));
    for (int i = 1; i < 3; i++) {
        bool fresh;
        if (!*partials[i]) continue;
        void *gradient = hg_grad_data(call->in[i], &fresh);
        HG_TRY(hg_add_partials(ctx, dtype, chunks, channels, *partials[i], gradient, fresh));
    }
    return HG_OK;
}

static hg_status norm_backward(hg_call *call)
{
    norm_args args = norm_arguments(call);
    if (hg_tensor_count(call->out) == 0) return HG_OK;
    args.g = hg_grad(call->out)->data;
    args.statistics = call->saved[0]->data;
    const bool chunks = hg_launches(call->ctx, normalise_backward_kernels[is_f64(call)]);
    const hg_step_mark mark = hg_step_set_mark(call->ctx);
    const hg_status status = (chunks ? norm_backward_by_chunks : norm_backward_by_rows)(call, &args);
    hg_step_rewind(call->ctx, mark);
    return status;
}

static void norm_reference(const hg_call *call, double *out)
{
    norm_args p = norm_arguments(call);
    const hg_tensor *gain = input_of(call, 1), *bias = input_of(call, 2);
    for (int64_t i = 0; i < hg_tensor_count(call->in[0]); i++) {
        int64_t row = i / p.n, channel = i / p.inner % (p.n / p.inner * p.groups);
        double mean = 0, variance = 0;
        for (int64_t j = 0; j < p.n; j++) mean += hg_tensor_item(call->in[0], row * p.n + j) / (double)p.n;
        for (int64_t j = 0; j < p.n; j++)
            variance += pow(hg_tensor_item(call->in[0], row * p.n + j) - mean, 2) / (double)p.n;
        out[i] = (hg_tensor_item(call->in[0], i) - mean) / sqrt(variance + p.epsilon) *
                     (gain ? hg_tensor_item(gain, channel) : 1) +
                 (bias ? hg_tensor_item(bias, channel) : 0);
    }
}

/* Written out, as ONNX has layer normalisation only from opset 17: x is [.., n] with the axis of the mean last. */
static int emit_normalise(hg_emitter *e, int x, double epsilon)
{
    int64_t last = -1;
    int mean = e->node(e->self, "ReduceMean", 1, &x, "axes=I keepdims=i", 1, &last, (int64_t)1);
    int centred = e->node(e->self, "Sub", 2, (int[]){ x, mean }, "");
    int square = e->node(e->self, "Mul", 2, (int[]){ centred, centred }, "");
    int variance = e->node(e->self, "ReduceMean", 1, &square, "axes=I keepdims=i", 1, &last, (int64_t)1);
    int guarded = e->node(e->self, "Add", 2, (int[]){ variance, hg_emit_scalar(e, epsilon) }, "");
    int deviation = e->node(e->self, "Sqrt", 1, &guarded, "");
    return e->node(e->self, "Div", 2, (int[]){ centred, deviation }, "");
}

/* Gain and bias are [C]; for [B,C,...] they become [C,1,...]. */
static int emit_scaled(const hg_call *call, hg_emitter *e, int y, int trailing)
{
    static const char *const types[] = { NULL, "Mul", "Add" };
    for (int i = 1; i < 3; i++) {
        if (!input_of(call, i)) continue;
        int value = e->input(e->self, call->in[i]);
        int64_t rank = trailing + 1, shape[HG_MAX_RANK] = { call->in[i]->shape[0], 1, 1, 1, 1, 1 };
        if (trailing)
            value = e->node(e->self, "Reshape", 2, (int[]){ value, e->constant_i64(e->self, 1, &rank, shape) }, "");
        y = e->node(e->self, types[i], 2, (int[]){ y, value }, "");
    }
    return y;
}

static hg_status layer_norm_emit(const hg_call *call, hg_emitter *e)
{
    int y = emit_normalise(e, e->input(e->self, call->in[0]), ((const norm_attributes *)call->attributes)->epsilon);
    return e->output(e->self, call->out, emit_scaled(call, e, y, 0));
}

static hg_status group_norm_emit(const hg_call *call, hg_emitter *e)
{
    const norm_attributes *attributes = call->attributes;
    const hg_tensor *x = call->in[0];
    int64_t three = 3, rank = x->rank, grouped[3] = { 0, attributes->groups, -1 }, shape[HG_MAX_RANK];
    memcpy(shape, x->shape, sizeof shape);
    shape[0] = -1; /* the number of rows stays open */
    int y = e->node(e->self, "Reshape", 2,
                    (int[]){ e->input(e->self, x), e->constant_i64(e->self, 1, &three, grouped) }, "");
    y = emit_normalise(e, y, attributes->epsilon);
    y = e->node(e->self, "Reshape", 2, (int[]){ y, e->constant_i64(e->self, 1, &rank, shape) }, "");
    return e->output(e->self, call->out, emit_scaled(call, e, y, x->rank - 2));
}

#define LAYER                                                                                                          \
    .attributes = &(const norm_attributes) { 1e-3, 0 }
static const hg_sample layer_norm_samples[] = {
    { .label = "rows", .n_in = 3, .in = { { 2, { 3, 5 } }, { 1, { 5 } }, { 1, { 5 } } }, LAYER },
    { .label = "no gain or bias", .n_in = 1, .in = { { 3, { 2, 2, 4 } } }, LAYER },
    { .label = "constant row",
      .n_in = 3,
      .in = { { 1, { 3 }, .values = (const double[]){ 2, 2, 2 } }, { 1, { 3 } }, { 1, { 3 } } },
      LAYER,
      .zero_gradient = true },
    { .label = "one", .n_in = 3, .in = { { 1, { 1 } }, { 1, { 1 } }, { 1, { 1 } } }, LAYER, .zero_gradient = true },
    { .label = "empty", .n_in = 3, .in = { { 2, { 0, 5 } }, { 1, { 5 } }, { 1, { 5 } } }, LAYER },
    { .label = "several chunks", .n_in = 3, .in = { { 2, { 100, 3 } }, { 1, { 3 } }, { 1, { 3 } } }, LAYER },
};
HG_OP(layer_norm, .formula = "(x - mean) / sqrt(variance + epsilon) gain + bias, along the last axis", .min_in = 1,
      .max_in = 3, .attributes_size = sizeof(norm_attributes), .shape = norm_shape, .forward = norm_forward,
      .backward = norm_backward, .samples = layer_norm_samples,
      .n_samples = sizeof layer_norm_samples / sizeof *layer_norm_samples, .reference = norm_reference,
      .emit = layer_norm_emit);

#define GROUP(groups_)                                                                                                 \
    .attributes = &(const norm_attributes) { 1e-3, groups_ }
static const hg_sample group_norm_samples[] = {
    { .label = "two groups", .n_in = 3, .in = { { 4, { 2, 4, 2, 3 } }, { 1, { 4 } }, { 1, { 4 } } }, GROUP(2) },
    { .label = "no space, no bias", .n_in = 2, .in = { { 2, { 3, 6 } }, { 1, { 6 } } }, GROUP(3) },
    { .label = "one",
      .n_in = 3,
      .in = { { 2, { 1, 1 } }, { 1, { 1 } }, { 1, { 1 } } },
      GROUP(1),
      .zero_gradient = true },
    { .label = "empty", .n_in = 3, .in = { { 3, { 0, 4, 2 } }, { 1, { 4 } }, { 1, { 4 } } }, GROUP(2) },
    { .label = "several chunks", .n_in = 3, .in = { { 3, { 20, 4, 3 } }, { 1, { 4 } }, { 1, { 4 } } }, GROUP(2) },
};
HG_OP(group_norm, .formula = "layer_norm over groups of the channels of [B,C,...]", .min_in = 1, .max_in = 3,
      .attributes_size = sizeof(norm_attributes), .shape = norm_shape, .forward = norm_forward,
      .backward = norm_backward, .samples = group_norm_samples,
      .n_samples = sizeof group_norm_samples / sizeof *group_norm_samples, .reference = norm_reference,
      .emit = group_norm_emit);

hg_tensor *hg_layer_norm(hg_ctx *ctx, hg_tensor *a, hg_tensor *gain, hg_tensor *bias, double epsilon)
{
    return hg_apply(ctx, &op_layer_norm, 3, (hg_tensor *[]){ a, gain, bias }, &(norm_attributes){ epsilon, 0 });
}

hg_tensor *hg_group_norm(hg_ctx *ctx, hg_tensor *a, hg_tensor *gain, hg_tensor *bias, int groups, double epsilon)
{
    /* 0 groups stand for layer_norm inside: refused like any other wrong number. */
    return hg_apply(ctx, &op_group_norm, 3, (hg_tensor *[]){ a, gain, bias },
                    &(norm_attributes){ epsilon, groups ? groups : -1 });
}
