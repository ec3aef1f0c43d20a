/* base: messages, memory, text, random numbers, registry, files, units. HDF5 is in test_h5.c, configs in test_config.c. */
#include "base/base.h"
#include "tests/test.h"

#include <pthread.h>
#include <signal.h>
#include <sys/resource.h>

/* ---- messages and memory ------------------------------------------------------------------------------------ */

static void test_message(void **state)
{
    (void)state;
    assert_int_equal(hg_fail(HG_FORMAT, "%s: %d", "a", 7), HG_FORMAT);
    assert_string_equal(hg_message(), "a: 7");
    hg_fail(HG_IO, "outer (%s)", hg_message()); /* a sentence that quotes the last one */
    assert_string_equal(hg_message(), "outer (a: 7)");
    char *text = hg_alloc(100000, 1);
    memset(text, 'x', 99999);
    hg_fail(HG_IO, "%s", text);
    assert_int_equal(strlen(hg_message()), 4095);
    assert_string_equal(hg_message() + 4092, "...");
    hg_free(text);
    for (int i = HG_OK; i <= HG_UNSUPPORTED; i++) assert_string_not_equal(hg_status_name((hg_status)i), "unknown");
    assert_string_equal(hg_status_name((hg_status)99), "unknown");
}

static void *fail_elsewhere(void *data)
{
    (void)data;
    hg_fail(HG_IO, "of the other thread");
    return NULL;
}

static void test_message_per_thread(void **state)
{
    (void)state;
    hg_fail(HG_IO, "mine");
    pthread_t thread;
    assert_int_equal(pthread_create(&thread, NULL, fail_elsewhere, NULL), 0);
    pthread_join(thread, NULL);
    assert_string_equal(hg_message(), "mine");
}

static void test_memory(void **state)
{
    (void)state;
    for (size_t count = 0; count < 300; count += 7) {
        unsigned char *memory = hg_alloc(count, 3);
        assert_non_null(memory);
        assert_int_equal((uintptr_t)memory % 64, 0);
        for (size_t i = 0; i < count * 3; i++) assert_int_equal(memory[i], 0);
        memset(memory, 0xab, count * 3);
        memory = hg_resize(memory, count, count + 50, 3);
        for (size_t i = 0; i < (count + 50) * 3; i++) assert_int_equal(memory[i], i < count * 3 ? 0xab : 0);
        memory = hg_resize(memory, count + 50, 1, 3);
        for (size_t i = 0; i < 3; i++) assert_int_equal(memory[i], count > 0 ? 0xab : 0);
        hg_free(memory);
    }
    hg_free(NULL);
    assert_null(hg_alloc(SIZE_MAX / 2, 3));
    assert_non_null(strstr(hg_message(), "more than an address can name"));
    assert_null(hg_alloc((size_t)1 << 50, 1));
    assert_non_null(strstr(hg_message(), "this machine has"));
    void *kept = hg_alloc(4, 1);
    assert_null(hg_resize(kept, 4, SIZE_MAX, 8)); /* the old one stays ours */
    hg_free(kept);
}

static void test_text(void **state)
{
    (void)state;
    hg_text text = { 0 };
    for (int i = 0; i < 1000; i++) hg_text_add(&text, "%d,", i);
    assert_false(text.failed);
    assert_int_equal(text.size, strlen(text.data));
    assert_int_equal(text.size, 10 * 2 + 90 * 3 + 900 * 4);
    hg_text_free(&text);
    assert_null(text.data);
    char *made = hg_format("%s-%03d", "a", 7);
    assert_string_equal(made, "a-007");
    char *copy = hg_strdup(made);
    assert_string_equal(copy, made);
    hg_free(copy);
    hg_free(made);
    assert_true(hg_hash("a", 1, 0) == UINT64_C(0xaf63dc4c8601ec8c)); /* published value of FNV-1a */
    assert_true(hg_hash("a", 1, 0) != hg_hash("a", 1, 1));
}

/* ---- random numbers ----------------------------------------------------------------------------------------- */

static void test_random(void **state)
{
    (void)state;
    /* Known answers of Random123 for philox4x32-10. */
    uint32_t bits[4];
    hg_random_bits(0, 0, 0, bits);
    assert_int_equal(bits[0], 0x6627e8d5), assert_int_equal(bits[1], 0xe169c58d);
    assert_int_equal(bits[2], 0xbc57ac4c), assert_int_equal(bits[3], 0x9b00dbd8);
    hg_random_bits(UINT64_MAX, UINT64_MAX, UINT64_MAX, bits);
    assert_int_equal(bits[0], 0x408f276d), assert_int_equal(bits[1], 0x41c83b0e);
    assert_int_equal(bits[2], 0xa20bc7c6), assert_int_equal(bits[3], 0x6d5451fd);
    double sum = 0.0, squares = 0.0, uniform = 0.0;
    enum { n = 100000 };
    int counts[7] = { 0 };
    for (uint64_t i = 0; i < n; i++) {
        double u = hg_random_uniform(3, 1, i), z = hg_random_normal(3, 2, i);
        assert_true(u >= 0.0 && u < 1.0);
        assert_true(isfinite(z));
        uniform += u, sum += z, squares += z * z;
        uint64_t k = hg_random_below(3, 3, i, 7);
        assert_true(k < 7);
        counts[k]++;
    }
    assert_true(fabs(uniform / n - 0.5) < 0.005);
    assert_true(fabs(sum / n) < 0.015);
    assert_true(fabs(squares / n - 1.0) < 0.02);
    for (int k = 0; k < 7; k++) assert_true(abs(counts[k] - n / 7) < 600);
    assert_true(hg_random_uniform(3, 1, 5) == hg_random_uniform(3, 1, 5));
    assert_true(hg_random_uniform(3, 1, 5) != hg_random_uniform(4, 1, 5));
    assert_int_equal(hg_random_below(1, 1, 1, 1), 0);
}

/* ---- registry ----------------------------------------------------------------------------------------------- */

static int first, second;
HG_REGISTER("test kind", zebra, &first);
HG_REGISTER("test kind", apple, &second);

static void test_registry(void **state)
{
    (void)state;
    const char *names[2];
    assert_int_equal(hg_list("test kind", names, 2), 2);
    assert_string_equal(names[0], "apple");
    assert_string_equal(names[1], "zebra");
    assert_int_equal(hg_list("test kind", names, 0), 2);
    assert_ptr_equal(hg_find("test kind", "zebra"), &first);
    assert_null(hg_find("test kind", "zebr"));
    assert_null(hg_find("other kind", "zebra"));
    assert_string_equal(hg_nearest("test kind", "zbera"), "zebra");
    assert_string_equal(hg_nearest("test kind", "Aple"), "apple");
    assert_null(hg_nearest("test kind", "hippopotamus"));
    assert_null(hg_registry_clash());
    static hg_entry again = { .abi = HG_ABI_VERSION, .kind = "test kind", .name = "zebra", .item = &second };
    hg_register(&again);
    assert_ptr_equal(hg_find("test kind", "zebra"), &first); /* the first one wins, the second is remembered */
    assert_non_null(hg_registry_clash());
    assert_non_null(strstr(hg_registry_clash(), "zebra"));
}

static void test_nearest(void **state)
{
    (void)state;
    const char *const names[] = { "learning_rate", "stretch", "steps", NULL };
    assert_string_equal(hg_nearest_of("learnig_rate", names, 4), "learning_rate");
    assert_string_equal(hg_nearest_of("learning-rate", names, 4), "learning_rate");
    assert_string_equal(hg_nearest_of("strech", names, 4), "stretch");
    assert_string_equal(hg_nearest_of("setps", names, 4), "steps");
    assert_string_equal(hg_nearest_of("learning_rate_of_the_network", names, 4), "learning_rate");
    assert_null(hg_nearest_of("gravity", names, 4));
    assert_null(hg_nearest_of("gravity", NULL, 0));
    char long_name[500];
    memset(long_name, 'a', 499);
    long_name[499] = '\0';
    assert_null(hg_nearest_of(long_name, names, 4));
}

/* ---- progress ----------------------------------------------------------------------------------------------- */

static void remember(void *self, double fraction, const char *text) { snprintf(self, 64, "%.2f %s", fraction, text); }

static void test_progress(void **state)
{
    (void)state;
    char seen[64] = "";
    hg_progress progress = { seen, remember };
    hg_progress_report(&progress, 0.25, "step %d", 3);
    assert_string_equal(seen, "0.25 step 3");
    hg_progress_report(NULL, 0.5, "nobody listens");
    hg_progress_report(&(hg_progress){ 0 }, 0.5, "nobody listens");
}

/* ---- files -------------------------------------------------------------------------------------------------- */

static void test_files(void **state)
{
    (void)state;
    char *path = test_path("a.bin");
    void *bytes;
    size_t size;
    assert_int_equal(hg_file_read(path, &bytes, &size), HG_IO);
    assert_non_null(strstr(hg_message(), "a.bin: cannot be opened (No such file or directory)"));
    assert_null(bytes);
    assert_int_equal(hg_file_write(path, "one\0two", 7), HG_OK);
    assert_int_equal(hg_file_read(path, &bytes, &size), HG_OK);
    assert_int_equal(size, 7);
    assert_memory_equal(bytes, "one\0two\0", 8);
    hg_free(bytes);
    assert_int_equal(hg_file_write(path, NULL, 0), HG_OK);
    assert_int_equal(hg_file_read(path, &bytes, &size), HG_OK);
    assert_int_equal(size, 0);
    hg_free(bytes);
    assert_true(hg_file_exists(path));
    assert_int_equal(hg_file_read(test_folder(), &bytes, &size), HG_IO);
    assert_non_null(strstr(hg_message(), "is a folder"));
    assert_int_equal(hg_file_write(test_folder(), "x", 1), HG_IO);
    assert_non_null(strstr(hg_message(), "is a folder"));
    assert_int_equal(hg_file_read("/dev/zero/x", &bytes, &size), HG_IO);
    assert_int_equal(hg_file_read("/proc/self/status", &bytes, &size), HG_OK); /* says that it has no size */
    assert_true(size > 100);
    hg_free(bytes);
    hg_free(path);
}

static void test_atomic_write(void **state)
{
    (void)state;
    char *path = test_path("kept.txt");
    assert_int_equal(hg_file_write(path, "old", 3), HG_OK);

    /* A disk that is full in the middle of the file. */
    static char large[200000];
    signal(SIGXFSZ, SIG_IGN);
    struct rlimit limit;
    getrlimit(RLIMIT_FSIZE, &limit);
    setrlimit(RLIMIT_FSIZE, &(struct rlimit){ 50000, limit.rlim_max });
    assert_int_equal(hg_file_write(path, large, sizeof large), HG_IO);
    setrlimit(RLIMIT_FSIZE, &limit);
    assert_non_null(
        strstr(hg_message(), "kept.txt: cannot be written (File too large); what was there before is untouched"));
    test_file_is(path, "old");
    test_no_leftovers();

    assert_int_equal(hg_file_write("/dev/full", large, sizeof large), HG_IO);
    assert_non_null(strstr(hg_message(), "No space left on device"));
    assert_int_equal(hg_file_write("/dev/null", large, sizeof large), HG_OK);

    /* No such folder; a file where a folder should be; a folder that may not be written. */
    char *inside = hg_path_join(path, "x.txt"), *nowhere = test_path("missing/x.txt"), *folder = test_path("closed"),
         *closed = test_path("closed/x.txt");
    assert_int_equal(hg_file_write(inside, "new", 3), HG_IO);
    assert_non_null(strstr(hg_message(), "Not a directory"));
    assert_int_equal(hg_file_write(nowhere, "new", 3), HG_IO);
    assert_non_null(strstr(hg_message(), "No such file or directory"));
    assert_int_equal(hg_folder_create(folder), HG_OK);
    assert_int_equal(hg_file_write(closed, "old", 3), HG_OK);
    if (geteuid() != 0) { /* nothing is closed to root */
        chmod(folder, 0555);
        assert_int_equal(hg_file_write(closed, "new", 3), HG_IO);
        assert_non_null(strstr(hg_message(), "Permission denied"));
        chmod(folder, 0755);
    }
    test_file_is(closed, "old");

    /* What is written through a link is the file that it points to. */
    char *link = test_path("link.txt");
    assert_int_equal(symlink(path, link), 0);
    assert_int_equal(hg_file_write(link, "new", 3), HG_OK);
    test_file_is(path, "new");
    struct stat about;
    assert_int_equal(lstat(link, &about), 0);
    assert_true(S_ISLNK(about.st_mode));

    /* The rights of the file stay. */
    chmod(path, 0640);
    assert_int_equal(hg_file_write(path, "newer", 5), HG_OK);
    stat(path, &about);
    assert_int_equal(about.st_mode & 0777, 0640);
    test_no_leftovers();
    hg_free(path), hg_free(inside), hg_free(nowhere), hg_free(folder), hg_free(closed), hg_free(link);
}

static void test_folders(void **state)
{
    (void)state;
    char *deep = test_path("a/b//c/"), *file = test_path("f"), *under = test_path("f/g");
    assert_int_equal(hg_folder_create(deep), HG_OK);
    assert_int_equal(hg_folder_create(deep), HG_OK);
    assert_true(hg_file_exists(deep));
    assert_int_equal(hg_file_write(file, "x", 1), HG_OK);
    assert_int_equal(hg_folder_create(file), HG_IO);
    assert_non_null(strstr(hg_message(), "is a file"));
    assert_int_equal(hg_folder_create(under), HG_IO);
    assert_int_equal(hg_folder_create("/proc/nothing/here"), HG_IO);
    assert_non_null(strstr(hg_message(), "the folder cannot be made"));
    hg_free(deep), hg_free(file), hg_free(under);
}

static void test_paths(void **state)
{
    (void)state;
    const char *const cases[][3] = {
        { "a", "b", "a/b" }, { "a/", "b", "a/b" }, { "", "b", "b" }, { "a", "/b", "/b" }, { "/", "b", "/b" }
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        char *joined = hg_path_join(cases[i][0], cases[i][1]);
        assert_string_equal(joined, cases[i][2]);
        hg_free(joined);
    }
    assert_string_equal(hg_path_extension("a/b.tfx"), "tfx");
    assert_string_equal(hg_path_extension("a.b/c"), "");
    assert_string_equal(hg_path_extension(".hidden"), "");
    assert_string_equal(hg_path_extension("x.tar.gz"), "gz");
    assert_string_equal(hg_path_extension("x."), "");
}

static void test_bytes(void **state)
{
    (void)state;
    uint8_t data[8] = { 1, 2, 3, 4, 5, 6, 7, 8 };
    hg_bytes from = { data, sizeof data, 0, "x.tfx" };
    uint32_t word;
    assert_int_equal(hg_bytes_read(&from, &word, 4, "count"), HG_OK);
    assert_int_equal(word, 0x04030201);
    assert_int_equal(hg_bytes_seek(&from, 6, "table"), HG_OK);
    assert_int_equal(hg_bytes_read(&from, &word, 4, "count"), HG_FORMAT);
    assert_string_equal(
        hg_message(),
        "x.tfx: count needs 4 bytes at offset 6, the file ends at 8; it is truncated or not what it says");
    assert_int_equal(from.offset, 6);
    assert_int_equal(hg_bytes_read(&from, data, SIZE_MAX, "count"), HG_FORMAT); /* the sum would wrap */
    assert_int_equal(hg_bytes_seek(&from, 8, "end"), HG_OK);
    assert_int_equal(hg_bytes_read(&from, &word, 0, "nothing"), HG_OK);
    assert_int_equal(hg_bytes_seek(&from, 9, "beyond"), HG_FORMAT);
    assert_non_null(strstr(hg_message(), "offset 9"));
}

/* ---- units -------------------------------------------------------------------------------------------------- */

static void test_units(void **state)
{
    (void)state;
    static const struct {
        const char *text, *unit;
        double value;
    } good[] = {
        { "5 mm", "m", 0.005 },
        { "9mm", "m", 0.009 },
        { " 2 N/m ", "N/m", 2 },
        { "200 dyn/cm", "N/m", 0.2 },
        { "1.3 g/cm^3", "kg/m^3", 1300 },
        { "1e-7 N m^2", "N m^2", 1e-7 },
        { "2 N*m^2", "N m^2", 2 },
        { "3 Hz", "1/s", 3 },
        { "5 %", "1", 0.05 },
        { "7", "m", 7 },
        { "-4 ms", "s", -0.004 },
        { "9.81 m/s\302\262", "m/s^2", 9.81 },
        { "60 tex", "kg/m", 6e-5 },
        { "6 mg/m", "kg/m", 6e-6 },
        { "2 min", "s", 120 },
        { "1 kPa", "N/m^2", 1000 },
        { "3 um", "m", 3e-6 },
        { "3 \302\265m", "m", 3e-6 },
        { "4", NULL, 4 },
        { "2 N\302\267m", "J", 2 },
        { "1 m^-1", "1/m", 1 },
        { "5 m2", "m^2", 5 },
        { "180 deg", "rad", 3.141592653589793 },
    };
    for (size_t i = 0; i < sizeof good / sizeof *good; i++) {
        double value = NAN;
        if (hg_unit_parse(good[i].text, good[i].unit, &value) != HG_OK || value != good[i].value)
            fail_msg("%s: %.17g, %s", good[i].text, value, hg_message());
    }
    static const char *const bad[][3] = {
        { "3 kg", "m", "has the unit kg, m is needed" },
        { "x", "m", "\"x\" is not a number" },
        { "", "m", "is not a number" },
        { "nan", "m", "is not a finite number" },
        { "1e999", "m", "is not a finite number" },
        { "3 blub", "m", "blub is not a known unit, m is needed" },
        { "3 m", NULL, "a bare number is needed" },
        { "3 m", "1", "a number without unit is needed" },
        { "3 N//m", "N/m", "is not a known unit" },
        { "3 N/", "N/m", "is not a known unit" },
        { "3 m^", "m", "is not a known unit" },
        { "3 m^99", "m", "is not a known unit" },
        { "3 rad", "1", "has the unit rad" },
    };
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        double value = 77;
        if (hg_unit_parse(bad[i][0], bad[i][1], &value) != HG_INVALID || value != 77 ||
            strstr(hg_message(), bad[i][2]) == NULL)
            fail_msg("%s: %s", bad[i][0], hg_message());
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_message), cmocka_unit_test(test_message_per_thread),
        cmocka_unit_test(test_memory),  cmocka_unit_test(test_text),
        cmocka_unit_test(test_random),  cmocka_unit_test(test_registry),
        cmocka_unit_test(test_nearest), cmocka_unit_test(test_progress),
        cmocka_unit_test(test_files),   cmocka_unit_test(test_atomic_write),
        cmocka_unit_test(test_folders), cmocka_unit_test(test_paths),
        cmocka_unit_test(test_bytes),   cmocka_unit_test(test_units),
    };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
