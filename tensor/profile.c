/* Profile: where the time of a step goes. Scopes have a group and a name and lie inside each other; a scope's own time is
 * what it took without the scopes inside it, so that own times add up to the step. All memory is taken at the start. */
#include "tensor/context.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { ROWS = 192, DEPTH = 32, NAME = 160 };

typedef struct {
    const char *group;
    char name[NAME]; /* its own: that of a physics is gone when the table is read */
    double own, total, bytes;
    int64_t calls, launches;
} row;

struct hg_profile {
    int n_rows, depth, steps, step;
    struct {
        int row;
        double start, inside;
        int64_t launches, launches_inside;
    } open[DEPTH];
    row rows[ROWS];
    hg_profile_row result[ROWS];
    double started, *seconds; /* of each step */
    double *own, *total;      /* [ROWS,steps] */
    double *sorted;           /* [steps] */
};

/* A device is waited for at both ends of a scope, so that its time is its own. */
static double now(hg_ctx *ctx)
{
    if (!ctx->device->host) ctx->device->wait(ctx->device); /* an error of a launch is told by what reads its result */
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

hg_status hg_profile_start(hg_ctx *ctx, int steps)
{
    hg_profile_stop(ctx);
    if (steps < 1) return hg_fail(HG_INVALID, "profile: %d steps; at least one", steps);
    hg_profile *p = hg_alloc(1, sizeof *p);
    if (!p) return HG_MEMORY;
    ctx->profile = p;
    p->steps = steps;
    p->seconds = hg_alloc((size_t)steps, sizeof(double));
    p->own = hg_alloc((size_t)steps * ROWS, sizeof(double));
    p->total = hg_alloc((size_t)steps * ROWS, sizeof(double));
    p->sorted = hg_alloc((size_t)steps, sizeof(double));
    if (!p->seconds || !p->own || !p->total || !p->sorted) {
        hg_profile_stop(ctx);
        return HG_MEMORY;
    }
    p->started = now(ctx);
    return HG_OK;
}

void hg_profile_stop(hg_ctx *ctx)
{
    hg_profile *p = ctx->profile;
    ctx->profile = NULL;
    if (!p) return;
    hg_free(p->seconds);
    hg_free(p->own);
    hg_free(p->total);
    hg_free(p->sorted);
    hg_free(p);
}

bool hg_profiling(const hg_ctx *ctx) { return ctx->profile != NULL; }

static int find(hg_profile *p, const char *group, const char *name)
{
    for (int i = 0; i < p->n_rows; i++)
        if (strncmp(p->rows[i].name, name, NAME - 1) == 0 &&
            (p->rows[i].group == group || strcmp(p->rows[i].group, group) == 0))
            return i;
    if (p->n_rows == ROWS) return ROWS - 1; /* the last one takes what there is no room for */
    p->rows[p->n_rows] = (row){ .group = group };
    snprintf(p->rows[p->n_rows].name, NAME, "%s", name);
    return p->n_rows++;
}

void hg_profile_begin(hg_ctx *ctx, const char *group, const char *name)
{
    hg_profile *p = ctx->profile;
    if (!p) return;
    if (p->depth < DEPTH) {
        p->open[p->depth].row = find(p, group, name);
        p->open[p->depth].inside = 0;
        p->open[p->depth].launches_inside = 0;
        p->open[p->depth].start = now(ctx);
        p->open[p->depth].launches = ctx->device->counts.launches;
    }
    p->depth++;
}

void hg_profile_end(hg_ctx *ctx, int64_t bytes)
{
    hg_profile *p = ctx->profile;
    if (!p || p->depth == 0) return;
    if (--p->depth >= DEPTH) return;
    row *r = &p->rows[p->open[p->depth].row];
    const double passed = now(ctx) - p->open[p->depth].start;
    const int64_t launched = ctx->device->counts.launches - p->open[p->depth].launches;
    r->total += passed;
    r->launches += launched - p->open[p->depth].launches_inside;
    r->own += passed - p->open[p->depth].inside;
    r->bytes += (double)bytes;
    r->calls++;
    if (p->depth == 0) return;
    p->open[p->depth - 1].inside += passed;
    p->open[p->depth - 1].launches_inside += launched;
}

void hg_profile_step(hg_ctx *ctx)
{
    hg_profile *p = ctx->profile;
    if (!p) return;
    const double time = now(ctx);
    if (p->step < p->steps) {
        p->seconds[p->step] = time - p->started;
        for (int i = 0; i < p->n_rows; i++) {
            p->own[(size_t)i * (size_t)p->steps + (size_t)p->step] = p->rows[i].own;
            p->total[(size_t)i * (size_t)p->steps + (size_t)p->step] = p->rows[i].total;
            p->result[i].calls += p->rows[i].calls;
            p->result[i].bytes += p->rows[i].bytes;
            p->result[i].launches += (double)p->rows[i].launches;
        }
        p->step++;
    }
    for (int i = 0; i < p->n_rows; i++) {
        p->rows[i].own = p->rows[i].total = p->rows[i].bytes = 0;
        p->rows[i].calls = p->rows[i].launches = 0;
    }
    p->depth = 0; /* scopes that an error left open */
    p->started = now(ctx);
}

static int compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(hg_profile *p, const double *values)
{
    memcpy(p->sorted, values, (size_t)p->step * sizeof *values);
    qsort(p->sorted, (size_t)p->step, sizeof *values, compare);
    return p->sorted[p->step / 2];
}

static int by_own(const void *a, const void *b)
{
    const double x = ((const hg_profile_row *)a)->own, y = ((const hg_profile_row *)b)->own;
    return (x < y) - (x > y);
}

int hg_profile_read(hg_ctx *ctx, double *step_seconds, const hg_profile_row **rows)
{
    hg_profile *p = ctx->profile;
    *rows = NULL;
    *step_seconds = 0;
    if (!p || p->step == 0) return 0;
    *step_seconds = median(p, p->seconds);
    for (int i = 0; i < p->n_rows; i++) {
        hg_profile_row *r = &p->result[i];
        r->group = p->rows[i].group;
        r->name = p->rows[i].name;
        r->calls /= (double)p->step;
        r->bytes /= (double)p->step;
        r->launches /= (double)p->step;
        r->own = median(p, p->own + (size_t)i * (size_t)p->steps);
        r->total = median(p, p->total + (size_t)i * (size_t)p->steps);
    }
    qsort(p->result, (size_t)p->n_rows, sizeof *p->result, by_own);
    *rows = p->result;
    p->steps = p->step = 0; /* what is read is not added to */
    return p->n_rows;
}
