/* Kernels of gather and scatter_add, element by element of [n, row]. */
#include "autograd/floats.h"

typedef struct {
    int64_t row; /* elements of a row */
    const int32_t *index;
    const int64_t *start;  /* [rows+1] into places */
    const int32_t *places; /* entries of index, by the row that they name, ascending */
    const void *from;
    void *to;
    bool add;
} gather_args;

/* to[i] = from[index[i]], for elements of a size; a range is made of pieces of rows. */
#define COPY(TYPE_, SUFFIX_)                                                                                           \
    HG_BODY void gather_##SUFFIX_(const gather_args *p, int64_t first, int64_t last)                                   \
    {                                                                                                                  \
        TYPE_ *to = (TYPE_ *)p->to;                                                                                    \
        int64_t j, i = hg_divide(first, p->row, &j);                                                                   \
        for (int64_t e = first; e < last; i++, j = 0) {                                                                \
            const int64_t width = p->row - j < last - e ? p->row - j : last - e;                                       \
            const TYPE_ *from = (const TYPE_ *)p->from + p->index[i] * p->row + j;                                     \
            for (int64_t k = 0; k < width; k++) to[e + k] = from[k];                                                   \
            e += width;                                                                                                \
        }                                                                                                              \
    }
COPY(uint16_t, 2)
COPY(uint32_t, 4)
COPY(uint64_t, 8)
#undef COPY

#define REAL   float
#define SUFFIX _f32
#include "autograd/gather.inc"
#undef REAL
#undef SUFFIX
#define REAL   double
#define SUFFIX _f64
#include "autograd/gather.inc"
#undef REAL
#undef SUFFIX

HG_KERNEL(gather_2, gather_args, 16384)
HG_KERNEL(gather_4, gather_args, 16384)
HG_KERNEL(gather_8, gather_args, 16384)
HG_KERNELS(gather_add, gather_args, 16384)
HG_KERNELS(segments, gather_args, 4096)
