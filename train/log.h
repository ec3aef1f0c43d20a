/* log: the JSON lines of a run; private to train/. */
#ifndef HG_TRAIN_LOG_H
#define HG_TRAIN_LOG_H

#include "train/train.h"

/* Scalars for TensorBoard (tensorboard.c). Events of steps after `step` are dropped. */
typedef struct hg_events hg_events;
hg_status hg_events_open(hg_events **events, const char *folder, int64_t step);
void hg_events_close(hg_events *events);
hg_status hg_events_write(hg_events *events, int64_t step, const hg_report *report); /* NULL: nothing */
uint32_t hg_crc32c(const void *bytes, size_t size);

typedef struct hg_run_log hg_run_log;
/* Lines of steps after `step` are dropped (a resumed run writes them again); step 0 starts an empty log. */
hg_status hg_run_log_open(hg_run_log **log, const char *folder, int64_t step);
void hg_run_log_close(hg_run_log *log);
/* {"step": 12, "<name>": value, ..}; a number that is not finite is written as null. */
hg_status hg_run_log_write(hg_run_log *log, int64_t step, const hg_report *report);
hg_status hg_run_log_note(hg_run_log *log, int64_t step, const char *name, const char *text);

hg_status hg_report_write(const char *path, const hg_report *report); /* report.json */

#endif
