/* Points spread evenly over a scalp. Private to scene/. */
#ifndef HG_SCENE_ROOTS_H
#define HG_SCENE_ROOTS_H

#include "scene/internal.h"

/* The first k of them are spread evenly too, whatever k: prefixes serve as centres of locks. Each array is [n,...]. */
hg_status scene_scatter_roots(const hg_body *body, int64_t n, uint64_t seed, int32_t *face, float *bary,
                              float *position);

#endif
