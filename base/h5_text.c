/* Attributes and lists of strings. Strings are written with a fixed length, as every HDF5 reader understands them;
 * fixed and variable ones are read. */
#include "base/h5.h"

#include <stdio.h>
#include <string.h>

static const char *object_of(const char *name) { return name == NULL || name[0] == '\0' ? "/" : name; }

/* ASCII where the text is, since VTK reads nothing else. */
static hid_t text_type(size_t length, bool ascii)
{
    hid_t type = H5Tcopy(H5T_C_S1);
    if (type < 0) return type;
    H5Tset_size(type, length > 0 ? length : 1);
    H5Tset_strpad(type, H5T_STR_NULLPAD);
    if (!ascii) H5Tset_cset(type, H5T_CSET_UTF8);
    return type;
}

static bool is_ascii(const char *text)
{
    while (*text != '\0')
        if ((unsigned char)*text++ >= 128) return false;
    return true;
}

/* ---- writing ------------------------------------------------------------------------------------------------ */

static hg_status set(hg_h5 *file, const char *object, const char *name, hid_t stored, hid_t memory, hid_t space,
                     const void *data)
{
    hg_status status = h5_writable(file, name);
    if (status == HG_OK && !hg_h5_has(file, object))
        status =
            hg_fail(HG_INVALID, "%s: \"%s\", which should get attribute \"%s\", is missing", file->path, object, name);
    if (status == HG_OK) status = h5_secure(file, 65536);
    if (status != HG_OK) return status;
    if (H5Aexists_by_name(file->file, object, name, H5P_DEFAULT) > 0)
        H5Adelete_by_name(file->file, object, name, H5P_DEFAULT);
    hid_t attribute = stored < 0 || space < 0 ? -1
                                              : H5Acreate_by_name(file->file, object, name, stored, space, H5P_DEFAULT,
                                                                  H5P_DEFAULT, H5P_DEFAULT);
    if (attribute < 0 || H5Awrite(attribute, memory, data) < 0) status = h5_refused(file, name, "attribute");
    if (attribute >= 0) H5Aclose(attribute);
    return status;
}

hg_status hg_h5_set_text(hg_h5 *file, const char *object, const char *name, const char *text)
{
    hid_t type = text_type(strlen(text), is_ascii(text)), space = H5Screate(H5S_SCALAR);
    hg_status status = set(file, object_of(object), name, type, type, space, text);
    if (space >= 0) H5Sclose(space);
    if (type >= 0) H5Tclose(type);
    return status;
}

hg_status hg_h5_set_number(hg_h5 *file, const char *object, const char *name, double number)
{
    hid_t space = H5Screate(H5S_SCALAR);
    hg_status status = set(file, object_of(object), name, H5T_IEEE_F64LE, H5T_NATIVE_DOUBLE, space, &number);
    if (space >= 0) H5Sclose(space);
    return status;
}

hg_status hg_h5_set_integers(hg_h5 *file, const char *object, const char *name, int n, const int64_t *values)
{
    hsize_t size = n > 0 ? (hsize_t)n : 0;
    hid_t space = H5Screate_simple(1, &size, NULL);
    hg_status status = set(file, object_of(object), name, H5T_STD_I64LE, H5T_NATIVE_INT64, space, values);
    if (space >= 0) H5Sclose(space);
    return status;
}

hg_status hg_h5_write_texts(hg_h5 *file, const char *name, int n, const char *const *texts)
{
    HG_TRY(h5_writable(file, name));
    if (hg_h5_has(file, name)) return hg_fail(HG_INVALID, "%s: \"%s\" is written twice", file->path, name);
    size_t length = 1;
    bool ascii = true;
    for (int i = 0; i < n; i++) {
        size_t size = strlen(texts[i]);
        if (size > length) length = size;
        ascii &= is_ascii(texts[i]);
    }
    char *packed = hg_alloc((size_t)(n > 0 ? n : 1), length);
    if (packed == NULL) return HG_MEMORY;
    hg_status status = h5_secure(file, (uint64_t)(n > 0 ? n : 1) * length);
    if (status == HG_OK) status = h5_parents(file, name);
    if (status != HG_OK) {
        hg_free(packed);
        return status;
    }
    for (int i = 0; i < n; i++) memcpy(packed + (size_t)i * length, texts[i], strlen(texts[i]));
    hsize_t size = n > 0 ? (hsize_t)n : 0;
    hid_t type = text_type(length, ascii), space = H5Screate_simple(1, &size, NULL),
          creation = H5Pcreate(H5P_DATASET_CREATE);
    if (creation >= 0) H5Pset_obj_track_times(creation, false);
    hid_t dataset = type < 0 || space < 0 || creation < 0
                        ? -1
                        : H5Dcreate2(file->file, name, type, space, H5P_DEFAULT, creation, H5P_DEFAULT);
    bool done = dataset >= 0 && (n <= 0 || H5Dwrite(dataset, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, packed) >= 0);
    status = done ? HG_OK : h5_refused(file, name, "list of strings");
    if (dataset >= 0 && H5Dclose(dataset) < 0 && status == HG_OK) status = h5_refused(file, name, "list of strings");
    if (creation >= 0) H5Pclose(creation);
    if (space >= 0) H5Sclose(space);
    if (type >= 0) H5Tclose(type);
    hg_free(packed);
    return status;
}

/* ---- reading ------------------------------------------------------------------------------------------------ */

static hg_status open_attribute(hg_h5 *file, const char *object, const char *name, hid_t *attribute, int64_t *points)
{
    h5_quiet();
    *attribute = -1;
    *points = 0;
    if (!hg_h5_has(file, object)) return hg_fail(HG_FORMAT, "%s: \"%s\" is missing", file->path, object);
    if (H5Aexists_by_name(file->file, object, name, H5P_DEFAULT) <= 0) {
        H5Eclear2(H5E_DEFAULT);
        return hg_fail(HG_FORMAT, "%s: attribute \"%s\" of \"%s\" is missing", file->path, name, object);
    }
    hid_t opened = H5Aopen_by_name(file->file, object, name, H5P_DEFAULT, H5P_DEFAULT);
    hid_t space = opened < 0 ? -1 : H5Aget_space(opened);
    hssize_t count = space < 0 ? -1 : H5Sget_simple_extent_npoints(space);
    if (space >= 0) H5Sclose(space);
    if (count < 0) {
        if (opened >= 0) H5Aclose(opened);
        return h5_refused(file, name, "attribute");
    }
    *attribute = opened;
    *points = (int64_t)count;
    return HG_OK;
}

hg_status hg_h5_get_number(hg_h5 *file, const char *object, const char *name, double *number)
{
    hid_t attribute;
    int64_t points;
    *number = 0.0;
    HG_TRY(open_attribute(file, object_of(object), name, &attribute, &points));
    hid_t type = H5Aget_type(attribute);
    H5T_class_t class = type < 0 ? H5T_NO_CLASS : H5Tget_class(type);
    hg_status status = HG_OK;
    if (points != 1 || (class != H5T_FLOAT && class != H5T_INTEGER && class != H5T_ENUM))
        status =
            hg_fail(HG_FORMAT, "%s: attribute \"%s\" of \"%s\" is not one number", file->path, name, object_of(object));
    else if (H5Aread(attribute, H5T_NATIVE_DOUBLE, number) < 0)
        status = h5_refused(file, name, "attribute");
    if (type >= 0) H5Tclose(type);
    H5Aclose(attribute);
    return status;
}

hg_status hg_h5_get_integers(hg_h5 *file, const char *object, const char *name, int n, int64_t *values)
{
    hid_t attribute;
    int64_t points;
    HG_TRY(open_attribute(file, object_of(object), name, &attribute, &points));
    hid_t type = H5Aget_type(attribute);
    hg_status status = HG_OK;
    if (points != n || type < 0 || H5Tget_class(type) != H5T_INTEGER)
        status = hg_fail(HG_FORMAT, "%s: attribute \"%s\" of \"%s\" is not a list of %d integers", file->path, name,
                         object_of(object), n);
    else if (n > 0 && H5Aread(attribute, H5T_NATIVE_INT64, values) < 0)
        status = h5_refused(file, name, "attribute");
    if (type >= 0) H5Tclose(type);
    H5Aclose(attribute);
    return status;
}

/* Copies n strings of `type` as they lie in memory after a read. */
static hg_status unpack(const char *packed, size_t width, bool variable, int64_t n, char **texts)
{
    for (int64_t i = 0; i < n; i++) {
        if (variable) {
            const char *text = ((char *const *)(const void *)packed)[i];
            texts[i] = hg_strdup(text == NULL ? "" : text);
        } else {
            const char *text = packed + (size_t)i * width;
            size_t length = strnlen(text, width);
            texts[i] = hg_alloc(length + 1, 1);
            if (texts[i] != NULL) memcpy(texts[i], text, length);
        }
        if (texts[i] == NULL) return HG_MEMORY;
    }
    return HG_OK;
}

/* Reads n strings of an attribute (dataset < 0) or a dataset. */
static hg_status read_strings(hg_h5 *file, const char *name, hid_t attribute, hid_t dataset, int64_t n, char **texts)
{
    const char *what = dataset < 0 ? "attribute" : "list of strings";
    hid_t type = dataset < 0 ? H5Aget_type(attribute) : H5Dget_type(dataset);
    if (type < 0) return h5_refused(file, name, what);
    hg_status status = HG_OK;
    bool variable = H5Tis_variable_str(type) > 0;
    size_t width = variable ? sizeof(char *) : H5Tget_size(type);
    char *packed = NULL;
    hid_t space = dataset < 0 ? H5Aget_space(attribute) : H5Dget_space(dataset);
    if (H5Tget_class(type) != H5T_STRING)
        status = hg_fail(HG_FORMAT, "%s: \"%s\" is not text", file->path, name);
    else if (!variable && n > 0 && width > file->size + 65536)
        status = hg_fail(HG_FORMAT, "%s: \"%s\" says its strings have %zu bytes, more than the file; it is damaged",
                         file->path, name, width);
    else if ((packed = hg_alloc((size_t)(n > 0 ? n : 1), width)) == NULL)
        status = HG_MEMORY;
    else if (n > 0) {
        herr_t done = dataset < 0 ? H5Aread(attribute, type, packed)
                                  : H5Dread(dataset, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, packed);
        status = done < 0 ? h5_refused(file, name, what) : unpack(packed, width, variable, n, texts);
        if (variable && done >= 0) H5Dvlen_reclaim(type, space, H5P_DEFAULT, packed);
    }
    hg_free(packed);
    if (space >= 0) H5Sclose(space);
    H5Tclose(type);
    return status;
}

hg_status hg_h5_get_text(hg_h5 *file, const char *object, const char *name, char **text)
{
    hid_t attribute;
    int64_t points;
    *text = NULL;
    HG_TRY(open_attribute(file, object_of(object), name, &attribute, &points));
    char *read[1] = { NULL };
    hg_status status = points == 1 ? read_strings(file, name, attribute, -1, 1, read)
                                   : hg_fail(HG_FORMAT, "%s: attribute \"%s\" of \"%s\" is not one text", file->path,
                                             name, object_of(object));
    H5Aclose(attribute);
    if (status == HG_OK)
        *text = read[0];
    else
        hg_free(read[0]);
    return status;
}

bool h5_attribute_is(hid_t object, const char *name, const char *text)
{
    char value[32] = { 0 };
    if (H5Aexists(object, name) <= 0) return false;
    hid_t attribute = H5Aopen(object, name, H5P_DEFAULT);
    if (attribute < 0) return false;
    hid_t type = H5Aget_type(attribute), space = H5Aget_space(attribute);
    bool same = type >= 0 && space >= 0 && H5Tget_class(type) == H5T_STRING && H5Tis_variable_str(type) == 0 &&
                H5Tget_size(type) < sizeof value && H5Sget_simple_extent_npoints(space) == 1 &&
                H5Aread(attribute, type, value) >= 0 && strcmp(value, text) == 0;
    if (space >= 0) H5Sclose(space);
    if (type >= 0) H5Tclose(type);
    H5Aclose(attribute);
    return same;
}

void hg_texts_free(char **texts, int n)
{
    for (int i = 0; texts != NULL && i < n; i++) hg_free(texts[i]);
    hg_free(texts);
}

hg_status hg_h5_read_texts(hg_h5 *file, const char *name, int *n, char ***texts)
{
    *n = 0;
    *texts = NULL;
    hid_t dataset;
    int rank;
    int64_t shape[6], count;
    HG_TRY(h5_dataset(file, name, &dataset, &rank, shape, &count));
    hg_status status =
        rank == 1 && count < INT32_MAX
            ? HG_OK
            : hg_fail(HG_FORMAT, "%s: \"%s\" has %d axes, a list of strings has one", file->path, name, rank);
    char **read = status == HG_OK ? hg_alloc((size_t)count, sizeof *read) : NULL;
    if (status == HG_OK && read == NULL) status = HG_MEMORY;
    if (status == HG_OK) status = read_strings(file, name, -1, dataset, count, read);
    H5Dclose(dataset);
    if (status != HG_OK) {
        if (read != NULL) hg_texts_free(read, (int)count);
        return status;
    }
    *n = (int)count;
    *texts = read;
    return HG_OK;
}
