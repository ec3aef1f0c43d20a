/* metrics: a trained network judged on a motion, frame by frame, against the rigidly posed groom.
 *
 * Energies are those of training, per strand, with gravity counted from the posed groom: then the zero does not depend
 * on where the body stands. The strands are drawn over the whole scalp, not those of training. Tip lag is the shift at
 * which the tips' motion about the head is most like that of the rigidly posed tips. */
#include "tasks/hair.h"

#include "geometry/vector.h"

#include <math.h>
#include <string.h>

enum { TIPS = 256, LAGS = 16 };
static const double deep = 1e-4;  /* m: deeper is inside */
static const double still = 0.02; /* m/s: slower posed tips say nothing of lag */

typedef struct {
    hg_tensor *now, *before, *older; /* [1,S,V,3] */
    float *x;                        /* now, on the host */
    hg_tensor *q;                    /* of the step, see hg_hair_strands */
    hg_tensor *mean;
    int32_t *triangle; /* [S V] guesses of the closest face */
    double energy[HG_HAIR_TERMS];
    int64_t inside, vertices;
    float *tips; /* [T,tips,3] motion about the head from frame to frame */
} side;

typedef struct {
    hg_hair_task *task;
    hg_ctx *ctx;
    const hg_motion *motion;
    const double *shape;
    int64_t frames, tips;
    hg_hair_track track;
    hg_hair_part part;
    hg_ctx *host; /* for what is measured of the strands here */
    hg_body_refit *refit;
    float *rest, *rotation, *position, *body; /* [S,V,3], [S,4], [S,3], [N,3] */
    float *joint_position, *joint_rotation, *raw, *inputs, *contact_point, *contact_normal;
    hg_frame at;      /* of the step */
    double *last_tip; /* [2,tips,3] about the head, in head space, and in the world */
    side net, posed;
    hg_hair_segments shapes;
    double tip_squares;
    int64_t tip_count;
} evaluation;

static void side_free(side *s)
{
    hg_tensor_destroy(s->now);
    hg_tensor_destroy(s->before);
    hg_tensor_destroy(s->older);
    hg_tensor_destroy(s->mean);
    hg_free(s->x);
    hg_free(s->triangle);
    hg_free(s->tips);
}

static void evaluation_free(evaluation *e)
{
    side_free(&e->net);
    side_free(&e->posed);
    hg_hair_track_destroy(&e->track);
    hg_hair_part_free(&e->part);
    hg_body_refit_destroy(e->refit);
    hg_free(e->rest);
    hg_free(e->rotation);
    hg_free(e->position);
    hg_free(e->body);
    hg_free(e->joint_position);
    hg_free(e->joint_rotation);
    hg_free(e->raw);
    hg_free(e->inputs);
    hg_free(e->contact_point);
    hg_free(e->contact_normal);
    hg_free(e->last_tip);
}

static hg_status side_create(side *s, evaluation *e, int64_t S, int64_t V)
{
    const int64_t shape[4] = { 1, S, V, 3 };
    s->now = hg_tensor_create(e->ctx, HG_F32, 4, shape);
    s->before = hg_tensor_create(e->ctx, HG_F32, 4, shape);
    s->older = hg_tensor_create(e->ctx, HG_F32, 4, shape);
    s->x = hg_alloc((size_t)(S * V) * 3, sizeof *s->x);
    s->triangle = hg_alloc((size_t)(S * V), sizeof *s->triangle);
    s->tips = hg_alloc((size_t)(e->frames * e->tips) * 3, sizeof(float));
    if (!s->now || !s->before || !s->older || !s->x || !s->triangle || !s->tips) return HG_MEMORY;
    for (int64_t i = 0; i < S * V; i++) s->triangle[i] = -1;
    return HG_OK;
}

static hg_status prepare(evaluation *e)
{
    hg_hair_task *task = e->task;
    HG_TRY(hg_hair_evaluation_subset(task));
    const int64_t S = task->evaluation.n, V = task->groom->vertices, joints = task->body->joints;
    e->tips = S < TIPS ? S : TIPS;
    HG_TRY(hg_hair_track_create(&e->track, &task->layout, task->body, e->motion));
    HG_TRY(side_create(&e->net, e, S, V));
    HG_TRY(side_create(&e->posed, e, S, V));
    e->host = hg_ctx_on_host(e->ctx);
    e->rest = hg_alloc((size_t)(S * V) * 3, sizeof(float));
    e->rotation = hg_alloc((size_t)S * 4, sizeof(float));
    e->position = hg_alloc((size_t)S * 3, sizeof(float));
    e->body = hg_alloc((size_t)task->body_vertices * 3, sizeof(float));
    e->joint_position = hg_alloc((size_t)joints * 3, sizeof(float));
    e->joint_rotation = hg_alloc((size_t)joints * 4, sizeof(float));
    e->raw = hg_alloc((size_t)task->layout.frame_inputs, sizeof(float));
    e->inputs = hg_alloc((size_t)task->layout.frame_inputs, sizeof(float));
    e->contact_point = hg_alloc((size_t)(S * V) * 3, sizeof(float));
    e->contact_normal = hg_alloc((size_t)(S * V) * 3, sizeof(float));
    e->last_tip = hg_alloc((size_t)e->tips * 9, sizeof(double));
    if (!e->host || !e->rest || !e->rotation || !e->position || !e->body || !e->joint_position || !e->joint_rotation ||
        !e->raw || !e->inputs || !e->contact_point || !e->contact_normal || !e->last_tip)
        return HG_MEMORY;
    HG_TRY(hg_tensor_read(task->evaluation.rest, e->rest));
    HG_TRY(hg_body_refit_create(&e->refit, task->tree, HG_F32));
    return hg_hair_part_keep(&e->part, task, e->ctx, &task->evaluation);
}

/* ---- one frame ---------------------------------------------------------------------------------------------- */

static hg_status strands_of(evaluation *e, int64_t frame)
{
    hg_hair_task *task = e->task;
    const hg_hair_subset *subset = &task->evaluation;
    const int64_t S = subset->n, V = task->groom->vertices;
    HG_TRY(hg_pose(e->ctx, task->poser, e->shape, e->motion, frame, e->body, e->joint_position, e->joint_rotation));
    HG_TRY(hg_pose_roots(e->ctx, task->poser, task->groom, subset->strand, S, e->body, e->rotation, e->position));
    hg_hair_track_frame(&task->layout, &e->track, frame, e->shape, e->raw);
    hg_hair_material_features(task, NULL, e->raw);
    hg_hair_normalise_frame(task, e->raw, e->inputs);
    e->at = (hg_frame){ .root_rotation = hg_tensor_from(e->ctx, HG_F32, 3, (int64_t[]){ 1, S, 4 }, e->rotation),
                        .root_position = hg_tensor_from(e->ctx, HG_F32, 3, (int64_t[]){ 1, S, 3 }, e->position),
                        .body_vertices =
                            hg_tensor_from(e->ctx, HG_F32, 3, (int64_t[]){ 1, task->body_vertices, 3 }, e->body),
                        .dt = 1 / task->rate };
    hg_no_grad_begin(e->ctx);
    const hg_tensor *x =
        hg_hair_predict_edges(task, e->ctx, &e->part, NULL,
                              hg_tensor_from(e->ctx, HG_F32, 2, (int64_t[]){ 1, task->layout.frame_inputs }, e->inputs),
                              subset->rest, e->at.root_rotation, e->at.root_position, &e->net.q);
    hg_no_grad_end(e->ctx);
    HG_TRY(hg_ctx_status(e->ctx));
    HG_TRY(hg_tensor_copy(e->net.now, x));
    HG_TRY(hg_tensor_read(x, e->net.x));
    hg_pose_strands(e->ctx, S, V, e->rest, e->rotation, e->position, e->posed.x);
    return hg_tensor_write(e->posed.now, e->posed.x);
}

/* The mean deformation of the network's strands over the run of frames that begins here: a clip is cut into runs as long as
 * those of training, the last one as long as is left. */
static hg_status mean_of_run(evaluation *e, int64_t first)
{
    const int64_t n = e->task->consecutive, last = first + n < e->frames ? first + n : e->frames,
                  numbers = hg_tensor_count(e->net.now);
    if (!e->net.mean) e->net.mean = hg_tensor_create(e->ctx, HG_F32, 4, e->net.now->shape);
    double *sum = hg_alloc((size_t)numbers, sizeof *sum);
    float *mean = hg_alloc((size_t)numbers, sizeof *mean);
    hg_status status = e->net.mean && sum && mean ? HG_OK : HG_MEMORY;
    for (int64_t frame = first; status == HG_OK && frame < last; frame++) {
        hg_step_reset(e->ctx);
        status = strands_of(e, frame);
        for (int64_t i = 0; i < numbers; i++) sum[i] += (double)e->net.x[i] - (double)e->posed.x[i];
    }
    for (int64_t i = 0; status == HG_OK && i < numbers; i++) mean[i] = (float)(sum[i] / (double)(last - first));
    if (status == HG_OK) status = hg_tensor_write(e->net.mean, mean);
    hg_free(sum);
    hg_free(mean);
    return status;
}

static hg_status energies(evaluation *e, side *s, double *terms)
{
    hg_frame frame = e->at;
    frame.previous = s->before;
    hg_no_grad_begin(e->ctx);
    frame.predicted = hg_sub(e->ctx, hg_scale(e->ctx, s->before, 2, 0), s->older);
    hg_no_grad_end(e->ctx);
    if (!frame.predicted) return hg_ctx_status(e->ctx);
    const hg_hair_strands strands = { .x = s->now, .q = s->q, .mean = s->mean };
    HG_TRY(hg_hair_physics_inputs(e->task, e->ctx, &e->task->evaluation, NULL, &strands, &frame));
    return hg_physics_evaluate(e->task->evaluation.physics, e->ctx, &frame, s->now, terms, NULL, NULL);
}

hg_status hg_hair_count_inside(hg_ctx *host, hg_body_refit *refit, int64_t S, int64_t V, const float *x,
                               int32_t *triangle, float *contact_point, float *contact_normal, int64_t *inside)
{
    HG_TRY(hg_body_closest(host, refit, HG_CONTACT_EXACT, 5e-3, S * V, x, triangle, contact_point, contact_normal));
    for (int64_t i = 0; i < S * V; i++) {
        if (i % V == 0) continue;
        const float *a = contact_point + 3 * i, *n = contact_normal + 3 * i;
        double distance = 0;
        for (int k = 0; k < 3; k++) distance += (double)n[k] * ((double)x[3 * i + k] - (double)a[k]);
        *inside += distance < -deep;
    }
    return HG_OK;
}

static hg_status count_inside(evaluation *e, side *s)
{
    const int64_t S = e->task->evaluation.n, V = e->task->groom->vertices;
    s->vertices += S * (V - 1);
    return hg_hair_count_inside(e->host, e->refit, S, V, s->x, s->triangle, e->contact_point, e->contact_normal,
                                &s->inside);
}

static hg_vec3d point(const float *x) { return hg_vec3d_make((double)x[0], (double)x[1], (double)x[2]); }

static void measure_tips(evaluation *e, int64_t frame)
{
    const int64_t S = e->task->evaluation.n, V = e->task->groom->vertices;
    const int head = e->task->layout.head;
    const hg_vec3d centre = point(e->joint_position + 3 * head);
    const float *q = e->joint_rotation + 4 * head;
    const hg_quatd unturn = hg_quatd_conj(hg_quatd_make((double)q[0], (double)q[1], (double)q[2], (double)q[3]));
    for (int64_t i = 0; i < e->tips; i++) {
        const int64_t at = ((i * S / e->tips) * V + V - 1) * 3;
        const hg_vec3d net = hg_vec3d_sub(point(e->net.x + at), centre);
        const hg_vec3d posed = hg_vec3d_sub(point(e->posed.x + at), centre);
        const hg_vec3d seen = hg_quatd_rotate(unturn, net);
        double *last = e->last_tip + 9 * i;
        if (frame > 0) {
            const hg_vec3d moved[2] = { hg_vec3d_sub(net, hg_vec3d_load(last)),
                                        hg_vec3d_sub(posed, hg_vec3d_load(last + 3)) };
            for (int k = 0; k < 2; k++) {
                float *out = (k ? e->posed.tips : e->net.tips) + (frame * e->tips + i) * 3;
                out[0] = (float)moved[k].x, out[1] = (float)moved[k].y, out[2] = (float)moved[k].z;
            }
            e->tip_squares += hg_vec3d_norm2(hg_vec3d_sub(seen, hg_vec3d_load(last + 6)));
            e->tip_count++;
        }
        hg_vec3d_store(last, net);
        hg_vec3d_store(last + 3, posed);
        hg_vec3d_store(last + 6, seen);
    }
}

static void turn_over(side *s)
{
    hg_tensor *oldest = s->older;
    s->older = s->before;
    s->before = s->now;
    s->now = oldest;
}

static hg_status one_frame(evaluation *e, int64_t frame)
{
    hg_hair_task *task = e->task;
    if (task->asks.deformation && task->consecutive > 1 && frame % task->consecutive == 0)
        HG_TRY(mean_of_run(e, frame));
    hg_step_reset(e->ctx);
    HG_TRY(strands_of(e, frame));
    side *const sides[2] = { &e->net, &e->posed };
    for (int k = 0; frame == 0 && k < 2; k++) { /* a clip starts at rest */
        HG_TRY(hg_tensor_copy(sides[k]->before, sides[k]->now));
        HG_TRY(hg_tensor_copy(sides[k]->older, sides[k]->now));
    }
    double terms[2][HG_HAIR_TERMS] = { { 0 }, { 0 } };
    HG_TRY(hg_body_refit_update(e->host, e->refit, e->body));
    for (int k = 0; k < 2; k++) {
        HG_TRY(energies(e, sides[k], terms[k]));
        HG_TRY(count_inside(e, sides[k]));
    }
    for (int i = 0; i < task->terms.n; i++) {
        const bool gravity = !strcmp(task->terms.term[i].energy->name, "gravity");
        e->net.energy[i] += terms[0][i] - (gravity ? terms[1][i] : 0);
        e->posed.energy[i] += gravity ? 0 : terms[1][i];
    }
    hg_hair_segments_add(&e->shapes, task->evaluation.n, task->groom->vertices, e->net.x, e->posed.x,
                         task->evaluation.lengths);
    measure_tips(e, frame);
    turn_over(&e->net);
    turn_over(&e->posed);
    return HG_OK;
}

/* ---- sums --------------------------------------------------------------------------------------------------- */

static double correlation(const evaluation *e, int lag)
{
    const int64_t row = e->tips * 3;
    double both = 0, net = 0, posed = 0;
    const int64_t first = lag > 0 ? 1 + lag : 1, last = lag < 0 ? e->frames + lag : e->frames;
    for (int64_t t = first; t < last; t++)
        for (int64_t i = 0; i < row; i++) {
            const double a = (double)e->net.tips[t * row + i], b = (double)e->posed.tips[(t - lag) * row + i];
            both += a * b;
            net += a * a;
            posed += b * b;
        }
    return net > 0 && posed > 0 ? both / sqrt(net * posed) : 0;
}

/* Seconds, to a fraction of a frame by a parabola through the largest correlation and its neighbours. */
static double tip_lag(const evaluation *e)
{
    double squares = 0;
    for (int64_t i = 0; i < e->frames * e->tips * 3; i++)
        squares += (double)e->posed.tips[i] * (double)e->posed.tips[i];
    const double count = (double)((e->frames - 1) * e->tips);
    if (e->frames < 8 || !(sqrt(squares / count) * e->task->rate > still)) return (double)NAN;
    const int lags = e->frames / 3 < LAGS ? (int)(e->frames / 3) : LAGS;
    double value[LAGS + 2]; /* of lags -1 .. : a peak at 0 has two sides too, and lags are often less than a frame */
    int best = 1;
    for (int i = 0; i <= lags + 1; i++) {
        value[i] = correlation(e, i - 1);
        if (value[i] > value[best]) best = i;
    }
    double offset = 0;
    if (best > 0 && best <= lags) {
        const double bend = value[best - 1] - 2 * value[best] + value[best + 1];
        if (bend < 0) offset = 0.5 * (value[best - 1] - value[best + 1]) / bend;
    }
    return (best - 1 + offset) / e->task->rate;
}

static void summarise(const evaluation *e, hg_hair_metrics *metrics)
{
    const hg_hair_task *task = e->task;
    const double per_strand = 1 / (double)(e->frames * task->evaluation.n);
    *metrics = (hg_hair_metrics){ .frames = e->frames, .strands = task->evaluation.n };
    hg_hair_segments_mean(&e->shapes, metrics);
    metrics->inside = 100 * (double)e->net.inside / (double)e->net.vertices;
    metrics->inside_posed = 100 * (double)e->posed.inside / (double)e->posed.vertices;
    metrics->n_terms = task->terms.n;
    for (int i = 0; i < task->terms.n; i++) {
        const char *name = task->terms.term[i].energy->name;
        const double weight = task->terms.term[i].weight;
        metrics->term[i] = name;
        metrics->term_energy[i] = weight * e->net.energy[i] * per_strand;
        metrics->term_posed[i] = weight * e->posed.energy[i] * per_strand;
        metrics->energy += metrics->term_energy[i];
        metrics->energy_posed += metrics->term_posed[i];
        if (strcmp(name, "gravity") && strcmp(name, "body_collision")) continue;
        metrics->gravity_body += metrics->term_energy[i];
        metrics->gravity_body_posed += metrics->term_posed[i];
    }
    metrics->tip_amplitude = e->tip_count ? sqrt(e->tip_squares / (double)e->tip_count) * task->rate : 0;
    metrics->tip_lag = tip_lag(e);
}

hg_status hg_hair_evaluate(hg_hair_task *task, hg_ctx *ctx, const hg_motion *motion, const double *shape,
                           int64_t frames, hg_hair_metrics *metrics, const hg_progress *progress)
{
    hg_motion *resampled = NULL;
    if (fabs(motion->rate - task->rate) > 1e-6 * task->rate) {
        HG_TRY(hg_motion_resample(&resampled, motion, task->rate));
        motion = resampled;
    }
    evaluation e = { .task = task, .ctx = ctx, .motion = motion, .shape = shape };
    e.frames = frames > 0 && frames < motion->frames ? frames : motion->frames;
    hg_status status = prepare(&e);
    for (int64_t t = 0; status == HG_OK && t < e.frames; t++) {
        status = one_frame(&e, t);
        hg_progress_report(progress, (double)(t + 1) / (double)e.frames, "%s: frame %lld of %lld",
                           motion->name ? motion->name : "motion", (long long)(t + 1), (long long)e.frames);
    }
    if (status == HG_OK) summarise(&e, metrics);
    hg_step_reset(ctx);
    evaluation_free(&e);
    hg_motion_destroy(resampled);
    return status;
}
