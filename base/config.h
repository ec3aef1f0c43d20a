/* Shared by config.c (values), config_yaml.c (reading a document) and config_echo.c (writing one). */
#ifndef HG_BASE_CONFIG_H
#define HG_BASE_CONFIG_H

#include "base/base.h"

typedef struct {
    hg_config_row row; /* its strings are copies */
    bool given;
    int line;
    char *text; /* as written; of lists: NULL */
    double number;
    int64_t integer;
    int count; /* of lists */
    double *numbers;
    char **texts;
} config_entry;

struct hg_config {
    char *name;
    config_entry *entries;
    int count;
    struct config_section {
        char *path;
        int line;
    } * sections; /* those that were written */
    int section_count, section_capacity;
};

config_entry *config_find(const hg_config *config, const char *key);
/* Gives an entry what was written: one item, or the items of a list. The message has no place yet: the caller adds it. */
hg_status config_assign(config_entry *entry, int n, const char *const *items, int line);
bool config_is_section(const hg_config *config, const char *path);
int config_section_line(const hg_config *config, const char *path); /* 0: not in the file, -1: not given */
hg_status config_add_section(hg_config *config, const char *path, int line);
/* False where a section on the way to the key is optional and was not given. */
bool config_is_active(const hg_config *config, const char *key);
/* "; did you mean \"learning_rate\"?" or what is known there; a new string. */
char *config_suggestion(const hg_config *config, const char *section, const char *key);
hg_status config_read(hg_config *config, const char *text, size_t size);

#endif
