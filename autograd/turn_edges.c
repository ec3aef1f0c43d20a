/* turn_edges: displacements of a strand whose edges turn and keep their lengths.
 *
 *     t_i = (t0_i + a_i) / |t0_i + a_i|        t0_i the rest edge's direction, a_i what a network says
 *     d_v = sum over i < v of l_i (t_i - t0_i)
 *
 * a [..,E,3] are the last E of the V-1 edges of a strand; those before them stay as they are. It is how a network can be
 * trained against stiff springs: no output stretches an edge, so bending, weight and contact are what is left to learn.
 * |t0 + a| is at least 0.01 where it is divided by; an edge of no length has no direction and moves nothing. */
#include "autograd/turn_edges.kernel.h"
#include "autograd/tape.h"

#include <math.h>

static hg_tensor *turn_shape(hg_call *call)
{
    const hg_tensor *a = call->in[0], *rest = call->in[1];
    if (!hg_floats_agree(call)) return NULL;
    if (a->rank < 3 || a->rank > 4 || a->shape[a->rank - 1] != 3 || rest->rank != 3 || rest->shape[2] != 3)
        return hg_refuse(call, "a has to be [B,S,E,3] or [S,E,3], and rest [S,V,3]");
    const int64_t strands = a->shape[a->rank - 3], turned = a->shape[a->rank - 2], edges = rest->shape[1] - 1;
    if (rest->shape[0] != strands || edges < 0 || turned > edges)
        return hg_refuse(call, "%lld strands with %lld edges to turn, the rest has %lld strands of %lld edges",
                         (long long)strands, (long long)turned, (long long)rest->shape[0], (long long)edges);
    if (hg_call_recorded(call) && hg_needs_grad(rest))
        return hg_refuse(call, "only a has a gradient here; detach rest");
    int64_t shape[4] = { a->shape[0], a->shape[1], a->shape[2], 3 };
    shape[a->rank - 2] = edges;
    return hg_out(call, a->dtype, a->rank, shape);
}

static turn_args turn_arguments(const hg_call *call)
{
    const hg_tensor *a = call->in[0], *rest = call->in[1];
    return (turn_args){ .strands = rest->shape[0],
                        .edges = rest->shape[1] - 1,
                        .turned = a->shape[a->rank - 2],
                        .a = a->data,
                        .rest = rest->data,
                        .d = call->out->data };
}

static int64_t rows(const hg_call *call)
{
    const hg_tensor *a = call->in[0];
    return a->shape[a->rank - 3] * (a->rank == 4 ? a->shape[0] : 1);
}

static hg_status turn_forward(hg_call *call)
{
    const turn_args args = turn_arguments(call);
    return hg_launch(call->ctx, turn_forward_kernels[call->out->dtype == HG_F64], rows(call), &args);
}

static hg_status turn_backward(hg_call *call)
{
    bool fresh;
    turn_args args = turn_arguments(call);
    args.g = hg_grad(call->out)->data;
    args.da = hg_grad_data(call->in[0], &fresh);
    args.fresh = fresh;
    return hg_launch(call->ctx, turn_backward_kernels[call->out->dtype == HG_F64], rows(call), &args);
}

static void turn_reference(const hg_call *call, double *out)
{
    const hg_tensor *a = call->in[0], *rest = call->in[1];
    const int64_t strands = rest->shape[0], edges = rest->shape[1] - 1, turned = a->shape[a->rank - 2];
    for (int64_t i = 0, n = rows(call); i < n; i++) {
        double sum[3] = { 0 };
        for (int64_t v = 0; v < edges; v++, out += 3) {
            const int64_t at = (i % strands * (edges + 1) + v) * 3, k = v - (edges - turned);
            double e[3], u[3];
            for (int c = 0; c < 3; c++) e[c] = hg_tensor_item(rest, at + 3 + c) - hg_tensor_item(rest, at + c);
            const double length = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]);
            for (int c = 0; c < 3; c++)
                u[c] = e[c] / fmax(length, LEAST_LENGTH) + (k >= 0 ? hg_tensor_item(a, (i * turned + k) * 3 + c) : 0);
            const double size = sqrt(fmax(u[0] * u[0] + u[1] * u[1] + u[2] * u[2], LEAST_SQUARE));
            for (int c = 0; c < 3; c++) {
                if (k >= 0) sum[c] += length * (u[c] / size - e[c] / fmax(length, LEAST_LENGTH));
                out[c] = sum[c];
            }
        }
    }
}

static int numbers(hg_emitter *e, int64_t n, const int64_t *values) { return e->constant_i64(e->self, 1, &n, values); }

static int slice_axis(hg_emitter *e, int value, int64_t first, int64_t last)
{
    const int in[4] = { value, numbers(e, 1, &first), numbers(e, 1, &last), numbers(e, 1, (int64_t[]){ -2 }) };
    return e->node(e->self, "Slice", 4, in, "");
}

/* |x| along the last axis, kept, and at least `least`. */
static int length_of(hg_emitter *e, int value, double least)
{
    const int squares = e->node(e->self, "Mul", 2, (int[]){ value, value }, "");
    const int sum = e->node(e->self, "ReduceSum", 2, (int[]){ squares, numbers(e, 1, (int64_t[]){ -1 }) }, "");
    const int bound = hg_emit_scalar(e, least * least);
    const int bounded = e->node(e->self, "Max", 2, (int[]){ sum, bound }, "");
    return e->node(e->self, "Sqrt", 1, &bounded, "");
}

static hg_status turn_emit(const hg_call *call, hg_emitter *e)
{
    const hg_tensor *a = call->in[0];
    const int64_t edges = call->in[1]->shape[1] - 1, still = edges - a->shape[a->rank - 2];
    const int rest = e->input(e->self, call->in[1]), turn = e->input(e->self, a);
    const int edge = e->node(
        e->self, "Sub", 2, (int[]){ slice_axis(e, rest, still + 1, edges + 1), slice_axis(e, rest, still, edges) }, "");
    const int length = length_of(e, edge, LEAST_LENGTH);
    const int t0 = e->node(e->self, "Div", 2, (int[]){ edge, length }, "");
    const int u = e->node(e->self, "Add", 2, (int[]){ t0, turn }, "");
    const int t = e->node(e->self, "Div", 2, (int[]){ u, length_of(e, u, sqrt(LEAST_SQUARE)) }, "");
    const int turned =
        e->node(e->self, "Mul", 2, (int[]){ length, e->node(e->self, "Sub", 2, (int[]){ t, t0 }, "") }, "");
    int sum = e->node(e->self, "CumSum", 2, (int[]){ turned, numbers(e, 1, (int64_t[]){ a->rank - 2 }) }, "");
    if (still > 0) {
        int64_t pads[8] = { 0 };
        pads[a->rank - 2] = still;
        sum = e->node(e->self, "Pad", 2, (int[]){ sum, numbers(e, 2 * a->rank, pads) }, "");
    }
    return e->output(e->self, call->out, sum);
}

static const double crooked[] = { 0,   0,    0,   0.1, 0.02, 0,    0.15, 0.1,  0.03, 0.2, 0.1, 0.1,
                                  0.3, -0.1, 0.2, 0.3, -0.2, 0.25, 0.35, -0.2, 0.4,  0.3, 0.1, 0.5 };
static const hg_sample turn_samples[] = {
    { .label = "all edges",
      .n_in = 2,
      .in = { { 4, { 2, 2, 3, 3 }, .low = -0.5, .high = 0.5 },
              { 3, { 2, 4, 3 }, .no_grad = true, .values = crooked } } },
    { .label = "two edges stay",
      .n_in = 2,
      .in = { { 4, { 2, 2, 1, 3 }, .low = -0.5, .high = 0.5 },
              { 3, { 2, 4, 3 }, .no_grad = true, .values = crooked } } },
    { .label = "no frames axis",
      .n_in = 2,
      .in = { { 3, { 2, 2, 3 }, .low = -0.5, .high = 0.5 }, { 3, { 2, 4, 3 }, .no_grad = true, .values = crooked } } },
    { .label = "one edge",
      .n_in = 2,
      .in = { { 3, { 1, 1, 3 }, .low = -0.5, .high = 0.5 }, { 3, { 1, 2, 3 }, .no_grad = true, .values = crooked } } },
    { .label = "no strands", .n_in = 2, .in = { { 4, { 2, 0, 3, 3 } }, { 3, { 0, 4, 3 }, .no_grad = true } } },
};
HG_OP(turn_edges, .formula = "d_v = sum_{i<v} l_i ((t_i + a_i) / |t_i + a_i| - t_i), t_i and l_i of the rest edges",
      .min_in = 2, .max_in = 2, .shape = turn_shape, .forward = turn_forward, .backward = turn_backward,
      .samples = turn_samples, .n_samples = sizeof turn_samples / sizeof *turn_samples, .reference = turn_reference,
      .emit = turn_emit);

hg_tensor *hg_turn_edges(hg_ctx *ctx, hg_tensor *a, hg_tensor *rest)
{
    return hg_apply(ctx, &op_turn_edges, 2, (hg_tensor *[]){ a, rest }, NULL);
}
