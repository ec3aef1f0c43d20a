/* A fuzz target is one file fuzz_NAME.c: what it does with bytes, and at least one well-formed input to begin from.
 *
 *     int fuzz_one(const uint8_t *data, size_t size)
 *     {
 *         hg_curves *curves = NULL;
 *         if (hg_curves_read(&curves, fuzz_file(data, size, "tfx")) == HG_OK) hg_curves_destroy(curves);
 *         return 0;
 *     }
 *     size_t fuzz_seed(int number, uint8_t *to, size_t room) { ... }      0: there is no seed of this number
 *
 * driver.c changes the seeds, calls fuzz_one, and keeps the input that crashed or hung. It is compiled with the
 * sanitizers by `./run test` (a few seconds per target) and `./run fuzz` (longer). */
#ifndef HG_FUZZ_H
#define HG_FUZZ_H

#include "base/base.h"

int fuzz_one(const uint8_t *data, size_t size);
size_t fuzz_seed(int number, uint8_t *to, size_t room);
/* The bytes as a file with this extension; the same path for every call. */
const char *fuzz_file(const uint8_t *data, size_t size, const char *extension);

#endif
