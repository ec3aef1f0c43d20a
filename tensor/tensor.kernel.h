/* Kernels of tensors: fill, copy with conversion. */
#include "tensor/kernel.h"
#include "tensor/math.h"

HG_BODY uint16_t bf16_of_f32(float x)
{
    const uint32_t bits = (uint32_t)hg_bits_of_float(x);
    if ((bits & 0x7fffffffu) > 0x7f800000u)
        return (uint16_t)(bits >> 16 | 0x40u); /* quiet, never rounded to infinity */
    return (uint16_t)((bits + 0x7fffu + (bits >> 16 & 1u)) >> 16);
}

HG_BODY float f32_of_bf16(uint16_t x) { return hg_float_of_bits((int32_t)((uint32_t)x << 16)); }

/* A number that i32 cannot hold becomes the nearest that it can, NaN becomes 0: defined, where C leaves it open. */
HG_BODY int32_t i32_of(double x)
{
    return x != x ? 0 : x <= -2147483648.0 ? (int32_t)-2147483647 - 1 : x >= 2147483647.0 ? 2147483647 : (int32_t)x;
}

HG_BODY double number_at(const void *data, int dtype, int64_t i)
{
    return dtype == HG_F32   ? (double)((const float *)data)[i]
           : dtype == HG_F64 ? ((const double *)data)[i]
           : dtype == HG_I32 ? (double)((const int32_t *)data)[i]
                             : (double)f32_of_bf16(((const uint16_t *)data)[i]);
}

HG_BODY void put_number(void *data, int dtype, int64_t i, double value)
{
    if (dtype == HG_F32)
        ((float *)data)[i] = (float)value;
    else if (dtype == HG_F64)
        ((double *)data)[i] = value;
    else if (dtype == HG_I32)
        ((int32_t *)data)[i] = i32_of(value);
    else
        ((uint16_t *)data)[i] = bf16_of_f32((float)value);
}

typedef struct {
    void *data;
    double value;
    int dtype;
} fill_args;

HG_BODY void fill(const fill_args *p, int64_t first, int64_t last)
{
    if (p->dtype == HG_F32) {
        float *to = (float *)p->data;
        const float value = (float)p->value;
        for (int64_t i = first; i < last; i++) to[i] = value;
    } else {
        for (int64_t i = first; i < last; i++) put_number(p->data, p->dtype, i, p->value);
    }
}
HG_KERNEL(fill, fill_args, 65536)

typedef struct {
    void *to;
    const void *from;
    int to_dtype, from_dtype;
} copy_args;

HG_BODY void copy(const copy_args *p, int64_t first, int64_t last)
{
    if (p->to_dtype != p->from_dtype) {
        for (int64_t i = first; i < last; i++) put_number(p->to, p->to_dtype, i, number_at(p->from, p->from_dtype, i));
    } else if (p->to_dtype == HG_F64) {
        for (int64_t i = first; i < last; i++) ((double *)p->to)[i] = ((const double *)p->from)[i];
    } else if (p->to_dtype == HG_BF16) {
        for (int64_t i = first; i < last; i++) ((uint16_t *)p->to)[i] = ((const uint16_t *)p->from)[i];
    } else {
        for (int64_t i = first; i < last; i++) ((int32_t *)p->to)[i] = ((const int32_t *)p->from)[i];
    }
}
HG_KERNEL(copy, copy_args, 65536)
