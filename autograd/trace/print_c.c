/* Printed C: a strand program as one function over vectors, a SIMD lane per strand. The lists are printed as they are, a
 * constant per register; the compiler allocates, fuses a b + c and schedules. */
#include "autograd/trace/strand.h"

#include <stdio.h>
#include <string.h>

typedef struct {
    const hg_strand_program *program; /* NULL: a function */
    const hg_numbers *numbers;
    hg_text *text;
    bool warp;                                    /* for lanes that have a site each: see print_cuda.c */
    const hg_instruction *defined[INT16_MAX + 1]; /* of the list being printed */
} printer;

/* all: as a vector even where it is the same for all lanes */
static void operand(printer *p, hg_operand o, bool all)
{
    hg_text *text = p->text;
    const hg_strand_program *program = p->program;
    if (o.place >= HG_PLACE_ARRAY) {
        const bool gradient = o.place >= HG_PLACE_ARRAY_GRADIENT;
        const int k = o.place - (gradient ? HG_PLACE_ARRAY_GRADIENT : HG_PLACE_ARRAY);
        char name[40];
        hg_strand_array_name(p->program, k, gradient, name);
        hg_text_add(text, "%s[%d]", name, program->arrays[k].width * o.offset + o.index);
        return;
    }
    switch (o.place) {
    case HG_PLACE_REGISTER:
        hg_text_add(text, "r%d", o.index);
        return;
    case HG_PLACE_NUMBER: {
        char literal[40];
        const double value = p->numbers->values[o.index];
        snprintf(literal, sizeof literal, "%.17g", value);
        if (!strpbrk(literal, ".en")) strcat(literal, ".0");
        hg_text_add(text, all ? "hg_v_all(HG_R(%s))" : value < 0 ? "(HG_R(%s))" : "HG_R(%s)", literal);
        return;
    }
    case HG_PLACE_IN:
    case HG_PLACE_OUT:
        hg_text_add(text, o.place == HG_PLACE_IN ? "in[%d]" : "out[%d]", o.index);
        return;
    case HG_PLACE_UNIFORM:
        hg_text_add(text, all ? "hg_v_all(u[%d])" : "u[%d]", o.index);
        return;
    case HG_PLACE_SITE:
        if (p->warp)
            hg_text_add(text, "site[V * %d + %d]", o.index, o.offset);
        else
            hg_text_add(text, "site[%d]", o.offset * p->program->n_site + o.index);
        return;
    case HG_PLACE_GROOM_STRAND:
        hg_text_add(text, "groom_strand[%d]", o.index);
        return;
    case HG_PLACE_STRAND:
        hg_text_add(text, "strand[%d]", o.index);
        return;
    case HG_PLACE_ADJOINT:
        hg_text_add(text, "adjoint[%d]", o.index);
        return;
    case HG_PLACE_ENERGY:
        hg_text_add(text, "energy[%d]", o.index);
        return;
    case HG_PLACE_STRAND_INPUT:
        hg_text_add(text, "input[%d]", o.index);
        return;
    case HG_PLACE_STRAND_INPUT_GRADIENT:
        hg_text_add(text, "input_gradient[%d]", o.index);
        return;
    case HG_PLACE_ROOT_X0:
    case HG_PLACE_ROOT_REST0:
        hg_text_add(text, "tile_%s[%d]", o.place == HG_PLACE_ROOT_X0 ? "x" : "rest", o.index);
        return;
    case HG_PLACE_ROOT_X1:
    case HG_PLACE_ROOT_REST1:
        hg_text_add(text, "tile_%s[second + %d]", o.place == HG_PLACE_ROOT_X1 ? "x" : "rest", o.index);
        return;
    case HG_PLACE_GRADIENT_X0:
    case HG_PLACE_GRADIENT_REST0:
        hg_text_add(text, "tile_gradient_%s[%d]", o.place == HG_PLACE_GRADIENT_X0 ? "x" : "rest", o.index);
        return;
    case HG_PLACE_GRADIENT_X1:
    case HG_PLACE_GRADIENT_REST1:
        hg_text_add(text, p->warp ? "tile_gradient_%s[second_share + %d]" : "tile_gradient_%s[second + %d]",
                    o.place == HG_PLACE_GRADIENT_X1 ? "x" : "rest", o.index);
        return;
    case HG_PLACE_CARRY:
        hg_text_add(text, "carry[%d]", program->n_carry * o.offset + o.index);
        return;
    default:
        hg_text_add(text, "carry_adjoint[%d]", program->n_carry * o.offset + o.index);
        return;
    }
}

static void call(printer *p, const char *name, int n, const hg_operand *operands)
{
    hg_text_add(p->text, "%s(", name);
    for (int i = 0; i < n; i++) {
        if (i) hg_text_add(p->text, ", ");
        operand(p, operands[i], true);
    }
    hg_text_add(p->text, ")");
}

static const hg_instruction *definition(const printer *p, hg_operand o, int op)
{
    if (o.place != HG_PLACE_REGISTER) return NULL;
    const hg_instruction *in = p->defined[o.index];
    return in && in->op == op ? in : NULL;
}

static bool scalar(hg_operand o) { return o.place == HG_PLACE_NUMBER || o.place == HG_PLACE_UNIFORM; }

static void infix(printer *p, const hg_instruction *in, const char *sign)
{
    operand(p, in->a, scalar(in->b));
    hg_text_add(p->text, " %s ", sign);
    operand(p, in->b, false);
}

static void expression(printer *p, const hg_instruction *in)
{
    static const char *const functions[HG_NODE_OPS] = {
        [HG_NODE_SQRT] = "hg_v_sqrt", [HG_NODE_RSQRT] = "hg_v_rsqrt", [HG_NODE_ABS] = "hg_v_abs",
        [HG_NODE_EXP] = "hg_v_exp",   [HG_NODE_LOG] = "hg_v_log",     [HG_NODE_SIN] = "hg_v_sin",
        [HG_NODE_COS] = "hg_v_cos",   [HG_NODE_ATAN2] = "hg_v_atan2", [HG_NODE_MIN] = "hg_v_min",
        [HG_NODE_MAX] = "hg_v_max",   [HG_NODE_LESS] = "hg_v_less",   [HG_NODE_SELECT] = "hg_v_select",
    };
    const hg_operand operands[4] = { in->a, in->b, in->c, { 0 } };
    const hg_instruction *other;
    switch (in->op) {
    case HG_NODE_ADD:
        infix(p, in, "+");
        return;
    case HG_NODE_SUB:
        infix(p, in, "-");
        return;
    case HG_NODE_MUL:
        infix(p, in, "*");
        return;
    case HG_NODE_DIV: /* a / sqrt(b): a root and a division are the dearest there is; one reciprocal root is cheaper */
        if ((other = definition(p, in->b, HG_NODE_SQRT))) {
            operand(p, in->a, true);
            hg_text_add(p->text, " * ");
            call(p, "hg_v_rsqrt", 1, &other->a);
            return;
        }
        infix(p, in, "/");
        return;
    case HG_NODE_NEG:
        hg_text_add(p->text, "-");
        operand(p, in->a, true);
        return;
    case HG_NODE_SELECT:
        if ((other = definition(p, in->a, HG_NODE_LESS))) {
            const hg_operand four[4] = { other->a, other->b, in->b, in->c };
            call(p, "hg_v_if_less", 4, four);
            return;
        }
        break;
    default:
        break;
    }
    call(p, functions[in->op], hg_node_arguments(in->op), operands);
}

static void list(printer *p, const hg_code *code, const char *indent)
{
    bool *needed = hg_alloc((size_t)code->registers + 1, sizeof *needed);
    if (!needed) {
        p->text->failed = true;
        return;
    }
    for (int i = 0; i < code->n; i++)
        if (code->instructions[i].to.place == HG_PLACE_REGISTER)
            p->defined[code->instructions[i].to.index] = &code->instructions[i];
    for (int i = 0; i < code->n; i++) { /* what the shorter forms above leave out */
        const hg_instruction *in = &code->instructions[i];
        const hg_operand from[3] = { in->a, in->b, in->c };
        for (int k = 0; k < 3; k++) {
            if (from[k].place != HG_PLACE_REGISTER) continue;
            if (in->op == HG_NODE_SELECT && k == 0 && definition(p, from[0], HG_NODE_LESS)) continue;
            if (in->op == HG_NODE_DIV && k == 1 && definition(p, from[1], HG_NODE_SQRT)) continue;
            needed[from[k].index] = true;
        }
    }
    for (int i = 0; i < code->n; i++) {
        const hg_instruction *in = &code->instructions[i];
        if (in->to.place == HG_PLACE_REGISTER && !needed[in->to.index]) continue;
        hg_text_add(p->text, "%s", indent);
        if (in->to.place == HG_PLACE_REGISTER) {
            hg_text_add(p->text, "const hg_v r%d = ", in->to.index);
            expression(p, in);
        } else {
            operand(p, in->to, true);
            hg_text_add(p->text, in->op == HG_DO_ADD_TO ? " += " : " = ");
            operand(p, in->a, true);
        }
        hg_text_add(p->text, ";\n");
    }
    hg_free(needed);
}

/* Does a list touch the place? Pointers that nobody uses are not printed. */
static bool touches(const hg_code *code, int place)
{
    for (int i = 0; i < code->n; i++) {
        const hg_instruction *in = &code->instructions[i];
        if (in->to.place == place || in->a.place == place || in->b.place == place || in->c.place == place) return true;
    }
    return false;
}

/* Does a list touch anything that lies by vertex? */
static bool touches_vertex(const hg_strand_program *program, const hg_code *code)
{
    bool any = touches(code, HG_PLACE_SITE) || touches(code, HG_PLACE_CARRY) || touches(code, HG_PLACE_CARRY_ADJOINT);
    for (int k = 0; k < program->n_arrays; k++)
        any |= touches(code, HG_PLACE_ARRAY + k) || touches(code, HG_PLACE_ARRAY_GRADIENT + k);
    return any;
}

static void vertex(printer *p, const hg_code *code, const char *indent)
{
    const hg_strand_program *program = p->program;
    hg_text *text = p->text;
    for (int k = 0; k < program->n_arrays; k++)
        for (int gradient = 0; gradient < 2; gradient++) {
            char name[40];
            hg_strand_array_name(p->program, k, gradient, name);
            if (touches(code, (gradient ? HG_PLACE_ARRAY_GRADIENT : HG_PLACE_ARRAY) + k))
                hg_text_add(text, "%s%s %s = tile_%s + %d * i;\n", indent, gradient ? "hg_tile" : "hg_tile_read", name,
                            name, program->arrays[k].width);
        }
    if (touches(code, HG_PLACE_SITE))
        hg_text_add(text, "%shg_tile_read site = sites + i * %d;\n", indent, program->n_site);
    if (touches(code, HG_PLACE_CARRY))
        hg_text_add(text, "%shg_tile carry = tile_carry + i * %d;\n", indent, program->n_carry);
    if (touches(code, HG_PLACE_CARRY_ADJOINT))
        hg_text_add(text, "%shg_tile carry_adjoint = tile_carry_adjoint + i * %d;\n", indent, program->n_carry);
    list(p, code, indent);
}

/* "width * rows of V vertices" */
static void size(printer *p, const hg_strand_input *array)
{
    hg_text_add(p->text, array->missing ? "%d * (V - %d)" : "%d * V", array->width, array->missing);
}

/* Every site asks for its share of the next tile's rows, and of the rows that this tile's gradient will go to. */
static void ahead(printer *p, int first)
{
    const hg_strand_program *program = p->program;
    hg_text *text = p->text;
    for (int k = 0; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        hg_text_add(text, "            hg_v_soon(args->array[%d], HG_BYTES * ((%s + count) * (", k,
                    array->rest ? "in_groom" : "at");
        size(p, array);
        hg_text_add(text, ") + (i - %d) * %d * HG_LANES), %d * HG_LANES * HG_BYTES);\n", first, array->width,
                    array->width);
        if (!array->gradient) continue;
        hg_text_add(text, "            hg_v_soon_written(args->array_gradient[%d], HG_BYTES * (at * (", k);
        size(p, array);
        hg_text_add(text, ") + (i - %d) * %d * HG_LANES), %d * HG_LANES * HG_BYTES);\n", first, array->width,
                    array->width);
    }
    if (program->n_site)
        hg_text_add(
            text,
            "            hg_v_soon(sites, (int64_t)sizeof(hg_v) * %d * (V + i - %d), %d * HG_LANES * HG_BYTES);\n",
            program->n_site, first, program->n_site);
}

/* One list per body: the first ones once, the last for every vertex from there on; back: from tip to root. */
static void walk(printer *p, const hg_code *bodies, bool back, bool look_ahead)
{
    const int last = p->program->bodies - 1;
    hg_text *text = p->text;
    for (int n = 0; n <= last; n++) {
        const int b = back ? last - n : n;
        if (bodies[b].n == 0) continue;
        if (b < last) {
            hg_text_add(text, "        if (V > %d) {\n", b);
            if (touches_vertex(p->program, &bodies[b])) hg_text_add(text, "            const int64_t i = %d;\n", b);
        } else if (back)
            hg_text_add(text, "        for (int64_t i = V - 1; i >= %d; i--) {\n", b);
        else
            hg_text_add(text, "        for (int64_t i = %d; i < V; i++) {\n", b);
        if (b == last && look_ahead) ahead(p, b);
        vertex(p, &bodies[b], "            ");
        hg_text_add(text, "        }\n");
    }
}

static void tile(printer *p, const char *name, hg_strand_tile at)
{
    hg_text_add(p->text, "    hg_tile tile_%s = hg_v_tile(scratch, %d * V + %d);\n", name, at.rows, at.extra);
}

static void load(printer *p)
{
    const hg_strand_program *program = p->program;
    hg_text *text = p->text;
    char name[40];
    for (int k = 0; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        hg_strand_array_name(p->program, k, false, name);
        hg_text_add(text, "        hg_v_load_tile(tile_%s, (const hg_real *)args->array[%d] + %s * (", name, k,
                    array->rest ? "in_groom" : "at");
        size(p, array);
        hg_text_add(text, "), ");
        size(p, array);
        hg_text_add(text, ", count);\n");
        if (!program->n_carry || !array->gradient) continue;
        hg_text_add(text, "        for (int64_t k = 0; k < "); /* on the way back no site is the first at a vertex */
        size(p, array);
        hg_text_add(text, "; k++) tile_gradient_%s[k] = hg_v_all(HG_R(0.0));\n", name);
    }
}

static void store(printer *p)
{
    const hg_strand_program *program = p->program;
    hg_text *text = p->text;
    char name[40];
    for (int k = 0; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        if (!array->gradient) continue;
        hg_strand_array_name(p->program, k, true, name);
        hg_text_add(text,
                    "        if (args->array_gradient[%d])\n"
                    "            hg_v_store_tile((hg_real *)args->array_gradient[%d] + at * (",
                    k, k);
        size(p, array);
        hg_text_add(text, "), tile_%s, ", name);
        size(p, array);
        hg_text_add(text, ", count);\n");
    }
    for (int j = 0; j < program->n_inputs; j++) {
        const hg_strand_input *input = &program->inputs[j];
        if (!input->gradient) continue;
        hg_text_add(
            text,
            "        if (args->strand_input_gradient[%d])\n"
            "            hg_v_store_tile((hg_real *)args->strand_input_gradient[%d] + at * %d, input_gradient + "
            "%d, %d, count);\n",
            j, j, input->width, input->first, input->width);
    }
    hg_text_add(text, "        hg_v_store_energy(args, t, at, count, energy, %d);\n", program->n_terms);
}

static bool touches_input(const hg_code *code, const hg_strand_input *input)
{
    for (int i = 0; i < code->n; i++) {
        const hg_operand from[3] = { code->instructions[i].a, code->instructions[i].b, code->instructions[i].c };
        for (int k = 0; k < 3; k++)
            if (from[k].place == HG_PLACE_STRAND_INPUT && from[k].index >= input->first &&
                from[k].index < input->first + input->width)
                return true;
    }
    return false;
}

static void preamble(printer *p)
{
    const hg_strand_program *program = p->program;
    hg_text *text = p->text;
    hg_text_add(text, "        {\n");
    if (touches(&program->preamble, HG_PLACE_STRAND_INPUT))
        hg_text_add(text, "            hg_v input[%d];\n", program->input_width);
    for (int j = 0; j < program->n_inputs; j++) {
        const hg_strand_input *input = &program->inputs[j];
        if (touches_input(&program->preamble, input))
            hg_text_add(text,
                        "            hg_v_load_tile(input + %d, (const hg_real *)args->strand_input[%d] + %d * at, %d, "
                        "count);\n",
                        input->first, j, input->width, input->width);
    }
    list(p, &program->preamble, "            ");
    hg_text_add(text, "        }\n");
}

void hg_strand_print_c(const hg_strand_program *program, const char *name, hg_text *text)
{
    printer *p = hg_alloc(1, sizeof *p);
    if (!p) {
        text->failed = true;
        return;
    }
    p->program = program;
    p->numbers = &program->numbers;
    p->text = text;
    bool second = false, rest = program->n_site || program->n_groom_strand;
    for (int place = HG_PLACE_ROOT_X0; place <= HG_PLACE_ROOT_REST1; place++)
        second |= (place == HG_PLACE_ROOT_X1 || place == HG_PLACE_ROOT_REST1) && touches(&program->preamble, place);
    second |=
        touches(&program->postamble, HG_PLACE_GRADIENT_X1) || touches(&program->postamble, HG_PLACE_GRADIENT_REST1);
    bool rest_array = false;
    for (int k = 0; k < program->n_arrays; k++) rest_array |= program->arrays[k].rest;
    bool input_gradient = false;
    for (int j = 0; j < program->n_inputs; j++) input_gradient |= program->inputs[j].gradient;

    hg_text_add(text, "static void %s(const hg_strand_args *args, int64_t first, int64_t last, void *scratch)\n{\n",
                name);
    hg_text_add(text, "    const int64_t V = args->vertices, S = args->strands;\n");
    if (program->n_uniform) hg_text_add(text, "    const hg_real *restrict u = (const hg_real *)args->uniform;\n");
    if (second) hg_text_add(text, "    const int64_t second = V > 1 ? 3 : 0;\n");
    for (int k = 0; k < program->n_arrays; k++) {
        char own[40];
        hg_strand_array_name(p->program, k, true, own);
        if (program->arrays[k].gradient) tile(p, own, program->arrays[k].gradient_tile);
        hg_strand_array_name(p->program, k, false, own);
        tile(p, own, program->arrays[k].tile);
    }
    if (program->n_carry) {
        tile(p, "carry", program->carry_tile);
        tile(p, "carry_adjoint", program->carry_adjoint_tile);
    }
    hg_text_add(text, "    for (int64_t t = first; t < last; t++) {\n"
                      "        const int64_t frame = t / args->tiles, s = t %% args->tiles * HG_LANES;\n"
                      "        const int64_t count = S - s < HG_LANES ? S - s : HG_LANES, at = frame * S + s;\n");
    if (rest || rest_array) hg_text_add(text, "        const int64_t groom = args->groom ? args->groom[frame] : 0;\n");
    if (rest) hg_text_add(text, "        const int64_t stored = groom * args->tiles + t %% args->tiles;\n");
    if (rest_array) hg_text_add(text, "        const int64_t in_groom = groom * S + s;\n");
    if (program->n_site)
        hg_text_add(text, "        hg_tile_read sites = hg_v_stored(args->site, stored, V * %d);\n", program->n_site);
    if (program->n_groom_strand)
        hg_text_add(text, "        hg_tile_read groom_strand = hg_v_stored(args->groom_strand, stored, %d);\n",
                    program->n_groom_strand);
    load(p);
    hg_text_add(text, "        hg_v energy[%d] = { 0 };\n", program->n_terms);
    if (program->n_adjoint) hg_text_add(text, "        hg_v adjoint[%d] = { 0 };\n", program->n_adjoint);
    if (program->n_strand) hg_text_add(text, "        hg_v strand[%d];\n", program->n_strand);
    if (input_gradient) hg_text_add(text, "        hg_v input_gradient[%d];\n", program->input_width);
    preamble(p);
    if (program->n_carry) {
        walk(p, program->forward, false, false);
        hg_text_add(text,
                    "        for (int k = 0; k < %d; k++) tile_carry_adjoint[%d * V + k] = hg_v_all(HG_R(0.0));\n",
                    program->n_carry, program->n_carry);
        walk(p, program->body, true, true);
    } else {
        walk(p, program->body, false, true);
    }
    hg_text_add(text, "        {\n");
    list(p, &program->postamble, "            ");
    hg_text_add(text, "        }\n");
    store(p);
    hg_text_add(text, "    }\n}\n");
    hg_free(p);
}

/* ---- for the other printer ---------------------------------------------------------------------------------- */

void hg_strand_print_list(const hg_strand_program *program, const hg_code *code, bool warp, const char *indent,
                          hg_text *text)
{
    printer *p = hg_alloc(1, sizeof *p);
    if (!p) {
        text->failed = true;
        return;
    }
    p->program = program;
    p->numbers = &program->numbers;
    p->text = text;
    p->warp = warp;
    list(p, code, indent);
    hg_free(p);
}

void hg_strand_array_name(const hg_strand_program *program, int k, bool gradient, char name[40])
{
    const hg_strand_input *array = &program->arrays[k];
    char own[24];
    if (array->kind == HG_INPUT_ATTRIBUTE || array->kind == HG_INPUT_FRAME)
        snprintf(own, sizeof own, "array_%d", k);
    else
        snprintf(own, sizeof own, "%s", hg_input_name(array->kind));
    snprintf(name, 40, gradient ? "gradient_%s" : "%s", own);
}

bool hg_strand_list_touches(const hg_code *code, int place) { return touches(code, place); }

void hg_function_print_cuda(const hg_function *function, const char *name, hg_text *text)
{
    printer *p = hg_alloc(1, sizeof *p);
    if (!p) {
        text->failed = true;
        return;
    }
    const hg_code *code = hg_function_code(function, &p->numbers);
    p->text = text;
    hg_text_add(text, "template <class hg_v> static __device__ inline void %s(const hg_v *in, hg_v *out)\n{\n", name);
    list(p, code, "    ");
    hg_text_add(text, "}\n");
    hg_free(p);
}
