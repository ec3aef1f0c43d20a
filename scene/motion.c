/* Motions: memory, files, other frame rates. */
#include "scene/internal.h"

#include <string.h>

#define MOTION_FORMAT "hairgrad motion"

hg_status scene_motion_allocate(hg_motion **motion, int64_t frames, int64_t joints, char *const *names, double rate)
{
    *motion = NULL;
    if (frames < 1 || frames > INT32_MAX || joints < 1 || !(rate > 0 && isfinite(rate)))
        return hg_fail(HG_INVALID, "motion of %lld frames, %lld joints, %g frames per second: all must be positive",
                       (long long)frames, (long long)joints, rate);
    hg_motion *m = hg_alloc(1, sizeof *m);
    if (!m) return HG_MEMORY;
    m->frames = frames, m->joints = joints, m->rate = rate;
    m->rotation = hg_alloc((size_t)frames, (size_t)joints * 4 * sizeof *m->rotation);
    m->translation = hg_alloc((size_t)frames, 3 * sizeof *m->translation);
    m->joint_name = scene_texts_copy(names, joints);
    if (!m->rotation || !m->translation || !m->joint_name) {
        hg_motion_destroy(m);
        return HG_MEMORY;
    }
    for (int64_t i = 0; i < frames * joints; i++) m->rotation[4 * i] = 1;
    *motion = m;
    return HG_OK;
}

hg_status hg_motion_create(hg_motion **motion, int64_t frames, const hg_body *body, double rate)
{
    return scene_motion_allocate(motion, frames, body->joints, body->joint_name, rate);
}

void hg_motion_destroy(hg_motion *motion)
{
    if (!motion) return;
    hg_texts_free(motion->joint_name, (int)motion->joints);
    hg_free(motion->rotation);
    hg_free(motion->translation);
    hg_free(motion->name);
    hg_free(motion);
}

/* ---- files -------------------------------------------------------------------------------------------------- */

static void list_absent(hg_text *text, char *const *names, int64_t n, char *const *in, int64_t n_in)
{
    int listed = 0;
    for (int64_t i = 0; i < n; i++) {
        bool found = false;
        for (int64_t k = 0; k < n_in && !found; k++) found = strcmp(names[i], in[k]) == 0;
        if (found) continue;
        if (listed < 8) hg_text_add(text, "%s%.40s", listed ? ", " : "", names[i]);
        listed++;
    }
    if (listed > 8) hg_text_add(text, " and %d more", listed - 8);
}

/* The joints must be the body's; where only their order differs they are brought into the body's. */
static hg_status motion_match(hg_motion *m, const char *path, const hg_body *body)
{
    hg_text missing = { 0 }, extra = { 0 };
    list_absent(&missing, body->joint_name, body->joints, m->joint_name, m->joints);
    list_absent(&extra, m->joint_name, m->joints, body->joint_name, body->joints);
    hg_status status = missing.failed || extra.failed ? HG_MEMORY : HG_OK;
    if (status == HG_OK && (missing.size || extra.size || m->joints != body->joints))
        status = hg_fail(HG_INVALID,
                         "%s: the motion is not of this body's joints: missing %s; extra %s; import it for this body",
                         path, missing.size ? missing.data : "none",
                         extra.size                  ? extra.data
                         : m->joints != body->joints ? "a name given twice"
                                                     : "none");
    hg_text_free(&missing);
    hg_text_free(&extra);
    HG_TRY(status);

    bool same = true;
    for (int64_t j = 0; j < m->joints; j++) same &= strcmp(m->joint_name[j], body->joint_name[j]) == 0;
    if (same) return HG_OK;
    float *row = hg_alloc((size_t)m->joints, 4 * sizeof *row);
    char **names = scene_texts_copy(body->joint_name, body->joints);
    if (row && names) {
        for (int64_t t = 0; t < m->frames; t++) {
            float *frame = m->rotation + 4 * m->joints * t;
            for (int64_t j = 0; j < m->joints; j++)
                memcpy(row + 4 * hg_body_joint(body, m->joint_name[j]), frame + 4 * j, 4 * sizeof *row);
            memcpy(frame, row, (size_t)m->joints * 4 * sizeof *row);
        }
        hg_texts_free(m->joint_name, (int)m->joints);
        m->joint_name = names;
        names = NULL;
    } else {
        status = HG_MEMORY;
    }
    hg_free(row);
    if (names) hg_texts_free(names, (int)body->joints);
    return status;
}

static hg_status motion_check(const hg_motion *m, const char *path)
{
    HG_TRY(scene_check_finite(path, "rotation", m->rotation, m->frames * m->joints, 4));
    HG_TRY(scene_check_finite(path, "translation", m->translation, m->frames, 3));
    for (int64_t i = 0; i < m->frames * m->joints; i++) {
        const float *q = m->rotation + 4 * i;
        double norm = 0;
        for (int k = 0; k < 4; k++) norm += (double)q[k] * (double)q[k];
        if (fabs(norm - 1) > 1e-3)
            return hg_fail(HG_FORMAT,
                           "%s: the rotation of joint %s in frame %lld has the norm %g, expected a unit quaternion",
                           path, m->joint_name[i % m->joints], (long long)(i / m->joints), sqrt(norm));
    }
    return HG_OK;
}

static hg_status motion_read(hg_h5 *file, const char *path, const scene_axes *axes, void *to)
{
    hg_motion *m = to;
    int64_t shape[6];
    int names = 0;
    HG_TRY(hg_h5_get_number(file, "/", "rate", &m->rate));
    if (!(m->rate > 0 && m->rate <= 1e5))
        return hg_fail(HG_FORMAT, "%s: attribute rate is %g, expected frames per second", path, m->rate);
    HG_TRY(hg_h5_read_texts(file, "/joint_name", &names, &m->joint_name));
    m->joints = names;
    HG_TRY(hg_h5_read(file, "/rotation", HG_F32, 3, (int64_t[]){ -1, names, 4 }, shape, (void **)&m->rotation));
    m->frames = shape[0];
    if (m->frames < 1 || names < 1)
        return hg_fail(HG_FORMAT, "%s: %lld frames of %d joints are no motion", path, (long long)m->frames, names);
    HG_TRY(hg_h5_read(file, "/translation", HG_F32, 2, (int64_t[]){ m->frames, 3 }, NULL, (void **)&m->translation));
    HG_TRY(scene_text_or(file, "name", "", &m->name));
    scene_axes_points(axes, m->translation, m->frames);
    scene_axes_turn(axes, m->rotation, m->frames * m->joints);
    return motion_check(m, path);
}

hg_status hg_motion_load(hg_motion **motion, const char *path, const hg_body *body)
{
    *motion = NULL;
    hg_motion *m = hg_alloc(1, sizeof *m);
    hg_status status = m ? scene_file_load(path, MOTION_FORMAT, motion_read, m) : HG_MEMORY;
    if (status == HG_OK && body) status = motion_match(m, path, body);
    if (status == HG_OK)
        *motion = m;
    else
        hg_motion_destroy(m);
    return status;
}

static hg_status motion_write(hg_h5 *file, const void *from)
{
    const hg_motion *m = from;
    HG_TRY(hg_h5_set_number(file, "/", "rate", m->rate));
    HG_TRY(hg_h5_set_text(file, "/", "name", m->name ? m->name : ""));
    HG_TRY(hg_h5_write_texts(file, "/joint_name", (int)m->joints, (const char *const *)m->joint_name));
    HG_TRY(hg_h5_write(file, "/rotation", HG_F32, 3, (int64_t[]){ m->frames, m->joints, 4 }, m->rotation));
    return hg_h5_write(file, "/translation", HG_F32, 2, (int64_t[]){ m->frames, 3 }, m->translation);
}

hg_status hg_motion_save(const hg_motion *motion, const char *path)
{
    HG_TRY(motion_check(motion, path));
    return scene_file_save(path, MOTION_FORMAT, motion_write, motion);
}

/* ---- frame rates -------------------------------------------------------------------------------------------- */

/* Frames that fall on frames of the motion are copied bit for bit. */
hg_status hg_motion_resample(hg_motion **out, const hg_motion *motion, double rate)
{
    *out = NULL;
    if (!(rate > 0 && rate <= 1e5)) return hg_fail(HG_INVALID, "%g frames per second: expected 0 to 100000", rate);
    double step = motion->rate / rate;
    int64_t frames = (int64_t)floor((double)(motion->frames - 1) / step + 1e-6) + 1, joints = motion->joints;
    hg_motion *m;
    HG_TRY(scene_motion_allocate(&m, frames, joints, motion->joint_name, rate));
    m->name = motion->name ? hg_strdup(motion->name) : NULL;
    if (motion->name && !m->name) {
        hg_motion_destroy(m);
        return HG_MEMORY;
    }
    for (int64_t t = 0; t < frames; t++) {
        double at = fmin((double)t * step, (double)(motion->frames - 1)), nearest = nearbyint(at);
        if (fabs(at - nearest) < 1e-6) at = nearest;
        int64_t a = (int64_t)floor(at), b = a + 1 < motion->frames ? a + 1 : a;
        double s = at - (double)a;
        const float *from = motion->rotation + 4 * joints * a, *to = motion->rotation + 4 * joints * b;
        float *rotation = m->rotation + 4 * joints * t;
        for (int c = 0; c < 3; c++) {
            double x = (double)motion->translation[3 * a + c], y = (double)motion->translation[3 * b + c];
            m->translation[3 * t + c] = s == 0 ? motion->translation[3 * a + c] : (float)(x + s * (y - x));
        }
        if (s == 0) {
            memcpy(rotation, from, (size_t)joints * 4 * sizeof *rotation);
            continue;
        }
        for (int64_t j = 0; j < joints; j++) {
            hg_quatd p = hg_quatd_from_f(hg_quatf_load(from + 4 * j)), q = hg_quatd_from_f(hg_quatf_load(to + 4 * j));
            q = hg_quatd_slerp(hg_quatd_normalize(p), hg_quatd_normalize(q), s);
            hg_quatf_store(rotation + 4 * j, hg_quatf_from_d(q));
        }
    }
    *out = m;
    return HG_OK;
}
