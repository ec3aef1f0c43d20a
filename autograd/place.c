/* place: how a network's output becomes hair. x = p + R (rest + d - rest_root); the root lies at p whatever d is.
 * The gradient goes to d alone; rest, rotation and position are data. */
#include "autograd/place.kernel.h"
#include "autograd/tape.h"

static bool has_shape(const hg_tensor *tensor, int rank, const int64_t *shape)
{
    if (tensor->rank != rank) return false;
    for (int i = 0; i < rank; i++)
        if (tensor->shape[i] != shape[i]) return false;
    return true;
}

static hg_tensor *place_shape(hg_call *call)
{
    const hg_tensor *d = call->in[0], *rest = call->in[1], *rotation = call->in[2], *position = call->in[3];
    if (!hg_floats_agree(call)) return NULL;
    if (d->rank != 4 || d->shape[3] != 3) return hg_refuse(call, "d has to be [B,S,V-1,3]");
    int64_t b = d->shape[0], s = d->shape[1], v = d->shape[2] + 1;
    if (!has_shape(rest, 3, (int64_t[]){ s, v, 3 }) && !has_shape(rest, 4, (int64_t[]){ b, s, v, 3 }))
        return hg_refuse(call, "for d [B,S,V-1,3] rest has to be [S,V,3] or [B,S,V,3]");
    if (!has_shape(rotation, 3, (int64_t[]){ b, s, 4 }) || !has_shape(position, 3, (int64_t[]){ b, s, 3 }))
        return hg_refuse(call, "for d [B,S,V-1,3] rotation has to be [B,S,4] and position [B,S,3]");
    for (int i = 1; i < 4; i++)
        if (hg_call_recorded(call) && hg_needs_grad(call->in[i]))
            return hg_refuse(call, "only d has a gradient here; detach rest, rotation and position");
    return hg_out(call, d->dtype, 4, (int64_t[]){ b, s, v, 3 });
}

static place_args place_arguments(const hg_call *call)
{
    const hg_tensor *x = call->out, *rest = call->in[1];
    return (place_args){ .strands = x->shape[1],
                         .vertices = x->shape[2],
                         .shared_rest = rest->rank == 3,
                         .d = call->in[0]->data,
                         .rest = rest->data,
                         .rotation = call->in[2]->data,
                         .position = call->in[3]->data,
                         .x = x->data };
}

static hg_status place_forward(hg_call *call)
{
    const place_args args = place_arguments(call);
    return hg_launch(call->ctx, place_forward_kernels[call->out->dtype == HG_F64], hg_tensor_count(call->out) / 3,
                     &args);
}

static hg_status place_backward(hg_call *call)
{
    hg_tensor *d = call->in[0];
    bool fresh;
    place_args args = place_arguments(call);
    args.g = hg_grad(call->out)->data;
    args.dd = hg_grad_data(d, &fresh);
    args.fresh = fresh;
    return hg_launch(call->ctx, place_backward_kernels[d->dtype == HG_F64], hg_tensor_count(d) / 3, &args);
}

/* v + 2 w (u x v) + 2 u x (u x v), for a quaternion (w, u) of length one. */
static void rotate(const double q[4], const double v[3], double out[3])
{
    const double *u = q + 1;
    double a[3] = { u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0] };
    double b[3] = { u[1] * a[2] - u[2] * a[1], u[2] * a[0] - u[0] * a[2], u[0] * a[1] - u[1] * a[0] };
    for (int k = 0; k < 3; k++) out[k] = v[k] + 2 * q[0] * a[k] + 2 * b[k];
}

static void place_reference(const hg_call *call, double *out)
{
    const hg_tensor *x = call->out, *d = call->in[0], *rest = call->in[1];
    int64_t strands = x->shape[1], vertices = x->shape[2];
    for (int64_t i = 0; i < x->shape[0] * strands; i++)
        for (int64_t v = 0; v < vertices; v++, out += 3) {
            int64_t at = (rest->rank == 3 ? i % strands : i) * vertices;
            double q[4], e[3];
            for (int k = 0; k < 4; k++) q[k] = hg_tensor_item(call->in[2], i * 4 + k);
            for (int k = 0; k < 3; k++)
                e[k] = hg_tensor_item(rest, (at + v) * 3 + k) - hg_tensor_item(rest, at * 3 + k) +
                       (v ? hg_tensor_item(d, (i * (vertices - 1) + v - 1) * 3 + k) : 0);
            rotate(q, e, out);
            for (int k = 0; k < 3; k++) out[k] += hg_tensor_item(call->in[3], i * 3 + k);
        }
}

static const double unit_quaternions[] = { 0.5, 0.5, -0.5, 0.5, 0.6, 0, 0.8, 0, 1, 0, 0, 0, 0.36, 0.48, -0.8, 0 };
#define PLACE(label_, b_, s_, v_, rest_rank_, ...)                                                                     \
    {                                                                                                                  \
        .label = label_, .n_in = 4, .in = {                                                                            \
            { 4, { b_, s_, v_ - 1, 3 } },                                                                              \
            { rest_rank_, { __VA_ARGS__ }, .no_grad = true },                                                          \
            { 3, { b_, s_, 4 }, .no_grad = true, .values = unit_quaternions },                                         \
            { 3, { b_, s_, 3 }, .no_grad = true }                                                                      \
        }                                                                                                              \
    }
static const hg_sample place_samples[] = {
    PLACE("shared rest", 2, 2, 4, 3, 2, 4, 3), PLACE("rest per frame", 2, 2, 3, 4, 2, 2, 3, 3),
    PLACE("one edge", 1, 1, 2, 3, 1, 2, 3),    PLACE("roots only", 1, 2, 1, 3, 2, 1, 3),
    PLACE("no strands", 1, 0, 4, 3, 0, 4, 3),
};
static int at_axis(hg_emitter *e, const char *op_type, int value, int64_t axis)
{
    const int in[2] = { value, e->constant_i64(e->self, 1, (int64_t[]){ 1 }, &axis) };
    return e->node(e->self, op_type, 2, in, "");
}

static hg_status place_emit(const hg_call *call, hg_emitter *e)
{
    int in[4];
    for (int i = 0; i < 4; i++) in[i] = e->input(e->self, call->in[i]);
    static const int64_t before[8] = { 0, 0, 1, 0, 0, 0, 0, 0 }, eight = 8, one = 1, zero = 0;
    const int pads[2] = { in[0], e->constant_i64(e->self, 1, &eight, before) };
    const int d = e->node(e->self, "Pad", 2, pads, ""); /* the root does not move */
    const int axis = e->constant_i64(e->self, 1, &one, (int64_t[]){ -2 });
    const int root[4] = { in[1], e->constant_i64(e->self, 1, &one, &zero), e->constant_i64(e->self, 1, &one, &one),
                          axis };
    const int from_root = e->node(e->self, "Sub", 2, (int[]){ in[1], e->node(e->self, "Slice", 4, root, "") }, "");
    const int moved = e->node(e->self, "Add", 2, (int[]){ from_root, d }, "");
    const int turned = hg_emit_quat_rotate(e, at_axis(e, "Unsqueeze", in[2], 2), moved);
    const int x = e->node(e->self, "Add", 2, (int[]){ at_axis(e, "Unsqueeze", in[3], 2), turned }, "");
    return e->output(e->self, call->out, x);
}

HG_OP(place, .formula = "x = p + R (rest + d - rest_root)", .min_in = 4, .max_in = 4, .shape = place_shape,
      .forward = place_forward, .backward = place_backward, .samples = place_samples,
      .n_samples = sizeof place_samples / sizeof *place_samples, .reference = place_reference, .emit = place_emit);

hg_tensor *hg_place(hg_ctx *ctx, hg_tensor *d, hg_tensor *rest, hg_tensor *rotation, hg_tensor *position)
{
    return hg_apply(ctx, &op_place, 4, (hg_tensor *[]){ d, rest, rotation, position }, NULL);
}
