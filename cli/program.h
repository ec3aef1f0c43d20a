/* Shared by main.c and arguments.c; subcommands need cli.h alone. */
#ifndef HG_CLI_PROGRAM_H
#define HG_CLI_PROGRAM_H

#include "cli/cli.h"

void cli_print_options(FILE *to, const hg_argument *options, size_t count);
void cli_print_command(FILE *to, const hg_command *command);
/* False after a sentence on stderr. */
bool cli_parse(hg_arguments *arguments, const hg_command *command, int count, char **words, bool *help);
void cli_free(hg_arguments *arguments);

#endif
