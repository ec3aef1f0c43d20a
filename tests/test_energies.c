/* Every energy in the registry, with every combination of its options: gradient against finite differences, f32 against
 * f64, printed kernels against the interpreter, hoisting against none, invariance and rest where they are declared,
 * degenerate hair, every length of strand, and the same bits whatever the threads. */
#include "energies_scene.h"

#include "hairloss/physics.h"

#include <setjmp.h>
#include <stdarg.h>
#include <cmocka.h>

enum { MAX_ENERGIES = 64 };

typedef struct {
    hg_term term;
    const char *options[HG_ENERGY_OPTIONS];
    char label[160];
} variant;

/* Calls what for every energy and every combination of its options. */
static void each_variant(void (*what)(const variant *v, void *self), void *self)
{
    const char *names[MAX_ENERGIES];
    const int n = hg_list("energy", names, MAX_ENERGIES);
    assert_true(n >= 7 && n <= MAX_ENERGIES);
    for (int i = 0; i < n; i++) {
        const hg_energy *energy = hg_energy_find(names[i]);
        assert_non_null(energy);
        int combinations = 1, radix[HG_ENERGY_OPTIONS] = { 0 };
        for (int k = 0; k < HG_ENERGY_OPTIONS && energy->options[k].name; k++) {
            radix[k] = 1;
            for (const char *c = energy->options[k].choices; *c; c++) radix[k] += *c == '|';
            combinations *= radix[k];
        }
        for (int code = 0; code < combinations; code++) {
            variant v = { .term = { energy, 1.7, NULL, NULL } };
            char choices[HG_ENERGY_OPTIONS][32];
            int rest = code, length = snprintf(v.label, sizeof v.label, "%s", names[i]);
            for (int k = 0; k < HG_ENERGY_OPTIONS && radix[k]; k++) {
                const char *at = energy->options[k].choices;
                for (int c = rest % radix[k]; c > 0; c--) at = strchr(at, '|') + 1;
                rest /= radix[k];
                snprintf(choices[k], sizeof choices[k], "%.*s", (int)strcspn(at, "|"), at);
                v.options[k] = choices[k];
                length += snprintf(v.label + length, sizeof v.label - (size_t)length, " %s=%s", energy->options[k].name,
                                   choices[k]);
            }
            v.term.options = v.options;
            what(&v, self);
        }
    }
}

static hg_ctx *make_context(int threads)
{
    hg_ctx *ctx;
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = threads, .seed = 1 }), HG_OK);
    return ctx;
}

static void ok(hg_status status, const char *label)
{
    if (status != HG_OK) fail_msg("%s: %s", label, hg_message());
}

static double value(const hg_tensor *tensor, int64_t i) { return hg_tensor_item(tensor, i); }

/* ---- gradient against finite differences, f64 ----------------------------------------------------------------- */

static double energy_at(hg_physics *physics, hg_ctx *ctx, const hg_frame *frame, hg_tensor *x, const double *from,
                        const double *direction, double step)
{
    double energy;
    for (int64_t i = 0; i < hg_tensor_count(x); i++) ((double *)x->data)[i] = from[i] + step * direction[i];
    ok(hg_physics_evaluate(physics, ctx, frame, x, &energy, NULL, NULL), "evaluate");
    return energy;
}

static double worst_gradient(const variant *v, const scene *s, hg_ctx *ctx, const hg_frame *frame, hg_physics *physics)
{
    const int64_t n = s->B * s->S * s->V * 3;
    hg_tensor *x = scene_x(s, ctx, HG_F64), *gradient = scene_x(s, ctx, HG_F64);
    double *direction = numbers(n), energy, worst = 0, largest = 0;
    ok(hg_physics_evaluate(physics, ctx, frame, x, &energy, NULL, gradient), v->label);
    for (int64_t i = 0; i < n; i++) largest = fmax(largest, fabs(value(gradient, i)));
    for (int round = 0; round < 24 + n; round++) {
        for (int64_t i = 0; i < n; i++) direction[i] = round >= 24 ? i == round - 24 : noise(100 + (uint64_t)round, i);
        double analytic = 0, numeric[2];
        for (int64_t i = 0; i < n; i++) analytic += value(gradient, i) * direction[i] / 1.7;
        for (int half = 0; half < 2; half++) {
            const double step = half ? 0.5e-5 : 1e-5;
            numeric[half] = (energy_at(physics, ctx, frame, x, s->x, direction, step) -
                             energy_at(physics, ctx, frame, x, s->x, direction, -step)) /
                            (2 * step);
        }
        const double difference = fabs((4 * numeric[1] - numeric[0]) / 3 - analytic);
        worst = fmax(worst, difference / fmax(fabs(analytic), 1e-2 * largest));
    }
    if (largest == 0 && energy != 0) worst = INFINITY;
    hg_free(direction);
    return worst;
}

static void check_gradient(const variant *v, void *self)
{
    (void)self;
    hg_ctx *ctx = make_context(1);
    scene s;
    scene_make(&s, 2, 2, 3, 7, 0.1);
    hg_physics *physics;
    ok(hg_physics_create(&physics, ctx, HG_F64, &v->term, 1, &s.data), v->label);
    const hg_frame frame = scene_frame(&s, ctx, HG_F64);
    const double worst = worst_gradient(v, &s, ctx, &frame, physics);
    print_message("    %-60s gradient %.1e\n", v->label, worst);
    if (!(worst < 1e-6)) fail_msg("%s: the gradient is off by %.3e", v->label, worst);
    hg_physics_destroy(physics);
    scene_free(&s);
    hg_ctx_destroy(ctx);
}

static void test_gradients(void **state)
{
    (void)state;
    each_variant(check_gradient, NULL);
}

/* ---- one back end against another ------------------------------------------------------------------------------ */

typedef struct {
    double *energy, *gradient, *per_strand; /* [n], [B,S,V,3], [B,S,n] */
} result;

static result evaluate(const scene *s, hg_dtype dtype, int threads, const hg_term *terms, int n, hg_backend backend,
                       bool give_posed, const char *label, bool *available)
{
    hg_ctx *ctx = make_context(threads);
    hg_physics *physics;
    result r = { numbers(n), numbers(s->B * s->S * s->V * 3), numbers(s->B * s->S * n) };
    ok(hg_physics_create(&physics, ctx, dtype, terms, n, &s->data), label);
    const hg_status status = hg_physics_backend(physics, backend);
    if (available)
        *available = status == HG_OK;
    else
        ok(status, label);
    if (status == HG_OK) {
        hg_frame frame = scene_frame(s, ctx, dtype);
        if (give_posed) frame.posed = upload(ctx, dtype, 4, (int64_t[]){ s->B, s->S, s->V, 3 }, s->posed);
        hg_tensor *x = scene_x(s, ctx, dtype), *gradient = scene_x(s, ctx, dtype);
        ok(hg_physics_evaluate(physics, ctx, &frame, x, r.energy, r.per_strand, gradient), label);
        for (int64_t i = 0; i < hg_tensor_count(gradient); i++) r.gradient[i] = value(gradient, i);
    }
    hg_physics_destroy(physics);
    hg_ctx_destroy(ctx);
    return r;
}

static void result_free(result *r)
{
    hg_free(r->energy);
    hg_free(r->gradient);
    hg_free(r->per_strand);
}

static double difference(const double *a, const double *b, int64_t n)
{
    double worst = 0, largest = 0;
    for (int64_t i = 0; i < n; i++) {
        if (!isfinite(a[i]) || !isfinite(b[i])) return INFINITY;
        worst = fmax(worst, fabs(a[i] - b[i]));
        largest = fmax(largest, fmax(fabs(a[i]), fabs(b[i])));
    }
    return largest > 0 ? worst / largest : worst;
}

static void check_dtypes(const variant *v, void *self)
{
    scene s;
    scene_make(&s, 2, 3, 37, 11, 0.3);
    result a = evaluate(&s, HG_F64, 1, &v->term, 1, HG_BACKEND_INTERPRETER, false, v->label, NULL);
    result b = evaluate(&s, HG_F32, 1, &v->term, 1, HG_BACKEND_INTERPRETER, false, v->label, NULL);
    const double energy = difference(a.energy, b.energy, 1),
                 gradient = difference(a.gradient, b.gradient, s.B * s.S * s.V * 3);
    double sum = 0;
    for (int64_t i = 0; i < s.B * s.S; i++) sum += a.per_strand[i];
    print_message("    %-60s f32 %.1e %.1e\n", v->label, energy, gradient);
    if (!(energy < 2e-4 && gradient < 2e-4))
        fail_msg("%s: f32 is off by %.3e, gradient %.3e", v->label, energy, gradient);
    if (fabs(sum - a.energy[0]) > 1e-12 * fabs(sum)) fail_msg("%s: the strands do not add up", v->label);
    result_free(&a);
    result_free(&b);
    scene_free(&s);
    (void)self;
}

static void test_f32(void **state)
{
    (void)state;
    each_variant(check_dtypes, NULL);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(test_gradients), cmocka_unit_test(test_f32) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
