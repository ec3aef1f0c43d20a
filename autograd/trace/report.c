/* What becomes of formulas, for people: how many operations each simplification leaves, what is computed how often, and the
 * lists that are run. */
#include "autograd/trace/report.h"

#include <stdio.h>
#include <string.h>

/* ---- counts ------------------------------------------------------------------------------------------------- */

static bool is_operation(const hg_node *node)
{
    return node->op != HG_NODE_NUMBER && node->op != HG_NODE_INPUT && node->op != HG_NODE_DETACH;
}

/* What the marked nodes need, and how many operations that is. */
static int spread(const hg_graph *graph, bool *reached)
{
    int n = 0;
    for (int i = graph->n - 1; i >= 0; i--) {
        const hg_node *node = &graph->nodes[i];
        if (!reached[i]) continue;
        n += is_operation(node);
        if (node->a >= 0) reached[node->a] = true;
        if (node->b >= 0) reached[node->b] = true;
        if (node->c >= 0) reached[node->c] = true;
    }
    return n;
}

static int distinct(const hg_graph *graph)
{
    int n = 0;
    for (int i = 0; i < graph->n; i++) n += is_operation(&graph->nodes[i]);
    return n;
}

static void count_rates(const hg_graph *graph, const bool *reached, hg_text *text)
{
    static const struct {
        hg_rate rate;
        const char *when, *why;
    } rates[] = {
        { HG_RATE_UNIFORM, "once per call", "parameters, weights and the time step alone" },
        { HG_RATE_GROOM, "once per groom and site", "rest data alone" },
        { HG_RATE_GROOM_STRAND, "once per groom and strand", "rest data of the root alone" },
        { HG_RATE_STRAND, "once per strand and frame", "the root of this frame" },
        { HG_RATE_SITE, "at every site", "a vertex of this frame" },
    };
    for (size_t k = 0; k < sizeof rates / sizeof *rates; k++) {
        int n = 0;
        for (int i = 0; i < graph->n; i++)
            n += reached[i] && is_operation(&graph->nodes[i]) && graph->nodes[i].rate == rates[k].rate;
        hg_text_add(text, "    %-28s %6d   what depends on %s\n", rates[k].when, n, rates[k].why);
    }
}

hg_status hg_report_counts(int n, const hg_report_formula *formulas, uint32_t wrt, int n_given, const hg_given *given,
                           hg_text *text)
{
    hg_graph graph;
    hg_graph_init(&graph, wrt, true);
    graph.given = given;
    graph.n_given = n_given;
    int *roots = hg_alloc((size_t)n + 1, sizeof *roots), *seeds = hg_alloc((size_t)n + 1, sizeof *seeds),
        *adjoint = NULL;
    bool *reached = NULL;
    hg_status status = roots && seeds ? HG_OK : HG_MEMORY;
    for (int i = 0; status == HG_OK && i < n; i++)
        status = hg_graph_trace(&graph, formulas[i].formula, &formulas[i].scope, &roots[i], NULL);
    const int traced = graph.n, there = distinct(&graph);
    int alive = 0, with_derivative = 0;
    if (status == HG_OK) {
        for (int i = 0; i < n; i++)
            seeds[i] = hg_graph_input(&graph, (hg_input){ HG_INPUT_WEIGHT, 0, 0, 0, (int16_t)formulas[i].scope.term });
        adjoint = hg_alloc((size_t)graph.n + 1, sizeof *adjoint);
        reached = hg_alloc((size_t)graph.n + 1, sizeof *reached);
        status = adjoint && reached ? HG_OK : HG_MEMORY;
    }
    if (status == HG_OK) {
        for (int i = 0; i < n; i++) reached[roots[i]] = true;
        alive = spread(&graph, reached);
        hg_free(reached);
        for (int i = 0; i < graph.n; i++) adjoint[i] = -1;
        status = hg_graph_reverse(&graph, n, roots, seeds, false, adjoint);
        reached = hg_alloc((size_t)graph.n + 1, sizeof *reached);
        if (!reached) status = HG_MEMORY;
    }
    if (status == HG_OK) {
        for (int i = 0; i < n; i++) reached[roots[i]] = true;
        for (int i = 0; i < traced; i++)
            if (graph.nodes[i].op == HG_NODE_INPUT && graph.nodes[i].active && adjoint[i] >= 0)
                reached[adjoint[i]] = true;
        with_derivative = spread(&graph, reached);
        const int after = graph.count.asked - graph.count.folded - graph.count.simplified;
        hg_text_add(text, "operations on scalars\n");
        hg_text_add(text, "    %-28s %6d\n", "asked for", graph.count.asked);
        hg_text_add(text, "    %-28s %6d   %d on numbers alone, %d like x + 0, 1 x, -(-x)\n", "after folding", after,
                    graph.count.folded, graph.count.simplified);
        hg_text_add(text,
                    "    %-28s %6d   %d were there already; some became two (a / b is a (1/b) where b is slower)\n",
                    "after sharing", there, graph.count.shared);
        hg_text_add(text, "    %-28s %6d   %d that nothing needs\n", "after dropping the dead", alive, there - alive);
        hg_text_add(text, "    %-28s %6d   %d more\n", "with the derivative", with_derivative, with_derivative - alive);
        hg_text_add(text, "of these\n");
        count_rates(&graph, reached, text);
    }
    hg_free(roots);
    hg_free(seeds);
    hg_free(adjoint);
    hg_free(reached);
    hg_graph_free(&graph);
    return status;
}

/* ---- expressions -------------------------------------------------------------------------------------------- */

typedef struct {
    const hg_strand_program *program;
    const hg_strand_term *terms;
    int n_terms;
    const hg_code *code;
    const hg_numbers *numbers;
    const hg_input *inputs; /* of a function */
    hg_text *text;
    size_t end; /* where the text has to stop */
} teller;

static void tell_operand(teller *t, hg_operand o, int depth);

static void tell_input(teller *t, hg_input in)
{
    static const char xyz[] = "xyz", wxyz[] = "wxyz";
    const char *name = hg_input_name(in.kind);
    switch (in.kind) {
    case HG_INPUT_PARAM:
        if (in.term < t->n_terms && in.name < t->terms[in.term].scope.n_params)
            name = t->terms[in.term].scope.params[in.name];
        hg_text_add(t->text, "%s", name);
        return;
    case HG_INPUT_WEIGHT:
        hg_text_add(t->text, t->n_terms > 1 && in.term < t->n_terms ? "weight of %s" : "weight",
                    t->terms[in.term].scope.name);
        return;
    case HG_INPUT_ATTRIBUTE:
        hg_text_add(t->text, "%s[%d]", in.name < t->program->n_attributes ? t->program->attributes[in.name] : name,
                    in.offset);
        return;
    case HG_INPUT_ROOT_ROTATION:
        hg_text_add(t->text, "%s.%c", name, wxyz[in.component & 3]);
        return;
    case HG_INPUT_MASS:
    case HG_INPUT_DISTANCE:
    case HG_INPUT_REST_DISTANCE:
    case HG_INPUT_FIELD:
    case HG_INPUT_FIELD_REST:
    case HG_INPUT_DT:
        hg_text_add(t->text, in.kind == HG_INPUT_MASS ? "%s[%d]" : "%s", name, in.offset);
        return;
    default:
        hg_text_add(t->text, "%s[%d].%c", name, in.offset, xyz[in.component % 3]);
        return;
    }
}

static const hg_instruction *definition(const teller *t, hg_operand o)
{
    for (int i = 0; i < t->code->n; i++) {
        const hg_operand to = t->code->instructions[i].to;
        if (to.place == HG_PLACE_REGISTER && to.index == o.index) return &t->code->instructions[i];
    }
    return NULL;
}

static void tell_instruction(teller *t, const hg_instruction *in, int depth)
{
    static const char *const signs[HG_NODE_OPS] = {
        [HG_NODE_ADD] = " + ", [HG_NODE_SUB] = " - ", [HG_NODE_MUL] = " ", [HG_NODE_DIV] = " / ", [HG_NODE_LESS] = " < "
    };
    const hg_operand from[3] = { in->a, in->b, in->c };
    const int n = hg_node_arguments((hg_node_op)in->op);
    const char *sign = signs[in->op];
    if (in->op == HG_NODE_NEG)
        hg_text_add(t->text, "-");
    else if (!sign)
        hg_text_add(t->text, "%s(", hg_node_name((hg_node_op)in->op));
    else if (depth > 0)
        hg_text_add(t->text, "(");
    for (int k = 0; k < n; k++) {
        if (k) hg_text_add(t->text, "%s", sign ? sign : ", ");
        tell_operand(t, from[k], depth + 1);
    }
    if ((sign && depth > 0) || (!sign && in->op != HG_NODE_NEG)) hg_text_add(t->text, ")");
}

static void tell_operand(teller *t, hg_operand o, int depth)
{
    if (t->text->size >= t->end) {
        hg_text_add(t->text, "..");
        return;
    }
    const hg_instruction *in;
    switch (o.place) {
    case HG_PLACE_REGISTER:
        in = definition(t, o);
        if (in && depth < 12)
            tell_instruction(t, in, depth);
        else
            hg_text_add(t->text, "..");
        return;
    case HG_PLACE_NUMBER:
        hg_text_add(t->text, "%.9g", t->numbers->values[o.index]);
        return;
    case HG_PLACE_IN:
        tell_input(t, t->inputs[o.index]);
        return;
    case HG_PLACE_UNIFORM:
        hg_text_add(t->text, "u%d", o.index);
        return;
    case HG_PLACE_GROOM_STRAND:
        hg_text_add(t->text, "s%d", o.index);
        return;
    case HG_PLACE_STRAND_INPUT:
        if (o.index < 4)
            hg_text_add(t->text, "R.%c", "wxyz"[o.index]);
        else if (o.index < 7)
            hg_text_add(t->text, "p.%c", "xyz"[o.index - 4]);
        else
            hg_text_add(t->text, "given %d", o.index - 7);
        return;
    case HG_PLACE_ROOT_X0:
    case HG_PLACE_ROOT_X1:
        hg_text_add(t->text, "root_x[%d].%c", o.place == HG_PLACE_ROOT_X1, "xyz"[o.index % 3]);
        return;
    case HG_PLACE_ROOT_REST0:
    case HG_PLACE_ROOT_REST1:
        hg_text_add(t->text, "root_rest[%d].%c", o.place == HG_PLACE_ROOT_REST1, "xyz"[o.index % 3]);
        return;
    default:
        hg_text_add(t->text, "value");
        return;
    }
}

/* One line per output of the list, of long ones the beginning. */
enum { LINES = 12 };

static void tell_outputs(teller *t, const char *letter)
{
    int told = 0;
    for (int i = 0; i < t->code->n; i++) {
        const hg_instruction *in = &t->code->instructions[i];
        if (in->to.place == HG_PLACE_REGISTER || told++ >= LINES) continue;
        hg_text_add(t->text, "    %s%d = ", letter, in->to.index);
        t->end = t->text->size + 70;
        tell_operand(t, in->a, 0);
        hg_text_add(t->text, "\n");
    }
    if (told > LINES) hg_text_add(t->text, "    and %d more\n", told - LINES);
}

static void tell_function(teller *t, const hg_function *function, int n, const char *letter, const char *when)
{
    if (!function || n == 0) return;
    int inputs;
    t->code = hg_function_code(function, &t->numbers);
    t->inputs = hg_function_inputs(function, &inputs);
    hg_text_add(t->text, "%s: %d value%s kept\n", when, n, n > 1 ? "s" : "");
    tell_outputs(t, letter);
}

/* ---- the program -------------------------------------------------------------------------------------------- */

/* Registers that hold a value at the same time, at most: what the machine's have to be enough for. */
static int alive_at_once(const hg_code *code)
{
    int most = 0, now = 0;
    int *last = hg_alloc((size_t)code->registers + 1, sizeof *last);
    for (int i = 0; last && i < code->n; i++) {
        const hg_operand from[3] = { code->instructions[i].a, code->instructions[i].b, code->instructions[i].c };
        for (int k = 0; k < 3; k++)
            if (from[k].place == HG_PLACE_REGISTER) last[from[k].index] = i;
    }
    for (int i = 0; last && i < code->n; i++) {
        const hg_instruction *in = &code->instructions[i];
        const hg_operand from[3] = { in->a, in->b, in->c };
        for (int k = 0; k < 3; k++) {
            bool again = false;
            for (int j = 0; j < k; j++) again |= from[j].place == from[k].place && from[j].index == from[k].index;
            now -= from[k].place == HG_PLACE_REGISTER && last[from[k].index] == i && !again;
        }
        now += in->to.place == HG_PLACE_REGISTER;
        if (now > most) most = now;
    }
    hg_free(last);
    return most;
}

static void tell_list(const hg_code *code, const char *when, hg_text *text)
{
    int arithmetic = 0, dear = 0;
    for (int i = 0; i < code->n; i++) {
        const uint8_t op = code->instructions[i].op;
        arithmetic += op < HG_NODE_OPS;
        dear += op == HG_NODE_DIV || op == HG_NODE_SQRT || op == HG_NODE_RSQRT ||
                (op >= HG_NODE_EXP && op <= HG_NODE_ATAN2);
    }
    hg_text_add(text, "    %-28s %6d   %d arithmetic, %d of them divisions, roots or functions; %d registers at once\n",
                when, code->n, arithmetic, dear, alive_at_once(code));
}

void hg_report_program(const hg_strand_program *program, int n_terms, const hg_strand_term *terms, hg_text *text)
{
    teller t = { .program = program, .terms = terms, .n_terms = n_terms, .text = text };
    tell_function(&t, program->uniform, program->n_uniform, "u", "once per call (from parameters)");
    tell_function(&t, program->site, program->n_site, "g",
                  "once per groom and site (from rest data; [0] is the site's last vertex)");
    tell_function(&t, program->groom_strand, program->n_groom_strand, "s",
                  "once per groom and strand (from rest data of the root)");
    if (program->n_strand) {
        t.code = &program->preamble;
        t.numbers = &program->numbers;
        t.inputs = NULL;
        hg_text_add(text, "once per strand and frame (from the root): %d value%s kept\n", program->n_strand,
                    program->n_strand > 1 ? "s" : "");
        tell_outputs(&t, "f");
    }
    hg_text_add(text, "instructions, for as many strands at once as the processor has lanes\n");
    if (program->preamble.n) tell_list(&program->preamble, "before the sites", text);
    for (int b = 0; program->n_carry && b < program->bodies; b++)
        if (program->forward[b].n)
            tell_list(&program->forward[b],
                      b + 1 < program->bodies ? "root to tip, at one vertex" : "root to tip, at the others", text);
    for (int b = 0; b < program->bodies; b++) {
        char when[40];
        if (b + 1 < program->bodies)
            snprintf(when, sizeof when, "at vertex %d", b);
        else
            snprintf(when, sizeof when, program->bodies > 1 ? "at every vertex from %d on" : "at every vertex", b);
        tell_list(&program->body[b], when, text);
    }
    if (program->postamble.n) tell_list(&program->postamble, "after the sites", text);
    if (program->n_carry)
        hg_text_add(text, "    values carried from site to site, their derivatives back from tip to root: %d\n",
                    program->n_carry);
    if (program->n_adjoint)
        hg_text_add(text, "    derivatives summed over the sites and chained once: %d\n", program->n_adjoint);
}
