/* bench: measures every row, or those whose names are given, and prints the table.
 *
 *     bench [--device cpu|cuda] [--rounds N] [--json FILE] [--plugin FILE] [NAME...]
 *
 * NAME: a row, or an energy, also one of a plug-in, to be measured by itself.
 * Environment: PYTHON, the interpreter that has PyTorch and ONNX Runtime (default python3). */
#include "bench/bench.h"

#include "tasks/hair.h"

#include <cjson/cJSON.h>
#include <malloc.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static const struct {
    const char *name;
    void (*run)(bench *);
} rows[] = {
    { "energies", bench_energies },
    { "chain", bench_chain },
    { "self_collision", bench_self_collision },
    { "body_collision", bench_body_collision },
    { "network", bench_network },
    { "decoder", bench_decoder },
    { "step", bench_step },
    { "inference", bench_inference },
    { "pairs", bench_pairs },
};
enum { ROWS = sizeof rows / sizeof *rows };

bool bench_steady_begin(bench *b, int64_t state[3])
{
    state[0] = hg_alloc_count();
    for (int c = 0; c < 2; c++) state[1 + c] = (int64_t)hg_step_reserved(b->ctx[c]);
    return true;
}

/* The race itself takes memory once, for its times. */
int bench_steady(bench *b, const int64_t state[3])
{
    return hg_alloc_count() - state[0] <= 1 && state[1] == (int64_t)hg_step_reserved(b->ctx[0]) &&
           state[2] == (int64_t)hg_step_reserved(b->ctx[1]);
}

void *bench_get(const hg_tensor *tensor)
{
    void *values = hg_alloc(hg_tensor_bytes(tensor) + 1, 1);
    bench_need(values ? hg_tensor_read(tensor, values) : HG_MEMORY);
    return values;
}

void bench_put(hg_tensor *tensor, const void *values) { bench_need(hg_tensor_write(tensor, values)); }

bool bench_same(const hg_tensor *a, const hg_tensor *b)
{
    void *x = bench_get(a), *y = bench_get(b);
    const bool same = !memcmp(x, y, hg_tensor_bytes(a));
    hg_free(x);
    hg_free(y);
    return same;
}

void bench_write_tensor(bench *b, const char *name, const hg_tensor *tensor)
{
    void *values = bench_get(tensor);
    bench_write(b, name, tensor->dtype, tensor->rank, tensor->shape, values);
    hg_free(values);
}

void bench_add(bench *b, const bench_result *result)
{
    if (b->n == (int)(sizeof b->result / sizeof *b->result)) return;
    bench_result *r = &b->result[b->n++];
    *r = *result;
    if (b->device) r->aim = 0; /* those are of the processor */
    if (r->other_ms > 0 && r->ours_ms > 0 && !r->at_most) r->ratio = r->other_ms / r->ours_ms;
    fprintf(stderr, "%-32s %-28s %10.3f   %-28s %10.3f   %6.2f\n", r->row, r->ours, r->ours_ms, r->other, r->other_ms,
            r->ratio);
}

static const char *reached(const bench_result *r)
{
    if (r->aim == 0 || r->ratio == 0) return "";
    return (r->at_most ? r->ratio <= r->aim : r->ratio >= r->aim) ? "yes" : "no";
}

static void print_table(const bench *b)
{
    char where[200];
    snprintf(where, sizeof where, "%d threads", BENCH_THREADS);
    hg_device_info devices[8];
    const int n_devices = hg_devices(devices, 8);
    for (int i = 0; i < n_devices && i < 8 && b->device; i++)
        if (!strcmp(devices[i].name, b->device)) snprintf(where, sizeof where, "%s", devices[i].what);
    printf("%s; multiply-add %.0f GFLOP/s (f32), copying %.1f GB/s, measured in this run. Times in ms, medians of runs "
           "in turn.\n\n",
           where, 1e-9 * b->operations, 1e-9 * b->bytes);
    printf("| row | hairgrad | ms | beside it | ms | ratio | aim | reached | GFLOP/s (of peak) | GB/s (of copy) | same "
           "bits | steady |\n"
           "|---|---|---|---|---|---|---|---|---|---|---|---|\n");
    for (int i = 0; i < b->n; i++) {
        const bench_result *r = &b->result[i];
        char other[32] = "", ratio[32] = "", aim[32] = "", operations[48] = "", bytes[48] = "";
        static const char *const answers[3] = { "", "no", "yes" };
        if (r->other_ms > 0) snprintf(other, sizeof other, "%.3g", r->other_ms);
        if (r->ratio > 0) snprintf(ratio, sizeof ratio, "%.3g", r->ratio);
        if (r->aim > 0) snprintf(aim, sizeof aim, "%s %.3g", r->at_most ? "<=" : ">=", r->aim);
        if (r->operations > 0 && r->ours_ms > 0) {
            const double rate = 1e3 * r->operations / r->ours_ms;
            snprintf(operations, sizeof operations, "%.0f (%.0f %%)", 1e-9 * rate, 100 * rate / b->operations);
        }
        if (r->bytes > 0 && r->ours_ms > 0) {
            const double rate = 1e3 * r->bytes / r->ours_ms;
            snprintf(bytes, sizeof bytes, "%.1f (%.0f %%)", 1e-9 * rate, 100 * rate / b->bytes);
        }
        printf("| %s | %s | %.3g | %s | %s | %s | %s | %s | %s | %s | %s | %s |\n", r->row, r->ours, r->ours_ms,
               r->other, other, ratio, aim, reached(r), operations, bytes, answers[r->same_bits + 1],
               answers[r->steady + 1]);
    }
    printf("\nSame bits: results of %s are equal. Steady: nothing was allocated while it was measured.\n",
           b->device ? "two runs" : "1 and 2 threads");
    for (int i = 0; i < b->n; i++) {
        if (!b->result[i].note[0] || (i && !strcmp(b->result[i].note, b->result[i - 1].note))) continue;
        printf("- %s: %s\n", b->result[i].row, b->result[i].note);
    }
}

static void write_json(const bench *b, const char *path)
{
    cJSON *all = cJSON_CreateObject(), *list = cJSON_CreateArray();
    cJSON_AddNumberToObject(all, "threads", BENCH_THREADS);
    cJSON_AddNumberToObject(all, "operations_per_second", b->operations);
    cJSON_AddNumberToObject(all, "copy_bytes_per_second", b->bytes);
    for (int i = 0; i < b->n; i++) {
        const bench_result *r = &b->result[i];
        cJSON *row = cJSON_CreateObject();
        cJSON_AddStringToObject(row, "row", r->row);
        cJSON_AddStringToObject(row, "ours", r->ours);
        cJSON_AddNumberToObject(row, "ours_ms", r->ours_ms);
        cJSON_AddStringToObject(row, "other", r->other);
        cJSON_AddNumberToObject(row, "other_ms", r->other_ms);
        cJSON_AddNumberToObject(row, "ratio", r->ratio);
        cJSON_AddNumberToObject(row, "aim", r->aim);
        cJSON_AddBoolToObject(row, "at_most", r->at_most);
        cJSON_AddStringToObject(row, "reached", reached(r));
        cJSON_AddNumberToObject(row, "operations", r->operations);
        cJSON_AddNumberToObject(row, "bytes", r->bytes);
        cJSON_AddNumberToObject(row, "same_bits", r->same_bits);
        cJSON_AddNumberToObject(row, "steady", r->steady);
        cJSON_AddStringToObject(row, "note", r->note);
        cJSON_AddItemToArray(list, row);
    }
    cJSON_AddItemToObject(all, "rows", list);
    char *text = cJSON_Print(all);
    cJSON_Delete(all);
    if (!text) bench_need(HG_MEMORY);
    bench_need(hg_file_write(path, text, strlen(text)));
    free(text);
}

static void usage(void)
{
    fprintf(stderr, "usage: bench [--device cpu|cuda] [--rounds N] [--json FILE] [--plugin FILE] [NAME...]; names are "
                    "those of energies, and");
    for (int i = 0; i < ROWS; i++) fprintf(stderr, " %s", rows[i].name);
    fprintf(stderr, "\n");
    exit(2);
}

static void start(bench *b)
{
    for (int c = 0; c < 2; c++)
        bench_need(hg_ctx_create(
            &b->ctx[c], &(hg_ctx_options){ .threads = b->device ? 2 : c + 1, .seed = 1, .device = b->device }));
    bench_need(hg_ctx_create(&b->host, &(hg_ctx_options){ .threads = BENCH_THREADS, .seed = 1, .device = "cpu" }));
    snprintf(b->folder, sizeof b->folder, "%s/hairgrad-bench-XXXXXX", getenv("TMPDIR") ? getenv("TMPDIR") : "/tmp");
    if (!mkdtemp(b->folder)) {
        fprintf(stderr, "bench: %s: cannot be made\n", b->folder);
        exit(1);
    }
}

static void end(bench *b)
{
    char command[300];
    hg_step_reset(b->host);
    hg_hair_task_destroy(b->task[2]);
    for (int c = 0; c < 2; c++) {
        hg_step_reset(b->ctx[c]);
        hg_hair_task_destroy(b->task[c]);
        hg_ctx_destroy(b->ctx[c]);
    }
    hg_ctx_destroy(b->host);
    snprintf(command, sizeof command, "rm -rf '%s'", b->folder);
    if (system(command) != 0) fprintf(stderr, "bench: %s is left behind\n", b->folder);
}

int main(int count, char **words)
{
    /* As the program does: threads that wait spin for a fifth of a millisecond and then sleep, so that they do not take the
     * other side's cores. Read before main, so once more. */
    if (!getenv("BENCH_SET_WAIT")) {
        setenv("OMP_WAIT_POLICY", "passive", 1);
        setenv("GOMP_SPINCOUNT", "20000", 1);
        setenv("BENCH_SET_WAIT", "1", 1);
        execv("/proc/self/exe", words);
    }
    mallopt(M_MMAP_THRESHOLD, 1 << 20); /* as the program does, too */
    bench b = { .rounds = 9, .source = BENCH_SOURCE, .python = getenv("PYTHON") ? getenv("PYTHON") : "python3" };
    bool wanted[ROWS] = { false }, any = false, memory = false;
    const char *json = NULL, *own[32];
    int n_own = 0;
    bench_need(hg_plugins_load(getenv("HAIRGRAD_PLUGINS")));
    for (int i = 1; i + 1 < count; i++)
        if (!strcmp(words[i], "--plugin")) bench_need(hg_plugin_load(words[i + 1]));
    for (int i = 1; i < count; i++) {
        int row = 0;
        while (row < ROWS && strcmp(words[i], rows[row].name)) row++;
        if (row < ROWS)
            wanted[row] = any = true;
        else if (!strcmp(words[i], "--step-memory"))
            memory = true;
        else if (!strcmp(words[i], "--rounds") && i + 1 < count && atoi(words[i + 1]) > 0)
            b.rounds = atoi(words[++i]);
        else if (!strcmp(words[i], "--json") && i + 1 < count)
            json = words[++i];
        else if (!strcmp(words[i], "--plugin") && i + 1 < count)
            i++;
        else if (!strcmp(words[i], "--device") && i + 1 < count)
            b.device = strcmp(words[++i], "cpu") ? words[i] : NULL;
        else if (n_own < 32 && hg_find("energy", words[i]))
            own[n_own++] = words[i];
        else
            usage();
    }
    signal(SIGPIPE, SIG_IGN); /* the other side may not be there */
    start(&b);
    if (memory) {
        bench_step_memory(&b);
        end(&b);
        return 0;
    }
    bench_need(hg_machine_limits(b.ctx[1], &b.operations, &b.bytes));
    for (int i = 0; i < ROWS; i++)
        if (wanted[i] || (!any && n_own == 0)) rows[i].run(&b);
    for (int i = 0; i < n_own; i++) bench_energy(&b, own[i]);
    double operations, bytes; /* again: a neighbour may have halved the machine the first time */
    bench_need(hg_machine_limits(b.ctx[1], &operations, &bytes));
    if (operations > b.operations) b.operations = operations;
    if (bytes > b.bytes) b.bytes = bytes;
    print_table(&b);
    if (json) write_json(&b, json);
    end(&b);
    return 0;
}
