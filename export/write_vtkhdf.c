/* Strands as VTKHDF polylines of one frame, for ParaView and PyVista: a writer of strands. */
#include "export/export.h"

static hg_status write_vtkhdf(const hg_curves *curves, const char *path, const char *variant)
{
    hg_vtkhdf *file;
    int64_t strands = curves->strands, vertices = curves->start[1];
    bool equal = vertices > 0; /* then it is a drape of one frame, which hairgrad render draws too */
    (void)variant;
    for (int64_t s = 0; s <= strands && equal; s++) equal = curves->start[s] == s * vertices;
    HG_TRY(equal ? hg_vtkhdf_create_strands(&file, path, 1, strands, vertices, 1)
                 : hg_vtkhdf_create_polylines(&file, path, 1, strands, curves->start, 1));
    hg_status status = hg_vtkhdf_add(file, curves->points);
    if (status == HG_OK) return hg_vtkhdf_commit(file);
    hg_vtkhdf_discard(file);
    return status;
}

static const hg_groom_writer writer = {
    .extension = "vtkhdf", .what = "VTKHDF polylines", .write = write_vtkhdf, .metres = true
};
HG_REGISTER("groom writer", vtkhdf, &writer);
