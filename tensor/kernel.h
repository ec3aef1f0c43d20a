/* kernel: what a file of kernels begins with, so that one text is C for the processor and CUDA C++ for a GPU.
 *
 * A body works on the indices [first, last) of a launch; what it reads is in its args, plain data whose pointers are memory of
 * the device. It lies in a file NAME.kernel.h, which a .c file includes and which the library also carries as text:
 *
 *     #include "tensor/kernel.h"
 *     typedef struct { const float *x; float *y; float scale; } twice_args;
 *     HG_BODY void twice(const twice_args *p, int64_t first, int64_t last)
 *     {
 *         for (int64_t i = first; i < last; i++) p->y[i] = p->scale * p->x[i];
 *     }
 *     HG_KERNEL(twice, twice_args, 4096)            -> hg_launch(ctx, &twice_kernel, n, &(twice_args){ x, y, 2 })
 *
 * On the processor a thread takes `block` indices at a time, on a GPU a thread takes one. Where one index is too much for one
 * GPU thread (a sum of many numbers), HG_KERNEL_BLOCK gives each index to a block of threads, which run a body of their own:
 *
 *     #ifdef HG_CUDA
 *     HG_BODY void total_block(const total_args *p, int64_t index) { ... threadIdx.x ... __syncthreads() ... }
 *     #endif
 *     HG_KERNEL_BLOCK(total, total_args, 1, 256)    256 threads; `total` is the processor's body
 *
 * HG_KERNEL_GPU is the same without a body for the processor, HG_KERNEL_CPU is a kernel without one for a GPU, where the two
 * go different ways (hg_launches says what runs).
 *
 * Both precisions: the bodies stand in a file NAME.inc over REAL and F(name), included twice by NAME.kernel.h, and HG_KERNELS in
 * NAME.kernel.h (not in the .inc) makes name_kernels[2]. A kernel whose file is not NAME.kernel.h cannot be found by its text.
 *
 * What both languages take: casts from void * written out, no compound literals and no designated initialisers inside bodies,
 * enums as int, no headers but these and other *.kernel.h; every __syncthreads() is reached by all threads of a block, every
 * *_sync has its mask, nothing waits for another block, and no floating-point atomics: the same bits in every run. */
#ifndef HG_TENSOR_KERNEL_H
#define HG_TENSOR_KERNEL_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#ifdef HG_CUDA /* set by whoever compiles the text: NVRTC has empty headers in their place, but for the types of stdint.h */

#define HG_BODY  static __device__ inline
#define HG_SIMD_ /* a thread has one lane */
#define restrict __restrict__
#ifndef HG_KERNEL_EXPORT
#define HG_KERNEL_EXPORT(name_)
#define HG_DYNAMIC_SHARED(type_, name_) extern __shared__ type_ name_[]
#endif
#define HG_KERNEL(name_, args_, block_)                                                                                \
    extern "C" __global__ void name_##_cuda(const __grid_constant__ args_ args, const int64_t n)                       \
    {                                                                                                                  \
        for (int64_t i = (int64_t)blockIdx.x * blockDim.x + threadIdx.x; i < n; i += (int64_t)gridDim.x * blockDim.x)  \
            name_(&args, i, i + 1);                                                                                    \
    }                                                                                                                  \
    HG_KERNEL_EXPORT(name_##_cuda)
#define HG_KERNEL_BLOCK(name_, args_, block_, threads_)                                                                \
    extern "C" __global__ void name_##_cuda(const __grid_constant__ args_ args, const int64_t n)                       \
    {                                                                                                                  \
        for (int64_t i = blockIdx.x; i < n; i += gridDim.x) name_##_block(&args, i);                                   \
    }                                                                                                                  \
    HG_KERNEL_EXPORT(name_##_cuda)

#define HG_KERNEL_GPU(name_, args_, threads_) HG_KERNEL_BLOCK(name_, args_, 1, threads_)
#define HG_KERNEL_CPU(name_, args_, block_)

#define HG_KERNEL_PAIR_(name_)

enum { HG_F32, HG_F64, HG_I32, HG_BF16, HG_TF32 }; /* as base.h has them */

#else

#include "tensor/tensor.h"

#define HG_BODY  static inline
#define HG_SIMD_ _Pragma("omp simd")
#if defined(__has_builtin) /* without it padding may differ from step to step, and such a step is not replayed */
#if __has_builtin(__builtin_clear_padding)
#define HG_CLEARS_PADDING          1
#define HG_CLEAR_PADDING(pointer_) __builtin_clear_padding(pointer_)
#endif
#endif
#ifndef HG_CLEARS_PADDING
#define HG_CLEARS_PADDING          0
#define HG_CLEAR_PADDING(pointer_) (void)(pointer_)
#endif
#ifndef HG_KERNEL_SOURCE /* a file that the library carries, or a text (HG_KERNEL_TEXT) */
#define HG_KERNEL_SOURCE __FILE__
#endif
#define HG_KERNEL_OF_(name_, args_, cuda_, block_, threads_, indices_)                                                 \
    static inline void name_##_cpu(const void *memory, int64_t first, int64_t last)                                    \
    {                                                                                                                  \
        name_((const args_ *)memory, first, last);                                                                     \
    }                                                                                                                  \
    static inline void name_##_clear(void *memory) { HG_CLEAR_PADDING((args_ *)memory); }                              \
    static const hg_kernel name_##_kernel = { .name = #name_,                                                          \
                                              .cuda = cuda_,                                                           \
                                              .args_size = sizeof(args_),                                              \
                                              .cpu = name_##_cpu,                                                      \
                                              .block = block_,                                                         \
                                              .threads = threads_,                                                     \
                                              .indices = indices_,                                                     \
                                              .clear = name_##_clear };
#define HG_KERNEL(name_, args_, block_) HG_KERNEL_OF_(name_, args_, HG_KERNEL_SOURCE, block_, 0, 0)
#define HG_KERNEL_BLOCK(name_, args_, block_, threads_)                                                                \
    HG_KERNEL_OF_(name_, args_, HG_KERNEL_SOURCE, block_, threads_, 1)
#define HG_KERNEL_CPU(name_, args_, block_) HG_KERNEL_OF_(name_, args_, NULL, block_, 0, 0)
#define HG_KERNEL_GPU(name_, args_, threads_)                                                                          \
    static inline void name_##_clear(void *memory) { HG_CLEAR_PADDING((args_ *)memory); }                              \
    static const hg_kernel name_##_kernel = { .name = #name_,                                                          \
                                              .cuda = HG_KERNEL_SOURCE,                                                \
                                              .args_size = sizeof(args_),                                              \
                                              .threads = threads_,                                                     \
                                              .indices = 1,                                                            \
                                              .clear = name_##_clear };
#define HG_KERNEL_PAIR_(name_)                                                                                         \
    static const hg_kernel *const name_##_kernels[2] = { &name_##_f32_kernel, &name_##_f64_kernel };

/* For a file that the library does not carry, such as a plug-in's: what stands between the brackets (args, HG_BODY or HG_BODIES,
 * HG_KERNEL lines) is compiled here and kept as text, for which this header, tensor/math.h and tensor/block.h are there too. It
 * is one line of preprocessor: no directives in it, macros of one's own are not known there. `#define HG_KERNEL_SOURCE
 * hg_kernel_text` before this header is included; once in a file (examples/new/op.c). */
#define HG_KERNEL_TEXT(...)                                                                                            \
    static const char hg_kernel_text[] = #__VA_ARGS__;                                                                 \
    __VA_ARGS__

#endif

/* One body for both precisions, in place of a NAME.inc: in it `real` is float, then double, and p, first and last are there. */
#define HG_BODIES(name_, args_, ...)                                                                                   \
    HG_BODY void name_##_f32(const args_ *p, int64_t first, int64_t last)                                              \
    {                                                                                                                  \
        typedef float real;                                                                                            \
        __VA_ARGS__                                                                                                    \
    }                                                                                                                  \
    HG_BODY void name_##_f64(const args_ *p, int64_t first, int64_t last)                                              \
    {                                                                                                                  \
        typedef double real;                                                                                           \
        __VA_ARGS__                                                                                                    \
    }

/* Bodies name_f32 and name_f64 of the same args: name_kernels[dtype == HG_F64]. */
#define HG_KERNELS(name_, args_, block_)                                                                               \
    HG_KERNEL(name_##_f32, args_, block_) HG_KERNEL(name_##_f64, args_, block_) HG_KERNEL_PAIR_(name_)
#define HG_KERNELS_CPU(name_, args_, block_)                                                                           \
    HG_KERNEL_CPU(name_##_f32, args_, block_) HG_KERNEL_CPU(name_##_f64, args_, block_) HG_KERNEL_PAIR_(name_)
#define HG_KERNELS_GPU(name_, args_, threads_)                                                                         \
    HG_KERNEL_GPU(name_##_f32, args_, threads_) HG_KERNEL_GPU(name_##_f64, args_, threads_) HG_KERNEL_PAIR_(name_)
#define HG_KERNELS_BLOCK(name_, args_, block_, threads_)                                                               \
    HG_KERNEL_BLOCK(name_##_f32, args_, block_, threads_)                                                              \
    HG_KERNEL_BLOCK(name_##_f64, args_, block_, threads_) HG_KERNEL_PAIR_(name_)

/* a / b and the rest, for an index that is not negative: 64 bits are a long subroutine on a GPU, and indices are short. */
HG_BODY int64_t hg_divide(int64_t a, int64_t b, int64_t *rest)
{
#ifdef HG_CUDA
    if (((uint64_t)a | (uint64_t)b) >> 32 == 0) {
        const uint32_t quotient = (uint32_t)a / (uint32_t)b;
        *rest = (int64_t)((uint32_t)a - quotient * (uint32_t)b);
        return (int64_t)quotient;
    }
#endif
    const int64_t quotient = a / b;
    *rest = a - quotient * b;
    return quotient;
}

#define HG_PASTE_(a_, b_) a_##b_
#define HG_PASTE(a_, b_)  HG_PASTE_(a_, b_)

#endif
