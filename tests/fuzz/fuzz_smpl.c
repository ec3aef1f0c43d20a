/* A body of SMPL's kind. */
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
    hg_body *body;
    hg_text notes = { 0 };
    if (hg_body_read(NULL, &body, mended(data, size), NULL, &notes) == HG_OK) hg_body_destroy(body);
    hg_text_free(&notes);
    return 0;
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    static const float regressor[24][8] = { { 1 }, { 0.5F, 0.5F } };
    static const double data[2] = { 1, 1 };
    static const npz_item others[] = { { "J_regressor", HG_F32, 2, { 24, 8 }, regressor },
                                       { "J_regressor_data", HG_F64, 1, { 2 }, data } };
    if (number > 2) return 0;
    void *bytes;
    size_t size;
    if (hg_file_read(small_smpl("seed.npz", number ? others + number - 1 : NULL), &bytes, &size) != HG_OK) return 0;
    size = small_seed(bytes, size, to, room);
    hg_free(bytes);
    return size;
}
