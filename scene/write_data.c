/* .data (USC-HairSalon) and .bin (CT2Hair); read_data.c has the layouts. The direction of a .bin vertex is that of the
 * edge that begins there (at the tip, of the edge that ends there); its label is 0. */
#include "scene/internal.h"

#include <string.h>

static void vertex_write(uint8_t *at, const float *strand, int64_t v, int64_t n, size_t width)
{
    memcpy(at, strand + 3 * v, 12);
    if (width == 3) return;
    int64_t a = v + 1 < n ? v : v - 1;
    float rest[4] = { 0 };
    if (a >= 0)
        scene_put(rest,
                  hg_vec3d_normalize(hg_vec3d_sub(scene_point(strand + 3 * (a + 1)), scene_point(strand + 3 * a))));
    memcpy(at + 12, rest, 16);
}

static hg_status write_file(const hg_curves *curves, const char *path, size_t width)
{
    int64_t points = curves->start[curves->strands];
    if (curves->strands > INT32_MAX) return hg_fail(HG_INVALID, "%s: it holds at most 2147483647 strands", path);
    size_t size = 4 + 4 * (size_t)curves->strands + 4 * width * (size_t)points;
    uint8_t *bytes = hg_alloc(size, 1), *at = bytes;
    if (!bytes) return HG_MEMORY;
    int32_t strands = (int32_t)curves->strands;
    memcpy(at, &strands, 4);
    at += 4;
    for (int64_t s = 0; s < curves->strands; s++) {
        int64_t n = curves->start[s + 1] - curves->start[s];
        int32_t count = (int32_t)n;
        if (n > INT32_MAX) {
            hg_free(bytes);
            return hg_fail(HG_INVALID, "%s: strand %lld has more than 2147483647 vertices", path, (long long)s);
        }
        memcpy(at, &count, 4);
        at += 4;
        for (int64_t v = 0; v < n; v++, at += 4 * width)
            vertex_write(at, curves->points + 3 * curves->start[s], v, n, width);
    }
    hg_status status = hg_file_write(path, bytes, size);
    hg_free(bytes);
    return status;
}

static hg_status write_data(const hg_curves *curves, const char *path, const char *variant)
{
    (void)variant;
    return write_file(curves, path, 3);
}

static hg_status write_bin(const hg_curves *curves, const char *path, const char *variant)
{
    (void)variant;
    return write_file(curves, path, 7);
}

static const hg_groom_writer data_writer = { .extension = "data",
                                             .what = "USC-HairSalon, Hair20K",
                                             .write = write_data };
HG_REGISTER("groom writer", data, &data_writer);

static const hg_groom_writer bin_writer = { .extension = "bin", .what = "CT2Hair", .write = write_bin };
HG_REGISTER("groom writer", bin, &bin_writer);
