/* The example of train/train.h, compiled; tests/test_train.c runs the trainer. */
#include "train/train.h"

hg_status run(hg_ctx *ctx, hg_model model, hg_task task, hg_progress progress);

hg_status run(hg_ctx *ctx, hg_model model, hg_task task, hg_progress progress)
{
    hg_train_result report;
#include "example.inc"
    return hg_ctx_status(ctx);
}

int main(void) { return 0; }
