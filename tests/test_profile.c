/* The profile: scopes, medians, own times; off it counts nothing. Ops on the tape have scopes of their own. And the
 * counter of allocations that shows a steady state. */
#include "test.h"

#include "autograd/autograd.h"

#include <time.h>

static void wait(double seconds)
{
    const struct timespec t = { 0, (long)(1e9 * seconds) };
    nanosleep(&t, NULL);
}

static const hg_profile_row *find(const hg_profile_row *rows, int n, const char *group, const char *name)
{
    for (int i = 0; i < n; i++)
        if (!strcmp(rows[i].group, group) && !strcmp(rows[i].name, name)) return &rows[i];
    return NULL;
}

static void test_scopes(void **state)
{
    (void)state;
    hg_ctx *ctx;
    const hg_profile_row *rows;
    double seconds;
    assert_int_equal(hg_ctx_create(&ctx, NULL), HG_OK);
    hg_profile_begin(ctx, "a", "not started");
    hg_profile_end(ctx, 1);
    hg_profile_step(ctx);
    assert_false(hg_profiling(ctx));
    assert_int_equal(hg_profile_read(ctx, &seconds, &rows), 0);
    assert_int_equal(hg_profile_start(ctx, 0), HG_INVALID);
    assert_int_equal(hg_profile_start(ctx, 3), HG_OK);
    assert_true(hg_profiling(ctx));
    const int64_t before = hg_alloc_count();
    for (int step = 0; step < 4; step++) { /* the fourth has no room */
        hg_profile_begin(ctx, "a", "outer");
        wait(0.002);
        for (int k = 0; k < 2; k++) {
            hg_profile_begin(ctx, "a", "inner");
            wait(0.004);
            hg_profile_end(ctx, 100);
        }
        hg_profile_end(ctx, 7);
        hg_profile_step(ctx);
    }
    assert_int_equal(hg_alloc_count(), before);
    const int n = hg_profile_read(ctx, &seconds, &rows);
    assert_int_equal(n, 2);
    const hg_profile_row *outer = find(rows, n, "a", "outer"), *inner = find(rows, n, "a", "inner");
    assert_non_null(outer);
    assert_non_null(inner);
    assert_true(outer->calls == 1 && inner->calls == 2 && outer->bytes == 7 && inner->bytes == 200);
    assert_true(outer->total >= 0.01 && outer->own >= 0.002 && inner->own >= 0.008);
    assert_true(outer->own < outer->total && inner->own == inner->total && seconds >= outer->total);
    hg_profile_stop(ctx);
    assert_false(hg_profiling(ctx));
    hg_ctx_destroy(ctx);
}

static void test_ops(void **state)
{
    (void)state;
    hg_ctx *ctx;
    const hg_profile_row *rows;
    double seconds;
    assert_int_equal(hg_ctx_create(&ctx, NULL), HG_OK);
    hg_tensor *w = hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ 4, 2 });
    assert_int_equal(hg_require_grad(w), HG_OK);
    assert_int_equal(hg_profile_start(ctx, 2), HG_OK);
    for (int step = 0; step < 2; step++) {
        hg_step_reset(ctx);
        hg_tensor *x = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 3, 4 });
        assert_int_equal(hg_tensor_fill(x, 1), HG_OK);
        assert_int_equal(hg_backward(ctx, hg_sum(ctx, hg_matmul(ctx, x, w))), HG_OK);
        hg_profile_step(ctx);
    }
    const int n = hg_profile_read(ctx, &seconds, &rows);
    const hg_profile_row *forward = find(rows, n, "forward", "matmul"), *backward = find(rows, n, "backward", "matmul");
    assert_non_null(forward);
    assert_non_null(backward);
    assert_non_null(find(rows, n, "forward", "sum"));
    assert_true(forward->calls == 1 && backward->calls == 1);
    assert_true(forward->bytes == 4 * (12 + 8 + 6) && backward->bytes == 4 * (12 + 2 * 8 + 6));
    hg_tensor_destroy(w);
    hg_ctx_destroy(ctx); /* frees the profile */
}

/* More names and more depth than there is room for are counted somewhere, or not at all, and harm nothing. */
static void test_limits(void **state)
{
    (void)state;
    static char names[400][16];
    hg_ctx *ctx;
    const hg_profile_row *rows;
    double seconds, operations, bytes;
    assert_int_equal(hg_ctx_create(&ctx, NULL), HG_OK);
    assert_int_equal(hg_profile_start(ctx, 1), HG_OK);
    for (int i = 0; i < 400; i++) {
        snprintf(names[i], sizeof names[i], "%d", i);
        hg_profile_begin(ctx, "many", names[i]);
        hg_profile_end(ctx, 1);
    }
    for (int i = 0; i < 100; i++) hg_profile_begin(ctx, "deep", "deep");
    for (int i = 0; i < 101; i++) hg_profile_end(ctx, 0);
    hg_profile_step(ctx);
    const int n = hg_profile_read(ctx, &seconds, &rows);
    double total = 0;
    for (int i = 0; i < n; i++) total += rows[i].bytes;
    assert_true(n > 100 && total == 400);
    assert_int_equal(hg_machine_limits(ctx, &operations, &bytes), HG_OK);
    assert_true(operations > 1e6 && bytes > 1e6 && operations < 1e17 && bytes < 1e17);
    hg_ctx_destroy(ctx);
}

static void test_alloc_count(void **state)
{
    (void)state;
    const int64_t before = hg_alloc_count();
    void *memory = hg_alloc(1, 8);
    memory = hg_resize(memory, 8, 16, 1);
    hg_free(memory);
    assert_int_equal(hg_alloc_count(), before + 2);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_scopes),
        cmocka_unit_test(test_ops),
        cmocka_unit_test(test_limits),
        cmocka_unit_test(test_alloc_count),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
