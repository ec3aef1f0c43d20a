/* A CUDA device: copies, launches, a step that is recorded and replayed, memory that is not there, the cache of compiled kernels,
 * several contexts and threads, and what is said where there is no device. On the emulated GPU, or a real one. */
#include "device.h"
#include "test.h"

#define HG_KERNEL_SOURCE hg_kernel_text
#include "tensor/kernel.h"

#include <pthread.h>
#include <sys/wait.h>

/* The args have padding on purpose: what is in it must not keep a step from being replayed. */
HG_KERNEL_TEXT(
    typedef struct {
        const float *x;
        char sign;
        float scale;
        float *y;
        short add;
    } line_args;
    HG_BODY void line(const line_args *p, int64_t first, int64_t last) {
        for (int64_t i = first; i < last; i++) p->y[i] = p->scale * p->x[i] * (float)p->sign + (float)p->add;
    } HG_KERNEL(line, line_args, 64))

static bool no_device(void)
{
    if (test_device()) return false;
    print_message("HG_TEST_DEVICE names no device\n");
    return true;
}
#define NEEDS_DEVICE()                                                                                                 \
    (void)state;                                                                                                       \
    if (no_device()) skip()

static bool emulated(void)
{
    const char *path = getenv("LD_LIBRARY_PATH");
    return path && strstr(path, "emulator");
}

static hg_ctx *make_ctx(void)
{
    hg_ctx *ctx = NULL;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .seed = 7, .device = test_device() }) != HG_OK)
        print_message("%s\n", hg_message());
    assert_non_null(ctx);
    return ctx;
}

static hg_tensor *own(hg_ctx *ctx, int64_t n)
{
    hg_tensor *tensor = hg_tensor_create(ctx, HG_F32, 1, &n);
    assert_non_null(tensor);
    return tensor;
}

static void run_line(hg_ctx *ctx, const hg_tensor *x, float scale, int add, hg_tensor *y)
{
    line_args args;
#if HG_CLEARS_PADDING
    memset(&args, rand() & 0xff, sizeof args);
#else
    memset(&args, 0, sizeof args);
#endif
    args.x = x->data, args.sign = 1, args.scale = scale, args.y = y->data, args.add = (short)add;
    assert_int_equal(hg_launch(ctx, &line_kernel, hg_tensor_count(y), &args), HG_OK);
}

/* ---- memory ---- */

static void test_copies(void **state)
{
    NEEDS_DEVICE();
    hg_ctx *ctx = make_ctx();
    assert_false(hg_ctx_host(ctx));
    assert_string_equal(hg_ctx_device(ctx), "cuda");
    assert_non_null(strstr(hg_ctx_device_what(ctx), "compute capability"));
    static const int64_t sizes[] = { 0, 1, 77, (5 << 18) + 3, 20 << 20 }; /* the last: more than all pinned memory */
    for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++) {
        const int64_t n = sizes[s];
        float *numbers = hg_alloc((size_t)n + 1, sizeof *numbers), *back = hg_alloc((size_t)n + 1, sizeof *back);
        hg_tensor *a = own(ctx, n), *b = own(ctx, n);
        for (int64_t i = 0; i < n; i++) numbers[i] = (float)(i % 1000003);
        assert_int_equal(hg_tensor_write(a, numbers), HG_OK);
        for (int64_t i = 0; i < n; i++) numbers[i] = -1; /* the caller's memory is free again at once */
        hg_tensor *c = hg_tensor_from(ctx, HG_F32, 1, &n, numbers);
        assert_non_null(c);
        memset(numbers, 0xff, (size_t)n * sizeof *numbers);
        assert_int_equal(hg_tensor_copy(b, a), HG_OK);
        assert_int_equal(hg_tensor_read(b, back), HG_OK);
        int64_t wrong = 0;
        for (int64_t i = 0; i < n; i++) wrong += back[i] != (float)(i % 1000003);
        assert_int_equal(hg_tensor_read(c, back), HG_OK);
        for (int64_t i = 0; i < n; i++) wrong += back[i] != -1;
        assert_int_equal(wrong, 0);
        if (n) assert_true(hg_tensor_item(a, n - 1) == (double)((n - 1) % 1000003));
        hg_step_reset(ctx);
        hg_tensor_destroy(a);
        hg_tensor_destroy(b);
        hg_free(numbers);
        hg_free(back);
    }
    const hg_device_counts counts = hg_ctx_counts(ctx);
    assert_true(counts.uploaded >= (int64_t)sizeof(float) * (20 << 20) && counts.downloaded >= counts.uploaded);
    assert_int_equal(hg_ctx_wait(ctx), HG_OK);
    hg_ctx_destroy(ctx);
}

static void test_out_of_memory(void **state)
{
    NEEDS_DEVICE();
    hg_ctx *ctx = make_ctx();
    const int64_t many = (int64_t)1 << 40;
    assert_null(hg_tensor_create(ctx, HG_F32, 1, &many));
    assert_int_equal(hg_ctx_status(ctx), HG_MEMORY);
    assert_non_null(strstr(hg_ctx_message(ctx), "4398046.5 MB were asked for, the device has "));
    hg_ctx_clear(ctx);
    assert_null(hg_tensor_make(ctx, HG_F32, 1, &many));
    assert_non_null(strstr(hg_ctx_message(ctx), "f32 [1099511627776]"));
    assert_non_null(strstr(hg_ctx_message(ctx), "4398046.5 MB were asked for, the device has "));
    hg_ctx_clear(ctx);
    assert_null(hg_step_device(ctx, (size_t)1 << 42));
    assert_non_null(strstr(hg_ctx_message(ctx), "MB were asked for, the device has "));
    hg_ctx_clear(ctx);
    hg_tensor *small = hg_tensor_make(ctx, HG_F32, 1, &(int64_t){ 10 }); /* and there is life after it */
    assert_non_null(small);
    assert_int_equal(hg_tensor_fill(small, 3), HG_OK);
    assert_true(hg_tensor_item(small, 9) == 3);
    hg_ctx_destroy(ctx);
}

/* ---- launches ---- */

static void test_launch_errors(void **state)
{
    NEEDS_DEVICE();
    hg_ctx *ctx = make_ctx();
    static const hg_kernel wide = {
        .name = "line", .cuda = hg_kernel_text, .args_size = sizeof(line_args), .threads = 4096
    };
    hg_tensor *x = own(ctx, 8);
    const line_args args = { .x = x->data, .y = x->data };
    assert_int_not_equal(hg_launch(ctx, &wide, 8, &args), HG_OK);
    assert_non_null(strstr(hg_ctx_message(ctx), "cuda: line: CUDA_ERROR_"));
    hg_ctx_clear(ctx);
    static const hg_kernel none = { .name = "only_here", .args_size = sizeof(line_args), .cpu = line_cpu };
    assert_false(hg_launches(ctx, &none));
    assert_int_equal(hg_launch(ctx, &none, 8, &args), HG_UNSUPPORTED);
    assert_non_null(strstr(hg_ctx_message(ctx), "only_here"));
    hg_ctx_clear(ctx);
    static const hg_kernel missing = { .name = "missing", .cuda = hg_kernel_text, .args_size = sizeof(line_args) };
    assert_int_not_equal(hg_launch(ctx, &missing, 8, &args), HG_OK);
    assert_non_null(strstr(hg_ctx_message(ctx), "missing_cuda"));
    hg_ctx_clear(ctx);
    static const hg_kernel unknown = { .name = "unknown",
                                       .cuda = "nowhere/unknown.kernel.h",
                                       .args_size = sizeof(line_args) };
    assert_false(hg_launches(ctx, &unknown));
    assert_int_equal(hg_launch(ctx, &unknown, 8, &args), HG_UNSUPPORTED);
    assert_non_null(strstr(hg_ctx_message(ctx), "nowhere/unknown.kernel.h"));
    hg_ctx_clear(ctx);
    static const hg_kernel wrong = { .name = "wrong",
                                     .cuda = "HG_BODY void wrong(int x) { no_such_word; }",
                                     .args_size = sizeof(line_args) };
    assert_int_equal(hg_launch(ctx, &wrong, 8, &args), HG_UNSUPPORTED);
    assert_non_null(strstr(hg_ctx_message(ctx), "wrong (a text of its own) does not compile"));
    assert_non_null(strstr(hg_ctx_message(ctx), "no_such_word"));
    hg_ctx_clear(ctx);
    run_line(ctx, x, 2, 1, x);
    assert_true(hg_tensor_item(x, 7) == 1);
    hg_tensor_destroy(x);
    hg_ctx_destroy(ctx);
}

/* An error of a kernel is heard of later: what was launched since the last wait is named. */
static void test_late_errors(void **state)
{
    NEEDS_DEVICE();
    if (!emulated()) skip();
    hg_ctx *ctx = make_ctx();
    hg_tensor *x = own(ctx, 8);
    float numbers[8];
    assert_int_equal(hg_ctx_wait(ctx), HG_OK);
    run_line(ctx, x, 1, 1, x);
    setenv("EMULATOR_FAIL", "1", 1);
    assert_int_equal(hg_ctx_wait(ctx), HG_NUMERIC);
    assert_non_null(strstr(hg_ctx_message(ctx), "cuda: line: CUDA_ERROR_UNKNOWN"));
    hg_ctx_clear(ctx);
    for (int i = 0; i < 3; i++) run_line(ctx, x, 1, 1, x);
    assert_int_equal(hg_tensor_read(x, numbers), HG_NUMERIC);
    assert_non_null(
        strstr(hg_message(), "cuda: one of the last 3 kernels and products, which end with line: CUDA_ERROR_"));
    assert_int_equal(hg_step_record(ctx), HG_OK);
    run_line(ctx, x, 1, 1, x);
    assert_int_equal(hg_step_run(ctx), HG_OK);
    assert_int_equal(hg_ctx_wait(ctx), HG_NUMERIC);
    assert_non_null(strstr(hg_ctx_message(ctx), "cuda: line: "));
    hg_ctx_clear(ctx);
    unsetenv("EMULATOR_FAIL");
    assert_int_equal(hg_tensor_read(x, numbers), HG_OK);
    assert_true(numbers[0] == 5);
    hg_tensor_destroy(x);
    hg_ctx_destroy(ctx);
}

/* Kernels come and go, at addresses that were another's before. */
static void test_kernels_by_address(void **state)
{
    NEEDS_DEVICE();
    enum { KERNELS = 150 };
    hg_ctx *ctx = make_ctx();
    hg_text text = { 0 };
    char(*names)[16] = hg_alloc(KERNELS, sizeof *names);
    hg_kernel *kernels = hg_alloc(KERNELS, sizeof *kernels);
    hg_text_add(&text, "typedef struct { float *y; } put_args;\n");
    for (int i = 0; i < KERNELS; i++) {
        snprintf(names[i], sizeof names[i], "k%d", i);
        hg_text_add(&text,
                    "HG_BODY void k%d(const put_args *p, int64_t i, int64_t last) { p->y[i] = %d; }\n"
                    "HG_KERNEL(k%d, put_args, 1)\n",
                    i, i, i);
        kernels[i] = (hg_kernel){ .name = names[i], .args_size = sizeof(float *) };
    }
    for (int i = 0; i < KERNELS; i++) kernels[i].cuda = text.data;
    hg_tensor *y = own(ctx, 3);
    for (int round = 0; round < 3; round++) {
        for (int i = 0; i < KERNELS; i++) {
            assert_int_equal(hg_launch(ctx, &kernels[i], 3, &y->data), HG_OK);
            if (i % 7 == 0) assert_true(hg_tensor_item(y, 2) == atoi(kernels[i].name + 1));
        }
        for (int i = round; i < KERNELS - 3; i += 2) { /* two kernels exchange their places */
            hg_kernel_release(ctx, &kernels[i]);
            hg_kernel_release(ctx, &kernels[i + 3]);
            const hg_kernel other = kernels[i];
            kernels[i] = kernels[i + 3];
            kernels[i + 3] = other;
        }
    }
    for (int i = 0; i < KERNELS; i++) hg_kernel_release(ctx, &kernels[i]);
    hg_kernel_release(ctx, &kernels[0]); /* again: nothing */
    text.data[0] = 0;                    /* the text may go now */
    hg_text_free(&text);
    hg_free(kernels);
    hg_free(names);
    hg_tensor_destroy(y);
    hg_ctx_destroy(ctx);
}

/* ---- record and replay ---- */

enum { N = 300, STEPS = 12 };
typedef struct {
    hg_ctx *ctx;
    hg_tensor *weights, *moment;
    bool record;
    float seen[STEPS][4];
} training;

/* A step as a training has them: what changes comes from the host, some of it after launches that read the same memory. */
static void one_step(training *t, int step, int64_t n, bool read, bool scratch)
{
    hg_ctx *ctx = t->ctx;
    float numbers[N];
    const int64_t side = 10, all = N;
    hg_step_reset(ctx);
    if (t->record) assert_int_equal(hg_step_record(ctx), HG_OK);
    for (int i = 0; i < N; i++) numbers[i] = (float)(i % 13) + 0.25f * (float)step;
    hg_tensor *x = hg_tensor_from(ctx, HG_F32, 1, &all, numbers);
    hg_tensor *y = hg_tensor_make(ctx, HG_F32, 1, &all), *z = hg_tensor_make(ctx, HG_F32, 1, &all);
    assert_non_null(z);
    assert_int_equal(hg_tensor_fill(y, 0.5), HG_OK);
    run_line(ctx, x, 0.125f, 3, y);
    for (int i = 0; i < N; i++) numbers[i] = (float)step - (float)(i % 7);
    assert_int_equal(hg_tensor_write(x, numbers), HG_OK); /* behind a launch that reads it */
    memset(numbers, 0, sizeof numbers);
    assert_int_equal(hg_tensor_copy(z, y), HG_OK);
    assert_int_equal(hg_product(ctx, HG_F32, false, true, side, side, side, 0.01, x->data, side, y->data, side, 1,
                                t->weights->data, side),
                     HG_OK);
    if (scratch) { /* memory that is given back within the step, and used for something else */
        const hg_step_mark mark = hg_step_set_mark(ctx);
        hg_tensor *s = hg_tensor_make(ctx, HG_F32, 1, &all);
        run_line(ctx, x, 2, 0, s);
        run_line(ctx, s, 0.5f, step % 2, z);
        hg_step_rewind(ctx, mark);
        for (int i = 0; i < N; i++) numbers[i] = (float)i;
        hg_tensor *again = hg_tensor_from(ctx, HG_F32, 1, &all, numbers);
        assert_ptr_equal(again->data, s->data);
        run_line(ctx, again, 1e-3f, 0, y);
    }
    if (read) t->seen[step][0] = (float)hg_tensor_item(t->weights, 3);
    hg_tensor *view = hg_tensor_rows(ctx, t->moment, 0, n);
    run_line(ctx, t->weights, 0.5f, 1, view);
    assert_int_equal(hg_product(ctx, HG_F32, false, false, side, side, side, 1e-3, t->weights->data, side,
                                t->moment->data, side, 0.5, t->weights->data, side),
                     HG_OK);
    run_line(ctx, z, 1, 0, t->moment);
    if (t->record) assert_int_equal(hg_step_run(ctx), HG_OK);
    t->seen[step][1] = (float)hg_tensor_item(t->weights, 42);
    t->seen[step][2] = (float)hg_tensor_item(t->moment, 17);
    t->seen[step][3] = (float)hg_tensor_item(z, 99);
}

static void compare_runs(int64_t (*size)(int step), bool (*read)(int step), bool scratch, int64_t expected_replays)
{
    training t[2];
    float numbers[N];
    for (int k = 0; k < 2; k++) {
        memset(&t[k], 0, sizeof t[k]);
        t[k].ctx = make_ctx();
        t[k].record = k;
        t[k].weights = own(t[k].ctx, N);
        t[k].moment = own(t[k].ctx, N);
        for (int i = 0; i < N; i++) numbers[i] = (float)(i * 37 % 101) / 100;
        assert_int_equal(hg_tensor_write(t[k].weights, numbers), HG_OK);
        int64_t taken = 0;
        size_t reserved = 0;
        hg_device_counts before = { 0 };
        for (int step = 0; step < STEPS; step++) {
            one_step(&t[k], step, size(step), read(step), scratch);
            if (step == STEPS - 2) {
                taken = hg_alloc_count();
                reserved = hg_step_reserved(t[k].ctx);
                before = hg_ctx_counts(t[k].ctx);
            }
        }
        const hg_device_counts counts = hg_ctx_counts(t[k].ctx);
        assert_int_equal(hg_alloc_count(), taken);
        assert_int_equal(hg_step_reserved(t[k].ctx), reserved);
        assert_int_equal(counts.launches - before.launches, scratch ? 10 : 7);
        assert_int_equal(counts.uploaded - before.uploaded, (scratch ? 3 : 2) * N * (int)sizeof(float));
        if (!t[k].record)
            assert_int_equal(counts.replays, 0);
        else
            assert_int_equal(counts.replays, expected_replays);
        int reads = 0;
        for (int step = 0; step < STEPS; step++) reads += t[k].record && read(step);
        assert_int_equal(counts.waits, reads);
        hg_tensor_destroy(t[k].weights);
        hg_tensor_destroy(t[k].moment);
        hg_ctx_destroy(t[k].ctx);
    }
    assert_memory_equal(t[0].seen, t[1].seen, sizeof t[0].seen);
    for (int step = 1; step < STEPS; step++) assert_true(t[0].seen[step][1] != t[0].seen[step - 1][1]);
}

static int64_t same_size(int step) { return (void)step, 100; }
static int64_t other_size(int step) { return 100 + step % 12; }
static int64_t late_size(int step) { return step < 6 ? 100 : 120; }
static bool never(int step) { return (void)step, false; }
static bool always(int step) { return (void)step, true; }

static void test_replay(void **state)
{
    NEEDS_DEVICE();
    compare_runs(same_size, never, false, STEPS - 1);        /* the first step as it comes, all others as a graph */
    compare_runs(late_size, never, false, STEPS - 2);        /* once more where it changed */
    compare_runs(other_size, never, false, 0);               /* every step another one: none */
    compare_runs(same_size, always, false, 2 * (STEPS - 1)); /* two graphs a step */
    if (emulated()) {                                        /* what cannot be captured is run call by call */
        setenv("EMULATOR_NO_CAPTURE", "1", 1);
        compare_runs(same_size, never, false, 0);
        unsetenv("EMULATOR_NO_CAPTURE");
    }
    compare_runs(same_size, never, true, 0); /* arguments that change: none */
}

static void test_record_ends(void **state)
{
    NEEDS_DEVICE();
    hg_ctx *ctx = make_ctx();
    hg_tensor *x = own(ctx, 100), *y = own(ctx, 100);
    assert_int_equal(hg_tensor_fill(x, 1), HG_OK);
    assert_int_equal(hg_step_run(ctx), HG_OK); /* nothing was recorded */
    assert_int_equal(hg_step_record(ctx), HG_OK);
    assert_int_equal(hg_step_run(ctx), HG_OK); /* an empty step */
    for (int i = 0; i < 4; i++) {
        assert_int_equal(hg_step_record(ctx), HG_OK);
        run_line(ctx, x, 2, 0, y);
        hg_tensor *gone = own(ctx, 100);
        run_line(ctx, y, 2, 0, gone);
        run_line(ctx, gone, 2, 0, y);
        hg_tensor_destroy(gone); /* runs what uses it first */
        assert_int_equal(hg_step_run(ctx), HG_OK);
        assert_true(hg_tensor_item(y, 99) == 8);
    }
    /* a step that an error ended: the next begins behind what was kept */
    assert_int_equal(hg_step_record(ctx), HG_OK);
    run_line(ctx, x, 3, 0, y);
    static const hg_kernel none = { .name = "only_here", .args_size = 8, .cpu = line_cpu };
    assert_int_not_equal(hg_launch(ctx, &none, 1, &x->data), HG_OK);
    hg_ctx_clear(ctx);
    hg_step_reset(ctx);
    assert_int_equal(hg_step_record(ctx), HG_OK);
    run_line(ctx, y, 5, 0, x);
    assert_int_equal(hg_step_run(ctx), HG_OK);
    assert_true(hg_tensor_item(x, 0) == 15);
    /* an error that memory being freed comes upon is told at the end, and what is behind it is not run */
    static const hg_kernel wide = {
        .name = "line", .cuda = hg_kernel_text, .args_size = sizeof(line_args), .threads = 4096
    };
    const line_args args = { .x = x->data, .y = x->data };
    hg_tensor *gone = own(ctx, 100);
    assert_int_equal(hg_step_record(ctx), HG_OK);
    assert_int_equal(hg_launch(ctx, &wide, 8, &args), HG_OK);
    hg_tensor_destroy(gone);
    run_line(ctx, y, 7, 0, x);
    hg_tensor_destroy(own(ctx, 100));
    assert_int_equal(hg_step_run(ctx), HG_NUMERIC);
    assert_non_null(strstr(hg_ctx_message(ctx), "cuda: line: CUDA_ERROR_"));
    hg_ctx_clear(ctx);
    assert_true(hg_tensor_item(x, 0) == 15);
    assert_int_equal(hg_step_record(ctx), HG_OK); /* destroyed in the middle of one */
    run_line(ctx, y, 5, 0, x);
    hg_tensor_destroy(x);
    hg_tensor_destroy(y);
    hg_ctx_destroy(ctx);
}

/* ---- contexts and threads ---- */

static void test_two_contexts(void **state)
{
    NEEDS_DEVICE();
    hg_ctx *a = make_ctx(), *b = make_ctx();
    hg_tensor *x = own(a, 1000), *y = own(b, 1000);
    for (int i = 0; i < 3; i++) {
        assert_int_equal(hg_step_record(a), HG_OK);
        run_line(a, x, 1, 1, x);
        assert_int_equal(hg_tensor_fill(y, 5), HG_OK); /* the other records nothing */
        run_line(b, y, 1, i, y);
        assert_true(hg_tensor_item(y, 999) == 5 + i);
        assert_int_equal(hg_step_run(a), HG_OK);
    }
    assert_true(hg_tensor_item(x, 999) == 3);
    hg_tensor_destroy(x);
    hg_ctx_destroy(a);
    run_line(b, y, 2, 0, y);
    assert_true(hg_tensor_item(y, 0) == 14);
    hg_tensor_destroy(y);
    hg_ctx_destroy(b);
}

static void *work(void *memory)
{
    hg_ctx *ctx = memory;
    hg_tensor *x = hg_tensor_create(ctx, HG_F32, 1, &(int64_t){ 100 });
    double *found = malloc(sizeof *found);
    *found = -1;
    if (x && found) {
        const line_args args = { .x = x->data, .y = x->data, .sign = 1, .scale = 1, .add = 4 };
        hg_launch(ctx, &line_kernel, 100, &args);
        hg_product(ctx, HG_F32, false, false, 10, 10, 10, 1, x->data, 10, x->data, 10, 1, x->data, 10);
        *found = hg_tensor_item(x, 0);
    }
    hg_tensor_destroy(x);
    return found;
}

/* A context is its maker's or another thread's, one at a time. */
static void test_threads(void **state)
{
    NEEDS_DEVICE();
    hg_ctx *ctx = make_ctx();
    for (int i = 0; i < 2; i++) {
        pthread_t thread;
        void *result;
        assert_int_equal(pthread_create(&thread, NULL, work, ctx), 0);
        assert_int_equal(pthread_join(thread, &result), 0);
        assert_true(*(double *)result > 0);
        free(result);
        result = work(ctx);
        assert_true(*(double *)result > 0);
        free(result);
    }
    hg_ctx_destroy(ctx);
}

/* ---- the cache on disk ---- */

static char *only_file(const char *folder)
{
    char *found = NULL;
    int count = 0;
    DIR *open = opendir(folder);
    for (struct dirent *entry; open && (entry = readdir(open));)
        if (entry->d_name[0] != '.') {
            hg_free(found);
            found = hg_path_join(folder, entry->d_name);
            count++;
        }
    if (open) closedir(open);
    assert_int_equal(count, 1);
    return found;
}

static void use_once(void)
{
    hg_ctx *ctx = make_ctx();
    hg_tensor *x = hg_tensor_make(ctx, HG_F32, 1, &(int64_t){ 10 });
    const line_args args = { .x = x->data, .y = x->data, .sign = 1, .scale = 0, .add = 6 };
    assert_int_equal(hg_launch(ctx, &line_kernel, 10, &args), HG_OK);
    hg_ctx_destroy(ctx);
}

static void test_cache(void **state)
{
    NEEDS_DEVICE();
    const char *usual = getenv("HAIRGRAD_CACHE");
    char *before = usual ? hg_strdup(usual) : NULL, *folder = test_path("cache");
    setenv("HAIRGRAD_CACHE", folder, 1);
    use_once();
    char *path = only_file(folder);
    void *good, *now;
    size_t size, size_now;
    assert_int_equal(hg_file_read(path, &good, &size), HG_OK);
    struct stat first, second;
    assert_int_equal(stat(path, &first), 0);
    use_once(); /* taken from there */
    assert_int_equal(stat(path, &second), 0);
    assert_true(first.st_ino == second.st_ino && first.st_mtim.tv_nsec == second.st_mtim.tv_nsec);
    for (int damage = 0; damage < 5; damage++) {
        unsigned char *bytes = hg_alloc(size, 1);
        memcpy(bytes, good, size);
        size_t left = size;
        if (damage == 0) bytes[size / 2] ^= 1;     /* a bit */
        if (damage == 1) left = size / 2;          /* cut short */
        if (damage == 2) left = 0;                 /* empty */
        if (damage == 3) memset(bytes, 'x', size); /* something else */
        if (damage == 4) bytes[size - 1] ^= 0x80;  /* the seal */
        assert_int_equal(hg_file_write(path, bytes, left), HG_OK);
        use_once();
        assert_int_equal(hg_file_read(path, &now, &size_now), HG_OK);
        assert_true(size_now > 100 && (size_now != left || memcmp(now, bytes, left) != 0)); /* made again */
        hg_free(now);
        hg_free(bytes);
    }
    hg_free(good);
    char *elsewhere = test_path("elsewhere");
    assert_int_equal(rename(path, elsewhere), 0);
    assert_int_equal(symlink(elsewhere, path), 0); /* a link is not trusted */
    use_once();
    assert_int_equal(lstat(path, &first), 0);
    assert_true(S_ISREG(first.st_mode));
    hg_free(elsewhere);
    hg_free(path);
    hg_free(folder);
    folder = test_path("a-file"); /* no folder at all: it costs time */
    assert_int_equal(hg_file_write(folder, "x", 1), HG_OK);
    setenv("HAIRGRAD_CACHE", folder, 1);
    use_once();
    hg_free(folder);
    if (before)
        setenv("HAIRGRAD_CACHE", before, 1);
    else
        unsetenv("HAIRGRAD_CACHE");
    hg_free(before);
}

/* ---- no device ---- */

static void test_names(void **state)
{
    (void)state;
    hg_ctx *ctx;
    static const char *const wrong[] = { "gpu", "cuda:", "cuda:x", "cuda:1x", "cuda:-1", "CUDA" };
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .device = wrong[i] }), HG_UNSUPPORTED);
        assert_null(ctx);
        assert_non_null(strstr(hg_message(), "cpu, cuda, cuda:NUMBER and auto are"));
    }
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .device = "cuda:1000" }), HG_UNSUPPORTED);
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .device = "auto" }), HG_OK); /* always something */
    hg_ctx_destroy(ctx);
    hg_device_info infos[3];
    assert_true(hg_devices(NULL, 0) >= 2);
    assert_true(hg_devices(infos, 3) >= 2);
    assert_string_equal(infos[0].name, "cpu");
    assert_true(infos[0].memory > 0);
    if (!test_device()) return;
    assert_string_equal(infos[1].why, "");
    assert_true(infos[1].memory > 0);
    assert_non_null(strstr(infos[1].versions, "NVRTC"));
}

/* The libraries are opened once in a process: this program again, with `setting`, says why there is no device. */
static void refused(const char *setting, const char *expected)
{
    char path[4096], answer[1024] = "";
    const ssize_t length = readlink("/proc/self/exe", path, sizeof path - 1);
    assert_true(length > 0);
    path[length] = 0;
    char *command = hg_format("%s '%s' --why", setting, path);
    FILE *pipe = popen(command, "r");
    assert_non_null(pipe);
    const size_t n = fread(answer, 1, sizeof answer - 1, pipe);
    answer[n] = 0;
    assert_int_equal(pclose(pipe), 0);
    hg_free(command);
    if (!strstr(answer, expected)) print_message("%s: %s", setting, answer);
    assert_non_null(strstr(answer, expected));
}

static void test_refusals(void **state)
{
    NEEDS_DEVICE();
    if (!emulated()) skip();
    refused("", "cuda works");
    refused("EMULATOR_NO_DEVICE=1", "the NVIDIA driver found no GPU that it can use (cuInit: CUDA_ERROR_NO_DEVICE)");
    refused("EMULATOR_DRIVER=11080", "the NVIDIA driver is for CUDA 11.8: one for 12.0 or later is needed");
    refused("EMULATOR_DRIVER=12040", "libnvrtc.so.12, is missing");
    refused("EMULATOR_CAPABILITY=87",
            "cuda works, 5"); /* newer than what NVRTC knows: PTX, which the driver compiles */
    refused("EMULATOR_CAPABILITY=61", "cannot compile for compute capability 6.1");
}

/* Both ways to ask must give the same sentence, and auto the cpu. */
static int say_why(void)
{
    hg_ctx *ctx;
    hg_device_info infos[2];
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .device = "cuda" }) == HG_OK) {
        hg_tensor *x = hg_tensor_make(ctx, HG_F32, 0, NULL);
        if (hg_tensor_fill(x, 5) == HG_OK)
            printf("cuda works, %g\n", hg_tensor_item(x, 0));
        else
            puts(hg_message());
        hg_ctx_destroy(ctx);
        return 0;
    }
    puts(hg_message());
    if (hg_devices(infos, 2) != 2 || !infos[1].why[0] || !strstr(hg_message(), infos[1].why)) return 1;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .device = "auto" }) != HG_OK) return 2;
    const bool right = hg_ctx_host(ctx) && strcmp(hg_ctx_device(ctx), "cpu") == 0;
    hg_ctx_destroy(ctx);
    return right ? 0 : 3;
}

int main(int count, char **words)
{
    if (count > 1 && strcmp(words[1], "--why") == 0) return say_why();
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_copies),
        cmocka_unit_test(test_out_of_memory),
        cmocka_unit_test(test_launch_errors),
        cmocka_unit_test(test_late_errors),
        cmocka_unit_test(test_kernels_by_address),
        cmocka_unit_test(test_replay),
        cmocka_unit_test(test_record_ends),
        cmocka_unit_test(test_two_contexts),
        cmocka_unit_test(test_threads),
        cmocka_unit_test(test_cache),
        cmocka_unit_test(test_names),
        cmocka_unit_test(test_refusals),
    };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
