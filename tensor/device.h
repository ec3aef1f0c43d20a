/* The device seam: what a backend has to offer. Nothing outside tensor/ sees this. */
#ifndef HG_TENSOR_DEVICE_H
#define HG_TENSOR_DEVICE_H

#include "tensor/tensor.h"

typedef struct hg_device {
    const char *name;
    bool host;                    /* its memory can be read and written by the processor */
    void *(*alloc)(size_t bytes); /* 64-byte aligned, not zeroed, NULL on failure */
    void (*free)(void *memory);
    hg_status (*upload)(void *device, const void *host, size_t bytes);
    hg_status (*download)(void *host, const void *device, size_t bytes);
    hg_status (*launch)(int threads, const hg_kernel *kernel, int64_t n, const void *args);
    /* Same contract as hg_product; workspace is what it asked for with product_workspace. */
    size_t (*product_workspace)(hg_dtype dtype, bool transpose_a, int64_t m, int64_t n, int64_t k);
    hg_status (*product)(int threads, hg_dtype dtype, bool transpose_a, bool transpose_b, int64_t m, int64_t n,
                         int64_t k, double alpha, const void *a, int64_t lda, const void *b, int64_t ldb, double beta,
                         void *c, int64_t ldc, void *workspace);
} hg_device;

extern const hg_device hg_cpu_device;

/* tensor/cpu/product.c, for tensor/cpu/device.c */
size_t hg_cpu_product_workspace(hg_dtype dtype, bool transpose_a, int64_t m, int64_t n, int64_t k);
hg_status hg_cpu_product(int threads, hg_dtype dtype, bool transpose_a, bool transpose_b, int64_t m, int64_t n,
                         int64_t k, double alpha, const void *a, int64_t lda, const void *b, int64_t ldb, double beta,
                         void *c, int64_t ldc, void *workspace);
/* tensor/cpu/product_bf16.c: c = op(a) op(b), or c += that; factors bf16, sums f32, on the calling thread */
bool hg_cpu_has_bf16(void);
void hg_cpu_product_bf16(bool transpose_a, bool transpose_b, int64_t m, int64_t n, int64_t k, const uint16_t *a,
                         int64_t lda, const uint16_t *b, int64_t ldb, bool add, float *c, int64_t ldc);
hg_status hg_cpu_launch(int threads, const hg_kernel *kernel, int64_t n, const void *args);

#endif
