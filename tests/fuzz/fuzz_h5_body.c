/* A body file. */
#include "tests/fuzz/fuzz.h"
#include "tests/small_files.h"

int fuzz_one(const uint8_t *data, size_t size)
{
    hg_body *body = NULL;
    if (hg_body_load(&body, fuzz_file(data, size, "h5")) == HG_OK) hg_body_destroy(body);
    return 0;
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    const char *path = small_path("seed.h5");
    hg_body *body = NULL;
    void *bytes = NULL;
    size_t size = 0;
    if (number > 0) return 0;
    if (small_body(&body) != HG_OK || hg_body_save(body, path) != HG_OK || hg_file_read(path, &bytes, &size) != HG_OK) {
        fprintf(stderr, "%s\n", hg_message());
        abort();
    }
    size = small_seed(bytes, size, to, room);
    hg_free(bytes);
    hg_body_destroy(body);
    return size;
}
