/* Energies by name, and terms completed: every param and option has a value, from the term or by default. */
#include "hairloss/physics.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

const hg_energy *hg_energy_find(const char *name)
{
    const hg_energy *energy = name ? hg_find("energy", name) : NULL;
    if (energy) return energy;
    const char *near = name ? hg_nearest("energy", name) : NULL;
    hg_fail(HG_INVALID, "energy '%s' is not known%s%s%s", name ? name : "(null)", near ? "; did you mean '" : "",
            near ? near : "", near ? "'?" : "");
    return NULL;
}

static int count_params(const hg_energy *energy)
{
    int n = 0;
    while (n < HG_ENERGY_PARAMS && energy->params[n].name) n++;
    return n;
}

static int count_options(const hg_energy *energy)
{
    int n = 0;
    while (n < HG_ENERGY_OPTIONS && energy->options[n].name) n++;
    return n;
}

/* Is choice one of "a|b|c"? */
static bool one_of(const char *choices, const char *choice)
{
    const size_t length = strlen(choice);
    for (const char *at = choices; at; at = strchr(at, '|') ? strchr(at, '|') + 1 : NULL)
        if (strncmp(at, choice, length) == 0 && (at[length] == '|' || at[length] == 0)) return length > 0;
    return false;
}

hg_status hg_term_complete(const hg_term *term, double params[HG_ENERGY_PARAMS], const char *options[HG_ENERGY_OPTIONS])
{
    const hg_energy *energy = term->energy;
    if (!energy) return hg_fail(HG_INVALID, "a term has no energy: is its name spelt right?");
    if (!isfinite(term->weight)) return hg_fail(HG_INVALID, "energy '%s': its weight is not a number", energy->name);
    for (int i = 0; i < count_params(energy); i++) {
        params[i] = term->params ? term->params[i] : energy->params[i].value;
        if (!isfinite(params[i]))
            return hg_fail(HG_INVALID, "energy '%s': param '%s' is not a number", energy->name, energy->params[i].name);
    }
    for (int i = 0; i < count_options(energy); i++) {
        const hg_energy_option *option = &energy->options[i];
        options[i] = term->options && term->options[i] ? term->options[i] : option->value;
        if (!one_of(option->choices, options[i]))
            return hg_fail(HG_INVALID, "energy '%s': option '%s' is '%s', possible are %s", energy->name, option->name,
                           options[i], option->choices);
    }
    return HG_OK;
}

bool hg_energy_choose(const hg_energy *energy, int number, hg_energy_choice *choice)
{
    *choice = (hg_energy_choice){ { NULL }, { "" } };
    for (int i = 0; i < count_options(energy); i++) {
        const char *word = energy->options[i].choices;
        int n = 1;
        for (const char *at = word; *at; at++) n += *at == '|';
        for (int skip = number % n; skip > 0; skip--) word = strchr(word, '|') + 1;
        number /= n;
        snprintf(choice->words[i], sizeof choice->words[i], "%.*s", (int)strcspn(word, "|"), word);
        choice->options[i] = choice->words[i];
    }
    return number == 0;
}

void hg_term_scope(hg_trace_scope *scope, const hg_term *term, int number, uint32_t allowed)
{
    const hg_energy *energy = term->energy;
    const int window = energy->site.kind == HG_SITE_WINDOW  ? energy->site.count
                       : energy->site.kind == HG_SITE_PAIRS ? 2
                                                            : 1;
    *scope = (hg_trace_scope){ .name = energy->name, .allowed = allowed, .window = window, .term = number };
    scope->n_params = count_params(energy);
    scope->n_options = count_options(energy);
    for (int i = 0; i < scope->n_params; i++) scope->params[i] = energy->params[i].name;
    for (int i = 0; i < scope->n_options; i++) {
        scope->options[i] = energy->options[i].name;
        scope->choices[i] = term->options[i];
    }
}

double hg_term_param(const hg_term *term, const char *name)
{
    for (int i = 0; i < count_params(term->energy); i++)
        if (strcmp(term->energy->params[i].name, name) == 0) return term->params[i];
    return NAN;
}

const char *hg_term_option(const hg_term *term, const char *name)
{
    for (int i = 0; i < count_options(term->energy); i++)
        if (strcmp(term->energy->options[i].name, name) == 0) return term->options[i];
    return NULL;
}

bool hg_term_weighs(const hg_term *term)
{
    const char *kernel_mass = hg_term_option(term, "kernel_mass");
    return term->energy->site.kind == HG_SITE_FIELD && kernel_mass && strcmp(kernel_mass, "kg") == 0;
}

const double *hg_groom_attribute_find(const hg_groom_data *data, const char *name)
{
    for (int i = 0; i < data->n_attributes; i++)
        if (strcmp(data->attributes[i].name, name) == 0) return data->attributes[i].values;
    return NULL;
}
