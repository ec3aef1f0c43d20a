/* autograd: the tape, the ops, and the check that a gradient is right.
 *
 * Define by run: every op call on a tensor that needs a gradient is recorded on the context's tape; hg_backward walks
 * it in reverse. Everything recorded lives in the step arena.
 *
 *     hg_tensor *w = hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ 4, 2 });
 *     hg_require_grad(w);
 *     hg_tensor *loss = hg_sum(ctx, hg_square(ctx, hg_matmul(ctx, x, w)));
 *     hg_status s = hg_backward(ctx, loss);
 *     hg_tensor *dw = hg_grad(w);                 [4,2], owned by w
 *     hg_step_reset(ctx);
 *
 * Contract: a backward adds (+=) into the gradients of its inputs; hg_backward first zeroes every gradient on the tape,
 * so that calling it twice gives the same numbers. Gradients are zero at the kinks where an op says so (the norm of a
 * zero vector; ties of min/max go to the first argument). A tensor overwritten after it was saved for the backward
 * pass is an error that names both ops.
 *
 * An op is one constant struct in one file (forward, backward, shape rule, samples for the tests, ONNX emitter),
 * registered by HG_OP. Names, dispatch, documentation, export and tests all come from it.
 */
#ifndef HG_AUTOGRAD_H
#define HG_AUTOGRAD_H

#include "tensor/tensor.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- tape --------------------------------------------------------------------------------------------------- */

hg_status  hg_require_grad(hg_tensor *leaf);                     /* an owned tensor, or one made in this step; its gradient is allocated with it */
hg_tensor *hg_grad(const hg_tensor *tensor);                     /* NULL when it has none (yet) */
bool       hg_needs_grad(const hg_tensor *tensor);
hg_status  hg_backward(hg_ctx *ctx, hg_tensor *loss);            /* loss: one element; seed 1 */
hg_status  hg_backward_seeded(hg_ctx *ctx, hg_tensor *out, const hg_tensor *seed); /* any shape, for checks */
hg_tensor *hg_detach(hg_ctx *ctx, hg_tensor *tensor);            /* same data, no gradient through it */
void       hg_no_grad_begin(hg_ctx *ctx);                        /* nests */
void       hg_no_grad_end(hg_ctx *ctx);
hg_status  hg_graph_dot(hg_ctx *ctx, hg_text *dot);              /* the tape as Graphviz */
/* From here on every op's output and every gradient that a backward makes is searched for numbers that are not finite.
 * The first one is an error (HG_NUMERIC) that names op, caller and element; with a path (kept, may be NULL) the inputs of
 * that call, and the gradient of its output, are written there as HDF5, to reproduce it. */
void       hg_trap_nan(hg_ctx *ctx, bool on, const char *path);
bool       hg_trap_is_on(const hg_ctx *ctx, const char **path);  /* path (may be NULL) gets where it writes to */
/* Runs the call that a trap wrote again, in its own precision and in f64, forward and backward, and says for every input,
 * output and gradient where it is not finite. HG_NUMERIC is not returned: what is not finite stands in the report. */
hg_status  hg_trap_replay(hg_ctx *ctx, const char *path, hg_text *report);

/* ---- op table ----------------------------------------------------------------------------------------------- */

#define HG_OP_INPUTS 16
typedef struct hg_op hg_op;
typedef struct hg_call {                                         /* one recorded op call; lives in the step arena */
    hg_ctx *ctx;
    const hg_op *op;
    int n_in;
    hg_tensor *in[HG_OP_INPUTS];                                 /* optional inputs may be NULL */
    hg_tensor *out;
    hg_tensor *saved[4];                                         /* what forward leaves for backward, step tensors */
    void *attributes;                                            /* op->attributes_size bytes, a copy */
    const char *file; int line;
} hg_call;

/* What an ONNX emitter sees (implemented in export/): values are numbers, -1 is an absent input. */
typedef struct hg_emitter {
    void *self;
    int (*input)(void *self, const hg_tensor *tensor);           /* the value that stands for a tensor of the tape */
    int (*constant)(void *self, const hg_tensor *tensor);        /* an initialiser */
    int (*constant_f32)(void *self, int rank, const int64_t *shape, const float *data);
    int (*constant_i64)(void *self, int rank, const int64_t *shape, const int64_t *data);
    int (*node)(void *self, const char *op_type, int n_in, const int *in, const char *attributes_format, ...); /* "axis=i alpha=f mode=s perm=I": i takes int64_t, f double, s const char *, I (int n, const int64_t *); "" for none */
    hg_status (*output)(void *self, const hg_tensor *tensor, int value); /* this value stands for that tensor from here on */
} hg_emitter;

/* One set of inputs on which the tests run an op. */
typedef struct hg_sample {
    const char *label;
    int n_in;
    struct { int rank; int64_t shape[HG_MAX_RANK]; hg_dtype dtype; double low, high; bool no_grad; const double *values; } in[HG_OP_INPUTS]; /* uniform in [low, high] (both 0: [-1, 1]) or values; dtype HG_F32 stands for the float type under test, HG_I32 stays */
    const void *attributes;
    bool zero_gradient;                                          /* some input's gradient is zero everywhere, and that is right */
} hg_sample;

struct hg_op {
    const char *name;                                            /* "matmul" */
    const char *formula;                                         /* "C = A B" */
    int min_in, max_in;
    size_t attributes_size;
    hg_tensor *(*shape)(hg_call *call);                          /* checks inputs, makes the output; NULL after hg_ctx_fail */
    hg_status (*forward)(hg_call *call);
    hg_status (*backward)(hg_call *call);                        /* reads hg_grad(call->out), adds into hg_grad(call->in[i]) where hg_needs_grad */
    bool not_differentiable;                                     /* backward NULL is allowed only with this */
    const hg_sample *samples; int n_samples;
    void (*reference)(const hg_call *call, double *out);         /* plain f64 loops, used by tests; inputs are f64 */
    bool (*kink)(const hg_call *call, int in, int64_t element, double step); /* true: finite differences are not valid here */
    hg_status (*emit)(const hg_call *call, hg_emitter *emitter); /* ONNX; NULL: cannot be exported, said by name */
    /* For the trap, of an op with more to say than an element of a tensor: adds what is not finite to the message, and writes
     * with a path (may be NULL) what reproduces it in a format of its own. NULL: inputs and attributes are written for
     * hg_trap_replay; then attributes hold no pointers. */
    hg_status (*explain)(const hg_call *call, bool backward, const char *path, hg_text *text);
    /* For HAIRGRAD_VALIDATE, of an op whose attributes belong to a device: the same call on a context of the processor, with `in`
     * in place of call->in, recorded where those need gradients. NULL: the op is applied with the same attributes. */
    hg_tensor *(*twin)(const hg_call *call, hg_ctx *host, hg_tensor *const *in);
};
#define HG_OP(name_, ...) \
    static const hg_op op_##name_ = { .name = #name_, __VA_ARGS__ }; \
    HG_REGISTER("op", name_, &op_##name_)

/* Runs and records an op; library ops are thin wrappers of this, users' own call it directly. */
hg_tensor *hg_apply(hg_ctx *ctx, const hg_op *op, int n_in, hg_tensor *const *in, const void *attributes);
/* For a shape check: "NAME: sentence; inputs f32 [3,4], f32 [5,6]" becomes the context's error. Returns NULL. */
hg_tensor *hg_refuse(const hg_call *call, const char *format, ...) HG_PRINTF(2, 3);
/* The recorded calls in order, for export and drawing. */
int hg_tape_count(const hg_ctx *ctx);
const hg_call *hg_tape_call(const hg_ctx *ctx, int i);
void hg_tape_record_all(hg_ctx *ctx, bool on);                   /* record calls that need no gradient too (export) */

/* ---- gradcheck ---------------------------------------------------------------------------------------------- */

typedef struct {
    double tolerance;            /* relative, default 1e-6 */
    double step;                 /* largest step of the sweep, in units of the input, default 1e-3 */
    int    directions;           /* 0: every element up to 2,000 elements, else 16 random directions */
    bool   zero_gradient;        /* an all-zero gradient is expected */
    const double *units;         /* [n_in] what a change of 1 means to an input: a step is step * max(unit, |value|); NULL: 1 */
    const char *const *names;    /* [n_in] of the inputs, for messages; NULL: their numbers */
} hg_gradcheck_options;

#define HG_GRADCHECK_STEPS 5
typedef struct {
    double worst; int input; int64_t element;                    /* element -1: a random direction */
    double analytic, numeric, step; char text[256];              /* step: the best one of the sweep */
    int steps; struct { double step, numeric, error; } sweep[HG_GRADCHECK_STEPS];   /* of the worst element */
    int64_t checked, kinks;                                      /* elements compared; left out, since a kink lies within their steps */
} hg_gradcheck_result;

/* f: builds a one-element f64 tensor from inputs (f64 step tensors or leaves). Checked are the inputs that need a
 * gradient; where none does, all f64 inputs are made to. Derivatives are differences of four values over steps from
 * `step` down by tens, the best one counts; signs count; a gradient that is zero everywhere is refused unless declared.
 * Where they disagree, but the gradient is the derivative to one side and not to the other, f has a kink there: such an
 * element is counted and left out. When nothing but kinks is left, that is an error.
 * HG_NUMERIC when it is wrong: the message and result->text say which element. */
hg_status hg_gradcheck(hg_ctx *ctx, hg_tensor *(*f)(void *self, hg_ctx *ctx, hg_tensor **in), void *self,
                       int n_in, hg_tensor *const *in, const hg_gradcheck_options *options, hg_gradcheck_result *result);
hg_status hg_gradcheck_op(hg_ctx *ctx, const hg_op *op, const hg_sample *sample, const hg_gradcheck_options *options, hg_gradcheck_result *result);

/* ---- ops ---------------------------------------------------------------------------------------------------- */
/* Shapes broadcast as in NumPy where two tensors meet elementwise. axis < 0 counts from the end. */

typedef enum { HG_IDENTITY, HG_RELU, HG_LEAKY_RELU, HG_ELU, HG_TANH, HG_SIGMOID, HG_SILU, HG_GELU, HG_SOFTPLUS } hg_activation;
hg_status hg_activation_parse(const char *name, hg_activation *activation);
const char *hg_activation_names(void);                           /* "identity|relu|..." for config choices */

hg_tensor *hg_add(hg_ctx *ctx, hg_tensor *a, hg_tensor *b);
hg_tensor *hg_sub(hg_ctx *ctx, hg_tensor *a, hg_tensor *b);
hg_tensor *hg_mul(hg_ctx *ctx, hg_tensor *a, hg_tensor *b);
hg_tensor *hg_div(hg_ctx *ctx, hg_tensor *a, hg_tensor *b);
hg_tensor *hg_minimum(hg_ctx *ctx, hg_tensor *a, hg_tensor *b);  /* ties: gradient to a */
hg_tensor *hg_maximum(hg_ctx *ctx, hg_tensor *a, hg_tensor *b);
hg_tensor *hg_scale(hg_ctx *ctx, hg_tensor *a, double scale, double shift);   /* scale a + shift */
hg_tensor *hg_square(hg_ctx *ctx, hg_tensor *a);
hg_tensor *hg_sqrt(hg_ctx *ctx, hg_tensor *a);
hg_tensor *hg_exp(hg_ctx *ctx, hg_tensor *a);
hg_tensor *hg_log(hg_ctx *ctx, hg_tensor *a);
hg_tensor *hg_abs(hg_ctx *ctx, hg_tensor *a);
hg_tensor *hg_clamp(hg_ctx *ctx, hg_tensor *a, double low, double high);
hg_tensor *hg_activate(hg_ctx *ctx, hg_tensor *a, hg_activation activation);
hg_tensor *hg_cast(hg_ctx *ctx, hg_tensor *a, hg_dtype dtype);
hg_tensor *hg_sum(hg_ctx *ctx, hg_tensor *a);                    /* -> [] , summed in f64 */
hg_tensor *hg_mean(hg_ctx *ctx, hg_tensor *a);
hg_tensor *hg_sum_axis(hg_ctx *ctx, hg_tensor *a, int axis, bool keep);
hg_tensor *hg_mean_axis(hg_ctx *ctx, hg_tensor *a, int axis, bool keep);
hg_tensor *hg_reshape(hg_ctx *ctx, hg_tensor *a, int rank, const int64_t *shape); /* one -1 allowed; shares data */
hg_tensor *hg_permute(hg_ctx *ctx, hg_tensor *a, const int *axes);
hg_tensor *hg_concat(hg_ctx *ctx, int axis, int n, hg_tensor *const *parts);      /* up to 16 */
hg_tensor *hg_slice(hg_ctx *ctx, hg_tensor *a, int axis, int64_t first, int64_t count);
hg_tensor *hg_pad(hg_ctx *ctx, hg_tensor *a, int axis, int64_t before, int64_t after); /* zeros */
hg_tensor *hg_gather(hg_ctx *ctx, hg_tensor *a, hg_tensor *index);                /* rows of axis 0 by i32 [n]; adjoint = segment sum, deterministic */
hg_tensor *hg_scatter_add(hg_ctx *ctx, hg_tensor *a, hg_tensor *index, int64_t rows);
hg_tensor *hg_matmul(hg_ctx *ctx, hg_tensor *a, hg_tensor *b);                    /* [..,m,k] x [k,n]; leading axes of a are rows */
hg_tensor *hg_linear(hg_ctx *ctx, hg_tensor *x, hg_tensor *weight, hg_tensor *bias, hg_activation activation); /* act(x W + b); W [in,out], b [out] or NULL; fused */
hg_tensor *hg_linear_pair(hg_ctx *ctx, hg_tensor *rows, hg_tensor *groups, hg_activation activation); /* act(rows[S,H] + groups[B,H]) -> [B,S,H]: the factored first layer, one pass */
/* Convolution of images: x [B,C,H,W], weight [O,C,kh,kw], bias [O] or NULL -> [B,O,(H + 2 padding - kh) / stride + 1, (W + 2
 * padding - kw) / stride + 1], zeros around x; not flipped. What does not fit is an error, an empty batch is none. On cuda by
 * cuDNN: HG_UNSUPPORTED where that is missing. */
hg_tensor *hg_conv2d(hg_ctx *ctx, hg_tensor *x, hg_tensor *weight, hg_tensor *bias, int stride, int padding);
typedef enum { HG_NEAREST, HG_BILINEAR } hg_interpolation;
hg_tensor *hg_upsample(hg_ctx *ctx, hg_tensor *x, hg_interpolation interpolation); /* [B,C,H,W] -> [B,C,2H,2W]; bilinear by half pixels */
hg_tensor *hg_softmax(hg_ctx *ctx, hg_tensor *a);                                 /* last axis */
hg_tensor *hg_layer_norm(hg_ctx *ctx, hg_tensor *a, hg_tensor *gain, hg_tensor *bias, double epsilon); /* last axis */
hg_tensor *hg_group_norm(hg_ctx *ctx, hg_tensor *a, hg_tensor *gain, hg_tensor *bias, int groups, double epsilon); /* [B,C,...] */
hg_tensor *hg_dot(hg_ctx *ctx, hg_tensor *a, hg_tensor *b);                       /* last axis -> [...] */
hg_tensor *hg_norm(hg_ctx *ctx, hg_tensor *a);                                    /* last axis; gradient of zero is zero */
hg_tensor *hg_normalize(hg_ctx *ctx, hg_tensor *a);                               /* last axis; zero stays zero */
hg_tensor *hg_cross(hg_ctx *ctx, hg_tensor *a, hg_tensor *b);                     /* [...,3] */
hg_tensor *hg_quat_mul(hg_ctx *ctx, hg_tensor *a, hg_tensor *b);                  /* [...,4] (w,x,y,z), broadcast */
hg_tensor *hg_quat_conjugate(hg_ctx *ctx, hg_tensor *q);
hg_tensor *hg_quat_rotate(hg_ctx *ctx, hg_tensor *q, hg_tensor *v);               /* q [...,4] unit, v [...,3], broadcast: q v conj(q) */
hg_tensor *hg_transport(hg_ctx *ctx, hg_tensor *a, hg_tensor *b);                 /* [...,3] unit -> [...,4]: (a.h, a x h), h = (a+b)/sqrt(max(|a+b|^2, 1e-4)) */
hg_tensor *hg_clip_gradient(hg_ctx *ctx, hg_tensor *x, double limit);             /* x; backward, rows of the last axis are shortened to `limit` */
/* d_v = sum_{i<v} l_i ((t_i + a_i) / |t_i + a_i| - t_i): displacements of strands whose edges turn and keep their length. a
 * [B,S,E,3] or [S,E,3] for the last E edges, rest [S,V,3] -> [B,S,V-1,3] or [S,V-1,3]. Gradient to a only. */
hg_tensor *hg_turn_edges(hg_ctx *ctx, hg_tensor *a, hg_tensor *rest);
/* x = p + R (rest + d - rest_root), d zero at the root: how a network's output becomes hair. d [B,S,V-1,3], rest [S,V,3]
 * or [B,S,V,3], rotation [B,S,4], position [B,S,3] -> [B,S,V,3]. Gradient to d only. */
hg_tensor *hg_place(hg_ctx *ctx, hg_tensor *d, hg_tensor *rest, hg_tensor *rotation, hg_tensor *position);

/* The caller's file and line in every message. */
#ifndef HG_NO_CALLER
#define HG_HERE(ctx) hg_at((ctx), __FILE__, __LINE__)
#define hg_backward(ctx, ...) (hg_backward)(HG_HERE(ctx), __VA_ARGS__)
#define hg_backward_seeded(ctx, ...) (hg_backward_seeded)(HG_HERE(ctx), __VA_ARGS__)
#define hg_detach(ctx, ...) (hg_detach)(HG_HERE(ctx), __VA_ARGS__)
#define hg_apply(ctx, ...) (hg_apply)(HG_HERE(ctx), __VA_ARGS__)
#define hg_gradcheck(ctx, ...) (hg_gradcheck)(HG_HERE(ctx), __VA_ARGS__)
#define hg_gradcheck_op(ctx, ...) (hg_gradcheck_op)(HG_HERE(ctx), __VA_ARGS__)
#define hg_add(ctx, ...) (hg_add)(HG_HERE(ctx), __VA_ARGS__)
#define hg_sub(ctx, ...) (hg_sub)(HG_HERE(ctx), __VA_ARGS__)
#define hg_mul(ctx, ...) (hg_mul)(HG_HERE(ctx), __VA_ARGS__)
#define hg_div(ctx, ...) (hg_div)(HG_HERE(ctx), __VA_ARGS__)
#define hg_minimum(ctx, ...) (hg_minimum)(HG_HERE(ctx), __VA_ARGS__)
#define hg_maximum(ctx, ...) (hg_maximum)(HG_HERE(ctx), __VA_ARGS__)
#define hg_scale(ctx, ...) (hg_scale)(HG_HERE(ctx), __VA_ARGS__)
#define hg_square(ctx, ...) (hg_square)(HG_HERE(ctx), __VA_ARGS__)
#define hg_sqrt(ctx, ...) (hg_sqrt)(HG_HERE(ctx), __VA_ARGS__)
#define hg_exp(ctx, ...) (hg_exp)(HG_HERE(ctx), __VA_ARGS__)
#define hg_log(ctx, ...) (hg_log)(HG_HERE(ctx), __VA_ARGS__)
#define hg_abs(ctx, ...) (hg_abs)(HG_HERE(ctx), __VA_ARGS__)
#define hg_clamp(ctx, ...) (hg_clamp)(HG_HERE(ctx), __VA_ARGS__)
#define hg_activate(ctx, ...) (hg_activate)(HG_HERE(ctx), __VA_ARGS__)
#define hg_cast(ctx, ...) (hg_cast)(HG_HERE(ctx), __VA_ARGS__)
#define hg_sum(ctx, ...) (hg_sum)(HG_HERE(ctx), __VA_ARGS__)
#define hg_mean(ctx, ...) (hg_mean)(HG_HERE(ctx), __VA_ARGS__)
#define hg_sum_axis(ctx, ...) (hg_sum_axis)(HG_HERE(ctx), __VA_ARGS__)
#define hg_mean_axis(ctx, ...) (hg_mean_axis)(HG_HERE(ctx), __VA_ARGS__)
#define hg_reshape(ctx, ...) (hg_reshape)(HG_HERE(ctx), __VA_ARGS__)
#define hg_permute(ctx, ...) (hg_permute)(HG_HERE(ctx), __VA_ARGS__)
#define hg_concat(ctx, ...) (hg_concat)(HG_HERE(ctx), __VA_ARGS__)
#define hg_slice(ctx, ...) (hg_slice)(HG_HERE(ctx), __VA_ARGS__)
#define hg_pad(ctx, ...) (hg_pad)(HG_HERE(ctx), __VA_ARGS__)
#define hg_gather(ctx, ...) (hg_gather)(HG_HERE(ctx), __VA_ARGS__)
#define hg_scatter_add(ctx, ...) (hg_scatter_add)(HG_HERE(ctx), __VA_ARGS__)
#define hg_matmul(ctx, ...) (hg_matmul)(HG_HERE(ctx), __VA_ARGS__)
#define hg_linear(ctx, ...) (hg_linear)(HG_HERE(ctx), __VA_ARGS__)
#define hg_linear_pair(ctx, ...) (hg_linear_pair)(HG_HERE(ctx), __VA_ARGS__)
#define hg_conv2d(ctx, ...) (hg_conv2d)(HG_HERE(ctx), __VA_ARGS__)
#define hg_upsample(ctx, ...) (hg_upsample)(HG_HERE(ctx), __VA_ARGS__)
#define hg_softmax(ctx, ...) (hg_softmax)(HG_HERE(ctx), __VA_ARGS__)
#define hg_layer_norm(ctx, ...) (hg_layer_norm)(HG_HERE(ctx), __VA_ARGS__)
#define hg_group_norm(ctx, ...) (hg_group_norm)(HG_HERE(ctx), __VA_ARGS__)
#define hg_dot(ctx, ...) (hg_dot)(HG_HERE(ctx), __VA_ARGS__)
#define hg_norm(ctx, ...) (hg_norm)(HG_HERE(ctx), __VA_ARGS__)
#define hg_normalize(ctx, ...) (hg_normalize)(HG_HERE(ctx), __VA_ARGS__)
#define hg_cross(ctx, ...) (hg_cross)(HG_HERE(ctx), __VA_ARGS__)
#define hg_quat_mul(ctx, ...) (hg_quat_mul)(HG_HERE(ctx), __VA_ARGS__)
#define hg_quat_conjugate(ctx, ...) (hg_quat_conjugate)(HG_HERE(ctx), __VA_ARGS__)
#define hg_quat_rotate(ctx, ...) (hg_quat_rotate)(HG_HERE(ctx), __VA_ARGS__)
#define hg_transport(ctx, ...) (hg_transport)(HG_HERE(ctx), __VA_ARGS__)
#define hg_place(ctx, ...) (hg_place)(HG_HERE(ctx), __VA_ARGS__)
#endif

#ifdef __cplusplus
}
#endif
#endif
