/* Numbers to an image: a linear layer to the smallest image, then twice the size and half the channels, depth times, and a
 * convolution to the channels wanted. What quaffure and groom_autoencoder share. Private to models/. */
#ifndef HG_MODELS_IMAGE_DECODER_H
#define HG_MODELS_IMAGE_DECODER_H

#include "models/models.h"

typedef struct {
    int smallest, width, depth; /* texels of a side and channels of the first image; how often it doubles */
    hg_activation activation;
    hg_linear_layer first;
    hg_conv_layer *layer; /* depth + 1 */
} image_decoder;

/* That textures and widths can be halved depth times, and groups fit; what: the architecture, for the message. */
hg_status image_spec_check(const hg_model_spec *spec, const char *what);
/* prefix: of its parameters' names; last: how the last layer begins. destroy takes a zeroed one too, and what create left. */
hg_status image_decoder_create(image_decoder *decoder, hg_ctx *ctx, const hg_model_spec *spec, int inputs, hg_init last,
                               const char *prefix);
void image_decoder_destroy(image_decoder *decoder);
hg_tensor *image_decoder_forward(const image_decoder *decoder, hg_ctx *ctx, hg_tensor *x); /* [B,inputs] -> [B,C,T,T] */

/* How many parameters a network of so many convolutions and linear layers has at most, and lists of those of a layer. */
enum { IMAGE_PARAMS = 3 };
int image_linear_params(const hg_linear_layer *layer, hg_tensor **params);
int image_conv_params(const hg_conv_layer *layer, hg_tensor **params);
int image_decoder_params(const image_decoder *decoder, hg_tensor **params);

#endif
