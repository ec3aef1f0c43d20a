/* Drag: air resistance, proportional to the velocity of a vertex.
 *
 *     E = m c / (2 dt) |x - x(t-1)|^2 per vertex, x(t-1) detached
 *
 * Ours: its gradient is the implicit force m c v. Without it long hair does not settle. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar drag(void)
{
    scalar rate = divide(mul(0.5, param("c")), dt());
    return mul(rate, mass(0), square(sub(x(0), previous(0))));
}

HG_ENERGY(drag, .equation = "m c / (2 dt) |x - x(t-1)|^2 per vertex", .source = "hairgrad", .site = window(1),
          .params = { { "c", 3, "1/s", "rate at which air slows a hair; 0 to 3 for short, 3 for long hair" } });
