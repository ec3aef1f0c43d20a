/* What the springs to a ghost, the angular springs and the pose regularisation are for: equilibria, curves and means. */
#include "energies_scene.h"

#include <setjmp.h>
#include <stdarg.h>
#include <cmocka.h>

static void ok(hg_status status, const char *what)
{
    if (status != HG_OK) fail_msg("%s: %s", what, hg_message());
}

enum { STRANDS = 2, VERTICES = 5, POINTS = STRANDS * VERTICES };
#define EDGE 4e-3

typedef struct {
    hg_ctx *ctx;
    hg_physics *physics;
    double rest[POINTS * 3], mass[POINTS];
} groom;

static void groom_make(groom *g, const hg_term *terms, int n)
{
    for (int i = 0; i < POINTS; i++) {
        g->rest[3 * i] = 0.01 * (i / VERTICES) + 1e-3 * noise(60, i);
        g->rest[3 * i + 1] = EDGE * (i % VERTICES);
        g->rest[3 * i + 2] = 1e-3 * noise(61, i);
        g->mass[i] = 2.6e-8 * (1 + 0.5 * noise(62, i));
    }
    const hg_groom_data data = {
        .grooms = 1, .strands = STRANDS, .vertices = VERTICES, .rest = g->rest, .mass = g->mass
    };
    ok(hg_ctx_create(&g->ctx, &(hg_ctx_options){ .threads = 1, .seed = 1 }), "context");
    ok(hg_physics_create(&g->physics, g->ctx, HG_F64, terms, n, &data), "physics");
}

static void groom_free(groom *g)
{
    hg_physics_destroy(g->physics);
    hg_ctx_destroy(g->ctx);
}

static double strand_length(const groom *g, int strand)
{
    double length = 0;
    for (int v = 1; v < VERTICES; v++) {
        const double *a = g->rest + 3 * (strand * VERTICES + v), *b = a - 3;
        length += sqrt(pow(a[0] - b[0], 2) + pow(a[1] - b[1], 2) + pow(a[2] - b[2], 2));
    }
    return length;
}

/* Energy, and its gradient in x, at positions x with ghosts y; [1,S,V,3]. */
static double at(const groom *g, const double *x, const double *y, double *gradient)
{
    const int64_t shape[4] = { 1, STRANDS, VERTICES, 3 };
    const hg_frame_input ghost = { "ghost", upload(g->ctx, HG_F64, 4, shape, y) };
    const hg_frame frame = { .dt = 1.0 / 30, .inputs = &ghost, .n_inputs = 1 };
    hg_tensor *positions = upload(g->ctx, HG_F64, 4, shape, x), *to = upload(g->ctx, HG_F64, 4, shape, x);
    double energies[2] = { 0 };
    ok(hg_physics_evaluate(g->physics, g->ctx, &frame, positions, energies, NULL, to), "evaluate");
    for (int i = 0; gradient && i < POINTS * 3; i++) gradient[i] = ((double *)to->data)[i];
    hg_step_reset(g->ctx);
    return energies[0];
}

/* Ghosts at y = x0 - (m/k) g: x0 is where springs and gravity are in balance, and with the other sign it is not. */
static void test_no_sag(void **state)
{
    (void)state;
    const double k = 1e-3, params[HG_ENERGY_PARAMS] = { k };
    const char *choices[2] = { "hookean", "softening" };
    for (int c = 0; c < 2; c++) {
        const char *options[HG_ENERGY_OPTIONS] = { choices[c] };
        const hg_term terms[2] = { { hg_energy_find("integrity"), 1, params, options },
                                   { hg_energy_find("gravity"), 1, NULL, NULL } };
        groom g;
        groom_make(&g, terms, 2);
        double y[POINTS * 3], gradient[POINTS * 3];
        for (int sign = -1; sign <= 1; sign += 2) {
            memcpy(y, g.rest, sizeof y);
            for (int i = 0; i < POINTS; i++) y[3 * i + 1] += sign * g.mass[i] / k * -9.81;
            at(&g, g.rest, y, gradient);
            double worst = 0;
            for (int i = 0; i < POINTS * 3; i++) worst = fmax(worst, fabs(gradient[i]) / (2.6e-8 * 9.81));
            assert_true(sign < 0 ? worst < 1e-12 : worst > 0.5);
        }
        groom_free(&g);
    }
}

/* The tension of the softening curve: the spring's up to half the length, nothing beyond one, without a step in between,
 * neither in itself nor in its slope; and it is the derivative of the energy. */
static void test_softening(void **state)
{
    (void)state;
    const double k = 2e-3, params[HG_ENERGY_PARAMS] = { k };
    const char *options[HG_ENERGY_OPTIONS] = { "softening" };
    const hg_term term = { hg_energy_find("integrity"), 1, params, options };
    groom g;
    groom_make(&g, &term, 1);
    const int vertex = VERTICES + 2; /* of strand 1 */
    const double L = strand_length(&g, 1), step = L / 4000;
    double y[POINTS * 3], gradient[POINTS * 3], last = 0, last_slope = k, last_energy = 0;
    for (int i = 0; i <= 5000; i++) {
        const double d = i * step;
        memcpy(y, g.rest, sizeof y);
        y[3 * vertex] -= 0.6 * d;
        y[3 * vertex + 2] += 0.8 * d;
        const double energy = at(&g, g.rest, y, gradient);
        const double tension = 0.6 * gradient[3 * vertex] - 0.8 * gradient[3 * vertex + 2];
        if (d <= 0.5 * L) assert_true(fabs(tension - k * d) < 1e-12 * k * L);
        if (d >= L)
            assert_true(fabs(tension) < 1e-15 * k * L && fabs(energy - 13.0 / 48 * k * L * L) < 1e-12 * k * L * L);
        assert_true(tension > -1e-15 * k * L && tension < 0.53 * k * L);
        if (i > 0) {
            const double slope = (tension - last) / step;
            if (fabs(slope - last_slope) > 0.01 * k)
                fail_msg("the slope jumps from %g to %g at %g L", last_slope, slope, d / L);
            assert_true(fabs((energy - last_energy) / step - 0.5 * (tension + last)) < 1e-6 * k * L);
            last_slope = slope;
        }
        last = tension;
        last_energy = energy;
    }
    groom_free(&g);
}

/* The angle is measured from the vertex, whatever the lengths: a quarter turn costs k/2 (pi/2)^2; at 0 and at pi, and where
 * an edge or its ghost has no length, the gradient is finite. */
static void test_angle(void **state)
{
    (void)state;
    const double k = 3e-7, params[HG_ENERGY_PARAMS] = { k };
    const hg_term term = { hg_energy_find("angular"), 1, params, NULL };
    const double pi = 3.14159265358979323846, angles[] = { 0, 0.3, pi / 2, 3, pi };
    groom g;
    groom_make(&g, &term, 1);
    for (int a = 0; a < 5; a++) {
        double y[POINTS * 3], gradient[POINTS * 3];
        for (int i = 0; i < POINTS; i++) { /* as seen from the vertex before, turned by the angle and twice as far */
            const double *now = g.rest + 3 * i, *before = i % VERTICES ? now - 3 : now;
            const double e[3] = { now[0] - before[0], now[1] - before[1], now[2] - before[2] };
            const double length = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]), flat = hypot(e[1], e[0]);
            const double side[3] = { flat > 0 ? e[1] / flat : 0, flat > 0 ? -e[0] / flat : 0, 0 };
            for (int c = 0; c < 3; c++)
                y[3 * i + c] = before[c] + 2 * (cos(angles[a]) * e[c] + sin(angles[a]) * length * side[c]);
        }
        const double energy = at(&g, g.rest, y, gradient),
                     want = STRANDS * (VERTICES - 1) * 0.5 * k * angles[a] * angles[a];
        if (!(fabs(energy - want) <= 1e-7 * k)) fail_msg("%g rad: %.12g, expected %.12g", angles[a], energy, want);
        for (int i = 0; i < POINTS * 3; i++) assert_true(fabs(gradient[i]) < 2 * k * pi / EDGE);
    }
    double gradient[POINTS * 3], x[POINTS * 3];
    memcpy(x, g.rest, sizeof x);
    memcpy(x + 6, x + 3, 3 * sizeof *x);
    assert_true(isfinite(at(&g, x, x, gradient)));
    for (int i = 0; i < POINTS * 3; i++) assert_true(isfinite(gradient[i]));
    groom_free(&g);
}

/* d over consecutive frames: the energy is that to the mean of each sequence, one frame costs nothing, and the gradient is
 * that of the whole energy, though the mean is detached. */
static void test_mean(void **state)
{
    (void)state;
    enum { FRAMES = 6, VALUES = FRAMES * POINTS * 3 };
    const double k = 1e-3, params[HG_ENERGY_PARAMS] = { k };
    const hg_term term = { hg_energy_find("pose_reg"), 1, params, NULL };
    groom g;
    groom_make(&g, &term, 1);
    const int64_t shape[4] = { FRAMES, STRANDS, VERTICES, 3 };
    for (int consecutive = 0; consecutive <= 3; consecutive++) {
        double d[VALUES], want = 0, gradient[VALUES], energy;
        for (int i = 0; i < VALUES; i++) d[i] = 1e-2 * noise(63, i);
        const int run = consecutive ? consecutive : FRAMES;
        for (int i = 0; i < VALUES; i++) {
            const int point = i % (POINTS * 3), first = i / (POINTS * 3) / run * run;
            double mean = 0;
            for (int f = 0; f < run; f++) mean += d[(first + f) * POINTS * 3 + point] / run;
            want += k * (mean - d[i]) * (mean - d[i]);
            gradient[i] = 2 * k * (d[i] - mean);
        }
        hg_tensor *x = hg_tensor_make(g.ctx, HG_F64, 4, shape), *deformation = upload(g.ctx, HG_F64, 4, shape, d);
        ok(hg_require_grad(deformation), "deformation");
        const hg_frame_input input = { "deformation", deformation };
        const hg_frame frame = { .dt = 1.0 / 30, .consecutive = consecutive, .inputs = &input, .n_inputs = 1 };
        hg_tensor *total = hg_physics_energy(g.physics, g.ctx, &frame, x, &energy);
        if (!total) fail_msg("%s", hg_message());
        ok(hg_backward(g.ctx, total), "backward");
        assert_true(fabs(energy - want) <= 1e-12 * want && (consecutive == 1) == (want == 0));
        for (int i = 0; i < VALUES; i++)
            assert_true(fabs(hg_tensor_item(hg_grad(deformation), i) - gradient[i]) < 1e-12 * k);
        hg_step_reset(g.ctx);
    }
    groom_free(&g);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_no_sag),
        cmocka_unit_test(test_softening),
        cmocka_unit_test(test_angle),
        cmocka_unit_test(test_mean),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
