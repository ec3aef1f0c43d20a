/* train, the rest of it: the moving average of the weights, early stop, TensorBoard events, starting from other weights. */
#include "hairgrad.h"
#include "tests/test.h"
#include "train/log.h"
#include "train/state.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- a task: y = sin(x0) x1 ---------------------------------------------------------------------------------- */

enum { ROWS = 16, INPUTS = 4 };
typedef struct {
    float x[ROWS * INPUTS], y[ROWS];
} batch;

static hg_status sample(void *self, hg_ctx *ctx, uint64_t seed, uint64_t step, void *bytes)
{
    (void)self, (void)ctx;
    batch *b = bytes;
    for (int i = 0; i < ROWS * INPUTS; i++)
        b->x[i] = (float)hg_random_normal(seed, 60, step * ROWS * INPUTS + (uint64_t)i);
    for (int r = 0; r < ROWS; r++) b->y[r] = sinf(b->x[r * INPUTS]) * b->x[r * INPUTS + 1];
    return HG_OK;
}

static hg_tensor *loss(void *self, hg_ctx *ctx, hg_model *model, const void *bytes, hg_report *report)
{
    (void)self, (void)report;
    const batch *b = bytes;
    hg_tensor *x = hg_tensor_wrap(ctx, HG_F32, 2, (int64_t[]){ ROWS, INPUTS }, (void *)(uintptr_t)b->x);
    hg_tensor *y = hg_tensor_wrap(ctx, HG_F32, 2, (int64_t[]){ ROWS, 1 }, (void *)(uintptr_t)b->y);
    return hg_mean(ctx, hg_square(ctx, hg_sub(ctx, model->forward(model->self, ctx, &x, 1), y)));
}

/* What a validation says where it is told so (early stop), else the loss on rows of their own. */
typedef struct {
    int asked, n;
    double first_weight; /* as the last validation saw it */
    const double *told;
} validations;

static hg_status validate(void *self, hg_ctx *ctx, hg_model *model, hg_report *report)
{
    validations *v = self;
    batch b;
    sample(NULL, ctx, 999, 0, &b);
    hg_no_grad_begin(ctx);
    const hg_tensor *value = loss(NULL, ctx, model, &b, NULL);
    hg_no_grad_end(ctx);
    v->first_weight = hg_tensor_item(model->params[0], 0);
    hg_report_add(report, "validation",
                  v->told ? v->told[v->asked < v->n ? v->asked : v->n - 1] : hg_tensor_item(value, 0));
    v->asked++;
    return hg_ctx_status(ctx);
}

static hg_train_options defaults(void)
{
    hg_train_options options = hg_train_defaults();
    options.steps = 60;
    options.learning_rate = 5e-3;
    options.warm_up = 5;
    options.log_every = 10;
    options.validate_every = 20;
    options.checkpoint_every = 15;
    options.config_hash = 7;
    return options;
}

static bool stop_at(void *self) { return (*(int *)self)-- == 0; }

typedef struct {
    float weight[512];
    int n;
    hg_status status;
    hg_train_result result;
} outcome;

static outcome train(const char *name, hg_train_options options, validations *v, int width)
{
    outcome out = { 0 };
    hg_ctx *ctx = NULL;
    hg_model *model = NULL;
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .seed = 3 }), HG_OK);
    const hg_model_spec spec = {
        .inputs = INPUTS, .outputs = 1, .width = width, .depth = 1, .activation = HG_TANH, .seed = 8
    };
    assert_int_equal(hg_model_create(&model, ctx, "neuralocks", &spec), HG_OK);
    char path[320];
    snprintf(path, sizeof path, "%s/%s", test_folder(), name ? name : "");
    options.folder = name ? path : NULL;
    validations own = { 0 };
    const hg_task task = {
        .self = v ? v : &own, .batch_bytes = sizeof(batch), .sample = sample, .loss = loss, .validate = validate
    };
    out.status = hg_train(ctx, model, &task, &options, NULL, &out.result);
    for (int i = 0; i < model->n_params; i++)
        for (int64_t k = 0; k < hg_tensor_count(model->params[i]); k++)
            out.weight[out.n++] = (float)hg_tensor_item(model->params[i], k);
    hg_model_destroy(model);
    hg_ctx_destroy(ctx);
    return out;
}

/* ---- the average --------------------------------------------------------------------------------------------- */

static void the_average_is_what_the_formula_says(void **state)
{
    (void)state;
    const double decay = 0.9;
    double *expected = NULL;
    outcome plain = { 0 };
    for (int steps = 0; steps <= 25; steps++) { /* the weights after each step, without an average */
        hg_train_options options = defaults();
        options.warm_up = 1000; /* so that the rate of a step does not depend on how many there are */
        options.steps = steps ? steps : 1;
        if (!steps) options.learning_rate = 0;
        plain = train(NULL, options, NULL, 12);
        assert_int_equal(plain.status, HG_OK);
        if (!expected) expected = calloc((size_t)plain.n, sizeof *expected);
        const double d = fmin(decay, (1.0 + steps) / (10.0 + steps));
        for (int i = 0; i < plain.n; i++)
            expected[i] = steps ? d * expected[i] + (1 - d) * (double)plain.weight[i] : (double)plain.weight[i];
    }
    hg_train_options options = defaults();
    options.warm_up = 1000;
    options.steps = 25;
    options.ema = decay;
    validations v = { 0 };
    const outcome averaged = train("average", options, &v, 12);
    assert_int_equal(averaged.status, HG_OK);
    double moved = 0;
    for (int i = 0; i < averaged.n; i++) {
        assert_true(fabs((double)averaged.weight[i] - expected[i]) < 1e-6);
        moved = fmax(moved, fabs((double)(averaged.weight[i] - plain.weight[i])));
    }
    assert_true(moved > 1e-5);
    assert_true(v.first_weight == (double)averaged.weight[0]); /* the validation saw the average */
    free(expected);

    /* So does whoever reads the checkpoint. */
    char path[320];
    snprintf(path, sizeof path, "%s/average/checkpoint.h5", test_folder());
    hg_h5 *file = NULL;
    float *weight = NULL;
    assert_int_equal(hg_h5_open(&file, path), HG_OK);
    assert_int_equal(
        hg_h5_read(file, "/model/first.weight", HG_F32, 2, (int64_t[]){ INPUTS, 12 }, NULL, (void **)&weight), HG_OK);
    assert_memory_equal(weight, averaged.weight, INPUTS * 12 * sizeof(float));
    hg_free(weight);
    hg_h5_close(file);
}

static void averaged_runs_resume_to_the_bit(void **state)
{
    (void)state;
    hg_train_options options = defaults();
    options.ema = 0.95;
    const outcome whole = train("whole", options, NULL, 12);
    int left = 37;
    options.stop = stop_at;
    options.stop_self = &left;
    assert_true(train("parts", options, NULL, 12).result.interrupted);
    options.stop = NULL;
    options.resume = true;
    const outcome parts = train("parts", options, NULL, 12);
    assert_int_equal(parts.result.steps, 60);
    assert_memory_equal(whole.weight, parts.weight, sizeof whole.weight);
    assert_true(whole.result.best_validation == parts.result.best_validation);
    options.ema = 0;
    options.config_hash = 8; /* as the config that says so would have */
    const outcome other = train("parts", options, NULL, 12);
    assert_int_equal(other.status, HG_INVALID);
    assert_non_null(strstr(hg_message(), "another config"));
}

/* ---- early stop ---------------------------------------------------------------------------------------------- */

static void patience_ends_a_run(void **state)
{
    (void)state;
    const double told[] = { 5, 4, 4.5, 4.2, 3, 3.5, 3.2, 3.1, 1 };
    validations v = { .told = told, .n = 9 };
    hg_train_options options = defaults();
    options.steps = 100;
    options.validate_every = 10;
    options.patience = 3;
    const outcome out = train("early", options, &v, 8);
    assert_int_equal(out.status, HG_OK);
    assert_true(out.result.early && !out.result.interrupted);
    assert_int_equal(out.result.steps, 80);
    assert_true(out.result.best_validation == 3);
    options.resume = true; /* it stays stopped */
    const outcome again = train("early", options, &v, 8);
    assert_int_equal(again.result.steps, 80);
    assert_true(again.result.early);

    /* Interrupted between the validations that count: the count goes on. */
    v.asked = 0;
    int left = 65;
    options.resume = false;
    options.stop = stop_at;
    options.stop_self = &left;
    assert_true(train("early_parts", options, &v, 8).result.interrupted);
    options.stop = NULL;
    options.resume = true;
    assert_int_equal(train("early_parts", options, &v, 8).result.steps, 80);
}

/* ---- events -------------------------------------------------------------------------------------------------- */

static uint64_t little(const uint8_t *at, int n)
{
    uint64_t value = 0;
    for (int k = 0; k < n; k++) value |= (uint64_t)at[k] << 8 * k;
    return value;
}

static uint64_t varint(const uint8_t **at)
{
    uint64_t value = 0;
    for (int shift = 0;; shift += 7) {
        const uint8_t byte = *(*at)++;
        value |= (uint64_t)(byte & 0x7f) << shift;
        if (!(byte & 0x80)) return value;
    }
}

/* Counts the records of an event file, with everything in them checked; values of `tag` go to values[step / 10]. */
static int read_events(const char *name, const char *tag, double *values)
{
    char path[400];
    void *bytes = NULL;
    size_t size;
    int n = 0;
    snprintf(path, sizeof path, "%s/%s/events.out.tfevents.0000000000.hairgrad", test_folder(), name);
    assert_int_equal(hg_file_read(path, &bytes, &size), HG_OK);
    for (const uint8_t *at = bytes, *end = at + size; at < end; n++) {
        const size_t length = (size_t)little(at, 8);
        assert_true(length + 16 <= (size_t)(end - at));
        for (int part = 0; part < 2; part++) { /* the masked sums of the length and of the message */
            const uint8_t *of = part ? at + 12 : at;
            const uint32_t crc = hg_crc32c(of, part ? length : 8);
            assert_int_equal((uint32_t)little(part ? at + 12 + length : at + 8, 4),
                             (uint32_t)((crc >> 15 | crc << 17) + 0xa282ead8u));
        }
        const uint8_t *m = at + 12, *last = m + length;
        at = last + 4;
        assert_int_equal(*m++, 1 << 3 | 1);
        double wall;
        memcpy(&wall, m, sizeof wall);
        assert_true(wall > 1.6e9);
        m += 8;
        assert_int_equal(*m++, 2 << 3);
        const uint64_t step = varint(&m);
        if (n == 0) {
            assert_int_equal(*m++, 3 << 3 | 2);
            assert_int_equal(varint(&m), 13);
            assert_memory_equal(m, "brain.Event:2", 13);
            assert_true(m + 13 == last);
            continue;
        }
        assert_int_equal(*m++, 5 << 3 | 2);
        const uint64_t summary = varint(&m);
        assert_true(m + summary == last);
        while (m < last) {
            assert_int_equal(*m++, 1 << 3 | 2);
            const uint8_t *value_end = m;
            const uint64_t inner = varint(&value_end);
            m = value_end;
            value_end += inner;
            assert_int_equal(*m++, 1 << 3 | 2);
            const size_t name_length = (size_t)varint(&m);
            const bool wanted = strlen(tag) == name_length && memcmp(tag, m, name_length) == 0;
            m += name_length;
            assert_int_equal(*m++, 2 << 3 | 5);
            float value;
            memcpy(&value, m, sizeof value);
            m += 4;
            assert_true(m == value_end);
            if (wanted) values[step / 10] = (double)value;
        }
    }
    hg_free(bytes);
    return n;
}

static void events_hold_the_log(void **state)
{
    (void)state;
    assert_int_equal(hg_crc32c("123456789", 9), 0xe3069283u); /* the check value of CRC-32C */
    hg_train_options options = defaults();
    options.tensorboard = true;
    double whole[16] = { 0 }, parts[16] = { 0 }, validation[16] = { 0 };
    const outcome out = train("events", options, NULL, 8);
    const int n = read_events("events", "loss", whole);
    assert_int_equal(n, 1 + 6 + 3); /* version, logged steps, validations */
    assert_true(fabs(whole[6] - out.result.loss) < 1e-6 * fabs(out.result.loss));
    read_events("events", "validation", validation);
    assert_true(validation[2] > 0 && validation[4] > 0 && validation[6] > 0 && validation[1] == 0);
    int left = 38; /* after the log of 30, before the checkpoint of 45: 30 is not written twice */
    options.stop = stop_at;
    options.stop_self = &left;
    train("events_parts", options, NULL, 8);
    options.stop = NULL;
    options.resume = true;
    train("events_parts", options, NULL, 8);
    assert_int_equal(read_events("events_parts", "loss", parts), n);
    for (int i = 0; i < 16; i++) assert_true(parts[i] == whole[i]);

    /* TensorBoard's own reader, where it is installed. */
    char command[900];
    snprintf(
        command, sizeof command,
        "python3 -c \"import importlib.util as u, sys; sys.exit(0 if u.find_spec('tensorboard') else 3)\" 2>/dev/null");
    if (system(command) != 0) return;
    snprintf(command, sizeof command,
             "python3 -c \"from tensorboard.backend.event_processing.event_accumulator import EventAccumulator as E\n"
             "e = E('%s/events'); e.Reload(); s = e.Scalars('loss'); import sys\n"
             "sys.exit(0 if [x.step for x in s] == [10,20,30,40,50,60] and abs(s[-1].value - %.9g) < 1e-5 else 1)\"",
             test_folder(), out.result.loss);
    assert_int_equal(system(command), 0);
}

/* ---- other weights to start from ------------------------------------------------------------------------------ */

static void training_starts_from_a_checkpoint(void **state)
{
    (void)state;
    hg_train_options options = defaults();
    options.steps = 800;
    options.learning_rate = 2e-2;
    const outcome first = train("first", options, NULL, 12);
    char from[400];
    snprintf(from, sizeof from, "%s/first/checkpoint.h5", test_folder());
    options.start_from = from;
    options.steps = 1;
    options.learning_rate = 0;
    const outcome same = train("second", options, NULL, 12);
    assert_int_equal(same.status, HG_OK);
    assert_memory_equal(first.weight, same.weight, sizeof first.weight);
    options.ema = 0.9; /* the average begins with them too */
    const outcome averaged = train("third", options, NULL, 12);
    assert_memory_equal(first.weight, averaged.weight, sizeof first.weight);
    options.ema = 0;

    /* Fine-tuning is ahead of a run from scratch. */
    options.steps = 5;
    options.learning_rate = 1e-3;
    const double fine = train("fine", options, NULL, 12).result.best_validation;
    options.start_from = NULL;
    const double scratch = train("scratch", options, NULL, 12).result.best_validation;
    if (!(fine < 0.9 * scratch)) fail_msg("%g after fine-tuning, %g from scratch", fine, scratch);

    options.start_from = from;
    const outcome wide = train("wide", options, NULL, 13);
    assert_int_equal(wide.status, HG_INVALID);
    assert_non_null(strstr(hg_message(), "first.weight is [4,12] there and f32 [4,13]"));
    options.start_from = "/nowhere/at/all.h5";
    assert_int_not_equal(train("none", options, NULL, 12).status, HG_OK);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_average_is_what_the_formula_says),
        cmocka_unit_test(averaged_runs_resume_to_the_bit),
        cmocka_unit_test(patience_ends_a_run),
        cmocka_unit_test(events_hold_the_log),
        cmocka_unit_test(training_starts_from_a_checkpoint),
    };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
