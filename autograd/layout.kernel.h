/* Kernels that move elements: slabs, and axes in another order. To copy, an element is so many bits; only adding asks for its
 * type. */
#include "tensor/kernel.h"

#ifdef HG_CUDA
#define HG_MAX_RANK 6 /* as tensor.h has it */
#endif

/* ---- slabs: rows of `length` elements, from rows of one pitch into rows of another ---- */

typedef struct {
    int64_t length, from_pitch, from_offset, to_pitch, to_offset; /* elements */
    const void *from;
    void *to;
} slab_args;

#define SLAB(NAME_, TYPE_, MOVE_)                                                                                      \
    HG_BODY void NAME_(const slab_args *p, int64_t first, int64_t last)                                                \
    {                                                                                                                  \
        for (int64_t e = first; e < last;) {                                                                           \
            int64_t i;                                                                                                 \
            const int64_t row = hg_divide(e, p->length, &i), n = p->length - i < last - e ? p->length - i : last - e;  \
            const TYPE_ *from = (const TYPE_ *)p->from + row * p->from_pitch + p->from_offset + i;                     \
            TYPE_ *to = (TYPE_ *)p->to + row * p->to_pitch + p->to_offset + i;                                         \
            MOVE_;                                                                                                     \
            e += n;                                                                                                    \
        }                                                                                                              \
    }
#ifdef HG_CUDA /* one element */
#define COPY_ *to = *from
#else
#define COPY_ memcpy(to, from, (size_t)n * sizeof *to)
#endif
#define ADD_                                                                                                           \
    for (int64_t j = 0; j < n; j++) to[j] += from[j]
SLAB(slab_16_bits, uint16_t, COPY_)
SLAB(slab_32_bits, uint32_t, COPY_)
SLAB(slab_64_bits, uint64_t, COPY_)
SLAB(slab_add_f32, float, ADD_)
SLAB(slab_add_f64, double, ADD_)

HG_KERNEL(slab_16_bits, slab_args, 16384)
HG_KERNEL(slab_32_bits, slab_args, 16384)
HG_KERNEL(slab_64_bits, slab_args, 16384)
HG_KERNELS(slab_add, slab_args, 16384)

/* ---- axes in another order ---- */

/* `to` is walked in order; stride[i] is where its axis i lies in `from`. */
typedef struct {
    int rank, near; /* the axis of `to` whose elements are neighbours in `from` */
    int64_t shape[HG_MAX_RANK], stride[HG_MAX_RANK];
    const void *from;
    void *to;
} permute_args;

#ifdef HG_CUDA
#define PERMUTE(NAME_, TYPE_, MOVE_)                                                                                   \
    HG_BODY void NAME_(const permute_args *p, int64_t first, int64_t last)                                             \
    {                                                                                                                  \
        int64_t rest = first, index, other = 0;                                                                        \
        (void)last;                                                                                                    \
        for (int i = p->rank - 1; i > 0; i--) {                                                                        \
            rest = hg_divide(rest, p->shape[i], &index);                                                               \
            other += index * p->stride[i];                                                                             \
        }                                                                                                              \
        if (p->rank > 0) other += rest * p->stride[0];                                                                 \
        ((TYPE_ *)p->to)[first] MOVE_((const TYPE_ *)p->from)[other];                                                  \
    }
#else
#define PERMUTE(NAME_, TYPE_, MOVE_)                                                                                   \
    HG_BODY void NAME_(const permute_args *p, int64_t first, int64_t last)                                             \
    {                                                                                                                  \
        int64_t index[HG_MAX_RANK] = { 0 }, other = 0, rest = first;                                                   \
        for (int i = p->rank; i-- > 0; rest /= p->shape[i]) {                                                          \
            index[i] = rest % p->shape[i];                                                                             \
            other += index[i] * p->stride[i];                                                                          \
        }                                                                                                              \
        for (int64_t e = first; e < last; e++) {                                                                       \
            ((TYPE_ *)p->to)[e] MOVE_((const TYPE_ *)p->from)[other];                                                  \
            for (int i = p->rank; i-- > 0;) {                                                                          \
                other += p->stride[i];                                                                                 \
                if (++index[i] < p->shape[i]) break;                                                                   \
                other -= p->shape[i] * p->stride[i];                                                                   \
                index[i] = 0;                                                                                          \
            }                                                                                                          \
        }                                                                                                              \
    }
#endif
PERMUTE(permute_16_bits, uint16_t, =)
PERMUTE(permute_32_bits, uint32_t, =)
PERMUTE(permute_64_bits, uint64_t, =)
PERMUTE(permute_add_f32, float, +=)
PERMUTE(permute_add_f64, double, +=)

HG_KERNEL(permute_16_bits, permute_args, 4096)
HG_KERNEL(permute_32_bits, permute_args, 4096)
HG_KERNEL(permute_64_bits, permute_args, 4096)
HG_KERNELS(permute_add, permute_args, 4096)

/* What is neighbours in `to` is far apart in `from` and the other way round: a GPU's block takes a square of the two axes, reads it
 * along the one, and writes it along the other. Blocks count squares, those of the last axis first, then of `near`, then the
 * other axes. */
enum { SQUARE = 32, SQUARE_THREADS = 256 };

#ifdef HG_CUDA
#define PERMUTE_SQUARES(NAME_, TYPE_, MOVE_)                                                                           \
    HG_BODY void NAME_##_block(const permute_args *p, int64_t block)                                                   \
    {                                                                                                                  \
        __shared__ TYPE_ square[SQUARE][SQUARE + 1]; /* columns of it lie in different banks */                        \
        const int last = p->rank - 1, column = (int)threadIdx.x % SQUARE;                                              \
        int64_t across, along, index, from = 0, to = 0, pitch = 1, near_pitch = 1;                                     \
        int64_t rest = hg_divide(block, (p->shape[last] + SQUARE - 1) / SQUARE, &across);                              \
        rest = hg_divide(rest, (p->shape[p->near] + SQUARE - 1) / SQUARE, &along);                                     \
        for (int i = last; i >= 0; i--) {                                                                              \
            if (i == p->near) near_pitch = pitch;                                                                      \
            if (i != p->near && i != last) {                                                                           \
                rest = hg_divide(rest, p->shape[i], &index);                                                           \
                from += index * p->stride[i];                                                                          \
                to += index * pitch;                                                                                   \
            }                                                                                                          \
            pitch *= p->shape[i];                                                                                      \
        }                                                                                                              \
        across *= SQUARE;                                                                                              \
        along *= SQUARE;                                                                                               \
        for (int row = (int)threadIdx.x / SQUARE; row < SQUARE; row += SQUARE_THREADS / SQUARE)                        \
            if (along + column < p->shape[p->near] && across + row < p->shape[last])                                   \
                square[row][column] =                                                                                  \
                    ((const TYPE_ *)p->from)[from + (across + row) * p->stride[last] + along + column];                \
        __syncthreads();                                                                                               \
        for (int row = (int)threadIdx.x / SQUARE; row < SQUARE; row += SQUARE_THREADS / SQUARE)                        \
            if (along + row < p->shape[p->near] && across + column < p->shape[last])                                   \
                ((TYPE_ *)p->to)[to + (along + row) * near_pitch + across + column] MOVE_ square[column][row];         \
        __syncthreads(); /* before the next square */                                                                  \
    }
PERMUTE_SQUARES(squares_32_bits, uint32_t, =)
PERMUTE_SQUARES(squares_64_bits, uint64_t, =)
PERMUTE_SQUARES(squares_add_f32, float, +=)
PERMUTE_SQUARES(squares_add_f64, double, +=)
#endif

HG_KERNEL_GPU(squares_32_bits, permute_args, SQUARE_THREADS)
HG_KERNEL_GPU(squares_64_bits, permute_args, SQUARE_THREADS)
HG_KERNEL_GPU(squares_add_f32, permute_args, SQUARE_THREADS)
HG_KERNEL_GPU(squares_add_f64, permute_args, SQUARE_THREADS)
