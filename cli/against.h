/* against: a network beside solvers, for hairgrad evaluate --against. */
#ifndef HG_CLI_AGAINST_H
#define HG_CLI_AGAINST_H

#include "cli/cli.h"

/* What --against asks for. n_solvers 0: it was not given. */
typedef struct {
    hg_against_options options;
    hg_against_solver solver[HG_AGAINST_SIDES];
} cli_against;

hg_status cli_against_options(const hg_arguments *arguments, cli_against *against);
/* Tables on stdout, --json, --plot. */
hg_status cli_against_show(const hg_arguments *arguments, int n, const char *const *clips, const hg_against *against);

#define CLI_AGAINST_OPTIONS                                                                                            \
    { "against", "METHOD",                                                                                             \
      "beside a solver of the same energies, lbfgs, adam or xpbd (repeat for more): docs/evaluate.md", true },         \
        { "against-frames", "N", "consecutive frames, 45; of a network without inertia N poses, 6", false },           \
        { "against-strands", "N", "about so many strands, evenly over the groom (200)", false },                       \
    {                                                                                                                  \
        "plot", "FILE", "with --against: energies and tip paths, PNG", false                                           \
    }

#endif
