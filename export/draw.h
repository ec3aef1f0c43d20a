/* Drawing on an hg_image, shared by text, plots and the renderer. Private to export/. */
#ifndef HG_EXPORT_DRAW_H
#define HG_EXPORT_DRAW_H

#include "export/export.h"

float hg_linear_from_srgb(uint8_t value);
uint8_t hg_srgb_from_linear(float value);

/* Mixes rgb into a pixel, alpha in [0,1]; outside the picture nothing happens. */
void hg_draw_pixel(hg_image *image, int x, int y, const uint8_t rgb[3], float alpha);
/* An anti-aliased line with round ends; coordinates in pixels, (0,0) the upper left corner of the picture. */
void hg_draw_line(hg_image *image, double x0, double y0, double x1, double y1, double width, const uint8_t rgb[3]);
void hg_draw_rectangle(hg_image *image, int x, int y, int width, int height, const uint8_t rgb[3], float alpha);
/* Width of a text in pixels; a line of text is 7 * scale high above its baseline and 2 * scale below. */
int hg_text_width(const char *text, int scale);

/* A 5 x 7 glyph: seven rows from the top, bit 4 the leftmost column. */
const uint8_t *hg_glyph(char character);
int hg_glyph_drop(char character); /* rows that it stands lower */

#endif
