/* Small files of NumPy's kind, byte by byte: what npz_write does not write (packed, Fortran, other types). */
#ifndef HG_TESTS_SMALL_ARRAYS_H
#define HG_TESTS_SMALL_ARRAYS_H

#include "scene/npz.h"
#include "tests/small_files.h"

#include <zlib.h>

/* An .npy of any header: small_npy(to, "'<f2'", false, "3,", data, 6). Returns its size. */
static inline size_t small_npy(uint8_t *to, const char *type, bool fortran, const char *shape, const void *data,
                               size_t size)
{
    char header[256];
    int length = snprintf(header, sizeof header, "{'descr': %s, 'fortran_order': %s, 'shape': (%s), }\n", type,
                          fortran ? "True" : "False", shape);
    memcpy(to, "\x93NUMPY\x01\x00", 8);
    to[8] = (uint8_t)length, to[9] = 0;
    memcpy(to + 10, header, (size_t)length);
    if (size > 0) memcpy(to + 10 + length, data, size);
    return 10 + (size_t)length + size;
}

typedef struct {
    uint8_t bytes[1 << 16], directory[1 << 12];
    size_t size, directory_size;
    int entries;
} small_zip;

static inline size_t small_number(uint8_t *to, uint64_t value, int bytes)
{
    for (int i = 0; i < bytes; i++) to[i] = (uint8_t)(value >> (8 * i));
    return (size_t)bytes;
}

static inline void small_zip_add(small_zip *zip, const char *name, const uint8_t *npy, size_t size, bool deflated)
{
    uint8_t packed[1 << 15];
    size_t packed_size = size, local = zip->size;
    if (deflated) {
        z_stream stream = {
            .next_in = (uint8_t *)npy, .avail_in = (uInt)size, .next_out = packed, .avail_out = sizeof packed
        };
        deflateInit2(&stream, 9, Z_DEFLATED, -MAX_WBITS, 8, Z_DEFAULT_STRATEGY);
        deflate(&stream, Z_FINISH);
        packed_size = stream.total_out;
        deflateEnd(&stream);
    }
    uint8_t common[64];
    size_t at = 0, length = strlen(name) + 4;
    const uint64_t fields[][2] = { { 20, 2 },
                                   { 0, 2 },
                                   { deflated ? 8 : 0, 2 },
                                   { 0, 2 },
                                   { 0x21, 2 },
                                   { crc32(0, npy, (uInt)size), 4 },
                                   { packed_size, 4 },
                                   { size, 4 },
                                   { length, 2 },
                                   { 0, 2 } };
    for (size_t i = 0; i < sizeof fields / sizeof *fields; i++)
        at += small_number(common + at, fields[i][0], (int)fields[i][1]);
    uint8_t *to = zip->bytes + zip->size;
    memcpy(to, "PK\3\4", 4);
    memcpy(to + 4, common, at);
    snprintf((char *)to + 30, length + 1, "%s.npy", name);
    memcpy(to + 30 + length, deflated ? packed : npy, packed_size);
    zip->size += 30 + length + packed_size;

    to = zip->directory + zip->directory_size;
    memset(to, 0, 46);
    memcpy(to, "PK\1\2", 4);
    small_number(to + 4, 20, 2);
    memcpy(to + 6, common, at);
    small_number(to + 42, local, 4);
    snprintf((char *)to + 46, length + 1, "%s.npy", name);
    zip->directory_size += 46 + length;
    zip->entries++;
}

/* Puts the right checksums into a zip whose bytes were changed, so that what lies behind them is tried, too. */
static inline void small_zip_mend(uint8_t *bytes, size_t size)
{
    for (size_t at = 0; at + 74 <= size; at++) {
        if (memcmp(bytes + at, "PK\1\2", 4) != 0) continue;
        uint64_t local = 0, length = 0, name = 0, extra = 0, lengths[2] = { 0 };
        memcpy(&length, bytes + at + 24, 4), memcpy(&local, bytes + at + 42, 4), memcpy(&name, bytes + at + 28, 2);
        memcpy(&extra, bytes + at + 30, 2);
        size_t wide = at + 46 + (size_t)name + 4;
        if (extra >= 28 && length == 0xffffffff && wide + 24 <= size)
            memcpy(&length, bytes + wide, 8), memcpy(&local, bytes + wide + 16, 8);
        if (local > size || size - local < 30) continue;
        memcpy(&lengths[0], bytes + local + 26, 2), memcpy(&lengths[1], bytes + local + 28, 2);
        uint64_t data = local + 30 + lengths[0] + lengths[1];
        if (data > size || length > size - data) continue;
        uint32_t crc = (uint32_t)crc32(0, bytes + data, (uInt)length);
        memcpy(bytes + at + 16, &crc, 4);
    }
}

/* The directory after the entries: then bytes [size] are the file. */
static inline void small_zip_end(small_zip *zip)
{
    uint8_t *to = zip->bytes + zip->size;
    memcpy(to, zip->directory, zip->directory_size);
    to += zip->directory_size;
    memset(to, 0, 22);
    memcpy(to, "PK\5\6", 4);
    small_number(to + 8, (uint64_t)zip->entries, 2);
    small_number(to + 10, (uint64_t)zip->entries, 2);
    small_number(to + 12, zip->directory_size, 4);
    small_number(to + 16, zip->size, 4);
    zip->size += zip->directory_size + 22;
}

#endif
