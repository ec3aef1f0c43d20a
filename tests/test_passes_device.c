/* The passes over pairs and fields on the device of the test against those on the processor: values and the derivatives of
 * everything that a call can bring, in f32 and f64, of every such energy; the same bits again and in any order of threads;
 * differences in f64 on the device itself; what is given wrongly there. */
#include "device.h"
#include "passes.h"

typedef struct {
    int64_t G, B, S, V;
    double bend;
} size;

static bool same_bits(const pass_result *a, const pass_result *b, const scene *s, const brought *values)
{
    bool same = memcmp(&a->energy, &b->energy, sizeof a->energy) == 0 &&
                memcmp(a->gradient, b->gradient, (size_t)(s->B * s->S * s->V * 3) * sizeof(double)) == 0 &&
                memcmp(a->per_strand, b->per_strand, (size_t)(s->B * s->S) * sizeof(double)) == 0;
    for (int i = 0; i < values->n; i++)
        same = same && memcmp(a->of[i], b->of[i], (size_t)values->count[i] * sizeof(double)) == 0;
    return same;
}

static void check(const variant *v, const size *at, bool per_strand, bool density)
{
    static const char *const orders[] = { "0", "1", "2", "0" };
    scene s;
    brought b;
    scene_make(&s, at->G, at->B, at->S, at->V, at->bend);
    bring_all(&b, &s, v->term.energy, per_strand, density);
    for (int d = 0; d < 2; d++) {
        const hg_dtype dtype = d ? HG_F64 : HG_F32;
        const double limit = d ? 1e-12 : 1e-5;
        pass_result host = run_pass(&s, &v->term, dtype, NULL, 1, &b, true, v->label), first;
        for (int order = 0; order < 4; order++) {
            setenv("EMULATOR_ORDER", orders[order], 1);
            pass_result r = run_pass(&s, &v->term, dtype, test_device(), 2, &b, true, v->label);
            if (order == 0) {
                first = r;
                continue;
            }
            if (!same_bits(&first, &r, &s, &b)) fail_msg("%s: other bits in order %s", v->label, orders[order]);
            pass_result_free(&r, b.n);
        }
        const double energy = fabs(first.energy - host.energy) / fmax(fabs(host.energy), 1e-300),
                     gradient = difference(host.gradient, first.gradient, s.B * s.S * s.V * 3),
                     strands = difference(host.per_strand, first.per_strand, s.B * s.S);
        double worst = 0;
        for (int i = 0; i < b.n; i++) {
            const double apart = difference(host.of[i], first.of[i], b.count[i]);
            if (!(apart < limit))
                fail_msg("%s %s: d/d%s differs by %.2e", v->label, d ? "f64" : "f32", b.label[i], apart);
            worst = fmax(worst, apart);
        }
        print_message("    %-40s %s: energy %.1e, gradient %.1e, derivatives %.1e\n", v->label, d ? "f64" : "f32",
                      energy, gradient, worst);
        if (!(energy < limit && gradient < limit && strands < limit))
            fail_msg("%s %s: energy differs by %.2e, the gradient by %.2e, strands by %.2e", v->label,
                     d ? "f64" : "f32", energy, gradient, strands);
        if (s.S > 5 && !(host.energy > 0)) fail_msg("%s: nothing is compared", v->label);
        /* without gradients the program is another one */
        pass_result plain = run_pass(&s, &v->term, dtype, test_device(), 2, &b, false, v->label);
        assert_true(fabs(plain.energy - host.energy) <= limit * fabs(host.energy));
        pass_result_free(&plain, b.n);
        pass_result_free(&first, b.n);
        pass_result_free(&host, b.n);
    }
    unsetenv("EMULATOR_ORDER");
    bring_free(&b);
    scene_free(&s);
}

static void check_variant(const variant *v, void *self)
{
    static const size sizes[] = { { 2, 3, 9, 7, 0.2 }, { 1, 2, 1, 1, 0.2 }, { 3, 2, 5, 4, 0.4 } };
    const hg_site_kind site = v->term.energy->site.kind;
    (void)self;
    if (site == HG_SITE_WINDOW) return;
    for (int per_strand = 0; per_strand < 2; per_strand++) check(v, &sizes[0], per_strand, false);
    for (int i = 1; i < 3; i++) check(v, &sizes[i], true, false);
    if (site == HG_SITE_FIELD && !strstr(v->label, "=kg")) check(v, &sizes[0], false, true); /* a density of vertices */
}

static void test_variants(void **state)
{
    (void)state;
    each_variant(check_variant, NULL);
}

/* Nothing is given: the groom and the term say everything. And lists of another radius, given in the call. */
static void test_given(void **state)
{
    (void)state;
    static const char *const names[] = { "adhesion", "self_collision", "test_pair", "test_density" };
    scene s;
    scene_make(&s, 2, 2, 9, 7, 0.2);
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        const hg_term term = { hg_energy_find(names[i]), 1.5, NULL, NULL };
        const bool pairs = term.energy->site.kind == HG_SITE_PAIRS;
        brought b = { 0 };
        for (int given = 0; given < 2; given++) {
            pass_result host = run_pass(&s, &term, HG_F64, NULL, 1, &b, !pairs || !given, names[i]);
            pass_result r = run_pass(&s, &term, HG_F64, test_device(), 1, &b, !pairs || !given, names[i]);
            assert_true(host.energy > 0 && fabs(r.energy - host.energy) <= 1e-12 * host.energy);
            assert_true(difference(host.gradient, r.gradient, s.B * s.S * s.V * 3) < 1e-12);
            pass_result_free(&host, b.n);
            pass_result_free(&r, b.n);
            const double wider = pairs ? 0.04 : 0.009;
            for (int p = 0; p < HG_ENERGY_PARAMS && term.energy->params[p].name && !given; p++)
                if (strcmp(term.energy->params[p].name, pairs ? "radius" : "h") == 0)
                    bring(&b, HG_INPUT_PARAM, p, NULL, "wider", true, 1, &wider);
        }
        bring_free(&b);
    }
    scene_free(&s);
}

/* No strand at all: the energy is zero, and said to be. */
static void test_empty(void **state)
{
    (void)state;
    static const char *const names[] = { "adhesion", "self_collision" };
    scene s;
    scene_make(&s, 1, 2, 0, 5, 0.2);
    for (int i = 0; i < 2; i++) {
        const hg_term term = { hg_energy_find(names[i]), 1, NULL, NULL };
        brought b = { 0 };
        pass_result r = run_pass(&s, &term, HG_F32, test_device(), 1, &b, true, names[i]);
        assert_true(r.energy == 0);
        pass_result_free(&r, 0);
    }
    scene_free(&s);
}

/* What moves by `step` in a random direction: the positions, or value i of the call. */
static void move(scene *s, brought *b, int i, double step)
{
    const int64_t n = i < 0 ? s->B * s->S * s->V * 3 : b->count[i];
    double *at = i < 0 ? s->x : b->at[i], scale = 0;
    for (int64_t k = 0; k < n; k++) scale = fmax(scale, fabs(at[k]));
    for (int64_t k = 0; k < n; k++) at[k] += step * (i < 0 ? 0.01 : 0.1) * scale * noise(70, k);
}

/* The derivatives of the device against differences of its energies, in random directions. */
static void test_differences(void **state)
{
    (void)state;
    static const char *const names[] = { "adhesion", "self_collision", "test_pair", "test_density" };
    static const double weights[4] = { 1.0 / 12, -8.0 / 12, 8.0 / 12, -1.0 / 12 };
    for (size_t e = 0; e < sizeof names / sizeof *names; e++) {
        scene s;
        brought b;
        const hg_term term = { hg_energy_find(names[e]), 1.5, NULL, NULL };
        scene_make(&s, 2, 3, 9, 7, 0.2);
        bring_all(&b, &s, term.energy, true, false);
        pass_result r = run_pass(&s, &term, HG_F64, test_device(), 1, &b, true, names[e]);
        assert_true(r.energy > 0);
        for (int i = -1; i < b.n; i++) {
            const int64_t n = i < 0 ? s.B * s.S * s.V * 3 : b.count[i];
            const double *slope = i < 0 ? r.gradient : r.of[i], step = 4e-4;
            double *kept = numbers(n), *at = i < 0 ? s.x : b.at[i], analytic = 0, numeric = 0;
            memcpy(kept, at, (size_t)n * sizeof *kept);
            move(&s, &b, i, 1);
            for (int64_t k = 0; k < n; k++) analytic += slope[k] * (at[k] - kept[k]);
            for (int j = 0; j < 4; j++) {
                memcpy(at, kept, (size_t)n * sizeof *kept);
                move(&s, &b, i, step * (j < 2 ? j - 2 : j - 1));
                pass_result moved = run_pass(&s, &term, HG_F64, test_device(), 1, &b, false, names[e]);
                numeric += term.weight * weights[j] * moved.energy / step;
                pass_result_free(&moved, b.n);
            }
            memcpy(at, kept, (size_t)n * sizeof *kept);
            const char *label = i < 0 ? "x" : b.label[i];
            print_message("    %-16s d/d%-16s %.9e %.9e\n", names[e], label, analytic, numeric);
            if (!(fabs(numeric - analytic) <= 1e-6 * fabs(analytic) + 1e-12 * r.energy))
                fail_msg("%s: d/d%s is wrong", names[e], label);
            hg_free(kept);
        }
        pass_result_free(&r, b.n);
        bring_free(&b);
        scene_free(&s);
    }
}

/* A reach that is no length, found out on the device alone: no energy, rather than a wrong one. */
static void test_no_reach(void **state)
{
    (void)state;
    if (!test_device()) skip(); /* the processor says so at once */
    scene s;
    scene_make(&s, 1, 1, 3, 4, 0.2);
    const hg_term term = { hg_energy_find("self_collision"), 1, NULL, NULL };
    const double wrong[] = { 0, -1, (double)INFINITY, (double)NAN };
    for (int i = 0; i < 4; i++) {
        brought b = { 0 };
        bring(&b, HG_INPUT_PARAM, 1, NULL, "h", true, 1, &wrong[i]);
        pass_result r = run_pass(&s, &term, HG_F32, test_device(), 1, &b, true, "h");
        assert_true(isnan(r.energy));
        pass_result_free(&r, b.n);
        bring_free(&b);
    }
    scene_free(&s);
}

/* A step that is recorded and replayed, with stiffness and reach as tensors that learn and the positions and grooms of the
 * frames new in every step: the same bits as run call by call, and the host waits for nothing. */
enum { STEPS = 6 };

static void run_steps(const scene *s, bool record, double *gradients /* [STEPS, 3 B S V + 3] */,
                      hg_device_counts *counts)
{
    hg_ctx *ctx;
    hg_physics *physics;
    const hg_term terms[] = { { hg_energy_find("self_collision"), 1.5, NULL, NULL },
                              { hg_energy_find("adhesion"), 0.5, NULL, NULL } };
    const int64_t shape[4] = { s->B, s->S, s->V, 3 }, n = s->B * s->S * s->V * 3;
    const double values[2] = { 2e-9, 0.003 };
    ok(hg_ctx_create(&ctx, &(hg_ctx_options){ .device = test_device(), .threads = 1 }), "steps");
    ok(hg_physics_create(&physics, ctx, HG_F64, terms, 2, &s->data), "steps");
    hg_tensor *x = hg_tensor_create(ctx, HG_F64, 4, shape), *learnt[2];
    double *at = numbers(n);
    for (int i = 0; i < 2; i++) {
        learnt[i] = hg_tensor_create(ctx, HG_F64, 0, NULL);
        ok(hg_tensor_write(learnt[i], &values[i]), "steps");
        ok(hg_require_grad(learnt[i]), "steps");
    }
    ok(hg_require_grad(x), "steps");
    const hg_frame_input inputs[] = { { "self_collision.stiffness", learnt[0] }, { "self_collision.h", learnt[1] } };
    for (int step = 0; step < STEPS; step++) {
        int32_t groom[8];
        for (int64_t i = 0; i < n; i++) at[i] = s->x[i] + 2e-4 * noise(80 + (uint64_t)step, i);
        for (int64_t b = 0; b < s->B; b++) groom[b] = (int32_t)((b + step) % s->G);
        const hg_frame frame = { .groom = groom, .dt = 1.0 / 30, .inputs = inputs, .n_inputs = 2 };
        hg_step_reset(ctx);
        const int64_t waits = hg_ctx_counts(ctx).waits;
        if (record) ok(hg_step_record(ctx), "steps");
        ok(hg_tensor_write(x, at), "steps");
        hg_tensor *energy = hg_physics_energy(physics, ctx, &frame, x, NULL);
        ok(hg_backward(ctx, energy), "steps");
        if (record) ok(hg_step_run(ctx), "steps");
        assert_true(!record || hg_ctx_counts(ctx).waits == waits);
        double *to = gradients + step * (n + 3);
        ok(hg_tensor_read(hg_grad(x), to), "steps");
        for (int i = 0; i < 2; i++) ok(hg_tensor_read(hg_grad(learnt[i]), to + n + i), "steps");
        ok(hg_tensor_read(energy, to + n + 2), "steps");
    }
    *counts = hg_ctx_counts(ctx);
    hg_free(at);
    for (int i = 0; i < 2; i++) hg_tensor_destroy(learnt[i]);
    hg_tensor_destroy(x);
    hg_physics_destroy(physics);
    hg_ctx_destroy(ctx);
}

static void test_recorded(void **state)
{
    (void)state;
    scene s;
    scene_make(&s, 2, 3, 9, 7, 0.2);
    const int64_t n = STEPS * (s.B * s.S * s.V * 3 + 3);
    double *plain = numbers(n), *recorded = numbers(n);
    hg_device_counts counts;
    run_steps(&s, false, plain, &counts);
    run_steps(&s, true, recorded, &counts);
    assert_memory_equal(plain, recorded, (size_t)n * sizeof(double));
    for (int64_t step = 1; step <= STEPS; step++) assert_true(recorded[step * n / STEPS - 1] > 0);
    if (test_device()) assert_true(counts.replays >= STEPS - 2);
    print_message("    %d launches in %d steps, %d replays\n", (int)counts.launches, STEPS, (int)counts.replays);
    hg_free(plain);
    hg_free(recorded);
    scene_free(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_variants),    cmocka_unit_test(test_given),    cmocka_unit_test(test_empty),
        cmocka_unit_test(test_differences), cmocka_unit_test(test_no_reach), cmocka_unit_test(test_recorded),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
