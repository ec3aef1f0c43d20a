/* The gradient of an energy, a user's own too, against finite differences: on a few bent strands above a box, turned and
 * moved, with a last and a predicted frame, so that every known energy has something to act on. */
#include "hairloss/hairloss.h"

#include <math.h>

enum { frames = 2, strands = 6, vertices = 7, strand_count = frames * strands, vertex_count = strand_count * vertices };

typedef struct {
    double rest[strands * vertices * 3], mass[strands * vertices], distance[strands * vertices];
    double x[vertex_count * 3], predicted[vertex_count * 3], previous[vertex_count * 3];
    double rotation[strand_count * 4], position[strand_count * 3], body[frames * 8 * 3];
} scene;

static double noise(uint64_t stream, int i) { return 2.0 * hg_random_uniform(11, stream, (uint64_t)i) - 1.0; }

static void rotate(const double q[4], const double v[3], double out[3])
{
    const double t[3] = { 2 * (q[2] * v[2] - q[3] * v[1]), 2 * (q[3] * v[0] - q[1] * v[2]),
                          2 * (q[1] * v[1] - q[2] * v[0]) };
    out[0] = v[0] + q[0] * t[0] + q[2] * t[2] - q[3] * t[1];
    out[1] = v[1] + q[0] * t[1] + q[3] * t[0] - q[1] * t[2];
    out[2] = v[2] + q[0] * t[2] + q[1] * t[1] - q[2] * t[0];
}

static void make_rest(scene *s)
{
    const double edge = 4e-3;
    for (int i = 0; i < strands; i++) {
        double at[3] = { 2e-3 * noise(1, 3 * i), 2e-3 + 1e-3 * noise(1, 3 * i + 1), 2e-3 * noise(1, 3 * i + 2) };
        for (int v = 0; v < vertices; v++) {
            int k = i * vertices + v;
            double angle = 0.6 * v + 3.0 * noise(2, i);
            for (int c = 0; c < 3; c++) s->rest[3 * k + c] = at[c];
            s->mass[k] = 2.6e-8 * (1.0 + 0.3 * noise(3, k));
            s->distance[k] = at[1];
            at[0] += edge * (0.5 * cos(angle) + 0.1 * noise(4, k));
            at[1] += edge * (0.7 + 0.1 * noise(5, k));
            at[2] += edge * (0.5 * sin(angle) + 0.1 * noise(6, k));
        }
    }
}

static void make_frames(scene *s)
{
    const double edge = 4e-3;
    for (int i = 0; i < strand_count; i++) {
        const double *rest = s->rest + i % strands * vertices * 3;
        double *q = s->rotation + 4 * i, *p = s->position + 3 * i, length = 1.0;
        q[0] = 1.0;
        for (int c = 0; c < 3; c++) {
            q[c + 1] = 0.2 * noise(7, 3 * i + c);
            length += q[c + 1] * q[c + 1];
            p[c] = rest[c] + (c == 1 ? 0.0 : 1e-3) * noise(8, 3 * i + c);
        }
        for (int c = 0; c < 4; c++) q[c] /= sqrt(length);
        for (int v = 0; v < vertices; v++) {
            const double arm[3] = { rest[3 * v] - rest[0], rest[3 * v + 1] - rest[1], rest[3 * v + 2] - rest[2] };
            double turned[3];
            rotate(q, arm, turned);
            for (int c = 0; c < 3; c++) {
                int k = (i * vertices + v) * 3 + c;
                s->x[k] = p[c] + turned[c] + 0.1 * edge * noise(9, k);
                s->previous[k] = p[c] + turned[c] + 0.3 * edge * noise(10, k);
                s->predicted[k] = p[c] + turned[c] + 0.3 * edge * noise(11, k);
            }
        }
    }
    for (int i = 0; i < frames * 8; i++) /* a box whose upper face is y = 0 */
        for (int c = 0; c < 3; c++)
            s->body[3 * i + c] = c == 1 ? (i & 2 ? 0.0 : -0.1) : i & (c == 0 ? 1 : 4) ? 0.1 : -0.1;
}

/* Tensors that live as long as the check: the step is rewound between evaluations. */
static hg_tensor *keep(hg_ctx *ctx, int rank, const int64_t *shape, const double *values)
{
    hg_tensor *tensor = hg_tensor_create(ctx, HG_F64, rank, shape);
    if (tensor != NULL && hg_tensor_write(tensor, values) == HG_OK) return tensor;
    hg_tensor_destroy(tensor);
    return NULL;
}

typedef struct {
    hg_physics *physics;
    hg_frame frame;
} subject;

static hg_tensor *energy_of(void *self, hg_ctx *ctx, hg_tensor **in)
{
    subject *of = self;
    return hg_physics_energy(of->physics, ctx, &of->frame, in[0], NULL);
}

static hg_status check(hg_ctx *ctx, const scene *s, const hg_body_tree *body, const hg_energy *energy,
                       const char *const *options, const hg_gradcheck_options *how, hg_gradcheck_result *result)
{
    const hg_groom_attribute attributes[] = { { "body_distance", s->distance }, { "scalp_distance", s->distance } };
    const hg_groom_data data = { .grooms = 1,
                                 .strands = strands,
                                 .vertices = vertices,
                                 .rest = s->rest,
                                 .mass = s->mass,
                                 .attributes = attributes,
                                 .n_attributes = 2,
                                 .body = body };
    const hg_term term = { .energy = energy, .weight = 1.0, .options = options };
    const int64_t points[4] = { frames, strands, vertices, 3 }, rotation[3] = { frames, strands, 4 },
                  position[3] = { frames, strands, 3 }, corners[3] = { frames, 8, 3 };
    subject of = { NULL, { .dt = 1.0 / 30.0 } };
    hg_tensor *x = keep(ctx, 4, points, s->x);
    of.frame.root_rotation = keep(ctx, 3, rotation, s->rotation);
    of.frame.root_position = keep(ctx, 3, position, s->position);
    of.frame.predicted = keep(ctx, 4, points, s->predicted);
    of.frame.previous = keep(ctx, 4, points, s->previous);
    of.frame.body_vertices = keep(ctx, 3, corners, s->body);
    bool made = x != NULL && of.frame.root_rotation != NULL && of.frame.root_position != NULL &&
                of.frame.predicted != NULL && of.frame.previous != NULL && of.frame.body_vertices != NULL;
    hg_status status = made ? hg_physics_create(&of.physics, ctx, HG_F64, &term, 1, &data) : HG_MEMORY;
    hg_gradcheck_options given = how != NULL ? *how : (hg_gradcheck_options){ 0 };
    if (given.step <= 0.0) given.step = 1e-4; /* m: hair has edges of millimetres */
    if (status == HG_OK) status = hg_gradcheck(ctx, energy_of, &of, 1, &x, &given, result);
    hg_physics_destroy(of.physics);
    hg_step_reset(ctx);
    hg_tensor *all[] = {
        x, of.frame.root_rotation, of.frame.root_position, of.frame.predicted, of.frame.previous, of.frame.body_vertices
    };
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) hg_tensor_destroy(all[i]);
    return status;
}

hg_status hg_energy_gradcheck(hg_ctx *ctx, const hg_energy *energy, const char *const *options,
                              const hg_gradcheck_options *how, hg_gradcheck_result *result)
{
    static const int32_t faces[36] = { 0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4,
                                       2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5 };
    scene *s = hg_alloc(1, sizeof *s);
    if (s == NULL) return HG_MEMORY;
    make_rest(s);
    make_frames(s);
    hg_body_tree *body = NULL;
    hg_status status = hg_body_tree_create(&body, 8, s->body, 12, faces);
    if (status == HG_OK) status = check(ctx, s, body, energy, options, how, result);
    hg_body_tree_destroy(body);
    hg_free(s);
    return status;
}
