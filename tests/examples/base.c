/* The example of base/base.h, in a program: a file with a header that is too short, and one that is long enough. */
#include "base/base.h"

#include <string.h>

hg_status load(const char *path);

#include "example.inc"

int main(int count, char **words)
{
    static const char bytes[200];
    if (count < 2 || hg_file_write(words[1], bytes, 100) != HG_OK) return 1;
    if (load(words[1]) != HG_FORMAT || strstr(hg_message(), "100 bytes, a header needs 160") == NULL) return 2;
    if (hg_file_write(words[1], bytes, 200) != HG_OK) return 3;
    return load(words[1]) == HG_OK ? 0 : 4;
}
