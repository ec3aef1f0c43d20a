/* drape: a trained network over a whole motion, for every strand of the groom, frame by frame. A frame depends on the
 * motion up to it alone, so memory is that of one frame. */
#include "tasks/hair.h"

#include <string.h>

typedef struct {
    hg_poser *poser;
    hg_hair_track track;
    bool own_track;
    hg_hair_subset strands;
    hg_hair_part part;
    float *body, *rotation, *position, *x, *posed, *raw, *inputs, *rest_points;
} drape;

static void drape_free(drape *d)
{
    hg_poser_destroy(d->poser);
    if (d->own_track) hg_hair_track_destroy(&d->track);
    hg_hair_subset_destroy(&d->strands);
    hg_hair_part_free(&d->part);
    hg_free(d->body);
    hg_free(d->rotation);
    hg_free(d->position);
    hg_free(d->x);
    hg_free(d->posed);
    hg_free(d->raw);
    hg_free(d->inputs);
    hg_free(d->rest_points);
}

static hg_status drape_prepare(drape *d, hg_hair_task *task, hg_ctx *ctx, const hg_motion *motion, int64_t stride)
{
    const hg_groom *groom = task->groom;
    const int64_t V = groom->vertices, n = (groom->strands + stride - 1) / stride;
    d->strands = (hg_hair_subset){ .first = task->current, .grooms = 1, .n = n };
    HG_TRY(hg_poser_create(&d->poser, task->body, false));
    HG_TRY(hg_hair_track_create(&d->track, &task->layout, task->body, motion));
    d->own_track = true;
    d->strands.strand = hg_alloc((size_t)n, sizeof *d->strands.strand);
    d->body = hg_alloc((size_t)hg_poser_vertices(d->poser) * 3, sizeof(float));
    d->rotation = hg_alloc((size_t)n * 4, sizeof(float));
    d->position = hg_alloc((size_t)n * 3, sizeof(float));
    d->x = hg_alloc((size_t)(n * V) * 3, sizeof(float));
    d->posed = hg_alloc((size_t)(n * V) * 3, sizeof(float));
    d->raw = hg_alloc((size_t)task->layout.frame_inputs, sizeof(float));
    d->inputs = hg_alloc((size_t)task->layout.frame_inputs, sizeof(float));
    d->rest_points = hg_alloc((size_t)(n * V) * 3, sizeof(float));
    if (!d->strands.strand || !d->body || !d->rotation || !d->position || !d->x || !d->posed || !d->raw || !d->inputs ||
        !d->rest_points)
        return HG_MEMORY;
    for (int64_t i = 0; i < n; i++) d->strands.strand[i] = (int32_t)(i * stride);
    HG_TRY(hg_hair_subset_features(&d->strands, task));
    HG_TRY(hg_hair_part_keep(&d->part, task, ctx, &d->strands));
    return hg_tensor_read(d->strands.rest, d->rest_points);
}

static hg_status drape_frame(drape *d, hg_hair_task *task, hg_ctx *ctx, const hg_motion *motion, const double *shape,
                             int64_t frame, hg_drape_sink sink, void *self)
{
    const int64_t V = task->groom->vertices, n = d->strands.n;
    hg_step_reset(ctx);
    HG_TRY(hg_pose(ctx, d->poser, shape, motion, frame, d->body, NULL, NULL));
    HG_TRY(hg_pose_roots(ctx, d->poser, task->groom, d->strands.strand, n, d->body, d->rotation, d->position));
    hg_hair_track_frame(&task->layout, &d->track, frame, shape, d->raw);
    hg_hair_material_features(task, NULL, d->raw);
    hg_hair_normalise_frame(task, d->raw, d->inputs);
    HG_TRY(hg_hair_predict_frame(task, ctx, &d->part, d->inputs, d->strands.rest, d->rotation, d->position, d->x));
    hg_pose_strands(ctx, n, V, d->rest_points, d->rotation, d->position, d->posed);
    return sink(self, &(hg_drape_frame){ .frame = frame,
                                         .strands = n,
                                         .vertices = V,
                                         .strand = d->strands.strand,
                                         .x = d->x,
                                         .posed = d->posed,
                                         .body_vertices = d->body,
                                         .root_rotation = d->rotation,
                                         .root_position = d->position });
}

hg_status hg_hair_drape(hg_hair_task *task, hg_ctx *ctx, const hg_motion *motion, const double *shape, int64_t first,
                        int64_t frames, int64_t stride, hg_drape_sink sink, void *self, const hg_progress *progress)
{
    if (stride < 1) return hg_fail(HG_INVALID, "drape: a stride of %lld strands; at least 1", (long long)stride);
    hg_motion *resampled = NULL;
    if (motion->rate < task->rate * (1 - 1e-6) || motion->rate > task->rate * (1 + 1e-6)) {
        HG_TRY(hg_motion_resample(&resampled, motion, task->rate));
        motion = resampled;
    }
    drape d = { 0 };
    hg_status status = HG_OK;
    if (first < 0 || first >= motion->frames)
        status =
            hg_fail(HG_INVALID, "drape: frame %lld of a motion of %lld", (long long)first, (long long)motion->frames);
    else if (frames <= 0 || first + frames > motion->frames)
        frames = motion->frames - first;
    if (status == HG_OK) status = drape_prepare(&d, task, ctx, motion, stride);
    for (int64_t i = 0; status == HG_OK && i < frames; i++) {
        status = drape_frame(&d, task, ctx, motion, shape, first + i, sink, self);
        hg_progress_report(progress, (double)(i + 1) / (double)frames, "draping frame %lld of %lld", (long long)(i + 1),
                           (long long)frames);
    }
    hg_step_reset(ctx);
    drape_free(&d);
    hg_motion_destroy(resampled);
    return status;
}
