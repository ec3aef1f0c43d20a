/* A body from glTF 2.0 (.gltf, .glb): all skinned meshes of the file as one, with the joints of their skins, and morph
 * targets as shapes. Vertices that differ only in normal or texture coordinates (seams) are joined, so that the surface
 * is closed where the artist's was. Materials, normals, cameras and lights are passed over. */
#include "scene/gltf.h"
#include "scene/skin.h"

#include <stdio.h>
#include <string.h>

#define SPREAD 0.3 /* of morph targets, which mean 0 to 1 */

typedef struct {
    float point[3], weight[HG_INFLUENCES], shape[HG_SHAPES][3];
    int32_t joint[HG_INFLUENCES];
} record; /* what vertices are compared by: no padding */

typedef struct {
    const gltf_file *file;
    const gltf_affine *global;
    gltf_rig *rig;
    int64_t vertices, vertex_room, corners, corner_room;
    record *vertex;
    float *uv;
    int32_t *corner; /* three a face */
    bool any_uv;
    char *shape[HG_SHAPES];
    int shapes, more_shapes, loose, other_modes;
} builder;

static hg_status grow(void **array, int64_t *room, int64_t count, size_t size)
{
    if (count <= *room) return HG_OK;
    int64_t larger = count + count / 2 + 256;
    void *bigger = hg_resize(*array, (size_t)*room, (size_t)larger, size);
    if (!bigger) return HG_MEMORY;
    *array = bigger;
    *room = larger;
    return HG_OK;
}

/* An attribute of a primitive as numbers [count, components]; NULL where it has none. */
static hg_status read_attribute(const builder *b, const cJSON *attributes, const char *where, const char *name,
                                int components, int64_t expected, double **numbers)
{
    int64_t accessor, count;
    *numbers = NULL;
    HG_TRY(gltf_integer(b->file, attributes, where, name, -1, 0, INT32_MAX, &accessor));
    if (accessor < 0) return HG_OK;
    HG_TRY(gltf_read(b->file, accessor, components, &count, numbers));
    if (count == expected) return HG_OK;
    hg_free(*numbers);
    *numbers = NULL;
    return gltf_fail(b->file, "%s: %s has %lld elements for %lld vertices", where, name, (long long)count,
                     (long long)expected);
}

/* ---- weights ------------------------------------------------------------------------------------------------- */

static hg_status take_weights(builder *b, const cJSON *attributes, const char *where, const cJSON *joints,
                              int64_t first, int64_t n)
{
    int known = cJSON_GetArraySize(joints), *joint = hg_alloc((size_t)known + 1, sizeof *joint), i = 0;
    if (!joint) return HG_MEMORY;
    const cJSON *item;
    cJSON_ArrayForEach(item, joints) joint[i++] = b->rig->joint_of_node[item->valueint]; /* checked by the rig */
    hg_status status = HG_OK;
    for (int set = 0; status == HG_OK && set < 2; set++) {
        char joints_name[32], weights_name[32];
        double *numbers = NULL, *weights = NULL;
        snprintf(joints_name, sizeof joints_name, "JOINTS_%d", set);
        snprintf(weights_name, sizeof weights_name, "WEIGHTS_%d", set);
        status = read_attribute(b, attributes, where, joints_name, 4, n, &numbers);
        if (status == HG_OK) status = read_attribute(b, attributes, where, weights_name, 4, n, &weights);
        if (status == HG_OK && set == 0 && (!numbers || !weights))
            status = gltf_fail(b->file, "%s: a skinned mesh without JOINTS_0 and WEIGHTS_0", where);
        for (int64_t k = 0; status == HG_OK && numbers && weights && k < 4 * n; k++) {
            record *v = b->vertex + first + k / 4;
            if (!(weights[k] >= 0))
                status = gltf_fail(b->file, "%s: vertex %lld has a negative weight", where, (long long)(k / 4));
            else if (weights[k] > 0 && !(numbers[k] >= 0 && numbers[k] < known))
                status = gltf_fail(b->file, "%s: vertex %lld follows joint %g; the skin has %d", where,
                                   (long long)(k / 4), numbers[k], known);
            else if (weights[k] > 0)
                skin_add(v->joint, v->weight, joint[(int)numbers[k]], (float)weights[k]);
        }
        hg_free(numbers);
        hg_free(weights);
    }
    hg_free(joint);
    return status;
}

/* ---- shapes -------------------------------------------------------------------------------------------------- */

/* Targets of the same name in several meshes are one shape. -1: there is no place for another. */
static hg_status shape_number(builder *b, const char *name, int target, int *number)
{
    char own[96];
    snprintf(own, sizeof own, "%.80s", name ? name : "morph");
    if (!name) snprintf(own, sizeof own, "morph_%d", target);
    for (*number = 0; *number < b->shapes; (*number)++)
        if (strcmp(b->shape[*number], own) == 0) return HG_OK;
    if (b->shapes == HG_SHAPES) {
        b->more_shapes++;
        *number = -1;
        return HG_OK;
    }
    if (!(b->shape[b->shapes] = hg_strdup(own))) return HG_MEMORY;
    b->shapes++;
    return HG_OK;
}

static hg_status take_shapes(builder *b, const cJSON *mesh, const cJSON *primitive, const char *where,
                             const gltf_affine *place, int64_t first, int64_t n)
{
    const cJSON *names =
                    cJSON_GetObjectItemCaseSensitive(cJSON_GetObjectItemCaseSensitive(mesh, "extras"), "targetNames"),
                *target;
    int t = 0;
    cJSON_ArrayForEach(target, cJSON_GetObjectItemCaseSensitive(primitive, "targets"))
    {
        double *way;
        int shape;
        HG_TRY(shape_number(b, cJSON_GetStringValue(cJSON_GetArrayItem(names, t)), t, &shape));
        t++;
        if (shape < 0) continue;
        HG_TRY(read_attribute(b, target, where, "POSITION", 3, n, &way));
        for (int64_t v = 0; way && v < n; v++) {
            hg_vec3d d = gltf_direction(place, hg_vec3d_load(way + 3 * v));
            scene_put(b->vertex[first + v].shape[shape], d);
        }
        hg_free(way);
    }
    return HG_OK;
}

/* ---- meshes -------------------------------------------------------------------------------------------------- */

static hg_status take_corners(builder *b, const cJSON *primitive, const char *where, int64_t mode, bool mirrored,
                              int64_t first, int64_t n)
{
    int64_t accessor, count = n;
    double *indices = NULL;
    HG_TRY(gltf_integer(b->file, primitive, where, "indices", -1, 0, INT32_MAX, &accessor));
    if (accessor >= 0) HG_TRY(gltf_read(b->file, accessor, 1, &count, &indices));
    int64_t faces = mode == 4 ? count / 3 : count - 2;
    hg_status status =
        grow((void **)&b->corner, &b->corner_room, b->corners + 3 * (faces > 0 ? faces : 0), sizeof *b->corner);
    for (int64_t f = 0; status == HG_OK && f < faces; f++) {
        int64_t at[3] = { 3 * f, 3 * f + 1, 3 * f + 2 };
        if (mode == 5) at[0] = f, at[1] = f + 1 + f % 2, at[2] = f + 2 - f % 2; /* strip */
        if (mode == 6) at[0] = 0, at[1] = f + 1, at[2] = f + 2;                 /* fan */
        for (int k = 0; k < 3; k++) {
            double index = indices ? indices[at[k]] : (double)at[k];
            if (!(index >= 0 && index < (double)n)) {
                status = gltf_fail(b->file, "%s: index %g at place %lld; there are %lld vertices", where, index,
                                   (long long)at[k], (long long)n);
                break;
            }
            b->corner[b->corners + (mirrored && k ? 3 - k : k)] = (int32_t)(first + (int64_t)index);
        }
        b->corners += 3;
    }
    hg_free(indices);
    return status;
}

/* joints NULL: the mesh is fixed to `bone`. */
static hg_status take_primitive(builder *b, const cJSON *mesh, const cJSON *primitive, const char *where,
                                const gltf_affine *place, const cJSON *joints, int bone)
{
    int64_t mode, accessor, n;
    double *points, *uv;
    HG_TRY(gltf_integer(b->file, primitive, where, "mode", 4, 0, 7, &mode));
    if (mode < 4) {
        b->other_modes++;
        return HG_OK;
    }
    if (cJSON_GetObjectItemCaseSensitive(cJSON_GetObjectItemCaseSensitive(primitive, "extensions"),
                                         "KHR_draco_mesh_compression"))
        return hg_fail(HG_UNSUPPORTED,
                       "%s: %s is packed by KHR_draco_mesh_compression, which is not read; export it without "
                       "compression",
                       b->file->path, where);
    const cJSON *attributes = cJSON_GetObjectItemCaseSensitive(primitive, "attributes");
    HG_TRY(gltf_integer(b->file, attributes, where, "POSITION", -1, 0, INT32_MAX, &accessor));
    if (accessor < 0) return gltf_fail(b->file, "%s: no POSITION", where);
    HG_TRY(gltf_read(b->file, accessor, 3, &n, &points));
    int64_t first = b->vertices, room = b->vertex_room;
    hg_status status =
        first + n > INT32_MAX / HG_INFLUENCES ? gltf_fail(b->file, "more vertices than can be numbered") : HG_OK;
    if (status == HG_OK) status = grow((void **)&b->uv, &room, first + n, 2 * sizeof *b->uv);
    if (status == HG_OK) status = grow((void **)&b->vertex, &b->vertex_room, first + n, sizeof *b->vertex);
    for (int64_t v = 0; status == HG_OK && v < n; v++)
        scene_put(b->vertex[first + v].point, gltf_point(place, hg_vec3d_load(points + 3 * v)));
    hg_free(points);
    HG_TRY(status);
    b->vertices += n;
    if (joints) HG_TRY(take_weights(b, attributes, where, joints, first, n));
    for (int64_t v = 0; !joints && v < n; v++)
        skin_add(b->vertex[first + v].joint, b->vertex[first + v].weight, bone, 1);
    HG_TRY(read_attribute(b, attributes, where, "TEXCOORD_0", 2, n, &uv));
    for (int64_t v = 0; uv && v < n; v++) { /* v grows downwards there */
        b->uv[2 * (first + v)] = (float)uv[2 * v];
        b->uv[2 * (first + v) + 1] = (float)(1 - uv[2 * v + 1]);
    }
    b->any_uv |= uv != NULL;
    hg_free(uv);
    HG_TRY(take_shapes(b, mesh, primitive, where, place, first, n));
    const double *m = place->m;
    double turn =
        m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) + m[2] * (m[4] * m[9] - m[5] * m[8]);
    return take_corners(b, primitive, where, mode, turn < 0, first, n);
}

/* The mesh of a node: moved by its skin, or fixed to the joint that it hangs on; others are left out. */
static hg_status take_node(builder *b, int node, const cJSON *json)
{
    int64_t mesh, skin;
    char where[64];
    snprintf(where, sizeof where, "nodes[%d]", node);
    HG_TRY(gltf_integer(b->file, json, where, "mesh", -1, 0, gltf_count(b->file, "meshes"), &mesh));
    HG_TRY(gltf_integer(b->file, json, where, "skin", -1, 0, gltf_count(b->file, "skins"), &skin));
    if (mesh < 0) return HG_OK;
    gltf_affine place;
    const cJSON *joints = NULL;
    int bone = -1;
    if (skin >= 0) {
        place = b->rig->place[skin];
        joints = cJSON_GetObjectItemCaseSensitive(gltf_item(b->file, "skins", skin), "joints");
    } else {
        int at = node;
        while (at >= 0 && b->rig->joint_of_node[at] < 0) at = b->file->node[at].parent;
        if (at < 0) {
            b->loose++;
            return HG_OK;
        }
        gltf_affine inverse;
        bone = b->rig->joint_of_node[at];
        if (!gltf_invert(b->global + at, &inverse)) return gltf_fail(b->file, "nodes[%d]: it is scaled to nothing", at);
        place = gltf_multiply(&inverse, b->global + node);
        place = gltf_multiply(b->rig->bind + bone, &place);
    }
    const cJSON *object = gltf_item(b->file, "meshes", mesh), *primitive;
    int p = 0;
    cJSON_ArrayForEach(primitive, cJSON_GetObjectItemCaseSensitive(object, "primitives"))
    {
        snprintf(where, sizeof where, "meshes[%lld].primitives[%d]", (long long)mesh, p++);
        HG_TRY(take_primitive(b, object, primitive, where, &place, joints, bone));
    }
    return HG_OK;
}

/* ---- one surface --------------------------------------------------------------------------------------------- */

static void normalise(record *v)
{
    double sum = 0;
    for (int i = 0; i < HG_INFLUENCES; i++) sum += (double)v->weight[i];
    for (int i = 0; i < HG_INFLUENCES; i++) v->weight[i] = sum > 1e-6 ? (float)((double)v->weight[i] / sum) : 0;
    for (int i = 0; i < 3; i++) v->point[i] += 0.0F; /* -0 is 0 */
    for (int i = 0; i < 3 * HG_SHAPES; i++) v->shape[i / 3][i % 3] += 0.0F;
}

/* Gives vertices that are the same in all that matters one number, in order of appearance. */
static hg_status join(builder *b, int32_t **number, int64_t *kept)
{
    uint64_t slots = 16;
    while (slots < 2 * (uint64_t)b->vertices) slots *= 2;
    int32_t *slot = hg_alloc(slots, sizeof *slot);
    *number = hg_alloc((size_t)b->vertices, sizeof **number);
    *kept = 0;
    if (!slot || !*number) {
        hg_free(slot);
        return HG_MEMORY;
    }
    for (int64_t v = 0; v < b->vertices; v++) {
        normalise(b->vertex + v);
        record held = b->vertex[v];
        uint64_t at = hg_hash(&held, sizeof held, 0) & (slots - 1);
        while (slot[at] && memcmp(b->vertex + slot[at] - 1, &held, sizeof held) != 0) at = (at + 1) & (slots - 1);
        if (!slot[at]) {
            b->vertex[*kept] = held;
            memmove(b->uv + 2 * *kept, b->uv + 2 * v, 2 * sizeof *b->uv);
            slot[at] = (int32_t)++ * kept;
        }
        (*number)[v] = slot[at] - 1;
    }
    hg_free(slot);
    return HG_OK;
}

static hg_status to_body(builder *b, hg_body *body, int64_t *joined, int64_t *flat)
{
    int32_t *number = NULL;
    int64_t kept = 0, faces = 0;
    hg_status status = join(b, &number, &kept);
    for (int64_t f = 0; status == HG_OK && f < b->corners / 3; f++) {
        int32_t c[3];
        for (int k = 0; k < 3; k++) c[k] = number[b->corner[3 * f + k]];
        if (c[0] == c[1] || c[1] == c[2] || c[2] == c[0]) continue;
        memcpy(b->corner + 3 * faces++, c, sizeof c);
    }
    hg_free(number);
    HG_TRY(status);
    *joined = b->vertices - kept;
    *flat = b->corners / 3 - faces;
    if (kept < 3 || faces < 1)
        return gltf_fail(b->file, "%lld vertices and %lld faces are no surface", (long long)kept, (long long)faces);
    body->vertices = kept;
    body->faces = faces;
    body->joints = b->rig->joints;
    HG_TRY(skin_allocate(body));
    if (b->any_uv) {
        body->uv = hg_alloc((size_t)kept, 2 * sizeof *body->uv);
        if (!body->uv) return HG_MEMORY;
        memcpy(body->uv, b->uv, (size_t)kept * 2 * sizeof *body->uv);
    }
    memcpy(body->triangles, b->corner, (size_t)faces * 3 * sizeof *b->corner);
    for (int64_t v = 0; v < kept; v++) {
        const record *from = b->vertex + v;
        memcpy(body->points + 3 * v, from->point, sizeof from->point);
        memcpy(body->weight + HG_INFLUENCES * v, from->weight, sizeof from->weight);
        memcpy(body->influence + HG_INFLUENCES * v, from->joint, sizeof from->joint);
        for (int s = 0; s < HG_SHAPES; s++)
            memcpy(body->shapes + 3 * (s * kept + v), from->shape[s], sizeof from->shape[s]);
    }
    for (int j = 0; j < b->rig->joints; j++) {
        body->parent[j] = b->rig->parent[j];
        const double *m = b->rig->bind[j].m;
        scene_put(body->joint + 3 * j, hg_vec3d_make(m[3], m[7], m[11]));
        if (!(body->joint_name[j] = hg_strdup(b->rig->name[j]))) return HG_MEMORY;
    }
    for (int s = 0; s < b->shapes; s++) body->shape_name[s] = b->shape[s], b->shape[s] = NULL;
    HG_TRY(skin_name_shapes(body, "morph", b->shapes, SPREAD));
    HG_TRY(scene_check_finite(b->file->path, "POSITION", body->points, kept, 3));
    HG_TRY(scene_check_finite(b->file->path, "joints", body->joint, body->joints, 3));
    return skin_normalise(b->file->path, body, NULL);
}

static hg_status make(builder *b, hg_body *body, const hg_import *with, hg_text *notes)
{
    const cJSON *node;
    int i = 0;
    int64_t joined = 0, flat = 0;
    cJSON_ArrayForEach(node, cJSON_GetObjectItemCaseSensitive(b->file->json, "nodes")) HG_TRY(take_node(b, i++, node));
    if (b->vertices == 0 || b->corners == 0)
        return gltf_fail(b->file, "no triangles of a mesh that a skin moves: nothing to be a body");
    HG_TRY(to_body(b, body, &joined, &flat));
    if (notes) {
        if (b->rig->posed)
            hg_text_add(notes, "rest: the nodes of the file do not stand as its skin rests; the skin's rest pose was "
                               "taken, standing where the file has its top joint\n");
        if (b->rig->node[0] < 0) hg_text_add(notes, "joints: several have none above them; skeleton_root was added\n");
        if (joined > 0)
            hg_text_add(notes, "vertices: %lld that differ only in normal or texture coordinates were joined\n",
                        (long long)joined);
        if (flat > 0) hg_text_add(notes, "faces: %lld without area were left out\n", (long long)flat);
        if (b->loose > 0) hg_text_add(notes, "meshes: %d that no joint moves were left out\n", b->loose);
        if (b->other_modes > 0) hg_text_add(notes, "meshes: %d of points or lines were left out\n", b->other_modes);
        if (b->more_shapes > 0)
            hg_text_add(notes, "shapes: the first %d morph targets; others were left out\n", HG_SHAPES);
    }
    HG_TRY(skin_find_collider(b->file->path, body));
    return skin_find_scalp(b->file->path, body, with->scalp, notes);
}

static hg_status read_gltf(hg_ctx *ctx, hg_body **out, const char *path, const hg_import *with, hg_text *notes)
{
    (void)ctx;
    *out = NULL;
    gltf_file *file;
    gltf_rig rig = { 0 };
    scene_axes axes;
    HG_TRY(skin_axes(with, false, &axes));
    HG_TRY(gltf_open(&file, path));
    gltf_affine top = gltf_top(&axes), *global = hg_alloc((size_t)file->n_nodes + 1, sizeof *global);
    hg_body *body = hg_alloc(1, sizeof *body);
    builder b = { .file = file, .global = global, .rig = &rig };
    hg_status status = global && body ? gltf_rig_create(file, &top, &rig) : HG_MEMORY;
    if (status == HG_OK) {
        gltf_globals(file, file->node, &top, global);
        status = make(&b, body, with, notes);
    }
    hg_free(b.vertex);
    hg_free(b.uv);
    hg_free(b.corner);
    for (int s = 0; s < HG_SHAPES; s++) hg_free(b.shape[s]);
    hg_free(global);
    gltf_rig_free(&rig);
    gltf_close(file);
    if (status == HG_OK)
        *out = body;
    else
        hg_body_destroy(body);
    return status;
}

static const hg_body_reader glb = { .extension = "glb", .what = "glTF 2.0, skinned meshes, binary", .read = read_gltf };
HG_REGISTER("body reader", glb, &glb);
static const hg_body_reader gltf = { .extension = "gltf", .what = "glTF 2.0, skinned meshes", .read = read_gltf };
HG_REGISTER("body reader", gltf, &gltf);
