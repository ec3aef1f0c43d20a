/* Integrity: a spring from every vertex to its ghost, the same vertex of a groom that moves with the head.
 *
 *     E = integral of the tension T from 0 to d,  d = |x - y|
 *     T = k d                                                       curve: hookean, so E = k/2 d^2
 *     T = k d              for d <= L/2                             curve: softening
 *         k L/2 (1 + u - 5 u^2 + 3 u^3)   for L/2 < d < L, u = 2 d/L - 1
 *         0                for d >= L
 *
 * Herrera et al. 2025 (AMS), eq. 1 and the curve of its fig. 3, L the rest length of the strand, at least 1e-6 m. Between
 * is the one cubic that meets the line at L/2 and zero at L with their slopes, so T is C1 and E is
 *
 *     E = k/2 min(d, L/2)^2 + k L^2/4 (u + u^2/2 - 5/3 u^3 + 3/4 u^4),  u = clamp(2 d/L - 1, 0, 1),
 *
 * 13/48 k L^2 where the spring has let go. y is the array "ghost" of the frame. Against sag the ghosts start at
 * y = x0 - (m/k) g: then x0 is the equilibrium under gravity (AMS eq. 13 prints the other sign). A vertex on its ghost has
 * gradient zero. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar integrity(void)
{
    scalar k = param("stiffness"), d = norm(sub(x(0), frame_vec3("ghost", 0)));
    if (option("curve", "hookean")) return mul(0.5, k, square(d));
    scalar L = max(strand_length(), 1e-6);
    scalar u = clamp(sub(divide(mul(2, d), L), 1), 0, 1);
    scalar soft = mul(u, add(1, mul(u, add(0.5, mul(u, sub(mul(0.75, u), 5.0 / 3))))));
    /* at the tie d = L/2 the polynomial has the slope, so that it is not counted twice */
    return mul(k, add(mul(0.5, square(min(mul(0.5, L), d))), mul(0.25, square(L), soft)));
}

HG_ENERGY(integrity, .equation = "integral of T(d), d = |x - ghost|: T = k d, or softening from L/2 to nothing at L",
          .source = "AMS eq. 1, fig. 3", .site = window(1),
          .params = { { "stiffness", 1e-3, "N/m", "spring to the ghost, per hair; 26 ug sag by 0.26 mm" } },
          .options = { { "curve", "hookean|softening", "hookean", "tension that grows for ever, or lets go" } },
          .zero_at_rest = true, .rigid_invariant = true);
