/* Strands from any file that a registered reader knows, and to any that a writer knows, by its extension. */
#include "scene/scene.h"

#include <string.h>

/* The names of readers are unique, extensions need not be: the first by name is taken. */
static bool has_extension(const char *path, const char *extension)
{
    const char *given = hg_path_extension(path);
    size_t i = 0;
    for (; given[i] && extension[i]; i++)
        if ((given[i] >= 'A' && given[i] <= 'Z' ? given[i] - 'A' + 'a' : given[i]) != extension[i]) return false;
    return given[i] == extension[i];
}

enum { MOST = 64 };

const hg_groom_reader *hg_groom_reader_find(const char *path)
{
    const char *names[MOST];
    hg_text known = { 0 };
    int count = hg_list("groom reader", names, MOST);
    for (int i = 0; i < count && i < MOST; i++) {
        const hg_groom_reader *reader = hg_find("groom reader", names[i]);
        if (reader && has_extension(path, reader->extension)) {
            hg_text_free(&known);
            return reader;
        }
        if (reader) hg_text_add(&known, "%s.%s (%s)", known.size ? ", " : "", reader->extension, reader->what);
    }
    hg_fail(HG_UNSUPPORTED, "%s: no reader for strands in a file ending in \".%.20s\"; known are %s", path,
            hg_path_extension(path), known.data ? known.data : "none");
    hg_text_free(&known);
    return NULL;
}

hg_status hg_curves_read(hg_curves **curves, const char *path)
{
    *curves = NULL;
    const hg_groom_reader *reader = hg_groom_reader_find(path);
    return reader ? reader->read(curves, path) : HG_UNSUPPORTED;
}

hg_status hg_curves_read_frame(hg_curves **curves, const char *path, int64_t frame)
{
    *curves = NULL;
    const hg_groom_reader *reader = hg_groom_reader_find(path);
    if (!reader) return HG_UNSUPPORTED;
    if (reader->read_frame) return reader->read_frame(curves, path, frame);
    return frame == 0 ? reader->read(curves, path)
                      : hg_fail(HG_INVALID, "%s: frame %lld: a .%s file has one frame, number 0", path,
                                (long long)frame, reader->extension);
}

const hg_groom_writer *hg_groom_writer_find(const char *path)
{
    const char *names[MOST];
    hg_text known = { 0 };
    int count = hg_list("groom writer", names, MOST);
    for (int i = 0; i < count && i < MOST; i++) {
        const hg_groom_writer *writer = hg_find("groom writer", names[i]);
        if (writer && has_extension(path, writer->extension)) {
            hg_text_free(&known);
            return writer;
        }
        if (writer) hg_text_add(&known, "%s.%s (%s)", known.size ? ", " : "", writer->extension, writer->what);
    }
    hg_fail(HG_UNSUPPORTED, "%s: no writer for strands to a file ending in \".%.20s\"; known are %s", path,
            hg_path_extension(path), known.data ? known.data : "none");
    hg_text_free(&known);
    return NULL;
}

/* The variant that is meant, "" when it is not one of "a|b|c". */
static const char *find_variant(const char *variants, const char *asked, char found[16])
{
    found[0] = '\0';
    if (!variants) return NULL;
    for (const char *at = variants;; at = strchr(at, '|') + 1) {
        size_t length = strcspn(at, "|");
        if (length < 16 && (!asked || (strlen(asked) == length && memcmp(asked, at, length) == 0))) {
            memcpy(found, at, length);
            found[length] = '\0';
            break;
        }
        if (!at[length]) break;
    }
    return found;
}

hg_status hg_curves_write(const hg_curves *curves, const char *path, const char *variant)
{
    char found[16];
    const hg_groom_writer *writer = hg_groom_writer_find(path);
    if (!writer) return HG_UNSUPPORTED;
    if (curves->strands < 1) return hg_fail(HG_INVALID, "%s: there is no strand to write", path);
    const char *chosen = find_variant(writer->variants, variant, found);
    if (variant && !chosen)
        return hg_fail(HG_INVALID, "%s: .%s has one variant only, none to choose", path, writer->extension);
    if (chosen && !*chosen)
        return hg_fail(HG_INVALID, "%s: .%s has no variant \"%s\"; known are %s", path, writer->extension, variant,
                       writer->variants);
    return writer->write(curves, path, chosen);
}

static hg_status check(const char *name, const void *item)
{
    const hg_groom_reader *reader = item;
    if (!reader || !reader->extension || !*reader->extension || !reader->what || !reader->read)
        return hg_fail(HG_INVALID, "reader '%s' lacks its extension, what it reads, or its function", name);
    return HG_OK;
}

static const hg_declaration declaration = { check };
HG_REGISTER("declaration", groom_reader, &declaration);
