/* hairgrad gradcheck: the gradients of ops and energies, built-in or of a plug-in, against finite differences in f64. An
 * energy is checked with every choice of its options, in every input and parameter that its formula asks for. */
#include "cli/cli.h"

#include <string.h>

enum { most = 512, most_words = 16 };

typedef struct {
    hg_ctx *ctx;
    double tolerance;
    bool verbose;
    const char *wrt[most_words], *set[most_words];     /* "posed"; "strain=smooth" */
    bool wrt_known[most_words], set_known[most_words]; /* some energy has it */
    int n_wrt, n_set;
    int passed, failed;
    int64_t kinks;
} tally;

static void print_sweep(const hg_gradcheck_result *result)
{
    for (int k = 0; k < result->steps; k++)
        printf("            step %.0e   numeric % .12e   error %.1e%s\n", result->sweep[k].step,
               result->sweep[k].numeric, result->sweep[k].error,
               result->sweep[k].step == result->step ? "   best" : "");
}

/* One line: verdict, what was checked, the worst element, the best step of its sweep, kinks. */
static void print_result(tally *count, const char *what, hg_status status, const hg_gradcheck_result *result,
                         bool no_effect)
{
    const bool good = status == HG_OK;
    *(good ? &count->passed : &count->failed) += 1;
    count->kinks += result->kinks;
    printf("  %-5s %-24s", good ? "ok" : "WRONG", what);
    if (!good)
        printf(" %s\n", result->text[0] != '\0' ? result->text : hg_message());
    else if (result->steps == 0)
        printf(" nothing to check\n");
    else if (no_effect)
        printf(" no effect here: the gradient is zero, and so are the differences");
    else
        printf(
            " %.1e   step %.0e   worst at %.*s", result->worst, result->step,
            (int)(strstr(result->text, ": analytic") != NULL ? strstr(result->text, ": analytic") - result->text : 0),
            result->text);
    if (good && result->kinks > 0) printf("   %lld kinks left out", (long long)result->kinks);
    if (good && result->steps > 0) putchar('\n');
    if (count->verbose || (!good && result->steps > 0)) {
        if (result->steps > 0) printf("            analytic                % .12e\n", result->analytic);
        print_sweep(result);
    }
}

static void check_op(const hg_op *op, tally *count)
{
    if (op->not_differentiable) {
        printf("op %s has no gradient\n", op->name);
        return;
    }
    printf("op %s: %s\n", op->name, op->formula != NULL ? op->formula : "");
    for (int i = 0; i < op->n_samples; i++) {
        hg_gradcheck_result result = { 0 };
        const hg_gradcheck_options options = { .tolerance = count->tolerance };
        hg_status status = hg_gradcheck_op(count->ctx, op, &op->samples[i], &options, &result);
        print_result(count, op->samples[i].label != NULL ? op->samples[i].label : "", status, &result, false);
        hg_step_reset(count->ctx);
        hg_ctx_clear(count->ctx);
    }
}

/* ---- energies -------------------------------------------------------------------------------------------------- */

/* Does --set leave this choice? */
static bool is_left(tally *count, const char *option, const char *choice)
{
    bool asked = false, left = false;
    for (int i = 0; i < count->n_set; i++) {
        const size_t length = strlen(option);
        if (strncmp(count->set[i], option, length) != 0 || count->set[i][length] != '=') continue;
        asked = true;
        if (strcmp(count->set[i] + length + 1, choice) != 0) continue;
        left = count->set_known[i] = true;
    }
    return left || !asked;
}

static void check_choice(const hg_energy *energy, const char *const *chosen, tally *count)
{
    const hg_gradcheck_options options = { .tolerance = count->tolerance };
    static hg_energy_check checks[HG_ENERGY_CHECKS]; /* large */
    bool titled = false;
    for (int w = 0; w < (count->n_wrt > 0 ? count->n_wrt : 1); w++) {
        int n;
        const hg_status status = hg_energy_gradcheck(count->ctx, energy, chosen,
                                                     count->n_wrt > 0 ? count->wrt[w] : NULL, &options, checks, &n);
        hg_ctx_clear(count->ctx);
        if (n == 0 && status == HG_INVALID && count->n_wrt > 0) continue; /* it does not ask for that */
        if (!titled) {
            printf("energy %s", energy->name);
            for (int i = 0; i < HG_ENERGY_OPTIONS && energy->options[i].name != NULL; i++)
                printf(" %s=%s", energy->options[i].name, chosen[i]);
            putchar('\n');
            titled = true;
        }
        if (count->n_wrt > 0) count->wrt_known[w] = true;
        for (int i = 0; i < n; i++)
            print_result(count, checks[i].name, checks[i].status, &checks[i].result, checks[i].no_effect);
        if (n == 0 && status != HG_OK)
            print_result(count, "everything", status, &(hg_gradcheck_result){ .text = "" }, false);
    }
}

/* Every combination of an energy's options that --set leaves. */
static void check_energy(const hg_energy *energy, tally *count)
{
    hg_energy_choice choice;
    for (int number = 0; hg_energy_choose(energy, number, &choice); number++) {
        bool left = true;
        for (int i = 0; i < HG_ENERGY_OPTIONS && energy->options[i].name != NULL; i++)
            left &= is_left(count, energy->options[i].name, choice.options[i]);
        if (left) check_choice(energy, choice.options, count);
    }
}

/* ---- the command ------------------------------------------------------------------------------------------------ */

/* What --wrt and --set say; "a,b" is cut in place. */
static bool read_words(const hg_arguments *arguments, tally *count, char *room, size_t size)
{
    for (int i = 0; i < arguments->n_given; i++) {
        const char *name = arguments->given[i].name, *value = arguments->given[i].value;
        const bool wrt = strcmp(name, "wrt") == 0;
        if (!wrt && strcmp(name, "set") != 0) continue;
        if (!wrt && strchr(value, '=') == NULL) {
            hg_fail(HG_INVALID, "--set %s: expected option=choice, such as strain=smooth", value);
            return false;
        }
        const size_t length = strlen(value) + 1;
        if (length > size) {
            hg_fail(HG_INVALID, "--%s: too long", name);
            return false;
        }
        memcpy(room, value, length);
        char *next = NULL;
        for (char *word = wrt ? strtok_r(room, ",", &next) : room; word != NULL;
             word = wrt ? strtok_r(NULL, ",", &next) : NULL) {
            int *n = wrt ? &count->n_wrt : &count->n_set;
            if (*n == most_words) {
                hg_fail(HG_INVALID, "--%s: more than %d", name, most_words);
                return false;
            }
            (wrt ? count->wrt : count->set)[(*n)++] = word;
        }
        room += length;
        size -= length;
    }
    return true;
}

static bool all_known(const tally *count)
{
    for (int i = 0; i < count->n_wrt; i++)
        if (!count->wrt_known[i]) {
            hg_fail(HG_INVALID, "--wrt %s: none of these energies asks for that", count->wrt[i]);
            return false;
        }
    for (int i = 0; i < count->n_set; i++)
        if (!count->set_known[i]) {
            hg_fail(HG_INVALID, "--set %s: none of these energies has that option with that choice", count->set[i]);
            return false;
        }
    return true;
}

static int gradcheck(const hg_arguments *arguments)
{
    const char *names[most];
    char room[1024];
    int ops = hg_list("op", names, most / 2), all;
    if (ops > most / 2) ops = most / 2;
    all = ops + hg_list("energy", names + ops, most - ops);
    if (all > most) all = most;
    tally count = { .tolerance = 1e-6, .verbose = cli_flag(arguments, "verbose") };
    if (!cli_number(arguments, "tolerance", &count.tolerance) || !read_words(arguments, &count, room, sizeof room))
        return cli_fail();
    const bool energies_only = count.n_wrt > 0 || count.n_set > 0;
    for (int i = 0; i < arguments->n_free; i++) {
        const char *name = arguments->free[i];
        if (hg_find("energy", name) != NULL || (hg_find("op", name) != NULL && !energies_only)) continue;
        const char *nearest = hg_nearest_of(name, names, all);
        if (hg_find("op", name) != NULL)
            hg_fail(HG_INVALID, "%s is an op: --wrt and --set choose among the inputs and options of energies", name);
        else
            hg_fail(HG_INVALID, "unknown op or energy \"%s\"%s%s%s", name,
                    nearest != NULL ? "; did you mean \"" : "; without a name all are checked",
                    nearest != NULL ? nearest : "", nearest != NULL ? "\"?" : "");
        return cli_fail();
    }
    if (!cli_context(&count.ctx, arguments)) return cli_fail();
    for (int i = energies_only ? ops : 0; i < all; i++) {
        bool wanted = arguments->n_free == 0;
        for (int j = 0; j < arguments->n_free; j++) wanted |= strcmp(arguments->free[j], names[i]) == 0;
        if (wanted && i < ops)
            check_op(hg_find("op", names[i]), &count);
        else if (wanted)
            check_energy(hg_find("energy", names[i]), &count);
        fflush(stdout);
    }
    hg_ctx_destroy(count.ctx);
    printf("%d right, %d wrong", count.passed, count.failed);
    if (count.kinks > 0) printf(", %lld derivatives at kinks left out", (long long)count.kinks);
    putchar('\n');
    if (!all_known(&count)) return cli_fail();
    return count.failed > 0;
}

static const hg_argument gradcheck_options[] = {
    { "wrt", "NAME[,NAME]", "only these inputs and parameters of energies, like x,stiffness,rest", true },
    { "set", "OPTION=CHOICE", "only this choice of an option of energies, like strain=smooth (default: every choice)",
      true },
    { "verbose", NULL, "every step of the sweep of the worst element", false },
    { "tolerance", "X", "relative error that is still right (default 1e-6)", false },
    CLI_DEVICE_OPTION,
    CLI_CONTEXT_OPTIONS,
};
HG_COMMAND(
    gradcheck, .what = "check the gradients of ops and energies by finite differences", .usage = "[NAME...]",
    .options = gradcheck_options, .n_options = sizeof gradcheck_options / sizeof *gradcheck_options, .max_free = most,
    .run = gradcheck,
    .more =
        "examples:\n  hairgrad gradcheck                        everything that is known\n  hairgrad "
        "gradcheck stretch matmul\n  hairgrad gradcheck bend_twist --set strain=smooth --wrt x,stiffness --verbose\n"
        "  hairgrad --plugin ./mine.so gradcheck my_energy\n");
