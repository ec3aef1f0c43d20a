/* The example of tasks/tasks.h, compiled; tests/test_task.c runs a task. */
#include "tasks/tasks.h"

void run(hg_ctx *ctx, const hg_config *config, hg_progress progress, hg_train_options options, const hg_motion *clip,
         const double *shape);

void run(hg_ctx *ctx, const hg_config *config, hg_progress progress, hg_train_options options, const hg_motion *clip,
         const double *shape)
{
    hg_train_result result;
    hg_hair_metrics metrics;
#include "example.inc"
}

int main(void) { return 0; }
