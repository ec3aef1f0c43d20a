/* What files of other programs hold, as their readers see them: in the file's own unit and axes, nothing resampled. */
#include "cli/facts.h"

#include <math.h>
#include <string.h>
#include <sys/stat.h>

static bool is_native(const char *extension)
{
    static const char *const native[] = { "h5", "hdf5", "vtkhdf" };
    for (int i = 0; i < 3; i++)
        if (strcmp(extension, native[i]) == 0) return true;
    return false;
}

static bool is_folder(const char *path)
{
    struct stat about;
    return stat(path, &about) == 0 && S_ISDIR(about.st_mode);
}

bool info_is_foreign(const char *path)
{
    char *run = hg_path_join(path, "checkpoint.h5");
    bool foreign = is_folder(path) ? !run || !hg_file_exists(run) : !is_native(hg_path_extension(path));
    hg_free(run);
    return foreign && hg_file_exists(path) && (is_folder(path) || *hg_path_extension(path));
}

/* ---- kinds --------------------------------------------------------------------------------------------------- */

static hg_status about_strands(facts *f, const char *path)
{
    hg_curves *c;
    HG_TRY(hg_curves_read(&c, path));
    double longest = 0, sum = 0;
    int64_t fewest = INT64_MAX, most = 0;
    for (int64_t s = 0; s < c->strands; s++) {
        double length = 0;
        for (int64_t p = c->start[s] + 1; p < c->start[s + 1]; p++) {
            const float *a = c->points + 3 * p;
            length +=
                sqrt(pow((double)(a[0] - a[-3]), 2) + pow((double)(a[1] - a[-2]), 2) + pow((double)(a[2] - a[-1]), 2));
        }
        int64_t n = c->start[s + 1] - c->start[s];
        fewest = n < fewest ? n : fewest, most = n > most ? n : most;
        longest = fmax(longest, length), sum += length;
    }
    facts_text(f, "holds", "strands");
    facts_count(f, "strands", c->strands);
    facts_count(f, "fewest_vertices", fewest);
    facts_count(f, "most_vertices", most);
    facts_number(f, "mean_length", sum / (double)c->strands, "of the file's units");
    facts_number(f, "longest", longest, "of the file's units");
    facts_text(f, "root_uv", c->root_uv ? "yes" : "no");
    hg_curves_destroy(c);
    return HG_OK;
}

static hg_status about_body(facts *f, const char *path)
{
    hg_body *b;
    HG_TRY(hg_body_read(NULL, &b, path, NULL, NULL));
    int shapes = 0;
    while (shapes < HG_SHAPES && b->shape_spread[shapes] > 0) shapes++;
    facts_text(f, "holds", "body");
    facts_count(f, "vertices", b->vertices);
    facts_count(f, "faces", b->faces);
    facts_count(f, "joints", b->joints);
    facts_texts(f, "joint_names", b->joint_name, b->joints);
    facts_texts(f, "shapes", b->shape_name, shapes);
    facts_count(f, "scalp_faces", b->scalp_faces);
    facts_extent(f, b->points, b->vertices);
    hg_body_destroy(b);
    return HG_OK;
}

static hg_status about_motion(facts *f, const char *path)
{
    hg_clip *c;
    HG_TRY(hg_clip_read(&c, path, NULL, NULL));
    facts_text(f, "holds", "motion");
    facts_count(f, "frames", c->frames);
    facts_number(f, "rate", c->rate, "1/s");
    facts_number(f, "seconds", (double)(c->frames - 1) / c->rate, "s");
    facts_count(f, "motion_joints", c->joints);
    facts_texts(f, "motion_joint_names", c->name, c->joints);
    hg_clip_destroy(c);
    return HG_OK;
}

/* Every kind that has a reader for such files is tried; what fails is no such thing. */
hg_status info_foreign(facts *f, const char *path)
{
    static const struct {
        const char *kind;
        hg_status (*about)(facts *, const char *);
    } kinds[] = { { "body", about_body }, { "motion", about_motion }, { "strands", about_strands } };
    int found = 0;
    hg_text reasons = { 0 };
    hg_status status = HG_UNSUPPORTED;
    for (int k = 0; k < 3; k++) {
        hg_status tried = kinds[k].about(f, path);
        if (tried == HG_OK) found++;
        if (tried == HG_MEMORY || tried == HG_IO) found = -8;
        if (tried != HG_UNSUPPORTED || !strstr(hg_message(), "known are")) status = tried == HG_OK ? status : tried;
        if (tried != HG_OK && !strstr(hg_message(), "known are")) {
            const char *message = hg_message();
            size_t length = strlen(path);
            if (strncmp(message, path, length) == 0 && message[length] == ':') message += length + 2;
            hg_text_add(&reasons, "%sno %s (%s)", reasons.size ? ", " : "", kinds[k].kind, message);
        }
    }
    if (found <= 0)
        hg_fail(status, "%s: %s", path,
                reasons.data ? reasons.data
                             : "no reader for such a file; hairgrad import --help lists what can be read");
    hg_text_free(&reasons);
    return found > 0 ? HG_OK : status;
}
