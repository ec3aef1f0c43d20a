/* The example of autograd/autograd.h, run: the gradient of sum (x w)^2 is 2 x^T x w, here with ones. */
#include "autograd/autograd.h"

int main(void)
{
    hg_ctx *ctx;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1, .seed = 1 }) != HG_OK) return 1;
    hg_tensor *x = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 3, 4 });
    hg_tensor_fill(x, 1.0);
#include "example.inc"
    int wrong = s != HG_OK || hg_tensor_count(dw) != 8;
    hg_tensor_destroy(w);
    hg_ctx_destroy(ctx);
    return wrong;
}
