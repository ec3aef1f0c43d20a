/* cache (private): files that can be made again, kept in a folder of the user's own.
 *
 * The folder is $HAIRGRAD_CACHE, else $XDG_CACHE_HOME/hairgrad, else ~/.cache/hairgrad. It is made for the user alone
 * (0700); one that somebody else owns or may write to is refused, since what lies in it is loaded as code.
 *
 * A file is sealed: its key and a checksum stand after its end. One that is cut short, changed, or of another key does not
 * pass, and is made again. Files are made in a workshop, a folder inside the cache that is the process' own. */
#ifndef HG_BASE_CACHE_H
#define HG_BASE_CACHE_H

#include "base/base.h"

typedef struct {
    uint64_t part[2];
} hg_cache_key; /* a hash of everything that the file depends on */

hg_cache_key hg_cache_key_add(hg_cache_key key, const void *bytes, size_t size);
char *hg_cache_path(const char *folder, hg_cache_key key, const char *extension); /* hg_free */

hg_status hg_cache_folder(char **folder);                         /* made when it is not there; hg_free */
hg_status hg_cache_workshop(const char *folder, char **workshop); /* ended by hg_cache_workshop_end */
void hg_cache_workshop_end(char *workshop);                       /* removed with the files in it, and freed */
hg_status hg_cache_seal(const char *from, const char *to, hg_cache_key key); /* at once, or not at all */
hg_status hg_cache_read(const char *path, hg_cache_key key, void **bytes,
                        size_t *size);                    /* sealed, without the seal; hg_free */
bool hg_cache_sealed(const char *path, hg_cache_key key); /* there, a file of this user's, whole, of this key */

#endif
