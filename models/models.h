/* models: layers, and one file per architecture. A model is a declaration, not a training program.
 *
 * A model owns its parameters (with names, for checkpoints and export) and has one forward over tensors.
 *
 *     hg_model *model;
 *     hg_model_create(&model, ctx, "neuralocks", &(hg_model_spec){ .inputs = 748, .strand_inputs = 66, .outputs = 72,
 *                                                                  .width = 256, .depth = 2, .activation = HG_SILU });
 *     hg_tensor *d = model->forward(model->self, ctx, (hg_tensor *[]){ strand, frame }, 2);
 *
 * Parameters are f32, made from (seed, parameter number): the same network everywhere.
 */
#ifndef HG_MODELS_H
#define HG_MODELS_H

#include "autograd/autograd.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct hg_model {
    const char *kind;
    hg_tensor **params; int n_params;            /* owned by the model; params[i]->name is "first.weight", ... */
    void *self;
    hg_tensor *(*forward)(void *self, hg_ctx *ctx, hg_tensor **in, int n);
    /* What the first layer makes of inputs that stay the same over several calls; goes in as in[2] of forward with
     * in[0] = NULL. NULL: the architecture has no such part. */
    hg_tensor *(*strand_part)(void *self, hg_ctx *ctx, hg_tensor *strand);
    hg_tensor *(*encode)(void *self, hg_ctx *ctx, hg_tensor *x); /* of an autoencoder: x as forward takes it -> code [N,latent]; NULL: it has none */
    void (*destroy)(void *self);
} hg_model;

typedef struct {
    int inputs, strand_inputs, outputs;          /* widths; strand inputs come first, the rest are a frame's */
    int width, depth;                            /* hidden layers */
    int latent;                                  /* autoencoder */
    int texture;                                 /* of images: texels of a side; width is the channels where they are smallest, depth how often they double, inputs or outputs are channels */
    int groups;                                  /* of images: for a group norm after each convolution but the last; 0: none */
    hg_activation activation;
    uint64_t seed;
} hg_model_spec;

/* An architecture: one file, registered as kind "model". */
typedef struct {
    const char *name, *what;
    hg_status (*create)(hg_model **model, hg_ctx *ctx, const hg_model_spec *spec);
    bool images;                                 /* forward([B,inputs]) is images [B,outputs,texture,texture] of all strands of a groom, not a row for each strand */
} hg_architecture;

hg_status hg_architecture_find(const hg_architecture **architecture, const char *name);
hg_status hg_model_create(hg_model **model, hg_ctx *ctx, const char *architecture, const hg_model_spec *spec);
void      hg_model_destroy(hg_model *model);
int64_t   hg_model_weights(const hg_model *model);
hg_status hg_model_copy(hg_model *to, const hg_model *from);     /* parameters only; same kind and shapes */

hg_tensor *hg_encode(const hg_model *model, hg_ctx *ctx, hg_tensor *x); /* of an autoencoder: the code [N,latent] */

/* Layers. */
typedef struct { hg_tensor *weight /* [in,out] */, *bias /* [out] */; } hg_linear_layer;
/* 3 x 3 taps, padded by one; with groups a group norm follows, whose gain and bias it has instead of its own bias. */
typedef struct { hg_tensor *weight /* [out,in,3,3] */, *bias /* [out] */, *gain /* [out] or NULL */; int stride, groups; } hg_conv_layer;
typedef enum { HG_INIT_HE, HG_INIT_XAVIER, HG_INIT_ZERO } hg_init;
hg_status  hg_linear_layer_create(hg_linear_layer *layer, hg_ctx *ctx, int in, int out, hg_init init, uint64_t seed, const char *name);
void       hg_linear_layer_destroy(hg_linear_layer *layer);
hg_tensor *hg_linear_layer_forward(const hg_linear_layer *layer, hg_ctx *ctx, hg_tensor *x, hg_activation activation);
hg_status  hg_conv_layer_create(hg_conv_layer *layer, hg_ctx *ctx, int in, int out, int stride, int groups, hg_init init, uint64_t seed, const char *name);
void       hg_conv_layer_destroy(hg_conv_layer *layer);
hg_tensor *hg_conv_layer_forward(const hg_conv_layer *layer, hg_ctx *ctx, hg_tensor *x, hg_activation activation);
hg_init    hg_init_for(hg_activation activation); /* of the layer before it: He where negative numbers are cut off, else Xavier */

#ifdef __cplusplus
}
#endif
#endif
