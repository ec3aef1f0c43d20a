/* hairgrad export: a trained network for other runtimes. */
#include "cli/cli.h"

#include <string.h>

static void tell(hg_hair_task *task, const char *path)
{
    printf("%s: %s network of %lld weights\n", path, hg_hair_model(task)->kind,
           (long long)hg_model_weights(hg_hair_model(task)));
}

static hg_status write_onnx(hg_hair_task *task, hg_ctx *ctx, const char *form, const char *path)
{
    hg_exported files[HG_HAIR_FORMULAS];
    int n;
    HG_TRY(hg_export_hair_onnx_as(task, ctx, form, path, files, &n));
    cli_progress_end();
    if (n == 1) tell(task, files[0].path);
    for (int i = 0; i < n && n > 1; i++) printf("%s: %s\n", files[i].path, files[i].what);
    hg_exported_free(files, n);
    return HG_OK;
}

static hg_status export_run(hg_ctx *ctx, const hg_arguments *arguments, const char *to, const char *path)
{
    hg_progress progress = cli_progress();
    hg_hair_task *task = NULL;
    const char *groom = cli_value(arguments, "groom", NULL);
    hg_status status = hg_hair_task_open(&task, ctx, arguments->free[0], &progress);
    if (status == HG_OK && groom) status = hg_hair_choose_groom(task, groom);
    if (status == HG_OK && !strcmp(to, "onnx"))
        status = write_onnx(task, ctx, cli_value(arguments, "form", NULL), path);
    else if (status == HG_OK) {
        status = hg_export_hair_h5(task, ctx, path);
        cli_progress_end();
        if (status == HG_OK) tell(task, path);
    }
    cli_progress_end();
    hg_hair_task_destroy(task);
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
    if (cli_value(arguments, "form", NULL) && strcmp(to, "onnx") != 0) {
        hg_fail(HG_INVALID, "export: --form %s: only of onnx", cli_value(arguments, "form", NULL));
        return cli_fail();
    }
    hg_ctx *ctx = NULL;
    if (!cli_context(&ctx, arguments)) return cli_fail();
    hg_status status = export_run(ctx, arguments, to, path);
    hg_ctx_destroy(ctx);
    return status == HG_OK ? 0 : cli_fail();
}

static const hg_argument export_options[] = {
    { "output", "FILE", "the network (-o)", false },
    { "to", "FORMAT", "onnx or h5 (default: by the file's name)", false },
    { "form", "FORM",
      "of onnx: concatenated (one graph) or factored (strands once per groom, then frames) of a network of strands; "
      "image or "
      "strands of one of grooms (default: the first)",
      false },
    { "groom", "NAME", "a groom of the run, another file (.h5) or a style (default: the run's first)", false },
    CLI_DEVICE_OPTION,
    CLI_CONTEXT_OPTIONS,
};
HG_COMMAND(export, .what = "write a trained network for other runtimes", .usage = "RUN --to onnx|h5 -o FILE",
           .options = export_options, .n_options = sizeof export_options / sizeof *export_options, .min_free = 1,
           .max_free = 1, .run = export,
           .more = "  hairgrad export out/demo/run --to onnx -o out/demo/model.onnx\n"
                   "  hairgrad export out/demo/run --to h5 -o out/demo/weights.h5\n"
                   "  hairgrad export out/demo/run --form factored -o out/demo/model.onnx   (model.strand.onnx, "
                   "model.frame.onnx)\n"
                   "  hairgrad export out/quaffure/run --form strands --groom wavy -o out/quaffure/wavy.onnx\n");
