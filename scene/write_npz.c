/* NumPy's .npz: `positions` [S,V,3], or, where strands differ in length, `points` [N,3] and `counts` [S]; `root_uv` [S,2]
 * where there is one. The names are those of DiffLocks. An .npy has one array [S,V,3]. */
#include "scene/internal.h"
#include "scene/npz.h"

static hg_status write_npz(const hg_curves *curves, const char *path, const char *variant)
{
    int64_t strands = curves->strands, vertices = curves->start[1];
    (void)variant;
    int32_t *counts = hg_alloc((size_t)strands, sizeof *counts);
    if (!counts) return HG_MEMORY;
    bool equal = true;
    for (int64_t s = 0; s < strands; s++) {
        int64_t n = curves->start[s + 1] - curves->start[s];
        equal = equal && n == vertices;
        if (n > INT32_MAX) {
            hg_free(counts);
            return hg_fail(HG_INVALID, "%s: strand %lld has more than 2147483647 vertices", path, (long long)s);
        }
        counts[s] = (int32_t)n;
    }
    npz_item items[3];
    int n = 0;
    if (equal) {
        items[n++] = (npz_item){ "positions", HG_F32, 3, { strands, vertices, 3 }, curves->points };
    } else {
        items[n++] = (npz_item){ "points", HG_F32, 2, { curves->start[strands], 3 }, curves->points };
        items[n++] = (npz_item){ "counts", HG_I32, 1, { strands }, counts };
    }
    if (curves->root_uv) items[n++] = (npz_item){ "root_uv", HG_F32, 2, { strands, 2 }, curves->root_uv };
    hg_status status = npz_write(path, n, items);
    hg_free(counts);
    return status;
}

static hg_status write_npy(const hg_curves *curves, const char *path, const char *variant)
{
    int64_t vertices;
    (void)variant;
    HG_TRY(scene_equal_vertices(curves, path, &vertices));
    return npz_write(path, 1, &(npz_item){ "", HG_F32, 3, { curves->strands, vertices, 3 }, curves->points });
}

static const hg_groom_writer npy_writer = { .extension = "npy", .what = "NumPy, [S,V,3]", .write = write_npy };
HG_REGISTER("groom writer", npy, &npy_writer);

static const hg_groom_writer writer = { .extension = "npz",
                                        .what = "NumPy, positions and root_uv",
                                        .write = write_npz };
HG_REGISTER("groom writer", npz, &writer);
