/* What the op files share: outputs, checks, sums of partial results, emitting shortcuts. */
#include "autograd/support.kernel.h"
#include "autograd/tape.h"

#include <string.h>

/* ---- outputs and checks ---- */

hg_tensor *hg_out(const hg_call *call, hg_dtype dtype, int rank, const int64_t *shape)
{
    return hg_tensor_make(call->ctx, dtype, rank, shape);
}

hg_tensor *hg_out_like(const hg_call *call, const hg_tensor *tensor)
{
    return hg_tensor_make(call->ctx, tensor->dtype, tensor->rank, tensor->shape);
}

hg_tensor *hg_out_view(const hg_call *call, hg_tensor *tensor, int rank, const int64_t *shape)
{
    hg_tensor *out = hg_tensor_wrap(call->ctx, tensor->dtype, rank, shape, tensor->data);
    if (out) out->base = tensor;
    return out;
}

bool hg_is_float(const hg_tensor *tensor) { return tensor->dtype == HG_F32 || tensor->dtype == HG_F64; }

bool hg_same_shape(const hg_tensor *a, const hg_tensor *b)
{
    return a->rank == b->rank && memcmp(a->shape, b->shape, sizeof a->shape) == 0;
}

bool hg_floats_agree(const hg_call *call)
{
    for (int i = 0; i < call->n_in; i++)
        if (call->in[i] && (!hg_is_float(call->in[i]) || call->in[i]->dtype != call->in[0]->dtype)) {
            hg_refuse(call, "the inputs have to be all f32 or all f64");
            return false;
        }
    return true;
}

int hg_axis_of(const hg_call *call, const hg_tensor *tensor, int axis)
{
    int positive = axis < 0 ? axis + tensor->rank : axis;
    if (positive >= 0 && positive < tensor->rank) return positive;
    hg_refuse(call, "there is no axis %d", axis);
    return -1;
}

/* ---- sums of partial results ---- */

hg_status hg_add_partials(hg_ctx *ctx, hg_dtype dtype, int64_t count, int64_t size, void *partials, void *out,
                          bool fresh)
{
    const partials_args args = { count, size, partials, out, fresh };
    return hg_launch(ctx, partials_kernels[dtype == HG_F64], size, &args);
}

hg_status hg_accumulate(hg_ctx *ctx, hg_dtype dtype, int64_t count, const void *from, void *out, bool fresh)
{
    return hg_add_partials(ctx, dtype, 1, count, (void *)from, out, fresh); /* one array is only read */
}

/* ---- emitting ---- */

int hg_emit_scalar(hg_emitter *emitter, double value)
{
    return emitter->constant_f32(emitter->self, 0, NULL, &(float){ (float)value });
}

hg_status hg_emit_one(const hg_call *call, hg_emitter *emitter, const char *op_type)
{
    int in[HG_OP_INPUTS];
    for (int i = 0; i < call->n_in; i++) in[i] = call->in[i] ? emitter->input(emitter->self, call->in[i]) : -1;
    return emitter->output(emitter->self, call->out, emitter->node(emitter->self, op_type, call->n_in, in, ""));
}
