/* models: the factored first layer against the concatenated one, the zero start, weights that depend on the seed alone. */
#include "hairgrad.h"

#include "device.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

enum { STRANDS = 37, FRAMES = 3, STRAND_INPUTS = 11, FRAME_INPUTS = 29, OUTPUTS = 12 };

static const hg_model_spec spec = { .inputs = STRAND_INPUTS + FRAME_INPUTS,
                                    .strand_inputs = STRAND_INPUTS,
                                    .outputs = OUTPUTS,
                                    .width = 64,
                                    .depth = 2,
                                    .activation = HG_SILU,
                                    .seed = 5 };

static hg_ctx *make_ctx(int threads)
{
    hg_ctx *ctx = NULL;
    const hg_ctx_options options = { .threads = threads, .seed = 1, .device = test_device() };
    assert_int_equal(hg_ctx_create(&ctx, &options), HG_OK);
    return ctx;
}

static void randomise(hg_tensor *tensor, uint64_t stream, double scale)
{
    const int64_t count = hg_tensor_count(tensor);
    float *numbers = malloc((size_t)count * sizeof *numbers);
    for (int64_t i = 0; i < count; i++) numbers[i] = (float)(scale * hg_random_normal(9, stream, (uint64_t)i));
    assert_int_equal(hg_tensor_write(tensor, numbers), HG_OK);
    free(numbers);
}

static hg_tensor *random_tensor(hg_ctx *ctx, int64_t rows, int64_t columns, uint64_t stream)
{
    hg_tensor *tensor = hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ rows, columns });
    assert_non_null(tensor);
    randomise(tensor, stream, 1);
    return tensor;
}

static float *numbers_of(const hg_tensor *tensor)
{
    float *numbers = malloc(hg_tensor_bytes(tensor) + 1);
    assert_int_equal(hg_tensor_read(tensor, numbers), HG_OK);
    return numbers;
}

static void randomise_last_layer(hg_model *model)
{
    hg_tensor *weight = model->params[model->n_params - 2];
    assert_string_equal(weight->name, "last.weight");
    randomise(weight, 77, 0.2);
}

/* Forward and the gradients of all parameters agree between the two forms of the network. */
static void factored_equals_concatenated(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(2);
    hg_model *model = NULL;
    assert_int_equal(hg_model_create(&model, ctx, "neuralocks", &spec), HG_OK);
    randomise_last_layer(model);
    hg_tensor *strand = random_tensor(ctx, STRANDS, STRAND_INPUTS, 1),
              *frame = random_tensor(ctx, FRAMES, FRAME_INPUTS, 2);
    hg_tensor *both = hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ FRAMES * STRANDS, spec.inputs });
    assert_non_null(both);
    float *strands = numbers_of(strand), *frames = numbers_of(frame), *rows = numbers_of(both);
    for (int64_t b = 0; b < FRAMES; b++)
        for (int64_t s = 0; s < STRANDS; s++) {
            float *row = rows + (b * STRANDS + s) * spec.inputs;
            memcpy(row, strands + s * STRAND_INPUTS, STRAND_INPUTS * sizeof *row);
            memcpy(row + STRAND_INPUTS, frames + b * FRAME_INPUTS, FRAME_INPUTS * sizeof *row);
        }
    assert_int_equal(hg_tensor_write(both, rows), HG_OK);
    free(strands);
    free(frames);
    free(rows);
    hg_tensor *out[3];
    float *gradient[3][6];
    for (int form = 0; form < 3; form++) {
        hg_step_reset(ctx);
        hg_tensor *part = form == 2 ? model->strand_part(model->self, ctx, strand) : NULL;
        hg_tensor *in[3] = { form == 0 ? both : form == 1 ? strand : NULL, frame, part };
        hg_tensor *y = model->forward(model->self, ctx, in, form + 1);
        assert_int_equal(hg_ctx_status(ctx), HG_OK);
        assert_int_equal(hg_tensor_count(y), FRAMES * STRANDS * OUTPUTS);
        out[form] = hg_tensor_create(ctx, HG_F32, 1, (int64_t[]){ FRAMES * STRANDS * OUTPUTS });
        assert_int_equal(hg_tensor_copy(out[form], y), HG_OK);
        assert_int_equal(hg_backward(ctx, hg_mean(ctx, hg_square(ctx, y))), HG_OK);
        assert_int_equal(model->n_params, 6);
        for (int i = 0; i < 6; i++) gradient[form][i] = numbers_of(hg_grad(model->params[i]));
    }
    double largest = 0;
    for (int form = 1; form < 3; form++) {
        for (int64_t i = 0; i < FRAMES * STRANDS * OUTPUTS; i++) {
            const double a = hg_tensor_item(out[0], i), b = hg_tensor_item(out[form], i);
            largest = fmax(largest, fabs(a));
            assert_true(fabs(a - b) <= 1e-6 * fmax(1, fabs(a)));
        }
        for (int i = 0; i < 6; i++) {
            double scale = 0;
            const int64_t n = hg_tensor_count(model->params[i]);
            for (int64_t k = 0; k < n; k++) scale = fmax(scale, fabs((double)gradient[0][i][k]));
            assert_true(scale > 0);
            for (int64_t k = 0; k < n; k++)
                assert_true(fabs((double)gradient[0][i][k] - (double)gradient[form][i][k]) <= 5e-6 * scale);
        }
    }
    assert_true(largest > 0.1);
    for (int form = 0; form < 3; form++) {
        hg_tensor_destroy(out[form]);
        for (int i = 0; i < 6; i++) free(gradient[form][i]);
    }
    hg_tensor_destroy(strand);
    hg_tensor_destroy(frame);
    hg_tensor_destroy(both);
    hg_model_destroy(model);
    hg_ctx_destroy(ctx);
}

static void starts_at_zero(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    hg_model *model = NULL;
    assert_int_equal(hg_model_create(&model, ctx, "neuralocks", &spec), HG_OK);
    hg_tensor *strand = random_tensor(ctx, STRANDS, STRAND_INPUTS, 1),
              *frame = random_tensor(ctx, FRAMES, FRAME_INPUTS, 2);
    hg_tensor *d = model->forward(model->self, ctx, (hg_tensor *[]){ strand, frame }, 2);
    assert_int_equal(hg_ctx_status(ctx), HG_OK);
    for (int64_t i = 0; i < hg_tensor_count(d); i++) assert_true(hg_tensor_item(d, i) == 0);
    assert_int_equal(hg_model_weights(model), 40 * 64 + 64 + 64 * 64 + 64 + 64 * 12 + 12);
    hg_tensor_destroy(strand);
    hg_tensor_destroy(frame);
    hg_model_destroy(model);
    hg_ctx_destroy(ctx);
}

static void published_size(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    hg_model *model = NULL;
    const hg_model_spec published = {
        .inputs = 748, .strand_inputs = 66, .outputs = 72, .width = 256, .depth = 2, .activation = HG_SILU
    };
    assert_int_equal(hg_model_create(&model, ctx, "neuralocks", &published), HG_OK);
    assert_int_equal(hg_model_weights(model), 276040);
    hg_model_destroy(model);
    hg_ctx_destroy(ctx);
}

static void weights_depend_on_the_seed_alone(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(2);
    hg_model *a = NULL, *b = NULL, *c = NULL;
    hg_model_spec other = spec;
    other.seed = 6;
    assert_int_equal(hg_model_create(&a, ctx, "neuralocks", &spec), HG_OK);
    assert_int_equal(hg_model_create(&b, ctx, "neuralocks", &spec), HG_OK);
    assert_int_equal(hg_model_create(&c, ctx, "neuralocks", &other), HG_OK);
    float *of_a = numbers_of(a->params[0]), *of_b = numbers_of(b->params[0]), *of_c = numbers_of(c->params[0]);
    assert_memory_equal(of_a, of_b, hg_tensor_bytes(a->params[0]));
    assert_memory_not_equal(of_a, of_c, hg_tensor_bytes(a->params[0]));
    assert_int_equal(hg_model_copy(c, a), HG_OK);
    free(of_c);
    of_c = numbers_of(c->params[0]);
    assert_memory_equal(of_a, of_c, hg_tensor_bytes(a->params[0]));
    free(of_a);
    free(of_b);
    free(of_c);
    hg_model_destroy(a);
    hg_model_destroy(b);
    hg_model_destroy(c);
    hg_ctx_destroy(ctx);
}

static void refuses(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    hg_model *model = NULL, *encoder = NULL;
    assert_int_equal(hg_model_create(&model, ctx, "neuralock", &spec), HG_INVALID);
    assert_non_null(strstr(hg_message(), "neuralocks"));
    hg_model_spec bad = spec;
    bad.outputs = 0;
    assert_int_equal(hg_model_create(&model, ctx, "neuralocks", &bad), HG_INVALID);
    bad = spec;
    bad.strand_inputs = spec.inputs + 1;
    assert_int_equal(hg_model_create(&model, ctx, "neuralocks", &bad), HG_INVALID);
    assert_null(model);
    /* No strand inputs: the factored form says so. */
    bad = spec;
    bad.strand_inputs = 0;
    assert_int_equal(hg_model_create(&model, ctx, "neuralocks", &bad), HG_OK);
    hg_tensor *frame = random_tensor(ctx, FRAMES, FRAME_INPUTS, 2);
    assert_null(model->forward(model->self, ctx, (hg_tensor *[]){ frame, frame }, 2));
    assert_int_equal(hg_ctx_status(ctx), HG_INVALID);
    hg_ctx_clear(ctx);
    /* Another kind is not copied. */
    hg_model_spec code = { .inputs = 6, .outputs = 6, .width = 8, .depth = 1, .latent = 2, .activation = HG_SILU };
    assert_int_equal(hg_model_create(&encoder, ctx, "strand_autoencoder", &code), HG_OK);
    assert_int_equal(hg_model_copy(model, encoder), HG_INVALID);
    assert_null(hg_encode(model, ctx, frame));
    hg_ctx_clear(ctx);
    hg_tensor_destroy(frame);
    hg_model_destroy(model);
    hg_model_destroy(encoder);
    hg_ctx_destroy(ctx);
}

static void autoencoder_shapes(void **state)
{
    (void)state;
    hg_ctx *ctx = make_ctx(1);
    hg_model *model = NULL;
    hg_model_spec code = {
        .inputs = 72, .outputs = 72, .width = 32, .depth = 2, .latent = 5, .activation = HG_SILU, .seed = 3
    };
    assert_int_equal(hg_model_create(&model, ctx, "strand_autoencoder", &code), HG_OK);
    hg_tensor *x = random_tensor(ctx, 7, 72, 4);
    hg_tensor *z = hg_encode(model, ctx, x), *y = model->forward(model->self, ctx, &x, 1);
    assert_int_equal(hg_ctx_status(ctx), HG_OK);
    assert_int_equal(z->shape[0], 7);
    assert_int_equal(z->shape[1], 5);
    assert_int_equal(y->shape[1], 72);
    hg_tensor_destroy(x);
    hg_model_destroy(model);
    hg_ctx_destroy(ctx);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(factored_equals_concatenated),
        cmocka_unit_test(starts_at_zero),
        cmocka_unit_test(published_size),
        cmocka_unit_test(weights_depend_on_the_seed_alone),
        cmocka_unit_test(refuses),
        cmocka_unit_test(autoencoder_shapes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
