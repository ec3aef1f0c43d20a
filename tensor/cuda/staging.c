/* Uploads go through pinned host memory: the caller's own is free again when the call returns, and the copy is made by the device
 * while the host goes on. A ring of blocks; an event behind the last copy out of a block says when it can be filled again. While
 * the next block is still in use another one is taken from the system, up to a limit, so that a steady state neither waits nor
 * allocates. */
#include "tensor/cuda/device.h"

#include <string.h>

enum { BLOCK = 1 << 20 };

static hg_status add_block(hg_cuda_device *d, int at)
{
    hg_cuda_block block = { 0 };
    void *memory = NULL;
    const CUresult result = d->api->cuMemAllocHost(&memory, BLOCK);
    HG_TRY(hg_cuda_check(d->api, result, "pinned memory for uploads"));
    block.memory = memory;
    const hg_status status =
        hg_cuda_check(d->api, d->api->cuEventCreate(&block.copied, CU_EVENT_DISABLE_TIMING), "an event");
    if (status != HG_OK) {
        d->api->cuMemFreeHost(memory);
        return status;
    }
    memmove(d->blocks + at + 1, d->blocks + at, (size_t)(d->n_blocks - at) * sizeof *d->blocks);
    d->blocks[at] = block;
    d->n_blocks++;
    return HG_OK;
}

static hg_status next_block(hg_cuda_device *d)
{
    if (d->n_blocks == 0) return add_block(d, 0);
    HG_TRY(hg_cuda_check(d->api, d->api->cuEventRecord(d->blocks[d->block].copied, d->stream), "an event"));
    int next = (d->block + 1) % d->n_blocks;
    const CUresult busy = d->api->cuEventQuery(d->blocks[next].copied);
    if (busy == CUDA_ERROR_NOT_READY && d->n_blocks < HG_CUDA_BLOCKS && add_block(d, d->block + 1) == HG_OK)
        next = d->block + 1;
    else if (busy != CUDA_SUCCESS)
        HG_TRY(hg_cuda_check(d->api, d->api->cuEventSynchronize(d->blocks[next].copied), "waiting for an upload"));
    d->block = next;
    d->block_used = 0;
    return HG_OK;
}

hg_status hg_cuda_stage(hg_cuda_device *d, CUdeviceptr to, const void *from, size_t bytes)
{
    const unsigned char *at = from;
    d->device.counts.uploaded += (int64_t)bytes;
    while (bytes) {
        if (d->n_blocks == 0 || d->block_used >= BLOCK) HG_TRY(next_block(d));
        const size_t room = BLOCK - d->block_used, n = bytes < room ? bytes : room;
        unsigned char *block = d->blocks[d->block].memory + d->block_used;
        memcpy(block, at, n);
        HG_TRY(hg_cuda_check(d->api, d->api->cuMemcpyHtoDAsync(to, block, n, d->stream), "a copy to the device"));
        d->block_used += (n + HG_ALIGNMENT - 1) / HG_ALIGNMENT * HG_ALIGNMENT;
        to += n;
        at += n;
        bytes -= n;
    }
    return HG_OK;
}

void hg_cuda_staging_free(hg_cuda_device *d)
{
    for (int i = 0; i < d->n_blocks; i++) {
        d->api->cuEventDestroy(d->blocks[i].copied);
        d->api->cuMemFreeHost(d->blocks[i].memory);
    }
    d->n_blocks = 0;
}
