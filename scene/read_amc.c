/* Acclaim .asf (a skeleton) and .amc (a clip on it), as the CMU motion capture database has them.
 *
 * A bone's local rotation is C M C^-1: C turns by the bone's `axis`, M by the values of its degrees of freedom, absent
 * ones being zero; both are composed in the order in which their letters are given, the first one applied first. A
 * joint is where its bone starts, and is named like the bone; its offset is direction times length of the bone before.
 * Files store no frame rate: the database's is 120 per second. */
#include "scene/clip.h"
#include "scene/lines.h"

#include <string.h>

#define RATE 120

typedef enum { TX, TY, TZ, RX, RY, RZ, LENGTH } freedom_kind;
typedef struct {
    char *name;
    hg_vec3d direction;
    double length;
    hg_quatd axis;     /* C */
    int8_t freedom[7]; /* freedom_kind, in the order of the file */
    int freedoms;
    int joint; /* -1 until the hierarchy places it */
} bone;

typedef struct {
    bone *bone; /* [CLIP_MAX_JOINTS]; 0 is the root */
    int bones;
    double metres, angle; /* of a length, in degrees of an angle */
    double position[3];   /* of the root */
    hg_clip *clip;
    int of_joint[CLIP_MAX_JOINTS];
} skeleton;

static int find_bone(const skeleton *s, hg_word word)
{
    for (int i = 0; i < s->bones; i++)
        if (s->bone[i].name && hg_word_is(word, s->bone[i].name)) return i;
    return -1;
}

/* "order TX TY TZ RX RY RZ" or "dof rx ry rz", up to the end of the line */
static hg_status read_freedoms(hg_lines *lines, bone *b)
{
    static const char *const names[] = { "tx", "ty", "tz", "rx", "ry", "rz", "l" };
    hg_word word;
    b->freedoms = 0;
    while (hg_lines_word(lines, &word)) {
        int kind = 0;
        while (kind < 7 && !hg_word_is_any_case(word, names[kind])) kind++;
        if (kind == 7)
            return hg_lines_fail(lines, "\"%.*s\" is not a degree of freedom", hg_word_length(word), word.at);
        if (b->freedoms == 7) return hg_lines_fail(lines, "more than 7 degrees of freedom");
        b->freedom[b->freedoms++] = (int8_t)kind;
    }
    return HG_OK;
}

/* "axis 0 0 20 XYZ": angles and the order in which they are applied */
static hg_status read_axis(hg_lines *lines, const skeleton *s, bone *b)
{
    double angle[3];
    hg_word order;
    for (int k = 0; k < 3; k++) HG_TRY(hg_lines_number(lines, &angle[k], "axis"));
    if (!hg_lines_word(lines, &order)) order = (hg_word){ "XYZ", 3 };
    b->axis = hg_quatd_identity();
    for (size_t i = 0; i < order.size; i++) {
        const char *letters = "xyzXYZ", *at = order.at[i] ? strchr(letters, order.at[i]) : NULL;
        if (!at || order.size != 3)
            return hg_lines_fail(lines, "\"%.*s\" is not an order of axes", hg_word_length(order), order.at);
        int k = (int)(at - letters) % 3;
        b->axis = hg_quatd_mul(clip_turn(k, angle[k] * s->angle), b->axis);
    }
    return HG_OK;
}

static hg_status read_units(skeleton *s, hg_lines *lines, hg_word key)
{
    hg_word word;
    if (hg_word_is(key, "length")) {
        double length;
        HG_TRY(hg_lines_number(lines, &length, "length"));
        if (!(length > 1e-6 && length < 1e6)) return hg_lines_fail(lines, "a unit of length of %g", length);
        s->metres = 0.0254 / length;
    } else if (hg_word_is(key, "angle") && hg_lines_word(lines, &word)) {
        s->angle = hg_word_is_any_case(word, "rad") ? 1 / CLIP_RADIANS : 1;
    }
    return HG_OK;
}

static hg_status read_root(skeleton *s, hg_lines *lines, hg_word key)
{
    bone *root = s->bone;
    if (hg_word_is(key, "order")) return read_freedoms(lines, root);
    if (hg_word_is(key, "position"))
        for (int k = 0; k < 3; k++) HG_TRY(hg_lines_number(lines, &s->position[k], "position"));
    if (hg_word_is(key, "orientation")) return read_axis(lines, s, root);
    return HG_OK; /* "axis XYZ" is the order of the orientation, which is zero in every file of the database */
}

static hg_status read_bone(skeleton *s, hg_lines *lines, hg_word key)
{
    hg_word word;
    if (hg_word_is(key, "begin")) {
        if (s->bones == CLIP_MAX_JOINTS) return hg_lines_fail(lines, "more than %d bones", CLIP_MAX_JOINTS);
        s->bone[s->bones++] = (bone){ .joint = -1, .axis = { 1, 0, 0, 0 } };
        return HG_OK;
    }
    bone *b = s->bone + s->bones - 1;
    if (s->bones == 1) return hg_lines_fail(lines, "\"%.*s\" before the first \"begin\"", hg_word_length(key), key.at);
    if (hg_word_is(key, "name")) {
        if (!hg_lines_word(lines, &word)) return hg_lines_fail(lines, "a bone without a name");
        if (b->name || find_bone(s, word) >= 0)
            return hg_lines_fail(lines, "a second bone \"%.*s\"", hg_word_length(word), word.at);
        b->name = hg_word_copy(word);
        return b->name ? HG_OK : HG_MEMORY;
    }
    if (hg_word_is(key, "direction")) {
        double d[3];
        for (int k = 0; k < 3; k++) HG_TRY(hg_lines_number(lines, &d[k], "direction"));
        b->direction = hg_vec3d_load(d);
    } else if (hg_word_is(key, "length")) {
        return hg_lines_number(lines, &b->length, "length");
    } else if (hg_word_is(key, "axis")) {
        return read_axis(lines, s, b);
    } else if (hg_word_is(key, "dof")) {
        return read_freedoms(lines, b);
    } /* id, limits and masses are not needed */
    return HG_OK;
}

/* "parent child child ..." */
static hg_status read_children(skeleton *s, hg_lines *lines, hg_word key)
{
    if (hg_word_is(key, "begin") || hg_word_is(key, "end")) return HG_OK;
    hg_clip *clip = s->clip;
    int parent = find_bone(s, key);
    if (parent < 0 || s->bone[parent].joint < 0)
        return hg_lines_fail(lines,
                             "bone \"%.*s\" has children before it is itself a child of the root or a bone above",
                             hg_word_length(key), key.at);
    for (hg_word word; hg_lines_word(lines, &word);) {
        int child = find_bone(s, word);
        if (child < 0) return hg_lines_fail(lines, "no bone \"%.*s\" in :bonedata", hg_word_length(word), word.at);
        bone *b = s->bone + child;
        if (b->joint >= 0) return hg_lines_fail(lines, "bone \"%s\" has two parents", b->name);
        b->joint = (int)clip->joints++;
        s->of_joint[b->joint] = child;
        clip->parent[b->joint] = s->bone[parent].joint;
        hg_vec3d offset = hg_vec3d_scale(s->bone[parent].direction, s->bone[parent].length * s->metres);
        hg_vec3d_store(clip->offset + 3 * b->joint, offset);
        if (!(clip->name[b->joint] = hg_strdup(b->name))) return HG_MEMORY;
    }
    return HG_OK;
}

static hg_status read_skeleton(skeleton *s, hg_lines *lines)
{
    enum { OTHER, UNITS, ROOT, BONES, HIERARCHY } section = OTHER;
    s->bone = hg_alloc(CLIP_MAX_JOINTS, sizeof *s->bone);
    if (!s->bone) return HG_MEMORY;
    HG_TRY(clip_create(&s->clip, CLIP_MAX_JOINTS));
    s->clip->joints = 1;
    s->bones = 1;
    s->bone[0].name = hg_strdup("root");
    s->bone[0].axis = hg_quatd_identity();
    s->clip->name[0] = hg_strdup("root");
    s->metres = CLIP_CMU_METRES;
    s->angle = 1;
    if (!s->bone[0].name || !s->clip->name[0]) return HG_MEMORY;
    while (hg_lines_next(lines)) {
        hg_word key;
        hg_lines_word(lines, &key);
        if (*key.at == ':') {
            section = hg_word_is(key, ":units")       ? UNITS
                      : hg_word_is(key, ":root")      ? ROOT
                      : hg_word_is(key, ":bonedata")  ? BONES
                      : hg_word_is(key, ":hierarchy") ? HIERARCHY
                                                      : OTHER;
        } else if (section == UNITS) {
            HG_TRY(read_units(s, lines, key));
        } else if (section == ROOT) {
            HG_TRY(read_root(s, lines, key));
        } else if (section == BONES && !hg_word_is(key, "end") && *key.at != '(') {
            HG_TRY(read_bone(s, lines, key));
        } else if (section == HIERARCHY) {
            HG_TRY(read_children(s, lines, key));
        }
    }
    if (s->bones < 2 || s->bone[0].freedoms == 0)
        return hg_lines_fail(lines, "the file ends without %s",
                             s->bones < 2 ? ":bonedata" : "an order of the root's freedoms");
    for (int i = 0; i < s->bones; i++)
        if (s->bone[i].joint < 0)
            return hg_lines_fail(lines, "the file ends without a place for bone \"%s\" in :hierarchy; it is truncated",
                                 s->bone[i].name ? s->bone[i].name : "(no name)");
    return HG_OK;
}

/* ---- the clip ------------------------------------------------------------------------------------------------ */

static hg_status add_frame(hg_clip *clip, int64_t *capacity)
{
    if (clip->frames == *capacity) {
        int64_t larger = 2 * *capacity + 64;
        double *rotation = hg_resize(clip->rotation, (size_t)(*capacity * clip->joints),
                                     (size_t)(larger * clip->joints), 4 * sizeof *rotation);
        if (!rotation) return HG_MEMORY;
        clip->rotation = rotation;
        double *translation = hg_resize(clip->translation, (size_t)*capacity, (size_t)larger, 3 * sizeof *translation);
        if (!translation) return HG_MEMORY;
        clip->translation = translation;
        *capacity = larger;
    }
    for (int64_t j = 0; j < clip->joints; j++) clip->rotation[4 * (clip->frames * clip->joints + j)] = 1;
    clip->frames++;
    return HG_OK;
}

static hg_status read_values(const skeleton *s, hg_lines *lines, const bone *b, double degrees)
{
    hg_clip *clip = s->clip;
    int64_t t = clip->frames - 1;
    hg_quatd turn = hg_quatd_identity();
    double place[3] = { 0 };
    for (int i = 0; i < b->freedoms; i++) {
        double value;
        HG_TRY(hg_lines_number(lines, &value, b->name));
        if (b->freedom[i] >= RX && b->freedom[i] <= RZ)
            turn = hg_quatd_mul(clip_turn(b->freedom[i] - RX, value * degrees), turn);
        else if (b->freedom[i] <= TZ)
            place[b->freedom[i] - TX] = value;
    }
    hg_word word;
    if (hg_lines_word(lines, &word))
        return hg_lines_fail(lines, "%s: more values than its %d degrees of freedom", b->name, b->freedoms);
    hg_quatd local = hg_quatd_mul(hg_quatd_mul(b->axis, turn), hg_quatd_conj(b->axis));
    hg_quatd_store(clip->rotation + 4 * (t * clip->joints + b->joint), local);
    if (b->joint == 0)
        for (int k = 0; k < 3; k++) clip->translation[3 * t + k] = (place[k] + s->position[k]) * s->metres;
    return HG_OK;
}

static hg_status check_frame(const skeleton *s, const hg_lines *lines, const bool *given, int64_t number)
{
    for (int i = 0; i < s->bones; i++)
        if (s->bone[i].freedoms > 0 && !given[i])
            return hg_lines_fail(
                lines,
                "frame %lld ends without values for \"%s\"; the file is truncated, or belongs to another skeleton",
                (long long)number, s->bone[i].name);
    return HG_OK;
}

static hg_status read_clip(const skeleton *s, hg_lines *lines)
{
    hg_clip *clip = s->clip;
    int64_t capacity = 0, number = 0, previous = 0;
    double degrees = 1;
    bool given[CLIP_MAX_JOINTS] = { false };
    clip->rate = RATE;
    while (hg_lines_next(lines)) {
        hg_word word;
        hg_lines_word(lines, &word);
        if (*word.at == ':') {
            if (hg_word_is_any_case(word, ":radians")) degrees = 1 / CLIP_RADIANS;
            continue;
        }
        if (hg_word_integer(word, &number)) {
            if (clip->frames > 0) HG_TRY(check_frame(s, lines, given, previous));
            if (clip->frames > 0 && number != previous + 1)
                return hg_lines_fail(lines, "frame %lld follows frame %lld", (long long)number, (long long)previous);
            previous = number;
            memset(given, 0, sizeof given);
            HG_TRY(add_frame(clip, &capacity));
            continue;
        }
        int which = find_bone(s, word);
        if (which < 0) return hg_lines_fail(lines, "no bone \"%.*s\" in the skeleton", hg_word_length(word), word.at);
        if (clip->frames == 0 || given[which])
            return hg_lines_fail(lines, "values for \"%s\" %s", s->bone[which].name,
                                 clip->frames ? "twice in a frame" : "before the first frame number");
        given[which] = true;
        HG_TRY(read_values(s, lines, s->bone + which, degrees));
    }
    if (clip->frames == 0) return hg_lines_fail(lines, "no frame in the file");
    return check_frame(s, lines, given, previous);
}

hg_status hg_clip_read_amc(hg_clip **clip, const char *asf, const char *amc)
{
    *clip = NULL;
    hg_lines lines;
    skeleton s = { 0 };
    HG_TRY(hg_lines_open(&lines, asf));
    hg_status status = read_skeleton(&s, &lines);
    hg_lines_close(&lines);
    if (status == HG_OK) status = hg_lines_open(&lines, amc);
    if (status == HG_OK) {
        status = read_clip(&s, &lines);
        hg_lines_close(&lines);
    }
    for (int i = 0; i < s.bones; i++) hg_free(s.bone[i].name);
    hg_free(s.bone);
    if (status == HG_OK)
        *clip = s.clip;
    else
        hg_clip_destroy(s.clip);
    return status;
}

static hg_status read_file(hg_clip **clip, const char *path, const hg_import *with, hg_text *notes)
{
    (void)notes;
    if (!with->skeleton) return hg_fail(HG_INVALID, "%s: an .amc file needs its skeleton: --skeleton X.asf", path);
    return hg_clip_read_amc(clip, with->skeleton, path);
}

static const hg_clip_reader reader = { .extension = "amc", .what = "CMU motion, with its .asf", .read = read_file };
HG_REGISTER("motion reader", amc, &reader);
