/* The example of scene/scene.h, run on the procedural scene. */
#include "scene/scene.h"

#include <stdio.h>

int main(void)
{
    hg_ctx *ctx;
    if (hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1 }) != HG_OK) return 1;
    const uint64_t seed = 1;
    const double *shape = NULL;
    static float vertices[200000 * 3], joints[200 * 3], rotation[3000 * 4], position[3000 * 3], x[3000 * 25 * 3];
#include "example.inc"
    int wrong = hg_ctx_status(ctx) != HG_OK || !(x[3000 * 25 * 3 - 1] != 0.0f);
    if (wrong) fprintf(stderr, "%s\n", hg_message());
    hg_poser_destroy(poser);
    hg_motion_destroy(motion);
    hg_groom_destroy(groom);
    hg_body_destroy(body);
    hg_ctx_destroy(ctx);
    return wrong;
}
