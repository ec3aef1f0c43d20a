/* Activations: their names, their definitions for the tests, and how they are written in ONNX. */
#include "autograd/activation.h"

#include <stdio.h>
#include <string.h>

static const char *const names[] = { "identity", "relu", "leaky_relu", "elu",     "tanh",
                                     "sigmoid",  "silu", "gelu",       "softplus" };
enum { COUNT = sizeof names / sizeof *names };

hg_status hg_activation_parse(const char *name, hg_activation *activation)
{
    for (int i = 0; i < COUNT; i++)
        if (strcmp(names[i], name) == 0) {
            *activation = (hg_activation)i;
            return HG_OK;
        }
    const char *nearest = hg_nearest_of(name, names, COUNT);
    return hg_fail(HG_INVALID, "there is no activation \"%s\"%s%s%s; there are %s", name,
                   nearest ? ", did you mean \"" : "", nearest ? nearest : "", nearest ? "\"" : "",
                   hg_activation_names());
}

const char *hg_activation_names(void) { return "identity|relu|leaky_relu|elu|tanh|sigmoid|silu|gelu|softplus"; }

bool hg_activation_saves_derivative(hg_activation activation) { return activation == HG_SILU || activation == HG_GELU; }
bool hg_activation_is_known(hg_activation activation) { return (unsigned)activation < COUNT; }
bool hg_activation_has_kink(hg_activation activation) { return activation == HG_RELU || activation == HG_LEAKY_RELU; }

/* The textbook formulas; HG_GELU as tanh, which the kernels write as a sigmoid. */
double hg_activation_reference(hg_activation activation, double x)
{
    switch (activation) {
    case HG_IDENTITY:
        return x;
    case HG_RELU:
        return fmax(x, 0);
    case HG_LEAKY_RELU:
        return x >= 0 ? x : 0.01 * x;
    case HG_ELU:
        return x >= 0 ? x : expm1(x);
    case HG_TANH:
        return tanh(x);
    case HG_SIGMOID:
        return 0.5 * (1 + tanh(0.5 * x));
    case HG_SILU:
        return x * 0.5 * (1 + tanh(0.5 * x));
    case HG_GELU:
        return 0.5 * x * (1 + tanh(sqrt(2 / 3.14159265358979323846) * (x + 0.044715 * x * x * x)));
    case HG_SOFTPLUS:
        return x > 30 ? x : log1p(exp(x));
    }
    return (double)NAN;
}

int hg_emit_activation(hg_emitter *e, hg_activation activation, int x)
{
    switch (activation) {
    case HG_IDENTITY:
        return x;
    case HG_RELU:
        return e->node(e->self, "Relu", 1, &x, "");
    case HG_LEAKY_RELU:
        return e->node(e->self, "LeakyRelu", 1, &x, "alpha=f", HG_LEAK);
    case HG_ELU:
        return e->node(e->self, "Elu", 1, &x, "alpha=f", 1.0);
    case HG_TANH:
        return e->node(e->self, "Tanh", 1, &x, "");
    case HG_SIGMOID:
        return e->node(e->self, "Sigmoid", 1, &x, "");
    case HG_SOFTPLUS:
        return e->node(e->self, "Softplus", 1, &x, "");
    case HG_SILU: {
        int sigmoid = e->node(e->self, "Sigmoid", 1, &x, "");
        return e->node(e->self, "Mul", 2, (int[]){ x, sigmoid }, "");
    }
    case HG_GELU: {
        int square = e->node(e->self, "Mul", 2, (int[]){ x, x }, "");
        int cube = e->node(e->self, "Mul", 2, (int[]){ square, hg_emit_scalar(e, HG_GELU_CUBE) }, "");
        int sum = e->node(e->self, "Add", 2, (int[]){ cube, hg_emit_scalar(e, 1) }, "");
        int scaled = e->node(e->self, "Mul", 2, (int[]){ x, hg_emit_scalar(e, HG_GELU_SCALE) }, "");
        int u = e->node(e->self, "Mul", 2, (int[]){ scaled, sum }, "");
        int sigmoid = e->node(e->self, "Sigmoid", 1, &u, "");
        return e->node(e->self, "Mul", 2, (int[]){ x, sigmoid }, "");
    }
    }
    return -1;
}
