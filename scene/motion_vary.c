/* More motions from those there are: mirrored left to right, and with another movement on top. A person is recorded for a
 * few minutes; a network that has only seen those poses does not know what to do with others. */
#include "scene/internal.h"

#include <ctype.h>
#include <stdio.h>
#include <string.h>

/* LeftArm <-> RightArm, LThumb <-> RThumb; any other joint is its own. -1 when the other side is missing. */
static int64_t other_side(const hg_motion *motion, int64_t joint)
{
    static const char *const sides[2] = { "Left", "Right" };
    const char *name = motion->joint_name[joint];
    char other[128] = "";
    for (int k = 0; k < 2; k++) {
        const size_t word = strlen(sides[k]);
        if (!strncmp(name, sides[k], word))
            snprintf(other, sizeof other, "%s%s", sides[!k], name + word);
        else if (name[0] == sides[k][0] && isupper((unsigned char)name[1]))
            snprintf(other, sizeof other, "%c%s", sides[!k][0], name + 1);
    }
    if (!other[0]) return joint;
    for (int64_t j = 0; j < motion->joints; j++)
        if (!strcmp(motion->joint_name[j], other)) return j;
    return -1;
}

static hg_status like(hg_motion **out, const hg_motion *motion, char *name)
{
    hg_motion *m = NULL;
    hg_status status = name ? HG_OK : HG_MEMORY;
    if (status == HG_OK)
        status = scene_motion_allocate(&m, motion->frames, motion->joints, motion->joint_name, motion->rate);
    if (status != HG_OK) {
        hg_free(name);
        return status;
    }
    m->name = name;
    *out = m;
    return HG_OK;
}

hg_status hg_motion_mirror(hg_motion **out, const hg_motion *motion)
{
    *out = NULL;
    for (int64_t j = 0; j < motion->joints; j++)
        if (other_side(motion, j) < 0)
            return hg_fail(HG_INVALID,
                           "%s: joint %s has no counterpart on the other side, so the motion cannot be mirrored",
                           motion->name ? motion->name : "motion", motion->joint_name[j]);
    hg_motion *m = NULL;
    HG_TRY(like(&m, motion, hg_format("%s mirrored", motion->name ? motion->name : "motion")));
    for (int64_t j = 0; j < motion->joints; j++) {
        const int64_t from = other_side(motion, j);
        for (int64_t t = 0; t < motion->frames; t++) {
            const float *q = motion->rotation + 4 * (t * motion->joints + from);
            float *to = m->rotation + 4 * (t * motion->joints + j);
            to[0] = q[0], to[1] = q[1], to[2] = -q[2], to[3] = -q[3];
        }
    }
    for (int64_t t = 0; t < motion->frames; t++) {
        const float *way = motion->translation + 3 * t;
        float *to = m->translation + 3 * t;
        to[0] = -way[0], to[1] = way[1], to[2] = way[2];
    }
    *out = m;
    return HG_OK;
}

hg_status hg_motion_combine(hg_motion **out, const hg_motion *motion, const hg_motion *above)
{
    *out = NULL;
    if (above->joints != motion->joints || above->frames < 1)
        return hg_fail(HG_INVALID, "motions of %lld and %lld joints cannot be combined: both must be of one body",
                       (long long)motion->joints, (long long)above->joints);
    hg_motion *m = NULL;
    HG_TRY(like(&m, motion,
                hg_format("%s + %s", motion->name ? motion->name : "motion", above->name ? above->name : "motion")));
    for (int64_t t = 0; t < motion->frames; t++) {
        const int64_t u = t < above->frames ? t : above->frames - 1;
        for (int64_t j = 0; j < motion->joints; j++) {
            const hg_quatd p = hg_quatd_from_f(hg_quatf_load(motion->rotation + 4 * (t * motion->joints + j)));
            const hg_quatd q = hg_quatd_from_f(hg_quatf_load(above->rotation + 4 * (u * motion->joints + j)));
            hg_quatf_store(m->rotation + 4 * (t * motion->joints + j),
                           hg_quatf_from_d(hg_quatd_normalize(hg_quatd_mul(p, q))));
        }
        for (int c = 0; c < 3; c++)
            m->translation[3 * t + c] = motion->translation[3 * t + c] + above->translation[3 * u + c];
    }
    *out = m;
    return HG_OK;
}
