/* neuralocks: a small network per strand (Lin et al. 2025): hidden layers of one width, displacements out.
 *
 * The input is [what belongs to the strand | what belongs to the frame]. The first layer is a sum of the two parts,
 *     W [s; f] + b = W_s s + (W_f f + b),
 * so with S strands and B frames it takes S + B rows instead of S B: that is the factored form, forward with
 * { strand [S,strand_inputs], frame [B,frame_inputs] }. With one input [N,inputs] it is the plain network (what is
 * exported). Both use the same weights and agree to rounding. The last layer starts at zero: no displacement. */
#include "models/models.h"

typedef struct {
    hg_model model;
    hg_model_spec spec;
    hg_linear_layer *layer; /* first, hidden.., last: depth + 1 */
    hg_tensor **params;
    int layers;
} neuralocks;

static void neuralocks_destroy(void *self)
{
    neuralocks *net = self;
    if (!net) return;
    for (int i = 0; net->layer && i < net->layers; i++) hg_linear_layer_destroy(&net->layer[i]);
    hg_free(net->layer);
    hg_free(net->params);
    hg_free(net);
}

static hg_tensor *strand_part(void *self, hg_ctx *ctx, hg_tensor *strand)
{
    neuralocks *net = self;
    hg_tensor *weight = hg_slice(ctx, net->layer[0].weight, 0, 0, net->spec.strand_inputs);
    return hg_linear(ctx, strand, weight, NULL, HG_IDENTITY);
}

static hg_tensor *frame_part(neuralocks *net, hg_ctx *ctx, hg_tensor *frame)
{
    const int strand_inputs = net->spec.strand_inputs;
    hg_tensor *weight = hg_slice(ctx, net->layer[0].weight, 0, strand_inputs, net->spec.inputs - strand_inputs);
    return hg_linear(ctx, frame, weight, net->layer[0].bias, HG_IDENTITY);
}

static hg_tensor *neuralocks_forward(void *self, hg_ctx *ctx, hg_tensor **in, int n)
{
    neuralocks *net = self;
    const hg_model_spec *spec = &net->spec;
    hg_tensor *h;
    if (n == 1) {
        h = hg_linear_layer_forward(&net->layer[0], ctx, in[0], spec->activation);
    } else if (n == 2 || n == 3) {
        if (spec->strand_inputs < 1 || spec->strand_inputs >= spec->inputs) {
            hg_ctx_fail(ctx, HG_INVALID,
                        "neuralocks: %d of %d inputs belong to the strand; the factored form needs both parts",
                        spec->strand_inputs, spec->inputs);
            return NULL;
        }
        hg_tensor *rows = n == 3 ? in[2] : strand_part(self, ctx, in[0]);
        h = hg_linear_pair(ctx, rows, frame_part(net, ctx, in[1]), spec->activation);
    } else {
        hg_ctx_fail(ctx, HG_INVALID, "neuralocks: forward takes 1 (concatenated), 2 or 3 inputs, not %d", n);
        return NULL;
    }
    for (int i = 1; i < spec->depth; i++) h = hg_linear_layer_forward(&net->layer[i], ctx, h, spec->activation);
    return hg_linear_layer_forward(&net->layer[spec->depth], ctx, h, HG_IDENTITY);
}

static hg_status neuralocks_create(hg_model **model, hg_ctx *ctx, const hg_model_spec *spec)
{
    neuralocks *net = hg_alloc(1, sizeof *net);
    if (!net) return HG_MEMORY;
    net->spec = *spec;
    net->layers = spec->depth + 1;
    net->layer = hg_alloc((size_t)net->layers, sizeof *net->layer);
    net->params = hg_alloc((size_t)net->layers * 2, sizeof(hg_tensor *));
    if (!net->layer || !net->params) {
        neuralocks_destroy(net);
        return HG_MEMORY;
    }
    for (int i = 0; i < net->layers; i++) {
        const bool last = i == spec->depth;
        char *name = i == 0 ? hg_strdup("first") : last ? hg_strdup("last") : hg_format("hidden%d", i);
        hg_status status = !name ? HG_MEMORY
                                 : hg_linear_layer_create(&net->layer[i], ctx, i == 0 ? spec->inputs : spec->width,
                                                          last ? spec->outputs : spec->width,
                                                          last ? HG_INIT_ZERO : HG_INIT_HE, spec->seed, name);
        hg_free(name);
        if (status != HG_OK) {
            neuralocks_destroy(net);
            return status;
        }
        net->params[2 * i] = net->layer[i].weight;
        net->params[2 * i + 1] = net->layer[i].bias;
    }
    net->model = (hg_model){ .kind = "neuralocks",
                             .params = net->params,
                             .n_params = 2 * net->layers,
                             .self = net,
                             .forward = neuralocks_forward,
                             .strand_part = strand_part,
                             .destroy = neuralocks_destroy };
    *model = &net->model;
    return HG_OK;
}

static const hg_architecture neuralocks_architecture = { .name = "neuralocks",
                                                         .what = "a small network per strand (Lin et al. 2025)",
                                                         .create = neuralocks_create };
HG_REGISTER("model", neuralocks, &neuralocks_architecture);
