/* The plan of a strand program: the window energies of a physics become one graph, differentiated once per body; what is
 * read gets its place, and every list of the program its outputs. */
#include "autograd/trace/strand_plan.h"

#include <string.h>

/* ---- tracing and differentiating ---------------------------------------------------------------------------- */

/* Both the sites that follow another and, where values are carried, the first one: there `first` takes their place. */
static hg_status trace_term(hg_strand_plan *p, int t)
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

static hg_status trace(hg_strand_plan *p)
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

static bool in_body(const hg_strand_plan *p, int body, int term)
{
    return p->terms[term].scope.window <= body + 1 || body == p->program->bodies - 1;
}

static bool first_site(const hg_strand_plan *p, int body, int term)
{
    return p->carries[term] && body == p->terms[term].scope.window - 1;
}

static int energy_of(const hg_strand_plan *p, int body, int term)
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

int hg_plan_find(const hg_strand_input *sources, int n, hg_input in)
{
    for (int i = 0; i < n; i++)
        if (same_source(&sources[i], in)) return i;
    return -1;
}

static hg_status add_array(hg_strand_plan *p, hg_input in)
{
    hg_strand_program *program = p->program;
    if (hg_plan_find(program->arrays, program->n_arrays, in) >= 0) return HG_OK;
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

static hg_status add_input(hg_strand_plan *p, hg_input in, int width)
{
    hg_strand_program *program = p->program;
    if (hg_plan_find(program->inputs, program->n_inputs, in) >= 0) return HG_OK;
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
static hg_status find_sources(hg_strand_plan *p)
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
        if ((in.kind == HG_INPUT_PARAM || in.kind == HG_INPUT_DT) && hg_plan_rate(p, i) == HG_RATE_STRAND)
            status = add_input(p, in, 1);
        if (in.kind == HG_INPUT_ROOT_REST && hg_plan_rate(p, i) == HG_RATE_STRAND) {
            in.kind = HG_INPUT_REST;
            status = add_array(p, in);
        } else if (hg_plan_rate(p, i) == HG_RATE_SITE && in.kind != HG_INPUT_CARRY) {
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

static hg_status differentiate_body(hg_strand_plan *p, int body, int *roots, int *seeds)
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

static hg_status differentiate(hg_strand_plan *p)
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
            reached |= p->adjoint[body][node] >= 0 && hg_plan_rate(p, node) != HG_RATE_SITE;
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
static int adjoint_of(const hg_strand_plan *p, const int *adjoint, hg_input in)
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
int hg_plan_body(const hg_strand_plan *p, int body, hg_output *outputs)
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
int hg_plan_forward(const hg_strand_plan *p, int body, hg_output *outputs)
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

int hg_plan_postamble(const hg_strand_plan *p, hg_output *outputs)
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

/* ---- the plan ----------------------------------------------------------------------------------------------- */

hg_status hg_strand_plan_make(hg_strand_plan *p)
{
    const size_t n = (size_t)p->program->n_terms + 1;
    p->energy = hg_alloc(n, sizeof *p->energy);
    p->first_energy = hg_alloc(n, sizeof *p->first_energy);
    p->root = hg_alloc(n, sizeof *p->root);
    p->carries = hg_alloc(n, sizeof *p->carries);
    if (!p->energy || !p->first_energy || !p->root || !p->carries) return HG_MEMORY;
    HG_TRY(trace(p));
    p->frontier = hg_alloc((size_t)p->traced + 1, sizeof *p->frontier);
    p->chained = hg_alloc((size_t)p->traced + 1, sizeof *p->chained);
    if (!p->frontier || !p->chained) return HG_MEMORY;
    HG_TRY(find_sources(p));
    return differentiate(p);
}

void hg_strand_plan_free(hg_strand_plan *p)
{
    hg_graph_free(&p->graph);
    for (int i = 0; i < HG_STRAND_BODIES; i++) hg_free(p->adjoint[i]);
    void *const tables[] = { p->energy, p->first_energy, p->root,     p->carries, p->stored, p->groom_strand,
                             p->strand, p->uniform,      p->frontier, p->chained, p->index };
    for (size_t i = 0; i < sizeof tables / sizeof *tables; i++) hg_free(tables[i]);
}
