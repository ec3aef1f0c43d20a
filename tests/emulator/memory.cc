/* The device's memory: one region of addresses, which nobody may touch but kernels, copies and the emulated libraries while they
 * run (a protection key of the processor; where it has none the pages are opened and closed). Every allocation ends where a page
 * begins that is never open, fresh memory is full of NaN, and an address is not given twice. */
#include "emulator.h"

#include <errno.h>
#include <stdio.h>
#include <sys/mman.h>
#include <unistd.h>

namespace emulated
{
namespace
{
enum { ALIGNMENT = 256 };
constexpr size_t REGION = (size_t)1 << 38;
uintptr_t region, region_used;
std::map<uintptr_t, size_t> &allocations = *new std::map<uintptr_t, size_t>; /* of the device, by where they begin; never destroyed */
struct freed_piece {
    uintptr_t begin, end;
};
std::vector<freed_piece> &freed = *new std::vector<freed_piece>; /* the last ones, for messages */
std::map<uintptr_t, size_t> &pinned = *new std::map<uintptr_t, size_t>;
size_t in_use;
int key = -1;
thread_local int depth;
int open_threads; /* without keys */

size_t pages(size_t bytes) { return (bytes + PAGE - 1) / PAGE * PAGE; }
size_t total()
{
    const char *text = getenv("EMULATOR_MEMORY");
    return text ? (size_t)strtoull(text, nullptr, 10) : (size_t)8 << 30;
}

void make_region()
{
    if (region) return;
    void *memory = mmap(nullptr, REGION, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (memory == MAP_FAILED) stop("no room for %zu bytes of addresses", REGION);
    region = (uintptr_t)memory;
    region_used = PAGE;
#ifdef PKEY_DISABLE_ACCESS
    if (!setting("EMULATOR_NO_KEYS")) key = pkey_alloc(0, PKEY_DISABLE_ACCESS);
#endif
}

/* NaN in all of it. Large ones share one piece until they are written to: most of a workspace never is. */
bool spoil(uintptr_t begin, size_t size)
{
    enum { PIECE = 1 << 20 };
    static int file = -1;
    if (size >= 4 * (size_t)PIECE && file < 0) {
        file = memfd_create("emulated-memory", MFD_CLOEXEC);
        const std::string piece(PIECE, '\xff');
        if (file < 0 || write(file, piece.data(), PIECE) != PIECE) stop("no memory for %d bytes", (int)PIECE);
    }
    const size_t shared = size >= 4 * (size_t)PIECE ? size / PIECE * PIECE : 0;
    for (size_t at = 0; at < shared; at += PIECE)
        if (mmap((void *)(begin + at), PIECE, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_FIXED, file, 0) == MAP_FAILED) return false;
    if (mprotect((void *)(begin + shared), size - shared, PROT_READ | PROT_WRITE) != 0) return false;
    memset((void *)(begin + shared), 0xff, size - shared);
    return true;
}

void protect_all(int protection)
{
    for (const auto &a : allocations) mprotect((void *)(a.first / PAGE * PAGE), pages(a.second), protection);
}
} // namespace

memory_rights::memory_rights()
{
    if (depth++) return;
#ifdef PKEY_DISABLE_ACCESS
    if (key >= 0) {
        pkey_set(key, 0);
        return;
    }
#endif
    if (open_threads++ == 0) protect_all(PROT_READ | PROT_WRITE);
}

memory_rights::~memory_rights()
{
    if (--depth) return;
#ifdef PKEY_DISABLE_ACCESS
    if (key >= 0) {
        pkey_set(key, PKEY_DISABLE_ACCESS);
        return;
    }
#endif
    if (--open_threads == 0) protect_all(PROT_NONE);
}

bool in_device_region(uintptr_t at) { return region && at - region < REGION; }

uintptr_t device_region(size_t *size)
{
    if (size) *size = REGION;
    return region;
}

allocation find_device(uintptr_t at)
{
    auto after = allocations.upper_bound(at);
    if (after == allocations.begin()) return { 0, 0 };
    --after;
    if (at >= after->first + after->second) return { 0, 0 };
    return { after->first, after->first + after->second };
}

std::string describe_address(uintptr_t at)
{
    char text[200];
    if (const allocation a = find_device(at); a.end) {
        snprintf(text, sizeof text, "byte %zu of an allocation of %zu bytes on the device", (size_t)(at - a.begin), (size_t)(a.end - a.begin));
    } else if (in_device_region(at)) {
        for (size_t i = freed.size(); i-- > 0;)
            if (at >= freed[i].begin && at < freed[i].end) {
                snprintf(text, sizeof text, "byte %zu of %zu bytes of device memory that were freed", (size_t)(at - freed[i].begin), (size_t)(freed[i].end - freed[i].begin));
                return text;
            }
        auto after = allocations.upper_bound(at);
        if (after == allocations.begin()) return "before all allocations on the device";
        --after;
        const size_t past = at - after->first - after->second;
        snprintf(text, sizeof text, "%zu bytes after the end of an allocation of %zu bytes on the device", past, after->second);
    } else if (at < PAGE) {
        return "a NULL pointer";
    } else if (in_pinned(at, 1)) {
        return "pinned memory of the host";
    } else if (~at < PAGE) {
        return "a pointer made of uninitialised memory";
    } else {
        return mapped_on_host(at) ? "memory of the host" : "no memory at all";
    }
    return text;
}

int allocate_device(uintptr_t *out, size_t size)
{
    make_region();
    if (size == 0) return refuse(INVALID_VALUE, "cuMemAlloc of 0 bytes");
    if (size > total() || in_use > total() - size) return OUT_OF_MEMORY;
    const size_t whole = pages(size) + PAGE;
    if (whole > REGION - region_used) stop("all addresses have been used up: %zu bytes", REGION);
    const uintptr_t begin = region + region_used, at = begin + (pages(size) - size) / ALIGNMENT * ALIGNMENT;
    if (!spoil(begin, pages(size))) return OUT_OF_MEMORY;
    region_used += whole;
#ifdef PKEY_DISABLE_ACCESS
    if (key >= 0) pkey_mprotect((void *)begin, pages(size), PROT_READ | PROT_WRITE, key);
#endif
    if (key < 0 && open_threads == 0) mprotect((void *)begin, pages(size), PROT_NONE);
    allocations[at] = size;
    in_use += size;
    *out = at;
    return SUCCESS;
}

void free_device(uintptr_t at)
{
    if (at == 0) return;
    auto found = allocations.find(at);
    if (found == allocations.end()) stop("cuMemFree of %#zx, which cuMemAlloc did not give: %s", (size_t)at, describe_address(at).c_str());
    const size_t size = found->second;
    if (mmap((void *)(at / PAGE * PAGE), pages(size), PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE | MAP_FIXED, -1, 0) == MAP_FAILED) stop("a piece of memory could not be freed");
    if (freed.size() >= 64) freed.erase(freed.begin());
    freed.push_back({ at, at + size });
    check_freed(at, size);
    in_use -= size;
    allocations.erase(found);
}

size_t forget_device()
{
    const size_t left = allocations.size();
    while (!allocations.empty()) free_device(allocations.begin()->first);
    return left;
}

void memory_figures(size_t *free, size_t *all)
{
    *all = total();
    *free = *all - in_use;
}

void *allocate_pinned(size_t size)
{
    if (size == 0) return nullptr;
    char *all = (char *)mmap(nullptr, pages(size) + PAGE, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (all == MAP_FAILED) return nullptr;
    mprotect(all + pages(size), PAGE, PROT_NONE);
    memset(all, 0xff, pages(size));
    char *at = all + (pages(size) - size) / ALIGNMENT * ALIGNMENT;
    pinned[(uintptr_t)at] = size;
    return at;
}

void free_pinned(void *at)
{
    auto found = pinned.find((uintptr_t)at);
    if (found == pinned.end()) stop("cuMemFreeHost of %p, which cuMemAllocHost did not give", at);
    munmap((void *)((uintptr_t)at / PAGE * PAGE), pages(found->second) + PAGE);
    pinned.erase(found);
}

bool in_pinned(uintptr_t at, size_t size)
{
    auto after = pinned.upper_bound(at);
    if (after == pinned.begin()) return false;
    --after;
    return at + size <= after->first + after->second;
}

char *dynamic_shared(size_t size)
{
    static char *memory;
    const size_t room = pages(SHARED_MOST);
    if (!memory) {
        memory = (char *)mmap(nullptr, room + 2 * PAGE, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
        if (memory == MAP_FAILED) stop("no memory for the shared memory of a block");
        mprotect(memory + PAGE, room, PROT_READ | PROT_WRITE);
    }
    return memory + PAGE + room - size;
}

bool mapped_on_host(uintptr_t at)
{
    unsigned char resident;
    return mincore((void *)(at / PAGE * PAGE), PAGE, &resident) == 0 || errno != ENOMEM;
}
} // namespace emulated
