/* log: one JSON object per line, named numbers in the order they were added. */
#include "train/log.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void hg_report_add(hg_report *report, const char *name, double value)
{
    if (!report || report->n >= HG_REPORT_MAX) return;
    report->item[report->n].name = name;
    report->item[report->n].value = value;
    report->item[report->n].from = NULL;
    report->n++;
}

void hg_report_later(hg_report *report, const char *name, const hg_tensor *from, int64_t at, double scale)
{
    const int n = report->n;
    hg_report_add(report, name, (double)NAN);
    if (report->n == n) return;
    report->item[n].from = from;
    report->item[n].at = at;
    report->item[n].scale = scale;
}

void hg_report_settle(hg_report *report)
{
    for (int i = 0; i < report->n; i++) {
        if (!report->item[i].from) continue;
        report->item[i].value = report->item[i].scale * hg_tensor_item(report->item[i].from, report->item[i].at);
        report->item[i].from = NULL;
    }
}

double hg_report_get(const hg_report *report, const char *name)
{
    for (int i = 0; report && i < report->n; i++)
        if (!strcmp(report->item[i].name, name)) return report->item[i].value;
    return (double)NAN;
}

struct hg_run_log {
    FILE *file;
    char *path;
};

/* Keeps the lines of steps up to `step`. Lines are ours: each begins with {"step": N, and ends with a newline; a line
 * cut short by a killed run is dropped. */
static hg_status keep_until(const char *path, int64_t step)
{
    if (!hg_file_exists(path)) return HG_OK;
    void *bytes = NULL;
    size_t size = 0;
    HG_TRY(hg_file_read(path, &bytes, &size));
    hg_text kept = { 0 };
    for (const char *line = bytes; *line;) {
        const char *end = strchr(line, '\n');
        if (!end) break;
        long long at = 0;
        if (step > 0 && sscanf(line, "{\"step\": %lld", &at) == 1 && at <= step)
            hg_text_add(&kept, "%.*s\n", (int)(end - line), line);
        line = end + 1;
    }
    hg_free(bytes);
    hg_status status = kept.failed ? HG_MEMORY : hg_file_write(path, kept.data ? kept.data : "", kept.size);
    hg_text_free(&kept);
    return status;
}

hg_status hg_run_log_open(hg_run_log **out, const char *folder, int64_t step)
{
    *out = NULL;
    char *path = hg_path_join(folder, "log.jsonl");
    if (!path) return HG_MEMORY;
    hg_status status = keep_until(path, step);
    hg_run_log *log = status == HG_OK ? hg_alloc(1, sizeof *log) : NULL;
    if (!log) {
        hg_free(path);
        return status == HG_OK ? HG_MEMORY : status;
    }
    log->path = path;
    log->file = fopen(path, "a");
    if (!log->file) {
        status = hg_fail(HG_IO, "%s: cannot be written: %s", path, strerror(errno));
        hg_run_log_close(log);
        return status;
    }
    *out = log;
    return HG_OK;
}

void hg_run_log_close(hg_run_log *log)
{
    if (!log) return;
    if (log->file) fclose(log->file);
    hg_free(log->path);
    hg_free(log);
}

static hg_status finish(hg_run_log *log)
{
    if (fputs("}\n", log->file) < 0 || fflush(log->file))
        return hg_fail(HG_IO, "%s: cannot be written: %s", log->path, strerror(errno));
    return HG_OK;
}

static void json_number(FILE *file, double value)
{
    if (isfinite(value))
        fprintf(file, "%.9g", value);
    else
        fputs("null", file);
}

static void json_text(FILE *file, const char *text)
{
    fputc('"', file);
    for (; *text; text++) {
        if (*text == '"' || *text == '\\')
            fprintf(file, "\\%c", *text);
        else if ((unsigned char)*text < 0x20)
            fprintf(file, "\\u%04x", (unsigned)(unsigned char)*text);
        else
            fputc(*text, file);
    }
    fputc('"', file);
}

hg_status hg_run_log_write(hg_run_log *log, int64_t step, const hg_report *report)
{
    if (!log) return HG_OK;
    fprintf(log->file, "{\"step\": %lld", (long long)step);
    for (int i = 0; i < report->n; i++) {
        fprintf(log->file, ", \"%s\": ", report->item[i].name);
        json_number(log->file, report->item[i].value);
    }
    return finish(log);
}

hg_status hg_run_log_note(hg_run_log *log, int64_t step, const char *name, const char *text)
{
    if (!log) return HG_OK;
    fprintf(log->file, "{\"step\": %lld, \"%s\": ", (long long)step, name);
    json_text(log->file, text);
    return finish(log);
}

hg_status hg_report_write(const char *path, const hg_report *report)
{
    hg_text text = { 0 };
    hg_text_add(&text, "{");
    for (int i = 0; i < report->n; i++) {
        hg_text_add(&text, "%s\n  \"%s\": ", i ? "," : "", report->item[i].name);
        if (isfinite(report->item[i].value))
            hg_text_add(&text, "%.9g", report->item[i].value);
        else
            hg_text_add(&text, "null");
    }
    hg_text_add(&text, "\n}\n");
    const hg_status status = text.failed ? HG_MEMORY : hg_file_write(path, text.data, text.size);
    hg_text_free(&text);
    return status;
}
