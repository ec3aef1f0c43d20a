/* A CUDA device: memory, copies, launches on one stream. It has the device's primary context, which it shares with whatever else
 * in the process uses the device, and may be used from any thread, one at a time. */
#include "tensor/cuda/device.h"

#include <stdio.h>
#include <string.h>

static hg_cuda_device *of(hg_device *device) { return (hg_cuda_device *)(void *)device; }

hg_status hg_cuda_enter(hg_cuda_device *d)
{
    return hg_cuda_check(d->api, d->api->cuCtxSetCurrent(d->context), "the context of the device");
}

/* A kernel that fails is heard of when the device is next waited for, and by then others may have been launched. */
hg_status hg_cuda_wait(hg_cuda_device *d)
{
    const CUresult result = d->api->cuStreamSynchronize(d->stream);
    const int64_t since = d->since;
    char what[192] = "waiting for the device";
    d->since = 0;
    if (result == CUDA_SUCCESS) return HG_OK;
    if (since == 1)
        snprintf(what, sizeof what, "%s", d->last);
    else if (since > 1)
        snprintf(what, sizeof what, "one of the last %lld kernels and products, which end with %s", (long long)since,
                 d->last);
    return hg_cuda_check(d->api, result, what);
}

/* ---- memory ---- */

static void *alloc(hg_device *device, size_t bytes)
{
    hg_cuda_device *d = of(device);
    CUdeviceptr memory = 0;
    if (hg_cuda_enter(d) != HG_OK) return NULL;
    const CUresult result = d->api->cuMemAlloc(&memory, bytes);
    if (result == CUDA_SUCCESS) return (void *)(uintptr_t)memory;
    size_t free = 0, all = 0;
    d->api->cuMemGetInfo(&free, &all);
    if (result == CUDA_ERROR_OUT_OF_MEMORY)
        hg_fail(HG_MEMORY, "%.1f MB were asked for, the device has %.1f MB free of %.1f MB", (double)bytes / 1e6,
                (double)free / 1e6, (double)all / 1e6);
    else
        hg_cuda_check(d->api, result, "memory");
    return NULL;
}

/* What was launched, or kept, may still use it. */
static void release(hg_device *device, void *memory)
{
    hg_cuda_device *d = of(device);
    if (!memory || hg_cuda_enter(d) != HG_OK) return;
    hg_cuda_flush_untold(d);
    d->api->cuStreamSynchronize(d->stream); /* an error of a kernel comes up again at the next wait */
    d->api->cuMemFree((CUdeviceptr)(uintptr_t)memory);
}

/* ---- copies ---- */

typedef struct {
    CUdeviceptr to, from;
    size_t bytes;
} move;

static hg_status move_now(hg_cuda_device *d, const void *args)
{
    const move *m = args;
    return hg_cuda_check(d->api, d->api->cuMemcpyDtoDAsync(m->to, m->from, m->bytes, d->stream),
                         "a copy on the device");
}

static hg_status upload(hg_device *device, void *to, const void *from, size_t bytes)
{
    hg_cuda_device *d = of(device);
    HG_TRY(hg_cuda_enter(d));
    if (d->calls_size == 0) return hg_cuda_stage(d, (CUdeviceptr)(uintptr_t)to, from, bytes);
    void *inbox = hg_arena_alloc(&d->inbox, bytes);
    if (!inbox) return HG_MEMORY;
    HG_TRY(hg_cuda_stage(d, (CUdeviceptr)(uintptr_t)inbox, from, bytes));
    move *kept = hg_cuda_keep(d, move_now, sizeof *kept);
    if (!kept) return HG_MEMORY;
    kept->to = (CUdeviceptr)(uintptr_t)to;
    kept->from = (CUdeviceptr)(uintptr_t)inbox;
    kept->bytes = bytes;
    return HG_OK;
}

static hg_status wait(hg_device *device)
{
    hg_cuda_device *d = of(device);
    HG_TRY(hg_cuda_enter(d));
    if (d->recording) d->device.counts.waits++;
    HG_TRY(hg_cuda_flush(d));
    return hg_cuda_wait(d);
}

static hg_status download(hg_device *device, void *to, const void *from, size_t bytes)
{
    hg_cuda_device *d = of(device);
    HG_TRY(hg_cuda_enter(d));
    HG_TRY(hg_cuda_flush(d));
    if (d->recording) d->device.counts.waits++;
    d->device.counts.downloaded += (int64_t)bytes;
    HG_TRY(hg_cuda_check(d->api, d->api->cuMemcpyDtoHAsync(to, (CUdeviceptr)(uintptr_t)from, bytes, d->stream),
                         "a copy from the device"));
    return hg_cuda_wait(d);
}

/* ---- kernels ---- */

/* The kernel's own arguments stand behind it. */
typedef struct {
    CUfunction function;
    const char *name;
    int64_t n;
    unsigned blocks, threads, shared, unused[3]; /* a multiple of 16 bytes, no padding */
} launch_head;

static hg_status launch_now(hg_cuda_device *d, const void *args)
{
    const launch_head *l = args;
    int64_t n = l->n;
    void *params[] = { (void *)(uintptr_t)(l + 1), &n };
    return hg_cuda_check(
        d->api,
        d->api->cuLaunchKernel(l->function, l->blocks, 1, 1, l->threads, 1, 1, l->shared, d->stream, params, NULL),
        l->name);
}

static hg_status launch(hg_device *device, int threads, const hg_kernel *kernel, int64_t n, const void *args)
{
    hg_cuda_device *d = of(device);
    (void)threads;
    launch_head l = { .name = kernel->name, .n = n };
    HG_TRY(hg_cuda_enter(d));
    HG_TRY(hg_cuda_function(d, kernel, &l.function));
    const int64_t per_block = kernel->threads ? kernel->threads : 256;
    const int64_t indices = kernel->indices ? kernel->indices : per_block;
    int64_t blocks = (n + indices - 1) / indices,
            most = kernel->indices ? 0x7fffffff : 32 * (int64_t)d->multiprocessors;
    if (blocks > most) blocks = most; /* kernels stride over the rest */
    l.blocks = (unsigned)blocks;
    l.threads = (unsigned)per_block;
    l.shared = (unsigned)kernel->shared;
    d->device.counts.launches++;
    d->last = kernel->name;
    d->since++;
    launch_head *kept = hg_cuda_keep(d, launch_now, sizeof l + kernel->args_size);
    if (!kept) return HG_MEMORY;
    *kept = l;
    memcpy(kept + 1, args, kernel->args_size);
    if (kernel->clear) kernel->clear(kept + 1);
    if (d->recording) return HG_OK;
    d->calls_size = 0;
    return launch_now(d, kept);
}

static bool launches(const hg_device *device, const hg_kernel *kernel)
{
    return (void)device, hg_cuda_has_function(kernel);
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
    if (d->context) {
        hg_cuda_enter(d);
        d->calls_size = 0; /* nobody waits for it */
        if (d->stream) d->api->cuStreamSynchronize(d->stream);
        hg_cuda_graphs_free(d);
        hg_cuda_staging_free(d);
        hg_cuda_modules_free(d);
        hg_cuda_convolutions_free(d);
        if (d->blas) d->api->cublasDestroy(d->blas);
        if (d->blas_workspace) d->api->cuMemFree(d->blas_workspace);
        if (d->stream) d->api->cuStreamDestroy(d->stream);
        d->api->cuDevicePrimaryCtxRelease(d->number);
    }
    hg_free(d);
}

/* "NVIDIA A100, compute capability 8.0" */
static void describe(const hg_cuda_api *api, CUdevice device, char *text, size_t size)
{
    char name[96] = "";
    int major = 0, minor = 0;
    api->cuDeviceGetName(name, sizeof name, device);
    api->cuDeviceGetAttribute(&major, CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR, device);
    api->cuDeviceGetAttribute(&minor, CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR, device);
    snprintf(text, size, "%s, compute capability %d.%d", name, major, minor);
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
    api->cuDeviceGetAttribute(&d->major, CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR, d->number);
    api->cuDeviceGetAttribute(&d->minor, CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR, d->number);
    api->cuDeviceGetAttribute(&d->multiprocessors, CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT, d->number);
    describe(api, d->number, d->device.what, sizeof d->device.what);
    HG_TRY(hg_cuda_check(api, api->cuDevicePrimaryCtxRetain(&d->context, d->number), "the context of the device"));
    HG_TRY(hg_cuda_enter(d));
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
                                       .product_workspace = hg_cuda_product_workspace,
                                       .product = hg_cuda_product,
                                       .convolve_workspace = hg_cuda_convolve_workspace,
                                       .convolve = hg_cuda_convolve,
                                       .compute = compute,
                                       .record = hg_cuda_record,
                                       .run = hg_cuda_run } };
    d->inbox.device = &d->device;
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
    int count = 0;
    if (hg_cuda_library(&api) != HG_OK) {
        if (room > 0) {
            infos[0] = (hg_device_info){ .name = "cuda" };
            snprintf(infos[0].why, sizeof infos[0].why, "%s", hg_cuda_refusal());
        }
        return 1;
    }
    const hg_cuda_dnn_api *dnn;
    char cudnn[64] = "no cuDNN, which convolutions need";
    if (room > 0 && hg_cuda_dnn_library(&dnn) == HG_OK)
        snprintf(cudnn, sizeof cudnn, "cuDNN %d.%d", (int)(dnn->cudnnGetVersion() / 10000),
                 (int)(dnn->cudnnGetVersion() / 100 % 100));
    api->cuDeviceGetCount(&count);
    for (int i = 0; i < count && i < room; i++) {
        hg_device_info *info = &infos[i];
        CUdevice device = 0;
        *info = (hg_device_info){ .name = "cuda" };
        if (count > 1) snprintf(info->name, sizeof info->name, "cuda:%d", i % 1000); /* there are not so many */
        api->cuDeviceGet(&device, i);
        api->cuDeviceTotalMem(&info->memory, device);
        describe(api, device, info->what, sizeof info->what);
        snprintf(info->versions, sizeof info->versions, "driver for CUDA %d.%d, NVRTC %d.%d, cuBLAS %d.%d, %s",
                 api->driver_version / 1000, api->driver_version % 1000 / 10, api->nvrtc_major, api->nvrtc_minor,
                 api->blas_major, api->blas_minor, cudnn);
    }
    return count;
}
