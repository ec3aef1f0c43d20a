/* How the emulated cuBLAS and cuDNN put their work on a stream of the emulated driver: a call with a copy of its arguments, which
 * runs when the stream comes to it (or is recorded while the stream is captured, and runs at every launch of the graph).
 *
 *     struct product { int m, n, k; const float *a, *b; float *c; };           pointers to device memory, scalars by value
 *     static void run_product(const void *bytes) { const product *p = (const product *)bytes; ... }
 *     return emulator_enqueue(stream, "cublasGemmEx", run_product, &args, sizeof args) == 0 ? 0 : 13;
 *
 * Device memory can be touched inside of the call alone, and by the thread that it runs on alone (OpenMP is held to one thread
 * there). The call may not use CUDA. The stream is what cublasSetStream was given. Returns a CUresult. */
#ifndef EMULATOR_ENQUEUE_H
#define EMULATOR_ENQUEUE_H

#include <dlfcn.h>
#include <stddef.h>

typedef int (*emulator_enqueue_function)(void *stream, const char *name, void (*call)(const void *bytes), const void *bytes, size_t size);

static inline int emulator_enqueue(void *stream, const char *name, void (*call)(const void *bytes), const void *bytes, size_t size)
{
    static emulator_enqueue_function enqueue;
    if (!enqueue)
        if (void *driver = dlopen("libcuda.so.1", RTLD_LAZY | RTLD_NOLOAD)) enqueue = (emulator_enqueue_function)dlsym(driver, "emulator_enqueue");
    return enqueue ? enqueue(stream, name, call, bytes, size) : 999;
}

#endif
