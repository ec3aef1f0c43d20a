/* hg_loss_run: every energy with every choice of its options, from a file to a file, against the values and gradients of
 * tests/reference; shapes, settings, and what is wrong with a file, in one sentence each. */
#include "hairloss/hairloss.h"

#include "tests/device.h"
#include "tests/test.h"

enum { MOST = 64 };

static void ok(hg_status status, const char *what)
{
    if (status != HG_OK) fail_msg("%s: %s", what, hg_message());
}

/* ---- files ---- */

typedef struct {
    int rank;
    int64_t shape[6], count;
    double *values;
} numbers;

static numbers read_numbers(hg_h5 *file, const char *name)
{
    numbers n = { .count = 1 };
    ok(hg_h5_shape(file, name, &n.rank, n.shape), name);
    for (int i = 0; i < n.rank; i++) n.count *= n.shape[i];
    ok(hg_h5_read(file, name, HG_F64, n.rank, n.shape, NULL, (void **)&n.values), name);
    return n;
}

static hg_h5 *open_reference(void)
{
    const char *source = getenv("HG_SOURCE");
    char *path = hg_path_join(source ? source : ".", "tests/reference/energies.h5");
    hg_h5 *file;
    ok(hg_h5_open(&file, path), "reference");
    hg_free(path);
    return file;
}

static void copy_dataset(hg_h5 *to, const char *as, hg_h5 *from, const char *name)
{
    char path[64];
    snprintf(path, sizeof path, "scene/%s", name);
    numbers n = read_numbers(from, path);
    ok(hg_h5_write(to, as, HG_F64, n.rank, n.shape, n.values), as);
    hg_free(n.values);
}

static void rotate(const double q[4], const double v[3], double out[3])
{
    const double t[3] = { 2 * (q[2] * v[2] - q[3] * v[1]), 2 * (q[3] * v[0] - q[1] * v[2]),
                          2 * (q[1] * v[1] - q[2] * v[0]) };
    out[0] = v[0] + q[0] * t[0] + q[2] * t[2] - q[3] * t[1];
    out[1] = v[1] + q[0] * t[1] + q[3] * t[0] - q[1] * t[2];
    out[2] = v[2] + q[0] * t[2] + q[1] * t[1] - q[2] * t[0];
}

/* The rigidly posed groom: root position + R (rest - rest root). */
static void write_posed(hg_h5 *to, hg_h5 *from)
{
    numbers rest = read_numbers(from, "scene/rest"), rotation = read_numbers(from, "scene/root_rotation"),
            position = read_numbers(from, "scene/root_position"), groom = read_numbers(from, "scene/groom");
    const int64_t B = rotation.shape[0], S = rotation.shape[1], V = rest.shape[2], shape[4] = { B, S, V, 3 };
    double *posed = calloc((size_t)(B * S * V * 3), sizeof *posed);
    assert_non_null(posed);
    for (int64_t i = 0; i < B * S * V; i++) {
        const int64_t strand = i / V, b = strand / S;
        const double *root = rest.values + (((int64_t)groom.values[b] * S + strand % S) * V) * 3;
        double arm[3], turned[3];
        for (int c = 0; c < 3; c++) arm[c] = root[3 * (i % V) + c] - root[c];
        rotate(rotation.values + 4 * strand, arm, turned);
        for (int c = 0; c < 3; c++) posed[3 * i + c] = position.values[3 * strand + c] + turned[c];
    }
    ok(hg_h5_write(to, "posed", HG_F64, 4, shape, posed), "posed");
    free(posed);
    hg_free(rest.values);
    hg_free(rotation.values);
    hg_free(position.values);
    hg_free(groom.values);
}

/* The scene of the reference as the input of a loss. */
static void write_scene(const char *path, hg_h5 *from, bool posed)
{
    static const char *const names[] = {
        "x",     "predicted",     "previous",       "root_rotation", "mass",  "rest",
        "groom", "body_distance", "scalp_distance", "body_vertices", "ghost", "deformation",
        "q",     "root_position"
    };
    hg_h5 *to;
    ok(hg_h5_create(&to, path), path);
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (!posed || strcmp(names[i], "root_position") != 0) {
            if (strcmp(names[i], "groom") != 0) copy_dataset(to, names[i], from, names[i]);
        }
    numbers groom = read_numbers(from, "scene/groom"), faces = read_numbers(from, "scene/faces");
    int64_t *whole = calloc((size_t)faces.count, sizeof *whole); /* as NumPy writes integers */
    assert_non_null(whole);
    for (int64_t i = 0; i < faces.count; i++) whole[i] = (int64_t)faces.values[i];
    ok(hg_h5_write_i64(to, "body_faces", 2, faces.shape, whole), "faces");
    for (int64_t i = 0; i < groom.count; i++) whole[i] = (int64_t)groom.values[i];
    ok(hg_h5_write_i64(to, "groom", 1, groom.shape, whole), "groom");
    copy_dataset(to, "rest_body_vertices", from, "body_rest");
    if (posed) write_posed(to, from);
    free(whole);
    hg_free(groom.values);
    hg_free(faces.values);
    ok(hg_h5_commit(to), path);
}

/* ---- against the reference ---- */

static void compare(const char *label, const char *what, const numbers *got, const numbers *want, double tolerance)
{
    double scale = 0;
    if (got->count != want->count)
        fail_msg("%s: %s has %lld numbers, expected %lld", label, what, (long long)got->count, (long long)want->count);
    for (int64_t i = 0; i < want->count; i++) scale = fmax(scale, fabs(want->values[i]));
    for (int64_t i = 0; i < want->count; i++)
        if (!(fabs(got->values[i] - want->values[i]) <= tolerance * scale))
            fail_msg("%s: %s at %lld is %.17g, expected %.17g", label, what, (long long)i, got->values[i],
                     want->values[i]);
}

static void compare_dataset(hg_h5 *out, const char *got_name, hg_h5 *file, const char *want_name, const char *label,
                            double tolerance)
{
    numbers got = read_numbers(out, got_name), want = read_numbers(file, want_name);
    compare(label, got_name, &got, &want, tolerance);
    hg_free(got.values);
    hg_free(want.values);
}

typedef struct {
    char energy[64], set[12][96];
    const char *list[12];
    int n;
} settings;

/* "bend_twist,strain=smooth" and the attributes of its group, as settings. */
static void read_settings(hg_h5 *file, const char *label, settings *s)
{
    *s = (settings){ 0 };
    if (!label) return; /* gcc 14 thinks that it might */
    snprintf(s->energy, sizeof s->energy, "%.*s", (int)strcspn(label, ","), label);
    for (const char *at = strchr(label, ','); at; at = strchr(at, ',')) {
        at++;
        snprintf(s->set[s->n++], sizeof s->set[0], "%.*s", (int)strcspn(at, ","), at);
    }
    const hg_energy *energy = hg_energy_find(s->energy);
    assert_non_null(energy);
    for (int p = 0; p < HG_ENERGY_PARAMS && energy->params[p].name; p++) {
        double value, y, z;
        const char *name = energy->params[p].name;
        if (hg_h5_get_number(file, label, name, &value) != HG_OK) continue;
        if (strcmp(name, "g.x") == 0) {
            ok(hg_h5_get_number(file, label, "g.y", &y), label);
            ok(hg_h5_get_number(file, label, "g.z", &z), label);
            snprintf(s->set[s->n++], sizeof s->set[0], "g=%.17g,%.17g,%.17g", value, y, z);
            p += 2;
        } else {
            snprintf(s->set[s->n++], sizeof s->set[0], "%s=%.17g", name, value);
        }
    }
    for (int i = 0; i < s->n; i++) s->list[i] = s->set[i];
}

static bool is_one_of(const char *name, const char *const *names, int n)
{
    for (int i = 0; i < n; i++)
        if (strcmp(name, names[i]) == 0) return true;
    return false;
}

static void check_case(hg_ctx *ctx, hg_h5 *file, const char *label, bool posed, hg_dtype dtype, const char *in,
                       const char *out)
{
    settings s;
    char group[300], name[400], grad[80], wrt[512] = "x", **names = NULL;
    int n = 0;
    read_settings(file, label, &s);
    snprintf(group, sizeof group, "%s/wrt", label);
    if (hg_h5_has(file, group)) ok(hg_h5_names(file, group, &n, &names), group);
    /* What is made of others is differentiated through them, or by itself: two files. */
    static const char *const through[] = { "rest", "root_rotation", "root_position" };
    const bool reads_posed = n && is_one_of("posed", (const char *const *)names, n);
    if (posed && !reads_posed) {
        hg_texts_free(names, n);
        return;
    }
    for (int i = 0; i < n; i++) {
        if (posed ? is_one_of(names[i], through, 3) : strcmp(names[i], "posed") == 0) continue;
        const char *dot = strchr(names[i], '.');
        if (dot && strcmp(dot, ".x") != 0) continue;
        const size_t used = strlen(wrt);
        snprintf(wrt + used, sizeof wrt - used, ",%.*s", dot ? (int)(dot - names[i]) : 64, names[i]);
    }
    hg_loss_result result;
    const hg_loss_options options = { .energies = s.energy, .dtype = dtype, .n_set = s.n, .set = s.list, .wrt = wrt };
    ok(hg_loss_run(ctx, in, out, &options, &result), label);

    hg_h5 *got;
    const double tolerance = dtype == HG_F64 ? 1e-9 : 2e-3;
    ok(hg_h5_open(&got, out), out);
    snprintf(name, sizeof name, "%s/value", label);
    compare_dataset(got, "energy", file, name, label, dtype == HG_F64 ? 1e-9 : 1e-4);
    snprintf(name, sizeof name, "%s/gradient", label);
    compare_dataset(got, "grad_x", file, name, label, tolerance);
    for (int i = 0; i < n; i++) {
        if (posed ? is_one_of(names[i], through, 3) : strcmp(names[i], "posed") == 0) continue;
        snprintf(name, sizeof name, "%s/%s", group, names[i]);
        const char *dot = strchr(names[i], '.');
        snprintf(grad, sizeof grad, "grad_%.*s", dot ? (int)(dot - names[i]) : 64, names[i]);
        if (!dot) {
            compare_dataset(got, grad, file, name, label, tolerance);
        } else {
            numbers all = read_numbers(got, grad), want = read_numbers(file, name);
            assert_int_equal(all.count, 3);
            numbers one = { .count = 1, .values = all.values + (dot[1] - 'x') };
            compare(label, names[i], &one, &want, tolerance);
            hg_free(all.values);
            hg_free(want.values);
        }
    }
    hg_h5_close(got);
    hg_texts_free(names, n);
}

static void test_reference(void **state)
{
    (void)state;
    hg_ctx *ctx;
    ok(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .device = test_device() }), "context");
    hg_h5 *file = open_reference();
    char *with = test_path("posed.h5"), *without = test_path("roots.h5"), *out = test_path("out.h5"), **labels;
    write_scene(with, file, true);
    write_scene(without, file, false);
    int n, checked = 0;
    ok(hg_h5_names(file, "", &n, &labels), "names");
    for (int i = 0; i < n; i++) {
        if (strcmp(labels[i], "scene") == 0 || strchr(labels[i], '@')) continue;
        char energy[64];
        snprintf(energy, sizeof energy, "%.*s", (int)strcspn(labels[i], ","), labels[i]);
        if (!hg_find("energy", energy)) continue; /* test_reference.c says so */
        check_case(ctx, file, labels[i], false, HG_F64, without, out);
        check_case(ctx, file, labels[i], true, HG_F64, with, out);
        /* A tied triangle may differ in f32. */
        if (!strstr(labels[i], "mode=plane")) check_case(ctx, file, labels[i], false, HG_F32, without, out);
        checked++;
    }
    assert_true(checked > 15);
    hg_texts_free(labels, n);
    hg_h5_close(file);
    hg_ctx_destroy(ctx);
    hg_free(with);
    hg_free(without);
    hg_free(out);
}

/* ---- shapes and settings ---- */

enum { S = 3, V = 4 };
typedef struct {
    hg_ctx *ctx;
    char *in, *out;
    double x[S * V * 3], rest[S * V * 3];
} bench;

static void bench_make(bench *b)
{
    ok(hg_ctx_create(&b->ctx, &(hg_ctx_options){ .threads = 1, .device = test_device() }), "context");
    b->in = test_path("in.h5");
    b->out = test_path("out.h5");
    for (int i = 0; i < S * V * 3; i++) {
        b->rest[i] =
            (i % 3 == 1 ? -0.01 * (i / 3 % V) : 0.02 * (i / (3 * V))) + 1e-3 * hg_random_normal(3, 1, (uint64_t)i);
        b->x[i] = b->rest[i] + 2e-3 * hg_random_normal(3, 2, (uint64_t)i);
    }
}

static void bench_free(bench *b)
{
    hg_ctx_destroy(b->ctx);
    hg_free(b->in);
    hg_free(b->out);
}

/* in.h5 with x and rest without the axis of frames, and one more dataset (NULL: none). */
static void bench_write(const bench *b, const char *name, int rank, const int64_t *shape, const double *values)
{
    hg_h5 *file;
    ok(hg_h5_create(&file, b->in), b->in);
    ok(hg_h5_write(file, "x", HG_F64, 3, (int64_t[]){ S, V, 3 }, b->x), "x");
    ok(hg_h5_write(file, "rest", HG_F64, 3, (int64_t[]){ S, V, 3 }, b->rest), "rest");
    if (name) ok(hg_h5_write(file, name, HG_F64, rank, shape, values), name);
    ok(hg_h5_commit(file), b->in);
}

static hg_status run_loss(const bench *b, const char *energies, const char *wrt, hg_loss_result *result, int n,
                          const char *const *set)
{
    const hg_loss_options options = { .energies = energies, .dtype = HG_F64, .n_set = n, .set = set, .wrt = wrt };
    return hg_loss_run(b->ctx, b->in, b->out, &options, result);
}

static numbers output(const bench *b, const char *name)
{
    hg_h5 *file;
    ok(hg_h5_open(&file, b->out), b->out);
    numbers n = read_numbers(file, name);
    hg_h5_close(file);
    return n;
}

/* Gradients have the shape of what was given: one number for all is their sum; per strand each its own. */
static void test_shapes(void **state)
{
    (void)state;
    bench b;
    hg_loss_result result;
    bench_make(&b);
    bench_write(&b, "mass", 0, NULL, (double[]){ 3e-8 });
    ok(run_loss(&b, "gravity", "x,mass,g", &result, 0, NULL), "gravity");
    numbers x = output(&b, "grad_x"), mass = output(&b, "grad_mass"), g = output(&b, "grad_g");
    assert_int_equal(x.rank, 3);
    assert_int_equal(mass.rank, 0);
    assert_true(fabs(mass.values[0] * 3e-8 / result.energy - 1) < 1e-12);
    assert_int_equal(g.rank, 1);
    assert_true(fabs(g.values[1] * -9.81 / result.energy - 1) < 1e-12);
    assert_string_equal(result.unread, "rest");
    hg_free(x.values);
    hg_free(mass.values);
    hg_free(g.values);

    const double stiffness[S] = { 1, 2, 4 };
    bench_write(&b, "stiffness", 1, (int64_t[]){ S }, stiffness);
    ok(run_loss(&b, "stretch", "stiffness", &result, 0, NULL), "stretch");
    numbers k = output(&b, "grad_stiffness");
    assert_int_equal(k.rank, 1);
    double sum = 0;
    for (int s = 0; s < S; s++) sum += stiffness[s] * k.values[s];
    assert_true(fabs(sum / result.energy - 1) < 1e-12); /* linear in each */
    hg_free(k.values);
    /* A setting comes before the dataset. */
    ok(run_loss(&b, "stretch", "stiffness", &result, 1, (const char *[]){ "stiffness=2000 mN/m" }), "set");
    k = output(&b, "grad_stiffness");
    assert_int_equal(k.rank, 0);
    assert_true(fabs(2 * k.values[0] / result.energy - 1) < 1e-12);
    hg_free(k.values);
    bench_free(&b);
}

/* A sum of energies is the sum of their values, and says each. */
static void test_sum(void **state)
{
    (void)state;
    bench b;
    hg_loss_result one, two, both;
    bench_make(&b);
    bench_write(&b, NULL, 0, NULL, NULL);
    ok(run_loss(&b, "stretch", NULL, &one, 1, (const char *[]){ "stiffness=3" }), "stretch");
    ok(run_loss(&b, "bend_twist", NULL, &two, 2, (const char *[]){ "strain=smooth", "root=clamped" }), "bend_twist");
    ok(run_loss(&b, "stretch+bend_twist", NULL, &both, 3,
                (const char *[]){ "stretch.stiffness=3", "bend_twist.strain=smooth", "root=clamped" }),
       "both");
    assert_true(fabs(both.energy / (one.energy + two.energy) - 1) < 1e-14);
    numbers e = output(&b, "energy_bend_twist");
    assert_true(e.values[0] == two.energy && both.term[1].energy == two.energy);
    hg_free(e.values);
    bench_free(&b);
}

/* Directed pairs that are given count as they are. */
static void test_neighbours(void **state)
{
    (void)state;
    bench b;
    hg_loss_result result;
    bench_make(&b);
    hg_h5 *file;
    bench_write(&b, NULL, 0, NULL, NULL);
    ok(hg_h5_create(&file, b.in), b.in);
    ok(hg_h5_write(file, "x", HG_F64, 4, (int64_t[]){ 1, S, V, 3 }, b.x), "x");
    ok(hg_h5_write_i64(file, "neighbours", 2, (int64_t[]){ 2, 2 }, (int64_t[]){ 1, V + 2, V + 2, 1 }), "neighbours");
    ok(hg_h5_commit(file), b.in);
    ok(run_loss(&b, "adhesion", NULL, &result, 1, (const char *[]){ "stiffness=1" }),
       "adhesion"); /* rest is not read */
    double square = 0;
    for (int c = 0; c < 3; c++) square += pow(b.x[3 + c] - b.x[3 * (V + 2) + c], 2);
    assert_true(fabs(result.energy / (2 * square) - 1) < 1e-12);
    bench_free(&b);
}

static void refused(const bench *b, const char *energies, const char *wrt, const char *set, const char *says)
{
    hg_loss_result result;
    if (run_loss(b, energies, wrt, &result, set ? 1 : 0, &set) == HG_OK) fail_msg("accepted; expected \"%s\"", says);
    if (!strstr(hg_message(), says)) fail_msg("it says \"%s\", expected \"%s\"", hg_message(), says);
    assert_false(hg_file_exists(b->out));
    hg_ctx_clear(b->ctx);
}

static void test_refusals(void **state)
{
    (void)state;
    bench b;
    bench_make(&b);
    remove(b.out);
    bench_write(&b, NULL, 0, NULL, NULL);
    refused(&b, "strech", NULL, NULL, "did you mean 'stretch'?");
    refused(&b, "stretch+stretch", NULL, NULL, "named twice");
    refused(&b, "stretch+", NULL, NULL, "is not a list of energies");
    refused(&b, "stretch", NULL, "stifness=2", "did you mean \"stiffness\"? it has stiffness");
    refused(&b, "stretch", NULL, "stiffness=2 kg", "has the unit kg, N/m is needed");
    refused(&b, "stretch", NULL, "stiffness=nan", "not a finite number");
    refused(&b, "stretch", NULL, "stiffness", "expected key=value");
    refused(&b, "stretch", NULL, "mass=2", "no parameter or option \"mass\"");
    refused(&b, "bend_twist", NULL, "strain=smoth", "there are published|smooth");
    refused(&b, "gravity", NULL, "g=0,-9.81", "is not 3 numbers like 0,-9.81,0");
    refused(&b, "gravity", NULL, "g=0,-9.81,0,1", "is not 3 numbers like 0,-9.81,0");
    refused(&b, "stretch+bend_twist", NULL, "stiffness=2", "write stretch.stiffness");
    refused(&b, "stretch", "x,stifness", NULL, "did you mean \"stiffness\"?");
    refused(&b, "gravity", "rest", NULL, "reads nothing of that name");
    refused(&b, "inertia", NULL, NULL, "dataset \"predicted\" [3,4,3] is missing");
    refused(&b, "hair_style", NULL, NULL, "dataset \"posed\" [3,4,3] is missing");
    refused(&b, "body_collision", NULL, NULL, "dataset \"body_vertices\"");
    bench_write(&b, "mass", 1, (int64_t[]){ S }, (double[S]){ 1, 2, 3 });
    refused(&b, "gravity", NULL, NULL, "dataset \"mass\" is [3], expected a scalar or [3,4]");
    bench_write(&b, "stiffness", 0, NULL, (double[]){ (double)NAN });
    refused(&b, "stretch", NULL, NULL, "dataset \"stiffness\" is nan; every number has to be finite");
    double bad[S * V * 3];
    memcpy(bad, b.x, sizeof bad);
    bad[(2 * V + 1) * 3 + 2] = (double)INFINITY;
    bench_write(&b, "predicted", 3, (int64_t[]){ S, V, 3 }, bad);
    refused(&b, "inertia", NULL, NULL, "dataset \"predicted\" is inf at strand 2, vertex 1, component 2");
    hg_loss_result result;
    assert_int_equal(
        hg_loss_run(b.ctx, b.in, b.in, &(hg_loss_options){ .energies = "stretch", .dtype = HG_F64 }, &result),
        HG_INVALID);
    hg_h5 *file;
    ok(hg_h5_create(&file, b.in), b.in);
    ok(hg_h5_write(file, "x", HG_F64, 3, (int64_t[]){ S, V, 3 }, b.x), "x");
    ok(hg_h5_write_i64(file, "neighbours", 2, (int64_t[]){ 1, 2 }, (int64_t[]){ 1, S * V }), "neighbours");
    ok(hg_h5_commit(file), b.in);
    refused(&b, "stretch", NULL, NULL, "dataset \"rest\" [3,4,3] is missing");
    refused(&b, "adhesion", NULL, NULL, "pair 0 names vertex 12; flat vertex numbers s*V+v go from 0 to 11");
    bench_free(&b);
}

/* What a trap writes is read by the loss that it names: in f32 the same number that is not finite, in f64 a finite one. */
static void check_trap(bench *b, const char *energy, const char *says, bool whole)
{
    hg_loss_result result;
    hg_loss_options options = { .energies = energy, .dtype = HG_F32, .wrt = "x" };
    char *trap = test_path("trap.h5"), *in = b->in;
    hg_trap_nan(b->ctx, true, trap);
    assert_int_equal(hg_loss_run(b->ctx, b->in, b->out, &options, &result), HG_NUMERIC);
    if (!strstr(hg_message(), says) || !strstr(hg_message(), "hairgrad loss "))
        fail_msg("it says \"%s\", expected \"%s\"", hg_message(), says);
    hg_ctx_clear(b->ctx);
    hg_trap_nan(b->ctx, false, NULL);
    b->in = trap;
    ok(hg_loss_run(b->ctx, b->in, b->out, &options, &result), "again");
    assert_false(isfinite(result.energy));
    options.dtype = HG_F64;
    ok(hg_loss_run(b->ctx, b->in, b->out, &options, &result), "in f64");
    assert_true(isfinite(result.energy) && result.energy > 0);
    assert_int_equal(result.strands, whole ? S : 1);
    b->in = in;
    hg_free(trap);
}

static void test_trap(void **state)
{
    (void)state;
    bench b;
    bench_make(&b);
    double far[S * V * 3], mass[S * V], stiffness[S] = { 1, 2, 3 }, q[S * (V - 1) * 4] = { 0 };
    memcpy(far, b.x, sizeof far);
    for (int c = 0; c < 3; c++) far[(V + 2) * 3 + c] *= 1e25; /* strand 1, vertex 2 */
    for (int i = 0; i < S * V; i++) mass[i] = 1e-8 * (1 + i);
    for (int i = 0; i < S * (V - 1); i++) q[4 * i] = 1;
    hg_h5 *file;
    ok(hg_h5_create(&file, b.in), b.in);
    ok(hg_h5_write(file, "x", HG_F64, 3, (int64_t[]){ S, V, 3 }, far), "x");
    ok(hg_h5_write(file, "rest", HG_F64, 3, (int64_t[]){ S, V, 3 }, b.rest), "rest");
    ok(hg_h5_write(file, "posed", HG_F64, 3, (int64_t[]){ S, V, 3 }, b.rest), "posed");
    ok(hg_h5_write(file, "predicted", HG_F64, 3, (int64_t[]){ S, V, 3 }, b.rest), "predicted");
    ok(hg_h5_write(file, "body_distance", HG_F64, 2, (int64_t[]){ S, V }, mass), "body_distance");
    ok(hg_h5_write(file, "mass", HG_F64, 2, (int64_t[]){ S, V }, mass), "mass");
    ok(hg_h5_write(file, "stiffness", HG_F64, 1, (int64_t[]){ S }, stiffness), "stiffness");
    ok(hg_h5_write(file, "q", HG_F64, 3, (int64_t[]){ S, V - 1, 4 }, q), "q");
    ok(hg_h5_write_i64(file, "neighbours", 2, (int64_t[]){ 1, 2 }, (int64_t[]){ 1, V + 2 }), "neighbours");
    ok(hg_h5_commit(file), b.in);
    check_trap(&b, "stretch", "energy 'stretch' of frame 0, strand 1: the force on vertex 1", false);
    check_trap(&b, "inertia", "energy 'inertia' of frame 0, strand 1: its value, by vertex 2", false);
    check_trap(&b, "hair_style", "energy 'hair_style' of frame 0, strand 1: its value, by vertex 2", false);
    check_trap(&b, "cosserat_stretch_shear",
               "energy 'cosserat_stretch_shear' of frame 0, strand 1: its value, by vertex 2", false);
    check_trap(&b, "gravity+stretch", "energy 'stretch' of frame 0, strand 1", false);
    check_trap(&b, "adhesion", "energy 'adhesion' of frame 0, strand 0: the force on vertex 1", true);
    bench_free(&b);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_reference),  cmocka_unit_test(test_shapes),   cmocka_unit_test(test_sum),
        cmocka_unit_test(test_neighbours), cmocka_unit_test(test_refusals), cmocka_unit_test(test_trap),
    };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
