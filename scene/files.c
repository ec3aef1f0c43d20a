/* What every file of scene/ has in common: its kind, unit and up axis, and checks of what it says. */
#include "scene/internal.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>

enum { VERSION = 1 };

hg_status scene_check_finite(const char *path, const char *what, const float *data, int64_t rows, int64_t columns)
{
    for (int64_t i = 0; i < rows * columns; i++)
        if (!isfinite(data[i]))
            return hg_fail(HG_NUMERIC, "%s: %s has a number that is not finite in row %lld (column %lld)", path, what,
                           (long long)(i / columns), (long long)(i % columns));
    return HG_OK;
}

hg_status scene_check_range(const char *path, const char *what, const int32_t *data, int64_t count, int64_t low,
                            int64_t high)
{
    for (int64_t i = 0; i < count; i++)
        if (data[i] < low || data[i] >= high)
            return hg_fail(HG_FORMAT, "%s: %s: entry %lld is %d, expected %lld to %lld", path, what, (long long)i,
                           data[i], (long long)low, (long long)high - 1);
    return HG_OK;
}

hg_status scene_axes_read(hg_h5 *file, const char *path, scene_axes *axes)
{
    char *unit, *up;
    *axes = (scene_axes){ .scale = 1 };
    HG_TRY(scene_text_or(file, "unit", "m", &unit));
    char *one = hg_format("1 %s", unit);
    hg_status status = one ? hg_unit_parse(one, "m", &axes->scale) : HG_MEMORY;
    if (status == HG_INVALID || status == HG_FORMAT || (status == HG_OK && !(axes->scale > 0)))
        status = hg_fail(HG_FORMAT, "%s: attribute unit is \"%s\", expected a unit of length such as \"m\" or \"cm\"",
                         path, unit);
    hg_free(one);
    hg_free(unit);
    HG_TRY(status);

    HG_TRY(scene_text_or(file, "up_axis", "+Y", &up));
    axes->z_up = strcmp(up, "+Z") == 0;
    if (!axes->z_up && strcmp(up, "+Y") != 0)
        status = hg_fail(HG_FORMAT, "%s: attribute up_axis is \"%s\", expected \"+Y\" or \"+Z\"", path, up);
    hg_free(up);
    return status;
}

/* +Z up, facing -Y, becomes +Y up, facing +Z: (x, z, -y). */
void scene_axes_points(const scene_axes *axes, float *points, int64_t count)
{
    if (axes->scale == 1 && !axes->z_up) return;
    for (int64_t i = 0; i < count; i++) {
        float *p = points + 3 * i, y = p[1], z = p[2];
        float scale = (float)axes->scale;
        p[0] *= scale, p[1] = scale * (axes->z_up ? z : y), p[2] = scale * (axes->z_up ? -y : z);
    }
}

void scene_axes_turn(const scene_axes *axes, float *quaternions, int64_t count)
{
    if (!axes->z_up) return;
    for (int64_t i = 0; i < count; i++) {
        float *q = quaternions + 4 * i, y = q[2];
        q[2] = q[3], q[3] = -y;
    }
}

/* A sentence says what the file is instead, when it is not of this format. */
static hg_status check_format(hg_h5 *file, const char *path, const char *expected)
{
    char *format;
    double version;
    if (hg_h5_get_text(file, "/", "format", &format) != HG_OK)
        return hg_fail(HG_FORMAT, "%s: not a %s: it has no attribute `format` (docs/formats.md has the layout)", path,
                       expected);
    bool same = strcmp(format, expected) == 0;
    if (!same) hg_fail(HG_FORMAT, "%s: it is a %.64s, expected a %s", path, format, expected);
    hg_free(format);
    if (!same) return HG_FORMAT;
    if (hg_h5_get_number(file, "/", "version", &version) == HG_OK && !(version >= 1 && version < VERSION + 1))
        return hg_fail(HG_FORMAT, "%s: it has version %g of its format; versions up to %d can be read", path, version,
                       VERSION);
    return HG_OK;
}

hg_status scene_file_load(const char *path, const char *format,
                          hg_status (*read)(hg_h5 *file, const char *path, const scene_axes *axes, void *to), void *to)
{
    hg_h5 *file;
    scene_axes axes;
    HG_TRY(hg_h5_open(&file, path));
    hg_status status = check_format(file, path, format);
    if (status == HG_OK) status = scene_axes_read(file, path, &axes);
    if (status == HG_OK) status = read(file, path, &axes, to);
    hg_h5_close(file);
    return status;
}

hg_status scene_head_write(hg_h5 *file, const char *format)
{
    HG_TRY(hg_h5_set_text(file, "/", "format", format));
    HG_TRY(hg_h5_set_number(file, "/", "version", VERSION));
    HG_TRY(hg_h5_set_text(file, "/", "unit", "m"));
    return hg_h5_set_text(file, "/", "up_axis", "+Y");
}

hg_status scene_file_save(const char *path, const char *format, hg_status (*write)(hg_h5 *file, const void *from),
                          const void *from)
{
    hg_h5 *file;
    HG_TRY(hg_h5_create(&file, path));
    hg_status status = scene_head_write(file, format);
    if (status == HG_OK) status = write(file, from);
    if (status == HG_OK) return hg_h5_commit(file);
    hg_h5_close(file);
    return status;
}

hg_status scene_hash_write(hg_h5 *file, const char *name, uint64_t hash)
{
    char text[17];
    snprintf(text, sizeof text, "%016" PRIx64, hash);
    return hg_h5_set_text(file, "/", name, text);
}

hg_status scene_text_or(hg_h5 *file, const char *name, const char *otherwise, char **text)
{
    if (hg_h5_get_text(file, "/", name, text) == HG_OK) return HG_OK;
    *text = hg_strdup(otherwise);
    return *text ? HG_OK : HG_MEMORY;
}

double scene_length(const float *points, int64_t vertices)
{
    double length = 0;
    for (int64_t i = 0; i + 1 < vertices; i++)
        length += hg_vec3d_distance(scene_point(points + 3 * i), scene_point(points + 3 * i + 3));
    return length;
}

char **scene_texts_copy(char *const *texts, int64_t n)
{
    char **copy = hg_alloc((size_t)n, sizeof *copy);
    for (int64_t i = 0; copy && i < n; i++) {
        copy[i] = hg_strdup(texts[i]);
        if (!copy[i]) {
            hg_texts_free(copy, (int)n);
            return NULL;
        }
    }
    return copy;
}
