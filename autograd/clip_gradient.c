/* clip_gradient: the same numbers forward; backward, the gradient of a row of the last axis is shortened to at most
 * `limit`. Forces on the vertices of a strand differ by five orders of magnitude between a hair that hangs and one that
 * an arm passes through: bounded, the second does not drown the first, and the minimum stays where it is as long as no
 * force there reaches the limit. Deliberately not the derivative of its forward, once it clips. */
#include "autograd/clip_gradient.kernel.h"
#include "autograd/tape.h"

#include <math.h>

typedef struct {
    double limit;
} clip_attributes;

static hg_tensor *clip_shape(hg_call *call)
{
    const clip_attributes *attributes = call->attributes;
    hg_tensor *x = call->in[0];
    if (!hg_floats_agree(call)) return NULL;
    if (x->rank < 1) return hg_refuse(call, "a scalar has no rows");
    if (!(attributes->limit > 0)) return hg_refuse(call, "a limit of %g; it has to be positive", attributes->limit);
    return hg_out_view(call, x, x->rank, x->shape);
}

static hg_status clip_forward(hg_call *call) { return (void)call, HG_OK; }

static hg_status clip_backward(hg_call *call)
{
    const hg_tensor *x = call->out;
    bool fresh;
    clip_args args = { .width = x->shape[x->rank - 1] };
    args.limit = ((const clip_attributes *)call->attributes)->limit;
    args.g = hg_grad(x)->data;
    args.to = hg_grad_data(call->in[0], &fresh);
    args.fresh = fresh;
    return hg_launch(call->ctx, clip_gradient_kernels[x->dtype == HG_F64],
                     args.width > 0 ? hg_tensor_count(x) / args.width : 0, &args);
}

static void clip_reference(const hg_call *call, double *out)
{
    for (int64_t i = 0; i < hg_tensor_count(call->in[0]); i++) out[i] = hg_tensor_item(call->in[0], i);
}

static hg_status clip_emit(const hg_call *call, hg_emitter *emitter) { return hg_emit_one(call, emitter, "Identity"); }

/* Gradients below the limit, where the op is what it says it is; tests/test_task.c sees it clip. */
static const clip_attributes wide = { .limit = 1e6 };
static const hg_sample clip_samples[] = {
    { .label = "rows", .n_in = 1, .in = { { 3, { 2, 3, 3 } } }, .attributes = &wide },
    { .label = "one", .n_in = 1, .in = { { 1, { 1 } } }, .attributes = &wide },
    { .label = "empty", .n_in = 1, .in = { { 2, { 0, 3 } } }, .attributes = &wide },
};
HG_OP(clip_gradient, .formula = "x; backward g min(1, limit / |g|) by row", .min_in = 1, .max_in = 1,
      .attributes_size = sizeof(clip_attributes), .shape = clip_shape, .forward = clip_forward,
      .backward = clip_backward, .samples = clip_samples, .n_samples = sizeof clip_samples / sizeof *clip_samples,
      .reference = clip_reference, .emit = clip_emit);

hg_tensor *hg_clip_gradient(hg_ctx *ctx, hg_tensor *x, double limit)
{
    const clip_attributes attributes = { .limit = limit };
    return hg_apply(ctx, &op_clip_gradient, 1, &x, &attributes);
}
