/* hairgrad train: a network from a recipe. */
#include "cli/train.h"

#include <math.h>
#include <string.h>

static hg_status overrides(hg_config *config, const hg_arguments *arguments)
{
    for (int i = 0; i < arguments->n_given; i++) {
        if (strcmp(arguments->given[i].name, "set")) continue;
        char *key = hg_strdup(arguments->given[i].value);
        if (!key) return HG_MEMORY;
        char *value = strchr(key, '=');
        if (value) *value++ = '\0';
        const hg_status status =
            value ? hg_config_set(config, key, value)
                  : hg_fail(HG_INVALID, "--set %s: expected key=value, like training.steps=2000", key);
        hg_free(key);
        HG_TRY(status);
    }
    return HG_OK;
}

static hg_status look_at_folder(const char *folder, bool resume, bool again)
{
    char *checkpoint = hg_path_join(folder, "checkpoint.h5"), *best = hg_path_join(folder, "best.h5");
    hg_status status = checkpoint && best ? HG_OK : HG_MEMORY;
    if (status == HG_OK && !resume && !again && (hg_file_exists(checkpoint) || hg_file_exists(best)))
        status =
            hg_fail(HG_INVALID, "%s: it holds a run already; --resume goes on with it, --again starts it anew", folder);
    if (status == HG_OK && again && !resume) {
        remove(checkpoint);
        remove(best);
    }
    hg_free(checkpoint);
    hg_free(best);
    return status;
}

static hg_status train_run(hg_ctx *ctx, const hg_arguments *arguments, const char *folder, hg_train_result *result)
{
    hg_config *config = NULL;
    HG_TRY(hg_hair_config_load(&config, arguments->free[0]));
    const bool resume = cli_flag(arguments, "resume"), dry = cli_flag(arguments, "dry-run");
    hg_hair_task *task = NULL;
    hg_progress progress = cli_progress();
    hg_status status = overrides(config, arguments);
    if (status == HG_OK && folder) status = look_at_folder(folder, resume, cli_flag(arguments, "again"));
    if (status == HG_OK && dry) status = hg_config_set(config, "features.encoder_steps", "1"); /* takes its time */
    if (status == HG_OK) status = hg_hair_task_create(&task, ctx, config, folder, &progress);
    hg_config_destroy(config);
    if (status == HG_OK && dry) {
        status = cli_dry_run(ctx, task, &progress);
    } else if (status == HG_OK) {
        hg_train_options options = hg_hair_train_options(task);
        options.resume = resume;
        options.allow_other_backend = cli_flag(arguments, "other-backend");
        options.stop = cli_interrupted;
        options.graph = cli_value(arguments, "graph", NULL);
        double minutes = 0;
        if (cli_value(arguments, "minutes", NULL) && !cli_number(arguments, "minutes", &minutes))
            status = hg_fail(HG_INVALID, "--minutes %s: expected a number", cli_value(arguments, "minutes", ""));
        options.minutes = minutes;
        cli_catch_signals();
        if (status == HG_OK)
            status = hg_train(ctx, hg_hair_model(task), hg_hair_task_of(task), &options, &progress, result);
    }
    cli_progress_end();
    hg_hair_task_destroy(task);
    return status;
}

static int train(const hg_arguments *arguments)
{
    hg_ctx *ctx = NULL;
    const bool dry = cli_flag(arguments, "dry-run");
    const char *folder = dry ? NULL : cli_value(arguments, "output", NULL);
    if (!folder && !dry) {
        hg_fail(HG_INVALID, "train: where should the run go? -o FOLDER");
        return cli_fail();
    }
    if (!cli_context(&ctx, arguments)) return cli_fail();
    hg_train_result result = { 0 };
    char *trap = NULL;
    hg_status status = cli_trap(ctx, arguments, folder, &trap);
    if (status == HG_OK) status = train_run(ctx, arguments, folder, &result);
    hg_ctx_destroy(ctx);
    hg_free(trap);
    if (status != HG_OK) return cli_fail();
    if (dry) return 0;
    if (result.early) printf("stopped early: the validation no longer gets better\n");
    printf("%s %lld steps in %.0f s", result.interrupted ? "stopped after" : "trained", (long long)result.steps,
           result.seconds);
    if (isfinite(result.loss)) printf(", loss %.4g", result.loss);
    if (isfinite(result.best_validation)) printf(", best validation %.4g", result.best_validation);
    printf("\n%s%s\n", result.interrupted ? "go on with --resume: " : "", folder);
    return 0;
}

static const hg_argument train_options[] = {
    { "output", "RUN", "folder of the run (-o)", false },
    { "set", "KEY=VALUE", "override a value of the recipe, like training.steps=2000", true },
    { "resume", NULL, "go on from the run's checkpoint", false },
    { "again", NULL, "start anew in a folder that holds a run", false },
    { "dry-run", NULL, "load and check everything, say what would be trained, make two steps; write nothing", false },
    { "minutes", "N", "stop after so many minutes; the learning rate comes down by then", false },
    { "other-backend", NULL, "resume although another back end computed the checkpoint", false },
    { "graph", "FILE.dot", "draw the tape of the first step: ops, shapes, norms of gradients (Graphviz)", false },
    CLI_TRAP_OPTION,
    CLI_DEVICE_OPTION,
    CLI_CONTEXT_OPTIONS,
};
HG_COMMAND(
    train, .what = "train a network on a recipe", .usage = "RECIPE.yaml -o RUN|--dry-run", .options = train_options,
    .n_options = sizeof train_options / sizeof *train_options, .min_free = 1, .max_free = 1, .run = train,
    .more = "  hairgrad train examples/recipes/demo.yaml -o out/demo/run\n"
            "  hairgrad train examples/recipes/neuralocks.yaml -o out/run --set scene.folder=out/scene --minutes 20\n"
            "Ctrl-C writes a checkpoint; the same command with --resume goes on, bit for bit.\n");
