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

/* At most 64 chunks, of at least 4096 items, and copies of together at most twice the size of the output. */
hg_broadcast_chunks hg_broadcast_cut(const hg_broadcast *plan, int input)
{
    int64_t chunks = (plan->count + 4095) / 4096, in_count = plan->in_count[input] > 0 ? plan->in_count[input] : 1;
    if (chunks > 64) chunks = 64;
    if (chunks > 2 * plan->count / in_count) chunks = 2 * plan->count / in_count;
    if (chunks < 1) chunks = 1;
    int64_t length = (plan->count + chunks - 1) / chunks;
    if (length < 1) length = 1;
    return (hg_broadcast_chunks){ (plan->count + length - 1) / length, length };
}

/* ---- ops of two broadcast inputs ---- */

typedef struct {
    hg_broadcast plan;
    const hg_pair_functions *functions;
    int real, input;                  /* 0: f32, 1: f64; the input whose gradient is made */
    int64_t width, size[2], out_size; /* elements of an item of a; bytes of the items */
    int64_t chunk;
    bool fresh;
    const char *a, *b, *g;
    char *out;
} pair_args;

static void pair_forward_cpu(const void *memory, int64_t first, int64_t last)
{
    const pair_args *p = memory;
    const hg_broadcast *plan = &p->plan;
    hg_walk walk;
    for (hg_walk_begin(&walk, plan, first); walk.position < last;) {
        int64_t n = hg_walk_length(&walk, plan, last);
        p->functions->forward[p->real](n, p->a + walk.at[0] * p->size[0], plan->step[0], p->b + walk.at[1] * p->size[1],
                                       plan->step[1], p->out + walk.position * p->out_size, p->width);
        hg_walk_next(&walk, plan, n);
    }
}

/* The input was not broadcast: its gradient lies like the output. */
static void pair_direct_cpu(const void *memory, int64_t first, int64_t last)
{
    const pair_args *p = memory;
    const hg_broadcast *plan = &p->plan;
    hg_walk walk;
    for (hg_walk_begin(&walk, plan, first); walk.position < last;) {
        int64_t n = hg_walk_length(&walk, plan, last);
        p->functions->gradient[p->input][p->real](n, p->g + walk.position * p->out_size, p->a + walk.at[0] * p->size[0],
                                                  plan->step[0], p->b + walk.at[1] * p->size[1], plan->step[1],
                                                  p->out + walk.position * p->size[p->input], 1, p->fresh, p->width);
        hg_walk_next(&walk, plan, n);
    }
}

static void pair_chunk_cpu(const void *memory, int64_t first, int64_t last)
{
    const pair_args *p = memory;
    const hg_broadcast *plan = &p->plan;
    for (int64_t chunk = first; chunk < last; chunk++) {
        char *copy = p->out + chunk * plan->in_count[p->input] * p->size[p->input];
        memset(copy, 0, (size_t)(plan->in_count[p->input] * p->size[p->input]));
        int64_t end = (chunk + 1) * p->chunk < plan->count ? (chunk + 1) * p->chunk : plan->count;
        hg_walk walk;
        for (hg_walk_begin(&walk, plan, chunk * p->chunk); walk.position < end;) {
            int64_t n = hg_walk_length(&walk, plan, end);
            p->functions->gradient[p->input][p->real](
                n, p->g + walk.position * p->out_size, p->a + walk.at[0] * p->size[0], plan->step[0],
                p->b + walk.at[1] * p->size[1], plan->step[1], copy + walk.at[p->input] * p->size[p->input],
                plan->step[p->input], false, p->width);
            hg_walk_next(&walk, plan, n);
        }
    }
}

static pair_args pair_arguments(const hg_call *call, const hg_pair_functions *functions)
{
    const hg_tensor *a = call->in[0], *b = call->in[1];
    pair_args args = { .functions = functions, .real = call->out->dtype == HG_F64, .width = 1 };
    int rank;
    int64_t shape[HG_MAX_RANK], real = (int64_t)hg_dtype_size(a->dtype);
    hg_broadcast_plan(call, functions->item_axes, &args.plan, &rank, shape); /* checked by the shape rule */
    if (functions->item_axes) args.width = a->shape[a->rank - 1];
    args.size[0] = args.width * real;
    args.size[1] = functions->item_axes ? b->shape[b->rank - 1] * real : real;
    args.out_size = functions->item_axes ? functions->out_width * real : real;
    args.a = a->data;
    args.b = b->data;
    return args;
}

hg_status hg_pair_forward(hg_call *call, const hg_pair_functions *functions)
{
    static const hg_kernel kernel = { .name = "pair", .args_size = sizeof(pair_args), .cpu = pair_forward_cpu };
    pair_args args = pair_arguments(call, functions);
    args.out = call->out->data;
    return hg_launch(call->ctx, &kernel, args.plan.count, &args);
}

hg_status hg_pair_backward(hg_call *call, const hg_pair_functions *functions)
{
    static const hg_kernel direct = { .name = "pair", .args_size = sizeof(pair_args), .cpu = pair_direct_cpu };
    static const hg_kernel chunked = {
        .name = "pair", .args_size = sizeof(pair_args), .cpu = pair_chunk_cpu, .block = 1
    };
    pair_args args = pair_arguments(call, functions);
    args.g = hg_grad(call->out)->data;
    if (args.plan.count == 0) return HG_OK;
    for (args.input = 0; args.input < 2; args.input++) {
        hg_tensor *in = call->in[args.input];
        if (!hg_needs_grad(in)) continue;
        char *gradient = hg_grad_data(in, &args.fresh);
        if (args.plan.in_count[args.input] == args.plan.count) {
            args.out = gradient;
            HG_TRY(hg_launch(call->ctx, &direct, args.plan.count, &args));
            continue;
        }
        hg_broadcast_chunks cut = hg_broadcast_cut(&args.plan, args.input);
        int64_t size = args.plan.in_count[args.input] * args.size[args.input] / (int64_t)hg_dtype_size(in->dtype);
        hg_step_mark mark = hg_step_set_mark(call->ctx);
        hg_tensor *copies = hg_tensor_make(call->ctx, in->dtype, 2, (int64_t[]){ cut.chunks, size });
        if (!copies) return HG_MEMORY;
        args.out = copies->data;
        args.chunk = cut.length;
        HG_TRY(hg_launch(call->ctx, &chunked, cut.chunks, &args));
        HG_TRY(hg_add_partials(call->ctx, in->dtype, cut.chunks, size, copies->data, gradient, args.fresh));
        hg_step_rewind(call->ctx, mark);
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
