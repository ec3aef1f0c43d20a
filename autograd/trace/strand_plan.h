/* strand_plan (private to autograd/trace): the window energies of a physics as one graph, with what every list of the
 * program has to leave behind. */
#ifndef HG_TRACE_STRAND_PLAN_H
#define HG_TRACE_STRAND_PLAN_H

#include "autograd/trace/strand.h"

typedef struct {
    hg_strand_program *program;
    const hg_strand_term *terms;
    hg_graph graph;
    int *energy, *first_energy, *root; /* nodes of the terms; first_energy: at the first site; -1: no root term */
    bool *carries;                     /* does the term carry more than rest data */
    int carry_at[HG_GRAPH_CARRIES];    /* first component of each carried value; -1: rest data */
    int *adjoint[HG_STRAND_BODIES];    /* of the nodes that were traced, per body */
    int traced;
    int *stored, *groom_strand, *strand, *uniform; /* nodes that get a place */
    int *frontier;                                 /* strand nodes whose adjoints are summed */
    int *chained;                                  /* adjoints of the nodes before the sites, made by the postamble */
    int *index;                                    /* place of a node in its table; -1: none */
    int part;                                      /* list being lowered: a body, or one of these */
} hg_strand_plan;
enum { HG_PLAN_PREAMBLE = HG_STRAND_BODIES, HG_PLAN_POSTAMBLE };

/* Traces and differentiates; finds what is read and where the tiles are. The program's tables are filled, its lists not. */
hg_status hg_strand_plan_make(hg_strand_plan *plan);
void hg_strand_plan_free(hg_strand_plan *plan);

static inline hg_rate hg_plan_rate(const hg_strand_plan *plan, int node)
{
    return (hg_rate)plan->graph.nodes[node].rate;
}

/* The number of the array or strand input that an input is; -1: none. */
int hg_plan_find(const hg_strand_input *sources, int n, hg_input in);

/* What the lists leave behind; how many there are. */
int hg_plan_body(const hg_strand_plan *plan, int body, hg_output *outputs);
int hg_plan_forward(const hg_strand_plan *plan, int body, hg_output *outputs);
int hg_plan_postamble(const hg_strand_plan *plan, hg_output *outputs);

#endif
