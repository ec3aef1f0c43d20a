/* Readers and writers of strands: small files written here, every truncation and many lies, round trips between all
 * formats, and the real grooms of ../shared/data where they are. */
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

/* It failed as HG_FORMAT, and the message names the file and holds a few words. */
static void refused(hg_status status, const char *path, const char *words)
{
    assert_int_equal(status, HG_FORMAT);
    if (!strstr(hg_message(), path) || !strstr(hg_message(), words))
        fail_msg("\"%s\" where \"%s\" is expected", hg_message(), words);
}

/* The three strands of small_files.h. */
static void is_small(const hg_curves *curves)
{
    assert_int_equal(curves->strands, 3);
    assert_int_equal(curves->start[0], 0);
    for (uint32_t s = 0; s < 3; s++) {
        assert_int_equal(curves->start[s + 1] - curves->start[s], small_counts[s]);
        for (uint32_t p = 0; p < small_counts[s]; p++) {
            float x[3];
            small_point(s, p, x);
            assert_memory_equal(x, curves->points + 3 * (curves->start[s] + p), sizeof x);
        }
    }
}

static void put(uint8_t *bytes, size_t offset, uint32_t value) { memcpy(bytes + offset, &value, 4); }

/* Every truncation is an error that names the file. */
static void cut_everywhere(const char *name, const uint8_t *bytes, size_t size)
{
    hg_curves *curves;
    for (size_t cut = 0; cut < size; cut++) {
        assert_int_equal(hg_curves_read(&curves, small_write(name, bytes, cut)), HG_FORMAT);
        assert_null(curves);
        assert_non_null(strstr(hg_message(), name));
    }
}

typedef struct {
    size_t at;
    uint32_t value;
    const char *words;
} lie;

static void lies_are_refused(const char *name, const uint8_t *bytes, size_t size, const lie *lies, size_t n)
{
    uint8_t changed[1024];
    hg_curves *curves;
    for (size_t i = 0; i < n; i++) {
        memcpy(changed, bytes, size);
        put(changed, lies[i].at, lies[i].value);
        refused(hg_curves_read(&curves, small_write(name, changed, size)), name, lies[i].words);
        assert_null(curves);
    }
}

/* ---- .hair -------------------------------------------------------------------------------------------------- */

static void hair_reads(void **state)
{
    (void)state;
    uint8_t bytes[1024];
    hg_curves *curves;
    size_t size = small_hair(true, bytes);
    ok(hg_curves_read(&curves, small_write("a.HAIR", bytes, size)));
    is_small(curves);
    hg_curves_destroy(curves);
    size_t plain = small_hair(false, bytes);
    ok(hg_curves_read(&curves, small_write("a.hair", bytes, plain)));
    assert_int_equal(curves->strands, 2);
    assert_int_equal(curves->start[2], 6);
    assert_true(curves->points[15] == 1 && curves->points[16] == 0.5F);
    hg_curves_destroy(curves);
}

static void bad_hair_is_refused(void **state)
{
    (void)state;
    uint8_t bytes[1024];
    static const lie ragged[] = {
        { 0, 0x4b4b4b4b, "does not begin with \"HAIR\"" },
        { 4, 0, "offset 4) says 0 strands" },
        { 4, 0xffffffff, "are there" },
        { 4, 2, "points together" },
        { 8, 0xffffffff, "are there" },
        { 8, 5, "points together" },
        { 12, 0, "no points" },
        { 12, 63, "bits 0x3f" },
        { 128, 0xffff, "points together" },
    };
    static const lie plain[] = {
        { 16, 3, "8 points would be needed" },
        { 16, 0xffffffff, "would be needed" },
        { 4, 0xffffffff, "would be needed" },
        { 12, 3, "are there" },
    };
    size_t size = small_hair(true, bytes);
    cut_everywhere("bad.hair", bytes, size);
    lies_are_refused("bad.hair", bytes, size, ragged, sizeof ragged / sizeof *ragged);
    size = small_hair(false, bytes);
    cut_everywhere("bad.hair", bytes, size);
    lies_are_refused("bad.hair", bytes, size, plain, sizeof plain / sizeof *plain);
}

/* ---- .data and .bin ----------------------------------------------------------------------------------------- */

static void data_reads(void **state)
{
    (void)state;
    uint8_t bytes[1024];
    hg_curves *curves;
    hg_groom_report report;
    for (size_t width = 3; width <= 7; width += 4) {
        const char *name = width == 3 ? "a.data" : "a.bin", *other = width == 3 ? "a.bin" : "a.data";
        size_t size = small_data(width, bytes);
        ok(hg_curves_read(&curves, small_write(name, bytes, size)));
        is_small(curves);
        ok(hg_curves_clean(curves, &report)); /* the bald root goes */
        assert_int_equal(report.strands, 3);
        assert_int_equal(report.bald, 1);
        assert_int_equal(curves->strands, 2);
        assert_int_equal(curves->start[2], 5);
        assert_true(curves->points[0] == 1 && curves->points[9] == 2);
        hg_curves_destroy(curves);
        refused(hg_curves_read(&curves, small_write(other, bytes, size)), other,
                width == 3 ? "call it .data" : "call it .bin");
    }
}

static void bad_data_is_refused(void **state)
{
    (void)state;
    uint8_t bytes[1024];
    for (size_t width = 3; width <= 7; width += 4) {
        const char *name = width == 3 ? "bad.data" : "bad.bin";
        size_t size = small_data(width, bytes);
        const lie lies[] = {
            { 0, 0, "says 0 strands" },
            { 0, 0xffffffff, "says -1 strands" },
            { 0, 0x7fffffff, "strands" },
            { 0, 2, "are left after the last of 2 strands" },
            { 0, 4, "number of vertices of a strand" },
            { 4, 0xffffffff, "strand 0 has -1 vertices (offset 4)" },
            { 4, 0x7fffffff, "the file ends after" },
            { 8 + 4 * width, 4, "" },
        };
        cut_everywhere(name, bytes, size);
        lies_are_refused(name, bytes, size, lies, sizeof lies / sizeof *lies);
    }
    hg_curves *curves;
    uint8_t nan[16] = { 1, 0, 0, 0, 0, 0, 0, 0 };
    hg_groom_report report; /* a strand of no vertex is bald, not a crash */
    ok(hg_curves_read(&curves, small_write("none.data", nan, 8)));
    assert_int_equal(hg_curves_clean(curves, &report), HG_INVALID);
    assert_non_null(strstr(hg_message(), "no strand is left of 1: 1 bald"));
    hg_curves_destroy(curves);
}

/* ---- .ply --------------------------------------------------------------------------------------------------- */

static void ply_reads(void **state)
{
    (void)state;
    uint8_t bytes[1024];
    hg_curves *curves;
    for (int i = 0; i < SMALL_PLYS + 2; i++) {
        if (i < SMALL_PLYS)
            ok(hg_curves_read(&curves, small_write_text("a.ply", small_ply[i])));
        else
            ok(hg_curves_read(&curves, small_write("a.ply", bytes, small_ply_binary(i > SMALL_PLYS, bytes))));
        if (i == 4) { /* by strand number: 3, 7, 9 */
            assert_int_equal(curves->strands, 3);
            assert_int_equal(curves->start[1], 1);
            assert_int_equal(curves->start[2], 4);
            assert_true(curves->points[0] == 0 && curves->points[10] == 0.5F && curves->points[12] == 2);
        } else {
            is_small(curves);
        }
        hg_curves_destroy(curves);
    }
}

#define HEAD   "ply\nformat ascii 1.0\n"
#define VERTEX "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
#define EDGE   "element edge 2\nproperty int vertex1\nproperty int vertex2\n"
#define POINTS "0 0 0\n0 1 0\n0 2 0\n"

static void bad_ply_is_refused(void **state)
{
    (void)state;
    static const struct {
        const char *text, *place, *words;
    } files[] = {
        { "", "b.ply", "no PLY file" },
        { "plywood", "b.ply", "no PLY file" },
        { "ply\n", "b.ply:", "ends within its header" },
        { "ply\nformat text 1.0\n", "b.ply:2", "expected ascii" },
        { HEAD "vertices 3\n", "b.ply:3", "no word of a PLY header" },
        { HEAD "property float x\n", "b.ply:3", "before the first element" },
        { HEAD "element vertex -1\n", "b.ply:3", "no count" },
        { HEAD "element vertex 3\nproperty real x\n", "b.ply:4", "not a type" },
        { HEAD "element vertex 3\nproperty list float int x\n", "b.ply:4", "length of a list" },
        { "ply\nelement vertex 3\nend_header\n", "b.ply:3", "without a line \"format\"" },
        { HEAD "end_header\n", "b.ply", "no element vertex" },
        { HEAD "element vertex 3\nproperty float x\nend_header\n1 2 3\n", "b.ply", "no x, y and z" },
        { HEAD "element vertex 999999999\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n",
          "b.ply", "999999999 rows of element vertex" },
        { HEAD "element vertex 0\nproperty float x\nproperty float y\nproperty float z\nend_header\n", "b.ply",
          "0 vertices" },
        { HEAD VERTEX "end_header\n" POINTS, "b.ply", "a cloud of 3 points" },
        { HEAD VERTEX "end_header\n0 0 0\n0 nan 0\n", "b.ply:", "not a finite number" },
        { HEAD VERTEX "end_header\n0 0 0\n0 1 0\n0 2\n", "b.ply:", "the file ends where" },
        { HEAD VERTEX "element face 1\nproperty list uchar int vertex_indices\nend_header\n" POINTS "3 0 1 2\n",
          "b.ply", "a mesh of 1 faces, strands are needed" },
        { HEAD VERTEX "element edge 0\nproperty int vertex1\nproperty int vertex2\nend_header\n" POINTS, "b.ply",
          "a cloud" },
        { HEAD VERTEX "element edge 1\nproperty int a\nproperty int b\nend_header\n" POINTS "0 1\n", "b.ply",
          "no vertex1 and vertex2" },
        { HEAD VERTEX EDGE "end_header\n" POINTS "0 1\n1 3\n", "b.ply", "edge 1 joins vertices 1 and 3" },
        { HEAD VERTEX EDGE "end_header\n" POINTS "0 1\n1 -1\n", "b.ply", "edge 1 joins" },
        { HEAD VERTEX EDGE "end_header\n" POINTS "0 1\n1 1\n", "b.ply", "edge 1 joins vertices 1 and 1" },
        { HEAD VERTEX EDGE "end_header\n" POINTS "0 1\n1 0\n", "b.ply", "make a ring" },
        { HEAD VERTEX EDGE "end_header\n" POINTS "0 1\n1 1.5\n", "b.ply:", "not an integer" },
        { HEAD VERTEX "element edge 3\nproperty int vertex1\nproperty int vertex2\nend_header\n" POINTS
                      "0 1\n0 2\n0 1\n",
          "b.ply", "vertex 0 has more than two edges" },
        { HEAD VERTEX "element strand 2\nproperty int nsegs\nend_header\n" POINTS "0\n2\n", "b.ply",
          "4 vertices by their segments" },
        { HEAD VERTEX "element strand 2\nproperty int nsegs\nend_header\n" POINTS "0\n-1\n", "b.ply", "-1 segments" },
        { HEAD VERTEX "element strand 2\nproperty int points\nend_header\n" POINTS "0\n-1\n", "b.ply", "neither" },
        { HEAD VERTEX "element line 1\nproperty list uchar int vertex_indices\nend_header\n" POINTS "2 0 3\n", "b.ply",
          "names vertex 3" },
        { HEAD VERTEX "element line 1\nproperty list char int vertex_indices\nend_header\n" POINTS "-2 0 3\n", "b.ply",
          "a list of -2" },
        { HEAD "element vertex 1\nproperty int strand\nproperty float x\nproperty float y\nproperty float z\n"
               "end_header\n-7 0 0 0\n",
          "b.ply", "vertex 0 is of strand -7" },
    };
    hg_curves *curves;
    for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
        refused(hg_curves_read(&curves, small_write_text("b.ply", files[i].text)), files[i].place, files[i].words);
        assert_null(curves);
    }
    uint8_t bytes[1024];
    size_t size = small_ply_binary(false, bytes);
    cut_everywhere("b.ply", bytes, size);
    size = strlen(small_ply[0]);
    cut_everywhere("b.ply", (const uint8_t *)small_ply[0], size - 2); /* "2 3" less its end is still "2 3" or "2" */
}

/* ---- .tfx --------------------------------------------------------------------------------------------------- */

static void tfx_has_root_uv(void **state)
{
    (void)state;
    uint8_t bytes[1024];
    float uv[6] = { 0.1F, 0.2F, 0.3F, 0.4F, 0.5F, 0.6F };
    hg_curves *curves;
    for (int version = 3; version <= 4; version++) {
        size_t size = small_tfx(version, bytes), offset = version == 4 ? 16 : 152;
        put(bytes, offset, (uint32_t)size);
        memcpy(bytes + size, uv, sizeof uv);
        ok(hg_curves_read(&curves, small_write("uv.tfx", bytes, size + sizeof uv)));
        assert_memory_equal(curves->root_uv, uv, sizeof uv);
        hg_curves_destroy(curves);
        refused(hg_curves_read(&curves, small_write("uv.tfx", bytes, size + sizeof uv - 1)), "uv.tfx", "UV of strands");
        put(bytes, offset, 8);
        refused(hg_curves_read(&curves, small_write("uv.tfx", bytes, size)), "uv.tfx", "inside the header");
        put(bytes, offset, 0xfffffff0);
        refused(hg_curves_read(&curves, small_write("uv.tfx", bytes, size)), "uv.tfx", "is said to begin at");
    }
}

static void transformed_tfx_is_refused(void **state)
{
    (void)state;
    static const char *const lines[] = { "scale 2", "rotation 0 90 0", "translation 0 0 0.5", "scale x" };
    char text[512];
    hg_curves *curves;
    for (int i = 0; i < 4; i++) {
        snprintf(text, sizeof text, "version 2.0\n%s\n%s", lines[i], strchr(small_tfx2, '\n') + 1);
        refused(hg_curves_read(&curves, small_write_text("t.tfx", text)), "t.tfx:2", "cannot be read");
    }
}

/* ---- HDF5 --------------------------------------------------------------------------------------------------- */

static void vtkhdf_reads(void **state)
{
    (void)state;
    static const int64_t start[] = { 0, 1, 4, 6 };
    float points[2][18];
    hg_vtkhdf *file;
    hg_curves *curves;
    const char *path = small_path("two.vtkhdf");
    for (uint32_t s = 0, i = 0; s < 3; s++)
        for (uint32_t p = 0; p < small_counts[s]; p++, i++) {
            small_point(s, p, points[1] + 3 * i);
            small_point(s + 7, p, points[0] + 3 * i);
        }
    ok(hg_vtkhdf_create_polylines(&file, path, 2, 3, start, 30));
    ok(hg_vtkhdf_add(file, points[0]));
    ok(hg_vtkhdf_add(file, points[1]));
    ok(hg_vtkhdf_commit(file));
    ok(hg_curves_read_frame(&curves, path, 1));
    is_small(curves);
    hg_curves_destroy(curves);
    ok(hg_curves_read(&curves, path));
    assert_memory_equal(curves->points, points[0], sizeof points[0]);
    hg_curves_destroy(curves);
    assert_int_equal(hg_curves_read_frame(&curves, path, 2), HG_INVALID);
    assert_non_null(strstr(hg_message(), "two.vtkhdf: frame 2: it has frames 0 to 1"));
    assert_int_equal(hg_curves_read_frame(&curves, small_write_text("a.ply", small_ply[0]), 1), HG_INVALID);
    assert_non_null(strstr(hg_message(), "one frame"));
    ok(hg_vtkhdf_create_mesh(&file, path, 1, 6, 1, (int32_t[]){ 0, 1, 2 }, 30));
    ok(hg_vtkhdf_add(file, points[0]));
    ok(hg_vtkhdf_commit(file));
    refused(hg_curves_read(&curves, path), "two.vtkhdf", "no polylines");
}

/* ---- round trips -------------------------------------------------------------------------------------------- */

/* Every format that can hold these strands gives them back bit for bit. */
static void round_trip(const hg_curves *curves, const char *const *paths, int n)
{
    for (int i = 0; i < n; i++) {
        const char *slash = strchr(paths[i], '/');
        char name[64];
        snprintf(name, sizeof name, "%.*s", slash ? (int)(slash - paths[i]) : 63, paths[i]);
        const char *path = small_path(name);
        hg_curves *back;
        ok(hg_curves_write(curves, path, slash ? slash + 1 : NULL));
        ok(hg_curves_read(&back, path));
        assert_int_equal(back->strands, curves->strands);
        assert_memory_equal(back->start, curves->start, (size_t)(curves->strands + 1) * sizeof *curves->start);
        assert_memory_equal(back->points, curves->points, (size_t)curves->start[curves->strands] * 12);
        hg_curves_destroy(back);
    }
}

static const char *const ragged_formats[] = {
    "r.hair", "r.data", "r.bin", "r.ply", "r.ply/ascii", "r.npz", "r.vtkhdf"
};
static const char *const equal_formats[] = { "e.hair", "e.data", "e.bin",   "e.ply",   "e.ply/ascii", "e.npz",
                                             "e.npy",  "e.tfx",  "e.tfx/3", "e.tfx/4", "e.vtkhdf",    "e.h5" };
enum { RAGGED = sizeof ragged_formats / sizeof *ragged_formats, EQUAL = sizeof equal_formats / sizeof *equal_formats };

static void round_trips(void **state)
{
    (void)state;
    uint8_t bytes[1024];
    hg_curves *curves;
    ok(hg_curves_read(&curves, small_write("s.data", bytes, small_data(3, bytes))));
    for (int64_t i = 0; i < 18; i++) curves->points[i] += (float)hg_random_normal(1, 2, (uint64_t)i); /* all digits */
    round_trip(curves, ragged_formats, RAGGED);
    const char *const equal[] = { "x.tfx", "x.h5" };
    for (int i = 0; i < 2; i++) {
        assert_int_equal(hg_curves_write(curves, small_path(equal[i]), NULL), HG_INVALID);
        assert_non_null(strstr(hg_message(), "strand 0 has 1 vertices and strand 1 has 3"));
        assert_false(hg_file_exists(small_path(equal[i])));
    }
    assert_int_equal(hg_curves_write(curves, small_path("x.xyz"), NULL), HG_UNSUPPORTED);
    assert_non_null(strstr(hg_message(), ".data (USC-HairSalon"));
    assert_int_equal(hg_curves_write(curves, small_path("x.ply"), "text"), HG_INVALID);
    assert_non_null(strstr(hg_message(), "no variant \"text\"; known are binary|ascii"));
    assert_int_equal(hg_curves_write(curves, small_path("x.hair"), "text"), HG_INVALID);
    assert_int_equal(hg_curves_write(curves, small_path("none/x.hair"), NULL), HG_IO);
    float kept = curves->points[4];
    curves->points[4] = NAN; /* bytes can hold it, text cannot */
    ok(hg_curves_write(curves, small_path("nan.data"), NULL));
    assert_int_equal(hg_curves_write(curves, small_path("nan.obj"), NULL), HG_INVALID);
    assert_non_null(strstr(hg_message(), "strand 1 is not finite"));
    assert_int_equal(hg_curves_write(curves, small_path("nan.ply"), "ascii"), HG_INVALID);
    ok(hg_curves_write(curves, small_path("nan.ply"), "binary"));
    curves->points[4] = kept;
    hg_groom_report report;
    ok(hg_curves_clean(curves, &report));
    ok(hg_curves_resample(curves, 9));
    round_trip(curves, equal_formats, EQUAL);
    curves->root_uv = hg_alloc(2, 2 * sizeof *curves->root_uv);
    curves->root_uv[3] = 0.75F;
    hg_curves *back;
    static const char *const with_uv[] = { "u.tfx", "u.npz" };
    for (int i = 0; i < 2; i++) {
        ok(hg_curves_write(curves, small_path(with_uv[i]), NULL));
        ok(hg_curves_read(&back, small_path(with_uv[i])));
        assert_non_null(back->root_uv);
        assert_memory_equal(back->root_uv, curves->root_uv, 4 * sizeof *back->root_uv);
        hg_curves_destroy(back);
    }
    hg_curves_destroy(curves);
}

/* A bound groom written and read again is the same groom. */
static void bound_groom_stays_bound(void **state)
{
    (void)state;
    hg_body *body;
    hg_groom *groom, *back;
    hg_curves *curves;
    ok(small_body(&body));
    ok(small_groom(&groom, body));
    groom->body_hash = hg_body_hash(body);
    const char *path = small_path("bound.h5"), *copy = small_path("copy.h5");
    ok(hg_groom_save(groom, path));
    ok(hg_curves_read(&curves, path));
    ok(hg_curves_write(curves, copy, NULL));
    ok(hg_groom_load(&back, copy));
    assert_true(hg_groom_hash(back) == hg_groom_hash(groom));
    hg_groom_destroy(back);
    ok(hg_curves_select(curves, 1, (int64_t[]){ 1 }));
    ok(hg_curves_write(curves, copy, NULL));
    ok(hg_groom_load(&back, copy));
    assert_int_equal(back->strands, 1);
    assert_int_equal(back->root_face[0], groom->root_face[1]);
    assert_true(back->root_bary[0] == 1 && back->body_hash == groom->body_hash);
    hg_groom_destroy(back);
    hg_groom_destroy(groom);
    hg_curves_destroy(curves);
    hg_body_destroy(body);
}

static void strands_are_chosen(void **state)
{
    (void)state;
    uint8_t bytes[1024];
    hg_curves *curves;
    ok(hg_curves_read(&curves, small_write("s.data", bytes, small_data(3, bytes))));
    assert_int_equal(hg_curves_select(curves, 2, (int64_t[]){ 1, 1 }), HG_INVALID);
    assert_int_equal(hg_curves_select(curves, 1, (int64_t[]){ 3 }), HG_INVALID);
    hg_curves_destroy(curves);
    ok(hg_curves_read(&curves, small_path("s.data")));
    ok(hg_curves_select(curves, 2, (int64_t[]){ 0, 2 }));
    assert_int_equal(curves->strands, 2);
    assert_int_equal(curves->start[1], 1);
    assert_int_equal(curves->start[2], 3);
    assert_true(curves->points[3] == 2 && curves->points[7] == 0.25F);
    assert_int_equal(hg_curves_resample(curves, 5), HG_INVALID); /* strand 0 is bald */
    assert_int_equal(hg_curves_resample(curves, 1), HG_INVALID);
    hg_curves_to_world(curves, 0.5, true);
    assert_true(curves->points[6] == 1 && curves->points[7] == -0.25F && curves->points[8] == -0.125F);
    hg_curves_from_world(curves, 0.5, true);
    assert_true(curves->points[6] == 2 && curves->points[7] == 0.25F && curves->points[8] == -0.5F);
    hg_curves_destroy(curves);
}

/* Real grooms through every format. */
static void real_round_trips(void **state)
{
    (void)state;
    static const char *const names[] = { "sintel-16pt/SintelHairOriginal-sintel_hair.16points.tfx",
                                         "fibermesh2/Fibermesh2_mohi0.3k_Curves.tfx" };
    for (int i = 0; i < 2; i++) {
        char path[1024];
        const char *source = getenv("HG_SOURCE");
        hg_curves *curves;
        snprintf(path, sizeof path, "%s/../shared/data/grooms/%s", source ? source : ".", names[i]);
        if (!hg_file_exists(path)) skip();
        ok(hg_curves_read(&curves, path));
        round_trip(curves, equal_formats, EQUAL);
        hg_curves_destroy(curves);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(hair_reads),
        cmocka_unit_test(bad_hair_is_refused),
        cmocka_unit_test(data_reads),
        cmocka_unit_test(bad_data_is_refused),
        cmocka_unit_test(ply_reads),
        cmocka_unit_test(bad_ply_is_refused),
        cmocka_unit_test(tfx_has_root_uv),
        cmocka_unit_test(transformed_tfx_is_refused),
        cmocka_unit_test(vtkhdf_reads),
        cmocka_unit_test(round_trips),
        cmocka_unit_test(bound_groom_stays_bound),
        cmocka_unit_test(strands_are_chosen),
        cmocka_unit_test(real_round_trips),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
