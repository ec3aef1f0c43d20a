/* hairgrad evaluate --against: what is asked for, and its tables. */
#include "cli/against.h"

#include <math.h>
#include <string.h>

static hg_status count(const hg_arguments *arguments, const char *name, int64_t *value)
{
    const char *text = cli_value(arguments, name, NULL);
    if (!text || (cli_integer(arguments, name, value) && *value > 0)) return HG_OK;
    return hg_fail(HG_INVALID, "--%s %s: expected a whole number above 0", name, text);
}

hg_status cli_against_options(const hg_arguments *arguments, cli_against *against)
{
    static const char *const methods[] = { [HG_LBFGS] = "lbfgs", [HG_ADAM] = "adam", [HG_XPBD] = "xpbd" };
    hg_against_options *options = &against->options;
    *against = (cli_against){ .options.solver = against->solver };
    for (int i = 0; i < arguments->n_given; i++) {
        if (strcmp(arguments->given[i].name, "against")) continue;
        int number = 0;
        while (number < 3 && strcmp(arguments->given[i].value, methods[number])) number++;
        if (number == 3) return hg_fail(HG_INVALID, "--against %s: lbfgs, adam or xpbd", arguments->given[i].value);
        for (int k = 0; k < options->n_solvers; k++)
            if (against->solver[k].how.minimise.method == (hg_minimise_method)number)
                return hg_fail(HG_INVALID, "--against %s is given twice", methods[number]);
        hg_against_solver *solver = &against->solver[options->n_solvers++];
        solver->name = methods[number];
        solver->how.minimise.method = (hg_minimise_method)number;
        solver->how.minimise.stop = cli_interrupted;
    }
    static const char *const others[] = { "against-frames", "against-strands", "plot" };
    for (size_t i = 0; !options->n_solvers && i < sizeof others / sizeof *others; i++)
        if (cli_value(arguments, others[i], NULL))
            return hg_fail(HG_INVALID, "--%s goes with --against METHOD: lbfgs, adam or xpbd", others[i]);
    HG_TRY(count(arguments, "against-frames", &options->frames));
    if (options->frames && options->frames < 6) options->poses = options->frames;
    return count(arguments, "against-strands", &options->strands);
}

/* ---- tables ------------------------------------------------------------------------------------------------------ */

/* A number that is too long is shortened, so that columns stay apart. */
static void cell(int width, int decimals, double value)
{
    char text[64];
    if (!isfinite(value)) {
        printf("%*s", width, "-");
        return;
    }
    if (snprintf(text, sizeof text, "%.*f", decimals, value) >= width) snprintf(text, sizeof text, "%.3g", value);
    printf("%*s", width, text);
}

static void head_of_part(const char *what, bool moving)
{
    printf("%s\n%-12s %-12s %9s %7s %7s %8s %5s %11s %7s %7s %7s %8s %7s %7s", what, "clip", "", "time", "inside",
           "length", "orient", "curl", "energy", "gap", "median", "free", "with", "off", "p95");
    if (moving) printf(" %6s %6s %6s %7s", "speed", "swing", "corr", "lag");
    printf("\n%-12s %-12s %9s %7s %7s %8s %5s %11s %7s %7s %7s %8s %7s %7s", "", "", "ms/frame", "%", "%", "degrees",
           "", "nJ", "", "strand", "of body", "body", "mm", "mm");
    if (moving) printf(" %6s %6s %6s %7s", "of ref", "of ref", "", "ms");
    printf("\n");
}

static void row_of(const char *clip, const hg_against *a, int k, bool moving)
{
    const hg_against_side *side = &a->side[k], *reference = &a->side[a->reference];
    const hg_against_part *part = moving ? &side->motion : &side->rest;
    printf("%-12.12s %-12.12s", clip, side->name);
    cell(10, 2, 1e3 * part->seconds);
    cell(8, 3, part->inside);
    cell(8, 3, part->length_error);
    cell(9, 2, part->orientation);
    cell(6, 2, part->curl);
    cell(12, 2, 1e9 * part->energy);
    cell(8, 3, part->gap);
    cell(8, 3, part->gap_median);
    cell(8, 3, part->gap_free);
    cell(9, 5, part->gap_contact);
    cell(8, 2, 1e3 * part->distance);
    cell(8, 2, 1e3 * part->distance_p95);
    if (moving) {
        cell(7, 2, side->tips.speed / reference->tips.speed);
        cell(7, 2, side->tips.excursion / reference->tips.excursion);
        cell(7, 2, side->tips.correlation);
        cell(8, 1, 1e3 * side->tips.lag);
    }
    printf("\n");
}

static void table_of(const char *what, bool moving, int n, const char *const *clips, const hg_against *all,
                     const hg_against *mean)
{
    head_of_part(what, moving);
    for (int i = 0; i < n; i++)
        for (int k = 0; k < all[i].n_sides; k++) row_of(clips[i], &all[i], k, moving);
    for (int k = 0; n > 1 && k < mean->n_sides; k++) row_of("mean", mean, k, moving);
}

static void terms_of(const hg_against *mean, bool moving)
{
    printf("%-20s", moving ? "in motion, nJ" : "at rest, nJ");
    for (int k = 0; k < mean->n_sides; k++) printf(" %12.12s", mean->side[k].name);
    printf("\n");
    for (int i = 0; i <= mean->n_terms; i++) {
        if (i < mean->n_terms && !moving && mean->term_moves[i]) continue;
        printf("%-20s", i < mean->n_terms ? mean->term[i] : "sum");
        for (int k = 0; k < mean->n_sides; k++) {
            const hg_against_part *part = moving ? &mean->side[k].motion : &mean->side[k].rest;
            printf(" %12.4f", 1e9 * (i < mean->n_terms ? part->term_energy[i] : part->energy));
        }
        printf("\n");
    }
}

static void say_converged(const hg_against *mean, int k, bool moving)
{
    const hg_against_part *part = moving ? &mean->side[k].motion : &mean->side[k].rest;
    if (!part->solves) return;
    if (!strcmp(mean->side[k].name, "xpbd")) { /* it knows of no minimum, and in motion of no rest */
        if (!moving)
            printf("xpbd: %lld of %lld strands came to rest\n", (long long)part->converged, (long long)part->solves);
        return;
    }
    printf("%s, %s: %lld of %lld strands at their minimum, %lld that sink no more", mean->side[k].name,
           moving ? "in motion" : "at rest", (long long)part->converged, (long long)part->solves,
           (long long)part->stalled);
    const long long neither = (long long)(part->solves - part->converged - part->stalled);
    if (neither) printf(", %lld not there", neither);
    printf("%s\n", k == mean->reference && part->converged < part->solves ? ": the minimum is an upper bound" : "");
}

hg_status cli_against_show(const hg_arguments *arguments, int n, const char *const *clips, const hg_against *against)
{
    hg_against mean;
    char what[160];
    const char *json = cli_value(arguments, "json", NULL), *plot = cli_value(arguments, "plot", NULL);
    hg_hair_against_mean(against, n, &mean);
    const char *reference = mean.side[mean.reference].name;
    snprintf(what, sizeof what, "at rest: %lld poses, %lld strands; gap: 0 is %s, 1 the posed groom",
             (long long)mean.poses, (long long)mean.strands, reference);
    table_of(what, false, n, clips, against, &mean);
    if (mean.frames) {
        snprintf(what, sizeof what, "\nin motion: %lld frames; against %s through time", (long long)mean.frames,
                 reference);
        table_of(what, true, n, clips, against, &mean);
    }
    printf("\nper strand, weighted, gravity counted from the posed groom; mean of all\n");
    terms_of(&mean, false);
    if (mean.frames) {
        printf("\neach with its own past\n");
        terms_of(&mean, true);
    }
    printf("\n");
    for (int k = 1; k + 1 < mean.n_sides; k++) {
        say_converged(&mean, k, false);
        if (mean.frames) say_converged(&mean, k, true);
    }
    if (json) HG_TRY(hg_hair_against_write(json, n, clips, against));
    if (!plot) return HG_OK;
    hg_image *image;
    HG_TRY(hg_against_draw(&image, n, clips, against, 0, 0));
    const hg_status status = hg_image_write_png(image, plot);
    hg_image_destroy(image);
    return status;
}
