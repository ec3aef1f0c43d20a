/* Enough of CUDA to run a printed kernel as C++: the threads of a block are contexts that take turns at each __syncwarp, in an
 * order that can be chosen. Dynamic shared memory begins as NaN in every block. */
#ifndef CUDA_SHIM_H
#define CUDA_SHIM_H

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <ucontext.h>

#define __global__
#define __device__

namespace shim
{
struct size {
    unsigned x;
};
enum { THREADS = 64, STACK = 256 << 10 };
static size thread, block, block_size;
static void *shared;
static ucontext_t scheduler, context[THREADS];
static bool done[THREADS];
static void (*body)(void *);
static void *body_argument;
static char *stacks;

static void run_thread(int number)
{
    body(body_argument);
    done[number] = true;
}

/* One block of two warps; order: of the threads, 0 forward, 1 backward, 2 mixed. */
static void run_block(void (*what)(void *), void *argument, int order)
{
    body = what;
    body_argument = argument;
    if (!stacks) stacks = (char *)malloc((size_t)THREADS * STACK);
    block_size.x = THREADS;
    for (int k = 0; k < THREADS; k++) {
        done[k] = false;
        getcontext(&context[k]);
        context[k].uc_stack.ss_sp = stacks + (size_t)k * STACK;
        context[k].uc_stack.ss_size = STACK;
        context[k].uc_link = &scheduler;
        makecontext(&context[k], (void (*)(void))run_thread, 1, k);
    }
    for (bool any = true; any;) {
        any = false;
        for (int n = 0; n < THREADS; n++) {
            const int k = order == 0 ? n : order == 1 ? THREADS - 1 - n : n * 37 % THREADS;
            if (done[k]) continue;
            thread.x = (unsigned)k;
            swapcontext(&scheduler, &context[k]);
            any = true;
        }
    }
}

static void wait()
{
    const unsigned number = thread.x;
    swapcontext(&context[number], &scheduler);
}
} // namespace shim

#define threadIdx shim::thread
#define blockIdx  shim::block
#define blockDim  shim::block_size
static inline void __syncwarp(unsigned) { shim::wait(); }
#define HG_DYNAMIC_SHARED(type, name) type *name = (type *)shim::shared

#endif
