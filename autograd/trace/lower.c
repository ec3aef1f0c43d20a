/* Lowering: nodes that outputs need become a list of instructions, each value computed once, close to where it is first
 * used; and lists become the steps of the interpreter, with registers sharing slots as soon as they are free. */
#include "autograd/trace/strand.h"

#include <string.h>

typedef struct {
    hg_code *list;
    hg_graph *graph;
    bool (*leaf)(void *self, int node, hg_operand *operand);
    void *self;
    hg_numbers *numbers;
    hg_operand *where; /* of every node; place NONE: not computed yet */
    bool failed;
} lowering;

static void append(lowering *l, hg_instruction instruction)
{
    hg_code *list = l->list;
    if (list->n == list->capacity) {
        const int capacity = list->capacity ? 2 * list->capacity : 128;
        hg_instruction *grown = hg_resize(list->instructions, (size_t)list->capacity, (size_t)capacity, sizeof *grown);
        if (!grown) {
            l->failed = true;
            return;
        }
        list->instructions = grown;
        list->capacity = capacity;
    }
    list->instructions[list->n++] = instruction;
}

static hg_operand number_operand(lowering *l, double value)
{
    hg_numbers *numbers = l->numbers;
    int i = 0;
    while (i < numbers->n && memcmp(&numbers->values[i], &value, sizeof value) != 0) i++;
    if (i == numbers->capacity) {
        const int capacity = numbers->capacity ? 2 * numbers->capacity : 32;
        double *grown = hg_resize(numbers->values, (size_t)numbers->capacity, (size_t)capacity, sizeof *grown);
        if (!grown) {
            l->failed = true;
            return (hg_operand){ HG_PLACE_NUMBER, 0, 0 };
        }
        numbers->values = grown;
        numbers->capacity = capacity;
    }
    if (i == numbers->n) numbers->values[numbers->n++] = value;
    return (hg_operand){ HG_PLACE_NUMBER, 0, (int16_t)i };
}

static hg_operand need(lowering *l, int node)
{
    if (l->where[node].place != HG_PLACE_NONE || l->failed) return l->where[node];
    const hg_node n = l->graph->nodes[node];
    hg_operand operand = { HG_PLACE_NONE, 0, 0 };
    if (n.op == HG_NODE_NUMBER) {
        operand = number_operand(l, n.number);
    } else if (l->leaf(l->self, node, &operand)) {
    } else if (n.op == HG_NODE_DETACH) {
        operand = need(l, n.a);
    } else if (n.op == HG_NODE_INPUT) {
        l->failed = true;
        hg_graph_fail(l->graph, HG_INVALID, "the input %s is asked for where it is not known",
                      hg_input_name(n.input.kind));
    } else {
        hg_instruction instruction = { .op = n.op };
        const int arguments = hg_node_arguments(n.op);
        instruction.a = need(l, n.a);
        if (arguments > 1) instruction.b = need(l, n.b);
        if (arguments > 2) instruction.c = need(l, n.c);
        if (l->list->registers == INT16_MAX) {
            l->failed = true;
            hg_graph_fail(l->graph, HG_INVALID, "the formulas are too long: more than %d operations", INT16_MAX);
        }
        operand = instruction.to = (hg_operand){ HG_PLACE_REGISTER, 0, (int16_t)l->list->registers++ };
        append(l, instruction);
    }
    return l->where[node] = operand;
}

hg_status hg_lower(hg_code *list, hg_graph *graph, bool (*leaf)(void *self, int node, hg_operand *operand), void *self,
                   hg_numbers *numbers, int n, const hg_output *outputs)
{
    lowering l = { list, graph, leaf, self, numbers, hg_alloc((size_t)graph->n + 1, sizeof(hg_operand)), false };
    if (!l.where) return HG_MEMORY;
    for (int i = 0; i < n; i++) {
        const hg_operand from = outputs[i].node < 0 ? number_operand(&l, 0) : need(&l, outputs[i].node);
        append(&l, (hg_instruction){ .op = outputs[i].add ? HG_DO_ADD_TO : HG_DO_SET, .to = outputs[i].to, .a = from });
    }
    hg_free(l.where);
    if (graph->status != HG_OK) return hg_fail(graph->status, "%s", graph->message);
    return l.failed ? hg_fail(HG_MEMORY, "out of memory while lowering a formula") : HG_OK;
}

void hg_code_free(hg_code *list)
{
    hg_free(list->instructions);
    *list = (hg_code){ 0 };
}

/* ---- steps of the interpreter ------------------------------------------------------------------------------- */

static bool same_for_all(hg_operand operand)
{
    return operand.place == HG_PLACE_NUMBER || operand.place == HG_PLACE_UNIFORM;
}

/* a b + c, a b - c, c - a b in one step, where the product is used nowhere else. The product stays where it is, marked
 * unused, and is not turned into a step. */
static void fuse(hg_instruction *list, int n, const int *uses, const int *defined, bool *dropped)
{
    for (int i = 0; i < n; i++) {
        hg_instruction *sum = &list[i];
        if (sum->op != HG_NODE_ADD && sum->op != HG_NODE_SUB) continue;
        for (int side = 1; side >= 0; side--) {
            const hg_operand product = side ? sum->b : sum->a, other = side ? sum->a : sum->b;
            if (product.place != HG_PLACE_REGISTER || uses[product.index] != 1 || same_for_all(other)) continue;
            const hg_instruction *mul = &list[defined[product.index]];
            if (mul->op != HG_NODE_MUL || same_for_all(mul->b)) continue;
            const uint8_t op = sum->op == HG_NODE_ADD ? HG_DO_MULADD : side ? HG_DO_SUBMUL : HG_DO_MULSUB;
            dropped[defined[product.index]] = true;
            *sum = (hg_instruction){ op, sum->to, mul->a, mul->b, other };
            break;
        }
    }
}

hg_status hg_steps_create(hg_steps *steps, const hg_code *source, int lanes, const int *stride)
{
    const int n = source->n, registers = source->registers;
    hg_instruction *list = hg_alloc((size_t)n + 1, sizeof *list);
    int *uses = hg_alloc((size_t)registers + 1, sizeof *uses), *last = hg_alloc((size_t)registers + 1, sizeof *last);
    int *defined = hg_alloc((size_t)registers + 1, sizeof *defined),
        *slot = hg_alloc((size_t)registers + 1, sizeof *slot);
    int *idle = hg_alloc((size_t)registers + 3, sizeof *idle);
    bool *dropped = hg_alloc((size_t)n + 1, sizeof *dropped);
    steps->steps = hg_alloc(3 * (size_t)n + 1, sizeof *steps->steps);
    steps->n = steps->slots = 0;
    if (!list || !uses || !last || !defined || !slot || !idle || !dropped || !steps->steps) goto out;

    if (n) memcpy(list, source->instructions, (size_t)n * sizeof *list);
    for (int i = 0; i < n; i++) {
        const hg_operand from[3] = { list[i].a, list[i].b, list[i].c };
        for (int k = 0; k < 3; k++)
            if (from[k].place == HG_PLACE_REGISTER) uses[from[k].index]++;
        if (list[i].to.place == HG_PLACE_REGISTER) defined[list[i].to.index] = i;
        if (list[i].op == HG_NODE_MUL && same_for_all(list[i].b)) { /* the one that is the same for all lanes first */
            const hg_operand swap = list[i].a;
            list[i].a = list[i].b;
            list[i].b = swap;
        }
    }
    fuse(list, n, uses, defined, dropped);
    for (int i = 0; i < n; i++) {
        const hg_operand from[3] = { list[i].a, list[i].b, list[i].c };
        for (int k = 0; k < 3 && !dropped[i]; k++)
            if (from[k].place == HG_PLACE_REGISTER) last[from[k].index] = i;
    }

    /* two slots are kept for values that have to be spread over the lanes first */
    int n_idle = 0;
    steps->slots = 2;
    for (int i = 0; i < n; i++) {
        if (dropped[i]) continue;
        const hg_instruction *in = &list[i];
        hg_operand from[3] = { in->a, in->b, in->c };
        int at[3] = { 0 }, form = 0, spread = 0;
        const int operands = in->op == HG_NODE_SELECT || in->op >= HG_DO_MULADD ? 3
                             : in->op >= HG_DO_SET                              ? 1
                                                                                : hg_node_arguments(in->op);
        for (int k = 0; k < operands; k++) {
            bool may_be_same = false; /* does the interpreter have this form? */
            if (in->op == HG_DO_SET)
                may_be_same = true;
            else if (in->op == HG_NODE_SELECT)
                may_be_same = k > 0;
            else if (in->op >= HG_DO_MULADD)
                may_be_same = k == 0;
            else if (operands == 2 && in->op != HG_NODE_ATAN2)
                may_be_same = k == 0 || !same_for_all(in->a);
            if (from[k].place == HG_PLACE_REGISTER) {
                at[k] = slot[from[k].index] * lanes;
            } else if (same_for_all(from[k])) {
                at[k] = from[k].index;
                if (may_be_same) {
                    form |= in->op == HG_NODE_SELECT ? 1 << (k - 1) : 1 << k;
                } else {
                    steps->steps[steps->n++] = (hg_step){ .op = 4 * HG_DO_SET + 1,
                                                          .to = HG_PLACE_REGISTER,
                                                          .to_at = spread * lanes,
                                                          .a = from[k].place,
                                                          .a_at = from[k].index };
                    from[k].place = HG_PLACE_REGISTER;
                    at[k] = spread++ * lanes;
                }
            } else {
                at[k] = (from[k].offset * stride[from[k].place] + from[k].index) * lanes;
            }
        }
        for (int k = 0; k < operands; k++) { /* free after the last use; once, if it is used twice here */
            const hg_operand operand = k == 0 ? in->a : k == 1 ? in->b : in->c;
            if (operand.place != HG_PLACE_REGISTER || last[operand.index] != i) continue;
            bool again = false;
            for (int j = 0; j < k; j++) {
                const hg_operand before = j == 0 ? in->a : in->b;
                again |= before.place == HG_PLACE_REGISTER && before.index == operand.index;
            }
            if (!again) idle[n_idle++] = slot[operand.index];
        }
        hg_step step = { .op = (uint16_t)(4 * in->op + form),
                         .to = in->to.place,
                         .a = from[0].place,
                         .b = from[1].place,
                         .c = from[2].place,
                         .a_at = at[0],
                         .b_at = at[1],
                         .c_at = at[2] };
        if (in->to.place == HG_PLACE_REGISTER) {
            slot[in->to.index] = n_idle ? idle[--n_idle] : steps->slots++;
            step.to_at = slot[in->to.index] * lanes;
        } else {
            step.to_at = (in->to.offset * stride[in->to.place] + in->to.index) * lanes;
        }
        steps->steps[steps->n++] = step;
    }
out:;
    const bool done = list && uses && last && defined && slot && idle && dropped && steps->steps;
    hg_free(list);
    hg_free(uses);
    hg_free(last);
    hg_free(defined);
    hg_free(slot);
    hg_free(idle);
    hg_free(dropped);
    return done ? HG_OK : HG_MEMORY;
}

void hg_steps_free(hg_steps *steps)
{
    hg_free(steps->steps);
    *steps = (hg_steps){ 0 };
}
