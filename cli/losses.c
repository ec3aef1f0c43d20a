/* hairgrad losses: every energy that is known, with its equation, source, site, parameters and units, and what it reads.
 * The last is found by tracing the formulas. */
#include "cli/cli.h"

#include <cjson/cJSON.h>
#include <stdlib.h>
#include <string.h>

enum { most = 256 };

/* What an energy asks for with any choice of its options. */
typedef struct {
    int n, choices;
    bool scan;
    struct {
        hg_energy_input input;
        int count; /* of choices that ask for it */
        char when[96];
    } of[2 * HG_ENERGY_INPUTS];
} asked;

static bool asks_for(const hg_energy_inputs *inputs, const char *name)
{
    for (int i = 0; i < inputs->n; i++)
        if (strcmp(inputs->input[i].name, name) == 0) return true;
    return false;
}

/* The one choice that decides whether an input is asked for: "surface=scalp"; "" when it is more than one. */
static hg_status explain(const hg_energy *energy, const char *name, char *when, size_t room)
{
    when[0] = '\0';
    for (int option = 0; option < HG_ENERGY_OPTIONS && energy->options[option].name != NULL; option++) {
        hg_energy_choice choice;
        char word[64] = "";
        bool decides = true;
        for (int number = 0; hg_energy_choose(energy, number, &choice); number++) {
            hg_energy_inputs inputs;
            HG_TRY(hg_energy_asks(energy, choice.options, true, &inputs));
            if (!asks_for(&inputs, name)) continue;
            decides &= word[0] == '\0' || strcmp(word, choice.options[option]) == 0;
            snprintf(word, sizeof word, "%.63s", choice.options[option]);
        }
        if (decides && word[0] != '\0') snprintf(when, room, "%.31s=%.63s", energy->options[option].name, word);
    }
    return HG_OK;
}

static hg_status ask(const hg_energy *energy, asked *all)
{
    hg_energy_choice choice;
    *all = (asked){ 0 };
    for (; hg_energy_choose(energy, all->choices, &choice); all->choices++) {
        hg_energy_inputs inputs;
        HG_TRY(hg_energy_asks(energy, choice.options, true, &inputs));
        all->scan |= inputs.scan;
        for (int i = 0; i < inputs.n; i++) {
            int k = 0;
            while (k < all->n && strcmp(all->of[k].input.name, inputs.input[i].name) != 0) k++;
            if (k == 2 * HG_ENERGY_INPUTS) continue;
            all->of[k].input = inputs.input[i];
            all->of[k].count++;
            if (k == all->n) all->n++;
        }
    }
    for (int k = 0; k < all->n; k++)
        if (all->of[k].count < all->choices)
            HG_TRY(explain(energy, all->of[k].input.name, all->of[k].when, sizeof all->of[k].when));
    return HG_OK;
}

/* Short, for the table, or in words. */
static const char *site_text(const hg_energy *energy, bool scan, bool words, char text[64])
{
    switch (energy->site.kind) {
    case HG_SITE_WINDOW:
        if (!words)
            snprintf(text, 64, "%s %d", scan ? "scan" : "window", energy->site.count);
        else if (energy->site.count == 1)
            snprintf(text, 64, "each vertex");
        else
            snprintf(text, 64, "each %d vertices in a row%s", energy->site.count, scan ? ", from root to tip" : "");
        return text;
    case HG_SITE_PAIRS:
        return words ? "each pair of near vertices" : "pairs";
    case HG_SITE_FIELD:
        return words ? "each vertex and its neighbours" : "field";
    }
    return "unknown";
}

static void print_param(const hg_energy_param *param)
{
    const bool bare = param->unit == NULL || strcmp(param->unit, "1") == 0;
    printf("%s = %.9g%s%s", param->name, param->value, bare ? "" : " ", bare ? "" : param->unit);
}

/* Two lines of the table. */
static void print_row(const hg_energy *energy, const asked *all)
{
    char site[64];
    const bool bare = energy->params[0].name == NULL && energy->options[0].name == NULL;
    printf(bare ? "%-23s %s" : "%-23s %-9s", energy->name, site_text(energy, all->scan, false, site));
    for (int i = 0; i < HG_ENERGY_PARAMS && energy->params[i].name != NULL; i++) {
        if (i > 0) printf(", ");
        print_param(&energy->params[i]);
    }
    for (int i = 0; i < HG_ENERGY_OPTIONS && energy->options[i].name != NULL; i++)
        printf("%s%s: %s", i > 0 || energy->params[0].name != NULL ? "; " : "", energy->options[i].name,
               energy->options[i].choices);
    printf("\n    %s   [%s]\n    reads", energy->equation != NULL ? energy->equation : "?",
           energy->source != NULL ? energy->source : "?");
    for (int i = 0; i < all->n; i++) {
        printf("%s %s", i > 0 ? "," : "", all->of[i].input.name);
        if (all->of[i].when[0] != '\0') printf(" (%s)", all->of[i].when);
    }
    putchar('\n');
}

static void print_text(const hg_energy *energy, const asked *all)
{
    char site[64];
    printf("%s\n  E = %s\n  source: %s\n  site: %s\n", energy->name, energy->equation != NULL ? energy->equation : "?",
           energy->source != NULL ? energy->source : "?", site_text(energy, all->scan, true, site));
    if (energy->params[0].name != NULL) printf("  parameters\n");
    for (int i = 0; i < HG_ENERGY_PARAMS && energy->params[i].name != NULL; i++) {
        printf("    ");
        print_param(&energy->params[i]);
        printf("%s%s\n", energy->params[i].help != NULL ? "   " : "",
               energy->params[i].help != NULL ? energy->params[i].help : "");
    }
    if (energy->options[0].name != NULL) printf("  options\n");
    for (int i = 0; i < HG_ENERGY_OPTIONS && energy->options[i].name != NULL; i++) {
        const hg_energy_option *option = &energy->options[i];
        printf("    %s: %s   one of %s%s%s\n", option->name, option->value, option->choices,
               option->help != NULL ? "; " : "", option->help != NULL ? option->help : "");
    }
    printf("  reads\n");
    for (int i = 0; i < all->n; i++) {
        const hg_energy_input *input = &all->of[i].input;
        printf("    %-18s %-12s%s%s%s%s\n", input->name, input->shape,
               input->differentiable ? " differentiable" : " detached", input->optional ? ", made where absent" : "",
               all->of[i].when[0] != '\0' ? ", with " : "", all->of[i].when);
    }
    printf("  zero at rest: %s; moves with the head: %s\n", energy->zero_at_rest ? "yes" : "not in general",
           energy->rigid_invariant ? "yes" : "no");
}

static cJSON *json_of(const hg_energy *energy, const asked *all)
{
    static const char *const kinds[] = { "window", "pairs", "field" };
    char site[64];
    cJSON *object = cJSON_CreateObject(), *params = cJSON_CreateArray(), *options = cJSON_CreateArray(),
          *inputs = cJSON_CreateArray();
    cJSON_AddStringToObject(object, "name", energy->name);
    cJSON_AddStringToObject(object, "equation", energy->equation != NULL ? energy->equation : "");
    cJSON_AddStringToObject(object, "source", energy->source != NULL ? energy->source : "");
    cJSON_AddStringToObject(object, "site", site_text(energy, all->scan, true, site));
    cJSON_AddStringToObject(object, "site_kind", all->scan ? "scan" : kinds[energy->site.kind]);
    cJSON_AddNumberToObject(object, "site_vertices", energy->site.count);
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
    for (int i = 0; i < all->n; i++) {
        cJSON *input = cJSON_CreateObject();
        cJSON_AddStringToObject(input, "name", all->of[i].input.name);
        cJSON_AddStringToObject(input, "shape", all->of[i].input.shape);
        cJSON_AddBoolToObject(input, "differentiable", all->of[i].input.differentiable);
        cJSON_AddBoolToObject(input, "optional", all->of[i].input.optional);
        if (all->of[i].when[0] != '\0') cJSON_AddStringToObject(input, "when", all->of[i].when);
        cJSON_AddItemToArray(inputs, input);
    }
    cJSON_AddItemToObject(object, "parameters", params);
    cJSON_AddItemToObject(object, "options", options);
    cJSON_AddItemToObject(object, "inputs", inputs);
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
    const bool json = cli_flag(arguments, "json");
    cJSON *all = json ? cJSON_CreateArray() : NULL;
    for (int i = 0; i < count; i++) {
        const hg_energy *energy = known(names[i]);
        asked asks;
        if (ask(energy, &asks) != HG_OK) {
            cJSON_Delete(all);
            return cli_fail();
        }
        if (i > 0 && !json) putchar('\n');
        if (json)
            cJSON_AddItemToArray(all, json_of(energy, &asks));
        else if (arguments->n_free > 0)
            print_text(energy, &asks);
        else
            print_row(energy, &asks);
    }
    if (!json) return 0;
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
