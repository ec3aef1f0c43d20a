/* A clip being read: what .amc and .bvh readers share. Private to scene/. */
#ifndef HG_SCENE_CLIP_H
#define HG_SCENE_CLIP_H

#include "scene/scene.h"

#include "geometry/vector.h"

#define CLIP_MAX_JOINTS 256
#define CLIP_RADIANS    (3.14159265358979323846 / 180)

/* Length of the CMU skeletons' unit: the files say "length 0.45", meaning that a value / 0.45 is in inches. */
#define CLIP_CMU_METRES (0.0254 / 0.45)

hg_status clip_create(hg_clip **clip, int64_t joints); /* names, parents (-1) and offsets; no frames yet */
hg_status clip_frames(hg_clip *clip, int64_t frames);  /* rotations of identity, translations of zero */
int clip_joint(const hg_clip *clip, const char *name); /* -1 when it has none */

/* A turn by `degrees` about axis 0, 1 or 2. */
static inline hg_quatd clip_turn(int axis, double degrees)
{
    hg_vec3d about = hg_vec3d_make(axis == 0, axis == 1, axis == 2);
    return hg_quatd_from_axis_angle(about, degrees * CLIP_RADIANS);
}

#endif
