/* VTKHDF files: PolyData that moves (Kitware's VTK file format specification, version 2.0). Connectivity and data that
 * do not change are stored once, all steps point at the same place; points are written frame by frame. What is ours
 * alone stands in the group /hairgrad, which VTK passes over. */
#include "export/export.h"

#include <stdio.h>
#include <string.h>

#define MOST_EXTRAS 16

typedef struct {
    char *name; /* the dataset's path */
    int64_t rows;
} extra;

struct hg_vtkhdf {
    hg_h5 *h5;
    char *path;
    int64_t frames, points, written; /* points of one frame */
    int n_extras;
    extra extras[MOST_EXTRAS];
};

static hg_status write_one(hg_h5 *h5, const char *name, int64_t value)
{
    return hg_h5_write_i64(h5, name, 1, (int64_t[]){ 1 }, &value);
}

/* One of the four kinds of cells, all of which must be there: `n` cells, whose ends in the connectivity are offsets. */
static hg_status write_cells(hg_h5 *h5, const char *kind, int64_t n, const int64_t *offsets,
                             const int64_t *connectivity)
{
    char name[80];
    int64_t ids = n > 0 ? offsets[n] : 0, zero = 0;
    snprintf(name, sizeof name, "VTKHDF/%s/NumberOfConnectivityIds", kind);
    HG_TRY(write_one(h5, name, ids));
    snprintf(name, sizeof name, "VTKHDF/%s/NumberOfCells", kind);
    HG_TRY(write_one(h5, name, n));
    snprintf(name, sizeof name, "VTKHDF/%s/Offsets", kind);
    HG_TRY(hg_h5_write_i64(h5, name, 1, (int64_t[]){ n + 1 }, n > 0 ? offsets : &zero));
    snprintf(name, sizeof name, "VTKHDF/%s/Connectivity", kind);
    return hg_h5_write_i64(h5, name, 1, (int64_t[]){ ids }, ids > 0 ? connectivity : &zero);
}

/* The same place for every step, `width` numbers a step. */
static hg_status write_same(hg_h5 *h5, const char *name, int64_t frames, int64_t width, int64_t value)
{
    int64_t *all = hg_alloc((size_t)(frames * width), sizeof *all);
    if (!all) return HG_MEMORY;
    for (int64_t i = 0; i < frames * width; i++) all[i] = value;
    hg_status status = width > 1 ? hg_h5_write_i64(h5, name, 2, (int64_t[]){ frames, width }, all)
                                 : hg_h5_write_i64(h5, name, 1, (int64_t[]){ frames }, all);
    hg_free(all);
    return status;
}

static hg_status write_steps(hg_h5 *h5, int64_t frames, int64_t points, double rate)
{
    HG_TRY(hg_h5_group(h5, "VTKHDF/Steps"));
    HG_TRY(hg_h5_set_integers(h5, "VTKHDF/Steps", "NSteps", 1, &frames));
    double *time = hg_alloc((size_t)frames, sizeof *time);
    int64_t *first = hg_alloc((size_t)frames, sizeof *first);
    hg_status status = time && first ? HG_OK : HG_MEMORY;
    for (int64_t t = 0; status == HG_OK && t < frames; t++) {
        time[t] = (double)t / rate;
        first[t] = t * points;
    }
    if (status == HG_OK) status = hg_h5_write(h5, "VTKHDF/Steps/Values", HG_F64, 1, (int64_t[]){ frames }, time);
    if (status == HG_OK) status = hg_h5_write_i64(h5, "VTKHDF/Steps/PointOffsets", 1, (int64_t[]){ frames }, first);
    hg_free(time);
    hg_free(first);
    HG_TRY(status);
    HG_TRY(write_same(h5, "VTKHDF/Steps/PartOffsets", frames, 1, 0));
    HG_TRY(write_same(h5, "VTKHDF/Steps/NumberOfParts", frames, 1, 1));
    HG_TRY(write_same(h5, "VTKHDF/Steps/CellOffsets", frames, 4, 0));
    return write_same(h5, "VTKHDF/Steps/ConnectivityIdOffsets", frames, 4, 0);
}

/* Everything but the points and the cells' data. */
static hg_status write_head(hg_vtkhdf *file, const char *kind, int64_t cells, const int64_t *offsets,
                            const int64_t *connectivity, double rate)
{
    static const char *const kinds[4] = { "Vertices", "Lines", "Polygons", "Strips" };
    hg_h5 *h5 = file->h5;
    HG_TRY(hg_h5_group(h5, "VTKHDF"));
    HG_TRY(hg_h5_set_integers(h5, "VTKHDF", "Version", 2, (int64_t[]){ 2, 0 }));
    HG_TRY(hg_h5_set_text(h5, "VTKHDF", "Type", "PolyData"));
    for (int k = 0; k < 4; k++) {
        bool here = strcmp(kind, kinds[k]) == 0;
        HG_TRY(write_cells(h5, kinds[k], here ? cells : 0, offsets, connectivity));
    }
    HG_TRY(write_one(h5, "VTKHDF/NumberOfPoints", file->points));
    HG_TRY(write_steps(h5, file->frames, file->points, rate));
    HG_TRY(hg_h5_group(h5, "hairgrad"));
    HG_TRY(hg_h5_set_number(h5, "", "T", (double)file->frames));
    HG_TRY(hg_h5_set_number(h5, "", "rate", rate));
    HG_TRY(hg_h5_set_text(h5, "", "unit", "m"));
    HG_TRY(hg_h5_set_text(h5, "", "up", "+Y"));
    HG_TRY(hg_h5_set_text(h5, "", "generator", "hairgrad " HG_VERSION));
    return hg_h5_reserve(h5, "VTKHDF/Points", HG_F32, 2, (int64_t[]){ file->frames * file->points, 3 });
}

static hg_status create(hg_vtkhdf **file, const char *path, int64_t frames, int64_t points, double rate)
{
    *file = NULL;
    if (frames < 1 || points < 1 || points > INT32_MAX || frames > INT64_MAX / points / 12)
        return hg_fail(HG_INVALID, "%s: %lld frames of %lld points; both have to be at least 1", path,
                       (long long)frames, (long long)points);
    if (!(rate > 0.0)) return hg_fail(HG_INVALID, "%s: %g frames per second; it has to be above 0", path, rate);
    hg_vtkhdf *made = hg_alloc(1, sizeof *made);
    if (!made) return HG_MEMORY;
    made->frames = frames;
    made->points = points;
    made->path = hg_strdup(path);
    hg_status status = made->path ? hg_h5_create(&made->h5, path) : HG_MEMORY;
    if (status != HG_OK) {
        hg_vtkhdf_discard(made);
        return status;
    }
    *file = made;
    return HG_OK;
}

/* Which strand a point is of, and how far along it, from 0 at the root to 1 at the tip. */
static hg_status write_strand_data(hg_vtkhdf *file, int64_t strands, const int64_t *start)
{
    int64_t points = file->points;
    int32_t *strand = hg_alloc((size_t)points, sizeof *strand);
    float *along = hg_alloc((size_t)points, sizeof *along);
    hg_status status = strand && along ? HG_OK : HG_MEMORY;
    for (int64_t s = 0; status == HG_OK && s < strands; s++)
        for (int64_t i = start[s], n = start[s + 1] - i, v = 0; v < n; v++) {
            strand[i + v] = (int32_t)s;
            along[i + v] = n > 1 ? (float)v / (float)(n - 1) : 0.0f;
        }
    hg_h5 *h5 = file->h5;
    if (status == HG_OK) status = hg_h5_write(h5, "VTKHDF/PointData/strand", HG_I32, 1, &points, strand);
    if (status == HG_OK) status = hg_h5_write(h5, "VTKHDF/PointData/along", HG_F32, 1, &points, along);
    if (status == HG_OK) status = write_same(h5, "VTKHDF/Steps/PointDataOffsets/strand", file->frames, 1, 0);
    if (status == HG_OK) status = write_same(h5, "VTKHDF/Steps/PointDataOffsets/along", file->frames, 1, 0);
    hg_free(strand);
    hg_free(along);
    HG_TRY(status);
    return hg_h5_set_number(h5, "", "S", (double)strands);
}

hg_status hg_vtkhdf_create_polylines(hg_vtkhdf **file, const char *path, int64_t frames, int64_t strands,
                                     const int64_t *start, double rate)
{
    *file = NULL;
    if (strands < 1 || start[strands] > INT32_MAX)
        return hg_fail(HG_INVALID, "%s: %lld strands of %lld vertices together; there have to be some, and at most %d",
                       path, (long long)strands, (long long)start[strands], INT32_MAX);
    HG_TRY(create(file, path, frames, start[strands], rate));
    int64_t *connectivity = hg_alloc((size_t)start[strands], sizeof *connectivity);
    hg_status status = connectivity ? HG_OK : HG_MEMORY;
    for (int64_t i = 0; status == HG_OK && i < start[strands]; i++) connectivity[i] = i;
    if (status == HG_OK) status = write_head(*file, "Lines", strands, start, connectivity, rate);
    hg_free(connectivity);
    if (status == HG_OK) status = write_strand_data(*file, strands, start);
    if (status != HG_OK) {
        hg_vtkhdf_discard(*file);
        *file = NULL;
    }
    return status;
}

hg_status hg_vtkhdf_create_strands(hg_vtkhdf **file, const char *path, int64_t frames, int64_t strands,
                                   int64_t vertices, double rate)
{
    *file = NULL;
    if (strands < 1 || vertices < 1 || strands > INT32_MAX / vertices)
        return hg_fail(HG_INVALID, "%s: %lld strands of %lld vertices; both have to be at least 1", path,
                       (long long)strands, (long long)vertices);
    int64_t *start = hg_alloc((size_t)strands + 1, sizeof *start);
    if (!start) return HG_MEMORY;
    for (int64_t s = 0; s <= strands; s++) start[s] = s * vertices;
    hg_status status = hg_vtkhdf_create_polylines(file, path, frames, strands, start, rate);
    hg_free(start);
    if (status == HG_OK) status = hg_h5_set_number((*file)->h5, "", "V", (double)vertices);
    if (status != HG_OK && *file) {
        hg_vtkhdf_discard(*file);
        *file = NULL;
    }
    return status;
}

/* Triangles. */
static hg_status write_triangles(hg_vtkhdf *file, int64_t faces, const int32_t *corners, double rate)
{
    int64_t *offsets = hg_alloc((size_t)faces + 1, sizeof *offsets);
    int64_t *connectivity = hg_alloc((size_t)(faces * 3) + 1, sizeof *connectivity);
    hg_status status = offsets && connectivity ? HG_OK : HG_MEMORY;
    if (status == HG_OK) {
        for (int64_t i = 0; i <= faces; i++) offsets[i] = i * 3;
        for (int64_t i = 0; i < faces * 3; i++) connectivity[i] = corners[i];
        status = write_head(file, "Polygons", faces, offsets, connectivity, rate);
    }
    hg_free(offsets);
    hg_free(connectivity);
    return status;
}

hg_status hg_vtkhdf_create_mesh(hg_vtkhdf **file, const char *path, int64_t frames, int64_t vertices, int64_t faces,
                                const int32_t *triangles, double rate)
{
    *file = NULL;
    if (faces < 0 || faces > INT32_MAX) return hg_fail(HG_INVALID, "%s: %lld faces", path, (long long)faces);
    for (int64_t i = 0; i < 3 * faces; i++)
        if (triangles[i] < 0 || triangles[i] >= vertices)
            return hg_fail(HG_INVALID, "%s: face %lld names vertex %d of %lld", path, (long long)(i / 3),
                           (int)triangles[i], (long long)vertices);
    HG_TRY(create(file, path, frames, vertices, rate));
    hg_status status = write_triangles(*file, faces, triangles, rate);
    if (status != HG_OK) {
        hg_vtkhdf_discard(*file);
        *file = NULL;
    }
    return status;
}

hg_status hg_vtkhdf_add(hg_vtkhdf *file, const float *points)
{
    if (file->written == file->frames)
        return hg_fail(HG_INVALID, "%s: was made for %lld frames, one more was added", file->path,
                       (long long)file->frames);
    HG_TRY(hg_h5_write_rows(file->h5, "VTKHDF/Points", file->written * file->points, file->points, points));
    file->written++;
    return HG_OK;
}

/* ---- our own data -------------------------------------------------------------------------------------------- */

hg_status hg_vtkhdf_write_extra(hg_vtkhdf *file, const char *name, hg_dtype dtype, int rank, const int64_t *shape,
                                const void *data)
{
    char *path = hg_format("hairgrad/%s", name);
    if (!path) return HG_MEMORY;
    hg_status status = hg_h5_write(file->h5, path, dtype, rank, shape, data);
    hg_free(path);
    return status;
}

hg_status hg_vtkhdf_add_extra(hg_vtkhdf *file, const char *name, hg_dtype dtype, int rank, const int64_t *shape,
                              const void *row)
{
    extra *found = NULL;
    for (int i = 0; i < file->n_extras && !found; i++)
        if (strcmp(file->extras[i].name + strlen("hairgrad/"), name) == 0) found = &file->extras[i];
    if (!found) {
        if (file->n_extras == MOST_EXTRAS || rank < 0 || rank > HG_MAX_RANK - 1)
            return hg_fail(HG_INVALID, "%s: /hairgrad/%s: at most %d datasets of at most %d axes a frame", file->path,
                           name, MOST_EXTRAS, HG_MAX_RANK - 1);
        char *path = hg_format("hairgrad/%s", name);
        if (!path) return HG_MEMORY;
        int64_t whole[HG_MAX_RANK] = { file->frames };
        for (int k = 0; k < rank; k++) whole[k + 1] = shape[k];
        hg_status status = hg_h5_reserve(file->h5, path, dtype, rank + 1, whole);
        if (status != HG_OK) {
            hg_free(path);
            return status;
        }
        found = &file->extras[file->n_extras++];
        *found = (extra){ .name = path };
    }
    if (found->rows == file->frames)
        return hg_fail(HG_INVALID, "%s: was made for %lld frames, /%s got one more", file->path,
                       (long long)file->frames, found->name);
    HG_TRY(hg_h5_write_rows(file->h5, found->name, found->rows, 1, row));
    found->rows++;
    return HG_OK;
}

hg_status hg_vtkhdf_set_text(hg_vtkhdf *file, const char *name, const char *text)
{
    return hg_h5_set_text(file->h5, "hairgrad", name, text);
}

/* ---- end ----------------------------------------------------------------------------------------------------- */

static void release(hg_vtkhdf *file)
{
    for (int i = 0; i < file->n_extras; i++) hg_free(file->extras[i].name);
    hg_free(file->path);
    hg_free(file);
}

hg_status hg_vtkhdf_commit(hg_vtkhdf *file)
{
    hg_status status = HG_OK;
    if (file->written < file->frames)
        status = hg_fail(HG_INVALID, "%s: was made for %lld frames, only %lld were added", file->path,
                         (long long)file->frames, (long long)file->written);
    for (int i = 0; i < file->n_extras && status == HG_OK; i++)
        if (file->extras[i].rows < file->frames)
            status = hg_fail(HG_INVALID, "%s: was made for %lld frames, /%s has only %lld", file->path,
                             (long long)file->frames, file->extras[i].name, (long long)file->extras[i].rows);
    if (status == HG_OK)
        status = hg_h5_commit(file->h5);
    else
        hg_h5_close(file->h5);
    release(file);
    return status;
}

void hg_vtkhdf_discard(hg_vtkhdf *file)
{
    if (!file) return;
    hg_h5_close(file->h5);
    release(file);
}
