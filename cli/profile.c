/* hairgrad profile: where the time of a training step goes. */
#include "cli/cli.h"

#include <cjson/cJSON.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { warm = 3 }; /* steps that are made before: memory, caches, first contacts */

typedef struct {
    double step, operations, bytes; /* seconds; what the machine can do in one */
    int n;
    const hg_profile_row *rows;
    char *backend;
    int threads, steps;
    bool device;                     /* not the processor */
    hg_device_counts before, counts; /* of the steps that are counted */
} profile;

typedef struct {
    hg_ctx *ctx;
    int left, steps;
    hg_device_counts *before;
} countdown;

/* Asked before every step: starts to count once the first ones are over. */
static bool count_or_stop(void *self)
{
    countdown *c = self;
    if (c->left-- == 0) {
        *c->before = hg_ctx_counts(c->ctx);
        hg_profile_start(c->ctx, c->steps);
    }
    return cli_interrupted(NULL);
}

static hg_status run_steps(hg_ctx *ctx, const char *recipe, const hg_arguments *arguments, profile *p)
{
    hg_config *config = NULL;
    hg_hair_task *task = NULL;
    hg_progress progress = cli_progress();
    HG_TRY(hg_hair_config_load(&config, recipe));
    hg_status status = HG_OK;
    for (int i = 0; i < arguments->n_given && status == HG_OK; i++) {
        if (strcmp(arguments->given[i].name, "set")) continue;
        char *key = hg_strdup(arguments->given[i].value), *value = key ? strchr(key, '=') : NULL;
        if (value) *value++ = '\0';
        status = !key    ? HG_MEMORY
                 : value ? hg_config_set(config, key, value)
                         : hg_fail(HG_INVALID, "--set %s: expected key=value, like model.width=128", key);
        hg_free(key);
    }
    if (status == HG_OK) status = hg_hair_task_create(&task, ctx, config, NULL, &progress);
    hg_config_destroy(config);
    if (status != HG_OK) return status;
    hg_train_options options = hg_hair_train_options(task);
    hg_task steps_only = *hg_hair_task_of(task);
    steps_only.validate = NULL;
    countdown until = { ctx, warm, p->steps, &p->before };
    options.steps = warm + p->steps;
    options.folder = NULL;
    options.log_every = options.validate_every = options.checkpoint_every = 0;
    options.stop = count_or_stop;
    options.stop_self = &until;
    p->backend = hg_strdup(options.backend);
    hg_train_result result;
    cli_catch_signals();
    status = hg_train(ctx, hg_hair_model(task), &steps_only, &options, NULL, &result);
    p->counts = hg_ctx_counts(ctx);
    if (status == HG_OK) p->n = hg_profile_read(ctx, &p->step, &p->rows);
    hg_hair_task_destroy(task);
    return status;
}

/* One launch for every call that does anything: what is nested inside has its own. */
static void count_launches(const profile *p, double *launches, double *least)
{
    *launches = *least = 0;
    for (int i = 0; i < p->n; i++) {
        *launches += p->rows[i].launches;
        if (p->rows[i].launches > 0) *least += fmin(p->rows[i].calls, p->rows[i].launches);
    }
}

static void print_table(const profile *p)
{
    printf("a step takes %.2f ms (median of %d, %d threads, strand energies %s)\n", 1e3 * p->step, p->steps, p->threads,
           p->backend);
    printf("copying is %.1f GB/s on this machine now, multiply-add %.0f GFLOP/s\n\n", 1e-9 * p->bytes,
           1e-9 * p->operations);
    printf("%-11s %-44s %6s %9s %6s %9s %8s %7s%s\n", "group", "what", "calls", "own ms", "share", "total ms", "MB",
           "of copy", p->device ? "  launches" : "");
    for (int i = 0; i < p->n; i++) {
        const hg_profile_row *r = &p->rows[i];
        char name[45], rate[16] = "";
        snprintf(name, sizeof name, "%s", r->name);
        if (r->bytes > 0 && r->total > 0) snprintf(rate, sizeof rate, "%.0f %%", 100 * r->bytes / r->total / p->bytes);
        printf("%-11s %-44s %6.4g %9.3f %4.0f %% %9.3f %8.2f %7s", r->group, name, r->calls, 1e3 * r->own,
               100 * r->own / p->step, 1e3 * r->total, 1e-6 * r->bytes, rate);
        if (p->device) printf("  %8.4g", r->launches);
        printf("\n");
    }
    if (p->device) {
        double launches, least;
        count_launches(p, &launches, &least);
        printf(
            "\n%.4g launches a step (one for each call would be %.4g), %.3f MB to the device and %.3f MB back a step, "
            "counted call\nby call; a training replays a step as one graph, without waiting in between.\n",
            launches, least, 1e-6 * (double)(p->counts.uploaded - p->before.uploaded) / p->steps,
            1e-6 * (double)(p->counts.downloaded - p->before.downloaded) / p->steps);
    }
    printf(
        "\nown: without what is listed inside it; MB: what it reads and writes if everything is touched once; of copy: "
        "that\nover its time, against copying. Energies of consecutive vertices are one pass, so they are one row.\n");
}

static hg_status write_json(const profile *p, const char *path)
{
    cJSON *all = cJSON_CreateObject(), *rows = cJSON_CreateArray();
    cJSON_AddNumberToObject(all, "step_seconds", p->step);
    cJSON_AddNumberToObject(all, "steps", p->steps);
    cJSON_AddNumberToObject(all, "threads", p->threads);
    cJSON_AddStringToObject(all, "backend", p->backend ? p->backend : "");
    cJSON_AddNumberToObject(all, "copy_bytes_per_second", p->bytes);
    cJSON_AddNumberToObject(all, "operations_per_second", p->operations);
    if (p->device) {
        double launches, least;
        count_launches(p, &launches, &least);
        cJSON_AddNumberToObject(all, "launches", launches);
        cJSON_AddNumberToObject(all, "least_launches", least);
        cJSON_AddNumberToObject(all, "uploaded_bytes", (double)(p->counts.uploaded - p->before.uploaded) / p->steps);
        cJSON_AddNumberToObject(all, "downloaded_bytes",
                                (double)(p->counts.downloaded - p->before.downloaded) / p->steps);
    }
    for (int i = 0; i < p->n; i++) {
        const hg_profile_row *r = &p->rows[i];
        cJSON *row = cJSON_CreateObject();
        cJSON_AddStringToObject(row, "group", r->group);
        cJSON_AddStringToObject(row, "name", r->name);
        cJSON_AddNumberToObject(row, "calls", r->calls);
        cJSON_AddNumberToObject(row, "own_seconds", r->own);
        cJSON_AddNumberToObject(row, "total_seconds", r->total);
        cJSON_AddNumberToObject(row, "bytes", r->bytes);
        if (p->device) cJSON_AddNumberToObject(row, "launches", r->launches);
        cJSON_AddNumberToObject(row, "share", p->step > 0 ? r->own / p->step : 0);
        cJSON_AddItemToArray(rows, row);
    }
    cJSON_AddItemToObject(all, "rows", rows);
    char *text = cJSON_Print(all);
    cJSON_Delete(all);
    if (!text) return hg_fail(HG_MEMORY, "profile: no memory to write %s", path);
    const hg_status status = hg_file_write(path, text, strlen(text));
    free(text);
    return status;
}

static int profile_command(const hg_arguments *arguments)
{
    hg_ctx *ctx = NULL;
    int64_t steps = 20;
    if (!cli_integer(arguments, "steps", &steps)) return cli_fail();
    if (steps < 1 || steps > 100000) {
        hg_fail(HG_INVALID, "--steps %lld: between 1 and 100000 is needed", (long long)steps);
        return cli_fail();
    }
    if (!cli_context(&ctx, arguments)) return cli_fail();
    profile p = { .steps = (int)steps, .threads = hg_ctx_threads(ctx), .device = !hg_ctx_host(ctx) };
    hg_status status = run_steps(ctx, arguments->free[0], arguments, &p);
    cli_progress_end();
    if (status == HG_OK && p.n == 0) status = hg_fail(HG_INVALID, "profile: interrupted before a step was counted");
    if (status == HG_OK) status = hg_machine_limits(ctx, &p.operations, &p.bytes);
    const char *json = cli_value(arguments, "json", NULL);
    if (status == HG_OK && json) status = write_json(&p, json);
    if (status == HG_OK) print_table(&p);
    hg_free(p.backend);
    hg_ctx_destroy(ctx);
    return status == HG_OK ? 0 : cli_fail();
}

static const hg_argument profile_options[] = {
    { "steps", "N", "steps to count, after 3 that are not (default 20)", false },
    { "json", "FILE", "the same as JSON", false },
    { "set", "KEY=VALUE", "override a value of the recipe", true },
    CLI_DEVICE_OPTION,
    CLI_CONTEXT_OPTIONS,
};
HG_COMMAND(profile, .what = "where the time of a training step goes", .usage = "RECIPE.yaml",
           .options = profile_options, .n_options = sizeof profile_options / sizeof *profile_options, .min_free = 1,
           .max_free = 1, .run = profile_command,
           .more = "  hairgrad profile examples/recipes/demo.yaml\n"
                   "Time, calls and bytes of every op, forward and backward, of the energies, the body, neighbours, "
                   "sampling and\nthe optimiser. Nothing is written but the JSON.\n");
