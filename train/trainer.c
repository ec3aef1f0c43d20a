/* trainer: the loop of a training run. It knows a task only by its batch, its loss and its validation.
 *
 * The learning rate rises linearly over the warm-up and then falls along a half cosine. With a time limit the cosine
 * also follows the clock, so that the rate has come down when the time is over: such a run is not reproducible, and its
 * log says so. Everything else depends on (seed, step) alone.
 *
 * On a device nothing in a step waits for it: while it computes one step, the host samples the next and sends it after. The
 * batch may be filled again at once, since what is sent has been copied (hg_tensor_write). Loss, norm and what was not finite are
 * read when they are logged, and before anything is kept. */
#include "train/log.h"
#include "train/state.h"

#include <glob.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

static double seconds_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

hg_train_options hg_train_defaults(void)
{
    return (hg_train_options){ .steps = 1000,
                               .learning_rate = 5e-4,
                               .final_fraction = 0.05,
                               .warm_up = 100,
                               .clip = 1,
                               .beta1 = 0.9,
                               .beta2 = 0.999,
                               .epsilon = 1e-8,
                               .log_every = 20,
                               .validate_every = 500,
                               .checkpoint_every = 500 };
}

static double learning_rate(const hg_train_options *options, int64_t step, double elapsed)
{
    if (step < options->warm_up) return options->learning_rate * (double)(step + 1) / (double)options->warm_up;
    const double span = (double)(options->steps - options->warm_up);
    double along = span > 0 ? (double)(step - options->warm_up) / span : 1;
    if (options->minutes > 0) along = fmax(along, elapsed / (60 * options->minutes));
    along = fmin(fmax(along, 0), 1);
    const double low = options->final_fraction;
    return options->learning_rate * (low + (1 - low) * 0.5 * (1 + cos(3.14159265358979323846 * along)));
}

/* Everything of one run, so that its parts can be functions of a screen. */
typedef struct {
    hg_ctx *ctx;
    hg_model *model;
    const hg_task *task;
    const hg_train_options *options;
    const hg_progress *progress;
    hg_adam *adam;
    hg_average *average;
    hg_run_log *log;
    hg_events *events;
    char *checkpoint, *best, *report;
    char *backend; /* the options', and the device where it is not the processor */
    void *batch;
    const hg_tensor *loss_tensor; /* of the step that was made, until the next; NULL: it is read */
    hg_train_state state;
    hg_report last;      /* of the last logged step */
    hg_report validated; /* of the last validation */
    double started, logged, loss;
    int64_t logged_step, first_step;
    bool resumed, early;
} run;

static double elapsed(const run *r) { return r->state.seconds + seconds_now() - r->started; }

/* What a device has found, and the loss of the last step: waits for it. */
static hg_status look(run *r, double *norm)
{
    if (hg_ctx_host(r->ctx)) return HG_OK;
    if (r->loss_tensor) r->loss = hg_tensor_item(r->loss_tensor, 0);
    r->loss_tensor = NULL;
    return hg_adam_check(r->adam, norm);
}

static hg_status save(run *r, const char *path)
{
    if (!path) return HG_OK;
    HG_TRY(look(r, NULL));
    hg_train_state state = r->state;
    state.seconds = elapsed(r);
    HG_TRY(hg_average_exchange(r->average));
    const hg_status status =
        hg_state_save(path, r->model, r->adam, r->average, &state, r->task, r->backend, r->options->config_hash);
    HG_TRY(hg_average_exchange(r->average));
    return status;
}

static hg_status resume(run *r)
{
    const hg_train_options *options = r->options;
    if (!r->checkpoint || !options->resume || !hg_file_exists(r->checkpoint)) return HG_OK;
    char *backend = NULL;
    uint64_t config_hash = 0;
    hg_status status =
        hg_state_load(r->checkpoint, r->model, r->adam, r->average, &r->state, r->task, &backend, &config_hash);
    /* Another config may be why the file does not fit: it is told first. */
    if (config_hash && config_hash != options->config_hash)
        status = hg_fail(HG_INVALID,
                         "%s: it belongs to another config; train into another folder, or start again without resuming",
                         r->checkpoint);
    else if (status == HG_OK && strcmp(backend, r->backend) && !options->allow_other_backend)
        status = hg_fail(HG_INVALID,
                         "%s: it was trained on \"%s\" and this is \"%s\", which rounds differently; allow another "
                         "back end to go on anyway",
                         r->checkpoint, backend, r->backend);
    hg_free(backend);
    if (status == HG_OK) status = hg_average_exchange(r->average);
    r->resumed = status == HG_OK;
    return status;
}

/* The tape of the first step made, as Graphviz. */
static hg_status draw_graph(const run *r)
{
    if (!r->options->graph || r->state.step != r->first_step) return HG_OK;
    hg_text dot = { 0 };
    hg_status status = hg_graph_dot(r->ctx, &dot);
    if (status == HG_OK) status = hg_file_write(r->options->graph, dot.data, dot.size);
    hg_text_free(&dot);
    return status;
}

/* Everything of a step that the device does. */
static hg_status compute_step(run *r, hg_report *report, double *norm, double *rate)
{
    const hg_train_options *options = r->options;
    const bool host = hg_ctx_host(r->ctx);
    hg_profile_begin(r->ctx, "step", "loss");
    hg_tensor *loss = r->task->loss(r->task->self, r->ctx, r->model, r->batch, report);
    hg_profile_end(r->ctx, 0);
    HG_TRY(hg_ctx_status(r->ctx));
    if (!loss) return hg_fail(HG_INVALID, "trainer: the task made no loss at step %lld", (long long)r->state.step + 1);
    if (host) r->loss = hg_tensor_item(loss, 0);
    if (host && !isfinite(r->loss)) return hg_adam_bad_loss(r->loss, r->state.step + 1);
    if (!host) hg_adam_watch(r->adam, r->loss_tensor = loss);
    hg_profile_begin(r->ctx, "step", "backward");
    HG_TRY(hg_backward(r->ctx, loss));
    hg_profile_end(r->ctx, 0);
    HG_TRY(draw_graph(r));
    *rate = learning_rate(options, r->state.step, elapsed(r));
    HG_TRY(hg_adam_step(r->adam, *rate, options->beta1, options->beta2, options->epsilon, options->weight_decay,
                        options->clip, host ? norm : NULL));
    r->state.step++;
    return hg_average_step(r->average, options->ema, r->state.step);
}

static hg_status one_step(run *r, hg_report *report, double *norm, double *rate)
{
    hg_ctx_clear(r->ctx);
    hg_step_reset(r->ctx);
    r->loss_tensor = NULL;
    hg_profile_begin(r->ctx, "step", "sample");
    HG_TRY(r->task->sample(r->task->self, r->ctx, hg_ctx_seed(r->ctx), (uint64_t)r->state.step, r->batch));
    hg_profile_end(r->ctx, 0);
    HG_TRY(hg_step_record(r->ctx));
    const hg_status status = compute_step(r, report, norm, rate);
    const hg_status done = hg_step_run(r->ctx);
    HG_TRY(status);
    HG_TRY(done);
    hg_profile_step(r->ctx);
    return HG_OK;
}

static hg_status log_report(run *r, const hg_report *report)
{
    HG_TRY(hg_run_log_write(r->log, r->state.step, report));
    return hg_events_write(r->events, r->state.step, report);
}

static hg_status validate(run *r)
{
    if (!r->task->validate) return HG_OK;
    HG_TRY(look(r, NULL));
    hg_report report = { 0 };
    hg_ctx_clear(r->ctx);
    hg_step_reset(r->ctx);
    HG_TRY(hg_average_exchange(r->average));
    HG_TRY(r->task->validate(r->task->self, r->ctx, r->model, &report));
    HG_TRY(hg_ctx_status(r->ctx));
    hg_report_settle(&report);
    HG_TRY(hg_average_exchange(r->average));
    r->validated = report;
    HG_TRY(log_report(r, &report));
    const double value = hg_report_get(&report, "validation");
    if (value < r->state.best_validation) {
        r->state.best_validation = value;
        r->state.unimproved = 0;
        return save(r, r->best);
    }
    if (r->state.step > r->first_step) r->state.unimproved++; /* a finished run resumed makes none */
    return HG_OK;
}

static void tell(const run *r)
{
    const hg_train_options *options = r->options;
    const double now = elapsed(r), passed = seconds_now() - r->started;
    const int64_t done = r->state.step - r->first_step;
    const double speed = passed > 0 ? (double)done / passed : 0;
    double left = speed > 0 ? (double)(options->steps - r->state.step) / speed : 0;
    double fraction = (double)r->state.step / (double)options->steps;
    if (options->minutes > 0) {
        left = fmin(left, fmax(0, 60 * options->minutes - now));
        fraction = fmax(fraction, now / (60 * options->minutes));
    }
    char validation[48] = "";
    if (isfinite(hg_report_get(&r->validated, "validation")))
        snprintf(validation, sizeof validation, "  validation %.4g", hg_report_get(&r->validated, "validation"));
    hg_progress_report(r->progress, fmin(fraction, 1), "step %lld of %lld  loss %.4g%s  %.1f steps/s  %lld:%02lld left",
                       (long long)r->state.step, (long long)options->steps, r->loss, validation, speed,
                       (long long)(left / 60), (long long)left % 60);
}

static hg_status write_log(run *r, hg_report *report, double norm, double rate)
{
    const double now = seconds_now(), passed = now - r->logged;
    hg_report_settle(report);
    hg_report_add(report, "loss", r->loss);
    hg_report_add(report, "gradient_norm", norm);
    hg_report_add(report, "learning_rate", rate);
    hg_report_add(report, "steps_per_second", passed > 0 ? (double)(r->state.step - r->logged_step) / passed : 0);
    hg_report_add(report, "seconds", elapsed(r));
    r->logged = now;
    r->logged_step = r->state.step;
    r->last = *report;
    return log_report(r, report);
}

static bool out_of_patience(const run *r)
{
    return r->options->patience > 0 && r->state.unimproved >= r->options->patience;
}

static bool every(int64_t step, int64_t period) { return period > 0 && step % period == 0; }

static hg_status loop(run *r, bool *interrupted)
{
    const hg_train_options *options = r->options;
    r->loss = (double)NAN; /* until a step is made: a finished run may be resumed */
    r->started = r->logged = seconds_now();
    r->first_step = r->logged_step = r->state.step;
    *interrupted = false;
    r->early = out_of_patience(r);
    while (!r->early && r->state.step < options->steps) {
        if (options->stop && options->stop(options->stop_self)) {
            *interrupted = true;
            return save(r, r->checkpoint);
        }
        if (options->minutes > 0 && elapsed(r) >= 60 * options->minutes) break;
        hg_report report = { 0 };
        double norm = 0, rate = 0;
        HG_TRY(one_step(r, &report, &norm, &rate));
        const int64_t step = r->state.step;
        if (step == r->first_step + 1) HG_TRY(look(r, &norm)); /* so that the progress has a loss to show */
        if (every(step, options->log_every) || step == options->steps) {
            HG_TRY(look(r, &norm));
            HG_TRY(write_log(r, &report, norm, rate));
        }
        if (every(step, options->validate_every) && step != options->steps) {
            HG_TRY(validate(r));
            if (out_of_patience(r)) {
                r->early = true;
                HG_TRY(hg_run_log_note(r->log, step, "note", "stopped early: the validation no longer gets better"));
                return save(r, r->checkpoint);
            }
        }
        if (every(step, options->checkpoint_every) && step != options->steps) HG_TRY(save(r, r->checkpoint));
        tell(r);
    }
    HG_TRY(validate(r));
    return save(r, r->checkpoint);
}

/* What a run that was killed while it wrote has left beside a file: it never got the file's name. */
static hg_status remove_leftovers(const char *path)
{
    char *pattern = hg_format("%s.part-*", path);
    glob_t found = { 0 };
    if (!pattern) return HG_MEMORY;
    if (glob(pattern, 0, NULL, &found) == 0)
        for (size_t i = 0; i < found.gl_pathc; i++) remove(found.gl_pathv[i]);
    globfree(&found);
    hg_free(pattern);
    return HG_OK;
}

/* Fine-tuning: other weights than random ones to begin with. */
static hg_status start(run *r)
{
    const char *from = r->options->start_from;
    if (!from || !from[0]) return HG_OK;
    HG_TRY(hg_state_start(from, r->model, r->task));
    hg_average_destroy(r->average); /* it began with the random ones */
    r->average = NULL;
    return r->options->ema > 0 ? hg_average_create(&r->average, r->ctx, r->model->n_params, r->model->params) : HG_OK;
}

static hg_status prepare(run *r)
{
    const char *folder = r->options->folder;
    r->state.best_validation = INFINITY;
    r->batch = hg_alloc(1, r->task->batch_bytes ? r->task->batch_bytes : 1);
    if (!r->batch) return HG_MEMORY;
    const char *backend = r->options->backend ? r->options->backend : "";
    const bool said = hg_ctx_host(r->ctx) || strstr(backend, hg_ctx_device(r->ctx));
    r->backend = said ? hg_strdup(backend) : hg_format("%s on %s", backend, hg_ctx_device(r->ctx));
    if (!r->backend) return HG_MEMORY;
    HG_TRY(hg_adam_create(&r->adam, r->ctx, r->model->n_params, r->model->params));
    if (r->options->ema > 0) HG_TRY(hg_average_create(&r->average, r->ctx, r->model->n_params, r->model->params));
    if (!folder) return start(r);
    HG_TRY(hg_folder_create(folder));
    r->checkpoint = hg_path_join(folder, "checkpoint.h5");
    r->best = hg_path_join(folder, "best.h5");
    r->report = hg_path_join(folder, "report.json");
    if (!r->checkpoint || !r->best || !r->report) return HG_MEMORY;
    HG_TRY(remove_leftovers(r->checkpoint));
    HG_TRY(remove_leftovers(r->best));
    HG_TRY(resume(r));
    if (!r->resumed) HG_TRY(start(r));
    HG_TRY(hg_run_log_open(&r->log, folder, r->state.step));
    if (r->options->tensorboard) HG_TRY(hg_events_open(&r->events, folder, r->state.step));
    char device[192];
    snprintf(device, sizeof device, "%s%s%s", hg_ctx_device(r->ctx), hg_ctx_host(r->ctx) ? "" : ": ",
             hg_ctx_device_what(r->ctx));
    HG_TRY(hg_run_log_note(r->log, r->state.step, "device", device));
    if (r->options->backend) HG_TRY(hg_run_log_note(r->log, r->state.step, "backend", r->options->backend));
    if (r->options->backend_note && r->options->backend_note[0])
        HG_TRY(hg_run_log_note(r->log, r->state.step, "backend_note", r->options->backend_note));
    if (r->options->note) HG_TRY(hg_run_log_note(r->log, r->state.step, "note", r->options->note));
    if (r->options->minutes > 0)
        HG_TRY(hg_run_log_note(r->log, r->state.step, "note",
                               "a time limit steers the learning rate: this run cannot be repeated bit for bit"));
    return HG_OK;
}

static hg_status finish(run *r)
{
    if (!r->report) return HG_OK;
    hg_report report = { 0 };
    hg_report_add(&report, "steps", (double)r->state.step);
    hg_report_add(&report, "training_seconds", elapsed(r));
    hg_report_add(&report, "best_validation", r->state.best_validation);
    for (int i = 0; i < r->last.n; i++) hg_report_add(&report, r->last.item[i].name, r->last.item[i].value);
    for (int i = 0; i < r->validated.n; i++)
        hg_report_add(&report, r->validated.item[i].name, r->validated.item[i].value);
    return hg_report_write(r->report, &report);
}

hg_status hg_train(hg_ctx *ctx, hg_model *model, const hg_task *task, const hg_train_options *options,
                   const hg_progress *progress, hg_train_result *result)
{
    if (options->steps < 1)
        return hg_fail(HG_INVALID, "trainer: %lld steps; at least 1 is needed", (long long)options->steps);
    run r = { .ctx = ctx, .model = model, .task = task, .options = options, .progress = progress };
    bool interrupted = false;
    hg_status status = prepare(&r);
    if (status == HG_OK) status = loop(&r, &interrupted);
    if (status == HG_OK) status = finish(&r);
    if (status == HG_OK) status = hg_average_exchange(r.average); /* what the caller goes on with */
    if (result)
        *result = (hg_train_result){ .steps = r.state.step,
                                     .seconds = r.started > 0 ? elapsed(&r) : 0,
                                     .loss = r.loss,
                                     .best_validation = r.state.best_validation,
                                     .interrupted = interrupted,
                                     .early = r.early };
    hg_run_log_close(r.log);
    hg_events_close(r.events);
    hg_adam_destroy(r.adam);
    hg_average_destroy(r.average);
    hg_free(r.batch);
    hg_free(r.backend);
    hg_free(r.checkpoint);
    hg_free(r.best);
    hg_free(r.report);
    return status;
}
