/* against: a network beside solvers on the same strands, poses and motion.
 *
 * Everybody drapes first and is written down; then all are judged alike, by the same physics. Two questions are asked. At rest: single
 * frames of the clip as if the body had always stood so, against the minimum of the energies that do not know of other frames; this
 * is well defined for any network. In motion: consecutive frames against the solution that steps through time, which has a few
 * frames to come from rest into the motion. */
#include "tasks/judge.h"

#include "geometry/vector.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { TIPS = 2, LAGS = 10, TIMED = 16 };
static const double still = 0.02; /* m/s: slower tips say nothing of a lag */
/* A frame that is one problem crawls for the last digits, which no gap shows: 1e-5 of a descent of 100 nJ is 1 pJ. */
static const double coupled_enough = 1e-5;

/* What is there in every frame, and where each side put the strands. */
typedef struct {
    int64_t frames;
    bool known;
    float *posed, *rotation, *position, *collider; /* [T,S,V,3], [T,S,4], [T,S,3], [T,N,3] */
    float *x[HG_AGAINST_SIDES];                    /* [T,S,V,3]; of the posed groom: posed */
    float *q[HG_AGAINST_SIDES];                    /* [T,S,V-1,4] orientations; NULL: the posed groom's */
} scene;

typedef struct {
    hg_hair_task *task;
    hg_ctx *ctx;
    const hg_motion *motion;
    const double *shape;
    hg_against_options options;
    hg_against *out;
    const hg_progress *progress;
    double done, share; /* of the progress line: what is behind, what is under way */
    int64_t stride, S, V, N;
    bool coupled; /* strands act on each other */
    int32_t *strand;
    scene rest, moving;
    hg_motion *held; /* the poses, as a motion */
    hg_hair_judge judge;
    double *seen;        /* [sides,T,S,3] tips from their roots */
    double *ranked;      /* distances, excursions: sorted */
    double *above;       /* [2,sides,T,S] J above the reference; without contact */
    double *least, *own; /* [2,S] of the reference and of a side in a frame, the same two ways */
} comparison;

static void scene_free(scene *s, int sides)
{
    float *const there[] = { s->posed, s->rotation, s->position, s->collider };
    for (size_t i = 0; i < sizeof there / sizeof *there; i++) hg_free(there[i]);
    for (int k = 0; k + 1 < sides; k++) hg_free(s->x[k]), hg_free(s->q[k]);
}

static void comparison_free(comparison *c)
{
    scene_free(&c->rest, c->out->n_sides);
    scene_free(&c->moving, c->out->n_sides);
    hg_hair_judge_free(&c->judge);
    hg_motion_destroy(c->held);
    hg_free(c->strand);
    hg_free(c->seen);
    hg_free(c->ranked);
    hg_free(c->above);
    hg_free(c->least);
    hg_free(c->own);
}

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

/* ---- progress: a part of the line is passed on ------------------------------------------------------------------- */

static void pass_on(void *self, double fraction, const char *text)
{
    const comparison *c = self;
    hg_progress_report(c->progress, c->done + c->share * fraction, "%s: %s",
                       c->motion->name ? c->motion->name : "motion", text);
}

static void under_way(comparison *c, double share)
{
    c->done += c->share;
    c->share = share;
}

/* ---- writing down ------------------------------------------------------------------------------------------------ */

static hg_status scene_create(scene *s, const comparison *c, int64_t frames)
{
    const size_t T = (size_t)frames, S = (size_t)c->S, row = S * (size_t)c->V * 3;
    s->frames = frames;
    s->posed = hg_alloc(T * row, sizeof(float));
    s->rotation = hg_alloc(T * S * 4, sizeof(float));
    s->position = hg_alloc(T * S * 3, sizeof(float));
    s->collider = hg_alloc(T * (size_t)c->N * 3 + 1, sizeof(float));
    bool room = s->posed && s->rotation && s->position && s->collider;
    const int posed = c->out->n_sides - 1;
    for (int k = 0; k < posed; k++) room = (s->x[k] = hg_alloc(T * row, sizeof(float))) && room;
    s->x[posed] = s->posed;
    return room ? HG_OK : HG_MEMORY;
}

typedef struct {
    comparison *c;
    scene *scene;
    int side;
    int64_t first, at; /* frame that is row `at` of the scene */
    int64_t most;      /* rows; what comes before and after is not kept */
    double left;       /* when the last frame was written, 0: none was */
    double seconds;
    int64_t timed;
} writing;

/* The first frame of all says which strands there are. */
static hg_status take_strands(comparison *c, const hg_drape_frame *frame)
{
    c->S = frame->strands;
    c->strand = hg_alloc((size_t)c->S + 1, sizeof *c->strand);
    if (!c->strand) return HG_MEMORY;
    if (c->S < 1 || frame->vertices != c->V)
        return hg_fail(HG_INVALID, "against: a drape of %lld strands of %lld vertices; the groom's have %lld",
                       (long long)c->S, (long long)frame->vertices, (long long)c->V);
    memcpy(c->strand, frame->strand, (size_t)c->S * sizeof *c->strand);
    return scene_create(&c->rest, c, c->options.poses);
}

static const float *edges_of(const comparison *c, const scene *s, int side, int64_t t)
{
    return s->q[side] ? s->q[side] + t * c->S * (c->V - 1) * 4 : NULL;
}

static hg_status keep_edges(const comparison *c, scene *s, int side, int64_t t, const float *q)
{
    const int64_t row = c->S * (c->V - 1) * 4;
    if (!s->q[side]) s->q[side] = hg_alloc((size_t)(s->frames * row) + 1, sizeof(float));
    if (!s->q[side]) return HG_MEMORY;
    memcpy(s->q[side] + t * row, q, (size_t)row * sizeof(float));
    return HG_OK;
}

static hg_status write_down(void *self, const hg_drape_frame *frame)
{
    writing *w = self;
    comparison *c = w->c;
    scene *s = w->scene;
    if (w->left > 0) w->seconds += now() - w->left, w->timed++;
    if (!c->strand) HG_TRY(take_strands(c, frame));
    if (frame->strands != c->S || memcmp(frame->strand, c->strand, (size_t)c->S * sizeof *c->strand))
        return hg_fail(HG_INVALID, "against: the sides drape different strands");
    const int64_t t = frame->frame - w->first + w->at, row = c->S * c->V * 3;
    if (frame->frame >= w->first && frame->frame - w->first < w->most) {
        memcpy(s->x[w->side] + t * row, frame->x, (size_t)row * sizeof(float));
        if (frame->q) HG_TRY(keep_edges(c, s, w->side, t, frame->q));
        if (!s->known) {
            const int32_t *vertex = hg_poser_vertex(c->task->poser); /* those that the collider keeps */
            memcpy(s->posed + t * row, frame->posed, (size_t)row * sizeof(float));
            memcpy(s->rotation + t * c->S * 4, frame->root_rotation, (size_t)c->S * 4 * sizeof(float));
            memcpy(s->position + t * c->S * 3, frame->root_position, (size_t)c->S * 3 * sizeof(float));
            for (int64_t i = 0; i < c->N; i++)
                memcpy(s->collider + (t * c->N + i) * 3, frame->body_vertices + 3 * vertex[i], 3 * sizeof(float));
        }
    }
    w->left = now();
    return HG_OK;
}

/* ---- who drapes -------------------------------------------------------------------------------------------------- */

static hg_status network(void *self, const hg_motion *motion, const double *shape, int64_t first, int64_t frames,
                         int64_t stride, hg_drape_sink sink, void *to)
{
    const comparison *c = self;
    return hg_hair_drape(c->task, c->ctx, motion, shape, first, frames, stride, sink, to, NULL);
}

static hg_status solve(comparison *c, int side, const hg_motion *motion, bool dynamic, int64_t before, writing *w,
                       hg_against_part *part)
{
    const hg_progress within = { c, pass_on };
    hg_hair_solve_options how = c->options.solver[side - 1].how;
    hg_hair_solution solution;
    how.dynamic = dynamic;
    if (!(how.minimise.enough > 0) && c->coupled) how.minimise.enough = coupled_enough;
    how.first = w->first - before;
    how.frames = before + w->most;
    how.strands = c->S;
    how.strand = c->strand;
    HG_TRY(hg_hair_solve(c->task, c->ctx, motion, c->shape, &how, write_down, w, &solution, &within));
    if (solution.interrupted) return hg_fail(HG_INVALID, "against: interrupted");
    part->seconds = solution.seconds / (double)how.frames;
    part->solves = solution.solves;
    part->converged = solution.converged;
    part->stalled = solution.stalled;
    return HG_OK;
}

/* Frames of the clip as a motion of their own. */
static hg_status frames_of(hg_motion **out, const comparison *c, int64_t n, const int64_t *frame)
{
    const hg_motion *from = c->motion;
    HG_TRY(hg_motion_create(out, n, c->task->body, from->rate));
    for (int64_t i = 0; i < n; i++) {
        memcpy((*out)->rotation + i * from->joints * 4, from->rotation + frame[i] * from->joints * 4,
               (size_t)from->joints * 4 * sizeof(float));
        memcpy((*out)->translation + i * 3, from->translation + frame[i] * 3, 3 * sizeof(float));
    }
    return HG_OK;
}

/* Each pose is a clip of one frame, so that whoever drapes knows of no movement. */
static hg_status drape_poses(comparison *c)
{
    const int64_t poses = c->options.poses;
    int64_t *frame = hg_alloc((size_t)poses, sizeof *frame);
    if (!frame) return HG_MEMORY;
    for (int64_t i = 0; i < poses; i++) frame[i] = (2 * i + 1) * c->motion->frames / (2 * poses);
    hg_status status = frames_of(&c->held, c, poses, frame);
    for (int64_t i = 0; status == HG_OK && i < poses; i++) {
        hg_motion *one = NULL;
        writing w = { .c = c, .scene = &c->rest, .at = i, .most = 1 };
        status = frames_of(&one, c, 1, frame + i);
        if (status == HG_OK) status = c->options.drape(c->options.self, one, c->shape, 0, 1, c->stride, write_down, &w);
        hg_motion_destroy(one);
    }
    hg_free(frame);
    if (status == HG_OK && !c->strand) status = hg_fail(HG_INVALID, "against: the drape of a pose brought no frame");
    c->rest.known = true;
    return status;
}

static hg_status drop_frame(void *self, const hg_drape_frame *frame)
{
    writing *w = self;
    (void)frame;
    if (w->left > 0) w->seconds += now() - w->left, w->timed++;
    w->left = now();
    return HG_OK;
}

/* A frame of a drape that goes on; what is made once per drape does not count. */
static hg_status time_drape(comparison *c)
{
    writing w = { .c = c };
    const int64_t frames = c->motion->frames < TIMED ? c->motion->frames : TIMED;
    HG_TRY(c->options.drape(c->options.self, c->motion, c->shape, 0, frames, c->stride, drop_frame, &w));
    c->out->side[0].rest.seconds = c->out->side[0].motion.seconds = w.timed ? w.seconds / (double)w.timed : (double)NAN;
    return HG_OK;
}

/* First of so many consecutive frames in which the head turns and goes most; a tenth of a metre counts as a radian. */
static hg_status liveliest(comparison *c, int64_t frames, int64_t *first)
{
    const int joints = (int)c->task->body->joints, head = c->task->layout.head;
    double *rotation = hg_alloc((size_t)joints * 4, sizeof *rotation),
           *position = hg_alloc((size_t)joints * 3, sizeof *position);
    double *way = hg_alloc((size_t)c->motion->frames, sizeof *way); /* up to a frame */
    hg_quatd turned = { 0 };
    hg_vec3d gone = { 0 };
    double most = -1;
    for (int64_t t = 0; rotation && position && way && t < c->motion->frames; t++) {
        hg_hair_joints(c->task->body, c->motion, t, rotation, position);
        const hg_quatd q = hg_quatd_load(rotation + 4 * head), turn = hg_quatd_mul(q, hg_quatd_conj(turned));
        const hg_vec3d p = hg_vec3d_load(position + 3 * head);
        const double angle = 2 * atan2(sqrt(turn.x * turn.x + turn.y * turn.y + turn.z * turn.z), fabs(turn.w));
        way[t] = t ? way[t - 1] + angle + hg_vec3d_norm(hg_vec3d_sub(p, gone)) / 0.1 : 0;
        turned = q, gone = p;
        const int64_t begin = t - frames + 1;
        if (begin >= 0 && way[t] - way[begin] > most * (1 + 1e-9)) most = way[t] - way[begin], *first = begin;
    }
    const hg_status status = rotation && position && way ? HG_OK : HG_MEMORY;
    hg_free(rotation);
    hg_free(position);
    hg_free(way);
    return status;
}

static hg_status drape_motion(comparison *c)
{
    const int64_t frames = c->options.frames;
    int64_t first = 0;
    HG_TRY(liveliest(c, frames, &first));
    HG_TRY(scene_create(&c->moving, c, frames));
    c->out->frames = frames;
    c->out->first = first;
    const int64_t before = first < c->options.settle ? first : c->options.settle;
    writing w = { .c = c, .scene = &c->moving, .first = first, .most = frames };
    HG_TRY(c->options.drape(c->options.self, c->motion, c->shape, first, frames, c->stride, write_down, &w));
    c->moving.known = true;
    for (int k = 1; k + 1 < c->out->n_sides; k++) {
        under_way(c, 0.7 / c->options.n_solvers);
        w = (writing){ .c = c, .scene = &c->moving, .side = k, .first = first, .most = frames };
        HG_TRY(solve(c, k, c->motion, true, before, &w, &c->out->side[k].motion));
    }
    return HG_OK;
}

/* ---- judging ----------------------------------------------------------------------------------------------------- */

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void distances(const comparison *c, const scene *s, int side, hg_against_part *part)
{
    const float *x = s->x[side], *y = s->x[c->out->reference];
    const int64_t rows = s->frames * c->S;
    int64_t n = 0;
    double sum = 0;
    for (int64_t i = 0; i < rows; i++)
        for (int64_t v = c->task->pinned; v < c->V; v++) {
            const int64_t at = (i * c->V + v) * 3;
            double square = 0;
            for (int k = 0; k < 3; k++) square += pow((double)x[at + k] - (double)y[at + k], 2);
            sum += c->ranked[n++] = sqrt(square);
        }
    if (!n) return;
    qsort(c->ranked, (size_t)n, sizeof *c->ranked, ascending);
    part->distance = sum / (double)n;
    part->distance_p95 = c->ranked[(n * 95) / 100];
}

static double median(double *numbers, int64_t n)
{
    qsort(numbers, (size_t)n, sizeof *numbers, ascending);
    return 0.5 * (numbers[(n - 1) / 2] + numbers[n / 2]);
}

static double *above_of(const comparison *c, const scene *s, bool free, int side, int64_t t)
{
    return c->above + ((free * c->out->n_sides + side) * s->frames + t) * c->S;
}

/* Energies of one frame t of a side: its own, and above the reference's in the energy of the reference's past. */
static hg_status frame_energies(comparison *c, const scene *s, bool moving, int64_t t, int side, hg_against_part *part,
                                const double *posed, const double *least)
{
    const int64_t row = c->S * c->V * 3;
    const float *x = s->x[side] + t * row, *y = s->x[c->out->reference] + t * row;
    const float *q = edges_of(c, s, side, t);
    double own[HG_HAIR_TERMS] = { 0 }, there[HG_HAIR_TERMS] = { 0 };
    HG_TRY(hg_hair_judge_energies(&c->judge, x, q, moving ? x - row : NULL, moving ? x - 2 * row : NULL, own, c->own));
    if (moving)
        HG_TRY(hg_hair_judge_energies(&c->judge, x, q, y - row, y - 2 * row, there, c->own));
    else
        memcpy(there, own, sizeof own);
    for (int free = 0; free < 2; free++)
        for (int64_t i = 0; i < c->S; i++)
            above_of(c, s, free, side, t)[i] = c->own[free * c->S + i] - c->least[free * c->S + i];
    for (int i = 0; i < c->out->n_terms; i++) {
        const bool gravity = !strcmp(c->out->term[i], "gravity");
        part->term_energy[i] += own[i] - (gravity ? posed[i] : 0);
        part->excess += there[i] - least[i];
        if (!c->task->terms.term[i].energy->contact) part->excess_free += there[i] - least[i];
    }
    return HG_OK;
}

static hg_status judge_scene(comparison *c, const scene *s, bool moving)
{
    const int sides = c->out->n_sides, reference = c->out->reference;
    const int64_t row = c->S * c->V * 3;
    int64_t frames = 0, inside[HG_AGAINST_SIDES] = { 0 };
    hg_hair_segments shapes[HG_AGAINST_SIDES] = { { 0 } };
    hg_against_part *part[HG_AGAINST_SIDES];
    for (int k = 0; k < sides; k++) part[k] = moving ? &c->out->side[k].motion : &c->out->side[k].rest;
    for (int64_t t = 0; t < s->frames; t++) {
        HG_TRY(hg_hair_judge_frame(&c->judge, s->rotation + t * c->S * 4, s->position + t * c->S * 3,
                                   s->posed + t * row, s->collider + t * c->N * 3));
        const bool whole = !moving || t >= 2; /* its past is known */
        const float *y = s->x[reference] + t * row;
        double posed[HG_HAIR_TERMS] = { 0 }, least[HG_HAIR_TERMS] = { 0 };
        if (whole) {
            HG_TRY(hg_hair_judge_energies(&c->judge, s->posed + t * row, NULL, NULL, NULL, posed, NULL));
            HG_TRY(hg_hair_judge_energies(&c->judge, y, edges_of(c, s, reference, t), moving ? y - row : NULL,
                                          moving ? y - 2 * row : NULL, least, c->least));
            frames++;
        }
        for (int k = 0; k < sides; k++) {
            const float *x = s->x[k] + t * row;
            if (whole) HG_TRY(frame_energies(c, s, moving, t, k, part[k], posed, least));
            HG_TRY(hg_hair_judge_inside(&c->judge, x, &inside[k]));
            hg_hair_segments_add(&shapes[k], c->S, c->V, x, s->posed + t * row, c->judge.subset.lengths);
        }
    }
    for (int k = 0; k < sides; k++) {
        hg_hair_metrics metrics = { 0 };
        const double per_strand = 1 / (double)(frames * c->S);
        hg_hair_segments_mean(&shapes[k], &metrics);
        part[k]->length_error = metrics.length_error;
        part[k]->orientation = metrics.orientation;
        part[k]->curl = metrics.curl;
        part[k]->inside = 100 * (double)inside[k] / (double)(s->frames * c->S * (c->V - 1));
        part[k]->excess *= per_strand;
        part[k]->excess_free *= per_strand;
        for (int i = 0; i < c->out->n_terms; i++) part[k]->energy += part[k]->term_energy[i] *= per_strand;
        distances(c, s, k, part[k]);
        part[k]->excess_median = median(above_of(c, s, false, k, s->frames - frames), frames * c->S);
        part[k]->excess_free_median = median(above_of(c, s, true, k, s->frames - frames), frames * c->S);
    }
    return HG_OK;
}

void hg_hair_against_gaps(hg_against *a)
{
    const hg_against_side *posed = &a->side[a->n_sides - 1];
    for (int k = 0; k < a->n_sides; k++)
        for (int m = 0; m < 2; m++) {
            hg_against_part *part = m ? &a->side[k].motion : &a->side[k].rest;
            const hg_against_part *whole = m ? &posed->motion : &posed->rest;
            const double free = whole->excess_free > 0 ? whole->excess_free : (double)NAN;
            part->gap = part == whole ? free / free : part->excess / free;
            part->gap_median = (part == whole ? part->excess_free_median : part->excess_median) /
                               (whole->excess_free_median > 0 ? whole->excess_free_median : (double)NAN);
            part->gap_free = part->excess_free / free;
            part->gap_contact = whole->excess > 0 ? part->excess / whole->excess : (double)NAN;
        }
}

/* ---- tips -------------------------------------------------------------------------------------------------------- */

static double *seen_of(const comparison *c, int side, int64_t t)
{
    return c->seen + (side * c->moving.frames + t) * c->S * 3;
}

static void see_tips(const comparison *c)
{
    const scene *s = &c->moving;
    for (int k = 0; k < c->out->n_sides; k++)
        for (int64_t t = 0; t < s->frames; t++)
            for (int64_t i = 0; i < c->S; i++) {
                const float *q = s->rotation + (t * c->S + i) * 4;
                const int64_t at = ((t * c->S + i + 1) * c->V - 1) * 3;
                const hg_quatd unturn =
                    hg_quatd_conj(hg_quatd_make((double)q[0], (double)q[1], (double)q[2], (double)q[3]));
                const float *x = s->x[k] + at, *posed = s->posed + at;
                const hg_vec3d off = hg_vec3d_make((double)x[0] - (double)posed[0], (double)x[1] - (double)posed[1],
                                                   (double)x[2] - (double)posed[2]);
                hg_vec3d_store(seen_of(c, k, t) + 3 * i, hg_quatd_rotate(unturn, off));
            }
}

/* Mean over frames of the 3 S numbers of a side. */
static void mean_place(const comparison *c, int side, double *mean)
{
    memset(mean, 0, (size_t)(c->S * 3) * sizeof *mean);
    for (int64_t t = 0; t < c->moving.frames; t++)
        for (int64_t i = 0; i < c->S * 3; i++) mean[i] += seen_of(c, side, t)[i] / (double)c->moving.frames;
}

/* Of tip velocities, the side's `lag` frames later than the reference's. */
static double follows(const comparison *c, int side, int64_t lag)
{
    const int64_t row = c->S * 3, last = lag > 0 ? c->moving.frames : c->moving.frames + lag;
    double both = 0, a2 = 0, b2 = 0;
    for (int64_t t = lag > 0 ? 1 + lag : 1; t < last; t++) {
        const double *x = seen_of(c, side, t), *y = seen_of(c, c->out->reference, t - lag);
        for (int64_t i = 0; i < row; i++) {
            const double a = x[i] - x[i - row], b = y[i] - y[i - row];
            both += a * b;
            a2 += a * a;
            b2 += b * b;
        }
    }
    return a2 > 0 && b2 > 0 ? both / sqrt(a2 * b2) : 0;
}

/* To a fraction of a frame by a parabola through the largest and its neighbours. */
static double lag_of(const comparison *c, int side)
{
    const hg_against_side *s = c->out->side;
    if (c->moving.frames < 8 || !(s[side].tips.speed > still) || !(s[c->out->reference].tips.speed > still))
        return (double)NAN;
    const int most = c->moving.frames / 3 < LAGS ? (int)(c->moving.frames / 3) : LAGS;
    double value[2 * LAGS + 1];
    int best = most;
    for (int i = 0; i <= 2 * most; i++) value[i] = follows(c, side, i - most);
    for (int i = 0; i <= 2 * most; i++)
        if (value[i] > value[best]) best = i;
    double offset = 0;
    if (best > 0 && best < 2 * most) {
        const double bend = value[best - 1] - 2 * value[best] + value[best + 1];
        if (bend < 0) offset = 0.5 * (value[best - 1] - value[best + 1]) / bend;
    }
    return (best - most + offset) / c->task->rate;
}

static void judge_tips(const comparison *c, double *mean /* [2,S,3] scratch */)
{
    const int64_t row = c->S * 3, T = c->moving.frames;
    double *const own = mean, *const other = mean + row;
    mean_place(c, c->out->reference, other);
    for (int k = 0; k < c->out->n_sides; k++) {
        hg_against_tips *tips = &c->out->side[k].tips;
        double speed = 0, a2 = 0, b2 = 0, both = 0;
        mean_place(c, k, own);
        for (int64_t t = 0; t < T; t++) {
            const double *x = seen_of(c, k, t), *y = seen_of(c, c->out->reference, t);
            for (int64_t i = 0; i < row; i++) {
                const double a = x[i] - own[i], b = y[i] - other[i], step = t ? x[i] - x[i - row] : 0;
                speed += step * step;
                a2 += a * a;
                b2 += b * b;
                both += a * b;
            }
        }
        tips->speed = sqrt(speed / (double)((T - 1) * c->S)) * c->task->rate;
        tips->excursion = sqrt(a2 / (double)(T * c->S));
        tips->correlation = a2 > 0 && b2 > 0 ? both / sqrt(a2 * b2) : 0;
    }
    for (int k = 0; k < c->out->n_sides; k++) c->out->side[k].tips.lag = lag_of(c, k);
}

/* The widest way of a tip by power iteration on the products of its deviations. */
static hg_vec3d widest(const comparison *c, int64_t strand, const double *mean)
{
    double m[9] = { 0 }, d[3] = { 0.6, 0.5, 0.7 };
    for (int64_t t = 0; t < c->moving.frames; t++) {
        const double *x = seen_of(c, c->out->reference, t) + 3 * strand;
        for (int i = 0; i < 9; i++)
            m[i] += (x[i / 3] - mean[3 * strand + i / 3]) * (x[i % 3] - mean[3 * strand + i % 3]);
    }
    for (int round = 0; round < 50; round++) {
        double next[3], norm = 0;
        for (int i = 0; i < 3; i++) next[i] = m[3 * i] * d[0] + m[3 * i + 1] * d[1] + m[3 * i + 2] * d[2];
        for (int i = 0; i < 3; i++) norm += next[i] * next[i];
        if (!(norm > 0)) break;
        for (int i = 0; i < 3; i++) d[i] = next[i] / sqrt(norm);
    }
    return hg_vec3d_make(d[0], d[1], d[2]);
}

/* One that swings more than nine of ten, and one in the middle. */
static hg_status keep_tips(const comparison *c, const double *mean)
{
    static const double rank[TIPS] = { 0.9, 0.5 };
    const int64_t T = c->moving.frames;
    double *swing = c->ranked, *sorted = c->ranked + c->S;
    for (int64_t i = 0; i < c->S; i++) {
        swing[i] = 0;
        for (int64_t t = 0; t < T; t++)
            for (int k = 0; k < 3; k++)
                swing[i] += pow(seen_of(c, c->out->reference, t)[3 * i + k] - mean[3 * i + k], 2);
    }
    memcpy(sorted, swing, (size_t)c->S * sizeof *sorted);
    qsort(sorted, (size_t)c->S, sizeof *sorted, ascending);
    c->out->tip = hg_alloc((size_t)(TIPS * c->out->n_sides * T), sizeof *c->out->tip);
    if (!c->out->tip) return HG_MEMORY;
    c->out->n_tips = TIPS;
    for (int n = 0; n < TIPS; n++) {
        int64_t strand = 0;
        while (swing[strand] != sorted[(int64_t)(rank[n] * (double)(c->S - 1))]) strand++;
        const hg_vec3d along = widest(c, strand, mean);
        for (int k = 0; k < c->out->n_sides; k++)
            for (int64_t t = 0; t < T; t++)
                c->out->tip[(n * c->out->n_sides + k) * T + t] =
                    hg_vec3d_dot(hg_vec3d_load(seen_of(c, k, t) + 3 * strand), along);
    }
    return HG_OK;
}

static hg_status compare_tips(comparison *c)
{
    const size_t row = (size_t)c->S * 3;
    c->seen = hg_alloc((size_t)(c->out->n_sides * c->moving.frames) * row, sizeof *c->seen);
    double *mean = hg_alloc(2 * row, sizeof *mean);
    hg_status status = c->seen && mean ? HG_OK : HG_MEMORY;
    if (status == HG_OK) {
        see_tips(c);
        judge_tips(c, mean);
        status = keep_tips(c, mean + row);
    }
    hg_free(mean);
    return status;
}

/* ---- all of it --------------------------------------------------------------------------------------------------- */

static hg_status take_options(comparison *c, const hg_against_options *given)
{
    hg_against_options *o = &c->options;
    hg_against *a = c->out;
    *o = *given;
    if (o->n_solvers < 1 || o->n_solvers > HG_AGAINST_SIDES - 2)
        return hg_fail(HG_INVALID, "against: %d solvers; from 1 to %d", o->n_solvers, HG_AGAINST_SIDES - 2);
    if (o->poses < 0 || o->frames < 0 || o->settle < 0 || o->strands < 0)
        return hg_fail(HG_INVALID, "against: poses, frames and strands are whole numbers, 0 for the default");
    if (!o->poses) o->poses = 6;
    if (!o->frames) o->frames = 45;
    if (!o->strands) o->strands = 200;
    if (!o->settle) o->settle = (int64_t)(0.5 * c->task->rate + 0.5);
    if (o->poses > c->motion->frames) o->poses = c->motion->frames;
    if (o->frames > c->motion->frames) o->frames = c->motion->frames;
    if (!o->drape) o->drape = network, o->self = c;
    c->V = c->task->groom->vertices;
    c->N = c->task->body_vertices;
    c->stride = (c->task->groom->strands + o->strands - 1) / o->strands;
    a->rate = c->task->rate;
    a->poses = o->poses;
    a->n_terms = c->task->terms.n;
    for (int i = 0; i < a->n_terms; i++) {
        a->term[i] = c->task->terms.term[i].energy->name;
        c->coupled |= c->task->terms.term[i].energy->site.kind != HG_SITE_WINDOW;
    }
    a->n_sides = o->n_solvers + 2;
    a->reference = 1;
    for (int k = o->n_solvers; k > 0; k--)
        if (o->solver[k - 1].how.minimise.method == HG_LBFGS) a->reference = k;
    a->side[0].name = "network";
    for (int k = 0; k < o->n_solvers; k++) a->side[k + 1].name = o->solver[k].name;
    a->side[a->n_sides - 1].name = "posed groom";
    for (int k = 0; k < a->n_sides; k++) a->side[k].rest.seconds = a->side[k].motion.seconds = (double)NAN;
    return HG_OK;
}

static hg_status compare(comparison *c)
{
    hg_against *a = c->out;
    bool dynamic;
    HG_TRY(hg_hair_is_dynamic(c->task, &dynamic));
    dynamic = dynamic && c->options.frames > 2;
    HG_TRY(drape_poses(c));
    a->strands = c->S;
    HG_TRY(time_drape(c));
    for (int k = 1; k + 1 < a->n_sides; k++) {
        writing w = { .c = c, .scene = &c->rest, .side = k, .most = c->options.poses };
        under_way(c, (dynamic ? 0.25 : 0.9) / c->options.n_solvers);
        HG_TRY(solve(c, k, c->held, false, 0, &w, &a->side[k].rest));
    }
    if (dynamic) HG_TRY(drape_motion(c));
    under_way(c, 0.05);
    HG_TRY(hg_hair_judge_create(&c->judge, c->task, c->ctx, c->strand, c->S));
    for (int i = 0; i < a->n_terms; i++) {
        a->term_moves[i] = true;
        for (int k = 0; k < c->judge.n_terms[0]; k++) a->term_moves[i] &= c->judge.column[0][k] != i;
    }
    const int64_t most = c->options.poses > a->frames ? c->options.poses : a->frames;
    c->ranked = hg_alloc((size_t)(most * c->S * c->V + 2 * c->S), sizeof *c->ranked);
    c->above = hg_alloc((size_t)(2 * a->n_sides * most * c->S), sizeof *c->above);
    c->least = hg_alloc((size_t)c->S * 2, sizeof *c->least);
    c->own = hg_alloc((size_t)c->S * 2, sizeof *c->own);
    if (!c->ranked || !c->above || !c->least || !c->own) return HG_MEMORY;
    HG_TRY(judge_scene(c, &c->rest, false));
    if (dynamic) HG_TRY(judge_scene(c, &c->moving, true));
    if (dynamic) HG_TRY(compare_tips(c));
    hg_hair_against_gaps(a);
    return HG_OK;
}

void hg_hair_against_free(hg_against *against)
{
    hg_free(against->tip);
    *against = (hg_against){ 0 };
}

hg_status hg_hair_against(hg_hair_task *task, hg_ctx *ctx, const hg_motion *motion, const double *shape,
                          const hg_against_options *options, hg_against *against, const hg_progress *progress)
{
    hg_motion *resampled = NULL;
    *against = (hg_against){ 0 };
    if (fabs(motion->rate - task->rate) > 1e-6 * task->rate) {
        HG_TRY(hg_motion_resample(&resampled, motion, task->rate));
        motion = resampled;
    }
    comparison c = { .task = task, .ctx = ctx, .motion = motion, .shape = shape, .out = against, .progress = progress };
    hg_status status = take_options(&c, options);
    if (status == HG_OK) status = compare(&c);
    hg_step_reset(ctx);
    comparison_free(&c);
    hg_motion_destroy(resampled);
    if (status != HG_OK) hg_hair_against_free(against);
    return status;
}
