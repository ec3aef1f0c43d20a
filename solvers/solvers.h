/* solvers: the same energies used directly, without a network. Today: what a hair is made of, from how it hangs.
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
