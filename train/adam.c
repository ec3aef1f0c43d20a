/* adam: Adam (Kingma and Ba 2015, algorithm 1) with bias correction, decoupled weight decay (Loshchilov and Hutter 2019)
 * and clipping of the global gradient norm. All parameters are stepped by one launch over fixed pieces: a piece never
 * depends on the number of threads, and the norm is summed in the order of pieces.
 *
 * On a device the host sees nothing of a step: the norm is finished by a kernel, which also finds what is not finite. */
#include "train/adam.kernel.h"
#include "train/chunks.h"
#include "train/state.h"

#include <math.h>

struct hg_adam {
    hg_ctx *ctx;
    hg_chunks chunks;
    hg_tensor *m, *v;         /* [all parameters in order] */
    hg_tensor *partial;       /* [chunks], f64 */
    hg_tensor *found;         /* an adam_state on a device; NULL on the host */
    adam_numbers numbers;     /* of the step that is made */
    adam_state state;         /* the host's, or what was last read */
    const hg_tensor *watched; /* the loss that the next step looks at */
    int64_t step;
};

hg_status hg_adam_create(hg_adam **out, hg_ctx *ctx, int n, hg_tensor *const *params)
{
    *out = NULL;
    for (int i = 0; i < n; i++)
        if (params[i]->dtype != HG_F32)
            return hg_fail(HG_INVALID, "adam: parameter %s is %s, it has to be f32", params[i]->name,
                           hg_dtype_name(params[i]->dtype));
    hg_adam *adam = hg_alloc(1, sizeof *adam);
    if (!adam) return HG_MEMORY;
    adam->ctx = ctx;
    hg_status status = hg_chunks_create(&adam->chunks, ctx, n, params);
    if (status == HG_OK) {
        adam->m = hg_tensor_create(ctx, HG_F32, 1, &adam->chunks.total);
        adam->v = hg_tensor_create(ctx, HG_F32, 1, &adam->chunks.total);
        adam->partial = hg_tensor_create(ctx, HG_F64, 1, &adam->chunks.n_chunks);
        if (!hg_ctx_host(ctx))
            adam->found = hg_tensor_create(ctx, HG_F64, 1, (int64_t[]){ sizeof(adam_state) / sizeof(double) });
    }
    if (!adam->m || !adam->v || !adam->partial || (!adam->found && !hg_ctx_host(ctx))) {
        const int64_t total = adam->chunks.total;
        hg_adam_destroy(adam);
        return hg_fail(HG_MEMORY, "adam: no memory for the moments of %lld weights", (long long)total);
    }
    *out = adam;
    return HG_OK;
}

void hg_adam_destroy(hg_adam *adam)
{
    if (!adam) return;
    hg_tensor_destroy(adam->m);
    hg_tensor_destroy(adam->v);
    hg_tensor_destroy(adam->partial);
    hg_tensor_destroy(adam->found);
    hg_chunks_destroy(&adam->chunks);
    hg_free(adam);
}

hg_status hg_adam_bad_loss(double loss, int64_t step)
{
    return hg_fail(HG_NUMERIC,
                   "trainer: the loss is %g at step %lld; try a smaller learning rate, or --trap-nan to see where it "
                   "comes from",
                   loss, (long long)step);
}

static hg_status refuse(const hg_adam *adam, int64_t step, int64_t param)
{
    if (param == ADAM_LOSS) return hg_adam_bad_loss(adam->state.loss, step);
    const char *name = param == ADAM_NORM ? NULL : adam->chunks.params[param]->name;
    return hg_fail(HG_NUMERIC, "adam: the gradient%s%s is not finite at step %lld; the weights were left as they were",
                   param == ADAM_NORM ? " norm" : " of ",
                   param == ADAM_NORM ? ""
                   : name             ? name
                                      : "a parameter",
                   (long long)step);
}

void hg_adam_watch(hg_adam *adam, const hg_tensor *loss) { adam->watched = loss; }

/* The host's: the norm from its parts, at once. */
static hg_status clip(hg_adam *adam)
{
    const double *partial = adam->partial->data;
    const int64_t n = adam->chunks.n_chunks;
    double squares = 0;
    for (int64_t c = 0; c < n; c++) squares += partial[c];
    const double norm = sqrt(squares), most = adam->numbers.clip;
    adam->state = (adam_state){ .norm = norm, .scale = (float)(most > 0 && norm > most ? most / norm : 1) };
    if (isfinite(norm)) return HG_OK;
    int64_t c = 0;
    while (c < n && isfinite(partial[c])) c++;
    return refuse(adam, adam->step + 1, c < n ? adam->chunks.chunks[c].param : ADAM_NORM);
}

hg_status hg_adam_check(hg_adam *adam, double *gradient_norm)
{
    if (adam->found) {
        HG_TRY(hg_tensor_read(adam->found, &adam->state));
        if (adam->state.failed_step) {
            const adam_state none = { 0 };
            adam->step = adam->state.failed_step - 1; /* no step was made since */
            HG_TRY(hg_tensor_write(adam->found, &none));
            if (gradient_norm) *gradient_norm = adam->state.norm;
            return refuse(adam, adam->state.failed_step, adam->state.failed_param);
        }
    }
    if (gradient_norm) *gradient_norm = adam->state.norm;
    return HG_OK;
}

hg_status hg_adam_step(hg_adam *adam, double learning_rate, double beta1, double beta2, double epsilon,
                       double weight_decay, double most, double *gradient_norm)
{
    hg_ctx *ctx = adam->ctx;
    const hg_tensor *loss = adam->watched;
    const hg_chunk *chunks = hg_chunks_table(&adam->chunks, true);
    adam->watched = NULL;
    if (!chunks) return HG_INVALID;
    const double t = (double)(adam->step + 1);
    adam->numbers = (adam_numbers){ .clip = most,
                                    .step = adam->step + 1,
                                    .beta1 = (float)beta1,
                                    .beta2 = (float)beta2,
                                    .rate = (float)(learning_rate / (1 - pow(beta1, t))),
                                    .correction2 = (float)(1 / (1 - pow(beta2, t))),
                                    .epsilon = (float)epsilon,
                                    .decay = (float)(learning_rate * weight_decay) };
    const hg_step_mark mark = hg_step_set_mark(ctx);
    const hg_tensor *numbers =
        hg_tensor_from(ctx, HG_F64, 1, (int64_t[]){ sizeof(adam_numbers) / sizeof(double) }, &adam->numbers);
    if (!numbers) return hg_ctx_status(ctx);
    const adam_args args = { .chunks = chunks,
                             .numbers = numbers->data,
                             .state = adam->found ? adam->found->data : &adam->state,
                             .partial = adam->partial->data,
                             .m = adam->m->data,
                             .v = adam->v->data,
                             .n_chunks = adam->chunks.n_chunks,
                             .loss = loss && loss->dtype == HG_F32 ? loss->data : NULL,
                             .loss_f64 = loss && loss->dtype == HG_F64 ? loss->data : NULL };
    hg_profile_begin(ctx, "optimiser", "gradient norm");
    HG_TRY(hg_launch(ctx, &adam_norm_kernel, args.n_chunks, &args));
    if (adam->found) HG_TRY(hg_launch(ctx, &adam_clip_kernel, 1, &args));
    hg_profile_end(ctx, 4 * adam->chunks.total);
    if (!adam->found) {
        const hg_status status = clip(adam);
        if (gradient_norm) *gradient_norm = adam->state.norm;
        if (status != HG_OK) {
            hg_step_rewind(ctx, mark);
            return status;
        }
    }
    hg_profile_begin(ctx, "optimiser", "adam");
    HG_TRY(hg_launch(ctx, &adam_step_kernel, args.n_chunks, &args));
    hg_profile_end(ctx, 28 * adam->chunks.total); /* value, m, v in and out, gradient in */
    hg_step_rewind(ctx, mark);
    for (int i = 0; i < adam->chunks.n; i++) hg_tensor_touch(adam->chunks.params[i]);
    adam->step++;
    return adam->found && gradient_norm ? hg_adam_check(adam, gradient_norm) : HG_OK;
}

hg_status hg_adam_save(const hg_adam *adam, hg_h5 *file)
{
    HG_TRY(hg_state_write_tensor(file, "/adam/m", adam->m));
    HG_TRY(hg_state_write_tensor(file, "/adam/v", adam->v));
    return hg_h5_write_i64(file, "/adam/step", 1, (int64_t[]){ 1 }, &adam->step);
}

hg_status hg_adam_load(hg_adam *adam, hg_h5 *file)
{
    int64_t step = 0;
    HG_TRY(hg_state_read_tensor(file, "/adam/m", adam->m));
    HG_TRY(hg_state_read_tensor(file, "/adam/v", adam->v));
    HG_TRY(hg_state_read_count(file, "/adam/step", &step));
    adam->step = step;
    return HG_OK;
}
