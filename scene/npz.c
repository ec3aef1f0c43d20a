/* The zip around NumPy's arrays, read and written (APPNOTE.TXT 6.3: stored and deflated entries, zip64). */
#include "scene/npy.h"

#include <stdlib.h>
#include <string.h>
#include <zlib.h>

enum { END = 22, END64 = 56, LOCATOR = 20, CENTRAL = 46, LOCAL = 30, EXTRA64_LOCAL = 20, EXTRA64_CENTRAL = 28 };
enum { PEEK = 1 << 16 };            /* bytes in which the header of an array must end */
static const uint64_t RATIO = 1040; /* deflate packs at most 1032 to 1 */

static uint64_t number(const uint8_t *at, int bytes)
{
    uint64_t value = 0;
    for (int i = 0; i < bytes; i++) value |= (uint64_t)at[i] << (8 * i);
    return value;
}

/* ---- unpacking ---------------------------------------------------------------------------------------------- */

/* The first `most` bytes of an entry. Memory grows with what is really there. *taken: how many came. */
static hg_status unpack(const npz_file *file, const npz_array *a, uint64_t most, uint8_t **out, uint64_t *taken)
{
    *out = NULL;
    *taken = 0;
    uint64_t limit = a->size < most ? a->size : most;
    size_t room = (size_t)(limit < 4 * a->packed + 4096 ? limit : 4 * a->packed + 4096);
    uint8_t *bytes = hg_alloc(room + 1, 1);
    z_stream stream = { 0 };
    if (!bytes || inflateInit2(&stream, -MAX_WBITS) != Z_OK) {
        hg_free(bytes);
        return hg_fail(HG_MEMORY, "%s: no memory to unpack %s", file->path, a->name);
    }
    hg_status status = HG_OK;
    uint64_t used = 0, made = 0;
    int result = Z_OK;
    while (result == Z_OK && made < limit) {
        if (made == room) {
            size_t larger = (size_t)(limit < 2 * (uint64_t)room ? limit : 2 * (uint64_t)room);
            uint8_t *more = hg_resize(bytes, room + 1, larger + 1, 1);
            if (!more) {
                status = HG_MEMORY;
                break;
            }
            bytes = more;
            room = larger;
        }
        uint64_t in = a->packed - used, space = room - made;
        if (in > 1u << 30) in = 1u << 30;
        if (space > 1u << 30) space = 1u << 30;
        stream.next_in = file->bytes + a->at + used;
        stream.avail_in = (uInt)in;
        stream.next_out = bytes + made;
        stream.avail_out = (uInt)space;
        result = inflate(&stream, Z_NO_FLUSH); /* Z_BUF_ERROR: the packed bytes end too early */
        used += in - stream.avail_in;
        made += space - stream.avail_out;
    }
    inflateEnd(&stream);
    if (status == HG_OK && result != Z_OK && result != Z_STREAM_END && result != Z_BUF_ERROR)
        status = hg_fail(HG_FORMAT, "%s: offset %llu: the packed bytes of %s are damaged", file->path,
                         (unsigned long long)(a->at + used), a->name);
    if (status == HG_OK && made < limit)
        status = hg_fail(HG_FORMAT, "%s: offset %llu: %s unpacks to %llu bytes, %llu were announced", file->path,
                         (unsigned long long)a->at, a->name, (unsigned long long)made, (unsigned long long)a->size);
    if (status != HG_OK) {
        hg_free(bytes);
        return status;
    }
    *out = bytes;
    *taken = made;
    return HG_OK;
}

hg_status npz_bytes(const npz_file *file, const npz_array *a, const uint8_t **bytes, uint8_t **owned)
{
    *owned = NULL;
    *bytes = file->bytes + a->at;
    uint64_t taken = a->size;
    if (a->deflated) {
        HG_TRY(unpack(file, a, a->size, owned, &taken));
        *bytes = *owned;
    }
    if (a->checked && crc32_z(crc32_z(0, NULL, 0), *bytes, (size_t)a->size) != a->crc) {
        hg_free(*owned);
        *owned = NULL;
        return hg_fail(HG_FORMAT, "%s: offset %llu: the checksum of %s is wrong; the file is damaged", file->path,
                       (unsigned long long)a->at, a->name);
    }
    return HG_OK;
}

/* ---- the directory ------------------------------------------------------------------------------------------ */

typedef struct {
    uint64_t entries, size, offset;
} directory;

static hg_status find_directory(const npz_file *file, directory *found)
{
    const uint8_t *bytes = file->bytes;
    size_t size = file->size, last = size >= END ? size - END : 0, first = last > 65535 ? last - 65535 : 0, at = last;
    bool here = false;
    for (; size >= END; at--) {
        here = number(bytes + at, 4) == 0x06054b50 && at + END + number(bytes + at + 20, 2) <= size;
        if (here || at == first) break;
    }
    if (!here)
        return hg_fail(HG_FORMAT, "%s: no directory at the end of the zip (%zu bytes); it may be truncated", file->path,
                       size);
    found->entries = number(bytes + at + 10, 2);
    found->size = number(bytes + at + 12, 4);
    found->offset = number(bytes + at + 16, 4);
    if (at >= LOCATOR && number(bytes + at - LOCATOR, 4) == 0x07064b50) {
        uint64_t wide = number(bytes + at - LOCATOR + 8, 8);
        if (wide > size || size - wide < END64 || number(bytes + wide, 4) != 0x06064b50)
            return hg_fail(HG_FORMAT, "%s: offset %zu: the zip64 record would be at %llu, but it is not", file->path,
                           at - LOCATOR, (unsigned long long)wide);
        found->entries = number(bytes + wide + 32, 8);
        found->size = number(bytes + wide + 40, 8);
        found->offset = number(bytes + wide + 48, 8);
    }
    if (found->offset > size || found->size > size - found->offset || found->entries > found->size / CENTRAL)
        return hg_fail(HG_FORMAT,
                       "%s: offset %zu: a directory of %llu entries, %llu bytes from %llu on, is not in %zu bytes",
                       file->path, at, (unsigned long long)found->entries, (unsigned long long)found->size,
                       (unsigned long long)found->offset, size);
    return HG_OK;
}

/* Sizes and the offset that do not fit 32 bits stand in an extra field, in this order, where 32 bits say ffffffff. */
static hg_status read_wide(const npz_file *file, const uint8_t *extra, size_t size, uint64_t *const value[3])
{
    bool wide[3];
    int needed = 0;
    for (int i = 0; i < 3; i++) needed += wide[i] = *value[i] == 0xffffffff;
    for (size_t at = 0; needed > 0 && at + 4 <= size;) {
        size_t length = (size_t)number(extra + at + 2, 2);
        if (at + 4 + length > size) break;
        if (number(extra + at, 2) == 1) {
            size_t from = at + 4;
            for (int i = 0; i < 3 && needed > 0; i++) {
                if (!wide[i]) continue;
                if (from + 8 > at + 4 + length) break;
                *value[i] = number(extra + from, 8);
                from += 8;
                needed--;
            }
            if (needed == 0) return HG_OK;
            break;
        }
        at += 4 + length;
    }
    if (needed > 0)
        return hg_fail(HG_FORMAT, "%s: offset %zu: a zip64 entry without its sizes", file->path,
                       (size_t)(extra - file->bytes));
    return HG_OK;
}

static hg_status read_array_header(const npz_file *file, npz_array *a)
{
    uint8_t *owned = NULL;
    uint64_t taken = a->size < PEEK ? a->size : PEEK;
    const uint8_t *bytes = file->bytes + a->at;
    if (a->deflated) {
        HG_TRY(unpack(file, a, PEEK, &owned, &taken));
        bytes = owned;
    }
    hg_status status = npy_parse(file->path, a, bytes, (size_t)taken);
    hg_free(owned);
    return status;
}

/* One entry of the directory at *at; those that are no arrays are passed over. */
static hg_status read_entry(npz_file *file, const directory *d, uint64_t *at)
{
    const uint8_t *entry = file->bytes + *at;
    uint64_t end = d->offset + d->size;
    if (end - *at < CENTRAL || number(entry, 4) != 0x02014b50)
        return hg_fail(HG_FORMAT, "%s: offset %llu: no entry of the zip's directory", file->path,
                       (unsigned long long)*at);
    size_t name = (size_t)number(entry + 28, 2), extra = (size_t)number(entry + 30, 2),
           comment = (size_t)number(entry + 32, 2);
    if (end - *at - CENTRAL < name + extra + comment)
        return hg_fail(HG_FORMAT, "%s: offset %llu: an entry of the zip's directory reaches beyond it", file->path,
                       (unsigned long long)*at);
    *at += CENTRAL + name + extra + comment;
    const char *text = (const char *)entry + CENTRAL;
    if (name < 5 || memcmp(text + name - 4, ".npy", 4) != 0) return HG_OK;

    npz_array *a = file->array + file->n;
    a->name = hg_format("%.*s", (int)(name - 4), text);
    if (!a->name) return HG_MEMORY;
    file->n++;
    a->checked = true;
    a->crc = (uint32_t)number(entry + 16, 4);
    a->packed = number(entry + 20, 4);
    a->size = number(entry + 24, 4);
    uint64_t local = number(entry + 42, 4);
    HG_TRY(read_wide(file, entry + CENTRAL + name, extra, (uint64_t *const[]){ &a->size, &a->packed, &local }));
    unsigned flags = (unsigned)number(entry + 8, 2), method = (unsigned)number(entry + 10, 2);
    if (flags & 1) return hg_fail(HG_UNSUPPORTED, "%s: %s is encrypted", file->path, a->name);
    if (method != 0 && method != 8)
        return hg_fail(HG_UNSUPPORTED, "%s: %s is packed by method %u; stored (0) and deflated (8) can be read",
                       file->path, a->name, method);
    if (local > file->size || file->size - local < LOCAL || number(file->bytes + local, 4) != 0x04034b50)
        return hg_fail(HG_FORMAT, "%s: offset %llu: %s should begin there, but does not", file->path,
                       (unsigned long long)local, a->name);
    a->deflated = method == 8;
    a->at = local + LOCAL + number(file->bytes + local + 26, 2) + number(file->bytes + local + 28, 2);
    if (a->at > file->size || a->packed > file->size - a->at || (!a->deflated && a->packed != a->size) ||
        a->size / RATIO > a->packed)
        return hg_fail(HG_FORMAT, "%s: offset %llu: %s cannot be %llu bytes, packed to %llu, in a file of %zu",
                       file->path, (unsigned long long)local, a->name, (unsigned long long)a->size,
                       (unsigned long long)a->packed, file->size);
    for (int i = 0; i + 1 < file->n; i++)
        if (strcmp(file->array[i].name, a->name) == 0)
            return hg_fail(HG_FORMAT, "%s: offset %llu: a second array named %s", file->path, (unsigned long long)local,
                           a->name);
    return read_array_header(file, a);
}

static hg_status read_zip(npz_file *file)
{
    directory d = { 0 };
    HG_TRY(find_directory(file, &d));
    file->array = hg_alloc((size_t)d.entries + 1, sizeof *file->array);
    if (!file->array) return HG_MEMORY;
    uint64_t at = d.offset;
    for (uint64_t i = 0; i < d.entries; i++) HG_TRY(read_entry(file, &d, &at));
    if (file->n == 0) return hg_fail(HG_FORMAT, "%s: the zip holds no array (.npy)", file->path);
    return HG_OK;
}

static hg_status read_single(npz_file *file)
{
    file->array = hg_alloc(1, sizeof *file->array);
    if (!file->array) return HG_MEMORY;
    npz_array *a = file->array;
    a->name = hg_strdup("");
    if (!a->name) return HG_MEMORY;
    file->n = 1;
    a->size = a->packed = file->size;
    return read_array_header(file, a);
}

hg_status npz_open(npz_file **out, const char *path)
{
    *out = NULL;
    npz_file *file = hg_alloc(1, sizeof *file);
    hg_status status = file ? HG_OK : HG_MEMORY;
    void *bytes = NULL;
    if (status == HG_OK && !(file->path = hg_strdup(path))) status = HG_MEMORY;
    if (status == HG_OK) status = hg_file_read(path, &bytes, &file->size);
    if (status == HG_OK) {
        file->bytes = bytes;
        if (file->size >= 6 && memcmp(bytes, "\x93NUMPY", 6) == 0)
            status = read_single(file);
        else if (file->size >= 4 && memcmp(bytes, "PK", 2) == 0)
            status = read_zip(file);
        else
            status = hg_fail(HG_FORMAT, "%s: offset 0: neither a zip nor an array of NumPy%s", path,
                             file->size >= 2 && file->bytes[0] == 0x80
                                 ? "; it looks like a pickle: save its arrays with numpy.savez"
                                 : "");
    }
    if (status == HG_OK)
        *out = file;
    else
        npz_close(file);
    return status;
}

void npz_close(npz_file *file)
{
    if (!file) return;
    for (int i = 0; i < file->n; i++) hg_free(file->array[i].name);
    hg_free(file->array);
    hg_free(file->bytes);
    hg_free(file->path);
    hg_free(file);
}

const npz_array *npz_find(const npz_file *file, const char *name)
{
    for (int i = 0; i < file->n; i++)
        if (strcmp(file->array[i].name, name) == 0) return file->array + i;
    return NULL;
}

/* ---- writing ------------------------------------------------------------------------------------------------ */

typedef struct {
    uint8_t *bytes;
    size_t at;
} sink;

static void put(sink *to, uint64_t value, int bytes)
{
    for (int i = 0; i < bytes; i++) to->bytes[to->at++] = (uint8_t)(value >> (8 * i));
}

static void put_bytes(sink *to, const void *bytes, size_t size)
{
    if (size > 0) memcpy(to->bytes + to->at, bytes, size);
    to->at += size;
}

static void put_array(sink *to, const npz_item *item, const char *header)
{
    put_bytes(to, header, strlen(header + 10) + 10);
    put_bytes(to, item->data, npy_size(item));
}

typedef struct {
    char header[NPY_HEADER];
    uint64_t offset, size;
    uint32_t crc;
} entry;

/* What a local header and an entry of the directory have in common. Sizes always stand in the zip64 field, as NumPy has
 * it in its local headers: one layout whatever the size. The date is the first that a zip can have. */
static void put_common(sink *to, const entry *e, size_t name, size_t extra)
{
    put(to, 45, 2), put(to, 0x800, 2), put(to, 0, 2), put(to, 0, 2), put(to, 0x21, 2);
    put(to, e->crc, 4), put(to, 0xffffffff, 4), put(to, 0xffffffff, 4);
    put(to, name, 2), put(to, extra, 2);
}

static void put_name(sink *to, const char *name)
{
    put_bytes(to, name, strlen(name));
    put_bytes(to, ".npy", 4);
}

static void put_local(sink *to, const npz_item *item, entry *e)
{
    e->offset = to->at;
    e->size = strlen(e->header + 10) + 10 + npy_size(item);
    put(to, 0x04034b50, 4);
    size_t crc_at = to->at + 10;
    put_common(to, e, strlen(item->name) + 4, EXTRA64_LOCAL);
    put_name(to, item->name);
    put(to, 1, 2), put(to, 16, 2), put(to, e->size, 8), put(to, e->size, 8);
    size_t begin = to->at;
    put_array(to, item, e->header);
    e->crc = (uint32_t)crc32_z(crc32_z(0, NULL, 0), to->bytes + begin, to->at - begin);
    sink again = { to->bytes, crc_at };
    put(&again, e->crc, 4);
}

static void put_directory(sink *to, int n, const npz_item *items, const entry *entries)
{
    uint64_t begin = to->at;
    for (int i = 0; i < n; i++) {
        put(to, 0x02014b50, 4), put(to, 45, 2);
        put_common(to, entries + i, strlen(items[i].name) + 4, EXTRA64_CENTRAL);
        put(to, 0, 2), put(to, 0, 2), put(to, 0, 2), put(to, 0, 4), put(to, 0xffffffff, 4);
        put_name(to, items[i].name);
        put(to, 1, 2), put(to, 24, 2), put(to, entries[i].size, 8), put(to, entries[i].size, 8);
        put(to, entries[i].offset, 8);
    }
    uint64_t end = to->at, size = end - begin;
    put(to, 0x06064b50, 4), put(to, END64 - 12, 8), put(to, 45, 2), put(to, 45, 2), put(to, 0, 4), put(to, 0, 4);
    put(to, (uint64_t)n, 8), put(to, (uint64_t)n, 8), put(to, size, 8), put(to, begin, 8);
    put(to, 0x07064b50, 4), put(to, 0, 4), put(to, end, 8), put(to, 1, 4);
    uint64_t count = n < 0xffff ? (uint64_t)n : 0xffff;
    put(to, 0x06054b50, 4), put(to, 0, 4), put(to, count, 2), put(to, count, 2);
    put(to, size < 0xffffffff ? size : 0xffffffff, 4), put(to, begin < 0xffffffff ? begin : 0xffffffff, 4);
    put(to, 0, 2);
}

hg_status npz_write(const char *path, int n, const npz_item *items)
{
    bool single = strcmp(hg_path_extension(path), "npy") == 0;
    if (n < 1 || (single && n != 1))
        return hg_fail(HG_INVALID, "%s: %d arrays; an .npy file takes one, an .npz file at least one", path, n);
    entry *entries = hg_alloc((size_t)n, sizeof *entries);
    hg_status status = entries ? HG_OK : HG_MEMORY;
    size_t total = END64 + LOCATOR + END;
    for (int i = 0; status == HG_OK && i < n; i++) {
        status = npy_header(path, items + i, entries[i].header);
        size_t name = single ? 0 : strlen(items[i].name) + 4;
        if (status == HG_OK && name > 0xffff) status = hg_fail(HG_INVALID, "%s: an array's name is too long", path);
        total += npy_size(items + i) + NPY_HEADER + 2 * name + LOCAL + CENTRAL + EXTRA64_LOCAL + EXTRA64_CENTRAL;
    }
    sink to = { status == HG_OK ? hg_alloc(total, 1) : NULL, 0 };
    if (status == HG_OK && !to.bytes) status = HG_MEMORY;
    if (status == HG_OK && single) put_array(&to, items, entries[0].header);
    if (status == HG_OK && !single) {
        for (int i = 0; i < n; i++) put_local(&to, items + i, entries + i);
        put_directory(&to, n, items, entries);
    }
    if (status == HG_OK) status = hg_file_write(path, to.bytes, to.at);
    hg_free(to.bytes);
    hg_free(entries);
    return status;
}
