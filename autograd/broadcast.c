/* Broadcasting; see broadcast.h. */
#include "autograd/broadcast.h"

#include <string.h>

bool hg_broadcast_plan(const hg_call *call, int item_axes, hg_broadcast *plan, int *rank, int64_t *shape)
{
    const hg_tensor *in[2] = { call->in[0], call->in[1] };
    int ranks[2] = { in[0]->rank - item_axes, in[1]->rank - item_axes };
    *rank = ranks[0] > ranks[1] ? ranks[0] : ranks[1];
    *plan = (hg_broadcast){ .count = 1, .in_count = { 1, 1 }, .segment = 1 };
    int64_t size[HG_MAX_RANK], stride[2][HG_MAX_RANK];
    for (int i = *rank; i-- > 0;) {
        int64_t n[2];
        for (int j = 0; j < 2; j++) {
            int axis = i - (*rank - ranks[j]);
            n[j] = axis >= 0 ? in[j]->shape[axis] : 1;
        }
        if (n[0] != n[1] && n[0] != 1 && n[1] != 1) {
            hg_refuse(call, "axes of %lld and %lld elements do not fit", (long long)n[0], (long long)n[1]);
            return false;
        }
        shape[i] = size[i] = n[0] == 1 ? n[1] : n[0];
        for (int j = 0; j < 2; j++) {
            stride[j][i] = n[j] == 1 ? 0 : plan->in_count[j];
            plan->in_count[j] *= n[j];
        }
        plan->count *= size[i];
    }
    /* Merge from the inside: axis i joins the one inside it when both inputs step over it without a gap. */
    int merged = 0;
    int64_t merged_size[HG_MAX_RANK], merged_stride[2][HG_MAX_RANK]; /* innermost first */
    for (int i = *rank; i-- > 0;) {
        if (size[i] == 1) continue;
        bool joins = merged > 0;
        for (int j = 0; joins && j < 2; j++)
            joins = stride[j][i] == merged_stride[j][merged - 1] * merged_size[merged - 1];
        if (joins) {
            merged_size[merged - 1] *= size[i];
            continue;
        }
        merged_size[merged] = size[i];
        for (int j = 0; j < 2; j++) merged_stride[j][merged] = stride[j][i];
        merged++;
    }
    if (merged == 0) return true; /* one item */
    plan->segment = merged_size[0];
    for (int j = 0; j < 2; j++) plan->step[j] = merged_stride[j][0];
    plan->rank = merged - 1;
    for (int i = 0; i < plan->rank; i++) {
        plan->size[i] = merged_size[merged - 1 - i];
        for (int j = 0; j < 2; j++) plan->stride[j][i] = merged_stride[j][merged - 1 - i];
    }
    return true;
}

/* ---- how a gradient is added up ---- */

/* At most 64 chunks, of at least 4096 items, and copies of together at most twice the size of the output. */
static hg_broadcast_sum cut_for_cpu(const hg_broadcast *plan, int input)
{
    int64_t chunks = (plan->count + 4095) / 4096, in_count = plan->in_count[input] > 0 ? plan->in_count[input] : 1;
    if (chunks > 64) chunks = 64;
    if (chunks > 2 * plan->count / in_count) chunks = 2 * plan->count / in_count;
    if (chunks < 1) chunks = 1;
    int64_t length = (plan->count + chunks - 1) / chunks;
    if (length < 1) length = 1;
    return (hg_broadcast_sum){ .chunks = (plan->count + length - 1) / length, .length = length, .tiles = 1 };
}

/* The smallest power of two from n on, at most `most`. */
static int64_t power_of_two(int64_t n, int64_t most)
{
    int64_t power = 1;
    while (power < n && power < most) power *= 2;
    return power;
}

/* Blocks of threads that read stretches of neighbours, at least 16 items a thread, and no more than about 2048 blocks. */
static hg_broadcast_sum cut_for_gpu(const hg_broadcast *plan, int input)
{
    hg_broadcast_sum sum = { .rank = 0, .inside = plan->in_count[input] };
    sum.outside = plan->count / sum.inside;
    for (int kept = 1; kept >= 0; kept--) {
        int64_t position = 1;
        int64_t strides[HG_MAX_RANK + 1];
        for (int i = plan->rank; i >= 0; i--) {
            strides[i] = position;
            position *= i == plan->rank ? plan->segment : plan->size[i];
        }
        for (int i = 0; i <= plan->rank; i++) {
            const bool last = i == plan->rank;
            const int64_t step[2] = { last ? plan->step[0] : plan->stride[0][i],
                                      last ? plan->step[1] : plan->stride[1][i] };
            if ((step[input] != 0) != kept) continue;
            sum.size[sum.rank] = last ? plan->segment : plan->size[i];
            sum.stride[sum.rank][0] = step[0];
            sum.stride[sum.rank][1] = step[1];
            sum.stride[sum.rank][2] = strides[i];
            sum.rank++;
        }
        if (kept) sum.kept = sum.rank;
    }
    const int64_t together = plan->step[input] ? power_of_two(sum.inside, 32) : 1;
    const int64_t rows = power_of_two(sum.outside, HG_SUM_THREADS / together);
    sum.lanes = HG_SUM_THREADS / rows;
    sum.tiles = (sum.inside + sum.lanes - 1) / sum.lanes;
    int64_t chunks = (sum.outside + 16 * rows - 1) / (16 * rows), most = 2048 / sum.tiles;
    if (chunks > most) chunks = most > 0 ? most : 1;
    sum.length = (sum.outside + chunks - 1) / chunks;
    sum.chunks = (sum.outside + sum.length - 1) / sum.length;
    return sum;
}

/* ---- ops of two broadcast inputs ---- */

static hg_pair_args pair_arguments(const hg_call *call, int item_axes)
{
    const hg_tensor *a = call->in[0], *b = call->in[1];
    hg_pair_args args = { .width = item_axes ? a->shape[a->rank - 1] : 1, .a = a->data, .b = b->data };
    int rank;
    int64_t shape[HG_MAX_RANK];
    hg_broadcast_plan(call, item_axes, &args.plan, &rank, shape); /* checked by the shape rule */
    return args;
}

hg_status hg_pair_forward(hg_call *call, int item_axes, const hg_pair_kernels *kernels)
{
    hg_pair_args args = pair_arguments(call, item_axes);
    args.to = call->out->data;
    return hg_launch(call->ctx, kernels->forward[call->out->dtype == HG_F64], args.plan.count, &args);
}

/* The input was broadcast: partial sums, and their sum. */
static hg_status backward_by_sums(hg_call *call, const hg_kernel *kernel, hg_pair_args *args, int input, void *gradient)
{
    hg_tensor *in = call->in[input];
    const bool fresh = args->fresh;
    args->sum = hg_ctx_host(call->ctx) ? cut_for_cpu(&args->plan, input) : cut_for_gpu(&args->plan, input);
    const int64_t blocks = args->sum.chunks * args->sum.tiles;
    args->to = gradient;
    if (args->sum.chunks == 1 && !hg_ctx_host(call->ctx)) return hg_launch(call->ctx, kernel, blocks, args);
    hg_step_mark mark = hg_step_set_mark(call->ctx);
    const int64_t size = hg_tensor_count(in);
    hg_tensor *partial = hg_tensor_make(call->ctx, in->dtype, 2, (int64_t[]){ args->sum.chunks, size });
    if (!partial) return HG_MEMORY;
    args->to = partial->data;
    args->fresh = true;
    HG_TRY(hg_launch(call->ctx, kernel, blocks, args));
    if (hg_ctx_host(call->ctx))
        HG_TRY(hg_add_partials(call->ctx, in->dtype, args->sum.chunks, size, partial->data, gradient, fresh));
    else
        HG_TRY(hg_sum_middle(call->ctx, in->dtype, 1, args->sum.chunks, size, 1, partial->data, gradient, fresh));
    hg_step_rewind(call->ctx, mark);
    return HG_OK;
}

hg_status hg_pair_backward(hg_call *call, int item_axes, const hg_pair_kernels *kernels)
{
    hg_pair_args args = pair_arguments(call, item_axes);
    const int real = call->out->dtype == HG_F64;
    args.g = hg_grad(call->out)->data;
    if (args.plan.count == 0) return HG_OK;
    for (int input = 0; input < 2; input++) {
        bool fresh;
        if (!hg_needs_grad(call->in[input])) continue;
        args.to = hg_grad_data(call->in[input], &fresh);
        args.fresh = fresh;
        if (args.plan.in_count[input] == args.plan.count)
            HG_TRY(hg_launch(call->ctx, kernels->gradient[input][real], args.plan.count, &args));
        else
            HG_TRY(backward_by_sums(call, kernels->sum[input][real], &args, input, args.to));
    }
    return HG_OK;
}

/* The output's items have the leading axes of the longer input, whatever their own width. */
void hg_pair_items(const hg_call *call, int item_axes, int64_t item, int64_t at[2])
{
    const hg_tensor *const *in = (const hg_tensor *const *)call->in;
    int ranks[2] = { in[0]->rank - item_axes, in[1]->rank - item_axes };
    int rank = ranks[0] > ranks[1] ? ranks[0] : ranks[1];
    int64_t stride[2] = { 1, 1 };
    at[0] = at[1] = 0;
    for (int axis = 1; axis <= rank; axis++) {
        int64_t n[2];
        for (int j = 0; j < 2; j++) n[j] = axis <= ranks[j] ? in[j]->shape[ranks[j] - axis] : 1;
        int64_t size = n[0] == 1 ? n[1] : n[0], k = item % size;
        item /= size;
        for (int j = 0; j < 2; j++) {
            if (n[j] > 1) at[j] += k * stride[j];
            stride[j] *= n[j];
        }
    }
}
