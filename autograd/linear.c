/* linear: act(x W + b) with bias and activation fused, its factored form for pairs of rows and groups, and matmul.
 *
 * This is where training spends its time. Forward: one tile of 256 rows is multiplied, biased and activated while it is
 * in the cache. Backward: one pass over chunks of rows makes dz, dx, dW and db together; chunks depend on the number
 * of rows alone and their partial sums are added in a fixed tree.
 *
 * With hg_ctx_compute at HG_BF16 the factors of a layer of many rows are rounded to bf16 as they come into the cache, the
 * weights once per call; sums, activations, gradients and the weights themselves are f32 as before.
 *
 * Tiles are for a processor's cache. A GPU makes whole products, and what belongs to an element in a kernel between them; there
 * the products themselves round their factors. */
#include "autograd/activation.h"
#include "autograd/linear.kernel.h"

#include <string.h>

enum { TILE_ROWS = 256, TILE_COLUMNS = 1024, CHUNKS = 32 };

typedef struct {
    hg_dtype dtype;
    hg_activation activation;
    int64_t rows, n_in, n_out, column_tiles, chunk;
    const void *x, *weight, *bias, *gradient;
    void *out, *saved, *dx, *dweight, *dbias, *scratch;
    bool fresh;
    uint16_t *weight_bf16; /* [n_in,n_out], NULL: compute in f32 */
    uint16_t *tiles_bf16;  /* per thread: a tile of x, then one of dz */
} linear_args;

#define REAL   float
#define SUFFIX _f32
#define DTYPE  HG_F32
#include "autograd/linear_tiles.inc"
#undef REAL
#undef SUFFIX
#undef DTYPE
#define REAL   double
#define SUFFIX _f64
#define DTYPE  HG_F64
#include "autograd/linear_tiles.inc"
#undef REAL
#undef SUFFIX
#undef DTYPE

/* ---- factors in bf16 ---- */

static void weight_bf16_cpu(const void *memory, int64_t first, int64_t last)
{
    const linear_args *p = memory;
    hg_bf16_of_f32(last - first, (const float *)p->weight + first, p->weight_bf16 + first);
}

static const hg_kernel weight_bf16_kernel = {
    .name = "linear_weight_bf16", .args_size = sizeof(linear_args), .cpu = weight_bf16_cpu, .block = 16384
};

static uint16_t *tile_bf16(const linear_args *p)
{
    return p->tiles_bf16 + (int64_t)hg_worker() * TILE_ROWS * (p->n_in + p->n_out);
}

static void linear_forward_bf16(const linear_args *p, int64_t tile)
{
    int64_t i = tile / p->column_tiles * TILE_ROWS, j = tile % p->column_tiles * TILE_COLUMNS;
    int64_t rows = p->rows - i < TILE_ROWS ? p->rows - i : TILE_ROWS;
    int64_t columns = p->n_out - j < TILE_COLUMNS ? p->n_out - j : TILE_COLUMNS;
    float *out = (float *)p->out + i * p->n_out + j, *saved = p->saved ? (float *)p->saved + i * p->n_out + j : NULL;
    uint16_t *x = tile_bf16(p);
    hg_bf16_of_f32(rows * p->n_in, (const float *)p->x + i * p->n_in, x);
    hg_product_here(HG_BF16, false, false, rows, columns, p->n_in, 1, x, p->n_in, p->weight_bf16 + j, p->n_out, 0, out,
                    p->n_out);
    linear_activate_f32(p, j, rows, columns, out, saved);
}

static void linear_backward_bf16(const linear_args *p, int64_t chunk)
{
    int64_t n_in = p->n_in, n_out = p->n_out, end = (chunk + 1) * p->chunk < p->rows ? (chunk + 1) * p->chunk : p->rows;
    float *scratch = (float *)p->scratch + (int64_t)hg_worker() * TILE_ROWS * n_out;
    uint16_t *x = tile_bf16(p), *dz_bf16 = x + TILE_ROWS * n_in;
    for (int64_t i = chunk * p->chunk; i < end; i += TILE_ROWS) {
        int64_t rows = end - i < TILE_ROWS ? end - i : TILE_ROWS;
        bool first = i == chunk * p->chunk;
        const float *dz = (const float *)p->gradient + i * n_out;
        if (p->activation != HG_IDENTITY) {
            activate_backward_f32(p->activation, rows * n_out, dz, (const float *)p->saved + i * n_out, scratch);
            dz = scratch;
        }
        hg_bf16_of_f32(rows * n_out, dz, dz_bf16);
        if (p->dx)
            hg_product_here(HG_BF16, false, true, rows, n_in, n_out, 1, dz_bf16, n_out, p->weight_bf16, n_out,
                            p->fresh ? 0 : 1, (float *)p->dx + i * n_in, n_in);
        if (p->dweight) {
            hg_bf16_of_f32(rows * n_in, (const float *)p->x + i * n_in, x);
            hg_product_here(HG_BF16, true, false, n_in, n_out, rows, 1, x, n_in, dz_bf16, n_out, first ? 0 : 1,
                            (float *)p->dweight + chunk * n_in * n_out, n_out);
        }
        if (p->dbias) add_rows_f32(rows, n_out, dz, (float *)p->dbias + chunk * n_out, first);
    }
}

/* Rounds the weights and makes room for tiles, in the step's memory, where the call computes in bf16. Few rows are not
 * worth the rounding of the weights. */
static hg_status prepare_bf16(hg_ctx *ctx, linear_args *args)
{
    if (hg_ctx_compute_dtype(ctx) != HG_BF16 || args->dtype != HG_F32 || args->rows <= TILE_ROWS || args->n_in == 0 ||
        args->n_out == 0)
        return HG_OK;
    int64_t weights = args->n_in * args->n_out;
    args->weight_bf16 = hg_step_alloc(ctx, (size_t)weights * sizeof(uint16_t));
    args->tiles_bf16 = hg_step_alloc(ctx, (size_t)(hg_ctx_threads(ctx) * TILE_ROWS * (args->n_in + args->n_out)) * 2);
    if (!args->weight_bf16 || !args->tiles_bf16) return HG_MEMORY;
    return hg_launch(ctx, &weight_bf16_kernel, weights, args);
}

/* The processor's kernels, for both float types. EACH_: the body takes one index; RANGE_: it takes the range. */
#define EACH_KERNEL(name_, args_)                                                                                      \
    static void name_##_cpu(const void *memory, int64_t first, int64_t last)                                           \
    {                                                                                                                  \
        const args_ *p = memory;                                                                                       \
        for (int64_t i = first; i < last; i++) (p->dtype == HG_F32 ? name_##_f32 : name_##_f64)(p, i);                 \
    }                                                                                                                  \
    static const hg_kernel name_##_kernel = {                                                                          \
        .name = #name_, .args_size = sizeof(args_), .cpu = name_##_cpu, .block = 1                                     \
    };
#define RANGE_KERNEL(name_, args_, block_)                                                                             \
    static void name_##_cpu(const void *memory, int64_t first, int64_t last)                                           \
    {                                                                                                                  \
        const args_ *p = memory;                                                                                       \
        (p->dtype == HG_F32 ? name_##_f32 : name_##_f64)(p, first, last);                                              \
    }                                                                                                                  \
    static const hg_kernel name_##_kernel = {                                                                          \
        .name = #name_, .args_size = sizeof(args_), .cpu = name_##_cpu, .block = block_                                \
    };

#define LINEAR_KERNEL(name_)                                                                                           \
    static void name_##_cpu(const void *memory, int64_t first, int64_t last)                                           \
    {                                                                                                                  \
        const linear_args *p = memory;                                                                                 \
        for (int64_t i = first; i < last; i++)                                                                         \
            (p->weight_bf16 ? name_##_bf16 : p->dtype == HG_F32 ? name_##_f32 : name_##_f64)(p, i);                    \
    }                                                                                                                  \
    static const hg_kernel name_##_kernel = {                                                                          \
        .name = #name_, .args_size = sizeof(linear_args), .cpu = name_##_cpu, .block = 1                               \
    };

LINEAR_KERNEL(linear_forward)
LINEAR_KERNEL(linear_backward)
RANGE_KERNEL(column_sums, linear_args, 1024)
RANGE_KERNEL(pair_forward, pair_args, 64)
EACH_KERNEL(pair_backward, pair_args)

static int64_t rows_of(const hg_tensor *x)
{
    int64_t rows = 1;
    for (int i = 0; i + 1 < x->rank; i++) rows *= x->shape[i];
    return rows;
}

static int64_t last_of(const hg_tensor *x) { return x->shape[x->rank - 1]; }

/* ---- linear ---- */

typedef struct {
    hg_activation activation;
} linear_attributes;

static hg_tensor *linear_shape(hg_call *call)
{
    const hg_tensor *x = call->in[0], *weight = call->in[1], *bias = call->n_in > 2 ? call->in[2] : NULL;
    const linear_attributes *attributes = call->attributes;
    if (!hg_floats_agree(call)) return NULL;
    if (!hg_activation_is_known(attributes->activation))
        return hg_refuse(call, "%d is no activation", (int)attributes->activation);
    if (x->rank < 1 || weight->rank != 2 || last_of(x) != weight->shape[0])
        return hg_refuse(call, "x [..,in] and weight [in,out] do not fit");
    if (bias && (bias->rank != 1 || bias->shape[0] != weight->shape[1]))
        return hg_refuse(call, "bias has to be [out], as weight [in,out] has it");
    int64_t shape[HG_MAX_RANK];
    memcpy(shape, x->shape, sizeof shape);
    shape[x->rank - 1] = weight->shape[1];
    return hg_out(call, x->dtype, x->rank, shape);
}

static linear_args linear_arguments(const hg_call *call)
{
    const hg_tensor *x = call->in[0], *weight = call->in[1], *bias = call->n_in > 2 ? call->in[2] : NULL;
    return (linear_args){ .dtype = x->dtype,
                          .activation = ((const linear_attributes *)call->attributes)->activation,
                          .rows = rows_of(x),
                          .n_in = weight->shape[0],
                          .n_out = weight->shape[1],
                          .column_tiles = (weight->shape[1] + TILE_COLUMNS - 1) / TILE_COLUMNS,
                          .x = x->data,
                          .weight = weight->data,
                          .bias = bias ? bias->data : NULL,
                          .out = call->out->data };
}

/* The product, then bias and activation over it. */
static hg_status forward_by_product(hg_ctx *ctx, const linear_args *args)
{
    HG_TRY(hg_product(ctx, args->dtype, false, false, args->rows, args->n_out, args->n_in, 1, args->x, args->n_in,
                      args->weight, args->n_out, 0, args->out, args->n_out));
    if (!args->bias && args->activation == HG_IDENTITY) return HG_OK;
    const finish_args finish = { (int)args->activation, args->n_out, args->bias, args->out, args->saved };
    return hg_launch(ctx, linear_finish_kernels[args->dtype == HG_F64], args->rows * args->n_out, &finish);
}

static hg_status linear_forward(hg_call *call)
{
    linear_args args = linear_arguments(call);
    if (hg_activation_saves_derivative(args.activation) && hg_call_recorded(call)) {
        call->saved[0] = hg_out_like(call, call->out);
        if (!call->saved[0]) return HG_MEMORY;
        args.saved = call->saved[0]->data;
    }
    if (!hg_launches(call->ctx, &linear_forward_kernel)) return forward_by_product(call->ctx, &args);
    hg_step_mark mark = hg_step_set_mark(call->ctx);
    hg_status status = prepare_bf16(call->ctx, &args);
    if (status == HG_OK)
        status = hg_launch(call->ctx, &linear_forward_kernel,
                           (args.rows + TILE_ROWS - 1) / TILE_ROWS * args.column_tiles, &args);
    hg_step_rewind(call->ctx, mark);
    return status;
}

/* dz = g act', in the step's memory; the gradient itself where there is nothing to do. NULL: the error is set. */
static const void *make_dz(hg_call *call, hg_activation activation, const void *gradient, const void *saved)
{
    if (activation == HG_IDENTITY) return gradient;
    const hg_tensor *dz = hg_out_like(call, call->out);
    if (!dz) return NULL;
    const dz_args args = { (int)activation, gradient, saved, dz->data };
    return hg_launch(call->ctx, linear_dz_kernels[dz->dtype == HG_F64], hg_tensor_count(dz), &args) == HG_OK ? dz->data
                                                                                                             : NULL;
}

/* Up to 256 rows there is one chunk: parallel inside the products instead. */
static hg_status backward_by_products(hg_call *call, linear_args *args, hg_tensor *x, hg_tensor *weight,
                                      hg_tensor *bias)
{
    bool fresh;
    const void *dz = make_dz(call, args->activation, args->gradient, args->saved);
    if (!dz) return hg_ctx_status(call->ctx);
    if (hg_needs_grad(x)) {
        void *dx = hg_grad_data(x, &fresh);
        HG_TRY(hg_product(call->ctx, args->dtype, false, true, args->rows, args->n_in, args->n_out, 1, dz, args->n_out,
                          args->weight, args->n_out, fresh ? 0 : 1, dx, args->n_in));
    }
    if (hg_needs_grad(weight)) {
        void *dweight = hg_grad_data(weight, &fresh);
        HG_TRY(hg_product(call->ctx, args->dtype, true, false, args->n_in, args->n_out, args->rows, 1, args->x,
                          args->n_in, dz, args->n_out, fresh ? 0 : 1, dweight, args->n_out));
    }
    if (!hg_needs_grad(bias)) return HG_OK;
    args->dbias = hg_grad_data(bias, &args->fresh);
    if (!hg_launches(call->ctx, &column_sums_kernel))
        return hg_sum_middle(call->ctx, args->dtype, 1, args->rows, args->n_out, 1, dz, args->dbias, args->fresh);
    args->scratch = (void *)(uintptr_t)dz;
    return hg_launch(call->ctx, &column_sums_kernel, args->n_out, args);
}

static hg_status many_rows_backward(hg_call *call, linear_args *args, hg_tensor *x, hg_tensor *weight, hg_tensor *bias)
{
    hg_ctx *ctx = call->ctx;
    HG_TRY(prepare_bf16(ctx, args));
    args->chunk = ((args->rows + CHUNKS - 1) / CHUNKS + TILE_ROWS - 1) / TILE_ROWS * TILE_ROWS; /* whole tiles */
    int64_t chunks = (args->rows + args->chunk - 1) / args->chunk, weights = args->n_in * args->n_out;
    hg_tensor *scratch =
        hg_tensor_make(ctx, args->dtype, 2, (int64_t[]){ hg_ctx_threads(ctx), TILE_ROWS * args->n_out });
    if (!scratch) return HG_MEMORY;
    args->scratch = scratch->data;
    if (hg_needs_grad(weight)) {
        hg_tensor *partials = hg_tensor_make(ctx, args->dtype, 2, (int64_t[]){ chunks, weights });
        if (!partials) return HG_MEMORY;
        args->dweight = partials->data;
    }
    if (hg_needs_grad(bias)) {
        hg_tensor *partials = hg_tensor_make(ctx, args->dtype, 2, (int64_t[]){ chunks, args->n_out });
        if (!partials) return HG_MEMORY;
        args->dbias = partials->data;
    }
    if (hg_needs_grad(x)) args->dx = hg_grad_data(x, &args->fresh);
    HG_TRY(hg_launch(ctx, &linear_backward_kernel, chunks, args));
    bool fresh;
    if (args->dweight) {
        void *dweight = hg_grad_data(weight, &fresh);
        HG_TRY(hg_add_partials(ctx, args->dtype, chunks, weights, args->dweight, dweight, fresh));
    }
    if (args->dbias) {
        void *dbias = hg_grad_data(bias, &fresh);
        HG_TRY(hg_add_partials(ctx, args->dtype, chunks, args->n_out, args->dbias, dbias, fresh));
    }
    return HG_OK;
}

static hg_status linear_backward(hg_call *call)
{
    hg_tensor *x = call->in[0], *weight = call->in[1], *bias = call->n_in > 2 ? call->in[2] : NULL;
    linear_args args = linear_arguments(call);
    args.gradient = hg_grad(call->out)->data;
    args.saved = call->saved[0] ? call->saved[0]->data : call->out->data;
    if (args.rows == 0) return HG_OK; /* the engine zeroes what is not written */
    hg_step_mark mark = hg_step_set_mark(call->ctx);
    const bool tiles = args.rows > TILE_ROWS && hg_launches(call->ctx, &linear_backward_kernel);
    const hg_status status = (tiles ? many_rows_backward : backward_by_products)(call, &args, x, weight, bias);
    hg_step_rewind(call->ctx, mark);
    return status;
}

static void linear_reference(const hg_call *call, double *out)
{
    const hg_tensor *x = call->in[0], *weight = call->in[1], *bias = call->n_in > 2 ? call->in[2] : NULL;
    int64_t n_in = weight->shape[0], n_out = weight->shape[1], rows = rows_of(x);
    for (int64_t i = 0; i < rows; i++)
        for (int64_t j = 0; j < n_out; j++) {
            double sum = bias ? hg_tensor_item(bias, j) : 0;
            for (int64_t k = 0; k < n_in; k++)
                sum += hg_tensor_item(x, i * n_in + k) * hg_tensor_item(weight, k * n_out + j);
            out[i * n_out + j] =
                hg_activation_reference(((const linear_attributes *)call->attributes)->activation, sum);
        }
}

/* A pre-activation near zero anywhere: the samples are small, so nothing finer is needed. */
static bool linear_kink(const hg_call *call, int in, int64_t element, double step)
{
    (void)in, (void)element;
    const hg_tensor *x = call->in[0], *weight = call->in[1], *bias = call->n_in > 2 ? call->in[2] : NULL;
    if (!hg_activation_has_kink(((const linear_attributes *)call->attributes)->activation)) return false;
    int64_t n_in = weight->shape[0], n_out = weight->shape[1], rows = rows_of(x);
    for (int64_t i = 0; i < rows; i++)
        for (int64_t j = 0; j < n_out; j++) {
            double sum = bias ? hg_tensor_item(bias, j) : 0;
            for (int64_t k = 0; k < n_in; k++)
                sum += hg_tensor_item(x, i * n_in + k) * hg_tensor_item(weight, k * n_out + j);
            if (fabs(sum) < 4 * step) return true;
        }
    return false;
}

static hg_status linear_emit(const hg_call *call, hg_emitter *e)
{
    int x = e->input(e->self, call->in[0]), weight = e->input(e->self, call->in[1]);
    int y = e->node(e->self, "MatMul", 2, (int[]){ x, weight }, "");
    if (call->n_in > 2 && call->in[2]) y = e->node(e->self, "Add", 2, (int[]){ y, e->input(e->self, call->in[2]) }, "");
    return e->output(e->self, call->out,
                     hg_emit_activation(e, ((const linear_attributes *)call->attributes)->activation, y));
}

#define LINEAR_SAMPLE(label_, activation_, rows_, in_, out_)                                                           \
    {                                                                                                                  \
        .label = label_, .n_in = 3, .in = { { 2, { rows_, in_ } }, { 2, { in_, out_ } }, { 1, { out_ } } },            \
        .attributes = &(const linear_attributes)                                                                       \
        {                                                                                                              \
            activation_                                                                                                \
        }                                                                                                              \
    }
static const hg_sample linear_samples[] = {
    LINEAR_SAMPLE("identity", HG_IDENTITY, 5, 3, 4),
    LINEAR_SAMPLE("relu", HG_RELU, 2, 3, 2),
    LINEAR_SAMPLE("leaky_relu", HG_LEAKY_RELU, 2, 3, 2),
    LINEAR_SAMPLE("elu", HG_ELU, 3, 3, 4),
    LINEAR_SAMPLE("tanh", HG_TANH, 5, 7, 3),
    LINEAR_SAMPLE("sigmoid", HG_SIGMOID, 5, 7, 3),
    LINEAR_SAMPLE("silu", HG_SILU, 5, 7, 3),
    LINEAR_SAMPLE("gelu", HG_GELU, 5, 7, 3),
    LINEAR_SAMPLE("softplus", HG_SOFTPLUS, 5, 7, 3),
    LINEAR_SAMPLE("one", HG_SILU, 1, 1, 1),
    LINEAR_SAMPLE("no rows", HG_SILU, 0, 3, 4),
    LINEAR_SAMPLE("no inputs", HG_TANH, 3, 0, 4),
    LINEAR_SAMPLE("no outputs", HG_TANH, 3, 4, 0),
    LINEAR_SAMPLE("several tiles", HG_SILU, 600, 5, 3),
    LINEAR_SAMPLE("several tiles, identity", HG_IDENTITY, 513, 2, 3),
    LINEAR_SAMPLE("wide", HG_TANH, 2, 2, 1030),
    { .label = "three axes, no bias",
      .n_in = 2,
      .in = { { 3, { 2, 3, 4 } }, { 2, { 4, 5 } } },
      .attributes = &(const linear_attributes){ HG_TANH } },
};
HG_OP(linear, .formula = "y = act(x W + b)", .min_in = 2, .max_in = 3, .attributes_size = sizeof(linear_attributes),
      .shape = linear_shape, .forward = linear_forward, .backward = linear_backward, .samples = linear_samples,
      .n_samples = sizeof linear_samples / sizeof *linear_samples, .reference = linear_reference, .kink = linear_kink,
      .emit = linear_emit);

hg_tensor *hg_linear(hg_ctx *ctx, hg_tensor *x, hg_tensor *weight, hg_tensor *bias, hg_activation activation)
{
    return hg_apply(ctx, &op_linear, bias ? 3 : 2, (hg_tensor *[]){ x, weight, bias },
                    &(linear_attributes){ activation });
}

/* ---- linear_pair ---- */

static hg_tensor *pair_shape(hg_call *call)
{
    const hg_tensor *rows = call->in[0], *groups = call->in[1];
    const linear_attributes *attributes = call->attributes;
    if (!hg_floats_agree(call)) return NULL;
    if (!hg_activation_is_known(attributes->activation))
        return hg_refuse(call, "%d is no activation", (int)attributes->activation);
    if (rows->rank != 2 || groups->rank != 2 || rows->shape[1] != groups->shape[1])
        return hg_refuse(call, "rows have to be [S,H] and groups [B,H] with the same H");
    return hg_out(call, rows->dtype, 3, (int64_t[]){ groups->shape[0], rows->shape[0], rows->shape[1] });
}

static pair_args pair_arguments(const hg_call *call)
{
    const hg_tensor *rows = call->in[0], *groups = call->in[1];
    return (pair_args){ .dtype = (int)rows->dtype,
                        .activation = (int)((const linear_attributes *)call->attributes)->activation,
                        .rows = rows->shape[0],
                        .groups = groups->shape[0],
                        .width = rows->shape[1],
                        .row_values = rows->data,
                        .group_values = groups->data,
                        .out = call->out->data };
}

static hg_status pair_forward(hg_call *call)
{
    pair_args args = pair_arguments(call);
    if (hg_activation_saves_derivative(args.activation) && hg_call_recorded(call)) {
        call->saved[0] = hg_out_like(call, call->out);
        if (!call->saved[0]) return HG_MEMORY;
        args.saved = call->saved[0]->data;
    }
    if (hg_launches(call->ctx, &pair_forward_kernel))
        return hg_launch(call->ctx, &pair_forward_kernel, args.rows, &args);
    return hg_launch(call->ctx, pair_elements_kernels[args.dtype == HG_F64], hg_tensor_count(call->out), &args);
}

/* dz of all elements, then its sums over groups and over rows. */
static hg_status pair_backward_by_sums(hg_call *call, const pair_args *args)
{
    hg_tensor *rows = call->in[0], *groups = call->in[1];
    const hg_dtype dtype = rows->dtype;
    const void *dz = make_dz(call, (hg_activation)args->activation, args->gradient, args->saved);
    bool fresh;
    if (!dz) return hg_ctx_status(call->ctx);
    if (hg_needs_grad(rows)) {
        void *drows = hg_grad_data(rows, &fresh);
        HG_TRY(hg_sum_middle(call->ctx, dtype, 1, args->groups, args->rows * args->width, 1, dz, drows, fresh));
    }
    if (!hg_needs_grad(groups)) return HG_OK;
    void *dgroups = hg_grad_data(groups, &fresh);
    return hg_sum_middle(call->ctx, dtype, args->groups, args->rows, args->width, 1, dz, dgroups, fresh);
}

static hg_status pair_backward(hg_call *call)
{
    pair_args args = pair_arguments(call);
    hg_ctx *ctx = call->ctx;
    args.gradient = hg_grad(call->out)->data;
    args.saved = call->saved[0] ? call->saved[0]->data : call->out->data;
    if (hg_tensor_count(call->out) == 0) return HG_OK;
    hg_step_mark mark = hg_step_set_mark(ctx);
    if (!hg_launches(ctx, &pair_backward_kernel)) {
        const hg_status done = pair_backward_by_sums(call, &args);
        hg_step_rewind(ctx, mark);
        return done;
    }
    const hg_dtype dtype = call->out->dtype;
    int64_t blocks = (args.rows + TILE_ROWS - 1) / TILE_ROWS;
    hg_tensor *scratch = hg_tensor_make(ctx, dtype, 2, (int64_t[]){ hg_ctx_threads(ctx), args.width });
    hg_tensor *partials = hg_tensor_make(ctx, dtype, 3, (int64_t[]){ blocks, args.groups, args.width });
    hg_status status = partials ? HG_OK : HG_MEMORY;
    if (status == HG_OK) {
        args.scratch = scratch->data;
        if (hg_needs_grad(call->in[0])) args.drows = hg_grad_data(call->in[0], &args.drows_fresh);
        if (hg_needs_grad(call->in[1])) args.dgroups = partials->data;
        status = hg_launch(ctx, &pair_backward_kernel, blocks, &args);
    }
    if (status == HG_OK && args.dgroups) {
        bool fresh;
        void *dgroups = hg_grad_data(call->in[1], &fresh);
        status = hg_add_partials(ctx, dtype, blocks, args.groups * args.width, args.dgroups, dgroups, fresh);
    }
    hg_step_rewind(ctx, mark);
    return status;
}

static void pair_reference(const hg_call *call, double *out)
{
    const hg_tensor *rows = call->in[0], *groups = call->in[1];
    for (int64_t b = 0; b < groups->shape[0]; b++)
        for (int64_t s = 0; s < rows->shape[0]; s++)
            for (int64_t h = 0; h < rows->shape[1]; h++)
                *out++ = hg_activation_reference(((const linear_attributes *)call->attributes)->activation,
                                                 hg_tensor_item(rows, s * rows->shape[1] + h) +
                                                     hg_tensor_item(groups, b * rows->shape[1] + h));
}

static bool pair_kink(const hg_call *call, int in, int64_t element, double step)
{
    (void)in, (void)element;
    if (!hg_activation_has_kink(((const linear_attributes *)call->attributes)->activation)) return false;
    const hg_tensor *rows = call->in[0], *groups = call->in[1];
    for (int64_t i = 0; i < hg_tensor_count(rows); i++)
        for (int64_t b = 0; b < groups->shape[0]; b++)
            if (fabs(hg_tensor_item(rows, i) + hg_tensor_item(groups, b * rows->shape[1] + i % rows->shape[1])) <
                4 * step)
                return true;
    return false;
}

/* [B,1,H] + [S,H]: the groups get an axis, then shapes broadcast. */
static hg_status pair_emit(const hg_call *call, hg_emitter *e)
{
    int rows = e->input(e->self, call->in[0]), groups = e->input(e->self, call->in[1]);
    int axes = e->constant_i64(e->self, 1, (int64_t[]){ 1 }, (int64_t[]){ 1 });
    int column = e->node(e->self, "Unsqueeze", 2, (int[]){ groups, axes }, "");
    int sum = e->node(e->self, "Add", 2, (int[]){ column, rows }, "");
    return e->output(e->self, call->out,
                     hg_emit_activation(e, ((const linear_attributes *)call->attributes)->activation, sum));
}

#define PAIR_SAMPLE(label_, activation_, rows_, groups_, width_)                                                       \
    {                                                                                                                  \
        .label = label_, .n_in = 2, .in = { { 2, { rows_, width_ } }, { 2, { groups_, width_ } } },                    \
        .attributes = &(const linear_attributes)                                                                       \
        {                                                                                                              \
            activation_                                                                                                \
        }                                                                                                              \
    }
static const hg_sample pair_samples[] = {
    PAIR_SAMPLE("identity", HG_IDENTITY, 4, 3, 5), PAIR_SAMPLE("relu", HG_RELU, 3, 2, 2),
    PAIR_SAMPLE("silu", HG_SILU, 4, 3, 5),         PAIR_SAMPLE("tanh", HG_TANH, 4, 1, 5),
    PAIR_SAMPLE("one", HG_GELU, 1, 1, 1),          PAIR_SAMPLE("no rows", HG_TANH, 0, 2, 3),
    PAIR_SAMPLE("no groups", HG_TANH, 2, 0, 3),    PAIR_SAMPLE("several blocks", HG_SILU, 520, 2, 3),
};
HG_OP(linear_pair, .formula = "y[b,s] = act(rows[s] + groups[b])", .min_in = 2, .max_in = 2,
      .attributes_size = sizeof(linear_attributes), .shape = pair_shape, .forward = pair_forward,
      .backward = pair_backward, .samples = pair_samples, .n_samples = sizeof pair_samples / sizeof *pair_samples,
      .reference = pair_reference, .kink = pair_kink, .emit = pair_emit);

hg_tensor *hg_linear_pair(hg_ctx *ctx, hg_tensor *rows, hg_tensor *groups, hg_activation activation)
{
    return hg_apply(ctx, &op_linear_pair, 2, (hg_tensor *[]){ rows, groups }, &(linear_attributes){ activation });
}

/* ---- matmul ---- */

static hg_tensor *matmul_shape(hg_call *call)
{
    const hg_tensor *a = call->in[0], *b = call->in[1];
    if (!hg_floats_agree(call)) return NULL;
    if (a->rank < 1 || b->rank != 2 || last_of(a) != b->shape[0])
        return hg_refuse(call, "a [..,m,k] and b [k,n] do not fit");
    int64_t shape[HG_MAX_RANK];
    memcpy(shape, a->shape, sizeof shape);
    shape[a->rank - 1] = b->shape[1];
    return hg_out(call, a->dtype, a->rank, shape);
}

static hg_status matmul_forward(hg_call *call)
{
    const hg_tensor *a = call->in[0], *b = call->in[1];
    int64_t m = rows_of(a), k = b->shape[0], n = b->shape[1];
    return hg_product(call->ctx, a->dtype, false, false, m, n, k, 1, a->data, k, b->data, n, 0, call->out->data, n);
}

static hg_status matmul_backward(hg_call *call)
{
    hg_tensor *a = call->in[0], *b = call->in[1];
    const void *g = hg_grad(call->out)->data;
    int64_t m = rows_of(a), k = b->shape[0], n = b->shape[1];
    if (hg_needs_grad(a)) {
        void *da = hg_grad(a)->data;
        HG_TRY(hg_product(call->ctx, a->dtype, false, true, m, k, n, 1, g, n, b->data, n, 1, da, k));
    }
    if (hg_needs_grad(b)) {
        void *db = hg_grad(b)->data;
        HG_TRY(hg_product(call->ctx, a->dtype, true, false, k, n, m, 1, a->data, k, g, n, 1, db, n));
    }
    return HG_OK;
}

static void matmul_reference(const hg_call *call, double *out)
{
    const hg_tensor *a = call->in[0], *b = call->in[1];
    int64_t m = rows_of(a), k = b->shape[0], n = b->shape[1];
    for (int64_t i = 0; i < m; i++)
        for (int64_t j = 0; j < n; j++) {
            double sum = 0;
            for (int64_t p = 0; p < k; p++) sum += hg_tensor_item(a, i * k + p) * hg_tensor_item(b, p * n + j);
            *out++ = sum;
        }
}

static hg_status matmul_emit(const hg_call *call, hg_emitter *e) { return hg_emit_one(call, e, "MatMul"); }

static const hg_sample matmul_samples[] = {
    { .label = "plain", .n_in = 2, .in = { { 2, { 3, 4 } }, { 2, { 4, 5 } } } },
    { .label = "vector", .n_in = 2, .in = { { 1, { 4 } }, { 2, { 4, 2 } } } },
    { .label = "leading axes", .n_in = 2, .in = { { 4, { 2, 1, 3, 4 } }, { 2, { 4, 5 } } } },
    { .label = "one", .n_in = 2, .in = { { 2, { 1, 1 } }, { 2, { 1, 1 } } } },
    { .label = "empty", .n_in = 2, .in = { { 2, { 0, 4 } }, { 2, { 4, 5 } } } },
    { .label = "empty sum", .n_in = 2, .in = { { 2, { 3, 0 } }, { 2, { 0, 5 } } } },
    { .label = "long sum", .n_in = 2, .in = { { 2, { 700, 2 } }, { 2, { 2, 3 } } } },
};
HG_OP(matmul, .formula = "C = A B", .min_in = 2, .max_in = 2, .shape = matmul_shape, .forward = matmul_forward,
      .backward = matmul_backward, .samples = matmul_samples,
      .n_samples = sizeof matmul_samples / sizeof *matmul_samples, .reference = matmul_reference, .emit = matmul_emit);

hg_tensor *hg_matmul(hg_ctx *ctx, hg_tensor *a, hg_tensor *b)
{
    return hg_apply(ctx, &op_matmul, 2, (hg_tensor *[]){ a, b }, NULL);
}
