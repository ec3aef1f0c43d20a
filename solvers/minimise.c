/* minimise: minima of a physics over the vertices of strands. What the methods share: memory, evaluation, results. */
#include "solvers/minimise.h"

#include <math.h>
#include <string.h>

enum { INPUTS = 24 }; /* of a frame */

void hg_minimiser_destroy(hg_minimiser *m)
{
    if (!m) return;
    hg_tensor_destroy(m->trial);
    hg_tensor_destroy(m->gradient);
    hg_tensor_destroy(m->orientation);
    hg_tensor_destroy(m->torque);
    hg_free(m->inputs);
    double *const numbers[] = { m->term_energy, m->x, m->g,    m->next_g,  m->d,      m->scratch,
                                m->slope,       m->r, m->edge, m->hessian, m->factor, m->part };
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) hg_free(numbers[i]);
    for (int k = 0; k < HG_MINIMISE_MEMORY; k++) {
        hg_free(m->s[k]);
        hg_free(m->y[k]);
    }
    hg_free(m->definite);
    hg_free(m->problem);
    hg_free(m->result);
    hg_free(m);
}

static void defaults(hg_minimise_options *o)
{
    if (o->pinned <= 0) o->pinned = 1;
    if (o->evaluations <= 0) o->evaluations = o->method == HG_ADAM ? 2000 : 6000;
    if (!(o->movement > 0)) o->movement = 1e-8;
    if (!(o->rate > 0)) o->rate = 2e-5;
}

static hg_status take_memory(hg_minimiser *m)
{
    const size_t strands = (size_t)m->strands, n = (size_t)m->n, all = strands * n + 1;
    const int64_t shape[4] = { m->B, m->S, m->V, 3 };
    m->trial = hg_tensor_create(m->ctx, HG_F64, 4, shape);
    m->gradient = hg_tensor_create(m->ctx, HG_F64, 4, shape);
    m->term_energy = hg_alloc(strands * (size_t)m->terms + 1, sizeof(double));
    double **const numbers[] = { &m->x, &m->g, &m->next_g, &m->d, &m->scratch, &m->r, &m->slope };
    bool all_there = m->trial && m->gradient && m->term_energy;
    if (m->width > 3) {
        const int64_t edges[4] = { m->B, m->S, m->V - 1, 4 };
        m->orientation = hg_tensor_create(m->ctx, HG_F64, 4, edges);
        m->torque = hg_tensor_create(m->ctx, HG_F64, 4, edges);
        m->inputs = hg_alloc(INPUTS, sizeof *m->inputs);
        if (!m->orientation || !m->torque || !m->inputs) return HG_MEMORY;
        HG_TRY(hg_require_grad(m->orientation));
    }
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
        all_there = (*numbers[i] = hg_alloc(all, sizeof(double))) && all_there;
    for (int k = 0; m->options.method == HG_LBFGS && k < HG_MINIMISE_MEMORY; k++) {
        m->s[k] = hg_alloc(all, sizeof(double));
        m->y[k] = hg_alloc(all, sizeof(double));
        all_there = all_there && m->s[k] && m->y[k];
    }
    m->edge = hg_alloc(strands * (size_t)m->V + 1, sizeof(double));
    m->hessian = hg_alloc(all * (size_t)(m->band + 1), sizeof(double));
    m->factor = hg_alloc(all * (size_t)(m->band + 1), sizeof(double));
    m->part = hg_alloc(strands * HG_MINIMISE_PARTS + 1, sizeof(double));
    m->definite = hg_alloc(strands + 1, 1);
    m->problem = hg_alloc((size_t)m->problems + 1, sizeof *m->problem);
    m->result = hg_alloc(strands + 1, sizeof *m->result);
    return all_there && m->edge && m->hessian && m->factor && m->part && m->definite && m->problem && m->result
               ? HG_OK
               : HG_MEMORY;
}

/* How far vertices of a strand feel each other, whether strands do, and whether their edges have orientations. */
static hg_status find_reach(hg_minimiser *m)
{
    m->group = 1;
    m->reach = 1;
    m->width = 3;
    bool whole = false;
    for (int t = 0; t < m->terms; t++) {
        const hg_term *term = hg_physics_term(m->physics, t);
        const hg_site site = term->energy->site;
        if (site.kind != HG_SITE_WINDOW) {
            m->group = m->S;
            continue;
        }
        hg_energy_inputs asks;
        HG_TRY(hg_energy_asks(term->energy, term->options, false, &asks));
        bool q = false;
        for (int i = 0; i < asks.n; i++) q = q || !strcmp(asks.input[i].name, "q");
        if (q) m->width = 7;
        if (!q && (asks.scan || (m->pinned < 2 && site.count > 2)))
            whole = true; /* with q, only rest frames are carried */
        if (site.count - 1 > m->reach) m->reach = site.count - 1;
    }
    if (whole || m->reach > m->V) m->reach = (int)m->V;
    m->problems = m->group ? m->strands / m->group : 0;
    m->n = m->width * (m->V - m->pinned);
    const int64_t band = (int64_t)m->width * (m->reach + 1) - 1;
    m->band = (int)(band < m->n ? band : (m->n > 0 ? m->n - 1 : 0));
    return HG_OK;
}

hg_status hg_minimiser_create(hg_minimiser **out, hg_ctx *ctx, hg_physics *physics, int64_t frames, int64_t strands,
                              int64_t vertices, const hg_minimise_options *options)
{
    *out = NULL;
    if (!hg_ctx_host(ctx))
        return hg_fail(HG_UNSUPPORTED, "minimise: it runs on the processor; give it the context of hg_ctx_on_host");
    if (options && options->method == HG_XPBD)
        return hg_fail(HG_INVALID,
                       "minimise: xpbd is a solver of its own, hg_xpbd; the methods here are lbfgs and adam");
    if (frames < 0 || strands < 0 || vertices < 1)
        return hg_fail(HG_INVALID, "minimise: %lld frames of %lld strands of %lld vertices", (long long)frames,
                       (long long)strands, (long long)vertices);
    hg_minimiser *m = hg_alloc(1, sizeof *m);
    if (!m) return HG_MEMORY;
    m->ctx = ctx;
    m->physics = physics;
    if (options) m->options = *options;
    defaults(&m->options);
    m->B = frames, m->S = strands, m->V = vertices, m->strands = frames * strands;
    m->pinned = m->options.pinned < vertices ? m->options.pinned : (int)vertices;
    m->terms = hg_physics_terms(physics);
    hg_status status = find_reach(m);
    if (status == HG_OK) status = take_memory(m);
    if (status != HG_OK) {
        hg_minimiser_destroy(m);
        return status;
    }
    *out = m;
    return HG_OK;
}

/* ---- evaluation ---------------------------------------------------------------------------------------------- */

bool hg_minimise_stopped(const hg_minimiser *m) { return m->options.stop && m->options.stop(m->options.stop_self); }

/* Of the orientation before vertex v: a number of the minimiser is q times this. */
static double turn_scale(const hg_minimiser *m, int64_t strand, int64_t v) { return 2 * m->edge[strand * m->V + v]; }

void hg_minimise_place_one(hg_minimiser *m, int64_t strand, int64_t vertex, int axis, double value)
{
    const int64_t v = m->pinned + vertex;
    if (axis < 3)
        ((double *)m->trial->data)[(strand * m->V + v) * 3 + axis] = value;
    else
        ((double *)m->orientation->data)[(strand * (m->V - 1) + v - 1) * 4 + axis - 3] =
            value / turn_scale(m, strand, v);
}

/* Between the numbers of a strand and arrays of vertices and edges. */
static void unpack(hg_minimiser *m, int64_t i, const double *numbers)
{
    if (m->width == 3) {
        memcpy((double *)m->trial->data + (i * m->V + m->pinned) * 3, numbers, (size_t)m->n * sizeof *numbers);
        return;
    }
    for (int64_t k = 0; k < m->n; k++) hg_minimise_place_one(m, i, k / m->width, (int)(k % m->width), numbers[k]);
}

/* gradient: that of the numbers, else they themselves. */
static void pack(const hg_minimiser *m, int64_t i, const double *x, const double *q, bool gradient, double *numbers)
{
    x += (i * m->V + m->pinned) * 3;
    if (m->width == 3) {
        memcpy(numbers, x, (size_t)m->n * sizeof *numbers);
        return;
    }
    for (int64_t v = 0; v + m->pinned < m->V; v++) {
        const double *edge = q + (i * (m->V - 1) + m->pinned + v - 1) * 4, scale = turn_scale(m, i, m->pinned + v);
        memcpy(numbers + v * m->width, x + 3 * v, 3 * sizeof *x);
        for (int c = 0; c < 4; c++) numbers[v * m->width + 3 + c] = gradient ? edge[c] / scale : edge[c] * scale;
    }
}

void hg_minimise_place(hg_minimiser *m, const double *x)
{
    for (int64_t i = 0; i < m->strands; i++) unpack(m, i, x + i * m->n);
}

static hg_status evaluate(hg_minimiser *m, hg_minimise_wanted wanted)
{
    double *energy = wanted == HG_ENERGY_AND_GRADIENT ? m->term_energy : NULL;
    if (m->width > 3) {
        hg_tensor_touch(m->orientation);
        return hg_physics_evaluate_with(m->physics, m->ctx, &m->with, m->trial, wanted == HG_STRANDS_ALONE, energy,
                                        m->gradient, m->orientation, m->torque);
    }
    return wanted == HG_STRANDS_ALONE
               ? hg_physics_evaluate_alone(m->physics, m->ctx, &m->with, m->trial, m->gradient)
               : hg_physics_evaluate(m->physics, m->ctx, &m->with, m->trial, NULL, energy, m->gradient);
}

/* What the physics makes in a step goes again; what the caller made in it stays. */
hg_status hg_minimise_evaluate(hg_minimiser *m, hg_minimise_wanted wanted)
{
    const hg_step_mark mark = hg_step_set_mark(m->ctx);
    hg_tensor_touch(m->trial);
    const hg_status status = evaluate(m, wanted);
    hg_step_rewind(m->ctx, mark);
    m->evaluations++;
    for (int64_t i = 0; status == HG_OK && i < m->strands; i++)
        pack(m, i, m->gradient->data, m->width > 3 ? m->torque->data : NULL, true, m->slope + i * m->n);
    return status;
}

static double strand_energy(const hg_minimiser *m, int64_t strand)
{
    double sum = 0;
    for (int t = 0; t < m->terms; t++)
        sum += hg_physics_term(m->physics, t)->weight * m->term_energy[strand * m->terms + t];
    return sum;
}

static hg_status start(hg_minimiser *m, const hg_tensor *x, const hg_tensor *q)
{
    const double *from = x->data;
    for (int64_t i = 0; i < hg_tensor_count(x); i++)
        if (!isfinite(from[i]))
            return hg_fail(HG_NUMERIC, "minimise: frame %lld, strand %lld, vertex %lld of the start is not finite",
                           (long long)(i / 3 / m->V / m->S), (long long)(i / 3 / m->V % m->S),
                           (long long)(i / 3 % m->V));
    for (int64_t i = 0; q && i < hg_tensor_count(q); i++)
        if (!isfinite(((const double *)q->data)[i]))
            return hg_fail(HG_NUMERIC, "minimise: frame %lld, strand %lld, edge %lld: its orientation is not finite",
                           (long long)(i / 4 / (m->V - 1) / m->S), (long long)(i / 4 / (m->V - 1) % m->S),
                           (long long)(i / 4 % (m->V - 1)));
    memcpy(m->trial->data, from, hg_tensor_bytes(x));
    if (q) memcpy(m->orientation->data, q->data, hg_tensor_bytes(q));
    for (int64_t i = 0; i < m->strands; i++) {
        const double *at = from + i * m->V * 3;
        for (int64_t v = 1; v < m->V; v++) {
            double square = 0;
            for (int c = 0; c < 3; c++)
                square += (at[3 * v + c] - at[3 * v - 3 + c]) * (at[3 * v + c] - at[3 * v - 3 + c]);
            m->edge[i * m->V + v] = fmax(sqrt(square), 1e-6);
        }
        pack(m, i, from, q ? q->data : NULL, false, m->x + i * m->n);
    }
    memset(m->problem, 0, (size_t)m->problems * sizeof *m->problem);
    m->evaluations = m->restarts = 0;
    m->interrupted = false;
    HG_TRY(hg_minimise_evaluate(m, HG_ENERGY_AND_GRADIENT));
    for (int64_t i = 0; i < m->strands; i++) {
        hg_problem *p = &m->problem[i / m->group];
        const double energy = strand_energy(m, i);
        const double *g = m->slope + i * m->n;
        double sum = energy;
        for (int64_t k = 0; k < m->n; k++) sum += g[k];
        if (!isfinite(sum))
            return hg_fail(HG_NUMERIC, "minimise: frame %lld, strand %lld has no finite energy where it starts",
                           (long long)(i / m->S), (long long)(i % m->S));
        m->result[i] = (hg_minimised){ .before = energy };
        memcpy(m->g + i * m->n, g, (size_t)m->n * sizeof *g);
        p->energy += energy;
        for (int t = 0; t < m->terms; t++)
            p->size += fabs(hg_physics_term(m->physics, t)->weight * m->term_energy[i * m->terms + t]);
    }
    return HG_OK;
}

/* ---- result -------------------------------------------------------------------------------------------------- */

double hg_minimise_longest(const hg_minimiser *m, const double *numbers)
{
    double square = 0;
    for (int64_t k = 0; k < m->n; k += m->width) {
        double turn = 0;
        const double *at = numbers + k;
        for (int c = 3; c < m->width; c++) turn += at[c] * at[c];
        square = fmax(square, fmax(turn, at[0] * at[0] + at[1] * at[1] + at[2] * at[2]));
    }
    return sqrt(square);
}

/* Adam does not know how far it is from a minimum. */
static hg_status judge(hg_minimiser *m)
{
    for (int64_t p = 0; p < m->problems; p++) m->problem[p].state = HG_PROBLEM_RUNS;
    HG_TRY(hg_strand_hessians(m));
    for (int64_t i = 0; i < m->strands; i++) {
        hg_problem *p = &m->problem[i / m->group];
        double *step = m->scratch + i * m->n;
        memcpy(step, m->g + i * m->n, (size_t)m->n * sizeof *step);
        hg_strand_solve(m, i, step);
        m->result[i].movement = hg_minimise_longest(m, step);
        if (!(m->result[i].movement < m->options.movement) || (!m->definite[i] && m->group == 1))
            p->state = HG_PROBLEM_STUCK;
    }
    for (int64_t p = 0; p < m->problems; p++)
        if (m->problem[p].state == HG_PROBLEM_RUNS) m->problem[p].state = HG_PROBLEM_DONE;
    return HG_OK;
}

static hg_status finish(hg_minimiser *m, hg_tensor *x, hg_tensor *q, hg_solution *solution)
{
    hg_minimise_place(m, m->x);
    HG_TRY(hg_minimise_evaluate(m, HG_ENERGY_AND_GRADIENT));
    for (int64_t i = 0; i < m->strands; i++) {
        const hg_problem *p = &m->problem[i / m->group];
        hg_minimised *r = &m->result[i];
        r->after = strand_energy(m, i);
        r->force = hg_minimise_longest(m, m->slope + i * m->n);
        r->iterations = p->iterations;
        r->converged = p->state == HG_PROBLEM_DONE || (m->group > 1 && p->state == HG_PROBLEM_STUCK &&
                                                       r->movement < m->options.movement); /* held up by others */
        r->stalled = p->state == HG_PROBLEM_STUCK && !r->converged && m->options.method == HG_LBFGS;
        solution->before += r->before;
        solution->after += r->after;
        solution->converged += r->converged;
        solution->stalled += r->stalled;
        solution->force = fmax(solution->force, r->force);
        solution->movement = fmax(solution->movement, r->movement);
    }
    solution->strands = m->strands;
    solution->evaluations = m->evaluations;
    solution->restarts = m->restarts;
    solution->strand = m->result;
    if (q) HG_TRY(hg_tensor_write(q, m->orientation->data));
    return hg_tensor_copy(x, m->trial);
}

static hg_status minimise(hg_minimiser *m, hg_tensor *x, hg_tensor *q, hg_solution *solution)
{
    HG_TRY(start(m, x, q));
    HG_TRY(m->options.method == HG_ADAM ? hg_minimise_adam(m) : hg_minimise_lbfgs(m));
    solution->interrupted = m->interrupted;
    if (m->options.method == HG_ADAM) HG_TRY(judge(m));
    return finish(m, x, q, solution);
}

/* The caller's frame, its q in the minimiser's hands. */
static hg_status take_frame(hg_minimiser *m, const hg_frame *frame, hg_tensor **q)
{
    char text[96];
    *q = NULL;
    m->with = *frame;
    if (m->width == 3) return HG_OK;
    if (frame->n_inputs > INPUTS) return hg_fail(HG_UNSUPPORTED, "minimise: a frame with more than %d inputs", INPUTS);
    for (int i = 0; i < frame->n_inputs; i++) {
        m->inputs[i] = frame->inputs[i];
        if (strcmp(frame->inputs[i].name, "q") != 0) continue;
        *q = frame->inputs[i].value;
        m->inputs[i].value = m->orientation;
    }
    m->with.inputs = m->inputs;
    if (!*q)
        return hg_fail(HG_INVALID,
                       "minimise: an energy asks for the orientations of edges: the frame has to bring q, "
                       "f64 [%lld,%lld,%lld,4], where they start; they are there after it",
                       (long long)m->B, (long long)m->S, (long long)(m->V - 1));
    const hg_tensor *t = *q;
    if (t->dtype != HG_F64 || t->rank != 4 || t->shape[0] != m->B || t->shape[1] != m->S || t->shape[2] != m->V - 1 ||
        t->shape[3] != 4)
        return hg_fail(HG_INVALID, "minimise: q is %s; expected f64 [%lld,%lld,%lld,4]", hg_shape_text(t, text),
                       (long long)m->B, (long long)m->S, (long long)(m->V - 1));
    return HG_OK;
}

hg_status hg_minimise(hg_minimiser *m, const hg_frame *frame, hg_tensor *x, hg_solution *solution)
{
    hg_solution unused;
    if (!solution) solution = &unused;
    *solution = (hg_solution){ 0 };
    char text[96];
    if (!x) return hg_fail(HG_INVALID, "minimise: x is NULL");
    if (x->dtype != HG_F64 || x->rank != 4 || x->shape[0] != m->B || x->shape[1] != m->S || x->shape[2] != m->V ||
        x->shape[3] != 3)
        return hg_fail(HG_INVALID, "minimise: x is %s; it was made for f64 [%lld,%lld,%lld,3]", hg_shape_text(x, text),
                       (long long)m->B, (long long)m->S, (long long)m->V);
    hg_tensor *q;
    HG_TRY(take_frame(m, frame, &q));
    hg_physics_hold_body(m->physics, true);
    const hg_status status = minimise(m, x, q, solution);
    hg_physics_hold_body(m->physics, false);
    return status;
}
