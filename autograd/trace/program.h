/* program (private to autograd/trace and hairloss): what becomes of a traced formula.
 *
 *   hg_graph      the recorded scalars: nodes in topological order, folded and shared (graph.c)
 *   hg_code       instructions for one place (a site, a strand, a lane of gathered values), in order (lower.c)
 *   hg_function   a list over lanes of gathered inputs: values and derivatives (interpreter.c). What pairs and fields use:
 *
 *     const hg_trace_scope scope = { .name = "self_collision", .allowed = HG_ALLOW_FIELD_KERNEL,
 *                                    .n_params = 2, .params = { "stiffness", "h" } };
 *     const hg_input inputs[] = { { HG_INPUT_DISTANCE }, { HG_INPUT_PARAM, .name = 1 } };
 *     hg_function *kernel;
 *     hg_function_create(&kernel, energy->kernel, &scope, 1, (int[]){ 0 }, 2, inputs);   value, then d/d inputs[0]
 *     hg_function_run(kernel, HG_F32, n, (const void *[]){ distances, NULL }, (double[]){ 0, h }, (void *[]){ w, dw });
 *
 * The strand pass, which fuses all window energies, is in strand.h.
 */
#ifndef HG_TRACE_PROGRAM_H
#define HG_TRACE_PROGRAM_H

#include "autograd/trace/trace.h"

/* ---- inputs ------------------------------------------------------------------------------------------------- */

typedef enum {
    HG_INPUT_X, /* vertex `offset`, component 0..2 */
    HG_INPUT_REST,
    HG_INPUT_POSED,
    HG_INPUT_PREDICTED,
    HG_INPUT_PREVIOUS,
    HG_INPUT_CONTACT_POINT,
    HG_INPUT_CONTACT_NORMAL,
    HG_INPUT_ROOT_X, /* vertex 0 or 1 of the strand: `offset` */
    HG_INPUT_ROOT_REST,
    HG_INPUT_ROOT_ROTATION, /* component 0..3: w x y z */
    HG_INPUT_ROOT_POSITION,
    HG_INPUT_MASS,
    HG_INPUT_ATTRIBUTE, /* `name`: number in the graph's table of attribute names */
    HG_INPUT_DISTANCE,
    HG_INPUT_REST_DISTANCE,
    HG_INPUT_FIELD,
    HG_INPUT_FIELD_REST,
    HG_INPUT_PARAM,  /* `name`: the param's number; `term`: whose */
    HG_INPUT_WEIGHT, /* of `term` */
    HG_INPUT_DT,
    HG_INPUT_ADJOINT,       /* `name`: number of a strand value whose adjoints were summed over the sites */
    HG_INPUT_Q,             /* of the edge whose first vertex is `offset`, component 0..3: w x y z */
    HG_INPUT_FRAME,         /* a named array of the frame; `name`: number in the graph's table of their names */
    HG_INPUT_CARRY,         /* what the site before kept; `name`: number in the graph's table of carried values */
    HG_INPUT_REST_CARRY,    /* the same, of rest data alone */
    HG_INPUT_CARRY_ADJOINT, /* the adjoint of what this site keeps */
    HG_INPUT_KINDS
} hg_input_kind;

typedef struct {
    hg_input_kind kind;
    int16_t offset; /* window(n): the formula's vertex k is offset k - (n - 1), so that 0 is the LAST vertex */
    int16_t component;
    int16_t name, term;
} hg_input;

#define HG_ALLOW(kind)  (1u << (kind))
#define HG_ALLOW_SHARED (HG_ALLOW(HG_INPUT_PARAM) | HG_ALLOW(HG_INPUT_DT))
#define HG_ALLOW_WINDOW                                                                                                \
    (HG_ALLOW_SHARED | HG_ALLOW(HG_INPUT_X) | HG_ALLOW(HG_INPUT_REST) | HG_ALLOW(HG_INPUT_POSED) |                     \
     HG_ALLOW(HG_INPUT_PREDICTED) | HG_ALLOW(HG_INPUT_PREVIOUS) | HG_ALLOW(HG_INPUT_CONTACT_POINT) |                   \
     HG_ALLOW(HG_INPUT_CONTACT_NORMAL) | HG_ALLOW(HG_INPUT_ROOT_X) | HG_ALLOW(HG_INPUT_ROOT_REST) |                    \
     HG_ALLOW(HG_INPUT_ROOT_ROTATION) | HG_ALLOW(HG_INPUT_ROOT_POSITION) | HG_ALLOW(HG_INPUT_MASS) |                   \
     HG_ALLOW(HG_INPUT_ATTRIBUTE) | HG_ALLOW(HG_INPUT_Q) | HG_ALLOW(HG_INPUT_FRAME) | HG_ALLOW(HG_INPUT_CARRY))
#define HG_ALLOW_PAIRS                                                                                                 \
    (HG_ALLOW_SHARED | HG_ALLOW(HG_INPUT_DISTANCE) | HG_ALLOW(HG_INPUT_REST_DISTANCE) | HG_ALLOW(HG_INPUT_MASS) |      \
     HG_ALLOW(HG_INPUT_ATTRIBUTE))
#define HG_ALLOW_FIELD_KERNEL (HG_ALLOW_SHARED | HG_ALLOW(HG_INPUT_DISTANCE))
#define HG_ALLOW_FIELD                                                                                                 \
    (HG_ALLOW_SHARED | HG_ALLOW(HG_INPUT_FIELD) | HG_ALLOW(HG_INPUT_FIELD_REST) | HG_ALLOW(HG_INPUT_MASS) |            \
     HG_ALLOW(HG_INPUT_ATTRIBUTE))

/* What the formula being traced may ask for, and the names it may use. */
#define HG_SCOPE_PARAMS  8
#define HG_SCOPE_OPTIONS 4
typedef struct {
    const char *name; /* of the energy, for messages */
    uint32_t allowed; /* HG_ALLOW_* */
    int window;       /* vertices of a site: k is 0 .. window-1 (pairs: 2) */
    int term;         /* number of the term in the physics */
    int n_params, n_options;
    const char *params[HG_SCOPE_PARAMS];                               /* "stiffness", "g.x" */
    const char *options[HG_SCOPE_OPTIONS], *choices[HG_SCOPE_OPTIONS]; /* and what was chosen */
    bool posed_given;  /* posed is an input; otherwise made of rest and the root frame */
    bool root_at_rest; /* the root position is the rest root, whoever brings rest */
    bool first_site;   /* of a strand: what is carried is what carry() calls `first` */
} hg_trace_scope;

/* An input that a call brings in the place of what the groom or the term says, or that a gradient is wanted of. It is not
 * hoisted: REST, MASS and ATTRIBUTE change with the site, PARAM and DT with the strand. */
typedef struct {
    hg_input_kind
        kind; /* REST, MASS, ATTRIBUTE, POSED, PREDICTED, PREVIOUS, ROOT_ROTATION, ROOT_POSITION, Q, FRAME, PARAM, DT */
    int term, param;  /* PARAM */
    const char *name; /* ATTRIBUTE, FRAME */
    bool gradient;
} hg_given;
#define HG_GIVEN 32

/* ---- functions over lanes ----------------------------------------------------------------------------------- */

typedef struct hg_function hg_function;

/* formula: traced in scope. inputs: what `run` brings, in this order; one that the formula asks for and that is not in
 * the list is an error. An attribute is brought as { HG_INPUT_ATTRIBUTE, .offset, .name = i } with attributes[i] its name.
 * wrt: numbers of the inputs whose derivatives are wanted. Outputs: the value, then one derivative per wrt. */
hg_status hg_function_create(hg_function **function, hg_scalar (*formula)(void), const hg_trace_scope *scope, int n_wrt,
                             const int *wrt, int n_in, const hg_input *inputs);
hg_status hg_function_create_named(hg_function **function, hg_scalar (*formula)(void), const hg_trace_scope *scope,
                                   int n_wrt, const int *wrt, int n_in, const hg_input *inputs, int n_attributes,
                                   const char *const *attributes);
void hg_function_destroy(hg_function *function);
/* n lanes, f32 or f64. in[i]: [n] values of input i, or NULL: all lanes have uniform[i] (uniform may be NULL when no in
 * is). out[j]: [n], NULL where not wanted. Thread-safe, allocates nothing; every lane is independent of n. */
void hg_function_run(const hg_function *function, hg_dtype dtype, int64_t n, const void *const *in,
                     const double *uniform, void *const *out);
/* The same for one lane as CUDA C++, for kernels whose text goes through hg_kernel.cuda: includes scalar_cuda.h once, then
 *     template <class hg_v> static __device__ inline void NAME(const hg_v *in, hg_v *out)
 * for hg_v float or double. in[i]: input i, uniform or not; out[j]: output j. Arrays of the calling thread stay in registers,
 * and what it does not read of `out` is not computed. */
void hg_function_print_cuda(const hg_function *function, const char *name, hg_text *text);
/* What a formula asks for, by name. */
#define HG_FORMULA_NAMES 8
typedef struct {
    uint32_t kinds; /* HG_ALLOW(kind) */
    int n_attributes, n_frames;
    char *attributes[HG_FORMULA_NAMES], *frames[HG_FORMULA_NAMES]; /* of the groom; of the frame */
    int frame_width[HG_FORMULA_NAMES];
} hg_formula_names;
hg_status hg_formula_reads(hg_scalar (*formula)(void), const hg_trace_scope *scope, hg_formula_names *names);
void hg_formula_names_free(hg_formula_names *names);
/* What a formula asks for, to know what to bring: a mask of HG_ALLOW(kind), and the names of its groom attributes (at
 * most 8; each is the caller's, freed with hg_free). */
hg_status hg_formula_inputs(hg_scalar (*formula)(void), const hg_trace_scope *scope, uint32_t *kinds, int *n_attributes,
                            char *attributes[8]);

#endif
