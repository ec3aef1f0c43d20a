/* physics_hoist (private): what the kernels of a strand program read that is computed once per groom, in f64 and on the
 * processor, and rounded once. */
#ifndef HG_HAIRLOSS_PHYSICS_HOIST_H
#define HG_HAIRLOSS_PHYSICS_HOIST_H

#include "autograd/trace/strand.h"
#include "hairloss/hairloss.h"

/* Where n values of `rows` vertices (of one, for those of a strand) lie. */
typedef enum {
    HG_HOIST_TILES, /* [G,tiles,rows,n,lanes]; lanes that no strand has repeat the last one */
    HG_HOIST_LANES, /* [G*S/32,rows,n,32]: strands of all grooms in a row */
    HG_HOIST_ROWS   /* [G,S,n,rows] */
} hg_hoist_layout;

typedef struct {
    void *site, *groom_strand;             /* of the host, to be freed; NULL: the program has none */
    size_t site_count, groom_strand_count; /* numbers */
} hg_hoisted;

hg_status hg_hoist(hg_hoisted *hoisted, hg_ctx *ctx, const hg_strand_program *program, const hg_groom_data *data,
                   hg_hoist_layout layout, int lanes);

#endif
