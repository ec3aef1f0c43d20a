/* glTF, as text and as binary: the body in it. */
#include "tests/fuzz/fuzz.h"
#include "tests/small_people.h"

int fuzz_one(const uint8_t *data, size_t size)
{
    hg_body *body;
    hg_text notes = { 0 };
    if (hg_body_read(NULL, &body, fuzz_file(data, size, "gltf"), NULL, &notes) == HG_OK) hg_body_destroy(body);
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
