/* train: what belongs to `hairgrad train` alone. */
#ifndef HG_CLI_TRAIN_H
#define HG_CLI_TRAIN_H

#include "cli/cli.h"

hg_status cli_dry_run(hg_ctx *ctx, hg_hair_task *task, const hg_progress *progress);

#endif
