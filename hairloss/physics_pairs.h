/* physics_pairs (private): the pass over pairs, and what its two halves know of each other: the host's (physics_pairs.c) and that
 * of another device (physics_pairs_device.c). */
#ifndef HG_HAIRLOSS_PHYSICS_PAIRS_H
#define HG_HAIRLOSS_PHYSICS_PAIRS_H

#include "hairloss/physics_pass.h"

typedef struct {
    hg_pass pass;
    hg_function *function, *full; /* value and slope in the distance; the same and the slope in every other input */
    hg_pass_inputs inputs;
    int distance, rest_distance;  /* numbers of inputs */
    int slope_of[HG_PASS_INPUTS]; /* output of `full`; -1: none */
    hg_pairs **pairs;             /* [G] */
    bool own_pairs;
    int radius, count; /* the params that make the list, -1: none */
    double radius_now, count_now;
    int64_t most_pairs;
    void **rest_distances;        /* [G] [M], of the groom's own rest */
    void *energies, *forces;      /* [M], [M,3] on the first of a pair, of the frame at work */
    void *rest_forces;            /* [M,3] the same of rest; made when first asked for */
    void *slopes[HG_PASS_INPUTS]; /* [M] derivatives in the inputs; made when first asked for */
    struct {                      /* on another device: the lists of all grooms, numbers of the kernels */
        hg_tensor *first, *pairs, *start, *incident, *rest_distances;
        int energy, energy_full;
    } on_device;
} pairs_pass;

/* Is the derivative of input i asked for? */
bool hg_pairs_wanted(const pairs_pass *pass, int i);

/* Of another device than the host: the kernels, the lists, a call. */
hg_status hg_pairs_device_make(pairs_pass *pass);
hg_status hg_pairs_device_lists(pairs_pass *pass);
void hg_pairs_device_free(pairs_pass *pass);
hg_status hg_pairs_device_run(pairs_pass *pass, hg_ctx *ctx, const hg_pass_call *call);

#endif
