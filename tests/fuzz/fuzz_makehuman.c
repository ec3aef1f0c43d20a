/* The base mesh of a MakeHuman body, with everything that is made of it. */
#include "tests/fuzz/fuzz.h"
#include "tests/small_files.h"

int fuzz_one(const uint8_t *data, size_t size)
{
    static const char *folder;
    if (!folder) folder = small_makehuman();
    small_write("makehuman/base.obj", data, size);
    hg_body *body = NULL;
    if (hg_body_read_makehuman(NULL, &body, folder, "cmu_mb") == HG_OK) hg_body_destroy(body);
    return 0;
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    if (number == 0) return small_seed(small_obj, sizeof small_obj - 1, to, room);
    return 0;
}
