/* minimise (private): what the methods share. Numbers of a strand are its free ones alone, [strands,n], n = width (V - pinned): of
 * every free vertex x, and where energies ask for orientations those of the edge before it too, times twice its length: all are
 * metres then, and a turn counts as the way of the edge's end.
 *
 *   minimise.c        create, evaluate, results
 *   lbfgs.c           L-BFGS, preconditioned by the Hessian of each strand
 *   solve_adam.c      Adam
 *   strand_hessian.c  the Hessian of a strand along itself, its Cholesky factor, solves
 */
#ifndef HG_SOLVERS_MINIMISE_H
#define HG_SOLVERS_MINIMISE_H

#include "solvers/solvers.h"

enum { HG_MINIMISE_MEMORY = 10, HG_MINIMISE_PARTS = 3 * HG_MINIMISE_MEMORY + 4 };

typedef enum {
    HG_PROBLEM_RUNS,
    HG_PROBLEM_WAITS, /* moves no more, or finds no way down: its Hessian is to be made anew */
    HG_PROBLEM_DONE,
    HG_PROBLEM_STUCK /* at a kink of the energy: no way that was tried leads down */
} hg_problem_state;

/* What is minimised on its own: a strand, or a frame where strands act on each other. */
typedef struct {
    hg_problem_state state;
    bool kick;      /* along a direction of negative curvature */
    bool advanced;  /* since the Hessian was made */
    int kept, next; /* pairs in the history; where the next goes */
    int kicks;
    int32_t iterations;
    int stalls; /* Hessians in a row that brought nothing */
    double first_energy, restart_energy;
    double energy, size; /* J; sum of the absolute terms: what rounding is measured against */
    double slope, step;
    double far, bend; /* of the direction: largest movement [m], largest change of an edge against its length */
    bool accepted;    /* the point is new, and has no direction yet */
    double rho[HG_MINIMISE_MEMORY], alpha[HG_MINIMISE_MEMORY], with_gradient[HG_MINIMISE_MEMORY];
    double product[HG_MINIMISE_MEMORY][HG_MINIMISE_MEMORY]; /* s_i . y_j */
} hg_problem;

struct hg_minimiser {
    hg_ctx *ctx;
    hg_physics *physics;
    hg_minimise_options options;
    int64_t B, S, V, strands, group, problems;
    int64_t n; /* free numbers of a strand */
    int pinned, reach, band, terms;
    int width;                       /* numbers of a vertex: 3, with orientations 7 */
    double *term_energy;             /* [strands,terms] */
    hg_tensor *trial, *gradient;     /* [B,S,V,3] */
    hg_tensor *orientation, *torque; /* [B,S,V-1,4] q that is tried and its gradient; NULL without */
    hg_frame with;                   /* the caller's frame with that q */
    hg_frame_input *inputs;
    double *x, *g, *next_g, *d, *scratch, *r; /* [strands,n] */
    double *slope;                            /* [strands,n] gradient of the last evaluation */
    double *s[HG_MINIMISE_MEMORY], *y[HG_MINIMISE_MEMORY];
    double *edge;             /* [strands,V] length of the edge before a vertex, as it was at the start */
    double *hessian, *factor; /* [strands,n,band + 1], lower */
    uint8_t *definite;        /* [strands] */
    double *part;             /* [strands,HG_MINIMISE_PARTS] */
    hg_problem *problem;
    hg_minimised *result; /* [strands] */
    int64_t evaluations, restarts;
    bool interrupted;
};

/* Where it is tried: energies and gradient, the gradient, or the gradient of strands without each other. */
typedef enum { HG_ENERGY_AND_GRADIENT, HG_GRADIENT_ALONE, HG_STRANDS_ALONE } hg_minimise_wanted;
hg_status hg_minimise_evaluate(hg_minimiser *m, hg_minimise_wanted wanted);
void hg_minimise_place(hg_minimiser *m, const double *x); /* free numbers into what is tried */
void hg_minimise_place_one(hg_minimiser *m, int64_t strand, int64_t vertex, int axis, double value);
double hg_minimise_longest(const hg_minimiser *m,
                           const double *numbers); /* way of a vertex or an edge's end, of a strand */
bool hg_minimise_stopped(const hg_minimiser *m);

/* Of every strand whose problem is not done, at m->x with gradient m->g: central part of the Hessian by differences, and
 * its factor. Overwrites what is tried, and its gradient. */
hg_status hg_strand_hessians(hg_minimiser *m);
void hg_strand_solve(const hg_minimiser *m, int64_t strand, double *numbers); /* in place */

hg_status hg_minimise_lbfgs(hg_minimiser *m);
hg_status hg_minimise_adam(hg_minimiser *m);

#endif
