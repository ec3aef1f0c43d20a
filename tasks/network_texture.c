/* network_texture: networks of a whole groom (Quaffure). A groom is an image over the scalp, one strand a texel (hg_texture), and
 * the network makes an image of what its strands do, for all of them at once. Strands that share a texel with another are left
 * out of the groom.
 *
 * Beside the frame it is told of the groom: [z_groom], the code of the image of its rest strands, seen from their roots in head
 * rest space, by an autoencoder. That learns from variants of the grooms too (longer, shorter, straighter, bent, mirrored), so
 * that a few grooms, or a single one, make a code in which others have a place. */
#include "tasks/hair.h"

#include "geometry/vector.h"

#include <math.h>
#include <string.h>

enum { STREAM_VARIANT = 7300, VARIANT_NUMBERS = 16, BATCH = 8, JUDGED = 16 /* variants that normalise the code */ };

/* ---- strands with a texel ----------------------------------------------------------------------------------- */

static hg_status choose(const hg_hair_task *task, hg_hair_style *style)
{
    hg_texture *texture;
    hg_groom *kept;
    HG_TRY(hg_texture_create(&texture, style->groom, hg_config_integer(task->config, "model.texture")));
    hg_status status = hg_texture_groom(&kept, texture, style->groom, NULL);
    if (status == HG_OK) {
        hg_groom_destroy(style->groom);
        style->groom = kept;
        style->left_out = texture->left_out;
        style->texel = texture->kept_texel;
        style->number = texture->kept_strand;
        texture->kept_texel = texture->kept_strand = NULL;
    }
    hg_texture_destroy(texture);
    return status;
}

static int64_t side(const hg_hair_task *task) { return hg_config_integer(task->config, "model.texture"); }
static int64_t texels(const hg_hair_task *task) { return side(task) * side(task); }
static int channels(const hg_hair_task *task) { return (int)(task->groom->vertices - 1) * 3; }

/* ---- images of grooms --------------------------------------------------------------------------------------- */

/* How a variant differs from its groom. */
typedef struct {
    double length, along_u, along_v, uneven; /* logarithms of the strands' lengths */
    double straight;                         /* 0: as it is, 1: a line from root to tip */
    hg_vec3d bend;                           /* rotation vector at the tips */
    bool mirrored;
} variant;

static double number_of(uint64_t seed, uint64_t number, uint64_t i)
{
    return hg_random_normal(seed, STREAM_VARIANT, number * VARIANT_NUMBERS + i);
}

static variant draw_variant(uint64_t seed, uint64_t number)
{
    double n[8];
    for (uint64_t i = 0; i < 8; i++) n[i] = fmin(fmax(number_of(seed, number, i), -2), 2);
    return (variant){ .length = 0.3 * n[0],
                      .along_u = 0.4 * n[1],
                      .along_v = 0.4 * n[2],
                      .uneven = 0.05,
                      .straight = fmax(0, 0.4 * n[3]),
                      .bend = hg_vec3d_make(0.25 * n[4], 0.25 * n[5], 0.25 * n[6]),
                      .mirrored = n[7] > 0 };
}

/* Vertices 1.. relative to their root, varied, times the scale; then the mask. image [channels + 1,T,T]. */
static void draw_image(const hg_hair_task *task, const hg_hair_style *style, const variant *varied, uint64_t seed,
                       float *image)
{
    const hg_groom *groom = style->groom;
    const int64_t V = groom->vertices, T = side(task), area = T * T;
    const int C = channels(task);
    memset(image, 0, (size_t)((C + 1) * area) * sizeof *image);
    for (int64_t s = 0; s < groom->strands; s++) {
        const float *x = groom->points + s * V * 3;
        int64_t at = style->texel[s];
        if (varied && varied->mirrored) at = at / T * T + T - 1 - at % T; /* u grows to the left */
        double scale = task->strand_scale;
        if (varied)
            scale *= exp(varied->length + varied->along_u * ((double)groom->root_uv[2 * s] - 0.5) +
                         varied->along_v * ((double)groom->root_uv[2 * s + 1] - 0.5) +
                         varied->uneven * hg_random_normal(seed, STREAM_VARIANT + 1, (uint64_t)s));
        const double tip[3] = { (double)x[3 * V - 3] - (double)x[0], (double)x[3 * V - 2] - (double)x[1],
                                (double)x[3 * V - 1] - (double)x[2] };
        for (int64_t v = 1; v < V; v++) {
            const double along = (double)v / (double)(V - 1);
            double r[3];
            for (int k = 0; k < 3; k++) r[k] = (double)x[3 * v + k] - (double)x[k];
            if (varied) {
                for (int k = 0; k < 3; k++) r[k] += varied->straight * (along * tip[k] - r[k]);
                const hg_quatd turn = hg_quatd_from_rotation_vector(hg_vec3d_scale(varied->bend, along));
                hg_vec3d_store(r, hg_quatd_rotate(turn, hg_vec3d_load(r)));
                if (varied->mirrored) r[0] = -r[0];
            }
            for (int k = 0; k < 3; k++) image[((v - 1) * 3 + k) * area + at] = (float)(scale * r[k]);
        }
        image[C * area + at] = 1;
    }
}

/* ---- autoencoder -------------------------------------------------------------------------------------------- */

/* Every second image of a batch is a groom as it is. */
static hg_status encoder_sample(void *self, hg_ctx *ctx, uint64_t seed, uint64_t step, void *batch)
{
    const hg_hair_task *task = self;
    (void)ctx;
    const int64_t row = (channels(task) + 1) * texels(task);
    for (uint64_t i = 0; i < BATCH; i++) {
        const uint64_t number = step * BATCH + i;
        const uint64_t groom = hg_random_below(seed, STREAM_VARIANT + 2, number, (uint64_t)task->n_grooms);
        const variant varied = draw_variant(seed, number);
        draw_image(task, &task->styles[groom], i % 2 ? &varied : NULL, seed + number,
                   (float *)batch + (int64_t)i * row);
    }
    return HG_OK;
}

/* The mean square over what strands there are. */
static hg_tensor *encoder_loss(void *self, hg_ctx *ctx, hg_model *model, const void *batch, hg_report *report)
{
    const hg_hair_task *task = self;
    const int C = channels(task);
    (void)report;
    double strands = 0;
    for (int g = 0; g < task->n_grooms; g++) strands += (double)task->styles[g].groom->strands / task->n_grooms;
    hg_tensor *x = hg_tensor_from(ctx, HG_F32, 4, (int64_t[]){ BATCH, C + 1, side(task), side(task) }, batch);
    hg_tensor *y = model->forward(model->self, ctx, &x, 1);
    hg_tensor *miss = hg_mul(ctx, hg_sub(ctx, y, hg_slice(ctx, x, 1, 0, C)), hg_slice(ctx, x, 1, C, 1));
    return hg_scale(ctx, hg_mean(ctx, hg_square(ctx, miss)), (double)texels(task) / strands, 0);
}

static hg_status train_encoder(hg_hair_task *task, const hg_progress *progress)
{
    const hg_task learn = { .self = task,
                            .batch_bytes = (size_t)(BATCH * (channels(task) + 1) * texels(task)) * sizeof(float),
                            .sample = encoder_sample,
                            .loss = encoder_loss };
    return hg_hair_encoder_learn(task, &learn, progress);
}

static hg_status make_encoder(hg_hair_task *task)
{
    task->latent = (int)hg_config_integer(task->config, "features.latent");
    task->strand_inputs = task->latent;
    const hg_model_spec spec = { .inputs = channels(task) + 1,
                                 .outputs = channels(task),
                                 .width = (int)hg_config_integer(task->config, "features.encoder_width"),
                                 .depth = (int)hg_config_integer(task->config, "model.depth"),
                                 .latent = task->latent,
                                 .texture = (int)side(task),
                                 .activation = HG_SILU,
                                 .seed = task->seed };
    return hg_model_create(&task->encoder, task->ctx, "groom_autoencoder", &spec);
}

static hg_status code_of(const hg_hair_task *task, const hg_hair_style *style, const variant *varied, uint64_t seed,
                         float *code)
{
    const int64_t C = channels(task) + 1, T = side(task);
    float *image = hg_alloc((size_t)(C * T * T), sizeof *image);
    if (!image) return HG_MEMORY;
    draw_image(task, style, varied, seed, image);
    hg_step_reset(task->ctx);
    hg_no_grad_begin(task->ctx);
    const hg_tensor *z =
        hg_encode(task->encoder, task->ctx, hg_tensor_from(task->ctx, HG_F32, 4, (int64_t[]){ 1, C, T, T }, image));
    hg_no_grad_end(task->ctx);
    const hg_status status = z ? hg_tensor_read(z, code) : hg_ctx_status(task->ctx);
    hg_step_reset(task->ctx);
    hg_free(image);
    return status;
}

static hg_status encode(hg_hair_task *task, hg_hair_style *style) { return code_of(task, style, NULL, 0, style->raw); }

/* ---- features ----------------------------------------------------------------------------------------------- */

/* The mean code of the grooms, and how far they and variants of them are from it: that of a single groom is 0. */
static hg_status name_features(hg_hair_task *task)
{
    const int L = task->latent, rows = task->n_grooms + (task->opened ? 0 : JUDGED);
    float *code = hg_alloc((size_t)(rows * L), sizeof *code);
    hg_status status = code ? HG_OK : HG_MEMORY;
    for (int i = 0; status == HG_OK && i < rows; i++) {
        if (i < task->n_grooms) {
            memcpy(code + i * L, task->styles[i].raw, (size_t)L * sizeof *code);
            continue;
        }
        const variant varied = draw_variant(task->seed, (uint64_t)i);
        status = code_of(task, &task->styles[i % task->n_grooms], &varied, (uint64_t)i, code + i * L);
    }
    double largest = 0;
    double *mean = hg_alloc((size_t)(2 * L), sizeof *mean), *deviation = mean ? mean + L : NULL;
    if (status == HG_OK && !mean) status = HG_MEMORY;
    for (int k = 0; status == HG_OK && k < L; k++) {
        for (int i = 0; i < task->n_grooms; i++) mean[k] += (double)code[i * L + k] / task->n_grooms;
        for (int i = 0; i < rows; i++) deviation[k] += pow((double)code[i * L + k] - mean[k], 2) / rows;
        deviation[k] = sqrt(deviation[k]);
        largest = fmax(largest, deviation[k]);
    }
    for (int k = 0; status == HG_OK && k < L; k++)
        status = hg_hair_add_feature(task, hg_format("z_groom[%d]", k), mean[k],
                                     fmax(deviation[k], fmax(0.1 * largest, 1e-3)));
    hg_free(mean);
    hg_free(code);
    return status;
}

/* ---- strands ------------------------------------------------------------------------------------------------ */

static hg_status check_model(const hg_hair_task *task, const hg_model *model)
{
    (void)task;
    (void)model;
    return HG_OK;
}

static hg_tensor *part_of(const hg_hair_task *task, hg_ctx *ctx, hg_tensor *features)
{
    (void)task;
    (void)ctx;
    return features;
}

/* [R,outputs,T,T]. A row's code is picked by a product with ones and zeros: an index would be read back from a device. */
static hg_tensor *images(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, const int32_t *groom,
                         hg_tensor *inputs)
{
    const int64_t R = inputs->shape[0];
    const int64_t G = part->grooms;
    float *one = hg_step_alloc(ctx, (size_t)(R * G) * sizeof *one);
    if (!one) return NULL;
    for (int64_t r = 0; r < R; r++)
        for (int64_t g = 0; g < G; g++) one[r * G + g] = g == (groom ? groom[r] : 0) ? 1 : 0;
    hg_tensor *code = hg_matmul(ctx, hg_tensor_from(ctx, HG_F32, 2, (int64_t[]){ R, G }, one), part->rows);
    hg_tensor *in = hg_concat(ctx, 1, 2, (hg_tensor *[]){ code, inputs });
    return task->model->forward(task->model->self, ctx, &in, 1);
}

/* A texel of all rows is one row to gather: the index is the groom's, the same in every step. */
static hg_tensor *outputs(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, hg_tensor *whole,
                          int64_t first, int64_t rows, int32_t groom)
{
    if (!whole) return NULL;
    const int64_t S = part->strands, C = task->outputs;
    if (rows < whole->shape[0]) whole = hg_slice(ctx, whole, 0, first, rows);
    hg_tensor *of_texel = hg_permute(ctx, whole, (int[]){ 2, 3, 0, 1 });
    hg_tensor *out = hg_gather(ctx, hg_reshape(ctx, of_texel, 2, (int64_t[]){ -1, rows * C }),
                               hg_tensor_rows(ctx, part->texel, groom * S, S));
    return hg_permute(ctx, hg_reshape(ctx, out, 3, (int64_t[]){ S, rows, C }), (int[]){ 1, 0, 2 });
}

/* ---- formulas ----------------------------------------------------------------------------------------------- */

static hg_tensor *image_of(const hg_hair_task *task, hg_ctx *ctx, hg_tensor *raw)
{
    hg_tensor *in = hg_hair_normalised(task, ctx, raw, 0, task->inputs);
    return in ? task->model->forward(task->model->self, ctx, &in, 1) : NULL;
}

/* [frames,columns] -> [frames,numbers of a strand,T,T] */
static hg_tensor *image_formula(void *self, hg_ctx *ctx, hg_tensor **in)
{
    const hg_hair_task *task = self;
    hg_tensor *y = hg_permute(ctx, image_of(task, ctx, in[0]), (int[]){ 0, 2, 3, 1 });
    y = hg_hair_as_rows(task, ctx, hg_reshape(ctx, y, 3, (int64_t[]){ -1, texels(task), task->outputs }), NULL);
    const int64_t numbers = y ? y->shape[2] : 0;
    return hg_reshape(ctx, hg_permute(ctx, y, (int[]){ 0, 2, 1 }), 4,
                      (int64_t[]){ -1, numbers, side(task), side(task) });
}

/* [frames,columns] -> [frames,strands of the groom,numbers of a strand] */
static hg_tensor *strands_formula(void *self, hg_ctx *ctx, hg_tensor **in)
{
    const hg_hair_task *task = self;
    const hg_hair_style *style = &task->styles[task->current];
    const int64_t S = style->groom->strands, V = style->groom->vertices;
    hg_tensor *texel = hg_tensor_from(ctx, HG_I32, 1, &S, style->texel);
    hg_tensor *rest =
        task->directions ? hg_tensor_from(ctx, HG_F32, 3, (int64_t[]){ S, V, 3 }, style->groom->points) : NULL;
    if (!texel || (task->directions && !rest)) return NULL;
    texel->name = "texel";
    if (rest) rest->name = "rest";
    hg_tensor *y = hg_permute(ctx, image_of(task, ctx, in[0]), (int[]){ 2, 3, 0, 1 });
    y = hg_gather(ctx, hg_reshape(ctx, y, 2, (int64_t[]){ texels(task), -1 }), texel);
    y = hg_permute(ctx, hg_reshape(ctx, y, 3, (int64_t[]){ S, -1, task->outputs }), (int[]){ 1, 0, 2 });
    return hg_hair_as_rows(task, ctx, y, rest);
}

/* Turned edges begin at those of the rest strands: then there is no image without them. */
static int formulas(const hg_hair_task *task, hg_hair_formula formulas[HG_HAIR_FORMULAS])
{
    static const char takes[] =
        "raw features, one row per frame, columns as listed in 'features', the groom's code first; "
        "normalisation ((x - mean) / deviation) is part of the graph";
    const hg_hair_formula all[2] = {
        { .form = "image",
          .what =
              "Displacements of hair from the rigidly posed groom, an image over the scalp with a strand in a texel; "
              "trained without simulated data by hairgrad.",
          .takes = takes,
          .output = "displacement",
          .gives = hg_hair_displacements_are(task),
          .n_inputs = 1,
          .input = { { "features", task->inputs, "frames" } },
          .n_rows = 1,
          .rows = { "frames" },
          .forward = image_formula },
        { .form = "strands",
          .what = "Displacements of the strands of a groom from the rigidly posed one, of one or more frames; trained "
                  "without simulated data by hairgrad.",
          .takes = takes,
          .output = "displacement",
          .gives = hg_hair_displacements_are(task),
          .n_inputs = 1,
          .input = { { "features", task->inputs, "frames" } },
          .n_rows = 1,
          .rows = { "frames" },
          .forward = strands_formula },
    };
    const int first = task->directions ? 1 : 0;
    for (int i = first; i < 2; i++) formulas[i - first] = all[i];
    return 2 - first;
}

const hg_hair_network hg_hair_network_texture = {
    .of_grooms = true,
    .encoder_label = "groom encoder",
    .choose = choose,
    .make_encoder = make_encoder,
    .train_encoder = train_encoder,
    .encode = encode,
    .name_features = name_features,
    .check_model = check_model,
    .part = part_of,
    .images = images,
    .outputs = outputs,
    .formulas = formulas,
};
