/* The trap for numbers that are not finite: names the op and the element, and writes what reproduces it. */
#include "autograd/tape.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

typedef struct {
    hg_dtype dtype;
    const void *data;
    int64_t *first; /* per block, -1: none */
    int64_t n;
} search_args;

enum { BLOCK = 16384 };

static void search_cpu(const void *memory, int64_t first, int64_t last)
{
    const search_args *p = memory;
    for (int64_t block = first; block < last; block++) {
        int64_t end = (block + 1) * BLOCK < p->n ? (block + 1) * BLOCK : p->n;
        p->first[block] = -1;
        for (int64_t i = block * BLOCK; i < end && p->first[block] < 0; i++) {
            double x = p->dtype == HG_F32 ? (double)((const float *)p->data)[i] : ((const double *)p->data)[i];
            if (!isfinite(x)) p->first[block] = i;
        }
    }
}

/* The first element that is not finite, -1 when there is none. */
static int64_t search(hg_ctx *ctx, const hg_tensor *tensor)
{
    static const hg_kernel kernel = {
        .name = "search", .args_size = sizeof(search_args), .cpu = search_cpu, .block = 1
    };
    if (!tensor || !hg_is_float(tensor)) return -1;
    int64_t n = hg_tensor_count(tensor), blocks = (n + BLOCK - 1) / BLOCK, found = -1;
    hg_step_mark mark = hg_step_set_mark(ctx);
    hg_tensor *first = hg_tensor_make(ctx, HG_F64, 1, &blocks); /* 8 bytes an element, on the device */
    if (first &&
        hg_launch(ctx, &kernel, blocks, &(search_args){ tensor->dtype, tensor->data, first->data, n }) == HG_OK) {
        int64_t *host = hg_step_alloc(ctx, (size_t)blocks * sizeof *host);
        if (host && hg_tensor_read(first, host) == HG_OK)
            for (int64_t b = 0; b < blocks && found < 0; b++) found = host[b];
    }
    hg_step_rewind(ctx, mark);
    return found;
}

/* "[2,0,1]" */
static const char *place_text(const hg_tensor *tensor, int64_t element, char text[96])
{
    int64_t index[HG_MAX_RANK];
    int at = snprintf(text, 96, "[");
    for (int i = tensor->rank; i-- > 0; element /= tensor->shape[i]) index[i] = element % tensor->shape[i];
    for (int i = 0; i < tensor->rank; i++)
        at += snprintf(text + at, (size_t)(96 - at), "%s%lld", i ? "," : "", (long long)index[i]);
    snprintf(text + at, (size_t)(96 - at), "]");
    return text;
}

static hg_status write_tensor(hg_h5 *file, const char *name, const hg_tensor *tensor)
{
    void *data = hg_alloc(hg_tensor_bytes(tensor) + 1, 1);
    if (!data) return HG_MEMORY;
    hg_status status = hg_tensor_read(tensor, data);
    if (status == HG_OK) status = hg_h5_write(file, name, tensor->dtype, tensor->rank, tensor->shape, data);
    hg_free(data);
    return status;
}

static hg_status write_call(const hg_call *call, const char *path)
{
    hg_h5 *file;
    char name[32];
    HG_TRY(hg_h5_create(&file, path));
    hg_status status = hg_h5_set_text(file, "/", "op", call->op->name);
    for (int i = 0; i < call->n_in && status == HG_OK; i++) {
        snprintf(name, sizeof name, "input_%d", i);
        if (call->in[i]) status = write_tensor(file, name, call->in[i]);
    }
    if (status == HG_OK) status = write_tensor(file, "output", call->out);
    if (status == HG_OK && hg_grad(call->out)) status = write_tensor(file, "gradient", hg_grad(call->out));
    if (status == HG_OK) return hg_h5_commit(file);
    hg_h5_close(file);
    return status;
}

static hg_status report(const hg_call *call, const char *what, const hg_tensor *tensor, int64_t element,
                        const char *path)
{
    char shape[96], place[96], origin[160] = "";
    double value = hg_tensor_item(tensor, element);
    for (int i = 0; i < call->n_in; i++) {
        int64_t bad = search(call->ctx, call->in[i]);
        if (bad < 0) continue;
        char from[96];
        snprintf(origin, sizeof origin, "; so was its input %d already, at %s", i, place_text(call->in[i], bad, from));
        break;
    }
    bool written = path && write_call(call, path) == HG_OK;
    return hg_ctx_fail(call->ctx, HG_NUMERIC, "%s (recorded at %s:%d): %s, %s, is %g at %s%s%s%s%s", call->op->name,
                       call->file ? call->file : "?", call->line, what, hg_shape_text(tensor, shape), value,
                       place_text(tensor, element, place), origin, written ? "; its inputs are in " : "",
                       written ? path : "", path && !written ? "; its inputs could not be written" : "");
}

hg_status hg_trap_check(const hg_call *call, bool backward, const char *path)
{
    if (!backward) {
        int64_t element = search(call->ctx, call->out);
        return element < 0 ? HG_OK : report(call, "the output", call->out, element, path);
    }
    for (int i = 0; i < call->n_in; i++) {
        const hg_tensor *gradient = hg_needs_grad(call->in[i]) ? hg_grad(call->in[i]) : NULL;
        int64_t element = search(call->ctx, gradient);
        char what[48];
        snprintf(what, sizeof what, "the gradient of input %d", i);
        if (element >= 0) return report(call, what, gradient, element, path);
    }
    return HG_OK;
}
