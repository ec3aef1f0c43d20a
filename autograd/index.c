/* The analysis of an index, and what is kept of it. */
#include "autograd/index.h"

#include <string.h>

struct hg_index_known {
    const hg_tensor *root; /* the caller's tensor that the index is, or looks into */
    const void *data;
    uint32_t version; /* of the root */
    int64_t count, rows;
    hg_tensor *start, *places;
    hg_index_known *next;
};

static const hg_tensor *root_of(const hg_tensor *tensor)
{
    while (tensor->base) tensor = tensor->base;
    return tensor;
}

void hg_index_forget(hg_index_known **list, const hg_tensor *root)
{
    for (hg_index_known **at = list; *at;) {
        hg_index_known *known = *at;
        if (root && known->root != root) {
            at = &known->next;
            continue;
        }
        *at = known->next; /* out of the list first: destroying a tensor comes here again */
        hg_tensor_destroy(known->start);
        hg_tensor_destroy(known->places);
        hg_free(known);
        at = list;
    }
}

/* A counting sort: the places of a row stay in order. start has rows + 1 elements. */
static void reverse(const int32_t *index, int64_t n, int64_t rows, int64_t *start, int32_t *places)
{
    memset(start, 0, (size_t)(rows + 1) * sizeof *start);
    for (int64_t i = 0; i < n; i++) start[index[i] + 1]++;
    for (int64_t r = 0; r < rows; r++) start[r + 1] += start[r];
    for (int64_t i = 0; i < n; i++) places[start[index[i]]++] = (int32_t)i; /* start[r] is now the end of r ... */
    for (int64_t r = rows; r > 0; r--) start[r] = start[r - 1];             /* ... which is the start of r + 1 */
    start[0] = 0;
}

static hg_index_known *find(hg_ctx *ctx, const hg_tensor *index, int64_t rows)
{
    const hg_tensor *root = root_of(index);
    for (hg_index_known *known = *hg_tape_indices(ctx); known; known = known->next)
        if (known->root == root && known->version == root->version && known->data == index->data &&
            known->count == hg_tensor_count(index) && known->rows == rows)
            return known;
    return NULL;
}

/* Lists of an index whose numbers are at hand, kept with its root. */
static hg_status keep(hg_ctx *ctx, const hg_tensor *index, int64_t rows, const int64_t *start, const int32_t *places)
{
    const hg_tensor *root = root_of(index);
    const int64_t count = hg_tensor_count(index), words = 2 * (rows + 1);
    hg_index_known **list = hg_tape_indices(ctx);
    for (const hg_index_known *old = *list; old; old = old->next)
        if (old->root == root &&
            old->version != root->version) { /* all that is known of it is of before it was overwritten */
            hg_index_forget(list, root);
            break;
        }
    hg_index_known *known = hg_alloc(1, sizeof *known);
    if (!known) return hg_ctx_fail(ctx, HG_MEMORY, "out of memory: the lists of an index");
    *known =
        (hg_index_known){ .root = root, .data = index->data, .version = root->version, .count = count, .rows = rows };
    known->start = hg_tensor_create(ctx, HG_I32, 1, &words); /* of 64 bits each */
    known->places = hg_tensor_create(ctx, HG_I32, 1, &count);
    known->next = *list;
    *list = known;
    if (known->start && known->places && hg_tensor_write(known->start, start) == HG_OK &&
        hg_tensor_write(known->places, places) == HG_OK)
        return HG_OK;
    hg_index_forget(list, root);
    return hg_ctx_fail(ctx, HG_MEMORY, "out of memory: the lists of an index");
}

/* The numbers of an index: its own memory, or a copy in the step's. */
static const int32_t *numbers_of(hg_ctx *ctx, const hg_tensor *index)
{
    if (hg_ctx_host(ctx)) return index->data;
    int32_t *copy = hg_step_alloc(ctx, hg_tensor_bytes(index));
    return copy && hg_tensor_read(index, copy) == HG_OK ? copy : NULL;
}

static hg_status analyse(hg_ctx *ctx, const hg_tensor *index, int64_t rows, const int64_t **start,
                         const int32_t **places)
{
    const int64_t n = hg_tensor_count(index);
    const int32_t *numbers = numbers_of(ctx, index);
    int64_t *host_start = hg_step_alloc(ctx, (size_t)(rows + 1) * sizeof **start);
    int32_t *host_places = hg_step_alloc(ctx, (size_t)n * sizeof **places);
    if (!host_start || !host_places || !numbers) return HG_MEMORY;
    reverse(numbers, n, rows, host_start, host_places);
    *start = host_start;
    *places = host_places;
    if (hg_ctx_host(ctx)) return HG_OK;
    if (root_of(index)->owned) return keep(ctx, index, rows, host_start, host_places);
    const int64_t words = 2 * (rows + 1);
    const hg_tensor *a = hg_tensor_from(ctx, HG_I32, 1, &words, host_start),
                    *b = hg_tensor_from(ctx, HG_I32, 1, &n, host_places);
    if (!a || !b) return hg_ctx_status(ctx);
    *start = a->data;
    *places = b->data;
    return HG_OK;
}

hg_status hg_index_reverse(hg_ctx *ctx, const hg_tensor *index, int64_t rows, const int64_t **start,
                           const int32_t **places)
{
    const hg_index_known *known = find(ctx, index, rows);
    if (!known) {
        HG_TRY(analyse(ctx, index, rows, start, places));
        known = find(ctx, index, rows);
    }
    if (known) {
        *start = known->start->data;
        *places = known->places->data;
    }
    return HG_OK;
}

bool hg_index_is_valid(const hg_call *call, const hg_tensor *index, int64_t rows)
{
    hg_ctx *ctx = call->ctx;
    const int64_t n = hg_tensor_count(index);
    if (n > INT32_MAX) return hg_refuse(call, "more than 2^31 indices"), false;
    if (find(ctx, index, rows)) return true;
    const hg_step_mark mark = hg_step_set_mark(ctx);
    const int32_t *at = numbers_of(ctx, index);
    bool valid = at != NULL;
    for (int64_t i = 0; valid && i < n; i++)
        if (at[i] < 0 || at[i] >= rows) {
            hg_refuse(call, "index %lld is %d, there are %lld rows", (long long)i, at[i], (long long)rows);
            valid = false;
        }
    hg_step_rewind(ctx, mark);
    /* It is read back this once: its lists are made at the same time. */
    if (valid && !hg_ctx_host(ctx) && root_of(index)->owned) {
        const int64_t *start;
        const int32_t *places;
        valid = analyse(ctx, index, rows, &start, &places) == HG_OK;
        hg_step_rewind(ctx, mark);
    }
    return valid;
}
