/* strand_vector (private): the vector type of a printed kernel, a few functions on it, and the transposition of tiles.
 * HG_BYTES (4 or 8) and HG_LANES (2, 4, 8 or 16) are defined by whoever compiles the kernel. GCC vector extensions, which
 * gcc (12 and later) and clang have for every processor; on x86 the operations that they lack are intrinsics. */
#ifndef HG_STRAND_VECTOR_H
#define HG_STRAND_VECTOR_H

#include "autograd/trace/strand_kernel.h"

#include <math.h>
#include <string.h>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#if HG_BYTES == 8
typedef double hg_real;
typedef int64_t hg_integer;
#define HG_R(literal) literal
#define HG_MATH(name) name
#else
typedef float hg_real;
typedef int32_t hg_integer;
#define HG_R(literal) literal##f
#define HG_MATH(name) name##f
#endif
typedef hg_real hg_v __attribute__((vector_size(HG_LANES * HG_BYTES), may_alias));
typedef hg_v *restrict hg_tile; /* rows of a tile */
typedef const hg_v *restrict hg_tile_read;
typedef hg_integer hg_m __attribute__((vector_size(HG_LANES * HG_BYTES), may_alias));

#if defined(__clang__)
#define HG_UNROLL _Pragma("unroll")
#else
#define HG_UNROLL _Pragma("GCC unroll 16")
#endif
#define HG_EACH HG_UNROLL for (int l = 0; l < HG_LANES; l++)

static inline hg_v hg_v_all(hg_real a) { return a - (hg_v){ 0 }; }

/* condition ? a : b, bit for bit: what is not chosen cannot spoil the result */
static inline hg_v hg_v_choose(hg_m condition, hg_v a, hg_v b)
{
    return (hg_v)((condition & (hg_m)a) | (~condition & (hg_m)b));
}

#if defined(__AVX512F__) && HG_BYTES == 4 && HG_LANES == 16
static inline hg_v hg_v_sqrt(hg_v a) { return (hg_v)_mm512_sqrt_ps((__m512)a); }
/* 14 bits and one Newton step: within 2 units in the last place of 1/sqrt(a), at a third of the time */
static inline hg_v hg_v_rsqrt(hg_v a)
{
    const hg_v y = (hg_v)_mm512_rsqrt14_ps((__m512)a);
    return y + (0.5f * y) * (1.0f - (a * y) * y);
}
static inline hg_v hg_v_min(hg_v a, hg_v b) { return (hg_v)_mm512_min_ps((__m512)b, (__m512)a); }
static inline hg_v hg_v_max(hg_v a, hg_v b) { return (hg_v)_mm512_max_ps((__m512)b, (__m512)a); }
static inline hg_v hg_v_if_less(hg_v a, hg_v b, hg_v c, hg_v d)
{
    return (hg_v)_mm512_mask_blend_ps(_mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_LT_OQ), (__m512)d, (__m512)c);
}
#elif defined(__AVX512F__) && HG_BYTES == 8 && HG_LANES == 8
static inline hg_v hg_v_sqrt(hg_v a) { return (hg_v)_mm512_sqrt_pd((__m512d)a); }
static inline hg_v hg_v_rsqrt(hg_v a) { return 1.0 / hg_v_sqrt(a); }
static inline hg_v hg_v_min(hg_v a, hg_v b) { return (hg_v)_mm512_min_pd((__m512d)b, (__m512d)a); }
static inline hg_v hg_v_max(hg_v a, hg_v b) { return (hg_v)_mm512_max_pd((__m512d)b, (__m512d)a); }
static inline hg_v hg_v_if_less(hg_v a, hg_v b, hg_v c, hg_v d)
{
    return (hg_v)_mm512_mask_blend_pd(_mm512_cmp_pd_mask((__m512d)a, (__m512d)b, _CMP_LT_OQ), (__m512d)d, (__m512d)c);
}
#else
#if defined(__AVX__) && HG_BYTES == 4 && HG_LANES == 8
static inline hg_v hg_v_sqrt(hg_v a) { return (hg_v)_mm256_sqrt_ps((__m256)a); }
static inline hg_v hg_v_min(hg_v a, hg_v b) { return (hg_v)_mm256_min_ps((__m256)b, (__m256)a); }
static inline hg_v hg_v_max(hg_v a, hg_v b) { return (hg_v)_mm256_max_ps((__m256)b, (__m256)a); }
#elif defined(__AVX__) && HG_BYTES == 8 && HG_LANES == 4
static inline hg_v hg_v_sqrt(hg_v a) { return (hg_v)_mm256_sqrt_pd((__m256d)a); }
static inline hg_v hg_v_min(hg_v a, hg_v b) { return (hg_v)_mm256_min_pd((__m256d)b, (__m256d)a); }
static inline hg_v hg_v_max(hg_v a, hg_v b) { return (hg_v)_mm256_max_pd((__m256d)b, (__m256d)a); }
#elif defined(__SSE2__) && HG_BYTES == 4 && HG_LANES == 4
static inline hg_v hg_v_sqrt(hg_v a) { return (hg_v)_mm_sqrt_ps((__m128)a); }
static inline hg_v hg_v_min(hg_v a, hg_v b) { return (hg_v)_mm_min_ps((__m128)b, (__m128)a); }
static inline hg_v hg_v_max(hg_v a, hg_v b) { return (hg_v)_mm_max_ps((__m128)b, (__m128)a); }
#elif defined(__SSE2__) && HG_BYTES == 8 && HG_LANES == 2
static inline hg_v hg_v_sqrt(hg_v a) { return (hg_v)_mm_sqrt_pd((__m128d)a); }
static inline hg_v hg_v_min(hg_v a, hg_v b) { return (hg_v)_mm_min_pd((__m128d)b, (__m128d)a); }
static inline hg_v hg_v_max(hg_v a, hg_v b) { return (hg_v)_mm_max_pd((__m128d)b, (__m128d)a); }
#else
static inline hg_v hg_v_sqrt(hg_v a)
{
    HG_EACH a[l] = HG_MATH(sqrt)(a[l]);
    return a;
}
static inline hg_v hg_v_min(hg_v a, hg_v b) { return hg_v_choose((hg_m)(b < a), b, a); }
static inline hg_v hg_v_max(hg_v a, hg_v b) { return hg_v_choose((hg_m)(a < b), b, a); }
#endif
static inline hg_v hg_v_rsqrt(hg_v a) { return HG_R(1.0) / hg_v_sqrt(a); }
static inline hg_v hg_v_if_less(hg_v a, hg_v b, hg_v c, hg_v d) { return hg_v_choose((hg_m)(a < b), c, d); }
#endif

static inline hg_v hg_v_less(hg_v a, hg_v b) { return hg_v_if_less(a, b, hg_v_all(1), hg_v_all(0)); }
static inline hg_v hg_v_select(hg_v c, hg_v a, hg_v b) { return hg_v_choose((hg_m)(c != 0), a, b); }
static inline hg_v hg_v_abs(hg_v a) { return hg_v_max(a, -a); }

#define HG_V_FUNCTION(name)                                                                                            \
    static inline hg_v hg_v_##name(hg_v a)                                                                             \
    {                                                                                                                  \
        HG_EACH a[l] = HG_MATH(name)(a[l]);                                                                            \
        return a;                                                                                                      \
    }
HG_V_FUNCTION(exp)
HG_V_FUNCTION(log)
HG_V_FUNCTION(sin)
HG_V_FUNCTION(cos)
static inline hg_v hg_v_atan2(hg_v a, hg_v b)
{
    HG_EACH a[l] = HG_MATH(atan2)(a[l], b[l]);
    return a;
}

/* ---- tiles -------------------------------------------------------------------------------------------------- */

/* One step of the transposition of HG_LANES rows: blocks of k columns change places between rows k apart. */
#define HG_SWAP(k, low, high)                                                                                          \
    HG_UNROLL                                                                                                          \
    for (int i = 0; i < HG_LANES; i++)                                                                                 \
        if (!(i & k)) {                                                                                                \
            const hg_v a = m[i], b = m[i + k];                                                                         \
            m[i] = __builtin_shufflevector(a, b, low);                                                                 \
            m[i + k] = __builtin_shufflevector(a, b, high);                                                            \
        }
#define HG_LIST(...) __VA_ARGS__

static inline __attribute__((always_inline)) void hg_v_transpose(hg_v *m)
{
#if HG_LANES == 16
    HG_SWAP(8, HG_LIST(0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23),
            HG_LIST(8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31))
    HG_SWAP(4, HG_LIST(0, 1, 2, 3, 16, 17, 18, 19, 8, 9, 10, 11, 24, 25, 26, 27),
            HG_LIST(4, 5, 6, 7, 20, 21, 22, 23, 12, 13, 14, 15, 28, 29, 30, 31))
    HG_SWAP(2, HG_LIST(0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29),
            HG_LIST(2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31))
    HG_SWAP(1, HG_LIST(0, 16, 2, 18, 4, 20, 6, 22, 8, 24, 10, 26, 12, 28, 14, 30),
            HG_LIST(1, 17, 3, 19, 5, 21, 7, 23, 9, 25, 11, 27, 13, 29, 15, 31))
#elif HG_LANES == 8
    HG_SWAP(4, HG_LIST(0, 1, 2, 3, 8, 9, 10, 11), HG_LIST(4, 5, 6, 7, 12, 13, 14, 15))
    HG_SWAP(2, HG_LIST(0, 1, 8, 9, 4, 5, 12, 13), HG_LIST(2, 3, 10, 11, 6, 7, 14, 15))
    HG_SWAP(1, HG_LIST(0, 8, 2, 10, 4, 12, 6, 14), HG_LIST(1, 9, 3, 11, 5, 13, 7, 15))
#elif HG_LANES == 4
    HG_SWAP(2, HG_LIST(0, 1, 4, 5), HG_LIST(2, 3, 6, 7))
    HG_SWAP(1, HG_LIST(0, 4, 2, 6), HG_LIST(1, 5, 3, 7))
#elif HG_LANES == 2
    HG_SWAP(1, HG_LIST(0, 2), HG_LIST(1, 3))
#else
#error "HG_LANES is 2, 4, 8 or 16"
#endif
}

/* Where the scratch's row `at` is, and the values of a groom's tile, `size` for each strand. */
static inline hg_v *hg_v_tile(void *scratch, int64_t at) { return (hg_v *)scratch + at; }
static inline const hg_v *hg_v_stored(const void *from, int64_t tile, int64_t size)
{
    return (const hg_v *)from + tile * size;
}

/* width numbers of each strand, row by row, to [width][HG_LANES]; strands that are missing repeat the last one. */
static inline void hg_v_load_tile(hg_v *tile, const hg_real *rows, int64_t width, int64_t count)
{
    if (width < HG_LANES) {
        for (int64_t j = 0; j < width; j++) HG_EACH tile[j][l] = rows[(l < count ? l : count - 1) * width + j];
        return;
    }
    for (int64_t j = 0; j < width; j += HG_LANES) {
        if (j > width - HG_LANES) j = width - HG_LANES; /* the last block overlaps the one before */
        hg_v m[HG_LANES];
        HG_EACH memcpy(&m[l], rows + (l < count ? l : count - 1) * width + j, sizeof m[l]);
        hg_v_transpose(m);
        HG_EACH tile[j + l] = m[l];
    }
}

static inline void hg_v_store_tile(hg_real *rows, const hg_v *tile, int64_t width, int64_t count)
{
    if (width < HG_LANES) {
        for (int64_t j = 0; j < width; j++)
            for (int l = 0; l < count; l++) rows[l * width + j] = tile[j][l];
        return;
    }
    for (int64_t j = 0; j < width; j += HG_LANES) {
        if (j > width - HG_LANES) j = width - HG_LANES;
        hg_v m[HG_LANES];
        HG_EACH m[l] = tile[j + l];
        hg_v_transpose(m);
        for (int l = 0; l < count && l < HG_LANES; l++) memcpy(rows + l * width + j, &m[l], sizeof m[l]);
    }
}

/* `bytes` at `from` + `offset`, to be read soon (or written): while a tile is at work, the lines of the next one come in. The
 * processor cannot look that far ahead by itself. A line that is not there is asked for without harm. */
static inline __attribute__((always_inline)) void hg_v_soon(const void *from, int64_t offset, int bytes)
{
    HG_UNROLL
    for (int b = 0; b < bytes; b += 64)
        __builtin_prefetch((const void *)((uintptr_t)from + (uintptr_t)(offset + b)), 0, 2);
}
static inline __attribute__((always_inline)) void hg_v_soon_written(const void *to, int64_t offset, int bytes)
{
    HG_UNROLL
    for (int b = 0; b < bytes; b += 64)
        __builtin_prefetch((const void *)((uintptr_t)to + (uintptr_t)(offset + b)), 1, 2);
}

/* Energies of a tile's strands, one vector per term. */
static inline void hg_v_store_energy(const hg_strand_args *args, int64_t tile, int64_t strand, int64_t count,
                                     const hg_v *energy, int terms)
{
    for (int t = 0; t < terms; t++) {
        double sum = 0;
        for (int l = 0; l < count; l++) sum += (double)energy[t][l];
        args->energy[tile * terms + t] = sum;
        if (args->per_strand)
            for (int l = 0; l < count; l++)
                args->per_strand[(strand + l) * args->stride + args->column[t]] = (double)energy[t][l];
    }
}

#endif
