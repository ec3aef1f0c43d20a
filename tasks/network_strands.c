/* network_strands: networks of single strands (Neuralocks). Each strand is a row, told of as
 * [root UV 2 | z_rest | z_lock], and what the first layer makes of that stays the same over frames.
 *
 * z_rest is the code of the rest strand, seen from its root in head rest space, by an autoencoder of all strands of the grooms.
 * z_lock is the mean code of the strand's lock; locks belong to the FULL groom, so that a strand has the same features whichever
 * strands are drawn with it. `features.locks: false` leaves it out. */
#include "tasks/hair.h"

#include <math.h>
#include <string.h>

enum { ROWS = 4096 }; /* strands encoded, or predicted, at a time */

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

/* Vertices 1.. relative to the root, times the scale. */
static void strand_rows(const hg_groom *groom, int64_t first, int64_t count, int inputs, float scale, float *out)
{
    for (int64_t s = 0; s < count; s++) {
        const float *root = groom->points + (first + s) * groom->vertices * 3;
        for (int i = 0; i < inputs; i++) out[s * inputs + i] = (root[3 + i] - root[i % 3]) * scale;
    }
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

static hg_status train_encoder(hg_hair_task *task, const hg_progress *progress)
{
    encoder_task data = { .n = strands_of_all(task), .inputs = (int)(task->groom->vertices - 1) * 3 };
    data.batch = data.n < 512 ? data.n : 512;
    data.strands = all_rows(task, data.inputs);
    if (!data.strands) return HG_MEMORY;
    const hg_task learn = { .self = &data,
                            .batch_bytes = (size_t)(data.batch * data.inputs) * sizeof(float),
                            .sample = encoder_sample,
                            .loss = encoder_loss };
    const hg_status status = hg_hair_encoder_learn(task, &learn, progress);
    hg_free(data.strands);
    return status;
}

/* Of the strand, and of its lock. */
static int codes(const hg_hair_task *task) { return hg_config_flag(task->config, "features.locks") ? 2 : 1; }

static hg_status make_encoder(hg_hair_task *task)
{
    const int inputs = (int)(task->groom->vertices - 1) * 3;
    task->latent = (int)hg_config_integer(task->config, "features.latent");
    task->strand_inputs = 2 + codes(task) * task->latent;
    const hg_model_spec spec = { .inputs = inputs,
                                 .outputs = inputs,
                                 .width = (int)hg_config_integer(task->config, "features.encoder_width"),
                                 .depth = 2,
                                 .latent = task->latent,
                                 .activation = HG_SILU,
                                 .seed = task->seed };
    return hg_model_create(&task->encoder, task->ctx, "strand_autoencoder", &spec);
}

/* ---- codes -------------------------------------------------------------------------------------------------- */

static hg_status strand_codes(hg_hair_task *task, hg_hair_style *style)
{
    const int inputs = (int)(style->groom->vertices - 1) * 3;
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
            memcpy(style->raw + (first + i) * task->strand_inputs + 2, code + i * latent,
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
        const float *code = style->raw + s * width + 2;
        members[style->lock[s]]++;
        for (int k = 0; k < latent; k++) sum[style->lock[s] * latent + k] += (double)code[k];
    }
    for (int64_t s = 0; s < groom->strands; s++) {
        float *row = style->raw + s * width;
        const int32_t lock = style->lock[s];
        for (int k = 0; k < latent; k++) row[2 + latent + k] = (float)(sum[lock * latent + k] / (double)members[lock]);
    }
    hg_free(sum);
    hg_free(members);
    return HG_OK;
}

static hg_status encode(hg_hair_task *task, hg_hair_style *style)
{
    HG_TRY(strand_codes(task, style));
    for (int64_t s = 0; s < style->groom->strands; s++)
        memcpy(style->raw + s * task->strand_inputs, style->groom->root_uv + 2 * s, 2 * sizeof *style->raw);
    return codes(task) == 2 ? lock_codes(task, style) : HG_OK;
}

/* ---- features ----------------------------------------------------------------------------------------------- */

static const double least_latent = 1e-3;

/* Mean and deviation of one strand feature over the strands of all grooms. */
static void strand_moments(const hg_hair_task *task, int column, double least, double *mean, double *deviation)
{
    double sum = 0, squares = 0, n = 0;
    for (int pass = 0; pass < 2; pass++) {
        for (int g = 0; g < task->n_grooms; g++) {
            const hg_hair_style *style = &task->styles[g];
            for (int64_t i = 0; i < style->groom->strands; i++) {
                const double value = (double)style->raw[i * task->strand_inputs + column];
                if (pass)
                    squares += (value - *mean) * (value - *mean);
                else
                    sum += value, n++;
            }
        }
        if (!pass) *mean = sum / n;
    }
    *deviation = fmax(sqrt(squares / n), least);
}

static hg_status name_features(hg_hair_task *task)
{
    const char axis_uv[2] = { 'u', 'v' };
    for (int k = 0; k < 2; k++) HG_TRY(hg_hair_add_feature(task, hg_format("root_uv.%c", axis_uv[k]), 0.5, 0.29));
    for (int part = 0; part < codes(task); part++) {
        double largest = 0, mean, deviation;
        for (int k = 0; k < task->latent; k++) {
            strand_moments(task, 2 + part * task->latent + k, 0, &mean, &deviation);
            largest = fmax(largest, deviation);
        }
        for (int k = 0; k < task->latent; k++) {
            strand_moments(task, 2 + part * task->latent + k, fmax(0.1 * largest, least_latent), &mean, &deviation);
            HG_TRY(hg_hair_add_feature(task, hg_format("%s[%d]", part ? "z_lock" : "z_rest", k), mean, deviation));
        }
    }
    return HG_OK;
}

/* ---- strands ------------------------------------------------------------------------------------------------ */

static hg_status check_model(const hg_hair_task *task, const hg_model *model)
{
    if (model->strand_part) return HG_OK;
    return hg_fail(
        HG_INVALID,
        "%s:%d: model.kind: a %s is neither a network per strand, such as neuralocks, nor one that makes images "
        "of a groom, such as quaffure",
        hg_config_name(task->config), hg_config_line(task->config, "model.kind"), model->kind);
}

static hg_tensor *part_of(const hg_hair_task *task, hg_ctx *ctx, hg_tensor *features)
{
    return task->model->strand_part(task->model->self, ctx, features);
}

static hg_tensor *outputs(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, hg_tensor *inputs,
                          int64_t first, int64_t rows, int32_t groom)
{
    const int64_t S = part->strands;
    hg_tensor *in[3] = { NULL, hg_tensor_rows(ctx, inputs, first, rows),
                         part->grooms == 1 ? part->rows : hg_slice(ctx, part->rows, 0, groom * S, S) };
    return task->model->forward(task->model->self, ctx, in, 3);
}

/* ---- formulas ----------------------------------------------------------------------------------------------- */

hg_tensor *hg_hair_forward_concatenated(hg_hair_task *task, hg_ctx *ctx, hg_tensor *raw)
{
    const int64_t edges = task->groom->vertices - 1, strand = task->strand_inputs, frame = task->layout.frame_inputs;
    hg_tensor *in = raw, *rest = NULL;
    if (task->directions) { /* [strand | rest | frame] */
        in = hg_concat(ctx, 1, 2,
                       (hg_tensor *[]){ hg_slice(ctx, raw, 1, 0, strand),
                                        hg_slice(ctx, raw, 1, strand + task->rest_columns, frame) });
        rest = hg_reshape(ctx, hg_slice(ctx, raw, 1, strand, task->rest_columns), 3, (int64_t[]){ -1, edges, 3 });
        rest = hg_pad(ctx, rest, 1, 1, 0); /* the root */
    }
    in = hg_mul(ctx, hg_sub(ctx, in, task->mean_tensor), task->inverse_deviation);
    return hg_hair_as_rows(task, ctx, task->model->forward(task->model->self, ctx, &in, 1), rest);
}

hg_tensor *hg_hair_forward_strands(hg_hair_task *task, hg_ctx *ctx, hg_tensor *raw)
{
    return task->model->strand_part(task->model->self, ctx, hg_hair_normalised(task, ctx, raw, 0, task->strand_inputs));
}

hg_tensor *hg_hair_forward_frames(hg_hair_task *task, hg_ctx *ctx, hg_tensor *part, hg_tensor *raw, hg_tensor *rest)
{
    const int64_t edges = task->groom->vertices - 1;
    hg_tensor *in[3] = { NULL, hg_hair_normalised(task, ctx, raw, task->strand_inputs, task->layout.frame_inputs),
                         part };
    if (task->directions) rest = hg_pad(ctx, hg_reshape(ctx, rest, 3, (int64_t[]){ -1, edges, 3 }), 1, 1, 0);
    return hg_hair_as_rows(task, ctx, task->model->forward(task->model->self, ctx, in, 3), rest);
}

static hg_tensor *concatenated(void *task, hg_ctx *ctx, hg_tensor **in)
{
    return hg_hair_forward_concatenated(task, ctx, in[0]);
}
static hg_tensor *strand_formula(void *task, hg_ctx *ctx, hg_tensor **in)
{
    return hg_hair_forward_strands(task, ctx, in[0]);
}
static hg_tensor *frame_formula(void *task, hg_ctx *ctx, hg_tensor **in)
{
    return hg_hair_forward_frames(task, ctx, in[0], in[1], in[2]);
}

static int formulas(const hg_hair_task *task, hg_hair_formula formulas[HG_HAIR_FORMULAS])
{
    const int strand = task->strand_inputs, frame = task->layout.frame_inputs, rest = task->rest_columns;
    static const char takes[] = "raw features, one row per strand, columns as listed in 'features'; normalisation "
                                "((x - mean) / deviation) is part of the graph";
    formulas[0] = (hg_hair_formula){
        .form = "concatenated",
        .what =
            "Displacements of hair strands from the rigidly posed groom, trained without simulated data by hairgrad.",
        .takes = takes,
        .output = "displacement",
        .gives = hg_hair_displacements_are(task),
        .n_inputs = 1,
        .input = { { "features", strand + rest + frame, "strands" } },
        .n_rows = 1,
        .rows = { "strands" },
        .forward = concatenated
    };
    formulas[1] = (hg_hair_formula){
        .form = "factored",
        .part = "strand",
        .what = "What the first layer makes of the strands, once per groom; goes into the network of frames.",
        .takes = takes,
        .output = "part",
        .gives = "numbers for the network of frames",
        .n_inputs = 1,
        .input = { { "strand_features", strand, "strands" } },
        .n_rows = 1,
        .rows = { "strands" },
        .forward = strand_formula
    };
    formulas[2] = (hg_hair_formula){
        .form = "factored",
        .part = "frame",
        .what = "Displacements of hair strands from the rigidly posed groom, of one or more frames; trained without "
                "simulated data by hairgrad.",
        .takes = takes,
        .output = "displacement",
        .gives = hg_hair_displacements_are(task),
        .n_inputs = rest ? 3 : 2,
        .input = { { "part", -1, "strands" }, { "frame_features", frame, "frames" }, { "rest", rest, "strands" } },
        .n_rows = 2,
        .rows = { "frames", "strands" },
        .forward = frame_formula
    };
    return 3;
}

const hg_hair_network hg_hair_network_strands = {
    .together = ROWS,
    .encoder_label = "strand encoder",
    .make_encoder = make_encoder,
    .train_encoder = train_encoder,
    .encode = encode,
    .name_features = name_features,
    .check_model = check_model,
    .part = part_of,
    .outputs = outputs,
    .formulas = formulas,
};
