/* The processor as a device: memory, copies, and kernels as OpenMP loops over blocks that depend on n alone. */
#include "tensor/device.h"

#include <omp.h>
#include <stdlib.h>
#include <string.h>

static void *alloc(size_t bytes)
{
    if (bytes > SIZE_MAX - 64) return NULL;
    return aligned_alloc(64, (bytes + 63) / 64 * 64);
}

static hg_status copy(void *to, const void *from, size_t bytes)
{
    memcpy(to, from, bytes);
    return HG_OK;
}

int hg_worker(void) { return omp_get_thread_num(); }

hg_status hg_cpu_launch(int threads, const hg_kernel *kernel, int64_t n, const void *args)
{
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

const hg_device hg_cpu_device = {
    .name = "cpu",
    .host = true,
    .alloc = alloc,
    .free = free,
    .upload = copy,
    .download = copy,
    .launch = hg_cpu_launch,
    .product_workspace = hg_cpu_product_workspace,
    .product = hg_cpu_product,
};
