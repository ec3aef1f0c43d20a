/* Shared by the files of base/ only: writing under a temporary name in the same folder; what a plug-in registers. */
#ifndef HG_BASE_INTERNAL_H
#define HG_BASE_INTERNAL_H

#include "base/base.h"

/* Where the bytes of `path` go until they are complete. A symbolic link is followed; `*target` is the file that will be
 * replaced. Fails where path is a folder or not a regular file. Both strings are the caller's. */
hg_status hg_temporary_open(const char *path, char **target, char **temporary, int *descriptor);
/* Syncs and closes the descriptor, renames, syncs the folder. On failure the temporary file is gone, the target as it was. */
hg_status hg_temporary_commit(const char *target, const char *temporary, int descriptor);
/* "out/a.h5: it could not be written (No space left on device); what was there before is untouched" */
hg_status hg_write_failure(const char *path, int error);

/* What this thread registers while a plug-in is opened: constructors run inside dlopen. */
enum { HG_PLUGIN_ENTRIES = 256 };
typedef struct {
    hg_entry *entry[HG_PLUGIN_ENTRIES];
    int n;
    char wrong[256]; /* the first clash or mismatch; "" when there is none */
} hg_registering;
void hg_registry_watch(hg_registering *to); /* NULL: no longer */
void hg_registry_forget(hg_entry *entry);

#endif
