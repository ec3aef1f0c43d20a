/* The tracer: every scalar operation and its derivative against finite differences in f64, f32 against f64, folding and
 * sharing, the semantics of select, min and max, vectors and quaternions against plain arithmetic, and messages. */
#include "autograd/trace/graph.h"
#include "autograd/trace/strand.h"

#include "device.h"
#include "tensor/tensor.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

#include "autograd/trace/names.h"

/* The three variables of the formulas below. */
#define A distance()
#define B rest_distance()
#define C field()

static const hg_input variables[] = { { .kind = HG_INPUT_DISTANCE },
                                      { .kind = HG_INPUT_REST_DISTANCE },
                                      { .kind = HG_INPUT_FIELD } };
static const hg_trace_scope scope = { .name = "test",
                                      .allowed = HG_ALLOW(HG_INPUT_DISTANCE) | HG_ALLOW(HG_INPUT_REST_DISTANCE) |
                                                 HG_ALLOW(HG_INPUT_FIELD),
                                      .window = 1 };

typedef struct {
    double value, d[3];
} outcome;

static hg_function *make(hg_scalar (*formula)(void))
{
    hg_function *f;
    if (hg_function_create(&f, formula, &scope, 3, (int[]){ 0, 1, 2 }, 3, variables) != HG_OK)
        fail_msg("%s", hg_message());
    return f;
}

static outcome run(const hg_function *f, hg_dtype dtype, double a, double b, double c)
{
    outcome o;
    float in32[3] = { (float)a, (float)b, (float)c }, out32[4];
    double in64[3] = { a, b, c }, out64[4];
    const void *in[3];
    void *out[4];
    for (int i = 0; i < 3; i++) in[i] = dtype == HG_F64 ? (void *)&in64[i] : (void *)&in32[i];
    for (int i = 0; i < 4; i++) out[i] = dtype == HG_F64 ? (void *)&out64[i] : (void *)&out32[i];
    hg_function_run(f, dtype, 1, in, NULL, out);
    o.value = dtype == HG_F64 ? out64[0] : (double)out32[0];
    for (int i = 0; i < 3; i++) o.d[i] = dtype == HG_F64 ? out64[1 + i] : (double)out32[1 + i];
    return o;
}

/* ---- scalar operations ------------------------------------------------------------------------------------------ */

static scalar f_add(void) { return add(A, B, C, 0.5, A); }
static scalar f_sub(void) { return sub(sub(A, B), sub(1, C)); }
static scalar f_mul(void) { return mul(A, B, 3, C, A); }
static scalar f_div(void) { return add(divide(A, B), divide(2, C), divide(A, 7)); }
static scalar f_neg(void) { return mul(neg(A), add(B, neg(C))); }
static scalar f_sqrt(void) { return mul(sqrt(A), sqrt(add(B, C))); }
static scalar f_rsqrt(void) { return mul(rsqrt(A), rsqrt(mul(B, C))); }
static scalar f_abs(void) { return add(abs(sub(A, B)), mul(C, abs(neg(C)))); }
static scalar f_exp(void) { return exp(sub(A, mul(B, C))); }
static scalar f_log(void) { return log(add(A, mul(B, C))); }
static scalar f_sin(void) { return sin(mul(A, add(B, C))); }
static scalar f_cos(void) { return cos(mul(A, add(B, C))); }
static scalar f_atan2(void) { return add(atan2(sub(A, B), C), atan2(A, sub(B, C)), atan2(1, A)); }
static scalar f_min(void) { return mul(min(A, B), min(C, 1.1)); }
static scalar f_max(void) { return mul(max(A, B), max(1.1, C)); }
static scalar f_clamp(void) { return mul(clamp(A, 0.5, B), clamp(C, 0.2, 0.9)); }
static scalar f_select(void) { return select(less(A, B), mul(A, C), select(less(C, 1), square(B), A)); }
static scalar f_square(void) { return square(sub(A, mul(B, C))); }
static scalar f_nested(void) { return divide(sqrt(add(square(A), square(B))), add(1, exp(neg(mul(C, A))))); }
static scalar f_shared(void)
{
    scalar s = sqrt(add(A, B));
    return mul(s, s, add(s, C), rsqrt(add(A, B)));
}
static scalar f_length(void) { return divide(C, norm(vector(A, B, 0.5))); }

/* plain arithmetic from here on */
#undef sqrt
#undef abs
#undef exp
#undef log
#undef sin
#undef cos
#undef atan2
#undef min
#undef max
static double r_add(double a, double b, double c) { return a + b + c + 0.5 + a; }
static double r_sub(double a, double b, double c) { return a - b - (1 - c); }
static double r_mul(double a, double b, double c) { return 3 * a * a * b * c; }
static double r_div(double a, double b, double c) { return a / b + 2 / c + a / 7; }
static double r_neg(double a, double b, double c) { return -a * (b - c); }
static double r_sqrt(double a, double b, double c) { return sqrt(a * (b + c)); }
static double r_rsqrt(double a, double b, double c) { return 1 / sqrt(a * b * c); }
static double r_abs(double a, double b, double c) { return fabs(a - b) + c * fabs(c); }
static double r_exp(double a, double b, double c) { return exp(a - b * c); }
static double r_log(double a, double b, double c) { return log(a + b * c); }
static double r_sin(double a, double b, double c) { return sin(a * (b + c)); }
static double r_cos(double a, double b, double c) { return cos(a * (b + c)); }
static double r_atan2(double a, double b, double c) { return atan2(a - b, c) + atan2(a, b - c) + atan2(1, a); }
static double r_min(double a, double b, double c) { return fmin(a, b) * fmin(c, 1.1); }
static double r_max(double a, double b, double c) { return fmax(a, b) * fmax(c, 1.1); }
static double r_clamp(double a, double b, double c) { return fmin(fmax(a, 0.5), b) * fmin(fmax(c, 0.2), 0.9); }
static double r_select(double a, double b, double c) { return a < b ? a * c : c < 1 ? b * b : a; }
static double r_square(double a, double b, double c) { return (a - b * c) * (a - b * c); }
static double r_nested(double a, double b, double c) { return sqrt(a * a + b * b) / (1 + exp(-c * a)); }
static double r_shared(double a, double b, double c) { return sqrt(a + b) * (sqrt(a + b) + c); }
static double r_length(double a, double b, double c) { return c / sqrt(a * a + b * b + 0.25); }

#define ROW(name)                                                                                                      \
    {                                                                                                                  \
#name, f_##name, r_##name                                                                                      \
    }
static const struct {
    const char *name;
    scalar (*formula)(void);
    double (*reference)(double a, double b, double c);
} table[] = { ROW(add), ROW(sub),   ROW(mul),    ROW(div),    ROW(neg),    ROW(sqrt),   ROW(rsqrt),
              ROW(abs), ROW(exp),   ROW(log),    ROW(sin),    ROW(cos),    ROW(atan2),  ROW(min),
              ROW(max), ROW(clamp), ROW(select), ROW(square), ROW(nested), ROW(shared), ROW(length) };

static void test_operations(void **state)
{
    (void)state;
    for (size_t i = 0; i < sizeof table / sizeof *table; i++) {
        hg_function *f = make(table[i].formula);
        for (int sample = 0; sample < 20; sample++) {
            double v[3];
            for (int k = 0; k < 3; k++) v[k] = 0.3 + 1.4 * hg_random_uniform(3, i, (uint64_t)(3 * sample + k));
            const outcome o = run(f, HG_F64, v[0], v[1], v[2]), o32 = run(f, HG_F32, v[0], v[1], v[2]);
            const double expected = table[i].reference(v[0], v[1], v[2]);
            if (fabs(o.value - expected) > 1e-14 * (1 + fabs(expected)))
                fail_msg("%s is %.17g, expected %.17g", table[i].name, o.value, expected);
            if (fabs(o32.value - o.value) > 1e-5 * (1 + fabs(o.value))) fail_msg("%s in f32", table[i].name);
            for (int k = 0; k < 3; k++) {
                double up[3], down[3], numeric[2];
                for (int half = 0; half < 2; half++) {
                    const double h = half ? 0.5e-4 : 1e-4;
                    memcpy(up, v, sizeof up);
                    memcpy(down, v, sizeof down);
                    up[k] += h;
                    down[k] -= h;
                    numeric[half] =
                        (table[i].reference(up[0], up[1], up[2]) - table[i].reference(down[0], down[1], down[2])) /
                        (2 * h);
                }
                const double derivative = (4 * numeric[1] - numeric[0]) / 3;
                if (fabs(derivative - o.d[k]) > 1e-8 * (1 + fabs(derivative)))
                    fail_msg("%s: derivative %d is %.12g, by differences %.12g", table[i].name, k, o.d[k], derivative);
                if (fabs(o32.d[k] - o.d[k]) > 1e-4 * (1 + fabs(o.d[k])))
                    fail_msg("%s: derivative %d in f32", table[i].name, k);
            }
        }
        hg_function_destroy(f);
    }
}

/* The functions printed as CUDA against the interpreter, lane by lane, all in one text. */
typedef struct {
    const void *in;
    void *out;
} lanes_args;

static void test_printed(void **state)
{
    (void)state;
    enum { N = 300, FORMULAS = sizeof table / sizeof *table };
    static hg_kernel kernels[FORMULAS][2];
    static char names[FORMULAS][2][40];
    static double in[3 * N], out[4 * N];
    static float in32[3 * N], out32[4 * N];
    hg_function *functions[FORMULAS];
    hg_ctx *ctx;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .device = test_device() }) != HG_OK) fail_msg("%s", hg_message());
    if (hg_ctx_host(ctx)) { /* there the interpreter is what runs */
        hg_ctx_destroy(ctx);
        return;
    }
    hg_text text = { 0 };
    hg_text_add(&text, "#include \"autograd/trace/scalar_cuda.h\"\n"
                       "typedef struct { const void *in; void *out; } lanes_args;\n");
    for (size_t i = 0; i < FORMULAS; i++) {
        char function[40];
        functions[i] = make(table[i].formula);
        snprintf(function, sizeof function, "formula_%s", table[i].name);
        hg_function_print_cuda(functions[i], function, &text);
        for (int half = 0; half < 2; half++) {
            const char *real = half ? "double" : "float";
            snprintf(names[i][half], sizeof names[i][half], "lanes_%s_%s", table[i].name, real);
            hg_text_add(
                &text,
                "HG_BODY void %s(const lanes_args *p, int64_t first, int64_t last)\n{\n    for (int64_t i = first;"
                " i < last; i++) %s((const %s *)p->in + 3 * i, (%s *)p->out + 4 * i);\n}\n"
                "HG_KERNEL(%s, lanes_args, 0)\n",
                names[i][half], function, real, real, names[i][half]);
        }
    }
    assert_false(text.failed);
    for (int k = 0; k < 3 * N; k++) in32[k] = (float)(in[k] = 0.3 + 1.4 * hg_random_uniform(3, 1, (uint64_t)k));
    hg_tensor *from[2], *to[2];
    for (int half = 0; half < 2; half++) {
        from[half] = hg_tensor_from(ctx, half ? HG_F64 : HG_F32, 2, (int64_t[]){ N, 3 }, half ? (void *)in : in32);
        to[half] = hg_tensor_make(ctx, half ? HG_F64 : HG_F32, 2, (int64_t[]){ N, 4 });
    }
    for (size_t i = 0; i < FORMULAS; i++) {
        for (int half = 0; half < 2; half++) {
            const lanes_args args = { from[half]->data, to[half]->data };
            kernels[i][half] = (hg_kernel){ .name = names[i][half], .cuda = text.data, .args_size = sizeof args };
            if (hg_launch(ctx, &kernels[i][half], N, &args) != HG_OK ||
                hg_tensor_read(to[half], half ? (void *)out : out32) != HG_OK)
                fail_msg("%s: %s", table[i].name, hg_message());
            hg_kernel_release(ctx, &kernels[i][half]);
        }
        for (int k = 0; k < N; k++) {
            const outcome o = run(functions[i], HG_F64, in[3 * k], in[3 * k + 1], in[3 * k + 2]);
            const double expected[4] = { o.value, o.d[0], o.d[1], o.d[2] };
            for (int j = 0; j < 4; j++) {
                if (!(fabs(out[4 * k + j] - expected[j]) <= 1e-13 * (1 + fabs(expected[j]))))
                    fail_msg("%s: output %d is %.17g, expected %.17g", table[i].name, j, out[4 * k + j], expected[j]);
                if (!(fabs((double)out32[4 * k + j] - expected[j]) <= 1e-4 * (1 + fabs(expected[j]))))
                    fail_msg("%s in f32: output %d is %g, expected %g", table[i].name, j, (double)out32[4 * k + j],
                             expected[j]);
            }
        }
        hg_function_destroy(functions[i]);
    }
    hg_text_free(&text);
    hg_ctx_destroy(ctx);
}

/* Every lane is independent of how many there are. */
static void test_lanes(void **state)
{
    (void)state;
    hg_function *f = make(f_nested);
    enum { N = 1000 };
    float a[N], b[N], value[N], d[N], one, done;
    for (int i = 0; i < N; i++) {
        a[i] = (float)hg_random_uniform(1, 1, (uint64_t)i);
        b[i] = (float)hg_random_uniform(1, 2, (uint64_t)i);
    }
    const double uniform[3] = { 0, 0, 0.7 };
    hg_function_run(f, HG_F32, N, (const void *[]){ a, b, NULL }, uniform, (void *[]){ value, d, NULL, NULL });
    for (int i = 0; i < N; i += 37) {
        hg_function_run(f, HG_F32, 1, (const void *[]){ a + i, b + i, NULL }, uniform,
                        (void *[]){ &one, &done, NULL, NULL });
        assert_memory_equal(&one, value + i, sizeof one);
        assert_memory_equal(&done, d + i, sizeof done);
    }
    hg_function_run(f, HG_F32, 0, (const void *[]){ NULL, NULL, NULL }, uniform, (void *[]){ value, d, NULL, NULL });
    hg_function_destroy(f);
}

/* ---- ties and branches ------------------------------------------------------------------------------------------ */

#define sqrt(a)   hg_trace_sqrt(a)
#define min(a, b) hg_trace_min(a, b)
#define max(a, b) hg_trace_max(a, b)
static scalar g_min(void) { return min(A, B); }
static scalar g_max(void) { return max(A, B); }
static scalar g_root(void) { return sqrt(A); }
static scalar g_norm(void) { return norm(vector(A, B, C)); }
static scalar g_normalize(void)
{
    vec3 n = normalize(vector(A, B, C));
    return add(n.x, mul(2, n.y), mul(3, n.z));
}
static scalar g_guarded(void) { return select(less(0, A), divide(B, A), mul(C, C)); }
static scalar g_detach(void) { return mul(detach(A), A); }
static scalar g_abs(void) { return hg_trace_abs(A); }
static scalar g_atan2(void) { return hg_trace_atan2(A, B); }
#undef sqrt
#undef min
#undef max

static void expect(scalar (*formula)(void), double a, double b, double c, double value, double da, double db, double dc)
{
    hg_function *f = make(formula);
    for (int dtype = 0; dtype < 2; dtype++) {
        const outcome o = run(f, dtype ? HG_F64 : HG_F32, a, b, c);
        const double off =
            fmax(fmax(fabs(o.value - value), fabs(o.d[0] - da)), fmax(fabs(o.d[1] - db), fabs(o.d[2] - dc)));
        if (!(off < 2e-6))
            fail_msg("at (%g, %g, %g): %g, derivatives %g %g %g; expected %g, %g %g %g", a, b, c, o.value, o.d[0],
                     o.d[1], o.d[2], value, da, db, dc);
    }
    hg_function_destroy(f);
}

static void test_branches(void **state)
{
    (void)state;
    expect(g_min, 2, 2, 0, 2, 1, 0, 0); /* ties: the first argument */
    expect(g_max, 2, 2, 0, 2, 1, 0, 0);
    expect(g_min, 3, 2, 0, 2, 0, 1, 0);
    expect(g_max, 3, 2, 0, 3, 1, 0, 0);
    expect(g_root, 0, 0, 0, 0, 0, 0, 0);
    expect(g_norm, 0, 0, 0, 0, 0, 0, 0);
    expect(g_norm, 0, 2, 0, 2, 0, 1, 0);
    expect(g_normalize, 0, 0, 0, 0, 0, 0, 0);
    expect(g_normalize, 0, 2, 0, 2, 0.5, 0, 1.5);
    expect(g_guarded, 0, 5, 3, 9, 0, 0, 6); /* b/0 = inf on the other side spoils neither value nor derivative */
    expect(g_guarded, 2, 5, 3, 2.5, -1.25, 0.5, 0);
    expect(g_detach, 3, 0, 0, 9, 3, 0, 0);
    expect(g_abs, 0, 0, 0, 0, 0, 0, 0);
    expect(g_abs, -2, 0, 0, 2, -1, 0, 0);
    expect(g_atan2, 0, 0, 0, 0, 0, 0, 0);
}

/* ---- folding and sharing ------------------------------------------------------------------------------------------ */

static int live(hg_graph *graph, int node)
{
    bool *reached = calloc((size_t)graph->n, sizeof *reached);
    int count = 0;
    assert_non_null(reached);
    reached[node] = true;
    for (int i = node; i >= 0; i--) {
        if (!reached[i]) continue;
        const hg_node *n = &graph->nodes[i];
        count += n->op != HG_NODE_NUMBER && n->op != HG_NODE_INPUT;
        if (n->a >= 0) reached[n->a] = true;
        if (n->b >= 0) reached[n->b] = true;
        if (n->c >= 0) reached[n->c] = true;
    }
    free(reached);
    return count;
}

static int operations(hg_scalar (*formula)(void))
{
    hg_graph graph;
    hg_graph_init(&graph, 0, true);
    int node;
    assert_int_equal(hg_graph_trace(&graph, formula, &scope, &node, NULL), HG_OK);
    const int n = live(&graph, node);
    hg_graph_free(&graph);
    return n;
}

static scalar h_numbers(void) { return mul(add(1, 2), sub(7, 4), hg_trace_sqrt(hg_trace_number(16))); }
static scalar h_identities(void)
{
    return add(mul(1, A), 0, neg(neg(B)), mul(0, C), sub(C, C), select(1 ? less(1, 2) : less(2, 1), A, C));
}
static scalar h_shared(void) { return add(mul(A, B), mul(B, A), mul(A, B)); }
static scalar h_collected(void) { return mul(2, mul(3, mul(A, 5))); }
static scalar h_signs(void) { return sub(mul(neg(A), neg(B)), neg(C)); }
static scalar h_no_number(void) { return mul(2, 3); }

static void test_folding(void **state)
{
    (void)state;
    assert_int_equal(operations(h_numbers), 0);
    assert_int_equal(operations(h_no_number), 0);
    assert_int_equal(operations(h_identities), 2); /* A + B + A */
    assert_int_equal(operations(h_shared), 3);     /* one product, and 2 p + p */
    assert_int_equal(operations(h_collected), 1);
    assert_int_equal(operations(h_signs), 2);
    expect(h_numbers, 0, 0, 0, 36, 0, 0, 0);
    expect(h_identities, 2, 5, 1, 9, 2, 1, 0);
    expect(h_shared, 2, 5, 1, 30, 15, 6, 0);
    expect(h_collected, 2, 0, 0, 60, 30, 0, 0);
    expect(h_signs, 2, 5, 1, 11, 5, 2, 1);
}

/* Rates: what is known once per groom, per strand or per call is not computed at the site. */
static scalar i_rates(void)
{
    scalar l0 = norm(sub(rest(1), rest(0)));
    scalar k = mul(param("a"), param("b"), hg_trace_exp(param("a")));
    return mul(k, divide(1, l0), square(sub(norm(sub(x(1), x(0))), l0)));
}

static void test_rates(void **state)
{
    (void)state;
    const hg_strand_term term = {
        { .name = "rates", .allowed = HG_ALLOW_WINDOW, .window = 2, .n_params = 2, .params = { "a", "b" } },
        i_rates,
        NULL
    };
    hg_strand_program *hoisted, *plain;
    assert_int_equal(hg_strand_program_create(&hoisted, HG_F32, 1, &term, 0, NULL, true), HG_OK);
    assert_int_equal(hg_strand_program_create(&plain, HG_F32, 1, &term, 0, NULL, false), HG_OK);
    assert_int_equal(hoisted->bodies, 2);
    assert_int_equal(hoisted->n_site, 2); /* l0 and 1/l0 */
    assert_true(hoisted->n_uniform <= 3); /* k, and k times the weight in the derivative */
    assert_int_equal(hoisted->n_adjoint, 0);
    assert_int_equal(hoisted->preamble.n, 0);
    assert_true(hoisted->body[1].n < plain->body[1].n);
    assert_true(hoisted->hash != plain->hash);
    for (int i = 0; i < hoisted->body[1].n; i++) assert_int_not_equal(hoisted->body[1].instructions[i].op, HG_NODE_EXP);
    hg_strand_program_destroy(hoisted);
    hg_strand_program_destroy(plain);
}

/* What is carried of rest data alone is made once per groom; what is given is not hoisted. */
static scalar i_carried(void)
{
    scalar along = carry("along", hg_trace_number(0)), late = carry("late", mul(param("a"), along));
    keep("along", add(along, norm(sub(rest(1), rest(0)))));
    keep("late", add(late, dot(x(0), x(1))));
    return mul(param("b"), square(sub(late, along)));
}

static void test_carried(void **state)
{
    (void)state;
    const hg_strand_term term = {
        { .name = "carried", .allowed = HG_ALLOW_WINDOW, .window = 2, .n_params = 2, .params = { "a", "b" } },
        i_carried,
        NULL
    };
    const hg_given given[] = { { .kind = HG_INPUT_REST, .gradient = true }, { .kind = HG_INPUT_PARAM, .param = 1 } };
    hg_strand_program *p[3];
    for (int n = 0; n < 3; n++)
        assert_int_equal(hg_strand_program_create(&p[n], HG_F64, 1, &term, n, given, true), HG_OK);
    assert_int_equal(p[0]->n_carry, 1); /* late */
    assert_int_equal(p[0]->n_rest_carry, 1);
    assert_int_equal(p[0]->n_site, 1); /* along */
    assert_int_equal(p[0]->bodies, 3); /* the first site has one of its own */
    assert_int_equal(p[0]->n_arrays, 1);
    assert_int_equal(p[0]->forward[0].n, 0);
    assert_true(p[0]->forward[2].n < p[0]->body[2].n);
    assert_int_equal(p[1]->n_carry, 2);
    assert_int_equal(p[1]->n_rest_carry, 0);
    assert_int_equal(p[1]->n_site, 0);
    assert_int_equal(p[1]->n_arrays, 2);
    assert_true(p[1]->arrays[1].kind == HG_INPUT_REST && p[1]->arrays[1].rest && p[1]->arrays[1].gradient);
    assert_int_equal(p[1]->n_inputs, 2); /* the root's rotation and position */
    assert_int_equal(p[2]->n_inputs, 3);
    assert_false(p[2]->inputs[2].gradient);
    for (int n = 0; n < 3; n++) assert_true(p[n]->hash != p[(n + 1) % 3]->hash);
    for (int n = 0; n < 3; n++) hg_strand_program_destroy(p[n]);
}

/* ---- vectors and quaternions ------------------------------------------------------------------------------------ */

static hg_quat some_quaternion(void) { return quaternion(0.8, vector(A, B, mul(0.5, C))); }
static hg_vec3 some_vector(void) { return vector(B, mul(2, A), sub(C, 1)); }
static scalar v_rotate(void) { return dot(rotate(some_quaternion(), some_vector()), vector(1, 2, 3)); }
static scalar v_sandwich(void) /* the same by two products */
{
    quat p = qmul(qmul(some_quaternion(), quaternion(0, some_vector())), conj(some_quaternion()));
    return dot(p.v, vector(1, 2, 3));
}
static scalar v_slow(void)
{
    return dot(rotate(quaternion(0.8, vector(0.1, -0.3, 0.4)), some_vector()), vector(1, 2, 3));
}
static scalar v_slow_sandwich(void)
{
    quat q = quaternion(0.8, vector(0.1, -0.3, 0.4));
    return dot(qmul(qmul(q, quaternion(0, some_vector())), conj(q)).v, vector(1, 2, 3));
}
static scalar v_carried(void) /* transport(a, b) turns a into b */
{
    vec3 a = normalize(some_vector()), b = normalize(vector(C, A, B));
    return norm(sub(rotate(transport(a, b), a), b));
}
static scalar v_unit(void)
{
    quat q = normalize(some_quaternion());
    return add(square(q), dot(q, q), norm(q), norm(mul(3, q)), norm(add(q, neg(q))), square(sub(mul(q, 2), q)));
}
static scalar v_cross(void)
{
    vec3 a = some_vector(), b = vector(A, C, 0.3), c = cross(a, b);
    return add(dot(c, a), dot(c, b), square(divide(mul(c, 2), 2)), neg(square(c)));
}

static void test_vectors(void **state)
{
    (void)state;
    hg_function *f[] = { make(v_rotate),  make(v_sandwich), make(v_slow), make(v_slow_sandwich),
                         make(v_carried), make(v_unit),     make(v_cross) };
    for (int sample = 0; sample < 20; sample++) {
        double v[3];
        for (int k = 0; k < 3; k++) v[k] = 0.3 + 1.4 * hg_random_uniform(4, 0, (uint64_t)(3 * sample + k));
        outcome o[7];
        for (int i = 0; i < 7; i++) o[i] = run(f[i], HG_F64, v[0], v[1], v[2]);
        assert_true(fabs(o[0].value - o[1].value) < 1e-12 && fabs(o[2].value - o[3].value) < 1e-12);
        for (int k = 0; k < 3; k++) {
            assert_true(fabs(o[0].d[k] - o[1].d[k]) < 1e-11);
            assert_true(fabs(o[2].d[k] - o[3].d[k]) < 1e-11);
        }
        assert_true(o[4].value < 1e-14);
        assert_true(fabs(o[5].value - 7) < 1e-13);
        assert_true(fabs(o[6].value) < 1e-12);
    }
    for (int i = 0; i < 7; i++) hg_function_destroy(f[i]);
}

/* ---- names and messages ------------------------------------------------------------------------------------------ */

static scalar m_param(void) { return param("stifness"); }
static scalar m_option(void) { return option("mood", "good") ? A : B; }
static scalar m_window(void) { return x(2).x; }
static scalar m_not_here(void) { return mass(0); }
static scalar m_root(void) { return root_x(2).y; }

static void refused(scalar (*formula)(void), const char *word)
{
    const hg_trace_scope small = { .name = "broken",
                                   .allowed = HG_ALLOW_WINDOW & ~HG_ALLOW(HG_INPUT_MASS),
                                   .window = 2,
                                   .n_params = 1,
                                   .params = { "stiffness" } };
    uint32_t kinds;
    int n;
    char *names[8];
    assert_int_equal(hg_formula_inputs(formula, &small, &kinds, &n, names), HG_INVALID);
    if (!strstr(hg_message(), word) || !strstr(hg_message(), "broken")) fail_msg("message: %s", hg_message());
}

static void test_messages(void **state)
{
    (void)state;
    refused(m_param, "stiffness"); /* the nearest right name */
    refused(m_option, "mood");
    refused(m_window, "x(2)");
    refused(m_not_here, "mass");
    refused(m_root, "root_x(2)");
    refused(f_add, "distance");
    hg_function *f; /* an input that is not brought */
    assert_int_equal(hg_function_create(&f, f_add, &scope, 0, NULL, 2, variables), HG_INVALID);
    assert_null(f);
    assert_non_null(strstr(hg_message(), "field"));
    assert_int_equal(hg_trace_add2(hg_trace_number(1), hg_trace_number(2)).id, -1); /* outside of any formula */
}

static scalar k_attributes(void)
{
    return mul(attribute("density", 0), attribute("other", 0), attribute("density", 0), mass(0));
}

static void test_attributes(void **state)
{
    (void)state;
    const hg_trace_scope pairs = { .name = "pair", .allowed = HG_ALLOW_PAIRS, .window = 1 };
    uint32_t kinds;
    int n;
    char *names[8];
    assert_int_equal(hg_formula_inputs(k_attributes, &pairs, &kinds, &n, names), HG_OK);
    assert_int_equal(n, 2);
    assert_string_equal(names[0], "density");
    assert_string_equal(names[1], "other");
    assert_int_equal(kinds, HG_ALLOW(HG_INPUT_ATTRIBUTE) | HG_ALLOW(HG_INPUT_MASS));
    for (int i = 0; i < n; i++) hg_free(names[i]);
    const hg_input inputs[] = { { HG_INPUT_ATTRIBUTE, .name = 0 },
                                { HG_INPUT_ATTRIBUTE, .name = 1 },
                                { .kind = HG_INPUT_MASS } };
    hg_function *f;
    const char *order[] = { "other", "density" };
    assert_int_equal(hg_function_create_named(&f, k_attributes, &pairs, 1, (int[]){ 1 }, 3, inputs, 2, order), HG_OK);
    double in[3] = { 2, 3, 5 }, value, derivative;
    hg_function_run(f, HG_F64, 1, (const void *[]){ &in[0], &in[1], &in[2] }, NULL, (void *[]){ &value, &derivative });
    assert_true(value == 2 * 9 * 5 && derivative == 2 * 2 * 3 * 5);
    hg_function_destroy(f);
    assert_int_equal(hg_function_create_named(&f, k_attributes, &pairs, 0, NULL, 3, inputs, 1, order), HG_INVALID);
    assert_non_null(strstr(hg_message(), "density"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_operations), cmocka_unit_test(test_printed), cmocka_unit_test(test_lanes),
        cmocka_unit_test(test_branches),   cmocka_unit_test(test_folding), cmocka_unit_test(test_rates),
        cmocka_unit_test(test_carried),    cmocka_unit_test(test_vectors), cmocka_unit_test(test_messages),
        cmocka_unit_test(test_attributes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
