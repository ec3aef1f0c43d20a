/* tasks: materials as inputs of the network, and learnt ones. */
#include "hairgrad.h"
#include "tests/test.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char conditioned[] =
    "scene: { strands: 80, vertices: 9, seconds: 2 s, motion_kinds: [nod], held_out_kinds: [turn], style: wavy }\n"
    "model: { width: 32, output: directions, pinned: 2 }\n"
    "features: { shape: false, pose_joints: [Head], history: 0, latent: 5, lock_size: 16, encoder_width: 24,\n"
    "  encoder_steps: 60, materials: { bend_twist: { stiffness: [3e-10, 3e-7] } } }\n"
    "losses: { stretch: { stiffness: 2 N/m }, bend_twist: { stiffness: 1e-8 N*m^2 }, gravity: {}}\n"
    "training: { strands: 80, frames: 4, steps: 400, warm_up: 10, log_every: 10, validate_every: 100,\n"
    "  validation_frames: 4, checkpoint_every: 100, learning_rate: 5e-3 }\n";

typedef struct {
    hg_ctx *ctx;
    hg_hair_task *task;
    hg_status status;
} trial;

static trial begin(const char *run, int threads, const char *const *set)
{
    trial s = { 0 };
    int n;
    const hg_config_row *rows = hg_hair_schema(&n);
    hg_config *config = NULL;
    if (hg_config_parse(&config, conditioned, "materials.yaml", rows, n) != HG_OK) fail_msg("%s", hg_message());
    for (int i = 0; set && set[i]; i += 2)
        if (hg_config_set(config, set[i], set[i + 1]) != HG_OK) fail_msg("%s", hg_message());
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

static bool stop_at(void *self) { return (*(int *)self)-- == 0; }

static uint64_t train(trial *s, bool resume, int stop)
{
    if (s->status != HG_OK) fail_msg("%s", hg_message());
    hg_train_options options = hg_hair_train_options(s->task);
    options.resume = resume;
    if (stop > 0) options.stop = stop_at, options.stop_self = &stop;
    hg_train_result result;
    if (hg_train(s->ctx, hg_hair_model(s->task), hg_hair_task_of(s->task), &options, NULL, &result) != HG_OK)
        fail_msg("%s", hg_message());
    const hg_model *model = hg_hair_model(s->task);
    uint64_t hash = 0;
    for (int i = 0; i < model->n_params; i++)
        hash = hg_hash(model->params[i]->data, hg_tensor_bytes(model->params[i]), hash);
    return hash;
}

/* How far the tips hang below those of the posed groom, on average. */
static hg_status measure(void *self, const hg_drape_frame *frame)
{
    double *drop = self;
    for (int64_t s = 0; s < frame->strands; s++) {
        const int64_t tip = (s * frame->vertices + frame->vertices - 1) * 3 + 1;
        *drop += (double)(frame->posed[tip] - frame->x[tip]) / (double)frame->strands;
    }
    return HG_OK;
}

static double drop(trial *s, double stiffness)
{
    double value = 0;
    if (hg_hair_set_material(s->task, "bend_twist.stiffness", stiffness) != HG_OK) fail_msg("%s", hg_message());
    assert_int_equal(
        hg_hair_drape(s->task, s->ctx, hg_hair_clip(s->task, false, 0), NULL, 0, 1, 1, measure, &value, NULL), HG_OK);
    return value;
}

/* One network drapes soft and stiff hair: softer hair hangs lower, and the energies follow. */
static void one_network_for_a_range(void **state)
{
    (void)state;
    trial s = begin("range", 2, NULL);
    if (s.status != HG_OK) fail_msg("%s", hg_message());
    assert_int_equal(hg_hair_materials(s.task), 1);
    const char *name, *unit;
    double range[2], value;
    assert_int_equal(hg_hair_material_at(s.task, 0, &name, &unit, range, &value), HG_OK);
    assert_string_equal(name, "bend_twist.stiffness");
    assert_string_equal(unit, "N*m^2");
    assert_true(range[0] == 3e-10 && range[1] == 3e-7 && value == 1e-8);
    const hg_feature *feature;
    const int n = hg_hair_features(s.task, &feature);
    assert_string_equal(feature[n - 1].name, "log10(bend_twist.stiffness)");
    float raw[64];
    assert_int_equal(hg_hair_frame_features(s.task, s.ctx, hg_hair_clip(s.task, false, 0), 0, NULL, raw), HG_OK);
    assert_true(fabs((double)raw[6] + 8) < 1e-6); /* behind the six of the pose */

    assert_true(fabs(drop(&s, 1e-9) - drop(&s, 1e-7)) < 1e-9); /* untrained it makes no difference */
    train(&s, false, 0);
    const double soft = drop(&s, 4e-10), middle = drop(&s, 1e-8), stiff = drop(&s, 2.5e-7);
    if (!(soft > middle + 1e-3 && middle > stiff + 1e-3)) fail_msg("%g, %g, %g", soft, middle, stiff);
    hg_hair_metrics low, high;
    const hg_motion *clip = hg_hair_clip(s.task, true, 0);
    hg_hair_set_material(s.task, name, 4e-10);
    assert_int_equal(hg_hair_evaluate(s.task, s.ctx, clip, NULL, 3, &low, NULL), HG_OK);
    hg_hair_set_material(s.task, name, 2.5e-7);
    assert_int_equal(hg_hair_evaluate(s.task, s.ctx, clip, NULL, 3, &high, NULL), HG_OK);
    assert_true(low.energy < high.energy); /* stiffer hair gives way less */
    assert_int_equal(hg_hair_set_material(s.task, name, 1e-6), HG_INVALID);
    assert_int_equal(hg_hair_set_material(s.task, "stretch.stiffness", 2), HG_INVALID);
    assert_non_null(strstr(hg_message(), "bend_twist.stiffness"));
    end(&s);
}

static const char *const quick[] = {
    "training.steps", "30", "training.checkpoint_every", "10", "training.ema", "0.9", NULL
};

static void drawn_materials_resume_to_the_bit(void **state)
{
    (void)state;
    trial whole = begin("whole", 2, quick);
    const uint64_t expected = train(&whole, false, 0);
    end(&whole);
    trial first = begin("parts", 1, quick);
    train(&first, false, 17);
    end(&first);
    trial second = begin("parts", 2, quick);
    assert_true(train(&second, true, 0) == expected);
    end(&second);
}

/* Without data a learnt stiffness goes down, and stays positive: the energy is smallest without it. */
static void a_parameter_is_learnt(void **state)
{
    (void)state;
    const char *const set[] = { "training.steps",
                                "60",
                                "training.checkpoint_every",
                                "20",
                                "features.materials.bend_twist.stiffness",
                                "[]",
                                "losses.bend_twist.learn",
                                "[stiffness]",
                                "losses.bend_twist.stiffness",
                                "1e-7",
                                NULL };
    trial s = begin("learnt", 2, set);
    const uint64_t expected = train(&s, false, 0);
    const hg_model *model = hg_hair_model(s.task);
    const hg_tensor *theta = model->params[model->n_params - 1];
    assert_string_equal(theta->name, "material.bend_twist.stiffness");
    const double learnt = hg_tensor_item(theta, 0);
    if (!(learnt < -0.02 && isfinite(learnt))) fail_msg("theta %g", learnt);
    end(&s);
    void *log = NULL;
    size_t size;
    char path[320];
    snprintf(path, sizeof path, "%s/learnt/log.jsonl", test_folder());
    assert_int_equal(hg_file_read(path, &log, &size), HG_OK);
    const char *last = NULL;
    for (const char *at = log; (at = strstr(at, "\"material.bend_twist.stiffness\": ")); at++) last = at;
    assert_non_null(last);
    assert_true(fabs(strtod(strchr(last, ':') + 1, NULL) / (1e-7 * exp(learnt)) - 1) < 0.01); /* of the step before */
    hg_free(log);

    trial first = begin("learnt_parts", 1, set);
    train(&first, false, 33);
    end(&first);
    trial second = begin("learnt_parts", 2, set);
    assert_true(train(&second, true, 0) == expected);
    end(&second);
    hg_ctx *ctx = NULL;
    hg_hair_task *opened = NULL;
    snprintf(path, sizeof path, "%s/learnt", test_folder());
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .seed = 1 }), HG_OK);
    if (hg_hair_task_open(&opened, ctx, path, NULL) != HG_OK) fail_msg("%s", hg_message());
    assert_true(hg_tensor_item(hg_hair_model(opened)->params[hg_hair_model(opened)->n_params - 1], 0) < 0);
    hg_hair_metrics metrics;
    assert_int_equal(hg_hair_evaluate(opened, ctx, hg_hair_clip(opened, true, 0), NULL, 2, &metrics, NULL), HG_OK);
    hg_hair_task_destroy(opened);
    hg_ctx_destroy(ctx);
}

/* A stiffness per strand on the tape, with something that holds against it: E(k) - sum_s c_s log k_s is smallest where
 * k_s = c_s / (E_s at k = 1), which is known without learning. */
static void a_stiffness_per_strand_is_learnt(void **state)
{
    (void)state;
    enum { S = 7, V = 6 };
    hg_ctx *ctx = NULL;
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .seed = 1 }), HG_OK);
    double rest[S * V * 3];
    hg_tensor *x = hg_tensor_create(ctx, HG_F32, 4, (int64_t[]){ 1, S, V, 3 });
    for (int i = 0; i < S * V * 3; i++) {
        rest[i] = 0.01 * (i % (V * 3) / 3) * (i % 3 == 1) + 0.002 * hg_random_normal(1, 2, (uint64_t)i);
        ((float *)x->data)[i] = (float)(rest[i] + 0.001 * hg_random_normal(1, 3, (uint64_t)i));
    }
    const hg_term term = { hg_energy_find("bend_twist"), 1, (const double[]){ 1 }, NULL };
    const hg_groom_data data = { .grooms = 1, .strands = S, .vertices = V, .rest = rest };
    hg_physics *physics = NULL;
    assert_int_equal(hg_physics_create(&physics, ctx, HG_F32, &term, 1, &data), HG_OK);
    double energy[S];
    assert_int_equal(hg_physics_evaluate(physics, ctx, &(hg_frame){ 0 }, x, NULL, energy, NULL), HG_OK);

    hg_tensor *theta = hg_tensor_create(ctx, HG_F32, 1, (int64_t[]){ S });
    hg_tensor *pull = hg_tensor_create(ctx, HG_F32, 1, (int64_t[]){ S });
    for (int s = 0; s < S; s++) ((float *)pull->data)[s] = (float)(energy[s] * 1e-8 * (1 + s)); /* k_s = 1e-8 (1 + s) */
    double scale = 0;
    for (int s = 0; s < S; s++) scale = fmax(scale, energy[s] * 1e-8);
    assert_int_equal(hg_require_grad(theta), HG_OK);
    hg_adam *adam = NULL;
    assert_int_equal(hg_adam_create(&adam, ctx, 1, &theta), HG_OK);
    for (int step = 0; step < 1500; step++) {
        hg_step_reset(ctx);
        const hg_frame_input input = { "bend_twist.stiffness", hg_scale(ctx, hg_exp(ctx, theta), 3e-8, 0) };
        const hg_frame frame = { .inputs = &input, .n_inputs = 1 };
        hg_tensor *loss =
            hg_sub(ctx, hg_physics_energy(physics, ctx, &frame, x, NULL), hg_sum(ctx, hg_mul(ctx, pull, theta)));
        if (hg_backward(ctx, hg_scale(ctx, loss, 1 / scale, 0)) != HG_OK) fail_msg("%s", hg_message());
        assert_int_equal(hg_adam_step(adam, step < 1000 ? 2e-2 : 1e-3, 0.9, 0.999, 1e-8, 0, 0, NULL), HG_OK);
    }
    for (int s = 0; s < S; s++) {
        const double learnt = 3e-8 * exp(hg_tensor_item(theta, s)), expected = 1e-8 * (1 + s);
        if (!(fabs(learnt - expected) < 2e-3 * expected)) fail_msg("strand %d: %g, expected %g", s, learnt, expected);
    }
    hg_step_reset(ctx);
    hg_adam_destroy(adam);
    hg_tensor_destroy(theta);
    hg_tensor_destroy(pull);
    hg_tensor_destroy(x);
    hg_physics_destroy(physics);
    hg_ctx_destroy(ctx);
}

static double loss_of_step(const char *const *set, uint64_t step)
{
    trial s = begin(NULL, 1, set);
    if (s.status != HG_OK) fail_msg("%s", hg_message());
    const hg_task *task = hg_hair_task_of(s.task);
    void *batch = calloc(1, task->batch_bytes);
    hg_report report = { 0 };
    assert_int_equal(task->sample(task->self, s.ctx, 1, step, batch), HG_OK);
    hg_tensor *loss = task->loss(task->self, s.ctx, hg_hair_model(s.task), batch, &report);
    assert_non_null(loss);
    const double value = hg_tensor_item(loss, 0);
    free(batch);
    end(&s);
    return value;
}

/* A stiffness with a ramp is that part of it in the first step, its root mean half way, all of it at the end and in validations; a
 * run that was broken off goes on with what the step has. */
static void a_stiffness_rises(void **state)
{
    (void)state;
#define SPRING                                                                                                         \
    "features.materials.bend_twist.stiffness", "[]", "losses.hair_style.weight", "1", "losses.hair_style.s_max", "1 m"
    static const struct {
        uint64_t step;
        const char *stiffness;
    } same[] = { { 0, "0.001" }, { 10, "0.01" }, { 20, "0.1" }, { 33, "0.1" } };
    double before = 0;
    for (int i = 0; i < 4; i++) {
        const char *const ramped[] = { SPRING, "losses.adhesion.weight",
                                       "1",    "losses.adhesion.radius",
                                       "5 cm", "losses.adhesion.stiffness",
                                       "0.1",  "losses.adhesion.ramp",
                                       "0.01", "training.ramp",
                                       "0.5",  "training.steps",
                                       "40",   "model.pinned",
                                       "1",    NULL };
        const char *const plain[] = { SPRING,
                                      "losses.adhesion.weight",
                                      "1",
                                      "losses.adhesion.radius",
                                      "5 cm",
                                      "losses.adhesion.stiffness",
                                      same[i].stiffness,
                                      "training.steps",
                                      "40",
                                      "model.pinned",
                                      "1",
                                      NULL };
        const double a = loss_of_step(ramped, same[i].step), b = loss_of_step(plain, same[i].step);
        if (!(fabs(a - b) <= 1e-6 * fabs(b))) fail_msg("step %d: %.9g, expected %.9g", (int)same[i].step, a, b);
        assert_true(i == 0 || i == 3 || fabs(b - before) > 1e-3 * fabs(b)); /* it matters */
        before = b;
    }
    const char *const run[] = { SPRING, "losses.hair_style.ramp",    "1e-3", "training.steps",
                                "30",   "training.checkpoint_every", "10",   NULL };
    trial whole = begin("risen", 2, run);
    const uint64_t expected = train(&whole, false, 0);
    end(&whole);
    trial first = begin("risen_parts", 1, run);
    train(&first, false, 17);
    end(&first);
    trial second = begin("risen_parts", 2, run);
    assert_true(train(&second, true, 0) == expected);
    end(&second);
    static const char *const wrong[][4] = { { "losses.bend_twist.ramp", "0", "features.materials.bend_twist.stiffness",
                                              "[]" },
                                            { "losses.bend_twist.ramp", "0.1", "training.ramp", "0.5" } };
    const char *const said[] = { "above 0", "input of the network already" };
    for (int i = 0; i < 2; i++) {
        trial s = begin(NULL, 1, (const char *const[]){ wrong[i][0], wrong[i][1], wrong[i][2], wrong[i][3], NULL });
        assert_int_equal(s.status, HG_INVALID);
        if (!strstr(hg_message(), said[i])) fail_msg("%s", hg_message());
        end(&s);
    }
#undef SPRING
}

static void wrong_materials_are_refused(void **state)
{
    (void)state;
    const char *const wrong[][2] = { { "features.materials.bend_twist.stiffness", "[1e-7, 1e-9]" },
                                     { "features.materials.bend_twist.stiffness", "[1e-7, 1e-6]" },
                                     { "features.materials.bend_twist.stiffness", "[1e-9]" },
                                     { "features.materials.drag.c", "[1, 3]" },
                                     { "losses.bend_twist.learn", "[stifness]" },
                                     { "losses.bend_twist.learn", "[stiffness]" } };
    const char *const said[] = { "highest above", "is not between",   "two numbers",
                                 "not among",     "has no parameter", "input of the network already" };
    for (int i = 0; i < 6; i++) {
        trial s = begin(NULL, 1, (const char *const[]){ wrong[i][0], wrong[i][1], NULL });
        assert_int_equal(s.status, HG_INVALID);
        if (!strstr(hg_message(), said[i])) fail_msg("%s", hg_message());
        end(&s);
    }
}

/* bf16 products while training: another network, about as good, validated in f32. */
static void bf16_compute(void **state)
{
    (void)state;
    const char *const set[] = {
        "training.compute", "bf16", "training.steps", "60", "training.validate_every", "0", NULL
    };
    const char *const same[] = {
        "training.compute", "f32", "training.steps", "60", "training.validate_every", "0", NULL
    };
    trial t = begin(NULL, 2, (const char *const[]){ "training.compute", "tf32", NULL }); /* GPUs alone have it */
    assert_int_equal(t.status, HG_UNSUPPORTED);
    assert_non_null(strstr(hg_message(), "training.compute: compute in tf32"));
    end(&t);
    trial s = begin(NULL, 2, set);
    if (s.status == HG_UNSUPPORTED) {
        assert_non_null(strstr(hg_message(), "training.compute"));
        end(&s);
        skip();
    }
    const uint64_t hash = train(&s, false, 0);
    assert_non_null(strstr(hg_hair_train_options(s.task).backend, "bf16"));
    assert_int_equal(hg_ctx_compute_dtype(s.ctx), HG_F32); /* as it was */
    hg_report rounded = { 0 }, plain = { 0 };
    const hg_task *task = hg_hair_task_of(s.task);
    assert_int_equal(task->validate(task->self, s.ctx, hg_hair_model(s.task), &rounded), HG_OK);
    end(&s);
    trial p = begin(NULL, 2, same);
    assert_true(train(&p, false, 0) != hash);
    task = hg_hair_task_of(p.task);
    assert_int_equal(task->validate(task->self, p.ctx, hg_hair_model(p.task), &plain), HG_OK);
    const double a = hg_report_get(&rounded, "validation"), b = hg_report_get(&plain, "validation");
    if (!(fabs(a - b) < 0.1 * fabs(b))) fail_msg("%g in bf16, %g in f32", a, b);
    end(&p);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(one_network_for_a_range),
        cmocka_unit_test(drawn_materials_resume_to_the_bit),
        cmocka_unit_test(a_parameter_is_learnt),
        cmocka_unit_test(a_stiffness_rises),
        cmocka_unit_test(wrong_materials_are_refused),
        cmocka_unit_test(bf16_compute),
        cmocka_unit_test(a_stiffness_per_strand_is_learnt),
    };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
