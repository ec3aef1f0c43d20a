/* The table of the pieces of all parameters. */
#include "train/chunks.h"

#include <string.h>

enum { CHUNK = 4096, DEVICE_CHUNK = 1024 };

hg_status hg_chunks_create(hg_chunks *c, hg_ctx *ctx, int n, hg_tensor *const *params)
{
    const int64_t size = hg_ctx_host(ctx) ? CHUNK : DEVICE_CHUNK;
    *c = (hg_chunks){ .ctx = ctx, .n = n };
    for (int i = 0; i < n; i++) {
        const int64_t count = hg_tensor_count(params[i]);
        c->total += count;
        c->n_chunks += (count + size - 1) / size;
    }
    c->params = hg_alloc((size_t)(n ? n : 1), sizeof *c->params);
    c->chunks = hg_alloc((size_t)(c->n_chunks ? c->n_chunks : 1), sizeof *c->chunks);
    if (!c->params || !c->chunks) return HG_MEMORY;
    if (n) memcpy(c->params, params, (size_t)n * sizeof *params);
    int64_t at = 0, offset = 0;
    for (int i = 0; i < n; i++) {
        const int64_t count = hg_tensor_count(params[i]);
        for (int64_t first = 0; first < count; first += size)
            c->chunks[at++] = (hg_chunk){ .first = first,
                                          .offset = offset + first,
                                          .count = count - first < size ? count - first : size,
                                          .param = i };
        offset += count;
    }
    if (hg_ctx_host(ctx)) return HG_OK;
    const int64_t words = c->n_chunks * (int64_t)(sizeof *c->chunks / sizeof(int32_t));
    c->device = hg_tensor_create(ctx, HG_I32, 1, &words);
    return c->device ? HG_OK : HG_MEMORY;
}

void hg_chunks_destroy(hg_chunks *c)
{
    hg_tensor_destroy(c->device);
    hg_free(c->chunks);
    hg_free(c->params);
    *c = (hg_chunks){ 0 };
}

const hg_chunk *hg_chunks_table(hg_chunks *c, bool gradients)
{
    bool changed = false;
    for (int64_t at = 0; at < c->n_chunks; at++) {
        hg_chunk *chunk = &c->chunks[at];
        const hg_tensor *param = c->params[chunk->param], *gradient = gradients ? hg_grad(param) : NULL;
        if (gradients && !gradient) {
            hg_fail(HG_INVALID, "adam: parameter %s has no gradient: the loss does not depend on it",
                    param->name ? param->name : "?");
            return NULL;
        }
        float *value = (float *)param->data + chunk->first;
        const float *from = gradient ? (const float *)gradient->data + chunk->first : NULL;
        changed |= chunk->value != value || chunk->gradient != from;
        chunk->value = value;
        chunk->gradient = from;
    }
    if (!c->device) return c->chunks;
    return changed && hg_tensor_write(c->device, c->chunks) != HG_OK ? NULL : c->device->data;
}
