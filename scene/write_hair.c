/* Cem Yuksel's .hair (read_hair.c has the layout): positions, and the number of segments of each strand where they differ.
 * Thickness 1, no transparency, white: what his own tools begin with. */
#include "scene/scene.h"

#include <string.h>

enum { SEGMENTS = 1, POINTS = 2, HEADER = 128 };

static hg_status write_hair(const hg_curves *curves, const char *path, const char *variant)
{
    int64_t points = curves->start[curves->strands], segments = curves->start[1] - 1;
    bool ragged = false;
    (void)variant;
    if (curves->strands > UINT32_MAX || points > UINT32_MAX)
        return hg_fail(HG_INVALID, "%s: .hair holds at most 4294967295 points", path);
    for (int64_t s = 0; s < curves->strands; s++) {
        int64_t own = curves->start[s + 1] - curves->start[s] - 1;
        ragged = ragged || own != segments;
        if (own < 0) return hg_fail(HG_INVALID, "%s: strand %lld has no vertex; .hair needs one", path, (long long)s);
    }
    for (int64_t s = 0; ragged && s < curves->strands; s++)
        if (curves->start[s + 1] - curves->start[s] - 1 > UINT16_MAX)
            return hg_fail(HG_INVALID, "%s: strand %lld has more than 65536 vertices, which .hair cannot hold", path,
                           (long long)s);
    size_t size = HEADER + (ragged ? 2 * (size_t)curves->strands : 0) + 12 * (size_t)points;
    uint8_t *bytes = hg_alloc(size, 1), *at = bytes;
    if (!bytes) return HG_MEMORY;
    uint32_t head[4] = { (uint32_t)curves->strands, (uint32_t)points, POINTS | (ragged ? SEGMENTS : 0),
                         ragged ? 0 : (uint32_t)segments };
    float look[5] = { 1, 0, 1, 1, 1 };
    memcpy(at, "HAIR", 4);
    memcpy(at + 4, head, sizeof head);
    memcpy(at + 20, look, sizeof look);
    memcpy(at + 40, "written by hairgrad", 19);
    at += HEADER;
    for (int64_t s = 0; ragged && s < curves->strands; s++, at += 2) {
        uint16_t own = (uint16_t)(curves->start[s + 1] - curves->start[s] - 1);
        memcpy(at, &own, 2);
    }
    memcpy(at, curves->points, 12 * (size_t)points);
    hg_status status = hg_file_write(path, bytes, size);
    hg_free(bytes);
    return status;
}

static const hg_groom_writer writer = { .extension = "hair", .what = "Cem Yuksel's HAIR", .write = write_hair };
HG_REGISTER("groom writer", hair, &writer);
