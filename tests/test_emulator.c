/* The emulated GPU (tests/emulator/) itself: kernels that are right give the same bits in every order of threads, and every
 * seeded mistake is found and named. Each case is a process of its own, since what CUDA leaves undefined ends the process. */
#include "emulator_machine.h"

static void order_is(int order, int seed)
{
    char text[16];
    snprintf(text, sizeof text, "%d", order);
    setenv("EMULATOR_ORDER", text, 1);
    snprintf(text, sizeof text, "%d", seed);
    setenv("EMULATOR_SEED", text, 1);
}

/* ---- kernels that are right ---- */

typedef struct {
    const char *name;
    unsigned gx, gy, bx, by, shared;
    int n;
    bool checked;
    void (*expect)(const int32_t *in, int32_t *out, int n);
} good;

static void expect_sum(const int32_t *in, int32_t *out, int n)
{
    for (int b = 0; b < 4; b++)
        for (int i = b * 256; i < n; i += 4 * 256)
            for (int t = 0; t < 256 && i + t < n; t++) out[b] += in[i + t];
}
static void expect_transpose(const int32_t *in, int32_t *out, int n)
{
    for (int i = 0; i < n * n; i++) out[i % n * n + i / n] = in[i];
}
static void expect_scan(const int32_t *in, int32_t *out, int n)
{
    for (int i = 0, sum = 0; i < n; i++) out[i] = sum += in[i];
}
static void expect_histogram(const int32_t *in, int32_t *out, int n)
{
    for (int i = 0; i < n; i++) out[in[i] & 15]++;
}
static void expect_hand_on(const int32_t *in, int32_t *out, int n)
{
    memcpy(out, in, 64 * sizeof *out);
    for (int round = 0; round < n; round++) {
        int32_t before[64];
        memcpy(before, out, sizeof before);
        for (int t = 0; t < 64; t++) out[t] += before[t / 32 * 32 + (t + 1) % 32];
    }
}
static void expect_words(const int32_t *in, int32_t *out, int n)
{
    unsigned char bytes[256];
    for (int t = 0; t < 256; t++) bytes[t] = (unsigned char)in[t];
    for (int t = 0; t < 256; t++) {
        unsigned short two;
        int32_t high;
        memcpy(&two, bytes + 2 * (t % 128), 2);
        memcpy(&high, bytes + 8 * (t % 32) + 4, 4);
        out[t] = two + in[4 * (t / 4 % (n / 4)) + 3] + high;
    }
}
static void expect_warps(const int32_t *in, int32_t *out, int n)
{
    int odd = 0, seven = 0;
    for (int t = 0; t < 64; t++) odd += in[t] & 1, seven |= in[t] == 7;
    for (int t = 0; t < 64; t++) {
        const int l = t % 32, h = l / 16 * 16;
        const int32_t *v = in + t / 32 * 32;
        int32_t *to = out + 32 * t;
        int32_t sum = 0, low = v[h], high = v[h], mix = 0, both = -1, either = 0, ballot = 0, any = 0, half = 0;
        for (int k = 0; k < 32; k++)
            sum += v[k], mix ^= v[k], ballot |= (int32_t)((uint32_t)(v[k] & 1) << k), any |= v[k] == 7;
        for (int k = h; k < h + 16; k++) {
            low = v[k] < low ? v[k] : low, high = v[k] > high ? v[k] : high;
            both &= v[k], either |= v[k], half += v[k];
        }
        const int32_t all[] = { v[5],
                                v[l ^ 3],
                                v[l / 8 * 8 + 1],
                                l >= 3 ? v[l - 3] : v[l],
                                l % 8 >= 3 ? v[l - 3] : v[l],
                                l + 3 < 32 ? v[l + 3] : v[l],
                                l % 4 < 3 ? v[l + 1] : v[l],
                                v[l ^ 16],
                                v[l ^ 3],
                                v[l ^ 15],
                                ballot,
                                any,
                                1,
                                sum,
                                low,
                                high,
                                mix,
                                both,
                                either,
                                odd,
                                1,
                                seven,
                                2 * v[31 - l] + 1,
                                l < 16 ? half : 0 };
        memcpy(to, all, sizeof all);
        for (int k = (int)(sizeof all / sizeof *all); k < 32; k++) to[k] = n;
    }
}

static int run_good(const void *argument)
{
    const good *g = argument;
    machine m;
    start(&m, images[0][g->checked]);
    MUST(cuMemsetD32Async(m.out, 0, N, m.stream));
    must(launch(&m, g->name, g->gx, g->gy, g->bx, g->by, g->shared, m.in, m.out, g->n), g->name);
    int32_t *got = malloc(BYTES);
    MUST(cuMemcpyDtoHAsync(got, m.out, BYTES, m.stream));
    for (size_t n = 0; n < BYTES;) {
        const ssize_t wrote = write(3, (char *)got + n, BYTES - n);
        if (wrote <= 0) return 4;
        n += (size_t)wrote;
    }
    free(got);
    finish(&m);
    return 0;
}

static void test_good(void **state)
{
    (void)state;
    if (!images[0][0]) skip();
    static const good all[] = { { "block_sum", 4, 1, 256, 1, 0, 2000, false, expect_sum },
                                { "transpose", 3, 3, 16, 8, 0, SIDE, false, expect_transpose },
                                { "scan", 1, 1, 1024, 1, 4096, 1000, false, expect_scan },
                                { "histogram", 5, 1, 128, 1, 0, N, false, expect_histogram },
                                { "warps", 1, 1, 64, 1, 0, 7, false, expect_warps },
                                { "hand_on", 1, 1, 64, 1, 0, 9, false, expect_hand_on },
                                { "words", 1, 1, 256, 1, 0, 256, false, expect_words } };
    int32_t *got = hg_alloc(N, 4), *expected = hg_alloc(N, 4), *in = hg_alloc(N, 4);
    for (int i = 0; i < N; i++) in[i] = (int)((unsigned)i * 2654435761u >> 20) % 100;
    for (size_t k = 0; k < sizeof all / sizeof *all; k++)
        for (int how = 0; how < 10; how++) {
            char said[SAID];
            good g = all[k];
            g.checked = how >= 5;
            order_is(how % 5 > 2 ? 2 : how % 5, how);
            memset(expected, 0, BYTES);
            g.expect(in, expected, g.n);
            const int status = apart(run_good, &g, said, got, BYTES);
            if (status != 0 || said[0])
                fail_msg("%s, order %d%s: %d %s", g.name, how % 5, g.checked ? ", checked" : "", status, said);
            for (int i = 0; i < N; i++)
                if (got[i] != expected[i])
                    fail_msg("%s, order %d%s: element %d is %d, not %d", g.name, how % 5, g.checked ? ", checked" : "",
                             i, got[i], expected[i]);
        }
    order_is(0, 1);
    hg_free(got);
    hg_free(expected);
    hg_free(in);
}

/* ---- seeded mistakes ---- */

typedef struct {
    const char *name;
    bool checked;
    unsigned blocks, threads, shared;
    int n;
    const char *says[3];
} bug;

static int run_bug(const void *argument)
{
    const bug *b = argument;
    machine m;
    CUdeviceptr exact; /* of exactly n numbers */
    start(&m, images[1][b->checked]);
    MUST(cuMemAlloc(&exact, 4 * (size_t)b->n));
    must(launch(&m, b->name, b->blocks, 1, b->threads, 1, b->shared, m.in, exact, b->n), b->name);
    MUST(cuStreamSynchronize(m.stream));
    return 0;
}

static void test_bugs(void **state)
{
    (void)state;
    if (!images[1][0]) skip();
    static const bug all[] = {
        { "removed_barrier", true, 1, 64, 0, 64, { "removed_barrier, block 0, thread", "race", "bugs.cu:10" } },
        { "removed_syncwarp", true, 1, 32, 0, 64, { "reads shared memory that no thread", "bugs.cu:23" } },
        { "race_in_block",
          true,
          1,
          64,
          0,
          64,
          { "race_in_block, block 0, thread", "race: it writes 4 bytes", "which thread" } },
        { "race_of_blocks", true, 4, 32, 0, 128, { "race_of_blocks, block", "race", "another block" } },
        { "race_with_atomic", true, 1, 64, 0, 64, { "race_with_atomic, block 0", "race", "atomic" } },
        { "off_by_one",
          false,
          1,
          128,
          0,
          64,
          { "off_by_one, block 0, thread 64: wrote to", "0 bytes after the end of an allocation of 256 bytes" } },
        { "off_by_one",
          true,
          1,
          128,
          0,
          50,
          { "off_by_one, block 0, thread 50: writes 4 bytes", "after the end of an allocation of 200 bytes",
            "bugs.cu:50" } },
        { "before_the_beginning", true, 1, 64, 0, 64, { "before_the_beginning, block 0, thread 0: reads 4 bytes" } },
        { "wrong_mask",
          false,
          1,
          32,
          0,
          64,
          { "wrong_mask, block 0, thread", "__shfl_down_sync at bugs.cu:63", "which has ended" } },
        { "mask_of_barrier",
          false,
          1,
          32,
          0,
          64,
          { "deadlock: __shfl_down_sync at bugs.cu:71", "__syncthreads at bugs.cu:72" } },
        { "mask_without_itself", false, 1, 32, 0, 64, { "does not name the thread itself (lane 16)" } },
        { "lane_outside", false, 1, 32, 0, 64, { "lane 8 reads from lane 16, which the mask 0000ffff does not name" } },
        { "mask_without_itself", false, 1, 16, 0, 64, { NULL } }, /* half a warp: all is well */
        { "wrong_mask", false, 1, 16, 0, 64, { "names threads that the block does not have" } },
        { "divergent_barrier",
          false,
          1,
          64,
          0,
          64,
          { "divergent barriers: __syncthreads at bugs.cu:9", "__syncthreads at bugs.cu:9" } },
        { "early_exit", false, 1, 64, 0, 60, { "early_exit, block 0", "waits for thread 60, which has ended" } },
        { "uninitialised_shared",
          true,
          1,
          64,
          0,
          64,
          { "uninitialised_shared, block 0, thread 63: reads shared memory that no thread" } },
        { "index_of_array",
          true,
          1,
          64,
          0,
          64,
          { "index_of_array, block 0, thread 33: undefined behaviour", "bugs.cu:120" } },
        { "beyond_dynamic_shared", false, 1, 64, 256, 64, { "beyond_dynamic_shared, block 0, thread 63: wrote to" } },
        { "beyond_dynamic_shared", true, 1, 64, 256, 64, { "0 bytes after the end of dynamic shared memory" } },
        { "misaligned", true, 1, 2, 0, 64, { "misaligned, block 0, thread 1: ", "misaligned" } },
        { "overflow", true, 1, 64, 0, 64, { "overflow, block 0, thread", "undefined behaviour" } },
        { "stack_of_another", true, 1, 64, 0, 64, { "of the stack of another thread" } },
        { "deep", false, 1, 1, 0, 64, { "deep, block 0, thread 0: its stack of 131072 bytes is full" } },
        { "divided_by_zero", false, 1, 64, 0, 64, { "divided_by_zero, block 0, thread 0", "divided by zero" } },
        { "failed_assertion",
          false,
          1,
          64,
          0,
          64,
          { "failed_assertion, block 0, thread 0: assert(in[threadIdx.x] < 0)" } },
    };
    for (size_t k = 0; k < sizeof all / sizeof *all; k++) {
        char said[SAID];
        const int status = apart(run_bug, &all[k], said, NULL, 0);
        if (status != (all[k].says[0] ? -SIGABRT : 0))
            fail_msg("%s%s was not found: %d %s", all[k].name, all[k].checked ? ", checked" : "", status, said);
        for (int i = 0; i < 3 && all[k].says[i]; i++)
            if (!strstr(said, all[k].says[i]))
                fail_msg("%s%s: \"%s\" is not in: %s", all[k].name, all[k].checked ? ", checked" : "", all[k].says[i],
                         said);
    }
}

/* Without checks a missing barrier shows as another result in some order, since shared memory is spoiled between blocks. */
static int run_unchecked(const void *argument)
{
    (void)argument;
    machine m;
    int32_t sum = 0, expected = 0;
    start(&m, images[1][0]);
    for (int i = 0; i < 64; i++) expected += m.host[i];
    must(launch(&m, "removed_barrier", 1, 1, 64, 1, 0, m.in, m.out, 64), "removed_barrier");
    MUST(cuMemcpyDtoHAsync(&sum, m.out, 4, m.stream));
    return sum != expected;
}

static void test_orders(void **state)
{
    (void)state;
    if (!images[1][0]) skip();
    char said[SAID];
    int wrong = 0;
    for (int order = 0; order < 3; order++) {
        order_is(order, 1);
        wrong += apart(run_unchecked, NULL, said, NULL, 0);
    }
    order_is(0, 1);
    assert_true(wrong > 0);
}

/* ---- the host's mistakes ---- */

typedef struct {
    const char *name;
    int (*run)(const void *);
    int status; /* how it ends */
    const char *says;
} mistake;

static int host_reads_device(const void *argument)
{
    (void)argument;
    machine m;
    start(&m, NULL);
    return *(volatile int *)(uintptr_t)m.in;
}
static int host_writes_device(const void *argument)
{
    (void)argument;
    machine m;
    start(&m, NULL);
    MUST(cuStreamSynchronize(m.stream));
    ((volatile int *)(uintptr_t)m.in)[3] = 1;
    return 0;
}
static int kernel_gets_host(const void *argument)
{
    (void)argument;
    machine m;
    start(&m, images[0][0]);
    uintptr_t host = (uintptr_t)&cuda; /* not one whose lower half could be a small number: those are let through */
    if ((uint32_t)host < 2u << 20 || (uint32_t)host > ~0u - (2u << 20)) host = (uintptr_t)&m;
    launch(&m, "add_one", 1, 1, 64, 1, 0, (CUdeviceptr)host, m.out, 64);
    return 0;
}
static int used_after_free(const void *argument)
{
    (void)argument;
    machine m;
    start(&m, images[0][0]);
    MUST(cuMemFree(m.out));
    launch(&m, "add_one", 1, 1, 64, 1, 0, m.in, m.out, 64);
    cuda.cuStreamSynchronize(m.stream);
    return 0;
}
static int freed_twice(const void *argument)
{
    (void)argument;
    machine m;
    start(&m, NULL);
    cuda.cuMemFree(m.in);
    cuda.cuMemFree(m.in);
    return 0;
}
static int freed_foreign(const void *argument)
{
    (void)argument;
    machine m;
    start(&m, NULL);
    cuda.cuMemFree((CUdeviceptr)(uintptr_t)m.host);
    return 0;
}
static int never_freed(const void *argument)
{
    (void)argument;
    machine m;
    start(&m, NULL);
    cuda.cuDevicePrimaryCtxRelease(0);
    return 0;
}
static int wrong_direction(const void *argument)
{
    (void)argument;
    machine m;
    start(&m, NULL);
    cuda.cuMemcpyHtoDAsync((CUdeviceptr)(uintptr_t)m.host, (void *)(uintptr_t)m.in, 64, m.stream);
    return 0;
}
static int too_much(const void *argument)
{
    (void)argument;
    machine m;
    start(&m, NULL);
    return (int)cuda.cuMemcpyHtoDAsync(m.in + 8, m.host, BYTES, m.stream) == 1 ? 0 : 9;
}
static int launch_sizes(const void *argument)
{
    (void)argument;
    machine m;
    start(&m, images[0][0]);
    if (launch(&m, "add_one", 1, 1, 1025, 1, 0, m.in, m.out, 64) != 1) return 9;
    if (launch(&m, "add_one", 0, 1, 64, 1, 0, m.in, m.out, 64) != 1) return 9;
    if (launch(&m, "add_one", 1, 70000, 64, 1, 0, m.in, m.out, 64) != 1) return 9;
    if (launch(&m, "add_one", 1, 1, 64, 1, 50000, m.in, m.out, 64) != 1) return 9;
    CUfunction function;
    MUST(cuModuleGetFunction(&function, m.module, "add_one"));
    MUST(cuFuncSetAttribute(function, CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES, 50000));
    return cuda.cuFuncSetAttribute(function, CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES, 1 << 20) == 1 ? 0 : 9;
}
static int unknown_kernel(const void *argument)
{
    (void)argument;
    machine m;
    CUfunction function;
    start(&m, images[0][0]);
    return cuda.cuModuleGetFunction(&function, m.module, "no_such") == 500 ? 0 : 9;
}
static int no_context(const void *argument)
{
    (void)argument;
    machine m;
    CUdeviceptr memory;
    start(&m, NULL);
    MUST(cuCtxSetCurrent(NULL));
    return cuda.cuMemAlloc(&memory, 64) == 201 ? 0 : 9;
}
static int unloaded(const void *argument)
{
    (void)argument;
    machine m;
    start(&m, images[0][0]);
    launch(&m, "add_one", 1, 1, 64, 1, 0, m.in, m.out, 64);
    cuda.cuModuleUnload(m.module); /* while the launch waits */
    cuda.cuStreamSynchronize(m.stream);
    return 0;
}
static int no_memory(const void *argument)
{
    (void)argument;
    machine m;
    CUdeviceptr memory;
    setenv("EMULATOR_MEMORY", "1000000", 1);
    start(&m, NULL);
    return cuda.cuMemAlloc(&memory, 2000000) == 2 ? 0 : 9;
}

static void test_host(void **state)
{
    (void)state;
    if (!images[0][0]) skip();
    static const mistake all[] = {
        { "host reads", host_reads_device, -SIGABRT, "the host read" },
        { "host writes", host_writes_device, -SIGABRT, "byte 12 of an allocation of 9216 bytes on the device" },
        { "host pointer", kernel_gets_host, -SIGABRT, "launch of add_one: argument 0, byte 0" },
        { "use after free", used_after_free, -SIGABRT, "add_one, block 0, thread 0: wrote to" },
        { "freed twice", freed_twice, -SIGABRT, "device memory that were freed" },
        { "freed foreign", freed_foreign, -SIGABRT, "which cuMemAlloc did not give: memory of the host" },
        { "never freed", never_freed, -SIGABRT, "2 allocations of device memory were not freed" },
        { "wrong direction", wrong_direction, -SIGABRT, "cuMemcpyHtoDAsync" },
        { "too much", too_much, 0, "cuMemcpyHtoDAsync of 9216 bytes" },
        { "launch sizes", launch_sizes, 0, "50000 bytes of shared memory, but 49152 are allowed" },
        { "unknown kernel", unknown_kernel, 0, "there is no kernel no_such in this module; there are: add_one" },
        { "no context", no_context, 0, "a thread without a context" },
        { "unloaded", unloaded, -SIGABRT, "add_one is launched, but its module has been unloaded" },
        { "no memory", no_memory, 0, NULL },
    };
    for (size_t k = 0; k < sizeof all / sizeof *all; k++) {
        char said[SAID];
        const int status = apart(all[k].run, NULL, said, NULL, 0);
        if (status != all[k].status) fail_msg("%s: it ended with %d: %s", all[k].name, status, said);
        if (all[k].says && !strstr(said, all[k].says))
            fail_msg("%s: \"%s\" is not in: %s", all[k].name, all[k].says, said);
    }
}

/* ---- streams, events, graphs ---- */

#define CHECK(truth_)                                                                                                  \
    if (!(truth_)) {                                                                                                   \
        fprintf(stderr, "line %d: %s\n", __LINE__, #truth_);                                                           \
        return 9;                                                                                                      \
    }

/* Work waits for whoever waits: a result that nobody waited for is not there. */
static int missing_wait(const void *argument)
{
    (void)argument;
    machine m;
    CUstream other;
    CUevent event;
    int32_t *pinned;
    start(&m, images[0][0]);
    MUST(cuMemAllocHost((void **)&pinned, BYTES));
    MUST(cuStreamCreate(&other, CU_STREAM_NON_BLOCKING));
    MUST(cuEventCreate(&event, CU_EVENT_DISABLE_TIMING));
    must(launch(&m, "add_one", 9, 1, 256, 1, 0, m.in, m.out, N), "add_one");
    MUST(cuMemcpyDtoHAsync(pinned, m.out, BYTES, other)); /* does not wait for the kernel */
    CHECK(pinned[5] == -1);
    MUST(cuStreamSynchronize(other));
    CHECK(pinned[5] == -1);
    MUST(cuEventRecord(event, m.stream));
    CHECK(cuda.cuEventQuery(event) == CUDA_ERROR_NOT_READY);
    MUST(cuStreamWaitEvent(other, event, 0));
    MUST(cuMemcpyDtoHAsync(pinned, m.out, BYTES, other));
    CHECK(pinned[5] == -1);
    MUST(cuStreamSynchronize(other));
    CHECK(pinned[5] == m.host[5] + 1);
    CHECK(cuda.cuEventQuery(event) == CUDA_SUCCESS);
    pinned[5] = 1000; /* pinned memory is read when the stream comes to it, other memory at once */
    m.host[6] = 2000;
    MUST(cuMemcpyHtoDAsync(m.in, pinned, BYTES, m.stream));
    pinned[5] = 3000;
    MUST(cuMemcpyHtoDAsync(m.out, m.host, BYTES, m.stream));
    m.host[6] = 4000;
    int32_t got[2];
    MUST(cuMemcpyDtoHAsync(&got[0], m.in + 20, 4, m.stream));
    MUST(cuMemcpyDtoHAsync(&got[1], m.out + 24, 4, m.stream));
    CHECK(got[0] == 3000 && got[1] == 2000);
    for (int i = 0; i < 100 && cuda.cuEventQuery(event) != CUDA_SUCCESS; i++) {
    }
    MUST(cuEventRecord(event, other));
    MUST(cuEventSynchronize(event));
    MUST(cuEventDestroy(event));
    MUST(cuStreamDestroy(other));
    MUST(cuMemFreeHost(pinned));
    finish(&m);
    return 0;
}

static int graphs(const void *argument)
{
    (void)argument;
    machine m;
    CUgraph graph, longer;
    CUgraphExec exec;
    CUgraphExecUpdateResultInfo info;
    int32_t *pinned;
    start(&m, images[0][0]);
    MUST(cuMemAllocHost((void **)&pinned, BYTES));
    MUST(cuStreamSynchronize(m.stream));
    memcpy(pinned, m.host, BYTES);
    for (int times = 1; times <= 2; times++) {
        MUST(cuStreamBeginCapture(m.stream, CU_STREAM_CAPTURE_MODE_THREAD_LOCAL));
        MUST(cuMemcpyHtoDAsync(m.in, pinned, BYTES, m.stream));
        must(launch(&m, "add_one", 9, 1, 256, 1, 0, m.in, m.out, N), "add_one");
        if (times == 2) must(launch(&m, "add_one", 9, 1, 256, 1, 0, m.out, m.in, N), "add_one");
        MUST(cuMemcpyDtoHAsync(pinned, m.out, BYTES, m.stream));
        MUST(cuStreamEndCapture(m.stream, times == 1 ? &graph : &longer));
    }
    CHECK(pinned[7] == m.host[7]); /* recorded, not run */
    MUST(cuGraphInstantiate(&exec, graph, 0));
    for (int step = 0; step < 5; step++) MUST(cuGraphLaunch(exec, m.stream));
    MUST(cuStreamSynchronize(m.stream));
    CHECK(pinned[7] == m.host[7] + 5);
    MUST(cuGraphExecUpdate(exec, graph, &info));
    CHECK(info.result == 0);
    CHECK(cuda.cuGraphExecUpdate(exec, longer, &info) == 910 && info.result == 2);
    MUST(cuGraphDestroy(graph));
    MUST(cuGraphDestroy(longer));
    MUST(cuGraphLaunch(exec, m.stream));
    MUST(cuStreamSynchronize(m.stream));
    CHECK(pinned[7] == m.host[7] + 6);
    MUST(cuGraphExecDestroy(exec));
    MUST(cuMemFreeHost(pinned));
    finish(&m);
    return 0;
}

static int forbidden_in_capture(const void *argument)
{
    (void)argument;
    machine m;
    CUgraph graph;
    CUdeviceptr memory;
    start(&m, images[0][0]);
    MUST(cuStreamBeginCapture(m.stream, CU_STREAM_CAPTURE_MODE_THREAD_LOCAL));
    CHECK(cuda.cuMemAlloc(&memory, 64) == 900);
    CHECK(launch(&m, "add_one", 9, 1, 256, 1, 0, m.in, m.out, N) == 901);
    CHECK(cuda.cuStreamEndCapture(m.stream, &graph) == 901 && graph == NULL);
    MUST(cuStreamBeginCapture(m.stream, CU_STREAM_CAPTURE_MODE_THREAD_LOCAL));
    CHECK(cuda.cuStreamSynchronize(m.stream) == 900);
    CHECK(cuda.cuStreamEndCapture(m.stream, &graph) == 901);
    MUST(cuStreamBeginCapture(m.stream, CU_STREAM_CAPTURE_MODE_THREAD_LOCAL));
    CHECK(cuda.cuMemFree(m.in) == 900);
    CHECK(cuda.cuStreamEndCapture(m.stream, &graph) == 901);
    finish(&m);
    return 0;
}

static void test_streams(void **state)
{
    (void)state;
    if (!images[0][0]) skip();
    static const mistake all[] = { { "a missing wait", missing_wait, 0, NULL },
                                   { "graphs", graphs, 0, NULL },
                                   { "capture", forbidden_in_capture, 0, "cuMemAlloc while a stream is captured" } };
    for (size_t k = 0; k < sizeof all / sizeof *all; k++) {
        char said[SAID];
        const int status = apart(all[k].run, NULL, said, NULL, 0);
        if (status != 0) fail_msg("%s: it ended with %d: %s", all[k].name, status, said);
        if (all[k].says && !strstr(said, all[k].says))
            fail_msg("%s: \"%s\" is not in: %s", all[k].name, all[k].says, said);
    }
}

/* Without protection keys pages are opened and closed: the same must be found. */
static void test_no_keys(void **state)
{
    setenv("EMULATOR_NO_KEYS", "1", 1);
    test_host(state);
    test_streams(state);
    unsetenv("EMULATOR_NO_KEYS");
}

/* ---- what does not compile ---- */

static void test_refused(void **state)
{
    (void)state;
    if (!images[0][0]) skip();
    hg_free(compile("#include \"some/header.h\"\nextern \"C\" __global__ void a(float *x) { x[0] = IN_HEADER; }\n",
                    "a.cu", false, NULL));
    compile("extern \"C\" __global__ void a(float *x)\n{\n    atomicAdd(x, 1.0f);\n}\n", "a.cu", false,
            "atomics on floating-point numbers");
    compile("extern \"C\" __global__ void a(unsigned *x)\n{\n    *x = __activemask();\n}\n", "a.cu", false, "a.cu:3");
    compile("extern \"C\" __global__ void a(int *x)\n{\n    *y = 1;\n}\n", "a.cu", false, "a.cu:3:6: error");
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(test_good),    cmocka_unit_test(test_bugs),
                                        cmocka_unit_test(test_orders),  cmocka_unit_test(test_host),
                                        cmocka_unit_test(test_streams), cmocka_unit_test(test_no_keys),
                                        cmocka_unit_test(test_refused) };
    return cmocka_run_group_tests(tests, open_all, close_all);
}
