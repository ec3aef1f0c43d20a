/* hairgrad fit material: what the hair of an observed drape is made of. */
#include "cli/cli.h"

#include <math.h>
#include <string.h>

static hg_status take_recipe(const hg_arguments *arguments, const char *path, hg_config **config)
{
    HG_TRY(hg_hair_config_load(config, path));
    hg_status status = hg_config_set(*config, "features.encoder_steps", "1"); /* no network is needed */
    for (int i = 0; status == HG_OK && i < arguments->n_given; i++) {
        if (strcmp(arguments->given[i].name, "set")) continue;
        char *key = hg_strdup(arguments->given[i].value), *value = key ? strchr(key, '=') : NULL;
        if (value) *value++ = '\0';
        status = !key    ? HG_MEMORY
                 : value ? hg_config_set(*config, key, value)
                         : hg_fail(HG_INVALID, "--set %s: expected key=value, like losses.stretch.stiffness=5", key);
        hg_free(key);
    }
    return status;
}

static hg_status write_strands(const hg_material_fit *fit, int64_t strands, const char *path)
{
    hg_h5 *file;
    HG_TRY(hg_h5_create(&file, path));
    hg_status status = HG_OK;
    for (int k = 0; status == HG_OK && k < fit->n; k++)
        status = hg_h5_write(file, fit->param[k].name, HG_F64, 1, &strands, fit->strands + k * strands);
    if (status == HG_OK) return hg_h5_commit(file);
    hg_h5_close(file);
    return status;
}

static void print_fit(const hg_material_fit *fit)
{
    for (int k = 0; k < fit->n; k++)
        printf("%-28s %.6g +- %.2g %s\n", fit->param[k].name, fit->param[k].value, fit->param[k].error,
               fit->param[k].unit ? fit->param[k].unit : "");
    printf("%lld free vertices looked at, %lld left out because they touch the body; %.2g %% of the known forces are "
           "left\n",
           (long long)fit->vertices, (long long)fit->left_out, 100 * fit->unbalanced);
}

static hg_status fit_run(hg_ctx *ctx, const hg_arguments *arguments, hg_drape_fit_options *options)
{
    const char *strands = cli_value(arguments, "per-strand", NULL), *tension = cli_value(arguments, "tension", "auto");
    options->material.per_strand = strands != NULL;
    options->material.tension = !strcmp(tension, "known")     ? HG_TENSION_KNOWN
                                : !strcmp(tension, "unknown") ? HG_TENSION_UNKNOWN
                                                              : HG_TENSION_AUTO;
    if (options->material.tension == HG_TENSION_AUTO && strcmp(tension, "auto"))
        return hg_fail(HG_INVALID, "--tension %s: known, unknown or auto", tension);
    int64_t n = 0;
    if (cli_value(arguments, "frames", NULL) && !cli_integer(arguments, "frames", &n))
        return hg_fail(HG_INVALID, "--frames %s: expected a whole number", cli_value(arguments, "frames", ""));
    options->n_frames = (int)n;
    options->body = cli_value(arguments, "body", NULL);
    hg_config *config = NULL;
    hg_hair_task *task = NULL;
    hg_material_fit fit = { 0 };
    hg_progress progress = cli_progress();
    hg_status status = take_recipe(arguments, arguments->free[1], &config);
    if (status == HG_OK) status = hg_hair_task_create(&task, ctx, config, NULL, &progress);
    hg_config_destroy(config);
    const char *groom = cli_value(arguments, "groom", NULL);
    if (status == HG_OK && groom) status = hg_hair_choose_groom(task, groom);
    if (status == HG_OK) status = hg_drape_fit_material(task, ctx, arguments->free[2], options, &fit);
    cli_progress_end();
    if (status == HG_OK) print_fit(&fit);
    if (status == HG_OK && strands) {
        status = write_strands(&fit, fit.n_strands, strands);
        if (status == HG_OK) printf("%s: a value for each of %lld strands\n", strands, (long long)fit.n_strands);
    }
    hg_material_fit_free(&fit);
    hg_hair_task_destroy(task);
    return status;
}

static int fit(const hg_arguments *arguments)
{
    const char *names[HG_FIT_PARAMS];
    hg_drape_fit_options options = { .material = { .names = names } };
    if (strcmp(arguments->free[0], "material")) {
        hg_fail(HG_INVALID, "fit %s: what can be fitted is `material`", arguments->free[0]);
        return cli_fail();
    }
    for (int i = 0; i < arguments->n_given && options.material.n < HG_FIT_PARAMS; i++)
        if (!strcmp(arguments->given[i].name, "parameter")) names[options.material.n++] = arguments->given[i].value;
    if (!options.material.n) names[options.material.n++] = "bend_twist.stiffness";
    hg_ctx *ctx = NULL;
    if (!cli_context(&ctx, arguments)) return cli_fail();
    const hg_status status = fit_run(ctx, arguments, &options);
    hg_ctx_destroy(ctx);
    return status == HG_OK ? 0 : cli_fail();
}

static const hg_argument fit_options[] = {
    { "parameter", "NAME", "ENERGY.PARAMETER to find (repeat for more; default bend_twist.stiffness)", true },
    { "per-strand", "FILE.h5", "a value for each strand too, written there", false },
    { "frames", "N", "frames of the drape, spread over it (default 8)", false },
    { "tension", "HOW", "of the edges: known (as the energies say), unknown (whatever balances), auto (default)",
      false },
    { "body", "FILE", "the body that moves with it (default: the one that the drape names)", false },
    { "groom", "NAME", "a groom of the recipe, another file (.h5) or a style (default: the recipe's first)", false },
    { "set", "KEY=VALUE", "override a value of the recipe, like losses.stretch.stiffness=5", true },
    CLI_DEVICE_OPTION,
    CLI_CONTEXT_OPTIONS,
};
HG_COMMAND(fit, .what = "what the hair of an observed drape is made of", .usage = "material RECIPE.yaml DRAPE.vtkhdf",
           .options = fit_options, .n_options = sizeof fit_options / sizeof *fit_options, .min_free = 3, .max_free = 3,
           .run = fit,
           .more = "  hairgrad fit material recipe.yaml drape.vtkhdf --parameter bend_twist.stiffness\n"
                   "The energies of the recipe's `losses:` are those that act on the hair; the value is that with "
                   "which their forces\n"
                   "are in balance at the free vertices. Vertices that touch the body are left out.\n");
