/* Two tensors that meet elementwise, by NumPy's rules, as one walk: axes of the output are merged where both inputs
 * allow it, and the last merged axis is a segment along which each input moves by 0 or 1 items. An item is one element,
 * or a vector or quaternion for the ops on those. */
#ifndef HG_AUTOGRAD_BROADCAST_H
#define HG_AUTOGRAD_BROADCAST_H

#include "autograd/tape.h"

typedef struct {
    int rank;                                          /* merged axes, the segment left out */
    int64_t size[HG_MAX_RANK], stride[2][HG_MAX_RANK]; /* in items */
    int64_t segment, step[2];                          /* items of a segment, and how the inputs move along it */
    int64_t count, in_count[2];                        /* items of the output and of the inputs */
} hg_broadcast;

/* Fills the plan and the output's shape without the last `item_axes` axes; false after hg_refuse. */
bool hg_broadcast_plan(const hg_call *call, int item_axes, hg_broadcast *plan, int *rank, int64_t *shape);

typedef struct {
    int64_t index[HG_MAX_RANK], at[2], column, position;
} hg_walk;
/* One stretch: `n` items of the output from `position`, inputs at at[0] and at[1]. */
static inline void hg_walk_begin(hg_walk *walk, const hg_broadcast *plan, int64_t first)
{
    int64_t row = first / plan->segment;
    walk->position = first;
    walk->column = first % plan->segment;
    walk->at[0] = walk->at[1] = 0;
    for (int i = plan->rank; i-- > 0; row /= plan->size[i]) {
        walk->index[i] = row % plan->size[i];
        for (int j = 0; j < 2; j++) walk->at[j] += walk->index[i] * plan->stride[j][i];
    }
    for (int j = 0; j < 2; j++) walk->at[j] += walk->column * plan->step[j];
}

static inline int64_t hg_walk_length(const hg_walk *walk, const hg_broadcast *plan, int64_t last)
{
    int64_t n = plan->segment - walk->column;
    return n < last - walk->position ? n : last - walk->position;
}

static inline void hg_walk_next(hg_walk *walk, const hg_broadcast *plan, int64_t n)
{
    walk->position += n;
    for (int j = 0; j < 2; j++) walk->at[j] -= walk->column * plan->step[j];
    walk->column = 0;
    for (int i = plan->rank; i-- > 0;) {
        for (int j = 0; j < 2; j++) walk->at[j] += plan->stride[j][i];
        if (++walk->index[i] < plan->size[i]) return;
        for (int j = 0; j < 2; j++) walk->at[j] -= plan->size[i] * plan->stride[j][i];
        walk->index[i] = 0;
    }
}

/* How a backward adds up the gradient of an input that was broadcast: the output is cut in `chunks` of `length` items,
 * fixed by the shapes; each adds into its own copy of the input's gradient; the copies are added in a tree. */
typedef struct {
    int64_t chunks, length;
} hg_broadcast_chunks;
hg_broadcast_chunks hg_broadcast_cut(const hg_broadcast *plan, int input);

/* ---- ops of two broadcast inputs ---- */

/* n items: a and b move by sa and sb (0 or 1) items. `width` is the elements of an item of a. */
typedef void hg_segment_forward(int64_t n, const void *a, int64_t sa, const void *b, int64_t sb, void *out,
                                int64_t width);
/* The gradient of one input: `to` moves by st items; fresh: overwrite (only with st 1), else add. */
typedef void hg_segment_gradient(int64_t n, const void *g, const void *a, int64_t sa, const void *b, int64_t sb,
                                 void *to, int64_t st, bool fresh, int64_t width);
typedef struct {
    int item_axes;                       /* 0: an item is one element; 1: the last axis */
    int out_width;                       /* with item_axes 1: elements of an item of the output */
    hg_segment_forward *forward[2];      /* f32, f64 */
    hg_segment_gradient *gradient[2][2]; /* by input, by type */
} hg_pair_functions;

hg_status hg_pair_forward(hg_call *call, const hg_pair_functions *functions);
hg_status hg_pair_backward(hg_call *call, const hg_pair_functions *functions);
/* For references: where in the inputs output item `item` comes from, by index arithmetic of its own. */
void hg_pair_items(const hg_call *call, int item_axes, int64_t item, int64_t at[2]);

#endif
