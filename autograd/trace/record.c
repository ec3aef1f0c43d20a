/* Recording: what a formula asks for and computes becomes nodes of a graph. The graph being recorded is thread-local. */
#include "autograd/trace/graph.h"

#include <stdio.h>
#include <string.h>

typedef struct {
    hg_graph *graph;
    const hg_trace_scope *scope;
    uint32_t used;
} recording;

static _Thread_local recording *current;

/* ---- recording a formula ------------------------------------------------------------------------------------ */

static const hg_scalar none = { -1 };

static void fail(const char *format, const char *name)
{
    hg_graph_fail(current->graph, HG_INVALID, format, current->scope->name, name);
}

/* Does a carried value depend on more than rest data? */
static bool beyond_rest(const hg_graph *graph, const hg_graph_carry *carry)
{
    uint8_t depends = 0;
    for (int c = 0; c < carry->width; c++)
        depends |= graph->nodes[carry->first[c]].depends | graph->nodes[carry->kept[c]].depends;
    return (depends & ~(HG_DEPENDS_GROOM | HG_DEPENDS_GROOM_STRAND)) != 0;
}

/* After a trace: was everything that is carried kept? True when it has to be traced again, because a value that was taken
 * to depend on rest data alone does not. */
static bool check_carries(hg_graph *graph, const hg_trace_scope *scope)
{
    bool again = false;
    for (int i = 0; i < graph->n_carries && graph->status == HG_OK; i++) {
        hg_graph_carry *carry = &graph->carries[i];
        if (carry->term != scope->term || !carry->carried) continue;
        if (!carry->kept_n) {
            fail("energy '%s' carries '%s' but does not keep it: the next site would have nothing", carry->name);
            continue;
        }
        if (!carry->rest || !beyond_rest(graph, carry)) continue;
        carry->rest = false;
        again = true;
    }
    return again;
}

hg_status hg_graph_trace(hg_graph *graph, hg_scalar (*formula)(void), const hg_trace_scope *scope, int *node,
                         uint32_t *used)
{
    recording recording_ = { graph, scope, 0 }, *outer = current;
    const __typeof__(graph->count) before = graph->count; /* of several traces the last one counts */
    current = &recording_;
    do {
        for (int i = 0; i < graph->n_carries; i++) graph->carries[i].carried = graph->carries[i].kept_n = 0;
        memcpy(&graph->count, &before, sizeof before);
        *node = formula().id;
    } while (check_carries(graph, scope));
    current = outer;
    if (used) *used |= recording_.used;
    if (graph->status == HG_OK && *node < 0)
        hg_graph_fail(graph, HG_INVALID, "the formula of energy '%s' returned no value", scope->name);
    if (graph->status != HG_OK) return hg_fail(graph->status, "%s", graph->message);
    return HG_OK;
}

hg_rate hg_trace_rate(hg_scalar a)
{
    return current && a.id >= 0 ? (hg_rate)current->graph->nodes[a.id].rate : HG_RATE_SITE;
}

static bool allowed(hg_input_kind kind)
{
    if (!current) return false;
    if (!(current->scope->allowed & HG_ALLOW(kind))) {
        fail("energy '%s' asks for %s, which this kind of site does not have", hg_input_name(kind));
        return false;
    }
    current->used |= HG_ALLOW(kind);
    return true;
}

static hg_scalar input(hg_input_kind kind, int offset, int component)
{
    if (!allowed(kind)) return none;
    return (hg_scalar){ hg_graph_input(current->graph, (hg_input){ kind, (int16_t)offset, (int16_t)component, 0, 0 }) };
}

/* Vertex k of the window, as an offset from its last vertex. */
static bool in_window(const char *name, int k, int *offset)
{
    if (!current) return false;
    const int window = current->scope->window;
    if (k < 0 || k >= window) {
        hg_graph_fail(current->graph, HG_INVALID, "energy '%s' asks for %s(%d), but its site has %d vertices",
                      current->scope->name, name, k, window);
        return false;
    }
    *offset = k - (window - 1);
    return true;
}

static hg_vec3 vector_input(hg_input_kind kind, int k)
{
    int offset;
    if (!in_window(hg_input_name(kind), k, &offset)) return (hg_vec3){ none, none, none };
    return (hg_vec3){ input(kind, offset, 0), input(kind, offset, 1), input(kind, offset, 2) };
}

static hg_vec3 root_input(hg_input_kind kind, int k)
{
    if (current && (k < 0 || k > 1))
        hg_graph_fail(current->graph, HG_INVALID, "energy '%s' asks for %s(%d): the root edge has vertices 0 and 1",
                      current->scope->name, hg_input_name(kind), k);
    return (hg_vec3){ input(kind, k, 0), input(kind, k, 1), input(kind, k, 2) };
}

hg_vec3 hg_trace_x(int k) { return vector_input(HG_INPUT_X, k); }

hg_vec3 hg_trace_rest(int k) { return vector_input(HG_INPUT_REST, k); }

hg_vec3 hg_trace_predicted(int k) { return vector_input(HG_INPUT_PREDICTED, k); }

hg_vec3 hg_trace_previous(int k) { return vector_input(HG_INPUT_PREVIOUS, k); }

hg_vec3 hg_trace_contact_point(int k) { return vector_input(HG_INPUT_CONTACT_POINT, k); }

hg_vec3 hg_trace_contact_normal(int k) { return vector_input(HG_INPUT_CONTACT_NORMAL, k); }

hg_vec3 hg_trace_root_x(int k) { return root_input(HG_INPUT_ROOT_X, k); }

hg_vec3 hg_trace_root_rest(int k) { return root_input(HG_INPUT_ROOT_REST, k); }

hg_quat hg_trace_root_rotation(void)
{
    const hg_input_kind kind = HG_INPUT_ROOT_ROTATION;
    return (hg_quat){ input(kind, 0, 0), { input(kind, 0, 1), input(kind, 0, 2), input(kind, 0, 3) } };
}

hg_vec3 hg_trace_root_position(void)
{
    if (current && current->scope->root_at_rest) return hg_trace_root_rest(0);
    const hg_input_kind kind = HG_INPUT_ROOT_POSITION;
    return (hg_vec3){ input(kind, 0, 0), input(kind, 0, 1), input(kind, 0, 2) };
}

/* p + R (rest - rest_root): made in the kernel unless the frame brings it, which saves reading it. */
hg_vec3 hg_trace_posed(int k)
{
    if (current && current->scope->posed_given) return vector_input(HG_INPUT_POSED, k);
    if (current) current->used |= HG_ALLOW(HG_INPUT_POSED);
    const hg_vec3 arm = hg_trace_vec3_sub(hg_trace_rest(k), hg_trace_root_rest(0));
    return hg_trace_vec3_add(hg_trace_root_position(), hg_trace_quat_rotate(hg_trace_root_rotation(), arm));
}

hg_scalar hg_trace_contact_distance(int k)
{
    return hg_trace_vec3_dot(hg_trace_contact_normal(k), hg_trace_vec3_sub(hg_trace_x(k), hg_trace_contact_point(k)));
}

hg_scalar hg_trace_mass(int k)
{
    int offset;
    if (!in_window("mass", k, &offset)) return (hg_scalar){ -1 };
    return input(HG_INPUT_MASS, offset, 0);
}

/* The number of a name in a table of the graph, added where it is new; -1 with an error. */
static int name_number(char **names, int *n, const char *name, const char *what)
{
    int i = 0;
    while (i < *n && strcmp(names[i], name) != 0) i++;
    if (i < *n) return i;
    if (i == HG_GRAPH_ATTRIBUTES) {
        hg_graph_fail(current->graph, HG_INVALID, "energy '%s': more than %d %s", current->scope->name,
                      HG_GRAPH_ATTRIBUTES, what);
        return -1;
    }
    if (!(names[i] = hg_strdup(name))) {
        hg_graph_fail(current->graph, HG_MEMORY, "out of memory while tracing");
        return -1;
    }
    return (*n)++;
}

hg_scalar hg_trace_attribute(const char *name, int k)
{
    int offset;
    if (!in_window("attribute", k, &offset) || !allowed(HG_INPUT_ATTRIBUTE)) return none;
    hg_graph *graph = current->graph;
    const int i = name_number(graph->attributes, &graph->n_attributes, name, "groom attributes");
    if (i < 0) return none;
    return (hg_scalar){ hg_graph_input(graph, (hg_input){ HG_INPUT_ATTRIBUTE, (int16_t)offset, 0, (int16_t)i, 0 }) };
}

hg_scalar hg_trace_strand_length(void) { return hg_trace_attribute("strand_length", 0); }

/* Edge k of the window lies between its vertices k and k + 1: offset is that of the first one. */
hg_quat hg_trace_q(int k)
{
    const hg_quat nothing = { none, { none, none, none } };
    if (!current || !allowed(HG_INPUT_Q)) return nothing;
    const int edges = current->scope->window - 1;
    if (k < 0 || k >= edges) {
        hg_graph_fail(current->graph, HG_INVALID, "energy '%s' asks for q(%d), but its site has %d edges",
                      current->scope->name, k, edges);
        return nothing;
    }
    const hg_input_kind kind = HG_INPUT_Q;
    const int offset = k - edges;
    return (hg_quat){ input(kind, offset, 0),
                      { input(kind, offset, 1), input(kind, offset, 2), input(kind, offset, 3) } };
}

static void frame_input(const char *name, int k, int width, hg_scalar *out)
{
    int offset;
    for (int c = 0; c < width; c++) out[c] = none;
    if (!in_window(width == 3 ? "frame_vec3" : "frame_scalar", k, &offset) || !allowed(HG_INPUT_FRAME)) return;
    hg_graph *graph = current->graph;
    const int known = graph->n_frames,
              i = name_number(graph->frames, &graph->n_frames, name, "named arrays of the frame");
    if (i < 0) return;
    if (i == known) graph->frame_width[i] = width;
    if (graph->frame_width[i] != width) {
        fail("energy '%s' reads '%s' as scalars and as vectors; one name is one array", name);
        return;
    }
    for (int c = 0; c < width; c++)
        out[c].id = hg_graph_input(graph, (hg_input){ HG_INPUT_FRAME, (int16_t)offset, (int16_t)c, (int16_t)i, 0 });
}

hg_scalar hg_trace_frame_scalar(const char *name, int k)
{
    hg_scalar out;
    frame_input(name, k, 1, &out);
    return out;
}

hg_vec3 hg_trace_frame_vec3(const char *name, int k)
{
    hg_scalar out[3];
    frame_input(name, k, 3, out);
    return (hg_vec3){ out[0], out[1], out[2] };
}

hg_scalar hg_trace_distance(void) { return input(HG_INPUT_DISTANCE, 0, 0); }

hg_scalar hg_trace_rest_distance(void) { return input(HG_INPUT_REST_DISTANCE, 0, 0); }

hg_scalar hg_trace_field(void) { return input(HG_INPUT_FIELD, 0, 0); }

hg_scalar hg_trace_field_rest(void) { return input(HG_INPUT_FIELD_REST, 0, 0); }

hg_scalar hg_trace_dt(void) { return input(HG_INPUT_DT, 0, 0); }

static hg_scalar param_of(const char *name)
{
    if (!current) return (hg_scalar){ -1 };
    const hg_trace_scope *scope = current->scope;
    for (int i = 0; i < scope->n_params; i++) {
        if (strcmp(scope->params[i], name) != 0) continue;
        current->used |= HG_ALLOW(HG_INPUT_PARAM);
        return (hg_scalar){ hg_graph_input(current->graph,
                                           (hg_input){ HG_INPUT_PARAM, 0, 0, (int16_t)i, (int16_t)scope->term }) };
    }
    const char *near = hg_nearest_of(name, scope->params, scope->n_params);
    hg_graph_fail(current->graph, HG_INVALID, "energy '%s' asks for param '%s', which it does not declare%s%s%s",
                  scope->name, name, near ? "; did it mean '" : "", near ? near : "", near ? "'?" : "");
    return (hg_scalar){ -1 };
}

hg_scalar hg_trace_param(const char *name) { return param_of(name); }

hg_vec3 hg_trace_param3(const char *name)
{
    char part[64];
    hg_scalar component[3];
    for (int i = 0; i < 3; i++) {
        snprintf(part, sizeof part, "%s.%c", name, "xyz"[i]);
        component[i] = param_of(part);
    }
    return (hg_vec3){ component[0], component[1], component[2] };
}

bool hg_trace_option(const char *name, const char *choice)
{
    if (!current) return false;
    const hg_trace_scope *scope = current->scope;
    for (int i = 0; i < scope->n_options; i++)
        if (strcmp(scope->options[i], name) == 0) return strcmp(scope->choices[i], choice) == 0;
    hg_graph_fail(current->graph, HG_INVALID, "energy '%s' asks for option '%s', which it does not declare",
                  scope->name, name);
    return false;
}

/* ---- values that go from site to site ----------------------------------------------------------------------- */

static hg_graph_carry *find_carry(const char *name)
{
    hg_graph *graph = current->graph;
    for (int i = 0; i < graph->n_carries; i++)
        if (graph->carries[i].term == current->scope->term && strcmp(graph->carries[i].name, name) == 0)
            return &graph->carries[i];
    return NULL;
}

static void carry(const char *name, int width, const hg_scalar *first, hg_scalar *out)
{
    for (int c = 0; c < width; c++) out[c] = none;
    if (!allowed(HG_INPUT_CARRY)) return;
    hg_graph *graph = current->graph;
    hg_graph_carry *found = find_carry(name);
    if (!found) {
        if (graph->n_carries == HG_GRAPH_CARRIES) {
            hg_graph_fail(graph, HG_INVALID, "energy '%s' carries '%s': more than %d values are carried",
                          current->scope->name, name, HG_GRAPH_CARRIES);
            return;
        }
        found = &graph->carries[graph->n_carries];
        *found =
            (hg_graph_carry){ .name = hg_strdup(name), .term = current->scope->term, .width = width, .rest = true };
        if (!found->name) {
            hg_graph_fail(graph, HG_MEMORY, "out of memory while tracing");
            return;
        }
        graph->n_carries++;
    }
    if (found->carried || found->width != width) {
        fail("energy '%s' carries '%s' twice; each name is carried once", name);
        return;
    }
    found->carried = 1;
    for (int c = 0; c < width; c++) {
        if (first[c].id < 0) return;
        found->first[c] = first[c].id;
        const hg_input_kind kind = found->rest ? HG_INPUT_REST_CARRY : HG_INPUT_CARRY;
        const hg_input in = { kind, 0, (int16_t)c, (int16_t)(found - graph->carries), 0 };
        out[c] = current->scope->first_site && !found->rest ? first[c] : (hg_scalar){ hg_graph_input(graph, in) };
    }
}

static void keep(const char *name, int width, const hg_scalar *value)
{
    if (!allowed(HG_INPUT_CARRY)) return;
    hg_graph_carry *found = find_carry(name);
    if (!found || !found->carried || found->width != width) {
        fail(found && found->carried ? "energy '%s' keeps '%s' as something else than it carries"
                                     : "energy '%s' keeps '%s' but does not carry it",
             name);
        return;
    }
    if (found->kept_n) {
        fail("energy '%s' keeps '%s' twice; each name is kept once", name);
        return;
    }
    for (int c = 0; c < width; c++) {
        if (value[c].id < 0) return;
        found->kept[c] = value[c].id;
    }
    found->kept_n = 1;
}

hg_scalar hg_trace_carry_scalar(const char *name, hg_scalar first)
{
    hg_scalar out;
    carry(name, 1, &first, &out);
    return out;
}

hg_vec3 hg_trace_carry_vec3(const char *name, hg_vec3 first)
{
    hg_scalar out[3];
    carry(name, 3, (hg_scalar[]){ first.x, first.y, first.z }, out);
    return (hg_vec3){ out[0], out[1], out[2] };
}

hg_quat hg_trace_carry_quat(const char *name, hg_quat first)
{
    hg_scalar out[4];
    carry(name, 4, (hg_scalar[]){ first.w, first.v.x, first.v.y, first.v.z }, out);
    return (hg_quat){ out[0], { out[1], out[2], out[3] } };
}

void hg_trace_keep_scalar(const char *name, hg_scalar value) { keep(name, 1, &value); }

void hg_trace_keep_vec3(const char *name, hg_vec3 value) { keep(name, 3, (hg_scalar[]){ value.x, value.y, value.z }); }

void hg_trace_keep_quat(const char *name, hg_quat value)
{
    keep(name, 4, (hg_scalar[]){ value.w, value.v.x, value.v.y, value.v.z });
}

/* ---- scalars ------------------------------------------------------------------------------------------------ */

static hg_scalar record(hg_node_op op, hg_scalar a, hg_scalar b, hg_scalar c)
{
    if (!current) return none;
    hg_graph *graph = current->graph;
    const int before = graph->n, node = hg_graph_op(graph, op, a.id, b.id, c.id);
    if (node < 0) return none;
    graph->count.asked++;
    if (graph->nodes[node].op == HG_NODE_NUMBER)
        graph->count.folded++;
    else if (node < before && graph->nodes[node].op == op && node != a.id)
        graph->count.shared++;
    else if (node < before)
        graph->count.simplified++;
    return (hg_scalar){ node };
}

hg_scalar hg_trace_number(double value) { return (hg_scalar){ current ? hg_graph_number(current->graph, value) : -1 }; }

hg_scalar hg_trace_add2(hg_scalar a, hg_scalar b) { return record(HG_NODE_ADD, a, b, none); }

hg_scalar hg_trace_sub(hg_scalar a, hg_scalar b) { return record(HG_NODE_SUB, a, b, none); }

hg_scalar hg_trace_mul2(hg_scalar a, hg_scalar b) { return record(HG_NODE_MUL, a, b, none); }

hg_scalar hg_trace_div(hg_scalar a, hg_scalar b) { return record(HG_NODE_DIV, a, b, none); }

hg_scalar hg_trace_neg(hg_scalar a) { return record(HG_NODE_NEG, a, none, none); }

hg_scalar hg_trace_sqrt(hg_scalar a) { return record(HG_NODE_SQRT, a, none, none); }

hg_scalar hg_trace_rsqrt(hg_scalar a) { return record(HG_NODE_RSQRT, a, none, none); }

hg_scalar hg_trace_abs(hg_scalar a) { return record(HG_NODE_ABS, a, none, none); }

hg_scalar hg_trace_exp(hg_scalar a) { return record(HG_NODE_EXP, a, none, none); }

hg_scalar hg_trace_log(hg_scalar a) { return record(HG_NODE_LOG, a, none, none); }

hg_scalar hg_trace_sin(hg_scalar a) { return record(HG_NODE_SIN, a, none, none); }

hg_scalar hg_trace_cos(hg_scalar a) { return record(HG_NODE_COS, a, none, none); }

hg_scalar hg_trace_atan2(hg_scalar y, hg_scalar x) { return record(HG_NODE_ATAN2, y, x, none); }

hg_scalar hg_trace_min(hg_scalar a, hg_scalar b) { return record(HG_NODE_MIN, a, b, none); }

hg_scalar hg_trace_max(hg_scalar a, hg_scalar b) { return record(HG_NODE_MAX, a, b, none); }

hg_scalar hg_trace_less(hg_scalar a, hg_scalar b) { return record(HG_NODE_LESS, a, b, none); }

hg_scalar hg_trace_select(hg_scalar condition, hg_scalar a, hg_scalar b)
{
    return record(HG_NODE_SELECT, condition, a, b);
}

hg_scalar hg_trace_detach(hg_scalar a) { return record(HG_NODE_DETACH, a, none, none); }
