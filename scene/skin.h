/* What every reader of a body does last: influences, order of joints, scalp, collider. Private to scene/. */
#ifndef HG_SCENE_SKIN_H
#define HG_SCENE_SKIN_H

#include "scene/internal.h"

/* Adds to the influences of a vertex; when all places are taken, the smallest gives way. */
void skin_add(int32_t *joints, float *weights, int joint, float weight);
/* Weights of every vertex to the sum 1; a vertex without any is an error that gives its number (number NULL: its own). */
hg_status skin_normalise(const char *path, hg_body *body, const int32_t *number);
/* Memory for the parts that a body always has, of its vertices, faces and joints. Names stay empty. */
hg_status skin_allocate(hg_body *body);
/* Names for the shapes that have none: `first`_0...; those from `used` on are zero and called "none". */
hg_status skin_name_shapes(hg_body *body, const char *first, int used, double spread);

/* Faces wholly above the chest that can be seen from outside; without such a joint, all that can be seen. */
hg_status skin_find_collider(const char *path, hg_body *body);
/* `how` NULL: the faces of the head within 116 degrees of an axis that leans back by 35 degrees, seen from its middle,
 * but for the ears, if they can be seen from outside. A length, "9 cm": faces nearer than that to the top of the head.
 * Else a file of face numbers: text, or .npy, .npz. Sets scalp_axis, scalp_centre and the UVs there. */
hg_status skin_find_scalp(const char *path, hg_body *body, const char *how, hg_text *notes);
/* Unit and axes of the person asking; z_up where nothing was said. */
hg_status skin_axes(const hg_import *with, bool z_up, scene_axes *axes);

#endif
