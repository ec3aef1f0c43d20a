/* One frame of the pairs pass, for one precision: hg_real, HG_P(name) and HG_MATH(name) are set by physics_pairs.c, the
 * only place that includes this.
 */

typedef struct {
    const pairs_pass *pass;
    const hg_pairs *pairs;
    int64_t groom;
    const hg_real *x;  /* [n,3] of this frame */
    hg_real *gradient; /* [n,3] of this frame, NULL: not wanted */
    double *sums;      /* energy of every block of pairs */
} HG_P(pairs_args);

static void HG_P(evaluate_pairs)(const void *args, int64_t first, int64_t last)
{
    const HG_P(pairs_args) *a = args;
    const pairs_pass *pass = a->pass;
    const int32_t *pairs = a->pairs->pairs;
    int64_t from = a->groom * pass->strands * pass->vertices;
    hg_real distance[BLOCK], energy[BLOCK], slope[BLOCK], gathered[2 + 2 * HG_PASS_ATTRIBUTES][BLOCK];
    hg_real direction[BLOCK][3];
    const void *in[HG_PASS_INPUTS] = { NULL };
    in[pass->distance] = distance;
    in[pass->rest_distance] = (const hg_real *)pass->rest_distances[a->groom] + first;
    int64_t count = last - first;
    for (int64_t k = 0; k < count; k++) {
        const hg_real *xi = a->x + 3 * (int64_t)pairs[2 * (first + k)],
                      *xj = a->x + 3 * (int64_t)pairs[2 * (first + k) + 1];
        hg_real dx = xi[0] - xj[0], dy = xi[1] - xj[1], dz = xi[2] - xj[2];
        distance[k] = HG_MATH(sqrt)(dx * dx + dy * dy + dz * dz);
        hg_real inverse = distance[k] > 0 ? 1 / distance[k] : 0; /* the gradient of a norm at zero is zero */
        direction[k][0] = dx * inverse;
        direction[k][1] = dy * inverse;
        direction[k][2] = dz * inverse;
    }
    int taken = 0;
    for (int side = 0; side < 2; side++)
        for (int v = -1; v < pass->n_attributes; v++) {
            int input = v < 0 ? pass->mass[side] : pass->attribute[v][side];
            if (input < 0) continue;
            const hg_real *values = (const hg_real *)(v < 0 ? pass->mass_values : pass->attribute_values[v]) + from;
            for (int64_t k = 0; k < count; k++) gathered[taken][k] = values[pairs[2 * (first + k) + side]];
            in[input] = gathered[taken++];
        }
    hg_function_run(pass->function, pass->dtype, count, in, pass->inputs.uniform, (void *[]){ energy, slope });
    hg_real *forces = pass->forces;
    double sum = 0.0;
    for (int64_t k = 0; k < count; k++) {
        pass->energies[first + k] = (double)energy[k];
        sum += (double)energy[k];
        for (int axis = 0; axis < 3; axis++)
            forces[3 * (first + k) + axis] = (hg_real)pass->weight * slope[k] * direction[k][axis];
    }
    a->sums[first / BLOCK] = sum;
}

static void HG_P(gather_pairs)(const void *args, int64_t first, int64_t last)
{
    const HG_P(pairs_args) *a = args;
    const hg_real *forces = a->pass->forces;
    for (int64_t v = first; v < last; v++) {
        hg_real sum[3] = { 0, 0, 0 };
        for (int64_t k = a->pairs->start[v]; k < a->pairs->start[v + 1]; k++) {
            const hg_real *force = forces + 3 * (int64_t)(a->pairs->incident[k] >> 1);
            hg_real sign = a->pairs->incident[k] & 1 ? -1 : 1;
            for (int axis = 0; axis < 3; axis++) sum[axis] += sign * force[axis];
        }
        for (int axis = 0; axis < 3; axis++) a->gradient[3 * v + axis] += sum[axis];
    }
}

static hg_status HG_P(run_frame)(pairs_pass *pass, hg_ctx *ctx, const hg_frame *frame, const hg_tensor *x, int64_t b,
                                 void *gradient, double *unweighted, double *strand_energies, int64_t stride)
{
    static const hg_kernel evaluate = {
        .name = "pairs_evaluate", .args_size = sizeof(HG_P(pairs_args)), .cpu = HG_P(evaluate_pairs), .block = BLOCK
    };
    static const hg_kernel gather = {
        .name = "pairs_gather", .args_size = sizeof(HG_P(pairs_args)), .cpu = HG_P(gather_pairs), .block = GATHER
    };
    int64_t n = pass->strands * pass->vertices, groom = frame->groom ? frame->groom[b] : 0;
    const hg_pairs *pairs = pass->pairs[groom];
    HG_P(pairs_args)
    args = { pass,
             pairs,
             groom,
             (const hg_real *)x->data + 3 * n * b,
             gradient ? (hg_real *)gradient + 3 * n * b : NULL,
             pass->sums };
    HG_TRY(hg_launch(ctx, &evaluate, pairs->n_pairs, &args));
    for (int64_t k = 0; k < (pairs->n_pairs + BLOCK - 1) / BLOCK; k++) *unweighted += pass->sums[k];
    if (strand_energies) { /* a pair counts for the strand of its first vertex */
        for (int64_t s = 0; s < pass->strands; s++) strand_energies[s * stride] = 0.0;
        for (int64_t p = 0; p < pairs->n_pairs; p++)
            strand_energies[pairs->pairs[2 * p] / pass->vertices * stride] += pass->energies[p];
    }
    if (gradient) HG_TRY(hg_launch(ctx, &gather, n, &args));
    return HG_OK;
}
