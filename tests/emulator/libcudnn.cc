/* An emulating libcudnn.so.9: convolutions of packed images as columns and products, run when the stream comes to them. Arguments
 * are checked at the call as cuDNN checks them. Stricter than cuDNN in one thing: algorithms that add in no fixed order are not
 * supported. The workspace is filled with rubbish, and freed memory of the device is found by the driver. */
#include "enqueue.h"
#include "library.h"

#include <dnnl.h>
#include <math.h>
#include <stdint.h>
#include <string.h>
#include <vector>

namespace
{
enum { SUCCESS = 0, NOT_INITIALIZED = 1001, BAD_PARAM = 2000, NULL_POINTER = 2002, INSUFFICIENT = 2006, MISMATCH = 2008, NOT_SUPPORTED = 3000, ALLOC_FAILED = 4004, EXECUTION_FAILED = 5000 };
enum { F32 = 0, F64 = 1, BF16 = 9 };
enum { FORWARD, TO_INPUT, TO_WEIGHT };
enum : uint64_t { HANDLE = 0x646e6e68616e646c, TENSOR, FILTER, CONVOLUTION };

struct handle {
    uint64_t kind;
    unsigned long long own; /* memory of the device that it takes when it is made, as cuDNN does */
    void *stream;
};
struct tensor { /* or filter */
    uint64_t kind;
    int type, n, c, h, w;
};
struct convolution {
    uint64_t kind;
    int pad_h, pad_w, stride_h, stride_w, type, math;
    bool set;
};
template <class T> T *of(void *memory, uint64_t kind)
{
    T *t = (T *)memory;
    return t && t->kind == kind ? t : nullptr;
}

struct call {
    tensor x, w, y;
    convolution c;
    int which;
    double alpha, beta;
    const void *a, *b;
    void *out, *workspace;
    size_t bytes;
};

float from_bits(uint32_t bits)
{
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}
uint32_t to_bits(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}
float to_tf32(float x) { return isfinite(x) ? from_bits((to_bits(x) + 0x1000u) & ~0x1fffu) : x; }
uint16_t to_bf16(float x)
{
    const uint32_t bits = to_bits(x);
    return isnan(x) ? 0x7fff : (uint16_t)((bits + 0x7fffu + (bits >> 16 & 1u)) >> 16);
}

size_t count(const tensor &t) { return (size_t)t.n * t.c * t.h * t.w; }

template <class T> std::vector<T> factors(const tensor &t, const void *from, bool tf32)
{
    std::vector<T> to(count(t));
    for (size_t i = 0; i < to.size(); i++)
        to[i] = t.type == F64 ? (T)((const double *)from)[i] : t.type == BF16 ? (T)from_bits((uint32_t)((const uint16_t *)from)[i] << 16) : tf32 ? (T)to_tf32(((const float *)from)[i]) : (T)((const float *)from)[i];
    return to;
}

void product(bool ta, bool tb, int m, int n, int k, const float *a, int lda, const float *b, int ldb, float beta, float *c)
{
    if (dnnl_sgemm(ta ? 'T' : 'N', tb ? 'T' : 'N', m, n, k, 1, a, lda, b, ldb, beta, c, n)) emulator_stop("cuDNN: oneDNN refuses the product");
}
void product(bool ta, bool tb, int m, int n, int k, const double *a, int lda, const double *b, int ldb, double beta, double *c)
{
    for (int i = 0; i < m; i++)
        for (int j = 0; j < n; j++) {
            double sum = 0;
            for (int l = 0; l < k; l++) sum += (ta ? a[l * (size_t)lda + i] : a[i * (size_t)lda + l]) * (tb ? b[j * (size_t)ldb + l] : b[l * (size_t)ldb + j]);
            double &to = c[i * (size_t)n + j];
            to = beta == 0 ? sum : to + sum;
        }
}

/* To the columns of an image, or from them. */
template <class T> void columns(const call &p, T *image, T *column, bool back)
{
    for (int c = 0; c < p.x.c; c++)
        for (int u = 0; u < p.w.h; u++)
            for (int v = 0; v < p.w.w; v++)
                for (int i = 0; i < p.y.h; i++)
                    for (int j = 0; j < p.y.w; j++, column++) {
                        const int y = i * p.c.stride_h + u - p.c.pad_h, x = j * p.c.stride_w + v - p.c.pad_w;
                        const bool inside = y >= 0 && y < p.x.h && x >= 0 && x < p.x.w;
                        T *pixel = image + ((size_t)c * p.x.h + (inside ? y : 0)) * p.x.w + (inside ? x : 0);
                        if (!back)
                            *column = inside ? *pixel : 0;
                        else if (inside)
                            *pixel += *column;
                    }
}

template <class T> void run_as(const call &p)
{
    const bool tf32 = p.x.type == F32 && p.c.math != 3;
    const int k = p.x.c * p.w.h * p.w.w, pixels = p.y.h * p.y.w, out = p.w.n;
    const tensor &result = p.which == FORWARD ? p.y : p.which == TO_INPUT ? p.x : p.w;
    const std::vector<T> a = factors<T>(p.which == TO_INPUT ? p.w : p.x, p.a, tf32), b = factors<T>(p.which == FORWARD ? p.w : p.y, p.b, tf32);
    std::vector<T> to(count(result)), column((size_t)k * pixels);
    for (int n = 0; n < p.x.n; n++) {
        const size_t image = (size_t)n * p.x.c * p.x.h * p.x.w, results = (size_t)n * out * pixels;
        if (p.which != TO_INPUT) columns(p, const_cast<T *>(a.data()) + image, column.data(), false);
        if (p.which == FORWARD) product(false, false, out, pixels, k, b.data(), k, column.data(), pixels, (T)0, to.data() + results);
        if (p.which == TO_WEIGHT) product(false, true, out, k, pixels, b.data() + results, pixels, column.data(), pixels, (T)(n > 0), to.data());
        if (p.which == TO_INPUT) {
            product(true, false, k, pixels, out, a.data(), k, b.data() + results, pixels, (T)0, column.data());
            columns(p, to.data() + image, column.data(), true);
        }
    }
    for (size_t i = 0; i < to.size(); i++) {
        const T value = (T)p.alpha * to[i];
        if (result.type == BF16) {
            uint16_t &at = ((uint16_t *)p.out)[i];
            at = to_bf16((float)(p.beta == 0 ? value : value + (T)p.beta * (T)from_bits((uint32_t)at << 16)));
        } else {
            T &at = ((T *)p.out)[i];
            at = p.beta == 0 ? value : value + (T)p.beta * at;
        }
    }
    if (p.bytes) memset(p.workspace, 0xff, p.bytes);
}
void run(const void *args)
{
    const call &p = *(const call *)args;
    if (p.x.type == F64)
        run_as<double>(p);
    else
        run_as<float>(p);
}

/* What every use of these descriptors checks; the workspace that it needs. */
int check(void *h, void *x, void *w, void *c, void *y, int which, int algorithm, call *p, size_t *bytes)
{
    if (!of<handle>(h, HANDLE)) return NOT_INITIALIZED;
    const tensor *tx = of<tensor>(x, TENSOR), *tw = of<tensor>(w, FILTER), *ty = of<tensor>(y, TENSOR);
    const convolution *tc = of<convolution>(c, CONVOLUTION);
    if (!tx || !tw || !ty || !tc || !tc->set || !tx->n || !tw->n || !ty->n) return BAD_PARAM;
    if (tx->type != tw->type || tx->type != ty->type) return BAD_PARAM;
    if (tc->type != (tx->type == F64 ? F64 : F32)) return NOT_SUPPORTED;
    if (tx->type == BF16 && tc->math == 3) return NOT_SUPPORTED;
    if (tx->c != tw->c || ty->c != tw->n || tx->n != ty->n) return MISMATCH;
    if (ty->h != 1 + (tx->h + 2 * tc->pad_h - tw->h) / tc->stride_h || ty->w != 1 + (tx->w + 2 * tc->pad_w - tw->w) / tc->stride_w) return MISMATCH;
    const bool fixed = which == FORWARD ? algorithm == 0 || algorithm == 1 : algorithm == 1; /* the others add in any order, or are not there */
    if (!fixed) return NOT_SUPPORTED;
    *p = { *tx, *tw, *ty, *tc, which, 0, 0, nullptr, nullptr, nullptr, nullptr, 0 };
    *bytes = algorithm ? 1024 + 16 * (size_t)tw->c * tw->h * tw->w : 0;
    return SUCCESS;
}

int ask(void *h, void *x, void *w, void *c, void *y, int which, int algorithm, size_t *bytes)
{
    call p;
    return bytes ? check(h, x, w, c, y, which, algorithm, &p, bytes) : NULL_POINTER;
}

int queue(void *h, void *x, void *w, void *c, void *y, int which, int algorithm, const void *alpha, const void *beta, const void *a, const void *b, void *out, void *workspace, size_t bytes)
{
    static const char *const names[] = { "cudnnConvolutionForward", "cudnnConvolutionBackwardData", "cudnnConvolutionBackwardFilter" };
    call p;
    size_t needed;
    if (const int status = check(h, x, w, c, y, which, algorithm, &p, &needed)) return status;
    if (!alpha || !beta || !a || !b || !out) return NULL_POINTER;
    if (bytes < needed || (needed && !workspace)) return INSUFFICIENT;
    p.alpha = p.x.type == F64 ? *(const double *)alpha : (double)*(const float *)alpha;
    p.beta = p.x.type == F64 ? *(const double *)beta : (double)*(const float *)beta;
    p.a = a, p.b = b, p.out = out, p.workspace = workspace, p.bytes = needed;
    return emulator_enqueue(((handle *)h)->stream, names[which], run, &p, sizeof p) ? EXECUTION_FAILED : SUCCESS;
}

template <class T> int create(void **out, uint64_t kind)
{
    if (!out) return NULL_POINTER;
    T *t = new T();
    t->kind = kind;
    return *out = t, SUCCESS;
}
template <class T> int destroy(void *memory, uint64_t kind)
{
    T *t = of<T>(memory, kind);
    if (!t) return BAD_PARAM;
    t->kind = 0;
    return delete t, SUCCESS;
}
int set(void *memory, uint64_t kind, int format, int type, int n, int c, int h, int w)
{
    tensor *t = of<tensor>(memory, kind);
    if (!t || n < 1 || c < 1 || h < 1 || w < 1) return BAD_PARAM;
    if (format != 0 || (type != F32 && type != F64 && type != BF16)) return NOT_SUPPORTED;
    return *t = { kind, type, n, c, h, w }, SUCCESS;
}
} // namespace

extern "C" {
size_t cudnnGetVersion() { return 90000; }
int cudnnCreate(void **out)
{
    unsigned long long own;
    if (!out) return NULL_POINTER;
    if (emulator_alloc(&own, 1 << 20)) return ALLOC_FAILED;
    return *out = new handle{ HANDLE, own, nullptr }, SUCCESS;
}
int cudnnDestroy(void *h)
{
    if (!of<handle>(h, HANDLE)) return NOT_INITIALIZED;
    emulator_free(((handle *)h)->own);
    return destroy<handle>(h, HANDLE);
}
int cudnnSetStream(void *h, void *stream) { return of<handle>(h, HANDLE) ? ((handle *)h)->stream = stream, SUCCESS : NOT_INITIALIZED; }
const char *cudnnGetErrorString(int status)
{
    switch (status) {
    case SUCCESS: return "CUDNN_STATUS_SUCCESS";
    case NOT_INITIALIZED: return "CUDNN_STATUS_NOT_INITIALIZED";
    case BAD_PARAM: return "CUDNN_STATUS_BAD_PARAM";
    case NULL_POINTER: return "CUDNN_STATUS_BAD_PARAM_NULL_POINTER";
    case INSUFFICIENT: return "CUDNN_STATUS_BAD_PARAM_SIZE_INSUFFICIENT";
    case MISMATCH: return "CUDNN_STATUS_BAD_PARAM_SHAPE_MISMATCH";
    case NOT_SUPPORTED: return "CUDNN_STATUS_NOT_SUPPORTED";
    case ALLOC_FAILED: return "CUDNN_STATUS_INTERNAL_ERROR_DEVICE_ALLOCATION_FAILED";
    case EXECUTION_FAILED: return "CUDNN_STATUS_EXECUTION_FAILED";
    }
    return "CUDNN_UNKNOWN_STATUS";
}
int cudnnCreateTensorDescriptor(void **out) { return create<tensor>(out, TENSOR); }
int cudnnDestroyTensorDescriptor(void *t) { return destroy<tensor>(t, TENSOR); }
int cudnnSetTensor4dDescriptor(void *t, int format, int type, int n, int c, int h, int w) { return set(t, TENSOR, format, type, n, c, h, w); }
int cudnnCreateFilterDescriptor(void **out) { return create<tensor>(out, FILTER); }
int cudnnDestroyFilterDescriptor(void *t) { return destroy<tensor>(t, FILTER); }
int cudnnSetFilter4dDescriptor(void *t, int type, int format, int k, int c, int h, int w) { return set(t, FILTER, format, type, k, c, h, w); }
int cudnnCreateConvolutionDescriptor(void **out) { return create<convolution>(out, CONVOLUTION); }
int cudnnDestroyConvolutionDescriptor(void *t) { return destroy<convolution>(t, CONVOLUTION); }
int cudnnSetConvolution2dDescriptor(void *memory, int pad_h, int pad_w, int stride_h, int stride_w, int dilation_h, int dilation_w, int mode, int type)
{
    convolution *c = of<convolution>(memory, CONVOLUTION);
    if (!c || pad_h < 0 || pad_w < 0 || stride_h < 1 || stride_w < 1 || dilation_h < 1 || dilation_w < 1 || mode < 0 || mode > 1) return BAD_PARAM;
    if (dilation_h != 1 || dilation_w != 1 || mode != 1 || (type != F32 && type != F64)) return NOT_SUPPORTED;
    return *c = { CONVOLUTION, pad_h, pad_w, stride_h, stride_w, type, 0, true }, SUCCESS;
}
int cudnnSetConvolutionMathType(void *memory, int math)
{
    convolution *c = of<convolution>(memory, CONVOLUTION);
    return !c || math < 0 || math > 3 ? BAD_PARAM : (c->math = math, SUCCESS);
}
int cudnnGetConvolutionForwardWorkspaceSize(void *h, void *x, void *w, void *c, void *y, int algorithm, size_t *bytes) { return ask(h, x, w, c, y, FORWARD, algorithm, bytes); }
int cudnnGetConvolutionBackwardDataWorkspaceSize(void *h, void *w, void *dy, void *c, void *dx, int algorithm, size_t *bytes) { return ask(h, dx, w, c, dy, TO_INPUT, algorithm, bytes); }
int cudnnGetConvolutionBackwardFilterWorkspaceSize(void *h, void *x, void *dy, void *c, void *dw, int algorithm, size_t *bytes) { return ask(h, x, dw, c, dy, TO_WEIGHT, algorithm, bytes); }
int cudnnConvolutionForward(void *h, const void *alpha, void *x_sizes, const void *x, void *w_sizes, const void *w, void *c, int algorithm, void *workspace, size_t bytes, const void *beta, void *y_sizes, void *y)
{
    return queue(h, x_sizes, w_sizes, c, y_sizes, FORWARD, algorithm, alpha, beta, x, w, y, workspace, bytes);
}
int cudnnConvolutionBackwardData(void *h, const void *alpha, void *w_sizes, const void *w, void *dy_sizes, const void *dy, void *c, int algorithm, void *workspace, size_t bytes, const void *beta, void *dx_sizes, void *dx)
{
    return queue(h, dx_sizes, w_sizes, c, dy_sizes, TO_INPUT, algorithm, alpha, beta, w, dy, dx, workspace, bytes);
}
int cudnnConvolutionBackwardFilter(void *h, const void *alpha, void *x_sizes, const void *x, void *dy_sizes, const void *dy, void *c, int algorithm, void *workspace, size_t bytes, const void *beta, void *dw_sizes, void *dw)
{
    return queue(h, x_sizes, dw_sizes, c, dy_sizes, TO_WEIGHT, algorithm, alpha, beta, x, dy, dw, workspace, bytes);
}
}
