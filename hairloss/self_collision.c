/* Self collision: hair resists being packed denser than at rest.
 *
 *     E = k sum_i max(rho_i - rho_rest_i, 0)^3,    rho_i = sum_j m_j W(|x_i - x_j|, h)
 *     W(r, h) = 4 - 6 s^2 + 3 s^3 for s = r/h <= 1,    (2 - s)^3 for s <= 2,    0 beyond
 *
 * Source: Neuralocks eq. 5; Quaffure eq. 11-13. The sum goes over all vertices j of the frame, i itself included
 * (W(0) = 4). rho_rest_i is the same sum in the rest groom, or the attribute "density_rest". `kernel_mass: unit` counts
 * every vertex as 1; `kg` weighs it with its mass, as the papers' formula reads, and needs a k that is larger by
 * 1 / mass^3. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar kernel(void)
{
    scalar s = divide(distance(), param("h"));
    scalar inner = add(4, mul(square(s), sub(mul(3, s), 6)));
    scalar outer = max(0, sub(2, s));
    return select(less(s, 1), inner, mul(outer, square(outer)));
}

static scalar self_collision(void)
{
    scalar excess = max(0, sub(field(), field_rest()));
    return mul(param("stiffness"), mul(excess, square(excess)));
}

HG_ENERGY(self_collision, .equation = "k max(rho - rho_rest, 0)^3, rho_i = sum_j m_j W(|x_i - x_j|, h)",
          .source = "Neuralocks eq. 5, Quaffure eq. 11-13", .site = { HG_SITE_FIELD, 1 },
          .params = { { "stiffness", 1e-10, "J", "energy of a vertex whose density exceeds that at rest by 1" },
                      { "h", 0.0025, "m", "half of the support; 25 to 35 neighbours within 2 h are usual" } },
          .options = { { "kernel_mass", "unit|kg", "unit", "what a vertex counts in the density" } }, .kernel = kernel,
          .reach = "h", .zero_at_rest = true, .rigid_invariant = true);
