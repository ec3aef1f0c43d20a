/* Two energies that ask for everything that a pass over pairs or fields can bring, and a pass run by itself, on any device. */
#ifndef PASSES_H
#define PASSES_H

#include "energies_walk.h"

#include "autograd/trace/names.h"

/* A pair energy and a field energy that ask for everything that they can. */
static scalar test_pair(void)
{
    scalar both = add(1, mul(1e8, mass(0)), mul(2e8, mass(1)), mul(50, attribute("body_distance", 0)),
                      mul(90, attribute("scalp_distance", 1)));
    scalar apart = sub(distance(), mul(param("scale"), rest_distance()));
    return mul(param("stiffness"), both, add(square(apart), mul(dt(), square(square(mul(30, distance()))))));
}

HG_ENERGY(test_pair, .equation = "k (...)", .source = "test", .site = { HG_SITE_PAIRS, 2 },
          .params = { { "stiffness", 1e-3, "N/m", "spring" },
                      { "scale", 0.9, "1", "of the rest distance" },
                      { "radius", 0.02, "m", "of the list" },
                      { "count", 4, "1", "of the list" } },
          .rigid_invariant = true);

static scalar test_kernel(void)
{
    scalar s = divide(distance(), param("h")), inside = max(0, sub(1, mul(0.25, square(s))));
    return mul(add(1, mul(param("skew"), s)), mul(inside, square(inside)));
}

static scalar test_density(void)
{
    scalar excess = sub(field(), mul(param("scale"), field_rest()));
    scalar site = add(1, mul(1e8, mass(0)), mul(60, attribute("body_distance", 0)), mul(3, dt()));
    if (option("kernel_mass", "kg")) excess = mul(4e7, excess);
    return mul(param("stiffness"), site, square(add(1, mul(param("h"), 100), excess)));
}

HG_ENERGY(test_density, .equation = "k (...)", .source = "test", .site = { HG_SITE_FIELD, 1 },
          .params = { { "stiffness", 1e-6, "J", "energy" },
                      { "scale", 0.7, "1", "of the rest field" },
                      { "h", 0.006, "m", "half of the support" },
                      { "skew", 0.3, "1", "of the kernel" } },
          .options = { { "kernel_mass", "unit|kg", "unit", "what a vertex counts" } }, .kernel = test_kernel,
          .reach = "h", .rigid_invariant = true);

#undef sqrt
#undef abs
#undef min
#undef max
#undef select
#undef field
#undef exp
#undef log
#undef sin
#undef cos

/* ---- one pass, alone ------------------------------------------------------------------------------------------ */

enum { MOST_VALUES = 16 };

typedef struct {
    int n;
    hg_pass_value values[MOST_VALUES];
    char label[MOST_VALUES][64];
    int64_t count[MOST_VALUES];
    double *at[MOST_VALUES]; /* the values in f64 */
} brought;

static inline void bring(brought *b, hg_input_kind kind, int param, const char *name, const char *label, bool uniform,
                         int64_t count, const double *from)
{
    const int i = b->n++;
    assert_true(i < MOST_VALUES);
    b->values[i] = (hg_pass_value){ .kind = kind, .term = 3, .param = param, .name = name, .uniform = uniform };
    snprintf(b->label[i], sizeof b->label[i], "%s", label);
    b->count[i] = count;
    b->at[i] = numbers(count);
    memcpy(b->at[i], from, (size_t)count * sizeof *from);
}

/* Everything that the energy can be given on the scene; per_strand: params that may differ from strand to strand do. */
static inline void bring_all(brought *b, const scene *s, const hg_energy *energy, bool per_strand, bool density)
{
    *b = (brought){ 0 };
    const int64_t n = s->G * s->S * s->V;
    for (int p = 0; p < HG_ENERGY_PARAMS && energy->params[p].name; p++) {
        const char *name = energy->params[p].name;
        if (strcmp(name, "radius") == 0 || strcmp(name, "count") == 0) continue;
        const bool kernel = strcmp(name, "h") == 0 || strcmp(name, "skew") == 0, uniform = kernel || !per_strand;
        const int64_t count = uniform ? 1 : s->B * s->S;
        double *values = numbers(count);
        for (int64_t i = 0; i < count; i++) values[i] = energy->params[p].value * (1 + 0.3 * noise(40 + p, i));
        bring(b, HG_INPUT_PARAM, p, NULL, name, uniform, count, values);
        hg_free(values);
    }
    const double dt = 0.04;
    double *rest = numbers(3 * n), *field = numbers(n);
    for (int64_t i = 0; i < 3 * n; i++) rest[i] = s->rest[i] + 3e-4 * noise(50, i);
    for (int64_t i = 0; i < n; i++) field[i] = 3 + noise(51, i);
    bring(b, HG_INPUT_DT, 0, NULL, "dt", true, 1, &dt);
    bring(b, HG_INPUT_MASS, 0, NULL, "mass", false, n, s->mass);
    bring(b, HG_INPUT_REST, 0, NULL, "rest", false, 3 * n, rest);
    bring(b, HG_INPUT_ATTRIBUTE, 0, "body_distance", "body_distance", false, n, s->body_distance);
    bring(b, HG_INPUT_ATTRIBUTE, 0, "scalp_distance", "scalp_distance", false, n, s->scalp_distance);
    if (density) bring(b, HG_INPUT_ATTRIBUTE, 0, "density_rest", "density_rest", false, n, field);
    hg_free(rest);
    hg_free(field);
}

static inline void bring_free(brought *b)
{
    for (int i = 0; i < b->n; i++) hg_free(b->at[i]);
}

typedef struct {
    double energy, *gradient, *of[MOST_VALUES]; /* [B,S,V,3] and of every value, f64 */
    double *per_strand;
} pass_result;

static inline pass_result run_pass(const scene *s, const hg_term *term, hg_dtype dtype, const char *device, int threads,
                                   const brought *b, bool gradients, const char *label)
{
    hg_ctx *ctx;
    ok(hg_ctx_create(&ctx, &(hg_ctx_options){ .device = device, .threads = threads, .seed = 1 }), label);
    double params[HG_ENERGY_PARAMS];
    const char *options[HG_ENERGY_OPTIONS];
    ok(hg_term_complete(term, params, options), label);
    const hg_pass_setup setup = { ctx, dtype, { term->energy, term->weight, params, options }, &s->data, 3 };
    const hg_physics_pass *kind = hg_find("physics_pass", term->energy->site.kind == HG_SITE_PAIRS ? "pairs" : "field");
    void *self;
    ok(kind->create(&self, &setup), label);
    const hg_frame frame = scene_frame(s, ctx, dtype);
    hg_tensor *x = scene_x(s, ctx, dtype), *gradient = scene_x(s, ctx, dtype);
    hg_pass_value values[MOST_VALUES];
    hg_tensor *value_of[MOST_VALUES], *gradient_of[MOST_VALUES];
    const int64_t strands = s->B * s->S;
    pass_result r = { .gradient = numbers(hg_tensor_count(x)), .per_strand = numbers(strands) };
    hg_tensor *groom = hg_tensor_make(ctx, HG_I32, 1, &s->B), *sum = hg_tensor_make(ctx, HG_F64, 0, NULL),
              *per_strand = hg_tensor_make(ctx, HG_F64, 1, &strands);
    ok(hg_tensor_write(groom, s->groom), label);
    for (int repeat = 0; repeat < 2; repeat++) { /* the second time with what the first left */
        ok(hg_tensor_fill(gradient, 0), label);
        for (int i = 0; i < b->n; i++) {
            double *zeros = numbers(b->count[i]);
            value_of[i] = upload(ctx, dtype, 1, &b->count[i], b->at[i]);
            gradient_of[i] = upload(ctx, dtype, 1, &b->count[i], zeros);
            hg_free(zeros);
            values[i] = b->values[i];
            values[i].values = value_of[i]->data;
            values[i].gradient = gradients ? gradient_of[i]->data : NULL;
        }
        ok(kind->run(self, ctx,
                     &(hg_pass_call){ &frame, groom->data, x, b->n, values, gradients ? gradient->data : NULL,
                                      sum->data, per_strand->data, 1 }),
           label);
    }
    r.energy = value(sum, 0);
    ok(hg_tensor_read(per_strand, r.per_strand), label);
    for (int64_t i = 0; i < hg_tensor_count(x); i++) r.gradient[i] = value(gradient, i);
    for (int i = 0; i < b->n; i++) {
        r.of[i] = numbers(b->count[i]);
        for (int64_t k = 0; k < b->count[i]; k++) r.of[i][k] = value(gradient_of[i], k);
    }
    kind->destroy(self);
    hg_ctx_destroy(ctx);
    return r;
}

static inline void pass_result_free(pass_result *r, int n)
{
    hg_free(r->gradient);
    hg_free(r->per_strand);
    for (int i = 0; i < n; i++) hg_free(r->of[i]);
}

#endif
