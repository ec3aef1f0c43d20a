/* train: optimisers, the trainer, checkpoints and logs. Knows nothing of hair.
 *
 * A task says what to learn: `sample` fills a batch from (seed, step) alone, so that a resumed run is exact; `loss`
 * builds one scalar. The trainer clips, steps Adam, logs, validates and checkpoints.
 *
 *     hg_train_options options = hg_train_defaults();
 *     options.steps = 2000; options.folder = "out/run";
 *     hg_train(ctx, &model, &task, &options, &progress, &report);
 *
 * The run folder: config.yaml (echo), log.jsonl (one object per logged step), checkpoint.h5 (atomic), best.h5, report.json,
 * and with `tensorboard` events.out.tfevents.*.
 * Bit for bit: the same run twice, with any number of threads, and interrupted and resumed, gives the same weights.
 */
#ifndef HG_TRAIN_H
#define HG_TRAIN_H

#include "models/models.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Named numbers of a step or a validation: weighted and unweighted terms, norms, metrics. Added in order. */
#define HG_REPORT_MAX 64
typedef struct {
    int n;
    struct { const char *name; double value; const hg_tensor *from; int64_t at; double scale; } item[HG_REPORT_MAX]; /* names are kept by pointer */
} hg_report;
void   hg_report_add(hg_report *report, const char *name, double value);
/* value = scale * element `at` of a tensor of the step, read when the report is wanted (hg_report_settle, before the step is over):
 * a device is not waited for in every step. */
void   hg_report_later(hg_report *report, const char *name, const hg_tensor *from, int64_t at, double scale);
void   hg_report_settle(hg_report *report);
double hg_report_get(const hg_report *report, const char *name); /* NAN when absent */

typedef struct {
    void *self;
    size_t batch_bytes;                                           /* the trainer owns one batch of this size, zeroed once */
    hg_status  (*sample)(void *self, hg_ctx *ctx, uint64_t seed, uint64_t step, void *batch);   /* pure: resume is exact */
    /* On a device this is recorded (hg_step_record): read nothing here, or the host waits. The batch goes there by hg_tensor_from,
     * which copies at once, so that `sample` fills it again while the device still computes. */
    hg_tensor *(*loss)(void *self, hg_ctx *ctx, hg_model *model, const void *batch, hg_report *report);
    hg_status  (*validate)(void *self, hg_ctx *ctx, hg_model *model, hg_report *report);        /* adds "validation"; NULL: none */
    hg_status  (*save)(void *self, hg_h5 *file);                  /* what else a checkpoint must hold; NULL: nothing */
    hg_status  (*load)(void *self, hg_h5 *file);
    hg_status  (*start)(void *self, hg_h5 *file);                 /* what a new run takes over from the checkpoint it starts from; NULL: nothing */
} hg_task;

typedef struct {
    int64_t steps;
    double learning_rate, final_fraction;  /* cosine from the first to learning_rate * final_fraction */
    int64_t warm_up;                       /* steps, linear */
    double clip;                           /* largest global gradient norm; 0: none */
    double beta1, beta2, epsilon, weight_decay;
    double ema;                            /* decay of a moving average of the weights, which then is what validations, best.h5, /model of checkpoints and the caller get; 0: none */
    int64_t patience;                      /* stops after so many validations without a better one; 0: never */
    int64_t log_every, validate_every, checkpoint_every;
    bool tensorboard;                      /* the log's numbers as an event file too */
    const char *start_from;                /* a checkpoint whose weights a new run starts from, with a fresh optimiser; NULL or "": none */
    double minutes;                        /* stops (finished, with the schedule cut) after so much time; 0: no limit. Not reproducible, said in the log */
    const char *folder;
    bool resume;                           /* continue from folder/checkpoint.h5 when there is one */
    bool allow_other_backend;
    uint64_t config_hash;                  /* a resume on another config is refused */
    const char *backend;                   /* logged; a resume on another one is refused unless allowed */
    const char *backend_note;              /* logged beside it: why it is interpreted, how long it took to compile; NULL or "": nothing */
    const char *note;                      /* logged when the run begins; NULL: nothing */
    const char *graph;                     /* the tape of the first step, with the norms of its gradients, is drawn there (Graphviz); NULL: not */
    bool (*stop)(void *);  void *stop_self; /* asked once a step; true: checkpoint and return (signal handlers) */
} hg_train_options;

typedef struct { int64_t steps; double seconds, loss, best_validation; bool interrupted, early /* out of patience */; } hg_train_result;

hg_train_options hg_train_defaults(void);
hg_status hg_train(hg_ctx *ctx, hg_model *model, const hg_task *task, const hg_train_options *options, const hg_progress *progress, hg_train_result *result);

/* Adam (Kingma and Ba 2015) with bias correction; state as flat tensors. */
typedef struct hg_adam hg_adam;
hg_status hg_adam_create(hg_adam **adam, hg_ctx *ctx, int n, hg_tensor *const *params);
void      hg_adam_destroy(hg_adam *adam);
/* Clips the global norm, then steps. A non-finite gradient leaves everything as it was and is HG_NUMERIC. On a device the host
 * does not wait for that: it is told by hg_adam_check, and nothing is stepped until then (with a gradient_norm, at once). */
hg_status hg_adam_step(hg_adam *adam, double learning_rate, double beta1, double beta2, double epsilon, double weight_decay, double clip, double *gradient_norm);
/* Of the last step; waits for the device. HG_NUMERIC: the first step since the last check whose gradient was not finite. */
hg_status hg_adam_check(hg_adam *adam, double *gradient_norm);

/* Checkpoints: parameters by name under /model, and what the trainer and the task need to go on. */
hg_status hg_checkpoint_save(const char *path, const hg_model *model, const hg_adam *adam, int64_t step, const hg_task *task, const char *backend, uint64_t config_hash);
hg_status hg_checkpoint_load(const char *path, hg_model *model, hg_adam *adam, int64_t *step, const hg_task *task, char **backend, uint64_t *config_hash); /* adam, step, task ... may be NULL */

#ifdef __cplusplus
}
#endif
#endif
