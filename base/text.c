/* Strings: copies, formatting, a growing text, and the hash that names groom files and cached kernels. */
#include "base/base.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

char *hg_strdup(const char *text)
{
    size_t size = strlen(text) + 1;
    char *copy = hg_alloc(size, 1);
    if (copy != NULL) memcpy(copy, text, size);
    return copy;
}

char *hg_format(const char *format, ...)
{
    va_list arguments, again;
    va_start(arguments, format);
    va_copy(again, arguments);
    int length = vsnprintf(NULL, 0, format, arguments);
    va_end(arguments);
    char *text = length < 0 ? NULL : hg_alloc((size_t)length + 1, 1);
    if (text != NULL) vsnprintf(text, (size_t)length + 1, format, again);
    va_end(again);
    if (length < 0) hg_fail(HG_INVALID, "text: \"%s\" cannot be formatted", format);
    return text;
}

void hg_text_add(hg_text *text, const char *format, ...)
{
    if (text->failed) return;
    va_list arguments, again;
    va_start(arguments, format);
    va_copy(again, arguments);
    int length = vsnprintf(NULL, 0, format, arguments);
    va_end(arguments);
    if (length < 0) {
        text->failed = true;
        va_end(again);
        return;
    }
    size_t needed = text->size + (size_t)length + 1;
    if (needed > text->capacity) {
        size_t capacity = text->capacity < 256 ? 256 : text->capacity;
        while (capacity < needed) capacity *= 2;
        char *data = hg_resize(text->data, text->size, capacity, 1);
        if (data == NULL) {
            text->failed = true;
            va_end(again);
            return;
        }
        text->data = data;
        text->capacity = capacity;
    }
    vsnprintf(text->data + text->size, (size_t)length + 1, format, again);
    text->size += (size_t)length;
    va_end(again);
}

void hg_text_free(hg_text *text)
{
    hg_free(text->data);
    *text = (hg_text){ 0 };
}

/* FNV-1a. */
uint64_t hg_hash(const void *bytes, size_t size, uint64_t seed)
{
    const unsigned char *byte = bytes;
    uint64_t hash = UINT64_C(0xcbf29ce484222325) ^ seed;
    for (size_t i = 0; i < size; i++) hash = (hash ^ byte[i]) * UINT64_C(0x100000001b3);
    return hash;
}

size_t hg_dtype_size(hg_dtype dtype)
{
    switch (dtype) {
    case HG_F32:
        return 4;
    case HG_F64:
        return 8;
    case HG_I32:
        return 4;
    case HG_BF16:
        return 2;
    case HG_TF32:
        return 0; /* nothing is stored in it */
    }
    return 0;
}

const char *hg_dtype_name(hg_dtype dtype)
{
    switch (dtype) {
    case HG_F32:
        return "f32";
    case HG_F64:
        return "f64";
    case HG_I32:
        return "i32";
    case HG_BF16:
        return "bf16";
    case HG_TF32:
        return "tf32";
    }
    return "unknown";
}
