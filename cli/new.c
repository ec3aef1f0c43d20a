/* hairgrad new: a file to start from, that builds as it is. The texts are examples/new/, put in when the program is built. */
#include "cli/cli.h"

#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <unistd.h>

extern const char cli_new_energy[], cli_new_op[], cli_new_model[];

static const struct {
    const char *kind, *stands_for, *capitals, *text;
} templates[] = {
    { "energy", "my_energy", "MY_ENERGY", cli_new_energy },
    { "op", "my_op", "MY_OP", cli_new_op },
    { "model", "my_model", "MY_MODEL", cli_new_model },
};
enum { TEMPLATES = sizeof templates / sizeof *templates };

/* C's words, and what the short names of formulas mean, cannot be the name of a function there. */
static bool is_taken_word(const char *name)
{
    static const char *const words[] = {
        "auto",       "break",   "case",     "char",         "const",     "continue", "default",
        "do",         "double",  "else",     "enum",         "extern",    "float",    "for",
        "goto",       "if",      "inline",   "int",          "long",      "register", "restrict",
        "return",     "short",   "signed",   "sizeof",       "static",    "struct",   "switch",
        "typedef",    "union",   "unsigned", "void",         "volatile",  "while",    "main",
        "scalar",     "vec3",    "quat",     "add",          "mul",       "sub",      "divide",
        "neg",        "dot",     "cross",    "norm",         "normalize", "square",   "sqrt",
        "rsqrt",      "abs",     "exp",      "log",          "sin",       "cos",      "atan2",
        "min",        "max",     "clamp",    "less",         "select",    "detach",   "vector",
        "quaternion", "conj",    "qmul",     "rotate",       "transport", "tangent",  "rest_length",
        "x",          "rest",    "posed",    "predicted",    "previous",  "mass",     "attribute",
        "q",          "carry",   "keep",     "distance",     "field",     "param",    "param3",
        "dt",         "option",  "window",   "bool",         "true",      "false",    "strain",
        "kernel",     "samples", "tenth",    "architecture", "template",
    };
    for (size_t i = 0; i < sizeof words / sizeof *words; i++)
        if (strcmp(name, words[i]) == 0) return true;
    return false;
}

static hg_status check_name(const char *kind, const char *name)
{
    bool good = isalpha((unsigned char)name[0]) && strlen(name) <= 40;
    for (const char *at = name; *at != '\0'; at++) good &= isalnum((unsigned char)*at) || *at == '_';
    if (!good || strncmp(name, "hg_", 3) == 0 || is_taken_word(name))
        return hg_fail(HG_INVALID,
                       "\"%s\" cannot be the name of an %s: a name of C is needed that is not in use, like tip_rise",
                       name, kind);
    if (hg_find(kind, name) != NULL) return hg_fail(HG_INVALID, "there is %s \"%s\" already", kind, name);
    return HG_OK;
}

/* `from` becomes `to` wherever it stands. */
static void add_replaced(hg_text *text, const char *from_text, int which, const char *name, const char *capitals)
{
    const size_t length = strlen(templates[which].stands_for);
    for (const char *at = from_text; *at != '\0';) {
        if (strncmp(at, templates[which].stands_for, length) == 0) {
            hg_text_add(text, "%s", name);
            at += length;
        } else if (strncmp(at, templates[which].capitals, length) == 0) {
            hg_text_add(text, "%s", capitals);
            at += length;
        } else {
            const size_t plain = 1 + strcspn(at + 1, "mM");
            hg_text_add(text, "%.*s", (int)plain, at);
            at += plain;
        }
    }
}

/* Made only where there is nothing yet. */
static hg_status write_new(const char *path, const hg_text *text)
{
    const int file = open(path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (file < 0 && errno == EEXIST)
        return hg_fail(HG_INVALID, "%s: it is there already and stays as it is; -o FILE names another one", path);
    if (file < 0) return hg_fail(HG_IO, "%s: cannot be made (%s)", path, strerror(errno));
    const bool written = write(file, text->data, text->size) == (ssize_t)text->size;
    if (close(file) == 0 && written) return HG_OK;
    unlink(path);
    return hg_fail(HG_IO, "%s: cannot be written", path);
}

static int new_file(const hg_arguments *arguments)
{
    const char *kind = arguments->free[0], *name = arguments->free[1], *kinds[TEMPLATES];
    int which = 0;
    for (int i = 0; i < TEMPLATES; i++) kinds[i] = templates[i].kind;
    while (which < TEMPLATES && strcmp(kind, kinds[which]) != 0) which++;
    if (which == TEMPLATES) {
        const char *near = hg_nearest_of(kind, kinds, TEMPLATES);
        hg_fail(HG_INVALID, "new %s: an energy, an op or a model can be started%s%s%s", kind,
                near != NULL ? "; did you mean \"" : "", near != NULL ? near : "", near != NULL ? "\"?" : "");
        return cli_fail();
    }
    if (check_name(kind, name) != HG_OK) return cli_fail();
    char *path = cli_value(arguments, "output", NULL) != NULL ? hg_strdup(cli_value(arguments, "output", NULL))
                                                              : hg_format("%s.c", name);
    char *capitals = hg_strdup(name);
    hg_text text = { 0 };
    hg_status status = path != NULL && capitals != NULL ? HG_OK : HG_MEMORY;
    for (char *at = capitals; status == HG_OK && *at != '\0'; at++) *at = (char)toupper((unsigned char)*at);
    if (status == HG_OK) add_replaced(&text, templates[which].text, which, name, capitals);
    if (status == HG_OK && text.failed) status = HG_MEMORY;
    if (status == HG_OK) status = write_new(path, &text);
    if (status == HG_OK) printf("%s: builds as it is; the commands stand in its first comment\n", path);
    hg_text_free(&text);
    hg_free(capitals);
    hg_free(path);
    return status == HG_OK ? 0 : cli_fail();
}

static const hg_argument new_options[] = { { "output", "FILE", "where to (-o; default NAME.c); never over another file",
                                             false } };
static const hg_command command_new = {
    .name = "new",
    .what = "a C file to start an energy, an op or a model of your own from",
    .usage = "energy|op|model NAME",
    .options = new_options,
    .n_options = 1,
    .min_free = 2,
    .max_free = 2,
    .run = new_file,
    .more = "  hairgrad new energy tip_rise\n  cc -shared -fPIC $(hairgrad flags) tip_rise.c -o tip_rise.so\n"
            "  hairgrad --plugin tip_rise.so gradcheck tip_rise\n",
};
HG_REGISTER("command", new, &command_new);
