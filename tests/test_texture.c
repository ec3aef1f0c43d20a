/* Grooms as textures: which strand a texel holds, strands drawn and read back, rows of a network's images and their gradient. */
#include "hairgrad.h"

#include "device.h"
#include "tests/test.h"

#define OK(call_)                                                                                                      \
    do {                                                                                                               \
        if ((call_) != HG_OK) fail_msg("%s", hg_message());                                                            \
    } while (0)

enum { VERTICES = 3, ROW = 3 * VERTICES };

/* Strands of random points; roots at uv [n,2], or anywhere. */
static hg_groom *make_groom(int64_t n, const float *uv, uint64_t seed)
{
    hg_groom *groom = NULL;
    OK(hg_groom_create(&groom, n, VERTICES));
    for (int64_t i = 0; i < n * ROW; i++) groom->points[i] = (float)hg_random_normal(seed, 0, (uint64_t)i);
    for (int64_t i = 0; i < 2 * n; i++) groom->root_uv[i] = uv ? uv[i] : (float)hg_random_uniform(seed, 1, (uint64_t)i);
    return groom;
}

static hg_texture *make_texture(const hg_groom *groom, int64_t size)
{
    hg_texture *texture = NULL;
    OK(hg_texture_create(&texture, groom, size));
    return texture;
}

static void the_nearest_root_is_kept(void **state)
{
    (void)state;
    /* 4 x 4 texels: three in one of them, two equally near in another, one on the border of four, one at the far corner. */
    static const float uv[] = { 0.30f,   0.05f,  0.375f,  0.125f, 0.49f, 0.01f, /* column 1, row 0 */
                                0.0625f, 0.625f, 0.1875f, 0.625f,               /* column 0, row 2 */
                                0.5f,    0.5f,   1.0f,    1.0f };
    hg_groom *groom = make_groom(7, uv, 1);
    hg_texture *t = make_texture(groom, 4);
    static const int32_t strand[16] = { -1, 1, -1, -1, -1, -1, -1, -1, 3, -1, 5, -1, -1, -1, -1, 6 };
    static const int32_t texel[7] = { -1, 1, -1, 8, -1, 10, 15 }, kept[4] = { 1, 3, 5, 6 },
                         kept_texel[4] = { 1, 8, 10, 15 };
    assert_memory_equal(t->strand, strand, sizeof strand);
    assert_memory_equal(t->texel, texel, sizeof texel);
    assert_int_equal(t->kept, 4);
    assert_int_equal(t->left_out, 3);
    assert_memory_equal(t->kept_strand, kept, sizeof kept);
    assert_memory_equal(t->kept_texel, kept_texel, sizeof kept_texel);
    for (int i = 0; i < 16; i++) assert_true(t->mask[i] == (strand[i] >= 0 ? 1.0f : 0.0f));
    hg_texture_destroy(t);
    hg_groom_destroy(groom);
}

/* Against a search over all strands for every texel; and the same whatever order the strands stand in. */
static void equals_a_search(void **state)
{
    (void)state;
    enum { STRANDS = 700, SIZE = 16 };
    hg_groom *groom = make_groom(STRANDS, NULL, 2), *turned = make_groom(STRANDS, NULL, 2);
    for (int s = 0; s < STRANDS; s++)
        memcpy(turned->root_uv + 2 * s, groom->root_uv + 2 * (STRANDS - 1 - s), 2 * sizeof(float));
    hg_texture *t = make_texture(groom, SIZE), *of_turned = make_texture(turned, SIZE);
    int64_t kept = 0;
    for (int row = 0; row < SIZE; row++)
        for (int column = 0; column < SIZE; column++) {
            int best = -1;
            double least = INFINITY;
            for (int s = 0; s < STRANDS; s++) {
                const double u = SIZE * (double)groom->root_uv[2 * s] - column,
                             v = SIZE * (double)groom->root_uv[2 * s + 1] - row;
                if (u < 0 || u >= 1 || v < 0 || v >= 1) continue;
                const double distance = hypot(u - 0.5, v - 0.5);
                if (distance < least) least = distance, best = s;
            }
            const int texel = row * SIZE + column;
            assert_int_equal(t->strand[texel], best);
            assert_int_equal(of_turned->strand[texel], best < 0 ? -1 : STRANDS - 1 - best);
            if (best >= 0) assert_int_equal(t->texel[best], texel);
            kept += best >= 0;
        }
    assert_int_equal(t->kept, kept);
    assert_int_equal(t->kept + t->left_out, STRANDS);
    assert_true(kept > SIZE * SIZE / 2 && kept < SIZE * SIZE); /* some texels are empty */
    hg_texture_destroy(t);
    hg_texture_destroy(of_turned);
    hg_groom_destroy(groom);
    hg_groom_destroy(turned);
}

static void there_and_back(void **state)
{
    (void)state;
    enum { STRANDS = 150, SIZE = 8, TEXELS = SIZE * SIZE };
    hg_groom *groom = make_groom(STRANDS, NULL, 3);
    OK((groom->name = hg_strdup("a groom")) ? HG_OK : HG_MEMORY);
    groom->body_hash = 77;
    for (int s = 0; s < STRANDS; s++) groom->root_face[s] = 5 * s, groom->root_bary[3 * s] = (float)s;
    hg_texture *t = make_texture(groom, SIZE);
    assert_true(t->left_out > 0);
    float image[ROW * TEXELS], again[ROW * TEXELS], kept[TEXELS * ROW];
    hg_texture_draw(t, ROW, groom->points, image);
    for (int i = 0; i < TEXELS; i++)
        for (int c = 0; c < ROW; c++) {
            const float there = image[c * TEXELS + i];
            assert_true(there == (t->strand[i] < 0 ? 0.0f : groom->points[t->strand[i] * ROW + c]));
        }
    hg_texture_pick(t, ROW, image, kept);
    hg_groom *back = NULL, *as_it_was = NULL, *moved = NULL;
    OK(hg_texture_groom(&back, t, groom, image));
    OK(hg_texture_groom(&as_it_was, t, groom, NULL));
    assert_int_equal(back->strands, t->kept);
    assert_int_equal(back->body_hash, 77);
    assert_string_equal(back->name, "a groom");
    for (int64_t i = 0; i < t->kept; i++) {
        const int32_t s = t->kept_strand[i];
        assert_memory_equal(back->points + i * ROW, groom->points + s * ROW, ROW * sizeof(float));
        assert_memory_equal(kept + i * ROW, groom->points + s * ROW, ROW * sizeof(float));
        assert_int_equal(back->root_face[i], 5 * s);
        assert_true(back->root_bary[3 * i] == (float)s);
        assert_memory_equal(back->root_uv + 2 * i, groom->root_uv + 2 * s, 2 * sizeof(float));
    }
    assert_true(hg_groom_hash(back) == hg_groom_hash(as_it_was));
    /* The points are the image's. */
    for (int i = 0; i < ROW * TEXELS; i++) again[i] = 2 * image[i];
    OK(hg_texture_groom(&moved, t, groom, again));
    for (int64_t i = 0; i < t->kept * ROW; i++) assert_true(moved->points[i] == 2 * back->points[i]);
    /* Of what was kept nothing is left out, and it draws the same image. */
    hg_texture *whole = make_texture(back, SIZE);
    assert_int_equal(whole->left_out, 0);
    assert_memory_equal(whole->mask, t->mask, TEXELS * sizeof(float));
    hg_texture_draw(whole, ROW, back->points, again);
    assert_memory_equal(again, image, sizeof image);
    hg_texture_destroy(t);
    hg_texture_destroy(whole);
    hg_groom_destroy(groom);
    hg_groom_destroy(back);
    hg_groom_destroy(as_it_was);
    hg_groom_destroy(moved);
}

/* Images of three frames of two grooms: rows are the strands' numbers, and the adjoint puts every number back where it was. */
static void rows_of_images(void **state)
{
    (void)state;
    enum { FRAMES = 3, SIZE = 6, TEXELS = SIZE * SIZE, C = 5, NUMBERS = FRAMES * C * TEXELS };
    hg_ctx *ctx = NULL;
    OK(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .seed = 1, .device = test_device() }));
    hg_groom *groom[2] = { make_groom(40, NULL, 4), make_groom(25, NULL, 5) };
    hg_texture *texture[2] = { make_texture(groom[0], SIZE), make_texture(groom[1], SIZE) };
    static const int of_frame[FRAMES] = { 0, 1, 0 };
    /* All kept strands in the first two frames; in the last one some, in another order. */
    const int32_t some[3] = { texture[0]->kept_strand[4], texture[0]->kept_strand[0], texture[0]->kept_strand[7] };
    int32_t places[3 * TEXELS], strands[3 * TEXELS], frames[3 * TEXELS];
    int64_t n = 0;
    for (int b = 0; b < FRAMES; b++) {
        const hg_texture *t = texture[of_frame[b]];
        const int64_t count = b == 2 ? 3 : t->kept;
        OK(hg_texture_places(t, b, count, b == 2 ? some : NULL, places + n));
        for (int64_t i = 0; i < count; i++) frames[n + i] = b, strands[n + i] = b == 2 ? some[i] : t->kept_strand[i];
        n += count;
    }
    float numbers[NUMBERS], seeds[3 * TEXELS * C], rows[3 * TEXELS * C], gradient[NUMBERS];
    for (int i = 0; i < NUMBERS; i++) numbers[i] = (float)hg_random_normal(6, 0, (uint64_t)i);
    for (int64_t i = 0; i < n * C; i++) seeds[i] = (float)hg_random_normal(6, 1, (uint64_t)i);
    hg_tensor *images = hg_tensor_create(ctx, HG_F32, 4, (int64_t[]){ FRAMES, C, SIZE, SIZE });
    OK(hg_tensor_write(images, numbers));
    OK(hg_require_grad(images));
    hg_tensor *out = hg_texture_gather(ctx, images, hg_tensor_from(ctx, HG_I32, 1, &n, places));
    OK(hg_ctx_status(ctx));
    assert_int_equal(out->shape[0], n);
    assert_int_equal(out->shape[1], C);
    OK(hg_tensor_read(out, rows));
    OK(hg_backward_seeded(ctx, out, hg_tensor_from(ctx, HG_F32, 2, (int64_t[]){ n, C }, seeds)));
    OK(hg_tensor_read(hg_grad(images), gradient));
    double product[2] = { 0, 0 }; /* <gather x, y> and <x, adjoint y> */
    for (int64_t i = 0; i < n; i++)
        for (int c = 0; c < C; c++) {
            const int64_t at = ((int64_t)frames[i] * C + c) * TEXELS + texture[of_frame[frames[i]]]->texel[strands[i]];
            assert_true(rows[i * C + c] == numbers[at]);
            assert_true(gradient[at] == seeds[i * C + c]);
            product[0] += (double)rows[i * C + c] * (double)seeds[i * C + c];
        }
    int64_t zeros = 0;
    for (int i = 0; i < NUMBERS; i++) {
        product[1] += (double)numbers[i] * (double)gradient[i];
        zeros += gradient[i] == 0;
    }
    assert_int_equal(zeros, NUMBERS - n * C); /* nothing else gets a gradient */
    assert_true(fabs(product[0] - product[1]) < 1e-9 && fabs(product[0]) > 1e-3);
    hg_tensor_destroy(images);
    for (int g = 0; g < 2; g++) {
        hg_texture_destroy(texture[g]);
        hg_groom_destroy(groom[g]);
    }
    hg_ctx_destroy(ctx);
}

#define REFUSED(call_, says_)                                                                                          \
    do {                                                                                                               \
        assert_int_equal(call_, HG_INVALID);                                                                           \
        if (!strstr(hg_message(), says_)) fail_msg("'%s' does not say \"%s\"", hg_message(), says_);                   \
    } while (0)

static void refusals(void **state)
{
    (void)state;
    hg_groom *groom = make_groom(30, NULL, 7), *other = make_groom(29, NULL, 7), *back = NULL;
    hg_texture *t = NULL;
    REFUSED(hg_texture_create(&t, groom, 1), "1 texels a side, expected 2");
    REFUSED(hg_texture_create(&t, groom, 5000), "expected 2 to 4096");
    const float kept = groom->root_uv[9];
    static const float wrong[3] = { 1.25f, -0.001f, NAN };
    for (int i = 0; i < 3; i++) {
        groom->root_uv[9] = wrong[i];
        REFUSED(hg_texture_create(&t, groom, 4), "strand 4 has root UV");
    }
    groom->root_uv[9] = kept;
    memset(other->root_uv, 0, 29 * 2 * sizeof(float));
    REFUSED(hg_texture_create(&t, other, 4), "no strand has a root UV");
    float *uv = other->root_uv;
    other->root_uv = NULL;
    REFUSED(hg_texture_create(&t, other, 4), "no strand has a root UV");
    other->root_uv = uv;
    other->strands = 0;
    REFUSED(hg_texture_create(&t, other, 4), "no strands");
    other->strands = 29;
    assert_null(t);
    t = make_texture(groom, 4);
    int32_t left_out = 0, places[30];
    while (t->texel[left_out] >= 0) left_out++;
    REFUSED(hg_texture_groom(&back, t, other, NULL), "30 strands");
    REFUSED(hg_texture_places(t, 0, 1, &left_out, places), "was left out");
    REFUSED(hg_texture_places(t, 0, 1, (int32_t[]){ 30 }, places), "no strand 30");
    REFUSED(hg_texture_places(t, 0, t->kept + 1, NULL, places), "have a texel");
    REFUSED(hg_texture_places(t, INT32_MAX / 16, 1, NULL, places), "2^31");
    assert_null(back);
    hg_ctx *ctx = NULL;
    OK(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1, .device = test_device() }));
    hg_tensor *flat = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 4, 4 });
    assert_null(hg_texture_gather(ctx, flat, hg_tensor_from(ctx, HG_I32, 1, (int64_t[]){ 1 }, &left_out)));
    assert_int_equal(hg_ctx_status(ctx), HG_INVALID);
    assert_null(hg_texture_gather(ctx, NULL, NULL));
    hg_ctx_destroy(ctx);
    hg_texture_destroy(t);
    hg_texture_destroy(NULL);
    hg_groom_destroy(groom);
    hg_groom_destroy(other);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_nearest_root_is_kept), cmocka_unit_test(equals_a_search), cmocka_unit_test(there_and_back),
        cmocka_unit_test(rows_of_images),           cmocka_unit_test(refusals),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
