/* Layout: reshape, detach (views), permute, concat, slice, pad. All but permute are copies of slabs: `outer` rows of
 * `length` elements, taken from rows of one pitch and put into rows of another. */
#include "autograd/layout.kernel.h"
#include "autograd/tape.h"

#include <string.h>

/* ---- slabs ---- */

/* One of the kernels that copy, by the size of an element, or of those that add. */
static const hg_kernel *mover(hg_dtype dtype, bool add, const hg_kernel *const copies[3],
                              const hg_kernel *const adds[2])
{
    if (add) return adds[dtype == HG_F64];
    const size_t size = hg_dtype_size(dtype);
    return copies[size == 2 ? 0 : size == 4 ? 1 : 2];
}

static hg_status move_slab(hg_ctx *ctx, int64_t outer, hg_dtype dtype, bool add, const slab_args *args)
{
    static const hg_kernel *const copies[3] = { &slab_16_bits_kernel, &slab_32_bits_kernel, &slab_64_bits_kernel };
    return hg_launch(ctx, mover(dtype, add, copies, slab_add_kernels), outer * args->length, args);
}

/* [outer, shape[axis], inner] of a tensor. */
static void split_at(const hg_tensor *tensor, int axis, int64_t *outer, int64_t *inner)
{
    *outer = *inner = 1;
    for (int i = 0; i < axis; i++) *outer *= tensor->shape[i];
    for (int i = axis + 1; i < tensor->rank; i++) *inner *= tensor->shape[i];
}

/* ---- reshape and detach ---- */

typedef struct {
    int rank;
    int64_t shape[HG_MAX_RANK]; /* as asked for, with -1 */
} reshape_attributes;

static hg_tensor *reshape_shape(hg_call *call)
{
    const reshape_attributes *attributes = call->attributes;
    int64_t shape[HG_MAX_RANK], known = 1, count = hg_tensor_count(call->in[0]);
    int open = -1;
    if (attributes->rank < 0 || attributes->rank > HG_MAX_RANK) return hg_refuse(call, "%d axes", attributes->rank);
    for (int i = 0; i < attributes->rank; i++) {
        shape[i] = attributes->shape[i];
        if (shape[i] == -1 && open < 0)
            open = i;
        else if (shape[i] < 0)
            return hg_refuse(call, "axis %d is %lld: one -1 is possible, nothing else below 0", i, (long long)shape[i]);
        else
            known *= shape[i];
    }
    if (open >= 0) shape[open] = known ? count / known : 0;
    if (open >= 0 ? known * shape[open] != count : known != count)
        return hg_refuse(call, "%lld elements do not fill the new shape", (long long)count);
    return hg_out_view(call, call->in[0], attributes->rank, shape);
}

static hg_status view_forward(hg_call *call) { return (void)call, HG_OK; }

static hg_status reshape_backward(hg_call *call)
{
    bool fresh;
    const void *g = hg_grad(call->out)->data;
    void *gradient = hg_grad_data(call->in[0], &fresh);
    return hg_accumulate(call->ctx, call->out->dtype, hg_tensor_count(call->out), g, gradient, fresh);
}

static void copy_reference(const hg_call *call, double *out)
{
    for (int64_t i = 0; i < hg_tensor_count(call->in[0]); i++) out[i] = hg_tensor_item(call->in[0], i);
}

/* Leading axes that are kept stay open (0: as the input has it), or, where the first is not kept, the number of rows (-1). */
static hg_status reshape_emit(const hg_call *call, hg_emitter *e)
{
    const reshape_attributes *attributes = call->attributes;
    const hg_tensor *in = call->in[0], *out = call->out;
    int64_t shape[HG_MAX_RANK], n = attributes->rank;
    bool open = false;
    for (int i = 0; i < attributes->rank; i++) {
        shape[i] = attributes->shape[i];
        open |= shape[i] == -1;
    }
    if (n > 0 && shape[0] != -1 && in->rank > 0) {
        if (in->shape[0] == out->shape[0])
            for (int i = 0; i < n && i < in->rank && shape[i] != -1 && in->shape[i] == out->shape[i]; i++) shape[i] = 0;
        else if (!open)
            shape[0] = -1;
    }
    int inputs[2] = { e->input(e->self, in), e->constant_i64(e->self, 1, &n, shape) };
    return e->output(e->self, out, e->node(e->self, "Reshape", 2, inputs, ""));
}

#define RESHAPE(label_, rank_in_, in_, rank_, ...)                                                                     \
    {                                                                                                                  \
        .label = label_, .n_in = 1, .in = { { rank_in_, SHAPE in_ } }, .attributes = &(const reshape_attributes)       \
        {                                                                                                              \
            rank_, { __VA_ARGS__ }                                                                                     \
        }                                                                                                              \
    }
#define SHAPE(...)                                                                                                     \
    {                                                                                                                  \
        __VA_ARGS__                                                                                                    \
    }
static const hg_sample reshape_samples[] = {
    RESHAPE("split", 2, (6, 4), 3, 2, 3, 4),
    RESHAPE("open axis", 2, (6, 4), 2, -1, 8),
    RESHAPE("one", 0, (0), 2, 1, 1),
    RESHAPE("empty", 2, (0, 4), 3, 0, 2, 2),
};
HG_OP(reshape, .formula = "the same elements in another shape", .min_in = 1, .max_in = 1,
      .attributes_size = sizeof(reshape_attributes), .shape = reshape_shape, .forward = view_forward,
      .backward = reshape_backward, .samples = reshape_samples,
      .n_samples = sizeof reshape_samples / sizeof *reshape_samples, .reference = copy_reference, .emit = reshape_emit);

hg_tensor *hg_reshape(hg_ctx *ctx, hg_tensor *a, int rank, const int64_t *shape)
{
    reshape_attributes attributes = { .rank = rank };
    for (int i = 0; i < rank && i < HG_MAX_RANK; i++) attributes.shape[i] = shape[i];
    return hg_apply(ctx, &op_reshape, 1, &a, &attributes);
}

static hg_tensor *detach_shape(hg_call *call)
{
    return hg_out_view(call, call->in[0], call->in[0]->rank, call->in[0]->shape);
}
static hg_status detach_emit(const hg_call *call, hg_emitter *e) { return hg_emit_one(call, e, "Identity"); }

HG_OP(detach, .formula = "the same elements, no gradient through them", .min_in = 1, .max_in = 1, .shape = detach_shape,
      .forward = view_forward, .not_differentiable = true, .emit = detach_emit);

hg_tensor *hg_detach(hg_ctx *ctx, hg_tensor *tensor) { return hg_apply(ctx, &op_detach, 1, &tensor, NULL); }

/* ---- permute ---- */

typedef struct {
    int axes[HG_MAX_RANK];
} permute_attributes;

static hg_tensor *permute_shape(hg_call *call)
{
    const permute_attributes *attributes = call->attributes;
    const hg_tensor *x = call->in[0];
    int64_t shape[HG_MAX_RANK];
    unsigned seen = 0;
    for (int i = 0; i < x->rank; i++) {
        int axis = attributes->axes[i];
        if (axis < 0 || axis >= x->rank || (seen >> axis & 1))
            return hg_refuse(call, "the axes have to name each of 0 to %d once", x->rank - 1);
        seen |= 1u << axis;
        shape[i] = x->shape[axis];
    }
    return hg_out(call, x->dtype, x->rank, shape);
}

/* How many squares, where a GPU should go by them: neither axis is short, and the last one lies far apart in `from`. */
static int64_t squares_of(permute_args *args)
{
    enum { SHORT = 8 };
    const int last = args->rank - 1;
    args->near = last;
    for (int i = 0; i < last; i++)
        if (args->stride[i] == 1 && args->shape[i] > 1) args->near = i;
    if (args->near == last || args->shape[args->near] < SHORT || args->shape[last] < SHORT) return 0;
    int64_t squares = 1;
    for (int i = 0; i <= last; i++)
        squares *= i == last || i == args->near ? (args->shape[i] + SQUARE - 1) / SQUARE : args->shape[i];
    return squares;
}

static hg_status permute(hg_ctx *ctx, const hg_tensor *walked, permute_args *args, bool add)
{
    static const hg_kernel *const copies[3] = { &permute_16_bits_kernel, &permute_32_bits_kernel,
                                                &permute_64_bits_kernel };
    static const hg_kernel *const squares[2][2] = { { &squares_32_bits_kernel, &squares_64_bits_kernel },
                                                    { &squares_add_f32_kernel, &squares_add_f64_kernel } };
    const size_t size = hg_dtype_size(walked->dtype);
    const int64_t n = size < 4 ? 0 : squares_of(args);
    const hg_kernel *by_squares = squares[add][size == 8];
    if (n > 0 && hg_launches(ctx, by_squares)) return hg_launch(ctx, by_squares, n, args);
    return hg_launch(ctx, mover(walked->dtype, add, copies, permute_add_kernels), hg_tensor_count(walked), args);
}

static void strides_of(const hg_tensor *tensor, int64_t *strides)
{
    int64_t stride = 1;
    for (int i = tensor->rank; i-- > 0; stride *= tensor->shape[i]) strides[i] = stride;
}

static hg_status permute_forward(hg_call *call)
{
    const permute_attributes *attributes = call->attributes;
    const hg_tensor *x = call->in[0], *y = call->out;
    permute_args args = { .rank = y->rank, .from = x->data, .to = y->data };
    int64_t strides[HG_MAX_RANK];
    strides_of(x, strides);
    for (int i = 0; i < y->rank; i++) {
        args.shape[i] = y->shape[i];
        args.stride[i] = strides[attributes->axes[i]];
    }
    return permute(call->ctx, y, &args, false);
}

static hg_status permute_backward(hg_call *call)
{
    const permute_attributes *attributes = call->attributes;
    hg_tensor *x = call->in[0];
    const hg_tensor *y = call->out;
    bool fresh;
    permute_args args = { .rank = x->rank, .from = hg_grad(y)->data };
    args.to = hg_grad_data(x, &fresh);
    int64_t strides[HG_MAX_RANK];
    strides_of(y, strides);
    for (int i = 0; i < x->rank; i++) {
        args.shape[attributes->axes[i]] = y->shape[i];
        args.stride[attributes->axes[i]] = strides[i];
    }
    return permute(call->ctx, x, &args, !fresh);
}

static void permute_reference(const hg_call *call, double *out)
{
    const permute_attributes *attributes = call->attributes;
    const hg_tensor *x = call->in[0];
    for (int64_t i = 0; i < hg_tensor_count(x); i++) {
        int64_t index[HG_MAX_RANK], rest = i, at = 0;
        for (int axis = x->rank; axis-- > 0; rest /= x->shape[axis]) index[axis] = rest % x->shape[axis];
        for (int axis = 0; axis < x->rank; axis++)
            at = at * x->shape[attributes->axes[axis]] + index[attributes->axes[axis]];
        out[at] = hg_tensor_item(x, i);
    }
}

static hg_status permute_emit(const hg_call *call, hg_emitter *e)
{
    const permute_attributes *attributes = call->attributes;
    int64_t axes[HG_MAX_RANK];
    for (int i = 0; i < call->in[0]->rank; i++) axes[i] = attributes->axes[i];
    int x = e->input(e->self, call->in[0]);
    return e->output(e->self, call->out, e->node(e->self, "Transpose", 1, &x, "perm=I", call->in[0]->rank, axes));
}

static const hg_sample permute_samples[] = {
    { .label = "transpose",
      .n_in = 1,
      .in = { { 2, { 3, 5 } } },
      .attributes = &(const permute_attributes){ { 1, 0 } } },
    { .label = "cycle",
      .n_in = 1,
      .in = { { 3, { 2, 3, 4 } } },
      .attributes = &(const permute_attributes){ { 2, 0, 1 } } },
    { .label = "one", .n_in = 1, .in = { { 1, { 1 } } }, .attributes = &(const permute_attributes){ { 0 } } },
    { .label = "empty", .n_in = 1, .in = { { 2, { 0, 3 } } }, .attributes = &(const permute_attributes){ { 1, 0 } } },
    { .label = "two blocks",
      .n_in = 1,
      .in = { { 3, { 70, 3, 21 } } },
      .attributes = &(const permute_attributes){ { 1, 2, 0 } } },
    { .label = "squares",
      .n_in = 1,
      .in = { { 4, { 2, 40, 3, 9 } } },
      .attributes = &(const permute_attributes){ { 3, 0, 2, 1 } } },
};
HG_OP(permute, .formula = "axes in another order", .min_in = 1, .max_in = 1,
      .attributes_size = sizeof(permute_attributes), .shape = permute_shape, .forward = permute_forward,
      .backward = permute_backward, .samples = permute_samples,
      .n_samples = sizeof permute_samples / sizeof *permute_samples, .reference = permute_reference,
      .emit = permute_emit);

hg_tensor *hg_permute(hg_ctx *ctx, hg_tensor *a, const int *axes)
{
    permute_attributes attributes = { { 0 } };
    for (int i = 0; a && i < a->rank; i++) attributes.axes[i] = axes[i];
    return hg_apply(ctx, &op_permute, 1, &a, &attributes);
}

/* ---- concat ---- */

typedef struct {
    int axis;
    int64_t first, count; /* slice: first and count; pad: before and after */
} range_attributes;

static hg_tensor *concat_shape(hg_call *call)
{
    range_attributes *attributes = call->attributes;
    const hg_tensor *x = call->in[0];
    attributes->axis = hg_axis_of(call, x, attributes->axis);
    if (attributes->axis < 0) return NULL;
    int64_t shape[HG_MAX_RANK];
    memcpy(shape, x->shape, sizeof shape);
    for (int i = 1; i < call->n_in; i++) {
        const hg_tensor *part = call->in[i];
        if (!part || part->rank != x->rank || part->dtype != x->dtype)
            return hg_refuse(call, "part %d does not fit part 0", i);
        for (int j = 0; j < x->rank; j++)
            if (j != attributes->axis && part->shape[j] != x->shape[j])
                return hg_refuse(call, "part %d does not fit part 0 in axis %d", i, j);
        shape[attributes->axis] += part->shape[attributes->axis];
    }
    return hg_out(call, x->dtype, x->rank, shape);
}

static hg_status concat_forward(hg_call *call)
{
    int axis = ((const range_attributes *)call->attributes)->axis;
    int64_t outer, inner, offset = 0;
    split_at(call->out, axis, &outer, &inner);
    for (int i = 0; i < call->n_in; i++) {
        int64_t length = call->in[i]->shape[axis] * inner;
        slab_args args = { .length = length,
                           .from_pitch = length,
                           .to_pitch = call->out->shape[axis] * inner,
                           .to_offset = offset,
                           .from = call->in[i]->data,
                           .to = call->out->data };
        HG_TRY(move_slab(call->ctx, outer, call->out->dtype, false, &args));
        offset += length;
    }
    return HG_OK;
}

static hg_status concat_backward(hg_call *call)
{
    int axis = ((const range_attributes *)call->attributes)->axis;
    int64_t outer, inner, offset = 0;
    split_at(call->out, axis, &outer, &inner);
    for (int i = 0; i < call->n_in; i++) {
        int64_t length = call->in[i]->shape[axis] * inner;
        if (hg_needs_grad(call->in[i])) {
            bool fresh;
            slab_args args = { .length = length,
                               .from_pitch = call->out->shape[axis] * inner,
                               .from_offset = offset,
                               .to_pitch = length,
                               .from = hg_grad(call->out)->data };
            args.to = hg_grad_data(call->in[i], &fresh);
            HG_TRY(move_slab(call->ctx, outer, call->out->dtype, !fresh, &args));
        }
        offset += length;
    }
    return HG_OK;
}

static void concat_reference(const hg_call *call, double *out)
{
    int axis = ((const range_attributes *)call->attributes)->axis;
    int64_t outer, inner;
    split_at(call->out, axis, &outer, &inner);
    for (int64_t o = 0; o < outer; o++)
        for (int i = 0; i < call->n_in; i++)
            for (int64_t j = 0; j < call->in[i]->shape[axis] * inner; j++)
                *out++ = hg_tensor_item(call->in[i], o * call->in[i]->shape[axis] * inner + j);
}

static hg_status concat_emit(const hg_call *call, hg_emitter *e)
{
    int in[HG_OP_INPUTS];
    for (int i = 0; i < call->n_in; i++) in[i] = e->input(e->self, call->in[i]);
    int64_t axis = ((const range_attributes *)call->attributes)->axis;
    return e->output(e->self, call->out, e->node(e->self, "Concat", call->n_in, in, "axis=i", axis));
}

static const hg_sample concat_samples[] = {
    { .label = "rows",
      .n_in = 2,
      .in = { { 2, { 2, 3 } }, { 2, { 4, 3 } } },
      .attributes = &(const range_attributes){ 0, 0, 0 } },
    { .label = "columns",
      .n_in = 3,
      .in = { { 2, { 2, 3 } }, { 2, { 2, 1 } }, { 2, { 2, 4 } } },
      .attributes = &(const range_attributes){ -1, 0, 0 } },
    { .label = "one part", .n_in = 1, .in = { { 1, { 1 } } }, .attributes = &(const range_attributes){ 0, 0, 0 } },
    { .label = "empty part",
      .n_in = 2,
      .in = { { 2, { 2, 0 } }, { 2, { 2, 3 } } },
      .attributes = &(const range_attributes){ 1, 0, 0 } },
    { .label = "two blocks",
      .n_in = 2,
      .in = { { 2, { 5000, 3 } }, { 2, { 5000, 2 } } },
      .attributes = &(const range_attributes){ 1, 0, 0 } },
};
HG_OP(concat, .formula = "parts one after the other along an axis", .min_in = 1, .max_in = HG_OP_INPUTS,
      .attributes_size = sizeof(range_attributes), .shape = concat_shape, .forward = concat_forward,
      .backward = concat_backward, .samples = concat_samples,
      .n_samples = sizeof concat_samples / sizeof *concat_samples, .reference = concat_reference, .emit = concat_emit);

hg_tensor *hg_concat(hg_ctx *ctx, int axis, int n, hg_tensor *const *parts)
{
    return hg_apply(ctx, &op_concat, n, parts, &(range_attributes){ axis, 0, 0 });
}

/* ---- slice and pad ---- */

static hg_tensor *slice_shape(hg_call *call)
{
    range_attributes *attributes = call->attributes;
    const hg_tensor *x = call->in[0];
    attributes->axis = hg_axis_of(call, x, attributes->axis);
    if (attributes->axis < 0) return NULL;
    int64_t n = x->shape[attributes->axis];
    if (attributes->first < 0 || attributes->count < 0 || attributes->first > n ||
        attributes->count > n - attributes->first)
        return hg_refuse(call, "%lld from %lld of axis %d do not exist", (long long)attributes->count,
                         (long long)attributes->first, attributes->axis);
    int64_t shape[HG_MAX_RANK];
    memcpy(shape, x->shape, sizeof shape);
    shape[attributes->axis] = attributes->count;
    return hg_out(call, x->dtype, x->rank, shape);
}

static hg_tensor *pad_shape(hg_call *call)
{
    range_attributes *attributes = call->attributes;
    const hg_tensor *x = call->in[0];
    if (!hg_floats_agree(call)) return NULL;
    attributes->axis = hg_axis_of(call, x, attributes->axis);
    if (attributes->axis < 0) return NULL;
    if (attributes->first < 0 || attributes->count < 0) return hg_refuse(call, "a negative pad: use slice");
    int64_t shape[HG_MAX_RANK];
    memcpy(shape, x->shape, sizeof shape);
    shape[attributes->axis] += attributes->first + attributes->count;
    return hg_out(call, x->dtype, x->rank, shape);
}

/* From the larger tensor's rows at `first` to the smaller's, or back. */
static hg_status move_range(const hg_call *call, const hg_tensor *large, const hg_tensor *small, const void *from,
                            void *to, bool to_small, bool add)
{
    const range_attributes *attributes = call->attributes;
    int64_t outer, inner;
    split_at(large, attributes->axis, &outer, &inner);
    int64_t pitch = large->shape[attributes->axis] * inner, length = small->shape[attributes->axis] * inner;
    int64_t offset = attributes->first * inner;
    slab_args args = { .length = length, .from = from, .to = to };
    args.from_pitch = to_small ? pitch : length;
    args.to_pitch = to_small ? length : pitch;
    args.from_offset = to_small ? offset : 0;
    args.to_offset = to_small ? 0 : offset;
    return move_slab(call->ctx, outer, large->dtype, add, &args);
}

static hg_status slice_forward(hg_call *call)
{
    return move_range(call, call->in[0], call->out, call->in[0]->data, call->out->data, true, false);
}

static hg_status slice_backward(hg_call *call)
{
    return move_range(call, call->in[0], call->out, hg_grad(call->out)->data, hg_grad(call->in[0])->data, false, true);
}

static hg_status pad_forward(hg_call *call)
{
    HG_TRY(hg_tensor_fill(call->out, 0));
    return move_range(call, call->out, call->in[0], call->in[0]->data, call->out->data, false, false);
}

static hg_status pad_backward(hg_call *call)
{
    bool fresh;
    const void *g = hg_grad(call->out)->data;
    void *gradient = hg_grad_data(call->in[0], &fresh);
    return move_range(call, call->out, call->in[0], g, gradient, true, !fresh);
}

static void slice_reference(const hg_call *call, double *out)
{
    const range_attributes *attributes = call->attributes;
    int64_t outer, inner;
    split_at(call->in[0], attributes->axis, &outer, &inner);
    for (int64_t o = 0; o < outer; o++)
        for (int64_t k = 0; k < attributes->count; k++)
            for (int64_t i = 0; i < inner; i++)
                *out++ = hg_tensor_item(call->in[0],
                                        (o * call->in[0]->shape[attributes->axis] + attributes->first + k) * inner + i);
}

static void pad_reference(const hg_call *call, double *out)
{
    const range_attributes *attributes = call->attributes;
    int64_t outer, inner, n = call->in[0]->shape[attributes->axis];
    split_at(call->in[0], attributes->axis, &outer, &inner);
    for (int64_t o = 0; o < outer; o++)
        for (int64_t k = -attributes->first; k < n + attributes->count; k++)
            for (int64_t i = 0; i < inner; i++)
                *out++ = k < 0 || k >= n ? 0 : hg_tensor_item(call->in[0], (o * n + k) * inner + i);
}

static hg_status slice_emit(const hg_call *call, hg_emitter *e)
{
    const range_attributes *attributes = call->attributes;
    int64_t one = 1, axis = attributes->axis, first = attributes->first, last = first + attributes->count;
    int in[4] = { e->input(e->self, call->in[0]), e->constant_i64(e->self, 1, &one, &first),
                  e->constant_i64(e->self, 1, &one, &last), e->constant_i64(e->self, 1, &one, &axis) };
    return e->output(e->self, call->out, e->node(e->self, "Slice", 4, in, ""));
}

static hg_status pad_emit(const hg_call *call, hg_emitter *e)
{
    const range_attributes *attributes = call->attributes;
    int64_t pads[2 * HG_MAX_RANK] = { 0 }, rank = call->in[0]->rank, n = 2 * rank;
    pads[attributes->axis] = attributes->first;
    pads[rank + attributes->axis] = attributes->count;
    int in[2] = { e->input(e->self, call->in[0]), e->constant_i64(e->self, 1, &n, pads) };
    return e->output(e->self, call->out, e->node(e->self, "Pad", 2, in, ""));
}

#define RANGE(label_, axis_, first_, count_, rank_, ...)                                                               \
    {                                                                                                                  \
        .label = label_, .n_in = 1, .in = { { rank_, { __VA_ARGS__ } } }, .attributes = &(const range_attributes)      \
        {                                                                                                              \
            axis_, first_, count_                                                                                      \
        }                                                                                                              \
    }
static const hg_sample slice_samples[] = {
    RANGE("rows", 0, 1, 2, 2, 4, 3), RANGE("columns", -1, 2, 3, 3, 2, 2, 6), RANGE("middle", 1, 1, 1, 3, 2, 3, 4),
    RANGE("one", 0, 0, 1, 1, 1),     RANGE("nothing", 0, 1, 0, 2, 4, 3),     RANGE("of nothing", 1, 0, 2, 2, 0, 3),
};
static const hg_sample pad_samples[] = {
    RANGE("rows", 0, 1, 2, 2, 4, 3), RANGE("columns", -1, 2, 0, 3, 2, 2, 6),  RANGE("middle", 1, 0, 1, 3, 2, 3, 4),
    RANGE("one", 0, 1, 1, 1, 1),     RANGE("from nothing", 0, 1, 1, 2, 0, 3),
};
HG_OP(slice, .formula = "a range of an axis", .min_in = 1, .max_in = 1, .attributes_size = sizeof(range_attributes),
      .shape = slice_shape, .forward = slice_forward, .backward = slice_backward, .samples = slice_samples,
      .n_samples = sizeof slice_samples / sizeof *slice_samples, .reference = slice_reference, .emit = slice_emit);
HG_OP(pad, .formula = "zeros before and after along an axis", .min_in = 1, .max_in = 1,
      .attributes_size = sizeof(range_attributes), .shape = pad_shape, .forward = pad_forward, .backward = pad_backward,
      .samples = pad_samples, .n_samples = sizeof pad_samples / sizeof *pad_samples, .reference = pad_reference,
      .emit = pad_emit);

hg_tensor *hg_slice(hg_ctx *ctx, hg_tensor *a, int axis, int64_t first, int64_t count)
{
    return hg_apply(ctx, &op_slice, 1, &a, &(range_attributes){ axis, first, count });
}

hg_tensor *hg_pad(hg_ctx *ctx, hg_tensor *a, int axis, int64_t before, int64_t after)
{
    return hg_apply(ctx, &op_pad, 1, &a, &(range_attributes){ axis, before, after });
}
