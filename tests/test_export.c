/* Pictures, VTKHDF and ONNX files: read back by libpng, by HDF5 and by protobuf-c. */
#define _GNU_SOURCE
#define HG_NO_CALLER
#include "export/export.h"
#include "tests/test.h"

#include <hdf5.h>
#include <png.h>

#define OK(call_)                                                                                                      \
    do {                                                                                                               \
        if ((call_) != HG_OK) fail_msg("%s", hg_message());                                                            \
    } while (0)

static const uint8_t white[3] = { 255, 255, 255 };
static void drop(char *path)
{
    unlink(path);
    hg_free(path);
}

/* ---- images -------------------------------------------------------------------------------------------------- */

static void png_round_trip(void **state)
{
    (void)state;
    hg_image *image;
    OK(hg_image_create(&image, 37, 19, white));
    for (int i = 0; i < 37 * 19 * 3; i++) image->rgb[i] = (uint8_t)(i * 7 + i / 50);
    char *path = test_path("a.png");
    OK(hg_image_write_png(image, path));
    png_image read = { .version = PNG_IMAGE_VERSION };
    assert_true(png_image_begin_read_from_file(&read, path));
    assert_int_equal(read.width, 37);
    assert_int_equal(read.height, 19);
    read.format = PNG_FORMAT_RGB;
    uint8_t *bytes = malloc(PNG_IMAGE_SIZE(read));
    assert_true(png_image_finish_read(&read, NULL, bytes, 0, NULL));
    assert_memory_equal(bytes, image->rgb, 37 * 19 * 3);
    free(bytes);
    assert_int_not_equal(hg_image_write_png(image, "no/such/folder/a.png"), HG_OK);
    drop(path);
    hg_image_destroy(image);
    assert_int_equal(hg_image_create(&image, 0, 5, white), HG_INVALID);
    assert_null(image);
}

static int dark_pixels(const hg_image *image, int x, int y, int width, int height)
{
    int count = 0;
    for (int row = y; row < y + height; row++)
        for (int column = x; column < x + width; column++) count += image->rgb[3 * (row * image->width + column)] < 250;
    return count;
}

static void text_and_paste(void **state)
{
    (void)state;
    static const uint8_t black[3] = { 0, 0, 0 };
    hg_image *image, *small;
    OK(hg_image_create(&image, 120, 40, white));
    hg_image_text(image, 10, 10, 2, black, "Hg");
    assert_true(dark_pixels(image, 10, 10, 24, 20) > 60);
    assert_int_equal(dark_pixels(image, 0, 0, 120, 9), 0);
    assert_int_equal(dark_pixels(image, 36, 0, 84, 40), 0);
    hg_image_text(image, -500, -500, 3, black, "outside");
    hg_image_text(image, 110, 35, 3, black, "over the edge");
    OK(hg_image_create(&small, 10, 10, black));
    hg_image_paste(image, small, 115, -5); /* cut at two edges */
    hg_image_paste(image, small, -20, 0);
    hg_image_paste(image, small, 50, 100);
    assert_int_equal(image->rgb[3 * 119], 0);
    assert_int_equal(image->rgb[3 * (4 * 120 + 115)], 0);
    assert_int_equal(image->rgb[3 * (5 * 120 + 115)], 255);
    assert_int_equal(image->rgb[3 * 114], 255);
    hg_image_destroy(small);
    hg_image_destroy(image);
}

/* The curve y = x runs from the lower left to the upper right, and nothing that is not finite is drawn. */
static void plot_draws(void **state)
{
    (void)state;
    hg_image *image;
    OK(hg_image_create(&image, 300, 200, white));
    double x[3] = { 0, 0.5, 1 }, y[3] = { 0, 0.5, 1 }, bad[3] = { NAN, INFINITY, NAN };
    const hg_curve curves[2] = { { "a", 3, x, y }, { "b", 3, x, bad } };
    OK(hg_plot(image, 0, 0, 300, 200, "title", "x", "y", 2, curves, false));
    int blue = 0;
    double column = 0.0, row = 0.0, product = 0.0;
    for (int j = 0; j < 200; j++)
        for (int i = 0; i < 300; i++) {
            const uint8_t *p = image->rgb + 3 * (j * 300 + i);
            if (p[0] < 40 && p[2] > 140 && i < 200) blue++, column += i, row += j, product += (double)i * j;
        }
    assert_true(blue > 80);
    assert_true(product / blue < column / blue * row / blue); /* falls in rows where it grows in columns */
    OK(hg_plot(image, 0, 0, 300, 200, NULL, NULL, NULL, 0, NULL, true));
    assert_int_equal(hg_plot(image, 0, 0, 20, 20, NULL, NULL, NULL, 2, curves, true), HG_INVALID);
    hg_image_destroy(image);
}

/* ---- renderer ------------------------------------------------------------------------------------------------ */

static hg_camera camera(double height)
{
    return (hg_camera){ .eye = { 0, 0, 1 }, .target = { 0, 0, 0 }, .up = { 0, 1, 0 }, .height = height };
}

static hg_image *rendered(int threads, const hg_view *view)
{
    hg_ctx *ctx;
    hg_image *image;
    OK(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = threads, .seed = 1 }));
    OK(hg_image_create(&image, 100, 80, white));
    OK(hg_render(ctx, image, 0, 0, 100, 80, view));
    hg_ctx_destroy(ctx);
    return image;
}

/* A vertical strand a quarter of the width to the right: columns 70 .. 80 hold it, all others stay white. */
static void strand_where_it_is(void **state)
{
    (void)state;
    float x[2 * 3] = { 0.25f, 0.2f, 0, 0.25f, -0.2f, 0 };
    const hg_view view = { .camera = camera(0.8), .strands = 1, .vertices = 2, .x = x, .hair_width = 0.01 };
    hg_image *image = rendered(2, &view);
    assert_true(dark_pixels(image, 70, 0, 10, 80) >= 38);
    assert_int_equal(dark_pixels(image, 0, 0, 70, 80), 0);
    assert_int_equal(dark_pixels(image, 80, 0, 20, 80), 0);
    assert_int_equal(dark_pixels(image, 70, 0, 10, 18), 0);
    assert_int_equal(dark_pixels(image, 70, 62, 10, 18), 0);
    hg_image_destroy(image);
}

/* Red in front of green, whatever the order in memory; behind the body nothing is seen, before it everything. */
static void depth_order(void **state)
{
    (void)state;
    const float colour[2 * 3] = { 1, 0, 0, 0, 1, 0 };
    for (int swapped = 0; swapped < 2; swapped++) {
        float z[2] = { 0.1f, -0.1f };
        float x[12] = { -0.3f, 0, z[0], 0.3f, 0, z[0], -0.3f, 0, z[1], 0.3f, 0, z[1] }, c[6];
        memcpy(c, colour, sizeof c);
        if (swapped) {
            float other[6];
            memcpy(other, x, sizeof other);
            memcpy(x, x + 6, sizeof other);
            memcpy(x + 6, other, sizeof other);
            memcpy(c, colour + 3, 3 * sizeof *c);
            memcpy(c + 3, colour, 3 * sizeof *c);
        }
        const hg_view view = {
            .camera = camera(0.8), .strands = 2, .vertices = 2, .x = x, .colour = c, .hair_width = 0.03
        };
        hg_image *image = rendered(1, &view);
        const uint8_t *middle = image->rgb + 3 * (40 * 100 + 50);
        assert_true(middle[0] > middle[1] + 20);
        hg_image_destroy(image);
    }
    const float square[12] = { -1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0 };
    const int32_t faces[6] = { 0, 1, 2, 0, 2, 3 };
    for (int front = 0; front < 2; front++) {
        float z = front ? 0.1f : -0.1f, x[6] = { -0.3f, 0, z, 0.3f, 0, z };
        hg_view view = { .camera = camera(0.8),
                         .strands = 1,
                         .vertices = 2,
                         .x = x,
                         .colour = (float[]){ 0, 0, 1 },
                         .hair_width = 0.03,
                         .body_vertices = 4,
                         .body_faces = 2,
                         .body = square,
                         .triangles = faces };
        hg_image *with = rendered(1, &view);
        const uint8_t *middle = with->rgb + 3 * (40 * 100 + 50);
        if (front)
            assert_true(middle[2] > middle[0] + 20);
        else
            assert_true(middle[0] > middle[2]); /* skin */
        hg_image_destroy(with);
    }
}

/* A little bush of curls before a tilted plane. */
static void make_bush(float *x, int64_t strands, int64_t vertices)
{
    for (int64_t s = 0; s < strands; s++)
        for (int64_t v = 0; v < vertices; v++) {
            double t = (double)v / (double)vertices, a = hg_random_uniform(3, 0, (uint64_t)s) * 6.28;
            float *p = x + 3 * (s * vertices + v);
            p[0] = (float)(0.3 * t * cos(a + 2 * t));
            p[1] = (float)(0.3 * t * sin(a + 2 * t));
            p[2] = (float)(0.2 * hg_random_uniform(4, 0, (uint64_t)s) * t);
        }
}

static void same_for_any_threads(void **state)
{
    (void)state;
    enum { S = 300, V = 9 };
    static float x[S * V * 3];
    make_bush(x, S, V);
    const float square[12] = { -1, -1, -0.1f, 1, -1, 0.1f, 1, 1, 0.05f, -1, 1, -0.1f };
    const int32_t faces[6] = { 0, 1, 2, 0, 2, 3 };
    const hg_view view = { .camera = camera(0.8),
                           .strands = S,
                           .vertices = V,
                           .x = x,
                           .body_vertices = 4,
                           .body_faces = 2,
                           .body = square,
                           .triangles = faces,
                           .hair_width = 0.002 };
    hg_image *one = rendered(1, &view), *two = rendered(2, &view);
    assert_memory_equal(one->rgb, two->rgb, 100 * 80 * 3);
    hg_image_destroy(one);
    hg_image_destroy(two);
}

static void broken_scenes(void **state)
{
    (void)state;
    float x[12] = { NAN, 0, 0, 0.1f, 0, 0, 0.2f, 0.2f, 0, 0.2f, 0.2f, 0 }; /* not finite; zero length */
    hg_view view = { .camera = camera(0.8), .strands = 2, .vertices = 2, .x = x, .hair_width = 0.01 };
    hg_image *image = rendered(1, &view);
    assert_int_equal(dark_pixels(image, 0, 0, 100, 80), 0);
    view.strands = 1;
    view.vertices = 1;
    view.x = x + 3;
    OK(hg_render(NULL, image, 0, 0, 100, 80, &view)); /* one vertex: nothing to draw */
    view.strands = 0;
    OK(hg_render(NULL, image, -50, -50, 100, 80, &view)); /* empty, partly outside */
    assert_int_equal(dark_pixels(image, 0, 0, 100, 80), 0);
    const float corner[9] = { 0 };
    const int32_t wrong[3] = { 0, 1, 3 }, flat[3] = { 0, 1, 2 };
    view.body = corner;
    view.body_vertices = 3;
    view.body_faces = 1;
    view.triangles = wrong;
    assert_int_equal(hg_render(NULL, image, 0, 0, 100, 80, &view), HG_INVALID);
    view.triangles = flat; /* a triangle without area */
    OK(hg_render(NULL, image, 0, 0, 100, 80, &view));
    view.camera.up[1] = 0;
    view.camera.up[2] = 1;
    assert_int_equal(hg_render(NULL, image, 0, 0, 100, 80, &view), HG_INVALID);
    hg_image_destroy(image);
}

/* ---- VTKHDF -------------------------------------------------------------------------------------------------- */

static void expect_integers(hid_t file, const char *name, int n, const int64_t *expected)
{
    int64_t found[32];
    hid_t set = H5Dopen2(file, name, H5P_DEFAULT);
    if (set < 0) fail_msg("%s is missing", name);
    hid_t space = H5Dget_space(set);
    assert_int_equal(H5Sget_simple_extent_npoints(space), n);
    if (n > 0) assert_true(H5Dread(set, H5T_NATIVE_INT64, H5S_ALL, H5S_ALL, H5P_DEFAULT, found) >= 0);
    for (int i = 0; i < n; i++)
        if (found[i] != expected[i])
            fail_msg("%s[%d] is %lld, not %lld", name, i, (long long)found[i], (long long)expected[i]);
    H5Sclose(space);
    H5Dclose(set);
}

static void write_strands(const char *path)
{
    hg_vtkhdf *file;
    float points[18];
    OK(hg_vtkhdf_create_strands(&file, path, 3, 2, 3, 30.0));
    for (int t = 0; t < 3; t++) {
        for (int i = 0; i < 18; i++) points[i] = (float)(100 * t + i);
        OK(hg_vtkhdf_add(file, points));
        OK(hg_vtkhdf_add_extra(file, "root_position", HG_F32, 2, (int64_t[]){ 2, 3 }, points));
    }
    assert_int_equal(hg_vtkhdf_add(file, points), HG_INVALID); /* one more than it was made for */
    assert_int_equal(hg_vtkhdf_add_extra(file, "root_position", HG_F32, 2, (int64_t[]){ 2, 3 }, points), HG_INVALID);
    OK(hg_vtkhdf_write_extra(file, "rest", HG_F32, 3, (int64_t[]){ 2, 3, 3 }, points));
    OK(hg_vtkhdf_set_text(file, "body", "body.vtkhdf"));
    OK(hg_vtkhdf_commit(file));
}

static void vtkhdf_structure(void **state)
{
    (void)state;
    char *path = test_path("strands.vtkhdf");
    write_strands(path);
    hid_t file = H5Fopen(path, H5F_ACC_RDONLY, H5P_DEFAULT);
    assert_true(file >= 0);

    char type[16] = "";
    hid_t attribute = H5Aopen_by_name(file, "VTKHDF", "Type", H5P_DEFAULT, H5P_DEFAULT), kind = H5Aget_type(attribute);
    assert_int_equal(H5Tget_class(kind), H5T_STRING);
    assert_false(H5Tis_variable_str(kind));
    assert_int_equal(H5Tget_cset(kind), H5T_CSET_ASCII);
    assert_int_equal(H5Tget_size(kind), 8);
    assert_true(H5Aread(attribute, kind, type) >= 0);
    assert_string_equal(type, "PolyData");
    H5Tclose(kind);
    H5Aclose(attribute);
    int version[2], steps;
    attribute = H5Aopen_by_name(file, "VTKHDF", "Version", H5P_DEFAULT, H5P_DEFAULT);
    assert_true(H5Aread(attribute, H5T_NATIVE_INT, version) >= 0);
    assert_int_equal(version[0], 2);
    H5Aclose(attribute);
    attribute = H5Aopen_by_name(file, "VTKHDF/Steps", "NSteps", H5P_DEFAULT, H5P_DEFAULT);
    assert_true(H5Aread(attribute, H5T_NATIVE_INT, &steps) >= 0);
    assert_int_equal(steps, 3);
    H5Aclose(attribute);

    const int64_t zeros[12] = { 0 };
    expect_integers(file, "VTKHDF/NumberOfPoints", 1, (int64_t[]){ 6 });
    static const char *const empty[3] = { "Vertices", "Polygons", "Strips" };
    for (int k = 0; k < 3; k++) {
        char name[64];
        snprintf(name, sizeof name, "VTKHDF/%s/Offsets", empty[k]);
        expect_integers(file, name, 1, zeros);
        snprintf(name, sizeof name, "VTKHDF/%s/Connectivity", empty[k]);
        expect_integers(file, name, 0, NULL);
        snprintf(name, sizeof name, "VTKHDF/%s/NumberOfCells", empty[k]);
        expect_integers(file, name, 1, zeros);
        snprintf(name, sizeof name, "VTKHDF/%s/NumberOfConnectivityIds", empty[k]);
        expect_integers(file, name, 1, zeros);
    }
    expect_integers(file, "VTKHDF/Lines/Offsets", 3, (int64_t[]){ 0, 3, 6 });
    expect_integers(file, "VTKHDF/Lines/Connectivity", 6, (int64_t[]){ 0, 1, 2, 3, 4, 5 });
    expect_integers(file, "VTKHDF/Lines/NumberOfCells", 1, (int64_t[]){ 2 });
    expect_integers(file, "VTKHDF/Lines/NumberOfConnectivityIds", 1, (int64_t[]){ 6 });
    expect_integers(file, "VTKHDF/Steps/PointOffsets", 3, (int64_t[]){ 0, 6, 12 });
    expect_integers(file, "VTKHDF/Steps/PartOffsets", 3, zeros);
    expect_integers(file, "VTKHDF/Steps/NumberOfParts", 3, (int64_t[]){ 1, 1, 1 });
    expect_integers(file, "VTKHDF/Steps/CellOffsets", 12, zeros);
    expect_integers(file, "VTKHDF/Steps/ConnectivityIdOffsets", 12, zeros);
    expect_integers(file, "VTKHDF/Steps/PointDataOffsets/strand", 3, zeros);
    expect_integers(file, "VTKHDF/Steps/PointDataOffsets/along", 3, zeros);
    expect_integers(file, "VTKHDF/PointData/strand", 6, (int64_t[]){ 0, 0, 0, 1, 1, 1 });
    H5Fclose(file);

    hg_h5 *h5;
    OK(hg_h5_open(&h5, path));
    float *points, *roots;
    double *times;
    char *text;
    OK(hg_h5_read(h5, "VTKHDF/Points", HG_F32, 2, (int64_t[]){ 18, 3 }, NULL, (void **)&points));
    OK(hg_h5_read(h5, "hairgrad/root_position", HG_F32, 3, (int64_t[]){ 3, 2, 3 }, NULL, (void **)&roots));
    OK(hg_h5_read(h5, "VTKHDF/Steps/Values", HG_F64, 1, (int64_t[]){ 3 }, NULL, (void **)&times));
    OK(hg_h5_get_text(h5, "hairgrad", "body", &text));
    assert_string_equal(text, "body.vtkhdf");
    for (int t = 0; t < 3; t++) {
        assert_true(fabs(times[t] - t / 30.0) < 1e-12);
        for (int i = 0; i < 18; i++) assert_true(points[18 * t + i] == (float)(100 * t + i));
        for (int i = 0; i < 6; i++) assert_true(roots[6 * t + i] == (float)(100 * t + i));
    }
    hg_free(points);
    hg_free(roots);
    hg_free(times);
    hg_free(text);
    hg_h5_close(h5);
    drop(path);
}

static void vtkhdf_refusals(void **state)
{
    (void)state;
    hg_vtkhdf *file;
    char *path = test_path("mesh.vtkhdf");
    float points[9] = { 0 };
    assert_int_equal(hg_vtkhdf_create_strands(&file, path, 0, 2, 3, 30.0), HG_INVALID);
    assert_int_equal(hg_vtkhdf_create_strands(&file, path, 1, 0, 3, 30.0), HG_INVALID);
    assert_int_equal(hg_vtkhdf_create_strands(&file, path, 1, 2, 3, 0.0), HG_INVALID);
    assert_int_equal(hg_vtkhdf_create_mesh(&file, path, 1, 3, 1, (int32_t[]){ 0, 1, 3 }, 30.0), HG_INVALID);
    assert_null(file);
    OK(hg_vtkhdf_create_mesh(&file, path, 2, 3, 1, (int32_t[]){ 0, 1, 2 }, 30.0));
    OK(hg_vtkhdf_add(file, points));
    assert_int_equal(hg_vtkhdf_commit(file), HG_INVALID); /* a frame is missing: no file */
    assert_false(hg_file_exists(path));
    OK(hg_vtkhdf_create_mesh(&file, path, 2, 3, 1, (int32_t[]){ 0, 1, 2 }, 30.0));
    hg_vtkhdf_discard(file);
    assert_false(hg_file_exists(path));
    hg_vtkhdf_discard(NULL);
    hg_free(path);
}

/* A drape of two frames of a one-strand groom turned by a quarter: pictures and tip paths can be made of it. */
static void drape_and_its_pictures(void **state)
{
    (void)state;
    char *path = test_path("drape.vtkhdf"), *body_path = test_path("body.vtkhdf");
    hg_ctx *ctx;
    OK(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2 }));
    hg_groom *groom;
    hg_body *body;
    OK(hg_bust_create(&body));
    OK(hg_groom_create(&groom, 5, 4));
    for (int s = 0; s < 5; s++)
        for (int v = 0; v < 4; v++) {
            float *p = groom->points + 3 * (4 * s + v);
            p[0] = 0.06f * (float)(s % 2 ? 1 : -1), p[1] = 1.6f - 0.05f * (float)v,
            p[2] = 0.06f * (float)(s < 2 ? 1 : -1);
        }
    hg_drape_file *file;
    OK(hg_drape_file_create(&file, path, body_path, groom, body, 2, 30.0));
    float x[5 * 4 * 3], rotation[5 * 4], position[5 * 3];
    for (int s = 0; s < 5; s++) {
        memcpy(rotation + 4 * s, (float[]){ 1, 0, 0, 0 }, 4 * sizeof(float));
        memcpy(position + 3 * s, groom->points + 12 * s, 3 * sizeof(float));
    }
    memcpy(x, groom->points, sizeof x);
    for (int t = 0; t < 2; t++) {
        for (int s = 0; s < 5; s++) x[12 * s + 9] += 0.02f * (float)t;
        OK(hg_drape_file_add(file, &(hg_drape_frame){ .frame = t,
                                                      .strands = 5,
                                                      .vertices = 4,
                                                      .x = x,
                                                      .body_vertices = body->points,
                                                      .root_rotation = rotation,
                                                      .root_position = position }));
    }
    OK(hg_drape_file_commit(file));
    hg_image *image;
    OK(hg_sheet_draw(ctx, &image, path, &(hg_sheet_options){ .width = 60, .height = 70, .compare = true }, NULL));
    assert_int_equal(image->width, 3 * 60 + 12);
    assert_int_equal(image->height, 2 * 70 + 6);
    hg_image_destroy(image);
    OK(hg_sheet_draw(ctx, &image, path, &(hg_sheet_options){ .width = 60, .height = 70, .view = "back" }, NULL));
    assert_int_equal(image->width, 2 * 60 + 6);
    assert_true(dark_pixels(image, 0, 0, 60, 70) > 100);
    hg_image_destroy(image);
    OK(hg_tips_draw(&image, path, 600, 300));
    hg_image_destroy(image);
    int64_t late = 2;
    assert_int_equal(hg_sheet_draw(ctx, &image, path, &(hg_sheet_options){ .frames = &late, .n_frames = 1 }, NULL),
                     HG_INVALID);
    assert_int_equal(hg_sheet_draw(ctx, &image, path, &(hg_sheet_options){ .view = "sideways" }, NULL), HG_INVALID);
    assert_int_not_equal(hg_sheet_draw(ctx, &image, "no.vtkhdf", &(hg_sheet_options){ 0 }, NULL), HG_OK);
    hg_groom_destroy(groom);
    hg_ctx_destroy(ctx);
    hg_body_destroy(body);
    drop(path);
    drop(body_path);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(png_round_trip),  cmocka_unit_test(text_and_paste),
        cmocka_unit_test(plot_draws),      cmocka_unit_test(strand_where_it_is),
        cmocka_unit_test(depth_order),     cmocka_unit_test(same_for_any_threads),
        cmocka_unit_test(broken_scenes),   cmocka_unit_test(vtkhdf_structure),
        cmocka_unit_test(vtkhdf_refusals), cmocka_unit_test(drape_and_its_pictures),
    };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
