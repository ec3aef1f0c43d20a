/* Scan: which of a run of sorted places lie within a radius of a point. The inner loop of every neighbour search. */
#ifndef HG_GEOMETRY_SCAN_H
#define HG_GEOMETRY_SCAN_H

#include "geometry/geometry.h"

#ifdef __AVX512F__
#include <immintrin.h>
#endif

/* Longer runs are scanned in pieces of this length; `hits` has room for a piece and HG_CELL_PAD more. */
#define HG_SCAN_PIECE 512

/* The places first <= q < last (at most HG_SCAN_PIECE) with |p_q - p|^2 <= radius2, in order, with their squared
 * distances; returns how many. x, y, z are those of hg_cells: readable HG_CELL_PAD beyond the last place. */
static inline int hg_scan_f(const float *x, const float *y, const float *z, int32_t first, int32_t last, float px,
                            float py, float pz, float radius2, int32_t *hits, float *distance2)
{
    int n = 0;
#ifdef __AVX512F__
    __m512 vx = _mm512_set1_ps(px), vy = _mm512_set1_ps(py), vz = _mm512_set1_ps(pz), r2 = _mm512_set1_ps(radius2);
    __m512i lanes = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    for (int32_t q = first; q < last; q += 16) {
        __m512 dx = _mm512_sub_ps(_mm512_loadu_ps(x + q), vx), dy = _mm512_sub_ps(_mm512_loadu_ps(y + q), vy);
        __m512 dz = _mm512_sub_ps(_mm512_loadu_ps(z + q), vz);
        __m512 d2 = _mm512_add_ps(_mm512_add_ps(_mm512_mul_ps(dx, dx), _mm512_mul_ps(dy, dy)), _mm512_mul_ps(dz, dz));
        __mmask16 hit = _mm512_cmp_ps_mask(d2, r2, _CMP_LE_OQ);
        if (last - q < 16) hit &= (__mmask16)((1u << (last - q)) - 1);
        _mm512_storeu_si512(hits + n, _mm512_maskz_compress_epi32(hit, _mm512_add_epi32(_mm512_set1_epi32(q), lanes)));
        _mm512_storeu_ps(distance2 + n, _mm512_maskz_compress_ps(hit, d2));
        n += __builtin_popcount(hit);
    }
#else
    float d2[HG_SCAN_PIECE];
    for (int32_t q = first; q < last; q++) {
        float dx = x[q] - px, dy = y[q] - py, dz = z[q] - pz;
        d2[q - first] = dx * dx + dy * dy + dz * dz;
    }
    for (int32_t q = first; q < last; q++) { /* written always, kept sometimes: no branch to mispredict */
        hits[n] = q;
        distance2[n] = d2[q - first];
        n += d2[q - first] <= radius2;
    }
#endif
    return n;
}

static inline int hg_scan_d(const double *x, const double *y, const double *z, int32_t first, int32_t last, double px,
                            double py, double pz, double radius2, int32_t *hits, double *distance2)
{
    int n = 0;
    double d2[HG_SCAN_PIECE];
    for (int32_t q = first; q < last; q++) {
        double dx = x[q] - px, dy = y[q] - py, dz = z[q] - pz;
        d2[q - first] = dx * dx + dy * dy + dz * dz;
    }
    for (int32_t q = first; q < last; q++) {
        hits[n] = q;
        distance2[n] = d2[q - first];
        n += d2[q - first] <= radius2;
    }
    return n;
}

#endif
