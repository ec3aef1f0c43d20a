/* Facts about a file, as lines of text or as JSON: what `hairgrad info` says. Private to cli/. */
#ifndef HG_CLI_FACTS_H
#define HG_CLI_FACTS_H

#include "cli/cli.h"

typedef struct {
    hg_text out;
    bool json;
    int count;
} facts;

void facts_text(facts *f, const char *key, const char *text);
void facts_numbers(facts *f, const char *key, int n, const double *numbers, const char *unit);
void facts_number(facts *f, const char *key, double number, const char *unit);
void facts_count(facts *f, const char *key, int64_t count);
void facts_hash(facts *f, const char *key, uint64_t hash);
void facts_texts(facts *f, const char *key, char *const *texts, int64_t n);
void facts_extent(facts *f, const float *points, int64_t n); /* lowest and highest corner [m] */

/* A file of another program that a reader knows: strands, a body, a motion, or several of them. */
bool info_is_foreign(const char *path);
hg_status info_foreign(facts *f, const char *path);

#endif
