/* sample: the batch of a step, from (seed, step) alone: which clip and frame, which body shape; the body and the roots of
 * the strands at t-2, t-1 and t. A clip starts at rest: its first frame stands for every time before it. */
#include "tasks/hair.h"

#include <math.h>

enum { STREAM_FRAME = 7200, STREAM_SHAPE = 7201, STREAM_GROOM = 7202, FRAMES = 256 };

size_t hg_hair_batch_bytes(const hg_hair_task *task, int64_t frames, int64_t strands)
{
    const size_t floats = (size_t)(frames * (3 * (task->layout.frame_inputs + strands * 7) + task->body_vertices * 3));
    return sizeof(hg_hair_batch) + 64 + floats * sizeof(float) +
           (size_t)frames * (sizeof(int32_t) + (size_t)task->n_materials * sizeof(double)) + 6 * 64;
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
    batch->frames = frames;
    batch->strands = strands;
    batch->body_vertices = task->body_vertices;
    batch->inputs = take(&at, 3 * frames * task->layout.frame_inputs);
    batch->rotation = take(&at, 3 * frames * strands * 4);
    batch->position = take(&at, 3 * frames * strands * 3);
    batch->body = take(&at, frames * task->body_vertices * 3);
    batch->groom = (int32_t *)(void *)take(&at, frames);
    batch->material = (double *)(void *)take(&at, 2 * frames * task->n_materials);
    return batch;
}

hg_status hg_hair_batch_fill(hg_hair_task *task, hg_ctx *ctx, hg_hair_batch *batch, const hg_hair_subset *subset,
                             int64_t b, int32_t groom, const hg_hair_clip_data *clip, int64_t frame,
                             const double shape[HG_SHAPES], const double *material)
{
    const int64_t B = batch->frames, S = batch->strands;
    batch->groom[b] = groom;
    for (int i = 0; i < task->n_materials; i++) batch->material[b * task->n_materials + i] = material[i];
    const int inputs = task->layout.frame_inputs;
    for (int64_t time = 0; time < 3; time++) {
        const int64_t at = frame - 2 + time, slot = time * B + b;
        /* The last body posed is that of t, which is the one that hair touches. */
        float *body = time == 2 ? batch->body + b * task->body_vertices * 3 : task->posed_body;
        hg_profile_begin(ctx, "sample", "body");
        HG_TRY(hg_pose(ctx, task->poser, shape, clip->motion, at < 0 ? 0 : at, body, NULL, NULL));
        hg_profile_end(ctx, 12 * task->body_vertices);
        hg_profile_begin(ctx, "sample", "roots");
        HG_TRY(hg_pose_roots(ctx, task->poser, task->styles[subset->first + groom].groom, subset->strand + groom * S, S,
                             body, batch->rotation + slot * S * 4, batch->position + slot * S * 3));
        hg_profile_end(ctx, 28 * S);
        float *out = batch->inputs + slot * inputs;
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

/* Which groom each frame of a step shows; frames of one groom stand together. */
static void draw_grooms(const hg_hair_task *task, uint64_t key, uint64_t step, int64_t B, int32_t *groom)
{
    int64_t at = 0;
    int32_t drawn[FRAMES];
    for (int64_t b = 0; b < B; b++)
        drawn[b] = task->n_grooms == 1 ? 0
                                       : (int32_t)hg_random_below(key, STREAM_GROOM, step * (uint64_t)B + (uint64_t)b,
                                                                  (uint64_t)task->n_grooms);
    for (int32_t g = 0; g < task->n_grooms; g++)
        for (int64_t b = 0; b < B; b++)
            if (drawn[b] == g) groom[at++] = g;
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
    draw_grooms(task, key, step, B, groom);
    for (int64_t b = 0; b < B; b++) {
        const uint64_t counter = step * (uint64_t)B + (uint64_t)b;
        int64_t frame = (int64_t)hg_random_below(key, STREAM_FRAME, counter, (uint64_t)task->training_frames);
        int clip = 0;
        while (frame >= task->clips[0][clip].motion->frames) frame -= task->clips[0][clip++].motion->frames;
        double shape[HG_SHAPES], material[HG_HAIR_MATERIALS];
        hg_hair_draw_shape(task, key, counter, shape);
        hg_hair_draw_materials(task, key, counter, material);
        HG_TRY(hg_hair_batch_fill(task, ctx, batch, &task->subset, b, groom[b], &task->clips[0][clip], frame, shape,
                                  material));
    }
    return HG_OK;
}

/* Shapes of another stream of numbers than training's. */
void hg_hair_held_out_shape(const hg_hair_task *task, int64_t i, double shape[HG_SHAPES])
{
    hg_hair_draw_shape(task, task->seed + 0x5eed, (uint64_t)i, shape);
}
