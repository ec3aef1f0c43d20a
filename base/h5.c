/* HDF5 files, opened and closed: the library's own error stack is silenced and becomes one sentence of ours; new files
 * live under a temporary name until they are complete; object times are off, so that the same data gives the same
 * bytes. Datasets are in h5_data.c, attributes and strings in h5_text.c. Works with HDF5 1.10 and 1.14. */
#define _GNU_SOURCE /* fallocate, memfd_create */
#include "base/h5.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

/* ---- the error stack as a sentence -------------------------------------------------------------------------- */

typedef struct {
    char first[160], system[160];
} reason;

static herr_t look(unsigned int depth, const H5E_error2_t *error, void *data)
{
    reason *why = data;
    if (error->desc == NULL) return 0;
    if (depth == 0) snprintf(why->first, sizeof why->first, "%s", error->desc);
    const char *system = strstr(error->desc, "error message = '");
    if (system != NULL && why->system[0] == '\0') {
        snprintf(why->system, sizeof why->system, "%s", system + 17);
        char *end = strchr(why->system, '\'');
        if (end != NULL) *end = '\0';
    }
    return 0;
}

/* What the system said when it refused, otherwise what the library found first. */
static const char *explain(reason *why)
{
    *why = (reason){ 0 };
    H5Ewalk2(H5E_DEFAULT, H5E_WALK_UPWARD, look, why);
    H5Eclear2(H5E_DEFAULT);
    if (why->system[0] != '\0') return why->system;
    return why->first[0] != '\0' ? why->first : "the HDF5 library gave no reason";
}

void h5_quiet(void) { H5Eset_auto2(H5E_DEFAULT, NULL, NULL); }

hg_status h5_refused(hg_h5 *file, const char *name, const char *what)
{
    reason why;
    const char *text = explain(&why);
    if (file->temporary != NULL) {
        file->failed = true;
        return hg_fail(HG_IO, "%s: %s \"%s\" cannot be written (%s); what was there before is untouched", file->path,
                       what, name, text);
    }
    return hg_fail(HG_FORMAT, "%s: %s \"%s\" cannot be read (%s)", file->path, what, name, text);
}

/* A flush that meets a full disk leaves the HDF5 library in a state in which it can neither retry nor close. So the disk
 * is asked for the space before anything is written: a full disk is found here, where it does no harm. */
hg_status h5_secure(hg_h5 *file, uint64_t more)
{
    hsize_t present = 0; /* nothing before the library has made the file */
    if (file->file >= 0 && H5Fget_filesize(file->file, &present) < 0) return h5_refused(file, "/", "file");
    uint64_t wanted;
    int error = 0;
    if (__builtin_add_overflow((uint64_t)present + 65536, more, &wanted) || wanted > INT64_MAX) error = EFBIG;
    if (error == 0 && wanted <= file->size) return HG_OK;
    struct rlimit limit;
    if (error == 0 && getrlimit(RLIMIT_FSIZE, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY &&
        wanted > limit.rlim_cur)
        error = EFBIG;
    if (error == 0 && fallocate(file->descriptor, FALLOC_FL_KEEP_SIZE, 0, (off_t)wanted) != 0) {
        error = errno;
        struct statvfs disk;
        if (error == EOPNOTSUPP &&
            fstatvfs(file->descriptor, &disk) == 0) { /* some shared disks: ask for what is free */
            uint64_t growth = wanted > file->size ? wanted - file->size : 0;
            error = growth / (disk.f_frsize > 0 ? disk.f_frsize : 1) > disk.f_bavail ? ENOSPC : 0;
        }
    }
    if (error != 0) {
        file->failed = true;
        return hg_write_failure(file->path, error);
    }
    file->size = wanted;
    return HG_OK;
}

hg_status h5_writable(hg_h5 *file, const char *name)
{
    h5_quiet();
    if (file->temporary == NULL)
        return hg_fail(HG_INVALID, "%s: was opened to read, \"%s\" cannot be written", file->path, name);
    if (file->failed) return hg_fail(HG_IO, "%s: an earlier write failed, \"%s\" is not written", file->path, name);
    return HG_OK;
}

/* ---- open --------------------------------------------------------------------------------------------------- */

static hid_t access_list(void)
{
    hid_t list = H5Pcreate(H5P_FILE_ACCESS);
    if (list < 0) return list;
    H5Pset_fclose_degree(list, H5F_CLOSE_STRONG);
#if H5_VERSION_GE(1, 10, 7)
    H5Pset_file_locking(list, false, true); /* files are replaced whole, and some shared disks refuse locks */
#endif
    return list;
}

hg_status hg_h5_open(hg_h5 **file, const char *path)
{
    *file = NULL;
    h5_quiet();
    struct stat about;
    if (stat(path, &about) != 0) return hg_fail(HG_IO, "%s: cannot be opened (%s)", path, strerror(errno));
    if (S_ISDIR(about.st_mode)) return hg_fail(HG_IO, "%s: is a folder, an HDF5 file is needed", path);
    if (access(path, R_OK) != 0) return hg_fail(HG_IO, "%s: cannot be opened (%s)", path, strerror(errno));
    if (!S_ISREG(about.st_mode)) return hg_fail(HG_IO, "%s: is a device or a pipe, an HDF5 file is needed", path);
    if (about.st_size == 0) return hg_fail(HG_FORMAT, "%s: is empty, an HDF5 file is needed", path);
    if (H5Fis_hdf5(path) <= 0) {
        H5Eclear2(H5E_DEFAULT);
        return hg_fail(HG_FORMAT, "%s: is not an HDF5 file (its signature is missing)", path);
    }
    hg_h5 *opened = hg_alloc(1, sizeof *opened);
    if (opened == NULL) return HG_MEMORY;
    opened->path = hg_strdup(path);
    opened->size = (uint64_t)about.st_size;
    opened->descriptor = -1;
    hid_t list = access_list();
    opened->file = opened->path == NULL || list < 0 ? -1 : H5Fopen(path, H5F_ACC_RDONLY, list);
    if (list >= 0) H5Pclose(list);
    if (opened->file < 0) {
        reason why;
        const char *text = explain(&why);
        hg_status status = opened->path == NULL
                               ? HG_MEMORY
                               : hg_fail(HG_FORMAT, "%s: the HDF5 file is damaged or truncated (%s)", path, text);
        hg_free(opened->path);
        hg_free(opened);
        return status;
    }
    *file = opened;
    return HG_OK;
}

/* ---- create and commit -------------------------------------------------------------------------------------- */

hg_status hg_h5_create(hg_h5 **file, const char *path)
{
    *file = NULL;
    h5_quiet();
    hg_h5 *made = hg_alloc(1, sizeof *made);
    if (made == NULL) return HG_MEMORY;
    made->file = -1;
    made->descriptor = -1;
    made->path = hg_strdup(path);
    hg_status status =
        made->path == NULL ? HG_MEMORY : hg_temporary_open(path, &made->target, &made->temporary, &made->descriptor);
    if (status != HG_OK) {
        hg_free(made->path);
        hg_free(made);
        return status;
    }
    status = h5_secure(made, 0);
    if (status != HG_OK) {
        hg_h5_close(made);
        return status;
    }
    hid_t access = access_list(), creation = H5Pcreate(H5P_FILE_CREATE);
    /* The format since 1.8 has checksums on all that describes the data: a damaged file is refused, where the library
     * could crash on a damaged one of the older format. */
    if (access >= 0) H5Pset_libver_bounds(access, H5F_LIBVER_V18, H5F_LIBVER_V18);
    if (creation >= 0) H5Pset_obj_track_times(creation, false);
    made->file = H5Fcreate(made->temporary, H5F_ACC_TRUNC, creation, access);
    if (creation >= 0) H5Pclose(creation);
    if (access >= 0) H5Pclose(access);
    if (made->file < 0) {
        reason why;
        status = hg_fail(HG_IO, "%s: cannot be written (%s); what was there before is untouched", path, explain(&why));
        hg_h5_close(made);
        return status;
    }
    *file = made;
    return HG_OK;
}

/* After a failed write the HDF5 library would try to write the rest again while closing, fail, and leave a half-freed
 * file behind that ends the process later. So its descriptor is pointed to memory that has no full disk (and takes
 * only the few pages of metadata that are left), and closing succeeds and frees all. */
static void close_nowhere(hid_t file)
{
    void *handle = NULL;
    int nowhere = memfd_create("nowhere", MFD_CLOEXEC);
    struct rlimit limit = { 0 };
    bool limited = getrlimit(RLIMIT_FSIZE, &limit) == 0 && limit.rlim_cur != limit.rlim_max;
    if (nowhere >= 0 && H5Fget_vfd_handle(file, H5P_DEFAULT, &handle) >= 0 && handle != NULL)
        dup2(nowhere, *(int *)handle);
    if (nowhere >= 0) close(nowhere);
    if (limited) setrlimit(RLIMIT_FSIZE, &(struct rlimit){ limit.rlim_max, limit.rlim_max });
    H5Fclose(file);
    if (limited) setrlimit(RLIMIT_FSIZE, &limit);
}

static void release(hg_h5 *file)
{
    if (file->descriptor >= 0) close(file->descriptor);
    hg_free(file->path);
    hg_free(file->target);
    hg_free(file->temporary);
    hg_free(file);
}

void hg_h5_close(hg_h5 *file)
{
    if (file == NULL) return;
    h5_quiet();
    if (file->file >= 0 && file->temporary != NULL)
        close_nowhere(file->file); /* nothing of it will be kept */
    else if (file->file >= 0)
        H5Fclose(file->file);
    H5Eclear2(H5E_DEFAULT);
    if (file->temporary != NULL) unlink(file->temporary);
    release(file);
}

hg_status hg_h5_commit(hg_h5 *file)
{
    h5_quiet();
    if (file->temporary == NULL) {
        hg_status status = hg_fail(HG_INVALID, "%s: was opened to read, there is nothing to commit", file->path);
        hg_h5_close(file);
        return status;
    }
    hg_status status = HG_OK;
    reason why;
    if (file->failed)
        status = hg_fail(HG_IO, "%s: a write failed before, the file is not replaced", file->path);
    else if (H5Fflush(file->file, H5F_SCOPE_GLOBAL) < 0)
        status =
            hg_fail(HG_IO, "%s: cannot be written (%s); what was there before is untouched", file->path, explain(&why));
    if (status != HG_OK) {
        hg_h5_close(file);
        return status;
    }
    if (H5Fclose(file->file) < 0) {
        file->file = -1;
        status =
            hg_fail(HG_IO, "%s: cannot be written (%s); what was there before is untouched", file->path, explain(&why));
        hg_h5_close(file);
        return status;
    }
    struct stat about; /* what was asked for beyond the end is given back */
    if (fstat(file->descriptor, &about) == 0 && ftruncate(file->descriptor, about.st_size) != 0) errno = 0;
    status = hg_temporary_commit(file->target, file->temporary, file->descriptor);
    file->descriptor = -1;
    release(file);
    return status;
}

/* ---- names -------------------------------------------------------------------------------------------------- */

/* H5Lexists wants every group on the way to exist. */
bool hg_h5_has(hg_h5 *file, const char *name)
{
    h5_quiet();
    char *path = hg_strdup(name);
    if (path == NULL) return false;
    bool found = true;
    for (char *at = path; found; at++) {
        if (*at != '/' && *at != '\0') continue;
        char kept = *at;
        *at = '\0';
        if (at != path && strcmp(path, "/") != 0) found = H5Lexists(file->file, path, H5P_DEFAULT) > 0;
        *at = kept;
        if (kept == '\0') break;
    }
    size_t length = strlen(name);
    if (found && length > 0 && strcmp(name, "/") != 0) found = H5Oexists_by_name(file->file, name, H5P_DEFAULT) > 0;
    H5Eclear2(H5E_DEFAULT);
    hg_free(path);
    return found;
}

/* Makes the first `length` characters of a path a group, one component after the other, since the library would give
 * those on the way their time of making. */
static bool make_groups(hg_h5 *file, const char *name, size_t length)
{
    hid_t creation = H5Pcreate(H5P_GROUP_CREATE);
    char *path = hg_format("%.*s", (int)length, name);
    bool done = creation >= 0 && path != NULL && H5Pset_obj_track_times(creation, false) >= 0;
    for (char *at = path; done; at++) {
        if (*at != '/' && *at != '\0') continue;
        char kept = *at;
        *at = '\0';
        if (at != path && !hg_h5_has(file, path)) {
            hid_t group = H5Gcreate2(file->file, path, H5P_DEFAULT, creation, H5P_DEFAULT);
            done = group >= 0;
            if (done) H5Gclose(group);
        }
        *at = kept;
        if (kept == '\0') break;
    }
    hg_free(path);
    if (creation >= 0) H5Pclose(creation);
    return done;
}

hg_status h5_parents(hg_h5 *file, const char *name)
{
    const char *slash = strrchr(name, '/');
    if (slash == NULL || slash == name) return HG_OK;
    return make_groups(file, name, (size_t)(slash - name)) ? HG_OK : h5_refused(file, name, "group of");
}

hg_status hg_h5_group(hg_h5 *file, const char *name)
{
    HG_TRY(h5_writable(file, name));
    if (hg_h5_has(file, name)) return HG_OK;
    HG_TRY(h5_secure(file, 0));
    return make_groups(file, name, strlen(name)) ? HG_OK : h5_refused(file, name, "group");
}

typedef struct {
    char **names;
    int count, capacity;
    bool failed;
} name_list;

static herr_t add_name(hid_t group, const char *name, const H5L_info_t *info, void *data)
{
    (void)group, (void)info;
    name_list *list = data;
    if (list->count == list->capacity) {
        int capacity = list->capacity == 0 ? 16 : list->capacity * 2;
        char **names = hg_resize(list->names, (size_t)list->count, (size_t)capacity, sizeof *names);
        if (names == NULL) return list->failed = true, -1;
        list->names = names, list->capacity = capacity;
    }
    char *copy = hg_strdup(name);
    if (copy == NULL) return list->failed = true, -1;
    list->names[list->count++] = copy;
    return 0;
}

hg_status hg_h5_names(hg_h5 *file, const char *group, int *n, char ***names)
{
    h5_quiet();
    *n = 0;
    *names = NULL;
    const char *where = group[0] == '\0' ? "/" : group;
    if (!hg_h5_has(file, where)) return hg_fail(HG_FORMAT, "%s: group \"%s\" is missing", file->path, where);
    hid_t object = H5Gopen2(file->file, where, H5P_DEFAULT);
    if (object < 0) return h5_refused(file, where, "group");
    name_list list = { 0 };
    herr_t done = H5Literate(object, H5_INDEX_NAME, H5_ITER_INC, NULL, add_name, &list);
    H5Gclose(object);
    if (done < 0) {
        hg_texts_free(list.names, list.count);
        return list.failed ? HG_MEMORY : h5_refused(file, where, "group");
    }
    *n = list.count;
    *names = list.names;
    return HG_OK;
}
