/* drape: a trained network over pairs of a groom and a pose, for every strand of the groom; a whole motion is the pairs of one
 * groom with its frames. What belongs to a groom or a motion is made once. The network sees some pairs at once, as many as fit
 * into a bound; the rest is made pair by pair, so that memory does not grow with their number. */
#include "tasks/hair.h"

#include <string.h>

enum { TOGETHER_BYTES = 256 << 20, TOGETHER_MOST = 256 };

typedef struct {
    int style;
    hg_hair_subset strands;
    hg_hair_part part;
    float *rest; /* [n,V,3] */
} drape_groom;

typedef struct {
    const hg_motion *given, *motion; /* motion: at the task's rate */
    hg_motion *resampled;
    hg_hair_track track;
} drape_clip;

typedef struct {
    int32_t groom, clip; /* of those of the drape */
} drape_of;

typedef struct {
    hg_hair_task *task;
    hg_ctx *ctx;
    hg_drape_pairs_options options;
    int64_t n, together, most_strands;
    const hg_drape_pair *pairs;
    drape_of *of; /* [n] */
    drape_groom *grooms;
    drape_clip *clips;
    int n_grooms, n_clips;
    hg_hair_part all; /* rows of all grooms, where they go through the network at once */
    hg_poser *poser;
    int32_t *row_groom; /* [together] */
    float *inputs;      /* [together,frame_inputs] */
    float *raw, *body, *rotation, *position, *x, *posed;
    float *q; /* [n,V-1,4]; NULL: the network predicts no orientations, or no energy asks for them */
    const char *what;
} drape;

static const double neutral[HG_SHAPES];

static void drape_free(drape *d)
{
    for (int g = 0; g < d->n_grooms; g++) {
        hg_hair_subset_destroy(&d->grooms[g].strands);
        hg_hair_part_free(&d->grooms[g].part);
        hg_free(d->grooms[g].rest);
    }
    for (int c = 0; c < d->n_clips; c++) {
        hg_motion_destroy(d->clips[c].resampled);
        hg_hair_track_destroy(&d->clips[c].track);
    }
    hg_hair_part_free(&d->all);
    hg_poser_destroy(d->poser);
    hg_free(d->of);
    hg_free(d->grooms);
    hg_free(d->clips);
    hg_free(d->row_groom);
    hg_free(d->inputs);
    hg_free(d->raw);
    hg_free(d->body);
    hg_free(d->rotation);
    hg_free(d->position);
    hg_free(d->x);
    hg_free(d->posed);
    hg_free(d->q);
}

/* ---- what there is of each -----------------------------------------------------------------------------------*/

static hg_status add_groom(drape *d, int style, int32_t *number)
{
    for (*number = 0; *number < d->n_grooms; ++*number)
        if (d->grooms[*number].style == style) return HG_OK;
    drape_groom *g = &d->grooms[d->n_grooms++];
    const hg_groom *groom = d->task->styles[style].groom;
    const int64_t n = (groom->strands + d->options.stride - 1) / d->options.stride;
    g->style = style;
    g->strands = (hg_hair_subset){ .first = style, .grooms = 1, .n = n };
    g->strands.strand = hg_alloc((size_t)n, sizeof *g->strands.strand);
    g->rest = hg_alloc((size_t)(n * groom->vertices) * 3, sizeof *g->rest);
    if (!g->strands.strand || !g->rest) return HG_MEMORY;
    for (int64_t i = 0; i < n; i++) g->strands.strand[i] = (int32_t)(i * d->options.stride);
    if (n > d->most_strands) d->most_strands = n;
    HG_TRY(hg_hair_subset_features(&g->strands, d->task));
    HG_TRY(hg_hair_part_keep(&g->part, d->task, d->ctx, &g->strands));
    return hg_tensor_read(g->strands.rest, g->rest);
}

static hg_status add_clip(drape *d, const hg_motion *motion, int32_t *number)
{
    for (*number = 0; *number < d->n_clips; ++*number)
        if (d->clips[*number].given == motion) return HG_OK;
    drape_clip *c = &d->clips[d->n_clips++];
    const double rate = d->task->rate;
    c->given = c->motion = motion;
    if (motion->rate < rate * (1 - 1e-6) || motion->rate > rate * (1 + 1e-6)) {
        HG_TRY(hg_motion_resample(&c->resampled, motion, rate));
        c->motion = c->resampled;
    }
    return hg_hair_track_create(&c->track, &d->task->layout, d->task->body, c->motion);
}

static hg_status add_pair(drape *d, int64_t i)
{
    const hg_drape_pair *pair = &d->pairs[i];
    if (pair->groom < 0 || pair->groom >= d->task->n_styles || !pair->motion)
        return hg_fail(HG_INVALID, "drape: %s %lld: groom %d of %d%s", d->what, (long long)i, pair->groom,
                       d->task->n_styles, pair->motion ? "" : ", and no motion");
    HG_TRY(add_groom(d, pair->groom, &d->of[i].groom));
    HG_TRY(add_clip(d, pair->motion, &d->of[i].clip));
    const int64_t frames = d->clips[d->of[i].clip].motion->frames;
    if (pair->frame >= 0 && pair->frame < frames) return HG_OK;
    return hg_fail(HG_INVALID, "drape: %s %lld: frame %lld of a motion of %lld", d->what, (long long)i,
                   (long long)pair->frame, (long long)frames);
}

/* How many different ones there can be. */
static int most_of(int64_t n, int most) { return n < most ? (int)n : most; }

static int motions_of(const drape *d)
{
    int motions = 0;
    for (int64_t i = 0; i < d->n; i++) /* runs of one motion: an upper bound, near in what is asked for */
        if (i == 0 || d->pairs[i].motion != d->pairs[i - 1].motion) motions++;
    return motions;
}

/* ---- pairs at once ------------------------------------------------------------------------------------------- */

/* Rows of all grooms stand together where they belong to grooms. */
static hg_status gather_rows(drape *d)
{
    if (!d->task->network->images) return HG_OK;
    const int64_t width = d->grooms[0].part.rows->shape[1];
    float *rows = hg_alloc((size_t)(d->n_grooms * width), sizeof *rows);
    hg_status status = rows ? HG_OK : HG_MEMORY;
    for (int g = 0; status == HG_OK && g < d->n_grooms; g++)
        status = hg_tensor_read(d->grooms[g].part.rows, rows + g * width);
    d->all = (hg_hair_part){ .grooms = d->n_grooms };
    if (status == HG_OK) {
        d->all.rows = hg_tensor_create(d->ctx, HG_F32, 2, (int64_t[]){ d->n_grooms, width });
        status = d->all.rows ? hg_tensor_write(d->all.rows, rows) : HG_MEMORY;
    }
    hg_free(rows);
    return status;
}

static hg_tensor *images_of(drape *d, int64_t rows)
{
    hg_no_grad_begin(d->ctx);
    hg_tensor *images =
        hg_hair_images(d->task, d->ctx, &d->all, d->row_groom,
                       hg_tensor_from(d->ctx, HG_F32, 2, (int64_t[]){ rows, d->task->layout.frame_inputs }, d->inputs));
    hg_no_grad_end(d->ctx);
    return images;
}

/* By what one takes of the step's memory; then all turns see as many. */
static hg_status choose_together(drape *d)
{
    if (!d->task->network->images) {
        d->together = 1;
        return HG_OK;
    }
    d->together = d->options.together;
    if (d->together < 1) {
        hg_step_reset(d->ctx);
        const size_t before = hg_step_bytes(d->ctx);
        images_of(d, 1);
        HG_TRY(hg_ctx_status(d->ctx));
        const size_t one = hg_step_bytes(d->ctx) - before;
        hg_step_reset(d->ctx);
        d->together = one ? (int64_t)(TOGETHER_BYTES / one) : TOGETHER_MOST;
        if (d->together > TOGETHER_MOST) d->together = TOGETHER_MOST;
        if (d->together < 1) d->together = 1;
    }
    if (d->together > d->n) d->together = d->n;
    const int64_t turns = (d->n + d->together - 1) / d->together;
    d->together = (d->n + turns - 1) / turns;
    return HG_OK;
}

static hg_status prepare(drape *d)
{
    const hg_hair_task *task = d->task;
    const int64_t V = task->groom->vertices, F = task->layout.frame_inputs;
    d->of = hg_alloc((size_t)d->n, sizeof *d->of);
    d->grooms = hg_alloc((size_t)most_of(d->n, task->n_styles), sizeof *d->grooms);
    d->clips = hg_alloc((size_t)motions_of(d), sizeof *d->clips);
    if (!d->of || !d->grooms || !d->clips) return HG_MEMORY;
    for (int64_t i = 0; i < d->n; i++) HG_TRY(add_pair(d, i));
    HG_TRY(gather_rows(d));
    HG_TRY(hg_poser_create(&d->poser, task->body, !d->options.bodies));
    const int64_t most = d->options.together > TOGETHER_MOST ? d->options.together : most_of(d->n, TOGETHER_MOST);
    d->row_groom = hg_alloc((size_t)most, sizeof *d->row_groom);
    d->inputs = hg_alloc((size_t)(most * F), sizeof *d->inputs);
    d->raw = hg_alloc((size_t)F, sizeof *d->raw);
    d->body = hg_alloc((size_t)hg_poser_vertices(d->poser) * 3, sizeof *d->body);
    d->rotation = hg_alloc((size_t)d->most_strands * 4, sizeof *d->rotation);
    d->position = hg_alloc((size_t)d->most_strands * 3, sizeof *d->position);
    d->x = hg_alloc((size_t)(d->most_strands * V) * 3, sizeof *d->x);
    if (d->options.posed) d->posed = hg_alloc((size_t)(d->most_strands * V) * 3, sizeof *d->posed);
    const bool edges = task->orientations && task->asks.q;
    if (edges) d->q = hg_alloc((size_t)(d->most_strands * (V - 1)) * 4, sizeof *d->q);
    if (!d->row_groom || !d->inputs || !d->raw || !d->body || !d->rotation || !d->position || !d->x ||
        (d->options.posed && !d->posed) || (edges && !d->q))
        return HG_MEMORY;
    return choose_together(d);
}

/* ---- turns ------------------------------------------------------------------------------------------------- */

static void fill_row(drape *d, int64_t row, int64_t i)
{
    const hg_drape_pair *pair = &d->pairs[i];
    const hg_hair_task *task = d->task;
    d->row_groom[row] = d->of[i].groom;
    hg_hair_track_frame(&task->layout, &d->clips[d->of[i].clip].track, pair->frame, pair->shape ? pair->shape : neutral,
                        d->raw);
    hg_hair_material_features(task, NULL, d->raw);
    hg_hair_normalise_frame(task, d->raw, d->inputs + row * task->layout.frame_inputs);
}

static hg_status drape_pair(drape *d, hg_tensor *images, int64_t row, int64_t i, hg_drape_pairs_sink sink, void *self)
{
    const hg_drape_pair *pair = &d->pairs[i];
    const drape_groom *g = &d->grooms[d->of[i].groom];
    const hg_groom *groom = d->task->styles[g->style].groom;
    const int64_t n = g->strands.n, V = groom->vertices;
    HG_TRY(hg_pose(d->ctx, d->poser, pair->shape, d->clips[d->of[i].clip].motion, pair->frame, d->body, NULL, NULL));
    HG_TRY(hg_pose_roots(d->ctx, d->poser, groom, g->strands.strand, n, d->body, d->rotation, d->position));
    HG_TRY(hg_hair_predict_row(d->task, d->ctx, &g->part, images, row, g->strands.rest, d->rotation, d->position, d->x,
                               d->q));
    if (d->posed) hg_pose_strands(d->ctx, n, V, g->rest, d->rotation, d->position, d->posed);
    return sink(self, i,
                &(hg_drape_frame){ .frame = pair->frame,
                                   .strands = n,
                                   .vertices = V,
                                   .strand = g->strands.strand,
                                   .x = d->x,
                                   .posed = d->posed,
                                   .body_vertices = d->options.bodies ? d->body : NULL,
                                   .root_rotation = d->rotation,
                                   .root_position = d->position,
                                   .q = d->q });
}

/* The last turn may have fewer: its last pair fills it up, so that every turn is of the same size. */
static hg_status take_turns(drape *d, hg_drape_pairs_sink sink, void *self, const hg_progress *progress)
{
    for (int64_t first = 0; first < d->n; first += d->together) {
        const int64_t last = d->n - 1;
        for (int64_t row = 0; row < d->together; row++) fill_row(d, row, first + row < last ? first + row : last);
        hg_step_reset(d->ctx);
        hg_tensor *images = images_of(d, d->together);
        HG_TRY(hg_ctx_status(d->ctx));
        const hg_step_mark mark = hg_step_set_mark(d->ctx);
        for (int64_t row = 0; row < d->together && first + row <= last; row++) {
            HG_TRY(drape_pair(d, images, row, first + row, sink, self));
            hg_step_rewind(d->ctx, mark);
            hg_progress_report(progress, (double)(first + row + 1) / (double)d->n, "draping %s %lld of %lld", d->what,
                               (long long)(first + row + 1), (long long)d->n);
        }
    }
    return HG_OK;
}

static hg_status run(drape *d, hg_drape_pairs_sink sink, void *self, const hg_progress *progress)
{
    hg_status status = prepare(d);
    if (status == HG_OK) status = take_turns(d, sink, self, progress);
    hg_step_reset(d->ctx);
    drape_free(d);
    return status;
}

hg_status hg_hair_drape_pairs(hg_hair_task *task, hg_ctx *ctx, int64_t n, const hg_drape_pair *pairs,
                              const hg_drape_pairs_options *options, hg_drape_pairs_sink sink, void *self,
                              const hg_progress *progress)
{
    drape d = { .task = task, .ctx = ctx, .n = n, .pairs = pairs, .what = "pair" };
    if (options) d.options = *options;
    if (n < 1) return hg_fail(HG_INVALID, "drape: %lld pairs of a groom and a pose; at least 1", (long long)n);
    if (d.options.stride < 0)
        return hg_fail(HG_INVALID, "drape: a stride of %lld strands; at least 1", (long long)d.options.stride);
    if (d.options.stride == 0) d.options.stride = 1;
    return run(&d, sink, self, progress);
}

/* ---- a motion ------------------------------------------------------------------------------------------------ */

typedef struct {
    hg_drape_sink sink;
    void *self;
} frame_sink;

static hg_status pass_on(void *self, int64_t pair, const hg_drape_frame *frame)
{
    const frame_sink *to = self;
    (void)pair;
    return to->sink(to->self, frame);
}

static hg_status drape_motion(hg_hair_task *task, hg_ctx *ctx, const hg_motion *motion, const double *shape,
                              int64_t first, int64_t frames, int64_t stride, frame_sink *sink,
                              const hg_progress *progress)
{
    if (first < 0 || first >= motion->frames)
        return hg_fail(HG_INVALID, "drape: frame %lld of a motion of %lld", (long long)first,
                       (long long)motion->frames);
    if (frames <= 0 || first + frames > motion->frames) frames = motion->frames - first;
    hg_drape_pair *pairs = hg_alloc((size_t)frames, sizeof *pairs);
    if (!pairs) return HG_MEMORY;
    for (int64_t i = 0; i < frames; i++) pairs[i] = (hg_drape_pair){ task->current, motion, first + i, shape };
    drape d = { .task = task,
                .ctx = ctx,
                .n = frames,
                .pairs = pairs,
                .options = { .stride = stride, .bodies = true, .posed = true },
                .what = "frame" };
    const hg_status status = run(&d, pass_on, sink, progress);
    hg_free(pairs);
    return status;
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
    const hg_status status =
        drape_motion(task, ctx, motion, shape, first, frames, stride, &(frame_sink){ sink, self }, progress);
    hg_motion_destroy(resampled);
    return status;
}
