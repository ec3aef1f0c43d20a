/* Clips on another body, and grooms on another head: the identities that must hold, on the procedural bust and on the
 * real files of ../shared/data where they are. */
#include "tests/small_files.h"

#include "geometry/vector.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>

#include <cmocka.h>

static const char *data(const char *name)
{
    static char paths[4][1024];
    static int next;
    char *path = paths[next++ % 4];
    const char *source = getenv("HG_SOURCE");
    snprintf(path, sizeof paths[0], "%s/../shared/data/%s", source ? source : ".", name);
    if (!hg_file_exists(path)) skip();
    return path;
}

static void ok(hg_status status)
{
    if (status != HG_OK) fail_msg("%s: %s", hg_status_name(status), hg_message());
}

static hg_ctx *make_ctx(int threads)
{
    hg_ctx *ctx = NULL;
    ok(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = threads, .seed = 1 }));
    return ctx;
}

static hg_body *real_body(void)
{
    hg_body *body;
    char folder[1024];
    snprintf(folder, sizeof folder, "%s", data("bodies/makehuman/base.obj"));
    *strstr(folder, "/makehuman/base.obj") = '\0';
    ok(hg_body_read_makehuman(NULL, &body, folder, "cmu_mb"));
    return body;
}

static int find(const hg_clip *clip, const char *name)
{
    for (int j = 0; j < clip->joints; j++)
        if (!strcmp(clip->name[j], name)) return j;
    fail_msg("no joint %s", name);
    return -1;
}

static hg_quatd clip_global(const hg_clip *clip, int64_t frame, int joint)
{
    hg_quatd turn = hg_quatd_identity();
    for (int j = joint; j >= 0; j = clip->parent[j])
        turn = hg_quatd_mul(hg_quatd_load(clip->rotation + 4 * (frame * clip->joints + j)), turn);
    return turn;
}

static hg_quatd motion_global(const hg_motion *motion, const hg_body *body, int64_t frame, int joint)
{
    hg_quatd turn = hg_quatd_identity();
    for (int j = joint; j >= 0; j = body->parent[j]) {
        const float *q = motion->rotation + 4 * (frame * motion->joints + j);
        turn = hg_quatd_mul(hg_quatd_normalize(hg_quatd_from_f(hg_quatf_load(q))), turn);
    }
    return turn;
}

static double turn_between(hg_quatd a, hg_quatd b)
{
    hg_quatd turn = hg_quatd_mul(hg_quatd_conj(a), b);
    return 2 * atan2(hg_vec3d_norm(hg_quatd_vector(turn)), fabs(turn.w)) * 180 / 3.14159265358979323846;
}

static hg_vec3d body_bone(const hg_body *body, const char *from, const char *to)
{
    const float *a = body->joint + 3 * hg_body_joint(body, from), *b = body->joint + 3 * hg_body_joint(body, to);
    return hg_vec3d_normalize(
        hg_vec3d_make((double)b[0] - (double)a[0], (double)b[1] - (double)a[1], (double)b[2] - (double)a[2]));
}

/* ---- motion -------------------------------------------------------------------------------------------------- */

static void small_clip_moves_the_bust(void **state)
{
    (void)state;
    hg_body *body;
    hg_clip *clip;
    hg_motion *motion;
    ok(hg_bust_create(&body));
    ok(hg_clip_read_bvh(&clip, small_write_text("c.bvh", small_bvh)));
    ok(hg_clip_retarget(&motion, clip, body, 120));
    assert_int_equal(motion->frames, 2);
    assert_int_equal(motion->joints, body->joints);
    assert_true(motion->rate == 120);
    for (int64_t t = 0; t < 2; t++) {
        hg_quatd from = clip_global(clip, t, find(clip, "Head")),
                 to = motion_global(motion, body, t, hg_body_joint(body, "Head"));
        assert_true(turn_between(from, to) < 1e-4);
    }
    hg_motion_destroy(motion);
    /* other rates: the duration stays */
    ok(hg_clip_retarget(&motion, clip, body, 1000));
    assert_true(motion->rate == 1000 && motion->frames == 9);
    hg_motion_destroy(motion);
    assert_int_equal(hg_clip_retarget(&motion, clip, body, 0), HG_INVALID);
    assert_int_equal(hg_clip_retarget(&motion, clip, body, (double)NAN), HG_INVALID);
    clip->name[find(clip, "Head")][0] = 'X';
    assert_int_equal(hg_clip_retarget(&motion, clip, body, 30), HG_INVALID);
    assert_non_null(strstr(hg_message(), "Head"));
    assert_null(motion);
    hg_clip_destroy(clip);
    hg_body_destroy(body);
}

typedef struct {
    const char *asf, *clip;
    double low, high;
} clip_row; /* where the lowest vertex of half of the frames is */
static const clip_row clips[] = {
    { "motions/cmu-asfamc/01.asf", "motions/cmu-asfamc/01_01.amc", -0.03, 0.05 },
    { "motions/cmu-asfamc/02.asf", "motions/cmu-asfamc/02_05.amc", -0.02, 0.03 },
    { "motions/cmu-asfamc/11.asf", "motions/cmu-asfamc/11_01.amc", -0.02, 0.03 },
    { "motions/cmu-asfamc/07-walk.asf", "motions/cmu-asfamc/07_05-walk.amc", -0.06,
      0.03 }, /* a floor that is not level */
    { NULL, "motions/cmu-bvh/01_01.bvh", -0.03, 0.05 },
    { NULL, "motions/cmu-bvh/102_01cc.bvh", -0.05, 0.01 },
};

static hg_clip *read_clip(const clip_row *row)
{
    hg_clip *clip;
    ok(row->asf ? hg_clip_read_amc(&clip, data(row->asf), data(row->clip)) : hg_clip_read_bvh(&clip, data(row->clip)));
    return clip;
}

static int compare(const void *a, const void *b)
{
    return (*(const double *)a > *(const double *)b) - (*(const double *)a < *(const double *)b);
}

static void feet_stand_on_the_floor(void **state)
{
    (void)state;
    hg_body *body = real_body();
    hg_ctx *ctx = make_ctx(2);
    hg_poser *poser;
    ok(hg_poser_create(&poser, body, false));
    float *vertices = hg_alloc((size_t)body->vertices, 3 * sizeof *vertices);
    assert_non_null(vertices);
    for (size_t i = 0; i < sizeof clips / sizeof *clips; i++) {
        hg_clip *clip = read_clip(&clips[i]);
        hg_motion *motion;
        ok(hg_clip_retarget(&motion, clip, body, 30));
        double lowest[1000];
        int count = 0;
        for (int64_t t = 0; t < motion->frames && count < 1000; t += 4) {
            ok(hg_pose(ctx, poser, NULL, motion, t, vertices, NULL, NULL));
            double low = 9;
            for (int64_t v = 0; v < body->vertices; v++) low = fmin(low, (double)vertices[3 * v + 1]);
            lowest[count++] = low;
        }
        qsort(lowest, (size_t)count, sizeof *lowest, compare);
        print_message("%s: lowest vertex, quartiles %.1f %.1f %.1f cm\n", clips[i].clip, 100 * lowest[count / 4],
                      100 * lowest[count / 2], 100 * lowest[3 * count / 4]);
        assert_true(lowest[count / 2] > clips[i].low && lowest[count / 2] < clips[i].high);
        hg_motion_destroy(motion);
        hg_clip_destroy(clip);
    }
    hg_free(vertices);
    hg_poser_destroy(poser);
    hg_ctx_destroy(ctx);
    hg_body_destroy(body);
}

/* Trunk and head turn as in the clip; arms and legs point where the clip's point; feet are as flat as the clip's. */
static void bones_point_as_in_the_clip(void **state)
{
    (void)state;
    hg_body *body = real_body();
    hg_clip *clip = read_clip(&clips[0]);
    hg_motion *motion;
    ok(hg_clip_retarget(&motion, clip, body, 30));
    assert_int_equal(motion->frames, 688);
    static const char *const same[][2] = { { "Hips", "root" },       { "LowerBack", "lowerback" },
                                           { "Spine", "upperback" }, { "Spine1", "thorax" },
                                           { "Neck", "lowerneck" },  { "Neck1", "upperneck" },
                                           { "Head", "head" },       { "LeftShoulder", "lclavicle" } };
    static const char *const along[][4] = {
        { "LeftArm", "LeftForeArm", "lhumerus", "lradius" },   { "LeftForeArm", "LeftHand", "lradius", "lwrist" },
        { "RightArm", "RightForeArm", "rhumerus", "rradius" }, { "RightForeArm", "RightHand", "rradius", "rwrist" },
        { "LeftUpLeg", "LeftLeg", "lfemur", "ltibia" },        { "LeftLeg", "LeftFoot", "ltibia", "lfoot" },
        { "RightUpLeg", "RightLeg", "rfemur", "rtibia" },      { "RightLeg", "RightFoot", "rtibia", "rfoot" },
    };
    double worst_turn = 0, worst_bone = 0, worst_sole = 0, worst_place = 0;
    for (int64_t t = 0; t < motion->frames; t += 7) {
        for (size_t i = 0; i < sizeof same / sizeof *same; i++)
            worst_turn = fmax(worst_turn, turn_between(motion_global(motion, body, t, hg_body_joint(body, same[i][0])),
                                                       clip_global(clip, 4 * t, find(clip, same[i][1]))));
        for (size_t i = 0; i < sizeof along / sizeof *along; i++) {
            hg_vec3d to = hg_quatd_rotate(motion_global(motion, body, t, hg_body_joint(body, along[i][0])),
                                          body_bone(body, along[i][0], along[i][1]));
            hg_vec3d bone = hg_vec3d_normalize(hg_vec3d_load(clip->offset + 3 * find(clip, along[i][3])));
            worst_bone =
                fmax(worst_bone,
                     hg_vec3d_distance(to, hg_quatd_rotate(clip_global(clip, 4 * t, find(clip, along[i][2])), bone)));
        }
        hg_vec3d sole =
            hg_quatd_rotate(motion_global(motion, body, t, hg_body_joint(body, "LeftFoot")), hg_vec3d_make(0, -1, 0));
        hg_vec3d shin = hg_vec3d_normalize(hg_vec3d_load(clip->offset + 3 * find(clip, "lfoot")));
        worst_sole = fmax(
            worst_sole, hg_vec3d_distance(sole, hg_quatd_rotate(clip_global(clip, 4 * t, find(clip, "lfoot")), shin)));
        worst_place = fmax(worst_place, fabs((double)motion->translation[3 * t + 1]));
    }
    assert_true(worst_turn < 1e-3 && worst_bone < 1e-5 && worst_sole < 1e-5);
    assert_true(worst_place < 2); /* [m] */
    /* every fourth frame, bit for bit */
    hg_motion *all;
    ok(hg_clip_retarget(&all, clip, body, 120));
    assert_int_equal(all->frames, 2751);
    for (int64_t t = 0; t < motion->frames; t++) {
        assert_memory_equal(motion->translation + 3 * t, all->translation + 12 * t, 3 * sizeof(float));
        for (int64_t i = 0; i < 4 * motion->joints; i++)
            assert_true(fabsf(motion->rotation[4 * t * motion->joints + i]) ==
                        fabsf(all->rotation[16 * t * motion->joints + i]));
    }
    for (int64_t i = 0; i < (all->frames - 1) * all->joints; i++) { /* the short way from frame to frame */
        hg_quatf a = hg_quatf_load(all->rotation + 4 * i), b = hg_quatf_load(all->rotation + 4 * (i + all->joints));
        assert_true(hg_quatf_dot(a, b) >= 0);
    }
    hg_motion_destroy(all);
    hg_motion_destroy(motion);
    hg_clip_destroy(clip);
    hg_body_destroy(body);
}

/* ---- grooms -------------------------------------------------------------------------------------------------- */

static void roots_lie_on_the_scalp(const hg_groom *groom, const hg_body *body)
{
    for (int64_t s = 0; s < groom->strands; s++) {
        int32_t face = groom->root_face[s];
        bool scalp = false;
        for (int64_t i = 0; i < body->scalp_faces && !scalp; i++) scalp = body->scalp[i] == face;
        assert_true(scalp);
        for (int k = 0; k < 3; k++) {
            double at = 0;
            for (int c = 0; c < 3; c++)
                at += (double)groom->root_bary[3 * s + c] *
                      (double)body->points[3 * (int64_t)body->triangles[3 * (int64_t)face + c] + k];
            assert_true(fabs(at - (double)groom->points[3 * s * groom->vertices + k]) < 1e-6);
            assert_true(groom->root_bary[3 * s + k] >= 0);
        }
        assert_true(groom->root_uv[2 * s] > 0 && groom->root_uv[2 * s] < 1 && groom->root_uv[2 * s + 1] > 0 &&
                    groom->root_uv[2 * s + 1] < 1);
    }
}

/* A grown groom, taken away by a similarity, comes back; so does one that was pushed into the head. */
static void grown_groom_comes_back(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(2);
    hg_body *body;
    hg_groom *groom, *away;
    ok(hg_bust_create(&body));
    ok(hg_groom_grow(ctx, &groom, body, "wavy", 400, 16, 3));
    ok(hg_groom_create(&away, groom->strands, groom->vertices));
    hg_quatd turn = hg_quatd_from_rotation_vector(hg_vec3d_make(0.3, -0.2, 0.5));
    hg_similarity back = { .scale = 0.8, .translation = { 0.1, -0.2, 0.3 } };
    hg_quatd_store(back.rotation, turn);
    int64_t count = groom->strands * groom->vertices;
    for (int64_t i = 0; i < count; i++) {
        hg_vec3d x =
            hg_vec3d_sub(hg_vec3d_from_f(hg_vec3f_load(groom->points + 3 * i)), hg_vec3d_load(back.translation));
        x = hg_vec3d_scale(hg_quatd_rotate(hg_quatd_conj(turn), x), 1 / back.scale);
        hg_vec3f_store(away->points + 3 * i, hg_vec3f_from_d(x));
    }
    hg_fit_report report;
    ok(hg_fit_groom(ctx, away, body, &back, &report));
    assert_true(report.moved_max < 1e-4 && report.moved_far == 0);
    roots_lie_on_the_scalp(away, body);
    assert_true(away->body_hash == hg_body_hash(body));
    assert_true(report.inside_after == 0);
    double worst = 0;
    for (int64_t s = 0; s < groom->strands; s++)
        worst = fmax(worst, (double)hg_vec3f_distance(hg_vec3f_load(away->points + 3 * s * 16),
                                                      hg_vec3f_load(groom->points + 3 * s * 16)));
    assert_true(worst < 1e-4);

    /* the same bits with one thread and two */
    hg_ctx *one = make_ctx(1);
    hg_groom *deep[2];
    for (int i = 0; i < 2; i++) {
        ok(hg_groom_create(&deep[i], groom->strands, groom->vertices));
        for (int64_t k = 0; k < 3 * count; k++) /* straight into the skull from half the length on */
            deep[i]->points[k] =
                groom->points[k] + (k % 3 == 2 && k / 3 % 16 > 8 && groom->points[k] < 0 ? 0.02F : 0.0F);
        ok(hg_fit_groom(i ? ctx : one, deep[i], body, NULL, &report));
        assert_true(report.inside_after <= report.inside_before);
        assert_true(report.inside_after == 0);
    }
    assert_memory_equal(deep[0]->points, deep[1]->points, (size_t)count * 3 * sizeof(float));
    for (int i = 0; i < 2; i++) hg_groom_destroy(deep[i]);

    hg_similarity bad = { .scale = 0 };
    assert_int_equal(hg_fit_groom(ctx, away, body, &bad, NULL), HG_INVALID);
    int64_t faces = body->scalp_faces;
    body->scalp_faces = 0;
    assert_int_equal(hg_fit_groom(ctx, away, body, NULL, NULL), HG_INVALID);
    assert_non_null(strstr(hg_message(), "no scalp"));
    body->scalp_faces = faces;
    away->points[0] = NAN;
    assert_int_equal(hg_fit_groom(ctx, away, body, NULL, NULL), HG_NUMERIC);
    hg_groom_destroy(away);
    hg_groom_destroy(groom);
    hg_body_destroy(body);
    hg_ctx_destroy(one);
    hg_ctx_destroy(ctx);
}

/* The body's own head, smaller and elsewhere, is brought back to where it was. */
static void similarity_of_the_same_head_is_found(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(2);
    hg_body *body;
    hg_groom *groom;
    ok(hg_bust_create(&body));
    ok(hg_groom_grow(ctx, &groom, body, "short", 600, 8, 3));
    float *head = hg_alloc((size_t)body->vertices, 3 * sizeof *head);
    assert_non_null(head);
    for (int64_t i = 0; i < 3 * body->vertices; i++) head[i] = body->points[i] * 1.25F + (float)(i % 3) * 0.1F;
    for (int64_t i = 0; i < 3 * groom->strands * groom->vertices; i++)
        groom->points[i] = groom->points[i] * 1.25F + (float)(i % 3) * 0.1F;
    hg_similarity found;
    ok(hg_fit_similarity(ctx, body, body->vertices, head, groom, &found));
    print_message("similarity of the bust with itself: %.5f (0.8), %.5f (0), %.5f (-0.08), %.5f (-0.16)\n", found.scale,
                  found.translation[0], found.translation[1], found.translation[2]);
    assert_true(fabs(found.scale - 0.8) < 4e-3);
    for (int k = 0; k < 3; k++) { /* where it puts the centre of the scalp */
        double at = found.scale * (body->scalp_centre[k] * 1.25 + k * 0.1) + found.translation[k];
        assert_true(fabs(at - body->scalp_centre[k]) < 1e-3);
    }
    for (int64_t i = 0; i < 3 * body->vertices; i++) head[i] += 100;
    assert_int_equal(hg_fit_similarity(ctx, body, body->vertices, head, groom, &found), HG_INVALID);
    assert_non_null(strstr(hg_message(), "same unit"));
    hg_free(head);
    hg_groom_destroy(groom);
    hg_body_destroy(body);
    hg_ctx_destroy(ctx);
}

static void sintel_on_the_real_head(void **state)
{
    (void)state;
    hg_body *body = real_body();
    hg_ctx *ctx = make_ctx(2);
    hg_curves *curves;
    hg_groom *groom;
    hg_groom_report read;
    ok(hg_curves_read(&curves, data("grooms/sintel-16pt/SintelHairOriginal-sintel_hair.16points.tfx")));
    ok(hg_groom_from_curves(&groom, curves, 25, &read));
    assert_true(read.strands == 11400 && read.kept == 11400);
    hg_mesh *bust;
    ok(hg_mesh_read_obj(&bust, data("grooms/sintel-16pt/sintel.obj")));
    assert_true(bust->vertices == 3046 && bust->faces == 5952);
    hg_similarity found, measured = { 0.923147, { 1, 0, 0, 0 }, { 0, -0.689840, 0.047239 } };
    ok(hg_fit_similarity(ctx, body, bust->vertices, bust->points, groom, &found));
    const double head[3] = { 0, 1.55, 0 };
    double apart = 0;
    for (int k = 0; k < 3; k++)
        apart = fmax(apart, fabs(found.scale * head[k] + found.translation[k] - measured.scale * head[k] -
                                 measured.translation[k]));
    print_message("similarity %.6f, %.6f %.6f %.6f: %.2f mm from the measured one\n", found.scale, found.translation[0],
                  found.translation[1], found.translation[2], 1e3 * apart);
    assert_true(fabs(found.scale - measured.scale) < 3e-3 && apart < 1e-3);

    hg_fit_report report;
    ok(hg_fit_groom(ctx, groom, body, &measured, &report));
    double vertices = (double)(groom->strands * (groom->vertices - 1));
    print_message("moved median %.2f p95 %.2f max %.1f mm, %lld far; inside %.2f %% -> %.3f %%\n",
                  1e3 * report.moved_median, 1e3 * report.moved_p95, 1e3 * report.moved_max,
                  (long long)report.moved_far, 100 * (double)report.inside_before / vertices,
                  100 * (double)report.inside_after / vertices);
    assert_true(fabs(report.moved_median - 2.8e-3) < 1e-4 && fabs(report.moved_p95 - 5.7e-3) < 1e-4 &&
                report.moved_far == 96);
    assert_true(fabs(100 * (double)report.inside_before / vertices - 6.9) < 0.1);
    assert_true(report.inside_after == 0);
    roots_lie_on_the_scalp(groom, body);
    double least = (double)INFINITY, most = 0, mean = 0;
    for (int64_t s = 0; s < groom->strands; s++) {
        double length = 0;
        for (int64_t v = 1; v < groom->vertices; v++) {
            const float *at = groom->points + 3 * (s * groom->vertices + v);
            length += (double)hg_vec3f_distance(hg_vec3f_load(at), hg_vec3f_load(at - 3));
        }
        least = fmin(least, length);
        most = fmax(most, length);
        mean += length / (double)groom->strands;
    }
    print_message("lengths %.0f / %.0f / %.0f mm\n", 1e3 * least, 1e3 * mean, 1e3 * most);
    assert_true(least > 0.020 && fabs(mean - 0.095) < 2e-3 && most < 0.24);
    hg_mesh_destroy(bust);
    hg_curves_destroy(curves);
    hg_groom_destroy(groom);
    hg_ctx_destroy(ctx);
    hg_body_destroy(body);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(small_clip_moves_the_bust),
        cmocka_unit_test(feet_stand_on_the_floor),
        cmocka_unit_test(bones_point_as_in_the_clip),
        cmocka_unit_test(grown_groom_comes_back),
        cmocka_unit_test(similarity_of_the_same_head_is_found),
        cmocka_unit_test(sintel_on_the_real_head),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
