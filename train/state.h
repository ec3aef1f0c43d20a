/* state: what a checkpoint holds beside the weights; private to train/. */
#ifndef HG_TRAIN_STATE_H
#define HG_TRAIN_STATE_H

#include "train/train.h"

/* Where a run stands. A resumed run goes on from here exactly as if it had not stopped. */
typedef struct {
    int64_t step;           /* steps done */
    double best_validation; /* INFINITY before the first */
    double seconds;         /* trained so far */
    int64_t unimproved;     /* validations since the best one */
} hg_train_state;

/* The moving average of the weights (average.c). */
typedef struct hg_average hg_average;
hg_status hg_average_create(hg_average **average, hg_ctx *ctx, int n, hg_tensor *const *params);
void hg_average_destroy(hg_average *average);
hg_status hg_average_step(hg_average *average, double decay, int64_t step); /* NULL: nothing is averaged */
hg_status hg_average_exchange(hg_average *average);                         /* it and the weights change places */
hg_status hg_average_save(const hg_average *average, hg_h5 *file);
hg_status hg_average_load(hg_average *average, hg_h5 *file);

/* On a device: the next step is not made where this loss is not finite either; hg_adam_check says so. */
void hg_adam_watch(hg_adam *adam, const hg_tensor *loss);
hg_status hg_adam_bad_loss(double loss, int64_t step); /* HG_NUMERIC with its sentence */
hg_status hg_adam_save(const hg_adam *adam, hg_h5 *file);
hg_status hg_adam_load(hg_adam *adam, hg_h5 *file);
/* A tensor of any device as a dataset; read into one of the same shape. */
hg_status hg_state_write_tensor(hg_h5 *file, const char *name, const hg_tensor *tensor);
hg_status hg_state_read_tensor(hg_h5 *file, const char *name, hg_tensor *tensor);
hg_status hg_state_read_count(hg_h5 *file, const char *name, int64_t *value); /* a step number */

/* average, NULL: none. It stands in the place of the weights at both calls. */
hg_status hg_state_save(const char *path, const hg_model *model, const hg_adam *adam, const hg_average *average,
                        const hg_train_state *state, const hg_task *task, const char *backend, uint64_t config_hash);
hg_status hg_state_load(const char *path, hg_model *model, hg_adam *adam, hg_average *average, hg_train_state *state,
                        const hg_task *task, char **backend, uint64_t *config_hash);
/* The weights of another run, to start from: names and shapes have to be the same. */
hg_status hg_state_start(const char *path, hg_model *model, const hg_task *task);

#endif
