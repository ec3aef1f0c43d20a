/* The driver's entry points that are not about streams: devices, the context, memory, modules. */
#include "ptx.h"
#include "streams.h"

#include <dlfcn.h>
#include <link.h>
#include <stdio.h>
#include <sys/mman.h>
#include <unistd.h>

using namespace emulated;

namespace
{
bool begun;
int retained;
thread_local void *context_now;
std::vector<function *> &functions = *new std::vector<function *>; /* kept: a graph may still hold one of an unloaded module */

struct error_name {
    int result;
    const char *name, *words;
};
const error_name names[] = { { SUCCESS, "CUDA_SUCCESS", "no error" },
                             { INVALID_VALUE, "CUDA_ERROR_INVALID_VALUE", "invalid argument" },
                             { OUT_OF_MEMORY, "CUDA_ERROR_OUT_OF_MEMORY", "out of memory" },
                             { NOT_INITIALIZED, "CUDA_ERROR_NOT_INITIALIZED", "initialization error" },
                             { NO_DEVICE, "CUDA_ERROR_NO_DEVICE", "no CUDA-capable device is detected" },
                             { INVALID_DEVICE, "CUDA_ERROR_INVALID_DEVICE", "invalid device ordinal" },
                             { INVALID_IMAGE, "CUDA_ERROR_INVALID_IMAGE", "device kernel image is invalid" },
                             { INVALID_CONTEXT, "CUDA_ERROR_INVALID_CONTEXT", "invalid device context" },
                             { INVALID_HANDLE, "CUDA_ERROR_INVALID_HANDLE", "invalid resource handle" },
                             { NOT_FOUND, "CUDA_ERROR_NOT_FOUND", "named symbol not found" },
                             { NOT_READY, "CUDA_ERROR_NOT_READY", "device not ready" },
                             { OUT_OF_RESOURCES, "CUDA_ERROR_LAUNCH_OUT_OF_RESOURCES", "too many resources requested for launch" },
                             { NOT_SUPPORTED, "CUDA_ERROR_NOT_SUPPORTED", "operation not supported" },
                             { CAPTURE_UNSUPPORTED, "CUDA_ERROR_STREAM_CAPTURE_UNSUPPORTED", "operation not permitted when stream is capturing" },
                             { CAPTURE_INVALIDATED, "CUDA_ERROR_STREAM_CAPTURE_INVALIDATED", "operation failed due to a previous error during capture" },
                             { 902, "CUDA_ERROR_STREAM_CAPTURE_MERGE", "operation would result in a merge of separate capture sequences" },
                             { CAPTURE_UNMATCHED, "CUDA_ERROR_STREAM_CAPTURE_UNMATCHED", "capture was not ended in the same stream as it began" },
                             { CAPTURE_UNJOINED, "CUDA_ERROR_STREAM_CAPTURE_UNJOINED", "capturing stream has unjoined work" },
                             { CAPTURE_ISOLATION, "CUDA_ERROR_STREAM_CAPTURE_ISOLATION", "dependency created on uncaptured work in another stream" },
                             { CAPTURED_EVENT, "CUDA_ERROR_CAPTURED_EVENT", "operation not permitted on an event last recorded in a capturing stream" },
                             { 908, "CUDA_ERROR_STREAM_CAPTURE_WRONG_THREAD", "attempt to terminate a thread-local capture sequence from another thread" },
                             { UPDATE_FAILURE, "CUDA_ERROR_GRAPH_EXEC_UPDATE_FAILURE", "the graph update was not performed because it included changes which violated constraints" },
                             { UNKNOWN, "CUDA_ERROR_UNKNOWN", "unknown error" } };
const error_name *find_name(int result)
{
    for (const error_name &n : names)
        if (n.result == result) return &n;
    return nullptr;
}
} // namespace

bool emulated::initialized() { return begun; }
int emulated::need_context(const char *what)
{
    if (!begun) return refuse(NOT_INITIALIZED, "%s before cuInit", what);
    if (!context_now || !retained) return refuse(INVALID_CONTEXT, "%s on a thread without a context (cuCtxSetCurrent)", what);
    return SUCCESS;
}

extern "C" {

/* ---- devices ---- */

int cuInit(unsigned flags)
{
    const entry e;
    if (setting("EMULATOR_NO_DEVICE")) return NO_DEVICE;
    begun = true;
    return flags ? INVALID_VALUE : SUCCESS;
}
int cuDriverGetVersion(int *version)
{
    const char *text = getenv("EMULATOR_DRIVER");
    return *version = text ? atoi(text) : 13000, 0;
}
int cuGetErrorName(int result, const char **name)
{
    const error_name *found = find_name(result);
    *name = found ? found->name : nullptr;
    return found ? SUCCESS : INVALID_VALUE;
}
int cuGetErrorString(int result, const char **words)
{
    const error_name *found = find_name(result);
    *words = found ? found->words : nullptr;
    return found ? SUCCESS : INVALID_VALUE;
}
int cuDeviceGetCount(int *n) { return *n = 1, begun ? SUCCESS : NOT_INITIALIZED; }
int cuDeviceGet(int *device, int number) { return *device = number, number == 0 ? SUCCESS : INVALID_DEVICE; }
int cuDeviceGetName(char *name, int size, int) { return snprintf(name, (size_t)size, "emulated GPU"), 0; }
int cuDeviceTotalMem_v2(size_t *bytes, int)
{
    size_t free;
    memory_figures(&free, bytes);
    return SUCCESS;
}
int cuDeviceGetAttribute(int *value, int attribute, int)
{
    static const int known[][2] = { { 1, 1024 }, { 2, 1024 }, { 3, 1024 }, { 4, 64 }, { 5, 0x7fffffff }, { 6, 65535 }, { 7, 65535 }, { 8, SHARED_USUAL },
                                    { 10, WARP }, { 12, 65536 }, { 13, 1500000 }, { 16, 4 }, { 36, 1500000 }, { 37, 128 }, { 38, 1 << 20 }, { 39, 2048 },
                                    { 40, 1 }, { 41, 1 }, { 75, 9 }, { 76, 0 }, { 81, 228 << 10 }, { 82, 65536 }, { 97, SHARED_MOST }, { 106, 32 } };
    const char *capability = getenv("EMULATOR_CAPABILITY"); /* 99: one that no NVRTC knows, so that it makes PTX */
    if (capability && (attribute == 75 || attribute == 76)) return *value = attribute == 75 ? atoi(capability) / 10 : atoi(capability) % 10, SUCCESS;
    for (const auto &k : known)
        if (k[0] == attribute) return *value = k[1], SUCCESS;
    return refuse(INVALID_VALUE, "cuDeviceGetAttribute: attribute %d is not emulated", attribute);
}
int cuDevicePrimaryCtxRetain(void **context, int device)
{
    const entry e;
    if (!begun) return refuse(NOT_INITIALIZED, "cuDevicePrimaryCtxRetain before cuInit");
    if (device != 0) return INVALID_DEVICE;
    retained++;
    *context = &state;
    return SUCCESS;
}
int cuDevicePrimaryCtxRelease_v2(int)
{
    const entry e;
    if (!retained) return refuse(INVALID_CONTEXT, "cuDevicePrimaryCtxRelease more often than it was retained");
    if (--retained) return SUCCESS;
    drain_all();
    if (const size_t left = forget_device()) stop("%zu allocations of device memory were not freed when the last context was released", left);
    return SUCCESS;
}
int cuCtxSetCurrent(void *context) { return context_now = context, SUCCESS; }
int cuCtxGetCurrent(void **context) { return *context = context_now, SUCCESS; }

int cuGetExportTable(const void **, const void *) { return NOT_FOUND; } /* the real NVRTC asks */

/* ---- memory ---- */

int cuMemGetInfo_v2(size_t *free, size_t *total)
{
    const entry e;
    memory_figures(free, total);
    return SUCCESS;
}
int cuMemAlloc_v2(unsigned long long *memory, size_t bytes)
{
    const entry e;
    if (const int failed = need_context("cuMemAlloc")) return failed;
    if (const int failed = in_capture("cuMemAlloc")) return failed;
    uintptr_t at = 0;
    const int status = allocate_device(&at, bytes);
    if (status == SUCCESS) *memory = at;
    return status;
}
int cuMemFree_v2(unsigned long long memory)
{
    const entry e;
    if (const int failed = need_context("cuMemFree")) return failed;
    if (const int failed = in_capture("cuMemFree")) return failed;
    drain_all();
    free_device((uintptr_t)memory);
    return SUCCESS;
}
int cuMemAllocHost_v2(void **memory, size_t bytes)
{
    const entry e;
    if (const int failed = need_context("cuMemAllocHost")) return failed;
    if (const int failed = in_capture("cuMemAllocHost")) return failed;
    *memory = allocate_pinned(bytes);
    return *memory ? SUCCESS : OUT_OF_MEMORY;
}
int cuMemFreeHost(void *memory)
{
    const entry e;
    if (const int failed = need_context("cuMemFreeHost")) return failed;
    if (const int failed = in_capture("cuMemFreeHost")) return failed;
    drain_all();
    free_pinned(memory);
    return SUCCESS;
}

/* ---- modules ---- */

int cuModuleLoadData(void **out, const void *image)
{
    const entry e;
    if (const int failed = need_context("cuModuleLoadData")) return failed;
    if (const int failed = in_capture("cuModuleLoadData")) return failed;
    const char *bytes = (const char *)image;
    std::string object, why;
    uint64_t size;
    if (memcmp(bytes, "EMULATED", 8) == 0) {
        memcpy(&size, bytes + 8, sizeof size);
        bytes += 16;
    } else { /* of the real NVRTC: a text */
        if (memcmp(bytes, "\177ELF", 4) == 0) return refuse(INVALID_IMAGE, "cuModuleLoadData: machine code of a GPU cannot be run here");
        if (!ptx_to_object(bytes, &object, &why)) return refuse(INVALID_IMAGE, "cuModuleLoadData: %s", why.c_str());
        bytes = object.data(), size = object.size();
    }
    auto m = std::make_shared<module>();
    m->file = memfd_create("emulated-module", MFD_CLOEXEC);
    for (size_t done = 0; m->file >= 0 && done < size;) {
        const ssize_t n = write(m->file, bytes + done, size - done);
        if (n <= 0) return refuse(INVALID_IMAGE, "cuModuleLoadData: the image could not be written to memory");
        done += (size_t)n;
    }
    static const bool global = [] { /* checked kernels find __tsan_read4 and the others here */
        Dl_info self;
        return dladdr((void *)cuInit, &self) && dlopen(self.dli_fname, RTLD_NOW | RTLD_GLOBAL | RTLD_NOLOAD);
    }();
    m->path = "/proc/self/fd/" + std::to_string(m->file);
    m->library = global ? dlopen(m->path.c_str(), RTLD_NOW | RTLD_LOCAL) : nullptr;
    if (!m->library) return refuse(INVALID_IMAGE, "cuModuleLoadData: %s", dlerror());
    m->contents = (emulator_module *)dlsym(m->library, "emulator_this_module");
    if (!m->contents) return refuse(INVALID_IMAGE, "cuModuleLoadData: the image is of another emulator");
    *m->contents->state = &state;
    struct where {
        uintptr_t inside, begin, end;
    } found = { (uintptr_t)m->contents, 0, 0 };
    dl_iterate_phdr(
        [](dl_phdr_info *info, size_t, void *user) {
            where *w = (where *)user;
            uintptr_t begin = UINTPTR_MAX, end = 0;
            for (int i = 0; i < info->dlpi_phnum; i++) {
                const auto &p = info->dlpi_phdr[i];
                if (p.p_type != PT_LOAD) continue;
                const uintptr_t at = info->dlpi_addr + p.p_vaddr;
                begin = at < begin ? at : begin, end = at + p.p_memsz > end ? at + p.p_memsz : end;
            }
            if (w->inside < begin || w->inside >= end) return 0;
            w->begin = begin, w->end = end;
            return 1;
        },
        &found);
    m->begin = found.begin, m->end = found.end;
    *out = new std::shared_ptr<module>(m);
    return SUCCESS;
}
int cuModuleUnload(void *handle)
{
    const entry e;
    auto *m = (std::shared_ptr<module> *)handle;
    for (function *f : functions)
        if (f->home == *m) f->home = nullptr;
    dlclose((*m)->library);
    close((*m)->file);
    delete m;
    return SUCCESS;
}
int cuModuleGetFunction(void **out, void *handle, const char *name)
{
    const entry e;
    auto &m = *(std::shared_ptr<module> *)handle;
    std::string all;
    for (emulator_kernel *k = m->contents->kernels; k; k = k->next) {
        if (strcmp(k->name, name) == 0) {
            function *f = new function;
            f->home = m, f->kernel = k, f->name = name;
            for (const size_t *size = k->sizes; *size; size++) f->sizes.push_back(*size);
            functions.push_back(f);
            *out = f;
            return SUCCESS;
        }
        all += std::string(all.empty() ? "" : ", ") + k->name;
    }
    return refuse(NOT_FOUND, "cuModuleGetFunction: there is no kernel %s in this module; there are: %s", name, all.c_str());
}
int cuFuncSetAttribute(void *f, int attribute, int value)
{
    const entry e;
    if (attribute != 8) return refuse(INVALID_VALUE, "cuFuncSetAttribute: attribute %d is not emulated", attribute);
    if (value < 0 || value > SHARED_MOST) return refuse(INVALID_VALUE, "cuFuncSetAttribute of %s: %d bytes of shared memory, a block has at most %d", ((function *)f)->name.c_str(), value, SHARED_MOST);
    ((function *)f)->most_dynamic = value > SHARED_USUAL ? value : SHARED_USUAL;
    return SUCCESS;
}
int cuFuncGetAttribute(int *value, int attribute, void *f)
{
    const entry e;
    const emulator_module *contents = ((function *)f)->home->contents;
    if (attribute == 0) return *value = MOST_THREADS, SUCCESS;
    if (attribute == 1) return *value = (int)(contents->shared_end - contents->shared_begin), SUCCESS;
    if (attribute == 8) return *value = ((function *)f)->most_dynamic, SUCCESS;
    return refuse(INVALID_VALUE, "cuFuncGetAttribute: attribute %d is not emulated", attribute);
}
}
