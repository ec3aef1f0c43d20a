/* hairgrad losses: every energy that is known, with its equation, source, parameters and units. */
#include "cli/cli.h"

#include <cjson/cJSON.h>
#include <stdlib.h>
#include <string.h>

enum { most = 256 };

static const char *site_text(const hg_energy *energy, char text[64])
{
    switch (energy->site.kind) {
    case HG_SITE_WINDOW:
        if (energy->site.count == 1) return "each vertex";
        snprintf(text, 64, "each %d vertices in a row", energy->site.count);
        return text;
    case HG_SITE_PAIRS:
        return "each pair of near vertices";
    case HG_SITE_FIELD:
        return "each vertex and its neighbours";
    }
    return "unknown";
}

static void print_text(const hg_energy *energy)
{
    char site[64];
    printf("%s\n  E = %s\n  source: %s\n  site: %s\n", energy->name, energy->equation != NULL ? energy->equation : "?",
           energy->source != NULL ? energy->source : "?", site_text(energy, site));
    for (int i = 0; i < HG_ENERGY_PARAMS && energy->params[i].name != NULL; i++) {
        const hg_energy_param *param = &energy->params[i];
        bool bare = param->unit == NULL || strcmp(param->unit, "1") == 0;
        printf("  %s = %.9g%s%s%s%s\n", param->name, param->value, bare ? "" : " ", bare ? "" : param->unit,
               param->help != NULL ? "   " : "", param->help != NULL ? param->help : "");
    }
    for (int i = 0; i < HG_ENERGY_OPTIONS && energy->options[i].name != NULL; i++) {
        const hg_energy_option *option = &energy->options[i];
        printf("  %s: %s   one of %s%s%s\n", option->name, option->value, option->choices,
               option->help != NULL ? "; " : "", option->help != NULL ? option->help : "");
    }
}

static cJSON *json_of(const hg_energy *energy)
{
    char site[64];
    cJSON *object = cJSON_CreateObject(), *params = cJSON_CreateArray(), *options = cJSON_CreateArray();
    cJSON_AddStringToObject(object, "name", energy->name);
    cJSON_AddStringToObject(object, "equation", energy->equation != NULL ? energy->equation : "");
    cJSON_AddStringToObject(object, "source", energy->source != NULL ? energy->source : "");
    cJSON_AddStringToObject(object, "site", site_text(energy, site));
    for (int i = 0; i < HG_ENERGY_PARAMS && energy->params[i].name != NULL; i++) {
        cJSON *param = cJSON_CreateObject();
        cJSON_AddStringToObject(param, "name", energy->params[i].name);
        cJSON_AddNumberToObject(param, "default", energy->params[i].value);
        cJSON_AddStringToObject(param, "unit", energy->params[i].unit != NULL ? energy->params[i].unit : "1");
        cJSON_AddStringToObject(param, "help", energy->params[i].help != NULL ? energy->params[i].help : "");
        cJSON_AddItemToArray(params, param);
    }
    for (int i = 0; i < HG_ENERGY_OPTIONS && energy->options[i].name != NULL; i++) {
        cJSON *option = cJSON_CreateObject();
        cJSON_AddStringToObject(option, "name", energy->options[i].name);
        cJSON_AddStringToObject(option, "choices", energy->options[i].choices);
        cJSON_AddStringToObject(option, "default", energy->options[i].value);
        cJSON_AddStringToObject(option, "help", energy->options[i].help != NULL ? energy->options[i].help : "");
        cJSON_AddItemToArray(options, option);
    }
    cJSON_AddItemToObject(object, "parameters", params);
    cJSON_AddItemToObject(object, "options", options);
    cJSON_AddBoolToObject(object, "zero_at_rest", energy->zero_at_rest);
    cJSON_AddBoolToObject(object, "rigid_invariant", energy->rigid_invariant);
    return object;
}

static const hg_energy *known(const char *name)
{
    const hg_energy *energy = hg_find("energy", name);
    if (energy != NULL) return energy;
    const char *nearest = hg_nearest("energy", name);
    hg_fail(HG_INVALID, "unknown energy \"%s\"%s%s%s", name,
            nearest != NULL ? "; did you mean \"" : "; hairgrad losses lists them", nearest != NULL ? nearest : "",
            nearest != NULL ? "\"?" : "");
    return NULL;
}

static int losses(const hg_arguments *arguments)
{
    const char *names[most];
    int count = hg_list("energy", names, most);
    if (count > most) count = most;
    if (arguments->n_free > 0) {
        count = arguments->n_free < most ? arguments->n_free : most;
        for (int i = 0; i < count; i++) {
            names[i] = arguments->free[i];
            if (known(names[i]) == NULL) return cli_fail();
        }
    }
    if (!cli_flag(arguments, "json")) {
        for (int i = 0; i < count; i++) {
            if (i > 0) putchar('\n');
            print_text(known(names[i]));
        }
        return 0;
    }
    cJSON *all = cJSON_CreateArray();
    for (int i = 0; i < count; i++) cJSON_AddItemToArray(all, json_of(known(names[i])));
    char *text = cJSON_Print(all);
    cJSON_Delete(all);
    if (text == NULL) {
        hg_fail(HG_MEMORY, "no memory to print the energies");
        return cli_fail();
    }
    puts(text);
    free(text);
    return 0;
}

static const hg_argument losses_options[] = { { "json", NULL, "print JSON, for programs", false } };
HG_COMMAND(losses, .what = "the energies: equation, source, parameters with units", .usage = "[NAME...]",
           .options = losses_options, .n_options = 1, .max_free = most, .run = losses,
           .more = "examples:\n  hairgrad losses stretch bend_twist\n  hairgrad losses --json\n");
