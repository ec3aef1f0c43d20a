/* solvers: a known stiffness found again in a drape that was made with it: alone, with others, per strand, with stretched
 * noise on the positions, against a body; and refusals. The drape is the minimum of the energy, by L-BFGS. */
#include "hairgrad.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

enum { S = 5, V = 9, N = S * V * 3, MEMORY = 24 };
static const double bend = 3e-9, stretch = 5, edge = 0.012, density = 6.5e-6;

typedef struct {
    hg_ctx *ctx;
    double rest[N], mass[S * V], scales[S]; /* scales: of a strand's bend stiffness */
    hg_groom_data data;
    hg_body_tree *tree;
    hg_tensor *body;
    hg_tensor *x, *gradient;
    hg_physics *physics[S]; /* a strand each, so that every one may have its own stiffness */
    int pinned;
} scene;

/* Curled strands that leave the scalp in other directions. */
static void make_scene(scene *s, double floor)
{
    memset(s, 0, sizeof *s);
    assert_int_equal(hg_ctx_create(&s->ctx, &(hg_ctx_options){ .threads = 1, .seed = 1 }), HG_OK);
    for (int i = 0; i < S; i++) {
        const double turn = 1.3 * i, lean = 0.3 + 0.25 * i;
        for (int v = 0; v < V; v++) {
            double *p = s->rest + (i * V + v) * 3;
            const double along = edge * v, wave = 0.004 * sin(0.9 * v + i),
                         other = 0.004 * cos(0.9 * v + i) - 0.004 * cos(i);
            p[0] = 0.05 * i + along * sin(lean) * cos(turn) + wave * sin(turn);
            p[1] = along * cos(lean) + other;
            p[2] = along * sin(lean) * sin(turn) - wave * cos(turn);
        }
        for (int v = 0; v < V; v++) s->mass[i * V + v] = density * edge * (v == 0 || v == V - 1 ? 0.5 : 1);
        s->scales[i] = 1;
    }
    s->data = (hg_groom_data){ .grooms = 1, .strands = S, .vertices = V, .rest = s->rest, .mass = s->mass };
    if (floor > -1) { /* a slab below the roots */
        const double low = floor - 0.05, corner[24] = { -1, low, -1, 1, low, -1, -1, floor, -1, 1, floor, -1,
                                                        -1, low, 1,  1, low, 1,  -1, floor, 1,  1, floor, 1 };
        static const int32_t faces[36] = { 0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4,
                                           2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5 };
        assert_int_equal(hg_body_tree_create(&s->tree, 8, corner, 12, faces), HG_OK);
        s->body = hg_tensor_create(s->ctx, HG_F64, 3, (int64_t[]){ 1, 8, 3 });
        hg_tensor_write(s->body, corner);
        s->data.body = s->tree;
    }
    s->x = hg_tensor_create(s->ctx, HG_F64, 4, (int64_t[]){ 1, S, V, 3 });
}

static void drop_scene(scene *s)
{
    hg_tensor_destroy(s->x);
    hg_tensor_destroy(s->body);
    hg_body_tree_destroy(s->tree);
    hg_ctx_destroy(s->ctx);
}

/* bend and stretch stiffness as given; the same list in every call: stretch, bend_twist, gravity (and body_collision). */
static int terms_of(const scene *s, double *numbers, hg_term *terms)
{
    memcpy(numbers, (double[]){ stretch, bend, 0, -9.81, 0, 30, 2e-3 }, 7 * sizeof *numbers);
    terms[0] = (hg_term){ hg_energy_find("stretch"), 1, numbers, NULL };
    terms[1] = (hg_term){ hg_energy_find("bend_twist"), 1, numbers + 1, NULL };
    terms[2] = (hg_term){ hg_energy_find("gravity"), 1, numbers + 2, NULL };
    if (s->tree) terms[3] = (hg_term){ hg_energy_find("body_collision"), 1, NULL, NULL };
    return s->tree ? 4 : 3;
}

/* Energy and gradient of one strand alone; the root is held. */
typedef struct {
    scene *s;
    hg_physics *physics;
    hg_tensor *x, *gradient;
    int strand;
} one;

static double evaluate(one *o, const double *x, double *gradient)
{
    const hg_frame frame = { .body_vertices = o->s->body };
    double energy[4], total = 0;
    memcpy(o->x->data, x, V * 3 * sizeof *x);
    hg_tensor_touch(o->x);
    if (hg_physics_evaluate(o->physics, o->s->ctx, &frame, o->x, energy, NULL, o->gradient) != HG_OK)
        fail_msg("%s", hg_message());
    for (int t = 0; t < hg_physics_terms(o->physics); t++) total += energy[t];
    if (!o->gradient->data) return total; /* gcc 14 thinks that it might */
    memcpy(gradient, o->gradient->data, V * 3 * sizeof *gradient);
    memset(gradient, 0, 3 * sizeof *gradient);
    hg_step_reset(o->s->ctx);
    return total;
}

static double dot(const double *a, const double *b)
{
    double sum = 0;
    for (int i = 0; i < V * 3; i++) sum += a[i] * b[i];
    return sum;
}

/* L-BFGS (Nocedal and Wright 2006, algorithm 7.4) with backtracking. */
static void minimise(one *o, double *x)
{
    static double ds[MEMORY][V * 3], dg[MEMORY][V * 3];
    double rho[MEMORY], alpha[MEMORY], g[V * 3], next[V * 3], next_g[V * 3], d[V * 3];
    double energy = evaluate(o, x, g);
    int n = 0;
    for (int round = 0; round < 4000; round++) {
        if (sqrt(dot(g, g)) < 2e-12) break; /* a millionth of a vertex' weight */
        memcpy(d, g, sizeof d);
        const int first = n > MEMORY ? n - MEMORY : 0;
        for (int k = n - 1; k >= first; k--) {
            alpha[k % MEMORY] = dot(ds[k % MEMORY], d) * rho[k % MEMORY];
            for (int i = 0; i < V * 3; i++) d[i] -= alpha[k % MEMORY] * dg[k % MEMORY][i];
        }
        const double scale = n ? 1 / (rho[(n - 1) % MEMORY] * dot(dg[(n - 1) % MEMORY], dg[(n - 1) % MEMORY])) : 0.05;
        for (int i = 0; i < V * 3; i++) d[i] *= scale;
        for (int k = first; k < n; k++) {
            const double beta = dot(dg[k % MEMORY], d) * rho[k % MEMORY];
            for (int i = 0; i < V * 3; i++) d[i] += (alpha[k % MEMORY] - beta) * ds[k % MEMORY][i];
        }
        double far = 0, value = 0;
        for (int i = 0; i < V * 3; i++) far = fmax(far, fabs(d[i]));
        double step = fmin(1, 0.2 * edge / far); /* an edge must not turn over */
        const double slope = dot(g, d);
        int halving = 0;
        for (; halving < 30; halving++, step *= 0.5) {
            for (int i = 0; i < V * 3; i++) next[i] = x[i] - step * d[i];
            value = evaluate(o, next, next_g);
            if (value <= energy - 1e-4 * step * slope) break;
        }
        if (halving == 30) {
            if (!n) break; /* as low as numbers go */
            n = 0;         /* once more, downhill */
            continue;
        }
        double *sk = ds[n % MEMORY], *yk = dg[n % MEMORY];
        for (int i = 0; i < V * 3; i++) sk[i] = next[i] - x[i], yk[i] = next_g[i] - g[i];
        const double curvature = dot(sk, yk);
        if (curvature > 1e-10 * dot(yk, yk))
            rho[n % MEMORY] = 1 / curvature, n++; /* else it bends down: nothing to learn */
        memcpy(x, next, sizeof next);
        memcpy(g, next_g, sizeof next_g);
        energy = value;
    }
}

/* Drapes every strand with its own stiffness. The plain drape, which several tests start from, is made once. */
static void drape(scene *s)
{
    static double plain[N];
    static bool made;
    bool is_plain = !s->tree;
    for (int i = 0; i < S; i++) is_plain &= s->scales[i] <= 1;
    if (is_plain && made) {
        hg_tensor_write(s->x, plain);
        return;
    }
    for (int i = 0; i < S; i++) {
        double numbers[8], x[V * 3];
        hg_term terms[4];
        const int n = terms_of(s, numbers, terms);
        numbers[1] = bend * s->scales[i];
        const hg_groom_data data = { .grooms = 1,
                                     .strands = 1,
                                     .vertices = V,
                                     .rest = s->rest + i * V * 3,
                                     .mass = s->mass + i * V,
                                     .body = s->tree };
        one o = { .s = s, .strand = i };
        if (hg_physics_create(&o.physics, s->ctx, HG_F64, terms, n, &data) != HG_OK) fail_msg("%s", hg_message());
        o.x = hg_tensor_create(s->ctx, HG_F64, 4, (int64_t[]){ 1, 1, V, 3 });
        o.gradient = hg_tensor_create(s->ctx, HG_F64, 4, (int64_t[]){ 1, 1, V, 3 });
        memcpy(x, s->rest + i * V * 3, sizeof x);
        minimise(&o, x);
        double left[V * 3];
        evaluate(&o, x, left);
        if (!(sqrt(dot(left, left)) < (s->tree ? 5e-8 : 1e-9))) /* contact has kinks */
            fail_msg("strand %d: %g N are left", i, sqrt(dot(left, left)));
        memcpy((double *)s->x->data + i * V * 3, x, sizeof x);
        hg_tensor_destroy(o.x);
        hg_tensor_destroy(o.gradient);
        hg_physics_destroy(o.physics);
    }
    hg_tensor_touch(s->x);
    if (is_plain) hg_tensor_read(s->x, plain);
    made |= is_plain;
}

static hg_status fit(scene *s, int n, const char *const *names, hg_material_options options, hg_material_fit *found)
{
    double numbers[8];
    hg_term terms[4];
    const int n_terms = terms_of(s, numbers, terms);
    numbers[0] = numbers[1] = 1; /* what stands there does not matter */
    for (int k = 0; k < n; k++)
        if (strcmp(names[k], "stretch.stiffness")) numbers[0] = stretch;
    options.n = n;
    options.names = names;
    const hg_frame frame = { .body_vertices = s->body };
    return hg_fit_material(s->ctx, terms, n_terms, &s->data, &frame, s->x, &options, found);
}

static void near(double found, double expected, double part)
{
    if (!(fabs(found - expected) <= part * fabs(expected))) fail_msg("%g, expected %g", found, expected);
}

static const char *const bend_name[] = { "bend_twist.stiffness" };

static void a_known_stiffness_is_found(void **state)
{
    (void)state;
    scene s;
    make_scene(&s, -2);
    drape(&s);
    double lowest = 1;
    for (int i = 0; i < S * V; i++) lowest = fmin(lowest, ((double *)s.x->data)[3 * i + 1] - s.rest[3 * i + 1]);
    assert_true(lowest < -0.01); /* it hangs */
    hg_material_fit found;
    for (int tension = HG_TENSION_AUTO; tension <= HG_TENSION_UNKNOWN; tension++) {
        if (fit(&s, 1, bend_name, (hg_material_options){ .tension = (hg_tension)tension }, &found) != HG_OK)
            fail_msg("%s", hg_message());
        near(found.param[0].value, bend, 1e-4);
        assert_true(found.unbalanced < 1e-4);
        assert_int_equal(found.vertices, S * (V - 1));
        assert_int_equal(found.left_out, 0);
        assert_string_equal(found.param[0].unit, "N*m^2");
    }
    /* Two at once. */
    static const char *const both[] = { "bend_twist.stiffness", "stretch.stiffness" };
    if (fit(&s, 2, both, (hg_material_options){ 0 }, &found) != HG_OK) fail_msg("%s", hg_message());
    near(found.param[0].value, bend, 1e-3);
    near(found.param[1].value, stretch, 1e-3);
    drop_scene(&s);
}

/* Positions as a camera would have them: edges a thousandth too long or short. Only with the tension unknown. */
static void inexact_lengths_do_not_matter(void **state)
{
    (void)state;
    scene s;
    make_scene(&s, -2);
    drape(&s);
    double *x = s.x->data;
    for (int i = 0; i < S; i++) {
        double moved[V * 3];
        memcpy(moved, x + i * V * 3, sizeof moved);
        for (int v = 1; v < V; v++) {
            const double factor = 1 + 1e-3 * hg_random_normal(5, 1, (uint64_t)(i * V + v));
            for (int c = 0; c < 3; c++)
                moved[3 * v + c] =
                    moved[3 * v - 3 + c] + factor * (x[(i * V + v) * 3 + c] - x[(i * V + v - 1) * 3 + c]);
        }
        memcpy(x + i * V * 3, moved, sizeof moved);
    }
    hg_material_fit found;
    if (fit(&s, 1, bend_name, (hg_material_options){ 0 }, &found) != HG_OK) fail_msg("%s", hg_message());
    near(found.param[0].value, bend, 0.02);
    if (fit(&s, 1, bend_name, (hg_material_options){ .tension = HG_TENSION_KNOWN }, &found) == HG_OK)
        assert_true(fabs(found.param[0].value - bend) > 0.05 * bend);
    hg_material_fit_free(&found);
    drop_scene(&s);
}

static void every_strand_has_its_own(void **state)
{
    (void)state;
    scene s;
    make_scene(&s, -2);
    for (int i = 0; i < S; i++) s.scales[i] = 1 + 0.5 * i;
    drape(&s);
    hg_material_fit found;
    if (fit(&s, 1, bend_name, (hg_material_options){ .per_strand = true }, &found) != HG_OK)
        fail_msg("%s", hg_message());
    for (int i = 0; i < S; i++) near(found.strands[i], bend * s.scales[i], 2e-3);
    assert_true(found.param[0].value > 0.5 * bend && found.param[0].value < 3 * bend);
    hg_material_fit_free(&found);
    drop_scene(&s);
}

/* A strand that lies on the body: what pushes it up is left out, the rest says enough. */
static void hair_that_touches_the_body(void **state)
{
    (void)state;
    scene s;
    make_scene(&s, -0.035);
    for (int i = 0; i < S; i++) s.scales[i] = 2; /* stiff enough not to fold on the floor */
    drape(&s);
    hg_material_fit found;
    if (fit(&s, 1, bend_name, (hg_material_options){ 0 }, &found) != HG_OK) fail_msg("%s", hg_message());
    near(found.param[0].value, 2 * bend, 0.02);
    assert_true(found.left_out > 3);
    assert_int_equal(found.left_out + found.vertices, S * (V - 1));
    drop_scene(&s);
}

/* Some vertices are pushed by what the energies do not know. */
static void outliers_count_less(void **state)
{
    (void)state;
    scene s;
    make_scene(&s, -2);
    drape(&s);
    ((double *)s.x->data)[(1 * V + 5) * 3 + 2] += 2e-4;
    hg_material_fit found;
    uint8_t left_out[S * V] = { 0 };
    for (int v = 2; v < V; v++) left_out[V + v] = 1;
    if (fit(&s, 1, bend_name, (hg_material_options){ 0 }, &found) != HG_OK) fail_msg("%s", hg_message());
    near(found.param[0].value, bend, 0.02);
    assert_true(found.unbalanced > 1e-4);
    if (fit(&s, 1, bend_name, (hg_material_options){ .left_out = left_out }, &found) != HG_OK)
        fail_msg("%s", hg_message());
    near(found.param[0].value, bend, 1e-3);
    assert_int_equal(found.left_out, V - 2);
    drop_scene(&s);
}

static void refusals(void **state)
{
    (void)state;
    scene s;
    make_scene(&s, -2);
    memcpy(s.x->data, s.rest, sizeof s.rest);
    hg_material_fit found;
    assert_int_equal(fit(&s, 1, bend_name, (hg_material_options){ 0 }, &found), HG_NUMERIC); /* not bent */
    assert_non_null(strstr(hg_message(), "bend_twist.stiffness"));
    static const char *const wrong[] = { "bend_twist.stifness" }, *const gravity[] = { "gravity.g.y" };
    assert_int_equal(fit(&s, 1, wrong, (hg_material_options){ 0 }, &found), HG_INVALID);
    assert_non_null(strstr(hg_message(), "bend_twist.stiffness"));
    assert_int_not_equal(fit(&s, 1, gravity, (hg_material_options){ 0 }, &found), HG_OK); /* nothing is known then */
    uint8_t all[S * V];
    memset(all, 1, sizeof all);
    assert_int_equal(fit(&s, 1, bend_name, (hg_material_options){ .left_out = all }, &found), HG_NUMERIC);
    assert_int_equal(fit(&s, 1, bend_name, (hg_material_options){ .pinned = V }, &found), HG_INVALID);
    drop_scene(&s);
}

/* From the recipe and the file of a drape, as `hairgrad fit material` does: positions in f32, hair on a head. */
static void a_file_of_a_drape(void **state)
{
    (void)state;
    static const char recipe[] =
        "scene: { style: short, strands: 12, vertices: 9, seconds: 1 s, motion_kinds: [nod] }\n"
        "features: { latent: 4, encoder_width: 8, encoder_steps: 1, history: 1 }\n"
        "losses: { stretch: { stiffness: 5 N/m }, bend_twist: {}, gravity: {}, body_collision: { distance: 1 mm } }\n"
        "training: { strands: 12 }\n";
    const double made = 2e-8;
    int n;
    const hg_config_row *rows = hg_hair_schema(&n);
    hg_config *config = NULL;
    hg_hair_task *task = NULL;
    scene s = { 0 };
    assert_int_equal(hg_ctx_create(&s.ctx, &(hg_ctx_options){ .threads = 1, .seed = 1 }), HG_OK);
    assert_int_equal(hg_config_parse(&config, recipe, "recipe.yaml", rows, n), HG_OK);
    if (hg_hair_task_create(&task, s.ctx, config, NULL, NULL) != HG_OK) fail_msg("%s", hg_message());
    hg_config_destroy(config);

    const hg_groom *groom = hg_hair_groom(task);
    const int64_t strands = groom->strands;
    float *x = hg_alloc((size_t)(strands * V * 3), sizeof *x),
          *rotation = hg_alloc((size_t)strands * 4, sizeof *rotation),
          *position = hg_alloc((size_t)strands * 3, sizeof *position);
    for (int64_t i = 0; i < strands; i++) {
        double numbers[8], rest[V * 3], mass[V] = { 0 }, at[V * 3], left[V * 3];
        hg_term terms[4];
        const int n_terms = terms_of(&s, numbers, terms);
        numbers[1] = made;
        for (int k = 0; k < V * 3; k++) at[k] = rest[k] = (double)groom->points[i * V * 3 + k];
        for (int v = 0; v + 1 < V; v++) {
            double length = 0;
            for (int c = 0; c < 3; c++) length += pow(rest[3 * v + 3 + c] - rest[3 * v + c], 2);
            for (int k = 0; k < 2; k++) mass[v + k] += 0.5 * density * sqrt(length);
        }
        const hg_groom_data data = { .grooms = 1, .strands = 1, .vertices = V, .rest = rest, .mass = mass };
        one o = { .s = &s };
        assert_int_equal(hg_physics_create(&o.physics, s.ctx, HG_F64, terms, n_terms, &data), HG_OK);
        o.x = hg_tensor_create(s.ctx, HG_F64, 4, (int64_t[]){ 1, 1, V, 3 });
        o.gradient = hg_tensor_create(s.ctx, HG_F64, 4, (int64_t[]){ 1, 1, V, 3 });
        minimise(&o, at);
        evaluate(&o, at, left);
        if (!(sqrt(dot(left, left)) < 1e-9)) fail_msg("strand %d: %g N are left", (int)i, sqrt(dot(left, left)));
        for (int k = 0; k < V * 3; k++) x[i * V * 3 + k] = (float)at[k];
        rotation[4 * i] = 1;
        for (int c = 0; c < 3; c++) position[3 * i + c] = (float)rest[c];
        hg_tensor_destroy(o.x);
        hg_tensor_destroy(o.gradient);
        hg_physics_destroy(o.physics);
    }
    char folder[] = "/tmp/hairgrad_fit_XXXXXX", path[64], body_path[64], command[96];
    assert_non_null(mkdtemp(folder));
    snprintf(path, sizeof path, "%s/drape.vtkhdf", folder);
    snprintf(body_path, sizeof body_path, "%s/body.vtkhdf", folder);
    hg_drape_file *file = NULL;
    const hg_drape_frame frame = { .strands = strands,
                                   .vertices = V,
                                   .x = x,
                                   .posed = x,
                                   .body_vertices = hg_hair_body(task)->points,
                                   .root_rotation = rotation,
                                   .root_position = position };
    assert_int_equal(hg_drape_file_create(&file, path, body_path, groom, hg_hair_body(task), 1, 30), HG_OK);
    assert_int_equal(hg_drape_file_add(file, &frame), HG_OK);
    assert_int_equal(hg_drape_file_commit(file), HG_OK);

    const hg_drape_fit_options options = { .material = { .n = 1, .names = bend_name, .per_strand = true } };
    hg_material_fit found;
    if (hg_drape_fit_material(task, s.ctx, path, &options, &found) != HG_OK) fail_msg("%s", hg_message());
    near(found.param[0].value, made, 0.02);
    assert_int_equal(found.n_strands, strands);
    if (!(found.vertices >= 10 && found.unbalanced < 0.05))
        fail_msg("%d vertices, %d left out, %g left", (int)found.vertices, (int)found.left_out, found.unbalanced);
    hg_material_fit_free(&found);

    /* Another groom's drape is refused. */
    assert_int_equal(hg_hair_choose_groom(task, "wavy"), HG_OK);
    assert_int_equal(hg_drape_fit_material(task, s.ctx, path, &options, &found), HG_INVALID);
    assert_non_null(strstr(hg_message(), "another groom"));
    snprintf(command, sizeof command, "rm -r '%s'", folder);
    assert_int_equal(system(command), 0);
    hg_free(x);
    hg_free(rotation);
    hg_free(position);
    hg_hair_task_destroy(task);
    hg_ctx_destroy(s.ctx);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_known_stiffness_is_found), cmocka_unit_test(inexact_lengths_do_not_matter),
        cmocka_unit_test(every_strand_has_its_own),   cmocka_unit_test(hair_that_touches_the_body),
        cmocka_unit_test(outliers_count_less),        cmocka_unit_test(refusals),
        cmocka_unit_test(a_file_of_a_drape),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
