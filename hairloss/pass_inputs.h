/* pass_inputs (private): what a pairs or field pass brings to the functions of its energy. */
#ifndef HG_HAIRLOSS_PASS_INPUTS_H
#define HG_HAIRLOSS_PASS_INPUTS_H

#include "hairloss/physics.h"

#define HG_PASS_INPUTS     24
#define HG_PASS_ATTRIBUTES 8

/* Inputs of a function in order; `uniform` holds the value of those that are the same for all lanes. */
typedef struct {
    int n;
    hg_input inputs[HG_PASS_INPUTS];
    double uniform[HG_PASS_INPUTS];
    int dt; /* number of the time step's input */
} hg_pass_inputs;

static inline int hg_pass_inputs_add(hg_pass_inputs *list, hg_input input, double uniform)
{
    list->inputs[list->n] = input;
    list->uniform[list->n] = uniform;
    return list->n++;
}

/* The parameters of the term and the time step. */
static inline void hg_pass_inputs_add_uniform(hg_pass_inputs *list, const hg_term *term)
{
    for (int p = 0; p < HG_ENERGY_PARAMS && term->energy->params[p].name; p++)
        hg_pass_inputs_add(list, (hg_input){ .kind = HG_INPUT_PARAM, .name = (int16_t)p }, term->params[p]);
    list->dt = hg_pass_inputs_add(list, (hg_input){ .kind = HG_INPUT_DT }, 0.0);
}

/* n numbers in the precision of the pass, to be freed. */
static inline void *hg_pass_values(hg_dtype dtype, int64_t n, const double *from)
{
    void *to = hg_alloc((size_t)n + 1, hg_dtype_size(dtype));
    if (!to) return NULL;
    for (int64_t i = 0; i < n; i++) {
        if (dtype == HG_F32)
            ((float *)to)[i] = (float)from[i];
        else
            ((double *)to)[i] = from[i];
    }
    return to;
}

/* The groom attributes that a formula asks for, in the precision of the pass. */
static inline hg_status hg_pass_attributes(const hg_pass_setup *setup, int64_t n, int n_attributes, char *const *names,
                                           void **values)
{
    for (int a = 0; a < n_attributes; a++) {
        const double *from = hg_groom_attribute_find(setup->data, names[a]);
        if (!from)
            return hg_fail(HG_INVALID, "energy '%s' asks for the groom attribute '%s', which the groom does not have",
                           setup->term.energy->name, names[a]);
        values[a] = hg_pass_values(setup->dtype, n, from);
        if (!values[a]) return HG_MEMORY;
    }
    return HG_OK;
}

#endif
