/* What every reader of a body does last: influences, scalp, collider. */
#include "scene/skin.h"
#include "scene/lines.h"
#include "scene/npz.h"
#include "scene/visible.h"

#include <stdlib.h>
#include <string.h>

/* ---- influences ---------------------------------------------------------------------------------------------- */

void skin_add(int32_t *joints, float *weights, int joint, float weight)
{
    int place = 0;
    for (int i = 0; i < HG_INFLUENCES; i++) {
        if (weights[i] > 0 && joints[i] == joint) {
            weights[i] += weight;
            return;
        }
        if (weights[i] < weights[place]) place = i;
    }
    if (weight > weights[place]) {
        joints[place] = joint;
        weights[place] = weight;
    }
}

hg_status skin_normalise(const char *path, hg_body *body, const int32_t *number)
{
    for (int64_t v = 0; v < body->vertices; v++) {
        float *weight = body->weight + v * HG_INFLUENCES;
        double sum = 0;
        for (int i = 0; i < HG_INFLUENCES; i++) sum += (double)weight[i];
        if (!(sum > 1e-6 && isfinite(sum)))
            return hg_fail(HG_FORMAT, "%s: vertex %lld of the body has no weight", path,
                           (long long)(number ? number[v] : v));
        for (int i = 0; i < HG_INFLUENCES; i++) weight[i] = (float)((double)weight[i] / sum);
    }
    return HG_OK;
}

hg_status skin_allocate(hg_body *b)
{
    size_t n = (size_t)b->vertices, j = (size_t)b->joints;
    b->points = hg_alloc(n, 3 * sizeof *b->points);
    b->triangles = hg_alloc((size_t)b->faces, 3 * sizeof *b->triangles);
    b->joint_name = hg_alloc(j, sizeof *b->joint_name);
    b->parent = hg_alloc(j, sizeof *b->parent);
    b->joint = hg_alloc(j, 3 * sizeof *b->joint);
    b->joint_shapes = hg_alloc(HG_SHAPES * j, 3 * sizeof *b->joint_shapes);
    b->influence = hg_alloc(n, HG_INFLUENCES * sizeof *b->influence);
    b->weight = hg_alloc(n, HG_INFLUENCES * sizeof *b->weight);
    b->shapes = hg_alloc(HG_SHAPES * n, 3 * sizeof *b->shapes);
    b->shape_name = hg_alloc(HG_SHAPES, sizeof *b->shape_name);
    bool all = b->points && b->triangles && b->joint_name && b->parent && b->joint && b->joint_shapes && b->influence &&
               b->weight && b->shapes && b->shape_name;
    return all ? HG_OK : HG_MEMORY;
}

hg_status skin_name_shapes(hg_body *body, const char *first, int used, double spread)
{
    for (int k = 0; k < HG_SHAPES; k++) {
        body->shape_spread[k] = k < used ? spread : 0;
        if (body->shape_name[k]) continue;
        body->shape_name[k] = k < used ? hg_format("%s_%d", first, k) : hg_format("none_%d", k);
        if (!body->shape_name[k]) return HG_MEMORY;
    }
    return HG_OK;
}

hg_status skin_axes(const hg_import *with, bool z_up, scene_axes *axes)
{
    axes->scale = with && with->unit > 0 ? with->unit : 1;
    axes->z_up = with && with->up ? with->up == 'z' : z_up;
    if (with && with->up && with->up != 'y' && with->up != 'z')
        return hg_fail(HG_INVALID, "up axis %c: y or z", with->up);
    return HG_OK;
}

/* ---- collider ------------------------------------------------------------------------------------------------ */

hg_status skin_find_collider(const char *path, hg_body *body)
{
    int chest = hg_body_joint(body, "Spine1");
    float lowest = chest >= 0 ? body->joint[3 * chest + 1] : -INFINITY;
    body->collider = hg_alloc((size_t)body->faces, sizeof *body->collider);
    if (!body->collider) return HG_MEMORY;
    for (int64_t f = 0; f < body->faces; f++) {
        bool above = true;
        for (int k = 0; k < 3; k++) above &= body->points[3 * (int64_t)body->triangles[3 * f + k] + 1] > lowest;
        if (above) body->collider[body->collider_faces++] = (int32_t)f;
    }
    return scene_visible_faces(path, body->vertices, body->points, body->faces, body->triangles, body->collider,
                               &body->collider_faces);
}

/* ---- scalp --------------------------------------------------------------------------------------------------- */

/* How much of a vertex belongs to the head: to its joint and those below it, such as jaw and eyes. */
static double head_weight(const hg_body *body, int64_t vertex, const bool *of_head)
{
    double sum = 0;
    for (int i = 0; i < HG_INFLUENCES; i++)
        if (of_head[body->influence[vertex * HG_INFLUENCES + i]])
            sum += (double)body->weight[vertex * HG_INFLUENCES + i];
    return sum;
}

typedef struct {
    bool *joints; /* [J] of the head */
    hg_vec3d top, centre;
    double half_width;
    int64_t vertices;
} head;

static hg_status measure_head(const char *path, const hg_body *body, head *h)
{
    int joint = hg_body_joint(body, "Head");
    if (joint < 0)
        return hg_fail(HG_FORMAT,
                       "%s: no joint for \"Head\", on which the scalp would be; --scalp FILE takes face numbers", path);
    h->joints = hg_alloc((size_t)body->joints, sizeof *h->joints);
    if (!h->joints) return HG_MEMORY;
    for (int64_t j = 0; j < body->joints; j++)
        h->joints[j] = j == joint || (body->parent[j] >= 0 && h->joints[body->parent[j]]);
    double low = (double)INFINITY, high = -low, front = -low, back = low;
    h->top = hg_vec3d_make(0, -low, 0);
    for (int64_t v = 0; v < body->vertices; v++) {
        if (head_weight(body, v, h->joints) < 0.5) continue;
        hg_vec3d p = scene_point(body->points + 3 * v);
        h->vertices++;
        low = fmin(low, p.x), high = fmax(high, p.x);
        if (p.y > h->top.y) h->top = p;
    }
    if (h->vertices < 3 || !(high > low))
        return hg_fail(HG_FORMAT, "%s: %lld vertices follow the joint %s: no head that could have a scalp", path,
                       (long long)h->vertices, body->joint_name[joint]);
    h->half_width = 0.5 * (high - low);
    h->centre = hg_vec3d_make(0.5 * (low + high), h->top.y - 0.86 * h->half_width, 0);
    for (int64_t v = 0; v < body->vertices; v++) {
        hg_vec3d p = scene_point(body->points + 3 * v);
        if (p.y < h->centre.y || head_weight(body, v, h->joints) < 0.5) continue;
        front = fmax(front, p.z), back = fmin(back, p.z);
    }
    h->centre.z = 0.5 * (front + back);
    return HG_OK;
}

static hg_vec3d face_centre(const hg_body *body, int64_t face)
{
    hg_vec3d c = { 0, 0, 0 };
    for (int k = 0; k < 3; k++)
        c = hg_vec3d_add_scaled(c, 1.0 / 3, scene_point(body->points + 3 * (int64_t)body->triangles[3 * face + k]));
    return c;
}

/* Faces that can be seen, near the top of the head or in the cap of hair. radius 0: the cap. */
static void take_faces(hg_body *body, const head *h, double radius)
{
    const double widest = cos(116 * SCENE_PI / 180);
    hg_vec3d axis = hg_vec3d_load(body->scalp_axis);
    for (int64_t i = 0; i < body->collider_faces; i++) {
        int64_t f = body->collider[i];
        hg_vec3d c = face_centre(body, f), d = hg_vec3d_sub(c, h->centre);
        double least = 1;
        for (int k = 0; k < 3; k++) least = fmin(least, head_weight(body, body->triangles[3 * f + k], h->joints));
        bool ear = fabs(d.x) > 0.84 * h->half_width && d.y < 0.15 * h->half_width && d.z > -0.5 * h->half_width;
        bool cap = hg_vec3d_dot(hg_vec3d_normalize(d), axis) > widest && !ear && d.y > -1.35 * h->half_width;
        if (least > 0.3 && (radius > 0 ? hg_vec3d_distance(c, h->top) < radius : cap))
            body->scalp[body->scalp_faces++] = (int32_t)f;
    }
}

static int ascending(const void *a, const void *b)
{
    int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

static hg_status take_numbers(const char *path, hg_body *body, int64_t *numbers, int64_t n)
{
    qsort(numbers, (size_t)n, sizeof *numbers, ascending);
    for (int64_t i = 0; i < n; i++) {
        if (numbers[i] < 0 || numbers[i] >= body->faces)
            return hg_fail(HG_FORMAT, "%s: face %lld; the body has the faces 0 to %lld", path, (long long)numbers[i],
                           (long long)body->faces - 1);
        if (i == 0 || numbers[i] != numbers[i - 1]) body->scalp[body->scalp_faces++] = (int32_t)numbers[i];
    }
    return n > 0 ? HG_OK : hg_fail(HG_FORMAT, "%s: no face number in it", path);
}

static hg_status read_numbers_text(const char *path, hg_body *body)
{
    hg_lines lines;
    HG_TRY(hg_lines_open(&lines, path));
    int64_t n = 0, room = (int64_t)(hg_lines_left(&lines) / 2) + 1, *numbers = hg_alloc((size_t)room, sizeof *numbers);
    hg_status status = numbers ? HG_OK : HG_MEMORY;
    hg_word word;
    while (status == HG_OK && hg_lines_flow(&lines, &word))
        if (n == room || !hg_word_integer(word, &numbers[n++]))
            status = hg_lines_fail(&lines, "\"%.*s\" is not a face number", hg_word_length(word), word.at);
    if (status == HG_OK) status = take_numbers(path, body, numbers, n);
    hg_free(numbers);
    hg_lines_close(&lines);
    return status;
}

static hg_status read_numbers_array(const char *path, hg_body *body)
{
    npz_file *file;
    int64_t n = 0, *numbers = NULL;
    HG_TRY(npz_open(&file, path));
    const char *name = file->n == 1 ? file->array[0].name : "scalp";
    hg_status status = npz_read_i64(file, name, 1, (int64_t[]){ -1 }, &n, &numbers);
    npz_close(file);
    if (status == HG_OK) status = take_numbers(path, body, numbers, n);
    hg_free(numbers);
    return status;
}

/* Where hair is projected from, when the faces are given: the sphere's centre under them is that of the head, or of the
 * faces themselves on a body without one. */
static void aim_at_faces(hg_body *body)
{
    hg_vec3d sum = { 0, 0, 0 };
    for (int64_t i = 0; i < body->scalp_faces; i++) sum = hg_vec3d_add(sum, face_centre(body, body->scalp[i]));
    hg_vec3d middle = hg_vec3d_scale(sum, 1.0 / (double)body->scalp_faces);
    hg_vec3d_store(body->scalp_centre, hg_vec3d_add_scaled(middle, -0.05, hg_vec3d_make(0, 1, 0)));
}

hg_status skin_find_scalp(const char *path, hg_body *body, const char *how, hg_text *notes)
{
    const double lean = 35 * SCENE_PI / 180;
    body->scalp_axis[0] = 0, body->scalp_axis[1] = cos(lean), body->scalp_axis[2] = -sin(lean);
    body->scalp = hg_alloc((size_t)body->faces, sizeof *body->scalp);
    if (!body->scalp) return HG_MEMORY;
    double radius = 0;
    bool is_file = how && hg_file_exists(how);
    if (how && !is_file && (hg_unit_parse(how, "m", &radius) != HG_OK || !(radius > 0)))
        return hg_fail(HG_INVALID, "--scalp %s: neither a file of face numbers nor a length such as \"9 cm\"", how);
    head h = { 0 };
    hg_status status = measure_head(path, body, &h);
    if (status == HG_OK) hg_vec3d_store(body->scalp_centre, h.centre);
    if (is_file) {
        bool array = !strcmp(hg_path_extension(how), "npy") || !strcmp(hg_path_extension(how), "npz"),
             no_head = status == HG_FORMAT;
        if (no_head) status = HG_OK;
        if (status == HG_OK) status = array ? read_numbers_array(how, body) : read_numbers_text(how, body);
        if (status == HG_OK && no_head) aim_at_faces(body);
    } else if (status == HG_OK) {
        take_faces(body, &h, radius);
    }
    if (status == HG_OK && body->scalp_faces == 0)
        status = hg_fail(HG_FORMAT,
                         "%s: no face of the head where the scalp should be; --scalp FILE takes face numbers", path);
    if (status == HG_OK && notes)
        hg_text_add(notes, "scalp: %lld faces %s\n", (long long)body->scalp_faces,
                    is_file      ? "as listed"
                    : radius > 0 ? "around the top of the head"
                                 : "found by the shape of the head: look at them, --scalp takes others");
    for (int64_t i = 0; status == HG_OK && body->uv && i < 3 * body->scalp_faces; i++) {
        int64_t v = body->triangles[3 * (int64_t)body->scalp[i / 3] + i % 3];
        hg_scalp_project(body, body->points + 3 * v, body->uv + 2 * v);
    }
    hg_free(h.joints);
    return status;
}
