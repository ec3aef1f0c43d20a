/* What a convolution by cuDNN needs beside it: the bias, and results in bf16 made f32. */
#include "tensor/kernel.h"
#include "tensor/math.h"

typedef struct {
    void *to;
    const void *bias;     /* NULL: none */
    const uint16_t *from; /* of widen_result */
    int64_t pixels, channels;
    int add;
} convolution_result_args;

HG_BODY void add_bias_f32(const convolution_result_args *p, int64_t first, int64_t last)
{
    for (int64_t i = first; i < last; i++) ((float *)p->to)[i] += ((const float *)p->bias)[i / p->pixels % p->channels];
}

HG_BODY void add_bias_f64(const convolution_result_args *p, int64_t first, int64_t last)
{
    for (int64_t i = first; i < last; i++)
        ((double *)p->to)[i] += ((const double *)p->bias)[i / p->pixels % p->channels];
}
HG_KERNELS(add_bias, convolution_result_args, 16384)

HG_BODY void widen_result(const convolution_result_args *p, int64_t first, int64_t last)
{
    float *to = (float *)p->to;
    for (int64_t i = first; i < last; i++) {
        float value = hg_float_of_bits((int32_t)((uint32_t)p->from[i] << 16));
        if (p->bias) value += ((const float *)p->bias)[i / p->pixels % p->channels];
        to[i] = p->add ? to[i] + value : value;
    }
}
HG_KERNEL(widen_result, convolution_result_args, 16384)
