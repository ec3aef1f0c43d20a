/* my_op: what it is for, in one sentence.
 *
 *     y = sqrt(x^2 + e^2) - e        replace this by your own: here |x| with a rounded corner of size e
 *
 * Build it and check its gradient:
 *
 *     cc -shared -fPIC $(hairgrad flags) my_op.c -o my_op.so
 *     hairgrad --plugin my_op.so gradcheck my_op
 *
 * Forward and backward stand side by side, for float and double. A backward ADDS into the gradients of its inputs. */
#include "autograd/autograd.h"

#include <math.h>

typedef struct {
    double corner;
} my_op_attributes;

hg_tensor *my_op(hg_ctx *ctx, hg_tensor *a, double corner);

static hg_tensor *my_op_shape(hg_call *call)
{
    const hg_tensor *a = call->in[0];
    if (a->dtype != HG_F32 && a->dtype != HG_F64) return hg_refuse(call, "floating-point numbers are needed");
    return hg_tensor_make(call->ctx, a->dtype, a->rank, a->shape);
}

typedef struct {
    hg_dtype dtype;
    double corner;
    const void *x, *gradient_out; /* gradient_out NULL: forward */
    void *out;
} my_op_work;

#define MY_OP(real_, sqrt_)                                                                                            \
    static void my_op_##real_(const my_op_work *w, int64_t first, int64_t last)                                        \
    {                                                                                                                  \
        const real_ *x = w->x, *g = w->gradient_out, e = (real_)w->corner;                                             \
        real_ *out = w->out;                                                                                           \
        for (int64_t i = first; i < last; i++) {                                                                       \
            const real_ root = sqrt_(x[i] * x[i] + e * e);                                                             \
            if (g)                                                                                                     \
                out[i] += g[i] * x[i] / root;                                                                          \
            else                                                                                                       \
                out[i] = root - e;                                                                                     \
        }                                                                                                              \
    }
MY_OP(float, sqrtf)
MY_OP(double, sqrt)

static void my_op_block(const void *memory, int64_t first, int64_t last)
{
    const my_op_work *work = memory;
    (work->dtype == HG_F64 ? my_op_double : my_op_float)(work, first, last);
}

/* Blocks of a fixed size over all threads: the same bits whatever their number. */
static const hg_kernel kernel = {
    .name = "my_op", .args_size = sizeof(my_op_work), .cpu = my_op_block, .block = 16384
};

static hg_status my_op_forward(hg_call *call)
{
    const my_op_attributes *attributes = call->attributes;
    const my_op_work work = { call->out->dtype, attributes->corner, call->in[0]->data, NULL, call->out->data };
    return hg_launch(call->ctx, &kernel, hg_tensor_count(call->out), &work);
}

static hg_status my_op_backward(hg_call *call)
{
    const my_op_attributes *attributes = call->attributes;
    const my_op_work work = { call->out->dtype, attributes->corner, call->in[0]->data, hg_grad(call->out)->data,
                              hg_grad(call->in[0])->data };
    return hg_launch(call->ctx, &kernel, hg_tensor_count(call->out), &work);
}

/* On these the gradient is checked. */
static const my_op_attributes tenth = { 0.1 };
static const hg_sample samples[] = {
    { .label = "matrix", .n_in = 1, .in = { { 2, { 5, 3 } } }, .attributes = &tenth }
};

HG_OP(my_op, .formula = "sqrt(x^2 + e^2) - e", .min_in = 1, .max_in = 1, .attributes_size = sizeof(my_op_attributes),
      .shape = my_op_shape, .forward = my_op_forward, .backward = my_op_backward, .samples = samples, .n_samples = 1);

/* What your programs call. */
hg_tensor *my_op(hg_ctx *ctx, hg_tensor *a, double corner)
{
    return hg_apply(ctx, &op_my_op, 1, &a, &(my_op_attributes){ corner });
}
