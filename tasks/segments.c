/* segments: what became of the segments of strands: their lengths, how they are turned, what is left of the bends that the
 * style has, and how far the tips went. Seen from the rigidly posed groom. */
#include "tasks/hair.h"

#include "geometry/vector.h"

#include <math.h>

static hg_vec3d between(const float *a, const float *b)
{
    return hg_vec3d_make((double)b[0] - (double)a[0], (double)b[1] - (double)a[1], (double)b[2] - (double)a[2]);
}

static double angle(hg_vec3d a, hg_vec3d b) { return atan2(hg_vec3d_norm(hg_vec3d_cross(a, b)), hg_vec3d_dot(a, b)); }

void hg_hair_segments_add(hg_hair_segments *sum, int64_t S, int64_t V, const float *x, const float *posed,
                          const double *lengths)
{
    for (int64_t s = 0; s < S; s++) {
        double strand = 0;
        hg_vec3d before[2] = { { 0 }, { 0 } };
        for (int64_t v = 0; v + 1 < V; v++) {
            const int64_t at = (s * V + v) * 3;
            const hg_vec3d now[2] = { between(x + at, x + at + 3), between(posed + at, posed + at + 3) };
            const double rest = fmax(lengths[s * (V - 1) + v], 1e-6);
            sum->length_error += fabs(hg_vec3d_norm(now[0]) - rest) / rest;
            sum->orientation += angle(now[0], now[1]);
            for (int k = 0; k < 2; k++) {
                if (v > 0) sum->bend[k] += angle(before[k], now[k]);
                before[k] = now[k];
            }
            strand += rest;
        }
        const int64_t tip = (s * V + V - 1) * 3;
        sum->tips += hg_vec3d_norm(between(posed + tip, x + tip)) / fmax(strand, 1e-6);
    }
    sum->strands += S;
    sum->segments += S * (V - 1);
}

void hg_hair_segments_mean(const hg_hair_segments *sum, hg_hair_metrics *metrics)
{
    if (!sum->segments) return;
    metrics->length_error = 100 * sum->length_error / (double)sum->segments;
    metrics->orientation = sum->orientation / (double)sum->segments * 180 / 3.14159265358979323846;
    metrics->curl = sum->bend[1] > 0 ? sum->bend[0] / sum->bend[1] : (double)NAN;
    metrics->tip_moved = 100 * sum->tips / (double)sum->strands;
}
