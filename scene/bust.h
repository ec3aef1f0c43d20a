/* The procedural bust as an implicit surface, and its mesh. Private to scene/. */
#ifndef HG_SCENE_BUST_H
#define HG_SCENE_BUST_H

#include "scene/internal.h"

typedef struct {
    double head, neck, torso; /* distances to the parts, about metres, negative inside */
    double all;               /* to their smooth union */
} bust_distance;

bust_distance bust_measure(hg_vec3d p);
hg_vec3d bust_normal(hg_vec3d p); /* outwards, unit */

/* A closed manifold of triangles of about `cell` metres, counter-clockwise seen from outside. Free with hg_free. */
hg_status bust_mesh(double cell, int64_t *vertices, float **points, int64_t *faces, int32_t **triangles);

#endif
