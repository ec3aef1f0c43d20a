/* The context as tensor/ sees it. */
#ifndef HG_TENSOR_CONTEXT_H
#define HG_TENSOR_CONTEXT_H

#include "tensor/arena.h"

enum { HG_HOOKS = 8, HG_CTX_MESSAGE = 1024 };

struct hg_ctx {
    hg_device *device;
    int threads;
    uint64_t seed;
    hg_dtype compute;
    /* Two arenas: descriptors and host scratch are always host memory, tensor data is the device's. */
    hg_arena host, data;
    bool guard;
    void *tape;
    hg_ctx *beside;      /* hg_ctx_on_host, of a device that is not the host; NULL: not made yet */
    hg_profile *profile; /* NULL: nothing is counted */
    const char *file;
    int line;
    hg_status status;
    char message[HG_CTX_MESSAGE];
    void (*on_reset[HG_HOOKS])(hg_ctx *);
    void (*on_destroy[HG_HOOKS])(hg_ctx *);
    void (*on_tensor_destroy[HG_HOOKS])(hg_tensor *);
};

#endif
