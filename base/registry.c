/* Everything that is known by a name. Entries come from constructors, in whatever order the linker chose, so the list
 * is kept sorted: what is listed, and the order of every loop over it, is the same in every build. */
#include "base/internal.h"

#include <ctype.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>

#define HG_TEXT_(text_) #text_
#define HG_TEXT(text_)  HG_TEXT_(text_)

static hg_entry *entries;
static char clash[256];
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

static int compare(const hg_entry *entry, const char *kind, const char *name)
{
    int order = strcmp(entry->kind, kind);
    return order != 0 ? order : strcmp(entry->name, name);
}

static _Thread_local hg_registering *watching;

void hg_registry_watch(hg_registering *to) { watching = to; }

static void remember(const char *format, const char *a, const char *b)
{
    char *to = watching ? watching->wrong : clash;
    if (to[0] == '\0') snprintf(to, sizeof clash, format, a, b);
}

void hg_register(hg_entry *entry)
{
    pthread_mutex_lock(&lock);
    if (entry->abi != HG_ABI_VERSION) { /* nothing else of it can be trusted */
        char given[24];
        snprintf(given, sizeof given, entry->abi < 1000000 ? "%llu" : "an old one", (unsigned long long)entry->abi);
        remember("it was compiled with the headers of ABI version %s, this library has %s; compile it again", given,
                 HG_TEXT(HG_ABI_VERSION));
        pthread_mutex_unlock(&lock);
        return;
    }
    hg_entry **at = &entries;
    while (*at != NULL && compare(*at, entry->kind, entry->name) < 0) at = &(*at)->next;
    if (*at != NULL && compare(*at, entry->kind, entry->name) == 0) {
        if (*at != entry) remember("%s \"%s\" is registered twice; the first one is used", entry->kind, entry->name);
    } else {
        entry->next = *at;
        *at = entry;
        if (watching && watching->n < HG_PLUGIN_ENTRIES) watching->entry[watching->n++] = entry;
    }
    pthread_mutex_unlock(&lock);
}

void hg_registry_forget(hg_entry *entry)
{
    pthread_mutex_lock(&lock);
    hg_entry **at = &entries;
    while (*at != NULL && *at != entry) at = &(*at)->next;
    if (*at != NULL) *at = entry->next;
    pthread_mutex_unlock(&lock);
}

const char *hg_registry_clash(void) { return clash[0] != '\0' ? clash : NULL; }

const void *hg_find(const char *kind, const char *name)
{
    pthread_mutex_lock(&lock);
    const hg_entry *entry = entries;
    while (entry != NULL && compare(entry, kind, name) != 0) entry = entry->next;
    pthread_mutex_unlock(&lock);
    return entry != NULL ? entry->item : NULL;
}

int hg_list(const char *kind, const char **names, int max)
{
    int count = 0;
    pthread_mutex_lock(&lock);
    for (const hg_entry *entry = entries; entry != NULL; entry = entry->next) {
        if (strcmp(entry->kind, kind) != 0) continue;
        if (count < max) names[count] = entry->name;
        count++;
    }
    pthread_mutex_unlock(&lock);
    return count;
}

/* ---- spelling ----------------------------------------------------------------------------------------------- */

static int plain(char letter) { return letter == '-' ? '_' : tolower((unsigned char)letter); }

/* Optimal string alignment: insertions, deletions, replacements and swaps of neighbours cost one each. */
static int distance(const char *a, const char *b)
{
    enum { longest = 63 };
    int rows[3][longest + 1];
    size_t length_a = strnlen(a, longest), length_b = strnlen(b, longest);
    int *before = rows[0], *last = rows[1], *now = rows[2];
    for (size_t j = 0; j <= length_b; j++) last[j] = (int)j;
    for (size_t i = 1; i <= length_a; i++) {
        now[0] = (int)i;
        for (size_t j = 1; j <= length_b; j++) {
            bool same = plain(a[i - 1]) == plain(b[j - 1]);
            int best = last[j - 1] + (same ? 0 : 1);
            if (last[j] + 1 < best) best = last[j] + 1;
            if (now[j - 1] + 1 < best) best = now[j - 1] + 1;
            bool swapped = i > 1 && j > 1 && plain(a[i - 1]) == plain(b[j - 2]) && plain(a[i - 2]) == plain(b[j - 1]);
            if (swapped && before[j - 2] + 1 < best) best = before[j - 2] + 1;
            now[j] = best;
        }
        int *row = before;
        before = last, last = now, now = row;
    }
    return last[length_b];
}

/* How far `known` is from `name`, or -1 when it is too far to be what was meant. */
static int nearness(const char *name, const char *known)
{
    size_t length = strnlen(name, 63), other = strnlen(known, 63), longer = length > other ? length : other;
    int steps = distance(name, known);
    if (steps <= (int)(longer + 2) / 3) return steps;
    size_t shorter = length < other ? length : other;
    if (shorter < 3) return -1;
    return strncasecmp(name, known, shorter) == 0 ? steps : -1; /* one begins with the other */
}

const char *hg_nearest_of(const char *name, const char *const *names, int n)
{
    const char *nearest = NULL;
    int best = -1;
    for (int i = 0; i < n; i++) {
        int steps = names[i] == NULL ? -1 : nearness(name, names[i]);
        if (steps >= 0 && (best < 0 || steps < best)) nearest = names[i], best = steps;
    }
    return nearest;
}

const char *hg_nearest(const char *kind, const char *name)
{
    const char *nearest = NULL;
    int best = -1;
    pthread_mutex_lock(&lock);
    for (const hg_entry *entry = entries; entry != NULL; entry = entry->next) {
        if (strcmp(entry->kind, kind) != 0) continue;
        int steps = nearness(name, entry->name);
        if (steps >= 0 && (best < 0 || steps < best)) nearest = entry->name, best = steps;
    }
    pthread_mutex_unlock(&lock);
    return nearest;
}
