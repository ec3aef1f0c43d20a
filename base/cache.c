/* The cache of files that can be made again: the user's own folder, sealed files, workshops. */
#include "base/cache.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

/* ---- keys --------------------------------------------------------------------------------------------------- */

hg_cache_key hg_cache_key_add(hg_cache_key key, const void *bytes, size_t size)
{
    /* two hashes that see the bytes after different beginnings; the size keeps parts apart */
    for (int i = 0; i < 2; i++) {
        key.part[i] = hg_hash(&size, sizeof size, key.part[i] ^ (i ? 0x9e3779b97f4a7c15u : 0));
        key.part[i] = hg_hash(bytes, size, key.part[i]);
    }
    return key;
}

char *hg_cache_path(const char *folder, hg_cache_key key, const char *extension)
{
    return hg_format("%s/%016llx%016llx.%s", folder, (unsigned long long)key.part[0], (unsigned long long)key.part[1],
                     extension);
}

/* ---- the folder --------------------------------------------------------------------------------------------- */

static char *folder_path(void)
{
    const char *own = getenv("HAIRGRAD_CACHE"), *shared = getenv("XDG_CACHE_HOME"), *home = getenv("HOME");
    if (own && *own) return hg_strdup(own);
    if (shared && *shared == '/') return hg_path_join(shared, "hairgrad"); /* the standard: others are ignored */
    if (home && *home == '/') return hg_path_join(home, ".cache/hairgrad");
    hg_fail(HG_IO, "there is no cache folder: neither HAIRGRAD_CACHE nor HOME is set");
    return NULL;
}

static hg_status make_private(const char *path)
{
    char *parent = hg_strdup(path);
    if (!parent) return HG_MEMORY;
    char *slash = strrchr(parent, '/');
    hg_status status = HG_OK;
    if (slash && slash != parent) {
        *slash = '\0';
        status = hg_folder_create(parent);
    }
    hg_free(parent);
    if (status == HG_OK && mkdir(path, 0700) != 0 && errno != EEXIST)
        status = hg_fail(HG_IO, "%s: the cache folder cannot be made (%s)", path, strerror(errno));
    return status;
}

/* Leftovers of processes that were killed while they made something. */
static void sweep(const char *folder)
{
    DIR *open = opendir(folder);
    for (struct dirent *entry; open && (entry = readdir(open));) {
        if (strncmp(entry->d_name, "making-", 7) != 0) continue;
        char *path = hg_path_join(folder, entry->d_name);
        struct stat about;
        if (path && lstat(path, &about) == 0 && S_ISDIR(about.st_mode) && time(NULL) - about.st_mtime > 3600)
            hg_cache_workshop_end(path);
        else
            hg_free(path);
    }
    if (open) closedir(open);
}

hg_status hg_cache_folder(char **folder)
{
    char *path = *folder = folder_path();
    if (!path) return HG_IO;
    hg_status status = make_private(path);
    struct stat about;
    if (status == HG_OK && stat(path, &about) != 0)
        status = hg_fail(HG_IO, "%s: the cache folder cannot be looked at (%s)", path, strerror(errno));
    else if (status == HG_OK && !S_ISDIR(about.st_mode))
        status = hg_fail(HG_IO, "%s: the cache folder is a file", path);
    else if (status == HG_OK && about.st_uid != geteuid())
        status = hg_fail(HG_IO, "%s: the cache folder belongs to somebody else", path);
    else if (status == HG_OK && (about.st_mode & 022))
        status = hg_fail(HG_IO, "%s: others may write to the cache folder; chmod 700 makes it yours", path);
    if (status == HG_OK) return HG_OK;
    hg_free(path);
    *folder = NULL;
    return status;
}

/* ---- workshops ---------------------------------------------------------------------------------------------- */

hg_status hg_cache_workshop(const char *folder, char **workshop)
{
    sweep(folder);
    *workshop = hg_path_join(folder, "making-XXXXXX");
    if (!*workshop) return HG_MEMORY;
    if (mkdtemp(*workshop)) return HG_OK;
    hg_status status = hg_fail(HG_IO, "%s: the cache folder cannot be written (%s)", folder, strerror(errno));
    hg_free(*workshop);
    *workshop = NULL;
    return status;
}

void hg_cache_workshop_end(char *workshop)
{
    if (!workshop) return;
    DIR *open = opendir(workshop);
    for (struct dirent *entry; open && (entry = readdir(open));) {
        char *path = hg_path_join(workshop, entry->d_name);
        if (path) unlink(path); /* "." and ".." are folders, which it leaves */
        hg_free(path);
    }
    if (open) closedir(open);
    rmdir(workshop);
    hg_free(workshop);
}

/* ---- sealed files ------------------------------------------------------------------------------------------- */

typedef struct {
    char mark[16];
    hg_cache_key key, sum;
} seal;

static seal seal_of(const void *bytes, size_t size, hg_cache_key key)
{
    seal s = { .mark = "hairgrad sealed", .key = key, .sum = key };
    s.sum = hg_cache_key_add(s.sum, bytes, size);
    return s;
}

hg_status hg_cache_seal(const char *from, const char *to, hg_cache_key key)
{
    void *bytes;
    size_t size;
    HG_TRY(hg_file_read(from, &bytes, &size));
    const seal s = seal_of(bytes, size, key);
    char *grown = hg_resize(bytes, size, size + sizeof s, 1);
    if (!grown) {
        hg_free(bytes);
        return HG_MEMORY;
    }
    memcpy(grown + size, &s, sizeof s);
    struct stat about;
    if (lstat(to, &about) == 0 && S_ISLNK(about.st_mode)) unlink(to); /* what it points to is not the cache's */
    hg_status status = hg_file_write(to, grown, size + sizeof s);
    hg_free(grown);
    return status;
}

hg_status hg_cache_read(const char *path, hg_cache_key key, void **bytes, size_t *size)
{
    struct stat about;
    *bytes = NULL;
    if (lstat(path, &about) != 0) return hg_fail(HG_IO, "%s: not in the cache", path);
    if (!S_ISREG(about.st_mode) || about.st_uid != geteuid())
        return hg_fail(HG_IO, "%s: not a file of this user's", path);
    HG_TRY(hg_file_read(path, bytes, size));
    seal s = { 0 };
    if (*size > sizeof s) {
        *size -= sizeof s;
        const seal expected = seal_of(*bytes, *size, key);
        memcpy(&s, (const char *)*bytes + *size, sizeof s);
        if (memcmp(&s, &expected, sizeof s) == 0) return HG_OK;
    }
    hg_free(*bytes);
    *bytes = NULL;
    return hg_fail(HG_IO, "%s: it is not whole, or was made from something else", path);
}

bool hg_cache_sealed(const char *path, hg_cache_key key)
{
    void *bytes;
    size_t size;
    const bool good = hg_cache_read(path, key, &bytes, &size) == HG_OK;
    hg_free(bytes);
    return good;
}
