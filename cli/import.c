/* hairgrad import groom|body|motion: files of other programs to the HDF5 files of this one. */
#include "cli/cli.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Puts the file's name before a message that does not have it. */
static hg_status of_file(hg_status status, const char *path)
{
    if (status == HG_OK || strstr(hg_message(), path)) return status;
    char *message = hg_strdup(hg_message());
    if (message) hg_fail(status, "%s: %s", path, message);
    hg_free(message);
    return status;
}

/* What the options say of the file. --unit is a name (cm) or a length (2.5 cm). */
static hg_status read_import(const hg_arguments *arguments, hg_import *with)
{
    const char *unit = cli_value(arguments, "unit", NULL), *up = cli_value(arguments, "up", NULL);
    *with = (hg_import){ .rig = cli_value(arguments, "rig", NULL),
                         .scalp = cli_value(arguments, "scalp", NULL),
                         .skeleton = cli_value(arguments, "skeleton", NULL),
                         .animation = cli_value(arguments, "animation", NULL) };
    if (up && strcmp(up, "y") != 0 && strcmp(up, "z") != 0) return hg_fail(HG_INVALID, "--up %s: y or z", up);
    if (up) with->up = *up;
    if (!unit) return HG_OK;
    bool length = *unit >= '0' && *unit <= '9';
    char *text = hg_format(length ? "%s" : "1 %s", unit);
    hg_status status = text ? hg_unit_parse(text, "m", &with->unit) : HG_MEMORY;
    hg_free(text);
    HG_TRY(status);
    return with->unit > 0 ? HG_OK : hg_fail(HG_INVALID, "--unit %s: more than nothing", unit);
}

static void say_notes(hg_text *notes)
{
    if (notes->size > 0) printf("%s", notes->data);
    hg_text_free(notes);
}

/* ---- body ---------------------------------------------------------------------------------------------------- */

static hg_status import_body(hg_ctx *ctx, const char *path, const hg_arguments *arguments, const char *output)
{
    hg_body *body = NULL;
    hg_import with;
    hg_text notes = { 0 };
    HG_TRY(read_import(arguments, &with));
    hg_status status = hg_body_read(ctx, &body, path, &with, &notes);
    if (status == HG_OK) status = of_file(hg_body_save(body, output), path);
    if (status == HG_OK) {
        int shapes = 0;
        for (int k = 0; k < HG_SHAPES; k++) shapes += body->shape_spread[k] > 0;
        printf("%s: %lld vertices, %lld faces, %lld joints, %d shape directions\n", output, (long long)body->vertices,
               (long long)body->faces, (long long)body->joints, shapes);
        printf("scalp %lld faces, collider %lld faces (the part above the chest that can be seen from outside)\n",
               (long long)body->scalp_faces, (long long)body->collider_faces);
        say_notes(&notes);
    }
    hg_text_free(&notes);
    hg_body_destroy(body);
    return status;
}

/* ---- motion -------------------------------------------------------------------------------------------------- */

static hg_status import_motion(hg_ctx *ctx, const char *path, const hg_arguments *arguments, const char *output)
{
    (void)ctx;
    const char *body_path = cli_value(arguments, "body", NULL);
    double rate = 30;
    if (!body_path) return hg_fail(HG_INVALID, "import motion needs --body BODY.h5, the body that is to move");
    if (!cli_number(arguments, "rate", &rate)) return HG_INVALID;
    hg_body *body = NULL;
    hg_clip *clip = NULL;
    hg_motion *motion = NULL;
    hg_import with;
    hg_text notes = { 0 };
    HG_TRY(read_import(arguments, &with));
    hg_status status = hg_body_load(&body, body_path);
    with.body = body;
    if (status == HG_OK) status = hg_clip_read(&clip, path, &with, &notes);
    if (status == HG_OK) status = of_file(hg_clip_retarget(&motion, clip, body, rate), path);
    if (status == HG_OK) {
        const char *name = strrchr(path, '/');
        hg_free(motion->name);
        motion->name = hg_strdup(name ? name + 1 : path);
        status = motion->name ? hg_motion_save(motion, output) : HG_MEMORY;
    }
    if (status == HG_OK)
        printf("%s: %lld frames of %lld joints at %g per second, %.1f s (the file has %lld at %g)\n", output,
               (long long)motion->frames, (long long)motion->joints, motion->rate,
               (double)motion->frames / motion->rate, (long long)clip->frames, clip->rate);
    if (status == HG_OK) say_notes(&notes);
    hg_text_free(&notes);
    hg_motion_destroy(motion);
    hg_clip_destroy(clip);
    hg_body_destroy(body);
    return status;
}

/* ---- groom --------------------------------------------------------------------------------------------------- */

static hg_status read_similarity(const char *text, hg_similarity *similarity)
{
    double number[4];
    const char *at = text;
    for (int i = 0; i < 4; i++) {
        char *end;
        number[i] = strtod(at, &end);
        bool last = i == 3;
        if (end == at || !isfinite(number[i]) || *end != (last ? '\0' : ','))
            return hg_fail(HG_INVALID, "--similarity \"%s\" is not scale,x,y,z (x' = scale x + translation, metres)",
                           text);
        at = end + 1;
    }
    *similarity = (hg_similarity){ number[0], { 1, 0, 0, 0 }, { number[1], number[2], number[3] } };
    return HG_OK;
}

static void say_dropped(const hg_groom_report *report)
{
    printf("strands: %lld in the file, %lld kept", (long long)report->strands, (long long)report->kept);
    const struct {
        const char *what;
        int64_t count;
    } dropped[] = { { "bald (one vertex or none)", report->bald },
                    { "of zero length", report->zero_length },
                    { "not finite", report->non_finite } };
    for (int i = 0; i < 3; i++)
        if (dropped[i].count > 0) printf(", %lld dropped: %s", (long long)dropped[i].count, dropped[i].what);
    printf("\n");
}

static void say_fitted(const hg_groom *groom, const hg_similarity *similarity, const char *how,
                       const hg_fit_report *report)
{
    double vertices = (double)(groom->strands * (groom->vertices - 1));
    printf("similarity %s: scale %.6f, translation %.6f, %.6f, %.6f\n", how, similarity->scale,
           similarity->translation[0], similarity->translation[1], similarity->translation[2]);
    printf("roots moved to the scalp: median %.1f mm, 95 %% under %.1f, most %.1f; %lld (%.1f %%) by more than 1 cm\n",
           1e3 * report->moved_median, 1e3 * report->moved_p95, 1e3 * report->moved_max, (long long)report->moved_far,
           100 * (double)report->moved_far / (double)groom->strands);
    printf("vertices inside the body: %.2f %% before, %.2f %% after they were pushed out\n",
           100 * (double)report->inside_before / vertices, 100 * (double)report->inside_after / vertices);
}

/* The similarity asked for: given, found from the head that the groom was made for, or none. */
static hg_status get_similarity(hg_ctx *ctx, const hg_arguments *arguments, const hg_body *body, const hg_groom *groom,
                                double unit, bool z_up, hg_similarity *similarity)
{
    const char *given = cli_value(arguments, "similarity", NULL), *source = cli_value(arguments, "source-mesh", NULL);
    bool find = cli_flag(arguments, "find");
    *similarity = (hg_similarity){ 1, { 1, 0, 0, 0 }, { 0, 0, 0 } };
    if (given && find) return hg_fail(HG_INVALID, "--similarity and --find: one of them, not both");
    if (given) return read_similarity(given, similarity);
    if (find != (source != NULL))
        return hg_fail(HG_INVALID,
                       "--find and --source-mesh HEAD.obj belong together: the head that the groom was made for");
    if (!find) return HG_OK;
    hg_mesh *mesh = NULL;
    HG_TRY(hg_mesh_read_obj(&mesh, source));
    hg_curves_to_world(&(hg_curves){ .strands = 1, .start = (int64_t[]){ 0, mesh->vertices }, .points = mesh->points },
                       unit, z_up);
    hg_status status = hg_fit_similarity(ctx, body, mesh->vertices, mesh->points, groom, similarity);
    hg_mesh_destroy(mesh);
    return status;
}

static hg_status import_groom(hg_ctx *ctx, const char *path, const hg_arguments *arguments, const char *output)
{
    const char *body_path = cli_value(arguments, "body", NULL);
    int64_t vertices = 25;
    hg_import with;
    HG_TRY(read_import(arguments, &with));
    double unit = with.unit > 0 ? with.unit : 1;
    bool z_up = with.up == 'z';
    if (!body_path)
        return hg_fail(HG_INVALID, "import groom needs --body BODY.h5, the body that the hair is to grow on");
    if (!cli_integer(arguments, "vertices", &vertices)) return HG_INVALID;
    if (vertices < 2 || vertices > 1024)
        return hg_fail(HG_INVALID, "--vertices %lld: 2 to 1024 are possible", (long long)vertices);

    const hg_groom_reader *reader = hg_groom_reader_find(path);
    if (!reader) return HG_UNSUPPORTED;
    if (reader->metres && (cli_value(arguments, "unit", NULL) || cli_value(arguments, "up", NULL)))
        return hg_fail(HG_INVALID, "%s: .%s files have their own unit and axes: --unit and --up are not for them", path,
                       reader->extension);
    char doubt[160] = "";
    hg_body *body = NULL;
    hg_curves *curves = NULL;
    hg_groom *groom = NULL;
    hg_groom_report read = { 0 };
    hg_fit_report fitted = { 0 };
    hg_similarity similarity;
    hg_status status = hg_body_load(&body, body_path);
    if (status == HG_OK) status = hg_curves_read(&curves, path);
    if (status == HG_OK) {
        hg_curves_to_world(curves, unit, z_up);
        hg_curves_in_metres(curves, doubt);
        status = of_file(hg_groom_from_curves(&groom, curves, vertices, &read), path);
    }
    if (status == HG_OK) status = get_similarity(ctx, arguments, body, groom, unit, z_up, &similarity);
    if (status == HG_OK) status = of_file(hg_fit_groom(ctx, groom, body, &similarity, &fitted), body_path);
    if (status == HG_OK) {
        const char *name = strrchr(path, '/');
        hg_free(groom->name);
        groom->name = hg_strdup(name ? name + 1 : path);
        status = groom->name ? hg_groom_save(groom, output) : HG_MEMORY;
    }
    if (status == HG_OK) {
        printf("%s: %lld strands of %lld vertices\n", output, (long long)groom->strands, (long long)groom->vertices);
        say_dropped(&read);
        if (doubt[0]) printf("unit: %s\n", doubt);
        const char *how = cli_flag(arguments, "find")                ? "found"
                          : cli_value(arguments, "similarity", NULL) ? "given"
                                                                     : "not asked for";
        say_fitted(groom, &similarity, how, &fitted);
    }
    hg_groom_destroy(groom);
    hg_curves_destroy(curves);
    hg_body_destroy(body);
    return status;
}

/* ---- the command --------------------------------------------------------------------------------------------- */

static int import(const hg_arguments *arguments)
{
    static const struct {
        const char *kind;
        hg_status (*run)(hg_ctx *, const char *, const hg_arguments *, const char *);
    } kinds[] = { { "groom", import_groom }, { "body", import_body }, { "motion", import_motion } };
    const char *output = cli_value(arguments, "output", NULL);
    int kind = 0;
    while (kind < 3 && strcmp(arguments->free[0], kinds[kind].kind) != 0) kind++;
    if (kind == 3) {
        hg_fail(HG_INVALID, "import %s: groom, body or motion can be imported", arguments->free[0]);
        return cli_fail();
    }
    if (!output) {
        hg_fail(HG_INVALID, "import %s needs --output FILE.h5 (-o)", kinds[kind].kind);
        return cli_fail();
    }
    hg_ctx *ctx = NULL;
    if (!cli_context(&ctx, arguments)) return cli_fail();
    hg_status status = kinds[kind].run(ctx, arguments->free[1], arguments, output);
    hg_ctx_destroy(ctx);
    return status == HG_OK ? 0 : cli_fail();
}

static const hg_argument import_options[] = {
    { "output", "FILE.h5", "where to write (-o)", false },
    { "body", "BODY.h5", "groom, motion: the body it is for", false },
    { "vertices", "N", "groom: vertices per strand, by arc length (default 25)", false },
    { "unit", "UNIT", "of the file, and of --source-mesh: m, cm, mm, inch, or a length, \"0.4 m\" (default m)", false },
    { "up", "y|z", "axis that is up in the file (default y; AMASS z)", false },
    { "similarity", "S,X,Y,Z", "groom: x' = S x + (X,Y,Z) takes its head to the body, in metres, +Y up", false },
    { "find", NULL, "groom: find that similarity from --source-mesh", false },
    { "source-mesh", "HEAD.obj", "groom: the head it was made for", false },
    { "rig", "NAME", "body: rig.NAME.json and weights.NAME.json (default cmu_mb)", false },
    { "scalp", "FILE|LENGTH", "body: faces that carry hair, by number, or all so near the top of the head (\"9 cm\")",
      false },
    { "skeleton", "FILE", "motion: the .asf of an .amc clip; the SMPL-like body of an AMASS clip", false },
    { "animation", "NAME", "motion: of a glTF file, by name or number (default: the first)", false },
    { "rate", "N", "motion: frames per second to write (default 30)", false },
    CLI_CONTEXT_OPTIONS,
};

/* What can be imported, from the readers that are there. */
static void list_readers(FILE *to)
{
    static const struct {
        const char *kind, *title;
    } kinds[] = { { "groom reader", "grooms" }, { "body reader", "bodies" }, { "motion reader", "motions" } };
    for (int k = 0; k < 3; k++) {
        const char *names[64];
        int n = hg_list(kinds[k].kind, names, 64);
        fprintf(to, "\n%s:\n", kinds[k].title);
        for (int i = 0; i < n && i < 64; i++) {
            const hg_groom_reader *groom = k == 0 ? hg_find(kinds[k].kind, names[i]) : NULL;
            const hg_body_reader *body = k == 1 ? hg_find(kinds[k].kind, names[i]) : NULL;
            const hg_clip_reader *clip = k == 2 ? hg_find(kinds[k].kind, names[i]) : NULL;
            const char *extension = groom ? groom->extension : body ? body->extension : clip->extension;
            const char *what = groom ? groom->what : body ? body->what : clip->what;
            fprintf(to, "  %s%-*s %s\n", *extension ? "." : "", *extension ? 11 : 12,
                    *extension ? extension : "a folder", what);
        }
    }
}

HG_COMMAND(import, .what = "bring a groom, a body or a motion into the files used here",
           .usage = "groom FILE | body FILE|FOLDER | motion FILE", .options = import_options,
           .n_options = (int)(sizeof import_options / sizeof *import_options), .min_free = 2, .max_free = 2,
           .run = import, .help = list_readers,
           .more = "hairgrad import body data/bodies -o body.h5\n"
                   "hairgrad import body smpl.npz --scalp \"10 cm\" -o body.h5\n"
                   "hairgrad import groom hair.tfx --body body.h5 --find --source-mesh head.obj -o groom.h5\n"
                   "hairgrad import motion 01_01.amc --skeleton 01.asf --body body.h5 -o motion.h5\n"
                   "hairgrad import motion character.glb --animation Walking --body body.h5 -o motion.h5\n");
