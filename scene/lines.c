/* Text files word by word. See lines.h. */
#include "scene/lines.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static bool is_space(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\f' || c == '\v' || c == '\0'; }

hg_status hg_lines_open(hg_lines *lines, const char *path)
{
    void *bytes = NULL;
    size_t size = 0;
    *lines = (hg_lines){ .path = path };
    HG_TRY(hg_file_read(path, &bytes, &size));
    lines->bytes = bytes;
    lines->at = lines->line_end = lines->bytes;
    lines->end = lines->bytes + size;
    return HG_OK;
}

void hg_lines_close(hg_lines *lines)
{
    hg_free(lines->bytes);
    *lines = (hg_lines){ 0 };
}

bool hg_lines_next(hg_lines *lines)
{
    const char *at = lines->line_end;
    while (at < lines->end) {
        if (lines->line > 0) {
            at++; /* the line break that ended the last line */
            if (at >= lines->end) break;
        }
        lines->line++;
        const char *line_end = memchr(at, '\n', (size_t)(lines->end - at));
        lines->line_end = line_end ? line_end : lines->end;
        while (at < lines->line_end && is_space(*at)) at++;
        if (at < lines->line_end && *at != '#') {
            lines->at = at;
            return true;
        }
        at = lines->line_end;
    }
    lines->at = lines->line_end = lines->end;
    return false;
}

bool hg_lines_word(hg_lines *lines, hg_word *word)
{
    const char *at = lines->at;
    while (at < lines->line_end && is_space(*at)) at++;
    const char *start = at;
    while (at < lines->line_end && !is_space(*at)) at++;
    lines->at = at;
    *word = (hg_word){ start, (size_t)(at - start) };
    return at > start;
}

bool hg_lines_flow(hg_lines *lines, hg_word *word)
{
    while (!hg_lines_word(lines, word))
        if (!hg_lines_next(lines)) return false;
    return true;
}

size_t hg_lines_left(const hg_lines *lines) { return (size_t)(lines->end - lines->at); }

hg_status hg_lines_fail(const hg_lines *lines, const char *format, ...)
{
    char text[600];
    va_list values;
    va_start(values, format);
    vsnprintf(text, sizeof text, format, values);
    va_end(values);
    return hg_fail(HG_FORMAT, "%s:%lld: %s", lines->path, (long long)lines->line, text);
}

hg_status hg_lines_number(hg_lines *lines, double *number, const char *what)
{
    hg_word word;
    *number = 0;
    if (!hg_lines_word(lines, &word))
        return hg_lines_fail(lines, "%s: a number is missing at the end of the line", what);
    if (!hg_word_number(word, number))
        return hg_lines_fail(lines, "%s: \"%.*s\" is not a finite number", what, hg_word_length(word), word.at);
    return HG_OK;
}

bool hg_word_is(hg_word word, const char *text)
{
    return strlen(text) == word.size && memcmp(word.at, text, word.size) == 0;
}

static char lower(char c) { return c >= 'A' && c <= 'Z' ? (char)(c - 'A' + 'a') : c; }

bool hg_word_is_any_case(hg_word word, const char *text)
{
    if (strlen(text) != word.size) return false;
    for (size_t i = 0; i < word.size; i++)
        if (lower(word.at[i]) != lower(text[i])) return false;
    return true;
}

/* Decimal numbers with up to 15 digits and a small power of ten are one exact product or quotient of two exact doubles,
 * hence correctly rounded; that is nearly all of them. The rest goes to strtod. */
bool hg_word_number(hg_word word, double *number)
{
    static const double power[] = { 1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                                    1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22 };
    const char *at = word.at, *end = word.at + word.size;
    bool negative = false, any = false;
    if (at < end && (*at == '-' || *at == '+')) negative = *at++ == '-';
    uint64_t mantissa = 0;
    int digits = 0, exponent = 0;
    for (bool fraction = false; at < end; at++) {
        if (*at == '.' && !fraction) {
            fraction = true;
            continue;
        }
        if (*at < '0' || *at > '9') break;
        any = true;
        if (digits < 18) {
            mantissa = mantissa * 10 + (uint64_t)(*at - '0');
            digits += mantissa > 0;
            exponent -= fraction;
        } else {
            digits++;
            exponent += !fraction;
        }
    }
    if (!any) return false;
    if (at < end && (*at == 'e' || *at == 'E')) {
        at++;
        bool minus = false;
        if (at < end && (*at == '-' || *at == '+')) minus = *at++ == '-';
        if (at == end) return false;
        int value = 0;
        for (; at < end && *at >= '0' && *at <= '9'; at++) value = value < 100000 ? value * 10 + (*at - '0') : value;
        exponent += minus ? -value : value;
    }
    if (at != end) return false;
    double value;
    if (mantissa == 0) {
        value = 0;
    } else if (digits <= 15 && exponent >= -22 && exponent <= 22) {
        value = exponent < 0 ? (double)mantissa / power[-exponent] : (double)mantissa * power[exponent];
    } else {
        char text[64]; /* mantissa and exponent without a decimal point: the same in every locale */
        snprintf(text, sizeof text, "%llue%d", (unsigned long long)mantissa, exponent);
        value = strtod(text, NULL);
    }
    *number = negative ? -value : value;
    return isfinite(value);
}

bool hg_word_integer(hg_word word, int64_t *integer)
{
    const char *at = word.at, *end = word.at + word.size;
    bool negative = at < end && *at == '-';
    at += negative;
    if (at == end || end - at > 18) return false;
    int64_t value = 0;
    for (; at < end; at++) {
        if (*at < '0' || *at > '9') return false;
        value = value * 10 + (*at - '0');
    }
    *integer = negative ? -value : value;
    return true;
}

char *hg_word_copy(hg_word word)
{
    char *copy = hg_alloc(word.size + 1, 1);
    if (copy) memcpy(copy, word.at, word.size);
    return copy;
}

int hg_word_length(hg_word word) { return word.size < 40 ? (int)word.size : 40; }
