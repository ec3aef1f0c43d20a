/* What becomes of energies, as text: for `hairgrad trace`. */
#include "autograd/trace/report.h"
#include "hairloss/physics.h"

#include <string.h>

enum { TERMS = 16 };

static hg_status add_formula(hg_report_formula *to, int *n, const hg_term *term, int number, hg_scalar (*formula)(void),
                             uint32_t allowed)
{
    if (!formula) return HG_OK;
    to[*n] = (hg_report_formula){ .formula = formula };
    hg_term_scope(&to[*n].scope, term, number, allowed);
    if (formula == term->energy->root) to[*n].scope.window = 2;
    ++*n;
    return HG_OK;
}

typedef struct {
    int n;
    hg_given given[HG_GIVEN];
    hg_formula_names names[TERMS]; /* of the formulas; the given point to them */
} wanted;

/* "rest", "root_rotation", a parameter ("stiffness", "bend_twist.stiffness"), a groom attribute, an array of the frame. */
static hg_status want(wanted *w, const hg_term *terms, int n, const char *name)
{
    static const struct {
        const char *name;
        hg_input_kind kind;
    } kinds[] = {
        { "rest", HG_INPUT_REST },
        { "mass", HG_INPUT_MASS },
        { "posed", HG_INPUT_POSED },
        { "predicted", HG_INPUT_PREDICTED },
        { "previous", HG_INPUT_PREVIOUS },
        { "root_rotation", HG_INPUT_ROOT_ROTATION },
        { "root_position", HG_INPUT_ROOT_POSITION },
        { "q", HG_INPUT_Q },
        { "dt", HG_INPUT_DT },
    };
    const int before = w->n;
    if (strcmp(name, "x") == 0) return HG_OK;
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++)
        if (strcmp(name, kinds[i].name) == 0 && w->n < HG_GIVEN)
            w->given[w->n++] = (hg_given){ .kind = kinds[i].kind, .gradient = true };
    for (int t = 0; t < n; t++) {
        const hg_energy *energy = terms[t].energy;
        const char *dot = strchr(name, '.');
        const size_t length = strlen(energy->name);
        const bool own = dot && (size_t)(dot - name) == length && strncmp(name, energy->name, length) == 0;
        for (int k = 0; k < HG_ENERGY_PARAMS && energy->params[k].name; k++)
            if ((strcmp(name, energy->params[k].name) == 0 || (own && strcmp(dot + 1, energy->params[k].name) == 0)) &&
                w->n < HG_GIVEN)
                w->given[w->n++] = (hg_given){ .kind = HG_INPUT_PARAM, .term = t, .param = k, .gradient = true };
        if (w->n > before) continue;
        for (int k = 0; k < w->names[t].n_attributes; k++)
            if (strcmp(name, w->names[t].attributes[k]) == 0 && w->n < HG_GIVEN)
                w->given[w->n++] =
                    (hg_given){ .kind = HG_INPUT_ATTRIBUTE, .name = w->names[t].attributes[k], .gradient = true };
        for (int k = 0; k < w->names[t].n_frames; k++)
            if (strcmp(name, w->names[t].frames[k]) == 0 && w->n < HG_GIVEN)
                w->given[w->n++] =
                    (hg_given){ .kind = HG_INPUT_FRAME, .name = w->names[t].frames[k], .gradient = true };
    }
    if (w->n > before) return HG_OK;
    return hg_fail(HG_INVALID,
                   "trace: '%s' is nothing that the formula depends on: x, rest, mass, posed, predicted, previous, "
                   "root_rotation, root_position, q, dt, a parameter, a groom attribute or an array of the frame is",
                   name);
}

static hg_status trace_window(const hg_term *terms, int n, hg_dtype dtype, const wanted *w, hg_text *report, hg_text *c,
                              hg_text *cuda)
{
    hg_report_formula formulas[2 * TERMS];
    hg_strand_term traced[TERMS];
    int count = 0;
    for (int t = 0; t < n; t++) {
        const hg_energy *energy = terms[t].energy;
        HG_TRY(add_formula(formulas, &count, &terms[t], t, energy->trace, HG_ALLOW_WINDOW));
        HG_TRY(add_formula(formulas, &count, &terms[t], t, energy->root, HG_ALLOW_WINDOW));
        traced[t] = (hg_strand_term){ .trace = energy->trace, .root = energy->root };
        hg_term_scope(&traced[t].scope, &terms[t], t, HG_ALLOW_WINDOW);
    }
    hg_strand_program *program;
    HG_TRY(hg_report_counts(count, formulas, HG_ALLOW(HG_INPUT_X) | HG_ALLOW(HG_INPUT_ROOT_X), w->n, w->given, report));
    HG_TRY(hg_strand_program_create(&program, dtype, n, traced, w->n, w->given, true));
    hg_report_program(program, n, traced, report);
    if (c) hg_strand_print_c(program, "kernel", c);
    if (cuda) hg_strand_print_cuda(program, "kernel", cuda);
    hg_strand_program_destroy(program);
    return HG_OK;
}

static hg_status trace_terms(const hg_term *terms, int n, hg_dtype dtype, int n_wrt, const char *const *wrt, wanted *w,
                             hg_text *report, hg_text *c, hg_text *cuda)
{
    hg_term completed[TERMS];
    double params[TERMS][HG_ENERGY_PARAMS];
    const char *options[TERMS][HG_ENERGY_OPTIONS];
    if (n < 1 || n > TERMS) return hg_fail(HG_INVALID, "trace: %d energies; 1 to %d are possible", n, TERMS);
    for (int t = 0; t < n; t++) {
        HG_TRY(hg_term_complete(&terms[t], params[t], options[t]));
        completed[t] = (hg_term){ terms[t].energy, terms[t].weight, params[t], options[t] };
        if (n > 1 && terms[t].energy->site.kind != HG_SITE_WINDOW)
            return hg_fail(HG_INVALID,
                           "trace: energy '%s' runs over pairs or neighbours, in a pass of its own: trace it alone",
                           terms[t].energy->name);
    }
    hg_status status = HG_OK;
    for (int t = 0; status == HG_OK && t < n && terms[0].energy->site.kind == HG_SITE_WINDOW; t++) {
        hg_trace_scope scope;
        hg_term_scope(&scope, &completed[t], t, HG_ALLOW_WINDOW);
        status = hg_formula_reads(completed[t].energy->trace, &scope, &w->names[t]);
    }
    for (int i = 0; status == HG_OK && i < n_wrt; i++) status = want(w, completed, n, wrt[i]);
    if (status != HG_OK) return status;
    hg_report_formula formulas[2];
    int count = 0;
    const hg_term *one = &completed[0];
    switch (one->energy->site.kind) {
    case HG_SITE_WINDOW:
        status = trace_window(completed, n, dtype, w, report, c, cuda);
        break;
    case HG_SITE_PAIRS:
        status = add_formula(formulas, &count, one, 0, one->energy->trace, HG_ALLOW_PAIRS);
        if (status == HG_OK)
            status = hg_report_counts(count, formulas, HG_ALLOW(HG_INPUT_DISTANCE), w->n, w->given, report);
        break;
    case HG_SITE_FIELD:
        hg_text_add(report, "the weight of a neighbour: ");
        status = add_formula(formulas, &count, one, 0, one->energy->kernel, HG_ALLOW_FIELD_KERNEL);
        if (status == HG_OK)
            status = hg_report_counts(count, formulas, HG_ALLOW(HG_INPUT_DISTANCE), w->n, w->given, report);
        count = 0;
        hg_text_add(report, "the function of the sum: ");
        if (status == HG_OK) status = add_formula(formulas, &count, one, 0, one->energy->trace, HG_ALLOW_FIELD);
        if (status == HG_OK)
            status = hg_report_counts(count, formulas, HG_ALLOW(HG_INPUT_FIELD), w->n, w->given, report);
        break;
    }
    if (status == HG_OK && (report->failed || (c && c->failed) || (cuda && cuda->failed))) return HG_MEMORY;
    return status;
}

hg_status hg_energy_trace(const hg_term *terms, int n, hg_dtype dtype, int n_wrt, const char *const *wrt,
                          hg_text *report, hg_text *c, hg_text *cuda)
{
    wanted *w = hg_alloc(1, sizeof *w);
    if (!w) return HG_MEMORY;
    const hg_status status = trace_terms(terms, n, dtype, n_wrt, wrt, w, report, c, cuda);
    for (int t = 0; t < TERMS; t++) hg_formula_names_free(&w->names[t]);
    hg_free(w);
    return status;
}
