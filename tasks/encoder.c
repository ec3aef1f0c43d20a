/* encoder: what describes a groom to the network comes from an autoencoder that is trained once on the grooms and then frozen.
 * It is kept in the run folder (encoder.h5) and in every checkpoint. What it is and what it learns from is its family's. */
#include "tasks/hair.h"

#include <math.h>
#include <string.h>

/* ---- grooms ------------------------------------------------------------------------------------------------- */

/* Locks, which are clusters of roots in UV of the FULL groom, and room for the features. */
static hg_status make_style(const hg_hair_task *task, hg_hair_style *style)
{
    const hg_groom *groom = style->groom;
    const int64_t rows = task->network->of_grooms ? 1 : groom->strands;
    style->raw = hg_alloc((size_t)(rows * task->strand_inputs), sizeof *style->raw);
    style->lock = hg_alloc((size_t)groom->strands, sizeof *style->lock);
    if (!style->raw || !style->lock) return HG_MEMORY;
    return hg_clusters(groom->strands, groom->root_uv, (int)hg_config_integer(task->config, "features.lock_size"),
                       style->lock, &style->locks);
}

hg_status hg_hair_style_strands(hg_hair_task *task, hg_hair_style *style)
{
    HG_TRY(make_style(task, style));
    return task->network->encode(task, style);
}

hg_status hg_hair_encode(hg_hair_task *task)
{
    for (int g = 0; g < task->n_styles; g++)
        if (task->styles[g].raw) HG_TRY(task->network->encode(task, &task->styles[g]));
    return HG_OK;
}

/* ---- training ----------------------------------------------------------------------------------------------- */

hg_status hg_hair_encoder_learn(hg_hair_task *task, const hg_task *learn, const hg_progress *progress)
{
    hg_train_options options = hg_train_defaults();
    options.steps = hg_config_integer(task->config, "features.encoder_steps");
    options.learning_rate = 1e-3;
    options.warm_up = options.steps < 100 ? 0 : 20;
    options.final_fraction = 0.02;
    hg_train_result result;
    const hg_status status = hg_train(task->ctx, task->encoder, learn, &options, progress, &result);
    hg_step_reset(task->ctx);
    return status;
}

/* Vertices 1.. relative to their roots are of order one over all grooms. */
static double strand_scale(const hg_hair_task *task)
{
    const int inputs = (int)(task->groom->vertices - 1) * 3;
    double squares = 0, count = 0;
    for (int g = 0; g < task->n_grooms; g++) {
        const hg_groom *groom = task->styles[g].groom;
        for (int64_t s = 0; s < groom->strands; s++) {
            const float *root = groom->points + s * groom->vertices * 3;
            for (int i = 0; i < inputs; i++) {
                const double d = (double)(root[3 + i] - root[i % 3]);
                squares += d * d;
            }
        }
        count += (double)groom->strands * inputs;
    }
    return (double)(float)(1 / fmax(sqrt(squares / count), 1e-6));
}

/* ---- files -------------------------------------------------------------------------------------------------- */

hg_status hg_hair_encoder_save(const hg_hair_task *task, hg_h5 *file)
{
    char name[160];
    for (int i = 0; i < task->encoder->n_params; i++) {
        const hg_tensor *param = task->encoder->params[i];
        void *values = hg_alloc(hg_tensor_bytes(param) + 1, 1);
        snprintf(name, sizeof name, "/encoder/%s", param->name);
        hg_status status = values ? hg_tensor_read(param, values) : HG_MEMORY;
        if (status == HG_OK) status = hg_h5_write(file, name, HG_F32, param->rank, param->shape, values);
        hg_free(values);
        HG_TRY(status);
    }
    return hg_h5_write(file, "/features/strand_scale", HG_F64, 1, (int64_t[]){ 1 }, &task->strand_scale);
}

hg_status hg_hair_encoder_load(hg_hair_task *task, hg_h5 *file)
{
    for (int i = 0; i < task->encoder->n_params; i++) {
        hg_tensor *param = task->encoder->params[i];
        char name[160];
        void *values = NULL;
        snprintf(name, sizeof name, "/encoder/%s", param->name);
        HG_TRY(hg_h5_read(file, name, HG_F32, param->rank, param->shape, NULL, &values));
        const hg_status status = hg_tensor_write(param, values);
        hg_free(values);
        HG_TRY(status);
    }
    if (!hg_h5_has(file, "/features/strand_scale")) return HG_OK; /* an older one: that of the groom itself */
    double *scale = NULL;
    HG_TRY(hg_h5_read(file, "/features/strand_scale", HG_F64, 1, (int64_t[]){ 1 }, NULL, (void **)&scale));
    const double value = scale[0];
    hg_free(scale);
    if (!(value > 0) || !isfinite(value))
        return hg_fail(HG_FORMAT, "checkpoint: /features/strand_scale is %g, it has to be positive", value);
    task->strand_scale = value;
    return HG_OK;
}

/* The encoder of the checkpoint that training starts from. */
static hg_status encoder_of_start(hg_hair_task *task)
{
    hg_h5 *file = NULL;
    HG_TRY(hg_h5_open(&file, task->start_from));
    const hg_status status = hg_hair_encoder_load(task, file);
    hg_h5_close(file);
    return status;
}

/* What the encoder depends on: a stored one with another hash is not used. */
static uint64_t encoder_hash(const hg_hair_task *task)
{
    const int64_t settings[] = { task->latent, hg_config_integer(task->config, "features.encoder_width"),
                                 hg_config_integer(task->config, "features.encoder_steps"), (int64_t)task->seed };
    uint64_t hash = hg_hash(settings, sizeof settings, hg_hair_grooms_hash(task));
    if (task->network->images) {
        const int64_t sizes[] = { hg_config_integer(task->config, "model.texture"),
                                  hg_config_integer(task->config, "model.depth") };
        hash = hg_hash(sizes, sizeof sizes, hash);
    }
    const char *from = hg_config_text(task->config, "training.start_from");
    return from[0] ? hg_hash(from, strlen(from), hash) : hash;
}

static hg_status stored_encoder(hg_hair_task *task, const char *path, uint64_t hash, bool *found)
{
    *found = false;
    if (!path || !hg_file_exists(path)) return HG_OK;
    uint64_t stored = 0;
    hg_h5 *file = NULL;
    HG_TRY(hg_h5_open(&file, path));
    char *text = NULL;
    const hg_status status = hg_h5_get_text(file, "/", "config_hash", &text);
    hg_h5_close(file);
    if (status != HG_OK) return status;
    sscanf(text, "%llx", (unsigned long long *)&stored);
    hg_free(text);
    if (stored != hash) return HG_OK;
    HG_TRY(hg_checkpoint_load(path, task->encoder, NULL, NULL, NULL, NULL, NULL));
    *found = true;
    return HG_OK;
}

hg_status hg_hair_encoder_keep(const hg_hair_task *task)
{
    if (!task->encoder_trained) return HG_OK;
    char *path = hg_path_join(task->folder, "encoder.h5");
    if (!path) return HG_MEMORY;
    const hg_status status = hg_checkpoint_save(path, task->encoder, NULL, 0, NULL, "", encoder_hash(task));
    hg_free(path);
    return status;
}

/* ---- create ------------------------------------------------------------------------------------------------- */

hg_status hg_hair_encoder_create(hg_hair_task *task, const hg_progress *progress)
{
    task->strand_scale = strand_scale(task);
    HG_TRY(task->network->make_encoder(task));
    for (int g = 0; g < task->n_grooms; g++) HG_TRY(make_style(task, &task->styles[g]));

    char *path = task->folder ? hg_path_join(task->folder, "encoder.h5") : NULL;
    const uint64_t hash = encoder_hash(task);
    bool found = false;
    hg_status status = task->folder && !path ? HG_MEMORY : HG_OK;
    /* A run that is opened brings its encoder with the checkpoint. */
    if (status == HG_OK && !task->opened) status = stored_encoder(task, path, hash, &found);
    if (status == HG_OK && !task->opened && !found) {
        hg_progress_report(progress, 0, "%s", task->network->encoder_label);
        status = task->start_from ? encoder_of_start(task) : task->network->train_encoder(task, progress);
        task->encoder_trained = status == HG_OK;
    }
    hg_free(path);
    HG_TRY(status);
    return hg_hair_encode(task);
}

hg_status hg_hair_strand_features(hg_hair_task *task, hg_ctx *ctx, const int32_t *strand, int64_t n, float *out)
{
    (void)ctx;
    const float *raw = task->styles[task->current].raw;
    for (int64_t i = 0; i < n; i++) {
        const int64_t s = strand ? strand[i] : i;
        if (s < 0 || s >= task->groom->strands)
            return hg_fail(HG_INVALID, "strand %lld is not one of the %lld of the groom", (long long)s,
                           (long long)task->groom->strands);
        float *row = out + i * (task->strand_inputs + task->rest_columns);
        const float *root = task->groom->points + s * task->groom->vertices * 3;
        memcpy(row, raw + (task->network->of_grooms ? 0 : s) * task->strand_inputs,
               (size_t)task->strand_inputs * sizeof *row);
        for (int k = 0; k < task->rest_columns; k++) row[task->strand_inputs + k] = root[3 + k] - root[k % 3];
    }
    return HG_OK;
}
