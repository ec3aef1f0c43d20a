/* What the tests of the emulated GPU share: its libraries, seeded kernels that are compiled once, a process for each case. */
#ifndef TESTS_EMULATOR_MACHINE_H
#define TESTS_EMULATOR_MACHINE_H

#include "test.h"

#include <dlfcn.h>
#include <signal.h>
#include <sys/wait.h>
#include "tensor/cuda/api.h"

enum { SIDE = 48, N = SIDE * SIDE, BYTES = N * 4, SAID = 4096 };

/* What api.h does not have since the product does not call it. */
#define MORE(X)                                                                                                        \
    X(cuStreamWaitEvent, "cuStreamWaitEvent", CUresult, (CUstream, CUevent, unsigned int))                             \
    X(cuMemsetD32Async, "cuMemsetD32Async", CUresult, (CUdeviceptr, unsigned int, size_t, CUstream))

static struct {
    HG_CUDA_DRIVER(HG_CUDA_FIELD)
    HG_CUDA_NVRTC(HG_CUDA_FIELD)
    MORE(HG_CUDA_FIELD)
} cuda;

static char *images[2][2]; /* good, bugs; plain, checked */

/* ---- compiling ---- */

static bool open_libraries(void)
{
    char *path[2] = { hg_path_join(getenv("HG_BUILD"), "tests/emulator/libcuda.so.1"),
                      hg_path_join(getenv("HG_BUILD"), "tests/emulator/libnvrtc.so.13") };
    void *library = dlopen(path[0], RTLD_NOW | RTLD_LOCAL);
    void *nvrtc = dlopen(path[1], RTLD_NOW | RTLD_LOCAL);
    hg_free(path[0]);
    hg_free(path[1]);
    if (!library || !nvrtc) return false;
#define TAKE(field_, symbol_, result_, arguments_)                                                                     \
    *(void **)(void *)&cuda.field_ = dlsym(library, symbol_);                                                          \
    if (!cuda.field_) fail_msg("the emulated driver has no %s", symbol_);
    HG_CUDA_DRIVER(TAKE)
    MORE(TAKE)
    library = nvrtc;
    HG_CUDA_NVRTC(TAKE)
    return true;
}

static char *compile(const char *source, const char *name, bool checked, const char *expected)
{
    setenv("EMULATOR_CHECK", checked ? "1" : "0", 1);
    static const char *const options[] = { "--gpu-architecture=sm_90", "--std=c++17" };
    static const char *const names[] = { "some/header.h" }, *const texts[] = { "#define IN_HEADER 1\n" };
    nvrtcProgram program;
    size_t size = 0;
    assert_int_equal(cuda.nvrtcCreateProgram(&program, source, name, 1, texts, names), 0);
    const int result = (int)cuda.nvrtcCompileProgram(program, 2, options);
    cuda.nvrtcGetProgramLogSize(program, &size);
    char *log = hg_alloc(size + 1, 1), *image = NULL;
    cuda.nvrtcGetProgramLog(program, log);
    if (expected) {
        if (result != 6 || !strstr(log, expected))
            fail_msg("expected an error with \"%s\", got %d: %s", expected, result, log);
    } else {
        if (result != 0) fail_msg("%s: %s", name, log);
        cuda.nvrtcGetCUBINSize(program, &size);
        image = hg_alloc(size, 1);
        cuda.nvrtcGetCUBIN(program, image);
    }
    hg_free(log);
    cuda.nvrtcDestroyProgram(&program);
    return image;
}

static int open_all(void **state)
{
    (void)state;
    if (!open_libraries()) return 0; /* no C++ compiler when this was configured */
    static const char *const names[2] = { "good.cu", "bugs.cu" };
    for (int which = 0; which < 2; which++) {
        char path[512];
        void *text;
        size_t size;
        snprintf(path, sizeof path, "%s/tests/emulator/seeded/%s", getenv("HG_SOURCE"), names[which]);
        if (hg_file_read(path, &text, &size) != HG_OK) return -1;
        char *source = hg_alloc(size + 1, 1);
        memcpy(source, text, size);
        for (int checked = 0; checked < 2; checked++)
            images[which][checked] = compile(source, names[which], checked, NULL);
        hg_free(source);
        hg_free(text);
    }
    return 0;
}

static int close_all(void **state)
{
    (void)state;
    for (int which = 0; which < 4; which++) hg_free(images[which / 2][which % 2]);
    return 0;
}

/* ---- a process for each case ---- */

typedef struct {
    CUcontext context;
    CUstream stream;
    CUmodule module;
    CUdeviceptr in, out;
    int32_t *host; /* what is put in */
} machine;

static void must(CUresult result, const char *what)
{
    if (result == 0) return;
    const char *name = NULL;
    cuda.cuGetErrorName(result, &name);
    fprintf(stderr, "%s: %s\n", what, name ? name : "?");
    _exit(3);
}
#define MUST(call_) must(cuda.call_, #call_)

static void start(machine *m, const char *image)
{
    memset(m, 0, sizeof *m);
    MUST(cuInit(0));
    MUST(cuDevicePrimaryCtxRetain(&m->context, 0));
    MUST(cuCtxSetCurrent(m->context));
    MUST(cuStreamCreate(&m->stream, CU_STREAM_NON_BLOCKING));
    if (image) MUST(cuModuleLoadData(&m->module, image));
    MUST(cuMemAlloc(&m->in, BYTES));
    MUST(cuMemAlloc(&m->out, BYTES));
    m->host = malloc(BYTES);
    for (int i = 0; i < N; i++) m->host[i] = (int)((unsigned)i * 2654435761u >> 20) % 100;
    MUST(cuMemcpyHtoDAsync(m->in, m->host, BYTES, m->stream));
}

static CUresult launch(machine *m, const char *name, unsigned gx, unsigned gy, unsigned bx, unsigned by,
                       unsigned shared, CUdeviceptr in, CUdeviceptr out, int n)
{
    CUfunction function;
    void *params[] = { &in, &out, &n };
    MUST(cuModuleGetFunction(&function, m->module, name));
    return cuda.cuLaunchKernel(function, gx, gy, 1, bx, by, 1, shared, m->stream, params, NULL);
}

static void finish(machine *m)
{
    MUST(cuStreamSynchronize(m->stream));
    MUST(cuMemFree(m->in));
    MUST(cuMemFree(m->out));
    if (m->module) MUST(cuModuleUnload(m->module));
    MUST(cuStreamDestroy(m->stream));
    MUST(cuDevicePrimaryCtxRelease(0));
    free(m->host);
}

/* Runs `what` and says how it ended: the exit status, or minus the signal. `said` gets its stderr, `result` what it wrote. */
static int apart(int (*what)(const void *), const void *argument, char *said, void *result, size_t size)
{
    int words[2], answer[2];
    assert_int_equal(pipe(words), 0);
    assert_int_equal(pipe(answer), 0);
    fflush(NULL);
    const pid_t child = fork();
    if (child == 0) {
        signal(SIGSEGV, SIG_DFL);
        dup2(words[1], STDERR_FILENO);
        dup2(answer[1], 3);
        _exit(what(argument));
    }
    close(words[1]);
    close(answer[1]);
    size_t n = 0;
    for (ssize_t got; result && n < size && (got = read(answer[0], (char *)result + n, size - n)) > 0;)
        n += (size_t)got;
    n = 0;
    for (ssize_t got; (got = read(words[0], said + n, SAID - 1 - n)) > 0;) n += (size_t)got;
    said[n] = 0;
    close(words[0]);
    close(answer[0]);
    int status;
    waitpid(child, &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
}

#endif
