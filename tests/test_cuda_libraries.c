/* cuBLAS and cuDNN as the product finds them, emulated or NVIDIA's: what is wrong in a call is refused by the code that stands in
 * NVIDIA's documentation, before anything runs; what is right gives the numbers. */
#include "tests/device.h"
#include "tests/test.h"

#include "tensor/cuda/api.h"

enum { INVALID_VALUE = 7, NOT_SUPPORTED = 15 }; /* cublasStatus_t */

static const hg_cuda_api *api;
static const hg_cuda_dnn_api *dnn;
static CUcontext context;
static CUstream stream;
static CUdeviceptr memory[4]; /* three arrays and a workspace */
enum { BYTES = 1 << 20, WORKSPACE = 8 << 20 };

static int open_device(void **state)
{
    (void)state;
    CUdevice device;
    if (!test_device() || hg_cuda_library(&api) != HG_OK) return 0;
    if (hg_cuda_dnn_library(&dnn) != HG_OK) dnn = NULL;
    if (api->cuDeviceGet(&device, 0) || api->cuDevicePrimaryCtxRetain(&context, device) ||
        api->cuCtxSetCurrent(context) || api->cuStreamCreate(&stream, CU_STREAM_NON_BLOCKING))
        return -1;
    for (int i = 0; i < 4; i++)
        if (api->cuMemAlloc(&memory[i], i < 3 ? BYTES : WORKSPACE)) return -1;
    return 0;
}

static int close_device(void **state)
{
    (void)state;
    CUdevice device;
    if (!context) return 0;
    for (int i = 0; i < 4; i++) api->cuMemFree(memory[i]);
    api->cuStreamDestroy(stream);
    return api->cuDeviceGet(&device, 0) || api->cuDevicePrimaryCtxRelease(device);
}

static void *at(int i) { return (void *)(uintptr_t)memory[i]; }

static void put(int i, const float *values, int n)
{
    assert_int_equal(api->cuMemcpyHtoDAsync(memory[i], values, (size_t)n * sizeof *values, stream), 0);
    assert_int_equal(api->cuStreamSynchronize(stream), 0);
}

static void get(int i, float *values, int n)
{
    assert_int_equal(api->cuMemcpyDtoHAsync(values, memory[i], (size_t)n * sizeof *values, stream), 0);
    assert_int_equal(api->cuStreamSynchronize(stream), 0);
}

/* ---- cuBLAS ---- */

typedef struct {
    int ta, tb, m, n, k, lda, ldb, ldc, a_type, b_type, c_type, compute, algorithm;
} gemm;

static int call(cublasHandle_t handle, gemm g)
{
    const double one = 1, zero = 0;
    const float one_f32 = 1, zero_f32 = 0;
    const bool f64 = g.compute == CUBLAS_COMPUTE_64F;
    return (int)api->cublasGemmEx(handle, (cublasOperation_t)g.ta, (cublasOperation_t)g.tb, g.m, g.n, g.k,
                                  f64 ? (const void *)&one : &one_f32, at(0), (cudaDataType)g.a_type, g.lda, at(1),
                                  (cudaDataType)g.b_type, g.ldb, f64 ? (const void *)&zero : &zero_f32, at(2),
                                  (cudaDataType)g.c_type, g.ldc, (cublasComputeType_t)g.compute,
                                  (cublasGemmAlgo_t)g.algorithm);
}

static void test_products(void **state)
{
    (void)state;
    if (!context) skip();
    cublasHandle_t handle;
    assert_int_equal(api->cublasCreate(&handle), 0);
    assert_int_equal(api->cublasSetStream(handle, stream), 0);
    assert_int_equal(api->cublasSetWorkspace(handle, at(3), WORKSPACE), 0);
    assert_int_equal(api->cublasSetAtomicsMode(handle, CUBLAS_ATOMICS_NOT_ALLOWED), 0);
    assert_int_equal(api->cublasSetMathMode(handle, CUBLAS_MATH_DISALLOW_REDUCED_PRECISION_REDUCTION), 0);
    const gemm good = { CUBLAS_OP_N,        CUBLAS_OP_T,        2, 3, 4, 2, 3, 2, CUDA_R_32F, CUDA_R_32F, CUDA_R_32F,
                        CUBLAS_COMPUTE_32F, CUBLAS_GEMM_DEFAULT };
    gemm wrong[8];
    for (int i = 0; i < 8; i++) wrong[i] = good;
    wrong[0].m = -1, wrong[1].k = -1, wrong[2].lda = 1, wrong[3].ldb = 2, wrong[4].ldc = 1;
    wrong[5].ta = CUBLAS_OP_T, wrong[5].lda = 3;
    wrong[6].b_type = CUDA_R_16BF, wrong[7].compute = CUBLAS_COMPUTE_64F;
    for (int i = 0; i < 8; i++) {
        const int status = call(handle, wrong[i]), expected = i < 6 ? INVALID_VALUE : NOT_SUPPORTED;
        if (status != expected) fail_msg("case %d: %d instead of %d", i, status, expected);
    }
    /* Column-major: A [2,4], B [3,4], C = A B^T [2,3]. */
    const float a[8] = { 1, 2, 3, 4, 5, 6, 7, 8 }, b[12] = { 1, 0, 2, 0, 1, 2, 1, 1, 0, 0, 1, 1 };
    float c[6];
    put(0, a, 8);
    put(1, b, 12);
    assert_int_equal(call(handle, good), 0);
    get(2, c, 6);
    for (int j = 0; j < 3; j++)
        for (int i = 0; i < 2; i++) {
            float sum = 0;
            for (int k = 0; k < 4; k++) sum += a[i + 2 * k] * b[j + 3 * k];
            assert_true(c[i + 2 * j] == sum);
        }
    gemm nothing = good;
    nothing.m = 0;
    assert_int_equal(call(handle, nothing), 0);
    assert_non_null(strstr(api->cublasGetStatusString(INVALID_VALUE), "unsupported value"));
    assert_int_equal(api->cublasDestroy(handle), 0);
}

/* ---- cuDNN ---- */

typedef struct {
    cudnnTensorDescriptor_t x, y;
    cudnnFilterDescriptor_t w;
    cudnnConvolutionDescriptor_t c;
} descriptors;

static int x_size[4] = { 1, 1, 3, 3 }, w_size[4] = { 1, 1, 2, 2 }, y_size[4] = { 1, 1, 2, 2 };

static void set(const descriptors *d)
{
    assert_int_equal(dnn->cudnnSetTensor4dDescriptor(d->x, CUDNN_TENSOR_NCHW, CUDNN_DATA_FLOAT, x_size[0], x_size[1],
                                                     x_size[2], x_size[3]),
                     0);
    assert_int_equal(dnn->cudnnSetTensor4dDescriptor(d->y, CUDNN_TENSOR_NCHW, CUDNN_DATA_FLOAT, y_size[0], y_size[1],
                                                     y_size[2], y_size[3]),
                     0);
    assert_int_equal(dnn->cudnnSetFilter4dDescriptor(d->w, CUDNN_DATA_FLOAT, CUDNN_TENSOR_NCHW, w_size[0], w_size[1],
                                                     w_size[2], w_size[3]),
                     0);
}

static cudnnStatus_t forward(cudnnHandle_t handle, const descriptors *d, size_t bytes)
{
    const float one = 1, zero = 0;
    return dnn->cudnnConvolutionForward(handle, &one, d->x, at(0), d->w, at(1), d->c,
                                        CUDNN_CONVOLUTION_FWD_ALGO_IMPLICIT_PRECOMP_GEMM, bytes ? at(3) : NULL, bytes,
                                        &zero, d->y, at(2));
}

static void test_convolutions(void **state)
{
    (void)state;
    if (!context || !dnn) skip();
    cudnnHandle_t handle;
    descriptors d;
    size_t bytes = 0;
    assert_int_equal(dnn->cudnnCreate(&handle), 0);
    assert_int_equal(dnn->cudnnSetStream(handle, stream), 0);
    assert_int_equal(dnn->cudnnCreateTensorDescriptor(&d.x), 0);
    assert_int_equal(dnn->cudnnCreateTensorDescriptor(&d.y), 0);
    assert_int_equal(dnn->cudnnCreateFilterDescriptor(&d.w), 0);
    assert_int_equal(dnn->cudnnCreateConvolutionDescriptor(&d.c), 0);
    assert_true(dnn->cudnnSetTensor4dDescriptor(d.x, CUDNN_TENSOR_NCHW, CUDNN_DATA_FLOAT, 1, 0, 3, 3) != 0);
    assert_true(dnn->cudnnSetConvolution2dDescriptor(d.c, 0, 0, 0, 1, 1, 1, CUDNN_CROSS_CORRELATION,
                                                     CUDNN_DATA_FLOAT) != 0); /* stride 0 */
    assert_int_equal(
        dnn->cudnnSetConvolution2dDescriptor(d.c, 0, 0, 1, 1, 1, 1, CUDNN_CROSS_CORRELATION, CUDNN_DATA_FLOAT), 0);
    assert_int_equal(dnn->cudnnSetConvolutionMathType(d.c, CUDNN_FMA_MATH), 0);
    set(&d);
    assert_int_equal(dnn->cudnnGetConvolutionForwardWorkspaceSize(
                         handle, d.x, d.w, d.c, d.y, CUDNN_CONVOLUTION_FWD_ALGO_IMPLICIT_PRECOMP_GEMM, &bytes),
                     0);
    assert_true(bytes <= WORKSPACE);
    if (bytes) assert_true(forward(handle, &d, bytes - 1) != 0);
    y_size[2] = 3; /* another size than the convolution has */
    set(&d);
    assert_true(forward(handle, &d, bytes) != 0);
    y_size[2] = 2, w_size[1] = 2; /* another number of channels */
    set(&d);
    assert_true(forward(handle, &d, bytes) != 0);
    w_size[1] = 1;
    set(&d);
    const float x[9] = { 1, 2, 3, 4, 5, 6, 7, 8, 9 }, w[4] = { 1, 0, 0, 2 };
    float y[4];
    put(0, x, 9);
    put(1, w, 4);
    assert_int_equal(forward(handle, &d, bytes), 0);
    get(2, y, 4);
    for (int i = 0; i < 4; i++)
        assert_true(y[i] == x[i / 2 * 3 + i % 2] + 2 * x[i / 2 * 3 + i % 2 + 4]); /* not flipped */
    assert_true(strlen(dnn->cudnnGetErrorString(2000)) > 0);
    dnn->cudnnDestroyTensorDescriptor(d.x);
    dnn->cudnnDestroyTensorDescriptor(d.y);
    dnn->cudnnDestroyFilterDescriptor(d.w);
    dnn->cudnnDestroyConvolutionDescriptor(d.c);
    assert_int_equal(dnn->cudnnDestroy(handle), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(test_products), cmocka_unit_test(test_convolutions) };
    return cmocka_run_group_tests(tests, open_device, close_device);
}
