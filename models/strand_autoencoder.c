/* strand_autoencoder: a strand's rest shape as a short code (Neuralocks, section on strand features): an encoder and a
 * decoder with `depth` hidden layers each, the code between them linear. forward([N,inputs]) is the reconstruction;
 * hg_encode the code, which a network per strand takes as its description of the strand. */
#include "models/models.h"

typedef struct {
    hg_model model;
    hg_model_spec spec;
    hg_linear_layer *layer; /* depth + 1 of the encoder, then depth + 1 of the decoder */
    hg_tensor **params;
    int layers;
} autoencoder;

static void autoencoder_destroy(void *self)
{
    autoencoder *net = self;
    if (!net) return;
    for (int i = 0; net->layer && i < net->layers; i++) hg_linear_layer_destroy(&net->layer[i]);
    hg_free(net->layer);
    hg_free(net->params);
    hg_free(net);
}

static hg_tensor *half(const autoencoder *net, hg_ctx *ctx, hg_tensor *h, int first)
{
    const int depth = net->spec.depth;
    for (int i = 0; i < depth; i++) h = hg_linear_layer_forward(&net->layer[first + i], ctx, h, net->spec.activation);
    return hg_linear_layer_forward(&net->layer[first + depth], ctx, h, HG_IDENTITY);
}

static hg_tensor *autoencoder_forward(void *self, hg_ctx *ctx, hg_tensor **in, int n)
{
    const autoencoder *net = self;
    if (n != 1) {
        hg_ctx_fail(ctx, HG_INVALID, "strand_autoencoder: forward takes 1 input, not %d", n);
        return NULL;
    }
    return half(net, ctx, half(net, ctx, in[0], 0), net->spec.depth + 1);
}

static hg_tensor *autoencoder_encode(void *self, hg_ctx *ctx, hg_tensor *strands)
{
    return half(self, ctx, strands, 0);
}

static hg_status autoencoder_create(hg_model **model, hg_ctx *ctx, const hg_model_spec *spec)
{
    if (spec->latent < 1)
        return hg_fail(HG_INVALID, "strand_autoencoder: a latent of %d numbers; it needs at least 1", spec->latent);
    autoencoder *net = hg_alloc(1, sizeof *net);
    if (!net) return HG_MEMORY;
    net->spec = *spec;
    const int half_layers = spec->depth + 1;
    net->layers = 2 * half_layers;
    net->layer = hg_alloc((size_t)net->layers, sizeof *net->layer);
    net->params = hg_alloc((size_t)net->layers * 2, sizeof(hg_tensor *));
    if (!net->layer || !net->params) {
        autoencoder_destroy(net);
        return HG_MEMORY;
    }
    for (int i = 0; i < net->layers; i++) {
        const bool encoder = i < half_layers, last = i % half_layers == spec->depth, first = i % half_layers == 0;
        const int in = !first ? spec->width : encoder ? spec->inputs : spec->latent;
        const int out = !last ? spec->width : encoder ? spec->latent : spec->outputs;
        char *name = hg_format("%s%d", encoder ? "encoder" : "decoder", i % half_layers);
        hg_status status = !name ? HG_MEMORY
                                 : hg_linear_layer_create(&net->layer[i], ctx, in, out,
                                                          last ? HG_INIT_XAVIER : HG_INIT_HE, spec->seed, name);
        hg_free(name);
        if (status != HG_OK) {
            autoencoder_destroy(net);
            return status;
        }
        net->params[2 * i] = net->layer[i].weight;
        net->params[2 * i + 1] = net->layer[i].bias;
    }
    net->model = (hg_model){ .kind = "strand_autoencoder",
                             .params = net->params,
                             .n_params = 2 * net->layers,
                             .self = net,
                             .forward = autoencoder_forward,
                             .encode = autoencoder_encode,
                             .destroy = autoencoder_destroy };
    *model = &net->model;
    return HG_OK;
}

static const hg_architecture autoencoder_architecture = { .name = "strand_autoencoder",
                                                          .what = "a strand's rest shape as a short code",
                                                          .create = autoencoder_create };
HG_REGISTER("model", strand_autoencoder, &autoencoder_architecture);
