/* What the emulating NVRTC puts before a kernel's text, so that a C++ compiler takes it: CUDA's words for one thread that is a
 * fiber of the emulating driver (libcuda.cc), which a kernel reaches through one table. */
#ifndef EMULATOR_SHIM_H
#define EMULATOR_SHIM_H

#include <math.h>
#include <stdint.h>
#include <stddef.h>
#include <string.h>
#include <utility>
#include <tuple>

struct emulator_size {
    unsigned x, y, z;
};

/* One instance, the driver's: who runs now, and what a thread may ask of it. */
struct emulator_state {
    emulator_size thread, block, block_size, grid_size;
    void *dynamic_shared;
    void (*barrier)(unsigned site);                            /* __syncthreads */
    uint64_t (*exchange)(unsigned site, unsigned mask, uint64_t value, int kind, int argument); /* warp operations */
};
extern "C" {
extern emulator_state *emulator; /* in every module; set when it is loaded */
}

/* A kernel of a module, its arguments unpacked: the driver calls it with the void ** of cuLaunchKernel. */
struct emulator_kernel {
    const char *name;
    void (*call)(void **);
    emulator_kernel *next;
};
extern "C" {
extern emulator_kernel *emulator_kernels;
}

template <auto F> struct emulator_thunk;
template <class... A, void (*F)(A...)> struct emulator_thunk<F> {
    template <size_t... I> static void unpack(void **args, std::index_sequence<I...>) { F(*(std::remove_reference_t<A> *)args[I]...); }
    static void call(void **args) { unpack(args, std::index_sequence_for<A...>()); }
};

#define HG_KERNEL_EXPORT(name_)                                                                                        \
    static emulator_kernel emulator_export_##name_ = { #name_, emulator_thunk<name_>::call, nullptr };                 \
    __attribute__((constructor)) static void emulator_add_##name_()                                                    \
    {                                                                                                                  \
        emulator_export_##name_.next = emulator_kernels;                                                               \
        emulator_kernels = &emulator_export_##name_;                                                                   \
    }
#define HG_DYNAMIC_SHARED(type_, name_) type_ *name_ = (type_ *)emulator->dynamic_shared

#define __global__
#define __device__
#define __host__
#define __forceinline__
#define __grid_constant__
#define __launch_bounds__(...)
#define __shared__ static __attribute__((section("emulator_shared")))
#define threadIdx (emulator->thread)
#define blockIdx  (emulator->block)
#define blockDim  (emulator->block_size)
#define gridDim   (emulator->grid_size)

#define __syncthreads() emulator->barrier(__COUNTER__)
enum { EMULATOR_SYNC, EMULATOR_SHUFFLE, EMULATOR_DOWN, EMULATOR_UP, EMULATOR_XOR, EMULATOR_BALLOT };
template <class T> static inline T emulator_exchange(unsigned site, unsigned mask, T value, int kind, int argument)
{
    static_assert(sizeof(T) <= 8, "");
    uint64_t bits = 0;
    memcpy(&bits, &value, sizeof value);
    bits = emulator->exchange(site, mask, bits, kind, argument);
    memcpy(&value, &bits, sizeof value);
    return value;
}
#define __syncwarp(mask_)                 ((void)emulator_exchange<int>(__COUNTER__, mask_, 0, EMULATOR_SYNC, 0))
#define __shfl_sync(mask_, v_, lane_)     emulator_exchange(__COUNTER__, mask_, v_, EMULATOR_SHUFFLE, lane_)
#define __shfl_down_sync(mask_, v_, n_)   emulator_exchange(__COUNTER__, mask_, v_, EMULATOR_DOWN, n_)
#define __shfl_up_sync(mask_, v_, n_)     emulator_exchange(__COUNTER__, mask_, v_, EMULATOR_UP, n_)
#define __shfl_xor_sync(mask_, v_, n_)    emulator_exchange(__COUNTER__, mask_, v_, EMULATOR_XOR, n_)
#define __ballot_sync(mask_, p_)          ((unsigned)emulator_exchange<uint64_t>(__COUNTER__, mask_, (p_) ? 1 : 0, EMULATOR_BALLOT, 0))

template <class T> static inline T atomicAdd(T *at, T v) { T old = *at; *at = old + v; return old; }
template <class T> static inline T atomicMax(T *at, T v) { T old = *at; if (v > old) *at = v; return old; }
template <class T> static inline T atomicMin(T *at, T v) { T old = *at; if (v < old) *at = v; return old; }
template <class T> static inline T atomicOr(T *at, T v) { T old = *at; *at = old | v; return old; }
template <class T> static inline T atomicExch(T *at, T v) { T old = *at; *at = v; return old; }
template <class T> static inline T atomicCAS(T *at, T expected, T v) { T old = *at; if (old == expected) *at = v; return old; }
static inline int __popc(unsigned x) { return __builtin_popcount(x); }
static inline int __ffs(int x) { return __builtin_ffs(x); }
static inline int __clz(int x) { return x ? __builtin_clz((unsigned)x) : 32; }
static inline float __int_as_float(int x) { float y; memcpy(&y, &x, 4); return y; }
static inline int __float_as_int(float x) { int y; memcpy(&y, &x, 4); return y; }
static inline void __threadfence() {}

#endif
