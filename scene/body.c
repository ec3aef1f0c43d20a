/* Bodies: memory, files, and the scalp projection. */
#include "scene/internal.h"
#include "scene/joints.h"

#include <string.h>

#define BODY_FORMAT "hairgrad body"

void hg_body_destroy(hg_body *body)
{
    if (!body) return;
    hg_free(body->points);
    hg_free(body->triangles);
    hg_free(body->uv);
    hg_texts_free(body->joint_name, (int)body->joints);
    hg_free(body->parent);
    hg_free(body->joint);
    hg_free(body->joint_shapes);
    hg_free(body->influence);
    hg_free(body->weight);
    hg_free(body->shapes);
    hg_texts_free(body->shape_name, HG_SHAPES);
    hg_free(body->scalp);
    hg_free(body->collider);
    hg_free(body);
}

int hg_body_joint(const hg_body *body, const char *name)
{
    int joint = joints_find(body->joint_name, body->joints, name);
    const joint_row *row = joint < 0 ? joints_row(name, JOINTS_OWN) : NULL;
    if (!row) return joint;
    return joints_find_row(body->joint_name, body->joints, row, joints_family(body->joint_name, body->joints));
}

uint64_t hg_body_hash(const hg_body *b)
{
    int64_t counts[3] = { b->vertices, b->faces, b->joints };
    size_t n = (size_t)b->vertices, f = (size_t)b->faces, j = (size_t)b->joints;
    uint64_t hash = hg_hash(counts, sizeof counts, 0);
    hash = hg_hash(b->points, n * 3 * sizeof *b->points, hash);
    hash = hg_hash(b->triangles, f * 3 * sizeof *b->triangles, hash);
    hash = hg_hash(b->parent, j * sizeof *b->parent, hash);
    hash = hg_hash(b->joint, j * 3 * sizeof *b->joint, hash);
    hash = hg_hash(b->joint_shapes, HG_SHAPES * j * 3 * sizeof *b->joint_shapes, hash);
    hash = hg_hash(b->influence, n * HG_INFLUENCES * sizeof *b->influence, hash);
    hash = hg_hash(b->weight, n * HG_INFLUENCES * sizeof *b->weight, hash);
    hash = hg_hash(b->shapes, HG_SHAPES * n * 3 * sizeof *b->shapes, hash);
    hash = hg_hash(b->scalp, (size_t)b->scalp_faces * sizeof *b->scalp, hash);
    return hg_hash(b->collider, (size_t)b->collider_faces * sizeof *b->collider, hash);
}

/* Lambert's azimuthal projection about the scalp axis: u to the character's left, 60 degrees from the axis is half way
 * out, 120 degrees is the edge. It keeps areas of a sphere and has no seam. Beyond the edge, UVs stop at 0 and 1. */
void hg_scalp_project(const hg_body *body, const float point[3], float uv[2])
{
    hg_vec3d axis = hg_vec3d_normalize(hg_vec3d_load(body->scalp_axis));
    hg_vec3d left = fabs(axis.x) > 0.99 ? hg_vec3d_make(0, 0, 1) : hg_vec3d_make(1, 0, 0);
    left = hg_vec3d_normalize(hg_vec3d_add_scaled(left, -hg_vec3d_dot(left, axis), axis));
    hg_vec3d back = hg_vec3d_cross(axis, left);
    hg_vec3d d = hg_vec3d_sub(scene_point(point), hg_vec3d_load(body->scalp_centre));
    double x = hg_vec3d_dot(d, left), y = hg_vec3d_dot(d, back), across = sqrt(x * x + y * y);
    uv[0] = uv[1] = 0.5f;
    if (!(across > 0)) return;
    double r = 0.5 * sin(0.5 * atan2(across, hg_vec3d_dot(d, axis))) / sin(SCENE_PI / 3);
    uv[0] = (float)fmin(fmax(0.5 + r * x / across, 0), 1);
    uv[1] = (float)fmin(fmax(0.5 + r * y / across, 0), 1);
}

/* ---- files -------------------------------------------------------------------------------------------------- */

/* Face numbers of a subset: in range and ascending, so that a face is not counted twice. */
static hg_status subset_check(const char *path, const char *what, const int32_t *faces, int64_t n, int64_t all)
{
    HG_TRY(scene_check_range(path, what, faces, n, 0, all));
    for (int64_t i = 1; i < n; i++)
        if (faces[i] <= faces[i - 1])
            return hg_fail(HG_FORMAT, "%s: %s: entry %lld is %d after %d, expected ascending faces", path, what,
                           (long long)i, faces[i], faces[i - 1]);
    return HG_OK;
}

static hg_status body_check(const hg_body *b, const char *path)
{
    int64_t n = b->vertices, j = b->joints;
    HG_TRY(scene_check_finite(path, "points", b->points, n, 3));
    HG_TRY(scene_check_range(path, "triangles", b->triangles, b->faces * 3, 0, n));
    if (b->uv) HG_TRY(scene_check_finite(path, "uv", b->uv, n, 2));
    if (b->parent[0] != -1)
        return hg_fail(HG_FORMAT, "%s: the first joint has parent %d, expected -1", path, b->parent[0]);
    for (int64_t i = 1; i < j; i++)
        if (b->parent[i] < 0 || b->parent[i] >= i)
            return hg_fail(HG_FORMAT, "%s: joint %lld (%s) has parent %d, expected a joint before it", path,
                           (long long)i, b->joint_name[i], b->parent[i]);
    for (int64_t i = 1; i < j; i++)
        if (hg_body_joint(b, b->joint_name[i]) != i)
            return hg_fail(HG_FORMAT, "%s: two joints have the name %s", path, b->joint_name[i]);
    HG_TRY(scene_check_finite(path, "joint", b->joint, j, 3));
    HG_TRY(scene_check_finite(path, "joint_shapes", b->joint_shapes, HG_SHAPES * j, 3));
    HG_TRY(scene_check_range(path, "influence", b->influence, n * HG_INFLUENCES, 0, j));
    HG_TRY(scene_check_finite(path, "weight", b->weight, n, HG_INFLUENCES));
    for (int64_t i = 0; i < n; i++) {
        double sum = 0;
        for (int k = 0; k < HG_INFLUENCES; k++) {
            float w = b->weight[i * HG_INFLUENCES + k];
            if (w < 0) return hg_fail(HG_FORMAT, "%s: vertex %lld has a negative weight", path, (long long)i);
            sum += (double)w;
        }
        if (fabs(sum - 1) > 1e-3)
            return hg_fail(HG_FORMAT, "%s: the weights of vertex %lld have the sum %g, expected 1", path, (long long)i,
                           sum);
    }
    HG_TRY(scene_check_finite(path, "shapes", b->shapes, HG_SHAPES * n, 3));
    for (int k = 0; k < HG_SHAPES; k++)
        if (!(b->shape_spread[k] >= 0 && b->shape_spread[k] <= 10))
            return hg_fail(HG_FORMAT, "%s: shape_spread %d is %g, expected 0 to 10", path, k, b->shape_spread[k]);
    if (b->scalp_faces == 0)
        return hg_fail(HG_FORMAT, "%s: the body has no scalp: list the faces that carry hair in the dataset scalp",
                       path);
    HG_TRY(subset_check(path, "scalp", b->scalp, b->scalp_faces, b->faces));
    if (b->collider_faces == 0)
        return hg_fail(HG_FORMAT, "%s: the dataset collider is empty: list the faces that hair can touch", path);
    HG_TRY(subset_check(path, "collider", b->collider, b->collider_faces, b->faces));
    hg_vec3d axis = hg_vec3d_load(b->scalp_axis), centre = hg_vec3d_load(b->scalp_centre);
    if (!(hg_vec3d_norm(axis) > 1e-6 && hg_vec3d_finite(axis) && hg_vec3d_finite(centre)))
        return hg_fail(HG_FORMAT, "%s: scalp_axis or scalp_centre is no direction or point", path);
    return HG_OK;
}

static hg_status read_numbers(hg_h5 *file, const char *name, int64_t n, double *to)
{
    double *numbers;
    HG_TRY(hg_h5_read(file, name, HG_F64, 1, &n, NULL, (void **)&numbers));
    memcpy(to, numbers, (size_t)n * sizeof *to);
    hg_free(numbers);
    return HG_OK;
}

static hg_status body_read(hg_h5 *file, const char *path, const scene_axes *axes, void *to)
{
    hg_body *b = to;
    int64_t shape[6];
    int names = 0;
    HG_TRY(hg_h5_read(file, "/points", HG_F32, 2, (int64_t[]){ -1, 3 }, shape, (void **)&b->points));
    b->vertices = shape[0];
    HG_TRY(hg_h5_read(file, "/triangles", HG_I32, 2, (int64_t[]){ -1, 3 }, shape, (void **)&b->triangles));
    b->faces = shape[0];
    if (b->vertices < 3 || b->vertices > INT32_MAX / HG_INFLUENCES || b->faces < 1 || b->faces > INT32_MAX / 3)
        return hg_fail(HG_FORMAT, "%s: %lld vertices and %lld faces are no surface", path, (long long)b->vertices,
                       (long long)b->faces);
    if (hg_h5_has(file, "/uv"))
        HG_TRY(hg_h5_read(file, "/uv", HG_F32, 2, (int64_t[]){ b->vertices, 2 }, NULL, (void **)&b->uv));
    HG_TRY(hg_h5_read_texts(file, "/joint_name", &names, &b->joint_name));
    b->joints = names;
    if (names < 1) return hg_fail(HG_FORMAT, "%s: joint_name is empty: a body has at least one joint", path);
    HG_TRY(hg_h5_read(file, "/parent", HG_I32, 1, &b->joints, NULL, (void **)&b->parent));
    HG_TRY(hg_h5_read(file, "/joint", HG_F32, 2, (int64_t[]){ b->joints, 3 }, NULL, (void **)&b->joint));
    HG_TRY(hg_h5_read(file, "/joint_shapes", HG_F32, 3, (int64_t[]){ HG_SHAPES, b->joints, 3 }, NULL,
                      (void **)&b->joint_shapes));
    HG_TRY(hg_h5_read(file, "/influence", HG_I32, 2, (int64_t[]){ b->vertices, HG_INFLUENCES }, NULL,
                      (void **)&b->influence));
    HG_TRY(
        hg_h5_read(file, "/weight", HG_F32, 2, (int64_t[]){ b->vertices, HG_INFLUENCES }, NULL, (void **)&b->weight));
    HG_TRY(hg_h5_read(file, "/shapes", HG_F32, 3, (int64_t[]){ HG_SHAPES, b->vertices, 3 }, NULL, (void **)&b->shapes));
    char **shape_name;
    HG_TRY(hg_h5_read_texts(file, "/shape_name", &names, &shape_name));
    if (names != HG_SHAPES) {
        hg_texts_free(shape_name, names);
        return hg_fail(HG_FORMAT, "%s: shape_name has %d names, expected %d", path, names, HG_SHAPES);
    }
    b->shape_name = shape_name;
    HG_TRY(read_numbers(file, "/shape_spread", HG_SHAPES, b->shape_spread));
    HG_TRY(hg_h5_read(file, "/scalp", HG_I32, 1, (int64_t[]){ -1 }, &b->scalp_faces, (void **)&b->scalp));
    HG_TRY(hg_h5_read(file, "/collider", HG_I32, 1, (int64_t[]){ -1 }, &b->collider_faces, (void **)&b->collider));
    HG_TRY(read_numbers(file, "/scalp_axis", 3, b->scalp_axis));
    HG_TRY(read_numbers(file, "/scalp_centre", 3, b->scalp_centre));

    scene_axes_points(axes, b->points, b->vertices);
    scene_axes_points(axes, b->joint, b->joints);
    scene_axes_points(axes, b->joint_shapes, HG_SHAPES * b->joints);
    scene_axes_points(axes, b->shapes, HG_SHAPES * b->vertices);
    if (axes->z_up || axes->scale != 1) {
        float turned[6];
        scene_put(turned, hg_vec3d_load(b->scalp_axis)), scene_put(turned + 3, hg_vec3d_load(b->scalp_centre));
        scene_axes_points(axes, turned, 2);
        for (int i = 0; i < 3; i++) b->scalp_axis[i] = (double)turned[i], b->scalp_centre[i] = (double)turned[3 + i];
    }
    return body_check(b, path);
}

hg_status hg_body_load(hg_body **body, const char *path)
{
    *body = NULL;
    hg_body *b = hg_alloc(1, sizeof *b);
    hg_status status = b ? scene_file_load(path, BODY_FORMAT, body_read, b) : HG_MEMORY;
    if (status == HG_OK)
        *body = b;
    else
        hg_body_destroy(b);
    return status;
}

static hg_status body_write(hg_h5 *file, const void *from)
{
    const hg_body *b = from;
    int64_t n = b->vertices, j = b->joints;
    HG_TRY(hg_h5_write(file, "/points", HG_F32, 2, (int64_t[]){ n, 3 }, b->points));
    HG_TRY(hg_h5_write(file, "/triangles", HG_I32, 2, (int64_t[]){ b->faces, 3 }, b->triangles));
    if (b->uv) HG_TRY(hg_h5_write(file, "/uv", HG_F32, 2, (int64_t[]){ n, 2 }, b->uv));
    HG_TRY(hg_h5_write_texts(file, "/joint_name", (int)j, (const char *const *)b->joint_name));
    HG_TRY(hg_h5_write(file, "/parent", HG_I32, 1, &j, b->parent));
    HG_TRY(hg_h5_write(file, "/joint", HG_F32, 2, (int64_t[]){ j, 3 }, b->joint));
    HG_TRY(hg_h5_write(file, "/joint_shapes", HG_F32, 3, (int64_t[]){ HG_SHAPES, j, 3 }, b->joint_shapes));
    HG_TRY(hg_h5_write(file, "/influence", HG_I32, 2, (int64_t[]){ n, HG_INFLUENCES }, b->influence));
    HG_TRY(hg_h5_write(file, "/weight", HG_F32, 2, (int64_t[]){ n, HG_INFLUENCES }, b->weight));
    HG_TRY(hg_h5_write(file, "/shapes", HG_F32, 3, (int64_t[]){ HG_SHAPES, n, 3 }, b->shapes));
    HG_TRY(hg_h5_write_texts(file, "/shape_name", HG_SHAPES, (const char *const *)b->shape_name));
    HG_TRY(hg_h5_write(file, "/shape_spread", HG_F64, 1, (int64_t[]){ HG_SHAPES }, b->shape_spread));
    HG_TRY(hg_h5_write(file, "/scalp", HG_I32, 1, &b->scalp_faces, b->scalp));
    HG_TRY(hg_h5_write(file, "/collider", HG_I32, 1, &b->collider_faces, b->collider));
    HG_TRY(hg_h5_write(file, "/scalp_axis", HG_F64, 1, (int64_t[]){ 3 }, b->scalp_axis));
    return hg_h5_write(file, "/scalp_centre", HG_F64, 1, (int64_t[]){ 3 }, b->scalp_centre);
}

hg_status hg_body_save(const hg_body *body, const char *path)
{
    HG_TRY(body_check(body, path));
    return scene_file_save(path, BODY_FORMAT, body_write, body);
}
