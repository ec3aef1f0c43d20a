/* Readers of strands, meshes, bodies and clips: small files written here, every truncation and many lies, and the real
 * files of ../shared/data where they are. */
#include "tests/small_files.h"

#include "geometry/vector.h"
#include "scene/lines.h"

#include <cjson/cJSON.h>
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

/* It failed as HG_FORMAT, and the message names the file and holds a few words. */
static void refused(hg_status status, const char *path, const char *words)
{
    assert_int_equal(status, HG_FORMAT);
    if (!strstr(hg_message(), path) || !strstr(hg_message(), words))
        fail_msg("\"%s\" where \"%s\" is expected", hg_message(), words);
}

/* ---- numbers ------------------------------------------------------------------------------------------------- */

static void numbers_are_those_of_strtod(void **state)
{
    (void)state;
    for (uint64_t i = 0; i < 20000; i++) {
        char text[64];
        double value = ldexp(hg_random_uniform(1, 1, i) - 0.5, (int)hg_random_below(1, 2, i, 200) - 100), read;
        const char *const formats[] = { "%.17g", "%.6f", "%g", "%.3e" };
        snprintf(text, sizeof text, formats[i % 4], value);
        assert_true(hg_word_number((hg_word){ text, strlen(text) }, &read));
        assert_true(read == strtod(text, NULL));
    }
    const char *const good[] = { "0", "-0", ".5", "5.", "+1e3", "-5.5E-1", "1e-400", "123456789012345678901234567890" };
    const char *const bad[] = { "", "-", ".", "e5", "1e", "1e+", "nan", "inf", "0x10", "1,5", "1e999", "1 ", "--1" };
    double read;
    for (size_t i = 0; i < sizeof good / sizeof *good; i++) {
        assert_true(hg_word_number((hg_word){ good[i], strlen(good[i]) }, &read));
        assert_true(read == strtod(good[i], NULL));
    }
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        assert_false(hg_word_number((hg_word){ bad[i], strlen(bad[i]) }, &read));
    int64_t integer;
    assert_true(hg_word_integer((hg_word){ "-17", 3 }, &integer) && integer == -17);
    assert_false(hg_word_integer((hg_word){ "1.5", 3 }, &integer));
    assert_false(hg_word_integer((hg_word){ "99999999999999999999", 20 }, &integer));
}

/* ---- strands ------------------------------------------------------------------------------------------------- */

static void small_tfx_reads(void **state)
{
    (void)state;
    uint8_t bytes[1024];
    hg_curves *curves;
    for (int version = 3; version <= 4; version++) {
        size_t size = small_tfx(version, bytes);
        ok(hg_curves_read(&curves, small_write("Hair.TFX", bytes, size)));
        assert_int_equal(curves->strands, 3);
        assert_int_equal(curves->start[3], 12);
        for (int i = 0; i < 12; i++) {
            assert_true(curves->points[3 * i] == (float)(i / 4));
            assert_true(curves->points[3 * i + 1] == 0.01F * (float)(i % 4));
            assert_true(curves->points[3 * i + 2] == 0.5F);
        }
        hg_curves_destroy(curves);
    }
    ok(hg_curves_read(&curves, small_write_text("hair.tfx", small_tfx2)));
    assert_int_equal(curves->strands, 2);
    assert_int_equal(curves->start[1], 3);
    assert_int_equal(curves->start[2], 5);
    assert_true(curves->points[8] == 0.5F && curves->points[14] == 0.25F);
    hg_curves_destroy(curves);
}

static void put(uint8_t *bytes, size_t offset, uint32_t value) { memcpy(bytes + offset, &value, 4); }

static void lying_tfx_is_refused(void **state)
{
    (void)state;
    uint8_t bytes[1024];
    hg_curves *curves;
    for (int version = 3; version <= 4; version++) {
        size_t size = small_tfx(version, bytes), offset = version == 4 ? 12 : 144;
        for (size_t cut = 0; cut < size; cut++) { /* every truncation */
            hg_status status = hg_curves_read(&curves, small_write("hair.tfx", bytes, cut));
            assert_int_equal(status, HG_FORMAT);
            assert_null(curves);
            assert_non_null(strstr(hg_message(), "hair.tfx"));
        }
        const struct {
            size_t at;
            uint32_t value;
            const char *words;
        } lies[] = {
            { 0, 0x40a00000, "version 5" },         { 0, 0x7fc00000, "version" }, { 4, 0, "0 strands" },
            { 4, 0xffffffff, "are there" },         { 4, 4, "are there" },        { 8, 0, "points per strand" },
            { 8, 0xffffffff, "points per strand" }, { 8, 5, "are there" },        { offset, 4, "inside the header" },
            { offset, 0xffffffff, "offset" },       { offset, 300, "" },
        };
        for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
            size = small_tfx(version, bytes);
            put(bytes, lies[i].at, lies[i].value);
            refused(hg_curves_read(&curves, small_write("hair.tfx", bytes, size)), "hair.tfx", lies[i].words);
        }
    }
    refused(hg_curves_read(&curves, small_write("hair.tfx", small_tfx2, sizeof small_tfx2 - 12)),
            "hair.tfx:", "number");
    refused(hg_curves_read(&curves, small_write_text("hair.tfx", "version 2.0\nnumStrands 999999999\n")), "hair.tfx:2",
            "numStrands");
    refused(hg_curves_read(&curves, small_write_text("hair.tfx",
                                                     "version 2.0\nnumStrands 2\nstrand 0 numVerts 99999999\n0,0,0\n")),
            "hair.tfx:3", "numVerts");
    assert_int_equal(hg_curves_read(&curves, small_path("nothing.tfx")), HG_IO);
    assert_int_equal(hg_curves_read(&curves, small_write_text("hair.xyz", "1")), HG_UNSUPPORTED);
    assert_non_null(strstr(hg_message(), ".tfx"));
}

static void real_tfx(void **state)
{
    (void)state;
    static const struct {
        const char *path;
        int64_t strands, points;
        double length[3], tolerance;
    } files[] = {
        { "grooms/sintel-16pt/SintelHairOriginal-sintel_hair.16points.tfx",
          11400,
          16,
          { 0.0251, 0.1031, 0.248 },
          1e-3 },
        { "grooms/sintel-lite-32pt/GEO-sintel_hair_emit.001-sintel_hair.tfx", 228, 32, { 3.80, 10.53, 20.63 }, 6e-3 },
        { "grooms/tressfx-ratboy/Ratboy_mohawk.tfx", 2228, 32, { 7.5e-6, 0.103, 0.295 }, 1e-3 },
        { "grooms/tressfx-bear/bear.tfx", 48113, 4, { 1.1e-4, 4.31, 8.0 }, 5e-2 },
        { "grooms/tressfx-testhair1/TestHair1.tfx", 10027, 4, { 11, 11, 11 }, 1e-3 },
        { "grooms/fibermesh2/Fibermesh2_hair_Curves.tfx", 10000, 9, { 1.23, 37.23, 74.52 }, 6e-3 },
    };
    for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
        hg_curves *curves;
        ok(hg_curves_read(&curves, data(files[i].path)));
        assert_int_equal(curves->strands, files[i].strands);
        assert_int_equal(curves->start[curves->strands], files[i].strands * files[i].points);
        double least = (double)INFINITY, most = 0, sum = 0;
        for (int64_t s = 0; s < curves->strands; s++) {
            double length = 0;
            for (int64_t p = curves->start[s] + 1; p < curves->start[s + 1]; p++)
                length += (double)hg_vec3f_distance(hg_vec3f_load(curves->points + 3 * p),
                                                    hg_vec3f_load(curves->points + 3 * p - 3));
            least = fmin(least, length);
            most = fmax(most, length);
            sum += length;
        }
        assert_true(fabs(least - files[i].length[0]) < files[i].tolerance);
        assert_true(fabs(sum / (double)curves->strands - files[i].length[1]) < files[i].tolerance);
        assert_true(fabs(most - files[i].length[2]) < files[i].tolerance);
        hg_curves_destroy(curves);
    }
}

/* ---- meshes -------------------------------------------------------------------------------------------------- */

static void small_obj_reads(void **state)
{
    (void)state;
    hg_mesh *mesh;
    ok(hg_mesh_read_obj(&mesh, small_write_text("box.obj", small_obj)));
    assert_int_equal(mesh->vertices, 16);
    assert_int_equal(mesh->faces, 16);
    assert_int_equal(mesh->n_groups, 3);
    assert_string_equal(mesh->group[mesh->group_of_face[0]], "body");
    assert_string_equal(mesh->group[mesh->group_of_face[15]], "joint-head");
    const int32_t quad[] = { 4, 5, 6, 4, 6, 7 }; /* cut at the diagonal from corner 0 to corner 2 */
    assert_memory_equal(mesh->triangles + 6, quad, sizeof quad);
    assert_int_equal(mesh->polygon[2], 1);
    assert_int_equal(mesh->polygon[3], 1);
    assert_true(mesh->uv[2 * 2] == 1 && mesh->uv[2 * 2 + 1] == 1); /* of vertex 2 at its first corner */
    hg_mesh_destroy(mesh);
    ok(hg_mesh_read_obj(
        &mesh, small_write_text("a.obj", "v 0 0 0\r\nv 1 0 0\r\nv 0 1 0\r\nvn 0 0 1\r\nf -3//1 -2//1 -1//1\r\n")));
    assert_int_equal(mesh->faces, 1);
    assert_int_equal(mesh->triangles[2], 2);
    assert_int_equal(mesh->group_of_face[0], -1);
    assert_null(mesh->uv);
    hg_mesh_destroy(mesh);
}

static void bad_obj_is_refused(void **state)
{
    (void)state;
    static const struct {
        const char *text, *place, *words;
    } files[] = {
        { "", "a.obj", "no vertex" },
        { "v 0 0\n", "a.obj:1", "missing" },
        { "v 0 0 nan\n", "a.obj:1", "not a finite number" },
        { "v 0 0 0\nv 0 0 1\nf 1 2\n", "a.obj:3", "2 corners" },
        { "v 0 0 0\nf 1 1 2\n", "a.obj:2", "not among the 1" },
        { "v 0 0 0\nf 1 1 0\n", "a.obj:2", "not among" },
        { "v 0 0 0\nf 1 1 -2\n", "a.obj:2", "not among" },
        { "v 0 0 0\nf 1/9 1 1\n", "a.obj:2", "texture" },
        { "v 0 0 0\nf 1 1 99999999999999999999\n", "a.obj:2", "not a vertex number" },
        { "v 0 0 0\nf a b c\n", "a.obj:2", "not a vertex number" },
    };
    hg_mesh *mesh;
    for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
        refused(hg_mesh_read_obj(&mesh, small_write_text("a.obj", files[i].text)), files[i].place, files[i].words);
        assert_null(mesh);
    }
}

/* ---- bodies -------------------------------------------------------------------------------------------------- */

static void small_body_reads(void **state)
{
    (void)state;
    hg_body *body;
    ok(small_body(&body));
    assert_int_equal(body->vertices, 8);
    assert_int_equal(body->faces, 12);
    assert_int_equal(body->joints, 4);
    static const char *const names[] = { "Hips", "Spine1", "Neck", "Head" };
    for (int j = 0; j < 4; j++) {
        assert_string_equal(body->joint_name[j], names[j]);
        assert_int_equal(body->parent[j], j - 1);
    }
    /* vertex 0: -0.7 dm, and the six targets of the neutral shape move it by 0.06 dm together */
    assert_true(fabs((double)body->points[0] + 0.064) < 1e-7);
    assert_true(fabs((double)body->joint[3 * 3 + 1] - 0.1 * (6.9 + 0.6 / 4)) <
                1e-6); /* a corner of its cube moves too */
    /* age: six of the same target on both sides: nothing; head height: half of the target on one side */
    for (int i = 0; i < 24; i++) assert_true(fabs((double)body->shapes[24 + i]) < 1e-9);
    assert_string_equal(body->shape_name[7], "head_height");
    assert_true(fabs((double)body->shapes[7 * 24] - 0.5 * 0.006) < 1e-8);
    assert_true(fabs((double)body->joint_shapes[7 * 12 + 3 * 3 + 1] - 0.5 * 0.06 / 4) < 1e-7);
    assert_true(fabs((double)body->joint_shapes[7 * 12 + 3 * 2 + 1] - 0.5 * 0.06 / 3) < 1e-7);
    double sum = 0, neck = 0;
    for (int i = 0; i < HG_INFLUENCES; i++) {
        sum += (double)body->weight[i];
        if (body->influence[i] == 2) neck += (double)body->weight[i];
    }
    assert_true(fabs(sum - 1) < 1e-6 && fabs(neck - 0.5) < 1e-6);
    assert_true(body->scalp_faces == 8 && body->collider_faces == 12);
    hg_body_destroy(body);
}

static void bad_bodies_are_refused(void **state)
{
    (void)state;
    static const struct {
        const char *file, *text, *words;
    } files[] = {
        { "makehuman/base.obj", "v 0 0 0\nf 1 1 1\n", "group named \"body\"" },
        { "makehuman/targets/head/head-scale-vert-incr.target", "0 1 2\n", "missing" },
        { "makehuman/targets/head/head-scale-vert-incr.target", "16 1 2 3\n", "not one of the 16 vertices" },
        { "makehuman/targets/head/head-scale-vert-incr.target", "-1 1 2 3\n", "not one of the 16 vertices" },
        { "makehuman/targets/head/head-scale-vert-incr.target", "1 x 2 3\n", "not a finite number" },
        { "mpfb2/rig.cmu_mb.json", "{\"Hips\": {\"head\": ", "not valid JSON" },
        { "mpfb2/rig.cmu_mb.json", "[]", "expected one object" },
        { "mpfb2/rig.cmu_mb.json", "{\"A\": {\"parent\": \"A\"}}", "no root" },
        { "mpfb2/rig.cmu_mb.json", "{\"A\": {\"parent\": \"\"}}", "strategy" },
        { "mpfb2/rig.cmu_mb.json",
          "{\"A\": {\"parent\": \"\", \"head\": {\"strategy\": \"CUBE\", \"cube_name\": \"x\"}}}", "cube_name" },
        { "mpfb2/rig.cmu_mb.json",
          "{\"A\": {\"parent\": \"\", \"head\": {\"strategy\": \"MEAN\", \"vertex_indices\": []}}}", "no vertex" },
        { "mpfb2/rig.cmu_mb.json",
          "{\"A\": {\"parent\": \"\", \"head\": {\"strategy\": \"MEAN\", \"vertex_indices\": [99]}}}",
          "vertex_indices" },
        { "mpfb2/rig.cmu_mb.json",
          "{\"A\": {\"parent\": \"\", \"head\": {\"strategy\": \"MEAN\", \"vertex_indices\": [1]}}, \"B\": "
          "{\"parent\": \"C\"}, \"C\": {\"parent\": \"B\"}}",
          "do not lead to the root" },
        { "mpfb2/weights.cmu_mb.json", "{}", "no object \"weights\"" },
        { "mpfb2/weights.cmu_mb.json", "{\"weights\": {\"Tail\": []}}", "\"Tail\"" },
        { "mpfb2/weights.cmu_mb.json", "{\"weights\": {\"Head\": [[0]]}}", "\"Head\"" },
        { "mpfb2/weights.cmu_mb.json", "{\"weights\": {\"Head\": [[0, -1]]}}", "\"Head\"" },
        { "mpfb2/weights.cmu_mb.json", "{\"weights\": {\"Head\": [[0, 1]]}}", "has no weight" },
        { "mpfb2/weights.cmu_mb.json", "{\"weights\": {\"Head\": 5}}", "has no weight" },
    };
    hg_body *body;
    for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
        small_makehuman();
        small_write_text(files[i].file, files[i].text);
        refused(hg_body_read_makehuman(NULL, &body, small_folder(), "cmu_mb"), files[i].file, files[i].words);
        assert_null(body);
    }
    small_makehuman();
    assert_int_equal(hg_body_read_makehuman(NULL, &body, small_folder(), "other"), HG_IO);
    assert_non_null(strstr(hg_message(), "rig.other.json"));
}

static hg_body *real_body(void)
{
    static hg_body *body;
    char folder[1024];
    snprintf(folder, sizeof folder, "%s", data("bodies/makehuman/base.obj"));
    *strstr(folder, "/makehuman/base.obj") = '\0';
    hg_body_destroy(body);
    body = NULL;
    ok(hg_body_read_makehuman(NULL, &body, folder, "cmu_mb"));
    return body;
}

static hg_vec3d corner(const hg_body *body, int64_t face, int k)
{
    const float *p = body->points + 3 * (int64_t)body->triangles[3 * face + k];
    return hg_vec3d_make((double)p[0], (double)p[1], (double)p[2]);
}

static void real_body_has_the_measured_shape(void **state)
{
    (void)state;
    hg_body *body = real_body();
    assert_int_equal(body->vertices, 13380);
    assert_int_equal(body->faces, 26756);
    assert_int_equal(body->joints, 31);
    double volume = 0, low = 9, high = -9;
    for (int64_t f = 0; f < body->faces; f++)
        volume += hg_vec3d_dot(corner(body, f, 0), hg_vec3d_cross(corner(body, f, 1), corner(body, f, 2))) / 6;
    for (int64_t v = 0; v < body->vertices; v++) {
        low = fmin(low, (double)body->points[3 * v + 1]);
        high = fmax(high, (double)body->points[3 * v + 1]);
        double sum = 0;
        for (int i = 0; i < HG_INFLUENCES; i++) sum += (double)body->weight[v * HG_INFLUENCES + i];
        assert_true(fabs(sum - 1) < 1e-5);
    }
    assert_true(fabs(volume - 0.0549) < 5e-5); /* [m3] */
    assert_true(fabs(low + 0.818) < 5e-4 && fabs(high - 0.842) < 5e-4 && fabs(high - low - 1.659) < 1e-3);
    for (int j = 0; j < body->joints; j++) assert_true(body->parent[j] < j);
}

/* The rig file stores where its joints were on the shape that it was made for: Z-up, metres. */
static void real_joints_are_those_of_the_rig(void **state)
{
    (void)state;
    hg_body *body = real_body();
    void *bytes;
    size_t size;
    ok(hg_file_read(data("bodies/mpfb2/rig.cmu_mb.json"), &bytes, &size));
    cJSON *rig = cJSON_Parse(bytes);
    assert_non_null(rig);
    double square = 0, most = 0;
    for (int j = 0; j < body->joints; j++) {
        const cJSON *bone = cJSON_GetObjectItemCaseSensitive(rig, body->joint_name[j]);
        const cJSON *at =
            cJSON_GetObjectItemCaseSensitive(cJSON_GetObjectItemCaseSensitive(bone, "head"), "default_position");
        double x = cJSON_GetArrayItem(at, 0)->valuedouble, y = cJSON_GetArrayItem(at, 1)->valuedouble,
               z = cJSON_GetArrayItem(at, 2)->valuedouble;
        const float *p = body->joint + 3 * j;
        double distance =
            hg_vec3d_distance(hg_vec3d_make(x, z, -y), hg_vec3d_make((double)p[0], (double)p[1], (double)p[2]));
        square += distance * distance;
        most = fmax(most, distance);
    }
    double rms = sqrt(square / (double)body->joints);
    print_message("joints against the rig's own: %.2f mm rms, %.2f at most\n", 1e3 * rms, 1e3 * most);
    assert_true(rms < 0.3e-3 && most < 1.5e-3);
    cJSON_Delete(rig);
    hg_free(bytes);
}

static void real_scalp_and_collider(void **state)
{
    (void)state;
    hg_body *body = real_body();
    assert_int_equal(body->scalp_faces, 760);
    bool *used = hg_alloc((size_t)body->vertices, sizeof *used);
    assert_non_null(used);
    double area = 0;
    int64_t vertices = 0;
    for (int64_t i = 0; i < body->scalp_faces; i++) {
        int64_t f = body->scalp[i];
        area += 0.5 * hg_vec3d_norm(hg_vec3d_cross(hg_vec3d_sub(corner(body, f, 1), corner(body, f, 0)),
                                                   hg_vec3d_sub(corner(body, f, 2), corner(body, f, 0))));
        const float *uv[3];
        for (int k = 0; k < 3; k++) {
            int64_t v = body->triangles[3 * f + k];
            vertices += !used[v];
            used[v] = true;
            uv[k] = body->uv + 2 * v;
            assert_true(uv[k][0] > 0 && uv[k][0] < 1 && uv[k][1] > 0 && uv[k][1] < 1);
        }
        float turn = (uv[1][0] - uv[0][0]) * (uv[2][1] - uv[0][1]) - (uv[2][0] - uv[0][0]) * (uv[1][1] - uv[0][1]);
        assert_true(turn > 0); /* no triangle is flipped: no seam, no fold */
        if (i > 0) assert_true(body->scalp[i] > body->scalp[i - 1]);
    }
    hg_free(used);
    assert_int_equal(vertices, 426);
    assert_true(fabs(area - 0.0596) < 1e-4);
    /* 9,962 faces lie above the chest; the mouth and the backs of the eye sockets are not for hair, the ears are */
    assert_true(body->collider_faces > 8500 && body->collider_faces < 9500);
    int64_t mouth = 0, ears = 0, scalp = 0;
    for (int64_t i = 0; i < body->collider_faces; i++) {
        int64_t f = body->collider[i];
        hg_vec3d c = hg_vec3d_scale(
            hg_vec3d_add(corner(body, f, 0), hg_vec3d_add(corner(body, f, 1), corner(body, f, 2))), 1.0 / 3);
        mouth += fabs(c.x) < 0.02 && c.y > 0.65 && c.y < 0.69 && c.z > 0.06 && c.z < 0.12;
        ears += fabs(c.x) > 0.07 && c.y > 0.7 && c.y < 0.79;
        for (int64_t k = 0; k < body->scalp_faces; k++) scalp += body->scalp[k] == f;
    }
    assert_int_equal(mouth, 0);
    assert_true(ears > 200);
    assert_int_equal(scalp, 760);
}

static void real_shapes_have_the_measured_size(void **state)
{
    (void)state;
    hg_body *body = real_body();
    double rms[HG_SHAPES], most[HG_SHAPES], height[HG_SHAPES];
    for (int s = 0; s < HG_SHAPES; s++) {
        const float *shape = body->shapes + 3 * s * body->vertices;
        double square = 0, largest = 0, low = 9, high = -9;
        for (int64_t v = 0; v < body->vertices; v++) {
            double norm = (double)hg_vec3f_norm(hg_vec3f_load(shape + 3 * v)),
                   y = (double)body->points[3 * v + 1] + (double)shape[3 * v + 1];
            square += norm * norm;
            largest = fmax(largest, norm);
            low = fmin(low, y);
            high = fmax(high, y);
        }
        rms[s] = sqrt(square / (double)body->vertices);
        most[s] = largest;
        height[s] = high - low - 1.6594;
    }
    assert_true(fabs(height[0] - 0.071) < 1e-3 && fabs(height[1] + 0.011) < 1e-3);
    assert_true(fabs(rms[2] - 0.015) < 5e-4 && fabs(most[2] - 0.072) < 1e-3);
    assert_true(fabs(rms[3] - 0.010) < 5e-4 && fabs(most[3] - 0.052) < 1e-3);
    assert_true(fabs(height[4] - 0.033) < 1e-3 && fabs(height[5] + 0.058) < 1e-3);
    /* joints follow: the head joint goes with the skin around it */
    int head = hg_body_joint(body, "Head");
    const float *joint = body->joint_shapes + 3 * head;
    assert_true((double)joint[1] > 0.05 && (double)joint[1] < 0.09);
    for (int s = 0; s < HG_SHAPES; s++) assert_true(body->shape_spread[s] == (s < 6 ? 0.4 : 0.2));
    hg_body_destroy(body);
}

/* ---- clips --------------------------------------------------------------------------------------------------- */

static double angle_between(const double *a, const double *b)
{
    hg_quatd turn = hg_quatd_mul(hg_quatd_conj(hg_quatd_load(a)), hg_quatd_load(b));
    return 2 * atan2(hg_vec3d_norm(hg_quatd_vector(turn)), fabs(turn.w)) * 180 / 3.14159265358979323846;
}

static void small_amc_reads(void **state)
{
    (void)state;
    hg_clip *clip;
    ok(hg_clip_read_amc(&clip, small_write_text("s.asf", small_asf), small_write_text("c.amc", small_amc)));
    assert_int_equal(clip->joints, 3);
    assert_int_equal(clip->frames, 3);
    assert_true(clip->rate == 120);
    assert_string_equal(clip->name[2], "head");
    assert_int_equal(clip->parent[2], 1);
    double unit = 0.0254 / 0.45;
    assert_true(fabs(clip->offset[3 * 2 + 1] - 9 * unit) < 1e-12); /* a joint is at the end of the bone before */
    assert_true(fabs(clip->translation[1] - 9 * unit) < 1e-12);
    double quarter[4] = { sqrt(0.5), 0, sqrt(0.5), 0 };
    assert_true(angle_between(clip->rotation + 4 * (1 * 3 + 0), quarter) < 1e-9);
    /* head of frame 2: C M C^-1 with C = 20 degrees about Z, M = Rz(10) Rx(30) */
    hg_quatd c = hg_quatd_from_axis_angle(hg_vec3d_make(0, 0, 1), 20 * 3.14159265358979323846 / 180);
    hg_quatd x = hg_quatd_from_axis_angle(hg_vec3d_make(1, 0, 0), 30 * 3.14159265358979323846 / 180);
    hg_quatd z = hg_quatd_from_axis_angle(hg_vec3d_make(0, 0, 1), 10 * 3.14159265358979323846 / 180);
    double expected[4];
    hg_quatd_store(expected, hg_quatd_mul(hg_quatd_mul(c, hg_quatd_mul(z, x)), hg_quatd_conj(c)));
    assert_true(angle_between(clip->rotation + 4 * (1 * 3 + 2), expected) < 1e-9);
    hg_clip_destroy(clip);
}

static void small_bvh_reads(void **state)
{
    (void)state;
    hg_clip *clip;
    ok(hg_clip_read_bvh(&clip, small_write_text("c.bvh", small_bvh)));
    assert_int_equal(clip->joints, 4);
    assert_int_equal(clip->frames, 2); /* the first one is a T-pose */
    assert_true(clip->rate == 120);
    assert_string_equal(clip->name[3], "Head");
    assert_int_equal(clip->parent[3], 2);
    hg_quatd q = hg_quatd_identity();
    const double degrees[3] = { 10, 20, 30 };
    for (int k = 0; k < 3; k++)
        q = hg_quatd_mul(q, hg_quatd_from_axis_angle(hg_vec3d_make(k == 2, k == 1, k == 0),
                                                     degrees[k] * 3.14159265358979323846 / 180));
    double expected[4];
    hg_quatd_store(expected, q);
    assert_true(angle_between(clip->rotation + 4 * 3, expected) < 1e-9); /* Rz Ry Rx */
    hg_clip_destroy(clip);
}

static void bad_clips_are_refused(void **state)
{
    (void)state;
    hg_clip *clip;
    size_t size = strlen(small_bvh);
    for (size_t cut = 0; cut < size - 2; cut++) { /* every truncation, up to the last number */
        hg_status status = hg_clip_read_bvh(&clip, small_write("c.bvh", small_bvh, cut));
        assert_int_equal(status, HG_FORMAT);
        assert_non_null(strstr(hg_message(), "c.bvh:"));
        assert_null(clip);
    }
    static const struct {
        const char *from, *to, *words;
    } bvh[] = {
        { "Frames: 3", "Frames: 2", "more values" },
        { "Frames: 3", "Frames: 4", "truncated" },
        { "Frames: 3", "Frames: 999999999999", "Frames:" },
        { "Frames: 3", "Frames: 0", "Frames:" },
        { ".0083333", "0", "Frame Time" },
        { ".0083333", "x", "Frame Time" },
        { "Zrotation", "Wrotation", "not a channel" },
        { "CHANNELS 6", "CHANNELS 7", "0 to 6" },
        { "Neck", "Hips", "second joint" },
        { "0 90 0", "0 nan 0", "frame 1" },
        { "OFFSET 1 -8 0", "OFFSET 1 -8", "OFFSET" },
        { "HIERARCHY", "MOTION", "HIERARCHY" },
    };
    char text[2048];
    for (size_t i = 0; i < sizeof bvh / sizeof *bvh; i++) {
        const char *at = strstr(small_bvh, bvh[i].from);
        snprintf(text, sizeof text, "%.*s%s%s", (int)(at - small_bvh), small_bvh, bvh[i].to, at + strlen(bvh[i].from));
        refused(hg_clip_read_bvh(&clip, small_write_text("c.bvh", text)), "c.bvh:", bvh[i].words);
    }
    static const struct {
        bool skeleton;
        const char *from, *to, *words;
    } amc[] = {
        { false, "head 30 10", "head 30", "number is missing" },
        { false, "head 30 10", "head 30 10 5", "more values" },
        { false, "head 30 10", "tail 30 10", "no bone \"tail\"" },
        { false, "head 30 10\n", "", "ends without values for \"head\"" },
        { false, "head -5.5e0 1e1\n", "", "ends without" },
        { false, "\n3\n", "\n4\n", "frame 4 follows frame 2" },
        { false, "\n1\n", "\n", "before the first frame" },
        { false, "head 0 0\n", "head 0 0\nhead 0 0\n", "twice" },
        { false, "9 2 0 90", "9 2 0 inf", "not a finite number" },
        { true, "lowerneck head", "lowerneck tail", "no bone \"tail\"" },
        { true, "lowerneck head", "", "place for bone \"head\"" },
        { true, "root lowerneck\n", "", "has children before" },
        { true, "dof rx rz", "dof rx qz", "not a degree" },
        { true, "name head", "name lowerneck", "second bone" },
        { true, "0 0 20   XYZ", "0 0 20   XQZ", "order of axes" },
        { true, "length 0.45", "length 0", "unit of length" },
        { true, "direction 0 1 0", "direction 0 1", "direction" },
        { true, ":bonedata", ":words", "" },
    };
    for (size_t i = 0; i < sizeof amc / sizeof *amc; i++) {
        const char *original = amc[i].skeleton ? small_asf : small_amc, *at = strstr(original, amc[i].from);
        snprintf(text, sizeof text, "%.*s%s%s", (int)(at - original), original, amc[i].to, at + strlen(amc[i].from));
        const char *asf = small_write_text("s.asf", amc[i].skeleton ? text : small_asf);
        const char *clip_file = small_write_text("c.amc", amc[i].skeleton ? small_amc : text);
        refused(hg_clip_read_amc(&clip, asf, clip_file), amc[i].skeleton ? "s.asf:" : "c.amc:", amc[i].words);
        assert_null(clip);
    }
}

/* Global rotations and places of one frame. */
static void pose(const hg_clip *clip, int64_t frame, const double *offset, hg_quatd *turn, hg_vec3d *place)
{
    for (int64_t j = 0; j < clip->joints; j++) {
        hg_quatd local = hg_quatd_load(clip->rotation + 4 * (frame * clip->joints + j));
        int parent = clip->parent[j];
        turn[j] = parent < 0 ? local : hg_quatd_mul(turn[parent], local);
        place[j] = parent < 0
                       ? hg_vec3d_load(clip->translation + 3 * frame)
                       : hg_vec3d_add(place[parent], hg_quatd_rotate(turn[parent], hg_vec3d_load(offset + 3 * j)));
    }
}

static int find(const hg_clip *clip, const char *name)
{
    for (int j = 0; j < clip->joints; j++)
        if (!strcmp(clip->name[j], name)) return j;
    fail_msg("no joint %s", name);
    return -1;
}

/* The same clip is there in both formats. The .bvh lost two bone lengths, so places agree under the .asf's offsets. */
static void amc_and_bvh_agree(void **state)
{
    (void)state;
    static const char *const pairs[31][2] = {
        { "root", "Hips" },
        { "lhipjoint", "LHipJoint" },
        { "lfemur", "LeftUpLeg" },
        { "ltibia", "LeftLeg" },
        { "lfoot", "LeftFoot" },
        { "ltoes", "LeftToeBase" },
        { "rhipjoint", "RHipJoint" },
        { "rfemur", "RightUpLeg" },
        { "rtibia", "RightLeg" },
        { "rfoot", "RightFoot" },
        { "rtoes", "RightToeBase" },
        { "lowerback", "LowerBack" },
        { "upperback", "Spine" },
        { "thorax", "Spine1" },
        { "lowerneck", "Neck" },
        { "upperneck", "Neck1" },
        { "head", "Head" },
        { "lclavicle", "LeftShoulder" },
        { "lhumerus", "LeftArm" },
        { "lradius", "LeftForeArm" },
        { "lwrist", "LeftHand" },
        { "lhand", "LeftFingerBase" },
        { "lfingers", "LFingers" },
        { "lthumb", "LThumb" },
        { "rclavicle", "RightShoulder" },
        { "rhumerus", "RightArm" },
        { "rradius", "RightForeArm" },
        { "rwrist", "RightHand" },
        { "rhand", "RightFingerBase" },
        { "rfingers", "RFingers" },
        { "rthumb", "RThumb" },
    };
    hg_clip *amc, *bvh;
    ok(hg_clip_read_amc(&amc, data("motions/cmu-asfamc/01.asf"), data("motions/cmu-asfamc/01_01.amc")));
    ok(hg_clip_read_bvh(&bvh, data("motions/cmu-bvh/01_01.bvh")));
    assert_int_equal(amc->frames, 2751);
    assert_int_equal(bvh->frames, 2751);
    assert_int_equal(amc->joints, 31);
    assert_int_equal(bvh->joints, 31);
    assert_true(amc->rate == 120 && bvh->rate == 120);
    int a[31], b[31];
    double offset[93], angle = 0, distance = 0, up_to_chest = 0;
    for (int i = 0; i < 31; i++) {
        a[i] = find(amc, pairs[i][0]);
        b[i] = find(bvh, pairs[i][1]);
        memcpy(offset + 3 * b[i], amc->offset + 3 * a[i], 3 * sizeof *offset);
    }
    hg_quatd amc_turn[31], bvh_turn[31];
    hg_vec3d amc_place[31], bvh_place[31], own_place[31];
    for (int64_t t = 0; t < amc->frames; t++) {
        pose(amc, t, amc->offset, amc_turn, amc_place);
        pose(bvh, t, bvh->offset, bvh_turn, own_place);
        pose(bvh, t, offset, bvh_turn, bvh_place);
        for (int i = 0; i < 31; i++) {
            double p[4], q[4];
            hg_quatd_store(p, amc_turn[a[i]]);
            hg_quatd_store(q, bvh_turn[b[i]]);
            angle = fmax(angle, angle_between(p, q));
            distance = fmax(distance, hg_vec3d_distance(amc_place[a[i]], bvh_place[b[i]]));
            if (i < 14) up_to_chest = fmax(up_to_chest, hg_vec3d_distance(amc_place[a[i]], own_place[b[i]]));
        }
    }
    print_message("01_01 as .amc and as .bvh: %.5f degrees, %.1f um (%.1f um with its own offsets up to the chest)\n",
                  angle, 1e6 * distance, 1e6 * up_to_chest);
    assert_true(angle < 0.0004 && distance < 10e-6 && up_to_chest < 10e-6);
    hg_clip_destroy(amc);
    hg_clip_destroy(bvh);
}

/* Offsets of this file are ten times those that its root's track is in. */
static void offsets_in_another_unit_are_noticed(void **state)
{
    (void)state;
    hg_clip *clip;
    ok(hg_clip_read_bvh(&clip, data("motions/cmu-bvh/102_01cc.bvh")));
    assert_int_equal(clip->frames, 277);
    double thigh = hg_vec3d_norm(hg_vec3d_load(clip->offset + 3 * find(clip, "lknee")));
    assert_true(fabs(thigh - 6.5811 * 0.0254 / 0.45) < 1e-4);
    double least =
        (double)INFINITY; /* the foot that stands hardly moves: metres per second, the lowest over the clip */
    hg_quatd turn[31];
    hg_vec3d place[31], before = { 0, 0, 0 };
    for (int64_t t = 0; t < clip->frames; t++) {
        pose(clip, t, clip->offset, turn, place);
        hg_vec3d foot = place[find(clip, "lfoot")];
        if (t > 0) least = fmin(least, hg_vec3d_distance(foot, before) * clip->rate);
        before = foot;
    }
    assert_true(least < 0.05);
    hg_clip_destroy(clip);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(numbers_are_those_of_strtod),
        cmocka_unit_test(small_tfx_reads),
        cmocka_unit_test(lying_tfx_is_refused),
        cmocka_unit_test(real_tfx),
        cmocka_unit_test(small_obj_reads),
        cmocka_unit_test(bad_obj_is_refused),
        cmocka_unit_test(small_body_reads),
        cmocka_unit_test(bad_bodies_are_refused),
        cmocka_unit_test(real_body_has_the_measured_shape),
        cmocka_unit_test(real_joints_are_those_of_the_rig),
        cmocka_unit_test(real_scalp_and_collider),
        cmocka_unit_test(real_shapes_have_the_measured_size),
        cmocka_unit_test(small_amc_reads),
        cmocka_unit_test(small_bvh_reads),
        cmocka_unit_test(bad_clips_are_refused),
        cmocka_unit_test(amc_and_bvh_agree),
        cmocka_unit_test(offsets_in_another_unit_are_noticed),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
