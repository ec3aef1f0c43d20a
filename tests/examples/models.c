/* The example of models/models.h, run. */
#include "models/models.h"

#include <stdio.h>

int main(void)
{
    hg_ctx *ctx;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1, .seed = 1 }) != HG_OK) return 1;
    hg_tensor *strand = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 5, 66 }),
              *frame = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 2, 682 });
    hg_tensor_fill(strand, 0.5);
    hg_tensor_fill(frame, 0.25);
#include "example.inc"
    int wrong = d == NULL || hg_tensor_count(d) != 2 * 5 * 72;
    if (wrong) fprintf(stderr, "%s\n", hg_message());
    hg_model_destroy(model);
    hg_ctx_destroy(ctx);
    return wrong;
}
