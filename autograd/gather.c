/* gather: rows of axis 0 by index; scatter_add: its adjoint. The sum into a row runs over the places that point at it,
 * in ascending order (a reverse list made by counting), so that it is deterministic without atomics. */
#include "autograd/gather.kernel.h"
#include "autograd/index.h"

#include <string.h>

static int64_t row_of(const hg_tensor *tensor, int from_axis)
{
    int64_t row = 1;
    for (int i = from_axis; i < tensor->rank; i++) row *= tensor->shape[i];
    return row;
}

static hg_status take_rows(hg_ctx *ctx, hg_dtype dtype, const gather_args *args, int64_t n)
{
    const size_t size = hg_dtype_size(dtype);
    const hg_kernel *copy = size == 2 ? &gather_2_kernel : size == 4 ? &gather_4_kernel : &gather_8_kernel;
    return hg_launch(ctx, args->add ? gather_add_kernels[dtype == HG_F64] : copy, n * args->row, args);
}

static hg_status sum_segments(hg_ctx *ctx, hg_dtype dtype, gather_args *args, const hg_tensor *index, int64_t rows)
{
    const hg_step_mark mark = hg_step_set_mark(ctx);
    hg_status status = hg_index_reverse(ctx, index, rows, &args->start, &args->places);
    if (status == HG_OK) status = hg_launch(ctx, segments_kernels[dtype == HG_F64], rows * args->row, args);
    hg_step_rewind(ctx, mark);
    return status;
}

/* ---- gather ---- */

static hg_tensor *gather_shape(hg_call *call)
{
    const hg_tensor *a = call->in[0], *index = call->in[1];
    if (a->rank < 1 || index->dtype != HG_I32 || index->rank + a->rank - 1 > HG_MAX_RANK)
        return hg_refuse(call, "a [R,...] is gathered by an i32 index [n]");
    if (!hg_index_is_valid(call, index, a->shape[0])) return NULL;
    int64_t shape[HG_MAX_RANK];
    int rank = 0;
    for (int i = 0; i < index->rank; i++) shape[rank++] = index->shape[i];
    for (int i = 1; i < a->rank; i++) shape[rank++] = a->shape[i];
    return hg_out(call, a->dtype, rank, shape);
}

static hg_status gather_forward(hg_call *call)
{
    const hg_tensor *a = call->in[0], *index = call->in[1];
    gather_args args = { .row = row_of(a, 1), .index = index->data, .from = a->data, .to = call->out->data };
    return take_rows(call->ctx, a->dtype, &args, hg_tensor_count(index));
}

static hg_status gather_backward(hg_call *call)
{
    hg_tensor *a = call->in[0], *index = call->in[1];
    bool fresh;
    gather_args args = { .row = row_of(a, 1), .index = index->data, .from = hg_grad(call->out)->data };
    args.to = hg_grad_data(a, &fresh);
    args.add = !fresh;
    return sum_segments(call->ctx, a->dtype, &args, index, a->shape[0]);
}

static void gather_reference(const hg_call *call, double *out)
{
    int64_t row = row_of(call->in[0], 1);
    for (int64_t i = 0; i < hg_tensor_count(call->in[1]); i++)
        for (int64_t j = 0; j < row; j++)
            *out++ = hg_tensor_item(call->in[0], (int64_t)hg_tensor_item(call->in[1], i) * row + j);
}

static hg_status gather_emit(const hg_call *call, hg_emitter *e) { return hg_emit_one(call, e, "Gather"); }

static const hg_sample gather_samples[] = {
    { .label = "rows",
      .n_in = 2,
      .in = { { 2, { 4, 3 } }, { 1, { 5 }, HG_I32, .values = (const double[]){ 3, 0, 3, 1, 3 } } } },
    { .label = "elements",
      .n_in = 2,
      .in = { { 1, { 4 } }, { 2, { 2, 2 }, HG_I32, .values = (const double[]){ 2, 1, 0, 1 } } } },
    { .label = "one", .n_in = 2, .in = { { 2, { 1, 1 } }, { 1, { 1 }, HG_I32, .values = (const double[]){ 0 } } } },
    { .label = "no index",
      .n_in = 2,
      .in = { { 2, { 4, 3 } }, { 1, { 0 }, HG_I32, .values = (const double[]){ 0 } } } },
};
HG_OP(gather, .formula = "y[i] = a[index[i]]", .min_in = 2, .max_in = 2, .shape = gather_shape,
      .forward = gather_forward, .backward = gather_backward, .samples = gather_samples,
      .n_samples = sizeof gather_samples / sizeof *gather_samples, .reference = gather_reference, .emit = gather_emit);

hg_tensor *hg_gather(hg_ctx *ctx, hg_tensor *a, hg_tensor *index)
{
    return hg_apply(ctx, &op_gather, 2, (hg_tensor *[]){ a, index }, NULL);
}

/* ---- scatter_add ---- */

typedef struct {
    int64_t rows;
} scatter_attributes;

static hg_tensor *scatter_shape(hg_call *call)
{
    const hg_tensor *a = call->in[0], *index = call->in[1];
    int64_t rows = ((const scatter_attributes *)call->attributes)->rows;
    if (!hg_is_float(a) || a->rank < 1 || index->dtype != HG_I32 || index->rank != 1 ||
        index->shape[0] != a->shape[0] || rows < 0)
        return hg_refuse(call, "a [n,...] is scattered by an i32 index [n] into %lld rows", (long long)rows);
    if (!hg_index_is_valid(call, index, rows)) return NULL;
    int64_t shape[HG_MAX_RANK];
    memcpy(shape, a->shape, sizeof shape);
    shape[0] = rows;
    return hg_out(call, a->dtype, a->rank, shape);
}

static hg_status scatter_forward(hg_call *call)
{
    const hg_tensor *a = call->in[0], *index = call->in[1];
    gather_args args = { .row = row_of(a, 1), .index = index->data, .from = a->data, .to = call->out->data };
    return sum_segments(call->ctx, a->dtype, &args, index, call->out->shape[0]);
}

static hg_status scatter_backward(hg_call *call)
{
    hg_tensor *a = call->in[0], *index = call->in[1];
    bool fresh;
    gather_args args = { .row = row_of(a, 1), .index = index->data, .from = hg_grad(call->out)->data };
    args.to = hg_grad_data(a, &fresh);
    args.add = !fresh;
    return take_rows(call->ctx, a->dtype, &args, hg_tensor_count(index));
}

static void scatter_reference(const hg_call *call, double *out)
{
    int64_t row = row_of(call->in[0], 1);
    for (int64_t i = 0; i < hg_tensor_count(call->out); i++) out[i] = 0;
    for (int64_t i = 0; i < hg_tensor_count(call->in[1]); i++)
        for (int64_t j = 0; j < row; j++)
            out[(int64_t)hg_tensor_item(call->in[1], i) * row + j] += hg_tensor_item(call->in[0], i * row + j);
}

#define SCATTER(...)                                                                                                   \
    .attributes = &(const scatter_attributes) { __VA_ARGS__ }
static const hg_sample scatter_samples[] = {
    { .label = "rows",
      .n_in = 2,
      .in = { { 2, { 5, 3 } }, { 1, { 5 }, HG_I32, .values = (const double[]){ 3, 0, 3, 1, 3 } } },
      SCATTER(4) },
    { .label = "one",
      .n_in = 2,
      .in = { { 2, { 1, 1 } }, { 1, { 1 }, HG_I32, .values = (const double[]){ 0 } } },
      SCATTER(1) },
    { .label = "nothing",
      .n_in = 2,
      .in = { { 2, { 0, 3 } }, { 1, { 0 }, HG_I32, .values = (const double[]){ 0 } } },
      SCATTER(2) },
};
/* A product with the matrix of ones at (index[i], i): in opset 15 nothing else adds where indices are equal. */
static hg_status scatter_emit(const hg_call *call, hg_emitter *e)
{
    const hg_tensor *out = call->out;
    enum { INT64 = 7 }; /* TensorProto.DataType: runtimes take no other indices for OneHot */
    const int64_t rows = out->shape[0], two = 2, none = 0, rank = out->rank;
    static const float values[2] = { 0, 1 };
    const int number = e->input(e->self, call->in[1]),
              index = e->node(e->self, "Cast", 1, &number, "to=i", (int64_t)INT64);
    const int depth = e->constant_i64(e->self, 0, NULL, &rows);
    const int hot = e->node(e->self, "OneHot", 3, (int[]){ index, depth, e->constant_f32(e->self, 1, &two, values) },
                            "axis=i", none);
    const int flat[2] = { e->input(e->self, call->in[0]),
                          e->constant_i64(e->self, 1, &two, (int64_t[]){ 0, row_of(call->in[0], 1) }) };
    const int sums = e->node(e->self, "MatMul", 2, (int[]){ hot, e->node(e->self, "Reshape", 2, flat, "") }, "");
    const int shaped[2] = { sums, e->constant_i64(e->self, 1, &rank, out->shape) };
    return e->output(e->self, out, e->node(e->self, "Reshape", 2, shaped, ""));
}

HG_OP(scatter_add, .formula = "y[index[i]] += a[i]", .min_in = 2, .max_in = 2,
      .attributes_size = sizeof(scatter_attributes), .shape = scatter_shape, .forward = scatter_forward,
      .backward = scatter_backward, .samples = scatter_samples,
      .n_samples = sizeof scatter_samples / sizeof *scatter_samples, .reference = scatter_reference,
      .emit = scatter_emit);

hg_tensor *hg_scatter_add(hg_ctx *ctx, hg_tensor *a, hg_tensor *index, int64_t rows)
{
    return hg_apply(ctx, &op_scatter_add, 2, (hg_tensor *[]){ a, index }, &(scatter_attributes){ rows });
}
