/* Messages: what happened, in which kernel, block and thread, and where in the source; faults of the processor become such. */
#include "emulator.h"

#include <dlfcn.h>
#include <execinfo.h>
#include <signal.h>
#include <stdio.h>
#include <sys/mman.h>
#include <sys/types.h>
#include <ucontext.h>
#include <unistd.h>

namespace emulated
{
const char *calling;

std::string line_of(const void *code)
{
    if (!running || !running->what->home) return "";
    const module &home = *running->what->home;
    const uintptr_t at = (uintptr_t)code;
    Dl_info info;
    std::string place;
    if (dladdr(code, &info) == 0) return "";
    if (at >= home.begin && at < home.end) {
        char command[256], line[512] = "";
        snprintf(command, sizeof command, "addr2line -e /proc/%d/fd/%d %#zx 2>/dev/null", (int)getpid(), home.file, (size_t)(at - (uintptr_t)info.dli_fbase - 1));
        if (FILE *pipe = popen(command, "r")) {
            if (!fgets(line, sizeof line, pipe)) line[0] = 0;
            pclose(pipe);
        }
        line[strcspn(line, " \n")] = 0;
        if (line[0] && line[0] != '?' && !strstr(line, ":?")) place = line;
        if (const size_t folder = place.find("emulated-nvrtc-"); folder != std::string::npos) place.erase(0, folder + strlen("emulated-nvrtc-XXXXXX/"));
    }
    if (place.empty() && info.dli_sname) place = info.dli_sname;
    return place;
}

namespace
{
void say(const void *code, const char *text)
{
    std::string who = "emulator: ";
    if (running) {
        const emulator_size b = state.block;
        char block[64];
        if (state.grid_size.y == 1 && state.grid_size.z == 1) snprintf(block, sizeof block, "block %u", b.x);
        else snprintf(block, sizeof block, "block (%u, %u, %u)", b.x, b.y, b.z);
        who += running->what->name + ", " + block + ", " + thread_name(current) + ": ";
    }
    const std::string place = code ? line_of(code) : "";
    fprintf(stderr, "%s%s%s%s\n", who.c_str(), text, place.empty() ? "" : ", at ", place.c_str());
    fflush(stderr);
}

[[noreturn]] void end()
{
    signal(SIGABRT, SIG_DFL);
    abort();
}

/* ---- faults ---- */

enum { SIGNALS = 4 };
const int signals[SIGNALS] = { SIGSEGV, SIGBUS, SIGILL, SIGFPE };
struct sigaction before[SIGNALS];

bool writes(const ucontext_t *context)
{
#ifdef __x86_64__
    return context->uc_mcontext.gregs[REG_ERR] & 2;
#else
    return (void)context, false;
#endif
}
const void *code_of(const ucontext_t *context)
{
#ifdef __x86_64__
    return (const void *)(context->uc_mcontext.gregs[REG_RIP] + 1); /* as a return address would be */
#else
    return (void)context, nullptr;
#endif
}

void on_fault(int number, siginfo_t *info, void *context_)
{
    const ucontext_t *context = (const ucontext_t *)context_;
    const uintptr_t at = (uintptr_t)info->si_addr;
    const char *did = writes(context) ? "wrote to" : "read";
    char text[512];
    if (running) {
        if (number == SIGILL) snprintf(text, sizeof text, "undefined behaviour: an index out of its array's bounds, an overflow of a signed number, a shift too far, a misaligned address or a NULL");
        else if (number == SIGFPE) snprintf(text, sizeof text, "an integer was divided by zero");
        else if (in_stack_guard(at)) snprintf(text, sizeof text, "its stack of %d bytes is full", (int)STACK);
        else if (at == 0 && number == SIGSEGV) snprintf(text, sizeof text, "%s NULL, or an address that is none, or a misaligned vector", did);
        else snprintf(text, sizeof text, "%s %#zx: %s", did, (size_t)at, describe_address(at).c_str());
        say(code_of(context), text);
        end();
    }
    if (calling) {
        snprintf(text, sizeof text, "%s %s %#zx: %s", calling, did, (size_t)at, describe_address(at).c_str());
        say(nullptr, text);
        end();
    }
    if (number == SIGSEGV && in_device_region(at)) {
        snprintf(text, sizeof text, "the host %s %#zx: %s. Device memory is out of the host's reach: hg_tensor_read, _write, _item and _from go there", did, (size_t)at, describe_address(at).c_str());
        say(nullptr, text);
        void *frames[24];
        backtrace_symbols_fd(frames, backtrace(frames, 24), STDERR_FILENO);
        end();
    }
    for (int i = 0; i < SIGNALS; i++) /* not ours: it happens again, to whoever was there before */
        if (signals[i] == number) sigaction(number, &before[i], nullptr);
}
} // namespace

void watch_signals()
{
    static thread_local char *stack;
    stack_t now;
    if (!stack && sigaltstack(nullptr, &now) == 0 && (now.ss_flags & SS_DISABLE)) {
        stack = (char *)mmap(nullptr, 128 << 10, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
        now.ss_sp = stack, now.ss_size = 128 << 10, now.ss_flags = 0;
        if (stack != MAP_FAILED) sigaltstack(&now, nullptr);
    } else if (!stack) {
        stack = (char *)now.ss_sp;
    }
    for (int i = 0; i < SIGNALS; i++) {
        struct sigaction is, ours;
        sigaction(signals[i], nullptr, &is);
        if ((is.sa_flags & SA_SIGINFO) && is.sa_sigaction == on_fault) continue;
        before[i] = is;
        memset(&ours, 0, sizeof ours);
        ours.sa_sigaction = on_fault;
        ours.sa_flags = SA_SIGINFO | SA_ONSTACK | SA_NODEFER;
        sigaction(signals[i], &ours, nullptr);
    }
}

void stop(const char *format, ...)
{
    char text[1024];
    va_list list;
    va_start(list, format);
    vsnprintf(text, sizeof text, format, list);
    va_end(list);
    say(nullptr, text);
    end();
}

void stop_at(const void *code, const char *format, ...)
{
    char text[1024];
    va_list list;
    va_start(list, format);
    vsnprintf(text, sizeof text, format, list);
    va_end(list);
    say(code, text);
    end();
}

int refuse(int result, const char *format, ...)
{
    char text[1024];
    va_list list;
    va_start(list, format);
    vsnprintf(text, sizeof text, format, list);
    va_end(list);
    fprintf(stderr, "emulator: %s\n", text);
    return result;
}

bool setting(const char *name)
{
    const char *text = getenv(name);
    return text && *text && strcmp(text, "0") != 0;
}
} // namespace emulated
