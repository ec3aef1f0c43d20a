/* Streams, events, copies and launches. */
#include "streams.h"

#include <dlfcn.h>
#include <time.h>
#include <algorithm>

using namespace emulated;

namespace emulated
{
namespace
{
enum { MOST_WAITING = 4096 };
constexpr size_t MOST_STAGED = (size_t)128 << 20;
std::recursive_mutex &lock = *new std::recursive_mutex;
std::map<void *, std::shared_ptr<stream>> &streams = *new std::map<void *, std::shared_ptr<stream>>;
std::map<void *, std::shared_ptr<event>> &events = *new std::map<void *, std::shared_ptr<event>>;

double seconds()
{
    timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

void call_library(const operation &o)
{
    typedef int (*get)();
    typedef void (*set)(int);
    static const get threads = (get)dlsym(RTLD_DEFAULT, "omp_get_max_threads");
    static const set set_threads = (set)dlsym(RTLD_DEFAULT, "omp_set_num_threads");
    const int usual = threads && set_threads ? threads() : 0;
    if (usual) set_threads(1); /* the right to touch device memory is this thread's alone */
    calling = o.name.c_str();
    o.call(o.data.data());
    calling = nullptr;
    if (usual) set_threads(usual);
}

void run(const operation &o)
{
    switch (o.is) {
    case operation::KERNEL:
        if (!o.kernel.what->home) stop("%s is launched, but its module has been unloaded", o.kernel.what->name.c_str());
        run_kernel(o.kernel);
        break;
    case operation::UPLOAD: memcpy((void *)o.to, o.staged ? o.data.data() : (const char *)o.from, o.bytes); break;
    case operation::DOWNLOAD:
    case operation::COPY: memmove((void *)o.to, (const void *)o.from, o.bytes); break;
    case operation::FILL:
        for (size_t i = 0; i < o.bytes; i += (size_t)o.width) memcpy((char *)o.to + i, &o.value, (size_t)o.width);
        break;
    case operation::CALL: call_library(o); break;
    case operation::HOST: o.host(o.user); break;
    case operation::RECORD: o.mark->time = seconds(); break;
    case operation::WAIT: drain(*o.other, o.serial); break;
    case operation::GRAPH:
        for (const operation &part : *o.graph) run(part);
        break;
    }
}

bool uploads_from(const operation &o, uintptr_t at, size_t bytes)
{
    if (o.is == operation::GRAPH) return std::any_of(o.graph->begin(), o.graph->end(), [=](const operation &part) { return uploads_from(part, at, bytes); });
    return o.is == operation::UPLOAD && !o.staged && o.from < at + bytes && at < o.from + o.bytes;
}

/* What will be written some time: whoever reads it before it was waited for is to see it. Not what is still to be uploaded. */
void spoil_destination(const operation &o, const operation &whole)
{
    if (o.is == operation::GRAPH)
        for (const operation &part : *o.graph) spoil_destination(part, whole);
    if (o.is != operation::DOWNLOAD || !in_pinned(o.to, o.bytes) || uploads_from(whole, o.to, o.bytes)) return;
    for (const auto &s : streams)
        for (const operation &w : s.second->waiting)
            if (uploads_from(w, o.to, o.bytes)) return;
    memset((void *)o.to, 0xff, o.bytes);
}
} // namespace

entry::entry()
{
    lock.lock();
    watch_signals();
}
entry::~entry() { lock.unlock(); }

std::shared_ptr<stream> find_stream(void *handle)
{
    auto found = streams.find(handle);
    if (found != streams.end()) return found->second;
    if (handle) return nullptr;
    return streams[nullptr] = std::make_shared<stream>();
}

void drain(stream &s, uint64_t until)
{
    const memory_rights rights;
    while (!s.waiting.empty() && s.done < until) {
        const operation o = std::move(s.waiting.front());
        s.waiting.pop_front();
        s.staged -= o.data.size();
        run(o);
        s.done++;
    }
}

void drain_all()
{
    for (auto &s : streams) drain(*s.second, UINT64_MAX);
}

int in_capture(const char *what)
{
    for (auto &s : streams) {
        capture *c = s.second->captured.get();
        if (!c || c->mode == 2 || (c->mode == 1 && !pthread_equal(c->thread, pthread_self()))) continue;
        c->invalid = true;
        return refuse(CAPTURE_UNSUPPORTED, "%s while a stream is captured", what);
    }
    return SUCCESS;
}

int enqueue(void *handle, operation &&o)
{
    std::shared_ptr<stream> s = find_stream(handle);
    if (!s) return refuse(INVALID_HANDLE, "%p is no stream", handle);
    if (s->captured) {
        capture &c = *s->captured;
        if (c.invalid) return CAPTURE_INVALIDATED;
        c.list.push_back(std::move(o));
        s->last = c.list.size();
        return SUCCESS;
    }
    if (!handle) {
        if (const int failed = in_capture("work on the default stream")) return failed;
        for (auto &other : streams)
            if (!other.second->non_blocking) drain(*other.second, UINT64_MAX);
    }
    spoil_destination(o, o);
    s->staged += o.data.size();
    s->waiting.push_back(std::move(o));
    if (!handle || setting("CUDA_LAUNCH_BLOCKING") || s->waiting.size() > MOST_WAITING || s->staged > MOST_STAGED) drain(*s, UINT64_MAX);
    return SUCCESS;
}

/* ---- what copies are given ---- */

namespace
{
int check_device(const char *what, uintptr_t at, size_t bytes)
{
    const allocation a = find_device(at);
    if (a.end && at + bytes <= a.end) return SUCCESS;
    if (!a.end && !in_device_region(at)) stop("%s: %#zx is not memory of the device: %s", what, (size_t)at, describe_address(at).c_str());
    return refuse(INVALID_VALUE, "%s of %zu bytes at %#zx: %s", what, bytes, (size_t)at, describe_address(at).c_str());
}

void check_host(const char *what, uintptr_t at)
{
    if (in_device_region(at)) stop("%s: %#zx is memory of the device where the host's is expected", what, (size_t)at);
    if (at < PAGE) stop("%s: a NULL pointer where the host's memory is expected", what);
}

int copy(operation::kind is, const char *what, uintptr_t to, uintptr_t from, size_t bytes, void *handle)
{
    const entry e;
    if (const int failed = need_context(what)) return failed;
    if (bytes == 0) return SUCCESS;
    operation o;
    o.is = is, o.to = to, o.from = from, o.bytes = bytes;
    if (is == operation::DOWNLOAD) check_host(what, to);
    else if (const int failed = check_device(what, to, bytes)) return failed;
    if (is == operation::UPLOAD) check_host(what, from);
    else if (const int failed = check_device(what, from, bytes)) return failed;
    const std::shared_ptr<stream> s = find_stream(handle);
    const bool captured = s && s->captured;
    if (is == operation::UPLOAD && !captured && !in_pinned(from, bytes)) {
        o.staged = true;
        o.data.assign((const char *)from, (const char *)from + bytes);
    }
    const int status = enqueue(handle, std::move(o));
    /* Into pageable memory CUDA copies before it returns. */
    if (status == SUCCESS && is == operation::DOWNLOAD && !captured && !in_pinned(to, bytes)) drain(*s, UINT64_MAX);
    return status;
}

int fill(const char *what, uintptr_t to, unsigned value, int width, size_t n, void *handle)
{
    const entry e;
    if (const int failed = need_context(what)) return failed;
    if (n == 0) return SUCCESS;
    if (const int failed = check_device(what, to, n * (size_t)width)) return failed;
    if (to % (uintptr_t)width) return refuse(INVALID_VALUE, "%s: %#zx is misaligned", what, (size_t)to);
    operation o;
    o.is = operation::FILL, o.to = to, o.value = value, o.width = width, o.bytes = n * (size_t)width;
    return enqueue(handle, std::move(o));
}

/* A pointer to the host's memory among the arguments of a kernel. Numbers are rarely the address of a page that is there; a small
 * one with a gap after it that holds half of a pointer may be. */
void check_arguments(const function &f, const std::vector<char> &args)
{
    size_t at = 0, number = 0;
    for (size_t size : f.sizes) {
        for (size_t i = 0; i + 8 <= size; i += 8) {
            uint64_t word;
            memcpy(&word, args.data() + at + i, sizeof word);
            const uint32_t low = (uint32_t)word;
            if (low < 1u << 20 || low > ~0u - (1u << 20)) continue;
            if (word < (uint64_t)1 << 40 || word >> 47 || in_device_region(word) || in_pinned(word, 1) || !mapped_on_host(word)) continue;
            stop("launch of %s: argument %zu, byte %zu: %#zx is memory of the host, which a kernel cannot reach", f.name.c_str(), number, i, (size_t)word);
        }
        at += (size + 15) / 16 * 16;
        number++;
    }
}
} // namespace
} // namespace emulated

extern "C" {

/* ---- streams ---- */

int cuStreamCreate(void **out, unsigned flags)
{
    const entry e;
    if (const int failed = need_context("cuStreamCreate")) return failed;
    if (flags > 1) return refuse(INVALID_VALUE, "cuStreamCreate: flags %u", flags);
    auto s = std::make_shared<stream>();
    s->non_blocking = flags == 1;
    *out = s.get();
    streams[*out] = s;
    return SUCCESS;
}
int cuStreamDestroy_v2(void *handle)
{
    const entry e;
    auto s = find_stream(handle);
    if (!s || !handle) return refuse(INVALID_HANDLE, "cuStreamDestroy: %p is no stream", handle);
    if (s->captured) return refuse(CAPTURE_UNSUPPORTED, "cuStreamDestroy of a stream that is captured");
    drain(*s, UINT64_MAX);
    streams.erase(handle);
    return SUCCESS;
}
int cuStreamSynchronize(void *handle)
{
    const entry e;
    if (const int failed = need_context("cuStreamSynchronize")) return failed;
    auto s = find_stream(handle);
    if (!s) return refuse(INVALID_HANDLE, "cuStreamSynchronize: %p is no stream", handle);
    if (s->captured) {
        s->captured->invalid = true;
        return refuse(CAPTURE_UNSUPPORTED, "cuStreamSynchronize on a stream that is captured");
    }
    if (const int failed = in_capture("cuStreamSynchronize")) return failed;
    drain(*s, UINT64_MAX);
    return setting("EMULATOR_FAIL") ? UNKNOWN : SUCCESS;
}
/* Time passes while somebody asks: one operation a question. */
int cuStreamQuery(void *handle)
{
    const entry e;
    auto s = find_stream(handle);
    if (!s) return refuse(INVALID_HANDLE, "cuStreamQuery: %p is no stream", handle);
    if (s->captured) {
        s->captured->invalid = true;
        return refuse(CAPTURE_UNSUPPORTED, "cuStreamQuery on a stream that is captured");
    }
    if (s->waiting.empty()) return SUCCESS;
    drain(*s, s->done + 1);
    return NOT_READY;
}
int cuCtxSynchronize()
{
    const entry e;
    if (const int failed = need_context("cuCtxSynchronize")) return failed;
    if (const int failed = in_capture("cuCtxSynchronize")) return failed;
    drain_all();
    return SUCCESS;
}
int cuLaunchHostFunc(void *handle, void (*call)(void *), void *user)
{
    const entry e;
    operation o;
    o.is = operation::HOST, o.host = call, o.user = user;
    return enqueue(handle, std::move(o));
}
/* See enqueue.h. */
int emulator_enqueue(void *handle, const char *name, void (*call)(const void *), const void *bytes, size_t size)
{
    const entry e;
    operation o;
    o.is = operation::CALL, o.name = name, o.call = call;
    o.data.assign((const char *)bytes, (const char *)bytes + size);
    return enqueue(handle, std::move(o));
}

/* ---- events ---- */

int cuEventCreate(void **out, unsigned flags)
{
    const entry e;
    if (const int failed = need_context("cuEventCreate")) return failed;
    auto made = std::make_shared<event>();
    made->timed = !(flags & 2);
    *out = made.get();
    events[*out] = made;
    return SUCCESS;
}
int cuEventDestroy_v2(void *handle)
{
    const entry e;
    return events.erase(handle) ? SUCCESS : refuse(INVALID_HANDLE, "cuEventDestroy: %p is no event", handle);
}
static std::shared_ptr<event> find_event(void *handle)
{
    auto found = events.find(handle);
    return found == events.end() ? nullptr : found->second;
}
int cuEventRecord(void *handle, void *on)
{
    const entry e;
    auto s = find_stream(on);
    auto mark = find_event(handle);
    if (!s || !mark) return refuse(INVALID_HANDLE, "cuEventRecord: no such %s", s ? "event" : "stream");
    if (s->captured) { /* no work: a place that other streams can wait for */
        if (s->captured->invalid) return CAPTURE_INVALIDATED;
        mark->captured = s->captured, mark->captured_on = s.get(), mark->captured_at = s->captured->list.size();
        return SUCCESS;
    }
    mark->captured = nullptr;
    mark->where = s;
    mark->serial = s->done + s->waiting.size() + 1;
    operation o;
    o.is = operation::RECORD, o.mark = mark;
    return enqueue(on, std::move(o));
}
static int usable_event(const char *what, const std::shared_ptr<event> &mark)
{
    if (!mark) return refuse(INVALID_HANDLE, "%s: no such event", what);
    if (!mark->captured) return SUCCESS;
    mark->captured->invalid = true;
    return refuse(CAPTURED_EVENT, "%s of an event that was recorded in a capture", what);
}
int cuEventSynchronize(void *handle)
{
    const entry e;
    auto mark = find_event(handle);
    if (const int failed = usable_event("cuEventSynchronize", mark)) return failed;
    if (const int failed = in_capture("cuEventSynchronize")) return failed;
    if (mark->where) drain(*mark->where, mark->serial);
    return SUCCESS;
}
int cuEventQuery(void *handle)
{
    const entry e;
    auto mark = find_event(handle);
    if (const int failed = usable_event("cuEventQuery", mark)) return failed;
    if (!mark->where || mark->where->done >= mark->serial) return SUCCESS;
    drain(*mark->where, mark->where->done + 1);
    return NOT_READY;
}
int cuEventElapsedTime_v2(float *milliseconds, void *begin, void *end)
{
    const entry e;
    auto a = find_event(begin), b = find_event(end);
    if (!a || !b || !a->where || !b->where || !a->timed || !b->timed) return refuse(INVALID_HANDLE, "cuEventElapsedTime of events without times");
    if (a->where->done < a->serial || b->where->done < b->serial) return NOT_READY;
    *milliseconds = (float)((b->time - a->time) * 1e3);
    return SUCCESS;
}
int cuEventElapsedTime(float *milliseconds, void *begin, void *end) { return cuEventElapsedTime_v2(milliseconds, begin, end); }
int cuStreamWaitEvent(void *handle, void *on, unsigned)
{
    const entry e;
    auto s = find_stream(handle);
    auto mark = find_event(on);
    if (!s || !mark) return refuse(INVALID_HANDLE, "cuStreamWaitEvent: no such %s", s ? "event" : "stream");
    if (mark->captured) {
        if (s->captured && s->captured != mark->captured) return refuse(902, "cuStreamWaitEvent: two captures would become one");
        if (!s->captured) { /* the stream joins the capture */
            s->captured = mark->captured;
            s->last = s->joined = 0;
            mark->captured->members.push_back(s.get());
        }
        if (mark->captured_on != s.get()) mark->captured_on->joined = std::max(mark->captured_on->joined, mark->captured_at);
        return SUCCESS;
    }
    if (s->captured) {
        s->captured->invalid = true;
        return refuse(CAPTURE_ISOLATION, "cuStreamWaitEvent: a stream that is captured cannot wait for work outside of the capture");
    }
    if (!mark->where) return SUCCESS;
    operation o;
    o.is = operation::WAIT, o.other = mark->where, o.serial = mark->serial;
    return enqueue(handle, std::move(o));
}

/* ---- copies ---- */

int cuMemcpyHtoDAsync_v2(unsigned long long to, const void *from, size_t bytes, void *s) { return copy(operation::UPLOAD, "cuMemcpyHtoDAsync", to, (uintptr_t)from, bytes, s); }
int cuMemcpyDtoHAsync_v2(void *to, unsigned long long from, size_t bytes, void *s) { return copy(operation::DOWNLOAD, "cuMemcpyDtoHAsync", (uintptr_t)to, from, bytes, s); }
int cuMemcpyDtoDAsync_v2(unsigned long long to, unsigned long long from, size_t bytes, void *s) { return copy(operation::COPY, "cuMemcpyDtoDAsync", to, from, bytes, s); }
int cuMemsetD8Async(unsigned long long to, unsigned char value, size_t n, void *s) { return fill("cuMemsetD8Async", to, value, 1, n, s); }
int cuMemsetD32Async(unsigned long long to, unsigned value, size_t n, void *s) { return fill("cuMemsetD32Async", to, value, 4, n, s); }

/* ---- launches ---- */

int cuLaunchKernel(void *f_, unsigned gx, unsigned gy, unsigned gz, unsigned bx, unsigned by, unsigned bz, unsigned shared, void *handle, void **params, void **extra)
{
    const entry e;
    function *f = (function *)f_;
    if (!f) return refuse(INVALID_HANDLE, "cuLaunchKernel without a function");
    const char *name = f->name.c_str();
    if (const int failed = need_context(name)) return failed;
    if (!f->home) stop("%s is launched, but its module has been unloaded", name);
    if (extra) return refuse(NOT_SUPPORTED, "launch of %s: arguments in `extra` are not emulated", name);
    if (!gx || !gy || !gz || !bx || !by || !bz || gx > 0x7fffffffu || gy > 65535 || gz > 65535 || bx > 1024 || by > 1024 || bz > 64 || (uint64_t)bx * by * bz > MOST_THREADS)
        return refuse(INVALID_VALUE, "launch of %s: a grid of %u x %u x %u blocks of %u x %u x %u threads is not possible", name, gx, gy, gz, bx, by, bz);
    if (shared > (unsigned)f->most_dynamic)
        return refuse(INVALID_VALUE, "launch of %s: %u bytes of shared memory, but %d are allowed%s", name, shared, f->most_dynamic,
                      f->most_dynamic == SHARED_USUAL ? " (cuFuncSetAttribute allows more)" : "");
    operation o;
    o.is = operation::KERNEL;
    o.kernel = { f, { gx, gy, gz }, { bx, by, bz }, shared, {} };
    for (size_t i = 0; i < f->sizes.size(); i++) {
        const size_t at = o.kernel.args.size();
        o.kernel.args.resize(at + (f->sizes[i] + 15) / 16 * 16);
        if (!params || !params[i]) return refuse(INVALID_VALUE, "launch of %s: argument %zu is missing", name, i);
        memcpy(o.kernel.args.data() + at, params[i], f->sizes[i]);
    }
    check_arguments(*f, o.kernel.args);
    return enqueue(handle, std::move(o));
}
}
