/* The strand pass of a physics: keeps what is computed once per groom, chooses the kernel (printed when the library was
 * built, or the interpreter), and runs it over tiles of strands. */
#include "autograd/trace/compile.h"
#include "hairloss/physics.h"

#include <omp.h>
#include <stdio.h>
#include <string.h>

struct hg_strand_pass {
    hg_dtype dtype;
    const hg_groom_data *data;
    int n; /* terms */
    hg_term *terms;
    int32_t *column;
    hg_strand_program *program;
    const hg_strand_kernel_entry *compiled; /* NULL: interpreted */
    char backend[80], note[256];
    int lanes;
    int64_t tiles;             /* per frame */
    void *site, *groom_strand; /* made once per groom, in the tile layout of the kernel */
    double *rest_carry;        /* [G,S,V,n_rest_carry] while they are made */
    void *uniform;
    double *uniform_values, *uniform_inputs;
    void *scratch;
    size_t scratch_size; /* of one thread */
    int threads;
};

uint64_t hg_strand_pass_hash(const hg_strand_pass *pass) { return pass->program->hash; }

const char *hg_strand_pass_backend_name(const hg_strand_pass *pass) { return pass->backend; }

const char *hg_strand_pass_backend_note(const hg_strand_pass *pass) { return pass->note; }

/* ---- once per groom ----------------------------------------------------------------------------------------- */

static double groom_value(const hg_strand_pass *p, hg_input in, int64_t groom, int64_t strand, int64_t vertex)
{
    const hg_groom_data *data = p->data;
    const int64_t V = data->vertices;
    int64_t v = in.kind == HG_INPUT_ROOT_REST ? in.offset : vertex + in.offset;
    if (v < 0) v = 0; /* windows that begin before the root are stored but never used */
    if (v > V - 1) v = V - 1;
    const int64_t at = (groom * data->strands + strand) * V + v;
    switch (in.kind) {
    case HG_INPUT_REST:
    case HG_INPUT_ROOT_REST:
        return data->rest[3 * at + in.component];
    case HG_INPUT_REST_CARRY:
        return p->rest_carry[at * p->program->n_rest_carry + p->program->rest_carries[in.name].at + in.component];
    case HG_INPUT_MASS:
        return data->mass[at];
    default:
        return hg_groom_attribute_find(data, p->program->attributes[in.name])[at];
    }
}

typedef struct {
    const hg_strand_pass *pass;
    const hg_function *function;
    int n_out;
    int64_t vertices; /* V for sites, 1 for strands */
    void *to;         /* [G,tiles,vertices,n_out,lanes] */
} groom_work;

enum { GROOM_CHUNK = HG_LANES_F64, GROOM_VALUES = 64 };

/* Computed in f64 whatever the physics, and rounded once. */
static void groom_rows(const void *args, int64_t first, int64_t last)
{
    const groom_work *work = args;
    const hg_strand_pass *p = work->pass;
    int n_in;
    const hg_input *inputs = hg_function_inputs(work->function, &n_in);
    double in[GROOM_VALUES][GROOM_CHUNK], out[GROOM_VALUES][GROOM_CHUNK];
    const void *ins[GROOM_VALUES];
    void *outs[GROOM_VALUES];
    for (int i = 0; i < n_in; i++) ins[i] = in[i];
    for (int j = 0; j < work->n_out; j++) outs[j] = out[j];
    for (int64_t row = first; row < last; row++) {
        const int64_t vertex = row % work->vertices, tile = row / work->vertices % p->tiles;
        const int64_t groom = row / work->vertices / p->tiles;
        for (int64_t lane = 0; lane < p->lanes; lane += GROOM_CHUNK) {
            const int64_t count = p->lanes - lane < GROOM_CHUNK ? p->lanes - lane : GROOM_CHUNK;
            for (int i = 0; i < n_in; i++)
                for (int64_t l = 0; l < count; l++) {
                    int64_t strand = tile * p->lanes + lane + l;
                    if (strand >= p->data->strands) strand = p->data->strands - 1;
                    in[i][l] = groom_value(p, inputs[i], groom, strand, vertex);
                }
            hg_function_run(work->function, HG_F64, count, ins, NULL, outs);
            for (int j = 0; j < work->n_out; j++) {
                const int64_t at = (row * work->n_out + j) * p->lanes + lane;
                for (int64_t l = 0; l < count; l++) {
                    if (p->dtype == HG_F64)
                        ((double *)work->to)[at + l] = out[j][l];
                    else
                        ((float *)work->to)[at + l] = (float)out[j][l];
                }
            }
        }
    }
}

static hg_status make_groom(hg_strand_pass *p, hg_ctx *ctx, const hg_function *function, int n_out, int64_t vertices,
                            void **to)
{
    static const hg_kernel kernel = {
        .name = "groom_hoist", .args_size = sizeof(groom_work), .cpu = groom_rows, .block = 16
    };
    hg_free(*to);
    *to = NULL;
    if (!function) return HG_OK;
    int n_in;
    hg_function_inputs(function, &n_in);
    if (n_in > GROOM_VALUES || n_out > GROOM_VALUES)
        return hg_fail(HG_UNSUPPORTED,
                       "the energies ask for %d rest values and keep %d per site: at most %d are possible", n_in, n_out,
                       GROOM_VALUES);
    const int64_t rows = p->data->grooms * p->tiles * vertices;
    *to = hg_alloc((size_t)(rows * n_out * p->lanes) + 1, hg_dtype_size(p->dtype));
    if (!*to) return HG_MEMORY;
    const groom_work work = { p, function, n_out, vertices, *to };
    return hg_launch(ctx, &kernel, rows, &work);
}

/* Runs a function of a vertex for some strands of a groom; out[j] gets its outputs. */
static void at_vertex(const hg_strand_pass *p, const hg_function *function, int64_t groom, int64_t strand,
                      int64_t count, int64_t vertex, double out[][GROOM_CHUNK], int n_out)
{
    int n_in;
    const hg_input *inputs = hg_function_inputs(function, &n_in);
    double in[GROOM_VALUES][GROOM_CHUNK];
    const void *ins[GROOM_VALUES];
    void *outs[GROOM_VALUES];
    for (int i = 0; i < n_in; i++) {
        ins[i] = in[i];
        for (int64_t l = 0; l < count; l++) in[i][l] = groom_value(p, inputs[i], groom, strand + l, vertex);
    }
    for (int j = 0; j < n_out; j++) outs[j] = out[j];
    hg_function_run(function, HG_F64, count, ins, NULL, outs);
}

/* Carried rest data of some strands, from root to tip. */
static void rest_carry_rows(const void *args, int64_t first, int64_t last)
{
    const hg_strand_pass *p = *(hg_strand_pass *const *)args;
    const hg_strand_program *program = p->program;
    const int64_t S = p->data->strands, V = p->data->vertices, chunks = (S + GROOM_CHUNK - 1) / GROOM_CHUNK;
    const int n = program->n_rest_carry;
    double out[4 * HG_GRAPH_CARRIES][GROOM_CHUNK];
    for (int64_t row = first; row < last; row++) {
        const int64_t groom = row / chunks, strand = row % chunks * GROOM_CHUNK;
        const int64_t count = S - strand < GROOM_CHUNK ? S - strand : GROOM_CHUNK;
        for (int64_t v = 0; v < V; v++)
            for (int kept = 0; kept < 2; kept++) {
                if (kept && v + 1 == V) break;
                /* one carried value's beginning may be made of another's */
                for (int round = 0; round < (kept ? 1 : program->n_rest_carries); round++) {
                    at_vertex(p, kept ? program->rest_kept : program->rest_first, groom, strand, count, v, out, n);
                    for (int i = 0; i < program->n_rest_carries; i++) {
                        if (kept ? v < program->rest_carries[i].start : v != program->rest_carries[i].start) continue;
                        for (int c = 0; c < program->rest_carries[i].width; c++) {
                            const int j = program->rest_carries[i].at + c;
                            for (int64_t l = 0; l < count; l++)
                                p->rest_carry[((groom * S + strand + l) * V + v + kept) * n + j] = out[j][l];
                        }
                    }
                }
            }
    }
}

static hg_status make_rest_carry(hg_strand_pass *p, hg_ctx *ctx)
{
    static const hg_kernel kernel = {
        .name = "groom_carry", .args_size = sizeof(hg_strand_pass *), .cpu = rest_carry_rows, .block = 1
    };
    const hg_strand_program *program = p->program;
    const int64_t S = p->data->strands, G = p->data->grooms;
    if (!program->n_rest_carry) return HG_OK;
    int first, kept;
    hg_function_inputs(program->rest_first, &first);
    hg_function_inputs(program->rest_kept, &kept);
    if (first > GROOM_VALUES || kept > GROOM_VALUES)
        return hg_fail(HG_UNSUPPORTED, "carried rest data is made of %d values: at most %d are possible",
                       first > kept ? first : kept, GROOM_VALUES);
    p->rest_carry = hg_alloc((size_t)(G * S * p->data->vertices * program->n_rest_carry) + 1, sizeof(double));
    if (!p->rest_carry) return HG_MEMORY;
    return hg_launch(ctx, &kernel, G * ((S + GROOM_CHUNK - 1) / GROOM_CHUNK), &p);
}

/* ---- the kernel --------------------------------------------------------------------------------------------- */

#if defined(__x86_64__)
#define SUPPORTS(level_)                                                                                               \
    (strcmp(level_, "avx512") == 0 ? __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&        \
                                         __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&   \
                                         __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("fma")           \
     : strcmp(level_, "avx2") == 0                                                                                     \
         ? __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2")           \
     : strcmp(level_, "sse4") == 0 ? __builtin_cpu_supports("sse4.2")                                                  \
                                   : 1)
#else
#define SUPPORTS(level_) 1
#endif

/* The best kernel for the program and this processor; only: that level. */
static const hg_strand_kernel_entry *find_compiled(const hg_strand_program *program, const char *only)
{
    static const char *const levels[] = { "avx512", "avx2", "sse4", "plain" };
    for (size_t i = 0; i < sizeof levels / sizeof *levels; i++) {
        char name[80];
        if ((only && strcmp(only, levels[i]) != 0) || !SUPPORTS(levels[i])) continue;
        snprintf(name, sizeof name, "%s %s %016llx", hg_dtype_name(program->dtype), levels[i],
                 (unsigned long long)program->hash);
        const hg_strand_kernel_entry *entry = hg_find("strand_kernel", name);
        if (entry && entry->hash == program->hash && entry->bytes == (int)hg_dtype_size(program->dtype)) return entry;
    }
    return NULL;
}

static hg_status make_scratch(hg_strand_pass *p, hg_ctx *ctx)
{
    if (p->threads >= hg_ctx_threads(ctx) && p->scratch) return HG_OK;
    hg_free(p->scratch);
    p->threads = hg_ctx_threads(ctx) > 0 ? hg_ctx_threads(ctx) : 1;
    p->scratch_size = (hg_strand_scratch(p->program, p->lanes, p->data->vertices) + 4095) & ~(size_t)4095;
    p->scratch = hg_alloc((size_t)p->threads, p->scratch_size);
    return p->scratch ? HG_OK : HG_MEMORY;
}

static hg_status prepare(hg_strand_pass *p, hg_ctx *ctx, const hg_strand_kernel_entry *compiled)
{
    const hg_strand_program *program = p->program;
    p->compiled = compiled;
    p->lanes = compiled ? compiled->lanes : hg_strand_lanes(p->dtype);
    p->tiles = (p->data->strands + p->lanes - 1) / p->lanes;
    hg_status status = make_rest_carry(p, ctx);
    if (status == HG_OK) status = make_groom(p, ctx, program->site, program->n_site, p->data->vertices, &p->site);
    if (status == HG_OK)
        status = make_groom(p, ctx, program->groom_strand, program->n_groom_strand, 1, &p->groom_strand);
    hg_free(p->rest_carry);
    p->rest_carry = NULL;
    HG_TRY(status);
    p->threads = 0;
    return make_scratch(p, ctx);
}

/* A groom of fewer vertices is interpreted where no kernel was printed for it: a second of the compiler is never won back. */
enum { WORTH_COMPILING = 10000 };

hg_status hg_strand_pass_backend(hg_strand_pass *pass, hg_ctx *ctx, hg_backend backend, const char *level)
{
    const hg_strand_kernel_entry *compiled =
        backend == HG_BACKEND_INTERPRETER ? NULL : find_compiled(pass->program, level);
    const bool worth = pass->data->grooms * pass->data->strands * pass->data->vertices >= WORTH_COMPILING;
    hg_compiled_kernel now = { 0 };
    pass->note[0] = '\0';
    if (!compiled && !level && (backend == HG_BACKEND_COMPILED || (backend == HG_BACKEND_AUTO && worth))) {
        if (hg_strand_compile(pass->program, &now) == HG_OK)
            compiled = now.kernel;
        else
            snprintf(pass->note, sizeof pass->note, "%s", hg_message());
        if (now.seconds > 0)
            snprintf(pass->note, sizeof pass->note, "compiled in %.1f s and kept in the cache", now.seconds);
    }
    if (backend == HG_BACKEND_COMPILED && !compiled) {
        hg_text names = { 0 };
        for (int i = 0; i < pass->n; i++) hg_text_add(&names, "%s%s", i ? " + " : "", pass->terms[i].energy->name);
        hg_status status =
            hg_fail(HG_UNSUPPORTED, "there is no compiled kernel for %s (%s): %s; the interpreter runs it",
                    names.data ? names.data : "", hg_dtype_name(pass->dtype),
                    level ? "none was printed when this library was built" : pass->note);
        hg_text_free(&names);
        return status;
    }
    if (!compiled)
        snprintf(pass->backend, sizeof pass->backend, "interpreter");
    else
        snprintf(pass->backend, sizeof pass->backend, "compiled %s%s%s", compiled->level, now.kernel ? " by " : "",
                 now.by);
    if (pass->compiled == compiled && pass->scratch) return HG_OK;
    return prepare(pass, ctx, compiled);
}

static bool attribute_given(const hg_strand_variant *variant, const char *name)
{
    for (int i = 0; variant && i < variant->n_given; i++)
        if (variant->given[i].kind == HG_INPUT_ATTRIBUTE && strcmp(variant->given[i].name, name) == 0) return true;
    return false;
}

hg_status hg_strand_pass_create(hg_strand_pass **out, hg_ctx *ctx, hg_dtype dtype, int n, const hg_term *terms,
                                const int32_t *column, const hg_groom_data *data, const hg_strand_variant *variant,
                                bool hoist)
{
    *out = NULL;
    hg_strand_pass *p = hg_alloc(1, sizeof *p);
    hg_strand_term *traced = hg_alloc((size_t)n + 1, sizeof *traced);
    hg_status status = p && traced ? HG_OK : HG_MEMORY;
    if (status != HG_OK) {
        hg_free(p);
        hg_free(traced);
        return status;
    }
    p->dtype = dtype;
    p->data = data;
    p->n = n;
    p->terms = hg_alloc((size_t)n + 1, sizeof *p->terms);
    p->column = hg_alloc((size_t)n + 1, sizeof *p->column);
    if (!p->terms || !p->column) status = HG_MEMORY;
    for (int t = 0; status == HG_OK && t < n; t++) {
        p->terms[t] = terms[t];
        p->column[t] = column[t];
        hg_term_scope(&traced[t].scope, &terms[t], t, HG_ALLOW_WINDOW);
        traced[t].scope.posed_given = variant && variant->posed_given;
        traced[t].scope.root_at_rest = variant && variant->root_at_rest;
        traced[t].trace = terms[t].energy->trace;
        traced[t].root = terms[t].energy->root;
    }
    if (status == HG_OK)
        status = hg_strand_program_create(&p->program, dtype, n, traced, variant ? variant->n_given : 0,
                                          variant ? variant->given : NULL, hoist);
    hg_free(traced);
    for (int i = 0; status == HG_OK && i < p->program->n_attributes; i++)
        if (!hg_groom_attribute_find(data, p->program->attributes[i]) &&
            !attribute_given(variant, p->program->attributes[i]))
            status = hg_fail(HG_INVALID, "energy '%s' needs the groom attribute '%s', which was not given",
                             terms[p->program->attribute_term[i]].energy->name, p->program->attributes[i]);
    if (status == HG_OK) {
        int n_in = 0;
        if (p->program->uniform) hg_function_inputs(p->program->uniform, &n_in);
        p->uniform = hg_alloc((size_t)p->program->n_uniform + 1, sizeof(double));
        p->uniform_values = hg_alloc((size_t)p->program->n_uniform + 1, sizeof(double));
        p->uniform_inputs = hg_alloc((size_t)n_in + 1, sizeof(double));
        if (!p->uniform || !p->uniform_values || !p->uniform_inputs) status = HG_MEMORY;
    }
    if (status == HG_OK) status = hg_strand_pass_backend(p, ctx, HG_BACKEND_AUTO, NULL);
    if (status != HG_OK) {
        hg_strand_pass_destroy(p);
        return status;
    }
    *out = p;
    return HG_OK;
}

void hg_strand_pass_destroy(hg_strand_pass *pass)
{
    if (!pass) return;
    hg_strand_program_destroy(pass->program);
    hg_free(pass->terms);
    hg_free(pass->column);
    hg_free(pass->site);
    hg_free(pass->groom_strand);
    hg_free(pass->uniform);
    hg_free(pass->uniform_values);
    hg_free(pass->uniform_inputs);
    hg_free(pass->scratch);
    hg_free(pass);
}

/* ---- per call ----------------------------------------------------------------------------------------------- */

typedef struct {
    const hg_strand_pass *pass;
    hg_strand_args args;
} strand_work;

static void strand_tiles(const void *args, int64_t first, int64_t last)
{
    const strand_work *work = args;
    const hg_strand_pass *p = work->pass;
    void *scratch = (char *)p->scratch + (size_t)(omp_get_thread_num() % p->threads) * p->scratch_size;
    if (p->compiled)
        p->compiled->run(&work->args, first, last, scratch);
    else
        hg_strand_interpret(p->program, &work->args, first, last, scratch);
}

/* The value of this call for an input of the program; NULL when there is none. */
static const hg_pass_value *find_value(const hg_strand_pass *p, int n, const hg_pass_value *values, hg_input_kind kind,
                                       int name, int term)
{
    for (int i = 0; i < n; i++) {
        const hg_pass_value *value = &values[i];
        if (value->kind != kind) continue;
        if (kind == HG_INPUT_PARAM && (value->term != p->column[term] || value->param != name)) continue;
        if (kind == HG_INPUT_ATTRIBUTE && strcmp(value->name, p->program->attributes[name]) != 0) continue;
        if (kind == HG_INPUT_FRAME && strcmp(value->name, p->program->frames[name]) != 0) continue;
        return value;
    }
    return NULL;
}

static double number_at(hg_dtype dtype, const void *values, int64_t i)
{
    return dtype == HG_F64 ? ((const double *)values)[i] : (double)((const float *)values)[i];
}

static void make_uniform(hg_strand_pass *p, const hg_frame *frame, int n_values, const hg_pass_value *values)
{
    const hg_strand_program *program = p->program;
    if (!program->uniform) return;
    int n_in;
    const hg_input *inputs = hg_function_inputs(program->uniform, &n_in);
    for (int i = 0; i < n_in; i++) {
        const hg_pass_value *value = find_value(p, n_values, values, inputs[i].kind, inputs[i].name, inputs[i].term);
        p->uniform_inputs[i] = inputs[i].kind == HG_INPUT_WEIGHT  ? p->terms[inputs[i].term].weight
                               : value                            ? number_at(p->dtype, value->values, 0)
                               : inputs[i].kind == HG_INPUT_PARAM ? p->terms[inputs[i].term].params[inputs[i].name]
                                                                  : frame->dt;
    }
    void *out[256];
    for (int j = 0; j < program->n_uniform; j++) out[j] = &p->uniform_values[j];
    hg_function_run(program->uniform, HG_F64, 1, NULL, p->uniform_inputs, out);
    for (int j = 0; j < program->n_uniform; j++) {
        if (p->dtype == HG_F64)
            ((double *)p->uniform)[j] = p->uniform_values[j];
        else
            ((float *)p->uniform)[j] = (float)p->uniform_values[j];
    }
}

static hg_status missing(const hg_strand_pass *p, hg_input_kind kind, const char *what)
{
    for (int t = 0; t < p->n; t++)
        if (p->program->used[t] & HG_ALLOW(kind))
            return hg_fail(HG_INVALID, "energy '%s' needs frame.%s, which was not given", p->terms[t].energy->name,
                           what);
    return hg_fail(HG_INVALID, "frame.%s was not given", what);
}

static bool uses(const hg_strand_pass *p, hg_input_kind kind)
{
    for (int t = 0; t < p->n; t++)
        if (p->program->used[t] & HG_ALLOW(kind)) return true;
    return false;
}

/* Root frames where the frame brings none: identity at the rest root. */
static void *still_roots(const hg_strand_pass *p, hg_ctx *ctx, const hg_frame *frame, int64_t frames, int width)
{
    const int64_t S = p->data->strands, V = p->data->vertices;
    void *to = hg_step_alloc(ctx, (size_t)(frames * S * width) * hg_dtype_size(p->dtype) + 1);
    for (int64_t i = 0; to && i < frames * S; i++)
        for (int c = 0; c < width; c++) {
            const int64_t groom = frame->groom ? frame->groom[i / S] : 0;
            const double value = width == 4 ? (c == 0 ? 1 : 0) : p->data->rest[(groom * S + i % S) * V * 3 + c];
            if (p->dtype == HG_F64)
                ((double *)to)[i * width + c] = value;
            else
                ((float *)to)[i * width + c] = (float)value;
        }
    return to;
}

/* A sum of per-strand or per-frame gradients that the kernel leaves, in the shape in which it is wanted. */
typedef struct {
    hg_dtype dtype;
    const int32_t *groom; /* [B]; of rest data: a row per frame goes to the row of its groom */
    int64_t frames, row;  /* row: values of one frame */
    const void *from;
    void *to; /* [G,row] */
} reduce_work;

static void reduce_rows(const void *args, int64_t first, int64_t last)
{
    const reduce_work *work = args;
    for (int64_t b = 0; b < work->frames; b++) {
        const int64_t groom = work->groom ? work->groom[b] : 0;
        for (int64_t i = first; i < last; i++) {
            if (work->dtype == HG_F64)
                ((double *)work->to)[groom * work->row + i] += ((const double *)work->from)[b * work->row + i];
            else
                ((float *)work->to)[groom * work->row + i] += ((const float *)work->from)[b * work->row + i];
        }
    }
}

static hg_status reduce(hg_strand_pass *p, hg_ctx *ctx, const hg_frame *frame, int64_t frames, int64_t row,
                        bool uniform, const void *from, void *to)
{
    static const hg_kernel kernel = {
        .name = "groom_gradient", .args_size = sizeof(reduce_work), .cpu = reduce_rows, .block = 4096
    };
    if (uniform) { /* one value of all strands: summed in f64 */
        double sum = 0;
        for (int64_t i = 0; i < frames * row; i++) sum += number_at(p->dtype, from, i);
        if (p->dtype == HG_F64)
            *(double *)to = sum;
        else
            *(float *)to = (float)sum;
        return HG_OK;
    }
    memset(to, 0, (size_t)(p->data->grooms * row) * hg_dtype_size(p->dtype));
    const reduce_work work = { p->dtype, frame->groom, frames, row, from, to };
    return hg_launch(ctx, &kernel, row, &work);
}

/* [B,S] of one value. */
static void *spread(const hg_strand_pass *p, hg_ctx *ctx, int64_t n, const void *value)
{
    void *to = hg_step_alloc(ctx, (size_t)n * hg_dtype_size(p->dtype) + 1);
    for (int64_t i = 0; to && i < n; i++) {
        if (p->dtype == HG_F64)
            ((double *)to)[i] = *(const double *)value;
        else
            ((float *)to)[i] = *(const float *)value;
    }
    return to;
}

/* Where the kernel finds an array of the program, or NULL. */
static const void *array_data(const hg_strand_pass *p, const hg_frame *frame, const hg_tensor *x,
                              const void *contact_point, const void *contact_normal, const hg_strand_input *array,
                              const hg_pass_value *value)
{
    const hg_tensor *brought = NULL;
    (void)p;
    switch (array->kind) {
    case HG_INPUT_X:
        brought = x;
        break;
    case HG_INPUT_POSED:
        brought = frame->posed;
        break;
    case HG_INPUT_PREDICTED:
        brought = frame->predicted;
        break;
    case HG_INPUT_PREVIOUS:
        brought = frame->previous;
        break;
    case HG_INPUT_CONTACT_POINT:
        return contact_point;
    case HG_INPUT_CONTACT_NORMAL:
        return contact_normal;
    default:
        return value ? value->values : NULL;
    }
    return brought ? brought->data : NULL;
}

static hg_status array_missing(const hg_strand_pass *p, const hg_strand_input *array)
{
    if (array->kind == HG_INPUT_FRAME)
        return hg_fail(HG_INVALID, "energy '%s' needs the array '%s' [B,S,V%s], which frame.inputs does not bring",
                       p->terms[p->program->frame_term[array->name]].energy->name, p->program->frames[array->name],
                       array->width == 3 ? ",3" : "");
    return missing(p, array->kind,
                   array->kind == HG_INPUT_Q ? "inputs \"q\" [B,S,V-1,4]"
                   : array->kind == HG_INPUT_CONTACT_POINT || array->kind == HG_INPUT_CONTACT_NORMAL
                       ? "body_vertices"
                       : hg_input_name(array->kind));
}

hg_status hg_strand_pass_run(hg_strand_pass *p, hg_ctx *ctx, const hg_frame *frame, const hg_tensor *x,
                             const void *contact_point, const void *contact_normal, int n_values,
                             const hg_pass_value *values, void *gradient, double *unweighted, double *per_strand,
                             int64_t stride)
{
    const hg_strand_program *program = p->program;
    const int64_t frames = x->shape[0], n = frames * p->tiles, S = p->data->strands, V = p->data->vertices;
    const size_t size = hg_dtype_size(p->dtype);
    for (int t = 0; t < p->n; t++) unweighted[p->column[t]] = 0;
    if (n == 0) return HG_OK;
    HG_TRY(make_scratch(p, ctx));
    make_uniform(p, frame, n_values, values);

    strand_work work = { .pass = p,
                         .args = { .strands = S,
                                   .vertices = V,
                                   .tiles = p->tiles,
                                   .groom = frame->groom,
                                   .site = p->site,
                                   .groom_strand = p->groom_strand,
                                   .uniform = p->uniform,
                                   .per_strand = per_strand,
                                   .stride = stride,
                                   .column = p->column } };
    hg_strand_args *args = &work.args;
    for (int k = 0; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        const hg_pass_value *value = find_value(p, n_values, values, array->kind, array->name, 0);
        args->array[k] = array_data(p, frame, x, contact_point, contact_normal, array, value);
        if (!args->array[k]) return array_missing(p, array);
        args->array_gradient[k] = k == 0 ? gradient : value ? value->gradient : NULL;
        if (array->rest && args->array_gradient[k] && /* per frame first */
            !(args->array_gradient[k] = hg_step_alloc(ctx, (size_t)(frames * S * V * array->width) * size)))
            return HG_MEMORY;
    }
    if (uses(p, HG_INPUT_DT) && !(frame->dt > 0) && !find_value(p, n_values, values, HG_INPUT_DT, 0, 0))
        return missing(p, HG_INPUT_DT, "dt (a positive time step)");
    for (int j = 0; j < program->n_inputs; j++) {
        const hg_strand_input *input = &program->inputs[j];
        const hg_pass_value *value = find_value(p, n_values, values, input->kind, input->name, input->term);
        const hg_tensor *brought = j == 0 ? frame->root_rotation : j == 1 ? frame->root_position : NULL;
        args->strand_input[j] = brought          ? brought->data
                                : j < 2          ? still_roots(p, ctx, frame, frames, input->width)
                                : value->uniform ? spread(p, ctx, frames * S, value->values)
                                                 : value->values;
        args->strand_input_gradient[j] = value ? value->gradient : NULL;
        if (value && value->uniform && value->gradient &&
            !(args->strand_input_gradient[j] = hg_step_alloc(ctx, (size_t)(frames * S) * size)))
            return HG_MEMORY;
        if (!args->strand_input[j]) return HG_MEMORY;
    }
    args->energy = hg_step_alloc(ctx, (size_t)(n * p->n) * sizeof(double) + 1);
    if (!args->energy) return hg_fail(HG_MEMORY, "out of memory for %lld strands", (long long)(frames * S));

    const hg_kernel kernel = {
        .name = "strand_energies", .args_size = sizeof work, .cpu = strand_tiles, .block = p->lanes >= 64 ? 1 : 8
    };
    HG_TRY(hg_launch(ctx, &kernel, n, &work));
    for (int64_t tile = 0; tile < n; tile++)
        for (int t = 0; t < p->n; t++) unweighted[p->column[t]] += args->energy[tile * p->n + t];

    for (int k = 1; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        if (array->rest && args->array_gradient[k])
            HG_TRY(reduce(p, ctx, frame, frames, S * V * array->width, false, args->array_gradient[k],
                          find_value(p, n_values, values, array->kind, array->name, 0)->gradient));
    }
    for (int j = 2; j < program->n_inputs; j++) {
        const hg_strand_input *input = &program->inputs[j];
        const hg_pass_value *value = find_value(p, n_values, values, input->kind, input->name, input->term);
        if (value->uniform && value->gradient)
            HG_TRY(reduce(p, ctx, frame, frames, S, true, args->strand_input_gradient[j], value->gradient));
    }
    return HG_OK;
}
