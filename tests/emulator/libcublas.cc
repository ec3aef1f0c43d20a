/* An emulating libcublas.so: products by plain loops, column-major as cuBLAS has them. */
#include <stddef.h>
#include <stdint.h>
#include <string.h>

template <class T> static void product(int ta, int tb, int m, int n, int k, T alpha, const T *a, int lda, const T *b, int ldb, T beta, T *c, int ldc)
{
    for (int j = 0; j < n; j++)
        for (int i = 0; i < m; i++) {
            T sum = 0;
            for (int l = 0; l < k; l++) sum += (ta ? a[l + (size_t)i * lda] : a[i + (size_t)l * lda]) * (tb ? b[j + (size_t)l * ldb] : b[l + (size_t)j * ldb]);
            T &to = c[i + (size_t)j * ldc];
            to = beta == 0 ? alpha * sum : alpha * sum + beta * to;
        }
}

extern "C" {
int cublasCreate_v2(void **handle) { return *handle = new char, 0; }
int cublasDestroy_v2(void *handle) { return delete (char *)handle, 0; }
int cublasGetProperty(int type, int *value) { return *value = type == 0 ? 13 : 0, 0; }
int cublasSetStream_v2(void *, void *) { return 0; }
int cublasSetWorkspace_v2(void *, void *, size_t) { return 0; }
const char *cublasGetStatusString(int status) { return status ? "CUBLAS_STATUS_NOT_SUPPORTED" : "CUBLAS_STATUS_SUCCESS"; }

int cublasGemmEx(void *, int ta, int tb, int m, int n, int k, const void *alpha, const void *a, int ta_type, int lda, const void *b, int, int ldb, const void *beta, void *c, int, int ldc, int, int)
{
    if (ta_type == 0)
        product(ta, tb, m, n, k, *(const float *)alpha, (const float *)a, lda, (const float *)b, ldb, *(const float *)beta, (float *)c, ldc);
    else if (ta_type == 1)
        product(ta, tb, m, n, k, *(const double *)alpha, (const double *)a, lda, (const double *)b, ldb, *(const double *)beta, (double *)c, ldc);
    else
        return 15;
    return 0;
}
}
