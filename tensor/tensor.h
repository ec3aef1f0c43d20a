/* tensor: memory, shapes, devices and kernel launch. Knows nothing of gradients, except one opaque slot for them.
 *
 * A tensor is contiguous and row-major, with up to 6 axes, on one device. A context (hg_ctx) owns the device, an
 * arena for everything made in a step, the seed and the first error.
 *
 *     hg_ctx *ctx;
 *     hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .seed = 1 });
 *     hg_tensor *x = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 3, 4 });     lives until hg_step_reset
 *     hg_tensor *w = hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ 4, 2 });   lives until hg_tensor_destroy
 *     ...
 *     hg_step_reset(ctx);
 *     hg_tensor_destroy(w);
 *     hg_ctx_destroy(ctx);
 *
 * Sticky errors. Calls that return hg_tensor * return NULL after an error and accept NULL, so that a formula is checked
 * once, at its end, with hg_ctx_status. The first error wins and names op, shapes and the caller's file and line.
 *
 * Determinism. hg_launch cuts [0, n) into blocks that depend on n alone, never on the number of threads; sums are added
 * in the order of blocks. The same work gives the same bits with 1 and with 64 threads.
 *
 * Data pointers: on the CPU `data` may be read and written directly. Code that runs on any device goes through
 * hg_tensor_read / hg_tensor_write, hg_launch and hg_product.
 */
#ifndef HG_TENSOR_H
#define HG_TENSOR_H

#include "base/base.h"

#ifdef __cplusplus
extern "C" {
#endif

#define HG_MAX_RANK 6

typedef struct hg_ctx hg_ctx;

typedef struct hg_tensor {
    void    *data;
    hg_ctx  *ctx;
    int64_t  shape[HG_MAX_RANK];   /* axes beyond rank are 1 */
    int      rank;                 /* 0 is a scalar: one element */
    hg_dtype dtype;
    uint32_t version;              /* grows whenever the data is overwritten: hg_tensor_touch */
    bool     owned;                /* by the caller (hg_tensor_create), not by the step arena */
    const char *name;              /* for messages, checkpoints and export; NULL or kept alive by whoever set it */
    struct hg_tensor *base;        /* what a view looks into, NULL for a tensor of its own */
    void    *tape;                 /* autograd's own */
} hg_tensor;

/* ---- context ------------------------------------------------------------------------------------------------ */

/* threads 0: all cores. device NULL or "cpu"; "cuda" or "cuda:1"; "auto": cuda where it works, else cpu. */
typedef struct { int threads; uint64_t seed; const char *device; } hg_ctx_options;

/* Tensors that the caller owns are destroyed before their context. */
hg_status   hg_ctx_create(hg_ctx **ctx, const hg_ctx_options *options);
void        hg_ctx_destroy(hg_ctx *ctx);
hg_status   hg_ctx_status(const hg_ctx *ctx);                    /* the first error since hg_ctx_clear; HG_OK when none */
const char *hg_ctx_message(const hg_ctx *ctx);                   /* its sentence */
void        hg_ctx_clear(hg_ctx *ctx);                           /* forget the error */
hg_status   hg_ctx_fail(hg_ctx *ctx, hg_status status, const char *format, ...) HG_PRINTF(3, 4); /* first one wins; also sets hg_message */
uint64_t    hg_ctx_seed(const hg_ctx *ctx);
int         hg_ctx_threads(const hg_ctx *ctx);
const char *hg_ctx_device(const hg_ctx *ctx);                    /* "cpu", "cuda" */
const char *hg_ctx_device_what(const hg_ctx *ctx);               /* which one: "NVIDIA A100, compute capability 8.0"; "" on the cpu */
bool        hg_ctx_host(const hg_ctx *ctx);                      /* may `data` be read and written by the processor? */
/* For work on arrays of the host, such as scenes and files: ctx itself, or a context of the processor beside it, which is made at
 * the first call and goes with it. NULL sets the error. */
hg_ctx     *hg_ctx_on_host(hg_ctx *ctx);
/* In what the factors of a layer's products (hg_linear of more than 256 rows and hg_conv2d, forward and both gradients) are rounded:
 * HG_F32 (default), HG_BF16 or HG_TF32, summed in f32 in any case; tensors, weights and everything else stay f32. On cuda it
 * holds for every f32 hg_product and convolution. HG_UNSUPPORTED where the processor has no bf16 instructions, and for HG_TF32
 * on the cpu: then it stays as it was. */
hg_status   hg_ctx_compute(hg_ctx *ctx, hg_dtype dtype);
hg_dtype    hg_ctx_compute_dtype(const hg_ctx *ctx);
void      **hg_ctx_tape(hg_ctx *ctx);                            /* autograd's slot */

/* Remembers the caller for messages: #define hg_add(ctx, a, b) (hg_add)(hg_at(ctx, __FILE__, __LINE__), a, b) */
hg_ctx *hg_at(hg_ctx *ctx, const char *file, int line);
const char *hg_ctx_caller(const hg_ctx *ctx, int *line);

/* ---- devices ------------------------------------------------------------------------------------------------ */

/* What there is, cpu first; memory in bytes, 0: not known. A device that cannot be used is listed too, with the reason; nothing is started that was not. */
typedef struct { char name[16], what[128], versions[256], why[256]; /* why not, one sentence; "" where it works */ size_t memory, free; } hg_device_info;
int       hg_devices(hg_device_info *infos, int room);           /* how many there are */
hg_status hg_ctx_wait(hg_ctx *ctx);                              /* until all that was launched is done; errors of it come out here */

/* Between these two, launches, products and copies are not run but kept, and run at the end; when they are the same as those
 * of the last time (kernels, sizes, arguments), they are replayed as one. Reading a tensor in between runs what was kept so far.
 * A device that has no such thing (cpu) runs everything at once. */
hg_status hg_step_record(hg_ctx *ctx);
hg_status hg_step_run(hg_ctx *ctx);

/* Of the context since it was made: kernels and library calls, replays of a whole step, times that the host waited for the device
 * inside of a record, and bytes to and from the host. Zero on the cpu but for launches. */
typedef struct { int64_t launches, replays, waits, uploaded, downloaded; } hg_device_counts;
hg_device_counts hg_ctx_counts(const hg_ctx *ctx);

/* ---- step arena --------------------------------------------------------------------------------------------- */

void  *hg_step_alloc(hg_ctx *ctx, size_t bytes);                 /* of the host; 64-byte aligned, not zeroed, gone at hg_step_reset; NULL sets the error */
void  *hg_step_device(hg_ctx *ctx, size_t bytes);                /* the same in the device's memory, for what kernels read and write */
void   hg_step_reset(hg_ctx *ctx);                               /* everything made in the step is gone; memory is kept for the next */
size_t hg_step_bytes(const hg_ctx *ctx);                         /* in use now */
size_t hg_step_high_water(const hg_ctx *ctx);                    /* most ever in use */
size_t hg_step_reserved(const hg_ctx *ctx);                      /* taken from the system; constant in the steady state */
void   hg_ctx_on_reset(hg_ctx *ctx, void (*call)(hg_ctx *));      /* autograd drops its tape here; up to 8 calls, each once */
void   hg_ctx_on_destroy(hg_ctx *ctx, void (*call)(hg_ctx *));    /* before the context's memory goes */
void   hg_ctx_on_tensor_destroy(hg_ctx *ctx, void (*call)(hg_tensor *)); /* autograd frees a leaf's gradient here */
/* Scratch with a scope: everything made after the mark is gone at the rewind, and the memory is used again. */
typedef struct { int chunk[2]; size_t used[2]; } hg_step_mark;
hg_step_mark hg_step_set_mark(const hg_ctx *ctx);
void   hg_step_rewind(hg_ctx *ctx, hg_step_mark mark);
/* Guards: with them on, every allocation of the step has a pattern before and behind it; hg_step_check says whether
 * anything wrote outside. Takes effect at the next hg_step_reset. */
void      hg_step_guard(hg_ctx *ctx, bool on);
hg_status hg_step_check(hg_ctx *ctx);

/* ---- tensors ------------------------------------------------------------------------------------------------ */

hg_tensor *hg_tensor_make(hg_ctx *ctx, hg_dtype dtype, int rank, const int64_t *shape);    /* in the step arena, not zeroed */
hg_tensor *hg_tensor_create(hg_ctx *ctx, hg_dtype dtype, int rank, const int64_t *shape);  /* the caller's, zeroed; hg_tensor_destroy */
hg_tensor *hg_tensor_wrap(hg_ctx *ctx, hg_dtype dtype, int rank, const int64_t *shape, void *data); /* step tensor over the caller's device memory */
hg_tensor *hg_tensor_from(hg_ctx *ctx, hg_dtype dtype, int rank, const int64_t *shape, const void *host); /* step tensor of the host's numbers, which stay as they are until the step is over: not copied on the cpu */
void       hg_tensor_destroy(hg_tensor *tensor);                 /* NULL is fine */
int64_t    hg_tensor_count(const hg_tensor *tensor);             /* elements */
size_t     hg_tensor_bytes(const hg_tensor *tensor);
hg_tensor *hg_tensor_rows(hg_ctx *ctx, hg_tensor *tensor, int64_t first, int64_t count); /* view along axis 0, without gradient */
void       hg_tensor_touch(hg_tensor *tensor);                   /* call after overwriting data by hand */
hg_status  hg_tensor_write(hg_tensor *tensor, const void *from); /* host -> device, all bytes; touches */
hg_status  hg_tensor_read(const hg_tensor *tensor, void *to);    /* device -> host */
hg_status  hg_tensor_fill(hg_tensor *tensor, double value);
hg_status  hg_tensor_copy(hg_tensor *to, const hg_tensor *from); /* same count; converts dtype */
hg_status  hg_tensor_numbers(const hg_tensor *tensor, double *to); /* all elements as doubles on the host, any dtype */
double     hg_tensor_item(const hg_tensor *tensor, int64_t i);   /* one element as double, any dtype; NAN outside */
const char *hg_shape_text(const hg_tensor *tensor, char text[96]); /* "f32 [3,4]" */

/* ---- kernels ------------------------------------------------------------------------------------------------ */

/* One body over an index range; tensor/kernel.h makes one from a text that both the processor and a GPU understand. `block` is
 * how many indices one block of the processor takes (0: 4096); it is part of the result where a kernel reduces, and never
 * depends on threads. For a GPU: `cuda` is the name of a *.kernel.h that the library carries (any path that ends in it), or a
 * text of its own; the function in it is `name`_cuda(args, int64_t n). NULL: the kernel is the processor's only. */
typedef struct {
    const char *name, *cuda;
    size_t args_size;
    void (*cpu)(const void *args, int64_t first, int64_t last); /* NULL: the GPU's only */
    int64_t block;
    int threads;   /* of a block of the GPU, 0: 256 */
    int indices;   /* that a block of the GPU takes; 0: one for each of its threads */
    size_t shared; /* dynamic shared memory of a block of the GPU, bytes */
    void (*clear)(void *args); /* zeroes the padding of args, which has to be the same from step to step; NULL: there is none */
} hg_kernel;

hg_status hg_launch(hg_ctx *ctx, const hg_kernel *kernel, int64_t n, const void *args);
bool      hg_launches(const hg_ctx *ctx, const hg_kernel *kernel); /* has it a body for the context's device? */
void      hg_kernel_release(hg_ctx *ctx, const hg_kernel *kernel); /* before a kernel that is not static, or its text, goes; a device knows it by its address */

/* C = alpha op(A) op(B) + beta C, row-major; op(A) is [m,k], op(B) is [k,n]; ld = elements from row to row as stored.
 * f32 through oneDNN single-threaded on fixed blocks, f64 by plain loops. Sums over k are cut in fixed chunks. */
hg_status hg_product(hg_ctx *ctx, hg_dtype dtype, bool transpose_a, bool transpose_b, int64_t m, int64_t n, int64_t k,
                     double alpha, const void *a, int64_t lda, const void *b, int64_t ldb, double beta, void *c, int64_t ldc);

/* Convolutions of images, as networks have them: y[b,o,i,j] = bias[o] + sum over c,u,v of weight[o,c,u,v] x[b,c, stride i + u -
 * padding, stride j + v - padding], x being zero outside. All arrays packed, in the order of their indices; at least one channel,
 * tap and output; any batch. f32 and f64, factors as hg_ctx_compute says: on the cpu in f32 where an output channel has up to 256
 * elements in the batch, and on cuda the results of bf16 are rounded to it too. Products over blocks of columns on the cpu, cuDNN
 * on cuda: HG_UNSUPPORTED where that is not installed. */
typedef struct { int64_t batch, in, height, width, out, kernel_height, kernel_width, stride, padding, out_height, out_width; } hg_convolution;
hg_status hg_convolve(hg_ctx *ctx, hg_dtype dtype, const hg_convolution *sizes, const void *x, const void *weight, const void *bias, void *y); /* bias NULL: none */
/* Their gradients: dx or dweight = or += (add) what dy makes of it. */
hg_status hg_convolve_to_input(hg_ctx *ctx, hg_dtype dtype, const hg_convolution *sizes, const void *weight, const void *dy, bool add, void *dx);
hg_status hg_convolve_to_weight(hg_ctx *ctx, hg_dtype dtype, const hg_convolution *sizes, const void *x, const void *dy, bool add, void *dweight);

/* Inside a kernel's cpu body: the same product on the calling thread alone, f32 and f64 (nothing else is asked for).
 * HG_BF16: A and B are bf16, C is f32, alpha is 1 and beta 0 or 1. */
void hg_product_here(hg_dtype dtype, bool transpose_a, bool transpose_b, int64_t m, int64_t n, int64_t k,
                     double alpha, const void *a, int64_t lda, const void *b, int64_t ldb, double beta, void *c, int64_t ldc);
int  hg_worker(void);                                            /* inside a kernel: which of hg_ctx_threads() is running, for scratch */

/* ---- profile ------------------------------------------------------------------------------------------------ */

/* Scopes with a group ("forward") and a name ("linear"), inside each other; nothing is counted unless it was started. Ops,
 * passes of the physics, body, neighbours, sampling and optimiser have one. Begin and end on the calling thread, outside of
 * kernels; both strings are kept by pointer. While a profile is taken a step is not recorded (hg_step_record), and a device is
 * waited for at both ends of a scope.
 *
 *     hg_profile_start(ctx, 20);
 *     for (int step = 0; step < 20; step++) { ... hg_profile_step(ctx); }
 *     n = hg_profile_read(ctx, &seconds, &rows);                                                                         */
typedef struct { const char *group, *name; double calls, bytes, launches; /* of a step; launches: of a device, without the scopes inside */ double own, total; /* seconds, medians of the steps; own: without the scopes inside */ } hg_profile_row;
typedef struct hg_profile hg_profile;
hg_status hg_profile_start(hg_ctx *ctx, int steps);              /* room for so many steps, later ones are not kept */
void      hg_profile_stop(hg_ctx *ctx);                          /* frees what was counted */
bool      hg_profiling(const hg_ctx *ctx);
void      hg_profile_begin(hg_ctx *ctx, const char *group, const char *name);
void      hg_profile_end(hg_ctx *ctx, int64_t bytes);            /* bytes read and written, as far as they are known */
void      hg_profile_step(hg_ctx *ctx);                          /* a step is over */
int       hg_profile_read(hg_ctx *ctx, double *step_seconds, const hg_profile_row **rows); /* largest own first; once, good until the stop */

/* Measured at the call, on all threads, in a few tenths of a second: f32 operations (a multiply-add is two) and bytes
 * copied (read and written), per second. */
hg_status hg_machine_limits(hg_ctx *ctx, double *operations, double *bytes);

uint16_t hg_bf16_from_f32(float x);                              /* round to nearest even, NaN stays NaN */
float    hg_f32_from_bf16(uint16_t x);

#ifdef __cplusplus
}
#endif
#endif
