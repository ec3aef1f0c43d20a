/* Named arrays in NumPy's files: .npz (a zip of .npy) and .npy. Private to scene/.
 *
 *     npz_file *file;
 *     int64_t shape[2];
 *     HG_TRY(npz_open(&file, path));                            headers only; nothing is unpacked yet
 *     float *points = NULL;
 *     hg_status status = npz_read(file, "points", HG_F32, 2, (int64_t[]){ -1, 3 }, shape, (void **)&points);
 *     npz_close(file);
 *     ...
 *     npz_item items[] = { { "points", HG_F32, 2, { n, 3 }, points } };
 *     HG_TRY(npz_write("out.npz", 1, items));
 *
 * Read: stored and deflated entries, zip64, checksums; .npy 1 to 3, C and Fortran order (given back in C order), little-
 * endian f2 f4 f8, i1 to i8, u1 to u8, bool; text (U, S). Arrays of Python objects, structures, complex numbers and
 * big-endian numbers are listed, but refused when they are asked for. An .npy file has one array, named "". Whatever a
 * header says, no more memory is taken than a small multiple of what the file holds. */
#ifndef HG_SCENE_NPZ_H
#define HG_SCENE_NPZ_H

#include "base/base.h"

#define NPZ_RANK 6

typedef struct {
    char *name;              /* without ".npy" */
    char type;               /* f i u b: numbers; U S: text; O V c m...: cannot be read */
    bool swapped;            /* big-endian: cannot be read */
    int width;               /* bytes of an element */
    bool fortran;            /* first index fastest */
    int rank;                /* 0: one element */
    int64_t shape[NPZ_RANK]; /* of the first `rank` */
    int64_t count;           /* of elements */
    uint64_t header;         /* bytes before the elements */
    uint64_t at, packed, size;
    uint32_t crc;
    bool deflated, checked; /* an entry of a zip has a checksum */
} npz_array;

typedef struct {
    char *path;
    uint8_t *bytes;
    size_t size;
    int n;
    npz_array *array;
} npz_file;

hg_status npz_open(npz_file **file, const char *path);
void npz_close(npz_file *file);
const npz_array *npz_find(const npz_file *file, const char *name); /* NULL when it has none */
char *npz_describe(const npz_file *file); /* "points [3,4] f4, counts [3] i8": for messages; hg_free */

/* A whole array in new memory, as hg_h5_read: f32, f64 or i32; expected[i] >= 0 must match, -1 takes any; shape gets the
 * real one (may be NULL). rank -1: any, expected is not looked at, shape has NPZ_RANK places. Numbers that are not whole
 * or too large are refused for integers. */
hg_status npz_read(const npz_file *file, const char *name, hg_dtype dtype, int rank, const int64_t *expected,
                   int64_t *shape, void **data);
hg_status npz_read_i64(const npz_file *file, const char *name, int rank, const int64_t *expected, int64_t *shape,
                       int64_t **data);
/* One number (an array of one element, of any rank). */
hg_status npz_read_number(const npz_file *file, const char *name, double *number);
/* Text of rank 0 or 1, as UTF-8; free with hg_texts_free. */
hg_status npz_read_texts(const npz_file *file, const char *name, int *n, char ***texts);

typedef struct {
    const char *name; /* not used in an .npy file */
    hg_dtype dtype;   /* f32, f64 or i32 */
    int rank;
    int64_t shape[NPZ_RANK];
    const void *data;
} npz_item;
/* Atomic, not packed, the same bytes for the same arrays. A path ending in .npy takes exactly one array. */
hg_status npz_write(const char *path, int n, const npz_item *items);

#endif
