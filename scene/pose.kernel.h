/* Kernels of posing: bodies from shapes and joint transforms, and the rigid frames of strand roots on them, for many poses at
 * once. Arrays that belong to the vertices of a body are [..,N], so that threads next to each other read what lies next to each
 * other. hg_pose does the same for one pose on the host, where the shaped rest is kept from frame to frame. */
#include "tensor/kernel.h"
#include "geometry/vector.h"

#define HG_POSE_SHAPES     10
#define HG_POSE_INFLUENCES 8

typedef struct {
    int64_t vertices, joints;
    const float *points;      /* [3,N] neutral rest */
    const float *shapes;      /* [HG_SHAPES,3,N] */
    const int32_t *influence; /* [HG_INFLUENCES,N] */
    const float *weight;      /* [HG_INFLUENCES,N] */
    const float *shape;       /* [P,HG_SHAPES] */
    const float *transform;   /* [P,J,12] rows of (R | what is added) */
    float *out;               /* [P,N,3] */
} pose_bodies_args;

HG_BODY void pose_bodies(const pose_bodies_args *p, int64_t first, int64_t last)
{
    const int64_t n = p->vertices;
    for (int64_t i = first; i < last; i++) {
        int64_t v, pose = hg_divide(i, n, &v);
        const float *beta = p->shape + HG_POSE_SHAPES * pose, *transform = p->transform + 12 * p->joints * pose;
        float rest[3], m[12];
        for (int c = 0; c < 3; c++) rest[c] = p->points[c * n + v];
        for (int k = 0; k < HG_POSE_SHAPES; k++)
            for (int c = 0; c < 3; c++) rest[c] += beta[k] * p->shapes[(3 * k + c) * n + v];
        for (int c = 0; c < 12; c++) m[c] = 0;
        for (int k = 0; k < HG_POSE_INFLUENCES; k++) {
            const float weight = p->weight[k * n + v];
            if (weight == 0) break; /* the used ones come first */
            const float *t = transform + 12 * p->influence[k * n + v];
            for (int c = 0; c < 12; c++) m[c] += weight * t[c];
        }
        for (int c = 0; c < 3; c++)
            p->out[3 * i + c] = m[4 * c] * rest[0] + m[4 * c + 1] * rest[1] + m[4 * c + 2] * rest[2] + m[4 * c + 3];
    }
}
HG_KERNEL(pose_bodies, pose_bodies_args, 1024)

/* Columns of a triangle's frame: edge 0 -> 1, normal x edge, normal. False when it has no area to speak of. */
HG_BODY bool triangle_frame(const hg_vec3d corner[3], hg_quatd *frame)
{
    hg_vec3d edge = hg_vec3d_sub(corner[1], corner[0]), other = hg_vec3d_sub(corner[2], corner[0]);
    hg_vec3d normal = hg_vec3d_cross(edge, other);
    if (!(hg_vec3d_norm(normal) > 1e-6 * (hg_vec3d_norm2(edge) + hg_vec3d_norm2(other)))) return false;
    normal = hg_vec3d_normalize(normal), edge = hg_vec3d_normalize(edge);
    *frame = hg_quatd_from_columns(edge, hg_vec3d_cross(normal, edge), normal);
    return true;
}

/* How a root's triangle has turned, and where the root is on it. */
HG_BODY void pose_root_on(const hg_vec3d rest[3], const hg_vec3d posed[3], const float *bary, float *rotation,
                          float *position)
{
    hg_vec3d at = hg_vec3d_make(0, 0, 0);
    hg_quatd from, to, turn = hg_quatd_identity();
    for (int c = 0; c < 3; c++) at = hg_vec3d_add_scaled(at, (double)bary[c], posed[c]);
    if (triangle_frame(rest, &from) && triangle_frame(posed, &to)) turn = hg_quatd_mul(to, hg_quatd_conj(from));
    if (turn.w < 0) turn = hg_quatd_neg(turn);
    hg_quatf_store(rotation, hg_quatf_from_d(turn));
    hg_vec3f_store(position, hg_vec3f_from_d(at));
}

typedef struct {
    int64_t strands, vertices; /* of a groom; of a body */
    const int32_t *corner;     /* [G,S,3] vertices of the root's triangle */
    const float *rest;         /* [G,S,3,3] where they are at neutral rest */
    const float *bary;         /* [G,S,3] */
    int64_t grooms;
    const int32_t *groom;       /* [grooms], of a pose that of its number modulo that; NULL: the first */
    const float *posed;         /* [P,N,3] */
    float *rotation, *position; /* [P,S,4], [P,S,3] */
} pose_roots_args;

HG_BODY void pose_roots(const pose_roots_args *p, int64_t first, int64_t last)
{
    for (int64_t i = first; i < last; i++) {
        int64_t s, pose = hg_divide(i, p->strands, &s);
        const int64_t root = s + (p->groom ? p->groom[pose % p->grooms] : 0) * p->strands;
        hg_vec3d rest[3], posed[3];
        for (int c = 0; c < 3; c++) {
            rest[c] = hg_vec3d_from_f(hg_vec3f_load(p->rest + 9 * root + 3 * c));
            posed[c] =
                hg_vec3d_from_f(hg_vec3f_load(p->posed + 3 * (pose * p->vertices + (int64_t)p->corner[3 * root + c])));
        }
        pose_root_on(rest, posed, p->bary + 3 * root, p->rotation + 4 * i, p->position + 3 * i);
    }
}
HG_KERNEL(pose_roots, pose_roots_args, 64)
