/* shape: body shape coefficients and clips by name on the command line. */
#include "cli/shape.h"

#include <stdlib.h>
#include <string.h>

hg_status cli_shape(const hg_arguments *arguments, double shape[HG_SHAPES], bool *given)
{
    const char *text = cli_value(arguments, "shape", NULL);
    memset(shape, 0, HG_SHAPES * sizeof *shape);
    *given = text != NULL;
    for (int k = 0; text && *text; k++) {
        char *end;
        const double value = strtod(text, &end);
        if (k == HG_SHAPES || end == text || (*end && *end != ',') || !(value >= -10 && value <= 10))
            return hg_fail(HG_INVALID, "--shape %s: expected up to %d numbers between -10 and 10, like 0.5,0,-1",
                           cli_value(arguments, "shape", ""), HG_SHAPES);
        shape[k] = value;
        text = *end ? end + 1 : end;
    }
    return HG_OK;
}

static const char *last_part(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

static bool is_called(const hg_motion *motion, const char *name)
{
    if (!motion->name) return false;
    const char *last = last_part(motion->name);
    const char *dot = strrchr(last, '.');
    return !strcmp(motion->name, name) || !strcmp(last, name) ||
           (dot && strlen(name) == (size_t)(dot - last) && !strncmp(last, name, strlen(name)));
}

const hg_motion *cli_clip(const hg_hair_task *task, const char *name)
{
    for (int held_out = 1; held_out >= 0; held_out--)
        for (int i = 0; i < hg_hair_clips(task, held_out); i++)
            if (is_called(hg_hair_clip(task, held_out, i), name)) return hg_hair_clip(task, held_out, i);
    hg_text known = { 0 };
    for (int held_out = 0; held_out < 2; held_out++)
        for (int i = 0; i < hg_hair_clips(task, held_out); i++) {
            const char *clip = hg_hair_clip(task, held_out, i)->name;
            hg_text_add(&known, "%s%s", known.size ? ", " : "", clip ? last_part(clip) : "?");
        }
    hg_fail(HG_INVALID, "the run has no clip \"%s\"; it has %s", name, known.data ? known.data : "none");
    hg_text_free(&known);
    return NULL;
}
