/* What a running command shows: the sentence of a failure, one line of progress, and how it is interrupted. */
#include "cli/cli.h"

#include <math.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <time.h>
#include <unistd.h>

static struct {
    double start, shown; /* s; shown: when the line was last written, negative: not yet */
    bool terminal, line; /* line: one stands unfinished on the terminal */
} state = { .shown = -1.0 };

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + (double)time.tv_nsec * 1e-9;
}

static int width(void)
{
    struct winsize size;
    return ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 20 ? size.ws_col : 80;
}

/* Short work shows nothing; a log file gets a line now and then, a terminal one line that is rewritten. */
static void report(void *self, double fraction, const char *text)
{
    (void)self;
    const double silent = 2.0, between = state.terminal ? 0.2 : 5.0;
    double time = now();
    if (time - state.start < silent || (state.shown >= 0.0 && time - state.shown < between)) return;
    char percent[16] = "";
    if (fraction >= 0.0 && fraction <= 1.0) snprintf(percent, sizeof percent, "%3.0f %%  ", floor(fraction * 100.0));
    if (state.terminal) {
        fprintf(stderr, "\r%s%.*s\033[K", percent, width() - (int)strlen(percent) - 1, text);
        state.line = true;
    } else {
        fprintf(stderr, "%s%s\n", percent, text);
    }
    fflush(stderr);
    state.shown = time;
}

hg_progress cli_progress(void)
{
    cli_progress_end();
    const char *kind = getenv("TERM");
    state.terminal = isatty(STDERR_FILENO) == 1 && kind != NULL && strcmp(kind, "dumb") != 0;
    state.start = now();
    return (hg_progress){ .self = NULL, .report = report };
}

void cli_progress_end(void)
{
    if (state.line) fputc('\n', stderr);
    state.line = false;
    state.shown = -1.0;
}

int cli_fail(void)
{
    cli_progress_end();
    const char *message = hg_message();
    fprintf(stderr, "hairgrad: %s\n", message[0] != '\0' ? message : "it failed without a reason");
    return 1;
}

/* ---- signals ------------------------------------------------------------------------------------------------ */

static volatile sig_atomic_t interrupted;

static void remember(int number)
{
    (void)number;
    interrupted = 1;
}

/* The first signal asks, the second one ends the program as usual. */
void cli_catch_signals(void)
{
    struct sigaction action;
    memset(&action, 0, sizeof action);
    action.sa_handler = remember;
    action.sa_flags = SA_RESTART | (int)SA_RESETHAND;
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
}

bool cli_interrupted(void *self)
{
    (void)self;
    return interrupted != 0;
}
