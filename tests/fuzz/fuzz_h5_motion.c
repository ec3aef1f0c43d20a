/* A motion file. */
#include "tests/fuzz/fuzz.h"
#include "tests/small_files.h"

int fuzz_one(const uint8_t *data, size_t size)
{
    hg_motion *motion = NULL;
    if (hg_motion_load(&motion, fuzz_file(data, size, "h5"), NULL) == HG_OK) hg_motion_destroy(motion);
    return 0;
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    const char *path = small_path("seed.h5");
    hg_body *body = NULL;
    hg_motion *motion = NULL;
    void *bytes = NULL;
    size_t size = 0;
    if (number > 0) return 0;
    if (small_body(&body) != HG_OK || hg_motion_make(&motion, body, "nod", 0.2, 30, 1) != HG_OK ||
        hg_motion_save(motion, path) != HG_OK || hg_file_read(path, &bytes, &size) != HG_OK) {
        fprintf(stderr, "%s\n", hg_message());
        abort();
    }
    size = small_seed(bytes, size, to, room);
    hg_free(bytes);
    hg_motion_destroy(motion);
    hg_body_destroy(body);
    return size;
}
