/* The activation functions, for the ops that fuse them. */
#ifndef HG_AUTOGRAD_ACTIVATION_H
#define HG_AUTOGRAD_ACTIVATION_H

#include "autograd/activation_kernel.h"
#include "autograd/tape.h"

bool hg_activation_saves_derivative(hg_activation activation); /* else the backward works from the output */
bool hg_activation_is_known(hg_activation activation);
bool hg_activation_has_kink(hg_activation activation); /* at zero */
double hg_activation_reference(hg_activation activation, double x);

#endif
