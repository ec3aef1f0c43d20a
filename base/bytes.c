/* Reading inside the bounds of a byte range. */
#include "base/base.h"

#include <string.h>

hg_status hg_bytes_read(hg_bytes *from, void *to, size_t size, const char *what)
{
    if (from->offset > from->size || size > from->size - from->offset)
        return hg_fail(
            HG_FORMAT,
            "%s: %s needs %zu bytes at offset %zu, the file ends at %zu; it is truncated or not what it says",
            from->path, what, size, from->offset, from->size);
    if (size > 0) memcpy(to, from->bytes + from->offset, size);
    from->offset += size;
    return HG_OK;
}

hg_status hg_bytes_seek(hg_bytes *from, size_t offset, const char *what)
{
    if (offset > from->size)
        return hg_fail(
            HG_FORMAT,
            "%s: %s is said to begin at offset %zu, the file ends at %zu; it is truncated or not what it says",
            from->path, what, offset, from->size);
    from->offset = offset;
    return HG_OK;
}
