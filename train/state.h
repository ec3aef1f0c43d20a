/* state: what a checkpoint holds beside the weights; private to train/. */
#ifndef HG_TRAIN_STATE_H
#define HG_TRAIN_STATE_H

#include "train/train.h"

/* Where a run stands. A resumed run goes on from here exactly as if it had not stopped. */
typedef struct {
    int64_t step;           /* steps done */
    double best_validation; /* INFINITY before the first */
    double seconds;         /* trained so far */
} hg_train_state;

hg_status hg_adam_save(const hg_adam *adam, hg_h5 *file);
hg_status hg_adam_load(hg_adam *adam, hg_h5 *file);
hg_status hg_state_read_count(hg_h5 *file, const char *name, int64_t *value); /* a step number */

hg_status hg_state_save(const char *path, const hg_model *model, const hg_adam *adam, const hg_train_state *state,
                        const hg_task *task, const char *backend, uint64_t config_hash);
hg_status hg_state_load(const char *path, hg_model *model, hg_adam *adam, hg_train_state *state, const hg_task *task,
                        char **backend, uint64_t *config_hash);

#endif
