/* What the op files share: outputs, checks, sums of partial results, emitting shortcuts. */
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

typedef struct {
    hg_dtype dtype;
    int64_t count, size;
    void *partials, *out;
    bool fresh;
} partials_args;

#define PARTIALS(REAL, SUFFIX)                                                                                         \
    static void partials_##SUFFIX(const partials_args *p, int64_t first, int64_t last)                                 \
    {                                                                                                                  \
        REAL *partials = p->partials, *out = p->out;                                                                   \
        for (int64_t step = 1; step < p->count; step *= 2)                                                             \
            for (int64_t i = 0; i + step < p->count; i += 2 * step) {                                                  \
                REAL *restrict to = partials + i * p->size;                                                            \
                const REAL *restrict from = partials + (i + step) * p->size;                                           \
                for (int64_t e = first; e < last; e++) to[e] += from[e];                                               \
            }                                                                                                          \
        if (p->fresh)                                                                                                  \
            for (int64_t e = first; e < last; e++) out[e] = partials[e];                                               \
        else                                                                                                           \
            for (int64_t e = first; e < last; e++) out[e] += partials[e];                                              \
    }
PARTIALS(float, f32)
PARTIALS(double, f64)

static void partials_cpu(const void *args, int64_t first, int64_t last)
{
    const partials_args *p = args;
    (p->dtype == HG_F32 ? partials_f32 : partials_f64)(p, first, last);
}

hg_status hg_add_partials(hg_ctx *ctx, hg_dtype dtype, int64_t count, int64_t size, void *partials, void *out,
                          bool fresh)
{
    static const hg_kernel kernel = { .name = "add_partials", .args_size = sizeof(partials_args), .cpu = partials_cpu };
    partials_args args = { dtype, count, size, partials, out, fresh };
    return hg_launch(ctx, &kernel, size, &args);
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
