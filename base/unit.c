/* Numbers with units: "5 mm", "0.2 N/m", "1e-7 N m^2", "1.3 g/cm^3", "30 deg", "0.5 1/s". A unit is reduced to powers
 * of metre, kilogram, second and radian, a power of ten, and a factor for those few that are no power of ten. */
#include "base/base.h"

#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { metre, kilogram, second, radian, dimensions };
typedef struct {
    int powers[dimensions], ten;
    double factor;
} measure;

static const struct {
    const char *name;
    int powers[dimensions], ten;
    double factor;
    bool prefixed; /* takes m, k, M, ... */
} units[] = {
    { "1", { 0 }, 0, 1.0, false },
    { "m", { 1, 0, 0, 0 }, 0, 1.0, true },
    { "g", { 0, 1, 0, 0 }, -3, 1.0, true },
    { "s", { 0, 0, 1, 0 }, 0, 1.0, true },
    { "min", { 0, 0, 1, 0 }, 0, 60.0, false },
    { "h", { 0, 0, 1, 0 }, 0, 3600.0, false },
    { "Hz", { 0, 0, -1, 0 }, 0, 1.0, true },
    { "N", { 1, 1, -2, 0 }, 0, 1.0, true },
    { "J", { 2, 1, -2, 0 }, 0, 1.0, true },
    { "W", { 2, 1, -3, 0 }, 0, 1.0, true },
    { "Pa", { -1, 1, -2, 0 }, 0, 1.0, true },
    { "dyn", { 1, 1, -2, 0 }, -5, 1.0, false },
    { "erg", { 2, 1, -2, 0 }, -7, 1.0, false },
    { "tex", { -1, 1, 0, 0 }, -6, 1.0, true },
    { "rad", { 0, 0, 0, 1 }, 0, 1.0, true },
    { "deg", { 0, 0, 0, 1 }, 0, 3.141592653589793 / 180.0, false },
    { "\302\260", { 0, 0, 0, 1 }, 0, 3.141592653589793 / 180.0, false },
    { "%", { 0 }, -2, 1.0, false },
};

static const struct {
    const char *name;
    int ten;
} prefixes[] = { { "n", -9 }, { "u", -6 }, { "\302\265", -6 }, { "\316\274", -6 }, { "m", -3 },
                 { "c", -2 }, { "d", -1 }, { "k", 3 },         { "M", 6 },         { "G", 9 } };

static bool find_unit(const char *name, size_t length, bool with_prefix, size_t *index)
{
    for (size_t i = 0; i < sizeof units / sizeof *units; i++) {
        if (with_prefix && !units[i].prefixed) continue;
        if (strlen(units[i].name) == length && memcmp(units[i].name, name, length) == 0) return *index = i, true;
    }
    return false;
}

static bool find_symbol(const char *name, size_t length, measure *to)
{
    size_t index, skip = 0;
    int ten = 0;
    if (!find_unit(name, length, false, &index)) {
        bool found = false;
        for (size_t i = 0; i < sizeof prefixes / sizeof *prefixes && !found; i++) {
            skip = strlen(prefixes[i].name);
            ten = prefixes[i].ten;
            found = skip < length && memcmp(prefixes[i].name, name, skip) == 0 &&
                    find_unit(name + skip, length - skip, true, &index);
        }
        if (!found) return false;
    }
    memcpy(to->powers, units[index].powers, sizeof to->powers);
    to->ten = units[index].ten + ten;
    to->factor = units[index].factor;
    return true;
}

/* "^2", "^-1", "2", or the superscripts two and three. */
static int read_power(const char **at)
{
    if (strncmp(*at, "\302\262", 2) == 0) return *at += 2, 2;
    if (strncmp(*at, "\302\263", 2) == 0) return *at += 2, 3;
    if (**at != '^' && !isdigit((unsigned char)**at)) return 1;
    if (**at == '^') (*at)++;
    char *end;
    long power = strtol(*at, &end, 10);
    if (end == *at || power < -9 || power > 9) return 0;
    *at = end;
    return (int)power;
}

/* Factors in a row, joined by a space, "*" or the middle dot; "/" turns the next one over. */
static bool read_unit(const char *text, measure *to)
{
    *to = (measure){ .factor = 1.0 };
    bool over = false, any = false;
    const char *at = text;
    for (;;) {
        while (*at == ' ' || *at == '*' || *at == '/' || strncmp(at, "\302\267", 2) == 0) {
            if (*at == '/') {
                if (over) return false;
                over = true;
            }
            at += *at == '\302' ? 2 : 1;
        }
        if (*at == '\0') return any && !over;
        const char *name = at;
        if (*at == '1')
            at++;
        else
            while (*at != '\0' && *at != ' ' && *at != '*' && *at != '/' && *at != '^' &&
                   !isdigit((unsigned char)*at) && strncmp(at, "\302\267", 2) != 0 && strncmp(at, "\302\262", 2) != 0 &&
                   strncmp(at, "\302\263", 2) != 0)
                at++;
        measure one;
        if (at == name || !find_symbol(name, (size_t)(at - name), &one)) return false;
        int power = read_power(&at);
        if (power == 0) return false;
        if (over) power = -power;
        for (int i = 0; i < dimensions; i++) to->powers[i] += power * one.powers[i];
        to->ten += power * one.ten;
        to->factor *= pow(one.factor, power);
        over = false;
        any = true;
    }
}

/* Powers of ten up to 1e22 are exact, and so one division or product is the nearest number to what was written. */
static double shift(double value, int ten)
{
    for (; ten > 22; ten -= 22) value *= 1e22;
    for (; ten < -22; ten += 22) value /= 1e22;
    double power = 1.0;
    for (int i = 0; i < abs(ten); i++) power *= 10.0;
    return ten < 0 ? value / power : value * power;
}

hg_status hg_unit_parse(const char *text, const char *unit, double *value)
{
    while (isspace((unsigned char)*text)) text++;
    char *end;
    double number = strtod(text, &end);
    const char *rest = end;
    if (end == text) return hg_fail(HG_INVALID, "\"%s\" is not a number", text);
    if (!isfinite(number)) return hg_fail(HG_INVALID, "\"%s\" is not a finite number", text);
    while (isspace((unsigned char)*rest)) rest++;
    size_t length = strlen(rest);
    while (length > 0 && isspace((unsigned char)rest[length - 1])) length--;
    char written[64];
    if (length >= sizeof written) return hg_fail(HG_INVALID, "\"%.40s...\" is not a number with a unit", text);
    memcpy(written, rest, length);
    written[length] = '\0';
    if (length == 0 ||
        (unit != NULL && strcmp(written, unit) == 0)) { /* as it is: what was echoed is read back to the bit */
        *value = number;
        return HG_OK;
    }
    measure is, should;
    if (unit == NULL) return hg_fail(HG_INVALID, "\"%s\" has the unit %s, a bare number is needed", text, written);
    const char *needed = strcmp(unit, "1") == 0 ? "a number without unit" : unit;
    if (!read_unit(written, &is))
        return hg_fail(HG_INVALID, "\"%s\": %s is not a known unit, %s is needed", text, written, needed);
    if (!read_unit(unit, &should))
        return hg_fail(HG_INVALID, "\"%s\" is declared with the unknown unit %s", text, unit);
    if (memcmp(is.powers, should.powers, sizeof is.powers) != 0)
        return hg_fail(HG_INVALID, "\"%s\" has the unit %s, %s is needed", text, written, needed);
    double converted = shift(number, is.ten - should.ten);
    if (is.factor != should.factor) converted *= is.factor / should.factor;
    if (!isfinite(converted)) return hg_fail(HG_INVALID, "\"%s\" is not a finite number", text);
    *value = converted;
    return HG_OK;
}
