/* hairgrad convert: strands from one format to another, without a body. */
#include "cli/cli.h"

#include <string.h>

static hg_status get_unit(const hg_arguments *arguments, const char *name, double *metres)
{
    const char *given = cli_value(arguments, name, "m");
    char *text = hg_format("1 %s", given);
    if (!text) return HG_MEMORY;
    hg_status status = hg_unit_parse(text, "m", metres);
    hg_free(text);
    HG_TRY(status);
    return *metres > 0 ? HG_OK : hg_fail(HG_INVALID, "--%s %s: more than nothing", name, given);
}

static hg_status get_up(const hg_arguments *arguments, const char *name, bool *z_up)
{
    const char *up = cli_value(arguments, name, "y");
    *z_up = strcmp(up, "z") == 0;
    return *z_up || strcmp(up, "y") == 0 ? HG_OK : hg_fail(HG_INVALID, "--%s %s: y or z", name, up);
}

/* --unit, --up of a file that does not say it itself. */
static hg_status get_axes(const hg_arguments *arguments, const char *path, bool known, bool output, double *unit,
                          bool *z_up)
{
    const char *unit_name = output ? "out-unit" : "unit", *up_name = output ? "out-up" : "up";
    if (known && (cli_value(arguments, unit_name, NULL) || cli_value(arguments, up_name, NULL)))
        return hg_fail(HG_INVALID, "%s: .%s files have their own unit and axes: --%s and --%s are not for them", path,
                       hg_path_extension(path), unit_name, up_name);
    HG_TRY(get_unit(arguments, unit_name, unit));
    return get_up(arguments, up_name, z_up);
}

typedef struct {
    hg_groom_report read;
    int64_t vertices; /* read */
} counts;

/* Every K-th, or N of them evenly over the file's order. */
static hg_status choose(hg_curves *curves, const hg_arguments *arguments)
{
    int64_t every = 1, wanted = curves->strands, n = 0;
    bool by_step = cli_value(arguments, "every", NULL), by_count = cli_value(arguments, "strands", NULL);
    if (!cli_integer(arguments, "every", &every) || !cli_integer(arguments, "strands", &wanted)) return HG_INVALID;
    if (by_step && by_count) return hg_fail(HG_INVALID, "--every and --strands: one of them, not both");
    if (every < 1) return hg_fail(HG_INVALID, "--every %lld: 1 or more", (long long)every);
    if (wanted < 1) return hg_fail(HG_INVALID, "--strands %lld: 1 or more", (long long)wanted);
    if (by_count && wanted > curves->strands)
        return hg_fail(HG_INVALID, "--strands %lld: there are %lld", (long long)wanted, (long long)curves->strands);
    if (!by_step && !by_count) return HG_OK;
    if (by_step) wanted = (curves->strands + every - 1) / every;
    int64_t *chosen = hg_alloc((size_t)wanted, sizeof *chosen);
    if (!chosen) return HG_MEMORY;
    for (; n < wanted; n++)
        chosen[n] = by_step ? n * every : (int64_t)((double)n * (double)curves->strands / (double)wanted);
    hg_status status = hg_curves_select(curves, n, chosen);
    hg_free(chosen);
    return status;
}

static hg_status change(hg_curves *curves, const char *path, const hg_arguments *arguments, double unit, bool z_up,
                        counts *counted)
{
    double scale = 1;
    int64_t vertices = 0;
    if (!cli_number(arguments, "scale", &scale) || !cli_integer(arguments, "vertices", &vertices)) return HG_INVALID;
    if (!(scale > 0) || !(scale < 1e30)) return hg_fail(HG_INVALID, "--scale %g: more than 0", scale);
    if (cli_value(arguments, "vertices", NULL) && vertices < 2)
        return hg_fail(HG_INVALID, "--vertices %lld: 2 or more", (long long)vertices);
    counted->vertices = curves->start[curves->strands];
    counted->read = (hg_groom_report){ .strands = curves->strands, .kept = curves->strands };
    hg_curves_to_world(curves, unit * scale, z_up);
    if (!cli_flag(arguments, "keep-bald")) {
        hg_status status = hg_curves_clean(curves, &counted->read);
        if (status == HG_INVALID) {
            char *message = hg_strdup(hg_message());
            if (message) hg_fail(status, "%s: %s", path, message);
            hg_free(message);
        }
        HG_TRY(status);
    } else if (vertices) {
        return hg_fail(HG_INVALID, "--keep-bald and --vertices: a bald strand cannot be resampled; one of them");
    }
    HG_TRY(choose(curves, arguments));
    return vertices ? hg_curves_resample(curves, vertices) : HG_OK;
}

static void say_read(const char *path, const counts *counted)
{
    const hg_groom_report *r = &counted->read;
    printf("%s: %lld strands, %lld vertices", path, (long long)r->strands, (long long)counted->vertices);
    if (r->bald) printf(", %lld dropped: bald (one vertex or none)", (long long)r->bald);
    if (r->zero_length) printf(", %lld dropped: of zero length", (long long)r->zero_length);
    if (r->non_finite) printf(", %lld dropped: not finite", (long long)r->non_finite);
    printf("\n");
}

/* A unit that nobody gave is said, and doubted where the numbers do not look like it. */
static void say_unit(const hg_groom_reader *reader, const hg_curves *curves, const hg_arguments *arguments)
{
    char doubt[160];
    bool plausible = hg_curves_in_metres(curves, doubt);
    if (!reader->metres && !cli_value(arguments, "unit", NULL))
        printf("unit: metres, +Y up are assumed; a .%s file does not say%s%s%s\n", reader->extension,
               reader->unit ? " (" : "", reader->unit ? reader->unit : "", reader->unit ? ")" : "");
    if (!plausible) printf("unit: %s\n", doubt);
}

static hg_status convert_file(const hg_arguments *arguments, const char *from, const char *to)
{
    const hg_groom_reader *reader = hg_groom_reader_find(from);
    const hg_groom_writer *writer = reader ? hg_groom_writer_find(to) : NULL;
    if (!writer) return HG_UNSUPPORTED;
    double unit, out_unit;
    bool z_up, out_z_up;
    int64_t frame = 0;
    HG_TRY(get_axes(arguments, from, reader->metres, false, &unit, &z_up));
    HG_TRY(get_axes(arguments, to, writer->metres, true, &out_unit, &out_z_up));
    if (!cli_integer(arguments, "frame", &frame)) return HG_INVALID;
    if (hg_file_exists(to) && !cli_flag(arguments, "force"))
        return hg_fail(HG_INVALID, "%s: is there already; --force writes over it", to);
    hg_curves *curves;
    counts counted;
    HG_TRY(hg_curves_read_frame(&curves, from, frame));
    hg_status status = change(curves, from, arguments, unit, z_up, &counted);
    if (status == HG_OK) {
        say_read(from, &counted);
        say_unit(reader, curves, arguments);
        hg_curves_from_world(curves, out_unit, out_z_up);
        status = hg_curves_write(curves, to, cli_value(arguments, "variant", NULL));
    }
    if (status == HG_OK)
        printf("%s: %lld strands, %lld vertices%s%s%s\n", to, (long long)curves->strands,
               (long long)curves->start[curves->strands], ", in ", cli_value(arguments, "out-unit", "m"),
               out_z_up ? ", +Z up" : ", +Y up");
    hg_curves_destroy(curves);
    return status;
}

static int convert(const hg_arguments *arguments)
{
    return convert_file(arguments, arguments->free[0], arguments->free[1]) == HG_OK ? 0 : cli_fail();
}

static const hg_argument convert_options[] = {
    { "unit", "UNIT", "of IN: m, dm, cm, mm, inch (default m)", false },
    { "up", "y|z", "axis that is up in IN (default y)", false },
    { "out-unit", "UNIT", "of OUT (default m)", false },
    { "out-up", "y|z", "axis that is up in OUT (default y)", false },
    { "scale", "S", "makes everything S times as large", false },
    { "vertices", "N", "resample every strand to N vertices, by arc length", false },
    { "every", "K", "keep every K-th strand", false },
    { "strands", "N", "keep N strands, evenly over the file's order", false },
    { "frame", "N", "of a drape or posed scene: the frame to take (default 0)", false },
    { "keep-bald", NULL, "drop nothing: strands without length or not finite stay, where OUT can hold them", false },
    { "variant", "NAME", ".tfx: 4 or 3; .ply: binary or ascii", false },
    { "force", NULL, "write over OUT when it is there", false },
};
HG_COMMAND(convert, .what = "strands from one format to another", .usage = "IN OUT", .options = convert_options,
           .n_options = (int)(sizeof convert_options / sizeof *convert_options), .min_free = 2, .max_free = 2,
           .run = convert,
           .more = "The formats are chosen by extension; docs/formats.md describes them.\n"
                   "hairgrad convert strands.data strands.ply\n"
                   "hairgrad convert wCurly.hair curly.npz --unit inch --up z --vertices 25 --every 10\n"
                   "hairgrad convert drape.vtkhdf frame12.hair --frame 12\n");
