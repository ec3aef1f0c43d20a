/* The strand pass of a physics: keeps what is computed once per groom, chooses the kernel (printed when the library was
 * built, or the interpreter; on a GPU printed CUDA), and runs it over tiles of strands. */
#include "autograd/trace/compile.h"
#include "hairloss/physics.h"
#include "hairloss/physics_hoist.h"
#include "hairloss/physics_kernels.h"

#include <omp.h>
#include <stdio.h>
#include <string.h>

/* What a GPU needs of its own. */
typedef struct {
    hg_text text; /* of both kernels */
    hg_kernel strands, values;
    hg_tensor *site, *groom_strand, *column; /* once per groom */
    hg_tensor *uniform, *inputs;             /* what is the same for all strands, and what it is made of */
    bool uniform_there, inputs_there;        /* are the values of the host there? */
} strand_device;

struct hg_strand_pass {
    hg_ctx *ctx;
    hg_dtype dtype;
    const hg_groom_data *data;
    int n; /* terms */
    hg_term *terms;
    int32_t *column;
    hg_strand_program *program;
    const hg_strand_kernel_entry *compiled; /* NULL: interpreted */
    char backend[80], note[256];
    int lanes;
    int64_t tiles;       /* per frame */
    hg_hoisted hoisted;  /* made once per groom, in the layout of the kernel */
    hg_tensor *still[2]; /* [G,S,4], [G,S,3]: root frames where a call brings none; made when first needed */
    void *uniform;
    double *uniform_values, *uniform_inputs;
    void *scratch;
    size_t scratch_size; /* of one thread */
    int threads;
    strand_device device;
};

uint64_t hg_strand_pass_hash(const hg_strand_pass *pass) { return pass->program->hash; }

const char *hg_strand_pass_backend_name(const hg_strand_pass *pass) { return pass->backend; }

const char *hg_strand_pass_backend_note(const hg_strand_pass *pass) { return pass->note; }

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
    p->compiled = compiled;
    p->lanes = compiled ? compiled->lanes : hg_strand_lanes(p->dtype);
    p->tiles = (p->data->strands + p->lanes - 1) / p->lanes;
    hg_free(p->hoisted.site);
    hg_free(p->hoisted.groom_strand);
    HG_TRY(hg_hoist(&p->hoisted, ctx, p->program, p->data, HG_HOIST_TILES, p->lanes));
    p->threads = 0;
    return make_scratch(p, ctx);
}

/* ---- the kernel of a GPU ------------------------------------------------------------------------------------ */

enum {
    SHARED = 48 << 10,    /* of a block: more would leave too few blocks */
    CARRY_BLOCK = 64,     /* threads, of a strand each: few for the many registers of a whole walk */
    CARRY_MOST = 1 << 16, /* at a time: the others come after them, in the same scratch */
    GIVEN_NUMBERS = 96
};

/* Values that are the same for all strands where the call brings some of what they are made of in the device's memory. */
typedef struct {
    const void *given[GIVEN_NUMBERS]; /* one number in the dtype of the physics; NULL: numbers[i] */
    const double *numbers;
    void *to;
} values_args;

static void print_values(const hg_strand_program *program, hg_text *text)
{
    int n_in;
    hg_function_inputs(program->uniform, &n_in);
    hg_function_print_cuda(program->uniform, "make_values", text);
    hg_text_add(text,
                "typedef struct { const void *given[%d]; const double *numbers; void *to; } values_args;\n"
                "HG_BODY void strand_values(const values_args *p, int64_t, int64_t)\n{\n"
                "    double in[%d], out[%d];\n"
                "    for (int i = 0; i < %d; i++) in[i] = p->given[i] ? (double)*(const hg_real *)p->given[i] : "
                "p->numbers[i];\n"
                "    make_values(in, out);\n"
                "    for (int i = 0; i < %d; i++) ((hg_real *)p->to)[i] = (hg_real)out[i];\n}\n"
                "HG_KERNEL(strand_values, values_args, 1)\n",
                GIVEN_NUMBERS, n_in + 1, program->n_uniform, n_in, program->n_uniform);
}

/* The host's numbers as a tensor of the device. */
static hg_status put(hg_ctx *ctx, hg_tensor **to, hg_dtype dtype, int64_t n, const void *from)
{
    *to = hg_tensor_create(ctx, dtype, 1, &n);
    return !*to ? HG_MEMORY : n ? hg_tensor_write(*to, from) : HG_OK;
}

static hg_status prepare_device(hg_strand_pass *p)
{
    const hg_strand_program *program = p->program;
    strand_device *d = &p->device;
    hg_hoisted made;
    HG_TRY(hg_hoist(&made, p->ctx, program, p->data, program->n_carry ? HG_HOIST_LANES : HG_HOIST_ROWS, 1));
    hg_status status = HG_OK;
    if (made.site) status = put(p->ctx, &d->site, p->dtype, (int64_t)made.site_count, made.site);
    if (status == HG_OK && made.groom_strand)
        status = put(p->ctx, &d->groom_strand, p->dtype, (int64_t)made.groom_strand_count, made.groom_strand);
    hg_free(made.site);
    hg_free(made.groom_strand);
    if (status == HG_OK) status = put(p->ctx, &d->column, HG_I32, p->n, p->column);
    HG_TRY(status);
    hg_strand_print_cuda(program, "strand_energies", &d->text);
    if (program->uniform) {
        int n_in;
        hg_function_inputs(program->uniform, &n_in);
        if (n_in > GIVEN_NUMBERS)
            return hg_fail(HG_UNSUPPORTED, "the energies are made of %d numbers; %d are possible on a GPU", n_in,
                           GIVEN_NUMBERS);
        print_values(program, &d->text);
        d->uniform = hg_tensor_create(p->ctx, p->dtype, 1, &(int64_t){ program->n_uniform });
        d->inputs = hg_tensor_create(p->ctx, HG_F64, 1, &(int64_t){ n_in });
        if (!d->uniform || !d->inputs) return HG_MEMORY;
    }
    if (d->text.failed) return HG_MEMORY;
    const size_t shared = hg_strand_cuda_shared(program, p->data->vertices);
    int warps = HG_STRAND_CUDA_THREADS / 32;
    while (warps > 1 && (size_t)warps * shared > SHARED) warps /= 2;
    d->strands = (hg_kernel){ .name = "strand_energies",
                              .cuda = d->text.data,
                              .args_size = sizeof(hg_strand_args),
                              .threads = program->n_carry ? CARRY_BLOCK : 32 * warps,
                              .indices = program->n_carry ? 0 : warps,
                              .shared = (size_t)warps * shared };
    d->values = (hg_kernel){ .name = "strand_values", .cuda = d->text.data, .args_size = sizeof(values_args) };
    snprintf(p->backend, sizeof p->backend, "%s", hg_ctx_device(p->ctx));
    return HG_OK;
}

static void free_device(hg_strand_pass *p)
{
    strand_device *d = &p->device;
    if (d->strands.name) {
        hg_kernel_release(p->ctx, &d->strands);
        hg_kernel_release(p->ctx, &d->values);
    }
    hg_text_free(&d->text);
    hg_tensor *const tensors[] = { d->site, d->groom_strand, d->column, d->uniform, d->inputs };
    for (size_t i = 0; i < sizeof tensors / sizeof *tensors; i++) hg_tensor_destroy(tensors[i]);
}

/* ---- which kernel ------------------------------------------------------------------------------------------- */

/* A groom of fewer vertices is interpreted where no kernel was printed for it: a second of the compiler is never won back. */
enum { WORTH_COMPILING = 10000 };

hg_status hg_strand_pass_backend(hg_strand_pass *pass, hg_ctx *ctx, hg_backend backend, const char *level)
{
    if (!hg_ctx_host(ctx)) { /* there is one way, and it is compiled */
        if (backend == HG_BACKEND_INTERPRETER || level)
            return hg_fail(HG_UNSUPPORTED, "the %s is of the processor; this context is on %s",
                           level ? level : "interpreter", hg_ctx_device(ctx));
        return pass->device.column ? HG_OK : prepare_device(pass);
    }
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
    p->ctx = ctx;
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
    free_device(pass);
    for (int j = 0; j < 2; j++) hg_tensor_destroy(pass->still[j]);
    hg_strand_program_destroy(pass->program);
    hg_free(pass->terms);
    hg_free(pass->column);
    hg_free(pass->hoisted.site);
    hg_free(pass->hoisted.groom_strand);
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

/* The values that are the same for all strands, from the numbers of this call. On a GPU they stay as they are until a number
 * changes; one that is there already is read there. */
static hg_status make_uniform(hg_strand_pass *p, const hg_frame *frame, int n_values, const hg_pass_value *values)
{
    const hg_strand_program *program = p->program;
    strand_device *d = &p->device;
    if (!program->uniform) return HG_OK;
    const bool host = hg_ctx_host(p->ctx);
    int n_in;
    const hg_input *inputs = hg_function_inputs(program->uniform, &n_in);
    values_args args = { .numbers = host ? NULL : d->inputs->data, .to = host ? NULL : d->uniform->data };
    bool given = false, same = true;
    for (int i = 0; i < n_in; i++) {
        const hg_pass_value *value = find_value(p, n_values, values, inputs[i].kind, inputs[i].name, inputs[i].term);
        if (value && !host) {
            args.given[i] = value->values;
            given = true;
            continue;
        }
        const double now = inputs[i].kind == HG_INPUT_WEIGHT  ? p->terms[inputs[i].term].weight
                           : value && p->dtype == HG_F64      ? *(const double *)value->values
                           : value                            ? (double)*(const float *)value->values
                           : inputs[i].kind == HG_INPUT_PARAM ? p->terms[inputs[i].term].params[inputs[i].name]
                                                              : frame->dt;
        same &= now == p->uniform_inputs[i];
        p->uniform_inputs[i] = now;
    }
    if (given) {
        const bool there = same && d->inputs_there;
        d->uniform_there = d->inputs_there = false; /* until it is */
        if (!there) HG_TRY(hg_tensor_write(d->inputs, p->uniform_inputs));
        d->inputs_there = true;
        return hg_launch(p->ctx, &d->values, 1, &args);
    }
    if (!host && same && d->uniform_there) return HG_OK;
    void *out[256];
    for (int j = 0; j < program->n_uniform; j++) out[j] = &p->uniform_values[j];
    hg_function_run(program->uniform, HG_F64, 1, NULL, p->uniform_inputs, out);
    for (int j = 0; j < program->n_uniform; j++) {
        if (p->dtype == HG_F64)
            ((double *)p->uniform)[j] = p->uniform_values[j];
        else
            ((float *)p->uniform)[j] = (float)p->uniform_values[j];
    }
    if (host) return HG_OK;
    d->uniform_there = d->inputs_there = false;
    HG_TRY(hg_tensor_write(d->uniform, p->uniform));
    d->uniform_there = true;
    return HG_OK;
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

/* Root frames where the frame brings none: identity at the rest root. j: 0 rotation, 1 position. */
static const void *still_roots(hg_strand_pass *p, const int32_t *groom, int64_t frames, int j)
{
    const int64_t S = p->data->strands, V = p->data->vertices, rows = p->data->grooms * S, width = j ? 3 : 4;
    if (!p->still[j]) {
        hg_tensor *made = hg_tensor_create(p->ctx, p->dtype, 1, &(int64_t){ rows * width });
        void *values = hg_alloc((size_t)(rows * width) + 1, hg_dtype_size(p->dtype));
        for (int64_t i = 0; values && i < rows * width; i++) {
            const double value = j ? p->data->rest[i / 3 * V * 3 + i % 3] : i % 4 == 0 ? 1 : 0;
            if (p->dtype == HG_F64)
                ((double *)values)[i] = value;
            else
                ((float *)values)[i] = (float)value;
        }
        if (!made || !values || hg_tensor_write(made, values) != HG_OK) {
            hg_tensor_destroy(made);
            made = NULL;
        }
        hg_free(values);
        p->still[j] = made;
    }
    return p->still[j] ? hg_physics_of_groom(p->ctx, p->dtype, groom, frames, S, width, p->still[j]->data) : NULL;
}

/* Where the kernel finds an array of the program, or NULL. */
static const void *array_data(const hg_frame *frame, const hg_tensor *x, const void *contact_point,
                              const void *contact_normal, const hg_strand_input *array, const hg_pass_value *value)
{
    const hg_tensor *brought = NULL;
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

/* Where the kernel reads and writes what the call brings and wants. */
static hg_status fill_args(hg_strand_pass *p, const hg_pass_call *call, const void *contact_point,
                           const void *contact_normal, hg_strand_args *args)
{
    const hg_strand_program *program = p->program;
    hg_ctx *ctx = p->ctx;
    const hg_frame *frame = call->frame;
    const int64_t frames = call->x->shape[0], S = p->data->strands, V = p->data->vertices;
    const size_t size = hg_dtype_size(p->dtype);
    for (int k = 0; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        const hg_pass_value *value = find_value(p, call->n_values, call->values, array->kind, array->name, 0);
        args->array[k] = array_data(frame, call->x, contact_point, contact_normal, array, value);
        if (!args->array[k]) return array_missing(p, array);
        args->array_gradient[k] = k == 0 ? call->gradient : value ? value->gradient : NULL;
        if (array->rest && args->array_gradient[k] && /* per frame first */
            !(args->array_gradient[k] = hg_step_device(ctx, (size_t)(frames * S * V * array->width) * size)))
            return HG_MEMORY;
    }
    if (uses(p, HG_INPUT_DT) && !(frame->dt > 0) && !find_value(p, call->n_values, call->values, HG_INPUT_DT, 0, 0))
        return missing(p, HG_INPUT_DT, "dt (a positive time step)");
    for (int j = 0; j < program->n_inputs; j++) {
        const hg_strand_input *input = &program->inputs[j];
        const hg_pass_value *value = find_value(p, call->n_values, call->values, input->kind, input->name, input->term);
        const hg_tensor *brought = j == 0 ? frame->root_rotation : j == 1 ? frame->root_position : NULL;
        args->strand_input[j] = brought          ? brought->data
                                : j < 2          ? still_roots(p, call->groom, frames, j)
                                : value->uniform ? hg_physics_repeat(ctx, p->dtype, 1, frames * S, value->values)
                                                 : value->values;
        args->strand_input_gradient[j] = value ? value->gradient : NULL;
        if (value && value->uniform && value->gradient &&
            !(args->strand_input_gradient[j] = hg_step_device(ctx, (size_t)(frames * S) * size)))
            return HG_MEMORY;
        if (!args->strand_input[j]) return HG_MEMORY;
    }
    return HG_OK;
}

/* One launch for all strands; rows: of args.energy. */
static hg_status launch(hg_strand_pass *p, strand_work *work, int64_t frames, int64_t *rows)
{
    static const hg_kernel
        lanes64 = { .name = "strand_energies", .args_size = sizeof *work, .cpu = strand_tiles, .block = 1 },
        few = { .name = "strand_energies", .args_size = sizeof *work, .cpu = strand_tiles, .block = 8 };
    hg_strand_args *args = &work->args;
    const strand_device *d = &p->device;
    const bool host = hg_ctx_host(p->ctx), carries = p->program->n_carry > 0;
    const int64_t strands = frames * p->data->strands;
    int64_t n = host ? frames * p->tiles : strands;
    *rows = host || carries ? n : (n + d->strands.indices - 1) / d->strands.indices;
    args->energy = hg_step_device(p->ctx, (size_t)(*rows * p->n) * sizeof(double) + 1);
    if (!args->energy) return hg_fail(HG_MEMORY, "out of memory for %lld strands", (long long)strands);
    if (host) return hg_launch(p->ctx, p->lanes >= 64 ? &lanes64 : &few, n, work);
    args->tiles = p->data->strands;
    args->count = n;
    args->site = d->site ? d->site->data : NULL;
    args->groom_strand = d->groom_strand ? d->groom_strand->data : NULL;
    args->uniform = d->uniform ? d->uniform->data : NULL;
    args->column = d->column->data;
    if (carries) {
        n = ((n < CARRY_MOST ? n : CARRY_MOST) + CARRY_BLOCK - 1) / CARRY_BLOCK * CARRY_BLOCK;
        args->scratch = hg_step_device(p->ctx, (size_t)n * hg_strand_cuda_scratch(p->program, p->data->vertices));
        if (!args->scratch) return hg_fail(HG_MEMORY, "out of memory for %lld strands", (long long)n);
    }
    return hg_launch(p->ctx, &d->strands, n, args);
}

hg_status hg_strand_pass_run(hg_strand_pass *p, const hg_pass_call *call, const void *contact_point,
                             const void *contact_normal)
{
    const hg_strand_program *program = p->program;
    hg_ctx *ctx = p->ctx;
    const int64_t frames = call->x->shape[0], S = p->data->strands, V = p->data->vertices;
    const int32_t *column = hg_ctx_host(ctx) ? p->column : p->device.column->data;
    if (frames * S == 0) return hg_physics_sums(ctx, HG_F64, NULL, 0, p->n, HG_F64, call->unweighted, column);
    if (hg_ctx_host(ctx)) HG_TRY(make_scratch(p, ctx));
    HG_TRY(make_uniform(p, call->frame, call->n_values, call->values));
    strand_work work = { .pass = p,
                         .args = { .strands = S,
                                   .vertices = V,
                                   .tiles = p->tiles,
                                   .groom = call->groom,
                                   .site = p->hoisted.site,
                                   .groom_strand = p->hoisted.groom_strand,
                                   .uniform = p->uniform,
                                   .per_strand = call->per_strand,
                                   .stride = call->stride,
                                   .column = p->column } };
    const hg_strand_args *args = &work.args;
    int64_t rows;
    HG_TRY(fill_args(p, call, contact_point, contact_normal, &work.args));
    HG_TRY(launch(p, &work, frames, &rows));
    HG_TRY(hg_physics_sums(ctx, HG_F64, args->energy, rows, p->n, HG_F64, call->unweighted, column));

    for (int k = 1; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        const hg_pass_value *value = find_value(p, call->n_values, call->values, array->kind, array->name, 0);
        if (array->rest && args->array_gradient[k])
            HG_TRY(hg_physics_groom_sum(ctx, p->dtype, call->groom, frames, p->data->grooms, S * V * array->width,
                                        args->array_gradient[k], value->gradient));
    }
    for (int j = 2; j < program->n_inputs; j++) {
        const hg_strand_input *input = &program->inputs[j];
        const hg_pass_value *value = find_value(p, call->n_values, call->values, input->kind, input->name, input->term);
        if (value->uniform && value->gradient)
            HG_TRY(hg_physics_sums(ctx, p->dtype, args->strand_input_gradient[j], frames * S, 1, p->dtype,
                                   value->gradient, NULL));
    }
    return HG_OK;
}
