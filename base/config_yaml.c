/* A YAML document against the declared keys. The walk goes only where the declaration goes, so that its depth and its
 * work are bounded by the declaration whatever the document (aliases that multiply, deep nesting) looks like. */
#include "base/config.h"

#include <string.h>
#include <yaml.h>

typedef struct {
    hg_config *config;
    yaml_document_t *document;
} reader;

static int line_of(const yaml_node_t *node) { return (int)node->start_mark.line + 1; }

static const char *text_of(const yaml_node_t *node) { return (const char *)node->data.scalar.value; }

static bool is_text(const yaml_node_t *node)
{
    return node != NULL && node->type == YAML_SCALAR_NODE && strlen(text_of(node)) == node->data.scalar.length;
}

/* Nothing written, or null. */
static bool is_empty(const yaml_node_t *node)
{
    if (!is_text(node) || node->data.scalar.style != YAML_PLAIN_SCALAR_STYLE) return false;
    const char *text = text_of(node);
    return text[0] == '\0' || strcmp(text, "~") == 0 || strcmp(text, "null") == 0;
}

static const char *type_text(const hg_config_row *row)
{
    switch (row->type) {
    case HG_NUMBER:
        return "a number";
    case HG_INTEGER:
        return "an integer";
    case HG_FLAG:
        return "true or false";
    case HG_TEXT:
        return "a text";
    case HG_CHOICE:
        return "a choice";
    case HG_NUMBERS:
        return "a list of numbers";
    case HG_TEXTS:
        return "a list of texts";
    case HG_SECTION:
        break;
    }
    return "a section";
}

static hg_status read_value(reader *in, config_entry *entry, const yaml_node_t *value, int line)
{
    const char *name = in->config->name, *key = entry->row.key;
    hg_status status = HG_OK;
    if (value->type == YAML_MAPPING_NODE)
        return hg_fail(HG_INVALID, "%s:%d: \"%s\" takes %s, not a section", name, line, key, type_text(&entry->row));
    if (value->type == YAML_SCALAR_NODE) {
        if (!is_text(value)) return hg_fail(HG_INVALID, "%s:%d: \"%s\" holds a zero byte", name, line, key);
        const char *text = is_empty(value) ? "" : text_of(value);
        bool list = entry->row.type == HG_NUMBERS || entry->row.type == HG_TEXTS;
        bool wants = entry->row.type != HG_TEXT && !list;
        if (text[0] == '\0' && wants)
            return hg_fail(HG_INVALID, "%s:%d: \"%s\" has no value, %s is needed", name, line, key,
                           type_text(&entry->row));
        status = config_assign(entry, text[0] == '\0' && list ? 0 : 1, &text, line);
    } else {
        size_t n = (size_t)(value->data.sequence.items.top - value->data.sequence.items.start);
        const char **items = hg_alloc(n, sizeof *items);
        if (items == NULL) return HG_MEMORY;
        for (size_t i = 0; i < n && status == HG_OK; i++) {
            yaml_node_t *item = yaml_document_get_node(in->document, value->data.sequence.items.start[i]);
            if (!is_text(item))
                status = hg_fail(HG_INVALID, "%s:%d: \"%s\": item %zu is no plain value", name,
                                 item == NULL ? line : line_of(item), key, i + 1);
            else
                items[i] = text_of(item);
        }
        if (status != HG_OK) {
            hg_free(items);
            return status;
        }
        status = config_assign(entry, (int)n, items, line);
        hg_free(items);
    }
    return status == HG_OK ? HG_OK : hg_fail(status, "%s:%d: \"%s\": %s", name, line, key, hg_message());
}

static hg_status read_section(reader *in, const yaml_node_t *map, const char *path);

static hg_status read_pair(reader *in, const yaml_node_t *key, const yaml_node_t *value, const char *path)
{
    hg_config *config = in->config;
    if (key == NULL || value == NULL || !is_text(key))
        return hg_fail(HG_INVALID, "%s:%d: a key has to be a plain name", config->name, key == NULL ? 0 : line_of(key));
    int line = line_of(key);
    const char *leaf = text_of(key);
    char *full = path[0] == '\0' ? hg_strdup(leaf) : hg_format("%s.%s", path, leaf);
    if (full == NULL) return HG_MEMORY;
    hg_status status = HG_OK;
    config_entry *entry = strchr(leaf, '.') != NULL ? NULL : config_find(config, full);
    bool section =
        strchr(leaf, '.') == NULL && (entry == NULL ? config_is_section(config, full) : entry->row.type == HG_SECTION);
    if (section) {
        int before = config_section_line(config, full);
        if (before > 0)
            status = hg_fail(HG_INVALID, "%s:%d: section \"%s\" was already given in line %d", config->name, line, full,
                             before);
        else if (value->type != YAML_MAPPING_NODE && !is_empty(value))
            status = hg_fail(HG_INVALID, "%s:%d: \"%s\" is a section, its keys stand indented below it", config->name,
                             line, full);
        else
            status = config_add_section(config, full, line);
        if (status == HG_OK && value->type == YAML_MAPPING_NODE) status = read_section(in, value, full);
    } else if (entry != NULL) {
        if (entry->given)
            status = hg_fail(HG_INVALID, "%s:%d: \"%s\" was already given in line %d", config->name, line, full,
                             entry->line);
        else
            status = read_value(in, entry, value, line);
    } else {
        char *hint = config_suggestion(config, path, leaf);
        status = hg_fail(HG_INVALID, "%s:%d: unknown key \"%s\"%s", config->name, line, full, hint == NULL ? "" : hint);
        hg_free(hint);
    }
    hg_free(full);
    return status;
}

static hg_status read_section(reader *in, const yaml_node_t *map, const char *path)
{
    for (const yaml_node_pair_t *pair = map->data.mapping.pairs.start; pair < map->data.mapping.pairs.top; pair++)
        HG_TRY(read_pair(in, yaml_document_get_node(in->document, pair->key),
                         yaml_document_get_node(in->document, pair->value), path));
    return HG_OK;
}

static hg_status refuse(const char *name, const yaml_parser_t *parser)
{
    const char *problem = parser->problem == NULL ? "no reason given" : parser->problem;
    if (parser->error == YAML_MEMORY_ERROR) return hg_fail(HG_MEMORY, "%s: the system has no memory left", name);
    if (parser->error == YAML_READER_ERROR)
        return hg_fail(HG_FORMAT, "%s: byte %zu is not valid text (%s)", name, parser->problem_offset, problem);
    if (parser->context == NULL)
        return hg_fail(HG_FORMAT, "%s:%zu: not valid YAML (%s)", name, parser->problem_mark.line + 1, problem);
    return hg_fail(HG_FORMAT, "%s:%zu: not valid YAML (%s, %s that begins in line %zu)", name,
                   parser->problem_mark.line + 1, problem, parser->context, parser->context_mark.line + 1);
}

hg_status config_read(hg_config *config, const char *text, size_t size)
{
    yaml_parser_t parser;
    if (!yaml_parser_initialize(&parser)) return hg_fail(HG_MEMORY, "%s: the system has no memory left", config->name);
    yaml_parser_set_input_string(&parser, (const unsigned char *)text, size);
    yaml_parser_set_encoding(&parser, YAML_UTF8_ENCODING);
    yaml_document_t document, second;
    if (!yaml_parser_load(&parser, &document)) {
        hg_status status = refuse(config->name, &parser);
        yaml_parser_delete(&parser);
        return status;
    }
    reader in = { config, &document };
    const yaml_node_t *root = yaml_document_get_root_node(&document);
    hg_status status = HG_OK;
    if (root != NULL && root->type == YAML_MAPPING_NODE)
        status = read_section(&in, root, "");
    else if (root != NULL && !is_empty(root))
        status = hg_fail(HG_FORMAT, "%s:%d: a config is a list of \"key: value\" lines", config->name, line_of(root));
    if (status == HG_OK && root != NULL) {
        if (!yaml_parser_load(&parser, &second))
            status = refuse(config->name, &parser);
        else {
            const yaml_node_t *more = yaml_document_get_root_node(&second);
            if (more != NULL)
                status = hg_fail(HG_FORMAT, "%s:%d: a second document begins here, one is needed", config->name,
                                 line_of(more));
            yaml_document_delete(&second);
        }
    }
    yaml_document_delete(&document);
    yaml_parser_delete(&parser);
    return status;
}
