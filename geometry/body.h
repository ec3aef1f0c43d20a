/* The body tree's own structures, shared by body_tree.c (topology) and body_query.c (frames and queries).
 *
 * The tree is implicit: triangles are put into an order such that 16 in a row are a leaf, 16 leaves in a row a node of
 * level 1, 16 of those a node of level 2 and so on; only the last of each level may be part full. Moving it to a new
 * frame is therefore a sweep over arrays, and a node's children are tested with one vector instruction per operation.
 */
#ifndef HG_GEOMETRY_BODY_H
#define HG_GEOMETRY_BODY_H

#include "geometry/geometry.h"
#include "geometry/vector.h"
#include "tensor/kernel.h"

#include "geometry/body_place.inc"

struct hg_body_tree {
    int64_t n_vertices, n_faces, n_edges;
    int32_t *faces;   /* [F,3] */
    int32_t *order;   /* [F] face at each place of the tree */
    int levels;       /* node levels above the leaves, at least 1 */
    int64_t n_leaves; /* ceil(F / 16) */
    int64_t
        level_start[HG_BODY_LEVELS + 1]; /* first node of level 1.. in the array of nodes; [levels] is their number */
    int32_t *corner_start;               /* [N+1] */
    int32_t *corners;                    /* [3F] face * 3 + corner, by vertex */
    int32_t *face_edges;                 /* [F,3] edge from corner k to corner k + 1 */
    int32_t *edge_start;                 /* [E+1] */
    int32_t *edge_faces;                 /* [3F] faces of each edge: two where the body is closed */
};

#endif
