/* A config as YAML with every value in it, defaults too: what a run folder keeps. Loading it gives the same values. */
#include "base/config.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The shortest of the usual forms that reads back as the same number. */
static void add_number(hg_text *to, double value, const char *unit)
{
    char digits[40];
    for (int precision = 15; precision <= 17; precision++) {
        snprintf(digits, sizeof digits, "%.*g", precision, value);
        if (strtod(digits, NULL) == value) break;
    }
    bool bare = unit == NULL || strcmp(unit, "1") == 0;
    hg_text_add(to, "%s%s%s", digits, bare ? "" : " ", bare ? "" : unit);
}

static void add_text(hg_text *to, const char *text)
{
    bool plain = text[0] != '\0' &&
                 strspn(text, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_./-") == strlen(text) &&
                 text[0] != '-' && text[0] != '.' && strcmp(text, "null") != 0;
    if (plain) {
        hg_text_add(to, "%s", text);
        return;
    }
    hg_text_add(to, "\"");
    for (const char *at = text; *at != '\0'; at++) {
        if (*at == '"' || *at == '\\')
            hg_text_add(to, "\\%c", *at);
        else if ((unsigned char)*at < 32 || *at == 127)
            hg_text_add(to, "\\x%02x", (unsigned)(unsigned char)*at);
        else
            hg_text_add(to, "%c", *at);
    }
    hg_text_add(to, "\"");
}

static void add_value(hg_text *to, const config_entry *entry)
{
    switch (entry->row.type) {
    case HG_NUMBER:
        add_number(to, entry->number, entry->row.unit);
        break;
    case HG_INTEGER:
        hg_text_add(to, "%lld", (long long)entry->integer);
        break;
    case HG_FLAG:
        hg_text_add(to, "%s", entry->integer != 0 ? "true" : "false");
        break;
    case HG_NUMBERS:
    case HG_TEXTS:
        hg_text_add(to, "[");
        for (int i = 0; i < entry->count; i++) {
            if (i > 0) hg_text_add(to, ", ");
            if (entry->row.type == HG_NUMBERS)
                add_number(to, entry->numbers[i], entry->row.unit);
            else
                add_text(to, entry->texts[i]);
        }
        hg_text_add(to, "]");
        break;
    default:
        add_text(to, entry->text == NULL ? "" : entry->text);
        break;
    }
}

/* The keys of one section in declared order; a section inside it comes where its first key is declared. */
static void add_section(hg_text *to, const hg_config *config, const char *path, int depth)
{
    size_t skip = path[0] == '\0' ? 0 : strlen(path) + 1;
    for (int i = 0; i < config->count; i++) {
        const config_entry *entry = &config->entries[i];
        const char *key = entry->row.key;
        if (skip > 0 && (strncmp(key, path, skip - 1) != 0 || key[skip - 1] != '.')) continue;
        const char *dot = strchr(key + skip, '.');
        bool leaf = dot == NULL && entry->row.type != HG_SECTION;
        if (leaf) {
            if (entry->row.value == NULL && !entry->given) continue;
            hg_text_add(to, "%*s%s: ", depth * 2, "", key + skip);
            add_value(to, entry);
            hg_text_add(to, "\n");
            continue;
        }
        size_t length = dot == NULL ? strlen(key) : (size_t)(dot - key);
        bool before = false, below = false;
        for (int j = 0; j < config->count; j++) {
            const char *other = config->entries[j].row.key;
            bool within = strncmp(other, key, length) == 0 && (other[length] == '.' || other[length] == '\0');
            before |= within && j < i;
            below |= within && other[length] == '.' && config_is_active(config, other);
        }
        if (before) continue;
        char *section = hg_format("%.*s", (int)length, key);
        if (section == NULL) {
            to->failed = true;
            return;
        }
        bool declared = config_find(config, section) != NULL, given = config_section_line(config, section) >= 0;
        if (below) {
            size_t start = to->size;
            hg_text_add(to, "%*s%s:\n", depth * 2, "", section + skip);
            size_t filled = to->size;
            add_section(to, config, section, depth + 1);
            if (!to->failed && to->size == filled) { /* nothing in it has a value */
                to->size = start;
                to->data[start] = '\0';
                if (declared && given) hg_text_add(to, "%*s%s: {}\n", depth * 2, "", section + skip);
            }
        } else if (declared && given) {
            hg_text_add(to, "%*s%s: {}\n", depth * 2, "", section + skip);
        }
        hg_free(section);
    }
}

char *hg_config_echo(const hg_config *config)
{
    hg_text text = { 0 };
    hg_text_add(&text, "%s", "");
    add_section(&text, config, "", 0);
    if (text.failed) {
        hg_text_free(&text);
        hg_fail(HG_MEMORY, "%s: no memory to write the config", config->name);
        return NULL;
    }
    return text.data;
}
