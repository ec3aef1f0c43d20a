/* inputs: what physics is given beside the strands where an energy asks for it: materials, ghosts, how far the strands are from
 * the posed groom, and the orientations of their edges.
 *
 *   ghost        the rigidly posed groom: what springs to ghosts hold on to moves with the head
 *   deformation  x - posed, differentiable, over runs of training.consecutive frames (pose_reg)
 *   q            R o q0 of every edge [w,x,y,z]: the rest frame q0, carried along the rest strand as cosserat_bend_twist does, the
 *                network's own turn o in head rest space (1 + offset, not of length one: unit_quaternion sees to that), and the
 *                root's rotation R. In head rest space, since equal turns of neighbours then bend nothing, as equal
 *                displacements stretch nothing. model.orientation_of: edges puts the short way from the posed edge to the
 *                edge before it (network.c). */
#include "tasks/hair.h"

#include "geometry/vector.h"

#include <math.h>
#include <string.h>

/* ---- what is asked for -------------------------------------------------------------------------------------- */

hg_status hg_hair_asks_of(hg_hair_asks *asks, const hg_hair_terms *terms)
{
    *asks = (hg_hair_asks){ 0 };
    for (int t = 0; t < terms->n; t++) {
        const hg_term *term = &terms->term[t];
        hg_energy_inputs inputs;
        HG_TRY(hg_energy_asks(term->energy, term->options, false, &inputs));
        for (int i = 0; i < inputs.n; i++) {
            const hg_energy_input *input = &inputs.input[i];
            if (!strcmp(input->name, "q"))
                asks->q = term->energy->name;
            else if (!strcmp(input->name, "ghost"))
                asks->ghost = true;
            else if (!strcmp(input->name, "deformation"))
                asks->deformation = term->energy->name;
        }
    }
    return HG_OK;
}

/* ---- frames of edges ---------------------------------------------------------------------------------------- */

static hg_vec3d edge(const float *x, int64_t v)
{
    double e[3], squares = 0;
    for (int k = 0; k < 3; k++) {
        e[k] = (double)x[3 * v + 3 + k] - (double)x[3 * v + k];
        squares += e[k] * e[k];
    }
    const double least = 1e-3 * fmax(sqrt(squares), 1e-6);
    return hg_vec3d_scale(hg_vec3d_load(e), 1 / sqrt(fmax(squares, least * least)));
}

void hg_hair_edge_frames(const float *rest, int64_t vertices, float *q)
{
    hg_quatd frame = { 0 };
    for (int64_t v = 0; v + 1 < vertices; v++) {
        frame = v == 0 ? hg_quatd_transport(hg_vec3d_make(0, 0, 1), edge(rest, 0))
                       : hg_quatd_mul(hg_quatd_transport(edge(rest, v - 1), edge(rest, v)), frame);
        q[4 * v] = (float)frame.w, q[4 * v + 1] = (float)frame.x, q[4 * v + 2] = (float)frame.y,
              q[4 * v + 3] = (float)frame.z;
    }
}

/* ---- inputs of a call --------------------------------------------------------------------------------------- */

/* Rows [G S,..] of the frames' grooms: [S,..] where there is one, else [B,S,..]. */
static hg_tensor *of_grooms(hg_ctx *ctx, const hg_hair_subset *subset, hg_tensor *rows, const hg_frame *frame)
{
    if (subset->grooms == 1 || !rows) return rows;
    const int64_t B = frame->root_rotation->shape[0], width = hg_tensor_count(rows) / subset->grooms;
    int64_t shape[HG_MAX_RANK] = { B, subset->n };
    for (int i = 1; i < rows->rank; i++) shape[i + 1] = rows->shape[i];
    hg_tensor *each = hg_reshape(ctx, rows, 2, (int64_t[]){ subset->grooms, width });
    hg_tensor *groom = hg_tensor_from(ctx, HG_I32, 1, &B, frame->groom);
    return hg_reshape(ctx, hg_gather(ctx, each, groom), rows->rank + 1, shape);
}

hg_tensor *hg_hair_posed(hg_ctx *ctx, hg_tensor *rest, hg_tensor *rotation, hg_tensor *position)
{
    if (!rest || !rotation || !position) return NULL;
    const int64_t V = rest->shape[rest->rank - 2];
    hg_tensor *still =
        hg_tensor_make(ctx, rest->dtype, 4, (int64_t[]){ rotation->shape[0], rotation->shape[1], V - 1, 3 });
    if (!still || hg_tensor_fill(still, 0) != HG_OK) return NULL;
    return hg_place(ctx, still, rest, rotation, position);
}

static hg_tensor *posed_edges(hg_ctx *ctx, const hg_hair_subset *subset, const hg_frame *frame)
{
    const int64_t shape[4] = { frame->root_rotation->shape[0], subset->n, 1, 4 };
    return hg_quat_mul(ctx, hg_reshape(ctx, frame->root_rotation, 4, shape),
                       of_grooms(ctx, subset, subset->edges, frame));
}

static hg_status add(hg_ctx *ctx, hg_frame_input *inputs, int *n, const char *name, hg_tensor *value)
{
    inputs[*n].name = name;
    inputs[(*n)++].value = value;
    return value ? HG_OK : hg_ctx_status(ctx);
}

/* values [B,n_materials + n_ramps], NULL: those of a drape. */
static hg_status add_materials(const hg_hair_task *task, hg_ctx *ctx, const double *values, int64_t B, int64_t S,
                               hg_frame_input *inputs, int *n)
{
    const int given = task->n_materials + task->n_ramps;
    for (int i = 0; i < task->n_materials; i++) {
        float *out = hg_step_alloc(ctx, (size_t)(B * S) * sizeof *out);
        if (!out) return hg_ctx_status(ctx);
        for (int64_t b = 0; b < B; b++)
            for (int64_t s = 0; s < S; s++)
                out[b * S + s] = (float)(values ? values[b * given + i] : task->materials[i].value);
        HG_TRY(add(ctx, inputs, n, task->materials[i].name, hg_tensor_from(ctx, HG_F32, 2, (int64_t[]){ B, S }, out)));
    }
    for (int i = 0; values && i < task->n_ramps; i++) { /* one number: that of the step */
        float *out = hg_step_alloc(ctx, sizeof *out);
        if (!out) return hg_ctx_status(ctx);
        *out = (float)values[task->n_materials + i];
        HG_TRY(add(ctx, inputs, n, task->ramps[i].name, hg_tensor_from(ctx, HG_F32, 0, NULL, out)));
    }
    for (int i = 0; i < task->n_learnt; i++)
        HG_TRY(add(ctx, inputs, n, task->learnt[i].name,
                   hg_scale(ctx, hg_exp(ctx, task->learnt[i].theta), task->learnt[i].start, 0)));
    return HG_OK;
}

hg_status hg_hair_physics_inputs(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_subset *subset,
                                 const double *materials, const hg_hair_strands *strands, hg_frame *frame)
{
    const hg_hair_asks *asks = &task->asks;
    const int most = task->n_materials + task->n_ramps + task->n_learnt + 4;
    hg_frame_input *inputs = hg_step_alloc(ctx, (size_t)most * sizeof *inputs);
    int n = 0;
    if (!inputs) return hg_ctx_status(ctx);
    HG_TRY(add_materials(task, ctx, materials, strands->x->shape[0], subset->n, inputs, &n));
    if (asks->ghost || asks->deformation) {
        hg_no_grad_begin(ctx);
        hg_tensor *posed =
            hg_hair_posed(ctx, of_grooms(ctx, subset, subset->rest, frame), frame->root_rotation, frame->root_position);
        hg_no_grad_end(ctx);
        if (asks->ghost) HG_TRY(add(ctx, inputs, &n, "ghost", posed));
        if (asks->deformation) HG_TRY(add(ctx, inputs, &n, "deformation", hg_sub(ctx, strands->x, posed)));
        if (asks->deformation && strands->mean) HG_TRY(add(ctx, inputs, &n, "deformation_mean", strands->mean));
    }
    if (asks->q) HG_TRY(add(ctx, inputs, &n, "q", strands->q ? strands->q : posed_edges(ctx, subset, frame)));
    frame->inputs = inputs;
    frame->n_inputs = n;
    return hg_ctx_status(ctx);
}
