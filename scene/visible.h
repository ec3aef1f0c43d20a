/* Which triangles can be seen from outside. Private to scene/. */
#ifndef HG_SCENE_VISIBLE_H
#define HG_SCENE_VISIBLE_H

#include "base/base.h"

/* Looks at the faces of `asked` (ascending) from many directions, with all faces in the way, and keeps those that are
 * seen, or share a vertex with one that is: the inside of a mouth or of an eye socket is left out. `asked` is
 * overwritten with the kept ones, *count with their number. */
hg_status scene_visible_faces(const char *path, int64_t n_vertices, const float *vertices, int64_t n_faces,
                              const int32_t *faces, int32_t *asked, int64_t *count);

#endif
