/* One array of NumPy: its header, and its elements as other numbers. Private to npz.c and npy.c. */
#ifndef HG_SCENE_NPY_H
#define HG_SCENE_NPY_H

#include "scene/npz.h"

enum { NPY_HEADER = 256 }; /* bytes of a header that is written, with its end */

/* type, shape... of an array from its first bytes; a->size is that of header and elements. */
hg_status npy_parse(const char *path, npz_array *a, const uint8_t *bytes, size_t size);
/* All bytes of an array, header too, their checksum compared. *owned is to be freed. */
hg_status npz_bytes(const npz_file *file, const npz_array *a, const uint8_t **bytes, uint8_t **owned);

hg_status npy_header(const char *path, const npz_item *item, char header[NPY_HEADER]); /* text from byte 10 on */
size_t npy_size(const npz_item *item);                                                 /* bytes of the elements */

#endif
