/* base, configs: every kind of mistake has its sentence with the exact line; what is echoed loads to the same. */
#include "tests/test.h"

#include <math.h>

static const hg_config_row rows[] = {
    { "scene.groom", HG_TEXT, NULL, NULL, NULL, 0, 0, "the groom file" },
    { "training.learning_rate", HG_NUMBER, "5e-4", "1", NULL, 0, 1, "rate" },
    { "training.steps", HG_INTEGER, "100", NULL, NULL, 1, INFINITY, "steps" },
    { "training.resume", HG_FLAG, "true", NULL, NULL, 0, 0, "resume" },
    { "losses.stretch", HG_SECTION, "", NULL, NULL, 0, 0, "stretch" },
    { "losses.stretch.stiffness", HG_NUMBER, "2 N/m", "N/m", NULL, 0, INFINITY, "stiffness" },
    { "losses.stretch.strain", HG_CHOICE, "published", NULL, "published|smooth", 0, 0, "strain" },
    { "losses.gravity", HG_SECTION, "", NULL, NULL, 0, 0, "gravity" },
    { "losses.gravity.needed", HG_NUMBER, NULL, "m", NULL, 0, 0, "a length" },
    { "losses.drag", HG_SECTION, "", NULL, NULL, 0, 0, "drag" },
    { "motion.clips", HG_TEXTS, "", NULL, NULL, 0, 0, "clips" },
    { "motion.limits", HG_NUMBERS, "1 mm, 2 mm", "m", NULL, -1, 1, "limits" },
    { "motion.angle", HG_NUMBER, "0 rad", "rad", NULL, -INFINITY, 3, "angle" },
};
enum { row_count = sizeof rows / sizeof *rows };

static hg_config *parsed(const char *text)
{
    hg_config *config;
    if (hg_config_parse(&config, text, "r.yaml", rows, row_count) != HG_OK) fail_msg("%s", hg_message());
    return config;
}

static void test_values(void **state)
{
    (void)state;
    hg_config *config = parsed(
        "# a comment\nscene:\n  groom: 'my groom.h5'\ntraining:\n  learning_rate: 1e-3\n  steps: 2e4\n  resume: Off\n"
        "losses:\n  stretch: {stiffness: 5 mN/mm, strain: smooth}\n  drag:\nmotion:\n  clips:\n    - a\n    - b c\n  "
        "limits: [3 mm, 4e-3]\n");
    assert_string_equal(hg_config_name(config), "r.yaml");
    assert_string_equal(hg_config_text(config, "scene.groom"), "my groom.h5");
    assert_true(hg_config_number(config, "training.learning_rate") == 1e-3);
    assert_int_equal(hg_config_integer(config, "training.steps"), 20000);
    assert_true(hg_config_number(config, "training.steps") == 20000.0);
    assert_false(hg_config_flag(config, "training.resume"));
    assert_true(hg_config_number(config, "losses.stretch.stiffness") == 5.0);
    assert_string_equal(hg_config_text(config, "losses.stretch.strain"), "smooth");
    assert_int_equal(hg_config_count(config, "motion.clips"), 2);
    assert_string_equal(hg_config_text_at(config, "motion.clips", 1), "b c");
    assert_int_equal(hg_config_count(config, "motion.limits"), 2);
    assert_true(hg_config_number_at(config, "motion.limits", 0) == 3e-3);
    assert_true(hg_config_number_at(config, "motion.limits", 1) == 4e-3);
    assert_true(hg_config_given(config, "losses.stretch")), assert_true(hg_config_given(config, "losses.drag"));
    assert_false(hg_config_given(config, "losses.gravity")), assert_false(hg_config_given(config, "motion.angle"));
    assert_int_equal(hg_config_line(config, "training.steps"), 6);
    assert_int_equal(hg_config_line(config, "losses.drag"), 10);
    assert_int_equal(hg_config_line(config, "motion.angle"), 0);
    char *echo = hg_config_echo(config); /* a copy knows where things stood in the original */
    hg_config *copy = parsed(echo);
    assert_true(hg_config_line(copy, "motion.angle") > 0);
    hg_config_lines(copy, config);
    assert_int_equal(hg_config_line(copy, "training.steps"), 6);
    assert_int_equal(hg_config_line(copy, "losses.drag"), 10);
    assert_int_equal(hg_config_line(copy, "motion.angle"), 0);
    hg_config_destroy(copy);
    hg_free(echo);
    /* Asking for what was not declared. */
    assert_true(isnan(hg_config_number(config, "x"))), assert_true(isnan(hg_config_number(config, "scene.groom")));
    assert_null(hg_config_text(config, "x")), assert_int_equal(hg_config_count(config, "x"), 0),
        assert_false(hg_config_flag(config, "x"));
    assert_true(isnan(hg_config_number_at(config, "motion.limits", 2))),
        assert_null(hg_config_text_at(config, "motion.clips", -1));
    hg_config_destroy(config);
    hg_config_destroy(NULL);
}

static void test_defaults(void **state)
{
    (void)state;
    hg_config *config = parsed("scene: {groom: x}");
    assert_true(hg_config_number(config, "training.learning_rate") == 5e-4);
    assert_true(hg_config_flag(config, "training.resume"));
    assert_true(hg_config_number(config, "losses.stretch.stiffness") == 2.0);
    assert_int_equal(hg_config_count(config, "motion.clips"), 0);
    assert_int_equal(hg_config_count(config, "motion.limits"), 2);
    assert_true(hg_config_number_at(config, "motion.limits", 1) == 2e-3);
    hg_config_destroy(config);
}

static void test_mistakes(void **state)
{
    (void)state;
#define S "scene: {groom: x}\n"
    static const char *const cases[][2] = {
        { "", "r.yaml: \"scene.groom\" is missing (the groom file)" },
        { "~", "r.yaml: \"scene.groom\" is missing" },
        { "scene:\n  grom: x\n", "r.yaml:2: unknown key \"scene.grom\"; did you mean \"groom\"?" },
        { S "trainig:\n  steps: 3\n", "r.yaml:2: unknown key \"trainig\"; did you mean \"training\"?" },
        { S "\n\ntraining:\n  learnig_rate: 3\n",
          "r.yaml:5: unknown key \"training.learnig_rate\"; did you mean \"learning_rate\"?" },
        { S "learning_rate: 3\n", "r.yaml:2: unknown key \"learning_rate\"; did you mean \"training.learning_rate\"?" },
        { S "training: {zzz: 3}\n",
          "r.yaml:2: unknown key \"training.zzz\"; known here: learning_rate, steps, resume" },
        { S "training.steps: 3\n", "r.yaml:2: unknown key \"training.steps\"" },
        { S "losses:\n  strech: {}\n", "r.yaml:3: unknown key \"losses.strech\"; did you mean \"stretch\"?" },
        { S "training:\n  steps: 0\n", "r.yaml:3: \"training.steps\": \"0\" is too small, at least 1 is needed" },
        { S "training:\n  steps: 3.5\n", "r.yaml:3: \"training.steps\": \"3.5\" is not an integer" },
        { S "training:\n  steps: many\n", "is not an integer" },
        { S "training:\n  steps: 99999999999999999999\n", "is not an integer" },
        { S "training:\n  steps:\n", "r.yaml:3: \"training.steps\" has no value, an integer is needed" },
        { S "training:\n  steps: [1, 2]\n", "r.yaml:3: \"training.steps\": takes one value, not a list" },
        { S "training:\n  steps: {a: 1}\n", "r.yaml:3: \"training.steps\" takes an integer, not a section" },
        { S "training:\n  steps: 3\n  steps: 4\n", "r.yaml:4: \"training.steps\" was already given in line 3" },
        { S "training: {steps: 3}\ntraining: {resume: no}\n",
          "r.yaml:3: section \"training\" was already given in line 2" },
        { S "training:\n  learning_rate: 2\n",
          "r.yaml:3: \"training.learning_rate\": \"2\" is out of range, between 0 and 1 is needed" },
        { S "training:\n  learning_rate: .nan\n", "is not a number" },
        { S "training:\n  learning_rate: nan\n", "is not a finite number" },
        { S "training:\n  learning_rate: 2 m\n", "a number without unit is needed" },
        { S "training:\n  resume: maybe\n", "r.yaml:3: \"training.resume\": \"maybe\" is not true or false" },
        { S "training: 5\n", "r.yaml:2: \"training\" is a section, its keys stand indented below it" },
        { S "losses:\n  stretch:\n    stiffness: 5 mm\n",
          "r.yaml:4: \"losses.stretch.stiffness\": \"5 mm\" has the unit mm, N/m is needed" },
        { S "losses:\n  stretch:\n    stiffness: -5 N/m\n",
          "r.yaml:4: \"losses.stretch.stiffness\": \"-5 N/m\" is too small, at least 0 N/m is needed" },
        { S "losses: {stretch: {strain: smoth}}\n", "r.yaml:2: \"losses.stretch.strain\": \"smoth\" is not one of "
                                                    "published or smooth; did you mean \"smooth\"?" },
        { S "losses: {gravity: {}}\n", "r.yaml: \"losses.gravity.needed\" is missing (a length)" },
        { S "motion: {angle: 200 deg}\n", "\"200 deg\" is too large, at most 3 rad is possible" },
        { S "motion:\n  limits:\n  - 1 mm\n  - 2 m\n", "r.yaml:3: \"motion.limits\": \"2 m\" is out of range" },
        { S "motion:\n  clips:\n  - a\n  - {b: c}\n", "r.yaml:5: \"motion.clips\": item 2 is no plain value" },
        { "scene: [x", "r.yaml:2: not valid YAML (did not find expected ',' or ']', while parsing a flow sequence that "
                       "begins in line 1)" },
        { S "training:\n\tsteps: 3\n", "r.yaml:3: not valid YAML" },
        { S "? [a, b]\n: 3\n", "r.yaml:2: a key has to be a plain name" },
        { "- a\n", "r.yaml:1: a config is a list of \"key: value\" lines" },
        { S "---\nx: 1\n", "r.yaml:3: a second document begins here" },
        { S "training: {steps: \"1\\0\"}\n", "r.yaml:2: \"training.steps\" holds a zero byte" },
        { S "x: \xff\xfe\n", "is not valid text" },
        { S "a: *unknown\n", "r.yaml:2: not valid YAML (found undefined alias)" },
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        hg_config *config;
        hg_status status = hg_config_parse(&config, cases[i][0], "r.yaml", rows, row_count);
        if (status == HG_OK || config != NULL || strstr(hg_message(), cases[i][1]) == NULL)
            fail_msg("%s\n gives: %s\n wanted: %s", cases[i][0], hg_message(), cases[i][1]);
    }
}

static void test_bombs(void **state)
{
    (void)state;
    /* Aliases that would be a billion items if they were written out; one that holds itself. */
    hg_text text = { 0 };
    hg_text_add(&text, "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n");
    for (int i = 1; i < 12; i++) {
        hg_text_add(&text, "a%d: &a%d [", i, i);
        for (int j = 0; j < 10; j++) hg_text_add(&text, "%s*a%d", j > 0 ? ", " : "", i - 1);
        hg_text_add(&text, "]\n");
    }
    hg_config *config;
    assert_int_equal(hg_config_parse(&config, text.data, "r.yaml", rows, row_count), HG_INVALID);
    assert_non_null(strstr(hg_message(), "r.yaml:1: unknown key \"a0\""));
    hg_text_free(&text);
    assert_int_equal(hg_config_parse(&config, "scene: &s\n  groom: *s\n", "r.yaml", rows, row_count), HG_INVALID);
    assert_int_equal(hg_config_parse(&config, "motion: {clips: &c [*c]}\n", "r.yaml", rows, row_count), HG_INVALID);
    /* Deep nesting. */
    for (int kind = 0; kind < 2; kind++) {
        for (int i = 0; i < 20000; i++) hg_text_add(&text, "%s", kind == 0 ? "[" : "{a: ");
        assert_int_not_equal(hg_config_parse(&config, text.data, "r.yaml", rows, row_count), HG_OK);
        hg_text_free(&text);
    }
}

static void test_echo_round_trip(void **state)
{
    (void)state;
    static const char *const texts[] = {
        "scene: {groom: x}\n",
        "scene: {groom: \"a \\\"b\\\" \\n: # \\\\ \xc3\xbc\"}\ntraining: {learning_rate: 0.12345678901234567}\nlosses: "
        "{drag: , stretch: {stiffness: 0.1 N/mm}}\n",
        "scene: {groom: 'null'}\nmotion: {clips: ['', 'a, b', '[', '- x', '*a', '&b', '!c'], limits: 7 um, angle: 33.3 "
        "deg}\n",
        "scene: {groom: ''}\nlosses: {gravity: {needed: 1e-300}}\n",
    };
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++) {
        hg_config *config = parsed(texts[i]), *again;
        char *echo = hg_config_echo(config);
        assert_non_null(echo);
        if (hg_config_parse(&again, echo, "echo.yaml", rows, row_count) != HG_OK)
            fail_msg("%s\n%s", hg_message(), echo);
        for (int j = 0; j < row_count; j++) {
            const char *key = rows[j].key;
            assert_true(hg_config_number(config, key) == hg_config_number(again, key) ||
                        isnan(hg_config_number(config, key)));
            assert_int_equal(hg_config_integer(config, key), hg_config_integer(again, key));
            assert_int_equal(hg_config_count(config, key), hg_config_count(again, key));
            for (int k = 0; k < hg_config_count(config, key); k++) {
                if (rows[j].type == HG_TEXTS)
                    assert_string_equal(hg_config_text_at(config, key, k), hg_config_text_at(again, key, k));
                else
                    assert_true(hg_config_number_at(config, key, k) == hg_config_number_at(again, key, k));
            }
            if (rows[j].type == HG_TEXT || rows[j].type == HG_CHOICE)
                assert_string_equal(hg_config_text(config, key), hg_config_text(again, key));
            if (rows[j].type == HG_SECTION) assert_int_equal(hg_config_given(config, key), hg_config_given(again, key));
        }
        char *second = hg_config_echo(again);
        assert_string_equal(echo, second);
        hg_free(second), hg_free(echo);
        hg_config_destroy(again), hg_config_destroy(config);
    }
    hg_config *config = parsed("scene: {groom: x}\nlosses: {drag: }\n");
    char *echo = hg_config_echo(config);
    assert_string_equal(
        echo,
        "scene:\n  groom: x\ntraining:\n  learning_rate: 0.0005\n  steps: 100\n  resume: true\nlosses:\n  drag: {}\n"
        "motion:\n  clips: []\n  limits: [0.001 m, 0.002 m]\n  angle: 0 rad\n");
    hg_free(echo);
    hg_config_destroy(config);
}

static void test_overrides(void **state)
{
    (void)state;
    hg_config *config = parsed("scene: {groom: x}");
    assert_int_equal(hg_config_set(config, "training.steps", "7"), HG_OK);
    assert_int_equal(hg_config_integer(config, "training.steps"), 7);
    assert_true(hg_config_given(config, "training.steps"));
    assert_int_equal(hg_config_set(config, "training.steps", "x"), HG_INVALID);
    assert_string_equal(hg_message(), "override training.steps=x: \"x\" is not an integer");
    assert_int_equal(hg_config_integer(config, "training.steps"), 7); /* as it was */
    assert_int_equal(hg_config_set(config, "training.stepps", "7"), HG_INVALID);
    assert_non_null(strstr(hg_message(), "unknown key \"training.stepps\"; did you mean \"steps\"?"));
    assert_int_equal(hg_config_set(config, "training", "7"), HG_INVALID);
    assert_non_null(strstr(hg_message(), "\"training\" is a section"));
    assert_int_equal(hg_config_set(config, "motion.clips", "[a, \"b c\"]"), HG_OK);
    assert_int_equal(hg_config_count(config, "motion.clips"), 2);
    assert_string_equal(hg_config_text_at(config, "motion.clips", 1), "b c");
    assert_int_equal(hg_config_set(config, "motion.limits", "5 mm"), HG_OK);
    assert_true(hg_config_number_at(config, "motion.limits", 0) == 5e-3);
    assert_int_equal(hg_config_set(config, "losses.stretch.stiffness", "3"), HG_OK);
    assert_true(hg_config_given(config, "losses.stretch"));
    assert_int_equal(hg_config_set(config, "losses.gravity", ""), HG_OK);
    assert_int_equal(hg_config_check(config), HG_INVALID);
    assert_non_null(strstr(hg_message(), "losses.gravity.needed"));
    assert_int_equal(hg_config_set(config, "losses.gravity.needed", "1 mm"), HG_OK);
    assert_int_equal(hg_config_check(config), HG_OK);
    hg_config_destroy(config);
}

static void test_files(void **state)
{
    (void)state;
    char *path = test_path("recipe.yaml");
    hg_config *config;
    assert_int_equal(hg_config_load(&config, path, rows, row_count), HG_IO);
    assert_non_null(strstr(hg_message(), "recipe.yaml: cannot be opened (No such file or directory)"));
    assert_int_equal(hg_file_write(path, "training: {steps: 3}\n", 21), HG_OK);
    assert_int_equal(hg_config_load(&config, path, rows, row_count), HG_INVALID);
    assert_non_null(strstr(hg_message(), "\"scene.groom\" is missing"));
    const char *overrides[] = { "scene.groom=a=b.h5", "training.steps=4" }; /* what is required may come from outside */
    assert_int_equal(hg_config_load_with(&config, path, rows, row_count, overrides, 2), HG_OK);
    assert_string_equal(hg_config_text(config, "scene.groom"), "a=b.h5");
    assert_int_equal(hg_config_integer(config, "training.steps"), 4);
    hg_config_destroy(config);
    overrides[0] = "scene.groom";
    assert_int_equal(hg_config_load_with(&config, path, rows, row_count, overrides, 1), HG_INVALID);
    assert_non_null(strstr(hg_message(), "KEY=VALUE is needed"));
    assert_int_equal(hg_file_write(path, "a\0b", 3), HG_OK);
    assert_int_equal(hg_config_load(&config, path, rows, row_count), HG_FORMAT);
    assert_non_null(strstr(hg_message(), "is a binary file"));
    char *large = hg_alloc(2 << 20, 1);
    memset(large, '\n', 2 << 20);
    assert_int_equal(hg_file_write(path, large, 2 << 20), HG_OK);
    assert_int_equal(hg_config_load(&config, path, rows, row_count), HG_FORMAT);
    assert_non_null(strstr(hg_message(), "too many for a config"));
    hg_free(large), hg_free(path);
}

static void test_schema_mistakes(void **state)
{
    (void)state;
    hg_config *config;
    const hg_config_row twice[] = { { "a", HG_TEXT, "", NULL, NULL, 0, 0, "" },
                                    { "a", HG_TEXT, "", NULL, NULL, 0, 0, "" } };
    assert_int_equal(hg_config_parse(&config, "", "r.yaml", twice, 2), HG_INVALID);
    assert_string_equal(hg_message(), "config key \"a\" is declared twice");
    const hg_config_row wrong = { "a", HG_INTEGER, "x", NULL, NULL, 0, 0, "" };
    assert_int_equal(hg_config_parse(&config, "", "r.yaml", &wrong, 1), HG_INVALID);
    assert_non_null(strstr(hg_message(), "has a default that it refuses"));
    assert_int_equal(hg_config_parse(&config, "", "r.yaml", NULL, 0), HG_OK); /* nothing declared, nothing written */
    char *echo = hg_config_echo(config);
    assert_string_equal(echo, "");
    hg_free(echo);
    hg_config_destroy(config);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_values), cmocka_unit_test(test_defaults),        cmocka_unit_test(test_mistakes),
        cmocka_unit_test(test_bombs),  cmocka_unit_test(test_echo_round_trip), cmocka_unit_test(test_overrides),
        cmocka_unit_test(test_files),  cmocka_unit_test(test_schema_mistakes),
    };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
