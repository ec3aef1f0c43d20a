/* physics_pass (private): what the passes over pairs and over fields share. Where the numbers of an energy come from in
 * this call (the groom, the term, or the frame), where their derivatives go, and the walk over the frames of the batch.
 *
 * A pass begins with an hg_pass, and its run is hg_pass_begin (values of this call) and hg_pass_frames. */
#ifndef HG_HAIRLOSS_PHYSICS_PASS_H
#define HG_HAIRLOSS_PHYSICS_PASS_H

#include "hairloss/physics.h"
#include "tensor/kernel.h"

#include "hairloss/physics_pass_lanes.inc" /* HG_PASS_INPUTS, hg_pass_lanes */

#define HG_PASS_ATTRIBUTES 8
#define HG_PASS_KERNELS    8

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
    int shape;  /* HG_PASS_UNIFORM, .._STRAND, .._GROOM: one value, [B,S], [G,S,V,w] */
    bool given; /* by the frame of this call */
    double uniform;
    const void
        *values;     /* of the device, in the precision of the pass; of a uniform one NULL on the host, and where it is
                           not given */
    void *gradient;  /* of the same shape, NULL: not wanted */
    double sum;      /* of a uniform one: its derivative, over the frames */
    double *strands; /* [S] of the frame at work: what a uniform one and one per strand leave for hg_pass_frames */
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
    hg_ctx *ctx, *host; /* the physics' own; one for what is made once on the host: the same where that is the device */
    char *attributes[HG_PASS_ATTRIBUTES];
    int n_attributes;
    void *own[HG_PASS_SOURCES]; /* [G,S,V,w] of the groom, in the precision of the pass; NULL: not asked for */
    hg_tensor *own_tensor[HG_PASS_SOURCES]; /* whose data they are on another device than the host */
    hg_pass_source source[HG_PASS_SOURCES];
    double *strand_slopes;   /* [sources,S] */
    double *strand_energies; /* [S] of the frame at work */
    bool wants;              /* some source's derivative is asked for */
    hg_status (*run_frame)(void *self, hg_ctx *ctx, const hg_pass_frame *frame); /* on the host */
    hg_text text; /* of the kernels of another device: the traced functions, and the bodies that call them */
    hg_kernel kernels[HG_PASS_KERNELS];
    int n_kernels;
} hg_pass;

/* Takes what the setup says; traces the energy's formula to know the attributes. */
hg_status hg_pass_create(hg_pass *pass, const hg_pass_setup *setup, uint32_t allowed, uint32_t *kinds);
void hg_pass_free(hg_pass *pass);
int hg_pass_param(const hg_pass *pass,
                  const char *name); /* number of the param; -1: the energy has none of that name */

int hg_pass_inputs_add(hg_pass_inputs *list, hg_input input, int source, int side);
void hg_pass_inputs_add_uniform(hg_pass_inputs *list, const hg_pass *pass, bool dt); /* the params, and the time step */
void hg_pass_inputs_fill(hg_pass_inputs *list, const hg_pass *pass);

/* n numbers in the precision of the pass, to be freed; the same as source s of the pass, on its device. */
void *hg_pass_values(hg_dtype dtype, int64_t n, const double *from);
hg_status hg_pass_own(hg_pass *pass, int s, int64_t n, const double *from);

/* The values of this call. */
hg_status hg_pass_begin(hg_pass *pass, const hg_frame *frame, int n_values, const hg_pass_value *values);
/* A param of one value, for what is made on the host; where the call gives it on another device, this waits for it. */
hg_status hg_pass_number(const hg_pass *pass, int param, double *number);
/* Runs the frames one after another, and adds up what they leave. */
hg_status hg_pass_frames(void *self, hg_ctx *ctx, const hg_pass_call *call);

/* ---- on another device than the host: all frames at once (physics_pass_device.c) ------------------------------ */

/* Kernels of the text, which live as long as the pass; returns the kernel's number in pass->kernels. */
int hg_pass_kernel(hg_pass *pass, const char *name, size_t args_size);
/* The inputs of a function as the kernels of this call find them. */
void hg_pass_lanes_fill(hg_pass_lanes *lanes, const hg_pass *pass, const hg_pass_inputs *inputs);
/* energies [B,S,V] of the vertices: the sum and the sums per strand go where the call wants them. */
hg_status hg_pass_energies(const hg_pass *pass, hg_ctx *ctx, const hg_pass_call *call, const double *energies);
/* Adds scale * the sums of slopes [frames,S,V,w] to the gradient of a source. groom: of each frame, NULL: all 0;
 * grooms: the frames are the grooms themselves. */
typedef struct {
    int64_t frames;
    const int32_t *groom;
    bool grooms;
} hg_pass_batch;
hg_status hg_pass_add(const hg_pass *pass, hg_ctx *ctx, const hg_pass_batch *batch, int source, double scale,
                      const double *slopes, int width);
/* The same to [G,S,V,w] in the precision of the pass. */
hg_status hg_pass_add_grooms(const hg_pass *pass, hg_ctx *ctx, const hg_pass_batch *batch, void *to, double scale,
                             const double *slopes, int width);

#endif
