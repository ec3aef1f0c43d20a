/* What tests share: cmocka with what it needs, and a folder of their own that goes away at the end. */
#ifndef HG_TEST_H
#define HG_TEST_H

#include "base/base.h"

#include <dirent.h>
#include <ftw.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

static char test_folder_path[512];

__attribute__((unused)) static const char *test_folder(void) { return test_folder_path; }

/* A path in the folder; hg_free. */
__attribute__((unused)) static char *test_path(const char *name) { return hg_path_join(test_folder_path, name); }

__attribute__((unused)) static int test_folder_make(void **state)
{
    (void)state;
    const char *base = getenv("TMPDIR");
    snprintf(test_folder_path, sizeof test_folder_path, "%s/hairgrad-test-XXXXXX", base != NULL ? base : "/tmp");
    return mkdtemp(test_folder_path) == NULL ? -1 : 0;
}

__attribute__((unused)) static int test_remove_one(const char *path, const struct stat *about, int kind, struct FTW *at)
{
    (void)about, (void)kind, (void)at;
    return remove(path);
}

__attribute__((unused)) static int test_folder_remove(void **state)
{
    (void)state;
    return nftw(test_folder_path, test_remove_one, 16, FTW_DEPTH | FTW_PHYS);
}

__attribute__((unused)) static void test_file_is(const char *path, const char *text)
{
    void *bytes;
    size_t size;
    assert_int_equal(hg_file_read(path, &bytes, &size), HG_OK);
    assert_string_equal(bytes, text);
    hg_free(bytes);
}

/* No temporary file is left in the folder. */
__attribute__((unused)) static void test_no_leftovers(void)
{
    DIR *folder = opendir(test_folder_path);
    assert_non_null(folder);
    for (struct dirent *entry = readdir(folder); entry != NULL; entry = readdir(folder))
        assert_null(strstr(entry->d_name, ".part-"));
    closedir(folder);
}

#endif
