/* Body tree: moving it to a frame, and the closest triangle of every point (functions in body_functions.h, read once
 * per precision).
 *
 * A search starts with the distance to the guessed triangle as its bound, so that mostly one leaf is opened. Distances
 * to boxes and triangles are compared in the precision of the points; the closest point on the chosen triangle, the
 * sign and the normal are worked out in double.
 *
 * Sign: Baerentzen and Aanaes 2005, "Signed distance computation using the angle weighted pseudonormal". */
#include "geometry/body.h"

#include <string.h>
#if defined(__AVX512F__) || defined(__AVX2__)
#include <immintrin.h>
#endif

#define HG_BODY_FAR  1e36 /* squared distance beyond which nothing is found: finite also in float */
#define HG_BODY_JUMP 0.03 /* m: points that follow each other farther apart are of different strands */
#define HG_BODY_TIES 32   /* more than this many tied triangles take a second search */

struct hg_body_refit {
    const hg_body_tree *tree;
    hg_dtype dtype;
    bool ready;
    void *leaves, *nodes, *vertices, *face_normals, *vertex_normals;
    float *angles; /* [F,3] of the corners */
};

/* Bit l is set where distance2[l] <= bound. */
static inline uint32_t lanes_within_d(const double *distance2, double bound)
{
#if defined(__AVX512F__)
    __m512d b = _mm512_set1_pd(bound);
    return (uint32_t)_mm512_cmp_pd_mask(_mm512_load_pd(distance2), b, _CMP_LE_OQ) |
           (uint32_t)_mm512_cmp_pd_mask(_mm512_load_pd(distance2 + 8), b, _CMP_LE_OQ) << 8;
#else
    uint32_t hit = 0;
    for (int l = 0; l < HG_BODY_LANES; l++) hit |= (uint32_t)(distance2[l] <= bound) << l;
    return hit;
#endif
}

static inline uint32_t lanes_within_f(const float *distance2, float bound)
{
#if defined(__AVX512F__)
    return (uint32_t)_mm512_cmp_ps_mask(_mm512_load_ps(distance2), _mm512_set1_ps(bound), _CMP_LE_OQ);
#elif defined(__AVX2__)
    __m256 b = _mm256_set1_ps(bound);
    return (uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(_mm256_load_ps(distance2), b, _CMP_LE_OQ)) |
           (uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(_mm256_load_ps(distance2 + 8), b, _CMP_LE_OQ)) << 8;
#else
    uint32_t hit = 0;
    for (int l = 0; l < HG_BODY_LANES; l++) hit |= (uint32_t)(distance2[l] <= bound) << l;
    return hit;
#endif
}

static inline hg_vec3d widen_d(hg_vec3d a) { return a; }
static inline hg_vec3d narrow_d(hg_vec3d a) { return a; }
static inline hg_vec3d widen_f(hg_vec3f a) { return hg_vec3d_from_f(a); }
static inline hg_vec3f narrow_f(hg_vec3d a) { return hg_vec3f_from_d(a); }

/* per precision: least number that is divided by, sliver (4 area^2 against edges^4), slack of a squared bound, and how
 * near [m] a direction is rounding */
#define least_d  1e-290
#define sliver_d 1e-20
#define slack_d  (1.0 + 1e-12)
#define near_d   1e-9
#define least_f  1e-35
#define sliver_f 1e-6
#define slack_f  (1.0 + 1e-5)
#define near_f   1e-6

#define HG_B(name)    HG_JOIN(name, _, HG_SUFFIX)
#define hg_real       double
#define HG_SUFFIX     d
#define HG_VEC3       hg_vec3d
#define HG_MATH(name) name
#include "geometry/body_functions.h"
#undef hg_real
#undef HG_SUFFIX
#undef HG_VEC3
#undef HG_MATH

#define hg_real       float
#define HG_SUFFIX     f
#define HG_VEC3       hg_vec3f
#define HG_MATH(name) name##f
#include "geometry/body_functions.h"

hg_status hg_body_refit_create(hg_body_refit **out, const hg_body_tree *tree, hg_dtype dtype)
{
    *out = NULL;
    if (!tree) return hg_fail(HG_INVALID, "body: a refit needs a tree");
    if (dtype != HG_F32 && dtype != HG_F64)
        return hg_fail(HG_INVALID, "body: a refit is f32 or f64, not %s", hg_dtype_name(dtype));
    hg_body_refit *refit = hg_alloc(1, sizeof *refit);
    if (!refit) return HG_MEMORY;
    refit->tree = tree;
    refit->dtype = dtype;
    size_t real = hg_dtype_size(dtype);
    refit->leaves = hg_alloc((size_t)tree->n_leaves, dtype == HG_F32 ? sizeof(leaf_f) : sizeof(leaf_d));
    refit->nodes = hg_alloc((size_t)tree->level_start[tree->levels], dtype == HG_F32 ? sizeof(node_f) : sizeof(node_d));
    refit->vertices = hg_alloc(3 * (size_t)tree->n_vertices, real);
    refit->face_normals = hg_alloc(3 * (size_t)tree->n_faces, real);
    refit->vertex_normals = hg_alloc(3 * (size_t)tree->n_vertices, real);
    refit->angles = hg_alloc(3 * (size_t)tree->n_faces, sizeof(float));
    if (!refit->leaves || !refit->nodes || !refit->vertices || !refit->face_normals || !refit->vertex_normals ||
        !refit->angles) {
        hg_body_refit_destroy(refit);
        return HG_MEMORY;
    }
    *out = refit;
    return HG_OK;
}

void hg_body_refit_destroy(hg_body_refit *refit)
{
    if (!refit) return;
    hg_free(refit->leaves);
    hg_free(refit->nodes);
    hg_free(refit->vertices);
    hg_free(refit->face_normals);
    hg_free(refit->vertex_normals);
    hg_free(refit->angles);
    hg_free(refit);
}

hg_status hg_body_refit_update(hg_ctx *ctx, hg_body_refit *refit, const void *vertices)
{
    hg_profile_begin(ctx, "body", "refit");
    HG_TRY(refit->dtype == HG_F32 ? update_f(ctx, refit, vertices) : update_d(ctx, refit, vertices));
    hg_profile_end(ctx, refit->dtype == HG_F32 ? bytes_f(refit->tree) : bytes_d(refit->tree));
    return HG_OK;
}

hg_status hg_body_closest(hg_ctx *ctx, const hg_body_refit *refit, hg_contact_mode mode, double reach, int64_t n,
                          const void *points, int32_t *triangle, void *contact_point, void *contact_normal)
{
    if (!refit->ready) return hg_fail(HG_INVALID, "body: asked for the closest triangle before hg_body_refit_update");
    if (!(reach >= 0.0)) return hg_fail(HG_INVALID, "body: a reach of %g m; it has to be 0 or more", reach);
    hg_profile_begin(ctx, "body", "closest triangles");
    HG_TRY(refit->dtype == HG_F32 ? run_f(ctx, refit, mode, reach, n, points, triangle, contact_point, contact_normal)
                                  : run_d(ctx, refit, mode, reach, n, points, triangle, contact_point, contact_normal));
    hg_profile_end(ctx, n * (9 * (int64_t)hg_dtype_size(refit->dtype) + 8));
    return HG_OK;
}
