/* NumPy's files: what is written is read back, every type and order, packed entries, and files that lie. */
#include "tests/small_arrays.h"
#include "tests/test.h"

static void ok(hg_status status)
{
    if (status != HG_OK) fail_msg("%s: %s", hg_status_name(status), hg_message());
}

static void refused(hg_status status, hg_status expected, const char *words)
{
    assert_int_equal(status, expected);
    if (!strstr(hg_message(), words)) fail_msg("\"%s\" where \"%s\" is expected", hg_message(), words);
}

static void what_is_written_is_read_back(void **state)
{
    (void)state;
    const float points[2][2][3] = { { { 1, 2, 3 }, { 4, 5, 6 } }, { { -1, 0.5F, 1e-30F }, { 7, 8, 9 } } };
    const double number = 1.0 / 3;
    const int32_t counts[] = { 2, 0, -7 };
    npz_item items[] = { { "points", HG_F32, 3, { 2, 2, 3 }, points },
                         { "rate", HG_F64, 0, { 0 }, &number },
                         { "counts", HG_I32, 1, { 3 }, counts },
                         { "none", HG_F32, 2, { 0, 3 }, NULL } };
    const char *path = small_path("a.npz");
    ok(npz_write(path, 4, items));
    npz_file *file;
    ok(npz_open(&file, path));
    assert_int_equal(file->n, 4);
    char *about = npz_describe(file);
    assert_string_equal(about, "points [2,2,3] f4, rate [] f8, counts [3] i4, none [0,3] f4");
    hg_free(about);
    float *read;
    int64_t shape[3], *wide;
    ok(npz_read(file, "points", HG_F32, 3, (int64_t[]){ -1, -1, 3 }, shape, (void **)&read));
    assert_memory_equal(read, points, sizeof points);
    assert_true(shape[0] == 2 && shape[1] == 2 && shape[2] == 3);
    hg_free(read);
    double rate;
    ok(npz_read_number(file, "rate", &rate));
    assert_true(rate == number);
    ok(npz_read_i64(file, "counts", 1, (int64_t[]){ 3 }, NULL, &wide));
    assert_true(wide[0] == 2 && wide[1] == 0 && wide[2] == -7);
    hg_free(wide);
    ok(npz_read(file, "none", HG_F32, 2, (int64_t[]){ -1, 3 }, shape, (void **)&read));
    assert_int_equal(shape[0], 0);
    hg_free(read);
    refused(npz_read(file, "points", HG_F32, 2, (int64_t[]){ -1, 3 }, NULL, (void **)&read), HG_FORMAT,
            "has the shape [2,2,3], expected [any,3]");
    assert_null(read);
    refused(npz_read(file, "poses", HG_F32, 1, (int64_t[]){ -1 }, NULL, (void **)&read), HG_FORMAT,
            "no array \"poses\"; there are points [2,2,3] f4, rate");
    refused(npz_read_number(file, "counts", &rate), HG_FORMAT, "one number");
    int32_t *whole;
    refused(npz_read(file, "points", HG_I32, -1, NULL, shape, (void **)&whole), HG_FORMAT, "element 7");
    npz_close(file);

    /* the same arrays give the same bytes */
    void *first, *second;
    size_t size[2];
    ok(hg_file_read(path, &first, &size[0]));
    ok(npz_write(small_path("b.npz"), 4, items));
    ok(hg_file_read(small_path("b.npz"), &second, &size[1]));
    assert_int_equal(size[0], size[1]);
    assert_memory_equal(first, second, size[0]);
    hg_free(first);
    hg_free(second);

    path = small_path("one.npy");
    ok(npz_write(path, 1, items));
    ok(npz_open(&file, path));
    ok(npz_read(file, "", HG_F32, 3, (int64_t[]){ 2, 2, 3 }, NULL, (void **)&read));
    assert_memory_equal(read, points, sizeof points);
    hg_free(read);
    npz_close(file);
    refused(npz_write(path, 2, items), HG_INVALID, "takes one");
}

static void every_type_and_order(void **state)
{
    (void)state;
    static small_zip zip;
    memset(&zip, 0, sizeof zip);
    uint8_t npy[1024];
    const uint16_t halves[] = { 0x3c00, 0xc000, 0x0001, 0x7bff }; /* 1, -2, 2^-24, 65504 */
    const int8_t bytes[] = { -1, 127 };
    const uint32_t unsigned_root[] = { 4294967295u, 0 };
    const uint8_t flags[] = { 0, 1 };
    const float fortran[] = { 1, 4, 2, 5, 3, 6 }; /* [2,3], first index fastest */
    const uint32_t text[] = { 'H', 0xfc, 0x20ac, 0x1f600, 0, 'a', 0, 0, 0, 0 };
    small_zip_add(&zip, "half", npy, small_npy(npy, "'<f2'", false, "4,", halves, 8), true);
    small_zip_add(&zip, "bytes", npy, small_npy(npy, "'|i1'", false, "2,", bytes, 2), false);
    small_zip_add(&zip, "root", npy, small_npy(npy, "'<u4'", false, "2L,", unsigned_root, 8), true);
    small_zip_add(&zip, "flags", npy, small_npy(npy, "'|b1'", false, "2,", flags, 2), true);
    small_zip_add(&zip, "fortran", npy, small_npy(npy, "'<f4'", true, "2, 3", fortran, 24), true);
    small_zip_add(&zip, "text", npy, small_npy(npy, "'<U5'", false, "2,", text, 40), true);
    small_zip_add(&zip, "gender", npy, small_npy(npy, "'|S6'", false, "", "female", 6), false);
    small_zip_add(&zip, "object", npy, small_npy(npy, "'|O'", false, "", "\x80\x03.", 3), true);
    small_zip_add(&zip, "big", npy, small_npy(npy, "'>f4'", false, "1,", fortran, 4), true);
    small_zip_add(&zip, "complex", npy, small_npy(npy, "'<c8'", false, "1,", fortran, 8), true);
    small_zip_add(&zip, "structure", npy, small_npy(npy, "[('x', '<f4'), ('y', '<i2', (2,))]", false, "1,", fortran, 8),
                  true);
    small_zip_add(&zip, "wide", npy, small_npy(npy, "'<i8'", false, "1,", &(int64_t){ 1LL << 40 }, 8), false);
    small_zip_end(&zip);
    npz_file *file;
    const char *path = small_write("types.npz", zip.bytes, zip.size);
    ok(npz_open(&file, path));
    double *x;
    float *f;
    int64_t *i, one = -1;
    int n;
    char **texts;
    ok(npz_read(file, "half", HG_F64, 1, &one, NULL, (void **)&x));
    assert_true(x[0] == 1 && x[1] == -2 && x[2] == ldexp(1, -24) && x[3] == 65504);
    hg_free(x);
    ok(npz_read_i64(file, "bytes", 1, &one, NULL, &i));
    assert_true(i[0] == -1 && i[1] == 127);
    hg_free(i);
    ok(npz_read_i64(file, "root", 1, &one, NULL, &i));
    assert_true(i[0] == 4294967295 && i[1] == 0);
    hg_free(i);
    ok(npz_read_i64(file, "flags", 1, &one, NULL, &i));
    assert_true(i[0] == 0 && i[1] == 1);
    hg_free(i);
    ok(npz_read(file, "fortran", HG_F32, 2, (int64_t[]){ 2, 3 }, NULL, (void **)&f));
    for (int k = 0; k < 6; k++) assert_true(f[k] == (float)(k + 1));
    hg_free(f);
    ok(npz_read_texts(file, "text", &n, &texts));
    assert_int_equal(n, 2);
    assert_string_equal(texts[0], "H\xc3\xbc\xe2\x82\xac\xf0\x9f\x98\x80");
    assert_string_equal(texts[1], "a");
    hg_texts_free(texts, n);
    ok(npz_read_texts(file, "gender", &n, &texts));
    assert_string_equal(texts[0], "female");
    hg_texts_free(texts, n);
    refused(npz_read_texts(file, "half", &n, &texts), HG_FORMAT, "no text");
    int32_t *narrow;
    refused(npz_read(file, "wide", HG_I32, 1, &one, NULL, (void **)&narrow), HG_FORMAT, "element 0");
    static const struct {
        const char *name, *words;
    } never[] = {
        { "object", "pickle" }, { "big", ">f4" }, { "complex", "c8" }, { "structure", "type V" }, { "text", "type U" }
    };
    for (size_t k = 0; k < sizeof never / sizeof *never; k++)
        refused(npz_read(file, never[k].name, HG_F32, -1, NULL, NULL, (void **)&f), HG_UNSUPPORTED, never[k].words);
    npz_close(file);

    for (size_t cut = 0; cut < zip.size; cut++) { /* every truncation */
        hg_status status = npz_open(&file, small_write("cut.npz", zip.bytes, cut));
        assert_int_equal(status, HG_FORMAT);
        assert_null(file);
        assert_non_null(strstr(hg_message(), "cut.npz"));
    }
    for (size_t at = 0; at < zip.size; at++) { /* every byte wrong: refused or read, never more */
        zip.bytes[at] ^= 0x55;
        if (npz_open(&file, small_write("wrong.npz", zip.bytes, zip.size)) == HG_OK) {
            for (int k = 0; k < file->n; k++)
                if (npz_read(file, file->array[k].name, HG_F64, -1, NULL, NULL, (void **)&x) == HG_OK) hg_free(x);
            npz_close(file);
        }
        zip.bytes[at] ^= 0x55;
    }
}

static void put(uint8_t *bytes, size_t at, uint64_t value, int size) { small_number(bytes + at, value, size); }

static void lies_are_refused(void **state)
{
    (void)state;
    static small_zip zip;
    uint8_t npy[1024];
    const float data[] = { 1, 2, 3 };
    static const struct {
        const char *type, *shape, *words;
        size_t size;
        hg_status status;
    } headers[] = {
        { "'<f4'", "4,", "12 bytes are there", 12, HG_FORMAT },
        { "'<f4'", "2,", "12 bytes are there", 12, HG_FORMAT },
        { "'<f4'", "9223372036854775807, 4", "size", 12, HG_FORMAT },
        { "'<f4'", "4611686018427387904, 4", "possible", 12, HG_FORMAT },
        { "'<f4'", "-3,", "a size", 12, HG_FORMAT },
        { "'<f4'", "1,1,1,1,1,1,3", "more than 6", 12, HG_UNSUPPORTED },
        { "12", "3,", "a type", 12, HG_FORMAT },
        { "[('x', '<f4'", "3,", "the end of a structure", 12, HG_FORMAT },
    };
    npz_file *file;
    for (size_t i = 0; i < sizeof headers / sizeof *headers; i++) {
        memset(&zip, 0, sizeof zip);
        small_zip_add(&zip, "x", npy, small_npy(npy, headers[i].type, false, headers[i].shape, data, headers[i].size),
                      true);
        small_zip_end(&zip);
        refused(npz_open(&file, small_write("lie.npz", zip.bytes, zip.size)), headers[i].status, headers[i].words);
        assert_null(file);
        assert_non_null(strstr(hg_message(), "lie.npz"));
    }
    memset(&zip, 0, sizeof zip);
    size_t size = small_npy(npy, "'<f4'", false, "3,", data, 12);
    small_zip_add(&zip, "x", npy, size, true);
    size_t directory = zip.size;
    small_zip_end(&zip);
    static const struct {
        size_t at; /* in the directory */
        uint64_t value;
        int bytes;
        const char *words;
    } lies[] = {
        { 8, 1, 2, "encrypted" },        { 10, 12, 2, "method 12" },      { 16, 1, 4, "checksum" },
        { 20, 1 << 30, 4, "cannot be" }, { 24, 1 << 30, 4, "cannot be" }, { 24, 0xffffffff, 4, "zip64" },
        { 42, 7, 4, "begin there" },     { 28, 600, 2, "beyond" },        { 0, 0, 4, "no entry" },
    };
    uint8_t saved[46];
    memcpy(saved, zip.bytes + directory, 46);
    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        put(zip.bytes, directory + lies[i].at, lies[i].value, lies[i].bytes);
        hg_status status = npz_open(&file, small_write("lie.npz", zip.bytes, zip.size));
        float *x = NULL;
        if (status == HG_OK) {
            status = npz_read(file, "x", HG_F32, -1, NULL, NULL, (void **)&x);
            npz_close(file);
        }
        assert_null(x);
        refused(status, lies[i].at == 8 || lies[i].at == 10 ? HG_UNSUPPORTED : HG_FORMAT, lies[i].words);
        memcpy(zip.bytes + directory, saved, 46);
    }
    /* twice the same name */
    memset(&zip, 0, sizeof zip);
    small_zip_add(&zip, "x", npy, size, false);
    small_zip_add(&zip, "x", npy, size, false);
    small_zip_end(&zip);
    refused(npz_open(&file, small_write("lie.npz", zip.bytes, zip.size)), HG_FORMAT, "second array");
    refused(npz_open(&file, small_write("lie.npz", "\x80\x03}q", 4)), HG_FORMAT, "pickle");
    refused(npz_open(&file, small_write("lie.npz", "", 0)), HG_FORMAT, "neither");
    assert_int_equal(npz_open(&file, small_path("nothing.npz")), HG_IO);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(what_is_written_is_read_back),
                                        cmocka_unit_test(every_type_and_order), cmocka_unit_test(lies_are_refused) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
