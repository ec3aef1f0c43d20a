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
