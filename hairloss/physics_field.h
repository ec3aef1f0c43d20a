/* physics_field (private): the pass over a field, and what its two halves know of each other: the host's (physics_field.c) and
 * that of another device (physics_field_device.c). */
#ifndef HG_HAIRLOSS_PHYSICS_FIELD_H
#define HG_HAIRLOSS_PHYSICS_FIELD_H

#include "hairloss/physics_pass.h"

/* The pairs that were found in a layer of cells, by owner, in pieces that are kept from call to call; 8 bytes a pair in
 * f32. */
enum { PIECE_PAIRS = 8192, PIECE_OWNERS = 1024 };
typedef struct field_piece {
    struct field_piece *next;
    int n_owners, n;
    int32_t owner[PIECE_OWNERS], count[PIECE_OWNERS], place[PIECE_PAIRS];
    double value[]; /* [PIECE_PAIRS] W'/r in the precision of the pass */
} field_piece;
typedef struct {
    field_piece *first, *last; /* in use up to `last`, NULL: none */
    bool failed;
} field_slab;

typedef struct {
    hg_pass pass;
    hg_function *kernel, *kernel_slope, *kernel_full; /* W; W with W'; W with its slope in every param */
    hg_function *function, *full;                     /* f with f'; f with its slope in every input */
    hg_pass_inputs kernel_inputs, inputs;
    int kernel_distance, field, field_rest; /* numbers of inputs */
    int reach;                              /* the param that is half the support */
    double radius;                          /* the support of this call */
    uint32_t kernel_params;                 /* bit of each param that the kernel asks for */
    bool weighs;                            /* kernel_mass: kg */
    hg_cells cells;
    void *rest_now;                                             /* [G,n] of this call, made when first needed */
    bool *rest_made;                                            /* [G] */
    void *sums, *slope, *rest_slope, *slope_place, *mass_place; /* [n] of the frame at work */
    field_slab *slabs;                                          /* [slabs_room] */
    int64_t slabs_room;
    bool kept;           /* the slabs hold the pairs of the cells */
    double *theta_place; /* [n] what a place leaves for the derivative of a param of the kernel */
    struct {             /* numbers of the kernels of another device */
        int place, sum, energy, energy_full, gradient, params, masses;
    } on_device;
} field_pass;

/* Is the rest field made of what this call brings? */
bool hg_field_rest_follows(const field_pass *pass);

/* The kernels of another device than the host; a call there. */
hg_status hg_field_device_make(field_pass *pass);
hg_status hg_field_device_run(field_pass *pass, hg_ctx *ctx, const hg_pass_call *call);

#endif
