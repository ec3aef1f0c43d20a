/* What the emulating driver and the kernels that it runs know of each other. */
#ifndef EMULATOR_TABLE_H
#define EMULATOR_TABLE_H

#include <stddef.h>
#include <stdint.h>

struct emulator_size {
    unsigned x, y, z;
};
struct emulator_site { /* where a thread waits: its address tells one place from another */
    const char *file;
    int line;
    const char *what;
};
enum { EMULATOR_PLAIN, EMULATOR_COUNT, EMULATOR_AND, EMULATOR_OR };
enum {
    EMULATOR_SYNC, EMULATOR_SHUFFLE, EMULATOR_DOWN, EMULATOR_UP, EMULATOR_XOR, EMULATOR_BALLOT,
    EMULATOR_ADD, EMULATOR_MIN, EMULATOR_MAX, EMULATOR_UMIN, EMULATOR_UMAX, EMULATOR_BITS_AND, EMULATOR_BITS_OR, EMULATOR_BITS_XOR
};

/* One instance, the driver's: who runs now, and what a thread may ask of it. */
struct emulator_state {
    emulator_size thread, block, block_size, grid_size;
    void *dynamic_shared;
    int (*barrier)(const emulator_site *site, int kind, int predicate);
    uint64_t (*exchange)(const emulator_site *site, unsigned mask, uint64_t value, int kind, int argument, int width);
    void (*touch)(const void *at, size_t size, bool write); /* EMULATOR_CHECK: before memory is read or written by a library function */
    void (*atomic)(const void *at, size_t size);
    void (*trap)(const char *what);
};

/* A kernel of a module, its arguments unpacked: the driver calls it with the void ** of cuLaunchKernel. */
struct emulator_kernel {
    const char *name;
    void (*call)(void **);
    const size_t *sizes; /* of the arguments, then 0 */
    emulator_kernel *next;
};
struct emulator_module { /* what the driver looks for in the image */
    emulator_state **state;
    emulator_kernel *kernels;
    char *shared_begin, *shared_end;
    bool checked; /* each access is announced */
};

#endif
