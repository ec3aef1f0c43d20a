/* Long work says how far it is; what is shown, and where, is the program's business. */
#include "base/base.h"

#include <stdarg.h>
#include <stdio.h>

void hg_progress_report(const hg_progress *progress, double fraction, const char *format, ...)
{
    if (progress == NULL || progress->report == NULL) return;
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    int length = vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    progress->report(progress->self, fraction, length < 0 ? "" : text);
}
