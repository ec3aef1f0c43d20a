/* Cem Yuksel's .hair: a header of 128 bytes, then whichever arrays its bits announce. Little-endian. Positions are used,
 * thickness, transparency and colour passed over. (C. Yuksel, "HAIR Model Files", cemyuksel.com/research/hairmodels.) */
#include "scene/scene.h"

#include <string.h>

enum { SEGMENTS = 1, POINTS = 2, THICKNESS = 4, TRANSPARENCY = 8, COLOUR = 16, HEADER = 128 };

static hg_status header_check(const hg_bytes *from, uint32_t strands, uint32_t points, uint32_t bits, uint32_t segments)
{
    if (strands == 0) return hg_fail(HG_FORMAT, "%s: the header (offset 4) says 0 strands", from->path);
    if (bits & ~(uint32_t)(SEGMENTS | POINTS | THICKNESS | TRANSPARENCY | COLOUR))
        return hg_fail(HG_FORMAT, "%s: the header (offset 12) has the bits 0x%x, expected some of 0x1f", from->path,
                       bits);
    if (!(bits & POINTS))
        return hg_fail(HG_FORMAT, "%s: the header (offset 12) says that it has no points", from->path);
    uint64_t bytes = (uint64_t)points *
                         (12 + (bits & THICKNESS ? 4 : 0) + (bits & TRANSPARENCY ? 4 : 0) + (bits & COLOUR ? 12 : 0)) +
                     (bits & SEGMENTS ? (uint64_t)strands * 2 : 0);
    if (bytes > from->size - HEADER)
        return hg_fail(HG_FORMAT,
                       "%s: the header says %u strands and %u points, that is %llu bytes from offset %d; %zu are there",
                       from->path, strands, points, (unsigned long long)bytes, HEADER, from->size - HEADER);
    if (!(bits & SEGMENTS) && ((uint64_t)segments + 1) * strands != points)
        return hg_fail(HG_FORMAT,
                       "%s: the header says %u strands of %u segments each (offset 16) and %u points (offset 8): "
                       "%llu points would be needed",
                       from->path, strands, segments, points, (unsigned long long)(((uint64_t)segments + 1) * strands));
    return HG_OK;
}

static hg_status read_from(hg_curves **curves, hg_bytes *from)
{
    char magic[4];
    uint32_t strands, points, bits, segments;
    HG_TRY(hg_bytes_read(from, magic, 4, "header"));
    if (memcmp(magic, "HAIR", 4) != 0)
        return hg_fail(HG_FORMAT, "%s: does not begin with \"HAIR\": it is no .hair file", from->path);
    HG_TRY(hg_bytes_read(from, &strands, 4, "header"));
    HG_TRY(hg_bytes_read(from, &points, 4, "header"));
    HG_TRY(hg_bytes_read(from, &bits, 4, "header"));
    HG_TRY(hg_bytes_read(from, &segments, 4, "header"));
    HG_TRY(hg_bytes_seek(from, HEADER, "first array"));
    HG_TRY(header_check(from, strands, points, bits, segments));
    HG_TRY(hg_curves_create(curves, strands, points));
    hg_curves *c = *curves;
    for (uint32_t s = 0; s < strands; s++) {
        uint16_t own = 0;
        if (bits & SEGMENTS) HG_TRY(hg_bytes_read(from, &own, 2, "segments of a strand"));
        c->start[s + 1] = c->start[s] + 1 + (bits & SEGMENTS ? own : segments);
    }
    if (c->start[strands] != points)
        return hg_fail(HG_FORMAT,
                       "%s: the strands have %lld points together (offset %d on), the header (offset 8) says %u",
                       from->path, (long long)c->start[strands], HEADER, points);
    return hg_bytes_read(from, c->points, (size_t)points * 12, "points");
}

static hg_status read_hair(hg_curves **curves, const char *path)
{
    hg_bytes from = { .path = path };
    void *bytes;
    *curves = NULL;
    HG_TRY(hg_file_read(path, &bytes, &from.size));
    from.bytes = bytes;
    hg_status status = read_from(curves, &from);
    hg_free(bytes);
    if (status != HG_OK) {
        hg_curves_destroy(*curves);
        *curves = NULL;
    }
    return status;
}

static const hg_groom_reader reader = {
    .extension = "hair", .what = "Cem Yuksel's HAIR", .read = read_hair, .unit = "inches and centimetres are both found"
};
HG_REGISTER("groom reader", hair, &reader);
