/* cli: the program. One file per subcommand, no logic of its own; the only floor that prints and exits.
 *
 *     static int info(const hg_arguments *arguments) { ... return 0; }
 *     HG_COMMAND(info, .what = "what a file holds", .usage = "FILE...", .min_free = 1, .max_free = 64, .run = info);
 */
#ifndef HG_CLI_H
#define HG_CLI_H

#include "export/export.h"

#include <stdio.h>

/* "--name VALUE" (value_name not NULL) or "--name" (a flag). Repeatable ones are joined in order. */
typedef struct { const char *name, *value_name, *help; bool repeat; } hg_argument;
typedef struct hg_command hg_command;
typedef struct { const hg_command *command; int n_free; const char **free; int n_given; struct { const char *name, *value; } given[64]; } hg_arguments;

struct hg_command {
    const char *name, *what, *usage;
    const hg_argument *options; int n_options;
    int min_free, max_free;
    int (*run)(const hg_arguments *arguments);     /* 0, or 1 after cli_fail; parsing errors are 2 */
    const char *more;                              /* shown by --help: examples */
    void (*help)(FILE *to);                        /* shown by --help before them, where it depends on what is registered; may be NULL */
};
#define HG_COMMAND(name_, ...) \
    static const hg_command command_##name_ = { .name = #name_, __VA_ARGS__ }; \
    HG_REGISTER("command", name_, &command_##name_)

const char *cli_value(const hg_arguments *arguments, const char *name, const char *otherwise); /* last one given */
bool        cli_flag(const hg_arguments *arguments, const char *name);
bool        cli_number(const hg_arguments *arguments, const char *name, double *value);   /* false and a message when it is no number */
bool        cli_integer(const hg_arguments *arguments, const char *name, int64_t *value);
int         cli_fail(void);                                   /* prints "hairgrad: " and hg_message() to stderr, returns 1 */
hg_progress cli_progress(void);                               /* one line on stderr, rewritten on a terminal, every few seconds otherwise; silent for the first two seconds */
void        cli_progress_end(void);
bool        cli_context(hg_ctx **ctx, const hg_arguments *arguments);             /* --threads, --seed; the cpu unless the command has --device */
#define CLI_CONTEXT_OPTIONS { "threads", "N", "threads to use (default: all cores)", false }, { "seed", "N", "seed of everything random (default 1)", false }
#define CLI_DEVICE_OPTION { "device", "NAME", "cpu, cuda, cuda:NUMBER or auto: cuda where it works (default " CLI_DEVICE "); hairgrad devices lists them", false }
#define CLI_DEVICE "auto"
/* --trap-nan: the trap is set, and writes nan.h5 into the folder (made where it is not there). path is the caller's. */
hg_status   cli_trap(hg_ctx *ctx, const hg_arguments *arguments, const char *folder, char **path);
#define CLI_TRAP_OPTION { "trap-nan", NULL, "stop at the first number that is not finite: op or energy, strand, vertex; nan.h5 has what reproduces it", false }
bool        cli_interrupted(void *);                          /* true after SIGINT or SIGTERM, once cli_catch_signals was called */
void        cli_catch_signals(void);

#endif
