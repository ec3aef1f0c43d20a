/* hairgrad pose: body and rigidly posed groom over a motion, the scene without a network. */
#include "cli/shape.h"

static bool whole(const hg_arguments *arguments, const char *name, int64_t *value)
{
    return !cli_value(arguments, name, NULL) || cli_integer(arguments, name, value);
}

static hg_status pose_run(hg_ctx *ctx, const hg_arguments *arguments, const char *output)
{
    const char *body_path = cli_value(arguments, "body", NULL), *groom_path = cli_value(arguments, "groom", NULL);
    const char *motion_path = cli_value(arguments, "motion", NULL);
    hg_progress progress = cli_progress();
    hg_posed_scene scene = { 0 };
    hg_body *body = NULL;
    hg_groom *groom = NULL;
    hg_motion *motion = NULL;
    double shape[HG_SHAPES];
    bool given;
    if (!body_path || !motion_path || !output)
        return hg_fail(HG_INVALID, "pose needs --body BODY.h5, --motion MOTION.h5 and -o OUT.h5");
    if (!whole(arguments, "first", &scene.first) || !whole(arguments, "frames", &scene.frames)) return HG_INVALID;
    hg_status status = hg_body_load(&body, body_path);
    if (status == HG_OK) status = cli_shape_of(arguments, body, shape, &given);
    if (status == HG_OK) status = hg_motion_load(&motion, motion_path, body);
    if (status == HG_OK && groom_path) status = hg_groom_load(&groom, groom_path);
    if (status == HG_OK) {
        scene.body = body, scene.groom = groom, scene.motion = motion, scene.shape = shape;
        status = hg_posed_scene_write(ctx, &scene, output, &progress);
        cli_progress_end();
    }
    if (status == HG_OK)
        printf("%s: %lld frames, %lld body vertices, %lld strands\n", output,
               (long long)(scene.frames ? scene.frames : motion->frames - scene.first), (long long)body->vertices,
               groom ? (long long)groom->strands : 0LL);
    hg_body_destroy(body);
    hg_groom_destroy(groom);
    hg_motion_destroy(motion);
    return status;
}

static int pose(const hg_arguments *arguments)
{
    hg_ctx *ctx = NULL;
    if (!cli_context(&ctx, arguments)) return cli_fail();
    hg_status status = pose_run(ctx, arguments, cli_value(arguments, "output", NULL));
    hg_ctx_destroy(ctx);
    return status == HG_OK ? 0 : cli_fail();
}

static const hg_argument pose_options[] = {
    { "output", "OUT.h5", "where to write (-o)", false },
    { "body", "BODY.h5", "the body", false },
    { "groom", "GROOM.h5", "its groom (default: the body alone)", false },
    { "motion", "MOTION.h5", "a motion of its joints", false },
    { "shape", "SHAPE", "ten numbers like 0.5,0,-1, or NAME=number, several times", true },
    { "first", "N", "first frame (default 0)", false },
    { "frames", "N", "how many (default: to the end)", false },
    CLI_CONTEXT_OPTIONS,
};

HG_COMMAND(pose, .what = "pose a body and its groom over a motion, without a network",
           .usage = "--body BODY.h5 --groom GROOM.h5 --motion MOTION.h5 -o OUT.h5", .options = pose_options,
           .n_options = (int)(sizeof pose_options / sizeof *pose_options), .min_free = 0, .max_free = 0, .run = pose,
           .more = "The file has body_vertices [T,N,3] in the mesh's own vertex order, joints [T,J,3], root_rotation\n"
                   "[T,S,4], root_position [T,S,3] and strands [T,S,V,3]; docs/formats.md says more.\n");
