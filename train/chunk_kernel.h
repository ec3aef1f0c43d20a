/* A piece of a parameter: what one index of the optimiser's kernels works on. */
#ifndef HG_TRAIN_CHUNK_KERNEL_H
#define HG_TRAIN_CHUNK_KERNEL_H

#include "tensor/kernel.h"

typedef struct {
    float *value;
    const float *gradient;
    int64_t first, offset, count; /* of its parameter; of arrays of all parameters one after the other */
    int64_t param;
} hg_chunk;

#endif
