/* average: an exponential moving average of the weights (Polyak and Juditsky 1992; the form used since Tarvainen and Valpola
 * 2017): a <- a + (1 - d) (w - a) after every step, with d = min(decay, (1 + t) / (10 + t)) so that the first, random
 * weights are soon forgotten. The average changes places with the weights for a validation and for what is written: a
 * checkpoint's /model is what should be used, and the weights that training goes on from stand beside it. */
#include "train/state.h"

#include <math.h>
#include <string.h>

enum { CHUNK = 4096 };

struct hg_average {
    hg_ctx *ctx;
    hg_tensor **params;
    hg_tensor *other; /* [all parameters in order]: the average, or the weights while it is in their place */
    int64_t total;
    int n;
};

typedef struct {
    float *a, *b;
    float rate; /* negative: exchange */
} move_args;

static void move_body(const void *args_, int64_t first, int64_t last)
{
    const move_args *args = args_;
    float *restrict a = args->a, *restrict b = args->b;
    if (args->rate >= 0)
        for (int64_t i = first; i < last; i++) a[i] += args->rate * (b[i] - a[i]);
    else
        for (int64_t i = first; i < last; i++) {
            const float kept = a[i];
            a[i] = b[i];
            b[i] = kept;
        }
}

static const hg_kernel move_kernel = {
    .name = "average", .args_size = sizeof(move_args), .cpu = move_body, .block = CHUNK
};

static hg_status move(hg_average *average, float rate)
{
    float *at = average->other->data;
    for (int i = 0; i < average->n; i++) {
        hg_tensor *param = average->params[i];
        const int64_t count = hg_tensor_count(param);
        const move_args args = { at, param->data, rate };
        HG_TRY(hg_launch(average->ctx, &move_kernel, count, &args));
        if (rate < 0) hg_tensor_touch(param);
        at += count;
    }
    return HG_OK;
}

hg_status hg_average_create(hg_average **out, hg_ctx *ctx, int n, hg_tensor *const *params)
{
    *out = NULL;
    hg_average *average = hg_alloc(1, sizeof *average);
    if (!average) return HG_MEMORY;
    average->ctx = ctx;
    average->n = n;
    for (int i = 0; i < n; i++) average->total += hg_tensor_count(params[i]);
    average->params = hg_alloc((size_t)(n ? n : 1), sizeof *average->params);
    average->other = hg_tensor_create(ctx, HG_F32, 1, &average->total);
    if (!average->params || !average->other) {
        hg_average_destroy(average);
        return hg_fail(HG_MEMORY, "trainer: no memory for the average of %lld weights", (long long)average->total);
    }
    if (n) memcpy(average->params, params, (size_t)n * sizeof *params);
    const hg_status status = move(average, 1); /* the average of one set of weights: a + (w - a) with a = 0 */
    if (status != HG_OK) {
        hg_average_destroy(average);
        return status;
    }
    *out = average;
    return HG_OK;
}

void hg_average_destroy(hg_average *average)
{
    if (!average) return;
    hg_tensor_destroy(average->other);
    hg_free(average->params);
    hg_free(average);
}

hg_status hg_average_step(hg_average *average, double decay, int64_t step)
{
    if (!average) return HG_OK;
    const double t = (double)step;
    return move(average, (float)(1 - fmin(decay, (1 + t) / (10 + t))));
}

hg_status hg_average_exchange(hg_average *average) { return average ? move(average, -1) : HG_OK; }

hg_status hg_average_save(const hg_average *average, hg_h5 *file)
{
    return hg_h5_write(file, "/average/weights", HG_F32, 1, &average->total, average->other->data);
}

hg_status hg_average_load(hg_average *average, hg_h5 *file)
{
    void *weights = NULL;
    hg_status status = hg_h5_read(file, "/average/weights", HG_F32, 1, &average->total, NULL, &weights);
    if (status == HG_OK) status = hg_tensor_write(average->other, weights);
    hg_free(weights);
    return status;
}
