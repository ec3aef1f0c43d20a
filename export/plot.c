/* Plots: axes with round tick values, labels, a legend; several curves, or bars. */
#include "export/draw.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

static const uint8_t ink[3] = { 40, 42, 48 }, grid_colour[3] = { 214, 216, 220 }, paper[3] = { 255, 255, 255 };

/* Told apart by colour-blind readers too (Okabe and Ito). */
static const uint8_t curve_colour[8][3] = { { 0, 114, 178 },   { 213, 94, 0 },  { 0, 158, 115 },  { 204, 121, 167 },
                                            { 120, 120, 120 }, { 230, 159, 0 }, { 86, 180, 233 }, { 60, 60, 60 } };

typedef struct {
    double low, high;
} range;

static range range_of(int n, const hg_curve *curves, bool vertical)
{
    range r = { DBL_MAX, -DBL_MAX };
    for (int c = 0; c < n; c++)
        for (int64_t i = 0; i < curves[c].n; i++) {
            double value = vertical ? curves[c].y[i] : curves[c].x[i];
            if (!isfinite(curves[c].x[i]) || !isfinite(curves[c].y[i])) continue;
            r.low = fmin(r.low, value);
            r.high = fmax(r.high, value);
        }
    if (r.low > r.high) return (range){ 0.0, 1.0 };
    if (r.high - r.low < 1e-12 * fmax(fabs(r.low), fabs(r.high)) || r.high == r.low) {
        double around = r.low == 0.0 ? 1.0 : 0.1 * fabs(r.low);
        return (range){ r.low - around, r.high + around };
    }
    double margin = 0.05 * (r.high - r.low);
    return (range){ r.low - margin, r.high + margin };
}

/* 1, 2 or 5 times a power of ten, so that about `count` ticks fit. */
static double tick_step(range r, int count)
{
    double rough = (r.high - r.low) / count, power = pow(10.0, floor(log10(rough))), part = rough / power;
    return power * (part <= 1.0 ? 1.0 : part <= 2.0 ? 2.0 : part <= 5.0 ? 5.0 : 10.0);
}

static void tick_text(char *text, size_t size, double value, double step)
{
    if (fabs(value) < 1e-9 * step) value = 0.0;
    double largest = fmax(fabs(value), step);
    int decimals = (int)ceil(-log10(step) - 1e-9);
    if (largest >= 1e5 || step < 1e-4)
        snprintf(text, size, "%.3g", value);
    else
        snprintf(text, size, "%.*f", decimals < 0 ? 0 : decimals, value);
}

/* Text turned by a quarter to the left, for the vertical axis. */
static hg_status text_upwards(hg_image *image, int x, int y, int scale, const char *text)
{
    int length = hg_text_width(text, scale), height = 9 * scale;
    if (length == 0) return HG_OK;
    hg_image *flat;
    HG_TRY(hg_image_create(&flat, length, height, paper));
    hg_image_text(flat, 0, 0, scale, ink, text);
    for (int row = 0; row < height; row++)
        for (int column = 0; column < length; column++) {
            float dark = 1.0f - (float)(flat->rgb[3 * ((size_t)row * (size_t)length + (size_t)column)] - ink[0]) /
                                    (float)(paper[0] - ink[0]);
            hg_draw_pixel(image, x + row, y + length - 1 - column, ink, dark);
        }
    hg_image_destroy(flat);
    return HG_OK;
}

typedef struct {
    int left, top, width, height; /* of the field in pixels */
    range x, y;
} field;

/* A curve without a name has the colour of the named one before it. */
static const uint8_t *colour_of(const hg_curve *curves, int c)
{
    int number = -1;
    for (int i = 0; i <= c; i++) number += curves[i].name && curves[i].name[0];
    return curve_colour[number < 0 ? 0 : number % 8];
}

static double across(const field *f, double x) { return f->left + (x - f->x.low) / (f->x.high - f->x.low) * f->width; }

static double down(const field *f, double y)
{
    return f->top + f->height - (y - f->y.low) / (f->y.high - f->y.low) * f->height;
}

static void draw_x_axis(hg_image *image, const field *f, int scale)
{
    char text[32];
    const double step = tick_step(f->x, f->width / (60 * scale) + 1);
    const int64_t last = (int64_t)floor(f->x.high / step + 1e-9);
    for (int64_t i = (int64_t)ceil(f->x.low / step - 1e-9); i <= last; i++) {
        const double x = across(f, (double)i * step);
        hg_draw_line(image, x, f->top, x, f->top + f->height, 1.0, grid_colour);
        tick_text(text, sizeof text, (double)i * step, step);
        hg_image_text(image, (int)x - hg_text_width(text, scale) / 2, f->top + f->height + 4 * scale, scale, ink, text);
    }
}

static void draw_axes(hg_image *image, const field *f, int scale)
{
    char text[32];
    draw_x_axis(image, f, scale);
    const double step = tick_step(f->y, f->height / (40 * scale) + 1);
    const int64_t last = (int64_t)floor(f->y.high / step + 1e-9);
    for (int64_t i = (int64_t)ceil(f->y.low / step - 1e-9); i <= last; i++) {
        double y = down(f, (double)i * step);
        hg_draw_line(image, f->left, y, f->left + f->width, y, 1.0, grid_colour);
        tick_text(text, sizeof text, (double)i * step, step);
        hg_image_text(image, f->left - hg_text_width(text, scale) - 4 * scale, (int)y - 3 * scale, scale, ink, text);
    }
    double right = f->left + f->width, bottom = f->top + f->height;
    hg_draw_line(image, f->left, bottom, right, bottom, 1.5, ink);
    hg_draw_line(image, f->left, f->top, f->left, bottom, 1.5, ink);
}

/* Clips a line to the field (Liang and Barsky 1984), so that no curve leaves it. */
static bool clip(const field *f, double p[4])
{
    double from = 0.0, to = 1.0, dx = p[2] - p[0], dy = p[3] - p[1];
    double towards[4] = { -dx, dx, -dy, dy };
    double room[4] = { p[0] - f->left, f->left + f->width - p[0], p[1] - f->top, f->top + f->height - p[1] };
    for (int k = 0; k < 4; k++) {
        if (towards[k] == 0.0) {
            if (room[k] < 0.0) return false;
            continue;
        }
        double t = room[k] / towards[k];
        if (towards[k] < 0.0)
            from = fmax(from, t);
        else
            to = fmin(to, t);
    }
    if (from > to) return false;
    double x = p[0], y = p[1];
    p[0] = x + from * dx, p[1] = y + from * dy;
    p[2] = x + to * dx, p[3] = y + to * dy;
    return true;
}

static void draw_curve(hg_image *image, const field *f, const hg_curve *curve, int scale, const uint8_t rgb[3])
{
    if (curve->n == 1 && isfinite(curve->x[0]) && isfinite(curve->y[0])) {
        double x = across(f, curve->x[0]), y = down(f, curve->y[0]);
        hg_draw_line(image, x, y, x, y, 5.5 * scale, ink); /* a dark rim, to be seen on its own path */
        hg_draw_line(image, x, y, x, y, 4.0 * scale, rgb);
    }
    for (int64_t i = 0; i + 1 < curve->n; i++) {
        double p[4] = { across(f, curve->x[i]), down(f, curve->y[i]), across(f, curve->x[i + 1]),
                        down(f, curve->y[i + 1]) };
        if (!isfinite(p[0] + p[1] + p[2] + p[3])) continue;
        if (clip(f, p)) hg_draw_line(image, p[0], p[1], p[2], p[3], 1.1 * scale, rgb);
    }
}

/* How many points of the curves lie in a box. */
static int64_t points_in(const field *f, int n, const hg_curve *curves, int x, int y, int width, int height)
{
    int64_t count = 0;
    for (int c = 0; c < n; c++)
        for (int64_t i = 0; i < curves[c].n; i++) {
            double px = across(f, curves[c].x[i]) - x, py = down(f, curves[c].y[i]) - y;
            count += px > 0.0 && py > 0.0 && px < width && py < height;
        }
    return count;
}

/* In the corner where it hides least. */
static void draw_legend(hg_image *image, const field *f, int scale, int n, const hg_curve *curves)
{
    int widest = 0, rows = 0, line = 11 * scale;
    for (int c = 0; c < n; c++) {
        if (!curves[c].name || !curves[c].name[0]) continue;
        int width = hg_text_width(curves[c].name, scale);
        widest = width > widest ? width : widest;
        rows++;
    }
    if (rows == 0) return;
    int width = widest + 24 * scale, height = rows * line + 4 * scale, x = 0, y = 0;
    int64_t fewest = INT64_MAX;
    for (int corner = 0; corner < 4; corner++) {
        int left = corner & 1 ? f->left + 4 * scale : f->left + f->width - width - 4 * scale;
        int top = corner & 2 ? f->top + f->height - height - 4 * scale : f->top + 4 * scale;
        int64_t hidden = points_in(f, n, curves, left, top, width, height);
        if (hidden < fewest) fewest = hidden, x = left, y = top;
    }
    hg_draw_rectangle(image, x, y, width, height, paper, 0.85f);
    for (int c = 0, row = 0; c < n; c++) {
        if (!curves[c].name || !curves[c].name[0]) continue;
        int top = y + 4 * scale + line * row++;
        double middle = top + 3.5 * scale;
        hg_draw_line(image, x + 4 * scale, middle, x + 15 * scale, middle, 1.6 * scale, colour_of(curves, c));
        hg_image_text(image, x + 20 * scale, top, scale, ink, curves[c].name);
    }
}

/* Widens the shorter range until a unit is as long along both axes. */
static void equalise(field *f)
{
    double unit_x = (f->x.high - f->x.low) / f->width, unit_y = (f->y.high - f->y.low) / f->height;
    range *small = unit_x < unit_y ? &f->x : &f->y;
    double want = unit_x < unit_y ? unit_y * f->width : unit_x * f->height, middle = 0.5 * (small->low + small->high);
    *small = (range){ middle - 0.5 * want, middle + 0.5 * want };
}

hg_status hg_plot(hg_image *image, int x, int y, int width, int height, const char *title, const char *x_label,
                  const char *y_label, int n, const hg_curve *curves, bool equal_axes)
{
    int scale = width >= 420 && height >= 300 ? 2 : 1;
    field f = { .left = x + 42 * scale, .top = y + 20 * scale };
    f.width = width - 42 * scale - 10 * scale;
    f.height = height - 20 * scale - 30 * scale;
    if (f.width < 20 || f.height < 20)
        return hg_fail(HG_INVALID, "plot: %d x %d pixels are too few; 100 x 100 is the least", width, height);
    f.x = range_of(n, curves, false);
    f.y = range_of(n, curves, true);
    if (equal_axes) equalise(&f);
    hg_draw_rectangle(image, x, y, width, height, paper, 1.0f);
    draw_axes(image, &f, scale);
    for (int dots = 0; dots < 2; dots++) /* dots over lines */
        for (int c = 0; c < n; c++)
            if ((curves[c].n == 1) == (dots == 1)) draw_curve(image, &f, &curves[c], scale, colour_of(curves, c));
    draw_legend(image, &f, scale, n, curves);
    if (title) hg_image_text(image, x + (width - hg_text_width(title, scale)) / 2, y + 6 * scale, scale, ink, title);
    if (x_label)
        hg_image_text(image, f.left + (f.width - hg_text_width(x_label, scale)) / 2, y + height - 11 * scale, scale,
                      ink, x_label);
    if (y_label)
        HG_TRY(
            text_upwards(image, x + 3 * scale, f.top + (f.height - hg_text_width(y_label, scale)) / 2, scale, y_label));
    return HG_OK;
}

/* ---- bars -------------------------------------------------------------------------------------------------------- */

static int widest_of(int n, const char *const *names, int scale)
{
    int widest = 0;
    for (int i = 0; i < n; i++) {
        const int width = hg_text_width(names[i], scale);
        widest = width > widest ? width : widest;
    }
    return widest;
}

/* Above the field in a row, that ends at `right` at the latest. */
static void draw_bar_names(hg_image *image, const field *f, int y, int right, int scale, int n,
                           const char *const *names)
{
    int wide = 0;
    for (int k = 0; k < n; k++) wide += 18 * scale + hg_text_width(names[k], scale);
    int x = f->left + wide > right ? right - wide : f->left;
    for (int k = 0; k < n; k++) {
        hg_draw_rectangle(image, x, y, 7 * scale, 7 * scale, curve_colour[k % 8], 1.0f);
        hg_image_text(image, x + 10 * scale, y, scale, ink, names[k]);
        x += 18 * scale + hg_text_width(names[k], scale);
    }
}

hg_status hg_plot_bars(hg_image *image, int x, int y, int width, int height, const char *title, const char *label,
                       int n_groups, const char *const *groups, int n_bars, const char *const *bars,
                       const double *values, double limit)
{
    const int scale = width >= 420 && height >= 300 ? 2 : 1, names = widest_of(n_groups, groups, scale);
    field f = { .left = x + names + 10 * scale, .top = y + 34 * scale };
    f.width = width - names - 24 * scale;
    f.height = height - 34 * scale - 30 * scale;
    if (f.width < 20 || f.height < 4 * n_groups || n_groups < 1 || n_bars < 1)
        return hg_fail(HG_INVALID, "plot: %d x %d pixels are too few for %d groups of bars", width, height, n_groups);
    char text[32];
    f.x = (range){ 0, 0 };
    for (int i = 0; i < n_groups * n_bars; i++)
        if (isfinite(values[i])) {
            const double value = limit > 0 ? fmax(-limit, fmin(limit, values[i])) : values[i];
            f.x.low = fmin(f.x.low, value), f.x.high = fmax(f.x.high, value);
        }
    if (f.x.low == f.x.high) f.x.high = 1;
    const double margin = 0.05 * (f.x.high - f.x.low), row = (double)f.height / n_groups, thick = 0.8 * row / n_bars;
    if (f.x.low < 0) f.x.low -= margin;
    if (f.x.high > 0) f.x.high += margin;
    hg_draw_rectangle(image, x, y, width, height, paper, 1.0f);
    draw_x_axis(image, &f, scale);
    for (int g = 0; g < n_groups; g++) {
        const double top = f.top + row * g;
        hg_image_text(image, f.left - hg_text_width(groups[g], scale) - 5 * scale, (int)(top + 0.5 * row) - 4 * scale,
                      scale, ink, groups[g]);
        for (int k = 0; k < n_bars; k++) {
            const double value = values[g * n_bars + k], from = across(&f, 0),
                         to = across(&f, fmax(f.x.low, fmin(f.x.high, value)));
            if (!isfinite(value)) continue;
            hg_draw_rectangle(image, (int)fmin(from, to), (int)(top + 0.1 * row + thick * k),
                              (int)fabs(to - from) > 1 ? (int)fabs(to - from) : 1, (int)thick > 1 ? (int)thick : 1,
                              curve_colour[k % 8], 1.0f);
            if (value > f.x.high || value < f.x.low) { /* it goes on */
                snprintf(text, sizeof text, "%.3g", value);
                const int small = thick < 10 * scale ? 1 : scale, wide = hg_text_width(text, small);
                hg_image_text(image, value > 0 ? (int)to - wide - 3 * scale : (int)to + 3 * scale,
                              (int)(top + 0.1 * row + thick * (k + 0.5)) - 4 * small, small, paper, text);
            }
        }
    }
    hg_draw_line(image, across(&f, 0), f.top, across(&f, 0), f.top + f.height, 1.5, ink);
    draw_bar_names(image, &f, y + 20 * scale, x + width, scale, n_bars, bars);
    if (title) hg_image_text(image, x + (width - hg_text_width(title, scale)) / 2, y + 6 * scale, scale, ink, title);
    if (label)
        hg_image_text(image, f.left + (f.width - hg_text_width(label, scale)) / 2, y + height - 11 * scale, scale, ink,
                      label);
    return HG_OK;
}
