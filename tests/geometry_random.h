/* Random numbers and contexts for the tests of geometry. */
#ifndef HG_TEST_GEOMETRY_H
#define HG_TEST_GEOMETRY_H

#include "geometry/geometry.h"
#include "geometry/vector.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

enum { SEED = 7 };

static inline double uniform(uint64_t stream, uint64_t i) { return hg_random_uniform(SEED, stream, i); }
static inline double between(uint64_t stream, uint64_t i, double lo, double hi)
{
    return lo + (hi - lo) * uniform(stream, i);
}

static inline hg_ctx *make_ctx(int threads)
{
    hg_ctx *ctx = NULL;
    assert_int_equal(hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = threads, .seed = 1 }), HG_OK);
    return ctx;
}

static inline void assert_vec(hg_vec3d a, hg_vec3d b, double tolerance)
{
    if (hg_vec3d_distance(a, b) > tolerance) fail_msg("(%g %g %g) is not (%g %g %g)", a.x, a.y, a.z, b.x, b.y, b.z);
}

#endif
