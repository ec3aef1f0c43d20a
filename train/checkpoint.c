/* checkpoint: one HDF5 file from which a run goes on bit for bit:
 *   /model/<parameter>    f32 weights, by name          /adam/m, /adam/v, /adam/step    the optimiser
 *   /average/weights      with a moving average: /model is the average, and this is what training goes on from
 *   /step, /best_validation, /seconds, /unimproved      attributes: kind, backend, config_hash (hex)
 *   whatever the task adds with its `save`
 * It is written under a temporary name and renamed: a run killed while it writes leaves the old one. */
#include "train/state.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

hg_status hg_state_read_count(hg_h5 *file, const char *name, int64_t *value)
{
    double *read = NULL;
    HG_TRY(hg_h5_read(file, name, HG_F64, 1, (int64_t[]){ 1 }, NULL, (void **)&read));
    const double number = read[0];
    hg_free(read);
    if (!(number >= 0 && number < 9e15)) return hg_fail(HG_FORMAT, "%s holds %g, expected a step number", name, number);
    *value = (int64_t)number;
    return HG_OK;
}

hg_status hg_state_write_tensor(hg_h5 *file, const char *name, const hg_tensor *tensor)
{
    if (hg_ctx_host(tensor->ctx))
        return hg_h5_write(file, name, tensor->dtype, tensor->rank, tensor->shape, tensor->data);
    void *copy = hg_alloc(hg_tensor_bytes(tensor) + 1, 1);
    if (!copy) return HG_MEMORY;
    hg_status status = hg_tensor_read(tensor, copy);
    if (status == HG_OK) status = hg_h5_write(file, name, tensor->dtype, tensor->rank, tensor->shape, copy);
    hg_free(copy);
    return status;
}

hg_status hg_state_read_tensor(hg_h5 *file, const char *name, hg_tensor *tensor)
{
    void *values = NULL;
    HG_TRY(hg_h5_read(file, name, tensor->dtype, tensor->rank, tensor->shape, NULL, &values));
    const hg_status status = hg_tensor_write(tensor, values);
    hg_free(values);
    return status;
}

static hg_status write_all(hg_h5 *file, const hg_model *model, const hg_adam *adam, const hg_average *average,
                           const hg_train_state *state, const hg_task *task, const char *backend, uint64_t config_hash)
{
    HG_TRY(hg_h5_group(file, "/model"));
    HG_TRY(hg_h5_set_text(file, "/model", "kind", model->kind));
    for (int i = 0; i < model->n_params; i++) {
        const hg_tensor *param = model->params[i];
        char name[160];
        snprintf(name, sizeof name, "/model/%s", param->name);
        HG_TRY(hg_state_write_tensor(file, name, param));
    }
    if (adam) HG_TRY(hg_adam_save(adam, file));
    if (average) HG_TRY(hg_average_save(average, file));
    char hash[24];
    snprintf(hash, sizeof hash, "%016" PRIx64, config_hash);
    HG_TRY(hg_h5_set_text(file, "/", "backend", backend ? backend : ""));
    HG_TRY(hg_h5_set_text(file, "/", "config_hash", hash));
    HG_TRY(hg_h5_write_i64(file, "/step", 1, (int64_t[]){ 1 }, &state->step));
    HG_TRY(hg_h5_write(file, "/best_validation", HG_F64, 1, (int64_t[]){ 1 }, &state->best_validation));
    HG_TRY(hg_h5_write(file, "/seconds", HG_F64, 1, (int64_t[]){ 1 }, &state->seconds));
    HG_TRY(hg_h5_write_i64(file, "/unimproved", 1, (int64_t[]){ 1 }, &state->unimproved));
    if (task && task->save) HG_TRY(task->save(task->self, file));
    return HG_OK;
}

hg_status hg_state_save(const char *path, const hg_model *model, const hg_adam *adam, const hg_average *average,
                        const hg_train_state *state, const hg_task *task, const char *backend, uint64_t config_hash)
{
    hg_h5 *file = NULL;
    HG_TRY(hg_h5_create(&file, path));
    const hg_status status = write_all(file, model, adam, average, state, task, backend, config_hash);
    if (status != HG_OK) {
        hg_h5_close(file);
        return status;
    }
    return hg_h5_commit(file);
}

static hg_status read_weights(hg_h5 *file, const char *path, hg_model *model)
{
    char *kind = NULL;
    HG_TRY(hg_h5_get_text(file, "/model", "kind", &kind));
    const bool same = !strcmp(kind, model->kind);
    const hg_status status =
        same ? HG_OK : hg_fail(HG_INVALID, "%s: it holds a %s, expected a %s", path, kind, model->kind);
    hg_free(kind);
    HG_TRY(status);
    for (int i = 0; i < model->n_params; i++) {
        hg_tensor *param = model->params[i];
        char name[160];
        snprintf(name, sizeof name, "/model/%s", param->name);
        HG_TRY(hg_state_read_tensor(file, name, param));
    }
    return HG_OK;
}

/* The first parameter that another run has in another shape, or not at all, is named with both shapes. */
static hg_status same_parameters(hg_h5 *file, const char *path, const hg_model *model)
{
    for (int i = 0; i < model->n_params; i++) {
        const hg_tensor *param = model->params[i];
        char name[160], here[96];
        int rank = 0;
        int64_t shape[6] = { 0 };
        snprintf(name, sizeof name, "/model/%s", param->name);
        if (!hg_h5_has(file, name))
            return hg_fail(HG_INVALID, "%s: it has no %s, which the network to be trained has (%s)", path, name + 7,
                           hg_shape_text(param, here));
        HG_TRY(hg_h5_shape(file, name, &rank, shape));
        bool same = rank == param->rank;
        for (int k = 0; same && k < rank; k++) same = shape[k] == param->shape[k];
        if (same) continue;
        hg_text there = { 0 };
        for (int k = 0; k < rank; k++) hg_text_add(&there, "%s%lld", k ? "," : "", (long long)shape[k]);
        const hg_status status = hg_fail(
            HG_INVALID,
            "%s: %s is [%s] there and %s in the network to be trained; to start from it, `model:`, `features:` and the "
            "vertices of a strand have to be those that it was trained with",
            path, name + 7, there.data ? there.data : "", hg_shape_text(param, here));
        hg_text_free(&there);
        return status;
    }
    return HG_OK;
}

hg_status hg_state_start(const char *path, hg_model *model, const hg_task *task)
{
    hg_h5 *file = NULL;
    HG_TRY(hg_h5_open(&file, path));
    hg_status status = hg_h5_has(file, "/model")
                           ? same_parameters(file, path, model)
                           : hg_fail(HG_FORMAT, "%s: it holds no network, so nothing can start from it", path);
    if (status == HG_OK) status = read_weights(file, path, model);
    if (status == HG_OK && task && task->start) status = task->start(task->self, file);
    hg_h5_close(file);
    return status;
}

static hg_status read_number(hg_h5 *file, const char *name, double *value)
{
    double *read = NULL;
    HG_TRY(hg_h5_read(file, name, HG_F64, 1, (int64_t[]){ 1 }, NULL, (void **)&read));
    *value = read[0];
    hg_free(read);
    return HG_OK;
}

static hg_status read_all(hg_h5 *file, const char *path, hg_model *model, hg_adam *adam, hg_average *average,
                          hg_train_state *state, const hg_task *task, char **backend, uint64_t *config_hash)
{
    HG_TRY(read_weights(file, path, model));
    if (adam) HG_TRY(hg_adam_load(adam, file));
    if (state) {
        HG_TRY(hg_state_read_count(file, "/step", &state->step));
        HG_TRY(read_number(file, "/best_validation", &state->best_validation));
        HG_TRY(read_number(file, "/seconds", &state->seconds));
        if (hg_h5_has(file, "/unimproved")) HG_TRY(hg_state_read_count(file, "/unimproved", &state->unimproved));
    }
    if (config_hash) {
        char *hash = NULL;
        HG_TRY(hg_h5_get_text(file, "/", "config_hash", &hash));
        *config_hash = strtoull(hash, NULL, 16);
        hg_free(hash);
    }
    if (average) HG_TRY(hg_average_load(average, file));
    if (task && task->load) HG_TRY(task->load(task->self, file));
    if (backend) HG_TRY(hg_h5_get_text(file, "/", "backend", backend));
    return HG_OK;
}

hg_status hg_state_load(const char *path, hg_model *model, hg_adam *adam, hg_average *average, hg_train_state *state,
                        const hg_task *task, char **backend, uint64_t *config_hash)
{
    hg_h5 *file = NULL;
    HG_TRY(hg_h5_open(&file, path));
    const hg_status status = read_all(file, path, model, adam, average, state, task, backend, config_hash);
    hg_h5_close(file);
    return status;
}

hg_status hg_checkpoint_save(const char *path, const hg_model *model, const hg_adam *adam, int64_t step,
                             const hg_task *task, const char *backend, uint64_t config_hash)
{
    const hg_train_state state = { .step = step, .best_validation = INFINITY };
    return hg_state_save(path, model, adam, NULL, &state, task, backend, config_hash);
}

hg_status hg_checkpoint_load(const char *path, hg_model *model, hg_adam *adam, int64_t *step, const hg_task *task,
                             char **backend, uint64_t *config_hash)
{
    hg_train_state state = { 0 };
    HG_TRY(hg_state_load(path, model, adam, NULL, &state, task, backend, config_hash));
    if (step) *step = state.step;
    return HG_OK;
}
