/* Gravity: potential energy in a uniform field.
 *
 *     E = -m g.x per vertex
 *
 * Lin et al. 2025 (Neuralocks), eq. 6. +Y is up. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar gravity(void) { return neg(mul(mass(0), dot(param3("g"), x(0)))); }

HG_ENERGY(gravity, .equation = "-m g.x per vertex", .source = "Neuralocks eq. 6", .site = window(1),
          .params = { { "g.x", 0, "m/s^2", "acceleration" },
                      { "g.y", -9.81, "m/s^2", "acceleration, up is positive" },
                      { "g.z", 0, "m/s^2", "acceleration" } });
