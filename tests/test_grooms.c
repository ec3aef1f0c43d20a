/* tasks: training on several grooms at once; draping one of them, and one that was not trained on. */
#include "hairgrad.h"
#include "tests/test.h"
#include "tasks/hair.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char tiny[] =
    "scene: { strands: 60, vertices: 9, seconds: 2 s, motion_kinds: [nod], held_out_kinds: [turn] }\n"
    "model: { width: 24, output: directions }\n"
    "features: { history: 3, latent: 5, lock_size: 16, encoder_width: 24, encoder_steps: 40 }\n"
    "losses: { stretch: {}, bend_twist: {}, gravity: {}, inertia: {}, body_collision: {} }\n"
    "training: { strands: 60, frames: 3, steps: 40, warm_up: 4, log_every: 10, validate_every: 20,\n"
    "  validation_frames: 4, checkpoint_every: 20, learning_rate: 2e-3 }\n";

typedef struct {
    hg_ctx *ctx;
    hg_hair_task *task;
    hg_status status;
} trial;

static trial begin(const char *run, int threads, const char *grooms, const char *style)
{
    trial s = { 0 };
    int n;
    const hg_config_row *rows = hg_hair_schema(&n);
    hg_config *config = NULL;
    assert_int_equal(hg_config_parse(&config, tiny, "tiny.yaml", rows, n), HG_OK);
    if (grooms) assert_int_equal(hg_config_set(config, "scene.grooms", grooms), HG_OK);
    if (style) assert_int_equal(hg_config_set(config, "scene.style", style), HG_OK);
    assert_int_equal(hg_ctx_create(&s.ctx, &(hg_ctx_options){ .threads = threads, .seed = 1 }), HG_OK);
    char path[320];
    snprintf(path, sizeof path, "%s/%s", test_folder(), run ? run : "");
    s.status = hg_hair_task_create(&s.task, s.ctx, config, run ? path : NULL, NULL);
    hg_config_destroy(config);
    return s;
}

static void end(trial *s)
{
    hg_hair_task_destroy(s->task);
    hg_ctx_destroy(s->ctx);
}

/* The energy [J] of a batch of single frames, one for each (groom, frame) asked for; the network is still zero. */
static double energy(trial *s, int n, const int32_t *groom, const int64_t *frame)
{
    hg_hair_task *task = s->task;
    void *bytes = hg_alloc(1, hg_hair_batch_bytes(task, n, task->subset.n));
    hg_hair_batch *batch = hg_hair_batch_lay_out(task, bytes, n, task->subset.n);
    double shape[HG_SHAPES] = { 0.3 };
    hg_tensor *unweighted;
    hg_step_reset(s->ctx);
    for (int b = 0; b < n; b++)
        assert_int_equal(hg_hair_batch_fill(task, s->ctx, batch, &task->subset, b, groom[b], &task->clips[0][0],
                                            frame[b], shape, NULL),
                         HG_OK);
    const hg_tensor *value = hg_hair_energy(task, s->ctx, batch, &task->subset, &unweighted);
    if (!value) fail_msg("%s", hg_message());
    const double joule = hg_tensor_item(value, 0) * (double)(n * task->subset.n) * task->reference;
    hg_step_reset(s->ctx);
    hg_free(bytes);
    return joule;
}

/* A step of two grooms is the sum of a step of each. */
static void grooms_add_up(void **state)
{
    (void)state;
    trial both = begin(NULL, 2, "[wavy, short]", NULL), wavy = begin(NULL, 2, NULL, "wavy"),
          straight = begin(NULL, 2, NULL, "short");
    assert_int_equal(hg_hair_grooms(both.task), 2);
    const double a = energy(&wavy, 1, (int32_t[]){ 0 }, (int64_t[]){ 20 });
    const double b = energy(&straight, 2, (int32_t[]){ 0, 0 }, (int64_t[]){ 31, 7 });
    const double sum = energy(&both, 3, (int32_t[]){ 0, 1, 1 }, (int64_t[]){ 20, 31, 7 });
    assert_true(a != 0 && b != 0 && fabs(a - b) > 0.01 * fabs(b));
    if (!(fabs(sum - a - b) < 1e-4 * (fabs(a) + fabs(b)))) fail_msg("%g, and %g + %g apart", sum, a, b);
    end(&both);
    end(&wavy);
    end(&straight);
}

static bool stop_at(void *self) { return (*(int *)self)-- == 0; }

static uint64_t train(trial *s, bool resume, int stop, hg_train_result *result)
{
    hg_train_options options = hg_hair_train_options(s->task);
    options.resume = resume;
    if (stop > 0) options.stop = stop_at, options.stop_self = &stop;
    if (hg_train(s->ctx, hg_hair_model(s->task), hg_hair_task_of(s->task), &options, NULL, result) != HG_OK)
        fail_msg("%s", hg_message());
    const hg_model *model = hg_hair_model(s->task);
    uint64_t hash = 0;
    for (int i = 0; i < model->n_params; i++)
        hash = hg_hash(model->params[i]->data, hg_tensor_bytes(model->params[i]), hash);
    return hash;
}

static hg_status count(void *self, const hg_drape_frame *frame)
{
    int64_t *strands = self;
    *strands = frame->strands;
    for (int64_t i = 0; i < frame->strands * frame->vertices * 3; i++)
        if (!isfinite(frame->x[i])) return hg_fail(HG_NUMERIC, "a vertex is not finite");
    return HG_OK;
}

static void several_grooms_are_learnt(void **state)
{
    (void)state;
    const char grooms[] = "[wavy, short, curly]";
    hg_train_result result;
    trial whole = begin("whole", 2, grooms, NULL);
    hg_report before = { 0 }, after = { 0 };
    const hg_task *task = hg_hair_task_of(whole.task);
    assert_int_equal(task->validate(task->self, whole.ctx, hg_hair_model(whole.task), &before), HG_OK);
    const uint64_t expected = train(&whole, false, 0, &result);
    assert_int_equal(task->validate(task->self, whole.ctx, hg_hair_model(whole.task), &after), HG_OK);
    assert_true(hg_report_get(&after, "validation") < hg_report_get(&before, "validation"));
    end(&whole);

    trial first = begin("parts", 1, grooms, NULL);
    train(&first, false, 27, &result);
    assert_true(result.interrupted);
    end(&first);
    trial second = begin("parts", 2, grooms, NULL);
    assert_true(train(&second, true, 0, &result) == expected);
    end(&second);

    /* Opened: every groom of the run, and one that it has not seen. */
    hg_ctx *ctx = NULL;
    hg_hair_task *opened = NULL;
    char path[320];
    snprintf(path, sizeof path, "%s/whole", test_folder());
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .seed = 1 }), HG_OK);
    if (hg_hair_task_open(&opened, ctx, path, NULL) != HG_OK) fail_msg("%s", hg_message());
    const char *const names[] = { "wavy", "short", "curly", "long", "straight", "short" };
    double seen[6];
    for (int i = 0; i < 6; i++) {
        if (hg_hair_choose_groom(opened, names[i]) != HG_OK) fail_msg("%s", hg_message());
        hg_hair_metrics metrics;
        const hg_motion *clip = hg_hair_clip(opened, true, 0);
        assert_int_equal(hg_hair_evaluate(opened, ctx, clip, NULL, 4, &metrics, NULL), HG_OK);
        seen[i] = metrics.energy_posed;
        assert_true(isfinite(metrics.energy) && metrics.energy != 0);
        int64_t strands = 0;
        assert_int_equal(hg_hair_drape(opened, ctx, clip, NULL, 3, 2, 1, count, &strands, NULL), HG_OK);
        assert_int_equal(strands, hg_hair_groom(opened)->strands);
    }
    assert_true(seen[1] == seen[5]); /* the same groom gives the same numbers */
    for (int i = 0; i < 5; i++)
        for (int k = 0; k < i; k++) assert_true(fabs(seen[i] - seen[k]) > 1e-3 * fabs(seen[i]));
    assert_int_not_equal(hg_hair_choose_groom(opened, "wavvy"), HG_OK);
    assert_non_null(strstr(hg_message(), "wavy"));
    hg_hair_metrics metrics; /* still usable */
    assert_int_equal(hg_hair_evaluate(opened, ctx, hg_hair_clip(opened, true, 0), NULL, 2, &metrics, NULL), HG_OK);
    hg_hair_task_destroy(opened);
    hg_ctx_destroy(ctx);
}

static void grooms_that_do_not_fit_are_refused(void **state)
{
    (void)state;
    trial s = begin(NULL, 1, NULL, "short");
    hg_groom *other = NULL;
    char path[320], list[400];
    assert_int_equal(hg_groom_grow(s.ctx, &other, hg_hair_body(s.task), "wavy", 20, 12, 1), HG_OK);
    snprintf(path, sizeof path, "%s/twelve.h5", test_folder());
    assert_int_equal(hg_groom_save(other, path), HG_OK);
    hg_groom_destroy(other);
    assert_int_equal(hg_hair_choose_groom(s.task, path), HG_INVALID);
    assert_non_null(strstr(hg_message(), "12 vertices"));
    end(&s);
    snprintf(list, sizeof list, "[short, %s]", path);
    s = begin(NULL, 1, list, NULL);
    assert_int_equal(s.status, HG_INVALID);
    assert_non_null(strstr(hg_message(), "12 vertices"));
    end(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(grooms_add_up),
        cmocka_unit_test(several_grooms_are_learnt),
        cmocka_unit_test(grooms_that_do_not_fit_are_refused),
    };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
