/* The procedural bust: a body for a machine with no data. Its surface comes from bust_surface.c; here are its rig with the
 * names of the CMU skeleton, smooth weights, ten shape directions, scalp and collider. */
#include "scene/bust.h"

#include <string.h>

#define CELL 0.0130 /* m, size of a triangle */

enum { HIPS, LOWER_BACK, SPINE, SPINE1, NECK, NECK1, HEAD, LEFT_SHOULDER, LEFT_ARM, RIGHT_SHOULDER, RIGHT_ARM, JOINTS };

static const struct {
    const char *name;
    int parent;
    double at[3];
} rig[JOINTS] = {
    [HIPS] = { "Hips", -1, { 0, 0.05, 0 } },
    [LOWER_BACK] = { "LowerBack", HIPS, { 0, 0.10, -0.008 } },
    [SPINE] = { "Spine", LOWER_BACK, { 0, 0.24, -0.018 } },
    [SPINE1] = { "Spine1", SPINE, { 0, 0.40, -0.028 } },
    [NECK] = { "Neck", SPINE1, { 0, 0.572, -0.026 } },
    [NECK1] = { "Neck1", NECK, { 0, 0.632, -0.010 } },
    [HEAD] = { "Head", NECK1, { 0, 0.690, 0.010 } },
    [LEFT_SHOULDER] = { "LeftShoulder", SPINE1, { 0.022, 0.535, 0.005 } },
    [LEFT_ARM] = { "LeftArm", LEFT_SHOULDER, { 0.165, 0.505, -0.014 } },
    [RIGHT_SHOULDER] = { "RightShoulder", SPINE1, { -0.022, 0.535, 0.005 } },
    [RIGHT_ARM] = { "RightArm", RIGHT_SHOULDER, { -0.165, 0.505, -0.014 } },
};

/* ---- weights ------------------------------------------------------------------------------------------------ */

/* A vertex belongs to the part whose own surface it lies on; where parts are joined it blends. */
static void weigh(hg_vec3d p, double w[JOINTS])
{
    bust_distance d = bust_measure(p);
    double head = scene_ramp(-0.022, 0.022, d.neck - d.head) * (1 - scene_ramp(0.02, 0.06, d.head));
    double torso = (1 - head) * scene_ramp(-0.03, 0.03, d.neck - d.torso);
    double neck = 1 - head - torso, upper = scene_ramp(0.595, 0.67, p.y - 0.25 * p.z);
    double shoulder = torso * scene_ramp(0.03, 0.13, fabs(p.x)) * scene_ramp(0.40, 0.51, p.y);
    double arm = torso * scene_ramp(0.135, 0.195, fabs(p.x)), low = 1 - scene_ramp(0.30, 0.44, p.y);
    shoulder = fmin(shoulder, torso - arm);
    memset(w, 0, JOINTS * sizeof *w);
    w[HEAD] = head;
    w[NECK1] = neck * upper, w[NECK] = neck * (1 - upper);
    w[p.x > 0 ? LEFT_ARM : RIGHT_ARM] = arm;
    w[p.x > 0 ? LEFT_SHOULDER : RIGHT_SHOULDER] = shoulder;
    w[SPINE] = (torso - arm - shoulder) * low, w[SPINE1] = (torso - arm - shoulder) * (1 - low);
}

/* Evens the weights out between neighbours, a few rounds. weights [N,JOINTS]. */
static hg_status smooth_weights(const hg_body *b, double *weights)
{
    hg_status status = HG_MEMORY;
    double *sum = hg_alloc((size_t)b->vertices, JOINTS * sizeof *sum),
           *count = hg_alloc((size_t)b->vertices, sizeof *count);
    if (!sum || !count) goto done;
    for (int round = 0; round < 4; round++) {
        memset(sum, 0, (size_t)b->vertices * JOINTS * sizeof *sum);
        memset(count, 0, (size_t)b->vertices * sizeof *count);
        for (int64_t i = 0; i < 3 * b->faces; i++) {
            int64_t v = b->triangles[i], u = b->triangles[i % 3 == 2 ? i - 2 : i + 1];
            for (int j = 0; j < JOINTS; j++)
                sum[JOINTS * v + j] += weights[JOINTS * u + j], sum[JOINTS * u + j] += weights[JOINTS * v + j];
            count[v]++, count[u]++;
        }
        for (int64_t i = 0; i < b->vertices * JOINTS; i++) weights[i] = 0.5 * (weights[i] + sum[i] / count[i / JOINTS]);
    }
    status = HG_OK;
done:
    hg_free(sum);
    hg_free(count);
    return status;
}

/* The eight largest, with sum 1; less than 0.1 % is nothing. */
static void keep_influences(const double w[JOINTS], int32_t *influence, float *weight)
{
    double kept[JOINTS], sum = 0;
    int joint[HG_INFLUENCES], n = 0;
    memcpy(kept, w, sizeof kept);
    for (; n < HG_INFLUENCES; n++) {
        int best = 0;
        for (int j = 1; j < JOINTS; j++)
            if (kept[j] > kept[best]) best = j;
        if (kept[best] < 1e-3) break;
        joint[n] = best, sum += kept[best], kept[best] = -1;
    }
    for (int k = 0; k < n; k++) influence[k] = joint[k], weight[k] = (float)(w[joint[k]] / sum);
}

/* ---- shapes ------------------------------------------------------------------------------------------------- */

static const struct {
    const char *name;
    double spread;
} shapes[HG_SHAPES] = { { "head_width", 0.3 },     { "head_height", 0.3 },     { "head_depth", 0.3 },
                        { "jaw_width", 0.4 },      { "neck_length", 0.4 },     { "neck_width", 0.4 },
                        { "shoulder_width", 0.4 }, { "shoulder_height", 0.4 }, { "build", 0.4 },
                        { "stature", 0.4 } };

/* Where one unit of a shape moves a point of these weights. Linear in the weights, so as smooth as they are. */
static hg_vec3d shape_way(int shape, hg_vec3d p, const double w[JOINTS], hg_vec3d normal)
{
    double head = w[HEAD], neck = w[NECK] + w[NECK1], torso = 1 - head - neck;
    switch (shape) {
    case 0:
        return hg_vec3d_make(0.10 * p.x * head, 0, 0);
    case 1:
        return hg_vec3d_make(0, 0.12 * (p.y - 0.69) * head * scene_ramp(0.62, 0.76, p.y), 0);
    case 2:
        return hg_vec3d_make(0, 0, 0.10 * (p.z - 0.02) * head);
    case 3:
        return hg_vec3d_make(0.14 * p.x * head * (1 - scene_ramp(0.64, 0.73, p.y)), 0, 0);
    case 4:
        return hg_vec3d_make(0, 0.02 * (head + 0.67 * w[NECK1] + 0.33 * w[NECK]), 0);
    case 5:
        return hg_vec3d_make(0.13 * p.x * neck, 0, 0.13 * (p.z - 0.4 * (p.y - 0.6)) * neck);
    case 6:
        return hg_vec3d_make(0.11 * p.x * torso, 0, 0);
    case 7:
        return hg_vec3d_make(0, 0.024 * scene_ramp(0.03, 0.16, fabs(p.x)) * torso, 0);
    case 8:
        return hg_vec3d_scale(normal, 0.010 * torso + 0.004 * neck + 0.0015 * head);
    default:
        return hg_vec3d_scale(hg_vec3d_sub(p, hg_vec3d_make(0, 0.05, 0)), 0.04);
    }
}

/* A joint lies between two parts and moves with both. */
static void joint_weights(int joint, double w[JOINTS])
{
    memset(w, 0, JOINTS * sizeof *w);
    w[joint] += 0.5;
    w[rig[joint].parent >= 0 ? rig[joint].parent : joint] += 0.5;
}

/* ---- scalp -------------------------------------------------------------------------------------------------- */

/* Within 116 degrees of an axis that leans back by 35, without temples, ears and the front of the neck. */
static bool on_scalp(const hg_body *b, hg_vec3d p, double head_weight)
{
    hg_vec3d d = hg_vec3d_normalize(hg_vec3d_sub(p, hg_vec3d_load(b->scalp_centre)));
    if (hg_vec3d_dot(d, hg_vec3d_load(b->scalp_axis)) < cos(116 * SCENE_PI / 180)) return false;
    double hairline = 0.690 + 0.065 * scene_ramp(-0.005, 0.015, p.z) + 0.024 * scene_ramp(0.03, 0.09, p.z);
    return head_weight > 0.3 && p.y > hairline;
}

/* ---- the body ----------------------------------------------------------------------------------------------- */

static hg_status bust_allocate(hg_body *b)
{
    size_t n = (size_t)b->vertices;
    b->joints = JOINTS;
    b->uv = hg_alloc(n, 2 * sizeof *b->uv);
    b->joint_name = hg_alloc(JOINTS, sizeof *b->joint_name);
    b->parent = hg_alloc(JOINTS, sizeof *b->parent);
    b->joint = hg_alloc(JOINTS, 3 * sizeof *b->joint);
    b->joint_shapes = hg_alloc(HG_SHAPES * JOINTS, 3 * sizeof *b->joint_shapes);
    b->influence = hg_alloc(n, HG_INFLUENCES * sizeof *b->influence);
    b->weight = hg_alloc(n, HG_INFLUENCES * sizeof *b->weight);
    b->shapes = hg_alloc(HG_SHAPES * n, 3 * sizeof *b->shapes);
    b->shape_name = hg_alloc(HG_SHAPES, sizeof *b->shape_name);
    b->scalp = hg_alloc((size_t)b->faces, sizeof *b->scalp);
    b->collider = hg_alloc((size_t)b->faces, sizeof *b->collider);
    bool made = b->uv && b->joint_name && b->parent && b->joint && b->joint_shapes && b->influence && b->weight &&
                b->shapes && b->shape_name && b->scalp && b->collider;
    for (int j = 0; made && j < JOINTS; j++) made = (b->joint_name[j] = hg_strdup(rig[j].name)) != NULL;
    for (int k = 0; made && k < HG_SHAPES; k++) made = (b->shape_name[k] = hg_strdup(shapes[k].name)) != NULL;
    return made ? HG_OK : HG_MEMORY;
}

static void bust_rig(hg_body *b)
{
    for (int j = 0; j < JOINTS; j++) {
        double w[JOINTS];
        hg_vec3d at = hg_vec3d_load(rig[j].at);
        joint_weights(j, w);
        b->parent[j] = rig[j].parent;
        scene_put(b->joint + 3 * j, at);
        for (int k = 0; k < HG_SHAPES; k++) /* `build` moves skin, not bones: no normal */
            scene_put(b->joint_shapes + 3 * (k * JOINTS + j), shape_way(k, at, w, (hg_vec3d){ 0 }));
    }
    for (int k = 0; k < HG_SHAPES; k++) b->shape_spread[k] = shapes[k].spread;
}

static void bust_skin(hg_body *b, const double *weights)
{
    for (int64_t v = 0; v < b->vertices; v++) {
        hg_vec3d p = scene_point(b->points + 3 * v), normal = bust_normal(p);
        const double *w = weights + JOINTS * v;
        keep_influences(w, b->influence + HG_INFLUENCES * v, b->weight + HG_INFLUENCES * v);
        for (int k = 0; k < HG_SHAPES; k++)
            scene_put(b->shapes + 3 * (k * b->vertices + v), shape_way(k, p, w, normal));
        hg_scalp_project(b, b->points + 3 * v, b->uv + 2 * v);
    }
}

static void bust_faces(hg_body *b, const double *weights)
{
    for (int64_t f = 0; f < b->faces; f++) {
        hg_vec3d centre = { 0 };
        double head = 0;
        for (int c = 0; c < 3; c++) {
            int64_t v = b->triangles[3 * f + c];
            centre = hg_vec3d_add_scaled(centre, 1.0 / 3, scene_point(b->points + 3 * v));
            head += weights[JOINTS * v + HEAD] / 3;
        }
        if (on_scalp(b, centre, head)) b->scalp[b->scalp_faces++] = (int32_t)f;
        b->collider[b->collider_faces++] = (int32_t)f; /* all: a closed surface has an inside everywhere */
    }
}

static hg_status bust_build(hg_body *b, double **weights)
{
    HG_TRY(bust_mesh(CELL, &b->vertices, &b->points, &b->faces, &b->triangles));
    HG_TRY(bust_allocate(b));
    *weights = hg_alloc((size_t)b->vertices, JOINTS * sizeof **weights);
    if (!*weights) return HG_MEMORY;
    const double lean = 35 * SCENE_PI / 180, centre[3] = { 0, 0.762, 0.030 };
    b->scalp_axis[1] = cos(lean), b->scalp_axis[2] = -sin(lean);
    memcpy(b->scalp_centre, centre, sizeof centre);
    for (int64_t v = 0; v < b->vertices; v++) weigh(scene_point(b->points + 3 * v), *weights + JOINTS * v);
    HG_TRY(smooth_weights(b, *weights));
    bust_rig(b);
    bust_skin(b, *weights);
    bust_faces(b, *weights);
    return HG_OK;
}

hg_status hg_bust_create(hg_body **body)
{
    double *weights = NULL;
    *body = NULL;
    hg_body *b = hg_alloc(1, sizeof *b);
    if (!b) return HG_MEMORY;
    hg_status status = bust_build(b, &weights);
    hg_free(weights);
    if (status == HG_OK)
        *body = b;
    else
        hg_body_destroy(b);
    return status;
}
