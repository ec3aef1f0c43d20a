/* What the threads of a GPU's block do together. */
#ifndef HG_TENSOR_BLOCK_H
#define HG_TENSOR_BLOCK_H

#include "tensor/kernel.h"

#ifdef HG_CUDA

enum { HG_BLOCK = 256 }; /* threads of the blocks that use this */

/* The sum over all threads of a block, in a fixed tree, for all of them; reached by all. */
HG_BODY double hg_block_sum(double value)
{
    __shared__ double sums[HG_BLOCK];
    sums[threadIdx.x] = value;
    __syncthreads();
    for (unsigned half = blockDim.x / 2; half > 0; half /= 2) {
        if (threadIdx.x < half) sums[threadIdx.x] += sums[threadIdx.x + half];
        __syncthreads();
    }
    const double sum = sums[0];
    __syncthreads(); /* before the next call writes */
    return sum;
}

HG_BODY double hg_block_max(double value)
{
    __shared__ double values[HG_BLOCK];
    values[threadIdx.x] = value;
    __syncthreads();
    for (unsigned half = blockDim.x / 2; half > 0; half /= 2) {
        if (threadIdx.x < half && values[threadIdx.x + half] > values[threadIdx.x])
            values[threadIdx.x] = values[threadIdx.x + half];
        __syncthreads();
    }
    const double most = values[0];
    __syncthreads();
    return most;
}

#endif
#endif
