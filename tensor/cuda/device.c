/* A CUDA device: memory, copies, launches on one stream. */
#include "tensor/cuda/device.h"

#include <stdio.h>
#include <string.h>

static hg_cuda_device *of(hg_device *device) { return (hg_cuda_device *)(void *)device; }

/* ---- memory ---- */

static void *alloc(hg_device *device, size_t bytes)
{
    hg_cuda_device *d = of(device);
    CUdeviceptr memory = 0;
    if (hg_cuda_check(d->api, d->api->cuCtxSetCurrent(d->context), "the context") != HG_OK) return NULL;
    const CUresult result = d->api->cuMemAlloc(&memory, bytes);
    if (result == CUDA_SUCCESS) return (void *)(uintptr_t)memory;
    size_t free = 0, all = 0;
    d->api->cuMemGetInfo(&free, &all);
    if (result == CUDA_ERROR_OUT_OF_MEMORY)
        hg_fail(HG_MEMORY, "the device has %.1f MB free of %.1f MB, %.1f MB were asked for", (double)free / 1e6,
                (double)all / 1e6, (double)bytes / 1e6);
    else
        hg_cuda_check(d->api, result, "memory");
    return NULL;
}

static void release(hg_device *device, void *memory)
{
    if (memory) of(device)->api->cuMemFree((CUdeviceptr)(uintptr_t)memory);
}

static hg_status upload(hg_device *device, void *to, const void *from, size_t bytes)
{
    hg_cuda_device *d = of(device);
    d->device.counts.uploaded += (int64_t)bytes;
    return hg_cuda_check(d->api, d->api->cuMemcpyHtoDAsync((CUdeviceptr)(uintptr_t)to, from, bytes, d->stream),
                         "a copy to the device");
}

static hg_status download(hg_device *device, void *to, const void *from, size_t bytes)
{
    hg_cuda_device *d = of(device);
    d->device.counts.downloaded += (int64_t)bytes;
    HG_TRY(hg_cuda_check(d->api, d->api->cuMemcpyDtoHAsync(to, (CUdeviceptr)(uintptr_t)from, bytes, d->stream),
                         "a copy from the device"));
    return hg_cuda_check(d->api, d->api->cuStreamSynchronize(d->stream), "waiting for the device");
}

static hg_status wait(hg_device *device)
{
    hg_cuda_device *d = of(device);
    return hg_cuda_check(d->api, d->api->cuStreamSynchronize(d->stream), "waiting for the device");
}

/* ---- kernels ---- */

static hg_status launch(hg_device *device, int threads, const hg_kernel *kernel, int64_t n, const void *args)
{
    hg_cuda_device *d = of(device);
    (void)threads;
    CUfunction function;
    HG_TRY(hg_cuda_function(d, kernel, &function));
    const int64_t per_block = kernel->threads ? kernel->threads : 256;
    const int64_t indices = kernel->indices ? kernel->indices : per_block;
    int64_t blocks = (n + indices - 1) / indices,
            most = kernel->indices ? 0x7fffffff : 32 * (int64_t)d->multiprocessors;
    if (blocks > most) blocks = most; /* kernels stride over the rest */
    void *params[] = { (void *)(uintptr_t)args, &n };
    d->device.counts.launches++;
    return hg_cuda_check(d->api,
                         d->api->cuLaunchKernel(function, (unsigned)blocks, 1, 1, (unsigned)per_block, 1, 1,
                                                (unsigned)kernel->shared, d->stream, params, NULL),
                         kernel->name);
}

static bool launches(const hg_device *device, const hg_kernel *kernel)
{
    return (void)device, hg_cuda_has_function(kernel);
}

static size_t product_workspace(hg_device *device, hg_dtype dtype, bool transpose_a, int64_t m, int64_t n, int64_t k)
{
    (void)device, (void)dtype, (void)transpose_a, (void)m, (void)n, (void)k;
    return 0;
}

static hg_status compute(hg_device *device, hg_dtype dtype)
{
    of(device)->compute = dtype;
    return HG_OK;
}

/* ---- life ---- */

static void close_device(hg_device *device)
{
    hg_cuda_device *d = of(device);
    if (d->stream) d->api->cuStreamSynchronize(d->stream);
    hg_cuda_modules_free(d);
    if (d->blas) d->api->cublasDestroy(d->blas);
    if (d->stream) d->api->cuStreamDestroy(d->stream);
    if (d->context) d->api->cuDevicePrimaryCtxRelease(d->number);
    hg_free(d);
}

static hg_status start(hg_cuda_device *d, int number)
{
    const hg_cuda_api *api = d->api;
    int count = 0;
    HG_TRY(hg_cuda_check(api, api->cuDeviceGetCount(&count), "counting the devices"));
    if (number >= count)
        return hg_fail(HG_UNSUPPORTED, "cuda: device %d was asked for, but there %s %d", number,
                       count == 1 ? "is" : "are", count);
    HG_TRY(hg_cuda_check(api, api->cuDeviceGet(&d->number, number), "the device"));
    api->cuDeviceGetAttribute(&d->major, CU_ATTRIBUTE_COMPUTE_MAJOR, d->number);
    api->cuDeviceGetAttribute(&d->minor, CU_ATTRIBUTE_COMPUTE_MINOR, d->number);
    api->cuDeviceGetAttribute(&d->multiprocessors, CU_ATTRIBUTE_MULTIPROCESSOR_COUNT, d->number);
    HG_TRY(hg_cuda_check(api, api->cuDevicePrimaryCtxRetain(&d->context, d->number), "the context of the device"));
    HG_TRY(hg_cuda_check(api, api->cuCtxSetCurrent(d->context), "the context of the device"));
    HG_TRY(hg_cuda_check(api, api->cuStreamCreate(&d->stream, CU_STREAM_NON_BLOCKING), "a stream"));
    return HG_OK;
}

hg_status hg_cuda_open(hg_device **out, int number)
{
    const hg_cuda_api *api;
    HG_TRY(hg_cuda_library(&api));
    hg_cuda_device *d = hg_alloc(1, sizeof *d);
    if (!d) return HG_MEMORY;
    *d = (hg_cuda_device){ .api = api,
                           .device = { .name = "cuda",
                                       .close = close_device,
                                       .alloc = alloc,
                                       .free = release,
                                       .upload = upload,
                                       .download = download,
                                       .wait = wait,
                                       .launch = launch,
                                       .launches = launches,
                                       .forget = hg_cuda_forget,
                                       .product_workspace = product_workspace,
                                       .product = hg_cuda_product,
                                       .compute = compute } };
    const hg_status status = start(d, number);
    if (status != HG_OK) {
        close_device(&d->device);
        return status;
    }
    *out = &d->device;
    return HG_OK;
}

int hg_cuda_list(hg_device_info *infos, int room)
{
    const hg_cuda_api *api;
    hg_device_info none = { .name = "cuda" };
    if (hg_cuda_library(&api) != HG_OK) {
        snprintf(none.why, sizeof none.why, "%s", hg_message());
        if (room > 0) infos[0] = none;
        return 1;
    }
    int count = 0;
    api->cuDeviceGetCount(&count);
    for (int i = 0; i < count && i < room; i++) {
        hg_device_info *info = &infos[i];
        int major = 0, minor = 0;
        CUdevice device = 0;
        *info = none;
        if (count > 1) snprintf(info->name, sizeof info->name, "cuda:%d", i);
        api->cuDeviceGet(&device, i);
        api->cuDeviceGetName(info->what, sizeof info->what, device);
        api->cuDeviceTotalMem(&info->memory, device);
        api->cuDeviceGetAttribute(&major, CU_ATTRIBUTE_COMPUTE_MAJOR, device);
        api->cuDeviceGetAttribute(&minor, CU_ATTRIBUTE_COMPUTE_MINOR, device);
        snprintf(info->versions, sizeof info->versions, "compute capability %d.%d, driver for CUDA %d.%d, NVRTC %d.%d",
                 major, minor, api->driver_version / 1000, api->driver_version % 1000 / 10, api->nvrtc_major,
                 api->nvrtc_minor);
    }
    return count;
}
