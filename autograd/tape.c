/* The tape: recording, the backward walk, detached and gradient-free scopes, and the drawing of it. */
#include "autograd/tape.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* A call and the versions that its tensors had when it was recorded. */
typedef struct {
    hg_call call;
    bool differentiable; /* false: recorded for export only */
    uint32_t in_version[HG_OP_INPUTS], out_version, saved_version[4];
} record;

typedef struct {
    record **records;
    int n, capacity;
    int no_grad;
    bool all, trap;
    const char *trap_path;
    hg_ctx *host;         /* where HAIRGRAD_VALIDATE runs everything again; NULL: not wanted */
    hg_node *leaves;      /* owned tensors, until they are destroyed */
    hg_node *step_leaves; /* leaves made in this step */
    hg_index_known *indices;
} tape;

/* ---- life ---- */

static void drop_records(hg_ctx *ctx)
{
    tape *t = *hg_ctx_tape(ctx);
    t->n = 0;
    t->step_leaves = NULL;
    for (hg_node *leaf = t->leaves; leaf; leaf = leaf->next) leaf->producer = -1;
}

static void free_tape(hg_ctx *ctx)
{
    tape *t = *hg_ctx_tape(ctx);
    if (t) {
        hg_free(t->records);
        hg_ctx_destroy(t->host);
    }
    hg_free(t);
    *hg_ctx_tape(ctx) = NULL;
}

static void free_leaf(hg_tensor *tensor)
{
    hg_node *node = tensor->tape;
    tape *t = *hg_ctx_tape(tensor->ctx);
    hg_index_forget(&t->indices, tensor);
    if (!node) return;
    for (hg_node **at = &t->leaves; *at; at = &(*at)->next)
        if (*at == node) {
            *at = node->next;
            break;
        }
    tensor->tape = NULL;
    hg_tensor_destroy(node->grad);
    hg_free(node);
}

static tape *tape_of(hg_ctx *ctx)
{
    void **slot = hg_ctx_tape(ctx);
    if (*slot) return *slot;
    tape *t = hg_alloc(1, sizeof *t);
    if (!t) {
        hg_ctx_fail(ctx, HG_MEMORY, "out of memory: the tape");
        return NULL;
    }
    if (hg_validate_wanted(ctx) && hg_ctx_create(&t->host, &(hg_ctx_options){ .device = "cpu" }) != HG_OK) {
        hg_free(t);
        hg_ctx_fail(ctx, HG_MEMORY, "%s", hg_message());
        return NULL;
    }
    *slot = t;
    hg_ctx_on_reset(ctx, drop_records);
    hg_ctx_on_destroy(ctx, free_tape);
    hg_ctx_on_tensor_destroy(ctx, free_leaf);
    return t;
}

hg_index_known **hg_tape_indices(hg_ctx *ctx) { return &((tape *)*hg_ctx_tape(ctx))->indices; } /* inside a call */

/* ---- leaves and gradients ---- */

hg_status hg_require_grad(hg_tensor *leaf)
{
    char text[96];
    if (!leaf) return hg_fail(HG_INVALID, "hg_require_grad: the tensor is NULL");
    if (leaf->tape) return HG_OK;
    if (!hg_is_float(leaf))
        return hg_ctx_fail(leaf->ctx, HG_INVALID, "hg_require_grad: %s: only f32 and f64 have gradients",
                           hg_shape_text(leaf, text));
    tape *t = tape_of(leaf->ctx);
    if (!t) return HG_MEMORY;
    hg_node *node = leaf->owned ? hg_alloc(1, sizeof *node) : hg_step_alloc(leaf->ctx, sizeof *node);
    if (!node) return hg_ctx_fail(leaf->ctx, HG_MEMORY, "out of memory: a gradient");
    *node = (hg_node){ .tensor = leaf, .producer = -1 };
    node->grad = (leaf->owned ? hg_tensor_create : hg_tensor_make)(leaf->ctx, leaf->dtype, leaf->rank, leaf->shape);
    if (!node->grad || hg_tensor_fill(node->grad, 0) != HG_OK) {
        if (leaf->owned) {
            hg_tensor_destroy(node->grad);
            hg_free(node);
        }
        return HG_MEMORY;
    }
    node->grad->name = leaf->name;
    hg_node **list = leaf->owned ? &t->leaves : &t->step_leaves;
    node->next = *list;
    *list = node;
    leaf->tape = node;
    return HG_OK;
}

bool hg_needs_grad(const hg_tensor *tensor) { return tensor && tensor->tape; }

hg_tensor *hg_grad(const hg_tensor *tensor)
{
    hg_node *node = tensor ? tensor->tape : NULL;
    if (!node || !node->grad) return NULL;
    if (node->stale) {
        node->stale = false;
        hg_tensor_fill(node->grad, 0);
    }
    return node->grad;
}

void *hg_grad_data(hg_tensor *tensor, bool *fresh)
{
    hg_node *node = tensor->tape;
    *fresh = node->stale;
    node->stale = false;
    hg_tensor_touch(node->grad);
    return node->grad->data;
}

void hg_no_grad_begin(hg_ctx *ctx)
{
    tape *t = tape_of(ctx);
    if (t) t->no_grad++;
}

void hg_no_grad_end(hg_ctx *ctx)
{
    tape *t = tape_of(ctx);
    if (t && t->no_grad > 0) t->no_grad--;
}

/* ---- recording ---- */

hg_tensor *hg_refuse(const hg_call *call, const char *format, ...)
{
    hg_text text = { 0 };
    char shape[96], sentence[400];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(sentence, sizeof sentence, format, arguments);
    va_end(arguments);
    hg_text_add(&text, "%s: %s; inputs", call->op->name, sentence);
    for (int i = 0; i < call->n_in; i++) hg_text_add(&text, "%s %s", i ? "," : "", hg_shape_text(call->in[i], shape));
    hg_ctx_fail(call->ctx, HG_INVALID, "%s", text.failed ? sentence : text.data);
    hg_text_free(&text);
    return NULL;
}

/* A view changes when what it looks into changes: hg_tensor_touch goes down the same chain. */
static uint32_t version_of(const hg_tensor *tensor)
{
    uint32_t version = 0;
    for (; tensor; tensor = tensor->base) version += tensor->version;
    return version;
}

bool hg_call_recorded(const hg_call *call)
{
    const tape *t = *hg_ctx_tape(call->ctx);
    if (t->no_grad || call->op->not_differentiable) return false;
    for (int i = 0; i < call->n_in; i++)
        if (hg_needs_grad(call->in[i])) return true;
    return false;
}

/* What a call reads and writes if it touches every tensor once; a backward reads what forward did and writes gradients. */
static int64_t bytes_of(const hg_call *call, bool backward)
{
    size_t bytes = hg_tensor_bytes(call->out);
    for (int i = 0; i < call->n_in; i++)
        if (call->in[i]) bytes += hg_tensor_bytes(call->in[i]) * (backward && hg_needs_grad(call->in[i]) ? 2 : 1);
    for (int i = 0; i < 4; i++)
        if (call->saved[i]) bytes += hg_tensor_bytes(call->saved[i]);
    return (int64_t)bytes;
}

static bool append(hg_ctx *ctx, tape *t, record *r)
{
    if (t->n == t->capacity) {
        int capacity = t->capacity ? 2 * t->capacity : 64;
        record **records = hg_resize(t->records, (size_t)t->capacity, (size_t)capacity, sizeof *records);
        if (!records) {
            hg_ctx_fail(ctx, HG_MEMORY, "out of memory: the tape of %d calls", capacity);
            return false;
        }
        t->records = records;
        t->capacity = capacity;
    }
    t->records[t->n++] = r;
    return true;
}

static bool inputs_are_usable(hg_call *call, int n_in, hg_tensor *const *in)
{
    const hg_op *op = call->op;
    if (n_in < op->min_in || n_in > op->max_in || n_in > HG_OP_INPUTS) {
        hg_ctx_fail(call->ctx, HG_INVALID, "%s: %d inputs, it takes %d to %d", op->name, n_in, op->min_in, op->max_in);
        return false;
    }
    for (int i = 0; i < n_in; i++) {
        call->in[i] = in[i];
        if (in[i] && in[i]->ctx != call->ctx) {
            hg_ctx_fail(call->ctx, HG_INVALID, "%s: input %d belongs to another context", op->name, i);
            return false;
        }
    }
    call->n_in = n_in;
    for (int i = 0; i < op->min_in; i++)
        if (!in[i]) {
            hg_refuse(call, "input %d is NULL", i);
            return false;
        }
    return true;
}

hg_tensor *hg_apply(hg_ctx *ctx, const hg_op *op, int n_in, hg_tensor *const *in, const void *attributes)
{
    tape *t = ctx ? tape_of(ctx) : NULL;
    if (!t || hg_ctx_status(ctx) != HG_OK) return NULL;
    record *r = hg_step_alloc(ctx, sizeof *r);
    if (!r) return NULL;
    *r = (record){ .call = { .ctx = ctx, .op = op } };
    hg_call *call = &r->call;
    call->file = hg_ctx_caller(ctx, &call->line);
    if (!inputs_are_usable(call, n_in, in)) return NULL;
    if (op->attributes_size) {
        call->attributes = hg_step_alloc(ctx, op->attributes_size);
        if (!call->attributes) return NULL;
        memcpy(call->attributes, attributes, op->attributes_size);
    }
    r->differentiable = hg_call_recorded(call);
    if (r->differentiable && !op->backward)
        return hg_refuse(call, "it has no backward and cannot take a tensor that needs a gradient; detach it first");
    call->out = op->shape(call);
    if (!call->out) return hg_ctx_status(ctx) == HG_OK ? hg_refuse(call, "its shape check failed") : NULL;
    const bool counted = hg_profiling(ctx);
    if (counted) hg_profile_begin(ctx, "forward", op->name);
    hg_status status = op->forward(call);
    if (counted) hg_profile_end(ctx, bytes_of(call, false));
    if (status != HG_OK) {
        if (hg_ctx_status(ctx) == HG_OK) hg_ctx_fail(ctx, status, "%s: %s", op->name, hg_message());
        return NULL;
    }
    if (t->trap && hg_trap_check(call, false, t->trap_path) != HG_OK) return NULL;
    if (t->host && hg_validate_forward(t->host, call) != HG_OK) return NULL;
    if (!r->differentiable && !t->all) return call->out;
    for (int i = 0; i < n_in; i++) r->in_version[i] = version_of(call->in[i]);
    for (int i = 0; i < 4; i++) r->saved_version[i] = version_of(call->saved[i]);
    r->out_version = version_of(call->out);
    if (r->differentiable) {
        hg_node *node = hg_step_alloc(ctx, sizeof *node);
        if (!node) return NULL;
        *node = (hg_node){ .tensor = call->out, .producer = t->n };
        call->out->tape = node;
    }
    return append(ctx, t, r) ? call->out : NULL;
}

int hg_tape_count(const hg_ctx *ctx)
{
    const tape *t = *hg_ctx_tape((hg_ctx *)ctx);
    return t ? t->n : 0;
}

const hg_call *hg_tape_call(const hg_ctx *ctx, int i)
{
    const tape *t = *hg_ctx_tape((hg_ctx *)ctx);
    return t && i >= 0 && i < t->n ? &t->records[i]->call : NULL;
}

void hg_tape_record_all(hg_ctx *ctx, bool on)
{
    tape *t = tape_of(ctx);
    if (t) t->all = on;
}

void hg_trap_nan(hg_ctx *ctx, bool on, const char *path)
{
    tape *t = tape_of(ctx);
    if (!t) return;
    t->trap = on;
    t->trap_path = path;
}

bool hg_trap_is_on(const hg_ctx *ctx, const char **path)
{
    const tape *t = *hg_ctx_tape((hg_ctx *)ctx);
    if (path) *path = t && t->trap ? t->trap_path : NULL;
    return t && t->trap;
}

/* ---- backward ---- */

static const char *maker_of(const tape *t, const hg_tensor *tensor)
{
    for (int i = t->n; i-- > 0;)
        if (t->records[i]->call.out == tensor) return t->records[i]->call.op->name;
    return tensor->owned ? "the caller" : "an unrecorded call";
}

static hg_status overwritten(const tape *t, const record *r, const char *role, int i, const hg_tensor *tensor)
{
    char text[96];
    const hg_call *call = &r->call;
    return hg_ctx_fail(
        call->ctx, HG_INVALID,
        "backward of %s (recorded at %s:%d): its %s %d%s%s, %s, made by %s, was overwritten after %s saved "
        "it; make a copy first, or overwrite it after the backward pass",
        call->op->name, call->file ? call->file : "?", call->line, role, i, tensor->name ? " " : "",
        tensor->name ? tensor->name : "", hg_shape_text(tensor, text), maker_of(t, tensor), call->op->name);
}

static hg_status check_versions(const tape *t, const record *r)
{
    const hg_call *call = &r->call;
    for (int i = 0; i < call->n_in; i++)
        if (r->in_version[i] != version_of(call->in[i])) return overwritten(t, r, "input", i, call->in[i]);
    for (int i = 0; i < 4; i++)
        if (r->saved_version[i] != version_of(call->saved[i]))
            return overwritten(t, r, "saved tensor", i, call->saved[i]);
    if (r->out_version != version_of(call->out)) return overwritten(t, r, "output", 0, call->out);
    return HG_OK;
}

static void mark_stale(const tape *t)
{
    for (hg_node *leaf = t->leaves; leaf; leaf = leaf->next) leaf->stale = true;
    for (hg_node *leaf = t->step_leaves; leaf; leaf = leaf->next) leaf->stale = true;
    for (int i = 0; i < t->n; i++) {
        hg_node *node = t->records[i]->call.out->tape;
        if (node) node->stale = true;
    }
}

/* What no call reached has a gradient of zero. */
static void zero_stale(const tape *t)
{
    for (hg_node *leaf = t->leaves; leaf; leaf = leaf->next) hg_grad(leaf->tensor);
    for (hg_node *leaf = t->step_leaves; leaf; leaf = leaf->next) hg_grad(leaf->tensor);
    for (int i = 0; i < t->n; i++) hg_grad(t->records[i]->call.out);
}

static hg_status make_gradient(hg_tensor *tensor)
{
    hg_node *node = tensor->tape;
    if (node->grad) return HG_OK;
    node->grad = hg_tensor_make(tensor->ctx, tensor->dtype, tensor->rank, tensor->shape);
    node->stale = true;
    return node->grad ? HG_OK : HG_MEMORY;
}

static hg_status walk(tape *t, hg_tensor *out)
{
    for (int i = ((hg_node *)out->tape)->producer; i >= 0; i--) {
        const record *r = t->records[i];
        const hg_node *node = r->call.out->tape;
        if (!r->differentiable || !node->grad || node->stale) continue;
        HG_TRY(check_versions(t, r));
        for (int j = 0; j < r->call.n_in; j++)
            if (hg_needs_grad(r->call.in[j])) HG_TRY(make_gradient(r->call.in[j]));
        hg_call call = r->call; /* a backward cannot change what was recorded */
        double *before[HG_OP_INPUTS];
        if (t->host) HG_TRY(hg_validate_before(t->host, &call, before));
        const bool counted = hg_profiling(call.ctx);
        if (counted) hg_profile_begin(call.ctx, "backward", call.op->name);
        hg_status status = call.op->backward(&call);
        if (counted) hg_profile_end(call.ctx, bytes_of(&call, true));
        if (status == HG_OK && t->trap) HG_TRY(hg_trap_check(&call, true, t->trap_path));
        if (status == HG_OK && t->host) status = hg_validate_backward(t->host, &call, before);
        if (status != HG_OK)
            return hg_ctx_fail(call.ctx, status, "backward of %s (recorded at %s:%d): %s", call.op->name,
                               call.file ? call.file : "?", call.line, hg_message());
    }
    return HG_OK;
}

hg_status hg_backward_seeded(hg_ctx *ctx, hg_tensor *out, const hg_tensor *seed)
{
    char a[96], b[96];
    HG_TRY(hg_ctx_status(ctx));
    if (!out) return hg_ctx_fail(ctx, HG_INVALID, "backward: the output is NULL");
    if (!hg_needs_grad(out))
        return hg_ctx_fail(ctx, HG_INVALID,
                           "backward: %s does not depend on a tensor that needs a gradient "
                           "(hg_require_grad before the formula, outside of a no-grad scope)",
                           hg_shape_text(out, a));
    if (seed && (seed->dtype != out->dtype || hg_tensor_count(seed) != hg_tensor_count(out)))
        return hg_ctx_fail(ctx, HG_INVALID, "backward: the seed is %s, the output %s", hg_shape_text(seed, a),
                           hg_shape_text(out, b));
    if (!seed && hg_tensor_count(out) != 1)
        return hg_ctx_fail(ctx, HG_INVALID, "backward: the loss has to be one element, not %s; sum it first",
                           hg_shape_text(out, a));
    tape *t = tape_of(ctx);
    if (!t) return HG_MEMORY;
    mark_stale(t);
    hg_status status = make_gradient(out);
    if (status == HG_OK) {
        ((hg_node *)out->tape)->stale = false;
        hg_tensor *grad = hg_grad(out);
        status = seed ? hg_tensor_copy(grad, seed) : hg_tensor_fill(grad, 1);
    }
    if (status == HG_OK) status = walk(t, out);
    zero_stale(t);
    return status;
}

hg_status hg_backward(hg_ctx *ctx, hg_tensor *loss) { return (hg_backward_seeded)(ctx, loss, NULL); }

/* ---- drawing ---- */

static double norm_of(const hg_tensor *tensor)
{
    double sum = 0;
    const int64_t n = hg_tensor_count(tensor);
    double *x = hg_alloc((size_t)n + 1, sizeof *x);
    if (!x || hg_tensor_numbers(tensor, x) != HG_OK) sum = (double)NAN;
    for (int64_t i = 0; x && i < n; i++) sum += x[i] * x[i];
    hg_free(x);
    return sqrt(sum);
}

/* What a tensor is called in the drawing, the same in every run: by the call that made it, or that first read it. */
typedef struct {
    int call, input; /* input -1: the call's output */
} drawn;

static drawn find_drawn(const tape *t, const hg_tensor *tensor, int before)
{
    for (int i = before; i-- > 0;)
        if (t->records[i]->call.out == tensor) return (drawn){ i, -1 };
    for (int i = 0; i < t->n; i++)
        for (int j = 0; j < t->records[i]->call.n_in; j++)
            if (t->records[i]->call.in[j] == tensor) return (drawn){ i, j };
    return (drawn){ before, -1 };
}

static void draw_name(hg_text *dot, drawn d)
{
    if (d.input < 0)
        hg_text_add(dot, "call%d", d.call);
    else
        hg_text_add(dot, "call%d_input%d", d.call, d.input);
}

static void draw_leaf(hg_text *dot, drawn d, const hg_tensor *tensor)
{
    char shape[96];
    hg_text_add(dot, "  ");
    draw_name(dot, d);
    hg_text_add(dot, " [shape=%s label=\"%s\\n%s", tensor->owned ? "box" : "ellipse",
                tensor->name            ? tensor->name
                : hg_needs_grad(tensor) ? "leaf"
                                        : "constant",
                hg_shape_text(tensor, shape));
    if (hg_grad(tensor)) hg_text_add(dot, "\\n|gradient| %.3g", norm_of(hg_grad(tensor)));
    hg_text_add(dot, "\"];\n");
}

hg_status hg_graph_dot(hg_ctx *ctx, hg_text *dot)
{
    const tape *t = tape_of(ctx);
    char shape[96];
    if (!t) return HG_MEMORY;
    hg_text_add(dot, "digraph tape {\n  rankdir=TB; node [fontname=\"sans-serif\" fontsize=10];\n");
    for (int i = 0; i < t->n; i++) {
        const hg_call *call = &t->records[i]->call;
        hg_text_add(dot, "  call%d [shape=record label=\"{%s|%s", i, call->op->name, hg_shape_text(call->out, shape));
        if (hg_grad(call->out)) hg_text_add(dot, "|gradient %.3g", norm_of(hg_grad(call->out)));
        hg_text_add(dot, "}\"];\n");
        for (int j = 0; j < call->n_in; j++) {
            if (!call->in[j]) continue;
            const drawn d = find_drawn(t, call->in[j], i);
            if (d.input == j && d.call == i) draw_leaf(dot, d, call->in[j]);
            hg_text_add(dot, "  ");
            draw_name(dot, d);
            hg_text_add(dot, " -> call%d [label=\"%d\" fontsize=8];\n", i, j);
        }
    }
    hg_text_add(dot, "}\n");
    return dot->failed ? hg_fail(HG_MEMORY, "out of memory: the drawing of the tape") : HG_OK;
}
