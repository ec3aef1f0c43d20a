/* The skeleton of a glTF file: the joints of all skins that meshes use, as they rest. */
#include "scene/gltf.h"

#include <stdio.h>
#include <string.h>

enum { MOST_JOINTS = 256 };

void gltf_rig_free(gltf_rig *rig)
{
    if (rig->name) hg_texts_free(rig->name, rig->joints);
    hg_free(rig->node);
    hg_free(rig->parent);
    hg_free(rig->bind);
    hg_free(rig->joint_of_node);
    hg_free(rig->place);
    memset(rig, 0, sizeof *rig);
}

static hg_status joint_node(const gltf_file *file, int skin, const cJSON *item, int *node)
{
    double number = cJSON_IsNumber(item) ? item->valuedouble : -1;
    if (!(number >= 0 && number < file->n_nodes) || number != (double)(int)number)
        return gltf_fail(file, "skins[%d]: a joint is none of the %d nodes", skin, file->n_nodes);
    *node = (int)number;
    return HG_OK;
}

/* Which skins belong to a mesh; which nodes are joints of those. */
static hg_status mark(const gltf_file *file, bool *used, bool *is_joint)
{
    int skins = gltf_count(file, "skins"), i = 0;
    bool any = false;
    const cJSON *node, *joint;
    cJSON_ArrayForEach(node, cJSON_GetObjectItemCaseSensitive(file->json, "nodes"))
    {
        int64_t skin, mesh;
        char where[32];
        snprintf(where, sizeof where, "nodes[%d]", i++);
        HG_TRY(gltf_integer(file, node, where, "skin", -1, 0, skins, &skin));
        HG_TRY(gltf_integer(file, node, where, "mesh", -1, 0, gltf_count(file, "meshes"), &mesh));
        if (skin >= 0 && mesh >= 0) used[skin] = any = true;
    }
    for (int s = 0; s < skins; s++) {
        if (any && !used[s]) continue;
        used[s] = true; /* a file of a skeleton without a mesh: all */
        const cJSON *joints = cJSON_GetObjectItemCaseSensitive(gltf_item(file, "skins", s), "joints");
        if (cJSON_GetArraySize(joints) < 1) return gltf_fail(file, "skins[%d]: it has no joints", s);
        cJSON_ArrayForEach(joint, joints)
        {
            int n = 0;
            HG_TRY(joint_node(file, s, joint, &n));
            is_joint[n] = true;
        }
    }
    return HG_OK;
}

static bool known(char *const *names, int n, const char *name)
{
    for (int i = 0; i < n; i++)
        if (names[i] && strcmp(names[i], name) == 0) return true;
    return false;
}

static char *own_name(const gltf_rig *rig, const gltf_node *node, int number)
{
    char *name = node->name && *node->name ? hg_strdup(node->name) : hg_format("joint_%d", number);
    for (int again = 2; name && known(rig->name, rig->joints, name); again++) {
        char *longer = hg_format("%.200s_%d", node->name && *node->name ? node->name : "joint", again);
        hg_free(name);
        name = longer;
    }
    return name;
}

/* Joints in the order of the tree; above several that have none above them, one more. */
static hg_status collect(const gltf_file *file, const bool *is_joint, gltf_rig *rig)
{
    int tops = 0, count = 0;
    int *above = hg_alloc((size_t)file->n_nodes + 1, sizeof *above); /* the joint that a node or its ancestors are */
    if (!above) return HG_MEMORY;
    for (int i = 0; i < file->n_nodes; i++) {
        int node = file->order[i], parent = file->node[node].parent;
        int joint = parent >= 0 ? above[parent] : -1;
        tops += is_joint[node] && joint < 0;
        count += is_joint[node];
        above[node] = is_joint[node] ? node : joint;
    }
    hg_status status = HG_OK;
    if (count < 1) status = gltf_fail(file, "no skin: a body needs joints and weights");
    if (count >= MOST_JOINTS) status = gltf_fail(file, "%d joints; at most %d are read", count, MOST_JOINTS - 1);
    if (status == HG_OK) {
        size_t room = (size_t)count + 1;
        rig->node = hg_alloc(room, sizeof *rig->node);
        rig->parent = hg_alloc(room, sizeof *rig->parent);
        rig->name = hg_alloc(room, sizeof *rig->name);
        rig->bind = hg_alloc(room, sizeof *rig->bind);
        if (!rig->node || !rig->parent || !rig->name || !rig->bind) status = HG_MEMORY;
    }
    if (status == HG_OK && tops > 1) {
        rig->node[0] = rig->parent[0] = -1;
        if (!(rig->name[0] = hg_strdup("skeleton_root"))) status = HG_MEMORY;
        rig->joints = 1;
    }
    for (int i = 0; status == HG_OK && i < file->n_nodes; i++) {
        int node = file->order[i], parent = file->node[node].parent, joint = parent >= 0 ? above[parent] : -1;
        if (!is_joint[node]) continue;
        int j = rig->joints;
        rig->node[j] = node;
        rig->parent[j] = joint >= 0 ? rig->joint_of_node[joint] : tops > 1 ? 0 : -1;
        rig->joint_of_node[node] = j;
        if (!(rig->name[j] = own_name(rig, file->node + node, j))) status = HG_MEMORY;
        rig->joints++;
    }
    hg_free(above);
    return status;
}

/* Where the joints of a skin rest: at bind time a joint stood at place * inverse(inverse bind matrix), with one place
 * for all of them. The nodes as the file has them show it, if they stand at rest; else the top joint's is taken. */
static hg_status bind_skin(const gltf_file *file, int skin, const gltf_affine *global, gltf_rig *rig, bool *bound)
{
    const cJSON *json = gltf_item(file, "skins", skin), *joints = cJSON_GetObjectItemCaseSensitive(json, "joints"),
                *item;
    int64_t accessor, count = 0;
    int n = cJSON_GetArraySize(joints), i = 0, top = -1;
    double *matrices = NULL;
    char where[32];
    snprintf(where, sizeof where, "skins[%d]", skin);
    HG_TRY(gltf_integer(file, json, where, "inverseBindMatrices", -1, 0, INT32_MAX, &accessor));
    if (accessor >= 0) HG_TRY(gltf_read(file, accessor, 16, &count, &matrices));
    if (matrices && count < n) {
        hg_free(matrices);
        return gltf_fail(file, "%s: %lld inverse bind matrices for %d joints", where, (long long)count, n);
    }
    gltf_affine *inverse = hg_alloc((size_t)n, sizeof *inverse), *rest = hg_alloc((size_t)n, sizeof *rest),
                place = { 0 };
    int *node = hg_alloc((size_t)n, sizeof *node);
    hg_status status = inverse && rest && node ? HG_OK : HG_MEMORY;
    cJSON_ArrayForEach(item, joints)
    {
        if (status != HG_OK) break;
        status = joint_node(file, skin, item, &node[i]);
        inverse[i] = gltf_top(&(scene_axes){ .scale = 1 });
        for (int r = 0; matrices && r < 3; r++)
            for (int c = 0; c < 4; c++) inverse[i].m[4 * r + c] = matrices[16 * i + 4 * c + r];
        if (status == HG_OK && !gltf_invert(inverse + i, rest + i))
            status = gltf_fail(file, "%s: the inverse bind matrix of joint %d has no inverse", where, i);
        if (status == HG_OK && (top < 0 || rig->joint_of_node[node[i]] < rig->joint_of_node[node[top]])) top = i;
        i++;
    }
    if (status == HG_OK) {
        place = gltf_multiply(global + node[top], inverse + top);
        double size = 0, apart = 0, way = 0;
        for (int k = 0; k < 12; k++)
            if (k % 4 < 3) size = fmax(size, fabs(place.m[k]));
        for (int j = 0; j < n; j++) {
            gltf_affine other = gltf_multiply(global + node[j], inverse + j);
            for (int k = 0; k < 12; k++) {
                if (k % 4 < 3)
                    apart = fmax(apart, fabs(other.m[k] - place.m[k]));
                else
                    way = fmax(way, fabs(other.m[k] - place.m[k]));
            }
        }
        rig->posed |= apart > 1e-3 * size || way > 1e-3;
        rig->place[skin] = place;
    }
    for (int j = 0; status == HG_OK && j < n; j++) {
        int joint = rig->joint_of_node[node[j]];
        if (bound[joint]) continue;
        bound[joint] = true;
        rig->bind[joint] = gltf_multiply(&place, rest + j);
        for (int k = 0; k < 12; k++)
            if (!isfinite(rig->bind[joint].m[k])) status = gltf_fail(file, "%s: joint %d rests nowhere", where, j);
    }
    hg_free(matrices);
    hg_free(inverse);
    hg_free(rest);
    hg_free(node);
    return status;
}

hg_status gltf_rig_create(const gltf_file *file, const gltf_affine *top, gltf_rig *rig)
{
    int skins = gltf_count(file, "skins");
    memset(rig, 0, sizeof *rig);
    rig->skins = skins;
    rig->place = hg_alloc((size_t)skins + 1, sizeof *rig->place);
    rig->joint_of_node = hg_alloc((size_t)file->n_nodes + 1, sizeof *rig->joint_of_node);
    bool *used = hg_alloc((size_t)skins + 1, 1), *is_joint = hg_alloc((size_t)file->n_nodes + 1, 1), *bound = NULL;
    gltf_affine *global = hg_alloc((size_t)file->n_nodes + 1, sizeof *global);
    hg_status status = rig->place && rig->joint_of_node && used && is_joint && global ? HG_OK : HG_MEMORY;
    for (int i = 0; status == HG_OK && i < file->n_nodes; i++) rig->joint_of_node[i] = -1;
    if (status == HG_OK) status = mark(file, used, is_joint);
    if (status == HG_OK) status = collect(file, is_joint, rig);
    if (status == HG_OK && !(bound = hg_alloc((size_t)rig->joints, 1))) status = HG_MEMORY;
    if (status == HG_OK) gltf_globals(file, file->node, top, global);
    for (int s = 0; status == HG_OK && s < skins; s++)
        if (used[s]) status = bind_skin(file, s, global, rig, bound);
    if (status == HG_OK && rig->node[0] < 0) { /* the added root stands under its first child, on the floor */
        rig->bind[0] = gltf_top(&(scene_axes){ .scale = 1 });
        rig->bind[0].m[3] = rig->bind[1].m[3], rig->bind[0].m[11] = rig->bind[1].m[11];
    }
    hg_free(used);
    hg_free(is_joint);
    hg_free(bound);
    hg_free(global);
    if (status != HG_OK) gltf_rig_free(rig);
    return status;
}
