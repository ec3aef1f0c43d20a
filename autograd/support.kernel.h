/* Kernels that op files share: sums of partial results. */
#include "autograd/floats.h"

typedef struct {
    int64_t count, size;
    void *partials, *out;
    bool fresh;
} partials_args;

/* The first copy becomes the sum, pairs first. */
#define PARTIALS(REAL_, SUFFIX_)                                                                                       \
    HG_BODY void partials_##SUFFIX_(const partials_args *p, int64_t first, int64_t last)                               \
    {                                                                                                                  \
        REAL_ *partials = (REAL_ *)p->partials, *out = (REAL_ *)p->out;                                                \
        for (int64_t step = 1; step < p->count; step *= 2)                                                             \
            for (int64_t i = 0; i + step < p->count; i += 2 * step) {                                                  \
                REAL_ *restrict to = partials + i * p->size;                                                           \
                const REAL_ *restrict from = partials + (i + step) * p->size;                                          \
                for (int64_t e = first; e < last; e++) to[e] += from[e];                                               \
            }                                                                                                          \
        if (p->fresh)                                                                                                  \
            for (int64_t e = first; e < last; e++) out[e] = partials[e];                                               \
        else                                                                                                           \
            for (int64_t e = first; e < last; e++) out[e] += partials[e];                                              \
    }
PARTIALS(float, f32)
PARTIALS(double, f64)
#undef PARTIALS

HG_KERNELS(partials, partials_args, 4096)
