/* Two tensors that meet elementwise, by NumPy's rules, as one walk: axes of the output are merged where both inputs
 * allow it, and the last merged axis is a segment along which each input moves by 0 or 1 items. An item is one element,
 * or a vector or quaternion for the ops on those. This file is for the kernels of these ops too. */
#ifndef HG_AUTOGRAD_BROADCAST_H
#define HG_AUTOGRAD_BROADCAST_H

#include "autograd/floats.h"
#ifdef HG_CUDA
#define HG_MAX_RANK 6 /* as tensor.h has it */
#else
#include "autograd/tape.h"
#endif

typedef struct {
    int rank;                                          /* merged axes, the segment left out */
    int64_t size[HG_MAX_RANK], stride[2][HG_MAX_RANK]; /* in items */
    int64_t segment, step[2];                          /* items of a segment, and how the inputs move along it */
    int64_t count, in_count[2];                        /* items of the output and of the inputs */
} hg_broadcast;

/* How a backward adds up the gradient of an input that was broadcast, in an order that the shapes fix.
 *
 * On the processor the output is cut in `chunks` of `length` items; each adds into its own copy of the input's gradient.
 *
 * On a GPU each of the input's items (`inside`) has the sum over the axes that the input does not have (`outside` items). The
 * axes are those of the plan, the input's first. A block of threads, as [rows, lanes], adds `length` items for `lanes`
 * neighbouring items of the input; so there are `chunks` partial sums by `tiles` of lanes. */
typedef struct {
    int64_t chunks, length;
    int rank, kept;
    int64_t size[HG_MAX_RANK], stride[HG_MAX_RANK][3]; /* in a, b and the output, in items */
    int64_t inside, outside, lanes, tiles;
} hg_broadcast_sum;

/* What the kernels of a pair get. */
typedef struct {
    hg_broadcast plan;
    hg_broadcast_sum sum;
    int64_t width; /* elements of an item of a */
    int fresh;
    const void *a, *b, *g;
    void *to; /* the output; the gradient; the partial sums */
} hg_pair_args;

enum { HG_SUM_THREADS = 256 }; /* of a block that adds gradients up */

/* ---- the walk ---- */

/* One stretch: items of the output from `position`, inputs at at[0] and at[1]. A GPU's stretch is one item. */
#ifdef HG_CUDA

typedef struct {
    int64_t at[2], position;
} hg_walk;

HG_BODY void hg_walk_begin(hg_walk *walk, const hg_broadcast *plan, int64_t first)
{
    int64_t row = 0, column = first, index;
    walk->position = first;
    if (plan->rank) row = hg_divide(first, plan->segment, &column);
    for (int j = 0; j < 2; j++) walk->at[j] = column * plan->step[j];
    for (int i = plan->rank - 1; i >= 0; i--) {
        index = row;
        if (i) row = hg_divide(row, plan->size[i], &index);
        for (int j = 0; j < 2; j++) walk->at[j] += index * plan->stride[j][i];
    }
}

HG_BODY int64_t hg_walk_length(const hg_walk *walk, const hg_broadcast *plan, int64_t last)
{
    return (void)walk, (void)plan, (void)last, 1;
}

HG_BODY void hg_walk_next(hg_walk *walk, const hg_broadcast *plan, int64_t n) { (void)plan, walk->position += n; }

#else

typedef struct {
    int64_t index[HG_MAX_RANK], at[2], column, position;
} hg_walk;

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

#endif

/* ---- sums over the axes that an input does not have ---- */

#ifdef HG_CUDA

/* A thread's share of a block: for item `item` of the input it adds the items first, first + step, ... < last of those
 * outside. A thread without an item has nothing to add. */
typedef struct {
    int64_t chunk, item, first, last, step, at[3];
} hg_sum_share;

/* Where item `i` of the axes [first, last) lies in a, b and the output. */
HG_BODY void hg_sum_place(const hg_broadcast_sum *sum, int first, int last, int64_t i, int64_t at[3])
{
    for (int axis = last - 1; axis >= first; axis--) {
        int64_t index = i;
        if (axis > first) i = hg_divide(i, sum->size[axis], &index);
        for (int j = 0; j < 3; j++) at[j] += index * sum->stride[axis][j];
    }
}

HG_BODY hg_sum_share hg_sum_begin(const hg_broadcast_sum *sum, int64_t index)
{
    hg_sum_share share;
    int64_t lane, tile;
    const int64_t row = hg_divide((int64_t)threadIdx.x, sum->lanes, &lane);
    share.chunk = hg_divide(index, sum->tiles, &tile);
    share.item = tile * sum->lanes + lane;
    share.step = hg_divide(HG_SUM_THREADS, sum->lanes, &lane);
    share.first = share.chunk * sum->length + row;
    share.last = (share.chunk + 1) * sum->length;
    if (share.last > sum->outside) share.last = sum->outside;
    for (int j = 0; j < 3; j++) share.at[j] = 0;
    if (share.item < sum->inside)
        hg_sum_place(sum, 0, sum->kept, share.item, share.at);
    else
        share.last = share.first;
    return share;
}

/* The sum over the threads of an item, in a tree; true in the thread that has it. All threads come here. */
HG_BODY bool hg_sum_end(const hg_broadcast_sum *sum, const hg_sum_share *share, double *value)
{
    __shared__ double all[HG_SUM_THREADS];
    const int thread = (int)threadIdx.x, lanes = (int)sum->lanes;
    all[thread] = *value;
    __syncthreads();
    for (int half = HG_SUM_THREADS / 2; half >= lanes; half /= 2) {
        if (thread < half) all[thread] += all[thread + half];
        __syncthreads();
    }
    *value = all[thread];
    __syncthreads(); /* before the next call writes */
    return thread < lanes && share->item < sum->inside;
}

#else

/* ---- ops of two broadcast inputs ---- */

/* Tables of f32 and f64, as HG_PAIR_KERNELS makes them. */
typedef struct {
    const hg_kernel *const *forward;
    const hg_kernel *const *gradient[2]; /* of a and b, lying like the output */
    const hg_kernel *const *sum[2]; /* the same, added up over what is not theirs: HG_SUM_THREADS threads a block */
} hg_pair_kernels;

/* Fills the plan and the output's shape without the last `item_axes` axes; false after hg_refuse. */
bool hg_broadcast_plan(const hg_call *call, int item_axes, hg_broadcast *plan, int *rank, int64_t *shape);
/* item_axes 0: an item is one element; 1: the last axis. */
hg_status hg_pair_forward(hg_call *call, int item_axes, const hg_pair_kernels *kernels);
hg_status hg_pair_backward(hg_call *call, int item_axes, const hg_pair_kernels *kernels);
/* For references: where in the inputs output item `item` comes from, by index arithmetic of its own. */
void hg_pair_items(const hg_call *call, int item_axes, int64_t item, int64_t at[2]);

#endif

/* ---- bodies ---- */

/* The bodies of a pair's kernels, of functions that do one stretch, a and b moving by sa and sb (0 or 1) items:
 *
 *     F(NAME_stretch)(int64_t n, const REAL *a, int64_t sa, const REAL *b, int64_t sb, REAL *y, int64_t width)
 *     F(NAME_da_stretch)(int64_t n, const REAL *g, const REAL *a, int64_t sa, const REAL *b, int64_t sb, REAL *to,
 *                        int64_t st, bool fresh, int64_t width)   st: items that `to` moves by; fresh: '=' instead of '+='
 *
 * with WA_, WB_ and OUT_ elements to an item of a, b and the output. Then HG_PAIR_KERNELS(NAME_, ...) in the NAME.kernel.h. */
#ifdef HG_CUDA
#define HG_PAIR_STEP(j_) 0
#define HG_STRETCH       HG_BODY
#else
#define HG_STRETCH       static __attribute__((noinline)) /* its loops are slower between the variables of the walk */
#define HG_PAIR_STEP(j_) p->plan.step[j_]
#endif
#define HG_PAIR_WALK(...)                                                                                              \
    do {                                                                                                               \
        hg_walk walk;                                                                                                  \
        for (hg_walk_begin(&walk, &p->plan, first); walk.position < last;) {                                           \
            const int64_t n = hg_walk_length(&walk, &p->plan, last);                                                   \
            const REAL *a = (const REAL *)p->a + walk.at[0] * wa, *b = (const REAL *)p->b + walk.at[1] * wb;           \
            __VA_ARGS__                                                                                                \
            hg_walk_next(&walk, &p->plan, n);                                                                          \
        }                                                                                                              \
    } while (0)

#define HG_PAIR_FORWARD(NAME_, WA_, WB_, OUT_)                                                                         \
    HG_BODY void F(NAME_##_forward)(const hg_pair_args *p, int64_t first, int64_t last)                                \
    {                                                                                                                  \
        const int64_t wa = (WA_), wb = (WB_);                                                                          \
        HG_PAIR_WALK(F(NAME_##_stretch)(n, a, HG_PAIR_STEP(0), b, HG_PAIR_STEP(1),                                     \
                                        (REAL *)p->to + walk.position * (OUT_), p->width););                           \
    }

/* The gradient of input IN_, whose items have WD_ elements: NAME_, and NAME_sum where it was broadcast. */
#define HG_PAIR_GRADIENT(NAME_, IN_, WA_, WB_, OUT_, WD_)                                                              \
    HG_PAIR_DIRECT(NAME_, WA_, WB_, OUT_, WD_)                                                                         \
    HG_PAIR_SUM(NAME_, IN_, WA_, WB_, OUT_, WD_)
#define HG_PAIR_DIRECT(NAME_, WA_, WB_, OUT_, WD_)                                                                     \
    HG_BODY void F(NAME_)(const hg_pair_args *p, int64_t first, int64_t last)                                          \
    {                                                                                                                  \
        const int64_t wa = (WA_), wb = (WB_);                                                                          \
        HG_PAIR_WALK(F(NAME_##_stretch)(n, (const REAL *)p->g + walk.position * (OUT_), a, HG_PAIR_STEP(0), b,         \
                                        HG_PAIR_STEP(1), (REAL *)p->to + walk.position * (WD_), 1, p->fresh,           \
                                        p->width););                                                                   \
    }

#ifdef HG_CUDA

/* PASSES_ times WD_ elements to an item; in pass `pass` the stretch of one item fills d[WD_]. */
#define HG_PAIR_SUM_BLOCK(NAME_, WA_, WB_, OUT_, PASSES_, WD_, ...)                                                    \
    HG_BODY void F_BLOCK(NAME_##_sum)(const hg_pair_args *p, int64_t index)                                            \
    {                                                                                                                  \
        const hg_sum_share share = hg_sum_begin(&p->sum, index);                                                       \
        for (int64_t pass = 0; pass < (PASSES_); pass++) {                                                             \
            double sum[WD_] = { 0 };                                                                                   \
            for (int64_t i = share.first; i < share.last; i += share.step) {                                           \
                int64_t at[3] = { share.at[0], share.at[1], share.at[2] };                                             \
                hg_sum_place(&p->sum, p->sum.kept, p->sum.rank, i, at);                                                \
                const REAL *const a = (const REAL *)p->a + at[0] * (WA_), *const b =                                   \
                                                                              (const REAL *)p->b + at[1] * (WB_);      \
                const REAL *g = (const REAL *)p->g + at[2] * (OUT_);                                                   \
                REAL d[WD_];                                                                                           \
                __VA_ARGS__                                                                                            \
                for (int k = 0; k < (WD_); k++) sum[k] += (double)d[k];                                                \
            }                                                                                                          \
            REAL *to = (REAL *)p->to + ((share.chunk * p->sum.inside + share.item) * (PASSES_) + pass) * (WD_);        \
            for (int k = 0; k < (WD_); k++)                                                                            \
                if (hg_sum_end(&p->sum, &share, &sum[k])) to[k] = (REAL)(p->fresh ? sum[k] : (double)to[k] + sum[k]);  \
        }                                                                                                              \
    }
#define HG_PAIR_SUM(NAME_, IN_, WA_, WB_, OUT_, WD_)                                                                   \
    HG_PAIR_SUM_BLOCK(NAME_, WA_, WB_, OUT_, 1, WD_, F(NAME_##_stretch)(1, g, a, 0, b, 0, d, 1, true, p->width);)

#else

#define HG_PAIR_SUM(NAME_, IN_, WA_, WB_, OUT_, WD_)                                                                   \
    HG_BODY void F(NAME_##_sum)(const hg_pair_args *p, int64_t first_chunk, int64_t last_chunk)                        \
    {                                                                                                                  \
        const int64_t wa = (WA_), wb = (WB_), size = p->plan.in_count[IN_] * (WD_);                                    \
        for (int64_t chunk = first_chunk; chunk < last_chunk; chunk++) {                                               \
            const int64_t first = chunk * p->sum.length, end = first + p->sum.length,                                  \
                          last = end < p->plan.count ? end : p->plan.count;                                            \
            REAL *copy = (REAL *)p->to + chunk * size;                                                                 \
            memset(copy, 0, (size_t)size * sizeof *copy);                                                              \
            HG_PAIR_WALK(F(NAME_##_stretch)(n, (const REAL *)p->g + walk.position * (OUT_), a, HG_PAIR_STEP(0), b,     \
                                            HG_PAIR_STEP(1), copy + walk.at[IN_] * (WD_), HG_PAIR_STEP(IN_), false,    \
                                            p->width););                                                               \
        }                                                                                                              \
    }

#endif

#define HG_PAIR_KERNELS(NAME_)                                                                                         \
    HG_KERNELS(NAME_##_forward, hg_pair_args, 0)                                                                       \
    HG_KERNELS(NAME_##_da, hg_pair_args, 0)                                                                            \
    HG_KERNELS(NAME_##_db, hg_pair_args, 0)                                                                            \
    HG_KERNELS_BLOCK(NAME_##_da_sum, hg_pair_args, 1, HG_SUM_THREADS)                                                  \
    HG_KERNELS_BLOCK(NAME_##_db_sum, hg_pair_args, 1, HG_SUM_THREADS)                                                  \
    HG_PAIR_TABLE_(NAME_)
#ifdef HG_CUDA
#define HG_PAIR_TABLE_(NAME_)
#else
#define HG_PAIR_TABLE_(NAME_)                                                                                          \
    static const hg_pair_kernels NAME_##_kernels = { .forward = NAME_##_forward_kernels,                               \
                                                     .gradient = { NAME_##_da_kernels, NAME_##_db_kernels },           \
                                                     .sum = { NAME_##_da_sum_kernels, NAME_##_db_sum_kernels } };
#endif

#endif
