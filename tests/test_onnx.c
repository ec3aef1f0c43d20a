/* ONNX files: parsed back by protobuf-c here; run by ONNX Runtime in test_export_python.sh, for which this program
 * writes every formula, its inputs and its outputs into the folder named by HG_ONNX_DUMP. */
#define _GNU_SOURCE
#define HG_NO_CALLER
#include "export/export.h"
#include "tasks/hair.h"
#include "tests/test.h"

#include "onnx.pb-c.h"

#define OK(call_)                                                                                                      \
    do {                                                                                                               \
        if ((call_) != HG_OK) fail_msg("%s", hg_message());                                                            \
    } while (0)

#define COLUMNS 12

/* ---- formulas of one input [n,12] ---------------------------------------------------------------------------- */

/* An owned tensor of numbers in [low, high]; kept for the formula's life. */
typedef struct {
    hg_tensor *kept[64];
    int n;
    hg_model *model;
} shelf;

static hg_tensor *numbers(shelf *s, hg_ctx *ctx, const char *name, int rank, const int64_t *shape, double low,
                          double high)
{
    hg_tensor *t = hg_tensor_create(ctx, HG_F32, rank, shape);
    assert_non_null(t);
    t->name = name;
    for (int64_t i = 0; i < hg_tensor_count(t); i++)
        ((float *)t->data)[i] = (float)(low + (high - low) * hg_random_uniform(11, (uint64_t)s->n, (uint64_t)i));
    assert_true(s->n < 64);
    return s->kept[s->n++] = t;
}

#define SHAPE(...)                                                                                                     \
    (int)(sizeof((int64_t[]){ __VA_ARGS__ }) / sizeof(int64_t)), (int64_t[]) { __VA_ARGS__ }

typedef hg_tensor *(*formula)(void *self, hg_ctx *ctx, hg_tensor *x);

/* A network with every activation, one after another; its first weight is named. */
static hg_tensor *network(void *self, hg_ctx *ctx, hg_tensor *x)
{
    shelf *s = self;
    if (s->n == 0) {
        numbers(s, ctx, "first.weight", SHAPE(COLUMNS, 16), -0.5, 0.5);
        numbers(s, ctx, "first.bias", SHAPE(16), -0.5, 0.5);
        for (int a = HG_IDENTITY; a <= HG_SOFTPLUS; a++) numbers(s, ctx, "hidden.weight", SHAPE(16, 16), -0.4, 0.4);
    }
    hg_tensor *h = hg_linear(ctx, x, s->kept[0], s->kept[1], HG_SILU);
    for (int a = HG_IDENTITY; a <= HG_SOFTPLUS; a++) {
        h = hg_linear(ctx, h, s->kept[2 + a], s->kept[1], (hg_activation)a);
        h = hg_add(ctx, h, hg_activate(ctx, h, (hg_activation)a));
    }
    return h;
}

static hg_tensor *elementwise(void *self, hg_ctx *ctx, hg_tensor *x)
{
    shelf *s = self;
    if (s->n == 0) {
        numbers(s, ctx, NULL, SHAPE(COLUMNS), 0.5, 1.5);
        numbers(s, ctx, NULL, SHAPE(1, 1), 0.5, 1.5);
    }
    hg_tensor *a = hg_div(ctx, hg_sub(ctx, x, s->kept[0]), s->kept[1]);
    hg_tensor *b = hg_sqrt(ctx, hg_scale(ctx, hg_abs(ctx, hg_mul(ctx, a, x)), 2.0, 0.5));
    hg_tensor *c = hg_log(ctx, hg_scale(ctx, hg_exp(ctx, x), 1.0, 1.0));
    hg_tensor *d = hg_maximum(ctx, hg_minimum(ctx, b, c), hg_clamp(ctx, hg_square(ctx, x), 0.1, 0.6));
    return hg_add(ctx, d, hg_detach(ctx, a));
}

/* Images of 2 x 2 pixels: up, convolved with and without bias and padding, down, up again. */
static hg_tensor *images(void *self, hg_ctx *ctx, hg_tensor *x)
{
    shelf *s = self;
    if (s->n == 0) {
        numbers(s, ctx, "image.weight", SHAPE(5, 3, 3, 3), -0.4, 0.4);
        numbers(s, ctx, "image.bias", SHAPE(5), -0.5, 0.5);
        numbers(s, ctx, NULL, SHAPE(2, 5, 3, 2), -0.4, 0.4);
    }
    hg_tensor *a = hg_upsample(ctx, hg_reshape(ctx, x, SHAPE(-1, 3, 2, 2)), HG_BILINEAR);            /* [n,3,4,4] */
    hg_tensor *b = hg_activate(ctx, hg_conv2d(ctx, a, s->kept[0], s->kept[1], 1, 1), HG_LEAKY_RELU); /* [n,5,4,4] */
    hg_tensor *c = hg_conv2d(ctx, b, s->kept[2], NULL, 2, 1);                                        /* [n,2,2,3] */
    return hg_reshape(ctx, hg_upsample(ctx, c, HG_NEAREST), SHAPE(-1, 48));
}

/* A declared network that makes images, with group norms; its last layer does not begin at zero here. */
static hg_tensor *quaffure(void *self, hg_ctx *ctx, hg_tensor *x)
{
    shelf *s = self;
    if (!s->model) {
        const hg_model_spec spec = { .inputs = COLUMNS,
                                     .outputs = 6,
                                     .width = 8,
                                     .depth = 2,
                                     .texture = 8,
                                     .groups = 2,
                                     .activation = HG_SILU,
                                     .seed = 2 };
        OK(hg_model_create(&s->model, ctx, "quaffure", &spec));
        hg_tensor *last = s->model->params[s->model->n_params - 2];
        for (int64_t i = 0; i < hg_tensor_count(last); i++)
            ((float *)last->data)[i] = (float)(0.3 * hg_random_normal(12, 0, (uint64_t)i));
    }
    return hg_reshape(ctx, s->model->forward(s->model->self, ctx, &x, 1), SHAPE(-1, 6 * 8 * 8));
}

static hg_tensor *layout(void *self, hg_ctx *ctx, hg_tensor *x)
{
    shelf *s = self;
    if (s->n == 0) numbers(s, ctx, NULL, SHAPE(3, 5), -1, 1);
    hg_tensor *a = hg_reshape(ctx, x, SHAPE(-1, 4, 3));
    hg_tensor *b = hg_permute(ctx, a, (int[]){ 0, 2, 1 });
    hg_tensor *c = hg_matmul(ctx, a, s->kept[0]);                                          /* [n,4,5] */
    hg_tensor *d = hg_concat(ctx, -1, 2, (hg_tensor *[]){ hg_slice(ctx, c, 2, 1, 3), a }); /* [n,4,6] */
    hg_tensor *e = hg_pad(ctx, hg_slice(ctx, d, 1, 1, 2), 1, 1, 0);                        /* [n,3,6] */
    return hg_concat(ctx, 2, 2, (hg_tensor *[]){ e, b });                                  /* [n,3,10] */
}

static hg_tensor *reductions(void *self, hg_ctx *ctx, hg_tensor *x)
{
    (void)self;
    hg_tensor *a = hg_reshape(ctx, x, SHAPE(-1, 4, 3));
    hg_tensor *b = hg_mul(ctx, a, hg_mean_axis(ctx, a, 1, true));
    return hg_add(ctx, hg_sum_axis(ctx, b, -1, false), hg_sum_axis(ctx, hg_square(ctx, b), 2, false));
}

/* The factored first layer: rows of a groom, groups the input; and gathering of rows by a fixed index. */
static hg_tensor *pairs(void *self, hg_ctx *ctx, hg_tensor *x)
{
    shelf *s = self;
    if (s->n == 0) {
        numbers(s, ctx, NULL, SHAPE(7, 8), -1, 1);
        numbers(s, ctx, NULL, SHAPE(COLUMNS, 8), -1, 1);
        hg_tensor *index = hg_tensor_create(ctx, HG_I32, SHAPE(5));
        for (int i = 0; i < 5; i++) ((int32_t *)index->data)[i] = (3 * i + 1) % 7;
        s->kept[s->n++] = index;
    }
    hg_tensor *rows = hg_gather(ctx, s->kept[0], s->kept[2]);
    return hg_linear_pair(ctx, rows, hg_matmul(ctx, x, s->kept[1]), HG_TANH);
}

static hg_tensor *normalisations(void *self, hg_ctx *ctx, hg_tensor *x)
{
    shelf *s = self;
    if (s->n == 0) {
        numbers(s, ctx, NULL, SHAPE(COLUMNS), 0.5, 1.5);
        numbers(s, ctx, NULL, SHAPE(COLUMNS), -1, 1);
        numbers(s, ctx, NULL, SHAPE(4), 0.5, 1.5);
        numbers(s, ctx, NULL, SHAPE(4), -1, 1);
    }
    hg_tensor *a = hg_layer_norm(ctx, x, s->kept[0], s->kept[1], 1e-5);
    hg_tensor *b = hg_reshape(ctx, hg_softmax(ctx, a), SHAPE(-1, 4, 3));
    hg_tensor *c = hg_group_norm(ctx, b, s->kept[2], s->kept[3], 2, 1e-5);
    hg_tensor *all = hg_mul(ctx, hg_sum(ctx, x), hg_mean(ctx, x)); /* over the rows too */
    hg_tensor *whole = hg_cast(ctx, hg_cast(ctx, hg_scale(ctx, all, 3.0, 0.0), HG_I32), HG_F64);
    return hg_add(ctx, c, hg_cast(ctx, whole, HG_F32));
}

static hg_tensor *vectors(void *self, hg_ctx *ctx, hg_tensor *x)
{
    (void)self;
    hg_tensor *q = hg_normalize(ctx, hg_clip_gradient(ctx, hg_reshape(ctx, x, SHAPE(-1, 3, 4)), 1e-3));
    return hg_mul(ctx, hg_dot(ctx, q, hg_quat_conjugate(ctx, q)), hg_norm(ctx, hg_add(ctx, q, hg_square(ctx, q))));
}

/* Products of vectors and quaternions, strands placed, rows added up. */
static hg_tensor *strands(void *self, hg_ctx *ctx, hg_tensor *x)
{
    shelf *s = self;
    if (s->n == 0) {
        numbers(s, ctx, NULL, SHAPE(2, 5, 3), -0.1, 0.1); /* rest */
        numbers(s, ctx, NULL, SHAPE(3), -1, 1);
        hg_tensor *index = hg_tensor_create(ctx, HG_I32, SHAPE(4));
        for (int i = 0; i < 4; i++) ((int32_t *)index->data)[i] = i == 2 ? 0 : i % 3;
        s->kept[s->n++] = index;
    }
    hg_tensor *q = hg_normalize(ctx, hg_reshape(ctx, hg_slice(ctx, x, 1, 0, 8), SHAPE(-1, 2, 4)));
    hg_tensor *v = hg_reshape(ctx, hg_slice(ctx, x, 1, 4, 6), SHAPE(-1, 2, 3));
    hg_tensor *w = hg_cross(ctx, hg_quat_rotate(ctx, hg_quat_mul(ctx, q, q), v), s->kept[1]);
    hg_tensor *t = hg_transport(ctx, hg_normalize(ctx, v), hg_normalize(ctx, w));
    hg_tensor *d =
        hg_concat(ctx, 2, 2, (hg_tensor *[]){ t, hg_concat(ctx, 2, 2, (hg_tensor *[]){ q, t }) }); /* [n,2,12] */
    hg_tensor *placed = hg_place(ctx, hg_reshape(ctx, d, SHAPE(-1, 2, 4, 3)), s->kept[0], t, v);   /* [n,2,5,3] */
    hg_tensor *sums = hg_scatter_add(
        ctx, hg_permute(ctx, hg_sum_axis(ctx, hg_reshape(ctx, x, SHAPE(-1, 4, 3)), 0, false), (int[]){ 0, 1 }),
        s->kept[2], 5); /* [5,3] */
    return hg_add(ctx, placed, sums);
}

/* Edges of a constant rest strand that turn. */
static hg_tensor *edges(void *self, hg_ctx *ctx, hg_tensor *x)
{
    shelf *s = self;
    if (s->n == 0) {
        hg_tensor *rest = numbers(s, ctx, NULL, SHAPE(1, 5, 3), -0.1, 0.1);
        for (int v = 0; v < 5; v++) ((float *)rest->data)[3 * v + 1] -= 0.3f * (float)v;
    }
    return hg_turn_edges(ctx, hg_reshape(ctx, x, SHAPE(-1, 1, 4, 3)), s->kept[0]);
}

static const struct {
    const char *name;
    formula forward;
} formulas[] = { { "network", network },   { "elementwise", elementwise },
                 { "layout", layout },     { "images", images },
                 { "quaffure", quaffure }, { "reductions", reductions },
                 { "pairs", pairs },       { "normalisations", normalisations },
                 { "vectors", vectors },   { "edges", edges },
                 { "strands", strands } };
#define FORMULAS (int)(sizeof formulas / sizeof *formulas)

static hg_ctx *context(void)
{
    hg_ctx *ctx;
    OK(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 2, .seed = 1 }));
    return ctx;
}

static void empty(shelf *s)
{
    for (int i = 0; i < s->n; i++) hg_tensor_destroy(s->kept[i]);
    s->n = 0;
    hg_model_destroy(s->model);
    s->model = NULL;
}

static const hg_onnx_metadata metadata[] = { { "units", "metres" }, { "dt", "0.0333" } };
static const hg_onnx_options options = { .input = "features",
                                         .output = "displacement",
                                         .graph = "test",
                                         .doc = "a test",
                                         .columns = COLUMNS,
                                         .metadata = metadata,
                                         .n_metadata = 2 };

/* ---- parsed back --------------------------------------------------------------------------------------------- */

static Onnx__ModelProto *parse(const char *path)
{
    void *bytes;
    size_t size;
    OK(hg_file_read(path, &bytes, &size));
    Onnx__ModelProto *model = onnx__model_proto__unpack(NULL, size, bytes);
    hg_free(bytes);
    assert_non_null(model);
    return model;
}

/* Every input of a node is the graph's, an initialiser or an earlier node's output, and names are used once. */
static void check_order(const Onnx__GraphProto *graph)
{
    const char *known[256];
    size_t n = 0;
    for (size_t i = 0; i < graph->n_input; i++) known[n++] = graph->input[i]->name;
    for (size_t i = 0; i < graph->n_initializer; i++) known[n++] = graph->initializer[i]->name;
    for (size_t i = 0; i < graph->n_node; i++) {
        const Onnx__NodeProto *node = graph->node[i];
        for (size_t k = 0; k < node->n_input; k++) {
            bool found = node->input[k][0] == '\0';
            for (size_t j = 0; j < n && !found; j++) found = strcmp(known[j], node->input[k]) == 0;
            if (!found) fail_msg("node %s reads %s, which nothing made before", node->name, node->input[k]);
        }
        for (size_t j = 0; j < n; j++) assert_string_not_equal(known[j], node->output[0]);
        assert_true(n < 256);
        known[n++] = node->output[0];
    }
    assert_string_equal(known[n - 1], graph->output[0]->name);
}

static void file_of_a_network(void **state)
{
    (void)state;
    hg_ctx *ctx = context();
    shelf s = { 0 };
    char *path = test_path("network.onnx");
    OK(hg_onnx_export(ctx, path, network, &s, &options));
    Onnx__ModelProto *model = parse(path);
    assert_int_equal(model->ir_version, 7);
    assert_int_equal(model->n_opset_import, 1);
    assert_int_equal(model->opset_import[0]->version, 15);
    assert_string_equal(model->opset_import[0]->domain, "");
    assert_string_equal(model->producer_name, "hairgrad");
    assert_int_equal(model->n_metadata_props, 2);
    assert_string_equal(model->metadata_props[1]->key, "dt");
    assert_string_equal(model->metadata_props[1]->value, "0.0333");

    const Onnx__GraphProto *graph = model->graph;
    assert_string_equal(graph->doc_string, "a test");
    assert_int_equal(graph->n_input, 1);
    assert_string_equal(graph->input[0]->name, "features");
    const Onnx__TypeProto__Tensor *type = graph->input[0]->type->tensor_type;
    assert_int_equal(type->elem_type, ONNX__TENSOR_PROTO__DATA_TYPE__FLOAT);
    assert_int_equal(type->shape->n_dim, 2);
    assert_string_equal(type->shape->dim[0]->dim_param, "strands");
    assert_int_equal(type->shape->dim[1]->dim_value, COLUMNS);
    assert_string_equal(graph->output[0]->name, "displacement");
    assert_int_equal(graph->output[0]->type->tensor_type->shape->dim[1]->dim_value, 16);
    check_order(graph);

    const Onnx__TensorProto *first = NULL;
    int hidden = 0;
    for (size_t i = 0; i < graph->n_initializer; i++) {
        if (strcmp(graph->initializer[i]->name, "first.weight") == 0) first = graph->initializer[i];
        hidden += strncmp(graph->initializer[i]->name, "hidden.weight", 13) == 0;
    }
    assert_int_equal(hidden, HG_SOFTPLUS + 1); /* nine of one name: told apart by numbers */
    assert_non_null(first);
    assert_int_equal(first->n_dims, 2);
    assert_int_equal(first->dims[0], COLUMNS);
    assert_int_equal(first->dims[1], 16);
    assert_int_equal(first->raw_data.len, COLUMNS * 16 * 4);
    assert_memory_equal(first->raw_data.data, s.kept[0]->data, first->raw_data.len);
    onnx__model_proto__free_unpacked(model, NULL);

    void *one, *two;
    size_t size_one, size_two;
    OK(hg_file_read(path, &one, &size_one));
    hg_step_reset(ctx);
    OK(hg_onnx_export(ctx, path, network, &s, &options)); /* again: the same bytes */
    OK(hg_file_read(path, &two, &size_two));
    assert_int_equal(size_one, size_two);
    assert_memory_equal(one, two, size_one);
    hg_free(one);
    hg_free(two);
    hg_free(path);
    empty(&s);
    hg_ctx_destroy(ctx);
}

static void every_formula_parses(void **state)
{
    (void)state;
    for (int f = 0; f < FORMULAS; f++) {
        hg_ctx *ctx = context();
        shelf s = { 0 };
        char *path = test_path("formula.onnx");
        OK(hg_onnx_export(ctx, path, formulas[f].forward, &s, &options));
        Onnx__ModelProto *model = parse(path);
        check_order(model->graph);
        onnx__model_proto__free_unpacked(model, NULL);
        hg_free(path);
        empty(&s);
        hg_ctx_destroy(ctx);
    }
}

/* Whatever op has an emitter is in one of the formulas above, so that ONNX Runtime has run it. */
static void every_emitter_is_tried(void **state)
{
    (void)state;
    const char *names[128];
    bool tried[128] = { 0 };
    int n = hg_list("op", names, 128);
    assert_in_range(n, 1, 128);
    hg_ctx *ctx = context();
    for (int f = 0; f < FORMULAS; f++) {
        shelf s = { 0 };
        hg_tensor *x = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ 2, COLUMNS });
        OK(hg_tensor_fill(x, 0.5));
        hg_tape_record_all(ctx, true);
        assert_non_null(formulas[f].forward(&s, ctx, x));
        hg_tape_record_all(ctx, false);
        for (int i = 0; i < hg_tape_count(ctx); i++)
            for (int k = 0; k < n; k++) tried[k] |= strcmp(names[k], hg_tape_call(ctx, i)->op->name) == 0;
        hg_step_reset(ctx);
        empty(&s);
    }
    for (int k = 0; k < n; k++) {
        const hg_op *op = hg_find("op", names[k]);
        if (op->emit && !tried[k]) fail_msg("op '%s' can be exported, but no formula here uses it", names[k]);
    }
    hg_ctx_destroy(ctx);
}

/* ---- refusals ------------------------------------------------------------------------------------------------ */

static hg_tensor *mute_shape(hg_call *call)
{
    return hg_tensor_make(call->ctx, HG_F32, call->in[0]->rank, call->in[0]->shape);
}

static hg_status mute_forward(hg_call *call) { return hg_tensor_copy(call->out, call->in[0]); }

static const hg_op mute = { .name = "mute",
                            .formula = "x",
                            .min_in = 1,
                            .max_in = 1,
                            .shape = mute_shape,
                            .forward = mute_forward,
                            .not_differentiable = true };

static hg_tensor *with_mute(void *self, hg_ctx *ctx, hg_tensor *x)
{
    (void)self;
    return hg_square(ctx, hg_apply(ctx, &mute, 1, &x, NULL));
}

static hg_tensor *constant_result(void *self, hg_ctx *ctx, hg_tensor *x)
{
    (void)self;
    return hg_square(ctx, hg_tensor_make(ctx, HG_F32, 2, x->shape));
}

static hg_tensor *one_row(void *self, hg_ctx *ctx, hg_tensor *x)
{
    (void)self;
    return hg_sum_axis(ctx, x, 0, true);
}

static void refusals(void **state)
{
    (void)state;
    static const struct {
        formula forward;
        hg_status status;
        const char *says;
    } cases[] = { { with_mute, HG_UNSUPPORTED, "'mute'" },
                  { constant_result, HG_INVALID, "does not depend on its input" },
                  { one_row, HG_INVALID, "rows" } };
    char *path = test_path("refused.onnx");
    for (int i = 0; i < 3; i++) {
        hg_ctx *ctx = context();
        assert_int_equal(hg_onnx_export(ctx, path, cases[i].forward, NULL, &options), cases[i].status);
        if (!strstr(hg_message(), cases[i].says)) fail_msg("'%s' does not say \"%s\"", hg_message(), cases[i].says);
        assert_false(hg_file_exists(path));
        hg_ctx_destroy(ctx);
    }
    hg_ctx *ctx = context();
    hg_onnx_options none = options;
    none.columns = 0;
    shelf s = { 0 };
    assert_int_equal(hg_onnx_export(ctx, path, network, &s, &none), HG_INVALID);
    hg_free(path);
    empty(&s);
    hg_ctx_destroy(ctx);
}

/* ---- a hair network ------------------------------------------------------------------------------------------ */

static const char *property(const Onnx__ModelProto *model, const char *key)
{
    for (size_t i = 0; i < model->n_metadata_props; i++)
        if (strcmp(model->metadata_props[i]->key, key) == 0) return model->metadata_props[i]->value;
    fail_msg("no metadata '%s'", key);
    return NULL;
}

/* Untrained but for weights set here; both files say the same of it, and the sample rows are its answers. */
/* In two parts: the same displacements as from the concatenated form, and files with the inputs they should have. */
static void check_parts(hg_hair_task *task, hg_ctx *ctx, hg_tensor *x, const float *expected)
{
    const int64_t own = hg_hair_strand_inputs(task), rows = x->shape[0];
    hg_tensor *part = hg_hair_forward_strands(task, ctx, hg_slice(ctx, x, 1, 0, own));
    hg_tensor *frame = hg_slice(ctx, hg_slice(ctx, x, 0, 0, 1), 1, own, x->shape[1] - own);
    const hg_tensor *y = hg_hair_forward_frames(task, ctx, part, frame, NULL);
    assert_non_null(y);
    assert_int_equal(y->rank, 3);
    assert_int_equal(y->shape[0], 1);
    assert_int_equal(y->shape[1], rows);
    for (int64_t i = 0; i < hg_tensor_count(y); i++)
        assert_true(fabs(hg_tensor_item(y, i) - (double)expected[i]) < 1e-7);

    char *path = test_path("parts.onnx");
    hg_exported files[HG_HAIR_FORMULAS];
    int n;
    OK(hg_export_hair_onnx_as(task, ctx, "factored", path, files, &n));
    assert_int_equal(n, 2);
    assert_non_null(strstr(files[0].path, "/parts.strand.onnx"));
    assert_non_null(strstr(files[1].path, "/parts.frame.onnx"));
    Onnx__ModelProto *strand = parse(files[0].path), *frames = parse(files[1].path);
    check_order(strand->graph);
    check_order(frames->graph);
    assert_int_equal(strand->graph->input[0]->type->tensor_type->shape->dim[1]->dim_value, own);
    assert_int_equal(frames->graph->n_input, 2);
    const Onnx__TensorShapeProto *out = frames->graph->output[0]->type->tensor_type->shape;
    assert_string_equal(out->dim[0]->dim_param, "frames");
    assert_string_equal(out->dim[1]->dim_param, "strands");
    assert_int_equal(out->dim[2]->dim_value, 27);
    onnx__model_proto__free_unpacked(strand, NULL);
    onnx__model_proto__free_unpacked(frames, NULL);
    hg_exported_free(files, n);
    assert_int_equal(hg_export_hair_onnx_as(task, ctx, "image", path, files, &n), HG_INVALID);
    assert_non_null(strstr(hg_message(), "this neuralocks has no form \"image\"; it has concatenated, factored"));
    hg_free(path);
}

static void hair_network(void **state)
{
    (void)state;
    static const char tiny[] = "scene: { strands: 40, vertices: 10, seconds: 1 s, motion_kinds: [turn], "
                               "held_out_kinds: [shake] }\n"
                               "model: { width: 16 }\n"
                               "features: { history: 2, latent: 4, lock_size: 8, encoder_width: 8, encoder_steps: 5 }\n"
                               "losses: { gravity: {} }\n"
                               "training: { strands: 16 }\n";
    int n;
    const hg_config_row *rows = hg_hair_schema(&n);
    hg_config *config;
    hg_hair_task *task;
    hg_ctx *ctx = context();
    OK(hg_config_parse(&config, tiny, "tiny.yaml", rows, n));
    OK(hg_hair_task_create(&task, ctx, config, NULL, NULL));
    hg_model *model = hg_hair_model(task);
    hg_tensor *last = model->params[model->n_params - 1];
    OK(hg_tensor_fill(last, 0.25)); /* the last layer starts at zero */
    char *onnx_path = test_path("hair.onnx"), *h5_path = test_path("hair.h5");
    OK(hg_export_hair_onnx(task, ctx, onnx_path));
    OK(hg_export_hair_h5(task, ctx, h5_path));

    Onnx__ModelProto *parsed = parse(onnx_path);
    check_order(parsed->graph);
    assert_string_equal(property(parsed, "vertices"), "10");
    char *hash = hg_format("%016llx", (unsigned long long)hg_groom_hash(hg_hair_groom(task)));
    assert_string_equal(property(parsed, "groom_hash"), hash);
    assert_non_null(strstr(property(parsed, "units"), "metres"));
    assert_non_null(strstr(property(parsed, "features"), "\"deviation\""));
    hg_h5 *file;
    char *text;
    OK(hg_h5_open(&file, h5_path));
    OK(hg_h5_get_text(file, "", "groom_hash", &text));
    assert_string_equal(text, hash);
    hg_free(text);
    hg_free(hash);

    int found = 0;
    for (int i = 0; i < model->n_params; i++) {
        const hg_tensor *parameter = model->params[i];
        char *name = hg_format("model/%s", parameter->name);
        for (char *c = name; *c; c++)
            if (*c == '.') *c = '/';
        float *data;
        OK(hg_h5_read(file, name, HG_F32, parameter->rank, parameter->shape, NULL, (void **)&data));
        assert_memory_equal(data, parameter->data, hg_tensor_bytes(parameter));
        hg_free(data);
        hg_free(name);
        for (size_t k = 0; k < parsed->graph->n_initializer; k++)
            found += strcmp(parsed->graph->initializer[k]->name, parameter->name) == 0;
    }
    assert_int_equal(found, model->n_params);

    int64_t shape[2] = { -1, -1 };
    float *raw, *answer;
    OK(hg_h5_read(file, "sample/features", HG_F32, 2, shape, shape, (void **)&raw));
    const Onnx__TypeProto__Tensor *type = parsed->graph->input[0]->type->tensor_type;
    assert_int_equal(type->shape->dim[1]->dim_value, shape[1]);
    hg_tensor *x = hg_tensor_make(ctx, HG_F32, 2, shape);
    OK(hg_tensor_write(x, raw));
    hg_tensor *y = hg_hair_forward_concatenated(task, ctx, x);
    assert_non_null(y);
    OK(hg_h5_read(file, "sample/displacement", HG_F32, 2, (int64_t[]){ shape[0], 27 }, NULL, (void **)&answer));
    assert_memory_equal(answer, y->data, hg_tensor_bytes(y));
    assert_true(fabsf(answer[0]) > 0.0f);
    check_parts(task, ctx, x, answer);
    hg_free(raw);
    hg_free(answer);
    hg_h5_close(file);
    onnx__model_proto__free_unpacked(parsed, NULL);
    hg_free(onnx_path);
    hg_free(h5_path);
    hg_hair_task_destroy(task);
    hg_config_destroy(config);
    hg_ctx_destroy(ctx);
}

static void open_dimensions(const Onnx__ValueInfoProto *value, int rank, const int64_t *expected)
{
    const Onnx__TensorShapeProto *shape = value->type->tensor_type->shape;
    assert_int_equal(shape->n_dim, rank);
    for (int i = 0; i < rank; i++) {
        if (expected[i] < 0)
            assert_string_equal(shape->dim[i]->dim_param, "frames");
        else
            assert_int_equal(shape->dim[i]->dim_value, expected[i]);
    }
}

/* Of a network of grooms: images that any groom's code makes, and the strands of one, which are its texels. */
static void network_of_grooms(void **state)
{
    (void)state;
    static const char tiny[] = "scene: { grooms: [wavy, short], strands: 60, vertices: 8, seconds: 1 s, motion_kinds: "
                               "[turn], held_out_kinds: [shake] }\n"
                               "model: { kind: quaffure, texture: 8, width: 8, depth: 1, orientations: \"yes\" }\n"
                               "features: { history: 1, latent: 4, encoder_width: 8, encoder_steps: 5 }\n"
                               "losses: { gravity: {} }\n"
                               "training: { strands: 16 }\n";
    enum { T = 8, D = 7 * 3, NUMBERS = 7 * 7 };
    int n_rows;
    const hg_config_row *rows = hg_hair_schema(&n_rows);
    for (int directions = 0; directions < 2; directions++) {
        hg_config *config;
        hg_hair_task *task;
        hg_ctx *ctx = context();
        OK(hg_config_parse(&config, tiny, "tiny.yaml", rows, n_rows));
        if (directions) OK(hg_config_set(config, "model.output", "directions"));
        OK(hg_hair_task_create(&task, ctx, config, NULL, NULL));
        OK(hg_hair_choose_groom(task, "short"));
        const int64_t S = hg_hair_groom(task)->strands;
        hg_tensor *last = hg_hair_model(task)->params[hg_hair_model(task)->n_params - 2];
        for (int64_t i = 0; i < hg_tensor_count(last); i++)
            ((float *)last->data)[i] = (float)(0.3 * hg_random_normal(12, 0, (uint64_t)i));
        hg_hair_formula forms[HG_HAIR_FORMULAS];
        const int n = hg_hair_formulas(task, forms);
        assert_int_equal(n, directions ? 1 : 2);
        assert_string_equal(forms[0].form, directions ? "strands" : "image");
        const int64_t columns = forms[0].input[0].columns;

        char *h5_path = test_path("grooms.h5"), *path = test_path("grooms.onnx");
        OK(hg_export_hair_h5(task, ctx, h5_path));
        hg_h5 *file;
        float *raw, *answer;
        OK(hg_h5_open(&file, h5_path));
        OK(hg_h5_read(file, "sample/features", HG_F32, 2, (int64_t[]){ 4, columns }, NULL, (void **)&raw));
        const int64_t image[4] = { 4, NUMBERS, T, T }, of_strands[3] = { 4, S, NUMBERS };
        OK(hg_h5_read(file, "sample/displacement", HG_F32, directions ? 3 : 4, directions ? of_strands : image, NULL,
                      (void **)&answer));
        hg_tensor *x = hg_tensor_from(ctx, HG_F32, 2, (int64_t[]){ 4, columns }, raw);
        const hg_tensor *y = forms[n - 1].forward(task, ctx, &x);
        assert_non_null(y);
        const int32_t *texel, *strand;
        assert_int_equal(hg_hair_texture(task, &texel, &strand), T);
        double largest = 0;
        for (int64_t b = 0; b < 4; b++)
            for (int64_t s = 0; s < S; s++)
                for (int64_t k = 0; k < NUMBERS; k++) {
                    const double now = hg_tensor_item(y, (b * S + s) * NUMBERS + k);
                    const int64_t there = directions ? (b * S + s) * NUMBERS + k : (b * NUMBERS + k) * T * T + texel[s];
                    assert_true(fabs(now - (double)answer[there]) < 1e-7);
                    if (k < D) largest = fmax(largest, fabs(now));
                }
        assert_true(largest > 1e-6);

        for (int i = 0; i < n; i++) {
            hg_exported files[HG_HAIR_FORMULAS];
            int written;
            OK(hg_export_hair_onnx_as(task, ctx, forms[i].form, path, files, &written));
            assert_int_equal(written, 1);
            Onnx__ModelProto *parsed = parse(path);
            check_order(parsed->graph);
            open_dimensions(parsed->graph->input[0], 2, (int64_t[]){ -1, columns });
            if (!strcmp(forms[i].form, "image"))
                open_dimensions(parsed->graph->output[0], 4, (int64_t[]){ -1, NUMBERS, T, T });
            else
                open_dimensions(parsed->graph->output[0], 3, (int64_t[]){ -1, S, NUMBERS });
            assert_string_equal(property(parsed, "form"), forms[i].form);
            assert_string_equal(property(parsed, "texture"), "8");
            assert_non_null(strstr(property(parsed, "features"), "z_groom[3]"));
            int at = 0, number = 0;
            const char *list = property(parsed, "texel"), *numbers = property(parsed, "strand");
            assert_int_equal(sscanf(list, "[%d,", &at), 1);
            assert_int_equal(sscanf(numbers, "[%d,", &number), 1);
            assert_int_equal(at, texel[0]);
            assert_int_equal(number, strand[0]);
            assert_int_equal(atoi(property(parsed, "strands_left_out")) + S, 60);
            onnx__model_proto__free_unpacked(parsed, NULL);
            hg_exported_free(files, written);
        }
        int32_t *kept;
        OK(hg_h5_read(file, "texture/texel", HG_I32, 1, &S, NULL, (void **)&kept));
        assert_memory_equal(kept, texel, (size_t)S * sizeof *kept);
        hg_free(kept);
        hg_free(raw);
        hg_free(answer);
        hg_h5_close(file);
        hg_free(h5_path);
        hg_free(path);
        hg_hair_task_destroy(task);
        hg_config_destroy(config);
        hg_ctx_destroy(ctx);
    }
}

/* ---- for ONNX Runtime ---------------------------------------------------------------------------------------- */

static void dump_one(const char *folder, int f, int64_t rows)
{
    hg_ctx *ctx = context();
    shelf s = { 0 };
    char *model = hg_format("%s/%s.onnx", folder, formulas[f].name);
    OK(hg_onnx_export(ctx, model, formulas[f].forward, &s, &options));
    hg_step_reset(ctx);
    hg_tensor *x = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ rows, COLUMNS });
    for (int64_t i = 0; i < hg_tensor_count(x); i++)
        ((float *)x->data)[i] = (float)(3.0 * hg_random_uniform(5, (uint64_t)rows, (uint64_t)i) - 1.5);
    hg_tensor *y = formulas[f].forward(&s, ctx, x);
    if (!y) fail_msg("%s", hg_ctx_message(ctx));
    char *in = hg_format("%s/%s.%d.in", folder, formulas[f].name, (int)rows);
    char *out = hg_format("%s/%s.%d.out", folder, formulas[f].name, (int)rows);
    OK(hg_file_write(in, x->data, hg_tensor_bytes(x)));
    OK(hg_file_write(out, y->data, hg_tensor_bytes(y)));
    hg_free(model);
    hg_free(in);
    hg_free(out);
    empty(&s);
    hg_ctx_destroy(ctx);
}

/* Strands and a mesh whose numbers the script knows: coordinate i of frame t is 1000 t + i. */
static void dump_vtkhdf(const char *folder)
{
    char *strands = hg_format("%s/strands.vtkhdf", folder), *mesh = hg_format("%s/mesh.vtkhdf", folder);
    hg_vtkhdf *file;
    float points[36];
    OK(hg_vtkhdf_create_strands(&file, strands, 5, 4, 3, 30.0));
    for (int t = 0; t < 5; t++) {
        for (int i = 0; i < 36; i++) points[i] = (float)(1000 * t + i);
        OK(hg_vtkhdf_add(file, points));
        OK(hg_vtkhdf_add_extra(file, "root_position", HG_F32, 2, (int64_t[]){ 4, 3 }, points));
    }
    OK(hg_vtkhdf_commit(file));
    OK(hg_vtkhdf_create_mesh(&file, mesh, 5, 4, 2, (int32_t[]){ 0, 1, 2, 0, 2, 3 }, 30.0));
    for (int t = 0; t < 5; t++) {
        for (int i = 0; i < 12; i++) points[i] = (float)(1000 * t + i);
        OK(hg_vtkhdf_add(file, points));
    }
    OK(hg_vtkhdf_commit(file));
    hg_free(strands);
    hg_free(mesh);
}

static void dump(void **state)
{
    (void)state;
    const char *folder = getenv("HG_ONNX_DUMP");
    if (!folder) skip();
    for (int f = 0; f < FORMULAS; f++) {
        dump_one(folder, f, 1);
        dump_one(folder, f, 7);
    }
    dump_vtkhdf(folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(file_of_a_network),
        cmocka_unit_test(every_formula_parses),
        cmocka_unit_test(every_emitter_is_tried),
        cmocka_unit_test(refusals),
        cmocka_unit_test(hair_network),
        cmocka_unit_test(network_of_grooms),
        cmocka_unit_test(dump),
    };
    return cmocka_run_group_tests(tests, test_folder_make, test_folder_remove);
}
