/* Back ends of the strand pass: printed kernels against the interpreter, for the sums printed at build time, on every
 * level of the processor, and for every energy compiled here by the system's cc; the same bits for any threads. */
#include "energies_walk.h"

#include "autograd/trace/strand.h"

#include <dlfcn.h>

#include "energies_own.h"

static void test_compiled(void **state)
{
    (void)state;
    for (int sum = 0; sum < USUAL_SUMS; sum++)
        for (int64_t V = 1; V <= 40; V += V < 6 ? 1 : 17)
            for (int dtype = 0; dtype < 2; dtype++) {
                hg_term terms[8];
                const int n = usual_terms(sum, terms);
                const hg_dtype type = dtype ? HG_F64 : HG_F32;
                char label[64];
                snprintf(label, sizeof label, "sum %d, V %d, %s", sum, (int)V, hg_dtype_name(type));
                scene s;
                scene_make(&s, 2, 3, 37, V, 0.3);
                result a = evaluate(&s, type, 1, terms, n, HG_BACKEND_INTERPRETER, false, label, NULL);
                result b = evaluate(&s, type, 1, terms, n, HG_BACKEND_COMPILED, false, label, NULL);
                /* frames carried along a strand round once more at every edge */
                const double limit = dtype ? 1e-12 : 1e-6 * (double)(10 + V),
                             gradient = difference(a.gradient, b.gradient, s.B * s.S * V * 3);
                if (!(gradient < limit)) fail_msg("%s: the compiled gradient is off by %.3e", label, gradient);
                for (int t = 0; t < n; t++) {
                    const double energy = difference(a.energy + t, b.energy + t, 1);
                    if (!(energy < limit))
                        fail_msg("%s: compiled %s is off by %.3e", label, terms[t].energy->name, energy);
                }
                const double strands = difference(a.per_strand, b.per_strand, s.B * s.S * n);
                if (!(strands < limit)) fail_msg("%s: a strand's compiled energy is off by %.3e", label, strands);
                result_free(&a);
                result_free(&b);
                scene_free(&s);
            }
}

/* Every level of vector instructions that this processor has, not only the one that is chosen. */
static void test_levels(void **state)
{
    (void)state;
    static const char *const levels[] = { "avx512", "avx2", "sse4", "plain" };
    int found = 0;
    for (int64_t V = 1; V <= 25; V += V < 6 ? 1 : 6)
        for (int dtype = 0; dtype < 2; dtype++) {
            const hg_dtype type = dtype ? HG_F64 : HG_F32;
            hg_ctx *ctx = make_context(1);
            scene s;
            scene_make(&s, 2, 2, 21, V, 0.3);
            const char *names[] = { "bend_twist", "gravity", "inertia", "stretch" };
            hg_term terms[4];
            double params[4][HG_ENERGY_PARAMS], energies[4], expected[4];
            const char *options[4][HG_ENERGY_OPTIONS];
            const int32_t column[4] = { 0, 1, 2, 3 };
            for (int t = 0; t < 4; t++) {
                const hg_term term = { hg_energy_find(names[t]), 1, NULL, NULL };
                ok(hg_term_complete(&term, params[t], options[t]), names[t]);
                terms[t] = (hg_term){ term.energy, 1.5, params[t], options[t] };
            }
            const hg_frame frame = scene_frame(&s, ctx, type);
            hg_tensor *x = scene_x(&s, ctx, type), *a = scene_x(&s, ctx, type), *b = scene_x(&s, ctx, type);
            hg_strand_pass *pass;
            ok(hg_strand_pass_create(&pass, ctx, type, 4, terms, column, &s.data, NULL, true), "levels");
            ok(hg_strand_pass_backend(pass, ctx, HG_BACKEND_INTERPRETER, NULL), "levels");
            hg_pass_call call = { &frame, s.groom, x, 0, NULL, a->data, expected, NULL, 4 };
            ok(hg_strand_pass_run(pass, &call, NULL, NULL), "levels");
            call.gradient = b->data;
            call.unweighted = energies;
            for (int level = 0; level < 4; level++) {
                if (hg_strand_pass_backend(pass, ctx, HG_BACKEND_COMPILED, levels[level]) != HG_OK) continue;
                found++;
                ok(hg_strand_pass_run(pass, &call, NULL, NULL), levels[level]);
                double worst = 0, largest = 0;
                for (int64_t i = 0; i < hg_tensor_count(x); i++) {
                    worst = fmax(worst, fabs(value(a, i) - value(b, i)));
                    largest = fmax(largest, fabs(value(a, i)));
                }
                if (!(worst < (dtype ? 1e-12 : 1e-5) * largest))
                    fail_msg("%s: gradient off by %.3e", levels[level], worst / largest);
                if (!(difference(energies, expected, 4) < (dtype ? 1e-12 : 1e-5)))
                    fail_msg("%s: energies differ", levels[level]);
            }
            hg_strand_pass_destroy(pass);
            scene_free(&s);
            hg_ctx_destroy(ctx);
        }
    assert_true(found > 0);
}

/* Kernels printed here and now, for every energy that there is: what a researcher's own energy becomes. */
#if defined(__AVX512F__)
enum { WIDTH = 64 };
#elif defined(__AVX2__)
enum { WIDTH = 32 };
#else
enum { WIDTH = 16 };
#endif

typedef struct {
    hg_text text;
    hg_dtype dtype;
    int n;
    uint64_t hash[MAX_ENERGIES];
    void *library;
} printing;

static void print_variant(const variant *v, void *self)
{
    printing *p = self;
    const hg_energy *energy = v->term.energy;
    if (energy->site.kind != HG_SITE_WINDOW) return;
    double params[HG_ENERGY_PARAMS];
    const char *options[HG_ENERGY_OPTIONS];
    ok(hg_term_complete(&v->term, params, options), v->label);
    const hg_term term = { energy, 1, params, options };
    hg_strand_term traced = { .trace = energy->trace, .root = energy->root };
    hg_term_scope(&traced.scope, &term, 0, HG_ALLOW_WINDOW);
    hg_strand_program *program;
    ok(hg_strand_program_create(&program, p->dtype, 1, &traced, 0, NULL, true), v->label);
    p->hash[p->n] = program->hash;
    for (int i = 0; i < p->n; i++)
        if (p->hash[i] == program->hash) { /* an option that changes the contact query alone */
            hg_strand_program_destroy(program);
            return;
        }
    char name[32];
    snprintf(name, sizeof name, "kernel_%d", p->n);
    hg_strand_print_c(program, name, &p->text);
    hg_text_add(&p->text, "hg_strand_kernel *const run_%d = %s;\n\n", p->n++, name);
    hg_strand_program_destroy(program);
    assert_true(p->n < MAX_ENERGIES);
}

static void check_printed(const variant *v, void *self)
{
    const printing *p = self;
    if (v->term.energy->site.kind != HG_SITE_WINDOW) return;
    for (int64_t V = 1; V <= 24; V += V < 6 ? 1 : 9) {
        scene s;
        scene_make(&s, 2, 2, 19, V, 0.3);
        result a = evaluate(&s, p->dtype, 1, &v->term, 1, HG_BACKEND_INTERPRETER, false, v->label, NULL);
        result b = evaluate(&s, p->dtype, 2, &v->term, 1, HG_BACKEND_COMPILED, false, v->label, NULL);
        const double limit = p->dtype == HG_F64 ? 1e-12 : 2e-5,
                     gradient = difference(a.gradient, b.gradient, s.B * s.S * V * 3);
        if (!(gradient < limit && difference(a.energy, b.energy, 1) < limit))
            fail_msg("%s, V %d: printed %.17g, interpreted %.17g, gradient off by %.3e", v->label, (int)V, b.energy[0],
                     a.energy[0], gradient);
        result_free(&a);
        result_free(&b);
        scene_free(&s);
    }
}

static void test_printed(void **state)
{
    (void)state;
    if (system("${CC:-cc} --version > /dev/null 2>&1") != 0) skip(); /* no compiler here */
    const char *source = getenv("HG_SOURCE") ? getenv("HG_SOURCE") : ".";
    char folder[] = "/tmp/hairgrad-XXXXXX", path[64], command[4096];
    assert_non_null(mkdtemp(folder));
    for (int dtype = 0; dtype < 2; dtype++) {
        static printing both[2]; /* what is registered stays */
        static hg_strand_kernel_entry kernels[2][MAX_ENERGIES];
        static hg_entry entries[2][MAX_ENERGIES];
        static char names[2][MAX_ENERGIES][64];
        printing *p = &both[dtype];
        p->dtype = dtype ? HG_F64 : HG_F32;
        const int bytes = (int)hg_dtype_size(p->dtype);
        hg_text_add(&p->text, "#include \"autograd/trace/strand_vector.h\"\n\n");
        each_variant(print_variant, p);
        snprintf(path, sizeof path, "%s/%d.c", folder, dtype);
        assert_int_equal(hg_file_write(path, p->text.data, p->text.size), HG_OK);
        snprintf(command, sizeof command,
                 "${CC:-cc} -std=gnu11 -O1 -march=native -fno-math-errno -ffp-contract=fast -Wno-psabi -fPIC -shared "
                 "-DHG_BYTES=%d -DHG_LANES=%d -I'%s' %s -o %s/%d.so -lm",
                 bytes, WIDTH / bytes, source, path, folder, dtype);
        if (system(command) != 0) fail_msg("the compiler refuses what was printed: %s", path);
        snprintf(path, sizeof path, "%s/%d.so", folder, dtype);
        p->library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
        if (!p->library) fail_msg("%s", dlerror());
        for (int i = 0; i < p->n; i++) {
            char symbol[32];
            snprintf(symbol, sizeof symbol, "run_%d", i);
            hg_strand_kernel *const *run = dlsym(p->library, symbol);
            assert_non_null(run);
            kernels[dtype][i] = (hg_strand_kernel_entry){ p->hash[i], WIDTH / bytes, bytes, "plain", *run };
            snprintf(names[dtype][i], sizeof names[dtype][i], "%s plain %016llx", hg_dtype_name(p->dtype),
                     (unsigned long long)p->hash[i]);
            entries[dtype][i] =
                (hg_entry){ HG_ABI_VERSION, "strand_kernel", names[dtype][i], &kernels[dtype][i], NULL };
            hg_register(&entries[dtype][i]);
        }
        each_variant(check_printed, p);
        hg_text_free(&p->text);
    }
    snprintf(command, sizeof command, "rm -rf %s", folder);
    assert_int_equal(system(command), 0);
}

static void test_no_kernel(void **state)
{
    (void)state;
    hg_ctx *ctx = make_context(1);
    scene s;
    scene_make(&s, 1, 1, 2, 4, 0.1);
    const hg_term term = { hg_energy_find("drag"), 1, NULL, NULL };
    hg_physics *physics;
    ok(hg_physics_create(&physics, ctx, HG_F32, &term, 1, &s.data), "drag");
    assert_string_equal(hg_physics_backend_name(physics), "interpreter");
    assert_int_equal(hg_physics_backend(physics, HG_BACKEND_COMPILED), HG_UNSUPPORTED);
    assert_non_null(strstr(hg_message(), "drag"));
    hg_physics_destroy(physics);
    scene_free(&s);
    hg_ctx_destroy(ctx);
}

static void test_threads(void **state)
{
    (void)state;
    for (int sum = 0; sum <= WITH_STYLE; sum += WITH_STYLE)
        for (int k = 0; k < 4; k++) {
            hg_term terms[8];
            const int n = usual_terms(sum, terms);
            const hg_dtype type = k & 1 ? HG_F64 : HG_F32;
            const hg_backend backend = k & 2 ? HG_BACKEND_COMPILED : HG_BACKEND_INTERPRETER;
            scene s;
            scene_make(&s, 1, 2, 700, 9, 0.3);
            result a = evaluate(&s, type, 1, terms, n, backend, false, "1 thread", NULL);
            result b = evaluate(&s, type, 2, terms, n, backend, false, "2 threads", NULL);
            result c = evaluate(&s, type, 3, terms, n, backend, false, "3 threads", NULL);
            assert_memory_equal(a.gradient, b.gradient, (size_t)(s.B * s.S * s.V * 3) * sizeof(double));
            assert_memory_equal(a.gradient, c.gradient, (size_t)(s.B * s.S * s.V * 3) * sizeof(double));
            assert_memory_equal(a.energy, b.energy, (size_t)n * sizeof(double));
            assert_memory_equal(a.energy, c.energy, (size_t)n * sizeof(double));
            result_free(&a);
            result_free(&b);
            result_free(&c);
            scene_free(&s);
        }
}

int main(void)
{
    setenv("HAIRGRAD_COMPILE", "0", 1); /* kernels that are there already; test_compile.c has the others */
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_compiled), cmocka_unit_test(test_levels),  cmocka_unit_test(test_no_kernel),
        cmocka_unit_test(test_threads),  cmocka_unit_test(test_printed), /* last: from then on there is a kernel for every energy */
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
