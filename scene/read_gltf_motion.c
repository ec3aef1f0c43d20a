/* A clip from an animation of glTF 2.0: translations, rotations and scales of nodes with steps, straight lines and cubic
 * splines, sampled at the rate of its keys. A joint's rotation is taken against the rest pose of the skin. */
#include "scene/clip.h"
#include "scene/gltf.h"
#include "scene/joints.h"
#include "scene/skin.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef enum { STEP, LINEAR, SPLINE } interpolation;

typedef struct {
    int node, path; /* path 0 translation, 1 rotation, 2 scale */
    interpolation how;
    int64_t keys;
    double *time, *value; /* value [keys, 1 or 3, 3 or 4] */
} channel;

typedef struct {
    const gltf_file *file;
    int channels, left_out;
    channel *channel;
    double first, last;
} animation;

static void animation_free(animation *a)
{
    for (int i = 0; i < a->channels; i++) hg_free(a->channel[i].time), hg_free(a->channel[i].value);
    hg_free(a->channel);
}

/* ---- reading ------------------------------------------------------------------------------------------------- */

static hg_status read_sampler(animation *a, const cJSON *sampler, const char *where, channel *c)
{
    int64_t input, output, count;
    HG_TRY(gltf_integer(a->file, sampler, where, "input", -1, 0, INT32_MAX, &input));
    HG_TRY(gltf_integer(a->file, sampler, where, "output", -1, 0, INT32_MAX, &output));
    const char *how = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(sampler, "interpolation"));
    c->how = !how || !strcmp(how, "LINEAR") ? LINEAR : !strcmp(how, "STEP") ? STEP : SPLINE;
    if (c->how == SPLINE && strcmp(how, "CUBICSPLINE") != 0)
        return gltf_fail(a->file, "%s: interpolation %.40s; LINEAR, STEP and CUBICSPLINE are known", where, how);
    HG_TRY(gltf_read(a->file, input, 1, &c->keys, &c->time));
    for (int64_t k = 1; k < c->keys; k++)
        if (c->time[k] < c->time[k - 1])
            return gltf_fail(a->file, "%s: key %lld comes before the one in front of it", where, (long long)k);
    HG_TRY(gltf_read(a->file, output, c->path == 1 ? 4 : 3, &count, &c->value));
    if (count != c->keys * (c->how == SPLINE ? 3 : 1))
        return gltf_fail(a->file, "%s: %lld values for %lld keys", where, (long long)count, (long long)c->keys);
    a->first = fmin(a->first, c->time[0]);
    a->last = fmax(a->last, c->time[c->keys - 1]);
    return HG_OK;
}

static hg_status read_channel(animation *a, const cJSON *json, const cJSON *samplers, const char *where)
{
    static const char *const paths[] = { "translation", "rotation", "scale" };
    const cJSON *target = cJSON_GetObjectItemCaseSensitive(json, "target");
    const char *path = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(target, "path"));
    int64_t node, sampler;
    HG_TRY(gltf_integer(a->file, target, where, "node", -1, 0, a->file->n_nodes, &node));
    HG_TRY(gltf_integer(a->file, json, where, "sampler", -1, 0, cJSON_GetArraySize(samplers), &sampler));
    if (sampler < 0 || !path) return gltf_fail(a->file, "%s: no sampler, or no path", where);
    int p = 0;
    while (p < 3 && strcmp(path, paths[p]) != 0) p++;
    if (p == 3 || node < 0) { /* weights of shapes, or an extension's */
        a->left_out++;
        return HG_OK;
    }
    channel *c = a->channel + a->channels++;
    c->node = (int)node;
    c->path = p;
    return read_sampler(a, cJSON_GetArrayItem(samplers, (int)sampler), where, c);
}

static hg_status find_animation(const gltf_file *file, const char *asked, const cJSON **found, char where[96])
{
    int n = gltf_count(file, "animations"), number = 0;
    if (n == 0) return gltf_fail(file, "no animation in it");
    if (asked) {
        char *end;
        long value = strtol(asked, &end, 10);
        bool numeric = *asked && !*end;
        hg_text names = { 0 };
        for (number = 0; number < n; number++) {
            const char *name =
                cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(gltf_item(file, "animations", number), "name"));
            if ((name && strcmp(name, asked) == 0) || (numeric && value == number)) break;
            if (number < 40) hg_text_add(&names, "%s%.60s", number ? ", " : "", name ? name : "without name");
        }
        hg_status status = number < n ? HG_OK
                                      : hg_fail(HG_INVALID, "%s: no animation \"%s\"; there are %s", file->path, asked,
                                                names.data ? names.data : "none");
        hg_text_free(&names);
        HG_TRY(status);
    }
    *found = gltf_item(file, "animations", number);
    const char *name = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(*found, "name"));
    snprintf(where, 96, "animations[%d]%s%.60s", number, name ? " " : "", name ? name : "");
    return HG_OK;
}

static hg_status read_animation(const gltf_file *file, const char *asked, animation *a, char where[96])
{
    const cJSON *json = NULL, *item, *samplers;
    HG_TRY(find_animation(file, asked, &json, where));
    *a = (animation){ .file = file, .first = (double)INFINITY, .last = -(double)INFINITY };
    const cJSON *channels = cJSON_GetObjectItemCaseSensitive(json, "channels");
    samplers = cJSON_GetObjectItemCaseSensitive(json, "samplers");
    a->channel = hg_alloc((size_t)cJSON_GetArraySize(channels) + 1, sizeof *a->channel);
    if (!a->channel) return HG_MEMORY;
    cJSON_ArrayForEach(item, channels) HG_TRY(read_channel(a, item, samplers, where));
    if (a->channels == 0) return gltf_fail(file, "%s: it moves no node", where);
    return HG_OK;
}

/* ---- sampling ------------------------------------------------------------------------------------------------ */

static void sample(const channel *c, double at, gltf_node *node)
{
    int n = c->path == 1 ? 4 : 3;
    int64_t low = 0, high = c->keys - 1;
    while (low < high) { /* the last key that is not after `at` */
        int64_t middle = (low + high + 1) / 2;
        if (c->time[middle] <= at)
            low = middle;
        else
            high = middle - 1;
    }
    int64_t next = low + 1 < c->keys ? low + 1 : low;
    double span = c->time[next] - c->time[low], s = span > 0 ? fmin(fmax((at - c->time[low]) / span, 0), 1) : 0, v[4];
    if (c->how == SPLINE) { /* in-tangent, value, out-tangent of each key */
        const double *p = c->value + n * (3 * low + 1), *q = c->value + n * (3 * next + 1);
        double s2 = s * s, s3 = s2 * s;
        for (int k = 0; k < n; k++)
            v[k] = (2 * s3 - 3 * s2 + 1) * p[k] + span * (s3 - 2 * s2 + s) * p[n + k] + (3 * s2 - 2 * s3) * q[k] +
                   span * (s3 - s2) * q[k - n];
    } else {
        const double *p = c->value + n * low, *q = c->value + n * next;
        if (c->how == STEP) s = 0;
        for (int k = 0; k < n; k++) v[k] = p[k] + s * (q[k] - p[k]);
        if (c->path == 1 && s > 0) {
            hg_quatd a = hg_quatd_make(p[3], p[0], p[1], p[2]), b = hg_quatd_make(q[3], q[0], q[1], q[2]);
            a = hg_quatd_slerp(hg_quatd_normalize(a), hg_quatd_normalize(b), s);
            v[0] = a.x, v[1] = a.y, v[2] = a.z, v[3] = a.w;
        }
    }
    if (c->path == 0) memcpy(node->translation, v, 3 * sizeof *v);
    if (c->path == 2) memcpy(node->scale, v, 3 * sizeof *v);
    if (c->path == 1) hg_quatd_store(node->rotation, hg_quatd_normalize(hg_quatd_make(v[3], v[0], v[1], v[2])));
}

/* A usual rate whose frames are those of the keys; 60 where the keys are at no such times. */
static double find_rate(const animation *a)
{
    static const double rates[] = { 24, 25, 30, 48, 50, 60, 90, 100, 120 };
    for (size_t r = 0; r < sizeof rates / sizeof *rates; r++) {
        bool fits = true;
        for (int i = 0; fits && i < a->channels; i++)
            for (int64_t k = 0; fits && k < a->channel[i].keys; k++) {
                double frame = (a->channel[i].time[k] - a->first) * rates[r];
                fits = fabs(frame - nearbyint(frame)) < 0.01;
            }
        if (fits) return rates[r];
    }
    return 60;
}

/* The joint that carries the body: the hips, or the first that the tree forks at. Its way is the clip's. */
static int find_anchor(const gltf_rig *rig)
{
    const joint_row *hips = joints_row("Hips", JOINTS_OWN);
    int joint = joints_find_row(rig->name, rig->joints, hips, joints_family(rig->name, rig->joints));
    for (int j = 0; joint < 0 && j < rig->joints; j++) {
        int children = 0;
        for (int k = j + 1; k < rig->joints; k++) children += rig->parent[k] == j;
        if (children > 1) joint = j;
    }
    return joint < 0 ? 0 : joint;
}

typedef struct {
    gltf_node *nodes;
    gltf_affine *global;
    hg_quatd *rest, *turn; /* [joints] of the bind pose; of the frame against it */
    hg_vec3d *place;       /* [joints] of the frame, by the bones alone */
    double *stray;         /* [joints] furthest from where its bone would end */
} scratch;

static void take_frame(const gltf_rig *rig, hg_clip *clip, int64_t t, int anchor, scratch *s)
{
    for (int j = 0; j < rig->joints; j++) {
        int parent = rig->parent[j], node = rig->node[j];
        s->turn[j] = node < 0
                         ? hg_quatd_identity()
                         : hg_quatd_normalize(hg_quatd_mul(gltf_rotation(s->global + node), hg_quatd_conj(s->rest[j])));
        hg_vec3d bone = hg_vec3d_load(clip->offset + 3 * j);
        hg_quatd local = parent < 0 ? s->turn[j] : hg_quatd_mul(hg_quatd_conj(s->turn[parent]), s->turn[j]);
        s->place[j] = parent < 0 ? bone : hg_vec3d_add(s->place[parent], hg_quatd_rotate(s->turn[parent], bone));
        hg_quatd_store(clip->rotation + 4 * (t * rig->joints + j), hg_quatd_normalize(local));
    }
    const double *m = rig->node[anchor] < 0 ? rig->bind[anchor].m : s->global[rig->node[anchor]].m;
    hg_vec3d way = hg_vec3d_sub(hg_vec3d_make(m[3], m[7], m[11]), s->place[anchor]);
    hg_vec3d_store(clip->translation + 3 * t, way);
    for (int j = 0; j < rig->joints; j++) {
        if (rig->node[j] < 0) continue;
        const double *at = s->global[rig->node[j]].m;
        hg_vec3d off = hg_vec3d_sub(hg_vec3d_make(at[3], at[7], at[11]), hg_vec3d_add(s->place[j], way));
        s->stray[j] = fmax(s->stray[j], hg_vec3d_norm(off));
    }
}

static hg_status make(hg_clip **out, const gltf_file *file, const animation *a, const gltf_rig *rig,
                      const gltf_affine *top, const char *where, hg_text *notes)
{
    double rate = find_rate(a), seconds = a->last - a->first, frames = floor(seconds * rate + 0.01) + 1;
    if (!(frames >= 1) || frames * rig->joints > 4e6 + (double)file->size)
        return gltf_fail(file, "%s: %g s of %d joints at %g per second are more than this file can mean", where,
                         seconds, rig->joints, rate);
    HG_TRY(clip_create(out, rig->joints));
    hg_clip *clip = *out;
    clip->rate = rate;
    HG_TRY(clip_frames(clip, (int64_t)frames));
    size_t joints = (size_t)rig->joints, nodes = (size_t)file->n_nodes + 1;
    scratch s = { .nodes = hg_alloc(nodes, sizeof *s.nodes), .global = hg_alloc(nodes, sizeof *s.global) };
    s.rest = hg_alloc(joints, sizeof *s.rest);
    s.turn = hg_alloc(joints, sizeof *s.turn);
    s.place = hg_alloc(joints, sizeof *s.place);
    s.stray = hg_alloc(joints, sizeof *s.stray);
    hg_status status = s.nodes && s.global && s.rest && s.turn && s.place && s.stray ? HG_OK : HG_MEMORY;
    for (int j = 0; status == HG_OK && j < rig->joints; j++) {
        const double *m = rig->bind[j].m;
        hg_vec3d place = hg_vec3d_make(m[3], m[7], m[11]);
        clip->parent[j] = rig->parent[j];
        s.rest[j] = gltf_rotation(rig->bind + j);
        if (rig->parent[j] >= 0) {
            m = rig->bind[rig->parent[j]].m;
            place = hg_vec3d_sub(place, hg_vec3d_make(m[3], m[7], m[11]));
        }
        hg_vec3d_store(clip->offset + 3 * j, place);
        if (!(clip->name[j] = hg_strdup(rig->name[j]))) status = HG_MEMORY;
    }
    int anchor = find_anchor(rig);
    if (status == HG_OK) memcpy(s.nodes, file->node, (size_t)file->n_nodes * sizeof *s.nodes);
    for (int i = 0; status == HG_OK && i < a->channels; i++) /* an animated node has no matrix */
        s.nodes[a->channel[i].node].is_matrix = false;
    for (int64_t t = 0; status == HG_OK && t < clip->frames; t++) {
        for (int i = 0; i < a->channels; i++)
            sample(a->channel + i, a->first + (double)t / rate, s.nodes + a->channel[i].node);
        gltf_globals(file, s.nodes, top, s.global);
        take_frame(rig, clip, t, anchor, &s);
        for (int k = 0; status == HG_OK && k < 4 * rig->joints; k++)
            if (!isfinite(clip->rotation[4 * t * rig->joints + k]) || !isfinite(clip->translation[3 * t + k % 3]))
                status = hg_fail(HG_NUMERIC, "%s: %s: frame %lld is not finite", file->path, where, (long long)t);
    }
    if (status == HG_OK && notes) {
        int strayed = 0;
        double most = 0;
        for (int j = 0; j < rig->joints; j++) strayed += s.stray[j] > 0.01, most = fmax(most, s.stray[j]);
        hg_text_add(notes, "%s: %.2f s at %g per second\n", where, seconds, rate);
        if (strayed > 0)
            hg_text_add(notes,
                        "joints: %d of %d are moved or scaled against those above them, by up to %.3g m; bones "
                        "keep their length here, and only %s is moved\n",
                        strayed, rig->joints, most, rig->name[anchor]);
        if (a->left_out > 0)
            hg_text_add(notes, "channels: %d of weights of shapes or of no node were left out\n", a->left_out);
    }
    hg_free(s.nodes);
    hg_free(s.global);
    hg_free(s.rest);
    hg_free(s.turn);
    hg_free(s.place);
    hg_free(s.stray);
    return status;
}

static hg_status read_gltf(hg_clip **clip, const char *path, const hg_import *with, hg_text *notes)
{
    *clip = NULL;
    gltf_file *file;
    gltf_rig rig = { 0 };
    animation a = { 0 };
    scene_axes axes;
    char where[96];
    if (with->skeleton) return hg_fail(HG_INVALID, "--skeleton: %s has its own", path);
    HG_TRY(skin_axes(with, false, &axes));
    gltf_affine top = gltf_top(&axes);
    HG_TRY(gltf_open(&file, path));
    hg_status status = gltf_rig_create(file, &top, &rig);
    if (status == HG_OK) status = read_animation(file, with->animation, &a, where);
    if (status == HG_OK) status = make(clip, file, &a, &rig, &top, where, notes);
    animation_free(&a);
    gltf_rig_free(&rig);
    gltf_close(file);
    if (status != HG_OK) {
        hg_clip_destroy(*clip);
        *clip = NULL;
    }
    return status;
}

static const hg_clip_reader glb = { .extension = "glb", .what = "glTF 2.0, an animation, binary", .read = read_gltf };
HG_REGISTER("motion reader", glb, &glb);
static const hg_clip_reader gltf = { .extension = "gltf", .what = "glTF 2.0, an animation", .read = read_gltf };
HG_REGISTER("motion reader", gltf, &gltf);
