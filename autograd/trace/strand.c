/* The strand program: the plan's graph is cut by how often things change, and lowered to the lists that the interpreter
 * runs and the printers print. */
#include "autograd/trace/strand_plan.h"

#include <string.h>

/* The same groom value with the window moved so that its last vertex is the site's: stored once, read at an offset. */
static int canonical(hg_strand_plan *p, int node)
{
    return hg_graph_shift(&p->graph, node, -p->graph.nodes[node].last);
}

/* ---- places ------------------------------------------------------------------------------------------------- */

static void claim(hg_strand_plan *p, int *table, int *n, int node)
{
    if (p->index[node] >= 0) return;
    p->index[node] = *n;
    table[(*n)++] = node;
}

/* What a node needs from slower parts. */
static void demand(hg_strand_plan *p, bool *seen, int node)
{
    hg_strand_program *program = p->program;
    if (node < 0 || seen[node]) return;
    seen[node] = true;
    const hg_node n = p->graph.nodes[node];
    switch (hg_plan_rate(p, node)) {
    case HG_RATE_CONSTANT:
        return;
    case HG_RATE_UNIFORM:
        claim(p, p->uniform, &program->n_uniform, node);
        return;
    case HG_RATE_GROOM:
        claim(p, p->stored, &program->n_site, canonical(p, node));
        return;
    case HG_RATE_GROOM_STRAND:
        claim(p, p->groom_strand, &program->n_groom_strand, node);
        return;
    case HG_RATE_STRAND:
        if (p->part < HG_PLAN_PREAMBLE || (p->part == HG_PLAN_POSTAMBLE && !(n.depends & HG_DEPENDS_ADJOINT))) {
            claim(p, p->strand, &program->n_strand, node);
            return;
        }
        break;
    case HG_RATE_SITE:
        break;
    }
    demand(p, seen, n.a);
    demand(p, seen, n.b);
    demand(p, seen, n.c);
}

/* Cheap steps from stored values and literals to a groom value, `enough` where there is no such way. */
enum { CHEAP = 4, ENOUGH };
static int steps_from_stored(hg_strand_plan *p, int node, int without)
{
    const hg_node n = p->graph.nodes[node];
    if (n.op == HG_NODE_NUMBER) return 0;
    if (hg_plan_rate(p, node) != HG_RATE_GROOM || n.op == HG_NODE_INPUT || n.op == HG_NODE_DIV ||
        n.op == HG_NODE_SQRT || n.op == HG_NODE_RSQRT || (n.op >= HG_NODE_EXP && n.op <= HG_NODE_ATAN2))
        return ENOUGH;
    const int arguments[3] = { n.a, n.b, n.c };
    int steps = 1;
    for (int k = 0; k < hg_node_arguments((hg_node_op)n.op) && steps < ENOUGH; k++) {
        const int argument = arguments[k];
        if (k > 0 && argument == arguments[k - 1]) continue;
        const int stored = hg_plan_rate(p, argument) == HG_RATE_GROOM ? canonical(p, argument) : argument;
        if (stored != without && p->index[stored] >= 0 && hg_plan_rate(p, argument) == HG_RATE_GROOM) continue;
        steps += steps_from_stored(p, argument, without);
    }
    return steps;
}

/* Groom values that are a few cheap steps away from others that are stored anyway are not worth the memory they would
 * be read from: a large groom is bound by memory, not by arithmetic. */
static void drop_cheap(hg_strand_plan *p)
{
    hg_strand_program *program = p->program;
    for (int i = program->n_site - 1; i >= 0; i--) {
        if (steps_from_stored(p, p->stored[i], p->stored[i]) > CHEAP) continue;
        p->index[p->stored[i]] = -1;
        for (int j = i + 1; j < program->n_site; j++) {
            p->stored[j - 1] = p->stored[j];
            p->index[p->stored[j]]--;
        }
        program->n_site--;
    }
}

static bool leaf(void *self, int node, hg_operand *operand)
{
    hg_strand_plan *p = self;
    const hg_node *n = &p->graph.nodes[node];
    switch (hg_plan_rate(p, node)) {
    case HG_RATE_UNIFORM:
        *operand = (hg_operand){ HG_PLACE_UNIFORM, 0, (int16_t)p->index[node] };
        return true;
    case HG_RATE_GROOM: {
        const int8_t offset = n->last;
        const int stored = canonical(p, node);
        if (p->index[stored] < 0) return false;
        *operand = (hg_operand){ HG_PLACE_SITE, offset, (int16_t)p->index[stored] };
        return true;
    }
    case HG_RATE_GROOM_STRAND:
        *operand = (hg_operand){ HG_PLACE_GROOM_STRAND, 0, (int16_t)p->index[node] };
        return true;
    case HG_RATE_STRAND:
        if (p->part != HG_PLAN_PREAMBLE && !(n->depends & HG_DEPENDS_ADJOINT)) {
            *operand = (hg_operand){ HG_PLACE_STRAND, 0, (int16_t)p->index[node] };
            return true;
        }
        break;
    default:
        break;
    }
    if (n->op != HG_NODE_INPUT) return false;
    const hg_input in = n->input;
    int k;
    switch (in.kind) {
    case HG_INPUT_ROOT_X:
        *operand = (hg_operand){ (uint8_t)(HG_PLACE_ROOT_X0 + in.offset), 0, in.component };
        return true;
    case HG_INPUT_ROOT_REST:
        *operand = (hg_operand){ (uint8_t)(HG_PLACE_ROOT_REST0 + in.offset), 0, in.component };
        return true;
    case HG_INPUT_ADJOINT:
        *operand = (hg_operand){ HG_PLACE_ADJOINT, 0, in.name };
        return true;
    case HG_INPUT_CARRY:
        *operand = (hg_operand){ HG_PLACE_CARRY, 0, (int16_t)(p->carry_at[in.name] + in.component) };
        return true;
    case HG_INPUT_CARRY_ADJOINT:
        *operand = (hg_operand){ HG_PLACE_CARRY_ADJOINT, 1, (int16_t)(p->carry_at[in.name] + in.component) };
        return true;
    default:
        break;
    }
    if ((k = hg_plan_find(p->program->arrays, p->program->n_arrays, in)) >= 0) {
        *operand = (hg_operand){ (uint8_t)(HG_PLACE_ARRAY + k), (int8_t)in.offset, in.component };
        return true;
    }
    if ((k = hg_plan_find(p->program->inputs, p->program->n_inputs, in)) >= 0) {
        *operand = (hg_operand){ HG_PLACE_STRAND_INPUT, 0, (int16_t)(p->program->inputs[k].first + in.component) };
        return true;
    }
    return false;
}

/* ---- the program -------------------------------------------------------------------------------------------- */

/* Rest data that goes from site to site: functions of a vertex, run in order when the groom's values are made. */
static hg_status lower_rest_carries(hg_strand_plan *p)
{
    hg_strand_program *program = p->program;
    int first[4 * HG_GRAPH_CARRIES], kept[4 * HG_GRAPH_CARRIES];
    for (int i = 0; i < p->graph.n_carries; i++) {
        const hg_graph_carry *carry = &p->graph.carries[i];
        if (!carry->rest) continue;
        program->rest_carries[i].start = p->terms[carry->term].scope.window - 1;
        program->rest_carries[i].at = program->n_rest_carry;
        program->rest_carries[i].width = carry->width;
        for (int c = 0; c < carry->width; c++, program->n_rest_carry++) {
            first[program->n_rest_carry] = carry->first[c];
            kept[program->n_rest_carry] = carry->kept[c];
        }
    }
    program->n_rest_carries = p->graph.n_carries;
    if (!program->n_rest_carry) return HG_OK;
    HG_TRY(hg_function_from_graph(&program->rest_first, &p->graph, program->n_rest_carry, first));
    return hg_function_from_graph(&program->rest_kept, &p->graph, program->n_rest_carry, kept);
}

static hg_status lower(hg_strand_plan *p)
{
    hg_strand_program *program = p->program;
    hg_graph *graph = &p->graph;
    /* shifting groom values to their canonical site makes a few more nodes: do it before tables are sized by them */
    for (int i = 0, n = graph->n; i < n; i++)
        if (hg_plan_rate(p, i) == HG_RATE_GROOM) canonical(p, i);
    const size_t n = (size_t)graph->n + 1;
    const size_t most = n + 2 * (size_t)program->n_terms + 4 * HG_STRAND_BODIES * HG_STRAND_ARRAYS +
                        4 * HG_STRAND_INPUTS + 8 * HG_GRAPH_CARRIES + 64;
    hg_output *outputs = hg_alloc(most, sizeof *outputs);
    bool *seen = hg_alloc(n, sizeof *seen);
    p->index = hg_alloc(n, sizeof *p->index);
    p->stored = hg_alloc(n, sizeof *p->stored);
    p->groom_strand = hg_alloc(n, sizeof *p->groom_strand);
    p->strand = hg_alloc(n, sizeof *p->strand);
    p->uniform = hg_alloc(n, sizeof *p->uniform);
    hg_status status =
        outputs && seen && p->index && p->stored && p->groom_strand && p->strand && p->uniform ? HG_OK : HG_MEMORY;
    if (status != HG_OK) goto out;
    for (size_t i = 0; i < n; i++) p->index[i] = -1;
    for (p->part = 0; p->part < program->bodies; p->part++) {
        int count = hg_plan_body(p, p->part, outputs);
        for (int i = 0; i < count; i++) demand(p, seen, outputs[i].node);
        count = hg_plan_forward(p, p->part, outputs);
        for (int i = 0; i < count; i++) demand(p, seen, outputs[i].node);
    }
    const int after = hg_plan_postamble(p, outputs);
    p->part = HG_PLAN_POSTAMBLE;
    for (int i = 0; i < after; i++) demand(p, seen, outputs[i].node);
    p->part = HG_PLAN_PREAMBLE;
    memset(seen, 0, n);
    for (int i = 0; i < program->n_strand; i++) demand(p, seen, p->strand[i]);
    drop_cheap(p);

    for (p->part = 0; status == HG_OK && p->part < program->bodies; p->part++) {
        int count = hg_plan_body(p, p->part, outputs);
        status = hg_lower(&program->body[p->part], graph, leaf, p, &program->numbers, count, outputs);
        count = hg_plan_forward(p, p->part, outputs);
        if (status == HG_OK)
            status = hg_lower(&program->forward[p->part], graph, leaf, p, &program->numbers, count, outputs);
    }
    if (status == HG_OK) status = lower_rest_carries(p);
    if (status == HG_OK) {
        for (int i = 0; i < program->n_strand; i++)
            outputs[i] = (hg_output){ p->strand[i], { HG_PLACE_STRAND, 0, (int16_t)i }, false };
        p->part = HG_PLAN_PREAMBLE;
        status = hg_lower(&program->preamble, graph, leaf, p, &program->numbers, program->n_strand, outputs);
    }
    if (status == HG_OK) {
        p->part = HG_PLAN_POSTAMBLE;
        status =
            hg_lower(&program->postamble, graph, leaf, p, &program->numbers, hg_plan_postamble(p, outputs), outputs);
    }
    if (status == HG_OK && program->n_uniform)
        status = hg_function_from_graph(&program->uniform, graph, program->n_uniform, p->uniform);
    if (status == HG_OK && program->n_site)
        status = hg_function_from_graph(&program->site, graph, program->n_site, p->stored);
    if (status == HG_OK && program->n_groom_strand)
        status = hg_function_from_graph(&program->groom_strand, graph, program->n_groom_strand, p->groom_strand);
out:
    hg_free(outputs);
    hg_free(seen);
    return status;
}

static uint64_t sources_hash(const hg_strand_input *sources, int n, uint64_t hash)
{
    for (int k = 0; k < n; k++) {
        const int32_t key[] = { sources[k].width, sources[k].missing, sources[k].rest, sources[k].gradient };
        hash = hg_hash(key, sizeof key, hash);
    }
    return hash;
}

static uint64_t program_hash(const hg_strand_program *p)
{
    const int32_t sizes[] = { 2 /* version of the printed kernel */,
                              p->n_terms,
                              p->bodies,
                              p->n_uniform,
                              p->n_site,
                              p->n_groom_strand,
                              p->n_strand,
                              p->n_adjoint,
                              p->n_arrays,
                              p->n_inputs,
                              p->n_carry };
    uint64_t hash = hg_hash(sizes, sizeof sizes, p->dtype == HG_F64 ? 64 : 32);
    hash = sources_hash(p->arrays, p->n_arrays, hash);
    hash = sources_hash(p->inputs, p->n_inputs, hash);
    hash = hg_hash(p->numbers.values, (size_t)p->numbers.n * sizeof(double), hash);
    for (int i = 0; i < p->bodies; i++) {
        hash = hg_code_hash(&p->body[i], hash);
        hash = hg_code_hash(&p->forward[i], hash);
    }
    hash = hg_code_hash(&p->preamble, hash);
    return hg_code_hash(&p->postamble, hash);
}

static hg_status steps(hg_strand_program *p)
{
    int stride[HG_PLACES] = { 0 };
    for (int k = 0; k < p->n_arrays; k++)
        stride[HG_PLACE_ARRAY + k] = stride[HG_PLACE_ARRAY_GRADIENT + k] = p->arrays[k].width;
    stride[HG_PLACE_SITE] = p->n_site;
    stride[HG_PLACE_CARRY] = stride[HG_PLACE_CARRY_ADJOINT] = p->n_carry;
    const int lanes = hg_strand_lanes(p->dtype);
    for (int i = 0; i < p->bodies; i++) {
        HG_TRY(hg_steps_create(&p->steps[i], &p->body[i], lanes, stride));
        HG_TRY(hg_steps_create(&p->forward_steps[i], &p->forward[i], lanes, stride));
    }
    HG_TRY(hg_steps_create(&p->steps[HG_PLAN_PREAMBLE], &p->preamble, lanes, stride));
    HG_TRY(hg_steps_create(&p->steps[HG_PLAN_POSTAMBLE], &p->postamble, lanes, stride));
    p->number_table = hg_alloc((size_t)p->numbers.n + 1, hg_dtype_size(p->dtype));
    if (!p->number_table) return HG_MEMORY;
    for (int i = 0; i < p->numbers.n; i++) {
        if (p->dtype == HG_F64)
            ((double *)p->number_table)[i] = p->numbers.values[i];
        else
            ((float *)p->number_table)[i] = (float)p->numbers.values[i];
    }
    return HG_OK;
}

static hg_status make(hg_strand_plan *p)
{
    hg_strand_program *program = p->program;
    program->used = hg_alloc((size_t)program->n_terms + 1, sizeof *program->used);
    program->attribute_term = hg_alloc(HG_GRAPH_ATTRIBUTES, sizeof *program->attribute_term);
    program->frame_term = hg_alloc(HG_GRAPH_ATTRIBUTES, sizeof *program->frame_term);
    if (!program->used || !program->attribute_term || !program->frame_term) return HG_MEMORY;
    HG_TRY(hg_strand_plan_make(p));
    HG_TRY(lower(p));
    program->hash = program_hash(program);
    return steps(program);
}

hg_status hg_strand_program_create(hg_strand_program **out, hg_dtype dtype, int n_terms, const hg_strand_term *terms,
                                   int n_given, const hg_given *given, bool hoist)
{
    *out = NULL;
    hg_strand_plan plan = { .program = hg_alloc(1, sizeof *plan.program), .terms = terms };
    hg_strand_program *program = plan.program;
    hg_graph *graph = &plan.graph;
    if (!program) return HG_MEMORY;
    program->n_terms = n_terms;
    program->dtype = dtype;
    hg_graph_init(graph, HG_ALLOW(HG_INPUT_X) | HG_ALLOW(HG_INPUT_ROOT_X) | HG_ALLOW(HG_INPUT_CARRY), hoist);
    graph->given = given;
    graph->n_given = n_given;
    hg_status status = make(&plan);
    program->n_attributes = graph->n_attributes; /* the names are the program's from here on */
    program->n_frames = graph->n_frames;
    memcpy(program->attributes, graph->attributes, sizeof graph->attributes);
    memcpy(program->frames, graph->frames, sizeof graph->frames);
    graph->n_attributes = graph->n_frames = 0;
    hg_strand_plan_free(&plan);
    if (status != HG_OK) {
        hg_strand_program_destroy(program);
        return status;
    }
    *out = program;
    return HG_OK;
}

void hg_strand_program_destroy(hg_strand_program *program)
{
    if (!program) return;
    hg_function_destroy(program->uniform);
    hg_function_destroy(program->site);
    hg_function_destroy(program->groom_strand);
    hg_function_destroy(program->rest_first);
    hg_function_destroy(program->rest_kept);
    hg_code_free(&program->preamble);
    hg_code_free(&program->postamble);
    for (int i = 0; i < HG_STRAND_BODIES; i++) {
        hg_code_free(&program->body[i]);
        hg_code_free(&program->forward[i]);
        hg_steps_free(&program->forward_steps[i]);
    }
    for (int i = 0; i < HG_STRAND_BODIES + 2; i++) hg_steps_free(&program->steps[i]);
    hg_free(program->numbers.values);
    hg_free(program->used);
    hg_free(program->attribute_term);
    hg_free(program->frame_term);
    for (int i = 0; i < program->n_attributes; i++) hg_free(program->attributes[i]);
    for (int i = 0; i < program->n_frames; i++) hg_free(program->frames[i]);
    hg_free(program->number_table);
    hg_free(program);
}
