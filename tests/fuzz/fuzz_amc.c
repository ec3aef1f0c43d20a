/* An Acclaim clip, put on the bust. */
#include "tests/fuzz/fuzz.h"
#include "tests/small_files.h"

int fuzz_one(const uint8_t *data, size_t size)
{
    static char asf[512];
    static hg_body *body;
    if (!asf[0]) snprintf(asf, sizeof asf, "%s", small_write_text("skeleton.asf", small_asf));
    if (!body && hg_bust_create(&body) != HG_OK) abort();
    hg_clip *clip = NULL;
    hg_motion *motion = NULL;
    if (hg_clip_read_amc(&clip, asf, fuzz_file(data, size, "amc")) == HG_OK &&
        hg_clip_retarget(&motion, clip, body, 30) == HG_OK)
        hg_motion_destroy(motion);
    hg_clip_destroy(clip);
    return 0;
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    if (number == 0) return small_seed(small_amc, sizeof small_amc - 1, to, room);
    return 0;
}
