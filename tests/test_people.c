/* Strands, bodies and clips from NumPy's files: small ones written here, lies, and clips of SMPL's joints on other rigs. */
#include "tests/small_arrays.h"
#include "tests/small_people.h"
#include "tests/test.h"

static void ok(hg_status status)
{
    if (status != HG_OK) fail_msg("%s: %s", hg_status_name(status), hg_message());
}

/* The message names the file and holds a few words. */
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

/* ---- strands ------------------------------------------------------------------------------------------------- */

static const char *written(int n, const npz_item *items)
{
    const char *path = small_path("hair.npz");
    ok(npz_write(path, n, items));
    return path;
}

static void strands_of_every_layout(void **state)
{
    (void)state;
    float points[12], roots[6] = { 1, 2, 3, 4, 5, 6 }, uv[4] = { 0.25F, 0.5F, 0.75F, 1 };
    for (int i = 0; i < 12; i++) points[i] = (float)(i * i);
    const int32_t counts[] = { 3, 1 }, offsets[] = { 0, 3 }, ends[] = { 0, 3, 4 };
    hg_curves *curves;
    npz_item even[] = { { "positions", HG_F32, 3, { 2, 2, 3 }, points }, { "root_uv", HG_F32, 2, { 2, 2 }, uv } };
    ok(hg_curves_read(&curves, written(2, even)));
    assert_true(curves->strands == 2 && curves->start[1] == 2 && curves->start[2] == 4);
    assert_memory_equal(curves->points, points, sizeof points);
    assert_memory_equal(curves->root_uv, uv, sizeof uv);
    hg_curves_destroy(curves);
    ok(npz_write(small_path("hair.npy"), 1, even));
    ok(hg_curves_read(&curves, small_path("hair.npy")));
    assert_memory_equal(curves->points, points, sizeof points);
    hg_curves_destroy(curves);

    npz_item ragged[] = { { "points", HG_F32, 2, { 4, 3 }, points }, { "counts", HG_I32, 1, { 2 }, counts } };
    npz_item others[] = { ragged[1], { "offsets", HG_I32, 1, { 2 }, offsets }, { "offsets", HG_I32, 1, { 3 }, ends } };
    for (int i = 0; i < 3; i++) {
        ragged[1] = others[i];
        ok(hg_curves_read(&curves, written(2, ragged)));
        assert_true(curves->strands == 2 && curves->start[1] == 3 && curves->start[2] == 4);
        hg_curves_destroy(curves);
    }
    /* from their roots */
    float from[12] = { 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 2, 0 };
    npz_item rooted[] = { { "strands", HG_F32, 3, { 2, 2, 3 }, from }, { "roots", HG_F32, 2, { 2, 3 }, roots } };
    ok(hg_curves_read(&curves, written(2, rooted)));
    assert_true(curves->points[0] == 1 && curves->points[4] == 3 && curves->points[6] == 4 && curves->points[10] == 7);
    hg_curves_destroy(curves);
    memcpy(from, roots, 12), memcpy(from + 6, roots + 3, 12); /* beginning with them */
    ok(hg_curves_read(&curves, written(2, rooted)));
    assert_memory_equal(curves->points, from, sizeof from);
    hg_curves_destroy(curves);
    from[6] = 9;
    refused(hg_curves_read(&curves, written(2, rooted)), "hair.npz", "neither begin");
}

static void lying_strands_are_refused(void **state)
{
    (void)state;
    float points[12] = { 0 };
    const int32_t lies[][3] = { { 3, 2, 0 }, { 3, -1, 0 }, { 2, 1, 0 }, { 0, 5, 0 }, { 1, 3, 0 }, { 0, 3, 2 } };
    hg_curves *curves;
    for (int i = 0; i < 6; i++) {
        npz_item items[] = { { "points", HG_F32, 2, { 4, 3 }, points },
                             { i < 3 ? "counts" : "offsets", HG_I32, 1, { i == 5 ? 3 : 2 }, lies[i] } };
        refused(hg_curves_read(&curves, written(2, items)), "hair.npz", i < 3 ? "counts" : "offsets");
        assert_null(curves);
    }
    npz_item alone[] = { { "points", HG_F32, 2, { 4, 3 }, points }, { "other", HG_F32, 1, { 3 }, points } };
    refused(hg_curves_read(&curves, written(2, alone)), "hair.npz", "counts or offsets");
    refused(hg_curves_read(&curves, written(1, alone + 1)), "hair.npz", "there are other [3] f4");
    alone[0].rank = 3, alone[0].shape[1] = 1;
    refused(hg_curves_read(&curves, written(1, alone)), "hair.npz", "has the shape [4,1,0]");
}

/* ---- bodies -------------------------------------------------------------------------------------------------- */

static void an_smpl_like_body_reads(void **state)
{
    (void)state;
    hg_body *body;
    hg_text notes = { 0 };
    const float corrective = 0;
    npz_item posedirs = { "posedirs", HG_F32, 1, { 1 }, &corrective };
    ok(hg_body_read(NULL, &body, small_smpl("smpl.npz", &posedirs), NULL, &notes));
    assert_true(body->vertices == 8 && body->faces == 12 && body->joints == 24);
    assert_string_equal(body->joint_name[15], "head");
    assert_int_equal(body->parent[0], -1);
    assert_int_equal(body->parent[15], 12);
    assert_int_equal(hg_body_joint(body, "Head"), 15);
    assert_int_equal(hg_body_joint(body, "LeftForeArm"), 18);
    assert_int_equal(hg_body_joint(body, "Neck1"), -1);
    near((double)body->joint[3 * 15 + 1], 0.72, 1e-6);
    assert_memory_equal(body->points, small_head, sizeof small_head);
    int neck = body->influence[0] == 12 ? 0 : 1;
    assert_true(body->influence[neck] == 12 && body->influence[1 - neck] == 15);
    near((double)body->weight[neck], 0.25, 1e-6);
    near((double)body->weight[1 - neck], 0.75, 1e-6);
    for (int v = 0; v < 8; v++) { /* the template's own x; up for the upper corners; no third shape */
        assert_true(body->shapes[3 * v] == small_head[v][0] && body->shapes[3 * v + 1] == 0);
        assert_true(body->shapes[24 + 3 * v + 1] == (v >= 2 ? 0.02F : 0));
        assert_true(body->shapes[48 + 3 * v] == 0);
    }
    assert_string_equal(body->shape_name[1], "beta_1");
    assert_true(body->shape_spread[1] == 0.5 && body->shape_spread[2] == 0);
    assert_true(body->scalp_faces > 0 && body->collider_faces == 12);
    assert_non_null(strstr(notes.data, "posedirs: not used"));
    assert_non_null(strstr(notes.data, "do not follow the shape"));
    hg_text_free(&notes);
    ok(hg_body_save(body, small_path("body.h5")));
    hg_body_destroy(body);

    /* unit, axes, scalp by radius and by number */
    hg_import with = { .unit = 0.01, .up = 'z' };
    ok(hg_body_read(NULL, &body, small_path("smpl.npz"), &with, NULL));
    near((double)body->points[1], -0.0003, 1e-7);
    near((double)body->points[2], -0.0070, 1e-7);
    near((double)body->shapes[24 + 3 * 7 + 2], -0.0002, 1e-9);
    hg_body_destroy(body);
    with = (hg_import){ .scalp = "1 m" };
    ok(hg_body_read(NULL, &body, small_path("smpl.npz"), &with, NULL));
    assert_int_equal(body->scalp_faces, 12);
    hg_body_destroy(body);
    with = (hg_import){ .scalp = small_write_text("faces.txt", "# of the scalp\n9 8\n2\n9\n") };
    ok(hg_body_read(NULL, &body, small_path("smpl.npz"), &with, NULL));
    assert_true(body->scalp_faces == 3 && body->scalp[0] == 2 && body->scalp[1] == 8 && body->scalp[2] == 9);
    hg_body_destroy(body);
    with.scalp = small_write_text("faces.txt", "12\n");
    refused(hg_body_read(NULL, &body, small_path("smpl.npz"), &with, NULL), "faces.txt", "face 12");
    with.scalp = "nearby";
    refused(hg_body_read(NULL, &body, small_path("smpl.npz"), &with, NULL), "nearby", "neither a file");
}

/* The regressor dense, and by rows, columns and pairs: the same joints, which follow the shapes. */
static void regressors_of_every_layout(void **state)
{
    (void)state;
    static float dense[24][8];
    int32_t row[24 * 8], column[24 * 8], rows[25], columns[9];
    double data[24 * 8], by_column[24 * 8];
    int32_t row_of[24 * 8];
    int n = 0, m = 0;
    for (int j = 0; j < 24; j++) {
        rows[j] = n;
        for (int v = 0; v < 8; v++) {
            dense[j][v] = (j + v) % 3 == 0 ? 0.125F * (float)(1 + j % 4) : 0;
            if (dense[j][v] == 0) continue;
            row[n] = j, column[n] = v, data[n++] = (double)dense[j][v];
        }
    }
    rows[24] = n;
    for (int v = 0; v < 8; v++) {
        columns[v] = m;
        for (int j = 0; j < 24; j++)
            if (dense[j][v] != 0) row_of[m] = j, by_column[m++] = (double)dense[j][v];
    }
    columns[8] = m;
    npz_item base[] = { { "J_regressor", HG_F32, 2, { 24, 8 }, dense } };
    npz_item csr[] = { { "J_regressor_data", HG_F64, 1, { n }, data },
                       { "J_regressor_indices", HG_I32, 1, { n }, column },
                       { "J_regressor_indptr", HG_I32, 1, { 25 }, rows } };
    npz_item csc[] = { { "J_regressor.data", HG_F64, 1, { n }, by_column },
                       { "J_regressor.indices", HG_I32, 1, { n }, row_of },
                       { "J_regressor.indptr", HG_I32, 1, { 9 }, columns } };
    npz_item coo[] = { { "J_regressor_data", HG_F64, 1, { n }, data },
                       { "J_regressor_row", HG_I32, 1, { n }, row },
                       { "J_regressor_col", HG_I32, 1, { n }, column } };
    static float weights[8][24], shapes[8][3][2];
    for (int v = 0; v < 8; v++) weights[v][15] = 1, shapes[v][0][0] = small_head[v][0], shapes[v][1][1] = 0.02F;
    struct {
        int n;
        npz_item *items;
    } layouts[] = { { 1, base }, { 3, csr }, { 3, csc }, { 3, coo } };
    hg_body *body;
    for (int l = 0; l < 4; l++) {
        npz_item items[8] = { { "v_template", HG_F32, 2, { 8, 3 }, small_head },
                              { "f", HG_I32, 2, { 12, 3 }, small_faces },
                              { "weights", HG_F32, 2, { 8, 24 }, weights },
                              { "shapedirs", HG_F32, 3, { 8, 3, 2 }, shapes } };
        memcpy(items + 4, layouts[l].items, (size_t)layouts[l].n * sizeof *items);
        ok(npz_write(small_path("r.npz"), 4 + layouts[l].n, items));
        ok(hg_body_read(NULL, &body, small_path("r.npz"), NULL, NULL));
        for (int j = 0; j < 24; j++)
            for (int k = 0; k < 3; k++) {
                double at = 0, wide = 0, high = 0;
                for (int v = 0; v < 8; v++) {
                    at += (double)dense[j][v] * (double)small_head[v][k];
                    wide += k == 0 ? (double)dense[j][v] * (double)small_head[v][0] : 0;
                    high += k == 1 ? (double)dense[j][v] * 0.02 : 0;
                }
                near((double)body->joint[3 * j + k], at, 1e-6);
                near((double)body->joint_shapes[3 * j + k], wide, 1e-6);
                near((double)body->joint_shapes[3 * (24 + j) + k], high, 1e-6);
            }
        hg_body_destroy(body);
        if (l == 0) continue;
        int32_t *lie = l == 1 ? rows + 3 : l == 2 ? columns + 3 : column + 2, kept = *lie;
        *lie = 200;
        ok(npz_write(small_path("r.npz"), 4 + layouts[l].n, items));
        refused(hg_body_read(NULL, &body, small_path("r.npz"), NULL, NULL), "r.npz", "entry");
        *lie = kept;
    }
}

static void lying_bodies_are_refused(void **state)
{
    (void)state;
    static float weights[8][24], places[24][3], shapes[8][3];
    static int32_t tree[2][24], faces[12][3];
    hg_body *body;
    weights[0][0] = -1;
    for (int j = 1; j < 24; j++) tree[0][j] = j;
    memcpy(faces, small_faces, sizeof faces);
    faces[5][1] = 8;
    places[3][1] = NAN;
    shapes[2][0] = INFINITY;
    const struct {
        npz_item item;
        const char *words;
    } lies[] = {
        { { "weights", HG_F32, 2, { 8, 24 }, weights }, "negative weight" },
        { { "weights", HG_F32, 2, { 7, 24 }, weights }, "[7,24], expected [8,24]" },
        { { "weights", HG_F32, 1, { 8 }, weights }, "expected [N,J]" },
        { { "f", HG_I32, 2, { 12, 3 }, faces }, "f: entry 16 is 8" },
        { { "f", HG_I32, 2, { 0, 3 }, faces }, "no surface" },
        { { "kintree_table", HG_I32, 2, { 2, 24 }, tree }, "parent 1" },
        { { "kintree_table", HG_I32, 2, { 2, 23 }, tree }, "[2,23]" },
        { { "J", HG_F32, 2, { 24, 3 }, places }, "not finite" },
        { { "J", HG_F32, 2, { 22, 3 }, places }, "[22,3]" },
        { { "shapedirs", HG_F32, 3, { 8, 3, 1 }, shapes }, "not finite" },
        { { "v_template", HG_F32, 2, { 2, 3 }, small_head }, "no surface" },
        { { "v_template", HG_F32, 2, { 6, 4 }, shapes }, "[6,4], expected [any,3]" },
        { { "joint_names", HG_F32, 1, { 24 }, weights }, "no text" },
    };
    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        refused(hg_body_read(NULL, &body, small_smpl("lie.npz", &lies[i].item), NULL, NULL), "lie.npz", lies[i].words);
        assert_null(body);
    }
    static small_zip zip; /* as Python's pickle stores what is no array */
    uint8_t npy[1024];
    memset(&zip, 0, sizeof zip);
    small_zip_add(&zip, "v_template", npy, small_npy(npy, "'<f4'", false, "8,3", small_head, sizeof small_head), true);
    small_zip_add(&zip, "f", npy, small_npy(npy, "'<i4'", false, "12,3", small_faces, sizeof small_faces), true);
    memset(weights, 0, sizeof weights);
    for (int v = 0; v < 8; v++) weights[v][15] = 1;
    small_zip_add(&zip, "weights", npy, small_npy(npy, "'<f4'", false, "8,24", weights, sizeof weights), true);
    small_zip_add(&zip, "J_regressor", npy, small_npy(npy, "'|O'", false, "", "\x80\x03.", 3), true);
    small_zip_end(&zip);
    refused(hg_body_read(NULL, &body, small_write("lie.npz", zip.bytes, zip.size), NULL, NULL), "lie.npz", "pickled");
    refused(hg_body_read(NULL, &body, small_write_text("body.pkl", "x"), NULL, NULL), "body.pkl", "known are");
}

/* ---- clips --------------------------------------------------------------------------------------------------- */

static hg_quatd global_turn(const hg_body *body, const hg_motion *motion, int64_t frame, int joint)
{
    hg_quatd q = hg_quatd_identity();
    for (int j = joint; j >= 0; j = body->parent[j])
        q = hg_quatd_mul(hg_quatd_from_f(hg_quatf_load(motion->rotation + 4 * (frame * motion->joints + j))), q);
    return q;
}

static double degrees_between(hg_quatd a, hg_quatd b)
{
    return hg_vec3d_norm(hg_quatd_to_rotation_vector(hg_quatd_mul(hg_quatd_conj(a), b))) * 180 / 3.14159265358979323846;
}

static hg_quatd about(double x, double y, double z) { return hg_quatd_from_rotation_vector(hg_vec3d_make(x, y, z)); }

/* On a body of SMPL's joints rotations stay as they are; the root's is turned from Z-up to Y-up. */
static void an_amass_clip_moves_an_smpl_body(void **state)
{
    (void)state;
    hg_body *body;
    hg_clip *clip;
    hg_motion *motion;
    hg_text notes = { 0 };
    ok(hg_body_read(NULL, &body, small_smpl("smpl.npz", NULL), NULL, NULL));
    hg_import with = { .body = body };
    ok(hg_clip_read(&clip, small_amass("clip.npz", NULL), &with, &notes));
    assert_true(clip->joints == 24 && clip->frames == 5 && clip->rate == 60);
    assert_non_null(strstr(notes.data, "betas: 0.5,-1,0"));
    assert_null(strstr(notes.data, "mean person"));
    hg_text_free(&notes);
    ok(hg_clip_retarget(&motion, clip, body, 60));
    assert_int_equal(motion->frames, 5);
    for (int t = 0; t < 5; t++)
        for (int j = 0; j < 24; j++) {
            hg_quatd q = hg_quatd_from_f(hg_quatf_load(motion->rotation + 4 * (24 * t + j)));
            double lift = -0.3 * t;
            hg_quatd expected = j == 15   ? about(0, 0.2 * t, 0)
                                : j == 12 ? about(0.1 * t, 0, 0)
                                : j == 16 ? about(0, 0, lift)
                                          : hg_quatd_identity(); /* the root stands: 90 degrees and back */
            assert_true(degrees_between(q, expected) < 1e-3);
        }
    /* SMPL's root joint stands at J0 + trans, J0 in the body's own axes. Here J0 = (0, -0.2, 0). */
    for (int t = 0; t < 5; t++) {
        near((double)motion->translation[3 * t], 0.01 * t, 1e-6);
        near((double)motion->translation[3 * t + 1], 1.1 + 0.2, 1e-6);
        near((double)motion->translation[3 * t + 2], 0.1 * t + 0.2, 1e-6);
    }
    hg_motion_destroy(motion);
    hg_clip_destroy(clip);

    with.up = 'y', with.unit = 0.01;
    ok(hg_clip_read(&clip, small_path("clip.npz"), &with, NULL));
    near(clip->translation[3 * 4 + 1], -0.004, 1e-6);
    assert_true(degrees_between(hg_quatd_load(clip->rotation), about(1.5707963, 0, 0)) < 1e-4);
    hg_clip_destroy(clip);
    hg_body_destroy(body);
}

/* Quaternions, poses in parts, other names of the rate, 22 joints. */
static void clips_of_every_layout(void **state)
{
    (void)state;
    static double quaternions[2][24][4], root[3][3], parts[3][63];
    static const float rate = 30;
    hg_clip *clip;
    for (int i = 0; i < 48; i++) quaternions[i / 24][i % 24][0] = 2, quaternions[i / 24][i % 24][3] = i == 30 ? 2 : 0;
    npz_item items[] = { { "poses", HG_F64, 3, { 2, 24, 4 }, quaternions }, { "fps", HG_F32, 1, { 1 }, &rate } };
    ok(npz_write(small_path("q.npz"), 2, items));
    ok(hg_clip_read(&clip, small_path("q.npz"), NULL, NULL));
    assert_true(clip->frames == 2 && clip->joints == 24 && clip->rate == 30);
    assert_true(degrees_between(hg_quatd_load(clip->rotation + 4 * 30), about(0, 0, 1.5707963267949)) < 1e-6);
    hg_clip_destroy(clip);
    parts[1][3 * 14] = 0.5; /* joint 15 */
    npz_item in_parts[] = { { "root_orient", HG_F64, 2, { 3, 3 }, root },
                            { "pose_body", HG_F64, 2, { 3, 63 }, parts },
                            { "mocap_frame_rate", HG_F32, 0, { 0 }, &rate } };
    ok(npz_write(small_path("p.npz"), 3, in_parts));
    ok(hg_clip_read(&clip, small_path("p.npz"), NULL, NULL));
    assert_true(clip->frames == 3 && clip->joints == 22);
    assert_true(degrees_between(hg_quatd_load(clip->rotation + 4 * (22 + 15)), about(0.5, 0, 0)) < 1e-6);
    hg_clip_destroy(clip);
}

static void lying_clips_are_refused(void **state)
{
    (void)state;
    static float poses[5][72], way[5][3];
    const double none = 0, betas[2] = { 1, NAN };
    hg_clip *clip;
    poses[3][7] = NAN;
    way[1][2] = INFINITY;
    const struct {
        npz_item item;
        const char *words;
    } lies[] = {
        { { "poses", HG_F32, 2, { 5, 72 }, poses }, "frame 3 has a number that is not finite (column 7)" },
        { { "poses", HG_F32, 2, { 5, 71 }, poses }, "expected SMPL's 24" },
        { { "poses", HG_F32, 2, { 5, 69 }, poses }, "23 joints" },
        { { "poses", HG_F32, 2, { 0, 72 }, poses }, "0 frames" },
        { { "poses", HG_F32, 3, { 5, 12, 6 }, poses }, "[5,12,6]" },
        { { "trans", HG_F32, 2, { 5, 3 }, way }, "frame 1" },
        { { "trans", HG_F32, 2, { 4, 3 }, way }, "[4,3], expected [5,3]" },
        { { "mocap_framerate", HG_F64, 0, { 0 }, &none }, "frames per second" },
        { { "mocap_framerate", HG_F64, 1, { 2 }, betas }, "one number" },
        { { "betas", HG_F64, 1, { 2 }, betas }, "entry 1" },
    };
    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        refused(hg_clip_read(&clip, small_amass("lie.npz", &lies[i].item), NULL, NULL), "lie.npz", lies[i].words);
        assert_null(clip);
    }
    npz_item alone = { "poses", HG_F32, 2, { 1, 72 }, poses };
    ok(npz_write(small_path("lie.npz"), 1, &alone));
    refused(hg_clip_read(&clip, small_path("lie.npz"), NULL, NULL), "lie.npz", "no frame rate");
    hg_import with = { .skeleton = small_path("none.npz") };
    assert_int_equal(hg_clip_read(&clip, small_amass("clip.npz", NULL), &with, NULL), HG_IO);
}

/* On the bust, whose joints have other names: the head's rotation in the world is the clip's. */
static void an_amass_clip_moves_another_rig(void **state)
{
    (void)state;
    hg_body *body;
    hg_clip *clip;
    hg_motion *motion;
    hg_text notes = { 0 };
    ok(hg_bust_create(&body));
    hg_import with = { .body = body };
    ok(hg_clip_read(&clip, small_amass("clip.npz", NULL), &with, &notes));
    assert_non_null(strstr(notes.data, "mean person"));
    hg_text_free(&notes);
    ok(hg_clip_retarget(&motion, clip, body, 60));
    int head = hg_body_joint(body, "Head"), arm = hg_body_joint(body, "LeftArm");
    for (int t = 0; t < 5; t++) {
        hg_quatd expected = hg_quatd_mul(about(0.1 * t, 0, 0), about(0, 0.2 * t, 0));
        assert_true(degrees_between(global_turn(body, motion, t, head), expected) < 1e-3);
        hg_quatd lift =
            hg_quatd_mul(global_turn(body, motion, t, arm), hg_quatd_conj(global_turn(body, motion, 0, arm)));
        assert_true(degrees_between(lift, about(0, 0, -0.3 * t)) < 1e-3);
    }
    hg_motion_destroy(motion);
    hg_clip_destroy(clip);
    hg_body_destroy(body);
}

/* The body of ../shared/data as an SMPL-like one: its scalp, whose faces are known, is found again within a few per cent. */
static void a_scalp_is_found(void **state)
{
    (void)state;
    const char *source = getenv("HG_SOURCE");
    char folder[1024];
    snprintf(folder, sizeof folder, "%s/../shared/data/bodies", source ? source : ".");
    if (!hg_file_exists(folder)) skip();
    hg_body *known, *found;
    ok(hg_body_read(NULL, &known, folder, NULL, NULL));
    float *weights = hg_alloc((size_t)known->vertices, 24 * sizeof *weights), places[24][3];
    assert_non_null(weights);
    small_places(places);
    for (int64_t i = 0; i < known->vertices * HG_INFLUENCES; i++) {
        int joint = -1;
        for (int j = known->influence[i]; joint < 0;
             j = known->parent[j]) { /* those that SMPL lacks: with the one above */
            const joint_row *row = joints_row(known->joint_name[j], JOINTS_OWN);
            for (int k = 0; row->name[JOINTS_SMPL] && joint < 0 && k < 24; k++)
                if (!strcmp(joints_smpl(24)[k], row->name[JOINTS_SMPL])) joint = k;
        }
        weights[24 * (i / HG_INFLUENCES) + joint] += known->weight[i];
    }
    npz_item items[] = { { "v_template", HG_F32, 2, { known->vertices, 3 }, known->points },
                         { "f", HG_I32, 2, { known->faces, 3 }, known->triangles },
                         { "weights", HG_F32, 2, { known->vertices, 24 }, weights },
                         { "J", HG_F32, 2, { 24, 3 }, places } };
    ok(npz_write(small_path("person.npz"), 4, items));
    ok(hg_body_read(NULL, &found, small_path("person.npz"), NULL, NULL));
    double both = 0, one[2] = { 0 };
    for (int64_t a = 0, b = 0; a < known->scalp_faces || b < found->scalp_faces;) {
        int32_t x = a < known->scalp_faces ? known->scalp[a] : INT32_MAX,
                y = b < found->scalp_faces ? found->scalp[b] : INT32_MAX;
        int32_t f = x < y ? x : y;
        const int32_t *t = known->triangles + 3 * (int64_t)f;
        hg_vec3f p = hg_vec3f_load(known->points + 3 * (int64_t)t[0]),
                 q = hg_vec3f_load(known->points + 3 * (int64_t)t[1]),
                 r = hg_vec3f_load(known->points + 3 * (int64_t)t[2]);
        double area = 0.5 * (double)hg_vec3f_norm(hg_vec3f_cross(hg_vec3f_sub(q, p), hg_vec3f_sub(r, p)));
        if (x == y)
            both += area;
        else
            one[x > y] += area;
        a += x == f, b += y == f;
    }
    print_message("scalp: %.1f cm2 of %.1f missed, %.1f cm2 too many\n", 1e4 * one[0], 1e4 * (both + one[0]),
                  1e4 * one[1]);
    assert_true(one[0] < 0.05 * both && one[1] < 0.05 * both);
    hg_free(weights);
    hg_body_destroy(known);
    hg_body_destroy(found);
}

/* The body of ../shared/data: it stands as the clip says, feet near the floor, arms stretched out to the sides. */
static void an_amass_clip_moves_the_makehuman_body(void **state)
{
    (void)state;
    const char *source = getenv("HG_SOURCE");
    char folder[1024];
    snprintf(folder, sizeof folder, "%s/../shared/data/bodies", source ? source : ".");
    if (!hg_file_exists(folder)) skip();
    hg_body *body;
    hg_clip *clip;
    hg_motion *motion;
    hg_poser *poser;
    hg_ctx *ctx;
    ok(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1 }));
    ok(hg_body_read(ctx, &body, folder, NULL, NULL));
    small_smpl("smpl.npz", NULL);
    hg_import with = { .body = body, .skeleton = small_path("smpl.npz") };
    ok(hg_clip_read(&clip, small_amass("clip.npz", NULL), &with, NULL));
    ok(hg_clip_retarget(&motion, clip, body, 60));
    ok(hg_poser_create(&poser, body, false));
    float *vertices = hg_alloc((size_t)body->vertices, 12), *joints = hg_alloc((size_t)body->joints, 12);
    assert_true(vertices && joints);
    hg_pose(ctx, poser, NULL, motion, 0, vertices, joints, NULL);
    float low = 9, high = -9;
    for (int64_t v = 0; v < body->vertices; v++) {
        for (int k = 0; k < 3; k++) assert_true(isfinite(vertices[3 * v + k]));
        low = fminf(low, vertices[3 * v + 1]), high = fmaxf(high, vertices[3 * v + 1]);
    }
    /* the clip's ankles are 0.9 m below its root joint at 1.1 m and stand 0.2 m above the floor: the body's, too */
    int foot = hg_body_joint(body, "LeftFoot"), left = hg_body_joint(body, "LeftArm"),
        fore = hg_body_joint(body, "LeftForeArm"), hand = hg_body_joint(body, "LeftHand");
    print_message("soles at %.3f m, ankle at %.3f m, crown at %.3f m\n", (double)low, (double)joints[3 * foot + 1],
                  (double)high);
    assert_true(high - low > 1.6F && high - low < 1.75F);
    near((double)joints[3 * foot + 1], 0.2, 0.03);
    for (int i = 0; i < 2; i++) { /* arms go to the left */
        const float *a = joints + 3 * (i ? fore : left), *b = joints + 3 * (i ? hand : fore);
        hg_vec3d bone =
            hg_vec3d_normalize(hg_vec3d_make((double)(b[0] - a[0]), (double)(b[1] - a[1]), (double)(b[2] - a[2])));
        assert_true(bone.x > 0.999);
    }
    hg_free(vertices);
    hg_free(joints);
    hg_poser_destroy(poser);
    hg_ctx_destroy(ctx);
    hg_motion_destroy(motion);
    hg_clip_destroy(clip);
    hg_body_destroy(body);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(strands_of_every_layout),
        cmocka_unit_test(lying_strands_are_refused),
        cmocka_unit_test(an_smpl_like_body_reads),
        cmocka_unit_test(regressors_of_every_layout),
        cmocka_unit_test(lying_bodies_are_refused),
        cmocka_unit_test(an_amass_clip_moves_an_smpl_body),
        cmocka_unit_test(clips_of_every_layout),
        cmocka_unit_test(lying_clips_are_refused),
        cmocka_unit_test(an_amass_clip_moves_another_rig),
        cmocka_unit_test(a_scalp_is_found),
        cmocka_unit_test(an_amass_clip_moves_the_makehuman_body),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
