/* Every pair of neighbours once, for one precision: the sums of a field, and its gradient in the positions. hg_real and
 * HG_P(name) are set by physics_field.c, the only place that includes this.
 *
 * A slab is a layer of cells along z. Of a vertex only the neighbours at later places are looked for, which lie in its own
 * slab and the next: slabs of even number write to no common place, so they are walked side by side, and then those of odd
 * number. The order of sums is that of slabs and places, whatever the threads. The pairs found for the sums are kept for
 * the gradient, with W'/r, where that takes no more than so many bytes; else they are found again. Both give the same
 * bits. */

/* x, y, z and the slope of a place; or the force on it, and what is not used */
typedef hg_real HG_P(four) __attribute__((vector_size(4 * sizeof(hg_real))));

typedef struct {
    field_pass *pass;
    const hg_cells *cells;
    const hg_real *mass;     /* [places], NULL: all 1 */
    hg_real *sums;           /* [places], NULL: gradient */
    HG_P(four) * at, *force; /* [places] */
    int64_t slabs;           /* of this colour */
    int colour;
    bool keep;
    hg_real alone; /* W(0): every vertex is its own neighbour */
    const int32_t *index;
    hg_real *out; /* [n] sums or [n,3] gradient */
    const hg_real *slope_place;
} HG_P(pair_args);

/* Pairs of several vertices, one after another, until there are enough lanes to be worth a run of the kernel function. */
typedef struct {
    int n, n_owners;
    int32_t place[LANES], owner[OWNERS], first[OWNERS + 1];
    hg_real value[LANES]; /* squared distance, then distance, then W or W'/r */
    hg_real weight[LANES];
} HG_P(batch);

/* What may be a neighbour of the vertices of a cell, copied so that it is scanned without a break. */
typedef struct {
    int32_t place[HG_SCAN_PIECE + HG_CELL_PAD];
    hg_real x[HG_SCAN_PIECE + HG_CELL_PAD], y[HG_SCAN_PIECE + HG_CELL_PAD], z[HG_SCAN_PIECE + HG_CELL_PAD];
    int n, own; /* the first `own` are of the cell's own row, from its own first place on */
    int32_t own_first;
} HG_P(candidates);

static hg_real HG_P(sum)(const hg_real *values, int n)
{
    hg_real lanes[16] = { 0 };
    int k = 0;
    for (; k + 16 <= n; k += 16)
        for (int l = 0; l < 16; l++) lanes[l] += values[k + l];
    for (int l = 0; k + l < n; l++) lanes[l] += values[k + l];
    for (int half = 8; half > 0; half /= 2)
        for (int l = 0; l < half; l++) lanes[l] += lanes[l + half];
    return lanes[0];
}

/* The forces of the pairs of one vertex. */
static void HG_P(pair_forces)(const HG_P(pair_args) * a, int32_t i, int n, const int32_t *place, const hg_real *value)
{
    const HG_P(four) at = a->at[i];
    HG_P(four) force = { 0 };
    for (int k = 0; k < n; k++) {
        const int32_t j = place[k];
        const HG_P(four) other = a->at[j];
        const hg_real both = a->mass ? at[3] * a->mass[j] + other[3] * a->mass[i] : at[3] + other[3];
        const HG_P(four) pull = both * value[k] * (at - other);
        force += pull;
        a->force[j] -= pull;
    }
    a->force[i] += force;
}

static void HG_P(flush_pairs)(const HG_P(pair_args) * a, HG_P(batch) * b, field_slab *slab)
{
    const field_pass *pass = a->pass;
    const void *in[HG_PASS_INPUTS] = { NULL };
    hg_real slope[LANES];
    const bool slopes = a->keep || !a->sums;
    void *outs[2] = { b->weight, slopes ? slope : NULL };
    for (int k = 0; k < b->n; k++) b->value[k] = HG_MATH(sqrt)(b->value[k]);
    in[pass->kernel_distance] = b->value;
    hg_function_run(slopes ? pass->kernel_slope : pass->kernel, HG_TYPE, b->n, in, pass->kernel_inputs.uniform, outs);
    if (slopes) /* at r = 0 there is no direction */
        for (int k = 0; k < b->n; k++) slope[k] = b->value[k] > 0 ? slope[k] / b->value[k] : 0;
    b->first[b->n_owners] = b->n;
    for (int o = 0; o < b->n_owners; o++) {
        const int32_t i = b->owner[o], first = b->first[o], n = b->first[o + 1] - first;
        const int32_t *place = b->place + first;
        hg_real *weight = b->weight + first;
        if (!a->sums) {
            HG_P(pair_forces)(a, i, n, place, slope + first);
            continue;
        }
        const hg_real mass = a->mass ? a->mass[i] : 1;
        for (int k = 0; k < n; k++) a->sums[place[k]] += mass * weight[k];
        if (a->mass)
            for (int k = 0; k < n; k++) weight[k] *= a->mass[place[k]];
        a->sums[i] += HG_P(sum)(weight, n);
    }
    if (a->keep && keep_pairs(slab, b->n_owners, b->owner, b->first, b->place, sizeof *slope, slope) != HG_OK)
        slab->failed = true;
    b->n = b->n_owners = 0;
}

/* The pairs of the vertices of a cell with its candidates. */
static void HG_P(pair_cell)(const HG_P(pair_args) * a, const HG_P(candidates) * c, int32_t first, int32_t last,
                            HG_P(batch) * b, field_slab *slab)
{
    const hg_real *x = a->cells->x, *y = a->cells->y, *z = a->cells->z;
    const hg_real radius = (hg_real)a->pass->radius, radius2 = radius * radius;
    for (int32_t i = first; i < last; i++) {
        int from = i + 1 - c->own_first; /* later places only */
        from = c->own == 0 || from < 0 ? 0 : from > c->own ? c->own : from;
        if (from >= c->n) continue;
        if (b->n + c->n + HG_CELL_PAD > LANES || b->n_owners == OWNERS) HG_P(flush_pairs)(a, b, slab);
        int32_t *hits = b->place + b->n;
        const int n = HG_P(hg_scan)(c->x, c->y, c->z, from, c->n, x[i], y[i], z[i], radius2, hits, b->value + b->n);
        if (n == 0) continue;
        for (int k = 0; k < n; k++) hits[k] = c->place[hits[k]];
        b->owner[b->n_owners] = i;
        b->first[b->n_owners++] = b->n;
        b->n += n;
    }
}

/* Whole vectors: both sides have so many elements more. */
static inline void HG_P(copy)(const hg_real *const from[3], int32_t first, int32_t n, HG_P(candidates) * c)
{
    for (int32_t k = 0; k < n; k += HG_CELL_PAD) {
        memcpy(c->x + c->n + k, from[0] + first + k, HG_CELL_PAD * sizeof(hg_real));
        memcpy(c->y + c->n + k, from[1] + first + k, HG_CELL_PAD * sizeof(hg_real));
        memcpy(c->z + c->n + k, from[2] + first + k, HG_CELL_PAD * sizeof(hg_real));
        for (int32_t l = 0; l < HG_CELL_PAD; l++) c->place[c->n + k + l] = first + k + l;
    }
}

static void HG_P(walk_slab)(const HG_P(pair_args) * a, int64_t layer)
{
    const hg_cells *cells = a->cells;
    const hg_real *from[3] = { cells->x, cells->y, cells->z };
    const int32_t nx = cells->size[0], ny = cells->size[1], nz = cells->size[2], *start = cells->start;
    field_slab *slab = &a->pass->slabs[layer];
    HG_P(batch) batch;
    HG_P(candidates) c;
    batch.n = batch.n_owners = 0;
    for (int32_t y = 0; y < ny; y++)
        for (int32_t x = 0; x < nx; x++) {
            const int32_t row = ((int32_t)layer * ny + y) * nx, cell = row + x, first = start[cell],
                          last = start[cell + 1];
            const int32_t left = x > 0 ? x - 1 : 0, right = (x + 1 < nx ? x + 1 : x) + 1;
            if (first == last) continue;
            int32_t runs[5][2] = { { first, start[row + right] } };
            int n_runs = 1;
            for (int32_t k = 0; k < 4; k++) { /* the row above, then three rows of the next layer */
                const int32_t above = k == 0 ? y + 1 : y + k - 2, slab_row = ((int32_t)layer + (k > 0)) * ny + above;
                if (above < 0 || above >= ny || (k > 0 && layer + 1 >= nz)) continue;
                runs[n_runs][0] = start[slab_row * nx + left];
                runs[n_runs][1] = start[slab_row * nx + right];
                n_runs += runs[n_runs][0] < runs[n_runs][1];
            }
            c.n = c.own = 0;
            c.own_first = first;
            for (int r = 0; r < n_runs; r++)
                for (int32_t at = runs[r][0]; at < runs[r][1];) {
                    const int32_t room = HG_SCAN_PIECE - c.n, left_over = runs[r][1] - at,
                                  n = left_over < room ? left_over : room;
                    if (r == 0 && c.n == 0) c.own_first = at;
                    HG_P(copy)(from, at, n, &c);
                    c.n += n;
                    c.own += r == 0 ? n : 0;
                    at += n;
                    if (c.n < HG_SCAN_PIECE) continue;
                    HG_P(pair_cell)(a, &c, first, last, &batch, slab);
                    c.n = c.own = 0;
                }
            if (c.n > 0) HG_P(pair_cell)(a, &c, first, last, &batch, slab);
        }
    HG_P(flush_pairs)(a, &batch, slab);
}

/* Number of the k-th slab of a colour: every second one first, so that halves of the launch are alike. */
static int64_t HG_P(slab_number)(const HG_P(pair_args) * a, int64_t k)
{
    const int64_t half = (a->slabs + 1) / 2;
    return 2 * (k < half ? 2 * k : 2 * (k - half) + 1) + a->colour;
}

static void HG_P(walk_slabs)(const void *args, int64_t first, int64_t last)
{
    for (int64_t k = first; k < last; k++) HG_P(walk_slab)(args, HG_P(slab_number)(args, k));
}

static void HG_P(kept_slabs)(const void *args, int64_t first, int64_t last)
{
    const HG_P(pair_args) *a = args;
    for (int64_t k = first; k < last; k++) {
        const field_slab *slab = &a->pass->slabs[HG_P(slab_number)(a, k)];
        for (const field_piece *piece = slab->last ? slab->first : NULL; piece;
             piece = piece == slab->last ? NULL : piece->next) {
            const int32_t *place = piece->place;
            const hg_real *value = (const hg_real *)(const void *)piece->value;
            for (int o = 0; o < piece->n_owners; o++) {
                HG_P(pair_forces)(a, piece->owner[o], piece->count[o], place, value);
                place += piece->count[o];
                value += piece->count[o];
            }
        }
    }
}

static void HG_P(begin_sums)(const void *args, int64_t first, int64_t last)
{
    const HG_P(pair_args) *a = args;
    for (int64_t i = first; i < last; i++) a->sums[i] = a->alone * (a->mass ? a->mass[i] : 1);
}

static void HG_P(end_sums)(const void *args, int64_t first, int64_t last)
{
    const HG_P(pair_args) *a = args;
    for (int64_t i = first; i < last; i++) a->out[a->index[i]] = a->sums[i];
}

static void HG_P(begin_forces)(const void *args, int64_t first, int64_t last)
{
    const HG_P(pair_args) *a = args;
    const hg_real *x = a->cells->x, *y = a->cells->y, *z = a->cells->z;
    for (int64_t i = first; i < last; i++) {
        a->at[i] = (HG_P(four)){ x[i], y[i], z[i], a->slope_place[i] };
        a->force[i] = (HG_P(four)){ 0 };
    }
}

static void HG_P(end_forces)(const void *args, int64_t first, int64_t last)
{
    const HG_P(pair_args) *a = args;
    for (int64_t i = first; i < last; i++)
        for (int k = 0; k < 3; k++) a->out[3 * (int64_t)a->index[i] + k] += a->force[i][k];
}

static hg_status HG_P(both_colours)(hg_ctx *ctx, const hg_kernel *kernel, HG_P(pair_args) * args)
{
    for (args->colour = 0; args->colour < 2; args->colour++) {
        args->slabs = (args->cells->size[2] + 1 - args->colour) / 2;
        HG_TRY(hg_launch(ctx, kernel, args->slabs, args));
    }
    return HG_OK;
}

/* sums [n] of the cells' points; those that are not finite are left as they are. keep: a gradient follows. */
static hg_status HG_P(pair_sums)(field_pass *pass, hg_ctx *ctx, const hg_real *mass, bool keep, hg_real *sums)
{
    static const hg_kernel begin = { .name = "field_begin_sums",
                                     .args_size = sizeof(HG_P(pair_args)),
                                     .cpu = HG_P(begin_sums) };
    static const hg_kernel walk = {
        .name = "field_sums", .args_size = sizeof(HG_P(pair_args)), .cpu = HG_P(walk_slabs), .block = 1
    };
    static const hg_kernel end = { .name = "field_end_sums",
                                   .args_size = sizeof(HG_P(pair_args)),
                                   .cpu = HG_P(end_sums) };
    const hg_cells *cells = &pass->cells;
    HG_TRY(begin_slabs(pass));
    const hg_step_mark mark = hg_step_set_mark(ctx);
    HG_P(pair_args)
    args = { .pass = pass,
             .cells = cells,
             .mass = mass,
             .sums = hg_step_alloc(ctx, (size_t)cells->n * sizeof(hg_real) + 1),
             .keep = keep && cells->n <= MOST_KEPT,
             .index = cells->index,
             .out = sums };
    if (!args.sums) return HG_MEMORY;
    const hg_real zero = 0;
    const void *in[HG_PASS_INPUTS] = { NULL };
    in[pass->kernel_distance] = &zero;
    hg_function_run(pass->kernel, HG_TYPE, 1, in, pass->kernel_inputs.uniform, (void *[]){ &args.alone });
    hg_status status = hg_launch(ctx, &begin, cells->n, &args);
    if (status == HG_OK) status = HG_P(both_colours)(ctx, &walk, &args);
    if (status == HG_OK) status = hg_launch(ctx, &end, cells->n, &args);
    hg_step_rewind(ctx, mark);
    for (int64_t s = 0; s < cells->size[2]; s++)
        if (pass->slabs[s].failed) return hg_fail(HG_MEMORY, "out of memory for the neighbours of a field");
    pass->kept = args.keep;
    return status;
}

/* gradient [n,3] += of the cells' points, slope_place [places] dE/dfield. */
static hg_status HG_P(pair_gradient)(field_pass *pass, hg_ctx *ctx, const hg_real *mass, const hg_real *slope_place,
                                     hg_real *gradient)
{
    static const hg_kernel begin = { .name = "field_begin_forces",
                                     .args_size = sizeof(HG_P(pair_args)),
                                     .cpu = HG_P(begin_forces) };
    static const hg_kernel walk = {
        .name = "field_forces", .args_size = sizeof(HG_P(pair_args)), .cpu = HG_P(walk_slabs), .block = 1
    };
    static const hg_kernel kept = {
        .name = "field_forces", .args_size = sizeof(HG_P(pair_args)), .cpu = HG_P(kept_slabs), .block = 1
    };
    static const hg_kernel end = { .name = "field_end_forces",
                                   .args_size = sizeof(HG_P(pair_args)),
                                   .cpu = HG_P(end_forces) };
    const hg_cells *cells = &pass->cells;
    HG_TRY(begin_slabs(pass));
    const hg_step_mark mark = hg_step_set_mark(ctx);
    const size_t bytes = (size_t)cells->n * sizeof(HG_P(four)) + 1;
    HG_P(pair_args)
    args = { .pass = pass,
             .cells = cells,
             .mass = mass,
             .at = hg_step_alloc(ctx, bytes),
             .force = hg_step_alloc(ctx, bytes),
             .index = cells->index,
             .out = gradient,
             .slope_place = slope_place };
    if (!args.at || !args.force) return HG_MEMORY;
    hg_status status = hg_launch(ctx, &begin, cells->n, &args);
    if (status == HG_OK) status = HG_P(both_colours)(ctx, pass->kept ? &kept : &walk, &args);
    if (status == HG_OK) status = hg_launch(ctx, &end, cells->n, &args);
    hg_step_rewind(ctx, mark);
    return status;
}
