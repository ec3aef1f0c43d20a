/* base: what every floor stands on. Errors, memory, files, HDF5, configs, registry, random numbers.
 *
 * Errors. A function that can fail returns hg_status. The sentence that says what went wrong, where, what was
 * expected and what to do about it is kept per thread: hg_message(). The library never prints, aborts or exits.
 *
 *     hg_status load(const char *path)
 *     {
 *         void *bytes; size_t size;
 *         HG_TRY(hg_file_read(path, &bytes, &size));
 *         if (size < 160) { hg_free(bytes); return hg_fail(HG_FORMAT, "%s: %zu bytes, a header needs 160", path, size); }
 *         ...
 *         hg_free(bytes);
 *         return HG_OK;
 *     }
 *
 * Registry. Everything that is known by a name (an op, an energy, a model, a reader, a subcommand) is a constant
 * struct that registers itself when the library or a plug-in is loaded: one file to add, nothing else to edit.
 *
 * Ownership. What a function allocates for the caller is freed with hg_free unless its line says otherwise.
 */
#ifndef HG_BASE_H
#define HG_BASE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define HG_PRINTF(text_, first_) __attribute__((format(printf, text_, first_)))

/* ---- errors ------------------------------------------------------------------------------------------------- */

typedef enum {
    HG_OK = 0,
    HG_INVALID,     /* an argument, a shape, a config value */
    HG_FORMAT,      /* a file that is not what it says it is */
    HG_IO,          /* the system refused: missing file, full disk, no permission */
    HG_MEMORY,      /* out of memory */
    HG_NUMERIC,     /* a number that is not finite where it has to be */
    HG_UNSUPPORTED  /* right, but not available here */
} hg_status;

hg_status   hg_fail(hg_status status, const char *format, ...) HG_PRINTF(2, 3); /* sets the thread's message, returns status */
const char *hg_message(void);                                 /* the thread's last message, "" when there is none */
const char *hg_status_name(hg_status status);                 /* "invalid", "format", ... */

#define HG_TRY(call) do { hg_status hg_try_ = (call); if (hg_try_ != HG_OK) return hg_try_; } while (0)

/* ---- memory and text ---------------------------------------------------------------------------------------- */

void *hg_alloc(size_t count, size_t size);                    /* zeroed, 64-byte aligned, overflow-checked; NULL and a message on failure */
void *hg_resize(void *old, size_t old_count, size_t count, size_t size); /* new part zeroed; old freed on success */
int64_t hg_alloc_count(void);                                 /* how many times memory was taken so far, by all threads: constant in a steady state */
void  hg_free(void *memory);                                  /* NULL is fine */
char *hg_strdup(const char *text);
char *hg_format(const char *format, ...) HG_PRINTF(1, 2);     /* a new string */

typedef struct { char *data; size_t size, capacity; bool failed; } hg_text;  /* {0} is empty; data is NUL-terminated */
void hg_text_add(hg_text *text, const char *format, ...) HG_PRINTF(2, 3);
void hg_text_free(hg_text *text);

uint64_t hg_hash(const void *bytes, size_t size, uint64_t seed); /* FNV-1a, 64 bit */

/* ---- numbers ------------------------------------------------------------------------------------------------ */

typedef enum { HG_F32, HG_F64, HG_I32, HG_BF16, HG_TF32 /* how factors are rounded (hg_ctx_compute), not of tensors */ } hg_dtype;
size_t      hg_dtype_size(hg_dtype dtype);
const char *hg_dtype_name(hg_dtype dtype);

/* Counter-based random numbers (Philox 4x32-10, Random123): the same (seed, stream, counter) gives the same numbers
 * on every machine and thread, so that nothing has to be saved to resume. */
void     hg_random_bits(uint64_t seed, uint64_t stream, uint64_t counter, uint32_t out[4]);
double   hg_random_uniform(uint64_t seed, uint64_t stream, uint64_t counter);  /* [0, 1) */
double   hg_random_normal(uint64_t seed, uint64_t stream, uint64_t counter);   /* mean 0, deviation 1 */
uint64_t hg_random_below(uint64_t seed, uint64_t stream, uint64_t counter, uint64_t n); /* [0, n) */

/* ---- registry ----------------------------------------------------------------------------------------------- */

/* Of the headers: what is registered says which one it was compiled with. Raised whenever a struct that is registered, or
 * one that it is handed, changes. */
#define HG_ABI_VERSION 2

typedef struct hg_entry { uint64_t abi /* HG_ABI_VERSION */; const char *kind, *name; const void *item; struct hg_entry *next; } hg_entry;

void        hg_register(hg_entry *entry);                     /* keeps the pointer; a second entry of the same kind and name is remembered as a clash */
const char *hg_registry_clash(void);                          /* which name was registered twice, or for another ABI version; NULL when none */
const void *hg_find(const char *kind, const char *name);      /* NULL when unknown */
int         hg_list(const char *kind, const char **names, int max); /* sorted by name; returns how many there are */
const char *hg_nearest(const char *kind, const char *name);   /* the known name nearest in spelling, NULL when none is near */
const char *hg_nearest_of(const char *name, const char *const *names, int n);

/* HG_REGISTER("energy", stretch, &stretch_energy); at file scope */
#define HG_REGISTER(kind_, name_, item_)                                                       \
    __attribute__((constructor)) static void hg_register_##name_(void)                        \
    {                                                                                          \
        static hg_entry entry = { .abi = HG_ABI_VERSION, .kind = kind_, .name = #name_, .item = item_ }; \
        hg_register(&entry);                                                                   \
    }                                                                                          \
    struct hg_needs_semicolon

/* Loads a shared object that registers energies, ops, models, readers (a path without "/" is in the working folder). From
 * then on their names work like those of the library's own. Everything declared is checked; when anything is wrong (it
 * cannot be loaded, another ABI version, a name that is taken, a declaration that makes no sense), nothing of it stays and
 * the message says what, in which file. Loading the same file again does nothing. Stays loaded. */
hg_status hg_plugin_load(const char *path);
hg_status hg_plugins_load(const char *list); /* "a.so:b.so", as in HAIRGRAD_PLUGINS; NULL: none */

/* How what is registered as one kind is checked: HG_REGISTER("declaration", energy, &check); a blank in a kind is a _. */
typedef struct { hg_status (*check)(const char *name, const void *item); } hg_declaration;

/* ---- progress ----------------------------------------------------------------------------------------------- */

/* Long work reports here; only the program prints. Either member may be NULL. */
typedef struct { void *self; void (*report)(void *self, double fraction, const char *text); } hg_progress;
void hg_progress_report(const hg_progress *progress, double fraction, const char *format, ...) HG_PRINTF(3, 4);

/* ---- files -------------------------------------------------------------------------------------------------- */

hg_status hg_file_read(const char *path, void **bytes, size_t *size);            /* one NUL is added after the end */
hg_status hg_file_write(const char *path, const void *bytes, size_t size);       /* atomic: temporary name, synced, renamed */
bool      hg_file_exists(const char *path);
hg_status hg_folder_create(const char *path);                                    /* with its parents; fine when it exists */
char     *hg_path_join(const char *folder, const char *name);
const char *hg_path_extension(const char *path);                                 /* "tfx" of "a/b.tfx", "" when none */

/* Reader of a byte range with bounds: every binary reader uses it, so that no lying header can read outside. */
typedef struct { const uint8_t *bytes; size_t size, offset; const char *path; } hg_bytes;
hg_status hg_bytes_read(hg_bytes *from, void *to, size_t size, const char *what); /* HG_FORMAT names path, offset, what */
hg_status hg_bytes_seek(hg_bytes *from, size_t offset, const char *what);

/* ---- HDF5 --------------------------------------------------------------------------------------------------- */

typedef struct hg_h5 hg_h5;
hg_status hg_h5_open(hg_h5 **file, const char *path);                            /* to read */
hg_status hg_h5_create(hg_h5 **file, const char *path);                          /* under a temporary name until hg_h5_commit */
hg_status hg_h5_commit(hg_h5 *file);                                             /* flush, sync, rename, free; on error the old file stays */
void      hg_h5_close(hg_h5 *file);                                              /* frees; an uncommitted new file is removed */
bool      hg_h5_has(hg_h5 *file, const char *name);
hg_status hg_h5_group(hg_h5 *file, const char *name);                            /* made with its parents */
hg_status hg_h5_write(hg_h5 *file, const char *name, hg_dtype dtype, int rank, const int64_t *shape, const void *data); /* parents are made; bf16 is stored as u16 with attribute dtype="bf16" */
hg_status hg_h5_write_i64(hg_h5 *file, const char *name, int rank, const int64_t *shape, const int64_t *data);
hg_status hg_h5_write_u8(hg_h5 *file, const char *name, int rank, const int64_t *shape, const uint8_t *data);
/* Rows written bit by bit: the dataset is made with its full shape, then filled along axis 0. */
hg_status hg_h5_reserve(hg_h5 *file, const char *name, hg_dtype dtype, int rank, const int64_t *shape);
hg_status hg_h5_write_rows(hg_h5 *file, const char *name, int64_t first, int64_t count, const void *data);
hg_status hg_h5_shape(hg_h5 *file, const char *name, int *rank, int64_t shape[6]);
/* Reads a whole dataset into new memory, converted to dtype. expected[i] >= 0 must match, -1 accepts any; shape gets
 * the real one (may be NULL). Rank and size are checked; the message names file, dataset, expected and found. */
hg_status hg_h5_read(hg_h5 *file, const char *name, hg_dtype dtype, int rank, const int64_t *expected, int64_t *shape, void **data);
hg_status hg_h5_read_i64(hg_h5 *file, const char *name, int rank, const int64_t *expected, int64_t *shape, int64_t **data);
hg_status hg_h5_read_u8(hg_h5 *file, const char *name, int rank, const int64_t *expected, int64_t *shape, uint8_t **data);
hg_status hg_h5_read_rows(hg_h5 *file, const char *name, hg_dtype dtype, int64_t first, int64_t count, void *data);
/* Attributes: object "" or "/" is the file itself. */
hg_status hg_h5_set_text(hg_h5 *file, const char *object, const char *name, const char *text);
hg_status hg_h5_set_number(hg_h5 *file, const char *object, const char *name, double number);
hg_status hg_h5_set_integers(hg_h5 *file, const char *object, const char *name, int n, const int64_t *values);
hg_status hg_h5_get_text(hg_h5 *file, const char *object, const char *name, char **text);
hg_status hg_h5_get_number(hg_h5 *file, const char *object, const char *name, double *number);
hg_status hg_h5_get_integers(hg_h5 *file, const char *object, const char *name, int n, int64_t *values);
hg_status hg_h5_write_texts(hg_h5 *file, const char *name, int n, const char *const *texts);       /* a list of strings */
hg_status hg_h5_read_texts(hg_h5 *file, const char *name, int *n, char ***texts);                  /* free with hg_texts_free */
hg_status hg_h5_names(hg_h5 *file, const char *group, int *n, char ***names);                       /* of the members of a group, sorted; "" is the file; free with hg_texts_free */
void      hg_texts_free(char **texts, int n);

/* ---- configs ------------------------------------------------------------------------------------------------ */

/* A YAML config is read against a declared schema. Rows name a key by its path ("training.learning_rate"); a
 * section is declared by the rows inside it; a row of type HG_SECTION declares a section that may be empty or absent.
 * An unknown key is an error with its line and the nearest right key; so are a wrong unit, a wrong type, a value
 * outside [min, max] and a key given twice. Numbers are written with their unit ("2 N/m", "5 mm") and are stored in
 * the unit of the row, SI; a bare number is taken to be in that unit. What stands in a section declared by HG_SECTION
 * is required, and echoed, only where that section is given. */
typedef enum { HG_NUMBER, HG_INTEGER, HG_FLAG, HG_TEXT, HG_CHOICE, HG_NUMBERS, HG_TEXTS, HG_SECTION } hg_config_type;
typedef struct {
    const char *key;            /* "training.learning_rate" */
    hg_config_type type;
    const char *value;          /* default as it would be written, NULL: required, "" (TEXT, TEXTS, NUMBERS): empty */
    const char *unit;           /* "N/m", "m", "s", "1"; NULL: none */
    const char *choices;        /* "published|smooth" for HG_CHOICE */
    double min, max;            /* both 0: any */
    const char *help;           /* one line */
} hg_config_row;

typedef struct hg_config hg_config;
hg_status   hg_config_load(hg_config **config, const char *path, const hg_config_row *rows, int n);
hg_status   hg_config_load_with(hg_config **config, const char *path, const hg_config_row *rows, int n, const char *const *overrides, int n_overrides); /* "KEY=VALUE" each, set before required keys are looked for */
hg_status   hg_config_parse(hg_config **config, const char *text, const char *name, const hg_config_row *rows, int n);
hg_status   hg_config_set(hg_config *config, const char *key, const char *value);   /* an override, "training.steps" "100"; same checks */
hg_status   hg_config_check(const hg_config *config);                               /* that every required key has a value, again after hg_config_set */
void        hg_config_destroy(hg_config *config);
bool        hg_config_given(const hg_config *config, const char *key);              /* written in the file (or set), not a default; also for sections */
double      hg_config_number(const hg_config *config, const char *key);             /* asking for an undeclared key is a bug: NAN */
int64_t     hg_config_integer(const hg_config *config, const char *key);
bool        hg_config_flag(const hg_config *config, const char *key);
const char *hg_config_text(const hg_config *config, const char *key);               /* TEXT and CHOICE */
int         hg_config_count(const hg_config *config, const char *key);              /* length of NUMBERS and TEXTS */
double      hg_config_number_at(const hg_config *config, const char *key, int i);
const char *hg_config_text_at(const hg_config *config, const char *key, int i);
int         hg_config_line(const hg_config *config, const char *key);               /* 0 when not in the file */
void        hg_config_lines(hg_config *config, const hg_config *from);              /* of a copy: every key stands where it stood in `from` */
const char *hg_config_name(const hg_config *config);                                /* the path given */
char       *hg_config_echo(const hg_config *config);                                /* every value, defaults too, as YAML that loads to the same */
hg_status   hg_unit_parse(const char *text, const char *unit, double *value);       /* "5 mm", "m" -> 0.005 */

#ifdef __cplusplus
}
#endif
#endif
