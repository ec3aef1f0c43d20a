/* hairgrad evaluate: a trained network on motions and body shapes that it was not trained on. */
#include "cli/against.h"
#include "cli/shape.h"

#include <math.h>
#include <string.h>

enum { CLIPS = 64 };

static void table_head(void)
{
    printf("%-20s %6s %8s %8s %8s %8s %9s %9s %9s %9s %8s %7s\n", "clip", "frames", "length", "orient", "inside",
           "posed", "energy", "posed", "grav+body", "posed", "tip", "lag");
    printf("%-20s %6s %8s %8s %8s %8s %9s %9s %9s %9s %8s %7s\n", "", "", "%", "degrees", "%", "%", "nJ", "nJ", "nJ",
           "nJ", "m/s", "ms");
}

static void table_row(const char *name, const hg_hair_metrics *m)
{
    printf("%-20.20s %6lld %8.3f %8.2f %8.3f %8.3f %9.2f %9.2f %9.2f %9.2f %8.3f ", name, (long long)m->frames,
           m->length_error, m->orientation, m->inside, m->inside_posed, 1e9 * m->energy, 1e9 * m->energy_posed,
           1e9 * m->gravity_body, 1e9 * m->gravity_body_posed, m->tip_amplitude);
    if (isfinite(m->tip_lag))
        printf("%7.1f\n", 1e3 * m->tip_lag);
    else
        printf("%7s\n", "-");
}

static void table_terms(const hg_hair_metrics *mean)
{
    printf("\n%-20s %12s %12s   (nJ per strand, weighted; gravity counted from the posed groom)\n", "energy", "network",
           "posed groom");
    for (int i = 0; i < mean->n_terms; i++)
        printf("%-20s %12.3f %12.3f\n", mean->term[i], 1e9 * mean->term_energy[i], 1e9 * mean->term_posed[i]);
}

typedef struct {
    int n;
    const hg_motion *clip[CLIPS];
    const char *name[CLIPS];
    hg_hair_metrics metrics[CLIPS];
    cli_against asked;
    hg_against against[CLIPS]; /* with --against, instead of the metrics */
} evaluations;

static hg_status choose_clips(evaluations *all, const hg_hair_task *task, const hg_arguments *arguments)
{
    for (int i = 0; i < arguments->n_given; i++) {
        if (strcmp(arguments->given[i].name, "clip") || all->n == CLIPS) continue;
        all->clip[all->n] = cli_clip(task, arguments->given[i].value);
        if (!all->clip[all->n++]) return HG_INVALID;
    }
    const bool held_out = hg_hair_clips(task, true) > 0;
    for (int i = 0; all->n < CLIPS && !cli_value(arguments, "clip", NULL) && i < hg_hair_clips(task, held_out); i++)
        all->clip[all->n++] = hg_hair_clip(task, held_out, i);
    for (int i = 0; i < all->n; i++) {
        const char *name = all->clip[i]->name ? all->clip[i]->name : "clip", *slash = strrchr(name, '/');
        all->name[i] = slash ? slash + 1 : name;
    }
    return HG_OK;
}

static hg_status judge(evaluations *all, hg_hair_task *task, hg_ctx *ctx, const double *given, int64_t frames)
{
    hg_progress progress = cli_progress();
    hg_status status = HG_OK;
    for (int i = 0; status == HG_OK && i < all->n; i++) {
        double shape[HG_SHAPES];
        hg_hair_held_out_shape(task, i, shape);
        const double *of = given ? given : shape;
        status = all->asked.options.n_solvers
                     ? hg_hair_against(task, ctx, all->clip[i], of, &all->asked.options, &all->against[i], &progress)
                     : hg_hair_evaluate(task, ctx, all->clip[i], of, frames, &all->metrics[i], &progress);
    }
    cli_progress_end();
    return status;
}

static hg_status show(const evaluations *all, const hg_arguments *arguments)
{
    if (all->asked.options.n_solvers) return cli_against_show(arguments, all->n, all->name, all->against);
    const char *json = cli_value(arguments, "json", NULL);
    if (json) HG_TRY(hg_hair_metrics_write(json, all->n, all->name, all->metrics));
    hg_hair_metrics mean;
    hg_hair_metrics_mean(all->metrics, all->n, &mean);
    table_head();
    for (int i = 0; i < all->n; i++) table_row(all->name[i], &all->metrics[i]);
    if (all->n > 1) table_row("mean", &mean);
    table_terms(&mean);
    return HG_OK;
}

static hg_status evaluate_run(hg_ctx *ctx, const hg_arguments *arguments, evaluations *all)
{
    hg_hair_task *task = NULL;
    hg_progress progress = cli_progress();
    double shape[HG_SHAPES];
    bool given;
    int64_t frames = 0;
    HG_TRY(cli_shape(arguments, shape, &given));
    HG_TRY(cli_against_options(arguments, &all->asked));
    if (cli_value(arguments, "frames", NULL) && !cli_integer(arguments, "frames", &frames))
        return hg_fail(HG_INVALID, "--frames %s: expected a whole number", cli_value(arguments, "frames", ""));
    if (all->asked.options.n_solvers) cli_catch_signals();
    const char *set[64];
    int n_set = 0;
    for (int i = 0; i < arguments->n_given; i++)
        if (!strcmp(arguments->given[i].name, "set")) set[n_set++] = arguments->given[i].value;
    hg_status status = hg_hair_task_open_with(&task, ctx, arguments->free[0], n_set, set, &progress);
    const char *groom = cli_value(arguments, "groom", NULL);
    if (status == HG_OK && groom) status = hg_hair_choose_groom(task, groom);
    if (status == HG_OK) status = cli_materials(arguments, task);
    if (status == HG_OK) status = choose_clips(all, task, arguments);
    if (status == HG_OK) status = judge(all, task, ctx, given ? shape : NULL, frames);
    if (status == HG_OK) status = show(all, arguments);
    hg_hair_task_destroy(task);
    return status;
}

static int evaluate(const hg_arguments *arguments)
{
    hg_ctx *ctx = NULL;
    if (!cli_context(&ctx, arguments)) return cli_fail();
    char *trap = NULL;
    hg_status status = cli_trap(ctx, arguments, arguments->free[0], &trap);
    evaluations *all = hg_alloc(1, sizeof *all);
    if (!all) status = HG_MEMORY;
    if (status == HG_OK) status = evaluate_run(ctx, arguments, all);
    for (int i = 0; all && i < all->n; i++) hg_hair_against_free(&all->against[i]);
    hg_free(all);
    hg_ctx_destroy(ctx);
    hg_free(trap);
    return status == HG_OK ? 0 : cli_fail();
}

static const hg_argument evaluate_options[] = {
    { "clip", "NAME", "a clip of the run (repeat for more; default: all that are held out)", true },
    { "frames", "N", "of each clip (default: all)", false },
    { "groom", "NAME", "a groom of the run, another file (.h5) or a style (default: the run's first)", false },
    { "material", "NAME=VALUE", "of a network that was trained over a range, like \"bend_twist.stiffness=2e-9 N*m^2\"",
      true },
    { "shape", "NUMBERS", "body shape, like 0.5,0,-1 (default: shapes that training does not draw)", false },
    { "set", "KEY=VALUE", "judge by other energies: override a value of the run's config, like losses.drag.weight=0",
      true },
    { "json", "FILE", "write the metrics there too", false },
    CLI_AGAINST_OPTIONS,
    CLI_TRAP_OPTION,
    CLI_DEVICE_OPTION,
    CLI_CONTEXT_OPTIONS,
};
HG_COMMAND(
    evaluate, .what = "judge a trained network on held-out motions and body shapes", .usage = "RUN",
    .options = evaluate_options, .n_options = sizeof evaluate_options / sizeof *evaluate_options, .min_free = 1,
    .max_free = 1, .run = evaluate,
    .more = "  hairgrad evaluate out/demo/run --json out/demo/metrics.json\n"
            "  hairgrad evaluate out/demo/run --against lbfgs --plot out/demo/against.png\n"
            "`posed` columns are the rigidly posed groom; `tip` is the rms speed of the tips in the head's frame.\n");
