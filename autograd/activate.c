/* activate: an activation on its own; cast: between float types, with gradient; convert: to i32 and bf16, without. */
#include "autograd/activate.kernel.h"
#include "autograd/activation.h"

#include <string.h>

/* ---- activate ---- */

typedef struct {
    hg_activation activation;
} activate_attributes;

static hg_tensor *activate_shape(hg_call *call)
{
    const activate_attributes *attributes = call->attributes;
    if (!hg_floats_agree(call)) return NULL;
    if (!hg_activation_is_known(attributes->activation))
        return hg_refuse(call, "%d is no activation", (int)attributes->activation);
    return hg_out_like(call, call->in[0]);
}

static hg_status activate_forward(hg_call *call)
{
    activate_args args = { .activation = (int)((const activate_attributes *)call->attributes)->activation,
                           .x = call->in[0]->data,
                           .out = call->out->data };
    if (hg_activation_saves_derivative((hg_activation)args.activation) && hg_call_recorded(call)) {
        call->saved[0] = hg_out_like(call, call->out);
        if (!call->saved[0]) return HG_MEMORY;
        args.derivative = call->saved[0]->data;
    }
    return hg_launch(call->ctx, activate_forward_kernels[call->out->dtype == HG_F64], hg_tensor_count(call->out),
                     &args);
}

static hg_status activate_backward(hg_call *call)
{
    bool fresh;
    activate_args args = { .activation = (int)((const activate_attributes *)call->attributes)->activation,
                           .g = hg_grad(call->out)->data,
                           .saved = call->saved[0] ? call->saved[0]->data : call->out->data };
    args.out = hg_grad_data(call->in[0], &fresh);
    args.fresh = fresh;
    return hg_launch(call->ctx, activate_backward_of_kernels[call->out->dtype == HG_F64], hg_tensor_count(call->out),
                     &args);
}

static void activate_reference(const hg_call *call, double *out)
{
    for (int64_t i = 0; i < hg_tensor_count(call->in[0]); i++)
        out[i] = hg_activation_reference(((const activate_attributes *)call->attributes)->activation,
                                         hg_tensor_item(call->in[0], i));
}

static bool activate_kink(const hg_call *call, int in, int64_t element, double step)
{
    return hg_activation_has_kink(((const activate_attributes *)call->attributes)->activation) &&
           fabs(hg_tensor_item(call->in[in], element)) < 2 * step;
}

static hg_status activate_emit(const hg_call *call, hg_emitter *e)
{
    hg_activation activation = ((const activate_attributes *)call->attributes)->activation;
    if (activation == HG_IDENTITY) return hg_emit_one(call, e, "Identity");
    return e->output(e->self, call->out, hg_emit_activation(e, activation, e->input(e->self, call->in[0])));
}

#define ACTIVATE_SAMPLE(label_, activation_, high_, n_)                                                                \
    {                                                                                                                  \
        .label = label_, .n_in = 1, .in = { { 1, { n_ }, .low = -(high_), .high = high_ } },                           \
        .attributes = &(const activate_attributes)                                                                     \
        {                                                                                                              \
            activation_                                                                                                \
        }                                                                                                              \
    }
static const hg_sample activate_samples[] = {
    ACTIVATE_SAMPLE("identity", HG_IDENTITY, 2, 41),
    ACTIVATE_SAMPLE("relu", HG_RELU, 2, 41),
    ACTIVATE_SAMPLE("leaky_relu", HG_LEAKY_RELU, 2, 41),
    ACTIVATE_SAMPLE("elu", HG_ELU, 3, 41),
    ACTIVATE_SAMPLE("tanh", HG_TANH, 3, 41),
    ACTIVATE_SAMPLE("tanh near 0", HG_TANH, 0.1, 41),
    ACTIVATE_SAMPLE("sigmoid", HG_SIGMOID, 4, 41),
    ACTIVATE_SAMPLE("silu", HG_SILU, 4, 41),
    ACTIVATE_SAMPLE("gelu", HG_GELU, 3, 41),
    ACTIVATE_SAMPLE("softplus", HG_SOFTPLUS, 4, 41),
    ACTIVATE_SAMPLE("one", HG_SILU, 1, 1),
    ACTIVATE_SAMPLE("empty", HG_SILU, 1, 0),
    ACTIVATE_SAMPLE("two blocks", HG_SILU, 2, 4099),
};
HG_OP(activate, .formula = "act(x)", .min_in = 1, .max_in = 1, .attributes_size = sizeof(activate_attributes),
      .shape = activate_shape, .forward = activate_forward, .backward = activate_backward, .samples = activate_samples,
      .n_samples = sizeof activate_samples / sizeof *activate_samples, .reference = activate_reference,
      .kink = activate_kink, .emit = activate_emit);

hg_tensor *hg_activate(hg_ctx *ctx, hg_tensor *a, hg_activation activation)
{
    return hg_apply(ctx, &op_activate, 1, &a, &(activate_attributes){ activation });
}

/* ---- cast and convert ---- */

typedef struct {
    hg_dtype dtype;
} cast_attributes;

static hg_tensor *cast_shape(hg_call *call)
{
    return hg_out(call, ((const cast_attributes *)call->attributes)->dtype, call->in[0]->rank, call->in[0]->shape);
}

static hg_status cast_forward(hg_call *call)
{
    HG_TRY(hg_tensor_copy(call->out, call->in[0]));
    return HG_OK;
}

static hg_status cast_backward(hg_call *call)
{
    hg_tensor *g = hg_grad(call->out), *in = call->in[0];
    hg_step_mark mark = hg_step_set_mark(call->ctx);
    hg_tensor *converted = hg_tensor_make(call->ctx, in->dtype, in->rank, in->shape);
    if (!converted) return HG_MEMORY;
    HG_TRY(hg_tensor_copy(converted, g));
    bool fresh;
    void *gradient = hg_grad_data(in, &fresh);
    HG_TRY(hg_accumulate(call->ctx, in->dtype, hg_tensor_count(in), converted->data, gradient, fresh));
    hg_step_rewind(call->ctx, mark);
    return HG_OK;
}

static void cast_reference(const hg_call *call, double *out)
{
    for (int64_t i = 0; i < hg_tensor_count(call->in[0]); i++) out[i] = hg_tensor_item(call->in[0], i);
}

/* ONNX numbers of the types: 1 float, 6 int32, 11 double, 16 bfloat16. */
static hg_status cast_emit(const hg_call *call, hg_emitter *e)
{
    static const int64_t types[] = { [HG_F32] = 1, [HG_F64] = 11, [HG_I32] = 6, [HG_BF16] = 16 };
    int x = e->input(e->self, call->in[0]);
    return e->output(e->self, call->out, e->node(e->self, "Cast", 1, &x, "to=i", types[call->out->dtype]));
}

static const hg_sample cast_samples[] = {
    { .label = "to f64", .n_in = 1, .in = { { 2, { 3, 4 } } }, .attributes = &(const cast_attributes){ HG_F64 } },
    { .label = "empty", .n_in = 1, .in = { { 1, { 0 } } }, .attributes = &(const cast_attributes){ HG_F64 } },
    { .label = "one", .n_in = 1, .in = { { 0, { 0 } } }, .attributes = &(const cast_attributes){ HG_F64 } },
};
HG_OP(cast, .formula = "x as f32 or f64", .min_in = 1, .max_in = 1, .attributes_size = sizeof(cast_attributes),
      .shape = cast_shape, .forward = cast_forward, .backward = cast_backward, .samples = cast_samples,
      .n_samples = sizeof cast_samples / sizeof *cast_samples, .reference = cast_reference, .emit = cast_emit);
HG_OP(convert, .formula = "x as i32 or bf16", .min_in = 1, .max_in = 1, .attributes_size = sizeof(cast_attributes),
      .shape = cast_shape, .forward = cast_forward, .not_differentiable = true, .emit = cast_emit);

hg_tensor *hg_cast(hg_ctx *ctx, hg_tensor *a, hg_dtype dtype)
{
    bool differentiable = a && hg_is_float(a) && (dtype == HG_F32 || dtype == HG_F64);
    return hg_apply(ctx, differentiable ? &op_cast : &op_convert, 1, &a, &(cast_attributes){ dtype });
}
