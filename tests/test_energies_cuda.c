/* The strand energies on a device against the interpreter on the processor: every window energy with every choice of its
 * options, in both precisions, for strands of one vertex up to more than a warp has lanes, and the usual sums; and the same
 * bits whatever the order of an emulated device's threads. The device is that of test_device(); on the processor the best kernel takes the device's part. */
#include "energies_walk.h"
#include "test.h"

#include "energies_own.h" /* its short names come last */

enum { B = 2, S = 11, ORDERS = 3 };

static void agree(hg_dtype dtype, const hg_term *terms, int n, int64_t V, const char *label)
{
    scene s;
    scene_make(&s, 2, B, S, V, 0.3);
    result expected = evaluate_on("cpu", &s, dtype, 1, terms, n, HG_BACKEND_INTERPRETER, false, label, NULL);
    result exact = evaluate_on("cpu", &s, HG_F64, 1, terms, n, HG_BACKEND_INTERPRETER, false, label, NULL),
           first = { 0 };
    /* in f32 against f64, and as close as the interpreter where that is less close */
    const double own = difference(exact.gradient, expected.gradient, B * S * V * 3);
    const double limit = dtype == HG_F64 ? 1e-12 : fmax(1e-5, 2 * own);
    for (int order = 0; order < ORDERS; order++) {
        const char text[2] = { (char)('0' + order), 0 };
        setenv("EMULATOR_ORDER", text, 1);
        result got = evaluate(&s, dtype, 1, terms, n, HG_BACKEND_AUTO, false, label, NULL);
        const double gradient = difference(exact.gradient, got.gradient, B * S * V * 3),
                     strands = difference(exact.per_strand, got.per_strand, B * S * n),
                     sums = difference(exact.energy, got.energy, n);
        if (!(gradient < limit && strands < limit && sums < limit))
            fail_msg("%s %s, V %d, order %d: gradient off by %.3e, energies of strands by %.3e, sums by %.3e", label,
                     hg_dtype_name(dtype), (int)V, order, gradient, strands, sums);
        if (order == 0) {
            first = got;
            continue;
        }
        assert_memory_equal(first.gradient, got.gradient, (size_t)(B * S * V * 3) * sizeof(double));
        assert_memory_equal(first.per_strand, got.per_strand, (size_t)(B * S * n) * sizeof(double));
        assert_memory_equal(first.energy, got.energy, (size_t)n * sizeof(double));
        result_free(&got);
    }
    unsetenv("EMULATOR_ORDER");
    result_free(&first);
    result_free(&expected);
    result_free(&exact);
    scene_free(&s);
}

static void check_variant(const variant *v, void *self)
{
    if (v->term.energy->site.kind != HG_SITE_WINDOW) return;
    const hg_dtype dtype = *(const hg_dtype *)self;
    static const int64_t lengths[] = { 1, 2, 3, 4, 37 };
    for (size_t i = 0; i < sizeof lengths / sizeof *lengths; i++) agree(dtype, &v->term, 1, lengths[i], v->label);
}

static void test_each(void **state)
{
    (void)state;
    each_variant(check_variant, &(hg_dtype){ HG_F64 });
    each_variant(check_variant, &(hg_dtype){ HG_F32 });
}

static void test_sums(void **state)
{
    (void)state;
    for (int sum = 0; sum < USUAL_SUMS; sum++) {
        hg_term terms[USUAL_TERMS];
        char label[32];
        const int n = usual_terms(sum, terms);
        snprintf(label, sizeof label, "sum %d", sum);
        agree(sum % 2 ? HG_F64 : HG_F32, terms, n, 25, label);
    }
}

/* Whatever the number of energies, a call is one launch and the sum of what its blocks leave; nothing goes to or from the
 * host. */
static void test_launches(void **state)
{
    (void)state;
    hg_ctx *ctx = make_context(1);
    if (hg_ctx_host(ctx)) { /* it has no launches of a GPU, nor bytes that travel */
        hg_ctx_destroy(ctx);
        skip();
    }
    const char *names[] = { "stretch", "bend_twist", "gravity", "inertia", "drag", "hair_style" };
    for (int n = 1; n <= 6; n++) {
        hg_term terms[6];
        for (int t = 0; t < n; t++) terms[t] = (hg_term){ hg_energy_find(names[t]), 1, NULL, NULL };
        scene s;
        scene_make(&s, 1, B, S, 25, 0.3);
        hg_physics *physics;
        ok(hg_physics_create(&physics, ctx, HG_F32, terms, n, &s.data), "launches");
        const hg_frame frame = scene_frame(&s, ctx, HG_F32);
        hg_tensor *x = scene_x(&s, ctx, HG_F32), *gradient = scene_x(&s, ctx, HG_F32);
        hg_device_counts before = { 0 };
        for (int call = 0; call < 3; call++) { /* the first makes what stays */
            if (call == 1) before = hg_ctx_counts(ctx);
            ok(hg_physics_evaluate(physics, ctx, &frame, x, NULL, NULL, gradient), "launches");
        }
        const hg_device_counts after = hg_ctx_counts(ctx);
        assert_int_equal(after.launches - before.launches, 2 * 2);
        assert_int_equal(after.uploaded - before.uploaded, 0);
        assert_int_equal(after.downloaded - before.downloaded, 0);
        hg_physics_destroy(physics);
        hg_step_reset(ctx);
        scene_free(&s);
    }
    hg_ctx_destroy(ctx);
}

/* A recorded step: value and gradient by a learnt parameter and by x, with other numbers in every step; replayed, without
 * waiting, it is what it is when it is not recorded. */
static void test_recorded(void **state)
{
    (void)state;
    enum { STEPS = 5, V = 9, N = B * S * V * 3 };
    hg_ctx *ctx = make_context(1);
    scene s;
    scene_make(&s, 2, B, S, V, 0.3);
    hg_term terms[USUAL_TERMS];
    const int n = usual_terms(1, terms); /* contact, inertia and drag are in it */
    hg_physics *physics;
    ok(hg_physics_create(&physics, ctx, HG_F32, terms, n, &s.data), "recorded");
    hg_tensor *stiffness = hg_tensor_create(ctx, HG_F32, 0, NULL);
    ok(hg_tensor_fill(stiffness, 7), "recorded");
    ok(hg_require_grad(stiffness), "recorded");
    float *positions = hg_alloc(N, sizeof *positions);
    double got[2][N + 2];
    hg_device_counts before = { 0 }, after = { 0 };
    for (int step = 0; step < 2 * STEPS; step++) {
        const bool recorded = step >= STEPS;
        if (step == STEPS + 3) before = hg_ctx_counts(ctx);
        hg_step_reset(ctx);
        const uint64_t seed = (uint64_t)(step % STEPS);
        s.groom[0] = step % STEPS == 3;
        for (int i = 0; i < N; i++) positions[i] = (float)(s.x[i] + 1e-4 * noise(80 + seed, i));
        if (recorded) ok(hg_step_record(ctx), "recorded");
        hg_frame frame = scene_frame(&s, ctx, HG_F32);
        frame.inputs = &(hg_frame_input){ "stretch.stiffness", stiffness };
        frame.n_inputs = 1;
        hg_tensor *x = hg_tensor_from(ctx, HG_F32, 4, (int64_t[]){ B, S, V, 3 }, positions);
        ok(hg_require_grad(x), "recorded");
        hg_tensor *energy = hg_physics_energy(physics, ctx, &frame, x, NULL);
        if (!energy) fail_msg("%s", hg_ctx_message(ctx));
        ok(hg_backward(ctx, energy), "recorded");
        if (recorded) ok(hg_step_run(ctx), "recorded");
        if (step == 2 * STEPS - 1) after = hg_ctx_counts(ctx);
        if (step % STEPS != STEPS - 1) continue;
        double *to = got[recorded];
        ok(hg_tensor_numbers(hg_grad(x), to), "recorded");
        to[N] = value(hg_grad(stiffness), 0);
        to[N + 1] = value(energy, 0);
    }
    assert_memory_equal(got[0], got[1], sizeof got[0]);
    assert_true(got[0][N] != 0 && got[0][N + 1] > 0);
    if (!hg_ctx_host(ctx)) {
        assert_int_equal(after.replays - before.replays, STEPS - 3);
        assert_int_equal(after.waits - before.waits, 0);
        assert_int_equal(after.downloaded - before.downloaded, 0);
    }
    hg_free(positions);
    hg_tensor_destroy(stiffness);
    hg_physics_destroy(physics);
    scene_free(&s);
    hg_ctx_destroy(ctx);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(test_each), cmocka_unit_test(test_sums),
                                        cmocka_unit_test(test_launches), cmocka_unit_test(test_recorded) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
