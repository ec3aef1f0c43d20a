/* strand (private to autograd/trace and hairloss): all window energies of a physics as ONE pass over the strands.
 *
 * A site is anchored at its LAST vertex i. Body b < bodies-1 runs once, at i = b, with the terms whose window fits there
 * (and, at i = 1, the terms of the root edge); the last body runs for every i >= bodies-1. All terms of a body share
 * their sub-expressions and one reverse pass.
 *
 * By how often it changes, a value is computed once per call (`uniform`), once per groom and strand or site
 * (`groom_strand`, `site`: stored), once per strand (`preamble`), or at the site. The adjoints of strand values are
 * summed over the sites and chained once (`postamble`). */
#ifndef HG_TRACE_STRAND_H
#define HG_TRACE_STRAND_H

#include "autograd/trace/graph.h"
#include "autograd/trace/strand_kernel.h"

/* ---- instructions ------------------------------------------------------------------------------------------- */

typedef enum {
    HG_PLACE_NONE,
    HG_PLACE_REGISTER, /* index: number of the instruction's result */
    HG_PLACE_NUMBER,   /* literal; the same for all lanes */
    HG_PLACE_UNIFORM,  /* once per call; the same for all lanes */
    HG_PLACE_IN,       /* function: input */
    HG_PLACE_OUT,      /* function: output */
    HG_PLACE_X,        /* the arrays of the frame: vertex i + offset, component index */
    HG_PLACE_POSED,
    HG_PLACE_PREDICTED,
    HG_PLACE_PREVIOUS,
    HG_PLACE_CONTACT_POINT,
    HG_PLACE_CONTACT_NORMAL,
    HG_PLACE_ROOT_X0,
    HG_PLACE_ROOT_X1,
    HG_PLACE_ROOT,         /* 0..3 rotation, 4..6 position */
    HG_PLACE_SITE,         /* stored value of vertex i + offset */
    HG_PLACE_GROOM_STRAND, /* stored value of the strand */
    HG_PLACE_STRAND,       /* left by the preamble */
    HG_PLACE_ADJOINT,      /* sums over the sites */
    HG_PLACE_GRADIENT,     /* of vertex i + offset */
    HG_PLACE_GRADIENT0,
    HG_PLACE_GRADIENT1,
    HG_PLACE_ENERGY, /* of term index */
    HG_PLACES
} hg_where;

typedef struct {
    uint8_t place;
    int8_t offset;
    int16_t index;
} hg_operand;

/* op: an hg_node_op, or one of these */
enum { HG_DO_SET = HG_NODE_OPS, HG_DO_ADD_TO, HG_DO_MULADD, HG_DO_MULSUB, HG_DO_SUBMUL, HG_DOS };
typedef struct {
    uint8_t op;
    hg_operand to, a, b, c;
} hg_instruction;

typedef struct {
    hg_instruction *instructions; /* every register is written once */
    int n, capacity, registers;
} hg_code;

typedef struct {
    double *values;
    int n, capacity;
} hg_numbers;

typedef struct {
    int node; /* -1: zero */
    hg_operand to;
    bool add; /* to += node */
} hg_output;

/* Instructions for the outputs, in order. leaf says where a node already is; numbers collects literals. */
hg_status hg_lower(hg_code *list, hg_graph *graph, bool (*leaf)(void *self, int node, hg_operand *operand), void *self,
                   hg_numbers *numbers, int n, const hg_output *outputs);
void hg_code_free(hg_code *list);

/* The same list as the interpreter runs it: registers share slots, operands are displacements, a b + c is one step. */
typedef struct {
    uint16_t op;         /* 4 * op + which operands are the same for all lanes */
    uint8_t to, a, b, c; /* places */
    int32_t to_at, a_at, b_at, c_at;
} hg_step;
typedef struct {
    hg_step *steps;
    int n, slots;
} hg_steps;
/* stride[place]: values per vertex */
hg_status hg_steps_create(hg_steps *steps, const hg_code *list, int lanes, const int *stride);
void hg_steps_free(hg_steps *steps);
void hg_steps_run_f32(const hg_steps *steps, float *const *base);
void hg_steps_run_f64(const hg_steps *steps, double *const *base);
enum { HG_LANES_F32 = 128, HG_LANES_F64 = 64 };

/* A function of nodes that are in a graph already; its inputs are found by itself. */
hg_status hg_function_from_graph(hg_function **function, hg_graph *graph, int n_outputs, const int *nodes);
const hg_input *hg_function_inputs(const hg_function *function, int *n);
uint64_t hg_code_hash(const hg_code *list, uint64_t seed);
uint64_t hg_function_hash(const hg_function *function, uint64_t seed);

/* ---- the strand program ------------------------------------------------------------------------------------- */

#define HG_STRAND_BODIES 8
typedef struct {
    hg_trace_scope scope;
    hg_scalar (*trace)(void);
    hg_scalar (*root)(void); /* NULL: none */
} hg_strand_term;

typedef struct {
    int n_terms, bodies;
    int n_uniform, n_site, n_groom_strand, n_strand, n_adjoint;
    hg_function *uniform, *site, *groom_strand; /* how they are made; NULL when there are none */
    hg_code preamble, body[HG_STRAND_BODIES], postamble;
    hg_numbers numbers;
    uint32_t arrays; /* bit HG_STRAND_*: read by a body */
    uint32_t *used;  /* [n_terms] HG_ALLOW(kind) of what each term asks for */
    char *attributes[HG_GRAPH_ATTRIBUTES];
    int *attribute_term; /* which term asked first */
    int n_attributes;
    uint64_t hash; /* of everything that a kernel depends on */
    /* the interpreter's */
    hg_dtype dtype;
    hg_steps steps[HG_STRAND_BODIES + 2];
    void *number_table;
} hg_strand_program;

hg_status hg_strand_program_create(hg_strand_program **program, hg_dtype dtype, int n_terms,
                                   const hg_strand_term *terms, bool hoist);
void hg_strand_program_destroy(hg_strand_program *program);
int hg_strand_lanes(hg_dtype dtype); /* of the interpreter */
size_t hg_strand_scratch(const hg_strand_program *program, int lanes,
                         int64_t vertices); /* bytes, enough for any kernel */
void hg_strand_interpret(const hg_strand_program *program, const hg_strand_args *args, int64_t first, int64_t last,
                         void *scratch);

/* ---- printed C ---------------------------------------------------------------------------------------------- */

/* A function `name`, an hg_strand_kernel, as C with GCC vector extensions; the file that holds it includes
 * strand_vector.h once, with HG_BYTES (4 or 8) and HG_LANES defined. */
void hg_strand_print_c(const hg_strand_program *program, const char *name, hg_text *text);

#endif
