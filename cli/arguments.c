/* Command lines: "--name VALUE", "--name=VALUE", "--flag", free words; "--" ends the options. */
#include "cli/program.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

/* ---- help --------------------------------------------------------------------------------------------------- */

void cli_print_options(FILE *to, const hg_argument *options, size_t count)
{
    int widest = 0;
    for (size_t i = 0; i < count; i++) {
        int width =
            snprintf(NULL, 0, "--%s %s", options[i].name, options[i].value_name != NULL ? options[i].value_name : "");
        if (width > widest && width <= 30) widest = width;
    }
    for (size_t i = 0; i < count; i++) {
        char text[96];
        snprintf(text, sizeof text, "--%s %s", options[i].name,
                 options[i].value_name != NULL ? options[i].value_name : "");
        fprintf(to, "  %-*s  %s\n", widest, text, options[i].help != NULL ? options[i].help : "");
    }
}

void cli_print_command(FILE *to, const hg_command *command)
{
    fprintf(to, "hairgrad %s: %s\n\nusage: hairgrad %s%s%s%s\n", command->name, command->what, command->name,
            command->n_options > 0 ? " [options]" : "", command->usage != NULL && command->usage[0] != '\0' ? " " : "",
            command->usage != NULL ? command->usage : "");
    if (command->n_options > 0) {
        fputs("\noptions:\n", to);
        cli_print_options(to, command->options, (size_t)command->n_options);
    }
    if (command->help != NULL) command->help(to);
    if (command->more != NULL)
        fprintf(to, "\n%s%s", command->more,
                command->more[0] != '\0' && command->more[strlen(command->more) - 1] == '\n' ? "" : "\n");
}

/* ---- parsing ------------------------------------------------------------------------------------------------ */

static const hg_argument *find_option(const hg_command *command, const char *name, size_t length)
{
    for (int i = 0; i < command->n_options; i++)
        if (strlen(command->options[i].name) == length && strncmp(command->options[i].name, name, length) == 0)
            return &command->options[i];
    return NULL;
}

static bool unknown_option(const hg_command *command, const char *word, size_t length)
{
    const char *names[128] = { "help" };
    int count = 1;
    for (int i = 0; i < command->n_options && count < 128; i++) names[count++] = command->options[i].name;
    char name[128];
    snprintf(name, sizeof name, "%.*s", (int)length, word + (word[1] == '-' ? 2 : 1));
    const char *nearest = hg_nearest_of(name, names, count);
    if (nearest != NULL)
        fprintf(stderr, "hairgrad %s: unknown option \"%s\"; did you mean \"--%s\"?\n", command->name, word, nearest);
    else
        fprintf(stderr, "hairgrad %s: unknown option \"%s\"; hairgrad %s --help lists them\n", command->name, word,
                command->name);
    return false;
}

bool cli_parse(hg_arguments *arguments, const hg_command *command, int count, char **words, bool *help)
{
    memset(arguments, 0, sizeof *arguments);
    arguments->command = command;
    *help = false;
    arguments->free = hg_alloc((size_t)count, sizeof *arguments->free);
    if (arguments->free == NULL) {
        cli_fail();
        return false;
    }
    const int most = (int)(sizeof arguments->given / sizeof *arguments->given);
    bool options = true;
    for (int i = 0; i < count; i++) {
        const char *word = words[i];
        if (!options || word[0] != '-' || word[1] == '\0') {
            arguments->free[arguments->n_free++] = word;
            continue;
        }
        if (strcmp(word, "--") == 0) {
            options = false;
            continue;
        }
        if (strcmp(word, "-o") == 0) word = "--output"; /* the one short name that everybody expects, besides -h */
        if (strcmp(word, "--help") == 0 || strcmp(word, "-h") == 0) {
            *help = true;
            return true;
        }
        const char *name = word + 2, *equals = word[1] == '-' ? strchr(name, '=') : NULL;
        size_t length = word[1] != '-' ? strlen(word + 1) : equals != NULL ? (size_t)(equals - name) : strlen(name);
        const hg_argument *option = word[1] == '-' ? find_option(command, name, length) : NULL;
        if (option == NULL) return unknown_option(command, word, length);
        const char *value = equals != NULL ? equals + 1 : NULL;
        if (option->value_name == NULL && value != NULL) {
            fprintf(stderr, "hairgrad %s: --%s takes no value\n", command->name, option->name);
            return false;
        }
        if (option->value_name != NULL && value == NULL) {
            if (i + 1 == count) {
                fprintf(stderr, "hairgrad %s: --%s needs a value (%s)\n", command->name, option->name,
                        option->value_name);
                return false;
            }
            value = words[++i];
        }
        if (arguments->n_given == most) {
            fprintf(stderr, "hairgrad %s: more than %d options\n", command->name, most);
            return false;
        }
        arguments->given[arguments->n_given].name = option->name;
        arguments->given[arguments->n_given].value = value;
        arguments->n_given++;
    }
    const char *usage = command->usage != NULL ? command->usage : "";
    if (arguments->n_free < command->min_free) {
        fprintf(stderr, "hairgrad %s: something is missing; usage: hairgrad %s%s %s\n", command->name, command->name,
                command->n_options > 0 ? " [options]" : "", usage);
        return false;
    }
    if (arguments->n_free > command->max_free) {
        fprintf(stderr, "hairgrad %s: \"%s\" is one argument too many; usage: hairgrad %s%s %s\n", command->name,
                arguments->free[command->max_free], command->name, command->n_options > 0 ? " [options]" : "", usage);
        return false;
    }
    return true;
}

void cli_free(hg_arguments *arguments)
{
    hg_free(arguments->free);
    arguments->free = NULL;
}

/* ---- what commands ask for ---------------------------------------------------------------------------------- */

const char *cli_value(const hg_arguments *arguments, const char *name, const char *otherwise)
{
    for (int i = arguments->n_given - 1; i >= 0; i--)
        if (strcmp(arguments->given[i].name, name) == 0) return arguments->given[i].value;
    return otherwise;
}

bool cli_flag(const hg_arguments *arguments, const char *name)
{
    for (int i = 0; i < arguments->n_given; i++)
        if (strcmp(arguments->given[i].name, name) == 0) return true;
    return false;
}

bool cli_number(const hg_arguments *arguments, const char *name, double *value)
{
    const char *text = cli_value(arguments, name, NULL);
    if (text == NULL) return true;
    double number;
    if (hg_unit_parse(text, NULL, &number) != HG_OK) {
        hg_fail(HG_INVALID, "--%s: \"%s\" is not a number", name, text);
        return false;
    }
    *value = number;
    return true;
}

bool cli_integer(const hg_arguments *arguments, const char *name, int64_t *value)
{
    const char *text = cli_value(arguments, name, NULL);
    if (text == NULL) return true;
    char *end;
    errno = 0;
    long long number = strtoll(text, &end, 10);
    if (end == text || *end != '\0' || errno != 0) {
        hg_fail(HG_INVALID, "--%s: \"%s\" is not an integer", name, text);
        return false;
    }
    *value = number;
    return true;
}

bool cli_context(hg_ctx **ctx, const hg_arguments *arguments)
{
    int64_t threads = 0, seed = 1;
    *ctx = NULL;
    if (!cli_integer(arguments, "threads", &threads) || !cli_integer(arguments, "seed", &seed)) return false;
    if (threads < 0 || threads > 4096) {
        hg_fail(HG_INVALID, "--threads: %lld is out of range, between 1 and 4096 is needed (0: all cores)",
                (long long)threads);
        return false;
    }
    hg_ctx_options options = { .threads = (int)threads,
                               .seed = (uint64_t)seed,
                               .device = find_option(arguments->command, "device", strlen("device"))
                                             ? cli_value(arguments, "device", CLI_DEVICE)
                                             : "cpu" };
    return hg_ctx_create(ctx, &options) == HG_OK;
}

hg_status cli_trap(hg_ctx *ctx, const hg_arguments *arguments, const char *folder, char **path)
{
    *path = NULL;
    if (!cli_flag(arguments, "trap-nan")) return HG_OK;
    HG_TRY(hg_folder_create(folder));
    *path = hg_path_join(folder, "nan.h5");
    if (!*path) return HG_MEMORY;
    remove(*path); /* of a run before */
    hg_trap_nan(ctx, true, *path);
    return hg_ctx_status(ctx);
}
