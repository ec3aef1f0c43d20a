/* What the files of scene/ share: checks on what a file says, units and axes, resampling. Private to scene/. */
#ifndef HG_SCENE_INTERNAL_H
#define HG_SCENE_INTERNAL_H

#include "geometry/vector.h"
#include "scene/scene.h"

#define SCENE_PI 3.14159265358979323846

/* Every number of data [rows,columns] is finite, or HG_NUMERIC names file, what and row. */
hg_status scene_check_finite(const char *path, const char *what, const float *data, int64_t rows, int64_t columns);
/* Every index of data lies in [low, high), or HG_FORMAT names file, what, place and value. */
hg_status scene_check_range(const char *path, const char *what, const int32_t *data, int64_t count, int64_t low,
                            int64_t high);

/* Unit and up axis of a file: attributes `unit` ("m", "cm", "1 inch"...) and `up_axis` ("+Y" or "+Z"), metres and +Y
 * when absent. */
typedef struct {
    double scale;
    bool z_up;
} scene_axes;
hg_status scene_axes_read(hg_h5 *file, const char *path, scene_axes *axes);
void scene_axes_points(const scene_axes *axes, float *points,
                       int64_t count); /* positions and offsets, to metres, +Y up */
void scene_axes_turn(const scene_axes *axes, float *quaternions,
                     int64_t count); /* rotations given about the file's axes */

/* A file of ours: `format`, version, unit and axes are looked at, then `read` fills `to`. */
hg_status scene_file_load(const char *path, const char *format,
                          hg_status (*read)(hg_h5 *file, const char *path, const scene_axes *axes, void *to), void *to);
/* The other way; the file appears when all of it was written. */
hg_status scene_file_save(const char *path, const char *format, hg_status (*write)(hg_h5 *file, const void *from),
                          const void *from);
hg_status scene_head_write(hg_h5 *file, const char *format); /* format, version, unit and axes */

hg_status scene_hash_write(hg_h5 *file, const char *name, uint64_t hash); /* as hexadecimal text */

/* A text attribute, or a copy of `otherwise` when the file has none. */
hg_status scene_text_or(hg_h5 *file, const char *name, const char *otherwise, char **text);

/* out [V,3]: V points of equal arc length on the centripetal Catmull-Rom curve through points [n,3]; both ends stay.
 * n >= 2, no two consecutive points equal, vertices >= 2. */
void scene_resample(const double *points, int64_t n, int64_t vertices, float *out);

/* 0 up to a, 1 from b on, with no jump in the first two derivatives. */
static inline double scene_ramp(double a, double b, double x)
{
    double t = fmin(fmax((x - a) / (b - a), 0), 1);
    return t * t * t * (t * (6 * t - 15) + 10);
}

static inline hg_vec3d scene_point(const float p[3]) { return hg_vec3d_make((double)p[0], (double)p[1], (double)p[2]); }

static inline void scene_put(float to[3], hg_vec3d p) { hg_vec3f_store(to, hg_vec3f_from_d(p)); }

/* What is wrong with a strand of n points in metres, if anything. */
typedef enum { STRAND_KEPT, STRAND_BALD, STRAND_ZERO_LENGTH, STRAND_NON_FINITE } scene_strand_kind;
scene_strand_kind scene_strand_classify(const float *points, int64_t n);
/* Leaves out points that repeat the one before; out [n,3], returns how many stay. */
int64_t scene_strand_points(const float *points, int64_t n, double *out);
#define SCENE_SHORTEST 1e-6 /* m; a strand below this has no direction, and rest lengths are never divided by less */

/* The number of vertices that every strand of curves has, or an error that names the first that has another: for formats
 * of equal strands. */
hg_status scene_equal_vertices(const hg_curves *curves, const char *path, int64_t *vertices);

/* An error that names the first strand that is not finite: for formats of text. */
hg_status scene_finite_strands(const hg_curves *curves, const char *path);

double scene_length(const float *points, int64_t vertices); /* of a strand, along it */

hg_status scene_motion_allocate(hg_motion **motion, int64_t frames, int64_t joints, char *const *names, double rate);

char **scene_texts_copy(char *const *texts, int64_t n);

#endif
