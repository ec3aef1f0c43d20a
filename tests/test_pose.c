/* Bodies and roots posed many at a time on a device, against one at a time on the host. */
#include "scene/scene.h"
#include "tests/device.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

enum { POSES = 6, STRANDS = 70, VERTICES = 5, GROOMS = 2 };

#define OK(call_)                                                                                                      \
    do {                                                                                                               \
        if ((call_) != HG_OK) fail_msg("%s", hg_message());                                                            \
    } while (0)

typedef struct {
    hg_ctx *ctx;
    hg_body *body;
    hg_groom *groom[GROOMS];
    hg_motion *motion;
    hg_poser *poser;
    double shape[POSES][HG_SHAPES];
    float *shapes, *transform;
} stage;

static void begin(stage *s, bool collider_only)
{
    OK(hg_ctx_create(&s->ctx, &(hg_ctx_options){ .threads = 2, .seed = 1, .device = test_device() }));
    OK(hg_bust_create(&s->body));
    for (int g = 0; g < GROOMS; g++)
        OK(hg_groom_grow(s->ctx, &s->groom[g], s->body, g ? "curly" : "short", STRANDS, VERTICES, (uint64_t)g + 3));
    OK(hg_motion_make(&s->motion, s->body, "mixed", 1, 30, 5));
    OK(hg_poser_create(&s->poser, s->body, collider_only));
    s->shapes = calloc(POSES * HG_SHAPES, sizeof *s->shapes);
    s->transform = calloc((size_t)(POSES * s->body->joints * 12), sizeof *s->transform);
    assert_non_null(s->shapes);
    assert_non_null(s->transform);
    for (int p = 0; p < POSES; p++) {
        for (int k = 0; k < HG_SHAPES; k++) s->shape[p][k] = 2 * hg_random_uniform(9, (uint64_t)p, (uint64_t)k) - 1;
        OK(hg_pose_joints(s->poser, s->shape[p], s->motion, 5 * p, s->shapes + HG_SHAPES * p,
                          s->transform + 12 * s->body->joints * p));
    }
}

static void end(stage *s)
{
    free(s->shapes);
    free(s->transform);
    hg_poser_destroy(s->poser);
    hg_motion_destroy(s->motion);
    for (int g = 0; g < GROOMS; g++) hg_groom_destroy(s->groom[g]);
    hg_body_destroy(s->body);
    hg_ctx_destroy(s->ctx);
}

static hg_tensor *bodies(stage *s)
{
    const int64_t shapes[2] = { POSES, HG_SHAPES }, transforms[3] = { POSES, s->body->joints, 12 };
    hg_tensor *made = hg_pose_bodies(s->ctx, s->poser, hg_tensor_from(s->ctx, HG_F32, 2, shapes, s->shapes),
                                     hg_tensor_from(s->ctx, HG_F32, 3, transforms, s->transform));
    if (!made) fail_msg("%s", hg_message());
    return made;
}

static double largest_difference(const float *a, const float *b, int64_t n)
{
    double largest = 0;
    for (int64_t i = 0; i < n; i++) largest = fmax(largest, fabs((double)a[i] - (double)b[i]));
    return largest;
}

static void bodies_are_those_of_the_host(bool collider_only)
{
    stage s = { 0 };
    begin(&s, collider_only);
    const int64_t n = 3 * hg_poser_vertices(s.poser);
    float *got = calloc((size_t)(POSES * n), sizeof *got), *want = calloc((size_t)n, sizeof *want);
    assert_non_null(got);
    assert_non_null(want);
    OK(hg_tensor_read(bodies(&s), got));
    for (int p = 0; p < POSES; p++) {
        OK(hg_pose(s.ctx, s.poser, s.shape[p], s.motion, 5 * p, want, NULL, NULL));
        assert_true(largest_difference(got + p * n, want, n) < 1e-6);
    }
    assert_true(largest_difference(got, got + n, n) > 1e-3); /* they do differ */
    free(got);
    free(want);
    end(&s);
}

static void test_bodies(void **state)
{
    (void)state;
    bodies_are_those_of_the_host(true);
    bodies_are_those_of_the_host(false);
}

/* Of two grooms in turn, on strands that are not all of them; and without a list of grooms the first. */
static void test_roots(void **state)
{
    (void)state;
    enum { N = 40 };
    stage s = { 0 };
    begin(&s, true);
    int32_t strand[GROOMS * N];
    for (int i = 0; i < GROOMS * N; i++) strand[i] = (i * 7 + i / N) % STRANDS;
    hg_roots *roots;
    OK(hg_roots_create(&roots, s.ctx, s.poser, GROOMS, (const hg_groom *const *)s.groom, N, strand));
    const int64_t vertices = 3 * hg_poser_vertices(s.poser), period = 2;
    float *body = calloc((size_t)(POSES * vertices), sizeof *body);
    assert_non_null(body);
    const int32_t groom[2] = { 1, 0 };
    for (int listed = 0; listed < 2; listed++) {
        hg_tensor *made = bodies(&s), *rotation, *position;
        OK(hg_tensor_read(made, body));
        OK(hg_roots_pose(s.ctx, roots, listed ? hg_tensor_from(s.ctx, HG_I32, 1, &period, groom) : NULL, made,
                         &rotation, &position));
        float turned[POSES * N * 4], placed[POSES * N * 3], want_turned[N * 4], want_placed[N * 3];
        OK(hg_tensor_read(rotation, turned));
        OK(hg_tensor_read(position, placed));
        for (int p = 0; p < POSES; p++) {
            const int g = listed ? groom[p % 2] : 0;
            OK(hg_pose_roots(s.ctx, s.poser, s.groom[g], strand + g * N, N, body + p * vertices, want_turned,
                             want_placed));
            assert_true(largest_difference(turned + p * N * 4, want_turned, N * 4) < 1e-6);
            assert_true(largest_difference(placed + p * N * 3, want_placed, N * 3) < 1e-6);
        }
        hg_step_reset(s.ctx);
    }
    hg_roots_destroy(roots);
    strand[3] = STRANDS;
    assert_int_equal(hg_roots_create(&roots, s.ctx, s.poser, 1, (const hg_groom *const *)s.groom, N, strand),
                     HG_INVALID);
    assert_null(roots);
    free(body);
    end(&s);
}

/* A triangle without an area leaves the strand unturned. */
static void test_flat_triangle(void **state)
{
    (void)state;
    stage s = { 0 };
    begin(&s, true);
    const int32_t strand = 0;
    const int64_t shape[3] = { 1, hg_poser_vertices(s.poser), 3 };
    hg_roots *roots;
    OK(hg_roots_create(&roots, s.ctx, s.poser, 1, (const hg_groom *const *)s.groom, 1, &strand));
    hg_tensor *point = hg_tensor_create(s.ctx, HG_F32, 3, shape), *rotation, *position;
    OK(hg_tensor_fill(point, 0.25)); /* all vertices in one place */
    OK(hg_roots_pose(s.ctx, roots, NULL, point, &rotation, &position));
    assert_true(hg_tensor_item(rotation, 0) == 1 && hg_tensor_item(rotation, 1) == 0);
    for (int c = 0; c < 3; c++) assert_true(fabs(hg_tensor_item(position, c) - 0.25) < 1e-6);
    hg_tensor_destroy(point);
    hg_roots_destroy(roots);
    end(&s);
}

static void test_refused(void **state)
{
    (void)state;
    stage s = { 0 };
    begin(&s, true);
    float shapes[HG_SHAPES];
    double broken[HG_SHAPES] = { 0, (double)NAN };
    assert_int_equal(hg_pose_joints(s.poser, broken, s.motion, 0, shapes, s.transform), HG_INVALID);
    const int64_t two[2] = { 2, HG_SHAPES }, one[3] = { 1, s.body->joints, 12 };
    assert_null(hg_pose_bodies(s.ctx, s.poser, hg_tensor_from(s.ctx, HG_F32, 2, two, s.shapes),
                               hg_tensor_from(s.ctx, HG_F32, 3, one, s.transform)));
    assert_non_null(strstr(hg_message(), "bodies"));
    end(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_bodies),
        cmocka_unit_test(test_roots),
        cmocka_unit_test(test_flat_triangle),
        cmocka_unit_test(test_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
