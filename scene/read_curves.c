/* Strands from any file that a registered reader knows, by its extension. */
#include "scene/scene.h"

#include <string.h>

hg_status hg_curves_read(hg_curves **curves, const char *path)
{
    *curves = NULL;
    char extension[16] = "";
    const char *given = hg_path_extension(path);
    for (size_t i = 0; given[i] && i + 1 < sizeof extension; i++)
        extension[i] = given[i] >= 'A' && given[i] <= 'Z' ? (char)(given[i] - 'A' + 'a') : given[i];
    const char *names[64];
    int count = hg_list("groom reader", names, 64);
    for (int i = 0; i < count && i < 64; i++) {
        const hg_groom_reader *reader = hg_find("groom reader", names[i]);
        if (reader && strcmp(reader->extension, extension) == 0) return reader->read(curves, path);
    }
    hg_text known = { 0 };
    for (int i = 0; i < count && i < 64; i++) {
        const hg_groom_reader *reader = hg_find("groom reader", names[i]);
        if (reader) hg_text_add(&known, "%s.%s (%s)", known.size ? ", " : "", reader->extension, reader->what);
    }
    hg_status status = hg_fail(HG_UNSUPPORTED, "%s: no reader for strands in a file ending in \".%s\"; known are %s",
                               path, extension, known.data ? known.data : "none");
    hg_text_free(&known);
    return status;
}
