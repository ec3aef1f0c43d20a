/* NumPy's array format (numpy.lib.format, versions 1 to 3): a magic string, the length of a header, the header as a
 * Python dictionary of descr, fortran_order and shape, then the elements. */
#include "scene/npy.h"

#include <math.h>
#include <string.h>

/* ---- the header --------------------------------------------------------------------------------------------- */

typedef struct {
    const char *path;
    const npz_array *a;
    const uint8_t *bytes;
    size_t at, end;
} cursor;

static hg_status header_fail(const cursor *c, const char *what)
{
    return hg_fail(HG_FORMAT, "%s: array \"%s\", byte %zu of its header: expected %s", c->path, c->a->name, c->at,
                   what);
}

static void skip_space(cursor *c)
{
    while (c->at < c->end && strchr(" \n\r\t", c->bytes[c->at]) && c->bytes[c->at]) c->at++;
}

static bool take(cursor *c, char mark)
{
    skip_space(c);
    if (c->at >= c->end || c->bytes[c->at] != (uint8_t)mark) return false;
    c->at++;
    return true;
}

static bool take_word(cursor *c, const char *word)
{
    size_t length = strlen(word);
    skip_space(c);
    if (c->end - c->at < length || memcmp(c->bytes + c->at, word, length) != 0) return false;
    c->at += length;
    return true;
}

/* A quoted text without escapes, at most 31 bytes. */
static bool take_text(cursor *c, char text[32])
{
    skip_space(c);
    if (c->at >= c->end || (c->bytes[c->at] != '\'' && c->bytes[c->at] != '"')) return false;
    uint8_t quote = c->bytes[c->at++];
    size_t length = 0;
    while (c->at < c->end && c->bytes[c->at] != quote && length < 31) text[length++] = (char)c->bytes[c->at++];
    text[length] = '\0';
    return take(c, (char)quote);
}

static bool take_size(cursor *c, int64_t *size)
{
    skip_space(c);
    size_t first = c->at;
    *size = 0;
    for (; c->at < c->end && c->bytes[c->at] >= '0' && c->bytes[c->at] <= '9'; c->at++) {
        if (*size > INT64_MAX / 10 - 1) return false;
        *size = 10 * *size + (c->bytes[c->at] - '0');
    }
    if (c->at > first && c->at < c->end && c->bytes[c->at] == 'L') c->at++; /* of Python 2 */
    return c->at > first;
}

static hg_status take_shape(cursor *c, npz_array *a)
{
    if (!take(c, '(')) return header_fail(c, "a shape (n, ...)");
    while (!take(c, ')')) {
        if (a->rank == NPZ_RANK)
            return hg_fail(HG_UNSUPPORTED, "%s: array \"%s\" has more than %d indices", c->path, a->name, NPZ_RANK);
        if (!take_size(c, &a->shape[a->rank])) return header_fail(c, "a size");
        a->rank++;
        if (!take(c, ',')) {
            if (take(c, ')')) break;
            return header_fail(c, "\",\" or \")\" in the shape");
        }
    }
    return HG_OK;
}

/* "<f4": byte order, kind, bytes; "<U5" counts characters. A list is a structure: noted as type V and passed over. */
static hg_status take_type(cursor *c, npz_array *a)
{
    char text[32];
    skip_space(c);
    if (c->at < c->end && c->bytes[c->at] == '[') {
        int depth = 0;
        for (; c->at < c->end; c->at++) {
            depth += (c->bytes[c->at] == '[') - (c->bytes[c->at] == ']');
            if (depth == 0) break;
        }
        if (!take(c, ']')) return header_fail(c, "the end of a structure");
        a->type = 'V';
        return HG_OK;
    }
    if (!take_text(c, text) || strlen(text) < 2) return header_fail(c, "a type such as '<f4'");
    int first = strchr("<>|=", text[0]) != NULL;
    a->swapped = text[0] == '>';
    a->type = text[first];
    int64_t width = 0;
    for (const char *digit = text + first + 1; *digit >= '0' && *digit <= '9' && width < (1 << 24); digit++)
        width = 10 * width + (*digit - '0');
    a->width = (int)(a->type == 'U' ? 4 * width : width);
    if (a->width == 1 || a->type == 'O' || a->type == 'S') a->swapped = false;
    return HG_OK;
}

static bool known_type(const npz_array *a)
{
    int w = a->width;
    switch (a->type) {
    case 'f':
        return w == 2 || w == 4 || w == 8;
    case 'i':
    case 'u':
        return w == 1 || w == 2 || w == 4 || w == 8;
    case 'b':
        return w == 1;
    case 'U':
    case 'S':
        return w >= 0;
    default:
        return false;
    }
}

hg_status npy_parse(const char *path, npz_array *a, const uint8_t *bytes, size_t size)
{
    cursor c = { .path = path, .a = a, .bytes = bytes, .end = size };
    if (size < 10 || memcmp(bytes, "\x93NUMPY", 6) != 0) return header_fail(&c, "the magic of a NumPy array");
    size_t begin = bytes[6] == 1 ? 10 : 12, length = (size_t)bytes[8] | (size_t)bytes[9] << 8;
    if (bytes[6] < 1 || bytes[6] > 3)
        return hg_fail(HG_UNSUPPORTED, "%s: array \"%s\" is of NumPy's format %d; 1 to 3 can be read", path, a->name,
                       bytes[6]);
    if (begin == 12 && size >= 12) length |= (size_t)bytes[10] << 16 | (size_t)bytes[11] << 24;
    if (size < begin || length > size - begin)
        return hg_fail(HG_FORMAT, "%s: array \"%s\": its header of %zu bytes does not fit into %zu", path, a->name,
                       length, size);
    c.at = begin;
    c.end = a->header = begin + length;
    bool type = false, order = false, shape = false;
    if (!take(&c, '{')) return header_fail(&c, "\"{\"");
    while (!take(&c, '}')) {
        char key[32];
        if (!take_text(&c, key) || !take(&c, ':')) return header_fail(&c, "a key");
        if (strcmp(key, "descr") == 0 && !type) {
            HG_TRY(take_type(&c, a));
            type = true;
        } else if (strcmp(key, "fortran_order") == 0 && !order) {
            a->fortran = take_word(&c, "True");
            if (!a->fortran && !take_word(&c, "False")) return header_fail(&c, "True or False");
            order = true;
        } else if (strcmp(key, "shape") == 0 && !shape) {
            HG_TRY(take_shape(&c, a));
            shape = true;
        } else {
            return header_fail(&c, "descr, fortran_order and shape, once each");
        }
        if (!take(&c, ',') && !(c.at < c.end && c.bytes[c.at] == '}')) return header_fail(&c, "\",\" or \"}\"");
    }
    if (!type || !order || !shape) return header_fail(&c, "descr, fortran_order and shape");
    a->count = 1;
    for (int i = 0; i < a->rank; i++)
        if (__builtin_mul_overflow(a->count, a->shape[i], &a->count))
            return header_fail(&c, "a shape that is possible");
    if (!known_type(a)) return HG_OK; /* listed; refused when it is asked for */
    int64_t bytes_needed;
    if (__builtin_mul_overflow(a->count, (int64_t)a->width, &bytes_needed) ||
        (uint64_t)bytes_needed != a->size - a->header)
        return hg_fail(HG_FORMAT, "%s: array \"%s\": its header says %lld elements of %d bytes; %llu bytes are there",
                       path, a->name, (long long)a->count, a->width, (unsigned long long)(a->size - a->header));
    return HG_OK;
}

/* ---- elements ----------------------------------------------------------------------------------------------- */

static double half(uint16_t bits)
{
    int exponent = bits >> 10 & 31, fraction = bits & 1023;
    double value = exponent == 31 ? fraction ? (double)NAN : (double)INFINITY
                                  : ldexp(exponent ? 1024 + fraction : fraction, (exponent ? exponent : 1) - 25);
    return bits >> 15 ? -value : value;
}

static int64_t as_integer(const npz_array *a, const uint8_t *at)
{
    uint64_t value = 0;
    memcpy(&value, at, (size_t)a->width);
    if (a->type == 'b') return value != 0;
    if (a->type == 'i' && a->width < 8 && value >> (8 * a->width - 1)) value |= ~(uint64_t)0 << (8 * a->width);
    return (int64_t)value;
}

static double as_number(const npz_array *a, const uint8_t *at)
{
    if (a->type != 'f') {
        int64_t value = as_integer(a, at);
        return a->type == 'u' && a->width == 8 ? (double)(uint64_t)value : (double)value;
    }
    if (a->width == 8) {
        double value;
        memcpy(&value, at, 8);
        return value;
    }
    if (a->width == 4) {
        float value;
        memcpy(&value, at, 4);
        return (double)value;
    }
    uint16_t bits;
    memcpy(&bits, at, 2);
    return half(bits);
}

/* Element i in C order, put at place i of `to`. false: it is no integer of that size. */
typedef bool element_put(const npz_array *a, const uint8_t *at, void *to, int64_t i);

static bool put_f32(const npz_array *a, const uint8_t *at, void *to, int64_t i)
{
    ((float *)to)[i] = (float)as_number(a, at);
    return true;
}

static bool put_f64(const npz_array *a, const uint8_t *at, void *to, int64_t i)
{
    ((double *)to)[i] = as_number(a, at);
    return true;
}

static bool put_i64(const npz_array *a, const uint8_t *at, void *to, int64_t i)
{
    if (a->type == 'f') {
        double value = as_number(a, at);
        if (!(fabs(value) < 9e15) || value != floor(value)) return false;
        ((int64_t *)to)[i] = (int64_t)value;
    } else {
        ((int64_t *)to)[i] = as_integer(a, at);
    }
    return true;
}

static bool put_i32(const npz_array *a, const uint8_t *at, void *to, int64_t i)
{
    int64_t value;
    if (!put_i64(a, at, &value, 0) || value < INT32_MIN || value > INT32_MAX) return false;
    ((int32_t *)to)[i] = (int32_t)value;
    return true;
}

/* Walks the elements in C order, whatever their order in the file. Returns the first that was refused, or -1. */
static int64_t each(const npz_array *a, const uint8_t *elements, element_put *put, void *to)
{
    int64_t stride[NPZ_RANK], index[NPZ_RANK] = { 0 }, step = 1, from = 0;
    for (int k = 0; k < a->rank; k++) {
        int d = a->fortran ? k : a->rank - 1 - k;
        stride[d] = step;
        step *= a->shape[d];
    }
    for (int64_t i = 0; i < a->count; i++) {
        if (!put(a, elements + from * a->width, to, i)) return i;
        for (int d = a->rank - 1; d >= 0; d--) {
            from += stride[d];
            if (++index[d] < a->shape[d]) break;
            from -= stride[d] * a->shape[d];
            index[d] = 0;
        }
    }
    return -1;
}

static void add_shape(hg_text *text, int rank, const int64_t *shape)
{
    hg_text_add(text, "[");
    for (int i = 0; i < rank; i++) {
        hg_text_add(text, i ? "," : "");
        if (shape[i] < 0)
            hg_text_add(text, "any");
        else
            hg_text_add(text, "%lld", (long long)shape[i]);
    }
    hg_text_add(text, "]");
}

static hg_status find(const npz_file *file, const char *name, const npz_array **found)
{
    *found = npz_find(file, name);
    if (*found) return HG_OK;
    char *known = npz_describe(file);
    hg_fail(HG_FORMAT, "%s: no array \"%s\"; there are %s", file->path, name, known ? known : "others");
    hg_free(known);
    return HG_FORMAT;
}

static hg_status check(const npz_file *file, const npz_array *a, int rank, const int64_t *expected)
{
    if (a->type == 'O')
        return hg_fail(HG_UNSUPPORTED,
                       "%s: array \"%s\" holds Python objects, which need pickle: save it as numbers with numpy.savez",
                       file->path, a->name);
    if (!known_type(a) || a->swapped || strchr("US", a->type))
        return hg_fail(HG_UNSUPPORTED,
                       "%s: array \"%s\" is of type %s%c%d; little-endian f2 f4 f8, i1 to i8, u1 to u8 and bool can be "
                       "read",
                       file->path, a->name, a->swapped ? ">" : "", a->type, a->width);
    bool fits = rank < 0 || rank == a->rank;
    for (int i = 0; fits && i < rank; i++) fits = expected[i] < 0 || expected[i] == a->shape[i];
    if (fits) return HG_OK;
    hg_text text = { 0 };
    hg_text_add(&text, "%s: array \"%s\" has the shape ", file->path, a->name);
    add_shape(&text, a->rank, a->shape);
    hg_text_add(&text, ", expected ");
    add_shape(&text, rank, expected);
    hg_status status = text.failed ? HG_MEMORY : hg_fail(HG_FORMAT, "%s", text.data);
    hg_text_free(&text);
    return status;
}

static hg_status read_as(const npz_file *file, const char *name, int rank, const int64_t *expected, int64_t *shape,
                         element_put *put, size_t width, void **data)
{
    const npz_array *a;
    *data = NULL;
    HG_TRY(find(file, name, &a));
    HG_TRY(check(file, a, rank, expected));
    const uint8_t *bytes;
    uint8_t *owned;
    HG_TRY(npz_bytes(file, a, &bytes, &owned));
    void *out = hg_alloc((size_t)a->count + 1, width); /* never NULL for an empty array */
    int64_t bad = out ? each(a, bytes + a->header, put, out) : -1;
    hg_free(owned);
    if (!out) return HG_MEMORY;
    if (bad >= 0) {
        hg_free(out);
        return hg_fail(HG_FORMAT, "%s: array \"%s\": element %lld is no whole number of at most %zu bytes", file->path,
                       name, (long long)bad, width);
    }
    for (int i = 0; shape && i < a->rank; i++) shape[i] = a->shape[i];
    *data = out;
    return HG_OK;
}

hg_status npz_read(const npz_file *file, const char *name, hg_dtype dtype, int rank, const int64_t *expected,
                   int64_t *shape, void **data)
{
    *data = NULL;
    switch (dtype) {
    case HG_F32:
        return read_as(file, name, rank, expected, shape, put_f32, 4, data);
    case HG_F64:
        return read_as(file, name, rank, expected, shape, put_f64, 8, data);
    case HG_I32:
        return read_as(file, name, rank, expected, shape, put_i32, 4, data);
    default:
        return hg_fail(HG_INVALID, "%s: arrays are read as f32, f64 or i32", file->path);
    }
}

hg_status npz_read_i64(const npz_file *file, const char *name, int rank, const int64_t *expected, int64_t *shape,
                       int64_t **data)
{
    return read_as(file, name, rank, expected, shape, put_i64, 8, (void **)data);
}

hg_status npz_read_number(const npz_file *file, const char *name, double *number)
{
    int64_t shape[NPZ_RANK];
    double *data;
    const npz_array *a;
    HG_TRY(find(file, name, &a));
    if (a->count != 1)
        return hg_fail(HG_FORMAT, "%s: array \"%s\" has %lld elements, expected one number", file->path, name,
                       (long long)a->count);
    HG_TRY(npz_read(file, name, HG_F64, -1, NULL, shape, (void **)&data));
    *number = data[0];
    hg_free(data);
    return HG_OK;
}

/* UTF-32 or bytes, padded with zeros, to UTF-8. */
static char *take_string(const npz_array *a, const uint8_t *at)
{
    if (a->type == 'S') return hg_format("%.*s", (int)strnlen((const char *)at, (size_t)a->width), (const char *)at);
    char *text = hg_alloc((size_t)a->width + 1, 1); /* at most four bytes a character, too */
    if (!text) return NULL;
    uint8_t *to = (uint8_t *)text;
    for (int i = 0; i < a->width; i += 4) {
        uint32_t c;
        memcpy(&c, at + i, 4);
        if (c == 0) break;
        if (c > 0x10ffff || (c >= 0xd800 && c < 0xe000)) c = '?';
        if (c < 0x80) {
            *to++ = (uint8_t)c;
            continue;
        }
        int more = c < 0x800 ? 1 : c < 0x10000 ? 2 : 3;
        *to++ = (uint8_t)((0xff00 >> (more + 1) & 0xff) | c >> (6 * more));
        while (more-- > 0) *to++ = (uint8_t)(0x80 | (c >> (6 * more) & 0x3f));
    }
    return text;
}

hg_status npz_read_texts(const npz_file *file, const char *name, int *n, char ***texts)
{
    const npz_array *a;
    *n = 0;
    *texts = NULL;
    HG_TRY(find(file, name, &a));
    if (!strchr("US", a->type) || a->swapped || a->rank > 1 || a->count > 1 << 20 || a->width == 0)
        return hg_fail(a->type == 'O' ? HG_UNSUPPORTED : HG_FORMAT,
                       "%s: array \"%s\" is no text or list of texts (numpy.array of str, little-endian)", file->path,
                       name);
    const uint8_t *bytes;
    uint8_t *owned;
    HG_TRY(npz_bytes(file, a, &bytes, &owned));
    char **out = hg_alloc((size_t)a->count + 1, sizeof *out);
    bool good = out != NULL;
    for (int64_t i = 0; good && i < a->count; i++)
        good = (out[i] = take_string(a, bytes + a->header + i * a->width)) != NULL;
    hg_free(owned);
    if (!good) {
        if (out) hg_texts_free(out, (int)a->count);
        return HG_MEMORY;
    }
    *n = (int)a->count;
    *texts = out;
    return HG_OK;
}

char *npz_describe(const npz_file *file)
{
    hg_text text = { 0 };
    for (int i = 0; i < file->n && i < 40; i++) {
        const npz_array *a = file->array + i;
        hg_text_add(&text, "%s%s%s", i ? ", " : "", a->name, *a->name ? " " : "");
        add_shape(&text, a->rank, a->shape);
        if (a->type == 'O')
            hg_text_add(&text, " objects");
        else
            hg_text_add(&text, " %c%d", a->type, a->type == 'U' ? a->width / 4 : a->width);
    }
    if (file->n > 40) hg_text_add(&text, " and %d more", file->n - 40);
    if (!text.failed) return text.data;
    hg_text_free(&text);
    return NULL;
}

/* ---- writing ------------------------------------------------------------------------------------------------ */

size_t npy_size(const npz_item *item)
{
    size_t size = hg_dtype_size(item->dtype);
    for (int i = 0; i < item->rank; i++) size *= (size_t)item->shape[i];
    return size;
}

/* Version 1: header and elements begin at multiples of 64 bytes in a file of their own. */
hg_status npy_header(const char *path, const npz_item *item, char header[NPY_HEADER])
{
    const char *type = item->dtype == HG_F32   ? "<f4"
                       : item->dtype == HG_F64 ? "<f8"
                       : item->dtype == HG_I32 ? "<i4"
                                               : NULL;
    if (!type || item->rank < 0 || item->rank > NPZ_RANK)
        return hg_fail(HG_INVALID, "%s: array \"%s\": f32, f64 or i32 of at most %d indices can be written", path,
                       item->name ? item->name : "", NPZ_RANK);
    hg_text text = { 0 };
    hg_text_add(&text, "{'descr': '%s', 'fortran_order': False, 'shape': (", type);
    for (int i = 0; i < item->rank; i++)
        hg_text_add(&text, "%s%lld%s", i ? " " : "", (long long)item->shape[i],
                    item->rank == 1 || i + 1 < item->rank ? "," : "");
    hg_text_add(&text, "), }");
    if (text.failed || text.size + 11 > NPY_HEADER) {
        hg_text_free(&text);
        return hg_fail(HG_MEMORY, "%s: no memory for a header", path);
    }
    size_t total = (10 + text.size + 1 + 63) / 64 * 64, length = total - 10;
    memset(header, ' ', NPY_HEADER);
    memcpy(header, "\x93NUMPY\x01\x00", 8);
    header[8] = (char)(length & 0xff), header[9] = (char)(length >> 8);
    memcpy(header + 10, text.data, text.size);
    header[total - 1] = '\n';
    if (total < NPY_HEADER) header[total] = '\0';
    hg_text_free(&text);
    return HG_OK;
}
