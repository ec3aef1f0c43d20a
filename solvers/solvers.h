/* solvers: the same energies used directly, without a network: how a hair hangs, from what it is made of; and what it is made
 * of, from how it hangs.
 *
 *     hg_minimiser_create(&minimiser, ctx, physics, frames, strands, vertices, &(hg_minimise_options){ .pinned = 2 });
 *     hg_minimise(minimiser, &frame, x, &solution);            x: the posed strands before, the minimum after
 *     bool there = solution.converged == solution.strands;     else how far it is: solution.force, solution.movement
 *     hg_minimiser_destroy(minimiser);
 *
 *     const char *const names[] = { "bend_twist.stiffness" };
 *     hg_fit_material(ctx, terms, n_terms, &groom_data, &frame, x, &(hg_material_options){ .n = 1, .names = names }, &fit);
 *     double stiffness = fit.param[0].value;                  [N m^2], and fit.param[0].error is a deviation of it
 *     hg_material_fit_free(&fit);
 *
 * A hair at rest (or one that moves, with `predicted` and dt) is in balance: the forces of all energies sum to zero at every
 * free vertex. In the forces the stiffnesses stand linearly, so those that balance an observed drape best are found by
 * least squares, without running a simulation: no start value, no local minimum.
 */
#ifndef HG_SOLVERS_H
#define HG_SOLVERS_H

#include "hairloss/hairloss.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- minima of an energy over the vertices --------------------------------------------------------------------- */

typedef enum { HG_LBFGS, HG_ADAM, HG_XPBD /* of hg_hair_solve alone: hg_xpbd below, hg_minimiser refuses it */ } hg_minimise_method;

/* Zero stands for the default. */
typedef struct {
    hg_minimise_method method;
    int pinned;                          /* first vertices of a strand that stay where x has them; 0: 1 */
    int64_t evaluations;                 /* at most so many of the energy, for all strands together; 0: 6000 (Adam: 2000) */
    double movement;                     /* m: a minimum is where a full Newton step is shorter; 0: 1e-8 */
    double enough;                       /* L-BFGS: leave what new Hessians bring less than this part of its descent; 0: 1e-8, two in a row, eight of a frame */
    double rate;                         /* Adam: a first step [m], which comes down to 0 as a cosine; 0: 2e-5 */
    bool (*stop)(void *); void *stop_self; /* asked once an iteration; true: what was reached is left in x, and interrupted is set */
} hg_minimise_options;

/* One strand; where strands act on each other, its iterations are those of its frame, and so is what new Hessians brought. */
typedef struct {
    double before, after;                /* J, weighted: sum of its terms at the start and at the end */
    double force;                        /* N: largest on a free vertex, or of the turning of an edge at its end */
    double movement;                     /* m: longest way of a vertex, or of an edge's end that turns, in a full Newton step from here */
    int32_t iterations;
    bool converged;                      /* movement is below the limit, and the Hessian along the strand is positive definite */
    bool stalled;                        /* L-BFGS: not so, but new Hessians, two in a row (eight for a frame), brought less than 1e-8 of the descent: it lies in a kink of the energy,
                                            such as an edge of the body's mesh, where a Newton step says nothing */
} hg_minimised;

typedef struct {
    int64_t strands, converged, stalled; /* of all frames */
    int64_t evaluations, restarts;       /* restarts: how often the Hessians were made */
    double before, after;                /* J: sums over the strands */
    double force, movement;              /* largest of all strands */
    bool interrupted;
    const hg_minimised *strand;          /* [B,S], the minimiser's: good until its next call */
} hg_solution;

/* Minimises a physics over the free vertices of B frames of S strands, and the orientations of their edges where energies know them. L-BFGS (Nocedal and Wright 2006) whose inverse Hessian starts
 * from that of each strand along itself, found by differences of the gradient, so that it knows every energy, also a user's own.
 * Where only energies of single strands act, each strand has its own history, step and end, and all advance together; with
 * pairs or neighbour sums a frame is one problem. It is made anew until nothing moves. Contact is searched in every evaluation.
 *
 * ctx is of the host (hg_ctx_on_host) and physics f64: forces of a hair are differences that f32 does not hold. Both live as long as
 * the minimiser. Same bits for any number of threads; nothing is allocated after create. */
typedef struct hg_minimiser hg_minimiser;
hg_status hg_minimiser_create(hg_minimiser **minimiser, hg_ctx *ctx, hg_physics *physics, int64_t frames, int64_t strands, int64_t vertices, const hg_minimise_options *options);
void      hg_minimiser_destroy(hg_minimiser *minimiser);         /* NULL is fine */
/* x [B,S,V,3] f64: the start, then the minimum; frame as for hg_physics_evaluate. Where energies ask for orientations, q of
 * frame->inputs (f64 [B,S,V-1,4]) is an unknown like x: the start, then those of the minimum; edges whose two vertices are held keep
 * theirs. HG_NUMERIC where the start is not finite or has no
 * finite energy; x is untouched then. Not to converge is no error: the solution says so. */
hg_status hg_minimise(hg_minimiser *minimiser, const hg_frame *frame, hg_tensor *x, hg_solution *solution);

/* ---- position-based dynamics -------------------------------------------------------------------------------------- */

/* Zero stands for the default. */
typedef struct {
    int pinned;                          /* first vertices of a strand that go where the posed groom has them; 0: 1 */
    int substeps, iterations;            /* of a step, and in each; 0: 20 and 10 of sweeps, else 20 (to rest: 1) and 1 */
    double dt;                           /* s, of a step; 0: the frame's, or 1/30 */
    bool sweeps;                         /* Gauss-Seidel along the strand, as published; else the constraints of a strand are solved for together */
    int64_t steps;                       /* to rest: at most so many; 0: 200 */
    double movement;                     /* m: at rest is what moves less in a step; 0: 1e-6 */
    double strand_distance;              /* m: that vertices of different strands keep, unless they are closer at rest; 0: strands do not feel each other */
    bool (*stop)(void *); void *stop_self; /* asked once a step; true: what was reached is left in x, and interrupted is set */
} hg_xpbd_options;

typedef struct {
    int64_t strands, at_rest;            /* at_rest: that moved less than the limit in the last step */
    int64_t steps;
    double movement;                     /* m: longest way of a vertex in the last step */
    bool interrupted;
    const double *orientation;           /* [S,V-1,4] of the edges: their z axis is the edge's direction; the solver's, good until its next call */
} hg_xpbd_solution;

/* Extended position-based dynamics of Cosserat rods: positions of vertices and orientations of edges, a Gauss-Seidel sweep along every
 * strand. Constraints and compliances come from the energies, so that what is at rest is their minimum but for what
 * solvers/xpbd.c says; those that it has no constraint for are left out (hg_xpbd_left_out). Rest data are those of the first groom.
 * One frame of S strands, f64, on a context of the processor; same bits for any number of threads; nothing is allocated after the first
 * call, but for strand_distance where strands come closer than ever before.
 *
 *     hg_xpbd_create(&xpbd, ctx, terms, n_terms, &groom_data, &(hg_xpbd_options){ .pinned = 2 });
 *     hg_xpbd_rest(xpbd, &frame, x, &solution);        x: the posed strands before, at rest after
 *     hg_xpbd_step(xpbd, &next_frame, x, &solution);   moves on by dt: roots and body go from where they were to where the frame has them
 *     hg_xpbd_destroy(xpbd); */
typedef struct hg_xpbd hg_xpbd;
hg_status hg_xpbd_create(hg_xpbd **xpbd, hg_ctx *ctx, const hg_term *terms, int n_terms, const hg_groom_data *data, const hg_xpbd_options *options);
void      hg_xpbd_destroy(hg_xpbd *xpbd);                        /* NULL is fine */
const char *hg_xpbd_left_out(const hg_xpbd *xpbd);               /* "adhesion, self_collision"; "": none */
/* x [1,S,V,3] f64; frame as for hg_physics_evaluate: root_rotation, root_position or posed, body_vertices where there is contact.
 * HG_NUMERIC where x is not finite, or what it comes to: x is untouched then. */
hg_status hg_xpbd_place(hg_xpbd *xpbd, const hg_frame *frame, const hg_tensor *x); /* there, without velocity */
hg_status hg_xpbd_rest(hg_xpbd *xpbd, const hg_frame *frame, hg_tensor *x, hg_xpbd_solution *solution); /* the same, then steps without velocity until nothing moves */
hg_status hg_xpbd_step(hg_xpbd *xpbd, const hg_frame *frame, hg_tensor *x, hg_xpbd_solution *solution); /* dynamic, from the call before; x gets where it is now */

/* ---- stiffnesses of a drape ------------------------------------------------------------------------------------ */

#define HG_FIT_PARAMS 8

typedef enum {
    HG_TENSION_AUTO,     /* unknown, unless a parameter of `stretch` is asked for */
    HG_TENSION_KNOWN,    /* the force along an edge is what the energies say */
    HG_TENSION_UNKNOWN   /* it is whatever balances best: for hair that does not stretch, and for positions that are not exact to a ten-thousandth of an edge */
} hg_tension;

typedef struct {
    int n; const char *const *names;     /* "ENERGY.PARAMETER": energies that are proportional to it */
    int pinned;                          /* first vertices of a strand that are held; 0: 1, or 2 where an energy has `root: clamped` */
    hg_tension tension;
    bool per_strand;                     /* a value for each strand too */
    const uint8_t *left_out;             /* [B,S,V] vertices whose balance is not looked at; NULL: none. Touching the body is found here */
} hg_material_options;

typedef struct { const char *name, *unit; double value, error /* a deviation */; } hg_fitted;
typedef struct {
    int n; hg_fitted param[HG_FIT_PARAMS];
    double unbalanced;                   /* of the known forces, the part that is left: 0 is a perfect balance, 1 none */
    int64_t vertices, left_out;          /* free vertices looked at; those that touch the body, or were left out */
    int64_t n_strands; double *strands;  /* [n,S], NAN where a strand says nothing; NULL without per_strand */
} hg_material_fit;

/* terms: all the energies that act; weights multiply, and the values of the parameters asked for do not matter. x [B,S,V,3]
 * f64, as everything in the frame. Vertices that touch the body are left out (what pushes them is not known well), and ones
 * that are far off balance count less (Huber 1964). HG_NUMERIC where the drape says nothing of a parameter. */
hg_status hg_fit_material(hg_ctx *ctx, const hg_term *terms, int n_terms, const hg_groom_data *data, const hg_frame *frame, hg_tensor *x, const hg_material_options *options, hg_material_fit *fit);
void      hg_material_fit_free(hg_material_fit *fit);

#ifdef __cplusplus
}
#endif
#endif
