/* strand_kernel (private): what a strand kernel is given, whoever made it: the interpreter or printed C.
 *
 * A tile is `lanes` strands of one frame, a SIMD lane per strand. Its arrays are transposed to [V,3,lanes] in scratch that
 * stays in the cache, the sites are walked from root to tip, and the gradient is accumulated there and written once. Where
 * values are carried from site to site, a first walk from root to tip makes them and the second goes back.
 * This header stands alone: printed C needs nothing else. */
#ifndef HG_STRAND_KERNEL_H
#define HG_STRAND_KERNEL_H

#ifndef HG_CUDA /* NVRTC has no such header, and size_t without it */
#include <stddef.h>
#endif
#include <stdint.h>

/* What a program reads by vertex (x first), and by strand (root rotation, root position, then what a call gives). */
enum { HG_STRAND_ARRAYS = 16, HG_STRAND_INPUTS = 24 };

typedef struct {
    int64_t strands, vertices, tiles;              /* per frame */
    const void *array[HG_STRAND_ARRAYS];           /* [B,S,V,width], V-1 rows of q; rest data [G,S,V,width] */
    void *array_gradient[HG_STRAND_ARRAYS];        /* [B,S,V,width], V-1 rows of q; NULL: not wanted */
    const void *strand_input[HG_STRAND_INPUTS];    /* [B,S,width] */
    void *strand_input_gradient[HG_STRAND_INPUTS]; /* [B,S,width] */
    const int32_t *groom;                          /* [B], NULL: all 0 */
    const void *site;                              /* [G,tiles,V,n_site,lanes], made once per groom */
    const void *groom_strand;                      /* [G,tiles,n_groom_strand,lanes] */
    const void *uniform;                           /* [n_uniform] */
    double *energy;                                /* [B,tiles,terms]: sums over the strands of a tile */
    double *per_strand;                            /* [B,S,stride] or NULL: term t goes to column[t] */
    int64_t stride;
    const int32_t *column;
    int64_t count; /* printed CUDA: strands of all frames, and where a thread per strand has room for its tile */
    void *scratch;
} hg_strand_args;

/* Tiles first .. last-1 of all frames; scratch is the thread's own, 64-byte aligned. */
typedef void hg_strand_kernel(const hg_strand_args *args, int64_t first, int64_t last, void *scratch);

/* A kernel that was printed when the library was built. */
typedef struct {
    uint64_t hash;     /* of the program it was printed from */
    int lanes, bytes;  /* strands of a tile; 4 for f32, 8 for f64 */
    const char *level; /* "avx512", "avx2", "sse4", "plain" */
    hg_strand_kernel *run;
} hg_strand_kernel_entry;

#endif
