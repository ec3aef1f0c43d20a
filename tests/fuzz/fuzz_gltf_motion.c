/* glTF, as text and as binary: the animation in it, put on the bust. */
#include "tests/fuzz/fuzz.h"
#include "tests/small_people.h"

int fuzz_one(const uint8_t *data, size_t size)
{
    static hg_body *body;
    if (!body && hg_bust_create(&body) != HG_OK) abort();
    hg_clip *clip;
    hg_motion *motion;
    hg_text notes = { 0 };
    if (hg_clip_read(&clip, fuzz_file(data, size, "glb"), NULL, &notes) == HG_OK) {
        if (clip->frames < 1000 && hg_clip_retarget(&motion, clip, body, clip->rate) == HG_OK)
            hg_motion_destroy(motion);
        hg_clip_destroy(clip);
    }
    hg_text_free(&notes);
    return 0;
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    char text[8192];
    uint8_t bytes[8192];
    if (number == 0) return small_seed(text, small_gltf(text), to, room);
    if (number == 1) return small_seed(bytes, small_glb(bytes), to, room);
    return 0;
}
