/* Convolutions on the processor, as products: a block lays out what its outputs read of the input as columns (im2col), in its
 * cache, and multiplies. One way for f32, f64 and bf16, on the products that are there. Blocks depend on the sizes alone, and
 * each sums in its own order, so that the bits do not depend on threads:
 *
 *     forward      a band of outputs of one image, all channels of it or some: weight x columns
 *     to input     some channels of one image: weight^T x dy are columns, whose entries are added where they were read from
 *     to weight    some rows of the columns, for all images one after another: dy x columns^T */
#include "tensor/device.h"
#include "tensor/math.h"

#include <string.h>

enum { CACHED = 256 << 10, BLOCKS = 16, FEW = 256 }; /* elements of a block's columns; blocks that keep cores busy */

typedef struct {
    hg_convolution sizes;
    hg_dtype dtype;        /* of the factors */
    size_t size, out_size; /* bytes of an element of the factors and of the result */
    int64_t k, pixels;     /* rows and columns of an image's columns */
    int64_t taps;          /* of a kernel */
    int64_t length, count; /* of outputs in a band, of bands */
    int64_t chunk, chunks; /* of channels, or of rows of the columns */
    const char *x, *weight, *dy;
    const void *bias;
    char *out, *scratch;
    size_t scratch_size; /* of a thread */
    bool add, direct;    /* the image itself is its columns */
} convolve_args;

static int64_t divide_up(int64_t a, int64_t b) { return (a + b - 1) / b; }
static int64_t within(int64_t x, int64_t low, int64_t high) { return x < low ? low : x > high ? high : x; }

/* ---- columns ---- */

#define STRIDED(TYPE_)                                                                                                 \
    for (int64_t i = 0; i < n; i++) ((TYPE_ *)to)[i] = ((const TYPE_ *)from)[i * stride]

static void copy_strided(size_t size, int64_t n, const void *from, int64_t stride, void *to)
{
    if (stride == 1)
        memcpy(to, from, (size_t)n * size);
    else if (size == 2)
        STRIDED(uint16_t);
    else if (size == 4)
        STRIDED(float);
    else
        STRIDED(double);
}

/* The outputs of a row, from first to last, that read inside of the input's row at tap v: [*begin, *end). */
static void inside(const hg_convolution *s, int64_t v, int64_t first, int64_t last, int64_t *begin, int64_t *end)
{
    *begin = v >= s->padding ? 0 : divide_up(s->padding - v, s->stride);
    *end = s->width + s->padding > v ? divide_up(s->width + s->padding - v, s->stride) : 0;
    *begin = within(*begin, first, last);
    *end = within(*end, *begin, last);
}

/* Rows first .. last of the columns of an image, for its outputs from .. to. */
static void lay_out(const convolve_args *p, const char *image, int64_t first, int64_t last, int64_t from, int64_t to,
                    char *columns)
{
    const hg_convolution *s = &p->sizes;
    const size_t size = p->size;
    for (int64_t row = first; row < last; row++) {
        const int64_t c = row / p->taps, u = row % p->taps / s->kernel_width, v = row % s->kernel_width;
        const char *plane = image + (size_t)(c * s->height * s->width) * size;
        for (int64_t pixel = from; pixel < to;) {
            const int64_t i = pixel / s->out_width, j = pixel % s->out_width;
            const int64_t end = s->out_width - j < to - pixel ? s->out_width : j + to - pixel,
                          y = i * s->stride + u - s->padding;
            int64_t begin_in = end, end_in = end;
            if (y >= 0 && y < s->height) inside(s, v, j, end, &begin_in, &end_in);
            memset(columns, 0, (size_t)(begin_in - j) * size);
            if (end_in > begin_in)
                copy_strided(size, end_in - begin_in,
                             plane + (size_t)(y * s->width + begin_in * s->stride + v - s->padding) * size, s->stride,
                             columns + (size_t)(begin_in - j) * size);
            memset(columns + (size_t)(end_in - j) * size, 0, (size_t)(end - end_in) * size);
            columns += (size_t)(end - j) * size;
            pixel += end - j;
        }
    }
}

#define PUT_BACK(TYPE_)                                                                                                \
    do {                                                                                                               \
        TYPE_ *to = (TYPE_ *)image + c * s->height * s->width;                                                         \
        const TYPE_ *from = (const TYPE_ *)columns + (c - first) * p->taps * p->pixels;                                \
        if (!p->add) memset(to, 0, (size_t)(s->height * s->width) * sizeof *to);                                       \
        for (int64_t u = 0; u < s->kernel_height; u++)                                                                 \
            for (int64_t v = 0; v < s->kernel_width; v++)                                                              \
                for (int64_t i = 0; i < s->out_height; i++, from += s->out_width) {                                    \
                    const int64_t y = i * s->stride + u - s->padding;                                                  \
                    int64_t begin, end;                                                                                \
                    if (y < 0 || y >= s->height) continue;                                                             \
                    inside(s, v, 0, s->out_width, &begin, &end);                                                       \
                    TYPE_ *restrict row = to + y * s->width + v - s->padding;                                          \
                    if (s->stride == 1)                                                                                \
                        for (int64_t j = begin; j < end; j++) row[j] += from[j];                                       \
                    else                                                                                               \
                        for (int64_t j = begin; j < end; j++) row[j * s->stride] += from[j];                           \
                }                                                                                                      \
    } while (0)

/* Channels first .. last of an image from the gradients of their columns. */
static void put_back(const convolve_args *p, const char *columns, int64_t first, int64_t last, char *image)
{
    const hg_convolution *s = &p->sizes;
    for (int64_t c = first; c < last; c++) {
        if (p->out_size == 4)
            PUT_BACK(float);
        else
            PUT_BACK(double);
    }
}

/* ---- blocks ---- */

static void add_bias(const convolve_args *p, int64_t channel, int64_t n, char *row)
{
    if (p->out_size == 4) {
        const float bias = ((const float *)p->bias)[channel];
        for (int64_t i = 0; i < n; i++) ((float *)(void *)row)[i] += bias;
    } else {
        const double bias = ((const double *)p->bias)[channel];
        for (int64_t i = 0; i < n; i++) ((double *)(void *)row)[i] += bias;
    }
}

static char *scratch_of(const convolve_args *p) { return p->scratch + (size_t)hg_worker() * p->scratch_size; }

static void forward_cpu(const void *memory, int64_t first, int64_t last)
{
    const convolve_args *p = memory;
    const hg_convolution *s = &p->sizes;
    for (int64_t block = first; block < last; block++) {
        const int64_t chunk = block % p->chunks, band = block / p->chunks % p->count, b = block / p->chunks / p->count;
        const int64_t from = band * p->length, to = within(from + p->length, 0, p->pixels), n = to - from;
        const int64_t o = chunk * p->chunk, rows = within(s->out - o, 0, p->chunk);
        const char *image = p->x + (size_t)(b * s->in * s->height * s->width) * p->size, *columns = scratch_of(p);
        char *out = p->out + (size_t)((b * s->out + o) * p->pixels + from) * p->out_size;
        if (p->direct)
            columns = image + (size_t)from * p->size;
        else
            lay_out(p, image, 0, p->k, from, to, scratch_of(p));
        hg_product_here(p->dtype, false, false, rows, n, p->k, 1, p->weight + (size_t)(o * p->k) * p->size, p->k,
                        columns, p->direct ? p->pixels : n, 0, out, p->pixels);
        if (p->bias)
            for (int64_t r = 0; r < rows; r++) add_bias(p, o + r, n, out + (size_t)(r * p->pixels) * p->out_size);
    }
}

static void to_input_cpu(const void *memory, int64_t first, int64_t last)
{
    const convolve_args *p = memory;
    const hg_convolution *s = &p->sizes;
    for (int64_t block = first; block < last; block++) {
        const int64_t b = block / p->chunks, c = block % p->chunks * p->chunk, end = within(c + p->chunk, 0, s->in);
        const int64_t plane = s->height * s->width;
        char *image = p->out + (size_t)(b * s->in * plane) * p->out_size, *columns = scratch_of(p);
        if (p->direct) columns = image + (size_t)(c * plane) * p->out_size;
        hg_product_here(p->dtype, true, false, (end - c) * p->taps, p->pixels, s->out, 1,
                        p->weight + (size_t)(c * p->taps) * p->size, p->k,
                        p->dy + (size_t)(b * s->out * p->pixels) * p->size, p->pixels, p->direct && p->add ? 1 : 0,
                        columns, p->pixels);
        if (!p->direct) put_back(p, columns, c, end, image);
    }
}

static void to_weight_cpu(const void *memory, int64_t first, int64_t last)
{
    const convolve_args *p = memory;
    const hg_convolution *s = &p->sizes;
    for (int64_t block = first; block < last; block++) {
        const int64_t row = block * p->chunk, rows = within(p->k - row, 0, p->chunk);
        for (int64_t b = 0; b < s->batch; b++) {
            const char *image = p->x + (size_t)(b * s->in * s->height * s->width) * p->size;
            for (int64_t from = 0; from < p->pixels; from += p->length) {
                const int64_t to = within(from + p->length, 0, p->pixels), n = to - from;
                const char *columns = scratch_of(p);
                if (p->direct)
                    columns = image + (size_t)(row * p->pixels + from) * p->size;
                else
                    lay_out(p, image, row, row + rows, from, to, scratch_of(p));
                hg_product_here(p->dtype, false, true, s->out, rows, n, 1,
                                p->dy + (size_t)(b * s->out * p->pixels + from) * p->size, p->pixels, columns,
                                p->direct ? p->pixels : n, p->add || b > 0 || from > 0 ? 1 : 0,
                                p->out + (size_t)row * p->out_size, p->k);
            }
        }
    }
}

/* ---- how it is cut ---- */

/* Few outputs are not worth the rounding of the weights. */
static bool in_bf16(const hg_convolve_call *call)
{
    const hg_convolution *s = call->sizes;
    return call->dtype == HG_F32 && call->compute == HG_BF16 && s->batch * s->out_height * s->out_width > FEW;
}

static convolve_args plan(const hg_convolve_call *call)
{
    const hg_convolution *s = call->sizes;
    convolve_args p = { .sizes = *s,
                        .dtype = in_bf16(call) ? HG_BF16 : call->dtype,
                        .out_size = hg_dtype_size(call->dtype),
                        .taps = s->kernel_height * s->kernel_width,
                        .pixels = s->out_height * s->out_width,
                        .add = call->add };
    p.k = s->in * p.taps;
    p.size = hg_dtype_size(p.dtype);
    p.direct = p.taps == 1 && s->stride == 1 && s->padding == 0;
    if (call->which == HG_CONVOLVE) {
        p.length = within(CACHED / p.k / 16 * 16, 64, 1024);
        p.count = divide_up(p.pixels, p.length);
        p.chunk = within(divide_up(s->out * s->batch * p.count, BLOCKS), 64, s->out > 64 ? s->out : 64);
        p.chunks = divide_up(s->out, p.chunk);
        p.scratch_size = (size_t)(p.k * (p.length < p.pixels ? p.length : p.pixels)) * p.size;
    } else if (call->which == HG_CONVOLVE_TO_INPUT) {
        p.chunk = within(CACHED / (p.taps * p.pixels), 1, divide_up(s->in * s->batch, BLOCKS));
        p.chunks = divide_up(s->in, p.chunk);
        p.scratch_size = (size_t)(p.chunk * p.taps * p.pixels) * p.out_size;
    } else {
        p.chunk = within(divide_up(p.k, 2 * BLOCKS * 16) * 16, 64, 512);
        p.chunks = divide_up(p.k, p.chunk);
        p.length = within(CACHED / p.chunk / 16 * 16, 64, 4096);
        p.scratch_size = (size_t)(p.chunk * (p.length < p.pixels ? p.length : p.pixels)) * p.size;
    }
    if (p.direct) p.scratch_size = 0;
    p.scratch_size = (p.scratch_size + 63) / 64 * 64;
    return p;
}

static size_t x_count(const hg_convolution *s) { return (size_t)(s->batch * s->in * s->height * s->width); }
static size_t y_count(const hg_convolution *s) { return (size_t)(s->batch * s->out * s->out_height * s->out_width); }

hg_status hg_cpu_convolve_workspace(hg_device *device, int threads, const hg_convolve_call *call, size_t *bytes)
{
    (void)device;
    const convolve_args p = plan(call);
    *bytes = (size_t)threads * p.scratch_size;
    if (p.dtype != HG_BF16) return HG_OK;
    const size_t weights = (size_t)(call->sizes->out * p.k), x = x_count(call->sizes), y = y_count(call->sizes);
    *bytes += 2 * (call->which == HG_CONVOLVE            ? x + weights
                   : call->which == HG_CONVOLVE_TO_INPUT ? y + weights
                                                         : x + y) +
              3 * 64;
    return HG_OK;
}

/* ---- factors in bf16 ---- */

typedef struct {
    const float *from;
    uint16_t *to;
} round_args;

static void round_cpu(const void *memory, int64_t first, int64_t last)
{
    const round_args *p = memory;
    hg_bf16_of_f32(last - first, p->from + first, p->to + first);
}

/* `from` as bf16 at *place, which moves behind it. */
static hg_status round_factor(hg_device *device, int threads, size_t count, const char **from, char **place)
{
    static const hg_kernel kernel = {
        .name = "convolve", .args_size = sizeof(round_args), .cpu = round_cpu, .block = 16384
    };
    const round_args args = { (const float *)(const void *)*from, (uint16_t *)(void *)*place };
    *from = *place;
    *place += (count * sizeof(uint16_t) + 63) / 64 * 64;
    return hg_cpu_launch(device, threads, &kernel, (int64_t)count, &args);
}

hg_status hg_cpu_convolve(hg_device *device, int threads, const hg_convolve_call *call, void *workspace)
{
    static const hg_kernel kernels[] = {
        [HG_CONVOLVE] = { .name = "convolve", .args_size = sizeof(convolve_args), .cpu = forward_cpu, .block = 1 },
        [HG_CONVOLVE_TO_INPUT] = { .name = "convolve",
                                   .args_size = sizeof(convolve_args),
                                   .cpu = to_input_cpu,
                                   .block = 1 },
        [HG_CONVOLVE_TO_WEIGHT] = { .name = "convolve",
                                    .args_size = sizeof(convolve_args),
                                    .cpu = to_weight_cpu,
                                    .block = 1 },
    };
    convolve_args p = plan(call);
    const hg_convolution *s = call->sizes;
    p.x = call->x, p.weight = call->weight, p.dy = call->y, p.bias = call->bias;
    p.out = call->which == HG_CONVOLVE ? call->y : call->which == HG_CONVOLVE_TO_INPUT ? call->x : call->weight;
    p.scratch = workspace;
    if (p.dtype == HG_BF16) {
        char *place = p.scratch + (size_t)threads * p.scratch_size;
        if (call->which != HG_CONVOLVE_TO_INPUT) HG_TRY(round_factor(device, threads, x_count(s), &p.x, &place));
        if (call->which != HG_CONVOLVE_TO_WEIGHT)
            HG_TRY(round_factor(device, threads, (size_t)(s->out * p.k), &p.weight, &place));
        if (call->which != HG_CONVOLVE) HG_TRY(round_factor(device, threads, y_count(s), &p.dy, &place));
    }
    const int64_t blocks = call->which == HG_CONVOLVE            ? s->batch * p.count * p.chunks
                           : call->which == HG_CONVOLVE_TO_INPUT ? s->batch * p.chunks
                                                                 : p.chunks;
    return hg_cpu_launch(device, threads, &kernels[call->which], blocks, &p);
}
