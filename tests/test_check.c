/* What `hairgrad check` finds: each kind of trouble is made here, found, and nothing else is. */
#include "export/export.h"
#include "tests/small_files.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>

#include <cmocka.h>

static void ok(hg_status status)
{
    if (status != HG_OK) fail_msg("%s: %s", hg_status_name(status), hg_message());
}

static hg_ctx *context(void)
{
    static hg_ctx *ctx;
    if (!ctx) ok(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .seed = 1 }));
    return ctx;
}

/* A finding of this severity and kind whose text holds these words. */
static void found(const hg_findings *findings, hg_severity severity, const char *about, const char *words)
{
    for (int i = 0; i < findings->n; i++)
        if (findings->list[i].severity == severity && !strcmp(findings->list[i].about, about) &&
            strstr(findings->list[i].text, words))
            return;
    for (int i = 0; i < findings->n; i++)
        print_message("%d %s: %s\n", (int)findings->list[i].severity, findings->list[i].about, findings->list[i].text);
    fail_msg("no finding \"%s\" with \"%s\"", about, words);
}

static hg_body *bust(void)
{
    static hg_body *body;
    if (!body) ok(hg_bust_create(&body));
    return body;
}

/* Straight hair on the bust. */
static hg_curves *hair(int64_t strands)
{
    hg_groom *groom;
    hg_curves *curves;
    ok(hg_groom_grow(context(), &groom, bust(), "straight", strands, 12, 3));
    ok(hg_groom_to_curves(&curves, groom));
    hg_groom_destroy(groom);
    return curves;
}

static void good_hair_is_fine(void **state)
{
    (void)state;
    hg_findings findings = { 0 };
    hg_curves *curves = hair(60);
    uint8_t problem[60];
    ok(hg_check_groom(context(), &findings, curves, bust(), problem));
    assert_int_equal(hg_findings_count(&findings, HG_WARNING), 0);
    assert_int_equal(hg_findings_count(&findings, HG_ERROR), 0);
    found(&findings, HG_FINE, "strands", "60 of 12 vertices");
    found(&findings, HG_FINE, "up", "+Y");
    found(&findings, HG_FINE, "roots", "0 by more than 1 cm");
    found(&findings, HG_FINE, "binding", "60 of 60");
    found(&findings, HG_FINE, "root_uv", "0.");
    for (int i = 0; i < 60; i++) assert_int_equal(problem[i], HG_STRAND_FINE);
    hg_image *image;
    ok(hg_problems_draw(context(), &image, curves, problem, bust(), 40, 50));
    assert_int_equal(image->width, 120);
    hg_image_destroy(image);
    hg_findings_free(&findings);
    hg_curves_destroy(curves);
}

static void units_are_doubted(void **state)
{
    (void)state;
    static const struct {
        double metres;
        const char *words;
    } units[] = { { 1, "" }, { 0.01, "(--unit cm)" }, { 0.0254, "(--unit inch)" }, { 0.001, "(--unit mm)" } };
    for (int i = 0; i < 4; i++) {
        hg_curves *curves = hair(60);
        hg_findings findings = { 0 };
        char text[160];
        hg_curves_from_world(curves, units[i].metres, false);
        assert_int_equal(hg_curves_in_metres(curves, text), i == 0);
        assert_non_null(strstr(text, units[i].words));
        ok(hg_check_groom(context(), &findings, curves, NULL, NULL));
        found(&findings, i ? HG_WARNING : HG_FINE, "unit", units[i].words);
        hg_findings_free(&findings);
        hg_curves_destroy(curves);
    }
    hg_curves *curves = hair(60);
    char text[160];
    hg_curves_from_world(curves, 1e4, false); /* a fiftieth of a millimetre */
    assert_false(hg_curves_in_metres(curves, text));
    assert_non_null(strstr(text, "in any unit"));
    hg_curves_destroy(curves);
}

static void axes_are_doubted(void **state)
{
    (void)state;
    hg_findings findings = { 0 };
    hg_curves *curves = hair(60);
    hg_curves_from_world(curves, 1, true);
    ok(hg_check_groom(context(), &findings, curves, NULL, NULL));
    found(&findings, HG_WARNING, "up",
          "strands point along -Z; with +Y up they would hang along -Y: it looks like +Z up (--up z)");
    hg_findings_free(&findings);
    hg_curves_destroy(curves);
}

static void bad_strands_are_found(void **state)
{
    (void)state;
    hg_findings findings = { 0 };
    hg_curves *curves = hair(60);
    uint8_t problem[60];
    float *p = curves->points;
    p[36 * 3 + 4] = NAN;
    for (int i = 3; i < 36; i++) p[36 * 7 + i] = p[36 * 7 + i % 3];        /* no length */
    memcpy(p + 36 * 20, p + 36 * 19, 36 * sizeof *p);                      /* the same strand */
    memcpy(p + 36 * 30, p + 36 * 29, 3 * sizeof *p);                       /* the same root */
    memcpy(p + 36 * 40 + 3 * 5, p + 36 * 40 + 3 * 4, 3 * sizeof *p);       /* the same vertex twice */
    for (int i = 0; i < 36; i++) p[36 * 50 + i] += i % 3 == 2 ? 0.05F : 0; /* 5 cm off */
    for (int k = 0; k < 3; k++) p[36 * 55 + 3 * 6 + k] = (float)bust()->scalp_centre[k];
    curves->root_face[10] = -1;
    curves->root_uv[0] = 1.5F;
    ok(hg_check_groom(context(), &findings, curves, bust(), problem));
    found(&findings, HG_FINE, "strands", "58 of 12 vertices");
    found(&findings, HG_WARNING, "dropped", "1 not finite, the first is strand 3");
    found(&findings, HG_WARNING, "dropped", "1 of zero length, the first is strand 7");
    found(&findings, HG_WARNING, "duplicates", "1 strands repeat another one, the first is strand 20");
    found(&findings, HG_WARNING, "duplicates", "1 more roots");
    found(&findings, HG_WARNING, "edges", "1 of zero length in 1 strands, the first is strand 40");
    found(&findings, HG_WARNING, "roots", "by more than 1 cm");
    found(&findings, HG_WARNING, "binding", "59 of 60");
    found(&findings, HG_WARNING, "root_uv", "0 to 1 is expected");
    assert_int_equal(problem[3], HG_STRAND_DROPPED);
    assert_int_equal(problem[7], HG_STRAND_DROPPED);
    assert_int_equal(problem[20], HG_STRAND_DUPLICATE);
    assert_int_equal(problem[40], HG_STRAND_EDGES);
    assert_int_equal(problem[50], HG_STRAND_ROOT);
    assert_int_equal(problem[55], HG_STRAND_INSIDE);
    assert_int_equal(problem[0], HG_STRAND_FINE);
    hg_findings_free(&findings);

    curves->body_hash = 5;
    ok(hg_check_groom(context(), &findings, curves, bust(), NULL));
    found(&findings, HG_ERROR, "binding", "another body");
    hg_findings_free(&findings);
    curves->root_face[0] = (int32_t)bust()->faces;
    ok(hg_check_groom(context(), &findings, curves, bust(), NULL));
    found(&findings, HG_ERROR, "binding", "1 roots are bound to faces that the body does not have");
    hg_findings_free(&findings);
    for (int i = 0; i < 60 * 36; i++) p[i] = NAN;
    ok(hg_check_groom(context(), &findings, curves, bust(), problem));
    found(&findings, HG_ERROR, "strands", "none of 60 can be used");
    hg_findings_free(&findings);
    hg_curves_destroy(curves);
}

static void bodies_are_looked_at(void **state)
{
    (void)state;
    hg_findings findings = { 0 };
    hg_body *body;
    ok(hg_bust_create(&body));
    ok(hg_check_body(&findings, body));
    assert_int_equal(hg_findings_count(&findings, HG_FINE), findings.n);
    hg_findings_free(&findings);
    int32_t *t = body->triangles, first = t[0];
    t[0] = t[1], t[1] = first; /* one triangle the other way */
    body->joint_name[hg_body_joint(body, "Head")][0] = 'h';
    for (int64_t i = 0; i < 3 * body->vertices; i++) body->points[i] *= 100;
    ok(hg_check_body(&findings, body));
    found(&findings, HG_WARNING, "mesh", "0 edges have one triangle, 0 more than two, 3 two that face opposite ways");
    found(&findings, HG_WARNING, "joints", "without Head");
    found(&findings, HG_WARNING, "unit", "not the size of a person");
    found(&findings, HG_WARNING, "scalp", "a head has about 0.06 m2");
    hg_findings_free(&findings);
    for (int64_t i = 0; i < body->vertices; i++) body->points[3 * i] *= -1; /* mirrored: inside out */
    body->faces--;
    ok(hg_check_body(&findings, body));
    found(&findings, HG_ERROR, "mesh", "inside out");
    found(&findings, HG_WARNING, "mesh", "3 edges have one triangle");
    hg_findings_free(&findings);
    hg_body_destroy(body);
}

static void motions_are_looked_at(void **state)
{
    (void)state;
    hg_findings findings = { 0 };
    hg_motion *motion;
    ok(hg_motion_make(&motion, bust(), "nod", 2, 30, 1));
    ok(hg_check_motion(&findings, motion, bust()));
    assert_int_equal(hg_findings_count(&findings, HG_FINE), findings.n);
    found(&findings, HG_FINE, "joints", "those of the body");
    hg_findings_free(&findings);
    int head = hg_body_joint(bust(), "Head");
    float *q = motion->rotation + 4 * (20 * motion->joints + head);
    q[0] = 0, q[1] = 1, q[2] = q[3] = 0; /* half a turn in a frame */
    motion->translation[3 * 30] = 500;
    motion->joint_name[head][0] = 'h';
    ok(hg_check_motion(&findings, motion, bust()));
    found(&findings, HG_WARNING, "turns", "head in frame 2");
    found(&findings, HG_WARNING, "way", "are these metres?");
    found(&findings, HG_ERROR, "joints", "missing Head; more head");
    hg_findings_free(&findings);
    motion->frames = 1;
    ok(hg_check_motion(&findings, motion, NULL));
    found(&findings, HG_WARNING, "clip", "a very short clip");
    hg_findings_free(&findings);
    hg_motion_destroy(motion);
}

static void configs_are_looked_at(void **state)
{
    (void)state;
    hg_findings findings = { 0 };
    const char *path = small_write_text(
        "good.yaml", "scene: {strands: 40, vertices: 9, seconds: 1 s, motion_kinds: [nod], held_out_kinds: [shake]}\n"
                     "model: {width: 16, depth: 1}\n"
                     "features: {history: 2, latent: 4, encoder_width: 16, encoder_steps: 50000, lock_size: 8}\n"
                     "losses:\n  stretch: {stiffness: 2 N/m}\ntraining: {strands: 20}\n");
    ok(hg_hair_config_check(context(), &findings, path));
    assert_int_equal(hg_findings_count(&findings, HG_ERROR), 0);
    found(&findings, HG_FINE, "losses", "1 energies");
    found(&findings, HG_FINE, "memory", "MB");
    hg_findings_free(&findings);

    path = small_write_text("bad.yaml", "scene:\n  groom: none.h5\n  motions: [a.h5]\n  held_out: [b.h5]\n"
                                        "features: {pose_joints: [Haed]}\n");
    ok(hg_hair_config_check(context(), &findings, path)); /* everything at once */
    found(&findings, HG_ERROR, "losses", "no energy");
    found(&findings, HG_ERROR, "file", "line 2, scene.groom: none.h5: cannot be opened");
    found(&findings, HG_ERROR, "file", "line 3, scene.motions: a.h5");
    found(&findings, HG_ERROR, "file", "line 4, scene.held_out: b.h5");
    found(&findings, HG_ERROR, "joints", "the body has no joint \"Haed\"; did you mean Head");
    hg_findings_free(&findings);

    path = small_write_text("misspelt.yaml", "losses:\n  strech: {}\n");
    ok(hg_hair_config_check(context(), &findings, path));
    found(&findings, HG_ERROR, "config", "misspelt.yaml:2: unknown key");
    assert_int_equal(findings.n, 1);
    hg_findings_free(&findings);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(good_hair_is_fine),     cmocka_unit_test(units_are_doubted),
        cmocka_unit_test(axes_are_doubted),      cmocka_unit_test(bad_strands_are_found),
        cmocka_unit_test(bodies_are_looked_at),  cmocka_unit_test(motions_are_looked_at),
        cmocka_unit_test(configs_are_looked_at),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    hg_body_destroy(bust());
    hg_ctx_destroy(context());
    return failed;
}
