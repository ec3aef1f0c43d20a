/* The processor as a device: memory, copies, and kernels as OpenMP loops over blocks that depend on n alone. */
#include "tensor/device.h"

#include <omp.h>
#include <stdlib.h>
#include <string.h>

static void *alloc(hg_device *device, size_t bytes)
{
    (void)device;
    if (bytes > SIZE_MAX - 64) return NULL;
    return aligned_alloc(64, (bytes + 63) / 64 * 64);
}

static void release(hg_device *device, void *memory)
{
    (void)device;
    free(memory);
}

static hg_status copy(hg_device *device, void *to, const void *from, size_t bytes)
{
    (void)device;
    memcpy(to, from, bytes);
    return HG_OK;
}

int hg_worker(void) { return omp_get_thread_num(); }

hg_status hg_cpu_launch(hg_device *device, int threads, const hg_kernel *kernel, int64_t n, const void *args)
{
    (void)device;
    if (!kernel->cpu) return hg_fail(HG_UNSUPPORTED, "%s: this kernel has no body for the cpu", kernel->name);
    int64_t block = kernel->block > 0 ? kernel->block : 4096;
    int64_t blocks = (n + block - 1) / block;
    if (blocks < threads) threads = (int)blocks;
    if (threads <= 1) {
        for (int64_t b = 0; b < blocks; b++)
            kernel->cpu(args, b * block, b * block + block < n ? b * block + block : n);
        return HG_OK;
    }
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t b = 0; b < blocks; b++) kernel->cpu(args, b * block, b * block + block < n ? b * block + block : n);
    return HG_OK;
}

static hg_status wait(hg_device *device) { return (void)device, HG_OK; }

static bool launches(const hg_device *device, const hg_kernel *kernel) { return (void)device, kernel->cpu != NULL; }

static hg_status compute(hg_device *device, hg_dtype dtype)
{
    (void)device;
    if (dtype == HG_TF32)
        return hg_fail(HG_UNSUPPORTED, "compute in tf32: only GPUs have it; the cpu computes in f32 or bf16");
    if (dtype == HG_F32 || hg_cpu_has_bf16()) return HG_OK;
    return hg_fail(HG_UNSUPPORTED,
                   "compute in bf16: this processor has no bf16 instructions (avx512_bf16), so f32 would be "
                   "faster; use f32");
}

hg_device *hg_cpu_device(void)
{
    static hg_device device = {
        .name = "cpu",
        .host = true,
        .alloc = alloc,
        .free = release,
        .upload = copy,
        .download = copy,
        .wait = wait,
        .launch = hg_cpu_launch,
        .launches = launches,
        .product_workspace = hg_cpu_product_workspace,
        .product = hg_cpu_product,
        .convolve_workspace = hg_cpu_convolve_workspace,
        .convolve = hg_cpu_convolve,
        .compute = compute,
    };
    return &device;
}
