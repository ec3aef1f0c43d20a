/* Text files word by word: what the readers of .obj, .target, .asf, .amc, .bvh and .tfx 2 share. Private to scene/.
 *
 *     hg_lines lines;
 *     HG_TRY(hg_lines_open(&lines, path));
 *     while (hg_lines_next(&lines)) {              the next line that has a word
 *         hg_word word;
 *         while (hg_lines_word(&lines, &word)) ... the words of that line
 *     }
 *     hg_lines_close(&lines);
 *
 * Nothing is allocated but the file itself, numbers do not depend on the locale, and every message has path and line.
 */
#ifndef HG_SCENE_LINES_H
#define HG_SCENE_LINES_H

#include "base/base.h"

typedef struct {
    const char *at;
    size_t size;
} hg_word;
typedef struct {
    const char *path;
    char *bytes;
    const char *at, *end, *line_end;
    int64_t line;
} hg_lines;

hg_status hg_lines_open(hg_lines *lines, const char *path);
void hg_lines_close(hg_lines *lines);
bool hg_lines_next(hg_lines *lines);                /* to the next line that has a word and is no comment */
bool hg_lines_word(hg_lines *lines, hg_word *word); /* next word of the line; false at its end */
bool hg_lines_flow(hg_lines *lines, hg_word *word); /* next word of this line or a later one; false at the end */
size_t hg_lines_left(const hg_lines *lines);        /* bytes up to the end of the file: bounds any count */
hg_status hg_lines_fail(const hg_lines *lines, const char *format, ...) HG_PRINTF(2, 3); /* "path:line: ..." */
hg_status hg_lines_number(hg_lines *lines, double *number, const char *what); /* next word of the line, finite */

bool hg_word_is(hg_word word, const char *text); /* case counts */
bool hg_word_is_any_case(hg_word word, const char *text);
bool hg_word_number(hg_word word, double *number); /* all of the word, finite */
bool hg_word_integer(hg_word word, int64_t *integer);
char *hg_word_copy(hg_word word);
int hg_word_length(hg_word word); /* for %.*s, at most 40 characters */

#endif
