/* lbfgs: limited-memory BFGS (Nocedal and Wright 2006, algorithm 7.4) of many problems at once.
 *
 * A round is one evaluation: each problem has its own step and takes it or shortens it (Armijo; near the end, where energies
 * drown in rounding, by slopes as Hager and Zhang 2005). The two loops of the direction are worked out in products of the history
 * (s_i . y_j), so that everything long is a few passes over strands, each strand by itself, and sums over strands are added
 * in their order: the same numbers for any number of threads.
 *
 * The inverse Hessian starts from the strands' own (strand_hessian.c). After some rounds, or when no problem goes on, that is made
 * anew where the strands are now and the history is dropped. A problem is done when a full step with a new Hessian does not move
 * it. Where the energy is flat but the Hessian is not positive definite (a straight hair that stands upright), it is a saddle: the
 * strand is pushed along a direction of negative curvature. */
#include "solvers/minimise.h"

#include <math.h>
#include <string.h>

enum { MEMORY = HG_MINIMISE_MEMORY, PARTS = HG_MINIMISE_PARTS, KICKS = 8 };

static const double sufficient = 1e-4; /* Armijo */
static const double edge_turn = 0.5;   /* a direction changes no edge by more than this part of it */
static const double shortest = 1e-13;  /* m: shorter steps are no steps */

typedef struct {
    hg_minimiser *m;
    int phase;
} pass;

static double dot(const double *a, const double *b, int64_t n)
{
    double sum = 0;
    for (int64_t k = 0; k < n; k++) sum += a[k] * b[k];
    return sum;
}

/* Slot of the i-th pair, the oldest first. */
static int slot_of(const hg_problem *p, int i) { return (p->next - p->kept + i + 2 * MEMORY) % MEMORY; }

/* ---- passes over strands --------------------------------------------------------------------------------------- */

static void measure_strand(const hg_minimiser *m, int64_t i, double *part)
{
    memcpy(m->next_g + i * m->n, m->slope + i * m->n, (size_t)m->n * sizeof(double));
    part[0] = part[1] = 0;
    for (int t = 0; t < m->terms; t++) {
        const double energy = hg_physics_term(m->physics, t)->weight * m->term_energy[i * m->terms + t];
        part[0] += energy;
        part[1] += fabs(energy);
    }
    part[2] = dot(m->next_g + i * m->n, m->d + i * m->n, m->n);
}

static void accept_strand(const hg_minimiser *m, int64_t i, const hg_problem *p, double *part)
{
    const int64_t at = i * m->n, n = m->n;
    double *s = m->s[p->next] + at, *y = m->y[p->next] + at;
    for (int64_t k = 0; k < n; k++) {
        s[k] = p->step * m->d[at + k];
        y[k] = m->next_g[at + k] - m->g[at + k];
        m->x[at + k] += s[k];
        m->g[at + k] = m->next_g[at + k];
    }
    for (int j = 0; j < MEMORY; j++) {
        part[j] = dot(s, m->y[j] + at, n);
        part[MEMORY + j] = dot(m->s[j] + at, y, n);
        part[2 * MEMORY + j] = dot(m->s[j] + at, m->g + at, n);
    }
    part[3 * MEMORY] = dot(y, y, n);
    part[3 * MEMORY + 1] = dot(s, s, n);
}

/* r = H0 (g - sum of alpha_i y_i) */
static void descend_strand(const hg_minimiser *m, int64_t i, const hg_problem *p, double *part)
{
    const int64_t at = i * m->n, n = m->n;
    double *r = m->r + at;
    memcpy(r, m->g + at, (size_t)n * sizeof *r);
    for (int a = 0; a < p->kept; a++) {
        const int j = slot_of(p, a);
        for (int64_t k = 0; k < n; k++) r[k] -= p->alpha[j] * m->y[j][at + k];
    }
    hg_strand_solve(m, i, r);
    for (int a = 0; a < p->kept; a++) part[slot_of(p, a)] = dot(m->y[slot_of(p, a)] + at, r, n);
}

static void direct_strand(const hg_minimiser *m, int64_t i, const hg_problem *p, double *part)
{
    const int64_t at = i * m->n, n = m->n;
    const int w = m->width;
    double *d = m->d + at, bend = 0;
    for (int64_t k = 0; k < n; k++) d[k] = -m->r[at + k];
    for (int a = 0; a < p->kept; a++) {
        const int j = slot_of(p, a);
        for (int64_t k = 0; k < n; k++) d[k] -= p->alpha[j] * m->s[j][at + k];
    }
    for (int64_t k = 0; k < n; k += w) {
        double turn = 0, change = 0;
        for (int c = 0; c < 3; c++) {
            const double before = k ? d[k - w + c] : 0;
            change += (d[k + c] - before) * (d[k + c] - before);
        }
        for (int c = 3; c < w; c++) turn += d[k + c] * d[k + c];
        bend = fmax(bend, sqrt(fmax(change, turn)) / m->edge[i * m->V + m->pinned + k / w]);
    }
    part[0] = dot(m->g + at, d, n);
    part[1] = hg_minimise_longest(m, d);
    part[2] = bend;
}

/* The softest way of a strand by inverse iteration, a tenth of a degree of an edge far. */
static void kick_strand(const hg_minimiser *m, int64_t i, double *part)
{
    const int64_t at = i * m->n, n = m->n;
    double *d = m->d + at, bend = 0;
    for (int64_t k = 0; k < n; k++) d[k] = m->definite[i] ? 0 : hg_random_normal(23, (uint64_t)i, (uint64_t)k);
    for (int round = 0; round < 6 && !m->definite[i]; round++) {
        hg_strand_solve(m, i, d);
        const double norm = sqrt(dot(d, d, n));
        for (int64_t k = 0; k < n; k++) d[k] /= norm > 0 ? norm : 1;
    }
    double far = hg_minimise_longest(m, d);
    const double sign = dot(m->g + at, d, n) > 0 ? -1 : 1,
                 scale = far > 0 ? 0.05 * m->edge[i * m->V + m->V - 1] / far : 0;
    for (int64_t k = 0; k < n; k++) d[k] *= sign * scale;
    far *= scale;
    for (int64_t k = 0; k < n; k++) bend = fmax(bend, fabs(d[k]));
    part[0] = 0;
    part[1] = far;
    part[2] = bend > 0 ? 1e-3 : 0;
}

enum { MEASURE, ACCEPT, DESCEND, DIRECT, KICK };

static void run_pass(const void *args, int64_t first, int64_t last)
{
    const pass *a = args;
    const hg_minimiser *m = a->m;
    for (int64_t i = first; i < last; i++) {
        const hg_problem *p = &m->problem[i / m->group];
        double *part = m->part + i * PARTS;
        if (p->state != HG_PROBLEM_RUNS) continue;
        if (a->phase == MEASURE) measure_strand(m, i, part);
        if (a->phase == ACCEPT && p->accepted) accept_strand(m, i, p, part);
        if (a->phase == DESCEND && p->accepted) descend_strand(m, i, p, part);
        if (a->phase == DIRECT && p->accepted && !p->kick) direct_strand(m, i, p, part);
        if (a->phase == KICK && p->accepted && p->kick) kick_strand(m, i, part);
    }
}

static hg_status go(hg_minimiser *m, int phase)
{
    static const hg_kernel kernel = { .name = "lbfgs", .args_size = sizeof(pass), .cpu = run_pass, .block = 8 };
    const pass args = { m, phase };
    return hg_launch(m->ctx, &kernel, m->strands, &args);
}

static double sum_of(const hg_minimiser *m, const hg_problem *p, int part)
{
    const int64_t first = (p - m->problem) * m->group;
    double sum = 0;
    for (int64_t i = first; i < first + m->group; i++) sum += m->part[i * PARTS + part];
    return sum;
}

static double largest_of(const hg_minimiser *m, const hg_problem *p, int part)
{
    const int64_t first = (p - m->problem) * m->group;
    double largest = 0;
    for (int64_t i = first; i < first + m->group; i++) largest = fmax(largest, m->part[i * PARTS + part]);
    return largest;
}

/* ---- direction --------------------------------------------------------------------------------------------------- */

static bool turns(const hg_problem *p) { return p->state == HG_PROBLEM_RUNS && p->accepted; }

/* Of every problem that runs and whose point is new (accepted). */
static hg_status directions(hg_minimiser *m)
{
    for (hg_problem *p = m->problem; p < m->problem + m->problems; p++)
        for (int i = p->kept - 1; turns(p) && i >= 0; i--) {
            const int k = slot_of(p, i);
            double projected = p->with_gradient[k];
            for (int j = i + 1; j < p->kept; j++) projected -= p->alpha[slot_of(p, j)] * p->product[k][slot_of(p, j)];
            p->alpha[k] = p->rho[k] * projected;
        }
    HG_TRY(go(m, DESCEND));
    for (hg_problem *p = m->problem; p < m->problem + m->problems; p++)
        for (int i = 0; turns(p) && i < p->kept; i++) {
            const int k = slot_of(p, i);
            double projected = sum_of(m, p, k);
            for (int j = 0; j < i; j++) projected += p->alpha[slot_of(p, j)] * p->product[slot_of(p, j)][k];
            p->alpha[k] -= p->rho[k] * projected; /* from here on: what s_k is multiplied with */
        }
    HG_TRY(go(m, DIRECT));
    HG_TRY(go(m, KICK));
    for (hg_problem *p = m->problem; p < m->problem + m->problems; p++) {
        if (!turns(p)) continue;
        p->slope = sum_of(m, p, 0);
        p->far = largest_of(m, p, 1);
        p->bend = largest_of(m, p, 2);
        p->step = p->bend > edge_turn ? edge_turn / p->bend : 1;
        p->accepted = false;
    }
    return HG_OK;
}

static bool definite(const hg_minimiser *m, const hg_problem *p)
{
    const int64_t first = (p - m->problem) * m->group;
    for (int64_t i = first; i < first + m->group; i++)
        if (!m->definite[i]) return false;
    return true;
}

/* With new Hessians: who is done, who goes on. */
static hg_status restart(hg_minimiser *m, int64_t *running)
{
    const int patience = m->options.enough > 0 ? 1 : m->group > 1 ? 8 : 2;
    HG_TRY(hg_strand_hessians(m));
    for (hg_problem *p = m->problem; p < m->problem + m->problems; p++) {
        if (p->state >= HG_PROBLEM_DONE) continue;
        p->state = m->restarts && !p->advanced ? HG_PROBLEM_STUCK : HG_PROBLEM_RUNS;
        if (!m->restarts) p->first_energy = p->energy;
        const double least = m->options.enough > 0 ? m->options.enough : 1e-8;
        const bool little = p->restart_energy - p->energy < least * (p->first_energy - p->energy);
        p->stalls = m->restarts && little ? p->stalls + 1 : 0;
        p->restart_energy = p->energy;
        p->accepted = true;
        p->kept = 0;
        p->kick = p->advanced = false;
    }
    m->restarts++;
    HG_TRY(directions(m));
    bool kicks = false;
    for (hg_problem *p = m->problem; p < m->problem + m->problems; p++) {
        if (p->state != HG_PROBLEM_RUNS) continue;
        const int64_t first = (p - m->problem) * m->group;
        for (int64_t i = first; i < first + m->group; i++) m->result[i].movement = m->part[i * PARTS + 1];
        if (!(p->far < m->options.movement) && p->slope < 0) {
            if (p->stalls >= patience) p->state = HG_PROBLEM_STUCK;
            continue;
        }
        if (m->group > 1 || definite(m, p)) {
            p->state = p->far < m->options.movement ? HG_PROBLEM_DONE : HG_PROBLEM_STUCK;
        } else if (p->kicks++ < KICKS) {
            kicks = p->kick = p->accepted = true;
        } else {
            p->state = HG_PROBLEM_STUCK;
        }
    }
    if (kicks) HG_TRY(directions(m));
    *running = 0;
    for (int64_t p = 0; p < m->problems; p++) *running += m->problem[p].state == HG_PROBLEM_RUNS;
    return HG_OK;
}

/* ---- a round ----------------------------------------------------------------------------------------------------- */

static void try_steps(hg_minimiser *m)
{
    for (int64_t i = 0; i < m->strands; i++) {
        const hg_problem *p = &m->problem[i / m->group];
        const double step = p->state == HG_PROBLEM_RUNS ? p->step : 0, *x = m->x + i * m->n, *d = m->d + i * m->n;
        double *out = m->scratch + i * m->n;
        for (int64_t k = 0; k < m->n; k++) out[k] = step != 0 ? x[k] + step * d[k] : x[k];
    }
    hg_minimise_place(m, m->scratch);
}

static void judge_step(hg_problem *p, double energy, double size, double slope)
{
    const double noise = 2e-15 * (p->size + size);
    p->accepted = false;
    if (isfinite(energy) && isfinite(slope)) {
        p->accepted = energy <= p->energy + sufficient * p->step * p->slope && (!p->kick || energy < p->energy);
        if (!p->kick && energy <= p->energy + noise && slope <= (2 * sufficient - 1) * p->slope) p->accepted = true;
    }
    if (p->accepted) {
        p->energy = energy;
        p->size = size;
        p->iterations++;
        p->advanced = true;
        return;
    }
    const double above = (energy - p->energy) / p->step - p->slope, fit = -0.5 * p->slope * p->step / above;
    p->step = isfinite(fit) && fit > 0.1 * p->step ? fmin(fit, 0.5 * p->step) : 0.1 * p->step;
    if (p->step * p->far < shortest) p->state = HG_PROBLEM_WAITS;
}

static void remember_pair(const hg_minimiser *m, hg_problem *p)
{
    const int k = p->next;
    const double curvature = sum_of(m, p, k), yy = sum_of(m, p, 3 * MEMORY), ss = sum_of(m, p, 3 * MEMORY + 1);
    for (int j = 0; j < MEMORY; j++) {
        p->product[k][j] = sum_of(m, p, j);
        p->product[j][k] = sum_of(m, p, MEMORY + j);
        p->with_gradient[j] = sum_of(m, p, 2 * MEMORY + j);
    }
    if (p->kept == MEMORY) p->kept--;                 /* the oldest was overwritten */
    if (!(curvature > 1e-12 * sqrt(ss * yy))) return; /* it bends down: nothing to learn */
    p->rho[k] = 1 / curvature;
    p->next = (k + 1) % MEMORY;
    p->kept++;
}

static hg_status one_round(hg_minimiser *m, int64_t *running)
{
    try_steps(m);
    HG_TRY(hg_minimise_evaluate(m, HG_ENERGY_AND_GRADIENT));
    HG_TRY(go(m, MEASURE));
    for (hg_problem *p = m->problem; p < m->problem + m->problems; p++)
        if (p->state == HG_PROBLEM_RUNS) judge_step(p, sum_of(m, p, 0), sum_of(m, p, 1), sum_of(m, p, 2));
    HG_TRY(go(m, ACCEPT));
    for (hg_problem *p = m->problem; p < m->problem + m->problems; p++) {
        if (!turns(p)) continue;
        remember_pair(m, p);
        if (p->kick) p->state = HG_PROBLEM_WAITS; /* another Hessian from here */
    }
    HG_TRY(directions(m));
    *running = 0;
    for (hg_problem *p = m->problem; p < m->problem + m->problems; p++) {
        if (p->state != HG_PROBLEM_RUNS) continue;
        if (!(p->slope < 0) && !p->kick) p->state = HG_PROBLEM_WAITS;
        if (p->far < m->options.movement) p->state = HG_PROBLEM_WAITS;
        *running += p->state == HG_PROBLEM_RUNS;
    }
    return HG_OK;
}

hg_status hg_minimise_lbfgs(hg_minimiser *m)
{
    const int64_t rounds = m->group > 1 ? 120 : 30 + 3 * m->reach; /* between Hessians, which cost as much themselves */
    for (;;) {
        int64_t running;
        HG_TRY(restart(m, &running));
        if (!running) return HG_OK;
        for (int64_t round = 0; running && round < rounds; round++) {
            HG_TRY(one_round(m, &running));
            if ((m->interrupted = hg_minimise_stopped(m)) || m->evaluations >= m->options.evaluations) return HG_OK;
        }
    }
}
