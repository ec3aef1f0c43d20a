/* YAML configs against a schema with every type. */
#include "tests/fuzz/fuzz.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const hg_config_row rows[] = {
    { "scene.groom", HG_TEXT, "", NULL, NULL, 0, 0, "groom" },
    { "training.learning_rate", HG_NUMBER, "5e-4", "1", NULL, 0, 1, "rate" },
    { "training.steps", HG_INTEGER, "100", NULL, NULL, 1, INFINITY, "steps" },
    { "training.resume", HG_FLAG, "no", NULL, NULL, 0, 0, "resume" },
    { "losses.stretch", HG_SECTION, "", NULL, NULL, 0, 0, "stretch" },
    { "losses.stretch.stiffness", HG_NUMBER, "2 N/m", "N/m", NULL, 0, INFINITY, "k" },
    { "losses.stretch.strain", HG_CHOICE, "published", NULL, "published|smooth", 0, 0, "strain" },
    { "motion.clips", HG_TEXTS, "", NULL, NULL, 0, 0, "clips" },
    { "motion.limits", HG_NUMBERS, "1 mm, 2 mm", "m", NULL, 0, 0, "limits" },
};
enum { row_count = sizeof rows / sizeof *rows };

/* What is accepted must echo, and the echo must load to the same. */
int fuzz_one(const uint8_t *data, size_t size)
{
    char *text = hg_alloc(size + 1, 1);
    if (text == NULL) return 0;
    memcpy(text, data, size);
    hg_config *config, *again;
    if (hg_config_parse(&config, text, "fuzz.yaml", rows, row_count) == HG_OK) {
        char *echo = hg_config_echo(config), *second = NULL;
        if (echo == NULL || hg_config_parse(&again, echo, "echo.yaml", rows, row_count) != HG_OK) abort();
        second = hg_config_echo(again);
        if (second == NULL || strcmp(echo, second) != 0) abort();
        hg_free(second);
        hg_free(echo);
        hg_config_destroy(again);
        hg_config_destroy(config);
    }
    hg_free(text);
    return 0;
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    static const char *const texts[] = {
        "scene:\n  groom: a.h5\ntraining:\n  learning_rate: 1e-3\n  steps: 20\n  resume: true\nlosses:\n  stretch:\n   "
        " stiffness: 5 mN/mm\n"
        "    strain: smooth\nmotion:\n  clips: [a, \"b c\"]\n  limits: [1 mm, 2.5e-3 m]\n",
        "scene: &a {groom: *a}\n",
        "losses: {stretch: }\n---\n",
    };
    if (number >= (int)(sizeof texts / sizeof *texts) || strlen(texts[number]) > room) return 0;
    memcpy(to, texts[number], strlen(texts[number]));
    return strlen(texts[number]);
}
