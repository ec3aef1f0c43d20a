/* Runs a fuzz target: seeds are changed at random (a fixed sequence for a fixed --seed) and given to it until the time is
 * up. An input that crashes, or takes more than ten seconds, is left as crash-NAME in the current folder.
 *
 *     fuzz_tfx [--seconds N] [--seed N] [FILE...]       more seeds; with --seconds 0 the files are only tried once */
#include "tests/fuzz/fuzz.h"

#include <dirent.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { most_seeds = 256, room = 1 << 20 };

static struct {
    uint8_t *bytes;
    size_t size;
} seeds[most_seeds];
static int seed_count;
static uint8_t *input;
static size_t input_size;
static uint64_t run_seed = 1, counter;
static char crash_path[256], file_path[256];

void __sanitizer_set_death_callback(void (*call)(void)) __attribute__((weak));

/* What libhdf5 forgets to free when it refuses a damaged file is not ours. */
const char *__lsan_default_suppressions(void);
const char *__lsan_default_suppressions(void) { return "leak:libhdf5\n"; }

static void keep_input(void)
{
    if (input == NULL) return;
    int file = open(crash_path, O_WRONLY | O_CREAT | O_TRUNC, 0666);
    if (file < 0) return;
    ssize_t wrote = write(file, input, input_size);
    (void)wrote;
    close(file);
    static const char text[] = "the input is kept: ";
    wrote = write(STDERR_FILENO, text, sizeof text - 1);
    wrote = write(STDERR_FILENO, crash_path, strlen(crash_path));
    wrote = write(STDERR_FILENO, "\n", 1);
}

static void on_signal(int number)
{
    static const char slow[] = "one input took more than ten seconds\n";
    if (number == SIGALRM) {
        ssize_t wrote = write(STDERR_FILENO, slow, sizeof slow - 1);
        (void)wrote;
    }
    keep_input();
    signal(number, SIG_DFL);
    _exit(1);
}

const char *fuzz_file(const uint8_t *data, size_t size, const char *extension)
{
    if (file_path[0] == '\0') {
        const char *folder = access("/dev/shm", W_OK) == 0 ? "/dev/shm"
                             : getenv("TMPDIR") != NULL    ? getenv("TMPDIR")
                                                           : "/tmp";
        snprintf(file_path, sizeof file_path, "%s/hairgrad-fuzz-%ld.%s", folder, (long)getpid(), extension);
    }
    int file = open(file_path, O_WRONLY | O_CREAT | O_TRUNC, 0600);
    if (file < 0 || write(file, data, size) != (ssize_t)size) {
        perror(file_path);
        exit(2);
    }
    close(file);
    return file_path;
}

/* ---- changes ------------------------------------------------------------------------------------------------ */

static uint64_t below(uint64_t n) { return n == 0 ? 0 : hg_random_below(run_seed, 7, counter++, n); }

static void resize_hole(size_t at, size_t old, size_t new)
{
    if (input_size - old + new > room) return;
    memmove(input + at + new, input + at + old, input_size - at - old);
    input_size = input_size - old + new;
}

static void change(void)
{
    static const int64_t odd[] = { 0,     1,     -1,    2,         127,       128,     255,        256,
                                   32767, 65535, 65536, INT32_MAX, INT32_MIN, 1 << 30, 0x7fc00000, 0x7f800000 };
    static const char *const words[] = { "0",  "-1", "nan", "inf",     "1e999", "4294967296", "9999999999999999999",
                                         "{",  "}",  "[",   "]",       "\"",    ":",          ",",
                                         "\n", " ",  "-",   "\\u0000", "null",  "\xff" };
    size_t at = (size_t)below(input_size + 1), left = input_size - at;
    switch (below(9)) {
    case 0: /* one bit */
        if (left > 0) input[at] ^= (uint8_t)(1u << below(8));
        break;
    case 1: /* one byte */
        if (left > 0) input[at] = (uint8_t)below(256);
        break;
    case 2: { /* a number that is often mishandled, mostly where headers have theirs */
        size_t width = (size_t)1 << below(4);
        if (below(2) == 0) at = (size_t)below(input_size < 160 ? input_size + 1 : 160) / 4 * 4;
        int64_t value = odd[below(sizeof odd / sizeof *odd)];
        if (at + width <= input_size) memcpy(input + at, &value, width);
        break;
    }
    case 3: { /* something is missing */
        size_t length = (size_t)below(left < 64 ? left + 1 : 64);
        resize_hole(at, length, 0);
        break;
    }
    case 4: { /* something stands there twice */
        size_t length = (size_t)below(left < 256 ? left + 1 : 256);
        uint8_t copy[256];
        memcpy(copy, input + at, length);
        if (input_size + length <= room) {
            resize_hole(at, 0, length);
            memcpy(input + at, copy, length);
        }
        break;
    }
    case 5: /* the end is missing */
        input_size = at;
        break;
    case 6: { /* a word that parsers stumble over */
        const char *word = words[below(sizeof words / sizeof *words)];
        size_t length = strlen(word), over = below(2) == 0 && left >= length ? length : 0;
        if (input_size - over + length <= room) {
            resize_hole(at, over, length);
            memcpy(input + at, word, length);
        }
        break;
    }
    case 7: /* another digit */
        for (size_t i = at; i < input_size && i < at + 64; i++)
            if (input[i] >= '0' && input[i] <= '9') {
                input[i] = (uint8_t)('0' + below(10));
                break;
            }
        break;
    default: { /* a piece of another seed */
        int other = (int)below((uint64_t)seed_count);
        size_t from = (size_t)below(seeds[other].size + 1), length = (size_t)below(seeds[other].size - from + 1);
        if (at + length <= room) {
            memcpy(input + at, seeds[other].bytes + from, length);
            if (at + length > input_size) input_size = at + length;
        }
    }
    }
}

/* ---- running ------------------------------------------------------------------------------------------------ */

static void add_seed(const uint8_t *bytes, size_t size)
{
    if (seed_count == most_seeds || size > room) return;
    seeds[seed_count].bytes = malloc(size > 0 ? size : 1);
    if (seeds[seed_count].bytes == NULL) exit(2);
    if (size > 0) memcpy(seeds[seed_count].bytes, bytes, size);
    seeds[seed_count++].size = size;
}

static void try_input(void)
{
    /* An exact copy on the heap, so that one byte too far is seen. */
    uint8_t *exact = malloc(input_size > 0 ? input_size : 1);
    if (exact == NULL) exit(2);
    memcpy(exact, input, input_size);
    alarm(10);
    fuzz_one(exact, input_size);
    alarm(0);
    free(exact);
}

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + (double)time.tv_nsec * 1e-9;
}

int main(int count, char **words)
{
    double seconds = 5.0;
    const char *name = strrchr(words[0], '/') != NULL ? strrchr(words[0], '/') + 1 : words[0];
    snprintf(crash_path, sizeof crash_path, "crash-%s", name);
    input = malloc(room);
    if (input == NULL) return 2;
    for (int i = 1; i < count; i++) {
        if (strcmp(words[i], "--seconds") == 0 && i + 1 < count)
            seconds = atof(words[++i]);
        else if (strcmp(words[i], "--seed") == 0 && i + 1 < count)
            run_seed = strtoull(words[++i], NULL, 10);
        else {
            void *bytes;
            size_t size;
            if (hg_file_read(words[i], &bytes, &size) != HG_OK) {
                fprintf(stderr, "%s\n", hg_message());
                return 2;
            }
            add_seed(bytes, size);
            hg_free(bytes);
        }
    }
    for (int i = 0; i < most_seeds; i++) {
        size_t size = fuzz_seed(i, input, room);
        if (size == 0) break;
        add_seed(input, size);
    }
    if (seed_count == 0) {
        fprintf(stderr, "%s: no seed\n", name);
        return 2;
    }
    const int deadly[] = { SIGALRM, SIGABRT, SIGFPE, SIGILL };
    for (size_t i = 0; i < sizeof deadly / sizeof *deadly; i++) signal(deadly[i], on_signal);
    if (__sanitizer_set_death_callback != NULL)
        __sanitizer_set_death_callback(keep_input);
    else
        signal(SIGSEGV, on_signal), signal(SIGBUS, on_signal);

    for (int i = 0; i < seed_count; i++) {
        memcpy(input, seeds[i].bytes, seeds[i].size);
        input_size = seeds[i].size;
        try_input();
    }
    double end = now() + seconds;
    unsigned long runs = 0;
    for (; now() < end; runs++) {
        int from = (int)below((uint64_t)seed_count);
        memcpy(input, seeds[from].bytes, seeds[from].size);
        input_size = seeds[from].size;
        for (uint64_t i = 0, changes = 1 + below(6); i < changes; i++) change();
        try_input();
    }
    printf("ok %s: %d seeds, %lu inputs\n", name, seed_count, runs);
    for (int i = 0; i < seed_count; i++) free(seeds[i].bytes);
    free(input);
    input = NULL;
    if (file_path[0] != '\0') unlink(file_path);
    return 0;
}
