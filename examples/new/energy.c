/* my_energy: what it is for, in one sentence.
 *
 *     E = k/2 l0 e^2 per edge, e = 1/2 ((l / l0)^2 - 1)        replace this by your own: here the Green strain of an edge
 *
 * Build it, look at it, check its gradient, see what becomes of it, train with it:
 *
 *     cc -shared -fPIC $(hairgrad flags) my_energy.c -o my_energy.so
 *     hairgrad --plugin my_energy.so losses my_energy
 *     hairgrad --plugin my_energy.so gradcheck my_energy
 *     hairgrad --plugin my_energy.so trace my_energy
 *     hairgrad --plugin my_energy.so train RECIPE.yaml -o RUN --set losses.my_energy.stiffness="2e-3 N"
 *
 * The function is called once and records the energy of ONE site; nobody writes a gradient, a loop or a layout. What it may
 * use stands in autograd/trace/names.h and trace.h, in the folder that `hairgrad flags` names. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h" /* the short names: last */

static scalar my_energy(void)
{
    scalar l0 = rest_length(rest(0), rest(1)); /* never zero: safe to divide by */
    scalar strain = mul(0.5, sub(divide(square(sub(x(1), x(0))), square(l0)), 1));
    return mul(0.5, param("stiffness"), l0, square(strain));
}

HG_ENERGY(my_energy, .equation = "k/2 l0 e^2 per edge, e = ((l / l0)^2 - 1) / 2", .source = "where it comes from",
          .site = window(2), /* vertices in a row: 1 vertex, 2 edge, 3 pair of edges, 4 torsion */
          .params = { { "stiffness", 2e-3, "N", "what it does, per hair" } }, .zero_at_rest = true,
          .rigid_invariant = true); /* what the tests may assume */
