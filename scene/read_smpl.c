/* A body of SMPL's kind (Loper et al. 2015; SMPL-H, SMPL-X) from .npz: template, faces, blend weights, joint regressor,
 * tree, shape directions. Corrective shapes that depend on the pose are not used: skinning is linear here. */
#include "scene/joints.h"
#include "scene/npz.h"
#include "scene/skin.h"

#include <string.h>

#define SPREAD 0.5 /* betas are counted in deviations of the model's people; 95 % of samples then lie within 1 */

static const char *const template_names[] = { "v_template", "vertices", NULL };
static const char *const face_names[] = { "f", "faces", NULL };
static const char *const weight_names[] = { "weights", "blend_weights", "lbs_weights", NULL };
static const char *const joint_names[] = { "J", "joints", NULL };
static const char *const name_names[] = { "joint_names", "joint_name", NULL };

static const char *first_of(const npz_file *file, const char *const *names)
{
    for (; *names; names++)
        if (npz_find(file, *names)) return *names;
    return NULL;
}

static hg_status read_mesh(const npz_file *file, hg_body *b, float **points, int32_t **triangles, int64_t *joints)
{
    int64_t shape[2];
    const char *name = first_of(file, template_names), *faces = first_of(file, face_names),
               *weights = first_of(file, weight_names);
    HG_TRY(npz_read(file, name ? name : "v_template", HG_F32, 2, (int64_t[]){ -1, 3 }, shape, (void **)points));
    b->vertices = shape[0];
    HG_TRY(npz_read(file, faces ? faces : "f", HG_I32, 2, (int64_t[]){ -1, 3 }, shape, (void **)triangles));
    b->faces = shape[0];
    if (b->vertices < 3 || b->vertices > INT32_MAX / HG_INFLUENCES || b->faces < 1 || b->faces > INT32_MAX / 3)
        return hg_fail(HG_FORMAT, "%s: %lld vertices and %lld faces are no surface", file->path, (long long)b->vertices,
                       (long long)b->faces);
    const npz_array *w = npz_find(file, weights ? weights : "weights");
    *joints = w && w->rank == 2 ? w->shape[1] : 0;
    if (w && (*joints < 1 || *joints > 1024))
        return hg_fail(HG_FORMAT, "%s: array \"%s\": expected [N,J] with 1 to 1024 joints", file->path, w->name);
    HG_TRY(scene_check_finite(file->path, "v_template", *points, b->vertices, 3));
    return scene_check_range(file->path, "f", *triangles, b->faces * 3, 0, b->vertices);
}

static hg_status read_weights(const npz_file *file, hg_body *b, hg_text *notes)
{
    const char *name = first_of(file, weight_names);
    float *weights;
    int64_t cut = 0, shape[2] = { b->vertices, b->joints };
    double most = 0;
    name = name ? name : "weights";
    HG_TRY(npz_read(file, name, HG_F32, 2, shape, NULL, (void **)&weights));
    hg_status status = scene_check_finite(file->path, name, weights, b->vertices, b->joints);
    for (int64_t v = 0; status == HG_OK && v < b->vertices; v++) {
        const float *row = weights + v * b->joints;
        double sum = 0, kept = 0;
        for (int64_t j = 0; j < b->joints; j++) {
            if (row[j] < -1e-6F)
                status = hg_fail(HG_FORMAT, "%s: array \"%s\": vertex %lld has a negative weight", file->path, name,
                                 (long long)v);
            if (row[j] <= 0) continue;
            sum += (double)row[j];
            skin_add(b->influence + v * HG_INFLUENCES, b->weight + v * HG_INFLUENCES, (int)j, row[j]);
        }
        for (int i = 0; i < HG_INFLUENCES; i++) kept += (double)b->weight[v * HG_INFLUENCES + i];
        cut += sum - kept > 1e-4 * sum;
        if (sum > 0) most = fmax(most, (sum - kept) / sum);
    }
    hg_free(weights);
    if (status == HG_OK) status = skin_normalise(file->path, b, NULL);
    if (status == HG_OK && cut > 0 && notes)
        hg_text_add(notes,
                    "weights: %lld vertices follow more than %d joints; the smallest were left out, %.2f %% at most\n",
                    (long long)cut, HG_INFLUENCES, 100 * most);
    return status;
}

/* ---- joints -------------------------------------------------------------------------------------------------- */

static hg_status read_parents(const npz_file *file, hg_body *b)
{
    int64_t *tree, shape[2] = { 2, b->joints };
    const char *name = npz_find(file, "kintree_table") ? "kintree_table" : "parents";
    if (strcmp(name, "parents") == 0 && !npz_find(file, name) && joints_smpl_parents(b->joints)) {
        memcpy(b->parent, joints_smpl_parents(b->joints), (size_t)b->joints * sizeof *b->parent);
        return HG_OK;
    }
    const npz_array *a = npz_find(file, name);
    if (a && a->rank == 1)
        HG_TRY(npz_read_i64(file, name, 1, shape + 1, NULL, &tree));
    else
        HG_TRY(npz_read_i64(file, name, 2, shape, NULL, &tree));
    hg_status status = HG_OK;
    b->parent[0] = -1; /* files say -1, 2^32 - 1 or the joint itself */
    for (int64_t j = 1; status == HG_OK && j < b->joints; j++) {
        if (tree[j] < 0 || tree[j] >= j)
            status = hg_fail(HG_FORMAT, "%s: array \"%s\": joint %lld has the parent %lld, expected a joint before it",
                             file->path, name, (long long)j, (long long)tree[j]);
        b->parent[j] = (int32_t)tree[j];
    }
    hg_free(tree);
    return status;
}

static hg_status read_names(const npz_file *file, hg_body *b, hg_text *notes)
{
    const char *name = first_of(file, name_names);
    const char *const *known = joints_smpl(b->joints);
    char **texts = NULL;
    int n = 0;
    if (name && npz_find(file, name)->type != 'O') {
        HG_TRY(npz_read_texts(file, name, &n, &texts));
        if (n < b->joints) { /* SMPL-X lists landmarks behind the joints */
            hg_texts_free(texts, n);
            return hg_fail(HG_FORMAT, "%s: array \"%s\" has %d names for %lld joints", file->path, name, n,
                           (long long)b->joints);
        }
    }
    hg_status status = HG_OK;
    for (int64_t j = 0; status == HG_OK && j < b->joints; j++) {
        b->joint_name[j] = texts   ? hg_strdup(texts[j])
                           : known ? hg_strdup(known[j])
                                   : hg_format("joint_%lld", (long long)j);
        if (!b->joint_name[j]) status = HG_MEMORY;
    }
    if (texts) hg_texts_free(texts, n);
    if (status == HG_OK && !texts && !known && notes)
        hg_text_add(notes,
                    "joints: %lld, which is not SMPL (24), SMPL-H (52) or SMPL-X (55), and no joint_names: called "
                    "joint_0...\n",
                    (long long)b->joints);
    return status;
}

/* The joint regressor as a list of (joint, vertex, weight), from a dense array or from the parts of a sparse one. */
typedef struct {
    int64_t n;
    int64_t *joint, *vertex;
    double *weight;
} regressor;

static void regressor_free(regressor *r)
{
    hg_free(r->joint);
    hg_free(r->vertex);
    hg_free(r->weight);
}

static hg_status dense_regressor(const npz_file *file, const hg_body *b, regressor *r)
{
    double *dense;
    HG_TRY(npz_read(file, "J_regressor", HG_F64, 2, (int64_t[]){ b->joints, b->vertices }, NULL, (void **)&dense));
    int64_t count = b->joints * b->vertices;
    for (int64_t i = 0; i < count; i++) r->n += dense[i] != 0;
    r->joint = hg_alloc((size_t)r->n + 1, sizeof *r->joint);
    r->vertex = hg_alloc((size_t)r->n + 1, sizeof *r->vertex);
    r->weight = hg_alloc((size_t)r->n + 1, sizeof *r->weight);
    hg_status status = r->joint && r->vertex && r->weight ? HG_OK : HG_MEMORY;
    for (int64_t i = 0, k = 0; status == HG_OK && i < count; i++) {
        if (dense[i] == 0) continue;
        r->joint[k] = i / b->vertices, r->vertex[k] = i % b->vertices, r->weight[k++] = dense[i];
    }
    hg_free(dense);
    return status;
}

/* "J_regressor" and a part of SciPy's sparse matrices, with "_" or "." between. */
static const char *part_name(const npz_file *file, const char *part, char name[64])
{
    for (const char *between = "_."; *between; between++) {
        strcpy(name, "J_regressor");
        name[11] = *between;
        strcpy(name + 12, part);
        if (npz_find(file, name)) return name;
    }
    return NULL;
}

/* indptr of rows (CSR, [J+1]) or of columns (CSC, [N+1]) to a number per entry. */
static hg_status expand(const npz_file *file, const char *name, const int64_t *pointers, int64_t rows, int64_t n,
                        int64_t **numbers)
{
    *numbers = hg_alloc((size_t)n + 1, sizeof **numbers);
    if (!*numbers) return HG_MEMORY;
    for (int64_t i = 0; i < rows; i++) {
        if (pointers[i] < 0 || pointers[i + 1] < pointers[i] || pointers[i + 1] > n || pointers[0] != 0)
            return hg_fail(HG_FORMAT, "%s: array \"%s\": entry %lld does not fit into %lld weights", file->path, name,
                           (long long)i, (long long)n);
        for (int64_t k = pointers[i]; k < pointers[i + 1]; k++) (*numbers)[k] = i;
    }
    return pointers[rows] == n ? HG_OK
                               : hg_fail(HG_FORMAT, "%s: array \"%s\" ends at %lld of %lld weights", file->path, name,
                                         (long long)pointers[rows], (long long)n);
}

static hg_status sparse_regressor(const npz_file *file, const hg_body *b, regressor *r)
{
    char data[64], row[64], column[64], indices[64], indptr[64];
    HG_TRY(npz_read(file, part_name(file, "data", data), HG_F64, 1, (int64_t[]){ -1 }, &r->n, (void **)&r->weight));
    if (part_name(file, "row", row) && part_name(file, "col", column)) {
        HG_TRY(npz_read_i64(file, row, 1, &r->n, NULL, &r->joint));
        return npz_read_i64(file, column, 1, &r->n, NULL, &r->vertex);
    }
    if (!part_name(file, "indices", indices) || !part_name(file, "indptr", indptr))
        return hg_fail(HG_FORMAT, "%s: \"%s\" without J_regressor_indices and _indptr, or _row and _col", file->path,
                       data);
    int64_t rows, *pointers;
    HG_TRY(npz_read_i64(file, indptr, 1, (int64_t[]){ -1 }, &rows, &pointers));
    bool by_joint = rows == b->joints + 1;
    hg_status status = HG_OK;
    if (!by_joint && rows != b->vertices + 1)
        status = hg_fail(HG_FORMAT, "%s: array \"%s\" has %lld entries, expected %lld (rows) or %lld (columns)",
                         file->path, indptr, (long long)rows, (long long)b->joints + 1, (long long)b->vertices + 1);
    if (status == HG_OK) status = expand(file, indptr, pointers, rows - 1, r->n, by_joint ? &r->joint : &r->vertex);
    hg_free(pointers);
    HG_TRY(status);
    return npz_read_i64(file, indices, 1, &r->n, NULL, by_joint ? &r->vertex : &r->joint);
}

static hg_status apply_regressor(const npz_file *file, hg_body *b, const regressor *r, int shapes)
{
    double *sum = hg_alloc((size_t)b->joints, 3 * (1 + HG_SHAPES) * sizeof *sum);
    if (!sum) return HG_MEMORY;
    hg_status status = HG_OK;
    for (int64_t i = 0; status == HG_OK && i < r->n; i++) {
        int64_t j = r->joint[i], v = r->vertex[i];
        if (j < 0 || j >= b->joints || v < 0 || v >= b->vertices || !isfinite(r->weight[i])) {
            status = hg_fail(HG_FORMAT, "%s: J_regressor: entry %lld (joint %lld, vertex %lld) is none", file->path,
                             (long long)i, (long long)j, (long long)v);
            break;
        }
        for (int k = 0; k < 3; k++) {
            sum[3 * j + k] += r->weight[i] * (double)b->points[3 * v + k];
            for (int s = 0; s < shapes; s++)
                sum[3 * (b->joints * (1 + s) + j) + k] +=
                    r->weight[i] * (double)b->shapes[3 * (b->vertices * s + v) + k];
        }
    }
    for (int64_t i = 0; i < 3 * b->joints; i++) b->joint[i] = (float)sum[i];
    for (int64_t i = 0; i < 3 * b->joints * HG_SHAPES; i++) b->joint_shapes[i] = (float)sum[3 * b->joints + i];
    hg_free(sum);
    return status;
}

static hg_status read_joints(const npz_file *file, hg_body *b, int shapes, hg_text *notes)
{
    char name[64];
    regressor r = { 0 };
    hg_status status = HG_OK;
    const npz_array *dense = npz_find(file, "J_regressor");
    bool sparse = part_name(file, "data", name) != NULL, regress = sparse || (dense && dense->type != 'O');
    if (regress) {
        status = sparse ? sparse_regressor(file, b, &r) : dense_regressor(file, b, &r);
        if (status == HG_OK) status = apply_regressor(file, b, &r, shapes);
        regressor_free(&r);
        return status;
    }
    const char *joints = first_of(file, joint_names);
    if (!joints && dense)
        return hg_fail(
            HG_UNSUPPORTED,
            "%s: J_regressor is a pickled object: save it as an array (J_regressor.toarray()), or the joints "
            "as J [J,3]",
            file->path);
    float *places;
    HG_TRY(npz_read(file, joints ? joints : "J_regressor", HG_F32, 2, (int64_t[]){ b->joints, 3 }, NULL,
                    (void **)&places));
    memcpy(b->joint, places, (size_t)b->joints * 3 * sizeof *b->joint);
    hg_free(places);
    if (notes && shapes > 0)
        hg_text_add(notes, "joints: taken from \"%s\"; without a J_regressor they do not follow the shape\n", joints);
    return scene_check_finite(file->path, joints, b->joint, b->joints, 3);
}

/* ---- shapes, UV ---------------------------------------------------------------------------------------------- */

static hg_status read_shapes(const npz_file *file, hg_body *b, int *used, hg_text *notes)
{
    int64_t shape[3];
    float *directions;
    *used = 0;
    const npz_array *a = npz_find(file, "shapedirs");
    if (!a || a->type == 'O') {
        if (notes) hg_text_add(notes, "shapes: no shapedirs%s: the body has one shape\n", a ? " as numbers" : "");
        return HG_OK;
    }
    HG_TRY(npz_read(file, "shapedirs", HG_F32, 3, (int64_t[]){ b->vertices, 3, -1 }, shape, (void **)&directions));
    *used = shape[2] < HG_SHAPES ? (int)shape[2] : HG_SHAPES;
    for (int64_t i = 0; i < 3 * b->vertices; i++)
        for (int s = 0; s < *used; s++) b->shapes[3 * b->vertices * s + i] = directions[i * shape[2] + s];
    hg_free(directions);
    if (notes && shape[2] > HG_SHAPES)
        hg_text_add(notes, "shapes: the first %d of %lld\n", HG_SHAPES, (long long)shape[2]);
    return scene_check_finite(file->path, "shapedirs", b->shapes, HG_SHAPES * b->vertices, 3);
}

static hg_status read_uv(const npz_file *file, hg_body *b)
{
    bool corners = npz_find(file, "vt") && npz_find(file, "ft");
    if (!corners && !npz_find(file, "uv")) return HG_OK;
    if (!corners) {
        HG_TRY(npz_read(file, "uv", HG_F32, 2, (int64_t[]){ b->vertices, 2 }, NULL, (void **)&b->uv));
        return scene_check_finite(file->path, "uv", b->uv, b->vertices, 2);
    }
    int64_t count;
    int32_t *corner = NULL;
    float *uv = NULL;
    int64_t shape[2];
    b->uv = hg_alloc((size_t)b->vertices, 2 * sizeof *b->uv);
    bool *set = hg_alloc((size_t)b->vertices, sizeof *set);
    hg_status status = b->uv && set ? HG_OK : HG_MEMORY;
    if (status == HG_OK) status = npz_read(file, "vt", HG_F32, 2, (int64_t[]){ -1, 2 }, shape, (void **)&uv);
    count = status == HG_OK ? shape[0] : 0;
    if (status == HG_OK) status = npz_read(file, "ft", HG_I32, 2, (int64_t[]){ b->faces, 3 }, NULL, (void **)&corner);
    if (status == HG_OK) status = scene_check_finite(file->path, "vt", uv, count, 2);
    if (status == HG_OK) status = scene_check_range(file->path, "ft", corner, 3 * b->faces, 0, count);
    for (int64_t i = 0; status == HG_OK && i < 3 * b->faces; i++) {
        int32_t v = b->triangles[i];
        if (set[v]) continue;
        set[v] = true;
        memcpy(b->uv + 2 * (int64_t)v, uv + 2 * (int64_t)corner[i], 2 * sizeof *uv);
    }
    hg_free(set);
    hg_free(uv);
    hg_free(corner);
    return status;
}

/* ---- all together -------------------------------------------------------------------------------------------- */

static hg_status make(const npz_file *file, hg_body *b, const hg_import *with, hg_text *notes)
{
    float *points = NULL;
    int32_t *triangles = NULL;
    int shapes = 0;
    scene_axes axes;
    HG_TRY(skin_axes(with, false, &axes));
    hg_status status = read_mesh(file, b, &points, &triangles, &b->joints);
    int64_t joints = b->joints;
    b->joints = 0; /* until there are names to free */
    if (status == HG_OK && joints == 0)
        status = hg_fail(HG_FORMAT, "%s: no array \"weights\" [N,J]: a body needs blend weights", file->path);
    if (status == HG_OK) {
        b->joints = joints;
        status = skin_allocate(b);
    }
    if (status == HG_OK) {
        memcpy(b->points, points, (size_t)b->vertices * 3 * sizeof *points);
        memcpy(b->triangles, triangles, (size_t)b->faces * 3 * sizeof *triangles);
    }
    hg_free(points);
    hg_free(triangles);
    HG_TRY(status);
    HG_TRY(read_parents(file, b));
    HG_TRY(read_names(file, b, notes));
    HG_TRY(read_weights(file, b, notes));
    HG_TRY(read_shapes(file, b, &shapes, notes));
    HG_TRY(skin_name_shapes(b, "beta", shapes, SPREAD));
    HG_TRY(read_joints(file, b, shapes, notes));
    HG_TRY(scene_check_finite(file->path, "J_regressor times v_template", b->joint, b->joints, 3));
    HG_TRY(read_uv(file, b));
    scene_axes_points(&axes, b->points, b->vertices);
    scene_axes_points(&axes, b->joint, b->joints);
    scene_axes_points(&axes, b->shapes, HG_SHAPES * b->vertices);
    scene_axes_points(&axes, b->joint_shapes, HG_SHAPES * b->joints);
    if (notes && npz_find(file, "posedirs"))
        hg_text_add(notes, "posedirs: not used; the body is skinned linearly, without shapes that correct a pose\n");
    HG_TRY(skin_find_collider(file->path, b));
    return skin_find_scalp(file->path, b, with->scalp, notes);
}

static hg_status read_smpl(hg_ctx *ctx, hg_body **out, const char *path, const hg_import *with, hg_text *notes)
{
    (void)ctx;
    *out = NULL;
    npz_file *file;
    HG_TRY(npz_open(&file, path));
    hg_body *body = hg_alloc(1, sizeof *body);
    hg_status status = body ? make(file, body, with, notes) : HG_MEMORY;
    npz_close(file);
    if (status == HG_OK)
        *out = body;
    else
        hg_body_destroy(body);
    return status;
}

static const hg_body_reader reader = { .extension = "npz",
                                       .what = "NumPy: SMPL, SMPL-H, SMPL-X and their like",
                                       .read = read_smpl };
HG_REGISTER("body reader", smpl, &reader);
