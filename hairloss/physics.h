/* physics (private): how an energy that is not a window of a strand takes part.
 *
 * Window energies are fused into the strand pass. A pairs or field energy is a pass of its own, run after it: it registers
 * itself as HG_REGISTER("physics_pass", pairs, &pass) or ("physics_pass", field, &pass), and physics makes one for each
 * term of that site kind.
 */
#ifndef HG_HAIRLOSS_PHYSICS_H
#define HG_HAIRLOSS_PHYSICS_H

#include "autograd/trace/program.h"
#include "hairloss/hairloss.h"

/* What a pass is made from; everything it points to lives as long as the physics. */
typedef struct {
    hg_ctx *ctx;
    hg_dtype dtype;
    hg_term term;              /* params and options are complete: defaults filled in, in the order of the energy */
    const hg_groom_data *data; /* the physics' own copy; mass and n_attributes as given, mass never NULL */
    int number;                /* of the term in the physics */
} hg_pass_setup;

/* A value of this call that is not the groom's or the term's own, resolved by physics, and where its gradient goes. */
typedef struct {
    hg_input_kind kind; /* HG_INPUT_PARAM, DT, REST, MASS, ATTRIBUTE; of the strand pass alone: Q, FRAME, and with a
                           gradient POSED, PREDICTED, PREVIOUS, ROOT_ROTATION, ROOT_POSITION */
    int term, param;    /* HG_INPUT_PARAM: number of the term in the physics, number of the param in its energy */
    const char *name;   /* HG_INPUT_ATTRIBUTE, HG_INPUT_FRAME */
    bool uniform;       /* a param or dt of one value: values is [1] */
    const void *values; /* of the device, in the dtype of the physics: [1] or [B,S]; groom values [G,S,V,w] */
    void *gradient;     /* the same shape, NULL: not wanted; zero or the strand pass' part before; the pass ADDS
                           weight * dE/dvalue */
} hg_pass_value;

/* One call of a pass. Every array in it is memory of the device; nothing of it is read by the host. */
typedef struct {
    const hg_frame *frame; /* for its tensors and dt */
    const int32_t *groom;  /* [B] of the device, where frame->groom is of the host; NULL: all 0 */
    const hg_tensor *x;    /* [B,S,V,3] */
    int n_values;
    const hg_pass_value *values; /* those of other terms are there too */
    void *gradient;              /* [B,S,V,3] in dtype, NULL: not wanted; the pass adds weight * dE/dx */
    double *unweighted;          /* one number: gets the energy */
    double *per_strand; /* NULL, or [B,S] values at distance `stride`: gets the energy per strand (set, not added) */
    int64_t stride;
} hg_pass_call;

typedef struct {
    hg_status (*create)(void **self, const hg_pass_setup *setup);
    void (*destroy)(void *self); /* NULL is fine */
    hg_status (*run)(void *self, hg_ctx *ctx, const hg_pass_call *call);
} hg_physics_pass;

/* Scope for tracing a term's formulas: names of params and chosen options filled in. */
void hg_term_scope(hg_trace_scope *scope, const hg_term *term, int number, uint32_t allowed);
/* Adds the bits of the params that a formula reads. */
hg_status hg_formula_params(hg_scalar (*formula)(void), const hg_trace_scope *scope, uint32_t *params);
/* Value of the param `name` of a completed term; NAN when it has none. The choice of the option `name`: NULL when none. */
double hg_term_param(const hg_term *term, const char *name);
const char *hg_term_option(const hg_term *term, const char *name);
/* Does the field of the term weigh its neighbours with their masses? The option kernel_mass says so. */
bool hg_term_weighs(const hg_term *term);
/* Attribute [G,S,V] of the groom data, NULL when absent. */
const double *hg_groom_attribute_find(const hg_groom_data *data, const char *name);
/* Params and options of a term with the defaults filled in; a wrong choice is an error. */
hg_status hg_term_complete(const hg_term *term, double params[HG_ENERGY_PARAMS],
                           const char *options[HG_ENERGY_OPTIONS]);

/* ---- the strand pass (physics_strand.c) ---------------------------------------------------------------------- */

typedef struct hg_strand_pass hg_strand_pass;

/* What a call brings and wants, as far as it changes the program. */
typedef struct {
    bool posed_given;  /* by the frame; otherwise made in the kernel */
    bool root_at_rest; /* rest is given and the root position is not: it is the rest root */
    int n_given;
    hg_given given[HG_GIVEN]; /* `term` counts the terms of the strand pass */
} hg_strand_variant;

/* terms: completed, all of site kind window; column[i]: number of term i in the physics. The data, and the names in the
 * variant (NULL: nothing is given), must outlive it. */
hg_status hg_strand_pass_create(hg_strand_pass **pass, hg_ctx *ctx, hg_dtype dtype, int n, const hg_term *terms,
                                const int32_t *column, const hg_groom_data *data, const hg_strand_variant *variant,
                                bool hoist);
void hg_strand_pass_destroy(hg_strand_pass *pass);
/* level: "avx512", "avx2", "sse4", "plain": that one only; NULL: the best that the processor has. */
hg_status hg_strand_pass_backend(hg_strand_pass *pass, hg_ctx *ctx, hg_backend backend, const char *level);
const char *hg_strand_pass_backend_name(const hg_strand_pass *pass);
const char *hg_strand_pass_backend_note(const hg_strand_pass *pass); /* why, how long */
uint64_t hg_strand_pass_hash(const hg_strand_pass *pass);
/* contact_point, contact_normal [B,S,V,3]: NULL unless a term asks for contact. The gradients of x and of the values are SET;
 * so are unweighted[column[i]] and per_strand[.. * stride + column[i]]. */
hg_status hg_strand_pass_run(hg_strand_pass *pass, const hg_pass_call *call, const void *contact_point,
                             const void *contact_normal);

/* physics_twin.c: the energy of a call on the device, of `twin` on the processor; inputs as hg_op.twin has them. */
hg_tensor *hg_physics_twin(hg_physics *twin, const hg_frame *frame, const hg_call *call, hg_ctx *host,
                           hg_tensor *const *in);

#endif
