/* Pose regularisation: over consecutive frames the predicted deformation changes little.
 *
 *     E = k |dbar - d|^2 per vertex,  dbar the mean of d over the consecutive frames of a sequence
 *
 * Stuyck et al. 2025 (Quaffure), eq. 14. d is the array "deformation" of the frame, what a network has predicted; physics
 * makes "deformation_mean" of it over hg_frame.consecutive frames. The mean is detached, and nothing is lost by that: the
 * differences to it add up to zero, and with them the gradient through it. One frame alone has energy zero. Positions do
 * not enter: the gradient in x is zero. */
#include "hairloss/hairloss.h"

#include "autograd/trace/names.h"

static scalar pose_reg(void)
{
    vec3 mean = detach(frame_vec3("deformation_mean", 0));
    return mul(param("stiffness"), square(sub(mean, frame_vec3("deformation", 0))));
}

HG_ENERGY(pose_reg, .equation = "k |dbar - d|^2 per vertex, d of consecutive frames", .source = "Quaffure eq. 14",
          .site = window(1), .params = { { "stiffness", 1e-3, "N/m", "spring to the mean, per hair" } },
          .rigid_invariant = true);
