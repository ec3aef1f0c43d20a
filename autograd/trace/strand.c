/* The strand program: the window energies of a physics become one graph, differentiated once per body, cut by how often
 * things change, and lowered to the lists that the interpreter runs and the printers print. */
#include "autograd/trace/strand.h"

#include <string.h>

typedef struct {
    hg_strand_program *program;
    hg_graph graph;
    int *energy, *root;             /* nodes of the terms; -1: no root term */
    int *adjoint[HG_STRAND_BODIES]; /* of the nodes that were traced, per body */
    int traced;
    int *stored, *groom_strand, *strand, *uniform; /* nodes that get a place */
    int *frontier;                                 /* strand nodes whose adjoints are summed */
    int *index;                                    /* place of a node in its table; -1: none */
    int root_gradient[2][3];
    int part; /* list being lowered: a body, or one of these */
} planner;
enum { PREAMBLE = HG_STRAND_BODIES, POSTAMBLE };

static const struct {
    hg_input_kind kind;
    hg_where place;
} arrays[HG_STRAND_ARRAYS] = {
    [HG_STRAND_X] = { HG_INPUT_X, HG_PLACE_X },
    [HG_STRAND_POSED] = { HG_INPUT_POSED, HG_PLACE_POSED },
    [HG_STRAND_PREDICTED] = { HG_INPUT_PREDICTED, HG_PLACE_PREDICTED },
    [HG_STRAND_PREVIOUS] = { HG_INPUT_PREVIOUS, HG_PLACE_PREVIOUS },
    [HG_STRAND_CONTACT_POINT] = { HG_INPUT_CONTACT_POINT, HG_PLACE_CONTACT_POINT },
    [HG_STRAND_CONTACT_NORMAL] = { HG_INPUT_CONTACT_NORMAL, HG_PLACE_CONTACT_NORMAL },
};

static hg_rate rate(const planner *p, int node) { return (hg_rate)p->graph.nodes[node].rate; }

/* The same groom value with the window moved so that its last vertex is the site's: stored once, read at an offset. */
static int canonical(planner *p, int node) { return hg_graph_shift(&p->graph, node, -p->graph.nodes[node].last); }

/* ---- tracing and differentiating ---------------------------------------------------------------------------- */

static hg_status trace(planner *p, const hg_strand_term *terms)
{
    hg_strand_program *program = p->program;
    int window = 1, any_root = 0;
    for (int t = 0; t < program->n_terms; t++) {
        hg_trace_scope scope = terms[t].scope;
        scope.term = t;
        const int known = p->graph.n_attributes;
        p->root[t] = -1;
        HG_TRY(hg_graph_trace(&p->graph, terms[t].trace, &scope, &p->energy[t], &program->used[t]));
        if (scope.window > window) window = scope.window;
        if (terms[t].root) {
            any_root = 1;
            scope.window = 2;
            HG_TRY(hg_graph_trace(&p->graph, terms[t].root, &scope, &p->root[t], &program->used[t]));
        }
        for (int i = known; i < p->graph.n_attributes; i++) program->attribute_term[i] = t;
    }
    program->bodies = any_root && window < 3 ? 3 : window;
    if (program->bodies > HG_STRAND_BODIES)
        return hg_fail(HG_UNSUPPORTED, "a window of %d vertices: at most %d are possible", program->bodies,
                       HG_STRAND_BODIES);
    p->traced = p->graph.n;
    return HG_OK;
}

static bool in_body(const planner *p, const hg_strand_term *terms, int body, int term)
{
    return terms[term].scope.window <= body + 1 || body == p->program->bodies - 1;
}

static hg_status differentiate(planner *p, const hg_strand_term *terms)
{
    hg_graph *graph = &p->graph;
    hg_strand_program *program = p->program;
    int *roots = hg_alloc(2 * (size_t)program->n_terms + 1, sizeof *roots);
    int *seeds = hg_alloc(2 * (size_t)program->n_terms + 1, sizeof *seeds);
    hg_status status = roots && seeds ? HG_OK : HG_MEMORY;
    for (int body = 0; status == HG_OK && body < program->bodies; body++) {
        int n = 0;
        p->adjoint[body] = hg_alloc((size_t)p->traced + 1, sizeof(int));
        if (!p->adjoint[body]) {
            status = HG_MEMORY;
            break;
        }
        for (int i = 0; i < p->traced; i++) p->adjoint[body][i] = -1;
        for (int t = 0; t < program->n_terms; t++) {
            const int weight = hg_graph_input(graph, (hg_input){ HG_INPUT_WEIGHT, 0, 0, 0, (int16_t)t });
            if (in_body(p, terms, body, t)) {
                roots[n] = p->energy[t];
                seeds[n++] = weight;
            }
            if (body == 1 && p->root[t] >= 0) {
                roots[n] = p->root[t];
                seeds[n++] = weight;
            }
        }
        if (graph->status != HG_OK)
            status = hg_fail(graph->status, "%s", graph->message);
        else
            status = hg_graph_reverse(graph, n, roots, seeds, true, p->adjoint[body]);
    }
    hg_free(roots);
    hg_free(seeds);
    HG_TRY(status);

    /* strand values that a site's derivative reached: their adjoints are summed, then chained once */
    for (int node = 0; node < p->traced; node++) {
        bool reached = false;
        for (int body = 0; body < program->bodies; body++)
            reached |= p->adjoint[body][node] >= 0 && rate(p, node) != HG_RATE_SITE;
        if (reached) p->frontier[program->n_adjoint++] = node;
    }
    for (int k = 0; k < 2; k++)
        for (int c = 0; c < 3; c++) p->root_gradient[k][c] = -1;
    if (program->n_adjoint == 0) return HG_OK;
    int *adjoint = hg_alloc((size_t)p->traced + 1, sizeof *adjoint),
        *sums = hg_alloc((size_t)p->traced + 1, sizeof *sums);
    status = adjoint && sums ? HG_OK : HG_MEMORY;
    for (int j = 0; status == HG_OK && j < program->n_adjoint; j++)
        sums[j] = hg_graph_input(graph, (hg_input){ HG_INPUT_ADJOINT, 0, 0, (int16_t)j, 0 });
    if (status == HG_OK) {
        for (int i = 0; i < p->traced; i++) adjoint[i] = -1;
        status = hg_graph_reverse(graph, program->n_adjoint, p->frontier, sums, false, adjoint);
    }
    for (int i = 0; status == HG_OK && i < p->traced; i++) {
        const hg_node *node = &graph->nodes[i];
        if (node->op == HG_NODE_INPUT && node->input.kind == HG_INPUT_ROOT_X)
            p->root_gradient[node->input.offset][node->input.component] = adjoint[i];
    }
    hg_free(adjoint);
    hg_free(sums);
    return status;
}

/* Outputs of a body: the energies of its terms, the gradient of its vertices, the adjoints of strand values. */
static int body_outputs(const planner *p, const hg_strand_term *terms, int body, hg_output *outputs)
{
    const hg_strand_program *program = p->program;
    int n = 0;
    for (int t = 0; t < program->n_terms; t++) {
        const hg_operand to = { HG_PLACE_ENERGY, 0, (int16_t)t };
        if (in_body(p, terms, body, t)) outputs[n++] = (hg_output){ p->energy[t], to, true };
        if (body == 1 && p->root[t] >= 0) outputs[n++] = (hg_output){ p->root[t], to, true };
    }
    for (int j = 0; j < program->n_adjoint; j++)
        if (p->adjoint[body][p->frontier[j]] >= 0)
            outputs[n++] = (hg_output){ p->adjoint[body][p->frontier[j]], { HG_PLACE_ADJOINT, 0, (int16_t)j }, true };
    for (int offset = -body; offset <= 0; offset++)
        for (int c = 0; c < 3; c++) {
            int adjoint = -1;
            for (int i = 0; i < p->traced && adjoint < 0; i++) {
                const hg_node *node = &p->graph.nodes[i];
                if (node->op == HG_NODE_INPUT && node->input.kind == HG_INPUT_X && node->input.offset == offset &&
                    node->input.component == c)
                    adjoint = p->adjoint[body][i];
            }
            /* the site is the first to touch its last vertex: the gradient need not be cleared before */
            if (adjoint >= 0 || offset == 0)
                outputs[n++] = (hg_output){ adjoint, { HG_PLACE_GRADIENT, (int8_t)offset, (int16_t)c }, offset != 0 };
        }
    return n;
}

static int postamble_outputs(const planner *p, hg_output *outputs)
{
    int n = 0;
    for (int k = 0; k < 2; k++)
        for (int c = 0; c < 3; c++)
            if (p->root_gradient[k][c] >= 0)
                outputs[n++] =
                    (hg_output){ p->root_gradient[k][c], { (uint8_t)(HG_PLACE_GRADIENT0 + k), 0, (int16_t)c }, true };
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
    for (int k = 0; k < HG_STRAND_ARRAYS; k++)
        if (in.kind == arrays[k].kind) {
            p->program->arrays |= 1u << k;
            *operand = (hg_operand){ (uint8_t)arrays[k].place, (int8_t)in.offset, in.component };
            return true;
        }
    switch (in.kind) {
    case HG_INPUT_ROOT_X:
        *operand = (hg_operand){ (uint8_t)(HG_PLACE_ROOT_X0 + in.offset), 0, in.component };
        return true;
    case HG_INPUT_ROOT_ROTATION:
        *operand = (hg_operand){ HG_PLACE_ROOT, 0, in.component };
        return true;
    case HG_INPUT_ROOT_POSITION:
        *operand = (hg_operand){ HG_PLACE_ROOT, 0, (int16_t)(4 + in.component) };
        return true;
    case HG_INPUT_ADJOINT:
        *operand = (hg_operand){ HG_PLACE_ADJOINT, 0, in.name };
        return true;
    default:
        return false;
    }
}

/* ---- the program -------------------------------------------------------------------------------------------- */

static hg_status lower(planner *p, const hg_strand_term *terms)
{
    hg_strand_program *program = p->program;
    hg_graph *graph = &p->graph;
    /* shifting groom values to their canonical site makes a few more nodes: do it before tables are sized by them */
    for (int i = 0, n = graph->n; i < n; i++)
        if (rate(p, i) == HG_RATE_GROOM) canonical(p, i);
    const size_t n = (size_t)graph->n + 1;
    hg_output *outputs = hg_alloc(n + 2 * (size_t)program->n_terms + 64, sizeof *outputs);
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
        const int count = body_outputs(p, terms, p->part, outputs);
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
        const int count = body_outputs(p, terms, p->part, outputs);
        status = hg_lower(&program->body[p->part], graph, leaf, p, &program->numbers, count, outputs);
    }
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

static uint64_t program_hash(const hg_strand_program *p)
{
    const int32_t sizes[] = { 1 /* version of the printed kernel */,
                              p->n_terms,
                              p->bodies,
                              p->n_uniform,
                              p->n_site,
                              p->n_groom_strand,
                              p->n_strand,
                              p->n_adjoint,
                              (int32_t)p->arrays };
    uint64_t hash = hg_hash(sizes, sizeof sizes, p->dtype == HG_F64 ? 64 : 32);
    hash = hg_hash(p->numbers.values, (size_t)p->numbers.n * sizeof(double), hash);
    for (int i = 0; i < p->bodies; i++) hash = hg_code_hash(&p->body[i], hash);
    hash = hg_code_hash(&p->preamble, hash);
    return hg_code_hash(&p->postamble, hash);
}

static hg_status steps(hg_strand_program *p)
{
    int stride[HG_PLACES] = { 0 };
    for (int place = HG_PLACE_X; place <= HG_PLACE_CONTACT_NORMAL; place++) stride[place] = 3;
    stride[HG_PLACE_GRADIENT] = 3;
    stride[HG_PLACE_SITE] = p->n_site;
    const int lanes = hg_strand_lanes(p->dtype);
    for (int i = 0; i < p->bodies; i++) HG_TRY(hg_steps_create(&p->steps[i], &p->body[i], lanes, stride));
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

hg_status hg_strand_program_create(hg_strand_program **out, hg_dtype dtype, int n_terms, const hg_strand_term *terms,
                                   bool hoist)
{
    *out = NULL;
    planner plan = { .program = hg_alloc(1, sizeof *plan.program) }, *p = &plan;
    if (!p->program) return HG_MEMORY;
    hg_strand_program *program = p->program;
    program->n_terms = n_terms;
    program->dtype = dtype;
    program->used = hg_alloc((size_t)n_terms + 1, sizeof *program->used);
    program->attribute_term = hg_alloc(HG_GRAPH_ATTRIBUTES, sizeof *program->attribute_term);
    p->energy = hg_alloc((size_t)n_terms + 1, sizeof *p->energy);
    p->root = hg_alloc((size_t)n_terms + 1, sizeof *p->root);
    hg_graph_init(&p->graph, HG_ALLOW(HG_INPUT_X) | HG_ALLOW(HG_INPUT_ROOT_X), hoist);
    hg_status status = program->used && program->attribute_term && p->energy && p->root ? HG_OK : HG_MEMORY;
    if (status == HG_OK) status = trace(p, terms);
    if (status == HG_OK && !(p->frontier = hg_alloc((size_t)p->traced + 1, sizeof *p->frontier))) status = HG_MEMORY;
    if (status == HG_OK) status = differentiate(p, terms);
    if (status == HG_OK) status = lower(p, terms);
    if (status == HG_OK) {
        program->hash = program_hash(program);
        status = steps(program);
    }
    program->n_attributes = p->graph.n_attributes;
    for (int i = 0; i < p->graph.n_attributes; i++) {
        program->attributes[i] = p->graph.attributes[i];
        p->graph.attributes[i] = NULL;
    }
    hg_graph_free(&p->graph);
    hg_free(p->energy);
    hg_free(p->root);
    for (int i = 0; i < HG_STRAND_BODIES; i++) hg_free(p->adjoint[i]);
    hg_free(p->stored);
    hg_free(p->groom_strand);
    hg_free(p->strand);
    hg_free(p->uniform);
    hg_free(p->frontier);
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
    hg_code_free(&program->preamble);
    hg_code_free(&program->postamble);
    for (int i = 0; i < HG_STRAND_BODIES; i++) hg_code_free(&program->body[i]);
    for (int i = 0; i < HG_STRAND_BODIES + 2; i++) hg_steps_free(&program->steps[i]);
    hg_free(program->numbers.values);
    hg_free(program->used);
    hg_free(program->attribute_term);
    for (int i = 0; i < program->n_attributes; i++) hg_free(program->attributes[i]);
    hg_free(program->number_table);
    hg_free(program);
}
