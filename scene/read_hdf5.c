/* Strands in HDF5: a groom of ours, one frame of a posed scene of ours, and one frame of VTKHDF PolyData (a drape, or
 * polylines that another program wrote). */
#include "scene/internal.h"

#include <string.h>

static hg_status frame_check(const char *path, int64_t frame, int64_t frames)
{
    if (frame >= 0 && frame < frames) return HG_OK;
    return hg_fail(HG_INVALID, "%s: frame %lld: it has frames 0 to %lld", path, (long long)frame,
                   (long long)frames - 1);
}

/* /strands [T,S,V,3] */
static hg_status read_posed(hg_curves **curves, hg_h5 *file, const char *path, int64_t frame)
{
    int rank;
    int64_t shape[6];
    scene_axes axes;
    if (!hg_h5_has(file, "/strands")) return hg_fail(HG_FORMAT, "%s: a posed scene without strands", path);
    HG_TRY(scene_axes_read(file, path, &axes));
    HG_TRY(hg_h5_shape(file, "/strands", &rank, shape));
    if (rank != 4 || shape[3] != 3 || shape[0] < 1 || shape[1] < 1 || shape[2] < 1 || shape[1] > INT32_MAX ||
        shape[2] > INT32_MAX)
        return hg_fail(HG_FORMAT, "%s: /strands is not [T,S,V,3]", path);
    HG_TRY(frame_check(path, frame, shape[0]));
    HG_TRY(hg_curves_create(curves, shape[1], shape[1] * shape[2]));
    for (int64_t s = 0; s <= shape[1]; s++) (*curves)->start[s] = s * shape[2];
    HG_TRY(hg_h5_read_rows(file, "/strands", HG_F32, frame, 1, (*curves)->points));
    scene_axes_points(&axes, (*curves)->points, shape[1] * shape[2]);
    return HG_OK;
}

/* An entry for this frame, `otherwise` when there is no such dataset. */
static hg_status step_value(hg_h5 *file, const char *path, const char *name, int64_t frame, int64_t otherwise,
                            int64_t *value)
{
    int rank;
    int64_t shape[6], *all = NULL;
    *value = otherwise;
    if (!hg_h5_has(file, name)) return HG_OK;
    HG_TRY(hg_h5_shape(file, name, &rank, shape));
    if (rank < 1 || rank > 2 || shape[0] <= frame || (rank == 2 && shape[1] < 2))
        return hg_fail(HG_FORMAT, "%s: %s has no entry for frame %lld", path, name, (long long)frame);
    int64_t width = rank == 2 ? shape[1] : 1;
    HG_TRY(hg_h5_read_i64(file, name, rank, (int64_t[]){ shape[0], width }, NULL, &all));
    *value = all[frame * width + (width > 1)]; /* of the four kinds of cells the lines are the second */
    hg_free(all);
    return HG_OK;
}

typedef struct {
    int64_t cells, *offsets, ids, *ids_of; /* offsets [cells+1], ids_of [ids] */
    float *points;
    int64_t n;
} polylines;

static hg_status gather(hg_curves **curves, const char *path, const polylines *p)
{
    if (p->cells < 1) return hg_fail(HG_FORMAT, "%s: it has no polylines (/VTKHDF/Lines), so no strands", path);
    for (int64_t s = 0; s < p->cells; s++)
        if (p->offsets[s] < 0 || p->offsets[s + 1] < p->offsets[s] || p->offsets[s + 1] > p->ids)
            return hg_fail(HG_FORMAT, "%s: /VTKHDF/Lines/Offsets: line %lld goes from %lld to %lld of %lld", path,
                           (long long)s, (long long)p->offsets[s], (long long)p->offsets[s + 1], (long long)p->ids);
    int64_t first = p->offsets[0], count = p->offsets[p->cells] - first;
    HG_TRY(hg_curves_create(curves, p->cells, count));
    for (int64_t s = 0; s <= p->cells; s++) (*curves)->start[s] = p->offsets[s] - first;
    for (int64_t i = 0; i < count; i++) {
        int64_t point = p->ids_of[first + i];
        if (point < 0 || point >= p->n)
            return hg_fail(HG_FORMAT, "%s: /VTKHDF/Lines/Connectivity names point %lld of %lld", path, (long long)point,
                           (long long)p->n);
        memcpy((*curves)->points + 3 * i, p->points + 3 * point, 3 * sizeof *p->points);
    }
    return HG_OK;
}

/* Numbers of points, cells and connections of the one part that a frame has. */
static hg_status one_of(hg_h5 *file, const char *path, const char *name, int64_t frame, int64_t *value)
{
    int rank;
    int64_t shape[6];
    HG_TRY(hg_h5_shape(file, name, &rank, shape));
    if (rank != 1 || shape[0] < 1) return hg_fail(HG_FORMAT, "%s: %s is not a list of numbers", path, name);
    return step_value(file, path, name, shape[0] > 1 ? frame : 0, 0, value);
}

static hg_status read_frame(hg_curves **curves, hg_h5 *file, const char *path, int64_t frame, polylines *p)
{
    int64_t frames = 1, part = 1, first, cell, id, points, cells, shape[6];
    int rank;
    if (hg_h5_has(file, "/VTKHDF/Steps")) HG_TRY(hg_h5_get_integers(file, "/VTKHDF/Steps", "NSteps", 1, &frames));
    HG_TRY(frame_check(path, frame, frames));
    HG_TRY(step_value(file, path, "/VTKHDF/Steps/NumberOfParts", frame, 1, &part));
    if (part != 1)
        return hg_fail(HG_UNSUPPORTED, "%s: frame %lld is in %lld parts; one can be read", path, (long long)frame,
                       (long long)part);
    HG_TRY(step_value(file, path, "/VTKHDF/Steps/PointOffsets", frame, 0, &first));
    HG_TRY(step_value(file, path, "/VTKHDF/Steps/CellOffsets", frame, 0, &cell));
    HG_TRY(step_value(file, path, "/VTKHDF/Steps/ConnectivityIdOffsets", frame, 0, &id));
    HG_TRY(one_of(file, path, "/VTKHDF/NumberOfPoints", frame, &points));
    HG_TRY(one_of(file, path, "/VTKHDF/Lines/NumberOfCells", frame, &cells));
    HG_TRY(hg_h5_shape(file, "/VTKHDF/Points", &rank, shape));
    if (rank != 2 || shape[1] != 3 || first < 0 || points < 0 || first > shape[0] || points > shape[0] - first)
        return hg_fail(HG_FORMAT, "%s: /VTKHDF/Points does not hold points %lld to %lld of frame %lld", path,
                       (long long)first, (long long)(first + points), (long long)frame);
    if (cell != 0 || id != 0)
        return hg_fail(HG_UNSUPPORTED,
                       "%s: its polylines change from frame to frame; only points that move can be read", path);
    p->n = points;
    p->points = hg_alloc(points ? (size_t)points : 1, 3 * sizeof *p->points);
    if (!p->points) return HG_MEMORY;
    if (points) HG_TRY(hg_h5_read_rows(file, "/VTKHDF/Points", HG_F32, first, points, p->points));
    HG_TRY(hg_h5_read_i64(file, "/VTKHDF/Lines/Offsets", 1, (int64_t[]){ -1 }, shape, &p->offsets));
    p->cells = cells;
    if (cells < 0 || shape[0] < cells + 1)
        return hg_fail(HG_FORMAT, "%s: /VTKHDF/Lines has %lld cells and %lld offsets", path, (long long)cells,
                       (long long)shape[0]);
    HG_TRY(hg_h5_read_i64(file, "/VTKHDF/Lines/Connectivity", 1, (int64_t[]){ -1 }, shape, &p->ids_of));
    p->ids = shape[0];
    return gather(curves, path, p);
}

static hg_status read_vtkhdf(hg_curves **curves, hg_h5 *file, const char *path, int64_t frame)
{
    polylines p = { 0 };
    scene_axes axes;
    HG_TRY(scene_axes_read(file, path, &axes));
    hg_status status = read_frame(curves, file, path, frame, &p);
    if (status == HG_OK) scene_axes_points(&axes, (*curves)->points, (*curves)->start[(*curves)->strands]);
    hg_free(p.points);
    hg_free(p.offsets);
    hg_free(p.ids_of);
    return status;
}

static hg_status read_groom(hg_curves **curves, const char *path, int64_t frame)
{
    hg_groom *groom;
    HG_TRY(frame_check(path, frame, 1));
    HG_TRY(hg_groom_load(&groom, path));
    hg_status status = hg_groom_to_curves(curves, groom);
    hg_groom_destroy(groom);
    return status;
}

static hg_status read_any_frame(hg_curves **curves, const char *path, int64_t frame)
{
    hg_h5 *file;
    char *format = NULL;
    *curves = NULL;
    HG_TRY(hg_h5_open(&file, path));
    bool vtk = hg_h5_has(file, "/VTKHDF");
    hg_status status = scene_text_or(file, "format", "", &format);
    bool posed = format && strcmp(format, "hairgrad posed scene") == 0;
    hg_free(format);
    if (status == HG_OK && vtk)
        status = read_vtkhdf(curves, file, path, frame);
    else if (status == HG_OK && posed)
        status = read_posed(curves, file, path, frame);
    hg_h5_close(file);
    if (status == HG_OK && !vtk && !posed) status = read_groom(curves, path, frame);
    if (status != HG_OK) {
        hg_curves_destroy(*curves);
        *curves = NULL;
    }
    return status;
}

static hg_status read_any(hg_curves **curves, const char *path) { return read_any_frame(curves, path, 0); }

static const hg_groom_reader h5_reader = { .extension = "h5",
                                           .what = "groom or posed scene of hairgrad",
                                           .read = read_any,
                                           .read_frame = read_any_frame,
                                           .metres = true };
HG_REGISTER("groom reader", h5, &h5_reader);

static const hg_groom_reader vtkhdf_reader = { .extension = "vtkhdf",
                                               .what = "a frame of VTKHDF polylines, such as a drape",
                                               .read = read_any,
                                               .read_frame = read_any_frame,
                                               .metres = true };
HG_REGISTER("groom reader", vtkhdf, &vtkhdf_reader);
