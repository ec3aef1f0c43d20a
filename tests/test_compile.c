/* Kernels compiled at run time: they agree with the interpreter, are kept and found again, and whatever is wrong with the
 * compiler or the cache is said while the interpreter runs. Every case is a process of its own, so that nothing of the last
 * one is loaded. */
#define _GNU_SOURCE 1 /* ST_NOEXEC */
#include "energies_walk.h"
#include "test.h"

#include <signal.h>
#include <sys/statvfs.h>
#include <sys/wait.h>

/* ---- a process that makes a physics and reports ------------------------------------------------------------- */

typedef struct {
    int sum; /* which of the sums below */
    hg_dtype dtype;
    hg_backend backend;
    int64_t strands;
    bool ignore_children;
} question;

typedef struct {
    hg_status status;
    char name[96], note[256], message[256];
    double energy[4], gradient; /* gradient: largest difference from the interpreter, relative */
    double worst;               /* of the energies */
} answer;

static const char *const sums[][4] = { { "stretch", "gravity", "drag" },
                                       { "hair_style", "bend_twist" },
                                       { "inertia", "drag" } };

static void ask(const question *q, answer *a)
{
    memset(a, 0, sizeof *a);
    if (q->ignore_children) signal(SIGCHLD, SIG_IGN);
    hg_term terms[4];
    int n = 0;
    for (; n < 4 && sums[q->sum][n]; n++)
        terms[n] = (hg_term){ hg_energy_find(sums[q->sum][n]), 1 + 0.5 * n, NULL, NULL };
    hg_ctx *ctx = make_context(1);
    scene s;
    scene_make(&s, 1, 2, q->strands, 10, 0.3);
    hg_physics *physics;
    ok(hg_physics_create(&physics, ctx, q->dtype, terms, n, &s.data), "create");
    a->status = hg_physics_backend(physics, q->backend);
    if (a->status != HG_OK) snprintf(a->message, sizeof a->message, "%s", hg_message());
    snprintf(a->name, sizeof a->name, "%s", hg_physics_backend_name(physics));
    snprintf(a->note, sizeof a->note, "%s", hg_physics_backend_note(physics));
    const hg_frame frame = scene_frame(&s, ctx, q->dtype);
    hg_tensor *x = scene_x(&s, ctx, q->dtype), *one = scene_x(&s, ctx, q->dtype), *two = scene_x(&s, ctx, q->dtype);
    double expected[4];
    ok(hg_physics_evaluate(physics, ctx, &frame, x, a->energy, NULL, one), "as asked");
    ok(hg_physics_backend(physics, HG_BACKEND_INTERPRETER), "interpreter");
    ok(hg_physics_evaluate(physics, ctx, &frame, x, expected, NULL, two), "interpreted");
    double largest = 0;
    for (int64_t i = 0; i < hg_tensor_count(x); i++) {
        a->gradient = fmax(a->gradient, fabs(value(one, i) - value(two, i)));
        largest = fmax(largest, fabs(value(two, i)));
    }
    a->gradient /= largest;
    a->worst = difference(a->energy, expected, n);
    hg_physics_destroy(physics);
    scene_free(&s);
    hg_ctx_destroy(ctx);
}

static pid_t start(const question *q, int *from)
{
    int ends[2];
    assert_int_equal(pipe(ends), 0);
    const pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) {
        close(ends[0]);
        answer a;
        ask(q, &a);
        _exit(write(ends[1], &a, sizeof a) == sizeof a ? 0 : 1);
    }
    close(ends[1]);
    *from = ends[0];
    return child;
}

static answer finish(pid_t child, int from)
{
    answer a = { .status = HG_INVALID };
    size_t got = 0;
    for (ssize_t n; got < sizeof a && (n = read(from, (char *)&a + got, sizeof a - got)) > 0;) got += (size_t)n;
    close(from);
    int status;
    assert_int_equal(waitpid(child, &status, 0), child);
    if (!WIFEXITED(status) || WEXITSTATUS(status) != 0 || got != sizeof a) fail_msg("a process failed");
    return a;
}

static answer asked(question q)
{
    int from;
    if (!q.strands) q.strands = 19;
    const pid_t child = start(&q, &from);
    return finish(child, from);
}

static void right(const answer *a, hg_dtype dtype)
{
    const double limit = dtype == HG_F64 ? 1e-12 : 2e-5;
    if (!(a->gradient < limit && a->worst < limit))
        fail_msg("%s: energies off by %.3e, gradient by %.3e", a->name, a->worst, a->gradient);
}

static void compiled(const answer *a, hg_dtype dtype)
{
    if (a->status != HG_OK) fail_msg("%s", a->message);
    if (strncmp(a->name, "compiled ", 9) != 0 || !strstr(a->name, " by ")) fail_msg("%s (%s)", a->name, a->note);
    right(a, dtype);
}

static void interpreted(const answer *a, const char *because)
{
    assert_string_equal(a->name, "interpreter");
    if (!strstr(a->note, because)) fail_msg("expected \"%s\", got \"%s\"", because, a->note);
    assert_true(a->gradient == 0 && a->worst == 0);
}

/* ---- the cache ---------------------------------------------------------------------------------------------- */

static char *cache; /* of the test that runs */

static void new_cache(const char *name)
{
    hg_free(cache);
    cache = test_path(name);
    setenv("HAIRGRAD_CACHE", cache, 1);
}

/* Kernels in the cache; nothing else may be there. path gets the last one. */
static int files(char *path, size_t size)
{
    int n = 0;
    DIR *folder = opendir(cache);
    for (struct dirent *entry; folder && (entry = readdir(folder));) {
        if (entry->d_name[0] == '.') continue;
        if (strcmp(hg_path_extension(entry->d_name), "so") != 0) fail_msg("%s was left in the cache", entry->d_name);
        if (path) snprintf(path, size, "%s/%s", cache, entry->d_name);
        n++;
    }
    if (folder) closedir(folder);
    return n;
}

static bool no_compiler(void) { return system("cc --version > /dev/null 2>&1") != 0; }

static void test_made_and_found_again(void **state)
{
    (void)state;
    if (no_compiler()) skip();
    new_cache("deep/er/cache");
    for (int sum = 0; sum < 2; sum++)
        for (int k = 0; k < 2; k++) {
            const hg_dtype dtype = k ? HG_F64 : HG_F32;
            const question q = { .sum = sum, .dtype = dtype, .backend = HG_BACKEND_COMPILED };
            const answer first = asked(q), second = asked(q);
            compiled(&first, dtype);
            compiled(&second, dtype);
            assert_non_null(strstr(first.note, "kept in the cache"));
            assert_string_equal(second.note, "");
            assert_string_equal(first.name, second.name); /* a resumed run finds the same back end */
            assert_memory_equal(first.energy, second.energy, sizeof first.energy);
            assert_int_equal(files(NULL, 0), 2 * sum + k + 1);
        }
    struct stat about;
    assert_int_equal(stat(cache, &about), 0);
    assert_int_equal(about.st_mode & 0777, 0700);
}

static void spoil(const char *path, int how)
{
    void *bytes;
    size_t size;
    assert_int_equal(hg_file_read(path, &bytes, &size), HG_OK);
    unlink(path);
    FILE *file = fopen(path, "w");
    assert_non_null(file);
    if (how == 4) {
        fputs("something else\n", file);
    } else {
        if (how < 2) ((char *)bytes)[how ? size / 3 : size - 20] ^= 1; /* in the code; in the seal */
        const size_t kept = how < 2 ? size : how == 2 ? size / 2 : 0;
        assert_int_equal(fwrite(bytes, 1, kept, file), kept);
    }
    fclose(file);
    hg_free(bytes);
}

static void test_spoilt_files_are_made_again(void **state)
{
    (void)state;
    if (no_compiler()) skip();
    new_cache("spoilt");
    const question q = { .sum = 2, .dtype = HG_F32, .backend = HG_BACKEND_COMPILED };
    char path[600];
    answer a = asked(q);
    compiled(&a, HG_F32);
    assert_int_equal(files(path, sizeof path), 1);
    for (int how = 0; how < 5; how++) {
        spoil(path, how);
        a = asked(q);
        compiled(&a, HG_F32);
        assert_non_null(strstr(a.note, "kept in the cache"));
        assert_int_equal(files(NULL, 0), 1);
        a = asked(q);
        assert_string_equal(a.note, "");
    }
    /* whole, but another's: f64 where f32 should be */
    a = asked((question){ .sum = 2, .dtype = HG_F64, .backend = HG_BACKEND_COMPILED });
    compiled(&a, HG_F64);
    char other[600] = "";
    DIR *folder = opendir(cache);
    for (struct dirent *entry; (entry = readdir(folder));)
        if (entry->d_name[0] != '.' && !strstr(path, entry->d_name))
            snprintf(other, sizeof other, "%s/%s", cache, entry->d_name);
    closedir(folder);
    assert_int_equal(rename(other, path), 0);
    a = asked(q);
    compiled(&a, HG_F32);
    assert_non_null(strstr(a.note, "kept in the cache"));
}

static void test_unusable_cache_is_said(void **state)
{
    (void)state;
    if (no_compiler()) skip();
    const question q = { .sum = 2, .dtype = HG_F32, .backend = HG_BACKEND_AUTO, .strands = 1000 };
    new_cache("open");
    assert_int_equal(mkdir(cache, 0777), 0);
    assert_int_equal(chmod(cache, 0777), 0);
    answer a = asked(q);
    interpreted(&a, "others may write");
    a = asked((question){ .sum = 2, .dtype = HG_F32, .backend = HG_BACKEND_COMPILED });
    assert_int_equal(a.status, HG_UNSUPPORTED);
    assert_non_null(strstr(a.message, "drag + inertia"));
    assert_non_null(strstr(a.message, "others may write"));
    new_cache("file");
    assert_int_equal(hg_file_write(cache, "x", 1), HG_OK);
    a = asked(q);
    interpreted(&a, "is a file");
    setenv("HAIRGRAD_CACHE", "/dev/null/cache", 1);
    a = asked(q);
    interpreted(&a, "cannot be made");
    new_cache("somebody's");
    if (geteuid() == 0) {
        assert_int_equal(mkdir(cache, 0700), 0);
        assert_int_equal(chown(cache, 12345, 12345), 0);
        a = asked(q);
        interpreted(&a, "belongs to somebody else");
    } else {
        assert_int_equal(mkdir(cache, 0500), 0);
        a = asked(q);
        interpreted(&a, "cannot be written");
    }
    struct statvfs about; /* where programs may not be run */
    if (statvfs("/dev/shm", &about) == 0 && (about.f_flag & ST_NOEXEC)) {
        char folder[] = "/dev/shm/hairgrad-XXXXXX";
        if (mkdtemp(folder)) {
            setenv("HAIRGRAD_CACHE", folder, 1);
            a = asked(q);
            interpreted(&a, "cannot be loaded");
            test_remove_all(folder);
        }
    }
}

static void script(const char *path, const char *text)
{
    assert_int_equal(hg_file_write(path, text, strlen(text)), HG_OK);
    assert_int_equal(chmod(path, 0755), 0);
}

static void test_unusable_compiler_is_said(void **state)
{
    (void)state;
    new_cache("compilers");
    const question q = { .sum = 2, .dtype = HG_F32, .backend = HG_BACKEND_AUTO, .strands = 1000 };
    setenv("HAIRGRAD_CC", "/nowhere/cc", 1);
    answer a = asked(q);
    interpreted(&a, "no C compiler");
    char *path = test_path("my cc"), *good = test_path("cc");
    script(good, "#!/bin/sh\n[ \"$1\" = --version ] && { echo 'cc (Own) 7.5'; exit 0; }\n"
                 "echo 'kernel.c:1:1: error: not today' >&2; exit 1\n");
    setenv("HAIRGRAD_CC", path, 1); /* blanks part words: such a path cannot be given */
    a = asked(q);
    interpreted(&a, "no C compiler");
    setenv("HAIRGRAD_CC", good, 1);
    a = asked(q);
    interpreted(&a, "error: not today");
    script(good,
           "#!/bin/sh\n[ \"$1\" = --version ] && exit 0\nwhile [ \"$1\" != -o ]; do shift; done\necho no >\"$2\"\n");
    a = asked(q);
    interpreted(&a, "cannot be loaded");
    script(good, "#!/bin/sh\n[ \"$1\" = --version ] && echo 2\nexit 0\n");
    a = asked(q);
    interpreted(&a, "could not compile the kernel");
    unsetenv("HAIRGRAD_CC");
    char *before = hg_strdup(getenv("PATH"));
    setenv("PATH", "/nowhere", 1);
    a = asked(q);
    interpreted(&a, "no C compiler was found");
    setenv("PATH", before, 1);
    setenv("HAIRGRAD_COMPILE", "0", 1);
    a = asked(q);
    interpreted(&a, "HAIRGRAD_COMPILE=0");
    unsetenv("HAIRGRAD_COMPILE");
    hg_free(before);
    hg_free(path);
    hg_free(good);
}

static void test_small_grooms_are_interpreted(void **state)
{
    (void)state;
    if (no_compiler()) skip();
    new_cache("sizes");
    answer a = asked((question){ .sum = 2, .dtype = HG_F32, .backend = HG_BACKEND_AUTO, .strands = 999 });
    interpreted(&a, "");
    assert_int_equal(files(NULL, 0), 0);
    a = asked((question){ .sum = 2, .dtype = HG_F32, .backend = HG_BACKEND_AUTO, .strands = 1000 });
    compiled(&a, HG_F32);
    assert_int_equal(files(NULL, 0), 1);
    a = asked((question){ .sum = 2, .dtype = HG_F32, .backend = HG_BACKEND_COMPILED, .ignore_children = true });
    compiled(&a, HG_F32);
}

static void test_processes_race(void **state)
{
    (void)state;
    if (no_compiler()) skip();
    new_cache("race");
    const question q = { .sum = 0, .dtype = HG_F32, .backend = HG_BACKEND_COMPILED, .strands = 19 };
    pid_t child[4];
    int from[4];
    for (int i = 0; i < 4; i++) child[i] = start(&q, &from[i]);
    for (int i = 0; i < 4; i++) {
        const answer a = finish(child[i], from[i]);
        compiled(&a, HG_F32);
    }
    assert_int_equal(files(NULL, 0), 1);
}

/* What a process has loaded serves its children, and they can compile too. Last: this process compiles. */
static void test_fork(void **state)
{
    (void)state;
    if (no_compiler()) skip();
    new_cache("fork");
    const question q = { .sum = 0, .dtype = HG_F32, .backend = HG_BACKEND_COMPILED, .strands = 19 };
    answer a;
    ask(&q, &a);
    compiled(&a, HG_F32);
    setenv("HAIRGRAD_CACHE", "/dev/null/cache", 1);
    answer b = asked(q);
    compiled(&b, HG_F32);
    setenv("HAIRGRAD_CACHE", cache, 1);
    b = asked((question){ .sum = 1, .dtype = HG_F64, .backend = HG_BACKEND_COMPILED });
    compiled(&b, HG_F64);
    signal(SIGCHLD, SIG_IGN); /* a host that does not wait for its children */
    ask(&(question){ .sum = 2, .dtype = HG_F32, .backend = HG_BACKEND_COMPILED, .strands = 19 }, &a);
    signal(SIGCHLD, SIG_DFL);
    compiled(&a, HG_F32);
}

static int settings(void **state)
{
    (void)state;
    unsetenv("HAIRGRAD_CC");
    unsetenv("HAIRGRAD_COMPILE");
    return 0;
}

static int end(void **state)
{
    hg_free(cache);
    return test_folder_remove(state);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup(test_made_and_found_again, settings),
        cmocka_unit_test_setup(test_spoilt_files_are_made_again, settings),
        cmocka_unit_test_setup(test_unusable_cache_is_said, settings),
        cmocka_unit_test_setup(test_unusable_compiler_is_said, settings),
        cmocka_unit_test_setup(test_small_grooms_are_interpreted, settings),
        cmocka_unit_test_setup(test_processes_race, settings),
        cmocka_unit_test_setup(test_fork, settings),
    };
    return cmocka_run_group_tests(tests, test_folder_make, end);
}
