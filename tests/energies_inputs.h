/* Formulas for test_inputs: energies that read every input there is and carry values of every kind, and some that carry them
 * the wrong way. */
#ifndef ENERGIES_INPUTS_H
#define ENERGIES_INPUTS_H

#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

/* Every input of a window, differentiable in all of them: three vertices, two edges. */
static scalar input_everything(void)
{
    vec3 e = mul(200, sub(x(1), x(0))), f = mul(200, sub(x(2), rest(1))), d = mul(100, sub(x(1), posed(1)));
    scalar l0 = rest_length(rest(1), rest(2));
    quat turn = qmul(conj(q(0)), q(1));
    scalar late = square(mul(100, sub(predicted(2), x(2)))), drift = dot(mul(100, sub(x(0), previous(1))), e);
    scalar ghost = square(mul(50, sub(x(2), frame_vec3("test_ghost", 2))));
    scalar wind = mul(frame_scalar("test_wind", 0), frame_scalar("test_wind", 1));
    scalar straight = dot(rotate(q(1), e), rotate(root_rotation(), sub(root_x(1), root_rest(1))));
    scalar near = mul(attribute("body_distance", 1), square(sub(x(1), root_position())));
    return mul(param("stiffness"), mass(1),
               add(mul(dt(), late), mul(0.1, drift), add(wind, ghost, mul(30, near)),
                   add(mul(param("bend"), square(turn)), straight, divide(square(sub(norm(f), param("bend"))), l0)),
                   dot(d, e)));
}

static scalar input_everything_root(void)
{
    vec3 was = rotate(root_rotation(), sub(root_rest(1), root_rest(0)));
    return mul(param("bend"), square(sub(sub(root_x(1), root_x(0)), was)), add(1, square(q(0))));
}

HG_ENERGY(input_everything, .equation = "k (...)", .source = "test", .site = window(3),
          .params = { { "stiffness", 3, "1", "scale" }, { "bend", 0.7, "1", "scale" } }, .root = input_everything_root);

/* Carried values of all widths, of rest data and of everything else, one made of the other. */
static scalar input_chain(void)
{
    scalar l0 = rest_length(rest(0), rest(1)), l1 = rest_length(rest(1), rest(2));
    scalar from_root = carry("from_root", l0);
    vec3 t0 = tangent(x(0), x(1), l0), t1 = tangent(x(1), x(2), l1);
    quat frame = carry("frame", qmul(transport(tangent(root_x(0), root_x(1), l0), t0), root_rotation()));
    vec3 rest_frame = carry("rest_frame", tangent(rest(0), rest(1), l0));
    vec3 drag = carry("drag", mul(param("stiffness"), t0));
    scalar wound = carry("wound", add(from_root, param("bend")));
    keep("from_root", add(from_root, l1));
    keep("frame", qmul(transport(t0, t1), frame));
    keep("rest_frame", rotate(transport(tangent(rest(0), rest(1), l0), tangent(rest(1), rest(2), l1)), rest_frame));
    keep("drag", add(mul(0.6, drag), cross(t0, mul(attribute("body_distance", 1), t1)), mul(0.2, rotate(frame, drag))));
    keep("wound", add(mul(0.9, wound), mul(dt(), dot(drag, t1))));
    return mul(param("stiffness"),
               add(square(sub(rotate(frame, rest_frame), t1)), dot(drag, add(t0, vector(0.3, -0.2, 0.5))),
                   mul(from_root, wound), square(wound)));
}

HG_ENERGY(input_chain, .equation = "k (...)", .source = "test", .site = window(3),
          .params = { { "stiffness", 3, "1", "scale" }, { "bend", 0.7, "1", "scale" } });

/* What a carried value means: the vertex number, the arc length from the root now and at rest. */
static scalar input_count(void)
{
    scalar number = carry("number", hg_trace_number(0)), length = carry("length", hg_trace_number(0)),
           rest_length_ = carry("rest_length", hg_trace_number(0));
    keep("number", add(number, 1));
    keep("length", add(length, norm(sub(x(1), x(0)))));
    keep("rest_length", add(rest_length_, norm(sub(rest(1), rest(0)))));
    return add(mul(param("number"), number), mul(param("length"), length), mul(param("rest_length"), rest_length_));
}

HG_ENERGY(input_count, .equation = "k (...)", .source = "test", .site = window(2),
          .params = { { "number", 0, "1", "" }, { "length", 0, "1", "" }, { "rest_length", 0, "1", "" } });

/* The same energy twice: by the vertex that was kept, and by a window of two. */
static scalar input_last(void)
{
    vec3 last = carry("last", x(0));
    keep("last", x(0));
    return mul(param("stiffness"), square(sub(x(0), last)));
}

static scalar input_edges(void) { return mul(param("stiffness"), square(sub(x(1), x(0)))); }

HG_ENERGY(input_last, .equation = "k |x - last|^2", .source = "test", .site = window(1),
          .params = { { "stiffness", 2, "1", "" } });
HG_ENERGY(input_edges, .equation = "k |x - last|^2", .source = "test", .site = window(2),
          .params = { { "stiffness", 2, "1", "" } });

/* What physics makes by itself. */
static scalar input_mean(void)
{
    return mul(0.5, square(sub(frame_vec3("deformation_mean", 0), frame_vec3("deformation", 0))));
}

HG_ENERGY(input_mean, .equation = "1/2 |dbar - d|^2", .source = "test", .site = window(1));

/* Carried the wrong way. */
static scalar one(void) { return carry("one", hg_trace_number(1)); }

static scalar not_kept(void) { return one(); }

static scalar not_carried(void)
{
    keep("one", hg_trace_number(1));
    return hg_trace_number(1);
}

static scalar kept_twice(void)
{
    scalar value = one();
    keep("one", value);
    keep("one", value);
    return value;
}

static scalar carried_twice(void)
{
    scalar value = add(one(), one());
    keep("one", value);
    return value;
}

static scalar kept_as_vector(void)
{
    scalar value = one();
    keep("one", x(0));
    return value;
}

static scalar no_such_edge(void) { return norm(q(1)); }

static scalar two_widths(void) { return add(frame_scalar("wind", 0), norm(frame_vec3("wind", 0))); }

#undef sqrt
#undef abs
#undef exp
#undef min
#undef max
#undef distance

#endif
