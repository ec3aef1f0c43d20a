/* NumPy's files: every array of them, as every kind of number, and as strands. */
#include "tests/fuzz/fuzz.h"
#include "tests/small_arrays.h"

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
    npz_file *file;
    hg_curves *curves;
    const char *path = mended(data, size);
    if (hg_curves_read(&curves, path) == HG_OK) hg_curves_destroy(curves);
    if (npz_open(&file, path) != HG_OK) return 0;
    for (int i = 0; i < file->n; i++) {
        void *numbers;
        char **texts;
        int n;
        for (hg_dtype dtype = HG_F32; dtype <= HG_I32; dtype++)
            if (npz_read(file, file->array[i].name, dtype, -1, NULL, NULL, &numbers) == HG_OK) hg_free(numbers);
        if (npz_read_texts(file, file->array[i].name, &n, &texts) == HG_OK) hg_texts_free(texts, n);
    }
    hg_free(npz_describe(file));
    npz_close(file);
    return 0;
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    static small_zip zip;
    uint8_t npy[1024];
    const float numbers[12] = { 1, 2, 3, 4, 5, 6 };
    const uint32_t text[] = { 'a', 0xfc, 0x20ac, 0x1f600 };
    const int64_t counts[] = { 3, 1 };
    if (number > 3) return 0;
    memset(&zip, 0, sizeof zip);
    if (number == 2) return small_seed(npy, small_npy(npy, "'<f4'", true, "2,3", numbers, 24), to, room);
    bool deflated = number == 1;
    if (number == 3) {
        small_zip_add(&zip, "points", npy, small_npy(npy, "'<f4'", false, "4,3", numbers, 48), true);
        small_zip_add(&zip, "counts", npy, small_npy(npy, "'<i8'", false, "2,", counts, 16), true);
        small_zip_add(&zip, "roots", npy, small_npy(npy, "'<f4'", false, "2,3", numbers, 24), true);
    }
    small_zip_add(&zip, "x", npy, small_npy(npy, "'<f4'", true, "2,3", numbers, 24), deflated);
    small_zip_add(&zip, "h", npy, small_npy(npy, "'<f2'", false, "6,", numbers, 12), deflated);
    small_zip_add(&zip, "t", npy, small_npy(npy, "'<U2'", false, "2,", text, 16), deflated);
    small_zip_add(&zip, "o", npy, small_npy(npy, "'|O'", false, "", "\x80\x03.", 3), deflated);
    small_zip_end(&zip);
    return small_seed(zip.bytes, zip.size, to, room);
}
