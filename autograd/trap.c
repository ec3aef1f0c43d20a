/* The trap for numbers that are not finite: names the op and the element, and writes what reproduces it. */
#include "autograd/tape.h"
#include "autograd/trap.kernel.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* The first element that is not finite, -1 when there is none. */
static int64_t search(hg_ctx *ctx, const hg_tensor *tensor)
{
    if (!tensor || !hg_is_float(tensor)) return -1;
    int64_t n = hg_tensor_count(tensor), blocks = (n + SEARCHED - 1) / SEARCHED, found = -1;
    hg_step_mark mark = hg_step_set_mark(ctx);
    hg_tensor *first = hg_tensor_make(ctx, HG_F64, 1, &blocks); /* 8 bytes an element, on the device */
    if (first && hg_launch(ctx, search_kernels[tensor->dtype == HG_F64], blocks,
                           &(search_args){ tensor->data, first->data, n }) == HG_OK) {
        int64_t *host = hg_step_alloc(ctx, (size_t)blocks * sizeof *host);
        if (host && hg_tensor_read(first, host) == HG_OK)
            for (int64_t b = 0; b < blocks && found < 0; b++) found = host[b];
    }
    hg_step_rewind(ctx, mark);
    return found;
}

/* Of a NaN, the sign is nobody's business. */
static double unsigned_nan(double x) { return isnan(x) ? (double)NAN : x; }

/* "[2,0,1]" */
const char *hg_place_text(const hg_tensor *tensor, int64_t element, char text[96])
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
    if (status == HG_OK) status = hg_h5_set_text(file, name, "kind", hg_dtype_name(tensor->dtype));
    hg_free(data);
    return status;
}

/* Attributes are bytes that an op believes: that they are what was written is made sure of. */
static const char *hash_text(const void *attributes, int64_t size, char text[24])
{
    snprintf(text, 24, "%016llx", (unsigned long long)hg_hash(attributes, (size_t)size, 0));
    return text;
}

static hg_status write_call(const hg_call *call, const char *path)
{
    hg_h5 *file;
    char name[32], hash[24];
    HG_TRY(hg_h5_create(&file, path));
    hg_status status = hg_h5_set_text(file, "/", "op", call->op->name);
    for (int i = 0; i < call->n_in && status == HG_OK; i++) {
        snprintf(name, sizeof name, "input_%d", i);
        if (call->in[i]) status = write_tensor(file, name, call->in[i]);
    }
    const int64_t size = (int64_t)call->op->attributes_size;
    if (status == HG_OK && size) status = hg_h5_write_u8(file, "attributes", 1, &size, call->attributes);
    if (status == HG_OK && size)
        status = hg_h5_set_text(file, "attributes", "hash", hash_text(call->attributes, size, hash));
    if (status == HG_OK) status = write_tensor(file, "output", call->out);
    if (status == HG_OK && hg_grad(call->out)) status = write_tensor(file, "gradient", hg_grad(call->out));
    if (status == HG_OK) return hg_h5_commit(file);
    hg_h5_close(file);
    return status;
}

/* "; its inputs are in FILE: hairgrad replay FILE runs it again", or in the words of the op. */
static void reproduce(const hg_call *call, bool backward, const char *path, hg_text *text)
{
    if (call->op->explain) {
        if (call->op->explain(call, backward, path, text) != HG_OK)
            hg_text_add(text, "; what it was could not be found out: %s", hg_message());
    } else if (path && write_call(call, path) == HG_OK) {
        hg_text_add(text, "; its inputs are in %s: hairgrad replay %s runs it again", path, path);
    } else if (path) {
        hg_text_add(text, "; its inputs could not be written: %s", hg_message());
    }
}

static hg_status report(const hg_call *call, bool backward, const char *what, const hg_tensor *tensor, int64_t element,
                        const char *path)
{
    char shape[96], place[96], from[96];
    hg_text text = { 0 };
    hg_text_add(&text, "%s (recorded at %s:%d): %s, %s, is %g at %s", call->op->name, call->file ? call->file : "?",
                call->line, what, hg_shape_text(tensor, shape), unsigned_nan(hg_tensor_item(tensor, element)),
                hg_place_text(tensor, element, place));
    for (int i = 0; i < call->n_in; i++) {
        const int64_t bad = search(call->ctx, call->in[i]);
        if (bad < 0) continue;
        hg_text_add(&text, "; so was its input %d%s%s already, at %s", i, call->in[i]->name ? " " : "",
                    call->in[i]->name ? call->in[i]->name : "", hg_place_text(call->in[i], bad, from));
        break;
    }
    reproduce(call, backward, path, &text);
    const hg_status status =
        hg_ctx_fail(call->ctx, HG_NUMERIC, "%s", text.failed ? "out of memory: what the trap found" : text.data);
    hg_text_free(&text);
    return status;
}

hg_status hg_trap_check(const hg_call *call, bool backward, const char *path)
{
    if (!backward) {
        int64_t element = search(call->ctx, call->out);
        return element < 0 ? HG_OK : report(call, false, "the output", call->out, element, path);
    }
    for (int i = 0; i < call->n_in; i++) {
        const hg_tensor *gradient = hg_needs_grad(call->in[i]) ? hg_grad(call->in[i]) : NULL;
        int64_t element = search(call->ctx, gradient);
        char what[96];
        const char *name = call->in[i]->name;
        snprintf(what, sizeof what, "the gradient of input %d%s%.60s", i, name ? " " : "", name ? name : "");
        if (element >= 0) return report(call, true, what, gradient, element, path);
    }
    return HG_OK;
}

/* ---- again ---------------------------------------------------------------------------------------------------- */

enum { ATTRIBUTES = 256 };
typedef struct {
    const hg_op *op;
    int n_in;
    hg_tensor *in[HG_OP_INPUTS], *seed;
    unsigned char attributes[ATTRIBUTES];
} saved_call;

/* A dataset of the file as a tensor; floats in `dtype`, or as they are where it is HG_I32. */
static hg_status read_tensor(hg_ctx *ctx, hg_h5 *file, const char *name, bool in_f64, hg_tensor **tensor)
{
    int rank;
    int64_t shape[6];
    void *data = NULL;
    char *stored = NULL;
    HG_TRY(hg_h5_shape(file, name, &rank, shape));
    hg_status status = hg_h5_get_text(file, name, "kind", &stored);
    if (status != HG_OK) return status;
    const hg_dtype dtype = strcmp(stored, "i32") == 0             ? HG_I32
                           : strcmp(stored, "bf16") == 0          ? HG_BF16
                           : in_f64 || strcmp(stored, "f64") == 0 ? HG_F64
                                                                  : HG_F32;
    hg_free(stored);
    HG_TRY(hg_h5_read(file, name, dtype, rank, shape, NULL, &data));
    *tensor = hg_tensor_make(ctx, dtype, rank, shape);
    status = *tensor ? hg_tensor_write(*tensor, data) : HG_MEMORY;
    hg_free(data);
    if (status == HG_OK && hg_is_float(*tensor)) status = hg_require_grad(*tensor);
    return status;
}

static hg_status read_call(hg_ctx *ctx, hg_h5 *file, const char *path, bool in_f64, saved_call *call)
{
    char *name = NULL, input[32];
    *call = (saved_call){ 0 };
    HG_TRY(hg_h5_get_text(file, "/", "op", &name));
    call->op = hg_find("op", name);
    hg_status status =
        call->op ? HG_OK
                 : hg_fail(HG_INVALID, "%s: it was written by the op \"%s\", which is not known here", path, name);
    hg_free(name);
    HG_TRY(status);
    const int64_t size = (int64_t)call->op->attributes_size;
    if (size > ATTRIBUTES)
        return hg_fail(HG_UNSUPPORTED, "%s: the op has %lld bytes of attributes", path, (long long)size);
    if (size) {
        uint8_t *bytes = NULL;
        char expected[24], *hash = NULL;
        HG_TRY(hg_h5_read_u8(file, "attributes", 1, &size, NULL, &bytes));
        memcpy(call->attributes, bytes, (size_t)size);
        hg_free(bytes);
        HG_TRY(hg_h5_get_text(file, "attributes", "hash", &hash));
        if (strcmp(hash, hash_text(call->attributes, size, expected)) != 0)
            status = hg_fail(HG_FORMAT, "%s: the attributes of the op are damaged", path);
        hg_free(hash);
        HG_TRY(status);
    }
    for (int i = 0; i < call->op->max_in && i < HG_OP_INPUTS; i++) {
        snprintf(input, sizeof input, "input_%d", i);
        if (!hg_h5_has(file, input)) continue;
        HG_TRY(read_tensor(ctx, file, input, in_f64, &call->in[i]));
        call->n_in = i + 1;
    }
    return hg_h5_has(file, "gradient") ? read_tensor(ctx, file, "gradient", in_f64, &call->seed) : HG_OK;
}

static void say(hg_ctx *ctx, hg_text *text, const char *what, const hg_tensor *tensor)
{
    char shape[96], place[96];
    if (!tensor) return;
    const int64_t n = hg_tensor_count(tensor), bad = search(ctx, tensor);
    double largest = 0;
    double *values = hg_alloc((size_t)n + 1, sizeof *values);
    if (values && hg_tensor_numbers(tensor, values) == HG_OK)
        for (int64_t i = 0; i < n; i++)
            if (isfinite(values[i]) && fabs(values[i]) > largest) largest = fabs(values[i]);
    hg_free(values);
    hg_text_add(text, "  %-20s %-16s largest %.4g", what, hg_shape_text(tensor, shape), largest);
    if (bad >= 0)
        hg_text_add(text, ", %g at %s", unsigned_nan(hg_tensor_item(tensor, bad)), hg_place_text(tensor, bad, place));
    hg_text_add(text, "\n");
}

static hg_status run_again(hg_ctx *ctx, saved_call *call, hg_text *text)
{
    char what[48];
    for (int i = 0; i < call->n_in; i++) {
        snprintf(what, sizeof what, "input %d", i);
        say(ctx, text, what, call->in[i]);
    }
    hg_tensor *out = (hg_apply)(ctx, call->op, call->n_in, call->in, call->attributes);
    HG_TRY(hg_ctx_status(ctx));
    say(ctx, text, "output", out);
    if (!call->seed || !hg_needs_grad(out)) return HG_OK;
    say(ctx, text, "gradient of output", call->seed);
    HG_TRY((hg_backward_seeded)(ctx, out, call->seed));
    for (int i = 0; i < call->n_in; i++) {
        snprintf(what, sizeof what, "gradient of input %d", i);
        say(ctx, text, what, hg_grad(call->in[i]));
    }
    return HG_OK;
}

hg_status hg_trap_replay(hg_ctx *ctx, const char *path, hg_text *report)
{
    hg_h5 *file;
    const char *trap_path;
    HG_TRY(hg_h5_open(&file, path));
    const bool trap = hg_trap_is_on(ctx, &trap_path); /* what is not finite is what is looked for */
    hg_trap_nan(ctx, false, NULL);
    hg_status status = HG_OK;
    for (int in_f64 = 0; in_f64 < 2 && status == HG_OK; in_f64++) {
        saved_call call;
        hg_step_reset(ctx);
        status = read_call(ctx, file, path, in_f64, &call);
        if (status == HG_OK)
            hg_text_add(report, "%s: %s, %s\n", call.op->name, call.op->formula, in_f64 ? "in f64" : "as it was");
        if (status == HG_OK) status = run_again(ctx, &call, report);
    }
    hg_step_reset(ctx);
    hg_trap_nan(ctx, trap, trap_path);
    hg_h5_close(file);
    return status;
}
