/* The block interpreter: runs instruction lists over lanes, in f32 and f64. Always there, needs no compiler, and is what
 * the printed kernels are checked against. Here too: functions, which are one list over lanes of gathered inputs. */
#include "autograd/trace/strand.h"

#include <math.h>
#include <string.h>

enum { FUNCTION_SLOTS = 256 };

struct hg_function {
    int n_inputs, n_outputs;
    hg_input *inputs;
    hg_code list;
    hg_numbers numbers;
    hg_steps steps_f32, steps_f64;
    float *numbers_f32;
    double *numbers_f64;
};

/* A build with sanitizers looks for wrong addresses in the steps, not for undefined behaviour of real numbers: it takes less than half
 * as long. */
#ifdef __SANITIZE_ADDRESS__
#define STEPS_ATTRIBUTE __attribute__((no_sanitize("undefined")))
#else
#define STEPS_ATTRIBUTE
#endif

#define REAL       float
#define LANES      HG_LANES_F32
#define NAME(name) name##_f32
#define MATH(name) name##f
#include "autograd/trace/interpreter_body.h"
#undef REAL
#undef LANES
#undef NAME
#undef MATH

#define REAL       double
#define LANES      HG_LANES_F64
#define NAME(name) name##_f64
#define MATH(name) name
#include "autograd/trace/interpreter_body.h"

/* ---- strands ------------------------------------------------------------------------------------------------ */

int hg_strand_lanes(hg_dtype dtype) { return dtype == HG_F64 ? HG_LANES_F64 : HG_LANES_F32; }

size_t hg_strand_scratch(const hg_strand_program *program, int lanes, int64_t vertices)
{
    int slots = 0;
    for (int i = 0; i < HG_STRAND_BODIES + 2; i++)
        if (program->steps[i].slots > slots) slots = program->steps[i].slots;
    for (int i = 0; i < HG_STRAND_BODIES; i++)
        if (program->forward_steps[i].slots > slots) slots = program->forward_steps[i].slots;
    const int64_t rows = program->tiles.rows * vertices + program->tiles.extra + 2 * program->input_width +
                         program->n_terms + program->n_adjoint + program->n_strand + slots + 1;
    return (size_t)(rows * lanes) * hg_dtype_size(program->dtype);
}

void hg_strand_interpret(const hg_strand_program *program, const hg_strand_args *args, int64_t first, int64_t last,
                         void *scratch)
{
    if (program->dtype == HG_F64)
        interpret_f64(program, args, first, last, scratch);
    else
        interpret_f32(program, args, first, last, scratch);
}

/* ---- functions ---------------------------------------------------------------------------------------------- */

typedef struct {
    const hg_graph *graph;
    hg_function *function;
} function_leaves;

static bool function_leaf(void *self, int node, hg_operand *operand)
{
    const function_leaves *leaves = self;
    const hg_node *n = &leaves->graph->nodes[node];
    if (n->op != HG_NODE_INPUT) return false;
    for (int i = 0; i < leaves->function->n_inputs; i++) {
        const hg_input in = leaves->function->inputs[i];
        if (in.kind != n->input.kind || in.offset != n->input.offset || in.component != n->input.component ||
            in.name != n->input.name || in.term != n->input.term)
            continue;
        *operand = (hg_operand){ HG_PLACE_IN, 0, (int16_t)i };
        return true;
    }
    return false;
}

static hg_status finish(hg_function *f, hg_graph *graph, const int *nodes)
{
    hg_output *outputs = hg_alloc((size_t)f->n_outputs + 1, sizeof *outputs);
    if (!outputs) return HG_MEMORY;
    for (int i = 0; i < f->n_outputs; i++) outputs[i] = (hg_output){ nodes[i], { HG_PLACE_OUT, 0, (int16_t)i }, false };
    function_leaves leaves = { graph, f };
    hg_status status = hg_lower(&f->list, graph, function_leaf, &leaves, &f->numbers, f->n_outputs, outputs);
    hg_free(outputs);
    HG_TRY(status);
    const int stride[HG_PLACES] = { 0 };
    HG_TRY(hg_steps_create(&f->steps_f32, &f->list, HG_LANES_F32, stride));
    HG_TRY(hg_steps_create(&f->steps_f64, &f->list, HG_LANES_F64, stride));
    if (f->n_inputs + f->n_outputs + f->steps_f32.slots > FUNCTION_SLOTS)
        return hg_fail(HG_UNSUPPORTED, "a formula needs %d values at a time; a function has room for %d",
                       f->n_inputs + f->n_outputs + f->steps_f32.slots, FUNCTION_SLOTS);
    f->numbers_f32 = hg_alloc((size_t)f->numbers.n + 1, sizeof(float));
    f->numbers_f64 = hg_alloc((size_t)f->numbers.n + 1, sizeof(double));
    if (!f->numbers_f32 || !f->numbers_f64) return HG_MEMORY;
    for (int i = 0; i < f->numbers.n; i++) {
        f->numbers_f64[i] = f->numbers.values[i];
        f->numbers_f32[i] = (float)f->numbers.values[i];
    }
    return HG_OK;
}

hg_status hg_function_from_graph(hg_function **function, hg_graph *graph, int n_outputs, const int *nodes)
{
    *function = NULL;
    hg_function *f = hg_alloc(1, sizeof *f);
    bool *reached = hg_alloc((size_t)graph->n + 1, sizeof *reached);
    hg_status status = f && reached ? HG_OK : HG_MEMORY;
    int n = 0;
    if (status == HG_OK) {
        for (int i = 0; i < n_outputs; i++) reached[nodes[i]] = true;
        for (int i = graph->n - 1; i >= 0; i--) {
            const hg_node *node = &graph->nodes[i];
            if (!reached[i]) continue;
            n += node->op == HG_NODE_INPUT;
            if (node->a >= 0) reached[node->a] = true;
            if (node->b >= 0) reached[node->b] = true;
            if (node->c >= 0) reached[node->c] = true;
        }
        f->inputs = hg_alloc((size_t)n + 1, sizeof *f->inputs);
        f->n_outputs = n_outputs;
        if (!f->inputs) status = HG_MEMORY;
    }
    for (int i = 0; status == HG_OK && i < graph->n; i++)
        if (reached[i] && graph->nodes[i].op == HG_NODE_INPUT) f->inputs[f->n_inputs++] = graph->nodes[i].input;
    hg_free(reached);
    if (status == HG_OK) status = finish(f, graph, nodes);
    if (status != HG_OK) {
        hg_function_destroy(f);
        return status;
    }
    *function = f;
    return HG_OK;
}

hg_status hg_function_create_named(hg_function **function, hg_scalar (*formula)(void), const hg_trace_scope *scope,
                                   int n_wrt, const int *wrt, int n_in, const hg_input *inputs, int n_attributes,
                                   const char *const *attributes)
{
    *function = NULL;
    hg_graph graph;
    uint32_t active = 0;
    for (int i = 0; i < n_wrt; i++) active |= HG_ALLOW(inputs[wrt[i]].kind);
    hg_graph_init(&graph, active, true);
    int value, *adjoint = NULL, *outputs = hg_alloc((size_t)n_wrt + 1, sizeof *outputs);
    hg_function *f = hg_alloc(1, sizeof *f);
    hg_status status = outputs && f ? HG_OK : HG_MEMORY;
    /* the caller's attributes come first, so that their numbers are the caller's */
    for (int i = 0; status == HG_OK && i < n_attributes; i++)
        if (i == HG_GRAPH_ATTRIBUTES || !(graph.attributes[graph.n_attributes++] = hg_strdup(attributes[i])))
            status = hg_fail(HG_MEMORY, "out of memory for %d attributes", n_attributes);
    if (status == HG_OK) status = hg_graph_trace(&graph, formula, scope, &value, NULL);
    if (status == HG_OK && graph.n_attributes > n_attributes)
        status = hg_fail(HG_INVALID, "energy '%s' asks for the groom attribute '%s', which is not at hand here",
                         scope->name, graph.attributes[n_attributes]);
    if (status == HG_OK && !(adjoint = hg_alloc((size_t)graph.n, sizeof *adjoint))) status = HG_MEMORY;
    if (status == HG_OK) {
        const int traced = graph.n, seed = hg_graph_number(&graph, 1);
        for (int i = 0; i < traced; i++) adjoint[i] = -1;
        outputs[0] = value;
        status = hg_graph_reverse(&graph, 1, &value, &seed, false, adjoint);
        for (int i = 0; status == HG_OK && i < n_wrt; i++) {
            hg_input wanted = inputs[wrt[i]];
            if (wanted.kind == HG_INPUT_PARAM) wanted.term = (int16_t)scope->term;
            const int before = graph.n, input = hg_graph_input(&graph, wanted);
            outputs[1 + i] =
                input >= before || input >= traced || adjoint[input] < 0 ? hg_graph_number(&graph, 0) : adjoint[input];
        }
    }
    if (status == HG_OK && !(f->inputs = hg_alloc((size_t)n_in + 1, sizeof *f->inputs))) status = HG_MEMORY;
    if (status == HG_OK) {
        f->n_inputs = n_in;
        f->n_outputs = 1 + n_wrt;
        for (int i = 0; i < n_in; i++) {
            f->inputs[i] = inputs[i];
            if (inputs[i].kind == HG_INPUT_PARAM) f->inputs[i].term = (int16_t)scope->term;
        }
        status = finish(f, &graph, outputs);
    }
    hg_free(adjoint);
    hg_free(outputs);
    hg_graph_free(&graph);
    if (status != HG_OK) {
        hg_function_destroy(f);
        return status;
    }
    *function = f;
    return HG_OK;
}

hg_status hg_function_create(hg_function **function, hg_scalar (*formula)(void), const hg_trace_scope *scope, int n_wrt,
                             const int *wrt, int n_in, const hg_input *inputs)
{
    return hg_function_create_named(function, formula, scope, n_wrt, wrt, n_in, inputs, 0, NULL);
}

void hg_function_destroy(hg_function *function)
{
    if (!function) return;
    hg_free(function->inputs);
    hg_code_free(&function->list);
    hg_free(function->numbers.values);
    hg_steps_free(&function->steps_f32);
    hg_steps_free(&function->steps_f64);
    hg_free(function->numbers_f32);
    hg_free(function->numbers_f64);
    hg_free(function);
}

void hg_function_run(const hg_function *function, hg_dtype dtype, int64_t n, const void *const *in,
                     const double *uniform, void *const *out)
{
    if (dtype == HG_F64)
        function_run_f64(function, n, in, uniform, out);
    else
        function_run_f32(function, n, in, uniform, out);
}

const hg_input *hg_function_inputs(const hg_function *function, int *n)
{
    *n = function->n_inputs;
    return function->inputs;
}

const hg_code *hg_function_code(const hg_function *function, const hg_numbers **numbers)
{
    *numbers = &function->numbers;
    return &function->list;
}

uint64_t hg_code_hash(const hg_code *list, uint64_t seed)
{
    for (int i = 0; i < list->n; i++) {
        const hg_instruction *in = &list->instructions[i];
        const hg_operand operands[4] = { in->to, in->a, in->b, in->c };
        int32_t key[13] = { in->op };
        for (int k = 0; k < 4; k++) {
            key[1 + 3 * k] = operands[k].place;
            key[2 + 3 * k] = operands[k].offset;
            key[3 + 3 * k] = operands[k].index;
        }
        seed = hg_hash(key, sizeof key, seed);
    }
    return hg_hash(&list->n, sizeof list->n, seed);
}

uint64_t hg_function_hash(const hg_function *function, uint64_t seed)
{
    if (!function) return hg_hash("none", 4, seed);
    for (int i = 0; i < function->n_inputs; i++) {
        const hg_input in = function->inputs[i];
        const int32_t key[5] = { (int32_t)in.kind, in.offset, in.component, in.name, in.term };
        seed = hg_hash(key, sizeof key, seed);
    }
    seed = hg_hash(function->numbers.values, (size_t)function->numbers.n * sizeof(double), seed);
    return hg_code_hash(&function->list, seed);
}

hg_status hg_formula_reads(hg_scalar (*formula)(void), const hg_trace_scope *scope, hg_formula_names *names)
{
    hg_graph graph;
    hg_graph_init(&graph, 0, true);
    int node;
    *names = (hg_formula_names){ 0 };
    hg_status status = hg_graph_trace(&graph, formula, scope, &node, &names->kinds);
    if (status == HG_OK && graph.n_attributes > HG_FORMULA_NAMES)
        status = hg_fail(HG_INVALID, "energy '%s' asks for %d groom attributes; %d are possible", scope->name,
                         graph.n_attributes, HG_FORMULA_NAMES);
    if (status == HG_OK && graph.n_frames > HG_FORMULA_NAMES)
        status = hg_fail(HG_INVALID, "energy '%s' reads %d named arrays; %d are possible", scope->name, graph.n_frames,
                         HG_FORMULA_NAMES);
    for (int i = 0; status == HG_OK && i < graph.n_attributes; i++) {
        names->attributes[names->n_attributes++] = graph.attributes[i];
        graph.attributes[i] = NULL;
    }
    for (int i = 0; status == HG_OK && i < graph.n_frames; i++) {
        names->frame_width[names->n_frames] = graph.frame_width[i];
        names->frames[names->n_frames++] = graph.frames[i];
        graph.frames[i] = NULL;
    }
    hg_graph_free(&graph);
    return status;
}

void hg_formula_names_free(hg_formula_names *names)
{
    for (int i = 0; i < names->n_attributes; i++) hg_free(names->attributes[i]);
    for (int i = 0; i < names->n_frames; i++) hg_free(names->frames[i]);
    *names = (hg_formula_names){ 0 };
}

hg_status hg_formula_inputs(hg_scalar (*formula)(void), const hg_trace_scope *scope, uint32_t *kinds, int *n_attributes,
                            char *attributes[8])
{
    hg_formula_names names;
    hg_status status = hg_formula_reads(formula, scope, &names);
    *kinds = names.kinds;
    *n_attributes = names.n_attributes;
    for (int i = 0; i < names.n_attributes; i++) attributes[i] = names.attributes[i];
    names.n_attributes = 0;
    hg_formula_names_free(&names);
    return status;
}
