/* emit_vector: ONNX nodes for products of vectors and quaternions along the last axis, for the emitters of the ops that have
 * them. Everything broadcasts over the leading axes as the ops do. */
#include "autograd/tape.h"

static int two(hg_emitter *e, const char *op_type, int a, int b)
{
    return e->node(e->self, op_type, 2, (int[]){ a, b }, "");
}

int hg_emit_pick(hg_emitter *e, int value, int n, const int64_t *which)
{
    const int64_t count = n;
    const int in[2] = { value, e->constant_i64(e->self, 1, &count, which) };
    return e->node(e->self, "Gather", 2, in, "axis=i", (int64_t)-1);
}

int hg_emit_dot(hg_emitter *e, int a, int b)
{
    const int in[2] = { two(e, "Mul", a, b), e->constant_i64(e->self, 1, (int64_t[]){ 1 }, (int64_t[]){ -1 }) };
    return e->node(e->self, "ReduceSum", 2, in, "keepdims=i", (int64_t)1);
}

/* a_yzx b_zxy - a_zxy b_yzx */
int hg_emit_cross(hg_emitter *e, int a, int b)
{
    static const int64_t yzx[3] = { 1, 2, 0 }, zxy[3] = { 2, 0, 1 };
    const int plus = two(e, "Mul", hg_emit_pick(e, a, 3, yzx), hg_emit_pick(e, b, 3, zxy));
    const int minus = two(e, "Mul", hg_emit_pick(e, a, 3, zxy), hg_emit_pick(e, b, 3, yzx));
    return two(e, "Sub", plus, minus);
}

/* a_w b + a_x i b + a_y j b + a_z k b: i, j and k change places and signs of b's numbers. */
int hg_emit_quat_mul(hg_emitter *e, int a, int b)
{
    static const int64_t place[4][4] = { { 0, 1, 2, 3 }, { 1, 0, 3, 2 }, { 2, 3, 0, 1 }, { 3, 2, 1, 0 } };
    static const float sign[4][4] = { { 1, 1, 1, 1 }, { -1, 1, -1, 1 }, { -1, 1, 1, -1 }, { -1, -1, 1, 1 } };
    int sum = -1;
    for (int k = 0; k < 4; k++) {
        const int64_t four = 4, number = k;
        int turned = k ? hg_emit_pick(e, b, 4, place[k]) : b;
        if (k) turned = two(e, "Mul", turned, e->constant_f32(e->self, 1, &four, sign[k]));
        const int part = two(e, "Mul", hg_emit_pick(e, a, 1, &number), turned);
        sum = k ? two(e, "Add", sum, part) : part;
    }
    return sum;
}

/* The vector part of q v conj(q), with q = (w, u): (w^2 - u.u) v + 2 (u.v) u + 2 w (u x v) */
int hg_emit_quat_rotate(hg_emitter *e, int q, int v)
{
    static const int64_t first = 0, last[3] = { 1, 2, 3 };
    const int w = hg_emit_pick(e, q, 1, &first), u = hg_emit_pick(e, q, 3, last), twice = hg_emit_scalar(e, 2);
    const int along = two(e, "Mul", two(e, "Sub", two(e, "Mul", w, w), hg_emit_dot(e, u, u)), v);
    const int axis = two(e, "Mul", hg_emit_dot(e, u, v), u), turned = two(e, "Mul", w, hg_emit_cross(e, u, v));
    return two(e, "Add", along, two(e, "Mul", twice, two(e, "Add", axis, turned)));
}

/* (a.h, a x h), h = (a + b) / sqrt(max(|a + b|^2, 1e-4)) */
int hg_emit_transport(hg_emitter *e, int a, int b)
{
    const int sum = two(e, "Add", a, b), bounded = two(e, "Max", hg_emit_dot(e, sum, sum), hg_emit_scalar(e, 1e-4));
    const int h = two(e, "Div", sum, e->node(e->self, "Sqrt", 1, &bounded, ""));
    const int parts[2] = { hg_emit_dot(e, a, h), hg_emit_cross(e, a, h) };
    return e->node(e->self, "Concat", 2, parts, "axis=i", (int64_t)-1);
}
