/* tensor/: arena, errors, tensors, conversions, kernels. */
#include "device.h"
#include "test.h"

#include "tensor/tensor.h"

static hg_ctx *make_ctx(int threads)
{
    hg_ctx *ctx;
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = threads, .seed = 7, .device = test_device() }),
                     HG_OK);
    return ctx;
}

/* ---- arena ---- */

static void test_arena_grows_and_settles(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    size_t reserved = 0;
    for (int step = 0; step < 6; step++) {
        hg_step_reset(ctx);
        assert_int_equal(hg_step_bytes(ctx), 0);
        unsigned char *at[40];
        for (int i = 0; i < 40; i++) {
            size_t bytes = (size_t)(i * 37 % 11) * 100000 + 1;
            at[i] = hg_step_alloc(ctx, bytes);
            assert_non_null(at[i]);
            assert_int_equal((uintptr_t)at[i] % 64, 0);
            memset(at[i], i, bytes);
        }
        for (int i = 0; i < 40; i++) assert_int_equal(at[i][(size_t)(i * 37 % 11) * 100000], i); /* nothing overlaps */
        if (step == 1) reserved = hg_step_reserved(ctx);
        if (step > 1) assert_int_equal(hg_step_reserved(ctx), reserved);
        assert_true(hg_step_bytes(ctx) <= hg_step_high_water(ctx));
        assert_true(hg_step_high_water(ctx) <= hg_step_reserved(ctx));
    }
    hg_ctx_destroy(ctx);
}

/* What kernels read and write is of the device, also under guards, which are patterns of the host alone. */
static void test_device_arena(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    size_t reserved = 0;
    for (int step = 0; step < 6; step++) {
        hg_step_guard(ctx, step >= 4);
        hg_step_reset(ctx);
        hg_tensor *all[20];
        for (int i = 0; i < 20; i++) {
            all[i] = hg_tensor_make(ctx, HG_F32, 1, (int64_t[]){ (i * 37 % 11) * 25000 + 1 });
            assert_non_null(all[i]);
            assert_int_equal((uintptr_t)all[i]->data % 64, 0);
            assert_int_equal(hg_tensor_fill(all[i], i), HG_OK);
        }
        for (int i = 0; i < 20; i++) {
            const int64_t last = hg_tensor_count(all[i]) - 1;
            assert_true(hg_tensor_item(all[i], 0) == i && hg_tensor_item(all[i], last) == i); /* nothing overlaps */
        }
        assert_int_equal(hg_step_check(ctx), HG_OK);
        if (step == 1) reserved = hg_step_reserved(ctx);
        if (step > 1 && step < 4) assert_int_equal(hg_step_reserved(ctx), reserved);
    }
    hg_ctx_destroy(ctx);
}

static void test_mark_and_rewind(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    hg_step_mark empty = hg_step_set_mark(ctx);
    char *kept = hg_step_alloc(ctx, 100);
    strcpy(kept, "kept");
    size_t bytes = hg_step_bytes(ctx);
    hg_step_mark mark = hg_step_set_mark(ctx);
    void *first = hg_step_alloc(ctx, 64), *large = hg_step_alloc(ctx, 5 << 20);
    assert_non_null(large);
    size_t reserved = hg_step_reserved(ctx);
    hg_step_rewind(ctx, mark);
    assert_int_equal(hg_step_bytes(ctx), bytes);
    assert_ptr_equal(hg_step_alloc(ctx, 64), first);
    assert_non_null(hg_step_alloc(ctx, 5 << 20));
    assert_int_equal(hg_step_reserved(ctx), reserved); /* the second chunk is used again */
    assert_string_equal(kept, "kept");
    hg_step_rewind(ctx, empty);
    assert_int_equal(hg_step_bytes(ctx), 0);
    hg_ctx_destroy(ctx);
}

static void test_guards(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    hg_step_guard(ctx, true);
    hg_step_reset(ctx);
    char *a = hg_step_alloc(ctx, 64), *b = hg_step_alloc(ctx, 128);
    memset(a, 1, 64);
    memset(b, 2, 128);
    assert_int_equal(hg_step_check(ctx), HG_OK);
    char behind = b[128];
    b[128] = 3;
    assert_int_equal(hg_step_check(ctx), HG_INVALID);
    b[128] = behind;
    hg_ctx_clear(ctx);
    assert_int_equal(hg_step_check(ctx), HG_OK);
    a[-1] ^= 1;
    assert_int_equal(hg_step_check(ctx), HG_INVALID);
    hg_ctx_destroy(ctx);
}

static void test_impossible_sizes(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    assert_null(hg_step_alloc(ctx, SIZE_MAX / 2));
    assert_int_equal(hg_ctx_status(ctx), HG_MEMORY);
    hg_ctx_clear(ctx);
    assert_null(hg_tensor_make(ctx, HG_F32, 3, (int64_t[]){ INT64_MAX / 8, 3, 3 }));
    assert_int_equal(hg_ctx_status(ctx), HG_MEMORY);
    hg_ctx_clear(ctx);
    assert_null(hg_tensor_make(ctx, HG_F32, 1, (int64_t[]){ -1 }));
    assert_int_equal(hg_ctx_status(ctx), HG_INVALID);
    hg_ctx_clear(ctx);
    assert_null(hg_tensor_make(ctx, HG_F32, 7, (int64_t[]){ 1, 1, 1, 1, 1, 1, 1 }));
    assert_int_equal(hg_ctx_status(ctx), HG_INVALID);
    hg_ctx_destroy(ctx);
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .device = "abacus" }), HG_UNSUPPORTED);
    assert_null(ctx);
    assert_non_null(strstr(hg_message(), "abacus"));
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = -1 }), HG_INVALID);
}

/* ---- errors ---- */

static void test_errors_stick(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    assert_int_equal(hg_ctx_status(ctx), HG_OK);
    assert_string_equal(hg_ctx_message(ctx), "");
    hg_ctx_fail(hg_at(ctx, "hair.c", 12), HG_INVALID, "first %d", 1);
    hg_ctx_fail(ctx, HG_MEMORY, "second");
    assert_int_equal(hg_ctx_status(ctx), HG_INVALID);
    assert_string_equal(hg_ctx_message(ctx), "first 1 (called at hair.c:12)");
    assert_non_null(strstr(hg_message(), "second"));
    assert_null(hg_tensor_make(ctx, HG_F32, 0, NULL)); /* nothing is made after an error */
    assert_null(hg_tensor_create(ctx, HG_F32, 0, NULL));
    hg_ctx_clear(ctx);
    assert_int_equal(hg_ctx_status(ctx), HG_OK);
    assert_non_null(hg_tensor_make(ctx, HG_F32, 0, NULL));
    hg_ctx_destroy(ctx);
    hg_ctx_destroy(NULL);
}

/* ---- tensors ---- */

static void test_tensors(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(2);
    char text[96];
    assert_int_equal(hg_ctx_threads(ctx), 2);
    assert_int_equal(hg_ctx_seed(ctx), 7);
    assert_string_equal(hg_ctx_device(ctx), test_device() ? test_device() : "cpu");
    assert_true(hg_ctx_host(ctx) == !test_device());
    hg_tensor *a = hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ 3, 4 });
    assert_string_equal(hg_shape_text(a, text), "f32 [3,4]");
    assert_string_equal(hg_shape_text(NULL, text), "NULL");
    assert_int_equal(hg_tensor_count(a), 12);
    assert_int_equal(hg_tensor_bytes(a), 48);
    assert_int_equal(a->shape[5], 1);
    assert_true(hg_tensor_item(a, 11) == 0);
    assert_true(isnan(hg_tensor_item(a, 12)) && isnan(hg_tensor_item(a, -1)) && isnan(hg_tensor_item(NULL, 0)));
    float numbers[12];
    for (int i = 0; i < 12; i++) numbers[i] = (float)i;
    uint32_t version = a->version;
    assert_int_equal(hg_tensor_write(a, numbers), HG_OK);
    assert_int_not_equal(a->version, version);
    hg_step_reset(ctx); /* owned tensors stay */
    hg_tensor *rows = hg_tensor_rows(ctx, a, 1, 2);
    assert_string_equal(hg_shape_text(rows, text), "f32 [2,4]");
    assert_true(hg_tensor_item(rows, 0) == 4);
    version = a->version;
    assert_int_equal(hg_tensor_fill(rows, 9), HG_OK); /* writing to a view is writing to the tensor */
    assert_int_not_equal(a->version, version);
    assert_true(hg_tensor_item(a, 3) == 3 && hg_tensor_item(a, 4) == 9);
    assert_int_equal(hg_tensor_count(hg_tensor_rows(ctx, a, 3, 0)), 0);
    assert_null(hg_tensor_rows(ctx, a, 2, 2));
    assert_non_null(strstr(hg_ctx_message(ctx), "2 rows from row 2 of f32 [3,4]"));
    hg_tensor_destroy(a);
    hg_tensor_destroy(NULL);
    hg_ctx_destroy(ctx);
}

/* What a device can do at best is measured on it, with kernels of its own. */
static void test_limits_of_device(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    double operations = 0, bytes = 0;
    if (!hg_ctx_host(ctx)) { /* the processor's take a while; test_profile */
        assert_int_equal(hg_machine_limits(ctx, &operations, &bytes), HG_OK);
        assert_true(operations > 0 && bytes > 0);
    }
    hg_ctx_destroy(ctx);
}

static void test_conversions(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(2);
    const double values[] = { 0, -1.5, 3.25, 1e9, -1e12, (double)NAN, (double)INFINITY, 65504 };
    const hg_dtype types[] = { HG_F32, HG_F64, HG_I32, HG_BF16 };
    hg_tensor *wide = hg_tensor_make(ctx, HG_F64, 1, (int64_t[]){ 8 });
    assert_int_equal(hg_tensor_write(wide, values), HG_OK);
    for (int t = 0; t < 4; t++) {
        hg_tensor *narrow = hg_tensor_make(ctx, types[t], 2, (int64_t[]){ 2, 4 }),
                  *same = hg_tensor_make(ctx, types[t], 1, (int64_t[]){ 8 }),
                  *back = hg_tensor_make(ctx, HG_F64, 1, (int64_t[]){ 8 });
        assert_int_equal(hg_tensor_copy(narrow, wide), HG_OK);
        assert_int_equal(hg_tensor_copy(same, narrow), HG_OK);
        assert_int_equal(hg_tensor_copy(back, same), HG_OK);
        for (int i = 0; i < 8; i++) {
            double x = hg_tensor_item(back, i), expected = values[i];
            if (types[t] == HG_F32) expected = (double)(float)expected;
            if (types[t] == HG_I32) expected = isnan(expected) ? 0 : fmax(fmin(trunc(expected), INT32_MAX), INT32_MIN);
            if (types[t] == HG_BF16) expected = (double)hg_f32_from_bf16(hg_bf16_from_f32((float)expected));
            assert_true(isnan(expected) ? isnan(x) : x == expected);
        }
    }
    assert_int_equal(hg_bf16_from_f32(1.0f), 0x3F80);
    assert_int_equal(hg_bf16_from_f32(1.00390625f), 0x3F80); /* a tie goes to the even one */
    assert_int_equal(hg_bf16_from_f32(1.01171875f), 0x3F82);
    assert_int_equal(hg_bf16_from_f32(1.005f), 0x3F81);
    assert_true(isnan(hg_f32_from_bf16(hg_bf16_from_f32(NAN))));
    assert_int_equal(hg_tensor_copy(wide, hg_tensor_make(ctx, HG_F64, 1, (int64_t[]){ 7 })), HG_INVALID);
    assert_non_null(strstr(hg_ctx_message(ctx), "f64 [7]"));
    hg_ctx_clear(ctx);
    assert_int_equal(hg_tensor_fill(hg_tensor_make(ctx, HG_I32, 0, NULL), 1e10), HG_INVALID);
    hg_ctx_destroy(ctx);
}

/* ---- kernels ---- */

typedef struct {
    int64_t n;
    int *seen;
    int64_t longest;
} count_args;

static void count_cpu(const void *memory, int64_t first, int64_t last)
{
    const count_args *p = memory;
    assert_true(last - first <= 100 && first % 100 == 0 && last <= p->n);
    for (int64_t i = first; i < last; i++) p->seen[i]++;
}

static void test_launch_covers_blocks(void **state)
{
    (void)state;
    if (test_device()) skip(); /* a body of the host, which writes to memory of the host */
    static const hg_kernel kernel = {
        .name = "count", .args_size = sizeof(count_args), .cpu = count_cpu, .block = 100
    };
    static const hg_kernel bodiless = { .name = "bodiless" };
    for (int threads = 1; threads <= 3; threads++) {
        hg_ctx *ctx = make_ctx(threads);
        const int64_t sizes[] = { 0, 1, 99, 100, 101, 1234 };
        for (int s = 0; s < 6; s++) {
            int seen[1300] = { 0 };
            assert_int_equal(hg_launch(ctx, &kernel, sizes[s], &(count_args){ sizes[s], seen, 0 }), HG_OK);
            for (int i = 0; i < 1300; i++) assert_int_equal(seen[i], i < sizes[s]);
        }
        assert_int_equal(hg_launch(ctx, &bodiless, 1, NULL), HG_UNSUPPORTED);
        assert_non_null(strstr(hg_ctx_message(ctx), "bodiless"));
        hg_ctx_destroy(ctx);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_arena_grows_and_settles),
        cmocka_unit_test(test_device_arena),
        cmocka_unit_test(test_mark_and_rewind),
        cmocka_unit_test(test_guards),
        cmocka_unit_test(test_impossible_sizes),
        cmocka_unit_test(test_errors_stick),
        cmocka_unit_test(test_tensors),
        cmocka_unit_test(test_conversions),
        cmocka_unit_test(test_limits_of_device),
        cmocka_unit_test(test_launch_covers_blocks),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
