/* A Neuralocks run on a device against the processor: training, evaluation, drape, export; the same bits twice, and no waiting
 * between two lines of the log. */
#include "hairgrad.h"
#include "tests/test.h"
#include "tests/device.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char tiny[] = "scene: { style: wavy, strands: 40, vertices: 8, seconds: 1 s, motion_kinds: [shake], "
                           "held_out_kinds: [turn] }\n"
                           "model: { width: 16 }\n"
                           "features: { history: 2, latent: 4, lock_size: 16, encoder_width: 16, encoder_steps: 20 }\n"
                           "losses:\n"
                           "  stretch: {}\n"
                           "  bend_twist: {}\n"
                           "  gravity: {}\n"
                           "  inertia: {}\n"
                           "  drag: {}\n"
                           "  body_collision: { mode: exact }\n"
                           "training: { strands: 32, frames: 2, steps: 100, warm_up: 10, log_every: 20, "
                           "validate_every: 50, validation_frames: 2, checkpoint_every: 50 }\n";
enum { STEPS = 100, EVERY = 20, LOGGED = STEPS / EVERY };

#define OK(call_)                                                                                                      \
    do {                                                                                                               \
        if ((call_) != HG_OK) fail_msg("%s", hg_message());                                                            \
    } while (0)

static void path_of(char path[400], const char *run, const char *file)
{
    snprintf(path, 400, "%s/%s%s%s", test_folder(), run, file ? "/" : "", file ? file : "");
}

static hg_ctx *make_ctx(const char *device)
{
    hg_ctx *ctx = NULL;
    OK(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .seed = 1, .device = device }));
    return ctx;
}

/* ---- a run ---- */

typedef struct {
    hg_ctx *ctx;
    int64_t steps, waits[STEPS + 1];
} watch;

/* The trainer asks once a step whether to stop. */
static bool look(void *self)
{
    watch *w = self;
    if (w->steps <= STEPS) w->waits[w->steps++] = hg_ctx_counts(w->ctx).waits;
    return false;
}

typedef struct {
    double loss[LOGGED], gravity[LOGGED], best;
    uint64_t weights;
} trained;

static double number_of(const char *line, const char *key)
{
    const char *at = strstr(line, key);
    if (!at) fail_msg("%s is not in %s", key, line);
    return strtod(at + strlen(key), NULL);
}

static void read_log(const char *run, trained *out)
{
    char path[400];
    char *text = NULL;
    size_t size;
    int n = 0;
    path_of(path, run, "log.jsonl");
    OK(hg_file_read(path, (void **)&text, &size));
    for (char *line = strtok(text, "\n"); line; line = strtok(NULL, "\n")) {
        if (!strstr(line, "\"gradient_norm\"")) continue;
        assert_true(n < LOGGED);
        out->loss[n] = number_of(line, "\"loss\": ");
        out->gravity[n++] = number_of(line, "\"loss.gravity\": ");
    }
    assert_int_equal(n, LOGGED);
    hg_free(text);
}

static uint64_t hash_of(const hg_model *model)
{
    uint64_t hash = 0;
    for (int i = 0; i < model->n_params; i++) {
        const size_t bytes = hg_tensor_bytes(model->params[i]);
        void *values = hg_alloc(1, bytes);
        OK(hg_tensor_read(model->params[i], values));
        hash = hg_hash(values, bytes, hash);
        hg_free(values);
    }
    return hash;
}

static hg_hair_task *make_task(hg_ctx *ctx, const char *run, const char *const (*set)[2])
{
    int n;
    const hg_config_row *rows = hg_hair_schema(&n);
    hg_config *config = NULL;
    hg_hair_task *task = NULL;
    char path[400];
    path_of(path, run ? run : "", NULL);
    OK(hg_config_parse(&config, tiny, "tiny.yaml", rows, n));
    for (; set && (*set)[0]; set++) OK(hg_config_set(config, (*set)[0], (*set)[1]));
    OK(hg_hair_task_create(&task, ctx, config, run ? path : NULL, NULL));
    hg_config_destroy(config);
    return task;
}

static trained run(const char *device, const char *name, watch *seen)
{
    hg_ctx *ctx = make_ctx(device);
    hg_hair_task *task = make_task(ctx, name, NULL);
    hg_train_options options = hg_hair_train_options(task);
    *seen = (watch){ .ctx = ctx };
    options.stop = look;
    options.stop_self = seen;
    hg_train_result result;
    OK(hg_train(ctx, hg_hair_model(task), hg_hair_task_of(task), &options, NULL, &result));
    trained out = { .best = result.best_validation, .weights = hash_of(hg_hair_model(task)) };
    read_log(name, &out);
    hg_hair_task_destroy(task);
    hg_ctx_destroy(ctx);
    return out;
}

static void trains_like_the_processor(void **state)
{
    (void)state;
    watch seen;
    const trained host = run("cpu", "host", &seen), device = run(test_device(), "device", &seen),
                  again = run(test_device(), "again", &(watch){ 0 });
    for (int i = 0; i < LOGGED; i++) {
        if (!(fabs(host.loss[i] - device.loss[i]) < 1e-3 * fmax(fabs(host.loss[i]), 1)))
            fail_msg("loss %.9g at line %d of the log, %.9g on the processor", device.loss[i], i, host.loss[i]);
        assert_true(fabs(host.gravity[i] - device.gravity[i]) < 1e-3 * fabs(host.gravity[i]));
        assert_true(device.loss[i] == again.loss[i]);
    }
    assert_true(host.loss[LOGGED - 1] < host.loss[0]);
    assert_true(fabs(host.best - device.best) < 1e-3 * fabs(host.best));
    assert_true(device.weights == again.weights);
    assert_int_equal(seen.steps, STEPS);
    for (int i = 1; i < STEPS; i++) /* before step i + 1: what step i waited for */
        if (i > 2 && i % EVERY && seen.waits[i] != seen.waits[i - 1])
            fail_msg("step %d waited %lld times for the device", i, (long long)(seen.waits[i] - seen.waits[i - 1]));
}

/* Everything that a config can change of what is made on the device: several grooms, strands drawn anew, outputs that turn edges,
 * materials that are inputs and learnt ones, a moving average, what has no gravity to count from the roots, and runs of frames
 * with orientations and ghosts. */
static void variants_train_too(void **state)
{
    (void)state;
    static const char *const grooms[][2] = { { "scene.grooms", "[wavy, short]" },
                                             { "training.frames", "3" },
                                             { "training.resample_every", "4" },
                                             { NULL, NULL } };
    static const char *const turned[][2] = { { "model.output", "directions" },
                                             { "model.pinned", "2" },
                                             { "features.materials.bend_twist.stiffness", "[1e-9 N*m^2, 1e-8 N*m^2]" },
                                             { "losses.drag.learn", "[c]" },
                                             { "training.ema", "0.9" },
                                             { NULL, NULL } };
    static const char *const light[][2] = { { "losses.gravity.weight", "0" },
                                            { "model.output", "edges" },
                                            { "losses.self_collision.weight", "1" },
                                            { NULL, NULL } };
    static const char *const rods[][2] = { { "losses.cosserat_stretch_shear.weight", "1" },
                                           { "losses.cosserat_bend_twist.weight", "1" },
                                           { "losses.unit_quaternion.weight", "1" },
                                           { "losses.pose_reg.weight", "1" },
                                           { "losses.integrity.weight", "1" },
                                           { "training.frames", "4" },
                                           { "training.consecutive", "2" },
                                           { "scene.grooms", "[wavy, short]" },
                                           { NULL, NULL } };
    const char *const(*const variants[])[2] = { grooms, turned, light, rods };
    for (int v = 0; v < 4; v++) {
        double loss[2], best[2];
        for (int k = 0; k < 2; k++) {
            hg_ctx *ctx = make_ctx(k ? test_device() : "cpu");
            hg_hair_task *task = make_task(ctx, NULL, variants[v]);
            hg_train_options options = hg_hair_train_options(task);
            options.steps = 10;
            hg_train_result result;
            OK(hg_train(ctx, hg_hair_model(task), hg_hair_task_of(task), &options, NULL, &result));
            loss[k] = result.loss;
            best[k] = result.best_validation;
            hg_hair_task_destroy(task);
            hg_ctx_destroy(ctx);
        }
        if (!(fabs(loss[1] - loss[0]) < 1e-3 * fmax(fabs(loss[0]), 1e-3)) ||
            !(fabs(best[1] - best[0]) < 1e-3 * fmax(fabs(best[0]), 1e-3)))
            fail_msg("variant %d: loss %.9g and validation %.9g, %.9g and %.9g on the processor", v, loss[1], best[1],
                     loss[0], best[0]);
    }
}

/* ---- what a trained network is used for ---- */

typedef struct {
    float x[3][40 * 8 * 3];
    int n;
} draped;

static hg_status keep(void *self, const hg_drape_frame *frame)
{
    draped *d = self;
    assert_true(frame->strands == 40 && frame->vertices == 8 && d->n < 3);
    memcpy(d->x[d->n++], frame->x, sizeof d->x[0]);
    return HG_OK;
}

typedef struct {
    hg_hair_metrics metrics;
    draped drape;
    void *onnx;
    size_t onnx_size;
} used;

static void use(const char *device, const char *name, used *out)
{
    hg_ctx *ctx = make_ctx(device);
    hg_hair_task *task = NULL;
    char path[400];
    double shape[HG_SHAPES];
    path_of(path, "host", NULL);
    OK(hg_hair_task_open(&task, ctx, path, NULL));
    hg_hair_held_out_shape(task, 0, shape);
    const hg_motion *clip = hg_hair_clip(task, true, 0);
    OK(hg_hair_evaluate(task, ctx, clip, shape, 8, &out->metrics, NULL));
    out->drape.n = 0;
    OK(hg_hair_drape(task, ctx, clip, shape, 4, 3, 1, keep, &out->drape, NULL));
    assert_int_equal(out->drape.n, 3);
    path_of(path, name, NULL);
    OK(hg_export_hair_onnx(task, ctx, path));
    OK(hg_file_read(path, &out->onnx, &out->onnx_size));
    hg_hair_task_destroy(task);
    hg_ctx_destroy(ctx);
}

static void close_to(double a, double b, double relative, double least, const char *what)
{
    if (!(fabs(a - b) <= fmax(relative * fabs(b), least))) fail_msg("%s: %.9g, %.9g on the processor", what, a, b);
}

static void is_used_like_on_the_processor(void **state)
{
    (void)state;
    used *host = calloc(1, sizeof *host), *device = calloc(1, sizeof *device);
    assert_non_null(host);
    assert_non_null(device);
    use("cpu", "host.onnx", host);
    use(test_device(), "device.onnx", device);
    const hg_hair_metrics *a = &device->metrics, *b = &host->metrics;
    close_to(a->length_error, b->length_error, 1e-3, 1e-6, "length error");
    close_to(a->orientation, b->orientation, 1e-3, 1e-5, "orientation");
    close_to(a->inside, b->inside, 0, 0.5, "inside");
    close_to(a->energy, b->energy, 1e-3, 0, "energy");
    close_to(a->energy_posed, b->energy_posed, 1e-3, 1e-12, "energy of the posed groom");
    close_to(a->tip_amplitude, b->tip_amplitude, 1e-3, 1e-6, "tip amplitude");
    double moved = 0;
    for (int t = 0; t < 3; t++)
        for (int i = 0; i < 40 * 8 * 3; i++) {
            if (!(fabs((double)device->drape.x[t][i] - (double)host->drape.x[t][i]) < 1e-5))
                fail_msg("frame %d, number %d of the drape: %.9g, %.9g on the processor", t, i,
                         (double)device->drape.x[t][i], (double)host->drape.x[t][i]);
            moved = fmax(moved, fabs((double)host->drape.x[t][i] - (double)host->drape.x[0][i]));
        }
    assert_true(moved > 1e-4);
    assert_int_equal(device->onnx_size, host->onnx_size);
    assert_memory_equal(device->onnx, host->onnx, host->onnx_size);
    hg_free(host->onnx);
    hg_free(device->onnx);
    free(host);
    free(device);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(trains_like_the_processor),
        cmocka_unit_test(variants_train_too),
        cmocka_unit_test(is_used_like_on_the_processor),
    };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
