/* hairgrad trace: what becomes of the formula of an energy, or of the sum of several. */
#include "cli/cli.h"

#include <string.h>

enum { TERMS = 16 };

/* "strain=smooth" for every energy that has the option, "bend_twist.strain=smooth" for one. */
static hg_status set_option(hg_term *terms, const char *(*options)[HG_ENERGY_OPTIONS], int n, const char *setting)
{
    const char *equals = strchr(setting, '='), *dot = strchr(setting, '.');
    if (equals == NULL) return hg_fail(HG_INVALID, "--set %s: expected option=choice, like strain=smooth", setting);
    if (dot != NULL && dot > equals) dot = NULL;
    const char *name = dot != NULL ? dot + 1 : setting, *known[TERMS * HG_ENERGY_OPTIONS];
    const size_t length = (size_t)(equals - name);
    int found = 0, n_known = 0;
    for (int t = 0; t < n; t++) {
        const hg_energy *energy = terms[t].energy;
        if (dot != NULL &&
            (strncmp(energy->name, setting, (size_t)(dot - setting)) != 0 || energy->name[dot - setting] != '\0'))
            continue;
        for (int k = 0; k < HG_ENERGY_OPTIONS && energy->options[k].name != NULL; k++) {
            known[n_known++] = energy->options[k].name;
            if (strncmp(energy->options[k].name, name, length) != 0 || energy->options[k].name[length] != '\0')
                continue;
            options[t][k] = equals + 1;
            found++;
        }
    }
    if (found > 0) return HG_OK;
    char *wanted = hg_format("%.*s", (int)length, name);
    const char *near = wanted != NULL ? hg_nearest_of(wanted, known, n_known) : NULL;
    hg_fail(HG_INVALID, "--set %s: none of the energies has such an option%s%s%s", setting,
            near != NULL ? "; did you mean \"" : "", near != NULL ? near : "", near != NULL ? "\"?" : "");
    hg_free(wanted);
    return HG_INVALID;
}

static void print_head(const hg_term *terms, const char *(*options)[HG_ENERGY_OPTIONS], int n)
{
    for (int t = 0; t < n; t++) {
        const hg_energy *energy = terms[t].energy;
        printf("%s%s: E = %s\n", t > 0 ? "+ " : "", energy->name, energy->equation != NULL ? energy->equation : "?");
        for (int k = 0; k < HG_ENERGY_OPTIONS && energy->options[k].name != NULL; k++)
            printf("    %s = %s\n", energy->options[k].name,
                   options[t][k] != NULL ? options[t][k] : energy->options[k].value);
    }
}

static int trace(const hg_arguments *arguments)
{
    hg_term terms[TERMS];
    const char *options[TERMS][HG_ENERGY_OPTIONS] = { { NULL } };
    const int n = arguments->n_free;
    const char *type = cli_value(arguments, "dtype", "f32");
    if (strcmp(type, "f32") != 0 && strcmp(type, "f64") != 0) {
        hg_fail(HG_INVALID, "--dtype %s: f32 or f64", type);
        return cli_fail();
    }
    for (int t = 0; t < n; t++) {
        terms[t] = (hg_term){ hg_energy_find(arguments->free[t]), 1, NULL, options[t] };
        if (terms[t].energy == NULL) return cli_fail();
    }
    for (int i = 0; i < arguments->n_given; i++)
        if (strcmp(arguments->given[i].name, "set") == 0 &&
            set_option(terms, options, n, arguments->given[i].value) != HG_OK)
            return cli_fail();
    enum { MOST_WRT = 32 };
    const char *wrt[MOST_WRT];
    char *list = hg_strdup(cli_value(arguments, "wrt", "")), *rest = NULL;
    int n_wrt = 0;
    for (char *word = list != NULL ? strtok_r(list, ", ", &rest) : NULL; word != NULL && n_wrt < MOST_WRT;
         word = strtok_r(NULL, ", ", &rest))
        wrt[n_wrt++] = word;
    const bool cuda = cli_flag(arguments, "cuda"), printed = cuda || cli_flag(arguments, "c");
    hg_text report = { 0 }, c = { 0 };
    const hg_status status = hg_energy_trace(terms, n, strcmp(type, "f64") == 0 ? HG_F64 : HG_F32, n_wrt, wrt, &report,
                                             cuda ? NULL : &c, cuda ? &c : NULL);
    hg_free(list);
    if (status == HG_OK && printed && c.size == 0) {
        hg_fail(HG_UNSUPPORTED, "trace: energies over pairs and neighbours are interpreted; there is no kernel of %s",
                arguments->free[0]);
    } else if (status == HG_OK && printed) {
        fputs(c.data, stdout);
    } else if (status == HG_OK) {
        print_head(terms, options, n);
        fputs(report.data, stdout);
    }
    const bool good = status == HG_OK && !(printed && c.size == 0);
    hg_text_free(&report);
    hg_text_free(&c);
    return good ? 0 : cli_fail();
}

static const hg_argument trace_options[] = {
    { "set", "OPTION=CHOICE", "choose an option, like strain=smooth or bend_twist.strain=smooth", true },
    { "wrt", "NAME,...",
      "what the derivative is taken in, beside x: rest, root_rotation, stiffness, ... (nothing of it is hoisted)",
      false },
    { "dtype", "f32|f64", "number type of the kernel (default f32)", false },
    { "c", NULL, "print the kernel as C instead", false },
    { "cuda", NULL, "print the kernel as CUDA C instead", false },
};
HG_COMMAND(trace, .what = "what becomes of an energy's formula: operations, what is hoisted, instructions, C",
           .usage = "NAME...", .options = trace_options, .n_options = sizeof trace_options / sizeof *trace_options,
           .min_free = 1, .max_free = TERMS, .run = trace,
           .more = "Several names are their sum, as it is fused into one kernel.\n"
                   "  hairgrad trace bend_twist --set strain=smooth\n"
                   "  hairgrad trace stretch bend_twist gravity inertia --c\n");
