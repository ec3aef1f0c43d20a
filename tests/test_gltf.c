/* glTF: a small skinned box with an animation, as text and as binary, lies, and the robot of ../shared/data. */
#include "tests/small_people.h"
#include "tests/test.h"

static void ok(hg_status status)
{
    if (status != HG_OK) fail_msg("%s: %s", hg_status_name(status), hg_message());
}

static void refused(hg_status status, const char *path, const char *words)
{
    assert_int_not_equal(status, HG_OK);
    if (!strstr(hg_message(), path) || !strstr(hg_message(), words))
        fail_msg("\"%s\" where \"%s\" is expected", hg_message(), words);
}

static void near(double a, double b, double tolerance)
{
    if (!(fabs(a - b) <= tolerance)) fail_msg("%.9g where %.9g is expected", a, b);
}

static void check_body(const hg_body *body)
{
    static const char *const names[] = { "mixamorig:Hips", "mixamorig:Neck", "mixamorig:Head" };
    const double height[] = { 0.5, 0.675, 0.725 };
    assert_true(body->vertices == 8 && body->faces == 12 && body->joints == 3); /* vertex 8 was joined with 7 */
    for (int v = 0; v < 8; v++)
        for (int k = 0; k < 3; k++) near((double)body->points[3 * v + k], (double)small_head[v][k], 1e-6);
    assert_memory_equal(body->triangles, small_faces, sizeof small_faces);
    for (int j = 0; j < 3; j++) {
        assert_string_equal(body->joint_name[j], names[j]);
        assert_int_equal(body->parent[j], j - 1);
        near((double)body->joint[3 * j], 0, 1e-6);
        near((double)body->joint[3 * j + 1], height[j], 1e-6);
    }
    assert_int_equal(hg_body_joint(body, "Head"), 2);
    for (int v = 0; v < 8; v++) {
        double head = 0, neck = 0;
        for (int i = 0; i < HG_INFLUENCES; i++) {
            head += body->influence[HG_INFLUENCES * v + i] == 2 ? (double)body->weight[HG_INFLUENCES * v + i] : 0;
            neck += body->influence[HG_INFLUENCES * v + i] == 1 ? (double)body->weight[HG_INFLUENCES * v + i] : 0;
        }
        near(head, v < 2 ? 0.75 : 1, 2e-5);
        near(neck, v < 2 ? 0.25 : 0, 2e-5);
    }
    assert_string_equal(body->shape_name[0], "tall");
    assert_string_equal(body->shape_name[1], "morph_1");
    for (int v = 0; v < 8; v++) { /* halved; the second is sparse */
        near((double)body->shapes[3 * v + 1], v == 2 ? 0.05 : 0, 1e-7);
        near((double)body->shapes[24 + 3 * v + 2], v == 3 ? 0.15 : 0, 1e-7);
    }
    assert_true(body->shape_spread[1] > 0 && body->shape_spread[2] == 0);
    bool scalp = false;
    for (int64_t i = 0; i < body->scalp_faces; i++) scalp |= body->scalp[i] == 8;
    assert_true(scalp && body->uv);
    assert_int_equal(body->collider_faces, 12);
}

static void a_body_reads(void **state)
{
    (void)state;
    char text[8192];
    uint8_t bytes[8192];
    size_t size = small_gltf(text);
    hg_body *body;
    hg_text notes = { 0 };
    ok(hg_body_read(NULL, &body, small_write("box.gltf", text, size), NULL, &notes));
    check_body(body);
    assert_non_null(strstr(notes.data, "vertices: 1 that differ only"));
    assert_null(strstr(notes.data, "rest:"));
    hg_text_free(&notes);
    ok(hg_body_save(body, small_path("box.h5")));
    hg_body_destroy(body);
    size = small_glb(bytes);
    ok(hg_body_read(NULL, &body, small_write("box.glb", bytes, size), NULL, NULL));
    check_body(body);
    hg_body_destroy(body);

    /* bytes in a file beside it, with a space in its name */
    uint8_t buffer[SMALL_GLTF_BYTES];
    small_gltf_bytes(buffer);
    small_write("box data.bin", buffer, sizeof buffer);
    snprintf(text, sizeof text, small_gltf_json, ", \"uri\": \"box%20data.bin\"");
    ok(hg_body_read(NULL, &body, small_write_text("box.gltf", text), NULL, NULL));
    check_body(body);
    hg_body_destroy(body);
    hg_import with = { .unit = 0.1, .up = 'z' };
    ok(hg_body_read(NULL, &body, small_path("box.glb"), &with, NULL));
    near((double)body->points[3 * 6 + 1], 0.011, 1e-7);
    near((double)body->points[3 * 6 + 2], -0.084, 1e-7);
    hg_body_destroy(body);
}

static double degrees_between(hg_quatd a, hg_quatd b)
{
    return hg_vec3d_norm(hg_quatd_to_rotation_vector(hg_quatd_mul(hg_quatd_conj(a), b))) * 180 / 3.14159265358979323846;
}

static void an_animation_reads(void **state)
{
    (void)state;
    uint8_t bytes[8192];
    hg_clip *clip;
    hg_body *body;
    hg_motion *motion;
    const char *path = small_write("box.glb", bytes, small_glb(bytes));
    const double degree = 3.14159265358979323846 / 180;
    ok(hg_clip_read(&clip, path, NULL, NULL));
    assert_true(clip->frames == 25 && clip->joints == 3 && clip->rate == 24);
    for (int t = 0; t < 25; t++) {
        const double *q = clip->rotation + 4 * 3 * t;
        double s = (t % 12) / 12.0, spline = s * s * (3 - 2 * s);
        assert_true(degrees_between(hg_quatd_load(q), hg_quatd_identity()) < 1e-4);
        /* about the neck's own X, which is Y here: a spline without slope at its keys, on the quaternion's numbers */
        double p = t < 12 ? spline : t < 24 ? 1 - spline : 0, half = sin(30 * degree) * p;
        double angle = 2 * atan2(half, 1 - p + p * cos(30 * degree));
        assert_true(degrees_between(hg_quatd_load(q + 4), hg_quatd_from_rotation_vector(hg_vec3d_make(0, angle, 0))) <
                    1e-4);
        assert_true(degrees_between(hg_quatd_load(q + 8),
                                    hg_quatd_from_rotation_vector(hg_vec3d_make(40.0 * t / 12 * degree, 0, 0))) < 1e-4);
        near(clip->translation[3 * t + 2], t < 12 ? 0 : t < 24 ? 0.1 : 0.2, 1e-7); /* steps */
        near(clip->translation[3 * t + 1], 0, 1e-7);
    }
    /* on its own body nothing changes */
    ok(hg_body_read(NULL, &body, path, NULL, NULL));
    ok(hg_clip_retarget(&motion, clip, body, 24));
    for (int64_t i = 0; i < 25 * 3; i++)
        assert_true(degrees_between(hg_quatd_from_f(hg_quatf_load(motion->rotation + 4 * i)),
                                    hg_quatd_load(clip->rotation + 4 * i)) < 1e-3);
    near((double)motion->translation[3 * 24 + 2], 0.2, 1e-6);
    hg_motion_destroy(motion);
    hg_clip_destroy(clip);
    hg_body_destroy(body);
    hg_import with = { .animation = "nod" };
    ok(hg_clip_read(&clip, path, &with, NULL));
    hg_clip_destroy(clip);
    with.animation = "0";
    ok(hg_clip_read(&clip, path, &with, NULL));
    hg_clip_destroy(clip);
    with.animation = "run";
    refused(hg_clip_read(&clip, path, &with, NULL), "box.glb", "there are nod");
}

/* ---- lies ---------------------------------------------------------------------------------------------------- */

static void lies_are_refused(void **state)
{
    (void)state;
    static const struct {
        const char *from, *to, *words;
        bool motion;
    } lies[] = {
        { "{\"asset\"", "[\"asset\"", "not valid JSON", false },
        { "\"2.0\"", "\"1.0\"", "asset.version", false },
        { "\"2.0\"},", "\"2.0\"}, \"extensionsRequired\": [\"KHR_draco_mesh_compression\"],", "KHR_draco", false },
        { "\"2.0\"},", "\"2.0\"}, \"extensionsRequired\": [\"EXT_meshopt_compression\"],", "EXT_meshopt", false },
        { "\"2.0\"},", "\"2.0\"}, \"extensionsRequired\": [\"ACME_wheels\"],", "ACME_wheels", false },
        { "\"primitives\": [{", "\"primitives\": [{\"extensions\": {\"KHR_draco_mesh_compression\": {}}, ",
          "packed by KHR_draco", false },
        { "\"byteLength\": 916", "\"byteLength\": 917", "916 bytes are there", false },
        { "\"byteLength\": 916", "\"byteLength\": 915", "bufferViews[7]", false },
        { "\"byteLength\": 916", "\"byteLength\": -1", "byteLength", false },
        { "base64,", "base64,*", "base64", false },
        { "data:application", "http://application", "beside this one", false },
        { "\"byteLength\": 108}", "\"byteLength\": 107}", "accessors[0]", false },
        { "\"byteStride\": 8", "\"byteStride\": 7", "accessors[3]", false },
        { "\"byteStride\": 8", "\"byteStride\": 9", "accessors[3]", false },
        { "\"count\": 9, \"type\": \"VEC3\"}", "\"count\": 1e9, \"type\": \"VEC3\"}", "count", false },
        { "\"count\": 9, \"type\": \"VEC3\"}", "\"count\": 10, \"type\": \"VEC3\"}", "do not fit", false },
        { "\"count\": 9, \"type\": \"VEC3\"}", "\"count\": 9, \"type\": \"VEC2\"}", "VEC2", false },
        { "\"componentType\": 5126, \"count\": 9, \"type\": \"VEC3\", \"sp",
          "\"componentType\": 5126, \"count\": 99999999, \"type\": \"VEC3\", \"sp", "without a bufferView", false },
        { "\"componentType\": 5121", "\"componentType\": 5130", "componentType", false },
        { "{\"count\": 1, \"indices\"", "{\"count\": 10, \"indices\"", "count", false },
        { "\"indices\": 4", "\"indices\": 0", "expected 1 numbers", false },
        { "\"indices\": 4", "\"indices\": 12", "no accessors[12]", false },
        { "\"POSITION\": 0", "\"NORMAL\": 0", "no POSITION", false },
        { "\"JOINTS_0\": 1, ", "", "without JOINTS_0", false },
        { "\"TEXCOORD_0\": 3", "\"TEXCOORD_0\": 11", "expected 2", false },
        { "\"joints\": [1, 2, 3]", "\"joints\": [1, 2]", "the skin has 2", false },
        { "\"joints\": [1, 2, 3]", "\"joints\": []", "no joints", false },
        { "\"joints\": [1, 2, 3]", "\"joints\": [1, 2, 30]", "none of the 5 nodes", false },
        { "\"joints\": [1, 2, 3]", "\"joints\": [1, 2, 3, 0]", "3 inverse bind matrices for 4", false },
        { "\"children\": [3]", "\"children\": [1]", "another parent", false },
        { "\"children\": [3]", "\"children\": [0]", "own ancestors", false },
        { "\"children\": [3]", "\"children\": [7]", "none of the 5 nodes", false },
        { "[0.5, 0.5, 0.5]", "[0.5, 0.5]", "list of 3", false },
        { "\"rotation\": [0, 0, 0.7", "\"rotation\": [0, 0, 0, 0], \"r\": [0.7", "no quaternion", false },
        { "\"skin\": 0", "\"skin\": 1", "\"skin\" is not", false },
        { "mixamorig:Head", "Top", "\"Head\"", false },
        { "\"output\": 7", "\"output\": 8", "expected 4", true },
        { "\"output\": 8", "\"output\": 10", "9 values for 3 keys", true },
        { "CUBICSPLINE", "LINEAR", "9 values for 3 keys", true },
        { "CUBICSPLINE", "BEZIER", "interpolation BEZIER", true },
        { "\"sampler\": 2", "\"sampler\": 3", "\"sampler\" is not", true },
        { "\"node\": 2", "\"node\": 5", "\"node\" is not", true },
        { "\"input\": 6, \"output\": 7", "\"input\": 4, \"output\": 7", "comes before", true },
        { "\"animations\"", "\"other\"", "no animation", true },
    };
    char whole[8192], text[8400];
    small_gltf(whole);
    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        const char *at = strstr(whole, lies[i].from);
        if (!at) fail_msg("\"%s\" is not there", lies[i].from);
        snprintf(text, sizeof text, "%.*s%s%s", (int)(at - whole), whole, lies[i].to, at + strlen(lies[i].from));
        const char *path = small_write_text("lie.gltf", text);
        hg_body *body = NULL;
        hg_clip *clip = NULL;
        refused(lies[i].motion ? hg_clip_read(&clip, path, NULL, NULL) : hg_body_read(NULL, &body, path, NULL, NULL),
                "lie.gltf", lies[i].words);
        assert_true(!body && !clip);
    }
    uint8_t bytes[8192];
    size_t size = small_glb(bytes);
    hg_body *body;
    for (size_t cut = 0; cut < size; cut += cut < 64 ? 1 : 7) { /* truncations */
        assert_int_equal(hg_body_read(NULL, &body, small_write("lie.glb", bytes, cut), NULL, NULL), HG_FORMAT);
        assert_non_null(strstr(hg_message(), "lie.glb"));
        assert_null(body);
    }
}

/* A time of years between two keys is not a motion that a few bytes can mean. */
static void no_memory_for_a_lying_clip(void **state)
{
    (void)state;
    uint8_t bytes[8192];
    hg_clip *clip;
    size_t size = small_glb(bytes), data = size - SMALL_GLTF_BYTES;
    const float late = 1e9F;
    memcpy(bytes + data + 560, &late, 4);
    refused(hg_clip_read(&clip, small_write("late.glb", bytes, size), NULL, NULL), "late.glb", "more than this file");
    const float never = NAN;
    memcpy(bytes + data + 560, &never, 4);
    refused(hg_clip_read(&clip, small_write("late.glb", bytes, size), NULL, NULL), "late.glb", "not finite");
}

/* ---- a real file --------------------------------------------------------------------------------------------- */

static void the_robot_reads(void **state)
{
    (void)state;
    const char *source = getenv("HG_SOURCE");
    char path[1024];
    snprintf(path, sizeof path, "%s/../shared/data/bodies/gltf-robot/robot.glb", source ? source : ".");
    if (!hg_file_exists(path)) skip();
    hg_body *body;
    hg_clip *clip;
    hg_text notes = { 0 };
    ok(hg_body_read(NULL, &body, path, NULL, &notes));
    assert_true(body->joints == 43 && body->vertices > 1500 && body->faces > 3000);
    assert_null(strstr(notes.data, "rest:")); /* its nodes stand as its skin rests */
    hg_text_free(&notes);
    assert_string_equal(body->joint_name[hg_body_joint(body, "Head")], "Head");
    double low = 9, high = -9;
    for (int64_t v = 0; v < body->vertices; v++) {
        low = fmin(low, (double)body->points[3 * v + 1]);
        high = fmax(high, (double)body->points[3 * v + 1]);
    }
    assert_true(fabs(low) < 0.1 && fabs(high - 4.54) < 0.02);
    ok(hg_body_save(body, small_path("robot.h5")));
    static const char *const names[] = { "Robot_Idle", "Robot_Walking", "Robot_Jump", "13" };
    for (int i = 0; i < 4; i++) {
        hg_motion *motion;
        hg_import with = { .animation = names[i], .body = body };
        ok(hg_clip_read(&clip, path, &with, NULL));
        assert_true(clip->rate == 24 && clip->frames > 10 && clip->joints == 43);
        ok(hg_clip_retarget(&motion, clip, body, 30));
        double jump = 0;
        for (int64_t t = 0; t < motion->frames; t++) jump = fmax(jump, (double)motion->translation[3 * t + 1]);
        assert_true(i == 2 ? jump > 0.5 : jump < 0.5);
        hg_motion_destroy(motion);
        hg_clip_destroy(clip);
    }
    hg_body_destroy(body);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(a_body_reads), cmocka_unit_test(an_animation_reads),
                                        cmocka_unit_test(lies_are_refused),
                                        cmocka_unit_test(no_memory_for_a_lying_clip),
                                        cmocka_unit_test(the_robot_reads) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
