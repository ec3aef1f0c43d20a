/* Checked, zeroed and aligned memory. A request beyond the memory of the machine fails with a sentence instead of
 * letting the system end the process later: such a request is nearly always a wrong count. */
#include "base/base.h"

#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { alignment = 64 };

static bool fits(size_t count, size_t size, size_t *bytes)
{
    if (__builtin_mul_overflow(count, size, bytes) || *bytes > SIZE_MAX / 2 - alignment) {
        hg_fail(HG_MEMORY, "memory: %zu elements of %zu bytes are more than an address can name", count, size);
        return false;
    }
    long pages = sysconf(_SC_PHYS_PAGES), page = sysconf(_SC_PAGESIZE);
    if (pages > 0 && page > 0 && *bytes / (size_t)page > (size_t)pages) {
        hg_fail(HG_MEMORY, "memory: %.1f GB were asked for at once, this machine has %.1f GB", (double)*bytes * 1e-9,
                (double)pages * (double)page * 1e-9);
        return false;
    }
    *bytes = (*bytes + alignment - 1) / alignment * alignment;
    if (*bytes == 0) *bytes = alignment;
    return true;
}

static atomic_llong taken;

int64_t hg_alloc_count(void) { return (int64_t)atomic_load_explicit(&taken, memory_order_relaxed); }

static void *take(size_t bytes)
{
    atomic_fetch_add_explicit(&taken, 1, memory_order_relaxed);
    void *memory = aligned_alloc(alignment, bytes);
    if (memory == NULL) hg_fail(HG_MEMORY, "memory: the system has no %.1f MB left", (double)bytes * 1e-6);
    return memory;
}

void *hg_alloc(size_t count, size_t size)
{
    size_t bytes;
    if (!fits(count, size, &bytes)) return NULL;
    void *memory = take(bytes);
    if (memory != NULL) memset(memory, 0, bytes);
    return memory;
}

void *hg_resize(void *old, size_t old_count, size_t count, size_t size)
{
    size_t bytes;
    if (!fits(count, size, &bytes)) return NULL;
    void *memory = take(bytes);
    if (memory == NULL) return NULL;
    size_t kept = old == NULL ? 0 : (old_count < count ? old_count : count) * size;
    if (kept > 0) memcpy(memory, old, kept);
    memset((char *)memory + kept, 0, bytes - kept);
    free(old);
    return memory;
}

void hg_free(void *memory) { free(memory); }
