/* What the passes over pairs and over fields share on another device than the host: all frames of the batch are one launch,
 * every vertex leaves its numbers in f64, and these are summed in a fixed order. */
#include "hairloss/physics_pass.h"

#include "hairloss/physics_pass.kernel.h"

#include <string.h>

enum { SUM_CHUNK = 4096 };

int hg_pass_kernel(hg_pass *pass, const char *name, size_t args_size)
{
    pass->kernels[pass->n_kernels] = (hg_kernel){ .name = name, .cuda = pass->text.data, .args_size = args_size };
    return pass->n_kernels++;
}

void hg_pass_lanes_fill(hg_pass_lanes *lanes, const hg_pass *pass, const hg_pass_inputs *inputs)
{
    memset(lanes, 0, sizeof *lanes);
    for (int i = 0; i < inputs->n; i++) {
        lanes->side[i] = inputs->side[i];
        if (inputs->source[i] < 0) continue;
        const hg_pass_source *source = &pass->source[inputs->source[i]];
        lanes->values[i] = source->values;
        lanes->uniform[i] = source->uniform;
        lanes->shape[i] = source->shape;
    }
}

/* The sum of n numbers: set at `to`, or added to `gradient`. */
static hg_status sum_all(const hg_pass *pass, hg_ctx *ctx, int64_t n, const double *from, double *to, void *gradient,
                         double scale)
{
    const int64_t chunks = (n + SUM_CHUNK - 1) / SUM_CHUNK;
    double *sums = hg_step_device(ctx, (size_t)chunks * sizeof(double) + 1);
    if (!sums) return HG_MEMORY;
    const sum_args first = { .from = from, .n = n, .chunk = SUM_CHUNK, .to = sums, .scale = 1 };
    const sum_args second = {
        .from = sums, .n = chunks, .chunk = chunks, .to = to, .gradient = gradient, .scale = scale, .dtype = pass->dtype
    };
    HG_TRY(hg_launch(ctx, &sum_chunks_kernel, chunks, &first));
    return hg_launch(ctx, &sum_chunks_kernel, 1, &second);
}

static hg_status sum_strands(const hg_pass *pass, hg_ctx *ctx, int64_t frames, const double *from, double *also,
                             int64_t stride, double **sums)
{
    const int64_t strands = frames * pass->strands;
    *sums = hg_step_device(ctx, (size_t)strands * sizeof(double) + 1);
    if (!*sums) return HG_MEMORY;
    const strand_sums_args args = {
        .from = from, .vertices = pass->vertices, .sums = *sums, .also = also, .stride = stride
    };
    return hg_launch(ctx, &strand_sums_kernel, strands, &args);
}

hg_status hg_pass_energies(const hg_pass *pass, hg_ctx *ctx, const hg_pass_call *call, const double *energies)
{
    const int64_t frames = call->x->shape[0];
    double *sums;
    HG_TRY(sum_strands(pass, ctx, frames, energies, call->per_strand, call->stride, &sums));
    return sum_all(pass, ctx, frames * pass->strands, sums, call->unweighted, NULL, 1);
}

hg_status hg_pass_add_grooms(const hg_pass *pass, hg_ctx *ctx, const hg_pass_batch *batch, void *to, double scale,
                             const double *slopes, int width)
{
    const groom_sums_args args = { .from = slopes,
                                   .frames = batch->frames,
                                   .width = pass->strands * pass->vertices * width,
                                   .groom = batch->groom,
                                   .grooms = batch->grooms,
                                   .to = to,
                                   .scale = scale };
    return hg_launch(ctx, groom_sums_kernels[pass->dtype == HG_F64], pass->grooms * args.width, &args);
}

hg_status hg_pass_add(const hg_pass *pass, hg_ctx *ctx, const hg_pass_batch *batch, int source, double scale,
                      const double *slopes, int width)
{
    const hg_pass_source *to = &pass->source[source];
    const int64_t strands = batch->frames * pass->strands;
    double *sums;
    if (to->shape == HG_PASS_GROOM) return hg_pass_add_grooms(pass, ctx, batch, to->gradient, scale, slopes, width);
    HG_TRY(sum_strands(pass, ctx, batch->frames, slopes, NULL, 0, &sums));
    if (to->shape == HG_PASS_UNIFORM) return sum_all(pass, ctx, strands, sums, NULL, to->gradient, scale);
    const groom_sums_args args = { .from = sums, .to = to->gradient, .scale = scale };
    return hg_launch(ctx, strand_adds_kernels[pass->dtype == HG_F64], strands, &args);
}
