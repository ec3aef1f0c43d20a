/* graph (private to autograd/trace): scalars recorded in topological order, every node once. */
#ifndef HG_TRACE_GRAPH_H
#define HG_TRACE_GRAPH_H

#include "autograd/trace/program.h"

typedef enum {
    HG_NODE_NUMBER,
    HG_NODE_INPUT,
    HG_NODE_DETACH,
    HG_NODE_ADD,
    HG_NODE_SUB,
    HG_NODE_MUL,
    HG_NODE_DIV,
    HG_NODE_NEG,
    HG_NODE_SQRT,
    HG_NODE_RSQRT,
    HG_NODE_ABS,
    HG_NODE_EXP,
    HG_NODE_LOG,
    HG_NODE_SIN,
    HG_NODE_COS,
    HG_NODE_ATAN2,
    HG_NODE_MIN,
    HG_NODE_MAX,
    HG_NODE_LESS,
    HG_NODE_SELECT,
    HG_NODE_OPS
} hg_node_op;

typedef struct {
    uint8_t op;
    uint8_t rate;       /* hg_rate */
    uint8_t depends;    /* HG_DEPENDS_* */
    bool active;        /* a derivative passes through it */
    int8_t first, last; /* range of vertex offsets of the groom inputs below it; first > last: none */
    int32_t a, b, c;    /* arguments, -1: none; all smaller than the node's own number */
    double number;
    hg_input input;
} hg_node;

enum {
    HG_DEPENDS_UNIFORM = 1,
    HG_DEPENDS_GROOM_STRAND = 2,
    HG_DEPENDS_GROOM = 4,
    HG_DEPENDS_STRAND = 8,
    HG_DEPENDS_SITE = 16,
    HG_DEPENDS_ADJOINT = 32 /* after the sites of a strand */
};

/* A value that goes from site to site. */
typedef struct {
    char *name;
    int term, width;
    bool rest;               /* of rest data alone: HG_INPUT_REST_CARRY */
    int first[4], kept[4];   /* nodes, as last traced */
    int first_site_kept[4];  /* what the first site keeps */
    uint8_t carried, kept_n; /* in the trace that is going on */
} hg_graph_carry;

#define HG_GRAPH_ATTRIBUTES 16
#define HG_GRAPH_CARRIES    16
typedef struct {
    hg_node *nodes;
    int n, capacity;
    int32_t *table; /* open addressing: node + 1, 0 is free */
    int table_size;
    bool hoist;   /* false: everything that is not a literal is computed at the site (for tests) */
    uint32_t wrt; /* HG_ALLOW(kind) of the inputs that derivatives are asked for */
    char *attributes[HG_GRAPH_ATTRIBUTES];
    int n_attributes;
    char *frames[HG_GRAPH_ATTRIBUTES]; /* named arrays of the frame */
    int frame_width[HG_GRAPH_ATTRIBUTES];
    int n_frames;
    hg_graph_carry carries[HG_GRAPH_CARRIES];
    int n_carries;
    const hg_given *given; /* inputs that are not where they usually are; the caller's */
    int n_given;
    struct {
        int asked, folded, simplified, shared; /* operations that formulas asked for, and what became of them */
    } count;
    hg_status status;
    char message[320];
} hg_graph;

void hg_graph_init(hg_graph *graph, uint32_t wrt, bool hoist);
void hg_graph_free(hg_graph *graph);
hg_status hg_graph_fail(hg_graph *graph, hg_status status, const char *format, ...)
    HG_PRINTF(3, 4); /* first one wins */
int hg_graph_number(hg_graph *graph, double value);
int hg_graph_input(hg_graph *graph, hg_input input);
int hg_graph_op(hg_graph *graph, hg_node_op op, int a, int b,
                int c);                                /* folded, simplified, shared; -1 after an error */
int hg_graph_shift(hg_graph *graph, int node, int by); /* the same of groom inputs `by` vertices further */
int hg_node_arguments(hg_node_op op);
const char *hg_node_name(hg_node_op op);
double hg_node_evaluate(hg_node_op op, double a, double b, double c);
const char *hg_input_name(hg_input_kind kind);
/* The given input that this is one of; NULL when it is none. */
const hg_given *hg_graph_given(const hg_graph *graph, hg_input input);

/* Traces a formula into the graph; used gets a mask of HG_ALLOW(kind) of what it asked for (may be NULL). A formula that
 * carries values is traced more than once, until it is known which of them depend on rest data alone. */
hg_status hg_graph_trace(hg_graph *graph, hg_scalar (*formula)(void), const hg_trace_scope *scope, int *node,
                         uint32_t *used);
/* Rate of a node being recorded, for vocabulary that chooses the cheaper form. */
hg_rate hg_trace_rate(hg_scalar a);

/* Reverse mode: adjoint[0..graph->n as it was) of the sum over roots of seed * root; -1 where there is none.
 * stop: nodes slower than HG_RATE_SITE keep their adjoint and do not pass it on. */
hg_status hg_graph_reverse(hg_graph *graph, int n_roots, const int *roots, const int *seeds, bool stop, int *adjoint);

#endif
