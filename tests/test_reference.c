/* Every energy, with every choice of its options, against values and gradients that PyTorch made from the equations
 * (tests/reference/energies.py). An energy that registers itself or stands in hairloss/ without a reference fails. */
#include "hairloss/hairloss.h"

#include "tests/test.h"

enum { MOST = 32 };
#define TOLERANCE 1e-9

typedef struct {
    hg_h5 *file;
    int64_t G, B, S, V, N;
    double *rest, *mass, *body_distance, *scalp_distance, *root_rotation, *root_position, *x, *x_degenerate, *predicted,
        *previous, *ghost, *deformation, *q, *body_rest, *body_vertices;
    int32_t *groom, *faces;
    hg_body_tree *tree;
    hg_groom_attribute attributes[2];
    hg_groom_data data;
} reference;

static void ok(hg_status status, const char *what)
{
    if (status != HG_OK) fail_msg("%s: %s", what, hg_message());
}

static char *source_path(const char *name)
{
    const char *source = getenv("HG_SOURCE");
    return hg_path_join(source ? source : ".", name);
}

static void read_numbers(reference *r, const char *name, int rank, const int64_t *shape, int64_t *found, double **to)
{
    ok(hg_h5_read(r->file, name, HG_F64, rank, shape, found, (void **)to), name);
}

static void open_reference(reference *r)
{
    *r = (reference){ 0 };
    char *path = source_path("tests/reference/energies.h5");
    ok(hg_h5_open(&r->file, path), "open");
    hg_free(path);
    int64_t any[4] = { -1, -1, -1, 3 }, found[4], pairs[2] = { -1, 3 };
    read_numbers(r, "scene/rest", 4, any, found, &r->rest);
    r->G = found[0];
    r->S = found[1];
    r->V = found[2];
    any[1] = r->S;
    any[2] = r->V;
    read_numbers(r, "scene/x", 4, any, found, &r->x);
    r->B = found[0];
    int64_t groom[3] = { r->G, r->S, r->V }, vertices[4] = { r->B, r->S, r->V, 3 }, roots[3] = { r->B, r->S, 4 };
    read_numbers(r, "scene/x_degenerate", 4, vertices, NULL, &r->x_degenerate);
    read_numbers(r, "scene/predicted", 4, vertices, NULL, &r->predicted);
    read_numbers(r, "scene/previous", 4, vertices, NULL, &r->previous);
    read_numbers(r, "scene/ghost", 4, vertices, NULL, &r->ghost);
    read_numbers(r, "scene/deformation", 4, vertices, NULL, &r->deformation);
    read_numbers(r, "scene/q", 4, (int64_t[]){ r->B, r->S, r->V - 1, 4 }, NULL, &r->q);
    read_numbers(r, "scene/mass", 3, groom, NULL, &r->mass);
    read_numbers(r, "scene/body_distance", 3, groom, NULL, &r->body_distance);
    read_numbers(r, "scene/scalp_distance", 3, groom, NULL, &r->scalp_distance);
    read_numbers(r, "scene/root_rotation", 3, roots, NULL, &r->root_rotation);
    roots[2] = 3;
    read_numbers(r, "scene/root_position", 3, roots, NULL, &r->root_position);
    read_numbers(r, "scene/body_rest", 2, pairs, found, &r->body_rest);
    r->N = found[0];
    int64_t body[3] = { r->B, r->N, 3 };
    read_numbers(r, "scene/body_vertices", 3, body, NULL, &r->body_vertices);
    ok(hg_h5_read(r->file, "scene/faces", HG_I32, 2, pairs, found, (void **)&r->faces), "faces");
    ok(hg_body_tree_create(&r->tree, r->N, r->body_rest, found[0], r->faces), "body");
    ok(hg_h5_read(r->file, "scene/groom", HG_I32, 1, &r->B, NULL, (void **)&r->groom), "groom");
    r->attributes[0] = (hg_groom_attribute){ "body_distance", r->body_distance };
    r->attributes[1] = (hg_groom_attribute){ "scalp_distance", r->scalp_distance };
    r->data = (hg_groom_data){ .grooms = r->G,
                               .strands = r->S,
                               .vertices = r->V,
                               .rest = r->rest,
                               .mass = r->mass,
                               .attributes = r->attributes,
                               .n_attributes = 2,
                               .body = r->tree };
}

static void close_reference(reference *r)
{
    hg_h5_close(r->file);
    hg_body_tree_destroy(r->tree);
    void *all[] = { r->rest,
                    r->mass,
                    r->body_distance,
                    r->scalp_distance,
                    r->root_rotation,
                    r->root_position,
                    r->x,
                    r->x_degenerate,
                    r->predicted,
                    r->previous,
                    r->body_rest,
                    r->body_vertices,
                    r->groom,
                    r->faces,
                    r->ghost,
                    r->deformation,
                    r->q };
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) hg_free(all[i]);
}

/* ---- one energy with one choice of options ---- */

typedef struct {
    char label[256];
    double params[HG_ENERGY_PARAMS];
    hg_energy_choice choice;
    hg_term term;
} variant;

/* The choice number `number` of all combinations of options; false when there are no more. */
static bool make_variant(const hg_energy *energy, int number, variant *v)
{
    *v = (variant){ .term = { .energy = energy, .weight = 1.0, .params = v->params, .options = v->choice.options } };
    const bool there = hg_energy_choose(energy, number, &v->choice);
    int length = snprintf(v->label, sizeof v->label, "%s", energy->name);
    for (int o = 0; o < HG_ENERGY_OPTIONS && energy->options[o].name; o++)
        length += snprintf(v->label + length, sizeof v->label - (size_t)length, ",%s=%s", energy->options[o].name,
                           v->choice.options[o]);
    for (int p = 0; p < HG_ENERGY_PARAMS && energy->params[p].name; p++) v->params[p] = energy->params[p].value;
    return there;
}

static hg_tensor *tensor(hg_ctx *ctx, hg_dtype dtype, int rank, const int64_t *shape, const double *from)
{
    hg_tensor *t = hg_tensor_make(ctx, dtype, rank, shape);
    assert_non_null(t);
    for (int64_t i = 0; i < hg_tensor_count(t); i++) {
        if (dtype == HG_F32)
            ((float *)t->data)[i] = (float)from[i];
        else
            ((double *)t->data)[i] = from[i];
    }
    return t;
}

typedef struct {
    double *unweighted, *per_strand, *gradient; /* [n], [B,S,n], [B,S,V,3] */
} outcome;

enum { MOST_INPUTS = 24 };

/* The arrays that the energies ask for by name, or everything that they ask for: as tensors of the frame. */
static void bring(const reference *r, hg_ctx *ctx, hg_dtype dtype, int n, const hg_term *terms, bool everything,
                  hg_frame *frame, hg_frame_input *list)
{
    const double dt = 1.0 / 30.0;
    const struct {
        const char *name;
        int rank;
        int64_t shape[4];
        const double *values;
        bool array;
    } all[] = { { "ghost", 4, { r->B, r->S, r->V, 3 }, r->ghost, true },
                { "deformation", 4, { r->B, r->S, r->V, 3 }, r->deformation, true },
                { "q", 4, { r->B, r->S, r->V - 1, 4 }, r->q, true },
                { "rest", 4, { r->G, r->S, r->V, 3 }, r->rest, false },
                { "mass", 3, { r->G, r->S, r->V }, r->mass, false },
                { "body_distance", 3, { r->G, r->S, r->V }, r->body_distance, false },
                { "scalp_distance", 3, { r->G, r->S, r->V }, r->scalp_distance, false },
                { "dt", 0, { 0 }, &dt, false } };
    frame->inputs = list;
    for (int t = 0; t < n; t++) {
        hg_energy_inputs asks;
        ok(hg_energy_asks(terms[t].energy, terms[t].options, false, &asks), terms[t].energy->name);
        for (int i = 0; i < asks.n; i++)
            for (size_t k = 0; k < sizeof all / sizeof *all; k++) {
                if (strcmp(all[k].name, asks.input[i].name) != 0 || !(all[k].array || everything)) continue;
                bool there = false;
                for (int j = 0; j < frame->n_inputs; j++) there |= strcmp(list[j].name, all[k].name) == 0;
                if (there) continue;
                assert_true(frame->n_inputs < MOST_INPUTS);
                list[frame->n_inputs++] =
                    (hg_frame_input){ all[k].name, tensor(ctx, dtype, all[k].rank, all[k].shape, all[k].values) };
            }
    }
}

static outcome evaluate(const reference *r, hg_dtype dtype, int threads, hg_backend backend, int n,
                        const hg_term *terms, const double *positions, const char *label)
{
    hg_ctx *ctx;
    hg_physics *physics;
    ok(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = threads, .seed = 1 }), label);
    ok(hg_physics_create(&physics, ctx, dtype, terms, n, &r->data), label);
    ok(hg_physics_backend(physics, backend), label);
    int64_t vertices[4] = { r->B, r->S, r->V, 3 }, body[3] = { r->B, r->N, 3 };
    int64_t rotation[3] = { r->B, r->S, 4 }, position[3] = { r->B, r->S, 3 };
    hg_frame frame = { .groom = r->groom, .dt = 1.0 / 30.0 };
    frame.root_rotation = tensor(ctx, dtype, 3, rotation, r->root_rotation);
    frame.root_position = tensor(ctx, dtype, 3, position, r->root_position);
    frame.predicted = tensor(ctx, dtype, 4, vertices, r->predicted);
    frame.previous = tensor(ctx, dtype, 4, vertices, r->previous);
    frame.body_vertices = tensor(ctx, dtype, 3, body, r->body_vertices);
    hg_frame_input list[MOST_INPUTS];
    bring(r, ctx, dtype, n, terms, false, &frame, list);
    hg_tensor *x = tensor(ctx, dtype, 4, vertices, positions), *gradient = hg_tensor_make(ctx, dtype, 4, vertices);
    int64_t count = hg_tensor_count(x);
    outcome out = { calloc((size_t)n, 8), calloc((size_t)(r->B * r->S * n), 8), calloc((size_t)count, 8) };
    assert_non_null(out.unweighted);
    assert_non_null(out.per_strand);
    assert_non_null(out.gradient);
    for (int repeat = 0; repeat < 2; repeat++) /* the second time with guesses and memory from the first */
        ok(hg_physics_evaluate(physics, ctx, &frame, x, out.unweighted, out.per_strand, gradient), label);
    for (int64_t i = 0; i < count; i++) out.gradient[i] = hg_tensor_item(gradient, i);
    hg_physics_destroy(physics);
    hg_ctx_destroy(ctx);
    return out;
}

static void outcome_free(outcome *out)
{
    free(out->unweighted);
    free(out->per_strand);
    free(out->gradient);
}

static void compare(const char *label, const char *what, int64_t n, const double *got, const double *want,
                    double tolerance)
{
    double scale = 0.0;
    for (int64_t i = 0; i < n; i++) scale = fmax(scale, fabs(want[i]));
    for (int64_t i = 0; i < n; i++)
        if (!(fabs(got[i] - want[i]) <= tolerance * scale))
            fail_msg("%s: %s at %lld is %.17g, expected %.17g (off by %.2g of the largest)", label, what, (long long)i,
                     got[i], want[i], fabs(got[i] - want[i]) / scale);
}

/* Reads the case `label` and the parameters that it was made with. */
static outcome read_case(const reference *r, const char *label, const hg_energy *energy, double *params)
{
    char name[300];
    outcome want = { 0 };
    int64_t strands[2] = { r->B, r->S }, vertices[4] = { r->B, r->S, r->V, 3 };
    if (!hg_h5_has(r->file, label))
        fail_msg("%s has no reference: add it to tests/reference/energies.py and run that", label);
    for (int p = 0; p < HG_ENERGY_PARAMS && energy->params[p].name; p++) {
        double number;
        if (hg_h5_get_number(r->file, label, energy->params[p].name, &number) == HG_OK) params[p] = number;
    }
    snprintf(name, sizeof name, "%s/value", label);
    ok(hg_h5_read(r->file, name, HG_F64, 0, NULL, NULL, (void **)&want.unweighted), name);
    snprintf(name, sizeof name, "%s/per_strand", label);
    ok(hg_h5_read(r->file, name, HG_F64, 2, strands, NULL, (void **)&want.per_strand), name);
    snprintf(name, sizeof name, "%s/gradient", label);
    ok(hg_h5_read(r->file, name, HG_F64, 4, vertices, NULL, (void **)&want.gradient), name);
    return want;
}

static void case_free(outcome *want)
{
    hg_free(want->unweighted);
    hg_free(want->per_strand);
    hg_free(want->gradient);
}

static void check_case(const reference *r, variant *v, const char *label, const double *positions)
{
    outcome want = read_case(r, label, v->term.energy, v->params);
    v->term.params = v->params;
    v->term.options = v->choice.options;
    int64_t strands = r->B * r->S, count = strands * r->V * 3;
    for (int backend = HG_BACKEND_AUTO; backend <= HG_BACKEND_INTERPRETER; backend++) {
        outcome got = evaluate(r, HG_F64, 1, (hg_backend)backend, 1, &v->term, positions, label);
        compare(label, "value", 1, got.unweighted, want.unweighted, TOLERANCE);
        compare(label, "strand", strands, got.per_strand, want.per_strand, TOLERANCE);
        compare(label, "gradient", count, got.gradient, want.gradient, TOLERANCE);
        outcome two = evaluate(r, HG_F64, 2, (hg_backend)backend, 1, &v->term, positions, label);
        assert_memory_equal(got.gradient, two.gradient, (size_t)count * sizeof(double));
        assert_memory_equal(got.unweighted, two.unweighted, sizeof(double));
        outcome_free(&two);
        outcome_free(&got);
    }
    /* f32: an independent check of what training runs. The plane of a tied triangle may differ, a kink may tip over. */
    if (!strchr(label, '@') && !strstr(label, "mode=plane")) {
        outcome got = evaluate(r, HG_F32, 2, HG_BACKEND_AUTO, 1, &v->term, positions, label);
        compare(label, "f32 value", 1, got.unweighted, want.unweighted, 1e-4);
        compare(label, "f32 gradient", count, got.gradient, want.gradient, 2e-3);
        outcome_free(&got);
    }
    case_free(&want);
}

/* ---- gradients in everything else ---- */

static int count_datasets(const reference *r, const char *group)
{
    int n = 0;
    char **names;
    if (!hg_h5_has(r->file, group)) return 0;
    ok(hg_h5_names(r->file, group, &n, &names), group);
    hg_texts_free(names, n);
    return n;
}

/* The posed groom: root + R (rest - rest root), R of a quaternion. */
static void make_posed(const reference *r, double *to)
{
    for (int64_t i = 0; i < r->B * r->S * r->V; i++) {
        const int64_t strand = i / r->V, groom = r->groom[strand / r->S];
        const double *root = r->rest + (groom * r->S + strand % r->S) * r->V * 3, *at = root + i % r->V * 3;
        const double *q = r->root_rotation + 4 * strand, *p = r->root_position + 3 * strand;
        const double d[3] = { at[0] - root[0], at[1] - root[1], at[2] - root[2] };
        for (int k = 0; k < 3; k++) {
            const int l = (k + 1) % 3, m = (k + 2) % 3;
            to[3 * i + k] = p[k] + d[k] * (1 - 2 * (q[1 + l] * q[1 + l] + q[1 + m] * q[1 + m])) +
                            d[l] * 2 * (q[1 + k] * q[1 + l] - q[0] * q[1 + m]) +
                            d[m] * 2 * (q[1 + k] * q[1 + m] + q[0] * q[1 + l]);
        }
    }
}

/* Which back end a call runs on, and how far from the reference it may be. */
typedef struct {
    const char *name;
    hg_dtype dtype;
    hg_backend backend;
    double tolerance;
} runner;

static int compare_wrt(const reference *r, const runner *on, const char *label, const char *name, const hg_tensor *leaf)
{
    char path[400];
    if (strcmp(name, "x") == 0)
        snprintf(path, sizeof path, "%s/gradient", label);
    else
        snprintf(path, sizeof path, "%s/wrt/%s", label, name);
    const hg_tensor *gradient = hg_grad(leaf);
    assert_non_null(gradient);
    const int64_t n = hg_tensor_count(leaf);
    double *want = NULL;
    if (!hg_h5_has(r->file, path)) { /* what has no effect; a sum may leave a little rounding */
        for (int64_t i = 0; i < n && on->dtype == HG_F64; i++)
            if (fabs(hg_tensor_item(gradient, i)) > 1e-12)
                fail_msg("%s: the gradient in %s at %lld is %g, and the reference has none", label, name, (long long)i,
                         hg_tensor_item(gradient, i));
        return 0;
    }
    ok(hg_h5_read(r->file, path, HG_F64, leaf->rank, leaf->shape, NULL, (void **)&want), path);
    double *got = calloc((size_t)n + 1, sizeof *got);
    assert_non_null(got);
    for (int64_t i = 0; i < n; i++) got[i] = hg_tensor_item(gradient, i);
    snprintf(path, sizeof path, "%s: %s", on->name, name);
    compare(label, path, n, got, want, on->tolerance);
    free(got);
    hg_free(want);
    return 1;
}

/* All at once on the tape; the posed groom in a call of its own, since it is then not made of the others. */
static void check_others(const reference *r, const variant *v, const runner *on)
{
    int64_t vertices[4] = { r->B, r->S, r->V, 3 }, body[3] = { r->B, r->N, 3 };
    int64_t rotation[3] = { r->B, r->S, 4 }, position[3] = { r->B, r->S, 3 };
    const hg_energy *energy = v->term.energy;
    char posed_path[400];
    snprintf(posed_path, sizeof posed_path, "%s/wrt/posed", v->label);
    const int posed_calls = 1 + hg_h5_has(r->file, posed_path);
    int found = 0;
    for (int posed = 0; posed < posed_calls; posed++) {
        hg_ctx *ctx;
        hg_physics *physics;
        hg_energy_inputs asks;
        hg_frame_input list[MOST_INPUTS];
        static char names[HG_ENERGY_PARAMS][96];
        ok(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .seed = 1 }), v->label);
        ok(hg_physics_create(&physics, ctx, on->dtype, &v->term, 1, &r->data), v->label);
        ok(hg_physics_backend(physics, on->backend), v->label);
        ok(hg_energy_asks(energy, v->choice.options, posed, &asks), v->label);
        hg_frame frame = { .groom = r->groom, .dt = 1.0 / 30.0 };
        frame.root_rotation = tensor(ctx, on->dtype, 3, rotation, r->root_rotation);
        frame.root_position = tensor(ctx, on->dtype, 3, position, r->root_position);
        frame.predicted = tensor(ctx, on->dtype, 4, vertices, r->predicted);
        frame.previous = tensor(ctx, on->dtype, 4, vertices, r->previous);
        frame.body_vertices = tensor(ctx, on->dtype, 3, body, r->body_vertices);
        bring(r, ctx, on->dtype, 1, &v->term, !posed, &frame, list);
        hg_tensor *x = tensor(ctx, on->dtype, 4, vertices, r->x);
        if (posed) {
            double *y = calloc((size_t)hg_tensor_count(x), sizeof *y);
            assert_non_null(y);
            make_posed(r, y);
            frame.posed = tensor(ctx, on->dtype, 4, vertices, y);
            free(y);
            ok(hg_require_grad(frame.posed), v->label);
        }
        for (int p = 0; !posed && p < HG_ENERGY_PARAMS && energy->params[p].name; p++) {
            if (!((asks.params | asks.kernel_params) >> p & 1)) continue;
            snprintf(names[p], sizeof names[p], "%s.%s", energy->name, energy->params[p].name);
            list[frame.n_inputs++] = (hg_frame_input){ names[p], tensor(ctx, on->dtype, 0, NULL, &v->params[p]) };
        }
        ok(hg_require_grad(x), v->label);
        hg_tensor *const members[] = { frame.root_rotation, frame.root_position, frame.predicted, frame.previous };
        static const char *const member_names[] = { "root_rotation", "root_position", "predicted", "previous" };
        for (int i = 0; !posed && i < frame.n_inputs; i++) ok(hg_require_grad(list[i].value), list[i].name);
        for (int i = 0; !posed && i < 4; i++) ok(hg_require_grad(members[i]), member_names[i]);
        hg_tensor *energy_tensor = hg_physics_energy(physics, ctx, &frame, x, NULL);
        if (!energy_tensor) fail_msg("%s: %s", v->label, hg_message());
        ok(hg_backward(ctx, energy_tensor), v->label);
        found += compare_wrt(r, on, v->label, "x", x);
        for (int i = 0; !posed && i < frame.n_inputs; i++) {
            const char *dot = strchr(list[i].name, '.');
            found += compare_wrt(r, on, v->label, dot ? dot + 1 : list[i].name, list[i].value);
        }
        for (int i = 0; !posed && i < 4; i++) found += compare_wrt(r, on, v->label, member_names[i], members[i]);
        if (posed) found += compare_wrt(r, on, v->label, "posed", frame.posed);
        hg_physics_destroy(physics);
        hg_ctx_destroy(ctx);
    }
    char group[400];
    snprintf(group, sizeof group, "%s/wrt", v->label);
    const int expected = count_datasets(r, group);
    found -= posed_calls; /* x, in each */
    if (found != expected) fail_msg("%s: %d of %d gradients were compared", v->label, found, expected);
}

static void test_energies(void **state)
{
    (void)state;
    reference r;
    open_reference(&r);
    const char *names[MOST];
    int n = hg_list("energy", names, MOST);
    assert_in_range(n, 9, MOST);
    for (int e = 0; e < n; e++) {
        const hg_energy *energy = hg_energy_find(names[e]);
        assert_non_null(energy);
        variant v;
        for (int number = 0; make_variant(energy, number, &v); number++) {
            check_case(&r, &v, v.label, r.x);
            check_others(&r, &v, &(runner){ "interpreted", HG_F64, HG_BACKEND_INTERPRETER, TOLERANCE });
            char label[300];
            snprintf(label, sizeof label, "%s@degenerate", v.label);
            if (hg_h5_has(r.file, label)) check_case(&r, &v, label, r.x_degenerate);
        }
    }
    close_reference(&r);
}

/* Every back end differentiates every energy in everything: interpreted and compiled, f32 and f64. What is compiled is kept
 * in the build folder, so that it is compiled once. */
static void test_back_ends(void **state)
{
    (void)state;
    const runner runners[] = { { "interpreted f32", HG_F32, HG_BACKEND_INTERPRETER, 2e-3 },
                               { "compiled f64", HG_F64, HG_BACKEND_COMPILED, TOLERANCE },
                               { "compiled f32", HG_F32, HG_BACKEND_COMPILED, 2e-3 } };
    const char *build = getenv("HG_BUILD");
    char folder[] = "/tmp/hairgrad-XXXXXX", path[4096], command[4160];
    if (!build) assert_non_null(mkdtemp(folder));
    snprintf(path, sizeof path, "%s/%s", build ? build : folder, build ? "test-kernels" : "kernels");
    setenv("HAIRGRAD_CACHE", path, 1);
    const bool compiler = system("${CC:-cc} --version > /dev/null 2>&1") == 0;
    reference r;
    open_reference(&r);
    const char *names[MOST];
    int n = hg_list("energy", names, MOST);
    for (int e = 0; e < n; e++) {
        const hg_energy *energy = hg_energy_find(names[e]);
        variant v;
        for (int number = 0; make_variant(energy, number, &v); number++) {
            if (strstr(v.label, "mode=plane")) continue; /* in f32 another one of tied triangles may be found */
            outcome want = read_case(&r, v.label, energy, v.params);
            case_free(&want);
            for (int k = 0; k < (compiler && energy->site.kind == HG_SITE_WINDOW ? 3 : 1); k++)
                check_others(&r, &v, &runners[k]);
        }
    }
    close_reference(&r);
    if (!build) {
        snprintf(command, sizeof command, "rm -rf '%s'", folder);
        assert_int_equal(system(command), 0);
    }
    if (!compiler) skip();
}

/* All at once, each with a weight of its own: the gradient is the weighted sum, the read-outs stay unweighted. */
static void test_weighted_sum(void **state)
{
    (void)state;
    reference r;
    open_reference(&r);
    const char *names[MOST];
    int n = hg_list("energy", names, MOST);
    static variant variants[MOST];
    hg_term terms[MOST];
    double value[MOST], scale = 0.0;
    int64_t count = r.B * r.S * r.V * 3;
    double *sum = calloc((size_t)count, sizeof *sum);
    assert_non_null(sum);
    for (int e = 0; e < n; e++) {
        make_variant(hg_energy_find(names[e]), 0, &variants[e]);
        outcome want = read_case(&r, variants[e].label, variants[e].term.energy, variants[e].params);
        value[e] = want.unweighted[0];
        double weight = 0.5 + e, largest = 0.0;
        for (int64_t i = 0; i < count; i++) largest = fmax(largest, fabs(want.gradient[i]));
        if (largest > 0) weight /= largest; /* so that every energy has its say */
        for (int64_t i = 0; i < count; i++) sum[i] += weight * want.gradient[i];
        terms[e] = (hg_term){ variants[e].term.energy, weight, variants[e].params, variants[e].choice.options };
        case_free(&want);
    }
    for (int64_t i = 0; i < count; i++) scale = fmax(scale, fabs(sum[i]));
    assert_true(scale > 0.0);
    outcome got = evaluate(&r, HG_F64, 2, HG_BACKEND_AUTO, n, terms, r.x, "sum");
    for (int e = 0; e < n; e++) compare(names[e], "value in the sum", 1, got.unweighted + e, value + e, TOLERANCE);
    compare("sum", "gradient", count, got.gradient, sum, TOLERANCE);
    outcome_free(&got);
    free(sum);
    close_reference(&r);
}

/* The density at rest may be given, and is then the one that counts. */
static void test_density_given(void **state)
{
    (void)state;
    reference r;
    open_reference(&r);
    variant v;
    make_variant(hg_energy_find("self_collision"), 0, &v);
    outcome want = read_case(&r, v.label, v.term.energy, v.params);
    v.term.params = v.params;
    v.term.options = v.choice.options;
    int64_t n = r.G * r.S * r.V;
    double *density = calloc((size_t)n, sizeof *density);
    assert_non_null(density);
    hg_groom_attribute given[3] = { r.attributes[0], r.attributes[1], { "density_rest", density } };
    reference with = r;
    with.data.attributes = given;
    with.data.n_attributes = 3;
    outcome got = evaluate(&with, HG_F64, 1, HG_BACKEND_AUTO, 1, &v.term, r.x, "density 0 at rest");
    assert_true(got.unweighted[0] > 2.0 * want.unweighted[0]);
    outcome_free(&got);
    for (int64_t i = 0; i < n; i++) density[i] = 1e6;
    got = evaluate(&with, HG_F64, 1, HG_BACKEND_AUTO, 1, &v.term, r.x, "density 1e6 at rest");
    assert_true(got.unweighted[0] == 0.0);
    for (int64_t i = 0; i < r.B * r.S * r.V * 3; i++) assert_true(got.gradient[i] == 0.0);
    outcome_free(&got);
    case_free(&want);
    free(density);
    close_reference(&r);
}

/* Pairs may be given, one list per groom. */
static void test_pairs_given(void **state)
{
    (void)state;
    reference r;
    open_reference(&r);
    variant v;
    make_variant(hg_energy_find("adhesion"), 0, &v);
    v.term.params = v.params;
    v.term.options = v.choice.options;
    int32_t far = (int32_t)(r.S * r.V - 1);
    hg_pairs *lists[2];
    ok(hg_pairs_from_list(&lists[0], r.S * r.V, 2, (int32_t[]){ 0, far, far, 1 }), "pairs");
    ok(hg_pairs_from_list(&lists[1], r.S * r.V, 0, NULL), "no pairs");
    r.data.adhesion = lists;
    outcome got = evaluate(&r, HG_F64, 1, HG_BACKEND_AUTO, 1, &v.term, r.x, "pairs given");
    double want = 0.0;
    for (int64_t b = 0; b < r.B; b++) {
        if (r.groom[b] != 0) continue;
        const double *x = r.x + b * r.S * r.V * 3;
        for (int k = 0; k < 3; k++)
            want += v.params[0] * (pow(x[k] - x[3 * far + k], 2) + pow(x[3 + k] - x[3 * far + k], 2));
    }
    assert_true(want > 0.0);
    assert_true(fabs(got.unweighted[0] - want) < 1e-12 * want);
    outcome_free(&got);
    for (int i = 0; i < 2; i++) hg_pairs_destroy(lists[i]);
    close_reference(&r);
}

/* Coincident vertices, a groom of one vertex, none at all, a runaway and a vertex that is not a number. */
static void test_degenerate_passes(void **state)
{
    (void)state;
    hg_ctx *ctx;
    ok(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1, .seed = 1 }), "context");
    hg_term terms[2] = { { hg_energy_find("self_collision"), 1.0, NULL, NULL },
                         { hg_energy_find("adhesion"), 1.0, NULL, NULL } };
    for (int strands = 0; strands <= 3; strands++)
        for (int vertices = 1; vertices <= 2; vertices++) {
            double rest[18];
            for (int i = 0; i < 18; i++) rest[i] = 0.0005 * i;
            hg_groom_data data = { .grooms = 1, .strands = strands, .vertices = vertices, .rest = rest };
            for (int dtype = HG_F32; dtype <= HG_F64; dtype++) {
                hg_physics *physics;
                ok(hg_physics_create(&physics, ctx, (hg_dtype)dtype, terms, 2, &data), "physics");
                int64_t shape[4] = { 1, strands, vertices, 3 };
                double coincident[18] = { 0 };
                hg_frame frame = { .dt = 1.0 / 30.0 };
                for (int what = 0; what < 3; what++) {
                    if (what == 1) coincident[0] = 1e6;
                    if (what == 2) coincident[0] = 1e30;
                    hg_tensor *x = tensor(ctx, (hg_dtype)dtype, 4, shape, coincident);
                    hg_tensor *gradient = hg_tensor_make(ctx, (hg_dtype)dtype, 4, shape);
                    double value[2];
                    ok(hg_physics_evaluate(physics, ctx, &frame, x, value, NULL, gradient), "evaluate");
                    assert_true(isfinite(value[0]) && (what == 2 || isfinite(value[1])));
                    if (what < 2)
                        for (int64_t i = 0; i < hg_tensor_count(gradient); i++)
                            assert_true(isfinite(hg_tensor_item(gradient, i)));
                }
                hg_physics_destroy(physics);
            }
        }
    double params[HG_ENERGY_PARAMS] = { 1e-10, -1.0 }, rest[3] = { 0 };
    hg_groom_data data = { .grooms = 1, .strands = 1, .vertices = 1, .rest = rest };
    terms[0].params = params;
    hg_physics *physics;
    assert_int_equal(hg_physics_create(&physics, ctx, HG_F64, terms, 1, &data), HG_INVALID);
    assert_non_null(strstr(hg_message(), "self_collision: h is -1 m"));
    hg_ctx_destroy(ctx);
}

/* A file of hairloss/ that declares an energy has its reference: by its name, whatever the registry says. */
static void test_every_file(void **state)
{
    (void)state;
    reference r;
    open_reference(&r);
    char *folder_path = source_path("hairloss");
    DIR *folder = opendir(folder_path);
    assert_non_null(folder);
    int found = 0;
    for (struct dirent *entry; (entry = readdir(folder));) {
        if (strcmp(hg_path_extension(entry->d_name), "c") != 0) continue;
        char *path = hg_path_join(folder_path, entry->d_name);
        void *bytes;
        size_t size;
        ok(hg_file_read(path, &bytes, &size), path);
        const char *at = strstr(bytes, "\nHG_ENERGY(");
        if (at) {
            char name[64];
            at += strlen("\nHG_ENERGY(");
            at += strspn(at, " \n");
            snprintf(name, sizeof name, "%.*s", (int)strcspn(at, ", )"), at);
            variant v;
            const hg_energy *energy = hg_energy_find(name);
            if (!energy) fail_msg("%s declares %s, which is not registered", entry->d_name, name);
            make_variant(energy, 0, &v);
            if (!hg_h5_has(r.file, v.label)) fail_msg("%s: no reference for %s", entry->d_name, v.label);
            found++;
        }
        hg_free(bytes);
        hg_free(path);
    }
    closedir(folder);
    assert_true(found >= 9);
    hg_free(folder_path);
    close_reference(&r);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_energies),          cmocka_unit_test(test_weighted_sum),
        cmocka_unit_test(test_density_given),     cmocka_unit_test(test_pairs_given),
        cmocka_unit_test(test_degenerate_passes), cmocka_unit_test(test_every_file),
        cmocka_unit_test(test_back_ends),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
