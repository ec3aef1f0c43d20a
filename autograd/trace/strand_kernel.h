/* strand_kernel (private): what a strand kernel is given, whoever made it: the interpreter or printed C.
 *
 * A tile is `lanes` strands of one frame, a SIMD lane per strand. Its arrays are transposed to [V,3,lanes] in scratch that
 * stays in the cache, the sites are walked from root to tip, and the gradient is accumulated there and written once.
 * This header stands alone: printed C needs nothing else. */
#ifndef HG_STRAND_KERNEL_H
#define HG_STRAND_KERNEL_H

#include <stddef.h>
#include <stdint.h>

/* The arrays [B,S,V,3] that a frame may bring. */
enum {
    HG_STRAND_X,
    HG_STRAND_POSED,
    HG_STRAND_PREDICTED,
    HG_STRAND_PREVIOUS,
    HG_STRAND_CONTACT_POINT,
    HG_STRAND_CONTACT_NORMAL,
    HG_STRAND_ARRAYS
};

typedef struct {
    int64_t strands, vertices, tiles;    /* per frame */
    const void *array[HG_STRAND_ARRAYS]; /* NULL where it is not read */
    const void *root_rotation;           /* [B,S,4] */
    const void *root_position;           /* [B,S,3] */
    const int32_t *groom;                /* [B], NULL: all 0 */
    const void *site;                    /* [G,tiles,V,n_site,lanes], made once per groom */
    const void *groom_strand;            /* [G,tiles,n_groom_strand,lanes] */
    const void *uniform;                 /* [n_uniform] */
    void *gradient;                      /* [B,S,V,3] */
    double *energy;                      /* [B,tiles,terms]: sums over the strands of a tile */
    double *per_strand;                  /* [B,S,stride] or NULL: term t goes to column[t] */
    int64_t stride;
    const int32_t *column;
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
