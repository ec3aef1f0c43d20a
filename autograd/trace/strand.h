/* strand (private to autograd/trace and hairloss): all window energies of a physics as ONE pass over the strands.
 *
 * A site is anchored at its LAST vertex i. Body b < bodies-1 runs once, at i = b, with the terms whose window fits there
 * (and, at i = 1, the terms of the root edge); the last body runs for every i >= bodies-1. All terms of a body share
 * their sub-expressions and one reverse pass.
 *
 * By how often it changes, a value is computed once per call (`uniform`), once per groom and strand or site
 * (`groom_strand`, `site`: stored), once per strand (`preamble`), or at the site. The adjoints of strand values are
 * summed over the sites and chained once (`postamble`).
 *
 * A formula that carries values has its first site in a body of its own, where what is carried is known. The forward lists
 * make the carried values from root to tip; then the bodies run from tip to root, each with the adjoint of what it kept.
 * Rest data that is carried is made once per groom (`rest_first`, `rest_kept`) and is a rest value like any other. */
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
    HG_PLACE_ROOT_X0,  /* vertices 0 and 1 of x, and of rest where it is an array */
    HG_PLACE_ROOT_X1,
    HG_PLACE_ROOT_REST0,
    HG_PLACE_ROOT_REST1,
    HG_PLACE_STRAND_INPUT, /* 0..3 rotation, 4..6 position, then what the call gives */
    HG_PLACE_STRAND_INPUT_GRADIENT,
    HG_PLACE_SITE,         /* stored value of vertex i + offset */
    HG_PLACE_GROOM_STRAND, /* stored value of the strand */
    HG_PLACE_STRAND,       /* left by the preamble */
    HG_PLACE_ADJOINT,      /* sums over the sites */
    HG_PLACE_GRADIENT_X0,  /* of what ROOT_X0 .. ROOT_REST1 read */
    HG_PLACE_GRADIENT_X1,
    HG_PLACE_GRADIENT_REST0,
    HG_PLACE_GRADIENT_REST1,
    HG_PLACE_ENERGY,        /* of term index */
    HG_PLACE_CARRY,         /* offset 0: what comes into the site; 1: what it keeps */
    HG_PLACE_CARRY_ADJOINT, /* of the same */
    HG_PLACE_ARRAY,         /* array k: vertex i + offset, component index */
    HG_PLACE_ARRAY_GRADIENT = HG_PLACE_ARRAY + HG_STRAND_ARRAYS,
    HG_PLACES = HG_PLACE_ARRAY_GRADIENT + HG_STRAND_ARRAYS
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
const hg_code *hg_function_code(const hg_function *function, const hg_numbers **numbers);
uint64_t hg_code_hash(const hg_code *list, uint64_t seed);
uint64_t hg_function_hash(const hg_function *function, uint64_t seed);

/* ---- the strand program ------------------------------------------------------------------------------------- */

#define HG_STRAND_BODIES 8
typedef struct {
    hg_trace_scope scope;
    hg_scalar (*trace)(void);
    hg_scalar (*root)(void); /* NULL: none */
} hg_strand_term;

/* Where a tile's array begins in the scratch: rows V + extra vectors. */
typedef struct {
    int rows, extra;
} hg_strand_tile;

/* Something that a kernel reads, by vertex or by strand. */
typedef struct {
    hg_input_kind kind;
    int name, term; /* ATTRIBUTE, FRAME: number of the name; PARAM: number of the param, and whose */
    int width;
    int first;   /* strand input: number of its first component */
    int missing; /* array: rows that it has fewer than vertices (q: 1) */
    bool rest;   /* array: [G,S,V,width], not [B,S,V,width] */
    bool gradient;
    hg_strand_tile tile, gradient_tile; /* array */
} hg_strand_input;

typedef struct {
    int n_terms, bodies;
    int n_uniform, n_site, n_groom_strand, n_strand, n_adjoint;
    hg_function *uniform, *site, *groom_strand; /* how they are made; NULL when there are none */
    hg_code preamble, body[HG_STRAND_BODIES], postamble;
    hg_code forward[HG_STRAND_BODIES]; /* what the site keeps, n_carry > 0 */
    hg_numbers numbers;
    hg_strand_input arrays[HG_STRAND_ARRAYS], inputs[HG_STRAND_INPUTS]; /* inputs: rotation and position first */
    int n_arrays, n_inputs, input_width;                                /* input_width: components of all inputs */
    int n_carry;                                                        /* components; rows 0 .. V of the tiles */
    hg_strand_tile carry_tile, carry_adjoint_tile, tiles;               /* tiles: the size of all */
    /* carried rest data: n_rest_carry components; values at the vertex where its energy's first site ends, and on */
    hg_function *rest_first, *rest_kept;
    int n_rest_carry, n_rest_carries;
    struct {
        int at, width, start;
    } rest_carries[HG_GRAPH_CARRIES];
    uint32_t *used; /* [n_terms] HG_ALLOW(kind) of what each term asks for */
    char *attributes[HG_GRAPH_ATTRIBUTES], *frames[HG_GRAPH_ATTRIBUTES];
    int *attribute_term, *frame_term; /* which term asked first */
    int n_attributes, n_frames;
    uint64_t hash; /* of everything that a kernel depends on */
    /* the interpreter's */
    hg_dtype dtype;
    hg_steps steps[HG_STRAND_BODIES + 2], forward_steps[HG_STRAND_BODIES];
    void *number_table;
} hg_strand_program;

/* given: inputs that the call brings, or that a gradient is wanted of. x always has one. */
hg_status hg_strand_program_create(hg_strand_program **program, hg_dtype dtype, int n_terms,
                                   const hg_strand_term *terms, int n_given, const hg_given *given, bool hoist);
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
/* Parts of it: the statements of a list over hg_v; the name of array k, or of its gradient; does a list use a place? warp: stored
 * values are [n_site,V], and the second vertex's gradient has a name of its own. */
void hg_strand_print_list(const hg_strand_program *program, const hg_code *code, bool warp, const char *indent,
                          hg_text *text);
void hg_strand_array_name(const hg_strand_program *program, int k, bool gradient, char name[40]);
bool hg_strand_list_touches(const hg_code *code, int place);

/* ---- printed CUDA ------------------------------------------------------------------------------------------- */

/* A kernel `name` of hg_strand_args as CUDA C++: the text of an hg_kernel; only one kernel in a text. A strand has a warp, a
 * block HG_STRAND_CUDA_THREADS / 32 of them or fewer: n strands are launched, `indices` of them for each block, with the shared
 * memory of as many; energy is [blocks,terms]. site: [G,S,n_site,V].
 * Where values are carried a strand has a thread, of any number n that is launched (args.count strands, in rounds), whole warps
 * of them with scratch; energy is [B,S,terms]. site: [G*S/32,V,n_site,32], strands of all grooms in a row. */
enum { HG_STRAND_CUDA_THREADS = 256 };
void hg_strand_print_cuda(const hg_strand_program *program, const char *name, hg_text *text);
/* Bytes of shared memory that a strand needs, and of scratch. */
size_t hg_strand_cuda_shared(const hg_strand_program *program, int64_t vertices);
size_t hg_strand_cuda_scratch(const hg_strand_program *program, int64_t vertices);

#endif
