/* The strand program: the window energies of a physics become one graph, differentiated once per body, cut by how often
 * things change, and lowered to the lists that the interpreter runs and the printers print. */
#include "autograd/trace/strand.h"

#include <string.h>

typedef struct {
    hg_strand_program *program;
    const hg_strand_term *terms;
    hg_graph graph;
    int *energy, *first_energy, *root; /* nodes of the terms; first_energy: at the first site; -1: no root term */
    bool *carries;                     /* does the term carry more than rest data */
    int carry_at[HG_GRAPH_CARRIES];    /* first component of each carried value; -1: rest data */
    int *adjoint[HG_STRAND_BODIES];    /* of the nodes that were traced, per body */
    int traced;
    int *stored, *groom_strand, *strand, *uniform; /* nodes that get a place */
    int *frontier;                                 /* strand nodes whose adjoints are summed */
    int *chained;                                  /* adjoints of the nodes before the sites, made by the postamble */
    int *index;                                    /* place of a node in its table; -1: none */
    int part;                                      /* list being lowered: a body, or one of these */
} planner;
enum { PREAMBLE = HG_STRAND_BODIES, POSTAMBLE };

static hg_rate rate(const planner *p, int node) { return (hg_rate)p->graph.nodes[node].rate; }

/* The same groom value with the window moved so that its last vertex is the site's: stored once, read at an offset. */
static int canonical(planner *p, int node) { return hg_graph_shift(&p->graph, node, -p->graph.nodes[node].last); }

/* ---- tracing and differentiating ---------------------------------------------------------------------------- */

/* Both the sites that follow another and, where values are carried, the first one: there `first` takes their place. */
static hg_status trace_term(planner *p, int t)
{
    hg_graph *graph = &p->graph;
    hg_strand_program *program = p->program;
    hg_trace_scope scope = p->terms[t].scope;
    int kept[HG_GRAPH_CARRIES][4];
    scope.term = t;
    HG_TRY(hg_graph_trace(graph, p->terms[t].trace, &scope, &p->energy[t], &program->used[t]));
    p->first_energy[t] = p->energy[t];
    for (int i = 0; i < graph->n_carries; i++) {
        const hg_graph_carry *carry = &graph->carries[i];
        memcpy(kept[i], carry->kept, sizeof kept[i]);
        p->carries[t] |= carry->term == t && !carry->rest;
    }
    if (p->carries[t]) {
        scope.first_site = true;
        HG_TRY(hg_graph_trace(graph, p->terms[t].trace, &scope, &p->first_energy[t], NULL));
        for (int i = 0; i < graph->n_carries; i++) {
            hg_graph_carry *carry = &graph->carries[i];
            if (carry->term == t) memcpy(carry->first_site_kept, carry->kept, sizeof kept[i]);
            memcpy(carry->kept, kept[i], sizeof kept[i]);
        }
    }
    if (!p->terms[t].root) return HG_OK;
    scope.first_site = false;
    scope.window = 2;
    scope.allowed &= ~HG_ALLOW(HG_INPUT_CARRY);
    return hg_graph_trace(graph, p->terms[t].root, &scope, &p->root[t], &program->used[t]);
}

static hg_status trace(planner *p)
{
    hg_strand_program *program = p->program;
    hg_graph *graph = &p->graph;
    int window = 1;
    bool any_root = false;
    for (int t = 0; t < program->n_terms; t++) {
        const int attributes = graph->n_attributes, frames = graph->n_frames;
        p->root[t] = -1;
        HG_TRY(trace_term(p, t));
        const int wide = p->terms[t].scope.window + p->carries[t]; /* the first site has a body of its own */
        if (wide > window) window = wide;
        any_root |= p->terms[t].root != NULL;
        for (int i = attributes; i < graph->n_attributes; i++) program->attribute_term[i] = t;
        for (int i = frames; i < graph->n_frames; i++) program->frame_term[i] = t;
    }
    for (int i = 0; i < graph->n_carries; i++) {
        const hg_graph_carry *carry = &graph->carries[i];
        p->carry_at[i] = carry->rest ? -1 : program->n_carry;
        if (!carry->rest) program->n_carry += carry->width;
    }
    program->bodies = any_root && window < 3 ? 3 : window;
    if (program->bodies > HG_STRAND_BODIES)
        return hg_fail(HG_UNSUPPORTED, "a window of %d vertices: at most %d are possible", program->bodies,
                       HG_STRAND_BODIES);
    p->traced = graph->n;
    return HG_OK;
}

static bool in_body(const planner *p, int body, int term)
{
    return p->terms[term].scope.window <= body + 1 || body == p->program->bodies - 1;
}

static bool first_site(const planner *p, int body, int term)
{
    return p->carries[term] && body == p->terms[term].scope.window - 1;
}

static int energy_of(const planner *p, int body, int term)
{
    return first_site(p, body, term) ? p->first_energy[term] : p->energy[term];
}

/* ---- what is read ------------------------------------------------------------------------------------------- */

static void mark(const hg_graph *graph, bool *live, int node)
{
    if (node < 0 || live[node]) return;
    live[node] = true;
    mark(graph, live, graph->nodes[node].a);
    mark(graph, live, graph->nodes[node].b);
    mark(graph, live, graph->nodes[node].c);
}

static bool same_source(const hg_strand_input *source, hg_input in)
{
    if (source->kind != in.kind) return false;
    if (in.kind == HG_INPUT_PARAM) return source->name == in.name && source->term == in.term;
    return (in.kind != HG_INPUT_ATTRIBUTE && in.kind != HG_INPUT_FRAME) || source->name == in.name;
}

static int find_source(const hg_strand_input *sources, int n, hg_input in)
{
    for (int i = 0; i < n; i++)
        if (same_source(&sources[i], in)) return i;
    return -1;
}

static hg_status add_array(planner *p, hg_input in)
{
    hg_strand_program *program = p->program;
    if (find_source(program->arrays, program->n_arrays, in) >= 0) return HG_OK;
    if (program->n_arrays == HG_STRAND_ARRAYS)
        return hg_fail(HG_UNSUPPORTED, "the energies read more than %d arrays of a frame", HG_STRAND_ARRAYS);
    const hg_given *given = hg_graph_given(&p->graph, in);
    const bool scalar = in.kind == HG_INPUT_MASS || in.kind == HG_INPUT_ATTRIBUTE ||
                        (in.kind == HG_INPUT_FRAME && p->graph.frame_width[in.name] == 1);
    program->arrays[program->n_arrays++] = (hg_strand_input){
        .kind = in.kind,
        .name = in.name,
        .width = in.kind == HG_INPUT_Q ? 4
                 : scalar              ? 1
                                       : 3,
        .missing = in.kind == HG_INPUT_Q,
        .rest = in.kind == HG_INPUT_REST || in.kind == HG_INPUT_MASS || in.kind == HG_INPUT_ATTRIBUTE,
        .gradient = in.kind == HG_INPUT_X || (given && given->gradient),
    };
    return HG_OK;
}

static hg_status add_input(planner *p, hg_input in, int width)
{
    hg_strand_program *program = p->program;
    if (find_source(program->inputs, program->n_inputs, in) >= 0) return HG_OK;
    if (program->n_inputs == HG_STRAND_INPUTS)
        return hg_fail(HG_UNSUPPORTED, "more than %d values per strand are given", HG_STRAND_INPUTS);
    const hg_given *given = hg_graph_given(&p->graph, in);
    program->inputs[program->n_inputs++] = (hg_strand_input){ .kind = in.kind,
                                                              .name = in.name,
                                                              .term = in.term,
                                                              .width = width,
                                                              .first = program->input_width,
                                                              .gradient = given && given->gradient };
    program->input_width += width;
    return HG_OK;
}

static hg_strand_tile take(hg_strand_program *program, int width, int extra)
{
    const hg_strand_tile tile = program->tiles;
    program->tiles.rows += width;
    program->tiles.extra += extra;
    return tile;
}

/* The tables of what the kernel reads, and where the tiles are. */
static hg_status find_sources(planner *p)
{
    hg_strand_program *program = p->program;
    const hg_graph *graph = &p->graph;
    bool *live = hg_alloc((size_t)p->traced + 1, sizeof *live);
    if (!live) return HG_MEMORY;
    for (int t = 0; t < program->n_terms; t++) {
        mark(graph, live, p->energy[t]);
        mark(graph, live, p->first_energy[t]);
        mark(graph, live, p->root[t]);
    }
    for (int i = 0; i < graph->n_carries; i++)
        for (int c = 0; c < graph->carries[i].width && !graph->carries[i].rest; c++) {
            mark(graph, live, graph->carries[i].kept[c]);
            mark(graph, live, graph->carries[i].first_site_kept[c]);
        }
    hg_status status = add_array(p, (hg_input){ .kind = HG_INPUT_X });
    if (status == HG_OK) status = add_input(p, (hg_input){ .kind = HG_INPUT_ROOT_ROTATION }, 4);
    if (status == HG_OK) status = add_input(p, (hg_input){ .kind = HG_INPUT_ROOT_POSITION }, 3);
    for (int i = 0; i < p->traced && status == HG_OK; i++) {
        const hg_node *node = &graph->nodes[i];
        hg_input in = node->input;
        if (!live[i] || node->op != HG_NODE_INPUT) continue;
        if ((in.kind == HG_INPUT_PARAM || in.kind == HG_INPUT_DT) && rate(p, i) == HG_RATE_STRAND)
            status = add_input(p, in, 1);
        if (in.kind == HG_INPUT_ROOT_REST && rate(p, i) == HG_RATE_STRAND) {
            in.kind = HG_INPUT_REST;
            status = add_array(p, in);
        } else if (rate(p, i) == HG_RATE_SITE && in.kind != HG_INPUT_CARRY) {
            status = add_array(p, in);
        }
    }
    hg_free(live);
    for (int gradient = 1; gradient >= 0; gradient--)
        for (int k = 0; k < program->n_arrays; k++) {
            hg_strand_input *array = &program->arrays[k];
            const int missing = array->width * array->missing;
            if (gradient && array->gradient) array->gradient_tile = take(program, array->width, -missing);
            if (!gradient) array->tile = take(program, array->width, -missing);
        }
    program->carry_tile = take(program, program->n_carry, program->n_carry);
    program->carry_adjoint_tile = take(program, program->n_carry, program->n_carry);
    return status;
}

/* ---- differentiating ---------------------------------------------------------------------------------------- */

static hg_status differentiate_body(planner *p, int body, int *roots, int *seeds)
{
    hg_graph *graph = &p->graph;
    hg_strand_program *program = p->program;
    int n = 0;
    p->adjoint[body] = hg_alloc((size_t)p->traced + 1, sizeof(int));
    if (!p->adjoint[body]) return HG_MEMORY;
    for (int i = 0; i < p->traced; i++) p->adjoint[body][i] = -1;
    for (int t = 0; t < program->n_terms; t++) {
        const int weight = hg_graph_input(graph, (hg_input){ HG_INPUT_WEIGHT, 0, 0, 0, (int16_t)t });
        if (in_body(p, body, t)) {
            roots[n] = energy_of(p, body, t);
            seeds[n++] = weight;
        }
        if (body == 1 && p->root[t] >= 0) {
            roots[n] = p->root[t];
            seeds[n++] = weight;
        }
    }
    for (int i = 0; i < graph->n_carries; i++) {
        const hg_graph_carry *carry = &graph->carries[i];
        if (carry->rest || !in_body(p, body, carry->term)) continue;
        const int *kept = first_site(p, body, carry->term) ? carry->first_site_kept : carry->kept;
        for (int c = 0; c < carry->width; c++) {
            roots[n] = kept[c];
            seeds[n++] = hg_graph_input(graph, (hg_input){ HG_INPUT_CARRY_ADJOINT, 0, (int16_t)c, (int16_t)i, 0 });
        }
    }
    if (graph->status != HG_OK) return hg_fail(graph->status, "%s", graph->message);
    return hg_graph_reverse(graph, n, roots, seeds, true, p->adjoint[body]);
}

static hg_status differentiate(planner *p)
{
    hg_graph *graph = &p->graph;
    hg_strand_program *program = p->program;
    const size_t n = 2 * (size_t)program->n_terms + 4 * HG_GRAPH_CARRIES + 1;
    int *roots = hg_alloc(n, sizeof *roots), *seeds = hg_alloc(n, sizeof *seeds);
    hg_status status = roots && seeds ? HG_OK : HG_MEMORY;
    for (int body = 0; status == HG_OK && body < program->bodies; body++)
        status = differentiate_body(p, body, roots, seeds);
    hg_free(roots);
    hg_free(seeds);
    HG_TRY(status);

    /* strand values that a site's derivative reached: their adjoints are summed, then chained once */
    for (int node = 0; node < p->traced; node++) {
        bool reached = false;
        p->chained[node] = -1;
        for (int body = 0; body < program->bodies; body++)
            reached |= p->adjoint[body][node] >= 0 && rate(p, node) != HG_RATE_SITE;
        if (reached) p->frontier[program->n_adjoint++] = node;
    }
    if (program->n_adjoint == 0) return HG_OK;
    int *sums = hg_alloc((size_t)p->traced + 1, sizeof *sums);
    if (!sums) return HG_MEMORY;
    for (int j = 0; j < program->n_adjoint; j++)
        sums[j] = hg_graph_input(graph, (hg_input){ HG_INPUT_ADJOINT, 0, 0, (int16_t)j, 0 });
    status = hg_graph_reverse(graph, program->n_adjoint, p->frontier, sums, false, p->chained);
    hg_free(sums);
    return status;
}

/* The adjoint of an input among those of the nodes that were traced; -1: none. */
static int adjoint_of(const planner *p, const int *adjoint, hg_input in)
{
    for (int i = 0; i < p->traced; i++) {
        const hg_node *node = &p->graph.nodes[i];
        if (node->op == HG_NODE_INPUT && node->input.kind == in.kind && node->input.offset == in.offset &&
            node->input.component == in.component && node->input.name == in.name && node->input.term == in.term)
            return adjoint[i];
    }
    return -1;
}

/* Outputs of a body: the energies of its terms, the adjoints of strand values, the gradient of what it reads, and the
 * adjoint of what came from the site before. */
static int body_outputs(const planner *p, int body, hg_output *outputs)
{
    const hg_strand_program *program = p->program;
    int n = 0;
    for (int t = 0; t < program->n_terms; t++) {
        const hg_operand to = { HG_PLACE_ENERGY, 0, (int16_t)t };
        if (in_body(p, body, t)) outputs[n++] = (hg_output){ energy_of(p, body, t), to, true };
        if (body == 1 && p->root[t] >= 0) outputs[n++] = (hg_output){ p->root[t], to, true };
    }
    for (int j = 0; j < program->n_adjoint; j++)
        if (p->adjoint[body][p->frontier[j]] >= 0)
            outputs[n++] = (hg_output){ p->adjoint[body][p->frontier[j]], { HG_PLACE_ADJOINT, 0, (int16_t)j }, true };
    for (int k = 0; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        const int newest = -array->missing;
        if (!array->gradient) continue;
        for (int offset = -body; offset <= newest; offset++)
            for (int c = 0; c < array->width; c++) {
                const int adjoint =
                    adjoint_of(p, p->adjoint[body],
                               (hg_input){ array->kind, (int16_t)offset, (int16_t)c, (int16_t)array->name, 0 });
                /* from root to tip the site is the first to touch its last vertex: the gradient need not be cleared */
                const bool set = offset == newest && !program->n_carry;
                const hg_operand to = { (uint8_t)(HG_PLACE_ARRAY_GRADIENT + k), (int8_t)offset, (int16_t)c };
                if (adjoint >= 0 || set) outputs[n++] = (hg_output){ adjoint, to, !set };
            }
    }
    for (int i = 0; i < p->graph.n_carries; i++) {
        const hg_graph_carry *carry = &p->graph.carries[i];
        if (carry->rest || !in_body(p, body, carry->term) || first_site(p, body, carry->term)) continue;
        for (int c = 0; c < carry->width; c++) {
            const int adjoint =
                adjoint_of(p, p->adjoint[body], (hg_input){ HG_INPUT_CARRY, 0, (int16_t)c, (int16_t)i, 0 });
            outputs[n++] = (hg_output){ adjoint, { HG_PLACE_CARRY_ADJOINT, 0, (int16_t)(p->carry_at[i] + c) }, false };
        }
    }
    return n;
}

/* What a site keeps, on the way from root to tip. */
static int forward_outputs(const planner *p, int body, hg_output *outputs)
{
    int n = 0;
    for (int i = 0; i < p->graph.n_carries; i++) {
        const hg_graph_carry *carry = &p->graph.carries[i];
        if (carry->rest || !in_body(p, body, carry->term)) continue;
        const int *kept = first_site(p, body, carry->term) ? carry->first_site_kept : carry->kept;
        for (int c = 0; c < carry->width; c++)
            outputs[n++] = (hg_output){ kept[c], { HG_PLACE_CARRY, 1, (int16_t)(p->carry_at[i] + c) }, false };
    }
    return n;
}

static int postamble_outputs(const planner *p, hg_output *outputs)
{
    const hg_strand_program *program = p->program;
    int n = 0;
    for (int rest = 0; rest < 2; rest++)
        for (int k = 0; k < 2; k++)
            for (int c = 0; c < 3; c++) {
                const hg_input_kind kind = rest ? HG_INPUT_ROOT_REST : HG_INPUT_ROOT_X;
                const int adjoint = adjoint_of(p, p->chained, (hg_input){ kind, (int16_t)k, (int16_t)c, 0, 0 });
                const int place = (rest ? HG_PLACE_GRADIENT_REST0 : HG_PLACE_GRADIENT_X0) + k;
                if (adjoint >= 0) outputs[n++] = (hg_output){ adjoint, { (uint8_t)place, 0, (int16_t)c }, true };
            }
    for (int j = 0; j < program->n_inputs; j++) {
        const hg_strand_input *input = &program->inputs[j];
        for (int c = 0; c < input->width && input->gradient; c++) {
            const hg_input in = { input->kind, 0, (int16_t)c, (int16_t)input->name, (int16_t)input->term };
            const hg_operand to = { HG_PLACE_STRAND_INPUT_GRADIENT, 0, (int16_t)(input->first + c) };
            outputs[n++] = (hg_output){ adjoint_of(p, p->chained, in), to, false };
        }
    }
    return n;
}

/* ---- places ------------------------------------------------------------------------------------------------- */

static void claim(planner *p, int *table, int *n, int node)
{
    if (p->index[node] >= 0) return;
    p->index[node] = *n;
    table[(*n)++] = node;
}

/* What a node needs from slower parts. */
static void demand(planner *p, bool *seen, int node)
{
    hg_strand_program *program = p->program;
    if (node < 0 || seen[node]) return;
    seen[node] = true;
    const hg_node n = p->graph.nodes[node];
    switch (rate(p, node)) {
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
        if (p->part < PREAMBLE || (p->part == POSTAMBLE && !(n.depends & HG_DEPENDS_ADJOINT))) {
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
static int steps_from_stored(planner *p, int node, int without)
{
    const hg_node n = p->graph.nodes[node];
    if (n.op == HG_NODE_NUMBER) return 0;
    if (rate(p, node) != HG_RATE_GROOM || n.op == HG_NODE_INPUT || n.op == HG_NODE_DIV || n.op == HG_NODE_SQRT ||
        n.op == HG_NODE_RSQRT || (n.op >= HG_NODE_EXP && n.op <= HG_NODE_ATAN2))
        return ENOUGH;
    const int arguments[3] = { n.a, n.b, n.c };
    int steps = 1;
    for (int k = 0; k < hg_node_arguments((hg_node_op)n.op) && steps < ENOUGH; k++) {
        const int argument = arguments[k];
        if (k > 0 && argument == arguments[k - 1]) continue;
        const int stored = rate(p, argument) == HG_RATE_GROOM ? canonical(p, argument) : argument;
        if (stored != without && p->index[stored] >= 0 && rate(p, argument) == HG_RATE_GROOM) continue;
        steps += steps_from_stored(p, argument, without);
    }
    return steps;
}

/* Groom values that are a few cheap steps away from others that are stored anyway are not worth the memory they would
 * be read from: a large groom is bound by memory, not by arithmetic. */
static void drop_cheap(planner *p)
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
    planner *p = self;
    const hg_node *n = &p->graph.nodes[node];
    switch (rate(p, node)) {
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
        if (p->part != PREAMBLE && !(n->depends & HG_DEPENDS_ADJOINT)) {
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
    if ((k = find_source(p->program->arrays, p->program->n_arrays, in)) >= 0) {
        *operand = (hg_operand){ (uint8_t)(HG_PLACE_ARRAY + k), (int8_t)in.offset, in.component };
        return true;
    }
    if ((k = find_source(p->program->inputs, p->program->n_inputs, in)) >= 0) {
        *operand = (hg_operand){ HG_PLACE_STRAND_INPUT, 0, (int16_t)(p->program->inputs[k].first + in.component) };
        return true;
    }
    return false;
}

/* ---- the program -------------------------------------------------------------------------------------------- */

/* Rest data that goes from site to site: functions of a vertex, run in order when the groom's values are made. */
static hg_status lower_rest_carries(planner *p)
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

static hg_status lower(planner *p)
{
    hg_strand_program *program = p->program;
    hg_graph *graph = &p->graph;
    /* shifting groom values to their canonical site makes a few more nodes: do it before tables are sized by them */
    for (int i = 0, n = graph->n; i < n; i++)
        if (rate(p, i) == HG_RATE_GROOM) canonical(p, i);
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
        int count = body_outputs(p, p->part, outputs);
        for (int i = 0; i < count; i++) demand(p, seen, outputs[i].node);
        count = forward_outputs(p, p->part, outputs);
        for (int i = 0; i < count; i++) demand(p, seen, outputs[i].node);
    }
    const int after = postamble_outputs(p, outputs);
    p->part = POSTAMBLE;
    for (int i = 0; i < after; i++) demand(p, seen, outputs[i].node);
    p->part = PREAMBLE;
    memset(seen, 0, n);
    for (int i = 0; i < program->n_strand; i++) demand(p, seen, p->strand[i]);
    drop_cheap(p);

    for (p->part = 0; status == HG_OK && p->part < program->bodies; p->part++) {
        int count = body_outputs(p, p->part, outputs);
        status = hg_lower(&program->body[p->part], graph, leaf, p, &program->numbers, count, outputs);
        count = forward_outputs(p, p->part, outputs);
        if (status == HG_OK)
            status = hg_lower(&program->forward[p->part], graph, leaf, p, &program->numbers, count, outputs);
    }
    if (status == HG_OK) status = lower_rest_carries(p);
    if (status == HG_OK) {
        for (int i = 0; i < program->n_strand; i++)
            outputs[i] = (hg_output){ p->strand[i], { HG_PLACE_STRAND, 0, (int16_t)i }, false };
        p->part = PREAMBLE;
        status = hg_lower(&program->preamble, graph, leaf, p, &program->numbers, program->n_strand, outputs);
    }
    if (status == HG_OK) {
        p->part = POSTAMBLE;
        status =
            hg_lower(&program->postamble, graph, leaf, p, &program->numbers, postamble_outputs(p, outputs), outputs);
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
    HG_TRY(hg_steps_create(&p->steps[PREAMBLE], &p->preamble, lanes, stride));
    HG_TRY(hg_steps_create(&p->steps[POSTAMBLE], &p->postamble, lanes, stride));
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

static hg_status make(planner *p)
{
    hg_strand_program *program = p->program;
    const size_t n = (size_t)program->n_terms + 1;
    program->used = hg_alloc(n, sizeof *program->used);
    program->attribute_term = hg_alloc(HG_GRAPH_ATTRIBUTES, sizeof *program->attribute_term);
    program->frame_term = hg_alloc(HG_GRAPH_ATTRIBUTES, sizeof *program->frame_term);
    p->energy = hg_alloc(n, sizeof *p->energy);
    p->first_energy = hg_alloc(n, sizeof *p->first_energy);
    p->root = hg_alloc(n, sizeof *p->root);
    p->carries = hg_alloc(n, sizeof *p->carries);
    if (!program->used || !program->attribute_term || !program->frame_term || !p->energy || !p->first_energy ||
        !p->root || !p->carries)
        return HG_MEMORY;
    HG_TRY(trace(p));
    p->frontier = hg_alloc((size_t)p->traced + 1, sizeof *p->frontier);
    p->chained = hg_alloc((size_t)p->traced + 1, sizeof *p->chained);
    if (!p->frontier || !p->chained) return HG_MEMORY;
    HG_TRY(find_sources(p));
    HG_TRY(differentiate(p));
    HG_TRY(lower(p));
    program->hash = program_hash(program);
    return steps(program);
}

hg_status hg_strand_program_create(hg_strand_program **out, hg_dtype dtype, int n_terms, const hg_strand_term *terms,
                                   int n_given, const hg_given *given, bool hoist)
{
    *out = NULL;
    planner plan = { .program = hg_alloc(1, sizeof *plan.program), .terms = terms }, *p = &plan;
    if (!p->program) return HG_MEMORY;
    hg_strand_program *program = p->program;
    hg_graph *graph = &p->graph;
    program->n_terms = n_terms;
    program->dtype = dtype;
    hg_graph_init(graph, HG_ALLOW(HG_INPUT_X) | HG_ALLOW(HG_INPUT_ROOT_X) | HG_ALLOW(HG_INPUT_CARRY), hoist);
    graph->given = given;
    graph->n_given = n_given;
    hg_status status = make(p);
    program->n_attributes = graph->n_attributes;
    program->n_frames = graph->n_frames;
    memcpy(program->attributes, graph->attributes, sizeof graph->attributes);
    memcpy(program->frames, graph->frames, sizeof graph->frames);
    graph->n_attributes = graph->n_frames = 0;
    hg_graph_free(graph);
    hg_free(p->energy);
    hg_free(p->first_energy);
    hg_free(p->root);
    hg_free(p->carries);
    for (int i = 0; i < HG_STRAND_BODIES; i++) hg_free(p->adjoint[i]);
    hg_free(p->stored);
    hg_free(p->groom_strand);
    hg_free(p->strand);
    hg_free(p->uniform);
    hg_free(p->frontier);
    hg_free(p->chained);
    hg_free(p->index);
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
