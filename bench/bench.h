/* bench: the table of speeds. One program: every row measures hairgrad, and beside it, in turn and on the same arrays,
 * what its user would take otherwise: PyTorch and ONNX Runtime in a process of their own (bench/peer.py), Embree in this
 * one. What is not installed is left out, and said. With --device cuda both sides run there, and no row has an aim.
 *
 *     static void network(bench *b) { ... bench_race(...); bench_add(...); }
 */
#ifndef HG_BENCH_H
#define HG_BENCH_H

#include "hairgrad.h"

#include <stdio.h>

typedef struct {
    char row[40];             /* "strand energies, 3,000" */
    char ours[56], other[56]; /* what was run */
    double ours_ms, other_ms; /* medians; other 0: nothing beside it */
    double ratio, aim;        /* aim 0: none; reached when ratio >= aim, or <= aim where `at_most` */
    bool at_most;
    double operations, bytes; /* of ours, one evaluation; 0: not counted */
    int same_bits, steady;    /* 1 yes, 0 no, -1 does not apply */
    char note[320];
} bench_result;

typedef struct bench {
    hg_ctx *ctx[2];              /* of 1 and of 2 threads; on a device: two of it */
    hg_ctx *host;                /* of 2 threads, for what prepares */
    const char *device;          /* NULL: the processor */
    double operations, bytes;    /* of the machine, per second, 2 threads, f32 */
    const char *source, *python; /* root of the source; program that runs the other side */
    char folder[256];            /* for arrays */
    int rounds;                  /* turns of each side */
    bench_result result[64];
    int n;
    struct hg_hair_task *task[3]; /* made when first asked for, one per context; [2] on the host beside a device */
    char scene[96];
} bench;

#define BENCH_THREADS 2

double bench_now(void);            /* ms */
void bench_need(hg_status status); /* ends the program with the message where it is not HG_OK */
void bench_add(bench *b, const bench_result *result);
double bench_median(double *values, int n);
void *bench_get(const hg_tensor *tensor); /* its numbers, wherever it is; hg_free */
void bench_put(hg_tensor *tensor, const void *values);
bool bench_same(const hg_tensor *a, const hg_tensor *b); /* bit by bit */
void bench_write_tensor(bench *b, const char *name, const hg_tensor *tensor);

/* Those who run in turn. `times` makes n measurements, in ms, after one that does not count. */
typedef struct bench_side {
    const char *label;
    void (*times)(void *self, double *ms, int n);
    void *self;
    double median;
    struct bench_side *unused;
} bench_side;
void bench_race(bench *b, int n_sides, bench_side *sides, int each); /* each: measurements of a turn */

/* A process that answers: "run VARIANT N" with N times, "memory VARIANT" with bytes. */
typedef struct bench_peer bench_peer;
bench_peer *bench_peer_start(bench *b, const char *row,
                             int patience /* s until it is ready */); /* NULL: b->... says why */
void bench_peer_end(bench_peer *peer);
bool bench_peer_has(const bench_peer *peer, const char *variant);
const char *bench_peer_text(const bench_peer *peer);             /* "PyTorch 2.1", or why there is none */
double bench_peer_memory(bench_peer *peer, const char *variant); /* bytes, 0: not known */
bench_side bench_peer_side(bench_peer *peer, const char *variant, const char *label);

/* An array as a .npy file in the folder. */
void bench_write(bench *b, const char *name, hg_dtype dtype, int rank, const int64_t *shape, const void *data);

struct hg_hair_task *
bench_task(bench *b,
           int threads);   /* 3,000 strands of 25 vertices on a body, all energies; threads 0: one of the host */
void bench_body(bench *b); /* body.h5 in the folder: the real one where it is, else a bust of as many triangles */
bool bench_steady_begin(bench *b, int64_t state[3]);
int bench_steady(bench *b, const int64_t state[3]); /* 1: nothing was allocated since */

/* Rows */
void bench_energies(bench *b);
void bench_chain(bench *b);
void bench_energy(bench *b, const char *name); /* one that is asked for, a plug-in's too */
void bench_self_collision(bench *b);
void bench_body_collision(bench *b);
void bench_network(bench *b);
void bench_decoder(bench *b);
void bench_step(bench *b);
void bench_inference(bench *b);
void bench_pairs(bench *b);
void bench_step_memory(bench *b); /* prints bytes; in a process of its own */

/* Embree, where it is installed: bench/embree.c. */
#ifdef BENCH_EMBREE
typedef struct bench_embree bench_embree;
bench_embree *bench_embree_create(int64_t n_vertices, int64_t n_faces, const int32_t *faces);
void bench_embree_destroy(bench_embree *e);
void bench_embree_query(bench_embree *e, const float *vertices, float reach, int64_t n, const float *points,
                        int32_t *triangle, float *distance);
#endif

#endif
