/* Row of the decoder: what drapes a whole groom from a latent image, 8 x 8 x 1024 through three stages of bilinear upsampling, a
 * 3 x 3 convolution and silu, 1024 -> 512 -> 256 -> 128, to 72 channels at 64 x 64; two grooms, forward and backward. */
#include "bench/bench.h"

#include <math.h>

enum { BATCH = 2, STAGES = 4, SIDE = 8 };
static const int64_t channels[STAGES + 1] = { 1024, 512, 256, 128, 72 };

typedef struct {
    hg_ctx *ctx;
    hg_dtype compute;
    hg_tensor *latent, *weight[STAGES], *bias[STAGES];
} decoder;

static hg_tensor *make(hg_ctx *ctx, int rank, const int64_t *shape, double scale)
{
    hg_tensor *t = hg_tensor_create(ctx, HG_F32, rank, shape);
    if (!t) bench_need(HG_MEMORY);
    float *values = bench_get(t);
    for (int64_t i = 0; i < hg_tensor_count(t); i++)
        values[i] = (float)(scale * hg_random_normal(1, (uint64_t)(rank * 10000 + shape[0]), (uint64_t)i));
    bench_put(t, values);
    hg_free(values);
    bench_need(hg_require_grad(t));
    return t;
}

static void make_decoder(decoder *s)
{
    s->latent = make(s->ctx, 4, (int64_t[]){ BATCH, channels[0], SIDE, SIDE }, 1);
    for (int i = 0; i < STAGES; i++) {
        s->weight[i] =
            make(s->ctx, 4, (int64_t[]){ channels[i + 1], channels[i], 3, 3 }, 0.3 / sqrt((double)channels[i]));
        s->bias[i] = make(s->ctx, 1, &channels[i + 1], 0.1);
    }
}

static void free_decoder(decoder *s)
{
    hg_tensor_destroy(s->latent);
    for (int i = 0; i < STAGES; i++) {
        hg_tensor_destroy(s->weight[i]);
        hg_tensor_destroy(s->bias[i]);
    }
}

static void run(void *self, double *ms, int n)
{
    decoder *s = self;
    bench_need(hg_ctx_compute(s->ctx, s->compute));
    for (int i = -1; i < n; i++) {
        hg_step_reset(s->ctx);
        const double start = bench_now();
        hg_tensor *x = s->latent;
        for (int stage = 0; stage < STAGES; stage++) {
            const bool last = stage == STAGES - 1;
            if (!last) x = hg_upsample(s->ctx, x, HG_BILINEAR);
            x = hg_conv2d(s->ctx, x, s->weight[stage], s->bias[stage], 1, 1);
            if (!last) x = hg_activate(s->ctx, x, HG_SILU);
        }
        bench_need(hg_backward_seeded(s->ctx, x, x));
        bench_need(hg_ctx_wait(s->ctx));
        if (i >= 0) ms[i] = bench_now() - start;
    }
    bench_need(hg_ctx_compute(s->ctx, HG_F32));
}

static int same_bits(decoder *one, decoder *two)
{
    double ms;
    run(one, &ms, 1);
    run(two, &ms, 1);
    for (int i = 0; i < STAGES; i++)
        if (!bench_same(hg_grad(one->weight[i]), hg_grad(two->weight[i])) ||
            !bench_same(hg_grad(one->bias[i]), hg_grad(two->bias[i])))
            return 0;
    return bench_same(hg_grad(one->latent), hg_grad(two->latent));
}

void bench_decoder(bench *b)
{
    decoder side[2][2]; /* f32, bf16; threads */
    for (int k = 0; k < 2; k++)
        for (int c = 0; c < 2; c++) {
            side[k][c] = (decoder){ .ctx = b->ctx[c], .compute = k ? HG_BF16 : HG_F32 };
            make_decoder(&side[k][c]);
        }
    bench_write_tensor(b, "latent", side[0][1].latent);
    for (int i = 0; i < STAGES; i++) {
        char name[16];
        snprintf(name, sizeof name, "weight%d", i);
        bench_write_tensor(b, name, side[0][1].weight[i]);
        snprintf(name, sizeof name, "bias%d", i);
        bench_write_tensor(b, name, side[0][1].bias[i]);
    }
    bench_peer *peer = bench_peer_start(b, "decoder", 60);
    const bool has = hg_ctx_compute(b->ctx[1], HG_BF16) == HG_OK;
    char missing[160] = "";
    if (!has) snprintf(missing, sizeof missing, "%.150s", hg_message());
    bench_need(hg_ctx_compute(b->ctx[1], HG_F32));
    const int bits[2] = { same_bits(&side[0][0], &side[0][1]), has ? same_bits(&side[1][0], &side[1][1]) : -1 };
    static const char *const variants[2] = { "eager", "bf16" }, *const labels[2] = { "PyTorch eager f32",
                                                                                     "PyTorch eager autocast bf16" };
    bench_side race[4] = { { "f32", run, &side[0][1] } };
    int n = 1, own[2] = { 0, -1 }, other[2] = { -1, -1 };
    if (has) race[own[1] = n++] = (bench_side){ "bf16", run, &side[1][1] };
    for (int v = 0; v < 2; v++)
        if (bench_peer_has(peer, variants[v])) race[other[v] = n++] = bench_peer_side(peer, variants[v], labels[v]);
    int64_t state[3];
    bench_steady_begin(b, state);
    bench_race(b, n, race, 3);
    const int steady = bench_steady(b, state);
    double operations = 0, bytes = 0;
    for (int i = 0; i < STAGES; i++) {
        const double pixels = BATCH * SIDE * SIDE * (double)(i < 3 ? 4 << 2 * i : 64);
        operations += 3 * 2 * 9 * pixels * (double)(channels[i] * channels[i + 1]);
        bytes += 4 * (3 * 9 * (double)(channels[i] * channels[i + 1]) +
                      3 * pixels * (double)(channels[i] + channels[i + 1]));
    }
    for (int k = 0; k < 2; k++) {
        bench_result r = { .row = "decoder, forward and backward",
                           .operations = operations,
                           .bytes = bytes,
                           .same_bits = bits[k],
                           .steady = steady };
        snprintf(r.ours, sizeof r.ours, "%s", k ? "bf16 compute" : "f32");
        snprintf(r.note, sizeof r.note, "%s", k && !has ? missing : bench_peer_text(peer));
        if (k && !has) r.steady = -1;
        if (own[k] >= 0) r.ours_ms = race[own[k]].median;
        if (other[k] >= 0 && own[k] >= 0) {
            r.other_ms = race[other[k]].median;
            snprintf(r.other, sizeof r.other, "%s", labels[k]);
        }
        bench_add(b, &r);
    }
    bench_peer_end(peer);
    for (int k = 0; k < 2; k++)
        for (int c = 0; c < 2; c++) free_decoder(&side[k][c]);
}
