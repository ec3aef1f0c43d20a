/* A groom file of ours. Strands that come from one keep the faces that they are bound to; others are not bound. */
#include "scene/internal.h"

#include <string.h>

static hg_status write_h5(const hg_curves *curves, const char *path, const char *variant)
{
    int64_t vertices;
    hg_groom *groom;
    (void)variant;
    HG_TRY(scene_equal_vertices(curves, path, &vertices));
    HG_TRY(hg_groom_create(&groom, curves->strands, vertices));
    size_t n = (size_t)curves->strands;
    const char *slash = strrchr(path, '/');
    memcpy(groom->points, curves->points, n * (size_t)vertices * 3 * sizeof *groom->points);
    groom->name = hg_strdup(slash ? slash + 1 : path);
    if (curves->root_face && curves->root_bary && curves->root_uv) {
        memcpy(groom->root_face, curves->root_face, n * sizeof *groom->root_face);
        memcpy(groom->root_bary, curves->root_bary, n * 3 * sizeof *groom->root_bary);
        memcpy(groom->root_uv, curves->root_uv, n * 2 * sizeof *groom->root_uv);
        groom->body_hash = curves->body_hash;
    }
    hg_status status = groom->name ? hg_groom_save(groom, path) : HG_MEMORY;
    hg_groom_destroy(groom);
    return status;
}

static const hg_groom_writer writer = {
    .extension = "h5", .what = "groom of hairgrad", .write = write_h5, .metres = true
};
HG_REGISTER("groom writer", h5, &writer);
