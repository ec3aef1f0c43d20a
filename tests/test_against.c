/* tasks: a drape beside solvers. Fakes that are known: the solver's own result, the posed groom, hair that is late, that swings
 * half as far, that learnt no motion; energies against those of the solve; who is refused; threads. */
#include "geometry/vector.h"
#include "hairgrad.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

static const char tiny[] = "scene:\n"
                           "  style: wavy\n"
                           "  strands: 120\n"
                           "  vertices: 10\n"
                           "  seconds: 2 s\n"
                           "  motion_kinds: [nod]\n"
                           "  held_out_kinds: [shake]\n"
                           "model:\n"
                           "  width: 16\n"
                           "  pinned: 2\n"
                           "features:\n"
                           "  history: 2\n"
                           "  encoder_width: 16\n"
                           "  encoder_steps: 1\n"
                           "losses:\n"
                           "  stretch: { stiffness: 2 N/m }\n"
                           "  bend_twist: { stiffness: 1e-8 N*m^2 }\n"
                           "  gravity: {}\n"
                           "  inertia: {}\n"
                           "  drag: { c: 3 1/s }\n"
                           "  body_collision: { stiffness: 30 J/m^3, mode: exact, rest_clearance: true }\n"
                           "training:\n"
                           "  strands: 32\n";

enum { SETTLE = 5, FRAMES = 24, POSES = 3, STRANDS = 20 };

typedef enum { PERFECT, POSED, LATE, HALF, RESTING, OTHERS } fake_kind;

typedef struct {
    hg_ctx *ctx;
    hg_hair_task *task;
    fake_kind kind;
} fixture;

typedef enum {
    MOVES,
    STANDS,
    RODS,
    COUPLED
} physics_kind; /* RODS: orientations of their own; COUPLED: strands feel each other; at rest */

static void begin(fixture *s, int threads, physics_kind kind)
{
    static const char *const rods[][2] = { { "losses.stretch.weight", "0" },
                                           { "losses.bend_twist.weight", "0" },
                                           { "losses.cosserat_stretch_shear.weight", "1" },
                                           { "losses.cosserat_stretch_shear.stiffness", "5e-5" },
                                           { "losses.cosserat_bend_twist.weight", "1" },
                                           { "losses.cosserat_bend_twist.stiffness", "1.5e-10" },
                                           { "losses.unit_quaternion.weight", "1" },
                                           { "losses.unit_quaternion.stiffness", "1e-3" } };
    int n;
    const hg_config_row *rows = hg_hair_schema(&n);
    hg_config *config;
    *s = (fixture){ 0 };
    assert_int_equal(hg_ctx_create(&s->ctx, &(hg_ctx_options){ .threads = threads, .seed = 1 }), HG_OK);
    if (hg_config_parse(&config, tiny, "tiny.yaml", rows, n) != HG_OK) fail_msg("%s", hg_message());
    if (kind != MOVES) {
        assert_int_equal(hg_config_set(config, "losses.inertia.weight", "0"), HG_OK);
        assert_int_equal(hg_config_set(config, "losses.drag.weight", "0"), HG_OK);
    }
    if (kind == COUPLED) {
        assert_int_equal(hg_config_set(config, "losses.adhesion.weight", "1"), HG_OK);
        assert_int_equal(hg_config_set(config, "losses.adhesion.stiffness", "1e-6"), HG_OK);
        assert_int_equal(hg_config_set(config, "losses.adhesion.radius", "0.02"), HG_OK);
    }
    for (size_t i = 0; kind == RODS && i < sizeof rods / sizeof *rods; i++)
        if (hg_config_set(config, rods[i][0], rods[i][1]) != HG_OK) fail_msg("%s", hg_message());
    if (hg_hair_task_create(&s->task, s->ctx, config, NULL, NULL) != HG_OK) fail_msg("%s", hg_message());
    hg_config_destroy(config);
}

static void end(fixture *s)
{
    hg_hair_task_destroy(s->task);
    hg_ctx_destroy(s->ctx);
}

/* ---- fakes ------------------------------------------------------------------------------------------------------- */

typedef struct {
    fake_kind kind;
    int64_t first, seen;
    hg_drape_sink sink;
    void *to;
    float *x, *local; /* [S,V,3]; local: from their roots, a frame earlier */
} faking;

/* Where the strands were from their roots a frame earlier; in the first frame where they are. */
static void make_late(faking *f, const hg_drape_frame *frame)
{
    for (int64_t s = 0; s < frame->strands; s++) {
        const float *q = frame->root_rotation + 4 * s, *p = frame->root_position + 3 * s;
        const hg_quatd turn = hg_quatd_make((double)q[0], (double)q[1], (double)q[2], (double)q[3]);
        for (int64_t v = 0; v < frame->vertices; v++) {
            const int64_t at = (s * frame->vertices + v) * 3;
            const float *x = frame->x + at;
            const hg_vec3d now = hg_quatd_rotate(
                hg_quatd_conj(turn),
                hg_vec3d_make((double)x[0] - (double)p[0], (double)x[1] - (double)p[1], (double)x[2] - (double)p[2]));
            const float *l = f->local + at;
            const hg_vec3d then = f->seen ? hg_vec3d_make((double)l[0], (double)l[1], (double)l[2]) : now,
                           there = hg_quatd_rotate(turn, then);
            const double place[3] = { there.x, there.y, there.z }, kept[3] = { now.x, now.y, now.z };
            for (int k = 0; k < 3; k++)
                f->x[at + k] = (float)(place[k] + (double)p[k]), f->local[at + k] = (float)kept[k];
        }
    }
}

/* What the solver found, passed on as somebody else's. */
static hg_status pass_on(void *self, const hg_drape_frame *frame)
{
    faking *f = self;
    hg_drape_frame out = *frame;
    if (f->kind == LATE) make_late(f, frame), out.x = f->x;
    if (f->kind == POSED) out.x = frame->posed;
    if (f->kind == HALF) {
        for (int64_t i = 0; i < frame->strands * frame->vertices * 3; i++)
            f->x[i] = 0.5F * (frame->x[i] + frame->posed[i]);
        out.x = f->x;
    }
    f->seen++;
    return frame->frame < f->first ? HG_OK : f->sink(f->to, &out);
}

static hg_status fake(void *self, const hg_motion *motion, const double *shape, int64_t first, int64_t frames,
                      int64_t stride, hg_drape_sink sink, void *to)
{
    const fixture *s = self;
    const int64_t strands = hg_hair_groom(s->task)->strands / stride;
    const size_t n = (size_t)(strands * hg_hair_groom(s->task)->vertices) * 3;
    int32_t strand[256];
    faking f = { .kind = s->kind, .first = first, .sink = sink, .to = to };
    const bool moves = motion->frames > 1 && s->kind != RESTING;
    const int64_t before = !moves ? 0 : first < SETTLE ? first : SETTLE;
    hg_hair_solution solution;
    const hg_hair_solve_options options = {
        .dynamic = moves, .first = first - before, .frames = frames + before, .strands = strands, .strand = strand
    };
    for (int64_t i = 0; i < strands; i++) strand[i] = (int32_t)(i * stride);
    if (s->kind == OTHERS) strand[0] = motion->frames > 1;
    f.x = calloc(n, sizeof(float));
    f.local = calloc(n, sizeof(float));
    assert_true(f.x && f.local);
    const hg_status status = hg_hair_solve(s->task, s->ctx, motion, shape, &options, pass_on, &f, &solution, NULL);
    free(f.x);
    free(f.local);
    return status;
}

static const hg_against_solver lbfgs = { .name = "lbfgs" };

static hg_against compare(fixture *s, fake_kind kind, bool faked)
{
    hg_against against;
    s->kind = kind;
    const hg_against_options options = { .n_solvers = 1,
                                         .solver = &lbfgs,
                                         .poses = POSES,
                                         .frames = FRAMES,
                                         .settle = SETTLE,
                                         .strands = STRANDS,
                                         .drape = faked ? fake : NULL,
                                         .self = s };
    if (hg_hair_against(s->task, s->ctx, hg_hair_clip(s->task, true, 0), NULL, &options, &against, NULL) != HG_OK)
        fail_msg("%s", hg_message());
    return against;
}

/* ---- tests ------------------------------------------------------------------------------------------------------- */

static void known_drapes(void **state)
{
    (void)state;
    fixture s;
    begin(&s, 2, MOVES);

    hg_against a = compare(&s, PERFECT, true); /* the reference itself, to the bit */
    assert_int_equal(a.n_sides, 3);
    assert_int_equal(a.strands, STRANDS);
    assert_int_equal(a.frames, FRAMES);
    assert_string_equal(a.side[1].name, "lbfgs");
    assert_true(a.side[0].rest.excess == 0 && a.side[0].rest.gap == 0 && a.side[0].rest.distance_p95 == 0);
    assert_true(a.side[0].motion.excess == 0 && a.side[0].motion.gap == 0 && a.side[0].motion.distance_p95 == 0);
    assert_true(fabs(a.side[0].tips.correlation - 1) < 1e-12 && fabs(a.side[0].tips.lag) < 1e-9);
    assert_true(a.side[0].tips.speed == a.side[1].tips.speed && a.side[1].tips.speed > 0.05);
    assert_true(a.side[0].tips.excursion == a.side[1].tips.excursion);
    assert_true(a.side[0].rest.energy == a.side[1].rest.energy && a.side[1].rest.energy < a.side[2].rest.energy);
    assert_true(a.side[2].rest.gap == 1 && a.side[2].motion.gap == 1 && a.side[2].tips.speed < 1e-4);
    assert_true(a.side[2].rest.gap_median == 1 && a.side[2].rest.gap_free == 1 && a.side[0].motion.gap_median == 0);
    assert_true(a.side[2].rest.gap_contact == 1 && isnan(a.side[2].rest.seconds) && isnan(a.side[2].tips.lag));
    assert_true(a.side[1].motion.solves == (FRAMES + (a.first < SETTLE ? a.first : SETTLE)) * STRANDS);
    hg_hair_against_free(&a);

    a = compare(&s, POSED, true); /* the posed groom */
    assert_true(a.side[0].rest.gap_contact == 1 && a.side[0].rest.excess == a.side[2].rest.excess);
    assert_true(fabs(a.side[0].motion.gap_contact - 1) < 1e-9 && a.side[0].motion.gap > 0.99);
    assert_true(a.side[0].tips.speed < 1e-4 * a.side[1].tips.speed);
    hg_hair_against_free(&a);

    a = compare(&s, HALF, true); /* half as far off its posed place */
    assert_true(fabs(a.side[0].tips.speed / a.side[1].tips.speed - 0.5) < 1e-3);
    assert_true(fabs(a.side[0].tips.excursion / a.side[1].tips.excursion - 0.5) < 1e-3);
    assert_true(a.side[0].tips.correlation > 0.999 && fabs(a.side[0].tips.lag) < 1e-3);
    assert_true(a.side[0].motion.gap > 0.05 && a.side[0].motion.distance > 0);
    hg_hair_against_free(&a);

    a = compare(&s, LATE, true); /* a frame behind */
    assert_true(fabs(a.side[0].tips.lag - 1 / a.rate) < 0.1 / a.rate);
    assert_true(fabs(a.side[0].tips.speed / a.side[1].tips.speed - 1) < 0.15);
    assert_true(fabs(a.side[0].rest.gap) < 1e-4 && a.side[0].motion.gap > 0.05);
    hg_hair_against_free(&a);

    a = compare(&s, RESTING, true); /* at rest in every frame: it learnt no motion */
    assert_true(a.side[0].rest.gap == 0);
    assert_true(a.side[0].tips.excursion < 0.6 * a.side[1].tips.excursion);
    assert_true(a.side[0].tips.correlation < 0.3 && a.side[0].motion.gap > 0.3);
    hg_hair_against_free(&a);
    end(&s);
}

/* The energies of a side are those that the solve itself says. */
static void compare_with_solve(physics_kind kind)
{
    fixture s;
    begin(&s, 2, kind);
    hg_against a = compare(&s, PERFECT, false);
    const hg_motion *clip = hg_hair_clip(s.task, true, 0);
    int32_t strand[STRANDS];
    double energy = 0, posed = 0, gravity = 0;
    for (int i = 0; i < STRANDS; i++) strand[i] = i * 120 / STRANDS;
    for (int i = 0; i < POSES; i++) {
        const hg_hair_solve_options options = {
            .first = (2 * i + 1) * clip->frames / (2 * POSES), .frames = 1, .strands = STRANDS, .strand = strand
        };
        hg_hair_solution found;
        assert_int_equal(hg_hair_solve(s.task, s.ctx, clip, NULL, &options, NULL, NULL, &found, NULL), HG_OK);
        energy += found.metrics.energy / POSES;
        posed += found.metrics.energy_posed / POSES;
        for (int k = 0; k < found.metrics.n_terms; k++)
            if (!strcmp(found.metrics.term[k], "gravity")) gravity += found.metrics.term_energy[k] / POSES;
    }
    const double tolerance =
        (kind == COUPLED ? 1e-3 : 1e-4) * (posed - energy); /* the solve goes on to the last digit */
    assert_true(posed > energy);
    assert_true(fabs(a.side[1].rest.energy - energy) < tolerance);
    assert_true(fabs(a.side[2].rest.energy - posed) < tolerance);
    assert_true(fabs(a.side[1].rest.excess) == 0 && fabs(a.side[2].rest.excess - (posed - energy)) < 2 * tolerance);
    for (int k = 0; k < a.n_terms; k++) {
        if (!strcmp(a.term[k], "gravity")) assert_true(fabs(a.side[1].rest.term_energy[k] - gravity) < tolerance);
        assert_int_equal(a.term_moves[k], !strcmp(a.term[k], "inertia") || !strcmp(a.term[k], "drag"));
    }
    assert_true(a.side[0].rest.seconds > 0 && isfinite(a.side[0].rest.gap)); /* the network itself */
    hg_against mean;                                                         /* of two the same: it itself */
    const hg_against twice[2] = { a, a };
    hg_hair_against_mean(twice, 2, &mean);
    assert_int_equal(mean.poses, 2 * POSES);
    assert_true(fabs(mean.side[0].rest.gap - a.side[0].rest.gap) < 1e-12 * fabs(a.side[0].rest.gap));
    assert_int_equal(a.frames, kind == MOVES ? FRAMES : 0);
    if (kind == MOVES)
        assert_true(fabs(mean.side[0].motion.gap - a.side[0].motion.gap) < 1e-12 * fabs(a.side[0].motion.gap));
    assert_true(fabs(mean.side[1].tips.speed - a.side[1].tips.speed) < 1e-12 && !mean.tip);
    hg_hair_against_free(&a);
    end(&s);
}

static void energies_of_the_solve(void **state)
{
    (void)state;
    compare_with_solve(MOVES);
    compare_with_solve(RODS);
    compare_with_solve(COUPLED);
}

static void clear_times(hg_against *a)
{
    for (int k = 0; k < a->n_sides; k++) a->side[k].rest.seconds = a->side[k].motion.seconds = 0;
}

static void threads_and_rest(void **state)
{
    (void)state;
    fixture one, two;
    begin(&one, 1, MOVES);
    begin(&two, 2, MOVES);
    hg_against a = compare(&one, PERFECT, false), b = compare(&two, PERFECT, false);
    assert_memory_equal(a.tip, b.tip, (size_t)(a.n_tips * a.n_sides * a.frames) * sizeof(double));
    clear_times(&a);
    clear_times(&b);
    for (int k = 0; k < a.n_sides; k++) {
        assert_memory_equal(&a.side[k].rest, &b.side[k].rest, sizeof a.side[k].rest);
        assert_memory_equal(&a.side[k].motion, &b.side[k].motion, sizeof a.side[k].motion);
    }
    hg_hair_against_free(&a);
    hg_hair_against_free(&b);
    end(&one);
    end(&two);

    hg_against still; /* without energies that know of time there is no motion to compare */
    fixture rest;
    begin(&rest, 2, STANDS);
    const hg_against_solver several[2] = { { .name = "adam", .how.minimise = { .method = HG_ADAM, .evaluations = 60 } },
                                           lbfgs };
    const hg_against_options options = { .n_solvers = 2, .solver = several, .poses = 2, .frames = 2, .strands = 10 };
    assert_int_equal(
        hg_hair_against(rest.task, rest.ctx, hg_hair_clip(rest.task, true, 0), NULL, &options, &still, NULL), HG_OK);
    assert_int_equal(still.frames, 0);
    assert_int_equal(still.n_tips, 0);
    assert_int_equal(still.reference, 2); /* lbfgs, wherever it stands */
    assert_true(still.side[1].rest.gap > 0.1 && still.side[1].rest.converged == 0 && still.side[2].rest.gap == 0);
    hg_hair_against_free(&still);
    end(&rest);
}

static void refusals(void **state)
{
    (void)state;
    fixture s;
    hg_against a;
    begin(&s, 2, MOVES);
    const hg_motion *clip = hg_hair_clip(s.task, true, 0);
    assert_int_equal(hg_hair_against(s.task, s.ctx, clip, NULL, &(hg_against_options){ 0 }, &a, NULL), HG_INVALID);
    assert_non_null(strstr(hg_message(), "0 solvers"));
    assert_int_equal(hg_hair_against(s.task, s.ctx, clip, NULL,
                                     &(hg_against_options){ .n_solvers = 1, .solver = &lbfgs, .poses = -1 }, &a, NULL),
                     HG_INVALID);
    s.kind = OTHERS;
    const hg_against_options others = {
        .n_solvers = 1, .solver = &lbfgs, .poses = 1, .frames = 4, .strands = 10, .drape = fake, .self = &s
    };
    assert_int_equal(hg_hair_against(s.task, s.ctx, clip, NULL, &others, &a, NULL), HG_INVALID);
    assert_non_null(strstr(hg_message(), "different strands"));
    assert_null(a.tip);
    end(&s);
}

/* ---- a body that is held ----------------------------------------------------------------------------------------- */

/* Strands around a box: whatever moves between calls, held or not, the numbers are the same. */
static void held_body_changes_nothing(void **state)
{
    (void)state;
    enum { S = 9, V = 6, N = S * V * 3 };
    static const double box[8][3] = { { -1, -1, -1 }, { 1, -1, -1 }, { 1, 1, -1 }, { -1, 1, -1 },
                                      { -1, -1, 1 },  { 1, -1, 1 },  { 1, 1, 1 },  { -1, 1, 1 } };
    static const int32_t faces[12][3] = {
        { 0, 2, 1 }, { 0, 3, 2 }, { 4, 5, 6 }, { 4, 6, 7 }, { 0, 1, 5 }, { 0, 5, 4 },
        { 1, 2, 6 }, { 1, 6, 5 }, { 2, 3, 7 }, { 2, 7, 6 }, { 3, 0, 4 }, { 3, 4, 7 }
    };
    static const char *const choices[] = { "exact", NULL };
    double rest[N], vertices[24], energy[2][S * 2];
    hg_ctx *ctx;
    hg_body_tree *tree;
    hg_physics *physics[2];
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .seed = 1 }), HG_OK);
    for (int i = 0; i < N; i++) rest[i] = 0.004 * ((i / 3) % V) + 0.01 * hg_random_normal(1, 1, (uint64_t)i);
    for (int i = 0; i < 24; i++) vertices[i] = 0.02 * box[i / 3][i % 3];
    assert_int_equal(hg_body_tree_create(&tree, 8, vertices, 12, &faces[0][0]), HG_OK);
    const hg_term terms[2] = { { .energy = hg_energy_find("stretch"), .weight = 1 },
                               { .energy = hg_energy_find("body_collision"), .weight = 1, .options = choices } };
    const hg_groom_data data = { .grooms = 1, .strands = S, .vertices = V, .rest = rest, .body = tree };
    hg_tensor *x = hg_tensor_create(ctx, HG_F64, 4, (int64_t[]){ 1, S, V, 3 });
    hg_tensor *gradient[2], *body = hg_tensor_create(ctx, HG_F64, 3, (int64_t[]){ 1, 8, 3 });
    for (int k = 0; k < 2; k++) {
        if (hg_physics_create(&physics[k], ctx, HG_F64, terms, 2, &data) != HG_OK) fail_msg("%s", hg_message());
        gradient[k] = hg_tensor_create(ctx, HG_F64, 4, (int64_t[]){ 1, S, V, 3 });
    }
    assert_int_equal(hg_tensor_write(x, rest), HG_OK);
    assert_int_equal(hg_tensor_write(body, vertices), HG_OK);
    const hg_frame frame = { .body_vertices = body, .dt = 1.0 / 30 };
    double *at = x->data, contact = 0;
    for (int round = 0; round < 12; round++) {
        if (round == 0 || round == 7) hg_physics_hold_body(physics[0], true);
        if (round == 5) hg_physics_hold_body(physics[0], false); /* for two calls */
        if (round == 7) {                                        /* and the body goes elsewhere */
            for (int i = 0; i < 24; i++) vertices[i] += 0.005;
            assert_int_equal(hg_tensor_write(body, vertices), HG_OK);
        }
        for (int i = 0; i < N; i++)
            if ((i / 3) % 4 == round % 4) at[i] += 0.002 * hg_random_normal(2, (uint64_t)round, (uint64_t)i);
        hg_tensor_touch(x);
        for (int k = 0; k < 2; k++) {
            assert_int_equal(hg_physics_evaluate(physics[k], ctx, &frame, x, NULL, energy[k], gradient[k]), HG_OK);
            hg_step_reset(ctx);
        }
        assert_memory_equal(energy[0], energy[1], sizeof energy[0]);
        assert_memory_equal(gradient[0]->data, gradient[1]->data, N * sizeof(double));
        for (int i = 0; i < S; i++) contact += energy[0][2 * i + 1];
    }
    assert_true(contact > 0);
    for (int k = 0; k < 2; k++) {
        hg_physics_destroy(physics[k]);
        hg_tensor_destroy(gradient[k]);
    }
    hg_tensor_destroy(x);
    hg_tensor_destroy(body);
    hg_body_tree_destroy(tree);
    hg_ctx_destroy(ctx);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(known_drapes), cmocka_unit_test(energies_of_the_solve),     cmocka_unit_test(threads_and_rest),
        cmocka_unit_test(refusals),     cmocka_unit_test(held_body_changes_nothing),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
