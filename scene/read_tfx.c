/* TressFX hair: binary .tfx of version 4 (160-byte header, four floats a point) and 3 (296-byte header, three floats a
 * point), and the text of version 2. Numbers are little-endian. Positions are used, and the strands' UV where a
 * binary file has them. */
#include "scene/lines.h"
#include "scene/scene.h"

#include <limits.h>
#include <math.h>
#include <string.h>

static hg_status read_binary(hg_curves **out, hg_bytes *from)
{
    float version;
    uint32_t strands, vertices, offset;
    HG_TRY(hg_bytes_read(from, &version, 4, "version"));
    if (!(version >= 3.0F && version < 5.0F))
        return hg_fail(HG_FORMAT,
                       "%s: the first four bytes give TressFX version %g; 3 and 4 (binary) and 2 (text) can be read",
                       from->path, (double)version);
    bool four = version >= 4.0F;
    HG_TRY(hg_bytes_read(from, &strands, 4, "number of strands"));
    HG_TRY(hg_bytes_read(from, &vertices, 4, "points per strand"));
    HG_TRY(hg_bytes_seek(from, four ? 12 : 144, "header"));
    HG_TRY(hg_bytes_read(from, &offset, 4, "offset of the positions"));
    if (strands == 0) return hg_fail(HG_FORMAT, "%s: the header (offset 4) says 0 strands", from->path);
    if (vertices == 0 || vertices > 100000)
        return hg_fail(HG_FORMAT, "%s: the header (offset 8) says %u points per strand, expected 1 to 100000",
                       from->path, vertices);
    size_t header = four ? 160 : 296, width = four ? 4 : 3;
    if (offset < header)
        return hg_fail(HG_FORMAT, "%s: positions would start at offset %u, inside the header of %zu bytes", from->path,
                       offset, header);
    HG_TRY(hg_bytes_seek(from, offset, "positions"));
    uint64_t points = (uint64_t)strands * vertices;
    if (points > (from->size - offset) / (width * 4))
        return hg_fail(
            HG_FORMAT, "%s: the header says %u strands of %u points from offset %u, that is %llu bytes; %zu are there",
            from->path, strands, vertices, offset, (unsigned long long)(points * width * 4), from->size - offset);

    HG_TRY(hg_curves_create(out, strands, (int64_t)points));
    hg_curves *curves = *out;
    for (uint32_t s = 0; s <= strands; s++) curves->start[s] = (int64_t)s * vertices;
    const uint8_t *at = from->bytes + offset;
    for (uint64_t i = 0; i < points; i++) memcpy(curves->points + 3 * i, at + 4 * width * i, 12);
    HG_TRY(hg_bytes_seek(from, four ? 16 : 152, "header"));
    HG_TRY(hg_bytes_read(from, &offset, 4, "offset of the strands' UV"));
    if (offset == 0) return HG_OK;
    if (offset < header)
        return hg_fail(HG_FORMAT, "%s: UV of strands would start at offset %u, inside the header of %zu bytes",
                       from->path, offset, header);
    HG_TRY(hg_bytes_seek(from, offset, "UV of strands"));
    curves->root_uv = hg_alloc(strands, 2 * sizeof *curves->root_uv);
    if (!curves->root_uv) return HG_MEMORY;
    return hg_bytes_read(from, curves->root_uv, (size_t)strands * 2 * sizeof *curves->root_uv, "UV of strands");
}

/* One strand of version 2: "strand I numVerts N texcoord U V", then N lines "x, y, z". */
static hg_status read_text_strand(hg_lines *lines, hg_curves *curves, int64_t strand, int64_t *capacity)
{
    hg_word word;
    int64_t count = -1;
    while (hg_lines_word(lines, &word))
        if (hg_word_is_any_case(word, "numVerts"))
            if (!hg_lines_word(lines, &word) || !hg_word_integer(word, &count)) count = -1;
    if (count < 0 || (uint64_t)count > hg_lines_left(lines) / 6 + 1) /* a point takes at least "0,0,0\n" */
        return hg_lines_fail(lines, "strand %lld: numVerts is missing, or larger than the rest of the file can hold",
                             (long long)strand);
    int64_t first = curves->start[strand];
    if (first + count > *capacity) {
        int64_t larger = 2 * (first + count);
        float *points = hg_resize(curves->points, (size_t)*capacity, (size_t)larger, 3 * sizeof *points);
        if (!points) return HG_MEMORY;
        curves->points = points;
        *capacity = larger;
    }
    for (int64_t v = 0; v < count; v++) {
        if (!hg_lines_next(lines))
            return hg_lines_fail(lines, "strand %lld: the file ends after %lld of %lld points", (long long)strand,
                                 (long long)v, (long long)count);
        for (char *c = lines->bytes + (lines->at - lines->bytes); c < lines->line_end; c++)
            if (*c == ',') *c = ' ';
        for (int k = 0; k < 3; k++) {
            double number;
            HG_TRY(hg_lines_number(lines, &number, "point"));
            curves->points[3 * (first + v) + k] = (float)number;
        }
    }
    curves->start[strand + 1] = first + count;
    return HG_OK;
}

/* "scale 1", "rotation 0 0 0" or "translation 0 0 0": in which order others would be meant is not known. */
static hg_status check_transform(hg_lines *lines, hg_word what)
{
    bool scale = hg_word_is_any_case(what, "scale");
    hg_word word;
    while (hg_lines_word(lines, &word)) {
        double number;
        if (!hg_word_number(word, &number) || fabs(number - (scale ? 1 : 0)) > 1e-9)
            return hg_lines_fail(lines,
                                 "%.*s %.*s: strands that are to be transformed cannot be read; write the file with "
                                 "scale 1, rotation 0 0 0 and translation 0 0 0",
                                 hg_word_length(what), what.at, hg_word_length(word), word.at);
    }
    return HG_OK;
}

static hg_status read_text(hg_curves **out, hg_lines *lines)
{
    int64_t strands = -1, strand = 0, capacity = 0;
    hg_curves *curves = NULL;
    while (hg_lines_next(lines)) {
        hg_word word;
        hg_lines_word(lines, &word);
        if (hg_word_is_any_case(word, "version")) {
            double version;
            HG_TRY(hg_lines_number(lines, &version, "version"));
            if (!(version >= 2 && version < 3))
                return hg_lines_fail(lines, "text of TressFX version %g; 2 (text), 3 and 4 (binary) can be read",
                                     version);
        } else if (hg_word_is_any_case(word, "scale") || hg_word_is_any_case(word, "rotation") ||
                   hg_word_is_any_case(word, "translation")) {
            HG_TRY(check_transform(lines, word));
        } else if (hg_word_is_any_case(word, "numStrands")) {
            if (curves || !hg_lines_word(lines, &word) || !hg_word_integer(word, &strands) || strands < 1 ||
                (uint64_t)strands > hg_lines_left(lines) / 8)
                return hg_lines_fail(
                    lines, "numStrands is not a number of strands that this file can hold, or is given twice");
            capacity = 1;
            HG_TRY(hg_curves_create(out, strands, capacity));
            curves = *out;
        } else if (hg_word_is_any_case(word, "strand")) {
            if (!curves || strand >= strands)
                return hg_lines_fail(lines, "a strand %s", curves ? "more than numStrands says" : "before numStrands");
            HG_TRY(read_text_strand(lines, curves, strand, &capacity));
            strand++;
        }
    }
    if (!curves || strand < strands)
        return hg_lines_fail(lines, "the file ends after %lld of %lld strands", (long long)strand,
                             (long long)(curves ? strands : 0));
    return HG_OK;
}

static hg_status read_tfx(hg_curves **curves, const char *path)
{
    *curves = NULL;
    hg_lines lines;
    HG_TRY(hg_lines_open(&lines, path));
    size_t size = (size_t)(lines.end - lines.bytes);
    bool text = size >= 7 && memcmp(lines.bytes, "version", 7) == 0;
    hg_status status =
        text ? read_text(curves, &lines)
             : read_binary(curves, &(hg_bytes){ .bytes = (uint8_t *)lines.bytes, .size = size, .path = path });
    hg_lines_close(&lines);
    if (status != HG_OK) {
        hg_curves_destroy(*curves);
        *curves = NULL;
    }
    return status;
}

static const hg_groom_reader reader = { .extension = "tfx",
                                        .what = "TressFX 2 (text), 3 and 4 (binary)",
                                        .read = read_tfx,
                                        .unit = "metres and centimetres are both found" };
HG_REGISTER("groom reader", tfx, &reader);
