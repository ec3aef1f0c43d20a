/* Products on the processor. oneDNN's own threading may cut sums by the number of threads, so it is always called on
 * one thread, inside our loops over fixed blocks: 256 rows of C, or, for A^T B with a long sum (the gradient of a
 * weight), fixed chunks of the sum whose partial results are added in a fixed tree. */
#include "tensor/device.h"

#include <dnnl.h>
#include <omp.h>

enum { ROWS = 256, COLUMNS = 1024, CHUNKS = 32 };

/* ---- one thread ---- */

static void product_f32(bool ta, bool tb, int64_t m, int64_t n, int64_t k, float alpha, const float *a, int64_t lda,
                        const float *b, int64_t ldb, float beta, float *c, int64_t ldc)
{
    /* A parallel region of one thread is not "in parallel" for OpenMP: only its thread count of one keeps oneDNN from
     * starting threads. The setting belongs to the calling task alone. */
    int threads = omp_get_max_threads();
    if (threads != 1) omp_set_num_threads(1);
    dnnl_status_t status = dnnl_sgemm(ta ? 'T' : 'N', tb ? 'T' : 'N', m, n, k, alpha, a, lda, b, ldb, beta, c, ldc);
    if (threads != 1) omp_set_num_threads(threads);
    if (status == dnnl_success) return;
    /* Not seen in practice (it refuses only wrong arguments, or runs out of memory); the plain loop is always there. */
    for (int64_t i = 0; i < m; i++)
        for (int64_t j = 0; j < n; j++) {
            float sum = 0;
            for (int64_t p = 0; p < k; p++)
                sum += (ta ? a[p * lda + i] : a[i * lda + p]) * (tb ? b[j * ldb + p] : b[p * ldb + j]);
            c[i * ldc + j] = alpha * sum + (beta == 0 ? 0 : beta * c[i * ldc + j]);
        }
}

/* Plain loops; the innermost runs along rows of b and c unless b is transposed. */
static void product_f64(bool ta, bool tb, int64_t m, int64_t n, int64_t k, double alpha, const double *a, int64_t lda,
                        const double *b, int64_t ldb, double beta, double *c, int64_t ldc)
{
    for (int64_t i = 0; i < m; i++) {
        double *row = c + i * ldc;
        if (beta == 0)
            for (int64_t j = 0; j < n; j++) row[j] = 0;
        else if (beta != 1)
            for (int64_t j = 0; j < n; j++) row[j] *= beta;
        if (tb) {
            for (int64_t j = 0; j < n; j++) {
                double sum = 0;
                for (int64_t p = 0; p < k; p++) sum += (ta ? a[p * lda + i] : a[i * lda + p]) * b[j * ldb + p];
                row[j] += alpha * sum;
            }
            continue;
        }
        for (int64_t p = 0; p < k; p++) {
            double factor = alpha * (ta ? a[p * lda + i] : a[i * lda + p]);
            const double *from = b + p * ldb;
#pragma omp simd
            for (int64_t j = 0; j < n; j++) row[j] += factor * from[j];
        }
    }
}

void hg_product_here(hg_dtype dtype, bool ta, bool tb, int64_t m, int64_t n, int64_t k, double alpha, const void *a,
                     int64_t lda, const void *b, int64_t ldb, double beta, void *c, int64_t ldc)
{
    if (m <= 0 || n <= 0) return;
    if (dtype == HG_F32 && k > 0)
        product_f32(ta, tb, m, n, k, (float)alpha, a, lda, b, ldb, (float)beta, c, ldc);
    else if (dtype == HG_F64)
        product_f64(ta, tb, m, n, k, alpha, a, lda, b, ldb, beta, c, ldc);
    else if (dtype == HG_BF16)
        hg_cpu_product_bf16(ta, tb, m, n, k, a, lda, b, ldb, beta != 0, c, ldc);
    else if (dtype == HG_F32) /* an empty sum */
        for (int64_t i = 0; i < m; i++)
            for (int64_t j = 0; j < n; j++) {
                float *at = (float *)c + i * ldc + j;
                *at = beta == 0 ? 0 : (float)beta * *at;
            }
}

/* ---- all threads ---- */

typedef struct {
    hg_dtype dtype;
    bool ta, tb;
    int64_t m, n, k, lda, ldb, ldc, columns, chunk, chunks;
    double alpha, beta;
    const char *a, *b;
    char *c, *partial;
} product_args;

static void block_cpu(const void *memory, int64_t first, int64_t last)
{
    const product_args *p = memory;
    int64_t size = (int64_t)hg_dtype_size(p->dtype);
    for (int64_t block = first; block < last; block++) {
        int64_t i = block / p->columns * ROWS, j = block % p->columns * COLUMNS;
        int64_t rows = p->m - i < ROWS ? p->m - i : ROWS, columns = p->n - j < COLUMNS ? p->n - j : COLUMNS;
        hg_product_here(p->dtype, p->ta, p->tb, rows, columns, p->k, p->alpha, p->a + (p->ta ? i : i * p->lda) * size,
                        p->lda, p->b + (p->tb ? j * p->ldb : j) * size, p->ldb, p->beta, p->c + (i * p->ldc + j) * size,
                        p->ldc);
    }
}

static void chunk_cpu(const void *memory, int64_t first, int64_t last)
{
    const product_args *p = memory;
    for (int64_t chunk = first; chunk < last; chunk++) {
        int64_t from = chunk * p->chunk, k = p->k - from < p->chunk ? p->k - from : p->chunk;
        hg_product_here(p->dtype, true, p->tb, p->m, p->n, k, p->alpha, p->a + from * p->lda * 4, p->lda,
                        p->b + (p->tb ? from : from * p->ldb) * 4, p->ldb, 0, p->partial + chunk * p->m * p->n * 4,
                        p->n);
    }
}

/* Elements first .. last of C: the chunks are added in pairs, pairs in pairs, in place in the first of each pair. */
static void tree_cpu(const void *memory, int64_t first, int64_t last)
{
    const product_args *p = memory;
    float *partial = (float *)p->partial, *c = (float *)p->c, beta = (float)p->beta;
    int64_t size = p->m * p->n;
    for (int64_t step = 1; step < p->chunks; step *= 2)
        for (int64_t chunk = 0; chunk + step < p->chunks; chunk += 2 * step) {
            float *restrict to = partial + chunk * size;
            const float *restrict from = partial + (chunk + step) * size;
#pragma omp simd
            for (int64_t e = first; e < last; e++) to[e] += from[e];
        }
    for (int64_t e = first; e < last;) {
        int64_t i = e / p->n, j = e % p->n, end = (i + 1) * p->n < last ? (i + 1) * p->n : last;
        float *to = c + i * p->ldc + j;
        if (p->beta == 0)
            for (; e < end; e++) *to++ = partial[e];
        else
            for (; e < end; e++, to++) *to = partial[e] + beta * *to;
    }
}

/* Chunks depend on k alone: at least 256 long, at most 32 of them. */
static int64_t chunk_length(int64_t k)
{
    int64_t length = (k + CHUNKS - 1) / CHUNKS;
    return length < ROWS ? ROWS : (length + 15) / 16 * 16;
}

static bool chunked(hg_dtype dtype, bool transpose_a, int64_t k) { return dtype == HG_F32 && transpose_a && k > ROWS; }

size_t hg_cpu_product_workspace(hg_device *device, hg_dtype dtype, bool transpose_a, int64_t m, int64_t n, int64_t k)
{
    (void)device;
    if (!chunked(dtype, transpose_a, k)) return 0;
    int64_t length = chunk_length(k);
    return (size_t)((k + length - 1) / length * m * n) * sizeof(float);
}

hg_status hg_cpu_product(hg_device *device, int threads, hg_dtype dtype, bool transpose_a, bool transpose_b, int64_t m,
                         int64_t n, int64_t k, double alpha, const void *a, int64_t lda, const void *b, int64_t ldb,
                         double beta, void *c, int64_t ldc, void *workspace)
{
    static const hg_kernel block = {
        .name = "product", .args_size = sizeof(product_args), .cpu = block_cpu, .block = 1
    };
    static const hg_kernel chunk = {
        .name = "product", .args_size = sizeof(product_args), .cpu = chunk_cpu, .block = 1
    };
    static const hg_kernel tree = { .name = "product", .args_size = sizeof(product_args), .cpu = tree_cpu };
    if (dtype != HG_F32 && dtype != HG_F64)
        return hg_fail(HG_UNSUPPORTED, "product: f32 and f64 are possible, not %s", hg_dtype_name(dtype));
    product_args args = { .dtype = dtype,
                          .ta = transpose_a,
                          .tb = transpose_b,
                          .m = m,
                          .n = n,
                          .k = k,
                          .lda = lda,
                          .ldb = ldb,
                          .ldc = ldc,
                          .alpha = alpha,
                          .beta = beta,
                          .a = a,
                          .b = b,
                          .c = c };
    if (chunked(dtype, transpose_a, k)) {
        args.partial = workspace;
        args.chunk = chunk_length(k);
        args.chunks = (k + args.chunk - 1) / args.chunk;
        HG_TRY(hg_cpu_launch(device, threads, &chunk, args.chunks, &args));
        return hg_cpu_launch(device, threads, &tree, m * n, &args);
    }
    args.columns = (n + COLUMNS - 1) / COLUMNS;
    return hg_cpu_launch(device, threads, &block, (m + ROWS - 1) / ROWS * args.columns, &args);
}
