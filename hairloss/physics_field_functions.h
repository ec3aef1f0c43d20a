/* One frame of the field pass, for one precision: hg_real, HG_P(name) and HG_MATH(name) are set by physics_field.c, the
 * only place that includes this.
 */

typedef struct {
    const field_pass *pass;
    int64_t groom;
    const hg_cells *cells;
    const hg_real *mass;       /* [places], NULL: all 1 */
    const hg_real *field_rest; /* [n] */
    hg_real *field;            /* [n] sum over neighbours */
    hg_real *slope;            /* [n] dE/dfield, times the weight */
    hg_real *slope_place;      /* [places] the same in the order of places */
    hg_real *gradient;         /* [n,3] of this frame */
    double *strand_energies;   /* [S] */
} HG_P(field_args);

/* Hits of several points, one after another, until there are enough lanes to be worth a run of the kernel function. */
typedef struct {
    int n, n_owners;
    int32_t place[LANES];
    hg_real value[LANES];                     /* squared distance, then distance, then W or W' */
    int32_t owner[OWNERS], first[OWNERS + 1]; /* places whose hits these are */
} HG_P(gathered);

static hg_real HG_P(sum)(const hg_real *values, int n)
{
    hg_real lanes[16] = { 0 }, total = 0;
    int k = 0;
    for (; k + 16 <= n; k += 16)
        for (int l = 0; l < 16; l++) lanes[l] += values[k + l];
    for (int l = 0; k + l < n; l++) lanes[l] += values[k + l];
    for (int l = 0; l < 16; l++) total += lanes[l];
    return total;
}

/* Appends the neighbours of `place`, itself included, within one run of places; where `slope` is given, only those that
 * have one. */
static inline void HG_P(gather)(const hg_cells *cells, int64_t place, int32_t first, int32_t last, hg_real radius2,
                                const hg_real *slope, HG_P(gathered) * to)
{
    const hg_real *x = cells->x, *y = cells->y, *z = cells->z;
    int32_t *hits = to->place + to->n;
    hg_real *distance2 = to->value + to->n;
    int n = HG_P(hg_scan)(x, y, z, first, last, x[place], y[place], z[place], radius2, hits, distance2);
    if (slope) {
        int kept = 0;
        for (int h = 0; h < n; h++) { /* written always, kept sometimes: no branch to mispredict */
            hits[kept] = hits[h];
            distance2[kept] = distance2[h];
            kept += slope[hits[h]] != 0;
        }
        n = kept;
    }
    to->n += n;
}

/* Value or derivative of the kernel at every gathered distance. */
static void HG_P(run_kernel)(const field_pass *pass, HG_P(gathered) * hits, bool derivative)
{
    for (int k = 0; k < hits->n; k++) hits->value[k] = HG_MATH(sqrt)(hits->value[k]);
    const void *in[HG_PASS_INPUTS] = { NULL };
    in[pass->kernel_distance] = hits->value;
    hg_real out[LANES];
    void *outs[2] = { derivative ? NULL : out, out };
    hg_function_run(derivative ? pass->kernel_slope : pass->kernel, HG_TYPE, hits->n, in, pass->kernel_inputs.uniform,
                    outs);
    if (derivative) { /* W'/r: what the difference of positions is multiplied with; at r = 0 nothing */
        for (int k = 0; k < hits->n; k++) hits->value[k] = hits->value[k] > 0 ? out[k] / hits->value[k] : 0;
    } else {
        memcpy(hits->value, out, (size_t)hits->n * sizeof *out);
    }
}

static void HG_P(flush_field)(const HG_P(field_args) * a, HG_P(gathered) * hits)
{
    HG_P(run_kernel)(a->pass, hits, false);
    hits->first[hits->n_owners] = hits->n;
    for (int o = 0; o < hits->n_owners; o++) {
        int first = hits->first[o], n = hits->first[o + 1] - first;
        if (a->mass)
            for (int k = first; k < first + n; k++) hits->value[k] *= a->mass[hits->place[k]];
        a->field[a->cells->index[hits->owner[o]]] += HG_P(sum)(hits->value + first, n);
    }
    hits->n = hits->n_owners = 0;
}

static void HG_P(flush_gradient)(const HG_P(field_args) * a, HG_P(gathered) * hits)
{
    const hg_real *x = a->cells->x, *y = a->cells->y, *z = a->cells->z;
    HG_P(run_kernel)(a->pass, hits, true);
    hits->first[hits->n_owners] = hits->n;
    for (int o = 0; o < hits->n_owners; o++) {
        int32_t i = hits->owner[o];
        hg_real lanes[3][16] = { { 0 } }, mass_i = a->mass ? a->mass[i] : 1, slope_i = a->slope_place[i];
        for (int k = hits->first[o]; k < hits->first[o + 1]; k += 16) {
            int n = hits->first[o + 1] - k < 16 ? hits->first[o + 1] - k : 16;
            for (int l = 0; l < n; l++) {
                int32_t j = hits->place[k + l];
                hg_real both = slope_i * (a->mass ? a->mass[j] : 1) + a->slope_place[j] * mass_i;
                both *= hits->value[k + l];
                lanes[0][l] += both * (x[i] - x[j]);
                lanes[1][l] += both * (y[i] - y[j]);
                lanes[2][l] += both * (z[i] - z[j]);
            }
        }
        hg_real *to = a->gradient + 3 * (int64_t)a->cells->index[i];
        for (int axis = 0; axis < 3; axis++) to[axis] += HG_P(sum)(lanes[axis], 16);
    }
    hits->n = hits->n_owners = 0;
}

/* Walks the neighbours of all places of a block; `gradient` chooses what is done with them. */
static void HG_P(walk)(const HG_P(field_args) * a, int64_t first, int64_t last, bool gradient)
{
    const hg_cells *cells = a->cells;
    const hg_real radius = (hg_real)a->pass->radius, radius2 = radius * radius;
    HG_P(gathered) hits;
    int32_t runs[HG_CELL_RUNS][2], cell = -1;
    int n_runs = 0;
    hits.n = hits.n_owners = 0;
    for (int64_t i = first; i < last; i++) {
        if (cells->cell[i] != cell) {
            cell = cells->cell[i];
            n_runs = hg_cells_runs(cells, cell, runs);
        }
        /* Where this vertex has no slope of its own, only neighbours that have one matter. */
        const hg_real *only = gradient && a->slope_place[i] == 0 ? a->slope_place : NULL;
        bool open = false;
        for (int r = 0; r < n_runs; r++)
            for (int32_t from = runs[r][0]; from < runs[r][1]; from += HG_SCAN_PIECE) {
                int32_t to = runs[r][1] - from < HG_SCAN_PIECE ? runs[r][1] : from + HG_SCAN_PIECE;
                if (hits.n + (to - from) + HG_CELL_PAD > LANES || (!open && hits.n_owners == OWNERS)) {
                    if (gradient)
                        HG_P(flush_gradient)(a, &hits);
                    else
                        HG_P(flush_field)(a, &hits);
                    open = false;
                }
                if (!open) {
                    hits.owner[hits.n_owners] = (int32_t)i;
                    hits.first[hits.n_owners++] = hits.n;
                    open = true;
                }
                HG_P(gather)(cells, i, from, to, radius2, only, &hits);
            }
    }
    if (gradient)
        HG_P(flush_gradient)(a, &hits);
    else
        HG_P(flush_field)(a, &hits);
}

static void HG_P(sum_field)(const void *args, int64_t first, int64_t last)
{
    const HG_P(field_args) *a = args;
    for (int64_t i = first; i < last; i++) a->field[a->cells->index[i]] = 0;
    HG_P(walk)(a, first, last, false);
}

static void HG_P(gather_gradient)(const void *args, int64_t first, int64_t last)
{
    HG_P(walk)(args, first, last, true);
}

/* The function of the sum, over whole strands. */
static void HG_P(evaluate_field)(const void *args, int64_t first, int64_t last)
{
    const HG_P(field_args) *a = args;
    const field_pass *pass = a->pass;
    int64_t groom_start = a->groom * pass->strands * pass->vertices;
    for (int64_t s = first; s < last; s++) {
        double sum = 0.0;
        for (int64_t v = 0; v < pass->vertices; v += CHUNK) {
            int64_t n = pass->vertices - v < CHUNK ? pass->vertices - v : CHUNK, at = s * pass->vertices + v;
            const void *in[HG_PASS_INPUTS] = { NULL };
            hg_real energy[CHUNK];
            in[pass->field_input] = a->field + at;
            in[pass->field_rest_input] = a->field_rest + at;
            in[pass->mass_input] = (const hg_real *)pass->mass_values + groom_start + at;
            for (int k = 0; k < pass->n_attributes; k++)
                in[pass->attribute_input[k]] = (const hg_real *)pass->attribute_values[k] + groom_start + at;
            hg_function_run(pass->function, HG_TYPE, n, in, pass->inputs.uniform, (void *[]){ energy, a->slope + at });
            for (int64_t k = 0; k < n; k++) {
                sum += (double)energy[k];
                a->slope[at + k] *= (hg_real)pass->weight;
            }
        }
        a->strand_energies[s] = sum;
    }
}

static void HG_P(place_slopes)(const void *args, int64_t first, int64_t last)
{
    const HG_P(field_args) *a = args;
    for (int64_t i = first; i < last; i++) a->slope_place[i] = a->slope[a->cells->index[i]];
}

static void HG_P(place_masses)(const void *args, int64_t first, int64_t last)
{
    const HG_P(field_args) *a = args;
    const hg_real *from = (const hg_real *)a->pass->mass_values + a->groom * a->pass->strands * a->pass->vertices;
    for (int64_t i = first; i < last; i++) ((hg_real *)a->pass->mass_place)[i] = from[a->cells->index[i]];
}

/* The field of positions x [n,3] into pass->field; vertices that are not finite get none. */
static hg_status HG_P(make_field)(field_pass *pass, hg_ctx *ctx, HG_P(field_args) * args, const hg_real *x)
{
    static const hg_kernel masses = {
        .name = "field_masses", .args_size = sizeof(HG_P(field_args)), .cpu = HG_P(place_masses), .block = PLACES
    };
    static const hg_kernel sums = {
        .name = "field_sums", .args_size = sizeof(HG_P(field_args)), .cpu = HG_P(sum_field), .block = PLACES
    };
    int64_t n = pass->strands * pass->vertices;
    HG_TRY(hg_cells_build(ctx, &pass->cells, HG_TYPE, n, x, pass->radius));
    if (pass->cells.n < n) memset(args->field, 0, (size_t)n * sizeof *args->field);
    if (pass->weighs) HG_TRY(hg_launch(ctx, &masses, pass->cells.n, args));
    return hg_launch(ctx, &sums, pass->cells.n, args);
}

static hg_status HG_P(run_frame)(field_pass *pass, hg_ctx *ctx, const hg_frame *frame, const hg_tensor *x, int64_t b,
                                 void *gradient, double *unweighted, double *strand_energies, int64_t stride)
{
    static const hg_kernel evaluate = {
        .name = "field_evaluate", .args_size = sizeof(HG_P(field_args)), .cpu = HG_P(evaluate_field), .block = 64
    };
    static const hg_kernel slopes = {
        .name = "field_slopes", .args_size = sizeof(HG_P(field_args)), .cpu = HG_P(place_slopes), .block = PLACES
    };
    static const hg_kernel gather = {
        .name = "field_gradient", .args_size = sizeof(HG_P(field_args)), .cpu = HG_P(gather_gradient), .block = PLACES
    };
    int64_t n = pass->strands * pass->vertices, groom = frame->groom ? frame->groom[b] : 0;
    HG_P(field_args)
    args = { pass,
             groom,
             &pass->cells,
             pass->weighs ? pass->mass_place : NULL,
             (const hg_real *)pass->field_rest + groom * n,
             pass->field,
             pass->slope,
             pass->slope_place,
             gradient ? (hg_real *)gradient + 3 * n * b : NULL,
             pass->strand_energies };
    HG_TRY(HG_P(make_field)(pass, ctx, &args, (const hg_real *)x->data + 3 * n * b));
    HG_TRY(hg_launch(ctx, &evaluate, pass->strands, &args));
    for (int64_t s = 0; s < pass->strands; s++) {
        *unweighted += pass->strand_energies[s];
        if (strand_energies) strand_energies[s * stride] = pass->strand_energies[s];
    }
    if (!gradient) return HG_OK;
    HG_TRY(hg_launch(ctx, &slopes, pass->cells.n, &args));
    return hg_launch(ctx, &gather, pass->cells.n, &args);
}
