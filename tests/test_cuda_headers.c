/* tensor/cuda/api.h against NVIDIA's own headers, where they are installed: the types of all functions, the values of enumerators,
 * the layout of structs. That this file compiles is the test. */
#include "test.h"

#ifdef HAVE_CUDA_HEADERS
#include <cublas_v2.h>
#include <cuda.h>
#include <nvrtc.h>
#define HG_CUDA_OWN_TYPES 0
#if __has_include(<cudnn.h>)
#include <cudnn.h>
#define HAVE_CUDNN_HEADERS
#else
#define HG_CUDA_OWN_DNN_TYPES 1
#endif
#endif
#include "tensor/cuda/api.h"

#ifdef HAVE_CUDA_HEADERS
#include <stddef.h>

/* The field's name is a macro of NVIDIA's where the symbol has a version: cuMemAlloc is cuMemAlloc_v2. */
#define TEXT_(name_) #name_
#define TEXT(name_)  TEXT_(name_)
#define SAME_FUNCTION(field_, symbol_, result_, arguments_)                                                            \
    _Static_assert(__builtin_types_compatible_p(__typeof__(field_), result_ arguments_), #field_ " has another type"); \
    _Static_assert(sizeof TEXT(field_) == sizeof symbol_, #field_ " is another symbol");
#define SAME_VALUE(name_, value_) _Static_assert((long long)(name_) == (value_), #name_ " has another value");

HG_CUDA_DRIVER(SAME_FUNCTION)
HG_CUDA_NVRTC(SAME_FUNCTION)
HG_CUDA_BLAS(SAME_FUNCTION)
HG_CUDA_DRIVER_VALUES(SAME_VALUE)
HG_CUDA_BLAS_VALUES(SAME_VALUE)
#ifdef HAVE_CUDNN_HEADERS
HG_CUDA_DNN(SAME_FUNCTION)
HG_CUDA_DNN_VALUES(SAME_VALUE)
#endif

/* The sizes that our own types have. */
#define SAME_ENUM(type_) _Static_assert(sizeof(type_) == sizeof(unsigned), #type_ " is no int");
SAME_ENUM(CUdevice)
SAME_ENUM(CUresult)
SAME_ENUM(CUdevice_attribute)
SAME_ENUM(CUfunction_attribute)
SAME_ENUM(CUstreamCaptureMode)
SAME_ENUM(CUgraphExecUpdateResult)
SAME_ENUM(nvrtcResult)
SAME_ENUM(cublasStatus_t)
SAME_ENUM(cublasOperation_t)
SAME_ENUM(cudaDataType)
SAME_ENUM(cublasComputeType_t)
SAME_ENUM(libraryPropertyType)
SAME_ENUM(cublasGemmAlgo_t)
SAME_ENUM(cublasAtomicsMode_t)
SAME_ENUM(cublasMath_t)
SAME_ENUM(cudnnStatus_t)
SAME_ENUM(cudnnDataType_t)
SAME_ENUM(cudnnTensorFormat_t)
SAME_ENUM(cudnnConvolutionMode_t)
SAME_ENUM(cudnnMathType_t)
SAME_ENUM(cudnnConvolutionFwdAlgo_t)
SAME_ENUM(cudnnConvolutionBwdDataAlgo_t)
SAME_ENUM(cudnnConvolutionBwdFilterAlgo_t)
_Static_assert(sizeof(CUdeviceptr) == sizeof(unsigned long long), "CUdeviceptr has another size");

typedef HG_CUDA_UPDATE_INFO update_info;
_Static_assert(sizeof(update_info) == sizeof(CUgraphExecUpdateResultInfo) &&
                   offsetof(update_info, errorNode) == offsetof(CUgraphExecUpdateResultInfo, errorNode) &&
                   offsetof(update_info, errorFromNode) == offsetof(CUgraphExecUpdateResultInfo, errorFromNode),
               "CUgraphExecUpdateResultInfo has another layout");

#define SAME_SYMBOL(field_, symbol_, result_, arguments_) assert_string_equal(TEXT(field_), symbol_);
#endif

static void test_headers(void **state)
{
    (void)state;
#ifdef HAVE_CUDA_HEADERS
    HG_CUDA_DRIVER(SAME_SYMBOL)
    HG_CUDA_NVRTC(SAME_SYMBOL)
    HG_CUDA_BLAS(SAME_SYMBOL)
    HG_CUDA_DNN(SAME_SYMBOL)
    print_message("compared with the headers of CUDA %d.%d\n", CUDA_VERSION / 1000, CUDA_VERSION % 1000 / 10);
#else
    print_message("NVIDIA's headers are not installed here: nothing to compare with\n");
    skip();
#endif
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(test_headers) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
