/* A CUDA device as tensor/cuda/ sees it. */
#ifndef HG_TENSOR_CUDA_DEVICE_H
#define HG_TENSOR_CUDA_DEVICE_H

#include "tensor/arena.h"
#include "tensor/cuda/api.h"

typedef struct hg_cuda_device hg_cuda_device;

typedef struct hg_cuda_module hg_cuda_module; /* what was compiled from one text, see module.c */
typedef struct {
    const hg_kernel *kernel;
    CUfunction function;
    hg_cuda_module *module;
} hg_cuda_kernel;

/* Pinned host memory that uploads go through, see staging.c. */
enum { HG_CUDA_BLOCKS = 64 };
typedef struct {
    unsigned char *memory;
    CUevent copied; /* recorded behind the last copy out of it */
} hg_cuda_block;

/* A step's list of calls, from its beginning or a read to the next read or its end, see graph.c. */
typedef struct {
    unsigned char *calls; /* of the last time */
    size_t size, room;
    CUgraphExec graph; /* NULL: never made */
    bool ready;        /* the graph is of these calls */
    bool refused;      /* these calls cannot be captured */
} hg_cuda_part;

struct hg_cuda_device {
    hg_device device;
    const hg_cuda_api *api;
    CUdevice number;
    CUcontext context;
    CUstream stream;
    int major, minor, multiprocessors; /* compute capability */
    cublasHandle_t blas;               /* made with the first product, with its workspace */
    CUdeviceptr blas_workspace;
    const hg_cuda_dnn_api *dnn_api; /* with the first convolution */
    cudnnHandle_t dnn;
    struct hg_cuda_convolution *convolutions; /* a list of what was asked for */
    hg_dtype compute;

    const char *last; /* what was launched last since the device was last waited for, NULL: nothing */
    int64_t since;    /* how many since then */

    hg_cuda_module *modules; /* a list */
    hg_cuda_kernel *kernels; /* a hash table by address; n_room is a power of two */
    int n_kernels, n_room;

    hg_cuda_block blocks[HG_CUDA_BLOCKS];
    int n_blocks, block; /* the one in use */
    size_t block_used;

    bool recording;
    unsigned char *calls; /* kept so far in this part */
    size_t calls_size, calls_room;
    hg_cuda_part *parts;
    int n_parts, part;
    hg_status untold; /* an error that could not be returned: the next flush does */
    char untold_message[1024];
    hg_arena inbox; /* device memory where uploads of a recorded step wait for their turn */
};

/* device.c. Every entry begins with it: the calling thread works with the device's context. */
hg_status hg_cuda_enter(hg_cuda_device *device);
hg_status hg_cuda_wait(hg_cuda_device *device); /* names what was launched since the last wait where that failed */

/* staging.c: the caller's memory may be used again at once. */
hg_status hg_cuda_stage(hg_cuda_device *device, CUdeviceptr to, const void *from, size_t bytes);
void hg_cuda_staging_free(hg_cuda_device *device);

/* graph.c. Does what `call` does, now, or when the step that is being recorded runs. The arguments are copied, and compared as
 * bytes with those of the step before: no padding in them but zeroes, no pointers but to what lives as long as the device or is
 * the device's memory. A call only enqueues on the device's stream. `name` is for messages, and static. */
typedef hg_status (*hg_cuda_call)(hg_cuda_device *device, const void *args);
hg_status hg_cuda_do(hg_cuda_device *device, const char *name, hg_cuda_call call, const void *args, size_t size);
void *hg_cuda_keep(hg_cuda_device *device, hg_cuda_call call,
                   size_t size);                   /* room for its arguments; NULL after hg_fail */
hg_status hg_cuda_flush(hg_cuda_device *device);   /* runs what was kept so far */
void hg_cuda_flush_untold(hg_cuda_device *device); /* for who returns nothing: an error is the next flush's */
hg_status hg_cuda_record(hg_device *device);
hg_status hg_cuda_run(hg_device *device);
void hg_cuda_graphs_forget(hg_cuda_device *device); /* nothing that was recorded is replayed again */
void hg_cuda_graphs_free(hg_cuda_device *device);

/* module.c: the function of a kernel, compiled when it is first asked for and kept in the cache on disk. */
hg_status hg_cuda_function(hg_cuda_device *device, const hg_kernel *kernel, CUfunction *function);
void hg_cuda_forget(hg_device *device, const hg_kernel *kernel);
bool hg_cuda_has_function(const hg_kernel *kernel);
void hg_cuda_modules_free(hg_cuda_device *device);

/* product.c */
size_t hg_cuda_product_workspace(hg_device *device, hg_dtype dtype, bool transpose_a, int64_t m, int64_t n, int64_t k);
hg_status hg_cuda_product(hg_device *device, int threads, hg_dtype dtype, bool transpose_a, bool transpose_b, int64_t m,
                          int64_t n, int64_t k, double alpha, const void *a, int64_t lda, const void *b, int64_t ldb,
                          double beta, void *c, int64_t ldc, void *workspace);

/* convolution.c */
hg_status hg_cuda_convolve_workspace(hg_device *device, int threads, const hg_convolve_call *call, size_t *bytes);
hg_status hg_cuda_convolve(hg_device *device, int threads, const hg_convolve_call *call, void *workspace);
void hg_cuda_convolutions_free(hg_cuda_device *device);

/* The files that the library carries for NVRTC: *.kernel.h, *.inc and the headers they include, by their path from the root;
 * the last has no name. Made by base/generate_texts.c. */
typedef struct {
    const char *name, *text;
} hg_kernel_file;
extern const hg_kernel_file hg_kernel_files[];

#endif
