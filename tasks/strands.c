/* strands: what the network is told of a strand: [root UV 2 | z_rest | z_lock].
 *
 * z_rest is the code of the rest strand, seen from its root in head rest space, by an autoencoder that is trained once on
 * every strand of the grooms and then frozen. z_lock is the mean code of the strand's lock; locks are clusters of roots
 * in UV of the FULL groom, so that a strand has the same features whichever strands are drawn with it. The encoder is
 * kept in the run folder (encoder.h5) and in every checkpoint. */
#include "tasks/hair.h"

#include <math.h>
#include <string.h>

enum { ROWS = 4096 }; /* strands encoded at a time */

/* ---- autoencoder training ----------------------------------------------------------------------------------- */

typedef struct {
    float *strands; /* [S,inputs], order one */
    int64_t n, batch;
    int inputs;
} encoder_task;

static int64_t strands_of_all(const hg_hair_task *task)
{
    int64_t n = 0;
    for (int g = 0; g < task->n_grooms; g++) n += task->styles[g].groom->strands;
    return n;
}

static hg_status encoder_sample(void *self, hg_ctx *ctx, uint64_t seed, uint64_t step, void *batch)
{
    const encoder_task *task = self;
    (void)ctx;
    float *rows = batch;
    for (int64_t i = 0; i < task->batch; i++) {
        const uint64_t s = hg_random_below(seed, 7001, step * (uint64_t)task->batch + (uint64_t)i, (uint64_t)task->n);
        memcpy(rows + i * task->inputs, task->strands + (int64_t)s * task->inputs, (size_t)task->inputs * sizeof *rows);
    }
    return HG_OK;
}

static hg_tensor *encoder_loss(void *self, hg_ctx *ctx, hg_model *model, const void *batch, hg_report *report)
{
    const encoder_task *task = self;
    (void)report;
    hg_tensor *x = hg_tensor_from(ctx, HG_F32, 2, (int64_t[]){ task->batch, task->inputs }, batch);
    hg_tensor *y = model->forward(model->self, ctx, &x, 1);
    return hg_mean(ctx, hg_square(ctx, hg_sub(ctx, y, x)));
}

static hg_status train_encoder(hg_hair_task *task, float *strands, int inputs, const hg_progress *progress)
{
    encoder_task data = { .strands = strands, .n = strands_of_all(task), .inputs = inputs };
    data.batch = data.n < 512 ? data.n : 512;
    const hg_task learn = { .self = &data,
                            .batch_bytes = (size_t)(data.batch * inputs) * sizeof(float),
                            .sample = encoder_sample,
                            .loss = encoder_loss };
    hg_train_options options = hg_train_defaults();
    options.steps = hg_config_integer(task->config, "features.encoder_steps");
    options.learning_rate = 1e-3;
    options.warm_up = options.steps < 100 ? 0 : 20;
    options.final_fraction = 0.02;
    hg_train_result result;
    const hg_status status = hg_train(task->ctx, task->encoder, &learn, &options, progress, &result);
    hg_step_reset(task->ctx);
    return status;
}

/* ---- codes -------------------------------------------------------------------------------------------------- */

/* Vertices 1.. relative to the root, times the scale. */
static void strand_rows(const hg_groom *groom, int64_t first, int64_t count, int inputs, float scale, float *out)
{
    for (int64_t s = 0; s < count; s++) {
        const float *root = groom->points + (first + s) * groom->vertices * 3;
        for (int i = 0; i < inputs; i++) out[s * inputs + i] = (root[3 + i] - root[i % 3]) * scale;
    }
}

/* So that they are of order one over all grooms. */
static double strand_scale(const hg_hair_task *task, int inputs)
{
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

static float *all_rows(const hg_hair_task *task, int inputs)
{
    float *out = hg_alloc((size_t)(strands_of_all(task) * inputs), sizeof *out);
    int64_t at = 0;
    for (int g = 0; out && g < task->n_grooms; at += task->styles[g++].groom->strands)
        strand_rows(task->styles[g].groom, 0, task->styles[g].groom->strands, inputs, (float)task->strand_scale,
                    out + at * inputs);
    return out;
}

static hg_status encode(hg_hair_task *task, hg_hair_style *style, int inputs)
{
    const int64_t n = style->groom->strands;
    const int latent = task->latent;
    const int64_t most = n < ROWS ? n : ROWS;
    float *rows = hg_alloc((size_t)(most * inputs), sizeof *rows),
          *code = hg_alloc((size_t)(most * latent), sizeof *code);
    hg_status status = rows && code ? HG_OK : HG_MEMORY;
    for (int64_t first = 0; status == HG_OK && first < n; first += ROWS) {
        const int64_t count = n - first < ROWS ? n - first : ROWS;
        strand_rows(style->groom, first, count, inputs, (float)task->strand_scale, rows);
        hg_step_reset(task->ctx);
        hg_no_grad_begin(task->ctx);
        hg_tensor *x = hg_tensor_from(task->ctx, HG_F32, 2, (int64_t[]){ count, inputs }, rows);
        const hg_tensor *z = hg_encode(task->encoder, task->ctx, x);
        hg_no_grad_end(task->ctx);
        status = z ? hg_tensor_read(z, code) : hg_ctx_status(task->ctx);
        for (int64_t i = 0; status == HG_OK && i < count; i++)
            memcpy(style->strand_raw + (first + i) * task->strand_inputs + 2, code + i * latent,
                   (size_t)latent * sizeof *code);
    }
    hg_step_reset(task->ctx);
    hg_free(rows);
    hg_free(code);
    return status;
}

static hg_status lock_codes(const hg_hair_task *task, hg_hair_style *style)
{
    const hg_groom *groom = style->groom;
    const int latent = task->latent, width = task->strand_inputs;
    double *sum = hg_alloc((size_t)(style->locks * latent), sizeof *sum);
    int64_t *members = hg_alloc((size_t)style->locks, sizeof *members);
    if (!sum || !members) {
        hg_free(sum);
        hg_free(members);
        return HG_MEMORY;
    }
    for (int64_t s = 0; s < groom->strands; s++) {
        const float *code = style->strand_raw + s * width + 2;
        members[style->lock[s]]++;
        for (int k = 0; k < latent; k++) sum[style->lock[s] * latent + k] += (double)code[k];
    }
    for (int64_t s = 0; s < groom->strands; s++) {
        float *row = style->strand_raw + s * width;
        const int32_t lock = style->lock[s];
        row[0] = groom->root_uv[2 * s], row[1] = groom->root_uv[2 * s + 1];
        for (int k = 0; k < latent; k++) row[2 + latent + k] = (float)(sum[lock * latent + k] / (double)members[lock]);
    }
    hg_free(sum);
    hg_free(members);
    return HG_OK;
}

static hg_status encode_style(hg_hair_task *task, hg_hair_style *style)
{
    HG_TRY(encode(task, style, (int)(style->groom->vertices - 1) * 3));
    return lock_codes(task, style);
}

hg_status hg_hair_strands_encode(hg_hair_task *task)
{
    for (int g = 0; g <= task->n_grooms; g++)
        if (task->styles[g].strand_raw) HG_TRY(encode_style(task, &task->styles[g]));
    return HG_OK;
}

/* Locks, and room for the features. */
static hg_status make_style(const hg_hair_task *task, hg_hair_style *style)
{
    const hg_groom *groom = style->groom;
    style->strand_raw = hg_alloc((size_t)(groom->strands * task->strand_inputs), sizeof(float));
    style->lock = hg_alloc((size_t)groom->strands, sizeof *style->lock);
    if (!style->strand_raw || !style->lock) return HG_MEMORY;
    return hg_clusters(groom->strands, groom->root_uv, (int)hg_config_integer(task->config, "features.lock_size"),
                       style->lock, &style->locks);
}

hg_status hg_hair_style_strands(hg_hair_task *task, hg_hair_style *style)
{
    HG_TRY(make_style(task, style));
    return encode_style(task, style);
}

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
    const uint64_t hash = hg_hash(settings, sizeof settings, hg_hair_grooms_hash(task));
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

hg_status hg_hair_strands_create(hg_hair_task *task, const hg_progress *progress)
{
    const hg_groom *groom = task->groom;
    const int inputs = (int)(groom->vertices - 1) * 3;
    task->latent = (int)hg_config_integer(task->config, "features.latent");
    task->strand_inputs = 2 + 2 * task->latent;
    task->strand_scale = strand_scale(task, inputs);
    for (int g = 0; g < task->n_grooms; g++) HG_TRY(make_style(task, &task->styles[g]));
    const hg_model_spec spec = { .inputs = inputs,
                                 .outputs = inputs,
                                 .width = (int)hg_config_integer(task->config, "features.encoder_width"),
                                 .depth = 2,
                                 .latent = task->latent,
                                 .activation = HG_SILU,
                                 .seed = task->seed };
    HG_TRY(hg_model_create(&task->encoder, task->ctx, "strand_autoencoder", &spec));

    char *path = task->folder ? hg_path_join(task->folder, "encoder.h5") : NULL;
    const uint64_t hash = encoder_hash(task);
    bool found = false;
    hg_status status = task->folder && !path ? HG_MEMORY : HG_OK;
    /* A run that is opened brings its encoder with the checkpoint. */
    if (status == HG_OK && !task->opened) status = stored_encoder(task, path, hash, &found);
    if (status == HG_OK && !task->opened && !found) {
        hg_progress_report(progress, 0, "strand encoder");
        if (task->start_from) {
            status = encoder_of_start(task);
        } else {
            float *strands = all_rows(task, inputs);
            status = strands ? train_encoder(task, strands, inputs, progress) : HG_MEMORY;
            hg_free(strands);
        }
        task->encoder_trained = status == HG_OK;
    }
    hg_free(path);
    HG_TRY(status);
    return hg_hair_strands_encode(task);
}

hg_status hg_hair_strand_features(hg_hair_task *task, hg_ctx *ctx, const int32_t *strand, int64_t n, float *out)
{
    (void)ctx;
    for (int64_t i = 0; i < n; i++) {
        const int64_t s = strand ? strand[i] : i;
        if (s < 0 || s >= task->groom->strands)
            return hg_fail(HG_INVALID, "strand %lld is not one of the %lld of the groom", (long long)s,
                           (long long)task->groom->strands);
        float *row = out + i * (task->strand_inputs + task->rest_columns);
        const float *root = task->groom->points + s * task->groom->vertices * 3;
        memcpy(row, task->styles[task->current].strand_raw + s * task->strand_inputs,
               (size_t)task->strand_inputs * sizeof *row);
        for (int k = 0; k < task->rest_columns; k++) row[task->strand_inputs + k] = root[3 + k] - root[k % 3];
    }
    return HG_OK;
}
