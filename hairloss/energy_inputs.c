/* What an energy asks for, found by tracing its formulas: nothing of it is declared twice. */
#include "autograd/trace/graph.h"
#include "hairloss/physics.h"

#include <stdio.h>
#include <string.h>

#define ANY(a, b) (HG_ALLOW(HG_INPUT_##a) | HG_ALLOW(HG_INPUT_##b))

static const struct {
    uint32_t kinds;
    const char *name, *shape;
    bool differentiable, optional;
} inputs_by_kind[] = {
    { ANY(X, ROOT_X) | ANY(DISTANCE, FIELD), "x", "[B,S,V,3]", true, false },
    { ANY(REST, ROOT_REST) | ANY(REST_DISTANCE, FIELD_REST), "rest", "[G,S,V,3]", true, false },
    { ANY(POSED, POSED), "posed", "[B,S,V,3]", true, true },
    { ANY(ROOT_ROTATION, ROOT_ROTATION), "root_rotation", "[B,S,4]", true, true },
    { ANY(ROOT_POSITION, ROOT_POSITION), "root_position", "[B,S,3]", true, true },
    { ANY(PREDICTED, PREDICTED), "predicted", "[B,S,V,3]", true, false },
    { ANY(PREVIOUS, PREVIOUS), "previous", "[B,S,V,3]", true, false },
    { ANY(Q, Q), "q", "[B,S,V-1,4]", true, false },
    { ANY(MASS, MASS), "mass", "[G,S,V]", true, true },
    { ANY(CONTACT_POINT, CONTACT_NORMAL), "body_vertices", "[B,N,3]", false, false },
    { ANY(DT, DT), "dt", "[]", true, false },
};

static void add(hg_energy_inputs *to, const char *name, const char *shape, bool differentiable, bool optional)
{
    for (int i = 0; i < to->n; i++)
        if (strcmp(to->input[i].name, name) == 0) return;
    if (to->n == HG_ENERGY_INPUTS) return;
    hg_energy_input *input = &to->input[to->n++];
    *input = (hg_energy_input){ .shape = shape, .differentiable = differentiable, .optional = optional };
    snprintf(input->name, sizeof input->name, "%s", name);
}

hg_status hg_formula_params(hg_scalar (*formula)(void), const hg_trace_scope *scope, uint32_t *params)
{
    hg_graph graph;
    int node;
    hg_graph_init(&graph, 0, true);
    const hg_status status = hg_graph_trace(&graph, formula, scope, &node, NULL);
    for (int i = 0; status == HG_OK && i < graph.n; i++)
        if (graph.nodes[i].op == HG_NODE_INPUT && graph.nodes[i].input.kind == HG_INPUT_PARAM)
            *params |= 1u << graph.nodes[i].input.name;
    hg_graph_free(&graph);
    return status;
}

/* What physics makes itself where it is not given. */
static bool made(const char *attribute) { return strcmp(attribute, "strand_length") == 0; }

hg_status hg_energy_asks(const hg_energy *energy, const char *const *options, bool posed_given, hg_energy_inputs *to)
{
    const bool field = energy->site.kind == HG_SITE_FIELD;
    const uint32_t allowed = energy->site.kind == HG_SITE_WINDOW  ? HG_ALLOW_WINDOW
                             : energy->site.kind == HG_SITE_PAIRS ? HG_ALLOW_PAIRS
                                                                  : HG_ALLOW_FIELD;
    hg_scalar (*const formulas[3])(void) = { energy->trace, energy->root, energy->kernel };
    double params[HG_ENERGY_PARAMS];
    const char *choices[HG_ENERGY_OPTIONS];
    const hg_term given = { energy, 1, NULL, options }, term = { energy, 1, params, choices };
    *to = (hg_energy_inputs){ 0 };
    HG_TRY(hg_term_complete(&given, params, choices));
    hg_formula_names names[3] = { 0 };
    uint32_t kinds = 0;
    hg_status status = HG_OK;
    for (int f = 0; f < 3 && status == HG_OK; f++) {
        hg_trace_scope scope;
        if (!formulas[f]) continue;
        hg_term_scope(&scope, &term, 0, f == 2 ? HG_ALLOW_FIELD_KERNEL : allowed);
        scope.posed_given = posed_given;
        if (f == 1) { /* the root edge */
            scope.window = 2;
            scope.allowed &= ~HG_ALLOW(HG_INPUT_CARRY);
        }
        status = hg_formula_reads(formulas[f], &scope, &names[f]);
        if (status == HG_OK) status = hg_formula_params(formulas[f], &scope, f == 2 ? &to->kernel_params : &to->params);
        kinds |= names[f].kinds;
    }
    if (hg_term_weighs(&term)) kinds |= HG_ALLOW(HG_INPUT_MASS);
    if (energy->contact) kinds |= HG_ALLOW(HG_INPUT_CONTACT_POINT) | HG_ALLOW(HG_INPUT_X);
    if (!posed_given && (kinds & HG_ALLOW(HG_INPUT_POSED))) { /* it is made of these */
        kinds &= ~HG_ALLOW(HG_INPUT_POSED);
        kinds |= HG_ALLOW(HG_INPUT_REST) | HG_ALLOW(HG_INPUT_ROOT_ROTATION) | HG_ALLOW(HG_INPUT_ROOT_POSITION);
    }
    to->scan = (kinds & (HG_ALLOW(HG_INPUT_CARRY) | HG_ALLOW(HG_INPUT_REST_CARRY))) != 0;
    for (size_t k = 0; k < sizeof inputs_by_kind / sizeof *inputs_by_kind; k++)
        if (kinds & inputs_by_kind[k].kinds)
            add(to, inputs_by_kind[k].name, inputs_by_kind[k].shape, inputs_by_kind[k].differentiable,
                inputs_by_kind[k].optional);
    for (int f = 0; f < 3; f++) {
        for (int i = 0; i < names[f].n_attributes; i++)
            add(to, names[f].attributes[i], "[G,S,V]", true, made(names[f].attributes[i]));
        for (int i = 0; i < names[f].n_frames; i++)
            if (strcmp(names[f].frames[i], "deformation_mean") != 0) /* physics makes it of "deformation" */
                add(to, names[f].frames[i], names[f].frame_width[i] == 3 ? "[B,S,V,3]" : "[B,S,V]", true, false);
        hg_formula_names_free(&names[f]);
    }
    if (field && (kinds & HG_ALLOW(HG_INPUT_FIELD_REST))) add(to, "density_rest", "[G,S,V]", true, true);
    return status;
}
