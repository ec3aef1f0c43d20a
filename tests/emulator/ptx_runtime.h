/* What a translated kernel calls. Registers are bits; an instruction reads them as the type in its name. */
#ifndef EMULATOR_PTX_RUNTIME_H
#define EMULATOR_PTX_RUNTIME_H

#include "shim.h"

#include <stdio.h>
#include <stdlib.h>
#include <limits>
#include <type_traits>

typedef int8_t s8;
typedef int16_t s16;
typedef int32_t s32;
typedef int64_t s64;
typedef uint8_t u8, b8;
typedef uint16_t u16, b16;
typedef uint32_t u32, b32;
typedef uint64_t u64, b64;
typedef float f32;
typedef double f64;

template <class T> static inline T as(u64 bits) /* the low bits of a register as a T */
{
    T value;
    memcpy(&value, &bits, sizeof value);
    return value;
}
template <> inline bool as<bool>(u64 bits) { return bits != 0; }
template <class T> static inline u64 bits_of(T value) /* as an instruction of type T leaves it: signed ones extended */
{
    if constexpr (std::is_signed_v<T> && std::is_integral_v<T>) return (u64)(s64)value;
    u64 bits = 0;
    memcpy(&bits, &value, sizeof value);
    return bits;
}

/* ---- memory ---- */

[[noreturn]] static inline void ptx_stop(const char *kernel, const char *what)
{
    fprintf(stderr, "emulator: %s, block %u, thread %u: %s\n", kernel, blockIdx.x, threadIdx.x, what);
    abort();
}
template <class T> static inline u64 ptx_load(const char *kernel, u64 address, int vector, int k)
{
    if (k == 0 && address % (sizeof(T) * (unsigned)vector)) ptx_stop(kernel, "a misaligned load");
    T value;
    memcpy(&value, (const void *)(uintptr_t)(address + (unsigned)k * sizeof(T)), sizeof value);
    return bits_of(value);
}
template <class T> static inline void ptx_store(const char *kernel, u64 address, int vector, int k, u64 bits)
{
    if (k == 0 && address % (sizeof(T) * (unsigned)vector)) ptx_stop(kernel, "a misaligned store");
    const T value = as<T>(bits);
    memcpy((void *)(uintptr_t)(address + (unsigned)k * sizeof(T)), &value, sizeof value);
}

/* ---- numbers ---- */

template <class T> static inline T ptx_mul_hi(T a, T b)
{
    if constexpr (sizeof(T) == 8) {
        if constexpr (std::is_signed_v<T>) return (T)(((__int128)a * b) >> 64);
        else return (T)(((unsigned __int128)a * b) >> 64);
    } else {
        typedef std::conditional_t<std::is_signed_v<T>, s64, u64> wide;
        return (T)(((wide)a * (wide)b) >> (8 * sizeof(T)));
    }
}
template <class T> static inline T ptx_div(T a, T b)
{
    if constexpr (std::is_floating_point_v<T>) return a / b;
    else return b == 0 ? (T)-1 : std::is_signed_v<T> && b == (T)-1 ? (T)(0 - (std::make_unsigned_t<T>)a) : (T)(a / b);
}
template <class T> static inline T ptx_rem(T a, T b) { return b == 0 ? a : std::is_signed_v<T> && b == (T)-1 ? 0 : (T)(a % b); }
template <class T> static inline T ptx_min(T a, T b)
{
    if constexpr (std::is_floating_point_v<T>) return a != a ? b : b != b ? a : a < b ? a : b < a ? b : std::signbit(a) ? a : b;
    else return a < b ? a : b;
}
template <class T> static inline T ptx_max(T a, T b)
{
    if constexpr (std::is_floating_point_v<T>) return a != a ? b : b != b ? a : a > b ? a : b > a ? b : std::signbit(a) ? b : a;
    else return a > b ? a : b;
}
template <class T> static inline T ptx_shl(T a, u32 n) { return n >= 8 * sizeof(T) ? (T)0 : (T)(a << n); }
template <class T> static inline T ptx_shr(T a, u32 n) { return (T)(n >= 8 * sizeof(T) ? (std::is_signed_v<T> ? a >> (8 * sizeof(T) - 1) : 0) : a >> n); }
template <class T> static inline T ptx_bfe(T a, u32 at, u32 length)
{
    at &= 0xff, length &= 0xff;
    const u32 width = 8 * sizeof(T);
    if (length == 0) return 0;
    typedef std::make_unsigned_t<T> bits;
    const bits all = (bits)a;
    bits value = at < width ? all >> at : 0;
    const bool sign = std::is_signed_v<T> && (all >> (at + length - 1 < width ? at + length - 1 : width - 1) & 1);
    if (length < width) value &= ((bits)1 << length) - 1;
    if (sign && length < width) value |= ~(((bits)1 << length) - 1);
    return (T)value;
}
template <class T> static inline T ptx_bfi(T a, T b, u32 at, u32 length)
{
    at &= 0xff, length &= 0xff;
    T result = b;
    for (u32 i = 0; i < length && at + i < 8 * sizeof(T); i++) result = (T)((result & ~((T)1 << (at + i))) | ((a >> i & 1) << (at + i)));
    return result;
}
static inline u32 ptx_lop3(u32 a, u32 b, u32 c, u32 table)
{
    u32 result = 0;
    for (int i = 0; i < 8; i++)
        if (table >> i & 1) result |= (i & 4 ? a : ~a) & (i & 2 ? b : ~b) & (i & 1 ? c : ~c);
    return result;
}
static inline u32 ptx_prmt(u32 a, u32 b, u32 selector)
{
    const u64 bytes = (u64)b << 32 | a;
    u32 result = 0;
    for (int i = 0; i < 4; i++) {
        const u32 s = selector >> (4 * i) & 0xf;
        u32 byte = (u32)(bytes >> (8 * (s & 7))) & 0xff;
        if (s & 8) byte = byte & 0x80 ? 0xff : 0;
        result |= byte << (8 * i);
    }
    return result;
}
static inline u32 ptx_shf_left(u32 low, u32 high, u32 n) { return n == 0 ? high : n >= 32 ? low : high << n | low >> (32 - n); }
static inline u32 ptx_shf_right(u32 low, u32 high, u32 n) { return n == 0 ? low : n >= 32 ? high : low >> n | high << (32 - n); }
static inline u32 ptx_brev(u32 a)
{
    u32 result = 0;
    for (int i = 0; i < 32; i++) result |= (a >> i & 1) << (31 - i);
    return result;
}
static inline f64 ptx_rcp_approximate(f64 x) /* the upper half of a number is all that is made */
{
    u64 bits = bits_of(1.0 / x) & 0xffffffff00000000u;
    return as<f64>(bits);
}
static inline f64 ptx_rsqrt_approximate(f64 x)
{
    u64 bits = bits_of(1.0 / sqrt(x)) & 0xffffffff00000000u;
    return as<f64>(bits);
}
enum ptx_rounding { RN, RZ, RM, RP };
template <class T> static inline T ptx_round(T x, ptx_rounding how) { return how == RN ? std::rint(x) : how == RZ ? std::trunc(x) : how == RM ? std::floor(x) : std::ceil(x); }
template <class To, class From> static inline To ptx_to_int(From x, ptx_rounding how)
{
    const From r = ptx_round(x, how);
    if (r != r) return sizeof(To) == 8 ? std::numeric_limits<To>::min() : 0;
    if (r <= (From)std::numeric_limits<To>::min()) return std::numeric_limits<To>::min();
    if (r >= (From)std::numeric_limits<To>::max()) return std::numeric_limits<To>::max();
    return (To)r;
}

/* ---- threads ---- */

static inline u32 ptx_lane() { return threadIdx.x & 31; }
/* The lane that a shuffle reads; `there`: is it inside of the segment? Otherwise it is this lane. */
static inline u32 ptx_source(char mode, u32 b, u32 c, bool *there)
{
    const u32 lane = ptx_lane(), segment = c >> 8 & 31, clamp = c & 31;
    const u32 first = lane & segment, last = first | (clamp & ~segment);
    s32 from;
    if (mode == 'u') from = (s32)lane - (s32)(b & 31), *there = from >= (s32)last;
    else if (mode == 'd') from = (s32)(lane + (b & 31)), *there = from <= (s32)last;
    else if (mode == 'b') from = (s32)(lane ^ (b & 31)), *there = from <= (s32)last;
    else from = (s32)(first | (b & 31 & ~segment)), *there = from <= (s32)last;
    return *there ? (u32)from : lane;
}

#endif
