/* network: the model of a config, of whatever family; what an output of it is; and strands from it. */
#include "tasks/hair.h"

#include <string.h>

hg_status hg_hair_network_find(hg_hair_task *task)
{
    const hg_architecture *architecture;
    HG_TRY(hg_architecture_find(&architecture, hg_config_text(task->config, "model.kind")));
    task->network = architecture->images ? &hg_hair_network_texture : &hg_hair_network_strands;
    return HG_OK;
}

/* ---- model -------------------------------------------------------------------------------------------------- */

/* What an output is.
 *   vertices     displacements, as published
 *   edges        displacements of edges, so that a vertex moves by the sum of the edges before it
 *   directions   changes of the unit directions of edges, which keep their lengths (hg_turn_edges)
 * The first two are one constant matrix [outputs,(V-1)*3] after the network. With two vertices pinned the first edge stays
 * as it is. Behind them, with orientations, stand four numbers for each of these edges: what its frame's turn differs from
 * none by. */
static hg_status make_output(hg_hair_task *task)
{
    const hg_config *config = task->config;
    const int64_t V = task->groom->vertices, columns = (V - 1) * 3;
    const char *output = hg_config_text(config, "model.output");
    task->pinned = (int)hg_config_integer(config, "model.pinned");
    if (task->pinned >= V)
        return hg_fail(HG_INVALID, "%s:%d: model.pinned: %d of %lld vertices are pinned: nothing is left to move",
                       hg_config_name(config), hg_config_line(config, "model.pinned"), task->pinned, (long long)V);
    const int64_t moved = (V - task->pinned) * 3;
    task->orientations = !strcmp(hg_config_text(config, "model.orientations"), "yes");
    task->orientation_scale = hg_config_number(config, "model.orientation_scale");
    if (task->asks.q && !task->orientations) {
        char losses[160];
        snprintf(losses, sizeof losses, "losses.%s", task->asks.q);
        return hg_fail(HG_INVALID,
                       "%s:%d: %s asks for the orientations of edges, and this network has none: "
                       "model.orientations is no",
                       hg_config_name(config), hg_config_line(config, losses), losses);
    }
    task->outputs = (int)(V - task->pinned) * (task->orientations ? 7 : 3);
    task->directions = !strcmp(output, "directions");
    task->output_scale = hg_config_number(config, task->directions ? "model.turn_scale" : "model.output_scale");
    task->world = !strcmp(hg_config_text(config, "model.space"), "world");
    if (task->world && task->directions)
        return hg_fail(HG_INVALID,
                       "%s:%d: model.space: world goes with outputs of vertices or edges; the directions of edges are "
                       "turned in the head's space",
                       hg_config_name(config), hg_config_line(config, "model.space"));
    if (task->orientations) {
        task->no_turn = hg_tensor_create(task->ctx, HG_F32, 1, (int64_t[]){ 4 });
        if (!task->no_turn) return HG_MEMORY;
        task->no_turn->name = "no_turn";
        HG_TRY(hg_tensor_write(task->no_turn, (float[]){ 1, 0, 0, 0 }));
        if (!strcmp(hg_config_text(config, "model.orientation_of"), "edges")) {
            task->along = hg_tensor_create(task->ctx, HG_F32, 1, (int64_t[]){ 3 });
            if (!task->along) return HG_MEMORY;
            HG_TRY(hg_tensor_write(task->along, (float[]){ 0, 0, 1 }));
        }
    }
    if (task->directions) return HG_OK;
    task->output_map = hg_tensor_create(task->ctx, HG_F32, 2, (int64_t[]){ moved, columns });
    if (!task->output_map) return HG_MEMORY;
    task->output_map->name = "output_map";
    float *map = hg_alloc((size_t)(moved * columns), sizeof *map);
    for (int64_t i = 0; map && i < moved; i++)
        for (int64_t column = i + (task->pinned - 1) * 3; column < columns; column += 3) {
            map[i * columns + column] = (float)task->output_scale;
            if (!strcmp(output, "vertices")) break;
        }
    const hg_status status = map ? hg_tensor_write(task->output_map, map) : HG_MEMORY;
    hg_free(map);
    return status;
}

hg_status hg_hair_network_create(hg_hair_task *task)
{
    HG_TRY(make_output(task));
    hg_model_spec spec = { .inputs = task->inputs,
                           .strand_inputs = task->strand_inputs,
                           .outputs = task->outputs,
                           .width = (int)hg_config_integer(task->config, "model.width"),
                           .depth = (int)hg_config_integer(task->config, "model.depth"),
                           .latent = task->latent,
                           .seed = task->seed };
    if (task->network->images) {
        spec.texture = (int)hg_config_integer(task->config, "model.texture");
        spec.groups = (int)hg_config_integer(task->config, "model.groups");
    }
    HG_TRY(hg_activation_parse(hg_config_text(task->config, "model.activation"), &spec.activation));
    HG_TRY(hg_model_create(&task->model, task->ctx, hg_config_text(task->config, "model.kind"), &spec));
    return task->network->check_model(task, task->model);
}

/* ---- strands ------------------------------------------------------------------------------------------------ */

/* [..,S,outputs] and rest [S,V,3] -> [..,S,V-1,3] */
static hg_tensor *displacements(const hg_hair_task *task, hg_ctx *ctx, hg_tensor *outputs, hg_tensor *rest)
{
    if (!outputs) return NULL;
    const int64_t V = task->groom->vertices;
    const bool framed = outputs->rank == 3;
    if (task->orientations) outputs = hg_slice(ctx, outputs, outputs->rank - 1, 0, (V - task->pinned) * 3);
    if (!outputs) return NULL;
    const int64_t edges = task->directions ? V - task->pinned : V - 1;
    hg_tensor *d =
        task->directions ? hg_scale(ctx, outputs, task->output_scale, 0) : hg_matmul(ctx, outputs, task->output_map);
    d = framed ? hg_reshape(ctx, d, 4, (int64_t[]){ outputs->shape[0], outputs->shape[1], edges, 3 })
               : hg_reshape(ctx, d, 3, (int64_t[]){ -1, edges, 3 });
    return task->directions ? hg_turn_edges(ctx, d, rest) : d;
}

/* d [R,S,V-1,3] from where the head carries the strands. */
static hg_tensor *place(const hg_hair_task *task, hg_ctx *ctx, hg_tensor *d, hg_tensor *rest, hg_tensor *rotation,
                        hg_tensor *position)
{
    if (!task->world) return hg_place(ctx, d, rest, rotation, position);
    hg_tensor *posed = hg_place(ctx, hg_scale(ctx, hg_detach(ctx, d), 0, 0), rest, rotation, position);
    return hg_add(ctx, hg_pad(ctx, d, 2, 1, 0), posed);
}

/* [..,S,outputs] -> the turns of the frames [..,S,V-1,4] in head rest space: 1 where the output is zero, or the edge pinned. */
static hg_tensor *turns(const hg_hair_task *task, hg_ctx *ctx, hg_tensor *outputs)
{
    if (!outputs) return NULL;
    const int64_t edges = task->groom->vertices - task->pinned;
    const int last = outputs->rank - 1;
    int64_t shape[4] = { 0 };
    for (int i = 0; i < last; i++) shape[i] = outputs->shape[i];
    shape[last] = edges, shape[last + 1] = 4;
    hg_tensor *o = hg_slice(ctx, outputs, last, edges * 3, edges * 4);
    o = hg_scale(ctx, hg_reshape(ctx, o, last + 2, shape), task->orientation_scale, 0);
    if (task->pinned > 1) o = hg_pad(ctx, o, last, task->pinned - 1, 0);
    return hg_add(ctx, o, task->no_turn);
}

/* The short way from the edges' directions with frames q [..,V-1,4] to those of strands x [..,V,3], as quaternions. */
static hg_tensor *carried(const hg_hair_task *task, hg_ctx *ctx, hg_tensor *q, hg_tensor *x)
{
    const int64_t edges = task->groom->vertices - 1;
    const int axis = x->rank - 2;
    hg_tensor *now = hg_normalize(ctx, hg_sub(ctx, hg_slice(ctx, x, axis, 1, edges), hg_slice(ctx, x, axis, 0, edges)));
    return hg_transport(ctx, hg_quat_rotate(ctx, q, task->along), now);
}

/* R o q0, or o R q0 where the axes are the world's, of rows with the roots' rotation [rows,S,4], rest frames q0 [S,V-1,4]; and
 * where turns are those of the strands' own edges, that with T of the strands x before it. */
static hg_tensor *edge_frames(const hg_hair_task *task, hg_ctx *ctx, hg_tensor *outputs, hg_tensor *rotation,
                              hg_tensor *edges, hg_tensor *x)
{
    if (!outputs || !rotation || !x) return NULL;
    hg_tensor *root = hg_reshape(ctx, rotation, 4, (int64_t[]){ rotation->shape[0], rotation->shape[1], 1, 4 });
    hg_tensor *o = turns(task, ctx, outputs), *posed = hg_quat_mul(ctx, root, edges);
    hg_tensor *q = task->world ? hg_quat_mul(ctx, o, posed) : hg_quat_mul(ctx, root, hg_quat_mul(ctx, o, edges));
    return task->along ? hg_quat_mul(ctx, carried(task, ctx, posed, x), q) : q;
}

hg_hair_part hg_hair_part_of(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_subset *subset)
{
    return (hg_hair_part){ .grooms = subset->grooms,
                           .strands = subset->n,
                           .rows = task->network->part(task, ctx, subset->features),
                           .texel = subset->texel,
                           .edges = subset->edges };
}

hg_status hg_hair_part_keep(hg_hair_part *part, const hg_hair_task *task, hg_ctx *ctx, const hg_hair_subset *subset)
{
    hg_step_reset(ctx);
    hg_no_grad_begin(ctx);
    *part = hg_hair_part_of(task, ctx, subset);
    hg_no_grad_end(ctx);
    const hg_tensor *made = part->rows;
    part->rows = NULL;
    HG_TRY(hg_ctx_status(ctx));
    part->rows = hg_tensor_create(ctx, HG_F32, made->rank, made->shape);
    return part->rows ? hg_tensor_copy(part->rows, made) : HG_MEMORY;
}

void hg_hair_part_free(hg_hair_part *part)
{
    hg_tensor_destroy(part->rows);
    *part = (hg_hair_part){ 0 };
}

/* n pieces along axis 0, with one more: as many as a concatenation takes are made one. */
static void add_piece(hg_ctx *ctx, hg_tensor **pieces, int *n, hg_tensor *piece)
{
    if (*n == HG_OP_INPUTS) {
        pieces[0] = hg_concat(ctx, 0, *n, pieces);
        *n = 1;
    }
    pieces[(*n)++] = piece;
}

hg_tensor *hg_hair_predict(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, const int32_t *groom,
                           hg_tensor *inputs, hg_tensor *rest, hg_tensor *rotation, hg_tensor *position)
{
    return hg_hair_predict_edges(task, ctx, part, groom, inputs, rest, rotation, position, NULL);
}

hg_tensor *hg_hair_predict_edges(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, const int32_t *groom,
                                 hg_tensor *inputs, hg_tensor *rest, hg_tensor *rotation, hg_tensor *position,
                                 hg_tensor **q)
{
    if (q) *q = NULL;
    if (!inputs || !part->rows || !rest || !rotation || !position) return NULL;
    const hg_hair_network *network = task->network;
    const int64_t R = inputs->shape[0], S = part->strands;
    hg_tensor *whole = hg_hair_images(task, ctx, part, groom, inputs);
    const bool with_edges = q && task->orientations && part->edges;
    hg_tensor *pieces[HG_OP_INPUTS], *edges[HG_OP_INPUTS];
    int n = 0, n_edges = 0;
    for (int64_t row = 0, end; row < R; row = end) {
        const int32_t g = groom ? groom[row] : 0;
        for (end = row + 1; end < R && (!groom || groom[end] == g); end++) {
        }
        hg_tensor *out = network->outputs(task, ctx, part, whole, row, end - row, g);
        hg_tensor *of = part->grooms == 1 ? rest : hg_tensor_rows(ctx, rest, g * S, S);
        hg_tensor *turned = hg_tensor_rows(ctx, rotation, row, end - row);
        hg_tensor *x = place(task, ctx, displacements(task, ctx, out, of), of, turned,
                             hg_tensor_rows(ctx, position, row, end - row));
        add_piece(ctx, pieces, &n, x);
        if (!with_edges) continue;
        add_piece(ctx, edges, &n_edges,
                  edge_frames(task, ctx, out, turned,
                              part->grooms == 1 ? part->edges : hg_tensor_rows(ctx, part->edges, g * S, S), x));
    }
    if (with_edges) *q = n_edges == 1 ? edges[0] : hg_concat(ctx, 0, n_edges, edges);
    return n == 1 ? pieces[0] : hg_concat(ctx, 0, n, pieces);
}

hg_tensor *hg_hair_images(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, const int32_t *groom,
                          hg_tensor *inputs)
{
    return task->network->images && inputs ? task->network->images(task, ctx, part, groom, inputs) : inputs;
}

hg_status hg_hair_predict_row(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, hg_tensor *whole,
                              int64_t row, hg_tensor *rest, const float *rotation, const float *position, float *x,
                              float *q)
{
    const hg_hair_network *network = task->network;
    const int64_t n = part->strands, V = rest->shape[1], most = network->together ? network->together : n;
    const hg_step_mark mark = hg_step_set_mark(ctx);
    hg_no_grad_begin(ctx);
    for (int64_t first = 0; first < n && hg_ctx_status(ctx) == HG_OK; first += most) {
        const int64_t count = n - first < most ? n - first : most;
        const hg_hair_part some = { .grooms = 1,
                                    .strands = count,
                                    .rows =
                                        network->of_grooms ? part->rows : hg_tensor_rows(ctx, part->rows, first, count),
                                    .texel = hg_tensor_rows(ctx, part->texel, first, count) };
        hg_tensor *of = hg_tensor_rows(ctx, rest, first, count);
        hg_tensor *out = network->outputs(task, ctx, &some, whole, row, 1, 0);
        hg_tensor *turned = hg_tensor_from(ctx, HG_F32, 3, (int64_t[]){ 1, count, 4 }, rotation + first * 4);
        hg_tensor *placed = place(task, ctx, displacements(task, ctx, out, of), of, turned,
                                  hg_tensor_from(ctx, HG_F32, 3, (int64_t[]){ 1, count, 3 }, position + first * 3));
        hg_tensor *edges =
            q ? edge_frames(task, ctx, out, turned, hg_tensor_rows(ctx, part->edges, first, count), placed) : NULL;
        if ((placed && hg_tensor_read(placed, x + first * V * 3) != HG_OK) ||
            (edges && hg_tensor_read(edges, q + first * (V - 1) * 4) != HG_OK))
            hg_ctx_fail(ctx, HG_UNSUPPORTED, "%s", hg_message());
        hg_step_rewind(ctx, mark);
    }
    hg_no_grad_end(ctx);
    return hg_ctx_status(ctx);
}

hg_status hg_hair_predict_frame(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, const float *inputs,
                                hg_tensor *rest, const float *rotation, const float *position, float *x)
{
    const hg_step_mark mark = hg_step_set_mark(ctx);
    hg_no_grad_begin(ctx);
    hg_tensor *whole = hg_hair_images(
        task, ctx, part, NULL, hg_tensor_from(ctx, HG_F32, 2, (int64_t[]){ 1, task->layout.frame_inputs }, inputs));
    const hg_status status = hg_hair_predict_row(task, ctx, part, whole, 0, rest, rotation, position, x, NULL);
    hg_no_grad_end(ctx);
    hg_step_rewind(ctx, mark);
    return status;
}

/* ---- for formulas ------------------------------------------------------------------------------------------- */

int hg_hair_turns(const hg_hair_task *task) { return task->orientations ? (int)(task->groom->vertices - 1) * 4 : 0; }

bool hg_hair_turns_edges(const hg_hair_task *task) { return task->along != NULL; }

/* Outputs as numbers in rows: displacements, then turns where there are any. */
hg_tensor *hg_hair_as_rows(const hg_hair_task *task, hg_ctx *ctx, hg_tensor *outputs, hg_tensor *rest)
{
    if (!outputs) return NULL;
    const int last = outputs->rank - 1, columns = (int)(task->groom->vertices - 1) * 3;
    int64_t shape[2][3];
    for (int k = 0; k < 2; k++) {
        for (int i = 0; i < last; i++) shape[k][i] = outputs->shape[i];
        shape[k][last] = k ? hg_hair_turns(task) : columns;
    }
    hg_tensor *d = hg_reshape(ctx, displacements(task, ctx, outputs, rest), last + 1, shape[0]);
    if (!task->orientations) return d;
    hg_tensor *both[2] = { d, hg_reshape(ctx, turns(task, ctx, outputs), last + 1, shape[1]) };
    return hg_concat(ctx, last, 2, both);
}

hg_tensor *hg_hair_normalised(const hg_hair_task *task, hg_ctx *ctx, hg_tensor *raw, int64_t first, int64_t count)
{
    return hg_mul(ctx, hg_sub(ctx, raw, hg_slice(ctx, task->mean_tensor, 0, first, count)),
                  hg_slice(ctx, task->inverse_deviation, 0, first, count));
}

const char *hg_hair_displacements_are(const hg_hair_task *task)
{
    if (task->world)
        return "displacements [m] of vertices 1..V-1 along the axes of the world, xyz by vertex; "
               "x = p + R (rest - rest_root) + d, p and R the strand's root frame";
    return "displacements [m] of vertices 1..V-1 in head rest space, xyz by vertex; "
           "x = p + R (rest + d - rest_root), p and R the strand's root frame";
}

int hg_hair_formulas(const hg_hair_task *task, hg_hair_formula formulas[HG_HAIR_FORMULAS])
{
    memset(formulas, 0, HG_HAIR_FORMULAS * sizeof *formulas);
    return task->network->formulas(task, formulas);
}

int hg_hair_texture(const hg_hair_task *task, const int32_t **texel, const int32_t **strand)
{
    const hg_hair_style *style = &task->styles[task->current];
    *texel = style->texel;
    *strand = style->number;
    return style->texel ? (int)hg_config_integer(task->config, "model.texture") : 0;
}
