/* The context: device, step arena, seed, caller, and the first error. */
#include "tensor/context.h"

#include <omp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* ---- life ---- */

/* "cpu", "cuda", "cuda:1", "auto". */
static hg_status open_device(hg_device **device, const char *name)
{
    *device = hg_cpu_device();
    if (!name || !name[0] || strcmp(name, "cpu") == 0) return HG_OK;
    if (strcmp(name, "auto") == 0) {
        hg_device *cuda;
        if (hg_cuda_open(&cuda, 0) == HG_OK) *device = cuda;
        return HG_OK;
    }
    if (strcmp(name, "cuda") == 0) return hg_cuda_open(device, 0);
    if (strncmp(name, "cuda:", 5) == 0 && name[5] >= '0' && name[5] <= '9') {
        char *end;
        const long number = strtol(name + 5, &end, 10);
        if (!*end && number < 1024) return hg_cuda_open(device, (int)number);
    }
    return hg_fail(HG_UNSUPPORTED, "device \"%s\" is not known: cpu, cuda, cuda:NUMBER and auto are", name);
}

hg_status hg_ctx_create(hg_ctx **ctx, const hg_ctx_options *options)
{
    *ctx = NULL;
    int threads = options ? options->threads : 0;
    if (threads < 0) return hg_fail(HG_INVALID, "threads is %d: give 1 or more, or 0 for all cores", threads);
    hg_device *device;
    HG_TRY(open_device(&device, options ? options->device : NULL));
    hg_ctx *c = hg_alloc(1, sizeof *c);
    if (!c) {
        if (device->close) device->close(device);
        return HG_MEMORY;
    }
    c->device = device;
    c->threads = threads > 0 ? threads : omp_get_max_threads();
    c->seed = options ? options->seed : 0;
    c->host.device = hg_cpu_device();
    c->data.device = device;
    *ctx = c;
    return HG_OK;
}

void hg_ctx_destroy(hg_ctx *ctx)
{
    if (!ctx) return;
    hg_step_reset(ctx);
    for (int i = 0; i < HG_HOOKS; i++)
        if (ctx->on_destroy[i]) ctx->on_destroy[i](ctx);
    hg_profile_stop(ctx);
    hg_ctx_destroy(ctx->beside);
    hg_arena_free(&ctx->host);
    hg_arena_free(&ctx->data);
    if (ctx->device->close) ctx->device->close(ctx->device);
    hg_free(ctx);
}

uint64_t hg_ctx_seed(const hg_ctx *ctx) { return ctx->seed; }
int hg_ctx_threads(const hg_ctx *ctx) { return ctx->threads; }
const char *hg_ctx_device(const hg_ctx *ctx) { return ctx->device->name; }
const char *hg_ctx_device_what(const hg_ctx *ctx) { return ctx->device->what; }
bool hg_ctx_host(const hg_ctx *ctx) { return ctx->device->host; }
hg_ctx *hg_ctx_on_host(hg_ctx *ctx)
{
    if (ctx->device->host) return ctx;
    const hg_ctx_options options = { .threads = ctx->threads, .seed = ctx->seed };
    if (!ctx->beside && hg_ctx_create(&ctx->beside, &options) != HG_OK)
        hg_ctx_fail(ctx, HG_MEMORY, "out of memory: a context of the processor");
    return ctx->beside;
}

hg_device_counts hg_ctx_counts(const hg_ctx *ctx) { return ctx->device->counts; }
hg_dtype hg_ctx_compute_dtype(const hg_ctx *ctx) { return ctx->compute; }
void **hg_ctx_tape(hg_ctx *ctx) { return &ctx->tape; }

hg_status hg_ctx_compute(hg_ctx *ctx, hg_dtype dtype)
{
    if (dtype != HG_F32 && dtype != HG_BF16 && dtype != HG_TF32)
        return hg_fail(HG_INVALID, "compute in %s: f32, tf32 and bf16 are possible", hg_dtype_name(dtype));
    HG_TRY(ctx->device->compute(ctx->device, dtype));
    ctx->compute = dtype;
    return HG_OK;
}

/* Each call is kept once. Floors with state of their own use these: eight is plenty, a ninth is told. */
#define ADD_HOOK(list_, what_)                                                                                         \
    do {                                                                                                               \
        int i = 0;                                                                                                     \
        while (i < HG_HOOKS && (list_)[i] && (list_)[i] != call) i++;                                                  \
        if (i < HG_HOOKS)                                                                                              \
            (list_)[i] = call;                                                                                         \
        else                                                                                                           \
            hg_ctx_fail(ctx, HG_INVALID, what_ ": there is room for %d calls", HG_HOOKS);                              \
    } while (0)

void hg_ctx_on_reset(hg_ctx *ctx, void (*call)(hg_ctx *)) { ADD_HOOK(ctx->on_reset, "hg_ctx_on_reset"); }
void hg_ctx_on_destroy(hg_ctx *ctx, void (*call)(hg_ctx *)) { ADD_HOOK(ctx->on_destroy, "hg_ctx_on_destroy"); }
void hg_ctx_on_tensor_destroy(hg_ctx *ctx, void (*call)(hg_tensor *))
{
    ADD_HOOK(ctx->on_tensor_destroy, "hg_ctx_on_tensor_destroy");
}

/* ---- errors ---- */

hg_ctx *hg_at(hg_ctx *ctx, const char *file, int line)
{
    if (ctx) {
        ctx->file = file;
        ctx->line = line;
    }
    return ctx;
}

const char *hg_ctx_caller(const hg_ctx *ctx, int *line)
{
    if (line) *line = ctx->line;
    return ctx->file;
}

hg_status hg_ctx_status(const hg_ctx *ctx) { return ctx->status; }
const char *hg_ctx_message(const hg_ctx *ctx) { return ctx->message; }

void hg_ctx_clear(hg_ctx *ctx)
{
    ctx->status = HG_OK;
    ctx->message[0] = 0;
    if (ctx->beside) hg_ctx_clear(ctx->beside);
}

hg_status hg_ctx_fail(hg_ctx *ctx, hg_status status, const char *format, ...)
{
    char text[HG_CTX_MESSAGE];
    va_list arguments;
    va_start(arguments, format);
    int length = vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (ctx->file && length >= 0 && (size_t)length < sizeof text)
        snprintf(text + length, sizeof text - (size_t)length, " (called at %s:%d)", ctx->file, ctx->line);
    if (ctx->status == HG_OK) {
        ctx->status = status;
        memcpy(ctx->message, text, sizeof text);
    }
    return hg_fail(status, "%s", text);
}

/* ---- step arena ---- */

void *hg_step_alloc(hg_ctx *ctx, size_t bytes)
{
    void *memory = hg_arena_alloc(&ctx->host, bytes);
    if (!memory) hg_ctx_fail(ctx, HG_MEMORY, "out of memory: %zu bytes for the step", bytes);
    return memory;
}

void *hg_step_device(hg_ctx *ctx, size_t bytes)
{
    void *memory = hg_arena_alloc(&ctx->data, bytes);
    if (!memory)
        hg_ctx_fail(ctx, HG_MEMORY, "out of memory: %zu bytes of the device for the step%s%s", bytes,
                    ctx->device->host ? "" : ": ", ctx->device->host ? "" : hg_message());
    return memory;
}

void hg_step_reset(hg_ctx *ctx)
{
    for (int i = 0; i < HG_HOOKS; i++)
        if (ctx->on_reset[i]) ctx->on_reset[i](ctx);
    hg_arena_reset(&ctx->host, ctx->guard);
    hg_arena_reset(&ctx->data, ctx->guard);
    if (ctx->beside) hg_step_reset(ctx->beside);
    ctx->file = NULL;
}

size_t hg_step_bytes(const hg_ctx *ctx) { return ctx->host.bytes + ctx->data.bytes; }
size_t hg_step_high_water(const hg_ctx *ctx) { return ctx->host.high_water + ctx->data.high_water; }
size_t hg_step_reserved(const hg_ctx *ctx) { return ctx->host.reserved + ctx->data.reserved; }

hg_step_mark hg_step_set_mark(const hg_ctx *ctx)
{
    const hg_arena *arenas[2] = { &ctx->host, &ctx->data };
    hg_step_mark mark;
    for (int i = 0; i < 2; i++) {
        mark.chunk[i] = arenas[i]->current;
        mark.used[i] = arenas[i]->current < arenas[i]->n_chunks ? arenas[i]->chunks[arenas[i]->current].used : 0;
    }
    return mark;
}

void hg_step_rewind(hg_ctx *ctx, hg_step_mark mark)
{
    hg_arena_rewind(&ctx->host, mark.chunk[0], mark.used[0]);
    hg_arena_rewind(&ctx->data, mark.chunk[1], mark.used[1]);
}

void hg_step_guard(hg_ctx *ctx, bool on) { ctx->guard = on; }

hg_status hg_step_check(hg_ctx *ctx)
{
    if (hg_arena_intact(&ctx->host) && hg_arena_intact(&ctx->data)) return HG_OK;
    return hg_ctx_fail(ctx, HG_INVALID, "memory of the step was written outside of what was asked for");
}

/* ---- kernels ---- */

hg_status hg_launch(hg_ctx *ctx, const hg_kernel *kernel, int64_t n, const void *args)
{
    if (n < 0) return hg_ctx_fail(ctx, HG_INVALID, "%s: launched over %lld indices", kernel->name, (long long)n);
    if (n == 0) return HG_OK;
    hg_status status = ctx->device->launch(ctx->device, ctx->threads, kernel, n, args);
    return status == HG_OK ? HG_OK : hg_ctx_fail(ctx, status, "%s", hg_message());
}

bool hg_launches(const hg_ctx *ctx, const hg_kernel *kernel) { return ctx->device->launches(ctx->device, kernel); }

void hg_kernel_release(hg_ctx *ctx, const hg_kernel *kernel)
{
    if (ctx->device->forget) ctx->device->forget(ctx->device, kernel);
}

static hg_status told(hg_ctx *ctx, hg_status status)
{
    return status == HG_OK ? HG_OK : hg_ctx_fail(ctx, status, "%s", hg_message());
}

hg_status hg_ctx_wait(hg_ctx *ctx) { return told(ctx, ctx->device->wait(ctx->device)); }

hg_status hg_step_record(hg_ctx *ctx)
{
    return ctx->device->record && !ctx->profile ? told(ctx, ctx->device->record(ctx->device)) : HG_OK;
}

hg_status hg_step_run(hg_ctx *ctx) { return ctx->device->run ? told(ctx, ctx->device->run(ctx->device)) : HG_OK; }

int hg_devices(hg_device_info *infos, int room)
{
    if (room > 0) {
        infos[0] = (hg_device_info){ .name = "cpu" };
        snprintf(infos[0].what, sizeof infos[0].what, "%d threads%s", omp_get_max_threads(),
                 hg_cpu_has_bf16() ? ", bf16 products" : "");
        const long page = sysconf(_SC_PAGESIZE), pages = sysconf(_SC_PHYS_PAGES), free = sysconf(_SC_AVPHYS_PAGES);
        if (page > 0 && pages > 0) infos[0].memory = (size_t)page * (size_t)pages;
        if (page > 0 && free > 0) infos[0].free = (size_t)page * (size_t)free;
    }
    return 1 + hg_cuda_list(infos + 1, room > 1 ? room - 1 : 0);
}

hg_status hg_product(hg_ctx *ctx, hg_dtype dtype, bool transpose_a, bool transpose_b, int64_t m, int64_t n, int64_t k,
                     double alpha, const void *a, int64_t lda, const void *b, int64_t ldb, double beta, void *c,
                     int64_t ldc)
{
    if (m < 0 || n < 0 || k < 0)
        return hg_ctx_fail(ctx, HG_INVALID, "product: sizes m %lld, n %lld, k %lld", (long long)m, (long long)n,
                           (long long)k);
    if (lda < (transpose_a ? m : k) || ldb < (transpose_b ? k : n) || ldc < n)
        return hg_ctx_fail(ctx, HG_INVALID,
                           "product: a row is longer than its leading dimension: m %lld, n %lld, "
                           "k %lld, lda %lld, ldb %lld, ldc %lld",
                           (long long)m, (long long)n, (long long)k, (long long)lda, (long long)ldb, (long long)ldc);
    if (m == 0 || n == 0) return HG_OK;
    size_t bytes = ctx->device->product_workspace(ctx->device, dtype, transpose_a, m, n, k);
    /* Of the step, so that it lies at the same place in the next one. */
    const hg_step_mark mark = hg_step_set_mark(ctx);
    void *workspace = bytes ? hg_step_device(ctx, bytes) : NULL;
    if (bytes && !workspace) return HG_MEMORY;
    hg_status status = ctx->device->product(ctx->device, ctx->threads, dtype, transpose_a, transpose_b, m, n, k, alpha,
                                            a, lda, b, ldb, beta, c, ldc, workspace);
    hg_step_rewind(ctx, mark);
    return status == HG_OK ? HG_OK : hg_ctx_fail(ctx, status, "%s", hg_message());
}

static hg_status convolve(hg_ctx *ctx, const hg_convolve_call *call)
{
    const hg_convolution *s = call->sizes;
    if (s->batch < 0 || s->in < 1 || s->out < 1 || s->kernel_height < 1 || s->kernel_width < 1 || s->stride < 1 ||
        s->padding < 0 || s->out_height < 1 || s->out_width < 1 ||
        (s->out_height - 1) * s->stride + s->kernel_height > s->height + 2 * s->padding ||
        (s->out_width - 1) * s->stride + s->kernel_width > s->width + 2 * s->padding)
        return hg_ctx_fail(ctx, HG_INVALID,
                           "convolution: [%lld,%lld,%lld,%lld], kernels [%lld,%lld,%lld,%lld], stride %lld, padding "
                           "%lld do not make [%lld,%lld]",
                           (long long)s->batch, (long long)s->in, (long long)s->height, (long long)s->width,
                           (long long)s->out, (long long)s->in, (long long)s->kernel_height, (long long)s->kernel_width,
                           (long long)s->stride, (long long)s->padding, (long long)s->out_height,
                           (long long)s->out_width);
    if (call->dtype != HG_F32 && call->dtype != HG_F64)
        return hg_ctx_fail(ctx, HG_UNSUPPORTED, "convolution: f32 and f64 are possible, not %s",
                           hg_dtype_name(call->dtype));
    if (s->batch == 0 && call->which != HG_CONVOLVE_TO_WEIGHT) return HG_OK;
    if (s->batch == 0) { /* a sum of nothing */
        const int64_t weights = s->out * s->in * s->kernel_height * s->kernel_width;
        hg_tensor *zeros = call->add ? NULL : hg_tensor_wrap(ctx, call->dtype, 1, &weights, call->weight);
        return call->add ? HG_OK : zeros ? hg_tensor_fill(zeros, 0) : HG_MEMORY;
    }
    size_t bytes = 0;
    hg_device *device = ctx->device;
    const hg_step_mark mark = hg_step_set_mark(ctx);
    HG_TRY(told(ctx, device->convolve_workspace(device, ctx->threads, call, &bytes)));
    void *workspace = bytes ? hg_step_device(ctx, bytes) : NULL;
    if (bytes && !workspace) return HG_MEMORY;
    const hg_status status = told(ctx, device->convolve(device, ctx->threads, call, workspace));
    hg_step_rewind(ctx, mark);
    return status;
}

/* The device's calls have one form, in which what is read is not const. */
#define MEMORY(pointer_) ((void *)(uintptr_t)(pointer_))

hg_status hg_convolve(hg_ctx *ctx, hg_dtype dtype, const hg_convolution *sizes, const void *x, const void *weight,
                      const void *bias, void *y)
{
    return convolve(ctx, &(hg_convolve_call){ .sizes = sizes,
                                              .which = HG_CONVOLVE,
                                              .dtype = dtype,
                                              .compute = ctx->compute,
                                              .x = MEMORY(x),
                                              .weight = MEMORY(weight),
                                              .bias = bias,
                                              .y = y });
}

hg_status hg_convolve_to_input(hg_ctx *ctx, hg_dtype dtype, const hg_convolution *sizes, const void *weight,
                               const void *dy, bool add, void *dx)
{
    return convolve(ctx, &(hg_convolve_call){ .sizes = sizes,
                                              .which = HG_CONVOLVE_TO_INPUT,
                                              .dtype = dtype,
                                              .compute = ctx->compute,
                                              .x = dx,
                                              .weight = MEMORY(weight),
                                              .y = MEMORY(dy),
                                              .add = add });
}

hg_status hg_convolve_to_weight(hg_ctx *ctx, hg_dtype dtype, const hg_convolution *sizes, const void *x, const void *dy,
                                bool add, void *dweight)
{
    return convolve(ctx, &(hg_convolve_call){ .sizes = sizes,
                                              .which = HG_CONVOLVE_TO_WEIGHT,
                                              .dtype = dtype,
                                              .compute = ctx->compute,
                                              .x = MEMORY(x),
                                              .weight = dweight,
                                              .y = MEMORY(dy),
                                              .add = add });
}
