/* Facts about a file, as lines of text or as JSON: what `hairgrad info` says. */
#include "cli/facts.h"

#include <inttypes.h>
#include <math.h>

static void add_quoted(hg_text *out, const char *text)
{
    hg_text_add(out, "\"");
    for (const unsigned char *c = (const unsigned char *)text; *c; c++) {
        if (*c == '"' || *c == '\\')
            hg_text_add(out, "\\%c", *c);
        else if (*c < 0x20)
            hg_text_add(out, "\\u%04x", *c);
        else
            hg_text_add(out, "%c", *c);
    }
    hg_text_add(out, "\"");
}

static void begin_fact(facts *f, const char *key)
{
    if (!f->json) {
        hg_text_add(&f->out, "  %-20s ", key);
    } else {
        hg_text_add(&f->out, "%s\n    ", f->count ? "," : "");
        add_quoted(&f->out, key);
        hg_text_add(&f->out, ": ");
    }
    f->count++;
}

static void end_fact(facts *f, const char *unit)
{
    if (!f->json) hg_text_add(&f->out, "%s%s\n", *unit ? " " : "", unit);
}

void facts_text(facts *f, const char *key, const char *text)
{
    begin_fact(f, key);
    if (f->json)
        add_quoted(&f->out, text);
    else
        hg_text_add(&f->out, "%s", *text ? text : "-");
    end_fact(f, "");
}

/* Numbers of one line; JSON has no NaN: null. */
void facts_numbers(facts *f, const char *key, int n, const double *numbers, const char *unit)
{
    begin_fact(f, key);
    if (f->json && n != 1) hg_text_add(&f->out, "[");
    for (int i = 0; i < n; i++) {
        hg_text_add(&f->out, "%s", i ? f->json ? ", " : " " : "");
        if (isfinite(numbers[i]))
            hg_text_add(&f->out, f->json ? "%.9g" : "%.6g", numbers[i]);
        else
            hg_text_add(&f->out, f->json ? "null" : "-");
    }
    if (f->json && n != 1) hg_text_add(&f->out, "]");
    end_fact(f, unit);
}

void facts_number(facts *f, const char *key, double number, const char *unit)
{
    facts_numbers(f, key, 1, &number, unit);
}

void facts_count(facts *f, const char *key, int64_t count)
{
    begin_fact(f, key);
    hg_text_add(&f->out, "%" PRId64, count);
    end_fact(f, "");
}

void facts_hash(facts *f, const char *key, uint64_t hash)
{
    char text[20];
    snprintf(text, sizeof text, "%016" PRIx64, hash);
    facts_text(f, key, text);
}

void facts_texts(facts *f, const char *key, char *const *texts, int64_t n)
{
    begin_fact(f, key);
    hg_text_add(&f->out, f->json ? "[" : "");
    for (int64_t i = 0; i < n; i++) {
        hg_text_add(&f->out, "%s", i ? f->json ? ", " : " " : "");
        if (f->json)
            add_quoted(&f->out, texts[i]);
        else
            hg_text_add(&f->out, "%s", texts[i]);
    }
    hg_text_add(&f->out, f->json ? "]" : "");
    end_fact(f, "");
}

void facts_extent(facts *f, const float *points, int64_t n)
{
    double low[3] = { INFINITY, INFINITY, INFINITY }, high[3] = { -INFINITY, -INFINITY, -INFINITY };
    for (int64_t i = 0; i < 3 * n; i++) {
        double x = (double)points[i];
        low[i % 3] = fmin(low[i % 3], x), high[i % 3] = fmax(high[i % 3], x);
    }
    facts_numbers(f, "lowest_corner", 3, low, "m");
    facts_numbers(f, "highest_corner", 3, high, "m");
}
