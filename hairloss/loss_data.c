/* The data of a loss: datasets of an HDF5 file become the groom data and the frame of a physics. Which ones are read is
 * decided by what the formulas ask for; sizes are checked against each other, and every number has to be finite. */
#include "hairloss/loss.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* ---- axes ---------------------------------------------------------------------------------------------------- */

static int64_t *size_of(loss *l, char axis) { return &l->size[axis - 'a']; }

static const char *axis_name(char axis)
{
    switch (axis) {
    case 'g':
        return "groom";
    case 'b':
        return "frame";
    case 's':
        return "strand";
    case 'v':
        return "vertex";
    case 'e':
        return "edge";
    case 'n':
        return "body vertex";
    default:
        return "component";
    }
}

/* "[B,S,V,3]" with the sizes that are known. */
static void describe(const loss *l, const char *axes, hg_text *text)
{
    if (!*axes) {
        hg_text_add(text, "a scalar");
        return;
    }
    const bool one = (*axes == 'b' || *axes == 'g') && axes[1] && (*axes == 'g' || l->size['b' - 'a'] == 1);
    axes += one && l->size[*axes - 'a'] <= 1 ? 1 : 0; /* may be left out */
    for (const char *at = axes; *at; at++) {
        hg_text_add(text, at == axes ? "[" : ",");
        if (*at >= '0' && *at <= '9')
            hg_text_add(text, "%c", *at);
        else if (l->size[*at - 'a'] >= 0)
            hg_text_add(text, "%lld", (long long)l->size[*at - 'a']);
        else
            hg_text_add(text, "%c", *at == 'e' ? 'E' : *at - 'a' + 'A');
    }
    hg_text_add(text, "]");
}

/* Does the dataset's shape fit these axes? One groom and one frame may be left out. */
static bool fits(const loss *l, const char *axes, int rank, const int64_t *shape)
{
    const int full = (int)strlen(axes);
    if (full == 0) return rank == 0 || (rank == 1 && shape[0] == 1);
    const bool without_first = rank == full - 1 && (*axes == 'b' || *axes == 'g') &&
                               (l->size[*axes - 'a'] == 1 || l->size[*axes - 'a'] < 0) && full > 2;
    if (rank != full && !without_first) return false;
    axes += without_first ? 1 : 0;
    for (int i = 0; i < rank; i++) {
        const int64_t expected = axes[i] >= '0' && axes[i] <= '9' ? axes[i] - '0' : l->size[axes[i] - 'a'];
        if (expected >= 0 && shape[i] != expected) return false;
    }
    return true;
}

/* The sizes that a dataset of known axes brings along. */
static void learn(loss *l, const loss_array *a)
{
    const int left_out = (int)strlen(a->axes) - a->rank;
    for (int i = 0; a->axes[i]; i++) {
        const char axis = a->axes[i];
        if (axis >= '0' && axis <= '9') continue;
        const int64_t n = i < left_out ? 1 : a->shape[i - left_out];
        *size_of(l, axis) = n;
        if (axis == 'e' && *size_of(l, 'v') < 0) *size_of(l, 'v') = n + 1;
        if (axis == 'v' && *size_of(l, 'e') < 0) *size_of(l, 'e') = n > 0 ? n - 1 : 0;
    }
}

/* ---- datasets ------------------------------------------------------------------------------------------------ */

/* The first number that is not finite, by its place. */
static hg_status check_finite(const loss *l, const loss_array *a)
{
    for (int64_t i = 0; i < a->count; i++) {
        if (isfinite(a->values[i])) continue;
        int64_t index[4] = { 0 }, rest = i;
        for (int k = a->rank; k-- > 0; rest /= a->shape[k]) index[k] = rest % a->shape[k];
        const char *axes = a->axes + strlen(a->axes) - (size_t)a->rank;
        hg_text place = { 0 };
        for (int k = 0; k < a->rank; k++)
            hg_text_add(&place, "%s%s %lld", k ? ", " : " at ", axis_name(axes[k]), (long long)index[k]);
        const hg_status status = hg_fail(HG_NUMERIC, "%s: dataset \"%s\" is %g%s; every number has to be finite",
                                         l->path, a->name, a->values[i], place.data ? place.data : "");
        hg_text_free(&place);
        return status;
    }
    return HG_OK;
}

/* The first of the possibilities "a|b|c": its length. */
static size_t possibility(const char *at, char one[8])
{
    const size_t length = strcspn(at, "|");
    memcpy(one, at, length < 7 ? length : 7);
    one[length < 7 ? length : 7] = '\0';
    return length;
}

/* Reads a dataset into the array. axes: one or more possibilities, like "|sv" for a scalar or [S,V]. */
static hg_status read_array(loss *l, loss_array *a, const char *axes)
{
    int rank;
    int64_t shape[6];
    char one[8];
    HG_TRY(hg_h5_shape(l->file, a->name, &rank, shape));
    for (const char *at = axes;; at++) {
        const size_t length = possibility(at, one);
        if (fits(l, one, rank, shape)) break;
        at += length;
        if (*at) continue;
        hg_text found = { 0 }, expected = { 0 };
        for (int i = 0; i < rank; i++) hg_text_add(&found, "%s%lld", i ? "," : "", (long long)shape[i]);
        for (at = axes;; at++) {
            const size_t next = possibility(at, one);
            if (at > axes) hg_text_add(&expected, " or ");
            describe(l, one, &expected);
            at += next;
            if (!*at) break;
        }
        const hg_status status = hg_fail(HG_FORMAT, "%s: dataset \"%s\" is [%s], expected %s", l->path, a->name,
                                         found.data ? found.data : "", expected.data ? expected.data : "another shape");
        hg_text_free(&found);
        hg_text_free(&expected);
        return status;
    }
    hg_free(a->values);
    a->values = NULL;
    a->rank = rank;
    a->count = 1;
    for (int i = 0; i < rank; i++) {
        a->shape[i] = shape[i];
        a->count *= shape[i];
    }
    memcpy(a->axes, one, sizeof a->axes);
    if (!*one && rank) snprintf(a->axes, sizeof a->axes, "1"); /* [1] for a scalar: given back as [1] */
    HG_TRY(hg_h5_read(l->file, a->name, HG_F64, rank, shape, NULL, (void **)&a->values));
    a->given = true;
    learn(l, a);
    return check_finite(l, a);
}

/* The dataset as an array of the loss; *array stays NULL where the file does not have it. */
static hg_status read_named(loss *l, const char *name, const char *axes, loss_array **array)
{
    *array = NULL;
    if (!hg_h5_has(l->file, name)) return HG_OK;
    loss_array *a = loss_find(l, name);
    if (a && a->given) return HG_OK;
    if (!a) a = loss_add(l, name);
    if (!a) return HG_INVALID;
    HG_TRY(read_array(l, a, axes));
    *array = a;
    return HG_OK;
}

/* Which energies, for messages. */
static const char *who(const loss *l) { return l->n_terms > 1 ? "these energies" : l->term[0].energy->name; }

static hg_status missing(const loss *l, const char *name, const char *axes, const char *what)
{
    hg_text shape = { 0 };
    describe(l, axes, &shape);
    const hg_status status = hg_fail(HG_INVALID, "%s: dataset \"%s\" %s is missing: %s reads %s", l->path, name,
                                     shape.data ? shape.data : "", who(l), what);
    hg_text_free(&shape);
    return status;
}

static bool reads(const loss *l, hg_input_kind kind) { return (l->reads.kinds & HG_ALLOW(kind)) != 0; }

/* ---- the frame ----------------------------------------------------------------------------------------------- */

static bool needs_x(const loss *l)
{
    return l->reads.pairs || l->reads.field || l->reads.contact || reads(l, HG_INPUT_X) || reads(l, HG_INPUT_ROOT_X);
}

static bool needs_rest(const loss *l)
{
    const bool makes_pairs = l->reads.pairs && !hg_h5_has(l->file, "neighbours");
    const bool makes_density = reads(l, HG_INPUT_FIELD_REST) && !hg_h5_has(l->file, "density_rest");
    bool makes_length = false;
    for (int i = 0; i < l->reads.n_attributes; i++) {
        const char *name = l->reads.attribute[i];
        makes_length |=
            !hg_h5_has(l->file, name) && (strcmp(name, "strand_length") == 0 || strcmp(name, "body_distance") == 0);
    }
    return makes_pairs || makes_density || makes_length || reads(l, HG_INPUT_REST) || reads(l, HG_INPUT_ROOT_REST) ||
           reads(l, HG_INPUT_REST_DISTANCE);
}

static hg_status read_frame_arrays(loss *l)
{
    loss_array *a;
    HG_TRY(read_named(l, "x", "bsv3", &a));
    l->has_x = a != NULL;
    if (!a && needs_x(l)) return missing(l, "x", "bsv3", "the positions");
    for (int i = 0; i < l->reads.n_frame; i++) {
        const char *axes = l->reads.width[i] == 1 ? "bsv" : "bsv3";
        HG_TRY(read_named(l, l->reads.frame[i], axes, &a));
        const bool made = strcmp(l->reads.frame[i], "deformation_mean") == 0; /* by physics */
        if (!a && !made) return missing(l, l->reads.frame[i], axes, "it");
    }
    const struct {
        hg_input_kind kind;
        const char *name, *axes, *what;
    } members[] = {
        { HG_INPUT_Q, "q", "bse4", "the orientations of the edges" },
        { HG_INPUT_PREDICTED, "predicted", "bsv3", "2 x(t-1) - x(t-2)" },
        { HG_INPUT_PREVIOUS, "previous", "bsv3", "x(t-1)" },
        { HG_INPUT_ROOT_ROTATION, "root_rotation", "bs4", NULL },
        { HG_INPUT_ROOT_POSITION, "root_position", "bs3", NULL },
    };
    for (size_t i = 0; i < sizeof members / sizeof *members; i++) {
        if (!reads(l, members[i].kind)) continue;
        HG_TRY(read_named(l, members[i].name, members[i].axes, &a));
        if (!a && members[i].what) return missing(l, members[i].name, members[i].axes, members[i].what);
    }
    /* posed is made of rest and the root frames where the file says where the roots are. */
    if (reads(l, HG_INPUT_POSED)) {
        HG_TRY(read_named(l, "posed", "bsv3", &a));
        if (!a && !hg_h5_has(l->file, "root_position"))
            return missing(l, "posed", "bsv3", "the rigidly posed groom (or give root_rotation and root_position)");
    }
    return HG_OK;
}

/* ---- the groom ----------------------------------------------------------------------------------------------- */

/* [G,S,V] of a scalar, of [S,V], or of [G,S,V]. */
static double *spread(const loss *l, const loss_array *a)
{
    const int64_t n = l->size['g' - 'a'] * l->size['s' - 'a'] * l->size['v' - 'a'];
    double *values = hg_alloc((size_t)n + 1, sizeof *values);
    for (int64_t i = 0; values && i < n; i++) values[i] = a->values[a->count == 1 ? 0 : i];
    return values;
}

static hg_status read_rest(loss *l)
{
    loss_array *a, *x = loss_find(l, "x");
    const bool needed = needs_rest(l);
    a = NULL;
    if (needed || !x || hg_h5_has(l->file, "groom")) HG_TRY(read_named(l, "rest", "gsv3", &a));
    if (!a && needed) return missing(l, "rest", "sv3", "the rest groom");
    if (*size_of(l, 's') < 0 || *size_of(l, 'v') < 0)
        return hg_fail(HG_INVALID, "%s: neither \"x\" nor \"rest\" is there to say how many strands there are",
                       l->path);
    if (*size_of(l, 'b') < 0) *size_of(l, 'b') = 1;
    if (!a) { /* nobody reads it: the strands of the first frame, or nothing, stand for it */
        const int64_t n = *size_of(l, 's') * *size_of(l, 'v') * 3;
        *size_of(l, 'g') = 1;
        double *values = hg_alloc((size_t)n + 1, sizeof *values);
        l->data.rest = values;
        if (!values) return HG_MEMORY;
        if (x && x->count >= n) memcpy(values, x->values, (size_t)n * sizeof *values);
        return HG_OK;
    }
    double *values = hg_alloc((size_t)a->count + 1, sizeof *values);
    l->data.rest = values;
    if (!values) return HG_MEMORY;
    memcpy(values, a->values, (size_t)a->count * sizeof *values);
    return HG_OK;
}

/* Which rest groom each frame uses, where there are several. */
static hg_status read_groom_numbers(loss *l)
{
    const int64_t frames = *size_of(l, 'b'), grooms = *size_of(l, 'g');
    if (!hg_h5_has(l->file, "groom"))
        return grooms == 1 ? HG_OK
                           : hg_fail(HG_INVALID,
                                     "%s: \"rest\" holds %lld grooms: \"groom\" [%lld] has to say which one a frame is",
                                     l->path, (long long)grooms, (long long)frames);
    HG_TRY(hg_h5_read(l->file, "groom", HG_I32, 1, &frames, NULL, (void **)&l->groom));
    l->frame.groom = l->groom;
    return HG_OK;
}

static hg_status read_faces(loss *l, int32_t **faces, int64_t *count)
{
    int64_t shape[2];
    const int64_t expected[2] = { -1, 3 };
    if (!hg_h5_has(l->file, "body_faces"))
        return hg_fail(HG_INVALID, "%s: dataset \"body_faces\" [F,3] is missing: %s reads the body", l->path, who(l));
    HG_TRY(hg_h5_read(l->file, "body_faces", HG_I32, 2, expected, shape, (void **)faces));
    *count = shape[0];
    return HG_OK;
}

/* The tree over the body: its topology is that of the rest body, of the first frame where there is none. */
static hg_status read_body(loss *l)
{
    loss_array *rest, *now = NULL;
    if (l->reads.contact) {
        HG_TRY(read_named(l, "body_vertices", "bn3", &now));
        if (!now) return missing(l, "body_vertices", "bn3", "the body");
    }
    HG_TRY(read_named(l, "rest_body_vertices", "n3", &rest));
    const loss_array *from = rest ? rest : now;
    if (!from) return HG_OK;
    int32_t *faces = NULL;
    int64_t n_faces = 0;
    HG_TRY(read_faces(l, &faces, &n_faces));
    const hg_status status = hg_body_tree_create(&l->body, *size_of(l, 'n'), from->values, n_faces, faces);
    hg_free(faces);
    if (status == HG_OK && l->reads.contact) l->data.body = l->body;
    return status == HG_OK ? HG_OK : hg_fail(status, "%s: the body: %s", l->path, hg_message());
}

/* Signed distance of every rest vertex to the rest body. */
static hg_status measure_body_distance(loss *l, double *distance)
{
    const int64_t n = l->data.grooms * l->data.strands * l->data.vertices;
    const loss_array *rest_body = loss_find(l, "rest_body_vertices");
    if (!rest_body)
        return hg_fail(HG_INVALID,
                       "%s: dataset \"body_distance\" [S,V] is missing: %s reads it; it is also made of "
                       "\"rest_body_vertices\" [N,3] and \"body_faces\" [F,3]",
                       l->path, who(l));
    const int64_t vertices[2] = { n, 3 }, body[2] = { hg_body_tree_vertices(l->body), 3 };
    hg_body_refit *refit = NULL;
    double *point = hg_alloc((size_t)n * 3 + 1, sizeof *point), *normal = hg_alloc((size_t)n * 3 + 1, sizeof *normal);
    hg_tensor *triangles = hg_tensor_make(l->ctx, HG_I32, 1, &n), *points = hg_tensor_make(l->ctx, HG_F64, 2, vertices),
              *normals = hg_tensor_make(l->ctx, HG_F64, 2, vertices),
              *at = hg_tensor_from(l->ctx, HG_F64, 2, vertices, l->data.rest),
              *moved = hg_tensor_from(l->ctx, HG_F64, 2, body, rest_body->values);
    hg_status status = point && normal && triangles && points && normals && at && moved ? HG_OK : HG_MEMORY;
    if (status == HG_OK) status = hg_tensor_fill(triangles, -1);
    if (status == HG_OK) status = hg_body_refit_create(&refit, l->body, HG_F64);
    if (status == HG_OK) status = hg_body_refit_update(l->ctx, refit, moved->data);
    if (status == HG_OK)
        status = hg_body_closest(l->ctx, refit, HG_CONTACT_EXACT, (double)INFINITY, n, at->data, triangles->data,
                                 points->data, normals->data);
    if (status == HG_OK) status = hg_tensor_numbers(points, point);
    if (status == HG_OK) status = hg_tensor_numbers(normals, normal);
    for (int64_t i = 0; status == HG_OK && i < n; i++) {
        distance[i] = 0;
        for (int c = 0; c < 3; c++) distance[i] += normal[3 * i + c] * (l->data.rest[3 * i + c] - point[3 * i + c]);
    }
    hg_body_refit_destroy(refit);
    hg_free(point);
    hg_free(normal);
    return status;
}

static hg_status read_attribute(loss *l, const char *name)
{
    loss_array *a;
    HG_TRY(read_named(l, name, "|gsv", &a));
    hg_groom_attribute *to = &l->attribute[l->data.n_attributes];
    if (!a && strcmp(name, "strand_length") == 0) return HG_OK; /* physics makes it */
    if (!a && strcmp(name, "body_distance") != 0) return missing(l, name, "sv", "it");
    if (!a) {
        a = loss_add(l, name);
        if (!a) return HG_MEMORY;
        a->rank = 2;
        a->shape[0] = l->data.strands;
        a->shape[1] = l->data.vertices;
        a->count = l->data.grooms * l->data.strands * l->data.vertices;
        snprintf(a->axes, sizeof a->axes, "sv");
        if (l->data.grooms > 1) {
            a->rank = 3;
            memcpy(a->shape, (int64_t[]){ l->data.grooms, l->data.strands, l->data.vertices }, 3 * sizeof(int64_t));
            snprintf(a->axes, sizeof a->axes, "gsv");
        }
        a->values = hg_alloc((size_t)a->count + 1, sizeof *a->values);
        if (!a->values) return HG_MEMORY;
        HG_TRY(measure_body_distance(l, a->values));
    }
    to->name = a->name;
    to->values = spread(l, a);
    if (!to->values) return HG_MEMORY;
    l->data.n_attributes++;
    return HG_OK;
}

static hg_status read_pairs(loss *l)
{
    if (!l->reads.pairs || !hg_h5_has(l->file, "neighbours")) return HG_OK;
    const int64_t vertices = l->data.strands * l->data.vertices, expected[2] = { -1, 2 };
    int64_t shape[2];
    int32_t *list = NULL;
    if (l->data.grooms > 1)
        return hg_fail(HG_UNSUPPORTED, "%s: \"neighbours\" are of one groom, and there are %lld", l->path,
                       (long long)l->data.grooms);
    HG_TRY(hg_h5_read(l->file, "neighbours", HG_I32, 2, expected, shape, (void **)&list));
    hg_status status = HG_OK;
    for (int64_t i = 0; i < 2 * shape[0] && status == HG_OK; i++)
        if (list[i] < 0 || list[i] >= vertices)
            status = hg_fail(HG_FORMAT,
                             "%s: dataset \"neighbours\": pair %lld names vertex %d; flat vertex numbers s*V+v go from "
                             "0 to %lld",
                             l->path, (long long)(i / 2), list[i], (long long)vertices - 1);
    if (status == HG_OK) status = hg_pairs_from_list(&l->pairs, vertices, shape[0], list);
    hg_free(list);
    l->data.adhesion = &l->pairs;
    return status;
}

/* Parameters, mass and time step from datasets of their names; a setting comes first. */
static hg_status read_params(loss *l)
{
    for (int i = 0; i < l->n_arrays; i++) {
        loss_array *a = &l->array[i];
        if (a->given || a->set) continue;
        const bool is_mass = strcmp(a->name, "mass") == 0, is_dt = strcmp(a->name, "dt") == 0;
        if (!hg_h5_has(l->file, a->name)) continue;
        HG_TRY(read_array(l, a,
                          a->term < 0 && is_mass ? "|gsv"
                          : a->term < 0 && is_dt ? ""
                          : a->count == 3        ? "3"
                                                 : "|s|bs"));
        if (a->term >= 0 && (a->count == 1 || a->axes[0] == '3'))
            memcpy(&l->params[a->term][a->param], a->values, (size_t)a->count * sizeof(double));
    }
    return HG_OK;
}

hg_status loss_read_data(loss *l)
{
    for (int i = 0; i < 26; i++) l->size[i] = -1;
    HG_TRY(read_frame_arrays(l));
    HG_TRY(read_rest(l));
    HG_TRY(read_groom_numbers(l));
    l->data.grooms = *size_of(l, 'g');
    l->data.strands = *size_of(l, 's');
    l->data.vertices = *size_of(l, 'v');
    l->data.attributes = l->attribute;
    HG_TRY(read_params(l));
    const loss_array *mass = loss_find(l, "mass"), *dt = loss_find(l, "dt");
    if (mass && mass->term < 0) l->data.mass = l->mass = spread(l, mass);
    if (mass && !l->mass) return HG_MEMORY;
    l->frame.dt = dt ? dt->values[0] : 1.0 / 30.0;
    HG_TRY(read_body(l));
    for (int i = 0; i < l->reads.n_attributes; i++) HG_TRY(read_attribute(l, l->reads.attribute[i]));
    if (l->reads.field && hg_h5_has(l->file, "density_rest")) HG_TRY(read_attribute(l, "density_rest"));
    return read_pairs(l);
}

void loss_free(loss *l)
{
    for (int i = 0; i < l->n_arrays; i++) hg_free(l->array[i].values);
    for (int i = 0; i < l->data.n_attributes; i++) hg_free((void *)l->attribute[i].values);
    for (int i = 0; i < l->reads.n_attributes; i++) hg_free(l->reads.attribute[i]);
    for (int i = 0; i < l->reads.n_frame; i++) hg_free(l->reads.frame[i]);
    for (int i = 0; i < l->n_texts; i++) hg_free(l->texts[i]);
    hg_free((void *)l->data.rest);
    hg_free(l->mass);
    hg_free(l->groom);
    hg_body_tree_destroy(l->body);
    hg_pairs_destroy(l->pairs);
    if (l->file) hg_h5_close(l->file);
}

/* ---- tensors ------------------------------------------------------------------------------------------------- */

/* A step tensor of values in the dtype of the loss. */
static hg_tensor *tensor_of(loss *l, int rank, const int64_t *shape, const double *values, const char *name)
{
    hg_tensor *tensor = hg_tensor_make(l->ctx, l->dtype, rank, shape);
    if (!tensor) return NULL;
    const int64_t n = hg_tensor_count(tensor);
    float *narrow = l->dtype == HG_F32 ? hg_alloc((size_t)n + 1, sizeof *narrow) : NULL;
    if (l->dtype == HG_F32 && !narrow) return NULL;
    for (int64_t i = 0; narrow && i < n; i++) narrow[i] = (float)values[i];
    if (n && hg_tensor_write(tensor, narrow ? (const void *)narrow : values) != HG_OK) tensor = NULL;
    hg_free(narrow);
    if (tensor) tensor->name = name;
    return tensor;
}

/* The array in the shape that physics expects: with its first axis. */
static hg_tensor *whole(loss *l, const loss_array *a, const char *axes)
{
    int64_t shape[4];
    int rank = 0;
    for (const char *at = axes; *at; at++) shape[rank++] = *at >= '0' && *at <= '9' ? *at - '0' : l->size[*at - 'a'];
    return tensor_of(l, rank, shape, a->values, a->name);
}

static void bring(loss *l, const char *name, hg_tensor *value)
{
    l->input[l->frame.n_inputs++] = (hg_frame_input){ name, value };
    l->frame.inputs = l->input;
}

/* A parameter as a tensor of the frame: per strand, or because its gradient is wanted. */
static hg_status bring_param(loss *l, loss_array *a)
{
    const hg_energy *energy = l->term[a->term].energy;
    const bool vector = a->axes[0] == '3';
    for (int c = 0; c < (vector ? 3 : 1); c++) {
        char *name = loss_keep(l, hg_format("%s.%s", energy->name, energy->params[a->param + c].name));
        a->tensor[c] = vector || a->count == 1 ? tensor_of(l, 0, NULL, a->values + c, name)
                                               : tensor_of(l, a->rank, a->shape, a->values, name);
        if (!name || !a->tensor[c]) return HG_MEMORY;
        bring(l, name, a->tensor[c]);
    }
    return HG_OK;
}

static bool is_wanted(const loss_array *a, int n, loss_array *const *wrt)
{
    for (int i = 0; i < n; i++)
        if (wrt[i] == a) return true;
    return false;
}

/* Groom values go in as they are; on the tape only where their gradient is wanted. */
static hg_status bring_groom_values(loss *l, loss_array *a)
{
    const bool is_rest = strcmp(a->name, "rest") == 0;
    double *values = is_rest ? NULL : spread(l, a);
    const int64_t shape[4] = { l->data.grooms, l->data.strands, l->data.vertices, 3 };
    a->tensor[0] =
        is_rest || values ? tensor_of(l, is_rest ? 4 : 3, shape, is_rest ? a->values : values, a->name) : NULL;
    hg_free(values);
    if (!a->tensor[0]) return HG_MEMORY;
    bring(l, a->name, a->tensor[0]);
    return HG_OK;
}

hg_status loss_make_frame(loss *l, int n_wrt, loss_array *const *wrt)
{
    const struct {
        const char *name, *axes;
        hg_tensor **to;
    } members[] = {
        { "posed", "bsv3", &l->frame.posed },
        { "predicted", "bsv3", &l->frame.predicted },
        { "previous", "bsv3", &l->frame.previous },
        { "root_rotation", "bs4", &l->frame.root_rotation },
        { "root_position", "bs3", &l->frame.root_position },
        { "body_vertices", "bn3", &l->frame.body_vertices },
        { "x", "bsv3", NULL },
    };
    for (int i = 0; i < l->n_arrays; i++) {
        loss_array *a = &l->array[i];
        const bool wanted = is_wanted(a, n_wrt, wrt);
        const char *axes = NULL;
        hg_tensor **to = NULL;
        for (size_t m = 0; m < sizeof members / sizeof *members; m++)
            if (strcmp(a->name, members[m].name) == 0) {
                axes = members[m].axes;
                to = members[m].to;
            }
        bool named = strcmp(a->name, "q") == 0;
        if (named) axes = "bse4";
        for (int k = 0; k < l->reads.n_frame; k++)
            if (strcmp(a->name, l->reads.frame[k]) == 0) {
                named = true;
                axes = l->reads.width[k] == 1 ? "bsv" : "bsv3";
            }
        if (a->term >= 0) {
            if (wanted || (a->count > 1 && a->axes[0] != '3')) HG_TRY(bring_param(l, a));
        } else if (axes) {
            a->tensor[0] = whole(l, a, axes);
            if (!a->tensor[0]) return HG_MEMORY;
            if (named) bring(l, a->name, a->tensor[0]);
            if (to) *to = a->tensor[0];
        } else if (wanted && strcmp(a->name, "dt") == 0) {
            a->tensor[0] = tensor_of(l, 0, NULL, a->values, a->name);
            if (!a->tensor[0]) return HG_MEMORY;
            bring(l, a->name, a->tensor[0]);
        } else if (wanted && strcmp(a->name, "rest_body_vertices") != 0) {
            HG_TRY(bring_groom_values(l, a));
        }
        for (int c = 0; wanted && c < 3 && a->tensor[c]; c++) HG_TRY(hg_require_grad(a->tensor[c]));
    }
    return HG_OK;
}
