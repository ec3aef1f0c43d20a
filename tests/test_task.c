/* tasks: a tiny procedural run from config to metrics; features; sampling; resume; the bit-for-bit promises; bad configs. */
#include "geometry/vector.h"
#include "hairgrad.h"
#include "tests/test.h"
#include "tasks/hair.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char tiny[] = "scene:\n"
                           "  style: wavy\n"
                           "  strands: 150\n"
                           "  vertices: 10\n"
                           "  seconds: 2 s\n"
                           "  motion_kinds: [nod, shake]\n"
                           "  held_out_kinds: [turn]\n"
                           "model:\n"
                           "  width: 32\n"
                           "features:\n"
                           "  history: 4\n"
                           "  latent: 6\n"
                           "  lock_size: 16\n"
                           "  encoder_width: 32\n"
                           "  encoder_steps: 60\n"
                           "losses:\n"
                           "  stretch: {}\n"
                           "  bend_twist: {}\n"
                           "  gravity: {}\n"
                           "  inertia: {}\n"
                           "  body_collision: {}\n"
                           "training:\n"
                           "  strands: 64\n"
                           "  frames: 2\n"
                           "  steps: 60\n"
                           "  warm_up: 5\n"
                           "  log_every: 10\n"
                           "  validate_every: 20\n"
                           "  validation_frames: 4\n"
                           "  checkpoint_every: 20\n";

static hg_config *parse(const char *text)
{
    int n;
    const hg_config_row *rows = hg_hair_schema(&n);
    hg_config *config = NULL;
    if (hg_config_parse(&config, text, "tiny.yaml", rows, n) != HG_OK) fail_msg("%s", hg_message());
    return config;
}

typedef struct {
    hg_ctx *ctx;
    hg_hair_task *task;
} trial;

static trial begin(const char *run, int threads, const char *key, const char *value)
{
    trial s = { 0 };
    assert_int_equal(hg_ctx_create(&s.ctx, &(hg_ctx_options){ .threads = threads, .seed = 1 }), HG_OK);
    hg_config *config = parse(tiny);
    if (key) assert_int_equal(hg_config_set(config, key, value), HG_OK);
    char path[320];
    snprintf(path, sizeof path, "%s/%s", test_folder(), run ? run : "");
    if (hg_hair_task_create(&s.task, s.ctx, config, run ? path : NULL, NULL) != HG_OK) fail_msg("%s", hg_message());
    hg_config_destroy(config);
    return s;
}

static void end(trial *s)
{
    hg_hair_task_destroy(s->task);
    hg_ctx_destroy(s->ctx);
}

static hg_train_result train(trial *s, bool resume, bool (*stop)(void *), void *self)
{
    hg_train_options options = hg_hair_train_options(s->task);
    options.resume = resume;
    options.stop = stop;
    options.stop_self = self;
    hg_train_result result;
    if (hg_train(s->ctx, hg_hair_model(s->task), hg_hair_task_of(s->task), &options, NULL, &result) != HG_OK)
        fail_msg("%s", hg_message());
    return result;
}

static uint64_t weights_hash(const trial *s)
{
    const hg_model *model = hg_hair_model(s->task);
    uint64_t hash = 0;
    for (int i = 0; i < model->n_params; i++)
        hash = hg_hash(model->params[i]->data, hg_tensor_bytes(model->params[i]), hash);
    return hash;
}

static double validation(trial *s)
{
    const hg_task *task = hg_hair_task_of(s->task);
    hg_report report = { 0 };
    hg_step_reset(s->ctx);
    assert_int_equal(task->validate(task->self, s->ctx, hg_hair_model(s->task), &report), HG_OK);
    return hg_report_get(&report, "validation");
}

/* ---- features ----------------------------------------------------------------------------------------------- */

static void features_are_finite_and_of_order_one(void **state)
{
    (void)state;
    trial s = begin(NULL, 2, NULL, NULL);
    const hg_feature *feature;
    const int n = hg_hair_features(s.task, &feature);
    const int strand_inputs = 2 + 6 + 6, frame_inputs = 10 + 42 + 4 * 21;
    assert_int_equal(n, strand_inputs + frame_inputs);
    assert_string_equal(feature[0].name, "root_uv.u");
    assert_string_equal(feature[2].name, "z_rest[0]");
    assert_string_equal(feature[8].name, "z_lock[0]");
    assert_string_equal(feature[14].name, "shape[0]");
    assert_string_equal(feature[24].name, "pose.Head.xx");
    assert_string_equal(feature[24 + 42].name, "acceleration[0].Head.x");
    assert_string_equal(feature[24 + 42 + 3].name, "angular_velocity[0].Head.x");
    assert_string_equal(feature[24 + 42 + 21].name, "acceleration[1].Head.x");

    const int64_t strands = hg_hair_groom(s.task)->strands;
    float *strand = malloc((size_t)(strands * strand_inputs) * sizeof *strand), frame[256];
    assert_int_equal(hg_hair_strand_features(s.task, s.ctx, NULL, strands, strand), HG_OK);
    for (int i = 0; i < strand_inputs; i++) {
        double sum = 0, squares = 0;
        for (int64_t k = 0; k < strands; k++) {
            const double z = ((double)strand[k * strand_inputs + i] - feature[i].mean) / feature[i].deviation;
            assert_true(isfinite(z));
            sum += z, squares += z * z;
        }
        assert_true(fabs(sum / (double)strands) < 1);
        assert_true(squares / (double)strands < 4);
    }
    free(strand);
    for (int held_out = 0; held_out < 2; held_out++)
        for (int c = 0; c < hg_hair_clips(s.task, held_out); c++) {
            const hg_motion *motion = hg_hair_clip(s.task, held_out, c);
            for (int64_t t = 0; t < motion->frames; t++) {
                assert_int_equal(hg_hair_frame_features(s.task, s.ctx, motion, t, NULL, frame), HG_OK);
                for (int i = 0; i < frame_inputs; i++) {
                    const hg_feature *f = &feature[strand_inputs + i];
                    const double z = ((double)frame[i] - f->mean) / f->deviation;
                    assert_true(isfinite(z) && fabs(z) < 30);
                }
            }
        }
    end(&s);
}

/* The first frame has no history; one frame later the newest velocity is that frame's and the rest is still. */
static void history_starts_at_rest(void **state)
{
    (void)state;
    trial s = begin(NULL, 1, NULL, NULL);
    const hg_motion *motion = hg_hair_clip(s.task, false, 1);
    float now[256], next[256];
    for (int64_t t = 20; t < 22; t++)
        assert_int_equal(hg_hair_frame_features(s.task, s.ctx, motion, t, NULL, t == 20 ? now : next), HG_OK);
    const int first = 10 + 42, width = 21;
    double moving = 0;
    for (int i = 0; i < 3 * width; i++) { /* what was newest is one frame older now */
        assert_true(now[first + i] == next[first + width + i]);
        moving += fabs((double)now[first + i]);
    }
    assert_true(moving > 0.1);
    assert_int_equal(hg_hair_frame_features(s.task, s.ctx, motion, 0, NULL, now), HG_OK);
    for (int i = 0; i < 4 * width; i++) assert_true(now[first + i] == 0);
    end(&s);
}

/* A head that turns in place: its heading is not a feature, and the velocity is where the maths says. */
static void a_turning_head(void **state)
{
    (void)state;
    trial s = begin(NULL, 1, NULL, NULL);
    const hg_body *body = hg_hair_body(s.task);
    hg_motion *motion = NULL;
    assert_int_equal(hg_motion_create(&motion, 30, body, 30), HG_OK);
    const int head = hg_body_joint(body, "Head");
    for (int64_t t = 0; t < 30; t++)
        for (int64_t j = 0; j < motion->joints; j++) {
            const double half = j == head ? 0.5 * 0.1 * (double)t : 0; /* 0.1 rad a frame: 3 rad/s, the unit */
            float *q = motion->rotation + (t * motion->joints + j) * 4;
            q[0] = (float)cos(half), q[1] = 0, q[2] = (float)sin(half), q[3] = 0;
        }
    float frame[256];
    assert_int_equal(hg_hair_frame_features(s.task, s.ctx, motion, 10, NULL, frame), HG_OK);
    const float upright[6] = { 1, 0, 0, 0, 1, 0 };
    for (int i = 0; i < 6; i++) assert_true(fabs((double)(frame[10 + i] - upright[i])) < 1e-5);
    const float *velocity = frame + 10 + 42;
    for (int i = 0; i < 3; i++) assert_true(fabs((double)velocity[i]) < 1e-5); /* the head joint stays */
    assert_true(fabs((double)velocity[3]) < 1e-4 && fabs((double)velocity[4] - 1) < 1e-4 &&
                fabs((double)velocity[5]) < 1e-4);
    hg_motion_destroy(motion);
    end(&s);
}

/* ---- sampling ----------------------------------------------------------------------------------------------- */

static void sampling_is_pure(void **state)
{
    (void)state;
    trial s = begin(NULL, 2, NULL, NULL), one = begin(NULL, 1, NULL, NULL);
    const hg_task *task = hg_hair_task_of(s.task), *same = hg_hair_task_of(one.task);
    const size_t bytes = task->batch_bytes;
    assert_int_equal(bytes, same->batch_bytes);
    char *a = aligned_alloc(64, (bytes + 63) & ~(size_t)63), *b = aligned_alloc(64, (bytes + 63) & ~(size_t)63);
    memset(a, 0, bytes);
    memset(b, 0, bytes);
    const size_t head = 256; /* the pointers differ */
    assert_int_equal(task->sample(task->self, s.ctx, 3, 17, a), HG_OK);
    assert_int_equal(same->sample(same->self, one.ctx, 3, 40, b), HG_OK);
    assert_memory_not_equal(a + head, b + head, bytes - head);
    assert_int_equal(same->sample(same->self, one.ctx, 3, 17, b), HG_OK);
    assert_memory_equal(a + head, b + head, bytes - head);
    free(a);
    free(b);
    end(&s);
    end(&one);
}

/* ---- training ----------------------------------------------------------------------------------------------- */

static hg_status compare_posed(void *self, const hg_drape_frame *frame)
{
    double *largest = self;
    for (int64_t i = 0; i < frame->strands * frame->vertices * 3; i++)
        *largest = fmax(*largest, fabs((double)(frame->x[i] - frame->posed[i])));
    return HG_OK;
}

/* Before training the hair is the rigidly posed groom; after it the loss is lower, on frames it has not seen too. */
static void training_lowers_the_loss(void **state)
{
    (void)state;
    trial s = begin("learn", 2, "training.steps", "300");
    double moved = 0;
    assert_int_equal(
        hg_hair_drape(s.task, s.ctx, hg_hair_clip(s.task, false, 0), NULL, 0, 5, 1, compare_posed, &moved, NULL),
        HG_OK);
    assert_true(moved < 1e-6);
    const double before = validation(&s);
    const hg_train_result result = train(&s, false, NULL, NULL);
    assert_int_equal(result.steps, 300);
    const double after = validation(&s);
    if (!(isfinite(before) && after < before - 0.02)) fail_msg("validation %g before, %g after", before, after);
    assert_int_equal(
        hg_hair_drape(s.task, s.ctx, hg_hair_clip(s.task, false, 0), NULL, 0, 5, 3, compare_posed, &moved, NULL),
        HG_OK);
    assert_true(moved > 1e-3);

    hg_hair_metrics metrics;
    double shape[HG_SHAPES];
    hg_hair_held_out_shape(s.task, 0, shape);
    assert_int_equal(hg_hair_evaluate(s.task, s.ctx, hg_hair_clip(s.task, true, 0), shape, 20, &metrics, NULL), HG_OK);
    assert_int_equal(metrics.frames, 20);
    assert_true(metrics.energy < metrics.energy_posed);
    assert_true(metrics.length_error > 0 && metrics.length_error < 20);
    assert_true(metrics.inside >= 0 && metrics.inside <= 100 && metrics.tip_amplitude > 0);
    assert_int_equal(metrics.n_terms, 5);

    /* What is opened from the folder is what was trained (the best one). */
    char path[320];
    snprintf(path, sizeof path, "%s/learn", test_folder());
    hg_hair_task *opened = NULL;
    if (hg_hair_task_open(&opened, s.ctx, path, NULL) != HG_OK) fail_msg("%s", hg_message());
    hg_hair_metrics again;
    assert_int_equal(hg_hair_evaluate(opened, s.ctx, hg_hair_clip(opened, true, 0), shape, 20, &again, NULL), HG_OK);
    assert_true(fabs(again.energy - metrics.energy) < 0.3 * fabs(metrics.energy));
    hg_hair_task_destroy(opened);
    end(&s);
}

static bool stop_at(void *self) { return (*(int *)self)-- == 0; }

static void same_bits(void **state)
{
    (void)state;
    trial two = begin("two", 2, NULL, NULL);
    train(&two, false, NULL, NULL);
    const uint64_t expected = weights_hash(&two);
    end(&two);
    trial one = begin("one", 1, NULL, NULL);
    train(&one, false, NULL, NULL);
    assert_true(weights_hash(&one) == expected);
    end(&one);
    int left = 33;
    trial first = begin("parts", 2, NULL, NULL);
    assert_true(train(&first, false, stop_at, &left).interrupted);
    end(&first);
    trial second = begin("parts", 2, NULL, NULL); /* as a new process would */
    assert_int_equal(train(&second, true, NULL, NULL).steps, 60);
    assert_true(weights_hash(&second) == expected);
    end(&second);
}

/* Strands drawn anew: resumed in the middle of a draw, and the bits are the same. */
static void same_bits_with_resampling(void **state)
{
    (void)state;
    trial whole = begin("resample", 2, "training.resample_every", "8");
    train(&whole, false, NULL, NULL);
    const uint64_t expected = weights_hash(&whole);
    end(&whole);
    int left = 29;
    trial first = begin("resample_parts", 1, "training.resample_every", "8");
    assert_true(train(&first, false, stop_at, &left).interrupted);
    end(&first);
    trial second = begin("resample_parts", 2, "training.resample_every", "8");
    train(&second, true, NULL, NULL);
    assert_true(weights_hash(&second) == expected);
    end(&second);
}

static void no_growth(void **state)
{
    (void)state;
    trial s = begin(NULL, 2, NULL, NULL);
    train(&s, false, NULL, NULL);
    const size_t reserved = hg_step_reserved(s.ctx);
    train(&s, false, NULL, NULL);
    assert_int_equal(hg_step_reserved(s.ctx), reserved);
    end(&s);
}

typedef struct {
    const hg_groom *groom;
    float *d; /* [S,(V-1)*3] */
} displaced;

/* What the drape moved, taken back to head rest space: R^-1 (x - p) - (rest - rest_root). */
static hg_status take_back(void *self, const hg_drape_frame *frame)
{
    displaced *out = self;
    const int64_t V = frame->vertices;
    for (int64_t s = 0; s < frame->strands; s++)
        for (int64_t v = 1; v < V; v++) {
            const float *q = frame->root_rotation + 4 * s, *p = frame->root_position + 3 * s;
            const float *x = frame->x + (s * V + v) * 3, *rest = out->groom->points + s * V * 3;
            const hg_vec3f moved = hg_vec3f_sub(hg_vec3f_load(x), hg_vec3f_load(p));
            const hg_vec3f back = hg_quatf_rotate(hg_quatf_conj(hg_quatf_load(q)), moved);
            const hg_vec3f edge = hg_vec3f_sub(hg_vec3f_load(rest + 3 * v), hg_vec3f_load(rest));
            hg_vec3f_store(out->d + (s * (V - 1) + v - 1) * 3, hg_vec3f_sub(back, edge));
        }
    return HG_OK;
}

/* The exported formula is the trained network: raw concatenated features in, what the drape does out. */
static void concatenated_is_the_drape(const char *output, const char *pinned)
{
    trial s = { 0 };
    assert_int_equal(hg_ctx_create(&s.ctx, &(hg_ctx_options){ .threads = 2, .seed = 1 }), HG_OK);
    hg_config *config = parse(tiny);
    assert_int_equal(hg_config_set(config, "model.output", output), HG_OK);
    assert_int_equal(hg_config_set(config, "model.pinned", pinned), HG_OK);
    if (hg_hair_task_create(&s.task, s.ctx, config, NULL, NULL) != HG_OK) fail_msg("%s", hg_message());
    hg_config_destroy(config);
    train(&s, false, NULL, NULL);

    const hg_motion *motion = hg_hair_clip(s.task, false, 0);
    const int64_t strands = hg_hair_groom(s.task)->strands, V = hg_hair_groom(s.task)->vertices;
    const hg_feature *feature;
    const int n = hg_hair_features(s.task, &feature), own = hg_hair_strand_inputs(s.task);
    const int inputs = feature[n - 1].first + feature[n - 1].count;
    int next = 0;
    for (int i = 0; i < n; i++) { /* the table covers every column once, in order */
        assert_int_equal(feature[i].first, next);
        next += feature[i].count;
    }
    double shape[HG_SHAPES] = { 0.4, -0.3, 0.2 };
    float *of_strand = calloc((size_t)(strands * own), sizeof *of_strand);
    float *raw = calloc((size_t)(strands * inputs), sizeof *raw);
    displaced moved = { hg_hair_groom(s.task), calloc((size_t)(strands * (V - 1)) * 3, sizeof(float)) };
    assert_int_equal(hg_hair_strand_features(s.task, s.ctx, NULL, strands, of_strand), HG_OK);
    for (int64_t i = 0; i < strands; i++) {
        memcpy(raw + i * inputs, of_strand + i * own, (size_t)own * sizeof *raw);
        assert_int_equal(hg_hair_frame_features(s.task, s.ctx, motion, 12, shape, raw + i * inputs + own), HG_OK);
    }
    assert_int_equal(hg_hair_drape(s.task, s.ctx, motion, shape, 12, 1, 1, take_back, &moved, NULL), HG_OK);
    hg_tensor *in = hg_tensor_wrap(s.ctx, HG_F32, 2, (int64_t[]){ strands, inputs }, raw);
    hg_tensor *d = hg_hair_forward_concatenated(s.task, s.ctx, in);
    assert_int_equal(hg_ctx_status(s.ctx), HG_OK);
    assert_int_equal(d->shape[1], (V - 1) * 3);
    double largest = 0, worst = 0;
    for (int64_t i = 0; i < hg_tensor_count(d); i++) {
        largest = fmax(largest, fabs(hg_tensor_item(d, i)));
        worst = fmax(worst, fabs(hg_tensor_item(d, i) - (double)moved.d[i]));
    }
    assert_true(largest > 1e-4);
    assert_true(worst < 2e-6);
    free(raw);
    free(of_strand);
    free(moved.d);
    end(&s);
}

static void concatenated_is_the_same_network(void **state)
{
    (void)state;
    concatenated_is_the_drape("vertices", "1");
    concatenated_is_the_drape("edges", "2");
    concatenated_is_the_drape("directions", "2");
}

/* Rows that pull harder than the limit are shortened to it, the others are left alone. */
static void forces_are_bounded(void **state)
{
    (void)state;
    hg_ctx *ctx = NULL;
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1 }), HG_OK);
    hg_tensor *x = hg_tensor_create(ctx, HG_F64, 2, (int64_t[]){ 3, 3 });
    const double pull[9] = { 3, 0, 4, 0.1, 0.2, 0.2, 0, 0, 0 };
    assert_int_equal(hg_require_grad(x), HG_OK);
    hg_tensor *c = hg_tensor_wrap(ctx, HG_F64, 2, (int64_t[]){ 3, 3 }, (void *)(uintptr_t)pull);
    hg_tensor *loss = hg_sum(ctx, hg_mul(ctx, hg_clip_gradient(ctx, x, 0.5), c));
    assert_int_equal(hg_backward(ctx, loss), HG_OK);
    const double expected[9] = { 0.3, 0, 0.4, 0.1, 0.2, 0.2, 0, 0, 0 };
    for (int i = 0; i < 9; i++) assert_true(fabs(hg_tensor_item(hg_grad(x), i) - expected[i]) < 1e-12);
    assert_null(hg_clip_gradient(ctx, x, 0));
    assert_int_equal(hg_ctx_status(ctx), HG_INVALID);
    hg_tensor_destroy(x);
    hg_ctx_destroy(ctx);
}

/* ---- configs ------------------------------------------------------------------------------------------------ */

static void refused(const char *text, const char *expected)
{
    int n;
    const hg_config_row *rows = hg_hair_schema(&n);
    hg_config *config = NULL;
    hg_status status = hg_config_parse(&config, text, "bad.yaml", rows, n);
    if (status == HG_OK) {
        hg_ctx *ctx = NULL;
        hg_hair_task *task = NULL;
        assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1 }), HG_OK);
        status = hg_hair_task_create(&task, ctx, config, NULL, NULL);
        assert_null(task);
        hg_ctx_destroy(ctx);
    }
    hg_config_destroy(config);
    assert_int_not_equal(status, HG_OK);
    if (!strstr(hg_message(), expected)) fail_msg("\"%s\" does not say \"%s\"", hg_message(), expected);
}

static void bad_configs(void **state)
{
    (void)state;
    refused("trainig: { steps: 3 }\nlosses: { gravity: {} }\n", "training");
    refused("training: { stepz: 3 }\nlosses: { gravity: {} }\n", "steps");
    refused("losses: { gravty: {} }\n", "gravity");
    refused("scene: { strands: 20 }\n", "no energy");
    refused("scene: { body: /nowhere/body.h5 }\nlosses: { gravity: {} }\n", "/nowhere/body.h5");
    refused("scene: { strands: 20, motion_kinds: [nodd] }\nlosses: { gravity: {} }\n", "nodd");
    refused("scene: { strands: 20 }\nfeatures: { pose_joints: [Haed] }\nlosses: { gravity: {} }\n", "Head");
    refused("scene: { strands: 20, seconds: 1 s }\nmodel: { kind: neuralock }\nlosses: { gravity: {} }\n",
            "neuralocks");
    refused("scene: { strands: 20, seconds: 1 s }\nmodel: { kind: strand_autoencoder }\nlosses: { gravity: {} }\n",
            "network per strand");
    refused("scene: { strands: 20, seconds: 1 s, vertices: 2 }\nmodel: { pinned: 2 }\nlosses: { gravity: {} }\n",
            "pinned");
    refused("scene: { strands: 20, seconds: 1 kg }\nlosses: { gravity: {} }\n", "bad.yaml:1");
}

/* Every registered energy can be written in a config, and an echo loads to the same energies. */
static void schema_follows_the_registry(void **state)
{
    (void)state;
    const char *names[64];
    const int n = hg_list("energy", names, 64);
    assert_true(n >= 4);
    int rows;
    const hg_config_row *row = hg_hair_schema(&rows);
    for (int i = 0; i < n; i++) {
        char key[128];
        snprintf(key, sizeof key, "losses.%s.weight", names[i]);
        bool found = false;
        for (int k = 0; k < rows; k++) found = found || !strcmp(row[k].key, key);
        assert_true(found);
    }
    hg_config *config = parse(tiny), *again = NULL;
    char *echo = hg_config_echo(config);
    assert_non_null(echo);
    assert_int_equal(hg_config_parse(&again, echo, "echo.yaml", row, rows), HG_OK);
    hg_free(echo);
    hg_config_destroy(config);
    hg_config_destroy(again);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(features_are_finite_and_of_order_one),
        cmocka_unit_test(history_starts_at_rest),
        cmocka_unit_test(a_turning_head),
        cmocka_unit_test(sampling_is_pure),
        cmocka_unit_test(training_lowers_the_loss),
        cmocka_unit_test(same_bits),
        cmocka_unit_test(same_bits_with_resampling),
        cmocka_unit_test(no_growth),
        cmocka_unit_test(concatenated_is_the_same_network),
        cmocka_unit_test(forces_are_bounded),
        cmocka_unit_test(bad_configs),
        cmocka_unit_test(schema_follows_the_registry),
    };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
