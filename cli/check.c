/* hairgrad check: what is wrong, or odd, with a groom, a body, a motion or a config, one finding a line. */
#include "cli/cli.h"

#include <string.h>

typedef struct {
    hg_ctx *ctx;
    const hg_arguments *arguments;
    const hg_body *body; /* --body, or NULL */
    hg_findings *findings;
} check_job;

/* ---- kinds of files ----------------------------------------------------------------------------------------- */

static hg_status check_strands(const check_job *job, const char *path)
{
    const hg_groom_reader *reader = hg_groom_reader_find(path);
    const char *image_path = cli_value(job->arguments, "image", NULL), *up = cli_value(job->arguments, "up", "y");
    const char *unit_name = cli_value(job->arguments, "unit", "m");
    double unit = 1;
    int64_t frame = 0;
    if (!reader)
        return hg_fail(HG_UNSUPPORTED,
                       "%s: strands (of any format that hairgrad import groom reads), a recipe (.yaml), a body or a "
                       "motion (.h5, once imported) can be checked",
                       path);
    char *text = hg_format("1 %s", unit_name);
    if (!text) return HG_MEMORY;
    hg_status status = hg_unit_parse(text, "m", &unit);
    hg_free(text);
    HG_TRY(status);
    if (!(unit > 0)) return hg_fail(HG_INVALID, "--unit %s: more than nothing", unit_name);
    if (strcmp(up, "y") != 0 && strcmp(up, "z") != 0) return hg_fail(HG_INVALID, "--up %s: y or z", up);
    if (!cli_integer(job->arguments, "frame", &frame)) return HG_INVALID;
    hg_curves *curves;
    hg_image *image = NULL;
    HG_TRY(hg_curves_read_frame(&curves, path, frame));
    if (!reader->metres) hg_curves_to_world(curves, unit, *up == 'z');
    uint8_t *problem = hg_alloc((size_t)curves->strands, sizeof *problem);
    status = problem ? hg_check_groom(job->ctx, job->findings, curves, job->body, problem) : HG_MEMORY;
    if (status == HG_OK && image_path) {
        status = hg_problems_draw(job->ctx, &image, curves, problem, job->body, 420, 520);
        if (status == HG_OK) status = hg_image_write_png(image, image_path);
        hg_image_destroy(image);
    }
    hg_free(problem);
    hg_curves_destroy(curves);
    return status;
}

static hg_status check_body(const check_job *job, const char *path)
{
    hg_body *body;
    HG_TRY(hg_body_load(&body, path));
    hg_status status = hg_check_body(job->findings, body);
    hg_body_destroy(body);
    return status;
}

static hg_status check_motion(const check_job *job, const char *path)
{
    hg_motion *motion;
    HG_TRY(hg_motion_load(&motion, path, NULL));
    hg_status status = hg_check_motion(job->findings, motion, job->body);
    hg_motion_destroy(motion);
    return status;
}

/* A .yaml is a config; an .h5 says what it is; all else is strands. */
static hg_status check_file(const check_job *job, const char *path)
{
    const char *extension = hg_path_extension(path);
    if (strcmp(extension, "yaml") == 0 || strcmp(extension, "yml") == 0)
        return hg_hair_config_check(job->ctx, job->findings, path);
    if (strcmp(extension, "h5") != 0) return check_strands(job, path);
    hg_h5 *file;
    char *format;
    HG_TRY(hg_h5_open(&file, path));
    hg_status status = hg_h5_get_text(file, "/", "format", &format);
    hg_h5_close(file);
    if (status != HG_OK) return check_strands(job, path);
    bool body = strcmp(format, "hairgrad body") == 0, motion = strcmp(format, "hairgrad motion") == 0;
    hg_free(format);
    return body ? check_body(job, path) : motion ? check_motion(job, path) : check_strands(job, path);
}

/* ---- telling ------------------------------------------------------------------------------------------------ */

static void print_quoted(const char *text)
{
    putchar('"');
    for (const unsigned char *c = (const unsigned char *)text; *c; c++) {
        if (*c == '"' || *c == '\\')
            printf("\\%c", *c);
        else if (*c < 0x20)
            printf("\\u%04x", *c);
        else
            putchar(*c);
    }
    putchar('"');
}

static void print_findings(const hg_findings *findings, const char *path, bool json)
{
    static const char *const severity[] = { "ok", "warning", "error" };
    if (json) {
        printf("{ \"file\": ");
        print_quoted(path);
        printf(", \"errors\": %d, \"warnings\": %d, \"findings\": [", hg_findings_count(findings, HG_ERROR),
               hg_findings_count(findings, HG_WARNING));
    }
    for (int i = 0; i < findings->n; i++) {
        const hg_finding *finding = &findings->list[i];
        if (json) {
            printf("%s\n  { \"severity\": \"%s\", \"about\": \"%s\", \"text\": ", i ? "," : "",
                   severity[finding->severity], finding->about);
            print_quoted(finding->text);
            printf(" }");
        } else {
            printf("%-8s %-11s %s\n", severity[finding->severity], finding->about, finding->text);
        }
    }
    if (json) printf("\n] }\n");
}

static int check(const hg_arguments *arguments)
{
    hg_findings findings = { 0 };
    check_job job = { .arguments = arguments, .findings = &findings };
    const char *path = arguments->free[0], *body_path = cli_value(arguments, "body", NULL);
    hg_body *body = NULL;
    if (!cli_context(&job.ctx, arguments)) return cli_fail();
    hg_status status = body_path ? hg_body_load(&body, body_path) : HG_OK;
    job.body = body;
    if (status == HG_OK && check_file(&job, path) != HG_OK) /* it cannot be read: that is what there is to say */
        hg_findings_add(&findings, HG_ERROR, "file", "%s", hg_message());
    hg_body_destroy(body);
    hg_ctx_destroy(job.ctx);
    if (status == HG_OK) print_findings(&findings, path, cli_flag(arguments, "json"));
    int errors = hg_findings_count(&findings, HG_ERROR);
    if (errors) {
        if (cli_flag(arguments, "json") || findings.n > 1)
            hg_fail(HG_INVALID, "%s: %d error%s", path, errors, errors > 1 ? "s" : "");
        else
            hg_fail(HG_INVALID, "%s", findings.list[0].text);
    }
    hg_findings_free(&findings);
    return errors || status != HG_OK ? cli_fail() : 0;
}

static const hg_argument check_options[] = {
    { "body", "BODY.h5", "groom: roots and vertices against this body; motion: whether it is for this body", false },
    { "unit", "UNIT", "groom: of a file that does not say: m, dm, cm, mm, inch (default m)", false },
    { "up", "y|z", "groom: axis that is up in such a file (default y)", false },
    { "frame", "N", "of a drape or posed scene: the frame to look at (default 0)", false },
    { "image", "FILE.png", "groom: draw the strands in the colour of their problem", false },
    { "json", NULL, "as JSON: file, errors, warnings and a list of findings", false },
    CLI_CONTEXT_OPTIONS,
};
HG_COMMAND(check, .what = "what is wrong, or odd, with a groom, a body, a motion or a recipe",
           .usage = "GROOM|BODY.h5|MOTION.h5|RECIPE.yaml", .options = check_options,
           .n_options = (int)(sizeof check_options / sizeof *check_options), .min_free = 1, .max_free = 1, .run = check,
           .more =
               "One finding a line: ok, warning or error; exit status 1 when there is an error. Nothing is written.\n"
               "hairgrad check strands.hair --unit inch --up z\n"
               "hairgrad check groom.h5 --body body.h5 --image groom.png\n"
               "hairgrad check examples/recipes/demo.yaml\n");
