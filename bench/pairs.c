/* Rows of many pairs of a groom and a pose at once: a network of grooms of the published size, 107 inputs to 64 x 64 x 72, over three
 * grooms, frames of a clip and body shapes. ms are those of a pair. What the paper says beside it: 0.3 s per 1,000 on an A6000. */
#include "bench/bench.h"

#include "tasks/hair.h"

#include <math.h>
#include <string.h>

enum { MOST = 1000, COUNTS = 4, CHECKED = 10 };
static const int counts[COUNTS] = { 1, 10, 100, MOST };

static const char config_text[] =
    "scene: { grooms: [long, wavy, short], strands: 4000, vertices: 25, seconds: 2 s, motion_kinds: [shake], "
    "held_out_kinds: []%s }\n"
    "model: { kind: quaffure, width: 1024, depth: 3, texture: 64, space: world }\n"
    "features: { pose_joints: [all], velocity_joints: [all], rotation: axis_angle, linear: none, history: 0, latent: "
    "16, "
    "encoder_width: 8, encoder_steps: 2 }\n"
    "losses: { gravity: {} }\n"
    "training: { strands: 100, frames: 1 }\n";

typedef struct {
    hg_ctx *ctx;
    hg_hair_task *task;
    hg_drape_pair pair[MOST];
    double shape[MOST][HG_SHAPES];
    int64_t next, half, allocated; /* allocated: at the half; -1 where more was taken after it */
    int64_t floats;
    float *kept; /* of the first CHECKED pairs */
} side;

static void make(bench *b, side *s, int c)
{
    char scene[600], text[2048];
    snprintf(scene, sizeof scene, ", folder: \"%s\", body: body.h5", b->folder);
    snprintf(text, sizeof text, config_text, scene);
    int n;
    const hg_config_row *rows = hg_hair_schema(&n);
    hg_config *config;
    bench_need(hg_config_parse(&config, text, "bench", rows, n));
    s->ctx = b->ctx[c];
    bench_need(hg_hair_task_create(&s->task, s->ctx, config, NULL, NULL));
    hg_config_destroy(config);
    for (int i = 0; i < MOST; i++) {
        const hg_motion *clip = hg_hair_clip(s->task, false, 0);
        hg_hair_held_out_shape(s->task, i, s->shape[i]);
        s->pair[i] = (hg_drape_pair){ i % 3, clip, i * 37 % clip->frames, s->shape[i] };
    }
    s->kept = hg_alloc((size_t)CHECKED * 4000 * 25 * 3, sizeof *s->kept);
    if (!s->kept) bench_need(HG_MEMORY);
}

static hg_status look(void *self, int64_t pair, const hg_drape_frame *frame)
{
    side *s = self;
    const int64_t count = frame->strands * frame->vertices * 3;
    if (s->next == s->half) s->allocated = hg_alloc_count();
    if (s->next++ > s->half && s->allocated != hg_alloc_count()) s->allocated = -1;
    if (pair == 0) s->floats = 0;
    if (pair >= CHECKED) return HG_OK;
    memcpy(s->kept + s->floats, frame->x, (size_t)count * sizeof *s->kept);
    s->floats += count;
    return HG_OK;
}

static double drape(side *s, int64_t n)
{
    s->next = 0, s->half = n / 2;
    const double start = bench_now();
    bench_need(hg_hair_drape_pairs(s->task, s->ctx, n, s->pair, NULL, look, s, NULL));
    return (bench_now() - start) / (double)n;
}

/* The network's images alone, of `rows` at once. */
static double images(side *s, int64_t rows)
{
    const int64_t width = s->task->strand_inputs, F = s->task->layout.frame_inputs;
    hg_tensor *code = hg_tensor_create(s->ctx, HG_F32, 2, (int64_t[]){ 1, width });
    hg_tensor *inputs = hg_tensor_create(s->ctx, HG_F32, 2, (int64_t[]){ rows, F });
    if (!code || !inputs) bench_need(HG_MEMORY);
    bench_need(hg_tensor_fill(code, 0.1));
    bench_need(hg_tensor_fill(inputs, 0.2));
    const hg_hair_part part = { .grooms = 1, .rows = code };
    double ms[5];
    hg_no_grad_begin(s->ctx);
    for (int i = -1; i < 5; i++) {
        hg_step_reset(s->ctx);
        const double start = bench_now();
        hg_hair_images(s->task, s->ctx, &part, NULL, inputs);
        bench_need(hg_ctx_status(s->ctx));
        bench_need(hg_ctx_wait(s->ctx));
        if (i >= 0) ms[i] = (bench_now() - start) / (double)rows;
    }
    hg_no_grad_end(s->ctx);
    hg_step_reset(s->ctx);
    hg_tensor_destroy(code);
    hg_tensor_destroy(inputs);
    return bench_median(ms, 5);
}

/* Multiply-adds of a row, counted twice: the first layer, and the convolutions at 16, 32, 64 and 64. */
static double operations(hg_hair_task *task)
{
    const hg_model *model = hg_hair_model(task);
    double sum = 0, pixels = 256;
    for (int i = 0; i < model->n_params; i++) {
        const hg_tensor *w = model->params[i];
        if (w->rank == 2) sum += 2 * (double)hg_tensor_count(w);
        if (w->rank != 4) continue;
        sum += 2 * pixels * (double)hg_tensor_count(w);
        pixels = fmin(4 * pixels, 4096);
    }
    return sum;
}

void bench_pairs(bench *b)
{
    bench_body(b);
    side *s[2];
    for (int c = 0; c < 2; c++) {
        s[c] = hg_alloc(1, sizeof *s[c]);
        if (!s[c]) bench_need(HG_MEMORY);
        make(b, s[c], c);
    }
    hg_model *model = hg_hair_model(s[1]->task);
    hg_tensor *last = model->params[model->n_params - 2]; /* starts at zero */
    float *values = bench_get(last);
    for (int64_t i = 0; i < hg_tensor_count(last); i++) values[i] = (float)(0.01 * hg_random_normal(9, 0, (uint64_t)i));
    bench_put(last, values);
    hg_free(values);
    bench_need(hg_model_copy(hg_hair_model(s[0]->task), model));
    for (int c = 0; c < 2; c++) drape(s[c], CHECKED);
    const int same =
        s[0]->floats == s[1]->floats && !memcmp(s[0]->kept, s[1]->kept, (size_t)s[0]->floats * sizeof *s[0]->kept);
    bench_result r = { .operations = operations(s[1]->task), .same_bits = -1, .steady = -1 };
    snprintf(r.note, sizeof r.note,
             "ms of a pair; %lld weights, %s; the paper: 0.3 ms on an A6000, linear in their number",
             (long long)hg_model_weights(model), b->scene);
    for (int k = 0; k < COUNTS; k++) {
        double ms[3];
        const int rounds = counts[k] == MOST ? 1 : 3;
        for (int i = 0; i < rounds; i++) ms[i] = drape(s[1], counts[k]);
        r.ours_ms = bench_median(ms, rounds);
        r.same_bits = same;
        r.steady = counts[k] < CHECKED ? -1 : s[1]->allocated >= 0;
        snprintf(r.row, sizeof r.row, "pairs, %d", counts[k]);
        snprintf(r.ours, sizeof r.ours, "bodies, network, strands");
        bench_add(b, &r);
    }
    for (int rows = 1; rows <= 16; rows *= 16) {
        r.ours_ms = images(s[1], rows);
        r.same_bits = r.steady = -1;
        snprintf(r.row, sizeof r.row, "pairs, network alone");
        snprintf(r.ours, sizeof r.ours, "%d at once", rows);
        bench_add(b, &r);
    }
    for (int c = 0; c < 2; c++) {
        hg_hair_task_destroy(s[c]->task);
        hg_free(s[c]->kept);
        hg_free(s[c]);
    }
}
