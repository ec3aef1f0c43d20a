/* my_model: what it is for, in one sentence.
 *
 * A network per strand: features of the strand and of the frame in, displacements of its vertices out. Replace it by your
 * own; here hidden layers that add to what they are given, h + act(W h + b).
 *
 * Build it and train it:
 *
 *     cc -shared -fPIC $(hairgrad flags) my_model.c -o my_model.so
 *     hairgrad --plugin my_model.so train RECIPE.yaml -o RUN --set model.kind=my_model
 *     hairgrad --plugin my_model.so evaluate RUN
 *
 * The first layer of [strand | frame] is a sum of two parts, so that a batch of B frames of S strands takes S + B rows
 * instead of S B. forward is asked with 1 input [N,inputs], or with 3: nothing, the frame's [B,frame inputs], and what
 * strand_part made of the strands [S,width]. */
#include "models/models.h"

typedef struct {
    hg_model model;
    hg_model_spec spec;
    hg_linear_layer *layer; /* first, hidden .., last: depth + 1 */
    hg_tensor **params;     /* what training changes and a checkpoint holds */
} my_model;

static void my_model_destroy(void *self)
{
    my_model *net = self;
    if (!net) return;
    for (int i = 0; net->layer && i <= net->spec.depth; i++) hg_linear_layer_destroy(&net->layer[i]);
    hg_free(net->layer);
    hg_free(net->params);
    hg_free(net);
}

static hg_tensor *my_model_strand_part(void *self, hg_ctx *ctx, hg_tensor *strand)
{
    my_model *net = self;
    hg_tensor *weight = hg_slice(ctx, net->layer[0].weight, 0, 0, net->spec.strand_inputs);
    return hg_linear(ctx, strand, weight, NULL, HG_IDENTITY);
}

static hg_tensor *my_model_forward(void *self, hg_ctx *ctx, hg_tensor **in, int n)
{
    my_model *net = self;
    const hg_model_spec *spec = &net->spec;
    hg_tensor *h;
    if (n == 1) {
        h = hg_linear_layer_forward(&net->layer[0], ctx, in[0], spec->activation);
    } else {
        hg_tensor *strands = n == 3 ? in[2] : my_model_strand_part(self, ctx, in[0]);
        const int64_t first = spec->strand_inputs, count = spec->inputs - first;
        hg_tensor *frames = hg_linear(ctx, in[1], hg_slice(ctx, net->layer[0].weight, 0, first, count),
                                      net->layer[0].bias, HG_IDENTITY);
        h = hg_linear_pair(ctx, strands, frames, spec->activation); /* [B,S,width] */
    }
    for (int i = 1; i < spec->depth; i++)
        h = hg_add(ctx, h, hg_linear_layer_forward(&net->layer[i], ctx, h, spec->activation));
    return hg_linear_layer_forward(&net->layer[spec->depth], ctx, h, HG_IDENTITY);
}

static hg_status my_model_create(hg_model **model, hg_ctx *ctx, const hg_model_spec *spec)
{
    my_model *net = hg_alloc(1, sizeof *net);
    if (!net) return HG_MEMORY;
    net->spec = *spec;
    net->layer = hg_alloc((size_t)spec->depth + 1, sizeof *net->layer);
    net->params = hg_alloc(2 * (size_t)spec->depth + 2, sizeof(hg_tensor *));
    hg_status status = net->layer && net->params ? HG_OK : HG_MEMORY;
    for (int i = 0; status == HG_OK && i <= spec->depth; i++) {
        const int from = i == 0 ? spec->inputs : spec->width, to = i == spec->depth ? spec->outputs : spec->width;
        char *name = hg_format("layer%d", i); /* "layer0.weight", "layer0.bias" in checkpoints */
        /* the last one starts at zero: training begins at the rigidly posed groom */
        if (!name) status = HG_MEMORY;
        if (status == HG_OK)
            status = hg_linear_layer_create(&net->layer[i], ctx, from, to, i == spec->depth ? HG_INIT_ZERO : HG_INIT_HE,
                                            spec->seed, name);
        hg_free(name);
        net->params[2 * i] = net->layer[i].weight;
        net->params[2 * i + 1] = net->layer[i].bias;
    }
    if (status != HG_OK) {
        my_model_destroy(net);
        return status;
    }
    net->model = (hg_model){ .kind = "my_model",
                             .params = net->params,
                             .n_params = 2 * spec->depth + 2,
                             .self = net,
                             .forward = my_model_forward,
                             .strand_part = my_model_strand_part,
                             .destroy = my_model_destroy };
    *model = &net->model;
    return HG_OK;
}

static const hg_architecture architecture = { .name = "my_model",
                                              .what = "a network per strand whose hidden layers add to their input",
                                              .create = my_model_create };
HG_REGISTER("model", my_model, &architecture);
