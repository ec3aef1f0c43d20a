/* HAIRGRAD_VALIDATE: an op that is wrong on the device is named with its shape and element, forward and backward; right ones
 * pass. Nothing to see on the processor alone. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <math.h>
#include <string.h>
#include <cmocka.h>

#include "autograd/autograd.h"
#include "device.h"

/* ---- an op that can be made wrong ---- */

typedef struct {
    const float *x;
    float *y;
    float scale;
    int add;
    int64_t wrong;  /* element that a GPU gets wrong, -1: none */
    double instead; /* what it gets */
} double_args;

static void double_cpu(const void *memory, int64_t first, int64_t last)
{
    const double_args *p = memory;
    for (int64_t i = first; i < last; i++) p->y[i] = (p->add ? p->y[i] : 0) + p->scale * p->x[i];
}

static const char text[] =
    "typedef struct { const float *x; float *y; float scale; int add; int64_t wrong; double instead; } double_args;\n"
    "HG_BODY void twice(const double_args *p, int64_t first, int64_t last)\n"
    "{\n"
    "    for (int64_t i = first; i < last; i++) p->y[i] = i == p->wrong ? (float)p->instead : (p->add ? p->y[i] : "
    "0) + p->scale * p->x[i];\n"
    "}\n"
    "HG_KERNEL(twice, double_args, 64)\n";
static const hg_kernel kernel = { .name = "twice", .cuda = text, .args_size = sizeof(double_args), .cpu = double_cpu };

static int64_t wrong_forward = -1, wrong_backward = -1;

static hg_tensor *shape(hg_call *call)
{
    return hg_tensor_make(call->ctx, call->in[0]->dtype, call->in[0]->rank, call->in[0]->shape);
}

static hg_status forward(hg_call *call)
{
    const double_args args = { call->in[0]->data, call->out->data, 2, 0, wrong_forward, 4.01 };
    return hg_launch(call->ctx, &kernel, hg_tensor_count(call->out), &args);
}

static hg_status backward(hg_call *call)
{
    const double_args args = { hg_grad(call->out)->data, hg_grad(call->in[0])->data, 2, 1, wrong_backward, 2.01 };
    return hg_launch(call->ctx, &kernel, hg_tensor_count(call->out), &args);
}

static const hg_op op = { .name = "twice",
                          .formula = "2 x",
                          .min_in = 1,
                          .max_in = 1,
                          .shape = shape,
                          .forward = forward,
                          .backward = backward };

/* ---- tests ---- */

/* y = twice(x), z = twice(y) + its own gradient twice: x gets from two calls. */
static hg_status run(float seventh, char *message, size_t size)
{
    hg_ctx *ctx;
    float values[12];
    for (int i = 0; i < 12; i++) values[i] = i == 6 ? seventh : (float)(i - 4);
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .device = test_device(), .threads = 1 }) != HG_OK)
        fail_msg("%s", hg_message());
    hg_tensor *x = hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ 3, 4 });
    assert_non_null(x);
    assert_int_equal(hg_tensor_write(x, values), HG_OK);
    assert_int_equal(hg_require_grad(x), HG_OK);
    hg_tensor *y = (hg_apply)(ctx, &op, 1, &x, NULL), *z = (hg_apply)(ctx, &op, 1, &x, NULL);
    hg_tensor *seed = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 3, 4 });
    hg_status status = hg_ctx_status(ctx);
    if (status == HG_OK) status = hg_tensor_fill(seed, 1);
    if (status == HG_OK) status = hg_backward_seeded(ctx, y, seed);
    if (status == HG_OK) status = hg_backward_seeded(ctx, z, seed);
    if (status == HG_OK) assert_float_equal((float)hg_tensor_item(hg_grad(x), 7), 2, 1e-6f);
    const char *sentence = hg_ctx_message(ctx);
    strncpy(message, sentence, size - 1);
    message[size - 1] = 0;
    hg_tensor_destroy(x);
    hg_ctx_destroy(ctx);
    return status;
}

static void test_validation(void **state)
{
    (void)state;
    char message[1024];
    if (!test_device()) skip();
    wrong_forward = wrong_backward = -1;
    assert_int_equal(run(2, message, sizeof message), HG_OK);
    wrong_forward = 6;
    assert_int_equal(run(2, message, sizeof message), HG_NUMERIC);
    assert_non_null(strstr(message, "validation: twice"));
    assert_non_null(strstr(message, "its output, f32 [3,4], differs at [1,2]: 4.01"));
    assert_int_equal(run(INFINITY, message, sizeof message), HG_NUMERIC); /* nothing is near infinity */
    assert_non_null(strstr(message, "differs at [1,2]: 4.01"));
    assert_non_null(strstr(message, "inf on the processor"));
    wrong_forward = -1;
    assert_int_equal(run(INFINITY, message, sizeof message), HG_OK);
    wrong_backward = 11;
    assert_int_equal(run(2, message, sizeof message), HG_NUMERIC);
    assert_non_null(strstr(message, "the gradient of its input 0, f32 [3,4], differs at [2,3]: 2.0"));
    assert_int_equal(setenv("HAIRGRAD_VALIDATE", "0", 1), 0);
    wrong_forward = 6, wrong_backward = -1;
    assert_int_equal(run(2, message, sizeof message), HG_OK);
}

int main(void)
{
    setenv("HAIRGRAD_VALIDATE", "1", 1);
    const struct CMUnitTest tests[] = { cmocka_unit_test(test_validation) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
