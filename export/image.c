/* Pictures: 8 bit sRGB, written as PNG by libpng; lines, boxes and text for captions and plots. */
#include "export/draw.h"

#include <math.h>
#include <png.h>
#include <setjmp.h>
#include <string.h>

#define LARGEST_SIDE 32768

hg_status hg_image_create(hg_image **image, int width, int height, const uint8_t rgb[3])
{
    *image = NULL;
    if (width < 1 || height < 1 || width > LARGEST_SIDE || height > LARGEST_SIDE)
        return hg_fail(HG_INVALID, "image: %d x %d pixels; each side has to be between 1 and %d", width, height,
                       LARGEST_SIDE);
    hg_image *made = hg_alloc(1, sizeof *made);
    if (!made) return HG_MEMORY;
    size_t pixels = (size_t)width * (size_t)height;
    made->width = width;
    made->height = height;
    made->rgb = hg_alloc(pixels, 3);
    if (!made->rgb) {
        hg_free(made);
        return HG_MEMORY;
    }
    if (rgb)
        for (size_t i = 0; i < pixels; i++) memcpy(made->rgb + 3 * i, rgb, 3);
    *image = made;
    return HG_OK;
}

void hg_image_destroy(hg_image *image)
{
    if (!image) return;
    hg_free(image->rgb);
    hg_free(image);
}

/* ---- colours ------------------------------------------------------------------------------------------------- */

/* IEC 61966-2-1. */
float hg_linear_from_srgb(uint8_t value)
{
    float v = (float)value / 255.0f;
    return v <= 0.04045f ? v / 12.92f : powf((v + 0.055f) / 1.055f, 2.4f);
}

uint8_t hg_srgb_from_linear(float value)
{
    if (!(value > 0.0f)) return 0;
    if (value >= 1.0f) return 255;
    float v = value <= 0.0031308f ? 12.92f * value : 1.055f * powf(value, 1.0f / 2.4f) - 0.055f;
    return (uint8_t)(v * 255.0f + 0.5f);
}

/* ---- PNG ----------------------------------------------------------------------------------------------------- */

typedef struct {
    uint8_t *bytes;
    size_t size, capacity;
} png_buffer;

/* The file is made in memory and then written under a temporary name and renamed, so that no half picture is left. */
static void buffer_write(png_structp png, png_bytep bytes, png_size_t size)
{
    png_buffer *buffer = png_get_io_ptr(png);
    if (size > buffer->capacity - buffer->size) {
        size_t capacity = 2 * (buffer->capacity + size);
        uint8_t *grown = hg_resize(buffer->bytes, buffer->capacity, capacity, 1);
        if (!grown) png_error(png, "out of memory");
        buffer->bytes = grown;
        buffer->capacity = capacity;
    }
    memcpy(buffer->bytes + buffer->size, bytes, size);
    buffer->size += size;
}

static void buffer_flush(png_structp png) { (void)png; }

static void say_nothing(png_structp png, png_const_charp text)
{
    (void)png;
    (void)text;
}

static hg_status encode(const hg_image *image, png_structp png, png_infop info, png_buffer *buffer)
{
    if (setjmp(png_jmpbuf(png))) return hg_fail(HG_MEMORY, "image: libpng could not compress the picture");
    png_set_write_fn(png, buffer, buffer_write, buffer_flush);
    png_set_IHDR(png, info, (png_uint_32)image->width, (png_uint_32)image->height, 8, PNG_COLOR_TYPE_RGB,
                 PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_set_sRGB(png, info, PNG_sRGB_INTENT_PERCEPTUAL);
    png_write_info(png, info);
    for (int y = 0; y < image->height; y++) png_write_row(png, image->rgb + 3 * (size_t)y * (size_t)image->width);
    png_write_end(png, info);
    return HG_OK;
}

hg_status hg_image_write_png(const hg_image *image, const char *path)
{
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, NULL, say_nothing);
    png_infop info = png ? png_create_info_struct(png) : NULL;
    if (!info) {
        png_destroy_write_struct(&png, NULL);
        return hg_fail(HG_MEMORY, "%s: libpng could not be started", path);
    }
    png_buffer buffer = { 0 };
    hg_status status = encode(image, png, info, &buffer);
    png_destroy_write_struct(&png, &info);
    if (status == HG_OK) status = hg_file_write(path, buffer.bytes, buffer.size);
    hg_free(buffer.bytes);
    return status;
}

/* ---- drawing ------------------------------------------------------------------------------------------------- */

void hg_image_paste(hg_image *to, const hg_image *from, int x, int y)
{
    int first = x < 0 ? -x : 0, last = from->width;
    if (last > to->width - x) last = to->width - x;
    if (first >= last) return;
    for (int row = 0; row < from->height; row++) {
        if (y + row < 0 || y + row >= to->height) continue;
        memcpy(to->rgb + 3 * ((size_t)(y + row) * (size_t)to->width + (size_t)(x + first)),
               from->rgb + 3 * ((size_t)row * (size_t)from->width + (size_t)first), 3 * (size_t)(last - first));
    }
}

void hg_draw_pixel(hg_image *image, int x, int y, const uint8_t rgb[3], float alpha)
{
    if (x < 0 || y < 0 || x >= image->width || y >= image->height || alpha <= 0.0f) return;
    uint8_t *pixel = image->rgb + 3 * ((size_t)y * (size_t)image->width + (size_t)x);
    if (alpha > 1.0f) alpha = 1.0f;
    for (int c = 0; c < 3; c++)
        pixel[c] = (uint8_t)((float)pixel[c] + alpha * ((float)rgb[c] - (float)pixel[c]) + 0.5f);
}

void hg_draw_rectangle(hg_image *image, int x, int y, int width, int height, const uint8_t rgb[3], float alpha)
{
    for (int row = y; row < y + height; row++)
        for (int column = x; column < x + width; column++) hg_draw_pixel(image, column, row, rgb, alpha);
}

static double clamped(double value, double low, double high) { return value < low ? low : value > high ? high : value; }

void hg_draw_line(hg_image *image, double x0, double y0, double x1, double y1, double width, const uint8_t rgb[3])
{
    if (!isfinite(x0) || !isfinite(y0) || !isfinite(x1) || !isfinite(y1)) return;
    double half = 0.5 * width, reach = half + 1.0;
    int left = (int)clamped(floor(fmin(x0, x1) - reach), 0, image->width);
    int right = (int)clamped(ceil(fmax(x0, x1) + reach), 0, image->width);
    int top = (int)clamped(floor(fmin(y0, y1) - reach), 0, image->height);
    int bottom = (int)clamped(ceil(fmax(y0, y1) + reach), 0, image->height);
    double dx = x1 - x0, dy = y1 - y0, square = dx * dx + dy * dy;
    for (int y = top; y < bottom; y++)
        for (int x = left; x < right; x++) {
            double px = x + 0.5 - x0, py = y + 0.5 - y0;
            double t = square > 0.0 ? clamped((px * dx + py * dy) / square, 0.0, 1.0) : 0.0;
            double distance = hypot(px - t * dx, py - t * dy);
            hg_draw_pixel(image, x, y, rgb, (float)clamped(half + 0.5 - distance, 0.0, 1.0));
        }
}

/* ---- text ---------------------------------------------------------------------------------------------------- */

static bool dot(const uint8_t *glyph, int x, int y)
{
    return x >= 0 && x < 5 && y >= 0 && y < 7 && (glyph[y] >> (4 - x) & 1);
}

/* How much of a point of a glyph is ink: neighbouring dots are joined by strokes with round ends, so that the letters
 * stay smooth at any size. x, y in dots, measured between dot centres. */
static float ink(const uint8_t *glyph, double x, double y, double half, double soft)
{
    static const int next[4][2] = { { 1, 0 }, { 0, 1 }, { 1, 1 }, { -1, 1 } };
    double nearest = 9.0;
    for (int row = (int)floor(y) - 1; row <= (int)floor(y) + 2; row++)
        for (int column = (int)floor(x) - 1; column <= (int)floor(x) + 2; column++) {
            if (!dot(glyph, column, row)) continue;
            nearest = fmin(nearest, hypot(x - column, y - row));
            for (int k = 0; k < 4; k++) {
                int dx = next[k][0], dy = next[k][1];
                if (!dot(glyph, column + dx, row + dy)) continue;
                /* a diagonal only where no corner dot joins the two already */
                if (dx && dy && (dot(glyph, column + dx, row) || dot(glyph, column, row + dy))) continue;
                double t = clamped(((x - column) * dx + (y - row) * dy) / (dx * dx + dy * dy), 0.0, 1.0);
                nearest = fmin(nearest, hypot(x - column - t * dx, y - row - t * dy));
            }
        }
    return (float)clamped((half - nearest) / soft + 0.5, 0.0, 1.0);
}

int hg_text_width(const char *text, int scale)
{
    int letters = (int)strlen(text);
    return letters ? (6 * letters - 1) * scale : 0;
}

void hg_image_text(hg_image *image, int x, int y, int scale, const uint8_t rgb[3], const char *text)
{
    if (scale < 1) scale = 1;
    double half = scale == 1 ? 0.5 : 0.42;
    for (int letter = 0; text[letter]; letter++) {
        const uint8_t *glyph = hg_glyph(text[letter]);
        int left = x + 6 * scale * letter, top = y + scale * hg_glyph_drop(text[letter]);
        for (int row = 0; row < 7 * scale; row++)
            for (int column = 0; column < 5 * scale; column++) {
                double px = (column + 0.5) / scale - 0.5, py = (row + 0.5) / scale - 0.5;
                float alpha = scale == 1 ? (float)dot(glyph, column, row) : ink(glyph, px, py, half, 1.0 / scale);
                hg_draw_pixel(image, left + column, top + row, rgb, alpha);
            }
    }
}
