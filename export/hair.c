/* Export of a hair network: as ONNX, raw features in and displacements out, with all that a runtime needs to feed it in
 * the metadata; and as HDF5, weights by layer beside the same feature table. */
#include "export/export.h"

#include <stdio.h>
#include <string.h>

#define MOST_METADATA 20
#define SAMPLE_ROWS   16

/* What stands beside the weights, as text. */
typedef struct {
    int n;
    const char *key[MOST_METADATA];
    char *value[MOST_METADATA];
    bool failed;
} description;

static void describe(description *d, const char *key, char *value)
{
    if (!value || d->n == MOST_METADATA) {
        hg_free(value);
        d->failed = true;
        return;
    }
    d->key[d->n] = key;
    d->value[d->n++] = value;
}

static void description_free(description *d)
{
    for (int i = 0; i < d->n; i++) hg_free(d->value[i]);
}

/* The input columns as JSON: [{"name": "root_uv", "first": 0, "count": 2, "mean": 0.5, "deviation": 0.3}, ...] */
static char *features_json(const hg_hair_task *task)
{
    const hg_feature *features;
    int n = hg_hair_features(task, &features);
    hg_text json = { 0 };
    for (int i = 0; i < n; i++)
        hg_text_add(&json, "%s{\"name\": \"%s\", \"first\": %d, \"count\": %d, \"mean\": %.9g, \"deviation\": %.9g}",
                    i ? ", " : "[", features[i].name, features[i].first, features[i].count, features[i].mean,
                    features[i].deviation);
    hg_text_add(&json, n ? "]" : "[]");
    char *text = json.failed ? NULL : hg_strdup(json.data);
    hg_text_free(&json);
    return text;
}

static hg_status describe_hair(const hg_hair_task *task, description *d)
{
    const hg_groom *groom = hg_hair_groom(task);
    const hg_body *body = hg_hair_body(task);
    *d = (description){ 0 };
    describe(d, "units",
             hg_strdup("metres, seconds, radians; +Y up, the face looks along +Z, +X is the character's left"));
    describe(d, "input",
             hg_strdup("raw features, one row per strand, columns as listed in 'features'; normalisation "
                       "((x - mean) / deviation) is part of the graph"));
    describe(d, "output",
             hg_strdup("displacements [m] of vertices 1..V-1 in head rest space, xyz by vertex; "
                       "x = p + R (rest + d - rest_root), p and R the strand's root frame"));
    if (hg_hair_turns(task)) {
        describe(d, "outputs",
                 hg_format("[{\"name\": \"displacement\", \"first\": 0, \"count\": %lld}, "
                           "{\"name\": \"turn\", \"first\": %lld, \"count\": %d}]",
                           (long long)(groom->vertices - 1) * 3, (long long)(groom->vertices - 1) * 3,
                           hg_hair_turns(task)));
        describe(
            d, "turn",
            hg_strdup(
                "o, w x y z by edge, in head rest space: the orientation of the edge is R o q0, q0 the frame of the "
                "rest edge: +z turned to the first edge the short way, and on from edge to edge"));
    }
    describe(d, "features", features_json(task));
    describe(d, "vertices", hg_format("%lld", (long long)groom->vertices));
    describe(d, "strands", hg_format("%lld", (long long)groom->strands));
    describe(d, "groom", hg_strdup(groom->name ? groom->name : ""));
    describe(d, "groom_hash", hg_format("%016llx", (unsigned long long)hg_groom_hash(groom)));
    describe(d, "body_hash", hg_format("%016llx", (unsigned long long)hg_body_hash(body)));
    describe(d, "dt", hg_format("%.9g", 1.0 / hg_hair_rate(task)));
    describe(d, "hairgrad_version", hg_strdup(HG_VERSION));
    if (!d->failed) return HG_OK;
    description_free(d);
    return hg_fail(HG_MEMORY, "export: out of memory");
}

static int columns_of(const hg_hair_task *task)
{
    const hg_feature *features;
    int n = hg_hair_features(task, &features), columns = 0;
    for (int i = 0; i < n; i++)
        if (features[i].first + features[i].count > columns) columns = features[i].first + features[i].count;
    return columns;
}

/* ---- ONNX ---------------------------------------------------------------------------------------------------- */

static hg_tensor *forward(void *self, hg_ctx *ctx, hg_tensor *raw)
{
    return hg_hair_forward_concatenated(self, ctx, raw);
}

hg_status hg_export_hair_onnx(hg_hair_task *task, hg_ctx *ctx, const char *path)
{
    description about;
    HG_TRY(describe_hair(task, &about));
    hg_onnx_metadata metadata[MOST_METADATA];
    for (int i = 0; i < about.n; i++) metadata[i] = (hg_onnx_metadata){ about.key[i], about.value[i] };
    const hg_onnx_options options = {
        .input = "features",
        .output = "displacement",
        .graph = hg_hair_model(task)->kind,
        .doc =
            "Displacements of hair strands from the rigidly posed groom, trained without simulated data by hairgrad.",
        .columns = columns_of(task),
        .n_metadata = about.n,
        .metadata = metadata,
    };
    hg_status status = hg_onnx_export(ctx, path, forward, task, &options);
    description_free(&about);
    return status;
}

/* ---- ONNX in two parts --------------------------------------------------------------------------------------- */

static hg_tensor *strand_part(void *self, hg_ctx *ctx, hg_tensor **in)
{
    return hg_hair_forward_strands(self, ctx, in[0]);
}

static hg_tensor *frame_part(void *self, hg_ctx *ctx, hg_tensor **in)
{
    return hg_hair_forward_frames(self, ctx, in[0], in[1], in[2]);
}

/* Columns of the rest strand, which only turned edges need. */
static int rest_columns(const hg_hair_task *task)
{
    const hg_feature *features;
    const int n = hg_hair_features(task, &features);
    for (int i = 0; i < n; i++)
        if (!strcmp(features[i].name, "rest")) return features[i].count;
    return 0;
}

static hg_status export_parts(hg_hair_task *task, hg_ctx *ctx, const char *strand_path, const char *frame_path,
                              const description *about)
{
    hg_onnx_metadata metadata[MOST_METADATA];
    for (int i = 0; i < about->n; i++) metadata[i] = (hg_onnx_metadata){ about->key[i], about->value[i] };
    const int rest = rest_columns(task), strand = hg_hair_strand_inputs(task) - rest;
    const int frame = columns_of(task) - strand - rest;
    const hg_onnx_input of_strands[] = { { "strand_features", strand, "strands" } };
    const hg_onnx_options first = { .output = "part",
                                    .graph = "strands",
                                    .doc = "What the first layer makes of the strands, once per groom; goes into the "
                                           "network of frames.",
                                    .n_inputs = 1,
                                    .inputs = of_strands,
                                    .n_metadata = about->n,
                                    .metadata = metadata };
    hg_step_reset(ctx);
    HG_TRY(hg_onnx_export_several(ctx, strand_path, strand_part, task, &first));
    hg_step_reset(ctx);
    hg_no_grad_begin(ctx);
    const hg_tensor *part =
        hg_hair_forward_strands(task, ctx, hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 1, strand }));
    hg_no_grad_end(ctx);
    HG_TRY(hg_ctx_status(ctx));
    const hg_onnx_input of_frames[] = { { "part", part->shape[1], "strands" },
                                        { "frame_features", frame, "frames" },
                                        { "rest", rest, "strands" } };
    const hg_onnx_options second = { .output = "displacement",
                                     .graph = "frames",
                                     .doc =
                                         "Displacements of hair strands from the rigidly posed groom, of one or more "
                                         "frames; trained without simulated data by hairgrad.",
                                     .n_inputs = rest ? 3 : 2,
                                     .inputs = of_frames,
                                     .n_output_rows = 2,
                                     .output_rows = (const char *const[]){ "frames", "strands" },
                                     .n_metadata = about->n,
                                     .metadata = metadata };
    hg_step_reset(ctx);
    HG_TRY(hg_onnx_export_several(ctx, frame_path, frame_part, task, &second));
    hg_step_reset(ctx);
    return HG_OK;
}

hg_status hg_export_hair_onnx_factored(hg_hair_task *task, hg_ctx *ctx, const char *path, char **strand_path,
                                       char **frame_path)
{
    const char *extension = hg_path_extension(path);
    const size_t stem = strlen(path) - (extension[0] ? strlen(extension) + 1 : 0);
    *strand_path = hg_format("%.*s.strand.onnx", (int)stem, path);
    *frame_path = hg_format("%.*s.frame.onnx", (int)stem, path);
    description about = { 0 };
    hg_status status = *strand_path && *frame_path ? describe_hair(task, &about) : HG_MEMORY;
    if (status == HG_OK) {
        status = export_parts(task, ctx, *strand_path, *frame_path, &about);
        description_free(&about);
    }
    if (status == HG_OK) return HG_OK;
    hg_free(*strand_path);
    hg_free(*frame_path);
    *strand_path = *frame_path = NULL;
    return status;
}

/* ---- HDF5 ---------------------------------------------------------------------------------------------------- */

/* "first.weight" becomes /model/first/weight. */
static hg_status write_parameter(hg_h5 *file, const hg_tensor *parameter, int number)
{
    char *name = parameter->name ? hg_format("model/%s", parameter->name) : hg_format("model/parameter_%d", number);
    size_t bytes = hg_tensor_bytes(parameter);
    void *data = hg_alloc(bytes > 0 ? bytes : 1, 1);
    hg_status status = name && data ? hg_tensor_read(parameter, data) : HG_MEMORY;
    if (status == HG_OK) {
        for (char *c = name; *c; c++)
            if (*c == '.') *c = '/';
        status = hg_h5_write(file, name, parameter->dtype, parameter->rank, parameter->shape, data);
    }
    hg_free(name);
    hg_free(data);
    return status;
}

static hg_status write_features(hg_h5 *file, const hg_hair_task *task)
{
    const hg_feature *features;
    int n = hg_hair_features(task, &features);
    if (n < 1) return HG_OK;
    size_t size = (size_t)n;
    const char **names = hg_alloc(size, sizeof *names);
    int64_t *first = hg_alloc(size, sizeof *first), *count = hg_alloc(size, sizeof *count), rows = n;
    double *mean = hg_alloc(size, sizeof *mean), *deviation = hg_alloc(size, sizeof *deviation);
    hg_status status = names && first && count && mean && deviation ? HG_OK : HG_MEMORY;
    for (int i = 0; status == HG_OK && i < n; i++) {
        names[i] = features[i].name;
        first[i] = features[i].first;
        count[i] = features[i].count;
        mean[i] = features[i].mean;
        deviation[i] = features[i].deviation;
    }
    if (status == HG_OK) status = hg_h5_write_texts(file, "features/name", n, names);
    if (status == HG_OK) status = hg_h5_write_i64(file, "features/first", 1, &rows, first);
    if (status == HG_OK) status = hg_h5_write_i64(file, "features/count", 1, &rows, count);
    if (status == HG_OK) status = hg_h5_write(file, "features/mean", HG_F64, 1, &rows, mean);
    if (status == HG_OK) status = hg_h5_write(file, "features/deviation", HG_F64, 1, &rows, deviation);
    hg_free(names);
    hg_free(first);
    hg_free(count);
    hg_free(mean);
    hg_free(deviation);
    return status;
}

/* Real inputs of a few strands spread over the groom, in the middle of a clip, and what the network answers. */
static hg_status write_sample(hg_h5 *file, hg_hair_task *task, hg_ctx *ctx)
{
    bool held_out = hg_hair_clips(task, true) > 0;
    if (!held_out && hg_hair_clips(task, false) < 1) return HG_OK;
    const hg_motion *clip = hg_hair_clip(task, held_out, 0);
    int64_t strands = hg_hair_groom(task)->strands, rows = strands < SAMPLE_ROWS ? strands : SAMPLE_ROWS;
    int64_t columns = columns_of(task), own = hg_hair_strand_inputs(task);
    float *raw = hg_alloc((size_t)(rows * columns), sizeof *raw), *answer = NULL;
    hg_status status = raw ? HG_OK : HG_MEMORY;
    for (int64_t i = 0; status == HG_OK && i < rows; i++) {
        int32_t strand = (int32_t)(i * strands / rows);
        status = hg_hair_strand_features(task, ctx, &strand, 1, raw + i * columns);
        if (status == HG_OK)
            status = hg_hair_frame_features(task, ctx, clip, clip->frames / 2, NULL, raw + i * columns + own);
    }
    hg_no_grad_begin(ctx);
    hg_tensor *in = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ rows, columns });
    if (status == HG_OK) status = in ? hg_tensor_write(in, raw) : hg_ctx_status(ctx);
    hg_tensor *out = status == HG_OK ? hg_hair_forward_concatenated(task, ctx, in) : NULL;
    if (status == HG_OK && !out) status = hg_ctx_status(ctx);
    if (status == HG_OK) {
        answer = hg_alloc(1, hg_tensor_bytes(out) + 1);
        status = answer ? hg_tensor_read(out, answer) : HG_MEMORY;
    }
    hg_no_grad_end(ctx);
    if (status == HG_OK) status = hg_h5_write(file, "sample/features", HG_F32, 2, (int64_t[]){ rows, columns }, raw);
    if (status == HG_OK) status = hg_h5_write(file, "sample/displacement", HG_F32, out->rank, out->shape, answer);
    hg_free(raw);
    hg_free(answer);
    return status;
}

static hg_status write_weights(hg_h5 *file, hg_hair_task *task, hg_ctx *ctx, const description *about)
{
    const hg_model *model = hg_hair_model(task);
    HG_TRY(hg_h5_group(file, "model"));
    HG_TRY(hg_h5_set_text(file, "model", "kind", model->kind));
    for (int i = 0; i < about->n; i++) /* the features have a table of their own; an attribute ends at 64 KiB */
        if (strcmp(about->key[i], "features") != 0) HG_TRY(hg_h5_set_text(file, "", about->key[i], about->value[i]));
    for (int i = 0; i < model->n_params; i++) HG_TRY(write_parameter(file, model->params[i], i));
    HG_TRY(write_sample(file, task, ctx));
    return write_features(file, task);
}

hg_status hg_export_hair_h5(hg_hair_task *task, hg_ctx *ctx, const char *path)
{
    description about;
    HG_TRY(describe_hair(task, &about));
    hg_h5 *file = NULL;
    hg_status status = hg_h5_create(&file, path);
    if (status == HG_OK) {
        status = write_weights(file, task, ctx, &about);
        if (status == HG_OK)
            status = hg_h5_commit(file);
        else
            hg_h5_close(file);
    }
    description_free(&about);
    return status;
}
