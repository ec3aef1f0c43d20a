/* Body tree: moving it to a frame, and the closest triangle of every point; its memory, on the host or on another device
 * (kernels in body.kernel.h).
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

/* Bit l is set where distance2[l] <= bound. */
static inline uint32_t lanes_within_f64(const double *distance2, double bound)
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

static inline uint32_t lanes_within_f32(const float *distance2, float bound)
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

#include "geometry/body.kernel.h"

struct hg_body_refit {
    const hg_body_tree *tree;
    hg_dtype dtype;
    int64_t most, frames; /* room; of the last update, 0: there was none, or it failed */
    hg_body_fit fit;      /* pointers into what follows: made at the first update, where the context computes */
    int64_t bytes;
    void *own;                    /* of the host */
    hg_tensor *memory, *topology; /* of another device */
};

hg_status hg_body_refit_create_frames(hg_body_refit **out, const hg_body_tree *tree, hg_dtype dtype, int64_t most)
{
    *out = NULL;
    if (!tree) return hg_fail(HG_INVALID, "body: a refit needs a tree");
    if (most < 1) return hg_fail(HG_INVALID, "body: a refit of %lld frames", (long long)most);
    if (dtype != HG_F32 && dtype != HG_F64)
        return hg_fail(HG_INVALID, "body: a refit is f32 or f64, not %s", hg_dtype_name(dtype));
    hg_body_refit *refit = hg_alloc(1, sizeof *refit);
    if (!refit) return HG_MEMORY;
    *refit = (hg_body_refit){ .tree = tree, .dtype = dtype, .most = most };
    *out = refit;
    return HG_OK;
}

hg_status hg_body_refit_create(hg_body_refit **out, const hg_body_tree *tree, hg_dtype dtype)
{
    return hg_body_refit_create_frames(out, tree, dtype, 1);
}

void hg_body_refit_destroy(hg_body_refit *refit)
{
    if (!refit) return;
    hg_free(refit->own);
    hg_tensor_destroy(refit->memory);
    hg_tensor_destroy(refit->topology);
    hg_free(refit);
}

/* ---- memory ---- */

/* A part of a block of memory; base NULL: only its size is counted. */
static void *take(unsigned char *base, size_t *used, int64_t bytes)
{
    void *at = base ? base + *used : NULL;
    *used += ((size_t)bytes + 63) & ~(size_t)63;
    return at;
}

static size_t lay_out_frames(hg_body_refit *refit, unsigned char *base)
{
    const hg_body_tree *tree = refit->tree;
    const int64_t real = (int64_t)hg_dtype_size(refit->dtype), frames = refit->most;
    const bool wide = refit->dtype == HG_F64;
    hg_body_fit *fit = &refit->fit;
    size_t used = 0;
    fit->leaves = take(base, &used, frames * tree->n_leaves * (int64_t)(wide ? sizeof(leaf_f64) : sizeof(leaf_f32)));
    fit->nodes = take(base, &used,
                      frames * tree->level_start[tree->levels] * (int64_t)(wide ? sizeof(node_f64) : sizeof(node_f32)));
    fit->vertices = take(base, &used, frames * 3 * tree->n_vertices * real);
    fit->face_normals = take(base, &used, frames * 3 * tree->n_faces * real);
    fit->vertex_normals = take(base, &used, frames * 3 * tree->n_vertices * real);
    fit->angles = take(base, &used, frames * 3 * tree->n_faces * (int64_t)sizeof(float));
    return used;
}

enum { TOPOLOGY = 7 };
static hg_status upload_topology(hg_ctx *ctx, hg_body_refit *refit)
{
    const hg_body_tree *tree = refit->tree;
    hg_body_fit *fit = &refit->fit;
    const int64_t corners = 3 * tree->n_faces;
    const struct {
        const int32_t **to, *from;
        int64_t n;
    } parts[TOPOLOGY] = { { &fit->faces, tree->faces, corners },
                          { &fit->order, tree->order, tree->n_faces },
                          { &fit->corner_start, tree->corner_start, tree->n_vertices + 1 },
                          { &fit->corners, tree->corners, corners },
                          { &fit->face_edges, tree->face_edges, corners },
                          { &fit->edge_start, tree->edge_start, tree->n_edges + 1 },
                          { &fit->edge_faces, tree->edge_faces, corners } };
    int64_t n = 0;
    for (int i = 0; i < TOPOLOGY; i++) n += parts[i].n;
    int32_t *all = hg_alloc((size_t)n, sizeof *all);
    if (!all) return HG_MEMORY;
    refit->topology = hg_tensor_create(ctx, HG_I32, 1, &n);
    hg_status status = refit->topology ? HG_OK : hg_ctx_status(ctx);
    int64_t at = 0;
    for (int i = 0; status == HG_OK && i < TOPOLOGY; at += parts[i++].n) {
        memcpy(all + at, parts[i].from, (size_t)parts[i].n * sizeof *all);
        *parts[i].to = (const int32_t *)refit->topology->data + at;
    }
    if (status == HG_OK) status = hg_tensor_write(refit->topology, all);
    hg_free(all);
    return status;
}

static hg_status make_memory(hg_ctx *ctx, hg_body_refit *refit)
{
    const hg_body_tree *tree = refit->tree;
    refit->fit = (hg_body_fit){ .faces = tree->faces,
                                .order = tree->order,
                                .corner_start = tree->corner_start,
                                .corners = tree->corners,
                                .face_edges = tree->face_edges,
                                .edge_start = tree->edge_start,
                                .edge_faces = tree->edge_faces,
                                .n_vertices = tree->n_vertices,
                                .n_faces = tree->n_faces,
                                .n_leaves = tree->n_leaves,
                                .n_nodes = tree->level_start[tree->levels],
                                .levels = tree->levels };
    for (int i = 0; i <= tree->levels; i++) refit->fit.level_start[i] = (int32_t)tree->level_start[i];
    const size_t bytes = lay_out_frames(refit, NULL);
    refit->bytes = (int64_t)bytes;
    if (hg_ctx_host(ctx)) {
        refit->own = hg_alloc(bytes + 63, 1);
        if (!refit->own) return HG_MEMORY;
        lay_out_frames(refit, (unsigned char *)(((uintptr_t)refit->own + 63) & ~(uintptr_t)63));
        return HG_OK;
    }
    refit->memory = hg_tensor_create(ctx, HG_I32, 1, (int64_t[]){ (int64_t)(bytes / sizeof(int32_t)) });
    if (!refit->memory) return hg_ctx_status(ctx);
    lay_out_frames(refit, refit->memory->data);
    return upload_topology(ctx, refit);
}

/* ---- frames and queries ---- */

/* A GPU takes all frames in one launch, the processor one after the other. */
static hg_body_fit frame_of(const hg_body_refit *refit, int64_t frame)
{
    const int64_t real = (int64_t)hg_dtype_size(refit->dtype);
    hg_body_fit fit = refit->fit;
    fit.leaves = (char *)fit.leaves +
                 frame * fit.n_leaves * (int64_t)(refit->dtype == HG_F64 ? sizeof(leaf_f64) : sizeof(leaf_f32));
    fit.nodes = (char *)fit.nodes +
                frame * fit.n_nodes * (int64_t)(refit->dtype == HG_F64 ? sizeof(node_f64) : sizeof(node_f32));
    fit.vertices = (char *)fit.vertices + frame * 3 * fit.n_vertices * real;
    fit.face_normals = (char *)fit.face_normals + frame * 3 * fit.n_faces * real;
    fit.vertex_normals = (char *)fit.vertex_normals + frame * 3 * fit.n_vertices * real;
    fit.angles += frame * 3 * fit.n_faces;
    return fit;
}

static bool is_finite(const hg_body_refit *refit, const hg_body_fit *fit)
{
    if (refit->dtype == HG_F64) {
        const view_f64 body = view_of_f64(fit, 0);
        return is_finite_f64(&body);
    }
    const view_f32 body = view_of_f32(fit, 0);
    return is_finite_f32(&body);
}

static hg_status update(hg_ctx *ctx, const hg_body_refit *refit, int64_t frames, const void *vertices)
{
    const bool wide = refit->dtype == HG_F64, host = hg_ctx_host(ctx);
    const int64_t at_once = host ? 1 : frames, real = (int64_t)hg_dtype_size(refit->dtype);
    for (int64_t b = 0; b < frames; b += at_once) {
        hg_body_refit_args args = { .body = frame_of(refit, b),
                                    .from = (const char *)vertices + b * 3 * refit->fit.n_vertices * real };
        HG_TRY(hg_launch(ctx, body_faces_kernels[wide], at_once * args.body.n_faces, &args));
        HG_TRY(hg_launch(ctx, body_vertices_kernels[wide], at_once * args.body.n_vertices, &args));
        HG_TRY(hg_launch(ctx, body_leaves_kernels[wide], at_once * args.body.n_leaves, &args));
        HG_TRY(hg_launch(ctx, body_nodes_kernels[wide], at_once, &args));
        if (host && !is_finite(refit, &args.body))
            return hg_fail(HG_NUMERIC, "body: a vertex of this frame is not finite; check the pose and the shape");
    }
    return HG_OK;
}

hg_status hg_body_refit_update_frames(hg_ctx *ctx, hg_body_refit *refit, int64_t frames, const void *vertices)
{
    if (frames < 1 || frames > refit->most)
        return hg_fail(HG_INVALID, "body: %lld frames for a refit that has room for %lld", (long long)frames,
                       (long long)refit->most);
    hg_profile_begin(ctx, "body", "refit");
    refit->frames = 0;
    if (!refit->fit.n_faces) HG_TRY(make_memory(ctx, refit));
    HG_TRY(update(ctx, refit, frames, vertices));
    refit->frames = frames;
    hg_profile_end(ctx, refit->bytes / refit->most * frames);
    return HG_OK;
}

hg_status hg_body_refit_update(hg_ctx *ctx, hg_body_refit *refit, const void *vertices)
{
    return hg_body_refit_update_frames(ctx, refit, 1, vertices);
}

hg_status hg_body_closest(hg_ctx *ctx, const hg_body_refit *refit, hg_contact_mode mode, double reach, int64_t n,
                          const void *points, int32_t *triangle, void *contact_point, void *contact_normal)
{
    if (!refit->frames) return hg_fail(HG_INVALID, "body: asked for the closest triangle before hg_body_refit_update");
    if (!(reach >= 0.0)) return hg_fail(HG_INVALID, "body: a reach of %g m; it has to be 0 or more", reach);
    hg_profile_begin(ctx, "body", "closest triangles");
    const int64_t at_once = hg_ctx_host(ctx) ? 1 : refit->frames, row = n * 3 * (int64_t)hg_dtype_size(refit->dtype);
    for (int64_t b = 0; b < refit->frames; b += at_once) {
        const hg_body_query query = { .body = frame_of(refit, b),
                                      .points_of_frame = n,
                                      .reach = reach,
                                      .mode = (int)mode,
                                      .points = (const char *)points + b * row,
                                      .triangle = triangle + b * n,
                                      .contact_point = (char *)contact_point + b * row,
                                      .contact_normal = (char *)contact_normal + b * row };
        HG_TRY(hg_launch(ctx, body_closest_kernels[refit->dtype == HG_F64], at_once * n, &query));
    }
    hg_profile_end(ctx, refit->frames * n * (9 * (int64_t)hg_dtype_size(refit->dtype) + 8));
    return HG_OK;
}
