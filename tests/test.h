/* What tests share: cmocka with what it needs, and a folder of their own that goes away at the end. */
#ifndef HG_TEST_H
#define HG_TEST_H

#include "base/base.h"

#include <dirent.h>
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

static char test_folder_path[256];

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

__attribute__((unused)) static void test_remove_all(const char *path)
{
    DIR *folder = opendir(path);
    for (struct dirent *entry; folder != NULL && (entry = readdir(folder)) != NULL;) {
        if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0) continue;
        char *inside = hg_path_join(path, entry->d_name);
        struct stat about;
        if (lstat(inside, &about) == 0 && S_ISDIR(about.st_mode))
            test_remove_all(inside);
        else
            unlink(inside);
        hg_free(inside);
    }
    if (folder != NULL) closedir(folder);
    rmdir(path);
}

__attribute__((unused)) static int test_folder_remove(void **state)
{
    (void)state;
    test_remove_all(test_folder_path);
    return 0;
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
