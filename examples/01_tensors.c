/* 01 * Tensors, the tape, a gradient.
 *
 *     cc -std=gnu11 01_tensors.c $(pkg-config --cflags --libs hairgrad) -lm && ./a.out
 *
 * A context owns the device, the memory of a step and the first error. Tensors are of two kinds: those of a step, which are
 * gone at hg_step_reset, and those that you own and destroy. Every call on a tensor that needs a gradient is recorded on
 * the context's tape; hg_backward walks it back. */
#include "hairgrad.h"

#include <stdio.h>

/* sum over i of w_i x_i^2, and its gradient by w and x. */
static void weighted_squares(hg_ctx *ctx, hg_tensor *w)
{
    hg_tensor *x = hg_tensor_make(ctx, HG_F64, 1, (int64_t[]){ 3 }); /* lives until hg_step_reset */
    hg_tensor_write(x, (double[]){ 1, 2, 3 });
    hg_require_grad(x);

    hg_tensor *loss = hg_sum(ctx, hg_mul(ctx, w, hg_square(ctx, x)));
    hg_backward(ctx, loss);

    printf("sum w x^2       %g\n", hg_tensor_item(loss, 0));
    for (int i = 0; i < 3; i++)
        printf("  x %g  w %g   d/dx = 2 w x = %g   d/dw = x^2 = %g\n", hg_tensor_item(x, i), hg_tensor_item(w, i),
               hg_tensor_item(hg_grad(x), i), hg_tensor_item(hg_grad(w), i));
}

/* A branch that is not differentiated: its value counts, its gradient does not. */
static void detached(hg_ctx *ctx, hg_tensor *w)
{
    hg_tensor *loss = hg_sum(ctx, hg_mul(ctx, w, hg_detach(ctx, w)));
    hg_backward(ctx, loss);
    printf("sum w [w]       %g, gradient %g instead of %g\n", hg_tensor_item(loss, 0), hg_tensor_item(hg_grad(w), 0),
           2 * hg_tensor_item(w, 0));
}

/* Nothing is checked call by call: after an error calls return NULL and take NULL, and the first error is kept. */
static void wrong_shape(hg_ctx *ctx, hg_tensor *w)
{
    hg_tensor *b = hg_tensor_make(ctx, HG_F64, 1, (int64_t[]){ 4 });
    hg_tensor_fill(b, 1);
    hg_tensor *loss = hg_sum(ctx, hg_square(ctx, hg_mul(ctx, w, b)));
    const char *said = hg_ctx_message(ctx);
    printf("3 times 4       %s: %.60s...\n", loss ? "?" : "no tensor", said);
    hg_ctx_clear(ctx);
}

int main(void)
{
    hg_ctx *ctx;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1, .seed = 1 }) != HG_OK) {
        fprintf(stderr, "%s\n", hg_message());
        return 1;
    }
    hg_tensor *w = hg_tensor_create(ctx, HG_F64, 1, (int64_t[]){ 3 }); /* ours, until hg_tensor_destroy */
    hg_tensor_write(w, (double[]){ 0.5, 1, 1.5 });
    hg_require_grad(w);

    weighted_squares(ctx, w);
    hg_step_reset(ctx); /* x and the tape are gone, w stays */
    detached(ctx, w);
    wrong_shape(ctx, w);

    hg_tensor_destroy(w);
    hg_ctx_destroy(ctx);
    return 0;
}
