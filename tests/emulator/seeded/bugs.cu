/* Kernels with one mistake each, which the emulator has to find: test_emulator.c says what it has to say about each. */

extern "C" __global__ void removed_barrier(const int *in, int *out, int n)
{
    __shared__ int sums[64];
    const int t = threadIdx.x;
    sums[t] = in[t];
    __syncthreads();
    for (int step = 32; step > 0; step /= 2) {
        if (t < step) sums[t] += sums[t + step];
        /* __syncthreads() is missing */
    }
    if (t == 0) out[0] = sums[0];
}
HG_KERNEL_EXPORT(removed_barrier)

extern "C" __global__ void removed_syncwarp(const int *in, int *out, int n)
{
    __shared__ int kept[32];
    const int t = threadIdx.x;
    kept[t] = in[t];
    /* __syncwarp() is missing */
    out[t] = kept[(t + 1) % 32];
}
HG_KERNEL_EXPORT(removed_syncwarp)

extern "C" __global__ void race_in_block(const int *in, int *out, int n)
{
    out[threadIdx.x / 2] = in[threadIdx.x];
}
HG_KERNEL_EXPORT(race_in_block)

extern "C" __global__ void race_of_blocks(const int *in, int *out, int n)
{
    const int i = blockIdx.x * blockDim.x + threadIdx.x;
    out[i] = threadIdx.x + 1 == blockDim.x && i + 1 < n ? out[i + 1] : 0;
}
HG_KERNEL_EXPORT(race_of_blocks)

extern "C" __global__ void race_with_atomic(const int *in, int *out, int n)
{
    atomicAdd(&out[0], 1);
    if (threadIdx.x == 3) out[1] = out[0];
}
HG_KERNEL_EXPORT(race_with_atomic)

extern "C" __global__ void off_by_one(const int *in, int *out, int n)
{
    const int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i <= n) out[i] = i;
}
HG_KERNEL_EXPORT(off_by_one)

extern "C" __global__ void before_the_beginning(const int *in, int *out, int n)
{
    out[threadIdx.x] = in[(int)threadIdx.x - 1];
}
HG_KERNEL_EXPORT(before_the_beginning)

extern "C" __global__ void wrong_mask(const int *in, int *out, int n)
{
    int v = in[threadIdx.x];
    if (threadIdx.x < 16) v += __shfl_down_sync(0xffffffffu, v, 8); /* the other half does not come */
    out[threadIdx.x] = v;
}
HG_KERNEL_EXPORT(wrong_mask)

extern "C" __global__ void mask_of_barrier(const int *in, int *out, int n)
{
    int v = in[threadIdx.x];
    if (threadIdx.x < 16) v += __shfl_down_sync(0xffffffffu, v, 8);
    __syncthreads();
    out[threadIdx.x] = v;
}
HG_KERNEL_EXPORT(mask_of_barrier)

extern "C" __global__ void mask_without_itself(const int *in, int *out, int n)
{
    out[threadIdx.x] = __shfl_sync(0x0000ffffu, in[threadIdx.x], 0);
}
HG_KERNEL_EXPORT(mask_without_itself)

extern "C" __global__ void lane_outside(const int *in, int *out, int n)
{
    if (threadIdx.x < 16) out[threadIdx.x] = __shfl_down_sync(0x0000ffffu, in[threadIdx.x], 8);
}
HG_KERNEL_EXPORT(lane_outside)

extern "C" __global__ void divergent_barrier(const int *in, int *out, int n)
{
    if (threadIdx.x % 2) __syncthreads();
    else __syncthreads();
    out[threadIdx.x] = in[threadIdx.x];
}
HG_KERNEL_EXPORT(divergent_barrier)

extern "C" __global__ void early_exit(const int *in, int *out, int n)
{
    const int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= n) return;
    __syncthreads();
    out[i] = in[i];
}
HG_KERNEL_EXPORT(early_exit)

extern "C" __global__ void uninitialised_shared(const int *in, int *out, int n)
{
    __shared__ int kept[65];
    kept[threadIdx.x] = in[threadIdx.x];
    __syncthreads();
    out[threadIdx.x] = kept[threadIdx.x + 1];
}
HG_KERNEL_EXPORT(uninitialised_shared)

extern "C" __global__ void index_of_array(const int *in, int *out, int n)
{
    __shared__ int kept[32];
    if (threadIdx.x < 32) kept[threadIdx.x] = 0;
    __syncthreads();
    if (threadIdx.x == 33) kept[threadIdx.x] = 1;
}
HG_KERNEL_EXPORT(index_of_array)

extern "C" __global__ void beyond_dynamic_shared(const int *in, int *out, int n)
{
    HG_DYNAMIC_SHARED(int, kept);
    kept[threadIdx.x + 1] = 1;
}
HG_KERNEL_EXPORT(beyond_dynamic_shared)

extern "C" __global__ void misaligned(const int *in, int *out, int n)
{
    const int4 four = *(const int4 *)(in + threadIdx.x);
    out[threadIdx.x] = four.x;
}
HG_KERNEL_EXPORT(misaligned)

extern "C" __global__ void overflow(const int *in, int *out, int n)
{
    out[threadIdx.x] = in[threadIdx.x] + 0x7fffffff;
}
HG_KERNEL_EXPORT(overflow)

extern "C" __global__ void stack_of_another(const int *in, int *out, int n)
{
    __shared__ int *pointer;
    int mine[4] = { in[threadIdx.x], 1, 2, 3 };
    if (threadIdx.x == 0) pointer = mine;
    __syncthreads();
    out[threadIdx.x] = pointer[threadIdx.x % 4];
    __syncthreads();
}
HG_KERNEL_EXPORT(stack_of_another)

__device__ static int deeper(const volatile int *in, int n)
{
    volatile int room[1024];
    room[n % 1024] = in[0];
    return n <= 0 ? room[0] : deeper(room, n - 1) + room[n % 1024];
}
extern "C" __global__ void deep(const int *in, int *out, int n)
{
    out[threadIdx.x] = deeper(in, n);
}
HG_KERNEL_EXPORT(deep)

extern "C" __global__ void divided_by_zero(const int *in, int *out, int n)
{
    out[threadIdx.x] = n / in[threadIdx.x];
}
HG_KERNEL_EXPORT(divided_by_zero)

extern "C" __global__ void failed_assertion(const int *in, int *out, int n)
{
    assert(in[threadIdx.x] < 0);
}
HG_KERNEL_EXPORT(failed_assertion)
