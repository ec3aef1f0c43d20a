/* Pairs on another device than the host: the lists of all grooms are copied there once, and all frames of a batch are one
 * launch, a thread for each vertex. Nobody writes where another does, and the order of sums is that of the lists. */
#include "hairloss/physics_pairs.h"

#include "hairloss/physics_pairs.inc"

#include <string.h>

_Static_assert(sizeof(pairs_args) < 4088, "the arguments of a kernel are at most 4 KB");

hg_status hg_pairs_device_make(pairs_pass *pass)
{
    hg_pass *base = &pass->pass;
    hg_text *text = &base->text;
    int outputs = 0;
    for (int i = 0; i < pass->inputs.n; i++)
        if (pass->slope_of[i] > outputs) outputs = pass->slope_of[i];
    hg_text_add(text, "#define REAL %s\n#include \"autograd/trace/scalar_cuda.h\"\n",
                base->dtype == HG_F64 ? "double" : "float");
    hg_function_print_cuda(pass->function, "pair_value", text);
    hg_function_print_cuda(pass->full, "pair_full", text);
    hg_text_add(text,
                "#define INPUTS %d\n#define OUTPUTS %d\n#define INPUT_DISTANCE %d\n#define INPUT_REST_DISTANCE %d\n"
                "#define OUTPUT_REST_DISTANCE %d\n",
                pass->inputs.n, outputs, pass->distance, pass->rest_distance, pass->slope_of[pass->rest_distance]);
    hg_text_add(text, "#define PAIR_SLOPE(out, k) (");
    for (int i = 0; i < pass->inputs.n; i++)
        if (pass->slope_of[i] >= 0) hg_text_add(text, "k == %d ? out[%d] : ", i, pass->slope_of[i]);
    hg_text_add(text, "(REAL)0)\n#include \"hairloss/physics_pairs.inc\"\n");
    if (text->failed) return HG_MEMORY;
    pass->on_device.energy = hg_pass_kernel(base, "pairs_energy", sizeof(pairs_args));
    pass->on_device.energy_full = hg_pass_kernel(base, "pairs_energy_full", sizeof(pairs_args));
    return HG_OK;
}

/* ---- the lists ------------------------------------------------------------------------------------------------ */

void hg_pairs_device_free(pairs_pass *pass)
{
    hg_tensor *tensors[] = { pass->on_device.first, pass->on_device.pairs, pass->on_device.start,
                             pass->on_device.incident, pass->on_device.rest_distances };
    for (size_t i = 0; i < sizeof tensors / sizeof *tensors; i++) hg_tensor_destroy(tensors[i]);
    pass->on_device.first = pass->on_device.pairs = pass->on_device.start = NULL;
    pass->on_device.incident = pass->on_device.rest_distances = NULL;
}

/* A tensor of n numbers that all grooms have one after another; with parts[g] == NULL the part is empty. 64-bit numbers are
 * kept in f64 tensors, which are as long. */
static hg_status upload(const pairs_pass *pass, hg_tensor **to, hg_dtype dtype, const void *const *parts,
                        const int64_t *counts)
{
    int64_t n = 0;
    const size_t size = hg_dtype_size(dtype);
    for (int64_t g = 0; g < pass->pass.grooms; g++) n += counts[g];
    char *all = hg_alloc((size_t)n + 1, size), *at = all;
    if (!all) return HG_MEMORY;
    for (int64_t g = 0; g < pass->pass.grooms; at += (size_t)counts[g++] * size)
        if (counts[g]) memcpy(at, parts[g], (size_t)counts[g] * size);
    *to = hg_tensor_create(pass->pass.ctx, dtype, 1, &n);
    const hg_status status = *to ? hg_tensor_write(*to, all) : HG_MEMORY;
    hg_free(all);
    return status;
}

static hg_status upload_lists(pairs_pass *pass, const void **parts, int64_t *counts, int64_t *first)
{
    const int64_t G = pass->pass.grooms, n = pass->pass.strands * pass->pass.vertices;
    for (int64_t g = 0, at = 0; g < G; at += pass->pairs[g++]->n_pairs) first[g] = at;
    for (int64_t g = 0; g < G; g++) parts[g] = &first[g], counts[g] = 1;
    HG_TRY(upload(pass, &pass->on_device.first, HG_F64, parts, counts));
    for (int64_t g = 0; g < G; g++) parts[g] = pass->pairs[g]->start, counts[g] = n + 1;
    HG_TRY(upload(pass, &pass->on_device.start, HG_F64, parts, counts));
    for (int64_t g = 0; g < G; g++) parts[g] = pass->pairs[g]->pairs, counts[g] = 2 * pass->pairs[g]->n_pairs;
    HG_TRY(upload(pass, &pass->on_device.pairs, HG_I32, parts, counts));
    for (int64_t g = 0; g < G; g++) parts[g] = pass->pairs[g]->incident;
    HG_TRY(upload(pass, &pass->on_device.incident, HG_I32, parts, counts));
    for (int64_t g = 0; g < G; g++) parts[g] = pass->rest_distances[g], counts[g] = pass->pairs[g]->n_pairs;
    return upload(pass, &pass->on_device.rest_distances, pass->pass.dtype, parts, counts);
}

hg_status hg_pairs_device_lists(pairs_pass *pass)
{
    const size_t G = (size_t)pass->pass.grooms;
    const void **parts = hg_alloc(G, sizeof *parts);
    int64_t *counts = hg_alloc(G, sizeof *counts), *first = hg_alloc(G, sizeof *first);
    const hg_status status = parts && counts && first ? upload_lists(pass, parts, counts, first) : HG_MEMORY;
    hg_free(parts);
    hg_free(counts);
    hg_free(first);
    return status;
}

/* ---- a call --------------------------------------------------------------------------------------------------- */

static hg_status run(const pairs_pass *pass, hg_ctx *ctx, const hg_pass_call *call)
{
    const hg_pass *base = &pass->pass;
    const hg_pass_source *rest = &base->source[HG_PASS_REST];
    const hg_pass_batch batch = { .frames = call->x->shape[0], .groom = call->groom };
    const int64_t vertices = batch.frames * base->strands * base->vertices;
    const size_t doubles = (size_t)vertices * sizeof(double) + 1;
    pairs_args args = { .strands = base->strands,
                        .vertices = base->vertices,
                        .groom = call->groom,
                        .first = pass->on_device.first->data,
                        .pairs = pass->on_device.pairs->data,
                        .start = pass->on_device.start->data,
                        .incident = pass->on_device.incident->data,
                        .rest_distances = pass->on_device.rest_distances->data,
                        .rest = rest->given ? rest->values : NULL,
                        .x = call->x->data,
                        .gradient = call->gradient,
                        .energy = hg_step_device(ctx, doubles),
                        .weight = base->term.weight };
    if (!args.energy) return HG_MEMORY;
    hg_pass_lanes_fill(&args.lanes, base, &pass->inputs);
    for (int i = 0; i < pass->inputs.n && base->wants; i++) {
        if (!hg_pairs_wanted(pass, i)) continue;
        double *slopes = hg_step_device(ctx, i == pass->rest_distance ? 3 * doubles : doubles);
        if (!slopes) return HG_MEMORY;
        if (i == pass->rest_distance)
            args.rest_slopes = slopes;
        else
            args.lanes.slopes[i] = slopes;
    }
    const int kernel = base->wants ? pass->on_device.energy_full : pass->on_device.energy;
    HG_TRY(hg_launch(ctx, &base->kernels[kernel], vertices, &args));
    HG_TRY(hg_pass_energies(base, ctx, call, args.energy));
    if (args.rest_slopes) HG_TRY(hg_pass_add(base, ctx, &batch, HG_PASS_REST, args.weight, args.rest_slopes, 3));
    for (int i = 0; i < pass->inputs.n; i++)
        if (args.lanes.slopes[i])
            HG_TRY(hg_pass_add(base, ctx, &batch, pass->inputs.source[i], args.weight, args.lanes.slopes[i], 1));
    return HG_OK;
}

hg_status hg_pairs_device_run(pairs_pass *pass, hg_ctx *ctx, const hg_pass_call *call)
{
    const hg_step_mark mark = hg_step_set_mark(ctx);
    const hg_status status = run(pass, ctx, call);
    hg_step_rewind(ctx, mark);
    return status;
}
