/* Rows of training and use: the full training step, its memory, and inference of a whole head of hair. */
#include "bench/bench.h"

#include "tasks/hair.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { INFERENCE = 120000 };

/* ---- scene -------------------------------------------------------------------------------------------------- */

static const char config_text[] =
    "scene: { style: long, strands: 3000, vertices: 25, seconds: 2 s, motion_kinds: [shake], "
    "held_out_kinds: []%s }\n"
    "features: { encoder_steps: 20 }\n"
    "losses:\n"
    "  stretch: { stiffness: 2 N/m }\n"
    "  bend_twist: { stiffness: 1e-8 N*m^2 }\n"
    "  gravity: {}\n"
    "  inertia: {}\n"
    "  body_collision: { stiffness: 30 J/m^3, distance: 5 mm, mode: exact }\n"
    "  hair_style: { stiffness: 0.005 N/m, s_max: 8 mm }\n"
    "  self_collision: { stiffness: 1e-10 J, h: 5 mm }\n"
    "  adhesion: { stiffness: 1e-6 N/m, radius: 4.5 mm, count: 5 }\n"
    "training: { strands: 3000, frames: 1 }\n";

/* The real body where the data is beside the source, else the procedural bust with every triangle cut in four until
 * there are about as many. */
static void make_body_file(bench *b, const char *path)
{
    char folder[700];
    hg_body *body = NULL;
    snprintf(folder, sizeof folder, "%s/../shared/data/bodies", b->source);
    snprintf(b->scene, sizeof b->scene, "MakeHuman body");
    char *object = hg_path_join(folder, "makehuman/base.obj");
    const bool there = object && hg_file_exists(object);
    hg_free(object);
    if (!there || hg_body_read_makehuman(b->host, &body, folder, "cmu_mb") != HG_OK) {
        bench_need(hg_bust_create(&body));
        snprintf(b->scene, sizeof b->scene, "procedural bust");
    }
    bench_need(hg_body_save(body, path));
    hg_body_destroy(body);
}

void bench_body(bench *b)
{
    char path[400];
    snprintf(path, sizeof path, "%s/body.h5", b->folder);
    if (!hg_file_exists(path)) make_body_file(b, path);
}

hg_hair_task *bench_task(bench *b, int threads)
{
    const int c = threads == 0 ? (b->device ? 2 : 1) : threads > 1;
    if (b->task[c]) return b->task[c];
    char scene[600], text[2048];
    bench_body(b);
    snprintf(scene, sizeof scene, ", folder: \"%s\", body: body.h5", b->folder);
    snprintf(text, sizeof text, config_text, scene);
    int n;
    const hg_config_row *rows = hg_hair_schema(&n);
    hg_config *config;
    bench_need(hg_config_parse(&config, text, "bench", rows, n));
    bench_need(hg_hair_task_create(&b->task[c], c == 2 ? b->host : b->ctx[c], config, NULL, NULL));
    hg_config_destroy(config);
    hg_model *model = hg_hair_model(b->task[c]); /* its last layer starts at zero */
    hg_tensor *weights = model->params[model->n_params - 2];
    float *last = bench_get(weights);
    for (int64_t i = 0; i < hg_tensor_count(weights); i++)
        last[i] = (float)(0.01 * hg_random_normal(9, 0, (uint64_t)i));
    bench_put(weights, last);
    hg_free(last);
    return b->task[c];
}

/* ---- the full step ------------------------------------------------------------------------------------------ */

typedef struct {
    hg_ctx *ctx;
    hg_hair_task *task;
    hg_adam *adam;
    void *batch;
    uint64_t step;
    hg_dtype compute;
} training;

static void one_step(training *t)
{
    const hg_task *task = hg_hair_task_of(t->task);
    const hg_train_options o = hg_hair_train_options(t->task);
    hg_model *model = hg_hair_model(t->task);
    hg_report report = { 0 };
    double norm;
    hg_step_reset(t->ctx);
    hg_profile_begin(t->ctx, "step", "sample");
    bench_need(task->sample(task->self, t->ctx, 1, t->step++ % 40, t->batch));
    hg_profile_end(t->ctx, 0);
    bench_need(hg_step_record(t->ctx));
    hg_profile_begin(t->ctx, "step", "loss");
    hg_tensor *loss = task->loss(task->self, t->ctx, model, t->batch, &report);
    hg_profile_end(t->ctx, 0);
    bench_need(hg_ctx_status(t->ctx));
    hg_profile_begin(t->ctx, "step", "backward");
    bench_need(hg_backward(t->ctx, loss));
    hg_profile_end(t->ctx, 0);
    /* a rate of zero: all the work of a step, and the same frames again find the same contacts */
    bench_need(hg_adam_step(t->adam, 0, o.beta1, o.beta2, o.epsilon, 0, o.clip, hg_ctx_host(t->ctx) ? &norm : NULL));
    bench_need(hg_step_run(t->ctx));
    hg_profile_step(t->ctx);
}

static training make_training(bench *b, int c)
{
    training t = { .ctx = c == 2 ? b->host : b->ctx[c], .task = bench_task(b, c == 2 ? 0 : c + 1) };
    hg_model *model = hg_hair_model(t.task);
    for (int i = 0; i < model->n_params; i++) bench_need(hg_require_grad(model->params[i]));
    bench_need(hg_adam_create(&t.adam, t.ctx, model->n_params, model->params));
    t.batch = hg_alloc(1, hg_hair_task_of(t.task)->batch_bytes);
    if (!t.batch) bench_need(HG_MEMORY);
    return t;
}

static void end_training(training *t)
{
    hg_step_reset(t->ctx);
    hg_adam_destroy(t->adam);
    hg_free(t->batch);
}

static void steps(void *self, double *ms, int n)
{
    training *t = self;
    if (t->compute == HG_BF16) bench_need(hg_ctx_compute(t->ctx, HG_BF16));
    one_step(t);
    if (hg_ctx_host(t->ctx)) {
        for (int i = 0; i < n; i++) {
            const double start = bench_now();
            one_step(t);
            ms[i] = bench_now() - start;
        }
    } else { /* as in a training: the host makes the next batch meanwhile */
        bench_need(hg_ctx_wait(t->ctx));
        const double start = bench_now();
        for (int i = 0; i < n; i++) one_step(t);
        bench_need(hg_ctx_wait(t->ctx));
        for (int i = 0; i < n; i++) ms[i] = (bench_now() - start) / n;
    }
    bench_need(hg_ctx_compute(t->ctx, HG_F32));
}

static void write_arrays(bench *b, const training *t)
{
    const hg_hair_task *task = t->task;
    const hg_hair_subset *subset = &task->subset;
    const int64_t S = subset->n, V = task->groom->vertices, F = task->layout.frame_inputs, N = task->body_vertices;
    int64_t n_faces;
    const int32_t *faces = hg_poser_collider(task->poser, &n_faces);
    const hg_hair_batch *batch = hg_hair_batch_lay_out(task, t->batch, 1, S);
    hg_model *model = hg_hair_model(t->task);
    bench_write_tensor(b, "strand", subset->features);
    bench_write_tensor(b, "rest", subset->rest);
    bench_write(b, "inputs", HG_F32, 2, (int64_t[]){ 3, F }, batch->inputs);
    bench_write(b, "rotation", HG_F32, 3, (int64_t[]){ 3, S, 4 }, batch->rotation);
    bench_write(b, "position", HG_F32, 3, (int64_t[]){ 3, S, 3 }, batch->position);
    bench_write(b, "body", HG_F32, 2, (int64_t[]){ N, 3 }, batch->body);
    bench_write(b, "faces", HG_I32, 2, (int64_t[]){ n_faces, 3 }, faces);
    bench_write(b, "mass", HG_F64, 1, &S, subset->mass);
    bench_write(b, "reference", HG_F64, 1, (int64_t[]){ 1 }, &task->reference);
    float *distance = hg_alloc((size_t)(S * V), sizeof *distance);
    if (!distance) bench_need(HG_MEMORY);
    for (int64_t i = 0; i < S; i++)
        memcpy(distance + i * V, task->styles[task->current].body_distance + (int64_t)subset->strand[i] * V,
               (size_t)V * sizeof *distance);
    bench_write(b, "body_distance", HG_F32, 2, (int64_t[]){ S, V }, distance);
    hg_free(distance);
    for (int i = 0; i < model->n_params; i++) {
        char name[24];
        snprintf(name, sizeof name, "model%d", i);
        bench_write_tensor(b, name, model->params[i]);
    }
}

static double status_bytes(const char *key)
{
    char line[256];
    double found = 0;
    FILE *file = fopen("/proc/self/status", "r");
    while (file && fgets(line, sizeof line, file))
        if (!strncmp(line, key, strlen(key))) found = 1024 * strtod(line + strlen(key) + 1, NULL);
    if (file) fclose(file);
    return found;
}

/* In a process of its own, so that nothing else has touched its memory: what three steps take beyond what stands ready
 * before the first, and of that the step's own memory. */
void bench_step_memory(bench *b)
{
    training t = make_training(b, 1);
    const double before = status_bytes("VmRSS");
    for (int i = 0; i < 3; i++) one_step(&t);
    printf("%.0f %.0f\n", status_bytes("VmHWM") - before, (double)hg_step_high_water(t.ctx));
    end_training(&t);
}

static double own_memory(void)
{
    double bytes = 0;
    char path[512], command[560];
    const ssize_t n = readlink("/proc/self/exe", path, sizeof path - 1);
    if (n <= 0) return 0;
    path[n] = 0;
    snprintf(command, sizeof command, "\"%s\" --step-memory", path);
    FILE *pipe = popen(command, "r");
    if (pipe && fscanf(pipe, "%lf", &bytes) != 1) bytes = 0;
    if (pipe) pclose(pipe);
    return bytes;
}

/* The parts of the step, as `hairgrad profile` shows them. */
static void show_parts(bench *b, training *t)
{
    const hg_profile_row *rows;
    double seconds;
    one_step(t);
    bench_need(hg_profile_start(t->ctx, 15));
    for (int i = 0; i < 15; i++) one_step(t);
    const int n = hg_profile_read(t->ctx, &seconds, &rows);
    printf("\nParts of the full step, %.2f ms (own time: without what is listed inside it):\n\n| part | ms | share "
           "|\n|---|---|---|\n",
           1e3 * seconds);
    for (int i = 0; i < n; i++)
        if (rows[i].own > 0.01 * seconds)
            printf("| %s: %s | %.2f | %.0f %% |\n", rows[i].group, rows[i].name, 1e3 * rows[i].own,
                   100 * rows[i].own / seconds);
    printf("\n");
    fflush(stdout);
    hg_profile_stop(t->ctx);
    (void)b;
}

static int same_steps(training *one, training *two)
{
    int same = 1;
    for (int k = 0; k < 2; k++) {
        one_step(one);
        one_step(two);
    }
    const hg_model *a = hg_hair_model(one->task), *z = hg_hair_model(two->task);
    for (int i = 0; i < a->n_params; i++)
        same &= bench_same(a->params[i], z->params[i]) && bench_same(hg_grad(a->params[i]), hg_grad(z->params[i]));
    return same;
}

void bench_step(bench *b)
{
    training one = make_training(b, 0), two = make_training(b, 1);
    bench_result r = { .row = "full training step", .ours = "f32", .aim = 12 };
    r.same_bits = same_steps(&one, &two);
    end_training(&one);
    if (b->device) { /* the posed frame is nowhere on the host */
        training host = make_training(b, 2);
        one_step(&host);
        write_arrays(b, &host);
        end_training(&host);
    } else {
        write_arrays(b, &two);
    }
    bench_peer *peer = bench_peer_start(b, "step", 150);
    const bool has = hg_ctx_compute(b->ctx[1], HG_BF16) == HG_OK;
    bench_need(hg_ctx_compute(b->ctx[1], HG_F32));
    training half = two;
    half.compute = HG_BF16;
    bench_side race[4] = { { "f32", steps, &two } };
    int n = 1, bf16 = -1, eager = -1, compiled = -1;
    if (has) race[bf16 = n++] = (bench_side){ "bf16", steps, &half };
    if (bench_peer_has(peer, "eager")) race[eager = n++] = bench_peer_side(peer, "eager", "PyTorch eager");
    if (bench_peer_has(peer, "compile")) race[compiled = n++] = bench_peer_side(peer, "compile", "torch.compile");
    int64_t state[3];
    double ms[2];
    for (int k = 0; k < 40; k++) steps(k % 2 && has ? &half : &two, ms, 1); /* every frame that is drawn has been met */
    bench_steady_begin(b, state);
    bench_race(b, n, race, 3);
    r.steady = bench_steady(b, state);
    const double rows = 3.0 * 3000;
    r.operations = rows * 2 * (66.0 / 3 * 256 + 256 * 256 + 256 * 72) + 3000 * 4.0 * (66 * 256 + 256 * 256 + 256 * 72) +
                   7560.0 * 3000;
    snprintf(r.note, sizeof r.note, "%s; theirs is given the posed body and roots, ours poses them; %.90s", b->scene,
             bench_peer_text(peer));
    for (int k = 0; k < 2; k++) {
        if (k && bf16 < 0) break;
        r.ours_ms = race[k ? bf16 : 0].median;
        r.other_ms = eager >= 0 ? race[eager].median : 0;
        snprintf(r.ours, sizeof r.ours, "%s", k ? "bf16 compute" : "f32");
        snprintf(r.other, sizeof r.other, "%s", eager >= 0 ? "PyTorch eager" : "");
        if (k) r.aim = 0, r.note[0] = 0;
        bench_add(b, &r);
    }
    if (compiled >= 0) {
        r.ours_ms = race[0].median;
        r.other_ms = race[compiled].median;
        snprintf(r.ours, sizeof r.ours, "f32");
        snprintf(r.other, sizeof r.other, "torch.compile");
        bench_add(b, &r);
    }
    bench_result m = { .row = "memory of the full step, MB",
                       .ours = "beyond what stands ready",
                       .aim = 4,
                       .same_bits = -1,
                       .steady = -1 };
    m.ours_ms = 1e-6 * own_memory();
    if (eager >= 0) {
        m.other_ms = 1e-6 * bench_peer_memory(peer, "eager");
        snprintf(m.other, sizeof m.other, "PyTorch eager");
    }
    snprintf(m.note, sizeof m.note,
             "largest resident memory less that before the first step, megabytes in place of ms");
    bench_add(b, &m);
    bench_peer_end(peer);
    show_parts(b, &two);
    end_training(&two);
}

/* ---- inference ---------------------------------------------------------------------------------------------- */

typedef struct {
    hg_ctx *ctx;
    hg_hair_task *task;
    hg_hair_part part;
    hg_tensor *rest;
    float *inputs, *rotation, *position, *x;
    hg_dtype compute;
} inference;

static void infer(void *self, double *ms, int n)
{
    inference *s = self;
    bench_need(hg_ctx_compute(s->ctx, s->compute));
    for (int i = -1; i < n; i++) {
        hg_step_reset(s->ctx);
        const double start = bench_now();
        bench_need(
            hg_hair_predict_frame(s->task, s->ctx, &s->part, s->inputs, s->rest, s->rotation, s->position, s->x));
        if (i >= 0) ms[i] = bench_now() - start;
    }
    bench_need(hg_ctx_compute(s->ctx, HG_F32));
}

static inference make_inference(bench *b, int c)
{
    hg_ctx *ctx = b->ctx[c];
    hg_hair_task *task = bench_task(b, c + 1);
    const int64_t S = task->subset.n, V = task->groom->vertices, K = task->strand_inputs, many = INFERENCE;
    inference s = { .ctx = ctx, .task = task };
    hg_tensor *features = hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ many, K });
    s.rest = hg_tensor_create(ctx, HG_F32, 3, (int64_t[]){ many, V, 3 });
    s.rotation = hg_alloc((size_t)many * 4, sizeof(float));
    s.position = hg_alloc((size_t)many * 3, sizeof(float));
    s.inputs = hg_alloc((size_t)task->layout.frame_inputs, sizeof(float));
    s.x = hg_alloc((size_t)(many * V) * 3, sizeof(float));
    if (!features || !s.rest || !s.rotation || !s.position || !s.inputs || !s.x) bench_need(HG_MEMORY);
    float *from = bench_get(task->subset.features), *rest = bench_get(task->subset.rest), *all = bench_get(features),
          *all_rest = bench_get(s.rest);
    for (int64_t i = 0; i < many; i++) {
        memcpy(all + i * K, from + i % S * K, (size_t)K * sizeof(float));
        memcpy(all_rest + i * V * 3, rest + i % S * V * 3, (size_t)V * 3 * sizeof(float));
        s.rotation[4 * i] = 1;
    }
    bench_put(features, all);
    bench_put(s.rest, all_rest);
    hg_free(from);
    hg_free(rest);
    hg_free(all);
    hg_free(all_rest);
    for (int i = 0; i < task->layout.frame_inputs; i++) s.inputs[i] = (float)hg_random_normal(11, 0, (uint64_t)i);
    const hg_hair_subset strands = { .grooms = 1, .n = many, .features = features };
    bench_need(hg_hair_part_keep(&s.part, task, ctx, &strands));
    hg_tensor_destroy(features);
    hg_step_reset(ctx);
    return s;
}

static void end_inference(inference *s)
{
    hg_hair_part_free(&s->part);
    hg_tensor_destroy(s->rest);
    hg_free(s->inputs);
    hg_free(s->rotation);
    hg_free(s->position);
    hg_free(s->x);
}

void bench_inference(bench *b)
{
    bench_need(
        hg_model_copy(hg_hair_model(bench_task(b, 1)), hg_hair_model(bench_task(b, 2)))); /* one was trained longer */
    inference side[2] = { make_inference(b, 0), make_inference(b, 1) };
    hg_hair_task *task = side[1].task;
    char path[400];
    snprintf(path, sizeof path, "%s/model.onnx", b->folder);
    bench_need(hg_export_hair_onnx(task, b->ctx[1], path));
    const int64_t count[2] = { INFERENCE, task->inputs };
    bench_write(b, "count", HG_I32, 1, (int64_t[]){ 2 }, (int32_t[]){ (int32_t)count[0], (int32_t)count[1] });
    bench_peer *peer = bench_peer_start(b, "inference", 60);
    double ms;
    for (int c = 0; c < 2; c++) infer(&side[c], &ms, 1);
    bench_result r = { .row = "inference, 120,000 strands", .ours = "f32", .aim = 3 };
    r.same_bits = !memcmp(side[0].x, side[1].x, (size_t)(INFERENCE * task->groom->vertices) * 12);
    end_inference(&side[0]);
    const bool has = hg_ctx_compute(b->ctx[1], HG_BF16) == HG_OK;
    bench_need(hg_ctx_compute(b->ctx[1], HG_F32));
    inference half = side[1];
    half.compute = HG_BF16;
    bench_side race[3] = { { "f32", infer, &side[1] } };
    int n = 1, bf16 = -1, other = -1;
    if (has) race[bf16 = n++] = (bench_side){ "bf16", infer, &half };
    if (bench_peer_has(peer, "onnx")) race[other = n++] = bench_peer_side(peer, "onnx", "ONNX Runtime");
    int64_t state[3];
    if (has) infer(&half, &ms, 1);
    bench_steady_begin(b, state);
    bench_race(b, n, race, 2);
    r.steady = bench_steady(b, state);
    r.operations = 2.0 * INFERENCE * (256 * 256 + 256 * 72);
    r.bytes = 4.0 * INFERENCE * (256 + 75 + 75 + 7);
    for (int k = 0; k < 2; k++) {
        if (k && bf16 < 0) break;
        r.ours_ms = race[k ? bf16 : 0].median;
        if (other >= 0) {
            r.other_ms = race[other].median;
            snprintf(r.other, sizeof r.other, "ONNX Runtime, published form");
        }
        snprintf(r.ours, sizeof r.ours, "%s, placed strands", k ? "bf16 compute" : "f32");
        snprintf(r.note, sizeof r.note, "%s", k ? "" : bench_peer_text(peer));
        if (k) r.aim = 0;
        bench_add(b, &r);
    }
    bench_peer_end(peer);
    end_inference(&side[1]);
}
