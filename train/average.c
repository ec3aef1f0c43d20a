/* average: an exponential moving average of the weights (Polyak and Juditsky 1992; the form used since Tarvainen and Valpola
 * 2017): a <- a + (1 - d) (w - a) after every step, with d = min(decay, (1 + t) / (10 + t)) so that the first, random
 * weights are soon forgotten. The average changes places with the weights for a validation and for what is written: a
 * checkpoint's /model is what should be used, and the weights that training goes on from stand beside it. */
#include "train/average.kernel.h"
#include "train/chunks.h"
#include "train/state.h"

#include <math.h>

struct hg_average {
    hg_ctx *ctx;
    hg_chunks chunks;
    hg_tensor *other; /* [all parameters in order]: the average, or the weights while it is in their place */
    float rate;       /* of the step that is made */
};

static hg_status move(hg_average *average, float rate)
{
    const hg_chunk *chunks = hg_chunks_table(&average->chunks, false);
    if (!chunks) return HG_MEMORY;
    average->rate = rate;
    const hg_step_mark mark = hg_step_set_mark(average->ctx);
    const hg_tensor *number = hg_tensor_from(average->ctx, HG_F32, 0, NULL, &average->rate);
    if (!number) return hg_ctx_status(average->ctx);
    const average_args args = { chunks, average->other->data, number->data };
    HG_TRY(hg_launch(average->ctx, &average_kernel, average->chunks.n_chunks, &args));
    hg_step_rewind(average->ctx, mark);
    hg_tensor_touch(average->other);
    for (int i = 0; rate < 0 && i < average->chunks.n; i++) hg_tensor_touch(average->chunks.params[i]);
    return HG_OK;
}

hg_status hg_average_create(hg_average **out, hg_ctx *ctx, int n, hg_tensor *const *params)
{
    *out = NULL;
    hg_average *average = hg_alloc(1, sizeof *average);
    if (!average) return HG_MEMORY;
    average->ctx = ctx;
    hg_status status = hg_chunks_create(&average->chunks, ctx, n, params);
    average->other = status == HG_OK ? hg_tensor_create(ctx, HG_F32, 1, &average->chunks.total) : NULL;
    if (!average->other) {
        const int64_t total = average->chunks.total;
        hg_average_destroy(average);
        return hg_fail(HG_MEMORY, "trainer: no memory for the average of %lld weights", (long long)total);
    }
    status = move(average, 1); /* the average of one set of weights: a + (w - a) with a = 0 */
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
    hg_chunks_destroy(&average->chunks);
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
    return hg_state_write_tensor(file, "/average/weights", average->other);
}

hg_status hg_average_load(hg_average *average, hg_h5 *file)
{
    return hg_state_read_tensor(file, "/average/weights", average->other);
}
