/* shape: body shape coefficients and clips by name on the command line. */
#include "cli/shape.h"

#include <stdlib.h>
#include <string.h>

static hg_status unknown_shape(const hg_body *body, const char *name, int length)
{
    hg_text known = { 0 };
    char *given = hg_format("%.*s", length, name);
    const char *nearest = given ? hg_nearest_of(given, (const char *const *)body->shape_name, HG_SHAPES) : NULL;
    for (int k = 0; k < HG_SHAPES; k++) hg_text_add(&known, "%s%s", k ? ", " : "", body->shape_name[k]);
    hg_fail(HG_INVALID, "the body has no shape \"%.*s\"%s%s%s; it has %s", length, name,
            nearest ? " (did you mean " : "", nearest ? nearest : "", nearest ? "?)" : "",
            known.data ? known.data : "none");
    hg_text_free(&known);
    hg_free(given);
    return HG_INVALID;
}

/* Items between commas, a number for the next shape or NAME=number. */
hg_status cli_shape_text(const char *text, const hg_body *body, double shape[HG_SHAPES])
{
    const char *at = text;
    for (int next = 0; *at;) {
        const size_t length = strcspn(at, ",=");
        int k = next;
        if (body && at[length] == '=') {
            for (k = 0; k < HG_SHAPES; k++)
                if (strlen(body->shape_name[k]) == length && !strncmp(body->shape_name[k], at, length)) break;
            if (k == HG_SHAPES) return unknown_shape(body, at, (int)length);
            at += length + 1;
        } else {
            next++;
        }
        char *end;
        const double value = strtod(at, &end);
        if (k == HG_SHAPES || end == at || (*end && *end != ',') || !(value >= -10 && value <= 10))
            return hg_fail(HG_INVALID, "shape %s: expected up to %d numbers between -10 and 10, like 0.5,0,-1%s", text,
                           HG_SHAPES, body ? ", or NAME=number" : "");
        shape[k] = value;
        at = *end ? end + 1 : end;
    }
    return HG_OK;
}

hg_status cli_shape_of(const hg_arguments *arguments, const hg_body *body, double shape[HG_SHAPES], bool *given)
{
    memset(shape, 0, HG_SHAPES * sizeof *shape);
    *given = false;
    for (int i = 0; i < arguments->n_given; i++) {
        if (strcmp(arguments->given[i].name, "shape") != 0) continue;
        HG_TRY(cli_shape_text(arguments->given[i].value, body, shape));
        *given = true;
    }
    return HG_OK;
}

hg_status cli_shape(const hg_arguments *arguments, double shape[HG_SHAPES], bool *given)
{
    return cli_shape_of(arguments, NULL, shape, given);
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
    const char *dot = strrchr(last, '.'), *space = strchr(last, ' '); /* made clips are called "shake 1500" */
    return !strcmp(motion->name, name) || !strcmp(last, name) ||
           (space && strlen(name) == (size_t)(space - last) && !strncmp(last, name, strlen(name))) ||
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

static const char *unit_of(const hg_hair_task *task, const char *name)
{
    const char *found, *unit;
    double range[2], value;
    for (int i = 0; i < hg_hair_materials(task); i++)
        if (hg_hair_material_at(task, i, &found, &unit, range, &value) == HG_OK && !strcmp(found, name)) return unit;
    return NULL;
}

hg_status cli_materials(const hg_arguments *arguments, hg_hair_task *task)
{
    for (int i = 0; i < arguments->n_given; i++) {
        if (strcmp(arguments->given[i].name, "material")) continue;
        char *name = hg_strdup(arguments->given[i].value), *text = name ? strchr(name, '=') : NULL;
        double value = 0;
        hg_status status = name ? HG_OK : HG_MEMORY;
        if (name && !text) status = hg_fail(HG_INVALID, "--material %s: expected NAME=VALUE", name);
        if (text) {
            *text++ = '\0';
            status = hg_unit_parse(text, unit_of(task, name), &value);
            if (status == HG_OK) status = hg_hair_set_material(task, name, value);
        }
        hg_free(name);
        HG_TRY(status);
    }
    return HG_OK;
}
