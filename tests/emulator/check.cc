/* Checks of every access of a kernel that was compiled with EMULATOR_CHECK=1: the compiler's thread sanitizer puts a call before
 * each access, and these are the functions that it calls. An access is to an allocation of the device, to the shared memory of the
 * block, or to what is the thread's own; it is aligned; shared memory was written before it is read; and no two threads touch the
 * same bytes, one of them writing, unless a barrier (or __syncwarp, or both being atomic) puts one before the other. */
#include "emulator.h"

#include <stdio.h>
#include <sys/mman.h>

namespace emulated
{
namespace
{
/* What is known of 4 bytes. Times are serial numbers that grow at each launch, block and barrier; clocks count the __syncwarps. */
struct cell {
    uint32_t write_time, write_clock, write_code;
    uint32_t read_time, read_clock, read_code, read_lanes;
    uint16_t write_thread, read_warp;
    uint8_t write_bytes, read_bytes, atomic, several;
};
enum { SEVERAL_WARPS = 1, SEVERAL_BLOCKS = 2 };

uint32_t now, launch_began, block_began;
uint32_t clocks[MOST_THREADS][WARP]; /* the newest clock of each lane of its warp that a thread comes after; its own at its lane */

cell *device_cells;
uintptr_t device_base;
std::vector<cell> &fixed_cells = *new std::vector<cell>, &dynamic_cells = *new std::vector<cell>;
uintptr_t fixed_begin, fixed_end, dynamic_begin, dynamic_end;
allocation last = { 0, 0 };

struct access {
    uintptr_t at;
    size_t size;
    bool write, atomic;
    const void *code;
};

const char *verb(const access &a) { return a.atomic ? "changes (atomically)" : a.write ? "writes" : "reads"; }

[[noreturn]] void race(const access &a, const cell &c, bool with_write)
{
    const uint32_t time = with_write ? c.write_time : c.read_time;
    char who[80];
    std::string where = a.at >= fixed_begin && a.at < fixed_end ? "byte " + std::to_string(a.at - fixed_begin) + " of shared memory" : a.at >= dynamic_begin && a.at < dynamic_end ? "byte " + std::to_string(a.at - dynamic_begin) + " of dynamic shared memory" : describe_address(a.at);
    if (time < block_began || (!with_write && (c.several & SEVERAL_BLOCKS))) snprintf(who, sizeof who, "another block");
    else if (with_write) snprintf(who, sizeof who, "%s", thread_name(c.write_thread).c_str());
    else if (c.several) snprintf(who, sizeof who, "several warps");
    else snprintf(who, sizeof who, "%s of this block", thread_name(c.read_warp * WARP + __builtin_ctz(c.read_lanes & ~(c.read_warp == current / WARP ? 1u << current % WARP : 0u))).c_str());
    const uintptr_t other = running->what->home->begin + (with_write ? c.write_code : c.read_code);
    stop_at(a.code, "race: it %s %zu bytes at %s, which %s %s (at %s) with no barrier between", verb(a), a.size, where.c_str(), who,
            with_write ? (c.atomic ? "changed atomically" : "wrote") : "read", line_of((const void *)other).c_str());
}

bool before_me(uint32_t lanes, uint32_t clock, const uint32_t *mine)
{
    for (; lanes; lanes &= lanes - 1)
        if (mine[__builtin_ctz(lanes)] < clock) return false;
    return true;
}

/* `since`: what happened to this memory before is over: the beginning of the launch, for shared memory of the block. */
void use(cell &c, unsigned bytes, const access &a, uint32_t since)
{
    const int warp = current / WARP, lane = current % WARP;
    const uint32_t *mine = clocks[current], me = 1u << lane;
    const uint32_t code = (uint32_t)((uintptr_t)a.code - running->what->home->begin);

    if (c.write_time >= since && (c.write_bytes & bytes) && !(a.atomic && c.atomic)) {
        if (c.write_time < block_began) race(a, c, true);
        if (c.write_time == now && c.write_thread != current && (c.write_thread / WARP != warp || mine[c.write_thread % WARP] < c.write_clock)) race(a, c, true);
    }
    if (!a.write) {
        const bool recent = c.read_time >= since, same_time = c.read_time == now;
        if (!recent) c.several = 0;
        else if (c.read_time < block_began) c.several = SEVERAL_BLOCKS;
        else if (!same_time) c.several &= SEVERAL_BLOCKS;
        if (same_time && c.read_warp != warp) {
            c.several |= SEVERAL_WARPS;
            c.read_bytes |= (uint8_t)bytes;
        } else if (!same_time || before_me(c.read_lanes & ~me, c.read_clock, mine)) {
            c.read_lanes = me, c.read_clock = mine[lane], c.read_bytes = (uint8_t)bytes;
        } else {
            c.read_lanes |= me, c.read_bytes |= (uint8_t)bytes;
            if (mine[lane] > c.read_clock) c.read_clock = mine[lane];
        }
        c.read_time = now, c.read_warp = (uint16_t)warp, c.read_code = code;
        return;
    }
    if (c.read_time >= since && (c.read_bytes & bytes)) {
        if ((c.several & SEVERAL_BLOCKS) || c.read_time < block_began) race(a, c, false);
        if (c.read_time == now && ((c.several & SEVERAL_WARPS) || c.read_warp != warp || !before_me(c.read_lanes & ~me, c.read_clock, mine))) race(a, c, false);
    }
    c.write_time = now, c.write_clock = mine[lane], c.write_thread = (uint16_t)current, c.write_bytes = (uint8_t)bytes, c.write_code = code;
    c.atomic = a.atomic;
}

void use_cells(cell *cells, uintptr_t base, const access &a, uint32_t since)
{
    for (uintptr_t at = a.at & ~(uintptr_t)3; at < a.at + a.size; at += 4) {
        const unsigned from = at < a.at ? (unsigned)(a.at - at) : 0, to = a.at + a.size - at < 4 ? (unsigned)(a.at + a.size - at) : 4;
        use(cells[(at - base) / 4], (0xfu << from) & (0xfu >> (4 - to)), a, since);
    }
}

void shared(std::vector<cell> &cells, uintptr_t begin, uintptr_t end, const access &a)
{
    if (a.at + a.size > end) stop_at(a.code, "%s %zu bytes across the end of shared memory", verb(a), a.size);
    if (cells.size() < (end - begin) / 4 + 2) cells.resize((end - begin) / 4 + 2);
    const uintptr_t base = begin & ~(uintptr_t)3;
    for (uintptr_t at = a.at & ~(uintptr_t)3; at < a.at + a.size && (!a.write || a.atomic); at += 4)
        if (cells[(at - base) / 4].write_time < block_began)
            stop_at(a.code, "reads shared memory that no thread of this block has written (byte %zu)", (size_t)(a.at - begin));
    use_cells(cells.data(), base, a, block_began);
}

/* Neither the device's memory nor the thread's stack. */
__attribute__((noinline)) void elsewhere(const access &a)
{
    if (a.at >= dynamic_begin && a.at < dynamic_end) return shared(dynamic_cells, dynamic_begin, dynamic_end, a);
    if (a.at >= fixed_begin && a.at < fixed_end) return shared(fixed_cells, fixed_begin, fixed_end, a);
    if (a.at - (uintptr_t)&state < sizeof state && !a.write) return;
    const module &home = *running->what->home;
    if (a.at >= home.begin && a.at < home.end) { /* constants */
        if (a.write) stop_at(a.code, "writes to a variable of the module, which is not shared memory");
        return;
    }
    if (is_argument(a.at)) {
        if (a.write) stop_at(a.code, "writes to its arguments");
        return;
    }
    if (in_pinned(a.at, a.size)) return;
    if (in_stacks(a.at)) stop_at(a.code, "%s %zu bytes of the stack of another thread", verb(a), a.size);
    if (a.at + 4096 >= dynamic_end && a.at <= dynamic_end + 4096 && dynamic_end)
        stop_at(a.code, "%s %zu bytes, %zu bytes after the end of dynamic shared memory", verb(a), a.size, (size_t)(a.at - dynamic_end));
    stop_at(a.code, "%s %zu bytes at %#zx: %s", verb(a), a.size, (size_t)a.at, describe_address(a.at).c_str());
}

inline void check(const access &a)
{
    if (!running || !stack_of_current || a.size == 0) return;
    if (a.at - (uintptr_t)stack_of_current < STACK) return;
    if (!in_device_region(a.at)) return elsewhere(a);
    if (a.at < last.begin || a.at + a.size > last.end) {
        last = find_device(a.at);
        if (!last.end || a.at + a.size > last.end) stop_at(a.code, "%s %zu bytes at %s", verb(a), a.size, describe_address(last.end ? last.end : a.at).c_str());
    }
    if (!device_cells) {
        device_base = device_region(nullptr);
        size_t size;
        device_region(&size);
        void *memory = mmap(nullptr, size / 4 * sizeof(cell), PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
        if (memory == MAP_FAILED) stop("no room for %zu bytes of addresses, with which accesses are checked", size / 4 * sizeof(cell));
        device_cells = (cell *)memory;
    }
    use_cells(device_cells, device_base, a, launch_began);
}

inline void access_of(const void *at, size_t size, bool write, const void *code, bool aligned)
{
    if (aligned && (uintptr_t)at % size && running) stop_at(code, "misaligned: %s %zu bytes at %#zx", write ? "writes" : "reads", size, (size_t)(uintptr_t)at);
    check({ (uintptr_t)at, size, write, false, code });
}
} // namespace

void check_begin_kernel()
{
    launch_began = ++now;
    emulator_module *contents = running->what->home->contents;
    fixed_begin = (uintptr_t)contents->shared_begin, fixed_end = (uintptr_t)contents->shared_end;
    dynamic_begin = (uintptr_t)state.dynamic_shared, dynamic_end = dynamic_begin + (dynamic_begin ? running->shared : 0);
    last = { 0, 0 };
}
void check_begin_block()
{
    block_began = ++now;
    if (!running->what->home->contents->checked) return;
    const int n = (int)(state.block_size.x * state.block_size.y * state.block_size.z);
    for (int k = 0; k < n; k++) {
        memset(clocks[k], 0, sizeof clocks[k]);
        clocks[k][k % WARP] = 1;
    }
}
void check_barrier() { now++; }
void check_syncwarp(int warp, unsigned mask)
{
    if (!running->what->home->contents->checked) return;
    uint32_t all[WARP] = { 0 };
    for (int l = 0; l < WARP; l++)
        for (int k = 0; k < WARP && (mask >> l & 1u); k++)
            if (clocks[warp * WARP + l][k] > all[k]) all[k] = clocks[warp * WARP + l][k];
    uint32_t newest = 0;
    for (int l = 0; l < WARP; l++)
        if ((mask >> l & 1u) && all[l] > newest) newest = all[l];
    for (int l = 0; l < WARP; l++)
        if (mask >> l & 1u) {
            memcpy(clocks[warp * WARP + l], all, sizeof all);
            clocks[warp * WARP + l][l] = newest + 1;
        }
}
void check_touch(const void *at, size_t size, bool write) { check({ (uintptr_t)at, size, write, false, __builtin_return_address(0) }); }
void check_atomic(const void *at, size_t size)
{
    if (!running->what->home->contents->checked) return;
    if ((uintptr_t)at % size) stop_at(__builtin_return_address(0), "misaligned: an atomic on %zu bytes at %p", size, at);
    check({ (uintptr_t)at, size, true, true, __builtin_return_address(0) });
}
void check_freed(uintptr_t at, size_t size)
{
    if (!device_cells) return;
    const uintptr_t begin = (uintptr_t)&device_cells[(at - device_base) / 4], end = (uintptr_t)&device_cells[(at + size - device_base) / 4];
    const uintptr_t first = (begin + PAGE - 1) / PAGE * PAGE, after = end / PAGE * PAGE;
    if (first < after) madvise((void *)first, after - first, MADV_DONTNEED);
}
} // namespace emulated

/* ---- what the compiler calls ---- */

#define HERE __builtin_return_address(0)
#define ACCESS(size_)                                                                                         \
    void __tsan_read##size_(void *at) { emulated::access_of(at, size_, false, HERE, true); }                  \
    void __tsan_write##size_(void *at) { emulated::access_of(at, size_, true, HERE, true); }                  \
    void __tsan_unaligned_read##size_(void *at) { emulated::access_of(at, size_, false, HERE, false); }       \
    void __tsan_unaligned_write##size_(void *at) { emulated::access_of(at, size_, true, HERE, false); }       \
    void __tsan_volatile_read##size_(void *at) { emulated::access_of(at, size_, false, HERE, true); }         \
    void __tsan_volatile_write##size_(void *at) { emulated::access_of(at, size_, true, HERE, true); }

extern "C" {
ACCESS(1)
ACCESS(2)
ACCESS(4)
ACCESS(8)
ACCESS(16)
void __tsan_read_range(void *at, size_t size) { emulated::access_of(at, size, false, HERE, false); }
void __tsan_write_range(void *at, size_t size) { emulated::access_of(at, size, true, HERE, false); }
void __tsan_init() {}
void __tsan_func_entry(void *) {}
void __tsan_func_exit(void *) {}
void __tsan_vptr_update(void **, void *) {}
}
