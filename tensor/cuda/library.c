/* Opening CUDA's libraries and filling the tables of api.h. */
#include "tensor/cuda/api.h"

#include <dlfcn.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static hg_cuda_api table;
static hg_status table_status;
static char table_message[256];

/* "NAME.so.MAJOR", where the system finds it, else in the toolkit's own folder. */
static void *open_major(const char *name, int major)
{
    const char *const homes[] = { NULL, getenv("CUDA_HOME"), getenv("CUDA_PATH"), "/usr/local/cuda" };
    void *library = NULL;
    for (size_t i = 0; i < sizeof homes / sizeof *homes && !library; i++) {
        char path[4096];
        if (i > 0 && !homes[i]) continue;
        const int length =
            snprintf(path, sizeof path, "%s%s%s.so.%d", i ? homes[i] : "", i ? "/lib64/" : "", name, major);
        if (length > 0 && (size_t)length < sizeof path) library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    }
    return library;
}

/* One of a newer major version than the driver's makes what that cannot load. */
enum { NEWEST = 13, OLDEST = 12, DNN = 9 };
static int newest(void) { return table.driver_version / 1000 < NEWEST ? table.driver_version / 1000 : NEWEST; }
static void *open_toolkit(const char *name)
{
    void *library = NULL;
    for (int major = newest(); major >= OLDEST && !library; major--) library = open_major(name, major);
    return library;
}

static hg_status refuse(const char *format, ...) HG_PRINTF(1, 2);
static hg_status refuse(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(table_message, sizeof table_message, format, arguments);
    va_end(arguments);
    return HG_UNSUPPORTED;
}

#define TAKE(field_, symbol_, result_, arguments_)                                                                     \
    *(void **)(void *)&table.field_ = dlsym(library, symbol_);                                                         \
    if (!table.field_) return refuse("%s is missing in what was found of CUDA: version 12 or later is needed", symbol_);

static hg_status take_driver(void)
{
    void *library = dlopen("libcuda.so.1", RTLD_NOW | RTLD_LOCAL);
    if (!library) return refuse("there is no NVIDIA driver here (libcuda.so.1 was not found)");
    *(void **)(void *)&table.cuDriverGetVersion = dlsym(library, "cuDriverGetVersion"); /* an old one says so itself */
    if (table.cuDriverGetVersion) table.cuDriverGetVersion(&table.driver_version);
    if (table.driver_version < 12000)
        return refuse("the NVIDIA driver is for CUDA %d.%d: one for 12.0 or later is needed",
                      table.driver_version / 1000, table.driver_version % 1000 / 10);
    HG_CUDA_DRIVER(TAKE)
    CUresult result = table.cuInit(0);
    const char *name = NULL;
    if (result != CUDA_SUCCESS) {
        table.cuGetErrorName(result, &name);
        return refuse("the NVIDIA driver found no GPU that it can use (cuInit: %s)", name ? name : "unknown error");
    }
    return HG_OK;
}

static hg_status take_nvrtc(void)
{
    void *library = open_toolkit("libnvrtc");
    if (!library)
        return refuse("CUDA's compiler at run time, libnvrtc.so.%d, is missing: install cuda-nvrtc of CUDA %d",
                      newest(), newest());
    HG_CUDA_NVRTC(TAKE)
    table.nvrtcVersion(&table.nvrtc_major, &table.nvrtc_minor);
    return HG_OK;
}

static hg_status take_blas(void)
{
    void *library = open_toolkit("libcublas");
    if (!library)
        return refuse("cuBLAS, libcublas.so.%d, is missing: install libcublas of CUDA %d", newest(), newest());
    HG_CUDA_BLAS(TAKE)
    table.cublasGetProperty(MAJOR_VERSION, &table.blas_major);
    table.cublasGetProperty(MINOR_VERSION, &table.blas_minor);
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

const char *hg_cuda_refusal(void) { return table_message; }

static hg_cuda_dnn_api dnn_table;
static char dnn_message[256];

static void open_dnn(void)
{
    void *library = open_major("libcudnn", DNN);
    if (!library)
        snprintf(dnn_message, sizeof dnn_message,
                 "convolutions need cuDNN 9, libcudnn.so.9, which is missing: install it, or use the cpu");
#define TAKE_DNN(field_, symbol_, result_, arguments_)                                                                 \
    if (!dnn_message[0]) *(void **)(void *)&dnn_table.field_ = dlsym(library, symbol_);                                \
    if (!dnn_message[0] && !dnn_table.field_)                                                                          \
        snprintf(dnn_message, sizeof dnn_message,                                                                      \
                 "%s is missing in the libcudnn.so.9 that was found: cuDNN 9 is needed", symbol_);
    HG_CUDA_DNN(TAKE_DNN)
}

hg_status hg_cuda_dnn_library(const hg_cuda_dnn_api **api)
{
    static pthread_once_t once = PTHREAD_ONCE_INIT;
    pthread_once(&once, open_dnn);
    *api = &dnn_table;
    return dnn_message[0] ? hg_fail(HG_UNSUPPORTED, "cuda: %s", dnn_message) : HG_OK;
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
