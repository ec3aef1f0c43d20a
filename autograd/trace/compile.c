/* Kernels compiled at run time. No shell is run: the compiler is started with a vector of arguments, in a folder of its own
 * inside the cache, and what it made is checked, sealed and moved into place before it is loaded. */
#define _GNU_SOURCE 1 /* memfd_create */
#include "autograd/trace/compile.h"

#include "base/cache.h"

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

extern const char hg_strand_headers[]; /* strand_kernel.h and strand_vector.h, put in when the library is built */
extern char **environ;

/* ---- the file ----------------------------------------------------------------------------------------------- */

void hg_strand_print_file(const hg_strand_program *program, hg_text *text)
{
    hg_text_add(text,
                "#if defined(__AVX512F__) && defined(__AVX512DQ__) && defined(__AVX512VL__)\n"
                "#define HG_LEVEL \"avx512\"\n#define HG_WIDTH 64\n"
                "#elif defined(__AVX2__)\n#define HG_LEVEL \"avx2\"\n#define HG_WIDTH 32\n"
                "#elif defined(__SSE4_2__)\n#define HG_LEVEL \"sse4\"\n#define HG_WIDTH 16\n"
                "#else\n#define HG_LEVEL \"plain\"\n#define HG_WIDTH 16\n#endif\n"
                "#define HG_BYTES %zu\n#define HG_LANES (HG_WIDTH / HG_BYTES)\n",
                hg_dtype_size(program->dtype));
    hg_text_add(text, "%s\n", hg_strand_headers);
    hg_strand_print_c(program, "kernel", text);
    hg_text_add(
        text,
        "\nextern const hg_strand_kernel_entry hg_strand_compiled;\n"
        "const hg_strand_kernel_entry hg_strand_compiled = { 0x%016llxu, HG_LANES, HG_BYTES, HG_LEVEL, kernel };\n",
        (unsigned long long)program->hash);
}

/* Those of the kernels that are printed when the library is built, for this processor. */
static const char *const flags[] = { "-std=gnu11",
                                     "-O2",
#if defined(__x86_64__)
                                     "-march=native",
                                     "-mprefer-vector-width=512",
#endif
                                     "-fno-math-errno",
                                     "-fno-trapping-math",
                                     "-ffp-contract=fast",
                                     "-fopenmp-simd",
                                     "-fPIC",
                                     "-shared",
                                     "-w" };
enum { FLAGS = sizeof flags / sizeof *flags, WORDS = 8 };

/* ---- running a program -------------------------------------------------------------------------------------- */

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

/* True when it ended well. A process that ignores SIGCHLD never learns how its children ended: then what they made speaks. */
static bool wait_for(pid_t child, double seconds)
{
    const double end = now() + seconds;
    int status;
    for (;;) {
        const pid_t ended = waitpid(child, &status, WNOHANG);
        if (ended == child) return WIFEXITED(status) && WEXITSTATUS(status) == 0;
        if (ended < 0 && errno != EINTR) return errno == ECHILD;
        if (now() > end) {
            kill(-child, SIGKILL); /* its group: a compiler starts others */
            while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
            }
            return false;
        }
        nanosleep(&(struct timespec){ .tv_nsec = 2000000 }, NULL);
    }
}

/* Starts words[0], found in PATH, and collects what it says. folder: for its temporary files, NULL: the system's. */
static bool run(char *const *words, const char *folder, double seconds, char *said, size_t size)
{
    said[0] = '\0';
    size_t n = 0;
    while (environ && environ[n]) n++;
    char **environment = hg_alloc(n + 3, sizeof *environment);
    char *temporary = folder ? hg_format("TMPDIR=%s", folder) : NULL;
    const int output = memfd_create("hairgrad", MFD_CLOEXEC);
    bool good = environment && output >= 0 && (temporary || !folder);
    size_t kept = 0;
    for (size_t i = 0; good && i < n; i++)
        if (strncmp(environ[i], "LC_ALL=", 7) != 0 && !(folder && strncmp(environ[i], "TMPDIR=", 7) == 0))
            environment[kept++] = environ[i];
    if (good) environment[kept++] = "LC_ALL=C";
    if (good && temporary) environment[kept++] = temporary;

    posix_spawn_file_actions_t actions;
    posix_spawnattr_t attributes;
    if (good) {
        posix_spawn_file_actions_init(&actions);
        posix_spawnattr_init(&attributes);
        posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
        posix_spawn_file_actions_adddup2(&actions, output, STDOUT_FILENO);
        posix_spawn_file_actions_adddup2(&actions, output, STDERR_FILENO);
        posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP);
        pid_t child;
        good =
            posix_spawnp(&child, words[0], &actions, &attributes, words, environment) == 0 && wait_for(child, seconds);
        posix_spawn_file_actions_destroy(&actions);
        posix_spawnattr_destroy(&attributes);
    }
    if (output >= 0) {
        const ssize_t got = pread(output, said, size - 1, 0);
        said[got > 0 ? got : 0] = '\0';
        close(output);
    }
    hg_free(temporary);
    hg_free(environment);
    return good;
}

/* ---- the compiler ------------------------------------------------------------------------------------------- */

/* Asked once per process for every setting; what is found stays. Lists only grow, at their head, by one exchange: no lock
 * that a fork could catch in the middle. */
typedef struct compiler {
    struct compiler *next;
    char *setting;      /* that it was found for */
    char *line;         /* the words of the command, one after the other; NULL: there is none */
    char *words[WORDS]; /* ended by NULL */
    hg_cache_key key;   /* of the command, what it says of itself, and the flags */
    char name[48];      /* "gcc 12.2.0" */
} compiler;
static _Atomic(compiler *) compilers;

/* "gcc 12.2.0" from what --version says. */
static void name_compiler(compiler *c, const char *said)
{
    const char *maker = strstr(said, "clang")                      ? "clang"
                        : strstr(said, "Free Software Foundation") ? "gcc"
                                                                   : c->words[0];
    const size_t line = strcspn(said, "\n");
    size_t at = 0, version = line;
    while (at < line) { /* the last word that begins with a digit */
        if (said[at] >= '0' && said[at] <= '9') version = at;
        at += strcspn(said + at, " \n");
        at += strspn(said + at, " ");
    }
    snprintf(c->name, sizeof c->name, "%.30s%s%.*s", maker, version < line ? " " : "",
             version < line ? (int)strcspn(said + version, " \n-)") : 0, said + version);
}

static bool try_compiler(compiler *c, const char *command)
{
    hg_free(c->line);
    c->line = hg_strdup(command);
    int n = 0;
    char *rest = NULL;
    for (char *word = c->line ? strtok_r(c->line, " ", &rest) : NULL; word && n < WORDS - 1;
         word = strtok_r(NULL, " ", &rest))
        c->words[n++] = word;
    c->words[n] = NULL;
    char said[4096], *words[WORDS + 1];
    memcpy(words, c->words, sizeof c->words);
    words[n] = "--version";
    words[n + 1] = NULL;
    if (n == 0 || !run(words, NULL, 20, said, sizeof said)) return false;
    name_compiler(c, said);
    c->key = hg_cache_key_add(c->key, command, strlen(command));
    c->key = hg_cache_key_add(c->key, said, strlen(said));
    for (int i = 0; i < FLAGS; i++) c->key = hg_cache_key_add(c->key, flags[i], strlen(flags[i]));
    return true;
}

static const compiler *find_compiler(void)
{
    const char *own = getenv("HAIRGRAD_CC"), *path = getenv("PATH");
    if (own && !*own) own = NULL;
    char *setting = hg_format("%s\n%s", own ? own : "", path ? path : "");
    if (!setting) return NULL;
    const compiler *known = atomic_load(&compilers);
    while (known && strcmp(known->setting, setting) != 0) known = known->next;
    if (!known) {
        compiler *c = hg_alloc(1, sizeof *c);
        if (!c) {
            hg_free(setting);
            return NULL;
        }
        c->setting = setting;
        static const char *const usual[] = { "cc", "gcc", "clang" };
        bool found = own && try_compiler(c, own);
        for (int i = 0; !own && !found && i < 3; i++) found = try_compiler(c, usual[i]);
        if (!found) {
            hg_free(c->line);
            c->line = NULL;
        }
        c->next = atomic_load(&compilers);
        while (!atomic_compare_exchange_weak(&compilers, &c->next, c)) {
        }
        known = c;
    } else {
        hg_free(setting);
    }
    if (known->line) return known;
    if (own)
        hg_fail(HG_UNSUPPORTED, "no C compiler: HAIRGRAD_CC is \"%s\", which does not run", own);
    else
        hg_fail(HG_UNSUPPORTED, "no C compiler was found");
    return NULL;
}

/* What -march=native means here: the description that the system gives of the first processor. */
static hg_cache_key add_processor(hg_cache_key key)
{
    void *text;
    size_t size;
    if (hg_file_read("/proc/cpuinfo", &text, &size) != HG_OK) return key;
    static const char *const fields[] = {
        "vendor_id", "cpu family", "model\t",         "model name", "stepping",
        "flags",     "Features",   "CPU implementer", "CPU part",   "CPU architecture"
    };
    const char *end = strstr(text, "\n\n");
    for (const char *line = text; line && *line && (!end || line < end);) {
        const size_t length = strcspn(line, "\n");
        for (size_t i = 0; i < sizeof fields / sizeof *fields; i++)
            if (strncmp(line, fields[i], strlen(fields[i])) == 0) key = hg_cache_key_add(key, line, length);
        line += length + (line[length] == '\n');
    }
    hg_free(text);
    return key;
}

/* ---- kernels ------------------------------------------------------------------------------------------------ */

typedef struct loaded {
    struct loaded *next;
    uint64_t hash;
    int bytes;
    hg_cache_key key;
    hg_compiled_kernel compiled; /* kernel NULL: the compiler refused it */
    char refused[200];
} loaded;
static _Atomic(loaded *) kernels;

static void remember(loaded *one)
{
    one->next = atomic_load(&kernels);
    while (!atomic_compare_exchange_weak(&kernels, &one->next, one)) {
    }
}

/* The first line that a compiler calls an error. */
static void first_error(const char *said, char *to, size_t size)
{
    const char *error = strstr(said, "error:");
    const char *from = error ? error : said;
    snprintf(to, size, "%.*s", (int)strcspn(from, "\n"), from);
}

static hg_status load(const char *path, const hg_strand_program *program, const hg_strand_kernel_entry **kernel)
{
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library)
        return hg_fail(HG_UNSUPPORTED, "what the compiler made cannot be loaded from the cache (%s)", dlerror());
    const hg_strand_kernel_entry *entry = dlsym(library, "hg_strand_compiled");
    if (!entry || entry->hash != program->hash || entry->bytes != (int)hg_dtype_size(program->dtype) || !entry->run ||
        entry->lanes < 1) {
        dlclose(library);
        return hg_fail(HG_UNSUPPORTED, "%s: it is not the kernel that it is named after", path);
    }
    *kernel = entry;
    return HG_OK;
}

static hg_status make(const compiler *c, const char *folder, const char *path, hg_cache_key key, const hg_text *text,
                      char *refused, size_t size)
{
    char *workshop;
    HG_TRY(hg_cache_workshop(folder, &workshop));
    char *source = hg_path_join(workshop, "kernel.c"), *made = hg_path_join(workshop, "kernel.so"), *said = NULL;
    hg_status status = source && made && (said = hg_alloc(16384, 1)) ? HG_OK : HG_MEMORY;
    if (status == HG_OK) status = hg_file_write(source, text->data, text->size);
    if (status == HG_OK) {
        char *words[WORDS + FLAGS + 6];
        int n = 0;
        for (int i = 0; c->words[i]; i++) words[n++] = c->words[i];
        for (int i = 0; i < FLAGS; i++) words[n++] = (char *)flags[i];
        words[n++] = source;
        words[n++] = "-o";
        words[n++] = made;
        words[n++] = "-lm";
        words[n] = NULL;
        if (!run(words, workshop, 300, said, 16384) || !hg_file_exists(made)) {
            char error[120];
            first_error(said, error, sizeof error);
            snprintf(refused, size, "%s could not compile the kernel%s%s", c->name, error[0] ? ": " : "", error);
            status = hg_fail(HG_UNSUPPORTED, "%s", refused);
        }
    }
    if (status == HG_OK) status = hg_cache_seal(made, path, key);
    hg_free(said);
    hg_free(source);
    hg_free(made);
    hg_cache_workshop_end(workshop);
    return status;
}

static hg_status find_or_make(const compiler *c, hg_cache_key key, const hg_text *text,
                              const hg_strand_program *program, loaded *one)
{
    char *folder;
    HG_TRY(hg_cache_folder(&folder));
    char *path = hg_cache_path(folder, key, "so");
    hg_status status = path ? HG_OK : HG_MEMORY;
    if (status == HG_OK && !hg_cache_sealed(path, key)) {
        const double start = now();
        status = make(c, folder, path, key, text, one->refused, sizeof one->refused);
        one->compiled.seconds = now() - start;
    }
    if (status == HG_OK) status = load(path, program, &one->compiled.kernel);
    hg_free(path);
    hg_free(folder);
    return status;
}

hg_status hg_strand_compile(const hg_strand_program *program, hg_compiled_kernel *compiled)
{
    *compiled = (hg_compiled_kernel){ 0 };
    const char *allowed = getenv("HAIRGRAD_COMPILE");
    if (allowed && strcmp(allowed, "0") == 0)
        return hg_fail(HG_UNSUPPORTED, "HAIRGRAD_COMPILE=0 turns the compiler off");
    const int bytes = (int)hg_dtype_size(program->dtype);
    for (const loaded *known = atomic_load(&kernels); known; known = known->next)
        if (known->hash == program->hash && known->bytes == bytes && known->compiled.kernel) {
            *compiled = known->compiled;
            compiled->seconds = 0;
            return HG_OK;
        }
    const compiler *c = find_compiler();
    if (!c) return HG_UNSUPPORTED;
    hg_text text = { 0 };
    hg_strand_print_file(program, &text);
    loaded *one = hg_alloc(1, sizeof *one);
    if (text.failed || !one) {
        hg_text_free(&text);
        hg_free(one);
        return HG_MEMORY;
    }
    one->hash = program->hash;
    one->bytes = bytes;
    one->key = add_processor(hg_cache_key_add(c->key, text.data, text.size));
    hg_status status = HG_OK;
    for (const loaded *known = atomic_load(&kernels); known && status == HG_OK; known = known->next)
        if (!known->compiled.kernel && memcmp(&known->key, &one->key, sizeof one->key) == 0)
            status = hg_fail(HG_UNSUPPORTED, "%s", known->refused);
    const bool known_refused = status != HG_OK;
    if (!known_refused) {
        memcpy(one->compiled.by, c->name, sizeof one->compiled.by);
        status = find_or_make(c, one->key, &text, program, one);
    }
    hg_text_free(&text);
    if (status == HG_OK) *compiled = one->compiled;
    if (status == HG_OK || (one->refused[0] && !known_refused))
        remember(one); /* also what the compiler refused: it is asked once */
    else
        hg_free(one);
    return status;
}
