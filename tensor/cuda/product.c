/* Matrix products by cuBLAS. Ours are row-major and cuBLAS' column-major: C^T = B^T A^T is asked for.
 *
 * The same bits in every run: one stream, a workspace of our own (which also keeps cuBLAS from taking memory while a step is
 * recorded), no atomics. True f32 unless hg_ctx_compute says otherwise; for bf16 the factors are rounded by a kernel of ours. */
#include "tensor/cuda/device.h"
#include "tensor/cuda/product.kernel.h"

#include <limits.h>

enum { WORKSPACE = 32 << 20, PITCH = 8 }; /* bytes, as NVIDIA advises for its newest; elements: rows on 16 bytes */

static hg_status check(const hg_cuda_device *d, cublasStatus_t status, const char *what)
{
    return status == 0 ? HG_OK : hg_fail(HG_NUMERIC, "cuda: %s: %s", what, d->api->cublasGetStatusString(status));
}

static hg_status open_blas(hg_cuda_device *d)
{
    const hg_cuda_api *api = d->api;
    if (d->blas) return HG_OK;
    if (!d->blas_workspace) {
        void *memory = d->device.alloc(&d->device, WORKSPACE);
        if (!memory) return HG_MEMORY;
        d->blas_workspace = (CUdeviceptr)(uintptr_t)memory;
    }
    cublasHandle_t blas;
    HG_TRY(check(d, api->cublasCreate(&blas), "starting cuBLAS"));
    hg_status status = check(d, api->cublasSetStream(blas, d->stream), "the stream of cuBLAS");
    if (status == HG_OK) /* after the stream, which would take it away */
        status = check(d, api->cublasSetWorkspace(blas, (void *)(uintptr_t)d->blas_workspace, WORKSPACE),
                       "the workspace of cuBLAS");
    if (status == HG_OK)
        status = check(d, api->cublasSetAtomicsMode(blas, CUBLAS_ATOMICS_NOT_ALLOWED), "cuBLAS without atomics");
    if (status == HG_OK)
        status = check(d, api->cublasSetMathMode(blas, CUBLAS_MATH_DISALLOW_REDUCED_PRECISION_REDUCTION),
                       "the precision of cuBLAS");
    if (status != HG_OK) {
        api->cublasDestroy(blas);
        return status;
    }
    d->blas = blas;
    return HG_OK;
}

/* Row-major, checked; factors of `type`, in what they are computed in `compute`. */
typedef struct {
    const void *a, *b;
    void *c;
    double alpha, beta;
    int m, n, k, lda, ldb, ldc, transpose_a, transpose_b, type, c_type, compute, unused;
} product_call;

static hg_status run_product(hg_cuda_device *d, const void *args)
{
    const product_call *p = args;
    const bool f64 = p->type == CUDA_R_64F;
    const float alpha = (float)p->alpha, beta = (float)p->beta;
    return check(d,
                 d->api->cublasGemmEx(d->blas, p->transpose_b ? CUBLAS_OP_T : CUBLAS_OP_N,
                                      p->transpose_a ? CUBLAS_OP_T : CUBLAS_OP_N, p->n, p->m, p->k,
                                      f64 ? (const void *)&p->alpha : &alpha, p->b, p->type, p->ldb, p->a, p->type,
                                      p->lda, f64 ? (const void *)&p->beta : &beta, p->c, p->c_type, p->ldc, p->compute,
                                      CUBLAS_GEMM_DEFAULT),
                 "a product");
}

static int64_t padded(int64_t columns) { return (columns + PITCH - 1) / PITCH * PITCH; }

static bool in_bf16(const hg_cuda_device *d, hg_dtype dtype) { return dtype == HG_F32 && d->compute == HG_BF16; }

/* Both factors in bf16, as they are stored but packed; m k + k n whichever way they lie. */
size_t hg_cuda_product_workspace(hg_device *device, hg_dtype dtype, bool transpose_a, int64_t m, int64_t n, int64_t k)
{
    (void)transpose_a;
    if (!in_bf16((const hg_cuda_device *)(const void *)device, dtype)) return 0;
    return (size_t)((m + PITCH) * (k + PITCH) + (n + PITCH) * (k + PITCH)) * sizeof(uint16_t);
}

static hg_status round_one(hg_cuda_device *d, int64_t rows, int64_t columns, const void *from, int64_t ld, uint16_t *to)
{
    const round_factor_args args = { from, to, columns, ld, padded(columns) };
    return d->device.launch(&d->device, 1, &round_factor_kernel, rows * columns, &args);
}

hg_status hg_cuda_product(hg_device *device, int threads, hg_dtype dtype, bool transpose_a, bool transpose_b, int64_t m,
                          int64_t n, int64_t k, double alpha, const void *a, int64_t lda, const void *b, int64_t ldb,
                          double beta, void *c, int64_t ldc, void *workspace)
{
    hg_cuda_device *d = (hg_cuda_device *)(void *)device;
    const bool f64 = dtype == HG_F64, bf16 = in_bf16(d, dtype);
    if (dtype != HG_F32 && dtype != HG_F64)
        return hg_fail(HG_UNSUPPORTED, "product: f32 and f64 are possible, not %s", hg_dtype_name(dtype));
    if (m > INT_MAX || n > INT_MAX || k > INT_MAX || lda > INT_MAX || ldb > INT_MAX || ldc > INT_MAX)
        return hg_fail(HG_UNSUPPORTED, "product: sizes above 2^31 are not possible on cuda");
    if (k == 0) {
        scale_product_args args = { c, n, ldc, beta, f64 };
        return device->launch(device, threads, &scale_product_kernel, m * n, &args);
    }
    HG_TRY(hg_cuda_enter(d));
    HG_TRY(open_blas(d));
    const int type = f64 ? CUDA_R_64F : bf16 ? CUDA_R_16BF : CUDA_R_32F;
    if (bf16) {
        const int64_t a_rows = transpose_a ? k : m, a_columns = transpose_a ? m : k;
        const int64_t b_rows = transpose_b ? n : k, b_columns = transpose_b ? k : n;
        uint16_t *a_bf16 = workspace, *b_bf16 = a_bf16 + (m + PITCH) * (k + PITCH) / PITCH * PITCH;
        HG_TRY(round_one(d, a_rows, a_columns, a, lda, a_bf16));
        HG_TRY(round_one(d, b_rows, b_columns, b, ldb, b_bf16));
        a = a_bf16, lda = padded(a_columns), b = b_bf16, ldb = padded(b_columns);
    }
    const product_call call = { .a = a,
                                .b = b,
                                .c = c,
                                .alpha = alpha,
                                .beta = beta,
                                .m = (int)m,
                                .n = (int)n,
                                .k = (int)k,
                                .lda = (int)lda,
                                .ldb = (int)ldb,
                                .ldc = (int)ldc,
                                .transpose_a = transpose_a,
                                .transpose_b = transpose_b,
                                .type = type,
                                .c_type = f64 ? CUDA_R_64F : CUDA_R_32F,
                                .compute = f64                                        ? CUBLAS_COMPUTE_64F
                                           : dtype == HG_F32 && d->compute == HG_TF32 ? CUBLAS_COMPUTE_32F_FAST_TF32
                                                                                      : CUBLAS_COMPUTE_32F };
    return hg_cuda_do(d, "product", run_product, &call, sizeof call);
}
