/* A clip of AMASS's kind (Mahmood et al. 2019) from .npz: poses [T,3J] as rotation vectors of SMPL's joints, trans [T,3],
 * a frame rate. The world is Z-up (--up y: it is not); the rest pose of the person is Y-up, and only the root's rotation
 * and way are turned: R' = C R, way' = C way with C (x, y, z) = (x, z, -y).
 *
 * The file has no skeleton. The bones are those of the SMPL-like body given by --skeleton or of the body that is to
 * move, with the file's betas, or else about those of a mean person. */
#include "scene/clip.h"
#include "scene/joints.h"
#include "scene/npz.h"
#include "scene/skin.h"

#include <math.h>
#include <string.h>

static const char *const rate_names[] = { "mocap_framerate", "mocap_frame_rate", "fps", "frame_rate", NULL };

/* ---- bones --------------------------------------------------------------------------------------------------- */

/* A person of 1.7 m standing with arms stretched out to the sides, to the centimetre: for directions and lengths of
 * bones. Pelvis, then left joints; right ones are their mirror images. */
static const struct {
    const char *name;
    double at[3];
} mean_person[] = {
    { "pelvis", { 0, -0.23, 0.02 } },
    { "left_hip", { 0.07, -0.32, 0.01 } },
    { "spine1", { 0, -0.12, 0.00 } },
    { "left_knee", { 0.10, -0.70, 0.01 } },
    { "spine2", { 0, 0.02, 0.00 } },
    { "left_ankle", { 0.09, -1.10, -0.03 } },
    { "spine3", { 0, 0.07, 0.01 } },
    { "left_foot", { 0.12, -1.16, 0.09 } },
    { "neck", { 0, 0.28, -0.01 } },
    { "left_collar", { 0.08, 0.19, -0.01 } },
    { "head", { 0, 0.37, 0.03 } },
    { "left_shoulder", { 0.18, 0.22, -0.02 } },
    { "left_elbow", { 0.44, 0.21, -0.04 } },
    { "left_wrist", { 0.69, 0.21, -0.04 } },
    { "left_hand", { 0.77, 0.20, -0.05 } },
    { "left_index1", { 0.78, 0.21, -0.01 } },
    { "left_middle1", { 0.79, 0.21, -0.03 } },
    { "left_ring1", { 0.78, 0.21, -0.05 } },
    { "left_pinky1", { 0.77, 0.20, -0.07 } },
    { "left_thumb1", { 0.73, 0.20, 0.01 } },
};

static bool place_of(const char *name, hg_vec3d *place)
{
    bool right = strncmp(name, "right_", 6) == 0;
    for (size_t i = 0; i < sizeof mean_person / sizeof *mean_person; i++) {
        const char *other = mean_person[i].name;
        bool left = strncmp(other, "left_", 5) == 0;
        if (right ? !left || strcmp(name + 6, other + 5) != 0 : strcmp(name, other) != 0) continue;
        *place = hg_vec3d_load(mean_person[i].at);
        if (right) place->x = -place->x;
        return true;
    }
    return false;
}

/* Rest places [J] of the clip's joints: from a body of the same names with betas, else of the mean person. */
static bool places_of_body(const hg_clip *clip, const hg_body *body, const double *betas, hg_vec3d *place)
{
    int found = 0;
    for (int64_t j = 0; j < clip->joints; j++) {
        int k = joints_find(body->joint_name, body->joints, clip->name[j]);
        int above = clip->parent[j];
        found += k >= 0;
        if (k < 0 && j < 22) return false;
        if (k < 0) {
            place[j] = hg_vec3d_add(place[above], hg_vec3d_make(clip->name[j][0] == 'r' ? -0.03 : 0.03, 0, 0));
            continue;
        }
        place[j] = scene_point(body->joint + 3 * (int64_t)k);
        for (int s = 0; s < HG_SHAPES; s++)
            place[j] =
                hg_vec3d_add_scaled(place[j], betas[s], scene_point(body->joint_shapes + 3 * (s * body->joints + k)));
    }
    return found >= 22;
}

static void places_of_mean(const hg_clip *clip, hg_vec3d *place)
{
    for (int64_t j = 0; j < clip->joints; j++)
        if (!place_of(clip->name[j], &place[j])) /* joints of fingers, jaw, eyes */
            place[j] =
                hg_vec3d_add(place[clip->parent[j]], hg_vec3d_make(clip->name[j][0] == 'r' ? -0.03 : 0.03, 0, 0));
}

static hg_status read_betas(const npz_file *file, double betas[HG_SHAPES], bool *given)
{
    memset(betas, 0, HG_SHAPES * sizeof *betas);
    const npz_array *a = npz_find(file, "betas");
    *given = false;
    if (!a || a->type == 'O' || a->count == 0) return HG_OK;
    double *numbers;
    HG_TRY(npz_read(file, "betas", HG_F64, -1, NULL, NULL, (void **)&numbers)); /* [16] or [1,16] */
    hg_status status = HG_OK;
    for (int64_t k = 0; k < a->count; k++) {
        if (!isfinite(numbers[k]))
            status =
                hg_fail(HG_NUMERIC, "%s: betas has a number that is not finite (entry %lld)", file->path, (long long)k);
        if (k < HG_SHAPES) betas[k] = numbers[k];
        *given |= numbers[k] != 0;
    }
    hg_free(numbers);
    return status;
}

static hg_status read_skeleton(const char *path, hg_body **body)
{
    if (strcmp(hg_path_extension(path), "h5") == 0) return hg_body_load(body, path);
    return hg_body_read(NULL, body, path, NULL, NULL);
}

static hg_status find_bones(hg_clip *clip, const npz_file *file, const hg_import *with, bool z_up, hg_text *notes)
{
    hg_body *skeleton = NULL;
    hg_vec3d place[64];
    double betas[HG_SHAPES];
    bool shaped;
    HG_TRY(read_betas(file, betas, &shaped));
    if (with->skeleton) HG_TRY(read_skeleton(with->skeleton, &skeleton));
    const hg_body *body = skeleton ? skeleton : with->body;
    bool own = body && places_of_body(clip, body, betas, place);
    hg_body_destroy(skeleton);
    if (with->skeleton && !own)
        return hg_fail(HG_INVALID, "%s: the joints of the skeleton are not those of SMPL", with->skeleton);
    if (!own) places_of_mean(clip, place);
    clip->standard_rest = true;
    for (int64_t j = 0; j < clip->joints; j++) {
        int above = clip->parent[j];
        hg_vec3d bone = above < 0 ? place[j] : hg_vec3d_sub(place[j], place[above]);
        if (above < 0 && z_up) bone = hg_vec3d_make(bone.x, bone.z, -bone.y);
        hg_vec3d_store(clip->offset + 3 * j, bone);
    }
    if (!notes) return HG_OK;
    if (!own)
        hg_text_add(notes, "bones: those of a mean person; --skeleton SMPL.npz takes those of its body%s\n",
                    shaped ? " with the file's betas" : "");
    if (shaped) {
        hg_text_add(notes, "betas: ");
        for (int k = 0; k < HG_SHAPES; k++) hg_text_add(notes, "%s%.4g", k ? "," : "", betas[k]);
        hg_text_add(notes, " (hairgrad pose --shape, with a body that has these directions)\n");
    }
    return HG_OK;
}

/* ---- frames -------------------------------------------------------------------------------------------------- */

static hg_status check_finite(const npz_file *file, const char *name, const double *data, int64_t frames,
                              int64_t columns)
{
    for (int64_t i = 0; i < frames * columns; i++)
        if (!isfinite(data[i]))
            return hg_fail(HG_NUMERIC, "%s: array \"%s\": frame %lld has a number that is not finite (column %lld)",
                           file->path, name, (long long)(i / columns), (long long)(i % columns));
    return HG_OK;
}

/* The poses as [T,J,width], width 3 (rotation vectors) or 4 (quaternions w, x, y, z). */
static hg_status read_poses(const npz_file *file, double **poses, int64_t *frames, int64_t *joints, int *width)
{
    int64_t shape[NPZ_RANK];
    const npz_array *a = npz_find(file, "poses");
    *width = 3;
    if (a && a->rank == 3) {
        *width = a->shape[2] == 4 ? 4 : 3;
        HG_TRY(npz_read(file, "poses", HG_F64, 3, (int64_t[]){ -1, -1, *width }, shape, (void **)poses));
        *frames = shape[0], *joints = shape[1];
    } else if (a || !npz_find(file, "root_orient")) {
        HG_TRY(npz_read(file, "poses", HG_F64, 2, (int64_t[]){ -1, -1 }, shape, (void **)poses));
        *frames = shape[0], *joints = shape[1] / 3;
        if (shape[1] % 3 != 0) *joints = 0;
    } else { /* in parts: the root and the body */
        double *root = NULL, *body = NULL;
        hg_status status = npz_read(file, "root_orient", HG_F64, 2, (int64_t[]){ -1, 3 }, shape, (void **)&root);
        *frames = status == HG_OK ? shape[0] : 0, *joints = 22;
        if (status == HG_OK)
            status = npz_read(file, "pose_body", HG_F64, 2, (int64_t[]){ *frames, 63 }, NULL, (void **)&body);
        if (status == HG_OK && !(*poses = hg_alloc((size_t)*frames + 1, 66 * sizeof **poses))) status = HG_MEMORY;
        for (int64_t t = 0; status == HG_OK && t < *frames; t++) {
            memcpy(*poses + 66 * t, root + 3 * t, 3 * sizeof *root);
            memcpy(*poses + 66 * t + 3, body + 63 * t, 63 * sizeof *body);
        }
        hg_free(root);
        hg_free(body);
        HG_TRY(status);
    }
    if (*frames < 1 || !joints_smpl(*joints))
        return hg_fail(
            HG_FORMAT,
            "%s: array \"poses\": %lld frames of %lld joints; expected SMPL's 24, SMPL-H's 52, SMPL-X's 55 or "
            "22 without hands, three numbers each",
            file->path, (long long)*frames, (long long)*joints);
    return check_finite(file, "poses", *poses, *frames, *joints * *width);
}

static hg_status read_rate(const npz_file *file, double *rate)
{
    for (const char *const *name = rate_names; *name; name++) {
        if (!npz_find(file, *name)) continue;
        HG_TRY(npz_read_number(file, *name, rate));
        if (!(*rate > 0 && *rate <= 1e5))
            return hg_fail(HG_FORMAT, "%s: %s is %g, expected frames per second", file->path, *name, *rate);
        return HG_OK;
    }
    return hg_fail(HG_FORMAT, "%s: no frame rate: expected mocap_framerate, mocap_frame_rate or fps", file->path);
}

static hg_status fill(hg_clip *clip, const npz_file *file, const double *poses, int width, bool z_up, double unit,
                      hg_text *notes)
{
    double *way = NULL;
    hg_quatd up = hg_quatd_from_axis_angle(hg_vec3d_make(1, 0, 0), -90 * CLIP_RADIANS);
    if (npz_find(file, "trans")) {
        HG_TRY(npz_read(file, "trans", HG_F64, 2, (int64_t[]){ clip->frames, 3 }, NULL, (void **)&way));
        hg_status status = check_finite(file, "trans", way, clip->frames, 3);
        if (status != HG_OK) {
            hg_free(way);
            return status;
        }
    } else if (notes) {
        hg_text_add(notes, "way: no array trans; the root stays in place\n");
    }
    for (int64_t i = 0; i < clip->frames * clip->joints; i++) {
        const double *p = poses + width * i;
        hg_quatd q = width == 3 ? hg_quatd_from_rotation_vector(hg_vec3d_load(p)) : hg_quatd_load(p);
        if (width == 4 && !(hg_quatd_norm(q) > 1e-6)) {
            hg_free(way);
            return hg_fail(HG_NUMERIC, "%s: array \"poses\": frame %lld: a quaternion of length zero", file->path,
                           (long long)(i / clip->joints));
        }
        q = hg_quatd_normalize(q);
        if (i % clip->joints == 0 && z_up) q = hg_quatd_mul(up, q);
        hg_quatd_store(clip->rotation + 4 * i, q);
    }
    for (int64_t t = 0; way && t < clip->frames; t++) {
        hg_vec3d p = hg_vec3d_scale(hg_vec3d_load(way + 3 * t), unit);
        hg_vec3d_store(clip->translation + 3 * t, z_up ? hg_vec3d_make(p.x, p.z, -p.y) : p);
    }
    hg_free(way);
    return HG_OK;
}

static hg_status make(hg_clip **out, const npz_file *file, const hg_import *with, hg_text *notes)
{
    int64_t frames = 0, joints = 0;
    int width;
    double rate, *poses = NULL;
    scene_axes axes;
    HG_TRY(skin_axes(with, true, &axes));
    HG_TRY(read_rate(file, &rate));
    hg_status status = read_poses(file, &poses, &frames, &joints, &width);
    if (status == HG_OK) status = clip_create(out, joints);
    hg_clip *clip = *out;
    if (status == HG_OK) {
        clip->rate = rate;
        status = clip_frames(clip, frames);
    }
    for (int64_t j = 0; status == HG_OK && j < joints; j++) {
        clip->parent[j] = joints_smpl_parents(joints)[j];
        if (!(clip->name[j] = hg_strdup(joints_smpl(joints)[j]))) status = HG_MEMORY;
    }
    if (status == HG_OK) status = fill(clip, file, poses, width, axes.z_up, axes.scale, notes);
    if (status == HG_OK) status = find_bones(clip, file, with, axes.z_up, notes);
    hg_free(poses);
    return status;
}

static hg_status read_amass(hg_clip **clip, const char *path, const hg_import *with, hg_text *notes)
{
    *clip = NULL;
    npz_file *file;
    HG_TRY(npz_open(&file, path));
    hg_status status = make(clip, file, with, notes);
    npz_close(file);
    if (status != HG_OK) {
        hg_clip_destroy(*clip);
        *clip = NULL;
    }
    return status;
}

static const hg_clip_reader reader = { .extension = "npz",
                                       .what = "NumPy: AMASS and its like, poses of SMPL's joints",
                                       .read = read_amass };
HG_REGISTER("motion reader", amass, &reader);
