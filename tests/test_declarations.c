/* What the library itself declares passes the checks that a plug-in has to pass; loading one as a library call. */
#include "autograd/autograd.h"
#include "test.h"

static int check_all(const char *kind, const char *declared_as)
{
    const char *names[256];
    const int n = hg_list(kind, names, 256);
    const hg_declaration *declaration = hg_find("declaration", declared_as);
    assert_non_null(declaration);
    for (int i = 0; i < n; i++)
        if (declaration->check(names[i], hg_find(kind, names[i])) != HG_OK) fail_msg("%s", hg_message());
    return n;
}

static void test_own_declarations(void **state)
{
    (void)state;
    assert_true(check_all("energy", "energy") >= 9);
    assert_true(check_all("op", "op") >= 30);
    assert_true(check_all("model", "model") >= 2);
    assert_true(check_all("groom reader", "groom_reader") >= 1);
}

static void test_load(void **state)
{
    (void)state;
    assert_int_equal(hg_plugin_load("/nowhere/own.so"), HG_IO);
    assert_non_null(strstr(hg_message(), "/nowhere/own.so: it cannot be loaded as a plug-in"));
    assert_int_equal(hg_plugin_load("own.so"), HG_IO); /* not from the folders of the system */
    assert_null(strstr(hg_message(), "./own.so"));
}

static void test_version(void **state)
{
    (void)state;
    static hg_entry old = { .abi = HG_ABI_VERSION + 7, .kind = "energy", .name = "from_the_future" };
    hg_register(&old);
    assert_null(hg_find("energy", "from_the_future"));
    assert_non_null(strstr(hg_registry_clash(), "ABI version"));
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(test_own_declarations), cmocka_unit_test(test_load),
                                        cmocka_unit_test(test_version) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
