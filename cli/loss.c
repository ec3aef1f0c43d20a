/* hairgrad loss: an energy on arrays of a file, to be held against NumPy or PyTorch. */
#include "cli/cli.h"

#include <string.h>

static void print_result(const hg_loss_result *result, const char *energies, const char *out)
{
    for (int t = 0; t < result->n; t++) printf("%-24s %.17g J\n", result->term[t].name, result->term[t].energy);
    if (result->n > 1) printf("%-24s %.17g J\n", energies, result->energy);
    for (int i = 0; i < result->n_gradients; i++) {
        const hg_loss_gradient *g = &result->gradient[i];
        printf("%-24s %s  norm %.6g  largest %.6g\n", g->name, g->shape, g->norm, g->largest);
    }
    if (result->unread[0]) printf("not read: %s\n", result->unread);
    printf("%lld frames, %lld strands, %lld vertices; %s; %s\n", (long long)result->frames, (long long)result->strands,
           (long long)result->vertices, result->backend, out);
}

static hg_status read_dtype(const hg_arguments *arguments, hg_dtype *dtype)
{
    const char *name = cli_value(arguments, "dtype", "f64");
    *dtype = strcmp(name, "f32") == 0 ? HG_F32 : HG_F64;
    if (*dtype == HG_F64 && strcmp(name, "f64") != 0)
        return hg_fail(HG_INVALID, "--dtype %s: there are f32 and f64", name);
    return HG_OK;
}

static hg_status read_backend(const hg_arguments *arguments, hg_backend *backend)
{
    static const char *const names[] = { "auto", "interpreter", "compiled" }; /* in the order of hg_backend */
    const char *name = cli_value(arguments, "backend", "auto");
    for (int i = 0; i < 3; i++)
        if (strcmp(name, names[i]) == 0) {
            *backend = (hg_backend)i;
            return HG_OK;
        }
    return hg_fail(HG_INVALID, "--backend %s: there are auto, interpreter and compiled", name);
}

static int loss(const hg_arguments *arguments)
{
    const char *out = cli_value(arguments, "output", NULL), *set[64];
    hg_loss_options options = { .energies = arguments->free[0], .set = set, .wrt = cli_value(arguments, "wrt", NULL) };
    for (int i = 0; i < arguments->n_given; i++)
        if (strcmp(arguments->given[i].name, "set") == 0) set[options.n_set++] = arguments->given[i].value;
    if (!out) {
        hg_fail(HG_INVALID, "loss: where should value and gradient go? -o OUT.h5");
        return cli_fail();
    }
    hg_ctx *ctx = NULL;
    if (read_dtype(arguments, &options.dtype) != HG_OK || read_backend(arguments, &options.backend) != HG_OK ||
        !cli_context(&ctx, arguments))
        return cli_fail();
    char *trap = cli_flag(arguments, "trap-nan") ? hg_format("%s.nan.h5", out) : NULL;
    if (trap) remove(trap); /* of a run before */
    if (trap) hg_trap_nan(ctx, true, trap);
    hg_loss_result result;
    const hg_status status = hg_loss_run(ctx, arguments->free[1], out, &options, &result);
    hg_ctx_destroy(ctx);
    hg_free(trap);
    if (status != HG_OK) return cli_fail();
    print_result(&result, options.energies, out);
    return 0;
}

static const hg_argument loss_options[] = {
    { "output", "OUT.h5", "value and gradients (-o)", false },
    { "set", "KEY=VALUE", "a parameter or option, like stiffness=2, \"stiffness=2 N/m\", strain=smooth, g=0,-9.81,0",
      true },
    { "dtype", "f32|f64", "numbers that are computed and written with (default f64)", false },
    { "wrt", "NAMES", "gradients by these too, like x,stiffness,rest (default x)", false },
    { "backend", "NAME", "auto, interpreter or compiled (default auto: compiled where that is worth it)", false },
    { "trap-nan", NULL, "stop at the first number that is not finite: energy, strand, vertex, and a file with it",
      false },
    CLI_DEVICE_OPTION,
    CLI_CONTEXT_OPTIONS,
};
HG_COMMAND(
    loss, .what = "value and gradient of an energy on arrays of a file", .usage = "ENERGY IN.h5 -o OUT.h5",
    .options = loss_options, .n_options = sizeof loss_options / sizeof *loss_options, .min_free = 2, .max_free = 2,
    .run = loss,
    .more =
        "ENERGY is a name of `hairgrad losses`, a plug-in's too, or a sum of some: stretch+gravity.\n"
        "\n"
        "Datasets of IN.h5 (f32 or f64, metres, kilograms, seconds; +Y up; quaternions w,x,y,z). Those are read that "
        "the\n"
        "energy asks for; B frames, S strands, V vertices, root first; with one frame the axis B may be left out:\n"
        "  x [B,S,V,3]                  positions\n"
        "  rest [S,V,3]                 rest groom; several as [G,S,V,3] with groom [B]\n"
        "  posed, predicted, previous   [B,S,V,3] the rigidly posed groom, 2 x(t-1) - x(t-2), x(t-1)\n"
        "  root_rotation [B,S,4]        identity when absent; root_position [B,S,3]: the root of rest when absent.\n"
        "                               With root_position, posed is made of the two when it is absent\n"
        "  q [B,S,V-1,4]                free orientations of the edges\n"
        "  mass                         scalar or [S,V]; 1 kg a vertex when absent\n"
        "  dt                           scalar; 1/30 s when absent\n"
        "  body_vertices [B,N,3], body_faces [F,3], rest_body_vertices [N,3]\n"
        "  density_rest                 scalar or [S,V]; from rest when absent\n"
        "  body_distance                scalar or [S,V]; from the rest body when absent; scalp_distance likewise, "
        "given\n"
        "  neighbours [M,2]             directed pairs of flat vertex numbers s*V+v; from rest when absent\n"
        "  ghost [B,S,V,3], deformation [N,S,V,3], and whatever else a formula reads by name, [B,S,V] or [B,S,V,3]\n"
        "  a parameter's name           scalar, or per strand [S] or [B,S]; a vector [3]. --set comes first\n"
        "An option kernel_mass is \"kg\" here unless set: neighbours are weighed with their mass, as published.\n"
        "\n"
        "OUT.h5: energy (f64 scalar, the sum over all sites, unweighted; energy_NAME of each when there are more),\n"
        "grad_x in the shape of x, and grad_NAME for every name of --wrt, in the shape of what was given: scalar for "
        "one\n"
        "number. An energy that does not read x needs none; without it the default of --wrt is what it reads instead.\n"
        "\n"
        "  hairgrad loss stretch in.h5 -o out.h5 --set \"stiffness=2 N/m\" --wrt x,stiffness\n"
        "  hairgrad loss bend_twist in.h5 -o out.h5 --set strain=smooth --dtype f32\n"
        "  hairgrad --plugin ./mine.so loss my_energy in.h5 -o out.h5\n");
