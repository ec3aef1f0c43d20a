/* Runs kernels: a fiber for each CUDA thread. Threads are run one after the other on one stack for as long as none waits; one that
 * waits keeps its stack, and the next begins on another. */
#include "emulator.h"

#include <stdio.h>
#include <sys/mman.h>
#ifndef __x86_64__
#include <ucontext.h>
#endif

namespace emulated
{
emulator_state state;
const launch *running;
int current;
char *stack_of_current;

namespace
{
enum what { FRESH, DONE, AT_BARRIER, IN_WARP, READY };

struct thread {
    what is;
    bool waited; /* its stack is its own */
    int stack;
    const emulator_site *site;
    unsigned mask;
    uint64_t value, result;
    int kind, argument, width;
};
thread threads[MOST_THREADS];
int n_threads;
int round_[WARP], n_round, next_in_round; /* lanes that a worker has still to begin */
int warp_order[MOST_THREADS / WARP], lane_order[WARP], n_warps;
std::vector<void *> &arguments = *new std::vector<void *>; /* never destroyed: a program may launch at its very end */
uintptr_t arguments_begin, arguments_end;

/* ---- stacks and switches ---- */

char *stacks; /* each with a page before it that nobody may touch */
enum { STRIDE = STACK + PAGE };
int free_stacks[MOST_THREADS], n_free;

void make_stacks()
{
    stacks = (char *)mmap(nullptr, (size_t)MOST_THREADS * STRIDE, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE | MAP_STACK, -1, 0);
    if (stacks == MAP_FAILED) stop("no memory for %d stacks of %d bytes", MOST_THREADS, STACK);
    for (int i = 0; i < MOST_THREADS; i++) {
        mprotect(stacks + (size_t)i * STRIDE, PAGE, PROT_NONE);
        free_stacks[MOST_THREADS - 1 - i] = i;
    }
    n_free = MOST_THREADS;
}

void work();

#ifdef __x86_64__
void *scheduler_at, *fiber_at[MOST_THREADS]; /* stack pointers, by stack */

/* Every register is given up; the address to go on at is on the stack. A jump, not a return: returns would be mispredicted. */
inline __attribute__((always_inline)) void switch_stack(void **from, void *to)
{
    __asm__ volatile("lea -128(%%rsp), %%rsp\n\t"
                     "push %%rbp\n\t"
                     "lea 1f(%%rip), %%rcx\n\t"
                     "push %%rcx\n\t"
                     "mov %%rsp, (%%rax)\n\t"
                     "mov %%rdx, %%rsp\n\t"
                     "pop %%rcx\n\t"
                     "jmp *%%rcx\n"
                     "1:\n\t"
                     "pop %%rbp\n\t"
                     "lea 128(%%rsp), %%rsp"
                     : "+a"(from), "+d"(to)
                     :
                     : "rbx", "rcx", "rsi", "rdi", "r8", "r9", "r10", "r11", "r12", "r13", "r14", "r15", "memory", "cc", "xmm0", "xmm1", "xmm2",
                       "xmm3", "xmm4", "xmm5", "xmm6", "xmm7", "xmm8", "xmm9", "xmm10", "xmm11", "xmm12", "xmm13", "xmm14", "xmm15");
}

void begin_fiber(int stack)
{
    void **top = (void **)(stacks + (size_t)(stack + 1) * STRIDE) - 2;
    top[0] = (void *)work;
    top[1] = nullptr; /* where work would return to: it does not */
    switch_stack(&scheduler_at, top);
}
void resume_fiber(int stack) { switch_stack(&scheduler_at, fiber_at[stack]); }
void leave_fiber(int stack) { switch_stack(&fiber_at[stack], scheduler_at); }
#else
ucontext_t scheduler_at, fiber_at[MOST_THREADS];

void begin_fiber(int stack)
{
    ucontext_t &c = fiber_at[stack];
    getcontext(&c);
    c.uc_stack.ss_sp = stacks + (size_t)stack * STRIDE + PAGE;
    c.uc_stack.ss_size = STACK;
    c.uc_link = nullptr;
    makecontext(&c, work, 0);
    swapcontext(&scheduler_at, &c);
}
void resume_fiber(int stack) { swapcontext(&scheduler_at, &fiber_at[stack]); }
void leave_fiber(int stack) { swapcontext(&fiber_at[stack], &scheduler_at); }
#endif

inline void set_current(int k)
{
    current = k;
    const emulator_size b = state.block_size;
    if (b.y == 1 && b.z == 1) state.thread = { (unsigned)k, 0, 0 };
    else state.thread = { (unsigned)k % b.x, (unsigned)k / b.x % b.y, (unsigned)k / b.x / b.y };
}

/* A worker: begins the threads of the round one after the other, until one of them has waited. */
void work()
{
    for (;;) {
        const int k = round_[next_in_round++];
        thread &t = threads[k];
        t.stack = free_stacks[n_free - 1];
        set_current(k);
        running->what->kernel->call(arguments.data());
        t.is = DONE;
        if (t.waited) {
            free_stacks[n_free++] = t.stack;
            leave_fiber(t.stack);
            stop("a thread went on after its end");
        }
        if (next_in_round == n_round) {
            leave_fiber(t.stack);
            stop("a thread went on after its end");
        }
    }
}

void wait_as(what is)
{
    thread &t = threads[current];
    t.is = is;
    if (!t.waited) {
        t.waited = true;
        n_free--; /* the stack on top is this thread's from now on */
    }
    const int k = current;
    leave_fiber(t.stack);
    set_current(k);
}

void begin_round()
{
    while (next_in_round < n_round) {
        const int stack = free_stacks[n_free - 1];
        stack_of_current = stacks + (size_t)stack * STRIDE + PAGE;
        begin_fiber(stack);
    }
}

void resume(int k)
{
    stack_of_current = stacks + (size_t)threads[k].stack * STRIDE + PAGE;
    resume_fiber(threads[k].stack);
}

/* ---- warp operations ---- */

uint64_t exchange(const emulator_site *site, unsigned mask, uint64_t value, int kind, int argument, int width)
{
    if (!running) stop("%s outside of a kernel", site->what);
    if (!(mask >> current % WARP & 1u)) stop("%s at %s:%d: the mask %08x does not name the thread itself (lane %d)", site->what, site->file, site->line, mask, current % WARP);
    if (width < 1 || width > WARP || (width & (width - 1))) stop("%s at %s:%d: the width %d is not a power of two up to 32", site->what, site->file, site->line, width);
    const int first = current / WARP * WARP, lanes = n_threads - first < WARP ? n_threads - first : WARP;
    if (lanes < WARP && mask >> lanes) stop("%s at %s:%d: the mask %08x names threads that the block does not have", site->what, site->file, site->line, mask);
    thread &t = threads[current];
    t.site = site, t.mask = mask, t.value = value, t.kind = kind, t.argument = argument, t.width = width;
    wait_as(IN_WARP);
    return t.result;
}

/* The lane that `lane` reads from; itself where the segment ends. */
int source_lane(const thread &t, int lane)
{
    const int first = lane & ~(t.width - 1), last = first + t.width - 1;
    if (t.kind == EMULATOR_SHUFFLE) return first + (t.argument & (t.width - 1));
    const int from = t.kind == EMULATOR_DOWN ? lane + t.argument : t.kind == EMULATOR_UP ? lane - t.argument : lane ^ t.argument;
    if (t.kind == EMULATOR_UP) return from < first || t.argument < 0 ? lane : from;
    return from > last || from < 0 ? lane : from;
}

uint64_t reduce(const thread *warp, unsigned mask, int kind)
{
    uint64_t all = 0;
    bool first = true;
    for (int l = 0; l < WARP; l++) {
        if (!(mask >> l & 1u)) continue;
        const unsigned v = (unsigned)warp[l].value, a = (unsigned)all;
        if (kind == EMULATOR_BALLOT) all |= warp[l].value ? 1ull << l : 0;
        else if (first) all = v;
        else if (kind == EMULATOR_ADD) all = a + v;
        else if (kind == EMULATOR_MIN) all = (int)v < (int)a ? v : a;
        else if (kind == EMULATOR_MAX) all = (int)v > (int)a ? v : a;
        else if (kind == EMULATOR_UMIN) all = v < a ? v : a;
        else if (kind == EMULATOR_UMAX) all = v > a ? v : a;
        else if (kind == EMULATOR_BITS_AND) all = a & v;
        else if (kind == EMULATOR_BITS_OR) all = a | v;
        else all = a ^ v;
        first = false;
    }
    return all;
}

/* If all lanes that `lane` names have come, they get their results. */
bool finish_exchange(int first, int lane)
{
    thread *warp = &threads[first];
    const thread &t = warp[lane];
    const unsigned mask = t.mask;
    for (int l = 0; l < WARP; l++) {
        if (!(mask >> l & 1u)) continue;
        const thread &other = warp[l];
        if (other.is == DONE) {
            current = first + lane;
            stop("%s at %s:%d: the mask %08x names %s, which has ended", t.site->what, t.site->file, t.site->line, mask, thread_name(first + l).c_str());
        }
        if (other.is != IN_WARP || other.mask != mask || other.site != t.site) return false;
    }
    if (t.kind == EMULATOR_SYNC) check_syncwarp(first / WARP, mask);
    const bool shuffles = t.kind >= EMULATOR_SHUFFLE && t.kind <= EMULATOR_XOR;
    const uint64_t all = t.kind >= EMULATOR_BALLOT ? reduce(warp, mask, t.kind) : 0;
    for (int l = 0; l < WARP; l++) {
        if (!(mask >> l & 1u)) continue;
        thread &to = warp[l];
        const int from = shuffles ? source_lane(to, l) : l;
        if (!(mask >> from & 1u)) {
            current = first + l;
            stop("%s at %s:%d: lane %d reads from lane %d, which the mask %08x does not name", to.site->what, to.site->file, to.site->line, l, from, mask);
        }
        to.result = shuffles ? warp[from].value : all;
    }
    for (int l = 0; l < WARP; l++)
        if (mask >> l & 1u) warp[l].is = READY;
    return true;
}

/* Runs a warp until each of its threads has ended or waits for the block. */
void run_warp(int warp)
{
    const int first = warp * WARP, lanes = n_threads - first < WARP ? n_threads - first : WARP;
    if (threads[first].is == FRESH) {
        n_round = next_in_round = 0;
        for (int n = 0; n < WARP; n++)
            if (lane_order[n] < lanes) round_[n_round++] = first + lane_order[n];
        begin_round();
    }
    for (;;) {
        int waiting = -1;
        bool progress = false;
        for (int n = 0; n < WARP; n++) {
            const int l = lane_order[n];
            if (l >= lanes) continue;
            thread &t = threads[first + l];
            if (t.is == READY) resume(first + l), progress = true;
        }
        for (int l = 0; l < lanes; l++)
            if (threads[first + l].is == IN_WARP) {
                if (finish_exchange(first, l)) progress = true;
                else waiting = l;
            }
        if (progress) continue;
        if (waiting < 0) return;
        const thread &t = threads[first + waiting];
        current = first + waiting;
        for (int l = 0; l < lanes; l++) {
            const thread &other = threads[first + l];
            if (!(t.mask >> l & 1u) || (other.is == IN_WARP && other.site == t.site && other.mask == t.mask)) continue;
            stop("deadlock: %s at %s:%d waits with the mask %08x for %s, which waits at %s at %s:%d with the mask %08x", t.site->what, t.site->file, t.site->line, t.mask,
                 thread_name(first + l).c_str(), other.site->what, other.site->file, other.site->line, other.is == IN_WARP ? other.mask : 0xffffffffu);
        }
        stop("deadlock in a warp");
    }
}

/* ---- barriers ---- */

int barrier(const emulator_site *site, int kind, int predicate)
{
    if (!running) stop("%s outside of a kernel", site->what);
    thread &t = threads[current];
    t.site = site, t.kind = kind, t.value = (uint64_t)predicate;
    wait_as(AT_BARRIER);
    return (int)t.result;
}

/* All have come to a barrier, to the same one, or all have ended: anything else is an error. */
bool finish_barrier()
{
    int ended = -1, waits = -1, count = 0;
    for (int k = 0; k < n_threads; k++) {
        thread &t = threads[k];
        if (t.is == DONE) ended = k;
        else if (waits < 0) waits = k;
        if (ended >= 0 && waits >= 0) {
            const emulator_site *site = threads[waits].site;
            current = waits;
            stop("%s at %s:%d waits for %s, which has ended: every thread has to come to a barrier", site->what, site->file, site->line, thread_name(ended).c_str());
        }
        if (t.is == DONE) continue;
        if (t.site != threads[waits].site) {
            const emulator_site *a = threads[waits].site, *b = t.site;
            current = waits;
            stop("divergent barriers: %s at %s:%d, while %s waits at %s at %s:%d", a->what, a->file, a->line, thread_name(k).c_str(), b->what, b->file, b->line);
        }
        count += t.value != 0;
    }
    if (waits < 0) return false;
    for (int k = 0; k < n_threads; k++) {
        thread &t = threads[k];
        t.result = t.kind == EMULATOR_COUNT ? (uint64_t)count : t.kind == EMULATOR_AND ? count == n_threads : count != 0;
        t.is = READY;
    }
    check_barrier();
    return true;
}

/* ---- orders ---- */

uint64_t random_state;
unsigned random_below(unsigned n)
{
    random_state = random_state * 6364136223846793005ull + 1442695040888963407ull;
    return (unsigned)((random_state >> 33) % n);
}
void arrange(int *list, int n, int order)
{
    for (int i = 0; i < n; i++) list[i] = order == 1 ? n - 1 - i : i;
    for (int i = n - 1; order == 2 && i > 0; i--) std::swap(list[i], list[random_below((unsigned)i + 1)]);
}

void run_block(int order)
{
    for (int k = 0; k < n_threads; k++) threads[k].is = FRESH, threads[k].waited = false;
    if (order == 2) arrange(warp_order, n_warps, order), arrange(lane_order, WARP, order);
    check_begin_block();
    do
        for (int w = 0; w < n_warps; w++) run_warp(warp_order[w]);
    while (finish_barrier());
}
} // namespace

std::string thread_name(int k)
{
    const emulator_size b = state.block_size;
    char text[64];
    if (b.y == 1 && b.z == 1) snprintf(text, sizeof text, "thread %d", k);
    else snprintf(text, sizeof text, "thread (%u, %u, %u)", (unsigned)k % b.x, (unsigned)k / b.x % b.y, (unsigned)k / b.x / b.y);
    return text;
}

bool in_stacks(uintptr_t at) { return stacks && at >= (uintptr_t)stacks && at < (uintptr_t)stacks + (size_t)MOST_THREADS * STRIDE; }
bool in_stack_guard(uintptr_t at) { return in_stacks(at) && (at - (uintptr_t)stacks) % STRIDE < PAGE; }
bool is_argument(uintptr_t at)
{
    return (at >= arguments_begin && at < arguments_end) || at - (uintptr_t)arguments.data() < arguments.size() * sizeof arguments[0];
}

void run_kernel(const launch &l)
{
    if (!stacks) make_stacks();
    const char *order_text = getenv("EMULATOR_ORDER"), *seed = getenv("EMULATOR_SEED");
    const int order = order_text ? atoi(order_text) : 0;
    if (order < 0 || order > 2) stop("EMULATOR_ORDER is %s, expected 0, 1 or 2", order_text);
    random_state = (seed ? strtoull(seed, nullptr, 10) : 1) * 0x9e3779b97f4a7c15ull + 1;

    std::vector<char> args = l.args; /* 16-byte aligned, each of them */
    arguments.clear();
    arguments_begin = (uintptr_t)args.data(), arguments_end = arguments_begin + args.size();
    size_t at = 0;
    for (size_t size : l.what->sizes) {
        arguments.push_back(args.data() + at);
        at += (size + 15) / 16 * 16;
    }
    state.barrier = barrier, state.exchange = exchange, state.touch = check_touch, state.atomic = check_atomic;
    state.trap = [](const char *what) { stop("%s", what); };
    state.block_size = l.block;
    state.grid_size = l.grid;
    n_threads = (int)(l.block.x * l.block.y * l.block.z);
    n_warps = (n_threads + WARP - 1) / WARP;
    arrange(warp_order, n_warps, order);
    arrange(lane_order, WARP, order);
    emulator_module *contents = l.what->home->contents;
    const size_t fixed = (size_t)(contents->shared_end - contents->shared_begin), dynamic = (l.shared + 15) / 16 * 16;
    char *memory = dynamic_shared(dynamic);
    state.dynamic_shared = l.shared ? memory : nullptr;
    const uint64_t blocks = (uint64_t)l.grid.x * l.grid.y * l.grid.z;
    std::vector<unsigned> shuffled;
    if (order == 2) {
        shuffled.resize(blocks);
        for (unsigned i = 0; i < blocks; i++) shuffled[i] = i;
        for (unsigned i = (unsigned)blocks; i > 1; i--) std::swap(shuffled[i - 1], shuffled[random_below(i)]);
    }
    running = &l;
    check_begin_kernel();
    for (uint64_t n = 0; n < blocks; n++) {
        const uint64_t b = order == 1 ? blocks - 1 - n : order == 2 ? shuffled[n] : n;
        state.block = { (unsigned)(b % l.grid.x), (unsigned)(b / l.grid.x % l.grid.y), (unsigned)(b / l.grid.x / l.grid.y) };
        if (fixed) memset(contents->shared_begin, 0xff, fixed);
        if (dynamic) memset(memory, 0xff, dynamic);
        run_block(order);
    }
    running = nullptr;
    stack_of_current = nullptr;
    if (memcmp(args.data(), l.args.data(), args.size()) != 0) stop("%s wrote to its arguments", l.what->name.c_str());
}
} // namespace emulated
