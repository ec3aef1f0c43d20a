/* hairgrad export: a trained network for other runtimes. */
#include "cli/cli.h"

#include <string.h>

static hg_status export_run(hg_ctx *ctx, const char *run, const char *to, bool factored, const char *path)
{
    hg_progress progress = cli_progress();
    hg_hair_task *task = NULL;
    hg_status status = hg_hair_task_open(&task, ctx, run, &progress);
    char *strand_path = NULL, *frame_path = NULL;
    if (status == HG_OK && factored)
        status = hg_export_hair_onnx_factored(task, ctx, path, &strand_path, &frame_path);
    else if (status == HG_OK)
        status = strcmp(to, "onnx") == 0 ? hg_export_hair_onnx(task, ctx, path) : hg_export_hair_h5(task, ctx, path);
    cli_progress_end();
    if (status == HG_OK && factored)
        printf("%s: once per groom\n%s: once per frame, with its output\n", strand_path, frame_path);
    else if (status == HG_OK)
        printf("%s: %s network of %lld weights\n", path, hg_hair_model(task)->kind,
               (long long)hg_model_weights(hg_hair_model(task)));
    hg_hair_task_destroy(task);
    hg_free(strand_path);
    hg_free(frame_path);
    return status;
}

static int export(const hg_arguments *arguments)
{
    static const char *const formats[] = { "onnx", "h5" };
    const char *path = cli_value(arguments, "output", NULL);
    const char *to = cli_value(arguments, "to", path ? hg_path_extension(path) : "onnx");
    if (!path) {
        hg_fail(HG_INVALID, "export: where should the network go? -o FILE");
        return cli_fail();
    }
    if (strcmp(to, "onnx") != 0 && strcmp(to, "h5") != 0) {
        const char *nearest = hg_nearest_of(to, formats, 2);
        hg_fail(HG_INVALID, "export: --to %s: known are onnx and h5%s%s%s", to, nearest ? "; did you mean " : "",
                nearest ? nearest : "", nearest ? "?" : "");
        return cli_fail();
    }
    const char *form = cli_value(arguments, "form", "concatenated");
    const bool factored = !strcmp(form, "factored");
    if ((!factored && strcmp(form, "concatenated")) || (factored && strcmp(to, "onnx"))) {
        hg_fail(HG_INVALID,
                factored ? "export: --form %s: only of onnx" : "export: --form %s: concatenated or factored", form);
        return cli_fail();
    }
    hg_ctx *ctx = NULL;
    if (!cli_context(&ctx, arguments)) return cli_fail();
    hg_status status = export_run(ctx, arguments->free[0], to, factored, path);
    hg_ctx_destroy(ctx);
    return status == HG_OK ? 0 : cli_fail();
}

static const hg_argument export_options[] = {
    { "output", "FILE", "the network (-o)", false },
    { "to", "FORMAT", "onnx or h5 (default: by the file's name)", false },
    { "form", "FORM", "of onnx: concatenated (one graph, default) or factored (strands once per groom, then frames)",
      false },
    CLI_DEVICE_OPTION,
    CLI_CONTEXT_OPTIONS,
};
HG_COMMAND(export, .what = "write a trained network for other runtimes", .usage = "RUN --to onnx|h5 -o FILE",
           .options = export_options, .n_options = sizeof export_options / sizeof *export_options, .min_free = 1,
           .max_free = 1, .run = export,
           .more = "  hairgrad export out/demo/run --to onnx -o out/demo/model.onnx\n"
                   "  hairgrad export out/demo/run --to h5 -o out/demo/weights.h5\n"
                   "  hairgrad export out/demo/run --form factored -o out/demo/model.onnx   (model.strand.onnx, "
                   "model.frame.onnx)\n");
