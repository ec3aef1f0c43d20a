/* Energies as a researcher may write them, for tests: together they use every input and operation of a window energy.
 * They register themselves like the built-in ones, so every test that walks the registry has them too. */
#ifndef ENERGIES_OWN_H
#define ENERGIES_OWN_H

#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

/* four vertices and a term of the root edge */
static scalar test_torsion(void)
{
    scalar now = norm(sub(x(3), x(0))), then = norm(sub(rest(3), rest(0)));
    return mul(0.5, param("stiffness"), square(sub(now, then)));
}

static scalar test_torsion_root(void)
{
    vec3 was = rotate(root_rotation(), sub(root_rest(1), root_rest(0)));
    return mul(param("root"), square(sub(sub(root_x(1), root_x(0)), was)));
}

HG_ENERGY(test_torsion, .equation = "k/2 (|x3 - x0| - l0)^2", .source = "test", .site = window(4),
          .params = { { "stiffness", 0.5, "N/m", "spring" }, { "root", 2, "N/m", "spring" } },
          .root = test_torsion_root, .zero_at_rest = true, .rigid_invariant = true);

/* one vertex and a root term: the root's body comes after the last vertex-only one */
static scalar test_tether(void) { return mul(param("stiffness"), norm(sub(x(0), root_x(0)))); }

static scalar test_tether_root(void)
{
    return mul(param("stiffness"), square(sub(norm(sub(root_x(1), root_x(0))), 0.003)));
}

HG_ENERGY(test_tether, .equation = "k |x - root|", .source = "test", .site = window(1),
          .params = { { "stiffness", 1e-3, "N", "pull" } }, .root = test_tether_root, .rigid_invariant = true);

/* every function, every input */
static scalar test_everything(void)
{
    vec3 e = mul(200, sub(x(1), x(0))), d = mul(100, sub(x(1), posed(1)));
    vec3 across = cross(e, mul(100, sub(x(0), previous(0))));
    scalar angle = atan2(norm(across), add(2, dot(e, d)));
    scalar near = exp(neg(divide(square(d), add(1, mul(100, attribute("body_distance", 1))))));
    scalar wave = add(sin(e.x), cos(mul(2, e.y)), mul(0.1, hg_trace_log(add(1, square(e)))));
    scalar side = select(less(d.x, mul(0.1, d.y)), square(d.x), mul(d.y, d.z));
    scalar edge = clamp(norm(e), 0.5, 1.2);
    quat q = normalize(quaternion(add(1, e.x), mul(0.2, d)));
    scalar turn = dot(rotate(q, e), rotate(root_rotation(), param3("way")));
    scalar deep = rsqrt(add(1, square(mul(50, max(sub(0.01, contact_distance(1)), 0)))));
    scalar late = square(mul(100, sub(predicted(1), x(1))));
    scalar off = norm(mul(30, sub(x(1), root_position())));
    scalar sum = add(angle, near, wave, side, edge, abs(turn));
    return mul(param("stiffness"), mass(1), add(sum, deep, mul(dt(), late), mul(min(off, 3), max(off, 0.1))));
}

HG_ENERGY(test_everything, .equation = "k (...)", .source = "test", .site = window(2),
          .params = { { "stiffness", 1, "1", "scale" },
                      { "way.x", 0.3, "1", "direction" },
                      { "way.y", -0.2, "1", "direction" },
                      { "way.z", 0.7, "1", "direction" },
                      { "distance", 0.01, "m", "reach of the contact" } },
          .options = { { "mode", "plane|exact", "exact", "contact" } }, .contact = true);

#undef log
#undef exp
#undef sin
#undef cos
#undef sqrt
#undef abs
#undef min
#undef max
#undef select
#undef field

#endif
