/* base, HDF5: what is written is read, the same bytes every time; files that lie, that end too early, and full disks. */
#include "tests/test.h"

#include <hdf5.h>
#include <signal.h>
#include <sys/resource.h>

#define OK(call)                                                                                                       \
    do {                                                                                                               \
        if ((call) != HG_OK) fail_msg("%s: %s", #call, hg_message());                                                  \
    } while (0)
#define REFUSED(call, status, part)                                                                                    \
    do {                                                                                                               \
        if ((call) != (status) || strstr(hg_message(), part) == NULL) fail_msg("%s: %s", #call, hg_message());         \
    } while (0)

static float ramp[600];

static void write_sample(const char *path)
{
    hg_h5 *file;
    for (int i = 0; i < 600; i++) ramp[i] = (float)i * 0.5f;
    OK(hg_h5_create(&file, path));
    OK(hg_h5_write(file, "groom/strands", HG_F32, 3, (int64_t[]){ 10, 20, 3 }, ramp));
    OK(hg_h5_write(file, "groom/faces", HG_I32, 1, (int64_t[]){ 3 }, (int32_t[]){ 1, -2, 3 }));
    OK(hg_h5_write(file, "scalar", HG_F64, 0, NULL, &(double){ 2.5 }));
    OK(hg_h5_write(file, "empty", HG_F32, 2, (int64_t[]){ 0, 3 }, NULL));
    OK(hg_h5_write(file, "half", HG_BF16, 1, (int64_t[]){ 3 }, (uint16_t[]){ 0x3f80, 0x4000, 0xbf00 }));
    OK(hg_h5_write_i64(file, "long", 1, (int64_t[]){ 2 }, (int64_t[]){ INT64_MIN, 5 }));
    OK(hg_h5_write_u8(file, "bytes", 1, (int64_t[]){ 2 }, (uint8_t[]){ 0, 255 }));
    OK(hg_h5_group(file, "a/b"));
    OK(hg_h5_group(file, "a/b"));
    OK(hg_h5_set_text(file, "", "unit", "m"));
    OK(hg_h5_set_text(file, "groom", "name", "gr\303\274n"));
    OK(hg_h5_set_text(file, "groom", "name", "other")); /* again: replaced */
    OK(hg_h5_set_text(file, "/", "nothing", ""));
    OK(hg_h5_set_number(file, "groom", "rate", 30.5));
    OK(hg_h5_set_integers(file, "groom", "version", 2, (int64_t[]){ 2, 3 }));
    OK(hg_h5_write_texts(file, "names", 3, (const char *[]){ "Head", "", "H\303\244ls" }));
    OK(hg_h5_write_texts(file, "no_names", 0, NULL));
    REFUSED(hg_h5_write(file, "scalar", HG_F64, 0, NULL, &(double){ 2.5 }), HG_INVALID, "written twice");
    REFUSED(hg_h5_write(file, "many", HG_F64, 7, (int64_t[7]){ 1 }, ramp), HG_INVALID, "7 axes");
    REFUSED(hg_h5_write(file, "less", HG_F64, 1, (int64_t[]){ -1 }, ramp), HG_INVALID, "negative size");
    OK(hg_h5_commit(file));
}

static void test_round_trip(void **state)
{
    (void)state;
    char *path = test_path("a.h5");
    write_sample(path);
    hg_h5 *file;
    OK(hg_h5_open(&file, path));
    void *data;
    int64_t shape[6] = { 0 };
    OK(hg_h5_read(file, "groom/strands", HG_F32, 3, (int64_t[]){ -1, -1, 3 }, shape, &data));
    assert_int_equal(shape[0], 10), assert_int_equal(shape[1], 20), assert_int_equal(shape[2], 3);
    assert_memory_equal(data, ramp, sizeof ramp);
    hg_free(data);
    OK(hg_h5_read(file, "/groom/strands", HG_F64, 3, NULL, NULL, &data));
    for (int i = 0; i < 600; i++) assert_true(((double *)data)[i] == (double)ramp[i]);
    hg_free(data);
    OK(hg_h5_read(file, "groom/faces", HG_F32, 1, NULL, NULL, &data));
    assert_true(((float *)data)[1] == -2.0f);
    hg_free(data);
    OK(hg_h5_read(file, "scalar", HG_F64, 0, NULL, NULL, &data));
    assert_true(*(double *)data == 2.5);
    hg_free(data);
    OK(hg_h5_read(file, "empty", HG_F32, 2, (int64_t[]){ -1, 3 }, shape, &data));
    assert_int_equal(shape[0], 0);
    hg_free(data);
    OK(hg_h5_read(file, "half", HG_F32, 1, NULL, NULL, &data));
    assert_true(((float *)data)[0] == 1.0f && ((float *)data)[1] == 2.0f && ((float *)data)[2] == -0.5f);
    hg_free(data);
    OK(hg_h5_read(file, "half", HG_BF16, 1, NULL, NULL, &data));
    assert_int_equal(((uint16_t *)data)[2], 0xbf00);
    hg_free(data);
    OK(hg_h5_read(file, "scalar", HG_BF16, 0, NULL, NULL, &data));
    assert_int_equal(*(uint16_t *)data, 0x4020);
    hg_free(data);
    int64_t *wide;
    OK(hg_h5_read_i64(file, "long", 1, NULL, NULL, &wide));
    assert_true(wide[0] == INT64_MIN && wide[1] == 5);
    hg_free(wide);
    REFUSED(hg_h5_read(file, "long", HG_I32, 1, NULL, NULL, &data), HG_FORMAT,
            "value -9223372036854775808 at element 0 is too large for an index");
    uint8_t *bytes;
    OK(hg_h5_read_u8(file, "bytes", 1, NULL, NULL, &bytes));
    assert_int_equal(bytes[1], 255);
    hg_free(bytes);

    char *text, **texts;
    double number;
    int64_t version[2];
    int n;
    OK(hg_h5_get_text(file, "groom", "name", &text));
    assert_string_equal(text, "other");
    hg_free(text);
    OK(hg_h5_get_text(file, "", "nothing", &text));
    assert_string_equal(text, "");
    hg_free(text);
    OK(hg_h5_get_number(file, "groom", "rate", &number));
    assert_true(number == 30.5);
    OK(hg_h5_get_integers(file, "groom", "version", 2, version));
    assert_int_equal(version[1], 3);
    OK(hg_h5_read_texts(file, "names", &n, &texts));
    assert_int_equal(n, 3);
    assert_string_equal(texts[0], "Head"), assert_string_equal(texts[1], ""),
        assert_string_equal(texts[2], "H\303\244ls");
    hg_texts_free(texts, n);
    OK(hg_h5_read_texts(file, "no_names", &n, &texts));
    assert_int_equal(n, 0);
    hg_texts_free(texts, n);
    OK(hg_h5_names(file, "groom", &n, &texts));
    assert_int_equal(n, 2);
    assert_string_equal(texts[0], "faces"), assert_string_equal(texts[1], "strands");
    hg_texts_free(texts, n);
    assert_true(hg_h5_has(file, "groom/strands")), assert_true(hg_h5_has(file, "/")),
        assert_true(hg_h5_has(file, "a/b"));
    assert_false(hg_h5_has(file, "groom/x/y")), assert_false(hg_h5_has(file, "groom/strands/x"));

    float rows[120];
    OK(hg_h5_read_rows(file, "groom/strands", HG_F32, 3, 2, rows));
    assert_memory_equal(rows, ramp + 180, sizeof rows);
    OK(hg_h5_read_rows(file, "groom/strands", HG_F32, 10, 0, rows));
    REFUSED(hg_h5_read_rows(file, "groom/strands", HG_F32, 9, 2, rows), HG_INVALID, "outside");
    REFUSED(hg_h5_read_rows(file, "groom/strands", HG_F32, -1, 2, rows), HG_INVALID, "outside");
    REFUSED(hg_h5_read_rows(file, "groom/strands", HG_F32, INT64_MAX, 2, rows), HG_INVALID, "outside");

    REFUSED(hg_h5_read(file, "groom/strand", HG_F32, 3, NULL, NULL, &data), HG_FORMAT,
            "a.h5: dataset \"groom/strand\" is missing");
    assert_null(data);
    REFUSED(hg_h5_read(file, "groom", HG_F32, 3, NULL, NULL, &data), HG_FORMAT, "is a group");
    REFUSED(hg_h5_read(file, "groom/strands", HG_F32, 3, ((int64_t[]){ -1, -1, 4 }), NULL, &data), HG_FORMAT,
            "is [10,20,3], [any,any,4] is needed");
    REFUSED(hg_h5_read(file, "groom/strands", HG_F32, 2, NULL, NULL, &data), HG_FORMAT,
            "is [10,20,3], [any,any] is needed");
    REFUSED(hg_h5_read(file, "groom/strands", HG_I32, 3, NULL, NULL, &data), HG_FORMAT, "integers are needed");
    REFUSED(hg_h5_read(file, "half", HG_I32, 1, NULL, NULL, &data), HG_FORMAT, "integers are needed");
    REFUSED(hg_h5_read(file, "names", HG_F32, 1, NULL, NULL, &data), HG_FORMAT, "holds text");
    REFUSED(hg_h5_read_texts(file, "half", &n, &texts), HG_FORMAT, "is not text");
    REFUSED(hg_h5_get_number(file, "groom", "name", &number), HG_FORMAT, "is not one number");
    REFUSED(hg_h5_get_number(file, "groom", "rates", &number), HG_FORMAT,
            "attribute \"rates\" of \"groom\" is missing");
    REFUSED(hg_h5_get_text(file, "grooms", "rates", &text), HG_FORMAT, "\"grooms\" is missing");
    REFUSED(hg_h5_write(file, "x", HG_F32, 0, NULL, ramp), HG_INVALID, "opened to read");
    hg_h5_close(file);
    hg_free(path);
}

static void test_same_bytes(void **state)
{
    (void)state;
    char *path = test_path("same.h5");
    void *first, *second;
    size_t first_size, second_size;
    write_sample(path);
    OK(hg_file_read(path, &first, &first_size));
    usleep(1100000); /* object times have seconds */
    write_sample(path);
    OK(hg_file_read(path, &second, &second_size));
    assert_int_equal(first_size, second_size);
    assert_memory_equal(first, second, first_size);
    hg_free(first), hg_free(second), hg_free(path);
}

static void test_rows(void **state)
{
    (void)state;
    char *path = test_path("rows.h5");
    hg_h5 *file;
    float row[6];
    OK(hg_h5_create(&file, path));
    OK(hg_h5_reserve(file, "x", HG_F32, 3, (int64_t[]){ 5, 2, 3 }));
    for (int t = 0; t < 5; t++) {
        for (int i = 0; i < 6; i++) row[i] = (float)(t * 10 + i);
        OK(hg_h5_write_rows(file, "x", t, 1, row));
    }
    REFUSED(hg_h5_write_rows(file, "x", 5, 1, row), HG_INVALID, "outside");
    REFUSED(hg_h5_write_rows(file, "y", 0, 1, row), HG_INVALID, "not reserved");
    OK(hg_h5_commit(file));
    OK(hg_h5_open(&file, path));
    void *data;
    OK(hg_h5_read(file, "x", HG_F32, 3, NULL, NULL, &data));
    assert_true(((float *)data)[29] == 45.0f);
    hg_free(data);
    hg_h5_close(file);
    hg_free(path);
}

/* ---- files that are not what they say ----------------------------------------------------------------------- */

static void test_not_hdf5(void **state)
{
    (void)state;
    char *path = test_path("bad.h5");
    hg_h5 *file;
    REFUSED(hg_h5_open(&file, "/nothing/here.h5"), HG_IO,
            "/nothing/here.h5: cannot be opened (No such file or directory)");
    assert_null(file);
    REFUSED(hg_h5_open(&file, test_folder()), HG_IO, "is a folder");
    REFUSED(hg_h5_open(&file, "/dev/null"), HG_IO, "is a device");
    OK(hg_file_write(path, "", 0));
    REFUSED(hg_h5_open(&file, path), HG_FORMAT, "is empty");
    OK(hg_file_write(path, "solid nonsense", 14));
    REFUSED(hg_h5_open(&file, path), HG_FORMAT, "is not an HDF5 file");
    /* Cut at every length: an error or a file that can be read, never a crash. */
    char *whole = test_path("whole.h5");
    write_sample(whole);
    void *bytes;
    size_t size;
    OK(hg_file_read(whole, &bytes, &size));
    for (size_t length = 1; length < size; length += 97) {
        OK(hg_file_write(path, bytes, length));
        hg_status status = hg_h5_open(&file, path);
        assert_int_not_equal(status, HG_OK);
        assert_non_null(strstr(hg_message(), "bad.h5: "));
    }
    hg_free(bytes), hg_free(whole), hg_free(path);
}

/* Files made with the HDF5 library itself: shapes that no file can hold, data elsewhere, odd types. */
static void test_lying(void **state)
{
    (void)state;
    char *path = test_path("lie.h5"), *elsewhere = test_path("elsewhere.raw");
    hid_t made = H5Fcreate(path, H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
    hsize_t huge[2] = { (hsize_t)1 << 40, 3 }, wrap[3] = { (hsize_t)1 << 31, (hsize_t)1 << 31, 8 }, small = 4;
    hsize_t chunk[2] = { 1024, 3 }, ones[7] = { 1, 1, 1, 1, 1, 1, 1 };
    hid_t space = H5Screate_simple(2, huge, NULL), wrapping = H5Screate_simple(3, wrap, NULL),
          few = H5Screate_simple(1, &small, NULL);
    hid_t seven = H5Screate_simple(7, ones, NULL), chunked = H5Pcreate(H5P_DATASET_CREATE),
          external = H5Pcreate(H5P_DATASET_CREATE);
    H5Pset_chunk(chunked, 2, chunk);
    H5Pset_external(external, elsewhere, 0, 16);
    H5Dclose(H5Dcreate2(made, "huge", H5T_IEEE_F32LE, space, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT));
    H5Dclose(H5Dcreate2(made, "chunked", H5T_IEEE_F32LE, space, H5P_DEFAULT, chunked, H5P_DEFAULT));
    hid_t wrapped = H5Dcreate2(made, "wrap", H5T_STD_U8LE, wrapping, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
    if (wrapped >= 0) H5Dclose(wrapped);
    H5Dclose(H5Dcreate2(made, "external", H5T_IEEE_F32LE, few, H5P_DEFAULT, external, H5P_DEFAULT));
    H5Dclose(H5Dcreate2(made, "seven", H5T_IEEE_F32LE, seven, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT));
    hid_t variable = H5Tcopy(H5T_C_S1), pair = H5Tcreate(H5T_COMPOUND, 8), fixed = H5Tcopy(H5T_C_S1);
    H5Tset_size(variable, H5T_VARIABLE);
    H5Tset_size(fixed, 3);
    H5Tinsert(pair, "a", 0, H5T_NATIVE_INT);
    H5Dclose(H5Dcreate2(made, "records", pair, few, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT));
    hid_t strings = H5Dcreate2(made, "strings", variable, few, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
    const char *texts[4] = { "Hips", "", NULL, "LeftUpLeg" };
    H5Dwrite(strings, variable, H5S_ALL, H5S_ALL, H5P_DEFAULT, texts);
    H5Dclose(strings);
    strings = H5Dcreate2(made, "fixed", fixed, few, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
    H5Dwrite(strings, fixed, H5S_ALL, H5S_ALL, H5P_DEFAULT, "abcde\0f\0\0\0\0\0");
    H5Dclose(strings);
    hid_t scalar = H5Screate(H5S_SCALAR),
          attribute = H5Acreate2(made, "name", variable, scalar, H5P_DEFAULT, H5P_DEFAULT);
    const char *name = "variable text";
    H5Awrite(attribute, variable, &name);
    H5Aclose(attribute);
    attribute = H5Acreate2(made, "pair", pair, scalar, H5P_DEFAULT, H5P_DEFAULT);
    H5Aclose(attribute);
    H5Lcreate_soft("/not/there", made, "dangling", H5P_DEFAULT, H5P_DEFAULT);
    H5Lcreate_soft("/loop", made, "loop", H5P_DEFAULT, H5P_DEFAULT);
    H5Lcreate_external("missing.h5", "/x", made, "outside", H5P_DEFAULT, H5P_DEFAULT);
    H5Sclose(scalar), H5Sclose(space), H5Sclose(few), H5Sclose(wrapping), H5Sclose(seven), H5Pclose(chunked),
        H5Pclose(external);
    H5Tclose(pair), H5Tclose(variable), H5Tclose(fixed);
    H5Fclose(made);

    hg_h5 *file;
    OK(hg_h5_open(&file, path));
    void *data;
    char **read, *text;
    int n;
    double number;
    REFUSED(hg_h5_read(file, "huge", HG_F32, 2, NULL, NULL, &data), HG_FORMAT,
            "dataset \"huge\" says it is [1099511627776,3], more than a file of");
    REFUSED(hg_h5_read(file, "chunked", HG_F32, 2, NULL, NULL, &data), HG_FORMAT, "more than a file of");
    if (wrapped >= 0)
        REFUSED(hg_h5_read_u8(file, "wrap", 3, NULL, NULL, (uint8_t **)&data), HG_FORMAT, "more than a file of");
    REFUSED(hg_h5_read(file, "external", HG_F32, 1, NULL, NULL, &data), HG_FORMAT, "in another file");
    REFUSED(hg_h5_read(file, "seven", HG_F32, 6, NULL, NULL, &data), HG_FORMAT, "7 axes");
    REFUSED(hg_h5_read(file, "records", HG_F32, 1, NULL, NULL, &data), HG_FORMAT, "holds records");
    REFUSED(hg_h5_read(file, "dangling", HG_F32, 1, NULL, NULL, &data), HG_FORMAT, "is missing");
    REFUSED(hg_h5_read(file, "loop", HG_F32, 1, NULL, NULL, &data), HG_FORMAT, "is missing");
    REFUSED(hg_h5_read(file, "outside", HG_F32, 1, NULL, NULL, &data), HG_FORMAT, "is missing");
    REFUSED(hg_h5_get_number(file, "", "pair", &number), HG_FORMAT, "is not one number");
    REFUSED(hg_h5_get_text(file, "", "pair", &text), HG_FORMAT, "is not text");
    OK(hg_h5_read_texts(file, "strings", &n, &read));
    assert_int_equal(n, 4);
    assert_string_equal(read[0], "Hips"), assert_string_equal(read[2], ""), assert_string_equal(read[3], "LeftUpLeg");
    hg_texts_free(read, n);
    OK(hg_h5_read_texts(file, "fixed", &n, &read)); /* the first one has no zero at its end */
    assert_string_equal(read[0], "abc"), assert_string_equal(read[1], "de"), assert_string_equal(read[2], "f");
    hg_texts_free(read, n);
    OK(hg_h5_get_text(file, "", "name", &text));
    assert_string_equal(text, "variable text");
    hg_free(text);
    hg_h5_close(file);
    hg_free(path), hg_free(elsewhere);
}

/* ---- failures while writing --------------------------------------------------------------------------------- */

static void test_abandoned(void **state)
{
    (void)state;
    char *path = test_path("abandoned.h5");
    OK(hg_file_write(path, "old", 3));
    hg_h5 *file;
    OK(hg_h5_create(&file, path));
    OK(hg_h5_write(file, "x", HG_F32, 1, (int64_t[]){ 600 }, ramp));
    hg_h5_close(file);
    test_file_is(path, "old");
    test_no_leftovers();
    REFUSED(hg_h5_create(&file, "/nothing/here.h5"), HG_IO, "cannot be written (No such file or directory)");
    assert_null(file);
    REFUSED(hg_h5_create(&file, test_folder()), HG_IO, "is a folder");
    REFUSED(hg_h5_create(&file, "/dev/full"), HG_IO, "is a device");
    hg_h5_close(NULL);
    hg_free(path);
}

/* The disk is full after `limit` bytes: whatever is being written then, the old file stays and nothing is left over. */
static void test_full_disk(void **state)
{
    (void)state;
    char *path = test_path("full.h5");
    write_sample(path);
    void *before, *after;
    size_t size, size_after;
    OK(hg_file_read(path, &before, &size));
    static double large[50000];
    struct rlimit limit;
    getrlimit(RLIMIT_FSIZE, &limit);
    signal(SIGXFSZ, SIG_IGN);
    int failed = 0;
    for (rlim_t bytes = 0; bytes < 700000; bytes += 9973) {
        setrlimit(RLIMIT_FSIZE, &(struct rlimit){ bytes, limit.rlim_max });
        hg_h5 *file;
        hg_status status = hg_h5_create(&file, path);
        if (status == HG_OK) {
            for (int i = 0; i < 20 && status == HG_OK; i++) {
                char name[32];
                snprintf(name, sizeof name, "g%d/x", i);
                status = hg_h5_write(file, name, HG_F64, 1, (int64_t[]){ 100 }, large);
                if (status == HG_OK) status = hg_h5_set_text(file, name, "unit", "m");
            }
            if (status == HG_OK) status = hg_h5_reserve(file, "rows", HG_F64, 2, (int64_t[]){ 100, 250 });
            for (int i = 0; i < 100 && status == HG_OK; i += 10) status = hg_h5_write_rows(file, "rows", i, 10, large);
            if (status == HG_OK) status = hg_h5_write(file, "large", HG_F64, 1, (int64_t[]){ 20000 }, large);
            if (status == HG_OK && bytes % 2 == 0)
                status = hg_h5_write(file, "larger", HG_F64, 1, (int64_t[]){ 40000 }, large);
            hg_status last = hg_h5_commit(file); /* must free and refuse, whatever failed before */
            assert_int_equal(status == HG_OK, last == HG_OK);
            status = last;
        }
        setrlimit(RLIMIT_FSIZE, &limit);
        test_no_leftovers();
        OK(hg_file_read(path, &after, &size_after));
        if (status != HG_OK) {
            failed++;
            assert_int_equal(status, HG_IO);
            assert_int_equal(size, size_after);
            assert_memory_equal(before, after, size);
        } else {
            hg_free(before);
            before = after, size = size_after;
            after = NULL;
        }
        hg_free(after);
    }
    assert_true(failed > 20);
    hg_h5 *file; /* what was committed last is whole */
    OK(hg_h5_open(&file, path));
    assert_true(hg_h5_has(file, "rows"));
    hg_h5_close(file);
    hg_free(before), hg_free(path);
}

static void test_many_objects(void **state)
{
    (void)state;
    char *path = test_path("many.h5");
    hg_h5 *file;
    OK(hg_h5_create(&file, path));
    for (int i = 0; i < 2000; i++) {
        char name[32];
        snprintf(name, sizeof name, "g%d/x", i);
        OK(hg_h5_write(file, name, HG_F64, 0, NULL, &(double){ i }));
    }
    OK(hg_h5_commit(file));
    OK(hg_h5_open(&file, path));
    char **names;
    int n;
    OK(hg_h5_names(file, "", &n, &names));
    assert_int_equal(n, 2000);
    hg_texts_free(names, n);
    hg_h5_close(file);
    hg_free(path);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_round_trip), cmocka_unit_test(test_same_bytes),   cmocka_unit_test(test_rows),
        cmocka_unit_test(test_not_hdf5),   cmocka_unit_test(test_lying),        cmocka_unit_test(test_abandoned),
        cmocka_unit_test(test_full_disk),  cmocka_unit_test(test_many_objects),
    };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
