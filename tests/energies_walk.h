/* Walking over every energy in the registry with every combination of its options, and running a physics on the scene. */
#ifndef ENERGIES_WALK_H
#define ENERGIES_WALK_H

#include "device.h"
#include "energies_scene.h"

#include "hairloss/physics.h"
#include "hairloss/usual_sums.h"

#include <setjmp.h>
#include <stdarg.h>
#include <cmocka.h>

enum { MAX_INPUTS = 16, MAX_ENERGIES = 64, WITH_STYLE = 7 /* of the usual sums: has all window energies */ };

typedef struct {
    hg_term term;
    char label[160];
} variant;

/* Calls what for every energy and every combination of its options. */
static inline void each_variant(void (*what)(const variant *v, void *self), void *self)
{
    const char *names[MAX_ENERGIES];
    const int n = hg_list("energy", names, MAX_ENERGIES);
    assert_true(n >= 7 && n <= MAX_ENERGIES);
    for (int i = 0; i < n; i++) {
        const hg_energy *energy = hg_energy_find(names[i]);
        assert_non_null(energy);
        variant v;
        hg_energy_choice choice;
        for (int code = 0; hg_energy_choose(energy, code, &choice); code++) {
            int length = snprintf(v.label, sizeof v.label, "%s", names[i]);
            for (int k = 0; k < HG_ENERGY_OPTIONS && energy->options[k].name; k++)
                length += snprintf(v.label + length, sizeof v.label - (size_t)length, " %s=%s", energy->options[k].name,
                                   choice.options[k]);
            v.term = (hg_term){ energy, 1.7, NULL, choice.options };
            what(&v, self);
        }
    }
}

static inline hg_ctx *make_context_on(const char *device, int threads)
{
    hg_ctx *ctx;
    const hg_ctx_options options = { .threads = threads, .seed = 1, .device = device };
    if (hg_ctx_create(&ctx, &options) != HG_OK) fail_msg("%s", hg_message());
    return ctx;
}

static inline hg_ctx *make_context(int threads) { return make_context_on(test_device(), threads); }

static inline void ok(hg_status status, const char *label)
{
    if (status != HG_OK) fail_msg("%s: %s", label, hg_message());
}

static inline double value(const hg_tensor *tensor, int64_t i) { return hg_tensor_item(tensor, i); }

/* Brings the arrays that the energies ask for by name; of a name of a test's own, something. They live as long as the step. */
static inline void scene_bring(const scene *s, hg_ctx *ctx, hg_dtype dtype, const hg_term *terms, int n,
                               hg_frame *frame)
{
    const int64_t vertices[4] = { s->B, s->S, s->V, 3 }, edges[4] = { s->B, s->S, s->V - 1, 4 };
    hg_frame_input *list = hg_step_alloc(ctx, MAX_INPUTS * sizeof *list);
    hg_energy_inputs *asks = hg_step_alloc(ctx, (size_t)n * sizeof *asks);
    assert_true(list && asks);
    frame->inputs = list;
    for (int t = 0; t < n; t++) {
        ok(hg_energy_asks(terms[t].energy, terms[t].options, false, &asks[t]), terms[t].energy->name);
        for (int i = 0; i < asks[t].n; i++) {
            const hg_energy_input *input = &asks[t].input[i];
            const bool q = strcmp(input->name, "q") == 0, vectors = strcmp(input->shape, "[B,S,V,3]") == 0;
            static const char *const members[] = { "x", "posed", "predicted", "previous" };
            bool known = input->shape[1] != 'B' || (!q && !vectors && strcmp(input->shape, "[B,S,V]") != 0);
            for (int k = 0; k < 4; k++) known |= strcmp(input->name, members[k]) == 0;
            for (int k = 0; k < frame->n_inputs; k++) known |= strcmp(input->name, list[k].name) == 0;
            if (known) continue;
            assert_true(frame->n_inputs < MAX_INPUTS);
            const double *values = q ? s->q : strcmp(input->name, "deformation") == 0 ? s->deformation : s->ghost;
            list[frame->n_inputs++] =
                (hg_frame_input){ input->name, upload(ctx, dtype, vectors || q ? 4 : 3, q ? edges : vertices, values) };
        }
    }
}

typedef struct {
    double *energy, *gradient, *per_strand; /* [n], [B,S,V,3], [B,S,n] */
} result;

static inline result evaluate_on(const char *device, const scene *s, hg_dtype dtype, int threads, const hg_term *terms,
                                 int n, hg_backend backend, bool give_posed, const char *label, bool *available)
{
    hg_ctx *ctx = make_context_on(device, threads);
    if (!hg_ctx_host(ctx)) backend = HG_BACKEND_AUTO; /* there is one */
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
        scene_bring(s, ctx, dtype, terms, n, &frame);
        if (give_posed) frame.posed = upload(ctx, dtype, 4, (int64_t[]){ s->B, s->S, s->V, 3 }, s->posed);
        hg_tensor *x = scene_x(s, ctx, dtype), *gradient = scene_x(s, ctx, dtype);
        ok(hg_physics_evaluate(physics, ctx, &frame, x, r.energy, r.per_strand, gradient), label);
        for (int64_t i = 0; i < hg_tensor_count(gradient); i++) r.gradient[i] = value(gradient, i);
    }
    hg_physics_destroy(physics);
    hg_ctx_destroy(ctx);
    return r;
}

static inline result evaluate(const scene *s, hg_dtype dtype, int threads, const hg_term *terms, int n,
                              hg_backend backend, bool give_posed, const char *label, bool *available)
{
    return evaluate_on(test_device(), s, dtype, threads, terms, n, backend, give_posed, label, available);
}

static inline void result_free(result *r)
{
    hg_free(r->energy);
    hg_free(r->gradient);
    hg_free(r->per_strand);
}

static inline double difference(const double *a, const double *b, int64_t n)
{
    double worst = 0, largest = 0;
    for (int64_t i = 0; i < n; i++) {
        if (!isfinite(a[i]) || !isfinite(b[i])) return INFINITY;
        worst = fmax(worst, fabs(a[i] - b[i]));
        largest = fmax(largest, fmax(fabs(a[i]), fabs(b[i])));
    }
    return largest > 0 ? worst / largest : worst;
}

static inline int usual_terms(int number, hg_term terms[USUAL_TERMS])
{
    int n = 0;
    for (; n < USUAL_TERMS && usual_sums[number][n].energy; n++)
        terms[n] = (hg_term){ hg_energy_find(usual_sums[number][n].energy), 0.5 + 0.25 * n, NULL,
                              usual_sums[number][n].options };
    return n;
}

#endif
