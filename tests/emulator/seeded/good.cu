/* Kernels that are right: the same bits in every order of threads, and nothing to say about them. test_emulator.c */

extern "C" __global__ void block_sum(const int *in, int *out, int n)
{
    __shared__ int part[8];
    int sum = 0;
    for (int i = blockIdx.x * blockDim.x + threadIdx.x; i < n; i += gridDim.x * blockDim.x) sum += in[i];
    for (int step = 16; step > 0; step /= 2) sum += __shfl_down_sync(0xffffffffu, sum, step);
    if (threadIdx.x % 32 == 0) part[threadIdx.x / 32] = sum;
    __syncthreads();
    if (threadIdx.x == 0) {
        for (int w = 1; w < (int)blockDim.x / 32; w++) sum += part[w];
        out[blockIdx.x] = sum;
    }
}
HG_KERNEL_EXPORT(block_sum)

/* Blocks of 16 x 8 threads, tiles of 16 x 16: n is the side of a square. */
extern "C" __global__ void transpose(const int *in, int *out, int n)
{
    __shared__ int tile[16][17];
    const int x = blockIdx.x * 16 + threadIdx.x, y = blockIdx.y * 16 + threadIdx.y;
    for (int k = 0; k < 16; k += 8) tile[threadIdx.y + k][threadIdx.x] = in[(y + k) * n + x];
    __syncthreads();
    const int to_x = blockIdx.y * 16 + threadIdx.x, to_y = blockIdx.x * 16 + threadIdx.y;
    for (int k = 0; k < 16; k += 8) out[(to_y + k) * n + to_x] = tile[threadIdx.x][threadIdx.y + k];
}
HG_KERNEL_EXPORT(transpose)

/* Sums of all before, of a block's 1024 threads, in dynamic shared memory. */
extern "C" __global__ void scan(const int *in, int *out, int n)
{
    HG_DYNAMIC_SHARED(int, sums);
    const int t = threadIdx.x;
    sums[t] = t < n ? in[t] : 0;
    __syncthreads();
    for (int step = 1; step < (int)blockDim.x; step *= 2) {
        const int before = t >= step ? sums[t - step] : 0;
        __syncthreads();
        sums[t] += before;
        __syncthreads();
    }
    if (t < n) out[t] = sums[t];
}
HG_KERNEL_EXPORT(scan)

extern "C" __global__ void histogram(const int *in, int *out, int n)
{
    __shared__ int count[16];
    if (threadIdx.x < 16) count[threadIdx.x] = 0;
    __syncthreads();
    for (int i = blockIdx.x * blockDim.x + threadIdx.x; i < n; i += gridDim.x * blockDim.x) atomicAdd(&count[in[i] & 15], 1);
    __syncthreads();
    if (threadIdx.x < 16) atomicAdd(&out[threadIdx.x], count[threadIdx.x]);
}
HG_KERNEL_EXPORT(histogram)

/* Every word of warps; 32 results for each of 64 threads. */
extern "C" __global__ void warps(const int *in, int *out, int n)
{
    const unsigned all = 0xffffffffu, half = threadIdx.x % 32 < 16 ? 0x0000ffffu : 0xffff0000u;
    const int lane = threadIdx.x % 32, v = in[threadIdx.x];
    int *to = out + 32 * threadIdx.x, k = 0;
    to[k++] = __shfl_sync(all, v, 5);
    to[k++] = __shfl_sync(all, v, lane ^ 3);
    to[k++] = __shfl_sync(all, v, 9, 8);
    to[k++] = __shfl_up_sync(all, v, 3);
    to[k++] = __shfl_up_sync(all, v, 3, 8);
    to[k++] = __shfl_down_sync(all, v, 3);
    to[k++] = __shfl_down_sync(all, v, 1, 4);
    to[k++] = __shfl_xor_sync(all, v, 16);
    to[k++] = __shfl_xor_sync(all, v, 3, 16);
    to[k++] = __shfl_xor_sync(half, v, 15, 16);
    to[k++] = (int)__ballot_sync(all, v & 1);
    to[k++] = __any_sync(all, v == 7);
    to[k++] = __all_sync(all, v >= 0);
    to[k++] = __reduce_add_sync(all, v);
    to[k++] = __reduce_min_sync(half, v);
    to[k++] = __reduce_max_sync(half, v);
    to[k++] = (int)__reduce_xor_sync(all, (unsigned)v);
    to[k++] = (int)__reduce_and_sync(half, (unsigned)v);
    to[k++] = (int)__reduce_or_sync(half, (unsigned)v);
    to[k++] = __syncthreads_count(v & 1);
    to[k++] = __syncthreads_and(v >= 0);
    to[k++] = __syncthreads_or(v == 7);
    const double wide = __shfl_sync(all, (double)v + 0.5, 31 - lane);
    to[k++] = (int)(2 * wide);
    if (lane < 16) { /* half of a warp may exchange while the other half does not */
        int sum = v;
        for (int step = 8; step > 0; step /= 2) sum += __shfl_xor_sync(0x0000ffffu, sum, step);
        to[k++] = sum;
    } else {
        to[k++] = 0;
    }
    while (k < 32) to[k++] = n;
}
HG_KERNEL_EXPORT(warps)

/* Lanes hand numbers on through shared memory, with __syncwarp alone between them. */
extern "C" __global__ void hand_on(const int *in, int *out, int n)
{
    __shared__ int kept[64];
    const int t = threadIdx.x, neighbour = t / 32 * 32 + (t + 1) % 32;
    int v = in[t];
    for (int round = 0; round < n; round++) {
        kept[t] = v;
        __syncwarp();
        v += kept[neighbour];
        __syncwarp();
    }
    out[t] = v;
}
HG_KERNEL_EXPORT(hand_on)

/* A thread looks at its own words and at others', of 1, 2, 4, 8 and 16 bytes, on both sides of a barrier. */
extern "C" __global__ void words(const int *in, int *out, int n)
{
    __shared__ __align__(16) unsigned char bytes[256];
    const int t = threadIdx.x;
    bytes[t] = (unsigned char)in[t];
    __syncthreads();
    const unsigned short two = ((unsigned short *)bytes)[t % 128];
    const int4 sixteen = ((const int4 *)in)[t / 4 % (n / 4)];
    const long long eight = ((const long long *)bytes)[t % 32];
    out[t] = two + sixteen.w + (int)(eight >> 32);
}
HG_KERNEL_EXPORT(words)

extern "C" __global__ void add_one(const int *in, int *out, int n)
{
    const int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i < n) out[i] = in[i] + 1;
}
HG_KERNEL_EXPORT(add_one)
