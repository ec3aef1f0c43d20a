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

/* ---- what a call gives, and gradients of everything --------------------------------------------------------- */

enum { GIVEN_STRANDS = 9, GIVEN_FRAMES = 2, GIVEN_MOST = 40 };
static const char *const given_names[] = { "bend_twist", "gravity", "inertia", "stretch" };
enum { GIVEN_TERMS = sizeof given_names / sizeof *given_names };

/* Nothing of it is left to hoist, so that both kernels read the same arrays. */
static hg_strand_program *given_program(hg_dtype dtype)
{
    static const char *clamped[HG_ENERGY_OPTIONS] = { "smooth", "clamped" };
    const hg_given given[] = {
        { .kind = HG_INPUT_REST, .gradient = true },
        { .kind = HG_INPUT_MASS, .gradient = true },
        { .kind = HG_INPUT_PREDICTED, .gradient = true },
        { .kind = HG_INPUT_ROOT_ROTATION, .gradient = true },
        { .kind = HG_INPUT_PARAM, .term = 0, .param = 0, .gradient = true },
        { .kind = HG_INPUT_PARAM, .term = 3, .param = 0, .gradient = true },
        { .kind = HG_INPUT_DT, .gradient = true },
    };
    hg_strand_term traced[GIVEN_TERMS];
    double params[GIVEN_TERMS][HG_ENERGY_PARAMS];
    static const char *options[GIVEN_TERMS][HG_ENERGY_OPTIONS];
    for (int t = 0; t < GIVEN_TERMS; t++) {
        const hg_energy *energy = hg_energy_find(given_names[t]);
        assert_non_null(energy);
        ok(hg_term_complete(&(hg_term){ energy, 1, NULL, t ? NULL : clamped }, params[t], options[t]), given_names[t]);
        const hg_term term = { energy, 1, params[t], options[t] };
        traced[t] = (hg_strand_term){ .trace = energy->trace, .root = energy->root };
        hg_term_scope(&traced[t].scope, &term, t, HG_ALLOW_WINDOW);
    }
    hg_strand_program *program;
    ok(hg_strand_program_create(&program, dtype, GIVEN_TERMS, traced, (int)(sizeof given / sizeof *given), given, true),
       "given");
    assert_int_equal(program->n_site + program->n_groom_strand + program->n_carry, 0);
    return program;
}

static void put(void *to, hg_dtype dtype, int64_t i, double value)
{
    if (dtype == HG_F64)
        ((double *)to)[i] = value;
    else
        ((float *)to)[i] = (float)value;
}

static double get(const void *from, hg_dtype dtype, int64_t i)
{
    return dtype == HG_F64 ? ((const double *)from)[i] : (double)((const float *)from)[i];
}

/* All gradients and energies of one run; n of them. */
static int64_t run_given(const hg_strand_program *program, hg_strand_kernel *kernel, int64_t V, double *out)
{
    const int64_t S = GIVEN_STRANDS, B = GIVEN_FRAMES;
    const hg_dtype dtype = program->dtype;
    const int lanes = kernel ? 1 : hg_strand_lanes(dtype);
    const size_t bytes = hg_dtype_size(dtype);
    const int32_t column[GIVEN_TERMS] = { 0, 1, 2, 3 };
    void *memory[GIVEN_MOST];
    int n_memory = 0;
    int64_t n = 0;
    hg_strand_args args = {
        .strands = S, .vertices = V, .tiles = (S + lanes - 1) / lanes, .stride = GIVEN_TERMS, .column = column
    };
    for (int k = 0; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        const int64_t count = (array->rest ? 1 : B) * S * (V - array->missing) * array->width;
        void *values = memory[n_memory++] = hg_alloc((size_t)count + 1, bytes);
        for (int64_t i = 0; i < count; i++) { /* a wavy strand that grows in y, in millimetres; positive masses */
            const int64_t v = i / array->width % V;
            put(values, dtype, i,
                array->width == 1 ? 1e-7 * (1.5 + noise(40, i))
                                  : 4e-3 * ((i % 3 == 1 ? (double)v : 0) + 0.4 * noise(41 + (uint64_t)k, i)));
        }
        args.array[k] = values;
        if (array->gradient)
            args.array_gradient[k] = memory[n_memory++] =
                hg_alloc((size_t)(B * S * (V - array->missing) * array->width) + 1, bytes);
    }
    for (int j = 0; j < program->n_inputs; j++) {
        const hg_strand_input *input = &program->inputs[j];
        const int64_t count = B * S * input->width;
        void *values = memory[n_memory++] = hg_alloc((size_t)count + 1, bytes);
        for (int64_t i = 0; i < count; i++) {
            const double wave = noise(60 + (uint64_t)j, i);
            put(values, dtype, i,
                input->kind == HG_INPUT_ROOT_ROTATION ? (i % 4 == 0 ? 0.99 : 0.08 * wave)
                : input->kind == HG_INPUT_DT          ? 0.03
                                                      : 1e-3 * (2 + wave));
        }
        args.strand_input[j] = values;
        if (input->gradient) args.strand_input_gradient[j] = memory[n_memory++] = hg_alloc((size_t)count + 1, bytes);
    }
    int n_in = 0;
    double uniforms[64], ins[64];
    void *outs[64], *uniform = memory[n_memory++] = hg_alloc((size_t)program->n_uniform + 1, bytes);
    if (program->uniform) hg_function_inputs(program->uniform, &n_in);
    assert_true(n_in <= 64 && program->n_uniform <= 64 && n_memory < GIVEN_MOST - 2);
    for (int i = 0; i < n_in; i++) ins[i] = 0.5 + 0.125 * i;
    for (int i = 0; i < program->n_uniform; i++) outs[i] = &uniforms[i];
    if (program->uniform) hg_function_run(program->uniform, HG_F64, 1, NULL, ins, outs);
    for (int i = 0; i < program->n_uniform; i++) put(uniform, dtype, i, uniforms[i]);
    args.uniform = uniform;
    args.energy = memory[n_memory++] = hg_alloc((size_t)(B * args.tiles * GIVEN_TERMS) + 1, sizeof(double));
    args.per_strand = memory[n_memory++] = hg_alloc((size_t)(B * S * GIVEN_TERMS) + 1, sizeof(double));
    void *scratch = hg_alloc(hg_strand_scratch(program, lanes, V), 1);
    if (kernel)
        kernel(&args, 0, B * args.tiles, scratch);
    else
        hg_strand_interpret(program, &args, 0, B * args.tiles, scratch);
    for (int k = 0; k < program->n_arrays; k++)
        for (int64_t i = 0;
             args.array_gradient[k] && i < B * S * (V - program->arrays[k].missing) * program->arrays[k].width; i++)
            out[n++] = get(args.array_gradient[k], dtype, i);
    for (int j = 0; j < program->n_inputs; j++)
        for (int64_t i = 0; args.strand_input_gradient[j] && i < B * S * program->inputs[j].width; i++)
            out[n++] = get(args.strand_input_gradient[j], dtype, i);
    for (int64_t i = 0; i < B * S * GIVEN_TERMS; i++) out[n++] = args.per_strand[i];
    hg_free(scratch);
    for (int i = 0; i < n_memory; i++) hg_free(memory[i]);
    return n;
}

static void check_given(const hg_strand_program *program, hg_strand_kernel *kernel, int *order)
{
    enum { MOST = 40000 };
    double *expected = numbers(MOST), *got = numbers(MOST), *first = numbers(MOST);
    for (int64_t V = 2; V <= 37; V += V < 5 ? 1 : 32)
        for (*order = 0; *order < 3; ++*order) {
            const int64_t n = run_given(program, NULL, V, expected);
            assert_true(n < MOST && run_given(program, kernel, V, got) == n);
            if (*order == 0) memcpy(first, got, (size_t)n * sizeof *got);
            assert_memory_equal(first, got, (size_t)n * sizeof *got);
            int64_t something = 0;
            for (int64_t i = 0; i < n; i++) something += expected[i] != 0;
            assert_true(n > 300 && something > n / 2);
            for (int64_t i = 0; i < n; i++) { /* each on its own scale: the neighbours of the same kind */
                double scale = 0;
                for (int64_t k = i > 20 ? i - 20 : 0; k < n && k < i + 20; k++) scale = fmax(scale, fabs(expected[k]));
                const double limit = (program->dtype == HG_F64 ? 1e-9 : 2e-3) * scale + 1e-300;
                if (!(fabs(got[i] - expected[i]) <= limit))
                    fail_msg("given, V %d, number %d of %d: %.9g, interpreted %.9g", (int)V, (int)i, (int)n, got[i],
                             expected[i]);
            }
        }
    hg_free(expected);
    hg_free(got);
    hg_free(first);
}

/* ---- kernels, printed and loaded ---------------------------------------------------------------------------- */

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
        hg_strand_program *given = given_program(p->dtype);
        hg_strand_print_cuda(given, "kernel_given", &p->text);
        hg_text_add(&p->text, "\nRUN(given, %zu, %zu)\n", hg_strand_cuda_shared(given, 64),
                    hg_strand_cuda_scratch(given, 64));
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
        hg_strand_kernel *const *run_of_given = dlsym(loaded, "run_given");
        assert_non_null(run_of_given);
        check_given(given, *run_of_given, *order);
        hg_strand_program_destroy(given);
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
