/* Speed of what looks for neighbours: the closest triangle of a body, self collision and adhesion, f32, on a bumpy
 * sphere of 26,000 triangles with strands of 25 vertices around it. Medians per evaluation and per vertex.
 *
 *     bench_contact [threads] [strands] [rounds] */
#include "geometry/vector.h"
#include "hairloss/hairloss.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { VERTICES = 25, RINGS = 114, AROUND = 115, MAX_ROUNDS = 1000 };

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e3 * (double)t.tv_sec + 1e-6 * (double)t.tv_nsec;
}

static int order(const void *a, const void *b)
{
    const double p = *(const double *)a, q = *(const double *)b;
    return (p > q) - (p < q);
}

static double median(double *values, int n)
{
    qsort(values, (size_t)n, sizeof *values, order);
    return values[n / 2];
}

static void check(hg_status status)
{
    if (status == HG_OK) return;
    fprintf(stderr, "%s\n", hg_message());
    exit(1);
}

static hg_vec3d on_sphere(double theta, double phi)
{
    double r = 0.1 * (1.0 + 0.05 * sin(9.0 * theta) * cos(7.0 * phi));
    return hg_vec3d_make(r * sin(theta) * cos(phi), r * cos(theta), -r * sin(theta) * sin(phi));
}

static void make_body(double *vertices, int32_t *faces, int64_t *n_faces)
{
    const double pi = 3.14159265358979323846;
    for (int r = 0; r < RINGS; r++)
        for (int k = 0; k < AROUND; k++) /* the rings next to the poles are small holes' rims: an open body */
            hg_vec3d_store(vertices + 3 * (r * AROUND + k),
                           on_sphere(pi * (r + 1) / (RINGS + 1), 2.0 * pi * k / AROUND));
    *n_faces = 0;
    for (int r = 0; r + 1 < RINGS; r++)
        for (int k = 0; k < AROUND; k++) {
            int32_t a = r * AROUND + k, b = r * AROUND + (k + 1) % AROUND, c = a + AROUND, d = b + AROUND;
            int32_t two[6] = { a, c, b, b, c, d };
            for (int i = 0; i < 6; i++) faces[6 * (r * AROUND + k) + i] = two[i];
            *n_faces += 2;
        }
}

/* Wavy strands that leave the upper half and fall along it. */
static void make_strands(double *rest, int64_t strands)
{
    for (int64_t s = 0; s < strands; s++) {
        double theta = acos(1.0 - hg_random_uniform(1, 1, (uint64_t)s)),
               phi = 6.2831853 * hg_random_uniform(1, 2, (uint64_t)s);
        double phase = 6.2831853 * hg_random_uniform(1, 3, (uint64_t)s);
        for (int v = 0; v < VERTICES; v++) {
            double t = (double)v / (VERTICES - 1), lift = 1.0 + 0.25 * sin(2.2 * t) + 0.02 * sin(12.0 * t + phase);
            hg_vec3d at = on_sphere(theta + 0.9 * t, phi + 0.1 * sin(9.0 * t + phase));
            hg_vec3d_store(rest + 3 * (s * VERTICES + v), hg_vec3d_scale(at, lift));
        }
    }
}

int main(int n, char **arguments)
{
    const int threads = n > 1 ? atoi(arguments[1]) : 0, wanted = n > 3 ? atoi(arguments[3]) : 21;
    const int64_t strands = n > 2 ? atoll(arguments[2]) : 3000, points = strands * VERTICES;
    const int rounds = wanted < 1 ? 1 : wanted > MAX_ROUNDS ? MAX_ROUNDS : wanted;
    static double times[4][MAX_ROUNDS], body[3 * RINGS * AROUND];
    static float moved[3 * RINGS * AROUND];
    static int32_t faces[6 * RINGS * AROUND];
    int64_t n_faces;
    hg_ctx *ctx;
    check(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = threads, .seed = 1 }));
    make_body(body, faces, &n_faces);
    for (int i = 0; i < 3 * RINGS * AROUND; i++) moved[i] = (float)body[i];
    double *rest = hg_alloc(3 * (size_t)points, sizeof *rest);
    int32_t *triangle = hg_alloc((size_t)points, sizeof *triangle);
    if (!rest || !triangle) return 1;
    make_strands(rest, strands);

    hg_body_tree *tree;
    hg_body_refit *refit;
    check(hg_body_tree_create(&tree, RINGS * AROUND, body, n_faces, faces));
    check(hg_body_refit_create(&refit, tree, HG_F32));
    const hg_groom_data data = { .grooms = 1, .strands = strands, .vertices = VERTICES, .rest = rest };
    const hg_term self = { hg_energy_find("self_collision"), 1.0, NULL, NULL };
    const hg_term near = { hg_energy_find("adhesion"), 1.0, NULL, NULL };
    hg_physics *physics[2];
    check(hg_physics_create(&physics[0], ctx, HG_F32, &self, 1, &data));
    check(hg_physics_create(&physics[1], ctx, HG_F32, &near, 1, &data));
    const int64_t shape[4] = { 1, strands, VERTICES, 3 };
    hg_tensor *x = hg_tensor_create(ctx, HG_F32, 4, shape), *gradient = hg_tensor_create(ctx, HG_F32, 4, shape);
    hg_tensor *point = hg_tensor_create(ctx, HG_F32, 4, shape), *normal = hg_tensor_create(ctx, HG_F32, 4, shape);
    if (!x || !gradient || !point || !normal) return 1;
    for (int64_t i = 0; i < 3 * points; i++)
        ((float *)x->data)[i] = (float)(rest[i] + 0.001 * hg_random_normal(1, 4, (uint64_t)i));
    for (int64_t i = 0; i < points; i++) triangle[i] = -1;
    const hg_frame frame = { .dt = 1.0 / 30.0 };
    for (int round = 0; round < rounds; round++) {
        double start = now(), unweighted;
        check(hg_body_refit_update(ctx, refit, moved));
        times[0][round] = now() - start;
        start = now();
        check(
            hg_body_closest(ctx, refit, HG_CONTACT_EXACT, 0.01, points, x->data, triangle, point->data, normal->data));
        times[1][round] = now() - start;
        for (int k = 0; k < 2; k++) {
            start = now();
            check(hg_physics_evaluate(physics[k], ctx, &frame, x, &unweighted, NULL, gradient));
            times[2 + k][round] = now() - start;
        }
    }
    static const char *const names[4] = { "body refit", "body closest, reach 1 cm", "self_collision with gradient",
                                          "adhesion with gradient" };
    printf("%lld vertices, %lld triangles, %d threads, medians of %d\n", (long long)points, (long long)n_faces,
           hg_ctx_threads(ctx), rounds);
    for (int k = 0; k < 4; k++) {
        double ms = median(times[k], rounds);
        printf("%-30s %8.3f ms %8.3f us per vertex\n", names[k], ms, 1e3 * ms / (double)points);
    }
    hg_tensor *tensors[4] = { x, gradient, point, normal };
    for (int k = 0; k < 4; k++) hg_tensor_destroy(tensors[k]);
    for (int k = 0; k < 2; k++) hg_physics_destroy(physics[k]);
    hg_body_refit_destroy(refit);
    hg_body_tree_destroy(tree);
    hg_free(rest);
    hg_free(triangle);
    hg_ctx_destroy(ctx);
    return 0;
}
