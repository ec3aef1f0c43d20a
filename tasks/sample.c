/* sample: the batch of a step, from (seed, step) alone: which clip and frame, which body shape; the body and the roots of
 * the strands at t-2, t-1 and t, or what moves them there. A clip starts at rest: its first frame stands for every time before it.
 * With `training.consecutive` frames come in runs of a clip, one after another with one body, groom and material: t-1 of a
 * frame is the t of the one before it, and is not made again. */
#include "tasks/hair.h"

#include <math.h>

enum { STREAM_FRAME = 7200, STREAM_SHAPE = 7201, STREAM_GROOM = 7202, FRAMES = 256 };

/* Floats of a batch, in the order in which they are laid out. */
enum { INPUTS, ROTATION, POSITION, BODY, SHAPE, TRANSFORM, PARTS };
static void measure(const hg_hair_task *task, int64_t frames, int64_t strands, int64_t floats[PARTS])
{
    const int64_t times = hg_hair_batch_rows(task, frames);
    const bool host = hg_ctx_host(task->ctx);
    floats[INPUTS] = times * task->layout.frame_inputs;
    floats[ROTATION] = host ? times * strands * 4 : 0;
    floats[POSITION] = host ? times * strands * 3 : 0;
    floats[BODY] = host ? frames * task->body_vertices * 3 : 0;
    floats[SHAPE] = host ? 0 : times * HG_SHAPES;
    floats[TRANSFORM] = host ? 0 : times * task->body->joints * 12;
}

int64_t hg_hair_batch_rows(const hg_hair_task *task, int64_t frames)
{
    return frames + 2 * (frames / task->consecutive);
}

size_t hg_hair_batch_bytes(const hg_hair_task *task, int64_t frames, int64_t strands)
{
    int64_t floats[PARTS];
    size_t bytes = sizeof(hg_hair_batch) + 64 + (size_t)hg_hair_batch_rows(task, frames) * sizeof(int32_t) +
                   (size_t)(frames * (task->n_materials + task->n_ramps)) * sizeof(double) + 2 * 64;
    measure(task, frames, strands, floats);
    for (int i = 0; i < PARTS; i++) bytes += (size_t)floats[i] * sizeof(float) + 64;
    return bytes;
}

static float *take(char **at, int64_t floats)
{
    uintptr_t aligned = ((uintptr_t)*at + 63) & ~(uintptr_t)63;
    *at = (char *)aligned + (size_t)floats * sizeof(float);
    return (float *)aligned;
}

hg_hair_batch *hg_hair_batch_lay_out(const hg_hair_task *task, void *bytes, int64_t frames, int64_t strands)
{
    hg_hair_batch *batch = bytes;
    char *at = (char *)bytes + sizeof *batch;
    int64_t floats[PARTS];
    float *part[PARTS];
    measure(task, frames, strands, floats);
    for (int i = 0; i < PARTS; i++) part[i] = floats[i] ? take(&at, floats[i]) : NULL;
    *batch = (hg_hair_batch){ .frames = frames,
                              .runs = frames / task->consecutive,
                              .consecutive = task->consecutive,
                              .rows = hg_hair_batch_rows(task, frames),
                              .strands = strands,
                              .body_vertices = task->body_vertices,
                              .inputs = part[INPUTS],
                              .rotation = part[ROTATION],
                              .position = part[POSITION],
                              .body = part[BODY],
                              .shape = part[SHAPE],
                              .transform = part[TRANSFORM] };
    batch->groom = (int32_t *)(void *)take(&at, batch->rows);
    batch->material = (double *)(void *)take(&at, 2 * frames * (task->n_materials + task->n_ramps));
    return batch;
}

/* The body and the roots of a row: made here, or what a device makes them from. */
static hg_status pose_row(hg_hair_task *task, hg_ctx *ctx, hg_hair_batch *batch, const hg_hair_subset *subset,
                          int64_t row, const hg_motion *motion, int64_t frame, const double *shape)
{
    const int64_t S = batch->strands, b = row - 2 * batch->runs;
    const int32_t groom = batch->groom[row];
    if (frame < 0) frame = 0;
    if (batch->transform)
        return hg_pose_joints(task->poser, shape, motion, frame, batch->shape + row * HG_SHAPES,
                              batch->transform + row * task->body->joints * 12);
    /* Hair touches the body of t alone. */
    float *body = b >= 0 ? batch->body + b * task->body_vertices * 3 : task->posed_body;
    hg_profile_begin(ctx, "sample", "body");
    HG_TRY(hg_pose(ctx, task->poser, shape, motion, frame, body, NULL, NULL));
    hg_profile_end(ctx, 12 * task->body_vertices);
    hg_profile_begin(ctx, "sample", "roots");
    HG_TRY(hg_pose_roots(ctx, task->poser, task->styles[subset->first + groom].groom, subset->strand + groom * S, S,
                         body, batch->rotation + row * S * 4, batch->position + row * S * 3));
    hg_profile_end(ctx, 28 * S);
    return HG_OK;
}

hg_status hg_hair_batch_fill(hg_hair_task *task, hg_ctx *ctx, hg_hair_batch *batch, const hg_hair_subset *subset,
                             int64_t run, int32_t groom, const hg_hair_clip_data *clip, int64_t frame,
                             const double shape[HG_SHAPES], const double *material)
{
    const int64_t N = batch->consecutive, given = task->n_materials + task->n_ramps;
    for (int64_t b = run * N; b < (run + 1) * N; b++)
        for (int i = 0; i < given; i++) batch->material[b * given + i] = material[i];
    for (int64_t time = 0; time < N + 2; time++) {
        const int64_t at = frame - 2 + time,
                      row = time < 2 ? time * batch->runs + run : 2 * batch->runs + run * N + time - 2;
        batch->groom[row] = groom;
        HG_TRY(pose_row(task, ctx, batch, subset, row, clip->motion, at, shape));
        float *out = batch->inputs + row * task->layout.frame_inputs;
        hg_hair_track_frame(&task->layout, &clip->track, at, shape, out);
        hg_hair_material_features(task, material, out);
        hg_hair_normalise_frame(task, out, out);
    }
    return HG_OK;
}

void hg_hair_draw_shape(const hg_hair_task *task, uint64_t seed, uint64_t counter, double shape[HG_SHAPES])
{
    for (int k = 0; k < HG_SHAPES; k++) {
        const double beta = task->spread[k] * hg_random_normal(seed, STREAM_SHAPE, counter * HG_SHAPES + (uint64_t)k);
        shape[k] = fmin(fmax(beta, -1), 1);
    }
}

/* Which groom each run of a step shows; runs of one groom stand together. */
static void draw_grooms(const hg_hair_task *task, uint64_t key, uint64_t step, int64_t runs, int32_t *groom)
{
    int64_t at = 0;
    int32_t drawn[FRAMES];
    for (int64_t r = 0; r < runs; r++)
        drawn[r] = task->n_grooms == 1
                       ? 0
                       : (int32_t)hg_random_below(key, STREAM_GROOM, step * (uint64_t)runs + (uint64_t)r,
                                                  (uint64_t)task->n_grooms);
    for (int32_t g = 0; g < task->n_grooms; g++)
        for (int64_t r = 0; r < runs; r++)
            if (drawn[r] == g) groom[at++] = g;
}

hg_status hg_hair_sample(void *self, hg_ctx *ctx, uint64_t seed, uint64_t step, void *bytes)
{
    hg_hair_task *task = self;
    const int64_t every = hg_config_integer(task->config, "training.resample_every");
    const int64_t epoch = every > 0 ? (int64_t)step / every : 0;
    if (epoch != task->subset_epoch) {
        hg_hair_subset drawn;
        HG_TRY(hg_hair_subset_create(&drawn, task, HG_HAIR_TRAINING, epoch));
        hg_hair_subset_destroy(&task->subset);
        task->subset = drawn;
        task->subset_epoch = epoch;
    }
    const int64_t B = hg_config_integer(task->config, "training.frames");
    hg_hair_batch *batch = hg_hair_batch_lay_out(task, bytes, B, task->subset.n);
    const uint64_t key = seed * 1000003 + task->seed;
    int32_t groom[FRAMES];
    draw_grooms(task, key, step, batch->runs, groom);
    /* A run begins where the rest of it is still in its clip. */
    const int64_t cut = batch->consecutive - 1, starts = task->training_frames - task->n_clips[0] * cut;
    for (int64_t r = 0; r < batch->runs; r++) {
        const uint64_t counter = step * (uint64_t)batch->runs + (uint64_t)r;
        int64_t frame = (int64_t)hg_random_below(key, STREAM_FRAME, counter, (uint64_t)starts);
        int clip = 0;
        while (frame >= task->clips[0][clip].motion->frames - cut) frame -= task->clips[0][clip++].motion->frames - cut;
        double shape[HG_SHAPES], material[HG_HAIR_GIVEN];
        hg_hair_draw_shape(task, key, counter, shape);
        hg_hair_draw_materials(task, key, counter, (int64_t)step, material);
        HG_TRY(hg_hair_batch_fill(task, ctx, batch, &task->subset, r, groom[r], &task->clips[0][clip], frame, shape,
                                  material));
    }
    return HG_OK;
}

/* Shapes of another stream of numbers than training's. */
void hg_hair_held_out_shape(const hg_hair_task *task, int64_t i, double shape[HG_SHAPES])
{
    hg_hair_draw_shape(task, task->seed + 0x5eed, (uint64_t)i, shape);
}
