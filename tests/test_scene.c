/* Tests of scene/: files that come back as they were, files that lie, strands of equal arc length, posing. */
#include "geometry/vector.h"
#include "scene/scene.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#define OK(call)                                                                                                       \
    do {                                                                                                               \
        hg_status ok_ = (call);                                                                                        \
        if (ok_ != HG_OK) fail_msg("%s: %s", #call, hg_message());                                                     \
    } while (0)

/* It fails, and the sentence has this in it. */
#define FAILS(call, text)                                                                                              \
    do {                                                                                                               \
        assert_int_not_equal((call), HG_OK);                                                                           \
        if (!strstr(hg_message(), text)) fail_msg("%s: \"%s\" is not in \"%s\"", #call, text, hg_message());           \
    } while (0)

#define NEAR(a, b, tolerance)                                                                                          \
    do {                                                                                                               \
        double a_ = (double)(a), b_ = (double)(b);                                                                     \
        if (!(fabs(a_ - b_) <= (tolerance))) fail_msg("%s is %.9g, expected %.9g", #a, a_, b_);                        \
    } while (0)

static hg_ctx *ctx;
static hg_body *bust;
static char folder[] = "/tmp/hairgrad_test_scene_XXXXXX";

static const char *in_folder(const char *name)
{
    static char paths[4][256]; /* the last four stay */
    static int last;
    last = (last + 1) % 4;
    snprintf(paths[last], sizeof paths[last], "%s/%s", folder, name);
    return paths[last];
}

static int set_up(void **state)
{
    (void)state;
    if (!mkdtemp(folder)) return 1;
    return hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .seed = 1 }) != HG_OK || hg_bust_create(&bust) != HG_OK;
}

static int tear_down(void **state)
{
    (void)state;
    hg_body_destroy(bust);
    hg_ctx_destroy(ctx);
    char *command = hg_format("rm -r %s", folder);
    int status = system(command);
    hg_free(command);
    return status;
}

static hg_vec3d point(const float *p) { return hg_vec3d_make((double)p[0], (double)p[1], (double)p[2]); }

static double random_at(uint64_t stream, uint64_t i) { return 2 * hg_random_uniform(7, stream, i) - 1; }

/* ---- strands ------------------------------------------------------------------------------------------------ */

static hg_curves *curves_make(int64_t strands, const int64_t *counts)
{
    hg_curves *curves = hg_alloc(1, sizeof *curves);
    curves->strands = strands;
    curves->start = hg_alloc((size_t)strands + 1, sizeof *curves->start);
    for (int64_t s = 0; s < strands; s++) curves->start[s + 1] = curves->start[s] + counts[s];
    curves->points = hg_alloc((size_t)curves->start[strands], 3 * sizeof *curves->points);
    return curves;
}

/* A circle of radius 1 given by uneven points: 25 vertices are on it, as far apart as they should be. */
static void test_resampling_follows_a_circle(void **state)
{
    (void)state;
    enum { N = 19, V = 25 };
    const double step = 4.5 / (V - 1);
    hg_curves *curves = curves_make(1, (int64_t[]){ N });
    for (int i = 0; i < N; i++) {
        double a = 4.5 * pow((double)i / (N - 1), 1.3);
        curves->points[3 * i] = (float)cos(a), curves->points[3 * i + 1] = (float)sin(a), curves->points[3 * i + 2] = 3;
    }
    hg_groom *groom;
    OK(hg_groom_from_curves(&groom, curves, V, NULL));
    for (int v = 0; v < V; v++) {
        const float *p = groom->points + 3 * v;
        double a = step * v;
        NEAR(hypot((double)p[0], (double)p[1]), 1, 5e-4);
        NEAR(hypot((double)p[0] - cos(a), (double)p[1] - sin(a)), 0, 2e-3);
        NEAR(p[2], 3, 1e-6);
        if (v == 0) continue;
        double chord = hg_vec3d_distance(point(p), point(p - 3));
        NEAR(chord, 2 * sin(0.5 * step), 5e-4);
    }
    /* both ends stay */
    for (int c = 0; c < 3; c++) {
        assert_true(groom->points[c] == curves->points[c]);
        assert_true(groom->points[3 * (V - 1) + c] == curves->points[3 * (N - 1) + c]);
    }
    hg_groom_destroy(groom);
    hg_curves_destroy(curves);
}

/* A straight line stays straight, and its vertices are evenly spaced to rounding. */
static void test_resampling_keeps_lines(void **state)
{
    (void)state;
    hg_curves *curves = curves_make(2, (int64_t[]){ 2, 5 });
    const float way[3] = { 0.3f, -0.4f, 1.2f }, at[7] = { 0, 1, 0, 0.05f, 0.1f, 0.6f, 1 };
    for (int i = 0; i < 7; i++)
        for (int c = 0; c < 3; c++) curves->points[3 * i + c] = at[i] * way[c];
    hg_groom *groom;
    OK(hg_groom_from_curves(&groom, curves, 9, NULL));
    for (int s = 0; s < 2; s++)
        for (int v = 0; v < 9; v++)
            for (int c = 0; c < 3; c++)
                NEAR(groom->points[3 * (9 * s + v) + c], way[c] * (float)v / 8, s ? 2e-3 : 1e-6);
    hg_groom_destroy(groom);
    hg_curves_destroy(curves);
}

static void test_broken_strands_are_counted(void **state)
{
    (void)state;
    hg_curves *curves = curves_make(7, (int64_t[]){ 3, 1, 0, 4, 2, 3, 3 });
    for (int64_t i = 0; i < 3 * curves->start[7]; i++) curves->points[i] = (float)i * 0.01f;
    float *same = curves->points + 3 * curves->start[3]; /* four equal points */
    for (int i = 3; i < 12; i++) same[i] = same[i - 3];
    curves->points[3 * curves->start[4] + 1] = NAN;
    curves->points[3 * curves->start[5]] = INFINITY;
    float *doubled = curves->points + 3 * curves->start[6]; /* kept: a repeated point is one point */
    for (int c = 0; c < 3; c++) doubled[3 + c] = doubled[c];
    hg_groom *groom;
    hg_groom_report report;
    OK(hg_groom_from_curves(&groom, curves, 5, &report));
    assert_int_equal(report.strands, 7);
    assert_int_equal(report.kept, 2);
    assert_int_equal(report.bald, 2);
    assert_int_equal(report.zero_length, 1);
    assert_int_equal(report.non_finite, 2);
    assert_int_equal(groom->strands, 2);
    for (int i = 0; i < 2 * 5 * 3; i++) assert_true(isfinite(groom->points[i]));
    hg_groom_destroy(groom);
    for (int64_t i = 0; i < 3 * curves->start[7]; i++) curves->points[i] = NAN;
    FAILS(hg_groom_from_curves(&groom, curves, 5, &report), "no strand is left of 7");
    assert_null(groom);
    FAILS(hg_groom_from_curves(&groom, curves, 1, NULL), "no strand is left");
    FAILS(hg_groom_create(&groom, 3, 1), "2 to 65536 vertices");
    hg_curves_destroy(curves);
}

/* ---- files -------------------------------------------------------------------------------------------------- */

static hg_groom *small_groom(void)
{
    hg_groom *groom;
    OK(hg_groom_grow(ctx, &groom, bust, "wavy", 40, 8, 3));
    return groom;
}

static void test_files_come_back(void **state)
{
    (void)state;
    hg_groom *groom = small_groom(), *groom_again;
    OK(hg_groom_save(groom, in_folder("groom.h5")));
    OK(hg_groom_load(&groom_again, in_folder("groom.h5")));
    assert_int_equal(groom->strands, groom_again->strands);
    assert_true(hg_groom_hash(groom) == hg_groom_hash(groom_again));
    assert_true(groom_again->body_hash == hg_body_hash(bust));
    assert_string_equal(groom->name, groom_again->name);
    groom_again->points[5] += 1e-3f;
    assert_true(hg_groom_hash(groom) != hg_groom_hash(groom_again));

    hg_body *again;
    OK(hg_body_save(bust, in_folder("body.h5")));
    OK(hg_body_load(&again, in_folder("body.h5")));
    assert_true(hg_body_hash(bust) == hg_body_hash(again));
    for (int64_t j = 0; j < bust->joints; j++) assert_string_equal(bust->joint_name[j], again->joint_name[j]);
    for (int k = 0; k < HG_SHAPES; k++) {
        assert_string_equal(bust->shape_name[k], again->shape_name[k]);
        assert_true(bust->shape_spread[k] == again->shape_spread[k]);
    }
    assert_memory_equal(bust->scalp_axis, again->scalp_axis, sizeof bust->scalp_axis);
    assert_memory_equal(bust->uv, again->uv, (size_t)bust->vertices * 2 * sizeof *bust->uv);

    hg_motion *motion, *motion_again;
    OK(hg_motion_make(&motion, bust, "turn", 2, 30, 5));
    OK(hg_motion_save(motion, in_folder("motion.h5")));
    OK(hg_motion_load(&motion_again, in_folder("motion.h5"), bust));
    assert_int_equal(motion->frames, motion_again->frames);
    assert_true(motion->rate == motion_again->rate);
    assert_memory_equal(motion->rotation, motion_again->rotation,
                        (size_t)(motion->frames * motion->joints * 4) * sizeof *motion->rotation);
    assert_memory_equal(motion->translation, motion_again->translation,
                        (size_t)(motion->frames * 3) * sizeof *motion->translation);
    hg_groom_destroy(groom);
    hg_groom_destroy(groom_again);
    hg_body_destroy(again);
    hg_motion_destroy(motion);
    hg_motion_destroy(motion_again);
}

/* A groom written in centimetres with Z up is read in metres with Y up. */
static void test_units_and_axes(void **state)
{
    (void)state;
    const float cm[12] = { 1, 2, 3, 1, 2, 4, 5, 6, 7, 5, 6, 9 }; /* two strands of two vertices */
    int64_t two = 2;
    hg_h5 *file;
    OK(hg_h5_create(&file, in_folder("cm.h5")));
    OK(hg_h5_set_text(file, "/", "format", "hairgrad groom"));
    OK(hg_h5_set_text(file, "/", "unit", "cm"));
    OK(hg_h5_set_text(file, "/", "up_axis", "+Z"));
    OK(hg_h5_write(file, "/strands", HG_F32, 3, (int64_t[]){ 2, 2, 3 }, cm));
    OK(hg_h5_write(file, "/root_face", HG_I32, 1, &two, (int32_t[]){ -1, -1 }));
    OK(hg_h5_write(file, "/root_barycentric", HG_F32, 2, (int64_t[]){ 2, 3 }, (float[6]){ 0 }));
    OK(hg_h5_write(file, "/root_uv", HG_F32, 2, (int64_t[]){ 2, 2 }, (float[4]){ 0 }));
    OK(hg_h5_commit(file));
    hg_groom *groom;
    OK(hg_groom_load(&groom, in_folder("cm.h5")));
    const double expected[6] = { 0.01, 0.03, -0.02, 0.01, 0.04, -0.02 };
    for (int i = 0; i < 6; i++) NEAR(groom->points[i], expected[i], 1e-8);
    hg_groom_destroy(groom);
}

/* A groom file as somebody else would write it, with something wrong in it. */
static void write_groom(const char *unit, int64_t strands, int64_t vertices, float bad, int32_t face, float weight,
                        int64_t uvs)
{
    hg_h5 *file;
    float *points = hg_alloc((size_t)(strands * vertices), 3 * sizeof *points);
    float *bary = hg_alloc((size_t)strands, 3 * sizeof *bary), *uv = hg_alloc((size_t)uvs, 2 * sizeof *uv);
    int32_t *faces = hg_alloc((size_t)strands, sizeof *faces);
    for (int64_t i = 0; i < strands * vertices * 3; i++) points[i] = (float)(i + 1) * 0.01f;
    for (int64_t s = 0; s < strands; s++) bary[3 * s] = weight, faces[s] = face;
    if (strands * vertices > 1) points[4] = bad;
    OK(hg_h5_create(&file, in_folder("bad.h5")));
    OK(hg_h5_set_text(file, "/", "format", "hairgrad groom"));
    OK(hg_h5_set_text(file, "/", "unit", unit));
    OK(hg_h5_write(file, "/strands", HG_F32, 3, (int64_t[]){ strands, vertices, 3 }, points));
    OK(hg_h5_write(file, "/root_face", HG_I32, 1, &strands, faces));
    OK(hg_h5_write(file, "/root_barycentric", HG_F32, 2, (int64_t[]){ strands, 3 }, bary));
    OK(hg_h5_write(file, "/root_uv", HG_F32, 2, (int64_t[]){ uvs, 2 }, uv));
    OK(hg_h5_commit(file));
    hg_free(points);
    hg_free(bary);
    hg_free(uv);
    hg_free(faces);
}

static void test_lying_grooms(void **state)
{
    (void)state;
    hg_groom *groom;
    char path[256];
    snprintf(path, sizeof path, "%s/bad.h5", folder);
    FAILS(hg_groom_load(&groom, in_folder("nothing.h5")), "nothing.h5");
    OK(hg_file_write(path, "not HDF5 at all", 15));
    FAILS(hg_groom_load(&groom, path), "bad.h5");
    OK(hg_body_save(bust, path));
    FAILS(hg_groom_load(&groom, path), "it is a hairgrad body, expected a hairgrad groom");
    write_groom("m", 3, 4, 0.5f, 0, 1, 3);
    OK(hg_groom_load(&groom, path));
    hg_groom_destroy(groom);
    write_groom("furlong", 3, 4, 0.5f, 0, 1, 3);
    FAILS(hg_groom_load(&groom, path), "unit");
    write_groom("m", 3, 4, NAN, 0, 1, 3);
    FAILS(hg_groom_load(&groom, path), "strand 0, vertex 1 is not finite");
    write_groom("m", 3, 1, 0.5f, 0, 1, 3);
    FAILS(hg_groom_load(&groom, path), "[3,1,3]");
    write_groom("m", 3, 4, 0.5f, -7, 1, 3);
    FAILS(hg_groom_load(&groom, path), "root face -7");
    write_groom("m", 3, 4, 0.5f, 0, 2, 3);
    FAILS(hg_groom_load(&groom, path), "barycentrics (2, 0, 0)");
    write_groom("m", 3, 4, 0.5f, 0, 1, 2);
    FAILS(hg_groom_load(&groom, path), "root_uv");
    assert_null(groom);

    /* nothing is written over a file when the groom is not good */
    write_groom("m", 3, 4, 0.5f, 0, 1, 3);
    OK(hg_groom_load(&groom, path));
    groom->points[0] = NAN;
    FAILS(hg_groom_save(groom, path), "not finite");
    groom->points[0] = 0;
    OK(hg_groom_save(groom, path));
    for (int c = 0; c < 12; c++) groom->points[c] = 1;
    FAILS(hg_groom_save(groom, path), "strand 0 has no length");
    FAILS(hg_groom_save(groom, "/nowhere/at/all.h5"), "strand 0 has no length");
    hg_groom_destroy(groom);
    OK(hg_groom_load(&groom, path));
    FAILS(hg_groom_save(groom, "/nowhere/at/all.h5"), "/nowhere/at");
    hg_groom_destroy(groom);
    OK(hg_groom_create(&groom, 0, 4));
    FAILS(hg_groom_save(groom, path), "without strands");
    hg_groom_destroy(groom);
}

/* Every cut of a good file is an error, not a crash. */
static void test_truncated_files(void **state)
{
    (void)state;
    hg_groom *groom = small_groom();
    hg_motion *motion;
    hg_body *body;
    void *bytes;
    size_t size;
    OK(hg_groom_save(groom, in_folder("whole.h5")));
    hg_groom_destroy(groom);
    OK(hg_file_read(in_folder("whole.h5"), &bytes, &size));
    for (int i = 0; i < 40; i++) {
        OK(hg_file_write(in_folder("cut.h5"), bytes, size * (size_t)i / 40));
        assert_int_not_equal(hg_groom_load(&groom, in_folder("cut.h5")), HG_OK);
        assert_int_not_equal(hg_body_load(&body, in_folder("cut.h5")), HG_OK);
        assert_int_not_equal(hg_motion_load(&motion, in_folder("cut.h5"), NULL), HG_OK);
    }
    hg_free(bytes);
}

static void test_lying_bodies(void **state)
{
    (void)state;
    hg_body *b, *loaded;
    const char *path = in_folder("body.h5");
    OK(hg_body_save(bust, path));
    OK(hg_body_load(&b, path));
#define BREAK(what, value, text)                                                                                       \
    do {                                                                                                               \
        __typeof__(what) kept_ = what;                                                                                 \
        what = value;                                                                                                  \
        FAILS(hg_body_save(b, path), text);                                                                            \
        what = kept_;                                                                                                  \
    } while (0)
    BREAK(b->points[7], NAN, "points");
    BREAK(b->triangles[30], (int32_t)b->vertices, "triangles: entry 30");
    BREAK(b->triangles[30], -1, "triangles: entry 30");
    BREAK(b->parent[3], 5, "has parent 5");
    BREAK(b->parent[3], -1, "has parent -1");
    BREAK(b->parent[0], 0, "the first joint");
    BREAK(b->joint_name[2], b->joint_name[4], "two joints");
    BREAK(b->joint[4], INFINITY, "joint");
    BREAK(b->influence[9], (int32_t)b->joints, "influence: entry 9");
    BREAK(b->weight[8], 5, "the weights of vertex 1");
    BREAK(b->weight[8], -1, "negative weight");
    BREAK(b->shapes[100], NAN, "shapes");
    BREAK(b->joint_shapes[10], NAN, "joint_shapes");
    BREAK(b->shape_spread[2], NAN, "shape_spread");
    BREAK(b->scalp_faces, 0, "no scalp");
    BREAK(b->scalp[1], b->scalp[0], "ascending");
    BREAK(b->scalp[b->scalp_faces - 1], (int32_t)b->faces, "scalp: entry");
    BREAK(b->collider_faces, 0, "collider");
    BREAK(b->scalp_axis[1], NAN, "scalp_axis");
#undef BREAK
    OK(hg_body_load(&loaded, path)); /* the good one is still there */
    assert_true(hg_body_hash(loaded) == hg_body_hash(bust));
    hg_body_destroy(loaded);
    hg_body_destroy(b);
}

static void test_motions_of_other_joints(void **state)
{
    (void)state;
    hg_motion *motion, *loaded;
    const char *path = in_folder("motion.h5");
    OK(hg_motion_make(&motion, bust, "nod", 1, 30, 1));
    char *head = motion->joint_name[6];
    assert_string_equal(head, "Head");
    motion->joint_name[6] = hg_strdup("Skull");
    OK(hg_motion_save(motion, path));
    FAILS(hg_motion_load(&loaded, path, bust), "missing Head; extra Skull");
    OK(hg_motion_load(&loaded, path, NULL));
    hg_motion_destroy(loaded);

    /* the same joints in another order are brought into the body's */
    hg_free(motion->joint_name[6]);
    motion->joint_name[6] = motion->joint_name[4], motion->joint_name[4] = head;
    for (int64_t t = 0; t < motion->frames; t++)
        for (int k = 0; k < 4; k++) {
            float *a = motion->rotation + 4 * (t * motion->joints + 4) + k, *b = a + 8, held = *a;
            *a = *b, *b = held;
        }
    OK(hg_motion_save(motion, path));
    OK(hg_motion_load(&loaded, path, bust));
    int64_t frame = 4 * 15 * motion->joints;
    assert_string_equal(loaded->joint_name[6], "Head");
    assert_memory_equal(loaded->rotation + frame + 24, motion->rotation + frame + 16, 4 * sizeof(float));
    assert_memory_equal(loaded->rotation + frame + 16, motion->rotation + frame + 24, 4 * sizeof(float));
    hg_motion_destroy(loaded);

    motion->rotation[8] = 3;
    FAILS(hg_motion_save(motion, path), "unit quaternion");
    motion->rotation[8] = NAN;
    FAILS(hg_motion_save(motion, path), "not finite");
    hg_motion_destroy(motion);
    FAILS(hg_motion_make(&motion, bust, "shaek", 1, 30, 1), "did you mean shake?");
    FAILS(hg_motion_make(&motion, bust, "nod", 1, 0, 1), "positive");
}

/* ---- frame rates -------------------------------------------------------------------------------------------- */

static void test_other_frame_rates(void **state)
{
    (void)state;
    hg_motion *motion, *third, *half, *more;
    OK(hg_motion_make(&motion, bust, "shake", 2, 120, 4));
    OK(hg_motion_resample(&third, motion, 30));
    assert_int_equal(third->frames, 61);
    int64_t row = 4 * motion->joints;
    for (int64_t t = 0; t < third->frames; t++)
        assert_memory_equal(third->rotation + t * row, motion->rotation + 4 * t * row, (size_t)row * sizeof(float));
    OK(hg_motion_resample(&half, motion, 48));
    for (int64_t i = 0; i < half->frames * half->joints; i++)
        NEAR(hg_quatf_norm(hg_quatf_load(half->rotation + 4 * i)), 1, 1e-6);
    hg_motion_destroy(third);
    hg_motion_destroy(half);
    hg_motion_destroy(motion);

    /* half way between a turn and one more, given with the other sign, is the turn between */
    OK(hg_motion_create(&motion, 2, bust, 10));
    hg_quatd a = hg_quatd_from_axis_angle(hg_vec3d_make(0, 1, 0), 0.4),
             b = hg_quatd_from_axis_angle(hg_vec3d_make(0, 1, 0), 1.0);
    hg_quatf_store(motion->rotation, hg_quatf_from_d(a));
    hg_quatf_store(motion->rotation + row, hg_quatf_from_d(hg_quatd_neg(b)));
    motion->translation[3] = 1;
    OK(hg_motion_resample(&more, motion, 20));
    assert_int_equal(more->frames, 3);
    hg_quatd between = hg_quatd_from_axis_angle(hg_vec3d_make(0, 1, 0), 0.7);
    hg_quatd got = hg_quatd_from_f(hg_quatf_load(more->rotation + row));
    NEAR(fabs(hg_quatd_dot(between, got)), 1, 1e-7);
    NEAR(more->translation[3], 0.5, 1e-7);
    FAILS(hg_motion_resample(&third, motion, -1), "frames per second");
    hg_motion_destroy(motion);
    hg_motion_destroy(more);
}

/* ---- posing ------------------------------------------------------------------------------------------------- */

static float *new_floats(int64_t n)
{
    float *memory = hg_alloc((size_t)n, sizeof *memory);
    assert_non_null(memory);
    return memory;
}

/* Turning the root joint alone turns everything about it as one. */
static void test_a_rigid_turn_is_rigid(void **state)
{
    (void)state;
    hg_motion *motion;
    hg_poser *poser;
    hg_groom *groom = small_groom();
    hg_quatd turn = hg_quatd_normalize(hg_quatd_make(0.3, -0.5, 0.7, 0.2));
    hg_vec3d way = hg_vec3d_make(0.3, -1, 2), pivot = point(bust->joint);
    OK(hg_motion_create(&motion, 1, bust, 30));
    hg_quatf_store(motion->rotation, hg_quatf_from_d(hg_quatd_neg(turn))); /* -q is the same turn */
    hg_vec3f_store(motion->translation, hg_vec3f_from_d(way));
    float *x = new_floats(3 * bust->vertices), *joints = new_floats(3 * bust->joints),
          *turns = new_floats(4 * bust->joints);
    float *rotation = new_floats(4 * groom->strands), *position = new_floats(3 * groom->strands);
    float *strands = new_floats(3 * groom->strands * groom->vertices);
    OK(hg_poser_create(&poser, bust, false));
    assert_int_equal(hg_poser_vertices(poser), bust->vertices);
    OK(hg_pose(ctx, poser, NULL, motion, 0, x, joints, turns));
    for (int64_t v = 0; v < bust->vertices; v++) {
        hg_vec3d rest = hg_vec3d_sub(point(bust->points + 3 * v), pivot);
        hg_vec3d expected = hg_vec3d_add(hg_vec3d_add(pivot, way), hg_quatd_rotate(turn, rest));
        NEAR(hg_vec3d_distance(expected, point(x + 3 * v)), 0, 2e-6);
    }
    for (int64_t j = 0; j < bust->joints; j++) {
        hg_vec3d rest = hg_vec3d_sub(point(bust->joint + 3 * j), pivot);
        hg_vec3d expected = hg_vec3d_add(hg_vec3d_add(pivot, way), hg_quatd_rotate(turn, rest));
        NEAR(hg_vec3d_distance(expected, point(joints + 3 * j)), 0, 1e-6);
        NEAR(fabs(hg_quatd_dot(turn, hg_quatd_from_f(hg_quatf_load(turns + 4 * j)))), 1, 1e-6);
    }
    OK(hg_pose_roots(ctx, poser, groom, NULL, 0, x, rotation, position));
    hg_pose_strands(ctx, groom->strands, groom->vertices, groom->points, rotation, position, strands);
    for (int64_t s = 0; s < groom->strands; s++) {
        hg_quatd got = hg_quatd_from_f(hg_quatf_load(rotation + 4 * s));
        NEAR(fabs(hg_quatd_dot(turn, got)), 1, 1e-6);
        assert_true(got.w >= 0);
        for (int64_t v = 0; v < groom->vertices; v++) {
            int64_t i = 3 * (s * groom->vertices + v);
            hg_vec3d rest = hg_vec3d_sub(point(groom->points + i), pivot);
            hg_vec3d expected = hg_vec3d_add(hg_vec3d_add(pivot, way), hg_quatd_rotate(turn, rest));
            NEAR(hg_vec3d_distance(expected, point(strands + i)), 0, 2e-5);
        }
    }
    hg_free(x), hg_free(joints), hg_free(turns), hg_free(rotation), hg_free(position), hg_free(strands);
    hg_poser_destroy(poser);
    hg_motion_destroy(motion);
    hg_groom_destroy(groom);
}

/* Against the formula, joint by joint, with a shape: x = sum of w (R (rest - joint) + posed joint). */
static void test_skinning_blends(void **state)
{
    (void)state;
    enum { J = 11 };
    hg_motion *motion;
    hg_poser *poser;
    double shape[HG_SHAPES];
    hg_vec3d rest[J], at[J];
    hg_quatd turn[J];
    assert_int_equal(bust->joints, J);
    OK(hg_motion_create(&motion, 2, bust, 30));
    for (int k = 0; k < HG_SHAPES; k++) shape[k] = 0.8 * random_at(1, (uint64_t)k);
    for (int j = 0; j < J; j++) {
        hg_vec3d r = hg_vec3d_make(random_at(2, (uint64_t)j), random_at(3, (uint64_t)j), random_at(4, (uint64_t)j));
        hg_quatd local = hg_quatd_from_rotation_vector(r);
        hg_quatf_store(motion->rotation + 4 * (J + j), hg_quatf_from_d(local));
        rest[j] = point(bust->joint + 3 * j);
        for (int k = 0; k < HG_SHAPES; k++)
            rest[j] = hg_vec3d_add_scaled(rest[j], shape[k], point(bust->joint_shapes + 3 * (k * J + j)));
        int parent = bust->parent[j];
        turn[j] = parent < 0 ? local : hg_quatd_mul(turn[parent], local);
        at[j] = parent < 0
                    ? rest[j]
                    : hg_vec3d_add(at[parent], hg_quatd_rotate(turn[parent], hg_vec3d_sub(rest[j], rest[parent])));
    }
    float *x = new_floats(3 * bust->vertices), *joints = new_floats(3 * J), *part = new_floats(3 * bust->vertices);
    OK(hg_poser_create(&poser, bust, false));
    OK(hg_pose(ctx, poser, shape, motion, 99, x, joints, NULL)); /* clamped to the last frame */
    int blended = 0;
    for (int64_t v = 0; v < bust->vertices; v++) {
        hg_vec3d p = point(bust->points + 3 * v), expected = { 0 };
        for (int k = 0; k < HG_SHAPES; k++)
            p = hg_vec3d_add_scaled(p, shape[k], point(bust->shapes + 3 * (k * bust->vertices + v)));
        for (int k = 0; k < HG_INFLUENCES; k++) {
            int j = bust->influence[HG_INFLUENCES * v + k];
            double w = (double)bust->weight[HG_INFLUENCES * v + k];
            hg_vec3d moved = hg_vec3d_add(at[j], hg_quatd_rotate(turn[j], hg_vec3d_sub(p, rest[j])));
            expected = hg_vec3d_add_scaled(expected, w, moved);
            blended += w > 0.2 && w < 0.8;
        }
        NEAR(hg_vec3d_distance(expected, point(x + 3 * v)), 0, 2e-6);
    }
    assert_true(blended > 100);
    for (int j = 0; j < J; j++) NEAR(hg_vec3d_distance(at[j], point(joints + 3 * j)), 0, 1e-6);

    /* the same with fewer vertices, and again with one thread: to the bit */
    hg_poser *few;
    hg_ctx *one;
    OK(hg_ctx_create(&one, &(hg_ctx_options){ .threads = 1 }));
    hg_body kept = *bust;
    kept.collider_faces /= 4, kept.scalp_faces /= 2;
    OK(hg_poser_create(&few, &kept, true));
    int64_t n = hg_poser_vertices(few), faces;
    assert_true(n > 100 && n < bust->vertices);
    OK(hg_pose(one, few, shape, motion, 1, part, NULL, NULL));
    const int32_t *vertex = hg_poser_vertex(few), *collider = hg_poser_collider(few, &faces);
    for (int64_t v = 0; v < n; v++) assert_memory_equal(part + 3 * v, x + 3 * (int64_t)vertex[v], 3 * sizeof(float));
    assert_int_equal(faces, kept.collider_faces);
    for (int64_t f = 0; f < faces; f++)
        for (int c = 0; c < 3; c++)
            assert_int_equal(vertex[collider[3 * f + c]], bust->triangles[3 * (int64_t)bust->collider[f] + c]);
    /* another shape, and back: nothing of it is left */
    OK(hg_pose(one, few, NULL, motion, 1, part, NULL, NULL));
    assert_true(memcmp(part, x + 3 * (int64_t)vertex[0], 3 * sizeof(float)) != 0);
    OK(hg_pose(one, few, shape, motion, 1, part, NULL, NULL));
    assert_memory_equal(part, x + 3 * (int64_t)vertex[0], 3 * sizeof(float));

    shape[3] = NAN;
    FAILS(hg_pose(ctx, poser, shape, motion, 0, x, NULL, NULL), "shape 3");
    motion->joints = 3;
    FAILS(hg_pose(ctx, poser, NULL, motion, 0, x, NULL, NULL), "3 joints");
    motion->joints = J;
    hg_free(x), hg_free(joints), hg_free(part);
    hg_poser_destroy(poser);
    hg_poser_destroy(few);
    hg_ctx_destroy(one);
    hg_motion_destroy(motion);
}

/* At rest the groom is where it was; a squashed triangle turns nothing; a root off the scalp is an error. */
static void test_root_frames(void **state)
{
    (void)state;
    hg_groom *groom = small_groom();
    hg_poser *poser;
    OK(hg_poser_create(&poser, bust, false));
    float *x = new_floats(3 * bust->vertices), *rotation = new_floats(4 * groom->strands);
    float *position = new_floats(3 * groom->strands), *strands = new_floats(3 * groom->strands * groom->vertices);
    OK(hg_pose(ctx, poser, NULL, NULL, 0, x, NULL, NULL));
    for (int64_t i = 0; i < 3 * bust->vertices; i++) NEAR(x[i], bust->points[i], 1e-6);
    OK(hg_pose_roots(ctx, poser, groom, NULL, 0, bust->points, rotation, position));
    hg_pose_strands(ctx, groom->strands, groom->vertices, groom->points, rotation, position, strands);
    for (int64_t i = 0; i < 3 * groom->strands * groom->vertices; i++) NEAR(strands[i], groom->points[i], 2e-6);

    /* a shape turns roots only a little, and posed roots lie on their triangles */
    OK(hg_pose(ctx, poser, (double[HG_SHAPES]){ 1, -1, 1 }, NULL, 0, x, NULL, NULL));
    int32_t chosen[2] = { 5, 3 };
    OK(hg_pose_roots(ctx, poser, groom, chosen, 2, x, rotation, position));
    for (int i = 0; i < 2; i++) {
        int64_t s = chosen[i];
        const int32_t *t = bust->triangles + 3 * (int64_t)groom->root_face[s];
        hg_vec3d p = { 0 };
        for (int c = 0; c < 3; c++)
            p = hg_vec3d_add_scaled(p, (double)groom->root_bary[3 * s + c], point(x + 3 * (int64_t)t[c]));
        NEAR(hg_vec3d_distance(p, point(position + 3 * i)), 0, 1e-6);
        assert_true(rotation[4 * i] > 0.98f && rotation[4 * i] <= 1);
    }

    const int32_t *t = bust->triangles + 3 * (int64_t)groom->root_face[0];
    for (int c = 0; c < 3; c++) x[3 * (int64_t)t[1] + c] = x[3 * (int64_t)t[0] + c]; /* edge of no length */
    OK(hg_pose_roots(ctx, poser, groom, (int32_t[]){ 0 }, 1, x, rotation, position));
    assert_true(rotation[0] == 1 && rotation[1] == 0 && rotation[2] == 0 && rotation[3] == 0);
    for (int c = 0; c < 3; c++) assert_true(isfinite(position[c]));

    FAILS(hg_pose_roots(ctx, poser, groom, (int32_t[]){ 99 }, 1, x, rotation, position), "strand 99");
    groom->root_face[2] = -1;
    FAILS(hg_pose_roots(ctx, poser, groom, NULL, 0, x, rotation, position), "strand 2 has its root on face -1");
    groom->root_face[2] = (int32_t)bust->faces;
    FAILS(hg_pose_roots(ctx, poser, groom, NULL, 0, x, rotation, position), "bind the groom");
    hg_free(x), hg_free(rotation), hg_free(position), hg_free(strands);
    hg_poser_destroy(poser);
    hg_groom_destroy(groom);
}

static void test_posed_scene_file(void **state)
{
    (void)state;
    hg_groom *groom = small_groom();
    hg_motion *motion;
    OK(hg_motion_make(&motion, bust, "shake", 1, 30, 2));
    hg_posed_scene scene = { .body = bust, .groom = groom, .motion = motion, .first = 10, .frames = 4 };
    OK(hg_posed_scene_write(ctx, &scene, in_folder("posed.h5"), NULL));
    hg_h5 *file;
    float *strands, *vertices, *x = new_floats(3 * bust->vertices);
    hg_poser *poser;
    OK(hg_h5_open(&file, in_folder("posed.h5")));
    OK(hg_h5_read(file, "/strands", HG_F32, 4, (int64_t[]){ 4, 40, 8, 3 }, NULL, (void **)&strands));
    OK(hg_h5_read(file, "/body_vertices", HG_F32, 3, (int64_t[]){ 4, bust->vertices, 3 }, NULL, (void **)&vertices));
    hg_h5_close(file);
    OK(hg_poser_create(&poser, bust, false));
    OK(hg_pose(ctx, poser, NULL, motion, 12, x, NULL, NULL));
    assert_memory_equal(x, vertices + 3 * 2 * bust->vertices, (size_t)bust->vertices * 3 * sizeof *x);
    hg_free(strands), hg_free(vertices), hg_free(x);
    hg_poser_destroy(poser);

    scene.frames = 0, scene.groom = NULL; /* to the end, the body alone */
    OK(hg_posed_scene_write(ctx, &scene, in_folder("posed.h5"), NULL));
    scene.frames = 40;
    FAILS(hg_posed_scene_write(ctx, &scene, in_folder("posed.h5"), NULL), "frames 10 to 49 of a motion of 31");
    scene.frames = 0, scene.groom = groom, groom->body_hash++;
    FAILS(hg_posed_scene_write(ctx, &scene, in_folder("posed.h5"), NULL), "bound to another body");
    hg_motion_destroy(motion);
    hg_groom_destroy(groom);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_resampling_follows_a_circle),
        cmocka_unit_test(test_resampling_keeps_lines),
        cmocka_unit_test(test_broken_strands_are_counted),
        cmocka_unit_test(test_files_come_back),
        cmocka_unit_test(test_units_and_axes),
        cmocka_unit_test(test_lying_grooms),
        cmocka_unit_test(test_truncated_files),
        cmocka_unit_test(test_lying_bodies),
        cmocka_unit_test(test_motions_of_other_joints),
        cmocka_unit_test(test_other_frame_rates),
        cmocka_unit_test(test_a_rigid_turn_is_rigid),
        cmocka_unit_test(test_skinning_blends),
        cmocka_unit_test(test_root_frames),
        cmocka_unit_test(test_posed_scene_file),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
