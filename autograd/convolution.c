/* conv2d: convolution of images [B,C,H,W], by the device's hg_convolve and its two gradients. */
#include "autograd/tape.h"

#include <string.h>

typedef struct {
    int stride, padding;
} conv2d_attributes;

static const hg_tensor *bias_of(const hg_call *call) { return call->n_in > 2 ? call->in[2] : NULL; }

/* The outputs of an axis; below 1 where the kernel does not fit. */
static int64_t outputs(int64_t size, int64_t kernel, const conv2d_attributes *attributes)
{
    const int64_t room = size + 2 * (int64_t)attributes->padding - kernel;
    return room < 0 ? 0 : room / attributes->stride + 1;
}

static hg_convolution sizes_of(const hg_call *call)
{
    const hg_tensor *x = call->in[0], *weight = call->in[1];
    const conv2d_attributes *attributes = call->attributes;
    return (hg_convolution){ .batch = x->shape[0],
                             .in = x->shape[1],
                             .height = x->shape[2],
                             .width = x->shape[3],
                             .out = weight->shape[0],
                             .kernel_height = weight->shape[2],
                             .kernel_width = weight->shape[3],
                             .stride = attributes->stride,
                             .padding = attributes->padding,
                             .out_height = outputs(x->shape[2], weight->shape[2], attributes),
                             .out_width = outputs(x->shape[3], weight->shape[3], attributes) };
}

static hg_tensor *conv2d_shape(hg_call *call)
{
    const hg_tensor *x = call->in[0], *weight = call->in[1], *bias = bias_of(call);
    const conv2d_attributes *attributes = call->attributes;
    if (!hg_floats_agree(call)) return NULL;
    if (attributes->stride < 1 || attributes->padding < 0)
        return hg_refuse(call, "stride %d, padding %d: at least 1 and 0 are needed", attributes->stride,
                         attributes->padding);
    if (x->rank != 4 || weight->rank != 4 || x->shape[1] != weight->shape[1])
        return hg_refuse(call, "x [batch,in,height,width] and weight [out,in,height,width] do not fit");
    if (bias && (bias->rank != 1 || bias->shape[0] != weight->shape[0]))
        return hg_refuse(call, "bias has to be [out], as weight [out,in,height,width] has it");
    for (int i = 0; i < 4; i++)
        if (weight->shape[i] < 1) return hg_refuse(call, "axis %d of weight is empty", i);
    const hg_convolution s = sizes_of(call);
    if (s.out_height < 1 || s.out_width < 1)
        return hg_refuse(call, "kernels of %lld x %lld do not fit into images of %lld x %lld with padding %d",
                         (long long)s.kernel_height, (long long)s.kernel_width, (long long)s.height, (long long)s.width,
                         attributes->padding);
    return hg_out(call, x->dtype, 4, (int64_t[]){ s.batch, s.out, s.out_height, s.out_width });
}

static hg_status conv2d_forward(hg_call *call)
{
    const hg_convolution sizes = sizes_of(call);
    const hg_tensor *bias = bias_of(call);
    return hg_convolve(call->ctx, call->out->dtype, &sizes, call->in[0]->data, call->in[1]->data,
                       bias ? bias->data : NULL, call->out->data);
}

/* Over the pixels of an image, then over images. */
static hg_status bias_gradient(const hg_call *call, const hg_convolution *s, const void *g)
{
    hg_ctx *ctx = call->ctx;
    const hg_dtype dtype = call->out->dtype;
    bool fresh;
    const hg_step_mark mark = hg_step_set_mark(ctx);
    void *images = hg_step_device(ctx, (size_t)(s->batch * s->out) * hg_dtype_size(dtype));
    if (!images) return HG_MEMORY;
    HG_TRY(hg_sum_middle(ctx, dtype, s->batch * s->out, s->out_height * s->out_width, 1, 1, g, images, true));
    void *gradient = hg_grad_data(call->in[2], &fresh);
    HG_TRY(hg_sum_middle(ctx, dtype, 1, s->batch, s->out, 1, images, gradient, fresh));
    hg_step_rewind(ctx, mark);
    return HG_OK;
}

static hg_status conv2d_backward(hg_call *call)
{
    const hg_convolution sizes = sizes_of(call);
    hg_tensor *x = call->in[0], *weight = call->in[1];
    const hg_dtype dtype = call->out->dtype;
    const void *g = hg_grad(call->out)->data;
    bool fresh;
    if (sizes.batch == 0) return HG_OK; /* the engine zeroes what is not written */
    if (hg_needs_grad(x)) {
        void *dx = hg_grad_data(x, &fresh);
        HG_TRY(hg_convolve_to_input(call->ctx, dtype, &sizes, weight->data, g, !fresh, dx));
    }
    if (hg_needs_grad(weight)) {
        void *dweight = hg_grad_data(weight, &fresh);
        HG_TRY(hg_convolve_to_weight(call->ctx, dtype, &sizes, x->data, g, !fresh, dweight));
    }
    return call->n_in > 2 && hg_needs_grad(call->in[2]) ? bias_gradient(call, &sizes, g) : HG_OK;
}

static void conv2d_reference(const hg_call *call, double *out)
{
    const hg_convolution s = sizes_of(call);
    const hg_tensor *x = call->in[0], *weight = call->in[1], *bias = bias_of(call);
    for (int64_t b = 0; b < s.batch; b++)
        for (int64_t o = 0; o < s.out; o++)
            for (int64_t i = 0; i < s.out_height; i++)
                for (int64_t j = 0; j < s.out_width; j++) {
                    double sum = bias ? hg_tensor_item(bias, o) : 0;
                    for (int64_t c = 0; c < s.in; c++)
                        for (int64_t u = 0; u < s.kernel_height; u++)
                            for (int64_t v = 0; v < s.kernel_width; v++) {
                                const int64_t y = i * s.stride + u - s.padding, z = j * s.stride + v - s.padding;
                                if (y < 0 || y >= s.height || z < 0 || z >= s.width) continue;
                                sum +=
                                    hg_tensor_item(x, ((b * s.in + c) * s.height + y) * s.width + z) *
                                    hg_tensor_item(weight, ((o * s.in + c) * s.kernel_height + u) * s.kernel_width + v);
                            }
                    *out++ = sum;
                }
}

static hg_status conv2d_emit(const hg_call *call, hg_emitter *e)
{
    const conv2d_attributes *attributes = call->attributes;
    const hg_tensor *weight = call->in[1];
    const int64_t kernel[2] = { weight->shape[2], weight->shape[3] },
                  strides[2] = { attributes->stride, attributes->stride }, padding = attributes->padding,
                  pads[4] = { padding, padding, padding, padding };
    int in[3] = { e->input(e->self, call->in[0]), e->input(e->self, weight) };
    if (bias_of(call)) in[2] = e->input(e->self, call->in[2]);
    return e->output(e->self, call->out,
                     e->node(e->self, "Conv", bias_of(call) ? 3 : 2, in, "kernel_shape=I strides=I pads=I", 2, kernel,
                             2, strides, 4, pads));
}

#define CONV2D(label_, stride_, padding_, b_, c_, h_, w_, o_, u_, v_)                                                  \
    {                                                                                                                  \
        .label = label_, .n_in = 3, .in = { { 4, { b_, c_, h_, w_ } }, { 4, { o_, c_, u_, v_ } }, { 1, { o_ } } },     \
        .attributes = &(const conv2d_attributes)                                                                       \
        {                                                                                                              \
            stride_, padding_                                                                                          \
        }                                                                                                              \
    }
static const hg_sample conv2d_samples[] = {
    CONV2D("padded", 1, 1, 2, 3, 5, 4, 2, 3, 3),
    CONV2D("stride, odd sizes", 2, 1, 2, 2, 7, 5, 3, 3, 3),
    CONV2D("stride, rest of the image unused", 2, 0, 1, 2, 6, 8, 2, 3, 3),
    CONV2D("even kernel", 2, 1, 1, 3, 4, 6, 2, 4, 2),
    CONV2D("stride beyond the kernel", 3, 0, 2, 2, 7, 8, 2, 2, 1),
    CONV2D("padding beyond the kernel", 1, 3, 1, 2, 2, 3, 2, 2, 2),
    CONV2D("pixels alone", 1, 0, 2, 5, 3, 4, 7, 1, 1),
    CONV2D("pixels alone, every other", 2, 0, 2, 3, 4, 5, 2, 1, 1),
    CONV2D("as large as the image", 1, 0, 2, 2, 3, 4, 3, 3, 4),
    CONV2D("one pixel", 1, 1, 1, 2, 1, 1, 3, 3, 3),
    CONV2D("one", 1, 0, 1, 1, 1, 1, 1, 1, 1),
    CONV2D("empty", 1, 1, 0, 2, 4, 4, 3, 3, 3),
    CONV2D("several blocks", 1, 1, 2, 9, 21, 15, 70, 3, 3),
    { .label = "no bias",
      .n_in = 2,
      .in = { { 4, { 1, 2, 4, 4 } }, { 4, { 2, 2, 3, 3 } } },
      .attributes = &(const conv2d_attributes){ 1, 1 } },
};
HG_OP(conv2d,
      .formula = "y[b,o,i,j] = bias[o] + sum weight[o,c,u,v] x[b,c,stride i + u - padding,stride j + v - padding]",
      .min_in = 2, .max_in = 3, .attributes_size = sizeof(conv2d_attributes), .shape = conv2d_shape,
      .forward = conv2d_forward, .backward = conv2d_backward, .samples = conv2d_samples,
      .n_samples = sizeof conv2d_samples / sizeof *conv2d_samples, .reference = conv2d_reference, .emit = conv2d_emit);

hg_tensor *hg_conv2d(hg_ctx *ctx, hg_tensor *x, hg_tensor *weight, hg_tensor *bias, int stride, int padding)
{
    return hg_apply(ctx, &op_conv2d, 3, (hg_tensor *[]){ x, weight, bias }, &(conv2d_attributes){ stride, padding });
}
