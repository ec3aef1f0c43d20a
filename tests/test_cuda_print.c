/* Printed CUDA, compiled as C++ over a small shim and run lane by lane in several orders: every window energy and the usual
 * sums, values and gradients against the interpreter; the same bits whatever the order of the lanes. */
#include "energies_walk.h"
#include "test.h"

#include "autograd/trace/strand.h"

#include <dlfcn.h>

enum { KERNELS = 128 };
typedef struct {
    hg_text text;
    hg_dtype dtype;
    int n;
    uint64_t hash[KERNELS];
} printing;

static const hg_energy *not_usual(void) { return hg_energy_find("spring_edge"); }

/* A usual sum with one more energy, so that it is not among the kernels of the library. */
static int sum_terms(int sum, hg_term *terms)
{
    int n = usual_terms(sum, terms);
    terms[n++] = (hg_term){ not_usual(), 0.7, NULL, NULL };
    return n;
}

static void print_sum(printing *p, const hg_term *terms, int n, const char *label)
{
    hg_strand_term traced[USUAL_TERMS + 1];
    double params[USUAL_TERMS + 1][HG_ENERGY_PARAMS];
    const char *options[USUAL_TERMS + 1][HG_ENERGY_OPTIONS];
    int order[USUAL_TERMS + 1];
    for (int t = 0; t < n; t++) { /* by name, as physics has them */
        int at = t;
        for (; at > 0 && strcmp(terms[order[at - 1]].energy->name, terms[t].energy->name) > 0; at--)
            order[at] = order[at - 1];
        order[at] = t;
    }
    for (int t = 0; t < n; t++) {
        const hg_energy *energy = terms[order[t]].energy;
        ok(hg_term_complete(&terms[order[t]], params[t], options[t]), label);
        const hg_term term = { energy, 1, params[t], options[t] };
        traced[t] = (hg_strand_term){ .trace = energy->trace, .root = energy->root };
        hg_term_scope(&traced[t].scope, &term, t, HG_ALLOW_WINDOW);
    }
    hg_strand_program *program;
    ok(hg_strand_program_create(&program, p->dtype, n, traced, 0, NULL, true), label);
    bool known = false;
    for (int i = 0; i < p->n; i++) known |= p->hash[i] == program->hash;
    if (!known) {
        char name[32];
        assert_true(p->n < KERNELS);
        snprintf(name, sizeof name, "kernel_%d", p->n);
        hg_strand_print_cuda(program, name, &p->text);
        hg_text_add(&p->text, "\nRUN(%d, %zu, %zu)\n\n", p->n, hg_strand_cuda_shared(program, 64),
                    hg_strand_cuda_scratch(program, 64));
        p->hash[p->n++] = program->hash;
    }
    hg_strand_program_destroy(program);
}

static bool can_run(const hg_energy *energy)
{
    /* what the scene of the tests brings */
    if (energy->site.kind != HG_SITE_WINDOW) return false;
    hg_formula_names names;
    double params[HG_ENERGY_PARAMS];
    const char *options[HG_ENERGY_OPTIONS];
    ok(hg_term_complete(&(hg_term){ energy, 1, NULL, NULL }, params, options), energy->name);
    hg_trace_scope scope;
    hg_term_scope(&scope, &(hg_term){ energy, 1, params, options }, 0, HG_ALLOW_WINDOW);
    ok(hg_formula_reads(energy->trace, &scope, &names), energy->name);
    const bool can = names.n_frames == 0 && !(names.kinds & HG_ALLOW(HG_INPUT_Q));
    hg_formula_names_free(&names);
    return can;
}

static void print_variant(const variant *v, void *self)
{
    if (can_run(v->term.energy)) print_sum(self, &v->term, 1, v->label);
}

static void agree(const printing *p, const hg_term *terms, int n, int64_t V, int *order, const char *label)
{
    scene s;
    scene_make(&s, 2, 2, 7, V, 0.3);
    result a = evaluate(&s, p->dtype, 1, terms, n, HG_BACKEND_INTERPRETER, false, label, NULL), b[3];
    const double limit = p->dtype == HG_F64 ? 1e-12 : 2e-5;
    for (*order = 0; *order < 3; ++*order) {
        b[*order] = evaluate(&s, p->dtype, 1, terms, n, HG_BACKEND_COMPILED, false, label, NULL);
        const double gradient = difference(a.gradient, b[*order].gradient, s.B * s.S * V * 3),
                     strands = difference(a.per_strand, b[*order].per_strand, s.B * s.S * n);
        if (!(gradient < limit && strands < limit))
            fail_msg("%s, V %d, order %d: gradient off by %.3e, energies by %.3e", label, (int)V, *order, gradient,
                     strands);
        assert_memory_equal(b[0].gradient, b[*order].gradient, (size_t)(s.B * s.S * V * 3) * sizeof(double));
        assert_memory_equal(b[0].energy, b[*order].energy, (size_t)n * sizeof(double));
    }
    result_free(&a);
    for (int i = 0; i < 3; i++) result_free(&b[i]);
    scene_free(&s);
}

typedef struct {
    const printing *printed;
    int *order;
} checking;

static void check_variant(const variant *v, void *self)
{
    const checking *c = self;
    if (!can_run(v->term.energy)) return;
    for (int64_t V = 1; V <= 40; V += V < 5 ? 1 : 35) agree(c->printed, &v->term, 1, V, c->order, v->label);
}

static const char *const run_macro =
    "static int order; extern \"C\" int *const hg_order = &order;\n"
    "#define RUN(n, shared_bytes, scratch_bytes) \\\n"
    "struct call_##n { hg_strand_args args; int64_t first, count; char *scratch; }; \\\n"
    "static void thread_##n(void *given) { call_##n *c = (call_##n *)given; kernel_##n(c->args, c->first, c->count, "
    "c->scratch, shared_bytes ? shared_bytes : scratch_bytes); } \\\n"
    "static void tiles_##n(const hg_strand_args *args, int64_t first, int64_t last, void *) { \\\n"
    "    call_##n c = { *args, first, last - first, (char *)malloc(scratch_bytes * (size_t)(last - first) + 1) }; \\\n"
    "    const int64_t per_block = shared_bytes ? 2 : 64; shim::shared = malloc(2 * shared_bytes + 1); \\\n"
    "    for (int64_t b = 0; b * per_block < c.count; b++) { memset(shim::shared, 0xff, 2 * shared_bytes + 1); \\\n"
    "        shim::block.x = (unsigned)b; shim::run_block(thread_##n, &c, order); } \\\n"
    "    free(shim::shared); free(c.scratch); } \\\n"
    "extern \"C\" hg_strand_kernel *const run_##n = tiles_##n;\n";

static void test_printed_cuda(void **state)
{
    (void)state;
    if (system("c++ --version > /dev/null 2>&1") != 0) skip();
    const char *source = getenv("HG_SOURCE") ? getenv("HG_SOURCE") : ".";
    for (int dtype = 0; dtype < 2; dtype++) {
        static printing both[2]; /* what is registered stays */
        static hg_strand_kernel_entry kernels[2][KERNELS];
        static hg_entry entries[2][KERNELS];
        static char names[2][KERNELS][64];
        printing *p = &both[dtype];
        hg_term terms[USUAL_TERMS + 1];
        char command[2048], label[32];
        p->dtype = dtype ? HG_F64 : HG_F32;
        hg_text_add(
            &p->text,
            "#define HG_BYTES %d\n#include \"tests/cuda_shim.h\"\n#include \"autograd/trace/strand_cuda.h\"\n%s",
            dtype ? 8 : 4, run_macro);
        each_variant(print_variant, p);
        for (int sum = 0; sum < USUAL_SUMS; sum++) print_sum(p, terms, sum_terms(sum, terms), "sum");
        assert_false(p->text.failed);
        char *path = test_path(dtype ? "f64.cc" : "f32.cc"), *library = test_path(dtype ? "f64.so" : "f32.so");
        assert_int_equal(hg_file_write(path, p->text.data, p->text.size), HG_OK);
        snprintf(command, sizeof command, "c++ -std=c++17 -O1 -w -ffp-contract=off -fPIC -shared -I'%s' '%s' -o '%s'",
                 source, path, library);
        if (system(command) != 0) fail_msg("the compiler refuses what was printed: %s", path);
        void *loaded = dlopen(library, RTLD_NOW | RTLD_LOCAL);
        if (!loaded) fail_msg("%s", dlerror());
        for (int i = 0; i < p->n; i++) {
            char symbol[32];
            snprintf(symbol, sizeof symbol, "run_%d", i);
            hg_strand_kernel *const *run = dlsym(loaded, symbol);
            assert_non_null(run);
            kernels[dtype][i] = (hg_strand_kernel_entry){ p->hash[i], 1, dtype ? 8 : 4, "plain", *run };
            snprintf(names[dtype][i], sizeof names[dtype][i], "%s plain %016llx", hg_dtype_name(p->dtype),
                     (unsigned long long)p->hash[i]);
            entries[dtype][i] =
                (hg_entry){ HG_ABI_VERSION, "strand_kernel", names[dtype][i], &kernels[dtype][i], NULL };
            hg_register(&entries[dtype][i]);
        }
        int *const *order = dlsym(loaded, "hg_order");
        assert_non_null(order);
        each_variant(check_variant, &(checking){ p, *order });
        for (int sum = 0; sum < USUAL_SUMS; sum++)
            for (int64_t V = 2; V <= 35; V += 33) {
                snprintf(label, sizeof label, "sum %d", sum);
                agree(p, terms, sum_terms(sum, terms), V, *order, label);
            }
        hg_text_free(&p->text);
        hg_free(path);
        hg_free(library);
    }
}

int main(void)
{
    setenv("HAIRGRAD_COMPILE", "0", 1); /* the kernels here, no others */
    const struct CMUnitTest tests[] = { cmocka_unit_test(test_printed_cuda) };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
