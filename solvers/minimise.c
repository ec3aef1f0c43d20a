/* minimise: minima of a physics over the vertices of strands. What the methods share: memory, evaluation, results. */
#include "solvers/minimise.h"

#include <math.h>
#include <string.h>

void hg_minimiser_destroy(hg_minimiser *m)
{
    if (!m) return;
    hg_tensor_destroy(m->trial);
    hg_tensor_destroy(m->gradient);
    double *const numbers[] = { m->term_energy, m->x,    m->g,       m->next_g, m->d,   m->q,
                                m->r,           m->edge, m->hessian, m->factor, m->part };
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
    double **const numbers[] = { &m->x, &m->g, &m->next_g, &m->d, &m->q, &m->r };
    bool all_there = m->trial && m->gradient && m->term_energy;
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

/* How far vertices of a strand feel each other, and whether strands do. */
static hg_status find_reach(hg_minimiser *m)
{
    m->group = 1;
    m->reach = 1;
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
        if (asks.scan || (m->pinned < 2 && site.count > 2)) whole = true;
        if (site.count - 1 > m->reach) m->reach = site.count - 1;
    }
    if (whole || m->reach > m->V) m->reach = (int)m->V;
    m->problems = m->group ? m->strands / m->group : 0;
    m->band = 3 * m->reach + 2 < m->n ? 3 * m->reach + 2 : (m->n > 0 ? m->n - 1 : 0);
    return HG_OK;
}

hg_status hg_minimiser_create(hg_minimiser **out, hg_ctx *ctx, hg_physics *physics, int64_t frames, int64_t strands,
                              int64_t vertices, const hg_minimise_options *options)
{
    *out = NULL;
    if (!hg_ctx_host(ctx))
        return hg_fail(HG_UNSUPPORTED, "minimise: it runs on the processor; give it the context of hg_ctx_on_host");
    if (options && options->method == HG_XPBD)
        return hg_fail(HG_INVALID, "minimise: xpbd is a solver of its own, hg_xpbd; the methods here are lbfgs and adam");
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
    m->n = 3 * (vertices - m->pinned);
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

void hg_minimise_place(hg_minimiser *m, const double *x)
{
    double *trial = m->trial->data;
    for (int64_t i = 0; i < m->strands; i++)
        memcpy(trial + (i * m->V + m->pinned) * 3, x + i * m->n, (size_t)m->n * sizeof *x);
}

/* What the physics makes in a step goes again; what the caller made in it stays. */
hg_status hg_minimise_evaluate(hg_minimiser *m, hg_minimise_wanted wanted)
{
    const hg_step_mark mark = hg_step_set_mark(m->ctx);
    hg_tensor_touch(m->trial);
    const hg_status status =
        wanted == HG_STRANDS_ALONE
            ? hg_physics_evaluate_alone(m->physics, m->ctx, m->frame, m->trial, m->gradient)
            : hg_physics_evaluate(m->physics, m->ctx, m->frame, m->trial, NULL,
                                  wanted == HG_GRADIENT_ALONE ? NULL : m->term_energy, m->gradient);
    hg_step_rewind(m->ctx, mark);
    m->evaluations++;
    return status;
}

static double strand_energy(const hg_minimiser *m, int64_t strand)
{
    double sum = 0;
    for (int t = 0; t < m->terms; t++)
        sum += hg_physics_term(m->physics, t)->weight * m->term_energy[strand * m->terms + t];
    return sum;
}

static hg_status start(hg_minimiser *m, const hg_tensor *x)
{
    const double *from = x->data;
    for (int64_t i = 0; i < hg_tensor_count(x); i++)
        if (!isfinite(from[i]))
            return hg_fail(HG_NUMERIC, "minimise: frame %lld, strand %lld, vertex %lld of the start is not finite",
                           (long long)(i / 3 / m->V / m->S), (long long)(i / 3 / m->V % m->S),
                           (long long)(i / 3 % m->V));
    memcpy(m->trial->data, from, hg_tensor_bytes(x));
    for (int64_t i = 0; i < m->strands; i++) {
        const double *at = from + i * m->V * 3;
        memcpy(m->x + i * m->n, at + m->pinned * 3, (size_t)m->n * sizeof *at);
        for (int64_t v = 1; v < m->V; v++) {
            double square = 0;
            for (int c = 0; c < 3; c++)
                square += (at[3 * v + c] - at[3 * v - 3 + c]) * (at[3 * v + c] - at[3 * v - 3 + c]);
            m->edge[i * m->V + v] = fmax(sqrt(square), 1e-6);
        }
    }
    memset(m->problem, 0, (size_t)m->problems * sizeof *m->problem);
    m->evaluations = m->restarts = 0;
    m->interrupted = false;
    HG_TRY(hg_minimise_evaluate(m, HG_ENERGY_AND_GRADIENT));
    for (int64_t i = 0; i < m->strands; i++) {
        hg_problem *p = &m->problem[i / m->group];
        const double energy = strand_energy(m, i);
        const double *g = (const double *)m->gradient->data + (i * m->V + m->pinned) * 3;
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

static double longest(const double *vectors, int64_t n)
{
    double square = 0;
    for (int64_t k = 0; k + 2 < n; k += 3)
        square =
            fmax(square, vectors[k] * vectors[k] + vectors[k + 1] * vectors[k + 1] + vectors[k + 2] * vectors[k + 2]);
    return sqrt(square);
}

/* Adam does not know how far it is from a minimum. */
static hg_status judge(hg_minimiser *m)
{
    for (int64_t p = 0; p < m->problems; p++) m->problem[p].state = HG_PROBLEM_RUNS;
    HG_TRY(hg_strand_hessians(m));
    for (int64_t i = 0; i < m->strands; i++) {
        hg_problem *p = &m->problem[i / m->group];
        memcpy(m->q + i * m->n, m->g + i * m->n, (size_t)m->n * sizeof *m->q);
        hg_strand_solve(m, i, m->q + i * m->n);
        m->result[i].movement = longest(m->q + i * m->n, m->n);
        if (!(m->result[i].movement < m->options.movement) || (!m->definite[i] && m->group == 1))
            p->state = HG_PROBLEM_STUCK;
    }
    for (int64_t p = 0; p < m->problems; p++)
        if (m->problem[p].state == HG_PROBLEM_RUNS) m->problem[p].state = HG_PROBLEM_DONE;
    return HG_OK;
}

static hg_status finish(hg_minimiser *m, hg_tensor *x, hg_solution *solution)
{
    hg_minimise_place(m, m->x);
    HG_TRY(hg_minimise_evaluate(m, HG_ENERGY_AND_GRADIENT));
    for (int64_t i = 0; i < m->strands; i++) {
        const hg_problem *p = &m->problem[i / m->group];
        hg_minimised *r = &m->result[i];
        r->after = strand_energy(m, i);
        r->force = longest((const double *)m->gradient->data + (i * m->V + m->pinned) * 3, m->n);
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
    return hg_tensor_copy(x, m->trial);
}

static hg_status minimise(hg_minimiser *m, hg_tensor *x, hg_solution *solution)
{
    HG_TRY(start(m, x));
    HG_TRY(m->options.method == HG_ADAM ? hg_minimise_adam(m) : hg_minimise_lbfgs(m));
    solution->interrupted = m->interrupted;
    if (m->options.method == HG_ADAM) HG_TRY(judge(m));
    return finish(m, x, solution);
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
    m->frame = frame;
    hg_physics_hold_body(m->physics, true);
    const hg_status status = minimise(m, x, solution);
    hg_physics_hold_body(m->physics, false);
    return status;
}
