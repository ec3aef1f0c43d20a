/* hairgrad make: the procedural bust, grooms and motions. */
#include "cli/cli.h"

#include <string.h>

static hg_status make_bust(hg_ctx *ctx, const hg_arguments *arguments, const char *output)
{
    hg_body *body = NULL;
    (void)ctx, (void)arguments;
    HG_TRY(hg_bust_create(&body));
    hg_status status = hg_body_save(body, output);
    if (status == HG_OK)
        printf("%s: %lld vertices, %lld faces, %lld joints\n", output, (long long)body->vertices,
               (long long)body->faces, (long long)body->joints);
    hg_body_destroy(body);
    return status;
}

/* The body given, or the bust. */
static hg_status get_body(hg_body **body, const hg_arguments *arguments)
{
    const char *path = cli_value(arguments, "body", NULL);
    return path ? hg_body_load(body, path) : hg_bust_create(body);
}

static hg_status make_groom(hg_ctx *ctx, const hg_arguments *arguments, const char *output)
{
    int64_t strands = 3000, vertices = 25;
    hg_body *body = NULL;
    hg_groom *groom = NULL;
    if (cli_value(arguments, "strands", NULL) && !cli_integer(arguments, "strands", &strands)) return HG_INVALID;
    if (cli_value(arguments, "vertices", NULL) && !cli_integer(arguments, "vertices", &vertices)) return HG_INVALID;
    HG_TRY(get_body(&body, arguments));
    hg_status status =
        hg_groom_grow(ctx, &groom, body, cli_value(arguments, "style", "wavy"), strands, vertices, hg_ctx_seed(ctx));
    if (status == HG_OK) status = hg_groom_save(groom, output);
    if (status == HG_OK)
        printf("%s: %lld strands of %lld vertices\n", output, (long long)groom->strands, (long long)groom->vertices);
    hg_groom_destroy(groom);
    hg_body_destroy(body);
    return status;
}

static hg_status make_motion(hg_ctx *ctx, const hg_arguments *arguments, const char *output)
{
    double seconds = 10, rate = 30;
    hg_body *body = NULL;
    hg_motion *motion = NULL;
    if (cli_value(arguments, "seconds", NULL) && !cli_number(arguments, "seconds", &seconds)) return HG_INVALID;
    if (cli_value(arguments, "rate", NULL) && !cli_number(arguments, "rate", &rate)) return HG_INVALID;
    HG_TRY(get_body(&body, arguments));
    hg_status status =
        hg_motion_make(&motion, body, cli_value(arguments, "kind", "mixed"), seconds, rate, hg_ctx_seed(ctx));
    if (status == HG_OK) status = hg_motion_save(motion, output);
    if (status == HG_OK)
        printf("%s: %lld frames of %lld joints at %g per second\n", output, (long long)motion->frames,
               (long long)motion->joints, motion->rate);
    hg_motion_destroy(motion);
    hg_body_destroy(body);
    return status;
}

static int make(const hg_arguments *arguments)
{
    static const struct {
        const char *what;
        hg_status (*run)(hg_ctx *, const hg_arguments *, const char *);
    } things[] = { { "bust", make_bust }, { "groom", make_groom }, { "motion", make_motion } };
    const char *what = arguments->free[0], *output = cli_value(arguments, "output", NULL);
    int thing = 0;
    while (thing < 3 && strcmp(what, things[thing].what) != 0) thing++;
    if (thing == 3) {
        hg_fail(HG_INVALID, "make %s: bust, groom or motion can be made", what);
        return cli_fail();
    }
    if (!output) {
        hg_fail(HG_INVALID, "make %s needs --output FILE.h5 (-o)", what);
        return cli_fail();
    }
    hg_ctx *ctx = NULL;
    if (!cli_context(&ctx, arguments)) return cli_fail();
    hg_status status = things[thing].run(ctx, arguments, output);
    hg_ctx_destroy(ctx);
    return status == HG_OK ? 0 : cli_fail();
}

static const hg_argument make_options[] = {
    { "output", "FILE.h5", "where to write (-o)", false },
    { "body", "BODY.h5", "groom, motion: the body it is for (default: the bust)", false },
    { "style", "STYLE", "groom: straight, wavy, curly, short or long (default wavy)", false },
    { "strands", "N", "groom: how many (default 3000)", false },
    { "vertices", "N", "groom: of a strand (default 25)", false },
    { "kind", "KIND", "motion: nod, turn, shake, walk, jump or mixed (default mixed)", false },
    { "seconds", "N", "motion: how long (default 10)", false },
    { "rate", "N", "motion: frames per second (default 30)", false },
    CLI_CONTEXT_OPTIONS,
};

HG_COMMAND(make, .what = "make a procedural bust, groom or motion", .usage = "bust | groom | motion",
           .options = make_options, .n_options = (int)(sizeof make_options / sizeof *make_options), .min_free = 1,
           .max_free = 1, .run = make,
           .more = "hairgrad make bust -o bust.h5\n"
                   "hairgrad make groom --body bust.h5 --style curly --strands 5000 -o groom.h5\n"
                   "hairgrad make motion --body bust.h5 --kind shake --seconds 8 --seed 3 -o shake.h5\n");
