/* The tape as autograd/ sees it: what the op files and gradcheck need beside the public header. */
#ifndef HG_AUTOGRAD_TAPE_H
#define HG_AUTOGRAD_TAPE_H

#define HG_NO_CALLER /* inside the library, messages name the user's line, not ours */
#include "autograd/autograd.h"

/* What a tensor's tape slot points at. */
typedef struct hg_node {
    hg_tensor *tensor, *grad;
    bool stale;           /* in a backward pass: nothing was added yet, and what is there is old */
    int producer;         /* number of the call on the tape, -1 for a leaf */
    struct hg_node *next; /* of the leaves */
} hg_node;

/* True when a backward of this call may follow, so that forward has to save what it needs. */
bool hg_call_recorded(const hg_call *call);

/* The gradient's data for a backward that can also overwrite: with *fresh true nothing was added yet, and every
 * element must be written with '='; else with '+='. (hg_grad is the same with the zeros written already.) */
void *hg_grad_data(hg_tensor *tensor, bool *fresh);

/* The output of most ops: a new step tensor. */
hg_tensor *hg_out(const hg_call *call, hg_dtype dtype, int rank, const int64_t *shape);
hg_tensor *hg_out_like(const hg_call *call, const hg_tensor *tensor);
/* The same data in another shape; versions are tied. */
hg_tensor *hg_out_view(const hg_call *call, hg_tensor *tensor, int rank, const int64_t *shape);

bool hg_is_float(const hg_tensor *tensor); /* f32 or f64 */
bool hg_same_shape(const hg_tensor *a, const hg_tensor *b);
/* All inputs present are f32, or all are f64; else the context's error. */
bool hg_floats_agree(const hg_call *call);
int hg_axis_of(const hg_call *call, const hg_tensor *tensor, int axis); /* 0 .. rank-1, or -1 with the error set */

/* Adds `count` arrays of `size` elements in a fixed tree, in place, and puts (fresh) or adds the sum into out. */
hg_status hg_add_partials(hg_ctx *ctx, hg_dtype dtype, int64_t count, int64_t size, void *partials, void *out,
                          bool fresh);
/* Overwrites or adds: out = or += from. */
hg_status hg_accumulate(hg_ctx *ctx, hg_dtype dtype, int64_t count, const void *from, void *out, bool fresh);

/* out = or += scale times the sum over the middle axis of [outer,n,inner], added in f64 in an order that the shape fixes. */
hg_status hg_sum_middle(hg_ctx *ctx, hg_dtype dtype, int64_t outer, int64_t n, int64_t inner, double scale,
                        const void *from, void *out, bool fresh);

/* What is known of indices that are the caller's (index.c), a list. NULL as root: all of it. */
typedef struct hg_index_known hg_index_known;
hg_index_known **hg_tape_indices(hg_ctx *ctx);
void hg_index_forget(hg_index_known **list, const hg_tensor *root);

/* Input i of a sample as a new step tensor of dtype (i32 stays i32), with its values. */
hg_tensor *hg_sample_input(hg_ctx *ctx, const hg_sample *sample, int i, hg_dtype dtype);

/* "[2,0,1]" */
const char *hg_place_text(const hg_tensor *tensor, int64_t element, char text[96]);

/* Held against the processor, see validate.c: `host` is a context there that nothing else uses. */
bool hg_validate_wanted(const hg_ctx *ctx);
hg_status hg_validate_forward(hg_ctx *host, const hg_call *call);
hg_status hg_validate_before(hg_ctx *host, const hg_call *call, double **before); /* [inputs] */
hg_status hg_validate_backward(hg_ctx *host, const hg_call *call, double *const *before);

/* HG_NUMERIC when one of the tensors (the output, or the inputs' gradients after a backward) is not finite. */
hg_status hg_trap_check(const hg_call *call, bool backward, const char *path);

/* Emitting shortcuts. */
int hg_emit_scalar(hg_emitter *emitter, double value);
int hg_emit_activation(hg_emitter *emitter, hg_activation activation, int value);
hg_status hg_emit_one(const hg_call *call, hg_emitter *emitter,
                      const char *op_type); /* one node, inputs as they come */
/* Nodes for vectors and quaternions (emit_vector.c). pick: numbers of the last axis; dot keeps that axis. */
int hg_emit_pick(hg_emitter *emitter, int value, int n, const int64_t *which);
int hg_emit_dot(hg_emitter *emitter, int a, int b);
int hg_emit_cross(hg_emitter *emitter, int a, int b);
int hg_emit_quat_mul(hg_emitter *emitter, int a, int b);
int hg_emit_quat_rotate(hg_emitter *emitter, int q, int v);
int hg_emit_transport(hg_emitter *emitter, int a, int b);

#endif
