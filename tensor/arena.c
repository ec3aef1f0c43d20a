/* The step arena; see arena.h. */
#include "tensor/arena.h"

#include <stdint.h>
#include <string.h>

/* Under the address sanitizer what is not allocated cannot be touched: use after a reset is found at once. */
#if defined(__SANITIZE_ADDRESS__)
#define HG_POISON 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
#define HG_POISON 1
#endif
#endif
#ifdef HG_POISON
#include <sanitizer/asan_interface.h>
static void close_memory(const hg_arena *arena, void *memory, size_t size)
{
    if (arena->device->host) __asan_poison_memory_region(memory, size);
}
static void open_memory(const hg_arena *arena, void *memory, size_t size)
{
    if (arena->device->host) __asan_unpoison_memory_region(memory, size);
}
enum { REDZONE = HG_ALIGNMENT };
#else
static void close_memory(const hg_arena *arena, void *memory, size_t size) { (void)arena, (void)memory, (void)size; }
static void open_memory(const hg_arena *arena, void *memory, size_t size) { (void)arena, (void)memory, (void)size; }
enum { REDZONE = 0 };
#endif

enum { GUARD = HG_ALIGNMENT, PATTERN = 0xA5, FIRST_CHUNK = 1 << 20 };

static void free_chunks(hg_arena *arena)
{
    for (int i = 0; i < arena->n_chunks; i++) {
        open_memory(arena, arena->chunks[i].memory, arena->chunks[i].size);
        arena->device->free(arena->device, arena->chunks[i].memory);
    }
    hg_free(arena->chunks);
    arena->chunks = NULL;
    arena->n_chunks = arena->current = 0;
    arena->reserved = 0;
}

static bool add_chunk(hg_arena *arena, size_t size)
{
    hg_arena_chunk *chunks =
        hg_resize(arena->chunks, (size_t)arena->n_chunks, (size_t)arena->n_chunks + 1, sizeof *chunks);
    if (!chunks) return false;
    arena->chunks = chunks;
    unsigned char *memory = arena->device->alloc(arena->device, size);
    if (!memory) return false;
    chunks[arena->n_chunks++] = (hg_arena_chunk){ .memory = memory, .size = size };
    arena->reserved += size;
    close_memory(arena, memory, size);
    return true;
}

/* Guards are host patterns: [size, pattern ...] [the allocation] [pattern ...]. */
static unsigned char *guarded(unsigned char *memory, size_t bytes)
{
    memset(memory, PATTERN, GUARD);
    memcpy(memory, &bytes, sizeof bytes);
    memset(memory + GUARD + bytes, PATTERN, GUARD);
    return memory + GUARD;
}

void *hg_arena_alloc(hg_arena *arena, size_t bytes)
{
    if (bytes > SIZE_MAX / 4) return NULL;
    bytes = (bytes + HG_ALIGNMENT - 1) / HG_ALIGNMENT * HG_ALIGNMENT;
    if (bytes == 0) bytes = HG_ALIGNMENT; /* so that an empty tensor has a pointer */
    size_t whole = bytes + (arena->guard ? 2 * GUARD : 0) + REDZONE;
    for (;;) {
        if (arena->current < arena->n_chunks) {
            hg_arena_chunk *chunk = &arena->chunks[arena->current];
            if (chunk->size - chunk->used >= whole) {
                unsigned char *memory = chunk->memory + chunk->used;
                chunk->used += whole;
                arena->bytes += whole;
                if (arena->bytes > arena->high_water) arena->high_water = arena->bytes;
                open_memory(arena, memory, whole - REDZONE);
                return arena->guard ? guarded(memory, bytes) : memory;
            }
            if (arena->current + 1 < arena->n_chunks) {
                arena->current++;
                continue;
            }
        }
        /* Doubling: few chunks in the first step, one afterwards. */
        size_t size = whole > FIRST_CHUNK ? whole : FIRST_CHUNK;
        if (size < arena->reserved) size = arena->reserved;
        if (!add_chunk(arena, size) && (size == whole || !add_chunk(arena, whole))) return NULL;
        arena->current = arena->n_chunks - 1;
    }
}

void hg_arena_rewind(hg_arena *arena, int chunk, size_t used)
{
    for (int i = arena->current; i >= chunk && i >= 0 && i < arena->n_chunks; i--) {
        hg_arena_chunk *c = &arena->chunks[i];
        size_t keep = i == chunk ? used : 0;
        close_memory(arena, c->memory + keep, c->used - keep);
        arena->bytes -= c->used - keep;
        c->used = keep;
    }
    arena->current = chunk;
}

void hg_arena_reset(hg_arena *arena, bool guard)
{
    hg_arena_rewind(arena, 0, 0);
    if (arena->n_chunks > 1) {
        free_chunks(arena);
        /* One chunk has no gaps, so the most ever in use is enough. When this fails the next allocation reports. */
        add_chunk(arena, arena->high_water);
    }
    arena->guard = guard && arena->device->host;
}

bool hg_arena_intact(const hg_arena *arena)
{
    if (!arena->guard) return true;
    for (int i = 0; i < arena->n_chunks; i++) {
        const hg_arena_chunk *chunk = &arena->chunks[i];
        for (size_t at = 0; at < chunk->used;) {
            const unsigned char *memory = chunk->memory + at;
            size_t bytes;
            memcpy(&bytes, memory, sizeof bytes);
            if (bytes > chunk->used - at - 2 * GUARD) return false;
            for (size_t j = sizeof bytes; j < GUARD; j++)
                if (memory[j] != PATTERN) return false;
            for (size_t j = 0; j < GUARD; j++)
                if (memory[GUARD + bytes + j] != PATTERN) return false;
            at += bytes + 2 * GUARD + REDZONE;
        }
    }
    return true;
}

void hg_arena_free(hg_arena *arena)
{
    free_chunks(arena);
    *arena = (hg_arena){ .device = arena->device };
}
