/* Inertia: implicit Euler as an energy (Martin et al. 2011; Gast et al. 2015).
 *
 *     E = m / (2 dt^2) |x - xhat|^2 per vertex,  xhat = 2 x(t-1) - x(t-2), detached
 *
 * Lin et al. 2025 (Neuralocks), eq. 9. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar inertia(void)
{
    scalar per_square = divide(0.5, square(dt()));
    return mul(per_square, mass(0), square(sub(x(0), predicted(0))));
}

HG_ENERGY(inertia, .equation = "m / (2 dt^2) |x - (2 x(t-1) - x(t-2))|^2 per vertex", .source = "Neuralocks eq. 9",
          .site = window(1));
