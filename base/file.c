/* Files: whole reads, and writes that either replace the old file completely or leave it as it was. */
#include "base/internal.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* ---- reading ------------------------------------------------------------------------------------------------ */

hg_status hg_file_read(const char *path, void **bytes, size_t *size)
{
    *bytes = NULL;
    *size = 0;
    int descriptor = open(path, O_RDONLY | O_CLOEXEC);
    if (descriptor < 0) return hg_fail(HG_IO, "%s: cannot be opened (%s)", path, strerror(errno));
    struct stat about;
    if (fstat(descriptor, &about) != 0 || S_ISDIR(about.st_mode)) {
        close(descriptor);
        return hg_fail(HG_IO, "%s: is a folder, a file is needed", path);
    }
    /* A pipe has no size: the buffer grows until the end is reached. */
    size_t capacity = S_ISREG(about.st_mode) && about.st_size > 0 ? (size_t)about.st_size + 1 : 65536, used = 0;
    char *data = hg_alloc(capacity, 1);
    if (data == NULL) {
        close(descriptor);
        return hg_fail(HG_MEMORY, "%s: %s", path, hg_message());
    }
    for (;;) {
        if (used + 1 >= capacity) {
            char probe;
            ssize_t more = read(descriptor, &probe, 1);
            if (more < 0 && errno == EINTR) continue;
            if (more == 0) break;
            char *larger = more < 0 ? NULL : hg_resize(data, used, capacity * 2, 1);
            if (larger == NULL) {
                hg_status status = more < 0 ? hg_fail(HG_IO, "%s: cannot be read (%s)", path, strerror(errno))
                                            : hg_fail(HG_MEMORY, "%s: %s", path, hg_message());
                hg_free(data);
                close(descriptor);
                return status;
            }
            data = larger;
            capacity *= 2;
            data[used++] = probe;
        }
        ssize_t got = read(descriptor, data + used, capacity - 1 - used);
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) {
            hg_status status = hg_fail(HG_IO, "%s: cannot be read (%s)", path, strerror(errno));
            hg_free(data);
            close(descriptor);
            return status;
        }
        if (got == 0) break;
        used += (size_t)got;
    }
    close(descriptor);
    data[used] = '\0';
    *bytes = data;
    *size = used;
    return HG_OK;
}

bool hg_file_exists(const char *path)
{
    struct stat about;
    return stat(path, &about) == 0;
}

/* ---- writing ------------------------------------------------------------------------------------------------ */

hg_status hg_write_failure(const char *path, int error)
{
    return hg_fail(HG_IO, "%s: cannot be written (%s); what was there before is untouched", path, strerror(error));
}

hg_status hg_temporary_open(const char *path, char **target, char **temporary, int *descriptor)
{
    static atomic_uint serial;
    *target = *temporary = NULL;
    *descriptor = -1;
    struct stat about;
    bool exists = stat(path, &about) == 0;
    if (exists && S_ISDIR(about.st_mode)) return hg_fail(HG_IO, "%s: is a folder, a file name is needed", path);
    if (exists && !S_ISREG(about.st_mode))
        return hg_fail(HG_IO, "%s: is a device or a pipe, a file name is needed", path);
    char resolved[PATH_MAX];
    *target = hg_strdup(exists && realpath(path, resolved) != NULL ? resolved : path);
    if (*target != NULL)
        *temporary = hg_format("%s.part-%ld-%u", *target, (long)getpid(), atomic_fetch_add(&serial, 1u));
    if (*temporary == NULL) {
        hg_free(*target);
        *target = NULL;
        return HG_MEMORY;
    }
    *descriptor = open(*temporary, O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, exists ? about.st_mode & 0777 : 0666);
    if (*descriptor < 0) {
        hg_status status = hg_write_failure(path, errno);
        hg_free(*target);
        hg_free(*temporary);
        *target = *temporary = NULL;
        return status;
    }
    return HG_OK;
}

/* The rename itself is on disk only when the folder is. Some file systems cannot sync a folder: that is no failure. */
static void sync_folder(const char *path)
{
    char *folder = hg_strdup(path);
    if (folder == NULL) return;
    char *slash = strrchr(folder, '/');
    if (slash == folder)
        slash[1] = '\0';
    else if (slash != NULL)
        *slash = '\0';
    int descriptor = open(slash == NULL ? "." : folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (descriptor >= 0) {
        fsync(descriptor);
        close(descriptor);
    }
    hg_free(folder);
}

hg_status hg_temporary_commit(const char *target, const char *temporary, int descriptor)
{
    int error = fsync(descriptor) != 0 ? errno : 0;
    if (close(descriptor) != 0 && error == 0) error = errno;
    if (error == 0 && rename(temporary, target) != 0) error = errno;
    if (error != 0) {
        unlink(temporary);
        return hg_write_failure(target, error);
    }
    sync_folder(target);
    return HG_OK;
}

static int write_all(int descriptor, const char *bytes, size_t size)
{
    while (size > 0) {
        ssize_t written = write(descriptor, bytes, size < 1u << 30 ? size : 1u << 30);
        if (written < 0 && errno == EINTR) continue;
        if (written < 0) return errno;
        bytes += written;
        size -= (size_t)written;
    }
    return 0;
}

hg_status hg_file_write(const char *path, const void *bytes, size_t size)
{
    struct stat about;
    if (stat(path, &about) == 0 && !S_ISREG(about.st_mode) && !S_ISDIR(about.st_mode)) { /* /dev/stdout, a pipe */
        int descriptor = open(path, O_WRONLY | O_CLOEXEC);
        int error = descriptor < 0 ? errno : write_all(descriptor, bytes, size);
        if (descriptor >= 0 && close(descriptor) != 0 && error == 0) error = errno;
        return error == 0 ? HG_OK : hg_fail(HG_IO, "%s: cannot be written (%s)", path, strerror(error));
    }
    char *target, *temporary;
    int descriptor;
    HG_TRY(hg_temporary_open(path, &target, &temporary, &descriptor));
    hg_status status;
    int error = write_all(descriptor, bytes, size);
    if (error != 0) {
        close(descriptor);
        unlink(temporary);
        status = hg_write_failure(path, error);
    } else {
        status = hg_temporary_commit(target, temporary, descriptor);
    }
    hg_free(target);
    hg_free(temporary);
    return status;
}

/* ---- folders and paths -------------------------------------------------------------------------------------- */

hg_status hg_folder_create(const char *path)
{
    char *part = hg_strdup(path);
    if (part == NULL) return HG_MEMORY;
    hg_status status = HG_OK;
    for (char *at = part; status == HG_OK; at++) {
        if (*at != '/' && *at != '\0') continue;
        char kept = *at;
        *at = '\0';
        struct stat about;
        if (at != part && mkdir(part, 0777) != 0) {
            int error = errno;
            if (stat(part, &about) != 0)
                status = hg_fail(HG_IO, "%s: the folder cannot be made (%s)", path, strerror(error));
            else if (!S_ISDIR(about.st_mode))
                status = hg_fail(HG_IO, "%s: the folder cannot be made: %s is a file", path, part);
        }
        *at = kept;
        if (kept == '\0') break;
    }
    hg_free(part);
    return status;
}

char *hg_path_join(const char *folder, const char *name)
{
    size_t length = strlen(folder);
    if (length == 0 || name[0] == '/') return hg_strdup(name);
    return hg_format(folder[length - 1] == '/' ? "%s%s" : "%s/%s", folder, name);
}

const char *hg_path_extension(const char *path)
{
    const char *name = strrchr(path, '/');
    name = name == NULL ? path : name + 1;
    const char *dot = strrchr(name, '.');
    return dot == NULL || dot == name ? "" : dot + 1;
}
