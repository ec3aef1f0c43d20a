/* adam: Adam (Kingma and Ba 2015, algorithm 1) with bias correction, decoupled weight decay (Loshchilov and Hutter 2019)
 * and clipping of the global gradient norm. All parameters are stepped by one launch over fixed chunks: a chunk never
 * depends on the number of threads, and the norm is summed in the order of chunks. */
#include "train/state.h"

#include <math.h>
#include <string.h>

enum { CHUNK = 4096 };

typedef struct {
    float *value;
    const float *gradient;
    float *m, *v;
    int64_t count;
    int param;
} chunk;

struct hg_adam {
    hg_ctx *ctx;
    hg_tensor **params;
    hg_tensor *m, *v; /* [all parameters in order] */
    chunk *chunks;
    double *partial; /* [chunks] squares of the gradient */
    int64_t n_chunks, total, step;
    int n;
};

hg_status hg_adam_create(hg_adam **out, hg_ctx *ctx, int n, hg_tensor *const *params)
{
    *out = NULL;
    int64_t total = 0, n_chunks = 0;
    for (int i = 0; i < n; i++) {
        if (params[i]->dtype != HG_F32)
            return hg_fail(HG_INVALID, "adam: parameter %s is %s, it has to be f32", params[i]->name,
                           hg_dtype_name(params[i]->dtype));
        const int64_t count = hg_tensor_count(params[i]);
        total += count;
        n_chunks += (count + CHUNK - 1) / CHUNK;
    }
    hg_adam *adam = hg_alloc(1, sizeof *adam);
    if (!adam) return HG_MEMORY;
    adam->ctx = ctx;
    adam->n = n;
    adam->total = total;
    adam->n_chunks = n_chunks;
    adam->params = hg_alloc((size_t)(n ? n : 1), sizeof *adam->params);
    adam->chunks = hg_alloc((size_t)(n_chunks ? n_chunks : 1), sizeof *adam->chunks);
    adam->partial = hg_alloc((size_t)(n_chunks ? n_chunks : 1), sizeof *adam->partial);
    adam->m = hg_tensor_create(ctx, HG_F32, 1, &total);
    adam->v = hg_tensor_create(ctx, HG_F32, 1, &total);
    if (!adam->params || !adam->chunks || !adam->partial || !adam->m || !adam->v) {
        hg_adam_destroy(adam);
        return hg_fail(HG_MEMORY, "adam: no memory for the moments of %lld weights", (long long)total);
    }
    if (n) memcpy(adam->params, params, (size_t)n * sizeof *params);
    int64_t at = 0, offset = 0;
    for (int i = 0; i < n; i++) {
        const int64_t count = hg_tensor_count(params[i]);
        for (int64_t first = 0; first < count; first += CHUNK) {
            adam->chunks[at++] = (chunk){ .m = (float *)adam->m->data + offset + first,
                                          .v = (float *)adam->v->data + offset + first,
                                          .count = count - first < CHUNK ? count - first : CHUNK,
                                          .param = i };
        }
        offset += count;
    }
    *out = adam;
    return HG_OK;
}

void hg_adam_destroy(hg_adam *adam)
{
    if (!adam) return;
    hg_tensor_destroy(adam->m);
    hg_tensor_destroy(adam->v);
    hg_free(adam->partial);
    hg_free(adam->chunks);
    hg_free(adam->params);
    hg_free(adam);
}

typedef struct {
    const chunk *chunks;
    double *partial;
} norm_args;

static void norm_body(const void *args_, int64_t first, int64_t last)
{
    const norm_args *args = args_;
    for (int64_t c = first; c < last; c++) {
        const float *g = args->chunks[c].gradient;
        const int64_t count = args->chunks[c].count;
        double sum[8] = { 0 };
        int64_t i = 0;
        for (; i + 8 <= count; i += 8)
            for (int k = 0; k < 8; k++) sum[k] += (double)g[i + k] * (double)g[i + k];
        for (; i < count; i++) sum[i & 7] += (double)g[i] * (double)g[i];
        args->partial[c] = ((sum[0] + sum[1]) + (sum[2] + sum[3])) + ((sum[4] + sum[5]) + (sum[6] + sum[7]));
    }
}

static const hg_kernel norm_kernel = {
    .name = "adam_norm", .args_size = sizeof(norm_args), .cpu = norm_body, .block = 1
};

typedef struct {
    const chunk *chunks;
    float scale, beta1, beta2, rate, correction2, epsilon, decay;
} step_args;

static void step_body(const void *args_, int64_t first, int64_t last)
{
    const step_args *args = args_;
    const float scale = args->scale, beta1 = args->beta1, beta2 = args->beta2, rate = args->rate;
    const float correction2 = args->correction2, epsilon = args->epsilon, decay = args->decay;
    for (int64_t c = first; c < last; c++) {
        const chunk *part = &args->chunks[c];
        float *restrict value = part->value, *restrict m = part->m, *restrict v = part->v;
        const float *restrict gradient = part->gradient;
        const int64_t count = part->count;
        for (int64_t i = 0; i < count; i++) {
            const float g = gradient[i] * scale;
            m[i] = beta1 * m[i] + (1 - beta1) * g;
            v[i] = beta2 * v[i] + (1 - beta2) * g * g;
            value[i] -= rate * m[i] / (sqrtf(v[i] * correction2) + epsilon) + decay * value[i];
        }
    }
}

static const hg_kernel step_kernel = {
    .name = "adam_step", .args_size = sizeof(step_args), .cpu = step_body, .block = 1
};

static hg_status refuse(const hg_adam *adam)
{
    for (int64_t c = 0; c < adam->n_chunks; c++) {
        if (isfinite(adam->partial[c])) continue;
        const hg_tensor *param = adam->params[adam->chunks[c].param];
        return hg_fail(HG_NUMERIC,
                       "adam: the gradient of %s is not finite at step %lld; the weights were left as they were",
                       param->name ? param->name : "a parameter", (long long)adam->step + 1);
    }
    return hg_fail(HG_NUMERIC, "adam: the gradient norm is not finite; the weights were left as they were");
}

hg_status hg_adam_step(hg_adam *adam, double learning_rate, double beta1, double beta2, double epsilon,
                       double weight_decay, double clip, double *gradient_norm)
{
    int64_t at = 0;
    for (int i = 0; i < adam->n; i++) {
        hg_tensor *param = adam->params[i];
        const hg_tensor *gradient = hg_grad(param);
        if (!gradient)
            return hg_fail(HG_INVALID, "adam: parameter %s has no gradient: the loss does not depend on it",
                           param->name ? param->name : "?");
        const int64_t count = hg_tensor_count(param);
        for (int64_t first = 0; first < count; first += CHUNK, at++) {
            adam->chunks[at].value = (float *)param->data + first;
            adam->chunks[at].gradient = (const float *)gradient->data + first;
        }
    }
    const norm_args norm = { adam->chunks, adam->partial };
    hg_profile_begin(adam->ctx, "optimiser", "gradient norm");
    HG_TRY(hg_launch(adam->ctx, &norm_kernel, adam->n_chunks, &norm));
    hg_profile_end(adam->ctx, 4 * adam->total);
    double squares = 0;
    for (int64_t c = 0; c < adam->n_chunks; c++) squares += adam->partial[c];
    const double length = sqrt(squares);
    if (gradient_norm) *gradient_norm = length;
    if (!isfinite(length)) return refuse(adam);

    const double t = (double)(adam->step + 1);
    const step_args step = { .chunks = adam->chunks,
                             .scale = (float)(clip > 0 && length > clip ? clip / length : 1),
                             .beta1 = (float)beta1,
                             .beta2 = (float)beta2,
                             .rate = (float)(learning_rate / (1 - pow(beta1, t))),
                             .correction2 = (float)(1 / (1 - pow(beta2, t))),
                             .epsilon = (float)epsilon,
                             .decay = (float)(learning_rate * weight_decay) };
    hg_profile_begin(adam->ctx, "optimiser", "adam");
    HG_TRY(hg_launch(adam->ctx, &step_kernel, adam->n_chunks, &step));
    hg_profile_end(adam->ctx, 28 * adam->total); /* value, m, v in and out, gradient in */
    for (int i = 0; i < adam->n; i++) hg_tensor_touch(adam->params[i]);
    adam->step++;
    return HG_OK;
}

hg_status hg_adam_save(const hg_adam *adam, hg_h5 *file)
{
    HG_TRY(hg_h5_write(file, "/adam/m", HG_F32, 1, &adam->total, adam->m->data));
    HG_TRY(hg_h5_write(file, "/adam/v", HG_F32, 1, &adam->total, adam->v->data));
    return hg_h5_write_i64(file, "/adam/step", 1, (int64_t[]){ 1 }, &adam->step);
}

hg_status hg_adam_load(hg_adam *adam, hg_h5 *file)
{
    void *m = NULL, *v = NULL;
    hg_status status = hg_h5_read(file, "/adam/m", HG_F32, 1, &adam->total, NULL, &m);
    if (status == HG_OK) status = hg_h5_read(file, "/adam/v", HG_F32, 1, &adam->total, NULL, &v);
    int64_t step = 0;
    if (status == HG_OK) status = hg_state_read_count(file, "/adam/step", &step);
    if (status == HG_OK) status = hg_tensor_write(adam->m, m);
    if (status == HG_OK) status = hg_tensor_write(adam->v, v);
    if (status == HG_OK) adam->step = step;
    hg_free(m);
    hg_free(v);
    return status;
}
