/* One frame of the field pass, for one precision: hg_real, HG_P(name) and HG_MATH(name) are set by physics_field.c, the
 * only place that includes this.
 */

typedef struct {
    const field_pass *pass;
    const hg_pass_frame *frame;
    const hg_cells *cells;
    const hg_real *mass;        /* [places], NULL: all 1 */
    const hg_real *vertex_mass; /* [n] what it is made of */
    const hg_real *field_rest;  /* [n] */
    hg_real *field;             /* [n] sum over neighbours */
    const hg_real *slope;       /* [n] dE/dfield, times the weight */
    hg_real *slope_place;       /* [places] the same in the order of places */
    hg_real *gradient;          /* [n,3] in the positions */
    hg_real *mass_gradient;     /* [n] in the masses of the kernel */
    int theta;                  /* input of the kernel whose derivative is summed, */
    double *theta_place;        /* [places] of every place */
} HG_P(field_args);

typedef enum { HG_P(WALK_THETA), HG_P(WALK_MASS) } HG_P(walk_kind);

/* Hits of several points, one after another, until there are enough lanes to be worth a run of the kernel function. */
typedef struct {
    int n, n_owners;
    int32_t place[LANES];
    hg_real value[LANES];                     /* squared distance, then distance, then W or W' */
    int32_t owner[OWNERS], first[OWNERS + 1]; /* places whose hits these are */
} HG_P(gathered);

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

/* The kernel at every gathered distance: its value, or its derivative in an input. */
static void HG_P(run_kernel)(const field_pass *pass, HG_P(gathered) * hits, HG_P(walk_kind) kind, int theta)
{
    const void *in[HG_PASS_INPUTS] = { NULL };
    hg_real out[LANES];
    void *outs[HG_PASS_INPUTS + 1] = { NULL };
    outs[kind == HG_P(WALK_THETA) ? 1 + theta : 0] = out;
    for (int k = 0; k < hits->n; k++) hits->value[k] = HG_MATH(sqrt)(hits->value[k]);
    in[pass->kernel_distance] = hits->value;
    hg_function_run(kind == HG_P(WALK_THETA) ? pass->kernel_full : pass->kernel, HG_TYPE, hits->n, in,
                    pass->kernel_inputs.uniform, outs);
    memcpy(hits->value, out, (size_t)hits->n * sizeof *out);
}

/* theta: slope_i sum_j m_j dW_ij/dtheta of every place i. mass: sum_j slope_j W_ij, which is dE/dm_i. */
static void HG_P(flush)(const HG_P(field_args) * a, HG_P(gathered) * hits, HG_P(walk_kind) kind)
{
    const hg_real *factor = kind == HG_P(WALK_THETA) ? a->mass : a->slope_place;
    HG_P(run_kernel)(a->pass, hits, kind, a->theta);
    hits->first[hits->n_owners] = hits->n;
    for (int o = 0; o < hits->n_owners; o++) {
        const int32_t i = hits->owner[o];
        double sum = 0.0;
        for (int k = hits->first[o]; k < hits->first[o + 1]; k++)
            sum += (double)hits->value[k] * (factor ? (double)factor[hits->place[k]] : 1.0);
        if (kind == HG_P(WALK_THETA))
            a->theta_place[i] += sum * (double)a->slope_place[i];
        else
            a->mass_gradient[a->cells->index[i]] += (hg_real)sum;
    }
    hits->n = hits->n_owners = 0;
}

/* Walks the neighbours of all places of a block; `kind` chooses what is done with them. */
static void HG_P(walk)(const HG_P(field_args) * a, int64_t first, int64_t last, HG_P(walk_kind) kind)
{
    const hg_cells *cells = a->cells;
    const hg_real radius = (hg_real)a->pass->radius, radius2 = radius * radius;
    HG_P(gathered) hits;
    int32_t runs[HG_CELL_RUNS][2], cell = -1;
    int n_runs = 0;
    hits.n = hits.n_owners = 0;
    for (int64_t i = first; i < last; i++) {
        if (kind == HG_P(WALK_THETA) && a->slope_place[i] == 0) continue;
        if (cells->cell[i] != cell) {
            cell = cells->cell[i];
            n_runs = hg_cells_runs(cells, cell, runs);
        }
        const hg_real *only =
            kind == HG_P(WALK_MASS) ? a->slope_place : NULL; /* neighbours without a slope add nothing */
        bool open = false;
        for (int r = 0; r < n_runs; r++)
            for (int32_t from = runs[r][0]; from < runs[r][1]; from += HG_SCAN_PIECE) {
                int32_t to = runs[r][1] - from < HG_SCAN_PIECE ? runs[r][1] : from + HG_SCAN_PIECE;
                if (hits.n + (to - from) + HG_CELL_PAD > LANES || (!open && hits.n_owners == OWNERS)) {
                    HG_P(flush)(a, &hits, kind);
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
    HG_P(flush)(a, &hits, kind);
}

static void HG_P(sum_theta)(const void *args, int64_t first, int64_t last)
{
    const HG_P(field_args) *a = args;
    for (int64_t i = first; i < last; i++) a->theta_place[i] = 0;
    HG_P(walk)(a, first, last, HG_P(WALK_THETA));
}

static void HG_P(gather_mass)(const void *args, int64_t first, int64_t last)
{
    HG_P(walk)(args, first, last, HG_P(WALK_MASS));
}

/* The function of the sum, over whole strands. */
static void HG_P(evaluate_field)(const void *args, int64_t first, int64_t last)
{
    const HG_P(field_args) *a = args;
    const field_pass *pass = a->pass;
    const hg_pass *base = &pass->pass;
    const hg_pass_inputs *inputs = &pass->inputs;
    const int64_t V = base->vertices, groom = a->frame->groom * base->strands * V;
    const hg_real weight = (hg_real)base->term.weight;
    for (int64_t s = first; s < last; s++) {
        double uniform[HG_PASS_INPUTS], sum = 0.0;
        memcpy(uniform, inputs->uniform, sizeof uniform);
        for (int i = 0; i < inputs->n; i++)
            if (inputs->source[i] >= 0 && base->source[inputs->source[i]].shape == HG_PASS_STRAND)
                uniform[i] = (double)((const hg_real *)base->source[inputs->source[i]]
                                          .values)[a->frame->frame * base->strands + s];
        for (int64_t v = 0; v < V; v += CHUNK) {
            const int64_t n = V - v < CHUNK ? V - v : CHUNK, at = s * V + v;
            const void *in[HG_PASS_INPUTS] = { NULL };
            hg_real energy[CHUNK], slopes[HG_PASS_INPUTS][CHUNK], *slope = (hg_real *)pass->slope + at,
                                                                  *rest_slope = (hg_real *)pass->rest_slope + at;
            void *out[HG_PASS_INPUTS + 1] = { energy, slope };
            in[pass->field] = a->field + at;
            in[pass->field_rest] = a->field_rest + at;
            for (int i = 0; i < inputs->n; i++) {
                if (inputs->source[i] < 0) continue;
                const hg_pass_source *source = &base->source[inputs->source[i]];
                if (source->shape == HG_PASS_GROOM) in[i] = (const hg_real *)source->values + groom + at;
                if (source->gradient) out[1 + i] = slopes[i];
            }
            if (base->wants) out[1 + pass->field_rest] = rest_slope;
            hg_function_run(base->wants ? pass->full : pass->function, HG_TYPE, n, in, uniform, out);
            for (int64_t k = 0; k < n; k++) {
                sum += (double)energy[k];
                slope[k] *= weight;
            }
            if (!base->wants) continue;
            for (int64_t k = 0; k < n; k++) rest_slope[k] *= weight;
            for (int i = 0; i < inputs->n; i++) {
                const hg_pass_source *source = inputs->source[i] < 0 ? NULL : &base->source[inputs->source[i]];
                if (!source || !source->gradient) continue;
                if (source->shape == HG_PASS_GROOM)
                    for (int64_t k = 0; k < n; k++)
                        ((hg_real *)source->gradient)[groom + at + k] += weight * slopes[i][k];
                else
                    for (int64_t k = 0; k < n; k++) source->strands[s] += (double)weight * (double)slopes[i][k];
            }
            hg_real *given = base->source[HG_PASS_FIELD_REST].gradient;
            for (int64_t k = 0; given && k < n; k++) given[groom + at + k] += rest_slope[k];
        }
        base->strand_energies[s] = sum;
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
    for (int64_t i = first; i < last; i++) ((hg_real *)a->pass->mass_place)[i] = a->vertex_mass[a->cells->index[i]];
}

/* Cells of the positions x [n,3], and the masses in their order. */
static hg_status HG_P(make_cells)(field_pass *pass, hg_ctx *ctx, HG_P(field_args) * args, const hg_real *x)
{
    static const hg_kernel masses = {
        .name = "field_masses", .args_size = sizeof(HG_P(field_args)), .cpu = HG_P(place_masses), .block = PLACES
    };
    pass->kept = false;
    HG_TRY(hg_cells_build(ctx, &pass->cells, HG_TYPE, pass->pass.strands * pass->pass.vertices, x, pass->radius));
    return pass->weighs ? hg_launch(ctx, &masses, pass->cells.n, args) : HG_OK;
}

/* The field of positions x [n,3]; vertices that are not finite get none. */
static hg_status HG_P(make_field)(field_pass *pass, hg_ctx *ctx, const hg_real *x, const hg_real *mass, bool keep,
                                  hg_real *field)
{
    const int64_t n = pass->pass.strands * pass->pass.vertices;
    HG_P(field_args) args = { .pass = pass, .cells = &pass->cells, .vertex_mass = mass };
    HG_TRY(HG_P(make_cells)(pass, ctx, &args, x));
    if (pass->cells.n < n) memset(field, 0, (size_t)n * sizeof *field);
    return HG_P(pair_sums)(pass, ctx, pass->weighs ? pass->mass_place : NULL, keep, field);
}

/* What follows from the slope of E in a field whose positions are in the cells: derivatives in the positions, in the
 * params of the kernel and in its masses, as far as they are asked for. */
static hg_status HG_P(chain_field)(field_pass *pass, hg_ctx *ctx, HG_P(field_args) * args)
{
    static const hg_kernel slopes = {
        .name = "field_slopes", .args_size = sizeof(HG_P(field_args)), .cpu = HG_P(place_slopes), .block = PLACES
    };
    static const hg_kernel thetas = {
        .name = "field_params", .args_size = sizeof(HG_P(field_args)), .cpu = HG_P(sum_theta), .block = PLACES
    };
    static const hg_kernel weights = {
        .name = "field_weights", .args_size = sizeof(HG_P(field_args)), .cpu = HG_P(gather_mass), .block = PLACES
    };
    const int64_t places = pass->cells.n;
    HG_TRY(hg_launch(ctx, &slopes, places, args));
    if (args->gradient) HG_TRY(HG_P(pair_gradient)(pass, ctx, args->mass, args->slope_place, args->gradient));
    if (args->mass_gradient) HG_TRY(hg_launch(ctx, &weights, places, args));
    for (int i = 0; i < pass->kernel_inputs.n; i++) {
        const int param = pass->kernel_inputs.source[i];
        if (param < 0 || !pass->pass.source[param].gradient || !(pass->kernel_params >> param & 1)) continue;
        args->theta = i;
        HG_TRY(hg_launch(ctx, &thetas, places, args));
        for (int64_t k = 0; k < places; k++) pass->pass.source[param].sum += args->theta_place[k];
    }
    return HG_OK;
}

static hg_status HG_P(run_frame)(void *self, hg_ctx *ctx, const hg_pass_frame *frame)
{
    static const hg_kernel evaluate = {
        .name = "field_evaluate", .args_size = sizeof(HG_P(field_args)), .cpu = HG_P(evaluate_field), .block = 64
    };
    field_pass *pass = self;
    const hg_pass *base = &pass->pass;
    const int64_t n = base->strands * base->vertices, groom = frame->groom;
    const hg_pass_source *mass = &base->source[HG_PASS_MASS], *rest = &base->source[HG_PASS_REST],
                         *field_rest = &base->source[HG_PASS_FIELD_REST];
    const bool follows = hg_field_rest_follows(pass);
    const hg_real *rest_x = follows ? (const hg_real *)rest->values + 3 * groom * n : NULL;
    HG_P(field_args)
    args = { .pass = pass,
             .frame = frame,
             .cells = &pass->cells,
             .mass = pass->weighs ? pass->mass_place : NULL,
             .vertex_mass = (const hg_real *)mass->values + groom * n,
             .field = pass->sums,
             .slope = pass->slope,
             .slope_place = pass->slope_place,
             .gradient = frame->gradient,
             .mass_gradient = pass->weighs && mass->gradient ? (hg_real *)mass->gradient + groom * n : NULL,
             .theta_place = pass->theta_place };
    args.field_rest = (const hg_real *)(follows ? pass->rest_now : field_rest->values) + groom * n;
    if (follows && !pass->rest_made[groom]) {
        HG_TRY(HG_P(make_field)(pass, ctx, rest_x, args.vertex_mass, false, (hg_real *)pass->rest_now + groom * n));
        pass->rest_made[groom] = true;
    }
    HG_TRY(HG_P(make_field)(pass, ctx, frame->x, args.vertex_mass, frame->gradient != NULL, args.field));
    HG_TRY(hg_launch(ctx, &evaluate, base->strands, &args));
    if (!frame->gradient && !base->wants) return HG_OK;
    HG_TRY(HG_P(chain_field)(pass, ctx, &args));
    if (!follows || !base->wants) return HG_OK;
    args.slope = pass->rest_slope;
    args.gradient = rest->gradient ? (hg_real *)rest->gradient + 3 * groom * n : NULL;
    HG_TRY(HG_P(make_cells)(pass, ctx, &args, rest_x));
    return HG_P(chain_field)(pass, ctx, &args);
}
