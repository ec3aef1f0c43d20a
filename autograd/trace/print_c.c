/* Printed C: a strand program as one function over vectors, a SIMD lane per strand. The lists are printed as they are, a
 * constant per register; the compiler allocates, fuses a b + c and schedules. */
#include "autograd/trace/strand.h"

#include <stdio.h>
#include <string.h>

typedef struct {
    const hg_strand_program *program;
    hg_text *text;
    const hg_instruction *defined[INT16_MAX + 1]; /* of the list being printed */
} printer;

static const char *const array_names[HG_STRAND_ARRAYS] = { "x",        "posed",         "predicted",
                                                           "previous", "contact_point", "contact_normal" };

/* all: as a vector even where it is the same for all lanes */
static void operand(printer *p, hg_operand o, bool all)
{
    hg_text *text = p->text;
    switch (o.place) {
    case HG_PLACE_REGISTER:
        hg_text_add(text, "r%d", o.index);
        return;
    case HG_PLACE_NUMBER: {
        char literal[40];
        const double value = p->program->numbers.values[o.index];
        snprintf(literal, sizeof literal, "%.17g", value);
        if (!strpbrk(literal, ".en")) strcat(literal, ".0");
        hg_text_add(text, all ? "hg_v_all(HG_R(%s))" : value < 0 ? "(HG_R(%s))" : "HG_R(%s)", literal);
        return;
    }
    case HG_PLACE_UNIFORM:
        hg_text_add(text, all ? "hg_v_all(u[%d])" : "u[%d]", o.index);
        return;
    case HG_PLACE_SITE:
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
    case HG_PLACE_ROOT:
        hg_text_add(text, "root[%d]", o.index);
        return;
    case HG_PLACE_ROOT_X0:
        hg_text_add(text, "tile_x[%d]", o.index);
        return;
    case HG_PLACE_ROOT_X1:
        hg_text_add(text, "tile_x[second + %d]", o.index);
        return;
    case HG_PLACE_GRADIENT:
        hg_text_add(text, "g[%d]", 3 * o.offset + o.index);
        return;
    case HG_PLACE_GRADIENT0:
        hg_text_add(text, "gradient[%d]", o.index);
        return;
    case HG_PLACE_GRADIENT1:
        hg_text_add(text, "gradient[second + %d]", o.index);
        return;
    default:
        hg_text_add(text, "%s[%d]", array_names[o.place - HG_PLACE_X], 3 * o.offset + o.index);
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

static void body(printer *p, int number, const char *indent)
{
    const hg_strand_program *program = p->program;
    const hg_code *code = &program->body[number];
    hg_text *text = p->text;
    for (int k = 0; k < HG_STRAND_ARRAYS; k++)
        if (touches(code, HG_PLACE_X + k))
            hg_text_add(text, "%sconst hg_v *restrict %s = tile_%s + 3 * i;\n", indent, array_names[k], array_names[k]);
    if (touches(code, HG_PLACE_SITE))
        hg_text_add(text, "%sconst hg_v *restrict site = sites + i * %d;\n", indent, program->n_site);
    hg_text_add(text, "%shg_v *restrict g = gradient + 3 * i;\n", indent);
    list(p, code, indent);
}

void hg_strand_print_c(const hg_strand_program *program, const char *name, hg_text *text)
{
    printer *p = hg_alloc(1, sizeof *p);
    if (!p) {
        text->failed = true;
        return;
    }
    p->program = program;
    p->text = text;
    const bool second =
        touches(&program->preamble, HG_PLACE_ROOT_X1) || touches(&program->postamble, HG_PLACE_GRADIENT1);
    const uint32_t arrays = program->arrays | 1u << HG_STRAND_X;

    hg_text_add(text, "static void %s(const hg_strand_args *args, int64_t first, int64_t last, void *scratch)\n{\n",
                name);
    hg_text_add(text, "    const int64_t V = args->vertices, S = args->strands, width = 3 * V;\n");
    if (program->n_uniform) hg_text_add(text, "    const hg_real *restrict u = args->uniform;\n");
    if (second) hg_text_add(text, "    const int64_t second = V > 1 ? 3 : 0;\n");
    hg_text_add(text, "    hg_v *restrict gradient = scratch;\n");
    for (int k = 0, n = 1; k < HG_STRAND_ARRAYS; k++)
        if (arrays >> k & 1)
            hg_text_add(text, "    hg_v *restrict tile_%s = (hg_v *)scratch + %d * width;\n", array_names[k], n++);
    hg_text_add(text, "    for (int64_t t = first; t < last; t++) {\n"
                      "        const int64_t frame = t / args->tiles, s = t %% args->tiles * HG_LANES;\n"
                      "        const int64_t count = S - s < HG_LANES ? S - s : HG_LANES, at = frame * S + s;\n");
    if (program->n_site || program->n_groom_strand)
        hg_text_add(text, "        const int64_t stored = (args->groom ? args->groom[frame] : 0) * args->tiles + t %% "
                          "args->tiles;\n");
    if (program->n_site)
        hg_text_add(text, "        const hg_v *restrict sites = (const hg_v *)args->site + stored * V * %d;\n",
                    program->n_site);
    if (program->n_groom_strand)
        hg_text_add(text,
                    "        const hg_v *restrict groom_strand = (const hg_v *)args->groom_strand + stored * %d;\n",
                    program->n_groom_strand);
    for (int k = 0; k < HG_STRAND_ARRAYS; k++)
        if (arrays >> k & 1)
            hg_text_add(
                text, "        hg_v_load_tile(tile_%s, (const hg_real *)args->array[%d] + at * width, width, count);\n",
                array_names[k], k);
    hg_text_add(text, "        hg_v energy[%d] = { 0 };\n", program->n_terms);
    if (program->n_adjoint) hg_text_add(text, "        hg_v adjoint[%d] = { 0 };\n", program->n_adjoint);
    if (program->n_strand) hg_text_add(text, "        hg_v strand[%d];\n", program->n_strand);
    hg_text_add(text, "        {\n");
    if (touches(&program->preamble, HG_PLACE_ROOT))
        hg_text_add(text,
                    "            hg_v root[7];\n"
                    "            hg_v_load_tile(root, (const hg_real *)args->root_rotation + 4 * at, 4, count);\n"
                    "            hg_v_load_tile(root + 4, (const hg_real *)args->root_position + 3 * at, 3, count);\n");
    list(p, &program->preamble, "            ");
    hg_text_add(text, "        }\n");
    for (int b = 0; b < program->bodies; b++) {
        if (b + 1 < program->bodies)
            hg_text_add(text, "        if (V > %d) {\n            const int64_t i = %d;\n", b, b);
        else
            hg_text_add(text, "        for (int64_t i = %d; i < V; i++) {\n", b);
        body(p, b, "            ");
        hg_text_add(text, "        }\n");
    }
    hg_text_add(text, "        {\n");
    list(p, &program->postamble, "            ");
    hg_text_add(text,
                "        }\n"
                "        if (args->gradient)\n"
                "            hg_v_store_tile((hg_real *)args->gradient + at * width, gradient, width, count);\n"
                "        hg_v_store_energy(args, t, at, count, energy, %d);\n    }\n}\n",
                program->n_terms);
    hg_free(p);
}
