/* solve: the energies of a config minimised on its scene, without a network: what the network is to find, and how far off
 * it is. Frame by frame; a frame that moves is the minimum of the same energies with the frames before it. */
#include "tasks/judge.h"

#include "geometry/vector.h"

#include <math.h>
#include <string.h>
#include <time.h>

typedef struct {
    hg_hair_task *task;
    hg_ctx *ctx; /* of the host */
    const hg_motion *motion;
    const double *shape;
    const hg_hair_solve_options *options;
    int64_t S, V, vertices; /* vertices: of the whole body */

    hg_hair_subset subset;
    hg_hair_numbers numbers;
    hg_physics *physics[2]; /* at rest, moving */
    hg_minimiser *minimiser[2];
    hg_physics *alone[2]; /* without what strands do to each other, where they do: the start of the others */
    hg_minimiser *minimiser_alone[2];
    hg_xpbd *xpbd;                            /* in their place */
    int n_terms[2], column[2][HG_HAIR_TERMS]; /* terms of the config */

    hg_poser *poser;
    hg_body_refit *refit;
    float *rest, *body, *rotation, *position, *posed_x, *out, *collider, *contact_point, *contact_normal;
    double *turned; /* [S,7] root rotations and positions of the frame before */
    int32_t *triangle[2];
    hg_tensor *x, *posed, *before, *older, *posed_before, *posed_older, *predicted,
        *posed_predicted; /* f64 [1,S,V,3] */
    hg_tensor *root_rotation, *root_position, *body_vertices;
    float *edges,
        *out_q; /* [S,V-1,4] frames of the rest groom; what comes out; NULL: no energy asks for orientations */
    hg_tensor *q, *posed_q; /* f64 [1,S,V-1,4] */

    double energy[2][HG_HAIR_TERMS], iterations;
    hg_hair_segments shapes;
    int64_t inside[2], measured, frames; /* of the energies: frames */
    hg_hair_solution *solution;
} solving;

static void solving_free(solving *s)
{
    hg_tensor *const tensors[] = {
        s->x,         s->posed,           s->before,        s->older,         s->posed_before,  s->posed_older,
        s->predicted, s->posed_predicted, s->root_rotation, s->root_position, s->body_vertices, s->q,
        s->posed_q
    };
    for (size_t i = 0; i < sizeof tensors / sizeof *tensors; i++) hg_tensor_destroy(tensors[i]);
    for (int k = 0; k < 2; k++) {
        hg_minimiser_destroy(s->minimiser[k]);
        hg_physics_destroy(s->physics[k]);
        hg_minimiser_destroy(s->minimiser_alone[k]);
        hg_physics_destroy(s->alone[k]);
        hg_free(s->triangle[k]);
    }
    hg_xpbd_destroy(s->xpbd);
    hg_poser_destroy(s->poser);
    hg_body_refit_destroy(s->refit);
    hg_hair_numbers_destroy(&s->numbers);
    hg_free(s->subset.strand);
    hg_free(s->subset.lengths);
    hg_free(s->subset.mass);
    float *const numbers[] = { s->rest, s->body,     s->rotation,      s->position,      s->posed_x,
                               s->out,  s->collider, s->contact_point, s->contact_normal };
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) hg_free(numbers[i]);
    hg_free(s->turned);
    hg_free(s->edges);
    hg_free(s->out_q);
}

/* ---- what is solved ------------------------------------------------------------------------------------------- */

static hg_status take_strands(solving *s)
{
    const hg_groom *groom = s->task->groom;
    const int32_t *given = s->options->strand;
    int64_t n = s->options->strands > 0 ? s->options->strands : hg_config_integer(s->task->config, "training.strands");
    if (n > groom->strands) n = groom->strands;
    for (int64_t i = 0; given && i < n; i++)
        if (given[i] < 0 || given[i] >= groom->strands)
            return hg_fail(HG_INVALID, "solve: strand %d of a groom of %lld", (int)given[i], (long long)groom->strands);
    s->S = n;
    s->V = groom->vertices;
    s->subset = (hg_hair_subset){ .first = s->task->current, .grooms = 1, .n = n };
    s->subset.strand = hg_alloc((size_t)n, sizeof *s->subset.strand);
    s->subset.lengths = hg_alloc((size_t)(n * (s->V - 1)), sizeof(double));
    s->subset.mass = hg_alloc((size_t)n, sizeof(double));
    s->rest = hg_alloc((size_t)(n * s->V) * 3, sizeof *s->rest);
    if (!s->subset.strand || !s->subset.lengths || !s->subset.mass || !s->rest) return HG_MEMORY;
    for (int64_t i = 0; i < n; i++) {
        s->subset.strand[i] = given ? given[i] : (int32_t)(i * groom->strands / n);
        memcpy(s->rest + i * s->V * 3, groom->points + s->subset.strand[i] * s->V * 3,
               (size_t)s->V * 3 * sizeof *s->rest);
    }
    return hg_hair_numbers_create(&s->numbers, &s->subset, s->task);
}

static hg_status make_xpbd(solving *s)
{
    double params[HG_HAIR_TERMS][HG_ENERGY_PARAMS];
    hg_term term[HG_HAIR_TERMS];
    int column[HG_HAIR_TERMS], n = 0;
    hg_xpbd_options options = s->options->xpbd;
    HG_TRY(hg_hair_terms_now(s->task, true, params, term, column, &n));
    options.pinned = s->options->minimise.pinned > 0 ? s->options->minimise.pinned : s->task->pinned;
    options.stop = s->options->minimise.stop, options.stop_self = s->options->minimise.stop_self;
    options.dt = 1 / s->task->rate;
    HG_TRY(hg_xpbd_create(&s->xpbd, s->ctx, term, n, &s->numbers.data, &options));
    snprintf(s->solution->left_out, sizeof s->solution->left_out, "%s", hg_xpbd_left_out(s->xpbd));
    return HG_OK;
}

/* Strands by themselves cost little, each with its own steps and end, and are near the minimum of the frame, which is one problem. */
static hg_status make_alone(solving *s, int moving, const hg_term *term, int n, const hg_minimise_options *options)
{
    hg_term own[HG_HAIR_TERMS];
    int n_own = 0;
    for (int i = 0; i < n; i++)
        if (term[i].energy->site.kind == HG_SITE_WINDOW) own[n_own++] = term[i];
    if (n_own == 0 || n_own == n) return HG_OK;
    HG_TRY(hg_physics_create(&s->alone[moving], s->ctx, HG_F64, own, n_own, &s->numbers.data));
    return hg_minimiser_create(&s->minimiser_alone[moving], s->ctx, s->alone[moving], 1, s->S, s->V, options);
}

static hg_status take_energies(solving *s)
{
    for (int moving = 0; moving < 1 + s->options->dynamic; moving++) {
        double params[HG_HAIR_TERMS][HG_ENERGY_PARAMS];
        hg_term term[HG_HAIR_TERMS];
        int n = 0;
        HG_TRY(hg_hair_terms_now(s->task, moving, params, term, s->column[moving], &n));
        s->n_terms[moving] = n;
        if (!n) return hg_fail(HG_INVALID, "solve: the config has no energy that acts on hair at rest");
        if (moving && n == s->n_terms[0])
            return hg_fail(HG_INVALID, "solve: no energy of the config knows of time; add `inertia: {}` to its losses, "
                                       "or solve without --dynamic");
        hg_minimise_options options = s->options->minimise;
        if (!options.pinned) options.pinned = s->task->pinned;
        HG_TRY(hg_physics_create(&s->physics[moving], s->ctx, HG_F64, term, n, &s->numbers.data));
        if (s->options->minimise.method != HG_XPBD)
            HG_TRY(hg_minimiser_create(&s->minimiser[moving], s->ctx, s->physics[moving], 1, s->S, s->V, &options));
        if (s->options->minimise.method == HG_LBFGS) HG_TRY(make_alone(s, moving, term, n, &options));
    }
    return s->options->minimise.method == HG_XPBD ? make_xpbd(s) : HG_OK;
}

static hg_status prepare_edges(solving *s)
{
    s->edges = hg_alloc((size_t)(s->S * (s->V - 1) * 4) + 1, sizeof *s->edges);
    s->q = hg_tensor_create(s->ctx, HG_F64, 4, (int64_t[]){ 1, s->S, s->V - 1, 4 });
    s->posed_q = hg_tensor_create(s->ctx, HG_F64, 4, (int64_t[]){ 1, s->S, s->V - 1, 4 });
    s->out_q = hg_alloc((size_t)(s->S * (s->V - 1) * 4) + 1, sizeof *s->out_q);
    if (!s->edges || !s->out_q || !s->q || !s->posed_q) return HG_MEMORY;
    for (int64_t i = 0; i < s->S; i++) hg_hair_edge_frames(s->rest + i * s->V * 3, s->V, s->edges + i * (s->V - 1) * 4);
    return HG_OK;
}

static hg_status prepare(solving *s)
{
    HG_TRY(take_strands(s));
    HG_TRY(take_energies(s));
    HG_TRY(hg_poser_create(&s->poser, s->task->body, false));
    HG_TRY(hg_body_refit_create(&s->refit, s->task->tree, HG_F32));
    const int64_t S = s->S, V = s->V, N = s->task->body_vertices;
    s->vertices = hg_poser_vertices(s->poser);
    const struct {
        float **numbers;
        int64_t count;
    } wanted[] = { { &s->body, s->vertices * 3 },    { &s->collider, N * 3 },          { &s->rotation, S * 4 },
                   { &s->position, S * 3 },          { &s->posed_x, S * V * 3 },       { &s->out, S * V * 3 },
                   { &s->contact_point, S * V * 3 }, { &s->contact_normal, S * V * 3 } };
    for (size_t i = 0; i < sizeof wanted / sizeof *wanted; i++)
        if (!(*wanted[i].numbers = hg_alloc((size_t)wanted[i].count + 1, sizeof(float)))) return HG_MEMORY;
    s->turned = hg_alloc((size_t)S * 7, sizeof(double));
    if (!s->turned) return HG_MEMORY;
    for (int k = 0; k < 2; k++) {
        s->triangle[k] = hg_alloc((size_t)(S * V), sizeof(int32_t));
        if (!s->triangle[k]) return HG_MEMORY;
        for (int64_t i = 0; i < S * V; i++) s->triangle[k][i] = -1;
    }
    hg_tensor **const tensors[] = { &s->x,           &s->posed,     &s->before,         &s->older, &s->posed_before,
                                    &s->posed_older, &s->predicted, &s->posed_predicted };
    for (size_t i = 0; i < sizeof tensors / sizeof *tensors; i++)
        if (!(*tensors[i] = hg_tensor_create(s->ctx, HG_F64, 4, (int64_t[]){ 1, S, V, 3 }))) return HG_MEMORY;
    s->root_rotation = hg_tensor_create(s->ctx, HG_F64, 3, (int64_t[]){ 1, S, 4 });
    s->root_position = hg_tensor_create(s->ctx, HG_F64, 3, (int64_t[]){ 1, S, 3 });
    s->body_vertices = hg_tensor_create(s->ctx, HG_F64, 3, (int64_t[]){ 1, N, 3 });
    if (!s->root_rotation || !s->root_position || !s->body_vertices) return HG_MEMORY;
    return s->task->asks.q ? prepare_edges(s) : HG_OK;
}

/* ---- one frame ------------------------------------------------------------------------------------------------ */

static void widen(hg_tensor *to, const float *from)
{
    double *out = to->data;
    for (int64_t i = 0; i < hg_tensor_count(to); i++) out[i] = (double)from[i];
    hg_tensor_touch(to);
}

static hg_status pose_frame(solving *s, int64_t frame)
{
    HG_TRY(hg_pose(s->ctx, s->poser, s->shape, s->motion, frame, s->body, NULL, NULL));
    HG_TRY(hg_pose_roots(s->ctx, s->poser, s->task->groom, s->subset.strand, s->S, s->body, s->rotation, s->position));
    hg_pose_strands(s->ctx, s->S, s->V, s->rest, s->rotation, s->position, s->posed_x);
    const int32_t *vertex = hg_poser_vertex(s->task->poser); /* those that the collider keeps */
    for (int64_t i = 0; i < s->task->body_vertices; i++)
        memcpy(s->collider + 3 * i, s->body + 3 * vertex[i], 3 * sizeof *s->body);
    widen(s->posed, s->posed_x);
    widen(s->root_rotation, s->rotation);
    widen(s->root_position, s->position);
    widen(s->body_vertices, s->collider);
    return hg_ctx_status(s->ctx);
}

static hg_quatd quaternion(const float *q)
{
    return hg_quatd_make((double)q[0], (double)q[1], (double)q[2], (double)q[3]);
}

/* Frames of the posed groom's edges; the solve starts from them, or from those of the frame before, turned with its root. */
static void pose_edges(solving *s, bool moving)
{
    const double *root = s->root_rotation->data;
    double *posed = s->posed_q->data, *q = s->q->data;
    for (int64_t i = 0; i < s->S; i++) {
        const hg_quatd R = hg_quatd_load(root + 4 * i);
        const hg_quatd turn = hg_quatd_mul(R, hg_quatd_conj(hg_quatd_load(s->turned + 7 * i)));
        for (int64_t v = 0; v + 1 < s->V; v++) {
            const int64_t at = (i * (s->V - 1) + v) * 4;
            hg_quatd_store(posed + at, hg_quatd_normalize(hg_quatd_mul(R, quaternion(s->edges + at))));
            if (moving && v + 1 >= s->task->pinned && v + 1 >= s->options->minimise.pinned)
                hg_quatd_store(q + at, hg_quatd_mul(turn, hg_quatd_load(q + at)));
            else
                memcpy(q + at, posed + at, 4 * sizeof *q);
        }
    }
    hg_tensor_touch(s->q);
    hg_tensor_touch(s->posed_q);
}

/* A frame that moves starts where the one before was, carried along with its root. */
static void carry(solving *s)
{
    double *x = s->x->data;
    const double *posed = s->posed->data, *q = s->root_rotation->data, *p = s->root_position->data;
    for (int64_t i = 0; i < s->S; i++) {
        const double *old = s->turned + 7 * i;
        const hg_quatd turn = hg_quatd_mul(hg_quatd_load(q + 4 * i), hg_quatd_conj(hg_quatd_load(old)));
        for (int64_t v = 0; v < s->V; v++) {
            double *at = x + (i * s->V + v) * 3;
            const hg_vec3d from_root = hg_vec3d_sub(hg_vec3d_load(at), hg_vec3d_load(old + 4));
            hg_vec3d_store(at, hg_vec3d_add(hg_quatd_rotate(turn, from_root), hg_vec3d_load(p + 3 * i)));
            if (v < s->task->pinned || v < s->options->minimise.pinned)
                memcpy(at, posed + (i * s->V + v) * 3, 3 * sizeof *at);
        }
    }
    hg_tensor_touch(s->x);
}

static void predict(hg_tensor *to, const hg_tensor *before, const hg_tensor *older)
{
    double *out = to->data;
    const double *a = before->data, *b = older->data;
    for (int64_t i = 0; i < hg_tensor_count(to); i++) out[i] = 2 * a[i] - b[i];
    hg_tensor_touch(to);
}

static hg_status measure(solving *s, int moving, const hg_frame *of_x, const hg_frame *of_posed)
{
    double terms[2][HG_HAIR_TERMS];
    HG_TRY(hg_physics_evaluate(s->physics[moving], s->ctx, of_x, s->x, terms[0], NULL, NULL));
    HG_TRY(hg_physics_evaluate(s->physics[moving], s->ctx, of_posed, s->posed, terms[1], NULL, NULL));
    for (int i = 0; i < s->n_terms[moving]; i++) {
        const int column = s->column[moving][i];
        const hg_term *term = &s->task->terms.term[column];
        const double zero = strcmp(term->energy->name, "gravity") ? 0 : terms[1][i];
        for (int k = 0; k < 2; k++) s->energy[k][column] += term->weight * (terms[k][i] - zero);
    }
    s->frames++;
    HG_TRY(hg_body_refit_update(s->ctx, s->refit, s->collider));
    for (int k = 0; k < 2; k++)
        HG_TRY(hg_hair_count_inside(s->ctx, s->refit, s->S, s->V, k ? s->posed_x : s->out, s->triangle[k],
                                    s->contact_point, s->contact_normal, &s->inside[k]));
    hg_hair_segments_add(&s->shapes, s->S, s->V, s->out, s->posed_x, s->subset.lengths);
    s->measured++;
    return HG_OK;
}

static void swap(hg_tensor **a, hg_tensor **b)
{
    hg_tensor *t = *a;
    *a = *b;
    *b = t;
}

static hg_status by_energy(solving *s, int moving, const hg_frame *frame)
{
    hg_solution found;
    hg_hair_solution *all = s->solution;
    if (s->minimiser_alone[moving]) {
        HG_TRY(hg_minimise(s->minimiser_alone[moving], frame, s->x, &found));
        all->evaluations += found.evaluations;
        all->interrupted = found.interrupted;
        if (found.interrupted) return HG_OK;
    }
    HG_TRY(hg_minimise(s->minimiser[moving], frame, s->x, &found));
    all->interrupted = found.interrupted;
    all->solves += found.strands;
    all->converged += found.converged;
    all->stalled += found.stalled;
    all->evaluations += found.evaluations;
    all->force = fmax(all->force, found.force);
    all->movement = fmax(all->movement, found.movement);
    for (int64_t k = 0; k < found.strands; k++) s->iterations += (double)found.strand[k].iterations;
    return HG_OK;
}

static hg_status by_position(solving *s, int moving, const hg_frame *frame)
{
    hg_xpbd_solution found;
    hg_hair_solution *all = s->solution;
    HG_TRY(moving ? hg_xpbd_step(s->xpbd, frame, s->x, &found) : hg_xpbd_rest(s->xpbd, frame, s->x, &found));
    all->interrupted = found.interrupted;
    all->solves += found.strands;
    s->iterations += (double)(found.strands * found.steps);
    if (s->q) HG_TRY(hg_tensor_write(s->q, found.orientation));
    if (moving) return HG_OK;
    all->converged += found.at_rest;
    all->movement = fmax(all->movement, found.movement);
    return HG_OK;
}

/* i counts the frames of the solve. */
static hg_status one_frame(solving *s, int64_t i, hg_drape_sink sink, void *self)
{
    hg_step_reset(s->ctx);
    HG_TRY(pose_frame(s, s->options->first + i));
    const int moving = s->options->dynamic && i > 0;
    if (moving && !s->xpbd)
        carry(s);
    else
        HG_TRY(hg_tensor_copy(s->x, s->posed));
    hg_frame frame = { .root_rotation = s->root_rotation,
                       .root_position = s->root_position,
                       .body_vertices = s->body_vertices,
                       .dt = 1 / s->task->rate };
    hg_frame_input inputs[2], inputs_posed[2];
    int n = 0;
    if (s->task->asks.ghost) inputs[n] = inputs_posed[n] = (hg_frame_input){ "ghost", s->posed }, n++;
    if (s->task->asks.q) {
        pose_edges(s, moving);
        inputs[n] = (hg_frame_input){ "q", s->q };
        inputs_posed[n++] = (hg_frame_input){ "q", s->posed_q };
    }
    frame.inputs = inputs, frame.n_inputs = n;
    hg_frame posed = frame;
    posed.inputs = inputs_posed;
    if (moving) {
        predict(s->predicted, s->before, s->older);
        predict(s->posed_predicted, s->posed_before, s->posed_older);
        frame.predicted = s->predicted, frame.previous = s->before;
        posed.predicted = s->posed_predicted, posed.previous = s->posed_before;
    }
    HG_TRY(s->xpbd ? by_position(s, moving, &frame) : by_energy(s, moving, &frame));
    if (s->solution->interrupted) return HG_OK;
    const double *x = s->x->data;
    for (int64_t k = 0; k < s->S * s->V * 3; k++) s->out[k] = (float)x[k];
    for (int64_t k = 0; s->q && k < s->S * (s->V - 1) * 4; k++) s->out_q[k] = (float)((const double *)s->q->data)[k];
    if (!s->options->dynamic || moving || s->options->frames == 1) HG_TRY(measure(s, moving, &frame, &posed));
    if (s->options->dynamic) {
        swap(&s->older, &s->before);
        swap(&s->posed_older, &s->posed_before);
        HG_TRY(hg_tensor_copy(s->before, s->x));
        HG_TRY(hg_tensor_copy(s->posed_before, s->posed));
        if (!moving) { /* a clip starts at rest */
            HG_TRY(hg_tensor_copy(s->older, s->x));
            HG_TRY(hg_tensor_copy(s->posed_older, s->posed));
        }
        for (int64_t k = 0; k < s->S; k++) {
            memcpy(s->turned + 7 * k, (const double *)s->root_rotation->data + 4 * k, 4 * sizeof(double));
            memcpy(s->turned + 7 * k + 4, (const double *)s->root_position->data + 3 * k, 3 * sizeof(double));
        }
    }
    return sink ? sink(self, &(hg_drape_frame){ .frame = s->options->first + i,
                                                .strands = s->S,
                                                .vertices = s->V,
                                                .strand = s->subset.strand,
                                                .x = s->out,
                                                .posed = s->posed_x,
                                                .body_vertices = s->body,
                                                .root_rotation = s->rotation,
                                                .root_position = s->position,
                                                .q = s->out_q })
                : HG_OK;
}

static void summarise(const solving *s)
{
    hg_hair_metrics *m = &s->solution->metrics;
    const hg_hair_terms *terms = &s->task->terms;
    const double strands = (double)(s->frames * s->S), edges = (double)(s->measured * s->S * (s->V - 1));
    *m = (hg_hair_metrics){
        .frames = s->measured, .strands = s->S, .tip_amplitude = (double)NAN, .tip_lag = (double)NAN
    };
    if (!s->measured) return;
    hg_hair_segments_mean(&s->shapes, m);
    m->inside = 100 * (double)s->inside[0] / edges;
    m->inside_posed = 100 * (double)s->inside[1] / edges;
    const int moving = s->options->dynamic && s->options->frames != 1;
    for (int i = 0; i < s->n_terms[moving]; i++) {
        const int column = s->column[moving][i], k = m->n_terms++;
        m->term[k] = terms->term[column].energy->name;
        m->term_energy[k] = s->energy[0][column] / strands;
        m->term_posed[k] = s->energy[1][column] / strands;
        m->energy += m->term_energy[k];
        m->energy_posed += m->term_posed[k];
        if (strcmp(m->term[k], "gravity") && strcmp(m->term[k], "body_collision")) continue;
        m->gravity_body += m->term_energy[k];
        m->gravity_body_posed += m->term_posed[k];
    }
    s->solution->iterations = s->iterations / fmax(1, (double)s->solution->solves);
}

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

hg_status hg_hair_solve(hg_hair_task *task, hg_ctx *ctx, const hg_motion *motion, const double *shape,
                        const hg_hair_solve_options *given, hg_drape_sink sink, void *self, hg_hair_solution *solution,
                        const hg_progress *progress)
{
    const double begun = now();
    *solution = (hg_hair_solution){ 0 };
    hg_motion *resampled = NULL;
    if (fabs(motion->rate - task->rate) > 1e-6 * task->rate) {
        HG_TRY(hg_motion_resample(&resampled, motion, task->rate));
        motion = resampled;
    }
    hg_hair_solve_options options = *given;
    hg_status status = HG_OK;
    if (options.first < 0 || options.first >= motion->frames || options.strands < 0)
        status = hg_fail(HG_INVALID, "solve: frame %lld of a motion of %lld, %lld strands", (long long)options.first,
                         (long long)motion->frames, (long long)options.strands);
    if (options.frames <= 0 || options.first + options.frames > motion->frames)
        options.frames = motion->frames - options.first;
    solving s = { .task = task,
                  .ctx = hg_ctx_on_host(ctx),
                  .motion = motion,
                  .shape = shape,
                  .options = &options,
                  .solution = solution };
    if (!s.ctx) status = HG_MEMORY;
    if (status == HG_OK) status = prepare(&s);
    for (int64_t i = 0; status == HG_OK && i < options.frames && !solution->interrupted; i++) {
        status = one_frame(&s, i, sink, self);
        hg_progress_report(progress, (double)(i + 1) / (double)options.frames,
                           "solving frame %lld of %lld: %lld of %lld strands at %s", (long long)(i + 1),
                           (long long)options.frames, (long long)solution->converged, (long long)solution->solves,
                           s.xpbd ? "rest" : "their minimum");
    }
    if (status == HG_OK) summarise(&s);
    solution->seconds = now() - begun;
    if (s.ctx) hg_step_reset(s.ctx);
    solving_free(&s);
    hg_motion_destroy(resampled);
    return status;
}
