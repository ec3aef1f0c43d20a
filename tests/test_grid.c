/* The grid that kernels make: every neighbour of every point against plain loops over all pairs, on the device of the test:
 * scattered, far apart, on the edges of its box, in one cell, not finite, alone, none; frames apart; the same bits again
 * and in any order of threads. */
#include "device.h"
#include "test.h"

#include "geometry/grid.h"

typedef struct {
    hg_grid grid; /* over the arrays below, of the host */
    int64_t all, cells;
    void *memory;
} copy;

static void *download(hg_ctx *ctx, hg_dtype dtype, int64_t n, void *data)
{
    void *to = hg_alloc((size_t)n + 1, hg_dtype_size(dtype));
    assert_non_null(to);
    hg_tensor *tensor = hg_tensor_wrap(ctx, dtype, 1, &n, data);
    assert_non_null(tensor);
    assert_int_equal(hg_tensor_read(tensor, to), HG_OK);
    return to;
}

static copy read_grid(hg_ctx *ctx, const hg_grid *grid, hg_dtype dtype)
{
    copy c = { *grid, grid->frames * grid->n, grid->frames * hg_grid_cells(grid), NULL };
    c.grid.start = download(ctx, HG_I32, c.cells + 2, grid->start);
    c.grid.vertex = download(ctx, HG_I32, c.all, grid->vertex);
    c.grid.place = download(ctx, HG_I32, c.all, grid->place);
    c.grid.cell = download(ctx, HG_I32, c.all, grid->cell);
    c.grid.x = download(ctx, dtype, c.all, grid->x);
    c.grid.y = download(ctx, dtype, c.all, grid->y);
    c.grid.z = download(ctx, dtype, c.all, grid->z);
    return c;
}

static void free_copy(copy *c)
{
    void *arrays[] = { c->grid.start, c->grid.vertex, c->grid.place, c->grid.cell, c->grid.x, c->grid.y, c->grid.z };
    for (size_t i = 0; i < sizeof arrays / sizeof *arrays; i++) hg_free(arrays[i]);
}

static double number(hg_dtype dtype, const void *from, int64_t i)
{
    return dtype == HG_F32 ? (double)((const float *)from)[i] : ((const double *)from)[i];
}

static bool near(const double *a, const double *b, double radius)
{
    const double d[3] = { a[0] - b[0], a[1] - b[1], a[2] - b[2] };
    return d[0] * d[0] + d[1] * d[1] + d[2] * d[2] <= radius * radius;
}

static bool finite3(const double *x) { return isfinite(x[0]) && isfinite(x[1]) && isfinite(x[2]); }

static hg_tensor *points_of(hg_ctx *ctx, hg_dtype dtype, int64_t count, const double *points)
{
    hg_tensor *tensor = hg_tensor_make(ctx, dtype, 1, &count);
    void *host = hg_alloc((size_t)count + 1, hg_dtype_size(dtype));
    assert_true(tensor && host);
    for (int64_t i = 0; i < count; i++) {
        if (dtype == HG_F32)
            ((float *)host)[i] = (float)points[i];
        else
            ((double *)host)[i] = points[i];
    }
    assert_int_equal(hg_tensor_write(tensor, host), HG_OK);
    hg_free(host);
    return tensor;
}

/* Everything within the radius is found once, and places are in order; every `stride`-th point is looked at. */
static void check_grid(const copy *c, hg_dtype dtype, const double *points, double radius, int64_t stride)
{
    const hg_grid *grid = &c->grid;
    const int64_t placed = hg_grid_placed(grid);
    int64_t finite = 0;
    for (int64_t i = 0; i < c->all; i++) {
        const int64_t place = grid->place[i];
        assert_true(place >= 0 && place < c->all && grid->vertex[place] == i);
        const bool is_finite = finite3(points + 3 * i);
        finite += is_finite;
        assert_int_equal(place < placed, is_finite);
        const void *const by_place[3] = { grid->x, grid->y, grid->z };
        for (int k = 0; k < 3 && is_finite; k++) assert_true(number(dtype, by_place[k], place) == points[3 * i + k]);
    }
    assert_int_equal(placed, finite);
    assert_int_equal(grid->start[c->cells + 1], c->all);
    for (int64_t cell = 0; cell < c->cells; cell++) {
        assert_true(grid->start[cell] <= grid->start[cell + 1]);
        for (int32_t q = grid->start[cell] + 1; q < grid->start[cell + 1]; q++)
            assert_true(grid->vertex[q - 1] < grid->vertex[q]); /* stable */
    }
    uint8_t *seen = hg_alloc((size_t)c->all + 1, 1);
    assert_non_null(seen);
    for (int64_t i = 0; i < c->all; i += stride) {
        if (!finite3(points + 3 * i)) continue;
        memset(seen, 0, (size_t)c->all);
        for (int part = 0; part < HG_GRID_RUNS; part++) {
            int32_t first, last;
            hg_grid_run(grid, grid->cell[i], part, &first, &last);
            for (int32_t q = first; q < last; q++) {
                assert_int_equal(grid->vertex[q] / grid->n, i / grid->n); /* of the same frame */
                seen[grid->vertex[q]]++;
            }
        }
        for (int64_t j = i / grid->n * grid->n; j < (i / grid->n + 1) * grid->n; j++) {
            assert_true(seen[j] <= 1);
            if (finite3(points + 3 * j) && near(points + 3 * i, points + 3 * j, radius) && !seen[j])
                fail_msg("point %d misses %d", (int)i, (int)j);
        }
    }
    hg_free(seen);
}

static bool same_bits(const copy *a, const copy *b, hg_dtype dtype)
{
    const size_t placed = (size_t)hg_grid_placed(&a->grid), real = hg_dtype_size(dtype);
    return memcmp(a->grid.start, b->grid.start, (size_t)(a->cells + 2) * sizeof(int32_t)) == 0 &&
           memcmp(a->grid.cell, b->grid.cell, (size_t)a->all * sizeof(int32_t)) == 0 &&
           memcmp(a->grid.vertex, b->grid.vertex, placed * sizeof(int32_t)) == 0 &&
           memcmp(a->grid.x, b->grid.x, placed * real) == 0 && memcmp(a->grid.y, b->grid.y, placed * real) == 0 &&
           memcmp(a->grid.z, b->grid.z, placed * real) == 0;
}

/* points [frames,n,3], numbers that f32 has too */
static void check(int64_t frames, int64_t n, const double *points, double radius, bool given, int64_t stride)
{
    static const char *const orders[] = { "0", "1", "2", "0" };
    const int dtypes = stride > 1 ? 1 : 2, runs = stride > 1 ? 2 : 4; /* a large one is looked at less */
    for (int d = 0; d < dtypes; d++) {
        const hg_dtype dtype = d ? HG_F64 : HG_F32;
        copy first;
        for (int order = 0; order < runs; order++) {
            hg_ctx *ctx;
            hg_grid grid;
            setenv("EMULATOR_ORDER", orders[order], 1);
            assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .device = test_device(), .threads = 2 }), HG_OK);
            const hg_tensor *x = points_of(ctx, dtype, 3 * frames * n, points);
            const double half = 0.5 * radius;
            const hg_tensor *reach = points_of(ctx, dtype, 1, &half);
            if (hg_grid_build(ctx, &grid, dtype, frames, n, x->data, given ? reach->data : NULL, given ? 2 : radius) !=
                HG_OK)
                fail_msg("%s", hg_message());
            copy c = read_grid(ctx, &grid, dtype);
            if (order == 0) {
                check_grid(&c, dtype, points, given && dtype == HG_F32 ? 2 * (double)(float)half : radius, stride);
                first = c;
            } else {
                assert_true(same_bits(&first, &c, dtype));
                free_copy(&c);
            }
            hg_ctx_destroy(ctx);
        }
        free_copy(&first);
    }
    unsetenv("EMULATOR_ORDER");
}

enum { FRAMES = 3, N = 400 };
static double points[3 * FRAMES * N];

static void scatter(double wide, double high, double deep)
{
    const double box[3] = { wide, high, deep };
    for (int i = 0; i < 3 * FRAMES * N; i++)
        points[i] = (double)(float)(box[i % 3] * (hg_random_uniform(8, 0, (uint64_t)i) - 0.4));
}

static void test_scattered(void **state)
{
    (void)state;
    scatter(0.1, 0.1, 0.1);
    check(FRAMES, N, points, 0.02, false, 1);
    check(FRAMES, N, points, 0.02, true, 1);
    check(1, N, points, 0.003, false, 1); /* most cells are empty */
}

static void test_beyond_the_box(void **state) /* it repeats; neighbours across its edges are found */
{
    (void)state;
    scatter(3, 0.02, 0.5);
    check(FRAMES, N, points, 0.02, false, 1);
    for (int i = 0; i < 3 * FRAMES * N; i++) /* on the edges of cells and around zero */
        points[i] = (double)(float)(0.02 * (1 + 1e-5) * floor(9 * hg_random_uniform(8, 1, (uint64_t)i) - 4));
    check(FRAMES, N, points, 0.02, false, 1);
}

static void test_one_cell(void **state)
{
    (void)state;
    scatter(1e-3, 1e-3, 1e-3);
    check(FRAMES, N, points, 0.02, false, 1);
    memset(points, 0, sizeof points); /* one place */
    check(FRAMES, N, points, 0.02, false, 1);
}

static void test_strays(void **state)
{
    (void)state;
    scatter(0.1, 0.1, 0.1);
    points[3 * 10] = 1e6;
    points[3 * 20 + 1] = -(double)1e30f;
    points[3 * 21 + 1] = (double)3e38f;
    points[3 * 30 + 2] = (double)NAN;
    points[3 * (N + 5)] = (double)INFINITY;
    points[3 * (N + 6) + 1] = -(double)INFINITY;
    check(FRAMES, N, points, 0.02, false, 1);
    for (int i = 0; i < 3 * N; i++) points[i] = (double)NAN; /* a whole frame */
    check(FRAMES, N, points, 0.02, false, 1);
}

static void test_few(void **state)
{
    (void)state;
    scatter(0.1, 0.1, 0.1);
    check(1, 1, points, 0.02, false, 1);
    check(FRAMES, 2, points, 0.2, false, 1);
    check(1, 0, points, 0.02, false, 1);
    check(0, 5, points, 0.02, false, 1);
}

static void test_many(void **state)
{
    (void)state;
    enum { MANY = 100000, MOST_FRAMES = 70000 };
    double *many = hg_alloc(3 * MANY, sizeof *many);
    assert_non_null(many);
    for (int i = 0; i < 3 * MANY; i++) many[i] = (double)(float)(0.3 * hg_random_uniform(8, 2, (uint64_t)i));
    check(1, MANY, many, 0.01, false, 2003);
    check(MOST_FRAMES, 1, many, 0.01, false, 2003); /* so many cells that the sums of their chunks are several pieces */
    hg_free(many);
}

static void test_refused(void **state)
{
    (void)state;
    hg_ctx *ctx;
    hg_grid grid;
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .device = test_device() }), HG_OK);
    const hg_tensor *x = points_of(ctx, HG_F32, 3 * N, points);
    assert_int_equal(hg_grid_build(ctx, &grid, HG_I32, 1, N, x->data, NULL, 0.02), HG_INVALID);
    assert_int_equal(hg_grid_build(ctx, &grid, HG_F32, 1 << 24, N, x->data, NULL, 0.02), HG_UNSUPPORTED);
    assert_non_null(strstr(hg_message(), "can be numbered"));
    const double wrong[] = { 0, -1, (double)NAN, (double)INFINITY };
    scatter(0.1, 0.1, 0.1);
    for (int i = 0; i < 4; i++) { /* found out on the device: nobody has a place */
        assert_int_equal(hg_grid_build(ctx, &grid, HG_F32, 1, N, x->data, NULL, wrong[i]), HG_OK);
        copy c = read_grid(ctx, &grid, HG_F32);
        assert_int_equal(hg_grid_placed(&c.grid), 0);
        free_copy(&c);
    }
    hg_ctx_destroy(ctx);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_scattered), cmocka_unit_test(test_beyond_the_box),
        cmocka_unit_test(test_one_cell),  cmocka_unit_test(test_strays),
        cmocka_unit_test(test_few),       cmocka_unit_test(test_many),
        cmocka_unit_test(test_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
