/* What the emulated cuBLAS and cuDNN take of the emulated driver beside its streams: memory, as the real ones do when a handle
 * is made, so that a handle that is made while a stream is captured, or that is never destroyed, is found. */
#ifndef EMULATOR_LIBRARY_H
#define EMULATOR_LIBRARY_H

#include <dlfcn.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

[[noreturn]] static inline void emulator_stop(const char *what)
{
    fprintf(stderr, "emulator: %s\n", what);
    abort();
}

template <class F> static inline F emulator_driver(const char *name)
{
    void *driver = dlopen("libcuda.so.1", RTLD_LAZY | RTLD_NOLOAD), *symbol = driver ? dlsym(driver, name) : nullptr;
    if (!symbol) emulator_stop("a library of CUDA is used without the emulated driver");
    return (F)symbol;
}

static inline int emulator_alloc(unsigned long long *memory, size_t bytes)
{
    return emulator_driver<int (*)(unsigned long long *, size_t)>("cuMemAlloc_v2")(memory, bytes);
}

static inline int emulator_free(unsigned long long memory)
{
    return emulator_driver<int (*)(unsigned long long)>("cuMemFree_v2")(memory);
}

#endif
