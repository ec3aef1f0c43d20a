/* Streams of the emulating driver: work waits in order until somebody waits for it. */
#ifndef EMULATOR_STREAMS_H
#define EMULATOR_STREAMS_H

#include "emulator.h"

#include <pthread.h>
#include <deque>
#include <mutex>

namespace emulated
{
struct event;
struct stream;
typedef std::vector<struct operation> operations;

struct operation {
    enum kind { KERNEL, UPLOAD, DOWNLOAD, COPY, FILL, CALL, HOST, RECORD, WAIT, GRAPH } is;
    launch kernel = {};
    uintptr_t to = 0, from = 0;
    size_t bytes = 0;
    unsigned value = 0; /* FILL: `width` bytes of it, again and again */
    int width = 0;
    std::vector<char> data; /* UPLOAD from pageable memory: as it was; CALL: its arguments */
    bool staged = false;
    std::string name;
    void (*call)(const void *) = nullptr;
    void (*host)(void *) = nullptr;
    void *user = nullptr;
    std::shared_ptr<event> mark;
    std::shared_ptr<stream> other; /* WAIT: until it has done `serial` operations */
    uint64_t serial = 0;
    std::shared_ptr<operations> graph;
};

struct capture {
    int mode;
    pthread_t thread;
    stream *origin;
    std::vector<stream *> members;
    operations list;
    bool invalid = false;
};

struct stream {
    bool non_blocking = false;
    std::deque<operation> waiting;
    uint64_t done = 0; /* operations, ever */
    size_t staged = 0; /* bytes that wait to be uploaded */
    std::shared_ptr<capture> captured;
    size_t last = 0, joined = 0; /* while captured: the end of its own work, how much of it the origin waits for */
};

struct event {
    bool timed = true;
    std::shared_ptr<stream> where; /* empty: never recorded */
    uint64_t serial = 0;           /* done when `where` has done as many */
    double time = 0;
    std::shared_ptr<capture> captured;
    stream *captured_on = nullptr;
    size_t captured_at = 0;
};

struct entry { /* one entry point at a time */
    entry();
    ~entry();
};

std::shared_ptr<stream> find_stream(void *handle); /* empty: no such stream */
int enqueue(void *handle, operation &&what);
void drain(stream &s, uint64_t until);
void drain_all();
int in_capture(const char *what); /* SUCCESS, or the error that CUDA gives: the capture is lost */
bool initialized();
int need_context(const char *what);
} // namespace emulated

#endif
