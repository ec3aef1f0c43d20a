/* chunks: all parameters as a table of pieces, for kernels that step all of them in one launch; private to train/. */
#ifndef HG_TRAIN_CHUNKS_H
#define HG_TRAIN_CHUNKS_H

#include "train/chunk_kernel.h"
#include "train/train.h"

typedef struct {
    hg_ctx *ctx;
    hg_tensor **params;
    hg_chunk *chunks;  /* on the host */
    hg_tensor *device; /* the same on a device; NULL: the host's is it */
    int64_t n_chunks, total;
    int n;
} hg_chunks;

/* Zeroed before. Pieces depend on the shapes alone, on a GPU they are smaller. */
hg_status hg_chunks_create(hg_chunks *chunks, hg_ctx *ctx, int n, hg_tensor *const *params);
void hg_chunks_destroy(hg_chunks *chunks);

/* The table for kernels, with the gradients where asked for: every parameter has to have one. Pointers stay from step to step, so
 * that it is sent to the device once. NULL: failed. */
const hg_chunk *hg_chunks_table(hg_chunks *chunks, bool gradients);

#endif
