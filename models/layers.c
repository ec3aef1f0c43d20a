/* layers: a linear layer with its weights made from (seed, name), so that the same network is the same everywhere.
 * He initialisation: He et al. 2015, eq. 10, as a uniform distribution; Xavier: Glorot and Bengio 2010, eq. 16. */
#include "models/models.h"

#include <math.h>
#include <string.h>

hg_status hg_linear_layer_create(hg_linear_layer *layer, hg_ctx *ctx, int in, int out, hg_init init, uint64_t seed,
                                 const char *name)
{
    *layer = (hg_linear_layer){ 0 };
    float *values = NULL;
    char *weight_name = hg_format("%s.weight", name), *bias_name = hg_format("%s.bias", name);
    layer->weight = hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ in, out });
    layer->bias = hg_tensor_create(ctx, HG_F32, 1, (int64_t[]){ out });
    if (!weight_name || !bias_name || !layer->weight || !layer->bias) goto failed;
    layer->weight->name = weight_name;
    layer->bias->name = bias_name;
    weight_name = bias_name = NULL;
    if (init != HG_INIT_ZERO) {
        const int64_t count = (int64_t)in * out;
        const double bound = init == HG_INIT_HE ? sqrt(6.0 / in) : sqrt(6.0 / (in + out));
        const uint64_t stream = hg_hash(name, strlen(name), 0);
        values = hg_alloc((size_t)count, sizeof *values);
        if (!values) goto failed;
        for (int64_t i = 0; i < count; i++)
            values[i] = (float)(bound * (2 * hg_random_uniform(seed, stream, (uint64_t)i) - 1));
        if (hg_tensor_write(layer->weight, values) != HG_OK) goto failed;
    }
    if (hg_require_grad(layer->weight) != HG_OK || hg_require_grad(layer->bias) != HG_OK) goto failed;
    hg_free(values);
    return HG_OK;
failed:
    hg_free(values);
    hg_free(weight_name);
    hg_free(bias_name);
    hg_linear_layer_destroy(layer);
    return hg_fail(HG_MEMORY, "layer %s: no memory for %d x %d weights", name, in, out);
}

void hg_linear_layer_destroy(hg_linear_layer *layer)
{
    hg_tensor *parts[2] = { layer->weight, layer->bias };
    for (int i = 0; i < 2; i++) {
        if (!parts[i]) continue;
        char *name = (char *)(uintptr_t)parts[i]->name;
        hg_tensor_destroy(parts[i]);
        hg_free(name);
    }
    *layer = (hg_linear_layer){ 0 };
}

hg_tensor *hg_linear_layer_forward(const hg_linear_layer *layer, hg_ctx *ctx, hg_tensor *x, hg_activation activation)
{
    return hg_linear(ctx, x, layer->weight, layer->bias, activation);
}
