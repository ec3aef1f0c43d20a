/* Points spread evenly over a scalp. Private to scene/. */
#ifndef HG_SCENE_ROOTS_H
#define HG_SCENE_ROOTS_H

#include "scene/internal.h"

/* The first k of them are spread evenly too, whatever k: prefixes serve as centres of locks. Each array is [n,...]. */
hg_status scene_scatter_roots(const hg_body *body, int64_t n, uint64_t seed, int32_t *face, float *bary,
                              float *position);

/* For every point the nearest of the first `centres` ones. */
void scene_nearest_root(int64_t n, const float *position, int64_t centres, int32_t *centre);

#endif
