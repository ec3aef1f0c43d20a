/* Brings the arrays of a frame that some terms ask for, by name, from what a test has: "q", "ghost", "deformation". */
#ifndef ASKS_H
#define ASKS_H

#include "hairloss/physics_inputs.h"

#include <stdlib.h>
#include <string.h>

typedef struct {
    const char *name;
    int width; /* 4: of edges */
    const double *values;
} test_array;

/* Tensors of the step; how many are asked for. */
static inline int bring_arrays(hg_ctx *ctx, hg_dtype dtype, const hg_term *terms, int n, const int64_t size[3],
                               int n_arrays, const test_array *arrays, hg_frame_input *inputs)
{
    hg_physics_asks asks = { 0 };
    int brought = 0;
    for (int t = 0; t < n; t++) {
        double params[HG_ENERGY_PARAMS];
        const char *options[HG_ENERGY_OPTIONS];
        if (hg_term_complete(&terms[t], params, options) != HG_OK) abort();
        const hg_term term = { terms[t].energy, 1, params, options };
        if (hg_physics_asked(&asks, &term, 1) != HG_OK) abort();
    }
    for (int i = 0; i < n_arrays; i++) {
        const test_array *array = &arrays[i];
        const int64_t shape[4] = { size[0], size[1], size[2] - (array->width == 4), array->width };
        bool asked = strcmp(array->name, "q") == 0 && asks.kinds & HG_ALLOW(HG_INPUT_Q);
        for (int k = 0; k < asks.n_frames; k++) asked |= strcmp(asks.frames[k].name, array->name) == 0;
        if (!asked) continue;
        hg_tensor *tensor = hg_tensor_make(ctx, dtype, array->width == 1 ? 3 : 4, shape);
        if (!tensor) abort();
        for (int64_t k = 0; k < hg_tensor_count(tensor); k++) {
            if (dtype == HG_F64)
                ((double *)tensor->data)[k] = array->values[k];
            else
                ((float *)tensor->data)[k] = (float)array->values[k];
        }
        inputs[brought++] = (hg_frame_input){ array->name, tensor };
    }
    hg_physics_asks_free(&asks);
    return brought;
}

#endif
