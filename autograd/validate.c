/* HAIRGRAD_VALIDATE=1: every op that runs on a device is run on the processor too, forward and backward, from the same inputs;
 * the first element that differs by more than rounding ends the formula with an error that names op, shape and element. Slow: for
 * finding out where a device goes wrong, not for training. */
#include "autograd/tape.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Against the element, and against the largest of the tensor: sums of numbers that cancel are as wrong as their terms. What
 * hg_ctx_compute rounds, of 8 or 11 bits, is compared with what is not rounded. */
static double tolerance(const hg_call *call, hg_dtype dtype)
{
    const hg_dtype compute = hg_ctx_compute_dtype(call->ctx);
    if (dtype == HG_F64) return 1e-11;
    return dtype == HG_BF16 || compute == HG_BF16 ? 1e-2 : compute == HG_TF32 ? 2e-3 : 1e-5;
}

bool hg_validate_wanted(const hg_ctx *ctx)
{
    const char *wanted = getenv("HAIRGRAD_VALIDATE");
    return wanted && wanted[0] && strcmp(wanted, "0") != 0 && !hg_ctx_host(ctx);
}

/* ---- comparing ---- */

static hg_status differs(const hg_call *call, const char *what, const hg_tensor *tensor, int64_t element, double got,
                         double wanted)
{
    char shape[96], place[96];
    hg_text inputs = { 0 };
    for (int i = 0; i < call->n_in; i++) hg_text_add(&inputs, "%s%s", i ? ", " : "", hg_shape_text(call->in[i], shape));
    const hg_status status = hg_ctx_fail(
        call->ctx, HG_NUMERIC,
        "validation: %s (recorded at %s:%d): %s, %s, differs at %s: %.9g on %s, %.9g on the processor; inputs %s",
        call->op->name, call->file ? call->file : "?", call->line, what, hg_shape_text(tensor, shape),
        hg_place_text(tensor, element, place), got, hg_ctx_device(call->ctx), wanted,
        inputs.failed ? "?"
        : inputs.data ? inputs.data
                      : "");
    hg_text_free(&inputs);
    return status;
}

/* before: what the element had when it was added to, NULL: nothing. */
static hg_status compare(const hg_call *call, const char *what, const hg_tensor *got, const double *before,
                         const hg_tensor *wanted)
{
    const int64_t n = hg_tensor_count(wanted);
    hg_tensor *here = hg_tensor_make(wanted->ctx, got->dtype, got->rank, got->shape);
    if (!here) return HG_MEMORY;
    if (hg_tensor_count(got) != n) return differs(call, what, got, 0, (double)hg_tensor_count(got), (double)n);
    HG_TRY(hg_tensor_read(got, here->data));
    double largest = 0;
    for (int64_t i = 0; i < n; i++) {
        const double x = fabs(hg_tensor_item(wanted, i)), old = before ? fabs(before[i]) : 0;
        if (isfinite(x)) largest = fmax(largest, fmax(x, old));
    }
    const double relative = tolerance(call, wanted->dtype);
    for (int64_t i = 0; i < n; i++) {
        const double a = hg_tensor_item(here, i), b = hg_tensor_item(wanted, i) + (before ? before[i] : 0);
        if (a == b || (isnan(a) && isnan(b))) continue;
        if (!isfinite(a) || !isfinite(b) || !(fabs(a - b) <= relative * (fabs(b) + largest)))
            return differs(call, what, got, i, a, b);
    }
    return HG_OK;
}

/* ---- the same call on the processor ---- */

static hg_tensor *copied(hg_ctx *host, const hg_tensor *tensor, bool gradient)
{
    hg_tensor *copy = hg_tensor_make(host, tensor->dtype, tensor->rank, tensor->shape);
    if (!copy || hg_tensor_read(tensor, copy->data) != HG_OK) return NULL;
    hg_tensor_touch(copy);
    copy->name = tensor->name;
    return gradient && hg_require_grad(copy) != HG_OK ? NULL : copy;
}

static hg_status again(hg_ctx *host, const hg_call *call, bool backward, hg_tensor **in, hg_tensor **out)
{
    for (int i = 0; i < call->n_in; i++) {
        in[i] = call->in[i] ? copied(host, call->in[i], backward && hg_needs_grad(call->in[i])) : NULL;
        if (call->in[i] && !in[i]) return HG_MEMORY;
    }
    *out = call->op->twin ? call->op->twin(call, host, in) : hg_apply(host, call->op, call->n_in, in, call->attributes);
    if (*out) return HG_OK;
    return hg_ctx_fail(call->ctx, HG_INVALID, "validation: %s does not run on the processor: %s", call->op->name,
                       hg_ctx_message(host));
}

hg_status hg_validate_forward(hg_ctx *host, const hg_call *call)
{
    hg_tensor *in[HG_OP_INPUTS], *out;
    hg_ctx_clear(host);
    hg_step_reset(host);
    hg_no_grad_begin(host);
    hg_status status = again(host, call, false, in, &out);
    if (status == HG_OK) status = compare(call, "its output", call->out, NULL, out);
    hg_no_grad_end(host);
    return status;
}

/* What the gradients of the inputs were, so that what a backward adds is known. */
hg_status hg_validate_before(hg_ctx *host, const hg_call *call, double **before)
{
    hg_ctx_clear(host);
    hg_step_reset(host);
    for (int i = 0; i < call->n_in; i++) {
        before[i] = NULL;
        const hg_node *node = call->in[i] ? call->in[i]->tape : NULL;
        if (!node || !node->grad || node->stale) continue;
        const hg_tensor *old = copied(host, node->grad, false);
        const int64_t n = old ? hg_tensor_count(old) : 0;
        before[i] = old ? hg_step_alloc(host, (size_t)n * sizeof(double)) : NULL;
        if (!before[i]) return HG_MEMORY;
        for (int64_t k = 0; k < n; k++) before[i][k] = hg_tensor_item(old, k);
    }
    return HG_OK;
}

hg_status hg_validate_backward(hg_ctx *host, const hg_call *call, double *const *before)
{
    hg_tensor *in[HG_OP_INPUTS], *out;
    char what[48];
    HG_TRY(again(host, call, true, in, &out));
    const hg_node *node = call->out->tape;
    const hg_tensor *seed = copied(host, node->grad, false);
    if (!seed) return HG_MEMORY;
    HG_TRY((hg_backward_seeded)(host, out, seed));
    for (int i = 0; i < call->n_in; i++) {
        bool twice = false; /* a tensor that is two inputs has one gradient: compared by its first, summed over both */
        for (int j = 0; j < i; j++) twice |= call->in[j] == call->in[i];
        if (!hg_needs_grad(call->in[i]) || twice) continue;
        hg_tensor *wanted = hg_grad(in[i]);
        for (int j = i + 1; j < call->n_in; j++) {
            if (call->in[j] != call->in[i]) continue;
            const hg_tensor *more = hg_grad(in[j]);
            HG_TRY(hg_accumulate(host, wanted->dtype, hg_tensor_count(wanted), more->data, wanted->data, false));
        }
        const hg_node *input = call->in[i]->tape;
        if (input->stale) continue; /* nothing was added: zero, and so it stays to be written */
        snprintf(what, sizeof what, "the gradient of its input %d", i);
        HG_TRY(compare(call, what, input->grad, before[i], wanted));
    }
    return HG_OK;
}
