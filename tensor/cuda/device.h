/* A CUDA device as tensor/cuda/ sees it. */
#ifndef HG_TENSOR_CUDA_DEVICE_H
#define HG_TENSOR_CUDA_DEVICE_H

#include "tensor/cuda/api.h"
#include "tensor/device.h"

typedef struct hg_cuda_module hg_cuda_module; /* what was compiled from one text, see module.c */

typedef struct {
    hg_device device;
    const hg_cuda_api *api;
    CUdevice number;
    CUcontext context;
    CUstream stream;
    int major, minor, multiprocessors; /* compute capability */
    cublasHandle_t blas;
    hg_dtype compute;
    hg_cuda_module *modules; /* a list */
} hg_cuda_device;

/* module.c: the function of a kernel, compiled when it is first asked for and kept in the cache on disk. */
hg_status hg_cuda_function(hg_cuda_device *device, const hg_kernel *kernel, CUfunction *function);
void hg_cuda_forget(hg_device *device, const hg_kernel *kernel);
bool hg_cuda_has_function(const hg_kernel *kernel);
void hg_cuda_modules_free(hg_cuda_device *device);

/* product.c */
hg_status hg_cuda_product(hg_device *device, int threads, hg_dtype dtype, bool transpose_a, bool transpose_b, int64_t m,
                          int64_t n, int64_t k, double alpha, const void *a, int64_t lda, const void *b, int64_t ldb,
                          double beta, void *c, int64_t ldc, void *workspace);

/* The files that the library carries for NVRTC: *.kernel.h, *.inc and the headers they include, by their path from the root;
 * the last has no name. Made by base/generate_texts.c. */
typedef struct {
    const char *name, *text;
} hg_kernel_file;
extern const hg_kernel_file hg_kernel_files[];

#endif
