/* hair_task: a training run from one config, of any family of networks: what is made once, the loss of a step, the
 * validation, and what a checkpoint adds. docs/neuralocks.md has the features. */
#include "tasks/hair.h"
#include "tasks/root_gravity.kernel.h"

#include <errno.h>
#include <math.h>
#include <string.h>
#include <unistd.h>

/* ---- loss --------------------------------------------------------------------------------------------------- */

/* The loss from the energy of a batch: over strands and the reference, and without the gravity of the roots, which is another
 * number in every step and therefore a tensor. */
static hg_tensor *from_roots(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_batch *batch,
                             const hg_hair_subset *subset, const hg_tensor *position, hg_tensor *energy,
                             hg_tensor **unweighted)
{
    const double scale = 1 / ((double)(batch->frames * batch->strands) * task->reference);
    hg_tensor *value = hg_scale(ctx, energy, scale, 0);
    for (int i = 0; i < task->terms.n; i++) {
        const hg_term *gravity = &task->terms.term[i];
        if (strcmp(gravity->energy->name, "gravity")) continue;
        const int64_t n = task->terms.n;
        hg_tensor *roots = hg_tensor_make(ctx, HG_F64, 1, &n), *shift = hg_tensor_make(ctx, HG_F32, 0, NULL);
        const hg_tensor *groom = hg_tensor_from(ctx, HG_I32, 1, &batch->frames, batch->groom + 2 * batch->runs);
        if (!roots || !shift || !groom) return NULL;
        const root_gravity_args args = { .frames = batch->frames,
                                         .strands = batch->strands,
                                         .position = position->data,
                                         .mass = subset->weigh->data,
                                         .groom = groom->data,
                                         .g = { gravity->params[0], gravity->params[1], gravity->params[2] },
                                         .terms = task->terms.n,
                                         .term = i,
                                         .scale = scale * gravity->weight,
                                         .joule = roots->data,
                                         .loss = shift->data };
        if (hg_launch(ctx, &root_gravity_kernel, 1, &args) != HG_OK) return NULL;
        *unweighted = hg_sub(ctx, *unweighted, roots);
        return hg_add(ctx, value, shift);
    }
    return value;
}

/* Roots [P,S,..] and bodies at t [B,N,3]: from the batch, or made here from what moves them. */
static hg_status bodies_and_roots(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_batch *batch,
                                  const hg_hair_subset *subset, hg_tensor **rotation, hg_tensor **position,
                                  hg_tensor **body)
{
    const int64_t B = batch->frames, P = batch->rows, S = batch->strands;
    if (!batch->transform) {
        *rotation = hg_tensor_from(ctx, HG_F32, 3, (int64_t[]){ P, S, 4 }, batch->rotation);
        *position = hg_tensor_from(ctx, HG_F32, 3, (int64_t[]){ P, S, 3 }, batch->position);
        *body = hg_tensor_from(ctx, HG_F32, 3, (int64_t[]){ B, batch->body_vertices, 3 }, batch->body);
        return hg_ctx_status(ctx);
    }
    const hg_tensor *shape = hg_tensor_from(ctx, HG_F32, 2, (int64_t[]){ P, HG_SHAPES }, batch->shape);
    const hg_tensor *transform =
        hg_tensor_from(ctx, HG_F32, 3, (int64_t[]){ P, task->body->joints, 12 }, batch->transform);
    const hg_tensor *groom = hg_tensor_from(ctx, HG_I32, 1, &P, batch->groom);
    hg_profile_begin(ctx, "sample", "body");
    hg_tensor *bodies = hg_pose_bodies(ctx, task->poser, shape, transform);
    hg_profile_end(ctx, 12 * P * batch->body_vertices);
    hg_profile_begin(ctx, "sample", "roots");
    if (bodies && groom) HG_TRY(hg_roots_pose(ctx, subset->roots, groom, bodies, rotation, position));
    hg_profile_end(ctx, 28 * P * S);
    *body = hg_tensor_rows(ctx, bodies, P - B, B);
    return hg_ctx_status(ctx);
}

/* x(t-1) and 2 x(t-1) - x(t-2) of the frames x [B,S,V,3]: of the two times before each run [2 R,S,V,3], and within a run of
 * the frames before. */
static void of_the_past(hg_ctx *ctx, const hg_hair_batch *batch, hg_tensor *past, hg_tensor *x, hg_tensor **previous,
                        hg_tensor **predicted)
{
    const int64_t R = batch->runs, N = batch->consecutive;
    hg_tensor *before = NULL;
    *previous = NULL;
    hg_no_grad_begin(ctx);
    if (past && N == 1) {
        before = hg_tensor_rows(ctx, past, 0, R);
        *previous = hg_tensor_rows(ctx, past, R, R);
    } else if (past && x) {
        const int64_t row = hg_tensor_count(x) / x->shape[0];
        hg_tensor *parts[3] = { hg_reshape(ctx, hg_tensor_rows(ctx, past, 0, R), 3, (int64_t[]){ R, 1, row }),
                                hg_reshape(ctx, hg_tensor_rows(ctx, past, R, R), 3, (int64_t[]){ R, 1, row }),
                                hg_reshape(ctx, x, 3, (int64_t[]){ R, N, row }) };
        hg_tensor *times = hg_concat(ctx, 1, 3, parts); /* [R,N+2,row] */
        before = hg_reshape(ctx, hg_slice(ctx, times, 1, 0, N), 4, x->shape);
        *previous = hg_reshape(ctx, hg_slice(ctx, times, 1, 1, N), 4, x->shape);
    }
    *predicted = hg_sub(ctx, hg_scale(ctx, *previous, 2, 0), before);
    hg_no_grad_end(ctx);
}

/* Without gradient, and without what they were made from. */
static hg_tensor *strands_before(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, hg_tensor *rest,
                                 hg_tensor *inputs, const int32_t *groom, hg_tensor *rotation, hg_tensor *position)
{
    hg_no_grad_begin(ctx);
    hg_tensor *past = inputs ? hg_tensor_make(ctx, HG_F32, 4,
                                              (int64_t[]){ inputs->shape[0], part->strands, task->groom->vertices, 3 })
                             : NULL;
    const hg_step_mark mark = hg_step_set_mark(ctx);
    const int recorded = hg_tape_count(ctx);
    const hg_tensor *made = hg_hair_predict(task, ctx, part, groom, inputs, rest, rotation, position);
    if (!made || !past || hg_tensor_copy(past, made) != HG_OK) past = NULL;
    if (hg_tape_count(ctx) == recorded) hg_step_rewind(ctx, mark); /* nothing else of it is needed again */
    hg_no_grad_end(ctx);
    return past;
}

hg_tensor *hg_hair_energy(hg_hair_task *task, hg_ctx *ctx, const hg_hair_batch *batch, hg_hair_subset *subset,
                          hg_tensor **unweighted)
{
    const int64_t B = batch->frames, past_rows = batch->rows - B, S = batch->strands, F = task->layout.frame_inputs;
    hg_tensor *inputs = hg_tensor_from(ctx, HG_F32, 2, (int64_t[]){ batch->rows, F }, batch->inputs);
    hg_tensor *rotation, *position, *body;
    if (!inputs || bodies_and_roots(task, ctx, batch, subset, &rotation, &position, &body) != HG_OK) return NULL;

    /* What belongs to the strands, or to their groom, is the same at all times. */
    const hg_hair_part part = hg_hair_part_of(task, ctx, subset);
    hg_tensor *past =
        task->moves
            ? strands_before(task, ctx, &part, subset->rest, hg_tensor_rows(ctx, inputs, 0, past_rows), batch->groom,
                             hg_tensor_rows(ctx, rotation, 0, past_rows), hg_tensor_rows(ctx, position, 0, past_rows))
            : NULL;
    const int32_t *groom = batch->groom + past_rows;
    hg_frame frame = { .groom = groom,
                       .root_rotation = hg_tensor_rows(ctx, rotation, past_rows, B),
                       .root_position = hg_tensor_rows(ctx, position, past_rows, B),
                       .body_vertices = body,
                       .dt = 1 / task->rate,
                       .consecutive = batch->consecutive };
    hg_hair_strands now = { 0 };
    now.x = hg_hair_predict_edges(task, ctx, &part, groom, hg_tensor_rows(ctx, inputs, past_rows, B), subset->rest,
                                  frame.root_rotation, frame.root_position, &now.q);
    if (task->moves) of_the_past(ctx, batch, past, now.x, &frame.previous, &frame.predicted);
    if (task->clip_vertex > 0)
        now.x = hg_clip_gradient(ctx, now.x, task->clip_vertex / ((double)(B * S) * task->reference));
    if (!now.x || hg_hair_physics_inputs(task, ctx, subset, batch->material, &now, &frame) != HG_OK) return NULL;
    hg_tensor *energy = hg_physics_energy(subset->physics, ctx, &frame, now.x, NULL);
    if (!energy) return NULL;
    *unweighted = hg_physics_unweighted(subset->physics);
    return from_roots(task, ctx, batch, subset, frame.root_position, energy, unweighted);
}

static hg_tensor *loss(void *self, hg_ctx *ctx, hg_model *model, const void *bytes, hg_report *report)
{
    hg_hair_task *task = self;
    const hg_hair_batch *batch = bytes;
    (void)model; /* the task's own */
    if (task->compute != HG_F32 && hg_ctx_compute(ctx, task->compute) != HG_OK) return NULL;
    hg_tensor *joule, *value = hg_hair_energy(task, ctx, batch, &task->subset, &joule);
    const double per_strand = 1 / (double)(batch->frames * batch->strands);
    for (int i = 0; value && i < task->terms.n; i++) {
        const double weight = task->terms.term[i].weight;
        hg_report_later(report, task->term_name[i][0], joule, i, weight * per_strand / task->reference);
        hg_report_later(report, task->term_name[i][1], joule, i, per_strand);
    }
    hg_hair_report_learnt(task, ctx, report);
    return value;
}

static int64_t left_out_of_all(const hg_hair_task *task)
{
    int64_t n = 0;
    for (int g = 0; g < task->n_grooms; g++) n += task->styles[g].left_out;
    return n;
}

/* ---- validation --------------------------------------------------------------------------------------------- */

/* The loss on frames and body shapes that training does not draw: held-out clips at even distances, or, where there are
 * none, training clips with other shapes. Always the same frames, so that values can be compared. */
static hg_status validate(void *self, hg_ctx *ctx, hg_model *model, hg_report *report)
{
    hg_hair_task *task = self;
    (void)model;
    const int held_out = task->n_clips[1] > 0;
    int64_t frames = 0;
    const int64_t N = task->consecutive;
    for (int i = 0; i < task->n_clips[held_out]; i++) frames += task->clips[held_out][i].motion->frames - (N - 1);
    const int64_t n = (hg_config_integer(task->config, "training.validation_frames") + N - 1) / N; /* runs */
    double total = 0, terms[HG_HAIR_TERMS] = { 0 };
    hg_hair_batch *batch = hg_hair_batch_lay_out(task, task->validation_batch, N, task->subset.n);
    if (task->compute != HG_F32) HG_TRY(hg_ctx_compute(ctx, HG_F32));
    hg_no_grad_begin(ctx);
    hg_status status = HG_OK;
    for (int64_t k = 0; status == HG_OK && k < n; k++) {
        int64_t frame = (2 * k + 1) * frames / (2 * n);
        int clip = 0;
        while (frame >= task->clips[held_out][clip].motion->frames - (N - 1))
            frame -= task->clips[held_out][clip++].motion->frames - (N - 1);
        double shape[HG_SHAPES], unweighted[HG_HAIR_TERMS], material[HG_HAIR_GIVEN];
        hg_tensor *joule;
        hg_hair_held_out_shape(task, k, shape);
        hg_hair_draw_materials(task, task->seed + 0x5eed, (uint64_t)k, -1, material);
        hg_step_reset(ctx);
        status = hg_hair_batch_fill(task, ctx, batch, &task->subset, 0, (int32_t)(k % task->n_grooms),
                                    &task->clips[held_out][clip], frame, shape, material);
        if (status != HG_OK) break;
        const hg_tensor *value = hg_hair_energy(task, ctx, batch, &task->subset, &joule);
        status = value ? hg_tensor_read(joule, unweighted) : hg_ctx_status(ctx);
        if (status != HG_OK || !value) break;
        total += hg_tensor_item(value, 0) / (double)n;
        for (int i = 0; i < task->terms.n; i++)
            terms[i] +=
                task->terms.term[i].weight * unweighted[i] / ((double)(n * N * task->subset.n) * task->reference);
    }
    hg_no_grad_end(ctx);
    if (status != HG_OK) return status;
    hg_report_add(report, "validation", total);
    for (int i = 0; i < task->terms.n; i++) hg_report_add(report, task->term_name[i][2], terms[i]);
    if (task->network->choose) hg_report_add(report, "strands_left_out", (double)left_out_of_all(task));
    return HG_OK;
}

/* ---- checkpoint --------------------------------------------------------------------------------------------- */

static hg_status save(void *self, hg_h5 *file)
{
    const hg_hair_task *task = self;
    char hash[24];
    HG_TRY(hg_hair_encoder_save(task, file));
    const int64_t inputs = task->inputs;
    HG_TRY(hg_h5_write(file, "/features/mean", HG_F64, 1, &inputs, task->mean));
    HG_TRY(hg_h5_write(file, "/features/deviation", HG_F64, 1, &inputs, task->deviation));
    HG_TRY(hg_h5_write(file, "/reference_energy", HG_F64, 1, (int64_t[]){ 1 }, &task->reference));
    snprintf(hash, sizeof hash, "%016llx", (unsigned long long)hg_hair_grooms_hash(task));
    return hg_h5_set_text(file, "/", "groom_hash", hash);
}

static hg_status load_features(hg_hair_task *task, hg_h5 *file)
{
    const int64_t inputs = task->inputs;
    double *mean = NULL, *deviation = NULL;
    hg_status status = hg_h5_read(file, "/features/mean", HG_F64, 1, &inputs, NULL, (void **)&mean);
    if (status == HG_OK)
        status = hg_h5_read(file, "/features/deviation", HG_F64, 1, &inputs, NULL, (void **)&deviation);
    for (int64_t i = 0; status == HG_OK && i < inputs; i++)
        if (!(deviation[i] > 0) || !isfinite(mean[i]))
            status = hg_fail(HG_FORMAT, "checkpoint: the deviation of feature %s is %g, it has to be positive",
                             task->features[i].name, deviation[i]);
    if (status == HG_OK) {
        memcpy(task->mean, mean, (size_t)inputs * sizeof *mean);
        memcpy(task->deviation, deviation, (size_t)inputs * sizeof *deviation);
    }
    hg_free(mean);
    hg_free(deviation);
    return status;
}

/* The normalisation, and what was made with the encoder before it was read. */
static hg_status load_inputs(hg_hair_task *task, hg_h5 *file)
{
    HG_TRY(hg_hair_encoder_load(task, file));
    HG_TRY(load_features(task, file));
    HG_TRY(hg_hair_encode(task));
    HG_TRY(hg_hair_features_tensors(task));
    if (task->subset.n) HG_TRY(hg_hair_subset_features(&task->subset, task));
    if (task->evaluation.n) HG_TRY(hg_hair_subset_features(&task->evaluation, task));
    return HG_OK;
}

/* A new run that starts from another's weights sees the world as that one did; the unit of the loss is its own. */
static hg_status start(void *self, hg_h5 *file) { return load_inputs(self, file); }

static hg_status load(void *self, hg_h5 *file)
{
    hg_hair_task *task = self;
    char *hash = NULL, expected[24];
    HG_TRY(hg_h5_get_text(file, "/", "groom_hash", &hash));
    snprintf(expected, sizeof expected, "%016llx", (unsigned long long)hg_hair_grooms_hash(task));
    const bool same = !strcmp(hash, expected);
    hg_free(hash);
    if (!same)
        return hg_fail(HG_INVALID, "checkpoint: it was trained on another groom than the one the config names now");
    double *reference = NULL;
    HG_TRY(load_inputs(task, file));
    HG_TRY(hg_h5_read(file, "/reference_energy", HG_F64, 1, (int64_t[]){ 1 }, NULL, (void **)&reference));
    task->reference = reference[0];
    hg_free(reference);
    return HG_OK;
}

/* ---- create and destroy ------------------------------------------------------------------------------------- */

/* The folder is made at once, so that one that cannot be written is known before anything is trained; what goes into it,
 * only when the whole config was accepted. */
static hg_status take_folder(hg_hair_task *task, const char *folder)
{
    task->folder = hg_strdup(folder);
    if (!task->folder) return HG_MEMORY;
    if (task->opened) return HG_OK;
    task->folder_made = !hg_file_exists(folder);
    HG_TRY(hg_folder_create(folder));
    return access(folder, W_OK) == 0 ? HG_OK
                                     : hg_fail(HG_IO, "%s: the folder cannot be written (%s)", folder, strerror(errno));
}

static hg_status fill_folder(const hg_hair_task *task)
{
    char *path = hg_path_join(task->folder, "config.yaml"), *echo = hg_config_echo(task->config);
    hg_status status = path && echo ? hg_file_write(path, echo, strlen(echo)) : HG_MEMORY;
    hg_free(path);
    hg_free(echo);
    return status == HG_OK ? hg_hair_encoder_keep(task) : status;
}

static hg_status take_config(hg_hair_task *task, const hg_config *config, const char *folder)
{
    HG_TRY(hg_hair_config_copy(&task->config, config));
    task->seed = (uint64_t)hg_config_integer(task->config, "training.seed");
    char *echo = hg_config_echo(task->config);
    if (!echo) return HG_MEMORY;
    task->config_hash = hg_hash(echo, strlen(echo), hg_ctx_seed(task->ctx));
    hg_free(echo);
    return folder ? take_folder(task, folder) : HG_OK;
}

/* The checkpoint that `training.start_from` means: a file, or the best one of a run. */
static hg_status find_start(hg_hair_task *task)
{
    const hg_config *config = task->config;
    const char *from = hg_config_text(config, "training.start_from"), *key = "training.start_from";
    if (!from[0]) return HG_OK;
    static const char *const names[] = { NULL, "best.h5", "checkpoint.h5" };
    const bool file = !strcmp(hg_path_extension(from), "h5");
    for (int i = file ? 0 : 1; i < (file ? 1 : 3); i++) {
        char *path = names[i] ? hg_path_join(from, names[i]) : hg_strdup(from);
        if (!path) return HG_MEMORY;
        if (hg_file_exists(path)) {
            task->start_from = path;
            return HG_OK;
        }
        hg_free(path);
    }
    return hg_fail(HG_IO, "%s:%d: %s: %s: %s", hg_config_name(config), hg_config_line(config, key), key, from,
                   file ? "there is no such file"
                        : "no best.h5 and no checkpoint.h5: nothing has been trained there yet");
}

static hg_status name_terms(hg_hair_task *task)
{
    const char *const prefix[3] = { "loss.", "joule.", "validation." };
    for (int i = 0; i < task->terms.n; i++)
        for (int k = 0; k < 3; k++) {
            task->term_name[i][k] = hg_format("%s%s", prefix[k], task->terms.term[i].energy->name);
            if (!task->term_name[i][k]) return HG_MEMORY;
        }
    return HG_OK;
}

/* bf16 or TF32 where the config asks for it: an error where the device has none, since its numbers are other ones. */
static hg_status take_compute(hg_hair_task *task)
{
    task->compute = HG_F32;
    const char *name = hg_config_text(task->config, "training.compute");
    if (task->opened || strcmp(name, "f32") == 0) return HG_OK;
    task->compute = strcmp(name, "bf16") == 0 ? HG_BF16 : HG_TF32;
    const hg_status status = hg_ctx_compute(task->ctx, task->compute);
    if (status != HG_OK) {
        char *why = hg_strdup(hg_message());
        hg_fail(status, "%s:%d: training.compute: %s", hg_config_name(task->config),
                hg_config_line(task->config, "training.compute"), why ? why : "not available");
        hg_free(why);
        return status;
    }
    return hg_ctx_compute(task->ctx, HG_F32);
}

/* What a network that cannot draw every strand leaves out. */
static hg_status tell_left_out(hg_hair_task *task, const hg_progress *progress)
{
    int64_t strands = left_out_of_all(task);
    if (strands == 0) return HG_OK;
    const int64_t left_out = strands;
    for (int g = 0; g < task->n_grooms; g++) strands += task->styles[g].groom->strands;
    task->note = hg_format("%lld of %lld strands are left out: their roots share a texel with another's; a larger "
                           "model.texture keeps more",
                           (long long)left_out, (long long)strands);
    if (!task->note) return HG_MEMORY;
    hg_progress_report(progress, 0, "%s", task->note);
    return HG_OK;
}

static hg_train_options train_options(const hg_hair_task *task)
{
    const hg_config *c = task->config;
    hg_train_options options = hg_train_defaults();
    options.steps = hg_config_integer(c, "training.steps");
    options.learning_rate = hg_config_number(c, "training.learning_rate");
    options.final_fraction = hg_config_number(c, "training.final_fraction");
    options.warm_up = hg_config_integer(c, "training.warm_up");
    options.clip = hg_config_number(c, "training.clip");
    options.beta1 = hg_config_number(c, "training.beta1");
    options.beta2 = hg_config_number(c, "training.beta2");
    options.epsilon = hg_config_number(c, "training.epsilon");
    options.weight_decay = hg_config_number(c, "training.weight_decay");
    options.ema = hg_config_number(c, "training.ema");
    options.patience = hg_config_integer(c, "training.patience");
    options.tensorboard = hg_config_flag(c, "training.tensorboard");
    options.start_from = task->start_from;
    options.log_every = hg_config_integer(c, "training.log_every");
    options.validate_every = hg_config_integer(c, "training.validate_every");
    options.checkpoint_every = hg_config_integer(c, "training.checkpoint_every");
    options.folder = task->folder;
    options.config_hash = task->config_hash;
    options.backend = task->backend;
    options.backend_note = task->backend_note;
    options.note = task->note;
    return options;
}

/* Runs of consecutive frames: they have to fill a step and to fit into every clip. */
static hg_status check_runs(const hg_hair_task *task)
{
    const hg_config *config = task->config;
    const char *const key = "training.consecutive";
    const long long N = task->consecutive, B = hg_config_integer(config, "training.frames");
    if (B % N)
        return hg_fail(HG_INVALID, "%s:%d: %s: the %lld frames of a step (training.frames) are not whole runs of %lld",
                       hg_config_name(config), hg_config_line(config, key), key, B, N);
    for (int held_out = 0; held_out < 2; held_out++)
        for (int i = 0; i < task->n_clips[held_out]; i++) {
            const hg_motion *motion = task->clips[held_out][i].motion;
            if (motion->frames < N)
                return hg_fail(HG_INVALID,
                               "%s:%d: %s: a run of %lld frames does not fit into the %lld of the motion %s",
                               hg_config_name(config), hg_config_line(config, key), key, N, (long long)motion->frames,
                               motion->name ? motion->name : "");
        }
    if (task->asks.deformation && N == 1 && !task->opened) {
        char losses[160];
        snprintf(losses, sizeof losses, "losses.%s", task->asks.deformation);
        return hg_fail(HG_INVALID,
                       "%s:%d: %s compares frames that follow each other, and is zero with runs of 1; %s: 2 or more",
                       hg_config_name(config), hg_config_line(config, losses), losses, key);
    }
    return HG_OK;
}

/* Where no energy asks for the frames before, they are not predicted. */
static hg_status look_back(hg_hair_task *task)
{
    for (int t = 0; t < task->terms.n; t++) {
        hg_energy_inputs inputs;
        HG_TRY(hg_energy_asks(task->terms.term[t].energy, task->terms.term[t].options, false, &inputs));
        for (int i = 0; i < inputs.n; i++)
            task->moves |= !strcmp(inputs.input[i].name, "predicted") || !strcmp(inputs.input[i].name, "previous");
    }
    return HG_OK;
}

/* What is given in every call makes another kernel than the config's numbers do: the first call makes it, and says
 * what runs it, which a checkpoint keeps. */
static hg_status first_call(hg_hair_task *task)
{
    const hg_hair_asks *asks = &task->asks;
    if (task->opened ||
        !(task->n_materials + task->n_ramps + task->n_learnt || asks->ghost || asks->deformation || asks->q))
        return HG_OK;
    void *batch = hg_alloc(1, task->batch_bytes);
    if (!batch) return HG_MEMORY;
    hg_tensor *joule;
    hg_step_reset(task->ctx);
    hg_status status = hg_hair_sample(task, task->ctx, hg_ctx_seed(task->ctx), 0, batch);
    if (status == HG_OK) {
        hg_hair_energy(task, task->ctx, batch, &task->subset, &joule);
        status = hg_ctx_status(task->ctx);
    }
    hg_step_reset(task->ctx);
    hg_free(batch);
    return status;
}

static hg_status create(hg_hair_task *task, const hg_config *config, const char *folder, const hg_progress *progress)
{
    HG_TRY(take_config(task, config, folder));
    if (!task->opened) HG_TRY(find_start(task));
    HG_TRY(take_compute(task));
    HG_TRY(hg_hair_terms_create(&task->terms, task->config));
    HG_TRY(hg_hair_asks_of(&task->asks, &task->terms));
    HG_TRY(name_terms(task));
    task->consecutive = hg_config_integer(task->config, "training.consecutive");
    HG_TRY(hg_hair_materials_create(task));
    HG_TRY(hg_hair_network_find(task));
    HG_TRY(hg_hair_world_create(task, progress));
    HG_TRY(tell_left_out(task, progress));
    HG_TRY(check_runs(task));
    HG_TRY(hg_hair_encoder_create(task, progress));
    HG_TRY(hg_hair_features_create(task));
    task->reference = hg_hair_reference_energy(task, &task->clip_vertex);
    task->clip_vertex *= hg_config_number(task->config, "training.clip_vertex");
    HG_TRY(hg_hair_network_create(task));
    HG_TRY(hg_hair_whole_model(task));
    hg_progress_report(progress, 0, "physics");
    HG_TRY(hg_hair_subset_create(&task->subset, task, HG_HAIR_TRAINING, 0));
    HG_TRY(look_back(task));
    task->batch_bytes = hg_hair_batch_bytes(task, hg_config_integer(task->config, "training.frames"), task->subset.n);
    task->validation_batch = hg_alloc(1, hg_hair_batch_bytes(task, task->consecutive, task->subset.n));
    if (!task->validation_batch) return HG_MEMORY;
    task->task = (hg_task){ .self = task,
                            .batch_bytes = task->batch_bytes,
                            .sample = hg_hair_sample,
                            .loss = loss,
                            .validate = validate,
                            .save = save,
                            .load = load,
                            .start = start };
    HG_TRY(first_call(task));
    task->backend = hg_format("%s%s", hg_physics_backend_name(task->subset.physics),
                              task->compute == HG_BF16   ? ", products in bf16"
                              : task->compute == HG_TF32 ? ", products in tf32"
                                                         : ""); /* outlives a subset drawn anew */
    task->backend_note = hg_strdup(hg_physics_backend_note(task->subset.physics));
    if (!task->backend || !task->backend_note) return HG_MEMORY;
    task->options = train_options(task);
    return task->folder && !task->opened ? fill_folder(task) : HG_OK;
}

static hg_status create_or_open(hg_hair_task **out, hg_ctx *ctx, const hg_config *config, const char *run_folder,
                                bool opened, const hg_progress *progress)
{
    *out = NULL;
    hg_hair_task *task = hg_alloc(1, sizeof *task);
    if (!task) return HG_MEMORY;
    task->ctx = ctx;
    task->opened = opened;
    const hg_status status = create(task, config, run_folder, progress);
    if (status != HG_OK) {
        if (task->folder_made) rmdir(task->folder); /* only where it is still empty */
        hg_hair_task_destroy(task);
        return status;
    }
    *out = task;
    return HG_OK;
}

hg_status hg_hair_task_create(hg_hair_task **out, hg_ctx *ctx, const hg_config *config, const char *run_folder,
                              const hg_progress *progress)
{
    return create_or_open(out, ctx, config, run_folder, false, progress);
}

void hg_hair_task_destroy(hg_hair_task *task)
{
    if (!task) return;
    hg_hair_subset_destroy(&task->subset);
    hg_hair_subset_destroy(&task->evaluation);
    hg_hair_materials_destroy(task);
    hg_model_destroy(task->model);
    hg_model_destroy(task->encoder);
    hg_tensor_destroy(task->output_map);
    hg_tensor_destroy(task->no_turn);
    hg_tensor_destroy(task->along);
    hg_tensor_destroy(task->mean_tensor);
    hg_tensor_destroy(task->inverse_deviation);
    for (int i = 0; i < task->n_features; i++) hg_free((char *)(uintptr_t)task->features[i].name);
    hg_free(task->features);
    hg_free(task->mean);
    hg_free(task->deviation);
    hg_body_tree_destroy(task->tree);
    hg_poser_destroy(task->poser);
    hg_free(task->posed_body);
    for (int held_out = 0; held_out < 2; held_out++) {
        for (int i = 0; i < task->n_clips[held_out]; i++) {
            hg_motion_destroy(task->clips[held_out][i].motion);
            hg_hair_track_destroy(&task->clips[held_out][i].track);
        }
        hg_free(task->clips[held_out]);
    }
    for (int i = 0; task->styles && i < task->n_styles; i++) hg_hair_style_destroy(&task->styles[i]);
    hg_free(task->styles);
    hg_body_destroy(task->body);
    for (int i = 0; i < HG_HAIR_TERMS; i++)
        for (int k = 0; k < 3; k++) hg_free(task->term_name[i][k]);
    hg_free(task->validation_batch);
    hg_free(task->folder);
    hg_free(task->backend);
    hg_free(task->backend_note);
    hg_free(task->note);
    hg_free(task->start_from);
    hg_config_destroy(task->config);
    hg_free(task);
}

hg_status hg_hair_task_open(hg_hair_task **out, hg_ctx *ctx, const char *run_folder, const hg_progress *progress)
{
    return hg_hair_task_open_with(out, ctx, run_folder, 0, NULL, progress);
}

hg_status hg_hair_task_open_with(hg_hair_task **out, hg_ctx *ctx, const char *run_folder, int n,
                                 const char *const *overrides, const hg_progress *progress)
{
    *out = NULL;
    char *config_path = hg_path_join(run_folder, "config.yaml"), *best = hg_path_join(run_folder, "best.h5");
    char *checkpoint = hg_path_join(run_folder, "checkpoint.h5");
    hg_config *config = NULL;
    hg_hair_task *task = NULL;
    hg_status status = config_path && best && checkpoint ? HG_OK : HG_MEMORY;
    int n_rows;
    const hg_config_row *rows = hg_hair_schema(&n_rows);
    if (status == HG_OK)
        status = rows ? hg_hair_config_loaded(hg_config_load_with(&config, config_path, rows, n_rows, overrides, n))
                      : HG_MEMORY;
    const char *weights = status == HG_OK && hg_file_exists(best) ? best : checkpoint;
    if (status == HG_OK && !hg_file_exists(weights))
        status = hg_fail(HG_IO, "%s: no best.h5 and no checkpoint.h5: nothing has been trained here yet", run_folder);
    if (status == HG_OK) status = create_or_open(&task, ctx, config, run_folder, true, progress);
    if (status == HG_OK) status = hg_checkpoint_load(weights, &task->whole, NULL, NULL, &task->task, NULL, NULL);
    hg_config_destroy(config);
    hg_free(config_path);
    hg_free(best);
    hg_free(checkpoint);
    if (status != HG_OK) {
        hg_hair_task_destroy(task);
        return status;
    }
    *out = task;
    return HG_OK;
}

/* ---- what others may ask ------------------------------------------------------------------------------------ */

const hg_task *hg_hair_task_of(hg_hair_task *task) { return &task->task; }
hg_model *hg_hair_model(hg_hair_task *task) { return &task->whole; }
hg_train_options hg_hair_train_options(const hg_hair_task *task) { return task->options; }
const hg_groom *hg_hair_groom(const hg_hair_task *task) { return task->groom; }
const char *hg_hair_groom_name(const hg_hair_task *task, int i)
{
    return i >= 0 && i < task->n_styles ? task->styles[i].name : NULL;
}
int hg_hair_grooms(const hg_hair_task *task) { return task->n_grooms; }
const hg_groom *hg_hair_groom_at(const hg_hair_task *task, int i)
{
    return i >= 0 && i < task->n_styles ? task->styles[i].groom : NULL;
}
int64_t hg_hair_left_out(const hg_hair_task *task, int i)
{
    return i >= 0 && i < task->n_styles ? task->styles[i].left_out : task->styles[task->current].left_out;
}
const hg_physics *hg_hair_physics(const hg_hair_task *task) { return task->subset.physics; }
const hg_body *hg_hair_body(const hg_hair_task *task) { return task->body; }
double hg_hair_rate(const hg_hair_task *task) { return task->rate; }
int hg_hair_clips(const hg_hair_task *task, bool held_out) { return task->n_clips[held_out]; }
const hg_motion *hg_hair_clip(const hg_hair_task *task, bool held_out, int i)
{
    return i >= 0 && i < task->n_clips[held_out] ? task->clips[held_out][i].motion : NULL;
}
