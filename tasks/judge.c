/* judge: energies of chosen strands, whoever placed them: a network, a solver, the posed groom. */
#include "tasks/judge.h"

#include "geometry/vector.h"

#include <math.h>
#include <string.h>

/* ---- energies of the config as they are now ---------------------------------------------------------------------- */

/* moves: an energy looks at the frames before. of_network: it is about what a network makes of several frames (pose_reg). */
static hg_status looks_back(const hg_term *term, bool *moves, bool *of_network)
{
    hg_energy_inputs inputs;
    HG_TRY(hg_energy_asks(term->energy, term->options, false, &inputs));
    *moves = *of_network = false;
    for (int i = 0; i < inputs.n; i++) {
        const char *name = inputs.input[i].name;
        *moves |= !strcmp(name, "predicted") || !strcmp(name, "previous");
        *of_network |= !strcmp(name, "deformation");
    }
    return HG_OK;
}

/* name: "ENERGY.PARAMETER" */
static void replace(const hg_term *term, double *params, const char *name, double value)
{
    const size_t length = strlen(term->energy->name);
    if (strncmp(name, term->energy->name, length) != 0 || name[length] != '.') return;
    for (int p = 0; p < HG_ENERGY_PARAMS && term->energy->params[p].name; p++)
        if (!strcmp(term->energy->params[p].name, name + length + 1)) params[p] = value;
}

hg_status hg_hair_terms_now(hg_hair_task *task, bool moving, double params[HG_HAIR_TERMS][HG_ENERGY_PARAMS],
                            hg_term term[HG_HAIR_TERMS], int column[HG_HAIR_TERMS], int *n)
{
    *n = 0;
    for (int t = 0; t < task->terms.n; t++) {
        bool moves, of_network;
        HG_TRY(looks_back(&task->terms.term[t], &moves, &of_network));
        if (of_network || (moves && !moving)) continue;
        const int k = (*n)++;
        column[k] = t;
        term[k] = task->terms.term[t];
        memcpy(params[k], task->terms.params[t], sizeof params[k]);
        term[k].params = params[k];
        for (int i = 0; i < task->n_materials; i++)
            replace(&term[k], params[k], task->materials[i].name, task->materials[i].value);
        for (int i = 0; i < task->n_learnt; i++)
            replace(&term[k], params[k], task->learnt[i].name,
                    task->learnt[i].start * exp(hg_tensor_item(task->learnt[i].theta, 0)));
    }
    return HG_OK;
}

hg_status hg_hair_is_dynamic(hg_hair_task *task, bool *dynamic)
{
    *dynamic = false;
    for (int t = 0; t < task->terms.n; t++) {
        bool moves, of_network;
        HG_TRY(looks_back(&task->terms.term[t], &moves, &of_network));
        *dynamic |= moves;
    }
    return HG_OK;
}

/* ---- the judge --------------------------------------------------------------------------------------------------- */

void hg_hair_judge_free(hg_hair_judge *j)
{
    hg_tensor *const tensors[] = {
        j->x, j->before, j->predicted, j->root_rotation, j->root_position, j->body_vertices, j->posed, j->q
    };
    for (size_t i = 0; i < sizeof tensors / sizeof *tensors; i++) hg_tensor_destroy(tensors[i]);
    for (int k = 0; k < 2; k++) hg_physics_destroy(j->physics[k]);
    hg_body_refit_destroy(j->refit);
    hg_hair_numbers_destroy(&j->numbers);
    hg_free(j->subset.strand);
    hg_free(j->subset.lengths);
    hg_free(j->subset.mass);
    hg_free(j->contact_point);
    hg_free(j->contact_normal);
    hg_free(j->triangle);
    hg_free(j->terms);
    hg_free(j->edges);
}

static hg_status make_inputs(hg_hair_judge *j)
{
    const int64_t S = j->S, V = j->V;
    if (j->task->asks.ghost && !(j->posed = hg_tensor_create(j->ctx, HG_F64, 4, (int64_t[]){ 1, S, V, 3 })))
        return HG_MEMORY;
    if (!j->task->asks.q) return HG_OK;
    j->q = hg_tensor_create(j->ctx, HG_F64, 4, (int64_t[]){ 1, S, V - 1, 4 });
    j->edges = hg_alloc((size_t)(S * (V - 1) * 4) + 1, sizeof *j->edges);
    if (!j->q || !j->edges) return HG_MEMORY;
    for (int64_t i = 0; i < S; i++)
        hg_hair_edge_frames(j->task->groom->points + (int64_t)j->subset.strand[i] * V * 3, V,
                            j->edges + i * (V - 1) * 4);
    return HG_OK;
}

static hg_status make(hg_hair_judge *j, const int32_t *strand)
{
    const int64_t S = j->S, V = j->V, N = j->task->body_vertices;
    j->subset = (hg_hair_subset){ .first = j->task->current, .grooms = 1, .n = S };
    j->subset.strand = hg_alloc((size_t)S, sizeof *j->subset.strand);
    j->subset.lengths = hg_alloc((size_t)(S * (V - 1)) + 1, sizeof(double));
    j->subset.mass = hg_alloc((size_t)S, sizeof(double));
    j->contact_point = hg_alloc((size_t)(S * V) * 3, sizeof(float));
    j->contact_normal = hg_alloc((size_t)(S * V) * 3, sizeof(float));
    j->triangle = hg_alloc((size_t)(S * V), sizeof(int32_t));
    j->terms = hg_alloc((size_t)S * HG_HAIR_TERMS, sizeof *j->terms);
    if (!j->ctx || !j->subset.strand || !j->subset.lengths || !j->subset.mass || !j->contact_point ||
        !j->contact_normal || !j->triangle || !j->terms)
        return HG_MEMORY;
    memcpy(j->subset.strand, strand, (size_t)S * sizeof *strand);
    for (int64_t i = 0; i < S * V; i++) j->triangle[i] = -1;
    HG_TRY(hg_hair_numbers_create(&j->numbers, &j->subset, j->task));
    for (int moving = 0; moving < 2; moving++) {
        double params[HG_HAIR_TERMS][HG_ENERGY_PARAMS];
        hg_term term[HG_HAIR_TERMS];
        HG_TRY(hg_hair_terms_now(j->task, moving, params, term, j->column[moving], &j->n_terms[moving]));
        if (j->n_terms[moving] == 0)
            return hg_fail(HG_INVALID, "the config has no energy that acts on hair at rest: there is no minimum to "
                                       "compare with");
        HG_TRY(hg_physics_create(&j->physics[moving], j->ctx, HG_F64, term, j->n_terms[moving], &j->numbers.data));
    }
    HG_TRY(hg_body_refit_create(&j->refit, j->task->tree, HG_F32));
    hg_tensor **const strands[] = { &j->x, &j->before, &j->predicted };
    for (size_t i = 0; i < sizeof strands / sizeof *strands; i++)
        if (!(*strands[i] = hg_tensor_create(j->ctx, HG_F64, 4, (int64_t[]){ 1, S, V, 3 }))) return HG_MEMORY;
    j->root_rotation = hg_tensor_create(j->ctx, HG_F64, 3, (int64_t[]){ 1, S, 4 });
    j->root_position = hg_tensor_create(j->ctx, HG_F64, 3, (int64_t[]){ 1, S, 3 });
    j->body_vertices = hg_tensor_create(j->ctx, HG_F64, 3, (int64_t[]){ 1, N, 3 });
    if (!j->root_rotation || !j->root_position || !j->body_vertices) return HG_MEMORY;
    return make_inputs(j);
}

hg_status hg_hair_judge_create(hg_hair_judge *judge, hg_hair_task *task, hg_ctx *ctx, const int32_t *strand, int64_t n)
{
    *judge = (hg_hair_judge){ .task = task, .ctx = hg_ctx_on_host(ctx), .S = n, .V = task->groom->vertices };
    return make(judge, strand);
}

static void widen(hg_tensor *to, const float *from)
{
    double *out = to->data;
    for (int64_t i = 0; i < hg_tensor_count(to); i++) out[i] = (double)from[i];
    hg_tensor_touch(to);
}

hg_status hg_hair_judge_frame(hg_hair_judge *j, const float *root_rotation, const float *root_position,
                              const float *posed, const float *collider)
{
    if (j->posed) widen(j->posed, posed);
    widen(j->root_rotation, root_rotation);
    widen(j->root_position, root_position);
    widen(j->body_vertices, collider);
    return hg_body_refit_update(j->ctx, j->refit, collider);
}

/* Rest frames, turned with the roots. */
static void pose_edges(hg_hair_judge *j)
{
    double *q = j->q->data;
    const double *root = j->root_rotation->data;
    for (int64_t i = 0; i < j->S * (j->V - 1); i++) {
        const float *rest = j->edges + 4 * i;
        const hg_quatd edge = hg_quatd_make((double)rest[0], (double)rest[1], (double)rest[2], (double)rest[3]);
        hg_quatd_store(q + 4 * i, hg_quatd_mul(hg_quatd_load(root + 4 * (i / (j->V - 1))), edge));
    }
    hg_tensor_touch(j->q);
}

hg_status hg_hair_judge_energies(hg_hair_judge *j, const float *x, const float *q, const float *before,
                                 const float *older, double energy[HG_HAIR_TERMS], double *per_strand)
{
    hg_frame_input inputs[2];
    const int moving = before != NULL;
    double terms[HG_HAIR_TERMS];
    hg_frame frame = { .root_rotation = j->root_rotation,
                       .root_position = j->root_position,
                       .body_vertices = j->body_vertices,
                       .dt = 1 / j->task->rate };
    hg_step_reset(j->ctx);
    widen(j->x, x);
    if (j->posed) inputs[frame.n_inputs++] = (hg_frame_input){ "ghost", j->posed };
    if (j->q) {
        if (q)
            widen(j->q, q);
        else
            pose_edges(j);
        inputs[frame.n_inputs++] = (hg_frame_input){ "q", j->q };
    }
    frame.inputs = inputs;
    if (moving) {
        double *predicted = j->predicted->data;
        widen(j->before, before);
        for (int64_t i = 0; i < hg_tensor_count(j->x); i++) predicted[i] = 2 * (double)before[i] - (double)older[i];
        hg_tensor_touch(j->predicted);
        frame.previous = j->before;
        frame.predicted = j->predicted;
    }
    hg_frame_input ghost = { "ghost", NULL };
    if (j->task->asks.ghost) {
        hg_tensor *rest = hg_tensor_from(j->ctx, HG_F64, 3, (int64_t[]){ j->S, j->V, 3 }, j->numbers.rest);
        ghost.value = hg_hair_posed(j->ctx, rest, j->root_rotation, j->root_position);
        if (!ghost.value) return hg_ctx_status(j->ctx);
        frame.inputs = &ghost, frame.n_inputs = 1;
    }
    HG_TRY(hg_physics_evaluate(j->physics[moving], j->ctx, &frame, j->x, terms, j->terms, NULL));
    const int n = j->n_terms[moving];
    for (int64_t k = 0; per_strand && k < 2 * j->S; k++) per_strand[k] = 0;
    for (int i = 0; i < n; i++) {
        const int column = j->column[moving][i];
        const double weight = j->task->terms.term[column].weight;
        energy[column] += weight * terms[i];
        for (int64_t k = 0; per_strand && k < j->S; k++) {
            const double value = weight * j->terms[k * n + i];
            per_strand[k] += value;
            if (!j->task->terms.term[column].energy->contact) per_strand[j->S + k] += value;
        }
    }
    return HG_OK;
}

hg_status hg_hair_judge_inside(hg_hair_judge *j, const float *x, int64_t *inside)
{
    return hg_hair_count_inside(j->ctx, j->refit, j->S, j->V, x, j->triangle, j->contact_point, j->contact_normal,
                                inside);
}
