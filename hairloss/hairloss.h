/* hairloss: the energies of hair, and `physics`: a weighted set of them over a groom.
 *
 * One energy is one file: equation, source, parameters with units, and the formula of one site (see
 * autograd/trace/trace.h). It registers itself; from then on its name works in configs, gradcheck and benches.
 *
 *     const hg_term terms[] = { { hg_energy_find("stretch"), 1.0 }, { hg_energy_find("gravity"), 1.0 } };
 *     hg_physics_create(&physics, ctx, HG_F32, terms, 2, &groom_data);
 *     hg_tensor *energy = hg_physics_energy(physics, ctx, &frame, x, unweighted);    x [B,S,V,3] -> []
 *     hg_backward(ctx, energy);                                                      hg_grad(x) is dE/dx
 *
 * Units are SI, +Y up. x is [B,S,V,3], root first. Quaternions are (w,x,y,z). Every energy is the SUM over its sites,
 * roots included. Degenerate input (zero-length edge, antiparallel tangents, q and -q, one-vertex strand, no strand) has
 * a finite value and gradient:
 *   rest length where divided by     max(l0, 1e-6 m)
 *   unit tangent                     e / sqrt(max(e.e, (1e-3 l0)^2))
 *   transport(a -> b)                (a.h, a x h), h = (a+b)/sqrt(max(|a+b|^2, 1e-4))
 *   gradient of a norm at zero       zero
 */
#ifndef HG_HAIRLOSS_H
#define HG_HAIRLOSS_H

#include "autograd/autograd.h"
#include "autograd/trace/trace.h"
#include "geometry/geometry.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- energies ----------------------------------------------------------------------------------------------- */

typedef enum {
    HG_SITE_WINDOW,     /* `count` consecutive vertices of a strand; a formula with carry and keep is a scan from root to tip */
    HG_SITE_PAIRS,      /* the pairs of a list: x(0), x(1), rest(0), rest(1), distance */
    HG_SITE_FIELD       /* a sum over neighbours (`kernel` of distance), then a function of it (`trace`) */
} hg_site_kind;
typedef struct { hg_site_kind kind; int count; } hg_site;

typedef struct { const char *name; double value; const char *unit; const char *help; } hg_energy_param;  /* scalar with default; "g.x" style names make a vector */
typedef struct { const char *name, *choices, *value, *help; } hg_energy_option;                          /* "strain", "published|smooth", "published" */

#define HG_ENERGY_PARAMS 8
#define HG_ENERGY_OPTIONS 4
typedef struct {
    const char *name, *equation, *source;
    hg_site site;
    hg_energy_param params[HG_ENERGY_PARAMS];      /* ended by name NULL */
    hg_energy_option options[HG_ENERGY_OPTIONS];
    hg_scalar (*trace)(void);                      /* the energy of one site */
    hg_scalar (*root)(void);                       /* a term once per strand, at the root edge; NULL: none */
    hg_scalar (*kernel)(void);                     /* field: the weight W of one neighbour, zero from `reach` on */
    const char *reach;                             /* field: name of the parameter that is half the support (h: support 2h) */
    bool contact;                                  /* needs the body query */
    bool zero_at_rest, rigid_invariant;            /* what tests may assume: x = rest and the body away; moved with root_rotation */
} hg_energy;

#define HG_ENERGY(name_, ...) \
    static const hg_energy energy_##name_ = { .name = #name_, .trace = name_, __VA_ARGS__ }; \
    HG_REGISTER("energy", name_, &energy_##name_)

const hg_energy *hg_energy_find(const char *name);               /* NULL and hg_message() with the nearest name */

/* Every combination of an energy's options, from number 0 up to the first false. An energy without options has one. */
typedef struct { const char *options[HG_ENERGY_OPTIONS]; char words[HG_ENERGY_OPTIONS][64]; } hg_energy_choice;
bool hg_energy_choose(const hg_energy *energy, int number, hg_energy_choice *choice);

/* What an energy asks for with these options (as in hg_term; NULL: the defaults), found by tracing its formulas. posed_given:
 * the frame brings the posed groom; otherwise it is made of rest, root_rotation and root_position, and those are listed. */
#define HG_ENERGY_INPUTS 24
typedef struct {
    char name[64];                                 /* "x", "rest", an attribute of the groom, an array of the frame */
    const char *shape;                             /* "[B,S,V,3]": B frames, G grooms */
    bool differentiable, optional;                 /* optional: physics makes it where it is absent */
} hg_energy_input;
typedef struct {
    int n; hg_energy_input input[HG_ENERGY_INPUTS];
    bool scan;                                     /* carries values along the strand */
    uint32_t params, kernel_params;                /* bit i: energy->params[i] is read by the formula; by the kernel of a field */
} hg_energy_inputs;
hg_status hg_energy_asks(const hg_energy *energy, const char *const *options, bool posed_given, hg_energy_inputs *inputs);

/* The gradients of one energy against finite differences, on a small scene of its own: in x and in everything else that it
 * asks for, params included, one after another. wrt: one of them by name, NULL: all. checks (may be NULL) gets each. The
 * status is that of the first that fails, and the message names energy, input, frame, strand and vertex. Resets the step. */
#define HG_ENERGY_CHECKS (HG_ENERGY_INPUTS + HG_ENERGY_PARAMS)
typedef struct {
    char name[64]; hg_status status; hg_gradcheck_result result;
    bool no_effect;                                /* gradient and differences are zero: right, and nothing was learnt. Of an unknown (x, q, ..) it is an error */
} hg_energy_check;
hg_status hg_energy_gradcheck(hg_ctx *ctx, const hg_energy *energy, const char *const *options, const char *wrt, const hg_gradcheck_options *how,
                              hg_energy_check checks[HG_ENERGY_CHECKS], int *n);

/* ---- physics ------------------------------------------------------------------------------------------------ */

/* Per-hair parameters, in the order of energy->params; NULL: defaults. option_choices likewise. `weight` multiplies. */
typedef struct {
    const hg_energy *energy;
    double weight;
    const double *params;
    const char *const *options;
} hg_term;

/* What becomes of a sum of energies, as text: operations before and after each simplification, what is computed how often, the
 * instructions at a site. wrt: names of what the derivative is taken in beside x ("rest", "stiffness", "bend_twist.stiffness", ...).
 * c and cuda (may be NULL) get the printed kernel; they stay empty for energies over pairs and neighbours. */
hg_status hg_energy_trace(const hg_term *terms, int n, hg_dtype dtype, int n_wrt, const char *const *wrt, hg_text *report, hg_text *c, hg_text *cuda);

typedef struct { const char *name; const double *values; /* [G,S,V] */ } hg_groom_attribute;

/* Rest data of G grooms with the same S and V; copied. */
typedef struct {
    int64_t grooms, strands, vertices;
    const double *rest;                  /* [G,S,V,3], head rest space [m] */
    const double *mass;                  /* [G,S,V] [kg]; NULL: 1 */
    const hg_groom_attribute *attributes; int n_attributes; /* "body_distance", "scalp_distance", "density_rest" (from rest when absent), ... */
    hg_pairs *const *adhesion;           /* [G]; NULL: built from rest with the radius and count of the term */
    const hg_body_tree *body;            /* NULL: no contact */
} hg_groom_data;

/* Anything else that an energy asks for, or that takes the place of what the groom or the term says in this call:
 *
 *     "bend_twist.stiffness"   a parameter of an energy, per strand: [], [S] or [B,S]. Of a pair or a neighbour sum: that of
 *                              the strand of the first vertex; one that makes a list (radius, h of a field) has to be []
 *     "dt"                     [], s
 *     "rest", "mass", or the name of a groom attribute       [G,S,V,3], [G,S,V]
 *     "q"                      free orientations of the edges [B,S,V-1,4]
 *     any name that a formula reads with frame_scalar or frame_vec3: [B,S,V], [B,S,V,3]     ("ghost", "deformation")
 *
 * A name that no energy asks for is an error that says which ones there are. */
typedef struct { const char *name; hg_tensor *value; } hg_frame_input;

/* What a frame brings; f32 or f64 as the physics. NULL where no energy asks for it (an error says which one does). */
typedef struct {
    const int32_t *groom;                /* [B], NULL: all 0 */
    hg_tensor *root_rotation;            /* [B,S,4], NULL: identity */
    hg_tensor *root_position;            /* [B,S,3], NULL: rest root */
    hg_tensor *posed;                    /* [B,S,V,3], NULL: from the two above */
    hg_tensor *predicted, *previous;     /* [B,S,V,3] */
    hg_tensor *body_vertices;            /* [B,N,3] */
    double dt;                           /* s */
    int64_t consecutive;                 /* pose_reg: the batch is B / consecutive sequences of so many frames; 0: one sequence */
    const hg_frame_input *inputs; int n_inputs;
} hg_frame;

/* Of the processor. A GPU has one way, CUDA printed for the sum of energies at hand and compiled when it is first launched: AUTO
 * and COMPILED are that, INTERPRETER is refused. What a call brings in a GPU's memory is not read by the host, so that it waits
 * for nothing: a "dt" is not checked there, and a "distance" of contact that is a tensor gives the search for contact no bound. */
typedef enum { HG_BACKEND_AUTO, HG_BACKEND_INTERPRETER, HG_BACKEND_COMPILED } hg_backend;

typedef struct hg_physics hg_physics;
hg_status  hg_physics_create(hg_physics **physics, hg_ctx *ctx, hg_dtype dtype, const hg_term *terms, int n, const hg_groom_data *data);
void       hg_physics_destroy(hg_physics *physics);
hg_status  hg_physics_backend(hg_physics *physics, hg_backend backend);            /* COMPILED: built in, from the cache, or by the C compiler now; fails, and says why, where none of them is possible. AUTO: the same for a groom that is large enough to win the second back, else interpreted */
const char *hg_physics_backend_name(const hg_physics *physics);                    /* "compiled avx512", "compiled avx512 by gcc 12.2.0" or "interpreter", for the log; of the last call */
const char *hg_physics_backend_note(const hg_physics *physics);                    /* how long it took to compile, or why it could not be; "" when there is nothing to say */
/* One scalar; unweighted [n terms] f64 read-outs of the host (may be NULL; a GPU is waited for). Value and gradient are made in one pass. Differentiable in x,
 * root_rotation, root_position, posed, predicted, previous and every tensor of frame->inputs: a gradient is made for those that
 * need one when the call is recorded. Contact is detached: a body_vertices that needs a gradient is an error, and so is a
 * parameter that makes a list. What is asked for changes the program (what is differentiated is not hoisted): a few
 * combinations are kept, so that a training step does not trace again. */
hg_tensor *hg_physics_energy(hg_physics *physics, hg_ctx *ctx, const hg_frame *frame, hg_tensor *x, double *unweighted);
/* The unweighted energies [n] f64 of the last call, on the context's device, good until the step is over. With `unweighted` NULL
 * and this instead, the host waits for nothing. */
hg_tensor *hg_physics_unweighted(const hg_physics *physics);
/* The same without a tape: energy per strand and term [B,S,n] f64 (may be NULL), gradient [B,S,V,3] (may be NULL). */
hg_status  hg_physics_evaluate(hg_physics *physics, hg_ctx *ctx, const hg_frame *frame, hg_tensor *x, double *unweighted, double *per_strand, hg_tensor *gradient);
/* The gradient of the strands as if each were alone: without pairs and neighbour sums. For solvers. */
hg_status hg_physics_evaluate_alone(hg_physics *physics, hg_ctx *ctx, const hg_frame *frame, hg_tensor *x, hg_tensor *gradient);
/* hg_physics_evaluate on the processor, alone as above or not, with the gradient of a tensor of frame->inputs that needs one
 * (hg_require_grad), such as q, in its shape. For solvers. */
hg_status hg_physics_evaluate_with(hg_physics *physics, hg_ctx *ctx, const hg_frame *frame, hg_tensor *x, bool alone, double *per_strand, hg_tensor *gradient,
                                   const hg_tensor *input, hg_tensor *input_gradient);
/* Until it is let go the body is where it is in the next call: it is fitted once, and contact is searched for vertices that moved since
 * the call before. The results are the same. For solvers, one frame, on the processor; elsewhere it changes nothing. */
void       hg_physics_hold_body(hg_physics *physics, bool held);
#ifndef HG_NO_CALLER
#define hg_physics_energy(physics, ctx, ...) (hg_physics_energy)(physics, HG_HERE(ctx), __VA_ARGS__)
#endif
int        hg_physics_terms(const hg_physics *physics);
const hg_term *hg_physics_term(const hg_physics *physics, int i);

/* ---- energies on arrays of a file --------------------------------------------------------------------------- */

/* What `hairgrad loss` does: reads from an HDF5 file the datasets that the energies' formulas ask for, and writes the value
 * (`energy`, f64, unweighted; with more than one also `energy_NAME`) and gradients (`grad_x`, `grad_NAME`, in dtype, in the
 * shape of what was given). docs/formats.md lists the datasets. Resets the step. */
#define HG_LOSS_GRADIENTS 48
typedef struct {
    const char *energies;                    /* "stretch", or "stretch+gravity" */
    hg_dtype dtype;                          /* HG_F32 or HG_F64 */
    int n_set; const char *const *set;       /* "stiffness=2 N/m", "strain=smooth", "g=0,-9.81,0", "stretch.stiffness=2" */
    const char *wrt;                         /* "x,stiffness"; NULL: x */
    hg_backend backend;
} hg_loss_options;
typedef struct { char name[128], shape[96]; double norm, largest; } hg_loss_gradient;
typedef struct {
    double energy;
    int n; struct { const char *name; double energy; } term[8];
    int n_gradients; hg_loss_gradient gradient[HG_LOSS_GRADIENTS];
    int64_t frames, strands, vertices;
    char backend[64], unread[512];           /* unread: datasets that no formula asked for, "a, b" */
} hg_loss_result;
hg_status hg_loss_run(hg_ctx *ctx, const char *in, const char *out, const hg_loss_options *options, hg_loss_result *result);

#ifdef __cplusplus
}
#endif
#endif
