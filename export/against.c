/* The comparison of a network with solvers as a picture: what its hair has of each energy, and how its tips swing. */
#include "export/draw.h"

#include <math.h>
#include <stdio.h>

enum { CLIPS = 6, PANELS = 3 };

static hg_status draw_energies(hg_image *image, int x, int y, int width, int height, const char *clip,
                               const hg_against *a)
{
    const char *groups[17], *bars[HG_AGAINST_SIDES];
    double values[17 * HG_AGAINST_SIDES];
    char title[160];
    double limit = 0; /* what contact costs the posed groom is of another order */
    int n = 0;
    for (int i = 0; i <= a->n_terms; i++) {
        if (i < a->n_terms && a->term_moves[i]) continue;
        groups[n] = i < a->n_terms ? a->term[i] : "sum";
        for (int k = 0; k < a->n_sides; k++) {
            const hg_against_part *part = &a->side[k].rest;
            values[n * a->n_sides + k] = 1e9 * (i < a->n_terms ? part->term_energy[i] : part->energy);
            if (k == 0 || k == a->reference) limit = fmax(limit, fabs(values[n * a->n_sides + k]));
        }
        n++;
    }
    for (int k = 0; k < a->n_sides; k++) bars[k] = a->side[k].name;
    snprintf(title, sizeof title, "%.40s: at rest, gap %.3f", clip, a->side[0].rest.gap);
    return hg_plot_bars(image, x, y, width, height, title, "nJ per strand", n, groups, a->n_sides, bars, values, limit);
}

/* Off the posed place; the posed groom itself stays at zero. */
static hg_status draw_tip(hg_image *image, int x, int y, int width, int height, const hg_against *a, int tip,
                          double *numbers /* [(1 + n_sides) frames] */)
{
    static const char *const which[] = { "a tip that swings much", "a tip as most swing" };
    const int64_t T = a->frames;
    const int posed = a->n_sides - 1;
    hg_curve curves[HG_AGAINST_SIDES];
    for (int64_t t = 0; t < T; t++) numbers[t] = (double)(a->first + t) / a->rate;
    for (int k = 0; k < posed; k++) {
        double *way = numbers + (k + 1) * T;
        for (int64_t t = 0; t < T; t++) way[t] = 1e3 * a->tip[(tip * a->n_sides + k) * T + t];
        curves[k] = (hg_curve){ a->side[k].name, T, numbers, way };
    }
    return hg_plot(image, x, y, width, height, which[tip], "time [s]", "off the posed place [mm]", posed, curves,
                   false);
}

hg_status hg_against_draw(hg_image **picture, int n, const char *const *clips, const hg_against *against, int width,
                          int height)
{
    static const uint8_t white[3] = { 255, 255, 255 };
    hg_image *image = NULL;
    int64_t frames = 0;
    int columns = 1;
    *picture = NULL;
    if (n < 1) return hg_fail(HG_INVALID, "against: there is no comparison to draw");
    if (n > CLIPS) n = CLIPS;
    if (width <= 0) width = 620;
    if (height <= 0) height = 420;
    for (int i = 0; i < n; i++) {
        if (against[i].frames > frames) frames = against[i].frames;
        if (against[i].n_tips > 0) columns = PANELS;
    }
    double *numbers = hg_alloc((size_t)(frames * (1 + HG_AGAINST_SIDES)) + 1, sizeof *numbers);
    hg_status status = numbers ? hg_image_create(&image, columns * width, n * height, white) : HG_MEMORY;
    for (int i = 0; status == HG_OK && i < n; i++) {
        status = draw_energies(image, 0, i * height, width, height, clips[i], &against[i]);
        for (int tip = 0; status == HG_OK && tip < against[i].n_tips && tip + 1 < PANELS; tip++)
            status = draw_tip(image, (tip + 1) * width, i * height, width, height, &against[i], tip, numbers);
    }
    hg_free(numbers);
    if (status == HG_OK)
        *picture = image;
    else
        hg_image_destroy(image);
    return status;
}
