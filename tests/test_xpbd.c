/* xpbd: places that are known (a hanging chain, a cantilever), the way to the minimum that L-BFGS finds, a curled groom that comes
 * back to rest, a pendulum, a body that moves into hair, strands that keep their distance; q and -q, threads, refusals. */
#include "hairgrad.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

enum { S = 11, V = 16, N = S * V * 3 };
static const double edge = 0.005, density = 6.5e-6, g = 9.81;

typedef struct {
    hg_ctx *ctx;
    hg_tensor *x;
    double mass[S * V];
    hg_groom_data data;
} scene;

static void make(scene *s, int threads, const double *rest, int64_t strands)
{
    *s = (scene){ 0 };
    assert_int_equal(hg_ctx_create(&s->ctx, &(hg_ctx_options){ .threads = threads, .seed = 1 }), HG_OK);
    for (int64_t i = 0; i < strands * V; i++) s->mass[i] = density * edge * (i % V == 0 || i % V == V - 1 ? 0.5 : 1);
    s->data = (hg_groom_data){ .grooms = 1, .strands = strands, .vertices = V, .rest = rest, .mass = s->mass };
    s->x = hg_tensor_create(s->ctx, HG_F64, 4, (int64_t[]){ 1, strands, V, 3 });
    assert_int_equal(hg_tensor_write(s->x, rest), HG_OK);
}

static void drop(scene *s)
{
    hg_tensor_destroy(s->x);
    hg_ctx_destroy(s->ctx);
}

/* numbers: stretch, bend, gravity */
static void chain_terms(hg_term terms[3], double numbers[5], double stretch, double bend, const char *energy,
                        const char *const *options)
{
    memcpy(numbers, (double[]){ stretch, bend, 0, -g, 0 }, 5 * sizeof *numbers);
    terms[0] = (hg_term){ hg_energy_find("stretch"), 1, numbers, NULL };
    terms[1] = (hg_term){ hg_energy_find(energy), 1, numbers + 1, options };
    terms[2] = (hg_term){ hg_energy_find("gravity"), 1, numbers + 2, NULL };
}

static hg_xpbd *start(const scene *s, const hg_term *terms, int n, const hg_xpbd_options *options)
{
    hg_xpbd *xpbd;
    if (hg_xpbd_create(&xpbd, s->ctx, terms, n, &s->data, options) != HG_OK) fail_msg("%s", hg_message());
    return xpbd;
}

static hg_xpbd_solution rest_of(scene *s, const hg_term *terms, int n, const hg_xpbd_options *options,
                                const hg_frame *frame)
{
    const hg_frame still = { 0 };
    hg_xpbd *xpbd = start(s, terms, n, options);
    hg_xpbd_solution found;
    if (hg_xpbd_rest(xpbd, frame ? frame : &still, s->x, &found) != HG_OK) fail_msg("%s", hg_message());
    found.orientation = NULL;
    hg_xpbd_destroy(xpbd);
    hg_step_reset(s->ctx);
    return found;
}

/* The energy of the terms, and their minimum by L-BFGS, whose place x gets. */
static double energy_of(scene *s, const hg_term *terms, int n, double *minimum, double *at)
{
    const hg_frame still = { 0 };
    hg_physics *physics;
    double each[4], sum = 0;
    assert_int_equal(hg_physics_create(&physics, s->ctx, HG_F64, terms, n, &s->data), HG_OK);
    assert_int_equal(hg_physics_evaluate(physics, s->ctx, &still, s->x, each, NULL, NULL), HG_OK);
    for (int t = 0; t < n; t++) sum += each[t];
    if (minimum) {
        hg_minimiser *m;
        hg_solution found;
        hg_tensor *x = hg_tensor_create(s->ctx, HG_F64, 4, s->x->shape);
        assert_int_equal(hg_tensor_copy(x, s->x), HG_OK);
        assert_int_equal(
            hg_minimiser_create(&m, s->ctx, physics, 1, s->data.strands, V, &(hg_minimise_options){ .pinned = 2 }),
            HG_OK);
        assert_int_equal(hg_minimise(m, &still, x, &found), HG_OK);
        assert_int_equal(found.converged, s->data.strands);
        *minimum = found.after;
        assert_int_equal(hg_tensor_read(x, at), HG_OK);
        hg_minimiser_destroy(m);
        hg_tensor_destroy(x);
    }
    hg_physics_destroy(physics);
    hg_step_reset(s->ctx);
    return sum;
}

static void straight(double *rest, double dx, double dy)
{
    for (int v = 0; v < V; v++) rest[3 * v] = edge * v * dx, rest[3 * v + 1] = edge * v * dy, rest[3 * v + 2] = 0;
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

/* ---- places that are known --------------------------------------------------------------------------------------- */

/* Every edge is longer by the weight below it over k. */
static void test_hanging_chain(void **state)
{
    (void)state;
    double rest[V * 3], numbers[5];
    hg_term terms[3];
    scene s;
    straight(rest, 0, -1);
    chain_terms(terms, numbers, 2, 1e-8, "bend_twist", NULL);
    make(&s, 1, rest, 1);
    for (int v = 2; v < V; v++) /* bent aside and stretched */
        ((double *)s.x->data)[3 * v] = 0.004 * sin(0.3 * v), ((double *)s.x->data)[3 * v + 1] *= 1.02;
    const hg_xpbd_solution found = rest_of(&s, terms, 3, &(hg_xpbd_options){ .pinned = 2, .movement = 1e-12 }, NULL);
    assert_true(found.at_rest == 1 && found.steps < 100 && found.movement < 1e-12);
    double y = -edge, below = 0;
    for (int v = 1; v < V; v++) below += s.mass[v] * g;
    for (int v = 2; v < V; v++) {
        below -= s.mass[v - 1] * g;
        y -= edge + below / 2;
        assert_true(fabs(((double *)s.x->data)[3 * v + 1] - y) < 1e-10);
        assert_true(fabs(((double *)s.x->data)[3 * v]) < 1e-9);
    }
    drop(&s);
}

/* A light cantilever whose joints turn by moment / (EI / l), its first edge held; and the beam that they stand for. */
static void test_cantilever(void **state)
{
    (void)state;
    static const char *const names[] = { "bend_twist", "bend_twist_chain", "cosserat_bend_twist" };
    static const char *const smooth[] = { "smooth", "free", NULL };
    for (int kind = 0; kind < 4; kind++) {
        double rest[V * 3], numbers[5];
        hg_term terms[3];
        scene s;
        straight(rest, 1, 0);
        chain_terms(terms, numbers, 2000, kind == 2 ? 2e-6 / edge * edge * edge : 2e-6, names[kind % 3],
                    kind == 3 ? smooth : NULL);
        if (kind == 2) numbers[1] = 2e-6 * edge;
        make(&s, 1, rest, 1);
        assert_int_equal(rest_of(&s, terms, 3, &(hg_xpbd_options){ .pinned = 2, .movement = 1e-12 }, NULL).at_rest, 1);
        double angle = 0, sunk = 0;
        for (int joint = 1; joint + 1 < V; joint++) {
            double moment = 0;
            for (int v = joint + 1; v < V; v++) moment += s.mass[v] * g * edge * (v - joint);
            angle += moment * edge / 2e-6;
            sunk += edge * angle;
        }
        const double tip = -((double *)s.x->data)[3 * V - 2], length = edge * (V - 2);
        assert_true(fabs(tip / sunk - 1) < 0.002);
        assert_true(fabs(tip / (density * g * pow(length, 4) / (8 * 2e-6)) - 1) < 0.2);
        drop(&s);
    }
}

/* Straight hair bends in a plane and does not twist: a rod with free orientations, but for its shear, is the hair of `stretch` and
 * `bend_twist`. Steps bring it there, and sweeps of Gauss-Seidel come nearer the more there are. */
static void test_way_to_the_minimum(void **state)
{
    (void)state;
    double rest[V * 3], numbers[5], minimum, at[V * 3], gap[3];
    hg_term terms[3];
    scene s;
    straight(rest, 1, 0);
    chain_terms(terms, numbers, 2, 1e-8, "bend_twist", NULL);
    make(&s, 1, rest, 1);
    const double first = energy_of(&s, terms, 3, &minimum, at);
    const int64_t steps[3] = { 3, 8, 60 };
    for (int k = 0; k < 3; k++) {
        assert_int_equal(hg_tensor_write(s.x, rest), HG_OK);
        rest_of(&s, terms, 3, &(hg_xpbd_options){ .pinned = 2, .steps = steps[k], .movement = 1e-12 }, NULL);
        gap[k] = (energy_of(&s, terms, 3, NULL, NULL) - minimum) / (first - minimum);
    }
    assert_true(gap[0] > 2 * gap[1] && gap[1] > 100 * gap[2] && gap[2] > 0 && gap[2] < 1e-4);
    for (int k = 0; k < V * 3; k++)
        assert_true(fabs(((double *)s.x->data)[k] - at[k]) < 1e-4); /* of 32 mm that the tip sinks */
    const int sweeps[3] = { 10, 100, 1000 };
    for (int k = 0; k < 3; k++) {
        assert_int_equal(hg_tensor_write(s.x, rest), HG_OK);
        rest_of(&s, terms, 3,
                &(hg_xpbd_options){ .pinned = 2, .sweeps = true, .substeps = 20, .iterations = sweeps[k], .steps = 40 },
                NULL);
        gap[k] = (energy_of(&s, terms, 3, NULL, NULL) - minimum) / (first - minimum);
    }
    assert_true(gap[0] > 5 * gap[1] && gap[1] > 1.5 * gap[2] && gap[2] > 0 && gap[2] < 0.1);
    drop(&s);
}

/* Curled hair that cannot untwist is that of `bend_twist_chain`: the same place as L-BFGS finds for its points alone. */
static void test_curled_minimum(void **state)
{
    (void)state;
    static const char *const strains[][3] = { { "published", "free" }, { "smooth", "free" } };
    for (int kind = 0; kind < 2; kind++) {
        double rest[N], numbers[5], minimum, at[N];
        hg_term terms[3];
        scene s;
        curled(rest);
        chain_terms(terms, numbers, 2, 1e-8, "bend_twist_chain", strains[kind]);
        make(&s, 2, rest, S);
        const double first = energy_of(&s, terms, 3, &minimum, at);
        assert_int_equal(rest_of(&s, terms, 3, &(hg_xpbd_options){ .pinned = 2, .movement = 1e-11 }, NULL).at_rest, S);
        const double gap = (energy_of(&s, terms, 3, NULL, NULL) - minimum) / (first - minimum);
        assert_true(gap > 0 && gap < 0.01);
        double moved = 0, off = 0;
        for (int k = 0; k < N; k++) {
            moved = fmax(moved, fabs(at[k] - rest[k]));
            off = fmax(off, fabs(((double *)s.x->data)[k] - at[k]));
        }
        assert_true(moved > 3e-3 && off < 5e-5);
        drop(&s);
    }
}

/* Without weight a curled groom goes back to where it was made, from a place that has little to do with it. */
static void test_returns(void **state)
{
    (void)state;
    static const char *const options[][3] = { { "published", "free" }, { "smooth", "clamped" } };
    static const char *const names[] = { "bend_twist_chain", "bend_twist" };
    for (int kind = 0; kind < 2; kind++) {
        double rest[N], numbers[5];
        hg_term terms[3];
        scene s;
        curled(rest);
        chain_terms(terms, numbers, 2, 1e-8, names[kind], options[kind]);
        make(&s, 1, rest, S);
        double *x = s.x->data;
        const int pinned = 2 - kind;
        for (int k = 0; k < N; k++)
            if (k / 3 % V >= pinned)
                x[k] += 4e-4 * hg_random_normal(5, 0, (uint64_t)k) + (k % 3 == 2 ? 6e-4 : 0) * (k / 3 % V - 1);
        const hg_xpbd_solution found =
            rest_of(&s, terms, 2, &(hg_xpbd_options){ .pinned = pinned, .movement = 1e-11 }, NULL);
        assert_int_equal(found.at_rest, S);
        for (int k = 0; k < N; k++) assert_true(fabs(x[k] - rest[k]) < 1e-8);
        for (int i = 0; i < S; i++)
            for (int v = 0; v < pinned * 3; v++) assert_true(x[i * V * 3 + v] == rest[i * V * 3 + v]);
        drop(&s);
    }
}

/* A spring to the posed groom: what hangs on it alone sinks by m g / 2k. */
static void test_style(void **state)
{
    (void)state;
    double rest[V * 3], near[V];
    scene s;
    straight(rest, 0, -1);
    make(&s, 1, rest, 1);
    for (int v = 0; v < V; v++) near[v] = 0.004;
    s.data.attributes = (const hg_groom_attribute[]){ { "body_distance", near } };
    s.data.n_attributes = 1;
    const double numbers[] = { 1e-9, 0, -g, 0, 0.005, 8e-3 };
    const hg_term terms[] = { { hg_energy_find("stretch"), 1, numbers, NULL },
                              { hg_energy_find("gravity"), 1, numbers + 1, NULL },
                              { hg_energy_find("hair_style"), 1, numbers + 4, NULL } };
    for (int sweeps = 0; sweeps < 2; sweeps++) {
        assert_int_equal(hg_tensor_write(s.x, rest), HG_OK);
        rest_of(&s, terms, 3, &(hg_xpbd_options){ .sweeps = sweeps, .movement = 1e-12 }, NULL);
        for (int v = 1; v < V; v++) {
            const double sunk = rest[3 * v + 1] - ((double *)s.x->data)[3 * v + 1];
            assert_true(fabs(sunk - s.mass[v] * g / 0.005) < 1e-3 * sunk); /* half of the spring's 2k is left at 4 mm */
        }
    }
    drop(&s);
}

/* ---- motion ------------------------------------------------------------------------------------------------------ */

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

/* A stiff edge with all of the mass at its tip, nine frames. */
static double pendulum(bool sweeps, int substeps)
{
    enum { P = 2 };
    const double length = 0.1, rest[P * 3] = { 0, 0, 0, length * sin(0.5), -length * cos(0.5), 0 },
                 mass[P] = { 0, 1e-5 };
    const hg_term terms[] = { { hg_energy_find("stretch"), 1, (double[]){ 2000 }, NULL },
                              { hg_energy_find("gravity"), 1, NULL, NULL } };
    const hg_groom_data data = { .grooms = 1, .strands = 1, .vertices = P, .rest = rest, .mass = mass };
    const hg_frame still = { 0 };
    hg_ctx *ctx;
    hg_xpbd *xpbd;
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1, .seed = 1 }), HG_OK);
    assert_int_equal(
        hg_xpbd_create(&xpbd, ctx, terms, 2, &data,
                       &(hg_xpbd_options){ .sweeps = sweeps, .substeps = substeps, .iterations = sweeps ? 20 : 2 }),
        HG_OK);
    hg_tensor *x = hg_tensor_create(ctx, HG_F64, 4, (int64_t[]){ 1, 1, P, 3 });
    assert_int_equal(hg_tensor_write(x, rest), HG_OK);
    assert_int_equal(hg_xpbd_place(xpbd, &still, x), HG_OK);
    for (int frame = 0; frame < 9; frame++)
        if (hg_xpbd_step(xpbd, &still, x, NULL) != HG_OK) fail_msg("%s", hg_message());
    const double *at = x->data, angle = atan2(at[3], -at[4]);
    assert_true(fabs(sqrt(at[3] * at[3] + at[4] * at[4]) - length) < 1e-5 && fabs(at[5]) < 1e-12);
    hg_tensor_destroy(x);
    hg_xpbd_destroy(xpbd);
    hg_ctx_destroy(ctx);
    return angle;
}

static void test_pendulum(void **state)
{
    (void)state;
    const double exact = swing(0.3, 0.1);
    assert_true(exact < -0.3); /* it has swung to the other side */
    const double coarse = pendulum(false, 20) - exact, fine = pendulum(false, 40) - exact;
    assert_true(fabs(coarse) < 0.03 && coarse / fine > 1.8 && coarse / fine < 2.3);
    assert_true(fabs(pendulum(true, 80) - exact) < 0.05); /* the inertia of the edge itself is 4 % there */
}

/* One substep a frame, solved to its end, is the time-stepped minimum of the inertial energy, that L-BFGS finds. */
static void test_time_steps(void **state)
{
    (void)state;
    double rest[V * 3], numbers[7], before[V * 3], older[V * 3];
    hg_term terms[5];
    scene s;
    straight(rest, 1, 0);
    chain_terms(terms, numbers, 20, 1e-8, "bend_twist", NULL);
    numbers[5] = 3;
    terms[3] = (hg_term){ hg_energy_find("drag"), 1, numbers + 5, NULL };
    terms[4] = (hg_term){ hg_energy_find("inertia"), 1, NULL, NULL };
    make(&s, 1, rest, 1);
    hg_physics *physics;
    hg_minimiser *m;
    assert_int_equal(hg_physics_create(&physics, s.ctx, HG_F64, terms, 5, &s.data), HG_OK);
    assert_int_equal(hg_minimiser_create(&m, s.ctx, physics, 1, 1, V, &(hg_minimise_options){ .pinned = 2 }), HG_OK);
    hg_tensor *x = hg_tensor_create(s.ctx, HG_F64, 4, s.x->shape),
              *guess = hg_tensor_create(s.ctx, HG_F64, 4, s.x->shape),
              *last = hg_tensor_create(s.ctx, HG_F64, 4, s.x->shape);
    assert_int_equal(hg_tensor_write(x, rest), HG_OK);
    memcpy(before, rest, sizeof before), memcpy(older, rest, sizeof older);
    hg_xpbd *xpbd = start(&s, terms, 5, &(hg_xpbd_options){ .pinned = 2, .substeps = 1, .iterations = 30 });
    const hg_frame still = { .dt = 1.0 / 60 };
    assert_int_equal(hg_xpbd_place(xpbd, &still, s.x), HG_OK);
    double sunk = 0;
    for (int t = 0; t < 12; t++) {
        double predicted[V * 3];
        for (int k = 0; k < V * 3; k++) predicted[k] = 2 * before[k] - older[k];
        assert_int_equal(hg_tensor_write(guess, predicted), HG_OK);
        assert_int_equal(hg_tensor_write(last, before), HG_OK);
        const hg_frame frame = { .predicted = guess, .previous = last, .dt = 1.0 / 60 };
        hg_solution found;
        if (hg_minimise(m, &frame, x, &found) != HG_OK) fail_msg("%s", hg_message());
        assert_int_equal(found.converged, 1);
        memcpy(older, before, sizeof older);
        assert_int_equal(hg_tensor_read(x, before), HG_OK);
        hg_step_reset(s.ctx);
        if (hg_xpbd_step(xpbd, &still, s.x, NULL) != HG_OK) fail_msg("%s", hg_message());
        for (int k = 0; k < V * 3; k++) assert_true(fabs(before[k] - ((double *)s.x->data)[k]) < 2e-4);
        sunk = fmin(sunk, before[3 * V - 2]);
    }
    assert_true(sunk < -0.02); /* it has swung down */
    hg_tensor_destroy(x);
    hg_tensor_destroy(guess);
    hg_tensor_destroy(last);
    hg_xpbd_destroy(xpbd);
    hg_minimiser_destroy(m);
    hg_physics_destroy(physics);
    drop(&s);
}

/* Roots that turn: hair goes along and comes to rest in the turned place; air slows it. */
static void test_carried_along(void **state)
{
    (void)state;
    double rest[N], numbers[6];
    hg_term terms[4];
    scene s;
    curled(rest);
    chain_terms(terms, numbers, 2, 1e-8, "bend_twist_chain", NULL);
    numbers[5] = 60;
    terms[3] = (hg_term){ hg_energy_find("drag"), 1, numbers + 5, NULL };
    make(&s, 2, rest, S);
    hg_tensor *turn = hg_tensor_create(s.ctx, HG_F64, 3, (int64_t[]){ 1, S, 4 });
    hg_xpbd *one = start(&s, terms, 4, &(hg_xpbd_options){ .pinned = 2 });
    double moving[2][N];
    for (int sign = 1; sign >= -1; sign -= 2) { /* -q is the same rotation; here it changes in every frame */
        assert_int_equal(hg_tensor_write(s.x, rest), HG_OK);
        for (int frame = 0; frame < 60; frame++) {
            const double angle = frame < 10 ? 0.1 * frame : 0.9;
            for (int i = 0; i < S; i++) {
                const double flip = sign < 0 && frame & 1 ? -1 : 1,
                             q[4] = { flip * cos(angle / 2), 0, 0, flip * sin(angle / 2) };
                memcpy((double *)turn->data + 4 * i, q, sizeof q);
            }
            const hg_frame now = { .root_rotation = turn };
            hg_xpbd_solution found;
            const hg_status status =
                frame ? hg_xpbd_step(one, &now, s.x, &found) : hg_xpbd_rest(one, &now, s.x, &found);
            if (status != HG_OK) fail_msg("%s", hg_message());
            if (frame == 5) assert_int_equal(hg_tensor_read(s.x, moving[sign < 0]), HG_OK);
        }
        const double *x = s.x->data;
        for (int i = 0; i < S; i++) { /* the second vertex is held by the turned root */
            const double *r = rest + i * V * 3, *at = x + i * V * 3, e[2] = { r[3] - r[0], r[4] - r[1] };
            assert_true(fabs(at[3] - r[0] - (cos(0.9) * e[0] - sin(0.9) * e[1])) < 1e-12);
            assert_true(fabs(at[4] - r[1] - (sin(0.9) * e[0] + cos(0.9) * e[1])) < 1e-12);
        }
    }
    for (int k = 0; k < N; k++) assert_true(fabs(moving[0][k] - moving[1][k]) < 1e-12);
    const hg_frame now = { .root_rotation = turn };
    double settled[N];
    memcpy(settled, s.x->data, sizeof settled);
    hg_xpbd_solution found;
    assert_int_equal(hg_xpbd_rest(one, &now, s.x, &found), HG_OK);
    for (int k = 0; k < N; k++) assert_true(fabs(settled[k] - ((double *)s.x->data)[k]) < 2e-4);
    for (int i = 0; i < S * (V - 1); i++) {
        const double *q = found.orientation + 4 * i;
        assert_true(fabs(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] - 1) < 1e-12);
    }
    hg_xpbd_destroy(one);
    hg_tensor_destroy(turn);
    drop(&s);
}

/* ---- contact ----------------------------------------------------------------------------------------------------- */

static const int32_t box_faces[12][3] = {
    { 0, 2, 1 }, { 1, 2, 3 }, { 4, 5, 6 }, { 5, 7, 6 }, { 0, 1, 4 }, { 1, 5, 4 },
    { 2, 6, 3 }, { 3, 6, 7 }, { 0, 4, 2 }, { 2, 4, 6 }, { 1, 3, 5 }, { 3, 7, 5 }
};

static void box(double *vertices, double y)
{
    for (int k = 0; k < 8; k++) {
        vertices[3 * k] = k & 1 ? 0.3 : -0.05;
        vertices[3 * k + 1] = y + (k & 2 ? 0 : -0.1);
        vertices[3 * k + 2] = k & 4 ? 0.1 : -0.1;
    }
}

/* Hair over a box, which then moves up into it. */
static void test_contact(void **state)
{
    (void)state;
    for (int kind = 0; kind < 4; kind++) {
        double rest[N], vertices[24], numbers[5];
        hg_term terms[4];
        scene s;
        for (int i = 0; i < S * V; i++)
            rest[3 * i] = edge * (i % V), rest[3 * i + 1] = 0.01, rest[3 * i + 2] = 0.015 * (i / V) - 0.08;
        const char *const options[] = { kind & 1 ? "exact" : "plane", "false", NULL };
        chain_terms(terms, numbers, 2, 1e-8, "bend_twist", NULL);
        terms[3] = (hg_term){ hg_energy_find("body_collision"), 1, (double[]){ 30, 0.004 }, options };
        make(&s, 1, rest, S);
        hg_body_tree *tree;
        box(vertices, 0);
        assert_int_equal(hg_body_tree_create(&tree, 8, vertices, 12, box_faces[0]), HG_OK);
        s.data.body = tree;
        hg_tensor *body = hg_tensor_create(s.ctx, HG_F64, 3, (int64_t[]){ 1, 8, 3 });
        assert_int_equal(hg_tensor_write(body, vertices), HG_OK);
        const hg_frame frame = { .body_vertices = body };
        hg_xpbd *xpbd = start(&s, terms, 4, &(hg_xpbd_options){ .pinned = 2, .sweeps = kind / 2 });
        hg_xpbd_solution found;
        if (hg_xpbd_rest(xpbd, &frame, s.x, &found) != HG_OK) fail_msg("%s", hg_message());
        const double *x = s.x->data;
        for (int i = 0; i < S; i++) assert_true(x[(i * V + V - 1) * 3 + 1] < 0.004); /* it hangs down to the box */
        for (int i = 0; i < S * V; i++) assert_true(x[3 * i + 1] > 0.0005);
        if (kind < 2) {
            assert_int_equal(found.at_rest, S);
            const double depth = 0.004 - x[3 * V - 2]; /* what lies on the box has its weight on a barrier */
            assert_true(3 * 30 * depth * depth < 40 * density * edge * g);
        }
        for (int step = 1; step <= 6; step++) {
            box(vertices, 0.004 * step);
            assert_int_equal(hg_tensor_write(body, vertices), HG_OK);
            if (hg_xpbd_step(xpbd, &frame, s.x, &found) != HG_OK) fail_msg("%s", hg_message());
            for (int i = 0; i < S * V; i++)
                if (i % V > 5) assert_true(x[3 * i + 1] > 0.004 * step);
        }
        hg_xpbd_destroy(xpbd);
        hg_tensor_destroy(body);
        hg_body_tree_destroy(tree);
        drop(&s);
    }
}

/* A heavy strand beside light ones, weight that presses it against them: they keep a millimetre, those that are closer at rest do
 * not; without that distance it goes through. */
static void test_strand_distance(void **state)
{
    (void)state;
    double rest[3 * V * 3], numbers[5];
    hg_term terms[3];
    scene s;
    for (int i = 0; i < 3; i++) {
        straight(rest + i * V * 3, 0, -1);
        for (int v = 0; v < V; v++) rest[(i * V + v) * 3] = i == 0 ? 0 : i == 1 ? 0.002 : 0.0023;
    }
    chain_terms(terms, numbers, 2, 1e-8, "bend_twist", NULL);
    numbers[2] = 2;
    make(&s, 1, rest, 3);
    for (int v = 0; v < V; v++) s.mass[v] *= 20;
    double *x = s.x->data;
    rest_of(&s, terms, 3, &(hg_xpbd_options){ .pinned = 2 }, NULL);
    assert_true(x[3 * V - 3] > x[6 * V - 3] + 0.002);
    assert_int_equal(hg_tensor_write(s.x, rest), HG_OK);
    for (int v = 2; v < V; v++) x[3 * v] += 0.0015, x[3 * v + 2] += 1e-5 * v;
    hg_xpbd *xpbd = start(&s, terms, 3, &(hg_xpbd_options){ .pinned = 2, .strand_distance = 0.001 });
    const hg_frame still = { 0 };
    double pressed[3 * V * 3];
    memcpy(pressed, x, sizeof pressed);
    for (int rests = 0; rests < 2; rests++) {
        assert_int_equal(hg_tensor_write(s.x, pressed), HG_OK);
        assert_int_equal(hg_xpbd_place(xpbd, &still, s.x), HG_OK);
        assert_int_equal(rests ? hg_xpbd_rest(xpbd, &still, s.x, NULL) : hg_xpbd_step(xpbd, &still, s.x, NULL), HG_OK);
        for (int v = 3; v < V; v++) {
            const double *a = x + 3 * v, *b = x + (V + v) * 3, *c = x + (2 * V + v) * 3;
            assert_true(hypot(b[0] - a[0], hypot(b[1] - a[1], b[2] - a[2])) > 0.0009);
            assert_true(hypot(c[0] - b[0], hypot(c[1] - b[1], c[2] - b[2])) < 0.0006);
        }
    }
    hg_xpbd_destroy(xpbd);
    drop(&s);
}

/* ---- the same bits, no memory, refusals -------------------------------------------------------------------------- */

static void run_threads(int threads, bool sweeps, double *x)
{
    double rest[N], numbers[5];
    hg_term terms[3];
    scene s;
    curled(rest);
    chain_terms(terms, numbers, 2, 1e-8, "bend_twist", NULL);
    make(&s, threads, rest, S);
    hg_xpbd *xpbd =
        start(&s, terms, 3, &(hg_xpbd_options){ .pinned = 2, .sweeps = sweeps, .steps = 10, .strand_distance = 0.004 });
    const hg_frame still = { 0 };
    assert_int_equal(hg_xpbd_rest(xpbd, &still, s.x, NULL), HG_OK);
    for (int k = 0; k < 3; k++) assert_int_equal(hg_xpbd_step(xpbd, &still, s.x, NULL), HG_OK);
    memcpy(x, s.x->data, N * sizeof *x);
    hg_xpbd_destroy(xpbd);
    drop(&s);
}

static void test_threads(void **state)
{
    (void)state;
    for (int sweeps = 0; sweeps < 2; sweeps++) {
        double one[N], several[N];
        run_threads(1, sweeps, one);
        for (int threads = 2; threads < 6; threads += 3) {
            run_threads(threads, sweeps, several);
            assert_memory_equal(one, several, sizeof one);
        }
    }
}

static void test_memory(void **state)
{
    (void)state;
    double rest[N], numbers[5];
    hg_term terms[3];
    scene s;
    curled(rest);
    chain_terms(terms, numbers, 2, 1e-8, "bend_twist", NULL);
    make(&s, 2, rest, S);
    hg_xpbd *xpbd = start(&s, terms, 3, &(hg_xpbd_options){ .pinned = 2, .steps = 5 });
    const hg_frame still = { 0 };
    assert_int_equal(hg_xpbd_rest(xpbd, &still, s.x, NULL), HG_OK);
    const int64_t taken = hg_alloc_count();
    assert_int_equal(hg_xpbd_step(xpbd, &still, s.x, NULL), HG_OK);
    assert_int_equal(hg_xpbd_rest(xpbd, &still, s.x, NULL), HG_OK);
    assert_int_equal(hg_alloc_count(), taken);
    hg_xpbd_destroy(xpbd);
    drop(&s);
}

static void test_refusals(void **state)
{
    (void)state;
    double rest[N], numbers[5], before[N];
    hg_term terms[4];
    scene s;
    curled(rest);
    chain_terms(terms, numbers, 2, 1e-8, "bend_twist", NULL);
    make(&s, 1, rest, S);
    const hg_frame still = { 0 };
    hg_xpbd *xpbd;
    assert_int_equal(hg_xpbd_create(&xpbd, s.ctx, terms + 1, 2, &s.data, NULL), HG_INVALID);
    assert_non_null(strstr(hg_message(), "stretch"));
    assert_null(xpbd);
    terms[3] = (hg_term){ hg_energy_find("adhesion"), 1, NULL, NULL };
    xpbd = start(&s, terms, 4, NULL);
    assert_string_equal(hg_xpbd_left_out(xpbd), "adhesion");
    assert_int_equal(hg_xpbd_step(xpbd, &still, s.x, NULL), HG_INVALID);
    ((double *)s.x->data)[3 * (5 * V + 7) + 1] = (double)NAN;
    memcpy(before, s.x->data, sizeof before);
    assert_int_equal(hg_xpbd_rest(xpbd, &still, s.x, NULL), HG_NUMERIC);
    assert_non_null(strstr(hg_message(), "strand 5, vertex 7"));
    assert_memory_equal(before, s.x->data, sizeof before);
    hg_tensor *narrow = hg_tensor_create(s.ctx, HG_F32, 4, (int64_t[]){ 1, S, V, 3 });
    assert_int_equal(hg_xpbd_rest(xpbd, &still, narrow, NULL), HG_INVALID);
    hg_tensor_destroy(narrow);
    hg_xpbd_destroy(xpbd);
    terms[3] = (hg_term){ hg_energy_find("body_collision"), 1, NULL, NULL };
    assert_int_equal(hg_xpbd_create(&xpbd, s.ctx, terms, 4, &s.data, NULL), HG_INVALID);
    assert_non_null(strstr(hg_message(), "body"));
    drop(&s);
}

/* Edges without length, strands of one vertex, everything held, no strand at all: nothing that is not finite. */
static void test_degenerate(void **state)
{
    (void)state;
    double rest[N], numbers[5];
    hg_term terms[3];
    scene s;
    const hg_frame still = { 0 };
    curled(rest);
    for (int c = 0; c < 3; c++) {
        rest[(2 * V + 6) * 3 + c] = rest[(2 * V + 5) * 3 + c];
        for (int v = 1; v < V; v++) rest[(3 * V + v) * 3 + c] = rest[3 * V * 3 + c]; /* a point */
    }
    for (int v = 0; v < V; v++) /* there and back along itself */
        rest[(4 * V + v) * 3] = 0, rest[(4 * V + v) * 3 + 1] = edge * (v & 1), rest[(4 * V + v) * 3 + 2] = 0;
    chain_terms(terms, numbers, 2, 1e-8, "bend_twist_chain", NULL);
    for (int sweeps = 0; sweeps < 2; sweeps++)
        for (int pinned = 1; pinned <= V; pinned += V - 1) {
            make(&s, 1, rest, S);
            hg_xpbd *xpbd = start(&s, terms, 3, &(hg_xpbd_options){ .pinned = pinned, .sweeps = sweeps, .steps = 20 });
            hg_xpbd_solution found;
            if (hg_xpbd_rest(xpbd, &still, s.x, &found) != HG_OK) fail_msg("%s", hg_message());
            if (hg_xpbd_step(xpbd, &still, s.x, NULL) != HG_OK) fail_msg("%s", hg_message());
            for (int k = 0; k < N; k++) assert_true(isfinite(((double *)s.x->data)[k]));
            if (pinned == V) assert_memory_equal(s.x->data, rest, sizeof rest);
            hg_xpbd_destroy(xpbd);
            drop(&s);
        }
    make(&s, 1, rest, 0);
    hg_xpbd *none = start(&s, terms, 3, NULL);
    hg_xpbd_solution found;
    assert_int_equal(hg_xpbd_rest(none, &still, s.x, &found), HG_OK);
    assert_int_equal(found.at_rest, 0);
    hg_xpbd_destroy(none);
    s.data.strands = 3, s.data.vertices = 1;
    hg_tensor *points = hg_tensor_create(s.ctx, HG_F64, 4, (int64_t[]){ 1, 3, 1, 3 });
    none = start(&s, terms, 3, NULL);
    if (hg_xpbd_rest(none, &still, points, &found) != HG_OK) fail_msg("%s", hg_message());
    assert_int_equal(found.at_rest, 3);
    hg_xpbd_destroy(none);
    hg_tensor_destroy(points);
    drop(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_hanging_chain),
        cmocka_unit_test(test_cantilever),
        cmocka_unit_test(test_way_to_the_minimum),
        cmocka_unit_test(test_curled_minimum),
        cmocka_unit_test(test_returns),
        cmocka_unit_test(test_style),
        cmocka_unit_test(test_pendulum),
        cmocka_unit_test(test_time_steps),
        cmocka_unit_test(test_carried_along),
        cmocka_unit_test(test_contact),
        cmocka_unit_test(test_strand_distance),
        cmocka_unit_test(test_threads),
        cmocka_unit_test(test_memory),
        cmocka_unit_test(test_refusals),
        cmocka_unit_test(test_degenerate),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
