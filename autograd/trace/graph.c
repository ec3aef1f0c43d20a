/* The graph: equal nodes are one node (hash consing), arithmetic on literals is done at once, and a few identities keep
 * it small (x + 0, 1 x, -(-x), division by something slower becomes multiplication by its reciprocal, which can be
 * hoisted). */
#include "autograd/trace/graph.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* ---- the graph ---------------------------------------------------------------------------------------------- */

void hg_graph_init(hg_graph *graph, uint32_t wrt, bool hoist)
{
    *graph = (hg_graph){ .wrt = wrt, .hoist = hoist, .status = HG_OK };
}

void hg_graph_free(hg_graph *graph)
{
    hg_free(graph->nodes);
    hg_free(graph->table);
    for (int i = 0; i < graph->n_attributes; i++) hg_free(graph->attributes[i]);
    for (int i = 0; i < graph->n_frames; i++) hg_free(graph->frames[i]);
    for (int i = 0; i < graph->n_carries; i++) hg_free(graph->carries[i].name);
    *graph = (hg_graph){ .status = HG_OK };
}

hg_status hg_graph_fail(hg_graph *graph, hg_status status, const char *format, ...)
{
    if (graph->status != HG_OK) return graph->status;
    va_list list;
    va_start(list, format);
    vsnprintf(graph->message, sizeof graph->message, format, list);
    va_end(list);
    return graph->status = status;
}

static const struct {
    const char *name;
    int arguments;
} ops[HG_NODE_OPS] = {
    [HG_NODE_NUMBER] = { "number", 0 }, [HG_NODE_INPUT] = { "input", 0 },   [HG_NODE_DETACH] = { "detach", 1 },
    [HG_NODE_ADD] = { "add", 2 },       [HG_NODE_SUB] = { "sub", 2 },       [HG_NODE_MUL] = { "mul", 2 },
    [HG_NODE_DIV] = { "div", 2 },       [HG_NODE_NEG] = { "neg", 1 },       [HG_NODE_SQRT] = { "sqrt", 1 },
    [HG_NODE_RSQRT] = { "rsqrt", 1 },   [HG_NODE_ABS] = { "abs", 1 },       [HG_NODE_EXP] = { "exp", 1 },
    [HG_NODE_LOG] = { "log", 1 },       [HG_NODE_SIN] = { "sin", 1 },       [HG_NODE_COS] = { "cos", 1 },
    [HG_NODE_ATAN2] = { "atan2", 2 },   [HG_NODE_MIN] = { "min", 2 },       [HG_NODE_MAX] = { "max", 2 },
    [HG_NODE_LESS] = { "less", 2 },     [HG_NODE_SELECT] = { "select", 3 },
};

int hg_node_arguments(hg_node_op op) { return ops[op].arguments; }

const char *hg_node_name(hg_node_op op) { return ops[op].name; }

double hg_node_evaluate(hg_node_op op, double a, double b, double c)
{
    switch (op) {
    case HG_NODE_ADD:
        return a + b;
    case HG_NODE_SUB:
        return a - b;
    case HG_NODE_MUL:
        return a * b;
    case HG_NODE_DIV:
        return a / b;
    case HG_NODE_NEG:
        return -a;
    case HG_NODE_SQRT:
        return sqrt(a);
    case HG_NODE_RSQRT:
        return 1 / sqrt(a);
    case HG_NODE_ABS:
        return fabs(a);
    case HG_NODE_EXP:
        return exp(a);
    case HG_NODE_LOG:
        return log(a);
    case HG_NODE_SIN:
        return sin(a);
    case HG_NODE_COS:
        return cos(a);
    case HG_NODE_ATAN2:
        return atan2(a, b);
    case HG_NODE_MIN:
        return b < a ? b : a;
    case HG_NODE_MAX:
        return a < b ? b : a;
    case HG_NODE_LESS:
        return a < b ? 1 : 0;
    case HG_NODE_SELECT:
        return a != 0 ? b : c;
    case HG_NODE_DETACH:
        return a;
    default:
        return NAN;
    }
}

static const struct {
    const char *name;
    hg_rate rate;
    int components;
} kinds[HG_INPUT_KINDS] = {
    [HG_INPUT_X] = { "x", HG_RATE_SITE, 3 },
    [HG_INPUT_REST] = { "rest", HG_RATE_GROOM, 3 },
    [HG_INPUT_POSED] = { "posed", HG_RATE_SITE, 3 },
    [HG_INPUT_PREDICTED] = { "predicted", HG_RATE_SITE, 3 },
    [HG_INPUT_PREVIOUS] = { "previous", HG_RATE_SITE, 3 },
    [HG_INPUT_CONTACT_POINT] = { "contact_point", HG_RATE_SITE, 3 },
    [HG_INPUT_CONTACT_NORMAL] = { "contact_normal", HG_RATE_SITE, 3 },
    [HG_INPUT_ROOT_X] = { "root_x", HG_RATE_STRAND, 3 },
    [HG_INPUT_ROOT_REST] = { "root_rest", HG_RATE_GROOM_STRAND, 3 },
    [HG_INPUT_ROOT_ROTATION] = { "root_rotation", HG_RATE_STRAND, 4 },
    [HG_INPUT_ROOT_POSITION] = { "root_position", HG_RATE_STRAND, 3 },
    [HG_INPUT_MASS] = { "mass", HG_RATE_GROOM, 1 },
    [HG_INPUT_ATTRIBUTE] = { "attribute", HG_RATE_GROOM, 1 },
    [HG_INPUT_DISTANCE] = { "distance", HG_RATE_SITE, 1 },
    [HG_INPUT_REST_DISTANCE] = { "rest_distance", HG_RATE_GROOM, 1 },
    [HG_INPUT_FIELD] = { "field", HG_RATE_SITE, 1 },
    [HG_INPUT_FIELD_REST] = { "field_rest", HG_RATE_GROOM, 1 },
    [HG_INPUT_PARAM] = { "param", HG_RATE_UNIFORM, 1 },
    [HG_INPUT_WEIGHT] = { "weight", HG_RATE_UNIFORM, 1 },
    [HG_INPUT_DT] = { "dt", HG_RATE_UNIFORM, 1 },
    [HG_INPUT_ADJOINT] = { "adjoint", HG_RATE_STRAND, 1 },
    [HG_INPUT_Q] = { "q", HG_RATE_SITE, 4 },
    [HG_INPUT_FRAME] = { "a named array of the frame", HG_RATE_SITE, 3 },
    [HG_INPUT_CARRY] = { "a carried value", HG_RATE_SITE, 4 },
    [HG_INPUT_REST_CARRY] = { "a carried rest value", HG_RATE_GROOM, 4 },
    [HG_INPUT_CARRY_ADJOINT] = { "the adjoint of a carried value", HG_RATE_SITE, 4 },
};

const char *hg_input_name(hg_input_kind kind) { return kinds[kind].name; }

const hg_given *hg_graph_given(const hg_graph *graph, hg_input input)
{
    if (input.kind == HG_INPUT_ROOT_REST) input.kind = HG_INPUT_REST;
    for (int i = 0; i < graph->n_given; i++) {
        const hg_given *given = &graph->given[i];
        if (given->kind != input.kind) continue;
        if (given->kind == HG_INPUT_PARAM && (given->term != input.term || given->param != input.name)) continue;
        if (given->kind == HG_INPUT_ATTRIBUTE && strcmp(given->name, graph->attributes[input.name]) != 0) continue;
        if (given->kind == HG_INPUT_FRAME && strcmp(given->name, graph->frames[input.name]) != 0) continue;
        return given;
    }
    return NULL;
}

static hg_rate input_rate(hg_input input, const hg_given *given)
{
    if (!given) return kinds[input.kind].rate;
    switch (input.kind) {
    case HG_INPUT_REST:
    case HG_INPUT_MASS:
    case HG_INPUT_ATTRIBUTE:
        return HG_RATE_SITE;
    case HG_INPUT_ROOT_REST:
    case HG_INPUT_PARAM:
    case HG_INPUT_DT:
        return HG_RATE_STRAND;
    default:
        return kinds[input.kind].rate;
    }
}

/* Uniform and rest data meet only per call, so such a node belongs to the strand or the site. */
static hg_rate rate_of(uint8_t depends)
{
    if (depends & HG_DEPENDS_SITE) return HG_RATE_SITE;
    if (depends & HG_DEPENDS_GROOM)
        return depends & ~(HG_DEPENDS_GROOM | HG_DEPENDS_GROOM_STRAND) ? HG_RATE_SITE : HG_RATE_GROOM;
    if (depends & (HG_DEPENDS_STRAND | HG_DEPENDS_ADJOINT)) return HG_RATE_STRAND;
    if (depends & HG_DEPENDS_GROOM_STRAND) return depends & HG_DEPENDS_UNIFORM ? HG_RATE_STRAND : HG_RATE_GROOM_STRAND;
    return depends ? HG_RATE_UNIFORM : HG_RATE_CONSTANT;
}

static uint64_t node_hash(const hg_node *node)
{
    struct {
        double number;
        int32_t op, a, b, c;
        int16_t input[5];
        int16_t pad[3];
    } key;
    memset(&key, 0, sizeof key);
    key.number = node->number;
    key.op = node->op;
    key.a = node->a;
    key.b = node->b;
    key.c = node->c;
    key.input[0] = (int16_t)node->input.kind;
    key.input[1] = node->input.offset;
    key.input[2] = node->input.component;
    key.input[3] = node->input.name;
    key.input[4] = node->input.term;
    return hg_hash(&key, sizeof key, 0);
}

static bool node_equal(const hg_node *p, const hg_node *q)
{
    return p->op == q->op && p->a == q->a && p->b == q->b && p->c == q->c &&
           memcmp(&p->number, &q->number, sizeof p->number) == 0 && p->input.kind == q->input.kind &&
           p->input.offset == q->input.offset && p->input.component == q->input.component &&
           p->input.name == q->input.name && p->input.term == q->input.term;
}

static bool table_grow(hg_graph *graph)
{
    int size = graph->table_size ? 2 * graph->table_size : 1024;
    int32_t *table = hg_alloc((size_t)size, sizeof *table);
    if (!table) return false;
    for (int i = 0; i < graph->n; i++) {
        uint64_t slot = node_hash(&graph->nodes[i]) & (uint64_t)(size - 1);
        while (table[slot]) slot = (slot + 1) & (uint64_t)(size - 1);
        table[slot] = i + 1;
    }
    hg_free(graph->table);
    graph->table = table;
    graph->table_size = size;
    return true;
}

/* The node's number: an equal one that is there already, or a new one. */
static int intern(hg_graph *graph, hg_node node)
{
    if (graph->status != HG_OK) return -1;
    if (2 * (graph->n + 1) > graph->table_size && !table_grow(graph)) {
        hg_graph_fail(graph, HG_MEMORY, "out of memory while tracing");
        return -1;
    }
    uint64_t slot = node_hash(&node) & (uint64_t)(graph->table_size - 1);
    for (; graph->table[slot]; slot = (slot + 1) & (uint64_t)(graph->table_size - 1))
        if (node_equal(&graph->nodes[graph->table[slot] - 1], &node)) return graph->table[slot] - 1;
    if (graph->n == graph->capacity) {
        int capacity = graph->capacity ? 2 * graph->capacity : 512;
        hg_node *nodes = hg_resize(graph->nodes, (size_t)graph->capacity, (size_t)capacity, sizeof *nodes);
        if (!nodes) {
            hg_graph_fail(graph, HG_MEMORY, "out of memory while tracing");
            return -1;
        }
        graph->nodes = nodes;
        graph->capacity = capacity;
    }
    node.first = INT8_MAX;
    node.last = INT8_MIN;
    if (node.op == HG_NODE_INPUT) {
        static const uint8_t bit[] = { [HG_RATE_UNIFORM] = HG_DEPENDS_UNIFORM,
                                       [HG_RATE_GROOM] = HG_DEPENDS_GROOM,
                                       [HG_RATE_GROOM_STRAND] = HG_DEPENDS_GROOM_STRAND,
                                       [HG_RATE_STRAND] = HG_DEPENDS_STRAND,
                                       [HG_RATE_SITE] = HG_DEPENDS_SITE };
        const hg_given *given = hg_graph_given(graph, node.input);
        node.depends = bit[input_rate(node.input, given)];
        if (node.input.kind == HG_INPUT_ADJOINT) node.depends |= HG_DEPENDS_ADJOINT;
        node.active = (graph->wrt & HG_ALLOW(node.input.kind)) != 0 || (given && given->gradient);
        if (node.depends & HG_DEPENDS_GROOM) node.first = node.last = (int8_t)node.input.offset;
    } else {
        const int arguments[3] = { node.a, node.b, node.c };
        for (int i = 0; i < hg_node_arguments(node.op); i++) {
            const hg_node *argument = &graph->nodes[arguments[i]];
            node.depends |= argument->depends;
            node.active |= argument->active;
            if (argument->first < node.first) node.first = argument->first;
            if (argument->last > node.last) node.last = argument->last;
        }
        if (node.op == HG_NODE_LESS || node.op == HG_NODE_DETACH) node.active = false;
        if (!graph->hoist && node.depends) node.depends |= HG_DEPENDS_SITE;
    }
    node.rate = (uint8_t)rate_of(node.depends);
    graph->nodes[graph->n] = node;
    graph->table[slot] = graph->n + 1;
    return graph->n++;
}

int hg_graph_number(hg_graph *graph, double value)
{
    if (value == 0) value = 0; /* -0 and 0 are one */
    return intern(graph, (hg_node){ .op = HG_NODE_NUMBER, .a = -1, .b = -1, .c = -1, .number = value });
}

int hg_graph_input(hg_graph *graph, hg_input input)
{
    return intern(graph, (hg_node){ .op = HG_NODE_INPUT, .a = -1, .b = -1, .c = -1, .input = input });
}

static bool is_number(const hg_graph *graph, int node, double value)
{
    return graph->nodes[node].op == HG_NODE_NUMBER && graph->nodes[node].number == value;
}

/* An identity that makes the node unnecessary or cheaper: its number, or -1 when none applies. */
static int simplify(hg_graph *graph, hg_node_op op, int a, int b, int c)
{
    const hg_node first = graph->nodes[a],
                  second = graph->nodes[b >= 0 ? b : a]; /* copies: recording moves the nodes */
    const hg_node *p = &first, *q = &second;
    const bool p_number = p->op == HG_NODE_NUMBER, q_number = q->op == HG_NODE_NUMBER;
    switch (op) {
    case HG_NODE_ADD:
        if (is_number(graph, a, 0)) return b;
        if (is_number(graph, b, 0)) return a;
        if (q->op == HG_NODE_NEG) return hg_graph_op(graph, HG_NODE_SUB, a, q->a, -1);
        if (p->op == HG_NODE_NEG) return hg_graph_op(graph, HG_NODE_SUB, b, p->a, -1);
        if (a == b) return hg_graph_op(graph, HG_NODE_MUL, hg_graph_number(graph, 2), a, -1);
        break;
    case HG_NODE_SUB:
        if (is_number(graph, b, 0)) return a;
        if (is_number(graph, a, 0)) return hg_graph_op(graph, HG_NODE_NEG, b, -1, -1);
        if (a == b) return hg_graph_number(graph, 0);
        if (q->op == HG_NODE_NEG) return hg_graph_op(graph, HG_NODE_ADD, a, q->a, -1);
        break;
    case HG_NODE_MUL:
        if (is_number(graph, a, 0) || is_number(graph, b, 1)) return a;
        if (is_number(graph, b, 0) || is_number(graph, a, 1)) return b;
        if (is_number(graph, a, -1)) return hg_graph_op(graph, HG_NODE_NEG, b, -1, -1);
        if (is_number(graph, b, -1)) return hg_graph_op(graph, HG_NODE_NEG, a, -1, -1);
        if (p->op == HG_NODE_NEG && q_number)
            return hg_graph_op(graph, HG_NODE_MUL, p->a, hg_graph_number(graph, -q->number), -1);
        if (q->op == HG_NODE_NEG && p_number)
            return hg_graph_op(graph, HG_NODE_MUL, q->a, hg_graph_number(graph, -p->number), -1);
        if (p->op == HG_NODE_NEG && q->op == HG_NODE_NEG) return hg_graph_op(graph, HG_NODE_MUL, p->a, q->a, -1);
        if (p->op == HG_NODE_NEG || q->op == HG_NODE_NEG) {
            const int product = p->op == HG_NODE_NEG ? hg_graph_op(graph, HG_NODE_MUL, p->a, b, -1)
                                                     : hg_graph_op(graph, HG_NODE_MUL, a, q->a, -1);
            return hg_graph_op(graph, HG_NODE_NEG, product, -1, -1);
        }
        /* literals and uniforms are collected: k1 (k2 x) = (k1 k2) x */
        for (int side = 0; side < 2 && graph->hoist; side++) {
            const int slow = side ? b : a, fast = side ? a : b;
            const hg_node f = graph->nodes[fast];
            if (f.op != HG_NODE_MUL || graph->nodes[slow].rate > HG_RATE_UNIFORM || f.rate <= HG_RATE_UNIFORM) continue;
            if (graph->nodes[f.a].rate <= HG_RATE_UNIFORM)
                return hg_graph_op(graph, HG_NODE_MUL, hg_graph_op(graph, HG_NODE_MUL, slow, f.a, -1), f.b, -1);
            if (graph->nodes[f.b].rate <= HG_RATE_UNIFORM)
                return hg_graph_op(graph, HG_NODE_MUL, hg_graph_op(graph, HG_NODE_MUL, slow, f.b, -1), f.a, -1);
        }
        if (p_number && q->op == HG_NODE_MUL)
            for (int side = 0; side < 2; side++) {
                const int inner = side ? q->b : q->a, other = side ? q->a : q->b;
                if (graph->nodes[inner].op == HG_NODE_NUMBER)
                    return hg_graph_op(graph, HG_NODE_MUL,
                                       hg_graph_number(graph, p->number * graph->nodes[inner].number), other, -1);
            }
        break;
    case HG_NODE_DIV:
        if (is_number(graph, b, 1)) return a;
        if (is_number(graph, a, 0)) return a;
        if (q_number && q->number != 0)
            return hg_graph_op(graph, HG_NODE_MUL, a, hg_graph_number(graph, 1 / q->number), -1);
        if (q->rate < p->rate)
            return hg_graph_op(graph, HG_NODE_MUL, a, hg_graph_op(graph, HG_NODE_DIV, hg_graph_number(graph, 1), b, -1),
                               -1);
        if (p->op == HG_NODE_NEG)
            return hg_graph_op(graph, HG_NODE_NEG, hg_graph_op(graph, HG_NODE_DIV, p->a, b, -1), -1, -1);
        break;
    case HG_NODE_NEG:
        if (p->op == HG_NODE_NEG) return p->a;
        if (p->op == HG_NODE_SUB) return hg_graph_op(graph, HG_NODE_SUB, p->b, p->a, -1);
        if (p->op == HG_NODE_MUL && graph->nodes[p->a].op == HG_NODE_NUMBER)
            return hg_graph_op(graph, HG_NODE_MUL, hg_graph_number(graph, -graph->nodes[p->a].number), p->b, -1);
        break;
    case HG_NODE_ABS:
        if (p->op == HG_NODE_NEG) return hg_graph_op(graph, HG_NODE_ABS, p->a, -1, -1);
        if (p->op == HG_NODE_ABS || p->op == HG_NODE_SQRT) return a;
        break;
    case HG_NODE_MIN:
    case HG_NODE_MAX:
        if (a == b) return a;
        break;
    case HG_NODE_LESS:
        if (a == b) return hg_graph_number(graph, 0);
        break;
    case HG_NODE_SELECT:
        if (p_number) return p->number != 0 ? b : c;
        if (b == c) return b;
        break;
    case HG_NODE_DETACH:
        if (!p->active) return a;
        break;
    default:
        break;
    }
    return -1;
}

int hg_graph_op(hg_graph *graph, hg_node_op op, int a, int b, int c)
{
    const int n = hg_node_arguments(op);
    if (graph->status != HG_OK || a < 0 || (n > 1 && b < 0) || (n > 2 && c < 0)) return -1;
    bool literal = true;
    const int arguments[3] = { a, b, c };
    for (int i = 0; i < n; i++) literal &= graph->nodes[arguments[i]].op == HG_NODE_NUMBER;
    if (literal)
        return hg_graph_number(graph, hg_node_evaluate(op, graph->nodes[a].number, n > 1 ? graph->nodes[b].number : 0,
                                                       n > 2 ? graph->nodes[c].number : 0));
    const int simpler = simplify(graph, op, a, b, c);
    if (simpler >= 0 || graph->status != HG_OK) return simpler;
    /* a number first, then the older node: so that a b and b a are one node */
    if ((op == HG_NODE_ADD || op == HG_NODE_MUL) &&
        (graph->nodes[b].op == HG_NODE_NUMBER || (graph->nodes[a].op != HG_NODE_NUMBER && b < a))) {
        const int swap = a;
        a = b;
        b = swap;
    }
    return intern(graph, (hg_node){ .op = (uint8_t)op, .a = a, .b = n > 1 ? b : -1, .c = n > 2 ? c : -1 });
}

int hg_graph_shift(hg_graph *graph, int node, int by)
{
    if (node < 0 || by == 0) return node;
    const hg_node old = graph->nodes[node];
    if (!(old.depends & HG_DEPENDS_GROOM)) return node;
    if (old.op == HG_NODE_INPUT) {
        hg_input input = old.input;
        input.offset = (int16_t)(input.offset + by);
        return hg_graph_input(graph, input);
    }
    const int n = hg_node_arguments(old.op);
    const int a = hg_graph_shift(graph, old.a, by);
    const int b = n > 1 ? hg_graph_shift(graph, old.b, by) : -1;
    const int c = n > 2 ? hg_graph_shift(graph, old.c, by) : -1;
    return hg_graph_op(graph, old.op, a, b, c);
}
