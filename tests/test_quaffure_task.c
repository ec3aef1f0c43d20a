/* Quaffure behind the hair task: sizes, left-out strands, the gradient of the loss, where it goes, several grooms, bit for bit
 * resumed, and a drape that is what training predicts. */
#include "hairgrad.h"
#include "tasks/hair.h"
#include "tests/device.h"
#include "tests/test.h"

#include <math.h>
#include <unistd.h>

static const char tiny[] =
    "scene: { style: wavy, strands: 40, vertices: 7, seconds: 1 s, motion_kinds: [nod], held_out_kinds: [turn] }\n"
    "model: { kind: quaffure, texture: 8, width: 8, depth: 1 }\n"
    "features: { pose_joints: [Head, Neck], rotation: axis_angle, velocity_joints: [Head], history: 2, latent: 3,\n"
    "  lock_size: 16, encoder_width: 8, encoder_steps: 12 }\n"
    "losses: { stretch: {}, bend_twist: {}, gravity: {}, inertia: {}, body_collision: { mode: exact } }\n"
    "training: { strands: 40, frames: 2, steps: 8, warm_up: 2, log_every: 4, validate_every: 4,\n"
    "  validation_frames: 2, checkpoint_every: 4, learning_rate: 2e-3 }\n";

#define OK(call_)                                                                                                      \
    do {                                                                                                               \
        if ((call_) != HG_OK) fail_msg("%s", hg_message());                                                            \
    } while (0)

typedef struct {
    hg_ctx *ctx;
    hg_hair_task *task;
} trial;

/* n pairs of keys and values on top of the tiny config. */
static trial begin(const char *run, int threads, int n, const char *const (*set)[2])
{
    trial s = { 0 };
    int n_rows;
    const hg_config_row *rows = hg_hair_schema(&n_rows);
    hg_config *config = NULL;
    OK(hg_config_parse(&config, tiny, "tiny.yaml", rows, n_rows));
    for (int i = 0; i < n; i++) OK(hg_config_set(config, set[i][0], set[i][1]));
    OK(hg_ctx_create(&s.ctx, &(hg_ctx_options){ .threads = threads, .seed = 1, .device = test_device() }));
    char path[400];
    snprintf(path, sizeof path, "%s/%s", test_folder(), run ? run : "");
    OK(hg_hair_task_create(&s.task, s.ctx, config, run ? path : NULL, NULL));
    hg_config_destroy(config);
    return s;
}

static void end(trial *s)
{
    hg_hair_task_destroy(s->task);
    hg_ctx_destroy(s->ctx);
}

/* The last layer begins at zero, and with it nearly every gradient. */
static void wake(trial *s)
{
    const hg_model *model = hg_hair_model(s->task);
    hg_tensor *weight = model->params[model->n_params - 2];
    assert_string_equal(weight->name, "last.weight");
    float *values = malloc(hg_tensor_bytes(weight));
    for (int64_t i = 0; i < hg_tensor_count(weight); i++)
        values[i] = (float)(0.3 * hg_random_normal(9, 77, (uint64_t)i));
    OK(hg_tensor_write(weight, values));
    free(values);
}

typedef struct {
    void *bytes;
    hg_hair_batch *batch;
} frames;

static frames make_frames(trial *s, int n, const int32_t *groom, const int64_t *frame)
{
    hg_hair_task *task = s->task;
    frames f = { .bytes = hg_alloc(1, hg_hair_batch_bytes(task, n, task->subset.n)) };
    f.batch = hg_hair_batch_lay_out(task, f.bytes, n, task->subset.n);
    const double shape[HG_SHAPES] = { 0.3, -0.2 };
    hg_step_reset(s->ctx);
    for (int b = 0; b < n; b++)
        OK(hg_hair_batch_fill(task, s->ctx, f.batch, &task->subset, b, groom[b], &task->clips[0][0], frame[b], shape,
                              NULL));
    return f;
}

static hg_tensor *loss_of(trial *s, const frames *f)
{
    hg_tensor *unweighted;
    hg_tensor *value = hg_hair_energy(s->task, s->ctx, f->batch, &s->task->subset, &unweighted);
    if (!value) fail_msg("%s", hg_ctx_message(s->ctx));
    return value;
}

/* ---- sizes -------------------------------------------------------------------------------------------------- */

/* The rig of CMU as MakeHuman's body has it, where the data is. */
static void published_sizes(void **state)
{
    (void)state;
    char path[500];
    snprintf(path, sizeof path, "%s/../shared/data/bodies", getenv("HG_SOURCE") ? getenv("HG_SOURCE") : ".");
    if (access(path, R_OK)) {
        print_message("%s is not there: the inputs of the published network are not counted\n", path);
        skip();
    }
    hg_ctx *ctx = NULL;
    hg_body *body = NULL;
    OK(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2 }));
    OK(hg_body_read_makehuman(ctx, &body, path, "cmu_mb"));
    assert_int_equal(body->joints, 31);
    static const char text[] = "model: { kind: quaffure }\n"
                               "features: { pose_joints: [all], velocity_joints: [all], rotation: axis_angle, linear: "
                               "none, history: 0, latent: 16 }\n"
                               "losses: { gravity: {} }\n";
    int n_rows;
    const hg_config_row *rows = hg_hair_schema(&n_rows);
    hg_config *config = NULL;
    OK(hg_config_parse(&config, text, "published.yaml", rows, n_rows));
    hg_hair_layout layout = { 0 };
    OK(hg_hair_layout_create(&layout, config, body));
    assert_int_equal(layout.n_pose, 27);
    assert_int_equal(hg_config_integer(config, "features.latent") + layout.frame_inputs, 107);
    OK(hg_config_set(config, "features.history", "30"));
    OK(hg_hair_layout_create(&layout, config, body));
    assert_int_equal(hg_config_integer(config, "features.latent") + layout.frame_inputs, 2537);
    hg_config_destroy(config);
    hg_body_destroy(body);
    hg_ctx_destroy(ctx);
}

static void strands_that_share_a_texel_are_left_out(void **state)
{
    (void)state;
    trial s = begin(NULL, 1, 0, NULL);
    const hg_hair_style *style = &s.task->styles[0];
    const int64_t kept = hg_hair_groom(s.task)->strands, left_out = hg_hair_left_out(s.task, 0);
    assert_int_equal(kept + left_out, 40);
    assert_true(left_out > 0 && kept > 10);
    bool taken[64] = { false };
    for (int64_t i = 0; i < kept; i++) {
        assert_in_range(style->texel[i], 0, 63);
        assert_false(taken[style->texel[i]]);
        taken[style->texel[i]] = true;
    }
    assert_non_null(hg_hair_train_options(s.task).note);
    hg_report report = { 0 };
    const hg_task *task = hg_hair_task_of(s.task);
    OK(task->validate(task->self, s.ctx, hg_hair_model(s.task), &report));
    assert_int_equal((int64_t)hg_report_get(&report, "strands_left_out"), left_out);
    end(&s);
}

/* Names, order and normalisation: [code | shape | pose | history]. */
static void features(void **state)
{
    (void)state;
    trial s = begin(NULL, 1, 1, (const char *const[][2]){ { "scene.grooms", "[wavy, short]" } });
    const hg_feature *feature;
    const int n = hg_hair_features(s.task, &feature);
    assert_int_equal(n, 3 + HG_SHAPES + 2 * 3 + 2 * (3 + 3));
    assert_int_equal(hg_hair_strand_inputs(s.task), 3);
    assert_string_equal(feature[0].name, "z_groom[0]");
    assert_string_equal(feature[3 + HG_SHAPES].name, "pose.Head.x");
    assert_string_equal(feature[n - 1].name, "angular_velocity[1].Head.z");
    double apart = 0;
    for (int k = 0; k < 3; k++) {
        const double a = (double)s.task->styles[0].raw[k], b = (double)s.task->styles[1].raw[k];
        assert_true(fabs(a - feature[k].mean) < 20 * feature[k].deviation);
        apart = fmax(apart, fabs(a - b) / feature[k].deviation);
    }
    assert_true(apart > 0.1); /* one groom is told from another */
    end(&s);
}

/* ---- gradients ---------------------------------------------------------------------------------------------- */

static double directional(trial *s, const frames *f, hg_tensor *param, const float *values, const double *direction,
                          double step)
{
    const int64_t n = hg_tensor_count(param);
    float *moved = malloc(hg_tensor_bytes(param));
    double at[2];
    for (int side = 0; side < 2; side++) {
        for (int64_t i = 0; i < n; i++) moved[i] = (float)((double)values[i] + (side ? -step : step) * direction[i]);
        OK(hg_tensor_write(param, moved));
        hg_step_reset(s->ctx);
        hg_no_grad_begin(s->ctx);
        at[side] = hg_tensor_item(loss_of(s, f), 0);
        hg_no_grad_end(s->ctx);
    }
    OK(hg_tensor_write(param, values));
    free(moved);
    return (at[0] - at[1]) / (2 * step);
}

/* Of every parameter, along its gradient; in each meaning of an output. The past is data, so there is no inertia here. */
static void the_gradient_is_that_of_the_loss(void **state)
{
    (void)state;
    static const char *const means[][2] = {
        { "vertices", "head" }, { "vertices", "world" }, { "edges", "world" }, { "directions", "head" }
    };
    for (int m = 0; m < 4; m++) {
        trial s = begin(NULL, 2, 4,
                        (const char *const[][2]){ { "model.output", means[m][0] },
                                                  { "model.space", means[m][1] },
                                                  { "losses.inertia.weight", "0" },
                                                  { "losses.shear.weight", "1" } });
        wake(&s);
        const frames f = make_frames(&s, 2, (int32_t[]){ 0, 0 }, (int64_t[]){ 5, 20 });
        OK(hg_backward(s.ctx, loss_of(&s, &f)));
        const hg_model *model = hg_hair_model(s.task);
        for (int p = 0; p < model->n_params; p++) {
            hg_tensor *param = model->params[p];
            const int64_t n = hg_tensor_count(param);
            float *values = malloc(hg_tensor_bytes(param)), *gradient = malloc(hg_tensor_bytes(param));
            double *direction = malloc((size_t)n * sizeof *direction), length = 0;
            OK(hg_tensor_read(param, values));
            OK(hg_tensor_read(hg_grad(param), gradient));
            for (int64_t i = 0; i < n; i++) length += (double)gradient[i] * (double)gradient[i];
            length = sqrt(length);
            assert_true(length > 0);
            for (int64_t i = 0; i < n; i++) direction[i] = (double)gradient[i] / length;
            double best = INFINITY;
            for (double step = 3e-3; step > 1e-5 && !(best < 2e-3); step *= 0.3) {
                hg_step_reset(s.ctx);
                best = fmin(best, fabs(directional(&s, &f, param, values, direction, step) / length - 1));
            }
            if (!(best < 2e-3))
                fail_msg("%s, %s: %s: the slope along the gradient is off by %g", means[m][0], means[m][1], param->name,
                         best);
            free(values);
            free(gradient);
            free(direction);
        }
        hg_free(f.bytes);
        end(&s);
    }
}

static void empty_texels_have_no_gradient(void **state)
{
    (void)state;
    trial s = begin(NULL, 1, 0, NULL);
    hg_hair_task *task = s.task;
    const frames f = make_frames(&s, 1, (int32_t[]){ 0 }, (int64_t[]){ 5 });
    const hg_hair_part part = hg_hair_part_of(task, s.ctx, &task->subset);
    hg_tensor *inputs = hg_tensor_from(s.ctx, HG_F32, 2, (int64_t[]){ 3, task->layout.frame_inputs }, f.batch->inputs);
    hg_tensor *image = task->network->images(task, s.ctx, &part, f.batch->groom, inputs);
    OK(hg_backward(s.ctx, hg_sum(s.ctx, task->network->outputs(task, s.ctx, &part, image, 1, 2, 0))));
    float *gradient = malloc(hg_tensor_bytes(image));
    OK(hg_tensor_read(hg_grad(image), gradient));
    bool taken[64] = { false };
    for (int64_t i = 0; i < part.strands; i++) taken[(int)hg_tensor_item(part.texel, i)] = true;
    for (int64_t i = 0; i < hg_tensor_count(image); i++) { /* the first row was not asked for */
        const bool asked = i >= 64 * task->outputs && taken[i % 64];
        assert_true(gradient[i] == (asked ? 1.0f : 0.0f));
    }
    free(gradient);
    hg_free(f.bytes);
    end(&s);
}

/* ---- training ----------------------------------------------------------------------------------------------- */

static bool stop_at(void *self) { return (*(int *)self)-- == 0; }

static uint64_t train(trial *s, bool resume, int stop, hg_train_result *result)
{
    hg_train_options options = hg_hair_train_options(s->task);
    options.resume = resume;
    if (stop > 0) options.stop = stop_at, options.stop_self = &stop;
    OK(hg_train(s->ctx, hg_hair_model(s->task), hg_hair_task_of(s->task), &options, NULL, result));
    const hg_model *model = hg_hair_model(s->task);
    uint64_t hash = 0;
    for (int i = 0; i < model->n_params; i++) {
        void *values = malloc(hg_tensor_bytes(model->params[i]));
        OK(hg_tensor_read(model->params[i], values));
        hash = hg_hash(values, hg_tensor_bytes(model->params[i]), hash);
        free(values);
    }
    return hash;
}

typedef struct {
    int64_t strands, vertices;
    float *x;
} draped;

static hg_status keep(void *self, const hg_drape_frame *frame)
{
    draped *d = self;
    d->strands = frame->strands, d->vertices = frame->vertices;
    const size_t bytes = (size_t)(frame->strands * frame->vertices) * 3 * sizeof(float);
    free(d->x);
    d->x = malloc(bytes);
    memcpy(d->x, frame->x, bytes);
    return HG_OK;
}

static const char *const two_grooms[][2] = { { "scene.grooms", "[wavy, short]" }, { "model.output", "directions" } };

static void a_resumed_run_is_the_same_and_opens(void **state)
{
    (void)state;
    hg_train_result result;
    trial whole = begin("whole", 2, 2, two_grooms);
    hg_report before = { 0 }, after = { 0 };
    const hg_task *task = hg_hair_task_of(whole.task);
    OK(task->validate(task->self, whole.ctx, hg_hair_model(whole.task), &before));
    const uint64_t expected = train(&whole, false, 0, &result);
    OK(task->validate(task->self, whole.ctx, hg_hair_model(whole.task), &after));
    assert_true(hg_report_get(&after, "validation") < hg_report_get(&before, "validation"));
    end(&whole);
    trial first = begin("parts", 1, 2, two_grooms);
    train(&first, false, 5, &result);
    assert_true(result.interrupted);
    end(&first);
    trial second = begin("parts", 2, 2, two_grooms);
    assert_true(train(&second, true, 0, &result) == expected);
    end(&second);

    hg_ctx *ctx = NULL;
    hg_hair_task *opened = NULL;
    char path[400];
    snprintf(path, sizeof path, "%s/whole", test_folder());
    OK(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .seed = 1, .device = test_device() }));
    OK(hg_hair_task_open(&opened, ctx, path, NULL));
    const char *const names[] = { "wavy", "short", "curly" }; /* the last one was not trained on */
    for (int i = 0; i < 3; i++) {
        OK(hg_hair_choose_groom(opened, names[i]));
        hg_hair_metrics metrics;
        draped d = { 0 };
        OK(hg_hair_evaluate(opened, ctx, hg_hair_clip(opened, true, 0), NULL, 3, &metrics, NULL));
        assert_true(isfinite(metrics.energy) && metrics.energy != 0 && metrics.length_error < 1e-3);
        OK(hg_hair_drape(opened, ctx, hg_hair_clip(opened, true, 0), NULL, 2, 1, 1, keep, &d, NULL));
        assert_int_equal(d.strands, hg_hair_groom(opened)->strands);
        assert_true(d.strands + hg_hair_left_out(opened, -1) == 40);
        free(d.x);
    }
    hg_hair_task_destroy(opened);

    /* A new run that starts from this one's weights and encoder. */
    char from[500];
    snprintf(from, sizeof from, "%s/best.h5", path);
    trial tuned = begin(NULL, 1, 3,
                        (const char *const[][2]){ { "scene.grooms", "[wavy, short]" },
                                                  { "model.output", "directions" },
                                                  { "training.start_from", from } });
    hg_train_options options = hg_hair_train_options(tuned.task);
    options.steps = 1, options.learning_rate = 0;
    OK(hg_train(tuned.ctx, hg_hair_model(tuned.task), hg_hair_task_of(tuned.task), &options, NULL, &result));
    assert_true(fabs(result.best_validation - hg_report_get(&after, "validation")) <
                0.05 * fabs(hg_report_get(&after, "validation")));
    end(&tuned);
    hg_ctx_destroy(ctx);
}

typedef struct {
    hg_ctx *ctx;
    int steps;
    int64_t waits[8];
} watch;

static bool look(void *self)
{
    watch *w = self;
    w->waits[w->steps++] = hg_ctx_counts(w->ctx).waits;
    return false;
}

/* The host waits for a device where a line is logged, not in every step. */
static void a_step_waits_for_nothing(void **state)
{
    (void)state;
    trial s = begin(NULL, 2, 0, NULL);
    watch w = { .ctx = s.ctx };
    hg_train_options options = hg_hair_train_options(s.task);
    options.log_every = options.steps = 8, options.validate_every = 0;
    options.stop = look, options.stop_self = &w;
    hg_train_result result;
    OK(hg_train(s.ctx, hg_hair_model(s.task), hg_hair_task_of(s.task), &options, NULL, &result));
    assert_int_equal(w.steps, 8);
    for (int i = 3; i < 8; i++) assert_int_equal(w.waits[i], w.waits[2]);
    end(&s);
}

/* What the loss sees of a frame is what a drape shows of it; and in a batch of two grooms each has its own strands. */
static void a_drape_is_what_training_predicts(void **state)
{
    (void)state;
    trial s = begin(NULL, 2, 2, two_grooms);
    hg_hair_task *task = s.task;
    wake(&s);
    const double shape[HG_SHAPES] = { 0.3, -0.2 };
    const frames f = make_frames(&s, 3, (int32_t[]){ 0, 1, 1 }, (int64_t[]){ 5, 20, 9 });
    const hg_hair_batch *batch = f.batch;
    const int64_t B = 3, S = batch->strands, V = hg_hair_groom(task)->vertices, row = S * V * 3;
    if (!batch->rotation) { /* a device poses roots in the step */
        hg_free(f.bytes);
        end(&s);
        skip();
    }
    hg_no_grad_begin(s.ctx);
    const hg_hair_part part = hg_hair_part_of(task, s.ctx, &task->subset);
    hg_tensor *x = hg_hair_predict(
        task, s.ctx, &part, batch->groom,
        hg_tensor_from(s.ctx, HG_F32, 2, (int64_t[]){ 3 * B, task->layout.frame_inputs }, batch->inputs),
        task->subset.rest, hg_tensor_from(s.ctx, HG_F32, 3, (int64_t[]){ 3 * B, S, 4 }, batch->rotation),
        hg_tensor_from(s.ctx, HG_F32, 3, (int64_t[]){ 3 * B, S, 3 }, batch->position));
    hg_no_grad_end(s.ctx);
    float *seen = malloc(hg_tensor_bytes(x));
    OK(hg_tensor_read(x, seen));
    for (int b = 0; b < 2; b++) {
        draped d = { 0 };
        OK(hg_hair_choose_groom(task, b ? "short" : "wavy"));
        OK(hg_hair_drape(task, s.ctx, task->clips[0][0].motion, shape, b ? 20 : 5, 1, 1, keep, &d, NULL));
        assert_int_equal(task->subset.first, 0);
        double far = 0, moved = 0;
        for (int64_t i = 0; i < S; i++)
            for (int64_t k = 0; k < V * 3; k++) {
                const float draped_at = d.x[task->subset.strand[b * S + i] * V * 3 + k];
                far = fmax(far, fabs((double)(seen[(2 * B + b) * row + i * V * 3 + k] - draped_at)));
                moved = fmax(moved,
                             fabs((double)(seen[(2 * B + b) * row + i * V * 3 + k] - seen[b * row + i * V * 3 + k])));
            }
        if (!(far < 1e-5)) fail_msg("groom %d: %g m between the drape and what was trained", b, far);
        assert_true(moved > 1e-5);
        free(d.x);
    }
    free(seen);
    hg_free(f.bytes);
    end(&s);
}

/* Everything that a recipe needs is there, and makes a network. */
static void recipes(void **state)
{
    (void)state;
    if (test_device()) skip(); /* nothing in them depends on it */
    static const char *const names[] = { "quaffure", "dynamic_quaffure" };
    for (int i = 0; i < 2; i++) {
        hg_ctx *ctx = NULL;
        hg_findings findings = { 0 };
        char path[500];
        snprintf(path, sizeof path, "%s/examples/recipes/%s.yaml", getenv("HG_SOURCE") ? getenv("HG_SOURCE") : ".",
                 names[i]);
        OK(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2 }));
        OK(hg_hair_config_check(ctx, &findings, path));
        for (int k = 0; k < findings.n; k++)
            if (findings.list[k].severity == HG_ERROR) fail_msg("%s: %s", path, findings.list[k].text);
        assert_true(findings.n >= 4);
        hg_findings_free(&findings);
        hg_ctx_destroy(ctx);
    }
}

/* ---- what cannot be ----------------------------------------------------------------------------------------- */

static void refuses(void **state)
{
    (void)state;
    static const struct {
        const char *key, *value, *says;
    } wrong[] = {
        { "model.depth", "4", "halved 4 times" },
        { "model.kind", "quafure", "did you mean \"quaffure\"" },
        { "model.space", "world", "turned in the head's space" },
        { "features.pose_joints", "[all, Head]", "no joint \"all\"" },
    };
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        int n_rows;
        const hg_config_row *rows = hg_hair_schema(&n_rows);
        hg_config *config = NULL;
        hg_ctx *ctx = NULL;
        hg_hair_task *task = NULL;
        OK(hg_config_parse(&config, tiny, "tiny.yaml", rows, n_rows));
        OK(hg_config_set(config, "model.output", "directions"));
        OK(hg_config_set(config, wrong[i].key, wrong[i].value));
        OK(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1, .device = test_device() }));
        assert_int_not_equal(hg_hair_task_create(&task, ctx, config, NULL, NULL), HG_OK);
        if (!strstr(hg_message(), wrong[i].says)) fail_msg("\"%s\" does not say \"%s\"", hg_message(), wrong[i].says);
        hg_config_destroy(config);
        hg_ctx_destroy(ctx);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(published_sizes),
        cmocka_unit_test(strands_that_share_a_texel_are_left_out),
        cmocka_unit_test(features),
        cmocka_unit_test(the_gradient_is_that_of_the_loss),
        cmocka_unit_test(empty_texels_have_no_gradient),
        cmocka_unit_test(a_resumed_run_is_the_same_and_opens),
        cmocka_unit_test(a_step_waits_for_nothing),
        cmocka_unit_test(a_drape_is_what_training_predicts),
        cmocka_unit_test(recipes),
        cmocka_unit_test(refuses),
    };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
