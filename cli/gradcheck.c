/* hairgrad gradcheck: the gradients of ops and energies, built-in or of a plug-in, against finite differences in f64. */
#include "cli/cli.h"

#include <string.h>

enum { most = 512 };

typedef struct {
    double tolerance;
    int passed, failed;
} tally;

static void print_result(tally *count, const char *kind, const char *name, const char *variant, hg_status status,
                         const hg_gradcheck_result *result)
{
    bool good = status == HG_OK;
    *(good ? &count->passed : &count->failed) += 1;
    printf("%-5s %-6s %s%s%s", good ? "ok" : "WRONG", kind, name, variant[0] != '\0' ? " " : "", variant);
    if (good)
        printf("   %.1e\n", result->worst);
    else
        printf("\n      %s\n", hg_message());
}

static void check_op(hg_ctx *ctx, const hg_op *op, tally *count)
{
    if (op->not_differentiable) {
        printf("      op     %s   has no gradient\n", op->name);
        return;
    }
    for (int i = 0; i < op->n_samples; i++) {
        hg_gradcheck_result result = { 0 };
        hg_gradcheck_options options = { .tolerance = count->tolerance };
        hg_status status = hg_gradcheck_op(ctx, op, &op->samples[i], &options, &result);
        print_result(count, "op", op->name, op->samples[i].label != NULL ? op->samples[i].label : "", status, &result);
        hg_step_reset(ctx);
        hg_ctx_clear(ctx);
    }
}

/* Cuts choice number `which` out of "published|smooth". */
static bool cut_choice(const char *choices, int which, char *out, size_t room)
{
    for (; which > 0 && choices != NULL; which--) {
        choices = strchr(choices, '|');
        if (choices != NULL) choices++;
    }
    if (choices == NULL) return false;
    snprintf(out, room, "%.*s", (int)strcspn(choices, "|"), choices);
    return true;
}

/* Every combination of an energy's options. */
static void check_energy(hg_ctx *ctx, const hg_energy *energy, int option, const char **chosen, tally *count)
{
    if (option < HG_ENERGY_OPTIONS && energy->options[option].name != NULL) {
        char choice[64];
        for (int i = 0; cut_choice(energy->options[option].choices, i, choice, sizeof choice); i++) {
            chosen[option] = choice;
            check_energy(ctx, energy, option + 1, chosen, count);
        }
        return;
    }
    char variant[512] = "";
    for (int i = 0; i < option; i++) {
        size_t used = strlen(variant);
        snprintf(variant + used, sizeof variant - used, "%s%s=%s", i > 0 ? " " : "", energy->options[i].name,
                 chosen[i]);
    }
    hg_gradcheck_result result = { 0 };
    hg_gradcheck_options options = { .tolerance = count->tolerance };
    hg_status status = hg_energy_gradcheck(ctx, energy, chosen, &options, &result);
    print_result(count, "energy", energy->name, variant, status, &result);
    hg_ctx_clear(ctx);
}

static int gradcheck(const hg_arguments *arguments)
{
    const char *names[most];
    int ops = hg_list("op", names, most / 2), all;
    if (ops > most / 2) ops = most / 2;
    all = ops + hg_list("energy", names + ops, most - ops);
    if (all > most) all = most;
    for (int i = 0; i < arguments->n_free; i++) {
        if (hg_find("op", arguments->free[i]) != NULL || hg_find("energy", arguments->free[i]) != NULL) continue;
        const char *nearest = hg_nearest_of(arguments->free[i], names, all);
        hg_fail(HG_INVALID, "unknown op or energy \"%s\"%s%s%s", arguments->free[i],
                nearest != NULL ? "; did you mean \"" : "; without a name all are checked",
                nearest != NULL ? nearest : "", nearest != NULL ? "\"?" : "");
        return cli_fail();
    }
    tally count = { .tolerance = 1e-6 };
    hg_ctx *ctx;
    if (!cli_number(arguments, "tolerance", &count.tolerance) || !cli_context(&ctx, arguments)) return cli_fail();
    for (int i = 0; i < all; i++) {
        bool wanted = arguments->n_free == 0;
        for (int j = 0; j < arguments->n_free; j++) wanted |= strcmp(arguments->free[j], names[i]) == 0;
        const char *chosen[HG_ENERGY_OPTIONS + 1] = { NULL };
        if (wanted && i < ops)
            check_op(ctx, hg_find("op", names[i]), &count);
        else if (wanted)
            check_energy(ctx, hg_find("energy", names[i]), 0, chosen, &count);
    }
    hg_ctx_destroy(ctx);
    printf("%d right, %d wrong\n", count.passed, count.failed);
    return count.failed > 0;
}

static const hg_argument gradcheck_options[] = {
    { "tolerance", "X", "relative error that is still right (default 1e-6)", false },
    CLI_CONTEXT_OPTIONS,
};
HG_COMMAND(gradcheck, .what = "check the gradients of ops and energies by finite differences", .usage = "[NAME...]",
           .options = gradcheck_options, .n_options = sizeof gradcheck_options / sizeof *gradcheck_options,
           .max_free = most, .run = gradcheck,
           .more = "examples:\n  hairgrad gradcheck                        everything that is known\n  hairgrad "
                   "gradcheck stretch matmul\n"
                   "  hairgrad --plugin ./mine.so gradcheck my_energy\n");
