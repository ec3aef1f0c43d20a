/* A body from the MakeHuman base mesh (base.obj, .target files) and an MPFB rig (rig.*.json, weights.*.json).
 *
 * The rest shape is the one that the rig was made for: the base mesh plus a sixth of each of six young adults. Files
 * are in decimetres with our axes. Joints are means of helper vertices (cubes) that the shape targets move too: each
 * joint therefore gets its own ten shape directions, which is exact because everything is linear.
 */
#include "scene/lines.h"
#include "scene/skin.h"

#include "geometry/vector.h"

#include <cjson/cJSON.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#define METRES     0.1 /* per file unit */
#define MAX_JOINTS 256

/* ---- shape directions: half the difference of two sides, each the mean of its targets ---------------------------- */

#define YOUNG(sex_)                                                                                                    \
    "macrodetails/african-" sex_ "-young", "macrodetails/asian-" sex_ "-young", "macrodetails/caucasian-" sex_ "-young"
#define OLD(sex_)                                                                                                      \
    "macrodetails/african-" sex_ "-old", "macrodetails/asian-" sex_ "-old", "macrodetails/caucasian-" sex_ "-old"
#define RACE(race_) "macrodetails/" race_ "-female-young", "macrodetails/" race_ "-male-young"
#define BUILD(muscle_, weight_)                                                                                        \
    "macrodetails/universal-female-young-" muscle_ "muscle-" weight_ "weight",                                         \
        "macrodetails/universal-male-young-" muscle_ "muscle-" weight_ "weight"

typedef struct {
    const char *name;
    double spread; /* deviation that gives plausible people, several directions at once */
    const char *plus[7], *minus[7];
} shape_direction;

static const char *const neutral_targets[] = { YOUNG("female"), YOUNG("male"), NULL };
static const shape_direction directions[HG_SHAPES] = {
    { "gender", 0.4, { YOUNG("male") }, { YOUNG("female") } },
    { "age", 0.4, { OLD("female"), OLD("male") }, { YOUNG("female"), YOUNG("male") } },
    { "weight", 0.4, { BUILD("min", "max") }, { BUILD("min", "min") } },
    { "muscle", 0.4, { BUILD("max", "max") }, { BUILD("min", "max") } },
    { "african", 0.4, { RACE("african") }, { RACE("caucasian") } },
    { "asian", 0.4, { RACE("asian") }, { RACE("caucasian") } },
    { "head_width", 0.2, { "head/head-scale-horiz-incr" }, { "head/head-scale-horiz-decr" } },
    { "head_height", 0.2, { "head/head-scale-vert-incr" }, { "head/head-scale-vert-decr" } },
    { "head_depth", 0.2, { "head/head-scale-depth-incr" }, { "head/head-scale-depth-decr" } },
    { "neck_height", 0.2, { "neck/neck-scale-vert-incr" }, { "neck/neck-scale-vert-decr" } },
};

/* What is being read: the whole mesh with helpers, and the body that comes out of it. */
typedef struct {
    const char *folder;
    hg_mesh *mesh;
    int body_group;               /* of the mesh */
    double *neutral;              /* [mesh vertices,3] metres */
    double *direction[HG_SHAPES]; /* [mesh vertices,3] */
    int32_t *number;              /* [mesh vertices] of a mesh vertex in the body, -1 for helpers */
    int32_t *vertex;              /* [body vertices] of a body vertex in the mesh */
    int32_t *polygon;             /* [faces] of the file that a body face was cut from */
    cJSON *rig, *weights;
    char *rig_path, *weights_path;
    hg_body *body;
} maker;

/* ---- targets ------------------------------------------------------------------------------------------------- */

/* Adds factor times a target, lines "vertex dx dy dz" on vertices counted from 0, to offset [n,3]. */
static hg_status add_target_lines(hg_lines *lines, double factor, int64_t n, double *offset)
{
    while (hg_lines_next(lines)) {
        hg_word word;
        int64_t vertex;
        hg_lines_word(lines, &word);
        if (!hg_word_integer(word, &vertex) || vertex < 0 || vertex >= n)
            return hg_lines_fail(lines, "\"%.*s\" is not one of the %lld vertices of the base mesh",
                                 hg_word_length(word), word.at, (long long)n);
        for (int k = 0; k < 3; k++) {
            double number;
            HG_TRY(hg_lines_number(lines, &number, "offset"));
            offset[3 * vertex + k] += factor * number;
        }
    }
    return HG_OK;
}

static hg_status add_target(const maker *m, const char *name, double factor, double *offset)
{
    char *path = hg_format("%s/makehuman/targets/%s.target", m->folder, name);
    if (!path) return HG_MEMORY;
    hg_lines lines;
    hg_status status = hg_lines_open(&lines, path);
    if (status == HG_OK) {
        status = add_target_lines(&lines, factor, m->mesh->vertices, offset);
        hg_lines_close(&lines);
    }
    hg_free(path);
    return status;
}

static hg_status add_mean(const maker *m, const char *const *names, double factor, double *offset)
{
    int count = 0;
    while (names[count]) count++;
    for (int i = 0; i < count; i++) HG_TRY(add_target(m, names[i], factor / count, offset));
    return HG_OK;
}

static hg_status read_shapes(maker *m)
{
    size_t count = (size_t)m->mesh->vertices;
    m->neutral = hg_alloc(count, 3 * sizeof *m->neutral);
    if (!m->neutral) return HG_MEMORY;
    for (size_t i = 0; i < 3 * count; i++) m->neutral[i] = METRES * (double)m->mesh->points[i];
    HG_TRY(add_mean(m, neutral_targets, METRES, m->neutral));
    for (int k = 0; k < HG_SHAPES; k++) {
        m->direction[k] = hg_alloc(count, 3 * sizeof *m->direction[k]);
        if (!m->direction[k]) return HG_MEMORY;
        HG_TRY(add_mean(m, directions[k].plus, 0.5 * METRES, m->direction[k]));
        HG_TRY(add_mean(m, directions[k].minus, -0.5 * METRES, m->direction[k]));
    }
    return HG_OK;
}

/* ---- mesh ---------------------------------------------------------------------------------------------------- */

static hg_status find_body_group(maker *m)
{
    const hg_mesh *mesh = m->mesh;
    while (m->body_group < mesh->n_groups && strcmp(mesh->group[m->body_group], "body") != 0) m->body_group++;
    for (int64_t f = 0; f < mesh->faces; f++)
        if (mesh->group_of_face[f] == m->body_group) return HG_OK;
    return hg_fail(HG_FORMAT,
                   "%s/makehuman/base.obj: no polygon in a group named \"body\"; is this the MakeHuman base mesh?",
                   m->folder);
}

static hg_status take_body_group(maker *m)
{
    const hg_mesh *mesh = m->mesh;
    hg_body *body = m->body;
    int group = m->body_group;
    m->number = hg_alloc((size_t)mesh->vertices, sizeof *m->number);
    m->vertex = hg_alloc((size_t)mesh->vertices, sizeof *m->vertex);
    if (!m->number || !m->vertex) return HG_MEMORY;
    for (int64_t f = 0; f < mesh->faces; f++) {
        if (mesh->group_of_face[f] != group) continue;
        body->faces++;
        for (int k = 0; k < 3; k++) m->number[mesh->triangles[3 * f + k]] = 1;
    }
    for (int64_t v = 0; v < mesh->vertices; v++) {
        if (m->number[v]) m->vertex[body->vertices] = (int32_t)v;
        m->number[v] = m->number[v] ? (int32_t)body->vertices++ : -1;
    }
    size_t n = (size_t)body->vertices;
    body->points = hg_alloc(n, 3 * sizeof *body->points);
    body->triangles = hg_alloc((size_t)body->faces, 3 * sizeof *body->triangles);
    m->polygon = hg_alloc((size_t)body->faces, sizeof *m->polygon);
    body->shapes = hg_alloc(HG_SHAPES * n, 3 * sizeof *body->shapes);
    body->shape_name = hg_alloc(HG_SHAPES, sizeof *body->shape_name);
    if (!body->points || !body->triangles || !m->polygon || !body->shapes || !body->shape_name) return HG_MEMORY;
    int64_t kept = 0;
    for (int64_t f = 0; f < mesh->faces; f++) {
        if (mesh->group_of_face[f] != group) continue;
        m->polygon[kept] = mesh->polygon[f];
        for (int k = 0; k < 3; k++) body->triangles[3 * kept + k] = m->number[mesh->triangles[3 * f + k]];
        kept++;
    }
    if (mesh->uv) {
        body->uv = hg_alloc(n, 2 * sizeof *body->uv);
        if (!body->uv) return HG_MEMORY;
        for (size_t v = 0; v < n; v++)
            memcpy(body->uv + 2 * v, mesh->uv + 2 * (int64_t)m->vertex[v], 2 * sizeof *body->uv);
    }
    for (size_t i = 0; i < 3 * n; i++)
        body->points[i] = (float)m->neutral[3 * (int64_t)m->vertex[i / 3] + (int64_t)(i % 3)];
    for (int s = 0; s < HG_SHAPES; s++) {
        float *shape = body->shapes + 3 * n * (size_t)s;
        for (size_t i = 0; i < 3 * n; i++)
            shape[i] = (float)m->direction[s][3 * (int64_t)m->vertex[i / 3] + (int64_t)(i % 3)];
        body->shape_spread[s] = directions[s].spread;
        if (!(body->shape_name[s] = hg_strdup(directions[s].name))) return HG_MEMORY;
    }
    return HG_OK;
}

/* ---- rig ----------------------------------------------------------------------------------------------------- */

static hg_status read_json(cJSON **json, const char *path)
{
    void *bytes = NULL;
    size_t size = 0;
    HG_TRY(hg_file_read(path, &bytes, &size));
    const char *end = bytes;
    *json = cJSON_ParseWithOpts(bytes, &end, 1);
    if (!*json) {
        long long line = 1;
        for (const char *c = bytes; c < end; c++) line += *c == '\n';
        hg_fail(HG_FORMAT, "%s:%lld: not valid JSON from byte %lld on (%zu bytes in all)", path, line,
                (long long)(end - (const char *)bytes), size);
    }
    hg_free(bytes);
    return *json ? HG_OK : HG_FORMAT;
}

static hg_status rig_fail(const maker *m, const cJSON *bone, const char *what)
{
    return hg_fail(HG_FORMAT, "%s: bone \"%s\": %s", m->rig_path, bone->string ? bone->string : "", what);
}

/* The mesh vertices whose mean is the joint at a bone's head; used [mesh vertices] becomes 1 at them. */
static hg_status mark_joint(const maker *m, const cJSON *bone, uint8_t *used)
{
    const hg_mesh *mesh = m->mesh;
    const cJSON *head = cJSON_GetObjectItemCaseSensitive(bone, "head");
    const char *strategy = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(head, "strategy"));
    memset(used, 0, (size_t)mesh->vertices);
    if (strategy && strcmp(strategy, "CUBE") == 0) {
        const char *cube = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(head, "cube_name"));
        int group = 0;
        while (cube && group < mesh->n_groups && strcmp(mesh->group[group], cube) != 0) group++;
        if (!cube || group == mesh->n_groups) return rig_fail(m, bone, "its cube_name is not a group of base.obj");
        for (int64_t f = 0; f < mesh->faces; f++)
            if (mesh->group_of_face[f] == group)
                for (int k = 0; k < 3; k++) used[mesh->triangles[3 * f + k]] = 1;
        return HG_OK;
    }
    if (strategy && strcmp(strategy, "MEAN") == 0) {
        const cJSON *index;
        cJSON_ArrayForEach(index, cJSON_GetObjectItemCaseSensitive(head, "vertex_indices"))
        {
            if (!cJSON_IsNumber(index) || !(index->valuedouble >= 0 && index->valuedouble < (double)mesh->vertices))
                return rig_fail(m, bone, "vertex_indices holds something that is not a vertex of base.obj");
            used[(int64_t)index->valuedouble] = 1;
        }
        return HG_OK;
    }
    return rig_fail(m, bone, "its head has no strategy CUBE or MEAN");
}

static void mean_of(const uint8_t *used, int64_t n, const double *field, float out[3])
{
    double sum[3] = { 0 };
    int64_t count = 0;
    for (int64_t v = 0; v < n; v++) {
        if (!used[v]) continue;
        count++;
        for (int k = 0; k < 3; k++) sum[k] += field[3 * v + k];
    }
    for (int k = 0; k < 3; k++) out[k] = (float)(sum[k] / (double)(count ? count : 1));
}

static int find_joint(const hg_body *body, const char *name)
{
    for (int j = 0; name && j < body->joints; j++)
        if (body->joint_name[j] && strcmp(body->joint_name[j], name) == 0) return j;
    return -1;
}

static hg_status take_joint(maker *m, const cJSON *bone, int parent, uint8_t *used)
{
    hg_body *body = m->body;
    int j = (int)body->joints;
    HG_TRY(mark_joint(m, bone, used));
    if (!memchr(used, 1, (size_t)m->mesh->vertices)) return rig_fail(m, bone, "no vertex to take its place from");
    mean_of(used, m->mesh->vertices, m->neutral, body->joint + 3 * j);
    int64_t stride = 3 * (int64_t)cJSON_GetArraySize(m->rig);
    for (int s = 0; s < HG_SHAPES; s++)
        mean_of(used, m->mesh->vertices, m->direction[s], body->joint_shapes + s * stride + 3 * j);
    body->parent[j] = parent;
    if (!(body->joint_name[j] = hg_strdup(bone->string))) return HG_MEMORY;
    body->joints++;
    return HG_OK;
}

/* Joints depth first from the root, siblings in the order of the file: parents come first. */
static hg_status read_rig(maker *m)
{
    hg_body *body = m->body;
    int count = cJSON_GetArraySize(m->rig);
    if (!cJSON_IsObject(m->rig) || count < 1 || count > MAX_JOINTS)
        return hg_fail(HG_FORMAT, "%s: expected one object of 1 to %d bones", m->rig_path, MAX_JOINTS);
    const cJSON *bone, *root = NULL;
    cJSON_ArrayForEach(bone, m->rig)
    {
        const char *parent = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(bone, "parent"));
        if (!parent) return rig_fail(m, bone, "no text \"parent\"");
        if (*parent) continue;
        if (root) return rig_fail(m, bone, "a second bone without parent");
        root = bone;
    }
    if (!root) return hg_fail(HG_FORMAT, "%s: no bone has an empty \"parent\", so there is no root", m->rig_path);
    body->joint_name = hg_alloc((size_t)count, sizeof *body->joint_name);
    body->parent = hg_alloc((size_t)count, sizeof *body->parent);
    body->joint = hg_alloc((size_t)count, 3 * sizeof *body->joint);
    body->joint_shapes = hg_alloc((size_t)count * HG_SHAPES, 3 * sizeof *body->joint_shapes);
    const cJSON **item = hg_alloc((size_t)count, sizeof *item); /* of a taken joint */
    uint8_t *used = hg_alloc((size_t)m->mesh->vertices, 1);
    hg_status status =
        body->joint_name && body->parent && body->joint && body->joint_shapes && item && used ? HG_OK : HG_MEMORY;
    if (status == HG_OK) {
        item[0] = root;
        status = take_joint(m, root, -1, used);
    }
    for (int at = 0; status == HG_OK && at >= 0;) {
        /* the next child of `at` that has not been taken; else back to its parent */
        const cJSON *next = NULL;
        cJSON_ArrayForEach(bone, m->rig)
        {
            const char *parent = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(bone, "parent"));
            if (!next && strcmp(parent, item[at]->string) == 0 && find_joint(body, bone->string) < 0) next = bone;
        }
        if (!next) {
            at = body->parent[at];
        } else if (body->joints == count) {
            status = rig_fail(m, next, "there twice");
        } else {
            item[body->joints] = next;
            status = take_joint(m, next, at, used);
            at = (int)body->joints - 1;
        }
    }
    if (status == HG_OK && body->joints < count) cJSON_ArrayForEach(bone, m->rig)
        {
            if (status == HG_OK && find_joint(body, bone->string) < 0)
                status = rig_fail(m, bone, "its parents do not lead to the root");
        }
    if (status == HG_OK && body->joints < count) status = hg_fail(HG_FORMAT, "%s: a bone is there twice", m->rig_path);
    hg_free(item);
    hg_free(used);
    return status;
}

/* ---- weights ------------------------------------------------------------------------------------------------- */

static hg_status read_weights(maker *m)
{
    hg_body *body = m->body;
    const cJSON *all = cJSON_GetObjectItemCaseSensitive(m->weights, "weights"), *bone, *pair;
    if (!cJSON_IsObject(all)) return hg_fail(HG_FORMAT, "%s: no object \"weights\"", m->weights_path);
    size_t n = (size_t)body->vertices;
    body->influence = hg_alloc(n, HG_INFLUENCES * sizeof *body->influence);
    body->weight = hg_alloc(n, HG_INFLUENCES * sizeof *body->weight);
    if (!body->influence || !body->weight) return HG_MEMORY;
    cJSON_ArrayForEach(bone, all)
    {
        int joint = find_joint(body, bone->string);
        if (joint < 0)
            return hg_fail(HG_FORMAT, "%s: weights of a bone \"%s\" that the rig does not have", m->weights_path,
                           bone->string);
        cJSON_ArrayForEach(pair, bone)
        {
            const cJSON *vertex = cJSON_GetArrayItem(pair, 0), *weight = cJSON_GetArrayItem(pair, 1);
            if (!cJSON_IsNumber(vertex) || !cJSON_IsNumber(weight) ||
                !(vertex->valuedouble >= 0 && vertex->valuedouble < (double)m->mesh->vertices) ||
                !(weight->valuedouble >= 0 && weight->valuedouble <= 1e6))
                return hg_fail(HG_FORMAT, "%s: bone \"%s\": an entry is not [vertex of base.obj, weight from 0]",
                               m->weights_path, bone->string);
            int64_t v = m->number[(int64_t)vertex->valuedouble];
            if (v >= 0)
                skin_add(body->influence + v * HG_INFLUENCES, body->weight + v * HG_INFLUENCES, joint,
                         (float)weight->valuedouble);
        }
    }
    return skin_normalise(m->weights_path, body, m->vertex);
}

/* ---- scalp --------------------------------------------------------------------------------------------------- */

static double joint_weight(const hg_body *body, int64_t vertex, int joint)
{
    double sum = 0;
    for (int i = 0; i < HG_INFLUENCES; i++)
        if (body->influence[vertex * HG_INFLUENCES + i] == joint)
            sum += (double)body->weight[vertex * HG_INFLUENCES + i];
    return sum;
}

/* Whole polygons within 116 degrees of an axis through the crown, on the head bone, without the ears (small polygons
 * at the side of the head). */
static bool is_scalp(const maker *m, int64_t first, int64_t last, int head)
{
    const hg_body *body = m->body;
    const double axis_angle = 35 * 3.14159265358979323846 / 180, widest = cos(116 * 3.14159265358979323846 / 180);
    hg_vec3d axis = hg_vec3d_make(0, cos(axis_angle), -sin(axis_angle)), from = hg_vec3d_load(body->scalp_centre);
    hg_vec3d centre = { 0, 0, 0 };
    double area = 0, least = 1;
    int corners = 0;
    for (int64_t f = first; f < last; f++) {
        const int32_t *t = body->triangles + 3 * f;
        hg_vec3d p[3];
        for (int k = 0; k < 3; k++) {
            p[k] = hg_vec3d_load(m->neutral + 3 * (int64_t)m->vertex[t[k]]);
            if (f > first && k < 2) continue; /* of the next triangle of a fan only the last corner is new */
            centre = hg_vec3d_add(centre, p[k]);
            least = fmin(least, joint_weight(body, t[k], head));
            corners++;
        }
        area += 0.5 * hg_vec3d_norm(hg_vec3d_cross(hg_vec3d_sub(p[1], p[0]), hg_vec3d_sub(p[2], p[0])));
    }
    centre = hg_vec3d_scale(centre, 1.0 / corners);
    hg_vec3d seen = hg_vec3d_normalize(hg_vec3d_sub(centre, from));
    bool ear = fabs(centre.x) > 0.055 && centre.y < 0.79 && centre.z > -0.01 && centre.z < 0.09 && area < 0.32e-4;
    return hg_vec3d_dot(seen, axis) > widest && least > 0.3 && centre.y > 0.65 && !ear;
}

static hg_status find_scalp(maker *m)
{
    hg_body *body = m->body;
    const double axis_angle = 35 * 3.14159265358979323846 / 180;
    int head = find_joint(body, "Head");
    if (head < 0) head = find_joint(body, "head"); /* of rigs for games */
    if (head < 0) return hg_fail(HG_FORMAT, "%s: no bone \"Head\", on which the scalp would be", m->rig_path);
    body->scalp_axis[1] = cos(axis_angle);
    body->scalp_axis[2] = -sin(axis_angle);
    body->scalp_centre[1] = 0.7705;
    body->scalp_centre[2] = 0.042;
    body->scalp = hg_alloc((size_t)body->faces, sizeof *body->scalp);
    if (!body->scalp) return HG_MEMORY;
    for (int64_t first = 0, last; first < body->faces; first = last) {
        for (last = first + 1; last < body->faces && m->polygon[last] == m->polygon[first];) last++;
        if (!is_scalp(m, first, last, head)) continue;
        for (int64_t f = first; f < last; f++) body->scalp[body->scalp_faces++] = (int32_t)f;
    }
    if (body->scalp_faces == 0)
        return hg_fail(HG_FORMAT,
                       "%s/makehuman/base.obj: no face where the scalp should be; is this the MakeHuman base mesh?",
                       m->folder);
    for (int64_t i = 0; body->uv && i < 3 * body->scalp_faces; i++) {
        int64_t v = body->triangles[3 * (int64_t)body->scalp[i / 3] + i % 3];
        hg_scalp_project(body, body->points + 3 * v, body->uv + 2 * v);
    }
    return HG_OK;
}

/* ---- all together -------------------------------------------------------------------------------------------- */

static hg_status make(maker *m)
{
    char *path = hg_format("%s/makehuman/base.obj", m->folder);
    hg_status status = path ? hg_mesh_read_obj(&m->mesh, path) : HG_MEMORY;
    hg_free(path);
    HG_TRY(status);
    HG_TRY(find_body_group(m));
    HG_TRY(read_json(&m->rig, m->rig_path));
    HG_TRY(read_json(&m->weights, m->weights_path));
    HG_TRY(read_shapes(m));
    HG_TRY(take_body_group(m));
    HG_TRY(read_rig(m));
    HG_TRY(read_weights(m));
    HG_TRY(find_scalp(m));
    return skin_find_collider(m->folder, m->body);
}

hg_status hg_body_read_makehuman(hg_ctx *ctx, hg_body **body, const char *folder, const char *rig)
{
    (void)ctx;
    *body = NULL;
    maker m = { .folder = folder, .body = hg_alloc(1, sizeof *m.body) };
    m.rig_path = hg_format("%s/mpfb2/rig.%s.json", folder, rig);
    m.weights_path = hg_format("%s/mpfb2/weights.%s.json", folder, rig);
    hg_status status = m.body && m.rig_path && m.weights_path ? make(&m) : HG_MEMORY;
    hg_mesh_destroy(m.mesh);
    hg_free(m.neutral);
    for (int k = 0; k < HG_SHAPES; k++) hg_free(m.direction[k]);
    hg_free(m.number);
    hg_free(m.vertex);
    hg_free(m.polygon);
    cJSON_Delete(m.rig);
    cJSON_Delete(m.weights);
    hg_free(m.rig_path);
    hg_free(m.weights_path);
    if (status == HG_OK)
        *body = m.body;
    else
        hg_body_destroy(m.body);
    return status;
}

static hg_status read_folder(hg_ctx *ctx, hg_body **body, const char *folder, const hg_import *with, hg_text *notes)
{
    (void)notes;
    if (with->scalp || with->unit > 0 || with->up)
        return hg_fail(HG_INVALID, "%s: scalp, unit and axes of the MakeHuman body are known: no --scalp, --unit, --up",
                       folder);
    return hg_body_read_makehuman(ctx, body, folder, with->rig ? with->rig : "cmu_mb");
}

static const hg_body_reader reader = { .extension = "",
                                       .what = "MakeHuman base mesh with an MPFB rig",
                                       .read = read_folder };
HG_REGISTER("body reader", makehuman, &reader);
