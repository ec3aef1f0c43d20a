/* The device seam: what a backend has to offer. Nothing outside tensor/ sees this. */
#ifndef HG_TENSOR_DEVICE_H
#define HG_TENSOR_DEVICE_H

#include "tensor/tensor.h"

/* What hg_convolve and its gradients become: of x, weight and y one is written. */
typedef enum { HG_CONVOLVE, HG_CONVOLVE_TO_INPUT, HG_CONVOLVE_TO_WEIGHT } hg_convolve_which;
typedef struct {
    const hg_convolution *sizes;
    hg_convolve_which which;
    hg_dtype dtype, compute;
    void *x, *weight, *y;
    const void *bias; /* NULL: none */
    bool add;         /* to what is written; never forward */
} hg_convolve_call;

/* One a context; the cpu's is shared. A backend's own struct begins with this one. */
typedef struct hg_device hg_device;
struct hg_device {
    const char *name;
    char what[160];             /* hg_ctx_device_what */
    bool host;                  /* its memory can be read and written by the processor */
    void (*close)(hg_device *); /* NULL: nothing to close */
    void *(*alloc)(
        hg_device *,
        size_t bytes); /* 64-byte aligned, not zeroed; NULL after hg_fail: how much was asked, what is free */
    void (*free)(hg_device *, void *memory);
    hg_status (*upload)(hg_device *, void *device, const void *host, size_t bytes);
    hg_status (*download)(hg_device *, void *host, const void *device, size_t bytes); /* waits */
    hg_status (*wait)(hg_device *);
    hg_status (*launch)(hg_device *, int threads, const hg_kernel *kernel, int64_t n, const void *args);
    bool (*launches)(const hg_device *, const hg_kernel *kernel);
    void (*forget)(hg_device *, const hg_kernel *kernel); /* hg_kernel_release; NULL: nothing is kept */
    /* Same contract as hg_product; workspace is what it asked for with product_workspace. */
    size_t (*product_workspace)(hg_device *, hg_dtype dtype, bool transpose_a, int64_t m, int64_t n, int64_t k);
    hg_status (*product)(hg_device *, int threads, hg_dtype dtype, bool transpose_a, bool transpose_b, int64_t m,
                         int64_t n, int64_t k, double alpha, const void *a, int64_t lda, const void *b, int64_t ldb,
                         double beta, void *c, int64_t ldc, void *workspace);
    hg_status (*convolve_workspace)(hg_device *, int threads, const hg_convolve_call *, size_t *bytes);
    hg_status (*convolve)(hg_device *, int threads, const hg_convolve_call *, void *workspace);
    hg_status (*compute)(hg_device *, hg_dtype dtype); /* hg_ctx_compute: may it? NULL: f32 alone */
    hg_status (*record)(hg_device *);                  /* NULL: everything is run at once */
    hg_status (*run)(hg_device *);
    hg_device_counts counts;
};

hg_device *hg_cpu_device(void);
hg_status hg_cuda_open(hg_device **out, int number); /* tensor/cuda/device.c; one sentence why not */
int hg_cuda_list(hg_device_info *infos, int room);

/* tensor/cpu/product.c, for tensor/cpu/device.c */
size_t hg_cpu_product_workspace(hg_device *, hg_dtype dtype, bool transpose_a, int64_t m, int64_t n, int64_t k);
hg_status hg_cpu_product(hg_device *, int threads, hg_dtype dtype, bool transpose_a, bool transpose_b, int64_t m,
                         int64_t n, int64_t k, double alpha, const void *a, int64_t lda, const void *b, int64_t ldb,
                         double beta, void *c, int64_t ldc, void *workspace);
/* tensor/cpu/convolution.c */
hg_status hg_cpu_convolve_workspace(hg_device *, int threads, const hg_convolve_call *, size_t *bytes);
hg_status hg_cpu_convolve(hg_device *, int threads, const hg_convolve_call *, void *workspace);
/* tensor/cpu/product_bf16.c: c = op(a) op(b), or c += that; factors bf16, sums f32, on the calling thread */
bool hg_cpu_has_bf16(void);
void hg_cpu_product_bf16(bool transpose_a, bool transpose_b, int64_t m, int64_t n, int64_t k, const uint16_t *a,
                         int64_t lda, const uint16_t *b, int64_t ldb, bool add, float *c, int64_t ldc);
hg_status hg_cpu_launch(hg_device *, int threads, const hg_kernel *kernel, int64_t n, const void *args);

#endif
