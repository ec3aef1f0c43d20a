/* Sides that run in turn, and the process of the other side. */
#include "bench/bench.h"

#include <errno.h>
#include <poll.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { MOST = 4096 };

double bench_now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e3 * (double)t.tv_sec + 1e-6 * (double)t.tv_nsec;
}

void bench_need(hg_status status)
{
    if (status == HG_OK) return;
    fprintf(stderr, "bench: %s\n", hg_message());
    exit(1);
}

static int order(const void *a, const void *b)
{
    const double p = *(const double *)a, q = *(const double *)b;
    return (p > q) - (p < q);
}

double bench_median(double *values, int n)
{
    qsort(values, (size_t)n, sizeof *values, order);
    return n ? values[n / 2] : 0;
}

void bench_race(bench *b, int n_sides, bench_side *sides, int each)
{
    int rounds = b->rounds;
    if (rounds * each > MOST) rounds = MOST / each;
    double *ms = hg_alloc((size_t)n_sides * MOST, sizeof *ms);
    if (!ms) bench_need(HG_MEMORY);
    const double started = bench_now();
    int done = 0;
    for (; done < rounds && (done < 2 || bench_now() - started < 12e3); done++)
        for (int s = 0; s < n_sides; s++) {
            nanosleep(&(struct timespec){ 0, 20000000 }, NULL); /* the last one's threads come to rest */
            /* woken threads may begin on one core; the scheduler parts them after some milliseconds of work */
            const double woken = bench_now();
            do sides[s].times(sides[s].self, ms + s * MOST + done * each, 1);
            while (bench_now() - woken < 40);
            sides[s].times(sides[s].self, ms + s * MOST + done * each, each);
        }
    for (int s = 0; s < n_sides; s++) sides[s].median = bench_median(ms + s * MOST, done * each);
    hg_free(ms);
}

/* ---- the other process -------------------------------------------------------------------------------------- */

struct bench_peer {
    pid_t pid;
    FILE *to;
    int from;
    char text[200], variants[200], line[65536];
    struct {
        struct bench_peer *peer;
        char variant[32];
    } side[8];
    int n_sides;
};

/* One line, or false when none came in time. */
static bool read_line(bench_peer *p, int seconds)
{
    size_t n = 0;
    const double end = bench_now() + 1e3 * seconds;
    for (;;) {
        struct pollfd wait = { p->from, POLLIN, 0 };
        const double left = end - bench_now();
        if (left <= 0 || poll(&wait, 1, (int)left + 1) < 0) return false;
        char c;
        if (!(wait.revents & (POLLIN | POLLHUP))) continue;
        if (read(p->from, &c, 1) != 1) return false;
        if (c == '\n') break;
        if (n + 1 < sizeof p->line) p->line[n++] = c;
    }
    p->line[n] = 0;
    return true;
}

bench_peer *bench_peer_start(bench *b, const char *row, int patience)
{
    int to[2], from[2];
    bench_peer *p = hg_alloc(1, sizeof *p);
    if (!p || pipe(to) != 0 || pipe(from) != 0) {
        fprintf(stderr, "bench: no pipe\n");
        exit(1);
    }
    char script[600];
    snprintf(script, sizeof script, "%s/bench/peer.py", b->source);
    p->pid = fork();
    if (p->pid == 0) {
        dup2(to[0], 0);
        dup2(from[1], 1);
        close(to[1]);
        close(from[0]);
        setenv("OMP_NUM_THREADS", "2", 1);
        unsetenv("OMP_WAIT_POLICY"); /* ours: its user would not set them */
        unsetenv("GOMP_SPINCOUNT");
        execlp(b->python, b->python, script, row, b->folder, b->device, (char *)NULL); /* a device of NULL is the end */
        _exit(127);
    }
    close(to[0]);
    close(from[1]);
    p->to = fdopen(to[1], "w");
    p->from = from[0];
    if (p->pid < 0 || !p->to || !read_line(p, patience) || strncmp(p->line, "ready ", 6) != 0) {
        snprintf(p->text, sizeof p->text, "%.180s",
                 strncmp(p->line, "none ", 5) == 0 ? p->line + 5
                 : p->line[0]                      ? "the other side gave no sensible answer"
                              : "the other side (python3 with NumPy and PyTorch) did not get ready");
        return p;
    }
    char *bar = strchr(p->line, '|');
    snprintf(p->text, sizeof p->text, "%.180s", bar ? bar + 2 : "");
    if (bar) *bar = 0;
    snprintf(p->variants, sizeof p->variants, "%.190s", p->line + 5);
    return p;
}

void bench_peer_end(bench_peer *p)
{
    if (!p) return;
    if (p->to) {
        fprintf(p->to, "quit\n");
        fclose(p->to);
    }
    close(p->from);
    if (p->pid > 0) {
        for (int i = 0; i < 100 && waitpid(p->pid, NULL, WNOHANG) == 0; i++) {
            if (i == 99) { /* only the process started above */
                kill(p->pid, SIGKILL);
                waitpid(p->pid, NULL, 0);
            }
            nanosleep(&(struct timespec){ 0, 30000000 }, NULL);
        }
    }
    hg_free(p);
}

bool bench_peer_has(const bench_peer *p, const char *variant)
{
    char word[40];
    snprintf(word, sizeof word, " %s ", variant);
    return strstr(p->variants, word) != NULL;
}

const char *bench_peer_text(const bench_peer *p) { return p->text; }

static bool ask(bench_peer *p, const char *question)
{
    fprintf(p->to, "%s\n", question);
    fflush(p->to);
    if (read_line(p, 120)) return true;
    fprintf(stderr, "bench: no answer to \"%s\"\n", question);
    exit(1);
}

static void peer_times(void *self, double *ms, int n)
{
    struct {
        bench_peer *peer;
        char variant[32];
    } *side = self;
    char question[80];
    snprintf(question, sizeof question, "run %s %d", side->variant, n);
    ask(side->peer, question);
    char *at = side->peer->line;
    for (int i = 0; i < n; i++) ms[i] = strtod(at, &at);
}

bench_side bench_peer_side(bench_peer *p, const char *variant, const char *label)
{
    const int i = p->n_sides++;
    p->side[i].peer = p;
    snprintf(p->side[i].variant, sizeof p->side[i].variant, "%s", variant);
    return (bench_side){ .label = label, .times = peer_times, .self = &p->side[i] };
}

double bench_peer_memory(bench_peer *p, const char *variant)
{
    char question[80];
    snprintf(question, sizeof question, "memory %s", variant);
    return ask(p, question) ? strtod(p->line, NULL) : 0;
}

/* ---- arrays ------------------------------------------------------------------------------------------------- */

void bench_write(bench *b, const char *name, hg_dtype dtype, int rank, const int64_t *shape, const void *data)
{
    char path[600], header[256];
    size_t bytes = hg_dtype_size(dtype);
    int n = snprintf(header, sizeof header, "{'descr': '%s', 'fortran_order': False, 'shape': (",
                     dtype == HG_F32   ? "<f4"
                     : dtype == HG_F64 ? "<f8"
                                       : "<i4");
    for (int i = 0; i < rank; i++) {
        n += snprintf(header + n, sizeof header - (size_t)n, "%lld,", (long long)shape[i]);
        bytes *= (size_t)shape[i];
    }
    n += snprintf(header + n, sizeof header - (size_t)n, "), }");
    while ((10 + n + 1) % 64) header[n++] = ' ';
    header[n++] = '\n';
    snprintf(path, sizeof path, "%s/%s.npy", b->folder, name);
    FILE *file = fopen(path, "wb");
    const unsigned char begin[10] = { 0x93, 'N', 'U', 'M', 'P', 'Y', 1, 0, (unsigned char)n, (unsigned char)(n >> 8) };
    if (!file || fwrite(begin, 1, 10, file) != 10 || fwrite(header, 1, (size_t)n, file) != (size_t)n ||
        fwrite(data, 1, bytes, file) != bytes || fclose(file) != 0) {
        fprintf(stderr, "bench: %s: %s\n", path, strerror(errno));
        exit(1);
    }
}
