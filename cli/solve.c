/* hairgrad solve: the minimum of a config's energies on its scene, without a network. */
#include "cli/shape.h"

#include <string.h>
#include <sys/stat.h>

/* A recipe, or the config of a run; no network is needed. */
static hg_status take_config(const hg_arguments *arguments, hg_config **config)
{
    const char *given = arguments->free[0];
    struct stat what;
    char *path =
        stat(given, &what) == 0 && S_ISDIR(what.st_mode) ? hg_path_join(given, "config.yaml") : hg_strdup(given);
    if (!path) return HG_MEMORY;
    hg_status status = hg_hair_config_load(config, path);
    hg_free(path);
    if (status == HG_OK) status = hg_config_set(*config, "features.encoder_steps", "1");
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

static hg_status choose_motion(const hg_arguments *arguments, const hg_hair_task *task, hg_motion **loaded,
                               const hg_motion **motion)
{
    const char *file = cli_value(arguments, "motion", NULL), *clip = cli_value(arguments, "clip", NULL);
    if (file && clip) return hg_fail(HG_INVALID, "solve: either --motion or --clip");
    if (file) {
        hg_motion *read = NULL;
        HG_TRY(hg_motion_load(&read, file, hg_hair_body(task)));
        const hg_status status = hg_motion_resample(loaded, read, hg_hair_rate(task));
        hg_motion_destroy(read);
        *motion = *loaded;
        return status;
    }
    *motion = clip ? cli_clip(task, clip) : hg_hair_clip(task, hg_hair_clips(task, true) > 0, 0);
    return *motion ? HG_OK : HG_INVALID;
}

static hg_status whole(const hg_arguments *arguments, const char *name, int64_t *value)
{
    const char *text = cli_value(arguments, name, NULL);
    if (!text || (cli_integer(arguments, name, value) && *value >= 0)) return HG_OK;
    return hg_fail(HG_INVALID, "--%s %s: expected a whole number, at least 0", name, text);
}

/* What only one of the methods understands is refused for the others. */
static hg_status take_xpbd(const hg_arguments *arguments, hg_hair_solve_options *options)
{
    static const char *const own[] = { "substeps", "iterations", "steps", "sweeps", "strand-distance" };
    const bool xpbd = options->minimise.method == HG_XPBD;
    for (size_t i = 0; i < sizeof own / sizeof *own && !xpbd; i++)
        if (cli_value(arguments, own[i], NULL) || (!strcmp(own[i], "sweeps") && cli_flag(arguments, own[i])))
            return hg_fail(HG_INVALID, "--%s belongs to --method xpbd", own[i]);
    if (xpbd && cli_value(arguments, "evaluations", NULL))
        return hg_fail(HG_INVALID, "--evaluations belongs to the other methods; xpbd has --steps");
    int64_t substeps = 0, iterations = 0;
    HG_TRY(whole(arguments, "substeps", &substeps));
    HG_TRY(whole(arguments, "iterations", &iterations));
    HG_TRY(whole(arguments, "steps", &options->xpbd.steps));
    if (substeps > 100000 || iterations > 100000)
        return hg_fail(HG_INVALID, "solve: at most 100000 substeps and iterations");
    options->xpbd.substeps = (int)substeps, options->xpbd.iterations = (int)iterations;
    options->xpbd.sweeps = cli_flag(arguments, "sweeps");
    const char *distance = cli_value(arguments, "strand-distance", NULL);
    return distance ? hg_unit_parse(distance, "m", &options->xpbd.strand_distance) : HG_OK;
}

static hg_status take_options(const hg_arguments *arguments, hg_hair_solve_options *options)
{
    const char *method = cli_value(arguments, "method", "lbfgs");
    static const char *const methods[] = { [HG_LBFGS] = "lbfgs", [HG_ADAM] = "adam", [HG_XPBD] = "xpbd" };
    int number = 0;
    while (number < 3 && strcmp(method, methods[number])) number++;
    if (number == 3) return hg_fail(HG_INVALID, "--method %s: lbfgs, adam or xpbd", method);
    options->minimise.method = (hg_minimise_method)number;
    options->minimise.stop = cli_interrupted;
    options->dynamic = cli_flag(arguments, "dynamic");
    HG_TRY(whole(arguments, "first", &options->first));
    HG_TRY(whole(arguments, "frames", &options->frames));
    HG_TRY(whole(arguments, "strands", &options->strands));
    HG_TRY(take_xpbd(arguments, options));
    return whole(arguments, "evaluations", &options->minimise.evaluations);
}

static void print_solution(const hg_hair_solution *s, bool xpbd, bool dynamic)
{
    const hg_hair_metrics *m = &s->metrics;
    printf("%-20s %12s %12s   (nJ per strand, weighted; gravity counted from the posed groom)\n", "energy",
           xpbd ? "xpbd" : "minimum", "posed groom");
    for (int i = 0; i < m->n_terms; i++)
        printf("%-20s %12.4f %12.4f\n", m->term[i], 1e9 * m->term_energy[i], 1e9 * m->term_posed[i]);
    printf("%-20s %12.4f %12.4f\n", "sum", 1e9 * m->energy, 1e9 * m->energy_posed);
    printf("length error %.3f %%, turned %.2f degrees, tips moved by %.1f %% of the length, %.3f of the curl, inside "
           "%.3f %% (posed "
           "%.3f %%)\n",
           m->length_error, m->orientation, m->tip_moved, m->curl, m->inside, m->inside_posed);
    if (xpbd) {
        if (*s->left_out) printf("without a constraint of xpbd: %s\n", s->left_out);
        printf("%lld of %lld strands at rest%s, largest movement in the last step to rest %.2g m; %.0f steps a strand, "
               "%.1f s\n",
               (long long)s->converged, (long long)(dynamic ? m->strands : s->solves),
               dynamic ? " in the first frame" : "", s->movement, s->iterations, s->seconds);
        return;
    }
    printf("%lld of %lld strands at their minimum, %lld in or beside a kink of the energy, which sink no more\n",
           (long long)s->converged, (long long)s->solves, (long long)s->stalled);
    printf("largest movement left %.2g m, force %.2g N; %.0f iterations a strand, %lld evaluations, %.1f s\n",
           s->movement, s->force, s->iterations, (long long)s->evaluations, s->seconds);
}

static hg_status solve_run(hg_ctx *ctx, const hg_arguments *arguments, const char *path)
{
    hg_progress progress = cli_progress();
    hg_hair_solve_options options = { 0 };
    hg_hair_solution solution;
    double shape[HG_SHAPES];
    bool given;
    hg_config *config = NULL;
    hg_hair_task *task = NULL;
    hg_motion *loaded = NULL;
    const hg_motion *motion = NULL;
    hg_drape_file *file = NULL;
    HG_TRY(cli_shape(arguments, shape, &given));
    HG_TRY(take_options(arguments, &options));
    cli_catch_signals();
    hg_status status = take_config(arguments, &config);
    if (status == HG_OK) status = hg_hair_task_create(&task, ctx, config, NULL, &progress);
    hg_config_destroy(config);
    const char *groom = cli_value(arguments, "groom", NULL);
    if (status == HG_OK && groom) status = hg_hair_choose_groom(task, groom);
    if (status == HG_OK) status = choose_motion(arguments, task, &loaded, &motion);
    const int64_t left = status == HG_OK ? motion->frames - options.first : 0;
    if (status == HG_OK && left < 1)
        status = hg_fail(HG_INVALID, "solve: from frame %lld: the motion has %lld frames", (long long)options.first,
                         (long long)motion->frames);
    if (!options.frames || options.frames > left) options.frames = left;
    if (status == HG_OK && path)
        status = hg_drape_file_create(&file, path, cli_value(arguments, "body-out", NULL), hg_hair_groom(task),
                                      hg_hair_body(task), options.frames, hg_hair_rate(task));
    if (status == HG_OK)
        status = hg_hair_solve(task, ctx, motion, shape, &options, file ? hg_drape_file_add : NULL, file, &solution,
                               &progress);
    if (status == HG_OK && solution.interrupted)
        status = hg_fail(HG_INVALID, "solve: interrupted; nothing was written");
    if (status == HG_OK && file)
        status = hg_drape_file_commit(file);
    else
        hg_drape_file_discard(file);
    cli_progress_end();
    const char *json = cli_value(arguments, "json", NULL);
    if (status == HG_OK && json)
        status = hg_hair_solution_write(json, motion->name ? motion->name : "motion", &solution);
    if (status == HG_OK) print_solution(&solution, options.minimise.method == HG_XPBD, options.dynamic);
    if (status == HG_OK && path)
        printf("%s: %lld frames of %lld strands\n", path, (long long)options.frames,
               (long long)solution.metrics.strands);
    hg_motion_destroy(loaded);
    hg_hair_task_destroy(task);
    return status;
}

static int solve(const hg_arguments *arguments)
{
    hg_ctx *ctx = NULL;
    if (!cli_context(&ctx, arguments)) return 1;
    const hg_status status = solve_run(ctx, arguments, cli_value(arguments, "output", NULL));
    hg_ctx_destroy(ctx);
    return status == HG_OK ? 0 : cli_fail();
}

static const hg_argument solve_options[] = {
    { "output", "FILE", "the drape, VTKHDF (-o; default: none is written)", false },
    { "body-out", "FILE", "the body that moves with it, VTKHDF", false },
    { "json", "FILE", "write the numbers there too", false },
    { "method", "NAME",
      "lbfgs (default), which gets there; adam, which does not; xpbd: Cosserat rods by position-based dynamics",
      false },
    { "dynamic", NULL, "each frame with the two before it: inertia and drag act; else each frame is at rest", false },
    { "motion", "FILE", "a motion file (.h5)", false },
    { "clip", "NAME", "a clip of the recipe (default: the first that is held out)", false },
    { "groom", "NAME", "a groom of the recipe, another file (.h5) or a style (default: the recipe's first)", false },
    { "shape", "NUMBERS", "body shape, like 0.5,0,-1 (default: the neutral body)", false },
    { "first", "N", "first frame (default 0)", false },
    { "frames", "N", "how many (default: all)", false },
    { "strands", "N", "so many, evenly over the groom (default: as many as a training step has)", false },
    { "evaluations", "N", "of the energy, at most, for a frame (default 6000; adam 2000)", false },
    { "substeps", "N", "xpbd: of a frame (default 20; to rest without --sweeps 1)", false },
    { "iterations", "N", "xpbd: in each of them (default 1; with --sweeps 10)", false },
    { "sweeps", NULL, "xpbd: Gauss-Seidel along the strand, as published; else each strand is solved for as a whole",
      false },
    { "steps", "N", "xpbd: at most so many until a frame is at rest (default 200)", false },
    { "strand-distance", "LENGTH",
      "xpbd: what vertices of different strands keep, like \"0.5 mm\" (default: they do not feel each other)", false },
    { "set", "KEY=VALUE", "override a value of the config, like losses.stretch.stiffness=5", true },
    CLI_CONTEXT_OPTIONS,
};
HG_COMMAND(solve, .what = "minimise the energies of a recipe directly, without a network",
           .usage = "RECIPE.yaml|RUN [-o FILE.vtkhdf]", .options = solve_options,
           .n_options = sizeof solve_options / sizeof *solve_options, .min_free = 1, .max_free = 1, .run = solve,
           .more = "  hairgrad solve examples/recipes/quasi_static.yaml --clip turn --frames 10 -o solved.vtkhdf\n"
                   "  hairgrad solve out/run --dynamic --strands 200 -o solved.vtkhdf --json solved.json\n"
                   "A strand is at its minimum when a full Newton step would move no vertex by more than 10 nm.\n");
