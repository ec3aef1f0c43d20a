/* The program: finds the subcommand in the registry, reads its arguments, runs it. Exit status: 0 done, 1 it failed and
 * one sentence on stderr says why, 2 the command line was wrong. */
#include "cli/program.h"

#include <hdf5.h>
#include <malloc.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static const hg_argument program_options[] = {
    { "plugin", "FILE",
      "load a shared object with energies, ops, models or readers of your own; may be repeated, before or after "
      "COMMAND; "
      "also HAIRGRAD_PLUGINS=a.so:b.so",
      true },
    { "version", NULL, "print the version", false },
    { "help", NULL, "print this", false },
};

static void print_commands(FILE *to)
{
    enum { most = 128 };
    const char *names[most];
    int count = hg_list("command", names, most);
    for (int i = 0; i < count && i < most; i++) {
        const hg_command *command = hg_find("command", names[i]);
        fprintf(to, "  %-12s %s\n", command->name, command->what);
    }
}

static void print_help(FILE *to)
{
    fputs("hairgrad " HG_VERSION ": energies of hair as formulas, networks trained against them\n\n"
          "usage: hairgrad COMMAND [options] ...      hairgrad COMMAND --help says more\n\ncommands:\n",
          to);
    print_commands(to);
    fputs("\noptions:\n", to);
    cli_print_options(to, program_options, sizeof program_options / sizeof *program_options);
}

static int wrong(const char *sentence)
{
    fprintf(stderr, "hairgrad: %s\n", sentence);
    return 2;
}

static int unknown_command(const char *name)
{
    const char *nearest = hg_nearest("command", name);
    if (nearest != NULL)
        fprintf(stderr, "hairgrad: unknown command \"%s\"; did you mean \"%s\"?\n", name, nearest);
    else
        fprintf(stderr, "hairgrad: unknown command \"%s\"; hairgrad --help lists them\n", name);
    return 2;
}

/* Those of HAIRGRAD_PLUGINS, "a.so:b.so", then those of the command line, which lose their words: --plugin may stand
 * anywhere in it. */
static int load_plugins(int *count, char **words)
{
    if (hg_plugins_load(getenv("HAIRGRAD_PLUGINS")) != HG_OK) return cli_fail();
    int kept = 1;
    bool options = true;
    for (int i = 1; i < *count; i++) {
        const char *word = words[i], *path = NULL;
        if (strcmp(word, "--") == 0) options = false;
        if (options && strncmp(word, "--plugin=", 9) == 0) path = word + 9;
        if (options && strcmp(word, "--plugin") == 0) {
            if (++i == *count) return wrong("--plugin needs a FILE");
            path = words[i];
        }
        if (path == NULL)
            words[kept++] = words[i];
        else if (hg_plugin_load(path) != HG_OK)
            return cli_fail();
    }
    words[kept] = NULL;
    *count = kept;
    return 0;
}

static int run_command(const char *name, int count, char **words)
{
    const hg_command *command = hg_find("command", name);
    if (command == NULL) return unknown_command(name);
    hg_arguments arguments;
    bool help = false;
    if (!cli_parse(&arguments, command, count, words, &help)) {
        cli_free(&arguments);
        return 2;
    }
    if (help) {
        cli_print_command(stdout, command);
        cli_free(&arguments);
        return 0;
    }
    int result = command->run(&arguments);
    cli_progress_end();
    cli_free(&arguments);
    return result;
}

static int run_program(int count, char **words)
{
    const int failed = load_plugins(&count, words);
    if (failed != 0) return failed;
    int at = 1;
    for (; at < count && words[at][0] == '-'; at++) {
        const char *option = words[at];
        if (strcmp(option, "--help") == 0 || strcmp(option, "-h") == 0) {
            print_help(stdout);
            return 0;
        }
        if (strcmp(option, "--version") == 0) {
            puts("hairgrad " HG_VERSION);
            return 0;
        }
        fprintf(stderr, "hairgrad: unknown option \"%s\" before COMMAND; hairgrad --help lists them\n", option);
        return 2;
    }
    if (hg_registry_clash() != NULL) {
        hg_fail(HG_INVALID, "%s; rename one", hg_registry_clash());
        return cli_fail();
    }
    if (at == count) {
        print_help(stderr);
        return 2;
    }
    if (strcmp(words[at], "help") == 0) {
        const hg_command *command = at + 1 < count ? hg_find("command", words[at + 1]) : NULL;
        if (at + 1 < count && command == NULL) return unknown_command(words[at + 1]);
        if (command != NULL)
            cli_print_command(stdout, command);
        else
            print_help(stdout);
        return 0;
    }
    return run_command(words[at], count - at - 1, words + at + 1);
}

/* By default a thread of libgomp that waits for the others spins for long. On a machine that other programs use too, that
 * made training ten times slower; asleep at once, it wakes so late that a second thread is no gain for work of less than
 * a millisecond. It spins for about a fifth of one, and then sleeps. libgomp reads its settings before main, so the program
 * starts itself once more with these, unless whoever called it has chosen. */
static void sleep_while_waiting(char **words)
{
    if (getenv("OMP_WAIT_POLICY") || getenv("GOMP_SPINCOUNT")) return;
    if (setenv("OMP_WAIT_POLICY", "passive", 1) == 0 && setenv("GOMP_SPINCOUNT", "20000", 1) == 0)
        execv("/proc/self/exe", words); /* where it fails, it spins */
}

int main(int count, char **words)
{
    sleep_while_waiting(words);
#ifdef __GLIBC__
    mallopt(M_MMAP_THRESHOLD, 1 << 20); /* large blocks go back to the system when they are freed */
#endif
    signal(SIGXFSZ, SIG_IGN); /* a file over the limit is an error like a full disk, not the end */
    H5dont_atexit(); /* files are closed by whoever opened them; nothing is left for the HDF5 library to tidy */
    int result = run_program(count, words);
    if (fflush(stdout) != 0 && result == 0) {
        hg_fail(HG_IO, "standard output: cannot be written");
        result = cli_fail();
    }
    return result;
}
