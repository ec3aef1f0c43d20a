/* Strands from NumPy's files: one array [S,V,3], or points [P,3] with the number of points or the first point of each
 * strand. Roots may stand apart from strands that begin at zero. An .npy holds one array [S,V,3]. */
#include "scene/npz.h"
#include "scene/scene.h"

#include <math.h>
#include <string.h>

static const char *const point_names[] = { "strands", "points", "positions", "", NULL };
static const char *const count_names[] = { "counts", "strand_counts", "num_points", NULL };
static const char *const offset_names[] = { "offsets", "starts", NULL };

static const char *first_of(const npz_file *file, const char *const *names)
{
    for (; *names; names++)
        if (npz_find(file, *names)) return *names;
    return NULL;
}

/* start [S+1] from counts or offsets; every number is checked against the points that there are. */
static hg_status read_starts(const npz_file *file, const char *name, bool counts, int64_t points, hg_curves *curves)
{
    int64_t n = 0, *numbers;
    HG_TRY(npz_read_i64(file, name, 1, (int64_t[]){ -1 }, &n, &numbers));
    bool ends = !counts && n > 1 && numbers[n - 1] == points; /* offsets with the end of the last strand */
    int64_t strands = ends ? n - 1 : n, at = 0;
    hg_status status = HG_OK;
    curves->strands = strands;
    curves->start = hg_alloc((size_t)strands + 1, sizeof *curves->start);
    if (!curves->start) status = HG_MEMORY;
    if (status == HG_OK && strands < 1) status = hg_fail(HG_FORMAT, "%s: array \"%s\" is empty", file->path, name);
    for (int64_t s = 0; status == HG_OK && s < strands; s++) {
        int64_t next = counts ? at + numbers[s] : s + 1 < n ? numbers[s + 1] : points;
        bool bad = counts ? numbers[s] < 0 || numbers[s] > points - at
                          : numbers[s] < 0 || next < numbers[s] || next > points || (s == 0 && numbers[0] != 0);
        if (bad)
            status = hg_fail(HG_FORMAT, "%s: array \"%s\": entry %lld is %lld, which does not fit into %lld points",
                             file->path, name, (long long)s, (long long)numbers[s], (long long)points);
        curves->start[s] = at;
        at = next;
    }
    if (status == HG_OK) {
        curves->start[strands] = at;
        if (at != points)
            status = hg_fail(HG_FORMAT, "%s: array \"%s\" gives %lld points to the strands, there are %lld", file->path,
                             name, (long long)at, (long long)points);
    }
    hg_free(numbers);
    return status;
}

/* Strands that all begin at zero are given from their roots; others begin with them. */
static hg_status add_roots(const npz_file *file, hg_curves *curves)
{
    float *roots;
    HG_TRY(npz_read(file, "roots", HG_F32, 2, (int64_t[]){ curves->strands, 3 }, NULL, (void **)&roots));
    bool zero = true, same = true;
    for (int64_t i = 0; i < 3 * curves->strands; i++) {
        int64_t s = i / 3;
        if (curves->start[s] == curves->start[s + 1]) continue;
        double x = (double)curves->points[3 * curves->start[s] + i % 3], root = (double)roots[i];
        zero = zero && x == 0;
        same = same && !(fabs(x - root) > 1e-4 * (1 + fabs(root)));
    }
    hg_status status = HG_OK;
    if (!zero && !same)
        status = hg_fail(HG_FORMAT,
                         "%s: array \"roots\": the strands neither begin at these roots nor at zero, from their roots",
                         file->path);
    for (int64_t s = 0; status == HG_OK && zero && s < curves->strands; s++)
        for (int64_t i = 3 * curves->start[s]; i < 3 * curves->start[s + 1]; i++)
            curves->points[i] += roots[3 * s + i % 3];
    hg_free(roots);
    return status;
}

static hg_status read_arrays(const npz_file *file, hg_curves *curves)
{
    int64_t shape[NPZ_RANK];
    const char *name = first_of(file, point_names);
    if (!name) {
        char *known = npz_describe(file);
        hg_fail(HG_FORMAT, "%s: no array strands, points or positions [S,V,3]; there are %s", file->path,
                known ? known : "others");
        hg_free(known);
        return HG_FORMAT;
    }
    const npz_array *a = npz_find(file, name);
    if (a->rank == 3) {
        HG_TRY(npz_read(file, name, HG_F32, 3, (int64_t[]){ -1, -1, 3 }, shape, (void **)&curves->points));
        if (shape[0] < 1 || shape[1] < 1)
            return hg_fail(HG_FORMAT, "%s: array \"%s\": %lld strands of %lld points", file->path, name,
                           (long long)shape[0], (long long)shape[1]);
        curves->strands = shape[0];
        curves->start = hg_alloc((size_t)shape[0] + 1, sizeof *curves->start);
        if (!curves->start) return HG_MEMORY;
        for (int64_t s = 0; s <= shape[0]; s++) curves->start[s] = s * shape[1];
    } else {
        const char *counts = first_of(file, count_names), *offsets = first_of(file, offset_names);
        if (a->rank != 2 || (!counts && !offsets))
            return hg_fail(
                HG_FORMAT,
                "%s: array \"%s\": expected [S,V,3], or [P,3] with an array counts or offsets of the strands",
                file->path, name);
        HG_TRY(npz_read(file, name, HG_F32, 2, (int64_t[]){ -1, 3 }, shape, (void **)&curves->points));
        HG_TRY(read_starts(file, counts ? counts : offsets, counts != NULL, shape[0], curves));
    }
    if (npz_find(file, "roots")) HG_TRY(add_roots(file, curves));
    if (npz_find(file, "root_uv"))
        HG_TRY(
            npz_read(file, "root_uv", HG_F32, 2, (int64_t[]){ curves->strands, 2 }, NULL, (void **)&curves->root_uv));
    return HG_OK;
}

static hg_status read_npz(hg_curves **out, const char *path)
{
    *out = NULL;
    npz_file *file;
    HG_TRY(npz_open(&file, path));
    hg_curves *curves = hg_alloc(1, sizeof *curves);
    hg_status status = curves ? read_arrays(file, curves) : HG_MEMORY;
    npz_close(file);
    if (status == HG_OK)
        *out = curves;
    else
        hg_curves_destroy(curves);
    return status;
}

static const hg_groom_reader npz_reader = { .extension = "npz",
                                            .what = "NumPy: strands [S,V,3], or points and counts",
                                            .read = read_npz };
HG_REGISTER("groom reader", npz, &npz_reader);
static const hg_groom_reader npy_reader = { .extension = "npy", .what = "NumPy: one array [S,V,3]", .read = read_npz };
HG_REGISTER("groom reader", npy, &npy_reader);
