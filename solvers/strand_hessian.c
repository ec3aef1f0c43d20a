/* strand_hessian: how stiff a strand is along itself, for every energy alike.
 *
 * Energies over windows of R + 1 vertices couple a vertex with R neighbours on each side. Vertices 2R + 1 apart do not touch
 * the same forces, so that one evaluation with all of them moved by h along an axis gives a column of the Hessian for each:
 * 3 (2R + 1) evaluations (7 with orientations) for all strands at once, whatever the energies are. Where an energy reaches along the whole strand
 * (frames carried from edge to edge, a root edge that is free), every vertex has its own. Pairs and neighbour sums add to the
 * diagonal alone.
 *
 * With orientations both ways are gone and the middle taken: what keeps a quaternion at length one is so much stiffer than what turns
 * it that the second derivatives of one step would be seen.
 *
 * Where the Hessian is not positive definite, a multiple of the identity is added until it is. */
#include "solvers/minimise.h"

#include <math.h>
#include <string.h>

static const double shift =
    3e-9; /* m: below it rounding of the forces shows, above it the softest modes drown in stretch */

/* Where strands act on each other, they are moved this way and that, so that what neighbours do averages out. */
static double direction(const hg_minimiser *m, int64_t strand)
{
    if (m->group == 1) return shift;
    uint32_t bits[4];
    hg_random_bits(17, 0, (uint64_t)strand, bits);
    return bits[0] & 1 ? shift : -shift;
}

typedef struct {
    hg_minimiser *m;
    const double *gradient, *moved; /* [strands,n] at x, or moved back; moved on */
    double apart;                   /* how many shifts */
    int64_t colour;
    int axis;
} column;

/* Vertices of the colour and those whose forces it moves. */
static void take_column(const void *args, int64_t first, int64_t last)
{
    const column *c = args;
    const hg_minimiser *m = c->m;
    const int64_t free = m->V - m->pinned, colours = 2 * m->reach + 1, row = m->band + 1, w = m->width;
    for (int64_t i = first; i < last; i++) {
        if (m->problem[i / m->group].state >= HG_PROBLEM_DONE) continue;
        const double h = c->apart * direction(m, i), *g = c->gradient + i * m->n;
        const double *moved = c->moved + i * m->n;
        double *hessian = m->hessian + i * m->n * row;
        for (int64_t v = c->colour; v < free; v += colours) {
            const int64_t low = v > m->reach ? v - m->reach : 0, high = v + m->reach < free ? v + m->reach : free - 1;
            const int64_t j = w * v + c->axis;
            for (int64_t k = w * low; k < w * high + w; k++) {
                const double value = (moved[k] - g[k]) / h;
                if (k == j)
                    hessian[j * row + m->band] = value;
                else if (k > j)
                    hessian[k * row + m->band - (k - j)] += 0.5 * value;
                else
                    hessian[j * row + m->band - (j - k)] += 0.5 * value;
            }
        }
    }
}

/* The same of all energies: what they are stiffer than the strand alone is added to the diagonal. */
static void take_diagonal(const void *args, int64_t first, int64_t last)
{
    const column *c = args;
    const hg_minimiser *m = c->m;
    const int64_t free = m->V - m->pinned, colours = 2 * m->reach + 1, row = m->band + 1;
    for (int64_t i = first; i < last; i++) {
        const double *moved = c->moved + i * m->n;
        for (int64_t v = c->colour; v < free; v += colours) {
            const int64_t j = m->width * v + c->axis;
            double *own = m->hessian + (i * m->n + j) * row + m->band;
            *own = fmax(*own, (moved[j] - c->gradient[i * m->n + j]) / direction(m, i));
        }
    }
}

static bool cholesky(const double *a, double *l, int64_t n, int64_t band, double added)
{
    const int64_t row = band + 1;
    for (int64_t i = 0; i < n; i++) {
        const int64_t low = i > band ? i - band : 0;
        double *li = l + i * row + band - i;
        const double *ai = a + i * row + band - i;
        for (int64_t j = low; j <= i; j++) {
            const double *lj = l + j * row + band - j;
            double sum = ai[j] + (i == j ? added : 0);
            for (int64_t k = low > j - band ? low : j - band; k < j; k++) sum -= li[k] * lj[k];
            if (j < i) {
                li[j] = sum / lj[j];
            } else {
                if (!(sum > 1e-11 * (fabs(ai[i]) + added))) return false;
                li[i] = sqrt(sum);
            }
        }
    }
    return true;
}

static void factor(const void *args, int64_t first, int64_t last)
{
    const column *c = args;
    const hg_minimiser *m = c->m;
    const int64_t n = m->n, row = m->band + 1;
    for (int64_t i = first; i < last; i++) {
        if (m->problem[i / m->group].state >= HG_PROBLEM_DONE) continue;
        const double *a = m->hessian + i * n * row;
        double *l = m->factor + i * n * row, largest = 0, added = 0;
        for (int64_t k = 0; k < n; k++) largest = fmax(largest, fabs(a[k * row + m->band]));
        if (!(largest > 0)) largest = 1; /* nothing acts on it */
        m->definite[i] = cholesky(a, l, n, m->band, 0);
        if (m->definite[i]) continue;
        for (added = 1e-8 * largest; !cholesky(a, l, n, m->band, added) && added < 1e6 * largest;) added *= 4;
    }
}

void hg_strand_solve(const hg_minimiser *m, int64_t strand, double *z)
{
    const int64_t n = m->n, band = m->band, row = band + 1;
    const double *l = m->factor + strand * n * row;
    for (int64_t i = 0; i < n; i++) {
        double sum = z[i];
        for (int64_t k = i > band ? i - band : 0; k < i; k++) sum -= l[i * row + band - (i - k)] * z[k];
        z[i] = sum / l[i * row + band];
    }
    for (int64_t i = n - 1; i >= 0; i--) {
        double sum = z[i];
        for (int64_t k = i + 1; k < n && k <= i + band; k++) sum -= l[k * row + band - (k - i)] * z[k];
        z[i] = sum / l[i * row + band];
    }
}

static void shift_by(hg_minimiser *m, int64_t colour, int axis, double shifts)
{
    for (int64_t i = 0; i < m->strands; i++)
        for (int64_t v = colour; v < m->V - m->pinned && (m->problem[i / m->group].state < HG_PROBLEM_DONE || !shifts);
             v += 2 * m->reach + 1)
            hg_minimise_place_one(m, i, v, axis, m->x[i * m->n + m->width * v + axis] + shifts * direction(m, i));
}

hg_status hg_strand_hessians(hg_minimiser *m)
{
    static const hg_kernel band = {
        .name = "strand_hessian", .args_size = sizeof(column), .cpu = take_column, .block = 16
    };
    static const hg_kernel diagonal = {
        .name = "strand_diagonal", .args_size = sizeof(column), .cpu = take_diagonal, .block = 16
    };
    static const hg_kernel factorise = {
        .name = "strand_cholesky", .args_size = sizeof(column), .cpu = factor, .block = 4
    };
    const int64_t free = m->V - m->pinned, colours = 2 * m->reach + 1;
    for (int64_t i = 0; i < m->strands; i++)
        if (m->problem[i / m->group].state < HG_PROBLEM_DONE)
            memset(m->hessian + i * m->n * (m->band + 1), 0, (size_t)(m->n * (m->band + 1)) * sizeof *m->hessian);
    hg_minimise_place(m, m->x);
    const double *alone = m->g;
    if (m->group > 1) {
        HG_TRY(hg_minimise_evaluate(m, HG_STRANDS_ALONE));
        memcpy(m->next_g, m->slope, (size_t)(m->strands * m->n) * sizeof *m->slope);
        alone = m->next_g;
    }
    for (int64_t colour = 0; colour < colours && colour < free; colour++)
        for (int axis = 0; axis < m->width; axis++) {
            const hg_minimise_wanted wanted = m->group > 1 ? HG_STRANDS_ALONE : HG_GRADIENT_ALONE;
            column windows = { m, alone, m->slope, 1, colour, axis };
            shift_by(m, colour, axis, 1);
            HG_TRY(hg_minimise_evaluate(m, wanted));
            if (m->width > 3) {
                memcpy(m->r, m->slope, (size_t)(m->strands * m->n) * sizeof *m->slope);
                shift_by(m, colour, axis, -1);
                HG_TRY(hg_minimise_evaluate(m, wanted));
                windows = (column){ m, m->slope, m->r, 2, colour, axis };
            }
            HG_TRY(hg_launch(m->ctx, &band, m->strands, &windows));
            if (m->group > 1) {
                shift_by(m, colour, axis, 1);
                HG_TRY(hg_minimise_evaluate(m, HG_GRADIENT_ALONE));
                const column all = { m, m->g, m->slope, 1, colour, axis };
                HG_TRY(hg_launch(m->ctx, &diagonal, m->strands, &all));
            }
            shift_by(m, colour, axis, 0);
        }
    const column every = { m, NULL, NULL, 0, 0, 0 };
    return hg_launch(m->ctx, &factorise, m->strands, &every);
}
