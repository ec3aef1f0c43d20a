/* json: numbers and names in the files of metrics. Private to tasks/. */
#ifndef HG_TASKS_JSON_H
#define HG_TASKS_JSON_H

#include "tasks/tasks.h"

/* One line, "name": value and what ends it; null where the value is not finite. */
void hg_hair_json_number(hg_text *text, const char *indent, const char *name, double value, const char *end);
void hg_hair_json_text(hg_text *text, const char *words);

#endif
