/* quaffure and groom_autoencoder: sizes, the zero start, gradients, bits, and that a small autoencoder learns its grooms. */
#include "hairgrad.h"

#include "device.h"
#include "tests/test.h"

#define OK(call_)                                                                                                      \
    do {                                                                                                               \
        if ((call_) != HG_OK) fail_msg("%s", hg_message());                                                            \
    } while (0)

static const hg_model_spec tiny = {
    .inputs = 7, .outputs = 6, .width = 8, .depth = 2, .texture = 8, .activation = HG_SILU, .seed = 5
};
/* A code that is coarse on purpose: 4 numbers. */
static const hg_model_spec tiny_code = {
    .inputs = 15, .outputs = 15, .width = 16, .depth = 2, .latent = 4, .texture = 8, .activation = HG_SILU, .seed = 3
};
enum { FRAMES = 2 };

static hg_ctx *make_ctx(int threads, const char *device)
{
    hg_ctx *ctx = NULL;
    OK(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = threads, .seed = 1, .device = device }));
    return ctx;
}

static hg_model *make_model(hg_ctx *ctx, const char *kind, const hg_model_spec *spec)
{
    hg_model *model = NULL;
    OK(hg_model_create(&model, ctx, kind, spec));
    return model;
}

static void randomise(hg_tensor *tensor, uint64_t stream, double scale)
{
    float *numbers = malloc(hg_tensor_bytes(tensor));
    for (int64_t i = 0; i < hg_tensor_count(tensor); i++)
        numbers[i] = (float)(scale * hg_random_normal(9, stream, (uint64_t)i));
    OK(hg_tensor_write(tensor, numbers));
    free(numbers);
}

static hg_tensor *random_tensor(hg_ctx *ctx, int rank, const int64_t *shape, uint64_t stream)
{
    hg_tensor *tensor = hg_tensor_create(ctx, HG_F32, rank, shape);
    assert_non_null(tensor);
    randomise(tensor, stream, 1);
    return tensor;
}

static float *numbers_of(const hg_tensor *tensor)
{
    float *numbers = malloc(hg_tensor_bytes(tensor));
    OK(hg_tensor_read(tensor, numbers));
    return numbers;
}

/* The last layer begins at zero, and with it most gradients. */
static hg_model *make_awake(hg_ctx *ctx, const hg_model_spec *spec)
{
    hg_model *model = make_model(ctx, "quaffure", spec);
    hg_tensor *weight = model->params[model->n_params - 2];
    assert_string_equal(weight->name, "last.weight");
    randomise(weight, 77, 0.2);
    return model;
}

/* What a network of these sizes must weigh: layers as DESIGNed, counted by hand. */
static int64_t conv(int64_t in, int64_t out, bool norm) { return 9 * in * out + out + (norm ? out : 0); }

static int64_t decoder_weights(const hg_model_spec *s, int64_t inputs)
{
    int64_t smallest = s->texture, width = s->width;
    for (int i = 0; i < s->depth; i++) smallest /= 2;
    int64_t count = (inputs + 1) * smallest * smallest * width;
    for (int i = 0; i < s->depth; i++, width /= 2) count += conv(width, width / 2, s->groups > 0);
    return count + conv(width, s->outputs, false);
}

static int64_t autoencoder_weights(const hg_model_spec *s)
{
    int64_t smallest = s->texture, width = s->width, count = 0;
    for (int i = 0; i < s->depth; i++) {
        smallest /= 2;
        count += conv(i == s->depth - 1 ? s->inputs : width / 2, width, s->groups > 0);
        width /= 2;
    }
    return count + (smallest * smallest * s->width + 1) * s->latent + decoder_weights(s, s->latent);
}

static void sizes(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1, test_device());
    hg_model_spec specs[3] = { tiny, tiny, tiny };
    specs[1].groups = 2;
    specs[2].depth = 3, specs[2].texture = 24, specs[2].inputs = 1;
    for (int i = 0; i < 3; i++) {
        hg_model *model = make_model(ctx, "quaffure", &specs[i]);
        assert_int_equal(hg_model_weights(model), decoder_weights(&specs[i], specs[i].inputs));
        hg_model_destroy(model);
        specs[i].latent = 5;
        model = make_model(ctx, "groom_autoencoder", &specs[i]);
        assert_int_equal(hg_model_weights(model), autoencoder_weights(&specs[i]));
        hg_model_destroy(model);
    }
    /* The published sizes: 16 of the code, 10 of the shape, 81 of the pose, and 30 frames of 81 velocities. */
    const hg_model_spec still = { .inputs = 107, .outputs = 72, .width = 1024, .depth = 3, .texture = 64 };
    assert_int_equal(decoder_weights(&still, 107), 107 * 65536 + 65536 + 6277064);
    assert_int_equal(decoder_weights(&still, 2537), 172607432);
    assert_int_equal(4 * decoder_weights(&still, 2537) / 1000000, 690); /* MB */
    hg_ctx_destroy(ctx);
}

static void starts_at_the_posed_groom(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1, test_device());
    hg_model *model = make_model(ctx, "quaffure", &tiny);
    hg_tensor *x = random_tensor(ctx, 2, (int64_t[]){ FRAMES, tiny.inputs }, 1);
    hg_tensor *y = model->forward(model->self, ctx, &x, 1);
    OK(hg_ctx_status(ctx));
    assert_int_equal(y->rank, 4);
    const int64_t shape[4] = { FRAMES, tiny.outputs, tiny.texture, tiny.texture };
    for (int i = 0; i < 4; i++) assert_int_equal(y->shape[i], shape[i]);
    float *numbers = numbers_of(y);
    for (int64_t i = 0; i < hg_tensor_count(y); i++) assert_true(numbers[i] == 0);
    free(numbers);
    hg_tensor_destroy(x);
    hg_model_destroy(model);
    hg_ctx_destroy(ctx);
}

static void weights_depend_on_the_seed_alone(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(2, test_device());
    hg_model_spec other = tiny_code;
    other.seed++;
    hg_model *a = make_model(ctx, "groom_autoencoder", &tiny_code),
             *b = make_model(ctx, "groom_autoencoder", &tiny_code), *c = make_model(ctx, "groom_autoencoder", &other);
    for (int i = 0; i < a->n_params; i++) {
        float *of_a = numbers_of(a->params[i]), *of_b = numbers_of(b->params[i]), *of_c = numbers_of(c->params[i]);
        assert_memory_equal(of_a, of_b, hg_tensor_bytes(a->params[i]));
        const bool drawn = strstr(a->params[i]->name, ".weight") != NULL;
        assert_true(drawn == (memcmp(of_a, of_c, hg_tensor_bytes(a->params[i])) != 0));
        if (drawn) { /* uniform within the bound of its kind: SiLU cuts off negative numbers, the code and the last do not */
            const int64_t *s = a->params[i]->shape;
            const bool image = a->params[i]->rank == 4;
            const double in = (double)(image ? 9 * s[1] : s[0]), out = (double)(image ? 9 * s[0] : s[1]);
            const bool xavier = strstr(a->params[i]->name, "encoder.code") || strstr(a->params[i]->name, "last");
            const double bound = sqrt(6 / (xavier ? in + out : in));
            double largest = 0;
            for (int64_t k = 0; k < hg_tensor_count(a->params[i]); k++) largest = fmax(largest, fabs((double)of_a[k]));
            if (!(largest <= bound && largest > 0.9 * bound))
                fail_msg("%s: up to %g, bound %g", a->params[i]->name, largest, bound);
        }
        for (int k = 0; k < i; k++) assert_string_not_equal(a->params[i]->name, a->params[k]->name);
        free(of_a);
        free(of_b);
        free(of_c);
    }
    hg_model_destroy(a);
    hg_model_destroy(b);
    hg_model_destroy(c);
    hg_ctx_destroy(ctx);
}

/* ---- gradients ---------------------------------------------------------------------------------------------- */

/* Strands that a texture of images holds, as the hair task will read them. */
static hg_tensor *loss_of(hg_ctx *ctx, hg_model *model, hg_tensor *x, hg_tensor *places, hg_tensor *target)
{
    hg_tensor *rows = hg_texture_gather(ctx, model->forward(model->self, ctx, &x, 1), places);
    return hg_mean(ctx, hg_square(ctx, hg_sub(ctx, rows, target)));
}

enum { STRANDS = 9 };
typedef struct {
    hg_ctx *ctx;
    hg_model *model;
    hg_tensor *x, *places, *target;
} scene;

static scene make_scene(int threads, const char *device, const hg_model_spec *spec)
{
    scene s = { .ctx = make_ctx(threads, device) };
    s.model = make_awake(s.ctx, spec);
    s.x = random_tensor(s.ctx, 2, (int64_t[]){ FRAMES, spec->inputs }, 1);
    OK(hg_require_grad(s.x));
    const int texels = spec->texture * spec->texture;
    int32_t places[STRANDS];
    for (int i = 0; i < STRANDS; i++) places[i] = (37 * i + 5) % (FRAMES * texels);
    s.places = hg_tensor_create(s.ctx, HG_I32, 1, (int64_t[]){ STRANDS });
    OK(hg_tensor_write(s.places, places));
    s.target = random_tensor(s.ctx, 2, (int64_t[]){ STRANDS, spec->outputs }, 2);
    return s;
}

static void scene_free(scene *s)
{
    hg_tensor_destroy(s->x);
    hg_tensor_destroy(s->places);
    hg_tensor_destroy(s->target);
    hg_model_destroy(s->model);
    hg_ctx_destroy(s->ctx);
}

static double value_of(const scene *s)
{
    hg_step_reset(s->ctx);
    hg_tensor *loss = loss_of(s->ctx, s->model, s->x, s->places, s->target);
    OK(hg_ctx_status(s->ctx));
    return hg_tensor_item(loss, 0);
}

/* The derivative along a random direction of each parameter and of the input, by differences of four values. */
static void check_gradients(const hg_model_spec *spec)
{
    scene s = make_scene(2, test_device(), spec);
    hg_step_reset(s.ctx);
    OK(hg_backward(s.ctx, loss_of(s.ctx, s.model, s.x, s.places, s.target)));
    for (int i = 0; i <= s.model->n_params; i++) {
        hg_tensor *tensor = i < s.model->n_params ? s.model->params[i] : s.x;
        const int64_t n = hg_tensor_count(tensor);
        float *at = numbers_of(tensor), *gradient = numbers_of(hg_grad(tensor)), *moved = numbers_of(tensor);
        double *direction = malloc((size_t)n * sizeof *direction), value[4], analytic = 0, norm = 0, length = 0;
        for (int64_t k = 0; k < n; k++) {
            /* half at random, half along the gradient, so that the derivative is not lost in the rounding of f32 */
            direction[k] = hg_random_normal(4, (uint64_t)i, (uint64_t)k);
            norm += (double)gradient[k] * (double)gradient[k];
        }
        assert_true(norm > 0);
        for (int64_t k = 0; k < n; k++) {
            direction[k] = direction[k] / sqrt((double)n) + (double)gradient[k] / sqrt(norm);
            length += direction[k] * direction[k];
        }
        for (int64_t k = 0; k < n; k++) analytic += (double)gradient[k] * direction[k] / sqrt(length);
        static const double steps[4] = { -2, -1, 1, 2 };
        const double step = 0.02;
        for (int k = 0; k < 4; k++) {
            for (int64_t j = 0; j < n; j++)
                moved[j] = (float)((double)at[j] + step * steps[k] * direction[j] / sqrt(length));
            OK(hg_tensor_write(tensor, moved));
            value[k] = value_of(&s);
        }
        const double numeric = (value[0] - 8 * value[1] + 8 * value[2] - value[3]) / (12 * step);
        if (fabs(numeric - analytic) > 2e-3 * sqrt(norm) + 2e-5)
            fail_msg("%s: derivative %.9g, differences say %.9g (norm %.9g)", tensor->name ? tensor->name : "input",
                     analytic, numeric, sqrt(norm));
        OK(hg_tensor_write(tensor, at));
        free(at);
        free(gradient);
        free(moved);
        free(direction);
    }
    scene_free(&s);
}

static void gradients(void **state)
{
    (void)state;
    hg_model_spec with_groups = tiny;
    with_groups.groups = 2;
    check_gradients(&tiny);
    check_gradients(&with_groups);
}

static void compare(const scene *a, const scene *b, double tolerance)
{
    const scene *both[2] = { a, b };
    for (int k = 0; k < 2; k++) {
        hg_step_reset(both[k]->ctx);
        OK(hg_backward(both[k]->ctx,
                       loss_of(both[k]->ctx, both[k]->model, both[k]->x, both[k]->places, both[k]->target)));
    }
    for (int i = 0; i <= a->model->n_params; i++) {
        const hg_tensor *of_a = hg_grad(i < a->model->n_params ? a->model->params[i] : a->x),
                        *of_b = hg_grad(i < b->model->n_params ? b->model->params[i] : b->x);
        float *x = numbers_of(of_a), *y = numbers_of(of_b);
        double scale = 0;
        for (int64_t k = 0; k < hg_tensor_count(of_a); k++) scale = fmax(scale, fabs((double)x[k]));
        assert_true(scale > 0);
        for (int64_t k = 0; k < hg_tensor_count(of_a); k++)
            assert_true(fabs((double)x[k] - (double)y[k]) <= tolerance * scale);
        free(x);
        free(y);
    }
}

/* Of the processor: large enough for several blocks of every kernel. */
static void threads_change_no_bit(void **state)
{
    (void)state;
    const hg_model_spec wide = { .inputs = 300,
                                 .outputs = 12,
                                 .width = 64,
                                 .depth = 2,
                                 .texture = 32,
                                 .groups = 4,
                                 .activation = HG_SILU,
                                 .seed = 5 };
    scene one = make_scene(1, "cpu", &wide), two = make_scene(2, "cpu", &wide), five = make_scene(5, "cpu", &wide);
    compare(&one, &two, 0);
    compare(&one, &five, 0);
    scene_free(&one);
    scene_free(&two);
    scene_free(&five);
}

/* On a device as on the processor. */
static void devices_agree(void **state)
{
    (void)state;
    hg_model_spec spec = tiny;
    spec.groups = 2;
    scene device = make_scene(2, test_device(), &spec), host = make_scene(2, "cpu", &spec);
    compare(&host, &device, 1e-5);
    scene_free(&device);
    scene_free(&host);
}

/* ---- learning ----------------------------------------------------------------------------------------------- */

/* Grown grooms as images of vertices relative to their roots, in units of 10 cm. */
enum { STYLES = 5, VERTICES = 6 };
static const char *const styles[STYLES] = { "straight", "wavy", "curly", "short", "long" };

static void draw_grooms(hg_ctx *ctx, float *images, float *masks)
{
    const int64_t texels = (int64_t)tiny_code.texture * tiny_code.texture, columns = tiny_code.inputs;
    hg_body *body = NULL;
    OK(hg_bust_create(&body));
    for (int g = 0; g < STYLES; g++) {
        hg_groom *groom = NULL;
        hg_texture *texture = NULL;
        OK(hg_groom_grow(hg_ctx_on_host(ctx), &groom, body, styles[g], 300, VERTICES, 7));
        OK(hg_texture_create(&texture, groom, tiny_code.texture));
        float *rows = malloc((size_t)(groom->strands * columns) * sizeof *rows);
        for (int64_t s = 0; s < groom->strands; s++)
            for (int64_t c = 0; c < columns; c++)
                rows[s * columns + c] =
                    10 * (groom->points[s * VERTICES * 3 + 3 + c] - groom->points[s * VERTICES * 3 + c % 3]);
        hg_texture_draw(texture, columns, rows, images + g * columns * texels);
        memcpy(masks + g * texels, texture->mask, (size_t)texels * sizeof *masks);
        free(rows);
        hg_texture_destroy(texture);
        hg_groom_destroy(groom);
    }
    hg_body_destroy(body);
}

static void an_autoencoder_learns_grooms(void **state)
{
    (void)state;
    enum { STEPS = 60 };
    hg_ctx *ctx = make_ctx(2, test_device());
    hg_model *model = make_model(ctx, "groom_autoencoder", &tiny_code);
    const int64_t side = tiny_code.texture, shape[4] = { STYLES, tiny_code.inputs, side, side },
                  mask_shape[4] = { STYLES, 1, side, side };
    hg_tensor *images = hg_tensor_create(ctx, HG_F32, 4, shape), *masks = hg_tensor_create(ctx, HG_F32, 4, mask_shape);
    float *of_images = malloc(hg_tensor_bytes(images)), *of_masks = malloc(hg_tensor_bytes(masks));
    draw_grooms(ctx, of_images, of_masks);
    OK(hg_tensor_write(images, of_images));
    OK(hg_tensor_write(masks, of_masks));
    hg_adam *adam = NULL;
    OK(hg_adam_create(&adam, ctx, model->n_params, model->params));
    double first = 0, last = 0;
    for (int step = 0; step <= STEPS; step++) {
        hg_step_reset(ctx);
        hg_tensor *error = hg_sub(ctx, model->forward(model->self, ctx, &images, 1), images);
        hg_tensor *loss = hg_mean(ctx, hg_square(ctx, hg_mul(ctx, error, masks)));
        OK(hg_ctx_status(ctx));
        last = hg_tensor_item(loss, 0);
        if (step == 0) first = last;
        OK(hg_backward(ctx, loss));
        OK(hg_adam_step(adam, 1e-2, 0.9, 0.999, 1e-8, 0, 0, NULL));
    }
    OK(hg_adam_check(adam, NULL));
    print_message("loss of the autoencoder: %.4g at first, %.4g after %d steps\n", first, last, STEPS);
    assert_true(last < 0.15 * first);
    /* Codes tell the grooms apart. */
    hg_step_reset(ctx);
    hg_no_grad_begin(ctx);
    hg_tensor *code = hg_encode(model, ctx, images);
    hg_no_grad_end(ctx);
    OK(hg_ctx_status(ctx));
    assert_false(hg_needs_grad(code));
    assert_int_equal(code->shape[0], STYLES);
    assert_int_equal(code->shape[1], tiny_code.latent);
    float *codes = numbers_of(code);
    for (int a = 0; a < STYLES; a++)
        for (int b = 0; b < a; b++) {
            double distance = 0;
            for (int k = 0; k < tiny_code.latent; k++)
                distance += fabs((double)codes[a * tiny_code.latent + k] - (double)codes[b * tiny_code.latent + k]);
            assert_true(distance > 0.05);
        }
    free(codes);
    free(of_images);
    free(of_masks);
    hg_adam_destroy(adam);
    hg_tensor_destroy(images);
    hg_tensor_destroy(masks);
    hg_model_destroy(model);
    hg_ctx_destroy(ctx);
}

/* ---- refusals ----------------------------------------------------------------------------------------------- */

static void refuses(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1, test_device());
    static const struct {
        int texture, width, depth, groups, latent;
        const char *says;
    } cases[] = { { 10, 8, 2, 0, 4, "multiples of 2^depth" },  { 8, 6, 2, 0, 4, "multiples of 2^depth" },
                  { 0, 8, 2, 0, 4, "(texture) is not given" }, { 8192, 8192, 13, 0, 4, "at most 12" },
                  { 8, 8, 2, 3, 4, "3 groups do not divide" }, { 8, 8, 2, -1, 4, "groups" },
                  { 4096, 1024, 1, 0, 4, "a depth above 1" },  { 8, 8, 2, 0, 0, "a latent of 0" } };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        const hg_model_spec spec = { .inputs = 3,
                                     .outputs = 3,
                                     .texture = cases[i].texture,
                                     .width = cases[i].width,
                                     .depth = cases[i].depth,
                                     .groups = cases[i].groups,
                                     .latent = cases[i].latent };
        hg_model *model = NULL;
        for (int kind = cases[i].latent == 0; kind < 2; kind++) {
            const char *name = kind == 0 ? "quaffure" : "groom_autoencoder";
            assert_int_equal(hg_model_create(&model, ctx, name, &spec), HG_INVALID);
            assert_null(model);
            if (!strstr(hg_message(), cases[i].says) || !strstr(hg_message(), name))
                fail_msg("'%s' does not say \"%s\"", hg_message(), cases[i].says);
        }
    }
    hg_model *decoder = make_model(ctx, "quaffure", &tiny), *encoder = make_model(ctx, "groom_autoencoder", &tiny_code);
    hg_tensor *x = random_tensor(ctx, 2, (int64_t[]){ FRAMES, tiny.inputs }, 1);
    hg_tensor *image = random_tensor(ctx, 4, (int64_t[]){ FRAMES, tiny_code.inputs, 4, 8 }, 1);
    assert_null(decoder->forward(decoder->self, ctx, (hg_tensor *[]){ x, x }, 2));
    hg_ctx_clear(ctx);
    assert_null(hg_encode(decoder, ctx, x));
    assert_non_null(strstr(hg_ctx_message(ctx), "no autoencoder"));
    hg_ctx_clear(ctx);
    assert_null(encoder->forward(encoder->self, ctx, &image, 1));
    assert_non_null(strstr(hg_ctx_message(ctx), "[batch,15,8,8]"));
    hg_ctx_clear(ctx);
    assert_null(encoder->forward(encoder->self, ctx, (hg_tensor *[]){ image, image }, 2));
    hg_ctx_clear(ctx);
    assert_null(hg_encode(encoder, ctx, NULL));
    hg_tensor_destroy(x);
    hg_tensor_destroy(image);
    hg_model_destroy(decoder);
    hg_model_destroy(encoder);
    hg_ctx_destroy(ctx);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sizes),
        cmocka_unit_test(starts_at_the_posed_groom),
        cmocka_unit_test(weights_depend_on_the_seed_alone),
        cmocka_unit_test(gradients),
        cmocka_unit_test(threads_change_no_bit),
        cmocka_unit_test(devices_agree),
        cmocka_unit_test(an_autoencoder_learns_grooms),
        cmocka_unit_test(refuses),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
