/* shape: body shape coefficients and clips by name on the command line. */
#ifndef HG_CLI_SHAPE_H
#define HG_CLI_SHAPE_H

#include "cli/cli.h"

/* "0.5,0,-1": up to ten numbers, the rest 0; absent: false in *given and all 0. */
hg_status cli_shape(const hg_arguments *arguments, double shape[HG_SHAPES], bool *given);
/* With a body also by name, several times and mixed: "head_width=0.5,neck_length=-1". */
hg_status cli_shape_of(const hg_arguments *arguments, const hg_body *body, double shape[HG_SHAPES], bool *given);
/* The same numbers and names as a text. */
hg_status cli_shape_text(const char *text, const hg_body *body, double shape[HG_SHAPES]);
/* The clip of a run whose name, or the last part of it, is `name`. NULL and a message that lists those there are. */
const hg_motion *cli_clip(const hg_hair_task *task, const char *name);

/* Every --material NAME=VALUE, set. */
hg_status cli_materials(const hg_arguments *arguments, hg_hair_task *task);

/* drape --pairs FILE|N. */
hg_status cli_drape_pairs(hg_ctx *ctx, const hg_arguments *arguments, hg_hair_task *task, int64_t stride,
                          const char *path);

#endif
