/* Kernels of the body tree: what a refit writes, bottom up, and the closest triangles. The one text serves the processor and a
 * GPU but for the search: the processor tests sixteen boxes or triangles at a time and remembers what is near for points in a
 * row (geometry/body_search.h), a thread of a GPU goes its own way through the same tree. */
#include "tensor/kernel.h"
#include "geometry/vector.h"
#include "geometry/body_place.inc"

typedef struct {
    hg_body_fit body;
    const void *from; /* [frames,N,3] */
} hg_body_refit_args;

typedef struct {
    hg_body_fit body;
    int64_t points_of_frame;
    double reach;
    int mode;
    const void *points; /* [frames,points,3] */
    int32_t *triangle;
    void *contact_point, *contact_normal;
} hg_body_query;

#ifdef HG_CUDA
#define HG_BODY_TIES             8                         /* more than this many tied triangles take a second search */
#define HG_BODY_FRAME(i_, size_) frame_of_index(i_, size_) /* all frames in one launch */
#else
#define HG_BODY_TIES             32
#define HG_BODY_FRAME(i_, size_) 0 /* a launch for each frame */
#endif
#define HG_BODY_JUMP     0.03 /* m: points that follow each other farther apart are of different strands */
#define HG_BODY_INFINITY ((hg_real)3e38)

HG_BODY int64_t frame_of_index(int64_t i, int64_t size)
{
    int64_t rest;
    return hg_divide(i, size, &rest);
}

HG_BODY hg_vec3d widen_f64(hg_vec3d a) { return a; }
HG_BODY hg_vec3d narrow_f64(hg_vec3d a) { return a; }
HG_BODY hg_vec3d widen_f32(hg_vec3f a) { return hg_vec3d_from_f(a); }
HG_BODY hg_vec3f narrow_f32(hg_vec3d a) { return hg_vec3f_from_d(a); }

/* per precision: least number that is divided by, sliver (4 area^2 against edges^4), slack of a squared bound, and how
 * near [m] a direction is rounding */
#define least_f64  1e-290
#define sliver_f64 1e-20
#define slack_f64  (1.0 + 1e-12)
#define near_f64   1e-9
#define least_f32  1e-35
#define sliver_f32 1e-6
#define slack_f32  (1.0 + 1e-5)
#define near_f32   1e-6

#define HG_B(name) HG_JOIN(name, _, HG_TYPE)

#define hg_real       double
#define HG_SUFFIX     d
#define HG_TYPE       f64
#define HG_VEC3       hg_vec3d
#define HG_MATH(name) name
#include "geometry/body.inc"
#undef hg_real
#undef HG_SUFFIX
#undef HG_TYPE
#undef HG_VEC3
#undef HG_MATH

#define hg_real       float
#define HG_SUFFIX     f
#define HG_TYPE       f32
#define HG_VEC3       hg_vec3f
#define HG_MATH(name) name##f
#include "geometry/body.inc"
#undef hg_real
#undef HG_SUFFIX
#undef HG_TYPE
#undef HG_VEC3
#undef HG_MATH

HG_KERNELS(body_faces, hg_body_refit_args, 1024)
HG_KERNELS(body_vertices, hg_body_refit_args, 1024)
HG_KERNELS(body_leaves, hg_body_refit_args, 64)
HG_KERNELS_BLOCK(body_nodes, hg_body_refit_args, 1, 256)
HG_KERNELS(body_closest, hg_body_query, 512)
