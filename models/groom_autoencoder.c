/* groom_autoencoder: a groom as a short code: convolutions that halve the image of its strands [B,inputs,texture,texture]
 * depth times and double its channels up to `width`, a linear layer to the code, and the way back. forward is the
 * reconstruction [B,outputs,texture,texture]; hg_encode the code [B,latent], which quaffure takes as its description of
 * the groom. An input may have more channels than the output, such as the mask of texels that hold a strand. */
#include "models/image_decoder.h"

typedef struct {
    hg_model model;
    hg_model_spec spec;
    hg_conv_layer *down; /* depth */
    hg_linear_layer code;
    image_decoder decoder;
    hg_tensor **params;
} autoencoder;

static void autoencoder_destroy(void *self)
{
    autoencoder *net = self;
    if (!net) return;
    for (int i = 0; net->down && i < net->spec.depth; i++) hg_conv_layer_destroy(&net->down[i]);
    hg_linear_layer_destroy(&net->code);
    image_decoder_destroy(&net->decoder);
    hg_free(net->down);
    hg_free(net->params);
    hg_free(net);
}

static hg_tensor *autoencoder_encode(void *self, hg_ctx *ctx, hg_tensor *x)
{
    const autoencoder *net = self;
    const hg_model_spec *spec = &net->spec;
    if (!x) return NULL;
    if (x->rank != 4 || x->shape[1] != spec->inputs || x->shape[2] != spec->texture || x->shape[3] != spec->texture) {
        char text[96];
        hg_ctx_fail(ctx, HG_INVALID, "groom_autoencoder: textures are [batch,%d,%d,%d], not %s", spec->inputs,
                    spec->texture, spec->texture, hg_shape_text(x, text));
        return NULL;
    }
    for (int i = 0; i < spec->depth; i++) x = hg_conv_layer_forward(&net->down[i], ctx, x, spec->activation);
    const int64_t numbers = net->code.weight->shape[0];
    return hg_linear_layer_forward(&net->code, ctx, hg_reshape(ctx, x, 2, (int64_t[]){ -1, numbers }), HG_IDENTITY);
}

static hg_tensor *autoencoder_forward(void *self, hg_ctx *ctx, hg_tensor **in, int n)
{
    const autoencoder *net = self;
    if (n != 1) {
        hg_ctx_fail(ctx, HG_INVALID, "groom_autoencoder: forward takes 1 input, not %d", n);
        return NULL;
    }
    return image_decoder_forward(&net->decoder, ctx, autoencoder_encode(self, ctx, in[0]));
}

static hg_status create_layers(autoencoder *net, hg_ctx *ctx)
{
    const hg_model_spec *spec = &net->spec;
    const int smallest = spec->texture >> spec->depth;
    for (int i = 0; i < spec->depth; i++) {
        char *name = hg_format("encoder.down%d", i);
        const int in = i == 0 ? spec->inputs : spec->width >> (spec->depth - i);
        hg_status status = name ? hg_conv_layer_create(&net->down[i], ctx, in, spec->width >> (spec->depth - 1 - i), 2,
                                                       spec->groups, hg_init_for(spec->activation), spec->seed, name)
                                : HG_MEMORY;
        hg_free(name);
        HG_TRY(status);
    }
    HG_TRY(hg_linear_layer_create(&net->code, ctx, smallest * smallest * spec->width, spec->latent, HG_INIT_XAVIER,
                                  spec->seed, "encoder.code"));
    return image_decoder_create(&net->decoder, ctx, spec, spec->latent, HG_INIT_XAVIER, "decoder.");
}

static hg_status autoencoder_create(hg_model **model, hg_ctx *ctx, const hg_model_spec *spec)
{
    if (spec->latent < 1)
        return hg_fail(HG_INVALID, "groom_autoencoder: a latent of %d numbers; it needs at least 1", spec->latent);
    HG_TRY(image_spec_check(spec, "groom_autoencoder"));
    autoencoder *net = hg_alloc(1, sizeof *net);
    if (!net) return HG_MEMORY;
    net->spec = *spec;
    net->down = hg_alloc((size_t)spec->depth, sizeof *net->down);
    net->params = hg_alloc((2 * (size_t)spec->depth + 3) * IMAGE_PARAMS, sizeof(hg_tensor *));
    hg_status status = net->down && net->params ? create_layers(net, ctx) : HG_MEMORY;
    if (status != HG_OK) {
        autoencoder_destroy(net);
        return status;
    }
    int n = 0;
    for (int i = 0; i < spec->depth; i++) n += image_conv_params(&net->down[i], net->params + n);
    n += image_linear_params(&net->code, net->params + n);
    n += image_decoder_params(&net->decoder, net->params + n);
    net->model = (hg_model){ .kind = "groom_autoencoder",
                             .params = net->params,
                             .n_params = n,
                             .self = net,
                             .forward = autoencoder_forward,
                             .encode = autoencoder_encode,
                             .destroy = autoencoder_destroy };
    *model = &net->model;
    return HG_OK;
}

static const hg_architecture autoencoder_architecture = { .name = "groom_autoencoder",
                                                          .what =
                                                              "a groom, as an image over the scalp, as a short code",
                                                          .create = autoencoder_create };
HG_REGISTER("model", groom_autoencoder, &autoencoder_architecture);
