/* A clip of AMASS's kind, put on the bust. */
#include "tests/fuzz/fuzz.h"
#include "tests/small_arrays.h"
#include "tests/small_people.h"

static const char *mended(const uint8_t *data, size_t size)
{
    uint8_t *copy = malloc(size + 1);
    if (!copy) abort();
    memcpy(copy, data, size);
    if (size % 4) small_zip_mend(copy, size);
    const char *path = fuzz_file(copy, size, "npz");
    free(copy);
    return path;
}

int fuzz_one(const uint8_t *data, size_t size)
{
    static hg_body *body;
    if (!body && hg_bust_create(&body) != HG_OK) abort();
    hg_clip *clip;
    hg_motion *motion;
    hg_text notes = { 0 };
    hg_import with = { .body = body };
    if (hg_clip_read(&clip, mended(data, size), &with, &notes) == HG_OK) {
        if (clip->frames < 1000 && hg_clip_retarget(&motion, clip, body, clip->rate) == HG_OK)
            hg_motion_destroy(motion);
        hg_clip_destroy(clip);
    }
    hg_text_free(&notes);
    return 0;
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    void *bytes;
    size_t size;
    if (number > 0 || hg_file_read(small_amass("seed.npz", NULL), &bytes, &size) != HG_OK) return 0;
    size = small_seed(bytes, size, to, room);
    hg_free(bytes);
    return size;
}
