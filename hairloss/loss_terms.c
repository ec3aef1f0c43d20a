/* The energies of a loss and their settings: "stretch+bend_twist", "stiffness=2 N/m", "strain=smooth", "g=0,-9.81,0". */
#include "hairloss/loss.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

char *loss_keep(loss *l, char *text)
{
    if (text && l->n_texts == (int)(sizeof l->texts / sizeof *l->texts)) {
        hg_free(text);
        hg_fail(HG_INVALID, "loss: more names than it keeps");
        return NULL;
    }
    if (text) l->texts[l->n_texts++] = text;
    return text;
}

loss_array *loss_find(loss *l, const char *name)
{
    for (int i = 0; i < l->n_arrays; i++)
        if (strcmp(l->array[i].name, name) == 0 || (l->array[i].full && strcmp(l->array[i].full, name) == 0))
            return &l->array[i];
    return NULL;
}

loss_array *loss_add(loss *l, const char *name)
{
    char *kept = loss_keep(l, hg_strdup(name));
    if (!kept) return NULL;
    if (l->n_arrays == LOSS_ARRAYS) {
        hg_fail(HG_INVALID, "loss: more than %d arrays", LOSS_ARRAYS);
        return NULL;
    }
    loss_array *array = &l->array[l->n_arrays++];
    *array = (loss_array){ .name = kept, .term = -1, .param = -1 };
    return array;
}

/* ---- energies ----------------------------------------------------------------------------------------------- */

static hg_status add_term(loss *l, const char *name)
{
    const hg_energy *energy = hg_energy_find(name);
    if (!energy) return HG_INVALID;
    if (l->n_terms == LOSS_TERMS) return hg_fail(HG_INVALID, "loss: at most %d energies at a time", LOSS_TERMS);
    for (int t = 0; t < l->n_terms; t++)
        if (l->term[t].energy == energy) return hg_fail(HG_INVALID, "loss: energy '%s' is named twice", name);
    const int t = l->n_terms++;
    l->term[t] = (hg_term){ energy, 1.0, l->params[t], l->options[t] };
    for (int p = 0; p < HG_ENERGY_PARAMS && energy->params[p].name; p++) l->params[t][p] = energy->params[p].value;
    for (int o = 0; o < HG_ENERGY_OPTIONS && energy->options[o].name; o++) {
        l->options[t][o] = energy->options[o].value;
        /* Held against papers and other programs, a density is that of their formula: weighed with the mass. */
        if (strcmp(energy->options[o].name, "kernel_mass") == 0) l->options[t][o] = "kg";
    }
    return HG_OK;
}

static hg_status read_energies(loss *l, const char *energies)
{
    for (const char *at = energies;; at++) {
        const size_t length = strcspn(at, "+");
        char name[128];
        if (length == 0 || length >= sizeof name)
            return hg_fail(HG_INVALID, "loss: \"%s\" is not a list of energies like stretch or stretch+gravity",
                           energies);
        snprintf(name, sizeof name, "%.*s", (int)length, at);
        HG_TRY(add_term(l, name));
        at += length;
        if (!*at) return HG_OK;
    }
}

/* "g" of "g.x" when g.y and g.z follow; else 0. */
static size_t vector_name(const hg_energy *energy, int p)
{
    const char *name = energy->params[p].name, *dot = strrchr(name, '.');
    if (!dot || strcmp(dot, ".x") != 0 || p + 2 >= HG_ENERGY_PARAMS) return 0;
    const size_t length = (size_t)(dot - name);
    for (int c = 1; c < 3; c++) {
        const char *next = energy->params[p + c].name;
        if (!next || strncmp(next, name, length) != 0 || next[length] != '.' || next[length + 1] != "xyz"[c]) return 0;
    }
    return length;
}

/* Is the name one of more than one energy? Then only "energy.name" means one of them. */
static bool is_shared(const loss *l, const char *name)
{
    int n = 0;
    for (int t = 0; t < l->n_terms; t++)
        for (int p = 0; p < HG_ENERGY_PARAMS && l->term[t].energy->params[p].name; p++) {
            const char *other = l->term[t].energy->params[p].name;
            const size_t vector = vector_name(l->term[t].energy, p);
            n += vector ? strlen(name) == vector && strncmp(name, other, vector) == 0 : strcmp(name, other) == 0;
        }
    return n > 1;
}

/* An array for every parameter, with its default; a vector's components are one. */
static hg_status add_params(loss *l)
{
    for (int t = 0; t < l->n_terms; t++) {
        const hg_energy *energy = l->term[t].energy;
        for (int p = 0; p < HG_ENERGY_PARAMS && energy->params[p].name; p++) {
            const size_t vector = vector_name(energy, p);
            char name[128];
            snprintf(name, sizeof name, "%.*s", vector ? (int)vector : 100, energy->params[p].name);
            char *full = loss_keep(l, hg_format("%s.%s", energy->name, name));
            loss_array *array = full ? loss_add(l, is_shared(l, name) ? full : name) : NULL;
            if (!array) return HG_MEMORY;
            array->full = full;
            array->unit = energy->params[p].unit;
            array->term = t;
            array->param = p;
            array->count = vector ? 3 : 1;
            array->rank = vector ? 1 : 0;
            array->shape[0] = 3;
            snprintf(array->axes, sizeof array->axes, "%s", vector ? "3" : "");
            array->values = hg_alloc(3, sizeof(double));
            if (!array->values) return HG_MEMORY;
            memcpy(array->values, &l->params[t][p], (size_t)array->count * sizeof(double));
            if (vector) p += 2;
        }
    }
    return HG_OK;
}

/* ---- settings ----------------------------------------------------------------------------------------------- */

/* "2 N/m", or "0,-9.81,0", "0,-981,0 cm/s^2", "[0, -9.81, 0]": a unit behind the last number is that of all. */
static hg_status parse_numbers(const char *key, const char *text, const char *unit, int n, double *values)
{
    const bool dimensionless = !unit || strcmp(unit, "1") == 0;
    if (n == 1) {
        if (hg_unit_parse(text, unit ? unit : "1", values) == HG_OK) return HG_OK;
        char *why = hg_strdup(hg_message());
        const hg_status status = hg_fail(HG_INVALID, "%s: %s%s%s", key, why ? why : "it is not a number",
                                         dimensionless ? "" : "; a bare number is in ", dimensionless ? "" : unit);
        hg_free(why);
        return status;
    }
    const char *last = strrchr(text, ','), *behind = NULL;
    if (last) {
        char *end;
        strtod(last + 1, &end);
        behind = end + strspn(end, " )]");
    }
    const char *at = text + strspn(text, " ([");
    for (int i = 0; i < n; i++) {
        char *end, one[64];
        const double number = strtod(at, &end);
        const bool has_unit = behind && *behind;
        snprintf(one, sizeof one, "%.17g%s%.40s", number, has_unit ? " " : "", has_unit ? behind : "");
        const char *next = end + strspn(end, " ");
        if (end == at || (i + 1 < n ? *next != ',' : next < last || (last && strchr(next, ','))) ||
            hg_unit_parse(one, unit ? unit : "1", &values[i]) != HG_OK)
            return hg_fail(HG_INVALID, "%s: \"%s\" is not %d numbers like 0,-9.81,0%s%s", key, text, n,
                           dimensionless ? "" : " in ", dimensionless ? "" : unit);
        at = next + 1;
    }
    return HG_OK;
}

static hg_status unknown_setting(loss *l, const char *key)
{
    const char *names[LOSS_ARRAYS + LOSS_TERMS * HG_ENERGY_OPTIONS] = { NULL };
    int n = 0;
    hg_text all = { 0 };
    for (int i = 0; i < l->n_arrays; i++)
        if (l->array[i].term >= 0 || strcmp(l->array[i].name, "mass") == 0 || strcmp(l->array[i].name, "dt") == 0)
            names[n++] = l->array[i].name;
    for (int t = 0; t < l->n_terms; t++)
        for (int o = 0; o < HG_ENERGY_OPTIONS && l->term[t].energy->options[o].name; o++)
            names[n++] = l->term[t].energy->options[o].name;
    for (int i = 0; i < n; i++) hg_text_add(&all, "%s%s", i ? ", " : "", names[i]);
    const char *near = hg_nearest_of(key, names, n);
    const hg_status status =
        hg_fail(HG_INVALID, "%s%s has no parameter or option \"%s\"%s%s%s it has %s", l->term[0].energy->name,
                l->n_terms > 1 ? "+..." : "", key, near ? "; did you mean \"" : "", near ? near : "",
                near ? "\"?" : ";", n && all.data ? all.data : "none");
    hg_text_free(&all);
    return status;
}

/* True where `choice` is one of "a|b|c". */
static bool is_choice(const char *choices, const char *choice)
{
    const size_t length = strlen(choice);
    for (const char *at = choices; at; at = strchr(at, '|') ? strchr(at, '|') + 1 : NULL)
        if (length && strncmp(at, choice, length) == 0 && (at[length] == '|' || !at[length])) return true;
    return false;
}

static hg_status set_option(loss *l, const char *key, const char *value, bool *found)
{
    *found = false;
    for (int t = 0; t < l->n_terms; t++) {
        const hg_energy *energy = l->term[t].energy;
        const size_t length = strlen(energy->name);
        const char *name = strncmp(key, energy->name, length) == 0 && key[length] == '.' ? key + length + 1 : key;
        for (int o = 0; o < HG_ENERGY_OPTIONS && energy->options[o].name; o++) {
            if (strcmp(energy->options[o].name, name) != 0) continue;
            if (!is_choice(energy->options[o].choices, value))
                return hg_fail(HG_INVALID, "%s: \"%s\" is not a choice of %s; there are %s", key, value, energy->name,
                               energy->options[o].choices);
            char *kept = loss_keep(l, hg_strdup(value));
            if (!kept) return HG_MEMORY;
            l->options[t][o] = kept;
            *found = true;
        }
    }
    return HG_OK;
}

static hg_status set_one(loss *l, const char *key, const char *value)
{
    bool found;
    HG_TRY(set_option(l, key, value, &found));
    if (found) return HG_OK;
    loss_array *array = loss_find(l, key);
    if (array) {
        HG_TRY(parse_numbers(key, value, array->unit, (int)array->count, array->values));
        array->set = true;
        if (array->term >= 0)
            memcpy(&l->params[array->term][array->param], array->values, (size_t)array->count * sizeof(double));
        return HG_OK;
    }
    for (int i = 0; i < l->n_arrays; i++) { /* a bare name that two energies have */
        const char *dot = l->array[i].full ? strchr(l->array[i].full, '.') : NULL;
        if (dot && strcmp(dot + 1, key) == 0)
            return hg_fail(HG_INVALID, "\"%s\": more than one energy has it; write %s", key, l->array[i].full);
    }
    return unknown_setting(l, key);
}

/* ---- what the formulas read ---------------------------------------------------------------------------------- */

/* Takes the name over. */
static hg_status remember(char **names, int *widths, int *n, char **name, int width)
{
    for (int i = 0; i < *n; i++)
        if (strcmp(names[i], *name) == 0) return HG_OK;
    if (*n == LOSS_NAMES) return hg_fail(HG_INVALID, "loss: the energies read more than %d named arrays", LOSS_NAMES);
    if (widths) widths[*n] = width;
    names[(*n)++] = *name;
    *name = NULL;
    return HG_OK;
}

static hg_status ask(loss *l, int t, hg_scalar (*formula)(void), uint32_t allowed, bool root)
{
    if (!formula) return HG_OK;
    hg_trace_scope scope;
    hg_formula_names names = { 0 };
    hg_term_scope(&scope, &l->term[t], t, allowed);
    if (root) scope.window = 2;
    scope.posed_given = hg_h5_has(l->file, "posed"); /* else it is made of rest and the root frames */
    hg_status status = hg_formula_reads(formula, &scope, &names);
    l->reads.kinds |= names.kinds;
    for (int i = 0; status == HG_OK && i < names.n_attributes; i++)
        status = remember(l->reads.attribute, NULL, &l->reads.n_attributes, &names.attributes[i], 1);
    for (int i = 0; status == HG_OK && i < names.n_frames; i++)
        status = remember(l->reads.frame, l->reads.width, &l->reads.n_frame, &names.frames[i], names.frame_width[i]);
    hg_formula_names_free(&names);
    return status;
}

static hg_status ask_all(loss *l)
{
    for (int t = 0; t < l->n_terms; t++) {
        const hg_energy *energy = l->term[t].energy;
        const hg_site_kind site = energy->site.kind;
        const uint32_t allowed = site == HG_SITE_WINDOW  ? HG_ALLOW_WINDOW
                                 : site == HG_SITE_PAIRS ? HG_ALLOW_PAIRS
                                                         : HG_ALLOW_FIELD;
        HG_TRY(ask(l, t, energy->trace, allowed, false));
        HG_TRY(ask(l, t, energy->root, HG_ALLOW_WINDOW & ~HG_ALLOW(HG_INPUT_CARRY), true));
        HG_TRY(ask(l, t, energy->kernel, HG_ALLOW_FIELD_KERNEL, false));
        l->reads.pairs |= site == HG_SITE_PAIRS;
        l->reads.field |= site == HG_SITE_FIELD;
        l->reads.contact |= energy->contact;
    }
    if (l->reads.field) l->reads.kinds |= HG_ALLOW(HG_INPUT_MASS); /* what a neighbour counts */
    return HG_OK;
}

static hg_status add_scalar(loss *l, const char *name, const char *unit, double value)
{
    loss_array *array = loss_add(l, name);
    if (!array) return HG_MEMORY;
    array->unit = unit;
    array->count = 1;
    array->values = hg_alloc(1, sizeof(double));
    if (!array->values) return HG_MEMORY;
    array->values[0] = value;
    return HG_OK;
}

hg_status loss_read_terms(loss *l, const char *energies, int n_set, const char *const *set)
{
    HG_TRY(read_energies(l, energies));
    HG_TRY(add_params(l));
    for (int pass = 0; pass < 2; pass++) { /* options first: they decide what the formulas read */
        for (int i = 0; i < n_set; i++) {
            char *key = hg_strdup(set[i]), *value = key ? strchr(key, '=') : NULL;
            hg_status status = key ? HG_OK : HG_MEMORY;
            if (key && !value)
                status = hg_fail(HG_INVALID, "--set %s: expected key=value, like stiffness=2 or strain=smooth", key);
            bool found = false;
            if (value) *value++ = 0;
            if (status == HG_OK && pass == 0) status = set_option(l, key, value, &found);
            if (status == HG_OK && pass == 1) status = set_one(l, key, value);
            hg_free(key);
            HG_TRY(status);
        }
        if (pass == 1) break;
        HG_TRY(ask_all(l));
        if (l->reads.kinds & HG_ALLOW(HG_INPUT_MASS)) HG_TRY(add_scalar(l, "mass", "kg", 1));
        if (l->reads.kinds & HG_ALLOW(HG_INPUT_DT)) HG_TRY(add_scalar(l, "dt", "s", 1.0 / 30.0));
    }
    return HG_OK;
}
