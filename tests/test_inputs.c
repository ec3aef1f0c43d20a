/* What a call of a physics brings: gradients with respect to every input against finite differences, values that are
 * given but not differentiated, values carried from site to site, and what is refused. On the device of test_device(). */
#include "energies_walk.h"

#include "autograd/trace/strand.h"

#include "energies_inputs.h"

enum { MOST = 15 };

/* Everything that the scene can bring, as tensors that live on. */
typedef struct {
    hg_physics *physics;
    hg_frame frame;
    int n;
    hg_tensor *tensor[MOST]; /* x first */
    const char *name[MOST];
    hg_frame_input inputs[MOST];
} bench;

static hg_tensor *make_tensor(bench *b, hg_ctx *ctx, hg_dtype dtype, const char *name, int rank, const int64_t *shape,
                              const double *values, double low, double high, uint64_t stream)
{
    hg_tensor *t = hg_tensor_create(ctx, dtype, rank, shape);
    assert_non_null(t);
    double *made = numbers(hg_tensor_count(t));
    for (int64_t i = 0; i < hg_tensor_count(t); i++)
        made[i] = values ? values[i] : low + 0.5 * (high - low) * (1 + noise(stream, i));
    ok(hg_tensor_copy(t, upload(ctx, HG_F64, rank, shape, made)), name);
    hg_free(made);
    b->tensor[b->n] = t;
    b->name[b->n++] = name;
    return t;
}

enum { NUMBER, PER_STRAND, PER_FRAME }; /* shape of a param */

static void make_bench(bench *b, hg_ctx *ctx, const scene *s, hg_dtype dtype, const char *energy, int params)
{
    *b = (bench){ .frame = { .groom = s->groom, .dt = 0.1 } };
    const hg_term term = { hg_energy_find(energy), 1.3, NULL, NULL };
    ok(hg_physics_create(&b->physics, ctx, dtype, &term, 1, &s->data), energy);
    const int64_t B = s->B, S = s->S, V = s->V, G = s->G;
    const int64_t vertices[4] = { B, S, V, 3 }, rotation[3] = { B, S, 4 }, position[3] = { B, S, 3 },
                  rest[4] = { G, S, V, 3 }, edges[4] = { B, S, V - 1, 4 }, per[2] = { B, S };
    const bool every = strcmp(energy, "input_everything") == 0;
    make_tensor(b, ctx, dtype, "x", 4, vertices, s->x, 0, 0, 0);
    b->frame.root_rotation = make_tensor(b, ctx, dtype, "root_rotation", 3, rotation, s->rotation, 0, 0, 0);
    if (every) {
        b->frame.root_position = make_tensor(b, ctx, dtype, "root_position", 3, position, s->position, 0, 0, 0);
        b->frame.predicted = make_tensor(b, ctx, dtype, "predicted", 4, vertices, s->predicted, 0, 0, 0);
        b->frame.previous = make_tensor(b, ctx, dtype, "previous", 4, vertices, s->previous, 0, 0, 0);
    }
    const int named = b->n;
    make_tensor(b, ctx, dtype, "rest", 4, rest, s->rest, 0, 0, 0);
    make_tensor(b, ctx, dtype, "body_distance", 3, rest, s->body_distance, 0, 0, 0);
    make_tensor(b, ctx, dtype, "dt", params == NUMBER ? 0 : 1, &S, NULL, 0.05, 0.2, 20);
    const int rank = params == NUMBER ? 0 : params == PER_STRAND ? 1 : 2;
    const int64_t *shape = params == PER_FRAME ? per : &S;
    make_tensor(b, ctx, dtype, every ? "input_everything.stiffness" : "input_chain.stiffness", rank, shape, NULL, 1, 2,
                21);
    make_tensor(b, ctx, dtype, every ? "input_everything.bend" : "input_chain.bend", rank, shape, NULL, 0.2, 1, 22);
    if (every) {
        make_tensor(b, ctx, dtype, "mass", 3, rest, NULL, 0.5, 1.5, 23);
        make_tensor(b, ctx, dtype, "q", 4, edges, NULL, -1, 1, 24);
        make_tensor(b, ctx, dtype, "test_ghost", 4, vertices, s->previous, 0, 0, 0);
        make_tensor(b, ctx, dtype, "test_wind", 3, vertices, NULL, -1, 1, 25);
    }
    for (int i = named; i < b->n; i++) b->inputs[i - named] = (hg_frame_input){ b->name[i], b->tensor[i] };
    b->frame.inputs = b->inputs;
    b->frame.n_inputs = b->n - named;
}

static void free_bench(bench *b)
{
    for (int i = 0; i < b->n; i++) hg_tensor_destroy(b->tensor[i]);
    hg_physics_destroy(b->physics);
}

static hg_tensor *bench_energy(void *self, hg_ctx *ctx, hg_tensor **in)
{
    bench *b = self;
    return hg_scale(ctx, hg_physics_energy(b->physics, ctx, &b->frame, in[0], NULL), 2, 0);
}

static void check_gradients(const char *energy, int params, int64_t V)
{
    hg_ctx *ctx = make_context(1);
    scene s;
    scene_make(&s, 2, 3, 2, V, 0.2);
    bench b;
    make_bench(&b, ctx, &s, HG_F64, energy, params);
    for (int i = 0; i < b.n; i++) hg_require_grad(b.tensor[i]);
    hg_gradcheck_result check;
    const hg_gradcheck_options how = { .step = 1e-4, .directions = 24, .zero_gradient = V <= 3 };
    const hg_status status = hg_gradcheck(ctx, bench_energy, &b, b.n, b.tensor, &how, &check);
    print_message("    %s V %d: worst %.1e of %s\n", energy, (int)V, check.worst, b.name[check.input]);
    if (status != HG_OK) fail_msg("%s, V %d, %s: %s", energy, (int)V, b.name[check.input], hg_message());
    hg_step_reset(ctx);
    free_bench(&b);
    scene_free(&s);
    hg_ctx_destroy(ctx);
}

static void test_gradients(void **state)
{
    (void)state;
    for (int params = NUMBER; params <= PER_FRAME; params++) check_gradients("input_everything", params, 5);
    for (int64_t V = 2; V <= 4; V++) check_gradients("input_everything", PER_STRAND, V);
}

static void test_carried(void **state)
{
    (void)state;
    for (int params = NUMBER; params <= PER_FRAME; params++) check_gradients("input_chain", params, 6);
    for (int64_t V = 3; V <= 9; V++) check_gradients("input_chain", PER_STRAND, V);
}

/* Where the root position is not given it is the rest root, also for the gradient of a rest groom that is; and a posed
 * groom that is given has its own. */
static void test_posed(void **state)
{
    (void)state;
    for (int given = 0; given < 2; given++) {
        hg_ctx *ctx = make_context(1);
        scene s;
        scene_make(&s, 2, 3, 2, 5, 0.3);
        const int64_t vertices[4] = { 3, 2, 5, 3 }, rest[4] = { 2, 2, 5, 3 }, rotation[3] = { 3, 2, 4 };
        const hg_term terms[] = { { hg_energy_find("shear"), 1e6, NULL, NULL },
                                  { hg_energy_find("hair_style"), 1e6, NULL, NULL } };
        bench b = { .frame = { .groom = s.groom } };
        ok(hg_physics_create(&b.physics, ctx, HG_F64, terms, 2, &s.data), "posed");
        make_tensor(&b, ctx, HG_F64, "x", 4, vertices, s.x, 0, 0, 0);
        hg_tensor *r = make_tensor(&b, ctx, HG_F64, "rest", 4, rest, s.rest, 0, 0, 0);
        if (given)
            b.frame.posed = make_tensor(&b, ctx, HG_F64, "posed", 4, vertices, s.posed, 0, 0, 0);
        else
            b.frame.root_rotation = make_tensor(&b, ctx, HG_F64, "root_rotation", 3, rotation, s.rotation, 0, 0, 0);
        b.inputs[0] = (hg_frame_input){ "rest", r };
        b.frame.inputs = b.inputs;
        b.frame.n_inputs = 1;
        for (int i = 0; i < b.n; i++) hg_require_grad(b.tensor[i]);
        hg_gradcheck_result check;
        const hg_status status =
            hg_gradcheck(ctx, bench_energy, &b, b.n, b.tensor, &(hg_gradcheck_options){ .step = 1e-5 }, &check);
        if (status != HG_OK) fail_msg("%s: %s", b.name[check.input], hg_message());
        hg_step_reset(ctx);
        free_bench(&b);
        scene_free(&s);
        hg_ctx_destroy(ctx);
    }
}

/* ---- strand_length ----------------------------------------------------------------------------------------------- */

static void make_lengths(bench *b, hg_ctx *ctx, const scene *s, hg_dtype dtype)
{
    static const char *const options[HG_ENERGY_OPTIONS] = { "softening" };
    const int64_t vertices[4] = { s->B, s->S, s->V, 3 }, rest[4] = { s->G, s->S, s->V, 3 };
    const hg_term term = { hg_energy_find("integrity"), 1e6, NULL, options };
    *b = (bench){ .frame = { .groom = s->groom, .inputs = b->inputs, .n_inputs = 2 } };
    ok(hg_physics_create(&b->physics, ctx, dtype, &term, 1, &s->data), "lengths");
    make_tensor(b, ctx, dtype, "x", 4, vertices, s->x, 0, 0, 0);
    make_tensor(b, ctx, dtype, "rest", 4, rest, s->rest, 0, 0, 0);
    make_tensor(b, ctx, dtype, "ghost", 4, vertices, s->ghost, 0, 0, 0);
    for (int i = 0; i < 2; i++) b->inputs[i] = (hg_frame_input){ b->name[1 + i], b->tensor[1 + i] };
    for (int i = 0; i < b->n; i++) hg_require_grad(b->tensor[i]);
}

/* One x in two calls: what they hand back adds up. */
static hg_tensor *twice_energy(void *self, hg_ctx *ctx, hg_tensor **in)
{
    bench *b = self;
    hg_tensor *one = hg_physics_energy(b->physics, ctx, &b->frame, in[0], NULL);
    return hg_add(ctx, one, hg_scale(ctx, hg_physics_energy(b->physics, ctx, &b->frame, in[0], NULL), 2, 0));
}

/* Value, then gradients of x, rest and ghost. */
static double *lengths_on(const char *device, const scene *s, hg_dtype dtype, int64_t *n)
{
    hg_ctx *ctx = make_context_on(device, 1);
    bench b;
    make_lengths(&b, ctx, s, dtype);
    double *found = numbers(1 + (2 * s->B + s->G) * s->S * s->V * 3);
    hg_tensor *energy = twice_energy(&b, ctx, b.tensor);
    if (!energy) fail_msg("%s", hg_message());
    ok(hg_backward(ctx, energy), "lengths");
    found[0] = value(energy, 0);
    *n = 1;
    for (int i = 0; i < b.n; i++) {
        ok(hg_tensor_numbers(hg_grad(b.tensor[i]), found + *n), b.name[i]);
        *n += hg_tensor_count(b.tensor[i]);
    }
    hg_step_reset(ctx);
    free_bench(&b);
    hg_ctx_destroy(ctx);
    return found;
}

/* The length of a rest groom that is given follows it, and hands on what comes to it; an edge without length hands on nothing. On
 * a device as on the processor. */
static void test_lengths(void **state)
{
    (void)state;
    scene s;
    scene_make(&s, 2, 3, 4, 6, 0.3);
    hg_ctx *ctx = make_context(1);
    bench b;
    make_lengths(&b, ctx, &s, HG_F64);
    hg_gradcheck_result check;
    const hg_status status =
        hg_gradcheck(ctx, twice_energy, &b, b.n, b.tensor, &(hg_gradcheck_options){ .step = 1e-5 }, &check);
    if (status != HG_OK) fail_msg("%s: %s", b.name[check.input], hg_message());
    hg_step_reset(ctx);
    free_bench(&b);
    hg_ctx_destroy(ctx);
    memcpy(s.rest + 9, s.rest + 6, 3 * sizeof(double));
    for (int single = 0; single < 2; single++) {
        const hg_dtype dtype = single ? HG_F32 : HG_F64;
        int64_t n, m;
        double *expected = lengths_on("cpu", &s, dtype, &n), *found = lengths_on(test_device(), &s, dtype, &m);
        const int64_t vertices = s.B * s.S * s.V * 3, rest = s.G * s.S * s.V * 3;
        assert_true(n == m && n == 1 + 2 * vertices + rest);
        double most = 0; /* of what came to the rest groom */
        for (int64_t i = 0; i < rest; i++) most = fmax(most, fabs(expected[1 + vertices + i]));
        assert_true(expected[0] > 0 && most > 0);
        const double limit = single ? 1e-5 : 1e-12;
        assert_true(difference(expected, found, 1) < limit);
        assert_true(difference(expected + 1, found + 1, vertices) < limit);
        assert_true(difference(expected + 1 + vertices, found + 1 + vertices, rest) < limit);
        assert_true(difference(expected + 1 + vertices + rest, found + 1 + vertices + rest, vertices) < limit);
        hg_free(expected);
        hg_free(found);
    }
    scene_free(&s);
}

/* ---- back ends, threads, and values without a gradient ----------------------------------------------------------- */

typedef struct {
    double energy, *gradient[MOST];
} outcome;

/* wanted: of which tensors a gradient is asked for, besides x */
static outcome run_bench(const char *energy, int params, int64_t S, int64_t V, hg_dtype dtype, int threads,
                         hg_backend backend, unsigned wanted)
{
    hg_ctx *ctx = make_context(threads);
    scene s;
    scene_make(&s, 2, 3, S, V, 0.2);
    bench b;
    make_bench(&b, ctx, &s, dtype, energy, params);
    if (backend != HG_BACKEND_AUTO && hg_ctx_host(ctx)) ok(hg_physics_backend(b.physics, backend), energy);
    outcome o = { 0 };
    for (int i = 0; i < b.n; i++)
        if (i == 0 || wanted >> i & 1) hg_require_grad(b.tensor[i]);
    hg_tensor *out = bench_energy(&b, ctx, b.tensor);
    if (!out) fail_msg("%s: %s", energy, hg_message());
    ok(hg_backward(ctx, out), energy);
    o.energy = value(out, 0);
    for (int i = 0; i < b.n; i++) {
        if (i && !(wanted >> i & 1)) continue;
        o.gradient[i] = numbers(hg_tensor_count(b.tensor[i]) + 1);
        o.gradient[i][0] = (double)hg_tensor_count(b.tensor[i]);
        for (int64_t k = 0; k < hg_tensor_count(b.tensor[i]); k++)
            o.gradient[i][1 + k] = value(hg_grad(b.tensor[i]), k);
    }
    hg_step_reset(ctx);
    free_bench(&b);
    scene_free(&s);
    hg_ctx_destroy(ctx);
    return o;
}

static void outcome_free(outcome *o)
{
    for (int i = 0; i < MOST; i++) hg_free(o->gradient[i]);
}

/* limit 0: bit for bit */
static void same(const outcome *a, const outcome *b, double limit, const char *what)
{
    if (fabs(a->energy - b->energy) > limit * fabs(a->energy))
        fail_msg("%s: energies %.17g and %.17g", what, a->energy, b->energy);
    for (int i = 0; i < MOST; i++) {
        if (!a->gradient[i] || !b->gradient[i]) continue;
        const int64_t n = (int64_t)a->gradient[i][0];
        const double off = limit == 0 ? memcmp(a->gradient[i], b->gradient[i], (size_t)(n + 1) * sizeof(double)) != 0
                                      : difference(a->gradient[i] + 1, b->gradient[i] + 1, n);
        if (!(off <= limit)) fail_msg("%s: gradient of input %d is off by %.3e", what, i, off);
    }
}

static void test_threads(void **state)
{
    (void)state;
    for (int chain = 0; chain < 2; chain++)
        for (int dtype = 0; dtype < 2; dtype++) {
            const char *energy = chain ? "input_chain" : "input_everything";
            const hg_dtype type = dtype ? HG_F64 : HG_F32;
            outcome a = run_bench(energy, NUMBER, 300, 7, type, 1, HG_BACKEND_INTERPRETER, ~0u),
                    b = run_bench(energy, NUMBER, 300, 7, type, 2, HG_BACKEND_INTERPRETER, ~0u),
                    c = run_bench(energy, NUMBER, 300, 7, type, 2, HG_BACKEND_INTERPRETER, 0);
            same(&a, &b, 0, "threads");
            same(&a, &c, dtype ? 1e-12 : 1e-5, "given without a gradient");
            outcome_free(&a);
            outcome_free(&b);
            outcome_free(&c);
        }
}

/* What is printed is compiled when it is met first. */
static void test_compiled(void **state)
{
    (void)state;
    if (system("cc --version > /dev/null 2>&1") != 0) skip();
    for (int chain = 0; chain < 2; chain++)
        for (int dtype = 0; dtype < 2; dtype++)
            for (int64_t V = 1; V <= 8; V += V < 5 ? 1 : 3) {
                const char *energy = chain ? "input_chain" : "input_everything";
                const hg_dtype type = dtype ? HG_F64 : HG_F32;
                char label[64];
                snprintf(label, sizeof label, "%s V %d %s", energy, (int)V, hg_dtype_name(type));
                outcome a = run_bench(energy, PER_STRAND, 37, V, type, 1, HG_BACKEND_INTERPRETER, ~0u),
                        b = run_bench(energy, PER_STRAND, 37, V, type, 2, HG_BACKEND_COMPILED, ~0u);
                same(&a, &b, dtype ? 1e-11 : 3e-5, label);
                outcome_free(&a);
                outcome_free(&b);
            }
}

/* ---- what carried values and made arrays mean -------------------------------------------------------------------- */

static double own_energy(hg_ctx *ctx, const scene *s, const char *name, const double *params, const hg_frame *frame,
                         double *gradient)
{
    const hg_term term = { hg_energy_find(name), 1, params, NULL };
    hg_physics *physics;
    double energy;
    ok(hg_physics_create(&physics, ctx, HG_F64, &term, 1, &s->data), name);
    hg_tensor *x = scene_x(s, ctx, HG_F64), *out = scene_x(s, ctx, HG_F64);
    ok(hg_physics_evaluate(physics, ctx, frame, x, &energy, NULL, out), name);
    for (int64_t i = 0; gradient && i < hg_tensor_count(out); i++) gradient[i] = value(out, i);
    hg_physics_destroy(physics);
    return energy;
}

static double edge_length(const double *points, int64_t edge)
{
    const double *a = points + 3 * edge;
    return sqrt((a[3] - a[0]) * (a[3] - a[0]) + (a[4] - a[1]) * (a[4] - a[1]) + (a[5] - a[2]) * (a[5] - a[2]));
}

static void test_meaning(void **state)
{
    (void)state;
    for (int64_t V = 1; V <= 12; V++) {
        hg_ctx *ctx = make_context(1);
        scene s;
        scene_make(&s, 2, 3, 5, V, 0.2);
        const hg_frame frame = { .groom = s.groom };
        double number = 0, length = 0, rest_length = 0, *gradient = numbers(s.B * s.S * V * 3);
        for (int64_t i = 0; i < s.B * s.S; i++)
            for (int64_t e = 0; e + 1 < V; e++) { /* an edge counts once in every site after it */
                number += (double)e;
                length += (double)(V - 2 - e) * edge_length(s.x + i * V * 3, e);
                rest_length +=
                    (double)(V - 2 - e) * edge_length(s.rest + (s.groom[i / s.S] * s.S + i % s.S) * V * 3, e);
            }
        assert_true(fabs(own_energy(ctx, &s, "input_count", (double[3]){ 1, 0, 0 }, &frame, gradient) - number) < 1e-9);
        for (int64_t i = 0; i < s.B * s.S * V * 3; i++) assert_true(gradient[i] == 0);
        const double now = own_energy(ctx, &s, "input_count", (double[3]){ 0, 1, 0 }, &frame, gradient);
        assert_true(fabs(now - length) <= 1e-12 * length);
        const double then = own_energy(ctx, &s, "input_count", (double[3]){ 0, 0, 1 }, &frame, NULL);
        assert_true(fabs(then - rest_length) <= 1e-12 * rest_length);
        for (int64_t i = 0; V > 2 && i < s.B * s.S; i++) { /* pulling the root shortens the first edge, V - 2 times */
            const double *x = s.x + i * V * 3, *g = gradient + i * V * 3;
            for (int c = 0; c < 3; c++)
                assert_true(fabs(g[c] - (double)(V - 2) * (x[c] - x[3 + c]) / edge_length(x, 0)) < 1e-12 * (double)V);
        }
        hg_free(gradient);
        scene_free(&s);
        hg_ctx_destroy(ctx);
    }
}

static void test_window_of_one(void **state)
{
    (void)state;
    for (int64_t V = 1; V <= 6; V++) {
        hg_ctx *ctx = make_context(1);
        scene s;
        scene_make(&s, 1, 2, 5, V, 0.2);
        const hg_frame frame = { 0 };
        const int64_t n = s.B * s.S * V * 3;
        double *a = numbers(n), *b = numbers(n);
        const double carried = own_energy(ctx, &s, "input_last", NULL, &frame, a),
                     edges = own_energy(ctx, &s, "input_edges", NULL, &frame, b);
        assert_true(fabs(carried - edges) <= 1e-14 * edges && difference(a, b, n) < 1e-14);
        hg_free(a);
        hg_free(b);
        scene_free(&s);
        hg_ctx_destroy(ctx);
    }
}

/* Several carriers, windows of other widths and root terms in one pass: nothing disturbs another. */
static void test_together(void **state)
{
    (void)state;
    const char *const names[] = { "input_last",  "bend_twist_chain", "spring_torsion", "input_count",
                                  "input_edges", "bend_twist",       "gravity",        "input_chain" };
    enum { N = sizeof names / sizeof *names };
    const char *options[HG_ENERGY_OPTIONS] = { "smooth", "clamped" };
    const double counts[] = { 0.1, 0.2, 0.3 };
    hg_term terms[N];
    for (int t = 0; t < N; t++) {
        const hg_energy *energy = hg_energy_find(names[t]);
        terms[t] = (hg_term){ energy, 0.5 + t, strcmp(names[t], "input_count") == 0 ? counts : NULL,
                              energy->options[1].name ? options : NULL };
    }
    for (int64_t V = 1; V <= 9; V++) {
        scene s;
        scene_make(&s, 2, 2, 7, V, 0.2);
        const int64_t n = s.B * s.S * V * 3;
        double *sum = numbers(n);
        result all = evaluate(&s, HG_F64, 1, terms, N, HG_BACKEND_INTERPRETER, false, "together", NULL);
        for (int t = 0; t < N; t++) {
            result one = evaluate(&s, HG_F64, 1, &terms[t], 1, HG_BACKEND_INTERPRETER, false, names[t], NULL);
            if (difference(one.energy, all.energy + t, 1) > 1e-13) fail_msg("%s is another in company", names[t]);
            for (int64_t i = 0; i < n; i++) sum[i] += one.gradient[i];
            result_free(&one);
        }
        assert_true(difference(sum, all.gradient, n) < 1e-12);
        hg_free(sum);
        result_free(&all);
        scene_free(&s);
    }
}

static void test_mean(void **state)
{
    (void)state;
    hg_ctx *ctx = make_context(2);
    scene s;
    scene_make(&s, 1, 6, 3, 4, 0.2);
    const int64_t row = s.S * s.V * 3, shape[4] = { s.B, s.S, s.V, 3 };
    for (int64_t consecutive = 0; consecutive <= 6; consecutive++) {
        hg_tensor *d = upload(ctx, HG_F64, 4, shape, s.deformation);
        const hg_frame_input input = { "deformation", d };
        const hg_frame frame = { .consecutive = consecutive, .inputs = &input, .n_inputs = 1 };
        const int64_t group = consecutive ? consecutive : s.B;
        const hg_term term = { hg_energy_find("input_mean"), 2, NULL, NULL };
        hg_physics *physics;
        ok(hg_physics_create(&physics, ctx, HG_F64, &term, 1, &s.data), "mean");
        hg_tensor *x = scene_x(&s, ctx, HG_F64);
        hg_require_grad(d);
        hg_tensor *energy = hg_physics_energy(physics, ctx, &frame, x, NULL);
        if (s.B % group) {
            assert_null(energy);
            assert_non_null(strstr(hg_message(), "consecutive"));
        } else {
            ok(hg_backward(ctx, energy), "mean");
            double expected = 0;
            for (int64_t k = 0; k < s.B * row; k++) {
                double mean = 0;
                for (int64_t f = 0; f < group; f++)
                    mean += s.deformation[(k / row / group * group + f) * row + k % row] / (double)group;
                const double off = s.deformation[k] - mean;
                expected += off * off; /* weight 2 of a half */
                assert_true(fabs(value(hg_grad(d), k) - 2 * off) < 1e-15);
            }
            assert_true(fabs(value(energy, 0) - expected) <= 1e-12 * expected);
        }
        hg_physics_destroy(physics);
        hg_step_reset(ctx);
        hg_ctx_destroy(ctx);
        ctx = make_context(2);
    }
    scene_free(&s);
    hg_ctx_destroy(ctx);
}

/* ---- free orientations ------------------------------------------------------------------------------------------- */

static double cosserat(hg_ctx *ctx, const scene *s, const char *name, const double *orientations)
{
    const int64_t shape[4] = { s->B, s->S, s->V - 1, 4 };
    const hg_frame_input input = { "q", upload(ctx, HG_F64, 4, shape, orientations) };
    const hg_frame frame = { .groom = s->groom, .inputs = &input, .n_inputs = 1 };
    const double energy = own_energy(ctx, s, name, (double[]){ 1 }, &frame, NULL);
    assert_true(isfinite(energy));
    return energy;
}

/* Zero where x is the turned rest groom and q its turned frames; q and -q are the same; a zero q is finite. */
static void test_orientations(void **state)
{
    (void)state;
    hg_ctx *ctx = make_context(1);
    scene s;
    scene_make(&s, 2, 2, 4, 9, 0);
    const double e3[3] = { 0, 0, 1 };
    const int64_t E = s.V - 1, n = s.B * s.S * E;
    double *orientation = numbers(4 * n);
    memcpy(s.x, s.posed, (size_t)(s.B * s.S * s.V * 3) * sizeof(double));
    for (int64_t i = 0; i < s.B * s.S; i++) {
        const double *rest = s.rest + (s.groom[i / s.S] * s.S + i % s.S) * s.V * 3;
        double frame[4], tangent[2][3];
        for (int64_t e = 0; e < E; e++) {
            for (int c = 0; c < 3; c++)
                tangent[e & 1][c] = (rest[3 * e + 3 + c] - rest[3 * e + c]) / edge_length(rest, e);
            double turn[4];
            shortest(e ? tangent[(e - 1) & 1] : e3, tangent[e & 1], turn);
            if (e)
                multiply(turn, frame, frame);
            else
                memcpy(frame, turn, sizeof frame);
            multiply(s.rotation + 4 * i, frame, orientation + 4 * (i * E + e));
        }
    }
    const char *const names[] = { "cosserat_stretch_shear", "cosserat_bend_twist", "unit_quaternion" };
    for (int k = 0; k < 3; k++) assert_true(fabs(cosserat(ctx, &s, names[k], orientation)) < 1e-20);
    double before[3];
    for (int64_t i = 0; i < 4 * n; i++) orientation[i] += 0.1 * noise(40, i);
    for (int k = 0; k < 3; k++) assert_true((before[k] = cosserat(ctx, &s, names[k], orientation)) > 1e-6);
    for (int64_t i = 0; i < 4 * n; i++)
        if (i / 4 % 3 == 0) orientation[i] = -orientation[i];
    for (int k = 0; k < 3; k++)
        assert_true(fabs(cosserat(ctx, &s, names[k], orientation) - before[k]) < 1e-12 * before[k]);
    memset(orientation, 0, (size_t)(4 * n) * sizeof(double));
    for (int k = 0; k < 3; k++) cosserat(ctx, &s, names[k], orientation);
    hg_free(orientation);
    scene_free(&s);
    hg_ctx_destroy(ctx);
}

/* ---- what a call may bring --------------------------------------------------------------------------------------- */

static void says(const char *a, const char *b)
{
    if (!strstr(hg_message(), a) || !strstr(hg_message(), b))
        fail_msg("the message '%s' does not say '%s' and '%s'", hg_message(), a, b);
}

/* A value that is given says the same as the term or the groom when it is the same. */
static void test_given(void **state)
{
    (void)state;
    hg_ctx *ctx = make_context(1);
    scene s;
    scene_make(&s, 2, 2, 5, 6, 0.2);
    hg_term terms[8];
    const int n = usual_terms(WITH_STYLE, terms);
    hg_physics *physics;
    ok(hg_physics_create(&physics, ctx, HG_F64, terms, n, &s.data), "given");
    hg_frame frame = scene_frame(&s, ctx, HG_F64);
    double expected[8], found[8], stiffness[5], twice[1];
    hg_tensor *x = scene_x(&s, ctx, HG_F64), *a = scene_x(&s, ctx, HG_F64), *b = scene_x(&s, ctx, HG_F64);
    ok(hg_physics_evaluate(physics, ctx, &frame, x, expected, NULL, a), "given");
    const hg_energy *stretch = hg_energy_find("stretch");
    for (int i = 0; i < 5; i++) stiffness[i] = stretch->params[0].value;
    twice[0] = 2 * stretch->params[0].value;
    const int64_t groom[4] = { s.G, s.S, s.V, 3 };
    const double dt = frame.dt;
    hg_frame_input inputs[] = { { "stretch.stiffness", upload(ctx, HG_F64, 1, (int64_t[]){ 5 }, stiffness) },
                                { "rest", upload(ctx, HG_F64, 4, groom, s.rest) },
                                { "mass", upload(ctx, HG_F64, 3, groom, s.mass) },
                                { "scalp_distance", upload(ctx, HG_F64, 3, groom, s.scalp_distance) },
                                { "dt", upload(ctx, HG_F64, 0, NULL, &dt) } };
    frame.inputs = inputs;
    hg_frame_input some[5];
    frame.inputs = some;
    for (int round = 0; round < 64; round++) { /* every combination, more than are kept, twice */
        frame.n_inputs = 0;
        for (int i = 0; i < 5; i++)
            if (round >> i & 1) some[frame.n_inputs++] = inputs[i];
        ok(hg_physics_evaluate(physics, ctx, &frame, x, found, NULL, b), "given");
        assert_true(difference(expected, found, n) < 1e-12);
        double *both = numbers(2 * hg_tensor_count(a));
        ok(hg_tensor_read(a, both), "given");
        ok(hg_tensor_read(b, both + hg_tensor_count(a)), "given");
        assert_true(difference(both, both + hg_tensor_count(a), hg_tensor_count(a)) < 1e-12);
        hg_free(both);
    }
    some[0] = (hg_frame_input){ "stretch.stiffness", upload(ctx, HG_F64, 0, NULL, twice) };
    frame.n_inputs = 1;
    ok(hg_physics_evaluate(physics, ctx, &frame, x, found, NULL, NULL), "given");
    for (int t = 0; t < n; t++)
        assert_true(fabs(found[t] - (terms[t].energy == stretch ? 2 : 1) * expected[t]) <= 1e-12 * fabs(expected[t]));
    const double none = 0; /* a device's memory is not waited for */
    some[0] = (hg_frame_input){ "dt", upload(ctx, HG_F64, 0, NULL, &none) };
    if (hg_ctx_host(ctx)) {
        assert_int_equal(hg_physics_evaluate(physics, ctx, &frame, x, found, NULL, NULL), HG_INVALID);
        says("'dt'", "positive");
    }
    hg_physics_destroy(physics);
    scene_free(&s);
    hg_ctx_destroy(ctx);
}

/* Once it is known what calls bring, nothing is traced and nothing is allocated. */
static void test_steady(void **state)
{
    (void)state;
    hg_ctx *ctx = make_context(2);
    scene s;
    scene_make(&s, 1, 2, 50, 8, 0.2);
    bench b;
    make_bench(&b, ctx, &s, HG_F32, "input_chain", PER_STRAND);
    for (int i = 0; i < b.n; i++) hg_require_grad(b.tensor[i]);
    int64_t allocations = 0;
    for (int step = 0; step < 6; step++) {
        ok(hg_backward(ctx, bench_energy(&b, ctx, b.tensor)), "steady");
        b.frame.n_inputs -= 1; /* another combination in between */
        ok(hg_backward(ctx, bench_energy(&b, ctx, b.tensor)), "steady");
        b.frame.n_inputs += 1;
        hg_step_reset(ctx);
        if (step == 3) allocations = hg_alloc_count();
    }
    assert_int_equal(hg_alloc_count(), allocations);
    free_bench(&b);
    scene_free(&s);
    hg_ctx_destroy(ctx);
}

static void test_refusals(void **state)
{
    (void)state;
    hg_ctx *ctx = make_context(1);
    scene s;
    scene_make(&s, 1, 2, 3, 4, 0.2);
    const hg_term terms[] = { { hg_energy_find("stretch"), 1, NULL, NULL },
                              { hg_energy_find("body_collision"), 1, NULL, NULL },
                              { hg_energy_find("unit_quaternion"), 1, NULL, NULL } };
    hg_physics *physics;
    ok(hg_physics_create(&physics, ctx, HG_F64, terms, 3, &s.data), "refusals");
    hg_frame frame = scene_frame(&s, ctx, HG_F64);
    hg_tensor *x = scene_x(&s, ctx, HG_F64);
    double energies[3];
    const double ones[4 * 24] = { 1 };
    const int64_t q[4] = { 2, 3, 3, 4 }, strands[1] = { 3 };
    hg_frame_input inputs[3] = { { "q", upload(ctx, HG_F64, 4, q, ones) } };
#define REFUSED(name_, value_, a, b)                                                                                   \
    inputs[1] = (hg_frame_input){ name_, value_ };                                                                     \
    assert_int_not_equal(hg_physics_evaluate(physics, ctx, &frame, x, energies, NULL, NULL), HG_OK);                   \
    says(a, b)
    assert_int_equal(hg_physics_evaluate(physics, ctx, &frame, x, energies, NULL, NULL), HG_INVALID);
    says("unit_quaternion", "\"q\" [B,S,V-1,4]");
    frame.inputs = inputs;
    frame.n_inputs = 2;
    hg_tensor *number = upload(ctx, HG_F64, 1, strands, ones);
    REFUSED("stretch.stifness", number, "stretch.stifness", "stretch.stiffness, body_collision.stiffness");
    REFUSED("ghost", number, "'ghost'", "rest, q");
    REFUSED("dt", number, "'dt'", "stretch.stiffness");
    REFUSED("stretch.stiffness", x, "[2,3,4,3]", "[], [S] or [B,S]");
    REFUSED("stretch.stiffness", upload(ctx, HG_F32, 1, strands, ones), "f32 [3]", "f64");
    REFUSED("rest", x, "'rest'", "[G,S,V,3]");
    REFUSED("q", inputs[0].value, "'q'", "twice");
    REFUSED("rest", NULL, "input 1", "no value");
    frame.n_inputs = 1;
    hg_require_grad(frame.body_vertices);
    assert_null(hg_physics_energy(physics, ctx, &frame, x, NULL));
    says("body_vertices", "detach");
    hg_physics_destroy(physics);
    scene_free(&s);
    hg_ctx_destroy(ctx);
}

static void formula_refused(hg_scalar (*formula)(void), uint32_t allowed, const char *a, const char *b)
{
    const hg_trace_scope broken = { .name = "broken", .allowed = allowed, .window = 2 };
    hg_formula_names names;
    assert_int_equal(hg_formula_reads(formula, &broken, &names), HG_INVALID);
    says(a, b);
    hg_formula_names_free(&names);
    const hg_strand_term term = { broken, formula, NULL };
    hg_strand_program *program;
    assert_int_equal(hg_strand_program_create(&program, HG_F64, 1, &term, 0, NULL, true), HG_INVALID);
    says(a, b);
}

static void test_formulas(void **state)
{
    (void)state;
    formula_refused(not_kept, HG_ALLOW_WINDOW, "carries 'one'", "does not keep");
    formula_refused(not_carried, HG_ALLOW_WINDOW, "keeps 'one'", "does not carry");
    formula_refused(kept_twice, HG_ALLOW_WINDOW, "'one' twice", "kept once");
    formula_refused(carried_twice, HG_ALLOW_WINDOW, "'one' twice", "carried once");
    formula_refused(kept_as_vector, HG_ALLOW_WINDOW, "'one'", "something else");
    formula_refused(no_such_edge, HG_ALLOW_WINDOW, "q(1)", "1 edges");
    formula_refused(two_widths, HG_ALLOW_WINDOW, "'wind'", "vectors");
    formula_refused(kept_twice, HG_ALLOW_PAIRS, "carried value", "does not have");
    formula_refused(no_such_edge, HG_ALLOW_FIELD, "asks for q", "does not have");
    formula_refused(two_widths, HG_ALLOW_FIELD_KERNEL, "named array", "does not have");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_gradients), cmocka_unit_test(test_carried),      cmocka_unit_test(test_posed),
        cmocka_unit_test(test_lengths),   cmocka_unit_test(test_threads),      cmocka_unit_test(test_compiled),
        cmocka_unit_test(test_meaning),   cmocka_unit_test(test_mean),         cmocka_unit_test(test_window_of_one),
        cmocka_unit_test(test_together),  cmocka_unit_test(test_orientations), cmocka_unit_test(test_given),
        cmocka_unit_test(test_steady),    cmocka_unit_test(test_refusals),     cmocka_unit_test(test_formulas),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
