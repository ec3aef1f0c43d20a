/* Bodies and clips from any file that a registered reader knows, by its extension. (Strands: read_curves.c.) */
#include "scene/scene.h"

#include <string.h>
#include <sys/stat.h>

static void lower(const char *path, char extension[16])
{
    const char *given = hg_path_extension(path);
    size_t i = 0;
    for (; given[i] && i < 15; i++)
        extension[i] = given[i] >= 'A' && given[i] <= 'Z' ? (char)(given[i] - 'A' + 'a') : given[i];
    extension[i] = '\0';
}

/* What the two kinds of readers begin with. */
typedef struct {
    const char *extension, *what;
} any_reader;

static const any_reader *find(const char *kind, const char *path, const char *thing)
{
    char extension[16];
    const char *names[64];
    struct stat about;
    lower(path, extension);
    if (stat(path, &about) == 0 && S_ISDIR(about.st_mode)) extension[0] = '\0';
    int count = hg_list(kind, names, 64);
    hg_text known = { 0 };
    for (int i = 0; i < count && i < 64; i++) {
        const any_reader *reader = hg_find(kind, names[i]);
        if (reader && strcmp(reader->extension, extension) == 0) {
            hg_text_free(&known);
            return reader;
        }
        if (reader && *reader->extension)
            hg_text_add(&known, "%s.%s (%s)", known.size ? ", " : "", reader->extension, reader->what);
        else if (reader)
            hg_text_add(&known, "%sa folder (%s)", known.size ? ", " : "", reader->what);
    }
    hg_fail(HG_UNSUPPORTED, "%s: no reader for a %s in such a file; known are %s", path, thing,
            known.data ? known.data : "none");
    hg_text_free(&known);
    return NULL;
}

hg_status hg_body_read(hg_ctx *ctx, hg_body **body, const char *path, const hg_import *with, hg_text *notes)
{
    static const hg_import nothing = { 0 };
    *body = NULL;
    const hg_body_reader *reader = (const void *)find("body reader", path, "body");
    return reader ? reader->read(ctx, body, path, with ? with : &nothing, notes) : HG_UNSUPPORTED;
}

hg_status hg_clip_read(hg_clip **clip, const char *path, const hg_import *with, hg_text *notes)
{
    static const hg_import nothing = { 0 };
    *clip = NULL;
    const hg_clip_reader *reader = (const void *)find("motion reader", path, "motion");
    return reader ? reader->read(clip, path, with ? with : &nothing, notes) : HG_UNSUPPORTED;
}
