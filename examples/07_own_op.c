/* 07 * An op of one's own: forward and backward by hand, in one place, checked like those of the library.
 *
 *     cc -std=gnu11 07_own_op.c $(pkg-config --cflags --libs hairgrad) -lm && ./a.out
 *
 * For a loss that is no formula of one site, and no composition of the ops that are there. An op is one constant struct:
 * what shape comes out, how the output is made, how its gradient goes to the inputs, and samples on which it is checked.
 * HG_OP makes it known by name: compiled as a plug-in, `hairgrad gradcheck` finds it, and so does the test of all ops.
 *
 * The contract of a backward: it ADDS to the gradients of the inputs that need one. */
#include "hairgrad.h"

#include <math.h>
#include <stdio.h>

typedef struct {
    double limit;
} hinge_attributes; /* plain numbers: a trap writes them to a file */

static bool is_float(const hg_tensor *x) { return x->dtype == HG_F32 || x->dtype == HG_F64; }

static hg_tensor *hinge_shape(hg_call *call)
{
    const hg_tensor *x = call->in[0];
    if (!is_float(x)) return hg_refuse(call, "it takes f32 or f64");
    return hg_tensor_make(call->ctx, x->dtype, x->rank, x->shape);
}

/* y = max(x - limit, 0)^2 */
static hg_status hinge_forward(hg_call *call)
{
    const double limit = ((const hinge_attributes *)call->attributes)->limit;
    const int64_t n = hg_tensor_count(call->out);
    for (int64_t i = 0; i < n; i++) {
        const double over = fmax(hg_tensor_item(call->in[0], i) - limit, 0);
        if (call->out->dtype == HG_F32)
            ((float *)call->out->data)[i] = (float)(over * over);
        else
            ((double *)call->out->data)[i] = over * over;
    }
    return HG_OK;
}

/* dx += 2 max(x - limit, 0) dy */
static hg_status hinge_backward(hg_call *call)
{
    const double limit = ((const hinge_attributes *)call->attributes)->limit;
    const hg_tensor *dy = hg_grad(call->out);
    if (!hg_needs_grad(call->in[0])) return HG_OK;
    hg_tensor *dx = hg_grad(call->in[0]);
    for (int64_t i = 0; i < hg_tensor_count(dy); i++) {
        const double slope = 2 * fmax(hg_tensor_item(call->in[0], i) - limit, 0) * hg_tensor_item(dy, i);
        if (dx->dtype == HG_F32)
            ((float *)dx->data)[i] += (float)slope;
        else
            ((double *)dx->data)[i] += slope;
    }
    hg_tensor_touch(dx);
    return HG_OK;
}

static const hinge_attributes quarter = { 0.25 };
static const hg_sample samples[] = {
    { .label = "both sides", .n_in = 1, .in = { { 2, { 3, 5 } } }, .attributes = &quarter },
    { .label = "nothing above",
      .n_in = 1,
      .in = { { 1, { 4 }, .low = -2, .high = 0 } },
      .attributes = &quarter,
      .zero_gradient = true },
};
HG_OP(hinge, .formula = "max(x - limit, 0)^2", .min_in = 1, .max_in = 1, .attributes_size = sizeof(hinge_attributes),
      .shape = hinge_shape, .forward = hinge_forward, .backward = hinge_backward, .samples = samples, .n_samples = 2);

/* What others call. */
static hg_tensor *hinge(hg_ctx *ctx, hg_tensor *x, double limit)
{
    return hg_apply(ctx, &op_hinge, 1, &x, &(hinge_attributes){ limit });
}

int main(void)
{
    hg_ctx *ctx;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1, .seed = 1 }) != HG_OK) return 1;
    hg_tensor *x = hg_tensor_make(ctx, HG_F64, 1, (int64_t[]){ 4 });
    hg_tensor_write(x, (double[]){ -2, 0.5, 1, 3 });
    hg_require_grad(x);
    hg_tensor *loss = hg_sum(ctx, hinge(ctx, hg_square(ctx, x), 1)); /* ours, among theirs */
    if (hg_backward(ctx, loss) != HG_OK) {
        fprintf(stderr, "%s\n", hg_message());
        return 1;
    }
    printf("sum max(x^2 - 1, 0)^2 = %g\n", hg_tensor_item(loss, 0));
    for (int i = 0; i < 4; i++) printf("  x %4g   gradient %g\n", hg_tensor_item(x, i), hg_tensor_item(hg_grad(x), i));

    for (int i = 0; i < 2; i++) {
        hg_gradcheck_result result = { 0 };
        const hg_status status = hg_gradcheck_op(ctx, hg_find("op", "hinge"), &samples[i], NULL, &result);
        printf("gradcheck, %s: %s\n", samples[i].label, status == HG_OK ? "right to 1e-6" : hg_message());
        hg_step_reset(ctx);
    }
    hg_ctx_destroy(ctx);
    return 0;
}
