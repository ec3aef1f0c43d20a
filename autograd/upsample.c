/* upsample: images [B,C,H,W] to twice their size. Bilinear is by half pixels: the large pixels lie a quarter of a pixel beside
 * the centre of the small one that they are in, and at the border the image goes on as it ends. */
#include "autograd/tape.h"
#include "autograd/upsample.kernel.h"

typedef struct {
    hg_interpolation interpolation;
} upsample_attributes;

static int interpolation_of(const hg_call *call)
{
    return (int)((const upsample_attributes *)call->attributes)->interpolation;
}

static hg_tensor *upsample_shape(hg_call *call)
{
    const hg_tensor *x = call->in[0];
    const int interpolation = interpolation_of(call);
    if (!hg_floats_agree(call)) return NULL;
    if (interpolation != HG_NEAREST && interpolation != HG_BILINEAR)
        return hg_refuse(call, "%d is no interpolation", interpolation);
    if (x->rank != 4) return hg_refuse(call, "x has to be [batch,channels,height,width]");
    return hg_out(call, x->dtype, 4, (int64_t[]){ x->shape[0], x->shape[1], 2 * x->shape[2], 2 * x->shape[3] });
}

static hg_status upsample_forward(hg_call *call)
{
    const hg_tensor *x = call->in[0];
    const upsample_args args = { .from = x->data, .to = call->out->data, .height = x->shape[2], .width = x->shape[3] };
    const hg_kernel *const *kernels =
        interpolation_of(call) == HG_NEAREST ? upsample_nearest_kernels : upsample_bilinear_kernels;
    return hg_launch(call->ctx, kernels[x->dtype == HG_F64], hg_tensor_count(call->out), &args);
}

static hg_status upsample_backward(hg_call *call)
{
    hg_tensor *x = call->in[0];
    bool fresh;
    upsample_args args = { .from = hg_grad(call->out)->data, .height = x->shape[2], .width = x->shape[3] };
    args.to = hg_grad_data(x, &fresh);
    args.fresh = fresh;
    const hg_kernel *const *kernels =
        interpolation_of(call) == HG_NEAREST ? upsample_nearest_backward_kernels : upsample_bilinear_backward_kernels;
    return hg_launch(call->ctx, kernels[x->dtype == HG_F64], hg_tensor_count(x), &args);
}

/* By the definition: where the centre of a large pixel lies among the centres of the small ones. */
static void upsample_reference(const hg_call *call, double *out)
{
    const hg_tensor *x = call->in[0];
    const int64_t size[2] = { x->shape[2], x->shape[3] }, planes = x->shape[0] * x->shape[1];
    for (int64_t plane = 0; plane < planes; plane++)
        for (int64_t i = 0; i < 2 * size[0]; i++)
            for (int64_t j = 0; j < 2 * size[1]; j++) {
                const int64_t pixel[2] = { i, j };
                double sum = 0;
                for (int corner = 0; corner < 4; corner++) {
                    int64_t at[2];
                    double weight = 1;
                    for (int axis = 0; axis < 2; axis++) {
                        const double where = ((double)pixel[axis] + 0.5) / 2 - 0.5;
                        const int64_t below = where < 0 ? -1 : (int64_t)where, upper = corner >> axis & 1;
                        at[axis] = below + upper;
                        weight *= upper ? where - (double)below : 1 - (where - (double)below);
                        if (at[axis] < 0) at[axis] = 0;
                        if (at[axis] >= size[axis]) at[axis] = size[axis] - 1;
                    }
                    sum += weight * hg_tensor_item(x, (plane * size[0] + at[0]) * size[1] + at[1]);
                }
                *out++ = interpolation_of(call) == HG_BILINEAR
                             ? sum
                             : hg_tensor_item(x, (plane * size[0] + i / 2) * size[1] + j / 2);
            }
}

/* With a factor of two every way to round to the nearest is the same. */
static hg_status upsample_emit(const hg_call *call, hg_emitter *e)
{
    const int64_t four = 4;
    const float scales[4] = { 1, 1, 2, 2 };
    const bool nearest = interpolation_of(call) == HG_NEAREST;
    const int in[3] = { e->input(e->self, call->in[0]), -1, e->constant_f32(e->self, 1, &four, scales) };
    return e->output(e->self, call->out,
                     e->node(e->self, "Resize", 3, in, "mode=s coordinate_transformation_mode=s",
                             nearest ? "nearest" : "linear", "half_pixel"));
}

#define UPSAMPLE(label_, interpolation_, b_, c_, h_, w_)                                                               \
    {                                                                                                                  \
        .label = label_, .n_in = 1, .in = { { 4, { b_, c_, h_, w_ } } }, .attributes = &(const upsample_attributes)    \
        {                                                                                                              \
            interpolation_                                                                                             \
        }                                                                                                              \
    }
static const hg_sample upsample_samples[] = {
    UPSAMPLE("nearest", HG_NEAREST, 2, 3, 3, 4),
    UPSAMPLE("bilinear", HG_BILINEAR, 2, 3, 3, 4),
    UPSAMPLE("nearest, one pixel", HG_NEAREST, 2, 2, 1, 1),
    UPSAMPLE("bilinear, one pixel", HG_BILINEAR, 2, 2, 1, 1),
    UPSAMPLE("bilinear, one row", HG_BILINEAR, 1, 2, 1, 5),
    UPSAMPLE("bilinear, one column", HG_BILINEAR, 1, 2, 5, 1),
    UPSAMPLE("bilinear, two", HG_BILINEAR, 1, 1, 2, 2),
    UPSAMPLE("nearest, empty", HG_NEAREST, 0, 2, 3, 4),
    UPSAMPLE("bilinear, empty", HG_BILINEAR, 2, 2, 0, 4),
    UPSAMPLE("several blocks", HG_BILINEAR, 2, 5, 33, 61),
};
HG_OP(upsample, .formula = "y[b,c,i,j] = x[b,c,(i + 1/2)/2 - 1/2,(j + 1/2)/2 - 1/2], the nearest or between four",
      .min_in = 1, .max_in = 1, .attributes_size = sizeof(upsample_attributes), .shape = upsample_shape,
      .forward = upsample_forward, .backward = upsample_backward, .samples = upsample_samples,
      .n_samples = sizeof upsample_samples / sizeof *upsample_samples, .reference = upsample_reference,
      .emit = upsample_emit);

hg_tensor *hg_upsample(hg_ctx *ctx, hg_tensor *x, hg_interpolation interpolation)
{
    return hg_apply(ctx, &op_upsample, 1, &x, &(upsample_attributes){ interpolation });
}
