/* The entry points of CUDA that are called, as typed tables: nothing of CUDA is linked or needed to build. They are filled by
 * library.c when a CUDA device is first asked for. Types and signatures are those of NVIDIA's headers (driver API of CUDA 12.0
 * and later, NVRTC, cuBLAS 12, cuDNN 9), against which tests/test_cuda_headers.c holds them where those are installed. */
#ifndef HG_TENSOR_CUDA_API_H
#define HG_TENSOR_CUDA_API_H

#include "base/base.h"

/* ---- driver: libcuda.so.1 ------------------------------------------------------------------------------------ */

#ifndef HG_CUDA_OWN_TYPES /* defined as 0 where NVIDIA's headers stand instead */
#define HG_CUDA_OWN_TYPES 1
#endif

#if HG_CUDA_OWN_TYPES
typedef int CUdevice;
typedef unsigned long long CUdeviceptr;
typedef struct CUctx_st *CUcontext;
typedef struct CUmod_st *CUmodule;
typedef struct CUfunc_st *CUfunction;
typedef struct CUstream_st *CUstream;
typedef struct CUevent_st *CUevent;
typedef struct CUgraph_st *CUgraph;
typedef struct CUgraphExec_st *CUgraphExec;
typedef struct CUgraphNode_st *CUgraphNode;
/* enums of NVIDIA's, which compilers hold in these */
typedef unsigned int CUresult, CUdevice_attribute, CUfunction_attribute, CUstreamCaptureMode, CUgraphExecUpdateResult;
#endif

#define HG_CUDA_UPDATE_INFO                                                                                            \
    struct {                                                                                                           \
        CUgraphExecUpdateResult result;                                                                                \
        CUgraphNode errorNode, errorFromNode;                                                                          \
    }
#if HG_CUDA_OWN_TYPES
typedef HG_CUDA_UPDATE_INFO CUgraphExecUpdateResultInfo;
#endif

/* X(name, value): enumerators and flags. */
#define HG_CUDA_DRIVER_VALUES(X)                                                                                       \
    X(CUDA_SUCCESS, 0)                                                                                                 \
    X(CUDA_ERROR_OUT_OF_MEMORY, 2)                                                                                     \
    X(CUDA_ERROR_NOT_READY, 600)                                                                                       \
    X(CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT, 16)                                                                    \
    X(CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR, 75)                                                                \
    X(CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR, 76)                                                                \
    X(CU_DEVICE_ATTRIBUTE_MAX_SHARED_MEMORY_PER_BLOCK_OPTIN, 97)                                                       \
    X(CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES, 8)                                                              \
    X(CU_STREAM_NON_BLOCKING, 1)                                                                                       \
    X(CU_EVENT_DISABLE_TIMING, 2)                                                                                      \
    X(CU_STREAM_CAPTURE_MODE_THREAD_LOCAL, 1)

/* X(field, symbol, result, arguments): the symbol is what the library exports. */
#define HG_CUDA_DRIVER(X)                                                                                              \
    X(cuInit, "cuInit", CUresult, (unsigned int))                                                                      \
    X(cuDriverGetVersion, "cuDriverGetVersion", CUresult, (int *))                                                     \
    X(cuGetErrorName, "cuGetErrorName", CUresult, (CUresult, const char **))                                           \
    X(cuGetErrorString, "cuGetErrorString", CUresult, (CUresult, const char **))                                       \
    X(cuDeviceGetCount, "cuDeviceGetCount", CUresult, (int *))                                                         \
    X(cuDeviceGet, "cuDeviceGet", CUresult, (CUdevice *, int))                                                         \
    X(cuDeviceGetName, "cuDeviceGetName", CUresult, (char *, int, CUdevice))                                           \
    X(cuDeviceTotalMem, "cuDeviceTotalMem_v2", CUresult, (size_t *, CUdevice))                                         \
    X(cuDeviceGetAttribute, "cuDeviceGetAttribute", CUresult, (int *, CUdevice_attribute, CUdevice))                   \
    X(cuDevicePrimaryCtxRetain, "cuDevicePrimaryCtxRetain", CUresult, (CUcontext *, CUdevice))                         \
    X(cuDevicePrimaryCtxRelease, "cuDevicePrimaryCtxRelease_v2", CUresult, (CUdevice))                                 \
    X(cuCtxSetCurrent, "cuCtxSetCurrent", CUresult, (CUcontext))                                                       \
    X(cuMemGetInfo, "cuMemGetInfo_v2", CUresult, (size_t *, size_t *))                                                 \
    X(cuMemAlloc, "cuMemAlloc_v2", CUresult, (CUdeviceptr *, size_t))                                                  \
    X(cuMemFree, "cuMemFree_v2", CUresult, (CUdeviceptr))                                                              \
    X(cuMemAllocHost, "cuMemAllocHost_v2", CUresult, (void **, size_t))                                                \
    X(cuMemFreeHost, "cuMemFreeHost", CUresult, (void *))                                                              \
    X(cuMemcpyHtoDAsync, "cuMemcpyHtoDAsync_v2", CUresult, (CUdeviceptr, const void *, size_t, CUstream))              \
    X(cuMemcpyDtoHAsync, "cuMemcpyDtoHAsync_v2", CUresult, (void *, CUdeviceptr, size_t, CUstream))                    \
    X(cuMemcpyDtoDAsync, "cuMemcpyDtoDAsync_v2", CUresult, (CUdeviceptr, CUdeviceptr, size_t, CUstream))               \
    X(cuStreamCreate, "cuStreamCreate", CUresult, (CUstream *, unsigned int))                                          \
    X(cuStreamDestroy, "cuStreamDestroy_v2", CUresult, (CUstream))                                                     \
    X(cuStreamSynchronize, "cuStreamSynchronize", CUresult, (CUstream))                                                \
    X(cuStreamBeginCapture, "cuStreamBeginCapture_v2", CUresult, (CUstream, CUstreamCaptureMode))                      \
    X(cuStreamEndCapture, "cuStreamEndCapture", CUresult, (CUstream, CUgraph *))                                       \
    X(cuEventCreate, "cuEventCreate", CUresult, (CUevent *, unsigned int))                                             \
    X(cuEventRecord, "cuEventRecord", CUresult, (CUevent, CUstream))                                                   \
    X(cuEventQuery, "cuEventQuery", CUresult, (CUevent))                                                               \
    X(cuEventSynchronize, "cuEventSynchronize", CUresult, (CUevent))                                                   \
    X(cuEventDestroy, "cuEventDestroy_v2", CUresult, (CUevent))                                                        \
    X(cuGraphInstantiate, "cuGraphInstantiateWithFlags", CUresult, (CUgraphExec *, CUgraph, unsigned long long))       \
    X(cuGraphExecUpdate, "cuGraphExecUpdate_v2", CUresult, (CUgraphExec, CUgraph, CUgraphExecUpdateResultInfo *))      \
    X(cuGraphLaunch, "cuGraphLaunch", CUresult, (CUgraphExec, CUstream))                                               \
    X(cuGraphExecDestroy, "cuGraphExecDestroy", CUresult, (CUgraphExec))                                               \
    X(cuGraphDestroy, "cuGraphDestroy", CUresult, (CUgraph))                                                           \
    X(cuModuleLoadData, "cuModuleLoadData", CUresult, (CUmodule *, const void *))                                      \
    X(cuModuleUnload, "cuModuleUnload", CUresult, (CUmodule))                                                          \
    X(cuModuleGetFunction, "cuModuleGetFunction", CUresult, (CUfunction *, CUmodule, const char *))                    \
    X(cuFuncSetAttribute, "cuFuncSetAttribute", CUresult, (CUfunction, CUfunction_attribute, int))                     \
    X(cuLaunchKernel, "cuLaunchKernel", CUresult,                                                                      \
      (CUfunction, unsigned int, unsigned int, unsigned int, unsigned int, unsigned int, unsigned int, unsigned int,   \
       CUstream, void **, void **))

/* ---- NVRTC: libnvrtc.so.13, .12 ------------------------------------------------------------------------------ */

#if HG_CUDA_OWN_TYPES
typedef struct _nvrtcProgram *nvrtcProgram;
typedef unsigned int nvrtcResult;
#endif

#define HG_CUDA_NVRTC(X)                                                                                               \
    X(nvrtcVersion, "nvrtcVersion", nvrtcResult, (int *, int *))                                                       \
    X(nvrtcGetErrorString, "nvrtcGetErrorString", const char *, (nvrtcResult))                                         \
    X(nvrtcGetNumSupportedArchs, "nvrtcGetNumSupportedArchs", nvrtcResult, (int *))                                    \
    X(nvrtcGetSupportedArchs, "nvrtcGetSupportedArchs", nvrtcResult, (int *))                                          \
    X(nvrtcCreateProgram, "nvrtcCreateProgram", nvrtcResult,                                                           \
      (nvrtcProgram *, const char *, const char *, int, const char *const *, const char *const *))                     \
    X(nvrtcDestroyProgram, "nvrtcDestroyProgram", nvrtcResult, (nvrtcProgram *))                                       \
    X(nvrtcCompileProgram, "nvrtcCompileProgram", nvrtcResult, (nvrtcProgram, int, const char *const *))               \
    X(nvrtcGetProgramLogSize, "nvrtcGetProgramLogSize", nvrtcResult, (nvrtcProgram, size_t *))                         \
    X(nvrtcGetProgramLog, "nvrtcGetProgramLog", nvrtcResult, (nvrtcProgram, char *))                                   \
    X(nvrtcGetPTXSize, "nvrtcGetPTXSize", nvrtcResult, (nvrtcProgram, size_t *))                                       \
    X(nvrtcGetPTX, "nvrtcGetPTX", nvrtcResult, (nvrtcProgram, char *))                                                 \
    X(nvrtcGetCUBINSize, "nvrtcGetCUBINSize", nvrtcResult, (nvrtcProgram, size_t *))                                   \
    X(nvrtcGetCUBIN, "nvrtcGetCUBIN", nvrtcResult, (nvrtcProgram, char *))

/* ---- cuBLAS: libcublas.so.13, .12 ---------------------------------------------------------------------------- */

#if HG_CUDA_OWN_TYPES
typedef struct cublasContext *cublasHandle_t;
typedef unsigned int cublasStatus_t, cublasOperation_t, cudaDataType, cublasComputeType_t, libraryPropertyType;
typedef unsigned int cublasAtomicsMode_t, cublasMath_t;
typedef int cublasGemmAlgo_t;
#endif

#define HG_CUDA_BLAS_VALUES(X)                                                                                         \
    X(CUBLAS_STATUS_SUCCESS, 0)                                                                                        \
    X(CUBLAS_OP_N, 0)                                                                                                  \
    X(CUBLAS_OP_T, 1)                                                                                                  \
    X(CUDA_R_32F, 0)                                                                                                   \
    X(CUDA_R_64F, 1)                                                                                                   \
    X(CUDA_R_16BF, 14)                                                                                                 \
    X(CUBLAS_COMPUTE_32F, 68)                                                                                          \
    X(CUBLAS_COMPUTE_64F, 70)                                                                                          \
    X(CUBLAS_COMPUTE_32F_FAST_TF32, 77)                                                                                \
    X(CUBLAS_ATOMICS_NOT_ALLOWED, 0)                                                                                   \
    X(CUBLAS_MATH_DISALLOW_REDUCED_PRECISION_REDUCTION, 16)                                                            \
    X(CUBLAS_GEMM_DEFAULT, -1)                                                                                         \
    X(MAJOR_VERSION, 0)                                                                                                \
    X(MINOR_VERSION, 1)

#define HG_CUDA_BLAS(X)                                                                                                \
    X(cublasCreate, "cublasCreate_v2", cublasStatus_t, (cublasHandle_t *))                                             \
    X(cublasDestroy, "cublasDestroy_v2", cublasStatus_t, (cublasHandle_t))                                             \
    X(cublasGetProperty, "cublasGetProperty", cublasStatus_t, (libraryPropertyType, int *))                            \
    X(cublasSetStream, "cublasSetStream_v2", cublasStatus_t, (cublasHandle_t, CUstream))                               \
    X(cublasSetWorkspace, "cublasSetWorkspace_v2", cublasStatus_t, (cublasHandle_t, void *, size_t))                   \
    X(cublasSetAtomicsMode, "cublasSetAtomicsMode", cublasStatus_t, (cublasHandle_t, cublasAtomicsMode_t))             \
    X(cublasSetMathMode, "cublasSetMathMode", cublasStatus_t, (cublasHandle_t, cublasMath_t))                          \
    X(cublasGetStatusString, "cublasGetStatusString", const char *, (cublasStatus_t))                                  \
    X(cublasGemmEx, "cublasGemmEx", cublasStatus_t,                                                                    \
      (cublasHandle_t, cublasOperation_t, cublasOperation_t, int, int, int, const void *, const void *, cudaDataType,  \
       int, const void *, cudaDataType, int, const void *, void *, cudaDataType, int, cublasComputeType_t,             \
       cublasGemmAlgo_t))

/* ---- cuDNN: libcudnn.so.9, opened when a convolution is first asked for --------------------------------------- */

#ifndef HG_CUDA_OWN_DNN_TYPES
#define HG_CUDA_OWN_DNN_TYPES HG_CUDA_OWN_TYPES
#endif
#if HG_CUDA_OWN_DNN_TYPES
typedef struct cudnnContext *cudnnHandle_t;
typedef struct cudnnTensorStruct *cudnnTensorDescriptor_t;
typedef struct cudnnFilterStruct *cudnnFilterDescriptor_t;
typedef struct cudnnConvolutionStruct *cudnnConvolutionDescriptor_t;
typedef unsigned int cudnnStatus_t, cudnnDataType_t, cudnnTensorFormat_t, cudnnConvolutionMode_t, cudnnMathType_t;
typedef unsigned int cudnnConvolutionFwdAlgo_t, cudnnConvolutionBwdDataAlgo_t, cudnnConvolutionBwdFilterAlgo_t;
#endif

#define HG_CUDA_DNN_VALUES(X)                                                                                          \
    X(CUDNN_STATUS_SUCCESS, 0)                                                                                         \
    X(CUDNN_DATA_FLOAT, 0)                                                                                             \
    X(CUDNN_DATA_DOUBLE, 1)                                                                                            \
    X(CUDNN_DATA_BFLOAT16, 9)                                                                                          \
    X(CUDNN_TENSOR_NCHW, 0)                                                                                            \
    X(CUDNN_CROSS_CORRELATION, 1)                                                                                      \
    X(CUDNN_TENSOR_OP_MATH, 1)                                                                                         \
    X(CUDNN_FMA_MATH, 3)                                                                                               \
    X(CUDNN_CONVOLUTION_FWD_ALGO_IMPLICIT_GEMM, 0)                                                                     \
    X(CUDNN_CONVOLUTION_FWD_ALGO_IMPLICIT_PRECOMP_GEMM, 1)                                                             \
    X(CUDNN_CONVOLUTION_BWD_DATA_ALGO_1, 1)                                                                            \
    X(CUDNN_CONVOLUTION_BWD_FILTER_ALGO_1, 1)

#define HG_CUDA_DNN(X)                                                                                                 \
    X(cudnnGetVersion, "cudnnGetVersion", size_t, (void))                                                              \
    X(cudnnCreate, "cudnnCreate", cudnnStatus_t, (cudnnHandle_t *))                                                    \
    X(cudnnDestroy, "cudnnDestroy", cudnnStatus_t, (cudnnHandle_t))                                                    \
    X(cudnnSetStream, "cudnnSetStream", cudnnStatus_t, (cudnnHandle_t, CUstream))                                      \
    X(cudnnGetErrorString, "cudnnGetErrorString", const char *, (cudnnStatus_t))                                       \
    X(cudnnCreateTensorDescriptor, "cudnnCreateTensorDescriptor", cudnnStatus_t, (cudnnTensorDescriptor_t *))          \
    X(cudnnSetTensor4dDescriptor, "cudnnSetTensor4dDescriptor", cudnnStatus_t,                                         \
      (cudnnTensorDescriptor_t, cudnnTensorFormat_t, cudnnDataType_t, int, int, int, int))                             \
    X(cudnnDestroyTensorDescriptor, "cudnnDestroyTensorDescriptor", cudnnStatus_t, (cudnnTensorDescriptor_t))          \
    X(cudnnCreateFilterDescriptor, "cudnnCreateFilterDescriptor", cudnnStatus_t, (cudnnFilterDescriptor_t *))          \
    X(cudnnSetFilter4dDescriptor, "cudnnSetFilter4dDescriptor", cudnnStatus_t,                                         \
      (cudnnFilterDescriptor_t, cudnnDataType_t, cudnnTensorFormat_t, int, int, int, int))                             \
    X(cudnnDestroyFilterDescriptor, "cudnnDestroyFilterDescriptor", cudnnStatus_t, (cudnnFilterDescriptor_t))          \
    X(cudnnCreateConvolutionDescriptor, "cudnnCreateConvolutionDescriptor", cudnnStatus_t,                             \
      (cudnnConvolutionDescriptor_t *))                                                                                \
    X(cudnnSetConvolution2dDescriptor, "cudnnSetConvolution2dDescriptor", cudnnStatus_t,                               \
      (cudnnConvolutionDescriptor_t, int, int, int, int, int, int, cudnnConvolutionMode_t, cudnnDataType_t))           \
    X(cudnnSetConvolutionMathType, "cudnnSetConvolutionMathType", cudnnStatus_t,                                       \
      (cudnnConvolutionDescriptor_t, cudnnMathType_t))                                                                 \
    X(cudnnDestroyConvolutionDescriptor, "cudnnDestroyConvolutionDescriptor", cudnnStatus_t,                           \
      (cudnnConvolutionDescriptor_t))                                                                                  \
    X(cudnnGetConvolutionForwardWorkspaceSize, "cudnnGetConvolutionForwardWorkspaceSize", cudnnStatus_t,               \
      (cudnnHandle_t, cudnnTensorDescriptor_t, cudnnFilterDescriptor_t, cudnnConvolutionDescriptor_t,                  \
       cudnnTensorDescriptor_t, cudnnConvolutionFwdAlgo_t, size_t *))                                                  \
    X(cudnnGetConvolutionBackwardDataWorkspaceSize, "cudnnGetConvolutionBackwardDataWorkspaceSize", cudnnStatus_t,     \
      (cudnnHandle_t, cudnnFilterDescriptor_t, cudnnTensorDescriptor_t, cudnnConvolutionDescriptor_t,                  \
       cudnnTensorDescriptor_t, cudnnConvolutionBwdDataAlgo_t, size_t *))                                              \
    X(cudnnGetConvolutionBackwardFilterWorkspaceSize, "cudnnGetConvolutionBackwardFilterWorkspaceSize", cudnnStatus_t, \
      (cudnnHandle_t, cudnnTensorDescriptor_t, cudnnTensorDescriptor_t, cudnnConvolutionDescriptor_t,                  \
       cudnnFilterDescriptor_t, cudnnConvolutionBwdFilterAlgo_t, size_t *))                                            \
    X(cudnnConvolutionForward, "cudnnConvolutionForward", cudnnStatus_t,                                               \
      (cudnnHandle_t, const void *, cudnnTensorDescriptor_t, const void *, cudnnFilterDescriptor_t, const void *,      \
       cudnnConvolutionDescriptor_t, cudnnConvolutionFwdAlgo_t, void *, size_t, const void *, cudnnTensorDescriptor_t, \
       void *))                                                                                                        \
    X(cudnnConvolutionBackwardData, "cudnnConvolutionBackwardData", cudnnStatus_t,                                     \
      (cudnnHandle_t, const void *, cudnnFilterDescriptor_t, const void *, cudnnTensorDescriptor_t, const void *,      \
       cudnnConvolutionDescriptor_t, cudnnConvolutionBwdDataAlgo_t, void *, size_t, const void *,                      \
       cudnnTensorDescriptor_t, void *))                                                                               \
    X(cudnnConvolutionBackwardFilter, "cudnnConvolutionBackwardFilter", cudnnStatus_t,                                 \
      (cudnnHandle_t, const void *, cudnnTensorDescriptor_t, const void *, cudnnTensorDescriptor_t, const void *,      \
       cudnnConvolutionDescriptor_t, cudnnConvolutionBwdFilterAlgo_t, void *, size_t, const void *,                    \
       cudnnFilterDescriptor_t, void *))

/* ---- tables -------------------------------------------------------------------------------------------------- */

#if HG_CUDA_OWN_TYPES
#define HG_CUDA_VALUE(name_, value_) name_ = (value_),
enum { HG_CUDA_DRIVER_VALUES(HG_CUDA_VALUE) };
enum { HG_CUDA_BLAS_VALUES(HG_CUDA_VALUE) };
#endif
#if HG_CUDA_OWN_DNN_TYPES
#define HG_CUDA_DNN_VALUE(name_, value_) name_ = (value_),
enum { HG_CUDA_DNN_VALUES(HG_CUDA_DNN_VALUE) };
#endif

#define HG_CUDA_FIELD(field_, symbol_, result_, arguments_) result_(*field_) arguments_;
typedef struct {
    HG_CUDA_DRIVER(HG_CUDA_FIELD)
    HG_CUDA_NVRTC(HG_CUDA_FIELD)
    HG_CUDA_BLAS(HG_CUDA_FIELD)
    int driver_version, nvrtc_major, nvrtc_minor, blas_major, blas_minor;
} hg_cuda_api;
typedef struct {
    HG_CUDA_DNN(HG_CUDA_FIELD)
} hg_cuda_dnn_api;

/* Opened once for the process and kept. One sentence why not: no driver, no NVRTC, no cuBLAS, too old. */
hg_status hg_cuda_library(const hg_cuda_api **api);
const char *hg_cuda_refusal(void); /* that sentence */

/* The same for cuDNN, which convolutions alone need: opened when the first is asked for. */
hg_status hg_cuda_dnn_library(const hg_cuda_dnn_api **api);

/* HG_OK or one sentence: what was tried, CUDA's name of the error and its own words. */
hg_status hg_cuda_check(const hg_cuda_api *api, CUresult result, const char *what);

#endif
