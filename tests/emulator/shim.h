/* What the emulating NVRTC puts before a kernel's text, so that a C++ compiler takes it: CUDA's words for a thread that is a fiber
 * of the emulating driver (scheduler.cc), which a kernel reaches through one table. What a GPU would do but ours must not (atomics
 * on floating-point numbers, __activemask) does not compile. */
#ifndef EMULATOR_SHIM_H
#define EMULATOR_SHIM_H

#include "table.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <tuple>
#include <type_traits>
#include <utility>

/* ---- modules ---- */

static emulator_state *emulator; /* set by the driver */

template <auto F> struct emulator_thunk;
template <class... A, void (*F)(A...)> struct emulator_thunk<F> {
    static constexpr size_t sizes[] = { sizeof(A)..., 0 };
    template <size_t... I> static void unpack(void **args, std::index_sequence<I...>) { F(*(std::remove_reference_t<A> *)args[I]...); }
    static void call(void **args) { unpack(args, std::index_sequence_for<A...>()); }
};

extern "C" {
extern char __start_emulator_shared[] __attribute__((weak, visibility("hidden")));
extern char __stop_emulator_shared[] __attribute__((weak, visibility("hidden")));
__attribute__((visibility("default"), used)) emulator_module emulator_this_module = {
    &emulator, nullptr, __start_emulator_shared, __stop_emulator_shared,
#ifdef EMULATOR_CHECKED
    true
#else
    false
#endif
};
}

#define HG_KERNEL_EXPORT(name_)                                                                                                  \
    static emulator_kernel emulator_export_##name_ = { #name_, emulator_thunk<name_>::call, emulator_thunk<name_>::sizes, nullptr }; \
    __attribute__((constructor, no_sanitize("thread"))) static void emulator_add_##name_()                                       \
    {                                                                                                                            \
        emulator_export_##name_.next = emulator_this_module.kernels;                                                             \
        emulator_this_module.kernels = &emulator_export_##name_;                                                                 \
    }
#define HG_DYNAMIC_SHARED(type_, name_) type_ *name_ = (type_ *)emulator->dynamic_shared

/* ---- words ---- */

#define __CUDA_ARCH__ 900
#define __CUDACC_RTC__
#define __global__
#define __device__
#define __host__
#define __forceinline__ inline __attribute__((always_inline))
#define __grid_constant__
#define __constant__ static const
#define __launch_bounds__(...)
#define __align__(n_) __attribute__((aligned(n_)))
#define __shared__ static __attribute__((section("emulator_shared")))
#define threadIdx (emulator->thread)
#define blockIdx  (emulator->block)
#define blockDim  (emulator->block_size)
#define gridDim   (emulator->grid_size)
#define warpSize  32
#define EMULATOR_SITE(what_)                                                                                           \
    ({                                                                                                                 \
        static const emulator_site here_ = { __FILE__, __LINE__, what_ };                                              \
        &here_;                                                                                                        \
    })

/* ---- threads that wait for each other ---- */

#define __syncthreads()            ((void)emulator->barrier(EMULATOR_SITE("__syncthreads"), EMULATOR_PLAIN, 0))
#define __syncthreads_count(p_)    emulator->barrier(EMULATOR_SITE("__syncthreads_count"), EMULATOR_COUNT, !!(p_))
#define __syncthreads_and(p_)      emulator->barrier(EMULATOR_SITE("__syncthreads_and"), EMULATOR_AND, !!(p_))
#define __syncthreads_or(p_)       emulator->barrier(EMULATOR_SITE("__syncthreads_or"), EMULATOR_OR, !!(p_))
#define __syncwarp                 emulator_warp{ EMULATOR_SITE("__syncwarp") } /* (mask), or () for all lanes */
#define __shfl_sync(mask_, ...)      emulator_shuffle(EMULATOR_SITE("__shfl_sync"), EMULATOR_SHUFFLE, mask_, __VA_ARGS__)
#define __shfl_down_sync(mask_, ...) emulator_shuffle(EMULATOR_SITE("__shfl_down_sync"), EMULATOR_DOWN, mask_, __VA_ARGS__)
#define __shfl_up_sync(mask_, ...)   emulator_shuffle(EMULATOR_SITE("__shfl_up_sync"), EMULATOR_UP, mask_, __VA_ARGS__)
#define __shfl_xor_sync(mask_, ...)  emulator_shuffle(EMULATOR_SITE("__shfl_xor_sync"), EMULATOR_XOR, mask_, __VA_ARGS__)
#define __ballot_sync(mask_, p_) ((unsigned)emulator_bits(EMULATOR_SITE("__ballot_sync"), mask_, (p_) ? 1 : 0, EMULATOR_BALLOT))
#define __any_sync(mask_, p_)    (emulator_bits(EMULATOR_SITE("__any_sync"), mask_, (p_) ? 1 : 0, EMULATOR_BALLOT) != 0)
#define __all_sync(mask_, p_)    (emulator_bits(EMULATOR_SITE("__all_sync"), mask_, (p_) ? 0 : 1, EMULATOR_BALLOT) == 0)
#define __reduce_add_sync(mask_, v_) emulator_reduce(EMULATOR_SITE("__reduce_add_sync"), mask_, v_, EMULATOR_ADD, EMULATOR_ADD)
#define __reduce_min_sync(mask_, v_) emulator_reduce(EMULATOR_SITE("__reduce_min_sync"), mask_, v_, EMULATOR_MIN, EMULATOR_UMIN)
#define __reduce_max_sync(mask_, v_) emulator_reduce(EMULATOR_SITE("__reduce_max_sync"), mask_, v_, EMULATOR_MAX, EMULATOR_UMAX)
#define __reduce_and_sync(mask_, v_) emulator_reduce(EMULATOR_SITE("__reduce_and_sync"), mask_, v_, EMULATOR_BITS_AND, EMULATOR_BITS_AND)
#define __reduce_or_sync(mask_, v_)  emulator_reduce(EMULATOR_SITE("__reduce_or_sync"), mask_, v_, EMULATOR_BITS_OR, EMULATOR_BITS_OR)
#define __reduce_xor_sync(mask_, v_) emulator_reduce(EMULATOR_SITE("__reduce_xor_sync"), mask_, v_, EMULATOR_BITS_XOR, EMULATOR_BITS_XOR)
#define __activemask() emulator_refused("__activemask says who happens to run beside a thread: name the lanes that are meant")

template <class T> static inline T emulator_shuffle(const emulator_site *site, int kind, unsigned mask, T value, int argument, int width = 32)
{
    static_assert(std::is_arithmetic_v<T> && sizeof(T) <= 8, "a number of at most 8 bytes can be shuffled");
    uint64_t bits = 0;
    __builtin_memcpy(&bits, &value, sizeof value);
    bits = emulator->exchange(site, mask, bits, kind, argument, width);
    __builtin_memcpy(&value, &bits, sizeof value);
    return value;
}
static inline uint64_t emulator_bits(const emulator_site *site, unsigned mask, uint64_t value, int kind)
{
    return emulator->exchange(site, mask, value, kind, 0, 32);
}
template <class T> static inline T emulator_reduce(const emulator_site *site, unsigned mask, T value, int kind, int unsigned_kind)
{
    static_assert(std::is_integral_v<T> && sizeof(T) == 4, "int and unsigned are reduced by a warp");
    return (T)emulator->exchange(site, mask, (uint64_t)(unsigned)value, std::is_signed_v<T> ? kind : unsigned_kind, 0, 32);
}
struct emulator_warp {
    const emulator_site *site;
    void operator()(unsigned mask = 0xffffffffu) const { emulator->exchange(site, mask, 0, EMULATOR_SYNC, 0, 32); }
};

/* ---- memory ---- */

#ifdef EMULATOR_CHECKED
#define EMULATOR_UNSEEN __attribute__((noinline, no_sanitize("thread"), no_sanitize("undefined")))
#define memcpy(to_, from_, n_) (emulator->touch(from_, n_, false), emulator->touch(to_, n_, true), __builtin_memcpy(to_, from_, n_))
#define memset(to_, c_, n_)    (emulator->touch(to_, n_, true), __builtin_memset(to_, c_, n_))
#else
#define EMULATOR_UNSEEN inline
#endif
#define EMULATOR_ATOMIC(name_, result_)                                                                                             \
    template <class T, class V> EMULATOR_UNSEEN static T name_(T *at, V operand)                                                    \
    {                                                                                                                               \
        static_assert(std::is_integral_v<T>, "atomics on floating-point numbers give other bits in every run: reduce in a fixed order"); \
        emulator->atomic(at, sizeof *at);                                                                                           \
        const T old = *at, v = (T)operand;                                                                                          \
        *at = (T)(result_);                                                                                                         \
        return old;                                                                                                                 \
    }
EMULATOR_ATOMIC(atomicAdd, (std::make_unsigned_t<T>)old + (std::make_unsigned_t<T>)v)
EMULATOR_ATOMIC(atomicSub, (std::make_unsigned_t<T>)old - (std::make_unsigned_t<T>)v)
EMULATOR_ATOMIC(atomicMax, v > old ? v : old)
EMULATOR_ATOMIC(atomicMin, v < old ? v : old)
EMULATOR_ATOMIC(atomicAnd, old &v)
EMULATOR_ATOMIC(atomicOr, old | v)
EMULATOR_ATOMIC(atomicXor, old ^ v)
EMULATOR_ATOMIC(atomicExch, v)
template <class T, class V, class W> EMULATOR_UNSEEN static T atomicCAS(T *at, V expected, W value)
{
    static_assert(std::is_integral_v<T>, "compare and swap is for whole numbers");
    emulator->atomic(at, sizeof *at);
    const T old = *at;
    if (old == (T)expected) *at = (T)value;
    return old;
}
#define __ldg(at_) (*(at_))
static inline void __threadfence() {}
static inline void __threadfence_block() {}
#define __trap()       emulator->trap("__trap")
#define assert(truth_) ((truth_) ? (void)0 : emulator->trap("assert(" #truth_ ")"))
extern "C" unsigned emulator_refused(const char *) __attribute__((error("this function is refused; see shim.h")));

struct __align__(8) float2 { float x, y; };
struct float3 { float x, y, z; };
struct __align__(16) float4 { float x, y, z, w; };
struct __align__(16) double2 { double x, y; };
struct __align__(8) int2 { int x, y; };
struct __align__(16) int4 { int x, y, z, w; };
struct __align__(8) uint2 { unsigned x, y; };
struct __align__(16) uint4 { unsigned x, y, z, w; };
static inline float2 make_float2(float x, float y) { return { x, y }; }
static inline float3 make_float3(float x, float y, float z) { return { x, y, z }; }
static inline float4 make_float4(float x, float y, float z, float w) { return { x, y, z, w }; }
static inline double2 make_double2(double x, double y) { return { x, y }; }
static inline int2 make_int2(int x, int y) { return { x, y }; }
static inline int4 make_int4(int x, int y, int z, int w) { return { x, y, z, w }; }
static inline uint2 make_uint2(unsigned x, unsigned y) { return { x, y }; }
static inline uint4 make_uint4(unsigned x, unsigned y, unsigned z, unsigned w) { return { x, y, z, w }; }

/* ---- numbers ---- */

template <class T, class U> static inline constexpr std::common_type_t<T, U> min(T a, U b) { return b < a ? b : a; }
template <class T, class U> static inline constexpr std::common_type_t<T, U> max(T a, U b) { return a < b ? b : a; }
static inline float rsqrtf(float x) { return 1.0f / sqrtf(x); }
static inline double rsqrt(double x) { return 1.0 / sqrt(x); }
static inline int __popc(unsigned x) { return __builtin_popcount(x); }
static inline int __popcll(unsigned long long x) { return __builtin_popcountll(x); }
static inline int __ffs(int x) { return __builtin_ffs(x); }
static inline int __ffsll(long long x) { return __builtin_ffsll(x); }
static inline int __clz(int x) { return x ? __builtin_clz((unsigned)x) : 32; }
static inline int __clzll(long long x) { return x ? __builtin_clzll((unsigned long long)x) : 64; }
static inline unsigned __umulhi(unsigned a, unsigned b) { return (unsigned)((uint64_t)a * b >> 32); }
template <class T, class F> static inline T emulator_cast(F from)
{
    static_assert(sizeof(T) == sizeof(F), "as many bits");
    T to;
    __builtin_memcpy(&to, &from, sizeof to);
    return to;
}
static inline float __int_as_float(int x) { return emulator_cast<float>(x); }
static inline int __float_as_int(float x) { return emulator_cast<int>(x); }
static inline float __uint_as_float(unsigned x) { return emulator_cast<float>(x); }
static inline unsigned __float_as_uint(float x) { return emulator_cast<unsigned>(x); }
static inline double __longlong_as_double(long long x) { return emulator_cast<double>(x); }
static inline long long __double_as_longlong(double x) { return emulator_cast<long long>(x); }
static inline float __fmaf_rn(float a, float b, float c) { return fmaf(a, b, c); }
static inline float __fmul_rn(float a, float b) { return a * b; }
static inline float __fadd_rn(float a, float b) { return a + b; }
static inline double __dmul_rn(double a, double b) { return a * b; }
static inline double __dadd_rn(double a, double b) { return a + b; }
#define __fdividef(a_, b_) ((a_) / (b_))
#define __expf(x_)  expf(x_)
#define __logf(x_)  logf(x_)
#define __sinf(x_)  sinf(x_)
#define __cosf(x_)  cosf(x_)
#define __powf(x_, y_) powf(x_, y_)

#endif
