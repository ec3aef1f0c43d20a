/* Row of the network: 748 -> 256 -> 256 -> 72 with silu over 3,000 strands, forward and backward, as training has it: 66
 * features of the strand and 682 of the frame enter the first layer apart. The other side has them concatenated. */
#include "bench/bench.h"

#include <string.h>

enum { STRANDS = 3000, STRAND = 66, FRAME = 682, WIDTH = 256, OUT = 72, PARAMS = 7 };

typedef struct {
    hg_ctx *ctx;
    hg_dtype compute;
    hg_tensor *strand, *frame,
        *param[PARAMS]; /* first of strands, of frames, its bias, hidden and bias, last and bias */
} network;

static hg_tensor *make(hg_ctx *ctx, int64_t rows, int64_t columns, double scale, bool learnt)
{
    hg_tensor *t = columns ? hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ rows, columns })
                           : hg_tensor_create(ctx, HG_F32, 1, &rows);
    if (!t) bench_need(HG_MEMORY);
    float *values = bench_get(t);
    for (int64_t i = 0; i < hg_tensor_count(t); i++)
        values[i] = (float)(scale * hg_random_normal(1, (uint64_t)(rows * 1000 + columns), (uint64_t)i));
    bench_put(t, values);
    hg_free(values);
    if (learnt) bench_need(hg_require_grad(t));
    return t;
}

static void run(void *self, double *ms, int n)
{
    network *s = self;
    hg_tensor *const *p = s->param;
    bench_need(hg_ctx_compute(s->ctx, s->compute));
    for (int i = -1; i < n; i++) {
        hg_step_reset(s->ctx);
        const double start = bench_now();
        hg_tensor *h = hg_linear_pair(s->ctx, hg_linear(s->ctx, s->strand, p[0], NULL, HG_IDENTITY),
                                      hg_linear(s->ctx, s->frame, p[1], p[2], HG_IDENTITY), HG_SILU);
        hg_tensor *y = hg_linear(s->ctx, hg_linear(s->ctx, h, p[3], p[4], HG_SILU), p[5], p[6], HG_IDENTITY);
        bench_need(hg_backward_seeded(s->ctx, y, y));
        bench_need(hg_ctx_wait(s->ctx));
        if (i >= 0) ms[i] = bench_now() - start;
    }
    bench_need(hg_ctx_compute(s->ctx, HG_F32));
}

static int same_bits(network *one, network *two)
{
    double ms;
    run(one, &ms, 1);
    run(two, &ms, 1);
    for (int i = 0; i < PARAMS; i++)
        if (!bench_same(hg_grad(one->param[i]), hg_grad(two->param[i]))) return 0;
    return 1;
}

void bench_network(bench *b)
{
    static const int64_t shapes[PARAMS][2] = { { STRAND, WIDTH }, { FRAME, WIDTH }, { WIDTH, 0 }, { WIDTH, WIDTH },
                                               { WIDTH, 0 },      { WIDTH, OUT },   { OUT, 0 } };
    network side[2][2]; /* f32, bf16; threads */
    for (int k = 0; k < 2; k++)
        for (int c = 0; c < 2; c++) {
            hg_ctx *ctx = b->ctx[c];
            side[k][c] = (network){ .ctx = ctx, .compute = k ? HG_BF16 : HG_F32 };
            side[k][c].strand = make(ctx, STRANDS, STRAND, 1, false);
            side[k][c].frame = make(ctx, 1, FRAME, 1, false);
            for (int i = 0; i < PARAMS; i++)
                side[k][c].param[i] = make(ctx, shapes[i][0], shapes[i][1], shapes[i][0] > 300 ? 0.04 : 0.06, true);
        }
    static float all[STRANDS * (STRAND + FRAME)];
    float *strand = bench_get(side[0][1].strand), *frame = bench_get(side[0][1].frame);
    for (int s = 0; s < STRANDS; s++) {
        memcpy(all + s * (STRAND + FRAME), strand + s * STRAND, STRAND * sizeof(float));
        memcpy(all + s * (STRAND + FRAME) + STRAND, frame, FRAME * sizeof(float));
    }
    hg_free(strand);
    hg_free(frame);
    bench_write(b, "features", HG_F32, 2, (int64_t[]){ STRANDS, STRAND + FRAME }, all);
    for (int i = 0; i < PARAMS; i++) {
        char name[16];
        snprintf(name, sizeof name, "param%d", i);
        bench_write_tensor(b, name, side[0][1].param[i]);
    }
    bench_peer *peer = bench_peer_start(b, "network", 150);
    const bool has = hg_ctx_compute(b->ctx[1], HG_BF16) == HG_OK;
    char missing[160] = "";
    if (!has) snprintf(missing, sizeof missing, "%.150s", hg_message());
    bench_need(hg_ctx_compute(b->ctx[1], HG_F32));
    const int bits[2] = { same_bits(&side[0][0], &side[0][1]), has ? same_bits(&side[1][0], &side[1][1]) : -1 };
    bench_side race[6] = { { "f32", run, &side[0][1] } };
    int n = 1, bf16 = -1, eager = -1;
    if (has) race[bf16 = n++] = (bench_side){ "bf16", run, &side[1][1] };
    static const char *const variants[] = { "eager", "compile", "bf16" }, *const labels[] = {
        "PyTorch eager f32", "torch.compile f32", "PyTorch eager autocast bf16"
    };
    int other[3] = { -1, -1, -1 };
    for (int v = 0; v < 3; v++)
        if (bench_peer_has(peer, variants[v])) race[other[v] = n++] = bench_peer_side(peer, variants[v], labels[v]);
    eager = other[0];
    int64_t state[3];
    bench_steady_begin(b, state);
    bench_race(b, n, race, 9);
    const int steady = bench_steady(b, state);
    const double deep = 3.0 * 2 * STRANDS * (WIDTH * WIDTH + WIDTH * OUT),
                 first = 2.0 * 2 * (STRANDS * STRAND + FRAME) * WIDTH;
    for (int k = 0; k < 2; k++) {
        bench_result r = { .row = "network, forward and backward",
                           .aim = k ? 5 : 2.5,
                           .operations = deep + first,
                           .bytes = 4.0 * STRANDS * (3 * STRAND + 11 * WIDTH + 3 * OUT),
                           .same_bits = bits[k],
                           .steady = steady };
        snprintf(r.ours, sizeof r.ours, "factored, %s", k ? "bf16 compute" : "f32");
        snprintf(r.note, sizeof r.note, "%s", k && !has ? missing : bench_peer_text(peer));
        if (k && !has) {
            r.steady = -1;
            bench_add(b, &r);
            continue;
        }
        r.ours_ms = race[k ? bf16 : 0].median;
        if (eager >= 0) {
            r.other_ms = race[eager].median;
            snprintf(r.other, sizeof r.other, "%s", labels[0]);
        }
        bench_add(b, &r);
        const int fair = other[k ? 2 : 1]; /* the same precision, or compiled: shown, without an aim */
        if (fair < 0) continue;
        r.aim = 0;
        r.other_ms = race[fair].median;
        snprintf(r.other, sizeof r.other, "%s", race[fair].label);
        r.note[0] = 0;
        bench_add(b, &r);
    }
    bench_peer_end(peer);
    for (int k = 0; k < 2; k++)
        for (int c = 0; c < 2; c++) {
            hg_tensor_destroy(side[k][c].strand);
            hg_tensor_destroy(side[k][c].frame);
            for (int i = 0; i < PARAMS; i++) hg_tensor_destroy(side[k][c].param[i]);
        }
}
