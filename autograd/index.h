/* What gather and scatter_add have to know of an index: that it points at rows that there are, and which of its places point at
 * a row. On the processor this is found at every call. On a device that means to read the index back, so an index of the
 * caller's own (hg_tensor_create) is analysed once, and again when it was overwritten; one made in the step at every call. */
#ifndef HG_AUTOGRAD_INDEX_H
#define HG_AUTOGRAD_INDEX_H

#include "autograd/tape.h"

/* Every element of the call's index is in [0, rows), or the context's error says which is not. */
bool hg_index_is_valid(const hg_call *call, const hg_tensor *index, int64_t rows);

/* start [rows+1] into places, places in ascending order: memory of the device, the step's or as long as the index. */
hg_status hg_index_reverse(hg_ctx *ctx, const hg_tensor *index, int64_t rows, const int64_t **start,
                           const int32_t **places);

#endif
