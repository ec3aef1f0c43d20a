/* The step arena: bump allocation in chunks that are kept from step to step. When a step needed more than one chunk,
 * the next one starts with a single chunk of the most ever in use: the steady state takes nothing from the system. */
#ifndef HG_TENSOR_ARENA_H
#define HG_TENSOR_ARENA_H

#include "tensor/device.h"

#define HG_ALIGNMENT 64

typedef struct {
    unsigned char *memory;
    size_t size, used;
} hg_arena_chunk;

typedef struct {
    hg_device *device;
    hg_arena_chunk *chunks;
    int n_chunks, current;
    bool guard;
    size_t bytes, high_water, reserved;
} hg_arena;

void *hg_arena_alloc(hg_arena *arena, size_t bytes); /* NULL when the system has no more */
void hg_arena_reset(hg_arena *arena, bool guard);
void hg_arena_rewind(hg_arena *arena, int chunk, size_t used);
bool hg_arena_intact(const hg_arena *arena); /* true without guards */
void hg_arena_free(hg_arena *arena);

#endif
