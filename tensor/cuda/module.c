/* From a kernel to a CUfunction: the file or text that it names goes through NVRTC once, for the device's architecture; the
 * result is kept in the cache on disk, under a hash of all that it depends on, and loaded from there the next time. */
#include "base/cache.h"
#include "tensor/cuda/device.h"

#include <stdio.h>
#include <string.h>
#include <unistd.h>

enum { FILES = 128, OPTIONS = 8 };

typedef struct loaded {
    const hg_kernel *kernel;
    CUfunction function;
    struct loaded *next;
} loaded;

struct hg_cuda_module {
    uint64_t key; /* of its text */
    CUmodule module;
    loaded *functions;
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

static hg_status make_source(const hg_kernel *kernel, hg_text *source)
{
    if (is_text(kernel->cuda)) {
        hg_text_add(source, "#include \"tensor/kernel.h\"\n%s\n", kernel->cuda);
    } else {
        const hg_kernel_file *file = find_file(kernel->cuda);
        if (!file)
            return hg_fail(HG_UNSUPPORTED, "%s: the library carries no file %s for CUDA", kernel->name, kernel->cuda);
        hg_text_add(source, "#include \"%s\"\n", file->name);
    }
    return source->failed ? HG_MEMORY : HG_OK;
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
    int n = 0, archs[64], best = 0;
    const int own = 10 * d->major + d->minor;
    d->api->nvrtcGetNumSupportedArchs(&n);
    if (n > 64) n = 64;
    int *all = hg_alloc(n > 0 ? (size_t)n : 1, sizeof *all);
    if (!all) return HG_MEMORY;
    d->api->nvrtcGetSupportedArchs(all);
    memcpy(archs, all, (size_t)n * sizeof *archs);
    hg_free(all);
    for (int i = 0; i < n; i++)
        if (archs[i] <= own && archs[i] > best) best = archs[i];
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

static hg_status compile(const hg_cuda_device *d, const hg_kernel *kernel, const char *source, const target *t,
                         void **image, size_t *size)
{
    const hg_cuda_api *api = d->api;
    const char *names[FILES], *texts[FILES];
    int n = 0;
    for (const hg_kernel_file *file = hg_kernel_files; file->name && n < FILES; file++, n++)
        names[n] = file->name, texts[n] = file->text;
    nvrtcProgram program;
    nvrtcResult result = api->nvrtcCreateProgram(&program, source, kernel->name, n, texts, names);
    if (result == 0) {
        result = api->nvrtcCompileProgram(program, t->n_options, t->options);
        size_t length = 0;
        char *log = NULL;
        if (result != 0 && api->nvrtcGetProgramLogSize(program, &length) == 0 && (log = hg_alloc(length + 1, 1)))
            api->nvrtcGetProgramLog(program, log);
        if (result != 0)
            hg_fail(HG_UNSUPPORTED, "cuda: %s does not compile (%s): %.600s", kernel->name,
                    api->nvrtcGetErrorString(result), log ? log : "");
        hg_free(log);
        if (result == 0)
            result = t->binary ? api->nvrtcGetCUBINSize(program, size) : api->nvrtcGetPTXSize(program, size);
        if (result == 0) {
            *image = hg_alloc(*size + 1, 1);
            if (*image) result = t->binary ? api->nvrtcGetCUBIN(program, *image) : api->nvrtcGetPTX(program, *image);
        }
        api->nvrtcDestroyProgram(&program);
    }
    if (result != 0 || !*image) return result != 0 ? HG_UNSUPPORTED : HG_MEMORY;
    return HG_OK;
}

/* ---- modules ---- */

static hg_cache_key key_of(const hg_cuda_device *d, const char *source, const target *t)
{
    hg_cache_key key = { { 0x6875646121, 1 } };
    const int versions[3] = { d->api->driver_version, d->api->nvrtc_major, d->api->nvrtc_minor };
    key = hg_cache_key_add(key, versions, sizeof versions);
    key = hg_cache_key_add(key, source, strlen(source));
    for (int i = 0; i < t->n_options; i++) key = hg_cache_key_add(key, t->options[i], strlen(t->options[i]) + 1);
    for (const hg_kernel_file *file = hg_kernel_files; file->name; file++)
        key = hg_cache_key_add(key, file->text, strlen(file->text));
    return key;
}

/* From the cache, or compiled and put there; a cache that cannot be used costs time, not the run. */
static hg_status find_image(const hg_cuda_device *d, const hg_kernel *kernel, const char *source, const target *t,
                            void **image, size_t *size)
{
    const hg_cache_key key = key_of(d, source, t);
    char *folder = NULL, *path = NULL;
    if (hg_cache_folder(&folder) == HG_OK) path = hg_cache_path(folder, key, t->binary ? "cubin" : "ptx");
    hg_status status = HG_OK;
    if (path && hg_cache_sealed(path, key)) {
        status = hg_file_read(path, image, size);
    } else {
        status = compile(d, kernel, source, t, image, size);
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

static hg_status make_module(hg_cuda_device *d, const hg_kernel *kernel, const char *source, uint64_t key,
                             hg_cuda_module **out)
{
    target t;
    void *image = NULL;
    size_t size = 0;
    HG_TRY(find_target(d, &t));
    hg_cuda_module *module = hg_alloc(1, sizeof *module);
    if (!module) return HG_MEMORY;
    hg_status status = find_image(d, kernel, source, &t, &image, &size);
    if (status == HG_OK) status = hg_cuda_check(d->api, d->api->cuModuleLoadData(&module->module, image), kernel->name);
    hg_free(image);
    if (status != HG_OK) {
        hg_free(module);
        return status;
    }
    module->key = key;
    module->next = d->modules;
    d->modules = *out = module;
    return HG_OK;
}

hg_status hg_cuda_function(hg_cuda_device *d, const hg_kernel *kernel, CUfunction *function)
{
    for (hg_cuda_module *module = d->modules; module; module = module->next)
        for (const loaded *f = module->functions; f; f = f->next)
            if (f->kernel == kernel) {
                *function = f->function;
                return HG_OK;
            }
    if (!kernel->cuda) return hg_fail(HG_UNSUPPORTED, "%s: this kernel has no body for cuda", kernel->name);
    hg_text source = { 0 };
    char name[128];
    hg_status status = make_source(kernel, &source);
    hg_cuda_module *module = NULL;
    loaded *f = hg_alloc(1, sizeof *f);
    if (!f) status = HG_MEMORY;
    if (status == HG_OK) {
        const uint64_t key = hg_hash(source.data, source.size, 0);
        for (module = d->modules; module && module->key != key;) module = module->next;
        if (!module) status = make_module(d, kernel, source.data, key, &module);
    }
    hg_text_free(&source);
    if (status == HG_OK) {
        snprintf(name, sizeof name, "%s_cuda", kernel->name);
        status = hg_cuda_check(d->api, d->api->cuModuleGetFunction(&f->function, module->module, name), name);
    }
    if (status == HG_OK && kernel->shared > 48 << 10)
        status = hg_cuda_check(
            d->api, d->api->cuFuncSetAttribute(f->function, CU_FUNC_MAX_DYNAMIC_SHARED, (int)kernel->shared), name);
    if (status != HG_OK) {
        hg_free(f);
        return status;
    }
    f->kernel = kernel;
    f->next = module->functions;
    module->functions = f;
    *function = f->function;
    return HG_OK;
}

void hg_cuda_forget(hg_device *device, const hg_kernel *kernel)
{
    hg_cuda_device *d = (hg_cuda_device *)(void *)device;
    for (hg_cuda_module *module = d->modules; module; module = module->next)
        for (loaded **at = &module->functions; *at; at = &(*at)->next)
            if ((*at)->kernel == kernel) {
                loaded *gone = *at;
                *at = gone->next;
                hg_free(gone);
                return;
            }
}

void hg_cuda_modules_free(hg_cuda_device *d)
{
    while (d->modules) {
        hg_cuda_module *module = d->modules;
        d->modules = module->next;
        while (module->functions) {
            loaded *f = module->functions;
            module->functions = f->next;
            hg_free(f);
        }
        d->api->cuModuleUnload(module->module);
        hg_free(module);
    }
}
