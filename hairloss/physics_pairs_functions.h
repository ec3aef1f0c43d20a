/* One frame of the pairs pass, for one precision: hg_real, HG_P(name) and HG_MATH(name) are set by physics_pairs.c, the
 * only place that includes this.
 */

typedef struct {
    const pairs_pass *pass;
    const hg_pairs *pairs;
    const hg_pass_frame *frame;
} HG_P(pairs_args);

/* Distances of the pairs of a block, and the unit vectors from the second to the first; zero where they coincide. */
static void HG_P(pair_distances)(const hg_real *x, const int32_t *pairs, int64_t count, hg_real *distance,
                                 hg_real (*direction)[3])
{
    for (int64_t k = 0; k < count; k++) {
        const hg_real *xi = x + 3 * (int64_t)pairs[2 * k], *xj = x + 3 * (int64_t)pairs[2 * k + 1];
        hg_real dx = xi[0] - xj[0], dy = xi[1] - xj[1], dz = xi[2] - xj[2];
        distance[k] = HG_MATH(sqrt)(dx * dx + dy * dy + dz * dz);
        hg_real inverse = distance[k] > 0 ? 1 / distance[k] : 0; /* the gradient of a norm at zero is zero */
        direction[k][0] = dx * inverse;
        direction[k][1] = dy * inverse;
        direction[k][2] = dz * inverse;
    }
}

static void HG_P(keep_forces)(hg_real *to, int64_t count, const hg_real *slope, hg_real (*direction)[3], hg_real weight)
{
    for (int64_t k = 0; k < count; k++)
        for (int axis = 0; axis < 3; axis++) to[3 * k + axis] = weight * slope[k] * direction[k][axis];
}

static void HG_P(evaluate_pairs)(const void *args, int64_t first, int64_t last)
{
    const HG_P(pairs_args) *a = args;
    const pairs_pass *pass = a->pass;
    const hg_pass *base = &pass->pass;
    const int32_t *pairs = a->pairs->pairs + 2 * first;
    const int64_t n = base->strands * base->vertices, from = a->frame->groom * n, count = last - first;
    const hg_real weight = (hg_real)base->term.weight;
    hg_real distance[BLOCK], slope[BLOCK], direction[BLOCK][3];
    hg_real rest_distance[BLOCK], rest_slope[BLOCK], rest_direction[BLOCK][3], gathered[HG_PASS_INPUTS][BLOCK];
    const void *in[HG_PASS_INPUTS] = { NULL };
    void *out[HG_PASS_INPUTS + 1] = { (hg_real *)pass->energies + first, slope };
    HG_P(pair_distances)(a->frame->x, pairs, count, distance, direction);
    in[pass->distance] = distance;
    in[pass->rest_distance] = (const hg_real *)pass->rest_distances[a->frame->groom] + first;
    if (base->source[HG_PASS_REST].given) {
        HG_P(pair_distances)
        ((const hg_real *)base->source[HG_PASS_REST].values + 3 * from, pairs, count, rest_distance, rest_direction);
        in[pass->rest_distance] = rest_distance;
    }
    for (int i = 0; i < pass->inputs.n; i++) {
        if (pass->inputs.source[i] < 0) continue;
        const hg_pass_source *source = &base->source[pass->inputs.source[i]];
        const hg_real *values = source->values;
        const int side = pass->inputs.side[i];
        if (source->shape == HG_PASS_UNIFORM) continue;
        if (source->shape == HG_PASS_STRAND)
            for (int64_t k = 0; k < count; k++)
                gathered[i][k] = values[a->frame->frame * base->strands + pairs[2 * k] / base->vertices];
        else
            for (int64_t k = 0; k < count; k++) gathered[i][k] = values[from + pairs[2 * k + side]];
        in[i] = gathered[i];
    }
    for (int i = 0; base->wants && i < pass->inputs.n; i++)
        if (hg_pairs_wanted(pass, i))
            out[pass->slope_of[i]] = i == pass->rest_distance ? rest_slope : (hg_real *)pass->slopes[i] + first;
    hg_function_run(base->wants ? pass->full : pass->function, base->dtype, count, in, pass->inputs.uniform, out);
    if (a->frame->gradient) HG_P(keep_forces)((hg_real *)pass->forces + 3 * first, count, slope, direction, weight);
    if (base->wants && hg_pairs_wanted(pass, pass->rest_distance))
        HG_P(keep_forces)((hg_real *)pass->rest_forces + 3 * first, count, rest_slope, rest_direction, weight);
}

/* Sum of the forces of its pairs on a vertex; of the second of a pair it is the opposite. */
static void HG_P(add_forces)(const hg_pairs *pairs, int64_t v, const hg_real *forces, hg_real *to)
{
    hg_real sum[3] = { 0, 0, 0 };
    for (int64_t k = pairs->start[v]; k < pairs->start[v + 1]; k++) {
        const hg_real *force = forces + 3 * (int64_t)(pairs->incident[k] >> 1);
        hg_real sign = pairs->incident[k] & 1 ? -1 : 1;
        for (int axis = 0; axis < 3; axis++) sum[axis] += sign * force[axis];
    }
    for (int axis = 0; axis < 3; axis++) to[axis] += sum[axis];
}

/* Sum over the pairs of a vertex in which it is on that side. */
static double HG_P(sum_side)(const hg_pairs *pairs, int64_t v, int side, const hg_real *values)
{
    double sum = 0.0;
    for (int64_t k = pairs->start[v]; k < pairs->start[v + 1]; k++) { /* a branch would mostly be guessed wrong */
        const double value = (double)values[pairs->incident[k] >> 1];
        sum += (pairs->incident[k] & 1) == side ? value : 0.0;
    }
    return sum;
}

static void HG_P(gather_pairs)(const void *args, int64_t first, int64_t last)
{
    const HG_P(pairs_args) *a = args;
    const pairs_pass *pass = a->pass;
    const hg_pass *base = &pass->pass;
    const int64_t V = base->vertices, groom = a->frame->groom * base->strands * V;
    const double weight = base->term.weight;
    for (int64_t s = first; s < last; s++) {
        double sum = 0.0;
        for (int64_t v = s * V; v < (s + 1) * V; v++) sum += HG_P(sum_side)(a->pairs, v, 0, pass->energies);
        base->strand_energies[s] = sum;
        if (a->frame->gradient)
            for (int64_t v = s * V; v < (s + 1) * V; v++)
                HG_P(add_forces)(a->pairs, v, pass->forces, (hg_real *)a->frame->gradient + 3 * v);
        for (int i = 0; base->wants && i < pass->inputs.n; i++) {
            if (!hg_pairs_wanted(pass, i)) continue;
            const hg_pass_source *source =
                &base->source[i == pass->rest_distance ? HG_PASS_REST : pass->inputs.source[i]];
            for (int64_t v = s * V; v < (s + 1) * V; v++) {
                hg_real *to = source->gradient;
                if (i == pass->rest_distance)
                    HG_P(add_forces)(a->pairs, v, pass->rest_forces, to + 3 * (groom + v));
                else if (source->shape == HG_PASS_GROOM)
                    to[groom + v] +=
                        (hg_real)(weight * HG_P(sum_side)(a->pairs, v, pass->inputs.side[i], pass->slopes[i]));
                else
                    source->strands[s] += weight * HG_P(sum_side)(a->pairs, v, 0, pass->slopes[i]);
            }
        }
    }
}

static hg_status HG_P(run_frame)(void *self, hg_ctx *ctx, const hg_pass_frame *frame)
{
    static const hg_kernel evaluate = {
        .name = "pairs_evaluate", .args_size = sizeof(HG_P(pairs_args)), .cpu = HG_P(evaluate_pairs), .block = BLOCK
    };
    static const hg_kernel gather = {
        .name = "pairs_gather", .args_size = sizeof(HG_P(pairs_args)), .cpu = HG_P(gather_pairs), .block = STRANDS
    };
    const pairs_pass *pass = self;
    const HG_P(pairs_args) args = { pass, pass->pairs[frame->groom], frame };
    HG_TRY(hg_launch(ctx, &evaluate, args.pairs->n_pairs, &args));
    return hg_launch(ctx, &gather, pass->pass.strands, &args);
}
