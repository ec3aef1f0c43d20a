/* Curves of equal arc length. Linear resampling makes kinks that would become rest curvature, so a strand is read as a
 * centripetal Catmull-Rom curve (Catmull and Rom 1974; Yuksel, Schaefer and Keyser 2011: no cusps, no loops), in its
 * Hermite form. */
#include "scene/internal.h"

enum { CHORDS = 24 }; /* per segment, to measure its length */

typedef struct {
    hg_vec3d p0, p1, m0, m1;
} hermite;

static hg_vec3d hermite_at(const hermite *h, double u)
{
    double u2 = u * u, u3 = u2 * u;
    hg_vec3d x = hg_vec3d_scale(h->p0, 2 * u3 - 3 * u2 + 1);
    x = hg_vec3d_add_scaled(x, u3 - 2 * u2 + u, h->m0);
    x = hg_vec3d_add_scaled(x, 3 * u2 - 2 * u3, h->p1);
    return hg_vec3d_add_scaled(x, u3 - u2, h->m1);
}

/* The point before a, of a curve that goes on through a, b, c: the mirror image of c in the plane half way between a and
 * b, which keeps the curvature of the end (a circle stays one). */
static hg_vec3d mirrored(hg_vec3d a, hg_vec3d b, hg_vec3d c)
{
    hg_vec3d axis = hg_vec3d_normalize(hg_vec3d_sub(b, a));
    double across = hg_vec3d_dot(hg_vec3d_sub(c, hg_vec3d_mix(a, b, 0.5)), axis);
    return hg_vec3d_add_scaled(c, -2 * across, axis);
}

/* The segment from point i to i + 1. */
static hermite hermite_segment(const double *points, int64_t n, int64_t i)
{
    hg_vec3d p[4];
    p[1] = hg_vec3d_load(points + 3 * i), p[2] = hg_vec3d_load(points + 3 * (i + 1));
    p[0] = hg_vec3d_sub(hg_vec3d_scale(p[1], 2), p[2]), p[3] = hg_vec3d_sub(hg_vec3d_scale(p[2], 2), p[1]);
    if (i > 0) p[0] = hg_vec3d_load(points + 3 * (i - 1));
    if (i + 2 < n) p[3] = hg_vec3d_load(points + 3 * (i + 2));
    if (i == 0 && n > 2) p[0] = mirrored(p[1], p[2], p[3]);
    if (i + 2 == n && n > 2) p[3] = mirrored(p[2], p[1], p[0]);
    double t01 = sqrt(hg_vec3d_distance(p[0], p[1])), t12 = sqrt(hg_vec3d_distance(p[1], p[2]));
    double t23 = sqrt(hg_vec3d_distance(p[2], p[3]));
    hg_vec3d slope = hg_vec3d_scale(hg_vec3d_sub(p[2], p[1]), 1 / t12);
    hg_vec3d m0 = hg_vec3d_add_scaled(slope, 1 / t01, hg_vec3d_sub(p[1], p[0]));
    hg_vec3d m1 = hg_vec3d_add_scaled(slope, 1 / t23, hg_vec3d_sub(p[3], p[2]));
    m0 = hg_vec3d_add_scaled(m0, -1 / (t01 + t12), hg_vec3d_sub(p[2], p[0]));
    m1 = hg_vec3d_add_scaled(m1, -1 / (t12 + t23), hg_vec3d_sub(p[3], p[1]));
    return (hermite){ p[1], p[2], hg_vec3d_scale(m0, t12), hg_vec3d_scale(m1, t12) };
}

void scene_resample(const double *points, int64_t n, int64_t vertices, float *out)
{
    double length = 0, passed = 0;
    int64_t next = 1; /* the vertex to be placed */
    hg_vec3d tip = hg_vec3d_load(points + 3 * (n - 1));
    for (int pass = 0; pass < 2; pass++) { /* the length; the vertices */
        for (int64_t i = 0; i + 1 < n; i++) {
            hermite h = hermite_segment(points, n, i);
            hg_vec3d from = h.p0;
            for (int k = 0; k < CHORDS; k++) {
                hg_vec3d to = hermite_at(&h, (double)(k + 1) / CHORDS);
                double chord = hg_vec3d_distance(from, to);
                if (pass == 0) length += chord;
                for (; pass == 1 && next < vertices - 1 && chord > 0; next++) {
                    double target = length * (double)next / (double)(vertices - 1);
                    if (target > passed + chord) break;
                    scene_put(out + 3 * next, hermite_at(&h, (k + (target - passed) / chord) / CHORDS));
                }
                if (pass == 1) passed += chord;
                from = to;
            }
        }
    }
    for (; next < vertices; next++) scene_put(out + 3 * next, tip); /* and what rounding left unplaced */
    scene_put(out, hg_vec3d_load(points));
}
