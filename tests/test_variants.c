/* tasks: what a config can change of a training beside the scene: runs of consecutive frames, orientations of edges as outputs,
 * ghosts, locks off; for networks of strands and of grooms alike. */
#include "geometry/vector.h"
#include "hairgrad.h"
#include "tests/test.h"
#include "tasks/hair.h"
#include "tests/device.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define OK(call)                                                                                                       \
    do {                                                                                                               \
        if ((call) != HG_OK) fail_msg("%s: %s", #call, hg_message());                                                  \
    } while (0)

static const char tiny[] =
    "scene: { strands: 30, vertices: 7, seconds: 1 s, motion_kinds: [nod, shake], held_out_kinds: [turn] }\n"
    "model: { width: 16 }\n"
    "features: { history: 3, latent: 4, lock_size: 8, encoder_width: 16, encoder_steps: 10 }\n"
    "losses: { gravity: {} }\n"
    "training: { strands: 30, frames: 6, steps: 20, warm_up: 2, log_every: 5, validate_every: 10, validation_frames: "
    "4,\n"
    "  checkpoint_every: 10, learning_rate: 2e-3 }\n";

#define COSSERAT                                                                                                       \
    { "losses.cosserat_stretch_shear.weight", "1" }, { "losses.cosserat_bend_twist.weight", "1" },                     \
    {                                                                                                                  \
        "losses.unit_quaternion.weight", "1"                                                                           \
    }
#define END                                                                                                            \
    {                                                                                                                  \
        NULL, NULL                                                                                                     \
    }
typedef const char *setting[2];
static const setting of_strands[] = { END };
static const setting of_grooms[] = { { "model.kind", "quaffure" },      { "model.texture", "8" },
                                     { "model.width", "16" },           { "model.depth", "1" },
                                     { "features.encoder_width", "8" }, END };
static const setting *const families[2] = { of_strands, of_grooms };

/* ---- a task --------------------------------------------------------------------------------------------------- */

typedef struct {
    hg_ctx *ctx;
    hg_hair_task *task;
} trial;

static hg_status create(trial *s, const char *run, const setting *family, const setting *set)
{
    int n;
    const hg_config_row *rows = hg_hair_schema(&n);
    hg_config *config = NULL;
    char path[400];
    OK(hg_config_parse(&config, tiny, "tiny.yaml", rows, n));
    for (; (*family)[0]; family++) OK(hg_config_set(config, (*family)[0], (*family)[1]));
    for (; set && (*set)[0]; set++) OK(hg_config_set(config, (*set)[0], (*set)[1]));
    OK(hg_ctx_create(&s->ctx, &(hg_ctx_options){ .threads = 2, .seed = 1, .device = test_device() }));
    snprintf(path, sizeof path, "%s/%s", test_folder(), run ? run : "");
    const hg_status status = hg_hair_task_create(&s->task, s->ctx, config, run ? path : NULL, NULL);
    hg_config_destroy(config);
    return status;
}

static trial begin(const char *run, const setting *family, const setting *set)
{
    trial s = { 0 };
    OK(create(&s, run, family, set));
    return s;
}

static void end(trial *s)
{
    hg_hair_task_destroy(s->task);
    hg_ctx_destroy(s->ctx);
    *s = (trial){ 0 };
}

static void refused(const setting *set, const char *part)
{
    trial s = { 0 };
    assert_int_not_equal(create(&s, NULL, of_strands, set), HG_OK);
    if (!strstr(hg_message(), part)) fail_msg("\"%s\" is not in: %s", part, hg_message());
    end(&s);
}

/* A network that moves the hair: the last layer begins at zero. */
static void stir(const trial *s)
{
    const hg_model *model = s->task->model;
    for (int i = 0; i < model->n_params; i++) {
        const int64_t n = hg_tensor_count(model->params[i]);
        float *w = malloc((size_t)n * sizeof *w);
        OK(hg_tensor_read(model->params[i], w));
        for (int64_t k = 0; k < n; k++) w[k] += (float)(0.1 * hg_random_normal(5, (uint64_t)i, (uint64_t)k));
        OK(hg_tensor_write(model->params[i], w));
        free(w);
    }
}

/* A batch of runs of the task's own length, each of the first clip from its frame on. */
typedef struct {
    void *bytes;
    hg_hair_batch *batch;
} filled;

static filled fill(const trial *s, int runs, const int32_t *groom, const int64_t *first)
{
    const int64_t B = runs * s->task->consecutive, n = s->task->subset.n;
    const double shape[HG_SHAPES] = { 0.4, -0.2 };
    filled f = { .bytes = hg_alloc(1, hg_hair_batch_bytes(s->task, B, n)) };
    f.batch = hg_hair_batch_lay_out(s->task, f.bytes, B, n);
    for (int r = 0; r < runs; r++)
        OK(hg_hair_batch_fill(s->task, s->ctx, f.batch, &s->task->subset, r, groom[r], &s->task->clips[0][1], first[r],
                              shape, NULL));
    return f;
}

/* ---- consecutive frames --------------------------------------------------------------------------------------- */

/* A run is what its frames are one by one. */
static void runs_are_their_frames(void **state)
{
    (void)state;
    static const setting three[] = { { "training.consecutive", "3" }, { "scene.grooms", "[wavy, short]" }, END },
                         one[] = { { "scene.grooms", "[wavy, short]" }, END };
    trial runs = begin(NULL, of_strands, three), single = begin(NULL, of_strands, one);
    const int32_t grooms[2] = { 0, 1 }, each[6] = { 0, 0, 0, 1, 1, 1 };
    const int64_t first[2] = { 0, 11 }, frames[6] = { 0, 1, 2, 11, 12, 13 };
    filled a = fill(&runs, 2, grooms, first), b = fill(&single, 6, each, frames);
    const hg_hair_batch *p = a.batch, *q = b.batch;
    assert_true(p->runs == 2 && p->rows == 10 && p->frames == 6 && q->runs == 6 && q->rows == 18);
    const size_t F = (size_t)runs.task->layout.frame_inputs, S = (size_t)p->strands, N = (size_t)p->body_vertices;
    for (size_t r = 0; r < 2; r++)
        for (size_t time = 0; time < 5; time++) { /* t-2, t-1 of the first frame; then t of each */
            const size_t row = time < 2 ? time * 2 + r : 4 + 3 * r + time - 2,
                         same = time < 2 ? time * 6 + 3 * r : 12 + 3 * r + time - 2;
            assert_int_equal(p->groom[row], q->groom[same]);
            assert_memory_equal(p->inputs + row * F, q->inputs + same * F, F * sizeof(float));
            if (p->transform) continue; /* roots and bodies are made in the step */
            assert_memory_equal(p->rotation + row * S * 4, q->rotation + same * S * 4, S * 4 * sizeof(float));
            assert_memory_equal(p->position + row * S * 3, q->position + same * S * 3, S * 3 * sizeof(float));
            if (time >= 2)
                assert_memory_equal(p->body + (row - 4) * N * 3, q->body + (same - 12) * N * 3, N * 3 * sizeof(float));
        }
    /* The t-1 of a frame of a run is the t of the one before it. */
    assert_memory_equal(q->inputs + (12 + 1) * F, q->inputs + (6 + 2) * F, F * sizeof(float));
    assert_memory_not_equal(q->inputs + 12 * F, q->inputs + 13 * F, F * sizeof(float));
    hg_free(a.bytes);
    hg_free(b.bytes);
    end(&runs);
    end(&single);
}

/* What is drawn for a step: frames that follow each other in one clip, with one body and groom. */
static void steps_draw_runs(void **state)
{
    (void)state;
    static const setting set[] = { { "training.consecutive", "3" }, { "scene.grooms", "[wavy, short]" }, END };
    trial s = begin(NULL, of_strands, set);
    const hg_hair_layout *layout = &s.task->layout;
    const int F = layout->frame_inputs, pose = HG_SHAPES + layout->pose_inputs, width = layout->velocity_inputs;
    hg_hair_batch *batch = hg_alloc(1, s.task->batch_bytes);
    int grooms[2] = { 0 };
    double moved = 0;
    for (uint64_t step = 0; step < 40; step++) {
        OK(hg_hair_sample(s.task, s.ctx, 3, step, batch));
        for (int r = 0; r < 2; r++) {
            const float *row = batch->inputs + (4 + 3 * r) * F;
            grooms[batch->groom[4 + 3 * r]]++;
            for (int k = 0; k < 2; k++, row += F) { /* what was newest is one frame older in the next */
                assert_int_equal(batch->groom[4 + 3 * r + k], batch->groom[4 + 3 * r + k + 1]);
                assert_memory_equal(row, row + F, HG_SHAPES * sizeof(float));
                assert_memory_equal(row + pose, row + F + pose + width, (size_t)(2 * width) * sizeof(float));
                for (int i = 0; i < width; i++) moved += fabs((double)(row + F)[pose + i] - (double)row[pose + i]);
            }
        }
    }
    assert_true(moved > 1 && grooms[0] > 10 && grooms[1] > 10);
    hg_free(batch);
    end(&s);
}

static void gradient_of(const trial *s, const hg_hair_batch *batch, double *loss, float *out)
{
    hg_tensor *unweighted, *value;
    hg_step_reset(s->ctx);
    value = hg_hair_energy(s->task, s->ctx, batch, &s->task->subset, &unweighted);
    if (!value || hg_backward(s->ctx, value) != HG_OK) fail_msg("%s", hg_message());
    *loss = hg_tensor_item(value, 0);
    for (int i = 0; i < s->task->model->n_params; i++) {
        const hg_tensor *w = s->task->model->params[i];
        OK(hg_tensor_read(hg_grad(w), out));
        out += hg_tensor_count(w);
    }
}

/* Without pose_reg a step of runs is the same as a step of their frames: in value and in gradient, inertia and drag too. */
static void a_step_of_runs_is_that_of_its_frames(void **state)
{
    (void)state;
    static const setting three[] = { { "training.consecutive", "3" },     { "losses.inertia.weight", "1" },
                                     { "losses.drag.weight", "1" },       { "losses.stretch.weight", "1" },
                                     { "losses.bend_twist.weight", "1" }, END };
    for (int family = 0; family < 2; family++) {
        trial runs = begin(NULL, families[family], three), single = begin(NULL, families[family], three + 1);
        stir(&runs);
        stir(&single);
        const int64_t weights = hg_model_weights(runs.task->model);
        float *g = malloc((size_t)weights * sizeof *g), *h = malloc((size_t)weights * sizeof *h);
        double a, b, difference = 0, size = 0;
        filled p = fill(&runs, 2, (int32_t[]){ 0, 0 }, (int64_t[]){ 4, 15 }),
               q = fill(&single, 6, (int32_t[]){ 0, 0, 0, 0, 0, 0 }, (int64_t[]){ 4, 5, 6, 15, 16, 17 });
        gradient_of(&runs, p.batch, &a, g);
        gradient_of(&single, q.batch, &b, h);
        for (int64_t i = 0; i < weights; i++) {
            difference += pow((double)g[i] - (double)h[i], 2);
            size += pow((double)h[i], 2);
        }
        if (!(fabs(a - b) < 1e-5 * fabs(b)) || !(difference < 1e-8 * size && size > 0))
            fail_msg("family %d: loss %.9g, %.9g; gradients differ by %g of %g", family, a, b, sqrt(difference),
                     sqrt(size));
        hg_free(p.bytes);
        hg_free(q.bytes);
        free(g);
        free(h);
        end(&runs);
        end(&single);
    }
}

typedef struct {
    float x[40][30 * 7 * 3], posed[40][30 * 7 * 3];
    int64_t n, strands;
} frames_seen;

static hg_status see(void *self, const hg_drape_frame *frame)
{
    frames_seen *seen = self;
    seen->strands = frame->strands;
    memcpy(seen->x[seen->n], frame->x, (size_t)(frame->strands * 7) * 3 * sizeof(float));
    memcpy(seen->posed[seen->n++], frame->posed, (size_t)(frame->strands * 7) * 3 * sizeof(float));
    return HG_OK;
}

/* An evaluation cuts a clip into runs; 8 frames are runs of 3, 3 and 2. The rigidly posed groom has no deformation. */
static void pose_reg_is_judged_in_runs(void **state)
{
    (void)state;
    static const setting set[] = { { "training.consecutive", "3" }, { "losses.pose_reg.weight", "1" }, END };
    trial s = begin(NULL, of_strands, set);
    stir(&s);
    const double shape[HG_SHAPES] = { 0.1 };
    hg_hair_metrics metrics;
    frames_seen *seen = calloc(1, sizeof *seen);
    const hg_motion *clip = hg_hair_clip(s.task, true, 0);
    OK(hg_hair_evaluate(s.task, s.ctx, clip, shape, 8, &metrics, NULL));
    OK(hg_hair_drape(s.task, s.ctx, clip, shape, 0, 8, 1, see, seen, NULL)); /* all strands, as the evaluation */
    assert_int_equal(seen->n, 8);
    double expected = 0;
    for (int64_t i = 0; i < seen->strands * 7 * 3; i++)
        for (int first = 0; first < 8; first += 3) {
            const int n = first == 6 ? 2 : 3;
            double mean = 0;
            for (int k = 0; k < n; k++) mean += ((double)seen->x[first + k][i] - (double)seen->posed[first + k][i]) / n;
            for (int k = 0; k < n; k++)
                expected += pow((double)seen->x[first + k][i] - (double)seen->posed[first + k][i] - mean, 2);
        }
    expected *= 1e-3 / (double)(8 * seen->strands); /* stiffness; a frame and strand */
    int term = 0;
    while (strcmp(metrics.term[term], "pose_reg")) term++;
    if (!(fabs(metrics.term_energy[term] - expected) < 1e-3 * expected && expected > 0))
        fail_msg("%g J, expected %g J", metrics.term_energy[term], expected);
    assert_true(metrics.term_posed[term] < 1e-6 * expected);
    free(seen);
    end(&s);
}

/* ---- orientations --------------------------------------------------------------------------------------------- */

/* A network whose last layer is zero leaves every edge's frame where the head carries it: no Cosserat energy at all. Turned
 * frames have one. */
static void zero_offsets_are_the_posed_frames(void **state)
{
    (void)state;
    static const setting sets[][8] = {
        { COSSERAT, { "model.output", "vertices" }, { "model.pinned", "1" }, END },
        { COSSERAT,
          { "model.output", "directions" },
          { "model.pinned", "2" },
          { "model.orientation_of", "edges" },
          END },
        { COSSERAT, { "model.space", "world" }, { "scene.grooms", "[wavy, curly]" }, { "model.pinned", "2" }, END },
    };
    for (int family = 0; family < 2; family++)
        for (int k = 0; k < 3; k++) {
            trial s = begin(NULL, families[family], sets[k]);
            hg_tensor *unweighted;
            double joule[2][HG_HAIR_TERMS];
            const int two = k == 2;
            s.task->consecutive = 1;
            filled f = fill(&s, 2, (int32_t[]){ 0, two }, (int64_t[]){ 3, 18 });
            for (int stirred = 0; stirred < 2; stirred++) {
                if (stirred) stir(&s);
                hg_step_reset(s.ctx);
                if (!hg_hair_energy(s.task, s.ctx, f.batch, &s.task->subset, &unweighted)) fail_msg("%s", hg_message());
                OK(hg_tensor_read(unweighted, joule[stirred]));
            }
            for (int t = 0; t < s.task->terms.n; t++) {
                const char *name = s.task->terms.term[t].energy->name;
                if (strcmp(name, "gravity") && !(fabs(joule[0][t]) < 1e-6 * joule[1][t]))
                    fail_msg("family %d, set %d: %s is %g J at the posed groom, %g J away from it", family, k, name,
                             joule[0][t], joule[1][t]);
            }
            const int64_t V = s.task->groom->vertices;
            assert_int_equal(s.task->outputs, 7 * (V - s.task->pinned));
            hg_free(f.bytes);
            end(&s);
        }
}

/* The frame of an edge points along it, and neighbours differ by the shortest turn. */
static void edge_frames_follow_the_strand(void **state)
{
    (void)state;
    const float strand[5][3] = {
        { 0, 0, 0 }, { 0, 0.01F, 0 }, { 0.01F, 0.01F, 0 }, { 0.01F, 0.01F, -0.01F }, { 0, 0, 0 }
    };
    float q[4][4];
    hg_hair_edge_frames(strand[0], 5, q[0]);
    for (int v = 0; v < 4; v++) {
        const hg_quatd frame = hg_quatd_make((double)q[v][0], (double)q[v][1], (double)q[v][2], (double)q[v][3]);
        const hg_vec3d along = hg_quatd_rotate(frame, hg_vec3d_make(0, 0, 1));
        double e[3], length = 0;
        for (int k = 0; k < 3; k++) e[k] = (double)(strand[v + 1][k] - strand[v][k]), length += e[k] * e[k];
        assert_true(fabs(along.x - e[0] / sqrt(length)) < 1e-6 && fabs(along.y - e[1] / sqrt(length)) < 1e-6 &&
                    fabs(along.z - e[2] / sqrt(length)) < 1e-6);
    }
    /* three turns by 90 degrees about -z, y and so on: the frame has turned about the edge too, as a carried one does */
    const hg_quatd a = hg_quatd_make((double)q[0][0], (double)q[0][1], (double)q[0][2], (double)q[0][3]),
                   b = hg_quatd_make((double)q[1][0], (double)q[1][1], (double)q[1][2], (double)q[1][3]);
    const hg_quatd turn = hg_quatd_mul(b, hg_quatd_conj(a));
    assert_true(fabs(turn.w - sqrt(0.5)) < 1e-6 && fabs(turn.z + sqrt(0.5)) < 1e-6);
}

/* The gradient of the whole loss in the weights, displacements, orientations and runs in it, against differences along itself
 * and along each parameter's own part of it. Energies of the past are left out: their gradient is detached. */
static void gradients_are_right(void **state)
{
    (void)state;
    static const setting sets[2][14] = {
        { COSSERAT,
          { "losses.pose_reg.weight", "1" },
          { "training.consecutive", "3" },
          { "model.pinned", "2" },
          { "losses.integrity.weight", "1" },
          { "losses.angular.weight", "1" },
          { "scene.grooms", "[wavy, curly]" },
          END },
        { COSSERAT,
          { "losses.pose_reg.weight", "1" },
          { "training.consecutive", "3" },
          { "model.output", "directions" },
          { "losses.pose_reg.stiffness", "0.1" },
          { "model.orientation_of", "edges" },
          END },
    };
    for (int family = 0; family < 2; family++)
        for (int k = 0; k < 2; k++) {
            trial s = begin(NULL, families[family], sets[k]);
            stir(&s);
            const hg_model *model = s.task->model;
            const int64_t weights = hg_model_weights(model);
            float *g = malloc((size_t)weights * sizeof *g);
            filled f = fill(&s, 2, (int32_t[]){ 0, k == 0 }, (int64_t[]){ 3, 18 });
            double loss;
            gradient_of(&s, f.batch, &loss, g);
            const float *part = g;
            for (int i = 0; i < model->n_params; part += hg_tensor_count(model->params[i++])) {
                hg_tensor *w = model->params[i];
                const int64_t n = hg_tensor_count(w);
                float *kept = malloc((size_t)n * sizeof *kept), *moved = malloc((size_t)n * sizeof *moved);
                double norm = 0, value[2], best = 1e9, slope = 0;
                OK(hg_tensor_read(w, kept));
                for (int64_t j = 0; j < n; j++) norm += (double)part[j] * (double)part[j];
                norm = sqrt(norm);
                for (double step = 1e-2; step > 5e-4 && best > 2e-3 * norm; step *= 0.3) {
                    for (int side = 0; side < 2; side++) {
                        hg_tensor *unweighted, *at;
                        for (int64_t j = 0; j < n; j++)
                            moved[j] = (float)((double)kept[j] + (side ? -1 : 1) * step * (double)part[j] / norm);
                        OK(hg_tensor_write(w, moved));
                        hg_step_reset(s.ctx);
                        at = hg_hair_energy(s.task, s.ctx, f.batch, &s.task->subset, &unweighted);
                        if (!at) fail_msg("%s", hg_message());
                        value[side] = hg_tensor_item(at, 0);
                    }
                    const double numeric = (value[0] - value[1]) / (2 * step);
                    if (fabs(numeric - norm) < best) best = fabs(numeric - norm), slope = numeric;
                }
                OK(hg_tensor_write(w, kept));
                if (!(norm > 0 && best < 5e-3 * norm))
                    fail_msg("family %d, set %d, %s: gradient %g, differences %g", family, k, w->name, norm, slope);
                free(kept);
                free(moved);
            }
            hg_free(f.bytes);
            free(g);
            end(&s);
        }
}

/* A few steps make the Cosserat energies of a stirred network fall; its run can be judged by other energies, and says what it
 * predicts. A network without orientations cannot be judged by energies of orientations. */
static void orientations_are_learnt(void **state)
{
    (void)state;
    static const setting set[] = { COSSERAT,
                                   { "model.output", "directions" },
                                   { "model.pinned", "2" },
                                   { "training.steps", "60" },
                                   { "training.warm_up", "5" },
                                   { "losses.unit_quaternion.stiffness", "1e-4" },
                                   END };
    static const char *const other[] = { "losses.cosserat_stretch_shear.weight=0",
                                         "losses.cosserat_bend_twist.weight=0", "losses.unit_quaternion.weight=0",
                                         "losses.bend_twist.weight=1", "losses.integrity.weight=1" };
    for (int family = 0; family < 2; family++) {
        const char *name = family ? "rods_of_grooms" : "rods";
        trial s = begin(name, families[family], set);
        stir(&s);
        hg_train_options options = hg_hair_train_options(s.task);
        hg_train_result result;
        const hg_task *task = hg_hair_task_of(s.task);
        hg_report before = { 0 }, after = { 0 };
        OK(task->validate(task->self, s.ctx, hg_hair_model(s.task), &before));
        OK(hg_train(s.ctx, hg_hair_model(s.task), task, &options, NULL, &result));
        OK(task->validate(task->self, s.ctx, hg_hair_model(s.task), &after));
        static const char *const terms[] = { "validation", "validation.cosserat_stretch_shear" };
        for (int i = 0; i < 2; i++)
            if (!(hg_report_get(&after, terms[i]) < 0.5 * hg_report_get(&before, terms[i])))
                fail_msg("family %d: %s %g, before %g", family, terms[i], hg_report_get(&after, terms[i]),
                         hg_report_get(&before, terms[i]));
        end(&s);

        char path[400];
        hg_hair_metrics own, judged;
        double shape[HG_SHAPES];
        snprintf(path, sizeof path, "%s/%s", test_folder(), name);
        for (int judge = 0; judge < 2; judge++) {
            OK(hg_ctx_create(&s.ctx, &(hg_ctx_options){ .threads = 1, .seed = 1, .device = test_device() }));
            OK(hg_hair_task_open_with(&s.task, s.ctx, path, judge ? 5 : 0, other, NULL));
            assert_true(s.task->orientations);
            hg_hair_held_out_shape(s.task, 0, shape);
            OK(hg_hair_evaluate(s.task, s.ctx, hg_hair_clip(s.task, true, 0), shape, 6, judge ? &judged : &own, NULL));
            end(&s);
        }
        assert_int_equal(own.n_terms, 4);
        assert_int_equal(judged.n_terms, 3);
        assert_true(own.length_error == judged.length_error && own.tip_moved == judged.tip_moved);
        for (int t = 0; t < own.n_terms; t++)
            assert_true(!strcmp(own.term[t], "gravity") || own.term_posed[t] < 1e-3 * own.term_energy[t]);
    }
    static const setting without[] = { COSSERAT, { "model.orientations", "no" }, END };
    refused(without, "asks for the orientations of edges, and this network has none");
}

/* What an exported network says: rows of displacements, then of turns o; the orientation of an edge is R o q0. */
static void exported_rows_have_turns(void **state)
{
    (void)state;
    static const setting set[] = { COSSERAT, { "model.pinned", "2" }, { "model.output", "directions" }, END };
    trial s = begin(NULL, of_strands, set);
    stir(&s);
    const hg_hair_task *task = s.task;
    enum { S = 30, E = 6 };
    const int own = hg_hair_strand_inputs(task), columns = own + task->layout.frame_inputs;
    const double shape[HG_SHAPES] = { 0.4, -0.2 };
    float *raw = malloc((size_t)(S * columns) * sizeof *raw), *strand = malloc((size_t)(S * own) * sizeof *strand),
          *frame = malloc((size_t)columns * sizeof *frame), *rows = malloc(sizeof(float) * S * E * 7),
          *q = malloc(sizeof(float) * S * E * 4), *rest = malloc(sizeof(float) * S * E * 4),
          *root = malloc(sizeof(float) * S * 4);
    assert_int_equal(task->subset.n, S);
    assert_int_equal(hg_hair_turns(task), E * 4);
    OK(hg_hair_strand_features(s.task, s.ctx, NULL, S, strand));
    OK(hg_hair_frame_features(s.task, s.ctx, task->clips[0][1].motion, 12, shape, frame));
    for (int i = 0; i < S; i++) {
        memcpy(raw + i * columns, strand + i * own, (size_t)own * sizeof *raw);
        memcpy(raw + i * columns + own, frame, (size_t)task->layout.frame_inputs * sizeof *raw);
    }
    hg_no_grad_begin(s.ctx);
    const hg_tensor *out =
        hg_hair_forward_concatenated(s.task, s.ctx, hg_tensor_from(s.ctx, HG_F32, 2, (int64_t[]){ S, columns }, raw));
    if (!out) fail_msg("%s", hg_message());
    assert_int_equal(hg_tensor_count(out), S * E * 7);
    OK(hg_tensor_read(out, rows));

    float *normal = malloc((size_t)task->layout.frame_inputs * sizeof *normal);
    hg_hair_normalise_frame(task, frame, normal);
    for (int i = 0; i < S; i++) { /* any rotation will do */
        const hg_quatd turn = hg_quatd_from_rotation_vector(hg_vec3d_make(0.1 * i, 0.3, -0.05 * i));
        root[4 * i] = (float)turn.w, root[4 * i + 1] = (float)turn.x, root[4 * i + 2] = (float)turn.y,
                 root[4 * i + 3] = (float)turn.z;
    }
    hg_tensor *made;
    const hg_hair_part part = hg_hair_part_of(task, s.ctx, &task->subset);
    hg_hair_predict_edges(task, s.ctx, &part, NULL,
                          hg_tensor_from(s.ctx, HG_F32, 2, (int64_t[]){ 1, task->layout.frame_inputs }, normal),
                          task->subset.rest, hg_tensor_from(s.ctx, HG_F32, 3, (int64_t[]){ 1, S, 4 }, root),
                          hg_tensor_from(s.ctx, HG_F32, 3, (int64_t[]){ 1, S, 3 }, root), &made);
    if (!made) fail_msg("%s", hg_message());
    OK(hg_tensor_read(made, q));
    OK(hg_tensor_read(task->subset.edges, rest));
    hg_no_grad_end(s.ctx);
    double turned = 0;
    for (int i = 0; i < S * E; i++) {
        double a[4], b[4], c[4], d[4];
        for (int k = 0; k < 4; k++) {
            a[k] = (double)root[i / E * 4 + k];
            b[k] = (double)rows[i / E * E * 7 + E * 3 + i % E * 4 + k];
            c[k] = (double)rest[4 * i + k];
            d[k] = (double)q[4 * i + k];
        }
        const hg_quatd r = hg_quatd_mul(hg_quatd_load(a), hg_quatd_mul(hg_quatd_load(b), hg_quatd_load(c)));
        assert_true(fabs(r.w - d[0]) + fabs(r.x - d[1]) + fabs(r.y - d[2]) + fabs(r.z - d[3]) < 1e-5);
        if (i % E == 0) assert_true(b[0] == 1 && b[1] == 0 && b[2] == 0 && b[3] == 0); /* pinned */
        turned = fmax(turned, fabs(b[1]));
    }
    assert_true(turned > 1e-3);
    free(raw);
    free(strand);
    free(frame);
    free(rows);
    free(q);
    free(rest);
    free(root);
    free(normal);
    end(&s);
}

/* ---- ghosts ---------------------------------------------------------------------------------------------------- */

/* Springs to ghosts are at rest where the posed groom is. */
static void ghosts_are_the_posed_groom(void **state)
{
    (void)state;
    static const setting set[] = {
        { "losses.integrity.weight", "1" }, { "losses.angular.weight", "1" }, { "scene.grooms", "[wavy, short]" }, END
    };
    trial s = begin(NULL, of_strands, set);
    filled f = fill(&s, 2, (int32_t[]){ 0, 1 }, (int64_t[]){ 3, 18 });
    hg_tensor *unweighted;
    double joule[2][HG_HAIR_TERMS];
    for (int stirred = 0; stirred < 2; stirred++) {
        if (stirred) stir(&s);
        hg_step_reset(s.ctx);
        if (!hg_hair_energy(s.task, s.ctx, f.batch, &s.task->subset, &unweighted)) fail_msg("%s", hg_message());
        OK(hg_tensor_read(unweighted, joule[stirred]));
    }
    for (int t = 0; t < s.task->terms.n; t++)
        assert_true(!strcmp(s.task->terms.term[t].energy->name, "gravity") || joule[0][t] < 1e-5 * joule[1][t]);
    hg_free(f.bytes);
    end(&s);
}

/* ---- locks ----------------------------------------------------------------------------------------------------- */

static void locks_off_drops_their_codes(void **state)
{
    (void)state;
    static const setting off[] = { { "features.locks", "false" }, END };
    trial with = begin(NULL, of_strands, NULL), without = begin("no_locks", of_strands, off);
    const hg_feature *a, *b;
    const int n = hg_hair_features(with.task, &a), m = hg_hair_features(without.task, &b);
    assert_int_equal(m, n - 4);
    int kept = 0;
    for (int i = 0; i < n; i++) {
        if (!strncmp(a[i].name, "z_lock", 6)) continue;
        assert_string_equal(a[i].name, b[kept].name);
        assert_true(a[i].mean == b[kept].mean && a[i].deviation == b[kept].deviation && b[kept].first == kept);
        kept++;
    }
    assert_int_equal(kept, m);
    float rows[2][30 * 10];
    OK(hg_hair_strand_features(with.task, with.ctx, NULL, 30, rows[0]));
    OK(hg_hair_strand_features(without.task, without.ctx, NULL, 30, rows[1]));
    for (int s = 0; s < 30; s++) assert_memory_equal(rows[0] + s * 10, rows[1] + s * 6, 6 * sizeof(float));
    hg_train_options options = hg_hair_train_options(without.task);
    hg_train_result result;
    OK(hg_train(without.ctx, hg_hair_model(without.task), hg_hair_task_of(without.task), &options, NULL, &result));
    end(&with);
    end(&without);
}

/* ---- runs of before -------------------------------------------------------------------------------------------- */

/* A run folder whose config knows none of these options is opened as it was. */
static void older_runs_are_opened(void **state)
{
    (void)state;
    trial s = begin("older", of_strands, NULL);
    hg_train_options options = hg_hair_train_options(s.task);
    hg_train_result result;
    hg_hair_metrics metrics[2];
    double shape[HG_SHAPES];
    OK(hg_train(s.ctx, hg_hair_model(s.task), hg_hair_task_of(s.task), &options, NULL, &result));
    end(&s);
    char path[400], file[420];
    snprintf(path, sizeof path, "%s/older", test_folder());
    snprintf(file, sizeof file, "%s/config.yaml", path);
    for (int old = 0; old < 2; old++) {
        if (old) {
            char *text = NULL;
            size_t size;
            hg_text kept = { 0 };
            int left_out = 0;
            OK(hg_file_read(file, (void **)&text, &size));
            for (char *line = strtok(text, "\n"); line; line = strtok(NULL, "\n")) {
                const bool new =
                    strstr(line, "consecutive:") || strstr(line, "orientation") || strstr(line, "  locks:");
                left_out += new;
                if (!new) hg_text_add(&kept, "%s\n", line);
            }
            assert_int_equal(left_out, 5);
            OK(hg_file_write(file, kept.data, kept.size));
            hg_free(text);
            hg_text_free(&kept);
        }
        OK(hg_ctx_create(&s.ctx, &(hg_ctx_options){ .threads = 1, .seed = 1, .device = test_device() }));
        OK(hg_hair_task_open(&s.task, s.ctx, path, NULL));
        hg_hair_held_out_shape(s.task, 0, shape);
        OK(hg_hair_evaluate(s.task, s.ctx, hg_hair_clip(s.task, true, 0), shape, 6, &metrics[old], NULL));
        end(&s);
    }
    assert_true(metrics[0].energy == metrics[1].energy && metrics[0].energy != metrics[0].energy_posed);
}

static void wrong_configs(void **state)
{
    (void)state;
    static const setting odd[] = { { "training.consecutive", "4" }, END },
                         long_runs[] = { { "training.consecutive", "60" }, { "training.frames", "60" }, END },
                         one[] = { { "losses.pose_reg.weight", "1" }, END };
    refused(odd, "the 6 frames of a step (training.frames) are not whole runs of 4");
    refused(long_runs, "a run of 60 frames does not fit into");
    refused(one, "pose_reg compares frames that follow each other");
}

/* ---- shapes of strands ------------------------------------------------------------------------------------------ */

static void curl_and_tips(void **state)
{
    (void)state;
    const float bent[4][3] = { { 0, 0, 0 }, { 0.01F, 0, 0 }, { 0.01F, 0.01F, 0 }, { 0.02F, 0.01F, 0 } },
                straight[4][3] = { { 0, 0, 0 }, { 0.01F, 0, 0 }, { 0.02F, 0, 0 }, { 0.03F, 0, 0 } };
    const double lengths[3] = { 0.01, 0.01, 0.01 };
    hg_hair_metrics metrics = { 0 };
    hg_hair_segments sum = { 0 };
    hg_hair_segments_add(&sum, 1, 4, bent[0], bent[0], lengths);
    hg_hair_segments_mean(&sum, &metrics);
    assert_true(fabs(metrics.curl - 1) < 1e-9 && metrics.tip_moved == 0 && metrics.length_error < 1e-4);
    hg_hair_segments_add(&sum, 1, 4, straight[0], bent[0], lengths);
    hg_hair_segments_mean(&sum, &metrics);
    assert_true(fabs(metrics.curl - 0.5) < 1e-6); /* a strand that kept it, and one without any */
    assert_true(fabs(metrics.tip_moved - 50 * sqrt(2) / 3) < 1e-4);
    assert_true(fabs(metrics.orientation - 90.0 / 6) < 1e-4);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(runs_are_their_frames),
        cmocka_unit_test(steps_draw_runs),
        cmocka_unit_test(a_step_of_runs_is_that_of_its_frames),
        cmocka_unit_test(pose_reg_is_judged_in_runs),
        cmocka_unit_test(zero_offsets_are_the_posed_frames),
        cmocka_unit_test(edge_frames_follow_the_strand),
        cmocka_unit_test(gradients_are_right),
        cmocka_unit_test(orientations_are_learnt),
        cmocka_unit_test(exported_rows_have_turns),
        cmocka_unit_test(ghosts_are_the_posed_groom),
        cmocka_unit_test(locks_off_drops_their_codes),
        cmocka_unit_test(older_runs_are_opened),
        cmocka_unit_test(wrong_configs),
        cmocka_unit_test(curl_and_tips),
    };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
