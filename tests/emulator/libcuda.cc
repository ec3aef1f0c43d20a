/* An emulating libcuda.so.1: runs kernels that the emulating NVRTC compiled, on the processor, a fiber for each CUDA thread. */
#include "shim.h"

#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/types.h>
#include <ucontext.h>
#include <unistd.h>
#include <map>
#include <string>
#include <vector>

namespace
{
enum { MOST = 1024, STACK = 64 << 10, WARP = 32 };

[[noreturn]] void stop(const char *what)
{
    fprintf(stderr, "emulator: %s\n", what);
    abort();
}

/* ---- fibers ---- */

struct fiber {
    ucontext_t context;
    bool done, waits;   /* at a barrier */
    bool exchanges;     /* at a warp operation */
    unsigned site, mask;
    uint64_t value, result;
    int kind, argument;
};

emulator_state state;
fiber fibers[MOST];
ucontext_t scheduler;
char *stacks;
int current;
void (*kernel_call)(void **);
void **kernel_args;

void fiber_main(int number)
{
    kernel_call(kernel_args);
    fibers[number].done = true;
}

void yield() { swapcontext(&fibers[current].context, &scheduler); }

void barrier(unsigned site)
{
    fibers[current].waits = true;
    fibers[current].site = site;
    yield();
}

uint64_t exchange(unsigned site, unsigned mask, uint64_t value, int kind, int argument)
{
    fiber &f = fibers[current];
    f.exchanges = true;
    f.site = site, f.mask = mask, f.value = value, f.kind = kind, f.argument = argument;
    yield();
    return f.result;
}

bool finish_exchange(int first, int lane)
{
    fiber &f = fibers[first + lane];
    for (int l = 0; l < WARP; l++)
        if (f.mask >> l & 1u) {
            fiber &other = fibers[first + l];
            if (other.done) stop("a warp operation names a thread that has ended");
            if (!other.exchanges || other.mask != f.mask || other.site != f.site) return false;
        }
    uint64_t ballot = 0;
    for (int l = 0; l < WARP; l++)
        if (f.mask >> l & 1u && fibers[first + l].value) ballot |= 1ull << l;
    const unsigned mask = f.mask;
    for (int l = 0; l < WARP; l++) {
        if (!(mask >> l & 1u)) continue;
        fiber &g = fibers[first + l];
        int from = l;
        if (g.kind == EMULATOR_SHUFFLE) from = g.argument & 31;
        if (g.kind == EMULATOR_DOWN && l + g.argument < WARP) from = l + g.argument;
        if (g.kind == EMULATOR_UP && l - g.argument >= 0) from = l - g.argument;
        if (g.kind == EMULATOR_XOR) from = l ^ g.argument;
        if (!(mask >> from & 1u)) from = l;
        g.result = g.kind == EMULATOR_BALLOT ? ballot : fibers[first + from].value;
    }
    for (int l = 0; l < WARP; l++)
        if (mask >> l & 1u) fibers[first + l].exchanges = false;
    return true;
}

void run_block(int threads, int order)
{
    for (int k = 0; k < threads; k++) {
        fiber &f = fibers[k];
        f.done = f.waits = f.exchanges = false;
        getcontext(&f.context);
        f.context.uc_stack.ss_sp = stacks + (size_t)k * STACK;
        f.context.uc_stack.ss_size = STACK;
        f.context.uc_link = &scheduler;
        makecontext(&f.context, (void (*)())fiber_main, 1, k);
    }
    for (;;) {
        bool progress = false, all_done = true;
        for (int n = 0; n < threads; n++) {
            const int k = order == 1 ? threads - 1 - n : order == 2 ? (int)((n * 37u + 11) % (unsigned)threads) : n;
            fiber &f = fibers[k];
            if (f.done || f.waits || f.exchanges) continue;
            current = k;
            state.thread.x = (unsigned)k;
            swapcontext(&scheduler, &f.context);
            progress = true;
        }
        for (int k = 0; k < threads; k++) {
            all_done &= fibers[k].done;
            if (fibers[k].exchanges && finish_exchange(k / WARP * WARP, k % WARP)) progress = true;
        }
        if (all_done) return;
        bool at_barrier = true;
        for (int k = 0; k < threads; k++) at_barrier &= fibers[k].waits;
        if (at_barrier) {
            for (int k = 0; k < threads; k++) {
                if (fibers[k].site != fibers[0].site) stop("threads of a block wait at different barriers");
                fibers[k].waits = false;
            }
            progress = true;
        }
        if (!progress) stop("deadlock: some threads wait at a barrier that others never reach");
    }
}

struct module {
    void *library;
    emulator_kernel *kernels;
    char *shared_begin, *shared_end;
};
struct function {
    module *home;
    emulator_kernel *kernel;
};
std::map<void *, size_t> allocations;
size_t in_use;
size_t total() { return getenv("EMULATOR_MEMORY") ? (size_t)atoll(getenv("EMULATOR_MEMORY")) : (size_t)8 << 30; }
} // namespace

extern "C" {

int cuInit(unsigned) { return getenv("EMULATOR_NO_DEVICE") ? 100 : 0; }
int cuDriverGetVersion(int *version) { return *version = 13000, 0; }
int cuGetErrorName(int result, const char **name)
{
    *name = result == 0 ? "CUDA_SUCCESS" : result == 2 ? "CUDA_ERROR_OUT_OF_MEMORY" : result == 100 ? "CUDA_ERROR_NO_DEVICE" : "CUDA_ERROR_UNKNOWN";
    return 0;
}
int cuGetErrorString(int result, const char **text) { return cuGetErrorName(result, text); }
int cuDeviceGetCount(int *n) { return *n = 1, 0; }
int cuDeviceGet(int *device, int number) { return *device = number, number == 0 ? 0 : 101; }
int cuDeviceGetName(char *name, int size, int) { return snprintf(name, (size_t)size, "emulated GPU"), 0; }
int cuDeviceTotalMem_v2(size_t *bytes, int) { return *bytes = total(), 0; }
int cuDeviceGetAttribute(int *value, int attribute, int)
{
    *value = attribute == 16 ? 4 : attribute == 75 ? 9 : attribute == 76 ? 0 : attribute == 97 ? 227 << 10 : 0;
    return 0;
}
int cuDevicePrimaryCtxRetain(void **context, int) { return *context = &state, 0; }
int cuDevicePrimaryCtxRelease_v2(int) { return 0; }
int cuCtxSetCurrent(void *) { return 0; }
int cuMemGetInfo_v2(size_t *free, size_t *all) { return *all = total(), *free = total() - in_use, 0; }

/* Each ends where a page begins that nobody may touch; fresh memory is NaN. */
int cuMemAlloc_v2(unsigned long long *memory, size_t bytes)
{
    const size_t page = 4096, size = (bytes + page - 1) / page * page;
    if (in_use + bytes > total()) return 2;
    char *all = (char *)mmap(nullptr, size + page, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (all == MAP_FAILED) return 2;
    mprotect(all + size, page, PROT_NONE);
    memset(all, 0xff, size);
    char *at = all + (size - bytes) / 256 * 256;
    allocations[at] = bytes;
    in_use += bytes;
    *memory = (unsigned long long)(uintptr_t)at;
    return 0;
}
int cuMemFree_v2(unsigned long long memory)
{
    char *at = (char *)(uintptr_t)memory;
    auto found = allocations.find(at);
    if (found == allocations.end()) stop("cuMemFree of what was not allocated");
    const size_t page = 4096, size = (found->second + page - 1) / page * page;
    char *all = (char *)((uintptr_t)at / page * page);
    while ((size_t)(at - all) > (size - found->second)) all += page;
    in_use -= found->second;
    munmap(all, size + page);
    allocations.erase(found);
    return 0;
}
int cuMemAllocHost_v2(void **memory, size_t bytes) { return *memory = malloc(bytes), *memory ? 0 : 2; }
int cuMemFreeHost(void *memory) { return free(memory), 0; }
int cuMemcpyHtoDAsync_v2(unsigned long long to, const void *from, size_t bytes, void *) { return memcpy((void *)(uintptr_t)to, from, bytes), 0; }
int cuMemcpyDtoHAsync_v2(void *to, unsigned long long from, size_t bytes, void *) { return memcpy(to, (void *)(uintptr_t)from, bytes), 0; }
int cuMemcpyDtoDAsync_v2(unsigned long long to, unsigned long long from, size_t bytes, void *) { return memcpy((void *)(uintptr_t)to, (void *)(uintptr_t)from, bytes), 0; }
int cuStreamCreate(void **stream, unsigned) { return *stream = &scheduler, 0; }
int cuStreamDestroy_v2(void *) { return 0; }
int cuStreamSynchronize(void *) { return 0; }
int cuStreamBeginCapture_v2(void *, int) { return 801; }
int cuStreamEndCapture(void *, void **) { return 801; }
int cuEventCreate(void **event, unsigned) { return *event = &scheduler, 0; }
int cuEventRecord(void *, void *) { return 0; }
int cuEventQuery(void *) { return 0; }
int cuEventSynchronize(void *) { return 0; }
int cuEventDestroy_v2(void *) { return 0; }
int cuGraphInstantiateWithFlags(void **, void *, unsigned long long) { return 801; }
int cuGraphExecUpdate_v2(void *, void *, void *) { return 801; }
int cuGraphLaunch(void *, void *) { return 801; }
int cuGraphExecDestroy(void *) { return 801; }
int cuGraphDestroy(void *) { return 801; }

/* What enqueue.h looks for. */
int emulator_enqueue(void *, const char *, void (*call)(const void *), const void *bytes, size_t) { return call(bytes), 0; }

int cuModuleLoadData(void **out, const void *image)
{
    const char *bytes = (const char *)image;
    if (memcmp(bytes, "EMULATED", 8) != 0) return 200;
    unsigned long size;
    memcpy(&size, bytes + 8, sizeof size);
    char path[] = "/tmp/emulated-module-XXXXXX";
    const int file = mkstemp(path);
    if (file < 0 || write(file, bytes + 16, size) != (ssize_t)size) return 200;
    close(file);
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    unlink(path);
    if (!library) return fprintf(stderr, "emulator: %s\n", dlerror()), 200;
    *(emulator_state **)dlsym(library, "emulator") = &state;
    state.barrier = barrier;
    state.exchange = exchange;
    module *m = new module{ library, *(emulator_kernel **)dlsym(library, "emulator_kernels"), nullptr, nullptr };
    *out = m;
    return 0;
}
int cuModuleUnload(void *m) { return dlclose(((module *)m)->library), delete (module *)m, 0; }
int cuModuleGetFunction(void **out, void *m, const char *name)
{
    for (emulator_kernel *k = ((module *)m)->kernels; k; k = k->next)
        if (strcmp(k->name, name) == 0) return *out = new function{ (module *)m, k }, 0;
    return 500;
}
int cuFuncSetAttribute(void *, int, int) { return 0; }
int cuLaunchKernel(void *f, unsigned gx, unsigned gy, unsigned gz, unsigned bx, unsigned, unsigned, unsigned shared, void *, void **params, void **)
{
    if (gx == 0 || gy != 1 || gz != 1 || bx == 0 || bx > MOST) return 1;
    if (!stacks) stacks = (char *)mmap(nullptr, (size_t)MOST * STACK, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    const char *order = getenv("EMULATOR_ORDER");
    void *memory = shared ? malloc(shared) : nullptr;
    kernel_call = ((function *)f)->kernel->call;
    kernel_args = params;
    state.block_size = { bx, 1, 1 };
    state.grid_size = { gx, 1, 1 };
    state.thread = { 0, 0, 0 };
    for (unsigned b = 0; b < gx; b++) {
        if (shared) memset(memory, 0xff, shared);
        state.dynamic_shared = memory;
        state.block = { b, 0, 0 };
        run_block((int)bx, order ? atoi(order) : 0);
    }
    free(memory);
    return 0;
}
}
