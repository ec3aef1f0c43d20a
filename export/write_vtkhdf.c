/* Strands as VTKHDF polylines of one frame, for ParaView and PyVista: a writer of strands. */
#include "export/export.h"

static hg_status write_vtkhdf(const hg_curves *curves, const char *path, const char *variant)
{
    hg_vtkhdf *file;
    (void)variant;
    HG_TRY(hg_vtkhdf_create_polylines(&file, path, 1, curves->strands, curves->start, 1));
    hg_status status = hg_vtkhdf_add(file, curves->points);
    if (status == HG_OK) return hg_vtkhdf_commit(file);
    hg_vtkhdf_discard(file);
    return status;
}

static const hg_groom_writer writer = {
    .extension = "vtkhdf", .what = "VTKHDF polylines", .write = write_vtkhdf, .metres = true
};
HG_REGISTER("groom writer", vtkhdf, &writer);
