/* layers: linear layers and convolutions with their weights made from (seed, name), so that the same network is the same
 * everywhere. He initialisation: He et al. 2015, eq. 10, as a uniform distribution; Xavier: Glorot and Bengio 2010, eq. 16. */
#include "models/models.h"

#include <math.h>
#include <string.h>

hg_init hg_init_for(hg_activation activation)
{
    switch (activation) {
    case HG_RELU:
    case HG_LEAKY_RELU:
    case HG_ELU:
    case HG_SILU:
    case HG_GELU:
        return HG_INIT_HE;
    default:
        return HG_INIT_XAVIER;
    }
}

/* ---- parameters --------------------------------------------------------------------------------------------- */

static hg_tensor *parameter(hg_ctx *ctx, const char *layer, const char *part, int rank, const int64_t *shape)
{
    char *name = hg_format("%s.%s", layer, part);
    hg_tensor *tensor = name ? hg_tensor_create(ctx, HG_F32, rank, shape) : NULL;
    if (!tensor) {
        hg_free(name);
        return NULL;
    }
    tensor->name = name;
    return tensor;
}

static void parameter_destroy(hg_tensor *tensor)
{
    if (!tensor) return;
    char *name = (char *)(uintptr_t)tensor->name;
    hg_tensor_destroy(tensor);
    hg_free(name);
}

/* in, out: what one number of the layer's output depends on, and how many depend on one of its inputs. */
static bool draw(hg_tensor *weight, int64_t in, int64_t out, hg_init init, uint64_t seed, const char *layer)
{
    if (init == HG_INIT_ZERO) return true;
    const int64_t count = hg_tensor_count(weight);
    const double bound = init == HG_INIT_HE ? sqrt(6.0 / (double)in) : sqrt(6.0 / (double)(in + out));
    const uint64_t stream = hg_hash(layer, strlen(layer), 0);
    float *values = hg_alloc((size_t)count, sizeof *values);
    if (!values) return false;
    for (int64_t i = 0; i < count; i++)
        values[i] = (float)(bound * (2 * hg_random_uniform(seed, stream, (uint64_t)i) - 1));
    const bool good = hg_tensor_write(weight, values) == HG_OK;
    hg_free(values);
    return good;
}

/* ---- linear ------------------------------------------------------------------------------------------------- */

hg_status hg_linear_layer_create(hg_linear_layer *layer, hg_ctx *ctx, int in, int out, hg_init init, uint64_t seed,
                                 const char *name)
{
    *layer = (hg_linear_layer){ 0 };
    layer->weight = parameter(ctx, name, "weight", 2, (int64_t[]){ in, out });
    layer->bias = parameter(ctx, name, "bias", 1, (int64_t[]){ out });
    if (layer->weight && layer->bias && draw(layer->weight, in, out, init, seed, name) &&
        hg_require_grad(layer->weight) == HG_OK && hg_require_grad(layer->bias) == HG_OK)
        return HG_OK;
    hg_linear_layer_destroy(layer);
    return hg_fail(HG_MEMORY, "layer %s: no memory for %d x %d weights", name, in, out);
}

void hg_linear_layer_destroy(hg_linear_layer *layer)
{
    parameter_destroy(layer->weight);
    parameter_destroy(layer->bias);
    *layer = (hg_linear_layer){ 0 };
}

hg_tensor *hg_linear_layer_forward(const hg_linear_layer *layer, hg_ctx *ctx, hg_tensor *x, hg_activation activation)
{
    return hg_linear(ctx, x, layer->weight, layer->bias, activation);
}

/* ---- convolution -------------------------------------------------------------------------------------------- */

enum { TAPS = 3 };

hg_status hg_conv_layer_create(hg_conv_layer *layer, hg_ctx *ctx, int in, int out, int stride, int groups, hg_init init,
                               uint64_t seed, const char *name)
{
    *layer = (hg_conv_layer){ .stride = stride, .groups = groups };
    layer->weight = parameter(ctx, name, "weight", 4, (int64_t[]){ out, in, TAPS, TAPS });
    layer->bias = parameter(ctx, name, "bias", 1, (int64_t[]){ out });
    bool good = layer->weight && layer->bias &&
                draw(layer->weight, (int64_t)in * TAPS * TAPS, (int64_t)out * TAPS * TAPS, init, seed, name) &&
                hg_require_grad(layer->weight) == HG_OK && hg_require_grad(layer->bias) == HG_OK;
    if (good && groups > 0) {
        layer->gain = parameter(ctx, name, "gain", 1, (int64_t[]){ out });
        good = layer->gain && hg_tensor_fill(layer->gain, 1) == HG_OK && hg_require_grad(layer->gain) == HG_OK;
    }
    if (good) return HG_OK;
    hg_conv_layer_destroy(layer);
    return hg_fail(HG_MEMORY, "layer %s: no memory for %d x %d x %d x %d weights", name, out, in, (int)TAPS, (int)TAPS);
}

void hg_conv_layer_destroy(hg_conv_layer *layer)
{
    parameter_destroy(layer->weight);
    parameter_destroy(layer->bias);
    parameter_destroy(layer->gain);
    *layer = (hg_conv_layer){ 0 };
}

hg_tensor *hg_conv_layer_forward(const hg_conv_layer *layer, hg_ctx *ctx, hg_tensor *x, hg_activation activation)
{
    hg_tensor *y = hg_conv2d(ctx, x, layer->weight, layer->gain ? NULL : layer->bias, layer->stride, 1);
    if (layer->gain) y = hg_group_norm(ctx, y, layer->gain, layer->bias, layer->groups, 1e-5);
    return activation == HG_IDENTITY ? y : hg_activate(ctx, y, activation);
}
