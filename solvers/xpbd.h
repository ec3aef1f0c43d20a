/* xpbd (private): a tile of strands, and what the parts share.
 *
 *   xpbd.c           energies into constraints, create, calls
 *   xpbd_strand.c    substeps of a tile: prediction, sweeps, velocities
 *   xpbd_contact.c   the body, and strands with each other
 *
 * A tile is HG_XPBD_LANES strands that go through the same operations, one in each lane of a vector. */
#ifndef HG_SOLVERS_XPBD_H
#define HG_SOLVERS_XPBD_H

#include "solvers/solvers.h"

enum { HG_XPBD_LANES = 8, HG_XPBD_BLOCK = 6 /* numbers of an edge and its end */ };
typedef double hg_lanes __attribute__((vector_size(HG_XPBD_LANES * sizeof(double))));

/* Rows of a tile; a row is one number of every strand. E = V - 1 edges. */
typedef struct {
    hg_lanes *x, *before, *velocity; /* [V,3] */
    hg_lanes *pin, *pin_to;          /* [V,3] where pinned vertices were before a step, and will be after it */
    hg_lanes *weight;                /* [V] 1/kg, 0 where pinned */
    hg_lanes *q, *q_before, *q_velocity, *q_pin, *q_pin_to; /* [E,4] */
    hg_lanes *root, *root_pin, *root_pin_to;                /* [4] frame of the first edge in the posed groom */
    hg_lanes *q_weight;                                     /* [E] 1/(4 I), 0 where both ends are pinned */
    hg_lanes *shear, *over_length;                          /* [E] stiffness [J], 1/l0 */
    hg_lanes *bend, *rest;     /* [E], [E,4] stiffness [J] and rotation at rest of the pair (i - 1, i); 0: (root, 0) */
    hg_lanes *style, *posed;   /* [V] N/m, [V,3] */
    hg_lanes *normal, *offset; /* [V,3], [V] contact plane n.x = offset */
    hg_lanes *clearance;       /* [V] D */
    hg_lanes *shear_force, *bend_force, *style_force, *contact_force; /* multipliers [E,3], [E,4], [V,3], [V] */
    hg_lanes *from, *q_from;                                          /* where an iteration began */
    hg_lanes *aim, *q_aim;                                            /* [V,3], [E,4] what was predicted */
    hg_lanes *start;                                                  /* [V,3] where a step began */
    hg_lanes *good_x, *good_q, *good_normal,
        *good_offset;        /* to rest: the place of least energy so far, and its contact */
    hg_lanes *pace, *energy; /* [1] to rest: of h^2; J there */
    hg_lanes *moved;         /* [1] longest way of a vertex in a step, squared */
} hg_xpbd_tile;

struct hg_xpbd {
    hg_ctx *ctx;
    hg_xpbd_options options;
    int64_t S, V, E, tiles;
    int pinned;
    double gravity[3], drag;
    double twist; /* stiffness about the edge, against that across it */
    bool smooth, contact, rest_clearance, placed, styled;
    double contact_stiffness, contact_distance;
    hg_contact_mode mode;
    char left_out[256];
    int64_t rows;               /* of a tile */
    hg_lanes *memory, *scratch; /* scratch: of every thread */
    double *rest, *rest_frame;  /* [S,V,3]; [S,E,4] orientations at rest */
    double *points;             /* [S,V,3] the strands, for searches and results */
    double *orientation;        /* [S,E,4] */
    double *moved;              /* [S] */

    const hg_body_tree *tree;
    hg_body_refit *refit;
    double *body, *body_from, *body_to, *contact_point, *contact_normal;
    double body_way; /* m: longest of a vertex of the body in a step */
    bool fitted;     /* refit is of body_to, which does not move */
    bool known;      /* every vertex was searched for since it was placed */
    int32_t *triangle;
    double *room;     /* [S,V] m: that a vertex can still go without coming into contact */
    double *searched; /* [S,V,3] where a vertex was when its contact was looked at */
    int64_t asked;    /* those that are searched: */
    int32_t *ask, *ask_triangle;
    double *ask_point, *ask_contact, *ask_normal;

    hg_neighbours *neighbours;
    double *push; /* [S,V,3] */
};

void hg_xpbd_tile_at(const hg_xpbd *s, int64_t tile, hg_xpbd_tile *rows);
static inline int64_t hg_xpbd_strand(const hg_xpbd *s, int64_t tile,
                                     int lane) /* the last tile repeats its last strand */
{
    const int64_t i = tile * HG_XPBD_LANES + lane;
    return i < s->S ? i : s->S - 1;
}

/* Substeps first .. last - 1 of a step of `substeps` for every tile; h seconds each. dynamic: velocities are kept. Of hair that
 * comes to rest the last one is judged by the next run, which may have none of its own (first == last). */
typedef struct {
    const hg_xpbd *solver;
    int first, last, substeps;
    double h;
    bool dynamic;
} hg_xpbd_run;
hg_status hg_xpbd_run_tiles(const hg_xpbd_run *run);

/* Contact planes where the strands are now, the body having gone `part` of its way; both in s->points. */
hg_status hg_xpbd_find_contact(hg_xpbd *s, double part, double way /* of the body since the last search */);
hg_status hg_xpbd_part_strands(hg_xpbd *s); /* pushes apart what is too close */

#endif
