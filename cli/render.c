/* hairgrad render: pictures of drapes, posed scenes and grooms. */
#include "cli/cli.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

#define MOST_FRAMES 64

/* "0,20,40" */
static hg_status parse_frames(const char *text, int64_t frame[MOST_FRAMES], int *n)
{
    *n = 0;
    while (text && *text) {
        char *end;
        errno = 0;
        long long value = strtoll(text, &end, 10);
        if (end == text || errno || value < 0 || (*end != ',' && *end != '\0'))
            return hg_fail(HG_INVALID, "render: --frames takes numbers like 0,20,40, not '%s'", text);
        if (*n == MOST_FRAMES) return hg_fail(HG_INVALID, "render: --frames takes at most %d numbers", MOST_FRAMES);
        frame[(*n)++] = value;
        text = *end ? end + 1 : end;
    }
    return HG_OK;
}

/* "480x560" */
static hg_status parse_size(const char *text, int *width, int *height)
{
    char rest;
    if (!text) return HG_OK;
    if (sscanf(text, "%dx%d%c", width, height, &rest) != 2 || *width < 16 || *height < 16 || *width > 8192 ||
        *height > 8192)
        return hg_fail(HG_INVALID, "render: --size takes WIDTHxHEIGHT like 480x560, each from 16 to 8192, not '%s'",
                       text);
    return HG_OK;
}

static hg_status render_run(hg_ctx *ctx, const hg_arguments *arguments, const char *path)
{
    int64_t frame[MOST_FRAMES];
    hg_sheet_options options = { .body = cli_value(arguments, "body", NULL),
                                 .view = cli_value(arguments, "view", NULL),
                                 .frames = frame,
                                 .compare = cli_flag(arguments, "compare") };
    HG_TRY(parse_frames(cli_value(arguments, "frames", NULL), frame, &options.n_frames));
    HG_TRY(parse_size(cli_value(arguments, "size", NULL), &options.width, &options.height));
    const char *hair_width = cli_value(arguments, "hair-width", NULL);
    if (hair_width) HG_TRY(hg_unit_parse(hair_width, "m", &options.hair_width));
    int64_t hairs = 0;
    if (cli_value(arguments, "hairs", NULL) && (!cli_integer(arguments, "hairs", &hairs) || hairs < 1 || hairs > 100))
        return hg_fail(HG_INVALID, "render: --hairs takes a number from 1 to 100");
    options.hairs = (int)hairs;
    hg_progress progress = cli_progress();
    hg_image *image = NULL;
    hg_status status = cli_flag(arguments, "tips")
                           ? hg_tips_draw(&image, arguments->free[0], options.width, options.height)
                           : hg_sheet_draw(ctx, &image, arguments->free[0], &options, &progress);
    if (status == HG_OK) status = hg_image_write_png(image, path);
    cli_progress_end();
    if (status == HG_OK) printf("%s: %d x %d pixels\n", path, image->width, image->height);
    hg_image_destroy(image);
    return status;
}

static int render(const hg_arguments *arguments)
{
    const char *path = cli_value(arguments, "output", NULL);
    if (!path) {
        hg_fail(HG_INVALID, "render: where should the picture go? -o FILE.png");
        return cli_fail();
    }
    hg_ctx *ctx = NULL;
    if (!cli_context(&ctx, arguments)) return cli_fail();
    hg_status status = render_run(ctx, arguments, path);
    hg_ctx_destroy(ctx);
    return status == HG_OK ? 0 : cli_fail();
}

static const hg_argument render_options[] = {
    { "output", "FILE", "the picture, PNG (-o)", false },
    { "body", "FILE", "body.vtkhdf or body.h5 (default: the one that the drape names)", false },
    { "frames", "LIST", "frames like 0,20,40 (default: spread over the clip)", false },
    { "view", "NAME", "front, three_quarter, side or back (default three_quarter)", false },
    { "size", "WxH", "pixels of one picture (default 480x560)", false },
    { "compare", NULL, "rest, rigidly posed and trained hair side by side", false },
    { "tips", NULL, "instead: paths of a few tips in the head's frame", false },
    { "hair-width", "LENGTH", "how thick a strand is drawn, like \"0.3 mm\" (default: by their number)", false },
    { "hairs", "N", "hairs drawn for a strand, around it (default: by their number; 1: the strands alone)", false },
    CLI_CONTEXT_OPTIONS,
};
HG_COMMAND(render, .what = "draw a drape, a posed scene or a groom as a picture",
           .usage = "DRAPE.vtkhdf|POSED.h5|GROOM.h5 -o FILE.png", .options = render_options,
           .n_options = sizeof render_options / sizeof *render_options, .min_free = 1, .max_free = 1, .run = render,
           .more = "  hairgrad render out/demo/drape.vtkhdf --compare -o out/demo/drape.png\n"
                   "  hairgrad render out/demo/drape.vtkhdf --tips -o out/demo/tips.png\n"
                   "  hairgrad render groom.h5 --body body.h5 --view back --size 900x1200 -o groom.png\n");
