/* image_decoder: numbers to an image, as image_decoder.h has it. Between two sizes the image is interpolated, so that
 * neighbouring texels, which are neighbouring strands, begin alike. */
#include "models/image_decoder.h"

enum { DEEPEST = 12 };

hg_status image_spec_check(const hg_model_spec *spec, const char *what)
{
    const int depth = spec->depth;
    if (spec->texture < 1)
        return hg_fail(HG_INVALID,
                       "%s: it makes images, and their size (texture) is not given; a task of single strands needs a "
                       "network per strand, such as neuralocks",
                       what);
    if (depth > DEEPEST || spec->texture % (1 << depth) || spec->width % (1 << depth))
        return hg_fail(HG_INVALID,
                       "%s: textures of %d texels a side and %d channels cannot be halved %d times: both have to be "
                       "multiples of 2^depth, with a depth of at most %d",
                       what, spec->texture, spec->width, depth, (int)DEEPEST);
    const int64_t smallest = spec->texture >> depth;
    if (smallest * smallest * spec->width > INT32_MAX)
        return hg_fail(HG_INVALID,
                       "%s: the smallest image, %lld x %lld texels of %d channels, has more than 2^31 numbers; a depth "
                       "above %d makes it smaller",
                       what, (long long)smallest, (long long)smallest, spec->width, depth);
    const int fewest = spec->width >> depth;
    if (spec->groups < 0 || (spec->groups > 0 && fewest % spec->groups))
        return hg_fail(HG_INVALID, "%s: %d groups do not divide the %d channels of the largest image", what,
                       spec->groups, fewest);
    return HG_OK;
}

static hg_status create_layers(image_decoder *decoder, hg_ctx *ctx, const hg_model_spec *spec, int inputs, hg_init last,
                               const char *prefix)
{
    const hg_init init = hg_init_for(spec->activation);
    char *name = hg_format("%sfirst", prefix);
    const int numbers = decoder->smallest * decoder->smallest * spec->width;
    hg_status status =
        name ? hg_linear_layer_create(&decoder->first, ctx, inputs, numbers, init, spec->seed, name) : HG_MEMORY;
    hg_free(name);
    for (int i = 0; status == HG_OK && i <= spec->depth; i++) {
        const bool end = i == spec->depth;
        name = end ? hg_format("%slast", prefix) : hg_format("%sup%d", prefix, i);
        status = name ? hg_conv_layer_create(&decoder->layer[i], ctx, spec->width >> i,
                                             end ? spec->outputs : spec->width >> (i + 1), 1, end ? 0 : spec->groups,
                                             end ? last : init, spec->seed, name)
                      : HG_MEMORY;
        hg_free(name);
    }
    return status;
}

hg_status image_decoder_create(image_decoder *decoder, hg_ctx *ctx, const hg_model_spec *spec, int inputs, hg_init last,
                               const char *prefix)
{
    *decoder = (image_decoder){ .smallest = spec->texture >> spec->depth,
                                .width = spec->width,
                                .depth = spec->depth,
                                .activation = spec->activation };
    decoder->layer = hg_alloc((size_t)spec->depth + 1, sizeof *decoder->layer);
    return decoder->layer ? create_layers(decoder, ctx, spec, inputs, last, prefix) : HG_MEMORY;
}

void image_decoder_destroy(image_decoder *decoder)
{
    hg_linear_layer_destroy(&decoder->first);
    for (int i = 0; decoder->layer && i <= decoder->depth; i++) hg_conv_layer_destroy(&decoder->layer[i]);
    hg_free(decoder->layer);
    *decoder = (image_decoder){ 0 };
}

hg_tensor *image_decoder_forward(const image_decoder *decoder, hg_ctx *ctx, hg_tensor *x)
{
    const int64_t smallest = decoder->smallest;
    hg_tensor *h = hg_linear_layer_forward(&decoder->first, ctx, x, decoder->activation);
    h = hg_reshape(ctx, h, 4, (int64_t[]){ -1, decoder->width, smallest, smallest });
    for (int i = 0; i < decoder->depth; i++)
        h = hg_conv_layer_forward(&decoder->layer[i], ctx, hg_upsample(ctx, h, HG_BILINEAR), decoder->activation);
    return hg_conv_layer_forward(&decoder->layer[decoder->depth], ctx, h, HG_IDENTITY);
}

/* ---- parameters --------------------------------------------------------------------------------------------- */

int image_linear_params(const hg_linear_layer *layer, hg_tensor **params)
{
    params[0] = layer->weight, params[1] = layer->bias;
    return 2;
}

int image_conv_params(const hg_conv_layer *layer, hg_tensor **params)
{
    params[0] = layer->weight, params[1] = layer->bias;
    if (layer->gain) params[2] = layer->gain;
    return layer->gain ? 3 : 2;
}

int image_decoder_params(const image_decoder *decoder, hg_tensor **params)
{
    int n = image_linear_params(&decoder->first, params);
    for (int i = 0; i <= decoder->depth; i++) n += image_conv_params(&decoder->layer[i], params + n);
    return n;
}
