/* Convolutions by cuDNN 9, through its functions with named algorithms: those fixed here add in the same order in every run, have
 * no choice to make and say beforehand what workspace they need. (Its graphs of operations would choose among engines at run
 * time, by version and card, and fuse nothing that is wanted here.) Descriptors are made once per shape. In bf16, factors are
 * rounded by a kernel of ours, and cuDNN's result, which is bf16 too, is made f32 by another. */
#include "tensor/cuda/convolution.kernel.h"
#include "tensor/cuda/device.h"
#include "tensor/cuda/product.kernel.h"

#include <limits.h>
#include <string.h>

enum { ALIGNMENT = 256 };

typedef struct hg_cuda_convolution {
    hg_convolution sizes;
    int type, math;
    cudnnTensorDescriptor_t x, y;
    cudnnFilterDescriptor_t weight;
    cudnnConvolutionDescriptor_t convolution;
    size_t workspace[3]; /* by hg_convolve_which */
    bool known[3];
    struct hg_cuda_convolution *next;
} shape;

static hg_status check(const hg_cuda_device *d, cudnnStatus_t status, const char *what)
{
    return status == CUDNN_STATUS_SUCCESS
               ? HG_OK
               : hg_fail(HG_NUMERIC, "cuda: cuDNN: %s: %s", what, d->dnn_api->cudnnGetErrorString(status));
}

static hg_status open_dnn(hg_cuda_device *d)
{
    if (d->dnn) return HG_OK;
    HG_TRY(hg_cuda_dnn_library(&d->dnn_api));
    cudnnHandle_t dnn;
    HG_TRY(check(d, d->dnn_api->cudnnCreate(&dnn), "its start"));
    const hg_status status = check(d, d->dnn_api->cudnnSetStream(dnn, d->stream), "its stream");
    if (status == HG_OK)
        d->dnn = dnn;
    else
        d->dnn_api->cudnnDestroy(dnn);
    return status;
}

/* ---- shapes ---- */

static void destroy(const hg_cuda_device *d, shape *s)
{
    if (s->x) d->dnn_api->cudnnDestroyTensorDescriptor(s->x);
    if (s->y) d->dnn_api->cudnnDestroyTensorDescriptor(s->y);
    if (s->weight) d->dnn_api->cudnnDestroyFilterDescriptor(s->weight);
    if (s->convolution) d->dnn_api->cudnnDestroyConvolutionDescriptor(s->convolution);
    hg_free(s);
}

void hg_cuda_convolutions_free(hg_cuda_device *d)
{
    while (d->convolutions) {
        shape *s = d->convolutions;
        d->convolutions = s->next;
        destroy(d, s);
    }
    if (d->dnn) d->dnn_api->cudnnDestroy(d->dnn);
    d->dnn = NULL;
}

static hg_status describe(const hg_cuda_device *d, shape *s)
{
    const hg_cuda_dnn_api *api = d->dnn_api;
    const hg_convolution *c = &s->sizes;
    const cudnnDataType_t type = (cudnnDataType_t)s->type;
    HG_TRY(check(d, api->cudnnCreateTensorDescriptor(&s->x), "an image"));
    HG_TRY(check(d, api->cudnnCreateTensorDescriptor(&s->y), "an image"));
    HG_TRY(check(d, api->cudnnCreateFilterDescriptor(&s->weight), "a kernel"));
    HG_TRY(check(d, api->cudnnCreateConvolutionDescriptor(&s->convolution), "a convolution"));
    HG_TRY(check(d,
                 api->cudnnSetTensor4dDescriptor(s->x, CUDNN_TENSOR_NCHW, type, (int)c->batch, (int)c->in,
                                                 (int)c->height, (int)c->width),
                 "the input's sizes"));
    HG_TRY(check(d,
                 api->cudnnSetTensor4dDescriptor(s->y, CUDNN_TENSOR_NCHW, type, (int)c->batch, (int)c->out,
                                                 (int)c->out_height, (int)c->out_width),
                 "the output's sizes"));
    HG_TRY(check(d,
                 api->cudnnSetFilter4dDescriptor(s->weight, type, CUDNN_TENSOR_NCHW, (int)c->out, (int)c->in,
                                                 (int)c->kernel_height, (int)c->kernel_width),
                 "the kernel's sizes"));
    HG_TRY(check(d,
                 api->cudnnSetConvolution2dDescriptor(s->convolution, (int)c->padding, (int)c->padding, (int)c->stride,
                                                      (int)c->stride, 1, 1, CUDNN_CROSS_CORRELATION,
                                                      type == CUDNN_DATA_DOUBLE ? CUDNN_DATA_DOUBLE : CUDNN_DATA_FLOAT),
                 "stride and padding"));
    return check(d, api->cudnnSetConvolutionMathType(s->convolution, (cudnnMathType_t)s->math), "the precision");
}

/* f32 is f32: without FMA_MATH cuDNN would round its factors to TF32. */
static hg_status find(hg_cuda_device *d, const hg_convolve_call *call, shape **out)
{
    const bool f32 = call->dtype == HG_F32;
    const int type = !f32 ? CUDNN_DATA_DOUBLE : call->compute == HG_BF16 ? CUDNN_DATA_BFLOAT16 : CUDNN_DATA_FLOAT;
    const int math = f32 && call->compute != HG_F32 ? CUDNN_TENSOR_OP_MATH : CUDNN_FMA_MATH;
    for (shape *s = d->convolutions; s; s = s->next)
        if (s->type == type && s->math == math && memcmp(&s->sizes, call->sizes, sizeof s->sizes) == 0) {
            *out = s;
            return HG_OK;
        }
    const int64_t *size = (const int64_t *)(const void *)call->sizes;
    for (size_t i = 0; i < sizeof *call->sizes / sizeof *size; i++)
        if (size[i] > INT_MAX) return hg_fail(HG_UNSUPPORTED, "convolution: sizes above 2^31 are not possible on cuda");
    shape *s = hg_alloc(1, sizeof *s);
    if (!s) return HG_MEMORY;
    s->sizes = *call->sizes;
    s->type = type;
    s->math = math;
    const hg_status status = describe(d, s);
    if (status != HG_OK) {
        destroy(d, s);
        return status;
    }
    s->next = d->convolutions;
    d->convolutions = *out = s;
    return HG_OK;
}

/* ---- workspace ---- */

static cudnnConvolutionFwdAlgo_t forward_algorithm(const shape *s)
{
    return s->type == CUDNN_DATA_DOUBLE ? CUDNN_CONVOLUTION_FWD_ALGO_IMPLICIT_GEMM
                                        : CUDNN_CONVOLUTION_FWD_ALGO_IMPLICIT_PRECOMP_GEMM;
}

static hg_status ask_workspace(const hg_cuda_device *d, shape *s, hg_convolve_which which)
{
    const hg_cuda_dnn_api *api = d->dnn_api;
    size_t *bytes = &s->workspace[which];
    if (s->known[which]) return HG_OK;
    if (which == HG_CONVOLVE)
        HG_TRY(check(d,
                     api->cudnnGetConvolutionForwardWorkspaceSize(d->dnn, s->x, s->weight, s->convolution, s->y,
                                                                  forward_algorithm(s), bytes),
                     "the workspace of a convolution"));
    else if (which == HG_CONVOLVE_TO_INPUT)
        HG_TRY(check(d,
                     api->cudnnGetConvolutionBackwardDataWorkspaceSize(d->dnn, s->weight, s->y, s->convolution, s->x,
                                                                       CUDNN_CONVOLUTION_BWD_DATA_ALGO_1, bytes),
                     "the workspace of a convolution's gradient to its input"));
    else
        HG_TRY(check(d,
                     api->cudnnGetConvolutionBackwardFilterWorkspaceSize(d->dnn, s->x, s->y, s->convolution, s->weight,
                                                                         CUDNN_CONVOLUTION_BWD_FILTER_ALGO_1, bytes),
                     "the workspace of a convolution's gradient to its weight"));
    s->known[which] = true;
    return HG_OK;
}

static size_t aligned(size_t bytes) { return (bytes + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT; }

/* Elements of x, weight and y. */
static void count(const hg_convolution *s, int64_t counts[3])
{
    counts[0] = s->batch * s->in * s->height * s->width;
    counts[1] = s->out * s->in * s->kernel_height * s->kernel_width;
    counts[2] = s->batch * s->out * s->out_height * s->out_width;
}

hg_status hg_cuda_convolve_workspace(hg_device *device, int threads, const hg_convolve_call *call, size_t *bytes)
{
    hg_cuda_device *d = (hg_cuda_device *)(void *)device;
    shape *s;
    int64_t counts[3];
    (void)threads;
    HG_TRY(hg_cuda_enter(d)); /* cuDNN looks at the device when it is asked */
    HG_TRY(open_dnn(d));
    HG_TRY(find(d, call, &s));
    HG_TRY(ask_workspace(d, s, call->which));
    count(&s->sizes, counts);
    *bytes = aligned(s->workspace[call->which]) + ALIGNMENT;
    for (int i = 0; i < 3 && s->type == CUDNN_DATA_BFLOAT16; i++) *bytes += aligned((size_t)counts[i] * 2);
    return HG_OK;
}

/* ---- the call ---- */

typedef struct {
    const shape *shape;
    void *x, *weight, *y, *workspace;
    size_t bytes;
    int64_t which, add;
} convolution_call;

static hg_status run_convolution(hg_cuda_device *d, const void *args)
{
    const convolution_call *p = args;
    const hg_cuda_dnn_api *api = d->dnn_api;
    const shape *s = p->shape;
    const float one = 1, beta = p->add ? 1 : 0;
    const double one_f64 = 1, beta_f64 = p->add ? 1 : 0;
    const bool f64 = s->type == CUDNN_DATA_DOUBLE;
    const void *alpha_at = f64 ? (const void *)&one_f64 : &one, *beta_at = f64 ? (const void *)&beta_f64 : &beta;
    if (p->which == HG_CONVOLVE)
        return check(d,
                     api->cudnnConvolutionForward(d->dnn, alpha_at, s->x, p->x, s->weight, p->weight, s->convolution,
                                                  forward_algorithm(s), p->workspace, p->bytes, beta_at, s->y, p->y),
                     "a convolution");
    if (p->which == HG_CONVOLVE_TO_INPUT)
        return check(d,
                     api->cudnnConvolutionBackwardData(d->dnn, alpha_at, s->weight, p->weight, s->y, p->y,
                                                       s->convolution, CUDNN_CONVOLUTION_BWD_DATA_ALGO_1, p->workspace,
                                                       p->bytes, beta_at, s->x, p->x),
                     "a convolution's gradient to its input");
    return check(d,
                 api->cudnnConvolutionBackwardFilter(d->dnn, alpha_at, s->x, p->x, s->y, p->y, s->convolution,
                                                     CUDNN_CONVOLUTION_BWD_FILTER_ALGO_1, p->workspace, p->bytes,
                                                     beta_at, s->weight, p->weight),
                 "a convolution's gradient to its weight");
}

hg_status hg_cuda_convolve(hg_device *device, int threads, const hg_convolve_call *call, void *workspace)
{
    hg_cuda_device *d = (hg_cuda_device *)(void *)device;
    shape *s;
    int64_t counts[3];
    HG_TRY(find(d, call, &s));
    count(&s->sizes, counts);
    const int written = call->which == HG_CONVOLVE ? 2 : call->which == HG_CONVOLVE_TO_INPUT ? 0 : 1;
    void *arrays[3] = { call->x, call->weight, call->y }, *result = arrays[written];
    char *place = (char *)(aligned((size_t)(uintptr_t)workspace));
    const bool bf16 = s->type == CUDNN_DATA_BFLOAT16;
    for (int i = 0; i < 3 && bf16; i++) {
        uint16_t *rounded = (uint16_t *)(void *)place;
        const round_factor_args args = { arrays[i], rounded, counts[i], counts[i], counts[i] };
        if (i != written) HG_TRY(device->launch(device, threads, &round_factor_kernel, counts[i], &args));
        arrays[i] = rounded;
        place += aligned((size_t)counts[i] * 2);
    }
    const convolution_call args = { .shape = s,
                                    .x = arrays[0],
                                    .weight = arrays[1],
                                    .y = arrays[2],
                                    .workspace = place,
                                    .bytes = s->workspace[call->which],
                                    .which = (int64_t)call->which,
                                    .add = !bf16 && call->add };
    HG_TRY(hg_cuda_do(d, "convolution", run_convolution, &args, sizeof args));
    if (!bf16 && !call->bias) return HG_OK;
    convolution_result_args finish = { .to = result,
                                       .bias = call->bias,
                                       .from = bf16 ? arrays[written] : NULL,
                                       .pixels = s->sizes.out_height * s->sizes.out_width,
                                       .channels = s->sizes.out,
                                       .add = call->add };
    return device->launch(device, threads, bf16 ? &widen_result_kernel : add_bias_kernels[call->dtype == HG_F64],
                          counts[written], &finish);
}
