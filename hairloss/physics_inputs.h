/* physics_inputs (private): what a call of a physics brings, by name, as values for the passes. */
#ifndef HG_HAIRLOSS_PHYSICS_INPUTS_H
#define HG_HAIRLOSS_PHYSICS_INPUTS_H

#include "hairloss/physics.h"

enum { HG_PHYSICS_NAMES = 16, HG_PHYSICS_VALUES = HG_GIVEN };

/* What the energies of a physics ask for. */
typedef struct {
    char *name;
    int width, term; /* which term asked first */
} hg_physics_name;
typedef struct {
    uint32_t kinds, window_kinds; /* HG_ALLOW(kind): of all energies, of those of the strand pass */
    hg_physics_name attributes[HG_PHYSICS_NAMES], frames[HG_PHYSICS_NAMES];
    int n_attributes, n_frames;
} hg_physics_asks;

hg_status hg_physics_asked(hg_physics_asks *asks, const hg_term *terms, int n);
void hg_physics_asks_free(hg_physics_asks *asks);
/* Is there an energy among the terms that takes an input of this name? */
bool hg_physics_takes(const hg_physics_asks *asks, const hg_term *terms, int n, const char *name);

/* The values of a call. */
typedef struct {
    int n;
    hg_pass_value value[HG_PHYSICS_VALUES];
    hg_tensor *tensor[HG_PHYSICS_VALUES]; /* whose gradient it is; NULL: not wanted */
    int64_t count[HG_PHYSICS_VALUES];     /* of the gradient's numbers */
} hg_physics_values;

typedef struct {
    hg_ctx *ctx;
    hg_dtype dtype;
    const hg_groom_data *data;
    const hg_term *terms;
    int n_terms;
    const hg_physics_asks *asks;
    const hg_frame *frame;
    int64_t frames;
    bool gradients; /* of every tensor that needs one */
    hg_physics_values *values;
} hg_physics_resolver;

hg_status hg_physics_resolve(hg_physics_resolver *resolver);
hg_status
hg_physics_chain(const hg_physics_resolver *resolver); /* after the passes: gradients of what was made of values */
/* In the step arena; NULL without memory. */
void *hg_physics_gradient(hg_ctx *ctx, const hg_physics_values *values, const hg_tensor *tensor);
void hg_physics_variant(const hg_physics_resolver *resolver, const int32_t *column, int n_window,
                        hg_strand_variant *variant);
bool hg_physics_same_variant(const hg_strand_variant *a, const hg_strand_variant *b);

/* ---- what is not finite (physics_trap.c) ---------------------------------------------------------------------- */

/* Adds to the message which energy is not finite at which frame, strand and vertex, in value or in force times `arrived`,
 * the gradient that came to the energy; with a path (may be NULL) writes there the input of a `hairgrad loss` that shows
 * it, and adds that command. */
hg_status hg_physics_explain(hg_ctx *ctx, hg_dtype dtype, const hg_term *terms, int n, const hg_groom_data *data,
                             const hg_frame *frame, hg_tensor *x, double arrived, const char *path, hg_text *text);

#endif
