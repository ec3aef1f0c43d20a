/* PLY (G. Turk, "The PLY Polygon File Format", 1994): ascii, binary little- and big-endian; any elements and properties. */
#include "scene/ply.h"

#include <math.h>
#include <string.h>

static const struct {
    const char *name, *other;
    int size;
} types[] = {
    { "char", "int8", 1 }, { "uchar", "uint8", 1 }, { "short", "int16", 2 },   { "ushort", "uint16", 2 },
    { "int", "int32", 4 }, { "uint", "uint32", 4 }, { "float", "float32", 4 }, { "double", "float64", 8 },
};
enum { N_TYPES = sizeof types / sizeof *types, FLOAT = 6, DOUBLE = 7 };

/* ---- header ------------------------------------------------------------------------------------------------- */

static hg_status read_name(ply *file, char name[PLY_NAME], const char *what)
{
    hg_word word;
    if (!hg_lines_word(&file->lines, &word) || word.size >= PLY_NAME)
        return hg_lines_fail(&file->lines, "the name of %s is missing or longer than %d characters", what,
                             PLY_NAME - 1);
    memcpy(name, word.at, word.size);
    name[word.size] = '\0';
    return HG_OK;
}

static hg_status read_type(ply *file, int *type)
{
    hg_word word;
    if (!hg_lines_word(&file->lines, &word)) return hg_lines_fail(&file->lines, "a type is missing");
    for (*type = 0; *type < N_TYPES; ++*type)
        if (hg_word_is(word, types[*type].name) || hg_word_is(word, types[*type].other)) return HG_OK;
    return hg_lines_fail(&file->lines, "\"%.*s\" is not a type of PLY", hg_word_length(word), word.at);
}

static hg_status read_format(ply *file)
{
    hg_word word;
    bool there = hg_lines_word(&file->lines, &word);
    file->ascii = there && hg_word_is(word, "ascii");
    file->big_endian = there && hg_word_is(word, "binary_big_endian");
    if (!file->ascii && !file->big_endian && !(there && hg_word_is(word, "binary_little_endian")))
        return hg_lines_fail(&file->lines, "format: expected ascii, binary_little_endian or binary_big_endian");
    return HG_OK;
}

static hg_status read_element(ply *file)
{
    if (file->n == PLY_ELEMENTS) return hg_lines_fail(&file->lines, "more than %d elements", PLY_ELEMENTS);
    ply_element *element = &file->element[file->n];
    hg_word word;
    HG_TRY(read_name(file, element->name, "an element"));
    if (!hg_lines_word(&file->lines, &word) || !hg_word_integer(word, &element->count) || element->count < 0)
        return hg_lines_fail(&file->lines, "element %s: its number of rows is missing or no count", element->name);
    file->n++;
    return HG_OK;
}

static hg_status read_property(ply *file)
{
    if (file->n == 0) return hg_lines_fail(&file->lines, "a property before the first element");
    ply_element *element = &file->element[file->n - 1];
    if (element->n == PLY_PROPERTIES)
        return hg_lines_fail(&file->lines, "element %s has more than %d properties", element->name, PLY_PROPERTIES);
    ply_property *property = &element->property[element->n];
    const char *at = file->lines.at;
    hg_word word;
    property->count_type = -1;
    if (hg_lines_word(&file->lines, &word) && hg_word_is(word, "list")) {
        HG_TRY(read_type(file, &property->count_type));
        if (property->count_type >= FLOAT) return hg_lines_fail(&file->lines, "the length of a list is an integer");
    } else {
        file->lines.at = at;
    }
    HG_TRY(read_type(file, &property->type));
    HG_TRY(read_name(file, property->name, "a property"));
    element->n++;
    return HG_OK;
}

static hg_status read_header(ply *file)
{
    hg_lines *lines = &file->lines;
    hg_word word;
    bool formatted = false;
    size_t size = (size_t)(lines->end - lines->bytes);
    if (size < 4 || memcmp(lines->bytes, "ply", 3) != 0 || !strchr("\r\n ", lines->bytes[3]) || !hg_lines_next(lines))
        return hg_fail(HG_FORMAT, "%s: does not begin with the line \"ply\": it is no PLY file", lines->path);
    while (hg_lines_next(lines)) {
        hg_lines_word(lines, &word);
        if (hg_word_is(word, "format")) {
            HG_TRY(read_format(file));
            formatted = true;
        } else if (hg_word_is(word, "element")) {
            HG_TRY(read_element(file));
        } else if (hg_word_is(word, "property")) {
            HG_TRY(read_property(file));
        } else if (hg_word_is(word, "end_header")) {
            if (!formatted) return hg_lines_fail(lines, "the header ends without a line \"format\"");
            file->bytes = (hg_bytes){ .bytes = (uint8_t *)lines->bytes, .size = size, .path = lines->path };
            file->bytes.offset = (size_t)(lines->line_end - lines->bytes) + (lines->line_end < lines->end);
            return HG_OK;
        } else if (!hg_word_is(word, "comment") && !hg_word_is(word, "obj_info")) {
            return hg_lines_fail(lines, "\"%.*s\" is no word of a PLY header", hg_word_length(word), word.at);
        }
    }
    return hg_lines_fail(lines, "the file ends within its header");
}

/* What a row takes at least bounds the number of rows, so that a count can be believed. */
static hg_status check_counts(const ply *file)
{
    for (int e = 0; e < file->n; e++) {
        const ply_element *element = &file->element[e];
        uint64_t row = 0, left = file->bytes.size - file->bytes.offset;
        for (int i = 0; i < element->n; i++) {
            const ply_property *property = &element->property[i];
            row += file->ascii ? 2
                               : (uint64_t)types[property->count_type < 0 ? property->type : property->count_type].size;
        }
        if (row > 0 && (uint64_t)element->count > left / row + 1)
            return hg_fail(HG_FORMAT, "%s: the header says %lld rows of element %s; %llu bytes follow it (offset %zu)",
                           file->lines.path, (long long)element->count, element->name, (unsigned long long)left,
                           file->bytes.offset);
    }
    return HG_OK;
}

hg_status ply_open(ply *file, const char *path)
{
    memset(file, 0, sizeof *file);
    file->keep = -1;
    HG_TRY(hg_lines_open(&file->lines, path));
    hg_status status = read_header(file);
    if (status == HG_OK) status = check_counts(file);
    if (status != HG_OK) ply_close(file);
    return status;
}

void ply_close(ply *file)
{
    hg_lines_close(&file->lines);
    hg_free(file->list);
    file->list = NULL;
}

static int find(const ply_element *element, const char *name, bool list)
{
    for (int i = 0; i < element->n; i++)
        if (strcmp(element->property[i].name, name) == 0 && (element->property[i].count_type >= 0) == list) return i;
    return -1;
}

int ply_scalar(const ply_element *element, const char *name) { return find(element, name, false); }

int ply_list(const ply_element *element, const char *name) { return find(element, name, true); }

/* ---- rows --------------------------------------------------------------------------------------------------- */

static hg_status read_binary(ply *file, int type, const char *what, double *number)
{
    uint8_t raw[8], bytes[8];
    int size = types[type].size;
    HG_TRY(hg_bytes_read(&file->bytes, raw, (size_t)size, what));
    for (int i = 0; i < size; i++) bytes[i] = raw[file->big_endian ? size - 1 - i : i];
    uint64_t bits = 0;
    for (int i = 0; i < size; i++) bits |= (uint64_t)bytes[i] << (8 * i);
    if (type == FLOAT) {
        float value;
        memcpy(&value, bytes, 4);
        *number = (double)value;
    } else if (type == DOUBLE) {
        memcpy(number, bytes, 8);
    } else if (type % 2 == 0 && bits >> (8 * size - 1)) { /* a negative number */
        *number = (double)bits - ldexp(1, 8 * size);
    } else {
        *number = (double)bits;
    }
    return HG_OK;
}

static hg_status read_ascii(ply *file, int type, const char *what, double *number)
{
    hg_word word;
    int64_t integer;
    if (!hg_lines_flow(&file->lines, &word))
        return hg_lines_fail(&file->lines, "the file ends where a number of element %s is expected", what);
    if (!hg_word_number(word, number))
        return hg_lines_fail(&file->lines, "%s: \"%.*s\" is not a finite number", what, hg_word_length(word), word.at);
    if (type < FLOAT && !hg_word_integer(word, &integer))
        return hg_lines_fail(&file->lines, "%s: \"%.*s\" is not an integer", what, hg_word_length(word), word.at);
    return HG_OK;
}

static hg_status read_number(ply *file, int type, const char *what, double *number)
{
    return file->ascii ? read_ascii(file, type, what, number) : read_binary(file, type, what, number);
}

static hg_status keep_number(ply *file, double number)
{
    if (file->list_count == file->list_capacity) {
        int64_t larger = file->list_capacity ? 2 * file->list_capacity : 64;
        int64_t *list = hg_resize(file->list, (size_t)file->list_capacity, (size_t)larger, sizeof *list);
        if (!list) return HG_MEMORY;
        file->list = list;
        file->list_capacity = larger;
    }
    file->list[file->list_count++] = fabs(number) < 1e15 ? (int64_t)number : -1;
    return HG_OK;
}

hg_status ply_row(ply *file, const ply_element *element)
{
    file->list_count = 0;
    for (int i = 0; i < element->n; i++) {
        const ply_property *property = &element->property[i];
        double number;
        if (property->count_type < 0) {
            HG_TRY(read_number(file, property->type, element->name, &file->value[i]));
            continue;
        }
        HG_TRY(read_number(file, property->count_type, element->name, &number));
        if (number < 0)
            return hg_fail(HG_FORMAT, "%s: element %s: a list of %g numbers", file->lines.path, element->name, number);
        for (int64_t k = 0, count = (int64_t)number; k < count; k++) {
            double item;
            HG_TRY(read_number(file, property->type, element->name, &item));
            if (i == file->keep) HG_TRY(keep_number(file, item));
        }
    }
    return HG_OK;
}
