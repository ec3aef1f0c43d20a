/* An emulating libcublas.so: products by oneDNN and plain loops, column-major as cuBLAS has them, run when the stream comes to
 * them. Arguments are checked at the call as cuBLAS checks them. Stricter than cuBLAS where the product promises more: without
 * a workspace that was given, or without the promise of no atomics, there is no product. */
#include "enqueue.h"
#include "library.h"

#include <dnnl.h>
#include <math.h>
#include <stdint.h>
#include <string.h>
#include <vector>

namespace
{
enum { SUCCESS = 0, NOT_INITIALIZED = 1, ALLOC_FAILED = 3, INVALID_VALUE = 7, EXECUTION_FAILED = 13, NOT_SUPPORTED = 15 };
enum { F32 = 0, F64 = 1, BF16 = 14 };
enum { COMPUTE_F32 = 68, COMPUTE_F64 = 70, COMPUTE_TF32 = 77 };
enum : uint64_t { ALIVE = 0x626c61736c697665 };

struct handle {
    uint64_t alive;
    unsigned long long own; /* memory of the device that it takes when it is made, as cuBLAS does */
    void *stream, *workspace;
    size_t bytes;
    int math, atomics;
};
handle *of(void *memory)
{
    handle *h = (handle *)memory;
    return h && h->alive == ALIVE ? h : nullptr;
}

struct call {
    int ta, tb, m, n, k, lda, ldb, ldc, type, compute;
    double alpha, beta;
    const void *a, *b;
    void *c;
};

float from_bits(uint32_t bits)
{
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}
/* TF32 keeps 10 bits behind the point; to nearest, ties away from zero, as the tensor cores' cvt.rna does. */
float to_tf32(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return isfinite(x) ? from_bits((bits + 0x1000u) & ~0x1fffu) : x;
}

/* A factor as stored, `columns` columns of `rows`, as packed f32. */
std::vector<float> rounded(const void *from, int rows, int columns, int ld, bool bf16)
{
    std::vector<float> to((size_t)rows * columns);
    for (int j = 0; j < columns; j++)
        for (int i = 0; i < rows; i++) {
            const size_t at = i + (size_t)j * ld;
            to[i + (size_t)j * rows] = bf16 ? from_bits((uint32_t)((const uint16_t *)from)[at] << 16) : to_tf32(((const float *)from)[at]);
        }
    return to;
}

void product_f64(const call &p)
{
    const double *a = (const double *)p.a, *b = (const double *)p.b;
    for (int j = 0; j < p.n; j++) {
        double *c = (double *)p.c + (size_t)j * p.ldc;
        for (int i = 0; i < p.m; i++) c[i] = p.beta == 0 ? 0 : p.beta * c[i];
        for (int l = 0; l < p.k; l++) {
            const double factor = p.alpha * (p.tb ? b[j + (size_t)l * p.ldb] : b[l + (size_t)j * p.ldb]);
            if (p.ta)
                for (int i = 0; i < p.m; i++) c[i] += a[l + (size_t)i * p.lda] * factor;
            else
                for (int i = 0; i < p.m; i++) c[i] += a[i + (size_t)l * p.lda] * factor;
        }
    }
}

/* C^T = B^T A^T row-major is C = A B column-major. */
void run(const void *args)
{
    const call &p = *(const call *)args;
    if (p.type == F64) return product_f64(p);
    const void *a = p.a, *b = p.b;
    int lda = p.lda, ldb = p.ldb;
    std::vector<float> a_rounded, b_rounded;
    if (p.type == BF16 || p.compute == COMPUTE_TF32) {
        const int a_rows = p.ta ? p.k : p.m, b_rows = p.tb ? p.n : p.k;
        a_rounded = rounded(a, a_rows, p.ta ? p.m : p.k, lda, p.type == BF16);
        b_rounded = rounded(b, b_rows, p.tb ? p.k : p.n, ldb, p.type == BF16);
        a = a_rounded.data(), b = b_rounded.data(), lda = a_rows, ldb = b_rows;
    }
    const int status = dnnl_sgemm(p.tb ? 'T' : 'N', p.ta ? 'T' : 'N', p.n, p.m, p.k, (float)p.alpha, (const float *)b, ldb, (const float *)a, lda, (float)p.beta, (float *)p.c, p.ldc);
    if (status) emulator_stop("cublasGemmEx: oneDNN refuses the product");
}
} // namespace

extern "C" {
int cublasCreate_v2(void **out)
{
    if (!out) return INVALID_VALUE;
    unsigned long long own;
    if (emulator_alloc(&own, 4 << 20)) return ALLOC_FAILED;
    *out = new handle{ ALIVE, own, nullptr, nullptr, 0, 0, 1 };
    return SUCCESS;
}
int cublasDestroy_v2(void *h)
{
    if (!of(h)) return NOT_INITIALIZED;
    emulator_free(of(h)->own);
    of(h)->alive = 0;
    return delete (handle *)h, SUCCESS;
}
int cublasGetProperty(unsigned what, int *value) { return what > 2 || !value ? INVALID_VALUE : (*value = what == 0 ? 13 : 0, SUCCESS); }
int cublasSetStream_v2(void *h, void *stream)
{
    if (!of(h)) return NOT_INITIALIZED;
    of(h)->stream = stream;
    of(h)->workspace = nullptr, of(h)->bytes = 0; /* as cuBLAS does: back to its own */
    return SUCCESS;
}
int cublasSetWorkspace_v2(void *h, void *workspace, size_t bytes)
{
    if (!of(h)) return NOT_INITIALIZED;
    if ((uintptr_t)workspace % 256) return INVALID_VALUE;
    of(h)->workspace = workspace, of(h)->bytes = bytes;
    return SUCCESS;
}
int cublasSetAtomicsMode(void *h, int mode)
{
    if (!of(h)) return NOT_INITIALIZED;
    return mode != 0 && mode != 1 ? INVALID_VALUE : (of(h)->atomics = mode, SUCCESS);
}
int cublasSetMathMode(void *h, int mode)
{
    if (!of(h)) return NOT_INITIALIZED;
    const int base = mode & 15;
    return (mode & ~31) || (base != 0 && base != 1 && base != 2 && base != 3) ? INVALID_VALUE : (of(h)->math = mode, SUCCESS);
}
const char *cublasGetStatusString(int status)
{
    switch (status) {
    case SUCCESS: return "success";
    case NOT_INITIALIZED: return "the library was not initialized";
    case ALLOC_FAILED: return "the resource allocation failed";
    case INVALID_VALUE: return "an unsupported value or parameter was passed to the function";
    case EXECUTION_FAILED: return "the function failed to launch on the GPU";
    case NOT_SUPPORTED: return "the requested functionality is not supported";
    }
    return "unrecognized status";
}

int cublasGemmEx(void *memory, int ta, int tb, int m, int n, int k, const void *alpha, const void *a, int a_type, int lda, const void *b, int b_type, int ldb, const void *beta, void *c, int c_type, int ldc, int compute, int algorithm)
{
    handle *h = of(memory);
    if (!h) return NOT_INITIALIZED;
    if (m < 0 || n < 0 || k < 0 || ta < 0 || ta > 2 || tb < 0 || tb > 2 || !alpha || !beta) return INVALID_VALUE;
    const int a_rows = ta ? k : m, b_rows = tb ? n : k;
    if (lda < (a_rows > 1 ? a_rows : 1) || ldb < (b_rows > 1 ? b_rows : 1) || ldc < (m > 1 ? m : 1)) return INVALID_VALUE;
    if (algorithm != -1 && algorithm != 99) return INVALID_VALUE;
    const bool f64 = compute == COMPUTE_F64 && a_type == F64 && b_type == F64 && c_type == F64;
    const bool f32 = (compute == COMPUTE_F32 || compute == COMPUTE_TF32) && a_type == F32 && b_type == F32 && c_type == F32;
    const bool bf16 = compute == COMPUTE_F32 && a_type == BF16 && b_type == BF16 && c_type == F32;
    if (!f64 && !f32 && !bf16) return NOT_SUPPORTED;
    if (!h->workspace || h->bytes < (4 << 20) || h->atomics) return EXECUTION_FAILED;
    if (m == 0 || n == 0) return SUCCESS;
    if (!a || !b || !c) return INVALID_VALUE;
    call p = { ta, tb, m, n, k, lda, ldb, ldc, a_type, compute, 0, 0, a, b, c };
    p.alpha = f64 ? *(const double *)alpha : (double)*(const float *)alpha;
    p.beta = f64 ? *(const double *)beta : (double)*(const float *)beta;
    if ((h->math & 15) == 3 && f32) p.compute = COMPUTE_TF32;
    return emulator_enqueue(h->stream, "cublasGemmEx", run, &p, sizeof p) ? EXECUTION_FAILED : SUCCESS;
}
}
