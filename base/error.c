/* The sentence of the last failure, kept per thread, and the names of the statuses. */
#include "base/base.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

static _Thread_local char thread_message[4096];

hg_status hg_fail(hg_status status, const char *format, ...)
{
    /* The arguments may point into the present message (a sentence that quotes another), so it is replaced last. */
    char message[sizeof thread_message];
    va_list arguments;
    va_start(arguments, format);
    int length = vsnprintf(message, sizeof message, format, arguments);
    va_end(arguments);
    if (length < 0) snprintf(message, sizeof message, "a message that could not be written: %s", format);
    if (length >= (int)sizeof message) memcpy(message + sizeof message - 4, "...", 4);
    memcpy(thread_message, message, strlen(message) + 1);
    return status;
}

const char *hg_message(void) { return thread_message; }

const char *hg_status_name(hg_status status)
{
    switch (status) {
    case HG_OK:
        return "ok";
    case HG_INVALID:
        return "invalid";
    case HG_FORMAT:
        return "format";
    case HG_IO:
        return "io";
    case HG_MEMORY:
        return "memory";
    case HG_NUMERIC:
        return "numeric";
    case HG_UNSUPPORTED:
        return "unsupported";
    }
    return "unknown";
}
