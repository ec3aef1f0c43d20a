/* hairgrad flags: what a C compiler needs to know to build a plug-in, or a program, against this very library: the tree that
 * it was built in, or where it was installed. */
#include "cli/cli.h"

#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* The folder that this program lies in; hg_free. */
static char *program_folder(void)
{
    char path[PATH_MAX];
    const ssize_t length = readlink("/proc/self/exe", path, sizeof path - 1);
    if (length <= 0) return hg_strdup("");
    path[length] = '\0';
    char *slash = strrchr(path, '/');
    if (slash != NULL) *slash = '\0';
    return hg_strdup(path);
}

static bool holds(const char *folder, const char *name)
{
    char *path = hg_path_join(folder, name);
    const bool there = path != NULL && hg_file_exists(path);
    hg_free(path);
    return there;
}

static char *resolved(const char *folder, const char *below)
{
    char *path = hg_path_join(folder, below), real[PATH_MAX];
    char *found = path != NULL && realpath(path, real) != NULL ? hg_strdup(real) : NULL;
    hg_free(path);
    return found;
}

static int flags(const hg_arguments *arguments)
{
    char *here = program_folder(), real[PATH_MAX];
    char *include = NULL, *library = NULL;
    if (here != NULL && realpath(HG_BUILD_ROOT, real) != NULL && strcmp(here, real) == 0) { /* where it was built */
        include = hg_strdup(HG_SOURCE_ROOT);
        library = hg_strdup(here);
    } else if (here != NULL) { /* where it was installed, or moved to */
        include = resolved(here, "../include/hairgrad");
        if (include != NULL && !holds(include, "hairgrad.h")) {
            hg_free(include);
            include = NULL;
        }
        if (include == NULL && holds(HG_INCLUDE_DIR, "hairgrad.h")) include = hg_strdup(HG_INCLUDE_DIR);
        library = resolved(here, "../" HG_LIBRARY_NAME);
        if (library == NULL || !holds(library, "libhairgrad.so")) {
            hg_free(library);
            library = hg_strdup(HG_LIBRARY_DIR);
        }
    }
    hg_free(here);
    int result = 0;
    if (include == NULL || library == NULL) {
        hg_fail(HG_IO, "flags: the headers of hairgrad are not where they were installed, %s", HG_INCLUDE_DIR);
        result = cli_fail();
    } else if (cli_flag(arguments, "libs")) {
        printf("-L%s -Wl,-rpath,%s -lhairgrad -lm\n", library, library);
    } else {
        printf("-I%s\n", include);
    }
    hg_free(include);
    hg_free(library);
    return result;
}

static const hg_argument flags_options[] = {
    { "libs", NULL, "what a program that uses the library is linked with; a plug-in needs none of it", false },
};
HG_COMMAND(flags, .what = "the flags that cc needs to build a plug-in or a program", .options = flags_options,
           .n_options = 1, .run = flags,
           .more = "  cc -shared -fPIC $(hairgrad flags) my_loss.c -o my_loss.so          a plug-in\n"
                   "  cc $(hairgrad flags) my_program.c $(hairgrad flags --libs)          a program\n"
                   "The first is pkg-config --cflags hairgrad where hairgrad is installed.\n");
