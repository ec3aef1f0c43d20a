/* What a product by cuBLAS needs beside it: factors rounded to bf16, and the product of an empty sum. */
#include "tensor/kernel.h"
#include "tensor/math.h"

/* to[rows,columns] is packed to rows of `pitch`. */
typedef struct {
    const float *from;
    uint16_t *to;
    int64_t columns, ld, pitch;
} round_factor_args;

HG_BODY void round_factor(const round_factor_args *p, int64_t first, int64_t last)
{
    for (int64_t i = first; i < last;) {
        const int64_t row = i / p->columns, column = i % p->columns;
        const int64_t n = p->columns - column < last - i ? p->columns - column : last - i;
        hg_bf16_of_f32(n, p->from + row * p->ld + column, p->to + row * p->pitch + column);
        i += n;
    }
}
HG_KERNEL(round_factor, round_factor_args, 16384)

/* c = beta c; c is not read where beta is 0. */
typedef struct {
    void *c;
    int64_t columns, ld;
    double beta;
    int f64;
} scale_product_args;

HG_BODY void scale_product(const scale_product_args *p, int64_t first, int64_t last)
{
    for (int64_t i = first; i < last; i++) {
        const int64_t at = i / p->columns * p->ld + i % p->columns;
        if (p->f64) {
            double *c = (double *)p->c + at;
            *c = p->beta == 0 ? 0 : p->beta * *c;
        } else {
            float *c = (float *)p->c + at;
            *c = p->beta == 0 ? 0 : (float)p->beta * *c;
        }
    }
}
HG_KERNEL(scale_product, scale_product_args, 16384)
