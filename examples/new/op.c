/* my_op: what it is for, in one sentence.
 *
 *     y = sqrt(x^2 + e^2) - e        replace this by your own: here |x| with a rounded corner of size e
 *
 * Build it and check its gradient, on the processor and where there is one on a GPU:
 *
 *     cc -shared -fPIC $(hairgrad flags) my_op.c -o my_op.so
 *     hairgrad --plugin my_op.so gradcheck my_op
 *     hairgrad --plugin my_op.so gradcheck my_op --device cuda
 *
 * Forward and backward stand side by side, for float and double. A backward ADDS into the gradients of its inputs. */
#include "autograd/autograd.h"

#define HG_KERNEL_SOURCE hg_kernel_text
#include "tensor/kernel.h"

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

/* The work on the elements first .. last, as one text: your compiler makes it for the processor now, and CUDA's for a GPU when a
 * GPU is first asked. `real` is float and then double. On the processor blocks of a fixed size go to all threads, on a GPU each
 * element is a thread: the same bits in every run. No # lines in here, and casts of void * are written out. */
/* clang-format off */
HG_KERNEL_TEXT(
    typedef struct {
        double corner;
        const void *x;
        const void *gradient; /* of the output */
        void *out;
    } my_op_args;

    HG_BODIES(my_op_forward, my_op_args, {
        const real *x = (const real *)p->x;
        real *y = (real *)p->out;
        const real e = (real)p->corner;
        for (int64_t i = first; i < last; i++) y[i] = (real)sqrt(x[i] * x[i] + e * e) - e;
    })

    HG_BODIES(my_op_backward, my_op_args, {
        const real *x = (const real *)p->x;
        const real *dy = (const real *)p->gradient;
        real *dx = (real *)p->out;
        const real e = (real)p->corner;
        for (int64_t i = first; i < last; i++) dx[i] += dy[i] * x[i] / (real)sqrt(x[i] * x[i] + e * e);
    })

    HG_KERNELS(my_op_forward, my_op_args, 16384)
    HG_KERNELS(my_op_backward, my_op_args, 16384)
)
/* clang-format on */

static hg_status forward(hg_call *call)
{
    const my_op_attributes *attributes = call->attributes;
    const my_op_args args = { attributes->corner, call->in[0]->data, NULL, call->out->data };
    return hg_launch(call->ctx, my_op_forward_kernels[call->out->dtype == HG_F64], hg_tensor_count(call->out), &args);
}

static hg_status backward(hg_call *call)
{
    const my_op_attributes *attributes = call->attributes;
    const my_op_args args = { attributes->corner, call->in[0]->data, hg_grad(call->out)->data,
                              hg_grad(call->in[0])->data };
    return hg_launch(call->ctx, my_op_backward_kernels[call->out->dtype == HG_F64], hg_tensor_count(call->out), &args);
}

/* On these the gradient is checked. */
static const my_op_attributes tenth = { 0.1 };
static const hg_sample samples[] = {
    { .label = "matrix", .n_in = 1, .in = { { 2, { 5, 3 } } }, .attributes = &tenth }
};

HG_OP(my_op, .formula = "sqrt(x^2 + e^2) - e", .min_in = 1, .max_in = 1, .attributes_size = sizeof(my_op_attributes),
      .shape = my_op_shape, .forward = forward, .backward = backward, .samples = samples, .n_samples = 1);

/* What your programs call. */
hg_tensor *my_op(hg_ctx *ctx, hg_tensor *a, double corner)
{
    return hg_apply(ctx, &op_my_op, 1, &a, &(my_op_attributes){ corner });
}
