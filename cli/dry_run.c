/* hairgrad train --dry-run: what would be trained, from everything loaded and two steps made. Writes nothing. */
#include "cli/train.h"

#include <string.h>

static void tell_scene(const hg_hair_task *task)
{
    const hg_body *body = hg_hair_body(task);
    printf("body        %lld vertices, %lld faces, %lld of them scalp, %lld joints\n", (long long)body->vertices,
           (long long)body->faces, (long long)body->scalp_faces, (long long)body->joints);
    for (int i = 0; i < hg_hair_grooms(task); i++) {
        const hg_groom *groom = hg_hair_groom_at(task, i);
        printf("groom       %s: %lld strands of %lld vertices", groom->name ? groom->name : "grown",
               (long long)groom->strands, (long long)groom->vertices);
        if (hg_hair_left_out(task, i)) printf(", %lld left out", (long long)hg_hair_left_out(task, i));
        printf("\n");
    }
    for (int held_out = 0; held_out < 2; held_out++) {
        int64_t frames = 0;
        const int n = hg_hair_clips(task, held_out);
        for (int i = 0; i < n; i++) frames += hg_hair_clip(task, held_out, i)->frames;
        printf("%s  %d clips, %lld frames, %.0f s at %g frames/s:", held_out ? "held out  " : "trained on", n,
               (long long)frames, (double)frames / hg_hair_rate(task), hg_hair_rate(task));
        for (int i = 0; i < n && i < 8; i++) {
            const char *name = hg_hair_clip(task, held_out, i)->name;
            printf(" %s", name ? name : "?");
        }
        printf("%s\n", n > 8 ? " .." : "");
    }
}

static void tell_network(hg_hair_task *task)
{
    const hg_feature *feature;
    const int n = hg_hair_features(task, &feature), strand = hg_hair_strand_inputs(task);
    int columns = 0;
    for (int i = 0; i < n; i++) columns += feature[i].count;
    const hg_model *model = hg_hair_model(task);
    int rest = 0; /* what turned edges start from is no input of the network */
    for (int i = 0; i < n; i++)
        if (!strcmp(feature[i].name, "rest")) rest = feature[i].count;
    printf("inputs      %d: %d of a strand or its groom, %d of a frame\n", columns - rest, strand - rest,
           columns - strand);
    printf("network     %s, %lld weights\n", model->kind, (long long)hg_model_weights(model));
    for (int i = 0; i < model->n_params; i++) {
        char shape[96];
        printf("            %-16s %s\n", model->params[i]->name, hg_shape_text(model->params[i], shape));
    }
}

static void tell_materials(const hg_hair_task *task)
{
    for (int i = 0; i < hg_hair_materials(task); i++) {
        const char *name, *unit;
        double range[2], value;
        if (hg_hair_material_at(task, i, &name, &unit, range, &value) == HG_OK)
            printf("%-12s%s  %g to %g %s, %g when nothing is said\n", i ? "" : "materials", name, range[0], range[1],
                   unit ? unit : "", value);
    }
}

static void tell_energies(hg_hair_task *task)
{
    const hg_physics *physics = hg_hair_physics(task);
    for (int i = 0; i < hg_physics_terms(physics); i++) {
        const hg_term *term = hg_physics_term(physics, i);
        printf("%-12s%s", i ? "" : "energies", term->energy->name);
        if (term->weight < 1 || term->weight > 1) printf("  weight %g", term->weight);
        for (int k = 0; k < HG_ENERGY_PARAMS && term->energy->params[k].name; k++)
            printf("  %s %g %s", term->energy->params[k].name, term->params[k],
                   term->energy->params[k].unit ? term->energy->params[k].unit : "");
        for (int k = 0; k < HG_ENERGY_OPTIONS && term->energy->options[k].name; k++)
            printf("  %s %s", term->energy->options[k].name, term->options[k]);
        printf("\n");
    }
    printf("back end    %s\n", hg_physics_backend_name(physics));
}

hg_status cli_dry_run(hg_ctx *ctx, hg_hair_task *task, const hg_progress *progress)
{
    const hg_train_options planned = hg_hair_train_options(task);
    hg_train_options options = planned;
    options.folder = NULL;
    options.stop = NULL;
    hg_task quiet = *hg_hair_task_of(task);
    quiet.validate = NULL; /* it would be counted as steps */
    hg_train_result first, both;
    options.steps = 1; /* the first makes what the others use again */
    HG_TRY(hg_train(ctx, hg_hair_model(task), &quiet, &options, progress, &first));
    options.start_from = NULL;
    options.steps = 2;
    HG_TRY(hg_train(ctx, hg_hair_model(task), &quiet, &options, progress, &both));
    cli_progress_end();
    tell_scene(task);
    tell_network(task);
    tell_materials(task);
    tell_energies(task);
    const double step = both.seconds / 2;
    printf("memory      %.0f MB for a step\n", (double)hg_step_high_water(ctx) / 1e6);
    printf("a step      %.3g s on %d threads; %lld steps: %.3g minutes with nothing else running\n", step,
           hg_ctx_threads(ctx), (long long)planned.steps, step * (double)planned.steps / 60);
    printf("first loss  %.4g\n", first.loss);
    return HG_OK;
}
