/* fit_material: stiffnesses from an observed drape, by the balance of forces.
 *
 * With g_0 the gradient of everything that is known and g_k that of an energy whose parameter k is 1, the drape is at rest
 * where g_0 + sum_k theta_k g_k = 0. Over the free vertices this is a linear least-squares problem in theta. Two things are
 * not known and are taken out: vertices that touch the body, and the tension of the edges: a hair hardly stretches, so the
 * lengths of an observed one, which are never exact, say nothing of the forces along it. Tension lambda_i of edge i pulls
 * with +lambda_i t_i at one end and -lambda_i t_i at the other; the best lambda of a strand is a tridiagonal system, solved
 * for every column, and what is left over takes the column's place. Outliers: iteratively reweighted, Huber 1964. */
#include "solvers/solvers.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { COLUMNS = HG_FIT_PARAMS + 1, ROUNDS = 12 };

typedef struct {
    int64_t B, S, V;
    int n, pinned;
    double *g[COLUMNS];   /* [B,S,V,3]: g[0] known, g[k] of parameter k - 1; without tension from `project` on */
    double *raw[COLUMNS]; /* the same before */
    double *weight, *off; /* [B,S,V]: 0 for vertices that are not looked at; length of what is left there */
    double *sorted;       /* [B,S,V] scratch */
    const double *x;
} fit_state;

/* ---- gradients ----------------------------------------------------------------------------------------------- */

/* dE/dx of some terms. */
static hg_status gradient_of(hg_ctx *ctx, const hg_term *terms, int n, const hg_groom_data *data, const hg_frame *frame,
                             hg_tensor *x, double *out)
{
    if (n == 0) return memset(out, 0, hg_tensor_bytes(x)), HG_OK;
    hg_physics *physics = NULL;
    HG_TRY(hg_physics_create(&physics, ctx, HG_F64, terms, n, data));
    hg_tensor *gradient = hg_tensor_create(ctx, HG_F64, x->rank, x->shape);
    hg_status status = gradient ? hg_physics_evaluate(physics, ctx, frame, x, NULL, NULL, gradient) : HG_MEMORY;
    if (status == HG_OK) status = hg_tensor_read(gradient, out);
    hg_tensor_destroy(gradient);
    hg_physics_destroy(physics);
    return status;
}

static hg_status find_param(const hg_term *terms, int n_terms, const char *name, int *term, int *param)
{
    for (*term = 0; *term < n_terms; ++*term) {
        const hg_energy *energy = terms[*term].energy;
        const size_t length = strlen(energy->name);
        if (strncmp(name, energy->name, length) || name[length] != '.') continue;
        for (*param = 0; *param < HG_ENERGY_PARAMS && energy->params[*param].name; ++*param)
            if (!strcmp(name + length + 1, energy->params[*param].name)) return HG_OK;
    }
    hg_text known = { 0 };
    for (int t = 0; t < n_terms; t++)
        for (int k = 0; k < HG_ENERGY_PARAMS && terms[t].energy->params[k].name; k++)
            hg_text_add(&known, "%s%s.%s", known.size ? ", " : "", terms[t].energy->name,
                        terms[t].energy->params[k].name);
    const hg_status status = hg_fail(HG_INVALID, "fit: there is no parameter \"%s\" among the energies; there are %s",
                                     name, known.data ? known.data : "none");
    hg_text_free(&known);
    return status;
}

static void parameters_of(const hg_term *term, double params[HG_ENERGY_PARAMS])
{
    memset(params, 0, HG_ENERGY_PARAMS * sizeof *params);
    for (int k = 0; k < HG_ENERGY_PARAMS && term->energy->params[k].name; k++)
        params[k] = term->params ? term->params[k] : term->energy->params[k].value;
}

static double largest_of(const double *values, int64_t n)
{
    double largest = 0;
    for (int64_t i = 0; i < n; i++) largest = fmax(largest, fabs(values[i]));
    return largest;
}

/* g of a parameter: its energy with 1 in its place; twice that with 2, or it is not proportional. */
static hg_status parameter_column(hg_ctx *ctx, const hg_term *term, int param, const char *name,
                                  const hg_groom_data *data, const hg_frame *frame, hg_tensor *x, double *out)
{
    double params[HG_ENERGY_PARAMS];
    parameters_of(term, params);
    hg_term one = *term;
    one.params = params;
    params[param] = 1;
    HG_TRY(gradient_of(ctx, &one, 1, data, frame, x, out));
    const int64_t n = hg_tensor_count(x);
    double *twice = hg_alloc((size_t)n, sizeof *twice);
    if (!twice) return HG_MEMORY;
    params[param] = 2;
    const hg_status status = gradient_of(ctx, &one, 1, data, frame, x, twice);
    double worst = 0;
    for (int64_t i = 0; i < n; i++) worst = fmax(worst, fabs(twice[i] - 2 * out[i]));
    const double scale = largest_of(out, n);
    hg_free(twice);
    HG_TRY(status);
    if (!(worst <= 1e-6 * scale))
        return hg_fail(HG_INVALID,
                       "fit: %s is not proportional to %s, so its value cannot be found by a balance of forces",
                       term->energy->name, name);
    return HG_OK;
}

/* All columns; vertices that touch the body get weight 0. */
static hg_status columns(hg_ctx *ctx, fit_state *s, const hg_term *terms, int n_terms, const hg_groom_data *data,
                         const hg_frame *frame, hg_tensor *x, const hg_material_options *options, hg_material_fit *fit)
{
    int term[HG_FIT_PARAMS], param[HG_FIT_PARAMS];
    hg_term *known = hg_alloc((size_t)n_terms, sizeof *known);
    if (!known) return HG_MEMORY;
    hg_status status = HG_OK;
    for (int k = 0; status == HG_OK && k < s->n; k++) {
        status = find_param(terms, n_terms, options->names[k], &term[k], &param[k]);
        if (status != HG_OK) break;
        fit->param[k].name = options->names[k];
        fit->param[k].unit = terms[term[k]].energy->params[param[k]].unit;
        for (int i = 0; i < k && status == HG_OK; i++)
            if (term[i] == term[k])
                status = hg_fail(HG_INVALID, "fit: %s and %s belong to one energy; only one of them can be found",
                                 options->names[i], options->names[k]);
        if (status == HG_OK)
            status = parameter_column(ctx, &terms[term[k]], param[k], options->names[k], data, frame, x, s->raw[k + 1]);
    }
    int n_known = 0, n_contact = 0;
    hg_term *contact = hg_alloc((size_t)n_terms, sizeof *contact);
    if (!contact) status = HG_MEMORY;
    for (int t = 0; status == HG_OK && t < n_terms; t++) {
        bool asked = false;
        for (int k = 0; k < s->n; k++) asked |= term[k] == t;
        if (terms[t].energy->contact)
            contact[n_contact++] = terms[t];
        else if (!asked)
            known[n_known++] = terms[t];
    }
    if (status == HG_OK) status = gradient_of(ctx, contact, n_contact, data, frame, x, s->raw[0]);
    for (int64_t i = 0; status == HG_OK && n_contact && i < s->B * s->S * s->V; i++)
        for (int c = 0; c < 3; c++)
            if (s->raw[0][3 * i + c] < 0 || s->raw[0][3 * i + c] > 0) s->weight[i] = 0;
    if (status == HG_OK) status = gradient_of(ctx, known, n_known, data, frame, x, s->raw[0]);
    if (status == HG_OK && !(largest_of(s->raw[0], 3 * s->B * s->S * s->V) > 0))
        status = hg_fail(HG_INVALID,
                         "fit: no force is known, so every stiffness would be as good as any other times a number; "
                         "gravity has to be among the energies");
    hg_free(known);
    hg_free(contact);
    return status;
}

/* ---- tension ------------------------------------------------------------------------------------------------- */

/* Of one strand: takes the best tension out of every column. */
static void project_strand(fit_state *s, int64_t strand, double *scratch)
{
    const int64_t V = s->V, E = V - 1, at = strand * V;
    const double *x = s->x + 3 * at, *w = s->weight + at;
    double *t = scratch, *diagonal = t + 3 * E, *above = diagonal + E, *right = above + E, *eliminated = right + E;
    for (int64_t e = 0; e < E; e++) {
        double length = 0;
        for (int c = 0; c < 3; c++) length += pow(x[3 * e + 3 + c] - x[3 * e + c], 2);
        length = sqrt(length);
        for (int c = 0; c < 3; c++) t[3 * e + c] = length > 0 ? (x[3 * e + 3 + c] - x[3 * e + c]) / length : 0;
    }
    for (int64_t e = 0; e < E; e++) {
        double turn = 0;
        for (int c = 0; e + 1 < E && c < 3; c++) turn += t[3 * e + c] * t[3 * e + 3 + c];
        diagonal[e] = w[e] + w[e + 1] + 1e-12; /* an edge that nothing looks at has no tension */
        above[e] = e + 1 < E ? -w[e + 1] * turn : 0;
    }
    for (int k = 0; k <= s->n; k++) {
        const double *raw = s->raw[k] + 3 * at;
        double *g = s->g[k] + 3 * at;
        memcpy(g, raw, (size_t)V * 3 * sizeof *g);
        /* +t_e at vertex e, -t_e at vertex e + 1 */
        for (int64_t e = 0; e < E; e++) {
            right[e] = 0;
            for (int c = 0; c < 3; c++)
                right[e] += t[3 * e + c] * (w[e] * raw[3 * e + c] - w[e + 1] * raw[3 * e + 3 + c]);
        }
        double pivot = diagonal[0];
        for (int64_t e = 0; e < E; e++) { /* Thomas */
            if (e > 0) {
                const double factor = above[e - 1] / pivot;
                pivot = diagonal[e] - factor * above[e - 1];
                right[e] -= factor * right[e - 1];
            }
            pivot = fmax(pivot, 1e-14);
            eliminated[e] = pivot;
        }
        for (int64_t e = E - 1; e >= 0; e--) {
            right[e] = (right[e] - (e + 1 < E ? above[e] * right[e + 1] : 0)) / eliminated[e];
            for (int c = 0; c < 3; c++) {
                g[3 * e + c] -= right[e] * t[3 * e + c];
                g[3 * e + 3 + c] += right[e] * t[3 * e + c];
            }
        }
    }
}

static void project(fit_state *s, bool tension_unknown, double *scratch)
{
    for (int64_t strand = 0; strand < s->B * s->S; strand++)
        if (tension_unknown && s->V > 1)
            project_strand(s, strand, scratch);
        else
            for (int k = 0; k <= s->n; k++)
                memcpy(s->g[k] + 3 * strand * s->V, s->raw[k] + 3 * strand * s->V, (size_t)s->V * 3 * sizeof(double));
}

/* ---- least squares ------------------------------------------------------------------------------------------- */

/* A theta = b with A n x n symmetric, by Cholesky in units of its own diagonal; false where a parameter has no say of its own.
 * inverse_diagonal: of A. */
static bool solve(int n, const double *A, const double *b, double *theta, double *inverse_diagonal)
{
    double L[HG_FIT_PARAMS][HG_FIT_PARAMS] = { { 0 } }, scale[HG_FIT_PARAMS], y[HG_FIT_PARAMS];
    for (int i = 0; i < n; i++) {
        scale[i] = sqrt(A[i * n + i]);
        if (!(scale[i] > 0)) return false;
    }
    for (int i = 0; i < n; i++)
        for (int k = 0; k <= i; k++) {
            double sum = A[i * n + k] / (scale[i] * scale[k]);
            for (int j = 0; j < k; j++) sum -= L[i][j] * L[k][j];
            if (i == k && !(sum > 1e-10)) return false;
            L[i][k] = i == k ? sqrt(sum) : sum / L[k][k];
        }
    for (int column = -1; column < n; column++) { /* -1: b; else the columns of the inverse */
        for (int i = 0; i < n; i++) {
            double sum = column < 0 ? b[i] / scale[i] : i == column;
            for (int k = 0; k < i; k++) sum -= L[i][k] * y[k];
            y[i] = sum / L[i][i];
        }
        for (int i = n - 1; i >= 0; i--) {
            for (int k = i + 1; k < n; k++) y[i] -= L[k][i] * y[k];
            y[i] /= L[i][i];
        }
        for (int i = 0; column < 0 && i < n; i++) theta[i] = y[i] / scale[i];
        if (column >= 0) inverse_diagonal[column] = y[column] / (scale[column] * scale[column]);
    }
    return true;
}

/* Normal equations over the strands first, first + step, ..: A theta = b. */
static void normal_equations(const fit_state *s, int64_t first, int64_t step, double *A, double *b)
{
    const int n = s->n;
    memset(A, 0, (size_t)(n * n) * sizeof *A);
    memset(b, 0, (size_t)n * sizeof *b);
    for (int64_t strand = first; strand < s->B * s->S; strand += step)
        for (int64_t i = strand * s->V; i < (strand + 1) * s->V; i++) {
            if (!(s->weight[i] > 0)) continue;
            for (int c = 0; c < 3; c++)
                for (int k = 0; k < n; k++) {
                    b[k] -= s->weight[i] * s->g[k + 1][3 * i + c] * s->g[0][3 * i + c];
                    for (int j = 0; j < n; j++)
                        A[k * n + j] += s->weight[i] * s->g[k + 1][3 * i + c] * s->g[j + 1][3 * i + c];
                }
        }
}

/* What is left at every vertex that is looked at. Returns the weighted square of it. */
static double leftover(fit_state *s, const double *theta, double *before, int64_t *vertices)
{
    double after = 0;
    *before = 0;
    *vertices = 0;
    for (int64_t i = 0; i < s->B * s->S * s->V; i++) {
        if (!(s->weight[i] > 0)) continue;
        double square = 0, known = 0;
        for (int c = 0; c < 3; c++) {
            double r = s->g[0][3 * i + c];
            known += r * r;
            for (int k = 0; k < s->n; k++) r += theta[k] * s->g[k + 1][3 * i + c];
            square += r * r;
        }
        s->off[i] = sqrt(square);
        s->sorted[(*vertices)++] = s->off[i];
        after += s->weight[i] * square;
        *before += s->weight[i] * known;
    }
    return after;
}

static int ascending(const void *a_, const void *b_)
{
    const double a = *(const double *)a_, b = *(const double *)b_;
    return a < b ? -1 : a > b;
}

static hg_status says_nothing(const hg_material_options *options)
{
    return hg_fail(
        HG_NUMERIC,
        "fit: the drape says nothing of %s%s on its own: the free vertices feel no force of it, or the same as of "
        "another parameter; is the hair bent, and are enough vertices free of the body?",
        options->names[0], options->n > 1 ? " or another of the parameters" : "");
}

static hg_status least_squares(fit_state *s, const hg_material_options *options, bool tension_unknown, double *scratch,
                               hg_material_fit *fit)
{
    double A[HG_FIT_PARAMS * HG_FIT_PARAMS], b[HG_FIT_PARAMS], theta[HG_FIT_PARAMS], inverse[HG_FIT_PARAMS], before = 0,
                                                                                                             after = 0;
    for (int round = 0; round < ROUNDS; round++) {
        project(s, tension_unknown, scratch);
        normal_equations(s, 0, 1, A, b);
        if (!solve(s->n, A, b, theta, inverse)) return says_nothing(options);
        after = leftover(s, theta, &before, &fit->vertices);
        qsort(s->sorted, (size_t)fit->vertices, sizeof *s->sorted, ascending);
        /* In three dimensions the median length is 1.538 deviations of a component. */
        const double deviation = s->sorted[fit->vertices / 2] / 1.538, bound = fmax(3 * deviation, 1e-300);
        if (round + 1 == ROUNDS) break;
        for (int64_t i = 0; i < s->B * s->S * s->V; i++)
            if (s->weight[i] > 0) s->weight[i] = s->off[i] > bound ? bound / s->off[i] : 1;
    }
    const double free_rows = fmax((double)((tension_unknown ? 2 : 3) * fit->vertices - s->n), 1);
    fit->unbalanced = before > 0 ? sqrt(after / before) : 0;
    if (!(fit->unbalanced < 0.9))
        return hg_fail(
            HG_NUMERIC,
            "fit: %s%s cannot balance the drape: %.0f %% of the known forces are left, whatever the value; is it at "
            "rest, and are all energies there that act on it?",
            options->names[0], options->n > 1 ? " and the others" : "", 100 * fit->unbalanced);
    for (int k = 0; k < s->n; k++) {
        fit->param[k].value = theta[k];
        fit->param[k].error = sqrt(after / free_rows * inverse[k]);
    }
    for (int64_t strand = 0; options->per_strand && strand < s->S; strand++) {
        normal_equations(s, strand, s->S, A, b);
        const bool told = solve(s->n, A, b, theta, inverse);
        for (int k = 0; k < s->n; k++) fit->strands[k * s->S + strand] = told ? theta[k] : (double)NAN;
    }
    return HG_OK;
}

/* ---- the whole ----------------------------------------------------------------------------------------------- */

static int pinned_of(const hg_term *terms, int n, const hg_material_options *options)
{
    if (options->pinned > 0) return options->pinned;
    for (int t = 0; t < n; t++)
        for (int k = 0; k < HG_ENERGY_OPTIONS && terms[t].energy->options[k].name; k++) {
            const char *chosen =
                terms[t].options && terms[t].options[k] ? terms[t].options[k] : terms[t].energy->options[k].value;
            if (!strcmp(terms[t].energy->options[k].name, "root") && !strcmp(chosen, "clamped")) return 2;
        }
    return 1;
}

static hg_status fit_all(hg_ctx *ctx, fit_state *s, const hg_term *terms, int n_terms, const hg_groom_data *data,
                         const hg_frame *frame, hg_tensor *x, const hg_material_options *options, hg_material_fit *fit)
{
    const int64_t points = s->B * s->S * s->V;
    for (int k = 0; k <= s->n; k++) {
        s->raw[k] = hg_alloc((size_t)(3 * points), sizeof(double));
        s->g[k] = hg_alloc((size_t)(3 * points), sizeof(double));
        if (!s->raw[k] || !s->g[k]) return HG_MEMORY;
    }
    s->weight = hg_alloc((size_t)points, sizeof(double));
    s->off = hg_alloc((size_t)points, sizeof(double));
    s->sorted = hg_alloc((size_t)points, sizeof(double));
    if (options->per_strand) fit->strands = hg_alloc((size_t)(s->n * s->S), sizeof(double));
    if (!s->weight || !s->off || !s->sorted || (options->per_strand && !fit->strands)) return HG_MEMORY;
    for (int64_t i = 0; i < points; i++)
        s->weight[i] = i % s->V >= s->pinned && !(options->left_out && options->left_out[i]);
    HG_TRY(columns(ctx, s, terms, n_terms, data, frame, x, options, fit));
    int64_t looked_at = 0;
    for (int64_t i = 0; i < points; i++) looked_at += s->weight[i] > 0;
    fit->left_out = s->B * s->S * (s->V - s->pinned) - looked_at;
    if (looked_at < 1)
        return hg_fail(HG_NUMERIC, "fit: every free vertex touches the body or was left out; nothing can be said");
    bool unknown = options->tension == HG_TENSION_UNKNOWN;
    if (options->tension == HG_TENSION_AUTO) {
        unknown = true;
        for (int k = 0; k < s->n; k++) unknown &= strncmp(options->names[k], "stretch.", 8) != 0;
    }
    double *scratch = hg_alloc((size_t)s->V * 7, sizeof *scratch);
    if (!scratch) return HG_MEMORY;
    const hg_status status = least_squares(s, options, unknown, scratch, fit);
    hg_free(scratch);
    return status;
}

hg_status hg_fit_material(hg_ctx *ctx, const hg_term *terms, int n_terms, const hg_groom_data *data,
                          const hg_frame *frame, hg_tensor *x, const hg_material_options *options, hg_material_fit *fit)
{
    *fit = (hg_material_fit){ .n = options->n, .n_strands = x && x->rank == 4 ? x->shape[1] : 0 };
    if (options->n < 1 || options->n > HG_FIT_PARAMS)
        return hg_fail(HG_INVALID, "fit: %d parameters; between 1 and %d can be found at once", options->n,
                       HG_FIT_PARAMS);
    if (!x || x->dtype != HG_F64 || x->rank != 4 || x->shape[3] != 3)
        return hg_fail(HG_INVALID, "fit: x has to be f64 [B,S,V,3]");
    fit_state s = { .B = x->shape[0], .S = x->shape[1], .V = x->shape[2], .n = options->n, .x = x->data };
    s.pinned = pinned_of(terms, n_terms, options);
    if (s.B * s.S < 1 || s.pinned >= s.V)
        return hg_fail(HG_INVALID, "fit: %lld strands of %lld vertices, %d of them held: nothing is free",
                       (long long)(s.B * s.S), (long long)s.V, s.pinned);
    const hg_status status = fit_all(ctx, &s, terms, n_terms, data, frame, x, options, fit);
    for (int k = 0; k <= s.n; k++) {
        hg_free(s.raw[k]);
        hg_free(s.g[k]);
    }
    hg_free(s.weight);
    hg_free(s.off);
    hg_free(s.sorted);
    if (status != HG_OK) hg_material_fit_free(fit);
    return status;
}

void hg_material_fit_free(hg_material_fit *fit)
{
    hg_free(fit->strands);
    fit->strands = NULL;
}
