/* Which triangles can be seen from outside: the faces are drawn, without perspective and with a depth buffer, from
 * directions spread evenly over the sphere (a Fibonacci spiral). A face is seen when it owns at least a few per cent of
 * the pixels that it would have alone: one glimpse through a slit between lips is not enough. */
#include "scene/visible.h"

#include "geometry/vector.h"

#include <string.h>

#define DIRECTIONS  48
#define EXPOSED     0.05 /* least part of a face's pixels, over the pictures that it faces, that nothing hides */
#define MOST_PIXELS 512  /* of a picture's side: about 1.5 mm for head and shoulders; small meshes need fewer */

typedef struct {
    hg_vec3d centre, across, up, towards;
    int side;     /* in pixels */
    double scale; /* pixels per metre */
    float *depth;
    int32_t *owner;
    int64_t *covered, *owned; /* [faces] pixels, over all pictures */
} picture;

static void draw(picture *to, const float *vertices, const int32_t *corner, int32_t face)
{
    double x[3], y[3], z[3];
    for (int k = 0; k < 3; k++) {
        const float *v = vertices + 3 * (int64_t)corner[k];
        hg_vec3d p = hg_vec3d_sub(hg_vec3d_make((double)v[0], (double)v[1], (double)v[2]), to->centre);
        x[k] = hg_vec3d_dot(p, to->across) * to->scale + 0.5 * to->side;
        y[k] = hg_vec3d_dot(p, to->up) * to->scale + 0.5 * to->side;
        z[k] = hg_vec3d_dot(p, to->towards);
    }
    double area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]);
    double left = fmin(x[0], fmin(x[1], x[2])), right = fmax(x[0], fmax(x[1], x[2]));
    double bottom = fmin(y[0], fmin(y[1], y[2])), top = fmax(y[0], fmax(y[1], y[2]));
    if (area < 1e-9 || !(right >= 0.5 && left <= to->side - 0.5 && top >= 0.5 && bottom <= to->side - 0.5)) return;
    int column_first = (int)ceil(fmax(left, 0.5) - 0.5), column_last = (int)floor(fmin(right, to->side - 0.5) - 0.5);
    int row_first = (int)ceil(fmax(bottom, 0.5) - 0.5), row_last = (int)floor(fmin(top, to->side - 0.5) - 0.5);
    for (int row = row_first; row <= row_last; row++)
        for (int column = column_first; column <= column_last; column++) {
            double px = column + 0.5 - x[0], py = row + 0.5 - y[0];
            double b = (px * (y[2] - y[0]) - (x[2] - x[0]) * py) / area;
            double c = ((x[1] - x[0]) * py - px * (y[1] - y[0])) / area;
            if (b < 0 || c < 0 || b + c > 1) continue;
            float depth = (float)(z[0] + b * (z[1] - z[0]) + c * (z[2] - z[0]));
            to->covered[face]++;
            int64_t pixel = (int64_t)row * to->side + column;
            if (to->owner[pixel] >= 0 && depth <= to->depth[pixel]) continue;
            to->depth[pixel] = depth;
            to->owner[pixel] = face;
        }
}

static void look(picture *to, int direction, const float *vertices, int64_t n_faces, const int32_t *faces)
{
    double height = 1 - 2 * (direction + 0.5) / DIRECTIONS, radius = sqrt(1 - height * height);
    double turn = direction * 3.14159265358979323846 * (3 - sqrt(5.0));
    to->towards = hg_vec3d_make(radius * cos(turn), height, radius * sin(turn));
    to->across = hg_vec3d_perpendicular(to->towards);
    to->up = hg_vec3d_cross(to->towards, to->across);
    for (int64_t i = 0; i < (int64_t)to->side * to->side; i++) to->owner[i] = -1;
    for (int64_t f = 0; f < n_faces; f++) draw(to, vertices, faces + 3 * f, (int32_t)f);
    for (int64_t i = 0; i < (int64_t)to->side * to->side; i++)
        if (to->owner[i] >= 0) to->owned[to->owner[i]]++;
}

hg_status scene_visible_faces(const char *path, int64_t n_vertices, const float *vertices, int64_t n_faces,
                              const int32_t *faces, int32_t *asked, int64_t *count)
{
    if (*count == 0) return HG_OK;
    const double far = (double)INFINITY;
    hg_vec3d low = hg_vec3d_make(far, far, far), high = hg_vec3d_neg(low);
    for (int64_t i = 0; i < 3 * *count; i++) {
        const float *v = vertices + 3 * (int64_t)faces[3 * (int64_t)asked[i / 3] + i % 3];
        low = hg_vec3d_make(fmin(low.x, (double)v[0]), fmin(low.y, (double)v[1]), fmin(low.z, (double)v[2]));
        high = hg_vec3d_make(fmax(high.x, (double)v[0]), fmax(high.y, (double)v[1]), fmax(high.z, (double)v[2]));
    }
    double radius = 0.5 * hg_vec3d_distance(low, high);
    if (!(radius > 0) || !isfinite(radius))
        return hg_fail(HG_NUMERIC, "%s: the faces that hair could reach span %g m", path, 2 * radius);

    int side = (int)fmin(MOST_PIXELS, 32 + 4 * sqrt((double)n_faces));
    picture to = { .centre = hg_vec3d_mix(low, high, 0.5), .side = side, .scale = 0.5 * side / radius };
    to.depth = hg_alloc((size_t)to.side * (size_t)to.side, sizeof *to.depth);
    to.owner = hg_alloc((size_t)to.side * (size_t)to.side, sizeof *to.owner);
    to.covered = hg_alloc((size_t)n_faces, sizeof *to.covered);
    to.owned = hg_alloc((size_t)n_faces, sizeof *to.owned);
    uint8_t *seen = hg_alloc((size_t)n_faces, 1), *near = hg_alloc((size_t)n_vertices, 1);
    hg_status status = to.depth && to.owner && to.covered && to.owned && seen && near ? HG_OK : HG_MEMORY;
    if (status == HG_OK) {
        for (int d = 0; d < DIRECTIONS; d++) look(&to, d, vertices, n_faces, faces);
        for (int64_t f = 0; f < n_faces; f++)
            seen[f] = to.owned[f] > 0 && (double)to.owned[f] >= EXPOSED * (double)to.covered[f];
        for (int64_t f = 0; f < n_faces; f++)
            for (int k = 0; k < 3; k++) near[faces[3 * f + k]] |= seen[f];
        int64_t kept = 0;
        for (int64_t i = 0; i < *count; i++) {
            const int32_t *corner = faces + 3 * (int64_t)asked[i];
            if (near[corner[0]] || near[corner[1]] || near[corner[2]]) asked[kept++] = asked[i];
        }
        *count = kept;
    }
    hg_free(to.depth);
    hg_free(to.owner);
    hg_free(to.covered);
    hg_free(to.owned);
    hg_free(seen);
    hg_free(near);
    return status;
}
