/* Bend and twist with the frame carried along the strand: bend_twist without its shortcut.
 *
 *     p_0 = 1, p_{i+1} = transport(t_i -> t_{i+1}) p_i,  r and the energy as in bend_twist
 *
 * Lin et al. 2025 (Neuralocks), eq. 3 and fig. 7 (Bergou et al. 2008: the Bishop frame). The frame of an edge is carried
 * from edge to edge, so that r is the rotation between neighbours whatever the strand did before: bend_twist's direct
 * transport from the root edge loses the holonomy of the path, and has a guard of its own wherever a strand points back
 * along its root edge; here only neighbours that fold onto each other do.
 *
 * Carried is f_i = p_i F, the frame of edge i as the root's frame F sees it: f_0 = F, f_{i+1} = T_i f_i with
 * T_i = transport(t_i -> t_{i+1}), and r = conj(F) conj(p_i) p_{i+1} F = conj(f_i) T_i f_i. The tangent
 * is carried too, which saves making and differentiating it in both of its pairs. At rest F is 1, and the whole chain is
 * made once per groom. Folded and collapsed edges: the guards of tangent and transport, finite. */
#include "hairloss/hairloss.h"

#include "hairloss/bend_twist.h"

static scalar bend_twist_chain(void)
{
    scalar l0 = rest_length(rest(0), rest(1)), l1 = rest_length(rest(1), rest(2));
    quat turn0 = transport(tangent(rest(0), rest(1), l0), tangent(rest(1), rest(2), l1));
    vec3 t0 = carry("tangent", tangent(x(0), x(1), l0)), t1 = tangent(x(1), x(2), l1);
    quat turn = transport(t0, t1);
    quat frame0 = carry("rest_frame", quaternion(1, vector(0, 0, 0)));
    quat frame = carry("frame", root().frame);
    keep("tangent", t1);
    keep("rest_frame", qmul(turn0, frame0));
    keep("frame", qmul(turn, frame));
    return strain_energy(seen_in(frame, turn), seen_in(frame0, turn0), mul(0.5, add(l0, l1)));
}

HG_ENERGY(bend_twist_chain, .equation = "as bend_twist, with p_{i+1} = transport(t_i -> t_{i+1}) p_i",
          .source = "Neuralocks eq. 3, fig. 7", .site = window(3),
          .params = { { "stiffness", 1e-8, "N*m^2", "bending and twisting stiffness of a hair" } },
          .options = { { "strain", "published|smooth", "published", "how a rotation is compared with the one at rest" },
                       { "root", "free|clamped", "free", "does the root edge resist leaving its rest direction" } },
          .root = root_clamp, .zero_at_rest = true, .rigid_invariant = true);
