/* Reverse mode over a recorded graph. The adjoints are nodes of the same graph, so that they are folded and shared like
 * the rest. min, max and select give the side that was not chosen an adjoint of exactly zero (by selection, never by a
 * product with zero), ties go to the first argument, and the derivatives of sqrt and abs at 0 are 0. */
#include "autograd/trace/graph.h"

typedef struct {
    hg_graph *graph;
    int *adjoint;
} reverse;

static int op(reverse *r, hg_node_op code, int a, int b) { return hg_graph_op(r->graph, code, a, b, -1); }

static int select(reverse *r, int condition, int a, int b)
{
    return hg_graph_op(r->graph, HG_NODE_SELECT, condition, a, b);
}

static int number(reverse *r, double value) { return hg_graph_number(r->graph, value); }

static void give(reverse *r, int node, int adjoint)
{
    if (node < 0 || adjoint < 0 || !r->graph->nodes[node].active) return;
    r->adjoint[node] = r->adjoint[node] < 0 ? adjoint : op(r, HG_NODE_ADD, r->adjoint[node], adjoint);
}

/* Adds the adjoint g of node i to its arguments. */
static void pass_on(reverse *r, int i, int g)
{
    const hg_node node = r->graph->nodes[i];
    const int a = node.a, b = node.b, c = node.c, zero = number(r, 0);
    switch ((hg_node_op)node.op) {
    case HG_NODE_ADD:
        give(r, a, g);
        give(r, b, g);
        break;
    case HG_NODE_SUB:
        give(r, a, g);
        give(r, b, op(r, HG_NODE_NEG, g, -1));
        break;
    case HG_NODE_MUL:
        if (a == b) {
            give(r, a, op(r, HG_NODE_MUL, number(r, 2), op(r, HG_NODE_MUL, g, a)));
            break;
        }
        give(r, a, op(r, HG_NODE_MUL, g, b));
        give(r, b, op(r, HG_NODE_MUL, g, a));
        break;
    case HG_NODE_DIV: /* d(a/b) = da / b - (a/b) db / b */
        give(r, a, op(r, HG_NODE_DIV, g, b));
        give(r, b, op(r, HG_NODE_NEG, op(r, HG_NODE_MUL, op(r, HG_NODE_DIV, g, b), i), -1));
        break;
    case HG_NODE_NEG:
        give(r, a, op(r, HG_NODE_NEG, g, -1));
        break;
    case HG_NODE_SQRT:
        give(r, a,
             select(r, op(r, HG_NODE_LESS, zero, i), op(r, HG_NODE_DIV, op(r, HG_NODE_MUL, number(r, 0.5), g), i),
                    zero));
        break;
    case HG_NODE_RSQRT: /* d a^-1/2 = -1/2 (a^-1/2)^3 da */
        give(r, a,
             op(r, HG_NODE_MUL, op(r, HG_NODE_MUL, number(r, -0.5), g),
                op(r, HG_NODE_MUL, i, op(r, HG_NODE_MUL, i, i))));
        break;
    case HG_NODE_ABS:
        give(r, a,
             select(r, op(r, HG_NODE_LESS, zero, a), g,
                    select(r, op(r, HG_NODE_LESS, a, zero), op(r, HG_NODE_NEG, g, -1), zero)));
        break;
    case HG_NODE_EXP:
        give(r, a, op(r, HG_NODE_MUL, g, i));
        break;
    case HG_NODE_LOG:
        give(r, a, op(r, HG_NODE_DIV, g, a));
        break;
    case HG_NODE_SIN:
        give(r, a, op(r, HG_NODE_MUL, g, op(r, HG_NODE_COS, a, -1)));
        break;
    case HG_NODE_COS:
        give(r, a, op(r, HG_NODE_NEG, op(r, HG_NODE_MUL, g, op(r, HG_NODE_SIN, a, -1)), -1));
        break;
    case HG_NODE_ATAN2: { /* a is y, b is x; nothing at the origin */
        const int squares = op(r, HG_NODE_ADD, op(r, HG_NODE_MUL, a, a), op(r, HG_NODE_MUL, b, b));
        const int scale = select(r, op(r, HG_NODE_LESS, zero, squares), op(r, HG_NODE_DIV, g, squares), zero);
        give(r, a, op(r, HG_NODE_MUL, scale, b));
        give(r, b, op(r, HG_NODE_NEG, op(r, HG_NODE_MUL, scale, a), -1));
        break;
    }
    case HG_NODE_MIN: {
        const int second = op(r, HG_NODE_LESS, b, a);
        give(r, a, select(r, second, zero, g));
        give(r, b, select(r, second, g, zero));
        break;
    }
    case HG_NODE_MAX: {
        const int second = op(r, HG_NODE_LESS, a, b);
        give(r, a, select(r, second, zero, g));
        give(r, b, select(r, second, g, zero));
        break;
    }
    case HG_NODE_SELECT:
        give(r, b, select(r, a, g, zero));
        give(r, c, select(r, a, zero, g));
        break;
    default:
        break;
    }
}

hg_status hg_graph_reverse(hg_graph *graph, int n_roots, const int *roots, const int *seeds, bool stop, int *adjoint)
{
    reverse r = { graph, adjoint };
    int last = -1;
    for (int i = 0; i < n_roots; i++)
        if (roots[i] > last) last = roots[i];
    for (int i = 0; i <= last; i++) adjoint[i] = -1;
    for (int i = 0; i < n_roots; i++) give(&r, roots[i], seeds[i]);
    for (int i = last; i >= 0; i--)
        if (adjoint[i] >= 0 && !(stop && graph->nodes[i].rate != HG_RATE_SITE)) pass_on(&r, i, adjoint[i]);
    return graph->status == HG_OK ? HG_OK : hg_fail(graph->status, "%s", graph->message);
}
