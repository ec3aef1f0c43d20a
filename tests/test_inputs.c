/* What a call of a physics brings: gradients with respect to every input against finite differences, values that are
 * given but not differentiated, values carried from site to site, and what is refused. */
#include "energies_walk.h"

#include "autograd/trace/names.h"

/* Every input of a window, differentiable in all of them: three vertices, two edges. */
static scalar input_everything(void)
{
    vec3 e = mul(200, sub(x(1), x(0))), f = mul(200, sub(x(2), rest(1))), d = mul(100, sub(x(1), posed(1)));
    scalar l0 = rest_length(rest(1), rest(2));
    quat turn = qmul(conj(q(0)), q(1));
    scalar late = square(mul(100, sub(predicted(2), x(2)))), drift = dot(mul(100, sub(x(0), previous(1))), e);
    scalar ghost = square(mul(50, sub(x(2), frame_vec3("test_ghost", 2))));
    scalar wind = mul(frame_scalar("test_wind", 0), frame_scalar("test_wind", 1));
    scalar straight = dot(rotate(q(1), e), rotate(root_rotation(), sub(root_x(1), root_rest(1))));
    scalar near = mul(attribute("body_distance", 1), square(sub(x(1), root_position())));
    return mul(param("stiffness"), mass(1),
               add(mul(dt(), late), mul(0.1, drift), add(wind, ghost, mul(30, near)),
                   add(mul(param("bend"), square(turn)), straight, divide(square(sub(norm(f), param("bend"))), l0)),
                   dot(d, e)));
}

static scalar input_everything_root(void)
{
    vec3 was = rotate(root_rotation(), sub(root_rest(1), root_rest(0)));
    return mul(param("bend"), square(sub(sub(root_x(1), root_x(0)), was)), add(1, square(q(0))));
}

HG_ENERGY(input_everything, .equation = "k (...)", .source = "test", .site = window(3),
          .params = { { "stiffness", 3, "1", "scale" }, { "bend", 0.7, "1", "scale" } }, .root = input_everything_root);

/* Carried values of all widths, of rest data and of everything else, one made of the other. */
static scalar input_chain(void)
{
    scalar l0 = rest_length(rest(0), rest(1)), l1 = rest_length(rest(1), rest(2));
    scalar from_root = carry("from_root", l0);
    vec3 t0 = tangent(x(0), x(1), l0), t1 = tangent(x(1), x(2), l1);
    quat frame = carry("frame", qmul(transport(tangent(root_x(0), root_x(1), l0), t0), root_rotation()));
    vec3 rest_frame = carry("rest_frame", tangent(rest(0), rest(1), l0));
    vec3 drag = carry("drag", mul(param("stiffness"), t0));
    scalar wound = carry("wound", add(from_root, param("bend")));
    keep("from_root", add(from_root, l1));
    keep("frame", qmul(transport(t0, t1), frame));
    keep("rest_frame", rotate(transport(tangent(rest(0), rest(1), l0), tangent(rest(1), rest(2), l1)), rest_frame));
    keep("drag", add(mul(0.6, drag), cross(t0, mul(attribute("body_distance", 1), t1)), mul(0.2, rotate(frame, drag))));
    keep("wound", add(mul(0.9, wound), mul(dt(), dot(drag, t1))));
    return mul(param("stiffness"),
               add(square(sub(rotate(frame, rest_frame), t1)), dot(drag, add(t0, vector(0.3, -0.2, 0.5))),
                   mul(from_root, wound), square(wound)));
}

HG_ENERGY(input_chain, .equation = "k (...)", .source = "test", .site = window(3),
          .params = { { "stiffness", 3, "1", "scale" }, { "bend", 0.7, "1", "scale" } });

#undef sqrt
#undef abs
#undef exp
#undef min
#undef max
#undef distance

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
    for (int64_t i = 0; i < hg_tensor_count(t); i++) {
        if (dtype == HG_F64)
            ((double *)t->data)[i] = made[i];
        else
            ((float *)t->data)[i] = (float)made[i];
    }
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
    if (backend != HG_BACKEND_AUTO) ok(hg_physics_backend(b.physics, backend), energy);
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

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_gradients),
        cmocka_unit_test(test_carried),
        cmocka_unit_test(test_threads),
        cmocka_unit_test(test_compiled),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
