/* Export of a hair network: as ONNX, raw features in and displacements out, with all that a runtime needs to feed it in
 * the metadata; and as HDF5, weights by layer beside the same feature table. Which formulas there are is the network's affair
 * (hg_hair_formulas). */
#include "export/export.h"

#include <stdio.h>
#include <string.h>

#define MOST_METADATA 24
enum { SAMPLE_STRANDS = 16, SAMPLE_FRAMES = 4 };

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

/* [3,1,4] */
static char *numbers_json(int64_t n, const int32_t *numbers)
{
    hg_text json = { 0 };
    for (int64_t i = 0; i < n; i++) hg_text_add(&json, "%s%d", i ? "," : "[", (int)numbers[i]);
    hg_text_add(&json, n ? "]" : "[]");
    char *text = json.failed ? NULL : hg_strdup(json.data);
    hg_text_free(&json);
    return text;
}

/* Where the strands are in the images, of a network that makes images. */
static void describe_texture(const hg_hair_task *task, description *d)
{
    const int32_t *texel, *strand;
    const int side = hg_hair_texture(task, &texel, &strand);
    if (!side) return;
    const int64_t strands = hg_hair_groom(task)->strands;
    describe(d, "texture", hg_format("%d", side));
    describe(d, "texel", numbers_json(strands, texel));
    describe(d, "strand", numbers_json(strands, strand));
    describe(d, "strands_left_out", hg_format("%lld", (long long)hg_hair_left_out(task, -1)));
    describe(
        d, "texels_are",
        hg_strdup("by strand of the groom: 'texel' is row * texture + column of its texel, row along root v and column "
                  "along root u; 'strand' is its number in the groom before strands that share a texel with another "
                  "were left out; other texels hold no strand"));
}

static hg_status describe_hair(const hg_hair_task *task, const hg_hair_formula *formula, description *d)
{
    const hg_groom *groom = hg_hair_groom(task);
    const hg_body *body = hg_hair_body(task);
    *d = (description){ 0 };
    describe(d, "units",
             hg_strdup("metres, seconds, radians; +Y up, the face looks along +Z, +X is the character's left"));
    describe(d, "form", hg_strdup(formula->form));
    describe(d, "input", hg_strdup(formula->takes));
    describe(d, "output", hg_strdup(formula->gives));
    if (hg_hair_turns(task)) {
        describe(d, "outputs",
                 hg_format("[{\"name\": \"displacement\", \"first\": 0, \"count\": %lld}, "
                           "{\"name\": \"turn\", \"first\": %lld, \"count\": %d}]",
                           (long long)(groom->vertices - 1) * 3, (long long)(groom->vertices - 1) * 3,
                           hg_hair_turns(task)));
        describe(
            d, "turn",
            hg_format(
                "o, w x y z by edge, in head rest space: the orientation of the edge is %sR o q0, q0 the frame of "
                "the rest edge: +z turned to the first edge the short way, and on from edge to edge%s",
                hg_hair_turns_edges(task) ? "T " : "",
                hg_hair_turns_edges(task) ? "; T turns the posed edge's direction to the edge's the short way" : ""));
    }
    describe(d, "features", features_json(task));
    describe(d, "vertices", hg_format("%lld", (long long)groom->vertices));
    describe(d, "strands", hg_format("%lld", (long long)groom->strands));
    describe_texture(task, d);
    describe(d, "groom", hg_strdup(groom->name ? groom->name : ""));
    describe(d, "groom_hash", hg_format("%016llx", (unsigned long long)hg_groom_hash(groom)));
    describe(d, "body_hash", hg_format("%016llx", (unsigned long long)hg_body_hash(body)));
    describe(d, "dt", hg_format("%.9g", 1.0 / hg_hair_rate(task)));
    describe(d, "hairgrad_version", hg_strdup(HG_VERSION));
    if (!d->failed) return HG_OK;
    description_free(d);
    return hg_fail(HG_MEMORY, "export: out of memory");
}

/* ---- ONNX ---------------------------------------------------------------------------------------------------- */

/* before: columns of the output of the formula before it, and then of this one. */
static hg_status export_one(hg_hair_task *task, hg_ctx *ctx, const hg_hair_formula *formula, const char *path,
                            int64_t *before)
{
    description about;
    HG_TRY(describe_hair(task, formula, &about));
    hg_onnx_metadata metadata[MOST_METADATA];
    for (int i = 0; i < about.n; i++) metadata[i] = (hg_onnx_metadata){ about.key[i], about.value[i] };
    hg_onnx_input inputs[HG_ONNX_INPUTS];
    for (int i = 0; i < formula->n_inputs; i++) {
        const hg_hair_formula_input *in = &formula->input[i];
        inputs[i] = (hg_onnx_input){ in->name, in->columns < 0 ? *before : in->columns, in->rows };
    }
    const hg_onnx_options options = { .output = formula->output,
                                      .graph = formula->part ? formula->part : hg_hair_model(task)->kind,
                                      .doc = formula->what,
                                      .n_inputs = formula->n_inputs,
                                      .inputs = inputs,
                                      .n_output_rows = formula->n_rows,
                                      .output_rows = formula->rows,
                                      .n_metadata = about.n,
                                      .metadata = metadata };
    hg_step_reset(ctx);
    hg_status status = hg_onnx_export_several(ctx, path, formula->forward, task, &options);
    description_free(&about);
    hg_step_reset(ctx);
    return status;
}

/* How many columns the output of a part has, which the next one takes. */
static hg_status columns_out(hg_hair_task *task, hg_ctx *ctx, const hg_hair_formula *formula, int64_t *columns)
{
    hg_tensor *in[HG_ONNX_INPUTS] = { NULL };
    hg_no_grad_begin(ctx);
    for (int i = 0; i < formula->n_inputs; i++)
        in[i] = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 1, formula->input[i].columns });
    const hg_tensor *out = hg_ctx_status(ctx) == HG_OK ? formula->forward(task, ctx, in) : NULL;
    hg_no_grad_end(ctx);
    if (out) *columns = out->shape[out->rank - 1];
    const hg_status status = hg_ctx_status(ctx);
    hg_step_reset(ctx);
    return status;
}

static hg_status no_form(hg_hair_task *task, int n, const hg_hair_formula *formulas, const char *form)
{
    hg_text known = { 0 };
    for (int i = 0; i < n; i++)
        if (i == 0 || strcmp(formulas[i].form, formulas[i - 1].form))
            hg_text_add(&known, "%s%s", i ? ", " : "", formulas[i].form);
    hg_fail(HG_INVALID, "export: this %s has no form \"%s\"; it has %s", hg_hair_model(task)->kind, form,
            known.data ? known.data : "none");
    hg_text_free(&known);
    return HG_INVALID;
}

static char *path_of(const char *path, const char *part)
{
    const char *extension = hg_path_extension(path);
    const size_t stem = strlen(path) - (extension[0] ? strlen(extension) + 1 : 0);
    return part ? hg_format("%.*s.%s.onnx", (int)stem, path, part) : hg_strdup(path);
}

hg_status hg_export_hair_onnx_as(hg_hair_task *task, hg_ctx *ctx, const char *form, const char *path,
                                 hg_exported files[HG_HAIR_FORMULAS], int *n_files)
{
    hg_hair_formula formulas[HG_HAIR_FORMULAS];
    const int n = hg_hair_formulas(task, formulas);
    *n_files = 0;
    if (!form) form = formulas[0].form;
    int64_t columns = 0;
    hg_status status = HG_OK;
    for (int i = 0; status == HG_OK && i < n; i++) {
        if (strcmp(formulas[i].form, form)) continue;
        hg_exported *file = &files[*n_files];
        *file = (hg_exported){ path_of(path, formulas[i].part), formulas[i].what };
        status = file->path ? export_one(task, ctx, &formulas[i], file->path, &columns) : HG_MEMORY;
        ++*n_files;
        const bool goes_on = i + 1 < n && !strcmp(formulas[i + 1].form, form);
        if (status == HG_OK && goes_on) status = columns_out(task, ctx, &formulas[i], &columns);
    }
    if (status == HG_OK && *n_files == 0) status = no_form(task, n, formulas, form);
    if (status == HG_OK) return HG_OK;
    hg_exported_free(files, *n_files);
    *n_files = 0;
    return status;
}

void hg_exported_free(hg_exported *files, int n)
{
    for (int i = 0; i < n; i++) hg_free(files[i].path);
}

hg_status hg_export_hair_onnx(hg_hair_task *task, hg_ctx *ctx, const char *path)
{
    hg_exported files[HG_HAIR_FORMULAS];
    int n;
    HG_TRY(hg_export_hair_onnx_as(task, ctx, NULL, path, files, &n));
    hg_exported_free(files, n);
    return HG_OK;
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

/* Real inputs of a few rows, and what the network answers: of strands spread over the groom, in the middle of a clip; or of frames
 * spread over it. */
static hg_status write_sample(hg_h5 *file, hg_hair_task *task, hg_ctx *ctx, const hg_hair_formula *formula)
{
    bool held_out = hg_hair_clips(task, true) > 0;
    if (!held_out && hg_hair_clips(task, false) < 1) return HG_OK;
    const hg_motion *clip = hg_hair_clip(task, held_out, 0);
    const int64_t strands = hg_hair_groom(task)->strands, columns = formula->input[0].columns;
    const int64_t own = hg_hair_strand_inputs(task);
    const bool of_strands = !strcmp(formula->input[0].rows, "strands");
    int64_t rows = of_strands ? SAMPLE_STRANDS : SAMPLE_FRAMES;
    if (of_strands && rows > strands) rows = strands;
    float *raw = hg_alloc((size_t)(rows * columns), sizeof *raw), *answer = NULL;
    hg_status status = raw ? HG_OK : HG_MEMORY;
    for (int64_t i = 0; status == HG_OK && i < rows; i++) {
        const int32_t strand = (int32_t)(i * strands / rows);
        const int64_t frame = of_strands ? clip->frames / 2 : (i + 1) * clip->frames / (rows + 1);
        status = hg_hair_strand_features(task, ctx, &strand, 1, raw + i * columns);
        if (status == HG_OK) status = hg_hair_frame_features(task, ctx, clip, frame, NULL, raw + i * columns + own);
    }
    hg_no_grad_begin(ctx);
    hg_tensor *in = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ rows, columns });
    if (status == HG_OK) status = in ? hg_tensor_write(in, raw) : hg_ctx_status(ctx);
    hg_tensor *out = status == HG_OK ? formula->forward(task, ctx, &in) : NULL;
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

static hg_status write_texture(hg_h5 *file, const hg_hair_task *task)
{
    const int32_t *texel, *strand;
    const int64_t strands = hg_hair_groom(task)->strands;
    if (!hg_hair_texture(task, &texel, &strand)) return HG_OK;
    HG_TRY(hg_h5_write(file, "texture/texel", HG_I32, 1, &strands, texel));
    return hg_h5_write(file, "texture/strand", HG_I32, 1, &strands, strand);
}

/* An attribute ends at 64 KiB: what can be longer has tables of its own. */
static bool has_table(const char *key)
{
    static const char *const keys[] = { "features", "texel", "strand" };
    for (size_t i = 0; i < sizeof keys / sizeof *keys; i++)
        if (!strcmp(key, keys[i])) return true;
    return false;
}

static hg_status write_weights(hg_h5 *file, hg_hair_task *task, hg_ctx *ctx, const hg_hair_formula *formula,
                               const description *about)
{
    const hg_model *model = hg_hair_model(task);
    HG_TRY(hg_h5_group(file, "model"));
    HG_TRY(hg_h5_set_text(file, "model", "kind", model->kind));
    for (int i = 0; i < about->n; i++)
        if (!has_table(about->key[i])) HG_TRY(hg_h5_set_text(file, "", about->key[i], about->value[i]));
    for (int i = 0; i < model->n_params; i++) HG_TRY(write_parameter(file, model->params[i], i));
    HG_TRY(write_sample(file, task, ctx, formula));
    HG_TRY(write_texture(file, task));
    return write_features(file, task);
}

hg_status hg_export_hair_h5(hg_hair_task *task, hg_ctx *ctx, const char *path)
{
    description about;
    hg_hair_formula formulas[HG_HAIR_FORMULAS];
    hg_hair_formulas(task, formulas);
    HG_TRY(describe_hair(task, &formulas[0], &about));
    hg_h5 *file = NULL;
    hg_status status = hg_h5_create(&file, path);
    if (status == HG_OK) {
        status = write_weights(file, task, ctx, &formulas[0], &about);
        if (status == HG_OK)
            status = hg_h5_commit(file);
        else
            hg_h5_close(file);
    }
    description_free(&about);
    return status;
}
