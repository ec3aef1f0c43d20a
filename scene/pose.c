/* Posing: shaped rest vertices, joints that follow the shape, linear blend skinning (Magnenat-Thalmann et al. 1988), and
 * the rigid frames of strand roots. */
#include "scene/internal.h"
#include "scene/pose.kernel.h"

#include <string.h>

enum { BLOCK_VERTICES = 1024, BLOCK_STRANDS = 64 };

struct hg_poser {
    const hg_body *body;
    int64_t vertices, collider_faces;
    int32_t *vertex;         /* [vertices] number in the body, ascending */
    int32_t *kept;           /* [N] number among the vertices kept, -1: left out */
    int32_t *collider;       /* [faces,3] in kept numbering */
    float *points;           /* [vertices,3] neutral rest */
    float *shapes;           /* [vertices,HG_SHAPES,3] */
    float *rest;             /* [vertices,3] shaped */
    int32_t *influence;      /* [vertices,HG_INFLUENCES], the used ones first */
    float *weight;           /* [vertices,HG_INFLUENCES] */
    uint8_t *influences;     /* [vertices] how many are used */
    hg_vec3d *joint;         /* [J] shaped rest */
    hg_quatd *rotation;      /* [J] global */
    hg_vec3d *position;      /* [J] */
    float *transform;        /* [J,12] rows of (R | position - R joint) */
    double shape[HG_SHAPES]; /* of rest and joint */
    /* for hg_pose_bodies, made at its first call: floats [3 + 3 HG_SHAPES + HG_INFLUENCES,N], influences [HG_INFLUENCES,N] */
    hg_tensor *floats, *indices;
};

void hg_poser_destroy(hg_poser *poser)
{
    if (!poser) return;
    hg_free(poser->vertex);
    hg_free(poser->kept);
    hg_free(poser->collider);
    hg_free(poser->points);
    hg_free(poser->shapes);
    hg_free(poser->rest);
    hg_free(poser->influence);
    hg_free(poser->weight);
    hg_free(poser->influences);
    hg_free(poser->joint);
    hg_free(poser->rotation);
    hg_free(poser->position);
    hg_free(poser->transform);
    hg_tensor_destroy(poser->floats);
    hg_tensor_destroy(poser->indices);
    hg_free(poser);
}

static void keep_faces(hg_poser *poser, const int32_t *faces, int64_t n)
{
    for (int64_t f = 0; f < n; f++)
        for (int c = 0; c < 3; c++) poser->kept[poser->body->triangles[3 * (int64_t)faces[f] + c]] = 0;
}

static void gather_vertex(hg_poser *poser, int64_t v)
{
    const hg_body *body = poser->body;
    int64_t from = poser->vertex[v];
    memcpy(poser->points + 3 * v, body->points + 3 * from, 3 * sizeof(float));
    for (int k = 0; k < HG_SHAPES; k++)
        memcpy(poser->shapes + 3 * (HG_SHAPES * v + k), body->shapes + 3 * (k * body->vertices + from),
               3 * sizeof(float));
    int used = 0;
    for (int k = 0; k < HG_INFLUENCES; k++) {
        float weight = body->weight[HG_INFLUENCES * from + k];
        if (weight == 0) continue;
        poser->influence[HG_INFLUENCES * v + used] = body->influence[HG_INFLUENCES * from + k];
        poser->weight[HG_INFLUENCES * v + used++] = weight;
    }
    poser->influences[v] = (uint8_t)used;
}

hg_status hg_poser_create(hg_poser **poser, const hg_body *body, bool collider_only)
{
    *poser = NULL;
    hg_poser *p = hg_alloc(1, sizeof *p);
    if (!p) return HG_MEMORY;
    p->body = body;
    p->kept = hg_alloc((size_t)body->vertices, sizeof *p->kept);
    if (!p->kept) goto memory;
    if (collider_only) {
        memset(p->kept, -1, (size_t)body->vertices * sizeof *p->kept);
        keep_faces(p, body->collider, body->collider_faces);
        keep_faces(p, body->scalp, body->scalp_faces);
    }
    for (int64_t v = 0; v < body->vertices; v++)
        if (p->kept[v] == 0) p->kept[v] = (int32_t)p->vertices++;

    size_t n = (size_t)p->vertices, j = (size_t)body->joints;
    p->collider_faces = body->collider_faces;
    p->vertex = hg_alloc(n, sizeof *p->vertex);
    p->collider = hg_alloc((size_t)p->collider_faces, 3 * sizeof *p->collider);
    p->points = hg_alloc(n, 3 * sizeof *p->points);
    p->shapes = hg_alloc(n, HG_SHAPES * 3 * sizeof *p->shapes);
    p->rest = hg_alloc(n, 3 * sizeof *p->rest);
    p->influence = hg_alloc(n, HG_INFLUENCES * sizeof *p->influence);
    p->weight = hg_alloc(n, HG_INFLUENCES * sizeof *p->weight);
    p->influences = hg_alloc(n, sizeof *p->influences);
    p->joint = hg_alloc(j, sizeof *p->joint);
    p->rotation = hg_alloc(j, sizeof *p->rotation);
    p->position = hg_alloc(j, sizeof *p->position);
    p->transform = hg_alloc(j, 12 * sizeof *p->transform);
    if (!p->vertex || !p->collider || !p->points || !p->shapes || !p->rest || !p->influence || !p->weight ||
        !p->influences || !p->joint || !p->rotation || !p->position || !p->transform)
        goto memory;

    for (int64_t v = 0; v < body->vertices; v++)
        if (p->kept[v] >= 0) p->vertex[p->kept[v]] = (int32_t)v;
    for (int64_t v = 0; v < p->vertices; v++) gather_vertex(p, v);
    for (int64_t f = 0; f < p->collider_faces; f++)
        for (int c = 0; c < 3; c++)
            p->collider[3 * f + c] = p->kept[body->triangles[3 * (int64_t)body->collider[f] + c]];
    p->shape[0] = NAN; /* nothing is shaped yet: equal to no shape */
    *poser = p;
    return HG_OK;
memory:
    hg_poser_destroy(p);
    return HG_MEMORY;
}

int64_t hg_poser_vertices(const hg_poser *poser) { return poser->vertices; }
const int32_t *hg_poser_vertex(const hg_poser *poser) { return poser->vertex; }

const int32_t *hg_poser_collider(const hg_poser *poser, int64_t *faces)
{
    if (faces) *faces = poser->collider_faces;
    return poser->collider;
}

/* ---- the body ----------------------------------------------------------------------------------------------- */

typedef struct {
    const hg_poser *poser;
    float shape[HG_SHAPES];
    float *out;
} pose_args;

static void shape_vertices(const void *args, int64_t first, int64_t last)
{
    const pose_args *a = args;
    for (int64_t v = first; v < last; v++) {
        const float *p = a->poser->points + 3 * v, *d = a->poser->shapes + 3 * HG_SHAPES * v;
        float x = p[0], y = p[1], z = p[2];
        for (int k = 0; k < HG_SHAPES; k++, d += 3)
            x += a->shape[k] * d[0], y += a->shape[k] * d[1], z += a->shape[k] * d[2];
        a->out[3 * v] = x, a->out[3 * v + 1] = y, a->out[3 * v + 2] = z;
    }
}

static void skin_vertices(const void *args, int64_t first, int64_t last)
{
    const pose_args *a = args;
    const hg_poser *p = a->poser;
    for (int64_t v = first; v < last; v++) {
        float m[12] = { 0 };
        for (int k = 0; k < p->influences[v]; k++) {
            const float *t = p->transform + 12 * p->influence[HG_INFLUENCES * v + k];
            float w = p->weight[HG_INFLUENCES * v + k];
            for (int i = 0; i < 12; i++) m[i] += w * t[i];
        }
        const float *r = p->rest + 3 * v;
        for (int i = 0; i < 3; i++)
            a->out[3 * v + i] = m[4 * i] * r[0] + m[4 * i + 1] * r[1] + m[4 * i + 2] * r[2] + m[4 * i + 3];
    }
}

static const hg_kernel shape_kernel = {
    .name = "shape vertices", .args_size = sizeof(pose_args), .cpu = shape_vertices, .block = BLOCK_VERTICES
};
static const hg_kernel skin_kernel = {
    .name = "skin vertices", .args_size = sizeof(pose_args), .cpu = skin_vertices, .block = BLOCK_VERTICES
};

/* The joints of a shape, and the shape as floats. */
static hg_status shape_joints(hg_poser *poser, const double *shape, float out[HG_SHAPES])
{
    const hg_body *body = poser->body;
    poser->shape[0] = NAN; /* rest is not of this shape */
    for (int k = 0; k < HG_SHAPES; k++) {
        if (!isfinite(shape[k]) || fabs(shape[k]) > 100)
            return hg_fail(HG_INVALID, "shape %d (%s) is %g: shapes are numbers of about -1 to 1", k,
                           body->shape_name[k], shape[k]);
        out[k] = (float)shape[k];
    }
    for (int64_t j = 0; j < body->joints; j++) {
        poser->joint[j] = scene_point(body->joint + 3 * j);
        for (int k = 0; k < HG_SHAPES; k++) {
            hg_vec3d way = scene_point(body->joint_shapes + 3 * (k * body->joints + j));
            poser->joint[j] = hg_vec3d_add_scaled(poser->joint[j], shape[k], way);
        }
    }
    return HG_OK;
}

static const double neutral[HG_SHAPES];

static hg_status pose_shape(hg_ctx *ctx, hg_poser *poser, const double *shape)
{
    if (!shape) shape = neutral;
    if (memcmp(poser->shape, shape, sizeof poser->shape) == 0) return HG_OK;
    pose_args args = { .poser = poser, .out = poser->rest };
    HG_TRY(shape_joints(poser, shape, args.shape));
    HG_TRY(hg_launch(ctx, &shape_kernel, poser->vertices, &args));
    memcpy(poser->shape, shape, sizeof poser->shape);
    return HG_OK;
}

/* Global rotations and positions of all joints, parents first, then what moves a rest point with each. */
static void pose_joints(hg_poser *poser, const float *rotation, const float *translation)
{
    for (int64_t j = 0; j < poser->body->joints; j++) {
        int64_t parent = poser->body->parent[j];
        hg_vec3d joint = poser->joint[j], at = joint;
        hg_quatd global = rotation ? hg_quatd_from_f(hg_quatf_load(rotation + 4 * j)) : hg_quatd_identity();
        global = hg_quatd_normalize(global);
        if (parent >= 0) {
            hg_quatd turn = poser->rotation[parent];
            global = hg_quatd_normalize(hg_quatd_mul(turn, global));
            at = hg_quatd_rotate(turn, hg_vec3d_sub(joint, poser->joint[parent]));
            at = hg_vec3d_add(poser->position[parent], at);
        } else if (translation) {
            at = hg_vec3d_add(joint, scene_point(translation));
        }
        poser->rotation[j] = global, poser->position[j] = at;

        double m[9];
        float *t = poser->transform + 12 * j;
        hg_quatd_to_matrix(global, m);
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++) t[4 * i + k] = (float)m[3 * i + k];
        hg_vec3d shift = hg_vec3d_sub(at, hg_quatd_rotate(global, joint));
        t[3] = (float)shift.x, t[7] = (float)shift.y, t[11] = (float)shift.z;
    }
}

/* What a clip has at a frame, clamped; NULL: at rest. */
static hg_status find_frame(const hg_poser *poser, const hg_motion *motion, int64_t frame, const float **rotation,
                            const float **translation)
{
    const int64_t joints = poser->body->joints;
    *rotation = *translation = NULL;
    if (!motion) return HG_OK;
    if (motion->joints != joints)
        return hg_fail(HG_INVALID, "the motion %s has %lld joints, the body %lld: import it for this body",
                       motion->name ? motion->name : "", (long long)motion->joints, (long long)joints);
    if (frame >= motion->frames) frame = motion->frames - 1;
    if (frame < 0) frame = 0;
    *rotation = motion->rotation + 4 * joints * frame, *translation = motion->translation + 3 * frame;
    return HG_OK;
}

hg_status hg_pose(hg_ctx *ctx, hg_poser *poser, const double *shape, const hg_motion *motion, int64_t frame,
                  float *vertices, float *joint_position, float *joint_rotation)
{
    const float *rotation, *translation;
    if (!(ctx = hg_ctx_on_host(ctx))) return HG_MEMORY;
    HG_TRY(find_frame(poser, motion, frame, &rotation, &translation));
    HG_TRY(pose_shape(ctx, poser, shape));
    pose_joints(poser, rotation, translation);
    pose_args args = { .poser = poser, .out = vertices };
    HG_TRY(hg_launch(ctx, &skin_kernel, poser->vertices, &args));
    for (int64_t j = 0; j < poser->body->joints; j++) {
        if (joint_position) scene_put(joint_position + 3 * j, poser->position[j]);
        if (joint_rotation) hg_quatf_store(joint_rotation + 4 * j, hg_quatf_from_d(poser->rotation[j]));
    }
    return HG_OK;
}

/* ---- many bodies on a device ---------------------------------------------------------------------------------- */

hg_status hg_pose_joints(hg_poser *poser, const double *shape, const hg_motion *motion, int64_t frame,
                         float shapes[HG_SHAPES], float *transform)
{
    const float *rotation, *translation;
    HG_TRY(find_frame(poser, motion, frame, &rotation, &translation));
    HG_TRY(shape_joints(poser, shape ? shape : neutral, shapes));
    pose_joints(poser, rotation, translation);
    memcpy(transform, poser->transform, (size_t)poser->body->joints * 12 * sizeof *transform);
    return HG_OK;
}

static hg_status upload_poser(hg_ctx *ctx, hg_poser *poser)
{
    enum { ROWS = 3 + 3 * HG_SHAPES + HG_INFLUENCES };
    const int64_t n = poser->vertices;
    float *floats = hg_alloc((size_t)n + 1, ROWS * sizeof *floats);
    int32_t *indices = hg_alloc((size_t)n + 1, HG_INFLUENCES * sizeof *indices);
    for (int64_t v = 0; floats && indices && v < n; v++) {
        for (int c = 0; c < 3; c++) floats[c * n + v] = poser->points[3 * v + c];
        for (int k = 0; k < 3 * HG_SHAPES; k++) floats[(3 + k) * n + v] = poser->shapes[3 * HG_SHAPES * v + k];
        for (int k = 0; k < HG_INFLUENCES; k++) {
            floats[(3 + 3 * HG_SHAPES + k) * n + v] =
                k < poser->influences[v] ? poser->weight[HG_INFLUENCES * v + k] : 0;
            indices[k * n + v] = poser->influence[HG_INFLUENCES * v + k];
        }
    }
    hg_status status = floats && indices ? HG_OK : HG_MEMORY;
    if (status == HG_OK) {
        poser->floats = hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ ROWS, n });
        poser->indices = hg_tensor_create(ctx, HG_I32, 2, (int64_t[]){ HG_INFLUENCES, n });
        status = poser->floats && poser->indices ? HG_OK : hg_ctx_status(ctx);
    }
    if (status == HG_OK) status = hg_tensor_write(poser->floats, floats);
    if (status == HG_OK) status = hg_tensor_write(poser->indices, indices);
    hg_free(floats);
    hg_free(indices);
    return status;
}

hg_tensor *hg_pose_bodies(hg_ctx *ctx, hg_poser *poser, const hg_tensor *shape, const hg_tensor *transform)
{
    if (!shape || !transform) return NULL;
    if (!poser->indices && upload_poser(ctx, poser) != HG_OK) return NULL;
    const int64_t n = poser->vertices, poses = transform->shape[0];
    if (transform->shape[1] != poser->body->joints || shape->shape[0] != poses || shape->shape[1] != HG_SHAPES) {
        char a[96], b[96];
        hg_ctx_fail(ctx, HG_INVALID, "bodies: shapes %s and transforms %s; [P,%d] and [P,%lld,12] are expected",
                    hg_shape_text(shape, a), hg_shape_text(transform, b), HG_SHAPES, (long long)poser->body->joints);
        return NULL;
    }
    hg_tensor *out = hg_tensor_make(ctx, HG_F32, 3, (int64_t[]){ poses, n, 3 });
    if (!out) return NULL;
    const float *floats = poser->floats->data;
    const pose_bodies_args args = { .vertices = n,
                                    .joints = poser->body->joints,
                                    .points = floats,
                                    .shapes = floats + 3 * n,
                                    .influence = poser->indices->data,
                                    .weight = floats + (3 + 3 * HG_SHAPES) * n,
                                    .shape = shape->data,
                                    .transform = transform->data,
                                    .out = out->data };
    return hg_launch(ctx, &pose_bodies_kernel, poses * n, &args) == HG_OK ? out : NULL;
}

/* ---- roots -------------------------------------------------------------------------------------------------- */

typedef struct {
    const hg_poser *poser;
    const hg_groom *groom;
    const int32_t *strand;
    const float *vertices;
    float *rotation, *position;
} root_args;

static void pose_root(const void *args, int64_t first, int64_t last)
{
    const root_args *a = args;
    const hg_poser *poser = a->poser;
    for (int64_t i = first; i < last; i++) {
        int64_t s = a->strand ? a->strand[i] : i;
        const int32_t *triangle = poser->body->triangles + 3 * (int64_t)a->groom->root_face[s];
        hg_vec3d rest[3], posed[3];
        for (int c = 0; c < 3; c++) {
            rest[c] = scene_point(poser->body->points + 3 * (int64_t)triangle[c]);
            posed[c] = scene_point(a->vertices + 3 * (int64_t)poser->kept[triangle[c]]);
        }
        pose_root_on(rest, posed, a->groom->root_bary + 3 * s, a->rotation + 4 * i, a->position + 3 * i);
    }
}

static const hg_kernel root_kernel = {
    .name = "pose roots", .args_size = sizeof(root_args), .cpu = pose_root, .block = BLOCK_STRANDS
};

static hg_status check_roots(const hg_poser *poser, const hg_groom *groom, const int32_t *strand, int64_t n)
{
    for (int64_t i = 0; i < n; i++) {
        int64_t s = strand ? strand[i] : i;
        if (s < 0 || s >= groom->strands)
            return hg_fail(HG_INVALID, "strand %lld of a groom of %lld", (long long)s, (long long)groom->strands);
        int64_t face = groom->root_face[s];
        if (face < 0 || face >= poser->body->faces)
            return hg_fail(HG_INVALID,
                           "strand %lld has its root on face %lld of a body of %lld faces: bind the groom to this body",
                           (long long)s, (long long)face, (long long)poser->body->faces);
        for (int c = 0; c < 3; c++)
            if (poser->kept[poser->body->triangles[3 * face + c]] < 0)
                return hg_fail(HG_INVALID, "strand %lld has its root on face %lld, which is not of the scalp",
                               (long long)s, (long long)face);
    }
    return HG_OK;
}

hg_status hg_pose_roots(hg_ctx *ctx, const hg_poser *poser, const hg_groom *groom, const int32_t *strand, int64_t n,
                        const float *vertices, float *rotation, float *position)
{
    if (!strand) n = groom->strands;
    HG_TRY(check_roots(poser, groom, strand, n));
    if (!(ctx = hg_ctx_on_host(ctx))) return HG_MEMORY;
    root_args args = { poser, groom, strand, vertices, rotation, position };
    return hg_launch(ctx, &root_kernel, n, &args);
}

/* ---- roots on a device ---------------------------------------------------------------------------------------- */

struct hg_roots {
    int64_t strands, vertices;       /* of each groom; of the body */
    hg_tensor *corner, *rest, *bary; /* [G,S,3], [G,S,3,3], [G,S,3] */
};

void hg_roots_destroy(hg_roots *roots)
{
    if (!roots) return;
    hg_tensor_destroy(roots->corner);
    hg_tensor_destroy(roots->rest);
    hg_tensor_destroy(roots->bary);
    hg_free(roots);
}

static void gather_root(const hg_poser *poser, const hg_groom *groom, int64_t s, int32_t *corner, float *rest,
                        float *bary)
{
    const int32_t *triangle = poser->body->triangles + 3 * (int64_t)groom->root_face[s];
    for (int c = 0; c < 3; c++) {
        corner[c] = poser->kept[triangle[c]];
        memcpy(rest + 3 * c, poser->body->points + 3 * (int64_t)triangle[c], 3 * sizeof *rest);
    }
    memcpy(bary, groom->root_bary + 3 * s, 3 * sizeof *bary);
}

hg_status hg_roots_create(hg_roots **out, hg_ctx *ctx, const hg_poser *poser, int grooms, const hg_groom *const *groom,
                          int64_t n, const int32_t *strand)
{
    *out = NULL;
    for (int g = 0; g < grooms; g++) HG_TRY(check_roots(poser, groom[g], strand + g * n, n));
    const int64_t all = grooms * n;
    hg_roots *roots = hg_alloc(1, sizeof *roots);
    int32_t *corner = hg_alloc((size_t)all + 1, 3 * sizeof *corner);
    float *rest = hg_alloc((size_t)all + 1, 9 * sizeof *rest), *bary = hg_alloc((size_t)all + 1, 3 * sizeof *bary);
    hg_status status = roots && corner && rest && bary ? HG_OK : HG_MEMORY;
    if (status == HG_OK) {
        roots->strands = n;
        roots->vertices = poser->vertices;
        for (int64_t i = 0; i < all; i++)
            gather_root(poser, groom[i / n], strand[i], corner + 3 * i, rest + 9 * i, bary + 3 * i);
        roots->corner = hg_tensor_create(ctx, HG_I32, 3, (int64_t[]){ grooms, n, 3 });
        roots->rest = hg_tensor_create(ctx, HG_F32, 4, (int64_t[]){ grooms, n, 3, 3 });
        roots->bary = hg_tensor_create(ctx, HG_F32, 3, (int64_t[]){ grooms, n, 3 });
        status = roots->corner && roots->rest && roots->bary ? HG_OK : hg_ctx_status(ctx);
    }
    if (status == HG_OK) status = hg_tensor_write(roots->corner, corner);
    if (status == HG_OK) status = hg_tensor_write(roots->rest, rest);
    if (status == HG_OK) status = hg_tensor_write(roots->bary, bary);
    hg_free(corner);
    hg_free(rest);
    hg_free(bary);
    if (status == HG_OK)
        *out = roots;
    else
        hg_roots_destroy(roots);
    return status;
}

hg_status hg_roots_pose(hg_ctx *ctx, const hg_roots *roots, const hg_tensor *groom, const hg_tensor *vertices,
                        hg_tensor **rotation, hg_tensor **position)
{
    if (!vertices) return hg_ctx_status(ctx);
    const int64_t poses = vertices->shape[0], n = roots->strands;
    char text[96];
    if (vertices->shape[1] != roots->vertices || (groom && poses % hg_tensor_count(groom) != 0))
        return hg_ctx_fail(ctx, HG_INVALID,
                           "roots on %s: bodies of %lld vertices are expected, and as many grooms or a part of them",
                           hg_shape_text(vertices, text), (long long)roots->vertices);
    *rotation = hg_tensor_make(ctx, HG_F32, 3, (int64_t[]){ poses, n, 4 });
    *position = hg_tensor_make(ctx, HG_F32, 3, (int64_t[]){ poses, n, 3 });
    if (!*rotation || !*position) return hg_ctx_status(ctx);
    const pose_roots_args args = { .strands = n,
                                   .vertices = roots->vertices,
                                   .corner = roots->corner->data,
                                   .rest = roots->rest->data,
                                   .bary = roots->bary->data,
                                   .grooms = groom ? hg_tensor_count(groom) : 1,
                                   .groom = groom ? groom->data : NULL,
                                   .posed = vertices->data,
                                   .rotation = (*rotation)->data,
                                   .position = (*position)->data };
    return hg_launch(ctx, &pose_roots_kernel, poses * n, &args);
}

/* ---- strands ------------------------------------------------------------------------------------------------ */

typedef struct {
    int64_t vertices;
    const float *rest, *rotation, *position;
    float *x;
} strand_args;

static void pose_strand(const void *args, int64_t first, int64_t last)
{
    const strand_args *a = args;
    for (int64_t s = first; s < last; s++) {
        const float *rest = a->rest + 3 * a->vertices * s, *p = a->position + 3 * s;
        float *x = a->x + 3 * a->vertices * s, m[9], root[3] = { rest[0], rest[1], rest[2] };
        hg_quatf_to_matrix(hg_quatf_load(a->rotation + 4 * s), m);
        for (int64_t v = 0; v < a->vertices; v++) {
            float d0 = rest[3 * v] - root[0], d1 = rest[3 * v + 1] - root[1], d2 = rest[3 * v + 2] - root[2];
            x[3 * v] = p[0] + (m[0] * d0 + m[1] * d1 + m[2] * d2);
            x[3 * v + 1] = p[1] + (m[3] * d0 + m[4] * d1 + m[5] * d2);
            x[3 * v + 2] = p[2] + (m[6] * d0 + m[7] * d1 + m[8] * d2);
        }
    }
}

static const hg_kernel strand_kernel = {
    .name = "pose strands", .args_size = sizeof(strand_args), .cpu = pose_strand, .block = BLOCK_STRANDS
};

void hg_pose_strands(hg_ctx *ctx, int64_t strands, int64_t vertices, const float *rest, const float *rotation,
                     const float *position, float *x)
{
    strand_args args = { vertices, rest, rotation, position, x };
    if ((ctx = hg_ctx_on_host(ctx))) hg_launch(ctx, &strand_kernel, strands, &args);
}
