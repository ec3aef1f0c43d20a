/* ONNX: a network's formula as a graph that ONNX Runtime, TensorRT and game engines run. Opset 15, IR version 7.
 *
 * The formula is run once on a probe while the tape records every call; each op's emitter then says which nodes stand
 * for its call. A value of the graph is a number here and a name in the file. What is neither the input nor made on the
 * tape (weights, constants of the formula) becomes an initialiser with raw little-endian data. The format is
 * onnx/onnx.proto as the distribution ships it, through protobuf-c; this is the only file that includes it.
 */
#include "autograd/autograd.h"
#include "export/export.h"

#include "onnx.pb-c.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#define OPSET        15
#define IR_VERSION   7
#define PROBE_ROWS   3
#define LARGEST_FILE (((size_t)1 << 30) / 10 * 19) /* 1.9 GiB: a protobuf message ends at 2 GiB */

/* ---- memory of the graph ------------------------------------------------------------------------------------- */

typedef struct piece {
    struct piece *next;
} piece;

typedef struct {
    char *name;
    bool from_input; /* depends on the graph's input */
} value;

typedef struct {
    const hg_tensor *tensor;
    int value;
} known;

typedef struct {
    hg_ctx *ctx;
    const hg_call *call; /* being emitted, for messages */
    hg_status status;    /* the first error */
    piece *pieces;       /* everything that the message points at */
    value *values;
    int n_values, room_values;
    known *known;            /* open addressing, by address */
    int n_known, room_known; /* room: a power of two */
    Onnx__NodeProto **nodes;
    size_t n_nodes, room_nodes;
    Onnx__TensorProto **initialisers;
    size_t n_initialisers, room_initialisers, bytes;
} builder;

static void *take(builder *b, size_t count, size_t size)
{
    if (b->status != HG_OK) return NULL;
    size_t head = 64; /* keeps the alignment of hg_alloc */
    piece *made = size && count > (SIZE_MAX - head) / size ? NULL : hg_alloc(head + count * size, 1);
    if (!made) {
        b->status = hg_fail(HG_MEMORY, "ONNX export: out of memory");
        return NULL;
    }
    made->next = b->pieces;
    b->pieces = made;
    return (char *)made + head;
}

static char *copy_text(builder *b, const char *text)
{
    size_t size = strlen(text) + 1;
    char *copy = take(b, size, 1);
    if (copy) memcpy(copy, text, size);
    return copy;
}

/* Makes room for one more element of a growing array. */
static bool grow(builder *b, void *array, size_t n, size_t *room, size_t size)
{
    if (b->status != HG_OK) return false;
    if (n < *room) return true;
    size_t wanted = *room ? 2 * *room : 64;
    void *old, *grown;
    memcpy(&old, array, sizeof old);
    grown = hg_resize(old, *room, wanted, size);
    if (!grown) {
        b->status = hg_fail(HG_MEMORY, "ONNX export: out of memory");
        return false;
    }
    memcpy(array, &grown, sizeof grown);
    *room = wanted;
    return true;
}

static void release(builder *b)
{
    while (b->pieces) {
        piece *next = b->pieces->next;
        hg_free(b->pieces);
        b->pieces = next;
    }
    hg_free(b->values);
    hg_free(b->known);
    hg_free(b->nodes);
    hg_free(b->initialisers);
}

/* ---- values -------------------------------------------------------------------------------------------------- */

static bool name_taken(const builder *b, const char *name)
{
    for (int i = 0; i < b->n_values; i++)
        if (strcmp(b->values[i].name, name) == 0) return true;
    return false;
}

/* A new value; its name is `wanted` where that is free, else with a number after it. */
static int new_value(builder *b, const char *wanted, bool numbered)
{
    size_t room = (size_t)b->room_values;
    if (!grow(b, &b->values, (size_t)b->n_values, &room, sizeof *b->values)) return -1;
    b->room_values = (int)room;
    char name[160];
    snprintf(name, sizeof name, "%.120s", wanted);
    if (numbered || name_taken(b, name))
        for (int i = b->n_values;; i++) {
            snprintf(name, sizeof name, "%.120s_%d", wanted, i);
            if (!name_taken(b, name)) break;
        }
    char *kept = copy_text(b, name);
    if (!kept) return -1;
    b->values[b->n_values] = (value){ .name = kept };
    return b->n_values++;
}

static size_t slot_of(const known *table, int room, const hg_tensor *tensor)
{
    size_t slot = (size_t)hg_hash(&tensor, sizeof tensor, 0) & (size_t)(room - 1);
    while (table[slot].tensor && table[slot].tensor != tensor) slot = (slot + 1) & (size_t)(room - 1);
    return slot;
}

static int find_value(const builder *b, const hg_tensor *tensor)
{
    if (b->room_known == 0) return -1;
    known entry = b->known[slot_of(b->known, b->room_known, tensor)];
    return entry.tensor ? entry.value : -1;
}

static hg_status remember(builder *b, const hg_tensor *tensor, int number)
{
    if (b->status != HG_OK) return b->status;
    if (2 * (b->n_known + 1) > b->room_known) {
        int room = b->room_known ? 2 * b->room_known : 256;
        known *table = hg_alloc((size_t)room, sizeof *table);
        if (!table) return b->status = HG_MEMORY;
        for (int i = 0; i < b->room_known; i++)
            if (b->known[i].tensor) table[slot_of(table, room, b->known[i].tensor)] = b->known[i];
        hg_free(b->known);
        b->known = table;
        b->room_known = room;
    }
    known *entry = &b->known[slot_of(b->known, b->room_known, tensor)];
    if (!entry->tensor) b->n_known++;
    *entry = (known){ tensor, number };
    return HG_OK;
}

/* A tensor that shares the data of one that is known already (a detached one): the same value. */
static int find_alias(const builder *b, const hg_tensor *tensor)
{
    for (int i = 0; i < b->room_known; i++) {
        const hg_tensor *other = b->known[i].tensor;
        if (!other || other->data != tensor->data || other->rank != tensor->rank || !tensor->data) continue;
        if (memcmp(other->shape, tensor->shape, sizeof other->shape) == 0 && other->dtype == tensor->dtype)
            return b->known[i].value;
    }
    return -1;
}

/* ---- initialisers -------------------------------------------------------------------------------------------- */

static int element_type(hg_dtype dtype)
{
    switch (dtype) {
    case HG_F32:
        return ONNX__TENSOR_PROTO__DATA_TYPE__FLOAT;
    case HG_F64:
        return ONNX__TENSOR_PROTO__DATA_TYPE__DOUBLE;
    case HG_I32:
        return ONNX__TENSOR_PROTO__DATA_TYPE__INT32;
    case HG_BF16:
        return ONNX__TENSOR_PROTO__DATA_TYPE__BFLOAT16;
    case HG_TF32:
        break;
    }
    return ONNX__TENSOR_PROTO__DATA_TYPE__UNDEFINED;
}

/* A new initialiser; *data is where its bytes go. */
static int new_initialiser(builder *b, const char *name, bool numbered, int type, int rank, const int64_t *shape,
                           size_t bytes, void **data)
{
    *data = NULL;
    b->bytes += bytes;
    if (b->status == HG_OK && b->bytes > LARGEST_FILE)
        b->status = hg_fail(HG_UNSUPPORTED,
                            "ONNX export: more than 1.9 GiB of weights, and one ONNX file holds less than 2 GiB; "
                            "export the weights with --to h5 instead");
    if (!grow(b, &b->initialisers, b->n_initialisers, &b->room_initialisers, sizeof *b->initialisers)) return -1;
    int number = new_value(b, name, numbered);
    Onnx__TensorProto *tensor = take(b, 1, sizeof *tensor);
    int64_t *dims = take(b, (size_t)(rank > 0 ? rank : 1), sizeof *dims);
    void *raw = take(b, bytes > 0 ? bytes : 1, 1);
    if (number < 0 || !tensor || !dims || !raw) return -1;
    onnx__tensor_proto__init(tensor);
    tensor->name = b->values[number].name;
    tensor->has_data_type = true;
    tensor->data_type = type;
    tensor->n_dims = (size_t)rank;
    tensor->dims = dims;
    if (rank > 0) memcpy(dims, shape, (size_t)rank * sizeof *dims);
    tensor->has_raw_data = true;
    tensor->raw_data = (ProtobufCBinaryData){ .len = bytes, .data = raw };
    b->initialisers[b->n_initialisers++] = tensor;
    *data = raw;
    return number;
}

static int constant(void *self, const hg_tensor *tensor)
{
    builder *b = self;
    if (!tensor) return -1;
    int number = find_value(b, tensor);
    if (number >= 0 || b->status != HG_OK) return number;
    void *data;
    number = new_initialiser(b, tensor->name ? tensor->name : "constant", !tensor->name, element_type(tensor->dtype),
                             tensor->rank, tensor->shape, hg_tensor_bytes(tensor), &data);
    if (number < 0) return -1;
    hg_status status = hg_tensor_read(tensor, data);
    if (status == HG_OK) status = remember(b, tensor, number);
    if (status != HG_OK) b->status = status;
    return status == HG_OK ? number : -1;
}

static int constant_f32(void *self, int rank, const int64_t *shape, const float *from)
{
    size_t count = 1;
    for (int k = 0; k < rank; k++) count *= (size_t)shape[k];
    void *data;
    int number = new_initialiser(self, "constant", true, ONNX__TENSOR_PROTO__DATA_TYPE__FLOAT, rank, shape,
                                 count * sizeof *from, &data);
    if (number >= 0) memcpy(data, from, count * sizeof *from);
    return number;
}

static int constant_i64(void *self, int rank, const int64_t *shape, const int64_t *from)
{
    size_t count = 1;
    for (int k = 0; k < rank; k++) count *= (size_t)shape[k];
    void *data;
    int number = new_initialiser(self, "integers", true, ONNX__TENSOR_PROTO__DATA_TYPE__INT64, rank, shape,
                                 count * sizeof *from, &data);
    if (number >= 0) memcpy(data, from, count * sizeof *from);
    return number;
}

static int input(void *self, const hg_tensor *tensor)
{
    builder *b = self;
    if (!tensor) return -1;
    int number = find_value(b, tensor);
    if (number >= 0) return number;
    number = find_alias(b, tensor);
    return number >= 0 ? number : constant(b, tensor);
}

/* ---- nodes --------------------------------------------------------------------------------------------------- */

/* One attribute of "name=k": i an int64_t, f a double, s a text, I an int and that many int64_t. */
static bool add_attribute(builder *b, Onnx__AttributeProto *attribute, char kind, va_list *arguments)
{
    switch (kind) {
    case 'i':
        attribute->type = ONNX__ATTRIBUTE_PROTO__ATTRIBUTE_TYPE__INT;
        attribute->has_i = true;
        attribute->i = va_arg(*arguments, int64_t);
        break;
    case 'f':
        attribute->type = ONNX__ATTRIBUTE_PROTO__ATTRIBUTE_TYPE__FLOAT;
        attribute->has_f = true;
        attribute->f = (float)va_arg(*arguments, double);
        break;
    case 's': {
        char *text = copy_text(b, va_arg(*arguments, const char *));
        if (!text) return false;
        attribute->type = ONNX__ATTRIBUTE_PROTO__ATTRIBUTE_TYPE__STRING;
        attribute->has_s = true;
        attribute->s = (ProtobufCBinaryData){ .len = strlen(text), .data = (uint8_t *)text };
        break;
    }
    case 'I': {
        int n = va_arg(*arguments, int);
        const int64_t *from = va_arg(*arguments, const int64_t *);
        attribute->type = ONNX__ATTRIBUTE_PROTO__ATTRIBUTE_TYPE__INTS;
        attribute->n_ints = (size_t)n;
        attribute->ints = take(b, (size_t)n + 1, sizeof *from);
        if (!attribute->ints) return false;
        memcpy(attribute->ints, from, (size_t)n * sizeof *from);
        break;
    }
    default:
        return false;
    }
    attribute->has_type = true;
    return true;
}

static bool add_attributes(builder *b, Onnx__NodeProto *made, const char *format, va_list *arguments)
{
    size_t most = 0;
    for (const char *c = format; *c; c++) most += *c == '=';
    if (most == 0) return true;
    made->attribute = take(b, most, sizeof *made->attribute);
    if (!made->attribute) return false;
    while (*format) {
        size_t length = strcspn(format, "=");
        Onnx__AttributeProto *attribute = take(b, 1, sizeof *attribute);
        char *name = take(b, length + 1, 1);
        if (!attribute || !name) return false;
        onnx__attribute_proto__init(attribute);
        memcpy(name, format, length);
        attribute->name = name;
        if (format[length] != '=' || !add_attribute(b, attribute, format[length + 1], arguments)) return false;
        made->attribute[made->n_attribute++] = attribute;
        format += length + 2;
        format += strspn(format, " ");
    }
    return true;
}

static int node(void *self, const char *op_type, int n_in, const int *in, const char *attributes_format, ...)
{
    builder *b = self;
    if (!grow(b, &b->nodes, b->n_nodes, &b->room_nodes, sizeof(Onnx__NodeProto *))) return -1;
    int number = new_value(b, op_type, true);
    Onnx__NodeProto *made = take(b, 1, sizeof *made);
    char **inputs = take(b, (size_t)n_in + 1, sizeof *inputs), **outputs = take(b, 1, sizeof *outputs);
    if (number < 0 || !made || !inputs || !outputs) return -1;
    onnx__node_proto__init(made);
    made->op_type = copy_text(b, op_type);
    made->name = b->values[number].name;
    made->input = inputs;
    made->output = outputs;
    made->n_output = 1;
    outputs[0] = b->values[number].name;
    for (int i = 0; i < n_in; i++) {
        bool there = in[i] >= 0 && in[i] < b->n_values;
        inputs[i] = there ? b->values[in[i]].name : (char *)protobuf_c_empty_string;
        if (there) {
            made->n_input = (size_t)i + 1; /* absent inputs at the end are left out */
            b->values[number].from_input |= b->values[in[i]].from_input;
        }
    }
    va_list arguments;
    va_start(arguments, attributes_format);
    bool fine = add_attributes(b, made, attributes_format ? attributes_format : "", &arguments);
    va_end(arguments);
    if (!fine) {
        if (b->status == HG_OK)
            b->status = hg_fail(HG_INVALID,
                                "ONNX export: op '%s': attributes \"%s\" of %s are not written as \"name=i\", "
                                "\"name=f\", \"name=s\" or \"name=I\"",
                                b->call ? b->call->op->name : "?", attributes_format, op_type);
        return -1;
    }
    b->nodes[b->n_nodes++] = made;
    return number;
}

static hg_status output(void *self, const hg_tensor *tensor, int number)
{
    builder *b = self;
    if (b->status != HG_OK) return b->status;
    if (number < 0 || number >= b->n_values)
        return b->status = hg_fail(HG_INVALID, "ONNX export: op '%s' gave no value for its output",
                                   b->call ? b->call->op->name : "?");
    return remember(b, tensor, number);
}

/* ---- the formula --------------------------------------------------------------------------------------------- */

/* Emits the calls from `first` on. */
static hg_status emit_calls(builder *b, int first)
{
    hg_emitter emitter = { b, input, constant, constant_f32, constant_i64, node, output };
    int n = hg_tape_count(b->ctx);
    for (int i = first; i < n; i++) {
        const hg_call *call = hg_tape_call(b->ctx, i);
        b->call = call;
        if (!call->op->emit) {
            char place[256] = "";
            if (call->file) snprintf(place, sizeof place, " (recorded at %.200s:%d)", call->file, call->line);
            return hg_fail(HG_UNSUPPORTED,
                           "ONNX export: op '%s'%s has no ONNX form; write the formula with others or give the op an "
                           "emitter",
                           call->op->name, place);
        }
        hg_status status = call->op->emit(call, &emitter);
        HG_TRY(b->status);
        HG_TRY(status);
        if (find_value(b, call->out) < 0)
            return hg_fail(HG_INVALID, "ONNX export: the emitter of op '%s' named no value for its output",
                           call->op->name);
    }
    b->call = NULL;
    return HG_OK;
}

/* `open`: names of the leading axes whose length is not fixed. */
static Onnx__ValueInfoProto *describe(builder *b, const char *name, const hg_tensor *tensor, int n_open,
                                      const char *const *open)
{
    Onnx__ValueInfoProto *info = take(b, 1, sizeof *info);
    Onnx__TypeProto *type = take(b, 1, sizeof *type);
    Onnx__TypeProto__Tensor *of = take(b, 1, sizeof *of);
    Onnx__TensorShapeProto *shape = take(b, 1, sizeof *shape);
    Onnx__TensorShapeProto__Dimension **dims = take(b, (size_t)tensor->rank + 1, sizeof *dims);
    if (!info || !type || !of || !shape || !dims) return NULL;
    onnx__value_info_proto__init(info);
    onnx__type_proto__init(type);
    onnx__type_proto__tensor__init(of);
    onnx__tensor_shape_proto__init(shape);
    for (int k = 0; k < tensor->rank; k++) {
        dims[k] = take(b, 1, sizeof **dims);
        if (!dims[k]) return NULL;
        onnx__tensor_shape_proto__dimension__init(dims[k]);
        if (k < n_open) {
            dims[k]->value_case = ONNX__TENSOR_SHAPE_PROTO__DIMENSION__VALUE_DIM_PARAM;
            dims[k]->dim_param = copy_text(b, open[k]);
        } else {
            dims[k]->value_case = ONNX__TENSOR_SHAPE_PROTO__DIMENSION__VALUE_DIM_VALUE;
            dims[k]->dim_value = tensor->shape[k];
        }
    }
    shape->n_dim = (size_t)tensor->rank;
    shape->dim = dims;
    of->has_elem_type = true;
    of->elem_type = element_type(tensor->dtype);
    of->shape = shape;
    type->value_case = ONNX__TYPE_PROTO__VALUE_TENSOR_TYPE;
    type->tensor_type = of;
    info->name = copy_text(b, name);
    info->type = type;
    return info;
}

static hg_status write_model(builder *b, const char *path, const hg_onnx_options *options, int n_in,
                             Onnx__ValueInfoProto **in, Onnx__ValueInfoProto *out)
{
    Onnx__GraphProto graph = ONNX__GRAPH_PROTO__INIT;
    Onnx__ModelProto model = ONNX__MODEL_PROTO__INIT;
    Onnx__OperatorSetIdProto opset = ONNX__OPERATOR_SET_ID_PROTO__INIT, *opsets[1] = { &opset };
    opset.domain = copy_text(b, "");
    opset.has_version = true;
    opset.version = OPSET;
    graph.name = copy_text(b, options->graph ? options->graph : "hairgrad");
    graph.doc_string = options->doc ? copy_text(b, options->doc) : NULL;
    graph.n_node = b->n_nodes;
    graph.node = b->nodes;
    graph.n_initializer = b->n_initialisers;
    graph.initializer = b->initialisers;
    graph.n_input = (size_t)n_in;
    graph.n_output = 1;
    graph.input = in;
    graph.output = &out;
    model.has_ir_version = true;
    model.ir_version = IR_VERSION;
    model.n_opset_import = 1;
    model.opset_import = opsets;
    model.producer_name = copy_text(b, "hairgrad");
    model.producer_version = copy_text(b, HG_VERSION);
    model.doc_string = graph.doc_string;
    model.graph = &graph;
    size_t n = options->n_metadata > 0 ? (size_t)options->n_metadata : 0;
    model.metadata_props = take(b, n + 1, sizeof *model.metadata_props);
    for (size_t i = 0; i < n && b->status == HG_OK; i++) {
        Onnx__StringStringEntryProto *entry = take(b, 1, sizeof *entry);
        if (!entry) break;
        onnx__string_string_entry_proto__init(entry);
        entry->key = copy_text(b, options->metadata[i].key);
        entry->value = copy_text(b, options->metadata[i].value);
        model.metadata_props[model.n_metadata_props++] = entry;
    }
    HG_TRY(b->status);
    size_t size = onnx__model_proto__get_packed_size(&model);
    if (size > LARGEST_FILE)
        return hg_fail(HG_UNSUPPORTED,
                       "%s: would have %zu bytes, and one ONNX file holds less than 2 GiB; export the "
                       "weights with --to h5 instead",
                       path, size);
    uint8_t *bytes = hg_alloc(size, 1);
    if (!bytes) return HG_MEMORY;
    onnx__model_proto__pack(&model, bytes);
    hg_status status = hg_file_write(path, bytes, size);
    hg_free(bytes);
    return status;
}

/* The probe of an input, and what the file says of it. */
typedef struct {
    int n;
    hg_onnx_input input[HG_ONNX_INPUTS];
    hg_tensor *probe[HG_ONNX_INPUTS];
} probes;

/* How many rows a probe has: another number for every row axis, so that one is never taken for another. */
static int64_t rows_of(const probes *p, int i)
{
    for (int k = 0; k < i; k++)
        if (!strcmp(p->input[k].rows, p->input[i].rows)) return rows_of(p, k);
    return PROBE_ROWS + 2 * i;
}

/* Names the output and writes the file, once every call has its nodes. */
static hg_status finish(builder *b, const char *path, const hg_onnx_options *options, const probes *in,
                        const hg_tensor *result)
{
    static const char *const strands = "strands";
    const int n_open = options->n_output_rows ? options->n_output_rows : 1;
    const char *const *open = options->n_output_rows ? options->output_rows : &strands;
    int last = input(b, result);
    HG_TRY(b->status);
    if (last < 0 || !b->values[last].from_input)
        return hg_fail(HG_INVALID, "%s: the output of the formula does not depend on its input by recorded ops", path);
    for (int k = 0; k < n_open; k++) {
        int64_t rows = 0;
        for (int i = 0; i < in->n; i++)
            if (!strcmp(in->input[i].rows, open[k])) rows = rows_of(in, i);
        if (result->rank <= k || result->shape[k] != rows)
            return hg_fail(HG_INVALID, "%s: the formula gives %lld rows for %lld", path,
                           (long long)(result->rank <= k ? 1 : result->shape[k]), (long long)rows);
    }
    int named = node(b, "Identity", 1, &last, "");
    HG_TRY(b->status);
    const char *name = options->output ? options->output : "output";
    if (name_taken(b, name))
        return hg_fail(HG_INVALID, "%s: the output cannot be called '%s': a weight or the input has that name", path,
                       name);
    b->nodes[b->n_nodes - 1]->output[0] = copy_text(b, name);
    HG_TRY(b->status);
    b->values[named].name = b->nodes[b->n_nodes - 1]->output[0];
    Onnx__ValueInfoProto *inputs[HG_ONNX_INPUTS];
    for (int i = 0; i < in->n; i++)
        inputs[i] = describe(b, b->values[i].name, in->probe[i], 1, (const char *const[]){ in->input[i].rows });
    Onnx__ValueInfoProto *out = describe(b, name, result, n_open, open);
    HG_TRY(b->status);
    return write_model(b, path, options, in->n, inputs, out);
}

/* Numbers of order one, none of them special. */
static hg_status fill_probe(hg_tensor *probe, uint64_t stream)
{
    int64_t n = hg_tensor_count(probe);
    float *data = hg_alloc((size_t)n, sizeof *data);
    if (!data) return HG_MEMORY;
    for (int64_t i = 0; i < n; i++) data[i] = (float)(2.0 * hg_random_uniform(7, stream, (uint64_t)i) - 1.0);
    hg_status status = hg_tensor_write(probe, data);
    hg_free(data);
    return status;
}

static hg_status make_probes(hg_ctx *ctx, const char *path, const hg_onnx_options *options, probes *p)
{
    p->n = options->n_inputs ? options->n_inputs : 1;
    if (p->n > HG_ONNX_INPUTS) return hg_fail(HG_INVALID, "%s: %d inputs; at most %d", path, p->n, HG_ONNX_INPUTS);
    for (int i = 0; i < p->n; i++) {
        p->input[i] =
            options->n_inputs ? options->inputs[i] : (hg_onnx_input){ options->input, options->columns, NULL };
        if (!p->input[i].rows) p->input[i].rows = "strands";
        if (p->input[i].columns < 1)
            return hg_fail(HG_INVALID, "%s: the network has %lld inputs", path, (long long)p->input[i].columns);
        p->probe[i] = hg_tensor_make(ctx, HG_F32, 2, (int64_t[]){ rows_of(p, i), p->input[i].columns });
        if (!p->probe[i]) return hg_ctx_status(ctx);
        HG_TRY(fill_probe(p->probe[i], (uint64_t)i));
    }
    return HG_OK;
}

hg_status hg_onnx_export_several(hg_ctx *ctx, const char *path,
                                 hg_tensor *(*forward)(void *self, hg_ctx *ctx, hg_tensor **inputs), void *self,
                                 const hg_onnx_options *options)
{
    probes in = { 0 };
    HG_TRY(hg_ctx_status(ctx));
    HG_TRY(make_probes(ctx, path, options, &in));
    int first = hg_tape_count(ctx);
    hg_tape_record_all(ctx, true);
    hg_tensor *result = forward(self, ctx, in.probe);
    hg_tape_record_all(ctx, false);
    HG_TRY(hg_ctx_status(ctx));
    if (!result) return hg_fail(HG_INVALID, "%s: the formula gave no tensor", path);

    builder b = { .ctx = ctx };
    hg_status status = HG_OK;
    for (int i = 0; status == HG_OK && i < in.n; i++) {
        int number = new_value(&b, in.input[i].name ? in.input[i].name : "input", false);
        if (number >= 0) b.values[number].from_input = true;
        status = number < 0 ? b.status : remember(&b, in.probe[i], number);
    }
    if (status == HG_OK) status = emit_calls(&b, first);
    if (status == HG_OK) status = finish(&b, path, options, &in, result);
    release(&b);
    return status;
}

typedef struct {
    hg_tensor *(*forward)(void *self, hg_ctx *ctx, hg_tensor *input);
    void *self;
} one_input;

static hg_tensor *forward_one(void *self, hg_ctx *ctx, hg_tensor **inputs)
{
    const one_input *one = self;
    return one->forward(one->self, ctx, inputs[0]);
}

hg_status hg_onnx_export(hg_ctx *ctx, const char *path,
                         hg_tensor *(*forward)(void *self, hg_ctx *ctx, hg_tensor *input), void *self,
                         const hg_onnx_options *options)
{
    return hg_onnx_export_several(ctx, path, forward_one, &(one_input){ forward, self }, options);
}
