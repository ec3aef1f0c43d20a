/* An Acclaim skeleton, under a clip made for another one. */
#include "tests/fuzz/fuzz.h"
#include "tests/small_files.h"

int fuzz_one(const uint8_t *data, size_t size)
{
    static char amc[512];
    if (!amc[0]) snprintf(amc, sizeof amc, "%s", small_write_text("clip.amc", small_amc));
    hg_clip *clip = NULL;
    if (hg_clip_read_amc(&clip, fuzz_file(data, size, "asf"), amc) == HG_OK) hg_clip_destroy(clip);
    return 0;
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    if (number == 0) return small_seed(small_asf, sizeof small_asf - 1, to, room);
    return 0;
}
