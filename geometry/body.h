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

#define HG_BODY_LANES  16
#define HG_BODY_LEVELS 8    /* 16^8 leaves: more than an int32_t counts */
#define HG_BODY_TIE    1e-6 /* m: triangles this much farther than the closest tie with it */

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

/* The place on a triangle that is closest to a point. */
typedef enum { HG_ON_FACE, HG_ON_EDGE, HG_ON_VERTEX } hg_body_feature;
typedef struct {
    hg_vec3d point;
    double distance2;
    hg_body_feature feature;
    int corner; /* edge: from this corner to the next; vertex: this corner */
} hg_body_place;

/* The best of the three edges and, where the point lies above it, the face. Degenerate triangles are their edges. */
hg_body_place hg_body_place_on_triangle(hg_vec3d p, hg_vec3d a, hg_vec3d b, hg_vec3d c);

/* Contact plane of a place: see hg_contact_mode. `normal` is the triangle's own (zero when degenerate), `outward` the
 * angle-weighted normal of the place, of any length; places nearer than `near` take its direction. */
hg_vec3d hg_body_contact_normal(hg_contact_mode mode, const hg_body_place *place, hg_vec3d p, hg_vec3d normal,
                                hg_vec3d outward, double near);

/* Corner angle from its cosine, to 2e-8 (Abramowitz and Stegun 4.4.46): a weight, and quicker than acos. */
static inline double hg_body_angle(double cosine)
{
    double x = cosine < 0.0 ? -cosine : cosine;
    if (!(x < 1.0)) x = 1.0;
    double p = -0.0012624911;
    p = p * x + 0.0066700901;
    p = p * x - 0.0170881256;
    p = p * x + 0.0308918810;
    p = p * x - 0.0501743046;
    p = p * x + 0.0889789874;
    p = p * x - 0.2145988016;
    p = p * x + 1.5707963050;
    double angle = sqrt(1.0 - x) * p;
    return cosine < 0.0 ? 3.14159265358979323846 - angle : angle;
}

#endif
