/* Opening CUDA's libraries and filling the tables of api.h. */
#include "tensor/cuda/api.h"

#include <dlfcn.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>

static hg_cuda_api table;
static hg_status table_status;
static char table_message[256];

static void *open_first(const char *const *names)
{
    void *library = NULL;
    for (int i = 0; names[i] && !library; i++) library = dlopen(names[i], RTLD_NOW | RTLD_LOCAL);
    return library;
}

static hg_status refuse(const char *format, const char *what)
{
    snprintf(table_message, sizeof table_message, format, what);
    return HG_UNSUPPORTED;
}

#define TAKE(field_, symbol_, result_, arguments_)                                                                     \
    *(void **)(void *)&table.field_ = dlsym(library, symbol_);                                                         \
    if (!table.field_) return refuse("%s is missing: the driver or toolkit is older than CUDA 12.4", symbol_);

static hg_status take_driver(void)
{
    static const char *const names[] = { "libcuda.so.1", NULL };
    void *library = open_first(names);
    if (!library) return refuse("there is no NVIDIA driver here (%s was not found)", names[0]);
    HG_CUDA_DRIVER(TAKE)
    CUresult result = table.cuInit(0);
    const char *name = NULL;
    if (result != CUDA_SUCCESS) {
        table.cuGetErrorName(result, &name);
        return refuse("the NVIDIA driver found no GPU that it can use (cuInit: %s)", name ? name : "unknown error");
    }
    table.cuDriverGetVersion(&table.driver_version);
    return HG_OK;
}

static hg_status take_nvrtc(void)
{
    static const char *const names[] = { "libnvrtc.so.13", "libnvrtc.so.12", "libnvrtc.so", NULL };
    void *library = open_first(names);
    if (!library) return refuse("the run-time compiler of CUDA is missing (%s or .12): install cuda-nvrtc", names[0]);
    HG_CUDA_NVRTC(TAKE)
    table.nvrtcVersion(&table.nvrtc_major, &table.nvrtc_minor);
    return HG_OK;
}

static hg_status take_blas(void)
{
    static const char *const names[] = { "libcublas.so.13", "libcublas.so.12", "libcublas.so", NULL };
    void *library = open_first(names);
    if (!library) return refuse("cuBLAS is missing (%s or .12): install libcublas", names[0]);
    HG_CUDA_BLAS(TAKE)
    return HG_OK;
}

static void open_all(void)
{
    table_status = take_driver();
    if (table_status == HG_OK) table_status = take_nvrtc();
    if (table_status == HG_OK) table_status = take_blas();
}

hg_status hg_cuda_library(const hg_cuda_api **api)
{
    static pthread_once_t once = PTHREAD_ONCE_INIT;
    pthread_once(&once, open_all);
    *api = &table;
    return table_status == HG_OK ? HG_OK : hg_fail(table_status, "cuda: %s", table_message);
}

hg_status hg_cuda_check(const hg_cuda_api *api, CUresult result, const char *what)
{
    if (result == CUDA_SUCCESS) return HG_OK;
    const char *name = NULL, *words = NULL;
    api->cuGetErrorName(result, &name);
    api->cuGetErrorString(result, &words);
    return hg_fail(result == CUDA_ERROR_OUT_OF_MEMORY ? HG_MEMORY : HG_NUMERIC, "cuda: %s: %s (%s)", what,
                   name ? name : "an unknown error", words ? words : "no description");
}
