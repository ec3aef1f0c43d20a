/* What an energy may declare, checked when a plug-in is loaded: names, parameters with units, options, a window that fits,
 * and formulas that are traced once for every choice of every option. */
#include "autograd/trace/program.h"
#include "hairloss/physics.h"

#include <ctype.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

enum { WINDOW_MOST = 8 };

/* Letters, digits, _ and the dot of "g.x". */
static bool is_name(const char *name, bool dots)
{
    if (!name || !(isalpha((unsigned char)*name) || *name == '_')) return false;
    for (const char *at = name; *at; at++)
        if (!isalnum((unsigned char)*at) && *at != '_' && !(dots && *at == '.')) return false;
    return true;
}

static hg_status check_params(const hg_energy *energy)
{
    bool ended = false;
    for (int i = 0; i < HG_ENERGY_PARAMS; i++) {
        const hg_energy_param *param = &energy->params[i];
        if (!param->name) {
            if (param->unit || param->help || param->value != 0)
                return hg_fail(HG_INVALID, "energy '%s': its parameter number %d has no name", energy->name, i + 1);
            ended = true;
            continue;
        }
        if (ended) return hg_fail(HG_INVALID, "energy '%s': its parameter number %d has no name", energy->name, i);
        if (!is_name(param->name, true))
            return hg_fail(HG_INVALID, "energy '%s': '%s' is no name for a parameter: letters, digits and _ are",
                           energy->name, param->name);
        for (int k = 0; k < i; k++)
            if (strcmp(energy->params[k].name, param->name) == 0)
                return hg_fail(HG_INVALID, "energy '%s': parameter '%s' is declared twice", energy->name, param->name);
        if (!param->unit || !*param->unit)
            return hg_fail(HG_INVALID, "energy '%s': parameter '%s' has no unit; a pure number has \"1\"", energy->name,
                           param->name);
        if (!isfinite(param->value))
            return hg_fail(HG_INVALID, "energy '%s': the default of parameter '%s' is not a number", energy->name,
                           param->name);
    }
    return HG_OK;
}

static int choices_of(const hg_energy_option *option)
{
    int n = 1;
    for (const char *at = option->choices; *at; at++) n += *at == '|';
    return n;
}

/* Choice number i, cut out of "a|b|c". */
static bool choice(const hg_energy_option *option, int i, char to[64])
{
    const char *at = option->choices;
    for (; i > 0; i--) at = strchr(at, '|') + 1;
    const size_t length = strcspn(at, "|");
    if (length == 0 || length > 63) return false;
    memcpy(to, at, length);
    to[length] = '\0';
    return true;
}

static hg_status check_options(const hg_energy *energy)
{
    bool ended = false;
    for (int i = 0; i < HG_ENERGY_OPTIONS; i++) {
        const hg_energy_option *option = &energy->options[i];
        if (!option->name) {
            ended = true;
            if (option->choices || option->value || option->help)
                return hg_fail(HG_INVALID, "energy '%s': its option number %d has no name", energy->name, i + 1);
            continue;
        }
        if (ended || !is_name(option->name, false))
            return hg_fail(HG_INVALID, "energy '%s': '%s' is no name for option number %d", energy->name, option->name,
                           i + 1);
        for (int k = 0; k < HG_ENERGY_PARAMS && energy->params[k].name; k++)
            if (strcmp(energy->params[k].name, option->name) == 0)
                return hg_fail(HG_INVALID, "energy '%s': '%s' is declared as a parameter and as an option",
                               energy->name, option->name);
        bool found = false;
        char word[64];
        for (int c = 0; option->choices && c < choices_of(option); c++) {
            if (!choice(option, c, word))
                return hg_fail(HG_INVALID, "energy '%s': option '%s' has an empty choice in \"%s\"", energy->name,
                               option->name, option->choices);
            found |= option->value && strcmp(option->value, word) == 0;
        }
        if (!found)
            return hg_fail(HG_INVALID, "energy '%s': the default \"%s\" of option '%s' is none of its choices \"%s\"",
                           energy->name, option->value ? option->value : "", option->name,
                           option->choices ? option->choices : "");
    }
    return HG_OK;
}

static hg_status trace(const hg_energy *energy, hg_scalar (*formula)(void), const char *const *options,
                       uint32_t allowed, int window)
{
    hg_trace_scope scope;
    const hg_term term = { energy, 1, NULL, options };
    uint32_t kinds;
    int n;
    char *attributes[8];
    if (!formula) return HG_OK;
    hg_term_scope(&scope, &term, 0, allowed);
    if (window) scope.window = window;
    HG_TRY(hg_formula_inputs(formula, &scope, &kinds, &n, attributes));
    for (int i = 0; i < n; i++) hg_free(attributes[i]);
    if (!energy->contact && (kinds & (HG_ALLOW(HG_INPUT_CONTACT_POINT) | HG_ALLOW(HG_INPUT_CONTACT_NORMAL))))
        return hg_fail(HG_INVALID, "energy '%s' asks for contact and does not declare it: .contact = true",
                       energy->name);
    return HG_OK;
}

static hg_status trace_all(const hg_energy *energy, const char *const *options)
{
    switch (energy->site.kind) {
    case HG_SITE_WINDOW:
        HG_TRY(trace(energy, energy->trace, options, HG_ALLOW_WINDOW, 0));
        return trace(energy, energy->root, options, HG_ALLOW_WINDOW, 2);
    case HG_SITE_PAIRS:
        return trace(energy, energy->trace, options, HG_ALLOW_PAIRS, 0);
    case HG_SITE_FIELD:
        HG_TRY(trace(energy, energy->kernel, options, HG_ALLOW_FIELD_KERNEL, 0));
        return trace(energy, energy->trace, options, HG_ALLOW_FIELD, 0);
    }
    return hg_fail(HG_INVALID, "energy '%s': its site is of no known kind", energy->name);
}

static hg_status check_site(const hg_energy *energy)
{
    if (!energy->trace) return hg_fail(HG_INVALID, "energy '%s' has no formula", energy->name);
    if (energy->site.kind == HG_SITE_WINDOW && (energy->site.count < 1 || energy->site.count > WINDOW_MOST))
        return hg_fail(HG_INVALID, "energy '%s': a window of %d vertices; 1 to %d are possible (.site = window(2))",
                       energy->name, energy->site.count, WINDOW_MOST);
    if (energy->site.kind != HG_SITE_FIELD) return HG_OK;
    bool found = false;
    for (int i = 0; energy->reach && i < HG_ENERGY_PARAMS && energy->params[i].name; i++)
        found |= strcmp(energy->params[i].name, energy->reach) == 0;
    if (!energy->kernel) return hg_fail(HG_INVALID, "energy '%s' sums over neighbours and has no kernel", energy->name);
    if (!found)
        return hg_fail(HG_INVALID, "energy '%s' sums over neighbours, and its .reach is none of its parameters",
                       energy->name);
    return HG_OK;
}

static hg_status check(const char *name, const void *item)
{
    const hg_energy *energy = item;
    if (!energy) return hg_fail(HG_INVALID, "energy '%s' is registered without its struct", name);
    if (!is_name(energy->name, false))
        return hg_fail(HG_INVALID, "'%s' is no name for an energy: letters, digits and _ are",
                       energy->name ? energy->name : "");
    if (strcmp(energy->name, name) != 0)
        return hg_fail(HG_INVALID, "energy '%s' is registered under another name, '%s'", energy->name, name);
    HG_TRY(check_params(energy));
    HG_TRY(check_options(energy));
    HG_TRY(check_site(energy));
    double params[HG_ENERGY_PARAMS];
    const char *options[HG_ENERGY_OPTIONS];
    HG_TRY(hg_term_complete(&(hg_term){ energy, 1, NULL, NULL }, params, options));
    HG_TRY(trace_all(energy, options));
    for (int i = 0; i < HG_ENERGY_OPTIONS && energy->options[i].name; i++) {
        const char *usual = options[i];
        char word[64];
        for (int c = 0; c < choices_of(&energy->options[i]); c++) {
            choice(&energy->options[i], c, word);
            options[i] = word;
            HG_TRY(trace_all(energy, options));
        }
        options[i] = usual;
    }
    return HG_OK;
}

static const hg_declaration declaration = { check };
HG_REGISTER("declaration", energy, &declaration);
