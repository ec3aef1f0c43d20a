/* glTF 2.0 (Khronos, ISO/IEC 12113): container, buffers, accessors and nodes. */
#include "scene/gltf.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

enum { MOST_NODES = 1 << 16 };

hg_status gltf_fail(const gltf_file *file, const char *format, ...)
{
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    return hg_fail(HG_FORMAT, "%s: %s", file->path, text);
}

/* ---- JSON ---------------------------------------------------------------------------------------------------- */

int gltf_count(const gltf_file *file, const char *list)
{
    return cJSON_GetArraySize(cJSON_GetObjectItemCaseSensitive(file->json, list));
}

const cJSON *gltf_item(const gltf_file *file, const char *list, int64_t index)
{
    const cJSON *array = cJSON_GetObjectItemCaseSensitive(file->json, list);
    return index >= 0 && index < INT32_MAX ? cJSON_GetArrayItem(array, (int)index) : NULL;
}

hg_status gltf_integer(const gltf_file *file, const cJSON *object, const char *where, const char *key,
                       int64_t otherwise, int64_t low, int64_t high, int64_t *value)
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(object, key);
    *value = otherwise;
    if (!item) return HG_OK;
    double number = cJSON_IsNumber(item) ? item->valuedouble : (double)NAN;
    if (!(number >= (double)low && number < (double)high) || number != floor(number))
        return gltf_fail(file, "%s: \"%s\" is not a whole number from %lld to %lld", where, key, (long long)low,
                         (long long)high - 1);
    *value = (int64_t)number;
    return HG_OK;
}

/* n numbers of an array under a key, if it is there. */
static hg_status read_numbers(const gltf_file *file, const cJSON *object, const char *where, const char *key, int n,
                              double *to, bool *there)
{
    const cJSON *array = cJSON_GetObjectItemCaseSensitive(object, key), *item;
    if (there) *there = array != NULL;
    if (!array) return HG_OK;
    int i = 0;
    cJSON_ArrayForEach(item, array)
    {
        if (i == n || !cJSON_IsNumber(item) || !isfinite(item->valuedouble)) break;
        to[i++] = item->valuedouble;
    }
    if (i < n || cJSON_GetArraySize(array) != n)
        return gltf_fail(file, "%s: \"%s\" is not a list of %d numbers", where, key, n);
    return HG_OK;
}

/* ---- container ----------------------------------------------------------------------------------------------- */

static hg_status parse(gltf_file *file, const char *text, size_t size, size_t offset)
{
    const char *end = text;
    file->json = cJSON_ParseWithLengthOpts(text, size, &end, 0);
    if (!file->json || !cJSON_IsObject(file->json))
        return gltf_fail(file, "offset %zu: not valid JSON of glTF from here on",
                         offset + (end >= text && end <= text + size ? (size_t)(end - text) : 0));
    const char *version = cJSON_GetStringValue(
        cJSON_GetObjectItemCaseSensitive(cJSON_GetObjectItemCaseSensitive(file->json, "asset"), "version"));
    if (!version || strncmp(version, "2.", 2) != 0)
        return gltf_fail(file, "asset.version is %s, expected 2.0", version ? version : "missing");
    const cJSON *required;
    cJSON_ArrayForEach(required, cJSON_GetObjectItemCaseSensitive(file->json, "extensionsRequired"))
    {
        const char *name = cJSON_GetStringValue(required);
        if (!name) return gltf_fail(file, "extensionsRequired holds something that is no name");
        bool harmless = !strcmp(name, "KHR_mesh_quantization") || !strncmp(name, "KHR_materials_", 14) ||
                        !strncmp(name, "KHR_texture_", 12) || !strncmp(name, "EXT_texture_", 12) ||
                        !strncmp(name, "KHR_lights_", 11);
        if (!harmless)
            return hg_fail(HG_UNSUPPORTED, "%s: needs the extension %s, which is not read%s", file->path, name,
                           strstr(name, "draco") || strstr(name, "meshopt") ? "; export it without compression" : "");
    }
    return HG_OK;
}

static int base64_digit(char c)
{
    if (c >= 'A' && c <= 'Z') return c - 'A';
    if (c >= 'a' && c <= 'z') return c - 'a' + 26;
    if (c >= '0' && c <= '9') return c - '0' + 52;
    return c == '+' ? 62 : c == '/' ? 63 : -1;
}

static hg_status decode(const gltf_file *file, int index, const char *text, uint8_t **out, size_t *size)
{
    size_t length = strlen(text), n = 0;
    uint8_t *bytes = hg_alloc(length / 4 * 3 + 4, 1);
    if (!bytes) return HG_MEMORY;
    uint32_t bits = 0;
    int held = 0;
    for (size_t i = 0; i < length && text[i] != '='; i++) {
        int digit = base64_digit(text[i]);
        if (digit < 0) {
            hg_free(bytes);
            return gltf_fail(file, "buffers[%d]: byte %zu of its base64 text is none", index, i);
        }
        bits = bits << 6 | (uint32_t)digit;
        held += 6;
        if (held >= 8) {
            held -= 8;
            bytes[n++] = (uint8_t)(bits >> held);
        }
    }
    *out = bytes;
    *size = n;
    return HG_OK;
}

/* A file beside this one; "%20" and the like are undone. */
static hg_status read_beside(const gltf_file *file, int index, const char *uri, void **out, size_t *size)
{
    if (strchr(uri, ':') || uri[0] == '/')
        return hg_fail(HG_UNSUPPORTED, "%s: buffers[%d]: \"%.80s\": only files beside this one are read", file->path,
                       index, uri);
    char *name = hg_strdup(uri), *folder = hg_strdup(file->path);
    if (!name || !folder) {
        hg_free(name);
        hg_free(folder);
        return HG_MEMORY;
    }
    char *to = name;
    for (const char *from = uri; *from; from++) {
        unsigned code;
        if (*from == '%' && sscanf(from + 1, "%2x", &code) == 1 && code > 0 && from[1] && from[2]) {
            *to++ = (char)code;
            from += 2;
        } else {
            *to++ = *from;
        }
    }
    *to = '\0';
    char *slash = strrchr(folder, '/');
    if (slash) *slash = '\0';
    char *path = slash ? hg_path_join(folder, name) : hg_strdup(name);
    hg_status status = path ? hg_file_read(path, out, size) : HG_MEMORY;
    hg_free(path);
    hg_free(name);
    hg_free(folder);
    return status;
}

static hg_status read_buffers(gltf_file *file, const uint8_t *chunk, size_t chunk_size)
{
    int n = gltf_count(file, "buffers");
    file->buffer = hg_alloc((size_t)n + 1, sizeof *file->buffer);
    if (!file->buffer) return HG_MEMORY;
    file->n_buffers = n;
    const cJSON *buffer;
    int i = 0;
    cJSON_ArrayForEach(buffer, cJSON_GetObjectItemCaseSensitive(file->json, "buffers"))
    {
        char where[32];
        snprintf(where, sizeof where, "buffers[%d]", i);
        const char *uri = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(buffer, "uri"));
        int64_t length;
        HG_TRY(gltf_integer(file, buffer, where, "byteLength", 0, 0, INT64_MAX / 2, &length));
        size_t size = 0;
        if (!uri) {
            if (i > 0 || !chunk) return gltf_fail(file, "%s: no uri, and no bytes in the file itself", where);
            file->buffer[i].bytes = chunk;
            size = chunk_size;
        } else if (strncmp(uri, "data:", 5) == 0) {
            const char *comma = strstr(uri, ";base64,");
            if (!comma) return gltf_fail(file, "%s: its data uri is not in base64", where);
            uint8_t *bytes = NULL;
            HG_TRY(decode(file, i, comma + 8, &bytes, &size));
            file->buffer[i].owned = bytes;
            file->buffer[i].bytes = bytes;
        } else {
            void *bytes;
            HG_TRY(read_beside(file, i, uri, &bytes, &size));
            file->buffer[i].owned = bytes;
            file->buffer[i].bytes = bytes;
        }
        if ((uint64_t)length > size)
            return gltf_fail(file, "%s: byteLength is %lld; %zu bytes are there", where, (long long)length, size);
        file->buffer[i++].size = (size_t)length;
    }
    return HG_OK;
}

/* ---- nodes --------------------------------------------------------------------------------------------------- */

static hg_status read_node(gltf_file *file, int i, const cJSON *json)
{
    gltf_node *node = file->node + i;
    char where[32];
    bool matrix;
    double m[16], q[4] = { 0, 0, 0, 1 };
    snprintf(where, sizeof where, "nodes[%d]", i);
    node->name = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(json, "name"));
    node->scale[0] = node->scale[1] = node->scale[2] = 1;
    HG_TRY(read_numbers(file, json, where, "matrix", 16, m, &matrix));
    node->is_matrix = matrix;
    for (int r = 0; matrix && r < 3; r++) /* columns in the file */
        for (int c = 0; c < 4; c++) node->matrix.m[4 * r + c] = m[4 * c + r];
    HG_TRY(read_numbers(file, json, where, "translation", 3, node->translation, NULL));
    HG_TRY(read_numbers(file, json, where, "rotation", 4, q, NULL));
    HG_TRY(read_numbers(file, json, where, "scale", 3, node->scale, NULL));
    hg_quatd turn = hg_quatd_make(q[3], q[0], q[1], q[2]);
    if (!(hg_quatd_norm(turn) > 1e-6)) return gltf_fail(file, "%s: its rotation is no quaternion", where);
    hg_quatd_store(node->rotation, hg_quatd_normalize(turn));
    const cJSON *child;
    cJSON_ArrayForEach(child, cJSON_GetObjectItemCaseSensitive(json, "children"))
    {
        double number = cJSON_IsNumber(child) ? child->valuedouble : -1;
        if (!(number >= 0 && number < file->n_nodes) || number != floor(number))
            return gltf_fail(file, "%s: a child is none of the %d nodes", where, file->n_nodes);
        if (file->node[(int)number].parent >= 0)
            return gltf_fail(file, "%s: its child %d has another parent, too", where, (int)number);
        file->node[(int)number].parent = i;
    }
    return HG_OK;
}

static hg_status read_nodes(gltf_file *file)
{
    int n = gltf_count(file, "nodes"), i = 0;
    if (n > MOST_NODES) return gltf_fail(file, "more than %d nodes", MOST_NODES);
    file->node = hg_alloc((size_t)n + 1, sizeof *file->node);
    file->order = hg_alloc((size_t)n + 1, sizeof *file->order);
    int *first = hg_alloc((size_t)n + 1, sizeof *first), *next = hg_alloc((size_t)n + 1, sizeof *next);
    hg_status status = file->node && file->order && first && next ? HG_OK : HG_MEMORY;
    if (status == HG_OK) {
        file->n_nodes = n;
        for (int k = 0; k < n; k++) file->node[k].parent = -1;
        const cJSON *json;
        cJSON_ArrayForEach(json, cJSON_GetObjectItemCaseSensitive(file->json, "nodes"))
        {
            if (status == HG_OK) status = read_node(file, i++, json);
        }
    }
    if (status == HG_OK) { /* parents first, siblings in the order of the file; lists of children number from 1 */
        int taken = 0;
        for (int k = n - 1; k >= 0; k--) {
            int parent = file->node[k].parent;
            if (parent < 0) continue;
            next[k] = first[parent];
            first[parent] = k + 1;
        }
        for (int k = 0; k < n; k++)
            if (file->node[k].parent < 0) file->order[taken++] = k;
        for (int at = 0; at < taken; at++)
            for (int k = first[file->order[at]]; k > 0; k = next[k - 1]) file->order[taken++] = k - 1;
        if (taken < n) status = gltf_fail(file, "the nodes are no tree: %d of them are their own ancestors", n - taken);
    }
    hg_free(first);
    hg_free(next);
    return status;
}

static hg_status read_file(gltf_file *file)
{
    void *bytes = NULL;
    HG_TRY(hg_file_read(file->path, &bytes, &file->size));
    file->bytes = bytes;
    const uint8_t *chunk = NULL;
    size_t chunk_size = 0;
    if (file->size < 4 || memcmp(bytes, "glTF", 4) != 0) {
        HG_TRY(parse(file, bytes, file->size, 0));
    } else {
        hg_bytes from = { .bytes = bytes, .size = file->size, .offset = 4, .path = file->path };
        uint32_t version, length, type, size;
        HG_TRY(hg_bytes_read(&from, &version, 4, "version"));
        HG_TRY(hg_bytes_read(&from, &length, 4, "length"));
        if (version != 2) return gltf_fail(file, "offset 4: version %u, expected 2", version);
        if (length > file->size)
            return gltf_fail(file, "offset 8: a length of %u bytes; the file has %zu", length, file->size);
        from.size = length;
        HG_TRY(hg_bytes_read(&from, &size, 4, "length of the JSON"));
        HG_TRY(hg_bytes_read(&from, &type, 4, "kind of the first chunk"));
        if (type != 0x4e4f534a || size > from.size - from.offset)
            return gltf_fail(file, "offset 12: the first chunk is not JSON of at most %zu bytes",
                             from.size - from.offset);
        size_t json = from.offset;
        from.offset += size;
        if (from.offset < from.size) {
            uint32_t binary;
            HG_TRY(hg_bytes_read(&from, &binary, 4, "length of the second chunk"));
            HG_TRY(hg_bytes_read(&from, &type, 4, "kind of the second chunk"));
            if (binary > from.size - from.offset)
                return gltf_fail(file, "offset %zu: a chunk of %u bytes; %zu are left", from.offset - 8, binary,
                                 from.size - from.offset);
            if (type == 0x004e4942) chunk = from.bytes + from.offset, chunk_size = binary;
        }
        HG_TRY(parse(file, (const char *)bytes + json, size, json));
    }
    HG_TRY(read_buffers(file, chunk, chunk_size));
    return read_nodes(file);
}

hg_status gltf_open(gltf_file **out, const char *path)
{
    *out = NULL;
    gltf_file *file = hg_alloc(1, sizeof *file);
    hg_status status = file && (file->path = hg_strdup(path)) ? read_file(file) : HG_MEMORY;
    if (status == HG_OK)
        *out = file;
    else
        gltf_close(file);
    return status;
}

void gltf_close(gltf_file *file)
{
    if (!file) return;
    for (int i = 0; i < file->n_buffers; i++) hg_free(file->buffer[i].owned);
    hg_free(file->buffer);
    hg_free(file->node);
    hg_free(file->order);
    cJSON_Delete(file->json);
    hg_free(file->bytes);
    hg_free(file->path);
    hg_free(file);
}

/* ---- accessors ----------------------------------------------------------------------------------------------- */

typedef struct {
    int width;
    double most; /* what a normalised integer is divided by */
} component;

static bool component_of(int64_t type, component *c)
{
    switch (type) {
    case 5120:
        *c = (component){ 1, 127 };
        return true;
    case 5121:
        *c = (component){ 1, 255 };
        return true;
    case 5122:
        *c = (component){ 2, 32767 };
        return true;
    case 5123:
        *c = (component){ 2, 65535 };
        return true;
    case 5125:
        *c = (component){ 4, 4294967295.0 };
        return true;
    case 5126:
        *c = (component){ 4, 1 };
        return true;
    default:
        return false;
    }
}

static double number_at(const uint8_t *at, int64_t type)
{
    int16_t i16;
    uint16_t u16;
    uint32_t u32;
    float f32;
    switch (type) {
    case 5120:
        return (int8_t)*at;
    case 5121:
        return *at;
    case 5122:
        memcpy(&i16, at, 2);
        return i16;
    case 5123:
        memcpy(&u16, at, 2);
        return u16;
    case 5125:
        memcpy(&u32, at, 4);
        return u32;
    default:
        memcpy(&f32, at, 4);
        return (double)f32;
    }
}

/* The bytes of `count` elements of `width` bytes from `offset` on in a buffer view. */
static hg_status view_bytes(const gltf_file *file, const char *where, int64_t index, int64_t offset, int64_t count,
                            int64_t width, const uint8_t **bytes, int64_t *stride)
{
    const cJSON *view = gltf_item(file, "bufferViews", index);
    char name[48];
    snprintf(name, sizeof name, "bufferViews[%lld]", (long long)index);
    if (!view) return gltf_fail(file, "%s: there is no %s", where, name);
    if (cJSON_GetObjectItemCaseSensitive(cJSON_GetObjectItemCaseSensitive(view, "extensions"),
                                         "EXT_meshopt_compression"))
        return hg_fail(HG_UNSUPPORTED,
                       "%s: %s is packed by EXT_meshopt_compression, which is not read; export it without compression",
                       file->path, name);
    int64_t buffer, begin, length, step;
    HG_TRY(gltf_integer(file, view, name, "buffer", -1, 0, file->n_buffers, &buffer));
    if (buffer < 0) return gltf_fail(file, "%s: it has no buffer", name);
    int64_t size = (int64_t)file->buffer[buffer].size;
    HG_TRY(gltf_integer(file, view, name, "byteOffset", 0, 0, size + 1, &begin));
    HG_TRY(gltf_integer(file, view, name, "byteLength", 0, 0, size - begin + 1, &length));
    HG_TRY(gltf_integer(file, view, name, "byteStride", width, 1, 4096, &step));
    if (step < width || offset > length ||
        (count > 0 && (length - offset < width || (length - offset - width) / step < count - 1)))
        return gltf_fail(
            file, "%s: %lld elements of %lld bytes, one every %lld from %lld on, do not fit into the %lld of %s", where,
            (long long)count, (long long)width, (long long)step, (long long)offset, (long long)length, name);
    *bytes = file->buffer[buffer].bytes + begin + offset;
    *stride = step;
    return HG_OK;
}

static hg_status fill_sparse(const gltf_file *file, const char *where, const cJSON *sparse, int64_t type,
                             int components, int64_t count, double *numbers)
{
    const cJSON *indices = cJSON_GetObjectItemCaseSensitive(sparse, "indices"),
                *values = cJSON_GetObjectItemCaseSensitive(sparse, "values");
    int64_t n, index_type, view[2], offset[2], stride[2];
    const uint8_t *bytes[2];
    component c, index;
    HG_TRY(gltf_integer(file, sparse, where, "count", 0, 0, count + 1, &n));
    HG_TRY(gltf_integer(file, indices, where, "componentType", 0, 0, 1 << 16, &index_type));
    if (!component_of(index_type, &index) || index_type == 5126 || index_type == 5120 || index_type == 5122)
        return gltf_fail(file, "%s: sparse indices of type %lld", where, (long long)index_type);
    if (!component_of(type, &c)) return gltf_fail(file, "%s: components of type %lld", where, (long long)type);
    HG_TRY(gltf_integer(file, indices, where, "bufferView", -1, 0, INT32_MAX, &view[0]));
    HG_TRY(gltf_integer(file, values, where, "bufferView", -1, 0, INT32_MAX, &view[1]));
    HG_TRY(gltf_integer(file, indices, where, "byteOffset", 0, 0, INT64_MAX / 4, &offset[0]));
    HG_TRY(gltf_integer(file, values, where, "byteOffset", 0, 0, INT64_MAX / 4, &offset[1]));
    HG_TRY(view_bytes(file, where, view[0], offset[0], n, index.width, &bytes[0], &stride[0]));
    HG_TRY(view_bytes(file, where, view[1], offset[1], n, (int64_t)c.width * components, &bytes[1], &stride[1]));
    for (int64_t i = 0; i < n; i++) {
        int64_t to = (int64_t)number_at(bytes[0] + i * stride[0], index_type);
        if (to >= count)
            return gltf_fail(file, "%s: sparse index %lld is not below %lld", where, (long long)to, (long long)count);
        for (int k = 0; k < components; k++)
            numbers[to * components + k] = number_at(bytes[1] + i * stride[1] + k * c.width, type);
    }
    return HG_OK;
}

static int components_of(const char *type)
{
    static const struct {
        const char *name;
        int n;
    } types[] = { { "SCALAR", 1 }, { "VEC2", 2 }, { "VEC3", 3 }, { "VEC4", 4 },
                  { "MAT2", 4 },   { "MAT3", 9 }, { "MAT4", 16 } };
    for (size_t i = 0; type && i < sizeof types / sizeof *types; i++)
        if (strcmp(type, types[i].name) == 0) return types[i].n;
    return 0;
}

hg_status gltf_read(const gltf_file *file, int64_t accessor, int components, int64_t *count, double **out)
{
    char where[48];
    const cJSON *json = gltf_item(file, "accessors", accessor);
    *out = NULL;
    *count = 0;
    snprintf(where, sizeof where, "accessors[%lld]", (long long)accessor);
    if (!json) return gltf_fail(file, "there is no %s", where);
    const char *shape = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(json, "type"));
    int n = components_of(shape);
    if (n == 0 || (components > 0 && n != components))
        return gltf_fail(file, "%s: its type is %s, expected %d numbers an element", where, shape ? shape : "missing",
                         components);
    int64_t type, view, offset, stride;
    component c;
    HG_TRY(gltf_integer(file, json, where, "componentType", 0, 0, 1 << 16, &type));
    if (!component_of(type, &c)) return gltf_fail(file, "%s: unknown componentType %lld", where, (long long)type);
    HG_TRY(gltf_integer(file, json, where, "count", 0, 1, INT32_MAX / 16, count));
    HG_TRY(gltf_integer(file, json, where, "bufferView", -1, 0, INT32_MAX, &view));
    HG_TRY(gltf_integer(file, json, where, "byteOffset", 0, 0, INT64_MAX / 4, &offset));
    if (*count < 1) return gltf_fail(file, "%s: no count", where);
    const uint8_t *bytes = NULL;
    const cJSON *sparse = cJSON_GetObjectItemCaseSensitive(json, "sparse");
    if (view >= 0)
        HG_TRY(view_bytes(file, where, view, offset, *count, (int64_t)c.width * n, &bytes, &stride));
    else if ((size_t)*count > file->size) /* zeros: as many as the rest of the file could go with */
        return gltf_fail(file, "%s: %lld elements without a bufferView", where, (long long)*count);
    double *numbers = hg_alloc((size_t)*count, (size_t)n * sizeof *numbers);
    if (!numbers) return HG_MEMORY;
    for (int64_t i = 0; bytes && i < *count; i++)
        for (int k = 0; k < n; k++) numbers[i * n + k] = number_at(bytes + i * stride + k * c.width, type);
    hg_status status = sparse ? fill_sparse(file, where, sparse, type, n, *count, numbers) : HG_OK;
    bool normalised = cJSON_IsTrue(cJSON_GetObjectItemCaseSensitive(json, "normalized"));
    for (int64_t i = 0; status == HG_OK && i < *count * n; i++) {
        if (!isfinite(numbers[i]))
            status = hg_fail(HG_NUMERIC, "%s: %s: element %lld is not finite", file->path, where, (long long)(i / n));
        if (normalised && type != 5126) numbers[i] = fmax(numbers[i] / c.most, -1);
    }
    if (status != HG_OK) {
        hg_free(numbers);
        return status;
    }
    *out = numbers;
    return HG_OK;
}

/* ---- transforms ---------------------------------------------------------------------------------------------- */

gltf_affine gltf_multiply(const gltf_affine *a, const gltf_affine *b)
{
    gltf_affine c;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++) {
            c.m[4 * i + j] = j == 3 ? a->m[4 * i + 3] : 0;
            for (int k = 0; k < 3; k++) c.m[4 * i + j] += a->m[4 * i + k] * b->m[4 * k + j];
        }
    return c;
}

bool gltf_invert(const gltf_affine *a, gltf_affine *inverse)
{
    const double *m = a->m;
    double c[9] = { m[5] * m[10] - m[6] * m[9], m[2] * m[9] - m[1] * m[10], m[1] * m[6] - m[2] * m[5],
                    m[6] * m[8] - m[4] * m[10], m[0] * m[10] - m[2] * m[8], m[2] * m[4] - m[0] * m[6],
                    m[4] * m[9] - m[5] * m[8],  m[1] * m[8] - m[0] * m[9],  m[0] * m[5] - m[1] * m[4] };
    double determinant = m[0] * c[0] + m[1] * c[3] + m[2] * c[6], size = 0;
    for (int i = 0; i < 12; i++)
        if (i % 4 < 3) size = fmax(size, fabs(m[i]));
    if (!(fabs(determinant) > 1e-12 * size * size * size)) return false;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) inverse->m[4 * i + j] = c[3 * i + j] / determinant;
        inverse->m[4 * i + 3] = -(c[3 * i] * m[3] + c[3 * i + 1] * m[7] + c[3 * i + 2] * m[11]) / determinant;
    }
    for (int i = 0; i < 12; i++)
        if (!isfinite(inverse->m[i])) return false;
    return true;
}

hg_vec3d gltf_direction(const gltf_affine *a, hg_vec3d d)
{
    const double *m = a->m;
    return hg_vec3d_make(m[0] * d.x + m[1] * d.y + m[2] * d.z, m[4] * d.x + m[5] * d.y + m[6] * d.z,
                         m[8] * d.x + m[9] * d.y + m[10] * d.z);
}

hg_vec3d gltf_point(const gltf_affine *a, hg_vec3d p)
{
    return hg_vec3d_add(gltf_direction(a, p), hg_vec3d_make(a->m[3], a->m[7], a->m[11]));
}

hg_quatd gltf_rotation(const gltf_affine *a)
{
    const double *m = a->m;
    hg_vec3d x = hg_vec3d_normalize(hg_vec3d_make(m[0], m[4], m[8])), y = hg_vec3d_make(m[1], m[5], m[9]);
    y = hg_vec3d_normalize(hg_vec3d_add_scaled(y, -hg_vec3d_dot(x, y), x));
    if (!(hg_vec3d_norm(x) > 0.5) || !(hg_vec3d_norm(y) > 0.5)) return hg_quatd_identity(); /* scaled to nothing */
    return hg_quatd_normalize(hg_quatd_from_columns(x, y, hg_vec3d_cross(x, y)));
}

gltf_affine gltf_local(const gltf_node *node)
{
    if (node->is_matrix) return node->matrix;
    double turn[9];
    gltf_affine a;
    hg_quatd_to_matrix(hg_quatd_load(node->rotation), turn);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) a.m[4 * i + j] = turn[3 * i + j] * node->scale[j];
        a.m[4 * i + 3] = node->translation[i];
    }
    return a;
}

void gltf_globals(const gltf_file *file, const gltf_node *nodes, const gltf_affine *top, gltf_affine *global)
{
    for (int i = 0; i < file->n_nodes; i++) {
        int node = file->order[i], parent = nodes[node].parent;
        gltf_affine local = gltf_local(nodes + node);
        global[node] = gltf_multiply(parent < 0 ? top : global + parent, &local);
    }
}

gltf_affine gltf_top(const scene_axes *axes)
{
    double s = axes->scale;
    if (axes->z_up) return (gltf_affine){ { s, 0, 0, 0, 0, 0, s, 0, 0, -s, 0, 0 } };
    return (gltf_affine){ { s, 0, 0, 0, 0, s, 0, 0, 0, 0, s, 0 } };
}
