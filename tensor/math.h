/* Elementary functions that vectorise and give the same bits in a vector as alone: no branches, no tables, no library
 * calls in f32. The f64 twins are the C library's. Errors in f32 are a few units in the last place. */
#ifndef HG_TENSOR_MATH_H
#define HG_TENSOR_MATH_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#ifndef HG_BODY /* as tensor/kernel.h has it: these are for kernels too */
#ifdef HG_CUDA
#define HG_BODY static __device__ inline
#define restrict __restrict__
#else
#define HG_BODY static inline
#endif
#endif

HG_BODY float hg_float_of_bits(int32_t bits)
{
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

HG_BODY int32_t hg_bits_of_float(float x)
{
    int32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

/* exp(x) = 2^n exp(r), n = round(x / ln 2), |r| <= ln 2 / 2, exp(r) by its series up to r^7 (the rest is below 6e-9).
 * 2^n is applied in two halves so that results near the ends of the range, infinite and subnormal ones included, come
 * out right. NaN stays NaN. */
HG_BODY float hg_exp_f32(float x)
{
    const float shift = 12582912.0f; /* 1.5 2^23: adding it leaves round(x) in the low bits of the sum */
    x = x > 89.0f ? 89.0f : x;
    x = x < -104.0f ? -104.0f : x;
    float t = x * 1.44269504f + shift;
    float n = t - shift;
    float r = (x - n * 0.693145752f) - n * 1.42860677e-6f;
    float y = 1.98412698e-4f;
    y = y * r + 1.38888889e-3f;
    y = y * r + 8.33333333e-3f;
    y = y * r + 4.16666667e-2f;
    y = y * r + 1.66666667e-1f;
    y = y * r + 0.5f;
    y = y * r + 1.0f;
    y = y * r + 1.0f;
    int32_t k = (int32_t)((uint32_t)hg_bits_of_float(t) - (uint32_t)hg_bits_of_float(shift));
    int32_t half = k / 2;
    uint32_t first = (uint32_t)(half + 127) << 23, second = (uint32_t)(k - half + 127) << 23;
    return y * hg_float_of_bits((int32_t)first) * hg_float_of_bits((int32_t)second);
}
HG_BODY double hg_exp_f64(double x) { return exp(x); }

HG_BODY float hg_sigmoid_f32(float x) { return 1.0f / (1.0f + hg_exp_f32(-x)); }
HG_BODY double hg_sigmoid_f64(double x) { return 1.0 / (1.0 + exp(-x)); }

/* (1 - e) / (1 + e) with e = exp(-2|x|); the odd series up to x^11 where that would cancel (rest below 2e-9). */
HG_BODY float hg_tanh_f32(float x)
{
    float a = x < 0 ? -x : x;
    float e = hg_exp_f32(-2.0f * a);
    float large = (1.0f - e) / (1.0f + e);
    float s = x * x;
    float y = -8.86323553e-3f;
    y = y * s + 2.18694885e-2f;
    y = y * s - 5.39682540e-2f;
    y = y * s + 1.33333333e-1f;
    y = y * s - 3.33333333e-1f;
    float small = x + x * s * y;
    return a < 0.3f ? small : x < 0 ? -large : large;
}
HG_BODY double hg_tanh_f64(double x) { return tanh(x); }

/* log(1 + exp(x)) = max(x, 0) + log1p(exp(-|x|)); log1p(e) = 2 atanh(e / (2 + e)), a series in at most (1/3)^2. */
HG_BODY float hg_softplus_f32(float x)
{
    float e = hg_exp_f32(x < 0 ? x : -x);
    float q = e / (2.0f + e), s = q * q;
    float y = 7.69230769e-2f;
    y = y * s + 9.09090909e-2f;
    y = y * s + 1.11111111e-1f;
    y = y * s + 1.42857143e-1f;
    y = y * s + 0.2f;
    y = y * s + 3.33333333e-1f;
    y = y * s + 1.0f;
    return (x > 0 ? x : 0.0f) + 2.0f * q * y;
}
HG_BODY double hg_softplus_f64(double x) { return (x > 0 ? x : 0.0) + log1p(exp(x < 0 ? x : -x)); }

#ifdef HG_CUDA /* where f64 is dear */
HG_BODY float hg_log_f32(float x) { return logf(x); }
#else
HG_BODY float hg_log_f32(float x) { return (float)log((double)x); }
#endif
HG_BODY double hg_log_f64(double x) { return log(x); }

HG_BODY float hg_sqrt_f32(float x) { return sqrtf(x); }
HG_BODY double hg_sqrt_f64(double x) { return sqrt(x); }

/* Round to nearest even; NaN stays NaN. As hg_bf16_from_f32, many at a time. */
HG_BODY void hg_bf16_of_f32(int64_t n, const float *restrict from, uint16_t *restrict to)
{
#ifndef HG_CUDA
#pragma omp simd
#endif
    for (int64_t i = 0; i < n; i++) {
        const uint32_t bits = (uint32_t)hg_bits_of_float(from[i]);
        const uint32_t rounded = (bits + 0x7fffu + (bits >> 16 & 1u)) >> 16, quiet = bits >> 16 | 0x40u;
        to[i] = (uint16_t)((bits & 0x7fffffffu) > 0x7f800000u ? quiet : rounded);
    }
}

/* GELU in its tanh form (Hendrycks and Gimpel 2016), x sigmoid(2u) with u = sqrt(2 / pi) (x + 0.044715 x^3). */
#define HG_GELU_SCALE 1.5957691216057308 /* 2 sqrt(2 / pi) */
#define HG_GELU_CUBE  0.044715

#endif
