/* solvers: minima that are known (a hanging chain, a cantilever), the same minimum from several starts, judged by the energy
 * alone; a saddle that is left; strands that hold each other; a pendulum step by step; refusals; threads. */
#include "hairgrad.h"

#include "geometry/vector.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

enum { S = 24, V = 16, N = S * V * 3 };
static const double edge = 0.005, density = 6.5e-6, g = 9.81;

typedef struct {
    hg_ctx *ctx;
    hg_physics *physics;
    hg_tensor *x;
    double mass[S * V];
    int64_t strands;
} scene;

static void make(scene *s, int threads, const double *rest, int64_t strands, const hg_term *terms, int n)
{
    *s = (scene){ .strands = strands };
    assert_int_equal(hg_ctx_create(&s->ctx, &(hg_ctx_options){ .threads = threads, .seed = 1 }), HG_OK);
    for (int64_t i = 0; i < strands * V; i++) s->mass[i] = density * edge * (i % V == 0 || i % V == V - 1 ? 0.5 : 1);
    const hg_groom_data data = { .grooms = 1, .strands = strands, .vertices = V, .rest = rest, .mass = s->mass };
    if (hg_physics_create(&s->physics, s->ctx, HG_F64, terms, n, &data) != HG_OK) fail_msg("%s", hg_message());
    s->x = hg_tensor_create(s->ctx, HG_F64, 4, (int64_t[]){ 1, strands, V, 3 });
    assert_int_equal(hg_tensor_write(s->x, rest), HG_OK);
}

static void drop(scene *s)
{
    hg_tensor_destroy(s->x);
    hg_physics_destroy(s->physics);
    hg_ctx_destroy(s->ctx);
}

static hg_solution solve(scene *s, const hg_minimise_options *options, const hg_frame *frame, hg_minimised *first)
{
    hg_minimiser *m;
    hg_solution found;
    const hg_frame still = { 0 };
    if (hg_minimiser_create(&m, s->ctx, s->physics, 1, s->strands, V, options) != HG_OK ||
        hg_minimise(m, frame ? frame : &still, s->x, &found) != HG_OK)
        fail_msg("%s", hg_message());
    if (first) *first = found.strand[0];
    hg_minimiser_destroy(m);
    hg_step_reset(s->ctx);
    return found;
}

static double energy_of(scene *s, const hg_tensor *x)
{
    double terms[4], sum = 0;
    const hg_frame still = { 0 };
    assert_int_equal(hg_physics_evaluate(s->physics, s->ctx, &still, (hg_tensor *)(uintptr_t)x, terms, NULL, NULL),
                     HG_OK);
    for (int t = 0; t < hg_physics_terms(s->physics); t++) sum += terms[t] * hg_physics_term(s->physics, t)->weight;
    hg_step_reset(s->ctx);
    return sum;
}

static void straight(double *rest, double dx, double dy)
{
    for (int v = 0; v < V; v++) rest[3 * v] = edge * v * dx, rest[3 * v + 1] = edge * v * dy, rest[3 * v + 2] = 0;
}

static int chain_terms(hg_term *terms, double *numbers, double bend, bool curl)
{
    static const char *const options[] = { "published", "free", NULL };
    memcpy(numbers, (double[]){ 2, bend, 0, -g, 0 }, 5 * sizeof *numbers);
    terms[0] = (hg_term){ hg_energy_find("stretch"), 1, numbers, NULL };
    terms[1] = (hg_term){ hg_energy_find("gravity"), 1, numbers + 2, NULL };
    terms[2] =
        (hg_term){ hg_energy_find(curl ? "bend_twist_chain" : "bend_twist"), 1, numbers + 1, curl ? NULL : options };
    return 3;
}

/* Every edge is longer by the weight below it over k; the energy follows. */
static void test_hanging_chain(void **state)
{
    (void)state;
    double rest[V * 3], numbers[5];
    hg_term terms[3];
    scene s;
    straight(rest, 0, -1);
    chain_terms(terms, numbers, 1e-8, false);
    make(&s, 1, rest, 1, terms, 3);
    for (int v = 2; v < V; v++) /* bent aside and stretched */
        ((double *)s.x->data)[3 * v] = 0.004 * sin(0.3 * v), ((double *)s.x->data)[3 * v + 1] *= 1.02;
    hg_minimised strand;
    const hg_solution found = solve(&s, &(hg_minimise_options){ .pinned = 2, .movement = 1e-11 }, NULL, &strand);
    assert_int_equal(found.converged, 1);
    double energy = 0, y = -edge, below = 0;
    for (int v = 1; v < V; v++) below += s.mass[v] * g;
    energy = s.mass[1] * g * y;
    for (int v = 2; v < V; v++) {
        below -= s.mass[v - 1] * g;
        y -= edge + below / 2;
        energy += below * below / 4 + s.mass[v] * g * y; /* k/2 (F/k)^2 with k = 2 N/m */
        assert_true(fabs(((double *)s.x->data)[3 * v + 1] - y) < 1e-10);
        assert_true(fabs(((double *)s.x->data)[3 * v]) < 1e-9);
    }
    assert_true(fabs(strand.after - energy) < 1e-9 * fabs(energy));
    assert_true(strand.after < strand.before && strand.force < 1e-12 && strand.iterations > 0);
    drop(&s);
}

/* A light cantilever sinks by w L^4 / (8 EI) where it is thin enough for that formula; the first edge is held. */
static void test_cantilever(void **state)
{
    (void)state;
    double rest[V * 3], numbers[5];
    hg_term terms[3];
    scene s;
    straight(rest, 1, 0);
    chain_terms(terms, numbers, 2e-6, false); /* stiff: it sinks by 0.2 mm */
    make(&s, 1, rest, 1, terms, 3);
    assert_int_equal(solve(&s, &(hg_minimise_options){ .pinned = 2 }, NULL, NULL).converged, 1);
    /* the same sum in edges: each joint turns by moment / (EI / l) */
    double angle = 0, sunk = 0;
    for (int joint = 1; joint + 1 < V; joint++) {
        double moment = 0;
        for (int v = joint + 1; v < V; v++) moment += s.mass[v] * g * edge * (v - joint);
        angle += moment * edge / 2e-6;
        sunk += edge * angle;
    }
    const double tip = -((double *)s.x->data)[3 * V - 2], length = edge * (V - 2);
    assert_true(fabs(tip / sunk - 1) < 0.01);
    assert_true(fabs(tip / (density * g * pow(length, 4) / (8 * 2e-6)) - 1) <
                0.2); /* and the continuous beam, up to its edges */
    drop(&s);
}

static void curled(double *rest)
{
    for (int i = 0; i < S; i++)
        for (int v = 0; v < V; v++) {
            double *p = rest + (i * V + v) * 3;
            const double turn = 0.7 * v + i, lean = 0.2 + 0.05 * i;
            p[0] = 0.02 * i + 0.7 * edge * v * sin(lean) + 0.003 * (cos(turn) - cos((double)i));
            p[1] = 0.7 * edge * v * cos(lean) + 0.003 * (sin(turn) - sin((double)i));
            p[2] = 0.002 * sin(0.9 * v);
        }
}

/* Judged by nothing but values of the energy: no direction goes down, and the slope is zero. */
static void is_minimum(scene *s, int pinned)
{
    const double middle = energy_of(s, s->x), h = 2e-5;
    double *x = s->x->data, kept[N], way[N];
    memcpy(kept, x, sizeof kept);
    for (int trial = 0; trial < 30; trial++) {
        double up[2];
        for (int k = 0; k < N; k++) way[k] = k / 3 % V < pinned ? 0 : hg_random_normal(3, (uint64_t)trial, (uint64_t)k);
        for (int side = 0; side < 2; side++) {
            for (int k = 0; k < N; k++) x[k] = kept[k] + (side ? -h : h) * way[k];
            hg_tensor_touch(s->x);
            up[side] = energy_of(s, s->x) - middle;
        }
        assert_true(up[0] > 0 && up[1] > 0);
        assert_true(fabs(up[0] - up[1]) < 0.02 * (up[0] + up[1]));
    }
    memcpy(x, kept, sizeof kept);
    hg_tensor_touch(s->x);
}

static void test_curled_from_anywhere(void **state)
{
    (void)state;
    double rest[N], numbers[5], reference[N];
    hg_term terms[3];
    scene s;
    curled(rest);
    chain_terms(terms, numbers, 1e-8, true);
    make(&s, 1, rest, S, terms, 3);
    double energy = 0;
    for (int from = 0; from < 3; from++) {
        double *x = s.x->data;
        memcpy(x, rest, sizeof rest);
        for (int k = 0; k < N; k++)
            if (k / 3 % V >= 2) {
                if (from == 1) x[k] += 2e-4 * hg_random_normal(5, 0, (uint64_t)k);
                if (from == 2 && k % 3 == 1) x[k] -= 5e-4 * (double)(k / 3 % V - 1); /* leaning down */
            }
        hg_tensor_touch(s.x);
        hg_minimised first;
        const hg_solution found = solve(&s, &(hg_minimise_options){ .pinned = 2, .movement = 1e-10 }, NULL, &first);
        assert_int_equal(found.converged, S);
        assert_true(found.after < found.before && found.movement <= 1e-10 && found.force < 1e-9);
        for (int k = 0; k < N; k++)
            if (k / 3 % V < 2) assert_true(x[k] == rest[k]); /* to the bit */
        if (!from) energy = found.after, memcpy(reference, x, sizeof reference), is_minimum(&s, 2);
        assert_true(fabs(found.after - energy) < 1e-9 * fabs(energy));
        for (int k = 0; k < N; k++) assert_true(fabs(x[k] - reference[k]) < 1e-6);
    }
    drop(&s);
}

/* A soft hair that stands upright is in balance, but does not stay so. */
static void test_leaves_a_saddle(void **state)
{
    (void)state;
    double rest[V * 3], numbers[5];
    hg_term terms[3];
    scene s;
    straight(rest, 0, 1);
    chain_terms(terms, numbers, 1e-9, false);
    make(&s, 1, rest, 1, terms, 3);
    hg_minimised strand;
    const hg_solution found = solve(&s, &(hg_minimise_options){ .pinned = 2 }, NULL, &strand);
    assert_int_equal(found.converged, 1);
    const double *tip = (const double *)s.x->data + 3 * (V - 1);
    assert_true(sqrt(tip[0] * tip[0] + tip[2] * tip[2]) > 5 * edge);
    assert_true(strand.after < strand.before);
    drop(&s);
}

/* Strands that hold each other are one problem. */
static void test_together(void **state)
{
    (void)state;
    double rest[N], numbers[5];
    hg_term terms[4];
    scene s;
    curled(rest);
    for (int k = 0; k < N; k += 3) rest[k] -= 0.018 * (k / 3 / V); /* 2 mm apart */
    chain_terms(terms, numbers, 1e-8, true);
    terms[3] = (hg_term){ hg_energy_find("adhesion"), 1, (double[]){ 1e-5, 0.004, 5 }, NULL };
    make(&s, 1, rest, S, terms, 4);
    const hg_solution found = solve(&s, &(hg_minimise_options){ .pinned = 2 }, NULL, NULL);
    assert_int_equal(found.converged, S);
    assert_true(found.after < found.before && found.force < 1e-8);
    is_minimum(&s, 2);
    drop(&s);
}

/* ---- orientations ------------------------------------------------------------------------------------------------ */

/* Frames of the edges, carried along the strand from the z axis. */
static void edge_frames(const double *x, int64_t strands, double *q)
{
    for (int64_t i = 0; i < strands; i++) {
        hg_vec3d before = { 0, 0, 1 };
        hg_quatd frame = hg_quatd_identity();
        for (int64_t v = 0; v + 1 < V; v++) {
            const double *at = x + (i * V + v) * 3;
            const hg_vec3d t = hg_vec3d_normalize(hg_vec3d_sub(hg_vec3d_load(at + 3), hg_vec3d_load(at)));
            frame = hg_quatd_mul(hg_quatd_transport(before, t), frame);
            hg_quatd_store(q + (i * (V - 1) + v) * 4, frame);
            before = t;
        }
    }
}

/* The same hair with free orientations: stretch 2 N/m, bending 1e-8 N m^2. */
static void rod_terms(hg_term terms[4], double numbers[6], double unit)
{
    memcpy(numbers, (double[]){ 2 * edge * edge, 1e-8 * edge, unit, 0, -g, 0 }, 6 * sizeof *numbers);
    terms[0] = (hg_term){ hg_energy_find("cosserat_stretch_shear"), 1, numbers, NULL };
    terms[1] = (hg_term){ hg_energy_find("cosserat_bend_twist"), 1, numbers + 1, NULL };
    terms[2] = (hg_term){ hg_energy_find("unit_quaternion"), 1, numbers + 2, NULL };
    terms[3] = (hg_term){ hg_energy_find("gravity"), 1, numbers + 3, NULL };
}

static hg_solution solve_rods(scene *s, hg_tensor *q, const hg_minimise_options *options)
{
    const hg_frame_input input = { "q", q };
    return solve(s, options, &(hg_frame){ .inputs = &input, .n_inputs = 1 }, NULL);
}

/* Straight hair bends in a plane: a rod whose edges hardly shear is the hair of stretch and bend_twist, in place and energy; its
 * orientations follow the edges. From another start, too, and by Adam on the way there. */
static void test_rod_without_twist(void **state)
{
    (void)state;
    double rest[V * 3], numbers[6], hair[V * 3], q0[(V - 1) * 4];
    hg_term terms[4];
    scene s;
    straight(rest, 1, 0);
    chain_terms(terms, numbers, 1e-8, false);
    make(&s, 1, rest, 1, terms, 3);
    const hg_solution expected = solve(&s, &(hg_minimise_options){ .pinned = 2 }, NULL, NULL);
    memcpy(hair, s.x->data, sizeof hair);
    drop(&s);
    rod_terms(terms, numbers, 1e-2);
    make(&s, 1, rest, 1, terms, 4);
    edge_frames(rest, 1, q0);
    hg_tensor *q = hg_tensor_create(s.ctx, HG_F64, 4, (int64_t[]){ 1, 1, V - 1, 4 });
    double after = 0;
    for (int from = 0; from < 3; from++) {
        double *x = s.x->data;
        assert_int_equal(hg_tensor_write(s.x, rest), HG_OK);
        assert_int_equal(hg_tensor_write(q, q0), HG_OK);
        for (int v = 2; from && v < V; v++) x[3 * v + 1] -= 0.002 * (v - 1);
        if (from == 1) edge_frames(x, 1, q->data);
        memcpy(q->data, q0, 4 * sizeof *q0);
        const hg_solution found = solve_rods(&s, q, &(hg_minimise_options){ .pinned = 2, .evaluations = 20000 });
        assert_int_equal(found.converged, 1);
        assert_true(found.after < expected.after); /* it may shear */
        assert_true(expected.after - found.after < 2e-3 * (expected.before - expected.after));
        if (from) assert_true(fabs(found.after - after) < 1e-9 * fabs(after));
        after = found.after;
        for (int k = 0; k < V * 3; k++) assert_true(fabs(x[k] - hair[k]) < 5e-5); /* the tip sinks by 30 mm */
        assert_memory_equal(q->data, q0, 4 * sizeof *q0);                         /* that of the held edge */
        for (int v = 1; v + 1 < V; v++) {
            const hg_vec3d t = hg_quatd_rotate(hg_quatd_load((double *)q->data + 4 * v), hg_vec3d_make(0, 0, 1));
            const hg_vec3d e = hg_vec3d_sub(hg_vec3d_load(x + 3 * v + 3), hg_vec3d_load(x + 3 * v));
            assert_true(hg_vec3d_norm(hg_vec3d_cross(t, hg_vec3d_normalize(e))) < 2e-3);
        }
    }
    assert_int_equal(hg_tensor_write(s.x, rest), HG_OK);
    assert_int_equal(hg_tensor_write(q, q0), HG_OK);
    const hg_solution adam =
        solve_rods(&s, q, &(hg_minimise_options){ .method = HG_ADAM, .pinned = 2, .evaluations = 500 });
    assert_true(adam.after < adam.before && adam.after > after && adam.converged == 0);
    hg_tensor_destroy(q);
    drop(&s);
}

/* Curled rods: the minimum is that of the position-based rods, another method altogether; and no way from it leads down. */
static void test_rods_two_ways(void **state)
{
    (void)state;
    double rest[N], numbers[6], place[N];
    hg_term terms[4];
    scene s;
    curled(rest);
    rod_terms(terms, numbers, 1);
    make(&s, 2, rest, S, terms, 4);
    const hg_groom_data data = { .grooms = 1, .strands = S, .vertices = V, .rest = rest, .mass = s.mass };
    hg_xpbd *xpbd;
    hg_xpbd_solution rods;
    if (hg_xpbd_create(&xpbd, s.ctx, terms, 4, &data, &(hg_xpbd_options){ .pinned = 2, .movement = 1e-12 }) != HG_OK ||
        hg_xpbd_rest(xpbd, &(hg_frame){ 0 }, s.x, &rods) != HG_OK)
        fail_msg("%s", hg_message());
    assert_int_equal(rods.at_rest, S);
    memcpy(place, s.x->data, sizeof place);
    hg_tensor *q = hg_tensor_create(s.ctx, HG_F64, 4, (int64_t[]){ 1, S, V - 1, 4 });
    edge_frames(rest, S, q->data);
    assert_int_equal(hg_tensor_write(s.x, rest), HG_OK);
    const hg_solution found = solve_rods(&s, q, &(hg_minimise_options){ .pinned = 2, .evaluations = 40000 });
    assert_int_equal(found.converged, S);
    for (int k = 0; k < N; k++) assert_true(fabs(((double *)s.x->data)[k] - place[k]) < 1e-6);
    for (int i = 0; i < S * (V - 1); i++) { /* q and -q are one */
        const double *a = (double *)q->data + 4 * i, *b = rods.orientation + 4 * i;
        assert_true(fabs(fabs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]) - 1) < 1e-5);
    }
    hg_xpbd_destroy(xpbd);
    hg_tensor_destroy(q);
    drop(&s);
}

static void test_orientations_refused(void **state)
{
    (void)state;
    double rest[V * 3], numbers[6];
    hg_term terms[4];
    scene s;
    straight(rest, 1, 0);
    rod_terms(terms, numbers, 1e-2);
    make(&s, 1, rest, 1, terms, 4);
    hg_minimiser *m;
    assert_int_equal(hg_minimiser_create(&m, s.ctx, s.physics, 1, 1, V, NULL), HG_OK);
    assert_int_equal(hg_minimise(m, &(hg_frame){ 0 }, s.x, NULL), HG_INVALID);
    assert_non_null(strstr(hg_message(), "bring q"));
    hg_tensor *q = hg_tensor_create(s.ctx, HG_F64, 4, (int64_t[]){ 1, 1, V - 1, 4 });
    edge_frames(rest, 1, q->data);
    ((double *)q->data)[4 * 3] = (double)NAN;
    const hg_frame_input input = { "q", q };
    assert_int_equal(hg_minimise(m, &(hg_frame){ .inputs = &input, .n_inputs = 1 }, s.x, NULL), HG_NUMERIC);
    assert_non_null(strstr(hg_message(), "edge 3"));
    assert_memory_equal(s.x->data, rest, sizeof rest);
    hg_tensor *narrow = hg_tensor_create(s.ctx, HG_F64, 4, (int64_t[]){ 1, 1, V, 4 });
    const hg_frame_input wrong = { "q", narrow };
    assert_int_equal(hg_minimise(m, &(hg_frame){ .inputs = &wrong, .n_inputs = 1 }, s.x, NULL), HG_INVALID);
    hg_tensor_destroy(narrow);
    hg_tensor_destroy(q);
    hg_minimiser_destroy(m);
    drop(&s);
}

static void test_adam_is_honest(void **state)
{
    (void)state;
    double rest[N], numbers[5];
    hg_term terms[3];
    scene s;
    curled(rest);
    chain_terms(terms, numbers, 1e-8, true);
    make(&s, 1, rest, S, terms, 3);
    const hg_solution adam =
        solve(&s, &(hg_minimise_options){ .method = HG_ADAM, .pinned = 2, .evaluations = 300 }, NULL, NULL);
    assert_true(adam.after < adam.before);
    assert_true(adam.converged < S && adam.movement > 1e-6);
    const hg_solution lbfgs = solve(&s, &(hg_minimise_options){ .pinned = 2 }, NULL, NULL);
    assert_true(lbfgs.after < adam.after && lbfgs.converged == S);
    drop(&s);
}

static void run_threads(int threads, double *x, hg_solution *found)
{
    double rest[N], numbers[5];
    hg_term terms[4];
    scene s;
    curled(rest);
    chain_terms(terms, numbers, 1e-8, true);
    make(&s, threads, rest, S, terms, 3);
    *found = solve(&s, &(hg_minimise_options){ .pinned = 2 }, NULL, NULL);
    memcpy(x, s.x->data, N * sizeof *x);
    drop(&s);
}

static void test_threads(void **state)
{
    (void)state;
    double one[N], two[N];
    hg_solution a, b;
    run_threads(1, one, &a);
    run_threads(2, two, &b);
    assert_memory_equal(one, two, sizeof one);
    assert_true(a.after == b.after && a.evaluations == b.evaluations);
}

static void test_refusals_and_memory(void **state)
{
    (void)state;
    double rest[N], numbers[5], before[N];
    hg_term terms[3];
    scene s;
    curled(rest);
    chain_terms(terms, numbers, 1e-8, true);
    make(&s, 1, rest, S, terms, 3);
    hg_minimiser *m;
    const hg_frame still = { 0 };
    assert_int_equal(hg_minimiser_create(&m, s.ctx, s.physics, 1, S, V, &(hg_minimise_options){ .pinned = 2 }), HG_OK);
    ((double *)s.x->data)[3 * (5 * V + 7) + 1] = (double)NAN;
    memcpy(before, s.x->data, sizeof before);
    assert_int_equal(hg_minimise(m, &still, s.x, NULL), HG_NUMERIC);
    assert_non_null(strstr(hg_message(), "strand 5, vertex 7"));
    assert_memory_equal(before, s.x->data, sizeof before);
    hg_tensor *narrow = hg_tensor_create(s.ctx, HG_F32, 4, (int64_t[]){ 1, S, V, 3 });
    assert_int_equal(hg_minimise(m, &still, narrow, NULL), HG_INVALID);
    hg_tensor_destroy(narrow);

    int64_t taken[2];
    for (int k = 0; k < 2; k++) {
        assert_int_equal(hg_tensor_write(s.x, rest), HG_OK);
        taken[k] = hg_alloc_count();
        assert_int_equal(hg_minimise(m, &still, s.x, NULL), HG_OK);
        taken[k] = hg_alloc_count() - taken[k];
        hg_step_reset(s.ctx);
    }
    assert_int_equal(taken[1], 0);
    hg_minimiser_destroy(m);
    assert_int_equal(hg_minimiser_create(&m, s.ctx, s.physics, 1, -1, V, NULL), HG_INVALID);
    assert_null(m);

    assert_int_equal(hg_tensor_write(s.x, rest), HG_OK); /* all is held: nothing to do */
    hg_solution found = solve(&s, &(hg_minimise_options){ .pinned = V }, NULL, NULL);
    assert_int_equal(found.converged, S);
    assert_memory_equal(rest, s.x->data, sizeof rest);
    drop(&s);
}

/* ---- a pendulum: all of the mass in the tip of a stiff chain that is held at its first vertex ---------------------- */

/* Angle after `time` from 0.5 rad at rest: Runge-Kutta. */
static double swing(double time, double length)
{
    double a = 0.5, w = 0;
    const int steps = 20000;
    const double h = time / steps;
    for (int i = 0; i < steps; i++) {
        const double a1 = w, w1 = -g / length * sin(a), a2 = w + h / 2 * w1, w2 = -g / length * sin(a + h / 2 * a1);
        const double a3 = w + h / 2 * w2, w3 = -g / length * sin(a + h / 2 * a2), a4 = w + h * w3,
                     w4 = -g / length * sin(a + h * a3);
        a += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4);
        w += h / 6 * (w1 + 2 * w2 + 2 * w3 + w4);
    }
    return a;
}

static double step_pendulum(int steps, double time)
{
    enum { P = 2 };
    hg_ctx *ctx;
    hg_physics *physics;
    hg_minimiser *m;
    const double length = 0.1, rest[P * 3] = { 0, 0, 0, length * sin(0.5), -length * cos(0.5), 0 },
                 mass[P] = { 0, 1e-5 };
    const hg_term terms[] = { { hg_energy_find("stretch"), 1, (double[]){ 2000 }, NULL },
                              { hg_energy_find("gravity"), 1, NULL, NULL },
                              { hg_energy_find("inertia"), 1, NULL, NULL } };
    const hg_groom_data data = { .grooms = 1, .strands = 1, .vertices = P, .rest = rest, .mass = mass };
    const int64_t shape[4] = { 1, 1, P, 3 };
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1, .seed = 1 }), HG_OK);
    assert_int_equal(hg_physics_create(&physics, ctx, HG_F64, terms, 3, &data), HG_OK);
    assert_int_equal(hg_minimiser_create(&m, ctx, physics, 1, 1, P, NULL), HG_OK);
    hg_tensor *x = hg_tensor_create(ctx, HG_F64, 4, shape), *predicted = hg_tensor_create(ctx, HG_F64, 4, shape);
    double before[P * 3], older[P * 3];
    memcpy(before, rest, sizeof rest), memcpy(older, rest, sizeof rest);
    assert_int_equal(hg_tensor_write(x, rest), HG_OK);
    for (int t = 0; t < steps; t++) {
        double guess[P * 3];
        for (int k = 0; k < P * 3; k++) guess[k] = 2 * before[k] - older[k];
        assert_int_equal(hg_tensor_write(predicted, guess), HG_OK);
        hg_solution found;
        const hg_frame frame = { .predicted = predicted, .dt = time / steps };
        if (hg_minimise(m, &frame, x, &found) != HG_OK) fail_msg("%s", hg_message());
        assert_int_equal(found.converged, 1);
        memcpy(older, before, sizeof older);
        assert_int_equal(hg_tensor_read(x, before), HG_OK);
        hg_step_reset(ctx);
    }
    hg_tensor_destroy(x);
    hg_tensor_destroy(predicted);
    hg_minimiser_destroy(m);
    hg_physics_destroy(physics);
    hg_ctx_destroy(ctx);
    return atan2(before[3], -before[4]);
}

/* Implicit Euler comes to the pendulum as its step does. */
static void test_pendulum(void **state)
{
    (void)state;
    const double time = 0.3, exact = swing(time, 0.1), coarse = step_pendulum(150, time) - exact,
                 fine = step_pendulum(300, time) - exact;
    assert_true(exact < -0.3); /* it has swung to the other side */
    assert_true(fabs(fine) < 0.02);
    assert_true(coarse / fine > 1.8 && coarse / fine < 2.2);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_hanging_chain),
        cmocka_unit_test(test_cantilever),
        cmocka_unit_test(test_curled_from_anywhere),
        cmocka_unit_test(test_leaves_a_saddle),
        cmocka_unit_test(test_together),
        cmocka_unit_test(test_rod_without_twist),
        cmocka_unit_test(test_rods_two_ways),
        cmocka_unit_test(test_orientations_refused),
        cmocka_unit_test(test_adam_is_honest),
        cmocka_unit_test(test_threads),
        cmocka_unit_test(test_refusals_and_memory),
        cmocka_unit_test(test_pendulum),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
