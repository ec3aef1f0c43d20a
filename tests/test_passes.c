/* The passes over pairs and fields by themselves: the derivative of every value that a call can bring (params, time step,
 * masses, rest, attributes, the field at rest) against finite differences in f64; f32 beside it; the same bits for any
 * number of threads; values that are given without a gradient; what is refused. */
#include "passes.h"

static void check_values(const variant *v, bool per_strand, bool density)
{
    scene s;
    brought b;
    scene_make(&s, 2, 3, 5, 6, 0.2);
    bring_all(&b, &s, v->term.energy, per_strand, density);
    pass_result r = run_pass(&s, &v->term, HG_F64, NULL, 1, &b, true, v->label);
    pass_result two = run_pass(&s, &v->term, HG_F64, NULL, 2, &b, true, v->label);
    pass_result single = run_pass(&s, &v->term, HG_F32, NULL, 2, &b, true, v->label);
    assert_memory_equal(r.gradient, two.gradient, (size_t)(s.B * s.S * s.V * 3) * sizeof(double));
    assert_true(difference(r.gradient, single.gradient, s.B * s.S * s.V * 3) < 1e-3);
    double sum = 0;
    for (int64_t i = 0; i < s.B * s.S; i++) sum += r.per_strand[i];
    assert_true(fabs(sum - r.energy) <= 1e-12 * fabs(sum));
    for (int i = 0; i < b.n; i++) {
        double largest = 0, worst = 0;
        int64_t worst_at = 0;
        assert_memory_equal(r.of[i], two.of[i], (size_t)b.count[i] * sizeof(double));
        for (int64_t k = 0; k < b.count[i]; k++) largest = fmax(largest, fabs(r.of[i][k]));
        if (difference(r.of[i], single.of[i], b.count[i]) > 2e-3)
            fail_msg("%s: d/d%s in f32 is off by %.2e", v->label, b.label[i],
                     difference(r.of[i], single.of[i], b.count[i]));
        for (int64_t k = 0; k<b.count[i]; k += b.count[i]> 60 ? 7 : 1) {
            const double kept = b.at[i][k], unit = fmax(fabs(kept), 1e-3);
            double best = INFINITY;
            for (double step = 1e-3; step > 1e-6; step *= 0.2) {
                double energy[4];
                for (int j = 0; j < 4; j++) {
                    b.at[i][k] = kept + (j < 2 ? j - 2 : j - 1) * step * unit;
                    pass_result moved = run_pass(&s, &v->term, HG_F64, NULL, 1, &b, false, v->label);
                    energy[j] = moved.energy;
                    pass_result_free(&moved, b.n);
                }
                b.at[i][k] = kept;
                const double numeric =
                    v->term.weight * (8 * (energy[2] - energy[1]) - energy[3] + energy[0]) / (12 * step * unit);
                best = fmin(best, fabs(numeric - r.of[i][k]) / fmax(fabs(r.of[i][k]), 1e-3 * largest));
            }
            if (largest > 0 ? best > worst : r.of[i][k] != 0) worst = best, worst_at = k;
        }
        print_message("    %-40s d/d%-16s %.1e of %.2e\n", v->label, b.label[i], worst, largest);
        if (!(worst < 1e-6)) fail_msg("%s: d/d%s at %d is off by %.2e", v->label, b.label[i], (int)worst_at, worst);
        /* what a test energy does not ask for: nothing of the scalp in the density, no rest where its field is given */
        const bool field = v->term.energy->site.kind == HG_SITE_FIELD,
                   used = !field ||
                          (strcmp(b.label[i], "scalp_distance") != 0 && (strcmp(b.label[i], "rest") != 0 || !density));
        if (strncmp(v->label, "test_", 5) == 0 && (largest > 0) != used)
            fail_msg("%s: the largest d/d%s is %.2e", v->label, b.label[i], largest);
    }
    pass_result_free(&r, b.n);
    pass_result_free(&two, b.n);
    pass_result_free(&single, b.n);
    bring_free(&b);
    scene_free(&s);
}

static void check_pass(const variant *v, void *self)
{
    (void)self;
    const hg_site_kind site = v->term.energy->site.kind;
    if (site == HG_SITE_WINDOW) return;
    for (int per_strand = 0; per_strand < 2; per_strand++) check_values(v, per_strand, false);
    if (site == HG_SITE_FIELD && !strstr(v->label, "=kg")) check_values(v, false, true); /* a density of vertices */
}

static void test_values(void **state)
{
    (void)state;
    each_variant(check_pass, NULL);
}

/* A value that is given counts, whether its derivative is asked for or not: the same as if the term had said it. */
static void test_given(void **state)
{
    (void)state;
    scene s;
    scene_make(&s, 1, 2, 5, 6, 0.2);
    const struct {
        const char *energy, *param;
        double value;
    } cases[] = { { "adhesion", "radius", 0.05 },
                  { "test_pair", "count", 2 },
                  { "test_pair", "stiffness", 3e-6 },
                  { "self_collision", "h", 0.01 },
                  { "test_density", "skew", 0.5 } };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        const hg_energy *energy = hg_energy_find(cases[i].energy);
        double params[HG_ENERGY_PARAMS];
        int param = 0;
        for (int p = 0; p < HG_ENERGY_PARAMS && energy->params[p].name; p++) {
            params[p] = energy->params[p].value;
            if (strcmp(energy->params[p].name, cases[i].param) == 0) param = p;
        }
        brought none = { 0 }, one = { 0 };
        bring(&one, HG_INPUT_PARAM, param, NULL, cases[i].param, true, 1, &cases[i].value);
        const hg_term plain = { energy, 1.5, params, NULL };
        pass_result a = run_pass(&s, &plain, HG_F64, NULL, 1, &one, false, cases[i].param);
        pass_result c = run_pass(&s, &plain, HG_F64, NULL, 1, &none, false, cases[i].param);
        if (a.energy == c.energy) fail_msg("%s.%s makes no difference", cases[i].energy, cases[i].param);
        params[param] = cases[i].value;
        pass_result d = run_pass(&s, &plain, HG_F64, NULL, 1, &none, false, cases[i].param);
        if (!(fabs(a.energy - d.energy) <= 1e-12 * fabs(d.energy)))
            fail_msg("%s.%s: %.17g given, %.17g by the term", cases[i].energy, cases[i].param, a.energy, d.energy);
        pass_result_free(&a, 1);
        pass_result_free(&c, 0);
        pass_result_free(&d, 0);
        bring_free(&one);
    }
    scene_free(&s);
}

static void refuse(const scene *s, const char *name, const char *param, double number, bool uniform, bool gradient,
                   const char *word)
{
    hg_ctx *ctx = make_context(1);
    const hg_energy *energy = hg_energy_find(name);
    double params[HG_ENERGY_PARAMS], values[16], sums[16] = { 0 }, unweighted;
    const char *options[HG_ENERGY_OPTIONS];
    int at = 0;
    ok(hg_term_complete(&(hg_term){ energy, 1, NULL, NULL }, params, options), name);
    for (int p = 0; p < HG_ENERGY_PARAMS && energy->params[p].name; p++)
        if (strcmp(energy->params[p].name, param) == 0) at = p;
    for (int i = 0; i < 16; i++) values[i] = number;
    const hg_pass_setup setup = { ctx, HG_F64, { energy, 1, params, options }, &s->data, 0 };
    const hg_physics_pass *kind = hg_find("physics_pass", energy->site.kind == HG_SITE_PAIRS ? "pairs" : "field");
    const hg_pass_value value = {
        .kind = HG_INPUT_PARAM, .param = at, .uniform = uniform, .values = values, .gradient = gradient ? sums : NULL
    };
    void *self;
    ok(kind->create(&self, &setup), name);
    const hg_frame frame = scene_frame(s, ctx, HG_F64);
    assert_int_not_equal(kind->run(self, ctx,
                                   &(hg_pass_call){ &frame, frame.groom, scene_x(s, ctx, HG_F64), 1, &value, NULL,
                                                    &unweighted, NULL, 1 }),
                         HG_OK);
    if (!strstr(hg_message(), word)) fail_msg("the message '%s' does not name '%s'", hg_message(), word);
    kind->destroy(self);
    hg_ctx_destroy(ctx);
}

static void test_refused(void **state)
{
    (void)state;
    scene s;
    scene_make(&s, 1, 2, 5, 6, 0.2);
    refuse(&s, "adhesion", "radius", 0.01, true, true, "adhesion.radius");
    refuse(&s, "adhesion", "count", 3, false, false, "adhesion.count");
    refuse(&s, "adhesion", "radius", -1, true, false, "-1");
    refuse(&s, "self_collision", "h", 0.01, false, false, "self_collision.h");
    refuse(&s, "self_collision", "h", 0, true, true, "h is 0 m");
    refuse(&s, "test_density", "skew", 0.1, false, true, "test_density.skew");
    scene_free(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_values),
        cmocka_unit_test(test_given),
        cmocka_unit_test(test_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
