/* A Biovision clip, put on the bust. */
#include "tests/fuzz/fuzz.h"
#include "tests/small_files.h"

int fuzz_one(const uint8_t *data, size_t size)
{
    static hg_body *body;
    if (!body && hg_bust_create(&body) != HG_OK) abort();
    hg_clip *clip = NULL;
    hg_motion *motion = NULL;
    if (hg_clip_read_bvh(&clip, fuzz_file(data, size, "bvh")) == HG_OK &&
        hg_clip_retarget(&motion, clip, body, 30) == HG_OK)
        hg_motion_destroy(motion);
    hg_clip_destroy(clip);
    return 0;
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    if (number == 0) return small_seed(small_bvh, sizeof small_bvh - 1, to, room);
    return 0;
}
