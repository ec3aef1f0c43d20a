/* Configs: a table of typed values with their defaults, filled from a document and from overrides. */
#include "base/config.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

/* ---- entries ------------------------------------------------------------------------------------------------ */

config_entry *config_find(const hg_config *config, const char *key)
{
    for (int i = 0; i < config->count; i++)
        if (strcmp(config->entries[i].row.key, key) == 0) return &config->entries[i];
    return NULL;
}

static bool inside(const char *key, const char *section)
{
    size_t length = strlen(section);
    return length == 0 || (strncmp(key, section, length) == 0 && key[length] == '.');
}

bool config_is_section(const hg_config *config, const char *path)
{
    for (int i = 0; i < config->count; i++) {
        const hg_config_row *row = &config->entries[i].row;
        if (inside(row->key, path) || (row->type == HG_SECTION && strcmp(row->key, path) == 0)) return true;
    }
    return false;
}

int config_section_line(const hg_config *config, const char *path)
{
    for (int i = 0; i < config->section_count; i++)
        if (strcmp(config->sections[i].path, path) == 0) return config->sections[i].line;
    return -1;
}

hg_status config_add_section(hg_config *config, const char *path, int line)
{
    if (config_section_line(config, path) >= 0) return HG_OK;
    if (config->section_count == config->section_capacity) {
        int capacity = config->section_capacity == 0 ? 16 : config->section_capacity * 2;
        struct config_section *larger =
            hg_resize(config->sections, (size_t)config->section_count, (size_t)capacity, sizeof *larger);
        if (larger == NULL) return HG_MEMORY;
        config->sections = larger;
        config->section_capacity = capacity;
    }
    char *copy = hg_strdup(path);
    if (copy == NULL) return HG_MEMORY;
    config->sections[config->section_count++] = (struct config_section){ copy, line };
    return HG_OK;
}

bool config_is_active(const hg_config *config, const char *key)
{
    for (int i = 0; i < config->count; i++) {
        const hg_config_row *row = &config->entries[i].row;
        if (row->type == HG_SECTION && inside(key, row->key) && config_section_line(config, row->key) < 0) return false;
    }
    return true;
}

/* ---- what was meant ----------------------------------------------------------------------------------------- */

/* The names directly inside a section, each once; they are cut out of keys into `names`. */
static int children(const hg_config *config, const char *section, char (*names)[64], int max)
{
    size_t skip = section[0] == '\0' ? 0 : strlen(section) + 1;
    int count = 0;
    for (int i = 0; i < config->count && count < max; i++) {
        const char *key = config->entries[i].row.key;
        if (!inside(key, section)) continue;
        const char *child = key + skip, *dot = strchr(child, '.');
        snprintf(names[count], sizeof names[count], "%.*s", dot == NULL ? 63 : (int)(dot - child), child);
        bool known = false;
        for (int j = 0; j < count; j++) known |= strcmp(names[j], names[count]) == 0;
        if (!known) count++;
    }
    return count;
}

char *config_suggestion(const hg_config *config, const char *section, const char *key)
{
    enum { most = 128 };
    char names[most][64];
    const char *pointers[most];
    int count = children(config, section, names, most);
    for (int i = 0; i < count; i++) pointers[i] = names[i];
    const char *nearest = hg_nearest_of(key, pointers, count);
    if (nearest != NULL) return hg_format("; did you mean \"%s\"?", nearest);
    for (int i = 0; i < config->count; i++) { /* the right key in the wrong place */
        const char *path = config->entries[i].row.key, *dot = strrchr(path, '.');
        if (strcmp(dot == NULL ? path : dot + 1, key) == 0) return hg_format("; did you mean \"%s\"?", path);
    }
    hg_text known = { 0 };
    for (int i = 0; i < count && i < 16; i++) hg_text_add(&known, "%s%s", i == 0 ? "; known here: " : ", ", names[i]);
    if (count > 16) hg_text_add(&known, ", ...");
    if (known.data == NULL) hg_text_add(&known, "; nothing is known here");
    return known.data;
}

/* ---- values ------------------------------------------------------------------------------------------------- */

static hg_status check_range(const hg_config_row *row, double value, const char *written)
{
    if (row->min == 0.0 && row->max == 0.0) return HG_OK;
    if (value >= row->min && value <= row->max) return HG_OK;
    const char *unit = row->unit == NULL || strcmp(row->unit, "1") == 0 ? "" : row->unit,
               *space = unit[0] == '\0' ? "" : " ";
    if (isinf(row->max))
        return hg_fail(HG_INVALID, "\"%s\" is too small, at least %g%s%s is needed", written, row->min, space, unit);
    if (isinf(row->min))
        return hg_fail(HG_INVALID, "\"%s\" is too large, at most %g%s%s is possible", written, row->max, space, unit);
    return hg_fail(HG_INVALID, "\"%s\" is out of range, between %g and %g%s%s is needed", written, row->min, row->max,
                   space, unit);
}

static hg_status to_number(const hg_config_row *row, const char *written, double *number)
{
    if (written[0] == '\0') return hg_fail(HG_INVALID, "has no value, a number is needed");
    HG_TRY(hg_unit_parse(written, row->unit, number));
    return check_range(row, *number, written);
}

static hg_status to_integer(const hg_config_row *row, const char *written, int64_t *integer)
{
    char *end;
    errno = 0;
    long long whole = strtoll(written, &end, 10);
    if (end == written || *end != '\0' || errno != 0) { /* 1e6 is an integer too */
        double number = strtod(written, &end);
        if (end == written || *end != '\0' || number != floor(number) || fabs(number) > 0x1p53)
            return hg_fail(HG_INVALID, "\"%s\" is not an integer", written);
        whole = (long long)number;
    }
    *integer = whole;
    return check_range(row, (double)whole, written);
}

static hg_status to_flag(const char *written, int64_t *flag)
{
    static const char *const names[] = { "false", "true", "no", "yes", "off", "on" };
    for (int i = 0; i < 6; i++)
        if (strcasecmp(written, names[i]) == 0) return *flag = i % 2, HG_OK;
    return hg_fail(HG_INVALID, "\"%s\" is not true or false", written);
}

static hg_status check_choice(const hg_config_row *row, const char *written)
{
    const char *choices = row->choices == NULL ? "" : row->choices;
    char *copy = hg_strdup(choices), *state = NULL;
    const char *names[64];
    int count = 0;
    if (copy == NULL) return HG_MEMORY;
    for (char *one = strtok_r(copy, "|", &state); one != NULL && count < 64; one = strtok_r(NULL, "|", &state))
        names[count++] = one;
    bool known = false;
    for (int i = 0; i < count; i++) known |= strcmp(names[i], written) == 0;
    hg_status status = HG_OK;
    if (!known) {
        hg_text list = { 0 };
        for (int i = 0; i < count; i++)
            hg_text_add(&list, "%s%s", i == 0 ? "" : i == count - 1 ? " or " : ", ", names[i]);
        const char *nearest = hg_nearest_of(written, names, count);
        status = hg_fail(HG_INVALID, "\"%s\" is not one of %s%s%s%s", written, list.data == NULL ? "none" : list.data,
                         nearest != NULL ? "; did you mean \"" : "", nearest != NULL ? nearest : "",
                         nearest != NULL ? "\"?" : "");
        hg_text_free(&list);
    }
    hg_free(copy);
    return status;
}

static void clear(config_entry *entry)
{
    hg_free(entry->text);
    hg_free(entry->numbers);
    hg_texts_free(entry->texts, entry->count);
    entry->text = NULL, entry->numbers = NULL, entry->texts = NULL;
    entry->count = 0;
}

static hg_status convert(config_entry *entry, int n, const char *const *items)
{
    const hg_config_row *row = &entry->row;
    if (row->type == HG_NUMBERS) {
        entry->numbers = hg_alloc((size_t)n, sizeof *entry->numbers);
        if (entry->numbers == NULL) return HG_MEMORY;
        for (int i = 0; i < n; i++) HG_TRY(to_number(row, items[i], &entry->numbers[i]));
        entry->count = n;
        return HG_OK;
    }
    if (row->type == HG_TEXTS) {
        entry->texts = hg_alloc((size_t)n, sizeof *entry->texts);
        if (entry->texts == NULL) return HG_MEMORY;
        for (entry->count = 0; entry->count < n; entry->count++)
            if ((entry->texts[entry->count] = hg_strdup(items[entry->count])) == NULL) return HG_MEMORY;
        return HG_OK;
    }
    const char *item = items[0];
    entry->text = hg_strdup(item);
    if (entry->text == NULL) return HG_MEMORY;
    switch (row->type) {
    case HG_NUMBER:
        return to_number(row, item, &entry->number);
    case HG_INTEGER:
        HG_TRY(to_integer(row, item, &entry->integer));
        return entry->number = (double)entry->integer, HG_OK;
    case HG_FLAG:
        return to_flag(item, &entry->integer);
    case HG_CHOICE:
        return check_choice(row, item);
    default:
        return HG_OK;
    }
}

hg_status config_assign(config_entry *entry, int n, const char *const *items, int line)
{
    config_entry fresh = { .row = entry->row, .given = true, .line = line };
    bool list = entry->row.type == HG_NUMBERS || entry->row.type == HG_TEXTS;
    if (!list && n != 1) return hg_fail(HG_INVALID, "takes one value, not a list");
    hg_status status = convert(&fresh, n, items);
    if (status != HG_OK) {
        clear(&fresh);
        return status;
    }
    clear(entry);
    *entry = fresh;
    return HG_OK;
}

/* A list written in one line, "[a, b]" or "a, b". */
static hg_status assign_line(config_entry *entry, const char *value, int line)
{
    if (entry->row.type != HG_NUMBERS && entry->row.type != HG_TEXTS) return config_assign(entry, 1, &value, line);
    size_t length = strlen(value);
    bool bracketed = length >= 2 && value[0] == '[' && value[length - 1] == ']';
    char *copy = hg_strdup(bracketed ? value + 1 : value);
    const char **items = hg_alloc(length + 1, sizeof *items);
    hg_status status = copy == NULL || items == NULL ? HG_MEMORY : HG_OK;
    if (status == HG_OK) {
        if (bracketed) copy[length - 2] = '\0';
        int n = 0;
        char *state = NULL;
        for (char *one = strtok_r(copy, ",", &state); one != NULL; one = strtok_r(NULL, ",", &state)) {
            while (*one == ' ') one++;
            size_t end = strlen(one);
            while (end > 0 && one[end - 1] == ' ') one[--end] = '\0';
            if (end >= 2 && (one[0] == '"' || one[0] == '\'') && one[end - 1] == one[0]) one[end - 1] = '\0', one++;
            if (end > 0) items[n++] = one;
        }
        status = config_assign(entry, n, items, line);
    }
    hg_free(items);
    hg_free(copy);
    return status;
}

/* ---- life --------------------------------------------------------------------------------------------------- */

static bool copy_row(hg_config_row *to, const hg_config_row *from)
{
    *to = *from;
    to->key = hg_strdup(from->key);
    to->value = from->value == NULL ? NULL : hg_strdup(from->value);
    to->unit = from->unit == NULL ? NULL : hg_strdup(from->unit);
    to->choices = from->choices == NULL ? NULL : hg_strdup(from->choices);
    to->help = from->help == NULL ? NULL : hg_strdup(from->help);
    return to->key != NULL && (to->value != NULL) == (from->value != NULL) &&
           (to->unit != NULL) == (from->unit != NULL) && (to->choices != NULL) == (from->choices != NULL) &&
           (to->help != NULL) == (from->help != NULL);
}

void hg_config_destroy(hg_config *config)
{
    if (config == NULL) return;
    for (int i = 0; i < config->count; i++) {
        config_entry *entry = &config->entries[i];
        clear(entry);
        hg_free((void *)entry->row.key);
        hg_free((void *)entry->row.value);
        hg_free((void *)entry->row.unit);
        hg_free((void *)entry->row.choices);
        hg_free((void *)entry->row.help);
    }
    for (int i = 0; i < config->section_count; i++) hg_free(config->sections[i].path);
    hg_free(config->sections);
    hg_free(config->entries);
    hg_free(config->name);
    hg_free(config);
}

static hg_status declare(hg_config *config, const hg_config_row *rows, int n)
{
    config->entries = hg_alloc((size_t)n, sizeof *config->entries);
    if (config->entries == NULL) return HG_MEMORY;
    for (int i = 0; i < n; i++) {
        if (config_find(config, rows[i].key) != NULL)
            return hg_fail(HG_INVALID, "config key \"%s\" is declared twice", rows[i].key);
        config_entry *entry = &config->entries[config->count++];
        if (!copy_row(&entry->row, &rows[i])) {
            if (entry->row.key == NULL) config->count--;
            return HG_MEMORY;
        }
        if (rows[i].value == NULL || rows[i].type == HG_SECTION) continue;
        hg_status status =
            rows[i].value[0] == '\0' && rows[i].type == HG_NUMBERS ? HG_OK : assign_line(entry, rows[i].value, 0);
        if (status != HG_OK)
            return hg_fail(status, "config key \"%s\" has a default that it refuses: %s", rows[i].key, hg_message());
        entry->given = false;
    }
    return HG_OK;
}

hg_status hg_config_check(const hg_config *config)
{
    for (int i = 0; i < config->count; i++) {
        const config_entry *entry = &config->entries[i];
        if (entry->given || entry->row.value != NULL || entry->row.type == HG_SECTION ||
            !config_is_active(config, entry->row.key))
            continue;
        const char *help = entry->row.help;
        return hg_fail(HG_INVALID, "%s: \"%s\" is missing%s%s%s", config->name, entry->row.key,
                       help != NULL ? " (" : "", help != NULL ? help : "", help != NULL ? ")" : "");
    }
    return HG_OK;
}

/* "training.steps=100" */
static hg_status override(hg_config *config, const char *text)
{
    const char *equals = strchr(text, '=');
    if (equals == NULL || equals == text)
        return hg_fail(HG_INVALID, "override \"%s\": KEY=VALUE is needed, such as training.steps=100", text);
    char *key = hg_format("%.*s", (int)(equals - text), text);
    hg_status status = key == NULL ? HG_MEMORY : hg_config_set(config, key, equals + 1);
    hg_free(key);
    return status;
}

static hg_status build(hg_config **config, const char *text, const char *name, const hg_config_row *rows, int n,
                       const char *const *overrides, int n_overrides)
{
    *config = NULL;
    hg_config *made = hg_alloc(1, sizeof *made);
    if (made == NULL) return HG_MEMORY;
    made->name = hg_strdup(name);
    hg_status status = made->name == NULL ? HG_MEMORY : declare(made, rows, n);
    if (status == HG_OK) status = config_read(made, text, strlen(text));
    for (int i = 0; i < n_overrides && status == HG_OK; i++) status = override(made, overrides[i]);
    if (status == HG_OK) status = hg_config_check(made);
    if (status != HG_OK)
        hg_config_destroy(made);
    else
        *config = made;
    return status;
}

hg_status hg_config_parse(hg_config **config, const char *text, const char *name, const hg_config_row *rows, int n)
{
    return build(config, text, name, rows, n, NULL, 0);
}

hg_status hg_config_load(hg_config **config, const char *path, const hg_config_row *rows, int n)
{
    return hg_config_load_with(config, path, rows, n, NULL, 0);
}

hg_status hg_config_load_with(hg_config **config, const char *path, const hg_config_row *rows, int n,
                              const char *const *overrides, int n_overrides)
{
    void *bytes;
    size_t size;
    *config = NULL;
    HG_TRY(hg_file_read(path, &bytes, &size));
    hg_status status = HG_OK;
    if (size > 1u << 20)
        status = hg_fail(HG_FORMAT, "%s: %zu bytes are too many for a config", path, size);
    else if (memchr(bytes, 0, size) != NULL)
        status = hg_fail(HG_FORMAT, "%s: is a binary file, a YAML text is needed", path);
    else
        status = build(config, bytes, path, rows, n, overrides, n_overrides);
    hg_free(bytes);
    return status;
}

hg_status hg_config_set(hg_config *config, const char *key, const char *value)
{
    config_entry *entry = config_find(config, key);
    bool section = entry == NULL ? config_is_section(config, key) : entry->row.type == HG_SECTION;
    if (section && (value[0] == '\0' || strcmp(value, "{}") == 0)) return config_add_section(config, key, 0);
    if (section)
        return hg_fail(HG_INVALID, "override %s=%s: \"%s\" is a section, name a key inside it", key, value, key);
    if (entry == NULL) {
        char *parent = hg_strdup(key);
        if (parent == NULL) return HG_MEMORY;
        char *dot = strrchr(parent, '.');
        const char *leaf = dot == NULL ? key : key + (dot - parent) + 1;
        if (dot != NULL) *dot = '\0';
        char *hint = config_suggestion(config, dot == NULL ? "" : parent, leaf);
        hg_status status =
            hg_fail(HG_INVALID, "override %s=%s: unknown key \"%s\"%s", key, value, key, hint == NULL ? "" : hint);
        hg_free(hint);
        hg_free(parent);
        return status;
    }
    hg_status status = assign_line(entry, value, 0);
    if (status != HG_OK) return hg_fail(status, "override %s=%s: %s", key, value, hg_message());
    char *path = hg_strdup(key);
    if (path == NULL) return HG_MEMORY;
    for (char *dot = strrchr(path, '.'); dot != NULL && status == HG_OK; dot = strrchr(path, '.')) {
        *dot = '\0';
        status = config_add_section(config, path, 0);
    }
    hg_free(path);
    return status;
}

/* ---- reading values ----------------------------------------------------------------------------------------- */

bool hg_config_given(const hg_config *config, const char *key)
{
    const config_entry *entry = config_find(config, key);
    return (entry != NULL && entry->given) || config_section_line(config, key) >= 0;
}

double hg_config_number(const hg_config *config, const char *key)
{
    const config_entry *entry = config_find(config, key);
    return entry == NULL || (entry->row.type != HG_NUMBER && entry->row.type != HG_INTEGER) ? (double)NAN
                                                                                            : entry->number;
}

int64_t hg_config_integer(const hg_config *config, const char *key)
{
    const config_entry *entry = config_find(config, key);
    return entry == NULL ? 0 : entry->row.type == HG_NUMBER ? (int64_t)llround(entry->number) : entry->integer;
}

bool hg_config_flag(const hg_config *config, const char *key) { return hg_config_integer(config, key) != 0; }

const char *hg_config_text(const hg_config *config, const char *key)
{
    const config_entry *entry = config_find(config, key);
    return entry == NULL ? NULL : entry->text;
}

int hg_config_count(const hg_config *config, const char *key)
{
    const config_entry *entry = config_find(config, key);
    return entry == NULL ? 0 : entry->count;
}

double hg_config_number_at(const hg_config *config, const char *key, int i)
{
    const config_entry *entry = config_find(config, key);
    return entry == NULL || entry->numbers == NULL || i < 0 || i >= entry->count ? (double)NAN : entry->numbers[i];
}

const char *hg_config_text_at(const hg_config *config, const char *key, int i)
{
    const config_entry *entry = config_find(config, key);
    return entry == NULL || entry->texts == NULL || i < 0 || i >= entry->count ? NULL : entry->texts[i];
}

int hg_config_line(const hg_config *config, const char *key)
{
    const config_entry *entry = config_find(config, key);
    if (entry != NULL && entry->line > 0) return entry->line;
    int line = config_section_line(config, key);
    return line > 0 ? line : 0;
}

const char *hg_config_name(const hg_config *config) { return config->name; }

void hg_config_lines(hg_config *config, const hg_config *from)
{
    for (int i = 0; i < config->count; i++) {
        const config_entry *entry = config_find(from, config->entries[i].row.key);
        config->entries[i].line = entry != NULL ? entry->line : 0;
    }
    for (int i = 0; i < config->section_count; i++) {
        int line = config_section_line(from, config->sections[i].path);
        config->sections[i].line = line > 0 ? line : 0;
    }
}
