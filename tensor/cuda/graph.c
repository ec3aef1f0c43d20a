/* Record and replay of a step.
 *
 * Between hg_step_record and hg_step_run nothing is given to the device: each call (a launch, a product, a convolution, a copy) is
 * appended to a list, as a function of ours and the bytes of its arguments. At the end the list is compared with that of the step
 * before, byte by byte:
 *
 *     another    it is run call by call, as without recording: kernels are loaded, libraries choose and warm up
 *     the same   it is run once more while the stream captures, and the graph that came out of it is launched
 *     the same   the graph is launched: one call for the whole step
 *     ...
 *
 * A list that changes now and then (other pairs, another batch) so costs one ordinary step and one capture, which updates the
 * graph that is there if it can; one that always changes costs no more than without recording. What cannot be captured is run
 * call by call for as long as it stays the same.
 *
 * Order is kept, whatever touches what. A read runs what was kept so far and waits; the rest of the step is a part of its own,
 * with its own list and graph. An upload before the first call of a part goes straight to its place. A later one is sent at once
 * to a place of its own, the inbox, at the same address in every step, and the list gets a copy from there: calls that were kept
 * before it still see the old numbers, and the graph does not depend on the numbers. Memory that is freed runs what was kept
 * first.
 *
 * Lists, inbox and graphs are kept from step to step: the steady state allocates nothing. */
#include "tensor/cuda/device.h"

#include <stdio.h>
#include <string.h>

static hg_cuda_device *of(hg_device *device) { return (hg_cuda_device *)(void *)device; }

/* ---- the list ---- */

/* In front of a call's arguments. */
typedef struct {
    hg_cuda_call call;
    size_t size; /* of the arguments, with what fills them up to ALIGNMENT */
} head;
enum { ALIGNMENT = 16 };

void *hg_cuda_keep(hg_cuda_device *d, hg_cuda_call call, size_t size)
{
    size = (size + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
    const size_t whole = sizeof(head) + size;
    if (d->calls_room - d->calls_size < whole) {
        const size_t room = 2 * d->calls_room + whole + 4096;
        unsigned char *grown = hg_resize(d->calls, d->calls_room, room, 1);
        if (!grown) return NULL;
        d->calls = grown;
        d->calls_room = room;
    }
    head *h = (head *)(void *)(d->calls + d->calls_size);
    memset(h, 0, whole);
    h->call = call;
    h->size = size;
    d->calls_size += whole;
    return h + 1;
}

hg_status hg_cuda_do(hg_cuda_device *d, const char *name, hg_cuda_call call, const void *args, size_t size)
{
    HG_TRY(hg_cuda_enter(d));
    d->device.counts.launches++;
    d->last = name;
    d->since++;
    if (!d->recording) return call(d, args);
    void *kept = hg_cuda_keep(d, call, size);
    if (!kept) return HG_MEMORY;
    memcpy(kept, args, size);
    return HG_OK;
}

static hg_status run_calls(hg_cuda_device *d, const unsigned char *calls, size_t size)
{
    for (size_t at = 0; at < size;) {
        const head *h = (const head *)(const void *)(calls + at);
        HG_TRY(h->call(d, h + 1));
        at += sizeof *h + h->size;
    }
    return HG_OK;
}

/* ---- graphs ---- */

/* The part's calls as a graph that can be launched; false: they cannot be captured. */
static bool make_graph(hg_cuda_device *d, hg_cuda_part *part)
{
    const hg_cuda_api *api = d->api;
    CUgraph captured = NULL;
    if (api->cuStreamBeginCapture(d->stream, CU_STREAM_CAPTURE_MODE_THREAD_LOCAL) != CUDA_SUCCESS) return false;
    const hg_status status = run_calls(d, part->calls, part->size);
    const CUresult ended = api->cuStreamEndCapture(d->stream, &captured);
    bool good = status == HG_OK && ended == CUDA_SUCCESS && captured;
    if (good && part->graph) {
        CUgraphExecUpdateResultInfo info;
        memset(&info, 0, sizeof info);
        if (api->cuGraphExecUpdate(part->graph, captured, &info) != CUDA_SUCCESS) {
            api->cuGraphExecDestroy(part->graph);
            part->graph = NULL;
        }
    }
    if (good && !part->graph) good = api->cuGraphInstantiate(&part->graph, captured, 0) == CUDA_SUCCESS;
    if (captured) api->cuGraphDestroy(captured);
    return good;
}

static hg_cuda_part *next_part(hg_cuda_device *d)
{
    if (d->part == d->n_parts) {
        hg_cuda_part *parts = hg_resize(d->parts, (size_t)d->n_parts, (size_t)d->n_parts + 1, sizeof *parts);
        if (!parts) return NULL;
        parts[d->n_parts++] = (hg_cuda_part){ 0 };
        d->parts = parts;
    }
    return &d->parts[d->part++];
}

/* Behind an error nothing more is run: what was kept goes. */
hg_status hg_cuda_flush(hg_cuda_device *d)
{
    const hg_status untold = d->untold;
    d->untold = HG_OK;
    if (untold != HG_OK) {
        d->calls_size = 0;
        return hg_fail(untold, "%s", d->untold_message);
    }
    if (d->calls_size == 0) return HG_OK;
    hg_cuda_part *part = next_part(d);
    const size_t size = d->calls_size;
    d->calls_size = 0;
    if (!part) return HG_MEMORY;
    if (part->size != size || memcmp(part->calls, d->calls, size) != 0) {
        unsigned char *calls = part->calls;
        const size_t room = part->room;
        part->calls = d->calls;
        part->room = d->calls_room;
        part->size = size;
        part->ready = part->refused = false;
        d->calls = calls;
        d->calls_room = room;
        return run_calls(d, part->calls, size);
    }
    if (!part->ready && !part->refused) {
        part->ready = make_graph(d, part);
        part->refused = !part->ready;
    }
    if (part->refused) return run_calls(d, part->calls, size);
    d->device.counts.replays++;
    return hg_cuda_check(d->api, d->api->cuGraphLaunch(part->graph, d->stream), "replaying a step");
}

void hg_cuda_flush_untold(hg_cuda_device *d)
{
    d->untold = hg_cuda_flush(d);
    if (d->untold != HG_OK) snprintf(d->untold_message, sizeof d->untold_message, "%s", hg_message());
}

void hg_cuda_graphs_forget(hg_cuda_device *d)
{
    for (int i = 0; i < d->n_parts; i++) {
        hg_cuda_part *part = &d->parts[i];
        if (part->graph) d->api->cuGraphExecDestroy(part->graph);
        part->graph = NULL;
        part->size = 0;
        part->ready = part->refused = false;
    }
}

void hg_cuda_graphs_free(hg_cuda_device *d)
{
    hg_cuda_graphs_forget(d);
    for (int i = 0; i < d->n_parts; i++) hg_free(d->parts[i].calls);
    hg_free(d->parts);
    hg_free(d->calls);
    d->parts = NULL;
    d->calls = NULL;
    d->n_parts = 0;
    d->calls_size = d->calls_room = 0;
    hg_arena_free(&d->inbox);
}

/* ---- the step ---- */

hg_status hg_cuda_record(hg_device *device)
{
    hg_cuda_device *d = of(device);
    HG_TRY(hg_cuda_enter(d));
    HG_TRY(hg_cuda_flush(d)); /* of a step that an error ended early */
    hg_arena_reset(&d->inbox, false);
    d->part = 0;
    d->recording = true;
    return HG_OK;
}

hg_status hg_cuda_run(hg_device *device)
{
    hg_cuda_device *d = of(device);
    HG_TRY(hg_cuda_enter(d));
    d->recording = false;
    return hg_cuda_flush(d);
}
