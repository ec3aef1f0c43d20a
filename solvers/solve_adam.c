/* solve_adam: Adam (Kingma and Ba 2015) on the positions. Every coordinate has its own scale, so strands need no problems of
 * their own. What it is good for is comparison: it stays far from a minimum (docs/solve.md). */
#include "solvers/minimise.h"

#include <math.h>
#include <string.h>

typedef struct {
    const hg_minimiser *m;
    double rate, first, second; /* corrections of the two moments */
} adam_step;

/* The moments are in d and r. */
static void step(const void *args, int64_t first, int64_t last)
{
    const adam_step *a = args;
    const hg_minimiser *m = a->m;
    const double tiny = 1e-300; /* forces of a hair may be of any size */
    for (int64_t i = first; i < last; i++) {
        for (int64_t k = i * m->n; k < (i + 1) * m->n; k++) {
            const double g = m->g[k] = m->slope[k];
            m->d[k] = 0.9 * m->d[k] + 0.1 * g;
            m->r[k] = 0.999 * m->r[k] + 0.001 * g * g;
            m->x[k] -= a->rate * (m->d[k] / a->first) / (sqrt(m->r[k] / a->second) + tiny);
        }
    }
}

hg_status hg_minimise_adam(hg_minimiser *m)
{
    static const hg_kernel kernel = { .name = "solve_adam", .args_size = sizeof(adam_step), .cpu = step, .block = 16 };
    const size_t bytes = (size_t)(m->strands * m->n) * sizeof(double);
    const int64_t steps = m->options.evaluations;
    memset(m->d, 0, bytes);
    memset(m->r, 0, bytes);
    for (int64_t t = 0; t < steps && !(m->interrupted = hg_minimise_stopped(m)); t++) {
        const adam_step args = { m,
                                 0.5 * m->options.rate * (1 + cos(3.14159265358979323846 * (double)t / (double)steps)),
                                 1 - pow(0.9, (double)t + 1), 1 - pow(0.999, (double)t + 1) };
        HG_TRY(hg_launch(m->ctx, &kernel, m->strands, &args));
        hg_minimise_place(m, m->x);
        HG_TRY(hg_minimise_evaluate(m, HG_ENERGY_AND_GRADIENT));
        for (int64_t p = 0; p < m->problems; p++) m->problem[p].iterations++;
    }
    memcpy(m->g, m->slope, bytes); /* where it stands now, for those who judge it */
    return HG_OK;
}
