/* features: what the network is told of a frame, and how every input is brought to order one.
 *
 *   [..]                           of the strand or the groom (network_*.c)
 *   [shape 10 | pose: 6 or 3 per joint | 30 x (head acceleration or velocity 3, angular velocity 3 per joint) | materials]
 *                                  of the frame
 *
 * Pose: the first two columns of a joint's rotation, or its rotation vector; local to its parent, but the head's is global with its heading
 * removed: it carries the direction of gravity. Velocities of frame f lie between f - 1 and f: angular ones in the joint's
 * own space in units of 3 rad/s (the head's and the root joint's global, others against their parent); the head's linear
 * one in head space in units of 1 m/s, or (`linear: acceleration`) its change since the frame before, in 10 m/s^2: inertia
 * does not know velocities, so a network that is told of them has to learn not to look; or (`linear: none`) it is left out. Newest frame first; before the
 * clip everything is at rest.
 * Joints are placed on the neutral body, whatever the shape: velocities then depend on the clip alone.
 *
 * Normalisation is fixed at creation: mean and deviation over the training clips (and over all strands), pooled over
 * the frames of the history, with a smallest deviation so that a joint that hardly moves is not blown up. */
#include "tasks/hair.h"

#include "geometry/vector.h"

#include <math.h>
#include <string.h>

static const double linear_unit = 1.0, acceleration_unit = 10.0, angular_unit = 3.0; /* m/s, m/s^2, rad/s */
static const double least_pose = 0.1, least_velocity = 0.2;

/* ---- layout ------------------------------------------------------------------------------------------------- */

bool hg_hair_is_all_joints(const hg_config *config, const char *key)
{
    return hg_config_count(config, key) == 1 && !strcmp(hg_config_text_at(config, key, 0), "all");
}

/* What Quaffure takes of CMU's rig of 31: all but four that say nothing of hair. */
static hg_status all_joints(const hg_config *config, const char *key, const hg_body *body, int *joints, int *count)
{
    static const char *const left_out[] = { "LHipJoint", "RHipJoint", "LThumb", "RThumb" };
    *count = 0;
    for (int64_t j = 0; j < body->joints; j++) {
        bool taken = true;
        for (int i = 0; i < 4; i++) taken &= strcmp(body->joint_name[j], left_out[i]) != 0;
        if (!taken) continue;
        if (*count == HG_HAIR_JOINTS)
            return hg_fail(HG_INVALID,
                           "%s:%d: %s: all: the body has more than %d joints; name those that move the hair",
                           hg_config_name(config), hg_config_line(config, key), key, HG_HAIR_JOINTS);
        joints[(*count)++] = (int)j;
    }
    return HG_OK;
}

static hg_status find_joints(const hg_config *config, const char *key, const hg_body *body, int *joints, int *count)
{
    *count = hg_config_count(config, key);
    if (hg_hair_is_all_joints(config, key)) return all_joints(config, key, body, joints, count);
    if (*count > HG_HAIR_JOINTS)
        return hg_fail(HG_INVALID, "%s:%d: %s: %d joints; at most %d", hg_config_name(config),
                       hg_config_line(config, key), key, *count, HG_HAIR_JOINTS);
    int asked = *count;
    *count = 0;
    for (int i = 0; i < asked; i++) {
        const char *name = hg_config_text_at(config, key, i);
        int joint = hg_body_joint(body, name);
        if (joint >= 0) joints[(*count)++] = joint;
        if (joint >= 0 || hg_hair_is_usual_list(config, key)) continue; /* of the usual ones, those that the body has */
        const char *near = hg_nearest_of(name, (const char *const *)body->joint_name, (int)body->joints);
        return hg_fail(HG_INVALID, "%s:%d: %s: the body has no joint \"%s\"%s%s%s", hg_config_name(config),
                       hg_config_line(config, key), key, name, near ? "; did you mean \"" : "", near ? near : "",
                       near ? "\"?" : "");
    }
    return HG_OK;
}

hg_status hg_hair_layout_create(hg_hair_layout *layout, const hg_config *config, const hg_body *body)
{
    layout->shape = hg_config_flag(config, "features.shape");
    layout->history = (int)hg_config_integer(config, "features.history");
    layout->head = hg_body_joint(body, "Head");
    if (layout->head < 0) return hg_fail(HG_INVALID, "the body has no joint \"Head\", which carries the hair");
    layout->linear = strcmp(hg_config_text(config, "features.linear"), "none") != 0;
    layout->acceleration = !strcmp(hg_config_text(config, "features.linear"), "acceleration");
    layout->pose_columns = strcmp(hg_config_text(config, "features.rotation"), "axis_angle") ? 6 : 3;
    HG_TRY(find_joints(config, "features.pose_joints", body, layout->pose, &layout->n_pose));
    HG_TRY(find_joints(config, "features.velocity_joints", body, layout->velocity, &layout->n_velocity));
    layout->pose_inputs = layout->pose_columns * layout->n_pose;
    layout->velocity_inputs = 3 * layout->linear + 3 * layout->n_velocity;
    layout->frame_inputs = (layout->shape ? HG_SHAPES : 0) + layout->pose_inputs +
                           layout->history * layout->velocity_inputs + layout->materials;
    if (layout->frame_inputs < 1)
        return hg_fail(HG_INVALID,
                       "%s: features: no shape, no pose and no history: the network would not see the frame",
                       hg_config_name(config));
    return HG_OK;
}

/* ---- tracks ------------------------------------------------------------------------------------------------- */

static hg_quatd local_rotation(const hg_motion *motion, int64_t frame, int64_t joint)
{
    const float *q = motion->rotation + (frame * motion->joints + joint) * 4;
    return hg_quatd_make((double)q[0], (double)q[1], (double)q[2], (double)q[3]);
}

void hg_hair_joints(const hg_body *body, const hg_motion *motion, int64_t frame, double *rotation, double *position)
{
    for (int64_t j = 0; j < body->joints; j++) {
        const int32_t parent = body->parent[j];
        const hg_quatd local = local_rotation(motion, frame, j);
        const float *rest = body->joint + 3 * j;
        hg_vec3d at = hg_vec3d_make((double)rest[0], (double)rest[1], (double)rest[2]);
        hg_quatd turn = local;
        if (parent < 0) {
            const float *moved = motion->translation + 3 * frame;
            at = hg_vec3d_add(at, hg_vec3d_make((double)moved[0], (double)moved[1], (double)moved[2]));
        } else {
            const float *from = body->joint + 3 * parent;
            const hg_quatd base = hg_quatd_load(rotation + 4 * parent);
            const hg_vec3d bone = hg_vec3d_sub(at, hg_vec3d_make((double)from[0], (double)from[1], (double)from[2]));
            at = hg_vec3d_add(hg_vec3d_load(position + 3 * parent), hg_quatd_rotate(base, bone));
            turn = hg_quatd_mul(base, local);
        }
        hg_quatd_store(rotation + 4 * j, turn);
        hg_vec3d_store(position + 3 * j, at);
    }
}

/* What is left of a rotation when its turn about +Y is taken off in front: conj(heading) q. */
static hg_quatd without_heading(hg_quatd q)
{
    const double length = sqrt(q.w * q.w + q.y * q.y);
    if (length < 1e-6) return q; /* upside down: every heading is as good */
    return hg_quatd_mul(hg_quatd_make(q.w / length, 0, -q.y / length, 0), q);
}

static void two_columns(hg_quatd q, float *out)
{
    const hg_vec3d x = hg_quatd_rotate(q, hg_vec3d_make(1, 0, 0)), y = hg_quatd_rotate(q, hg_vec3d_make(0, 1, 0));
    out[0] = (float)x.x, out[1] = (float)x.y, out[2] = (float)x.z;
    out[3] = (float)y.x, out[4] = (float)y.y, out[5] = (float)y.z;
}

static void pose_numbers(const hg_hair_layout *layout, hg_quatd q, float *out)
{
    if (layout->pose_columns == 6) {
        two_columns(q, out);
        return;
    }
    const hg_vec3d turn = hg_quatd_to_rotation_vector(q.w < 0 ? hg_quatd_neg(q) : q); /* the short way */
    out[0] = (float)turn.x, out[1] = (float)turn.y, out[2] = (float)turn.z;
}

/* The angular velocity that leads from a to b in one frame, in the space of b, the short way. */
static void angular_velocity(hg_quatd a, hg_quatd b, double rate, float *out)
{
    hg_quatd turn = hg_quatd_mul(hg_quatd_conj(a), b);
    if (turn.w < 0) turn = hg_quatd_neg(turn);
    const hg_vec3d w = hg_vec3d_scale(hg_quatd_to_rotation_vector(turn), rate / angular_unit);
    out[0] = (float)w.x, out[1] = (float)w.y, out[2] = (float)w.z;
}

static hg_quatd joint_rotation(const hg_hair_layout *layout, const hg_motion *motion, const double *rotation,
                               int64_t frame, int joint)
{
    return joint == layout->head ? hg_quatd_load(rotation + 4 * joint) : local_rotation(motion, frame, joint);
}

/* moved: of the head from frame to frame [m]; moved_before: the same a frame earlier. */
static void track_velocity(const hg_hair_layout *layout, const hg_motion *motion, int64_t frame, const double *before,
                           const double *now, hg_vec3d moved, hg_vec3d moved_before, float *out)
{
    if (layout->acceleration) moved = hg_vec3d_sub(moved, moved_before);
    const double unit =
        layout->acceleration ? motion->rate * motion->rate / acceleration_unit : motion->rate / linear_unit;
    const hg_vec3d seen = hg_quatd_rotate(hg_quatd_conj(hg_quatd_load(now + 4 * layout->head)), moved);
    if (layout->linear) {
        out[0] = (float)(seen.x * unit), out[1] = (float)(seen.y * unit), out[2] = (float)(seen.z * unit);
        out += 3;
    }
    for (int i = 0; i < layout->n_velocity; i++) {
        const int joint = layout->velocity[i];
        angular_velocity(joint_rotation(layout, motion, before, frame - 1, joint),
                         joint_rotation(layout, motion, now, frame, joint), motion->rate, out + 3 * i);
    }
}

hg_status hg_hair_track_create(hg_hair_track *track, const hg_hair_layout *layout, const hg_body *body,
                               const hg_motion *motion)
{
    *track = (hg_hair_track){ .frames = motion->frames };
    if (motion->joints != body->joints)
        return hg_fail(HG_INVALID, "%s: %lld joints, the body has %lld; retarget the motion to this body",
                       motion->name ? motion->name : "motion", (long long)motion->joints, (long long)body->joints);
    const size_t joints = (size_t)body->joints, frames = (size_t)motion->frames;
    double *scratch = hg_alloc(joints * 14, sizeof *scratch);
    track->pose = hg_alloc(frames * (size_t)(layout->pose_inputs ? layout->pose_inputs : 1), sizeof(float));
    track->velocity = hg_alloc(frames * (size_t)(layout->velocity_inputs ? layout->velocity_inputs : 1), sizeof(float));
    if (!scratch || !track->pose || !track->velocity) {
        hg_free(scratch);
        hg_hair_track_destroy(track);
        return HG_MEMORY;
    }
    double *rotation[2] = { scratch, scratch + 4 * joints },
           *place[2] = { scratch + 8 * joints, scratch + 11 * joints };
    hg_vec3d moved = hg_vec3d_make(0, 0, 0);
    for (int64_t t = 0; t < motion->frames; t++) {
        const int now = (int)(t & 1);
        hg_hair_joints(body, motion, t, rotation[now], place[now]);
        for (int i = 0; i < layout->n_pose; i++) {
            const int joint = layout->pose[i];
            hg_quatd q = joint_rotation(layout, motion, rotation[now], t, joint);
            if (joint == layout->head) q = without_heading(q);
            pose_numbers(layout, q, track->pose + t * layout->pose_inputs + layout->pose_columns * i);
        }
        if (t == 0) continue;
        const hg_vec3d moved_before = moved;
        moved =
            hg_vec3d_sub(hg_vec3d_load(place[now] + 3 * layout->head), hg_vec3d_load(place[!now] + 3 * layout->head));
        track_velocity(layout, motion, t, rotation[!now], rotation[now], moved, moved_before,
                       track->velocity + t * layout->velocity_inputs);
    }
    hg_free(scratch);
    return HG_OK;
}

void hg_hair_track_destroy(hg_hair_track *track)
{
    hg_free(track->pose);
    hg_free(track->velocity);
    *track = (hg_hair_track){ 0 };
}

void hg_hair_track_frame(const hg_hair_layout *layout, const hg_hair_track *track, int64_t frame, const double *shape,
                         float *out)
{
    const int64_t last = track->frames - 1, at = frame < 0 ? 0 : frame > last ? last : frame;
    if (layout->shape) {
        for (int k = 0; k < HG_SHAPES; k++) out[k] = shape ? (float)shape[k] : 0;
        out += HG_SHAPES;
    }
    memcpy(out, track->pose + at * layout->pose_inputs, (size_t)layout->pose_inputs * sizeof *out);
    out += layout->pose_inputs;
    for (int i = 0; i < layout->history; i++, out += layout->velocity_inputs) {
        const int64_t f = frame - i;
        if (f > 0 && f <= last)
            memcpy(out, track->velocity + f * layout->velocity_inputs, (size_t)layout->velocity_inputs * sizeof *out);
        else /* before the clip, and after it, everything rests */
            memset(out, 0, (size_t)layout->velocity_inputs * sizeof *out);
    }
}

hg_status hg_hair_frame_features(hg_hair_task *task, hg_ctx *ctx, const hg_motion *motion, int64_t frame,
                                 const double *shape, float *out)
{
    (void)ctx;
    for (int held_out = 0; held_out < 2; held_out++)
        for (int i = 0; i < task->n_clips[held_out]; i++)
            if (task->clips[held_out][i].motion == motion) {
                hg_hair_track_frame(&task->layout, &task->clips[held_out][i].track, frame, shape, out);
                hg_hair_material_features(task, NULL, out);
                return HG_OK;
            }
    hg_hair_track track;
    HG_TRY(hg_hair_track_create(&track, &task->layout, task->body, motion));
    hg_hair_track_frame(&task->layout, &track, frame, shape, out);
    hg_hair_material_features(task, NULL, out);
    hg_hair_track_destroy(&track);
    return HG_OK;
}

/* ---- normalisation ------------------------------------------------------------------------------------------ */

/* Mean and deviation of one channel over all training clips. */
static void clip_moments(const hg_hair_task *task, bool pose, int channel, double least, double *mean,
                         double *deviation)
{
    const int width = pose ? task->layout.pose_inputs : task->layout.velocity_inputs;
    double sum = 0, squares = 0;
    for (int pass = 0; pass < 2; pass++) {
        for (int i = 0; i < task->n_clips[0]; i++) {
            const hg_hair_track *track = &task->clips[0][i].track;
            const float *values = (pose ? track->pose : track->velocity) + channel;
            for (int64_t t = 0; t < track->frames; t++) {
                const double d = (double)values[t * width] - (pass ? *mean : 0);
                if (pass)
                    squares += d * d;
                else
                    sum += d;
            }
        }
        if (!pass) *mean = sum / (double)task->training_frames;
    }
    *deviation = fmax(sqrt(squares / (double)task->training_frames), least);
}

hg_status hg_hair_add_feature(hg_hair_task *task, char *name, double mean, double deviation)
{
    if (!name) return HG_MEMORY;
    const int row = task->n_features++, i = row - (task->rest_columns > 0);
    task->features[row] =
        (hg_feature){ .name = name, .first = i + task->rest_columns, .count = 1, .mean = mean, .deviation = deviation };
    task->mean[i] = mean;
    task->deviation[i] = deviation;
    return HG_OK;
}

/* Not an input of the network, but of what its output is applied to: the last columns of a strand. A network of grooms has no rows
 * of strands. */
static hg_status rest_row(hg_hair_task *task)
{
    task->rest_columns = 0;
    if (task->network->of_grooms || strcmp(hg_config_text(task->config, "model.output"), "directions")) return HG_OK;
    char *name = hg_strdup("rest");
    if (!name) return HG_MEMORY;
    task->rest_columns = (int)(task->groom->vertices - 1) * 3;
    task->features[task->n_features++] = (hg_feature){
        .name = name, .first = task->strand_inputs, .count = task->rest_columns, .mean = 0, .deviation = 1
    };
    return HG_OK;
}

static hg_status frame_feature_rows(hg_hair_task *task)
{
    const hg_hair_layout *layout = &task->layout;
    const hg_body *body = task->body;
    const char axis[3] = { 'x', 'y', 'z' };
    const int linear = 3 * layout->linear;
    double mean[3 + 3 * HG_HAIR_JOINTS], deviation[3 + 3 * HG_HAIR_JOINTS];
    for (int k = 0; layout->shape && k < HG_SHAPES; k++)
        HG_TRY(hg_hair_add_feature(task, hg_format("shape[%d]", k), 0, fmax(body->shape_spread[k], 0.05)));
    for (int i = 0; i < layout->pose_inputs; i++) {
        clip_moments(task, true, i, least_pose, mean, deviation);
        const char *joint = body->joint_name[layout->pose[i / layout->pose_columns]];
        HG_TRY(hg_hair_add_feature(task,
                                   layout->pose_columns == 6
                                       ? hg_format("pose.%s.%c%c", joint, axis[i % 6 / 3], axis[i % 3])
                                       : hg_format("pose.%s.%c", joint, axis[i % 3]),
                                   *mean, *deviation));
    }
    for (int i = 0; i < layout->velocity_inputs; i++)
        clip_moments(task, false, i, least_velocity, mean + i, deviation + i);
    for (int lag = 0; lag < layout->history; lag++)
        for (int i = 0; i < layout->velocity_inputs; i++)
            HG_TRY(hg_hair_add_feature(
                task,
                i < linear
                    ? hg_format("%s[%d].Head.%c", layout->acceleration ? "acceleration" : "velocity", lag, axis[i])
                    : hg_format("angular_velocity[%d].%s.%c", lag, body->joint_name[layout->velocity[(i - linear) / 3]],
                                axis[i % 3]),
                mean[i], deviation[i]));
    for (int i = 0; i < task->n_materials; i++) { /* uniform between two logarithms */
        const double low = log10(task->materials[i].low), high = log10(task->materials[i].high);
        HG_TRY(hg_hair_add_feature(task, hg_format("log10(%s)", task->materials[i].name), 0.5 * (low + high),
                                   fmax((high - low) / sqrt(12), 1e-3)));
    }
    return HG_OK;
}

hg_status hg_hair_features_create(hg_hair_task *task)
{
    task->inputs = task->strand_inputs + task->layout.frame_inputs;
    task->mean = hg_alloc((size_t)task->inputs, sizeof(double));
    task->deviation = hg_alloc((size_t)task->inputs, sizeof(double));
    task->features = hg_alloc((size_t)task->inputs + 1, sizeof *task->features);
    if (!task->mean || !task->deviation || !task->features) return HG_MEMORY;
    HG_TRY(task->network->name_features(task));
    HG_TRY(rest_row(task));
    HG_TRY(frame_feature_rows(task));
    return hg_hair_features_tensors(task);
}

/* The normalisation as the concatenated formula needs it: (raw - mean) * inverse_deviation. */
hg_status hg_hair_features_tensors(hg_hair_task *task)
{
    const int64_t n = task->inputs;
    if (!task->mean_tensor) task->mean_tensor = hg_tensor_create(task->ctx, HG_F32, 1, &n);
    if (!task->inverse_deviation) task->inverse_deviation = hg_tensor_create(task->ctx, HG_F32, 1, &n);
    if (!task->mean_tensor || !task->inverse_deviation) return HG_MEMORY;
    task->mean_tensor->name = "feature_mean";
    task->inverse_deviation->name = "feature_inverse_deviation";
    float *mean = hg_alloc((size_t)n * 2 + 1, sizeof *mean);
    if (!mean) return HG_MEMORY;
    float *inverse = mean + n;
    for (int64_t i = 0; i < n; i++) {
        mean[i] = (float)task->mean[i];
        inverse[i] = (float)(1 / task->deviation[i]);
        hg_feature *feature = &task->features[i + (task->rest_columns > 0 && i >= task->strand_inputs)];
        feature->mean = task->mean[i];
        feature->deviation = task->deviation[i];
    }
    hg_status status = hg_tensor_write(task->mean_tensor, mean);
    if (status == HG_OK) status = hg_tensor_write(task->inverse_deviation, inverse);
    hg_free(mean);
    return status;
}

int hg_hair_features(const hg_hair_task *task, const hg_feature **features)
{
    *features = task->features;
    return task->n_features;
}

int hg_hair_strand_inputs(const hg_hair_task *task) { return task->strand_inputs + task->rest_columns; }

void hg_hair_normalise_frame(const hg_hair_task *task, const float *raw, float *out)
{
    const double *mean = task->mean + task->strand_inputs, *deviation = task->deviation + task->strand_inputs;
    for (int i = 0; i < task->layout.frame_inputs; i++) out[i] = (float)(((double)raw[i] - mean[i]) / deviation[i]);
}
