/* hairgrad replay: runs again what --trap-nan wrote. */
#include "cli/cli.h"

static hg_status replay_file(hg_ctx *ctx, const char *path)
{
    hg_h5 *file;
    char *command = NULL;
    HG_TRY(hg_h5_open(&file, path));
    const bool is_energy = hg_h5_get_text(file, "/", "command", &command) == HG_OK;
    hg_h5_close(file);
    if (is_energy) {
        printf("%s: the inputs of an energy; this evaluates it:\n%s\n", path, command);
        hg_free(command);
        return HG_OK;
    }
    hg_text report = { 0 };
    const hg_status status = hg_trap_replay(ctx, path, &report);
    if (status == HG_OK && report.data) fputs(report.data, stdout);
    hg_text_free(&report);
    return status;
}

static int replay(const hg_arguments *arguments)
{
    hg_ctx *ctx = NULL;
    if (!cli_context(&ctx, arguments)) return cli_fail();
    const hg_status status = replay_file(ctx, arguments->free[0]);
    hg_ctx_destroy(ctx);
    return status == HG_OK ? 0 : cli_fail();
}

static const hg_argument replay_options[] = { CLI_DEVICE_OPTION, CLI_CONTEXT_OPTIONS };
HG_COMMAND(replay, .what = "run again what --trap-nan wrote", .usage = "NAN.h5", .options = replay_options,
           .n_options = sizeof replay_options / sizeof *replay_options, .min_free = 1, .max_free = 1, .run = replay,
           .more = "Of an op: where its inputs, output and gradients are not finite, in its own precision and in f64.\n"
                   "Of an energy: the `hairgrad loss` command that evaluates it.\n");
