/* Shared by h5.c, h5_data.c and h5_text.c. */
#ifndef HG_BASE_H5_H
#define HG_BASE_H5_H

#define H5_USE_110_API
#include "base/internal.h"

#include <hdf5.h>

struct hg_h5 {
    hid_t file;
    char *path;               /* as the caller wrote it */
    uint64_t size;            /* bytes of a file that is read; bytes of disk secured for one that is written */
    char *target, *temporary; /* of a file that is written; NULL when reading */
    int descriptor;
    bool failed; /* a write failed: it will not be committed */
};

void h5_quiet(void);
/* The library refused: HG_IO for a file that is written (it will not be committed), HG_FORMAT for one that is read. */
hg_status h5_refused(hg_h5 *file, const char *name, const char *what);
hg_status h5_writable(hg_h5 *file, const char *name);
hg_status h5_secure(hg_h5 *file, uint64_t more);     /* takes the disk space for what is there and `more` bytes */
hg_status h5_parents(hg_h5 *file, const char *name); /* makes the groups on the way to a name */
/* Opens a dataset that is read, after checking that it is one, is stored in this file, and is no larger than the file
 * can hold. Sizes beyond rank are 1. */
hg_status h5_dataset(hg_h5 *file, const char *name, hid_t *dataset, int *rank, int64_t shape[6], int64_t *count);
bool h5_attribute_is(hid_t object, const char *name, const char *text);

#endif
