/* Stream capture and graphs: a list of operations in an order that their streams and events allow. */
#include "streams.h"

#include <set>

using namespace emulated;

namespace
{
struct graph {
    operations list;
};
struct executable {
    std::shared_ptr<operations> list;
};
std::set<void *> &graphs = *new std::set<void *>, &executables = *new std::set<void *>;

struct update_result { /* CUgraphExecUpdateResultInfo */
    int result;
    void *node, *from_node;
};
enum { UPDATE_SUCCESS = 0, UPDATE_TOPOLOGY_CHANGED = 2, UPDATE_TYPE_CHANGED = 3 };
} // namespace

extern "C" {

int cuStreamBeginCapture_v2(void *handle, int mode)
{
    const entry e;
    if (const int failed = need_context("cuStreamBeginCapture")) return failed;
    auto s = find_stream(handle);
    if (!s) return refuse(INVALID_HANDLE, "cuStreamBeginCapture: %p is no stream", handle);
    if (!handle) return refuse(CAPTURE_UNSUPPORTED, "the default stream cannot be captured");
    if (setting("EMULATOR_NO_CAPTURE")) return CAPTURE_UNSUPPORTED;
    if (s->captured) return refuse(INVALID_VALUE, "cuStreamBeginCapture of a stream that is captured already");
    if (mode < 0 || mode > 2) return refuse(INVALID_VALUE, "cuStreamBeginCapture: mode %d", mode);
    s->captured = std::make_shared<capture>();
    s->captured->mode = mode;
    s->captured->thread = pthread_self();
    s->captured->origin = s.get();
    s->captured->members.assign(1, s.get());
    s->last = s->joined = 0;
    return SUCCESS;
}

int cuStreamIsCapturing(void *handle, int *status)
{
    const entry e;
    auto s = find_stream(handle);
    if (!s) return refuse(INVALID_HANDLE, "cuStreamIsCapturing: %p is no stream", handle);
    *status = !s->captured ? 0 : s->captured->invalid ? 2 : 1;
    return SUCCESS;
}

int cuStreamEndCapture(void *handle, void **out)
{
    const entry e;
    *out = nullptr;
    auto s = find_stream(handle);
    if (!s) return refuse(INVALID_HANDLE, "cuStreamEndCapture: %p is no stream", handle);
    auto c = s->captured;
    if (!c) return refuse(INVALID_VALUE, "cuStreamEndCapture of a stream that is not captured");
    if (c->origin != s.get()) return refuse(CAPTURE_UNMATCHED, "cuStreamEndCapture on a stream on which the capture did not begin");
    if (c->mode != 2 && !pthread_equal(c->thread, pthread_self())) return refuse(908, "cuStreamEndCapture on another thread than cuStreamBeginCapture");
    bool unjoined = false;
    for (stream *member : c->members) {
        unjoined |= member != c->origin && member->joined < member->last;
        member->captured = nullptr;
    }
    if (c->invalid) return CAPTURE_INVALIDATED;
    if (unjoined) return refuse(CAPTURE_UNJOINED, "cuStreamEndCapture: the work of another stream was not waited for");
    graph *g = new graph{ std::move(c->list) };
    graphs.insert(g);
    *out = g;
    return SUCCESS;
}

int cuGraphDestroy(void *g)
{
    const entry e;
    if (!graphs.erase(g)) return refuse(INVALID_VALUE, "cuGraphDestroy: %p is no graph", g);
    delete (graph *)g;
    return SUCCESS;
}

int cuGraphGetNodes(void *g, void **nodes, size_t *n)
{
    const entry e;
    if (!graphs.count(g)) return refuse(INVALID_VALUE, "cuGraphGetNodes: %p is no graph", g);
    if (nodes) return refuse(NOT_SUPPORTED, "cuGraphGetNodes: only their number is emulated");
    *n = ((graph *)g)->list.size();
    return SUCCESS;
}

int cuGraphInstantiateWithFlags(void **out, void *g, unsigned long long flags)
{
    const entry e;
    if (!graphs.count(g)) return refuse(INVALID_VALUE, "cuGraphInstantiate: %p is no graph", g);
    if (flags) return refuse(NOT_SUPPORTED, "cuGraphInstantiate: flags %llu are not emulated", flags);
    executable *x = new executable{ std::make_shared<operations>(((graph *)g)->list) };
    executables.insert(x);
    *out = x;
    return SUCCESS;
}

int cuGraphExecDestroy(void *x)
{
    const entry e;
    if (!executables.erase(x)) return refuse(INVALID_VALUE, "cuGraphExecDestroy: %p is no graph that can be launched", x);
    delete (executable *)x;
    return SUCCESS;
}

/* As many nodes of the same kinds in the same order; what they work on may be another. */
int cuGraphExecUpdate_v2(void *x, void *g, update_result *info)
{
    const entry e;
    if (!executables.count(x) || !graphs.count(g)) return refuse(INVALID_VALUE, "cuGraphExecUpdate: no such graph");
    const operations &is = *((executable *)x)->list, &becomes = ((graph *)g)->list;
    *info = { UPDATE_SUCCESS, nullptr, nullptr };
    if (is.size() != becomes.size()) info->result = UPDATE_TOPOLOGY_CHANGED;
    for (size_t i = 0; i < is.size() && info->result == UPDATE_SUCCESS; i++) {
        const bool kernels = (is[i].is == operation::KERNEL || is[i].is == operation::CALL) && (becomes[i].is == operation::KERNEL || becomes[i].is == operation::CALL);
        if (is[i].is != becomes[i].is && !kernels) info->result = UPDATE_TYPE_CHANGED;
    }
    if (info->result != UPDATE_SUCCESS) return UPDATE_FAILURE;
    ((executable *)x)->list = std::make_shared<operations>(becomes);
    return SUCCESS;
}

int cuGraphLaunch(void *x, void *handle)
{
    const entry e;
    if (const int failed = need_context("cuGraphLaunch")) return failed;
    if (!executables.count(x)) return refuse(INVALID_VALUE, "cuGraphLaunch: %p is no graph that can be launched", x);
    auto s = find_stream(handle);
    if (!s) return refuse(INVALID_HANDLE, "cuGraphLaunch: %p is no stream", handle);
    operation o;
    o.is = operation::GRAPH;
    o.graph = ((executable *)x)->list;
    return enqueue(handle, std::move(o));
}
}
