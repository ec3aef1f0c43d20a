/* Energies on arrays of a file: value and gradients, to be held against other programs. The energies are evaluated as in
 * training, by a physics on the tape; no energy is known here by name. */
#include "hairloss/loss.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* ---- with respect to what ------------------------------------------------------------------------------------ */

/* What can be asked for: everything read that is a number, by the name to write. */
static bool is_differentiable(const loss *l, const loss_array *a)
{
    (void)l;
    return strcmp(a->name, "rest_body_vertices") != 0;
}

static hg_status unknown_name(loss *l, const char *name)
{
    const char *names[LOSS_ARRAYS];
    int n = 0;
    hg_text all = { 0 };
    for (int i = 0; i < l->n_arrays; i++)
        if (is_differentiable(l, &l->array[i])) names[n++] = l->array[i].name;
    for (int i = 0; i < n; i++) hg_text_add(&all, "%s%s", i ? ", " : "", names[i]);
    const char *near = hg_nearest_of(name, names, n);
    const hg_status status =
        hg_fail(HG_INVALID, "--wrt %s: %s%s reads nothing of that name here%s%s%s; it reads %s", name,
                l->term[0].energy->name, l->n_terms > 1 ? "+..." : "", near ? "; did you mean \"" : "",
                near ? near : "", near ? "\"?" : "", all.data ? all.data : "nothing");
    hg_text_free(&all);
    return status;
}

/* Roots that are not turned, to be differentiated by. */
static loss_array *identity_rotations(loss *l)
{
    loss_array *a = loss_add(l, "root_rotation");
    if (!a) return NULL;
    const int64_t shape[3] = { l->size['b' - 'a'], l->data.strands, 4 };
    snprintf(a->axes, sizeof a->axes, "bs4");
    a->rank = 3;
    memcpy(a->shape, shape, sizeof shape);
    a->count = shape[0] * shape[1] * 4;
    a->values = hg_alloc((size_t)a->count + 1, sizeof *a->values);
    for (int64_t i = 0; a->values && i < a->count; i += 4) a->values[i] = 1;
    return a->values ? a : NULL;
}

typedef struct {
    int n;
    loss_array *array[LOSS_ARRAYS];
    char *name[LOSS_ARRAYS]; /* as asked for: the gradient is grad_NAME */
} wishes;

static hg_status wish(loss *l, wishes *w, const char *name)
{
    loss_array *a = loss_find(l, name);
    if (!a && strcmp(name, "root_rotation") == 0 && l->reads.kinds & HG_ALLOW(HG_INPUT_ROOT_ROTATION)) {
        a = identity_rotations(l);
        if (!a) return HG_MEMORY;
    }
    if (!a || !is_differentiable(l, a)) return unknown_name(l, name);
    for (int i = 0; i < w->n; i++)
        if (w->array[i] == a) return HG_OK;
    if (w->n == LOSS_ARRAYS) return hg_fail(HG_INVALID, "--wrt: more than %d names", LOSS_ARRAYS);
    w->array[w->n] = a;
    w->name[w->n] = loss_keep(l, hg_format("grad_%s", name));
    return w->name[w->n++] ? HG_OK : HG_MEMORY;
}

/* x always, where it is there; and what was asked for. Without x and without a wish: the arrays of the frame. */
static hg_status read_wishes(loss *l, wishes *w, const char *wrt)
{
    *w = (wishes){ 0 };
    if (l->has_x) HG_TRY(wish(l, w, "x"));
    if (!wrt || !*wrt) {
        for (int i = 0; !l->has_x && i < l->reads.n_frame; i++)
            if (loss_find(l, l->reads.frame[i])) HG_TRY(wish(l, w, l->reads.frame[i]));
        if (!l->has_x && loss_find(l, "q")) HG_TRY(wish(l, w, "q"));
        return HG_OK;
    }
    for (const char *at = wrt;; at++) {
        char name[128];
        at += strspn(at, " ");
        const size_t length = strcspn(at, ",");
        snprintf(name, sizeof name, "%.*s", (int)length, at);
        for (size_t end = strlen(name); end > 0 && name[end - 1] == ' '; end--) name[end - 1] = 0;
        HG_TRY(wish(l, w, name));
        at += length;
        if (!*at) return HG_OK;
    }
}

/* ---- evaluation ---------------------------------------------------------------------------------------------- */

static hg_status evaluate(loss *l, hg_physics *physics, const wishes *w, double *unweighted)
{
    loss_array *x = l->has_x ? loss_find(l, "x") : NULL;
    hg_tensor *at = x ? x->tensor[0] : NULL;
    if (!at) { /* nobody reads it */
        const int64_t shape[4] = { l->size['b' - 'a'], l->data.strands, l->data.vertices, 3 };
        at = hg_tensor_make(l->ctx, l->dtype, 4, shape);
        if (at) HG_TRY(hg_tensor_fill(at, 0));
    }
    hg_tensor *energy = hg_physics_energy(physics, l->ctx, &l->frame, at, unweighted);
    HG_TRY(hg_ctx_status(l->ctx));
    if (!energy) return HG_MEMORY;
    return w->n ? hg_backward(l->ctx, energy) : HG_OK;
}

/* The gradient of an array in the shape that it was given in: one number for all stands for their sum. */
static hg_status gradient_of(const loss *l, const loss_array *a, double **values)
{
    const hg_tensor *first = hg_grad(a->tensor[0]);
    *values = hg_alloc((size_t)a->count + 1, sizeof **values);
    if (!*values) return HG_MEMORY;
    if (!first) return hg_fail(HG_INVALID, "%s: there is no gradient by \"%s\"", l->path, a->name);
    const int64_t n = hg_tensor_count(first);
    if (a->tensor[1]) {
        for (int c = 0; c < 3; c++) (*values)[c] = hg_tensor_item(hg_grad(a->tensor[c]), 0);
    } else if (a->count == 1) {
        double *each = hg_alloc((size_t)n + 1, sizeof *each);
        hg_status status = each ? hg_tensor_numbers(first, each) : HG_MEMORY;
        for (int64_t i = 0; status == HG_OK && i < n; i++) (*values)[0] += each[i];
        hg_free(each);
        return status;
    } else {
        return hg_tensor_numbers(first, *values);
    }
    return HG_OK;
}

static hg_status write_values(hg_h5 *file, const char *name, hg_dtype dtype, const loss_array *a, const double *values)
{
    if (dtype == HG_F64) return hg_h5_write(file, name, dtype, a->rank, a->shape, values);
    float *narrow = hg_alloc((size_t)a->count + 1, sizeof *narrow);
    if (!narrow) return HG_MEMORY;
    for (int64_t i = 0; i < a->count; i++) narrow[i] = (float)values[i];
    const hg_status status = hg_h5_write(file, name, dtype, a->rank, a->shape, narrow);
    hg_free(narrow);
    return status;
}

static void summarise(hg_loss_result *result, const char *name, const loss_array *a, const double *values)
{
    if (result->n_gradients == HG_LOSS_GRADIENTS) return;
    hg_loss_gradient *g = &result->gradient[result->n_gradients++];
    snprintf(g->name, sizeof g->name, "%s", name);
    size_t used = (size_t)snprintf(g->shape, sizeof g->shape, "[");
    for (int i = 0; i < a->rank; i++)
        used +=
            (size_t)snprintf(g->shape + used, sizeof g->shape - used, "%s%lld", i ? "," : "", (long long)a->shape[i]);
    snprintf(g->shape + used, sizeof g->shape - used, "]");
    for (int64_t i = 0; i < a->count; i++) {
        g->norm += values[i] * values[i];
        if (fabs(values[i]) > g->largest) g->largest = fabs(values[i]);
    }
    if (isnan(g->norm)) g->largest = (double)NAN;
    g->norm = isnan(g->norm) ? (double)NAN : sqrt(g->norm); /* printed without a sign */
}

static hg_status write(loss *l, const char *path, const wishes *w, hg_loss_result *result)
{
    hg_h5 *file;
    HG_TRY(hg_h5_create(&file, path));
    hg_status status = hg_h5_write(file, "energy", HG_F64, 0, NULL, &result->energy);
    for (int t = 0; t < l->n_terms && l->n_terms > 1 && status == HG_OK; t++) {
        char name[128];
        snprintf(name, sizeof name, "energy_%s", l->term[t].energy->name);
        status = hg_h5_write(file, name, HG_F64, 0, NULL, &result->term[t].energy);
    }
    for (int i = 0; i < w->n && status == HG_OK; i++) {
        double *values = NULL;
        status = gradient_of(l, w->array[i], &values);
        if (status == HG_OK) status = write_values(file, w->name[i], l->dtype, w->array[i], values);
        if (status == HG_OK) summarise(result, w->name[i], w->array[i], values);
        hg_free(values);
    }
    if (status == HG_OK) status = hg_h5_set_text(file, "/", "dtype", hg_dtype_name(l->dtype));
    if (status == HG_OK) return hg_h5_commit(file);
    hg_h5_close(file);
    return status;
}

/* Names in the file that nobody read: a misspelt one shows. */
static hg_status list_unread(loss *l, hg_loss_result *result)
{
    char **names;
    int n;
    size_t used = 0;
    HG_TRY(hg_h5_names(l->file, "", &n, &names));
    for (int i = 0; i < n; i++) {
        const loss_array *a = loss_find(l, names[i]);
        const bool read = (a && a->given) || (l->groom && strcmp(names[i], "groom") == 0) ||
                          (l->pairs && strcmp(names[i], "neighbours") == 0) ||
                          (l->body && strcmp(names[i], "body_faces") == 0);
        if (!read && used < sizeof result->unread)
            used += (size_t)snprintf(result->unread + used, sizeof result->unread - used, "%s%s", used ? ", " : "",
                                     names[i]);
    }
    hg_texts_free(names, n);
    return HG_OK;
}

static hg_status run(loss *l, const char *out, const hg_loss_options *options, hg_loss_result *result)
{
    wishes w;
    double unweighted[LOSS_TERMS] = { 0 };
    hg_physics *physics = NULL;
    HG_TRY(loss_read_terms(l, options->energies, options->n_set, options->set));
    HG_TRY(loss_read_data(l));
    HG_TRY(read_wishes(l, &w, options->wrt));
    HG_TRY(list_unread(l, result));
    HG_TRY(loss_make_frame(l, w.n, w.array));
    hg_status status = hg_physics_create(&physics, l->ctx, l->dtype, l->term, l->n_terms, &l->data);
    if (status == HG_OK && options->backend != HG_BACKEND_AUTO) status = hg_physics_backend(physics, options->backend);
    if (status == HG_OK) {
        snprintf(result->backend, sizeof result->backend, "%s", hg_physics_backend_name(physics));
        status = evaluate(l, physics, &w, unweighted);
    }
    if (status == HG_OK) {
        result->n = l->n_terms;
        result->frames = l->size['b' - 'a'];
        result->strands = l->data.strands;
        result->vertices = l->data.vertices;
        for (int t = 0; t < l->n_terms; t++) {
            result->term[t].name = l->term[t].energy->name;
            result->term[t].energy = isnan(unweighted[t]) ? (double)NAN : unweighted[t];
            result->energy += result->term[t].energy;
        }
        status = write(l, out, &w, result);
    }
    hg_physics_destroy(physics);
    return status;
}

hg_status hg_loss_run(hg_ctx *ctx, const char *in, const char *out, const hg_loss_options *options,
                      hg_loss_result *result)
{
    *result = (hg_loss_result){ 0 };
    if (options->dtype != HG_F32 && options->dtype != HG_F64)
        return hg_fail(HG_INVALID, "loss: the dtype is f32 or f64, not %s", hg_dtype_name(options->dtype));
    if (strcmp(in, out) == 0) return hg_fail(HG_INVALID, "%s: the output would replace the input", out);
    loss *l = hg_alloc(1, sizeof *l);
    if (!l) return HG_MEMORY;
    l->ctx = ctx;
    l->path = in;
    l->dtype = options->dtype;
    hg_step_reset(ctx);
    hg_status status = hg_h5_open(&l->file, in);
    if (status == HG_OK) status = run(l, out, options, result);
    loss_free(l);
    hg_free(l);
    hg_step_reset(ctx);
    return status;
}
