/* train: Adam against plain loops, a toy task, resume to the bit, threads, killed checkpoints, refusals. */
#include "hairgrad.h"

#include "device.h"

#include <math.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>
#include <cmocka.h>

static char folder[256];

static int make_folder(void **state)
{
    (void)state;
    snprintf(folder, sizeof folder, "%s/hairgrad_train_XXXXXX", getenv("TMPDIR") ? getenv("TMPDIR") : "/tmp");
    return mkdtemp(folder) ? 0 : -1;
}

static int remove_folder(void **state)
{
    (void)state;
    char command[600];
    snprintf(command, sizeof command, "chmod -R u+w '%s'; rm -rf '%s'", folder, folder);
    return system(command) == 0 ? 0 : -1;
}

static hg_ctx *make_ctx_on(const char *device, int threads)
{
    hg_ctx *ctx = NULL;
    const hg_ctx_options options = { .threads = threads, .seed = 3, .device = device };
    assert_int_equal(hg_ctx_create(&ctx, &options), HG_OK);
    return ctx;
}

static hg_ctx *make_ctx(int threads) { return make_ctx_on(test_device(), threads); }

/* ---- Adam --------------------------------------------------------------------------------------------------- */

enum { SMALL = 5, LARGE = 9001 };

/* Random numbers; `bad` in one element (-1: none). They come back, to be freed. */
static float *set_gradient(hg_tensor *param, uint64_t step, int64_t at, float bad)
{
    const int64_t count = hg_tensor_count(param);
    float *g = malloc((size_t)count * sizeof *g);
    for (int64_t i = 0; i < count; i++)
        g[i] = i == at ? bad : (float)hg_random_normal(1, (uint64_t)count, step * 100000 + (uint64_t)i);
    assert_int_equal(hg_tensor_write(hg_grad(param), g), HG_OK);
    return g;
}

static float *numbers_of(const hg_tensor *tensor)
{
    float *numbers = malloc(hg_tensor_bytes(tensor) + 1);
    assert_int_equal(hg_tensor_read(tensor, numbers), HG_OK);
    return numbers;
}

static void adam_matches_plain_loops(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(2);
    hg_tensor *params[2] = { hg_tensor_create(ctx, HG_F32, 1, (int64_t[]){ SMALL }),
                             hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ LARGE / 3, 3 }) };
    const int64_t count[2] = { SMALL, LARGE / 3 * 3 };
    double *value[2], *m[2], *v[2];
    for (int p = 0; p < 2; p++) {
        assert_int_equal(hg_require_grad(params[p]), HG_OK);
        value[p] = calloc((size_t)count[p], sizeof(double));
        m[p] = calloc((size_t)count[p], sizeof(double));
        v[p] = calloc((size_t)count[p], sizeof(double));
    }
    hg_adam *adam = NULL;
    assert_int_equal(hg_adam_create(&adam, ctx, 2, params), HG_OK);
    const double rate = 1e-2, beta1 = 0.9, beta2 = 0.999, epsilon = 1e-8, decay = 0.01, clip = 50;
    for (int step = 1; step <= 10; step++) {
        double squares = 0, norm = 0;
        float *gradient[2];
        for (int p = 0; p < 2; p++) {
            gradient[p] = set_gradient(params[p], (uint64_t)step, -1, 0);
            for (int64_t i = 0; i < count[p]; i++) squares += pow((double)gradient[p][i], 2);
        }
        const double length = sqrt(squares), scale = length > clip ? clip / length : 1;
        assert_true(scale < 1);
        for (int p = 0; p < 2; p++)
            for (int64_t i = 0; i < count[p]; i++) {
                const double g = scale * (double)gradient[p][i];
                m[p][i] = beta1 * m[p][i] + (1 - beta1) * g;
                v[p][i] = beta2 * v[p][i] + (1 - beta2) * g * g;
                const double m_hat = m[p][i] / (1 - pow(beta1, step)), v_hat = v[p][i] / (1 - pow(beta2, step));
                value[p][i] -= rate * m_hat / (sqrt(v_hat) + epsilon) + rate * decay * value[p][i];
            }
        assert_int_equal(hg_adam_step(adam, rate, beta1, beta2, epsilon, decay, clip, &norm), HG_OK);
        assert_true(fabs(norm - length) < 1e-9 * length);
        for (int p = 0; p < 2; p++) free(gradient[p]);
    }
    for (int p = 0; p < 2; p++) {
        float *found = numbers_of(params[p]);
        for (int64_t i = 0; i < count[p]; i++) assert_true(fabs((double)found[i] - value[p][i]) < 2e-6);
        free(found);
        free(value[p]);
        free(m[p]);
        free(v[p]);
        hg_tensor_destroy(params[p]);
    }
    hg_adam_destroy(adam);
    hg_ctx_destroy(ctx);
}

/* Said at the step on the processor; on a device by hg_adam_check, and no step is made until then. */
static void adam_refuses_what_is_not_finite(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    hg_tensor *params[2] = { hg_tensor_create(ctx, HG_F32, 1, (int64_t[]){ 3000 }),
                             hg_tensor_create(ctx, HG_F32, 1, (int64_t[]){ 3000 }) };
    params[0]->name = "first.weight";
    params[1]->name = "hidden7.weight";
    hg_adam *adam = NULL;
    for (int p = 0; p < 2; p++) hg_require_grad(params[p]);
    assert_int_equal(hg_adam_create(&adam, ctx, 2, params), HG_OK);
    for (int late = 0; late < 2; late++) {
        free(set_gradient(params[0], 1, -1, 0));
        free(set_gradient(params[1], 1, 2999, late ? INFINITY : NAN));
        double norm = 0;
        hg_status status = hg_adam_step(adam, 0.1, 0.9, 0.999, 1e-8, 0, 0, late ? NULL : &norm);
        if (late && !hg_ctx_host(ctx)) {
            assert_int_equal(status, HG_OK);
            free(set_gradient(params[1], 2, -1, 0));
            assert_int_equal(hg_adam_step(adam, 0.1, 0.9, 0.999, 1e-8, 0, 0, NULL), HG_OK);
            status = hg_adam_check(adam, &norm);
        }
        assert_int_equal(status, HG_NUMERIC);
        if (!strstr(hg_message(), "hidden7.weight is not finite at step 1")) fail_msg("%s", hg_message());
        for (int p = 0; p < 2; p++)
            for (int i = 0; i < 3000; i += 77) assert_true(hg_tensor_item(params[p], i) == 0);
    }
    for (int p = 0; p < 2; p++) free(set_gradient(params[p], 1, -1, 0));
    assert_int_equal(hg_adam_step(adam, 0.1, 0.9, 0.999, 1e-8, 0, 0, NULL), HG_OK);
    assert_int_equal(hg_adam_check(adam, NULL), HG_OK);
    for (int i = 0; i < 3000; i += 77)
        assert_true(fabs(fabs(hg_tensor_item(params[1], i)) - 0.1) < 1e-5); /* the first step is the rate */
    hg_adam_destroy(adam);
    for (int p = 0; p < 2; p++) hg_tensor_destroy(params[p]);
    hg_ctx_destroy(ctx);
}

/* ---- a toy task --------------------------------------------------------------------------------------------- */

enum { ROWS = 32, INPUTS = 5, OUTPUTS = 3 };

typedef struct {
    float x[ROWS * INPUTS], y[ROWS * OUTPUTS];
} toy_batch;

static hg_status toy_sample(void *self, hg_ctx *ctx, uint64_t seed, uint64_t step, void *bytes)
{
    (void)self, (void)ctx;
    toy_batch *batch = bytes;
    for (int r = 0; r < ROWS; r++) {
        float *x = batch->x + r * INPUTS;
        for (int i = 0; i < INPUTS; i++)
            x[i] = (float)hg_random_normal(seed, 50, (step * ROWS + (uint64_t)r) * INPUTS + (uint64_t)i);
        for (int k = 0; k < OUTPUTS; k++) batch->y[r * OUTPUTS + k] = sinf(x[k]) * x[k + 1];
    }
    return HG_OK;
}

static hg_tensor *toy_loss(void *self, hg_ctx *ctx, hg_model *model, const void *bytes, hg_report *report)
{
    (void)self, (void)report;
    const toy_batch *batch = bytes;
    hg_tensor *x = hg_tensor_from(ctx, HG_F32, 2, (int64_t[]){ ROWS, INPUTS }, batch->x);
    hg_tensor *y = hg_tensor_from(ctx, HG_F32, 2, (int64_t[]){ ROWS, OUTPUTS }, batch->y);
    return hg_mean(ctx, hg_square(ctx, hg_sub(ctx, model->forward(model->self, ctx, &x, 1), y)));
}

static hg_status toy_validate(void *self, hg_ctx *ctx, hg_model *model, hg_report *report)
{
    toy_batch batch;
    toy_sample(self, ctx, 999, 0, &batch);
    hg_no_grad_begin(ctx);
    const hg_tensor *loss = toy_loss(self, ctx, model, &batch, NULL);
    hg_no_grad_end(ctx);
    if (loss) hg_report_add(report, "validation", hg_tensor_item(loss, 0));
    return hg_ctx_status(ctx);
}

static const hg_task toy = {
    .batch_bytes = sizeof(toy_batch), .sample = toy_sample, .loss = toy_loss, .validate = toy_validate
};

static hg_train_options toy_options(void)
{
    hg_train_options options = hg_train_defaults();
    options.steps = 120;
    options.learning_rate = 5e-3;
    options.warm_up = 10;
    options.log_every = 10;
    options.validate_every = 40;
    options.checkpoint_every = 25;
    options.backend = "toy";
    options.config_hash = 0xfedcba9876543210u;
    return options;
}

typedef struct {
    int64_t at, asked;
} stop_at;

static bool stop_now(void *self)
{
    stop_at *stop = self;
    return stop->asked++ == stop->at;
}

static hg_model *toy_model(hg_ctx *ctx)
{
    hg_model *model = NULL;
    const hg_model_spec spec = {
        .inputs = INPUTS, .outputs = OUTPUTS, .width = 48, .depth = 2, .activation = HG_TANH, .seed = 8
    };
    assert_int_equal(hg_model_create(&model, ctx, "neuralocks", &spec), HG_OK);
    return model;
}

static float *weights_of(const hg_model *model, size_t *bytes)
{
    *bytes = 0;
    for (int i = 0; i < model->n_params; i++) *bytes += hg_tensor_bytes(model->params[i]);
    char *weights = malloc(*bytes);
    for (int i = 0, at = 0; i < model->n_params; at += (int)hg_tensor_bytes(model->params[i]), i++)
        assert_int_equal(hg_tensor_read(model->params[i], weights + at), HG_OK);
    return (float *)(void *)weights;
}

/* Trains the toy in `name` (NULL: no folder) and returns its weights. */
static float *toy_run(const char *name, int threads, hg_train_options options, hg_train_result *result, size_t *bytes)
{
    hg_ctx *ctx = make_ctx(threads);
    hg_model *model = toy_model(ctx);
    char path[320];
    snprintf(path, sizeof path, "%s/%s", folder, name ? name : "");
    options.folder = name ? path : NULL;
    assert_int_equal(hg_train(ctx, model, &toy, &options, NULL, result), HG_OK);
    float *weights = weights_of(model, bytes);
    hg_model_destroy(model);
    hg_ctx_destroy(ctx);
    return weights;
}

static void toy_is_learnt(void **state)
{
    (void)state;
    hg_train_result result;
    size_t bytes;
    hg_train_options options = toy_options();
    options.steps = 400;
    free(toy_run("learn", 2, options, &result, &bytes));
    assert_int_equal(result.steps, 400);
    assert_true(result.best_validation < 0.1); /* the mean square of the target is 0.4 */
    assert_false(result.interrupted);
    char path[320];
    const char *const files[] = { "checkpoint.h5", "best.h5", "log.jsonl", "report.json" };
    for (int i = 0; i < 4; i++) {
        snprintf(path, sizeof path, "%s/learn/%s", folder, files[i]);
        assert_true(hg_file_exists(path));
    }
    void *log = NULL;
    size_t size;
    snprintf(path, sizeof path, "%s/learn/log.jsonl", folder);
    assert_int_equal(hg_file_read(path, &log, &size), HG_OK);
    assert_non_null(strstr(log, "{\"step\": 400, \"loss\": "));
    assert_non_null(strstr(log, "\"gradient_norm\": "));
    assert_non_null(strstr(log, "\"learning_rate\": "));
    assert_non_null(strstr(log, "\"backend\": \"toy\""));
    hg_free(log);
}

static void threads_do_not_matter(void **state)
{
    (void)state;
    hg_train_result result;
    size_t bytes, same;
    float *one = toy_run(NULL, 1, toy_options(), &result, &bytes),
          *two = toy_run(NULL, 2, toy_options(), &result, &same);
    assert_int_equal(bytes, same);
    assert_memory_equal(one, two, bytes);
    free(one);
    free(two);
}

/* The same steps by hand, nothing recorded and each of them waited for, give the same bits as the trainer's; and a device is
 * waited for by the trainer where it logs, not in its steps. */
static void trainer_equals_steps_by_hand(void **state)
{
    (void)state;
    hg_train_options options = toy_options();
    options.steps = 30;
    options.warm_up = 0;
    options.final_fraction = 1;
    options.validate_every = options.checkpoint_every = 0;
    size_t bytes, same;
    float *weights[2];
    for (int by_hand = 0; by_hand < 2; by_hand++) {
        hg_ctx *ctx = make_ctx(2);
        hg_model *model = toy_model(ctx);
        hg_task task = toy;
        task.validate = NULL;
        if (by_hand) {
            hg_adam *adam = NULL;
            toy_batch batch;
            assert_int_equal(hg_adam_create(&adam, ctx, model->n_params, model->params), HG_OK);
            for (uint64_t step = 0; step < 30; step++) {
                double norm = 0;
                hg_step_reset(ctx);
                assert_int_equal(toy_sample(NULL, ctx, hg_ctx_seed(ctx), step, &batch), HG_OK);
                assert_int_equal(hg_backward(ctx, toy_loss(NULL, ctx, model, &batch, NULL)), HG_OK);
                assert_int_equal(hg_adam_step(adam, options.learning_rate, options.beta1, options.beta2,
                                              options.epsilon, options.weight_decay, options.clip, &norm),
                                 HG_OK);
                assert_true(norm > 0);
            }
            hg_adam_destroy(adam);
        } else {
            assert_int_equal(hg_train(ctx, model, &task, &options, NULL, NULL), HG_OK);
            const hg_device_counts counts = hg_ctx_counts(ctx);
            if (!hg_ctx_host(ctx)) assert_true(counts.replays >= 20);
            assert_int_equal(counts.waits, 0);
        }
        weights[by_hand] = weights_of(model, by_hand ? &same : &bytes);
        hg_model_destroy(model);
        hg_ctx_destroy(ctx);
    }
    assert_int_equal(bytes, same);
    assert_memory_equal(weights[0], weights[1], bytes);
    free(weights[0]);
    free(weights[1]);
}

/* A hundred steps on a device come to the processor's weights. */
static void devices_agree(void **state)
{
    (void)state;
    if (!test_device()) skip();
    hg_train_options options = toy_options();
    options.steps = 100;
    hg_train_result result[2];
    size_t bytes;
    float *weights[2];
    for (int i = 0; i < 2; i++) {
        hg_ctx *ctx = make_ctx_on(i ? test_device() : "cpu", 2);
        hg_model *model = toy_model(ctx);
        assert_int_equal(hg_train(ctx, model, &toy, &options, NULL, &result[i]), HG_OK);
        weights[i] = weights_of(model, &bytes);
        hg_model_destroy(model);
        hg_ctx_destroy(ctx);
    }
    assert_true(result[0].loss > 0 && fabs(result[1].loss - result[0].loss) <= 1e-3 * result[0].loss);
    assert_true(fabs(result[1].best_validation - result[0].best_validation) <= 1e-3 * result[0].best_validation);
    double largest = 0, worst = 0;
    for (size_t i = 0; i < bytes / sizeof(float); i++) {
        largest = fmax(largest, fabs((double)weights[0][i]));
        worst = fmax(worst, fabs((double)weights[1][i] - (double)weights[0][i]));
    }
    if (!(worst <= 1e-3 * largest)) fail_msg("weights of %g differ by %g", largest, worst);
    free(weights[0]);
    free(weights[1]);
}

/* A loss that is not finite ends a training, on a device when it is next looked at; the weights are those of before. */
static hg_tensor *bad_loss(void *self, hg_ctx *ctx, hg_model *model, const void *bytes, hg_report *report)
{
    int *step = self;
    hg_tensor *loss = toy_loss(NULL, ctx, model, bytes, report);
    return (*step)++ == 4 ? hg_log(ctx, hg_scale(ctx, loss, 0, -1)) : loss;
}

static void bad_loss_ends_a_training(void **state)
{
    (void)state;
    size_t bytes;
    float *weights[2];
    for (int bad = 0; bad < 2; bad++) {
        hg_ctx *ctx = make_ctx(1);
        hg_model *model = toy_model(ctx);
        hg_train_options options = toy_options();
        int step = bad ? 0 : 10;
        hg_task task = { .self = &step, .batch_bytes = sizeof(toy_batch), .sample = toy_sample, .loss = bad_loss };
        options.steps = bad ? 30 : 4;
        options.final_fraction = 1;
        const hg_status status = hg_train(ctx, model, &task, &options, NULL, NULL);
        assert_int_equal(status, bad ? HG_NUMERIC : HG_OK);
        if (bad && !strstr(hg_message(), "at step 5")) fail_msg("%s", hg_message());
        weights[bad] = weights_of(model, &bytes);
        hg_model_destroy(model);
        hg_ctx_destroy(ctx);
    }
    assert_memory_equal(weights[0], weights[1], bytes);
    free(weights[0]);
    free(weights[1]);
}

static int lines(const char *name)
{
    char path[320];
    void *text = NULL;
    size_t size;
    int n = 0;
    snprintf(path, sizeof path, "%s/%s/log.jsonl", folder, name);
    assert_int_equal(hg_file_read(path, &text, &size), HG_OK);
    for (size_t i = 0; i < size; i++) n += ((char *)text)[i] == '\n' && i > 0;
    hg_free(text);
    return n;
}

static void resumed_equals_uninterrupted(void **state)
{
    (void)state;
    hg_train_result whole, part;
    size_t bytes, same;
    hg_train_options options = toy_options();
    options.ema = 0.95; /* the average is in the checkpoint too */
    float *expected = toy_run("whole", 2, options, &whole, &bytes);
    stop_at stop = { .at = 67 };
    options.stop = stop_now;
    options.stop_self = &stop;
    free(toy_run("parts", 2, options, &part, &same));
    assert_true(part.interrupted);
    assert_int_equal(part.steps, 67);
    options.resume = true;
    stop = (stop_at){ .at = 20 };
    free(toy_run("parts", 1, options, &part, &same));
    assert_int_equal(part.steps, 87);
    options.stop = NULL;
    float *found = toy_run("parts", 2, options, &part, &same);
    assert_int_equal(part.steps, 120);
    assert_int_equal(bytes, same);
    assert_memory_equal(expected, found, bytes);
    assert_true(part.best_validation == whole.best_validation);
    /* the two runs more each note their back end, and nothing else is logged twice */
    assert_int_equal(lines("parts"), lines("whole") + 4);
    free(expected);
    free(found);
}

static void resume_refuses(void **state)
{
    (void)state;
    hg_train_result result;
    size_t bytes;
    hg_train_options options = toy_options();
    options.steps = 30;
    free(toy_run("refuse", 1, options, &result, &bytes));
    hg_ctx *ctx = make_ctx(1);
    hg_model *model = NULL, *wide = NULL;
    hg_model_spec spec = {
        .inputs = INPUTS, .outputs = OUTPUTS, .width = 48, .depth = 2, .activation = HG_TANH, .seed = 8
    };
    assert_int_equal(hg_model_create(&model, ctx, "neuralocks", &spec), HG_OK);
    spec.width = 49;
    assert_int_equal(hg_model_create(&wide, ctx, "neuralocks", &spec), HG_OK);
    char path[320];
    snprintf(path, sizeof path, "%s/refuse", folder);
    options.folder = path;
    options.resume = true;
    options.config_hash++;
    assert_int_equal(hg_train(ctx, model, &toy, &options, NULL, NULL), HG_INVALID);
    assert_non_null(strstr(hg_message(), "another config"));
    options.config_hash--;
    options.backend = "other";
    assert_int_equal(hg_train(ctx, model, &toy, &options, NULL, NULL), HG_INVALID);
    assert_non_null(strstr(hg_message(), "toy"));
    options.allow_other_backend = true;
    assert_int_equal(hg_train(ctx, model, &toy, &options, NULL, NULL), HG_OK);
    assert_int_not_equal(hg_train(ctx, wide, &toy, &options, NULL, NULL), HG_OK);
    options.steps = 0;
    assert_int_equal(hg_train(ctx, model, &toy, &options, NULL, NULL), HG_INVALID);
    hg_model_destroy(model);
    hg_model_destroy(wide);
    hg_ctx_destroy(ctx);
}

/* Another device rounds differently: it is refused like another back end. */
static void resume_on_another_device_is_refused(void **state)
{
    (void)state;
    if (!test_device()) skip();
    hg_train_result result;
    size_t bytes;
    char path[320];
    hg_train_options options = toy_options();
    options.steps = 10;
    free(toy_run("device", 1, options, &result, &bytes));
    hg_ctx *host = make_ctx_on("cpu", 1);
    hg_model *model = toy_model(host);
    snprintf(path, sizeof path, "%s/device", folder);
    options.folder = path;
    options.resume = true;
    assert_int_equal(hg_train(host, model, &toy, &options, NULL, NULL), HG_INVALID);
    if (!strstr(hg_message(), "\"toy on cuda\" and this is \"toy\"")) fail_msg("%s", hg_message());
    options.allow_other_backend = true;
    options.steps = 12;
    assert_int_equal(hg_train(host, model, &toy, &options, NULL, &result), HG_OK);
    assert_int_equal(result.steps, 12);
    hg_model_destroy(model);
    hg_ctx_destroy(host);
}

/* ---- checkpoints -------------------------------------------------------------------------------------------- */

static hg_status fail_to_save(void *self, hg_h5 *file)
{
    (void)file;
    if (self) raise(SIGKILL); /* in the middle of the file */
    return hg_fail(HG_IO, "no space left");
}

static void broken_checkpoint_leaves_the_old_one(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    hg_model *model = NULL;
    const hg_model_spec spec = { .inputs = INPUTS, .outputs = OUTPUTS, .width = 8, .depth = 1, .activation = HG_TANH };
    assert_int_equal(hg_model_create(&model, ctx, "neuralocks", &spec), HG_OK);
    char path[320];
    snprintf(path, sizeof path, "%s/kill.h5", folder);
    assert_int_equal(hg_checkpoint_save(path, model, NULL, 41, NULL, "a", 1), HG_OK);
    const double first = hg_tensor_item(model->params[0], 0);
    assert_true(first != 7);
    assert_int_equal(hg_tensor_fill(model->params[0], 7), HG_OK);

    hg_task task = toy;
    task.save = fail_to_save;
    assert_int_equal(hg_checkpoint_save(path, model, NULL, 42, &task, "b", 1), HG_IO);
    const pid_t child = fork();
    if (child == 0) { /* of its own: a GPU cannot be used on after a fork */
        hg_ctx *host = make_ctx_on("cpu", 1);
        task.self = &task;
        if (hg_model_create(&model, host, "neuralocks", &spec) == HG_OK)
            hg_checkpoint_save(path, model, NULL, 43, &task, "c", 1);
        _exit(0);
    }
    int status = 0;
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(WIFSIGNALED(status));

    int64_t step = 0;
    char *backend = NULL;
    uint64_t hash = 0;
    assert_int_equal(hg_checkpoint_load(path, model, NULL, &step, NULL, &backend, &hash), HG_OK);
    assert_int_equal(step, 41);
    assert_string_equal(backend, "a");
    assert_true(hg_tensor_item(model->params[0], 0) == first);
    hg_free(backend);
    hg_model_destroy(model);
    hg_ctx_destroy(ctx);
}

static void wrong_checkpoints_are_refused(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    hg_model *model = NULL, *other = NULL;
    hg_model_spec spec = {
        .inputs = INPUTS, .outputs = OUTPUTS, .width = 8, .depth = 1, .latent = 2, .activation = HG_TANH
    };
    assert_int_equal(hg_model_create(&model, ctx, "neuralocks", &spec), HG_OK);
    assert_int_equal(hg_model_create(&other, ctx, "strand_autoencoder", &spec), HG_OK);
    char path[320];
    snprintf(path, sizeof path, "%s/wrong.h5", folder);
    assert_int_not_equal(hg_checkpoint_load(path, model, NULL, NULL, NULL, NULL, NULL), HG_OK);
    assert_int_equal(hg_file_write(path, "not hdf5", 8), HG_OK);
    assert_int_not_equal(hg_checkpoint_load(path, model, NULL, NULL, NULL, NULL, NULL), HG_OK);
    assert_int_equal(hg_checkpoint_save(path, other, NULL, 1, NULL, "", 1), HG_OK);
    assert_int_equal(hg_checkpoint_load(path, model, NULL, NULL, NULL, NULL, NULL), HG_INVALID);
    assert_non_null(strstr(hg_message(), "strand_autoencoder"));
    hg_model_destroy(model);
    hg_model_destroy(other);
    hg_ctx_destroy(ctx);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(adam_matches_plain_loops),
        cmocka_unit_test(adam_refuses_what_is_not_finite),
        cmocka_unit_test(toy_is_learnt),
        cmocka_unit_test(threads_do_not_matter),
        cmocka_unit_test(trainer_equals_steps_by_hand),
        cmocka_unit_test(devices_agree),
        cmocka_unit_test(bad_loss_ends_a_training),
        cmocka_unit_test(resumed_equals_uninterrupted),
        cmocka_unit_test(resume_refuses),
        cmocka_unit_test(resume_on_another_device_is_refused),
        cmocka_unit_test(broken_checkpoint_leaves_the_old_one),
        cmocka_unit_test(wrong_checkpoints_are_refused),
    };
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
