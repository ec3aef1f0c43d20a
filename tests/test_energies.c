/* Every energy in the registry, with every combination of its options: gradient against finite differences, f32 against
 * f64, hoisting against none, invariance and rest where they are declared, degenerate hair, every length of strand, the
 * tape, and what is refused. On the device of test_device(). */
#include "energies_walk.h"

#include "energies_own.h"

/* ---- gradient against finite differences, f64 ----------------------------------------------------------------- */

static double energy_at(hg_physics *physics, hg_ctx *ctx, const hg_frame *frame, hg_tensor *x, const double *from,
                        const double *direction, double step)
{
    double energy;
    double *moved = numbers(hg_tensor_count(x));
    for (int64_t i = 0; i < hg_tensor_count(x); i++) moved[i] = from[i] + step * direction[i];
    ok(hg_tensor_write(x, moved), "evaluate");
    hg_free(moved);
    ok(hg_physics_evaluate(physics, ctx, frame, x, &energy, NULL, NULL), "evaluate");
    return energy;
}

static double worst_gradient(const variant *v, const scene *s, hg_ctx *ctx, const hg_frame *frame, hg_physics *physics)
{
    const int64_t n = s->B * s->S * s->V * 3;
    hg_tensor *x = scene_x(s, ctx, HG_F64), *gradient = scene_x(s, ctx, HG_F64);
    double *direction = numbers(n), energy, worst = 0, largest = 0;
    ok(hg_physics_evaluate(physics, ctx, frame, x, &energy, NULL, gradient), v->label);
    for (int64_t i = 0; i < n; i++) largest = fmax(largest, fabs(value(gradient, i)));
    for (int round = 0; round < 24 + n; round++) {
        for (int64_t i = 0; i < n; i++) direction[i] = round >= 24 ? i == round - 24 : noise(100 + (uint64_t)round, i);
        double analytic = 0, difference = INFINITY;
        for (int64_t i = 0; i < n; i++) analytic += value(gradient, i) * direction[i] / 1.7;
        /* The better of two steps: a kink of max() that lies within the long one does not lie within the short one. */
        for (double longest = 1e-6; longest > 0.5e-7; longest *= 0.1) {
            double numeric[2];
            for (int half = 0; half < 2; half++) {
                const double step = half ? 0.5 * longest : longest;
                numeric[half] = (energy_at(physics, ctx, frame, x, s->x, direction, step) -
                                 energy_at(physics, ctx, frame, x, s->x, direction, -step)) /
                                (2 * step);
            }
            difference = fmin(difference, fabs((4 * numeric[1] - numeric[0]) / 3 - analytic));
        }
        worst = fmax(worst, difference / fmax(fabs(analytic), 1e-2 * largest));
    }
    hg_energy_inputs asks;
    ok(hg_energy_asks(v->term.energy, v->term.options, false, &asks), v->label);
    if (largest == 0 && energy != 0 && strcmp(asks.input[0].name, "x") == 0) worst = INFINITY;
    hg_free(direction);
    return worst;
}

static void check_gradient(const variant *v, void *self)
{
    (void)self;
    hg_ctx *ctx = make_context(1);
    scene s;
    scene_make(&s, 2, 2, 3, 7, 0.1);
    hg_physics *physics;
    ok(hg_physics_create(&physics, ctx, HG_F64, &v->term, 1, &s.data), v->label);
    hg_frame frame = scene_frame(&s, ctx, HG_F64);
    scene_bring(&s, ctx, HG_F64, &v->term, 1, &frame);
    const double worst = worst_gradient(v, &s, ctx, &frame, physics);
    print_message("    %-60s gradient %.1e\n", v->label, worst);
    if (!(worst < 1e-6)) fail_msg("%s: the gradient is off by %.3e", v->label, worst);
    hg_physics_destroy(physics);
    scene_free(&s);
    hg_ctx_destroy(ctx);
}

static void test_gradients(void **state)
{
    (void)state;
    each_variant(check_gradient, NULL);
}

static void check_dtypes(const variant *v, void *self)
{
    scene s;
    scene_make(&s, 2, 3, 37, 11, 0.3);
    result a = evaluate(&s, HG_F64, 1, &v->term, 1, HG_BACKEND_INTERPRETER, false, v->label, NULL);
    result b = evaluate(&s, HG_F32, 1, &v->term, 1, HG_BACKEND_INTERPRETER, false, v->label, NULL);
    const double energy = difference(a.energy, b.energy, 1),
                 gradient = difference(a.gradient, b.gradient, s.B * s.S * s.V * 3);
    double sum = 0;
    for (int64_t i = 0; i < s.B * s.S; i++) sum += a.per_strand[i];
    print_message("    %-60s f32 %.1e %.1e\n", v->label, energy, gradient);
    if (!(energy < 2e-4 && gradient < 2e-4))
        fail_msg("%s: f32 is off by %.3e, gradient %.3e", v->label, energy, gradient);
    if (fabs(sum - a.energy[0]) > 1e-12 * fabs(sum)) fail_msg("%s: the strands do not add up", v->label);
    result_free(&a);
    result_free(&b);
    scene_free(&s);
    (void)self;
}

static void test_f32(void **state)
{
    (void)state;
    each_variant(check_dtypes, NULL);
}

/* ---- hoisting and posed ------------------------------------------------------------------------------------------ */

static void check_hoisting(const variant *v, void *self)
{
    (void)self;
    if (v->term.energy->site.kind != HG_SITE_WINDOW) return;
    hg_ctx *ctx = make_context(1);
    scene s;
    scene_make(&s, 2, 2, 5, 6, 0.3);
    double params[HG_ENERGY_PARAMS];
    const char *options[HG_ENERGY_OPTIONS];
    ok(hg_term_complete(&v->term, params, options), v->label);
    const hg_term term = { v->term.energy, 1.7, params, options };
    const int32_t column = 0;
    hg_frame frame = scene_frame(&s, ctx, HG_F64);
    scene_bring(&s, ctx, HG_F64, &v->term, 1, &frame);
    hg_pass_value values[MAX_INPUTS];
    int n_values = 0;
    for (int i = 0; i < frame.n_inputs; i++) {
        const char *name = frame.inputs[i].name;
        values[n_values++] = (hg_pass_value){ .kind = strcmp(name, "q") == 0 ? HG_INPUT_Q : HG_INPUT_FRAME,
                                              .name = name,
                                              .values = frame.inputs[i].value->data };
        if (strcmp(name, "deformation") == 0) { /* physics makes it; here anything does */
            values[n_values] = values[n_values - 1];
            values[n_values].name = "deformation_mean";
            values[n_values++].values = frame.predicted->data;
        }
    }
    hg_tensor *x = scene_x(&s, ctx, HG_F64), *gradient[2] = { scene_x(&s, ctx, HG_F64), scene_x(&s, ctx, HG_F64) };
    /* what physics would have made */
    const hg_groom_attribute attributes[3] = { s.attributes[0], s.attributes[1], { "strand_length", s.body_distance } };
    hg_groom_data data = s.data;
    data.attributes = attributes;
    data.n_attributes = 3;
    double energy[2];
    for (int hoist = 0; hoist < 2; hoist++) {
        hg_strand_pass *pass;
        ok(hg_strand_pass_create(&pass, ctx, HG_F64, 1, &term, &column, &data, NULL, hoist), v->label);
        hg_tensor *point = NULL, *normal = NULL;
        if (v->term.energy->contact) { /* any contact will do here: the plane y = 1 mm */
            point = hg_tensor_make(ctx, HG_F64, 4, x->shape);
            normal = hg_tensor_make(ctx, HG_F64, 4, x->shape);
            double *values_of = numbers(hg_tensor_count(x));
            for (int64_t i = 0; i < hg_tensor_count(x); i++) values_of[i] = i % 3 == 1;
            ok(hg_tensor_write(normal, values_of), v->label);
            for (int64_t i = 0; i < hg_tensor_count(x); i++) values_of[i] = i % 3 == 1 ? 1e-3 : s.x[i];
            ok(hg_tensor_write(point, values_of), v->label);
            hg_free(values_of);
        }
        hg_tensor *sum = hg_tensor_make(ctx, HG_F64, 0, NULL), *groom = hg_tensor_make(ctx, HG_I32, 1, &s.B);
        ok(hg_tensor_write(groom, s.groom), v->label);
        const hg_pass_call call = {
            &frame, groom->data, x, n_values, values, gradient[hoist]->data, sum->data, NULL, 1
        };
        ok(hg_strand_pass_run(pass, &call, point ? point->data : NULL, normal ? normal->data : NULL), v->label);
        hg_strand_pass_destroy(pass);
        energy[hoist] = value(sum, 0);
    }
    double *both[2] = { numbers(hg_tensor_count(x)), numbers(hg_tensor_count(x)) };
    for (int hoist = 0; hoist < 2; hoist++) ok(hg_tensor_read(gradient[hoist], both[hoist]), v->label);
    const double off = fmax(difference(energy, energy + 1, 1), difference(both[0], both[1], hg_tensor_count(x)));
    for (int hoist = 0; hoist < 2; hoist++) hg_free(both[hoist]);
    if (!(off < 1e-12)) fail_msg("%s: hoisting changes the result by %.3e", v->label, off);
    scene_free(&s);
    hg_ctx_destroy(ctx);
}

static void test_hoisting(void **state)
{
    (void)state;
    each_variant(check_hoisting, NULL);
}

/* posed brought by the frame, or made in the kernel */
static void test_posed(void **state)
{
    (void)state;
    const hg_term term = { hg_energy_find("hair_style"), 1, NULL, NULL };
    scene s;
    scene_make(&s, 2, 3, 20, 7, 0.3);
    result a = evaluate(&s, HG_F64, 1, &term, 1, HG_BACKEND_AUTO, false, "posed made", NULL);
    result b = evaluate(&s, HG_F64, 1, &term, 1, HG_BACKEND_AUTO, true, "posed given", NULL);
    assert_true(a.energy[0] > 0 && difference(a.energy, b.energy, 1) < 1e-12);
    assert_true(difference(a.gradient, b.gradient, s.B * s.S * s.V * 3) < 1e-12);
    result_free(&a);
    result_free(&b);
    scene_free(&s);
}

/* ---- invariance and rest --------------------------------------------------------------------------------------- */

/* Moves everything of the frame, the body too, by one rotation and translation. */
static void move_rigidly(scene *s, const double q[4], const double shift[3])
{
    double *points[] = { s->x, s->predicted, s->previous, s->posed, s->ghost, s->position, s->body };
    const int64_t n = s->B * s->S * s->V, counts[] = { n, n, n, n, n, s->B * s->S, s->B * 8 };
    for (int k = 0; k < 7; k++)
        for (int64_t i = 0; i < counts[k]; i++) {
            double turned[3];
            rotate_by(q, points[k] + 3 * i, turned);
            for (int c = 0; c < 3; c++) points[k][3 * i + c] = turned[c] + shift[c];
        }
    for (int64_t i = 0; i < s->B * s->S; i++) multiply(q, s->rotation + 4 * i, s->rotation + 4 * i);
    for (int64_t i = 0; i < s->B * s->S * (s->V - 1); i++) multiply(q, s->q + 4 * i, s->q + 4 * i);
}

static void check_invariance(const variant *v, void *self)
{
    (void)self;
    scene s;
    scene_make(&s, 2, 2, 8, 8, 0.3);
    const double q[4] = { 0.5, 0.1, -0.7, 0.5 }, shift[3] = { 0.3, -0.2, 0.5 };
    result a = evaluate(&s, HG_F64, 1, &v->term, 1, HG_BACKEND_INTERPRETER, false, v->label, NULL);
    move_rigidly(&s, q, shift);
    result b = evaluate(&s, HG_F64, 1, &v->term, 1, HG_BACKEND_INTERPRETER, false, v->label, NULL);
    for (int64_t i = 0; i < s.B * s.S * s.V; i++) { /* the gradient turns along */
        double turned[3];
        rotate_by(q, a.gradient + 3 * i, turned);
        memcpy(a.gradient + 3 * i, turned, sizeof turned);
    }
    const double off = fmax(difference(a.energy, b.energy, 1), difference(a.gradient, b.gradient, s.B * s.S * s.V * 3));
    if (v->term.energy->rigid_invariant && !(off < 1e-8))
        fail_msg("%s: a rigid motion changes it by %.3e", v->label, off);
    result_free(&a);
    result_free(&b);
    /* the other sign of the root's quaternion is the same rotation */
    for (int64_t i = 0; i < s.B * s.S * 4; i++) s.rotation[i] = -s.rotation[i];
    result c = evaluate(&s, HG_F64, 1, &v->term, 1, HG_BACKEND_INTERPRETER, false, v->label, NULL);
    for (int64_t i = 0; i < s.B * s.S * 4; i++) s.rotation[i] = -s.rotation[i];
    result d = evaluate(&s, HG_F64, 1, &v->term, 1, HG_BACKEND_INTERPRETER, false, v->label, NULL);
    if (!(difference(c.gradient, d.gradient, s.B * s.S * s.V * 3) < 1e-12 && difference(c.energy, d.energy, 1) < 1e-12))
        fail_msg("%s: q and -q differ", v->label);
    result_free(&c);
    result_free(&d);
    scene_free(&s);
}

static void test_invariance(void **state)
{
    (void)state;
    each_variant(check_invariance, NULL);
}

static void check_rest(const variant *v, void *self)
{
    (void)self;
    if (!v->term.energy->zero_at_rest) return;
    scene s;
    scene_make(&s, 2, 2, 8, 8, 0);
    const double q[4] = { 0.5, 0.1, -0.7, 0.5 }, shift[3] = { 0.3, -0.2, 0.5 };
    for (int64_t i = 0; i < s.B * s.S; i++) { /* the head at rest, then moved as a whole */
        memcpy(s.rotation + 4 * i, (double[]){ 1, 0, 0, 0 }, 4 * sizeof(double));
        memcpy(s.position + 3 * i, s.rest + (s.groom[i / s.S] * s.S + i % s.S) * s.V * 3, 3 * sizeof(double));
    }
    make_posed(&s);
    make_q(&s);
    memcpy(s.x, s.posed, (size_t)(s.B * s.S * s.V * 3) * sizeof(double));
    memcpy(s.ghost, s.posed, (size_t)(s.B * s.S * s.V * 3) * sizeof(double));
    for (int64_t i = 0; i < s.B * 8; i++) s.body[3 * i + 1] -= 1; /* the body is away */
    if (v->term.energy->rigid_invariant) move_rigidly(&s, q, shift);
    result a = evaluate(&s, HG_F64, 1, &v->term, 1, HG_BACKEND_INTERPRETER, false, v->label, NULL);
    double largest = 0;
    for (int64_t i = 0; i < s.B * s.S * s.V * 3; i++) largest = fmax(largest, fabs(a.gradient[i]));
    if (!(fabs(a.energy[0]) < 1e-18 && largest < 1e-12))
        fail_msg("%s: at rest it is %.3e, gradient %.3e", v->label, a.energy[0], largest);
    result_free(&a);
    scene_free(&s);
}

static void test_rest(void **state)
{
    (void)state;
    each_variant(check_rest, NULL);
}

/* ---- degenerate hair and every length --------------------------------------------------------------------------- */

enum { COLLAPSED_EDGE, COLLAPSED_STRAND, FOLDED, ROOT_REVERSED, COLLAPSED_REST, ALL_IN_ONE_POINT, DEGENERATE };

static void degrade(scene *s, int how)
{
    for (int64_t i = 0; i < s->B * s->S; i++) {
        double *x = s->x + i * s->V * 3;
        for (int64_t v = 1; v < s->V; v++)
            for (int c = 0; c < 3; c++) {
                if (how == COLLAPSED_EDGE && v == s->V / 2) x[3 * v + c] = x[3 * (v - 1) + c];
                if (how == COLLAPSED_STRAND) x[3 * v + c] = x[c];
                if (how == FOLDED && v >= 2)
                    x[3 * v + c] = x[3 * (v - 2) + c]; /* every edge antiparallel to the last */
                if (how == ALL_IN_ONE_POINT) x[3 * v + c] = 0;
            }
        if (how == ROOT_REVERSED && s->V > 1) { /* the root edge against where the head has turned it */
            const double *posed = s->posed + i * s->V * 3;
            for (int c = 0; c < 3; c++) x[3 + c] = x[c] - (posed[3 + c] - posed[c]);
        }
        if (how == ALL_IN_ONE_POINT)
            for (int c = 0; c < 3; c++) x[c] = 0;
    }
    if (how == COLLAPSED_REST)
        for (int64_t i = 0; i < s->G * s->S; i++)
            for (int64_t v = 1; v < s->V; v += 2)
                memcpy(s->rest + (i * s->V + v) * 3, s->rest + (i * s->V + v - 1) * 3, 24);
}

static void check_degenerate(const variant *v, void *self)
{
    (void)self;
    for (int how = 0; how < DEGENERATE; how++)
        for (int64_t V = 1; V <= 7; V++)
            for (int dtype = 0; dtype < 2; dtype++) {
                scene s;
                scene_make(&s, 1, 1, 3, V, 0.1);
                degrade(&s, how);
                result r = evaluate(&s, dtype ? HG_F64 : HG_F32, 1, &v->term, 1, HG_BACKEND_INTERPRETER, false,
                                    v->label, NULL);
                bool finite = isfinite(r.energy[0]);
                for (int64_t i = 0; i < s.B * s.S * V * 3; i++) finite &= isfinite(r.gradient[i]) != 0;
                if (!finite) fail_msg("%s: not finite for case %d, V %d", v->label, how, (int)V);
                result_free(&r);
                scene_free(&s);
            }
}

static void test_degenerate(void **state)
{
    (void)state;
    each_variant(check_degenerate, NULL);
    for (int sum = 0; sum < USUAL_SUMS; sum++) /* and printed */
        for (int how = 0; how < DEGENERATE; how++)
            for (int64_t V = 1; V <= 7; V++) {
                hg_term terms[8];
                const int n = usual_terms(sum, terms);
                scene s;
                scene_make(&s, 1, 1, 3, V, 0.1);
                degrade(&s, how);
                result r = evaluate(&s, HG_F32, 1, terms, n, HG_BACKEND_COMPILED, false, "printed", NULL);
                for (int t = 0; t < n; t++) assert_true(isfinite(r.energy[t]));
                for (int64_t i = 0; i < s.B * s.S * V * 3; i++) assert_true(isfinite(r.gradient[i]));
                result_free(&r);
                scene_free(&s);
            }
}

/* V from 1 to 40: a strand's energy does not depend on what lies beside it, and cutting vertices off changes no site. */
static void test_lengths(void **state)
{
    (void)state;
    for (int64_t V = 1; V <= 40; V++) {
        hg_term terms[8];
        const int n = usual_terms(WITH_STYLE, terms);
        hg_ctx *ctx = make_context(1);
        scene s;
        scene_make(&s, 1, 1, 2, V, 0.2);
        hg_physics *physics;
        ok(hg_physics_create(&physics, ctx, HG_F64, terms, n, &s.data), "lengths");
        const hg_frame frame = scene_frame(&s, ctx, HG_F64);
        hg_tensor *x = scene_x(&s, ctx, HG_F64), *gradient = scene_x(&s, ctx, HG_F64);
        double energies[8], total[2], *moved = numbers(hg_tensor_count(x));
        memcpy(moved, s.x, (size_t)hg_tensor_count(x) * sizeof *moved);
        ok(hg_physics_evaluate(physics, ctx, &frame, x, energies, NULL, gradient), "lengths");
        for (int64_t i = 0; i<hg_tensor_count(x); i += V> 4 ? V : 1) { /* a few derivatives */
            for (int side = 0; side < 2; side++) {
                moved[i] = s.x[i] + (side ? 1e-7 : -1e-7);
                ok(hg_tensor_write(x, moved), "lengths");
                ok(hg_physics_evaluate(physics, ctx, &frame, x, energies, NULL, NULL), "lengths");
                total[side] = 0;
                for (int t = 0; t < n; t++) total[side] += terms[t].weight * energies[t];
            }
            moved[i] = s.x[i];
            const double numeric = (total[1] - total[0]) / 2e-7, analytic = value(gradient, i);
            if (fabs(numeric - analytic) > 1e-5 * fmax(fabs(analytic), 1e-4))
                fail_msg("V %d, element %d: %.9e, by differences %.9e", (int)V, (int)i, analytic, numeric);
        }
        hg_free(moved);
        hg_physics_destroy(physics);
        scene_free(&s);
        hg_ctx_destroy(ctx);
    }
}

static void test_no_strands(void **state)
{
    (void)state;
    hg_term terms[8];
    const int n = usual_terms(0, terms);
    hg_ctx *ctx = make_context(2);
    const hg_groom_data data = { .grooms = 1, .strands = 0, .vertices = 5 };
    hg_physics *physics;
    ok(hg_physics_create(&physics, ctx, HG_F32, terms, n, &data), "no strands");
    hg_tensor *x = hg_tensor_create(ctx, HG_F32, 4, (int64_t[]){ 2, 0, 5, 3 });
    hg_tensor *predicted = hg_tensor_create(ctx, HG_F32, 4, (int64_t[]){ 2, 0, 5, 3 });
    double energies[8] = { 1, 1, 1, 1 };
    ok(hg_physics_evaluate(physics, ctx, &(hg_frame){ .predicted = predicted, .dt = 0.1 }, x, energies, NULL, NULL),
       "no strands");
    for (int t = 0; t < n; t++) assert_true(energies[t] == 0);
    hg_tensor_destroy(x);
    hg_tensor_destroy(predicted);
    hg_physics_destroy(physics);
    hg_ctx_destroy(ctx);
}

/* ---- on the tape, and what is refused ---------------------------------------------------------------------------- */

typedef struct {
    hg_physics *physics;
    hg_frame frame;
} taped;

static hg_tensor *taped_energy(void *self, hg_ctx *ctx, hg_tensor **in)
{
    taped *t = self;
    /* scaled, so that the gradient that arrives is not 1 */
    return hg_scale(ctx, hg_physics_energy(t->physics, ctx, &t->frame, in[0], NULL), 1e9, 0);
}

static void test_tape(void **state)
{
    (void)state;
    hg_term terms[8];
    const int n = usual_terms(WITH_STYLE, terms);
    hg_ctx *ctx = make_context(1);
    scene s;
    scene_make(&s, 1, 1, 2, 6, 0.1);
    taped t;
    ok(hg_physics_create(&t.physics, ctx, HG_F64, terms, n, &s.data), "tape");
    double *arrays[] = { s.rotation, s.position, s.predicted, s.previous, s.body, s.x };
    const int64_t shapes[6][4] = {
        { 1, 2, 4 }, { 1, 2, 3 }, { 1, 2, 6, 3 }, { 1, 2, 6, 3 }, { 1, 8, 3 }, { 1, 2, 6, 3 }
    };
    hg_tensor *kept[6]; /* a gradcheck resets the step */
    for (int k = 0; k < 6; k++) {
        kept[k] = hg_tensor_create(ctx, HG_F64, shapes[k][3] ? 4 : 3, shapes[k]);
        assert_int_equal(hg_tensor_write(kept[k], arrays[k]), HG_OK);
    }
    t.frame = (hg_frame){ .root_rotation = kept[0],
                          .root_position = kept[1],
                          .predicted = kept[2],
                          .previous = kept[3],
                          .body_vertices = kept[4],
                          .dt = 1.0 / 30 };
    hg_gradcheck_result check;
    hg_require_grad(kept[5]);
    const hg_status status =
        hg_gradcheck(ctx, taped_energy, &t, 1, &kept[5], &(hg_gradcheck_options){ .step = 1e-5 }, &check);
    if (status != HG_OK) fail_msg("%s (%s)", hg_message(), check.text);

    double unweighted[8], again[8];
    hg_tensor *energy = hg_physics_energy(t.physics, ctx, &t.frame, kept[5], unweighted);
    assert_non_null(energy);
    double total = 0;
    for (int i = 0; i < n; i++) total += terms[i].weight * unweighted[i];
    assert_true(fabs(value(energy, 0) - total) < 1e-12 * fabs(total));
    ok(hg_physics_evaluate(t.physics, ctx, &t.frame, kept[5], again, NULL, NULL), "tape");
    assert_memory_equal(unweighted, again, (size_t)n * sizeof(double));
    hg_step_reset(ctx);
    for (int k = 0; k < 6; k++) hg_tensor_destroy(kept[k]);
    hg_physics_destroy(t.physics);
    scene_free(&s);
    hg_ctx_destroy(ctx);
}

static void test_steady_state(void **state)
{
    (void)state;
    hg_term terms[8];
    const int n = usual_terms(WITH_STYLE, terms);
    hg_ctx *ctx = make_context(2);
    scene s;
    scene_make(&s, 1, 1, 100, 12, 0.1);
    hg_physics *physics;
    ok(hg_physics_create(&physics, ctx, HG_F32, terms, n, &s.data), "steady");
    size_t reserved = 0;
    for (int step = 0; step < 6; step++) {
        const hg_frame frame = scene_frame(&s, ctx, HG_F32);
        hg_tensor *x = scene_x(&s, ctx, HG_F32);
        double energies[8];
        ok(hg_physics_evaluate(physics, ctx, &frame, x, energies, NULL, NULL), "steady");
        if (step == 2) reserved = hg_step_reserved(ctx);
        if (step > 2) assert_int_equal(hg_step_reserved(ctx), reserved);
        hg_step_reset(ctx);
    }
    hg_physics_destroy(physics);
    scene_free(&s);
    hg_ctx_destroy(ctx);
}

static void refused(hg_ctx *ctx, const scene *s, const hg_term *term, const hg_groom_data *data, const char *word)
{
    (void)s;
    hg_physics *physics;
    assert_int_not_equal(hg_physics_create(&physics, ctx, HG_F64, term, 1, data), HG_OK);
    assert_null(physics);
    if (!strstr(hg_message(), word)) fail_msg("the message '%s' does not name '%s'", hg_message(), word);
}

static void test_refusals(void **state)
{
    (void)state;
    hg_ctx *ctx = make_context(1);
    scene s;
    scene_make(&s, 1, 1, 2, 4, 0.1);
    assert_null(hg_energy_find("strech"));
    assert_non_null(strstr(hg_message(), "stretch"));
    const char *wrong[HG_ENERGY_OPTIONS] = { "smoth" };
    refused(ctx, &s, &(hg_term){ hg_energy_find("bend_twist"), 1, NULL, wrong }, &s.data, "smoth");
    refused(ctx, &s, &(hg_term){ NULL, 1, NULL, NULL }, &s.data, "energy");
    refused(ctx, &s, &(hg_term){ hg_energy_find("stretch"), NAN, NULL, NULL }, &s.data, "weight");
    hg_groom_data data = s.data;
    data.body = NULL;
    refused(ctx, &s, &(hg_term){ hg_energy_find("body_collision"), 1, NULL, NULL }, &data, "body");
    data = s.data;
    data.n_attributes = 0;
    refused(ctx, &s, &(hg_term){ hg_energy_find("hair_style"), 1, NULL, NULL }, &data, "body_distance");
    data = s.data;
    data.vertices = 0;
    refused(ctx, &s, &(hg_term){ hg_energy_find("stretch"), 1, NULL, NULL }, &data, "vertex");
    const double kept = s.rest[4];
    s.rest[4] = NAN;
    refused(ctx, &s, &(hg_term){ hg_energy_find("stretch"), 1, NULL, NULL }, &s.data, "rest");
    s.rest[4] = kept;
    s.mass[1] = -1;
    refused(ctx, &s, &(hg_term){ hg_energy_find("gravity"), 1, NULL, NULL }, &s.data, "mass");
    s.mass[1] = 1;

    hg_physics *physics; /* what a frame does not bring */
    const hg_term inertia = { hg_energy_find("inertia"), 1, NULL, NULL };
    ok(hg_physics_create(&physics, ctx, HG_F64, &inertia, 1, &s.data), "inertia");
    hg_tensor *x = scene_x(&s, ctx, HG_F64);
    hg_frame frame = scene_frame(&s, ctx, HG_F64);
    double energy;
    frame.predicted = NULL;
    assert_int_equal(hg_physics_evaluate(physics, ctx, &frame, x, &energy, NULL, NULL), HG_INVALID);
    assert_non_null(strstr(hg_message(), "inertia"));
    assert_non_null(strstr(hg_message(), "predicted"));
    frame = scene_frame(&s, ctx, HG_F64);
    frame.dt = 0;
    assert_int_equal(hg_physics_evaluate(physics, ctx, &frame, x, &energy, NULL, NULL), HG_INVALID);
    frame = scene_frame(&s, ctx, HG_F64);
    frame.groom = (int32_t[]){ 1 };
    assert_int_equal(hg_physics_evaluate(physics, ctx, &frame, x, &energy, NULL, NULL), HG_INVALID);
    assert_non_null(strstr(hg_message(), "groom 1"));
    frame = scene_frame(&s, ctx, HG_F32);
    assert_int_equal(hg_physics_evaluate(physics, ctx, &frame, x, &energy, NULL, NULL), HG_INVALID);
    hg_physics_destroy(physics);
    scene_free(&s);
    hg_ctx_destroy(ctx);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_gradients),  cmocka_unit_test(test_f32),          cmocka_unit_test(test_hoisting),
        cmocka_unit_test(test_posed),      cmocka_unit_test(test_invariance),   cmocka_unit_test(test_rest),
        cmocka_unit_test(test_degenerate), cmocka_unit_test(test_lengths),      cmocka_unit_test(test_no_strands),
        cmocka_unit_test(test_tape),       cmocka_unit_test(test_steady_state), cmocka_unit_test(test_refusals),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
