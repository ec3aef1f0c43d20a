/* Matrix products by cuBLAS. Ours are row-major and cuBLAS' column-major: C^T = B^T A^T is asked for. */
#include "tensor/cuda/device.h"

#include <limits.h>

static hg_status check(const hg_cuda_device *d, cublasStatus_t status)
{
    return status == 0 ? HG_OK : hg_fail(HG_NUMERIC, "cuda: a product: %s", d->api->cublasGetStatusString(status));
}

hg_status hg_cuda_product(hg_device *device, int threads, hg_dtype dtype, bool transpose_a, bool transpose_b, int64_t m,
                          int64_t n, int64_t k, double alpha, const void *a, int64_t lda, const void *b, int64_t ldb,
                          double beta, void *c, int64_t ldc, void *workspace)
{
    hg_cuda_device *d = (hg_cuda_device *)(void *)device;
    (void)threads, (void)workspace;
    if (dtype != HG_F32 && dtype != HG_F64)
        return hg_fail(HG_UNSUPPORTED, "product: f32 and f64 are possible, not %s", hg_dtype_name(dtype));
    if (m > INT_MAX || n > INT_MAX || k > INT_MAX || lda > INT_MAX || ldb > INT_MAX || ldc > INT_MAX)
        return hg_fail(HG_UNSUPPORTED, "product: sizes above 2^31 are not possible on cuda");
    if (!d->blas) {
        HG_TRY(check(d, d->api->cublasCreate(&d->blas)));
        HG_TRY(check(d, d->api->cublasSetStream(d->blas, d->stream)));
    }
    const float alpha_f = (float)alpha, beta_f = (float)beta;
    const bool f64 = dtype == HG_F64;
    const int type = f64 ? CUDA_R_64F : CUDA_R_32F;
    d->device.counts.launches++;
    return check(d, d->api->cublasGemmEx(d->blas, transpose_b ? CUBLAS_OP_T : CUBLAS_OP_N,
                                         transpose_a ? CUBLAS_OP_T : CUBLAS_OP_N, (int)n, (int)m, (int)k,
                                         f64 ? (const void *)&alpha : &alpha_f, b, type, (int)ldb, a, type, (int)lda,
                                         f64 ? (const void *)&beta : &beta_f, c, type, (int)ldc,
                                         f64 ? CUBLAS_COMPUTE_64F : CUBLAS_COMPUTE_32F, CUBLAS_GEMM_DEFAULT));
}
