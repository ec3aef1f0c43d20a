/* The entry points of CUDA that are called, as typed tables: nothing of CUDA is linked or needed to build. They are filled by
 * library.c when a CUDA device is first asked for. Types and signatures are those of NVIDIA's headers (driver API of CUDA 12.4
 * and later, NVRTC, cuBLAS 12, cuDNN 9), against which tests/test_cuda_headers.c holds them where those are installed. */
#ifndef HG_TENSOR_CUDA_API_H
#define HG_TENSOR_CUDA_API_H

#include "base/base.h"

/* ---- driver: libcuda.so.1 ------------------------------------------------------------------------------------ */

typedef int CUresult, CUdevice;
typedef unsigned long long CUdeviceptr;
typedef struct CUctx_st *CUcontext;
typedef struct CUmod_st *CUmodule;
typedef struct CUfunc_st *CUfunction;
typedef struct CUstream_st *CUstream;
typedef struct CUevent_st *CUevent;
typedef struct CUgraph_st *CUgraph;
typedef struct CUgraphExec_st *CUgraphExec;
typedef struct CUgraphNode_st *CUgraphNode;

enum { CUDA_SUCCESS = 0, CUDA_ERROR_OUT_OF_MEMORY = 2 };
enum { /* CUdevice_attribute */
       CU_ATTRIBUTE_MULTIPROCESSOR_COUNT = 16,
       CU_ATTRIBUTE_COMPUTE_MAJOR = 75,
       CU_ATTRIBUTE_COMPUTE_MINOR = 76,
       CU_ATTRIBUTE_SHARED_OPTIN = 97,
};
enum { CU_FUNC_MAX_DYNAMIC_SHARED = 8 }; /* CUfunction_attribute */
enum { CU_STREAM_NON_BLOCKING = 1 };
enum { CU_CAPTURE_THREAD_LOCAL = 1 };

typedef struct {
    int result;
    CUgraphNode errorNode, errorFromNode;
} CUgraphExecUpdateResultInfo;

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
    X(cuDeviceGetAttribute, "cuDeviceGetAttribute", CUresult, (int *, int, CUdevice))                                  \
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
    X(cuStreamCreate, "cuStreamCreate", CUresult, (CUstream *, unsigned int))                                          \
    X(cuStreamDestroy, "cuStreamDestroy_v2", CUresult, (CUstream))                                                     \
    X(cuStreamSynchronize, "cuStreamSynchronize", CUresult, (CUstream))                                                \
    X(cuStreamBeginCapture, "cuStreamBeginCapture_v2", CUresult, (CUstream, int))                                      \
    X(cuStreamEndCapture, "cuStreamEndCapture", CUresult, (CUstream, CUgraph *))                                       \
    X(cuEventCreate, "cuEventCreate", CUresult, (CUevent *, unsigned int))                                             \
    X(cuEventRecord, "cuEventRecord", CUresult, (CUevent, CUstream))                                                   \
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
    X(cuFuncSetAttribute, "cuFuncSetAttribute", CUresult, (CUfunction, int, int))                                      \
    X(cuLaunchKernel, "cuLaunchKernel", CUresult,                                                                      \
      (CUfunction, unsigned int, unsigned int, unsigned int, unsigned int, unsigned int, unsigned int, unsigned int,   \
       CUstream, void **, void **))

/* ---- NVRTC: libnvrtc.so.13, .12 ------------------------------------------------------------------------------ */

typedef struct _nvrtcProgram *nvrtcProgram;
typedef int nvrtcResult;

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

typedef struct cublasContext *cublasHandle_t;
typedef int cublasStatus_t;
enum { CUBLAS_OP_N = 0, CUBLAS_OP_T = 1 };
enum { CUDA_R_32F = 0, CUDA_R_64F = 1, CUDA_R_16BF = 14 };                                    /* cudaDataType */
enum { CUBLAS_COMPUTE_32F = 68, CUBLAS_COMPUTE_64F = 70, CUBLAS_COMPUTE_32F_FAST_TF32 = 77 }; /* cublasComputeType_t */
enum { CUBLAS_GEMM_DEFAULT = -1 };

#define HG_CUDA_BLAS(X)                                                                                                \
    X(cublasCreate, "cublasCreate_v2", cublasStatus_t, (cublasHandle_t *))                                             \
    X(cublasDestroy, "cublasDestroy_v2", cublasStatus_t, (cublasHandle_t))                                             \
    X(cublasGetVersion, "cublasGetVersion_v2", cublasStatus_t, (cublasHandle_t, int *))                                \
    X(cublasSetStream, "cublasSetStream_v2", cublasStatus_t, (cublasHandle_t, CUstream))                               \
    X(cublasSetWorkspace, "cublasSetWorkspace_v2", cublasStatus_t, (cublasHandle_t, void *, size_t))                   \
    X(cublasGetStatusString, "cublasGetStatusString", const char *, (cublasStatus_t))                                  \
    X(cublasGemmEx, "cublasGemmEx", cublasStatus_t,                                                                    \
      (cublasHandle_t, int, int, int, int, int, const void *, const void *, int, int, const void *, int, int,          \
       const void *, void *, int, int, int, int))

/* ---- tables -------------------------------------------------------------------------------------------------- */

#define HG_CUDA_FIELD(field_, symbol_, result_, arguments_) result_(*field_) arguments_;
typedef struct {
    HG_CUDA_DRIVER(HG_CUDA_FIELD)
    HG_CUDA_NVRTC(HG_CUDA_FIELD)
    HG_CUDA_BLAS(HG_CUDA_FIELD)
    int driver_version, nvrtc_major, nvrtc_minor;
} hg_cuda_api;

/* Opened once for the process and kept. One sentence why not: no driver, no NVRTC, no cuBLAS, too old. */
hg_status hg_cuda_library(const hg_cuda_api **api);

/* HG_OK or one sentence: what was tried, CUDA's name of the error and its own words. */
hg_status hg_cuda_check(const hg_cuda_api *api, CUresult result, const char *what);

#endif
