/* PLY: element vertex, element strand with the number of segments of each, and element edge, so that viewers draw lines.
 * Root first. */
#include "scene/internal.h"

#include <string.h>

static hg_status header_write(const hg_curves *curves, const char *path, bool ascii, hg_text *text)
{
    int64_t points = curves->start[curves->strands], edges = points - curves->strands;
    const char *width = "ushort";
    if (points > INT32_MAX) return hg_fail(HG_INVALID, "%s: .ply edges name at most 2147483647 vertices", path);
    for (int64_t s = 0; s < curves->strands; s++) {
        int64_t n = curves->start[s + 1] - curves->start[s];
        if (n < 1) return hg_fail(HG_INVALID, "%s: strand %lld has no vertex; .ply needs one", path, (long long)s);
        if (n > UINT16_MAX) width = "uint";
    }
    hg_text_add(text,
                "ply\nformat %s 1.0\ncomment strands, written by hairgrad\nelement vertex %lld\nproperty float x\n"
                "property float y\nproperty float z\nelement strand %lld\nproperty %s nsegs\nelement edge %lld\n"
                "property int vertex1\nproperty int vertex2\nend_header\n",
                ascii ? "ascii" : "binary_little_endian", (long long)points, (long long)curves->strands, width,
                (long long)edges);
    return text->failed ? HG_MEMORY : HG_OK;
}

static void text_write(const hg_curves *curves, hg_text *text)
{
    const float *p = curves->points;
    for (int64_t i = 0; i < curves->start[curves->strands]; i++, p += 3)
        hg_text_add(text, "%.9g %.9g %.9g\n", (double)p[0], (double)p[1], (double)p[2]);
    for (int64_t s = 0; s < curves->strands; s++)
        hg_text_add(text, "%lld\n", (long long)(curves->start[s + 1] - curves->start[s] - 1));
    for (int64_t s = 0; s < curves->strands; s++)
        for (int64_t v = curves->start[s]; v + 1 < curves->start[s + 1]; v++)
            hg_text_add(text, "%lld %lld\n", (long long)v, (long long)v + 1);
}

static hg_status binary_write(const hg_curves *curves, const char *path, const hg_text *header)
{
    int64_t points = curves->start[curves->strands];
    size_t wide = strstr(header->data, "ushort") ? 2 : 4;
    size_t size =
        header->size + 12 * (size_t)points + wide * (size_t)curves->strands + 8 * (size_t)(points - curves->strands);
    uint8_t *bytes = hg_alloc(size, 1), *at = bytes;
    if (!bytes) return HG_MEMORY;
    memcpy(at, header->data, header->size);
    at += header->size;
    memcpy(at, curves->points, 12 * (size_t)points);
    at += 12 * (size_t)points;
    for (int64_t s = 0; s < curves->strands; s++, at += wide) {
        uint32_t segments = (uint32_t)(curves->start[s + 1] - curves->start[s] - 1);
        memcpy(at, &segments, wide); /* little-endian */
    }
    for (int64_t s = 0; s < curves->strands; s++)
        for (int64_t v = curves->start[s]; v + 1 < curves->start[s + 1]; v++, at += 8) {
            int32_t edge[2] = { (int32_t)v, (int32_t)(v + 1) };
            memcpy(at, edge, 8);
        }
    hg_status status = hg_file_write(path, bytes, size);
    hg_free(bytes);
    return status;
}

static hg_status write_ply(const hg_curves *curves, const char *path, const char *variant)
{
    bool ascii = strcmp(variant, "ascii") == 0;
    hg_text text = { 0 };
    if (ascii) HG_TRY(scene_finite_strands(curves, path));
    hg_status status = header_write(curves, path, ascii, &text);
    if (status == HG_OK && ascii) {
        text_write(curves, &text);
        status = text.failed ? HG_MEMORY : hg_file_write(path, text.data, text.size);
    } else if (status == HG_OK) {
        status = binary_write(curves, path, &text);
    }
    hg_text_free(&text);
    return status;
}

static const hg_groom_writer writer = {
    .extension = "ply", .what = "vertices, strands and edges", .variants = "binary|ascii", .write = write_ply
};
HG_REGISTER("groom writer", ply, &writer);
