/* A scene without a network: body and rigidly posed groom over a motion, written frame by frame. */
#include "scene/internal.h"

#define POSED_FORMAT "hairgrad posed scene"

typedef struct {
    hg_poser *poser;
    float *vertices, *joints, *joint_rotation;      /* [N,3], [J,3], [J,4] */
    float *root_rotation, *root_position, *strands; /* [S,4], [S,3], [S,V,3] */
} posed_frame;

static hg_status frame_create(posed_frame *f, const hg_posed_scene *scene)
{
    size_t n = (size_t)scene->body->vertices, j = (size_t)scene->body->joints;
    HG_TRY(hg_poser_create(&f->poser, scene->body, false));
    f->vertices = hg_alloc(n, 3 * sizeof(float));
    f->joints = hg_alloc(j, 3 * sizeof(float));
    f->joint_rotation = hg_alloc(j, 4 * sizeof(float));
    if (!f->vertices || !f->joints || !f->joint_rotation) return HG_MEMORY;
    if (!scene->groom) return HG_OK;
    size_t s = (size_t)scene->groom->strands, v = (size_t)scene->groom->vertices;
    f->root_rotation = hg_alloc(s, 4 * sizeof(float));
    f->root_position = hg_alloc(s, 3 * sizeof(float));
    f->strands = hg_alloc(s, v * 3 * sizeof(float));
    return f->root_rotation && f->root_position && f->strands ? HG_OK : HG_MEMORY;
}

static void frame_clear(posed_frame *f)
{
    hg_poser_destroy(f->poser);
    hg_free(f->vertices);
    hg_free(f->joints);
    hg_free(f->joint_rotation);
    hg_free(f->root_rotation);
    hg_free(f->root_position);
    hg_free(f->strands);
}

static hg_status write_head(hg_h5 *file, const hg_posed_scene *scene, int64_t frames)
{
    static const double neutral[HG_SHAPES];
    const hg_body *body = scene->body;
    int64_t n = body->vertices, j = body->joints;
    HG_TRY(scene_head_write(file, POSED_FORMAT));
    HG_TRY(hg_h5_set_number(file, "/", "rate", scene->motion->rate));
    HG_TRY(hg_h5_set_number(file, "/", "first_frame", (double)scene->first));
    HG_TRY(hg_h5_set_text(file, "/", "motion", scene->motion->name ? scene->motion->name : ""));
    HG_TRY(scene_hash_write(file, "body_hash", hg_body_hash(body)));
    HG_TRY(hg_h5_write_texts(file, "/joint_name", (int)j, (const char *const *)body->joint_name));
    HG_TRY(hg_h5_write(file, "/parent", HG_I32, 1, &j, body->parent));
    HG_TRY(hg_h5_write(file, "/triangles", HG_I32, 2, (int64_t[]){ body->faces, 3 }, body->triangles));
    HG_TRY(hg_h5_write(file, "/shape", HG_F64, 1, (int64_t[]){ HG_SHAPES }, scene->shape ? scene->shape : neutral));
    HG_TRY(hg_h5_reserve(file, "/body_vertices", HG_F32, 3, (int64_t[]){ frames, n, 3 }));
    HG_TRY(hg_h5_reserve(file, "/joints", HG_F32, 3, (int64_t[]){ frames, j, 3 }));
    HG_TRY(hg_h5_reserve(file, "/joint_rotation", HG_F32, 3, (int64_t[]){ frames, j, 4 }));
    if (!scene->groom) return HG_OK;
    int64_t s = scene->groom->strands, v = scene->groom->vertices;
    HG_TRY(hg_h5_set_text(file, "/", "groom", scene->groom->name ? scene->groom->name : ""));
    HG_TRY(scene_hash_write(file, "groom_hash", hg_groom_hash(scene->groom)));
    HG_TRY(hg_h5_reserve(file, "/root_rotation", HG_F32, 3, (int64_t[]){ frames, s, 4 }));
    HG_TRY(hg_h5_reserve(file, "/root_position", HG_F32, 3, (int64_t[]){ frames, s, 3 }));
    return hg_h5_reserve(file, "/strands", HG_F32, 4, (int64_t[]){ frames, s, v, 3 });
}

static hg_status write_frame(hg_ctx *ctx, hg_h5 *file, const hg_posed_scene *scene, posed_frame *f, int64_t row)
{
    const hg_groom *groom = scene->groom;
    HG_TRY(hg_pose(ctx, f->poser, scene->shape, scene->motion, scene->first + row, f->vertices, f->joints,
                   f->joint_rotation));
    HG_TRY(hg_h5_write_rows(file, "/body_vertices", row, 1, f->vertices));
    HG_TRY(hg_h5_write_rows(file, "/joints", row, 1, f->joints));
    HG_TRY(hg_h5_write_rows(file, "/joint_rotation", row, 1, f->joint_rotation));
    if (!groom) return HG_OK;
    HG_TRY(hg_pose_roots(ctx, f->poser, groom, NULL, 0, f->vertices, f->root_rotation, f->root_position));
    hg_pose_strands(ctx, groom->strands, groom->vertices, groom->points, f->root_rotation, f->root_position,
                    f->strands);
    HG_TRY(hg_ctx_status(ctx));
    HG_TRY(hg_h5_write_rows(file, "/root_rotation", row, 1, f->root_rotation));
    HG_TRY(hg_h5_write_rows(file, "/root_position", row, 1, f->root_position));
    return hg_h5_write_rows(file, "/strands", row, 1, f->strands);
}

hg_status hg_posed_scene_write(hg_ctx *ctx, const hg_posed_scene *scene, const char *path, const hg_progress *progress)
{
    const hg_groom *groom = scene->groom;
    int64_t left = scene->motion->frames - scene->first, frames = scene->frames ? scene->frames : left;
    if (scene->first < 0 || frames < 1 || frames > left)
        return hg_fail(HG_INVALID, "frames %lld to %lld of a motion of %lld", (long long)scene->first,
                       (long long)(scene->first + frames - 1), (long long)scene->motion->frames);
    if (groom && groom->body_hash && groom->body_hash != hg_body_hash(scene->body))
        return hg_fail(HG_INVALID, "the groom %s is bound to another body: import or make it for this one",
                       groom->name ? groom->name : "");
    posed_frame frame = { 0 };
    hg_h5 *file = NULL;
    hg_status status = frame_create(&frame, scene);
    if (status == HG_OK) status = hg_h5_create(&file, path);
    if (status == HG_OK) status = write_head(file, scene, frames);
    for (int64_t row = 0; status == HG_OK && row < frames; row++) {
        status = write_frame(ctx, file, scene, &frame, row);
        hg_progress_report(progress, (double)(row + 1) / (double)frames, "frame %lld of %lld", (long long)(row + 1),
                           (long long)frames);
    }
    frame_clear(&frame);
    if (status == HG_OK) return hg_h5_commit(file);
    if (file) hg_h5_close(file);
    return status;
}
