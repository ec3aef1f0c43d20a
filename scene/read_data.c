/* Strands one after the other, each with its number of vertices before it, little-endian:
 *   .data   USC-HairSalon, Hair20K: i32 strands; per strand i32 n and n times x y z (Hu et al. 2015)
 *   .bin    CT2Hair: the same with seven floats a vertex, x y z, direction, label (Shen et al. 2023)
 * A strand of one vertex is a bald root. Nothing may follow the last strand: that is how one is told from the other. */
#include "scene/scene.h"

#include <string.h>

/* The number of vertices of a strand, when the file holds them. */
static hg_status read_count(hg_bytes *from, int64_t strand, size_t width, int32_t *count)
{
    size_t at = from->offset;
    HG_TRY(hg_bytes_read(from, count, 4, "number of vertices of a strand"));
    if (*count < 0)
        return hg_fail(HG_FORMAT, "%s: strand %lld has %d vertices (offset %zu)", from->path, (long long)strand, *count,
                       at);
    if ((uint64_t)*count > (from->size - from->offset) / (4 * width))
        return hg_fail(HG_FORMAT, "%s: strand %lld has %d vertices (offset %zu), the file ends after %zu of them",
                       from->path, (long long)strand, *count, at, (from->size - from->offset) / (4 * width));
    return HG_OK;
}

/* Walks over all strands: counts and checks, or with curves not NULL fills them. */
static hg_status walk(hg_bytes *from, size_t width, int32_t strands, int64_t *points, hg_curves *curves)
{
    *points = 0;
    for (int64_t s = 0; s < strands; s++) {
        int32_t count;
        HG_TRY(read_count(from, s, width, &count));
        for (int32_t v = 0; curves && v < count; v++)
            memcpy(curves->points + 3 * (*points + v), from->bytes + from->offset + 4 * width * (size_t)v, 12);
        from->offset += 4 * width * (size_t)count;
        *points += count;
        if (curves) curves->start[s + 1] = *points;
    }
    return HG_OK;
}

static hg_status read_from(hg_curves **curves, hg_bytes *from, size_t width)
{
    int32_t strands;
    int64_t points;
    HG_TRY(hg_bytes_read(from, &strands, 4, "number of strands"));
    if (strands < 1 || (uint64_t)strands > (from->size - 4) / 4)
        return hg_fail(HG_FORMAT,
                       "%s: the first number says %d strands; %zu bytes follow, 4 at least are needed for each",
                       from->path, strands, from->size - 4);
    hg_status status = walk(from, width, strands, &points, NULL);
    if (status == HG_OK && from->offset != from->size)
        status = hg_fail(HG_FORMAT, "%s: %zu bytes are left after the last of %d strands, at offset %zu", from->path,
                         from->size - from->offset, strands, from->offset);
    if (status != HG_OK) { /* is it the other one? */
        char *message = hg_strdup(hg_message());
        size_t other = width == 3 ? 7 : 3;
        int64_t ignored;
        from->offset = 4;
        if (message && walk(from, other, strands, &ignored, NULL) == HG_OK && from->offset == from->size)
            hg_fail(status, "%s; with %zu floats a vertex it is whole: call it .%s", message, other,
                    other == 7 ? "bin" : "data");
        else if (message)
            hg_fail(status, "%s", message);
        hg_free(message);
        return status;
    }
    HG_TRY(hg_curves_create(curves, strands, points));
    from->offset = 4;
    return walk(from, width, strands, &points, *curves);
}

static hg_status read_file(hg_curves **curves, const char *path, size_t width)
{
    hg_bytes from = { .path = path };
    void *bytes;
    *curves = NULL;
    HG_TRY(hg_file_read(path, &bytes, &from.size));
    from.bytes = bytes;
    hg_status status = read_from(curves, &from, width);
    hg_free(bytes);
    if (status != HG_OK) {
        hg_curves_destroy(*curves);
        *curves = NULL;
    }
    return status;
}

static hg_status read_data(hg_curves **curves, const char *path) { return read_file(curves, path, 3); }

static hg_status read_bin(hg_curves **curves, const char *path) { return read_file(curves, path, 7); }

static const hg_groom_reader data_reader = { .extension = "data",
                                             .what = "USC-HairSalon, Hair20K",
                                             .read = read_data,
                                             .unit = "USC-HairSalon is in metres, +Y up" };
HG_REGISTER("groom reader", data, &data_reader);

static const hg_groom_reader bin_reader = {
    .extension = "bin", .what = "CT2Hair", .read = read_bin, .unit = "it varies: look at the lengths"
};
HG_REGISTER("groom reader", bin, &bin_reader);
