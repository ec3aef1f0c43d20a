/* quaffure: one network for all strands of a groom (Stuyck et al. 2025): forward([B,inputs]) is an image of displacements
 * [B,outputs,texture,texture] over the scalp UV, three channels for each vertex of the strand that a texel holds.
 *
 * The input is the groom's code, the body's shape and its pose, and for the dynamic one the history of the joints: what
 * it means is the task's affair. The published sizes are 16 + 10 + 81 = 107 inputs, with 30 frames of 81 velocities
 * 2,537, and 64 x 64 texels of 72 channels; with a width of 1024, that is 8 x 8 x 1024 numbers after the first layer, and
 * a depth of 3, the dynamic one has 172,607,432 weights, 690 MB. The last layer starts at zero: no displacement. */
#include "models/image_decoder.h"

typedef struct {
    hg_model model;
    image_decoder decoder;
    hg_tensor **params;
} quaffure;

static void quaffure_destroy(void *self)
{
    quaffure *net = self;
    if (!net) return;
    image_decoder_destroy(&net->decoder);
    hg_free(net->params);
    hg_free(net);
}

static hg_tensor *quaffure_forward(void *self, hg_ctx *ctx, hg_tensor **in, int n)
{
    const quaffure *net = self;
    if (n != 1) {
        hg_ctx_fail(ctx, HG_INVALID, "quaffure: forward takes 1 input, the row of a frame, not %d", n);
        return NULL;
    }
    return image_decoder_forward(&net->decoder, ctx, in[0]);
}

static hg_status quaffure_create(hg_model **model, hg_ctx *ctx, const hg_model_spec *spec)
{
    HG_TRY(image_spec_check(spec, "quaffure"));
    quaffure *net = hg_alloc(1, sizeof *net);
    if (!net) return HG_MEMORY;
    net->params = hg_alloc(((size_t)spec->depth + 2) * IMAGE_PARAMS, sizeof(hg_tensor *));
    hg_status status =
        net->params ? image_decoder_create(&net->decoder, ctx, spec, spec->inputs, HG_INIT_ZERO, "") : HG_MEMORY;
    if (status != HG_OK) {
        quaffure_destroy(net);
        return status;
    }
    net->model = (hg_model){ .kind = "quaffure",
                             .params = net->params,
                             .n_params = image_decoder_params(&net->decoder, net->params),
                             .self = net,
                             .forward = quaffure_forward,
                             .destroy = quaffure_destroy };
    *model = &net->model;
    return HG_OK;
}

static const hg_architecture quaffure_architecture = {
    .name = "quaffure",
    .what = "one network for a groom, an image of displacements over the scalp (Stuyck et al. 2025)",
    .create = quaffure_create,
    .images = true
};
HG_REGISTER("model", quaffure, &quaffure_architecture);
