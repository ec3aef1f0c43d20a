/* Binary TressFX, version 4 or 3 (read_tfx.c has the layouts): positions, and the strands' UV where there is one. The
 * first two vertices of a strand are fixed, as AMD's exporter has it. */
#include "scene/internal.h"

#include <string.h>

static hg_status write_tfx(const hg_curves *curves, const char *path, const char *variant)
{
    bool four = variant[0] == '4';
    size_t header = four ? 160 : 296, width = four ? 16 : 12;
    int64_t vertices;
    HG_TRY(scene_equal_vertices(curves, path, &vertices));
    size_t points = (size_t)curves->strands * (size_t)vertices, positions = width * points;
    size_t uv = curves->root_uv ? 8 * (size_t)curves->strands : 0;
    if (vertices < 1 || vertices > 100000)
        return hg_fail(HG_INVALID, "%s: strands of %lld vertices; .tfx holds 1 to 100000", path, (long long)vertices);
    if (curves->strands > UINT32_MAX || header + positions > UINT32_MAX)
        return hg_fail(HG_INVALID, "%s: %zu points are more than a .tfx can say where they are (4 GiB)", path, points);
    uint8_t *bytes = hg_alloc(header + positions + uv, 1);
    if (!bytes) return HG_MEMORY;
    float version = four ? 4 : 3;
    uint32_t head[3] = { (uint32_t)curves->strands, (uint32_t)vertices, (uint32_t)header };
    uint32_t uv_offset = uv ? (uint32_t)(header + positions) : 0;
    memcpy(bytes, &version, 4);
    memcpy(bytes + 4, head, 8);
    memcpy(bytes + (four ? 12 : 144), &head[2], 4);
    memcpy(bytes + (four ? 16 : 152), &uv_offset, 4);
    for (size_t i = 0; i < points; i++) {
        float free = i % (size_t)vertices < 2 ? 0 : 1;
        memcpy(bytes + header + width * i, curves->points + 3 * i, 12);
        if (four) memcpy(bytes + header + width * i + 12, &free, 4);
    }
    if (uv) memcpy(bytes + header + positions, curves->root_uv, uv);
    hg_status status = hg_file_write(path, bytes, header + positions + uv);
    hg_free(bytes);
    return status;
}

static const hg_groom_writer writer = {
    .extension = "tfx", .what = "TressFX 4 and 3, binary", .variants = "4|3", .write = write_tfx
};
HG_REGISTER("groom writer", tfx, &writer);
