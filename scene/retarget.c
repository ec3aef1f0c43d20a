/* Puts a clip of one skeleton on a body with another rest pose, and other names (joints.c has them).
 *
 * With G the global rotation of a joint against its own rest pose, G_body(j) = G_clip(j) O_j. O_j is the identity for
 * hips, spine, neck, head and shoulders (to align bones there would straighten the neck and shrug the shoulders). Along
 * arms and legs it takes the body's bone to the clip's by the smallest rotation, after what the bone above has turned:
 * O_j = minarc(O_parent b_j -> d_j) O_parent. Hands and fingers keep the O of the forearm; feet take straight down to
 * the clip's shin, which leaves soles flat, where they are not flat in the clip's rest pose already. A clip and a body of
 * SMPL rest alike: there all O are the identity. A joint that the clip lacks between two that it has (the upper neck) shares
 * their turn; others follow the joint above. The root follows the middle between the two thigh joints, scaled by the
 * length of the legs. The clip's floor is y = 0 and stays there. */
#include "scene/clip.h"
#include "scene/joints.h"

#include <stdio.h>
#include <string.h>

typedef struct {
    const hg_clip *clip;
    const hg_body *body;
    joint_family clip_family, body_family;
    bool same_rest;   /* both rigs rest alike: rotations are taken as they are */
    int *source;      /* [J] joint of the clip, -1: none */
    int *heir;        /* [J] of a joint that the clip lacks between two that it has: the lower one; -1: none */
    hg_quatd *offset; /* [J] O */
    double scale;
    hg_quatd *from; /* [clip joints] global, one frame */
    hg_vec3d *from_place;
    hg_quatd *to; /* [J] */
    hg_vec3d *to_place;
} retarget;

/* The joint of the body that plays a part, by the part's own name; -1: none. */
static int body_part(const retarget *r, const char *name)
{
    const joint_row *row = joints_row(name, JOINTS_OWN);
    return row ? joints_find_row(r->body->joint_name, r->body->joints, row, r->body_family) : -1;
}

/* By the part that it plays; a joint that plays none, or that the clip's family does not name, by its own name: `lhand`
 * alone says nothing, an .asf and Poser differ about it. */
static int source_of(const retarget *r, const char *name)
{
    const hg_clip *clip = r->clip;
    const joint_row *row = joints_row(name, r->body_family);
    int joint = row ? joints_find_row(clip->name, clip->joints, row, r->clip_family) : -1;
    bool settled = row && (r->clip_family == JOINTS_ASF || r->clip_family == JOINTS_POSER ||
                           (r->clip_family != r->body_family && row->name[r->clip_family]));
    return joint >= 0 || settled ? joint : clip_joint(clip, name);
}

static hg_vec3d body_joint(const hg_body *body, int joint)
{
    const float *p = body->joint + 3 * (int64_t)joint;
    return hg_vec3d_make((double)p[0], (double)p[1], (double)p[2]);
}

/* The bone from joint to the part `end` in the body and in the clip; false when either lacks it or has it at length 0. */
static bool bones(const retarget *r, int joint, const char *end, hg_vec3d *in_body, hg_vec3d *in_clip)
{
    int last = body_part(r, end);
    if (joint < 0 || last < 0 || r->source[joint] < 0 || r->source[last] < 0) return false;
    *in_body = hg_vec3d_sub(body_joint(r->body, last), body_joint(r->body, joint));
    *in_clip = hg_vec3d_load(r->clip->offset + 3 * (int64_t)r->source[last]);
    return hg_vec3d_norm(*in_body) > 1e-6 && hg_vec3d_norm(*in_clip) > 1e-6;
}

static void find_offsets(retarget *r)
{
    const hg_body *body = r->body;
    for (int j = 0; j < body->joints; j++) {
        const joint_row *row = joints_row(body->joint_name[j], r->body_family);
        hg_quatd above = body->parent[j] >= 0 ? r->offset[body->parent[j]] : hg_quatd_identity();
        hg_vec3d in_body, in_clip;
        r->offset[j] = hg_quatd_identity();
        if (!row || r->same_rest) continue;
        if (row->rule == JOINT_PARENT) r->offset[j] = above;
        if (row->rule == JOINT_CHAIN && bones(r, j, row->other, &in_body, &in_clip)) {
            hg_vec3d turned = hg_quatd_rotate(above, hg_vec3d_normalize(in_body));
            r->offset[j] = hg_quatd_mul(hg_quatd_between(turned, hg_vec3d_normalize(in_clip)), above);
        }
        if (row->rule == JOINT_SOLE && !joints_flat(r->clip_family)) {
            const joint_row *shin = joints_row(row->other, JOINTS_OWN);
            if (bones(r, body_part(r, row->other), shin->other, &in_body, &in_clip))
                r->offset[j] = hg_quatd_between(hg_vec3d_make(0, -1, 0), hg_vec3d_normalize(in_clip));
        }
    }
}

/* Length of the legs in the body over that in the clip; without legs, from hips to head. */
static void find_scale(retarget *r)
{
    static const char *const leg[] = { "LeftUpLeg", "LeftLeg", "RightUpLeg", "RightLeg" };
    double in_body = 0, in_clip = 0;
    hg_vec3d a, b;
    for (int i = 0; i < 4; i++)
        if (bones(r, body_part(r, leg[i]), joints_row(leg[i], JOINTS_OWN)->other, &a, &b)) {
            in_body += hg_vec3d_norm(a);
            in_clip += hg_vec3d_norm(b);
        }
    if (!(in_body > 0)) {
        int head = hg_body_joint(r->body, "Head");
        in_body = fabs(body_joint(r->body, head).y - body_joint(r->body, 0).y);
        for (int j = r->source[head]; j >= 0 && r->clip->parent[j] >= 0; j = r->clip->parent[j])
            in_clip += r->clip->offset[3 * j + 1];
        in_clip = fabs(in_clip);
    }
    r->scale = in_body > 1e-6 && in_clip > 1e-6 ? in_body / in_clip : 1;
}

/* A neck of two bones under a clip with one: the turn between neck and head is shared. Bones of length zero turn nothing. */
static void find_heirs(retarget *r)
{
    const hg_body *body = r->body;
    for (int j = 0; j < body->joints; j++) {
        int parent = body->parent[j], children = 0;
        r->heir[j] = -1;
        if (r->source[j] >= 0 || parent < 0 || r->source[parent] < 0) continue;
        for (int k = j + 1; k < body->joints; k++) {
            if (body->parent[k] != j) continue;
            children++;
            r->heir[j] = r->source[k] >= 0 ? k : -1;
        }
        if (children != 1 || !(hg_vec3d_distance(body_joint(body, j), body_joint(body, parent)) > 1e-4))
            r->heir[j] = -1;
    }
}

static hg_status prepare(retarget *r)
{
    const hg_clip *clip = r->clip;
    const hg_body *body = r->body;
    r->source = hg_alloc((size_t)body->joints, sizeof *r->source);
    r->heir = hg_alloc((size_t)body->joints, sizeof *r->heir);
    r->offset = hg_alloc((size_t)body->joints, sizeof *r->offset);
    r->from = hg_alloc((size_t)clip->joints, sizeof *r->from);
    r->from_place = hg_alloc((size_t)clip->joints, sizeof *r->from_place);
    r->to = hg_alloc((size_t)body->joints, sizeof *r->to);
    r->to_place = hg_alloc((size_t)body->joints, sizeof *r->to_place);
    if (!r->source || !r->heir || !r->offset || !r->from || !r->from_place || !r->to || !r->to_place) return HG_MEMORY;
    r->clip_family = joints_family(clip->name, clip->joints);
    r->body_family = joints_family(body->joint_name, body->joints);
    r->same_rest = clip->standard_rest && r->clip_family == r->body_family;
    for (int64_t j = 0; j < body->joints; j++) r->source[j] = source_of(r, body->joint_name[j]);
    r->source[0] = r->source[0] >= 0 ? r->source[0] : 0; /* the roots belong together, whatever their names */
    static const char *const needed[] = { "Head", "Neck" };
    for (int i = 0; i < 2; i++) {
        int joint = hg_body_joint(body, needed[i]);
        if (joint < 0 || r->source[joint] < 0)
            return hg_fail(
                HG_INVALID,
                "the %s has no joint for \"%s\"; names of CMU skeletons (.asf, or .bvh made from them), of SMPL, of "
                "Mixamo and of game engines are understood, and those of the body itself",
                joint < 0 ? "body" : "clip", needed[i]);
    }
    find_heirs(r);
    find_offsets(r);
    find_scale(r);
    return HG_OK;
}

static void pose_clip(retarget *r, int64_t t)
{
    const hg_clip *clip = r->clip;
    for (int64_t j = 0; j < clip->joints; j++) {
        int parent = clip->parent[j];
        hg_quatd local = hg_quatd_load(clip->rotation + 4 * (t * clip->joints + j));
        if (parent < 0) {
            r->from[j] = local;
            r->from_place[j] =
                hg_vec3d_add(hg_vec3d_load(clip->translation + 3 * t), hg_vec3d_load(clip->offset + 3 * j));
        } else {
            r->from[j] = hg_quatd_normalize(hg_quatd_mul(r->from[parent], local));
            r->from_place[j] = hg_vec3d_add(r->from_place[parent],
                                            hg_quatd_rotate(r->from[parent], hg_vec3d_load(clip->offset + 3 * j)));
        }
    }
}

/* One frame: rotation [J,4], translation [3]. */
static void retarget_frame(retarget *r, int64_t t, float *rotation, float *translation, const float *previous)
{
    const hg_body *body = r->body;
    pose_clip(r, t);
    for (int j = 0; j < body->joints; j++) {
        int parent = body->parent[j];
        hg_quatd above = parent >= 0 ? r->to[parent] : hg_quatd_identity();
        int heir = r->heir[j], source = r->source[heir >= 0 ? heir : j];
        r->to[j] =
            source >= 0 ? hg_quatd_normalize(hg_quatd_mul(r->from[source], r->offset[heir >= 0 ? heir : j])) : above;
        if (heir >= 0) r->to[j] = hg_quatd_slerp(above, r->to[j], 0.5);
        r->to_place[j] = body_joint(body, j);
        if (parent >= 0) {
            hg_vec3d bone = hg_vec3d_sub(body_joint(body, j), body_joint(body, parent));
            r->to_place[j] = hg_vec3d_add(r->to_place[parent], hg_quatd_rotate(above, bone));
        }
        hg_quatd local = hg_quatd_normalize(hg_quatd_mul(hg_quatd_conj(above), r->to[j]));
        if (previous) { /* the short way from the frame before, so that frames can be mixed */
            const float *q = previous + 4 * j;
            double c =
                local.w * (double)q[0] + local.x * (double)q[1] + local.y * (double)q[2] + local.z * (double)q[3];
            if (c < 0) local = hg_quatd_neg(local);
        }
        rotation[4 * j] = (float)local.w;
        rotation[4 * j + 1] = (float)local.x;
        rotation[4 * j + 2] = (float)local.y;
        rotation[4 * j + 3] = (float)local.z;
    }
    int left = body_part(r, "LeftUpLeg"), right = body_part(r, "RightUpLeg");
    bool legs = left >= 0 && right >= 0 && r->source[left] >= 0 && r->source[right] >= 0;
    hg_vec3d place = legs ? hg_vec3d_mix(r->to_place[left], r->to_place[right], 0.5) : r->to_place[0];
    hg_vec3d asked = legs ? hg_vec3d_mix(r->from_place[r->source[left]], r->from_place[r->source[right]], 0.5)
                          : r->from_place[r->source[0]];
    hg_vec3d move = hg_vec3d_sub(hg_vec3d_scale(asked, r->scale), place);
    translation[0] = (float)move.x;
    translation[1] = (float)move.y;
    translation[2] = (float)move.z;
}

hg_status hg_clip_retarget(hg_motion **motion, const hg_clip *clip, const hg_body *body, double rate)
{
    *motion = NULL;
    if (!(rate > 0) || !isfinite(rate)) return hg_fail(HG_INVALID, "a rate of %g frames per second", rate);
    if (clip->frames < 1 || clip->joints < 1)
        return hg_fail(HG_INVALID, "a clip of %lld frames and %lld joints", (long long)clip->frames,
                       (long long)clip->joints);
    /* Whole ratios take every k-th frame as it is; others go over slerp. */
    double ratio = clip->rate / rate, whole = round(ratio);
    bool exact = whole >= 1 && fabs(ratio - whole) < 1e-9 * whole;
    int64_t step = exact ? (int64_t)whole : 1, frames = (clip->frames - 1) / step + 1;
    hg_motion *full = NULL;
    retarget r = { .clip = clip, .body = body };
    hg_status status = prepare(&r);
    if (status == HG_OK) status = hg_motion_create(&full, frames, body, exact ? rate : clip->rate);
    for (int64_t t = 0; status == HG_OK && t < frames; t++) {
        float *rotation = full->rotation + 4 * t * body->joints;
        retarget_frame(&r, t * step, rotation, full->translation + 3 * t, t > 0 ? rotation - 4 * body->joints : NULL);
    }
    hg_free(r.source);
    hg_free(r.heir);
    hg_free(r.offset);
    hg_free(r.from);
    hg_free(r.from_place);
    hg_free(r.to);
    hg_free(r.to_place);
    if (status == HG_OK && !exact) {
        status = hg_motion_resample(motion, full, rate);
        hg_motion_destroy(full);
        full = NULL;
    }
    if (status == HG_OK && exact)
        *motion = full;
    else if (status != HG_OK)
        hg_motion_destroy(full);
    return status;
}
