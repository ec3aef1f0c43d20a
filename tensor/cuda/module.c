/* From a kernel to a CUfunction: the file or text that it names goes through NVRTC once, for the device's architecture, with the
 * files that it includes; the result is kept in the cache on disk, under a hash of all that it depends on, and loaded from there
 * the next time. A kernel is known by its address, its module by its text. */
#include "base/cache.h"
#include "tensor/cuda/device.h"

#include <stdio.h>
#include <string.h>

enum { FILES = 128, OPTIONS = 4, LOG_LINES = 8 };

struct hg_cuda_module {
    uint64_t key; /* of its text */
    CUmodule module;
    bool carried; /* a file that the library carries: kept; a text of its own goes with the last of its kernels */
    int users;
    hg_cuda_module *next;
};

/* ---- sources ---- */

/* The file that the library carries under the longest name that `path` ends in; NULL: none. */
static const hg_kernel_file *find_file(const char *path)
{
    const size_t length = strlen(path);
    for (const hg_kernel_file *file = hg_kernel_files; file->name; file++) {
        const size_t n = strlen(file->name);
        if (n <= length && strcmp(path + length - n, file->name) == 0 && (n == length || path[length - n - 1] == '/'))
            return file;
    }
    return NULL;
}

static bool is_text(const char *cuda) { return strpbrk(cuda, "{;\n") != NULL; }

bool hg_cuda_has_function(const hg_kernel *kernel)
{
    return kernel->cuda && (is_text(kernel->cuda) || find_file(kernel->cuda));
}

/* What NVRTC is given: the text, and the files that it includes, directly or through others. */
typedef struct {
    hg_text text;
    const char *names[FILES], *texts[FILES];
    int n_files;
} source;

static void add_includes(source *s, const char *text)
{
    static const char mark[] = "#include ";
    for (const char *at = text; (at = strstr(at, mark));) {
        at += sizeof mark - 1;
        const char *end = *at == '"' ? strchr(at + 1, '"') : *at == '<' ? strchr(at + 1, '>') : NULL;
        if (!end) continue;
        const size_t length = (size_t)(end - at - 1);
        const hg_kernel_file *file = hg_kernel_files;
        while (file->name && (strncmp(file->name, at + 1, length) != 0 || file->name[length])) file++;
        bool known = !file->name; /* the processor's alone, behind an #ifdef; if not, NVRTC says so */
        for (int i = 0; i < s->n_files && !known; i++) known = s->names[i] == file->name;
        if (known || s->n_files == FILES) continue;
        s->names[s->n_files] = file->name;
        s->texts[s->n_files++] = file->text;
        add_includes(s, file->text);
    }
}

/* The text alone: of a kernel whose module is there nothing more is needed. */
static hg_status make_source(const hg_kernel *kernel, source *s)
{
    memset(s, 0, sizeof *s);
    if (is_text(kernel->cuda)) {
        hg_text_add(&s->text, "#include \"tensor/block.h\"\n#include \"tensor/math.h\"\n%s\n", kernel->cuda);
    } else {
        const hg_kernel_file *file = find_file(kernel->cuda);
        if (!file)
            return hg_fail(HG_UNSUPPORTED, "%s: the library carries no file %s for CUDA", kernel->name, kernel->cuda);
        hg_text_add(&s->text, "#include \"%s\"\n", file->name);
    }
    return s->text.failed ? HG_MEMORY : HG_OK;
}

/* ---- NVRTC ---- */

typedef struct {
    char arch[40];
    const char *options[OPTIONS];
    int n_options;
    bool binary; /* a cubin for this very architecture, else PTX that the driver compiles */
} target;

/* The device's architecture, or the newest that NVRTC knows below it. */
static hg_status find_target(const hg_cuda_device *d, target *t)
{
    int n = 0, best = 0;
    const int own = 10 * d->major + d->minor;
    d->api->nvrtcGetNumSupportedArchs(&n);
    int *archs = hg_alloc(n > 0 ? (size_t)n : 1, sizeof *archs);
    if (!archs) return HG_MEMORY;
    if (d->api->nvrtcGetSupportedArchs(archs) != 0) n = 0;
    for (int i = 0; i < n; i++)
        if (archs[i] <= own && archs[i] > best) best = archs[i];
    hg_free(archs);
    if (!best)
        return hg_fail(HG_UNSUPPORTED, "cuda: NVRTC %d.%d cannot compile for compute capability %d.%d",
                       d->api->nvrtc_major, d->api->nvrtc_minor, d->major, d->minor);
    t->binary = best == own;
    snprintf(t->arch, sizeof t->arch, "--gpu-architecture=%s_%d", t->binary ? "sm" : "compute", best);
    t->n_options = 0;
    t->options[t->n_options++] = t->arch;
    t->options[t->n_options++] = "--std=c++17";
    t->options[t->n_options++] = "-DHG_CUDA=1";
    return HG_OK;
}

/* The first lines of a compiler's log. */
static void shorten(char *log)
{
    for (int line = 0; *log; log++)
        if (*log == '\n' && ++line == LOG_LINES) {
            *log = 0;
            return;
        }
}

static hg_status compile(const hg_cuda_device *d, const hg_kernel *kernel, const source *s, const target *t,
                         void **image, size_t *size)
{
    const hg_cuda_api *api = d->api;
    nvrtcProgram program;
    nvrtcResult result = api->nvrtcCreateProgram(&program, s->text.data, kernel->name, s->n_files, s->texts, s->names);
    if (result != 0)
        return hg_fail(HG_UNSUPPORTED, "cuda: %s cannot be compiled: %s", kernel->name,
                       api->nvrtcGetErrorString(result));
    hg_status status = HG_OK;
    result = api->nvrtcCompileProgram(program, t->n_options, t->options);
    if (result != 0) {
        size_t length = 0;
        char *log = NULL;
        if (api->nvrtcGetProgramLogSize(program, &length) == 0 && (log = hg_alloc(length + 1, 1)) &&
            api->nvrtcGetProgramLog(program, log) == 0)
            shorten(log);
        status = hg_fail(HG_UNSUPPORTED, "cuda: %s (%s) does not compile: %s\n%s", kernel->name,
                         is_text(kernel->cuda) ? "a text of its own" : find_file(kernel->cuda)->name,
                         api->nvrtcGetErrorString(result), log ? log : "");
        hg_free(log);
    } else {
        result = t->binary ? api->nvrtcGetCUBINSize(program, size) : api->nvrtcGetPTXSize(program, size);
        if (result == 0) {
            *image = hg_alloc(*size + 1, 1);
            if (!*image) status = HG_MEMORY;
        }
        if (*image) result = t->binary ? api->nvrtcGetCUBIN(program, *image) : api->nvrtcGetPTX(program, *image);
        if (result != 0)
            status = hg_fail(HG_UNSUPPORTED, "cuda: %s: NVRTC gave nothing back: %s", kernel->name,
                             api->nvrtcGetErrorString(result));
    }
    api->nvrtcDestroyProgram(&program);
    return status;
}

/* ---- modules ---- */

static hg_cache_key key_of(const hg_cuda_device *d, const source *s, const target *t)
{
    hg_cache_key key = { { 0x6875646121, 2 } };
    const int versions[3] = { d->api->driver_version, d->api->nvrtc_major, d->api->nvrtc_minor };
    key = hg_cache_key_add(key, versions, sizeof versions);
    key = hg_cache_key_add(key, s->text.data, s->text.size);
    for (int i = 0; i < t->n_options; i++) key = hg_cache_key_add(key, t->options[i], strlen(t->options[i]) + 1);
    for (int i = 0; i < s->n_files; i++) {
        key = hg_cache_key_add(key, s->names[i], strlen(s->names[i]));
        key = hg_cache_key_add(key, s->texts[i], strlen(s->texts[i]));
    }
    return key;
}

/* From the cache, or compiled and put there; a cache that cannot be used costs time, not the run. */
static hg_status find_image(const hg_cuda_device *d, const hg_kernel *kernel, const source *s, const target *t,
                            void **image, size_t *size)
{
    const hg_cache_key key = key_of(d, s, t);
    char *folder = NULL, *path = NULL;
    if (hg_cache_folder(&folder) == HG_OK) path = hg_cache_path(folder, key, t->binary ? "cubin" : "ptx");
    hg_status status = HG_OK;
    if (!path || hg_cache_read(path, key, image, size) != HG_OK) {
        status = compile(d, kernel, s, t, image, size);
        char *workshop = NULL, *made = NULL;
        if (status == HG_OK && path && hg_cache_workshop(folder, &workshop) == HG_OK) {
            made = hg_path_join(workshop, "image");
            if (made && hg_file_write(made, *image, *size) == HG_OK) hg_cache_seal(made, path, key);
            hg_free(made);
            hg_cache_workshop_end(workshop);
        }
    }
    hg_free(folder);
    hg_free(path);
    return status;
}

static hg_status make_module(hg_cuda_device *d, const hg_kernel *kernel, source *s, uint64_t key, hg_cuda_module **out)
{
    target t;
    void *image = NULL;
    size_t size = 0;
    HG_TRY(find_target(d, &t));
    add_includes(s, s->text.data);
    hg_cuda_module *module = hg_alloc(1, sizeof *module);
    if (!module) return HG_MEMORY;
    hg_status status = find_image(d, kernel, s, &t, &image, &size);
    if (status == HG_OK) status = hg_cuda_check(d->api, d->api->cuModuleLoadData(&module->module, image), kernel->name);
    hg_free(image);
    if (status != HG_OK) {
        hg_free(module);
        return status;
    }
    module->key = key;
    module->carried = !is_text(kernel->cuda);
    module->next = d->modules;
    d->modules = *out = module;
    return HG_OK;
}

static hg_status find_module(hg_cuda_device *d, const hg_kernel *kernel, hg_cuda_module **out)
{
    source s;
    hg_status status = make_source(kernel, &s);
    if (status == HG_OK) {
        const uint64_t key = hg_hash(s.text.data, s.text.size, 0);
        for (*out = d->modules; *out && (*out)->key != key;) *out = (*out)->next;
        if (!*out) status = make_module(d, kernel, &s, key, out);
    }
    hg_text_free(&s.text);
    return status;
}

static void unload(hg_cuda_device *d, hg_cuda_module *module)
{
    hg_cuda_module **at = &d->modules;
    while (*at != module) at = &(*at)->next;
    *at = module->next;
    d->api->cuModuleUnload(module->module);
    hg_free(module);
}

/* ---- kernels by address ---- */

/* Where a kernel is, or would be: its cell of a table that is never full. */
static hg_cuda_kernel *cell(hg_cuda_kernel *table, int room, const hg_kernel *kernel)
{
    uint64_t at = (uint64_t)(uintptr_t)kernel * 0x9e3779b97f4a7c15u >> 32;
    while (table[at & (uint64_t)(room - 1)].kernel && table[at & (uint64_t)(room - 1)].kernel != kernel) at++;
    return &table[at & (uint64_t)(room - 1)];
}

static hg_status grow_table(hg_cuda_device *d)
{
    const int room = d->n_room ? 2 * d->n_room : 64;
    hg_cuda_kernel *table = hg_alloc((size_t)room, sizeof *table);
    if (!table) return HG_MEMORY;
    for (int i = 0; i < d->n_room; i++)
        if (d->kernels[i].kernel) *cell(table, room, d->kernels[i].kernel) = d->kernels[i];
    hg_free(d->kernels);
    d->kernels = table;
    d->n_room = room;
    return HG_OK;
}

/* Those behind it, up to the next gap, may stand where they stand because of it: each is put in anew. */
static void take_out(hg_cuda_device *d, const hg_kernel *kernel)
{
    hg_cuda_kernel *gone = cell(d->kernels, d->n_room, kernel);
    *gone = (hg_cuda_kernel){ 0 };
    d->n_kernels--;
    for (int i = (int)(gone - d->kernels);;) {
        i = (i + 1) % d->n_room;
        const hg_cuda_kernel k = d->kernels[i];
        if (!k.kernel) return;
        d->kernels[i] = (hg_cuda_kernel){ 0 };
        *cell(d->kernels, d->n_room, k.kernel) = k;
    }
}

static hg_status add_kernel(hg_cuda_device *d, const hg_kernel *kernel, CUfunction *function)
{
    if (!kernel->cuda) return hg_fail(HG_UNSUPPORTED, "%s: this kernel has no body for cuda", kernel->name);
    hg_cuda_kernel k = { .kernel = kernel };
    char name[128];
    HG_TRY(find_module(d, kernel, &k.module));
    snprintf(name, sizeof name, "%s_cuda", kernel->name);
    hg_status status = hg_cuda_check(d->api, d->api->cuModuleGetFunction(&k.function, k.module->module, name), name);
    if (status == HG_OK && kernel->shared > 48 << 10)
        status = hg_cuda_check(d->api,
                               d->api->cuFuncSetAttribute(k.function, CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES,
                                                          (int)kernel->shared),
                               name);
    if (status == HG_OK && 2 * (d->n_kernels + 1) > d->n_room) status = grow_table(d);
    if (status != HG_OK) {
        if (!k.module->carried && k.module->users == 0) unload(d, k.module);
        return status;
    }
    *cell(d->kernels, d->n_room, kernel) = k;
    d->n_kernels++;
    k.module->users++;
    *function = k.function;
    return HG_OK;
}

hg_status hg_cuda_function(hg_cuda_device *d, const hg_kernel *kernel, CUfunction *function)
{
    if (d->n_room) {
        const hg_cuda_kernel *k = cell(d->kernels, d->n_room, kernel);
        *function = k->function;
        if (k->kernel) return HG_OK;
    }
    return add_kernel(d, kernel, function);
}

/* The module of a text goes with the last of its kernels, and with it every graph, since one may hold a function of it. */
void hg_cuda_forget(hg_device *device, const hg_kernel *kernel)
{
    hg_cuda_device *d = (hg_cuda_device *)(void *)device;
    const hg_cuda_kernel *k = d->n_room ? cell(d->kernels, d->n_room, kernel) : NULL;
    if (!k || !k->kernel || hg_cuda_enter(d) != HG_OK) return;
    hg_cuda_module *module = k->module;
    hg_cuda_flush_untold(d);
    if (d->last == kernel->name) d->last = "a kernel that is gone";
    take_out(d, kernel);
    if (--module->users > 0 || module->carried) return;
    d->api->cuStreamSynchronize(d->stream);
    hg_cuda_graphs_forget(d);
    unload(d, module);
}

void hg_cuda_modules_free(hg_cuda_device *d)
{
    while (d->modules) unload(d, d->modules);
    hg_free(d->kernels);
    d->kernels = NULL;
    d->n_kernels = d->n_room = 0;
}
