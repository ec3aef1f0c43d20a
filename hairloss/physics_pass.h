/* physics_pass (private): what the passes over pairs and over fields share. Where the numbers of an energy come from in
 * this call (the groom, the term, or the frame), where their derivatives go, and the walk over the frames of the batch.
 *
 * A pass begins with an hg_pass, and its run is hg_pass_begin (values of this call) and hg_pass_frames. */
#ifndef HG_HAIRLOSS_PHYSICS_PASS_H
#define HG_HAIRLOSS_PHYSICS_PASS_H

#include "hairloss/physics.h"

#define HG_PASS_INPUTS     32
#define HG_PASS_ATTRIBUTES 8

/* The sources of a term: its params by number, then these, then its attributes. */
enum {
    HG_PASS_DT = HG_ENERGY_PARAMS,
    HG_PASS_MASS,
    HG_PASS_REST,       /* positions; no input of a function, but what rest distances and rest fields are made of */
    HG_PASS_FIELD_REST, /* the attribute "density_rest" of a field */
    HG_PASS_ATTRIBUTE,
    HG_PASS_SOURCES = HG_PASS_ATTRIBUTE + HG_PASS_ATTRIBUTES
};

typedef struct {
    enum { HG_PASS_UNIFORM, HG_PASS_STRAND, HG_PASS_GROOM } shape; /* one value, [B,S], [G,S,V,w] */
    bool given;                                                    /* by the frame of this call */
    double uniform;
    const void *values; /* in the precision of the pass; not of a uniform one */
    void *gradient;     /* of the same shape, NULL: not wanted */
    double sum;         /* of a uniform one: its derivative, over the frames */
    double *strands;    /* [S] of the frame at work: what a uniform one and one per strand leave for hg_pass_frames */
} hg_pass_source;

/* One input of a function: a source, or (source -1) something that the pass brings by itself. */
typedef struct {
    int n;
    hg_input inputs[HG_PASS_INPUTS];
    int source[HG_PASS_INPUTS], side[HG_PASS_INPUTS]; /* side: vertex 0 or 1 of a pair */
    double uniform[HG_PASS_INPUTS];                   /* set by hg_pass_begin for uniform sources */
} hg_pass_inputs;

/* One frame of the batch. */
typedef struct {
    int64_t frame, groom;
    const void *x;  /* [S,V,3] */
    void *gradient; /* [S,V,3], NULL: not wanted */
} hg_pass_frame;

typedef struct hg_pass {
    hg_dtype dtype;
    hg_term term;
    int number; /* of the term */
    const hg_groom_data *data;
    int64_t grooms, strands, vertices;
    uint32_t uniform_only; /* bit of each param that has to be one value, because it makes a list or a sum */
    uint32_t makes_list;   /* bit of each param that has no derivative */
    char *attributes[HG_PASS_ATTRIBUTES];
    int n_attributes;
    void *own[HG_PASS_SOURCES]; /* [G,S,V,w] of the groom, in the precision of the pass; NULL: not asked for */
    hg_pass_source source[HG_PASS_SOURCES];
    double *strand_slopes;   /* [sources,S] */
    double *strand_energies; /* [S] of the frame at work */
    bool wants;              /* some source's derivative is asked for */
    hg_status (*run_frame)(void *self, hg_ctx *ctx, const hg_pass_frame *frame);
} hg_pass;

/* Takes what the setup says; traces the energy's formula to know the attributes. */
hg_status hg_pass_create(hg_pass *pass, const hg_pass_setup *setup, uint32_t allowed, uint32_t *kinds);
void hg_pass_free(hg_pass *pass);
int hg_pass_param(const hg_pass *pass,
                  const char *name); /* number of the param; -1: the energy has none of that name */

int hg_pass_inputs_add(hg_pass_inputs *list, hg_input input, int source, int side);
void hg_pass_inputs_add_uniform(hg_pass_inputs *list, const hg_pass *pass, bool dt); /* the params, and the time step */
void hg_pass_inputs_fill(hg_pass_inputs *list, const hg_pass *pass);

/* n numbers in the precision of the pass, to be freed. */
void *hg_pass_values(hg_dtype dtype, int64_t n, const double *from);

/* The values of this call. */
hg_status hg_pass_begin(hg_pass *pass, const hg_frame *frame, int n_values, const hg_pass_value *values);
/* Runs the frames one after another, and adds up what they leave. */
hg_status hg_pass_frames(void *self, hg_ctx *ctx, const hg_pass_call *call);

#endif
