/* fit_hair: what the hair of a scene is made of, from frames in which it was seen: the scene's energies, masses and body with
 * hg_fit_material. A frame that comes with those before it is balanced with its inertia. */
#include "tasks/hair.h"

#include <string.h>

typedef struct {
    hg_hair_subset subset;
    hg_hair_numbers numbers;
    hg_tensor *x, *rotation, *position, *predicted, *previous, *body; /* f64 [B,..] */
} observed;

static void observed_free(observed *o)
{
    hg_tensor *const tensors[] = { o->x, o->rotation, o->position, o->predicted, o->previous, o->body };
    for (int i = 0; i < 6; i++) hg_tensor_destroy(tensors[i]);
    hg_hair_numbers_destroy(&o->numbers);
    hg_free(o->subset.strand);
    hg_free(o->subset.lengths);
    hg_free(o->subset.mass);
}

static void widen(hg_tensor *to, int64_t frame, int64_t count, const float *from)
{
    double *out = (double *)to->data + frame * count;
    for (int64_t i = 0; i < count; i++) out[i] = (double)from[i];
    hg_tensor_touch(to);
}

static hg_status take_strands(observed *o, hg_hair_task *task, const int32_t *strand, int64_t strands)
{
    const hg_groom *groom = task->groom;
    o->subset = (hg_hair_subset){ .first = task->current, .grooms = 1, .n = strands };
    o->subset.strand = hg_alloc((size_t)strands, sizeof *o->subset.strand);
    o->subset.lengths = hg_alloc((size_t)(strands * (groom->vertices - 1)), sizeof(double));
    o->subset.mass = hg_alloc((size_t)strands, sizeof(double));
    if (!o->subset.strand || !o->subset.lengths || !o->subset.mass) return HG_MEMORY;
    for (int64_t s = 0; s < strands; s++) {
        o->subset.strand[s] = strand ? strand[s] : (int32_t)s;
        if (o->subset.strand[s] < 0 || o->subset.strand[s] >= groom->strands)
            return hg_fail(HG_INVALID, "fit: strand %d of a groom of %lld", (int)o->subset.strand[s],
                           (long long)groom->strands);
    }
    return hg_hair_numbers_create(&o->numbers, &o->subset, task);
}

static hg_status take_frames(observed *o, hg_hair_task *task, hg_ctx *ctx, int n, const hg_observed_frame *frames)
{
    const int64_t S = o->subset.n, V = task->groom->vertices, N = task->body_vertices, count = S * V * 3;
    const int64_t shape[4] = { n, S, V, 3 };
    o->x = hg_tensor_create(ctx, HG_F64, 4, shape);
    o->predicted = hg_tensor_create(ctx, HG_F64, 4, shape);
    o->previous = hg_tensor_create(ctx, HG_F64, 4, shape);
    o->rotation = hg_tensor_create(ctx, HG_F64, 3, (int64_t[]){ n, S, 4 });
    o->position = hg_tensor_create(ctx, HG_F64, 3, (int64_t[]){ n, S, 3 });
    if (!o->x || !o->predicted || !o->previous || !o->rotation || !o->position) return HG_MEMORY;
    if (frames[0].body_vertices) {
        o->body = hg_tensor_create(ctx, HG_F64, 3, (int64_t[]){ n, N, 3 });
        if (!o->body) return HG_MEMORY;
    }
    const int32_t *vertex = hg_poser_vertex(task->poser); /* those that the collider keeps */
    for (int b = 0; b < n; b++) {
        const hg_observed_frame *f = &frames[b];
        const float *before = f->before ? f->before : f->x, *older = f->older ? f->older : before;
        widen(o->x, b, count, f->x);
        widen(o->previous, b, count, before);
        widen(o->rotation, b, S * 4, f->root_rotation);
        widen(o->position, b, S * 3, f->root_position);
        double *predicted = (double *)o->predicted->data + b * count;
        for (int64_t i = 0; i < count; i++) predicted[i] = 2 * (double)before[i] - (double)older[i];
        if (!o->body) continue;
        if (!f->body_vertices) return hg_fail(HG_INVALID, "fit: frame %d has no body, others have", b);
        double *body = (double *)o->body->data + b * N * 3;
        for (int64_t i = 0; i < N; i++)
            for (int c = 0; c < 3; c++) body[3 * i + c] = (double)f->body_vertices[3 * vertex[i] + c];
    }
    hg_tensor_touch(o->predicted);
    return HG_OK;
}

hg_status hg_hair_fit_material(hg_hair_task *task, hg_ctx *ctx, const int32_t *strand, int64_t strands, int n,
                               const hg_observed_frame *frames, const hg_material_options *options,
                               hg_material_fit *fit)
{
    *fit = (hg_material_fit){ 0 };
    if (n < 1 || strands < 1) return hg_fail(HG_INVALID, "fit: %d frames of %lld strands", n, (long long)strands);
    observed o = { 0 };
    if (!(ctx = hg_ctx_on_host(ctx))) return HG_MEMORY; /* the balances are solved there */
    hg_step_reset(ctx);
    hg_status status = take_strands(&o, task, strand, strands);
    if (status == HG_OK) status = take_frames(&o, task, ctx, n, frames);
    if (status == HG_OK) {
        hg_term terms[HG_HAIR_TERMS];
        int kept = 0;
        for (int i = 0; i < task->terms.n; i++) /* without a body nothing is known of contact */
            if (o.body || !task->terms.term[i].energy->contact) terms[kept++] = task->terms.term[i];
        if (!o.body) o.numbers.data.body = NULL;
        const hg_frame frame = { .root_rotation = o.rotation,
                                 .root_position = o.position,
                                 .predicted = o.predicted,
                                 .previous = o.previous,
                                 .body_vertices = o.body,
                                 .dt = 1 / task->rate };
        status = hg_fit_material(ctx, terms, kept, &o.numbers.data, &frame, o.x, options, fit);
    }
    hg_step_reset(ctx);
    observed_free(&o);
    return status;
}
