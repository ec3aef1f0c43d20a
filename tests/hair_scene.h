/* A hair task of a few strands, which tests of tasks share: made from a config's text and keys set on top of it. */
#ifndef TESTS_HAIR_SCENE_H
#define TESTS_HAIR_SCENE_H

#include "hairgrad.h"
#include "tasks/hair.h"

#include "tests/device.h"
#include "tests/test.h"

#define OK(call_)                                                                                                      \
    do {                                                                                                               \
        if ((call_) != HG_OK) fail_msg("%s", hg_message());                                                            \
    } while (0)

typedef struct {
    hg_ctx *ctx;
    hg_hair_task *task;
} trial;

/* run: a folder in the test's; NULL: none is written. */
__attribute__((unused)) static trial trial_begin(const char *text, const char *run, int threads, int n,
                                                 const char *const (*set)[2])
{
    trial s = { 0 };
    int n_rows;
    const hg_config_row *rows = hg_hair_schema(&n_rows);
    hg_config *config = NULL;
    OK(hg_config_parse(&config, text, "tiny.yaml", rows, n_rows));
    for (int i = 0; i < n; i++) OK(hg_config_set(config, set[i][0], set[i][1]));
    OK(hg_ctx_create(&s.ctx, &(hg_ctx_options){ .threads = threads, .seed = 1, .device = test_device() }));
    char *path = run ? test_path(run) : NULL;
    OK(hg_hair_task_create(&s.task, s.ctx, config, path, NULL));
    hg_free(path);
    hg_config_destroy(config);
    return s;
}

__attribute__((unused)) static void trial_end(trial *s)
{
    hg_hair_task_destroy(s->task);
    hg_ctx_destroy(s->ctx);
    *s = (trial){ 0 };
}

/* The last layer begins at zero, and with it every displacement and nearly every gradient. */
__attribute__((unused)) static void trial_wake(trial *s)
{
    const hg_model *model = hg_hair_model(s->task);
    hg_tensor *weight = model->params[model->n_params - 2];
    float *values = malloc(hg_tensor_bytes(weight));
    assert_non_null(values);
    for (int64_t i = 0; i < hg_tensor_count(weight); i++)
        values[i] = (float)(0.3 * hg_random_normal(9, 77, (uint64_t)i));
    OK(hg_tensor_write(weight, values));
    free(values);
}

#endif
