/* Kernels of clip_gradient: rows of the gradient, shortened. */
#include "tensor/kernel.h"

typedef struct {
    int64_t width;
    double limit;
    int fresh;
    const void *g;
    void *to;
} clip_args;

#define CLIP_ROWS(REAL_, SUFFIX_)                                                                                      \
    HG_BODY void clip_gradient_##SUFFIX_(const clip_args *p, int64_t first, int64_t last)                              \
    {                                                                                                                  \
        for (int64_t row = first; row < last; row++) {                                                                 \
            const REAL_ *g = (const REAL_ *)p->g + row * p->width;                                                     \
            REAL_ *to = (REAL_ *)p->to + row * p->width;                                                               \
            double squares = 0;                                                                                        \
            for (int64_t i = 0; i < p->width; i++) squares += (double)g[i] * (double)g[i];                             \
            const double length = sqrt(squares);                                                                       \
            const REAL_ scale = (REAL_)(length > p->limit ? p->limit / length : 1);                                    \
            for (int64_t i = 0; i < p->width; i++) to[i] = p->fresh ? scale * g[i] : to[i] + scale * g[i];             \
        }                                                                                                              \
    }
CLIP_ROWS(float, f32)
CLIP_ROWS(double, f64)
#undef CLIP_ROWS

HG_KERNELS(clip_gradient, clip_args, 2048)
