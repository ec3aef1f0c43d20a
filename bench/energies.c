/* Rows of the strand pass: four energies fused, by the interpreter and two apart; bend_twist against its chain. */
#include "bench/bench.h"

#include <string.h>

enum { VERTICES = 25 };

typedef struct {
    hg_ctx *ctx;
    hg_physics *physics[4];
    int n;
    const hg_frame *frame;
    hg_tensor *x, *gradient;
} strands;

static void evaluate(void *self, double *ms, int n)
{
    strands *s = self;
    double energies[8];
    for (int i = -1; i < n; i++) {
        const double start = bench_now();
        for (int k = 0; k < s->n; k++)
            bench_need(hg_physics_evaluate(s->physics[k], s->ctx, s->frame, s->x, energies, NULL, s->gradient));
        bench_need(hg_ctx_wait(s->ctx));
        if (i >= 0) ms[i] = bench_now() - start;
        hg_step_reset(s->ctx);
    }
}

static hg_physics *make(hg_ctx *ctx, int n, const char *const *names, const hg_groom_data *data, hg_backend backend)
{
    hg_term terms[8];
    hg_physics *physics;
    for (int i = 0; i < n; i++) {
        terms[i] = (hg_term){ hg_energy_find(names[i]), 1, NULL, NULL };
        if (!terms[i].energy) bench_need(HG_INVALID);
    }
    bench_need(hg_physics_create(&physics, ctx, HG_F32, terms, n, data));
    bench_need(hg_physics_backend(physics, backend));
    return physics;
}

typedef struct {
    hg_groom_data data;
    double *rest;
    hg_tensor *x[2], *predicted[2], *rotation[2], *position[2], *gradient[2];
    hg_frame frame[2];
} scene;

static void make_scene(bench *b, scene *s, int64_t count)
{
    const int64_t n = count * VERTICES * 3, shape[4] = { 1, count, VERTICES, 3 };
    *s = (scene){ .rest = hg_alloc((size_t)n, sizeof(double)) };
    if (!s->rest) bench_need(HG_MEMORY);
    for (int64_t i = 0; i < n; i++)
        s->rest[i] = (i % 3 == 1 ? -4e-3 * (double)(i / 3 % VERTICES) : 0) + 1e-3 * hg_random_normal(1, 0, (uint64_t)i);
    float *x = hg_alloc((size_t)n, sizeof *x), *predicted = hg_alloc((size_t)n, sizeof *predicted),
          *rotation = hg_alloc((size_t)count, 4 * sizeof *rotation);
    if (!x || !predicted || !rotation) bench_need(HG_MEMORY);
    for (int64_t i = 0; i < n; i++) {
        x[i] = (float)(s->rest[i] + 5e-4 * hg_random_normal(2, 0, (uint64_t)i));
        predicted[i] = (float)(s->rest[i] + 5e-4 * hg_random_normal(2, 1, (uint64_t)i));
    }
    for (int64_t i = 0; i < count; i++) rotation[4 * i] = 1;
    s->data = (hg_groom_data){ .grooms = 1, .strands = count, .vertices = VERTICES, .rest = s->rest };
    for (int c = 0; c < 2; c++) {
        hg_ctx *ctx = b->ctx[c];
        s->x[c] = hg_tensor_create(ctx, HG_F32, 4, shape);
        s->predicted[c] = hg_tensor_create(ctx, HG_F32, 4, shape);
        s->gradient[c] = hg_tensor_create(ctx, HG_F32, 4, shape);
        s->rotation[c] = hg_tensor_create(ctx, HG_F32, 3, (int64_t[]){ 1, count, 4 });
        s->position[c] = hg_tensor_create(ctx, HG_F32, 3, (int64_t[]){ 1, count, 3 });
        if (!s->x[c] || !s->predicted[c] || !s->gradient[c] || !s->rotation[c] || !s->position[c])
            bench_need(HG_MEMORY);
        bench_put(s->x[c], x);
        bench_put(s->predicted[c], predicted);
        bench_put(s->rotation[c], rotation);
        s->frame[c] = (hg_frame){ .root_rotation = s->rotation[c],
                                  .root_position = s->position[c],
                                  .predicted = s->predicted[c],
                                  .dt = 1.0 / 30 };
    }
    hg_free(x);
    hg_free(predicted);
    hg_free(rotation);
}

static void free_scene(scene *s)
{
    for (int c = 0; c < 2; c++) {
        hg_tensor *all[] = { s->x[c], s->predicted[c], s->gradient[c], s->rotation[c], s->position[c] };
        for (int i = 0; i < 5; i++) hg_tensor_destroy(all[i]);
    }
    hg_free(s->rest);
}

static int same_bits(scene *s, strands *one, strands *two)
{
    double ms;
    evaluate(one, &ms, 1);
    evaluate(two, &ms, 1);
    return bench_same(s->gradient[0], s->gradient[1]);
}

/* Operations of a strand as the prototype counted them for these four energies; bytes: x, predicted and the gradient, and
 * what is kept of the rest groom. */
static const double strand_operations = 7560, strand_bytes = VERTICES * 4.0 * (3 + 3 + 2 * 3 + 8);

static void energies_of(bench *b, int64_t count)
{
    static const char *const four[] = { "stretch", "bend_twist", "gravity", "inertia" };
    scene s;
    make_scene(b, &s, count);
    strands side[4] = { 0 }; /* compiled, interpreter, two apart, one thread */
    for (int k = 0; k < 4; k++)
        side[k] = (strands){ .ctx = b->ctx[k < 3],
                             .n = k == 2 ? 2 : 1,
                             .frame = &s.frame[k < 3],
                             .x = s.x[k < 3],
                             .gradient = s.gradient[k < 3] };
    side[0].physics[0] = make(b->ctx[1], 4, four, &s.data, HG_BACKEND_AUTO);
    if (!b->device) side[1].physics[0] = make(b->ctx[1], 4, four, &s.data, HG_BACKEND_INTERPRETER);
    for (int k = 0; k < 2; k++) side[2].physics[k] = make(b->ctx[1], 1, four + k, &s.data, HG_BACKEND_AUTO);
    side[3].physics[0] = make(b->ctx[0], 4, four, &s.data, HG_BACKEND_AUTO);
    const int64_t shape[4] = { 1, count, VERTICES, 3 };
    bench_write(b, "rest", HG_F64, 3, shape + 1, s.rest);
    bench_write_tensor(b, "x", s.x[1]);
    bench_write_tensor(b, "predicted", s.predicted[1]);
    bench_peer *peer = bench_peer_start(b, "energies", 150);

    const int bits = same_bits(&s, &side[3], &side[0]);
    double ms;
    for (int k = b->device ? 2 : 1; k < 3; k++) evaluate(&side[k], &ms, 1);
    int64_t state[3];
    bench_steady_begin(b, state);
    bench_side race[5] = { { "compiled", evaluate, &side[0] }, { "two apart", evaluate, &side[2] } };
    int n = 2, interpreted = -1, eager = -1, compiled = -1;
    if (!b->device) race[interpreted = n++] = (bench_side){ "interpreter", evaluate, &side[1] };
    if (bench_peer_has(peer, "eager")) race[eager = n++] = bench_peer_side(peer, "eager", "PyTorch eager");
    if (bench_peer_has(peer, "compile")) race[compiled = n++] = bench_peer_side(peer, "compile", "torch.compile");
    bench_race(b, n, race, count > 10000 ? 5 : 9);
    const int steady = bench_steady(b, state);
    bench_result r = { .operations = strand_operations * (double)count,
                       .bytes = strand_bytes * (double)count,
                       .same_bits = bits,
                       .steady = steady };
    snprintf(r.row, sizeof r.row, "four strand energies, %lld", (long long)count);
    for (int k = 0; k < (interpreted < 0 ? 1 : 2); k++) {
        snprintf(r.ours, sizeof r.ours, "%s", hg_physics_backend_name(side[k].physics[0]));
        r.ours_ms = race[k ? interpreted : 0].median;
        r.aim = k == 0 ? 100 : 25;
        r.other_ms = eager >= 0 ? race[eager].median : 0;
        snprintf(r.other, sizeof r.other, "%s", eager >= 0 ? "PyTorch eager" : "");
        snprintf(r.note, sizeof r.note, "%s", bench_peer_text(peer));
        bench_add(b, &r);
    }
    snprintf(r.ours, sizeof r.ours, "%s", hg_physics_backend_name(side[0].physics[0]));
    r.ours_ms = race[0].median;
    r.note[0] = 0;
    if (compiled >= 0) {
        r.aim = 0;
        r.other_ms = race[compiled].median;
        snprintf(r.other, sizeof r.other, "torch.compile");
        bench_add(b, &r);
    }
    r.aim = 1;
    r.other_ms = race[1].median;
    snprintf(r.other, sizeof r.other, "stretch and bend_twist apart");
    bench_add(b, &r);
    bench_peer_end(peer);
    for (int k = 0; k < 4; k++)
        for (int i = 0; i < side[k].n; i++) hg_physics_destroy(side[k].physics[i]);
    free_scene(&s);
}

void bench_energies(bench *b)
{
    energies_of(b, 3000);
    energies_of(b, 30000);
}

void bench_chain(bench *b)
{
    static const char *const names[] = { "bend_twist", "bend_twist_chain" };
    bench_result r = { .row = "bend_twist_chain", .ours = "chain", .other = "direct", .aim = 1.3, .at_most = true };
    if (!hg_find("energy", names[1])) {
        snprintf(r.note, sizeof r.note, "there is no bend_twist_chain in this build");
        r.same_bits = r.steady = -1;
        bench_add(b, &r);
        return;
    }
    scene s;
    make_scene(b, &s, 3000);
    strands side[3] = { 0 };
    for (int k = 0; k < 3; k++) {
        const int c = k < 2;
        side[k] = (strands){ .ctx = b->ctx[c],
                             .n = 1,
                             .frame = &s.frame[c],
                             .x = s.x[c],
                             .gradient = s.gradient[c],
                             .physics = { make(b->ctx[c], 1, &names[k > 0], &s.data, HG_BACKEND_AUTO) } };
    }
    r.same_bits = same_bits(&s, &side[2], &side[1]);
    int64_t state[3];
    double ms;
    evaluate(&side[0], &ms, 1);
    bench_steady_begin(b, state);
    bench_side race[2] = { { "direct", evaluate, &side[0] }, { "chain", evaluate, &side[1] } };
    bench_race(b, 2, race, 15);
    r.steady = bench_steady(b, state);
    r.ours_ms = race[1].median;
    r.other_ms = race[0].median;
    r.ratio = r.ours_ms / r.other_ms;
    r.bytes = VERTICES * 4.0 * (3 + 2 * 3 + 8) * 3000;
    snprintf(r.note, sizeof r.note, "%s against %s", hg_physics_backend_name(side[1].physics[0]),
             hg_physics_backend_name(side[0].physics[0]));
    bench_add(b, &r);
    for (int k = 0; k < 3; k++) hg_physics_destroy(side[k].physics[0]);
    free_scene(&s);
}

/* Any energy of strands by itself: what a kernel of its own gains over the interpreter. */
void bench_energy(bench *b, const char *name)
{
    scene s;
    make_scene(b, &s, 3000);
    for (int c = 0; c < 2; c++) s.frame[c].previous = s.predicted[c];
    strands side[3] = { 0 }; /* compiled, interpreter (on a GPU: the same again), compiled on one thread */
    for (int k = 0; k < 3; k++)
        side[k] = (strands){ .ctx = b->ctx[k < 2],
                             .n = 1,
                             .frame = &s.frame[k < 2],
                             .x = s.x[k < 2],
                             .gradient = s.gradient[k < 2],
                             .physics = { make(b->ctx[k < 2], 1, &name, &s.data,
                                               k == 1 && !b->device ? HG_BACKEND_INTERPRETER : HG_BACKEND_AUTO) } };
    bench_result r = { .same_bits = same_bits(&s, &side[2], &side[0]) };
    int64_t state[3];
    double ms;
    evaluate(&side[1], &ms, 1);
    bench_steady_begin(b, state);
    bench_side race[2] = { { "compiled", evaluate, &side[0] }, { "interpreter", evaluate, &side[1] } };
    bench_race(b, 2, race, 9);
    r.steady = bench_steady(b, state);
    r.ours_ms = race[0].median;
    r.other_ms = race[1].median;
    snprintf(r.row, sizeof r.row, "%s, 3000 strands", name);
    snprintf(r.ours, sizeof r.ours, "%s", hg_physics_backend_name(side[0].physics[0]));
    snprintf(r.other, sizeof r.other, "%s", b->device ? "itself" : "interpreter");
    bench_add(b, &r);
    for (int k = 0; k < 3; k++) hg_physics_destroy(side[k].physics[0]);
    free_scene(&s);
}
