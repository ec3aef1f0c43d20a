/* Datasets: numbers of up to six axes, whole or row by row, little-endian in the file, checked before memory is taken. */
#include "base/h5.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

/* ---- types -------------------------------------------------------------------------------------------------- */

typedef enum { AS_F32, AS_F64, AS_I32, AS_BF16, AS_I64, AS_U8 } stored;

static hid_t file_type(stored as)
{
    switch (as) {
    case AS_F32:
        return H5T_IEEE_F32LE;
    case AS_F64:
        return H5T_IEEE_F64LE;
    case AS_I32:
        return H5T_STD_I32LE;
    case AS_BF16:
        return H5T_STD_U16LE;
    case AS_I64:
        return H5T_STD_I64LE;
    case AS_U8:
        return H5T_STD_U8LE;
    }
    return -1;
}

static hid_t memory_type(stored as)
{
    switch (as) {
    case AS_F32:
        return H5T_NATIVE_FLOAT;
    case AS_F64:
        return H5T_NATIVE_DOUBLE;
    case AS_I32:
        return H5T_NATIVE_INT32;
    case AS_BF16:
        return H5T_NATIVE_UINT16;
    case AS_I64:
        return H5T_NATIVE_INT64;
    case AS_U8:
        return H5T_NATIVE_UINT8;
    }
    return -1;
}

static stored stored_as(hg_dtype dtype)
{
    return dtype == HG_F32 ? AS_F32 : dtype == HG_F64 ? AS_F64 : dtype == HG_I32 ? AS_I32 : AS_BF16;
}

static const char *shape_text(int rank, const int64_t *shape, char text[160])
{
    size_t used = 0;
    text[used++] = '[';
    for (int i = 0; i < rank && used < 130; i++) {
        int wrote = shape[i] < 0 ? snprintf(text + used, 160 - used, "%sany", i > 0 ? "," : "")
                                 : snprintf(text + used, 160 - used, "%s%" PRId64, i > 0 ? "," : "", shape[i]);
        used += (size_t)wrote;
    }
    snprintf(text + used, 160 - used, "]");
    return text;
}

/* ---- writing ------------------------------------------------------------------------------------------------ */

static hg_status mark_bf16(hid_t dataset)
{
    hid_t type = H5Tcopy(H5T_C_S1), space = H5Screate(H5S_SCALAR);
    H5Tset_size(type, 4);
    H5Tset_strpad(type, H5T_STR_NULLPAD);
    hid_t attribute = H5Acreate2(dataset, "dtype", type, space, H5P_DEFAULT, H5P_DEFAULT);
    bool done = attribute >= 0 && H5Awrite(attribute, type, "bf16") >= 0;
    if (attribute >= 0) H5Aclose(attribute);
    H5Sclose(space);
    H5Tclose(type);
    return done ? HG_OK : HG_IO;
}

/* Makes a dataset and fills it when data is not NULL. */
static hg_status make(hg_h5 *file, const char *name, stored as, int rank, const int64_t *shape, const void *data)
{
    HG_TRY(h5_writable(file, name));
    if (rank < 0 || rank > 6)
        return hg_fail(HG_INVALID, "%s: dataset \"%s\": %d axes, at most 6 are written", file->path, name, rank);
    hsize_t sizes[6];
    uint64_t bytes = H5Tget_size(file_type(as));
    bool empty = false, overflow = false;
    for (int i = 0; i < rank; i++) {
        if (shape[i] < 0)
            return hg_fail(HG_INVALID, "%s: dataset \"%s\": a negative size on axis %d", file->path, name, i);
        sizes[i] = (hsize_t)shape[i];
        empty |= shape[i] == 0;
        overflow |= __builtin_mul_overflow(bytes, (uint64_t)shape[i], &bytes);
    }
    if (overflow && !empty)
        return hg_fail(HG_INVALID, "%s: dataset \"%s\" is larger than a file can be", file->path, name);
    if (hg_h5_has(file, name)) return hg_fail(HG_INVALID, "%s: \"%s\" is written twice", file->path, name);
    HG_TRY(h5_secure(file, empty ? 0 : bytes));
    HG_TRY(h5_parents(file, name));
    hid_t space = rank == 0 ? H5Screate(H5S_SCALAR) : H5Screate_simple(rank, sizes, NULL);
    hid_t creation = H5Pcreate(H5P_DATASET_CREATE);
    if (creation >= 0) H5Pset_obj_track_times(creation, false);
    if (creation >= 0 && data == NULL) H5Pset_alloc_time(creation, H5D_ALLOC_TIME_EARLY);
    hid_t dataset = space < 0 || creation < 0
                        ? -1
                        : H5Dcreate2(file->file, name, file_type(as), space, H5P_DEFAULT, creation, H5P_DEFAULT);
    bool done = dataset >= 0;
    if (done && as == AS_BF16) done = mark_bf16(dataset) == HG_OK;
    if (done && data != NULL && !empty)
        done = H5Dwrite(dataset, memory_type(as), H5S_ALL, H5S_ALL, H5P_DEFAULT, data) >= 0;
    hg_status status = done ? HG_OK : h5_refused(file, name, "dataset");
    if (dataset >= 0 && H5Dclose(dataset) < 0 && status == HG_OK) status = h5_refused(file, name, "dataset");
    if (creation >= 0) H5Pclose(creation);
    if (space >= 0) H5Sclose(space);
    return status;
}

hg_status hg_h5_write(hg_h5 *file, const char *name, hg_dtype dtype, int rank, const int64_t *shape, const void *data)
{
    return make(file, name, stored_as(dtype), rank, shape, data);
}

hg_status hg_h5_write_i64(hg_h5 *file, const char *name, int rank, const int64_t *shape, const int64_t *data)
{
    return make(file, name, AS_I64, rank, shape, data);
}

hg_status hg_h5_write_u8(hg_h5 *file, const char *name, int rank, const int64_t *shape, const uint8_t *data)
{
    return make(file, name, AS_U8, rank, shape, data);
}

hg_status hg_h5_reserve(hg_h5 *file, const char *name, hg_dtype dtype, int rank, const int64_t *shape)
{
    return make(file, name, stored_as(dtype), rank, shape, NULL);
}

/* Selects rows [count, first) of a dataset; the memory space has their size. */
static bool select_rows(hid_t space, int64_t first, int64_t count, hid_t *memory)
{
    hsize_t sizes[H5S_MAX_RANK], start[H5S_MAX_RANK] = { 0 };
    int rank = H5Sget_simple_extent_ndims(space);
    *memory = -1;
    if (rank < 1 || H5Sget_simple_extent_dims(space, sizes, NULL) < 0) return false;
    if (first < 0 || count < 0 || (hsize_t)first > sizes[0] || (hsize_t)count > sizes[0] - (hsize_t)first) return false;
    start[0] = (hsize_t)first;
    sizes[0] = (hsize_t)count;
    *memory = H5Screate_simple(rank, sizes, NULL);
    return *memory >= 0 && H5Sselect_hyperslab(space, H5S_SELECT_SET, start, NULL, sizes, NULL) >= 0;
}

hg_status hg_h5_write_rows(hg_h5 *file, const char *name, int64_t first, int64_t count, const void *data)
{
    HG_TRY(h5_writable(file, name));
    if (!hg_h5_has(file, name))
        return hg_fail(HG_INVALID, "%s: dataset \"%s\" was not reserved before its rows", file->path, name);
    hid_t dataset = H5Dopen2(file->file, name, H5P_DEFAULT);
    if (dataset < 0) return h5_refused(file, name, "dataset");
    hid_t space = H5Dget_space(dataset), type = H5Dget_type(dataset), memory = -1;
    hid_t native = type < 0 ? -1 : H5Tget_native_type(type, H5T_DIR_ASCEND);
    hg_status status = HG_OK;
    if (space < 0 || native < 0)
        status = h5_refused(file, name, "dataset");
    else if (!select_rows(space, first, count, &memory))
        status = hg_fail(HG_INVALID, "%s: dataset \"%s\": %" PRId64 " rows from row %" PRId64 " are outside of it",
                         file->path, name, count, first);
    else if (count > 0 && H5Sget_select_npoints(space) > 0 &&
             H5Dwrite(dataset, native, memory, space, H5P_DEFAULT, data) < 0)
        status = h5_refused(file, name, "dataset");
    if (memory >= 0) H5Sclose(memory);
    if (native >= 0) H5Tclose(native);
    if (type >= 0) H5Tclose(type);
    if (space >= 0) H5Sclose(space);
    if (H5Dclose(dataset) < 0 && status == HG_OK) status = h5_refused(file, name, "dataset");
    return status;
}

/* ---- checks before reading ---------------------------------------------------------------------------------- */

hg_status h5_dataset(hg_h5 *file, const char *name, hid_t *dataset, int *rank, int64_t shape[6], int64_t *count)
{
    h5_quiet();
    *dataset = -1;
    if (!hg_h5_has(file, name)) return hg_fail(HG_FORMAT, "%s: dataset \"%s\" is missing", file->path, name);
    hid_t object = H5Oopen(file->file, name, H5P_DEFAULT);
    H5I_type_t kind = object < 0 ? H5I_BADID : H5Iget_type(object);
    if (object >= 0) H5Oclose(object);
    if (kind == H5I_GROUP) return hg_fail(HG_FORMAT, "%s: \"%s\" is a group, a dataset is needed", file->path, name);
    hid_t opened = H5Dopen2(file->file, name, H5P_DEFAULT);
    if (opened < 0) return h5_refused(file, name, "dataset");
    hid_t space = H5Dget_space(opened), type = H5Dget_type(opened), creation = H5Dget_create_plist(opened);
    hsize_t sizes[H5S_MAX_RANK];
    hg_status status = HG_OK;
    int axes = space < 0 || type < 0 || creation < 0 ? -1 : H5Sget_simple_extent_ndims(space);
    if (axes < 0 || (axes > 0 && H5Sget_simple_extent_dims(space, sizes, NULL) < 0))
        status = h5_refused(file, name, "dataset");
    else if (axes > 6)
        status = hg_fail(HG_FORMAT, "%s: dataset \"%s\" has %d axes, at most 6 are read", file->path, name, axes);
    else if (H5Sget_simple_extent_type(space) == H5S_NULL)
        status = hg_fail(HG_FORMAT, "%s: dataset \"%s\" has no space for data", file->path, name);
    else if (H5Pget_layout(creation) == H5D_VIRTUAL ||
             (H5Pget_layout(creation) == H5D_CONTIGUOUS && H5Pget_external_count(creation) > 0))
        status = hg_fail(HG_FORMAT, "%s: dataset \"%s\" keeps its data in another file, which is not read", file->path,
                         name);
    if (status == HG_OK) {
        /* A header may say any shape. Plain data cannot be larger than the file; packed data shrinks a thousandfold at most. */
        uint64_t bytes = H5Tget_size(type), limit = file->size;
        *count = 1;
        bool overflow = false, empty = false;
        for (int i = 0; i < axes; i++) empty |= sizes[i] == 0;
        for (int i = 0; i < axes; i++) {
            overflow |= sizes[i] > INT64_MAX;
            shape[i] = (int64_t)sizes[i];
            if (!empty) overflow |= __builtin_mul_overflow(bytes, (uint64_t)sizes[i], &bytes);
            overflow |= __builtin_mul_overflow(*count, (int64_t)sizes[i], count);
        }
        if (H5Pget_layout(creation) == H5D_CHUNKED)
            limit = limit > UINT64_MAX / 2048 ? UINT64_MAX : limit * 1100 + (1u << 20);
        for (int i = axes; i < 6; i++) shape[i] = 1;
        *rank = axes;
        char text[160];
        if (overflow || (!empty && bytes > limit))
            status = hg_fail(HG_FORMAT,
                             "%s: dataset \"%s\" says it is %s, more than a file of %" PRIu64
                             " bytes can hold; it is damaged",
                             file->path, name, shape_text(axes, shape, text), file->size);
    }
    if (creation >= 0) H5Pclose(creation);
    if (type >= 0) H5Tclose(type);
    if (space >= 0) H5Sclose(space);
    if (status != HG_OK)
        H5Dclose(opened);
    else
        *dataset = opened;
    return status;
}

hg_status hg_h5_shape(hg_h5 *file, const char *name, int *rank, int64_t shape[6])
{
    hid_t dataset;
    int64_t count;
    HG_TRY(h5_dataset(file, name, &dataset, rank, shape, &count));
    H5Dclose(dataset);
    return HG_OK;
}

/* ---- reading ------------------------------------------------------------------------------------------------ */

static float widen(uint16_t bits)
{
    uint32_t word = (uint32_t)bits << 16;
    float value;
    memcpy(&value, &word, sizeof value);
    return value;
}

static uint16_t narrow(float value)
{
    uint32_t word;
    memcpy(&word, &value, sizeof word);
    if (isnan(value)) return (uint16_t)(word >> 16 | 0x40);
    return (uint16_t)((word + 0x7fff + (word >> 16 & 1)) >> 16);
}

/* Reads what is selected as `as`. Integers that do not fit, and fractions where integers are wanted, are errors. */
static hg_status fetch(hg_h5 *file, const char *name, hid_t dataset, hid_t memory, hid_t space, stored as,
                       int64_t count, void *data)
{
    hid_t type = H5Dget_type(dataset);
    H5T_class_t class = type < 0 ? H5T_NO_CLASS : H5Tget_class(type);
    size_t width = type < 0 ? 0 : H5Tget_size(type);
    bool is_signed = class == H5T_INTEGER && H5Tget_sign(type) == H5T_SGN_2;
    if (type >= 0) H5Tclose(type);
    bool is_bf16 = class == H5T_INTEGER && width == 2 && h5_attribute_is(dataset, "dtype", "bf16");
    bool wants_integers = as == AS_I32 || as == AS_I64 || as == AS_U8;
    if (class != H5T_FLOAT && class != H5T_INTEGER && class != H5T_ENUM)
        return hg_fail(HG_FORMAT, "%s: dataset \"%s\" holds %s, numbers are needed", file->path, name,
                       class == H5T_STRING ? "text" : "records");
    if (wants_integers && (class == H5T_FLOAT || is_bf16))
        return hg_fail(HG_FORMAT, "%s: dataset \"%s\" holds floating-point numbers, integers are needed", file->path,
                       name);
    if (count == 0) return HG_OK;

    bool through_wide =
        (as == AS_I32 && (width > 4 || (width == 4 && !is_signed))) || (as == AS_U8 && (width > 1 || is_signed));
    bool through_bf16 = is_bf16 && as != AS_BF16, through_f32 = as == AS_BF16 && !is_bf16;
    if (!through_wide && !through_bf16 && !through_f32)
        return H5Dread(dataset, memory_type(as), memory, space, H5P_DEFAULT, data) < 0
                   ? h5_refused(file, name, "dataset")
                   : HG_OK;

    stored between = through_wide ? AS_I64 : through_bf16 ? AS_BF16 : AS_F32;
    void *buffer = hg_alloc((size_t)count, through_wide ? 8 : through_bf16 ? 2 : 4);
    if (buffer == NULL) return HG_MEMORY;
    hg_status status = HG_OK;
    if (H5Dread(dataset, memory_type(between), memory, space, H5P_DEFAULT, buffer) < 0)
        status = h5_refused(file, name, "dataset");
    for (int64_t i = 0; i < count && status == HG_OK; i++) {
        if (through_bf16) {
            float value = widen(((uint16_t *)buffer)[i]);
            if (as == AS_F32)
                ((float *)data)[i] = value;
            else
                ((double *)data)[i] = (double)value;
        } else if (through_f32) {
            ((uint16_t *)data)[i] = narrow(((float *)buffer)[i]);
        } else {
            int64_t value = ((int64_t *)buffer)[i], low = as == AS_I32 ? INT32_MIN : 0,
                    high = as == AS_I32 ? INT32_MAX : UINT8_MAX;
            if (value < low || value > high)
                status = hg_fail(
                    HG_FORMAT, "%s: dataset \"%s\": value %" PRId64 " at element %" PRId64 " is too large for an index",
                    file->path, name, value, i);
            else if (as == AS_I32)
                ((int32_t *)data)[i] = (int32_t)value;
            else
                ((uint8_t *)data)[i] = (uint8_t)value;
        }
    }
    hg_free(buffer);
    return status;
}

static hg_status read_whole(hg_h5 *file, const char *name, stored as, size_t width, int rank, const int64_t *expected,
                            int64_t *shape, void **data)
{
    *data = NULL;
    hid_t dataset;
    int found_rank;
    int64_t found[6], count;
    HG_TRY(h5_dataset(file, name, &dataset, &found_rank, found, &count));
    bool match = rank == found_rank;
    for (int i = 0; match && i < rank; i++) match = expected == NULL || expected[i] < 0 || expected[i] == found[i];
    hg_status status = HG_OK;
    if (!match) {
        char is[160], should[160];
        int64_t any[6] = { -1, -1, -1, -1, -1, -1 };
        status =
            hg_fail(HG_FORMAT, "%s: dataset \"%s\" is %s, %s is needed", file->path, name,
                    shape_text(found_rank, found, is), shape_text(rank, expected == NULL ? any : expected, should));
    }
    if (status == HG_OK && (*data = hg_alloc((size_t)count, width)) == NULL)
        status = hg_fail(HG_MEMORY, "%s: dataset \"%s\": %s", file->path, name, hg_message());
    if (status == HG_OK) status = fetch(file, name, dataset, H5S_ALL, H5S_ALL, as, count, *data);
    H5Dclose(dataset);
    if (status != HG_OK) {
        hg_free(*data);
        *data = NULL;
    } else if (shape != NULL) {
        memcpy(shape, found, (size_t)rank * sizeof *shape);
    }
    return status;
}

hg_status hg_h5_read(hg_h5 *file, const char *name, hg_dtype dtype, int rank, const int64_t *expected, int64_t *shape,
                     void **data)
{
    return read_whole(file, name, stored_as(dtype), hg_dtype_size(dtype), rank, expected, shape, data);
}

hg_status hg_h5_read_i64(hg_h5 *file, const char *name, int rank, const int64_t *expected, int64_t *shape,
                         int64_t **data)
{
    void *read = NULL;
    hg_status status = read_whole(file, name, AS_I64, sizeof **data, rank, expected, shape, &read);
    *data = read;
    return status;
}

hg_status hg_h5_read_u8(hg_h5 *file, const char *name, int rank, const int64_t *expected, int64_t *shape,
                        uint8_t **data)
{
    void *read = NULL;
    hg_status status = read_whole(file, name, AS_U8, sizeof **data, rank, expected, shape, &read);
    *data = read;
    return status;
}

hg_status hg_h5_read_rows(hg_h5 *file, const char *name, hg_dtype dtype, int64_t first, int64_t count, void *data)
{
    hid_t dataset;
    int rank;
    int64_t shape[6], all;
    HG_TRY(h5_dataset(file, name, &dataset, &rank, shape, &all));
    hid_t space = H5Dget_space(dataset), memory = -1;
    hg_status status;
    if (space < 0 || !select_rows(space, first, count, &memory))
        status =
            hg_fail(HG_INVALID, "%s: dataset \"%s\": %" PRId64 " rows from row %" PRId64 " are outside of its %" PRId64,
                    file->path, name, count, first, rank > 0 ? shape[0] : 0);
    else
        status = fetch(file, name, dataset, memory, space, stored_as(dtype), shape[0] == 0 ? 0 : all / shape[0] * count,
                       data);
    if (memory >= 0) H5Sclose(memory);
    if (space >= 0) H5Sclose(space);
    H5Dclose(dataset);
    return status;
}
