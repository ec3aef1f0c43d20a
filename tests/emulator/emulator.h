/* The parts of the emulating driver among themselves: scheduler.cc runs kernels, memory.cc keeps the device's memory out of reach,
 * check.cc watches every access of a kernel that was compiled for it, streams.cc orders work, driver.cc has the entry points.
 *
 * What CUDA answers with an error is answered with that error, and said on stderr; what CUDA leaves undefined ends the program
 * with a message: the kernel, the block and the thread, and where. Settings, all by environment variables:
 *
 *   EMULATOR_ORDER=0|1|2       threads and blocks forward, backward, shuffled (by EMULATOR_SEED)
 *   EMULATOR_CHECK=1           kernels are compiled so that each access is checked: bounds, alignment, races, undefined behaviour
 *   CUDA_LAUNCH_BLOCKING=1     everything at once; otherwise work waits in its stream until somebody waits for it
 *   EMULATOR_MEMORY=BYTES      of the device (8 GiB)
 *   EMULATOR_CAPABILITY=90     the compute capability
 *   EMULATOR_NO_KEYS=1         device memory is protected page by page, as on processors without protection keys
 *   EMULATOR_NO_DEVICE=1       a driver without a GPU
 *   EMULATOR_NO_CAPTURE=1      no stream can be captured
 *   EMULATOR_FAIL=1            who waits for a stream hears of an error
 *   EMULATOR_DRIVER=11080      the driver's version, as cuDriverGetVersion gives it (13000) */
#ifndef EMULATOR_H
#define EMULATOR_H

#include "table.h"

#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <map>
#include <memory>
#include <string>
#include <vector>

namespace emulated
{
enum { MOST_THREADS = 1024, WARP = 32, STACK = 128 << 10, PAGE = 4096, SHARED_USUAL = 48 << 10, SHARED_MOST = 227 << 10 };

enum result { /* CUresult */
    SUCCESS = 0, INVALID_VALUE = 1, OUT_OF_MEMORY = 2, NOT_INITIALIZED = 3, NO_DEVICE = 100, INVALID_DEVICE = 101, INVALID_IMAGE = 200,
    INVALID_CONTEXT = 201, INVALID_HANDLE = 400, NOT_FOUND = 500, NOT_READY = 600, OUT_OF_RESOURCES = 701, NOT_SUPPORTED = 801,
    CAPTURE_UNSUPPORTED = 900, CAPTURE_INVALIDATED = 901, CAPTURE_UNMATCHED = 903, CAPTURE_UNJOINED = 904, CAPTURE_ISOLATION = 905,
    CAPTURED_EVENT = 907, UPDATE_FAILURE = 910, UNKNOWN = 999
};

struct module {
    void *library = nullptr;
    emulator_module *contents = nullptr;
    int file = -1;        /* of the image: where addresses become lines */
    std::string path;
    uintptr_t begin = 0, end = 0; /* where it is in memory */
};
struct function {
    std::shared_ptr<module> home; /* empty: unloaded */
    emulator_kernel *kernel;
    std::string name;
    std::vector<size_t> sizes;
    int most_dynamic = SHARED_USUAL;
};
struct launch {
    function *what;
    emulator_size grid, block;
    size_t shared;
    std::vector<char> args;
};

/* report.cc: who runs is named where somebody runs */
[[noreturn]] void stop(const char *format, ...) __attribute__((format(printf, 1, 2)));
[[noreturn]] void stop_at(const void *code, const char *format, ...) __attribute__((format(printf, 2, 3))); /* and the source line of `code` */
int refuse(int result, const char *format, ...) __attribute__((format(printf, 2, 3))); /* says why on stderr */
std::string line_of(const void *code); /* hairloss/physics.kernel.h:120, or the function where lines are not known */
void watch_signals(); /* again and again: test programs set handlers of their own */
bool setting(const char *name);

extern const char *calling;  /* the library call that runs, or NULL */

/* scheduler.cc */
extern emulator_state state;
extern const launch *running; /* NULL: no kernel */
extern int current;           /* the thread of the block, x fastest */
extern char *stack_of_current;
void run_kernel(const launch &);
std::string thread_name(int thread);
bool in_stacks(uintptr_t at), in_stack_guard(uintptr_t at);
bool is_argument(uintptr_t at);

/* memory.cc */
struct memory_rights { /* while one lives, this thread may touch the device's memory */
    memory_rights();
    ~memory_rights();
};
struct allocation {
    uintptr_t begin, end; /* end == begin: none */
};
allocation find_device(uintptr_t at); /* the allocation that `at` is in */
bool in_device_region(uintptr_t at);
uintptr_t device_region(size_t *size);
std::string describe_address(uintptr_t at);
bool in_pinned(uintptr_t at, size_t size);
int allocate_device(uintptr_t *out, size_t size);
void free_device(uintptr_t at);
void *allocate_pinned(size_t size);
void free_pinned(void *at);
void memory_figures(size_t *free, size_t *total);
size_t forget_device(); /* at the end of the context: how many allocations were left */
char *dynamic_shared(size_t size); /* ends at a page that nobody may touch; poisoned by the scheduler */
bool mapped_on_host(uintptr_t at);

/* check.cc */
void check_begin_kernel(), check_begin_block();
void check_barrier();
void check_syncwarp(int warp, unsigned mask);
void check_touch(const void *at, size_t size, bool write);
void check_atomic(const void *at, size_t size);
void check_freed(uintptr_t at, size_t size);
} // namespace emulated

#endif
