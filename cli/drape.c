/* hairgrad drape: a trained network over a whole motion, as a file that ParaView opens. */
#include "cli/shape.h"

static hg_status choose_motion(const hg_arguments *arguments, const hg_hair_task *task, hg_motion **loaded,
                               const hg_motion **motion)
{
    const char *file = cli_value(arguments, "motion", NULL), *clip = cli_value(arguments, "clip", NULL);
    if (file && clip) return hg_fail(HG_INVALID, "drape: either --motion or --clip");
    if (file) {
        hg_motion *given = NULL;
        HG_TRY(hg_motion_load(&given, file, hg_hair_body(task)));
        const hg_status status = hg_motion_resample(loaded, given, hg_hair_rate(task));
        hg_motion_destroy(given);
        *motion = *loaded;
        return status;
    }
    *motion = clip ? cli_clip(task, clip) : hg_hair_clip(task, hg_hair_clips(task, true) > 0, 0);
    return *motion ? HG_OK : HG_INVALID;
}

typedef struct {
    int64_t first, frames, stride;
} range;

static bool whole(const hg_arguments *arguments, const char *name, int64_t *value)
{
    return !cli_value(arguments, name, NULL) || cli_integer(arguments, name, value);
}

static hg_status drape_run(hg_ctx *ctx, const hg_arguments *arguments, const char *path)
{
    hg_progress progress = cli_progress();
    double shape[HG_SHAPES];
    bool given;
    range part = { .stride = 1 };
    HG_TRY(cli_shape(arguments, shape, &given));
    if (!whole(arguments, "first", &part.first) || !whole(arguments, "frames", &part.frames) ||
        !whole(arguments, "stride", &part.stride))
        return hg_fail(HG_INVALID, "--first, --frames and --stride take whole numbers");
    hg_hair_task *task = NULL;
    hg_motion *loaded = NULL;
    const hg_motion *motion = NULL;
    hg_drape_file *file = NULL;
    hg_status status = hg_hair_task_open(&task, ctx, arguments->free[0], &progress);
    const char *groom = cli_value(arguments, "groom", NULL);
    if (cli_value(arguments, "pairs", NULL)) {
        if (status == HG_OK) status = cli_materials(arguments, task);
        if (status == HG_OK) status = cli_drape_pairs(ctx, arguments, task, part.stride, path);
        cli_progress_end();
        hg_hair_task_destroy(task);
        return status;
    }
    if (status == HG_OK && groom) status = hg_hair_choose_groom(task, groom);
    if (status == HG_OK) status = cli_materials(arguments, task);
    if (status == HG_OK) status = choose_motion(arguments, task, &loaded, &motion);
    int64_t frames = 0, strands = 0;
    if (status == HG_OK) {
        frames = motion->frames - part.first;
        if (part.frames > 0 && part.frames < frames) frames = part.frames;
        if (part.stride < 1 || part.first < 0 || frames < 1)
            status = hg_fail(HG_INVALID, "drape: from frame %lld, every %lld-th strand: the motion has %lld frames",
                             (long long)part.first, (long long)part.stride, (long long)motion->frames);
    }
    if (status == HG_OK) {
        strands = (hg_hair_groom(task)->strands + part.stride - 1) / part.stride;
        status = hg_drape_file_create(&file, path, cli_value(arguments, "body-out", NULL), hg_hair_groom(task),
                                      hg_hair_body(task), frames, hg_hair_rate(task));
    }
    if (status == HG_OK)
        status = hg_hair_drape(task, ctx, motion, shape, part.first, frames, part.stride, hg_drape_file_add, file,
                               &progress);
    if (status == HG_OK)
        status = hg_drape_file_commit(file);
    else
        hg_drape_file_discard(file);
    cli_progress_end();
    if (status == HG_OK) {
        printf("%s: %lld frames of %lld strands", path, (long long)frames, (long long)strands);
        const int64_t left_out = hg_hair_left_out(task, -1);
        if (left_out) printf("; %lld of the groom are left out, they share a texel with another", (long long)left_out);
        printf("\n");
    }
    hg_motion_destroy(loaded);
    hg_hair_task_destroy(task);
    return status;
}

static int drape(const hg_arguments *arguments)
{
    hg_ctx *ctx = NULL;
    const char *path = cli_value(arguments, "output", NULL);
    if (!path) {
        hg_fail(HG_INVALID, "drape: where should the drape go? -o FILE.vtkhdf");
        return cli_fail();
    }
    if (!cli_context(&ctx, arguments)) return cli_fail();
    const hg_status status = drape_run(ctx, arguments, path);
    hg_ctx_destroy(ctx);
    return status == HG_OK ? 0 : cli_fail();
}

static const hg_argument drape_options[] = {
    { "output", "FILE", "the drape, VTKHDF (-o)", false },
    { "body-out", "FILE", "the body that moves with it, VTKHDF", false },
    { "motion", "FILE", "a motion file (.h5)", false },
    { "clip", "NAME", "a clip of the run (default: the first that is held out)", false },
    { "groom", "NAME", "a groom of the run, another file (.h5) or a style (default: the run's first)", false },
    { "material", "NAME=VALUE", "of a network that was trained over a range, like \"bend_twist.stiffness=2e-9 N*m^2\"",
      true },
    { "shape", "NUMBERS", "body shape, like 0.5,0,-1 (default: the neutral body)", false },
    { "pairs", "FILE|N",
      "many pairs of a groom and a pose at once, in place of a motion: a line of FILE is GROOM CLIP FRAME [SHAPE]; "
      "or N that are drawn",
      false },
    { "first", "N", "first frame (default 0)", false },
    { "frames", "N", "how many (default: all)", false },
    { "stride", "N", "every N-th strand only (default 1)", false },
    CLI_DEVICE_OPTION,
    CLI_CONTEXT_OPTIONS,
};
HG_COMMAND(drape, .what = "drape the hair over a motion with a trained network", .usage = "RUN -o FILE.vtkhdf",
           .options = drape_options, .n_options = sizeof drape_options / sizeof *drape_options, .min_free = 1,
           .max_free = 1, .run = drape,
           .more =
               "  hairgrad drape out/demo/run --clip shake -o out/demo/drape.vtkhdf --body-out out/demo/body.vtkhdf\n"
               "  hairgrad drape out/demo/run --pairs 1000 -o out/demo/pairs.vtkhdf   (a step each; pairs.pairs says "
               "which is which; "
               "of several grooms pairs.GROOM.vtkhdf)\n");
