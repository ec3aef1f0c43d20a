/* What the passes over pairs and fields leave at the vertices, summed in a fixed order: per strand, per groom, in all. */
#include "tensor/kernel.h"

typedef struct {
    const double *from; /* [frames,S,V] */
    int64_t vertices;   /* V */
    double *sums;       /* [frames*S] */
    double *also;       /* NULL, or the same at distance `stride` */
    int64_t stride;
} strand_sums_args;

HG_BODY void strand_sums(const strand_sums_args *p, int64_t first, int64_t last)
{
    for (int64_t s = first; s < last; s++) {
        double sum = 0;
        for (int64_t v = 0; v < p->vertices; v++) sum += p->from[s * p->vertices + v];
        p->sums[s] = sum;
        if (p->also) p->also[s * p->stride] = sum;
    }
}
HG_KERNEL(strand_sums, strand_sums_args, 256)

/* Sums of chunks of `chunk` numbers; then, as one chunk, of those: a tree over the threads of a block, each of which adds up
 * every 256th number of the chunk. */
#define SUM_THREADS 256

typedef struct {
    const double *from;
    int64_t n, chunk;
    double *to; /* [chunks], NULL: there is one, and it is added to `gradient` */
    void *gradient;
    double scale;
    int64_t dtype; /* of the gradient */
} sum_args;

HG_BODY void sum_put(const sum_args *p, int64_t chunk, double sum)
{
    if (p->to)
        p->to[chunk] = p->scale * sum;
    else if (p->dtype == HG_F64)
        *(double *)p->gradient += p->scale * sum;
    else
        *(float *)p->gradient += (float)(p->scale * sum);
}

/* What thread t of a block adds up. */
HG_BODY double sum_part(const sum_args *p, int64_t chunk, int t)
{
    const int64_t first = chunk * p->chunk, last = first + p->chunk < p->n ? first + p->chunk : p->n;
    double sum = 0;
    for (int64_t i = first + t; i < last; i += SUM_THREADS) sum += p->from[i];
    return sum;
}

#ifdef HG_CUDA
HG_BODY void sum_chunks_block(const sum_args *p, int64_t chunk)
{
    __shared__ double parts[SUM_THREADS];
    const int t = (int)threadIdx.x;
    parts[t] = sum_part(p, chunk, t);
    __syncthreads();
    for (int half = SUM_THREADS / 2; half > 0; half /= 2) {
        if (t < half) parts[t] += parts[t + half];
        __syncthreads();
    }
    if (t == 0) sum_put(p, chunk, parts[0]);
    __syncthreads(); /* before the parts of the next chunk */
}
#else
HG_BODY void sum_chunks(const sum_args *p, int64_t first, int64_t last)
{
    double parts[SUM_THREADS];
    for (int64_t chunk = first; chunk < last; chunk++) {
        for (int t = 0; t < SUM_THREADS; t++) parts[t] = sum_part(p, chunk, t);
        for (int half = SUM_THREADS / 2; half > 0; half /= 2)
            for (int t = 0; t < half; t++) parts[t] += parts[t + half];
        sum_put(p, chunk, parts[0]);
    }
}
#endif
HG_KERNEL_BLOCK(sum_chunks, sum_args, 1, SUM_THREADS)

typedef struct {
    const double *from; /* [frames,width] */
    int64_t frames, width;
    const int32_t *groom; /* [frames], NULL: all 0 */
    int64_t grooms;       /* the frames are the grooms */
    void *to;             /* [grooms,width], or of strands the same shape as `from` */
    double scale;
} groom_sums_args;

#define REAL    float
#define F(name) name##_f32
#include "hairloss/physics_pass.inc"
#undef REAL
#undef F
#define REAL    double
#define F(name) name##_f64
#include "hairloss/physics_pass.inc"
#undef REAL
#undef F
HG_KERNELS(groom_sums, groom_sums_args, 1024)
HG_KERNELS(strand_adds, groom_sums_args, 1024)
