/* Wavefront .obj: one polyline (l) for a strand, one point (p) for a bald root. It is read by nearly every viewer. */
#include "scene/internal.h"

static hg_status write_obj(const hg_curves *curves, const char *path, const char *variant)
{
    hg_text text = { 0 };
    (void)variant;
    HG_TRY(scene_finite_strands(curves, path));
    hg_text_add(&text, "# %lld strands, written by hairgrad\n", (long long)curves->strands);
    for (int64_t s = 0; s < curves->strands; s++) {
        int64_t first = curves->start[s], n = curves->start[s + 1] - first;
        for (int64_t v = first; v < first + n; v++) {
            const float *p = curves->points + 3 * v;
            hg_text_add(&text, "v %.9g %.9g %.9g\n", (double)p[0], (double)p[1], (double)p[2]);
        }
        if (n > 0) hg_text_add(&text, n > 1 ? "l" : "p");
        for (int64_t v = first; v < first + n; v++) hg_text_add(&text, " %lld", (long long)v + 1);
        if (n > 0) hg_text_add(&text, "\n");
    }
    hg_status status = text.failed ? HG_MEMORY : hg_file_write(path, text.data, text.size);
    hg_text_free(&text);
    return status;
}

static const hg_groom_writer writer = { .extension = "obj", .what = "Wavefront, polylines", .write = write_obj };
HG_REGISTER("groom writer", obj, &writer);
